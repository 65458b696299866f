"""Section 6.1: the conclusions, from the runs of all figures."""

from __future__ import annotations

import numpy as np

from reproduction import analytic, checks, flights, words
from reproduction.cases import Calculation
from reproduction.claims import AtLeast, AtMost, Because, Claim, Measure, Phase, Pooled, Reading
from reproduction.entry import Entry
from reproduction.measures import MASS, difference_in_sigma, mass_rms, mean_nis, percent_error, ratio, value, worst


def _final_ratio(case: str) -> Pooled:
    """Makes a pooled measure: RMS error of 1/m at the end over that of the sample run."""
    return ratio(mass_rms(case), mass_rms("base"))


def _right_share(jet_number: int, case: str) -> Measure:
    """Makes a measure: of alarms after 50 s that name a jet, the share that name this one."""

    def measure(phase: Phase) -> float:
        """Computes the share in one phase."""
        run = phase[case]
        named = (run["jet_isolated"][:, 0] != 0.0) & (run["time_s"] > 50.0 + 1e-6)
        return float(np.mean(run["suspected_jet"][named, 0] == jet_number - 1))

    return measure


# fmt: off
ENTRIES = (
    Entry(
        "section_6_1",
        "Conclusions",
        {
            "base": flights.HYBRID,
            "ignored": flights.IGNORED,
            "centripetal": flights.CENTRIPETAL,
            "none": flights.NO_COMPENSATION,
            "extended": flights.EXTENDED,
            "serial": flights.SERIAL,
            "weighted": flights.WEIGHTED,
            "average": flights.AVERAGE,
            "mid_value": flights.MID_VALUE,
            "stuck_on": flights.STUCK_ON,
            "stuck_off": flights.STUCK_OFF,
            "exact": Calculation("separations", analytic.separations),
            "counts": Calculation("updates_per_sample", checks.updates_per_sample),
        },
        (
            Claim(1,
                "largest difference that ignoring coupling makes in an estimate of the diagonal at 36.9 s, before "
                "rates rise, over the filter's 1-sigma",
                "coupling is negligible when firings are near-impulsive, or whenever rates are small", words.NEGLIGIBLE,
                difference_in_sigma("base", "ignored", 36.9)),
            Claim(1, "final error of 1/m with the centripetal term, difference to that without",
                "so is the centripetal acceleration",
                Reading(AtMost(0.1), "negligible: a tenth of the final error of 1 %"),
                lambda phase: float(
                    abs(percent_error(phase["centripetal"])[-1, MASS] - percent_error(phase["base"])[-1, MASS])
                ), "%"),
            Claim(1, "largest final error of the diagonal, coupling ignored over subtracted",
                "a minor increase in accuracy can be obtained by subtracting it", words.SLIGHTLY_MORE,
                ratio(worst("ignored"), worst("base")),
                because=Because(
                    "{:.4f} % with and {:.3f} % without: rates with two axes commanded are not small, and until then "
                    "the two differ by {:.2f} of the filter's 1-sigma",
                    (worst("base"), worst("ignored"), difference_in_sigma("base", "ignored", 36.9)))),
            Claim(2, "RMS error of 1/m before 25 s, NONE over T+COV",
                "transverse acceleration has a significant effect on the initial estimation of 1/m", words.SIGNIFICANT,
                ratio(mass_rms("none", 1.0, 24.9), mass_rms("base", 1.0, 24.9)), pooled=True),
            Claim(3, "largest final error of the diagonal, extended Kalman filter",
                "the extended Kalman filter is unacceptable",
                Reading(AtLeast(5.0), "unacceptable: 200 times table 5-3's 0.02 %"), worst("extended"), "%"),
            Claim(3, "its mean consistency function from 25 s on",
                "the neglected bias leads to highly inconsistent residuals", words.HIGHLY_INCONSISTENT,
                mean_nis("extended", "rotation", 25.0)),
            *(
                Claim(4, f"RMS final error of 1/m, {rule} over single",
                    "a slight increase in accuracy by averaging or mid-value selection", words.SLIGHTLY_LESS,
                    _final_ratio(case), pooled=True)
                for case, rule in (
                    ("weighted", "three by weighted average"),
                    ("average", "three by average"),
                    ("mid_value", "three by mid-value"),
                )
            ),
            Claim(4, "RMS final error of 1/m, serial over weighted average, distance from 1",
                "serial processing does not lead to a perceptible increase in performance",
                Reading(AtMost(0.01), "perceptible: 1 %"),
                lambda phases: abs(_final_ratio("serial")(phases) / _final_ratio("weighted")(phases) - 1.0),
                pooled=True),
            Claim(4, "its updates per sample over those of the weighted average", "it increases the load considerably",
                words.CONSIDERABLE, ratio(value("counts", "serial"), value("counts", "weighted_average"))),
            Claim(5, "share of jets named that are right, jet 29 stuck on",
                "CGLR isolates hard failures even among close, similar jets", AtLeast(1.0),
                _right_share(29, "stuck_on")),
            Claim(5, "the same, jet 11 stuck off", "hard failures", AtLeast(1.0), _right_share(11, "stuck_off")),
            Claim(5, "largest force over least that one sample needs to tell a cluster from all others",
                "the ability to isolate soft failures depends considerably upon observability and separability",
                words.MUCH_MORE,
                lambda phase: float(
                    np.sqrt(phase["exact"]["cluster_margin"].max() / phase["exact"]["cluster_margin"].min())
                )),
        ),
    ),
)
# fmt: on
