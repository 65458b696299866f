"""Detection and isolation of failed jets."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation import adaptation, estimation_ports
from massprop_drake.maths.estimation.cycle import make_evidence
from massprop_drake.maths.estimation.detector import Detector, Judgment, KnownJets, Verdict
from massprop_drake.maths.estimation.detectors import cglr
from massprop_drake.maths.estimation.filter import NOT_MEASURED
from massprop_drake.maths.kernels import compile_kernel as compiled_form
from massprop_drake.maths.kernels import make_holder
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.systems.caching import Cached, Part, declare_output, declare_outputs, declare_update, state_of
from massprop_drake.systems.layouts import (
    ADAPTATION,
    DETECTOR_REPORT,
    EVIDENCE,
    IMPULSES,
    KNOWN_FORCE,
    RECONFIGURATION,
    detector_row,
)
from massprop_drake.systems.stopwatch import DETECTOR, time_call

_NO_KNOWN_FORCE = np.zeros(KNOWN_FORCE.size)
_NOT_MEASURED, _USABLE = EVIDENCE.pack(NOT_MEASURED), IMPULSES.slice("usable").start
_NO_ADAPTATION = adaptation.pack_adaptation(adaptation.NO_ADAPTATION)


class FailureDetector(LeafSystem):
    r"""Finds failed jets from the innovations of the filters, and the adaptation that the filters need.

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
        compiled: whether its kernels are, where the method is `cglr`.
    """

    def __init__(self, detector: Detector, params: Any, *, jets: KnownJets, compiled: bool = False):
        super().__init__()
        self.set_name("failure_detector")
        self._detector = detector
        self._params = params
        self._jets = jets
        n_jets = jets.thrusts.size
        self._reconfiguration = RECONFIGURATION.sized(jets=n_jets)
        self._report_layout = DETECTOR_REPORT.sized(jets=n_jets)

        self._command = self.DeclareVectorInputPort("jet_commands", n_jets)
        self._impulses = self.DeclareVectorInputPort("impulses", IMPULSES.size)
        self._evidence = self.DeclareVectorInputPort("evidence", EVIDENCE.size)
        self._predicted = self.DeclareVectorInputPort("predicted", 10)
        initial = detector.initial(params)
        self._state_of = type(initial)
        assert detector.layout is not None, "a state that is no vector needs a system of its own"
        self._layout = detector.layout(params)
        self._variance, removed, self._closed = map(self._layout.slice, ("variance", "removed", "closed"))
        self.DeclareDiscreteState(self._layout.pack(initial))
        self._compiled = compiled and detector is cglr.DETECTOR
        if self._compiled:
            self._kernel = compiled_form(estimation_ports.run_detector)
            self._known_force_kernel = compiled_form(estimation_ports.known_force)
            self._held = make_holder(estimation_ports.make_detector(params), compile_it=True)

        tickets = {self.xd_ticket(), self.all_input_ports_ticket(), self.time_ticket()}
        judgment = Cached(self, "judgment", self._judge, tickets)
        # known forces enter the impulses, which make the innovations: of this sample they know the commands alone
        known = {self.xd_ticket(), self._predicted.ticket(), self._command.ticket()}
        declare_output(self, "known_force", KNOWN_FORCE.size, self._calc_known_force, known)
        # of the row that `_judge` gives
        adapted, state_start = ADAPTATION.size, ADAPTATION.size + self._reconfiguration.slice("removed").start
        state_slice = slice(state_start, state_start + self._layout.size)
        reconfiguration_slice = slice(adapted, state_start)
        outputs: list[tuple[str, int, Part]] = [
            ("adaptation", adapted, slice(0, adapted)),
            (
                "reconfiguration",
                self._reconfiguration.size,
                lambda row: np.concatenate((row[reconfiguration_slice], row[state_slice][removed])),
            ),
            ("closed", n_jets, lambda row: row[state_slice][self._closed]),
            ("report", self._report_layout.size, slice(state_slice.stop, None)),
        ]
        declare_outputs(self, judgment, outputs)
        held = {self.xd_ticket()}
        declare_output(self, "held_closed", n_jets, lambda context: state_of(context)[self._closed], held)
        declare_update(self, judgment, jets.period_s, state_slice)

    def _state(self, vector: Array) -> Any:
        """Converts the state vector to the detector's named tuple."""
        return self._state_of._make(self._layout.read(vector))

    def _judge(self, context: Any) -> Array:
        """Runs the detector on a sample; returns its packed result, see `estimation_ports.run_detector`."""
        vector, command, impulse_row = state_of(context), self._command.Eval(context), self._impulses.Eval(context)
        # a sample that is not steady is not looked at, so that nothing need be gathered
        seen = self._evidence.Eval(context) if impulse_row[_USABLE] else _NOT_MEASURED
        time_s = context.get_time()
        if self._compiled:
            row: Array = time_call(DETECTOR, self._kernel, vector, time_s, command, impulse_row, seen, self._held)
            return row
        before, impulses = self._state(vector), IMPULSES.read(impulse_row)
        evidence = make_evidence(time_s, command, impulses, EVIDENCE.read(seen) if impulses.usable else NOT_MEASURED)
        judgment: Judgment = time_call(DETECTOR, self._detector.judge, before, evidence, self._params)
        state, requested = judgment.state, judgment.adaptation
        return np.concatenate(
            (
                _NO_ADAPTATION if requested is adaptation.NO_ADAPTATION else adaptation.pack_adaptation(requested),
                (judgment.status.detector_event == Verdict.DECLARED,),
                state.force @ self._jets.unit_wrenches,
                vector if state is before else self._layout.pack(state),
                detector_row(judgment, before, self._report_layout),
            )
        )

    def _calc_known_force(self, context: Any) -> Any:
        """Computes the effect of known forces on the sample's innovations, packed as `KNOWN_FORCE`."""
        vector = state_of(context)
        if not has_nonzero(vector[self._variance]):
            return _NO_KNOWN_FORCE
        predicted, command = self._predicted.Eval(context), self._command.Eval(context)
        if self._compiled:
            return self._known_force_kernel(vector, predicted, command, self._held)
        known = self._detector.known_force(self._state(vector), predicted, command, self._params)
        return KNOWN_FORCE.pack(known)
