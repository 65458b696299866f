r"""The second-order filter for inverse inertia and centre of mass from rate increments.

Measurement of one sample, bilinear in the state x (order in `mass_properties`):

    z = w_k - w_{k-1} = h(x) + noise,    h(x) = I^-1 (a + lambda x r_cm)      (2-47), (2-55)

With S the covariance of x and P (6x6), C (6x3), Q (3x3) its blocks, the exact moments of z under a
Gaussian x are, in closed form,

    H   = [ A_6(a + lambda x r_cm),  I^-1 [lambda x] ]                        (2-102)
    h^  = h(x^) + b,    b_i = E{ (dI^-1 (lambda x dr))_i }                    (2-118)
    D_ij = cov of the i-th and j-th elements of dI^-1 (lambda x dr)           (2-121)
    Y   = H S H^T + D + R                                                     (2-120)

where A_6(v) x_6 = I^-1 v. The second-order terms b and D come from the one product of errors
dI^-1 (lambda x dr), so with E(i, m) the state's index of I^-1_im and X = C [lambda x]^T:

    b_i  = sum_m X[E(i, m), m]
    D_ij = sum_mn P[E(i, m), E(j, n)] ([lambda x] Q [lambda x]^T)_mn + sum_mn X[E(i, m), n] X[E(j, n), m]

The update is Joseph's form (2-126). The extended Kalman filter is the same without b and D (2.6).

Source: D. R. Levy, MIT S.M. thesis, 1983, section 2.4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.adaptation import CORRECT_THESIS, NO_ACTION, REJECT, Adaptation
from massprop_drake.maths.linear_algebra import (
    Array,
    cross,
    inverse_positive_definite,
    is_positive_definite,
    skew,
)
from massprop_drake.maths.mass_properties import ELEMENT, N_ROTATION

SUBTRACT, IGNORE, HYBRID = 0, 1, 2  # treatment of dynamic coupling

_AXES = np.arange(3)
# S.ravel()[_PRODUCT] is the (ij) x (mn) table of P[E(i, m), E(j, n)]
_PRODUCT = np.array(
    [
        [[ELEMENT[i, m] * N_ROTATION + ELEMENT[j, n] for m in range(3) for n in range(3)] for j in range(3)]
        for i in range(3)
    ]
).reshape(9, 9)
# X.ravel()[_LEFT][i, (m, n)] = X[E(i, m), n] and X.ravel()[_RIGHT][j, (m, n)] = X[E(j, n), m]
_LEFT = np.array([[ELEMENT[i, m] * 3 + n for m in range(3) for n in range(3)] for i in range(3)])
_RIGHT = np.array([[ELEMENT[j, n] * 3 + m for m in range(3) for n in range(3)] for j in range(3)])
_DIAGONAL = np.array([0, 4, 8])  # of the (m, n) pairs above
_IDENTITY = np.eye(N_ROTATION)
_NOT_MEASURED = np.full(3, np.nan)


def angular_block(vector: Array) -> Array:
    """A_6(v): the 3x6 matrix with A_6(v) x_6 = I^-1 v, the left block of (2-53)."""
    x, y, z = vector.tolist()
    return np.array([[x, 0.0, 0.0, 0.0, z, y], [0.0, y, 0.0, z, 0.0, x], [0.0, 0.0, z, y, x, 0.0]])


def rate_increment(estimate: Array, angular_impulse: Array, linear_impulse: Array) -> Array:
    """h(x): the rate increment of a known impulse, rad/s, (2-47) in closed form, shape (3,)."""
    moment = angular_impulse + cross(linear_impulse, estimate[6:])
    return estimate[ELEMENT] @ moment


def rate_increment_jacobian(estimate: Array, angular_impulse: Array, linear_impulse: Array) -> Array:
    """H = dh/dx (2-102), shape (3, 9)."""
    moment = angular_impulse + cross(linear_impulse, estimate[6:])
    jacobian = np.empty((3, N_ROTATION))
    jacobian[:, :6] = angular_block(moment)
    jacobian[:, 6:] = estimate[ELEMENT] @ skew(linear_impulse)
    return jacobian


def second_order_terms(covariance: Array, linear_impulse: Array) -> tuple[Array, Array]:
    """Bias b, rad/s, shape (3,), and covariance D, rad^2/s^2, shape (3, 3), of the curvature of h."""
    arm = skew(linear_impulse)
    spread = (covariance[:6, 6:] @ arm.T).ravel()
    left = spread[_LEFT]
    bias = left[:, _DIAGONAL].sum(axis=1)
    force = arm @ covariance[6:, 6:] @ arm.T
    curvature = (covariance.ravel()[_PRODUCT] @ force.ravel()).reshape(3, 3)
    return bias, curvature + left @ spread[_RIGHT].T


def coupling_increment(inverse_inertia: Array, rate: Array, period_s: float) -> Array:
    r"""Rate increment of dynamic coupling over one sample, -I^-1 (w x I w) dt, rad/s, shape (3,).

    Args:
        inverse_inertia: positive definite, shape (3, 3).
        rate: mean angular rate over the sample, rad/s, body axes, shape (3,).
        period_s: sample period, s.
    """
    momentum = inverse_positive_definite(inverse_inertia, "inverse inertia") @ rate
    return inverse_inertia @ cross(rate, momentum) * -period_s


class RotationSettings(NamedTuple):
    """What shapes the rotation filter.

    Attributes:
        period_s: sample period, s.
        second_order: the second-order filter, or (False) the extended Kalman filter.
        coupling: SUBTRACT, IGNORE or HYBRID.
        coupling_limit: HYBRID subtracts once the largest variance of the innovation is below this
            many times the largest variance of the measurement noise.
        jump_threshold: on a NIS above this the covariance is incremented (2-138); infinity: never.
        jump_covariance: what is then added, in state order, shape (9, 9).
        process_noise: covariance added per sample (2-123), shape (9, 9).
        disturbance_covariance: R^d of a rate increment, rad^2/s^2, shape (3, 3).
    """

    period_s: float
    second_order: bool
    coupling: int
    coupling_limit: float
    jump_threshold: float
    jump_covariance: Array
    process_noise: Array
    disturbance_covariance: Array


class RotationSample(NamedTuple):
    """What one sample brings to the rotation filter.

    Attributes:
        increment: measured rate increment z, rad/s, body axes, shape (3,).
        rate: mean of the two readings that bound the sample, rad/s, body axes, shape (3,).
        noise: covariance R^z of the increment, rad^2/s^2, shape (3, 3).
        angular_impulse, linear_impulse: a and lambda over the sample, shape (3,) each.
        firing: whether an impulse acted.
    """

    increment: Array
    rate: Array
    noise: Array
    angular_impulse: Array
    linear_impulse: Array
    firing: bool


class RotationInnovation(NamedTuple):
    """Measured minus predicted rate increment of one sample, before any update.

    Attributes:
        innovation: e, rad/s, body axes, shape (3,).
        covariance: Y, rad^2/s^2, shape (3, 3).
        information: the inverse of Y.
        jacobian: H, shape (3, 9).
        noise: D + R, rad^2/s^2, shape (3, 3).
        subtract_coupling: whether the hybrid rule asks for the subtraction of dynamic coupling.
        nis: e^T Y^-1 e; chi-square with 3 degrees of freedom for a consistent filter.
    """

    innovation: Array
    covariance: Array
    information: Array
    jacobian: Array
    noise: Array
    subtract_coupling: bool
    nis: float


class RotationUpdate(NamedTuple):
    """State of the rotation filter after one sample.

    Attributes:
        estimate: x, shape (9,).
        covariance: S, shape (9, 9).
        jumped: whether the covariance was incremented first (2-138).
    """

    estimate: Array
    covariance: Array
    jumped: bool


_COASTING = np.zeros((3, N_ROTATION))


def innovate(
    estimate: Array,
    covariance: Array,
    sample: RotationSample,
    subtract_coupling_before: bool,
    settings: RotationSettings,
) -> RotationInnovation:
    r"""The innovation of one sample, (2-117) to (2-121), with dynamic coupling subtracted if due.

    The hybrid rule looks at the innovation's covariance, which says something about the estimates only
    while jets fire; a coasting sample keeps the decision of the last firing one. Whatever the rule
    says, nothing is subtracted while the estimated inverse inertia is not positive definite.

    Args:
        estimate, covariance: predicted state (9,) and its covariance (9, 9).
        sample: see `RotationSample`.
        subtract_coupling_before: the hybrid rule's last decision.
        settings: see `RotationSettings`.

    Raises:
        NotPositiveDefiniteError: when Y is not positive definite.
    """
    noise = sample.noise + settings.disturbance_covariance
    if sample.firing:
        impulses = sample.angular_impulse, sample.linear_impulse
        jacobian = rate_increment_jacobian(estimate, *impulses)
        innovation = sample.increment - rate_increment(estimate, *impulses)
        total_noise = noise
        if settings.second_order:
            bias, curvature = second_order_terms(covariance, sample.linear_impulse)
            innovation -= bias
            total_noise = noise + curvature
        innovation_covariance = jacobian @ covariance @ jacobian.T + total_noise
        limit = settings.coupling_limit * max(noise.ravel()[_DIAGONAL].tolist())
        subtract_coupling = max(innovation_covariance.ravel()[_DIAGONAL].tolist()) < limit
    else:
        jacobian, total_noise, innovation_covariance = _COASTING, noise, noise
        innovation = sample.increment
        subtract_coupling = subtract_coupling_before
    if settings.coupling != HYBRID:
        subtract_coupling = settings.coupling == SUBTRACT
    if subtract_coupling:
        inverse_inertia = estimate[ELEMENT]
        if is_positive_definite(inverse_inertia):
            innovation = innovation - coupling_increment(inverse_inertia, sample.rate, settings.period_s)
    information = inverse_positive_definite(innovation_covariance, "innovation covariance")
    nis = float(innovation @ information @ innovation)
    return RotationInnovation(
        innovation, innovation_covariance, information, jacobian, total_noise, subtract_coupling, nis
    )


def joseph_update(
    estimate: Array, covariance: Array, innovation: Array, information: Array, jacobian: Array, noise: Array
) -> tuple[Array, Array]:
    """Estimate (2-115) and covariance in Joseph's form (2-126), symmetrised."""
    gain = covariance @ jacobian.T @ information
    kept = _IDENTITY - gain @ jacobian
    updated = kept @ covariance @ kept.T + gain @ noise @ gain.T
    return estimate + gain @ innovation, 0.5 * (updated + updated.T)


