"""Systems of the autopilot."""
