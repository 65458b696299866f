r"""Consistency of the filters: a verdict from their innovations, and from the errors if known.

NIS, the square of an innovation in units of its own covariance, is chi-square distributed if the claims are true. Its
mean is ruled by a single bad sample, and says nothing of many that are a little bad. So two shares are counted: of
samples beyond the 99 % point of the distribution, and of those in its upper quarter. A flight is called inconsistent
when either share is beyond doubt (binomial, 99.9 %) larger than what consistent flights have shown at the most: 2.5 %
in place of 1, and half in place of a quarter, since innovations of one flight are not independent where thrust errors
are considered. Smaller innovations than claimed, as those of a sensor whose quantum exceeds the signal, are no fault.

Where a detector follows hypotheses, the verdict judges the innovations of the likeliest history. At a sample at which
another history becomes the likeliest, sums over its own innovations since the fork replace those that were reported,
see `likeliest_innovations`. Of such samples the mean is known, and not which are beyond a point. They are counted as
the share beyond it that chi-square has when it is scaled to that mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import Count, Real, Text

Array = NDArray[np.float64]

CONSISTENT, INCONSISTENT, TOO_LITTLE = "consistent", "inconsistent", "not enough data"

# signals that say what a NIS is expected to be, as of so many components, where that varies
COMPONENTS = {"rotation": "gyro_components", "mass": "accelerometer_components"}

_LEAST_FACTOR = 1e-6  # of NIS over its expectation: less has no tail
_TAIL, _QUARTER = 0.01, 0.25  # probabilities of the two points
_TAIL_ALLOWED, _QUARTER_ALLOWED = 0.025, 0.5  # shares of a flight
_DOUBT = 0.001  # probability of calling a flight inconsistent that is at the limit
_FEWEST = 20  # samples of the rotation filter, below which nothing is said
_RULED = 2.0  # times the mean of the other samples: such a mean is ruled by the few beyond the 99 % point
_SAME_S = 1e-6  # times that are no farther apart are the same
_FAR = 5.0  # sigma: of ten parameters one in 170,000 consistent flights has an error like this


class Diagnosis(NamedTuple):
    """Diagnosis: an assumption that a run's readings contradict.

    Attributes:
        kind: "factor", "jet", "thrust", "lag", "delay", "torque", "drag", "momentum", "gyro_bias",
            "acceleration_bias", "gyro_scale", "gyro_sign", "accelerometer_scale", "accelerometer_sign",
            "oscillation", "drift", "disturbance", "jitter", "noise" or "start".
        reason: in words.
        statistic: of its test.
        threshold: that it exceeds.
    """

    kind: Text
    reason: Text
    statistic: Real
    threshold: Real


class Innovations(NamedTuple):
    """Innovations of one filter by sample.

    Attributes:
        used: whether the filter used the sample, shape (n,).
        nis: scaled to three components, NaN where not used, shape (n,).
        components: expectation of the unscaled NIS, shape (n,).
        averaged: whether these two are means over several samples, shape (n,).
    """

    used: NDArray[np.bool_]
    nis: Array
    components: Array
    averaged: NDArray[np.bool_]


class Forks(NamedTuple):
    """Samples at which another history has become the likeliest.

    Attributes:
        rows: of these samples, in their order, shape (k,).
        since_s: time of each fork, s, shape (k,).
        nis: sum of the unscaled NIS of the new history from there to the sample, shape (k,).
        components: its expectation, shape (k,).
    """

    rows: NDArray[np.int_]
    since_s: Array
    nis: Array
    components: Array


class Consistency(NamedTuple):
    """Consistency of the filters' innovations with the covariance they claim.

    Attributes:
        rotation_nis_mean: mean NIS of the rotation filter over the samples it used; None without any.
        translation_nis_mean: the same of the mass filter; None without any, or without accelerometer.
        samples: number of samples that the rotation filter used.
        verdict: "consistent", "inconsistent" or "not enough data"; empty in what an earlier version wrote.
        reasons: for "inconsistent".
        rotation_nis_beyond, translation_nis_beyond: share of the samples beyond the 99 % point; None like the means.
        diagnoses: what the readings contradict, see `results.diagnoses`; their words are among the reasons.
        rotation_nis_within, translation_nis_within: mean NIS of the other samples, those within the 99 % point, which
            is not ruled by those of a failure until it is declared; None like the means.
    """

    rotation_nis_mean: Real | None
    translation_nis_mean: Real | None
    samples: Count
    verdict: Text = ""
    reasons: Sequence[Text] = ()
    rotation_nis_beyond: Real | None = None
    translation_nis_beyond: Real | None = None
    diagnoses: tuple[Diagnosis, ...] = ()
    rotation_nis_within: Real | None = None
    translation_nis_within: Real | None = None

    def in_words(self) -> str:
        """Describes the mean NIS of rotation and translation, and the number of samples used, in words."""
        rotation = mean_in_words(self.rotation_nis_mean, self.rotation_nis_within, self.rotation_nis_beyond)
        translation = mean_in_words(self.translation_nis_mean, self.translation_nis_within, self.translation_nis_beyond)
        return f"mean NIS {rotation} rotation, {translation} translation, over {self.samples} samples used"


def mean_in_words(mean: float | None, mean_within: float | None, share_beyond: float | None) -> str:
    """Formats a mean NIS; where outliers beyond the 99 % point dominate it, the mean without them first.

    Args:
        mean: of all samples; None without any.
        mean_within: of the samples within the 99 % point.
        share_beyond: share of the samples beyond it, 0 to 1.
    """
    if mean is None:
        return "-"
    if mean_within is None or share_beyond is None or not is_mean_dominated(mean, mean_within):
        return f"{mean:.2f}"
    return f"{mean_within:.2f} ({mean:.4g} with the {100.0 * share_beyond:.2g} % beyond their 99 % point)"


def is_mean_dominated(mean: float, mean_within: float) -> bool:
    """Tests whether outliers dominate a mean NIS: it is at least twice that of samples within the 99 % point."""
    return mean >= _RULED * mean_within


class Tally:
    """Running count of the NIS of one filter, its mean and its excess beyond chi-square limits.

    Attributes:
        NUMBERS: names of the numbers that it comes to.
    """

    NUMBERS = ("n", "sum", "expected", "sum_within", "expected_within", "beyond_tail", "beyond_quarter")

    def __init__(self) -> None:
        self.n = 0
        self._sum = self._expected = self._sum_within = self._expected_within = 0.0  # in threes of components
        self._beyond = [0.0, 0.0]
        self._explained = [0.0, 0.0, 0.0]  # samples of which it is known why they are what they are, and those beyond

    @classmethod
    def from_counts(cls, counts: Array) -> Tally:
        """Makes a tally from the counts and sums of another, shape (7,), in the order of `NUMBERS`."""
        tally = cls()
        n, tally._sum, tally._expected, tally._sum_within, tally._expected_within, *beyond = counts.tolist()
        tally.n, tally._beyond = int(n), beyond
        return tally

    @property
    def numbers(self) -> Array:
        """Returns counts and sums in the order of `NUMBERS`, shape (7,), from which `Tally.from_counts` goes on."""
        sums = self._sum, self._expected, self._sum_within, self._expected_within
        return np.array([self.n, *sums, *self._beyond], dtype=float)

    def add(self, nis: Array, components: Array) -> None:
        """Adds samples: NIS scaled to three components, and its unscaled expectation, shape (n,) each."""
        from scipy.special import chdtrc  # noqa: PLC0415 (slow to load, and what runs in real time needs none)

        self.n += nis.size
        threes = components / 3.0
        self._sum += float((nis * threes).sum())
        self._expected += float(threes.sum())
        # what a wide cell tells spreads less than chi-square, by which one component is the least
        chance = chdtrc(np.maximum(components, 1.0), nis * threes)
        # one by one, so that it does not depend on how the samples come in blocks
        for value, weight in zip(nis[chance >= _TAIL].tolist(), threes[chance >= _TAIL].tolist(), strict=True):
            self._sum_within += value * weight
            self._expected_within += weight
        self._beyond = [
            count + int((chance < least).sum()) for count, least in zip(self._beyond, (_TAIL, _QUARTER), strict=True)
        ]

    def add_averaged(self, nis: Array, components: Array) -> None:
        """Adds samples of which only the mean NIS over several is known, shape (n,) each.

        Args:
            nis: means, scaled to three components.
            components: means of the expectation of the unscaled NIS.
        """
        from scipy.special import chdtrc, chdtri  # noqa: PLC0415 (slow to load)

        self.n += nis.size
        threes, degrees = components / 3.0, np.maximum(components, 1.0)
        unscaled = nis * threes
        self._sum += float(unscaled.sum())
        self._expected += float(threes.sum())
        within = chdtrc(degrees, unscaled) >= _TAIL
        self._sum_within += float(unscaled[within].sum())
        self._expected_within += float(threes[within].sum())
        factor = np.maximum(unscaled / degrees, _LEAST_FACTOR)
        for index, least in enumerate((_TAIL, _QUARTER)):
            self._beyond[index] += float(chdtrc(degrees, chdtri(degrees, least) / factor).sum())

    def add_innovations(self, innovations: Innovations) -> None:
        """Adds the NIS of the samples that the filter used, single ones and averages, to the counts."""
        for add, chosen in ((self.add, ~innovations.averaged), (self.add_averaged, innovations.averaged)):
            used = innovations.used & chosen
            if used.any():
                add(innovations.nis[used], innovations.components[used])

    def exclude_from_faults(self, nis: Array, components: Array) -> None:
        """Excludes samples from `faults`, such as those between a payload's docking and its declaration."""
        excluded = Tally()
        excluded.add(nis, components)
        self._explained = [float(excluded.n), *excluded._beyond]

    @property
    def mean(self) -> float | None:
        """Mean NIS over its expectation, about 1 if consistent; None without informative samples."""
        return self._sum / self._expected if self._expected else None

    @property
    def beyond(self) -> float | None:
        """Share of samples whose NIS is beyond the 99 % point of chi-square; None without a sample."""
        return self._beyond[0] / self.n if self.n else None

    @property
    def within(self) -> float | None:
        """Mean NIS over its expectation, of samples within the 99 % point of chi-square; None without any."""
        return self._sum_within / self._expected_within if self._expected_within else None

    def faults(self, filter_name: str) -> list[str]:
        """Lists in words signs of inconsistency: NIS beyond the 99 % point or in the upper quarter too often."""
        reasons = []
        n, tail, quarter = (
            count - known for count, known in zip((self.n, *self._beyond), self._explained, strict=True)
        )
        n = int(n)
        if _exceeds_share(tail, n, _TAIL_ALLOWED):
            reasons.append(f"{100.0 * tail / n:.3g} % of the {filter_name} innovations are beyond their 99 % point")
        if _exceeds_share(quarter, n, _QUARTER_ALLOWED):
            reasons.append(f"{100.0 * quarter / n:.3g} % of the {filter_name} innovations are in their upper quarter")
        return reasons