def update(
    estimate: Array,
    covariance: Array,
    sample: RotationSample,
    innovation: RotationInnovation,
    adaptation: Adaptation,
    settings: RotationSettings,
) -> RotationUpdate:
    r"""Measurement update of one usable firing sample, then the time update (2-123).

    When the innovation's NIS exceeds the jump threshold, the covariance is first incremented and the
    innovation formed again from the same measurement (2-138), unless a jet's failure explains it.

    Args:
        estimate, covariance: predicted state (9,) and its covariance (9, 9).
        sample: see `RotationSample`.
        innovation: what `measure` made of the same sample.
        adaptation: see `maths.adaptation`.
        settings: see `RotationSettings`.

    Raises:
        NotPositiveDefiniteError: when an innovation covariance is not positive definite.
    """
    if adaptation.action == REJECT:
        return RotationUpdate(estimate, covariance + settings.process_noise, jumped=False)
    jumped = adaptation.action == NO_ACTION and innovation.nis > settings.jump_threshold
    if jumped:
        covariance = covariance + settings.jump_covariance
        innovation = innovate(estimate, covariance, sample, innovation.subtract_coupling, settings)
    information, noise, error = innovation.information, innovation.noise, innovation.innovation
    if adaptation.action != NO_ACTION:
        error = error - adaptation.rotation
        noise = noise + adaptation.rotation_spread
    if adaptation.action == CORRECT_THESIS:
        enlarged = innovation.covariance + adaptation.rotation_spread
        information = inverse_positive_definite(enlarged, "innovation covariance")
    estimate, covariance = joseph_update(estimate, covariance, error, information, innovation.jacobian, noise)
    return RotationUpdate(estimate, covariance + settings.process_noise, jumped)


