"""Figures 5-12 to 5-15: the mass reciprocal, rotational coupling and redundant accelerometers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure

from massprop_drake.display.figures import set_symmetric_log
from reproduction import flights, words
from reproduction.cases import Calculation
from reproduction.checks import updates_per_sample
from reproduction.claims import (
    Array,
    AtLeast,
    AtMost,
    Because,
    Between,
    Claim,
    Measure,
    Near,
    Phase,
    Phases,
    Pooled,
    Printed,
    Reading,
    Signals,
    reference,
)
from reproduction.drawing import consistency, curves, panels
from reproduction.entry import Entry
from reproduction.measures import (
    CENTER,
    END_S,
    MASS,
    at,
    during,
    mass_error,
    mass_rms,
    mean_nis,
    nis,
    orbiter,
    ratio,
    used,
    value,
    worst,
)

_COMPENSATION = {
    **{"all": flights.CENTRIPETAL, "t_cov": flights.TRANSVERSE},
    **{"t": flights.NO_COVARIANCE, "none": flights.NO_COMPENSATION},
}
_COMPENSATION_LABELS = {"all": "T+C+COV", "t_cov": "T+COV", "t": "T", "none": "NONE"}
_SENSORS = {"single": flights.MIDDLE, "left": flights.LEFT, "serial": flights.SERIAL, "weighted": flights.WEIGHTED}


def _largest_error(case: str, start_s: float, end_s: float) -> Measure:
    """Makes a measure: largest error of 1/m over a time, %."""
    return lambda phase: float(np.abs(mass_error(phase[case], start_s, end_s)).max())


def _rms_ratio(numerator: str, denominator: str, start_s: float = END_S, end_s: float = np.inf) -> Pooled:
    """Makes a pooled measure: RMS error of one case over that of another, over a time; at the end without one."""
    return ratio(mass_rms(numerator, start_s, end_s), mass_rms(denominator, start_s, end_s))


def _largest_difference(first: str, second: str, start_s: float) -> Measure:
    """Makes a measure: largest difference of two cases' errors of 1/m from a time on, %."""
    return lambda phase: float(np.abs(mass_error(phase[first], start_s) - mass_error(phase[second], start_s)).max())


def added_variance(run: Signals) -> Array:
    """Largest variance that the center of mass adds to a velocity increment over the sensor's, at the used samples."""
    increments = np.diff(run["rate"], axis=0, prepend=run["rate"][:1])[used(run, "mass")]
    sigma = np.roll(run["standard_deviation"], 1, axis=0)[used(run, "mass"), CENTER]
    added = np.stack([np.cross(increments, sigma * axis) for axis in np.eye(3)])
    noise = 2.0 * orbiter().accelerometers[0].variance
    result: Array = (added**2).sum(axis=0).max(axis=1) / noise
    return result


def _share_uncertain(phase: Phase) -> float:
    """Computes the share of the used samples before 25 s to which the center of mass adds as much as the sensor."""
    run = phase["t_cov"]
    early = run["time_s"][used(run, "mass")] < 25.0
    return float(np.mean(added_variance(run)[early] >= 1.0))


def _count_changes_of_better(phase: Phase) -> float:
    """Counts how often the better one of two sensors changes from 25 s on."""
    better = np.abs(mass_error(phase["left"], 25.0)) < np.abs(mass_error(phase["single"], 25.0))
    return float(np.count_nonzero(np.diff(better.astype(int))))


def _nis_difference(phase: Phase) -> float:
    """Computes the largest difference of NIS by the centripetal term, over the largest NIS without compensation."""
    apart = np.abs(nis(phase["all"], "mass") - nis(phase["t_cov"], "mass")).max()
    return float(apart / nis(phase["none"], "mass").max())


# ----------------------------------------------------------------------------------------- pictures


def _mass_errors(title: str, pairs: tuple[Mapping[str, str], ...]) -> Callable[[Phases], Figure]:
    """Makes a function that draws the error of 1/m, true minus estimate, a panel per pair of cases."""

    def error(run: Signals) -> Array:
        """Returns the error of 1/m, true minus estimate, 1/slug."""
        result: Array = run["truth"][:, MASS] - run["estimate"][:, MASS]
        return result

    def draw(phases: Phases) -> Figure:
        """Draws the picture from all phases."""
        figure, axes = panels(len(pairs), title)
        for panel, labels in zip(axes, pairs, strict=True):
            curves(panel, phases, labels, error)
            set_symmetric_log(panel, 1.7e-6, 5e-4)
            panel.set_ylabel("1/m, 1/slug")
        return figure

    return draw


def _samples_used(case: str) -> Measure:
    """Makes a measure: number of samples used in the translations."""
    return lambda phase: float(np.count_nonzero(used(phase[case], "mass") & during(phase[case], 25.0, 35.5)))


