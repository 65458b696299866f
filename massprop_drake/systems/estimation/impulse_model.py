"""Impulses that the commanded jets should have given over the last sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation import estimation_ports
from massprop_drake.maths.estimation.detector import unpack_known_force
from massprop_drake.maths.estimation.estimation_ports import Lagging
from massprop_drake.maths.kernels import compile_kernel_if, make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.thrust import lag_factors
from massprop_drake.systems.arguments import require_rows, require_vector
from massprop_drake.systems.caching import Cached, declare_output, declare_outputs, state_of
from massprop_drake.systems.layouts import IMPULSE_MEMORY, IMPULSES, KNOWN_FORCE
from massprop_drake.systems.stopwatch import ESTIMATORS, time_call

_NOTHING_OUTSIDE = np.zeros(6)
_IMPULSE = slice(IMPULSES.slice("angular_impulse").start, IMPULSES.slice("linear_impulse").stop)


class ImpulseModel(LeafSystem):
    """Turns jet commands into impulses (2-45), (2-46), with the steady-combination gate.

    Ports:
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, 0 to 1, NaN where
            not known. Required.
        outside_wrench (in, 6): torque about the vehicle origin and force of known outside forces, mean
            over that interval. Unconnected: none.
        known_force (in, 24): see `FailureDetector`; its wrench acts over the whole interval. Unconnected:
            none.
        impulses (out, 8): angular impulse about the vehicle origin (3), lbf-ft-s or N-m-s; linear
            impulse (3), lbf-s or N-s; usable, 1 when the combination was steady; firing, 1 when any
            jet was commanded or an outside force is known.
        mean_level (out, n_jets): thrust level of each jet, mean over the interval.

    State: memory (2 n_jets): the command of the interval before, and the thrust level by the lag at the
    start of this one.

    Timing: `impulses` at t_k are of [t_k-1, t_k). Before the first sample all jets are taken as off.

    Args:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        time_constants_s: of the thrust lag, s, zero: instantaneous, shape (n_jets,).
        period_s: sample period, s.
        compiled: whether its kernel is.
    """

    def __init__(self, *, wrenches: Array, time_constants_s: Array, period_s: float, compiled: bool = False):
        super().__init__()
        self.set_name("impulse_model")
        wrenches = require_rows("impulse model: wrenches", wrenches, 6)
        n_jets = wrenches.shape[0]
        time_constants_s = require_vector("impulse model: time_constants_s", time_constants_s, n_jets)
        lagging = Lagging(wrenches * period_s, lag_factors(time_constants_s, period_s), period_s)
        self._kernel = compile_kernel_if(estimation_ports.impulses, compiled)
        self._held = make_holder(lagging, compiled)
        self._command = self.DeclareVectorInputPort("jet_commands", n_jets)
        self._known_force = self.DeclareVectorInputPort("known_force", KNOWN_FORCE.size)
        self._outside = self.DeclareVectorInputPort("outside_wrench", 6)
        self._period_s = period_s
        self._n_jets = n_jets
        self.DeclareDiscreteState(IMPULSE_MEMORY.sized(jets=n_jets).size)
        read = {self.xd_ticket(), self._command.ticket(), self._outside.ticket()}
        self._impulses = Cached(self, "impulses", self._compute, read)
        tickets = {self._impulses.ticket, self._known_force.ticket()}
        declare_output(self, "impulses", IMPULSES.size, self._calc_impulses, tickets)
        declare_outputs(self, self._impulses, [("mean_level", n_jets, slice(IMPULSES.size, IMPULSES.size + n_jets))])
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _compute(self, context: Any) -> Array:
        """Computes impulses, mean jet levels and the next levels, as `estimation_ports.impulses` packs them."""
        outside = self._outside.Eval(context) if self._outside.HasValue(context) else _NOTHING_OUTSIDE
        arguments = state_of(context), self._command.Eval(context), outside, self._held
        row: Array = time_call(ESTIMATORS, self._kernel, *arguments)
        return row

    def _calc_impulses(self, context: Any) -> Any:
        """Computes the impulses of the interval, those of known forces included, packed as `IMPULSES`."""
        impulse_row = self._impulses.get(context)[: IMPULSES.size]
        if self._known_force.HasValue(context):
            known = unpack_known_force(self._known_force.Eval(context))
            if known.acts:
                impulse_row = impulse_row.copy()
                impulse_row[_IMPULSE] += known.wrench * self._period_s
        return impulse_row

    def _update(self, context: Any, state: Any) -> None:
        """Stores the interval's command, and the thrust levels at its end."""
        level = self._impulses.get(context)[IMPULSES.size + self._n_jets :]
        state.set_value(np.concatenate((self._command.Eval(context), level)))
