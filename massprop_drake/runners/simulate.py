"""Runs a scenario through Drake's simulator."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from massprop_drake.diagrams import closed_loop, open_loop
from massprop_drake.errors import InputError
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import N_ROTATION, MassProperties, symmetric
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    POSITION,
    QUATERNION,
    RATE,
    VELOCITY,
    OutOfMassError,
    SpunUpError,
)
from massprop_drake.results.run import Run
from massprop_drake.results.spool import Spool
from massprop_drake.results.summary import Timing, summarize
from massprop_drake.runners.logs import ESTIMATION, Intake, estimation_signals, for_json, state_groups
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram
from massprop_drake.systems.layouts import RECONFIGURATION, STRUCTURE

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
    *ESTIMATION,
)
_CHUNK_S = 5.0  # of simulated time between two reports of progress
_BLOCK_ROWS = 1024  # that logs hold, at least, before they are emptied


class Moment(NamedTuple):
    """A simulation at one sample, for those who watch it.

    Attributes:
        time_s: of the sample, s.
        attitude: q_NB, shape (4,).
        center_of_mass: the true one, vehicle frame, ft or m, shape (3,).
        thrust: mean force of each jet over the coming sample, lbf or N, shape (n_jets,).
        estimate, standard_deviation: of the ten parameters, shape (10,) each.
        removed: jets taken out of use, boolean, shape (n_jets,).
    """

    time_s: float
    attitude: Array
    center_of_mass: Array
    thrust: Array
    estimate: Array
    standard_deviation: Array
    removed: NDArray[np.bool_]


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Moment], None] | None = None,
    folder: Path | None = None,
) -> Run:
    """Simulates a scenario from start to end, of any length in bounded memory.

    The same scenario gives the same run, bit for bit, but for the time it took.

    Args:
        scenario: with hand-controller windows (closed loop) or a jet schedule (open loop).
        progress: called now and then with the simulated time, s.
        watch: called at every sample with what there is to see.
        folder: where a temporary file with the signals of a long run may lie; default the system's place for such.

    Raises:
        InputError: when the vehicle uses up its mass, or a covariance loses definiteness by the scenario's numbers,
            with the time; or when that file cannot be written.
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
    if params.time_step(scenario) == 0.0:
        config = SimulatorConfig(
            integration_scheme=scenario.plant.integrator,
            max_step_size=period,
            accuracy=scenario.plant.accuracy,
            use_error_control=True,
        )
        ApplySimulatorConfig(config, simulator)

    intake = Intake(scenario, folder)
    intervals = params.sample_count(scenario)
    end_s = intervals * period
    root = simulator.get_mutable_context()
    began = time.perf_counter()
    chunk_s = _CHUNK_S if watch is None else period
    with _scenario_to_blame(scenario):
        simulator.Initialize()
        for number in range(1, math.ceil(end_s / chunk_s - 1e-9) + 1):
            reached = min(number * chunk_s, end_s)
            simulator.AdvanceTo(reached)
            if watch is not None:
                watch(_moment(diagram, diagram.GetMyContextFromRoot(simulator.get_context())))
            if progress is not None:
                progress(reached)
            logged = sinks["command"].FindLog(root).num_samples()
            # a block of a few rows at the end would take other ways through linear algebra, with other rounding
            if _BLOCK_ROWS <= logged <= intervals + 1 - intake.spool.n_rows - _BLOCK_ROWS:
                intake.take(_emptied(scenario, sinks, root))
        own = diagram.GetMyContextFromRoot(root)
        covariance = diagram.GetOutputPort("covariance").Eval(own).reshape(10, 10)
        simulator.AdvancePendingEvents()  # the sample at the end is used like any other
    intake.take(_emptied(scenario, sinks, root))
    wall_s = time.perf_counter() - began

    signals = intake.spool
    timing = Timing(wall_s, end_s / wall_s, _cycle_times(diagram, signals.n_rows))
    results = summarize(scenario, signals, intake.found(), covariance, timing, _authority(scenario, signals))
    not_commanded = np.full(len(vehicle.jets), np.nan)  # beyond the end
    state = intake.state(signals.n_rows - 1, for_json(state_groups(diagram, root)), not_commanded)
    return Run(scenario, results, None, signals, state)


@contextlib.contextmanager
def _scenario_to_blame(scenario: Scenario) -> Iterator[None]:
    """Turns what only the numbers of a scenario can bring about into the message that says so."""
    try:
        yield
    except OutOfMassError as error:
        vehicle = scenario.vehicle_data
        unit = vehicle.unit_names["mass"]
        raise InputError(
            f"scenario '{scenario.name}': at t = {error.time_s:.6g} s the vehicle runs out of mass: {error.left:.6g} "
            f"{unit} are left, and its jets are about to use {error.wanted:.6g} {unit}; check the mass, and thrust and "
            "specific impulse of the jets, or set plant.depletion to false"
        ) from error
    except SpunUpError as error:
        raise InputError(
            f"scenario '{scenario.name}': at t = {error.time_s:.6g} s the vehicle makes {error.turns:.3g} turns in a "
            "sample, which nothing could follow; check thrust, inertia, failures and initial rate, or end it sooner"
        ) from error
    except NotPositiveDefiniteError as error:
        raise InputError(
            f"scenario '{scenario.name}': the filters cannot go on: {error.headline}; check quantum and noise of the "
            "sensors and the uncertainty at the start: both must be such that double precision holds their squares "
            "side by side"
        ) from error
    except RuntimeError as error:
        if "smaller than minimum allowed" not in str(error):
            raise
        raise InputError(
            f"scenario '{scenario.name}': plant.accuracy: the continuous plant cannot be integrated to "
            f"{scenario.plant.accuracy:g}; ask for less, or leave out plant.time_step for steps of high order"
        ) from error


