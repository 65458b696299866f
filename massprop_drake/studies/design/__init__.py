"""Designs of maneuvers: from what a user asks to a scenario, a page and a verdict."""
