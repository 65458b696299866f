"""A finished run: its summary, its signals, and how they are kept on disk."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake import telemetry
from massprop_drake.errors import InputError
from massprop_drake.files import whole_folder
from massprop_drake.models import yaml_text
from massprop_drake.scenario import Scenario, load_scenario
from massprop_drake.signals import SIGNALS, Signal, accelerometer_signal, gyro_signal, in_units
from massprop_drake.summary import null_for_nan

if TYPE_CHECKING:
    from massprop_drake.figures import Plots

Array = NDArray[np.float64]


class Run:
    """A scenario that has been run.

    Attributes:
        scenario: as run, in full.
        summary: as `summary.json`.
        signals: every logged signal by name, one row per sample, shape (n_samples, components); the
            unit of each is in `units`, the names of its columns in `components`. Sample times are
            `time_s`.
        covariance: of the ten estimates at the end, shape (10, 10).
    """

    def __init__(
        self,
        scenario: Scenario,
        summary: dict[str, Any],
        time_s: Array,
        signals: Mapping[str, Array],
        covariance: Array,
    ):
        self.scenario = scenario
        self.summary = summary
        self.time_s = time_s
        self.signals = dict(signals)
        self.covariance = covariance

    def __repr__(self) -> str:
        return f"<Run of '{self.scenario.name}', {self.time_s[-1]:g} s, seed {self.scenario.seed}>"

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]

    @cached_property
    def descriptions(self) -> dict[str, Signal]:
        """What each signal is."""
        vehicle = self.scenario.vehicle_data
        packages = {gyro.name: gyro_signal(gyro.name) for gyro in vehicle.gyros}
        packages |= {package.name: accelerometer_signal(package.name) for package in vehicle.accelerometers}
        return {name: SIGNALS.get(name) or packages[name] for name in self.signals}

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each signal, in the vehicle's units."""
        names = self.scenario.vehicle_data.unit_names
        return {name: in_units(signal.unit, names) for name, signal in self.descriptions.items()}

    @cached_property
    def components(self) -> dict[str, tuple[str, ...]]:
        """Names of each signal's columns."""
        jets = self.scenario.vehicle_data.designations
        return {name: signal.components or jets for name, signal in self.descriptions.items()}

    @property
    def plot(self) -> Plots:
        """Figures of this run: `run.plot.rates()` and the others return matplotlib figures."""
        from massprop_drake.figures import Plots  # noqa: PLC0415 (matplotlib is slow to load)

        return Plots(self.time_s, self.signals, self.scenario)

    def save(self, folder: str | Path, *, force: bool = False, pictures: bool = True) -> Path:
        """Writes the run's folder, whole or not at all.

        Args:
            folder: where; an earlier run's folder there is replaced.
            force: whether another, non-empty folder may be written into.
            pictures: whether to draw the figures, which takes most of the time.

        Raises:
            InputError: when the folder cannot be written.
        """
        target = Path(folder)
        with whole_folder(target, force=force) as partial:
            (partial / "scenario.yaml").write_text(yaml_text(self.scenario), encoding="utf-8")
            self._write_telemetry(partial / "telemetry.csv")
            self._write_history(partial / "history.npz")
            (partial / "filter_state.json").write_text(_json(self._filter_state()), encoding="utf-8")
            if pictures:
                (partial / "figures").mkdir()
                for name, figure in self.plot.all().items():
                    figure.savefig(partial / "figures" / f"{name}.png")
            (partial / "summary.json").write_text(_json(self.summary), encoding="utf-8")
        return target

    @staticmethod
    def load(folder: str | Path) -> Run:
        """A run from its folder.

        Raises:
            InputError: when the folder holds no run.
        """
        path = Path(folder)
        try:
            summary = json.loads((path / "summary.json").read_text(encoding="utf-8"))
            with (path / "history.npz").open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files if not name.startswith("_")}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise InputError(f"{path}: holds no run that can be read: {error}") from None
        scenario = load_scenario(path / "scenario.yaml")
        time_s = arrays.pop("time_s")
        return Run(scenario, summary, time_s, arrays, np.array(summary["covariance"], dtype=float))

    def _write_telemetry(self, path: Path) -> None:
        vehicle = self.scenario.vehicle_data
        commands = self.signals["command"].copy()
        commands[-1] = np.nan  # nothing is commanded beyond the end
        readings = {name: self.signals[name] for name in vehicle.sensor_names()}
        telemetry.write_csv(path, vehicle, self.time_s, readings, commands)

    def _write_history(self, path: Path) -> None:
        described = {name: {"unit": self.units[name], "components": self.components[name]} for name in self.signals}
        arrays = {"time_s": self.time_s, **self.signals, "_description": np.array(json.dumps(described))}
        np.savez_compressed(path, **arrays)  # type: ignore[arg-type]

    def _filter_state(self) -> dict[str, Any]:
        return {
            "format": 1,
            "time_s": float(self.time_s[-1]),
            "estimate": null_for_nan(self.signals["estimate"][-1]),
            "covariance": null_for_nan(self.covariance),
        }


def _json(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"
