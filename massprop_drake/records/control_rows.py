"""Rows at times of their own, thinned to one a sample period: code that counts or compares samples takes these."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.reader import JITTER
from massprop_drake.records.rows import Rows


class Thinning:
    """Selection of rows, block by block: one a sample period, with commands of its own and a reading of the rate.

    Args:
        period_s: sample period.
        gyros: names of the packages of which one must have been read.
    """

    def __init__(self, period_s: float, gyros: list[str]):
        self._period_s, self._gyros = period_s, gyros
        self._last_s = -math.inf
        self._before: tuple[Array, Array] | None = None  # commands of the last two rows

    def select(self, rows: Rows, signals: Mapping[str, Array]) -> tuple[Rows, dict[str, Array]]:
        """Selects rows with rates about a sample period apart, and gaps; returns them with their signals."""
        has_rate = np.any([~np.isnan(rows.readings[name]).any(axis=1) for name in self._gyros], axis=0)
        has_commands = np.ones_like(has_rate) if rows.told is None else rows.told
        chosen = []
        for row in np.flatnonzero(has_rate | ~rows.recorded).tolist():
            periods = (float(rows.time_s[row]) - self._last_s) / self._period_s
            if not rows.recorded[row] or periods >= (1.0 - JITTER if has_commands[row] else 1.0 + JITTER):
                chosen.append(row)
                self._last_s = float(rows.time_s[row])
        indices = np.array(chosen, dtype=int)
        selected = {name: values[indices] for name, values in signals.items()}
        if "usable" in selected:
            selected["usable"] = self._steady_commands(rows.commands[indices])
        return rows.select(indices), selected

    def _steady_commands(self, commands: Array) -> Array:
        """Returns 1.0 for rows whose last interval had the same commands as the one before, else 0.0, shape (n, 1)."""
        nothing = np.zeros(commands.shape[1])
        last, newest = self._before or (nothing, nothing)
        all_commands = np.vstack((last, newest, commands))
        self._before = all_commands[-2], all_commands[-1]
        return (all_commands[:-2] == all_commands[1:-1]).all(axis=1).astype(float)[:, None]
