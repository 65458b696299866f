"""Figures 5-16 to 5-27: failed jets, with the detector of the thesis and no reset of the jet logic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reproduction import analytic
from reproduction.cases import Calculation
from reproduction.claims import (
    Array,
    AtLeast,
    AtMost,
    Because,
    Claim,
    Measure,
    Near,
    Phase,
    Phases,
    Printed,
    Reading,
    Signals,
    reference,
)
from reproduction.drawing import COLORS, TRUTH_COLOR, panels
from reproduction.entry import Entry
from reproduction.flights import LEAK, STUCK_OFF, STUCK_ON, STUCK_ON_JUMP, STUCK_ON_RESET, VERNIER
from reproduction.measures import DIAGONAL, during, longest_row, orbiter, ratio, rms, worst
from reproduction.words import COMPARABLE, CONSIDERABLE, MARGINAL, MUCH_MORE, NEARLY_ALL, TREMENDOUS, TYPICALLY, orders

_ONSET_S = 50.0
_MARGIN = 6.0


def _clusters() -> NDArray[np.int_]:
    return np.array([jet.cluster for jet in orbiter().jets])


def tested(run: Signals) -> NDArray[np.bool_]:
    """Samples tested after the onset of the failure."""
    result: NDArray[np.bool_] = (run["tested"][:, 0] != 0.0) & (run["time_s"] > _ONSET_S + 1e-6)
    return result


def showing(run: Signals, jet: int) -> NDArray[np.bool_]:
    """Tested samples over whose interval a jet was commanded."""
    on = run["command"][:, jet - 1] > 0.0
    before = np.concatenate([[False], on[:-1]])  # a row's command acts from its time on
    result: NDArray[np.bool_] = tested(run) & before
    return result


def _column(run: Signals, name: str, samples: NDArray[np.bool_]) -> Array:
    result: Array = run[name][samples, 0]
    return result


def _orders(jet: int, which: Callable[[Signals], NDArray[np.bool_]]) -> Measure:
    """Makes a measure: orders of magnitude from the largest argument of the 5 s before to the first sample's after."""

    def measure(phase: Phase) -> float:
        run = phase["flight"]
        before = (run["tested"][:, 0] != 0.0) & (run["time_s"] < _ONSET_S + 1e-6)
        first = int(np.flatnonzero(which(run))[0])
        return float(np.log10(run["likelihood"][first, jet - 1] / run["likelihood"][before].max()))

    return measure


def _median_argument(run: Signals, jet: int, which: Callable[[Signals], NDArray[np.bool_]]) -> float:
    return float(np.median(run["likelihood"][which(run), jet - 1]))


def _orders_below(jet: int) -> Measure:
    """Makes a measure: orders of magnitude of a jet's median argument below that of jet 29, stuck on."""
    return lambda phase: float(
        np.log10(_median_argument(phase["hard"], 29, tested) / _median_argument(phase["flight"], jet, tested))
    )


def _first(name: str, which: Callable[[Signals], NDArray[np.bool_]]) -> Measure:
    """Makes a measure: a margin at the first sample that shows the failure; NaN: none does."""
    return lambda phase: float(np.append(_column(phase["flight"], name, which(phase["flight"])), np.nan)[0])


def _least_margin(phase: Phase) -> float:
    run = phase["flight"]
    return float(min(_column(run, name, tested(run)).min() for name in ("cluster_margin", "jet_margin")))


def _right(jet: int, which: Callable[[Signals], NDArray[np.bool_]]) -> Measure:
    """Makes a measure: share of samples whose alarm names the right jet."""

    def measure(phase: Phase) -> float:
        run = phase["flight"]
        samples = which(run)
        named = (_column(run, "jet_isolated", samples) != 0.0) & (_column(run, "suspected_jet", samples) == jet - 1)
        return float(named.mean())

    return measure


def _right_cluster(jet: int) -> Measure:
    """Makes a measure: share of tested samples whose alarm names the right cluster."""

    def measure(phase: Phase) -> float:
        run = phase["flight"]
        samples = tested(run)
        alarm = _column(run, "alarm", samples) != 0.0
        right = _column(run, "suspected_cluster", samples) == _clusters()[jet - 1]
        return float((alarm & right).mean())

    return measure


