"""Estimation of the mass reciprocal."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.maths.estimation import estimation_ports
from massprop_drake.maths.estimation.estimation_ports import MassVector
from massprop_drake.maths.estimation.filter import NOT_MEASURED
from massprop_drake.maths.estimation.filters import mass_filter, thesis
from massprop_drake.maths.estimation.filters.mass_filter import MassCycle, MassParams, MassState
from massprop_drake.maths.estimation.filters.thesis import Turning
from massprop_drake.maths.kernels import compile_kernel as compiled_form
from massprop_drake.maths.kernels import make_holder
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import N_ROTATION, join_ten_parameters
from massprop_drake.systems.caching import declare_output, state_of
from massprop_drake.systems.estimation._filter import FilterSystem, MeasuredFilter
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.layouts import EVIDENCE, MASS_ESTIMATE, MASS_REPORT, TURNING
from massprop_drake.systems.stopwatch import ESTIMATORS, time_call

_NOT_MEASURED = EVIDENCE.pack(NOT_MEASURED)
_INNOVATION, _COVARIANCE = slice(0, 3), slice(3, 12)


class MassEstimator(FilterSystem):
    r"""Estimates the mass reciprocal from velocity increments and known impulses.

    The Kalman filter (3-81) to (3-87) with transverse and centripetal compensation, see
    `massprop_drake.maths.estimation.filters.mass_filter`.

    Ports:
        <accelerometer> (in, 3), one per package: integrated specific force, ft/s or m/s, body axes; NaN
            where missing. Required of the first; another that is unconnected counts as missing.
        turning (in, 136 + 12 n): see `RotationEstimator`. Required.
        predicted_estimate (in, 9): see `RotationEstimator`. Required for `predicted`.
        impulses (in, 8): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        mean_level (in, n_jets): see `ImpulseModel`. Required where thrust errors are considered.
        predicted (out, 10): the ten parameters before this sample's measurement. No feedthrough from readings.
        evidence (out, 213): both filters' innovations and predictions for the detector, packed as
            `layouts.EVIDENCE`: innovation (6), translation first, its covariance (36), 1 when translation and
            rotation share a part of it, the ten predicted parameters (10) and their covariance (100), covariance
            of the innovation with their errors (60). NaN where the combination of jets was not steady.
        innovation (out, 3): measured minus predicted velocity increment after compensation, ft/s or
            m/s, NaN where not measured.
        innovation_covariance (out, 9): row by row.
        estimate (out, 2): 1/m and its variance, after this sample's measurement.
        report (out, 11): packed as `layouts.MASS_REPORT`, for logs: estimate (2); the innovation (3) again; its
            1-sigma (3) and its NIS, NaN where not measured; 1 when the sample was used; 1 when a jump of 1/m was found.

    State (2 + 3 s + 3 n), packed as `thesis.MASS_STATE`: 1/m, its variance, the last reading of each of the s
    packages, NaN before the first, and the window of the jump test, n the samples that it looks back; sensitivity
    (n_jets) to thrust errors, where they are considered.

    Timing: as `RotationEstimator`; the center of mass is the rotation filter's prediction (3-40).

    Args:
        mass_reciprocal, variance: at the start, 1/slug or 1/kg, and squared.
        accelerometers: packages with an input port, in the order of the parameters' positions.
        params: see `MassParams`.
        thrust_errors: impulses of one sigma of each jet's thrust error at full level over a sample, about
            the vehicle origin, shape (n_jets, 6); None: thrust is taken as known.
        compiled: whether its kernels are, where one accelerometer counts at a time and thrust is taken as known.
    """

    def __init__(
        self,
        *,
        mass_reciprocal: float,
        variance: float,
        accelerometers: tuple[KnownPackage, ...],
        params: MassParams,
        thrust_errors: Array | None = None,
        compiled: bool = False,
    ):
        n_errors = 0 if thrust_errors is None else thrust_errors.shape[0]
        super().__init__("mass_estimator", n_errors)
        self._params, self._linear_errors = params, thesis.linear_errors(thrust_errors)
        self._accelerometers = self._declare_packages(accelerometers)
        self._turning_layout = TURNING.sized(jets=n_errors)
        self._turning = self._declare_input("turning", self._turning_layout.size)
        self._declare_interval()
        self._predicted_estimate = self.DeclareVectorInputPort("predicted_estimate", N_ROTATION)
        self._layout = thesis.mass_layout(params, n_errors)
        start = thesis.mass_start(mass_reciprocal, variance, params, n_errors)
        vector = thesis.pack_mass(*start, self._layout)
        self.DeclareDiscreteState(vector)
        self._compiled = compiled and thrust_errors is None and mass_filter.uses_one_package(params)
        if self._compiled:
            model = estimation_ports.make_mass_filter(params, MassVector._make(self._layout.read(vector)[:-1]))
            self._measure_kernel = compiled_form(estimation_ports.measure_mass)
            self._finish_kernel = compiled_form(estimation_ports.finish_mass)
            self._held = make_holder(model, compile_it=True)
        predictions = {self.xd_ticket(), self._predicted_estimate.ticket()}
        declare_output(self, "predicted", 10, self._calc_predicted, predictions)
        size, n_estimate = MASS_REPORT.size, MASS_ESTIMATE.size
        self._declare_cycle(
            (
                ("evidence", EVIDENCE.size, self._evidence),
                ("innovation", 3, lambda measured: self._innovation(measured)[_INNOVATION]),
                ("innovation_covariance", 9, lambda measured: self._innovation(measured)[_COVARIANCE]),
            ),
            (("estimate", n_estimate, slice(size, size + n_estimate)), ("report", size, slice(0, size))),
            params.period_s,
            slice(size, None),
        )

    def _read_state(self, context: Any) -> tuple[MassState, Array]:
        """Returns the filter's state, and the readings before, from the context."""
        return thesis.unpack_mass(state_of(context), self._layout)

    def _read_turning(self, context: Any) -> Turning:
        """Reads the rotation filter's measurement of the sample."""
        turning = Turning._make(self._turning_layout.read(self._turning.Eval(context)))
        return turning if self._linear_errors is not None else turning._replace(effects=None, sensitivity=None)

    def _measure(self, context: Any) -> Any:
        """Measures velocity increments: `Measured`, or compiled the vector of `estimation_ports.measure_mass`."""
        if self._compiled:
            arguments = state_of(context), self._accelerometers.eval(context), self._turning.Eval(context)
            return time_call(ESTIMATORS, self._measure_kernel, *arguments, *self._interval_vectors(context), self._held)
        state, before = self._read_state(context)
        velocities, interval = self._accelerometers.eval(context), self._interval(context)
        turning = self._read_turning(context)
        inputs = thesis.mass_interval(interval, self._linear_errors), thesis.rotation_inputs(turning)
        measurement = time_call(ESTIMATORS, mass_filter.measure, state, before, velocities, *inputs, self._params)
        return MeasuredFilter(state, interval, measurement, (velocities, turning))

    def _compute_cycle(self, context: Any) -> Any:
        """Runs the cycle; returns the report and the state after it, concatenated."""
        measured: Any = self._measurement.get(context)
        if self._compiled:
            return time_call(ESTIMATORS, self._finish_kernel, measured, self._read_adaptation(context), self._held)
        state, interval, measurement, (velocities, _) = measured
        finish = mass_filter.finish, state, measurement, interval.impulses.usable, interval.impulses.firing
        cycle: MassCycle = time_call(ESTIMATORS, *finish, self._requested_adaptation(context), self._params)
        report = MASS_REPORT.pack(thesis.mass_report(measurement.innovation, cycle))
        return np.concatenate((report, thesis.pack_mass(cycle.state, velocities, self._layout)))

    def _calc_predicted(self, context: Any) -> Any:
        """Computes the ten parameters before the sample's measurement, shape (10,)."""
        state, _ = self._read_state(context)
        return join_ten_parameters(self._predicted_estimate.Eval(context), state.mass_reciprocal)

    def _evidence(self, measured: Any) -> Array:
        """Packs innovations and predictions of both filters for the detector, as `EVIDENCE`."""
        if self._compiled:
            row: Array = measured[: EVIDENCE.size]
            return row
        state, interval, measurement, (_, turning) = measured
        if not interval.impulses.usable:
            return _NOT_MEASURED
        return EVIDENCE.pack(thesis.join_innovations(turning, measurement.sample, measurement.innovation, state))

    def _innovation(self, measured: Any) -> Array:
        """Returns the velocity innovation (3) and its covariance (9), concatenated."""
        if self._compiled:
            row: Array = measured[EVIDENCE.size :]
            return row
        innovation = measured.measurement.innovation
        return np.append(innovation.innovation, innovation.covariance)