class RotationMeasurement(NamedTuple):
    """A sample and its innovation.

    Attributes:
        sample: what was measured.
        innovation: before any update; NaN where not measured.
    """

    sample: RotationSample
    innovation: RotationInnovation


def measure(
    estimate: Array,
    covariance: Array,
    rate_before: Array,
    subtract_coupling_before: bool,
    rate: Array,
    noise: Array,
    angular_impulse: Array,
    linear_impulse: Array,
    firing: bool,
    settings: RotationSettings,
) -> RotationMeasurement:
    """First half of a cycle: the increment and its innovation.

    Args:
        estimate, covariance: predicted state (9,) and its covariance (9, 9).
        rate_before, rate: readings at the sample's two ends, rad/s, NaN where missing, shape (3,) each.
        subtract_coupling_before: the hybrid rule's last decision.
        noise: covariance of their difference, rad^2/s^2, shape (3, 3).
        angular_impulse, linear_impulse: a and lambda over the sample, shape (3,) each.
        firing: whether a known impulse acted.
        settings: see `RotationSettings`.
    """
    increment = rate - rate_before
    mean_rate = 0.5 * (rate + rate_before)
    sample = RotationSample(increment, mean_rate, noise, angular_impulse, linear_impulse, firing)
    if math.isfinite(increment[0] + increment[1] + increment[2]):
        innovation = innovate(estimate, covariance, sample, subtract_coupling_before, settings)
    else:
        innovation = RotationInnovation(
            _NOT_MEASURED, noise, noise, _COASTING, noise, subtract_coupling_before, math.nan
        )
    return RotationMeasurement(sample, innovation)


def finish(
    estimate: Array,
    covariance: Array,
    measurement: RotationMeasurement,
    usable: bool,
    adaptation: Adaptation,
    settings: RotationSettings,
) -> RotationCycle:
    """Second half of a cycle: the update, when the sample can be used.

    A sample is used when both readings are there, the jets' combination was steady, and an impulse
    acted.

    Args:
        estimate, covariance: predicted state (9,) and its covariance (9, 9).
        measurement: what `measure` made of the sample.
        usable: whether the combination of jets was steady and a jet commanded.
        adaptation: see `maths.adaptation`.
        settings: see `RotationSettings`.
    """
    sample, innovation = measurement
    if math.isnan(innovation.nis) or not (usable and sample.firing):
        return RotationCycle(estimate, covariance + settings.process_noise, used=False, jumped=False)
    updated = update(estimate, covariance, sample, innovation, adaptation, settings)
    return RotationCycle(updated.estimate, updated.covariance, used=adaptation.action != REJECT, jumped=updated.jumped)


class RotationCycle(NamedTuple):
    """State of the rotation filter after a cycle, measured or not, used or not.

    Attributes:
        estimate: x, shape (9,).
        covariance: S, shape (9, 9).
        used: whether the estimate was updated.
        jumped: whether the covariance was incremented first.
    """

    estimate: Array
    covariance: Array
    used: bool
    jumped: bool
