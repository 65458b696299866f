r"""On-times: jets that open and close within a sample.

A command says of each jet for which share f of a sample of the length T it is open, and its onset how long after the
beginning of the sample it opens, s. The jet then gives full thrust from the onset a to a + f T, through its lag, and
nothing before and after. Without an onset (NaN) a command is a level: the jet gives the share f of its thrust all
through the sample. A command of 0 or 1 says the same either way.

A sample is as many pieces as its edges make, in each of which every level tends to a constant. Edges that are closer
than `_APART` are one; a level there is the share of the piece that is covered, so that no impulse is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_SAME = 1e-9  # of a sample: from its beginning or end
_APART = 1e-6  # of a sample: arithmetic loses digits of a lag over less

Place = Literal["start", "center", "end"]
PLACES: dict[Place, float] = {"start": 0.0, "center": 0.5, "end": 1.0}  # share of what is left that lies before


def onsets(fractions: Array, pulse_place: Place, period_s: float) -> Array:
    """Computes the times at which pulses begin within a sample, s: at its start, about its middle, or up to its end."""
    return PLACES[pulse_place] * period_s * (1.0 - fractions)


@kernel
def level_onsets(shape: int | tuple[int, ...]) -> Array:
    """Returns NaN onsets, as of commands that are levels and not pulses, in the given shape."""
    return np.full(shape, np.nan)


def command_onsets(command: Array, stated_s: Array | None, pulse_place: Place | None, period_s: float) -> Array:
    """Returns when each jet opens in a sample, s, (n_jets,): as given, else as the place of pulses implies.

    Args:
        command: fraction of each jet, shape (n_jets,).
        stated_s: its onsets; None: they are not told.
        pulse_place: where on-times lie then; None: commands are levels.
    """
    if stated_s is not None:
        return stated_s
    return level_onsets(command.size) if pulse_place is None else onsets(command, pulse_place, period_s)


def pulse_samples(start_s: float, end_s: float, period_s: float) -> tuple[int, int]:
    """Returns the index of the first sample in which a pulse is on, and the index after the last one."""
    return int(start_s / period_s + _SAME), math.ceil(end_s / period_s - _SAME)


def pulse_shares(start_s: float, end_s: float, period_s: float, count: int) -> Iterator[tuple[int, float, float]]:
    """Yields per sample in which a pulse is on: its index, the onset in it, s, and the share it is on.

    Args:
        start_s, end_s: of the pulse.
        count: number of samples that there are.
    """
    first, end_sample = pulse_samples(start_s, end_s, period_s)
    for sample in range(first, min(end_sample, count)):
        begin, end = max(start_s / period_s - sample, 0.0), min(end_s / period_s - sample, 1.0)
        begin, end = 0.0 if begin < _SAME else begin, 1.0 if end > 1.0 - _SAME else end
        yield sample, begin * period_s, end - begin


def rest_of_sample(command: Array, onset_s: Array, elapsed_s: Array, period_s: float) -> tuple[Array, Array]:
    """Computes commands and onsets over the rest of each sample after a time, shape (n, n_jets) each.

    Args:
        command: f, NaN where not known, shape (n, n_jets).
        onset_s: a, NaN: the command is a level, shape (n, n_jets).
        elapsed_s: how long ago each sample began, shape (n,).
        period_s: T.
    """
    since = elapsed_s[:, None]
    timed = is_pulse(command, onset_s)
    opens = np.where(timed, np.maximum(onset_s - since, 0.0), 0.0)
    closes = np.where(timed, onset_s + command * period_s - since, 0.0)
    left = np.clip((closes - opens) / period_s, 0.0, 1.0)
    told = timed & (since > 0.0)
    return np.where(told, left, command), np.where(told, opens, onset_s)


@kernel
def is_pulse(command: Any, onset_s: Any) -> Any:
    """Flags commands whose jet opens or closes within the sample; shape as command and onset."""
    return (onset_s >= 0.0) & (command > 0.0) & (command < 1.0)


@kernel
def has_pulse(command: Array, onset_s: Array) -> bool:
    """Tests whether any jet opens or closes within the sample."""
    return bool(is_pulse(command, onset_s).any())


@kernel
def split_sample(command: Array, onset_s: Array, period_s: float, span_s: tuple[float, float]) -> tuple[Array, Array]:
    """Splits a sample at the times when jets switch: lengths, s, (k,), and commanded levels, (k, n_jets).

    Args:
        command: f of each jet, NaN where not known, shape (n_jets,).
        onset_s: a of each jet, NaN: the command is a level, shape (n_jets,).
        period_s: T.
        span_s: from when to when since the sample began: of the whole sample 0 and T.
    """
    n_jets, (since_s, until_s) = command.size, span_s
    edges, count = np.empty(2 * n_jets), 0
    for jet in range(n_jets):
        if is_pulse(command[jet], onset_s[jet]):
            edges[count], edges[count + 1] = onset_s[jet], onset_s[jet] + command[jet] * period_s
            count += 2
    edges = np.sort(edges[:count])
    ends, number, least, last = np.empty(count + 1), 0, _APART * period_s, since_s
    for edge in edges:
        if last + least < edge < until_s - least:
            ends[number] = last = edge
            number += 1
    ends[number] = until_s
    lengths, levels, begin = np.empty(number + 1), np.empty((number + 1, n_jets)), since_s
    for piece in range(number + 1):
        end = ends[piece]
        lengths[piece] = end - begin
        for jet in range(n_jets):
            levels[piece, jet] = command[jet]
            if is_pulse(command[jet], onset_s[jet]):
                covered = min(onset_s[jet] + command[jet] * period_s, end) - max(onset_s[jet], begin)
                levels[piece, jet] = min(max(covered / (end - begin), 0.0), 1.0)
        begin = end
    return lengths, levels


def max_pieces(command: Array, onset_s: Array, period_s: float) -> int:
    """Returns the most pieces that switching jets split any sample of a table into; rows (n, n_jets) each."""
    rows = np.flatnonzero(is_pulse(command, onset_s).any(axis=1)).tolist()
    whole = 0.0, period_s
    return max((split_sample(command[row], onset_s[row], period_s, whole)[0].size for row in rows), default=1)