def used_nis(filter_name: str, signals: Mapping[str, Array]) -> tuple[Array, Array]:
    """Returns NIS of the samples that a filter used, scaled to three components, and its unscaled expectation, (k,).

    Args:
        filter_name: "rotation" or "mass".
        signals: by name, as in a run, shape (n, components).
    """
    samples = innovations(filter_name, signals)
    return samples.nis[samples.used], samples.components[samples.used]


def innovations(filter_name: str, signals: Mapping[str, Array]) -> Innovations:
    """Reads a filter's innovations from signals: use, NIS and its expectation by sample; arguments as `used_nis`."""
    used = signals[f"{filter_name}_used"][:, 0] != 0.0
    nis = signals[f"{filter_name}_nis"][:, 0]
    components = (
        signals[COMPONENTS[filter_name]][:, 0] if COMPONENTS[filter_name] in signals else np.full(nis.size, 3.0)
    )
    return Innovations(used, nis, components, np.zeros(nis.size, dtype=np.bool_))


def fork_signals(filter_name: str) -> tuple[str, str, str]:
    """Returns a filter's signal names at forks (change of the likeliest hypothesis): time, NIS, its expectation."""
    return "history_since", f"history_{filter_name}_nis", f"history_{filter_name}_components"


def find_forks(filter_name: str, signals: Mapping[str, Array]) -> Forks:
    """Returns the samples at which another hypothesis became the likeliest, with its NIS; arguments as `used_nis`."""
    rows = np.flatnonzero(np.isfinite(signals["history_since"][:, 0]))
    since_s, nis, components = (signals[column][rows, 0] for column in fork_signals(filter_name))
    return Forks(rows, since_s, nis, components)


