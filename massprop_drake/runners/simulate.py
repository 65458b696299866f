"""Simulation of a scenario, through Drake's simulator or by the plain loop."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.errors import InputError, moment
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, N_ROTATION, MassProperties, symmetric_matrix
from massprop_drake.maths.signals import JOINTS, PROPELLANT, is_user_signal
from massprop_drake.maths.vehicle.depletion import OutOfPropellantError
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    POSITION,
    QUATERNION,
    RATE,
    VELOCITY,
    OutOfMassError,
    SpunUpError,
)
from massprop_drake.results.parts import PartsMade
from massprop_drake.results.spool import Spool
from massprop_drake.results.summarize import add_batch_analysis, summarize, summarize_last_estimates
from massprop_drake.results.summary import Findings, RunTiming
from massprop_drake.runners.logs import Intake, estimation_signals, groups_to_json
from massprop_drake.runners.moment import Moment
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram
from massprop_drake.systems.layouts import STRUCTURE

Array = NDArray[np.float64]

CHUNK_S = 5.0  # of simulated time between two reports of progress
BLOCK_ROWS = 1024  # that logs hold, at least, before they are emptied


class Engine(Protocol):
    """Interface of an engine that runs a scenario; all engines give bit-identical results."""

    @property
    def logged(self) -> int:
        """Number of samples logged since the logs were emptied."""

    def advance(self, until_s: float) -> None:
        """Simulates up to a time, s, and logs every sample up to it, that at the time itself included."""

    def take_logs(self) -> dict[str, Array]:
        """Returns logged rows by port, shape (n, size), with their times as time_s, and empties the logs."""

    def snapshot(self) -> Moment:
        """Returns true motion, thrusts, estimates, commands and readings of the last sample, for viewers."""

    def finish(self, *, interrupted: bool = False) -> tuple[Array, Groups]:
        """Completes the last cycle; returns covariance of the ten estimates, shape (10, 10), and the estimators' state.

        Args:
            interrupted: something was raised on the way; its logs have been emptied.
        """

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Computes mean times per cycle of estimators, detector and jet selection, microseconds; None: no such part."""


def needs_diagram(scenario: Scenario) -> bool:
    """Tests whether a scenario has what only Drake's simulator covers, not the plain loop.

    Wheels, burns of engines, bodies and joints, and jets that are prescribed beside an autopilot.
    """
    prescribed = scenario.jet_schedule or scenario.autopilot.test_firing
    beside = bool(prescribed) and not scenario.open_loop
    turned = bool(scenario.vehicle_data.wheels or scenario.engine_schedule)
    return turned or beside or isinstance(scenario.plant, MultibodyBlock)


def _make_engine(scenario: Scenario, diagram: Any, log: Sequence[Any], truth: Mapping[str, Any] | None) -> Engine:
    """Makes the engine that a scenario's `execution` asks for; a diagram of the user's own has Drake's simulator."""
    if log and not hasattr(diagram, "GetMutableSystems"):
        raise InputError("simulate: log takes output ports of systems of a DiagramBuilder, given as diagram")
    if truth is not None and diagram is None:
        raise InputError("simulate: truth names output ports of a diagram of your own, given as diagram")
    if scenario.execution.engine == "loop" and diagram is None and not needs_diagram(scenario):
        from massprop_drake.runners.loop import Loop  # noqa: PLC0415 (each engine loads what it needs)

        return Loop(scenario)
    from massprop_drake.runners.drake_engine import DrakeEngine  # noqa: PLC0415 (loads the whole of Drake's framework)

    return DrakeEngine(scenario, diagram, log, truth)


