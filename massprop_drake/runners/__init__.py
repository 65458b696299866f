"""What runs it: the simulator, recorded telemetry, and the estimator for real time."""
