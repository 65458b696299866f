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
from massprop_drake.maths.estimation.detector import Detector, Judgment, KnownJets, Verdict
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import are_converged
from massprop_drake.systems.caching import Cached, declare_output, declare_outputs
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
from massprop_drake.systems.stopwatch import time_call


class Memory(NamedTuple):
    """Memory of the system, which is never changed: a cycle makes a new one.

    Attributes:
        before: state before the newest sample.
        step: its cycle; None: there has been none.
        time_s: of that sample.
        stamp_s: when its readings were taken, see `Sample`; None: at that time.
    """

    before: EstimationState
    step: EstimationStep | None
    time_s: float
    stamp_s: float | None = None

    @property
    def state(self) -> EstimationState:
        """State of filter and detector after the cycle."""
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
    and outputs at that time are taken from it, and so they are until `record_time` goes on.

    Args:
        params: of the cycle.
        jets: see `maths.estimation.detector.Jets`.
        gyros, accelerometers: packages, the preferred one first.
        tracked: size of the reading of each sensor in a fixed frame, by its name, in the vehicle's order.
        weighs: whether anything read shows the mass, so that there is a `mass_report`.
        known: the ten parameters that are known beforehand, see `maths.mass_properties.are_converged`.
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
        self._next_command = self.DeclareVectorInputPort("command", n_jets)
        names = ("held_command_onset", "command_onset") if within else ()
        self._onsets = [self.DeclareVectorInputPort(name, n_jets) for name in names]
        start = Memory(cycle.initial_state(params), None, -math.inf)
        self._memory = self.DeclareAbstractState(Value[object](start))
        read = {self.xa_ticket(), self.time_ticket(), self.all_input_ports_ticket()}
        self._cycle = Cached(self, "cycle", self._run_cycle, read)

        outputs: list[tuple[str, int, Any]] = [
            ("estimate", 10, lambda now: self._estimate_and_covariance(now)[0]),
            ("standard_deviation", 10, lambda now: np.sqrt(self._covariance(now).diagonal())),
            ("covariance", 100, lambda now: self._covariance(now).ravel()),
            ("converged", 1, self._converged),
            (IMPULSES.name, IMPULSES.size, lambda now: impulse_row(now.step.interval.impulses)),
            (ROTATION_REPORT.name, ROTATION_REPORT.size, lambda now: ROTATION_REPORT.pack(now.step.filtered.rotation)),
        ]
        if weighs:
            outputs.append((MASS_REPORT.name, MASS_REPORT.size, _mass_report))
        if params.filter.report is not None:
            own = params.filter.report.sized(jets=n_jets)
            outputs.append((own.name, own.size, lambda now: own.pack(now.step.filtered.own)))
        before: list[tuple[str, int, Any]] = [("predicted", 10, self._calc_predicted)]
        if params.detector is not None:
            before.append(("held_closed", n_jets, lambda now: self._read_memory(now).state.detector.closed))
            outputs += _detector_outputs(jets, params.detector)
        for name, size, calc in before:
            declare_output(self, name, size, calc, {self.xa_ticket()})
        declare_outputs(self, self._cycle, outputs)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=params.period_s, offset_sec=0.0, update=self._update)

    def pack_state(self, context: Any) -> dict[str, Array]:
        """Maps groups of the state of filter and detector to vectors, see `maths.estimation.cycle.save_state`."""
        return dict(cycle.save_state(self._read_memory(context).state, self._params))

    # ------------------------------------------------------------------------------------------- the cycle

    def _read_memory(self, context: Any) -> Memory:
        """Returns the state of filter and detector, with the newest cycle, from the context."""
        memory: Memory = context.get_abstract_state(self._memory).get_value()
        return memory

    def _read_sample(self, context: Any) -> Sample:
        """Reads time, readings, commands and outside wrench from the input ports, as a sample."""

        def read_optional(port: Any) -> Array | None:
            """Returns a copy of the value at an input port; None where it is not connected."""
            return port.Eval(context).copy() if port.HasValue(context) else None

        def read_or_nan(port: Any) -> Array:
            """Returns the value at an input port, NaN where it is not connected."""
            row: Array = port.Eval(context) if port.HasValue(context) else np.full(port.size(), np.nan)
            return row

        stamp = read_optional(self._stamp)
        return Sample(
            context.get_time(),
            self._gyros.eval(context),
            self._accelerometers.eval(context),
            self._command.Eval(context).copy(),
            read_optional(self._outside),
            None if stamp is None else float(stamp[0]),
            read_optional(self._next_command),
            np.concatenate([read_or_nan(port) for port in self._tracked]) if self._tracked else None,
            *map(read_optional, self._onsets),
        )

    def _run_cycle(self, context: Any) -> Memory:
        """Runs the estimation cycle of the sample; returns the memory after it, unchanged for a repeated row."""
        memory, time_s = self._read_memory(context), context.get_time()
        if memory.step is not None and memory.time_s == time_s:
            return memory
        sample = self._read_sample(context)
        if memory.step is not None and sample.stamp_s is not None and sample.stamp_s == memory.stamp_s:
            return memory
        step = cycle.step(memory.state, sample, self._params, time_call)
        return Memory(memory.state, step, time_s, sample.stamp_s)

    def _update(self, context: Any, state: Any) -> None:
        """Stores the cycle at this sample in the abstract state."""
        state.get_mutable_abstract_state(self._memory).set_value(self._cycle.get(context))

    # ------------------------------------------------------------------------------------------- outputs

    def _estimate_and_covariance(self, memory: Memory) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the cycle."""
        step = _step(memory)
        return step.filtered.known or cycle.estimate_and_covariance(step.state, self._params)

    def _covariance(self, memory: Memory) -> Array:
        """Returns the covariance of the ten parameters after the cycle, shape (10, 10)."""
        _, covariance = self._estimate_and_covariance(memory)
        return covariance

    def _converged(self, memory: Memory) -> Array:
        """Computes 1.0 where the ten estimates have converged, else 0.0, shape (1,)."""
        estimate, covariance = self._estimate_and_covariance(memory)
        deviation = np.sqrt(covariance.diagonal())
        return are_converged(deviation[None], estimate[None], self._params.limits, self._known).astype(float)

    def _calc_predicted(self, context: Any) -> Any:
        """Computes the ten parameters before the sample's measurement, shape (10,)."""
        memory = self._read_memory(context)
        state = memory.before if memory.time_s == context.get_time() else memory.state
        return self._params.filter.predicted(state.filter)


