"""Entries by theme; `catalogue` puts them together."""
