"""The crew's hand controllers as a timeline."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import LeafSystem


class Window(NamedTuple):
    """A hand controller held out of detent.

    Attributes:
        channel: 0 to 2 rotation about x, y, z; 3 to 5 translation along x, y, z.
        sign: +1 or -1.
        start_s: leaves detent, s.
        end_s: back in detent, s.
    """

    channel: int
    sign: float
    start_s: float
    end_s: float


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
        time = context.get_time()
        command = np.zeros(6)
        for window in self._windows:
            if window.start_s <= time < window.end_s:
                command[window.channel] = window.sign
        output.SetFromVector(command)
