"""Pure functions on numpy arrays: the mathematics behind every system. Knows nothing of Drake."""