def simulate(
    scenario: Scenario,
    *,
    diagram: Any = None,
    log: Sequence[Any] = (),
    truth: Mapping[str, Any] | None = None,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Moment], None] | None = None,
    folder: Path | None = None,
    look_back: bool = True,
    keep: Callable[[Run], object] | None = None,
) -> Run:
    """Simulates a scenario, of any length in bounded memory, with its estimation; returns the run.

    The same scenario gives the same run, bit for bit, but for the time it took.

    Args:
        scenario: with hand-controller windows (closed loop) or a jet schedule (open loop).
        diagram: a Drake diagram of your own that flies the scenario, or its `DiagramBuilder`; None: the bundled one.
            It has a `MassPropertyEstimator` or the output ports of one, exported or, in a builder, on its systems, and
            the sample period of the scenario's vehicle. Readings and `command` are output ports of those names or, in
            a builder, whatever feeds the estimator.
        log: output ports of named systems in that builder, kept as signals `<system>.<port>`.
        truth: output ports of that diagram, or their names, by what they truly are: `rate` (3), `attitude` (4),
            `position` and `velocity` of the center of mass in the fixed frame (3 each), `mass_properties` (10) and
            `thrust` (n_jets), as the ports of `diagrams.vehicle` have them. None: `body_state`, `structure` and
            `thrust` of that diagram, if all three are there; without any the run knows no truth.
        progress: called now and then with the simulated time, s.
        watch: called at every sample with what there is to see.
        folder: where a temporary file with the signals of a long run may lie; default the system's place for such.
        look_back: whether the summary says what hindsight shows, `identifiability` and diagnoses in the verdict; where
            it does not, `results.summarize.add_batch_analysis` makes up for it.
        keep: called with the run as far as it has come when something is raised after its first sample, an
            interruption as well; its summary says where and why it ended, and which parts could not be made.

    Raises:
        InputError: when what its `execution` asks for cannot be had; when the vehicle uses up its mass, or a covariance
            loses definiteness by the scenario's numbers, with the time; when a jet is commanded by less than 0 or more
            than 1; or when that file cannot be written.
        ArithmeticError: when the jet selection's solver fails.
    """
    flight = _FlyingRun(scenario, _make_engine(scenario, diagram, log, truth), Intake(scenario, folder))
    try:
        flight.fly(progress, watch)
        return flight.finish_run(PartsMade(strict=True), look_back=look_back)
    except BaseException as error:
        if keep is not None and (kept := flight.finish_early(error)) is not None:
            keep(kept)
        raise


class _FlyingRun:
    """Simulated run in progress.

    Args:
        scenario: to fly.
        engine: what flies it.
        intake: what takes in its signals.
    """

    def __init__(self, scenario: Scenario, engine: Engine, intake: Intake):
        self._scenario, self._engine, self._intake = scenario, engine, intake
        self._intervals = params.sample_count(scenario)
        self._began = time.perf_counter()

    def fly(self, progress: Callable[[float], None] | None, watch: Callable[[Moment], None] | None) -> None:
        """Simulates the flight to its end and spools its signals; arguments as those of `simulate`."""
        engine, period = self._engine, self._scenario.vehicle_data.sample_period_s
        end_s = self._intervals * period
        chunk_s = CHUNK_S if watch is None else period
        with _explain_scenario_errors(self._scenario):
            for number in range(1, math.ceil(end_s / chunk_s - 1e-9) + 1):
                reached_s = min(number * chunk_s, end_s)
                engine.advance(reached_s)
                if watch is not None:
                    watch(engine.snapshot())
                if progress is not None:
                    progress(reached_s)
                # a block of a few rows at the end would take other ways through linear algebra, with other rounding
                if BLOCK_ROWS <= engine.logged <= self._intervals + 1 - self._intake.spool.n_rows - BLOCK_ROWS:
                    self._take_signals()
            self._state = engine.finish()
        self._take_signals()

    def _take_signals(self) -> None:
        """Moves logged rows from the engine to the spool, as signals."""
        self._intake.take(_split_signals(self._scenario, self._engine.take_logs()))

    def finish_run(self, parts: PartsMade, *, look_back: bool) -> Run:
        """Makes the run, with its summary and filter state, from all spooled signals."""
        scenario, intake, signals = self._scenario, self._intake, self._intake.spool
        covariance, groups = self._state
        flown_s, wall_s = float(signals.last("time_s")), time.perf_counter() - self._began
        timing = RunTiming(wall_s, flown_s / wall_s, self._engine.cycle_times(signals.n_rows))
        found = parts.make("detections", intake.findings, Findings())
        results = parts.make(
            "summary", lambda: summarize(scenario, signals, found, covariance, timing, parts), None
        ) or summarize_last_estimates(scenario, signals, timing)
        authority = parts.make("control authority", lambda: _control_authority(scenario, signals), None)
        results = replace(results, autopilot=results.autopilot._replace(control_authority=authority))
        not_commanded = np.full(len(scenario.vehicle_data.jets), np.nan)  # beyond the end
        state: dict[str, Any] = {}
        if groups:
            saved = groups_to_json(groups)
            state = parts.make("filter state", lambda: intake.state(signals.n_rows - 1, saved, not_commanded), state)
        if look_back:
            results = parts.make("hindsight", lambda: add_batch_analysis(results, scenario, signals), results)
        return Run(scenario, replace(results, missing=tuple(parts.missing)), None, signals, state)

    def finish_early(self, error: BaseException) -> Run | None:
        """Makes the run of the samples before an error; None where there is none."""
        parts, signals = PartsMade(), self._intake.spool
        if self._engine.logged:
            parts.make("the last samples", self._take_signals, None)
        if not signals.n_rows:
            return None
        unknown: tuple[Array, Groups] = np.full((10, 10), np.nan), {}
        self._state = parts.make("filter state", lambda: self._engine.finish(interrupted=True), unknown)
        if self._engine.logged:
            parts.make("the last sample", self._take_signals, None)
        run = self.finish_run(parts, look_back=isinstance(error, Exception))
        run.note_end(error, early=signals.n_rows <= self._intervals)
        return run


