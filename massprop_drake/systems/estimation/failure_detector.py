"""Detects and isolates failed jets."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation import adaptation
from massprop_drake.maths.estimation.detectors import cglr as detection
from massprop_drake.maths.estimation.detectors.cglr import (
    DECLARED,
    N_KNOWN_FORCE,
    CglrParams,
    DetectorCycle,
    DetectorState,
)
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.systems.caching import Cached, Stopwatch
from massprop_drake.systems.estimation.impulse_model import N_IMPULSES

Array = NDArray[np.float64]

N_STATUS = 14
_NO_KNOWN_FORCE = np.zeros(N_KNOWN_FORCE)
_NO_ADAPTATION = adaptation.packed(adaptation.NO_ADAPTATION)


class FailureDetector(LeafSystem):
    r"""Finds failed jets from the innovations of both filters, and what the filters are to do about them.

    The constrained generalized likelihood ratio of one sample, the two-step isolation by the margin of
    six, and the count of alarms that declares a failure; see `massprop_drake.maths.estimation.detectors.jet_tests` and
    `massprop_drake.maths.estimation.detectors.cglr`.

    Ports:
        jet_commands (in, n_jets): fraction commanded over the interval that ends now. Required.
        impulses (in, 8): see `ImpulseModel`. Required.
        rotation_judged (in, 12), predicted_estimate (in, 9), predicted_covariance (in, 81): see
            `RotationEstimator`. Required.
        mass_judged (in, 12), mass_predicted (in, at least 2): see `MassEstimator`. Required.
        rotation_effects (in, 3 n_jets), mass_effects (in, 3 n_jets): `thrust_error_effects` of both.
            Unconnected: no thrust error is considered.
        known_force (out, 24): wrench about the vehicle origin (6) of the known forces of failed jets, and
            what their uncertainty adds to the covariances of the velocity (9) and rate (9) increments. No
            feedthrough from innovations.
        adaptation (out, 26): see `maths.adaptation`.
        reconfiguration (out, 7 + n_jets): 1 when a failure is declared at this sample; wrench of the
            known forces from now on (6); 1 for each jet to be taken out of use.
        closed (out, n_jets): 1 for each jet whose manifold is closed from now on.
        held_closed (out, n_jets): the same up to now. No feedthrough.
        status (out, 14): tested; alarm; event (0 none, 1 declared, 2 jump, 3 withdrawn); index of the
            likeliest jet's cluster; its index; 1 when the alarm names the jet; its magnitude and 1-sigma,
            lbf or N; its likelihood argument; margins of the cluster and of the jet; what it leaves
            unexplained; onset, s; alarms in a row.
        likelihood (out, n_jets): argument of every jet, NaN where the sample was not tested.
        magnitude (out, n_jets): estimated magnitude of every jet, lbf or N, likewise.
        report (out, 14 + 2 n_jets): status, likelihood and magnitude in one, for logs.
        memory (out, 10 + 4 n_jets): the state. No feedthrough.

    State: memory (10 + 4 n_jets): see `maths.detection.packed`.

    Timing: outputs at t_k judge the interval [t_k-1, t_k) with predictions made before it.

    Assumptions and limitations: one jet fails at a time; a failure below the sensors' resolution, or one
    whose effect another jet's failure could have as well, is not told from it.

    Args:
        params: see `maths.detection.CglrParams`.
        limits: of convergence, see `maths.mass_properties.converged`, shape (3,).
        mass_size: length of `mass_predicted`.
    """

    def __init__(self, params: CglrParams, *, limits: Array, mass_size: int):
        super().__init__()
        self.set_name("failure_detector")
        n_jets = self._n_jets = params.clusters.size
        self._params = params
        self._limits = limits
        self.stopwatch = Stopwatch()

        self._command = self.DeclareVectorInputPort("jet_commands", n_jets)
        self._impulses = self.DeclareVectorInputPort("impulses", N_IMPULSES)
        self._rotation = self.DeclareVectorInputPort("rotation_judged", 12)
        self._predicted = self.DeclareVectorInputPort("predicted_estimate", N_ROTATION)
        self._predicted_covariance = self.DeclareVectorInputPort("predicted_covariance", N_ROTATION**2)
        self._mass = self.DeclareVectorInputPort("mass_judged", 12)
        self._mass_predicted = self.DeclareVectorInputPort("mass_predicted", mass_size)
        self._effects = [self.DeclareVectorInputPort(f"{name}_effects", 3 * n_jets) for name in ("mass", "rotation")]
        self._memory = self.DeclareDiscreteState(detection.packed(detection.initial_state(n_jets)))

        self._cycle = Cached(
            self, "cycle", self._compute, {self.xd_ticket(), self.all_input_ports_ticket(), self.time_ticket()}
        )
        # known forces enter the impulses, which make the innovations: of this sample they know the commands alone
        predictions = (self._predicted, self._mass_predicted, self._command)
        self.DeclareVectorOutputPort(
            "known_force",
            N_KNOWN_FORCE,
            self._calc_known_force,
            prerequisites_of_calc={
                self.xd_ticket(),
                *(self.input_port_ticket(port.get_index()) for port in predictions),
            },
        )
        for name, size, calc in (
            ("adaptation", adaptation.N_ADAPTATION, self._calc_adaptation),
            ("reconfiguration", 7 + n_jets, self._calc_reconfiguration),
            ("closed", n_jets, self._calc_closed),
            ("status", N_STATUS, self._calc_status),
            ("likelihood", n_jets, self._calc_likelihood),
            ("magnitude", n_jets, self._calc_magnitude),
            ("report", N_STATUS + 2 * n_jets, self._calc_report),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._cycle.ticket})
        self.DeclareVectorOutputPort(
            "held_closed", n_jets, self._calc_held_closed, prerequisites_of_calc={self.xd_ticket()}
        )
        self.DeclareStateOutputPort("memory", self._memory)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=params.period_s, offset_sec=0.0, update=self._update)

    def _state(self, context: Any) -> DetectorState:
        return detection.unpacked(context.get_discrete_state(self._memory).CopyToVector(), self._n_jets)

    def _compute(self, context: Any) -> DetectorCycle:
        impulses = self._impulses.Eval(context)
        mass = self._mass_predicted.Eval(context)
        translation, rotation = self._mass.Eval(context), self._rotation.Eval(context)
        shared = None
        if all(port.HasValue(context) for port in self._effects):
            shared = detection.shared_covariance(*(port.Eval(context).reshape(3, -1) for port in self._effects))
        return self.stopwatch.measure(
            detection.judged,
            self._state(context),
            context.get_time(),
            self._command.Eval(context),
            impulses[6] != 0.0,
            impulses[7] != 0.0,
            translation[:3],
            rotation[:3],
            translation[3:].reshape(3, 3),
            rotation[3:].reshape(3, 3),
            self._predicted.Eval(context),
            self._predicted_covariance.Eval(context).reshape(N_ROTATION, N_ROTATION),
            mass,
            self._limits,
            self._params,
            shared,
        )

    def _calc_known_force(self, context: Any, output: Any) -> None:
        state = self._state(context)
        if not state.variance.any():
            output.SetFromVector(_NO_KNOWN_FORCE)
            return
        estimate = np.append(self._predicted.Eval(context), self._mass_predicted.Eval(context)[0])
        known = detection.known_force(state, estimate, self._command.Eval(context), self._params)
        output.SetFromVector(
            np.concatenate([known.wrench, known.translation_spread.ravel(), known.rotation_spread.ravel()])
        )

    def _calc_adaptation(self, context: Any, output: Any) -> None:
        todo = self._cycle.get(self, context).adaptation
        output.SetFromVector(_NO_ADAPTATION if todo is adaptation.NO_ADAPTATION else adaptation.packed(todo))

    def _calc_reconfiguration(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        wrench = cycle.state.force @ self._params.unit_wrenches
        declared = cycle.finding.event == DECLARED
        output.SetFromVector(np.concatenate([[declared], wrench, cycle.state.removed]))

    def _calc_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).state.closed)

    def _calc_held_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._state(context).closed)

    def _calc_status(self, context: Any, output: Any) -> None:
        output.SetFromVector(detection.status(self._cycle.get(self, context)))

    def _calc_likelihood(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).tests.likelihood)

    def _calc_magnitude(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).tests.magnitude)

    def _calc_report(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        output.SetFromVector(np.concatenate([detection.status(cycle), cycle.tests.likelihood, cycle.tests.magnitude]))

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._memory, detection.packed(self._cycle.get(self, context).state))
