"""Finds failed jets, jumps and false readings by a hypothesis filter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.detector import Detector, Event, Jets, Judgment
from massprop_drake.maths.estimation.faults import hypothesis_filter as faults
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import NOTHING, Cached
from massprop_drake.systems.layouts import DETECTOR_REPORT, HYPOTHESIS_REPORT, RECONFIGURATION, detector_row
from massprop_drake.systems.stopwatch import DETECTOR, timed


class Memory(NamedTuple):
    """What the system remembers. Never changed; a cycle makes a new one.

    Attributes:
        before: state before the newest sample that has been judged.
        judgment: of it, with the state after it; None: none has been judged.
        time_s: of that sample.
    """

    before: Any
    judgment: Judgment | None
    time_s: float

    @property
    def state(self) -> Any:
        """After it."""
        return self.before if self.judgment is None else self.judgment.state

    def __deepcopy__(self, _memo: Any) -> Memory:
        """Itself: a clone of a context shares what is never changed."""
        return self


class HypothesisDetector(LeafSystem):
    r"""Hypothesis filter of faults, see `massprop_drake.maths.estimation.faults`.

    Ports:
        evidence (in, abstract): `maths.estimation.joint.cycle.JointEvidence`, see `JointEstimator`. Required.
        replacement (out, abstract): the state from which the filter is to go on, or `NOTHING`; see `JointEstimator`.
        published (out, abstract): the state whose estimates it is to publish meanwhile, or `NOTHING`.
        reconfiguration (out, 7 + n_jets), closed (out, n_jets), held_closed (out, n_jets), report (out, 14 +
            4 n_jets): see `FailureDetector`. The forces are those that the filter has as states; no manifold is
            closed; magnitudes are those of the jets that are declared at this sample.
        hypothesis_report (out, 21 + 12 n_jets): packed as `layouts.HYPOTHESIS_REPORT`, for logs: what is said of jumps
            and readings; and of every jet, as `faults.declarations.Word`, with force, its 1-sigma and onset,
            which of the things said name it, and what would tell its group apart.
        fault_probability (out, n_jets + 2): posterior probability that each jet has failed, then that nothing has
            failed or changed, and that something unknown pushes; NaN of a method that gives none.

    State: abstract, `Memory`: hypotheses are tuples that are never changed, so that a cycle shares all but the newest
    with the one before, and so does a clone.

    Timing: outputs at t_k judge the interval [t_k-1, t_k). Drake updates abstract state before the discrete state of
    other systems at the same instant: the state therefore holds the newest judgment with its time, and outputs at that
    time are taken from it.

    Args:
        params: of the method, such as `faults.hypothesis_filter.Params`.
        jets: see `maths.estimation.detector.Jets`.
        method: a detector that is made for one filter and judges hypotheses; default that of the joint filter.
    """

    def __init__(self, params: Any, *, jets: Jets, method: Detector = faults.DETECTOR):
        super().__init__()
        self.set_name(method.group)
        self._params, self._jets, self._method = params, jets, method
        n_jets = jets.thrusts.size
        self._reconfiguration = RECONFIGURATION.sized(jets=n_jets)
        self._logged = DETECTOR_REPORT.sized(jets=n_jets)
        self._report = HYPOTHESIS_REPORT.sized(jets=n_jets)
        self._evidence = self.DeclareAbstractInputPort("evidence", Value[object](NOTHING))
        start = Memory(method.initial(params), None, -np.inf)
        self._memory = self.DeclareAbstractState(Value[object](start))
        read = {self.xa_ticket(), self.time_ticket(), self.all_input_ports_ticket()}
        self._judgment = Cached(self, "judgment", self._judge, read)
        judged = {self._judgment.ticket}
        for name, of_state in (("replacement", self._calc_replacement), ("published", self._calc_published)):
            self.DeclareAbstractOutputPort(
                name, alloc=lambda: Value[object](NOTHING), calc=of_state, prerequisites_of_calc=judged
            )
        for name, size, calc in (
            ("reconfiguration", self._reconfiguration.size, self._calc_reconfiguration),
            ("closed", n_jets, self._calc_closed),
            ("report", self._logged.size, self._calc_report),
            ("hypothesis_report", self._report.size, self._calc_hypotheses),
            ("fault_probability", n_jets + 2, self._calc_probability),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=judged)
        self.DeclareVectorOutputPort(
            "held_closed", n_jets, self._calc_held_closed, prerequisites_of_calc={self.xa_ticket()}
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=jets.period_s, offset_sec=0.0, update=self._update)

    def kept(self, context: Any) -> Array:
        """The state as a vector, see `maths.estimation.detector.Detector`."""
        return self._method.kept(self._remembered(context).state, self._params)

    def _remembered(self, context: Any) -> Memory:
        memory: Memory = context.get_abstract_state(self._memory).get_value()
        return memory

    def _judge(self, context: Any) -> Memory:
        memory, time_s = self._remembered(context), context.get_time()
        if memory.judgment is not None and memory.time_s == time_s:
            return memory
        evidence = self._evidence.Eval(context)
        judgment = timed(DETECTOR, self._method.judge, memory.state, evidence, self._params)
        return Memory(memory.state, judgment, time_s)

    def _judged(self, context: Any) -> Judgment:
        judgment: Judgment = self._judgment.get(context).judgment
        return judgment

    def _calc_replacement(self, context: Any, output: Any) -> None:
        replacement = self._judged(context).replacement
        output.set_value(NOTHING if replacement is None else replacement)

    def _calc_published(self, context: Any, output: Any) -> None:
        published = self._judged(context).published
        output.set_value(NOTHING if published is None else published)

    def _calc_reconfiguration(self, context: Any, output: Any) -> None:
        judgment = self._judged(context)
        declared = judgment.status.detector_event == Event.DECLARED
        wrench = judgment.state.force @ self._jets.unit_wrenches
        output.SetFromVector(self._reconfiguration.pack((declared, wrench, judgment.state.removed)))

    def _calc_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._judged(context).state.closed)

    def _calc_held_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._remembered(context).state.closed)

    def _calc_report(self, context: Any, output: Any) -> None:
        before, judgment, _ = self._judgment.get(context)
        output.SetFromVector(detector_row(judgment, before, self._logged))

    def _calc_hypotheses(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._report.pack(self._judged(context).own))

    def _calc_probability(self, context: Any, output: Any) -> None:
        own = self._judged(context).own
        jets = np.broadcast_to(own.fault_probability, self._jets.thrusts.shape)
        output.SetFromVector(np.append(jets, (own.none_probability, own.unknown_probability)))

    def _update(self, context: Any, state: Any) -> None:
        state.get_mutable_abstract_state(self._memory).set_value(self._judgment.get(context))
