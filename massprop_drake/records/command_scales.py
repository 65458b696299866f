"""Scales of logged commands: fractions, percent and on-times are recognized by their largest values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array

_EXACT = 1e-6  # of full scale, to which values reach it exactly
_LONGER = 0.05  # of the sample period, by which an on-time may exceed it where the clock jitters
_CLEARLY = 0.05  # of full scale, above which numbers look like it
_FEW = 0.02  # of the commands that open a jet, up to which the largest may be errors
_FAR = 2.0  # factor by which such are above the others
_BYTE = 255.0
_LEVEL = 0.01  # of the step between two levels, within which values belong to one
_RARE = 0.1  # of the rarer level, up to which other values are no level


class CommandScale(NamedTuple):
    """Scale that numbers of commands may have.

    Attributes:
        unit: "1", "%", or of an on-time "s", "ms", "us" or "ns".
        full: value of a jet that is open all the time.
        words: of the meaning.
    """

    unit: str
    full: float
    words: str

    @property
    def is_timed(self) -> bool:
        """True if the scale is one of on-times, not of fractions or percent."""
        return self.unit not in ("1", "%")

    def is_reached(self, largest: float) -> bool:
        """Tests whether the largest command equals full scale, but for rounding."""
        return abs(largest - self.full) <= _EXACT * self.full


class Levels(NamedTuple):
    """The two levels that commands take.

    Attributes:
        closed: the more frequent one, a median.
        opened: the other one, a median.
        scatters: values of a level are not all the same.
        beside: values of neither level, which are rare.
    """

    closed: float
    opened: float
    scatters: bool
    beside: tuple[float, ...]


def two_levels(values: Array) -> Levels | None:
    """Finds the values of closed and open jets, if all but rare commands take these two alone; else None."""
    levels, counts = np.unique(values, return_counts=True)
    extra: list[float] = []
    left_out = 0
    while levels.size > 1:
        jumps = np.diff(levels)
        at = int(np.argmax(jumps)) + 1
        lower, upper = (levels[:at], counts[:at]), (levels[at:], counts[at:])
        rarer, usual = sorted((lower, upper), key=lambda one: int(one[1].sum()))
        if max(np.ptp(lower[0]), np.ptp(upper[0])) <= _LEVEL * jumps[at - 1]:
            if left_out > _RARE * rarer[1].sum():
                return None
            closed, opened = (float(np.median(np.repeat(*one))) for one in (usual, rarer))
            return Levels(closed, opened, levels.size > 2, tuple(extra))
        extra += [float(one) for one in rarer[0]]
        left_out += int(rarer[1].sum())
        levels, counts = usual
    return None


def drop_rare_commands(values: Array) -> Array:
    """Returns the commands without the largest ones, if these are few and far above the others."""
    opened = np.sort(values[values > 0.0])
    few = _count_possible_errors(opened.size)
    if not few or opened[-1 - few] > opened[-1] / _FAR:
        return values
    return values[values <= opened[-1 - few]]


def possible_scales(values: Array, period_s: float) -> list[CommandScale]:
    """Lists scales that fit all commands, the likelier first; empty if no jet opens or a command is negative.

    A jet is open all the time now and then, so that values reach full scale exactly; else the least scale that holds
    them is the likeliest.

    Args:
        values: all commands, NaN where missing.
        period_s: sample period, s.
    """
    values = values[np.isfinite(values)]
    largest = float(values.max(initial=0.0))
    if largest <= 0.0 or values.min() < 0.0:
        return []
    whole = bool((values == np.round(values)).all())
    scales = [CommandScale("1", 1.0, "fractions"), CommandScale("%", 100.0, "percent")]
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        full = float(f"{period_s / factor:.9g}")
        scales.append(CommandScale(unit, full, f"on-times in {unit}, of {full:g} {unit} at the most"))
    if whole and largest > 100.0:
        scales.append(CommandScale("1", _BYTE, "numbers of 0 to 255"))
    fitting = [one for one in scales if largest <= one.full * (1.0 + (_LONGER if one.is_timed else _EXACT))]
    if np.unique(values[values > 0.0]).size == 1 and not any(one.is_reached(largest) for one in scales):
        fitting.append(CommandScale("1", largest, f"two values, 0 closed and {largest:g} open"))
    return sorted(fitting, key=lambda one: (not one.is_reached(largest), one.full))


class CommandTally:
    """Tally of commands as they are read, to detect fractions that look like on-times in seconds.

    Args:
        period_s: sample period, s.
    """

    def __init__(self, period_s: float):
        self._period_s = period_s
        self._opened, self._full, self._longer = 0, 0, 0
        self._largest = 0.0  # of those that are no longer than the period

    def add(self, commands: Array) -> None:
        """Counts commands that open a jet, those of a full period, and longer ones; NaN counts as missing."""
        opened = commands[commands > 0.0]
        allowed = opened[opened <= self._period_s * (1.0 + _LONGER)]
        self._opened += opened.size
        self._longer += opened.size - allowed.size
        self._full += int((allowed >= self._period_s * (1.0 - _LONGER)).sum())
        self._largest = max(self._largest, float(allowed.max(initial=0.0)))

    def doubt(self) -> str:
        """Returns a warning if the fractions counted so far look like on-times in seconds; "" if not."""
        if not self._opened or self._period_s >= 1.0:
            return ""
        whose = "no command of the whole record exceeds"
        if self._longer:
            if self._longer > _count_possible_errors(self._opened) or self._full <= self._longer:
                return ""
            whose = f"all but {self._longer} of the {self._opened} commands that open a jet are no more than"
        return (
            f"{whose} {self._largest:g}, and the sample period is {self._period_s:g} s: are these on-times in seconds? "
            f"A command is a fraction of 0 to 1: divide them by {self._period_s:g}, or say `unit: s` of them in a map"
        )


def _count_possible_errors(n_commands: int) -> int:
    """Returns how many of n commands above zero may be errors; 0 where n is too small to tell."""
    few = max(int(_FEW * n_commands), 1)
    return few if few <= _RARE * n_commands else 0


def scale_hint(values: Array, period_s: float) -> str:
    """Returns advice on the scale of commands above 1, to append to an error; "" where no scale fits.

    Args:
        values: commands, NaN where missing.
        period_s: sample period, s.
    """
    largest = np.nanmax(values)
    likely = [one for one in possible_scales(values, period_s) if 1.0 < one.full < largest / _CLEARLY and largest > 2.0]
    if not likely:
        return ""
    equal = [one for one in likely if abs(one.full - likely[0].full) <= _EXACT * one.full]
    words = " or ".join(one.words.partition(",")[0] for one in equal)
    return f"; the commands look like {words}: divide by {likely[0].full:g}"
