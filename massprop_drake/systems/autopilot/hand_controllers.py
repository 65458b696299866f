"""The crew's hand controllers as a timeline."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.phase_space import Window, hand_controllers


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
        self._windows = windows
        self.DeclareVectorOutputPort("hand_controllers", 6, self._calc, prerequisites_of_calc={self.time_ticket()})

    def _calc(self, context: Any, output: Any) -> None:
        output.SetFromVector(hand_controllers(self._windows, context.get_time()))