@contextlib.contextmanager
def _explain_scenario_errors(scenario: Scenario) -> Iterator[None]:
    """Converts, in a with block, numerical errors of a flight into InputErrors with the likely cause."""
    try:
        yield
    except OutOfMassError as error:
        vehicle = scenario.vehicle_data
        unit, when = vehicle.unit_names["mass"], moment(error.time_s)
        if math.isnan(error.wanted):
            raise InputError(
                f"scenario '{scenario.name}': at t = {when} s a command of the jets is NaN; each must be from 0 to 1"
            ) from error
        raise InputError(
            f"scenario '{scenario.name}': at t = {when} s the vehicle runs out of mass: {error.left:.6g} "
            f"{unit} are left, and its jets are about to use {error.wanted:.6g} {unit}; check the mass, and thrust and "
            "specific impulse of the jets, or set plant.depletion to false"
        ) from error
    except OutOfPropellantError as error:
        tank = scenario.vehicle_data.tanks[error.tank]
        raise InputError(
            f"scenario '{scenario.name}': at t = {moment(error.time_s)} s tank '{tank.name}' is empty; put more in it "
            "(propellant of the vehicle's tanks, or plant.propellant), or end the run sooner"
        ) from error
    except SpunUpError as error:
        raise InputError(
            f"scenario '{scenario.name}': at t = {moment(error.time_s)} s the vehicle makes {error.turns:.3g} turns in "
            "a sample, which nothing could follow; check thrust, inertia, failures and initial rate, or end it sooner"
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
            f"{scenario.plant.accuracy:g}; ask for less"
            + (", or leave out plant.time_step for steps of high order" if scenario.plant.kind == "rigid" else "")
        ) from error


def _split_signals(scenario: Scenario, logs: dict[str, Array]) -> dict[str, Array]:
    """Maps names of signals to rows, split from the logged ports of an engine."""
    vehicle = scenario.vehicle_data
    signals = {"time_s": logs["time_s"]} | _true_signals(scenario, logs)
    of_autopilot = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")
    for name in ("command", "command_onset", JOINTS, PROPELLANT, *of_autopilot):
        if name in logs:
            signals[name] = logs[name]
    signals |= estimation_signals(scenario, logs)
    non_inertial = (sensor.name for sensor in true_params.simulated_non_inertial(scenario))
    for name in (*vehicle.sensor_names(), *non_inertial, *filter(is_user_signal, logs)):
        signals[name] = logs[name]
    return signals


