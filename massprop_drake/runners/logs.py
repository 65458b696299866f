"""Logs of the estimators as signals, and their state for files.

The same for simulated runs, for recorded telemetry and for the estimator in real time.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs import params
from massprop_drake.inputs.params import mass_is_observable
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.results.detections import (
    DetectionRecord,
    bound_jump_times,
    finalize_detections,
    note_mass_before_jumps,
    update_detections,
)
from massprop_drake.results.events import EventRecord, list_events
from massprop_drake.results.fault_probabilities import final_probabilities
from massprop_drake.results.json_arrays import null_for_nan
from massprop_drake.results.spool import Spool
from massprop_drake.results.stored import FORMAT, FilterState, state_origin
from massprop_drake.results.summary import Findings
from massprop_drake.results.unconfirmed import Suspicions
from massprop_drake.systems.layouts import (
    DETECTOR_REPORT,
    HYPOTHESIS_REPORT,
    IMPULSES,
    MASS_REPORT,
    ROTATION_REPORT,
    detector_row,
    impulse_row,
)

Array = NDArray[np.float64]
SavedState = Mapping[str, Sequence[Sequence[float | None]]]  # vectors by the part of the diagram, NaN as None

# ports of the estimation diagram that are logged, where it has them
ESTIMATION = (
    *("impulses", "rotation_report", "mass_report", "joint_report", "pose_report"),
    *("detector_report", "hypothesis_report"),
)
_STEP = 5.0  # 1-sigma of the difference of two readings: what moves farther has been moved
RECENT = 256  # rows whose times a run keeps for the part that goes on from it


def estimation_signals(scenario: Scenario, logs: Mapping[str, Array]) -> dict[str, Array]:
    """Maps names of signals to rows, shape (n, size), split from the logged ports of the estimation.

    Args:
        scenario: for the number of jets and the limits of convergence.
        logs: by port, a row per sample.
    """
    signals = IMPULSES.columns(logs["impulses"])
    rotation = ROTATION_REPORT.columns(logs["rotation_report"])
    has_mass = "mass_report" in logs
    mass_rows = logs["mass_report"] if has_mass else np.full((logs["impulses"].shape[0], MASS_REPORT.size), np.nan)
    mass = MASS_REPORT.columns(mass_rows)
    signals["estimate"] = np.hstack([rotation.pop("estimate"), mass.pop("mass_reciprocal")])
    signals["standard_deviation"] = np.hstack([rotation.pop("standard_deviation"), np.sqrt(mass.pop("variance"))])
    limits = params.convergence_limits(scenario)
    known = params.known_parameters(scenario)
    converged = mass_properties.are_converged(signals["standard_deviation"], signals["estimate"], limits, known)
    signals["converged"] = converged.astype(float)[:, None]
    signals |= rotation
    if has_mass:
        signals |= mass
    layout = FILTERS[scenario.estimation.filter].report
    if layout is not None and layout.name in logs:
        signals |= layout.sized(jets=len(scenario.vehicle_data.jets)).columns(logs[layout.name])
    if "detector_report" in logs:
        jets = len(scenario.vehicle_data.jets)
        signals |= DETECTOR_REPORT.sized(jets=jets).columns(logs["detector_report"])
        if "hypothesis_report" in logs:
            signals |= HYPOTHESIS_REPORT.sized(jets=jets).columns(logs["hypothesis_report"])
    return signals


class EstimationLog:
    """Rows of the estimation diagram's ports, logged by cycles that run without a diagram.

    Args:
        scenario: for jets and sensors.
        params: of the cycle.
        n_rows: number of rows.

    Attributes:
        rows: by port, shape (count, its size).
    """

    def __init__(self, scenario: Scenario, params: EstimationParams, n_rows: int):
        jets = len(scenario.vehicle_data.jets)
        self._own = params.filter.report and params.filter.report.sized(jets=jets)
        self._detector = params.detector
        self._said = params.detector and params.detector.report and params.detector.report.sized(jets=jets)
        layouts = [IMPULSES, ROTATION_REPORT]
        if mass_is_observable(scenario):
            layouts.append(MASS_REPORT)
        if self._own is not None:
            layouts.append(self._own)
        self._judged = DETECTOR_REPORT.sized(jets=jets)
        if self._detector is not None:
            layouts += [self._judged, *([self._said] if self._said else [])]
        self.rows = {layout.name: np.empty((n_rows, layout.size)) for layout in layouts}

    def put(self, row: int, step: EstimationStep, detector_before: Any) -> None:
        """Writes the reports of an estimation cycle into a row of the log.

        Args:
            row: of the row.
            step: the cycle.
            detector_before: state of the detector before it.
        """
        rows, filtered, judgment = self.rows, step.filtered, step.judgment
        rows["impulses"][row] = impulse_row(step.interval.impulses)
        rows["rotation_report"][row] = ROTATION_REPORT.pack(filtered.rotation)
        if filtered.mass is not None:
            rows["mass_report"][row] = MASS_REPORT.pack(filtered.mass)
        if self._own is not None:
            rows[self._own.name][row] = self._own.pack(filtered.own)
        if judgment is not None:
            rows["detector_report"][row] = detector_row(judgment, detector_before, self._judged)
            if self._said is not None:
                rows[self._said.name][row] = self._said.pack(judgment.own)

    def reports(self, row: int) -> tuple[Any, Any, Any]:
        """Returns the reports of rotation filter, mass filter and detector in a row; None where there is none."""
        rows = self.rows
        mass = MASS_REPORT.read(rows["mass_report"][row]) if "mass_report" in rows else None
        status = None if self._detector is None else self._judged.read(rows["detector_report"][row])
        return ROTATION_REPORT.read(rows["rotation_report"][row]), mass, status

    def estimate_and_deviation(self, row: int) -> tuple[Array, Array]:
        """Returns estimate and 1-sigma of the ten parameters in a row, NaN if not observed, shape (10,) each."""
        rotation, mass, _ = self.reports(row)
        reciprocal, variance = (math.nan, math.nan) if mass is None else (mass.mass_reciprocal, mass.variance)
        return (
            mass_properties.join_ten_parameters(rotation.estimate, reciprocal),
            mass_properties.join_ten_parameters(rotation.standard_deviation, np.sqrt(variance)),
        )


class Intake:
    """Spools the signals of a run block by block, and collects its events and detections.

    Args:
        scenario: as run.
        folder: for the spool; default the system's place for such.
        earlier: state at the end of the run that this one goes on from.

    Attributes:
        spool: all signals so far, with `time_s`.
        recent_s: times of the last rows, s, at most `RECENT`.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path | None = None,
        earlier: FilterState | None = None,
    ):
        self.spool = Spool(folder, index="time_s")
        self.recent_s = np.array(() if earlier is None else earlier.recent_s, dtype=float)
        self._scenario, self._vehicle = scenario, scenario.vehicle_data
        self._sensors = params.vector_sensor_names(scenario)
        self._entries: list[DetectionRecord] = [] if earlier is None else list(earlier.detections)
        self._events: list[EventRecord] = [] if earlier is None else list(earlier.events)
        suspected = ((), ()) if earlier is None else (earlier.unconfirmed, earlier.commanded)
        self._suspicions = Suspicions(scenario, *suspected)
        self._last_mass = np.full((1, 3), np.nan)  # time, 1/m and its 1-sigma of the row before the block

    def take(self, signals: Mapping[str, Array]) -> tuple[list[EventRecord], list[DetectionRecord]]:
        """Spools a block of signals; returns the block's events, and the detections that are new with it.

        Args:
            signals: by name, shape (n, components), and `time_s`, shape (n,).
        """
        self.spool.append(signals)
        time_s = signals["time_s"]
        self.recent_s = np.concatenate([self.recent_s, time_s])[-RECENT:]
        events = list_events(self._vehicle, self._sensors, time_s, signals, self._events)
        known = len(self._entries)
        self._entries = update_detections(self._vehicle, events, self._entries)
        if "verdict" not in signals:
            names = ("estimate", "standard_deviation")
            mass = np.column_stack((time_s, *(signals[name][:, MASS_RECIPROCAL] for name in names)))
            mass = np.vstack([self._last_mass, mass])
            self._entries, self._last_mass = note_mass_before_jumps(self._entries, *mass.T), mass[-1:]
        self._events += events
        self._suspicions.add(time_s, signals, events)
        return events, self._entries[known:]

    def last(self, name: str, default: Array) -> Array:
        """Returns the last row of a spooled signal, or a substitute where the run has no such signal."""
        return self.spool.last(name) if name in self.spool else default

    def findings(self) -> Findings:
        """Makes detections, events, suspicions and fault probabilities at the end of the run."""
        none = np.zeros(len(self._vehicle.jets))
        forces = self.last("known_force", none), self.last("known_force_variance", none)
        mass = tuple(float(self.spool.last(name)[MASS_RECIPROCAL]) for name in ("estimate", "standard_deviation"))
        steps = {
            package.name: _STEP * math.sqrt(2.0 * package.variance) + package.quantum
            for package in (*params.gyros(self._scenario), *params.accelerometers(self._scenario))
            if package.name in self.spool
        }
        records: Sequence[DetectionRecord] = self._entries
        if "verdict" in self.spool:
            records = bound_jump_times(records, self.spool.blocks("time_s", "command", "alarm", *steps), steps)
        entries = finalize_detections(records, *forces, *mass)
        return Findings(
            entries,
            tuple(event._replace(jet_index=None) for event in self._events),
            self._suspicions.list_records(),
            self._suspicions.untested([entry.jet for entry in entries if entry.withdrawn_s is None]),
            final_probabilities(self._vehicle, self.spool),
        )

    def state(self, row: int, states: SavedState, command: Array) -> dict[str, Any]:
        """Returns the JSON data of `filter_state.json`, from which a later run goes on.

        Args:
            row: number of the last row.
            states: of the estimators, after it.
            command: from it on, NaN where none is known, shape (n_jets,).
        """
        return {
            "format": FORMAT,
            "made_with": state_origin(self._scenario),
            "time_s": float(self.spool.last("time_s")),
            "row": row,
            "states": states,
            "command": null_for_nan(command),
            "recent_s": null_for_nan(self.recent_s),
            "detections": [entry._asdict() for entry in self._entries],
            "events": [event._asdict() for event in self._events],
            "unconfirmed": [one._asdict() for one in self._suspicions.list_records()],
            "commanded": self._suspicions.counts,
        }


