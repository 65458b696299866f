"""Figures 5-16 to 5-27: failed jets, with the detector of the thesis and no reset of the jet logic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reproduction import analytic, flights, words
from reproduction.cases import Calculation, Case, Flight
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
    expected,
    reference,
)
from reproduction.drawing import COLORS, TRUTH_COLOR, panels
from reproduction.entry import Entry
from reproduction.measures import DIAGONAL, during, longest_row, mean, orbiter, ratio, rms, worst

_ONSET_S = 50.0
_MARGIN = analytic.MARGIN
_CLUSTERS = np.array([jet.cluster for jet in orbiter().jets])

Samples = NDArray[np.bool_]


def _select_tested(run: Signals) -> Samples:
    """Selects the samples tested after the onset of the failure."""
    result: Samples = (run["tested"][:, 0] != 0.0) & (run["time_s"] > _ONSET_S + 1e-6)
    return result


def _select_commanded(run: Signals, jet_number: int) -> Samples:
    """Selects the tested samples over whose interval a jet was commanded."""
    on = run["command"][:, jet_number - 1] > 0.0
    result: Samples = _select_tested(run) & np.concatenate([[False], on[:-1]])  # a row's command acts from its time on
    return result


def _signal_at(run: Signals, name: str, samples: Samples) -> Array:
    """Returns a signal of one component at the selected samples."""
    result: Array = run[name][samples, 0]
    return result


def _flag_named(phase: Phase) -> Samples:
    """Flags the tested samples whose alarm names a jet."""
    run = phase["flight"]
    result: Samples = _signal_at(run, "jet_isolated", _select_tested(run)) != 0.0
    return result


def _share_named(phase: Phase) -> float:
    """Computes the share of the tested samples whose alarm names a jet."""
    return float(_flag_named(phase).mean())


def _first_named_sample(phase: Phase) -> float:
    """Returns the number of the first tested sample whose alarm names a jet; infinity: none does."""
    indices = np.flatnonzero(_flag_named(phase))
    return float(indices[0] + 1) if indices.size else np.inf


def _largest(values: Array) -> float:
    """Returns the largest size of some values."""
    return float(np.abs(values).max())


def _share_within_1_lbf(errors: Array) -> float:
    """Computes the share of errors up to 1 lbf."""
    return float(np.mean(np.abs(errors) <= 1.0))


def _mark_onset(panel: Axes, label: str) -> None:
    """Labels a panel's vertical axis and marks the onset of the failure."""
    panel.set_ylabel(label)
    panel.axvline(_ONSET_S, color=TRUTH_COLOR, linewidth=0.8, linestyle=":")


def _select_plotted(run: Signals) -> Samples:
    """Selects the tested samples that pictures show."""
    return (run["tested"][:, 0] != 0.0) & during(run, 49.0, 58.0)


