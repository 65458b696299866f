"""What the systems around both filters have in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Adaptation, unpacked
from massprop_drake.systems.caching import Cached

Array = NDArray[np.float64]


class Measured(NamedTuple):
    """First half of a filter's cycle, in one cache entry.

    Attributes:
        measurement: see `measure` of the filter.
        readings: of its packages, shape (s, 3).
        state: of the filter before.
    """

    measurement: Any
    readings: Array
    state: Any


class Finished(NamedTuple):
    """Both halves of a filter's cycle, in one cache entry.

    Attributes:
        cycle: see `finish` of the filter.
        measurement, readings: see `Measured`.
    """

    cycle: Any
    measurement: Any
    readings: Array


class Filter(LeafSystem):
    """A filter that measures, is judged by the detector, and finishes its cycle as the detector says.

    A system that derives from it sets `_measurement`, whose entry is a `Measured`, and `_adaptation`.
    """

    _measurement: Cached
    _adaptation: Any

    def _measured(self, context: Any) -> Any:
        return self._measurement.get(self, context).measurement

    def _adapted(self, context: Any) -> Adaptation:
        """What the detector asks for; nothing where there is none."""
        return unpacked(self._adaptation.Eval(context)) if self._adaptation.HasValue(context) else NO_ADAPTATION

    def _calc_effects(self, context: Any, output: Any) -> None:
        effects = self._measured(context).innovation.effects
        output.SetFromVector(np.zeros(output.size()) if effects is None else effects.ravel())

    def _calc_innovation(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._measured(context).innovation.innovation)

    def _calc_innovation_covariance(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._measured(context).innovation.covariance.ravel())

    def _calc_judged(self, context: Any, output: Any) -> None:
        innovation = self._measured(context).innovation
        vector = np.empty(12)
        vector[:3], vector[3:] = innovation.innovation, innovation.covariance.ravel()
        output.SetFromVector(vector)
