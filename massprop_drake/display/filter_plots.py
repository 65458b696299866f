"""Plots of the filter: its estimates with their 3 sigma, its innovations and their consistency."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.plot_source import DEGREES, Source, plot
from massprop_drake.display.spec import (
    Band,
    Line,
    Mark,
    Panel,
    Plot,
    Points,
    SymmetricLog,
    Whiskers,
    Zone,
)
from massprop_drake.display.style import BAND_COLOR, COLORS, THIN_LINE
from massprop_drake.inputs import params
from massprop_drake.maths.mass_properties import zero_floors
from massprop_drake.maths.signals import AXES, SYMBOLS, is_user_signal, mass_property_units
from massprop_drake.results.consistency import is_mean_dominated

Array = NDArray[np.float64]

NIS_LIMITS = (0.21579528262389802, 9.348403604496148)  # 2.5 and 97.5 % of chi-square, 3 degrees of freedom
_RARE_NIS = 11.344866730144373  # 99 % of chi-square, 3 degrees of freedom
_LEAST_NIS = 0.003  # that its axis shows: 1 in 24,000 of a consistent filter is less
DIAGONAL, PRODUCTS, CENTER = (0, 1, 2), (3, 4, 5), (6, 7, 8)  # of the ten parameters


def inverse_inertia_diagonal(run: Source) -> Plot:
    """Plots errors of the diagonal of the inverse inertia (figure 5-6a)."""
    return _parameter_plot(run, "inverse_inertia_diagonal", DIAGONAL, "Inverse inertia, diagonal")


def inverse_inertia_products(run: Source) -> Plot:
    """Plots errors of the products of the inverse inertia (figure 5-6b)."""
    return _parameter_plot(run, "inverse_inertia_products", PRODUCTS, "Inverse inertia, products")


def center_of_mass(run: Source) -> Plot:
    """Plots errors of the center of mass (figure 5-7)."""
    return _parameter_plot(run, "center_of_mass", CENTER, "Center of mass")


def mass_reciprocal(run: Source) -> Plot:
    """Plots the error of the mass reciprocal (figure 5-12)."""
    return _parameter_plot(run, "mass_reciprocal", (9,), "Mass reciprocal")


def _parameter_plot(run: Source, name: str, elements: tuple[int, ...], title: str) -> Plot:
    """Plots errors of some parameters with their 3-sigma band; estimates with theirs where no truth is known.

    The estimates of the user's own systems, outputs `estimate` of ten numbers, are drawn beside.
    """
    panel, what = (_error_panel, "estimation error") if run.simulated else (_estimate_panel, "estimate")
    return plot(run, name, f"{title}: {what}", [panel(run, element) for element in estimated_elements(run, elements)])


def other_estimates(run: Source, element: int) -> dict[str, tuple[Array, str]]:
    """Maps each of the user's own estimators to its estimates of a parameter, shape (n,), and its color."""
    names = [name for name in run.signals if is_user_signal(name) and name.endswith(".estimate")]
    found = {name.rpartition(".")[0]: run.signals[name] for name in names if run.signals[name].shape[1] == len(SYMBOLS)}
    there = {name: values[:, element] for name, values in found.items() if np.isfinite(values[:, element]).any()}
    return {name: (values, COLORS[3 + number % 3]) for number, (name, values) in enumerate(there.items())}


def estimated_elements(run: Source, elements: tuple[int, ...]) -> list[int]:
    """Returns the indices that the filter estimates: parameters neither fixed nor without effect in a plane."""
    known = params.known_parameters(run.scenario)
    return [element for element in elements if not known[element]]


def thrust_factors(run: Source) -> Plot:
    """Plots the estimated acceleration by each jet over the nominal one, one panel per jet."""
    factor, deviation = run.signals["thrust_factor"], run.signals["thrust_factor_std"]
    panels = []
    for jet, name in enumerate(run.vehicle.designations):
        value, band = factor[:, jet], 3.0 * deviation[:, jet]
        marks = (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.2g}"),
            Line(run.time_s, value, COLORS[jet % 3], f"factor, at the end {value[-1]:.3g}"),
        )
        panels.append(Panel(name, "", marks, limits=_estimate_limits(value, band)))
    title = "Thrust factors: acceleration by each jet over nominal"
    return plot(run, "thrust_factors", title, panels)