@dataclass(frozen=True)
class FailedJet:
    """Failed jet of three figures, with measures of a phase of its flight.

    Attributes:
        flight: with the failure.
        jet: number in table 5-1.
        force, thesis_force: on top of its commands, by table 5-1 and as the thesis gives it, lbf.
        title: words for it.
        of_cluster: whether the thesis shows its cluster.
    """

    flight: Flight
    jet: int
    force: float
    thesis_force: float
    title: str
    of_cluster: bool = False

    @property
    def inside(self) -> Samples:
        """Flags the jets of its cluster, shape (44,)."""
        result: Samples = _CLUSTERS[self.jet - 1] == _CLUSTERS
        return result

    def shows(self, run: Signals) -> Samples:
        """Selects the tested samples that show the failure: missing thrust alone while the jet is commanded."""
        return _select_tested(run) if self.force > 0.0 else _select_commanded(run, self.jet)

    def rise(self, phase: Phase) -> float:
        """Computes the orders of magnitude by which the argument rises at the first sample that shows the failure."""
        run = phase["flight"]
        before = (run["tested"][:, 0] != 0.0) & (run["time_s"] < _ONSET_S + 1e-6)
        first = int(np.flatnonzero(self.shows(run))[0])
        return float(np.log10(run["likelihood"][first, self.jet - 1] / run["likelihood"][before].max()))

    def median(self, run: Signals) -> float:
        """Computes the median argument of the jet at the samples that show the failure."""
        return float(np.median(run["likelihood"][self.shows(run), self.jet - 1]))

    def orders_below(self, phase: Phase) -> float:
        """Computes the orders of magnitude of its median argument below that of jet 29, stuck on."""
        return float(np.log10(_ON.median(phase["hard"]) / self.median(phase["flight"])))

    def first(self, margin: str) -> Measure:
        """Makes a measure: a margin at the first sample that shows the failure; NaN: none does."""
        return lambda phase: float(
            np.append(_signal_at(phase["flight"], margin, self.shows(phase["flight"])), np.nan)[0]
        )

    def right(self, phase: Phase) -> float:
        """Computes the share of samples that show the failure whose alarm names the jet."""
        run = phase["flight"]
        samples = self.shows(run)
        named = _signal_at(run, "jet_isolated", samples) != 0.0
        return float((named & (_signal_at(run, "suspected_jet", samples) == self.jet - 1)).mean())

    def right_cluster(self, phase: Phase) -> float:
        """Computes the share of tested samples whose alarm names the cluster."""
        run = phase["flight"]
        samples = _select_tested(run)
        right = _signal_at(run, "suspected_cluster", samples) == _CLUSTERS[self.jet - 1]
        return float(((_signal_at(run, "alarm", samples) != 0.0) & right).mean())

    def likeliest(self, run: Signals) -> Array:
        """Returns the index of the likeliest jet of the cluster at each tested sample."""
        result: Array = np.where(self.inside, run["likelihood"][_select_tested(run)], -1.0).argmax(axis=1)
        return result

    def likeliest_is_right(self, phase: Phase) -> float:
        """Computes the share of tested samples whose likeliest jet of the cluster is the failed one."""
        return float(np.mean(self.likeliest(phase["flight"]) == self.jet - 1))

    def force_error(self, statistic: Callable[[Array], float]) -> Measure:
        """Makes a measure: a statistic of the errors of the force at the samples that show the failure, lbf."""
        return lambda phase: statistic(
            phase["flight"]["failure_magnitude"][self.shows(phase["flight"]), self.jet - 1] - self.thesis_force
        )

    def likeliest_within(self, phase: Phase) -> float:
        """Computes the share of tested samples whose likeliest jet of the cluster has the force within 1 lbf."""
        run = phase["flight"]
        return _share_within_1_lbf(
            run["failure_magnitude"][_select_tested(run), self.likeliest(run)] - self.thesis_force
        )

    def exact(self, quantity: str, *jets_on: int) -> Measure:
        """Makes a measure: argument, margin or 1-sigma without noise, at table 5-2's mass properties.

        Args:
            quantity: argument, cluster, jet or std.
            jets_on: numbers of the jets that are on; without, the failed one where thrust is missing.
        """

        def measure(_: Phase) -> float:
            """Computes the quantity, which is the same in every phase."""
            on = jets_on or ((self.jet,) if self.force < 0.0 else ())
            tests, isolation = analytic.noise_free_tests(self.jet, self.force, on)
            values = {
                "argument": tests.likelihood[self.jet - 1],
                "cluster": isolation.cluster_margin,
                "jet": isolation.jet_margin,
                "std": np.sqrt(tests.variance[self.jet - 1]),
            }
            return float(values[quantity])

        return measure

    def arguments(self, figure: str, *claims: Claim, **other_cases: Case) -> Entry:
        """Makes the figure of the argument of the failed jet, or its cluster, and of the largest elsewhere."""
        title = f"{'Cluster likelihood' if self.of_cluster else 'Likelihood'} argument, {self.title}"

        def draw(phases: Phases) -> Figure:
            """Draws the arguments of the first phase over time."""
            picture, (panel,) = panels(1, f"{title} (figure {figure})", windows=False, height=2.6)
            run = phases[0]["flight"]
            shown, likelihood = _select_plotted(run), run["likelihood"]
            jet_values = likelihood[:, self.inside].max(axis=1) if self.of_cluster else likelihood[:, self.jet - 1]
            name = f"cluster {_CLUSTERS[self.jet - 1]}" if self.of_cluster else f"jet {self.jet}"
            elsewhere = likelihood[:, ~self.inside].max(axis=1)
            for values, color, label in (
                (elsewhere, COLORS[1], "largest of the other clusters"),
                (jet_values, COLORS[0], name),
            ):
                panel.plot(run["time_s"][shown], np.maximum(values[shown], 0.05), ".", color=color, ms=4, label=label)
            panel.set_yscale("log")
            _mark_onset(panel, "likelihood argument")
            panel.legend(fontsize=8)
            return picture

        return self._entry(figure, title, claims, draw, **other_cases)

    def margins(self, figure: str, *claims: Claim, **other_cases: Case) -> Entry:
        """Makes the figure of the margins within the cluster and between clusters."""

        def draw(phases: Phases) -> Figure:
            """Draws the margins of the first phase over time."""
            title = f"Largest minus next-largest argument, {self.title} (figure {figure})"
            picture, axes = panels(2, title, windows=False)
            run = phases[0]["flight"]
            shown = _select_plotted(run)
            names = {"jet_margin": "(a) within the cluster", "cluster_margin": "(b) between clusters"}
            for panel, (name, label), color in zip(axes, names.items(), COLORS, strict=False):
                panel.plot(run["time_s"][shown], np.maximum(run[name][shown, 0], 0.05), ".", color=color, ms=4)
                panel.axhline(_MARGIN, color=TRUTH_COLOR, linewidth=0.8, linestyle="--")
                panel.set_yscale("log")
                _mark_onset(panel, label)
            return picture

        return self._entry(figure, f"Margins, {self.title}", claims, draw, **other_cases)

    def magnitudes(self, figure: str, *claims: Claim) -> Entry:
        """Makes the figure of the estimated force of the failed jet and, if soft, of its cluster's likeliest."""

        def draw(phases: Phases) -> Figure:
            """Draws the estimated forces of the first phase over time."""
            title = f"Estimated failure force, {self.title} (figure {figure})"
            picture, axes = panels(1 + self.of_cluster, title, windows=False, height=2.2)
            run = phases[0]["flight"]
            shown, inside = _select_plotted(run), np.flatnonzero(self.inside)
            likeliest = inside[run["likelihood"][:, inside].argmax(axis=1)]
            forces = run["failure_magnitude"]
            both = (forces[:, self.jet - 1], forces[np.arange(len(likeliest)), likeliest])
            labels = (f"jet {self.jet}, lbf", "likeliest in cluster, lbf")
            for panel, values, label, color in zip(axes, both, labels, COLORS, strict=False):
                panel.plot(run["time_s"][shown], values[shown], ".", color=color, ms=4)
                panel.axhline(self.thesis_force, color=TRUTH_COLOR, linewidth=0.8)
                _mark_onset(panel, label)
            return picture

        return self._entry(figure, f"Failure magnitude, {self.title}", claims, draw)

    def _entry(
        self, figure: str, title: str, claims: tuple[Claim, ...], draw: Callable[[Phases], Figure], **other_cases: Case
    ) -> Entry:
        """Makes the entry of a figure, whose cases are the flight and some others."""
        name = f"fig_{figure.replace('-', '_')}"
        return Entry(name, title, {"flight": self.flight, **other_cases}, claims, {name: draw})


