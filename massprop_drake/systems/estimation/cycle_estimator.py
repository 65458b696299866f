"""Estimation of all ten mass properties and detection of failures, whole cycles in one system."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample
from massprop_drake.maths.estimation.detector import Judgment, KnownJets, Verdict
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import converged_rows
from massprop_drake.systems.caching import Cached
from massprop_drake.systems.estimation._readings import KnownPackage, Readings
from massprop_drake.systems.layouts import (
    DETECTOR_REPORT,
    IMPULSES,
    MASS_REPORT,
    RECONFIGURATION,
    ROTATION_REPORT,
    detector_row,
    impulse_row,
)
from massprop_drake.systems.stopwatch import timed


class Memory(NamedTuple):
    """Memory of the system, which is never changed: a cycle makes a new one.

    Attributes:
        before: state before the newest sample.
        step: its cycle; None: there has been none.
        time_s: of that sample.
    """

    before: EstimationState
    step: EstimationStep | None
    time_s: float

    @property
    def state(self) -> EstimationState:
        """State after the cycle."""
        return self.before if self.step is None else self.step.state

    def __deepcopy__(self, _memo: Any) -> Memory:
        """Returns itself: a clone of a context shares what is never changed."""
        return self


class CycleEstimator(LeafSystem):
    r"""A filter and its detector of any method, see `massprop_drake.maths.estimation.cycle`.

    Ports:
        <gyro> (in, 3), <accelerometer> (in, 3), one per package: rates, rad/s, and integrated specific force, ft/s or
            m/s, body axes. The first of each kind is required; of the others one that is not connected is missing.
        <pose> (in, 7), <velocity> (in, 3), one per sensor in a fixed frame: as `PoseTracker` and `VelocityTracker`
            read, NaN where nothing is read; one that is not connected reads nothing.
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, NaN where not known. Required.
        outside_wrench (in, 6): known outside torque about the vehicle origin and force, mean over that interval.
            Unconnected: none.
        record_time (in, 1): when the readings were taken, s. Unconnected: now.
        command (in, n_jets): fraction commanded from now on, which matters where readings are taken after their tick.
            Unconnected: not known.
        held_command_onset (in, n_jets), command_onset (in, n_jets), where jets open within a sample: how long after the
            beginning of the interval that ends now, and of the coming one, each jet opens, s, see
            `maths.vehicle.on_times`. Unconnected: as the vehicle's `jet_commands` say.
        estimate (out, 10), standard_deviation (out, 10), covariance (out, 100), converged (out, 1): of the ten
            parameters after this sample, NaN for what has no sigma; see `ConvergenceMonitor`.
        predicted (out, 10): the ten parameters before this sample. No feedthrough.
        impulses (out, 8): see `ImpulseModel`.
        rotation_report (out, 28), mass_report (out, 11): see `RotationEstimator` and `MassEstimator`. A filter of
            several packages gives the innovation of the first, and NIS of all components, scaled to three.
        <report> (out): fields of the filter's own `report`, for logs, such as `joint_report` (3) and `pose_report`
            (24 + 2 n_jets).
        reconfiguration (out, 7 + n_jets), closed (out, n_jets), held_closed (out, n_jets), detector_report (out, 14 +
            4 n_jets), with a detector: see `FailureDetector`.
        hypothesis_report (out, 21 + 12 n_jets), with a detector by hypotheses: packed as `layouts.HYPOTHESIS_REPORT`,
            for logs: what is said of jumps and readings; and of every jet, as `faults.declarations.Word`, with force,
            its 1-sigma and onset, which of the things said name it, and what would tell its group apart.
        fault_probability (out, n_jets + 2), likewise: posterior probability that each jet has failed, then that nothing
            has failed or changed, and that something unknown pushes; NaN of a method that gives none.

    State: abstract, `Memory`: filter and hypotheses are tuples that are never changed, so that a cycle shares all but
    the newest with the one before, and so does a clone of the context.

    Timing: outputs at t_k use the readings at t_k and the commands of [t_k-1, t_k). Drake updates abstract state before
    the discrete state of other systems at the same instant: the state therefore holds the newest cycle with its time,
    and outputs at that time are taken from it.

    Args:
        params: of the cycle.
        jets: see `maths.estimation.detector.Jets`.
        gyros, accelerometers: packages, the preferred one first.
        tracked: size of the reading of each sensor in a fixed frame, by its name, in the vehicle's order.
        weighs: whether anything read shows the mass, so that there is a `mass_report`.
        known: the ten parameters that are known beforehand, see `maths.mass_properties.converged_rows`.
        within: whether jets open within a sample.
    """

    def __init__(
        self,
        params: EstimationParams,
        *,
        jets: KnownJets,
        gyros: tuple[KnownPackage, ...],
        accelerometers: tuple[KnownPackage, ...],
        tracked: Mapping[str, int],
        weighs: bool,
        known: NDArray[np.bool_],
        within: bool = False,
    ):
        super().__init__()
        self.set_name("estimator")
        self._params, self._jets, self._known = params, jets, known
        n_jets = jets.thrusts.size
        self._gyros, self._accelerometers = Readings(self, gyros), Readings(self, accelerometers)
        self._tracked = [self.DeclareVectorInputPort(name, size) for name, size in tracked.items()]
        self._command = self.DeclareVectorInputPort("jet_commands", n_jets)
        self._outside = self.DeclareVectorInputPort("outside_wrench", 6)
        self._stamp = self.DeclareVectorInputPort("record_time", 1)
        self._coming = self.DeclareVectorInputPort("command", n_jets)
        names = ("held_command_onset", "command_onset") if within else ()
        self._onsets = [self.DeclareVectorInputPort(name, n_jets) for name in names]
        start = Memory(cycle.initial_state(params), None, -math.inf)
        self._memory = self.DeclareAbstractState(Value[object](start))
        read = {self.xa_ticket(), self.time_ticket(), self.all_input_ports_ticket()}
        self._cycle = Cached(self, "cycle", self._cycled, read)

        before: dict[str, tuple[int, Any]] = {"predicted": (10, self._calc_predicted)}
        after: dict[str, tuple[int, Any]] = {
            "estimate": (10, self._calc_estimate),
            "standard_deviation": (10, self._calc_deviation),
            "covariance": (100, self._calc_covariance),
            "converged": (1, self._calc_converged),
            IMPULSES.name: (IMPULSES.size, self._calc_impulses),
            ROTATION_REPORT.name: (ROTATION_REPORT.size, self._calc_rotation),
        }
        if weighs:
            after[MASS_REPORT.name] = MASS_REPORT.size, self._calc_mass
        if params.filter.report is not None:
            self._own = params.filter.report.sized(jets=n_jets)
            after[self._own.name] = self._own.size, self._calc_own
        detector = params.detector
        if detector is not None:
            self._reconfiguration = RECONFIGURATION.sized(jets=n_jets)
            self._logged = DETECTOR_REPORT.sized(jets=n_jets)
            before["held_closed"] = n_jets, self._calc_held_closed
            after[RECONFIGURATION.name] = self._reconfiguration.size, self._calc_reconfiguration
            after["closed"] = n_jets, self._calc_closed
            after[DETECTOR_REPORT.name] = self._logged.size, self._calc_detector
        if detector is not None and detector.report is not None:
            self._said = detector.report.sized(jets=n_jets)
            after[self._said.name] = self._said.size, self._calc_said
            after["fault_probability"] = n_jets + 2, self._calc_probability
        for ports, ticket in ((before, self.xa_ticket()), (after, self._cycle.ticket)):
            for name, (size, calc) in ports.items():
                self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={ticket})
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=params.period_s, offset_sec=0.0, update=self._update)

    def kept(self, context: Any) -> dict[str, Array]:
        """Packs the state into vectors, see `maths.estimation.cycle.saved`."""
        return dict(cycle.saved(self._remembered(context).state, self._params))

    # ------------------------------------------------------------------------------------------- the cycle

    def _remembered(self, context: Any) -> Memory:
        memory: Memory = context.get_abstract_state(self._memory).get_value()
        return memory

    def _sample(self, context: Any) -> Sample:
        """Reads the input ports."""

        def given(port: Any) -> Array | None:
            return port.Eval(context).copy() if port.HasValue(context) else None

        def read(port: Any) -> Array:
            row: Array = port.Eval(context) if port.HasValue(context) else np.full(port.size(), np.nan)
            return row

        stamp = given(self._stamp)
        return Sample(
            context.get_time(),
            self._gyros.eval(context),
            self._accelerometers.eval(context),
            self._command.Eval(context).copy(),
            given(self._outside),
            None if stamp is None else float(stamp[0]),
            given(self._coming),
            np.concatenate([read(port) for port in self._tracked]) if self._tracked else None,
            *map(given, self._onsets),
        )

    def _cycled(self, context: Any) -> Memory:
        """Computes the cycle of the present time."""
        memory, time_s = self._remembered(context), context.get_time()
        if memory.step is not None and memory.time_s == time_s:
            return memory
        step = cycle.step(memory.state, self._sample(context), self._params, timed)
        return Memory(memory.state, step, time_s)

    def _update(self, context: Any, state: Any) -> None:
        state.get_mutable_abstract_state(self._memory).set_value(self._cycle.get(context))

    def _step(self, context: Any) -> EstimationStep:
        step: EstimationStep = self._cycle.get(context).step
        return step

    def _judged(self, context: Any) -> Judgment:
        judgment = self._step(context).judgment
        assert judgment is not None
        return judgment

    # ------------------------------------------------------------------------------------------- outputs

    def _known_now(self, context: Any) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the cycle."""
        step = self._step(context)
        return step.filtered.known or cycle.known(step.state, self._params)

    def _calc_predicted(self, context: Any, output: Any) -> None:
        memory = self._remembered(context)
        known = memory.before if memory.time_s == context.get_time() else memory.state
        output.SetFromVector(self._params.filter.predicted(known.filter))

    def _calc_estimate(self, context: Any, output: Any) -> None:
        estimate, _ = self._known_now(context)
        output.SetFromVector(estimate)

    def _calc_deviation(self, context: Any, output: Any) -> None:
        _, covariance = self._known_now(context)
        output.SetFromVector(np.sqrt(covariance.diagonal()))

    def _calc_covariance(self, context: Any, output: Any) -> None:
        _, covariance = self._known_now(context)
        output.SetFromVector(covariance.ravel())

    def _calc_converged(self, context: Any, output: Any) -> None:
        estimate, covariance = self._known_now(context)
        deviation = np.sqrt(covariance.diagonal())
        good = converged_rows(deviation[None], estimate[None], self._params.limits, self._known)
        output.SetFromVector(good.astype(float))

    def _calc_impulses(self, context: Any, output: Any) -> None:
        output.SetFromVector(impulse_row(self._step(context).interval.impulses))

    def _calc_rotation(self, context: Any, output: Any) -> None:
        output.SetFromVector(ROTATION_REPORT.pack(self._step(context).filtered.rotation))

    def _calc_mass(self, context: Any, output: Any) -> None:
        report = self._step(context).filtered.mass
        output.SetFromVector(np.full(MASS_REPORT.size, np.nan) if report is None else MASS_REPORT.pack(report))

    def _calc_own(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._own.pack(self._step(context).filtered.own))

    def _calc_reconfiguration(self, context: Any, output: Any) -> None:
        judgment = self._judged(context)
        declared = judgment.status.detector_event == Verdict.DECLARED
        wrench = judgment.state.force @ self._jets.unit_wrenches
        output.SetFromVector(self._reconfiguration.pack((declared, wrench, judgment.state.removed)))

    def _calc_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._judged(context).state.closed)

    def _calc_held_closed(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._remembered(context).state.detector.closed)

    def _calc_detector(self, context: Any, output: Any) -> None:
        before = self._cycle.get(context).before.detector
        output.SetFromVector(detector_row(self._judged(context), before, self._logged))

    def _calc_said(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._said.pack(self._judged(context).own))

    def _calc_probability(self, context: Any, output: Any) -> None:
        own = self._judged(context).own
        jets = np.broadcast_to(own.fault_probability, self._jets.thrusts.shape)
        output.SetFromVector(np.append(jets, (own.none_probability, own.unknown_probability)))
