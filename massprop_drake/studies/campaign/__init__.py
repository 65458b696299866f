"""Campaigns: many cases of one scenario, flown on one machine or many, and what they say together."""