def surroundings(run: Source) -> Plot:
    """Plots estimated delay of commands, drag rates, and heading-dependent angular acceleration, with 3 sigma."""
    shown = [("command_delay", 0, "delay of commands", "s")]
    shown += [("drag_rate", 0, "drag", "1/s"), ("drag_rate", 1, "angular drag", "1/s")]
    shown += [("heading_turn", part, f"turning, {name}", "rad/s^2") for part, name in enumerate(("cosine", "sine"))]
    panels = []
    for number, (signal, column, label, unit) in enumerate(shown):
        value, deviation = (run.signals[name][:, column] for name in (signal, f"{signal}_std"))
        if not deviation.max(initial=0.0) > 0.0:  # known, or of no effect
            continue
        band = 3.0 * deviation
        marks = (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.2g} {unit}"),
            Line(run.time_s, value, COLORS[number % 3], f"estimate, at the end {value[-1]:.3g} {unit}"),
        )
        panels.append(Panel(label, unit, marks, limits=_estimate_limits(value, band)))
    meaning = "drag over mass, angular drag over inertia; turning: angular acceleration that goes with the heading"
    return plot(run, "surroundings", "Delay of commands, and surroundings", panels, meaning=meaning)


def _error_panel(run: Source, element: int) -> Panel:
    """Makes a panel of a parameter's estimation error, in percent of the truth, or in its unit where that is zero."""
    truth = run.signals["truth"]
    true = truth[:, element]
    unit, scale = mass_property_units(run.vehicle.unit_names)[element], np.ones_like(true)
    if (np.abs(true) > zero_floors(truth)[:, element]).all():
        unit, scale = "%", 100.0 / np.abs(true)
    error = scale * (run.signals["estimate"][:, element] - true)
    band = scale * 3.0 * run.signals["standard_deviation"][:, element]
    others = {name: (scale * (values - true), color) for name, (values, color) in other_estimates(run, element).items()}
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, -band, band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, error, COLORS[element % 3], f"error, at the end {error[-1]:.3g} {unit}"),
            *_other_lines(run, others, unit, 3),
        ),
        scale=SymmetricLog(float(band[-1]), float(np.nanmax(np.abs([error, band])))),
    )


def _estimate_panel(run: Source, element: int) -> Panel:
    """Makes a panel of a parameter's estimate with its 3-sigma band, scaled to the band's last half."""
    value = run.signals["estimate"][:, element]
    band = 3.0 * run.signals["standard_deviation"][:, element]
    unit = mass_property_units(run.vehicle.unit_names)[element]
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, value, COLORS[element % 3], f"estimate, at the end {value[-1]:.5g} {unit}"),
            *_other_lines(run, other_estimates(run, element), unit, 5),
        ),
        limits=_estimate_limits(value, band),
    )


def _other_lines(run: Source, others: Mapping[str, tuple[Array, str]], unit: str, digits: int) -> list[Line]:
    """Makes lines of estimates or errors of the user's own estimators, labeled with their last values."""
    return [
        Line(run.time_s, values, color, f"{name}, at the end {values[-1]:.{digits}g} {unit}", width=THIN_LINE)
        for name, (values, color) in others.items()
    ]


def _estimate_limits(value: Array, band: Array) -> tuple[float, float]:
    """Computes vertical limits for an estimate and the last half of its band, whose beginning may be huge."""
    half = value.size // 2
    low = min(float(value.min()), float((value - band)[half:].min()))
    high = max(float(value.max()), float((value + band)[half:].max()))
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def consistency(run: Source) -> Plot:
    """Plots NIS of rotation and of mass at the samples used (figures 5-8, 5-13)."""
    panels = []
    filters = [name for name in ("rotation", "mass") if f"{name}_nis" in run.signals]
    for name, color in zip(filters, COLORS, strict=False):
        used = run.nonzero_rows(f"{name}_used")
        nis = run.signals[f"{name}_nis"][used, 0]
        marks = (
            Zone(*NIS_LIMITS, label="95 % of chi-square, 3 degrees of freedom"),
            Points(run.time_s[used], nis, color, _nis_label(run, name, nis)),
        )
        most = float(nis.max(initial=NIS_LIMITS[1]))
        panels.append(Panel(f"{name} filter", "", marks, scale="log", limits=(_LEAST_NIS, 2.0 * most)))
    return plot(run, "consistency", "Consistency: NIS at the samples used", panels)


