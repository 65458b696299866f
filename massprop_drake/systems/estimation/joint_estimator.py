"""Estimates all ten mass properties, rate, velocity and thrust with one filter."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common.value import Value

from massprop_drake.maths.estimation.filter import FilterStep, Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState, Measurement
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import NOTHING, Cached
from massprop_drake.systems.estimation._filter import WholeFilterSystem
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.layouts import JOINT_REPORT


class JointEstimator(WholeFilterSystem):
    r"""The joint filter, see `massprop_drake.maths.estimation.filters.joint`.

    The same outputs as `RotationEstimator`, `MassEstimator` and `ConvergenceMonitor` give together. Impulses it makes
    itself from the commands, with the lag at its present estimate.

    Ports:
        <gyro> (in, 3), <accelerometer> (in, 3), one per package: as `RotationEstimator` and `MassEstimator`.
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, NaN where not known. Required.
        outside_wrench (in, 6): see `ImpulseModel`. Unconnected: none.
        record_time (in, 1): when the readings were taken, s. Unconnected: now.
        command (in, n_jets): fraction commanded from now on, which matters where readings are taken after their tick.
            Unconnected: not known.
        replacement (in, abstract): a state of the filter, `maths.estimation.joint.layout.JointState`, from which it
            is to go on in place of its own, or an empty tuple for none. Unconnected: none.
        published (in, abstract): likewise, a state whose estimates are its outputs, while it goes on from its own.
        predicted (out, 10): the ten parameters before this sample's measurement. No feedthrough.
        evidence (out, abstract): `maths.estimation.joint.cycle.JointEvidence`, for a detector. Does not depend on
            replacement and published.
        estimate (out, 10), standard_deviation (out, 10), covariance (out, 100), converged (out, 1): of the ten
            parameters, after this sample's measurement; see `ConvergenceMonitor`.
        rotation_report (out, 28), mass_report (out, 11): see `RotationEstimator` and `MassEstimator`; the innovation is
            that of the first package, NIS is of all components of a kind that were used, scaled to three.
        joint_report (out, 3): packed as `layouts.JOINT_REPORT`, for logs: how many components of gyros and of
            accelerometers were used; 1 when the start is over.

    State: the filter's, one vector, see `filters.joint.packed`.

    Timing: outputs at t_k use the readings at t_k and the commands of [t_k-1, t_k).

    Args:
        params: see `JointFilterParams`.
        gyros, accelerometers: packages with an input port, the preferred one first.
        limits: of convergence, see `maths.mass_properties.converged`, shape (3,).
    """

    def __init__(
        self,
        params: JointFilterParams,
        *,
        gyros: tuple[Package, ...],
        accelerometers: tuple[Package, ...],
        limits: Array,
    ):
        super().__init__(joint.GROUP, 0)
        self._params, self._limits = params, limits
        n_jets = params.joint.places.jets
        self._gyros, self._accelerometers = self._declare_packages(gyros), self._declare_packages(accelerometers)
        self._command = self._declare_input("jet_commands", n_jets)
        self._outside = self._declare_input("outside_wrench", 6)
        self._stamp = self._declare_input("record_time", 1)
        self._coming = self._declare_input("command", n_jets)
        self._declare_judged()
        self._state = self.DeclareDiscreteState(joint.packed(joint.initial(params), params))

        inputs = {self.input_port_ticket(port.get_index()) for port in self._inputs}
        measured = {self.xd_ticket(), self.time_ticket(), *inputs}
        self._measurement = Cached(self, "measurement", self._measure_cycle, measured)
        given = {self.input_port_ticket(port.get_index()) for port in (self._replacement, self._published)}
        judged = {self._measurement.ticket, *given}
        self._cycle = Cached(self, "cycle", self._finish_cycle, judged)
        self.DeclareVectorOutputPort("predicted", 10, self._calc_predicted, prerequisites_of_calc={self.xd_ticket()})
        self.DeclareAbstractOutputPort(
            "evidence",
            alloc=lambda: Value[object](NOTHING),
            calc=self._calc_evidence,
            prerequisites_of_calc={self._measurement.ticket},
        )
        for name, size, calc in (*self._reports(), ("joint_report", JOINT_REPORT.size, self._calc_joint)):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._cycle.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=params.period_s, offset_sec=0.0, update=self._update)

    def _known(self, context: Any) -> JointFilterState:
        return joint.unpacked(context.get_discrete_state(self._state).CopyToVector(), self._params)

    def _measure_cycle(self, context: Any) -> Measurement:
        time_s = context.get_time()
        stamp_s = float(self._stamp.Eval(context)[0]) if self._stamp.HasValue(context) else time_s
        coming = self._coming.Eval(context) if self._coming.HasValue(context) else None
        outside = self._outside.Eval(context) if self._outside.HasValue(context) else np.zeros(6)
        told = Told(time_s, stamp_s, self._command.Eval(context), coming, outside)
        state, rates, velocities = self._known(context), self._gyros.eval(context), self._accelerometers.eval(context)
        return self.stopwatch.measure(joint.step, state, rates, velocities, told, self._params)

    def _finish_cycle(self, context: Any) -> FilterStep:
        measurement: Measurement = self._measurement.get(self, context)
        step = joint.done(measurement, self._params)
        return self._as_judged(context, step, joint.FILTER, self._params)

    def _step(self, context: Any) -> FilterStep:
        step: FilterStep = self._cycle.get(self, context)
        return step

    def _known_of(self, state: JointFilterState) -> tuple[Array, Array]:
        return state.estimate, state.covariance

    def _calc_predicted(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._known(context).estimate)

    def _calc_evidence(self, context: Any, output: Any) -> None:
        output.set_value(self._measurement.get(self, context).evidence)

    def _calc_joint(self, context: Any, output: Any) -> None:
        output.SetFromVector(JOINT_REPORT.pack(self._step(context).own))

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._state, joint.packed(self._step(context).state, self._params))
