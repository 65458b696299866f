"""Torques of reaction wheels' motors prescribed beforehand."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array


class WheelSchedule(LeafSystem):
    """Plays back a table of motor torques, a row per sample.

    Ports:
        wheel_torque (out, n_wheels): torque of each motor on its wheel over the coming sample, ft-lbf or N-m; zero
            after the table.

    State: none.

    Args:
        torques: row k acts on [k T, (k + 1) T), shape (n_samples, n_wheels).
        period_s: sample period T, s.
    """

    def __init__(self, torques: Array, *, period_s: float):
        super().__init__()
        self.set_name("wheel_schedule")
        self._torques, self._period_s = np.array(torques, dtype=float), period_s
        n = self._torques.shape[1]
        self.DeclareVectorOutputPort("wheel_torque", n, self._calc, prerequisites_of_calc={self.time_ticket()})

    def _calc(self, context: Any, output: Any) -> None:
        sample = round(context.get_time() / self._period_s)
        table = self._torques
        output.SetFromVector(table[sample] if sample < len(table) else np.zeros(table.shape[1]))
