"""Figures of named signals, in the manner of figures 5-2 to 5-15 of the thesis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullLocator
from numpy.typing import NDArray
from scipy.special import chdtri

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import HandControllerWindow, Scenario
from massprop_drake.signals import (
    BAND_COLOR,
    COLORS,
    SIGNALS,
    SYMBOLS,
    TRUTH_COLOR,
    WINDOW_COLOR,
    in_units,
    mass_property_units,
)

Array = NDArray[np.float64]

_LINE_WIDTH = 1.1
_DEGREES = 180.0 / np.pi


class _Drawings(Mapping[str, Figure]):
    """Figures that are drawn when they are asked for, so that one at a time is held."""

    def __init__(self, drawings: Mapping[str, Callable[[], Figure]]):
        self._drawings = drawings

    def __getitem__(self, name: str) -> Figure:
        return self._drawings[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._drawings)

    def __len__(self) -> int:
        return len(self._drawings)


class Plots:
    """Draws a run's signals; every method returns a matplotlib figure.

    Args:
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        scenario: for units, maneuver windows and jets.
        consistency: mean NIS and number of samples used, as in the summary; needed where the signals are not
            complete, else taken from them.
    """

    def __init__(
        self,
        time_s: Array,
        signals: Mapping[str, Array],
        scenario: Scenario,
        *,
        consistency: Mapping[str, float | None] | None = None,
    ):
        self._time_s = time_s
        self._signals = signals
        self._scenario = scenario
        self._consistency = consistency
        self._simulated = "truth" in signals
        self._vehicle = scenario.vehicle_data
        self._names = self._vehicle.unit_names
        self._windows = [window for window in scenario.maneuver if window.start_s < time_s[-1]]

    def all(self) -> Mapping[str, Figure]:
        """Every figure by name, in the order to read them; each is drawn when it is asked for."""
        drawings: dict[str, Callable[[], Figure]] = {
            "rates": self.rates,
            "velocities": self.velocities,
            "jets": self.jets,
            "torques": self.torques,
            "forces": self.forces,
            "inverse_inertia_diagonal": self.inverse_inertia_diagonal,
            "inverse_inertia_products": self.inverse_inertia_products,
            "center_of_mass": self.center_of_mass,
            "mass_reciprocal": self.mass_reciprocal,
            "consistency": self.consistency,
        }
        if not self._simulated:  # recorded telemetry: what was read, in place of what was true
            for name in ("rates", "velocities", "torques", "forces"):
                del drawings[name]
            drawings = {"gyro_readings": self.gyro_readings, **drawings}
            if self._vehicle.accelerometers:
                drawings = {"accelerometer_velocities": self.accelerometer_velocities, **drawings}
        if "mass_nis" not in self._signals:  # no accelerometer
            del drawings["mass_reciprocal"]
        if "likelihood" in self._signals:
            drawings |= {
                "likelihoods": self.likelihoods,
                "margins": self.margins,
                "failure_magnitude": self.failure_magnitude,
                "detection_timeline": self.detection_timeline,
            }
        return _Drawings(drawings)

    def rates(self) -> Figure:
        """Angular velocity (figure 5-2)."""
        return self._three_axes("rate", "Angular rate", "deg/s", scale=_DEGREES)

    def velocities(self) -> Figure:
        """Velocity of the center of mass relative to the start (figure 5-3)."""
        return self._three_axes("velocity", "Velocity of the center of mass, relative to the start, inertial axes")

    def gyro_readings(self) -> Figure:
        """Angular rate as each gyro package read it."""
        names = [gyro.name for gyro in self._vehicle.gyros]
        return self._readings(names, "Angular rate, as read", "deg/s", _DEGREES)

    def accelerometer_velocities(self) -> Figure:
        """Integrated specific force as each accelerometer package read it."""
        names = [package.name for package in self._vehicle.accelerometers]
        return self._readings(names, "Integrated specific force, as read", f"{self._names['length']}/s", 1.0)

    def _readings(self, names: Sequence[str], title: str, unit: str, scale: float) -> Figure:
        figure, axes = self._panels(3, title)
        for axis, (panel, letter) in enumerate(zip(axes, "xyz", strict=True)):
            for name, color in zip(names, COLORS * (1 + len(names) // len(COLORS)), strict=False):
                values = scale * self._signals[name][:, axis]
                panel.plot(self._time_s, values, color=color, linewidth=_LINE_WIDTH, label=name)
            panel.set_ylabel(f"{letter}, {unit}")
        if len(names) > 1:
            axes[0].legend(loc="upper left", fontsize=8, ncols=3)
        return figure

    def torques(self) -> Figure:
        """Applied torque about the center of mass (figure 5-4)."""
        return self._three_axes("torque", "Applied torque about the center of mass", steps=True)

    def forces(self) -> Figure:
        """Applied force (figure 5-5)."""
        return self._three_axes("force", "Applied force", steps=True)

    def inverse_inertia_diagonal(self) -> Figure:
        """Errors of the diagonal of the inverse inertia (figure 5-6a)."""
        return self._errors((0, 1, 2), "Inverse inertia, diagonal")

    def inverse_inertia_products(self) -> Figure:
        """Errors of the products of the inverse inertia (figure 5-6b)."""
        return self._errors((3, 4, 5), "Inverse inertia, products")

    def center_of_mass(self) -> Figure:
        """Errors of the center of mass (figure 5-7)."""
        return self._errors((6, 7, 8), "Center of mass")

    def mass_reciprocal(self) -> Figure:
        """Error of the mass reciprocal (figure 5-12)."""
        return self._errors((9,), "Mass reciprocal")

    def consistency(self) -> Figure:
        """NIS of both filters at the samples used (figures 5-8, 5-13)."""
        filters = [(name, f"{name} filter") for name in ("rotation", "mass") if f"{name}_nis" in self._signals]
        figure, axes = self._panels(len(filters), "Consistency: NIS at the samples used")
        for panel, (name, label), color in zip(axes, filters, COLORS, strict=False):
            used = self._signals[f"{name}_used"][:, 0] != 0.0
            nis = self._signals[f"{name}_nis"][used, 0]
            panel.axhspan(*chdtri(3, [0.975, 0.025]), color=BAND_COLOR, alpha=0.35, linewidth=0.0)
            panel.plot(self._time_s[used], nis, ".", color=color, markersize=4)
            panel.set_yscale("log")
            panel.set_ylabel(f"NIS, {label}")
            mean = self._mean_nis(name, nis)
            handles = [
                Line2D([], [], color=color, marker=".", linestyle="", label=mean),
                Patch(color=BAND_COLOR, alpha=0.35, label="95 % of chi-square, 3 degrees of freedom"),
            ]
            panel.legend(handles=handles, loc="upper right", fontsize=8, ncols=2)
        return figure

    def _mean_nis(self, name: str, nis: Array) -> str:
        if self._consistency is None:
            return f"mean {nis.mean():.2f} of {nis.size} samples" if nis.size else "no sample used"
        mean = self._consistency["rotation_nis_mean" if name == "rotation" else "translation_nis_mean"]
        return "no sample used" if mean is None else f"mean {mean:.2f} of all samples used"

    def jets(self) -> Figure:
        """Which jet was commanded when, by cluster."""
        command = self._signals["command"]
        jets = self._vehicle.jets
        order = sorted(range(len(jets)), key=lambda index: (jets[index].cluster, index))
        figure = Figure(figsize=(9.0, max(3.0, 0.15 * len(jets) + 1.2)), dpi=110, layout="constrained")
        panel = figure.add_subplot()
        # up to the next row: where rows are left out, what a row commands is drawn that far
        lengths = np.append(np.diff(self._time_s), self._vehicle.sample_period_s)
        for row, index in enumerate(order):
            on = np.flatnonzero(command[:, index] > 0.0)
            spans = list(zip(self._time_s[on].tolist(), lengths[on].tolist(), strict=True))
            color = COLORS[jets[index].cluster % (len(COLORS) - 1)]
            panel.broken_barh(spans, (row - 0.42, 0.84), facecolors=color, linewidth=0.0)
        panel.set_yticks(range(len(order)))
        panel.set_yticklabels([f"{jets[i].designation}  ({jets[i].cluster})" for i in order], fontsize=7)
        panel.set_ylim(len(order) - 0.4, -0.6)
        panel.set_ylabel("jet (cluster)")
        panel.grid(axis="y", alpha=0.15)
        figure.suptitle(f"Jets commanded   ({self._caption()})", fontsize=11)
        self._finish([panel])
        return figure

    def likelihoods(self) -> Figure:
        """Likelihood arguments of all jets, and of the clusters (figures 5-16, 5-19, 5-22, 5-25)."""
        figure, axes = self._panels(2, "Likelihood arguments of a failed jet")
        likelihood = self._signals["likelihood"]
        clusters = np.array([jet.cluster for jet in self._vehicle.jets])
        numbers = np.unique(clusters)
        by_cluster = np.stack([likelihood[:, clusters == number].max(axis=1) for number in numbers], axis=1)
        tested = self._signals["tested"][:, 0] != 0.0
        names = (list(self._vehicle.designations), [f"cluster {number}" for number in numbers])
        for panel, values, labels in zip(axes, (likelihood, by_cluster), names, strict=True):
            shown = np.maximum(values[tested], 0.1)
            panel.set_yscale("log")
            panel.set_ylim(0.1, max(10.0, 2.0 * float(shown.max(initial=1.0))))
            if not shown.size:
                continue
            # the three that ever reach highest are named, the others are gray
            top = np.argsort(-shown.max(axis=0))[:3]
            rest = np.setdiff1d(np.arange(shown.shape[1]), top)
            panel.plot(self._time_s[tested], shown[:, rest], ".", color=BAND_COLOR, markersize=2)
            for color, column in zip(COLORS, top, strict=False):
                panel.plot(self._time_s[tested], shown[:, column], ".", color=color, markersize=4, label=labels[column])
            panel.legend(loc="upper left", fontsize=8, ncols=3)
        axes[0].set_ylabel("of the jets")
        axes[1].set_ylabel("of the clusters")
        return figure

    def margins(self) -> Figure:
        """Margins of the likeliest jet and cluster (figures 5-17, 5-20, 5-23, 5-26)."""
        figure, axes = self._panels(2, "Margins of the likeliest")
        tested = self._signals["tested"][:, 0] != 0.0
        limit = self._scenario.detector.margin
        sides = (("jet_margin", "jet, within its cluster"), ("cluster_margin", "cluster, over all others"))
        for panel, (name, label), color in zip(axes, sides, COLORS, strict=False):
            values = np.maximum(self._signals[name][tested, 0], 0.1)
            panel.plot(self._time_s[tested], values, ".", color=color, markersize=4)
            panel.axhline(limit, color=TRUTH_COLOR, linewidth=0.8, linestyle="--", label=f"isolated above {limit:g}")
            panel.set_yscale("log")
            panel.set_ylabel(label)
            panel.legend(loc="upper left", fontsize=8)
        return figure

    def failure_magnitude(self) -> Figure:
        """Estimated magnitude of the likeliest jet where there is an alarm, with 1-sigma and the truth
        (figures 5-18, 5-21, 5-24, 5-27), and the known force from then on.
        """
        figure, axes = self._panels(1, "Magnitude of the failure")
        panel = axes[0]
        alarm = np.flatnonzero(self._signals["alarm"][:, 0])
        if alarm.size:
            jets = self._signals["suspected_jet"][alarm, 0].astype(int)
            magnitude = self._signals["suspected_magnitude"][alarm, 0]
            deviation = self._signals["suspected_magnitude_std"][alarm, 0]
            panel.errorbar(
                self._time_s[alarm],
                magnitude,
                deviation,
                fmt=".",
                color=COLORS[0],
                markersize=4,
                elinewidth=0.8,
                label="likeliest jet, 1-sigma",
            )
            suspects = dict.fromkeys(jets.tolist() if self._simulated else [])
            for jet, color in zip(suspects, (TRUTH_COLOR, *COLORS[2:]), strict=False):
                full = self._vehicle.jets[jet].thrust
                truth = self._signals["thrust"][:, jet] - full * self._signals["command"][:, jet]
                label = f"truth, {self._vehicle.designations[jet]}"
                panel.plot(self._time_s, truth, color=color, linewidth=0.9, drawstyle="steps-post", label=label)
        known = self._signals["known_force_variance"] > 0.0
        for jet in np.flatnonzero(known.any(axis=0)):
            force = np.where(known[:, jet], self._signals["known_force"][:, jet], np.nan)
            label = f"known force, {self._vehicle.designations[jet]}"
            panel.plot(self._time_s, force, color=COLORS[1], linewidth=1.4, linestyle="--", label=label)
        panel.set_ylabel(self._names["force"])
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="upper left", fontsize=8)
        return figure

    def detection_timeline(self) -> Figure:
        """Failures, alarms and declarations over the rates and the number of jets commanded."""
        figure, axes = self._panels(3, "Detection")
        rates = self._signals["rate" if self._simulated else params.gyro(self._scenario).name]
        for axis, letter in enumerate(SIGNALS["rate"].components):
            rate = _DEGREES * rates[:, axis]
            axes[0].plot(self._time_s, rate, color=COLORS[axis], linewidth=_LINE_WIDTH, label=letter)
        axes[0].set_ylabel("rate, deg/s")
        axes[0].legend(loc="upper left", fontsize=8, ncols=3)
        count = (self._signals["command"] > 0.0).sum(axis=1)
        axes[1].fill_between(self._time_s, count, step="post", color=COLORS[0], alpha=0.6, linewidth=0.0)
        axes[1].set_ylabel("jets commanded")
        rows = ("tested", "alarm", "jet_isolated")
        for row, (name, color) in enumerate(zip(rows, (BAND_COLOR, COLORS[4], COLORS[1]), strict=True)):
            at = self._time_s[self._signals[name][:, 0] != 0.0]
            axes[2].plot(at, np.full(at.shape, -row), "|", color=color, markersize=9)
        axes[2].set_yticks([0, -1, -2], ["tested", "alarm", "names the jet"], fontsize=8)
        axes[2].set_ylim(-2.6, 0.6)
        events = self._signals["detector_event"][:, 0]
        for panel in axes:
            for failure in self._scenario.failures:
                panel.axvline(failure.start_s, color=TRUTH_COLOR, linewidth=0.9, linestyle=":")
            for jump in self._scenario.jumps:
                panel.axvline(jump.time_s, color=TRUTH_COLOR, linewidth=0.9, linestyle=":")
            for time in self._time_s[events != 0.0]:
                panel.axvline(time, color=COLORS[1], linewidth=0.9)
        dotted = "dotted: it happens, " if self._simulated else ""
        axes[-1].set_xlabel(f"time, s   ({dotted}red line: it is declared)")
        return figure

    # ------------------------------------------------------------------------------------ drawing

    def _caption(self) -> str:
        drawn = f", seed {self._scenario.seed}" if self._simulated else ""
        return f"{self._vehicle.name}, {self._scenario.name}{drawn}"

    def _panels(self, count: int, title: str) -> tuple[Figure, list[Axes]]:
        figure = Figure(figsize=(9.0, 1.9 * count + 1.0), dpi=110, layout="constrained")
        axes = list(np.atleast_1d(figure.subplots(count, 1, sharex=True)))
        figure.suptitle(f"{title}   ({self._caption()})", fontsize=11)
        self._finish(axes)
        return figure, axes

    def _finish(self, axes: Sequence[Axes]) -> None:
        for panel in axes:
            panel.grid(alpha=0.25)
            panel.spines[["top", "right"]].set_visible(False)
            if self._time_s[-1] > self._time_s[0]:
                panel.set_xlim(float(self._time_s[0]), float(self._time_s[-1]))
            for window in self._windows:
                panel.axvspan(window.start_s, window.end_s, color=WINDOW_COLOR, alpha=0.10, linewidth=0.0)
        for window in self._windows:
            self._label_window(axes[0], window)
        shaded = "   (shaded: hand controller out of detent)" if self._windows else ""
        axes[-1].set_xlabel(f"time, s{shaded}")

    def _label_window(self, panel: Axes, window: HandControllerWindow) -> None:
        # windows that begin together are labeled one above the other
        same = [w for w in self._windows if w.start_s == window.start_s]
        panel.annotate(
            f"{window.controller.upper()} {window.axis}",
            xy=(window.start_s, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(1, 2 + 8 * same.index(window)),
            textcoords="offset points",
            fontsize=6,
            color="#555555",
            annotation_clip=False,
        )

    def _three_axes(
        self, name: str, title: str, unit: str | None = None, *, scale: float = 1.0, steps: bool = False
    ) -> Figure:
        signal = SIGNALS[name]
        figure, axes = self._panels(3, title)
        values = scale * self._signals[name]
        style = "steps-post" if steps else "default"
        for axis, (panel, letter) in enumerate(zip(axes, signal.components, strict=True)):
            panel.plot(self._time_s, values[:, axis], color=COLORS[axis], linewidth=_LINE_WIDTH, drawstyle=style)
            panel.set_ylabel(f"{letter}, {unit or in_units(signal.unit, self._names)}")
        return figure

    def _errors(self, elements: tuple[int, ...], title: str) -> Figure:
        """Estimation errors in percent of the truth, with their 3-sigma band; without truth the estimates."""
        if not self._simulated:
            return self._estimates(elements, title)
        figure, axes = self._panels(len(elements), f"{title}: estimation error")
        truth = self._signals["truth"]
        units = mass_property_units(self._names)
        for panel, element in zip(axes, elements, strict=True):
            true = truth[:, element]
            size = np.abs(true).max()
            relative = size > 1e-12 * np.abs(truth).max()
            scale = 100.0 / np.abs(true) if relative else np.ones_like(true)
            error = scale * (self._signals["estimate"][:, element] - true)
            band = scale * 3.0 * self._signals["standard_deviation"][:, element]
            panel.fill_between(self._time_s, -band, band, color=BAND_COLOR, alpha=0.35, linewidth=0.0)
            panel.plot(self._time_s, error, color=COLORS[element % 3], linewidth=_LINE_WIDTH)
            unit = "%" if relative else units[element]
            symmetric_log(panel, float(band[-1]), float(np.nanmax(np.abs([error, band]))))
            panel.set_ylabel(f"{SYMBOLS[element]}, {unit}")
            handles = [
                Line2D([], [], color=COLORS[element % 3], label=f"error, at the end {error[-1]:.3g} {unit}"),
                Patch(color=BAND_COLOR, alpha=0.35, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            ]
            panel.legend(handles=handles, loc="upper right", fontsize=8, ncols=2)
        return figure

    def _estimates(self, elements: tuple[int, ...], title: str) -> Figure:
        """Estimates with their 3-sigma band, on a scale that the end of the record sets."""
        figure, axes = self._panels(len(elements), f"{title}: estimate")
        units = mass_property_units(self._names)
        for panel, element in zip(axes, elements, strict=True):
            value = self._signals["estimate"][:, element]
            band = 3.0 * self._signals["standard_deviation"][:, element]
            color, unit = COLORS[element % 3], units[element]
            panel.fill_between(self._time_s, value - band, value + band, color=BAND_COLOR, alpha=0.35, linewidth=0.0)
            panel.plot(self._time_s, value, color=color, linewidth=_LINE_WIDTH)
            panel.set_ylim(*_last_half(value, band))
            panel.set_ylabel(f"{SYMBOLS[element]}, {unit}")
            handles = [
                Line2D([], [], color=color, label=f"estimate, at the end {value[-1]:.5g} {unit}"),
                Patch(color=BAND_COLOR, alpha=0.35, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            ]
            panel.legend(handles=handles, loc="upper right", fontsize=8, ncols=2)
        return figure


def _last_half(value: Array, band: Array) -> tuple[float, float]:
    """Limits of an axis that show an estimate, and its band over the last half; the first band may be huge."""
    half = value.size // 2
    low = min(float(value.min()), float((value - band)[half:].min()))
    high = max(float(value.max()), float((value + band)[half:].max()))
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + 3.0 * margin


def symmetric_log(panel: Axes, small: float, large: float) -> None:
    """A vertical axis that is linear up to the final band and logarithmic beyond, with few marks."""
    first = math.ceil(math.log10(max(small, 1e-300)))
    last = max(math.floor(math.log10(max(large, 1e-300))), first)
    step = max(1, round((last - first) / 3))
    marks = [10.0**power for power in range(first, last + 1, step)]
    panel.set_yscale("symlog", linthresh=10.0**first, linscale=0.8)
    panel.set_yticks([*(-mark for mark in reversed(marks)), 0.0, *marks])
    panel.yaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