_ON = FailedJet(flights.STUCK_ON, 29, 868.819, 868.819, "jet 29 stuck on")
_OFF = FailedJet(flights.STUCK_OFF, 11, -874.185, -874.185, "jet 11 stuck off")
_VERNIER = FailedJet(flights.VERNIER, 39, 24.483, 24.483, "vernier 39 stuck on", of_cluster=True)
_LEAK = FailedJet(flights.LEAK, 24, 0.015 * 691.018, 10.4, "jet 24 leaking 1.5 %", of_cluster=True)


def _least_margin(phase: Phase) -> float:
    """Returns the smallest margin, of both, at the tested samples."""
    run = phase["flight"]
    return float(min(_signal_at(run, name, _select_tested(run)).min() for name in ("cluster_margin", "jet_margin")))


def _cluster_eight_on(run: Signals) -> Samples:
    """Selects the tested samples over whose interval a jet of cluster 8 was commanded."""
    return np.any([_select_commanded(run, int(jet)) for jet in np.flatnonzero(_CLUSTERS == 8) + 1], axis=0)


def _margin_ratio(phase: Phase) -> float:
    """Computes the median margin between clusters over that within, while the opposing cluster is off."""
    run = phase["flight"]
    samples = _select_tested(run) & ~_cluster_eight_on(run)
    return float(
        np.median(_signal_at(run, "cluster_margin", samples)) / np.median(_signal_at(run, "jet_margin", samples))
    )


def _margin_ratio_opposed(phase: Phase) -> float:
    """Computes the median margin between clusters while the opposing cluster fires over that while not; NaN: never."""
    run = phase["flight"]
    opposed = _cluster_eight_on(run)
    if not opposed.any():
        return float("nan")
    margins = [
        np.median(_signal_at(run, "cluster_margin", samples)) for samples in (opposed, _select_tested(run) & ~opposed)
    ]
    return float(margins[0] / margins[1])


