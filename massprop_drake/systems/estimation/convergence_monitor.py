"""The ten estimates side by side, and the test whether they may be acted on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.estimation.filters.thesis import joint_covariance
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import N_ROTATION, is_converged, join_ten_parameters
from massprop_drake.systems.caching import Cached, Part, declare_outputs
from massprop_drake.systems.layouts import MASS_ESTIMATE

_NOT_OBSERVED = np.full(MASS_ESTIMATE.size, np.nan)


class Ten(NamedTuple):
    """Estimate, 1-sigma and covariance of the ten parameters."""

    estimate: Array
    deviation: Array
    covariance: Array


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
        limits: see `maths.mass_properties.is_converged`, shape (3,).
    """

    def __init__(self, limits: Array):
        super().__init__()
        self.set_name("convergence_monitor")
        self._rotation = self.DeclareVectorInputPort("rotation_estimate", N_ROTATION)
        self._covariance = self.DeclareVectorInputPort("rotation_covariance", N_ROTATION**2)
        self._mass = self.DeclareVectorInputPort("mass_estimate", 2)
        known = Cached(self, "ten", self._join_estimates, {self.all_input_ports_ticket()})
        outputs: list[tuple[str, int, Part]] = [
            ("estimate", 10, lambda ten: ten.estimate),
            ("standard_deviation", 10, lambda ten: ten.deviation),
            ("covariance", 100, lambda ten: ten.covariance.ravel()),
            ("converged", 1, lambda ten: np.array([float(is_converged(ten.deviation, ten.estimate, limits))])),
        ]
        declare_outputs(self, known, outputs)

    def _join_estimates(self, context: Any) -> Ten:
        """Joins both filters' estimates of the ten parameters, their 1-sigmas and covariance."""
        mass = MASS_ESTIMATE.read(self._mass.Eval(context) if self._mass.HasValue(context) else _NOT_OBSERVED)
        covariance = self._covariance.Eval(context).reshape(N_ROTATION, N_ROTATION)
        estimate = join_ten_parameters(self._rotation.Eval(context), mass.mass_reciprocal)
        deviation = np.sqrt(join_ten_parameters(covariance.diagonal(), mass.variance))
        return Ten(estimate, deviation, joint_covariance(covariance, mass.variance))
