r"""Rate increment that known impulses and dynamic coupling give, and its derivatives by the rotational state x.

    h(x) = I^-1 (a + lambda x r_cm)                                           (2-47), (2-55)
    H    = [ A_6(a + lambda x r_cm),  I^-1 [lambda x] ],   A_6(v) x_6 = I^-1 v      (2-102)

With S the covariance of x and P (6x6), C (6x3), Q (3x3) its blocks, the exact moments of h under a Gaussian x are
h(x^) + b and H S H^T + D. The second-order terms b and D come from the one product of errors dI^-1 (lambda x dr), so
with E(i, m) the state's index of I^-1_im and X = C [lambda x]^T:

    b_i  = sum_m X[E(i, m), m]                                                              (2-118)
    D_ij = sum_mn P[E(i, m), E(j, n)] ([lambda x] Q [lambda x]^T)_mn + sum_mn X[E(i, m), n] X[E(j, n), m]   (2-121)

Dynamic coupling adds g(x) = -I^-1 (w x I w) dt; with l = I w,

    dg = -[ dI^-1 (w x l) - I^-1 (w x I dI^-1 l) ] dt

Source: D. R. Levy, MIT S.M. thesis, 1983, section 2.4; dg is our own.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.kernels import kernel, numbers, take_elements
from massprop_drake.maths.linear_algebra import Array, congruence, cross, inverse_positive_definite, skew, times_stack
from massprop_drake.maths.mass_properties import ELEMENT, N_ROTATION

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


@kernel
def angular_block(vector: Array) -> Array:
    """Computes A_6(v): the 3x6 matrix with A_6(v) x_6 = I^-1 v, the left block of (2-53)."""
    x, y, z = numbers(vector, 3)
    return np.array([[x, 0.0, 0.0, 0.0, z, y], [0.0, y, 0.0, z, 0.0, x], [0.0, 0.0, z, y, x, 0.0]])


@kernel
def rate_increment(estimate: Array, angular_impulse: Array, linear_impulse: Array) -> Array:
    """Computes h(x): the rate increment of a known impulse, rad/s, (2-47) in closed form, shape (3,)."""
    moment = angular_impulse + cross(linear_impulse, estimate[6:])
    increment: Array = np.dot(take_elements(estimate, ELEMENT), moment)
    return increment


@kernel
def rate_increment_jacobian(estimate: Array, angular_impulse: Array, linear_impulse: Array) -> Array:
    """Computes the Jacobian of the rate increment by the nine parameters, H = dh/dx (2-102), shape (3, 9)."""
    moment = angular_impulse + cross(linear_impulse, estimate[6:])
    jacobian = np.empty((3, N_ROTATION))
    jacobian[:, :6] = angular_block(moment)
    jacobian[:, 6:] = np.dot(take_elements(estimate, ELEMENT), skew(linear_impulse))
    return jacobian


@kernel
def rate_increment_jacobians(estimate: Array, impulses: Array) -> Array:
    """Computes the Jacobians H (2-102) of the rate increments by several impulses, shape (n, 3, 9).

    Args:
        estimate: x, or more parameters after it, shape (9,) or longer.
        impulses: angular impulse about the vehicle origin and linear impulse of each, shape (n, 6).
    """
    linear = impulses[:, 3:]
    moment = _moments(estimate, impulses)
    jacobians = np.zeros((impulses.shape[0], 3, N_ROTATION))
    for i in range(3):
        for m in range(3):
            jacobians[:, i, ELEMENT[i, m]] = moment[:, m]
    arms = np.zeros((impulses.shape[0], 3, 3))
    arms[:, 0, 1], arms[:, 0, 2], arms[:, 1, 2] = -linear[:, 2], linear[:, 1], -linear[:, 0]
    arms[:, 1, 0], arms[:, 2, 0], arms[:, 2, 1] = linear[:, 2], -linear[:, 1], linear[:, 0]
    jacobians[:, :, 6:] = times_stack(take_elements(estimate, ELEMENT), arms)
    return jacobians


@kernel
def _moments(estimate: Array, impulses: Array) -> Array:
    """Computes angular impulses about the estimated center of mass, a + lambda x r_cm, shape (n, 3)."""
    x, y, z = numbers(estimate[6:9], 3)
    arm = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # transpose of [r_cm x]
    return impulses[:, :3] - impulses[:, 3:] @ arm


def thrust_error_effects(estimate: Array, thrust_errors: Array) -> Array:
    """Computes G: the rate increment of one sigma of each jet's thrust error, rad/s, shape (3, n_jets).

    Args:
        estimate: x, shape (9,).
        thrust_errors: impulses of one sigma of each jet's thrust error over the sample, about the vehicle
            origin, shape (n_jets, 6).
    """
    effects: Array = estimate[ELEMENT] @ _moments(estimate, thrust_errors).T
    return effects


@kernel
def second_order_terms(covariance: Array, linear_impulse: Array) -> tuple[Array, Array]:
    """Computes bias, rad/s, (3,), and covariance, rad^2/s^2, (3, 3), of the rate increment by second-order terms."""
    arm = skew(linear_impulse)
    spread = (covariance[:6, 6:] @ arm.T).ravel()
    left = take_elements(spread, _LEFT)
    bias = left[:, _DIAGONAL].sum(axis=1)
    force = congruence(arm, covariance[6:, 6:])
    curvature = (take_elements(covariance.ravel(), _PRODUCT) @ force.ravel()).reshape(3, 3)
    return bias, curvature + left @ take_elements(spread, _RIGHT).T


@kernel
def coupling_increment(inverse_inertia: Array, rate: Array, period_s: float) -> Array:
    r"""Computes the rate increment of dynamic coupling over one sample, -I^-1 (w x I w) dt, rad/s, shape (3,).

    Args:
        inverse_inertia: positive definite, shape (3, 3).
        rate: mean angular rate over the sample, rad/s, body axes, shape (3,).
        period_s: sample period, s.
    """
    momentum = np.dot(inverse_positive_definite(inverse_inertia, "inverse inertia"), rate)
    increment: Array = np.dot(inverse_inertia, cross(rate, momentum)) * -period_s
    return increment


@kernel
def coupling_jacobian(inverse_inertia: Array, rate: Array, period_s: float) -> Array:
    """Computes the Jacobian of dynamic coupling's rate increment, shape (3, 9); see `coupling_increment`."""
    inertia = inverse_positive_definite(inverse_inertia, "inverse inertia")
    momentum = inertia @ rate
    through_inertia = inverse_inertia @ skew(rate) @ inertia @ angular_block(momentum)
    jacobian = np.zeros((3, N_ROTATION))
    jacobian[:, :6] = -period_s * (angular_block(cross(rate, momentum)) - through_inertia)
    return jacobian
