"""Estimation of inverse inertia and center of mass."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.maths.estimation import estimation_ports
from massprop_drake.maths.estimation.estimation_ports import RotationVector
from massprop_drake.maths.estimation.filters import rotation_filter, thesis
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCycle,
    RotationMemory,
    RotationParams,
    RotationState,
)
from massprop_drake.maths.kernels import compile_kernel as compiled_form
from massprop_drake.maths.kernels import make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.systems.caching import declare_output, state_of
from massprop_drake.systems.estimation._filter import FilterSystem, MeasuredFilter
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.layouts import ROTATION_REPORT, TURNING
from massprop_drake.systems.stopwatch import ESTIMATORS, time_call


class RotationEstimator(FilterSystem):
    r"""Estimates inverse inertia and center of mass from rate increments and known impulses.

    The second-order filter (2-115) to (2-123) or the extended Kalman filter, see
    `massprop_drake.maths.estimation.filters.rotation_filter`.

    Ports:
        <gyro> (in, 3), one per package: measured rate, rad/s, body axes; NaN where missing. Required
            of the first; another that is unconnected counts as missing.
        impulses (in, 8): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        mean_level (in, n_jets): see `ImpulseModel`. Required where thrust errors are considered.
        predicted_estimate (out, 9): x before this sample's measurement. No feedthrough.
        turning (out, 136 + 12 n): what the mass filter and the detector need, packed as `layouts.TURNING`:
            innovation (3) and its covariance (9), measured rate increment (3) and mean rate (3) over the sample,
            rad/s, NaN where missing, the variance of the increment's error per component, rad^2/s^2, prediction
            (9) and its covariance (81), covariance of the innovation with the error of the prediction (27); where
            thrust errors are considered, n = n_jets, the effect of one sigma of each on the innovation, row by row,
            zero where none bears on the sample, and the sensitivity (9 n); else n = 0.
        innovation (out, 3): measured minus predicted rate increment, rad/s, NaN where not measured.
        innovation_covariance (out, 9): row by row, rad^2/s^2.
        estimate (out, 9): x after this sample's measurement.
        covariance (out, 81): its covariance S, row by row.
        report (out, 28): packed as `layouts.ROTATION_REPORT`, for logs: estimate (9); 1-sigma (9); the innovation
            (3) again; its 1-sigma (3) and its NIS before any covariance increment, NaN where not measured; 1 when the
            sample was used; 1 when the covariance was incremented; 1 when dynamic coupling was to be subtracted.

    State (91 + 3 s), packed as `thesis.ROTATION_STATE`: estimate (9); covariance (81); the hybrid rule's last
    decision; the last reading of each of the s packages, NaN before the first; sensitivity (9 n_jets) to thrust
    errors, row by row, where they are considered.

    Timing: outputs at t_k use the reading at t_k and the impulses of [t_k-1, t_k); the update at t_k
    makes `estimate` the next prediction.

    Assumptions and limitations: increments of consecutive samples share a reading and so are not
    independent, as the filter takes them to be; on the early samples the estimates can lock onto a wrong
    trade between inertia and center of mass, which the covariance increment heals.

    Args:
        estimate, covariance: at the start, shapes (9,) and (9, 9).
        gyros: packages with an input port, in the order of the parameters' variances.
        params: see `RotationParams`.
        thrust_errors: impulses of one sigma of each jet's thrust error at full level over a sample, about
            the vehicle origin, shape (n_jets, 6); None: thrust is taken as known.
        compiled: whether its kernels are, where one gyro counts at a time and thrust is taken as known.
    """

    def __init__(
        self,
        *,
        estimate: Array,
        covariance: Array,
        gyros: tuple[KnownPackage, ...],
        params: RotationParams,
        thrust_errors: Array | None = None,
        compiled: bool = False,
    ):
        n_errors = 0 if thrust_errors is None else thrust_errors.shape[0]
        super().__init__("rotation_estimator", n_errors)
        self._params, self._thrust_errors = params, thrust_errors
        self._gyros = self._declare_packages(gyros)
        self._declare_interval()
        self._turning = TURNING.sized(jets=n_errors)
        self._no_effects, self._insensitive = np.zeros((3, n_errors)), np.zeros((N_ROTATION, n_errors))
        self._layout = thesis.rotation_layout(params, n_errors)
        start = thesis.rotation_start(estimate, covariance, params, n_errors)
        vector = thesis.pack_rotation(*start, self._layout)
        self.DeclareDiscreteState(vector)
        self._compiled = compiled and thrust_errors is None and rotation_filter.uses_one_package(params)
        if self._compiled:
            model = estimation_ports.make_rotation_filter(params, RotationVector._make(self._layout.read(vector)[:-1]))
            self._measure_kernel = compiled_form(estimation_ports.measure_rotation)
            self._finish_kernel = compiled_form(estimation_ports.finish_rotation)
            self._held = make_holder(model, compile_it=True)
        state = {self.xd_ticket()}
        declare_output(self, "predicted_estimate", N_ROTATION, lambda now: self._read_state(now)[0].estimate, state)
        reported, size = slice(0, ROTATION_REPORT.size), ROTATION_REPORT.size
        innovation, spread = map(self._turning.slice, ("innovation", "innovation_covariance"))
        means, spreads = (
            slice(size + part.start, size + part.stop) for part in map(self._layout.slice, ("estimate", "covariance"))
        )
        self._declare_cycle(
            (
                ("turning", self._turning.size, self._pack_turning),
                ("innovation", 3, lambda measured: self._pack_turning(measured)[innovation]),
                ("innovation_covariance", 9, lambda measured: self._pack_turning(measured)[spread]),
            ),
            (("estimate", N_ROTATION, means), ("covariance", N_ROTATION**2, spreads), ("report", size, reported)),
            params.period_s,
            slice(size, None),
        )

    def _read_state(self, context: Any) -> tuple[RotationState, RotationMemory]:
        """Returns the filter's state, and its memory of the last sample, from the context."""
        return thesis.unpack_rotation(state_of(context), self._layout)

    def _measure(self, context: Any) -> Any:
        """Measures rate increments: `Measured`, or compiled the vector of `estimation_ports.measure_rotation`."""
        if self._compiled:
            arguments = state_of(context), self._gyros.eval(context), *self._interval_vectors(context), self._held
            return time_call(ESTIMATORS, self._measure_kernel, *arguments)
        state, memory = self._read_state(context)
        rates, interval = self._gyros.eval(context), self._interval(context)
        inputs = thesis.rotation_interval(interval, self._thrust_errors)
        measurement = time_call(ESTIMATORS, rotation_filter.measure, state, memory, rates, inputs, self._params)
        return MeasuredFilter(state, interval, measurement, rates)

    def _compute_cycle(self, context: Any) -> Any:
        """Runs the cycle; returns the report and the state after it, concatenated."""
        measured: Any = self._measurement.get(context)
        if self._compiled:
            return time_call(ESTIMATORS, self._finish_kernel, measured, self._read_adaptation(context), self._held)
        state, interval, measurement, rates = measured
        learning = thesis.is_learning(interval)
        finish = rotation_filter.finish, state, measurement, learning, self._requested_adaptation(context), self._params
        cycle: RotationCycle = time_call(ESTIMATORS, *finish)
        memory = thesis.rotation_memory(measurement, rates)
        report = ROTATION_REPORT.pack(thesis.rotation_report(measurement.innovation, cycle))
        return np.concatenate((report, thesis.pack_rotation(cycle.state, memory, self._layout)))

    def _pack_turning(self, measured: Any) -> Array:
        """Packs the measurement for the mass filter and the detector into a vector, as `TURNING`."""
        if self._compiled:
            row: Array = measured[: self._turning.size]
            return row
        state, _, measurement, _ = measured
        turning = thesis.make_turning(state, measurement.sample, measurement.innovation)
        effects = self._no_effects if turning.effects is None else turning.effects
        sensitivity = self._insensitive if turning.sensitivity is None else turning.sensitivity
        return self._turning.pack(turning._replace(effects=effects, sensitivity=sensitivity))
