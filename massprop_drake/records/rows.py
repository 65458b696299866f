"""Rows of telemetry, their columns, and what is counted of them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Set
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.scenario import Scenario, filter_of, resolve_scenario, set_field
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.yaml import Document
from massprop_drake.maths.signals import AXES

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_TURNING_FAST = {"rotation": {"coupling": "model"}, "mass": {"compensation": "transverse_centripetal"}}
WRENCH = tuple(f"known_{what}_{axis}" for what in ("torque", "force") for axis in AXES)


def telemetry_columns(vehicle: Vehicle) -> list[str]:
    """Lists a vehicle's telemetry columns in order: time, axes of sensors, sensors in a fixed frame, jets."""
    sensors = [f"{name}_{axis}" for name in vehicle.sensor_names() for axis in AXES]
    return ["time_s", *sensors, *vehicle.tracked_columns, *(f"jet_{jet}" for jet in vehicle.designations)]


def on_time_columns(vehicle: Vehicle) -> list[str]:
    """Lists the names of the columns of on-times, one per jet."""
    return [f"on_{jet}_s" for jet in vehicle.designations]


def jet_columns(vehicle: Vehicle, present: Set[str]) -> list[str]:
    """Lists each jet's command column: its fraction, or its on-time where a table has that alone."""
    names = zip(vehicle.designations, on_time_columns(vehicle), strict=True)
    fractions = ((f"jet_{jet}", timed) for jet, timed in names)
    return [timed if fraction not in present and timed in present else fraction for fraction, timed in fractions]


def onset_columns(vehicle: Vehicle) -> list[str]:
    """Lists the names of the columns of onsets, one per jet."""
    return [f"onset_{jet}_s" for jet in vehicle.designations]


def scenario_name(telemetry: str | Path) -> str:
    """Returns a scenario's name from the name of a telemetry file, without characters not allowed in it."""
    stem = "stdin" if str(telemetry) == "-" else Path(telemetry).stem
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", stem).lstrip("_.-") or "telemetry"


def vehicle_scenario(name: str, vehicle: str, overrides: list[str] | None = None) -> Scenario:
    """Makes a scenario with default settings for a recorded vehicle.

    With the thesis's filters dynamic coupling and centripetal acceleration are modeled: a recorded vehicle may turn
    faster than the orbiter in its maneuvers.

    Args:
        name: of the scenario.
        vehicle: a bundled one's name, or the path of a file.
        overrides: `KEY=VALUE` each, as of `load_scenario`.

    Raises:
        InputError: when there is no such vehicle, or a setting is wrong.
    """
    document = Document("{}", "scenario")
    data = document.data = {"name": name, "vehicle": vehicle}
    for override in overrides or []:
        set_field(data, override, document.overridden)
    if data["vehicle"] == vehicle:  # so that errors in its file begin with the file
        data["vehicle"] = load_vehicle(vehicle)
    if filter_of(data) == "thesis":  # others have no such choice
        for block, keys in _TURNING_FAST.items():
            stated = data.setdefault(block, {})
            if isinstance(stated, dict):
                data[block] = {**keys, **stated}
    return resolve_scenario(data, document)


class Rows(NamedTuple):
    """A block of rows in time order, ready for the filters.

    Attributes:
        time_s: of each row, s, shape (n,).
        readings: of each sensor package, NaN where missing, shape (n, 3).
        commands: fraction commanded over the interval that starts at the row's time, NaN where unknown,
            shape (n, n_jets).
        outside_wrench: known outside torque about the vehicle origin and force over that interval, mean,
            shape (n, 6); None: the record has none.
        recorded: whether the row is in the record; a row that fills a gap has neither readings nor
            commands, shape (n,).
        tracked: readings of the sensors in a fixed frame, as `Vehicle.tracked_columns` names them, NaN where missing,
            shape (n, columns); None: the vehicle has none.
        onsets_s: of the commands, see `maths.vehicle.on_times`, NaN where not told, shape (n, n_jets); None: jets
            switch with samples.
        told: rows that have commands of their own, shape (n,); None: all.
    """

    time_s: Array
    readings: Mapping[str, Array]
    commands: Array
    outside_wrench: Array | None
    recorded: Flags
    tracked: Array | None = None
    onsets_s: Array | None = None
    told: Flags | None = None

    def first(self, count: int) -> Rows:
        """Selects the first rows of the block, at most count."""
        return self.select(slice(count))

    def select(self, chosen: slice | NDArray[np.int_]) -> Rows:
        """Returns the rows that a slice, mask or indices select."""
        readings = {name: values[chosen] for name, values in self.readings.items()}
        outside, tracked, onsets_s = (
            None if part is None else part[chosen] for part in (self.outside_wrench, self.tracked, self.onsets_s)
        )
        told = None if self.told is None else self.told[chosen]
        recorded = self.recorded[chosen]
        return Rows(self.time_s[chosen], readings, self.commands[chosen], outside, recorded, tracked, onsets_s, told)


