"""The autopilot: phase space and jet selection."""
