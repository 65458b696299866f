"""LeafSystems: thin plumbing around `massprop_drake.maths`, one file each.

Names are loaded when they are first used: `from massprop_drake.systems import RateGyro`. Those of the true vehicle are
templates as well, `RateGyro_[AutoDiffXd]`, and have `parameters`, see `massprop_drake.systems.parameters`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "AttitudeReference": "autopilot.attitude_reference",
    "BodyMotion": "multibody.body_motion",
    "ConvergenceMonitor": "estimation.convergence_monitor",
    "CycleEstimator": "estimation.cycle_estimator",
    "Disturbance": "vehicle.disturbance_source",
    "Disturbance_": "vehicle.disturbance_source",
    "FailureDetector": "estimation.failure_detector",
    "FindingsMonitor": "estimation.findings_monitor",
    "FiringTestSystem": "autopilot.firing_test",
    "HandControllers": "autopilot.hand_controllers",
    "ImpulseModel": "estimation.impulse_model",
    "IntegratingAccelerometer": "vehicle.integrating_accelerometer",
    "IntegratingAccelerometer_": "vehicle.integrating_accelerometer",
    "JetSchedule": "autopilot.jet_schedule",
    "JetSelection": "autopilot.jet_selection_system",
    "MassEstimator": "estimation.mass_estimator",
    "MassPropertyEstimator": "massprop_drake.diagrams.estimation",  # a diagram of systems
    "NoiseSource": "vehicle.noise_source",
    "NoiseSource_": "vehicle.noise_source",
    "PhaseSpaceController": "autopilot.phase_space_controller",
    "PoseTracker": "vehicle.trackers",
    "RateGyro": "vehicle.rate_gyro",
    "RateGyro_": "vehicle.rate_gyro",
    "ReactionJets": "vehicle.reaction_jets_system",
    "ReactionJets_": "vehicle.reaction_jets_system",
    "ReactionWheels": "vehicle.reaction_wheels",
    "RigidBodyPlant": "vehicle.rigid_body_plant",
    "RigidBodyPlant_": "vehicle.rigid_body_plant",
    "RotationEstimator": "estimation.rotation_estimator",
    "Sensor": "vehicle.sensor",
    "Sensor_": "vehicle.sensor",
    "StarTracker": "multibody.star_tracker",
    "StarTracker_": "multibody.star_tracker",
    "TelemetrySource": "estimation.telemetry_source",
    "Thrusters": "multibody.thrusters",
    "VelocityTracker": "vehicle.trackers",
    "WheelController": "autopilot.wheel_controller",
    "WheelSchedule": "autopilot.wheel_schedule",
}

__all__ = sorted(_HOMES)  # noqa: PLE0605 (the names are those of the mapping above)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOMES[name]
    return getattr(import_module(home if home.startswith("massprop_drake.") else f"{__name__}.{home}"), name)
