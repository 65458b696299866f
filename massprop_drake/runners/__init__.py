"""Runners: the simulator, recorded telemetry, and the estimator for real time."""
