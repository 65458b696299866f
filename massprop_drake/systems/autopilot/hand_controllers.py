"""The crew's hand controllers as a timeline."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.phase_space import Window, hand_controller_rows
from massprop_drake.systems.caching import declare_output


class HandControllers(LeafSystem):
    """Plays back rotational and translational hand controllers (RHC, THC).

    Ports:
        hand_controllers (out, 6): -1, 0 (detent) or 1 per axis: rotation x, y, z, translation x, y, z.

    Timing: a window is in force at t with start <= t < end; at sample k that is t = k T.

    Args:
        windows: when each controller is out of detent; windows of one channel do not overlap.
    """

    def __init__(self, windows: tuple[Window, ...]):
        super().__init__()
        self.set_name("hand_controllers")

        def calc_deflections(context: Any) -> Any:
            """Computes deflections of both hand controllers at the context's time, -1, 0 or 1, shape (6,)."""
            return hand_controller_rows(windows, np.array([context.get_time()]))[0]

        declare_output(self, "hand_controllers", 6, calc_deflections, {self.time_ticket()})
