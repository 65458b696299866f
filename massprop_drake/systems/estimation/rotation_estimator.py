"""Estimates inverse inertia and center of mass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.adaptation import N_ADAPTATION
from massprop_drake.maths.estimation.detectors.cglr import N_KNOWN_FORCE
from massprop_drake.maths.estimation.filters import rotation_filter
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationParams,
    RotationState,
)
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.systems.caching import Cached, Stopwatch
from massprop_drake.systems.estimation._filter import Filter, Finished, Measured
from massprop_drake.systems.estimation._readings import Package, Readings
from massprop_drake.systems.estimation.impulse_model import N_IMPULSES

Array = NDArray[np.float64]


class RotationEstimator(Filter):
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
        predicted_covariance (out, 81): its covariance S, row by row. No feedthrough.
        rate_sample (out, 7): measured rate increment (3) and mean rate (3) over the sample, rad/s, NaN where
            missing, and the variance of the increment's error per component, rad^2/s^2.
        innovation (out, 3): measured minus predicted rate increment, rad/s, NaN where not measured.
        innovation_covariance (out, 9): row by row, rad^2/s^2.
        judged (out, 12): innovation and innovation_covariance in one, for the detector.
        thrust_error_effects (out, 3 n_jets), where thrust errors are considered: effect of one sigma of
            each jet's thrust error on the innovation, row by row, rad/s; zero where none bears on the sample.
        estimate (out, 9): x after this sample's measurement.
        covariance (out, 81): its covariance S, row by row.
        standard_deviation (out, 9): square roots of its diagonal.
        status (out, 7): the innovation (3) again; its NIS before any covariance increment, NaN where not
            measured; 1 when the sample was used; 1 when the covariance was incremented; 1 when dynamic
            coupling was to be subtracted.
        report (out, 25): estimate, standard_deviation and status in one, for logs.

    State: estimate (9); covariance (81); memory (1 + 3 s): the hybrid rule's last decision, and the last
    reading of each package, NaN before the first; sensitivity (9 n_jets) to thrust errors, row by row,
    where they are considered.

    Timing: outputs at t_k use the reading at t_k and the impulses of [t_k-1, t_k); the update at t_k
    makes `estimate` the next prediction.

    Assumptions and limitations: increments of consecutive samples share a reading and so are not
    independent, as the filter takes them to be; on the early samples the estimates can lock onto a wrong
    trade between inertia and center of mass, which the covariance increment heals.

    Args:
        estimate, covariance: at the start, shapes (9,) and (9, 9).
        gyros: packages with an input port, in the order of the parameters' variances.
        params: see `maths.rotation_filter.RotationParams`.
        thrust_errors: impulses of one sigma of each jet's thrust error at full level over a sample, about
            the vehicle origin, shape (n_jets, 6); None: thrust is taken as known.
    """

    def __init__(
        self,
        *,
        estimate: Array,
        covariance: Array,
        gyros: tuple[Package, ...],
        params: RotationParams,
        thrust_errors: Array | None = None,
    ):
        super().__init__()
        self.set_name("rotation_estimator")
        self._params = params
        self._thrust_errors = thrust_errors
        self.stopwatch = Stopwatch()
        self._gyros = Readings(self, gyros)
        self._impulses = self.DeclareVectorInputPort("impulses", N_IMPULSES)
        self._known_force = self.DeclareVectorInputPort("known_force", N_KNOWN_FORCE)
        self._adaptation = self.DeclareVectorInputPort("adaptation", N_ADAPTATION)
        inputs = [*self._gyros.ports, self._impulses, self._known_force]

        self._estimate = self.DeclareDiscreteState(estimate)
        self._covariance = self.DeclareDiscreteState(covariance.ravel())
        self._memory = self.DeclareDiscreteState(np.append(0.0, np.full(3 * len(gyros), np.nan)))
        if thrust_errors is not None:
            self._mean_level = self.DeclareVectorInputPort("mean_level", thrust_errors.shape[0])
            inputs.append(self._mean_level)
            self._sensitivity = self.DeclareDiscreteState(N_ROTATION * thrust_errors.shape[0])

        # the innovation must not depend on the adaptation: the detector makes the one from the other
        measured = {self.xd_ticket(), *(self.input_port_ticket(port.get_index()) for port in inputs)}
        self._measurement = Cached(self, "measurement", self._measure, measured)
        adapted = {self._measurement.ticket, self.input_port_ticket(self._adaptation.get_index())}
        self._cycle = Cached(self, "cycle", self._finish, {self.xd_ticket(), *adapted})
        self.DeclareStateOutputPort("predicted_estimate", self._estimate)
        self.DeclareStateOutputPort("predicted_covariance", self._covariance)
        for name, size, calc, entry in (
            ("rate_sample", 7, self._calc_rate_sample, self._measurement),
            ("innovation", 3, self._calc_innovation, self._measurement),
            ("innovation_covariance", 9, self._calc_innovation_covariance, self._measurement),
            ("judged", 12, self._calc_judged, self._measurement),
            ("estimate", N_ROTATION, self._calc_estimate, self._cycle),
            ("covariance", N_ROTATION**2, self._calc_covariance, self._cycle),
            ("standard_deviation", N_ROTATION, self._calc_deviation, self._cycle),
            ("status", 7, self._calc_status, self._cycle),
            ("report", 2 * N_ROTATION + 7, self._calc_report, self._cycle),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={entry.ticket})
        if thrust_errors is not None:
            self.DeclareVectorOutputPort(
                "thrust_error_effects",
                3 * thrust_errors.shape[0],
                self._calc_effects,
                prerequisites_of_calc={self._measurement.ticket},
            )
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=params.period_s, offset_sec=0.0, update=self._update)

    def _state(self, context: Any) -> RotationState:
        estimate = context.get_discrete_state(self._estimate).CopyToVector()
        covariance = context.get_discrete_state(self._covariance).CopyToVector().reshape(N_ROTATION, N_ROTATION)
        if self._thrust_errors is None:
            return RotationState(estimate, covariance)
        sensitivity = context.get_discrete_state(self._sensitivity).CopyToVector().reshape(N_ROTATION, -1)
        return RotationState(estimate, covariance, sensitivity)

    def _measure(self, context: Any) -> Measured:
        impulses = self._impulses.Eval(context)
        memory = context.get_discrete_state(self._memory).CopyToVector()
        extra_noise, acting, thrust_errors = None, impulses[7] != 0.0, None
        if self._known_force.HasValue(context):
            known = self._known_force.Eval(context)
            if known.any():
                extra_noise, acting = known[15:].reshape(3, 3), True
        if self._thrust_errors is not None:
            thrust_errors = self._mean_level.Eval(context)[:, None] * self._thrust_errors
        rates, state = self._gyros.eval(context), self._state(context)
        measurement = self.stopwatch.measure(
            rotation_filter.measure,
            state,
            memory[1:].reshape(-1, 3),
            memory[0] != 0.0,
            rates,
            extra_noise,
            impulses[:3],
            impulses[3:6],
            acting,
            self._params,
            thrust_errors,
        )
        return Measured(measurement, rates, state)

    def _finish(self, context: Any) -> Finished:
        adaptation = self._adapted(context)
        measurement, rates, state = self._measurement.get(self, context)
        # a known force alone is no reason to learn: it may have ceased
        usable = bool(self._impulses.Eval(context)[6:8].all())
        cycle = self.stopwatch.measure(rotation_filter.finish, state, measurement, usable, adaptation, self._params)
        return Finished(cycle, measurement, rates)

    def _calc_rate_sample(self, context: Any, output: Any) -> None:
        sample = self._measured(context).sample
        output.SetFromVector(np.array([*sample.increment, *sample.rate, sample.gyro_variance]))

    def _calc_estimate(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).cycle.state.estimate)

    def _calc_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).cycle.state.covariance.ravel())

    def _calc_deviation(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.sqrt(self._cycle.get(self, context).cycle.state.covariance.diagonal()))

    def _calc_status(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.array(_status(self._cycle.get(self, context))))

    def _calc_report(self, context: Any, output: Any) -> None:
        finished = self._cycle.get(self, context)
        state = finished.cycle.state
        deviation = np.sqrt(state.covariance.diagonal())
        output.SetFromVector(np.concatenate([state.estimate, deviation, _status(finished)]))

    def _update(self, context: Any, state: Any) -> None:
        finished = self._cycle.get(self, context)
        after, innovation = finished.cycle.state, finished.measurement.innovation
        state.set_value(self._estimate, after.estimate)
        state.set_value(self._covariance, after.covariance.ravel())
        state.set_value(self._memory, np.append(innovation.subtract_coupling, finished.readings))
        if self._thrust_errors is not None:
            state.set_value(self._sensitivity, after.sensitivity.ravel())


def _status(finished: Finished) -> list[float]:
    cycle, before = finished.cycle, finished.measurement.innovation
    return [*before.innovation, before.nis, cycle.used, cycle.jumped, before.subtract_coupling]