def innovations(run: Source) -> Plot:
    """Plots innovations of rotation at the samples used, with 3 sigma by the filter's own covariance."""
    return _innovations(run, "innovations", "rotation", DEGREES, "deg/s")


def mass_innovations(run: Source) -> Plot:
    """Plots innovations of translation at the samples used, with 3 sigma by the filter's own covariance."""
    return _innovations(run, "mass_innovations", "mass", 1.0, f"{run.vehicle.unit_names['length']}/s")


_TURNED_OR_MOVED = {"rotation": "rotation", "mass": "translation"}  # by how a filter's signals begin


def _innovations(run: Source, name: str, filter_name: str, scale: float, unit: str) -> Plot:
    """Plots the innovations of a filter at the samples used, a panel per axis."""
    used = run.nonzero_rows(f"{filter_name}_used")
    time_s, values = run.time_s[used], scale * run.signals[f"{filter_name}_innovation"][used]
    bands = 3.0 * scale * run.signals.get(f"{filter_name}_innovation_std", np.full((run.time_s.size, 3), np.nan))[used]
    panels = []
    for axis, letter in enumerate(AXES):
        value, band = values[:, axis], bands[:, axis]
        marks: list[Mark] = [Points(time_s, value, COLORS[axis], "innovation" if axis == 0 else "")]
        if np.isfinite(band).any():  # not in runs made before it was logged
            label = "3 sigma by the filter's own covariance" if axis == 0 else ""
            marks.insert(0, Whiskers(time_s, -band, band, BAND_COLOR, label))
        limit = _innovation_range(value, band)
        marks += _edge_triangles(time_s, value, limit, COLORS[axis])
        limits = (-limit, limit) if limit > 0.0 else None
        panels.append(Panel(letter, unit, tuple(marks), limits=limits, most=True))
    return plot(run, name, f"Innovations of {_TURNED_OR_MOVED[filter_name]} at the samples used", panels)


_NORMAL = 4.45  # 3 sigma of a normal distribution over the median of its magnitudes
_ROOM = 1.5  # that is left around
_EDGE, _EDGE_SIZE = 0.94, 5.0  # where a value beyond the limits stands, of them, and the size of its triangle, points


def _innovation_range(values: Array, band: Array) -> float:
    """Computes a panel's half range from medians: of the band, and of 3 sigma of the values; 0 without values.

    A median is the lower of two values, so that a page finds the same for a part of them.
    """
    found = [
        times * float(np.quantile(np.abs(part[np.isfinite(part)]), 0.5, method="lower"))
        for part, times in ((values, _NORMAL), (band, 1.0))
        if np.isfinite(part).any()
    ]
    return _ROOM * max(found, default=0.0)


def _edge_triangles(time_s: Array, values: Array, limit: float, color: str) -> list[Mark]:
    """Makes triangles at a panel's edges for the values beyond its limits, of either sign."""
    high, low = values > limit, values < -limit
    count = int(high.sum() + low.sum())
    note = f"{count} beyond the axis" if count else ""
    sides: tuple[tuple[NDArray[np.bool_], float, Literal["up", "down"], str], ...]
    sides = ((high, _EDGE, "up", note), (low, -_EDGE, "down", ""))
    return [
        Points(time_s[beyond], np.full(int(beyond.sum()), share * limit), color, label, _EDGE_SIZE, symbol)
        for beyond, share, symbol, label in sides
    ]


def _nis_label(run: Source, filter_name: str, nis: Array) -> str:
    """Labels a NIS curve with its mean, or the mean within the 99 % point where few samples dominate it."""
    means = run.consistency
    if means is None:
        mean = float(nis.mean()) if nis.size else None
        within, of = float(nis[nis <= _RARE_NIS].mean()) if (nis <= _RARE_NIS).any() else None, f"{nis.size}"
    else:
        mean, within = (means.get(f"{_TURNED_OR_MOVED[filter_name]}_nis_{which}") for which in ("mean", "within"))
        of = "all"
    if mean is None:
        return "NIS, no sample used"
    if within is None or not is_mean_dominated(mean, within):
        return f"NIS, mean {mean:.2f} of {of} samples{'' if means is None else ' used'}"
    return f"NIS, mean {within:.2f} ({mean:.4g} with those beyond 99 %)"
