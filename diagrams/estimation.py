"""The estimators, fed by gyros, accelerometers and commands. Nothing here sees the truth.

    jet_commands --> impulse_model --impulses--> rotation_estimator --> convergence_monitor --> estimate
    gyros ----------------------------------------^     |  turning                    ^
                                                        v                             |
    accelerometers --------------------------> mass_estimator ------------------------'

    evidence of both filters --> failure_detector --> adaptation (to both), known_force (to all three),
                                                      reconfiguration (to the autopilot)

These are the thesis's filters. Any other filter is one system with its detector, which makes its own impulses:

    jet_commands, gyros, accelerometers, poses, velocities --> estimator --> estimate, fault_probability,
                                                                         reconfiguration (to the autopilot)

With `findings` a monitor follows the reports of all:

    rotation_report, mass_report, detector_report --> findings_monitor --> failed_jets, detections, verdict

The same diagram serves the closed loop, the open loop and recorded telemetry.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import DiagramBuilder, InputPortIndex, LeafSystem, OutputPortIndex

from massprop_drake.diagrams._wiring import Diagram, export_outputs
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import SensorPackage
from massprop_drake.maths.estimation.detector import Detector
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.results.monitoring import FlightMonitor
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.estimation.convergence_monitor import ConvergenceMonitor
from massprop_drake.systems.estimation.cycle_estimator import CycleEstimator
from massprop_drake.systems.estimation.failure_detector import FailureDetector
from massprop_drake.systems.estimation.findings_monitor import FindingsMonitor
from massprop_drake.systems.estimation.impulse_model import ImpulseModel
from massprop_drake.systems.estimation.mass_estimator import MassEstimator
from massprop_drake.systems.estimation.rotation_estimator import RotationEstimator
from massprop_drake.systems.layouts import (
    DETECTOR_REPORT,
    HYPOTHESIS_REPORT,
    JOINT_REPORT,
    MASS_REPORT,
    ROTATION_REPORT,
)

# reports from which findings are made, and the systems whose own are called otherwise than the detector's
_REPORTS = (ROTATION_REPORT, MASS_REPORT, JOINT_REPORT, DETECTOR_REPORT, HYPOTHESIS_REPORT)
_REPORTERS = {"rotation_estimator": "rotation_report", "mass_estimator": "mass_report"}


def build(scenario: Scenario, *, findings: bool = False) -> MassPropertyEstimator:
    """Builds the Drake diagram of a scenario's estimation: from commands and readings to estimates and reports.

    Args:
        scenario: for the vehicle and the settings of the estimators.
        findings: whether it says what the flight has shown so far, which takes some tens of microseconds a sample.

    Ports:
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, 0 to 1, NaN where not
            known.
        outside_wrench (in, 6): known outside forces, see `ImpulseModel`; may stay unconnected.
        <gyro> (in, 3): measured rate, rad/s, body axes, for each package.
        <accelerometer> (in, 3): integrated specific force, ft/s or m/s, body axes, for each package.
        estimate (out, 10), standard_deviation (out, 10), covariance (out, 100), converged (out, 1): see
            `ConvergenceMonitor`.
        impulses (out, 8): see `ImpulseModel`.
        rotation_innovation (out, 3), rotation_innovation_covariance (out, 9), rotation_report (out, 28): see
            `RotationEstimator`.
        mass_innovation (out, 3), mass_innovation_covariance (out, 9), mass_report (out, 11), with an
            accelerometer: see `MassEstimator`.
        reconfiguration (out, 7 + n_jets), closed (out, n_jets), held_closed (out, n_jets),
            detector_report (out, 14 + 4 n_jets), with a detector: see `FailureDetector`.
        record_time (in, 1), command (in, n_jets), held_command_onset (in, n_jets), command_onset (in, n_jets),
            <pose> (in, 7), <velocity> (in, 3), joint_report (out, 3), pose_report (out, 24 + 2 n_jets),
            hypothesis_report (out, 21 + 12 n_jets), fault_probability (out, n_jets + 2), with a filter other than the
            thesis's, which has neither innovations nor their covariances as outputs: see `CycleEstimator`; the inputs
            may stay unconnected.
        failed_jets (out, n_jets), detections (out, abstract), verdict (out, abstract), with `findings`: see
            `FindingsMonitor`; they close no loop.
    """
    return MassPropertyEstimator(scenario, findings=findings)


class MassPropertyEstimator(Diagram):
    """The estimators of a vehicle in one system, ready to be connected.

        estimator = builder.AddSystem(MassPropertyEstimator(load_vehicle("lander")))

    Ports: see `build`. Connect each gyro, each accelerometer and `jet_commands`, then read `estimate`.

    Timing: the outputs at t_k use the readings at t_k, with the commands of [t_k-1, t_k).

    Args:
        vehicle: nominal mass properties, jets and sensors, estimated with the usual settings; or a scenario, whose
            settings are taken.
        name: of the system.
        findings: see `build`.

    Attributes:
        scenario: vehicle and settings, what `simulate` takes.

    Raises:
        InputError: when the vehicle is one that cannot be estimated.
    """

    def __init__(self, vehicle: Vehicle | Scenario, name: str = "estimation", *, findings: bool = True):
        scenario = vehicle if isinstance(vehicle, Scenario) else resolve_scenario({"vehicle": vehicle})
        builder = DiagramBuilder()
        (_add_thesis if scenario.estimation.filter == "thesis" else _add_cycle)(builder, scenario)
        if findings:
            _add_findings(builder, scenario)
        super().__init__(builder, name)
        self.scenario = scenario


def _add_cycle(builder: DiagramBuilder, scenario: Scenario) -> None:
    """Adds a filter and its detector in one system, and exports all ports of it except `predicted`."""
    estimator = builder.AddSystem(
        CycleEstimator(
            params.estimation_params(scenario),
            jets=params.known_jets(scenario),
            gyros=_packages(params.gyros(scenario)),
            accelerometers=_packages(params.accelerometers(scenario)),
            tracked={sensor.name: len(sensor.columns) for sensor in params.non_inertial_sensors(scenario)},
            weighs=params.mass_is_observable(scenario),
            known=params.known_parameters(scenario),
            within=scenario.vehicle_data.has_on_times,
        )
    )
    for index in map(InputPortIndex, range(estimator.num_input_ports())):
        port = estimator.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    export_outputs(builder, (estimator,), but=("predicted",))


def _add_thesis(builder: DiagramBuilder, scenario: Scenario) -> None:
    """Adds the thesis's two filters to the builder, with impulse model before and failure detector between."""
    vehicle = scenario.vehicle_data
    impulses = builder.AddNamedSystem(
        "impulse_model",
        ImpulseModel(
            wrenches=vehicle.wrenches,
            time_constants_s=params.estimator_time_constants(scenario),
            period_s=vehicle.sample_period_s,
            compiled=scenario.execution.compiled,
        ),
    )
    commands = builder.ExportInput(impulses.GetInputPort("jet_commands"), "jet_commands")
    builder.ExportInput(impulses.GetInputPort("outside_wrench"), "outside_wrench")
    builder.ExportOutput(impulses.GetOutputPort("impulses"), "impulses")
    filters = _add_filters(builder, scenario, impulses)
    method = params.detector(scenario)
    if method is not None:
        _add_detector(builder, scenario, method, (impulses, *filters), commands)