def likeliest_innovations(reported: Innovations, time_s: Array, forks: Forks) -> Innovations:
    """Replaces NIS since a fork (where the newly likeliest hypothesis left the former) by the new hypothesis's mean.

    Where two forks overlap the later one counts, and of the earlier one its mean elsewhere.

    Args:
        reported: innovations as logged.
        time_s: sample times, s, shape (n,).
        forks: see `Forks`.
    """
    used, nis = reported.used.copy(), reported.nis.copy()
    components, averaged = reported.components.copy(), reported.averaged.copy()
    for row, since_s, total, expected in zip(*(part.tolist() for part in forks), strict=True):
        first = int(np.searchsorted(time_s, since_s + _SAME_S, side="right"))
        span = np.arange(first, row + 1)
        if expected > 0.0:
            there = span[used[span]] if used[span].any() else span
            nis[there], components[there] = 3.0 * total / expected, expected / there.size
            used[there] = averaged[there] = True
        else:
            used[span] = False
    return Innovations(used, nis, components, averaged)


def _exceeds_share(count: float, n_samples: int, allowed_share: float) -> bool:
    """Tests whether a count out of some samples exceeds the allowed share at 0.1 % significance (binomial)."""
    from scipy.special import bdtrc  # noqa: PLC0415 (slow to load, and what runs in real time needs none)

    return count > 0.0 and float(bdtrc(count - 1.0, n_samples, allowed_share)) < _DOUBT  # of a fraction the whole part


def judge_consistency(
    rotation: Tally, translation: Tally, errors: Array, symbols: Sequence[str], diagnoses: Sequence[Diagnosis] = ()
) -> Consistency:
    """Judges whether a run is consistent, with reasons if not, by NIS and by estimation errors if known.

    Args:
        rotation, translation: NIS of the two filters, or parts of one; without samples where there is none.
        errors: of the ten parameters over their 1-sigma, NaN where the truth is not known, shape (10,).
        symbols: of the ten parameters.
        diagnoses: assumptions that the readings contradict.
    """
    reasons = [*(one.reason for one in diagnoses), *rotation.faults("rotation"), *translation.faults("translation")]
    reasons += [
        f"{symbol} is {abs(ratio):.3g} of its sigmas off"
        for symbol, ratio in zip(symbols, errors.tolist(), strict=True)
        if math.isfinite(ratio) and abs(ratio) > _FAR
    ]
    verdict = INCONSISTENT if reasons else CONSISTENT if rotation.n >= _FEWEST else TOO_LITTLE
    return Consistency(
        rotation.mean,
        translation.mean,
        rotation.n,
        verdict,
        reasons,
        rotation.beyond,
        translation.beyond,
        tuple(diagnoses),
        rotation.within,
        translation.within,
    )
