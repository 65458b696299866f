"""Content of a finished run: its summary and its signals, and what is stored of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, counted, in_words, suggestion
from massprop_drake.inputs import params
from massprop_drake.inputs.kinds import bundled_files, describe_folder
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.inputs.yaml import exists
from massprop_drake.maths.signals import (
    JOINTS,
    PROPELLANT,
    SIGNALS,
    Signal,
    accelerometer_signal,
    engine_signal,
    fill_unit_template,
    gyro_signal,
    is_user_signal,
    joint_signal,
    pose_signal,
    propellant_signal,
    simulated_signal,
    user_signal,
    velocity_signal,
    wheel_signal,
)
from massprop_drake.records import rows
from massprop_drake.results.exchange import recover
from massprop_drake.results.json_arrays import null_for_nan
from massprop_drake.results.parts import EarlyEnd
from massprop_drake.results.spool import Signals, Spool, blocks, write_npz
from massprop_drake.results.stored import read_json
from massprop_drake.results.summary import Summary
from massprop_drake.results.thinning import outstanding_rows, pick_rows

Array = NDArray[np.float64]

# signals that no figure of recorded telemetry shows
_NOT_SHOWN = ("angular_impulse", "linear_impulse", "failure_magnitude")
_MANY_ROWS = 5000  # longer runs are downsampled for plots and pages
_PEAKS = ("rotation_nis", "mass_nis")  # signals whose maxima a plot must not lose
_EVENTS = ("alarm", "detector_event", "gap")  # signals whose rows a plot must not lose


def read_summary(folder: Path) -> Summary:
    """Reads `summary.json` from a run's folder, after recovery of what a killed process has left.

    Raises:
        InputError: when the folder holds no run that can be read.
    """
    recover(folder)
    path = folder / "summary.json"
    if not exists(folder):
        raise InputError(f"{folder}: there is no such run{_runs_like(folder)}")
    if exists(folder / "plan.parquet"):
        raise InputError(f"{folder}: {describe_folder(folder)}")
    if not exists(path):
        raise InputError(f"{folder}: holds no run that can be read: it has no summary.json")
    return Summary.from_json(read_json(path), str(path))


def _runs_like(folder: Path) -> str:
    """Returns a hint for messages: a similar run, or the command that makes one."""
    found = (*Path().glob("*/history.npz"), *Path().glob("runs/*/history.npz"))  # which a campaign's folder lacks
    there = sorted(str(path.parent) for path in found if exists(path.parent / "summary.json"))
    same = [name for name in there if Path(name).name == folder.name]
    if not same and str(folder) in bundled_files("scenario"):
        return f"; 'massprop run {folder}' makes one in runs/{folder}"
    return suggestion(folder, same[:1] or there)


class RunContent:
    """Scenario that has been run.

    Attributes:
        scenario: as run, in full.
        results: what it found, as arrays and objects; `summary` is the same as JSON.
        signals: every logged signal by name, one row per sample, shape (n_samples, components); the
            unit of each is in `units`, the names of its columns in `components`. Sample times are
            `time_s`. Those of a long run stay on disk and are read when asked for.
        state: what it takes to resume from the end, as in `filter_state.json`.
        thinned: whether the signals are but some of the rows, as `thin_for_plots` picks them.
    """

    def __init__(
        self,
        scenario: Scenario,
        results: Summary,
        time_s: Array | None,
        signals: Mapping[str, Array],
        state: Mapping[str, Any] | None = None,
    ):
        self.scenario = scenario
        self.results = results
        if time_s is not None:
            self.time_s = time_s
        self.signals = signals if isinstance(signals, Spool) else Signals(signals)
        self.state = dict(state or {})
        self.thinned = False

    def __repr__(self) -> str:
        found = len(self.results.detections)
        said = counted(found, "declaration") if found else "no failure found"
        said += "" if self.results.ended is None else ", ended early"
        return (
            f"<Run of '{self.scenario.name}' on '{self.results.vehicle}', {self.results.duration_s:g} s, "
            f"seed {self.scenario.seed}: {said}>"
        )

    def __getitem__(self, name: str) -> Array:
        try:
            return self.signals[name]
        except KeyError:
            raise KeyError(f"no signal {name!r}{suggestion(name, list(self.signals))}") from None

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Content of `summary.json`."""
        return self.results.as_json()

    @property
    def covariance(self) -> Array:
        """Covariance of the ten estimates at the end, shape (10, 10)."""
        return self.results.covariance

    @cached_property
    def time_s(self) -> Array:
        """Sample times, s, shape (n_samples,)."""
        return self.signals["time_s"]

    @property
    def _rows(self) -> Mapping[str, Array]:
        """Signals by name, "time_s" included, as files hold them."""
        return self.signals if isinstance(self.signals, Spool) else {"time_s": self.time_s, **self.signals}

    @property
    def _n_rows(self) -> int:
        """Number of samples."""
        return self.signals.n_rows if isinstance(self.signals, Spool) else self.time_s.size

    @cached_property
    def descriptions(self) -> dict[str, Signal]:
        """Maps each signal to its description: label, unit template and components."""
        vehicle = self.scenario.vehicle_data
        packages = {gyro.name: gyro_signal(gyro.name) for gyro in vehicle.gyros}
        packages |= {package.name: accelerometer_signal(package.name) for package in vehicle.accelerometers}
        packages |= {sensor.name: pose_signal(sensor.name) for sensor in vehicle.poses}
        packages |= {sensor.name: velocity_signal(sensor.name) for sensor in vehicle.velocities}
        packages |= {wheel.name: wheel_signal(wheel.name) for wheel in vehicle.wheels}
        packages |= {one.name: engine_signal(one.name, has_gimbal=one.gimbal is not None) for one in vehicle.engines}
        packages[PROPELLANT] = propellant_signal(tuple(tank.name for tank in vehicle.tanks))
        packages |= {against.name: against for against in map(simulated_signal, packages.values())}
        if isinstance(plant := self.scenario.plant, MultibodyBlock):
            packages[JOINTS] = joint_signal(plant.joint_columns, plant.joint_units)
        own = {
            name: user_signal(name, np.shape(self.signals[name])[1]) for name in self.signals if is_user_signal(name)
        }
        return {name: SIGNALS.get(name) or packages.get(name) or own[name] for name in self.signals}

    @cached_property
    def units(self) -> dict[str, str]:
        """Maps each signal to its unit, in the vehicle's unit system."""
        names = self.scenario.vehicle_data.unit_names
        return {name: fill_unit_template(signal.unit, names) for name, signal in self.descriptions.items()}

    @cached_property
    def components(self) -> dict[str, tuple[str, ...]]:
        """Maps each signal to the names of its columns."""
        jets = self.scenario.vehicle_data.designations
        return {name: signal.components or jets for name, signal in self.descriptions.items()}

    def thin_for_plots(self) -> Self:
        """Returns a run with a few thousand rows to plot; a run of up to 5000 rows is returned itself.

        Kept are the rows at which the rates and the NIS are extreme within each of many stretches of equal
        length, and rows with alarms, a few thousand in all. Rows are never averaged.
        """
        if self.thinned or self._n_rows <= _MANY_ROWS:
            return self
        keys = (params.main_sensor(self.scenario),)
        rows = outstanding_rows(self.signals, self._n_rows, keys=keys, peaks=_PEAKS, events=_EVENTS)
        signals = pick_rows(self._rows, rows, excluded=_NOT_SHOWN)
        thinned = type(self)(self.scenario, self.results, signals.pop("time_s"), signals, self.state)
        thinned.thinned = True
        return thinned

    def note_end(self, error: BaseException, *, early: bool) -> None:
        """Stores in the results the time and reason of an early end, or the reason why a part is missing."""
        why = in_words(error)
        if early:
            self.__dict__.pop("summary", None)
            self.results = replace(self.results, ended=EarlyEnd(float(self.time_s[-1]), why))
        elif not self.results.missing:
            self.note_missing(why)

    def note_missing(self, part: str) -> None:
        """Adds to the results a line on a missing part of the output, with the reason."""
        self.__dict__.pop("summary", None)
        self.results = replace(self.results, missing=(*self.results.missing, part))

    def to_pandas(self) -> Any:
        """Returns the signals as a pandas DataFrame: rows by time in seconds, columns by signal and component.

        Raises:
            ImportError: when pandas is not installed.
        """
        import pandas  # noqa: PLC0415 (optional)

        columns = [(name, component) for name in self.units for component in self.components[name]]
        table = np.hstack([np.asarray(self.signals[name]) for name in self.units])
        index = pandas.Index(np.asarray(self.time_s), name="time_s")
        return pandas.DataFrame(
            table, index=index, columns=pandas.MultiIndex.from_tuples(columns, names=["signal", "component"])
        )

    def to_xarray(self) -> Any:
        """Returns the signals as an xarray Dataset over time in seconds, each with its components and its unit.

        Raises:
            ImportError: when xarray is not installed.
        """
        import xarray  # noqa: PLC0415 (optional)

        variables = {
            name: (("time_s", f"{name}_component"), np.asarray(self.signals[name]), {"units": unit})
            for name, unit in self.units.items()
        }
        coordinates = {f"{name}_component": list(self.components[name]) for name in self.units}
        return xarray.Dataset(variables, coords={"time_s": np.asarray(self.time_s), **coordinates})

    def write_telemetry(self, path: Path) -> None:
        """Writes sample times, readings and commands as a telemetry CSV file."""
        rows.write_csv(path, self.scenario.vehicle_data, self._telemetry())

    def _telemetry(self) -> Iterator[rows.Rows]:
        """Yields times, readings and commands as rows of a telemetry file, block by block."""
        sensors = self.scenario.vehicle_data.sensor_names()
        tracked = self.scenario.vehicle_data.tracked
        named = [sensor.name for sensor in tracked if sensor.name in self.signals]
        recorded = "gap" in self.signals
        optional = [name for name in ("gap", "outside_wrench", "command_onset") if name in self.signals]
        rows_left = self._n_rows
        for block in blocks(self._rows, "time_s", "command", *sensors, *named, *optional):
            rows_left -= block["time_s"].size
            commands, readings = block["command"], {name: block[name] for name in sensors}
            if not (recorded or rows_left):
                commands = np.vstack([commands[:-1], np.full(commands.shape[1], np.nan)])  # none beyond the end
            is_present = block["gap"][:, 0] == 0.0 if recorded else np.ones(len(commands), dtype=bool)
            unread = (np.full((len(commands), len(sensor.columns)), np.nan) for sensor in tracked)
            read = [block.get(sensor_read.name, none) for sensor_read, none in zip(tracked, unread, strict=True)]
            followed = np.hstack(read) if read else None
            more = block.get("outside_wrench"), is_present, followed, block.get("command_onset")
            yield rows.Rows(block["time_s"], readings, commands, *more)

    def write_history(self, path: Path) -> None:
        """Writes every signal with its unit and components as an NPZ file."""
        described = {name: {"unit": self.units[name], "components": self.components[name]} for name in self.units}
        write_npz(path, self._rows, described)

    def filter_state(self) -> dict[str, Any]:
        """Returns what `filter_state.json` holds: the estimators' state, estimates and covariance."""
        return {
            **self.state,
            "estimate": null_for_nan(self.results.estimates),
            "covariance": null_for_nan(self.covariance),
        }
