"""Probability distributions as a campaign's file writes them: a block with one tag and plain names.

    {normal: {mean: 0.0, std: 0.01}}

Every draw is made from a coordinate of the unit cube by the inverse of the distribution function, so that random,
Latin-hypercube and low-discrepancy plans take the same blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from massprop_drake.errors import suggestion
from massprop_drake.inputs.model import Model, Positive, Real, Whole, described
from massprop_drake.maths.linear_algebra import Array

_MOST_POINTS = 1000  # of one quantity in a grid
_FARTHEST = 8.0  # std from the mean that a bound of a normal distribution may cut off
_NAMES_OF_PARAMETERS = {"low", "high", "mean", "std", "mode", "median", "factor", "values", "weights", "points"}


class Distribution(Model):
    """Distribution of one quantity that is drawn."""

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, a list of n plain values: numbers, or whatever is chosen among."""
        raise NotImplementedError

    def grid(self) -> list[Any] | None:
        """Lists the values that a full-factorial plan takes; None where the block does not say how many."""
        return None


class _Between(Distribution):
    """Fields common to distributions between two bounds."""

    low: Real = described(..., "lower bound")
    high: Real = described(..., "upper bound, above low")
    points: Whole | None = described(
        None, "how many values, bounds included, `method: grid` takes", ge=2, le=_MOST_POINTS
    )

    @model_validator(mode="after")
    def _require_low_below_high(self) -> _Between:
        """Raises ValueError where low is not below high, or their difference is infinite."""
        if not self.high > self.low:
            raise ValueError(f"high must be above low, got {self.low:g} to {self.high:g}")
        if math.isinf(self.high - self.low):
            raise ValueError(f"low and high are too far apart, {self.low:g} and {self.high:g}")
        return self

    def _clip_to_bounds(self, values: Array) -> list[Any]:
        """Returns values, which rounding may have moved out of bounds, clipped to low and high, as a list."""
        return np.clip(values, self.low, self.high).tolist()

    def grid(self) -> list[Any] | None:
        """Lists as many values as points says, evenly spaced in probability; None where points is not set."""
        return None if self.points is None else self.quantiles(np.linspace(0.0, 1.0, self.points))


class Uniform(_Between):
    """Uniform distribution between two bounds."""

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, shape (n,), as a list of numbers."""
        return self._clip_to_bounds(self.low * (1.0 - u) + self.high * u)


class LogUniform(_Between):
    """Distribution between two positive bounds whose logarithm is uniform."""

    low: Positive = described(..., "lower bound, above zero")

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, shape (n,), as a list of numbers."""
        return self._clip_to_bounds(np.exp(math.log(self.low) * (1.0 - u) + math.log(self.high) * u))


class Triangular(_Between):
    """Triangular distribution: highest at the mode, zero at both bounds."""

    mode: Real = described(..., "likeliest value, from low to high")

    @model_validator(mode="after")
    def _require_mode_between_bounds(self) -> Triangular:
        """Raises ValueError where the mode lies outside low to high."""
        if not self.low <= self.mode <= self.high:
            raise ValueError(f"mode must lie between low and high, got {self.mode:g}")
        return self

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, shape (n,), as a list of numbers."""
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        rising = self.low + np.sqrt(u) * (math.sqrt(width) * math.sqrt(rise))
        falling = self.high - np.sqrt(1.0 - u) * (math.sqrt(width) * math.sqrt(fall))
        return self._clip_to_bounds(np.where(u * width < rise, rising, falling))


class Integers(_Between):
    """Uniform distribution of whole numbers from low to high, both included."""

    low: Whole = described(..., "least number", ge=-(2**53), le=2**53)
    high: Whole = described(..., "largest number, above low", ge=-(2**53), le=2**53)

    @model_validator(mode="after")
    def _require_enough_integers(self) -> Integers:
        """Raises ValueError where more points are asked for than there are whole numbers."""
        if self.points is not None and self.points > self.high - self.low + 1:
            raise ValueError(f"points: there are no {self.points} whole numbers from {self.low} to {self.high}")
        return self

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the whole number at each of the probabilities u, shape (n,), as a list."""
        count = self.high - self.low + 1
        return [self.low + min(int(part * count), count - 1) for part in u.tolist()]

    def grid(self) -> list[Any] | None:
        """Lists all whole numbers, or evenly spaced ones where points is set; None where they are too many."""
        if self.points is None and self.high - self.low >= _MOST_POINTS:
            return None
        return list(range(self.low, self.high + 1)) if self.points is None else super().grid()