def _add_filters(builder: DiagramBuilder, scenario: Scenario, impulses: ImpulseModel) -> tuple[LeafSystem, ...]:
    """Adds the thesis's two filters to the builder and returns them, that with the detector's evidence last."""
    vehicle = scenario.vehicle_data
    filters = params.thesis_params(scenario)
    rotation = builder.AddNamedSystem(
        "rotation_estimator",
        RotationEstimator(
            estimate=filters.estimate[:N_ROTATION],
            covariance=filters.covariance[:N_ROTATION, :N_ROTATION],
            gyros=_packages(params.gyros(scenario)),
            params=filters.rotation,
            thrust_errors=filters.thrust_errors,
            compiled=scenario.execution.compiled,
        ),
    )
    monitor = builder.AddNamedSystem("convergence_monitor", ConvergenceMonitor(params.convergence_limits(scenario)))
    _connect_impulses(builder, impulses, rotation)
    for sensor in vehicle.gyros:
        builder.ExportInput(rotation.GetInputPort(sensor.name), sensor.name)
    for name in ("estimate", "covariance"):
        builder.Connect(rotation.GetOutputPort(name), monitor.GetInputPort(f"rotation_{name}"))
    for name in ("innovation", "innovation_covariance", "report"):
        builder.ExportOutput(rotation.GetOutputPort(name), f"rotation_{name}")
    for name in ("estimate", "standard_deviation", "covariance", "converged"):
        builder.ExportOutput(monitor.GetOutputPort(name), name)
    if filters.mass is None:
        return (rotation,)

    mass = builder.AddNamedSystem(
        "mass_estimator",
        MassEstimator(
            mass_reciprocal=float(filters.estimate[N_ROTATION]),
            variance=float(filters.covariance[N_ROTATION, N_ROTATION]),
            accelerometers=_packages(params.accelerometers(scenario)),
            params=filters.mass,
            thrust_errors=filters.thrust_errors,
            compiled=scenario.execution.compiled,
        ),
    )
    _connect_impulses(builder, impulses, mass)
    for name in ("turning", "predicted_estimate"):
        builder.Connect(rotation.GetOutputPort(name), mass.GetInputPort(name))
    for instrument in vehicle.accelerometers:
        builder.ExportInput(mass.GetInputPort(instrument.name), instrument.name)
    builder.Connect(mass.GetOutputPort("estimate"), monitor.GetInputPort("mass_estimate"))
    for name in ("innovation", "innovation_covariance", "report"):
        builder.ExportOutput(mass.GetOutputPort(name), f"mass_{name}")
    return rotation, mass


