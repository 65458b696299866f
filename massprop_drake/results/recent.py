"""Innovations of a flight in progress: counted, but for the newest, which another history may explain otherwise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.results.consistency import Forks, Innovations, Tally, likeliest_innovations

Array = NDArray[np.float64]

COLUMNS = 5  # of a row: time, s, then the fields of `Innovations`


class Recent(NamedTuple):
    """Innovations of one filter so far. Never changed; a sample makes new ones.

    Attributes:
        older: counts of the samples that are no longer kept, `Tally.NUMBERS`.
        rows: of the newest samples, oldest first, shape (n, `COLUMNS`); time -inf: there is no sample yet.
    """

    older: Array
    rows: Array

    def followed_on(self, time_s: float, used: float, nis: float, components: float) -> Recent:
        """Returns the innovations after one more sample; arguments as the fields of `Innovations`."""
        rows = np.vstack([self.rows, (time_s, used, nis, components, 0.0)])
        was_used = rows[0, 1] != 0.0
        return Recent(_add_counts(self.older, rows[:1]) if was_used else self.older, rows[1:])

    def replaced(self, since_s: float, nis: float, components: float) -> Recent:
        """Returns the innovations once another history is the likeliest; of an old fork its share of those kept.

        Args:
            since_s: time of the fork, s.
            nis, components: see `Forks`.
        """
        first_s, last_s = self.rows[[0, -1], 0].tolist()
        share = min((last_s - first_s) / (last_s - since_s), 1.0) if since_s < last_s else 1.0
        sums = (np.array([share * value]) for value in (nis, components))
        found = Forks(np.array([self.rows.shape[0] - 1]), np.array([since_s]), *sums)
        seen = likeliest_innovations(_innovations(self.rows), self.rows[:, 0], found)
        return Recent(self.older, np.column_stack([self.rows[:, 0], *seen]))

    @property
    def tally(self) -> Tally:
        """Tally of all innovations."""
        return Tally.of(_add_counts(self.older, self.rows))


def empty_recent(window: int) -> Recent:
    """Returns the record of innovations before the first sample.

    Args:
        window: number of samples that are kept.
    """
    rows = np.zeros((window, COLUMNS))
    rows[:, 0] = -np.inf
    return Recent(np.zeros(len(Tally.NUMBERS)), rows)


def _innovations(rows: Array) -> Innovations:
    _, used, nis, components, averaged = rows.T
    return Innovations(used != 0.0, nis, components, averaged != 0.0)


def _add_counts(older: Array, rows: Array) -> Array:
    tally = Tally.of(older)
    tally.take(_innovations(rows))
    return tally.numbers