def _cluster_eight_on(run: Signals) -> NDArray[np.bool_]:
    jets = np.flatnonzero(_clusters() == 8) + 1
    return np.any([showing(run, int(jet)) for jet in jets], axis=0)


def _margins_apart(phase: Phase) -> float:
    """Median of the margin between clusters over that within, while the opposing cluster is off."""
    run = phase["flight"]
    samples = tested(run) & ~_cluster_eight_on(run)
    return float(np.median(_column(run, "cluster_margin", samples)) / np.median(_column(run, "jet_margin", samples)))


def _dip(phase: Phase) -> float:
    """Median margin between clusters while the opposing cluster fires over that while it does not."""
    run = phase["flight"]
    opposed = _cluster_eight_on(run)
    if not opposed.any():
        return float("nan")
    margins = [np.median(_column(run, "cluster_margin", which)) for which in (opposed, tested(run) & ~opposed)]
    return float(margins[0] / margins[1])


def _force_error(
    jet: int, force: float, which: Callable[[Signals], NDArray[np.bool_]], size: Callable[[Array], float]
) -> Measure:
    return lambda phase: size(phase["flight"]["failure_magnitude"][which(phase["flight"]), jet - 1] - force)


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _within(values: Array) -> float:
    """Share of errors up to 1 lbf."""
    return float(np.mean(np.abs(values) <= 1.0))


def _best_force_within(jet: int, force: float) -> Measure:
    """Makes a measure: share of tested samples whose likeliest jet of the failed cluster has the force within 1 lbf."""

    def measure(phase: Phase) -> float:
        run = phase["flight"]
        found = run["failure_magnitude"][tested(run), _best_in_cluster(run, jet)]
        return _within(found - force)

    return measure


def _share_named(phase: Phase) -> float:
    """Share of the tested samples whose alarm names a jet."""
    return float(_named(phase["flight"]).mean())


def _named(run: Signals) -> NDArray[np.bool_]:
    """Selects, of the tested samples, those whose alarm names a jet."""
    result: NDArray[np.bool_] = _column(run, "jet_isolated", tested(run)) != 0.0
    return result


def _first_named(phase: Phase) -> float:
    """Number of the first tested sample whose alarm names a jet; infinity: none does."""
    found = np.flatnonzero(_named(phase["flight"]))
    return float(found[0] + 1) if found.size else np.inf


def _best_in_cluster(run: Signals, jet: int) -> Array:
    """Index of the likeliest jet of the failed cluster, for the tested samples."""
    inside = _clusters() == _clusters()[jet - 1]
    result: Array = np.where(inside, run["likelihood"][tested(run)], -1.0).argmax(axis=1)
    return result


def _best_is_right(jet: int) -> Measure:
    return lambda phase: float(np.mean(_best_in_cluster(phase["flight"], jet) == jet - 1))


def _first_at_lower_threshold(phase: Phase) -> float:
    """Number of the jet that the largest margin within the cluster belongs to."""
    run = phase["flight"]
    margins = _column(run, "jet_margin", tested(run))
    return float(_best_in_cluster(run, 24)[int(margins.argmax())] + 1)


# ------------------------------------------------------------------------------------------- oracle


def _exact(jet: int, force: float, what: str, commanded: tuple[int, ...] = ()) -> Measure:
    """Makes a measure: argument or margin of a failure without noise, at table 5-2's truth."""

    def measure(_: Phase) -> float:
        tests, isolation = analytic.noise_free(jet, force, commanded)
        values = {
            "argument": tests.likelihood[jet - 1],
            "cluster": isolation.cluster_margin,
            "jet": isolation.jet_margin,
            "std": np.sqrt(tests.variance[jet - 1]),
        }
        return float(values[what])

    return measure


# ----------------------------------------------------------------------------------------- pictures


