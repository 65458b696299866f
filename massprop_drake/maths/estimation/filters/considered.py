r"""Considered thrust errors: what both filters' Schmidt-Kalman updates share.

No jet gives exactly its thrust: jet j is off by the constant fraction sigma_j beta_j, with beta unknown and of unit
variance, never estimated. The error of the state x is Psi beta and a part independent of beta, of covariance S_0. With
G what one sigma of each thrust error does to the measurement directly,

    L = H Psi + G,    Y = H S_0 H^T + L L^T + noise,    K = (S_0 H^T + Psi L^T) Y^-1,    Psi <- Psi - K L

L is what one sigma of each thrust error does to the innovation. Products of both errors are part of the prediction and
of the noise, see the filters. The update is made twice, the second time with G at the estimate that the first one gave.

Source: own, on the filters of D. R. Levy, MIT S.M. thesis, 1983.
"""

from __future__ import annotations

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array


@kernel
def add_noise(noise: Array, extra: Array | None) -> Array:
    """Adds a further noise covariance to a noise covariance; None: the first is returned as it is."""
    if extra is None:
        return noise
    return noise + extra


@kernel
def add_effect_covariance(covariance: Array, effects: Array | None) -> Array:
    """Adds L L^T, the innovation covariance by considered thrust errors; L of None: adds nothing."""
    if effects is None:
        return covariance
    return covariance + effects @ effects.T


@kernel
def update_sensitivity(sensitivity: Array | None, gain: Array, effects: Array | None) -> Array | None:
    """Updates the estimate's sensitivity to thrust errors by a measurement, Psi - K L; L of None: Psi itself."""
    if effects is None or sensitivity is None:
        return sensitivity
    return sensitivity - gain @ effects