def _connect_impulses(builder: DiagramBuilder, impulses: ImpulseModel, system: LeafSystem) -> None:
    """Connects outputs of the impulse model to a filter, with jet levels where it considers thrust errors."""
    for name in ("impulses", "mean_level"):
        if system.HasInputPort(name):
            builder.Connect(impulses.GetOutputPort(name), system.GetInputPort(name))


def _add_detector(
    builder: DiagramBuilder,
    scenario: Scenario,
    method: Detector,
    estimators: tuple[LeafSystem, ...],
    commands: InputPortIndex,
) -> None:
    """Adds the failure detector to the builder, between the filters' innovations and their updates.

    Args:
        builder: of the diagram.
        scenario: for the jets and the detector's block.
        method: of detection.
        estimators: the impulse model, then the filters, the last of which gives the evidence.
        commands: index of the exported port of jet commands.
    """
    impulses, *filters = estimators
    detector = builder.AddNamedSystem(
        "failure_detector",
        FailureDetector(
            method,
            params.detector_params(scenario),
            jets=params.known_jets(scenario),
            compiled=scenario.execution.compiled,
        ),
    )
    builder.ConnectInput(commands, detector.GetInputPort("jet_commands"))
    builder.Connect(impulses.GetOutputPort("impulses"), detector.GetInputPort("impulses"))
    for name in ("evidence", "predicted"):
        builder.Connect(filters[-1].GetOutputPort(name), detector.GetInputPort(name))

    for system in estimators:
        builder.Connect(detector.GetOutputPort("known_force"), system.GetInputPort("known_force"))
    for system in filters:
        builder.Connect(detector.GetOutputPort("adaptation"), system.GetInputPort("adaptation"))
    for name in ("reconfiguration", "closed", "held_closed"):
        builder.ExportOutput(detector.GetOutputPort(name), name)
    builder.ExportOutput(detector.GetOutputPort("report"), "detector_report")


def _add_findings(builder: DiagramBuilder, scenario: Scenario) -> None:
    """Adds the `FindingsMonitor` to the builder, and connects reports of filters and detector to it."""
    found = {}
    for system in builder.GetSystems():
        for index in map(OutputPortIndex, range(system.num_output_ports())):
            port = system.get_output_port(index)
            own = _REPORTERS.get(system.get_name(), "detector_report")
            found[own if port.get_name() == "report" else port.get_name()] = port
    jets = len(scenario.vehicle_data.jets)
    layouts = {layout.name: layout.sized(jets=jets) for layout in _REPORTS if layout.name in found}
    monitor = builder.AddNamedSystem(
        "findings_monitor",
        FindingsMonitor(
            FlightMonitor(scenario.vehicle_data, params.vector_sensor_names(scenario), layouts),
            reports={name: layout.size for name, layout in layouts.items()},
            period_s=scenario.vehicle_data.sample_period_s,
        ),
    )
    for name in layouts:
        builder.Connect(found[name], monitor.GetInputPort(name))
    for name in ("failed_jets", "detections", "verdict"):
        builder.ExportOutput(monitor.GetOutputPort(name), name)


def _packages(sensors: Sequence[SensorPackage]) -> tuple[KnownPackage, ...]:
    return tuple(KnownPackage(sensor.name, sensor.limit) for sensor in sensors)
