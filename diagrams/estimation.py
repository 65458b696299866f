"""The estimators: all that is known from gyros, accelerometers and commands. Nothing here sees the truth.

    jet_commands --> impulse_model --impulses--> rotation_estimator --> convergence_monitor --> estimate
    gyros ----------------------------------------^     |  rate_sample, prediction    ^
                                                        v                             |
    accelerometers --------------------------> mass_estimator ------------------------'

    innovations of both filters --> failure_detector --> adaptation (to both), known_force (to all three),
                                                         reconfiguration (to the autopilot)

The same diagram serves the closed loop, the open loop and recorded telemetry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPortIndex

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle import SensorPackage
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.estimation.convergence_monitor import ConvergenceMonitor
from massprop_drake.systems.estimation.failure_detector import FailureDetector
from massprop_drake.systems.estimation.impulse_model import ImpulseModel
from massprop_drake.systems.estimation.mass_estimator import MassEstimator
from massprop_drake.systems.estimation.rotation_estimator import RotationEstimator


def build(scenario: Scenario) -> Diagram:
    """The estimation diagram of a scenario.

    Ports:
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, 0 to 1, NaN where not
            known.
        outside_wrench (in, 6): known outside forces, see `ImpulseModel`; may stay unconnected.
        <gyro> (in, 3): measured rate, rad/s, body axes, for each package.
        <accelerometer> (in, 3): integrated specific force, ft/s or m/s, body axes, for each package.
        estimate (out, 10), standard_deviation (out, 10), converged (out, 1): see `ConvergenceMonitor`.
        impulses (out, 8): see `ImpulseModel`.
        rotation_estimate (out, 9), rotation_covariance (out, 81), rotation_standard_deviation (out, 9),
            rotation_innovation (out, 3), rotation_innovation_covariance (out, 9), rotation_status (out, 7),
            rotation_report (out, 25): see `RotationEstimator`.
        mass_estimate (out, 2), mass_innovation (out, 3), mass_innovation_covariance (out, 9),
            mass_status (out, 6), mass_report (out, 8), with an accelerometer: see `MassEstimator`.
        reconfiguration (out, 7 + n_jets), closed (out, n_jets), held_closed (out, n_jets),
            detector_status (out, 14), detector_likelihood (out, n_jets), detector_magnitude (out, n_jets),
            detector_report (out, 14 + 2 n_jets), detector_memory (out, 10 + 4 n_jets), with a detector: see
            `FailureDetector`.
    """
    vehicle = scenario.vehicle_data
    estimate, covariance = params.initial_estimate(scenario), params.initial_covariance(scenario)
    thrust_errors = params.thrust_errors(scenario)
    builder = DiagramBuilder()

    impulses = builder.AddNamedSystem(
        "impulse_model",
        ImpulseModel(
            wrenches=vehicle.wrenches,
            time_constants_s=params.estimator_time_constants(scenario),
            period_s=vehicle.sample_period_s,
        ),
    )
    rotation = builder.AddNamedSystem(
        "rotation_estimator",
        RotationEstimator(
            estimate=estimate[:N_ROTATION],
            covariance=covariance[:N_ROTATION, :N_ROTATION],
            gyros=_packages(params.gyros(scenario)),
            params=params.rotation_params(scenario),
            thrust_errors=thrust_errors,
        ),
    )
    monitor = builder.AddNamedSystem("convergence_monitor", ConvergenceMonitor(params.convergence_limits(scenario)))
    commands = builder.ExportInput(impulses.GetInputPort("jet_commands"), "jet_commands")
    builder.ExportInput(impulses.GetInputPort("outside_wrench"), "outside_wrench")
    builder.Connect(impulses.GetOutputPort("impulses"), rotation.GetInputPort("impulses"))
    if thrust_errors is not None:
        builder.Connect(impulses.GetOutputPort("mean_level"), rotation.GetInputPort("mean_level"))
    for sensor in vehicle.gyros:
        builder.ExportInput(rotation.GetInputPort(sensor.name), sensor.name)
    builder.Connect(rotation.GetOutputPort("estimate"), monitor.GetInputPort("rotation_estimate"))
    builder.Connect(rotation.GetOutputPort("covariance"), monitor.GetInputPort("rotation_covariance"))

    if vehicle.accelerometers:
        mass = builder.AddNamedSystem(
            "mass_estimator",
            MassEstimator(
                mass_reciprocal=float(estimate[9]),
                variance=float(covariance[9, 9]),
                accelerometers=_packages(params.accelerometers(scenario)),
                params=params.mass_params(scenario),
                thrust_errors=thrust_errors,
            ),
        )
        builder.Connect(impulses.GetOutputPort("impulses"), mass.GetInputPort("impulses"))
        if thrust_errors is not None:
            builder.Connect(impulses.GetOutputPort("mean_level"), mass.GetInputPort("mean_level"))
        for name in ("rate_sample", "predicted_estimate", "predicted_covariance"):
            builder.Connect(rotation.GetOutputPort(name), mass.GetInputPort(name))
        for instrument in vehicle.accelerometers:
            builder.ExportInput(mass.GetInputPort(instrument.name), instrument.name)
        builder.Connect(mass.GetOutputPort("estimate"), monitor.GetInputPort("mass_estimate"))
        for name in ("estimate", "innovation", "innovation_covariance", "status", "report"):
            builder.ExportOutput(mass.GetOutputPort(name), f"mass_{name}")
        if scenario.detector.kind != "off":
            _add_detector(builder, scenario, impulses, rotation, mass, commands)

    builder.ExportOutput(impulses.GetOutputPort("impulses"), "impulses")
    for name in (
        "estimate",
        "covariance",
        "standard_deviation",
        "innovation",
        "innovation_covariance",
        "status",
        "report",
    ):
        builder.ExportOutput(rotation.GetOutputPort(name), f"rotation_{name}")
    for name in ("estimate", "standard_deviation", "converged"):
        builder.ExportOutput(monitor.GetOutputPort(name), name)
    diagram = builder.Build()
    diagram.set_name("estimation")
    return diagram


def _add_detector(
    builder: DiagramBuilder,
    scenario: Scenario,
    impulses: ImpulseModel,
    rotation: RotationEstimator,
    mass: MassEstimator,
    commands: InputPortIndex,
) -> None:
    """Puts the failure detector between the filters' innovations and their updates."""
    detector = builder.AddNamedSystem(
        "failure_detector",
        FailureDetector(
            params.detector_params(scenario),
            limits=params.convergence_limits(scenario),
            mass_size=mass.GetOutputPort("predicted").size(),
        ),
    )
    builder.ConnectInput(commands, detector.GetInputPort("jet_commands"))
    builder.Connect(impulses.GetOutputPort("impulses"), detector.GetInputPort("impulses"))
    builder.Connect(rotation.GetOutputPort("judged"), detector.GetInputPort("rotation_judged"))
    builder.Connect(mass.GetOutputPort("judged"), detector.GetInputPort("mass_judged"))
    for name in ("predicted_estimate", "predicted_covariance"):
        builder.Connect(rotation.GetOutputPort(name), detector.GetInputPort(name))
    builder.Connect(mass.GetOutputPort("predicted"), detector.GetInputPort("mass_predicted"))

    if params.thrust_errors(scenario) is not None:
        for name, system in (("rotation", rotation), ("mass", mass)):
            builder.Connect(system.GetOutputPort("thrust_error_effects"), detector.GetInputPort(f"{name}_effects"))

    for system in (impulses, rotation, mass):
        builder.Connect(detector.GetOutputPort("known_force"), system.GetInputPort("known_force"))
    for system in (rotation, mass):
        builder.Connect(detector.GetOutputPort("adaptation"), system.GetInputPort("adaptation"))
    for name in ("reconfiguration", "closed", "held_closed"):
        builder.ExportOutput(detector.GetOutputPort(name), name)
    for name in ("status", "likelihood", "magnitude", "report", "memory"):
        builder.ExportOutput(detector.GetOutputPort(name), f"detector_{name}")


def _packages(sensors: Sequence[SensorPackage]) -> tuple[Package, ...]:
    return tuple(Package(sensor.name, math.inf if sensor.range is None else sensor.range) for sensor in sensors)