def _history(title: str, jet: int, *, of_cluster: bool) -> Callable[[Phases], Figure]:
    """Makes a picture of the argument of the failed jet, or its cluster, and of the largest elsewhere."""

    def draw(phases: Phases) -> Figure:
        figure, (panel,) = panels(1, title, windows=False, height=2.6)
        run = phases[0]["flight"]
        shown = (run["tested"][:, 0] != 0.0) & during(run, 49.0, 58.0)
        inside = _clusters() == _clusters()[jet - 1]
        own = run["likelihood"][:, inside].max(axis=1) if of_cluster else run["likelihood"][:, jet - 1]
        other = run["likelihood"][:, ~inside].max(axis=1)
        for values, color, label in (
            (other, COLORS[1], "largest of the other clusters"),
            (own, COLORS[0], f"cluster {_clusters()[jet - 1]}" if of_cluster else f"jet {jet}"),
        ):
            panel.plot(run["time_s"][shown], np.maximum(values[shown], 0.05), ".", color=color, ms=4, label=label)
        panel.set_yscale("log")
        panel.set_ylabel("likelihood argument")
        panel.axvline(_ONSET_S, color=TRUTH_COLOR, linewidth=0.8, linestyle=":")
        panel.legend(fontsize=8)
        return figure

    return draw


def _margins(title: str) -> Callable[[Phases], Figure]:
    """Makes a picture of both margins."""

    def draw(phases: Phases) -> Figure:
        figure, axes = panels(2, title, windows=False)
        run = phases[0]["flight"]
        shown = (run["tested"][:, 0] != 0.0) & during(run, 49.0, 58.0)
        for panel, name, label, color in zip(
            axes,
            ("jet_margin", "cluster_margin"),
            ("(a) within the cluster", "(b) between clusters"),
            COLORS,
            strict=False,
        ):
            panel.plot(run["time_s"][shown], np.maximum(run[name][shown, 0], 0.05), ".", color=color, ms=4)
            panel.axhline(_MARGIN, color=TRUTH_COLOR, linewidth=0.8, linestyle="--")
            panel.axvline(_ONSET_S, color=TRUTH_COLOR, linewidth=0.8, linestyle=":")
            panel.set_yscale("log")
            panel.set_ylabel(label)
        return figure

    return draw


def _magnitudes(title: str, jet: int, force: float, *, best: bool) -> Callable[[Phases], Figure]:
    """Makes a picture of the estimated force of the failed jet and, with best, of its cluster's likeliest."""

    def draw(phases: Phases) -> Figure:
        figure, axes = panels(1 + best, title, windows=False, height=2.2)
        run = phases[0]["flight"]
        shown = (run["tested"][:, 0] != 0.0) & during(run, 49.0, 58.0)
        inside = np.flatnonzero(_clusters() == _clusters()[jet - 1])
        likeliest = inside[run["likelihood"][:, inside].argmax(axis=1)]
        forces = [run["failure_magnitude"][:, jet - 1], run["failure_magnitude"][np.arange(len(likeliest)), likeliest]]
        labels = [f"jet {jet}, lbf", "likeliest in cluster, lbf"]
        for panel, values, label, color in zip(axes, forces, labels, COLORS, strict=False):
            panel.plot(run["time_s"][shown], values[shown], ".", color=color, ms=4)
            panel.axhline(force, color=TRUTH_COLOR, linewidth=0.8)
            panel.axvline(_ONSET_S, color=TRUTH_COLOR, linewidth=0.8, linestyle=":")
            panel.set_ylabel(label)
        return figure

    return draw


def _jet_11(run: Signals) -> NDArray[np.bool_]:
    return showing(run, 11)


def _jet_11_off(run: Signals) -> NDArray[np.bool_]:
    return tested(run) & ~showing(run, 11)


_ON, _OFF = 868.819, -874.185  # lbf, table 5-1
_VERNIER_FORCE, _LEAK_FORCE = 24.483, 10.4

