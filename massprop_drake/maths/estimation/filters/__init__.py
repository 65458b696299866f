"""Filters of mass properties, a file per variant; `registry` has the names of those that scenarios may name."""
