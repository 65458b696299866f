"""Reaction wheels that hold attitude, and are unloaded by jets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.wheel_control import (
    WheelControlParams,
    must_unload,
    rate_for_jets,
    wheel_torques,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import declare_output
from massprop_drake.systems.layouts import HAND_CONTROLLERS

_ROTATION = HAND_CONTROLLERS.slice("rotation")


class WheelController(LeafSystem):
    """Makes reaction wheels follow the rate that the phase-space controller commands, and jets unload them.

    See `massprop_drake.maths.autopilot.wheel_control`.

    Ports:
        hand_controllers (in, 6): see `HandControllers`. Required.
        attitude_error (in, 3): from the held attitude to the body, rad, body axes. Required.
        gyro (in, 3): measured rate, rad/s, body axes. Required.
        <wheel> (in, 1): what is read of the speed of each wheel, rad/s. Required.
        wheel_torque (out, n): torque of each motor on its wheel over the coming sample, ft-lbf or N-m.
        rate_for_jets (out, 3): for the jets' controller in place of the gyro's, rad/s; while jets unload, with what
            the wheels' momentum would turn the vehicle by.

    State: whether jets unload, 0 or 1.

    Timing: outputs at t_k belong to the readings at t_k; a torque acts on [t_k, t_k+1).

    Args:
        params: see `WheelControlParams`.
        names: of the wheels.
    """

    def __init__(self, params: WheelControlParams, names: Sequence[str]):
        super().__init__()
        self.set_name("wheel_controller")
        self._params = params
        self._controllers = self.DeclareVectorInputPort("hand_controllers", HAND_CONTROLLERS.size)
        self._error = self.DeclareVectorInputPort("attitude_error", 3)
        self._gyro = self.DeclareVectorInputPort("gyro", 3)
        self._wheels = [self.DeclareVectorInputPort(name, 1) for name in names]
        self._unloading = self.DeclareDiscreteState(1)
        turning = {port.ticket() for port in (*self._wheels, self._gyro)}
        command = {self._controllers.ticket(), self._error.ticket()}
        declare_output(self, "wheel_torque", len(names), self._calc_torque, turning | command)
        declare_output(self, "rate_for_jets", 3, self._calc_rate, turning | {self.xd_ticket()})
        period_s = params.settings.period_s
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _speeds(self, context: Any) -> Array:
        """Returns measured speeds of all wheels, rad/s, shape (n,)."""
        return np.concatenate([port.Eval(context) for port in self._wheels])

    def _is_unloading(self, context: Any) -> bool:
        """Tests whether jets unload the wheels from this sample on."""
        was_unloading = context.get_discrete_state(self._unloading).CopyToVector()[0] != 0.0
        return must_unload(was_unloading, self._speeds(context), self._params)

    def _calc_torque(self, context: Any) -> Any:
        """Computes the motor torques of the wheels that turn the vehicle as commanded, shape (n,)."""
        rotation = self._controllers.Eval(context)[_ROTATION]
        turning = rotation, self._error.Eval(context), self._gyro.Eval(context)
        return wheel_torques(turning, self._speeds(context), self._params)

    def _calc_rate(self, context: Any) -> Any:
        """Computes the rate that jets control to zero, rad/s: measured, biased by wheel momentum when unloading."""
        unloading, speeds = self._is_unloading(context), self._speeds(context)
        return rate_for_jets(self._gyro.Eval(context), unloading, speeds, self._params)

    def _update(self, context: Any, state: Any) -> None:
        """Stores whether jets unload the wheels, 0 or 1."""
        state.set_value(self._unloading, [float(self._is_unloading(context))])
