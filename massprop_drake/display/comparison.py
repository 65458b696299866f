"""Comparison page of runs side by side: the estimates and findings of each, and their plots overlaid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from massprop_drake.display import interactive, plots, templates
from massprop_drake.display.plot_source import Source
from massprop_drake.display.spec import Band, Line, Mark, Panel, Plot, Points, SymmetricLog
from massprop_drake.display.style import COLORS
from massprop_drake.maths.signals import SYMBOLS, mass_property_units
from massprop_drake.results.detections import in_words
from massprop_drake.results.summary import Parameter

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

_HERE = Path(__file__).parent
_BAND_OPACITY = 0.15  # of bands over each other
_OVERLAID = (
    "rates",
    "velocities",
    "gyro_readings",
    "accelerometer_velocities",
    "rates_estimated",
    "inverse_inertia_diagonal",
    "inverse_inertia_products",
    "center_of_mass",
    "mass_reciprocal",
    "consistency",
    "thrust_factors",
    "surroundings",
)


def comparison_html(runs: Sequence[tuple[str, RunContent]]) -> str:
    """Returns the comparison page of runs as the text of one HTML file that needs no network.

    Args:
        runs: of one vehicle, each with a name.
    """
    shown = [(name, run.thin_for_plots()) for name, run in runs]
    sources = _comparable_sources([(name, plots.source(run)) for name, run in shown])
    longest = max((source.time_s for _, source in sources), key=lambda time_s: float(time_s[-1]))
    drawn = [interactive.plotly_figure(plot) for plot in overlay_plots(sources)]
    content = {
        "title": " and ".join(name for name, _ in runs),
        "names": [name for name, _ in runs],
        "parameters": _parameter_rows(runs),
        "found": [_findings_text(run) for _, run in runs],
        "vehicle": runs[0][1].results.vehicle,
        "from_zero": any(one.time_s[0] != run.time_s[0] for (_, one), (_, run) in zip(sources, shown, strict=True)),
    }
    return templates.page(
        _HERE / "comparison.html",
        content,
        data={"time": interactive.round_times(longest), **interactive.pack_figures(drawn), "jumps": []},
        styles=[(_HERE / "report.css").read_text(encoding="utf-8")],
        scripts=interactive.scripts(),
        extra_policy=interactive.NEEDS,
    )


def _comparable_sources(runs: Sequence[tuple[str, Source]]) -> list[tuple[str, Source]]:
    """Returns the runs' sources by name, adapted for overlaid plots: common signals, and times that overlap.

    Beside a record, whose truth is unknown, a simulated run shows its estimates, too, not their errors. Runs that
    have no time in common all begin at zero.
    """
    sources = [source for _, source in runs]
    if len({source.simulated for source in sources}) > 1:
        sources = [
            source._replace(signals={name: source.signals[name] for name in source.signals if name != "truth"})
            for source in sources
        ]
    if max(source.time_s[0] for source in sources) >= min(source.time_s[-1] for source in sources):
        sources = [source._replace(time_s=source.time_s - source.time_s[0]) for source in sources]
    return [(name, source) for (name, _), source in zip(runs, sources, strict=True)]


def overlay_plots(runs: Sequence[tuple[str, Source]]) -> list[Plot]:
    """Makes one overlaid plot for each plot that all runs have, with one color per run; runs with their names."""
    available = [plots.available_plots(source) for _, source in runs]
    names = [name for name in _OVERLAID if all(name in each for each in available)]
    made = {name: [each[name](source) for each, (_, source) in zip(available, runs, strict=True)] for name in names}
    called = [name for name, _ in runs]
    return [_overlay_plot(each, called) for each in made.values() if len({len(plot.panels) for plot in each}) == 1]


def _overlay_plot(plots: Sequence[Plot], names: Sequence[str]) -> Plot:
    """Merges the same plot of several runs into one plot, over the times of the longest run."""
    longest = max(plots, key=lambda plot: float(plot.time_s[-1]))
    panels = []
    for parts in zip(*(plot.panels for plot in plots), strict=True):
        marks: list[Mark] = []
        for number, (panel, name) in enumerate(zip(parts, names, strict=True)):
            color = COLORS[number % len(COLORS)]
            marks += [mark for mark in (_recolor_mark(mark, color, name) for mark in panel.marks) if mark is not None]
        panels.append(parts[0]._replace(marks=tuple(marks), scale=_common_scale(parts), limits=_common_limits(parts)))
    windows = tuple(window for window in longest.windows if all(window in plot.windows for plot in plots))
    moments = tuple(dict.fromkeys(moment for plot in plots for moment in plot.moments))
    banded = any(isinstance(mark, Band) for panel in panels for mark in panel.marks)
    meaning = "3 sigma: shaded, or dashed where the scale is logarithmic" if banded else ""
    return longest._replace(panels=tuple(panels), windows=windows, moments=moments, meaning=meaning)


def _recolor_mark(mark: Mark, color: str, name: str) -> Mark | None:
    """Returns a copy of a plot's mark in its run's color, labeled with the run; None for a mark all runs share."""
    match mark:
        case Line() | Points():
            return mark._replace(color=color, label=f"{name}: {mark.label}" if mark.label else name)
        case Band():
            return mark._replace(color=color, label="", opacity=_BAND_OPACITY)
        case _:
            return None


def _common_scale(panels: Sequence[Panel]) -> Any:
    """Returns the vertical scale of overlaid panels; symmetric logarithmic, over the widest range, only if all are."""
    scales = [panel.scale for panel in panels]
    symmetric = [scale for scale in scales if isinstance(scale, SymmetricLog)]
    if len(symmetric) < len(scales):
        return scales[0]
    return SymmetricLog(min(scale.small for scale in symmetric), max(scale.large for scale in symmetric))


def _common_limits(panels: Sequence[Panel]) -> tuple[float, float] | None:
    """Returns the least and the greatest vertical limit of the panels; None if any panel has no limits."""
    limits = [panel.limits for panel in panels if panel.limits is not None]
    return (min(low for low, _ in limits), max(high for _, high in limits)) if len(limits) == len(panels) else None


def _findings_text(run: RunContent) -> tuple[str, str, str]:
    """Formats a run's duration, consistency verdict and declared failures as three texts."""
    results = run.results
    declared = "; ".join(in_words(entry, run.scenario.vehicle_data.unit_names) for entry in results.detections)
    return f"{results.duration_s:.6g} s", results.consistency.verdict or "not judged", declared or "nothing"