def _step(memory: Memory) -> EstimationStep:
    """Returns the estimation step of the newest cycle, which there must be."""
    assert memory.step is not None
    return memory.step


def _mass_report(memory: Memory) -> Array:
    """Packs the mass filter's report of the cycle as `MASS_REPORT`, NaN where there is none."""
    report = _step(memory).filtered.mass
    return np.full(MASS_REPORT.size, np.nan) if report is None else MASS_REPORT.pack(report)


def _detector_outputs(jets: KnownJets, detector: Detector) -> list[tuple[str, int, Any]]:
    """Lists a detector's output ports, name, size and function each, as `declare_outputs` takes them."""
    n_jets, report = jets.thrusts.size, detector.report
    reconfiguration, logged = (layout.sized(jets=n_jets) for layout in (RECONFIGURATION, DETECTOR_REPORT))

    def pack_reconfiguration(memory: Memory) -> Array:
        """Packs the detector's requests to the autopilot as `RECONFIGURATION`."""
        judgment = _judgment(memory)
        declared = judgment.status.detector_event == Verdict.DECLARED
        return reconfiguration.pack((declared, judgment.state.force @ jets.unit_wrenches, judgment.state.removed))

    def pack_probabilities(memory: Memory) -> Array:
        """Packs probabilities of a fault by jet, of none and of an unknown cause, shape (n_jets + 2,)."""
        fault_report = _judgment(memory).own
        by_jet = np.broadcast_to(fault_report.fault_probability, jets.thrusts.shape)
        return np.append(by_jet, (fault_report.none_probability, fault_report.unknown_probability))

    ports: list[tuple[str, int, Any]] = [
        (reconfiguration.name, reconfiguration.size, pack_reconfiguration),
        ("closed", n_jets, lambda memory: _judgment(memory).state.closed),
        (logged.name, logged.size, lambda memory: detector_row(_judgment(memory), memory.before.detector, logged)),
    ]
    if report is not None:
        layout = report.sized(jets=n_jets)
        ports.append((layout.name, layout.size, lambda memory: layout.pack(_judgment(memory).own)))
        ports.append(("fault_probability", n_jets + 2, pack_probabilities))
    return ports


def _judgment(memory: Memory) -> Judgment:
    """Returns the detector's judgment of the newest cycle, which there must be."""
    judgment = _step(memory).judgment
    assert judgment is not None
    return judgment
