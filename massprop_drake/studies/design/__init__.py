"""Designs of maneuvers: from a user's request to a scenario, a page and a verdict."""