def write_csv(path: Path, vehicle: Vehicle, rows: Iterable[Rows]) -> None:
    """Writes telemetry as CSV; every number reads back exactly, and NaN becomes an empty cell.

    Args:
        path: of the file.
        vehicle: whose packages and jets name the columns.
        rows: block by block; rows that only fill gaps are left out.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        heading = False
        for block in rows:
            outside = [] if block.outside_wrench is None else [block.outside_wrench]
            if not heading:
                opening = [] if block.onsets_s is None else onset_columns(vehicle)
                writer.writerow([*telemetry_columns(vehicle), *opening, *(WRENCH if outside else ())])
                heading = True
            sensors = [block.readings[name] for name in vehicle.sensor_names()]
            tracked = [] if block.tracked is None else [block.tracked]
            onsets = [] if block.onsets_s is None else [block.onsets_s]
            parts = [block.time_s, *sensors, *tracked, block.commands, *onsets, *outside]
            table = np.column_stack(parts)[block.recorded]
            writer.writerows([_format_cell(value) for value in row] for row in table.tolist())


def _format_cell(value: float) -> str:
    """Formats a number as a CSV cell that reads back exactly; NaN as an empty one."""
    if math.isnan(value):  # not measured, or not commanded
        return ""
    return str(int(value)) if value in (0.0, 1.0) else repr(value)


class Record:
    """Statistics gathered while a record is read, for the quality report.

    Attributes:
        rows: taken; first_s, last_s: their times, s.
        intervals, interval_sum_s: those of about a sample period, and their sum.
        jitter, largest_jitter_s: intervals off by more than 0.1 % of the period, and the most.
        gaps, gap_sum_s, longest_gap_s, first_gaps: longer or shorter intervals; (time, length) of the first.
        duplicates, backward, first_late_line: rows left out because their time is that of the row before, or
            earlier; line of the first.
        without_time, before_start: rows left out that have no time, or were estimated from already.
        missing: rows in which a sensor package lacks a reading, by its name.
        absent: packages that the record does not have.
        unknown: columns not used, each with a name that may have been meant, or "".
        notes: on what is doubtful in the rows, a sentence each.
        information: on how they were made, likewise.
    """

    def __init__(self) -> None:
        self.rows = self.intervals = self.jitter = self.gaps = self.duplicates = self.backward = 0
        self.without_time = self.before_start = self.first_late_line = 0
        self.first_s = self.last_s = math.nan
        self.interval_sum_s = self.largest_jitter_s = self.gap_sum_s = self.longest_gap_s = 0.0
        self.first_gaps: list[tuple[float, float]] = []
        self.missing: dict[str, int] = {}
        self.absent: list[str] = []
        self.unknown: dict[str, str] = {}
        self.notes: list[str] = []
        self.information: list[str] = []

    @property
    def period_s(self) -> float | None:
        """Mean interval between rows without a gap, s; None without any."""
        return self.interval_sum_s / self.intervals if self.intervals else None


class Continuation(NamedTuple):
    """End of an earlier part of a record, from which reading continues.

    Attributes:
        time_s: of its last row.
        command: of that row, NaN where unknown, shape (n_jets,).
        outside_wrench: of that row, shape (6,).
        velocity: integral of each acceleration so far, by package, shape (3,) each.
        onset_s: of the command, NaN where not told, shape (n_jets,); None: jets switch with samples.
    """

    time_s: float
    command: Array
    outside_wrench: Array
    velocity: Mapping[str, Array]
    onset_s: Array | None = None
