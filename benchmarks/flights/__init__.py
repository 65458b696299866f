"""Flights of the card: what is drawn, flown and recorded of each."""
