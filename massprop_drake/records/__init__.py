"""Recorded telemetry: files of any recorder, the maps that make rows of them, and their quality."""
