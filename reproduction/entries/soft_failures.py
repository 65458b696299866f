"""Section 5.3.2: the sweep of soft failures over all jets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from reproduction import analytic
from reproduction.analytic import FORCES, MARGIN
from reproduction.cases import Calculation
from reproduction.claims import (
    AtLeast,
    AtMost,
    Because,
    Claim,
    Measure,
    Near,
    Phase,
    Phases,
    Reading,
    expected,
    reference,
)
from reproduction.drawing import TRUTH_COLOR, heat_map
from reproduction.entry import Entry
from reproduction.flights import UNSEEN_LEAK
from reproduction.measures import during, orbiter
from reproduction.words import MOST_JETS


def _count_separable(force: float, *margins: str) -> Measure:
    """Makes a measure: number of jets whose margins without noise exceed six at a force, lbf."""
    return lambda phase: float(
        np.count_nonzero(np.all([phase["exact"][margin] * force**2 > MARGIN for margin in margins], axis=0))
    )


def _median_force(phase: Phase) -> float:
    """Computes the median over the jets of the force at which both margins without noise are six, lbf."""
    margins = np.minimum(phase["exact"]["jet_margin"], phase["exact"]["cluster_margin"])
    return float(np.median(np.sqrt(MARGIN / margins)))


def _count_isolated(target: str, force: float) -> Measure:
    """Makes a measure: number of jets isolated in at least half of the samples at a force, lbf."""
    column = int(np.flatnonzero(force == FORCES)[0])
    return lambda phase: float(np.count_nonzero(phase["sampled"][target][:, column] >= 0.5))


def _share_wrong(kind: str) -> Measure:
    """Makes a measure: share of wrong names over all jets and forces."""
    return lambda phase: float(phase["sampled"][kind].mean())


def _count_alarms(phase: Phase) -> float:
    """Counts the alarms of the flight with a leak of 10 lbf in jet 27."""
    run = phase["flight"]
    return float(run["alarm"][during(run, 50.08, 58.0)].sum())


def _cluster_11_leak(quantity: str) -> Measure:
    """Makes a measure: argument, margin, ambiguity or a cluster's force, jet 27 leaking 10 lbf without noise."""

    def measure(_: Phase) -> float:
        """Computes the quantity, which is the same in every phase."""
        tests, isolation = analytic.noise_free_tests(27, 10.0)
        clusters = analytic.setting().clusters
        if quantity == "argument":
            return float(tests.likelihood[26])
        if quantity == "margin":
            return isolation.cluster_margin
        if quantity == "ambiguity":
            others = min(tests.likelihood[clusters == cluster].max() for cluster in (5, 8))
            return float(tests.likelihood[26] - others)
        inside = np.flatnonzero(clusters == int(quantity))
        return float(tests.magnitude[inside[tests.likelihood[inside].argmax()]])

    return measure


def _force_std(clusters: tuple[int, ...], extreme: Callable[..., float], *, excluded: bool = False) -> Measure:
    """Makes a measure: smallest or largest 1-sigma of the force, of the jets in some clusters or outside them, lbf."""

    def measure(phase: Phase) -> float:
        """Computes the extreme in one phase, lbf."""
        inside = np.isin(phase["exact"]["cluster"], clusters)
        return float(extreme(phase["exact"]["force_std"][~inside if excluded else inside]))

    return measure


def _draw_shares(phases: Phases) -> Figure:
    """Draws shares of samples that isolate cluster and jet, and a line where the margin without noise is six."""
    figure = Figure(figsize=(9.0, 8.0), dpi=100, layout="constrained")
    figure.suptitle("Leaks isolated from one sample, all jets off (section 5.3.2)", fontsize=11)
    jets = orbiter().jets
    order = sorted(range(len(jets)), key=lambda index: (jets[index].cluster, index))
    rows = [f"{jets[index].designation} ({jets[index].cluster})" for index in order]
    columns = [f"{force:.0f}" for force in FORCES]
    for panel, target, title in zip(
        figure.subplots(1, 2), ("cluster", "jet"), ("its cluster", "the jet itself"), strict=True
    ):
        share = np.mean([phase["sampled"][target] for phase in phases], axis=0)
        heat_map(panel, share[order], columns, rows, "share of samples")
        panel.set_title(f"{title}; line: margin without noise passes 6", fontsize=9)
        needed = np.sqrt(MARGIN / phases[0]["exact"][f"{target}_margin"][order])
        edge = np.clip((needed - FORCES[0]) / (FORCES[1] - FORCES[0]), -0.5, len(FORCES) - 0.5)
        panel.step(np.append(edge, edge[-1]), np.arange(len(order) + 1) - 0.5, where="pre", color="w", linewidth=2.2)
        panel.step(
            np.append(edge, edge[-1]), np.arange(len(order) + 1) - 0.5, where="pre", color=TRUTH_COLOR, linewidth=1
        )
    return figure


