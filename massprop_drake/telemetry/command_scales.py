"""Scales of logged commands: fractions, percent and on-times are told apart by what they reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_EXACT = 1e-6  # of full scale, to which values reach it exactly
_LONGER = 0.05  # of the sample period, by which an on-time may exceed it where the clock jitters
_CLEARLY = 0.05  # of full scale, above which numbers look like it
_FEW = 0.02  # of the commands that open a jet, up to which the largest may be errors
_FAR = 2.0  # factor by which such are above the others
_BYTE = 255.0
_LEVEL = 0.01  # of the step between two levels, within which values belong to one
_RARE = 0.1  # of the rarer level, up to which other values are no level


class CommandScale(NamedTuple):
    """A meaning that numbers of commands may have.

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
        """Tests whether commands are on-times."""
        return self.unit not in ("1", "%")

    def is_reached(self, most: float) -> bool:
        """Tests whether the largest command is full scale exactly."""
        return abs(most - self.full) <= _EXACT * self.full


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
    """The two levels that all commands but rare ones take; None where they take more, or one.

    Args:
        values: all commands, without missing ones.
    """
    found, counts = np.unique(values, return_counts=True)
    beside: list[float] = []
    left_out = 0
    while found.size > 1:
        jumps = np.diff(found)
        at = int(np.argmax(jumps)) + 1
        lower, upper = (found[:at], counts[:at]), (found[at:], counts[at:])
        rarer, usual = sorted((lower, upper), key=lambda one: int(one[1].sum()))
        if max(np.ptp(lower[0]), np.ptp(upper[0])) <= _LEVEL * jumps[at - 1]:
            if left_out > _RARE * rarer[1].sum():
                return None
            closed, opened = (float(np.median(np.repeat(*one))) for one in (usual, rarer))
            return Levels(closed, opened, found.size > 2, tuple(beside))
        beside += [float(one) for one in rarer[0]]
        left_out += int(rarer[1].sum())
        found, counts = usual
    return None


def without_rare(values: Array) -> Array:
    """The commands without the largest, where these are few and far above the others.

    Args:
        values: all commands, without missing ones.
    """
    opened = np.sort(values[values > 0.0])
    few = max(int(_FEW * opened.size), 1)
    if opened.size < few / _RARE or opened[-1 - few] > opened[-1] / _FAR:
        return values
    return values[values <= opened[-1 - few]]


def possible_scales(values: Array, period_s: float) -> list[CommandScale]:
    """Scales that commands may have, the likelier first; none where there is no open jet, or a negative command.

    A jet is open all the time now and then, so that values reach full scale exactly; else the least scale that holds
    them is the likeliest.

    Args:
        values: all commands, NaN where missing.
        period_s: sample period, s.
    """
    values = values[np.isfinite(values)]
    most = float(values.max(initial=0.0))
    if most <= 0.0 or values.min() < 0.0:
        return []
    whole = bool((values == np.round(values)).all())
    every = [CommandScale("1", 1.0, "fractions"), CommandScale("%", 100.0, "percent")]
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        full = float(f"{period_s / factor:.9g}")
        every.append(CommandScale(unit, full, f"on-times in {unit}, of {full:g} {unit} at the most"))
    if whole and most > 100.0:
        every.append(CommandScale("1", _BYTE, "numbers of 0 to 255"))
    fitting = [one for one in every if most <= one.full * (1.0 + (_LONGER if one.is_timed else _EXACT))]
    if np.unique(values[values > 0.0]).size == 1 and not any(one.is_reached(most) for one in every):
        fitting.append(CommandScale("1", most, f"two values, 0 closed and {most:g} open"))
    return sorted(fitting, key=lambda one: (not one.is_reached(most), one.full))


def doubt_about(largest: float, period_s: float) -> str:
    """A sentence on fractions that look like on-times in seconds; "" where they do not.

    Args:
        largest: command of the whole record.
        period_s: sample period, s.
    """
    if not 0.0 < largest <= period_s * (1.0 + _LONGER) or period_s >= 1.0:
        return ""
    return (
        f"no command of the whole record exceeds {largest:g}, and the sample period is {period_s:g} s: are these "
        f"on-times in seconds? A command is a fraction of 0 to 1: divide them by {period_s:g}, or say `unit: s` of "
        "them in a map"
    )


def hint_about(values: Array, period_s: float) -> str:
    """Advice on commands that are no fractions, to be added to an error; "" where no scale fits.

    Args:
        values: commands, NaN where missing.
        period_s: sample period, s.
    """
    most = np.nanmax(values)
    likely = [one for one in possible_scales(values, period_s) if 1.0 < one.full < most / _CLEARLY and most > 2.0]
    if not likely:
        return ""
    alike = [one for one in likely if abs(one.full - likely[0].full) <= _EXACT * one.full]
    words = " or ".join(one.words.partition(",")[0] for one in alike)
    return f"; the commands look like {words}: divide by {likely[0].full:g}"
