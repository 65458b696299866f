"""Section 5.2: what its text says beyond the figures."""

from __future__ import annotations

import numpy as np

from reproduction import flights, words
from reproduction.claims import Array, AtLeast, AtMost, Because, Claim, Measure, Phase, Phases, Reading, Signals
from reproduction.entries.mass import added_variance
from reproduction.entry import Entry
from reproduction.measures import END_S, mass_error, mass_rms, mean_nis, ratio, rms, share_above, used, worst


def _largest_before(case: str, end_s: float) -> Measure:
    """Makes a measure: largest error of 1/m from the first rotation to a time, %."""
    return lambda phase: float(np.abs(mass_error(phase[case], 1.5, end_s)).max())


def _variance_before(run: Signals) -> Array:
    """Returns the variance that the center of mass adds to a velocity increment over the sensor's, before 25 s."""
    result: Array = added_variance(run)[run["time_s"][used(run, "mass")] < 25.0]
    return result


def _last_uncertain_s(phase: Phase) -> float:
    """Returns the last time at which the center of mass added as much variance as the sensor before 25 s, s."""
    run = phase["sample"]
    times_s = run["time_s"][used(run, "mass")]
    return float(times_s[: _variance_before(run).size][_variance_before(run) >= 1.0].max(initial=0.0))


def _variance_after(run: Signals) -> Array:
    """Returns the variance that the center of mass adds to a velocity increment over the sensor's, after 27.5 s."""
    result: Array = added_variance(run)[run["time_s"][used(run, "mass")] > 27.5]
    return result


def _correlation_effect(phases: Phases) -> float:
    """Computes the RMS difference of stacked and serial estimates of 1/m at the end, over the RMS error."""
    stacked, serial = (np.concatenate([mass_error(p[case], END_S) for p in phases]) for case in ("stacked", "serial"))
    return rms(stacked - serial) / rms(serial)


# fmt: off
ENTRIES = (
    Entry(
        "section_5_2",
        "Mass-property estimation, the text",
        {
            "other": flights.OTHER,
            "ignored": flights.OTHER_IGNORED,
            "extended": flights.OTHER_EXTENDED,
            "none": flights.OTHER_NONE,
            "first": flights.TRANSLATION_FIRST,
            "first_incremented": flights.TRANSLATION_FIRST_INCREMENTED,
            "sample": flights.HYBRID,
            "sample_ignored": flights.IGNORED,
            "sample_none": flights.NO_COMPENSATION,
            "serial": flights.SERIAL,
            "stacked": flights.STACKED,
        },
        (
            Claim(1, "another maneuver, rotations first: largest final error of the diagonal",
                "several maneuver histories, similar conclusions resulting from each",
                Reading(AtMost(0.1), "similar: within five times table 5-3's 0.02 %"), worst("other"), "%"),
            Claim(1, "there, coupling ignored over subtracted", "a minor increase in accuracy by subtraction",
                words.SLIGHTLY_MORE, ratio(worst("ignored"), worst("other")),
                because=Because(
                    "final errors scatter: {:.3f} % without and {:.3f} % with subtraction are medians, and single "
                    "phases end more accurate without it, or more than twice as accurate with it",
                    (worst("ignored"), worst("other")))),
            Claim(1, "there, extended Kalman over second-order filter", "the extended Kalman filter diverges",
                words.TREMENDOUS, ratio(worst("extended"), worst("other"))),
            Claim(1, "there, mean consistency function of the rotation filter from 25 s on",
                "chi-square except initially", words.CHI_SQUARE, mean_nis("other", "rotation", 25.0)),
            Claim(1, "there, RMS error of 1/m before the first translation, NONE over T+COV",
                "transverse accelerations have a significant effect on the initial estimation", words.SIGNIFICANT,
                ratio(mass_rms("none", 1.0, 10.9), mass_rms("other", 1.0, 10.9)), pooled=True,
                because=Because(
                    "whether the neglected acceleration drives the estimate off depends on which axes turn first, here "
                    "z and x: the largest error of NONE before the translation is {:.0f} %, in the sample maneuver "
                    "{:.0f} %. Its residuals are as inconsistent here (next claim)",
                    (_largest_before("none", 10.9), _largest_before("sample_none", 24.9)))),
            Claim(1, "there, mean consistency function of the mass filter, NONE",
                "without compensation inconsistent throughout", words.INCONSISTENT, mean_nis("none", "mass")),
            Claim(1, "a maneuver with a translation first: mean consistency function from 25 s on",
                "similar conclusions from each", words.CHI_SQUARE, mean_nis("first", "rotation", 25.0),
                because=Because(
                    "a translation before any rotation is the hardest start: D is large, is taken for noise that "
                    "averages out, and shrinks too fast. The diagonal ends with {:.2f} %; with covariance "
                    "incrementation (section 2.5, off in the sample runs) it is {:.3f} %, and the mean consistency "
                    "function {:.1f}",
                    (worst("first"), worst("first_incremented"), mean_nis("first_incremented", "rotation", 25.0)))),
            Claim(2, "samples from 37 to 46 s that would alarm at 11.34, coupling ignored",
                "in terms of jump detection subtracting is clearly superior",
                Reading(AtLeast(0.1), "inferior: ten times the 1 % of chance"),
                share_above("sample_ignored", 11.34, 37.0, 46.0)),
            Claim(2, "the same, coupling subtracted", "clearly superior",
                Reading(AtMost(0.02), "superior: at most twice the 1 % of chance"),
                share_above("sample", 11.34, 37.0, 46.0)),
            Claim(3,
                "share of the used samples before 25 s to whose variance the uncertain center of mass adds as much as "
                "the sensor", "this uncertainty is often as large as the measurement noise", words.OFTEN,
                lambda phase: float(np.mean(_variance_before(phase["sample"]) >= 1.0)),
                because=Because(
                    "it is for {:.0f} of {:.0f} samples, the last at {:.1f} s, with variances up to {:.1f} times the "
                    "sensor's: residual force then has shown the center of mass",
                    (lambda phase: float(np.count_nonzero(_variance_before(phase["sample"]) >= 1.0)),
                     lambda phase: float(_variance_before(phase["sample"]).size), _last_uncertain_s,
                     lambda phase: float(_variance_before(phase["sample"]).max())))),
            Claim(4, "RMS error of 1/m before 25 s of three sensors over one, their correlation counted",
                "the worse transient of serial processing is due primarily to the correlation of the noises",
                Reading(AtMost(1.0), "counted, no worse than one"),
                ratio(mass_rms("stacked", 1.0, 24.9), mass_rms("sample", 1.0, 24.9)), pooled=True),
            Claim(4, "variance that the center of mass adds to all three sensors after 27.5 s, over that of the sensor",
                "this correlation becomes negligible after the first translational maneuver", words.NEGLIGIBLE,
                lambda phase: float(_variance_after(phase["sample"]).max())),
            Claim(4, "what the correlation changes in the final estimate, RMS over the error",
                "this correlation becomes negligible", words.NEGLIGIBLE, _correlation_effect, pooled=True,
                because=Because(
                    "the correlation itself does (claim above: {:.1e} of the sensor's variance); the final estimates "
                    "still remember the samples before it did",
                    (lambda phase: float(_variance_after(phase["sample"]).max()),))),
        ),
    ),
)
# fmt: on
