"""Attitude by the gyro, and the attitude to hold."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot import autopilot_ports
from massprop_drake.maths.autopilot.autopilot_ports import Reference
from massprop_drake.maths.autopilot.phase_space import initial_memory
from massprop_drake.maths.kernels import compile_kernel_if, make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import Cached, declare_outputs, declare_update, state_of
from massprop_drake.systems.layouts import ATTITUDE_MEMORY, HAND_CONTROLLERS


class AttitudeReference(LeafSystem):
    """Integrates the measured rate to an attitude and keeps the attitude to hold.

    The reference is inertially fixed about axes in detent and follows the body about the others; an
    axis back in detent is held from the moment its rate has fallen below the capture rate.

    Ports:
        gyro (in, 3): measured rate, rad/s, body axes. Required.
        hand_controllers (in, 6): see `HandControllers`. Required.
        attitude_error (out, 3): rotation vector from the held attitude to the body, rad, body axes;
            zero about axes that hold none.

    State: memory (14): attitude (4) and reference (4), quaternions, scalar first; which axes hold
    attitude (3), 0 or 1; the last reading (3), rad/s, NaN before the first.

    Timing: the error at t_k belongs to the reading at t_k.

    Args:
        period_s: sample period, s.
        capture_rate: see `maths.phase_space.PhaseSpaceParams`.
        compiled: whether its kernel is.
    """

    def __init__(self, *, period_s: float, capture_rate: float, compiled: bool = False):
        super().__init__()
        self.set_name("attitude_reference")
        start = initial_memory().attitude
        self._kernel = compile_kernel_if(autopilot_ports.attitude, compiled)
        self._held = make_holder(Reference(period_s, capture_rate, start), compiled)
        self._gyro = self.DeclareVectorInputPort("gyro", 3)
        self._controllers = self.DeclareVectorInputPort("hand_controllers", HAND_CONTROLLERS.size)
        self.DeclareDiscreteState(ATTITUDE_MEMORY.pack(start))
        step = Cached(self, "step", self._compute, {self.xd_ticket(), self.all_input_ports_ticket()})
        declare_outputs(self, step, [("attitude_error", 3, slice(0, 3))])
        declare_update(self, step, period_s, slice(3, None))

    def _compute(self, context: Any) -> Array:
        """Computes the attitude error (3), followed by the next state of the reference, as one vector."""
        gyro, controllers = self._gyro.Eval(context), self._controllers.Eval(context)
        row: Array = self._kernel(state_of(context), gyro, controllers, self._held)
        return row
