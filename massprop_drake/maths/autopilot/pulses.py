"""On-times of jet selection flown as pulses of at most a control cycle, by the clock of the valves.

Durations are in control cycles here. What is left of an on-time goes over several cycles: at their starts it is flown
as full cycles and then the rest, so that a valve opens and closes once; at another place of the cycle in equal shares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import level_onsets

_SAME = 1e-9  # of a cycle: rounding
_SHORTEST = 1e-6  # of a cycle, physics: no valve is faster; edges that are closer are one, see `on_times`


class Pulses(NamedTuple):
    """Valves of the jets, as the autopilot uses them.

    Attributes:
        within: whether they open and close within a cycle; else with cycles, and all else is of no meaning.
        place: of a pulse in its cycle: 0 at its start, 0.5 about its middle, 1 until its end.
        quanta: step of each valve's clock, cycles, zero: none, shape (n_jets,).
        least: shortest on-time of each, cycles, shape (n_jets,).
        accumulates: whether on-times below the shortest add up; else they are dropped.
    """

    within: bool
    place: float
    quanta: Array
    least: Array
    accumulates: bool


def whole_cycle_pulses(n_jets: int) -> Pulses:
    """Makes the `Pulses` of valves that open and close only at control cycle boundaries."""
    return Pulses(within=False, place=0.0, quanta=np.zeros(n_jets), least=np.zeros(n_jets), accumulates=False)


def valve_pulses(minimum_s: Array, quanta_s: Array, period_s: float, pulse_place: float, accumulates: bool) -> Pulses:
    """Makes the `Pulses` of valves that open and close within a control cycle.

    Args:
        minimum_s: shortest on-time of each, raised to whole steps of its clock, s, shape (n_jets,).
        quanta_s: step of each clock, zero: none, s, shape (n_jets,).
        pulse_place, accumulates: see `Pulses`.
    """
    steps_s = np.where(quanta_s > 0.0, quanta_s, 1.0)
    raised_s = np.where(quanta_s > 0.0, np.ceil(minimum_s / steps_s - _SAME) * steps_s, minimum_s)
    least = np.maximum(raised_s / period_s, np.maximum(quanta_s / period_s, _SHORTEST))
    return Pulses(True, pulse_place, quanta_s / period_s, least, accumulates)


def round_to_clock(on_times: Array, pulses: Pulses) -> Array:
    """Rounds on-times to the nearest whole steps of the valves' clocks; in cycles, shape (n_jets,)."""
    steps = np.where(pulses.quanta > 0.0, pulses.quanta, 1.0)
    ticked = np.where(pulses.quanta > 0.0, np.floor(on_times / steps + 0.5) * steps, on_times)
    nearest = np.round(ticked)
    return np.where(np.abs(ticked - nearest) < _SAME, nearest, ticked)


def burst_pulses(on_times: Array, owed: Array, pulses: Pulses) -> tuple[Array, Array]:
    """Rounds selected on-times to those flown; returns these, and what is still owed, cycles, (n_jets,) each.

    Below the shortest an on-time is not flown. It is dropped or, where such accumulate, owed: once what a jet owes by
    selections that all ask for it reaches the shortest, this is flown, and the rest stays owed.

    Args:
        on_times: as selected, zero or positive, cycles, shape (n_jets,).
        owed: before, cycles, shape (n_jets,).
        pulses: of the jets.
    """
    flown = round_to_clock(on_times, pulses)
    if pulses.place > 0.0:  # equal shares must not be too short
        cycles = np.ceil(flown - _SAME)
        flown = np.where((cycles > 1.0) & (flown < cycles * pulses.least), np.floor(flown + _SAME), flown)
    long_enough = flown >= pulses.least - _SAME
    flown = np.where(long_enough, flown, 0.0)
    if not pulses.accumulates:
        return flown, np.zeros_like(owed)
    left = np.where(long_enough | (on_times < _SHORTEST), 0.0, owed + on_times)
    due = left >= pulses.least - _SAME
    return np.where(due, pulses.least, flown), np.where(due, np.maximum(left - pulses.least, 0.0), left)


@kernel
def coming_pulse(remaining: Array, pulses: Pulses) -> Array:
    """Computes the share of the coming control cycle for which each jet is open, shape (n_jets,).

    Args:
        remaining: what is left of each on-time, cycles, shape (n_jets,).
        pulses: of the jets; of cycles whole ones are left.
    """
    if pulses.place == 0.0:
        return np.minimum(remaining, 1.0)
    shares = np.empty_like(remaining)
    for jet in range(remaining.size):
        left, step = remaining[jet], pulses.quanta[jet]
        share = left / max(np.ceil(left - _SAME), 1.0)
        if step > 0.0:
            share = np.ceil(share / step - _SAME) * step
        shares[jet] = min(share, left, 1.0)
    return shares


@kernel
def remaining_after_pulse(remaining: Array, flown_on_times: Array) -> Array:
    """Subtracts flown from remaining on-times, cycles, shape (n_jets,); rounding errors count as zero."""
    left = remaining - flown_on_times
    return np.where(left < _SAME, 0.0, left)


@kernel
def pulse_onsets(shares: Array, pulses: Pulses, period_s: float) -> Array:
    """Returns when in a cycle each jet opens, s, shape (n_jets,); NaN where jets switch with cycles."""
    if not pulses.within:
        return level_onsets(shares.size)
    return pulses.place * period_s * (1.0 - shares)


def max_edges(pulses: Pulses) -> int:
    """Returns the largest number of times within a cycle at which jets can open or close."""
    if not pulses.within:
        return 0
    return pulses.quanta.size * (2 if 0.0 < pulses.place < 1.0 else 1)
