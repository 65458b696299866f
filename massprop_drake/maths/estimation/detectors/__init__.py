"""Detectors of failed jets, a file per variant."""
