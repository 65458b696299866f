"""Estimates inverse inertia and centre of mass."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths import rotation_filter
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.maths.rotation_filter import RotationCycle, RotationSettings
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
        predicted_estimate (out, 9): x before this sample's measurement. No feedthrough.
        predicted_covariance (out, 81): its covariance S, row by row. No feedthrough.
        rate_sample (out, 6): measured rate increment (3) and mean rate (3) over the sample, rad/s.
        innovation (out, 3): measured minus predicted rate increment, rad/s, NaN where not measured.
        innovation_covariance (out, 9): row by row, rad^2/s^2.
        estimate (out, 9): x after this sample's measurement.
        covariance (out, 81): its covariance S, row by row.
        standard_deviation (out, 9): square roots of its diagonal.
        status (out, 7): the innovation (3) again; its NIS before any covariance increment, NaN where not
            measured; 1 when the sample was used; 1 when the covariance was incremented; 1 when dynamic
            coupling was to be subtracted. One port, because all of it is logged.

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

        self._estimate = self.DeclareDiscreteState(estimate)
        self._covariance = self.DeclareDiscreteState(covariance.ravel())
        self._memory = self.DeclareDiscreteState([np.nan, np.nan, np.nan, 0.0])

        measured = {
            self.input_port_ticket(self._gyro.get_index()),
            self.input_port_ticket(self._impulses.get_index()),
            self.xd_ticket(),
        }
        self._cycle = Cached(self, "cycle", self._compute, measured)
        self.DeclareStateOutputPort("predicted_estimate", self._estimate)
        self.DeclareStateOutputPort("predicted_covariance", self._covariance)
        for name, size, calc in (
            ("rate_sample", 6, self._calc_rate_sample),
            ("innovation", 3, self._calc_innovation),
            ("innovation_covariance", 9, self._calc_innovation_covariance),
            ("estimate", N_ROTATION, self._calc_estimate),
            ("covariance", N_ROTATION**2, self._calc_covariance),
            ("standard_deviation", N_ROTATION, self._calc_deviation),
            ("status", 7, self._calc_status),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._cycle.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=settings.period_s, offset_sec=0.0, update=self._update)

    def _compute(self, context: Any) -> RotationCycle:
        impulses = self._impulses.Eval(context)
        memory = context.get_discrete_state(self._memory).CopyToVector()
        return self.stopwatch.measure(
            rotation_filter.cycle,
            context.get_discrete_state(self._estimate).CopyToVector(),
            context.get_discrete_state(self._covariance).CopyToVector().reshape(N_ROTATION, N_ROTATION),
            memory[:3],
            memory[3] != 0.0,
            self._gyro.Eval(context),
            self._noise,
            impulses[:3],
            impulses[3:6],
            impulses[6] != 0.0,
            impulses[7] != 0.0,
            self._settings,
        )

    def _calc_rate_sample(self, context: Any, output: Any) -> None:
        sample = self._cycle.get(self, context).sample
        output.SetFromVector(np.concatenate([sample.increment, sample.rate]))

    def _calc_innovation(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).innovation.innovation)

    def _calc_innovation_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).innovation.covariance.ravel())

    def _calc_estimate(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).estimate)

    def _calc_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._cycle.get(self, context).covariance.ravel())

    def _calc_deviation(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.sqrt(self._cycle.get(self, context).covariance.diagonal()))

    def _calc_status(self, context: Any, output: Any) -> None:
        cycle = self._cycle.get(self, context)
        before = cycle.innovation
        output.SetFromVector(
            np.array([*before.innovation, before.nis, cycle.used, cycle.jumped, before.subtract_coupling])
        )

    def _update(self, context: Any, state: Any) -> None:
        cycle = self._cycle.get(self, context)
        state.set_value(self._estimate, cycle.estimate)
        state.set_value(self._covariance, cycle.covariance.ravel())
        state.set_value(self._memory, np.append(self._gyro.Eval(context), cycle.innovation.subtract_coupling))
