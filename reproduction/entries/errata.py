"""The reference's errata and findings, confirmed or refuted by measurement."""

from __future__ import annotations

import numpy as np

from reproduction import analytic, checks, flights
from reproduction.cases import Calculation
from reproduction.claims import AtMost, Because, Between, Near, Pooled, erratum
from reproduction.entry import Entry
from reproduction.measures import mass_rms, mean, mean_nis, nis, ratio, value, worst
from reproduction.words import CHI_SQUARE


def _share_above(limit: float) -> Pooled:
    """Makes a pooled measure: share of healthy samples whose largest argument exceeds a limit."""
    return mean(lambda phase: float(np.mean(phase["rest"]["largest"] > limit)))


def _argument_quantile(level: float) -> Pooled:
    """Makes a pooled measure: quantile of the largest arguments of healthy samples."""
    return lambda phases: float(np.quantile(np.concatenate([phase["rest"]["largest"] for phase in phases]), level))


# fmt: off
ENTRIES = (
    Entry(
        "errata",
        "Errata and findings of the reference, measured again",
        {
            "jump": Calculation("mass_jump_variance", checks.mass_jump_variance, seeds=20),
            "window": Calculation("window_false_alarms", checks.window_false_alarms, seeds=20),
            "corrected": Calculation("corrections", checks.corrections, seeds=20),
            "white": Calculation("whiteness", checks.whiteness, seeds=20),
            "rest": Calculation("at_rest", analytic.at_rest, seeds=20),
            "plain": flights.HYBRID,
            "incremented": flights.INCREMENTED,
            "early": flights.INCREMENTED_EARLY,
            "serial": flights.SERIAL,
            "stacked": flights.STACKED,
        },
        (
            erratum(1, "variance after a jump found in one sample, gain 0.8, true over the exact form",
                "(3-117), (3-118): the cross term is zero", Near(1.0, 0.04),
                ratio(mean(value("jump", "true")), mean(value("jump", "exact"))), pooled=True),
            erratum(1, "the thesis's small-gain form over the true variance, gain 0.8",
                "(3-118) errs on the large side, 7.4 times at this gain", Near(7.4, 0.2),
                ratio(mean(value("jump", "thesis")), mean(value("jump", "true"))), pooled=True),
            erratum(1, "the same, gain 0.004", "and differs little for small gains (1.017)", Near(1.017, 0.03),
                ratio(mean(value("jump", "thesis", 1)), mean(value("jump", "true", 1))), pooled=True),
            erratum(2, "false alarms of a window of five samples at 6.63, small gain",
                "below (3-110): not chi-square with N degrees; 3.8 %", Near(0.038, 0.002),
                mean(value("window", "share", (0, 0))), pooled=True,
                because=Because(
                    "it depends on the gain, which the reference does not give: {:.1%} here, {:.1%} with a prior as "
                    "uncertain as one sample",
                    (value("window", "share", (0, 0)), value("window", "share", (1, 0))))),
            erratum(2, "the same with a prior as uncertain as one sample", "3.8 %", Near(0.038, 0.002),
                mean(value("window", "share", (1, 0))), pooled=True),
            erratum(2, "at the value of one degree for 1 % / 5, small gain", "0.8 %", Near(0.008, 0.001),
                mean(value("window", "share", (0, 1))), pooled=True),
            erratum(2, "the same with a prior as uncertain as one sample", "0.8 %", Near(0.008, 0.001),
                mean(value("window", "share", (1, 1))), pooled=True),
            erratum(3, "variance after a corrected sample, true over claimed, gains kept (4.5)",
                "(4-34), (4-35): the corrected residual has covariance Y - C; 1.00", Near(1.0, 0.05),
                mean(value("corrected", "ours")), pooled=True),
            erratum(3, "the same with the thesis's smaller gains", "1.1 to 1.2: claimed too small", Between(1.05, 1.25),
                mean(value("corrected", "thesis")), pooled=True),
            erratum(4, "healthy samples whose largest argument of 44 exceeds 6.63",
                "(4-27): 4.8 %, five times the 1 % of one jet", Near(0.048, 0.0015), _share_above(6.635), pooled=True),
            erratum(4, "their 99 % value", "9.7", Near(9.7, 0.15), _argument_quantile(0.99), pooled=True),
            erratum(4, "their 99.9 % value", "14.3", Near(14.3, 0.4), _argument_quantile(0.999), pooled=True),
            erratum(5, "healthy samples that pass the margin of six", "0.0015 per sample", Near(0.0015, 0.0002),
                mean(lambda phase: float(np.mean(phase["rest"]["cluster_margin"] > analytic.MARGIN))), pooled=True),
            erratum(6, "correlation of the noises of consecutive increments",
                "8.2: first differences, correlation -1/2", Near(-0.5, 0.02), mean(value("white", "correlation")),
                pooled=True),
            erratum(7, "share of phases with a bad start (mean consistency above 100)", "8.4: rare bad starts, 1 of 24",
                Between(0.0, 0.15), mean(lambda phase: nis(phase["plain"], "rotation").mean() > 100.0), pooled=True),
            erratum(8, "largest error of the diagonal with covariance incrementation at 25",
                "8.4: it cures them; worst 0.04 %", AtMost(0.04), worst("incremented"), "%"),
            erratum(8, "mean consistency with incrementation at 25", "consistent in every phase", CHI_SQUARE,
                mean_nis("incremented", "rotation")),
            erratum(8, "mean consistency with incrementation at 11.34", "consistent in every phase", CHI_SQUARE,
                mean_nis("early", "rotation")),
            erratum(9, "RMS final error of 1/m, one stacked update over serial updates",
                "3.6: the same answer were the errors independent", Near(1.0, 0.1),
                ratio(mass_rms("stacked"), mass_rms("serial")), pooled=True),
        ),
    ),
)
# fmt: on
