"""Estimates all ten mass properties with one filter of any method."""

from __future__ import annotations

from typing import Any

from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.estimation.filter import Filter, FilterStep
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.estimation._filter import Measured, WholeFilterSystem
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.layouts import EVIDENCE
from massprop_drake.systems.stopwatch import ESTIMATORS, timed


class FilterEstimator(WholeFilterSystem):
    """Runs a filter of the registry `massprop_drake.maths.estimation.filters` that is not split into systems.

    The same outputs as `RotationEstimator`, `MassEstimator` and `ConvergenceMonitor` give together, whatever the
    method and the size of its state.

    Ports:
        <gyro> (in, 3), <accelerometer> (in, 3), one per package: as `RotationEstimator` and `MassEstimator`.
        impulses (in, 8), mean_level (in, n_jets): see `ImpulseModel`. Required.
        known_force (in, 24), adaptation (in, 26): see `FailureDetector`. Unconnected: no failures.
        predicted (out, 10), evidence (out, 213): see `MassEstimator`.
        estimate (out, 10), standard_deviation (out, 10), covariance (out, 100), converged (out, 1): of the ten
            parameters, after this sample's measurement; see `ConvergenceMonitor`.
        rotation_report (out, 28), mass_report (out, 11): see `RotationEstimator` and `MassEstimator`.

    State: the filter's, the vectors that its `saved` gives one after the other.

    Timing: as `RotationEstimator`.

    Args:
        name: of the method, and of the system.
        method: see `Filter`.
        params: its parameters.
        gyros, accelerometers: packages with an input port, the preferred one first.
        n_jets: number of jets.
        limits: of convergence, see `maths.mass_properties.converged`, shape (3,).
        period_s: sample period, s.
    """

    def __init__(
        self,
        name: str,
        method: Filter,
        params: Any,
        *,
        gyros: tuple[Package, ...],
        accelerometers: tuple[Package, ...],
        n_jets: int,
        limits: Array,
        period_s: float,
    ):
        super().__init__(name, n_jets)
        self._method, self._params, self._limits = method, params, limits
        self._gyros, self._accelerometers = self._declare_packages(gyros), self._declare_packages(accelerometers)
        self._declare_interval()
        initial = method.saved(method.initial(params), params)
        self._fields = Layout(name, **{part: vector.size for part, vector in initial.items()})
        self._state = self.DeclareDiscreteState(self._fields.pack(tuple(initial.values())))
        self.DeclareVectorOutputPort("predicted", 10, self._calc_predicted, prerequisites_of_calc={self.xd_ticket()})
        self._declare_cycle(
            (("evidence", EVIDENCE.size, self._calc_evidence),),
            self._reports(),
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _restored(self, context: Any) -> Any:
        groups = self._fields.read(context.get_discrete_state(self._state).CopyToVector())._asdict()
        return self._method.restored(groups, self._params)

    def _measure(self, context: Any) -> Measured:
        state, interval = self._restored(context), self._interval(context)
        rates, velocities = self._gyros.eval(context), self._accelerometers.eval(context)
        measurement = timed(ESTIMATORS, self._method.measure, state, rates, velocities, interval, self._params)
        return Measured(state, interval, measurement, None)

    def _finish(self, measured: Measured, adaptation: Adaptation) -> FilterStep:
        state, interval, measurement, _ = measured
        step: FilterStep = timed(
            ESTIMATORS, self._method.finish, state, measurement, interval, adaptation, self._params
        )
        return step

    def _step(self, context: Any) -> FilterStep:
        _, step = self._cycled(context)
        return step

    def _known_of(self, state: Any) -> tuple[Array, Array]:
        return self._method.predicted(state), self._method.covariance(state)

    def _calc_predicted(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._method.predicted(self._restored(context)))

    def _calc_evidence(self, context: Any, output: Any) -> None:
        state, interval, measurement, _ = self._measured(context)
        output.SetFromVector(EVIDENCE.pack(self._method.evidence(state, measurement, interval)))

    def _update(self, context: Any, state: Any) -> None:
        groups = self._method.saved(self._step(context).state, self._params)
        state.set_value(self._state, self._fields.pack(tuple(groups.values())))
