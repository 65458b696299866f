"""Detects and isolates failed jets."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation import adaptation
from massprop_drake.maths.estimation.cycle import evidence_of
from massprop_drake.maths.estimation.detector import Detector, Event, Jets, Judgment
from massprop_drake.maths.estimation.filter import NOT_MEASURED
from massprop_drake.maths.linear_algebra import Array, nonzero
from massprop_drake.systems.caching import Cached, Stopwatch
from massprop_drake.systems.layouts import (
    ADAPTATION,
    DETECTOR_REPORT,
    EVIDENCE,
    IMPULSES,
    KNOWN_FORCE,
    RECONFIGURATION,
    detector_row,
)

_NO_KNOWN_FORCE = np.zeros(KNOWN_FORCE.size)
_NO_ADAPTATION = adaptation.packed(adaptation.NO_ADAPTATION)


class FailureDetector(LeafSystem):
    r"""Finds failed jets from the innovations of the filters, and what the filters are to do about them.

    Whatever the method: see `massprop_drake.maths.estimation.detectors`, `cglr` for the thesis's constrained
    generalized likelihood ratio.

    Ports:
        jet_commands (in, n_jets): fraction commanded over the interval that ends now. Required.
        impulses (in, 8): see `ImpulseModel`. Required.
        evidence (in, 213), predicted (in, 10): see `MassEstimator`. Required.
        known_force (out, 24): packed as `layouts.KNOWN_FORCE`: wrench about the vehicle origin (6) of the known
            forces of failed jets, and what their uncertainty adds to the covariances of the velocity (9) and rate
            (9) increments. No feedthrough from innovations.
        adaptation (out, 26): packed as `layouts.ADAPTATION`, see `maths.estimation.adaptation`.
        reconfiguration (out, 7 + n_jets): packed as `layouts.RECONFIGURATION`: 1 when a failure is declared at this
            sample; wrench of the known forces from now on (6); 1 for each jet to be taken out of use.
        closed (out, n_jets): 1 for each jet whose manifold is closed from now on.
        held_closed (out, n_jets): the same up to now. No feedthrough.
        report (out, 14 + 4 n_jets): packed as `layouts.DETECTOR_REPORT`, for logs: the fields of
            `maths.estimation.detector.STATUS`; statistic and estimated magnitude of every jet, NaN where the sample
            was not tested; known force of every jet before this sample, lbf or N, and its variance.

    State: memory, of the size and the fields that the method says; 10 + 4 n_jets for `cglr`.

    Timing: outputs at t_k judge the interval [t_k-1, t_k) with predictions made before it.

    Assumptions and limitations: one jet fails at a time; a failure below the sensors' resolution, or one
    whose effect another jet's failure could have as well, is not told from it.

    Args:
        detector: the method.
        params: its parameters.
        jets: see `maths.estimation.detector.Jets`.
    """

    def __init__(self, detector: Detector, params: Any, *, jets: Jets):
        super().__init__()
        self.set_name("failure_detector")
        self._detector = detector
        self._params = params
        self._jets = jets
        n_jets = jets.thrusts.size
        self._reconfiguration = RECONFIGURATION.sized(jets=n_jets)
        self.stopwatch = Stopwatch()

        self._command = self.DeclareVectorInputPort("jet_commands", n_jets)
        self._impulses = self.DeclareVectorInputPort("impulses", IMPULSES.size)
        self._evidence = self.DeclareVectorInputPort("evidence", EVIDENCE.size)
        self._predicted = self.DeclareVectorInputPort("predicted", 10)
        initial = detector.initial(params)
        self._state_of = type(initial)
        assert detector.layout is not None, "a state that is no vector needs a system of its own"
        self._layout = detector.layout(params)
        self._variance = self._layout.slice("variance")
        self._memory = self.DeclareDiscreteState(self._layout.pack(initial))

        self._judgment = Cached(
            self, "judgment", self._judge, {self.xd_ticket(), self.all_input_ports_ticket(), self.time_ticket()}
        )
        # known forces enter the impulses, which make the innovations: of this sample they know the commands alone
        predictions = {self.input_port_ticket(port.get_index()) for port in (self._predicted, self._command)}
        self.DeclareVectorOutputPort(
            "known_force",
            KNOWN_FORCE.size,
            self._calc_known_force,
            prerequisites_of_calc={self.xd_ticket(), *predictions},
        )
        for name, size, calc in (
            ("adaptation", ADAPTATION.size, self._calc_adaptation),
            ("reconfiguration", self._reconfiguration.size, self._calc_reconfiguration),
            ("closed", n_jets, self._calc_closed),
            ("report", DETECTOR_REPORT.sized(jets=n_jets).size, self._calc_report),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._judgment.ticket})
        self.DeclareVectorOutputPort(
            "held_closed", n_jets, self._calc_held_closed, prerequisites_of_calc={self.xd_ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=jets.period_s, offset_sec=0.0, update=self._update)

    def _packed(self, context: Any) -> Array:
        vector: Array = context.get_discrete_state(self._memory).CopyToVector()
        return vector

    def _state(self, context: Any) -> Any:
        return self._state_of._make(self._layout.read(self._packed(context)))

    def _judge(self, context: Any) -> tuple[Judgment, Any]:
        """What the method makes of the sample, and the state before."""
        impulses = IMPULSES.read(self._impulses.Eval(context))
        # a sample that is not steady is not looked at, so that nothing need be unpacked
        seen = EVIDENCE.read(self._evidence.Eval(context)) if impulses.usable else NOT_MEASURED
        evidence = evidence_of(context.get_time(), self._command.Eval(context), impulses, seen)
        state = self._state(context)
        judgment: Judgment = self.stopwatch.measure(self._detector.judge, state, evidence, self._params)
        return judgment, state

    def _judged(self, context: Any) -> Judgment:
        judgment: Judgment
        judgment, _ = self._judgment.get(self, context)
        return judgment

    def _calc_known_force(self, context: Any, output: Any) -> None:
        if not nonzero(self._packed(context)[self._variance]):
            output.SetFromVector(_NO_KNOWN_FORCE)
            return
        predicted, command = self._predicted.Eval(context), self._command.Eval(context)
        known = self._detector.known_force(self._state(context), predicted, command, self._params)
        output.SetFromVector(KNOWN_FORCE.pack(known))

    def _calc_adaptation(self, context: Any, output: Any) -> None:
        todo = self._judged(context).adaptation
        output.SetFromVector(_NO_ADAPTATION if todo is adaptation.NO_ADAPTATION else adaptation.packed(todo))

    def _calc_reconfiguration(self, context: Any, output: Any) -> None:
        judgment = self._judged(context)
        declared = judgment.status.detector_event == Event.DECLARED
        wrench = judgment.state.force @ self._jets.unit_wrenches
        output.SetFromVector(self._reconfiguration.pack((declared, wrench, judgment.state.removed)))

    def _calc_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._judged(context).state.closed)

    def _calc_held_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._state(context).closed)

    def _calc_report(self, context: Any, output: Any) -> None:
        output.SetFromVector(detector_row(*self._judgment.get(self, context)))

    def _update(self, context: Any, state: Any) -> None:
        judgment, before = self._judgment.get(self, context)
        if judgment.state is not before:  # else it stays as it is
            state.set_value(self._memory, self._layout.pack(judgment.state))
