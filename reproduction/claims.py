"""Claims of the thesis: what each one expects, how it is measured, and whether it holds.

A claim is measured once per sensor phase, a run whose quantizers start at other marks and nothing else
differs, because the thesis shows one run of a quantized simulation. Its verdict follows from how the
measured values lie over the phases:

- a threshold or range *holds* when at least 95 % of the phases meet it, *holds within spread* when at
  least half do, and else *differs*;
- a printed number *holds within spread* when it lies inside the central 95 % of the phases, and else
  *differs*: one number from one run can prove no more.

A pooled claim is about all phases together (an RMS, say); its spread comes of drawing the phases anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Signals = Mapping[str, Array]  # of one run, by name, a row per sample
Phase = Mapping[str, Signals]  # runs of one sensor phase, by the label of their case
Phases = Sequence[Phase]
Measure = Callable[[Phase], float]
Pooled = Callable[[Phases], float]  # a measure of all phases together

MOST, HALF = 0.95, 0.5  # of the phases
_CENTRAL = (0.025, 0.975)
_RESAMPLES = 400  # of the phases, for a pooled claim


class Source(StrEnum):
    """The maker of a claim."""

    THESIS = "thesis"  # its words, figures and tables
    REFERENCE = "reference"  # our reference: worked out from the thesis's equations, or found by a check of them
    ERRATA = "errata"  # our reference, on errors of the thesis


class Verdict(StrEnum):
    """The verdict on a claim."""

    HOLDS = "holds"
    SPREAD = "holds within spread"
    DIFFERS = "differs"


@dataclass(frozen=True)
class Between:
    """Expects values in a range, its ends included."""

    low: float
    high: float

    def accepts(self, values: Array) -> NDArray[np.bool_]:
        """Flags the values in the range, shape (n,)."""
        return (values >= self.low) & (values <= self.high)

    def __str__(self) -> str:
        if self.low == -math.inf:
            return f"≤ {number(self.high)}"
        return f"≥ {number(self.low)}" if self.high == math.inf else f"{number(self.low)} to {number(self.high)}"


AtMost = partial(Between, -math.inf)  # a limit
AtLeast = partial(Between, high=math.inf)


@dataclass(frozen=True)
class Near:
    """Expects values that agree with one to a tolerance, such as half its last digit."""

    value: float
    tolerance: float

    def accepts(self, values: Array) -> NDArray[np.bool_]:
        """Flags the values within the tolerance, shape (n,)."""
        return np.abs(values - self.value) <= self.tolerance

    def __str__(self) -> str:
        return f"{number(self.value)} ± {number(self.tolerance)}"


@dataclass(frozen=True)
class Printed:
    """Expects a number that the thesis printed of one run to be among ours."""

    value: float

    def __str__(self) -> str:
        return number(self.value)


@dataclass(frozen=True)
class Reading:
    """Expects what words that leave room are read as.

    Attributes:
        bound: of the values.
        words: how they are read, shown beside the bound.
    """

    bound: Between | Near
    words: str

    def accepts(self, values: Array) -> NDArray[np.bool_]:
        """Flags the values within the bound, shape (n,)."""
        return self.bound.accepts(values)

    def __str__(self) -> str:
        return str(self.bound)


Expectation = Between | Near | Printed | Reading


@dataclass(frozen=True)
class Because:
    """Explains why a claim differs, in a sentence with measured numbers.

    Attributes:
        text: with a place `{}` for each measure, such as `{:.2f}`.
        measures: of one phase each; the median over the phases is put in.
    """

    text: str
    measures: tuple[Measure, ...] = ()

    def write_sentence(self, phases: Phases) -> str:
        """Returns the sentence, with the median of each measure over the phases put in."""
        return self.text.format(*(float(np.median([measure(phase) for phase in phases])) for measure in self.measures))


@dataclass(frozen=True)
class Claim:
    """One thing the thesis says, or our reference of it, and how it is measured.

    Attributes:
        row: number of the row in the reference's table of claims that it belongs to, from 1.
        text: what is measured, in our words.
        thesis: the words or number of the source.
        expect: see the classes above.
        measure: of one phase, or with `pooled` of a list of phases.
        unit: of the measured value.
        pooled: whether it is about all phases together.
        because: shown when the claim differs.
        source: who makes it.
    """

    row: int
    text: str
    thesis: str
    expect: Expectation
    measure: Callable[[Any], float]
    unit: str = ""
    pooled: bool = False
    because: Because | None = None
    source: Source = Source.THESIS

    @property
    def expected(self) -> str:
        """Text of the expected value: the bound with its unit, and how words are read."""
        bound = f"{self.expect} {self.unit}".strip()
        return f"{bound} ({self.expect.words})" if isinstance(self.expect, Reading) else bound


reference = partial(Claim, source=Source.REFERENCE)  # a number of our reference, its words in parentheses
erratum = partial(Claim, source=Source.ERRATA)


def expected(
    row: int,
    text: str,
    words: str,
    expect: Expectation,
    measure: Callable[[Any], float],
    unit: str = "",
    **options: Any,
) -> Claim:
    """Makes a claim of a number that our reference expects; see `Claim`."""
    return reference(row, text, f"(expected {words})", expect, measure, unit, **options)


@dataclass(frozen=True)
class Outcome:
    """A claim and what was measured of it.

    Attributes:
        claim: the claim.
        values: measured, one per phase, or per drawing of the phases for a pooled claim.
        center: the median over the phases, or the pooled value.
        verdict: what becomes of it.
        share: of the values that meet the expectation; for a printed number, of those below it.
        why: of a difference; may be empty.
    """

    claim: Claim
    values: Array
    center: float
    verdict: Verdict
    share: float
    why: str

    @property
    def measured(self) -> str:
        """Text of the measured value: median, central 95 %, and where the thesis's number falls."""
        unit = f" {self.claim.unit}" if self.claim.unit else ""
        if (self.values == self.values[0]).all():
            return f"{number(self.center)}{unit}"
        low, high = _central_range(self.values)
        text = f"{number(self.center)}{unit} ({number(low)} to {number(high)})"
        if isinstance(self.claim.expect, Printed):
            return f"{text}, thesis at {100.0 * self.share:.0f} %"
        return text if self.share in (0.0, 1.0) else f"{text}, met in {100.0 * self.share:.0f} %"