# --------------------------------------------------------------------------------------- kept states


def state_groups(diagram: Any, context: Any) -> Groups:
    """Maps systems of the estimation diagram to their discrete state vectors, read from the root context."""
    groups: dict[str, Array] = {}
    for system in diagram.GetSystems():
        if not getattr(system, "is_resumed", True):
            continue
        system_context = system.GetMyContextFromRoot(context)
        state = system_context.get_discrete_state()
        if hasattr(system, "pack_state"):  # filter and detector in one, whose state is no vector
            groups |= system.pack_state(system_context)
        elif state.num_groups():  # a system of the estimators keeps one vector
            groups[system.get_name()] = state.get_vector(0).CopyToVector()
    return groups


def state_to_json(state: EstimationState, params: EstimationParams) -> SavedState:
    """Converts the state of filter and detector to JSON data for `filter_state.json`."""
    return groups_to_json(cycle.save_state(state, params))


def state_from_json(states: SavedState, params: EstimationParams, source: str) -> EstimationState:
    """Restores the state of filter and detector from JSON data: the inverse of `state_to_json`.

    Raises:
        InputError: when they are of other parameters, or no run can have left them.
    """
    template = cycle.save_state(cycle.initial_state(params), params)
    detector = params.detector
    growing_groups = {params.filter.growing, detector.group if detector is not None and detector.layout is None else ""}
    groups = groups_from_json(states, template, source, growing_groups)
    try:
        return cycle.restore_state(groups, params)
    except ValueError as error:
        raise InputError(f"{source}: states: {error}; it was not written by a run") from None


def groups_to_json(groups: Groups) -> SavedState:
    """Converts state vectors by name to JSON data, NaN as null."""
    return {name: [null_for_nan(vector)] for name, vector in groups.items()}


def groups_from_json(states: SavedState, template: Groups, source: str, growing_groups: Collection[str] = ()) -> Groups:
    """Converts JSON data to state vectors by name: the inverse of `groups_to_json`; version 0.1 has them in pieces.

    Args:
        states: as a file has them.
        template: a state of the same parameters, for the sizes.
        source: where they come from, for messages.
        growing_groups: parts that may have more numbers than there.

    Raises:
        InputError: when they are of another vehicle or other settings.
    """
    for name in sorted(set(template) | set(states)):
        saved = sum(map(len, states.get(name, ())))
        size = template[name].size if name in template else 0
        if saved != size and not (name in growing_groups and saved > size):
            raise InputError(
                f"{source}: the saved state of {name} has sizes {[saved] if saved else 'none'}, but these settings "
                f"make it {[size] if size else 'none'}; go on with the vehicle and the settings of that run"
            )
    return {name: np.concatenate([np.array(piece, dtype=float) for piece in states[name]]) for name in template}
