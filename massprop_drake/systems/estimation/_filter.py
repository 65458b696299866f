"""What the systems around filters have in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Adaptation, packed, unpacked
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, known_force_of
from massprop_drake.maths.estimation.filter import Filter, FilterStep, Interval
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import converged
from massprop_drake.systems.caching import NOTHING, Cached
from massprop_drake.systems.estimation._readings import Package, Readings
from massprop_drake.systems.layouts import ADAPTATION, IMPULSES, KNOWN_FORCE, MASS_REPORT, ROTATION_REPORT

Ports = tuple[tuple[str, int, Any], ...]  # name, size and callback of output ports

_NO_LEVEL = np.empty(0)
_NO_FORCE, _NOTHING_ASKED = np.zeros(KNOWN_FORCE.size), packed(NO_ADAPTATION)


class Measured(NamedTuple):
    """First half of a filter's cycle, in one cache entry.

    Attributes:
        state: of the filter before.
        interval: see `maths.estimation.filter.Interval`.
        measurement: what the filter makes of the sample.
        readings: of its packages.
    """

    state: Any
    interval: Interval
    measurement: Any
    readings: Any


class FilterSystem(LeafSystem):
    """A filter that measures, is judged by the detector, and finishes its cycle as the detector says.

    A system that derives from it calls `_declare_cycle` once its ports and state are declared, and gives
    `_measure(context) -> Measured` and `_finish(measured, adaptation) -> cycle`.

    Args:
        name: of the system.
        n_levels: number of jets whose mean thrust levels it reads; 0: none.
    """

    def __init__(self, name: str, n_levels: int):
        super().__init__()
        self.set_name(name)
        self._n_levels = n_levels
        self._inputs: list[Any] = []

    def _declare_packages(self, packages: tuple[Package, ...]) -> Readings:
        readings = Readings(self, packages)
        self._inputs += readings.ports
        return readings

    def _declare_input(self, name: str, size: int) -> Any:
        """An input port that the measurement depends on."""
        port = self.DeclareVectorInputPort(name, size)
        self._inputs.append(port)
        return port

    def _declare_interval(self) -> None:
        """Ports of what is known of the interval, and of what the detector says."""
        self._impulses = self._declare_input("impulses", IMPULSES.size)
        self._known_force = self._declare_input("known_force", KNOWN_FORCE.size)
        self._adaptation = self.DeclareVectorInputPort("adaptation", ADAPTATION.size)
        self._mean_level = self._declare_input("mean_level", self._n_levels) if self._n_levels else None

    def _declare_cycle(self, outputs: Ports, reports: Ports) -> None:
        """Cache entries and output ports: of the measurement alone, and of the whole cycle."""
        # the innovation must not depend on the adaptation: the detector makes the one from the other
        measured = {self.xd_ticket(), *(self.input_port_ticket(port.get_index()) for port in self._inputs)}
        self._measurement = Cached(self, "measurement", self._measure, measured)
        adapted = {self._measurement.ticket, self.input_port_ticket(self._adaptation.get_index())}
        self._cycle = Cached(self, "cycle", self._compute_cycle, {self.xd_ticket(), *adapted})
        for entry, ports in ((self._measurement, outputs), (self._cycle, reports)):
            for name, size, calc in ports:
                self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={entry.ticket})

    def _interval(self, context: Any) -> Interval:
        """What is known of the interval; mean levels only where they are read."""
        known = NO_KNOWN_FORCE
        if self._known_force.HasValue(context):
            known = known_force_of(self._known_force.Eval(context))
        mean_level = _NO_LEVEL if self._mean_level is None else self._mean_level.Eval(context)
        told = IMPULSES.read(self._impulses.Eval(context))
        impulses = Impulses(told.angular_impulse, told.linear_impulse, told.usable, told.firing, _NO_LEVEL, mean_level)
        return Interval(impulses, known)

    def _adapted(self, context: Any) -> Adaptation:
        """What the detector asks for; nothing where there is none."""
        return unpacked(self._adaptation.Eval(context)) if self._adaptation.HasValue(context) else NO_ADAPTATION

    def _told(self, context: Any) -> tuple[Array, Array]:
        """Impulses and known force as they are packed, for compiled kernels."""
        known = self._known_force.Eval(context) if self._known_force.HasValue(context) else _NO_FORCE
        return self._impulses.Eval(context), known

    def _asked(self, context: Any) -> Array:
        """What the detector asks for as it is packed, for compiled kernels."""
        asked: Array = self._adaptation.Eval(context) if self._adaptation.HasValue(context) else _NOTHING_ASKED
        return asked

    def _measured(self, context: Any) -> Measured:
        measured: Measured = self._measurement.get(context)
        return measured

    def _cycled(self, context: Any) -> tuple[Measured, Any]:
        """The measurement, and what became of it."""
        cycled: tuple[Measured, Any] = self._cycle.get(context)
        return cycled

    def _measure(self, context: Any) -> Measured:
        raise NotImplementedError

    def _compute_cycle(self, context: Any) -> Any:
        """The measurement, and what became of it; what a system wants that has ports of its own for it."""
        adaptation = self._adapted(context)
        measured = self._measured(context)
        return measured, self._finish(measured, adaptation)

    def _finish(self, measured: Measured, adaptation: Adaptation) -> Any:
        raise NotImplementedError


class WholeFilterSystem(FilterSystem):
    """A filter of all ten mass properties in one system, and the ports that say what its cycle gave.

    A system that derives from it gives `_step(context) -> FilterStep` and `_known_of(state) -> (estimate, covariance)`
    of the ten parameters, and has its convergence limits, `mass_properties.converged`, in `_limits`.
    """

    _limits: Array

    def _reports(self) -> Ports:
        """Output ports of the cycle."""
        return (
            ("estimate", 10, self._calc_estimate),
            ("standard_deviation", 10, self._calc_deviation),
            ("covariance", 100, self._calc_covariance),
            ("converged", 1, self._calc_converged),
            ("rotation_report", ROTATION_REPORT.size, self._calc_rotation),
            ("mass_report", MASS_REPORT.size, self._calc_mass),
        )

    def _declare_judged(self) -> None:
        """Ports of what a detector that is made for the filter makes of its state."""
        self._replacement = self.DeclareAbstractInputPort("replacement", Value[object](NOTHING))
        self._published = self.DeclareAbstractInputPort("published", Value[object](NOTHING))

    def _as_judged(self, context: Any, step: FilterStep, method: Filter, params: Any) -> FilterStep:
        """The cycle as these ports have it; as it is where they say nothing."""
        for port, taken in ((self._replacement, method.replaced), (self._published, method.published)):
            given = port.Eval(context) if port.HasValue(context) else NOTHING
            step = taken(step, given, params) if given else step
        return step

    def _step(self, context: Any) -> FilterStep:
        raise NotImplementedError

    def _known_of(self, state: Any) -> tuple[Array, Array]:
        raise NotImplementedError

    def _known_now(self, context: Any) -> tuple[Array, Array]:
        """Estimate and covariance of the ten parameters after the cycle."""
        step = self._step(context)
        return step.known or self._known_of(step.state)

    def _calc_estimate(self, context: Any, output: Any) -> None:
        estimate, _ = self._known_now(context)
        output.SetFromVector(estimate)

    def _calc_deviation(self, context: Any, output: Any) -> None:
        _, covariance = self._known_now(context)
        output.SetFromVector(np.sqrt(covariance.diagonal()))

    def _calc_covariance(self, context: Any, output: Any) -> None:
        _, covariance = self._known_now(context)
        output.SetFromVector(covariance.ravel())

    def _calc_converged(self, context: Any, output: Any) -> None:
        estimate, covariance = self._known_now(context)
        output.SetFromVector([float(converged(np.sqrt(covariance.diagonal()), estimate, self._limits))])

    def _calc_rotation(self, context: Any, output: Any) -> None:
        output.SetFromVector(ROTATION_REPORT.pack(self._step(context).rotation))

    def _calc_mass(self, context: Any, output: Any) -> None:
        report = self._step(context).mass
        output.SetFromVector(np.full(MASS_REPORT.size, np.nan) if report is None else MASS_REPORT.pack(report))


class Memory(NamedTuple):
    """What a system remembers whose filter's state is no vector. Never changed; a cycle makes a new one.

    Attributes:
        before: state before the newest sample.
        measurement: of it, before the detector has judged it; None: there has been none.
        step: the whole cycle; None: there has been none.
        time_s: of that sample.
    """

    before: Any
    measurement: Any
    step: FilterStep | None
    time_s: float

    @property
    def state(self) -> Any:
        """After it."""
        return self.before if self.step is None else self.step.state

    def __deepcopy__(self, _memo: Any) -> Memory:
        """Itself: a clone of a context shares what is never changed."""
        return self


class RememberingFilterSystem(WholeFilterSystem):
    """A filter of all ten mass properties whose state is no vector, in one system.

    A system that derives from it calls `_declare_memory` once its input ports are declared, and gives
    `_measure_sample(context, state)`, `_finish_sample(context, measurement) -> FilterStep` and
    `_evidence_of(measurement)`.
    Its filter's state has the `estimate` and the `covariance` of the ten parameters.
    """

    def _declare_memory(self, initial: Any, period_s: float, own: Ports) -> None:
        """State, cache entries, output ports and the update.

        Args:
            initial: state of the filter before the first sample.
            period_s: sample period, s.
            own: output ports of the cycle besides those of `_reports`.
        """
        self._declare_judged()
        self._memory = self.DeclareAbstractState(Value[object](Memory(initial, None, None, -np.inf)))
        inputs = {self.input_port_ticket(port.get_index()) for port in self._inputs}
        measured = {self.xa_ticket(), self.time_ticket(), *inputs}
        self._measurement = Cached(self, "measurement", self._measure_cycle, measured)
        given = {self.input_port_ticket(port.get_index()) for port in (self._replacement, self._published)}
        judged = {self._measurement.ticket, *given}
        self._cycle = Cached(self, "cycle", self._finish_cycle, judged)
        self.DeclareVectorOutputPort("predicted", 10, self._calc_predicted, prerequisites_of_calc={self.xa_ticket()})
        self.DeclareAbstractOutputPort(
            "evidence",
            alloc=lambda: Value[object](NOTHING),
            calc=self._calc_evidence,
            prerequisites_of_calc={self._measurement.ticket},
        )
        for name, size, calc in (*self._reports(), *own):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self._cycle.ticket})
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _measure_sample(self, context: Any, state: Any) -> Any:
        raise NotImplementedError

    def _finish_sample(self, context: Any, measurement: Any) -> FilterStep:
        raise NotImplementedError

    def _evidence_of(self, measurement: Any) -> Any:
        raise NotImplementedError

    def _remembered(self, context: Any) -> Memory:
        memory: Memory = context.get_abstract_state(self._memory).get_value()
        return memory

    def _is_now(self, context: Any) -> bool:
        """Whether the newest cycle is of this time."""
        memory = self._remembered(context)
        return memory.step is not None and memory.time_s == context.get_time()

    def _measure_cycle(self, context: Any) -> Any:
        memory = self._remembered(context)
        return memory.measurement if self._is_now(context) else self._measure_sample(context, memory.state)

    def _finish_cycle(self, context: Any) -> FilterStep:
        if self._is_now(context):
            step = self._remembered(context).step
            assert step is not None
            return step
        return self._finish_sample(context, self._measurement.get(context))

    def _step(self, context: Any) -> FilterStep:
        step: FilterStep = self._cycle.get(context)
        return step

    def _known_of(self, state: Any) -> tuple[Array, Array]:
        return state.estimate, state.covariance

    def _calc_predicted(self, context: Any, output: Any) -> None:
        memory = self._remembered(context)
        known = memory.before if self._is_now(context) else memory.state
        output.SetFromVector(known.estimate)

    def _calc_evidence(self, context: Any, output: Any) -> None:
        output.set_value(self._evidence_of(self._measurement.get(context)))

    def _update(self, context: Any, state: Any) -> None:
        memory = self._remembered(context)
        before = memory.before if self._is_now(context) else memory.state
        newest = Memory(before, self._measurement.get(context), self._step(context), context.get_time())
        state.get_mutable_abstract_state(self._memory).set_value(newest)
