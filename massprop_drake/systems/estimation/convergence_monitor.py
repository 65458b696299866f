"""The ten estimates side by side, and whether they may be acted on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.mass_properties import N_ROTATION, converged

Array = NDArray[np.float64]


class ConvergenceMonitor(LeafSystem):
    """Puts the two filters' estimates together and judges whether they have converged.

    Ports:
        rotation_estimate (in, 9), rotation_covariance (in, 81): see `RotationEstimator`. Required.
        mass_estimate (in, 2): 1/m and its variance. Unconnected: 1/m is NaN, and nothing converges.
        estimate (out, 10): the ten parameters, see `maths.mass_properties`.
        standard_deviation (out, 10): 1-sigma of each.
        converged (out, 1): 1 when every 1-sigma is within its limit.

    Timing: outputs at t_k include the measurement at t_k.

    Args:
        limits: see `maths.mass_properties.converged`, shape (3,).
    """

    def __init__(self, limits: Array):
        super().__init__()
        self.set_name("convergence_monitor")
        self._limits = limits
        self._rotation = self.DeclareVectorInputPort("rotation_estimate", N_ROTATION)
        self._covariance = self.DeclareVectorInputPort("rotation_covariance", N_ROTATION**2)
        self._mass = self.DeclareVectorInputPort("mass_estimate", 2)
        self.DeclareVectorOutputPort("estimate", 10, self._calc_estimate)
        self.DeclareVectorOutputPort("standard_deviation", 10, self._calc_deviation)
        self.DeclareVectorOutputPort("converged", 1, self._calc_converged)

    def _mass_estimate(self, context: Any) -> Array:
        if self._mass.HasValue(context):
            return self._mass.Eval(context)
        return np.full(2, np.nan)

    def _estimates(self, context: Any) -> Array:
        return np.append(self._rotation.Eval(context), self._mass_estimate(context)[0])

    def _deviations(self, context: Any) -> Array:
        variance = self._covariance.Eval(context)[:: N_ROTATION + 1]
        return np.sqrt(np.append(variance, self._mass_estimate(context)[1]))

    def _calc_estimate(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._estimates(context))

    def _calc_deviation(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._deviations(context))

    def _calc_converged(self, context: Any, output: Any) -> None:
        good = converged(self._deviations(context), self._estimates(context), self._limits)
        output.SetFromVector([float(good)])