_DEPENDS_ON_TRANSLATION = Because(
    "it depends on how steadily the autopilot translates. Here {:.0f} samples of the translations can be used, and "
    "they nearly undo the error ({:.1f} % at 25 s, {:.1f} % at 27.5 s); with jets selected anew for every 0.02 deg/s "
    "{:.0f} can, and the final errors are {:.1f} % without and {:.1f} % with compensation",
    (
        _samples_used("none"),
        worst("none", MASS, 24.9),
        worst("none", MASS, 27.5),
        _samples_used("held_none"),
        worst("held_none", MASS),
        worst("held", MASS),
    ),
)
_NOT_AT_THE_END = Because(
    "after the first translation the center of mass is known to {:.2g} ft in the worst axis (1-sigma), so COV has "
    "little left to add: final errors {:.2f} % with and {:.2f} % without it; "
    "with closely held rates {:.2f} % and {:.2f} %. Early on it does matter (see the RMS error before 25 s)",
    (
        lambda phase: float(phase["t_cov"]["standard_deviation"][at(phase["t_cov"], 27.5), CENTER].max()),
        worst("t_cov", MASS),
        worst("t", MASS),
        worst("held", MASS),
        worst("held_t", MASS),
    ),
)

_MIDDLE_LABEL = {"single": "middle sensor"}

