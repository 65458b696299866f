"""Jet selection: which jets fire, and for how many cycles."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot.jet_selection import activity_vectors, burst_cycles, least_change
from massprop_drake.maths.autopilot.phase_space import Urgency
from massprop_drake.maths.linear_algebra import nonzero
from massprop_drake.systems.autopilot.jet_selection_program import (
    RATE,
    VELOCITY,
    JetSelectionProgram,
    Outcome,
    Selection,
)
from massprop_drake.systems.caching import Cached, Stopwatch
from massprop_drake.systems.layouts import RECONFIGURATION, REFUSED, REQUEST, SELECTION_COUNTS

Array = NDArray[np.float64]

_LONGEST_BURST_S = 2.0  # against a force that acts all along
_NOT_REFUSED = (np.zeros(3), 0.0)
_LEAST_CONTROL = 0.01  # share of the reach about an axis that must be left when jets are taken out


class _Burst(NamedTuple):
    """The burst in force at a sample."""

    remaining: Array  # cycles still to fire, this one included
    command: Array
    changed: tuple[Array, Array, Array] | None  # states `counts`, `refused`, `out_of_use`; None: as they were


class JetSelection(LeafSystem):
    r"""Serves rate-change requests by bursts of jet firings of least propellant.

    A request is taken when no burst is running, or at once if it says so. The on-times of the linear
    program (1-1) to (1-4) are rounded to whole cycles, and every selected jet fires from now on for
    its number of cycles. A request that cannot be met is relaxed and counted, never dropped; see
    `JetSelectionProgram`.

    Ports:
        request (in, 8): see `PhaseSpaceController`. Required.
        estimate (in, 10): estimated mass properties, see `maths.mass_properties`. Optional.
        converged (in, 1): non-zero when the estimate may be used. Optional, with `estimate`.
        reconfiguration (in, 7 + n_jets): see `FailureDetector`. Optional. A declared failure stops the
            running burst; the jets in question are not selected again, if control about every axis
            remains without them; known forces are met by asking in every idle cycle for what undoes them.
        command (out, n_jets): 1 for each jet that fires over the coming sample, else 0. Feedthrough.
        held_command (out, n_jets): the command decided at the last sample. No feedthrough.
        delivered (out, 3): velocity change that the held command gives in one sample by the mass
            properties in use, ft/s or m/s. No feedthrough.
        out_of_use (out, n_jets): 1 for each jet taken out of use, -1 for one in question that is left in
            because control needs it. No feedthrough.
        counts (out, 4): programs solved; requests met in part (velocity change reduced); requests
            met by the closest reachable one; share of the last request's velocity change that was
            granted. No feedthrough.

    State: remaining (n_jets), cycles left of the burst; held_command (n_jets); delivered (3);
    counts (4); refused (4): rate change of the last request if it rounded to no firing at all, and by how
    much it must change to be asked again, rad/s.

    Timing: `command` at t_k acts on [t_k, t_k+1); it is for a plant that is stepped at t_k, and for
    logs. `held_command` equals it after the update at t_k; it is for a continuous plant, and at t_k
    tells what acted on the past interval.

    Args:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        mass_flows: of each jet, slug/s or kg/s, shape (n_jets,).
        minimum_on_times_s: of each jet, s, shape (n_jets,).
        selectable: which jets may be selected, boolean, shape (n_jets,).
        mass_properties: nominal, the ten parameters, shape (10,).
        period_s: control period, s.
    """

    def __init__(
        self,
        *,
        wrenches: Array,
        mass_flows: Array,
        minimum_on_times_s: Array,
        selectable: NDArray[np.bool_],
        mass_properties: Array,
        period_s: float,
    ):
        super().__init__()
        self.set_name("jet_selection")
        n_jets = wrenches.shape[0]
        self.stopwatch = Stopwatch()  # of the linear program
        self._wrenches = wrenches
        self._minimum = minimum_on_times_s
        self._selectable = selectable
        self._nominal = mass_properties
        self._nominal_activity = activity_vectors(wrenches, mass_properties)
        self._program = JetSelectionProgram(mass_flows)
        self._period_s = period_s

        self._layout = RECONFIGURATION.sized(jets=n_jets)
        self._request = self.DeclareVectorInputPort("request", REQUEST.size)
        self._estimate = self.DeclareVectorInputPort("estimate", 10)
        self._converged = self.DeclareVectorInputPort("converged", 1)
        self._reconfiguration = self.DeclareVectorInputPort("reconfiguration", self._layout.size)
        self._remaining = self.DeclareDiscreteState(n_jets)
        self._held = self.DeclareDiscreteState(n_jets)
        self._delivered = self.DeclareDiscreteState(3)
        self._counts = self.DeclareDiscreteState(SELECTION_COUNTS.pack((0.0, 0.0, 0.0, 1.0)))
        self._refused = self.DeclareDiscreteState(REFUSED.size)
        self._out_of_use = self.DeclareDiscreteState(n_jets)
        self._burst = Cached(self, "burst", self._compute, {self.xd_ticket(), self.all_input_ports_ticket()})
        self.DeclareVectorOutputPort("command", n_jets, self._calc_command, prerequisites_of_calc={self._burst.ticket})
        self.DeclareStateOutputPort("held_command", self._held)
        self.DeclareStateOutputPort("delivered", self._delivered)
        self.DeclareStateOutputPort("counts", self._counts)
        self.DeclareStateOutputPort("out_of_use", self._out_of_use)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _properties(self, context: Any) -> Array:
        """The mass properties in use."""
        if self._converged.HasValue(context) and self._converged.Eval(context)[0] != 0.0:
            return self._estimate.Eval(context)
        return self._nominal

    def _activity(self, context: Any) -> Array:
        """Activity vectors by the mass properties in use."""
        properties = self._properties(context)
        if properties is self._nominal:
            return self._nominal_activity
        return activity_vectors(self._wrenches, properties)

    def _compute(self, context: Any) -> _Burst:
        request = REQUEST.read(self._request.Eval(context))
        remaining = context.get_discrete_state(self._remaining).CopyToVector()
        wrench, declared = None, False
        if self._reconfiguration.HasValue(context):
            asked_for = self._layout.read(self._reconfiguration.Eval(context))
            declared = asked_for.declared
            if nonzero(asked_for.known_wrench):
                wrench = asked_for.known_wrench
        if declared:
            remaining = np.zeros_like(remaining)
        urgency = request.urgency
        asked = urgency == Urgency.WHEN_IDLE or wrench is not None
        if urgency != Urgency.AT_ONCE and not declared and (not asked or nonzero(remaining)):
            return _Burst(remaining, np.where(remaining > 0.0, 1.0, 0.0), None)

        solved, reduced, closest, granted = SELECTION_COUNTS.read(
            context.get_discrete_state(self._counts).CopyToVector()
        )
        refused = REFUSED.read(context.get_discrete_state(self._refused).CopyToVector())
        out_of_use = context.get_discrete_state(self._out_of_use).CopyToVector()
        before = self._program.solves
        if declared:
            out_of_use = self._reduced(context, out_of_use, asked_for.removed)
        if wrench is None and urgency == Urgency.WHEN_IDLE:
            change = max(abs(element) for element in (request.rate_change - refused.rate_change).tolist())
            asked = change >= refused.least_change
        if urgency == Urgency.AT_ONCE or asked:
            available = self._selectable & (out_of_use <= 0.0)
            wanted, selection = self._selected(context, request, wrench, available)
            remaining = burst_cycles(selection.on_times_s, self._period_s, self._minimum)
            refused = _NOT_REFUSED
            if not nonzero(remaining):
                refused = (wanted[RATE], least_change(wanted, selection.on_times_s, self._period_s))
            size = float(np.linalg.norm(wanted[VELOCITY]))
            reduced += selection.outcome == Outcome.REDUCED
            closest += selection.outcome == Outcome.CLOSEST
            granted = float(np.linalg.norm(selection.reached[VELOCITY])) / size if size > 0.0 else 1.0
        counts = (solved + self._program.solves - before, reduced, closest, granted)
        changed = SELECTION_COUNTS.pack(counts), REFUSED.pack(refused), out_of_use
        return _Burst(remaining, np.where(remaining > 0.0, 1.0, 0.0), changed)

    def _selected(
        self, context: Any, request: Any, wrench: Array | None, available: NDArray[np.bool_]
    ) -> tuple[Array, Selection]:
        """The change of rate and velocity asked for, and the answer.

        A force that acts all along is undone over the time that the burst takes: that of the change alone,
        in whole cycles, and twice that as often as it takes until on-times within it are enough.
        """
        activity = self._activity(context)

        def solved(wanted: Array, longest_s: float) -> Selection:
            limits = np.where(available, longest_s, 0.0)
            return self.stopwatch.measure(self._program.solve, activity, wanted, limits)

        asked = np.concatenate([request.rate_change, request.velocity_change])
        if wrench is None:
            return asked, solved(asked, request.time_limit_s)
        effect = self._effect(context, wrench)
        if np.isfinite(request.time_limit_s):  # a translation, which has its time
            wanted = asked - effect * request.time_limit_s
            return wanted, solved(wanted, request.time_limit_s)
        alone = float(solved(asked, np.inf).on_times_s.max())
        duration = self._period_s * max(1, math.ceil(alone / self._period_s - 1e-9))
        while True:
            wanted = asked - effect * duration
            selection = solved(wanted, duration)
            if selection.outcome == Outcome.EXACT or duration >= _LONGEST_BURST_S:
                return wanted, selection
            duration *= 2.0

    def _effect(self, context: Any, wrench: Array) -> Array:
        """Rates of change of rate and velocity by a wrench about the vehicle origin, shape (6,)."""
        return activity_vectors(wrench[None, :], self._properties(context))[:, 0]

    def _reduced(self, context: Any, out_of_use: Array, proposed: Array) -> Array:
        """The state `out_of_use` when jets are proposed: those that control about every axis can spare go."""
        activity = self._activity(context)
        needed = [_LEAST_CONTROL * reach for reach in self._reaches(activity, np.zeros_like(proposed))]

        def controllable(out: Array) -> bool:
            return all(reach > least for reach, least in zip(self._reaches(activity, out), needed, strict=True))

        # all jets that the data cannot tell apart, or none: those in question since the last time
        group = (proposed != 0.0) & (out_of_use == 0.0)
        spared = controllable(np.where(group, 1.0, out_of_use))
        return np.where(group, 1.0 if spared else -1.0, out_of_use)

    def _reaches(self, activity: Array, out_of_use: Array) -> list[float]:
        """Largest rate change per second of firing about each axis, both ways, without some jets."""
        limits = np.where(self._selectable & (out_of_use <= 0.0), 1.0, 0.0)
        return [self._program.reach(activity, row, sign, limits) for row in range(3) for sign in (1.0, -1.0)]

    def _calc_command(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._burst.get(self, context).command)

    def _update(self, context: Any, state: Any) -> None:
        burst = self._burst.get(self, context)
        delivered = np.zeros(3)
        if nonzero(burst.command):
            delivered = self._activity(context)[VELOCITY] @ burst.command * self._period_s
        state.set_value(self._remaining, np.maximum(burst.remaining - 1.0, 0.0))
        state.set_value(self._held, burst.command)
        state.set_value(self._delivered, delivered)
        if burst.changed is not None:
            groups = (self._counts, self._refused, self._out_of_use)
            for group, value in zip(groups, burst.changed, strict=True):
                state.set_value(group, value)
