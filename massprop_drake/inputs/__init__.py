"""Inputs: vehicles and scenarios from YAML, and the parameters of the mathematics made of them."""
