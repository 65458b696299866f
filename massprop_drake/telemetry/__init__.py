"""What is read: recorded telemetry, its format and its quality."""
