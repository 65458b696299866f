"""Estimates the mass reciprocal."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths import mass_filter, mass_jump
from massprop_drake.maths.adaptation import N_ADAPTATION, NO_ADAPTATION, unpacked
from massprop_drake.maths.detection import N_KNOWN_FORCE
from massprop_drake.maths.mass_filter import MassCycle, MassMeasurement, MassSettings
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.maths.sensing import increment_noise
from massprop_drake.systems._caching import Cached, Stopwatch
from massprop_drake.systems.impulse_model import N_IMPULSES
from massprop_drake.systems.rotation_estimator import Package

Array = NDArray[np.float64]


class MassEstimator(LeafSystem):
    r"""Estimates the mass reciprocal from velocity increments and known impulses.

    The Kalman filter (3-81) to (3-87) with transverse and centripetal compensation, see
    `massprop_drake.maths.mass_filter`.

    Ports:
        <accelerometer> (in, 3), one per package: integrated specific force, ft/s or m/s, body axes; NaN
            where missing. Required of the package in use.
        impulses (in, 8): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        rate_sample (in, 6), predicted_estimate (in, 9), predicted_covariance (in, 81): see
            `RotationEstimator`. Required.
        predicted (out, 5 + 3 n): the state, first 1/m and its variance before this sample's measurement. No
            feedthrough.
        innovation (out, 3): measured minus predicted velocity increment after compensation, ft/s or
            m/s, NaN where not measured.
        innovation_covariance (out, 9): row by row.
        judged (out, 12): innovation and innovation_covariance in one, for the detector.
        estimate (out, 2): 1/m and its variance, after this sample's measurement.
        status (out, 6): the innovation (3) again; its NIS, NaN where not measured; 1 when the sample was
            used; 1 when a jump of 1/m was found.
        report (out, 8): estimate and status in one, for logs.

    State: estimate (5 + 3 n): 1/m, its variance, the last reading (3), NaN before the first, and the
    window of the jump test, n the samples that it looks back.

    Timing: as `RotationEstimator`; the centre of mass is the rotation filter's prediction (3-40).

    Args:
        mass_reciprocal, variance: at the start, 1/slug or 1/kg, and squared.
        accelerometers: packages with an input port.
        accelerometer: name of the one in use.
        position: of the package in use, vehicle frame, ft or m, shape (3,).
        rate_variance: of the error of one rate reading per component, rad^2/s^2.
        settings: see `maths.mass_filter.MassSettings`.
    """

    def __init__(
        self,
        *,
        mass_reciprocal: float,
        variance: float,
        accelerometers: tuple[Package, ...],
        accelerometer: str,
        position: Array,
        rate_variance: float,
        settings: MassSettings,
    ):
        super().__init__()
        self.set_name("mass_estimator")
        self._settings = settings
        self.stopwatch = Stopwatch()
        self._position = np.array(position, dtype=float)
        ports = {package.name: self.DeclareVectorInputPort(package.name, 3) for package in accelerometers}
        self._accelerometer = ports[accelerometer]
        self._noise = increment_noise(next(p.variance for p in accelerometers if p.name == accelerometer))
        self._rate_variance = 2.0 * rate_variance  # of an increment
        self._impulses = self.DeclareVectorInputPort("impulses", N_IMPULSES)
        self._rate_sample = self.DeclareVectorInputPort("rate_sample", 6)
        self._predicted = self.DeclareVectorInputPort("predicted_estimate", N_ROTATION)
        self._predicted_covariance = self.DeclareVectorInputPort("predicted_covariance", N_ROTATION**2)

        self._known_force = self.DeclareVectorInputPort("known_force", N_KNOWN_FORCE)
        self._adaptation = self.DeclareVectorInputPort("adaptation", N_ADAPTATION)
        window = mass_jump.empty_window(settings.jump_window)
        head = [mass_reciprocal, variance, np.nan, np.nan, np.nan]
        self._state = self.DeclareDiscreteState(np.concatenate([head, window.ravel()]))

        # the innovation must not depend on the adaptation: the detector makes the one from the other
        inputs = (
            self._accelerometer,
            self._impulses,
            self._rate_sample,
            self._predicted,
            self._predicted_covariance,
            self._known_force,
        )
        measured = {self.xd_ticket(), *(self.input_port_ticket(port.get_index()) for port in inputs)}
        self._measurement = Cached(self, "measurement", self._measure, measured)
        adapted = {self._measurement.ticket, self.input_port_ticket(self._adaptation.get_index())}
        self._cycle = Cached(self, "cycle", self._finish, {self.xd_ticket(), *adapted})
        self.DeclareStateOutputPort("predicted", self._state)
        for name, size, calc, entry in (
            ("innovation", 3, self._calc_innovation, self._measurement),
            ("innovation_covariance", 9, self._calc_innovation_covariance, self._measurement),
            ("judged", 12, self._calc_judged, self._measurement),
            ("estimate", 2, self._calc_estimate, self._cycle),
            ("status", 6, self._calc_status, self._cycle),
            ("report", 8, self._calc_report, self._cycle),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={entry.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=settings.period_s, offset_sec=0.0, update=self._update)

    def _measure(self, context: Any) -> MassMeasurement:
        rate_sample = self._rate_sample.Eval(context)
        state = context.get_discrete_state(self._state).CopyToVector()
        covariance = self._predicted_covariance.Eval(context).reshape(N_ROTATION, N_ROTATION)
        noise = self._noise
        if self._known_force.HasValue(context):
            known = self._known_force.Eval(context)
            if known.any():
                noise = noise + known[6:15].reshape(3, 3)
        return self.stopwatch.measure(
            mass_filter.measure,
            float(state[0]),
            float(state[1]),
            state[2:5],
            self._accelerometer.Eval(context),
            noise,
            self._position - self._predicted.Eval(context)[6:],
            covariance[6:, 6:],
            rate_sample[:3],
            rate_sample[3:],
            self._rate_variance,
            self._impulses.Eval(context)[3:6],
            self._settings,
        )

    def _finish(self, context: Any) -> MassCycle:
        adaptation = NO_ADAPTATION
        if self._adaptation.HasValue(context):
            adaptation = unpacked(self._adaptation.Eval(context))
        impulses = self._impulses.Eval(context)
        state = context.get_discrete_state(self._state).CopyToVector()
        return self.stopwatch.measure(
            mass_filter.finish,
            float(state[0]),
            float(state[1]),
            state[5:].reshape(-1, 3),
            self._measurement.get(self, context),
            impulses[6] != 0.0,
            impulses[7] != 0.0,
            adaptation,
            self._settings,
        )

    def _calc_innovation(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._measurement.get(self, context).innovation.innovation)

    def _calc_innovation_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._measurement.get(self, context).innovation.covariance.ravel())

    def _calc_judged(self, context: Any, output: Any) -> None:
        innovation = self._measurement.get(self, context).innovation
        vector = np.empty(12)
        vector[:3], vector[3:] = innovation.innovation, innovation.covariance.ravel()
        output.SetFromVector(vector)

    def _calc_estimate(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        output.SetFromVector(np.array([cycle.mass_reciprocal, cycle.variance]))

    def _calc_status(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.array(self._status(context)))

    def _calc_report(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        output.SetFromVector(np.array([cycle.mass_reciprocal, cycle.variance, *self._status(context)]))

    def _status(self, context: Any) -> list[float]:
        innovation = self._measurement.get(self, context).innovation
        cycle = self._cycle.get(self, context)
        return [*innovation.innovation, innovation.nis, cycle.used, cycle.jumped]

    def _update(self, context: Any, state: Any) -> None:
        cycle = self._cycle.get(self, context)
        velocity = self._accelerometer.Eval(context)
        state.set_value(
            self._state, np.concatenate([[cycle.mass_reciprocal, cycle.variance], velocity, cycle.window.ravel()])
        )
