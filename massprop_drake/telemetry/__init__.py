"""Recorded telemetry, its format and its quality."""
