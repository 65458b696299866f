"""The control law: a six-dimensional rate-change request."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.phase_space import (
    PhaseSpaceParams,
    Request,
    TranslationMemory,
    phase_space_request,
)
from massprop_drake.systems.caching import Cached


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
        period_s: sample period, s.
    """

    def __init__(self, params: PhaseSpaceParams, *, period_s: float):
        super().__init__()
        self.set_name("phase_space_controller")
        self._params = params
        self._period_s = period_s
        self._controllers = self.DeclareVectorInputPort("hand_controllers", 6)
        self._error = self.DeclareVectorInputPort("attitude_error", 3)
        self._gyro = self.DeclareVectorInputPort("gyro", 3)
        self._delivered = self.DeclareVectorInputPort("delivered", 3)
        self._translation = self.DeclareDiscreteState(8)
        self._step = Cached(self, "step", self._compute, {self.xd_ticket(), self.all_input_ports_ticket()})
        self.DeclareVectorOutputPort("request", 8, self._calc_request, prerequisites_of_calc={self._step.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _compute(self, context: Any) -> tuple[Request, TranslationMemory]:
        controllers = self._controllers.Eval(context)
        remembered = context.get_discrete_state(self._translation).CopyToVector()
        return phase_space_request(
            controllers[:3],
            controllers[3:],
            self._error.Eval(context),
            self._gyro.Eval(context),
            self._delivered.Eval(context),
            TranslationMemory(remembered[:3], remembered[3:6], float(remembered[6]), float(remembered[7])),
            self._period_s,
            self._params,
        )

    def _calc_request(self, context: Any, output: Any) -> None:
        request = self._step.get(self, context)[0]
        output.SetFromVector(
            np.array([*request.rate_change, *request.velocity_change, request.time_limit_s, request.urgency])
        )

    def _update(self, context: Any, state: Any) -> None:
        memory = self._step.get(self, context)[1]
        left, since = memory.horizon_left_s, memory.since_selection_s
        state.set_value(self._translation, np.array([*memory.command, *memory.velocity_left, left, since]))