# fmt: off
_STUCK_ON = (
    Entry("fig_5_16", "Likelihood argument, jet 29 stuck on", {"flight": STUCK_ON}, (
            Claim(1, "orders of magnitude by which the argument rises at the first sample tested",
                "at the first sample instant after the failure it increases by five orders of magnitude", orders(5),
                _orders(29, tested)),
            reference(1, "argument without noise", "(expected 8.07e5)", Near(8.07e5, 0.5e3),
                _exact(29, _ON, "argument")),
        ),
        {"fig_5_16": _history("Likelihood argument, jet 29 stuck on (figure 5-16)", 29, of_cluster=False)},
    ),
    Entry("fig_5_17", "Margins, jet 29 stuck on", {"flight": STUCK_ON}, (
            Claim(2, "margin (b) at the first sample", "cluster isolated at the first sample", AtLeast(_MARGIN),
                _first("cluster_margin", tested)),
            Claim(2, "margin (a) at the first sample", "jet isolated at the first sample", AtLeast(_MARGIN),
                _first("jet_margin", tested)),
            reference(2, "margin (a) without noise", "(expected 289, next jet 30)", Near(289, 0.5),
                _exact(29, _ON, "jet")),
            reference(2, "margin (b) without noise", "(expected 17 800, next cluster 7)", Near(17800, 50),
                _exact(29, _ON, "cluster")),
            Claim(3, "margin (b) over margin (a), medians while the opposing cluster is off",
                "isolation between clusters is normally much more significant than within", MUCH_MORE, _margins_apart),
            Claim(4, "median margin (b) while cluster 8 fires over that while it does not",
                "abrupt negative spikes of (b) when the opposing jet is fired",
                Reading(AtMost(1.0 / 3.0), "abrupt: to a third"), _dip),
            reference(4, "margin (b) without noise while jet 17 fires", "(expected 32.8, next cluster 8)",
                Near(32.8, 0.05), _exact(29, _ON, "cluster", (17,))),
            Claim(5, "least of both margins from 50 to 58 s",
                "always greater than ten throughout the period of the failure", AtLeast(10.0), _least_margin),
            Claim(5, "share of tested samples that name jet 29", "isolation always right", AtLeast(1.0),
                _right(29, tested)),
        ),
        {"fig_5_17": _margins("Largest minus next-largest argument, jet 29 stuck on (figure 5-17)")},
    ),
    Entry("fig_5_18", "Failure magnitude, jet 29 stuck on", {"flight": STUCK_ON}, (
            reference(6, "RMS error of the force", "(RMS within 1 lbf)", AtMost(1.0),
                _force_error(29, _ON, tested, rms), "lbf"),
            Claim(6, "largest error of the force", "variations less than 1 lbf over the entire observed period",
                AtMost(1.0), _force_error(29, _ON, tested, _largest), "lbf",
                because=Because(
                    "one sample's own 1-sigma is {:.2f} lbf by (4-25) with the sensors of section 5.1; of {:.0f} "
                    "tested samples {:.0%} are within 1 lbf",
                    (_exact(29, _ON, "std"), lambda phase: float(np.count_nonzero(tested(phase["flight"]))),
                     _force_error(29, _ON, tested, _within)))),
            reference(6, "1-sigma of the force", "(expected 0.97)", Near(0.97, 0.005), _exact(29, _ON, "std"), "lbf"),
        ),
        {"fig_5_18": _magnitudes("Estimated failure force, jet 29 stuck on (figure 5-18)", 29, _ON, best=False)},
    ),
)

