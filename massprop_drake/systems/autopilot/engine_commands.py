"""Commands of the engines: their schedule, and gimbals that hold the rate."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.gimbal_control import GimbalControl, steer_gimbals
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS
from massprop_drake.systems.autopilot.jet_schedule import make_row_reader
from massprop_drake.systems.caching import declare_output


class EngineCommands(LeafSystem):
    """Plays back levels and angles of engines, and adds what holds the vehicle's rate at zero while they burn.

    Ports:
        gyro (in, 3, with a bandwidth only): measured rate, rad/s, body axes. Required.
        engine_command (out, 3 n): level and two angles of each, rad, over the coming sample; shut after the table.

    State: what the vehicle has turned since any engine burns, rad (3).

    Args:
        table: row k holds on [k T, (k + 1) T), shape (n_samples, 3 n).
        control: see `GimbalControl`.
    """

    def __init__(self, table: Array, control: GimbalControl):
        super().__init__()
        self.set_name("engine_commands")
        table = np.array(table, dtype=float)
        self._control, self._gyro, size = control, None, table.shape[1]
        self._scheduled = make_row_reader(table, control.period_s, np.zeros(size))
        self._turned = self.DeclareDiscreteState(3)
        needed = {self.time_ticket(), self.xd_ticket()}
        if control.bandwidth > 0.0:
            self._gyro = self.DeclareVectorInputPort("gyro", 3)
            needed.add(self._gyro.ticket())
        declare_output(self, "engine_command", size, self._calc_command, needed)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=control.period_s, offset_sec=0.0, update=self._update)

    def _steer(self, context: Any) -> tuple[Array, Array]:
        """Computes engine commands, shape (n, 3), and the integral of the rate while engines burn, rad, shape (3,)."""
        rate = np.zeros(3) if self._gyro is None else self._gyro.Eval(context)
        turned = context.get_discrete_state(self._turned).CopyToVector()
        return steer_gimbals(self._scheduled(context).reshape(-1, N_CHANNELS), rate, turned, self._control)

    def _calc_command(self, context: Any) -> Any:
        """Computes level and gimbal angles, rad, of all engines for the coming sample, shape (3 n,)."""
        commands, _ = self._steer(context)
        return commands.ravel()

    def _update(self, context: Any, state: Any) -> None:
        """Stores the integral of the rate while engines burn."""
        _, turned = self._steer(context)
        state.set_value(self._turned, turned)