# fmt: off
ENTRIES = (
    Entry("fig_5_12", "Effect of rotational coupling on the mass reciprocal",
        {**_COMPENSATION, "held": flights.CLOSELY_HELD, "held_none": flights.CLOSELY_HELD_NONE,
            "held_t": flights.CLOSELY_HELD_T}, (
            Claim(1, "largest difference between T+C+COV and T+COV, of the initial error",
                "no difference whatsoever can be observed by excluding the centripetal acceleration", words.NOT_SEEN,
                _largest_difference("all", "t_cov", 0.0), "%"),
            Claim(2, "largest error of NONE before 25 s",
                "excluding it altogether causes the error to diverge until a large translation with little rotation",
                Reading(AtLeast(100.0), "diverges: beyond the initial error"), _largest_error("none", 0.0, 24.9), "%"),
            Claim(2, "final error of NONE", "15 percent", Printed(15.0), worst("none", MASS), "%",
                because=_DEPENDS_ON_TRANSLATION),
            Claim(2, "RMS final error of NONE over that of T+C+COV",
                "final error is large (15 percent versus 1 percent)", Reading(AtLeast(10.0), "15 to 1: tenfold"),
                _rms_ratio("none", "all"), pooled=True, because=_DEPENDS_ON_TRANSLATION),
            Claim(2, "the same over T+COV with closely held rates in the translations",
                "final error is large (15 percent versus 1 percent)", Reading(AtLeast(10.0), "15 to 1: tenfold"),
                _rms_ratio("held_none", "held"), pooled=True, because=_DEPENDS_ON_TRANSLATION),
            Claim(3, "final error of T+C+COV", "1 percent of the initial error", Printed(1.0), worst("all", MASS), "%"),
            reference(3, "final error of T+C+COV", "(0.5 to 3 %)", Between(0.5, 3.0), worst("all", MASS), "%"),
            Claim(4, "RMS error before 25 s of T over that of T+COV",
                "neglecting this uncertainty results in larger estimation errors", Reading(AtLeast(1.0), "larger"),
                _rms_ratio("t", "t_cov", 1.0, 24.9), pooled=True),
            Claim(4, "the same over the same from 25 s on", "especially when the net translations are small",
                Reading(AtLeast(1.0), "more than later"),
                ratio(_rms_ratio("t", "t_cov", 1.0, 24.9), _rms_ratio("t", "t_cov", 25.0)), pooled=True),
            Claim(4, "RMS error from 1 s on of T over that of T+COV", "COV: a significant increase in performance",
                words.SIGNIFICANT, _rms_ratio("t", "t_cov", 1.0), pooled=True,
                because=Because(
                    "the center of mass is uncertain enough to matter in {:.0%} of the used samples before 25 s alone "
                    "(its variance at least that of the sensor); these make the errors larger, but not by half",
                    (_share_uncertain,))),
            Claim(4, "final error of T over that of T+COV", "about three times as large", Printed(3.0),
                ratio(worst("t", MASS), worst("t_cov", MASS)), because=_NOT_AT_THE_END),
            Claim(4, "RMS final error of T over that of T+COV", "about three times as large, as an average",
                Reading(Between(2.5, 3.5), "about three: rounds to it"), _rms_ratio("t", "t_cov"), pooled=True,
                because=_NOT_AT_THE_END),
        ),
        {
            "fig_5_12": _mass_errors(
                "Error of the mass reciprocal, true minus estimate (figure 5-12)",
                tuple({"all": "T+C+COV", case: _COMPENSATION_LABELS[case]} for case in ("t_cov", "t", "none")),
            )
        },
    ),
    Entry("fig_5_13", "Effect of rotational coupling on the translation consistency function", _COMPENSATION, (
            Claim(1, "largest difference between (a) and (b), over the largest value of (d), the height of the panels",
                "(a) and (b) appear identical",
                Reading(AtMost(0.01), "identical to the eye: a line's width, 1 % of the height"), _nis_difference),
            reference(1, "mean of (a)", "(about 1.7 to 2 with quantized sensors)", Between(1.65, 2.05),
                mean_nis("all", "mass")),
            Claim(2, "mean of (d)", "without compensation the residuals are inconsistent", words.INCONSISTENT,
                mean_nis("none", "mass")),
            Claim(2, "mean of (d) from 37 s on", "even after this point the residuals remain inconsistent",
                words.INCONSISTENT, mean_nis("none", "mass", 37.0)),
            Claim(3, "mean of (c) over that of (b), before 25 s", "(c) is worse than (b) early",
                Reading(AtLeast(1.0), "worse"),
                ratio(mean_nis("t", "mass", 0.0, 24.9), mean_nis("t_cov", "mass", 0.0, 24.9))),
        ),
        {
            "fig_5_13": consistency(
                "mass",
                "Consistency function of the mass filter, used samples (figure 5-13)",
                {
                    case: f"({letter}) {_COMPENSATION_LABELS[case]}"
                    for letter, case in zip("abcd", _COMPENSATION, strict=True)
                },
                symbol="ε' Y⁻¹ ε",
                height=1.6,
            )
        },
    ),
    Entry("fig_5_14", "Effect of redundant sensors on the mass reciprocal",
        {**_SENSORS, "counts": Calculation("updates_per_sample", updates_per_sample)}, (
            Claim(1, "final error, left sensor", "2.1 percent", Printed(2.1), worst("left", MASS), "%"),
            Claim(1, "final error, middle sensor", "1.4 percent", Printed(1.4), worst("single", MASS), "%"),
            Claim(1, "RMS final error, left over middle sensor", "the final errors were also comparable",
                words.COMPARABLE, _rms_ratio("left", "single"), pooled=True),
            reference(1, "larger of the two final errors", "(both below 4 %)", AtMost(4.0),
                lambda phase: max(worst("left", MASS)(phase), worst("single", MASS)(phase)), "%"),
            Claim(1, "how often the better of the two changes after 25 s",
                "one slightly more accurate for a while, to be surpassed by the other later", AtLeast(1.0),
                _count_changes_of_better),
            Claim(2, "final error, three serial", "0.8 percent", Printed(0.8), worst("serial", MASS), "%"),
            Claim(2, "RMS final error, serial over single", "a slight increase in accuracy", words.SLIGHTLY_LESS,
                _rms_ratio("serial", "single"), pooled=True),
            Claim(2, "RMS error before 25 s, serial over single", "transient slightly worse than a single sensor",
                words.SLIGHTLY_MORE, _rms_ratio("serial", "single", 1.0, 24.9), pooled=True),
            Claim(3, "largest difference between serial and weighted average over the history, of the initial error",
                "the entire history is virtually identical", words.NOT_SEEN,
                _largest_difference("serial", "weighted", 0.0), "%"),
            Claim(4, "updates per used sample, serial over weighted average", "serial costs three times the work",
                Near(3.0, 0.0), ratio(value("counts", "serial"), value("counts", "weighted_average"))),
        ),
        {
            "fig_5_14": _mass_errors(
                "Error of the mass reciprocal, true minus estimate (figure 5-14)",
                (
                    {**_MIDDLE_LABEL, "left": "left sensor"},
                    {**_MIDDLE_LABEL, "serial": "three, serial"},
                    {**_MIDDLE_LABEL, "weighted": "three, weighted average"},
                ),
            )
        },
    ),
    Entry("fig_5_15", "Effect of redundant sensors on the translation consistency function",
        {"single": flights.MIDDLE, "weighted": flights.WEIGHTED,
            "single_equal": flights.SINGLE_EQUAL, "weighted_equal": flights.WEIGHTED_EQUAL}, (
            Claim(1, "mean of the weighted average over that of a single sensor, equal quantizer phases",
                "the weighted average residuals were somewhat more inconsistent", words.SLIGHTLY_MORE,
                ratio(mean_nis("weighted_equal", "mass"), mean_nis("single_equal", "mass")),
                because=Because(
                    "three sensors a foot apart with their marks at the same places round alike: averaging takes "
                    "nothing off their error but two thirds off its variance, so means are {:.1f} against {:.1f}; a "
                    "factor of three is the most that this can do",
                    (mean_nis("weighted_equal", "mass"), mean_nis("single_equal", "mass")))),
            Claim(1, "the same with phases of their own", "somewhat more inconsistent", words.SLIGHTLY_MORE,
                ratio(mean_nis("weighted", "mass"), mean_nis("single", "mass")),
                because=Because(
                    "with marks of their own the sensors' errors are not alike, and averaging does take them off: "
                    "means are {:.2f} against {:.2f}", (mean_nis("weighted", "mass"), mean_nis("single", "mass")))),
        ),
        {
            "fig_5_15": consistency(
                "mass",
                "Consistency function of the mass filter, used samples (figure 5-15)",
                {
                    "single_equal": "middle sensor",
                    "weighted_equal": "three, weighted average, equal quantizer phases",
                    "weighted": "three, weighted average, phases of their own",
                },
                symbol="ε' Y⁻¹ ε",
                height=1.6,
            )
        },
    ),
)
# fmt: on
