"""The control law: a six-dimensional rate-change request."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot import autopilot_ports
from massprop_drake.maths.autopilot.autopilot_ports import Control
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, initial_memory
from massprop_drake.maths.kernels import compile_kernel_if, make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import Cached, declare_outputs, declare_update, state_of
from massprop_drake.systems.layouts import HAND_CONTROLLERS, REQUEST, TRANSLATION_MEMORY


class PhaseSpaceController(LeafSystem):
    """Turns hand controllers, attitude error and rate into a rate-change request.

    Source: D. R. Levy, MIT S.M. thesis, 1983, section 5.1 (modes); the gains are params, since the
    thesis gives none. See `massprop_drake.maths.autopilot.phase_space`.

    Ports:
        hand_controllers (in, 6): see `HandControllers`. Required.
        attitude_error (in, 3): from the held attitude to the body, rad, body axes. Required.
        gyro (in, 3): measured rate, rad/s, body axes. Required.
        delivered (in, 3): velocity change commanded over the last sample, ft/s or m/s. Required.
        request (out, 8): dw (3) rad/s, dv (3) ft/s or m/s, longest on-time s (may be infinite),
            urgency (0 none, 1 once idle, 2 at once).

    State: translation (8): hand controller (3), velocity left (3), horizon left s, time since the last
    selection s.

    Timing: the request at t_k belongs to the measurements at t_k.

    Args:
        params: gains and limits.
        compiled: whether its kernel is.
    """

    def __init__(self, params: PhaseSpaceParams, *, compiled: bool = False):
        super().__init__()
        self.set_name("phase_space_controller")
        start = initial_memory().translation
        self._kernel = compile_kernel_if(autopilot_ports.request, compiled)
        self._held = make_holder(Control(params, start), compiled)
        sizes = {"hand_controllers": HAND_CONTROLLERS.size, "attitude_error": 3, "gyro": 3, "delivered": 3}
        self._sensed = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        self.DeclareDiscreteState(TRANSLATION_MEMORY.pack(start))
        step = Cached(self, "step", self._compute, {self.xd_ticket(), self.all_input_ports_ticket()})
        declare_outputs(self, step, [("request", REQUEST.size, slice(0, REQUEST.size))])
        declare_update(self, step, params.period_s, slice(REQUEST.size, None))

    def _compute(self, context: Any) -> Array:
        """Computes the request, packed as `REQUEST`, followed by the next state, as one vector."""
        arguments = [state_of(context), *(port.Eval(context) for port in self._sensed), self._held]
        row: Array = self._kernel(*arguments)
        return row