_LINES_NEAR_CENTER = (1, 7, 11)

# fmt: off
ENTRIES = (
    Entry(
        "section_5_3_2",
        "Sweep of soft failures",
        {
            "exact": Calculation("separations", analytic.separations),
            "sampled": Calculation("soft_failures", analytic.soft_failures, seeds=20),
            "flight": UNSEEN_LEAK,
        },
        (
            *(
                expected(1, f"jets with both margins above 6 without noise at {force} lbf", f"{count}",
                    Near(count, 0), _count_separable(force, "jet_margin", "cluster_margin"))
                for force, count in ((20, 7), (30, 8), (50, 14))
            ),
            Claim(1, "jets named in at least half of the samples at 20 lbf, quantized sensors",
                "soft failures could be isolated to the jet in the range of 20 to 50 lbf, depending on the jet",
                Reading(AtLeast(1), "from 20 lbf: some of 44"), _count_isolated("jet", 20.0)),
            Claim(1, "the same at 50 lbf",
                "soft failures could be isolated to the jet in the range of 20 to 50 lbf, depending on the jet",
                Reading(AtLeast(23), "to 50 lbf: most, more than half of 44"), _count_isolated("jet", 50.0),
                because=Because(
                    "without noise {:.0f} of 44 jets pass six at 50 lbf, and half of all need {:.0f} lbf or more: "
                    "jets of one cluster lie about a foot apart and point alike",
                    (_count_separable(50.0, "jet_margin", "cluster_margin"), _median_force))),
            reference(1, "share of samples that name a wrong jet, all jets and forces", "(none)", AtMost(0.005),
                _share_wrong("wrong_jet")),
            *(
                expected(2, f"jets with margin (b) above 6 without noise at {force} lbf", f"{count}",
                    Near(count, 0), _count_separable(force, "cluster_margin"))
                for force, count in ((10, 24), (20, 34), (30, 36), (50, 36))
            ),
            Claim(2, "jets whose cluster is named in at least half of the samples at 10 lbf, quantized sensors",
                "isolation to the cluster could be accomplished for most of the jets down to the 10 lbf level",
                MOST_JETS, _count_isolated("cluster", 10.0)),
            reference(2, "share of samples that name a wrong cluster, all jets and forces", "(none)", AtMost(0.005),
                _share_wrong("wrong_cluster")),
            Claim(3, "alarms in 8 s of jet 27 leaking 10 lbf", "no alarm for a 10 lbf leak in cluster 11", AtMost(0),
                _count_alarms),
            expected(3, "its argument without noise", "7.7", Near(7.7, 0.05), _cluster_11_leak("argument")),
            expected(3, "its margin without noise", "0.11, next cluster 8", Near(0.11, 0.005),
                _cluster_11_leak("margin")),
            Claim(3, "argument of jet 27 less the smaller of those of clusters 5 and 8, without noise",
                "it could not be distinguished from a leak in cluster 5 or 8", AtMost(MARGIN),
                _cluster_11_leak("ambiguity")),
            Claim(3, "larger of the forces that a leak in cluster 5 or 8 would have", "from an even smaller leak",
                AtMost(10.0), lambda phase: max(_cluster_11_leak("5")(phase), _cluster_11_leak("8")(phase)), "lbf"),
            reference(3, "force that a leak in cluster 8 would have", "(2.5 lbf)", Near(2.5, 0.05),
                _cluster_11_leak("8"), "lbf"),
            reference(3, "force that a leak in cluster 5 would have", "(1.3 lbf)", Near(1.3, 0.05),
                _cluster_11_leak("5"), "lbf"),
            expected(4, "least 1-sigma of a force, clusters 1, 7, 11 apart", "0.60 lbf", Near(0.60, 0.005),
                _force_std(_LINES_NEAR_CENTER, np.min, excluded=True), "lbf"),
            expected(4, "largest, clusters 1, 7, 11 apart", "0.97 lbf", Near(0.97, 0.005),
                _force_std(_LINES_NEAR_CENTER, np.max, excluded=True), "lbf"),
            expected(4, "largest, clusters 1, 7, 11", "6.9 lbf", Near(6.9, 0.05),
                _force_std(_LINES_NEAR_CENTER, np.max), "lbf"),
        ),
        {"section_5_3_2": _draw_shares},
    ),
)
# fmt: on
