"""The true vehicle: rigid body, thrust, failures of jets as they are in truth, sensors."""