class Normal(Distribution):
    """The normal distribution, cut off at bounds where there are any."""

    mean: Real = described(0.0, "mean, before anything is cut off")
    std: Positive = described(..., "1-sigma, before anything is cut off")
    low: Real | None = described(None, "no value beyond this; null: any")
    high: Real | None = described(None, "no value beyond this; null: any")

    @model_validator(mode="after")
    def _require_usable_bounds(self) -> Normal:
        """Raises ValueError where low is not below high, or both lie beyond 8 std on one side of the mean."""
        low, high = self._bounds()
        if not high > low:
            raise ValueError(f"high must be above low, got {low:g} to {high:g}")
        if low > self.mean + _FARTHEST * self.std or high < self.mean - _FARTHEST * self.std:
            raise ValueError(f"low and high leave nothing within {_FARTHEST:g} std of the mean")
        return self

    def _bounds(self) -> tuple[float, float]:
        """Lower and upper bound, infinite where none is set."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, shape (n,), as a list of numbers."""
        from scipy.special import ndtr, ndtri  # noqa: PLC0415 (slow to load)

        low, high = self._bounds()
        a, b = (low - self.mean) / self.std, (high - self.mean) / self.std
        inside = np.clip(u, np.finfo(float).tiny, 1.0 - np.finfo(float).epsneg)  # a quasi-random zero is not -infinity
        if a > 0.0:  # in the lower tail, where probabilities keep their digits
            z = -ndtri(ndtr(-a) * (1.0 - inside) + ndtr(-b) * inside)
        else:
            z = ndtri(ndtr(a) * (1.0 - inside) + ndtr(b) * inside)
        with np.errstate(over="ignore"):  # infinity is refused by the field that it is drawn for
            return np.clip(self.mean + self.std * z, low, high).tolist()


class LogNormal(Distribution):
    """Distribution of a positive quantity whose logarithm is normal."""

    median: Positive = described(..., "median")
    factor: Real = described(..., "1-sigma as a factor: 1.1 for 10 % more or less", gt=1.0)

    def quantiles(self, u: Array) -> list[Any]:
        """Computes the quantiles at probabilities u, shape (n,), as a list of numbers."""
        with np.errstate(over="ignore"):  # likewise
            return (self.median * self.factor ** np.array(Normal(mean=0.0, std=1.0).quantiles(u))).tolist()


class Choice(Distribution):
    """Choice among some values; written as a list, or as `values` with `weights`."""

    values: tuple[Any, ...] | str = described(
        ..., "any values; `all`, or a kind of jets, for the jets of the vehicle", min_length=1
    )
    weights: tuple[Annotated[Real, Field(ge=0.0, le=1e9)], ...] | None = described(
        None, "how often each, relative to the others; null: all alike"
    )

    @model_validator(mode="before")
    @classmethod
    def _wrap_plain_values(cls, value: Any) -> Any:
        """Returns a plain list of values as a mapping with the key `values`."""
        return value if isinstance(value, dict) else {"values": value}

    @model_validator(mode="after")
    def _require_matching_weights(self) -> Choice:
        """Raises ValueError unless there is a weight per value, one at least above zero."""
        if self.weights is None:
            return self
        if isinstance(self.values, str) or len(self.weights) != len(self.values):
            raise ValueError("give as many weights as values")
        if not sum(self.weights) > 0.0:
            raise ValueError("one weight at least must be above zero")
        return self

    def quantiles(self, u: Array) -> list[Any]:
        """Returns the value chosen at each of the probabilities u, by the cumulative weights, as a list."""
        assert not isinstance(self.values, str), "jets are named by the vehicle"
        edges = np.cumsum(np.ones(len(self.values)) if self.weights is None else np.array(self.weights))
        return [self.values[index] for index in np.searchsorted(edges / edges[-1], u, side="right")]

    def grid(self) -> list[Any] | None:
        """Lists all values that are chosen among."""
        return list(self.values)


KINDS: Mapping[str, type[Distribution]] = {
    "uniform": Uniform,
    "loguniform": LogUniform,
    "triangular": Triangular,
    "integers": Integers,
    "normal": Normal,
    "lognormal": LogNormal,
    "choice": Choice,
}


def distribution_in(value: Any) -> tuple[str, Any] | None:
    """Recognizes a distribution in data: returns its tag and parameters, or None where the data are none.

    Raises:
        ValueError: when it looks like a distribution and has a tag that is none.
    """
    if not isinstance(value, dict) or len(value) != 1:
        return None
    tag, parameters = next(iter(value.items()))
    if tag in KINDS:
        return tag, parameters
    if isinstance(parameters, dict) and parameters and set(parameters) <= _NAMES_OF_PARAMETERS:
        raise ValueError(f"there is no distribution {tag!r}{suggestion(tag, list(KINDS))}")
    return None
