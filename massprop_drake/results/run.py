"""Finished run: its summary, its signals, and their storage on disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from massprop_drake.errors import InputError, in_words, suggestion
from massprop_drake.inputs import params
from massprop_drake.inputs.kinds import about_folder, bundled
from massprop_drake.inputs.model import validated, yaml_text
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.inputs.yaml import exists, read_text
from massprop_drake.records import rows
from massprop_drake.results.exchange import recover
from massprop_drake.results.folder import Place, require_writable, whole_folder, write_file
from massprop_drake.results.json_arrays import null_for_nan
from massprop_drake.results.parts import Ended, PartsMade
from massprop_drake.results.spool import Signals, Spool, blocks, write_npz
from massprop_drake.results.stored import STATE_FILE, FilterState, read_history, read_json, storable
from massprop_drake.results.summary import Summary, SummaryFile
from massprop_drake.results.thinning import outstanding_rows, picked
from massprop_drake.signals import (
    JOINTS,
    PROPELLANT,
    SIGNALS,
    Signal,
    accelerometer_signal,
    engine_signal,
    gyro_signal,
    in_units,
    is_own,
    joint_signal,
    own_signal,
    pose_signal,
    propellant_signal,
    simulated_signal,
    velocity_signal,
    wheel_signal,
)

if TYPE_CHECKING:
    from massprop_drake.display.figures import Plots

Array = NDArray[np.float64]

# signals that no figure of recorded telemetry shows
_NOT_SHOWN = ("angular_impulse", "linear_impulse", "failure_magnitude")
_MANY_ROWS = 5000  # longer runs are downsampled for plots and pages
_END = "...\n"  # closes a YAML document: a file without it was cut short
_PEAKS = ("rotation_nis", "mass_nis")  # signals whose maxima a plot must not lose
_EVENTS = ("alarm", "detector_event", "gap")  # signals whose rows a plot must not lose


def read_summary(folder: Path) -> Summary:
    """Reads the summary of a run from its folder, also where a killed process has left it unfinished beside.

    Raises:
        InputError: when the folder holds no run that can be read.
    """
    recover(folder)
    path = folder / "summary.json"
    if not exists(folder):
        raise InputError(f"{folder}: there is no such run{_runs_like(folder)}")
    if exists(folder / "plan.parquet"):
        raise InputError(f"{folder}: {about_folder(folder)}")
    if not exists(path):
        raise InputError(f"{folder}: holds no run that can be read: it has no summary.json")
    return Summary.from_json(read_json(path), str(path))


def _runs_like(folder: Path) -> str:
    """Suggests a run that exists, or how to make one of a bundled scenario."""
    found = (*Path().glob("*/history.npz"), *Path().glob("runs/*/history.npz"))  # which a campaign's folder lacks
    there = sorted(str(path.parent) for path in found if exists(path.parent / "summary.json"))
    same = [name for name in there if Path(name).name == folder.name]
    if not same and str(folder) in bundled("scenario"):
        return f"; 'massprop run {folder}' makes one in runs/{folder}"
    return suggestion(folder, same[:1] or there)


class Run:
    """Scenario that has been run.

    Attributes:
        scenario: as run, in full.
        results: what it found, as arrays and objects; `summary` is the same as JSON.
        signals: every logged signal by name, one row per sample, shape (n_samples, components); the
            unit of each is in `units`, the names of its columns in `components`. Sample times are
            `time_s`. Those of a long run stay on disk and are read when asked for.
        state: what it takes to resume from the end, as in `filter_state.json`.
        thinned: whether the signals are but some of the rows, as `shown` picks them.
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
        said = f"{found} declaration{'s' if found > 1 else ''}" if found else "no failure found"
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
        """Signals with their times, as files have them."""
        return self.signals if isinstance(self.signals, Spool) else {"time_s": self.time_s, **self.signals}

    @property
    def _n_rows(self) -> int:
        return self.signals.n_rows if isinstance(self.signals, Spool) else self.time_s.size

    @cached_property
    def descriptions(self) -> dict[str, Signal]:
        """Name, label, unit and components of each signal."""
        vehicle = self.scenario.vehicle_data
        packages = {gyro.name: gyro_signal(gyro.name) for gyro in vehicle.gyros}
        packages |= {package.name: accelerometer_signal(package.name) for package in vehicle.accelerometers}
        packages |= {sensor.name: pose_signal(sensor.name) for sensor in vehicle.poses}
        packages |= {sensor.name: velocity_signal(sensor.name) for sensor in vehicle.velocities}
        packages |= {wheel.name: wheel_signal(wheel.name) for wheel in vehicle.wheels}
        packages |= {one.name: engine_signal(one.name, turns=one.gimbal is not None) for one in vehicle.engines}
        packages[PROPELLANT] = propellant_signal(tuple(tank.name for tank in vehicle.tanks))
        packages |= {against.name: against for against in map(simulated_signal, packages.values())}
        if isinstance(plant := self.scenario.plant, MultibodyBlock):
            packages[JOINTS] = joint_signal(plant.joint_columns, plant.joint_units)
        own = {name: own_signal(name, np.shape(self.signals[name])[1]) for name in self.signals if is_own(name)}
        return {name: SIGNALS.get(name) or packages.get(name) or own[name] for name in self.signals}

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each signal, in the vehicle's unit system."""
        names = self.scenario.vehicle_data.unit_names
        return {name: in_units(signal.unit, names) for name, signal in self.descriptions.items()}

    @cached_property
    def components(self) -> dict[str, tuple[str, ...]]:
        """Names of each signal's columns."""
        jets = self.scenario.vehicle_data.designations
        return {name: signal.components or jets for name, signal in self.descriptions.items()}

    @property
    def plot(self) -> Plots:
        """Plots of the run: `run.plot.rates()` and the others return matplotlib figures."""
        from massprop_drake.display.figures import Plots  # noqa: PLC0415 (matplotlib is slow to load)
        from massprop_drake.display.plot_source import source  # noqa: PLC0415

        return Plots(source(self.shown()))

    def shown(self) -> Run:
        """Downsamples a long run for plots and pages; a short one is returned as it is.

        Kept are the rows at which the rates and the NIS are extreme within each of many stretches of equal
        length, and rows with alarms, a few thousand in all. Rows are never averaged.
        """
        if self.thinned or self._n_rows <= _MANY_ROWS:
            return self
        keys = (params.main_sensor(self.scenario),)
        rows = outstanding_rows(self.signals, self._n_rows, keys=keys, peaks=_PEAKS, events=_EVENTS)
        signals = picked(self._rows, rows, leaving_out=_NOT_SHOWN)
        shown = Run(self.scenario, self.results, signals.pop("time_s"), signals, self.state)
        shown.thinned = True
        return shown

    def save(
        self,
        folder: str | Path | Place,
        *,
        force: bool = False,
        pictures: bool = True,
        report: bool = True,
        replay: bool = False,
    ) -> Path:
        """Writes the run's folder, whole or not at all.

        A part that cannot be made is left out and noted in `summary.json`; what it raised is raised once the rest is
        written. A run that lacks data takes no earlier run's place, which is kept as `<folder>.1`, `<folder>.2`, ....

        Args:
            folder: where to write. A folder of an earlier run is replaced, when every file in it is in its
                `manifest.json` and unchanged. A place that was found before the work says what was there then.
            force: keep what is there as `<folder>.1`, `<folder>.2`, ...; nothing is replaced then.
            pictures: draw the figures, which takes most of the time.
            report: write `report.html`.
            replay: write `replay.html`, the run in three dimensions.

        Raises:
            InputError: when the folder holds anything else, cannot be written, or has been changed by others since
                it was found; the message then says where the run is.
        """
        place = folder if isinstance(folder, Place) else require_writable(Path(folder), force=force)
        try:
            error = self._write(place, {"figures": pictures, "replay.html": replay, "report.html": report})
        except Exception:
            raise
        except BaseException as interruption:  # without pages, which take most of the time
            if place.is_as_found:
                self._write(place, {}, f"figures and pages: {in_words(interruption)}")
            raise
        if error is not None:
            raise error
        return place.shown

    def _write(self, place: Place, pages: Mapping[str, bool], *missing: str) -> Exception | None:
        """Writes the run's folder; parts that cannot be made are noted in its summary.

        Args:
            place: of the folder.
            pages: whether figures, replay and report are wanted.
            missing: parts that are known to be missing.

        Returns:
            The first error that was noted.
        """
        data, drawn = PartsMade(), PartsMade()
        with whole_folder(place, beside=lambda: bool(self.results.ended or data.missing)) as partial:

            def put(name: str, write: Callable[[Path], object], parts: PartsMade) -> None:
                try:
                    write(partial / name)
                except Exception as error:
                    if parts is data and isinstance(error, OSError):
                        raise
                    _remove(partial / name)
                    parts.note(name, error)

            put("scenario.yaml", lambda path: _put(path, yaml_text(self.scenario) + _END), data)
            put("telemetry.csv", self._write_telemetry, data)
            put("history.npz", self._write_history, data)
            if self.state:
                put(STATE_FILE, lambda path: _put(path, _json(self._filter_state(), FilterState, data)), data)
            shown = self.shown() if any(pages.values()) else self  # once: it takes a while
            if pages.get("figures"):
                put("figures", shown._draw, drawn)
            if pages.get("replay.html"):
                put("replay.html", shown._write_replay, drawn)
            if pages.get("report.html"):
                put("report.html", shown._write_report, drawn)
            noted = (*self.results.missing, *data.missing, *drawn.missing, *missing)
            results = replace(self.results, missing=noted) if noted else self.results
            content = storable(results.as_json(), SummaryFile, lost := PartsMade())
            if lost.missing:
                content["missing"] = [*noted, *lost.missing]
            _put(partial / "summary.json", _text(content))
        return data.error or drawn.error or lost.error

    def _draw(self, folder: Path) -> None:
        folder.mkdir()
        self.plot.save(folder)

    def _write_replay(self, path: Path) -> None:
        from massprop_drake.display.flight3d import replay_html  # noqa: PLC0415 (loads Drake)

        _put(path, replay_html(self))

    def _write_report(self, path: Path) -> None:
        from massprop_drake.display.page import report_html  # noqa: PLC0415 (loads templates)

        replay = path.with_name("replay.html")
        _put(path, report_html(self, replay=replay.name if replay.exists() else None))

    def export(self, to: str, path: str | Path, *, epoch_s: float | None = None, force: bool = False) -> Path:
        """Writes the run for viewers of others: signals with units, frames, a scene and messages.

        Args:
            to: "mcap", for Foxglove and PlotJuggler, or "rerun".
            path: of the file; it appears whole or not at all, and replaces nothing.
            epoch_s: time of the run's time zero, s since 1970; None: times are those of the run.
            force: keep a file that is there as `<path>.1`, `<path>.2`, ....

        Raises:
            InputError: when there is no such format, the package that writes it is missing, a file is there, or it
                cannot be written.
        """
        from massprop_drake.display import export  # noqa: PLC0415 (loads an extra)

        target, kind = Path(path), export.chosen(to).name
        content = export.Content(self, epoch_s=epoch_s)
        write_file(target, lambda ready: export.write(content, to, ready), kind, force=force)
        return target

    def note_end(self, error: BaseException, *, early: bool) -> None:
        """Notes in the results the reason for the end of the run.

        Args:
            error: what was raised.
            early: whether before the end of the scenario or the record.
        """
        why = in_words(error)
        if early:
            self.__dict__.pop("summary", None)
            self.results = replace(self.results, ended=Ended(float(self.time_s[-1]), why))
        elif not self.results.missing:
            self.note_missing(why)

    def note_missing(self, part: str) -> None:
        """Notes in the results a part that is left out, with the reason."""
        self.__dict__.pop("summary", None)
        self.results = replace(self.results, missing=(*self.results.missing, part))

    def _repr_html_(self) -> str:
        """Shows the ten parameters and what was found in a notebook."""
        from massprop_drake.display.page import summary_html  # noqa: PLC0415 (loads templates)

        return summary_html(self)

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

    @staticmethod
    def load(folder: str | Path) -> Run:
        """Reads a run back from its folder, also where a killed process has left it unfinished beside.

        Raises:
            InputError: when the folder holds no run that can be read.
        """
        path = Path(folder)
        results = read_summary(path)
        scenario = load_scenario(path / "scenario.yaml")
        if not read_text(path / "scenario.yaml").endswith(_END):
            raise InputError(f"{path / 'scenario.yaml'}: is cut short: it must end with '...'; run the scenario anew")
        joints = len(scenario.plant.joint_columns) if isinstance(scenario.plant, MultibodyBlock) else 0
        whole = results.ended is None and not results.missing
        time_s, signals = read_history(path / "history.npz", scenario.vehicle_data, joints=joints, whole=whole)
        state: dict[str, Any] = {}
        if exists(path / STATE_FILE):
            state = read_json(path / STATE_FILE)
            validated(FilterState, state, source=str(path / STATE_FILE))
        return Run(scenario, results, time_s, signals, state)

    def _write_telemetry(self, path: Path) -> None:
        rows.write_csv(path, self.scenario.vehicle_data, self._telemetry())

    def _telemetry(self) -> Iterator[rows.Rows]:
        """Yields the readings and commands, block by block."""
        sensors = self.scenario.vehicle_data.sensor_names()
        tracked = self.scenario.vehicle_data.tracked
        named = [sensor.name for sensor in tracked if sensor.name in self.signals]
        recorded = "gap" in self.signals
        optional = [name for name in ("gap", "outside_wrench", "command_onset") if name in self.signals]
        left = self._n_rows
        for block in blocks(self._rows, "time_s", "command", *sensors, *named, *optional):
            left -= block["time_s"].size
            commands, readings = block["command"], {name: block[name] for name in sensors}
            if not (recorded or left):
                commands = np.vstack([commands[:-1], np.full(commands.shape[1], np.nan)])  # none beyond the end
            there = block["gap"][:, 0] == 0.0 if recorded else np.ones(len(commands), dtype=bool)
            unread = (np.full((len(commands), len(sensor.columns)), np.nan) for sensor in tracked)
            read = [block.get(one.name, none) for one, none in zip(tracked, unread, strict=True)]
            followed = np.hstack(read) if read else None
            more = block.get("outside_wrench"), there, followed, block.get("command_onset")
            yield rows.Rows(block["time_s"], readings, commands, *more)

    def _write_history(self, path: Path) -> None:
        described = {name: {"unit": self.units[name], "components": self.components[name]} for name in self.units}
        write_npz(path, self._rows, described)

    def _filter_state(self) -> dict[str, Any]:
        return {
            **self.state,
            "estimate": null_for_nan(self.results.estimates),
            "covariance": null_for_nan(self.covariance),
        }


def _json(content: Any, schema: type[BaseModel], parts: PartsMade) -> str:
    return _text(storable(content, schema, parts))


def _text(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="")


def _remove(path: Path) -> None:
    """Removes a file that has been begun, or an empty folder."""
    if not path.is_dir():
        path.unlink(missing_ok=True)
    elif not any(path.iterdir()):
        path.rmdir()
