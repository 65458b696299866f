"""Estimates the mass reciprocal."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.adaptation import N_ADAPTATION
from massprop_drake.maths.estimation.detectors.cglr import N_KNOWN_FORCE
from massprop_drake.maths.estimation.filters import mass_filter, mass_jump
from massprop_drake.maths.estimation.filters.mass_filter import MassParams, MassState, Rotation
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.systems.caching import Cached, Stopwatch
from massprop_drake.systems.estimation._filter import Filter, Finished, Measured
from massprop_drake.systems.estimation._readings import Package, Readings
from massprop_drake.systems.estimation.impulse_model import N_IMPULSES

Array = NDArray[np.float64]


class MassEstimator(Filter):
    r"""Estimates the mass reciprocal from velocity increments and known impulses.

    The Kalman filter (3-81) to (3-87) with transverse and centripetal compensation, see
    `massprop_drake.maths.estimation.filters.mass_filter`.

    Ports:
        <accelerometer> (in, 3), one per package: integrated specific force, ft/s or m/s, body axes; NaN
            where missing. Required of the first; another that is unconnected counts as missing.
        impulses (in, 8): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        rate_sample (in, 7), predicted_estimate (in, 9), predicted_covariance (in, 81): see
            `RotationEstimator`. Required.
        mean_level (in, n_jets): see `ImpulseModel`. Required where thrust errors are considered.
        predicted (out, 2 + 3 s + 3 n): the state, first 1/m and its variance before this sample's
            measurement. No feedthrough.
        innovation (out, 3): measured minus predicted velocity increment after compensation, ft/s or
            m/s, NaN where not measured.
        innovation_covariance (out, 9): row by row.
        judged (out, 12): innovation and innovation_covariance in one, for the detector.
        thrust_error_effects (out, 3 n_jets), where thrust errors are considered: effect of one sigma of
            each jet's thrust error on the innovation, row by row; zero where none bears on the sample.
        estimate (out, 2): 1/m and its variance, after this sample's measurement.
        status (out, 6): the innovation (3) again; its NIS, NaN where not measured; 1 when the sample was
            used; 1 when a jump of 1/m was found.
        report (out, 8): estimate and status in one, for logs.

    State: estimate (2 + 3 s + 3 n): 1/m, its variance, the last reading of each of the s packages, NaN
    before the first, and the window of the jump test, n the samples that it looks back; sensitivity (n_jets)
    to thrust errors, where they are considered.

    Timing: as `RotationEstimator`; the center of mass is the rotation filter's prediction (3-40).

    Args:
        mass_reciprocal, variance: at the start, 1/slug or 1/kg, and squared.
        accelerometers: packages with an input port, in the order of the parameters' positions.
        params: see `maths.mass_filter.MassParams`.
        thrust_errors: impulses of one sigma of each jet's thrust error at full level over a sample, about
            the vehicle origin, shape (n_jets, 6); None: thrust is taken as known.
    """

    def __init__(
        self,
        *,
        mass_reciprocal: float,
        variance: float,
        accelerometers: tuple[Package, ...],
        params: MassParams,
        thrust_errors: Array | None = None,
    ):
        super().__init__()
        self.set_name("mass_estimator")
        self._params = params
        self._thrust_errors = None if thrust_errors is None else thrust_errors[:, 3:].T
        self.stopwatch = Stopwatch()
        self._accelerometers = Readings(self, accelerometers)
        self._impulses = self.DeclareVectorInputPort("impulses", N_IMPULSES)
        self._rate_sample = self.DeclareVectorInputPort("rate_sample", 7)
        self._predicted = self.DeclareVectorInputPort("predicted_estimate", N_ROTATION)
        self._predicted_covariance = self.DeclareVectorInputPort("predicted_covariance", N_ROTATION**2)
        self._known_force = self.DeclareVectorInputPort("known_force", N_KNOWN_FORCE)
        self._adaptation = self.DeclareVectorInputPort("adaptation", N_ADAPTATION)
        inputs = [
            *self._accelerometers.ports,
            self._impulses,
            self._rate_sample,
            self._predicted,
            self._predicted_covariance,
            self._known_force,
        ]

        window = mass_jump.empty_window(params.jump_window)
        readings = np.full(3 * len(accelerometers), np.nan)
        self._window = 2 + readings.size  # where it begins
        self._estimate = self.DeclareDiscreteState(
            np.concatenate([[mass_reciprocal, variance], readings, window.ravel()])
        )
        if thrust_errors is not None:
            self._mean_level = self.DeclareVectorInputPort("mean_level", thrust_errors.shape[0])
            inputs.append(self._mean_level)
            self._sensitivity = self.DeclareDiscreteState(thrust_errors.shape[0])

        # the innovation must not depend on the adaptation: the detector makes the one from the other
        measured = {self.xd_ticket(), *(self.input_port_ticket(port.get_index()) for port in inputs)}
        self._measurement = Cached(self, "measurement", self._measure, measured)
        adapted = {self._measurement.ticket, self.input_port_ticket(self._adaptation.get_index())}
        self._cycle = Cached(self, "cycle", self._finish, {self.xd_ticket(), *adapted})
        self.DeclareStateOutputPort("predicted", self._estimate)
        for name, size, calc, entry in (
            ("innovation", 3, self._calc_innovation, self._measurement),
            ("innovation_covariance", 9, self._calc_innovation_covariance, self._measurement),
            ("judged", 12, self._calc_judged, self._measurement),
            ("estimate", 2, self._calc_estimate, self._cycle),
            ("status", 6, self._calc_status, self._cycle),
            ("report", 8, self._calc_report, self._cycle),
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

    def _state(self, context: Any) -> MassState:
        estimate = context.get_discrete_state(self._estimate).CopyToVector()
        window = estimate[self._window :].reshape(-1, 3)
        sensitivity = None
        if self._thrust_errors is not None:
            sensitivity = context.get_discrete_state(self._sensitivity).CopyToVector()
        return MassState(float(estimate[0]), float(estimate[1]), window, sensitivity)

    def _measure(self, context: Any) -> Measured:
        rate_sample = self._rate_sample.Eval(context)
        estimate = context.get_discrete_state(self._estimate).CopyToVector()
        covariance = self._predicted_covariance.Eval(context).reshape(N_ROTATION, N_ROTATION)
        extra_noise = thrust_errors = None
        if self._known_force.HasValue(context):
            known = self._known_force.Eval(context)
            if known.any():
                extra_noise = known[6:15].reshape(3, 3)
        if self._thrust_errors is not None:
            thrust_errors = self._thrust_errors * self._mean_level.Eval(context)
        rotation = Rotation(
            increment=rate_sample[:3],
            rate=rate_sample[3:6],
            variance=float(rate_sample[6]),
            center=self._predicted.Eval(context)[6:],
            center_covariance=covariance[6:, 6:],
        )
        velocities, state = self._accelerometers.eval(context), self._state(context)
        measurement = self.stopwatch.measure(
            mass_filter.measure,
            state,
            estimate[2 : self._window].reshape(-1, 3),
            velocities,
            extra_noise,
            rotation,
            self._impulses.Eval(context)[3:6],
            self._params,
            thrust_errors,
        )
        return Measured(measurement, velocities, state)

    def _finish(self, context: Any) -> Finished:
        adaptation = self._adapted(context)
        impulses = self._impulses.Eval(context)
        measurement, velocities, state = self._measurement.get(self, context)
        cycle = self.stopwatch.measure(
            mass_filter.finish,
            state,
            measurement,
            impulses[6] != 0.0,
            impulses[7] != 0.0,
            adaptation,
            self._params,
        )
        return Finished(cycle, measurement, velocities)

    def _calc_estimate(self, context: Any, output: Any) -> None:
        state = self._cycle.get(self, context).cycle.state
        output.SetFromVector(np.array([state.mass_reciprocal, state.variance]))

    def _calc_status(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.array(_status(self._cycle.get(self, context))))

    def _calc_report(self, context: Any, output: Any) -> None:
        finished = self._cycle.get(self, context)
        state = finished.cycle.state
        output.SetFromVector(np.array([state.mass_reciprocal, state.variance, *_status(finished)]))

    def _update(self, context: Any, state: Any) -> None:
        finished = self._cycle.get(self, context)
        after = finished.cycle.state
        head = [after.mass_reciprocal, after.variance]
        state.set_value(self._estimate, np.concatenate([head, finished.readings.ravel(), after.window.ravel()]))
        if self._thrust_errors is not None:
            state.set_value(self._sensitivity, after.sensitivity)


def _status(finished: Finished) -> list[float]:
    cycle, innovation = finished.cycle, finished.measurement.innovation
    return [*innovation.innovation, innovation.nis, cycle.used, cycle.jumped]
