"""Bursts of jets from requests for a change of rate and velocity: when to solve, and the use of the answer."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.autopilot.jet_selection import (
    activity_vectors,
    burst_cycles,
    least_change,
    least_cycles,
    must_select,
)
from massprop_drake.maths.autopilot.pulses import Pulses, burst_pulses, whole_cycle_pulses
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.systems.autopilot.jet_selection_program import (
    RATE,
    VELOCITY,
    JetSelectionProgram,
    Outcome,
    Selection,
)
from massprop_drake.systems.layouts import REFUSED, SELECTION_COUNTS
from massprop_drake.systems.stopwatch import JET_SELECTION, time_call

_LONGEST_BURST_S = 2.0  # against a force that acts all along
_NOT_REFUSED = np.zeros(REFUSED.size)
_LEAST_CONTROL = 0.01  # share of the reach about an axis that must be left when jets are taken out


class Burst(NamedTuple):
    """Burst in force from a sample on, and the state remembered with it, see `SelectionState`.

    Attributes:
        remaining: cycles that each jet has still to fire, this one included, shape (n_jets,).
        counts, refused, out_of_use, owed: as they are now.
    """

    remaining: Array
    counts: Array
    refused: Array
    out_of_use: Array
    owed: Array


class SelectionState(NamedTuple):
    """State of jet selection.

    Attributes:
        remaining: cycles that each jet has still to fire, shape (n_jets,).
        command: decided at the last sample, shape (n_jets,).
        delivered: velocity change that it gives, ft/s or m/s, shape (3,).
        counts, refused: packed as `layouts.SELECTION_COUNTS` and `layouts.REFUSED`.
        out_of_use: 1 for each jet taken out of use, -1 for one left in though in question, shape (n_jets,).
        owed: on-times below the shortest that add up, cycles, see `pulses.burst_pulses`, shape (n_jets,).
    """

    remaining: Array
    command: Array
    delivered: Array
    counts: Array
    refused: Array
    out_of_use: Array
    owed: Array


class Reconfiguration(NamedTuple):
    """Requests of the detector to jet selection, as `layouts.RECONFIGURATION` has them.

    Attributes:
        declared: whether a failure was declared in this cycle.
        known_wrench: torque about the vehicle origin and force of failed jets, shape (6,).
        removed: 1 for each jet to be taken out of use, shape (n_jets,).
    """

    declared: bool
    known_wrench: Array
    removed: Array


class Selector:
    """Decider of which jets fire: a workspace that keeps the linear program and its last results to save time.

    An answer depends on the arguments of `decide` alone, never on earlier calls: what is kept is used again only for
    the same numbers. It is not for several threads at once; a diagram has one in each context.

    Args:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        mass_flows: of each jet, slug/s or kg/s, shape (n_jets,).
        minimum_on_times_s: of each jet, s, shape (n_jets,).
        selectable: which jets may be selected, boolean, shape (n_jets,).
        mass_properties: nominal, the ten parameters, shape (10,).
        period_s: control period, s.
        pulses: on-times that are flown; None: whole cycles.

    Attributes:
        initial: nothing asked for yet.
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
    ):
        self._wrenches = wrenches
        self._least = least_cycles(minimum_on_times_s, period_s)
        self._pulses = whole_cycle_pulses(selectable.size) if pulses is None else pulses
        self._selectable = selectable
        self._nominal = mass_properties
        self._nominal_activity = _make_read_only(activity_vectors(wrenches, mass_properties))
        self._last_wrench, self._last_effect = np.zeros(6), np.zeros(6)  # the last wrench, and its effect
        self._limits_key, self._limits = (b"", 0.0), np.zeros(0)  # the last limits, and of which jets and time
        self._program = JetSelectionProgram(mass_flows)
        self._period_s = period_s
        off = np.zeros(selectable.size)
        counts = SELECTION_COUNTS.pack((0.0, 0.0, 0.0, 1.0))
        owed = off if self._pulses.within else np.zeros(0)
        self.initial = SelectionState(off, off, np.zeros(3), counts, np.zeros(REFUSED.size), off, owed)

    def decide(self, state: SelectionState, request: Any, properties: Array | None, reconfiguration: Any) -> Burst:
        """Selects the burst of jet firings for a request, by the linear program; called where `must_select` is true.

        Args:
            state: before the sample.
            request: see `maths.autopilot.phase_space.Request`.
            properties: mass properties to reckon with, the ten parameters, shape (10,); None: the nominal ones.
            reconfiguration: see `Reconfiguration`; None: there is no detector.
        """
        wrench, declared = None, False
        if reconfiguration is not None:
            declared = reconfiguration.declared
            if has_nonzero(reconfiguration.known_wrench):
                wrench = reconfiguration.known_wrench
        remaining = np.zeros_like(state.remaining) if declared else state.remaining
        solved, reduced, closest, granted = SELECTION_COUNTS.read(state.counts)
        refused = state.refused
        out_of_use, owed = state.out_of_use, state.owed
        solves_before = self._program.solves
        if declared:
            out_of_use = self._take_out_of_use(properties, out_of_use, reconfiguration.removed)
        if not declared or must_select(remaining, request, refused, wrench is not None, False):
            target, selection = self._select_jets(properties, request, wrench, out_of_use)
            remaining, owed, shortest_s = self._round_on_times(selection.on_times_s, owed)
            refused = _NOT_REFUSED
            if not (has_nonzero(remaining) or self._pulses.accumulates):
                refused = REFUSED.pack((target[RATE], least_change(target, selection.on_times_s, shortest_s)))
            size = _length(target[VELOCITY])
            reduced += selection.outcome == Outcome.REDUCED
            closest += selection.outcome == Outcome.CLOSEST
            granted = _length(selection.reached[VELOCITY]) / size if size > 0.0 else 1.0
        counts = (solved + self._program.solves - solves_before, reduced, closest, granted)
        return Burst(remaining, SELECTION_COUNTS.pack(counts), refused, out_of_use, owed)

    def _round_on_times(self, on_times_s: Array, owed: Array) -> tuple[Array, Array, Array | float]:
        """Rounds on-times, s, to flown cycles; also returns remainders owed, and the least on-time rounded up, s."""
        period_s, pulses = self._period_s, self._pulses
        if not pulses.within:
            return burst_cycles(on_times_s, period_s, self._least), owed, 0.5 * period_s
        shortest = pulses.least - 0.5 * pulses.quanta  # that are rounded up to the least
        return *burst_pulses(on_times_s / period_s, owed, pulses), shortest * period_s

    def _activity(self, properties: Array | None) -> Array:
        """Returns activity vectors, shape (6, n_jets), by mass properties; None: by the nominal ones."""
        return self._nominal_activity if properties is None else activity_vectors(self._wrenches, properties)

    def _select_jets(
        self, properties: Array | None, request: Any, wrench: Array | None, out_of_use: Array
    ) -> tuple[Array, Selection]:
        """Computes the change of rate and velocity to solve for, shape (6,), and the on-times selected for it.

        A force that acts all along is undone over the time that the burst takes: that of the change alone,
        in whole cycles, and twice that as often as it takes until on-times within it are enough.
        """
        activity = self._activity(properties)

        def solve(target: Array, longest_s: float) -> Selection:
            """Solves for the on-times of a change of rate and velocity, each at most the longest, s."""
            limits = self._on_time_limits(out_of_use, longest_s)
            return time_call(JET_SELECTION, self._program.solve, activity, target, limits)

        request_vector = np.concatenate([request.rate_change, request.velocity_change])
        if wrench is None:
            return request_vector, solve(request_vector, request.time_limit_s)
        acceleration = self._acceleration(properties, wrench)
        if np.isfinite(request.time_limit_s):  # a translation, which has its time
            target = request_vector - acceleration * request.time_limit_s
            return target, solve(target, request.time_limit_s)
        duration_alone = float(solve(request_vector, np.inf).on_times_s.max())
        duration = self._period_s * max(1, math.ceil(duration_alone / self._period_s - 1e-9))
        while True:
            target = request_vector - acceleration * duration
            selection = solve(target, duration)
            if selection.outcome == Outcome.EXACT or duration >= _LONGEST_BURST_S:
                return target, selection
            duration *= 2.0

    def _on_time_limits(self, out_of_use: Array, longest_s: float) -> Array:
        """Computes longest on-times, s, zero for jets that are not selectable or out of use, shape (n_jets,)."""
        key = out_of_use.tobytes(), longest_s
        if key != self._limits_key:
            available = self._selectable & (out_of_use <= 0.0)
            self._limits_key, self._limits = key, _make_read_only(np.where(available, longest_s, 0.0))
        return self._limits

    def _acceleration(self, properties: Array | None, wrench: Array) -> Array:
        """Computes angular and linear acceleration by a wrench about the vehicle origin, body axes, shape (6,)."""
        if properties is not None:
            return activity_vectors(wrench[None, :], properties)[:, 0]
        if not np.array_equal(wrench, self._last_wrench):
            self._last_wrench, self._last_effect = wrench.copy(), activity_vectors(wrench[None, :], self._nominal)[:, 0]
        return self._last_effect

    def _take_out_of_use(self, properties: Array | None, out_of_use: Array, proposed_jets: Array) -> Array:
        """Marks proposed jets as out of use (1) if all axes stay controllable without them, else as left in (-1)."""
        activity = self._activity(properties)
        needed = [_LEAST_CONTROL * reach for reach in self._axis_reaches(activity, np.zeros_like(proposed_jets))]

        def is_controllable(unused: Array) -> bool:
            """Tests whether all axes stay controllable both ways with some jets unused."""
            return all(reach > least for reach, least in zip(self._axis_reaches(activity, unused), needed, strict=True))

        # all jets that the data cannot tell apart, or none: those in question since the last time
        group = (proposed_jets != 0.0) & (out_of_use == 0.0)
        can_spare = is_controllable(np.where(group, 1.0, out_of_use))
        return np.where(group, 1.0 if can_spare else -1.0, out_of_use)

    def _axis_reaches(self, activity: Array, out_of_use: Array) -> list[float]:
        """Computes the largest rate change in 1 s of firing, about x, y, z and both ways, rad/s, six numbers."""
        limits = self._on_time_limits(out_of_use, 1.0)
        return [self._program.reach(activity, row, sign, limits) for row in range(3) for sign in (1.0, -1.0)]


def _make_read_only(array: Array) -> Array:
    """Makes an array read-only in place, and returns it."""
    array.flags.writeable = False
    return array


def _length(vector: Array) -> float:
    """Computes the Euclidean norm of a short vector."""
    return math.sqrt(float(vector @ vector))
