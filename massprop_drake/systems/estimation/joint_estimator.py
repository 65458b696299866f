"""Estimates all ten mass properties, rate, velocity and thrust with one filter."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.maths.estimation.filter import FilterStep, Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState, Measurement
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.estimation._filter import RememberingFilterSystem
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.layouts import JOINT_REPORT
from massprop_drake.systems.stopwatch import ESTIMATORS, timed


class JointEstimator(RememberingFilterSystem):
    r"""The joint filter, see `massprop_drake.maths.estimation.filters.joint`.

    The same outputs as `RotationEstimator`, `MassEstimator` and `ConvergenceMonitor` give together. Impulses it makes
    itself from the commands, with the lag at its present estimate.

    Ports:
        <gyro> (in, 3), <accelerometer> (in, 3), one per package: as `RotationEstimator` and `MassEstimator`.
        <tracker> (in, 7), one per sensor of attitude: as `PoseTracker` reads, NaN where nothing is read; one that is
            not connected reads nothing.
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

    State: the filter's, an immutable value that a clone of the context shares.

    Timing: outputs at t_k use the readings at t_k and the commands of [t_k-1, t_k).

    Args:
        params: see `JointFilterParams`.
        gyros, accelerometers: packages with an input port, the preferred one first.
        trackers: names of the sensors of attitude.
        limits: of convergence, see `maths.mass_properties.converged`, shape (3,).
    """

    def __init__(
        self,
        params: JointFilterParams,
        *,
        gyros: tuple[Package, ...],
        accelerometers: tuple[Package, ...],
        limits: Array,
        trackers: tuple[str, ...] = (),
    ):
        super().__init__(joint.GROUP, 0)
        self._params, self._limits = params, limits
        n_jets = params.joint.places.jets
        self._gyros, self._accelerometers = self._declare_packages(gyros), self._declare_packages(accelerometers)
        self._trackers = [self._declare_input(name, 7) for name in trackers]
        self._command = self._declare_input("jet_commands", n_jets)
        self._outside = self._declare_input("outside_wrench", 6)
        self._stamp = self._declare_input("record_time", 1)
        self._coming = self._declare_input("command", n_jets)
        own = (("joint_report", JOINT_REPORT.size, self._calc_joint),)
        self._declare_memory(joint.initial(params), params.period_s, own)

    def kept(self, context: Any) -> Array:
        """The state as a vector, see `filters.joint.saved`."""
        return joint.saved(self._remembered(context).state, self._params)[joint.GROUP]

    def _measure_sample(self, context: Any, state: JointFilterState) -> Measurement:
        time_s = context.get_time()
        stamp_s = float(self._stamp.Eval(context)[0]) if self._stamp.HasValue(context) else time_s
        coming = self._coming.Eval(context) if self._coming.HasValue(context) else None
        outside = self._outside.Eval(context) if self._outside.HasValue(context) else np.zeros(6)
        told = Told(time_s, stamp_s, self._command.Eval(context).copy(), coming, outside, self._tracked(context))
        rates, velocities = self._gyros.eval(context), self._accelerometers.eval(context)
        return timed(ESTIMATORS, joint.step, state, rates, velocities, told, self._params)

    def _tracked(self, context: Any) -> Array | None:
        """Readings of the trackers, as in `Told`."""
        read = [port.Eval(context) if port.HasValue(context) else np.full(7, np.nan) for port in self._trackers]
        return np.concatenate(read) if read else None

    def _finish_sample(self, context: Any, measurement: Measurement) -> FilterStep:
        return self._as_judged(context, joint.done(measurement, self._params), joint.FILTER, self._params)

    def _evidence_of(self, measurement: Measurement) -> JointEvidence:
        return measurement.evidence

    def _calc_joint(self, context: Any, output: Any) -> None:
        output.SetFromVector(JOINT_REPORT.pack(self._step(context).own))