_STUCK_OFF = (
    Entry("fig_5_19", "Likelihood argument, jet 11 stuck off", {"flight": STUCK_OFF, "hard": STUCK_ON}, (
            Claim(
                1,
                "median argument while jet 11 is commanded, over that of jet 29 stuck on",
                "the size of the arguments was comparable to that of the stuck-on case",
                COMPARABLE,
                lambda phase: (
                    _median_argument(phase["flight"], 11, _jet_11) / _median_argument(phase["hard"], 29, tested)
                ),
            ),
            reference(1, "argument without noise", "(expected 1.08e6)", Near(1.08e6, 0.5e4),
                _exact(11, _OFF, "argument", (11,))),
        ),
        {"fig_5_19": _history("Likelihood argument, jet 11 stuck off (figure 5-19)", 11, of_cluster=False)},
    ),
    Entry("fig_5_20", "Margins, jet 11 stuck off", {"flight": STUCK_OFF}, (
            Claim(2, "margin (b) at the first sample that shows it",
                "detection and isolation at the first sample after the failure", AtLeast(_MARGIN),
                _first("cluster_margin", _jet_11)),
            Claim(2, "margin (a) at the first sample that shows it", "isolation at the first sample", AtLeast(_MARGIN),
                _first("jet_margin", _jet_11)),
            Claim(2, "share of samples with jet 11 commanded that name it", "isolation right", AtLeast(1.0),
                _right(11, _jet_11)),
            reference(2, "margin (b) without noise", "(expected 1 940, next cluster 2)", Near(1940, 5),
                _exact(11, _OFF, "cluster", (11,))),
            reference(2, "margin (a) without noise, jet 12 also on", "(expected 2.0e4)", Near(2.0e4, 0.05e4),
                _exact(11, _OFF, "jet", (11, 12))),
            reference(2, "margin (a) without noise, jet 12 off", "(expected about 1e6)", Near(1e6, 0.1e6),
                _exact(11, _OFF, "jet", (11,))),
        ),
        {"fig_5_20": _margins("Largest minus next-largest argument, jet 11 stuck off (figure 5-20)")},
    ),
    Entry("fig_5_21", "Failure magnitude, jet 11 stuck off", {"flight": STUCK_OFF}, (
            Claim(3, "largest error of the force while commanded", "again accurate to less than 1 lbf", AtMost(1.0),
                _force_error(11, _OFF, _jet_11, _largest), "lbf"),
            reference(3, "1-sigma of the force", "(expected 0.84)", Near(0.84, 0.005), _exact(11, _OFF, "std", (11,)),
                "lbf"),
            Claim(4, "RMS of the force while not commanded",
                "the magnitude estimates likewise jumped as the commands changed",
                Reading(AtMost(1.0), "jumps: to nothing, within 1 lbf"), _force_error(11, 0.0, _jet_11_off, rms),
                "lbf"),
        ),
        {"fig_5_21": _magnitudes("Estimated failure force, jet 11 stuck off (figure 5-21)", 11, _OFF, best=False)},
    ),
)

