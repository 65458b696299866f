"""Runs of the estimators and the failure detector over recorded telemetry, with no simulated vehicle."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.errors import InputError
from massprop_drake.inputs import params
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.record_map import RecordMap, load_map
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import SensorPackage
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.whole import Samples
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.records import mapped_rows, mapping
from massprop_drake.records.blocks import Table
from massprop_drake.records.control_rows import Thinning
from massprop_drake.records.merging import MergedTable
from massprop_drake.records.quality import QualityReport
from massprop_drake.records.reader import AT_STAMPS, Reader
from massprop_drake.records.recording import open_recording, require_table
from massprop_drake.records.rows import Continuation, Rows
from massprop_drake.results import delay_remarks
from massprop_drake.results.batch_analysis import BatchAnalysis, analyze_run
from massprop_drake.results.consistency import TOO_LITTLE, Consistency, Tally, judge_consistency, used_nis
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.exchange import recover
from massprop_drake.results.json_arrays import null_for_nan, onsets_as_json
from massprop_drake.results.parts import PartsMade
from massprop_drake.results.stored import STATE_FILE, FilterState, read_json, require_same_origin
from massprop_drake.results.summarize import compose_summary, count_firings, exclude_explained, summarize_last_estimates
from massprop_drake.results.summary import AutopilotSummary, Findings, RunTiming, Summary
from massprop_drake.runners.cycles import RecordRows, make_cycles
from massprop_drake.runners.logs import EstimationLog, Intake, estimation_signals, state_from_json, state_to_json

Array = NDArray[np.float64]

_LONGEST_S = 1e6  # duration that a scenario may have
_ALIKE = 1e-9  # relative: what a replay may differ by
_LESS = 0.01  # of a rate of rows, which is found from the first of them


def estimate(
    telemetry: str | Path | Sequence[str | Path],
    scenario: Scenario,
    *,
    resume_from: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    declared: Callable[[DetectionRecord], None] | None = None,
    said: Callable[[EventRecord], None] | None = None,
    stream: IO[bytes] | None = None,
    folder: Path | None = None,
    record_map: str | Path | RecordMap | None = None,
    keep: Callable[[Run], object] | None = None,
) -> Run:
    """Estimates mass properties and finds failed jets from a record, in bounded memory; returns the run.

    The cycle is that of simulated runs, so a run's own telemetry gives its own estimates, bit for bit. Drake plays no
    part; `diagrams.replay` does the same as a diagram.

    Args:
        telemetry: a CSV or Parquet file, or several, each with times of its own; or "-" for standard input, whose rows
            are used as they come.
        scenario: for the vehicle and the settings of sensors, estimators and detector; the rest of it plays
            no part.
        resume_from: folder of a run to go on from: its filter state is taken up, and rows up to its end are
            skipped.
        progress: called now and then with the share of the file that has been read, 0 to 1.
        declared: called with each detection as soon as it is made.
        said: called with all that the detector says as soon as it says it, detections included.
        stream: read instead of the file.
        folder: where a temporary file with the signals may lie; default the system's place for such.
        record_map: what the columns of another program's file mean, or the file that says so; None: the record is
            telemetry. With a map all of the file is read before the first row is used.
        keep: called with the run as far as it has come when something is raised after its first row, an interruption
            as well; its summary says where and why it ended, and which parts could not be made. Where a file has bad
            rows, which can be mended and read again, it is not called.

    Returns:
        The run, without truth; its signals lie on disk, and its summary has `data_quality` besides.

    Raises:
        InputError: when the record or the saved state cannot be used, or readings are such that a covariance
            loses definiteness; the message says where.
    """
    scenario = estimation_settings(scenario)
    earlier = None if resume_from is None else _read_filter_state(Path(resume_from), scenario)
    after = None if earlier is None else _make_continuation(earlier)
    vehicle = scenario.vehicle_data
    gyro = params.gyro(scenario).name if vehicle.gyros and not vehicle.needs_pose_filter else None
    own_times = params.steps_by_readings(scenario)
    joint = scenario.estimation.filter == "joint"
    source = _open_record(telemetry, record_map, (vehicle, gyro), (own_times, joint))
    reader = Reader(source, vehicle, gyro=gyro, previous=after, stream=stream)
    can_be_read_again = stream is None and str(telemetry) != "-"
    try:
        if not own_times and joint and can_be_read_again:
            scenario = _step_at_record_rate(scenario, reader.readings_per_s())
        reader.own_times = params.steps_by_readings(scenario)
        if scenario.joint.switching == "stamps":
            reader.jitter = AT_STAMPS
        replayed = _Estimation(scenario, earlier, str(resume_from), folder)
        began, whole = time.perf_counter(), False
        try:
            for rows in reader:
                events, entries = replayed.take(rows, reader.before)
                if declared is not None:
                    for entry in entries:
                        declared(entry)
                if said is not None:
                    for event in events:
                        said(event)
                if progress is not None:
                    progress(reader.done)
            whole = True
            return replayed.finish(reader, telemetry, began, PartsMade(strict=True))
        except BaseException as error:
            in_the_file = isinstance(error, InputError) and can_be_read_again
            if keep is not None and not in_the_file and replayed.has_rows:
                kept = replayed.finish(reader, telemetry, began, PartsMade())
                kept.note_end(error, early=not whole)
                keep(kept)
            raise
    except NotPositiveDefiniteError as error:  # the files are all that there is to be wrong
        raise InputError(
            f"{reader.source}: the filters cannot go on: {error.headline}; "
            "check that units, columns and vehicle belong together"
        ) from error
    finally:
        reader.close()


def _open_record(
    telemetry: str | Path | Sequence[str | Path],
    record_map: str | Path | RecordMap | None,
    vehicle_and_gyro: tuple[Vehicle, str | None],
    stepping: tuple[bool, bool],
) -> str | Path | Table:
    """Opens telemetry for the reader: one file, several merged into a table, or one converted by its map.

    Args:
        telemetry, record_map: see `estimate`.
        vehicle_and_gyro: vehicle, and its gyro; None: of a vehicle that is followed in a fixed frame.
        stepping: whether the filter takes one whenever anything is read, and whether it can.
    """
    first, *others = [telemetry] if isinstance(telemetry, (str, Path)) else telemetry
    if others and "-" in (first, *others):
        raise InputError("standard input cannot be joined with files: give '-' alone")
    if record_map is not None:
        for path in others:
            raise InputError(f"{path}: a map goes with one record; give several files only where they need none")
        loaded_map = record_map if isinstance(record_map, RecordMap) else load_map(record_map)
        name = "map" if isinstance(record_map, RecordMap) else str(record_map)
        (vehicle, gyro), (own_times, possible) = vehicle_and_gyro, stepping
        record = mapping.apply_map(open_recording(first, loaded_map), loaded_map, vehicle, name)
        faster = possible and mapped_rows.is_oversampled(record)
        return mapped_rows.make_table(record, gyro, own_times=own_times or faster)
    for path in (first, *others):
        require_table(path)
    return MergedTable([first, *others]) if others else first


def _step_at_record_rate(scenario: Scenario, readings_per_s: float | None) -> Scenario:
    """Returns the scenario with a record's readings per second as the filter's steps; None: unchanged."""
    if readings_per_s is None:
        return scenario
    period_s = scenario.vehicle_data.sample_period_s
    steps = math.ceil(readings_per_s * period_s * (1.0 - _LESS))
    estimation = scenario.estimation.model_copy(update={"readings_per_s": steps / period_s})
    return scenario.model_copy(update={"estimation": estimation})


def estimation_settings(scenario: Scenario) -> Scenario:
    """Returns the scenario with maneuver, failures, jumps, true plant and sensor errors set to their defaults."""
    bare = {"maneuver": (), "jet_schedule": (), "failures": (), "jumps": (), "plant": PlantBlock()}
    sensors = scenario.sensors.model_copy(update={"errors": ()})
    return scenario.model_copy(update={**bare, "sensors": sensors})


class _Estimation:
    """Estimation over a record: a cycle for every row, its log, and its findings."""

    def __init__(self, scenario: Scenario, earlier: FilterState | None, source: str, folder: Path | None):
        self._scenario = scenario
        self._vehicle = scenario.vehicle_data
        self._period_s = self._vehicle.sample_period_s
        self._resumed = earlier is not None
        self._next_row = 0 if earlier is None else earlier.row + 1
        self._params = params.estimation_params(scenario)
        begin = None
        if earlier is not None:
            begin = state_from_json(earlier.states, self._params, f"{source}/{STATE_FILE}")
            _require_same_state(earlier, cycle.estimate_and_covariance(begin, self._params), f"{source}/{STATE_FILE}")
        self._cycles = make_cycles(scenario, self._params, begin)
        n_jets = len(self._vehicle.jets)
        self._command, self._outside = np.zeros(n_jets), np.zeros(6)  # of the interval before the next row
        self._onset_s = level_onsets(n_jets)  # likewise
        self._at_any_time = scenario.estimation.filter == "pose" or params.steps_by_readings(scenario)
        self._gyros, self._accelerometers = params.gyros(scenario), params.accelerometers(scenario)
        self._intake = Intake(scenario, folder, earlier)
        self._nis = {"rotation": Tally(), "mass": Tally()}
        self._on_before = np.zeros(n_jets, dtype=bool)
        self._firings = 0
        self._fired = np.zeros(n_jets)
        self._quality = QualityReport(scenario)
        self._thinning: Thinning | None = None
        self._before_s = math.nan
        if params.steps_by_readings(scenario):
            self._thinning = Thinning(self._period_s, [package.name for package in self._gyros])

    def take(
        self, rows: Rows, interval_before: tuple[Array, Array, Array | None]
    ) -> tuple[list[EventRecord], list[DetectionRecord]]:
        """Runs the estimation over a block of rows; returns the block's events and new detections."""
        if not self._intake.spool.n_rows:
            self._command, self._outside, onset_s = interval_before
            self._onset_s = self._onset_s if onset_s is None else onset_s
            self._on_before = interval_before[0] > 0.0
            self._quality.begin(interval_before[0])
        log, commands, outside_wrenches = self._begin_rows(rows)
        try:
            self._cycles.advance(rows.time_s.size)
        except BaseException:
            done = self._cycles.done
            self._add_estimated_rows(
                rows.first(done), {name: part[:done] for name, part in log.rows.items()}, commands, outside_wrenches
            )
            raise
        return self._add_estimated_rows(rows, log.rows, commands, outside_wrenches)

    def _begin_rows(self, rows: Rows) -> tuple[EstimationLog, Array, Array]:
        """Begins the estimation of rows; returns its empty log, and commands and wrench from one row earlier on."""
        count = rows.time_s.size
        rates, velocities = _stack_readings(rows, self._gyros), _stack_readings(rows, self._accelerometers)
        log = EstimationLog(self._scenario, self._params, count)
        commands = np.vstack([self._command, rows.commands])
        outside_wrenches = np.vstack([self._outside, np.broadcast_to(self._outside, (count, 6))])
        if rows.outside_wrench is not None:
            outside_wrenches[1:] = rows.outside_wrench
        time_s = np.arange(self._next_row, self._next_row + count).astype(np.float64) * self._period_s
        if self._at_any_time:
            time_s = rows.time_s
        samples = Samples(time_s, rates, velocities, commands[:-1], outside_wrenches[:-1])
        onsets_s = None if rows.onsets_s is None else np.vstack((self._onset_s, rows.onsets_s))
        self._cycles.begin(RecordRows(samples, rows.time_s, commands[1:], rows.tracked, onsets_s), log)
        return log, commands, outside_wrenches

    def _add_estimated_rows(
        self, rows: Rows, logs: Mapping[str, Array], commands: Array, outside_wrenches: Array
    ) -> tuple[list[EventRecord], list[DetectionRecord]]:
        """Adds rows and estimates to signals, counts and data quality; returns their events and new detections."""
        count = rows.time_s.size
        if not count:
            return [], []
        self._command, self._outside = commands[count], outside_wrenches[count]
        if rows.onsets_s is not None:
            self._onset_s = rows.onsets_s[count - 1]
        self._next_row += count
        signals = self._make_signals(rows, logs)
        self._count_samples(rows, signals, commands[:count])
        self._quality.add(*((rows, signals) if self._thinning is None else self._thinning.select(rows, signals)))
        return self._intake.take(signals)

    def _make_signals(self, rows: Rows, logs: Mapping[str, Array]) -> dict[str, Array]:
        """Maps names of signals to rows of the record and its estimates, with times by the record's clock."""
        signals: dict[str, Array] = {"time_s": rows.time_s, "command": rows.commands}
        if rows.onsets_s is not None:
            signals["command_onset"] = rows.onsets_s
        signals["gap"] = np.where(rows.recorded, 0.0, 1.0)[:, None]
        if rows.outside_wrench is not None:
            signals["outside_wrench"] = rows.outside_wrench
        signals |= estimation_signals(self._scenario, logs)
        signals |= rows.readings
        signals |= split_by_sensor(rows, self._vehicle)
        for name in {"onset", "verdict_onset", "unexplained_since", "history_since"} & set(signals):
            if not self._at_any_time:
                signals[name] = self._convert_to_record_time(signals[name], rows.time_s)
        return signals

    def _convert_to_record_time(self, estimation_times_s: Array, record_times_s: Array) -> Array:
        """Converts times by the estimation's clock, a period per row, to times by the record's, s; NaN stays."""
        rows = np.nan_to_num(estimation_times_s / self._period_s).round().astype(int)
        recent_s = np.concatenate([self._intake.recent_s, record_times_s])
        first = self._next_row - recent_s.size
        converted_s = recent_s[np.clip(rows - first, 0, None)]
        # rows long past: as far back from the first one known as their number says
        converted_s = np.where(rows >= first, converted_s, recent_s[0] - (first - rows) * self._period_s)
        return converted_s + (estimation_times_s - rows * self._period_s)  # exactly what it was where both times agree

    def _count_samples(self, rows: Rows, signals: Mapping[str, Array], commands_before: Array) -> None:
        """Adds rows to the counts of NIS, firings and on-times; `commands_before`: commands from one row earlier on."""
        for name, tally in self._nis.items():
            if f"{name}_nis" in signals:
                tally.add(*used_nis(name, signals))
        is_on = rows.commands > 0.0
        self._firings += count_firings(is_on, self._on_before)
        self._on_before = is_on[-1]
        if self._thinning is None:
            self._fired += np.nansum(rows.commands, axis=0)
            return
        steps = np.diff(rows.time_s, prepend=rows.time_s[0] if math.isnan(self._before_s) else self._before_s)
        self._before_s = float(rows.time_s[-1])
        self._fired += np.nansum(commands_before * steps[:, None], axis=0) / self._period_s

    @property
    def has_rows(self) -> bool:
        """True if any row has been taken in."""
        return self._intake.spool.n_rows > 0

    def finish(
        self, reader: Reader, telemetry: str | Path | Sequence[str | Path], began_s: float, parts: PartsMade
    ) -> Run:
        """Makes the run with its summary and filter state, once all rows have been estimated.

        Args:
            reader: of the record.
            telemetry: the record.
            began_s: when the first row was asked for, by the performance counter, s.
            parts: makes what may fail.
        """
        wall_s = time.perf_counter() - began_s
        reader.close()
        duration_s = float(self._intake.spool.last("time_s")) - reader.record.first_s
        if self._period_s <= duration_s <= _LONGEST_S:
            self._scenario = self._scenario.model_copy(update={"duration_s": duration_s})
        timing = RunTiming(wall_s, duration_s / wall_s, self._cycle_times())
        results = parts.make(
            "summary", lambda: self._make_summary(reader, telemetry, timing, parts), None
        ) or summarize_last_estimates(self._scenario, self._intake.spool, timing)
        empty: dict[str, Any] = {}
        state = parts.make("filter state", lambda: self._make_filter_state(reader), empty)
        return Run(self._scenario, replace(results, missing=tuple(parts.missing)), None, self._intake.spool, state)

    def _make_summary(
        self, reader: Reader, telemetry: str | Path | Sequence[str | Path], timing: RunTiming, parts: PartsMade
    ) -> Summary:
        """Makes the summary of estimates, findings and data quality; arguments as those of `finish`."""
        last = self._intake.spool.last
        found = parts.make("detections", self._intake.findings, Findings())
        failed_s = [entry.onset_s for entry in found.detections if entry.kind != JUMP and entry.withdrawn_s is None]
        unjudged: dict[str, Any] = {"warnings": []}
        quality = parts.make(
            "data quality", lambda: self._judge_quality(reader, min(failed_s, default=math.inf)), unjudged
        )
        unknown = np.full(10, np.nan)
        estimate = last("estimate")
        analysis = parts.make(
            "hindsight",
            lambda: analyze_run(
                self._scenario, self._intake.spool, estimate, found.detections, found.events, resumed=self._resumed
            ),
            BatchAnalysis(unknown, ()),
        )
        _, covariance = parts.make(
            "covariance", self._cycles.estimate_and_covariance, (unknown, np.full((10, 10), np.nan))
        )
        return compose_summary(
            self._scenario,
            duration_s=float(last("time_s")) - reader.record.first_s,
            estimate=last("estimate"),
            deviation=last("standard_deviation"),
            covariance=covariance,
            truth=unknown,
            findings=found,
            consistency=parts.make(
                "consistency", lambda: self._judge_consistency(found, analysis), Consistency(None, None, 0, TOO_LITTLE)
            ),
            bound=analysis.bound,
            autopilot=AutopilotSummary(self._firings, float(self._fired @ self._vehicle.mass_flows) * self._period_s),
            timing=timing,
            telemetry=_record_name(telemetry),
            telemetry_sha256=parts.make("digest of the record", reader.sha256, None),
            data_quality=quality,
            losses=reader.losses,
        )

    def _judge_quality(self, reader: Reader, failed_s: float) -> dict[str, Any]:
        """Returns the quality of the record up to the first failure, with warnings, as JSON data."""
        quality = self._quality.summarize(reader.record, reader.ragged, failed_s)
        quality["warnings"] = [*quality["warnings"], *delay_remarks.remarks(self._scenario, self._intake.spool)]
        return quality

    def _judge_consistency(self, found: Findings, analysis: BatchAnalysis) -> Consistency:
        """Tests the NIS of both filters for consistency, less the samples that declared failures explain."""
        rotation, mass = (
            exclude_explained(copy.deepcopy(tally), self._intake.spool, name, found.detections)
            for name, tally in self._nis.items()
        )
        return judge_consistency(rotation, mass, np.full(10, np.nan), SYMBOLS, analysis.diagnoses)

    def _make_filter_state(self, reader: Reader) -> dict[str, Any]:
        """Returns the JSON data of `filter_state.json` after the last row."""
        states = state_to_json(self._cycles.state(), self._params)
        return {
            **self._intake.state(self._next_row - 1, states, self._intake.spool.last("command")),
            **onsets_as_json(self._onset_s),
            "outside_wrench": null_for_nan(self._intake.last("outside_wrench", np.zeros(6))),
            "velocity": {name: null_for_nan(value) for name, value in reader.velocity.items()},
        }

    def _cycle_times(self) -> dict[str, float | None]:
        """Computes mean times per cycle of estimators and detector, microseconds; None: no such part."""
        mean = {name: 1e6 * spent / self._intake.spool.n_rows for name, spent in self._cycles.spent_s.items()}
        detector = mean.get("detector") if self._params.detector is not None else None
        return {"estimators": mean["estimators"], "detector": detector, "jet_selection": None}