def _parameter_rows(runs: Sequence[tuple[str, RunContent]]) -> list[dict[str, Any]]:
    """Makes ten table rows, one per mass property: symbol, unit, and each run's estimate, error and 1-sigma."""
    units = mass_property_units(runs[0][1].scenario.vehicle_data.unit_names)
    rows = []
    for index, (symbol, unit) in enumerate(zip(SYMBOLS, units, strict=True)):
        cells = [_parameter_cells(run.results.parameters[index], unit) for _, run in runs]
        rows.append({"symbol": symbol, "unit": unit, "cells": cells})
    return rows


def _parameter_cells(parameter: Parameter, unit: str) -> tuple[str, str, str]:
    """Formats estimate, error and 1-sigma of a mass property; the last two in percent, or in its unit near zero."""
    if math.isnan(parameter.estimate):
        return "not observable", "", ""
    if math.isnan(parameter.standard_deviation):
        return f"{parameter.estimate:.6g}", "fixed", ""
    error = "" if math.isnan(parameter.truth) else f"{parameter.estimate - parameter.truth:+.3g} {unit}"
    if not math.isnan(parameter.percent_error):
        error = f"{parameter.percent_error:+.4f} %"
    sigma = f"{parameter.standard_deviation:.2g} {unit}"
    if not math.isnan(parameter.percent_deviation):
        sigma = f"{parameter.percent_deviation:.4f} %"
    return f"{parameter.estimate:.6g}", error, sigma