def _moment(diagram: Diagram, context: Any) -> Moment:
    """What there is to see at this sample."""

    def output(name: str) -> Array:
        return diagram.GetOutputPort(name).Eval(context)

    thrust = output("thrust")
    removed = np.zeros(thrust.size, dtype=bool)
    if diagram.HasOutputPort("reconfiguration"):
        removed = RECONFIGURATION.sized(jets=thrust.size).read(output("reconfiguration")).removed != 0.0
    return Moment(
        context.get_time(),
        output("body_state")[QUATERNION],
        STRUCTURE.read(output("structure")).center_of_mass,
        thrust,
        output("estimate"),
        output("standard_deviation"),
        removed,
    )


def _emptied(scenario: Scenario, sinks: dict[str, VectorLogSink], root: Any) -> dict[str, Array]:
    """Takes what has been logged out of the logs; the signals that it holds, with their times."""
    logs = {}
    for name, sink in sinks.items():
        log = sink.FindMutableLog(root)
        logs[name] = np.array(log.data().T)  # a copy: the log goes on in its memory
        times = np.array(log.sample_times())
        log.Clear()
    return {"time_s": times, **_signals(scenario, logs)}


def _signals(scenario: Scenario, logs: dict[str, Array]) -> dict[str, Array]:
    """The logged ports taken apart into named signals."""
    vehicle = scenario.vehicle_data
    body, structure = logs["body_state"], STRUCTURE.columns(logs["structure"])
    signals = {
        "rate": body[:, RATE],
        "attitude": body[:, QUATERNION],
        "position": body[:, POSITION],
        "velocity": body[:, VELOCITY],
        "truth": _truth(body[:, MASS], logs["structure"]),
        "command": logs["command"],
        "thrust": logs["thrust"],
    }
    level = logs["thrust"] / np.linalg.norm(vehicle.thrusts, axis=1)
    torque, signals["force"] = np.hsplit(level @ vehicle.wrenches, 2)
    signals["torque"] = torque - np.cross(structure["center_of_mass"], signals["force"])
    for name in ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use"):
        if name in logs:
            signals[name] = logs[name]
    signals |= estimation_signals(scenario, logs)
    for name in vehicle.sensor_names():
        signals[name] = logs[name]
    return signals


def _truth(mass: Array, structure: Array) -> Array:
    """True ten parameters at each sample; the inverse is taken once per distinct structure."""
    truth, parts = np.empty((mass.size, 10)), STRUCTURE.columns(structure)
    inertia, center = parts["inertia"], parts["center_of_mass"]
    changes = np.flatnonzero(np.any(np.diff(structure, axis=0) != 0.0, axis=1)) + 1
    for first, last in zip([0, *changes], [*changes, mass.size], strict=True):
        truth[first:last] = MassProperties(1.0, center[first], symmetric(inertia[first])).vector()
    truth[:, N_ROTATION] = 1.0 / mass
    return truth


def _cycle_times(diagram: Any, cycles: int) -> dict[str, float | None]:
    """Mean time per cycle spent in the mathematics of each part, microseconds."""
    estimation = diagram.GetSubsystemByName("estimation")
    spent = {
        system.get_name(): 1e6 * system.stopwatch.spent_s / cycles
        for system in estimation.GetSystems()
        if hasattr(system, "stopwatch")
    }
    detector = next((spent.pop(name) for name in ("failure_detector", "hypothesis_detector") if name in spent), None)
    selection = None
    if diagram.HasSubsystemNamed("autopilot"):
        autopilot = diagram.GetSubsystemByName("autopilot")
        selection = 1e6 * autopilot.GetSubsystemByName("jet_selection").stopwatch.spent_s / cycles
    return {"estimators": sum(spent.values()), "detector": detector, "jet_selection": selection}


def _authority(scenario: Scenario, signals: Spool) -> dict[str, Any] | None:
    """Largest change of rate and velocity in one second of firing, per axis and direction, by nominal mass
    properties: with all selectable jets, and with those left at the end. None without an autopilot.
    """
    if "out_of_use" not in signals:
        return None
    vehicle = scenario.vehicle_data
    program = JetSelectionProgram(vehicle.mass_flows)
    activity = activity_vectors(vehicle.wrenches, vehicle.nominal.vector())
    left = params.selectable(scenario) & (signals.last("out_of_use") <= 0.0)

    def reach(available: NDArray[np.bool_]) -> dict[str, float]:
        limits = np.where(available, 1.0, 0.0)
        return {
            f"{quantity}_{sign}{axis}": program.reach(activity, row, 1.0 if sign == "+" else -1.0, limits)
            for row, (quantity, axis) in enumerate((q, a) for q in ("rotation", "translation") for a in "xyz")
            for sign in "+-"
        }

    before = reach(params.selectable(scenario))
    return {"before": before, "after": before if left.sum() == params.selectable(scenario).sum() else reach(left)}
