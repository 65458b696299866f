"""Filters of mass properties, a file per variant."""
