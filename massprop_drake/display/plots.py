"""The interactive plots of a report, as data: which curves, in which units and colors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from massprop_drake.inputs import params
from massprop_drake.signals import (
    AXES,
    BAND_COLOR,
    COLORS,
    SIGNALS,
    SYMBOLS,
    TRUTH_COLOR,
    in_units,
    mass_property_units,
)

if TYPE_CHECKING:
    from massprop_drake.results.run import Run

Array = NDArray[np.float64]
Panel = dict[str, Any]

_DEGREES = 180.0 / np.pi
_DIGITS = 6  # of a number in the page


def panels(run: Run) -> list[Panel]:
    """Every plot of a run, in the order to read them."""
    return _Panels(run).all()


class _Panels:
    def __init__(self, run: Run):
        self._run = run
        self._signals = run.signals
        self._vehicle = run.scenario.vehicle_data
        self._names = self._vehicle.unit_names
        self._time = np.asarray(run.time_s)

    def all(self) -> list[Panel]:
        found = [self._rates(), *self._velocities(), self._jets()]
        found += [self._vector(name, steps=True) for name in ("torque", "force") if name in self._signals]
        found += [self._parameter(element) for element in range(10) if self._observed(element)]
        found += [self._consistency(name) for name in ("rotation", "mass") if f"{name}_nis" in self._signals]
        if "likelihood" in self._signals:
            found += [self._likelihoods(), self._margins(), self._magnitude()]
        return found

    # -------------------------------------------------------------------------------------- motion

    def _rates(self) -> Panel:
        name = "rate" if "rate" in self._signals else params.gyro(self._run.scenario).name
        return self._vector(name, unit="deg/s", scale=_DEGREES, title="Angular rate")

    def _velocities(self) -> list[Panel]:
        if "velocity" in self._signals:
            return [self._vector("velocity")]
        packages = params.accelerometers(self._run.scenario)
        return [self._vector(packages[0].name)] if packages else []

    def _vector(
        self, name: str, *, unit: str | None = None, scale: float = 1.0, title: str | None = None, steps: bool = False
    ) -> Panel:
        signal = self._run.descriptions[name]
        values = scale * np.asarray(self._signals[name])
        unit = unit or in_units(signal.unit, self._names)
        heading = title or signal.label[0].upper() + signal.label[1:]
        curves = [self._curve(values[:, axis], letter, COLORS[axis], steps=steps) for axis, letter in enumerate(AXES)]
        return _panel(name, heading, unit, curves)

    def _jets(self) -> Panel:
        """When each jet was commanded, a row per jet, by cluster."""
        command = np.nan_to_num(np.asarray(self._signals["command"])) > 0.0
        jets = self._vehicle.jets
        order = sorted(range(len(jets)), key=lambda index: (jets[index].cluster, index))
        after = np.append(self._time[1:], self._time[-1])
        by_cluster: dict[int, dict[str, list[Any]]] = {}
        for row, index in enumerate(order):
            on = command[:, index]
            begins = np.flatnonzero(on & ~np.append(False, on[:-1]))
            ends = np.flatnonzero(on & ~np.append(on[1:], False))
            curve = by_cluster.setdefault(jets[index].cluster, {"x": [], "y": [], "text": []})
            for begin, end in zip(begins, ends, strict=True):
                curve["x"] += [_rounded(self._time[begin]), _rounded(after[end]), None]
                curve["y"] += [row, row, None]
                curve["text"] += [jets[index].designation] * 2 + [""]
        curves = [
            {
                **curve,
                "mode": "lines",
                "name": f"cluster {cluster}",
                "color": COLORS[cluster % (len(COLORS) - 1)],
                "width": 5,
                "legend": False,
            }
            for cluster, curve in by_cluster.items()
        ]
        panel = _panel("jets", "Jets commanded, by cluster", "", curves)
        panel["rows"] = [f"{jets[index].designation} ({jets[index].cluster})" for index in order]
        panel["height"] = 80 + 13 * len(order)
        return panel

    # ----------------------------------------------------------------------------------- estimates

    def _observed(self, element: int) -> bool:
        return bool(np.isfinite(np.asarray(self._signals["estimate"])[:, element]).any())

    def _parameter(self, element: int) -> Panel:
        """Estimation error and 3-sigma or, where the truth is unknown, the estimate within its band."""
        estimate = np.asarray(self._signals["estimate"])[:, element]
        deviation = np.asarray(self._signals["standard_deviation"])[:, element]
        unit = mass_property_units(self._names)[element]
        color = COLORS[element % 3]
        if "truth" not in self._signals:
            curves = self._band(estimate - 3.0 * deviation, estimate + 3.0 * deviation)
            curves.append(self._curve(estimate, "estimate", color))
            return _panel(f"parameter{element}", f"{SYMBOLS[element]}: estimate and 3-sigma", unit, curves)
        truth = np.asarray(self._signals["truth"])
        true = truth[:, element]
        scale = np.ones_like(true)
        if np.abs(true).max() > 1e-12 * np.abs(truth).max():
            unit, scale = "%", 100.0 / np.abs(true)
        error, band = scale * (estimate - true), scale * 3.0 * deviation
        curves = [
            *self._band(-band, band, view="linear"),
            self._curve(error, "error", color, view="linear"),
            self._curve(band, "3-sigma", BAND_COLOR, view="log"),
            self._curve(np.abs(error), "|error|", color, view="log"),
        ]
        panel = _panel(f"parameter{element}", f"{SYMBOLS[element]}: estimation error", unit, curves)
        panel["views"] = True
        return panel

    def _band(self, low: Array, high: Array, view: str = "") -> list[dict[str, Any]]:
        lower = self._curve(low, "", BAND_COLOR, view=view)
        upper = self._curve(high, "3-sigma", BAND_COLOR, view=view)
        return [{**lower, "width": 0, "legend": False}, {**upper, "width": 0, "fill": True}]

    def _consistency(self, name: str) -> Panel:
        used = np.asarray(self._signals[f"{name}_used"])[:, 0] != 0.0
        nis = np.where(used, np.asarray(self._signals[f"{name}_nis"])[:, 0], np.nan)
        panel = _panel(
            f"{name}_nis", f"{SIGNALS[f'{name}_nis'].label}, samples used", "", [self._dots(nis, "NIS", COLORS[0])]
        )
        panel["log"] = True
        panel["bands"] = [[float(value) for value in chdtri(3, [0.975, 0.025])]]
        panel["note"] = "shaded: 95 % of chi-square with 3 degrees of freedom"
        return panel

    # ------------------------------------------------------------------------------------ detector

    def _likelihoods(self) -> Panel:
        likelihood = np.maximum(np.asarray(self._signals["likelihood"]), 0.1)
        tested = np.isfinite(likelihood).any(axis=1)
        peak = likelihood[tested].max(axis=0) if tested.any() else np.zeros(likelihood.shape[1])
        highest = np.argsort(-peak)[:5]
        curves = [
            self._dots(likelihood[:, jet], self._vehicle.designations[jet], color)
            for jet, color in zip(highest, COLORS, strict=False)
        ]
        panel = _panel("likelihood", "Likelihood arguments of the five likeliest jets", "", curves)
        panel["log"] = True
        return panel

    def _margins(self) -> Panel:
        tested = np.asarray(self._signals["tested"])[:, 0] != 0.0
        curves = []
        for name, words, color in (
            ("cluster_margin", "cluster, over all others", COLORS[0]),
            ("jet_margin", "jet, within its cluster", COLORS[1]),
        ):
            margin = np.maximum(np.asarray(self._signals[name])[:, 0], 0.1)
            curves.append(self._dots(np.where(tested, margin, np.nan), words, color))
        panel = _panel("margins", "Margins of the likeliest cluster and jet", "", curves)
        panel["log"] = True
        panel["lines"] = [self._run.scenario.detector.margin]
        return panel

    def _magnitude(self) -> Panel:
        alarm = np.asarray(self._signals["alarm"])[:, 0] != 0.0
        magnitude = np.where(alarm, np.asarray(self._signals["suspected_magnitude"])[:, 0], np.nan)
        curves = [self._dots(magnitude, "at alarms, likeliest jet", COLORS[0])]
        variance = np.asarray(self._signals["known_force_variance"])
        force = np.asarray(self._signals["known_force"])
        for jet in np.flatnonzero((variance > 0.0).any(axis=0)):
            known = np.where(variance[:, jet] > 0.0, force[:, jet], np.nan)
            words = f"known force, {self._vehicle.designations[jet]}"
            curves.append(self._curve(known, words, COLORS[1]))
        if "thrust" in self._signals:
            for name in sorted({failure.jet for failure in self._run.scenario.failures}):
                index = self._vehicle.jet_index(name)
                full = self._vehicle.jets[index].thrust
                command = np.nan_to_num(np.asarray(self._signals["command"])[:, index])
                true = np.asarray(self._signals["thrust"])[:, index] - full * command
                curves.append(self._curve(true, f"truth, {name}", TRUTH_COLOR, steps=True))
        return _panel("magnitude", "Magnitude of the failure", self._names["force"], curves)

    # ------------------------------------------------------------------------------------- helpers

    def _curve(self, values: Array, name: str, color: str, *, steps: bool = False, view: str = "") -> dict[str, Any]:
        curve: dict[str, Any] = {"y": _numbers(values), "name": name, "color": color, "mode": "lines"}
        if steps:
            curve["steps"] = True
        if view:
            curve["view"] = view
        return curve

    def _dots(self, values: Array, name: str, color: str) -> dict[str, Any]:
        """Points at the samples that have a value; the others are left out of the page."""
        rows = np.flatnonzero(np.isfinite(values))
        times = [_rounded(value) for value in self._time[rows].tolist()]
        return {"x": times, "y": _numbers(values[rows]), "name": name, "color": color, "mode": "markers"}


def _panel(name: str, title: str, unit: str, curves: Sequence[dict[str, Any]]) -> Panel:
    return {"name": name, "title": title, "unit": unit, "curves": list(curves)}


def _numbers(values: Array) -> list[float | None]:
    return [_rounded(value) if np.isfinite(value) else None for value in values.tolist()]


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
