"""Analyses of a whole flight at once: batch regression, bound, guaranteed intervals, identifiability."""