def _record_name(telemetry: str | Path | Sequence[str | Path]) -> str:
    """Returns the name of a record for its summary: names of its files, or "standard input"."""
    if isinstance(telemetry, (str, Path)):
        return "standard input" if str(telemetry) == "-" else Path(telemetry).name
    return ", ".join(Path(path).name for path in telemetry)


def split_by_sensor(rows: Rows, vehicle: Vehicle) -> dict[str, Array]:
    """Maps sensors in the fixed frame to their columns of the readings, shape (n, columns)."""
    if rows.tracked is None:
        return {}
    ends = np.cumsum([len(sensor.columns) for sensor in vehicle.tracked])[:-1]
    parts = np.split(rows.tracked, ends, axis=1)
    return {sensor.name: part for sensor, part in zip(vehicle.tracked, parts, strict=True)}


def _stack_readings(rows: Rows, packages: Sequence[SensorPackage]) -> Array:
    """Stacks readings of sensor packages, NaN where missing or saturated, shape (n, s, 3)."""
    stacked = np.empty((rows.time_s.size, len(packages), 3))
    for place, package in enumerate(packages):
        stacked[:, place] = readings = rows.readings[package.name]
        if package.limit < math.inf:
            within = (np.abs(readings) < package.limit).all(axis=1)
            stacked[~within, place] = np.nan
    return stacked


