"""Plots of the detector: statistics and probabilities of faults, their size, and the times of declarations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import motion
from massprop_drake.display.plot_source import DEGREES, Source, plot
from massprop_drake.display.spec import (
    Band,
    Level,
    Line,
    Mark,
    Panel,
    Plot,
    Points,
    Whiskers,
)
from massprop_drake.display.style import BAND_COLOR, COLORS, FAILED_COLOR, POINT_SIZE, TRUTH_COLOR
from massprop_drake.maths.estimation.detector import Verdict as Code
from massprop_drake.maths.signals import AXES
from massprop_drake.results.fault_probabilities import LEAST_SHOWN, format_probability

Array = NDArray[np.float64]

_FLOOR = 0.1  # of statistics on a logarithmic scale: what lies below says nothing
_NAMED = 5  # jets, or clusters, with a color of their own; the others are gray


def likelihoods(run: Source) -> Plot:
    """Plots likelihood arguments of all jets, and of the clusters (figures 5-16, 5-19, 5-22, 5-25).

    Of the detector by thrust factors it plots the log-odds of each jet's failure over no failure.
    """
    tested = run.nonzero_rows("tested")
    of_jets = run.signals["likelihood"][tested]
    clusters = np.array([jet.cluster for jet in run.vehicle.jets])
    numbers = np.unique(clusters)
    of_clusters = np.stack([of_jets[:, clusters == number].max(axis=1) for number in numbers], axis=1)
    declared = np.zeros(clusters.size, dtype=bool)
    if "known_force_variance" in run.signals:
        declared |= (run.signals["known_force_variance"] > 0.0).any(axis=0)
    said = run.signals["detector_event"][:, 0] == Code.DECLARED  # what is off has no known force
    declared[run.signals["suspected_jet"][said, 0].astype(int)] = True
    panels = [_highest_panel(run.time_s[tested], of_jets, run.vehicle.designations, "of the jets", declared)]
    if run.clustered:
        groups, found = [f"cluster {number}" for number in numbers], np.isin(numbers, clusters[declared])
        panels.append(_highest_panel(run.time_s[tested], of_clusters, groups, "of the clusters", found))
    leads = run.scenario.detector.kind == "thrust_factors"
    title = "Lead of each jet's failure over no failure, nats" if leads else "Likelihood arguments of a failed jet"
    others = any(isinstance(mark, Whiskers) for panel in panels for mark in panel.marks)
    return plot(run, "likelihoods", title, panels, meaning="gray: the range of the others" if others else "")


def _highest_panel(
    time_s: Array, values: Array, names: Sequence[str], label: str, is_declared: NDArray[np.bool_]
) -> Panel:
    """Makes a panel of test statistics: declared and highest candidates by name, the others as a gray range."""
    shown = np.maximum(values, _FLOOR)
    limits = (_FLOOR, max(10.0, 2.0 * float(np.fmax.reduce(shown, axis=None, initial=1.0))))
    if not time_s.size:
        return Panel(label, "", (), scale="log", limits=limits)
    most = np.fmax.reduce(shown, axis=0, initial=_FLOOR)  # of what there is: a detector need not judge all at all times
    order, reaching = np.lexsort((-most, ~is_declared)), int((most > _FLOOR).sum())
    top, rest = np.split(order, [min(_NAMED, max(1, reaching))])
    top = top[np.argsort(is_declared[top], kind="stable")]
    marks: list[Mark] = []
    if rest.size:
        low, high = (reduced(shown[:, rest], axis=1) for reduced in (np.fmin.reduce, np.fmax.reduce))
        marks.append(Whiskers(time_s, low, high, BAND_COLOR, "range of the others"))
    marks += [Points(time_s, shown[:, column], BAND_COLOR, names[column], drawn=False, group=label) for column in rest]
    for column, color in zip(top, COLORS, strict=False):
        size = POINT_SIZE if is_declared[column] else 0.7 * POINT_SIZE
        marks.append(Points(time_s, shown[:, column], color, names[column], size=size, group=label))
    return Panel(label, "", tuple(marks), scale="log", limits=limits)


def fault_probabilities(run: Source) -> Plot:
    """Plots posterior probabilities: of failure of each jet that reaches 1 %, of no fault, and of an unknown one."""
    of_jets, names = run.signals["fault_probability"], run.vehicle.designations
    most = np.fmax.reduce(of_jets, axis=0, initial=0.0)
    order = [jet for jet in np.argsort(-most, kind="stable").tolist() if most[jet] > LEAST_SHOWN]
    marks: list[Mark] = []
    if rest := order[_NAMED:]:
        low, high = (reduced(of_jets[:, rest], axis=1) for reduced in (np.fmin.reduce, np.fmax.reduce))
        marks.append(Whiskers(run.time_s, low, high, BAND_COLOR, f"range of {len(rest)} others"))
    marks += [Points(run.time_s, of_jets[:, jet], BAND_COLOR, names[jet], drawn=False, group="jets") for jet in rest]
    for jet, color in zip(order, COLORS[:_NAMED], strict=False):
        marks.append(
            Line(run.time_s, of_jets[:, jet], color, f"{names[jet]}, {_final_value_text(of_jets[:, jet])}", steps=True)
        )
    others = []
    for name, color in (("none", TRUTH_COLOR), ("unknown", FAILED_COLOR)):
        values = run.signals[f"{name}_probability"][:, 0]
        others.append(Line(run.time_s, values, color, f"{name}, {_final_value_text(values)}", steps=True))
    limits = (-0.02, 1.02)
    panels = [Panel("jet has failed", "", tuple(marks), limits=limits)] if marks else []
    panels.append(Panel("nothing, or unknown", "", tuple(others), limits=limits))
    meaning = "none: nothing has failed or changed; unknown: something pushes that nothing else explains"
    return plot(run, "fault_probabilities", "Probability of faults", panels, meaning=meaning)


def _final_value_text(values: Array) -> str:
    """Formats the last value of a probability for a legend, as 'at the end ...'."""
    return f"at the end {format_probability(float(values[-1]))}"


def margins(run: Source) -> Plot:
    """Plots isolation margins of the likeliest jet and cluster over the next (figures 5-17, 5-20, 5-23, 5-26)."""
    tested = run.nonzero_rows("tested")
    limit = getattr(run.scenario.detector, "margin", None)  # a matter of the method
    levels = () if limit is None else (Level(limit, label=f"isolated above {limit:g}"),)
    sides = (("jet_margin", "jet, within its cluster"), ("cluster_margin", "cluster, over all others"))
    panels = []
    for (name, label), color in zip(sides, COLORS, strict=False):
        values = np.maximum(run.signals[name][tested, 0], _FLOOR)
        marks = (Points(run.time_s[tested], values, color), *levels)
        panels.append(Panel(label, "", marks, scale="log"))
    return plot(run, "margins", "Margins of the likeliest", panels)


def failure_magnitude(run: Source) -> Plot:
    """Plots the magnitude of a failure (figures 5-18, 5-21, 5-24, 5-27).

    Shows the estimate for the likeliest jet at every alarm, with its 1-sigma; the truth of the jets that were
    suspected or do fail; and the force that is taken as known from then on.
    """
    marks: list[Mark] = []
    alarm = run.nonzero_rows("alarm")
    if "thrust" in run.signals:
        jets = run.signals["suspected_jet"][alarm, 0]
        suspected = jets[~np.isnan(jets)].astype(int).tolist()
        failed = [run.vehicle.jet_index(failure.jet) for failure in run.scenario.failures]
        for jet, color in zip(dict.fromkeys(suspected + failed), (TRUTH_COLOR, *COLORS[2:]), strict=False):
            expected = run.vehicle.jets[jet].thrust * run.signals["command"][:, jet]
            label = f"truth of {run.vehicle.designations[jet]}"
            marks.append(Line(run.time_s, run.signals["thrust"][:, jet] - expected, color, label, steps=True))
    known = run.signals["known_force_variance"] > 0.0
    for jet in np.flatnonzero(known.any(axis=0)):
        force = np.where(known[:, jet], run.signals["known_force"][:, jet], np.nan)
        label = f"known force of {run.vehicle.designations[jet]}"
        marks.append(Line(run.time_s, force, COLORS[1], label, width=1.4, dashed=True))
    if alarm.size:
        time_s, magnitude = run.time_s[alarm], run.signals["suspected_magnitude"][alarm, 0]
        deviation = run.signals["suspected_magnitude_std"][alarm, 0]
        marks += [
            Whiskers(time_s, magnitude - deviation, magnitude + deviation, COLORS[0]),
            Points(time_s, magnitude, COLORS[0], "likeliest jet, 1-sigma"),
        ]
    panel = Panel("magnitude", run.vehicle.unit_names["force"], tuple(marks))
    return plot(run, "failure_magnitude", "Magnitude of the failure", [panel])


def detection_timeline(run: Source) -> Plot:
    """Plots tests, alarms and declarations beside the rates and the number of jets commanded."""
    rate = DEGREES * motion.rate(run.scenario, run.signals)
    turning = tuple(Line(run.time_s, rate[:, axis], COLORS[axis], AXES[axis]) for axis in run.rotation_axes)
    count = (run.signals["command"] > 0.0).sum(axis=1).astype(float)
    commanded = Band(run.time_s, np.zeros_like(count), count, COLORS[0], opacity=0.6, steps=True)
    rows = {
        "tested": ("tested", BAND_COLOR),
        "alarm": ("alarm", COLORS[4]),
        "jet_isolated": ("names the jet", COLORS[1]),
    }
    ticks = []
    for row, (name, (_, color)) in enumerate(rows.items()):
        at = run.time_s[run.nonzero_rows(name)]
        ticks.append(Points(at, np.full(at.shape, float(row)), color, size=9.0, symbol="tick"))
    panels = [
        Panel("rate", "deg/s", turning),
        Panel("jets commanded", "", (commanded,)),
        Panel("", "", tuple(ticks), rows=tuple(label for label, _ in rows.values())),
    ]
    return plot(run, "detection_timeline", "Detection", panels)
