"""Entries by theme; `catalog` puts them together."""
