"""The look of the reproduction's figures: panels over time, a color per case, phases as bands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from massprop_drake.display.filter_plots import NIS_LIMITS
from massprop_drake.display.style import BAND_COLOR, COLORS, LINE_WIDTH, TRUTH_COLOR, WINDOW_COLOR
from reproduction.claims import Array, Phases, Signals
from reproduction.measures import maneuver_windows, used

__all__ = ["BAND_COLOR", "COLORS", "TRUTH_COLOR"]

_CENTRAL = (0.025, 0.975)


def panels(count: int, title: str, *, windows: bool = True, height: float = 1.9) -> tuple[Figure, list[Axes]]:
    """Makes a figure of panels over time, one above the other."""
    figure = Figure(figsize=(9.0, height * count + 1.0), dpi=100, layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(count, 1, sharex=True)))
    figure.suptitle(title, fontsize=11)
    for panel in axes:
        tidy(panel)
        for window in maneuver_windows() if windows else ():
            panel.axvspan(window.start_s, window.end_s, color=WINDOW_COLOR, alpha=0.08, linewidth=0.0)
    meaning = "   (line: first phase, band: central 95 % of the phases; shaded: hand controller out of detent)"
    axes[-1].set_xlabel("time, s" + (meaning if windows else ""))
    return figure, axes


def tidy(panel: Axes) -> None:
    """Gives a panel a light grid, and no frame above and to the right."""
    panel.grid(alpha=0.25)
    panel.spines[["top", "right"]].set_visible(False)


def curves(
    panel: Axes,
    phases: Phases,
    labels: Mapping[str, str],
    value: Callable[[Signals], Array],
    *,
    points: bool = False,
    step: bool = False,
) -> None:
    """Plots each case in a color: the first phase as a line, the central 95 % of all phases as a band.

    Args:
        panel: to draw in.
        phases: results.
        labels: cases to draw, and what to call them.
        value: of a run, over its time, shape (n,); NaN is left out.
        points: whether samples are apart, and drawn so without a band.
        step: whether a value holds until the next.
    """
    for (case, label), color in zip(labels.items(), COLORS, strict=False):
        first = phases[0][case]
        time_s = first["time_s"]
        if points:
            panel.plot(time_s, value(first), ".", color=color, markersize=4, label=label)
            continue
        if len(phases) > 1:
            values = np.array([value(phase[case]) for phase in phases])
            low, high = np.quantile(values, _CENTRAL, axis=0)
            panel.fill_between(time_s, low, high, color=color, alpha=0.18, linewidth=0.0)
        style = "steps-post" if step else "default"
        panel.plot(time_s, value(first), color=color, linewidth=LINE_WIDTH, label=label, drawstyle=style)
    if len(labels) > 1:
        panel.legend(loc="upper right", fontsize=8, ncols=len(labels))


def chi_square_band(panel: Axes) -> None:
    """Shades the central 95 % of chi-square with three degrees of freedom."""
    panel.axhspan(*NIS_LIMITS, color=BAND_COLOR, alpha=0.3, linewidth=0.0)


def consistency(
    filter_name: str, title: str, labels: Mapping[str, str], *, symbol: str, height: float = 1.9
) -> Callable[[Phases], Figure]:
    """Makes a function that draws a filter's consistency function (NIS) at the samples used, a panel per case.

    Args:
        filter_name: rotation or mass.
        title: of the picture.
        labels: of the cases.
        symbol: of the function, on the vertical axes.
        height: of a panel, inches.
    """

    def value(run: Signals) -> Array:
        """Returns the consistency function at the samples used, NaN at others."""
        return np.where(used(run, filter_name), np.maximum(run[f"{filter_name}_nis"][:, 0], 1e-2), np.nan)

    def draw(phases: Phases) -> Figure:
        """Draws the picture from all phases."""
        figure, axes = panels(len(labels), title, height=height)
        for panel, (case, label) in zip(axes, labels.items(), strict=True):
            chi_square_band(panel)
            curves(panel, phases, {case: label}, value, points=True)
            panel.set_yscale("log")
            panel.set_ylabel(symbol)
            panel.set_title(label, fontsize=9, loc="left")
        return figure

    return draw


def heat_map(panel: Axes, values: Array, columns: Sequence[str], rows: Sequence[str], label: str) -> None:
    """Draws a table of shares from 0 to 1 as colors, with a bar for a legend."""
    picture = panel.imshow(values, aspect="auto", cmap="cividis", vmin=0.0, vmax=1.0)
    panel.set_xticks(range(len(columns)), columns, fontsize=8)
    panel.set_yticks(range(len(rows)), rows, fontsize=6)
    panel.set_xlabel("leak, lbf")
    panel.figure.colorbar(picture, ax=panel, label=label, shrink=0.6)
