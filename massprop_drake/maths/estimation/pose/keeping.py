"""Commands that still act and hypotheses as a vector, from which a filter continues bit for bit after a restart.

In order: how many commands and parts there are; times and levels of the commands; of each part, which is a delay that
may be (`delays`), eight numbers, likelihoods, onsets, what is known, the filters, and where there is such
what has been foretold apart and what the next sample is to decide. Of covariances the lower triangle. A likelihood of
minus infinity is kept as NaN.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.pose.pose_cycle import Doubt
from massprop_drake.maths.estimation.pose.pose_hypotheses import Tried
from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseBank, PoseParams
from massprop_drake.maths.linear_algebra import Array

_MOST = 4096  # of anything that is counted


class _PoseReader:
    """Reader of a vector from its beginning."""

    def __init__(self, vector: Array):
        self._vector, self._at = vector, 0

    def take(self, *shape: int) -> Array:
        """Reads the next numbers of the vector in a shape; ValueError when it is too short."""
        end = self._at + int(np.prod(shape))
        if end > self._vector.size:
            raise ValueError("hypotheses are cut short")
        found = self._vector[self._at : end].reshape(shape).copy()
        self._at = end
        return found

    def count(self) -> int:
        """Reads the next number of the vector, a whole one of 0 to 4096; ValueError when it is not."""
        (number,) = self.take(1)
        if not (0.0 <= number <= _MOST and number == int(number)):
            raise ValueError("hypotheses must be counted by whole numbers")
        return int(number)

    def is_at_end(self) -> bool:
        """Tests whether the whole vector has been read."""
        return self._at == self._vector.size


def pack_hypotheses(hypotheses: Tried, commands: Commands) -> Array:
    """Packs the commands that still act and all hypotheses into one vector, for a restart."""
    parts = [hypotheses._replace(elsewhere=()), *hypotheses.elsewhere]
    blocks: list[Array] = [np.array([commands.time_s.size, len(parts)], dtype=float)]
    blocks += [commands.time_s, commands.levels.ravel()]
    for part in parts:
        blocks += _pack_part(part)
    return np.concatenate(blocks)


def unpack_hypotheses(vector: Array, params: PoseParams) -> tuple[Tried, Commands]:
    """Unpacks hypotheses and commands from a vector, checked: the inverse of `pack_hypotheses`.

    Raises:
        ValueError: when the vector is not of these parameters, or holds what no run leaves.
    """
    reader, jets = _PoseReader(vector), params.pushes.shape[0]
    count, parts = reader.count(), reader.count()
    commands = Commands(reader.take(count), reader.take(count, jets))
    unpacked = [_read_part(reader, params) for _ in range(parts)]
    if not unpacked or not reader.is_at_end():
        raise ValueError("hypotheses are of another number")
    _require_possible(commands, unpacked)
    return unpacked[0]._replace(elsewhere=tuple(unpacked[1:])), commands


def _pack_part(part: Tried) -> list[Array]:
    """Packs the hypotheses of one delay into arrays, scalars first: the inverse of `_read_part`."""
    has = part.apart is not None, part.doubt is not None
    numbers = part.bank.mean.shape[0], part.renewed_s, part.led_s, part.leader, part.steady, part.total, *has
    likelihood = np.where(np.isneginf(part.likelihood), np.nan, part.likelihood)
    blocks = [np.array(numbers, dtype=float), likelihood, part.onset_s, part.known, *_pack_bank(part.bank)]
    if part.apart is not None:
        blocks.append(part.apart.ravel())
    if part.doubt is not None:
        blocks += [*_pack_bank(part.doubt.bank), part.doubt.share]
    return blocks


def _read_part(reader: _PoseReader, params: PoseParams) -> Tried:
    """Reads the hypotheses of one delay from a vector as `_pack_part` packs them."""
    filters, renewed_s, led_s, leader, steady, total, has_apart, has_doubt = reader.take(8).tolist()
    jets = params.pushes.shape[0]
    if filters not in (1.0, 2.0 + 2.0 * jets):
        raise ValueError("hypotheses are of another number of jets")
    count = int(filters)
    likelihood = reader.take(count)
    likelihood[np.isnan(likelihood)] = -np.inf
    onset_s, known, bank = reader.take(count), reader.take(1 + 2 * jets), _read_bank(reader, count, params)
    apart = reader.take(count, count) if has_apart else None
    doubt = Doubt(_read_bank(reader, count, params), reader.take(count)) if has_doubt else None
    return Tried(bank, likelihood, onset_s, known, renewed_s, led_s, int(leader), int(steady), doubt, apart, total)


def _pack_bank(bank: PoseBank) -> list[Array]:
    """Packs a bank of filters into flat arrays; of each covariance the lower triangle."""
    rows, columns = np.tril_indices(bank.covariance.shape[1])
    lower = bank.covariance[:, rows, columns]
    parts = (bank.mean, lower, bank.rotation, bank.opens.astype(float), bank.reference, bank.turned)
    return [part.ravel() for part in parts]


def _read_bank(reader: _PoseReader, count: int, params: PoseParams) -> PoseBank:
    """Reads a bank of ``count`` filters from a vector: the inverse of `_pack_bank`."""
    n = params.free.size
    rows, columns = np.tril_indices(n)
    mean, lower = reader.take(count, params.parts.size), reader.take(count, rows.size)
    covariance = np.empty((count, n, n))
    covariance[:, rows, columns] = covariance[:, columns, rows] = lower
    rotation, opens = reader.take(count, 3, 3), reader.take(count)
    if not np.isin(opens, np.arange(PUSHED, params.pushes.shape[0])).all():
        raise ValueError("hypotheses are of jets that there are not")
    return PoseBank(mean, covariance, rotation, opens.astype(int), reader.take(count, 3), reader.take(count, 3, 3))


def _require_possible(commands: Commands, parts: list[Tried]) -> None:
    """Raises ValueError where unpacked commands or hypotheses hold values that no estimator leaves."""
    if not np.isfinite(commands.time_s).all() or (np.diff(commands.time_s) <= 0.0).any():
        raise ValueError("commands must be in order of time")
    if ((commands.levels < 0.0) | (commands.levels > 1.0)).any():
        raise ValueError("commands must be fractions of 0 to 1")
    for part in parts:
        numbers = (part.onset_s, part.bank.reference, part.bank.turned, part.renewed_s, part.total)
        if not all(np.isfinite(each).all() for each in numbers) or not np.isin(part.known, (0.0, 1.0)).all():
            raise ValueError("hypotheses must be numbers")
        if not (np.isfinite(part.bank.mean[0]).all() and np.isfinite(part.bank.covariance[0]).all()):
            raise ValueError("the first hypothesis must be numbers")
