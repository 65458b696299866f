"""Estimation from gyros, accelerometers and commands: filters, detectors, and their cycle."""
