"""The ten estimates side by side, and the test whether they may be acted on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.filters.thesis import joint_covariance
from massprop_drake.maths.mass_properties import N_ROTATION, all_ten, converged
from massprop_drake.systems.layouts import MASS_ESTIMATE

Array = NDArray[np.float64]

_NOT_OBSERVED = np.full(MASS_ESTIMATE.size, np.nan)


class ConvergenceMonitor(LeafSystem):
    """Puts the two filters' estimates together and judges whether they have converged.

    Ports:
        rotation_estimate (in, 9), rotation_covariance (in, 81): see `RotationEstimator`. Required.
        mass_estimate (in, 2): 1/m and its variance. Unconnected: 1/m is NaN, and nothing converges.
        estimate (out, 10): the ten parameters, see `maths.mass_properties`.
        standard_deviation (out, 10): 1-sigma of each.
        covariance (out, 100): of all ten, row by row; nothing is shared between 1/m and the others.
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
        self.DeclareVectorOutputPort("covariance", 100, self._calc_covariance)
        self.DeclareVectorOutputPort("converged", 1, self._calc_converged)

    def _mass_estimate(self, context: Any) -> Any:
        return MASS_ESTIMATE.read(self._mass.Eval(context) if self._mass.HasValue(context) else _NOT_OBSERVED)

    def _rotation_covariance(self, context: Any) -> Array:
        covariance: Array = self._covariance.Eval(context).reshape(N_ROTATION, N_ROTATION)
        return covariance

    def _estimates(self, context: Any) -> Array:
        return all_ten(self._rotation.Eval(context), self._mass_estimate(context).mass_reciprocal)

    def _deviations(self, context: Any) -> Array:
        variance = self._rotation_covariance(context).diagonal()
        return np.sqrt(all_ten(variance, self._mass_estimate(context).variance))

    def _calc_estimate(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._estimates(context))

    def _calc_deviation(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._deviations(context))

    def _calc_covariance(self, context: Any, output: Any) -> None:
        variance = self._mass_estimate(context).variance
        output.SetFromVector(joint_covariance(self._rotation_covariance(context), variance).ravel())

    def _calc_converged(self, context: Any, output: Any) -> None:
        good = converged(self._deviations(context), self._estimates(context), self._limits)
        output.SetFromVector([float(good)])
