"""Runs a scenario through Drake's simulator."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from massprop_drake import settings as make
from massprop_drake.diagrams import closed_loop, open_loop
from massprop_drake.maths import detection, mass_properties
from massprop_drake.maths.jet_selection import activity_vectors
from massprop_drake.maths.mass_properties import N_ROTATION, MassProperties, six_elements, symmetric
from massprop_drake.maths.rigid_body import MASS, POSITION, QUATERNION, RATE, VELOCITY
from massprop_drake.models import digest
from massprop_drake.run import Run
from massprop_drake.scenario import Scenario
from massprop_drake.systems.jet_selection_program import JetSelectionProgram
from massprop_drake.vehicle import Vehicle

Array = NDArray[np.float64]

_LOGGED = (
    "body_state",
    "structure",
    "command",
    "thrust",
    "hand_controllers",
    "attitude_error",
    "request",
    "selection_counts",
    "out_of_use",
    "impulses",
    "rotation_estimate",
    "rotation_standard_deviation",
    "rotation_status",
    "mass_estimate",
    "mass_status",
    "detector_status",
    "detector_likelihood",
    "detector_magnitude",
    "detector_memory",
)
_DETECTOR_STATUS = {
    "tested": 1,
    "alarm": 1,
    "detector_event": 1,
    "suspected_cluster": 1,
    "suspected_jet": 1,
    "jet_isolated": 1,
    "suspected_magnitude": 1,
    "suspected_magnitude_std": 1,
    "suspected_likelihood": 1,
    "cluster_margin": 1,
    "jet_margin": 1,
    "unexplained": 1,
    "onset": 1,
    "alarms": 1,
}
_CHUNK_S = 5.0  # of simulated time between two reports of progress


def simulate(scenario: Scenario, *, progress: Callable[[float], None] | None = None) -> Run:
    """Simulates a scenario from start to end.

    The same scenario gives the same run, bit for bit, but for the time it took.

    Args:
        scenario: with hand-controller windows (closed loop) or a jet schedule (open loop).
        progress: called now and then with the simulated time, s.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness, with the time and the matrix.
        ArithmeticError: when the jet selection's solver fails.
    """
    vehicle = scenario.vehicle_data
    period = vehicle.sample_period_s
    diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario)
    builder = DiagramBuilder()
    builder.AddNamedSystem(diagram.get_name(), diagram)
    names = [name for name in (*_LOGGED, *vehicle.sensor_names()) if diagram.HasOutputPort(name)]
    sinks = {name: LogVectorOutput(diagram.GetOutputPort(name), builder, period) for name in names}
    simulator = Simulator(builder.Build())
    if make.time_step(scenario) == 0.0:
        config = SimulatorConfig(
            integration_scheme=scenario.plant.integrator,
            max_step_size=period,
            accuracy=scenario.plant.accuracy,
            use_error_control=True,
        )
        ApplySimulatorConfig(config, simulator)

    end_s = make.sample_count(scenario) * period
    began = time.perf_counter()
    simulator.Initialize()
    reached = 0.0
    while reached < end_s:
        reached = min(reached + _CHUNK_S, end_s)
        simulator.AdvanceTo(reached)
        if progress is not None:
            progress(reached)
    context = simulator.get_context()
    covariance = _covariance(diagram, diagram.GetMyContextFromRoot(context))
    simulator.AdvancePendingEvents()  # the sample at the end is used like any other
    wall_s = time.perf_counter() - began

    time_s, logs = _collect(sinks, context)
    signals = _signals(scenario, logs)
    summary = _summary(scenario, time_s, signals, covariance, wall_s, diagram)
    return Run(scenario, summary, time_s, signals, covariance)


def _covariance(diagram: Diagram, context: Any) -> Array:
    """Covariance of the ten estimates, shape (10, 10); NaN for the mass where it is not observed."""
    covariance = np.zeros((10, 10))
    rotation = diagram.GetOutputPort("rotation_covariance").Eval(context)
    covariance[:N_ROTATION, :N_ROTATION] = rotation.reshape(N_ROTATION, N_ROTATION)
    covariance[9, 9] = diagram.GetOutputPort("mass_estimate").Eval(context)[1]
    return covariance


def _collect(sinks: dict[str, VectorLogSink], context: Any) -> tuple[Array, dict[str, Array]]:
    logs = {}
    for name, sink in sinks.items():
        log = sink.FindLog(context)
        logs[name] = np.array(log.data().T)  # a copy: the log's own memory goes with it
        times = np.array(log.sample_times())
    return times, logs


def _signals(scenario: Scenario, logs: dict[str, Array]) -> dict[str, Array]:
    """The logged ports taken apart into named signals."""
    vehicle = scenario.vehicle_data
    body, structure = logs["body_state"], logs["structure"]
    signals = {
        "rate": body[:, RATE],
        "attitude": body[:, QUATERNION],
        "position": body[:, POSITION],
        "velocity": body[:, VELOCITY],
        "truth": _truth(body[:, MASS], structure),
        "command": logs["command"],
        "thrust": logs["thrust"],
    }
    level = logs["thrust"] / np.linalg.norm(vehicle.thrusts, axis=1)
    wrench = level @ vehicle.wrenches
    signals["force"] = wrench[:, 3:]
    signals["torque"] = wrench[:, :3] - np.cross(structure[:, 6:], wrench[:, 3:])
    for name in ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use"):
        if name in logs:
            signals[name] = logs[name]
    signals |= _parts(logs["impulses"], angular_impulse=3, linear_impulse=3, usable=1, firing=1)
    signals["estimate"] = np.hstack([logs["rotation_estimate"], logs["mass_estimate"][:, :1]])
    deviation = np.sqrt(logs["mass_estimate"][:, 1:])
    signals["standard_deviation"] = np.hstack([logs["rotation_standard_deviation"], deviation])
    limits = make.convergence_limits(scenario)
    signals["converged"] = np.array(
        [
            [float(mass_properties.converged(deviation, estimate, limits))]
            for deviation, estimate in zip(signals["standard_deviation"], signals["estimate"], strict=True)
        ]
    )
    signals |= _parts(
        logs["rotation_status"],
        rotation_innovation=3,
        rotation_nis=1,
        rotation_used=1,
        rotation_jump=1,
        coupling_subtracted=1,
    )
    signals |= _parts(logs["mass_status"], mass_innovation=3, mass_nis=1, mass_used=1, mass_jump=1)
    if "detector_status" in logs:
        signals |= _parts(logs["detector_status"], **_DETECTOR_STATUS)
        signals["likelihood"] = logs["detector_likelihood"]
        signals["failure_magnitude"] = logs["detector_magnitude"]
        n_jets = len(vehicle.jets)
        signals |= _parts(logs["detector_memory"][:, 4:], known_force=n_jets, known_force_variance=n_jets)
    for name in vehicle.sensor_names():
        signals[name] = logs[name]
    return signals


def _parts(log: Array, **sizes: int) -> dict[str, Array]:
    edges = np.cumsum([0, *sizes.values()])
    return {name: log[:, start:end] for name, start, end in zip(sizes, edges, edges[1:], strict=False)}


def _truth(mass: Array, structure: Array) -> Array:
    """True ten parameters at each sample; the inverse is taken once per distinct structure."""
    truth = np.empty((mass.size, 10))
    changes = np.flatnonzero(np.any(np.diff(structure, axis=0) != 0.0, axis=1)) + 1
    for first, last in zip([0, *changes], [*changes, mass.size], strict=True):
        properties = MassProperties(1.0, structure[first, 6:], symmetric(structure[first, :6]))
        truth[first:last] = properties.vector()
    truth[:, 9] = 1.0 / mass
    return truth


def _summary(
    scenario: Scenario,
    time_s: Array,
    signals: dict[str, Array],
    covariance: Array,
    wall_s: float,
    diagram: Diagram,
) -> dict[str, Any]:
    vehicle = scenario.vehicle_data
    estimate, truth = signals["estimate"][-1], signals["truth"][-1]
    used, mass_used = signals["rotation_used"][:, 0] != 0.0, signals["mass_used"][:, 0] != 0.0
    commands = signals["command"][:-1] > 0.0
    return {
        "format": 1,
        "version": version("massprop-drake"),
        "scenario": scenario.name,
        "vehicle": vehicle.name,
        "units": vehicle.units,
        "seed": scenario.seed,
        "duration_s": float(time_s[-1]),
        "estimates": by_name(estimate),
        "standard_deviations": by_name(signals["standard_deviation"][-1]),
        "covariance": covariance.tolist(),
        "derived": _derived(estimate, covariance),
        "truth": by_name(truth),
        "percent_error": by_name(mass_properties.percent_error(estimate, truth)),
        "detections": detections(vehicle, time_s, signals),
        "consistency": {
            "rotation_nis_mean": _mean(signals["rotation_nis"][used, 0]),
            "translation_nis_mean": _mean(signals["mass_nis"][mass_used, 0]),
            "samples": int(used.sum()),
        },
        "autopilot": {
            "firings": int(firings(commands)),
            "propellant_mass": _propellant(scenario, signals),
            **_selection(signals),
            "control_authority": _authority(scenario, signals),
        },
        "provenance": {
            "drake": version("drake"),
            "numpy": version("numpy"),
            "vehicle_sha256": digest(vehicle),
            "scenario_sha256": digest(scenario),
        },
        "timing": {
            "wall_s": wall_s,
            "real_time_factor": float(time_s[-1]) / wall_s,
            "cycle_us": _cycle_times(diagram, len(time_s)),
        },
    }


def detections(vehicle: Vehicle, time_s: Array, signals: dict[str, Array]) -> list[dict[str, Any]]:
    """One entry per declared failure or jump, as `summary.json` has them."""
    if "detector_event" not in signals:
        return []
    entries: list[dict[str, Any]] = []
    for k in np.flatnonzero(signals["detector_event"][:, 0]):
        at = {name: float(signals[name][k, 0]) for name in _DETECTOR_STATUS}
        jet = int(at["suspected_jet"])
        event = int(at["detector_event"])
        if event == detection.WITHDRAWN:
            for entry in entries:
                if entry["jet_index"] == jet and entry["withdrawn_s"] is None:
                    entry["withdrawn_s"] = float(time_s[k])
            continue
        entry = {
            "onset_s": at["onset"],
            "time_s": float(time_s[k]),
            "kind": "mass_property_jump",
            "cluster": None,
            "jet": None,
            "isolated_to": None,
            "magnitude": None,
            "magnitude_std": None,
            "statistic": float(signals["rotation_nis"][k, 0]),
            "alarms": int(at["alarms"]),
            "withdrawn_s": None,
            "jet_index": None,
        }
        if event == detection.DECLARED:
            magnitude, std = at["suspected_magnitude"], at["suspected_magnitude_std"]
            isolated = bool(at["jet_isolated"])
            entry |= {
                "kind": _kind(magnitude, std, vehicle.jets[jet].thrust),
                "cluster": vehicle.jets[jet].cluster,
                "jet": vehicle.designations[jet] if isolated else None,
                "isolated_to": "jet" if isolated else "cluster",
                "magnitude": magnitude,
                "magnitude_std": std,
                "statistic": at["suspected_likelihood"],
                "jet_index": jet,
            }
        entries.append(entry)
    for entry in entries:
        jet = entry.pop("jet_index")
        if entry["kind"] == "jet_on" and signals["known_force_variance"][-1, jet] > 0.0:
            entry["magnitude"] = float(signals["known_force"][-1, jet])
            entry["magnitude_std"] = float(np.sqrt(signals["known_force_variance"][-1, jet]))
    return entries


def _kind(magnitude: float, std: float, thrust: float) -> str:
    if magnitude > 0.0:
        return "jet_on"
    lost_all = -magnitude > 0.9 * thrust or abs(magnitude + thrust) < 3.0 * std
    return "jet_off" if lost_all else "jet_degraded"


def by_name(parameters: Array) -> dict[str, Any]:
    """Ten parameters as files have them: matrix, vector and number; NaN becomes null."""
    values = [None if np.isnan(value) else float(value) for value in parameters]
    matrix = [[values[index] for index in row] for row in mass_properties.ELEMENT.tolist()]
    return {"inverse_inertia": matrix, "center_of_mass": values[6:9], "mass_reciprocal": values[9]}


def from_names(values: dict[str, Any]) -> Array:
    """The inverse of `by_name`: ten parameters, null as NaN, shape (10,)."""
    inverse = np.array(values["inverse_inertia"], dtype=float)
    center = np.array(values["center_of_mass"], dtype=float)
    reciprocal = np.array([values["mass_reciprocal"]], dtype=float)
    return np.concatenate([six_elements(inverse), center, reciprocal])


def _derived(estimate: Array, covariance: Array) -> dict[str, Any]:
    derived = mass_properties.derived(estimate, covariance)
    return {
        "mass": derived.mass,
        "mass_std": derived.mass_std,
        "inertia": None if derived.inertia is None else derived.inertia.tolist(),
        "inertia_std": None if derived.inertia_std is None else derived.inertia_std.tolist(),
        "physically_possible": derived.physically_possible,
    }


def firings(commands: NDArray[np.bool_]) -> int:
    """Number of off-to-on transitions over all jets, shape (n_samples, n_jets)."""
    before = np.vstack([np.zeros((1, commands.shape[1]), dtype=bool), commands[:-1]])
    return int((commands & ~before).sum())


def _propellant(scenario: Scenario, signals: dict[str, Array]) -> float:
    """Propellant used, slug or kg: what the thrust of every sample took."""
    vehicle = scenario.vehicle_data
    level = signals["thrust"][:-1] / np.linalg.norm(vehicle.thrusts, axis=1)
    return float((level @ make.plant_wrenches(scenario)[:, 6]).sum() * vehicle.sample_period_s)


def _authority(scenario: Scenario, signals: dict[str, Array]) -> dict[str, Any] | None:
    """Largest change of rate and velocity in one second of firing, per axis and direction, by nominal mass
    properties: with all selectable jets, and with those left at the end. None without an autopilot.
    """
    if "out_of_use" not in signals:
        return None
    vehicle = scenario.vehicle_data
    program = JetSelectionProgram(vehicle.mass_flows)
    activity = activity_vectors(vehicle.wrenches, vehicle.nominal.vector())
    left = make.selectable(scenario) & (signals["out_of_use"][-1] == 0.0)

    def reach(available: NDArray[np.bool_]) -> dict[str, float]:
        limits = np.where(available, 1.0, 0.0)
        return {
            f"{quantity}_{sign}{axis}": program.reach(activity, row, 1.0 if sign == "+" else -1.0, limits)
            for row, (quantity, axis) in enumerate((q, a) for q in ("rotation", "translation") for a in "xyz")
            for sign in "+-"
        }

    before = reach(make.selectable(scenario))
    return {"before": before, "after": before if left.sum() == make.selectable(scenario).sum() else reach(left)}


def _selection(signals: dict[str, Array]) -> dict[str, int | None]:
    if "selection_counts" not in signals:
        return {"lp_solves": None, "lp_infeasible": None}
    solved, reduced, closest, _ = signals["selection_counts"][-1].tolist()
    return {"lp_solves": int(solved), "lp_infeasible": int(reduced + closest)}


def _mean(values: Array) -> float | None:
    return float(values.mean()) if values.size else None


def _cycle_times(diagram: Diagram, cycles: int) -> dict[str, float | None]:
    """Mean time per cycle spent in the mathematics of each part, microseconds."""
    estimation = diagram.GetSubsystemByName("estimation")
    names = [system.get_name() for system in estimation.GetSystems()]
    estimators = [name for name in ("impulse_model", "rotation_estimator", "mass_estimator") if name in names]
    spent = sum(estimation.GetSubsystemByName(name).stopwatch.spent_s for name in estimators)
    selection = detector = None
    if diagram.HasSubsystemNamed("autopilot"):
        autopilot = diagram.GetSubsystemByName("autopilot")
        selection = 1e6 * autopilot.GetSubsystemByName("jet_selection").stopwatch.spent_s / cycles
    if "failure_detector" in names:
        detector = 1e6 * estimation.GetSubsystemByName("failure_detector").stopwatch.spent_s / cycles
    return {"estimators": 1e6 * spent / cycles, "detector": detector, "jet_selection": selection}
