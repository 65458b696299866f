"""Estimates inverse inertia and centre of mass."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths import rotation_filter
from massprop_drake.maths.adaptation import N_ADAPTATION, NO_ADAPTATION, unpacked
from massprop_drake.maths.detection import N_KNOWN_FORCE
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.maths.rotation_filter import RotationCycle, RotationMeasurement, RotationSettings
from massprop_drake.maths.sensing import increment_noise
from massprop_drake.systems._caching import Cached, Stopwatch
from massprop_drake.systems.impulse_model import N_IMPULSES

Array = NDArray[np.float64]


class Package(NamedTuple):
    """A sensor package as a filter knows it.

    Attributes:
        name: of its input port.
        variance: of the error of one reading per component.
    """

    name: str
    variance: float


class RotationEstimator(LeafSystem):
    r"""Estimates inverse inertia and centre of mass from rate increments and known impulses.

    The second-order filter (2-115) to (2-123) or the extended Kalman filter, see
    `massprop_drake.maths.rotation_filter`.

    Ports:
        <gyro> (in, 3), one per package: measured rate, rad/s, body axes; NaN where missing. Required
            of the package in use.
        impulses (in, 8): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        predicted_estimate (out, 9): x before this sample's measurement. No feedthrough.
        predicted_covariance (out, 81): its covariance S, row by row. No feedthrough.
        rate_sample (out, 6): measured rate increment (3) and mean rate (3) over the sample, rad/s.
        innovation (out, 3): measured minus predicted rate increment, rad/s, NaN where not measured.
        innovation_covariance (out, 9): row by row, rad^2/s^2.
        judged (out, 12): innovation and innovation_covariance in one, for the detector.
        estimate (out, 9): x after this sample's measurement.
        covariance (out, 81): its covariance S, row by row.
        standard_deviation (out, 9): square roots of its diagonal.
        status (out, 7): the innovation (3) again; its NIS before any covariance increment, NaN where not
            measured; 1 when the sample was used; 1 when the covariance was incremented; 1 when dynamic
            coupling was to be subtracted.
        report (out, 25): estimate, standard_deviation and status in one, for logs.

    State: estimate (9); covariance (81); memory (4): the last reading (3), NaN before the first, and the
    hybrid rule's last decision.

    Timing: outputs at t_k use the reading at t_k and the impulses of [t_k-1, t_k); the update at t_k
    makes `estimate` the next prediction.

    Assumptions and limitations: increments of consecutive samples share a reading and so are not
    independent, as the filter takes them to be; on the early samples the estimates can lock onto a wrong
    trade between inertia and centre of mass, which the covariance increment heals.

    Args:
        estimate, covariance: at the start, shapes (9,) and (9, 9).
        gyros: packages with an input port.
        gyro: name of the one in use.
        settings: see `maths.rotation_filter.RotationSettings`.
    """

    def __init__(
        self,
        *,
        estimate: Array,
        covariance: Array,
        gyros: tuple[Package, ...],
        gyro: str,
        settings: RotationSettings,
    ):
        super().__init__()
        self.set_name("rotation_estimator")
        self._settings = settings
        self.stopwatch = Stopwatch()
        ports = {package.name: self.DeclareVectorInputPort(package.name, 3) for package in gyros}
        self._gyro = ports[gyro]
        self._noise = increment_noise(next(p.variance for p in gyros if p.name == gyro))
        self._impulses = self.DeclareVectorInputPort("impulses", N_IMPULSES)

        self._known_force = self.DeclareVectorInputPort("known_force", N_KNOWN_FORCE)
        self._adaptation = self.DeclareVectorInputPort("adaptation", N_ADAPTATION)

        self._estimate = self.DeclareDiscreteState(estimate)
        self._covariance = self.DeclareDiscreteState(covariance.ravel())
        self._memory = self.DeclareDiscreteState([np.nan, np.nan, np.nan, 0.0])

        # the innovation must not depend on the adaptation: the detector makes the one from the other
        inputs = (self._gyro, self._impulses, self._known_force)
        measured = {self.xd_ticket(), *(self.input_port_ticket(port.get_index()) for port in inputs)}
        self._measurement = Cached(self, "measurement", self._measure, measured)
        adapted = {self._measurement.ticket, self.input_port_ticket(self._adaptation.get_index())}
        self._cycle = Cached(self, "cycle", self._finish, {self.xd_ticket(), *adapted})
        self.DeclareStateOutputPort("predicted_estimate", self._estimate)
        self.DeclareStateOutputPort("predicted_covariance", self._covariance)
        for name, size, calc, entry in (
            ("rate_sample", 6, self._calc_rate_sample, self._measurement),
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
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=settings.period_s, offset_sec=0.0, update=self._update)

    def _predicted(self, context: Any) -> tuple[Array, Array]:
        covariance = context.get_discrete_state(self._covariance).CopyToVector()
        estimate = context.get_discrete_state(self._estimate).CopyToVector()
        return estimate, covariance.reshape(N_ROTATION, N_ROTATION)

    def _measure(self, context: Any) -> RotationMeasurement:
        impulses = self._impulses.Eval(context)
        memory = context.get_discrete_state(self._memory).CopyToVector()
        noise, acting = self._noise, impulses[7] != 0.0
        if self._known_force.HasValue(context):
            known = self._known_force.Eval(context)
            if known.any():
                noise, acting = noise + known[15:].reshape(3, 3), True
        return self.stopwatch.measure(
            rotation_filter.measure,
            *self._predicted(context),
            memory[:3],
            memory[3] != 0.0,
            self._gyro.Eval(context),
            noise,
            impulses[:3],
            impulses[3:6],
            acting,
            self._settings,
        )

    def _finish(self, context: Any) -> RotationCycle:
        adaptation = NO_ADAPTATION
        if self._adaptation.HasValue(context):
            adaptation = unpacked(self._adaptation.Eval(context))
        measurement = self._measurement.get(self, context)
        # a known force alone is no reason to learn: it may have ceased
        usable = bool(self._impulses.Eval(context)[6:8].all())
        return self.stopwatch.measure(
            rotation_filter.finish,
            *self._predicted(context),
            measurement,
            usable,
            adaptation,
            self._settings,
        )

    def _calc_rate_sample(self, context: Any, output: Any) -> None:
        sample = self._measurement.get(self, context).sample
        output.SetFromVector(np.concatenate([sample.increment, sample.rate]))

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
        output.SetFromVector(self._cycle.get(self, context).estimate)

    def _calc_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).covariance.ravel())

    def _calc_deviation(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.sqrt(self._cycle.get(self, context).covariance.diagonal()))

    def _calc_status(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._status(context))

    def _calc_report(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        deviation = np.sqrt(cycle.covariance.diagonal())
        output.SetFromVector(np.concatenate([cycle.estimate, deviation, self._status(context)]))

    def _status(self, context: Any) -> Array:
        cycle = self._cycle.get(self, context)
        before = self._measurement.get(self, context).innovation
        return np.array([*before.innovation, before.nis, cycle.used, cycle.jumped, before.subtract_coupling])

    def _update(self, context: Any, state: Any) -> None:
        cycle = self._cycle.get(self, context)
        subtract_coupling = self._measurement.get(self, context).innovation.subtract_coupling
        state.set_value(self._estimate, cycle.estimate)
        state.set_value(self._covariance, cycle.covariance.ravel())
        state.set_value(self._memory, np.append(self._gyro.Eval(context), subtract_coupling))
