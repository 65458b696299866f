"""Flights of the card: draws, runs and records of each kind."""
