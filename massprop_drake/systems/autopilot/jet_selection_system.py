"""Jet selection: which jets fire, and for how many cycles."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.autopilot import autopilot_ports
from massprop_drake.maths.autopilot.autopilot_ports import Burning
from massprop_drake.maths.autopilot.jet_selection import delivered_velocity, jet_forces
from massprop_drake.maths.autopilot.phase_space import Request, Urgency
from massprop_drake.maths.autopilot.pulses import Pulses, pulse_onsets, whole_cycle_pulses
from massprop_drake.maths.kernels import compile_kernel_if, make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.systems.autopilot.selector import SelectionState, Selector
from massprop_drake.systems.caching import Cached, Part, Scratch, declare_output, declare_outputs
from massprop_drake.systems.layouts import RECONFIGURATION, REQUEST

_SELECTS, _FIRED = 0, slice(1, None)  # of what `autopilot_ports.select_or_fire` gives


class JetSelection(LeafSystem):
    r"""Serves rate-change requests by bursts of jet firings of least propellant.

    A request is taken when no burst is running, or at once if it says so. The on-times of the linear
    program (1-1) to (1-4) are rounded to whole cycles, and every selected jet fires from now on for
    its number of cycles; with `pulses` they are flown as they are, in steps of the
    valves' clocks. A request that cannot be met is relaxed and counted, never dropped; see `JetSelectionProgram`.

    Ports:
        request (in, 8): see `PhaseSpaceController`. Required.
        estimate (in, 10): estimated mass properties, see `maths.mass_properties`. Optional.
        converged (in, 1): non-zero when the estimate may be used. Optional, with `estimate`.
        reconfiguration (in, 7 + n_jets): see `FailureDetector`. Optional. A declared failure stops the
            running burst; the jets in question are not selected again, if control about every axis
            remains without them; known forces are met by asking in every idle cycle for what undoes them.
        prescribed (in, n_jets): fraction commanded over the coming sample, 0 to 1. Optional. In a sample in which any
            is above zero these fire instead, and a running burst ends; what it was for is asked for again.
        command (out, n_jets): 1 for each jet that fires over the coming sample, else 0; of pulses the share of it for
            which the jet is open. Feedthrough.
        held_command (out, n_jets): the command decided at the last sample. No feedthrough.
        command_onset (out, n_jets), held_command_onset (out, n_jets), with pulses: how long after the beginning of the
            coming and of the last sample each jet opens, s, see `maths.vehicle.on_times`. The held one has no
            feedthrough.
        delivered (out, 3): velocity change that the held command gives in one sample by the mass
            properties in use, ft/s or m/s. No feedthrough.
        out_of_use (out, n_jets): 1 for each jet taken out of use, -1 for one in question that is left in
            because control needs it. No feedthrough.
        counts (out, 4): programs solved; requests met in part (velocity change reduced); requests
            met by the closest reachable one; share of the last request's velocity change that was
            granted. No feedthrough.

    State: remaining (n_jets), cycles left of the burst; held_command (n_jets); delivered (3);
    counts (4); refused (4): rate change of the last request if it rounded to no firing at all, and by how
    much it must change to be asked again, rad/s; out_of_use (n_jets); with pulses owed (n_jets): on-times
    below the shortest that add up, cycles.

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
        pulses: on-times that are flown; None: whole cycles.
        compiled: whether its kernels are; the linear program is Drake's.
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
        pulses: Pulses | None = None,
        compiled: bool = False,
    ):
        super().__init__()
        self.set_name("jet_selection")
        n_jets = wrenches.shape[0]
        on_times: dict[str, Any] = {"minimum_on_times_s": minimum_on_times_s, "period_s": period_s, "pulses": pulses}
        body: dict[str, Any] = {"wrenches": wrenches, "mass_flows": mass_flows, "mass_properties": mass_properties}
        make = partial(Selector, selectable=selectable, **on_times, **body)
        self._selector = Scratch(self, "selector", make)
        self._select_or_fire = compile_kernel_if(autopilot_ports.select_or_fire, compiled)
        self._fire_sample = compile_kernel_if(autopilot_ports.fire_sample, compiled)
        some_request = Request(np.zeros(3), np.zeros(3), np.inf, Urgency.NONE)
        self._pulses, self._period_s = whole_cycle_pulses(n_jets) if pulses is None else pulses, period_s
        self._forces = jet_forces(wrenches)
        self._held = make_holder(Burning(self._forces, period_s, some_request, self._pulses), compiled)
        self._nominal = float(mass_properties[MASS_RECIPROCAL])
        self._command = slice(n_jets, 2 * n_jets)
        self._rows = (slice(0, n_jets), self._command, slice(2 * n_jets, None))
        self._layout = RECONFIGURATION.sized(jets=n_jets)
        self._no_reconfiguration = np.zeros(self._layout.size)
        self._request = self.DeclareVectorInputPort("request", REQUEST.size)
        self._estimate = self.DeclareVectorInputPort("estimate", 10)
        self._converged = self.DeclareVectorInputPort("converged", 1)
        self._reconfiguration = self.DeclareVectorInputPort("reconfiguration", self._layout.size)
        self._prescribed = self.DeclareVectorInputPort("prescribed", n_jets)
        starts = make().initial
        self._groups = SelectionState._make(self.DeclareDiscreteState(part) if part.size else None for part in starts)
        self._burst = Cached(self, "burst", self._compute, {self.xd_ticket(), self.all_input_ports_ticket()})
        declare_outputs(self, self._burst, [("command", n_jets, lambda burst: burst[0][self._command])])
        self.DeclareStateOutputPort("held_command", self._groups.command)
        if self._pulses.within:
            opened: Part = lambda burst: pulse_onsets(burst[0][self._command], self._pulses, period_s)  # noqa: E731
            declare_outputs(self, self._burst, [("command_onset", n_jets, opened)])
            state = {self.xd_ticket()}
            declare_output(self, "held_command_onset", n_jets, self._calc_held, state)
        self.DeclareStateOutputPort("delivered", self._groups.delivered)
        self.DeclareStateOutputPort("counts", self._groups.counts)
        self.DeclareStateOutputPort("out_of_use", self._groups.out_of_use)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _converged_properties(self, context: Any) -> Array | None:
        """Returns the ten estimated parameters where converged; None: the nominal ones are in use."""
        if self._converged.HasValue(context) and self._converged.Eval(context)[0] != 0.0:
            return self._estimate.Eval(context)
        return None

    def _state(self, context: Any) -> SelectionState:
        """Returns the state of jet selection from the context."""
        return SelectionState._make(_state_group(context, group) for group in self._groups)

    def _compute(self, context: Any) -> tuple[Array, tuple[Array, ...]]:
        """Computes commands and delivered velocity of the coming sample, and further states that change."""
        row, changed = self._decide_sample(context)
        prescribed = self._prescribed.Eval(context) if self._prescribed.HasValue(context) else None
        if prescribed is None or not prescribed.any():
            return row, changed
        properties = self._converged_properties(context)
        reciprocal = self._nominal if properties is None else float(properties[MASS_RECIPROCAL])
        delivered = delivered_velocity(prescribed, self._forces, reciprocal, self._period_s)
        return np.concatenate((np.zeros(prescribed.size), prescribed, delivered)), changed

    def _decide_sample(self, context: Any) -> tuple[Array, tuple[Array, ...]]:
        """Continues the burst, or selects a new one; returns the coming sample's jets, and states that change."""
        remaining, refused = _state_group(context, self._groups.remaining), _state_group(context, self._groups.refused)
        request, properties = self._request.Eval(context), self._converged_properties(context)
        has_detector = self._reconfiguration.HasValue(context)
        reconfiguration_row = self._reconfiguration.Eval(context) if has_detector else self._no_reconfiguration
        reciprocal = self._nominal if properties is None else float(properties[MASS_RECIPROCAL])
        row = self._select_or_fire(remaining, request, refused, reconfiguration_row, reciprocal, self._held)
        if row[_SELECTS] == 0.0:
            return row[_FIRED], ()
        reconfiguration = self._layout.read(reconfiguration_row) if has_detector else None
        burst = self._selector.get(context).decide(
            self._state(context), REQUEST.read(request), properties, reconfiguration
        )
        return self._fire_sample(burst.remaining, reciprocal, self._held), burst[1:]

    def _calc_held(self, context: Any) -> Any:
        """Computes onsets of the held command's pulses in the running sample, s, shape (n_jets,)."""
        command = _state_group(context, self._groups.command)
        return pulse_onsets(command, self._pulses, self._period_s)

    def _update(self, context: Any, state: Any) -> None:
        """Writes the states after the coming sample's firings into the discrete state."""
        row, changed = self._burst.get(context)
        values = (*(row[part] for part in self._rows), *changed)
        for group, value in zip(self._groups, values, strict=False):
            if group is not None:
                state.set_value(group, value)


def _state_group(context: Any, group: Any) -> Array:
    """Returns a copy of a group of the discrete state, an empty vector where there is none."""
    vector: Array = np.zeros(0) if group is None else context.get_discrete_state(group).CopyToVector()
    return vector