# ------------------------------------------------------------------------------------------ going on


def _read_filter_state(folder: Path, scenario: Scenario) -> FilterState:
    """Reads the filter state in an earlier run's folder; raises InputError for another vehicle or settings."""
    source = folder / STATE_FILE
    recover(folder)
    state = validate_data(FilterState, read_json(source), source=str(source))
    require_same_origin(state, scenario, str(source))
    vehicle = scenario.vehicle_data
    for entry in state.detections:
        if entry.jet_index is not None and entry.jet_index >= len(vehicle.jets):
            raise InputError(f"{source}: detections: vehicle '{vehicle.name}' has no jet of index {entry.jet_index}")
    return state


def _require_same_state(state: FilterState, estimate_and_covariance: tuple[Array, Array], source: str) -> None:
    """Raises InputError where a saved estimate or covariance differs from that restored from its `states`."""
    for name, values in zip(("estimate", "covariance"), estimate_and_covariance, strict=True):
        saved = getattr(state, name)
        if saved is not None and not np.allclose(np.array(saved, dtype=float), values, _ALIKE, 0.0, equal_nan=True):
            raise InputError(f"{source}: {name}: is unlike the one in 'states'; it was not written by a run")


def _make_continuation(state: FilterState) -> Continuation:
    """Returns time, command, wrench and velocities at the earlier run's end, for the record's reader."""
    return Continuation(
        time_s=state.time_s,
        command=np.array(state.command, dtype=float),
        outside_wrench=np.array(state.outside_wrench),
        velocity={name: np.array(value) for name, value in state.velocity.items()},
        onset_s=state.onset_s,
    )
