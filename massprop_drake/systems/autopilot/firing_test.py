"""Test firings in flight: jets are asked to fire so that a question of the estimators is answered."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import EventStatus, LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.maneuver.onboard import FiringTest, design_commands, misses_target, suspects
from massprop_drake.systems.autopilot.jet_sets import jet_sets
from massprop_drake.systems.caching import declare_output


class FiringTestMemory(NamedTuple):
    """State of test firings. Never changed; an update makes a new one.

    Attributes:
        rows: commands that are still to be flown, a row per sample, shape (n, n_jets).
        since_s: from when on the question stands, s; infinity: there is none.
        pause_s: until when nothing is asked after a test, s.
        tests: how many have been flown.
    """

    rows: Array
    since_s: float
    pause_s: float
    tests: int

    def __deepcopy__(self, _memo: Any) -> FiringTestMemory:
        """Returns itself: a clone of a context shares what is never changed."""
        return self


class FiringTestSystem(LeafSystem):
    """Requests the firings that show which jet of a group fails, or that make mass properties known.

    Dual control in its simplest form: when a question has stood for a while, a maneuver is designed from what the
    estimators say, as `massprop design` does before a flight, and flown until the question is answered; if it stands
    at the end, again.

    Ports:
        estimate (in, 10), covariance (in, 100): of the estimators. Required.
        fault_probability (in, n_jets + 2): see `CycleEstimator`. Required where groups are asked about.
        gyro (in, 3): measured rate, rad/s, body axes. Required.
        command (out, n_jets): fraction commanded over the coming sample, zero while nothing is tested: `prescribed` of
            the autopilot. No feedthrough.
        tests (out, 1): how many tests have begun. No feedthrough.

    State: abstract, `FiringTestMemory`.

    Timing: a test that is designed at t_k fires from t_k+1 on.

    Args:
        settings: see `FiringTest`.
    """

    def __init__(self, settings: FiringTest):
        super().__init__()
        self.set_name("firing_test")
        self._settings, self._sets = settings, jet_sets(settings.craft)
        n_jets = settings.craft.params.places.jets
        self._estimate = self.DeclareVectorInputPort("estimate", 10)
        self._covariance = self.DeclareVectorInputPort("covariance", 100)
        self._probability = self.DeclareVectorInputPort("fault_probability", n_jets + 2)
        self._gyro = self.DeclareVectorInputPort("gyro", 3)
        start = FiringTestMemory(np.zeros((0, n_jets)), np.inf, 0.0, 0)
        self._memory = self.DeclareAbstractState(Value[object](start))
        state = {self.xa_ticket()}
        declare_output(self, "command", n_jets, self._calc_command, state)
        declare_output(self, "tests", 1, lambda context: [float(self._read_memory(context).tests)], state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(settings.craft.period_s, 0.0, self._update)

    def _read_memory(self, context: Any) -> FiringTestMemory:
        """Returns the state of test firings from the context."""
        memory: FiringTestMemory = context.get_abstract_state(self._memory).get_value()
        return memory

    def _calc_command(self, context: Any) -> Any:
        """Returns the commands of the running test for the coming sample, zero without one, shape (n_jets,)."""
        rows = self._read_memory(context).rows
        return rows[0] if rows.shape[0] else np.zeros(rows.shape[1])

    def _update(self, context: Any, state: Any) -> EventStatus:
        """Writes the state of test firings after the sample into the abstract state."""
        memory = self._next_memory(context, self._read_memory(context))
        state.get_mutable_abstract_state(self._memory).set_value(memory)
        return EventStatus.Succeeded()

    def _next_memory(self, context: Any, memory: FiringTestMemory) -> FiringTestMemory:
        """Computes the state after a sample: continues a test, waits, or designs the test firings that are due."""
        settings, time_s = self._settings, context.get_time()
        covariance = self._covariance.Eval(context).reshape(10, 10)
        suspected = suspects(self._probability.Eval(context), settings) if settings.groups else ()
        is_open = bool(suspected) if settings.groups else misses_target(covariance, settings)
        if not is_open:  # what is left of a test is not flown
            return memory._replace(rows=memory.rows[:0], since_s=np.inf)
        if memory.rows.shape[0] > 0:
            return memory._replace(rows=memory.rows[1:], pause_s=time_s + settings.patience_s)
        if time_s < memory.pause_s:
            return memory._replace(since_s=np.inf)
        since_s = min(memory.since_s, time_s)
        if time_s - since_s < settings.patience_s:
            return memory._replace(since_s=since_s)
        estimate_and_covariance = self._estimate.Eval(context), covariance
        rows = design_commands(self._sets, estimate_and_covariance, self._gyro.Eval(context), suspected, settings)
        n_tests = memory.tests + int(rows.shape[0] > 0)
        return FiringTestMemory(rows, np.inf, time_s + settings.patience_s, n_tests)