_VERNIER = (
    Entry("fig_5_22", "Cluster likelihood argument, vernier 39 stuck on", {"flight": VERNIER, "hard": STUCK_ON}, (
            Claim(
                2,
                "orders of magnitude of the median argument below that of jet 29",
                "three to four orders of magnitude smaller than those of the hard failures",
                orders(3, 4),
                _orders_below(39),
                because=Because(
                    "without noise table 5-1 and (4-28) give {:.2f} orders: {:.2f} by the forces, less since a pound "
                    "of the vernier shows more",
                    (
                        lambda phase: float(
                            np.log10(_exact(29, _ON, "argument")(phase) / _exact(39, _VERNIER_FORCE, "argument")(phase))
                        ),
                        lambda _: float(2.0 * np.log10(_ON / _VERNIER_FORCE)),
                    ),
                ),
            ),
            reference(2, "the same without noise", "(expected ratio 1.4e-3)", Near(1.4e-3, 0.5e-4),
                lambda phase: _exact(39, _VERNIER_FORCE, "argument")(phase) / _exact(29, _ON, "argument")(phase)),
            reference(1, "argument without noise", "(expected 1 121)", Near(1121, 0.5),
                _exact(39, _VERNIER_FORCE, "argument")),
        ),
        {"fig_5_22": _history("Cluster likelihood argument, vernier 39 stuck on (figure 5-22)", 39, of_cluster=True)},
    ),
    Entry("fig_5_23", "Margins, vernier 39 stuck on",
        {"flight": VERNIER, "gaussian": Calculation("vernier_gaussian", analytic.vernier_gaussian, seeds=20)}, (
            Claim(1, "margin (b) at the first sample", "cluster detected and isolated at the first sample",
                AtLeast(_MARGIN), _first("cluster_margin", tested)),
            Claim(1, "share of tested samples that name cluster 4", "isolation to the cluster was also significant",
                NEARLY_ALL, _right_cluster(39)),
            reference(1, "margin (b) without noise", "(expected 582, next cluster 2)", Near(582, 0.5),
                _exact(39, _VERNIER_FORCE, "cluster")),
            Claim(3, "number of the first sample that names the jet",
                "isolation to the particular jet occurred after four time instants", Printed(4.0), _first_named,
                because=Because(
                    "which sample is the first is a matter of chance: {:.0%} of the samples name the jet here, and of "
                    "independent samples with Gaussian noise {:.0%}, of which {:.0%} of the runs would wait for the "
                    "fourth or longer",
                    (_share_named, lambda phase: float(phase["gaussian"]["named"].mean()),
                     lambda phase: float((1.0 - phase["gaussian"]["named"].mean()) ** 3)))),
            Claim(3, "longest row of samples that name the jet",
                "no two isolations ever occurred consecutively thereafter", AtMost(1.0),
                lambda phase: float(longest_row(_named(phase["flight"]))),
                because=Because(
                    "{:.0%} of the samples name the jet, so among {:.0f} tested ones two in a row are the rule; with "
                    "Gaussian noise of equal variance it is {:.0%}",
                    (_share_named, lambda phase: float(_named(phase["flight"]).size),
                     lambda phase: float(phase["gaussian"]["named"].mean())))),
            Claim(3, "share of tested samples that name the jet", "isolation to the jet is marginal", MARGINAL,
                _share_named),
            reference(3, "the same of independent samples with Gaussian noise", "(expected 0.17)", Near(0.17, 0.02),
                lambda phases: float(np.mean([phase["gaussian"]["named"].mean() for phase in phases])), pooled=True),
            reference(3, "mean margin (a) without noise", "(expected 2.8, next jet 9)", Near(2.8, 0.05),
                _exact(39, _VERNIER_FORCE, "jet")),
            reference(3, "share of samples whose likeliest jet is the right one", "(best-jet choice right 80 %)",
                Near(0.80, 0.05), _best_is_right(39),
                because=Because(
                    "quantized sensors at rest repeat few values: {:.0%} here, {:.0%} with Gaussian noise of equal "
                    "variance", (_best_is_right(39), lambda phase: float(phase["gaussian"]["best"].mean())))),
            reference(3, "the same of independent samples with Gaussian noise", "(expected 0.80)", Near(0.80, 0.02),
                lambda phases: float(np.mean([phase["gaussian"]["best"].mean() for phase in phases])), pooled=True),
        ),
        {"fig_5_23": _margins("Largest minus next-largest argument, vernier 39 stuck on (figure 5-23)")},
    ),
    Entry("fig_5_24", "Failure magnitude, vernier 39 stuck on", {"flight": VERNIER}, (
            Claim(4, "share of tested samples whose force is within 1 lbf, (a) failed jet",
                "we can typically estimate the failure magnitude to within 1 lbf", TYPICALLY,
                _force_error(39, _VERNIER_FORCE, tested, _within)),
            Claim(4, "the same, (b) jet that maximizes the argument in the cluster",
                "we can typically estimate the failure magnitude to within 1 lbf", TYPICALLY,
                _best_force_within(39, _VERNIER_FORCE)),
            reference(4, "1-sigma of the force", "(expected 0.73)", Near(0.73, 0.005),
                _exact(39, _VERNIER_FORCE, "std"), "lbf"),
        ),
        {
            "fig_5_24": _magnitudes(
                "Estimated failure force, vernier 39 stuck on (figure 5-24)", 39, _VERNIER_FORCE, best=True
            )
        },
    ),
)

