"""Parts that the systems around the thesis's two filters have in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Adaptation, pack_adaptation, unpack_adaptation
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, unpack_known_force
from massprop_drake.maths.estimation.filter import Interval
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import Cached, Part, declare_outputs, declare_update
from massprop_drake.systems.estimation._readings import KnownPackage, Readings
from massprop_drake.systems.layouts import ADAPTATION, IMPULSES, KNOWN_FORCE

Ports = tuple[tuple[str, int, Part], ...]

_NO_LEVEL = np.empty(0)
_NO_FORCE, _NOTHING_ASKED = np.zeros(KNOWN_FORCE.size), pack_adaptation(NO_ADAPTATION)


class MeasuredFilter(NamedTuple):
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
    """System of a filter that measures, is judged by the detector, and finishes its cycle as the detector asks.

    A system that derives from it calls `_declare_cycle` once its ports and state are declared, and gives
    `_measure(context)`, and `_compute_cycle(context)`: the report, and after it the state after the cycle.

    Args:
        name: of the system.
        n_levels: number of jets whose mean thrust levels it reads; 0: none.
    """

    def __init__(self, name: str, n_levels: int):
        super().__init__()
        self.set_name(name)
        self._n_levels = n_levels
        self._inputs: list[Any] = []

    def _declare_packages(self, packages: tuple[KnownPackage, ...]) -> Readings:
        """Declares an input port for each sensor package, and returns their readings."""
        readings = Readings(self, packages)
        self._inputs += readings.ports
        return readings

    def _declare_input(self, name: str, size: int) -> Any:
        """Declares a vector input port that the measurement depends on, and returns it."""
        port = self.DeclareVectorInputPort(name, size)
        self._inputs.append(port)
        return port

    def _declare_interval(self) -> None:
        """Declares input ports of impulses, known force, mean levels, and the detector's adaptation."""
        self._impulses = self._declare_input("impulses", IMPULSES.size)
        self._known_force = self._declare_input("known_force", KNOWN_FORCE.size)
        self._adaptation = self.DeclareVectorInputPort("adaptation", ADAPTATION.size)
        self._mean_level = self._declare_input("mean_level", self._n_levels) if self._n_levels else None

    def _declare_cycle(self, measurement_ports: Ports, cycle_ports: Ports, period_s: float, state_slice: slice) -> None:
        """Declares output ports of the measurement and of the cycle, and the periodic update of the state."""
        # the innovation must not depend on the adaptation: the detector makes the one from the other
        tickets = {self.xd_ticket(), *(port.ticket() for port in self._inputs)}
        self._measurement = Cached(self, "measurement", self._measure, tickets)
        adapted_tickets = {self._measurement.ticket, self._adaptation.ticket()}
        cycle = Cached(self, "cycle", self._compute_cycle, {self.xd_ticket(), *adapted_tickets})
        declare_outputs(self, self._measurement, measurement_ports)
        declare_outputs(self, cycle, cycle_ports)
        declare_update(self, cycle, period_s, state_slice)

    def _interval(self, context: Any) -> Interval:
        """Reads the interval's impulses and known force from the input ports; mean thrust levels only where used."""
        known = NO_KNOWN_FORCE
        if self._known_force.HasValue(context):
            known = unpack_known_force(self._known_force.Eval(context))
        mean_level = _NO_LEVEL if self._mean_level is None else self._mean_level.Eval(context)
        row = IMPULSES.read(self._impulses.Eval(context))
        impulses = Impulses(row.angular_impulse, row.linear_impulse, row.usable, row.firing, _NO_LEVEL, mean_level)
        return Interval(impulses, known)

    def _requested_adaptation(self, context: Any) -> Adaptation:
        """Reads the adaptation of the filter that the detector requests; a neutral one without a detector."""
        return (
            unpack_adaptation(self._adaptation.Eval(context)) if self._adaptation.HasValue(context) else NO_ADAPTATION
        )

    def _interval_vectors(self, context: Any) -> tuple[Array, Array]:
        """Reads the vectors of impulses and known force from the input ports, as compiled kernels take them."""
        known_force = self._known_force.Eval(context) if self._known_force.HasValue(context) else _NO_FORCE
        return self._impulses.Eval(context), known_force

    def _read_adaptation(self, context: Any) -> Array:
        """Reads the adaptation that the detector requests as a vector, as compiled kernels take it."""
        row: Array = self._adaptation.Eval(context) if self._adaptation.HasValue(context) else _NOTHING_ASKED
        return row

    def _measure(self, context: Any) -> Any:
        """Computes the first half of the filter's cycle: the measurement and its innovation."""
        raise NotImplementedError

    def _compute_cycle(self, context: Any) -> Array:
        """Runs the filter's cycle; returns the report, then the state after it, as one vector."""
        raise NotImplementedError