def _true_signals(scenario: Scenario, logs: dict[str, Array]) -> dict[str, Array]:
    """Maps names of true signals to rows, as far as the logged ports have them."""
    named = ("rate", "attitude", "position", "velocity", "truth")
    signals: dict[str, Array] = {name: logs[name] for name in named if name in logs}
    if "body_state" in logs:
        body = logs["body_state"]
        parts = {"rate": RATE, "attitude": QUATERNION, "position": POSITION, "velocity": VELOCITY}
        signals = {name: body[:, part] for name, part in parts.items()}
        signals["truth"] = true_parameters(body[:, MASS], logs["structure"])
    if "thrust" in logs:
        signals["thrust"] = logs["thrust"]
        level = logs["thrust"] / np.linalg.norm(scenario.vehicle_data.thrusts, axis=1)
        # row by row: a product's last bit depends on its rows
        wrench = (level[:, np.newaxis] @ scenario.vehicle_data.wrenches)[:, 0]
        torque, signals["force"] = np.hsplit(wrench, 2)
        if "truth" in signals:
            signals["torque"] = torque - np.cross(signals["truth"][:, CENTER_OF_MASS], signals["force"])
    return signals


def true_parameters(mass: Array, structure: Array) -> Array:
    """Computes true ten parameters at each sample, shape (n, 10); one inverse per distinct structure.

    Args:
        mass: slug or kg, shape (n,).
        structure: packed as `rigid_body.STRUCTURE`, a row a sample.
    """
    truth, parts = np.empty((mass.size, 10)), STRUCTURE.columns(structure)
    inertia, center = parts["inertia"], parts["center_of_mass"]
    changes = np.flatnonzero(np.any(np.diff(structure, axis=0) != 0.0, axis=1)) + 1
    for first, last in zip([0, *changes], [*changes, mass.size], strict=True):
        truth[first:last] = MassProperties(1.0, center[first], symmetric_matrix(inertia[first])).vector()
    truth[:, N_ROTATION] = 1.0 / mass
    return truth


def _control_authority(scenario: Scenario, signals: Spool) -> dict[str, Any] | None:
    """Computes the control authority of all selectable jets, and of those left at the end; None: no autopilot.

    It is the largest change of rate and velocity in one second of firing, per axis and direction, by nominal mass
    properties. None without an autopilot.
    """
    if "out_of_use" not in signals:
        return None
    vehicle = scenario.vehicle_data
    usable = params.selectable_jets(scenario)
    available = usable & (signals.last("out_of_use") <= 0.0)
    jet_data = tuple(array.tobytes() for array in (vehicle.wrenches, vehicle.nominal.vector(), vehicle.mass_flows))
    before = dict(_jet_reach(*jet_data, usable.tobytes()))
    return {
        "before": before,
        "after": before if available.sum() == usable.sum() else dict(_jet_reach(*jet_data, available.tobytes())),
    }


@lru_cache(maxsize=64)
def _jet_reach(wrenches: bytes, properties: bytes, mass_flows: bytes, available: bytes) -> dict[str, float]:
    """Maps axis and direction to the largest change of rate or velocity by available jets in 1 s; arrays as bytes."""
    program = JetSelectionProgram(np.frombuffer(mass_flows))
    activity = activity_vectors(np.frombuffer(wrenches).reshape(-1, 6), np.frombuffer(properties))
    limits = np.where(np.frombuffer(available, dtype=np.bool_), 1.0, 0.0)
    return {
        f"{quantity}_{sign}{axis}": program.reach(activity, row, 1.0 if sign == "+" else -1.0, limits)
        for row, (quantity, axis) in enumerate((q, a) for q in ("rotation", "translation") for a in "xyz")
        for sign in "+-"
    }
