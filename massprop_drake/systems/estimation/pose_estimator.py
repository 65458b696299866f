"""Estimates mass properties, thrust factors, pose and rate of a vehicle that is followed in a fixed frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE
from massprop_drake.maths.estimation.filter import FilterStep, Interval, Told
from massprop_drake.maths.estimation.filters import pose
from massprop_drake.maths.estimation.filters.pose import Measurement, PoseFilterParams, PoseFilterState
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import converged_rows
from massprop_drake.systems.estimation._filter import RememberingFilterSystem
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.layouts import POSE_REPORT
from massprop_drake.systems.stopwatch import ESTIMATORS, timed

_NOT_MADE = Impulses(np.zeros(3), np.zeros(3), False, False, np.empty(0), np.empty(0))  # the filter makes its own


class PoseEstimator(RememberingFilterSystem):
    r"""The estimator in a fixed frame, see `massprop_drake.maths.estimation.filters.pose`.

    Ports:
        <gyro> (in, 3), <accelerometer> (in, 3), one per package: as `JointEstimator`.
        <pose> (in, 7), <velocity> (in, 3), one per sensor in the fixed frame: as `PoseTracker` and `VelocityTracker`
            read, NaN where nothing is read; one that is not connected reads nothing.
        jet_commands (in, n_jets): fraction commanded over the interval that ends now, NaN where not known. Required.
        record_time (in, 1): when the readings were taken, s. Unconnected: now.
        command (in, n_jets): fraction commanded from now on, which matters where jets act before their command.
            Unconnected: not known.
        outside_wrench (in, 6): see `ImpulseModel`. Unconnected: none.
        replacement (in, abstract): hypotheses from which the filter is to go on, a `Tried` of
            `maths.estimation.pose.hypotheses`, or an empty tuple for none. Unconnected: none.
        published (in, abstract): likewise, whose first filter's estimates are its outputs, while it goes on from its
            own.
        predicted (out, 10): the ten parameters before this sample's measurement.
        evidence (out, abstract): `maths.estimation.filters.pose.PoseEvidence`, for a detector.
        estimate (out, 10), standard_deviation (out, 10), covariance (out, 100), converged (out, 1): of the ten
            parameters, NaN for what has no sigma; see `ConvergenceMonitor`.
        rotation_report (out, 28), mass_report (out, 11): see `RotationEstimator` and `MassEstimator`; NIS is of
            attitudes and rates, and of positions, velocities and accelerometers, scaled to three components.
        pose_report (out, 24 + 2 n_jets): packed as `layouts.POSE_REPORT`, for logs.

    State: abstract, `Memory`: of as many commands as still act.

    Timing: outputs at t_k use the readings at t_k and the commands of [t_k-1, t_k). As `HypothesisDetector`, the state
    holds the newest cycle with its time, and outputs at that time are taken from it.

    Args:
        params: see `PoseFilterParams`.
        gyros, accelerometers: packages with an input port, the preferred one first.
        poses, velocities: names of the sensors in the fixed frame.
        limits: of convergence, see `maths.mass_properties.converged`, shape (3,).
        period_s: sample period, s.
    """

    def __init__(
        self,
        params: PoseFilterParams,
        *,
        gyros: tuple[Package, ...],
        accelerometers: tuple[Package, ...],
        poses: tuple[str, ...],
        velocities: tuple[str, ...],
        limits: Array,
        period_s: float,
    ):
        super().__init__(pose.GROUP, 0)
        self._params, self._limits = params, limits
        n_jets = params.pose.pushes.shape[0]
        self._report = POSE_REPORT.sized(jets=n_jets)
        self._gyros, self._accelerometers = self._declare_packages(gyros), self._declare_packages(accelerometers)
        self._tracked = [self._declare_input(name, 7) for name in poses]
        self._tracked += [self._declare_input(name, 3) for name in velocities]
        self._command = self._declare_input("jet_commands", n_jets)
        self._stamp = self._declare_input("record_time", 1)
        self._coming = self._declare_input("command", n_jets)
        self._outside = self._declare_input("outside_wrench", 6)
        own = (("pose_report", self._report.size, self._calc_pose),)
        self._declare_memory(pose.initial(params), period_s, own)

    def kept(self, context: Any) -> Array:
        """The state as a vector, see `filters.pose.saved`."""
        return pose.saved(self._remembered(context).state, self._params)[pose.GROUP]

    def _measure_sample(self, context: Any, state: PoseFilterState) -> Measurement:
        time_s = context.get_time()
        stamp_s = float(self._stamp.Eval(context)[0]) if self._stamp.HasValue(context) else time_s
        coming = self._coming.Eval(context) if self._coming.HasValue(context) else None
        tracked = [
            port.Eval(context) if port.HasValue(context) else np.full(port.size(), np.nan) for port in self._tracked
        ]
        row = np.concatenate(tracked) if tracked else None
        outside = self._outside.Eval(context).copy() if self._outside.HasValue(context) else np.zeros(6)
        told = Told(time_s, stamp_s, self._command.Eval(context).copy(), coming, outside, row)
        rates = self._gyros.eval(context) if self._gyros.ports else np.empty((0, 3))
        velocities = self._accelerometers.eval(context) if self._accelerometers.ports else np.empty((0, 3))
        interval = Interval(_NOT_MADE, NO_KNOWN_FORCE, told)
        return timed(ESTIMATORS, pose.measure, state, rates, velocities, interval, self._params)

    def _finish_sample(self, context: Any, measurement: Measurement) -> FilterStep:
        step = pose.finish(measurement.state, measurement, None, NO_ADAPTATION, self._params)
        return self._as_judged(context, step, pose.FILTER, self._params)

    def _evidence_of(self, measurement: Measurement) -> Any:
        return pose.evidence(None, measurement, None)

    def _calc_converged(self, context: Any, output: Any) -> None:
        estimate, covariance = self._known_now(context)
        deviation = np.sqrt(covariance.diagonal())
        good = converged_rows(deviation[None], estimate[None], self._limits, self._params.known)
        output.SetFromVector(good.astype(float))

    def _calc_pose(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._report.pack(self._step(context).own))
