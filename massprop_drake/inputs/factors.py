"""Common factors by which numbers are off where a unit is in place of another: degrees, g, milliseconds, percent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from massprop_drake.inputs.plausible import FOOT, GRAVITY, SLUG

_NEAR = 1.5  # ratio to a common factor: mass properties are off by as much where 30 % is stated
_DEGREE = math.pi / 180.0
_FORCES = SLUG * FOOT  # N in a lbf
_POWERS = (1, -1, 2, -2, 3, -3, 6, -6)  # of ten, for prefixes and decimals


class Factor(NamedTuple):
    """A common factor between numbers as they are read and as they should be.

    Attributes:
        size: what is read over what should be.
        words: the mistake that makes it, such as "degrees in place of radians"; empty: none that is common.
    """

    size: float
    words: str

    @property
    def name(self) -> str:
        """Name of the mistake, or the factor itself."""
        return self.words or f"a factor of {self.size:g}"

    def __str__(self) -> str:
        return f"{format_factor(self.size)} times what they should be{self.words and ': '}{self.words}"


def format_factor(size: float) -> str:
    """Formats a factor as text, one below 1 as a fraction: 57.3, 1/57.3."""
    return f"{size:.4g}" if size >= 1.0 else f"1/{1.0 / size:.4g}"


def rate_factors(period_s: float) -> tuple[Factor, ...]:
    """Lists the factors by which common mistakes of unit distort rates in rad/s, at a sample period in s."""
    return (
        Factor(1.0 / _DEGREE, "degrees in place of radians"),
        Factor(_DEGREE, "radians in place of degrees"),
        Factor(period_s, "increments of angle in place of rates"),
        Factor(1.0 / period_s, "rates in place of increments of angle"),
        Factor(period_s / _DEGREE, "increments of angle in degrees in place of rates"),
        Factor(30.0 / math.pi, "rpm in place of rad/s"),
        Factor(math.pi / 30.0, "rad/s in place of rpm"),
        *_decimal_factors(),
    )


def velocity_factors(units: str, period_s: float) -> tuple[Factor, ...]:
    """Lists the factors by which common mistakes of unit distort integrated acceleration; units: "us" or "si"."""
    own, other, feet = ("meters", "feet", 1.0 / FOOT) if units == "si" else ("feet", "meters", FOOT)
    weight, gravity = ("m/s^2", GRAVITY) if units == "si" else ("ft/s^2", GRAVITY / FOOT)
    return (
        Factor(1.0 / gravity, f"g in place of {weight}"),
        Factor(gravity, f"{weight} in place of g"),
        Factor(feet, f"{other} in place of {own}"),
        Factor(1.0 / feet, f"{own} in place of {other}"),
        Factor(period_s, "increments of velocity in place of accelerations"),
        Factor(1.0 / period_s, "accelerations in place of increments of velocity"),
        *_decimal_factors(),
    )


def impulse_factors(units: str, period_s: float) -> tuple[Factor, ...]:
    """Lists the factors by which common mistakes of unit distort impulses computed from commands and thrusts."""
    own, other, force = ("N", "lbf", 1.0 / _FORCES) if units == "si" else ("lbf", "N", _FORCES)
    return (
        Factor(period_s, "on-times in s in place of fractions of the sample period"),
        Factor(1.0 / period_s, "fractions of the sample period in place of on-times in s"),
        Factor(force, f"{other} in place of {own}"),
        Factor(1.0 / force, f"{own} in place of {other}"),
        Factor(0.01, "fractions in place of percent"),
        *_decimal_factors(),
    )


def time_factors() -> tuple[Factor, ...]:
    """Lists the factors by which common mistakes of unit distort time stamps in s."""
    return (
        *(Factor(10.0**n, f"{unit} in place of s") for n, unit in ((3, "ms"), (6, "us"), (9, "ns"))),
        *(Factor(10.0**-n, f"s in place of {unit}") for n, unit in ((3, "ms"), (6, "us"), (9, "ns"))),
        *(Factor(1.0 / size, f"{unit} in place of s") for size, unit in ((60.0, "min"), (3600.0, "h"))),
    )


def factors_near(size: float, candidates: Sequence[Factor]) -> list[Factor]:
    """Returns the candidates within a ratio of 1.5 of a measured factor, nearest first."""
    if not (size > 0.0 and math.isfinite(size)):
        return []
    near = [factor for factor in candidates if _log_distance(factor.size, size) < math.log(_NEAR)]
    return sorted(near, key=lambda factor: _log_distance(factor.size, size))


def _log_distance(a: float, b: float) -> float:
    """Absolute logarithm of the ratio of two sizes."""
    return abs(math.log(a / b))


def _decimal_factors() -> list[Factor]:
    """Lists factors of powers of ten, without a name."""
    return [Factor(10.0**n, "") for n in _POWERS]