_LEAK = (
    Entry("fig_5_25", "Cluster likelihood argument, jet 24 leaking 1.5 %", {"flight": LEAK, "hard": STUCK_ON}, (
            Claim(1, "orders of magnitude of the median argument below that of jet 29",
                "three to four orders of magnitude smaller than those of the hard failures", orders(3, 4),
                _orders_below(24)),
            reference(1, "argument without noise", "(expected 260)", Near(260, 0.5),
                _exact(24, 0.015 * 691.018, "argument")),
        ),
        {"fig_5_25": _history("Cluster likelihood argument, jet 24 leaking (figure 5-25)", 24, of_cluster=True)},
    ),
    Entry("fig_5_26", "Margins, jet 24 leaking 1.5 %", {"flight": LEAK}, (
            Claim(1, "margin (b) at the first sample", "cluster detected and isolated at the first sample",
                AtLeast(_MARGIN), _first("cluster_margin", tested)),
            Claim(1, "share of tested samples that name cluster 10", "isolation to the cluster was also significant",
                NEARLY_ALL, _right_cluster(24)),
            reference(1, "margin (b) without noise", "(expected 81, next cluster 8)", Near(81, 0.5),
                _exact(24, 0.015 * 691.018, "cluster")),
            Claim(2, "samples that name a jet", "no isolation to the jet in the whole run", AtMost(0.0),
                lambda phase: float(_named(phase["flight"]).sum())),
            reference(2, "mean margin (a) without noise", "(expected 0.04, next jet 25)", Near(0.04, 0.005),
                _exact(24, 0.015 * 691.018, "jet")),
            Claim(2, "number of the jet with the largest margin (a)",
                "a lower threshold would first have isolated jet 42, incorrectly", Near(42.0, 0.0),
                _first_at_lower_threshold),
            reference(2, "share of samples whose likeliest jet is a wrong one of the cluster",
                "(jets 24, 25, 26 and 42 compete)", AtLeast(0.25), lambda phase: 1.0 - _best_is_right(24)(phase)),
        ),
        {"fig_5_26": _margins("Largest minus next-largest argument, jet 24 leaking (figure 5-26)")},
    ),
    Entry("fig_5_27", "Failure magnitude, jet 24 leaking 1.5 %", {"flight": LEAK}, (
            Claim(3, "share of tested samples whose force is within 1 lbf, (a) leaking jet",
                "we can typically estimate the failure magnitude to within 1 lbf", TYPICALLY,
                _force_error(24, _LEAK_FORCE, tested, _within)),
            Claim(3, "the same, (b) jet that maximizes the argument in the cluster",
                "we can typically estimate the failure magnitude to within 1 lbf", TYPICALLY,
                _best_force_within(24, _LEAK_FORCE)),
            reference(3, "1-sigma of the force", "(expected 0.64)", Near(0.64, 0.005), _exact(24, _LEAK_FORCE, "std"),
                "lbf"),
        ),
        {"fig_5_27": _magnitudes("Estimated failure force, jet 24 leaking (figure 5-27)", 24, _LEAK_FORCE, best=True)},
    ),
)
# fmt: on


def _grown(case: str, time_s: float) -> Measure:
    """Makes a measure: largest error of the diagonal at a time over that before the failure."""
    return ratio(worst(case, DIAGONAL, time_s), worst(case, DIAGONAL, _ONSET_S))


# fmt: off
_TEXT = (
    Entry("section_5_3", "Identification of jet failures, the text",
        {"flight": STUCK_ON, "reset": STUCK_ON_RESET, "jump": STUCK_ON_JUMP}, (
            Claim(1, "largest error of the diagonal 2 s after jet 29 sticks on and passes for jumps, over that before",
                "an erroneous decision that a mass-property jump has occurred quickly leads to state divergence",
                TREMENDOUS, _grown("jump", 52.0)),
            Claim(2, "largest error of the diagonal 8 s after, jet logic reset after two alarms, over that before",
                "a reset would also prevent divergence of the mass-property states",
                Reading(AtMost(2.0), "no divergence: at most doubled"), _grown("reset", 58.0)),
            Claim(2, "the same without a reset", "divergence due to an improper correction of the residuals",
                CONSIDERABLE, _grown("flight", 58.0),
                because=Because(
                    "no correction is improper here: {:.0%} of the tested samples name the right jet, and the error is "
                    "{:.4f} % before and {:.4f} % after",
                    (_right(29, tested), worst("flight", DIAGONAL, _ONSET_S), worst("flight", DIAGONAL, 58.0)))),
        ),
    ),
)
# fmt: on

ENTRIES = (*_TEXT, *_STUCK_ON, *_STUCK_OFF, *_VERNIER, *_LEAK)