def _force_while_off(phase: Phase) -> float:
    """Computes the RMS force of jet 11 while it is not commanded, lbf."""
    run = phase["flight"]
    return rms(run["failure_magnitude"][_select_tested(run) & ~_OFF.shows(run), _OFF.jet - 1])


def _jet_of_largest_margin(phase: Phase) -> float:
    """Returns the number of the jet that the largest margin within the cluster belongs to."""
    run = phase["flight"]
    return float(_LEAK.likeliest(run)[int(_signal_at(run, "jet_margin", _select_tested(run)).argmax())] + 1)


def _gaussian_share(flag: str) -> Measure:
    """Makes a measure: share of independent samples of the vernier with Gaussian noise that have a flag."""
    return lambda phase: float(phase["gaussian"][flag].mean())


def _error_growth(case: str, time_s: float) -> Measure:
    """Makes a measure: largest error of the diagonal at a time over that before the failure."""
    return ratio(worst(case, DIAGONAL, time_s), worst(case, DIAGONAL, _ONSET_S))


# fmt: off
ENTRIES = (
    Entry("section_5_3", "Identification of jet failures, the text",
        {"flight": flights.STUCK_ON, "reset": flights.STUCK_ON_RESET, "jump": flights.STUCK_ON_JUMP}, (
            Claim(1, "largest error of the diagonal 2 s after jet 29 sticks on and passes for jumps, over that before",
                "an erroneous decision that a mass-property jump has occurred quickly leads to state divergence",
                words.TREMENDOUS, _error_growth("jump", 52.0)),
            Claim(2, "largest error of the diagonal 8 s after, jet logic reset after two alarms, over that before",
                "a reset would also prevent divergence of the mass-property states",
                Reading(AtMost(2.0), "no divergence: at most doubled"), _error_growth("reset", 58.0)),
            Claim(2, "the same without a reset", "divergence due to an improper correction of the residuals",
                words.CONSIDERABLE, _error_growth("flight", 58.0),
                because=Because(
                    "no correction is improper here: {:.0%} of the tested samples name the right jet, and the error is "
                    "{:.4f} % before and {:.4f} % after",
                    (_ON.right, worst("flight", DIAGONAL, _ONSET_S), worst("flight", DIAGONAL, 58.0)))),
        ),
    ),

    _ON.arguments("5-16",
        Claim(1, "orders of magnitude by which the argument rises at the first sample tested",
            "at the first sample instant after the failure it increases by five orders of magnitude", words.orders(5),
            _ON.rise),
        expected(1, "argument without noise", "8.07e5", Near(8.07e5, 0.5e3), _ON.exact("argument")),
    ),
    _ON.margins("5-17",
        Claim(2, "margin (b) at the first sample", "cluster isolated at the first sample", AtLeast(_MARGIN),
            _ON.first("cluster_margin")),
        Claim(2, "margin (a) at the first sample", "jet isolated at the first sample", AtLeast(_MARGIN),
            _ON.first("jet_margin")),
        expected(2, "margin (a) without noise", "289, next jet 30", Near(289, 0.5), _ON.exact("jet")),
        expected(2, "margin (b) without noise", "17 800, next cluster 7", Near(17800, 50), _ON.exact("cluster")),
        Claim(3, "margin (b) over margin (a), medians while the opposing cluster is off",
            "isolation between clusters is normally much more significant than within", words.MUCH_MORE,
            _margin_ratio),
        Claim(4, "median margin (b) while cluster 8 fires over that while it does not",
            "abrupt negative spikes of (b) when the opposing jet is fired",
            Reading(AtMost(1.0 / 3.0), "abrupt: to a third"), _margin_ratio_opposed),
        expected(4, "margin (b) without noise while jet 17 fires", "32.8, next cluster 8", Near(32.8, 0.05),
            _ON.exact("cluster", 17)),
        Claim(5, "least of both margins from 50 to 58 s",
            "always greater than ten throughout the period of the failure", AtLeast(10.0), _least_margin),
        Claim(5, "share of tested samples that name jet 29", "isolation always right", AtLeast(1.0), _ON.right),
    ),
    _ON.magnitudes("5-18",
        reference(6, "RMS error of the force", "(RMS within 1 lbf)", AtMost(1.0), _ON.force_error(rms), "lbf"),
        Claim(6, "largest error of the force", "variations less than 1 lbf over the entire observed period",
            AtMost(1.0), _ON.force_error(_largest), "lbf",
            because=Because(
                "one sample's own 1-sigma is {:.2f} lbf by (4-25) with the sensors of section 5.1; of {:.0f} "
                "tested samples {:.0%} are within 1 lbf",
                (_ON.exact("std"), lambda phase: float(np.count_nonzero(_select_tested(phase["flight"]))),
                 _ON.force_error(_share_within_1_lbf)))),
        expected(6, "1-sigma of the force", "0.97", Near(0.97, 0.005), _ON.exact("std"), "lbf"),
    ),

    _OFF.arguments("5-19",
        Claim(1, "median argument while jet 11 is commanded, over that of jet 29 stuck on",
            "the size of the arguments was comparable to that of the stuck-on case", words.COMPARABLE,
            lambda phase: _OFF.median(phase["flight"]) / _ON.median(phase["hard"])),
        expected(1, "argument without noise", "1.08e6", Near(1.08e6, 0.5e4), _OFF.exact("argument")),
        hard=flights.STUCK_ON,
    ),
    _OFF.margins("5-20",
        Claim(2, "margin (b) at the first sample that shows it",
            "detection and isolation at the first sample after the failure", AtLeast(_MARGIN),
            _OFF.first("cluster_margin")),
        Claim(2, "margin (a) at the first sample that shows it", "isolation at the first sample", AtLeast(_MARGIN),
            _OFF.first("jet_margin")),
        Claim(2, "share of samples with jet 11 commanded that name it", "isolation right", AtLeast(1.0), _OFF.right),
        expected(2, "margin (b) without noise", "1 940, next cluster 2", Near(1940, 5), _OFF.exact("cluster")),
        expected(2, "margin (a) without noise, jet 12 also on", "2.0e4", Near(2.0e4, 0.05e4),
            _OFF.exact("jet", 11, 12)),
        expected(2, "margin (a) without noise, jet 12 off", "about 1e6", Near(1e6, 0.1e6), _OFF.exact("jet")),
    ),
    _OFF.magnitudes("5-21",
        Claim(3, "largest error of the force while commanded", "again accurate to less than 1 lbf", AtMost(1.0),
            _OFF.force_error(_largest), "lbf"),
        expected(3, "1-sigma of the force", "0.84", Near(0.84, 0.005), _OFF.exact("std"), "lbf"),
        Claim(4, "RMS of the force while not commanded",
            "the magnitude estimates likewise jumped as the commands changed",
            Reading(AtMost(1.0), "jumps: to nothing, within 1 lbf"), _force_while_off, "lbf"),
    ),

    _VERNIER.arguments("5-22",
        Claim(2, "orders of magnitude of the median argument below that of jet 29",
            "three to four orders of magnitude smaller than those of the hard failures", words.orders(3, 4),
            _VERNIER.orders_below,
            because=Because(
                "without noise table 5-1 and (4-28) give {:.2f} orders: {:.2f} by the forces, less since a pound "
                "of the vernier shows more",
                (lambda phase: float(np.log10(_ON.exact("argument")(phase) / _VERNIER.exact("argument")(phase))),
                 lambda _: float(2.0 * np.log10(_ON.force / _VERNIER.force))))),
        expected(2, "the same without noise", "ratio 1.4e-3", Near(1.4e-3, 0.5e-4),
            ratio(_VERNIER.exact("argument"), _ON.exact("argument"))),
        expected(1, "argument without noise", "1 121", Near(1121, 0.5), _VERNIER.exact("argument")),
        hard=flights.STUCK_ON,
    ),
    _VERNIER.margins("5-23",
        Claim(1, "margin (b) at the first sample", "cluster detected and isolated at the first sample",
            AtLeast(_MARGIN), _VERNIER.first("cluster_margin")),
        Claim(1, "share of tested samples that name cluster 4", "isolation to the cluster was also significant",
            words.NEARLY_ALL, _VERNIER.right_cluster),
        expected(1, "margin (b) without noise", "582, next cluster 2", Near(582, 0.5), _VERNIER.exact("cluster")),
        Claim(3, "number of the first sample that names the jet",
            "isolation to the particular jet occurred after four time instants", Printed(4.0), _first_named_sample,
            because=Because(
                "which sample is the first is a matter of chance: {:.0%} of the samples name the jet here, and of "
                "independent samples with Gaussian noise {:.0%}, of which {:.0%} of the runs would wait for the "
                "fourth or longer",
                (_share_named, _gaussian_share("named"), lambda phase: (1.0 - _gaussian_share("named")(phase)) ** 3))),
        Claim(3, "longest row of samples that name the jet",
            "no two isolations ever occurred consecutively thereafter", AtMost(1.0),
            lambda phase: float(longest_row(_flag_named(phase))),
            because=Because(
                "{:.0%} of the samples name the jet, so among {:.0f} tested ones two in a row are the rule; with "
                "Gaussian noise of equal variance it is {:.0%}",
                (_share_named, lambda phase: float(_flag_named(phase).size), _gaussian_share("named")))),
        Claim(3, "share of tested samples that name the jet", "isolation to the jet is marginal", words.MARGINAL,
            _share_named),
        expected(3, "the same of independent samples with Gaussian noise", "0.17", Near(0.17, 0.02),
            mean(_gaussian_share("named")), pooled=True),
        expected(3, "mean margin (a) without noise", "2.8, next jet 9", Near(2.8, 0.05), _VERNIER.exact("jet")),
        reference(3, "share of samples whose likeliest jet is the right one", "(best-jet choice right 80 %)",
            Near(0.80, 0.05), _VERNIER.likeliest_is_right,
            because=Because(
                "quantized sensors at rest repeat few values: {:.0%} here, {:.0%} with Gaussian noise of equal "
                "variance", (_VERNIER.likeliest_is_right, _gaussian_share("best")))),
        expected(3, "the same of independent samples with Gaussian noise", "0.80", Near(0.80, 0.02),
            mean(_gaussian_share("best")), pooled=True),
        gaussian=Calculation("vernier_gaussian", analytic.vernier_gaussian, seeds=20),
    ),
    _VERNIER.magnitudes("5-24",
        Claim(4, "share of tested samples whose force is within 1 lbf, (a) failed jet",
            "we can typically estimate the failure magnitude to within 1 lbf", words.TYPICALLY,
            _VERNIER.force_error(_share_within_1_lbf)),
        Claim(4, "the same, (b) jet that maximizes the argument in the cluster",
            "we can typically estimate the failure magnitude to within 1 lbf", words.TYPICALLY,
            _VERNIER.likeliest_within),
        expected(4, "1-sigma of the force", "0.73", Near(0.73, 0.005), _VERNIER.exact("std"), "lbf"),
    ),

    _LEAK.arguments("5-25",
        Claim(1, "orders of magnitude of the median argument below that of jet 29",
            "three to four orders of magnitude smaller than those of the hard failures", words.orders(3, 4),
            _LEAK.orders_below),
        expected(1, "argument without noise", "260", Near(260, 0.5), _LEAK.exact("argument")),
        hard=flights.STUCK_ON,
    ),
    _LEAK.margins("5-26",
        Claim(1, "margin (b) at the first sample", "cluster detected and isolated at the first sample",
            AtLeast(_MARGIN), _LEAK.first("cluster_margin")),
        Claim(1, "share of tested samples that name cluster 10", "isolation to the cluster was also significant",
            words.NEARLY_ALL, _LEAK.right_cluster),
        expected(1, "margin (b) without noise", "81, next cluster 8", Near(81, 0.5), _LEAK.exact("cluster")),
        Claim(2, "samples that name a jet", "no isolation to the jet in the whole run", AtMost(0.0),
            lambda phase: float(_flag_named(phase).sum())),
        expected(2, "mean margin (a) without noise", "0.04, next jet 25", Near(0.04, 0.005), _LEAK.exact("jet")),
        Claim(2, "number of the jet with the largest margin (a)",
            "a lower threshold would first have isolated jet 42, incorrectly", Near(42.0, 0.0),
            _jet_of_largest_margin),
        reference(2, "share of samples whose likeliest jet is a wrong one of the cluster",
            "(jets 24, 25, 26 and 42 compete)", AtLeast(0.25), lambda phase: 1.0 - _LEAK.likeliest_is_right(phase)),
    ),
    _LEAK.magnitudes("5-27",
        Claim(3, "share of tested samples whose force is within 1 lbf, (a) leaking jet",
            "we can typically estimate the failure magnitude to within 1 lbf", words.TYPICALLY,
            _LEAK.force_error(_share_within_1_lbf)),
        Claim(3, "the same, (b) jet that maximizes the argument in the cluster",
            "we can typically estimate the failure magnitude to within 1 lbf", words.TYPICALLY,
            _LEAK.likeliest_within),
        expected(3, "1-sigma of the force", "0.64", Near(0.64, 0.005), _LEAK.exact("std"), "lbf"),
    ),
)
# fmt: on