def judge(claim: Claim, phases: Phases) -> Outcome:
    """Measures a claim over the phases, and returns the outcome.

    Args:
        claim: see `Claim`.
        phases: one or more.
    """
    if claim.pooled:
        center = float(claim.measure(phases))
        draws = np.random.default_rng(0).integers(len(phases), size=(_RESAMPLES, len(phases)))
        values = np.array([float(claim.measure([phases[index] for index in draw])) for draw in draws])
    else:
        values = np.array([float(claim.measure(phase)) for phase in phases])
        center = float(np.median(values))
    verdict, share = decide(claim.expect, values)
    differs = claim.because is not None and verdict is Verdict.DIFFERS
    why = claim.because.write_sentence(phases) if claim.because is not None and differs else ""
    return Outcome(claim, values, center, verdict, share, why)


def decide(expectation: Expectation, values: Array) -> tuple[Verdict, float]:
    """Decides on measured values by the rules above; returns the verdict and the share that it rests on.

    Args:
        expectation: see `Claim`.
        values: shape (n,); NaN meets nothing.
    """
    if isinstance(expectation, Printed):
        low, high = _central_range(values)
        below = float(np.mean(values < expectation.value) + 0.5 * np.mean(values == expectation.value))
        return (Verdict.SPREAD if low <= expectation.value <= high else Verdict.DIFFERS), below
    share = float(np.mean(expectation.accepts(values)))
    if share >= MOST:
        return Verdict.HOLDS, share
    return (Verdict.SPREAD if share >= HALF else Verdict.DIFFERS), share


def _central_range(values: Array) -> tuple[float, float]:
    """Computes the ends of the central 95 %; beside infinite or missing values, an end is one of the values."""
    method = "linear" if np.isfinite(values).all() else "nearest"
    low, high = np.quantile(values, _CENTRAL, method=method)  # type: ignore[call-overload]
    return float(low), float(high)


def number(value: float) -> str:
    """Formats a number with three digits, as briefly as it goes."""
    if not math.isfinite(value):
        return f"{value:g}"
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
