"""Torques of reaction wheels' motors prescribed beforehand."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.autopilot.jet_schedule import make_row_reader
from massprop_drake.systems.caching import declare_output


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
        table = np.array(torques, dtype=float)
        n = table.shape[1]
        declare_output(self, "wheel_torque", n, make_row_reader(table, period_s, np.zeros(n)), {self.time_ticket()})
