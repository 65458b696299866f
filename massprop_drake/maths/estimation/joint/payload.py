r"""Mass that a jump of the mass properties added, and its place.

From the estimates before it and now, m = 1/mu, the mass gained is m_2 - m_1 and its place (m_2 r_2 - m_1 r_1) divided
by it. Both estimates rest on the same parameters p that a jump does not change: thrust errors, lags, biases and the
common thrust scale s. A scale that is wrong by e makes both masses, and so what was gained, wrong by that share: its
error is e (m_2 - m_1), not that of two masses. With P_1 and P_2 the covariances then and now, and

    A = P_1xp P_1pp^-1,    x_1 <- x_1 + A (p_2 - p_1),    error of x_1 = A (error of p_2) + rest,

the estimate before is what it would have been had p been known as it is now, and the rest, of covariance
P_1xx - A P_1px, has nothing to do with what came after. Both errors thereby are in the same independent columns.

*Neglected*: what the jump's filter still knows of x_1 (the share (sigma_1 / 0.3 sigma_0)^2 of it, some 1e-4), errors of
rate and gathered velocity at the time of the jump (a quantum, forgotten within seconds), forces of failed jets (taken
as known anew), and the propellant used since.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale
from massprop_drake.maths.linear_algebra import Array

_SIGNIFICANT = 3.0  # sigmas of a mass
_EXACT = 1e-9  # of the largest sigma of p: below, a direction of it is exact, as the mean of b' is


class Payload(NamedTuple):
    """Mass gained by the vehicle.

    Attributes:
        mass, mass_sigma: released: negative, slug or kg.
        position, position_sigma: where, vehicle frame, NaN while the mass is not significant, ft or m, shape (3,).
    """

    mass: float
    mass_sigma: float
    position: Array
    position_sigma: Array


UNKNOWN = Payload(np.nan, np.nan, np.full(3, np.nan), np.full(3, np.nan))  # where no filter fits


def gained_payload(earlier: JointState, later: JointState, params: JointParams) -> Payload:
    """Computes mass and position of the payload gained between two states, before and after a jump, with 1-sigmas."""
    padded = later._replace(root=np.hstack((later.root, np.zeros_like(later.root))))
    first, first_rows = _mass_and_moment(_condition_on_present(earlier, later, params), params)
    last, last_rows = _mass_and_moment(padded, params)
    gained, rows = last - first, last_rows - first_rows
    mass, mass_sigma = float(gained[0]), float(np.linalg.norm(rows[0]))
    if abs(mass) < _SIGNIFICANT * mass_sigma:
        return UNKNOWN._replace(mass=mass, mass_sigma=mass_sigma)
    position = gained[1:] / mass
    sigma = np.linalg.norm(rows[1:] - np.outer(position, rows[0]), axis=1) / abs(mass)
    return Payload(mass, mass_sigma, position, sigma)


def _condition_on_present(earlier: JointState, later: JointState, params: JointParams) -> JointState:
    """Returns the earlier state conditioned on the later estimates of thrust, lag and other shared errors."""
    places, size = params.places, params.places.size
    mean, root = earlier.mean.copy(), np.hstack((np.zeros_like(earlier.root), earlier.root))
    shared = slice(places.thrust, places.force)
    by_shared = earlier.root[:N_PROPERTIES] @ np.linalg.pinv(earlier.root[shared], rcond=_EXACT)
    mean[:N_PROPERTIES] += by_shared @ (later.mean[shared] - earlier.mean[shared])
    mean[shared] = later.mean[shared]
    root[:N_PROPERTIES, :size] = by_shared @ later.root[shared]
    root[:N_PROPERTIES, size:] -= by_shared @ earlier.root[shared]
    root[shared, :size], root[shared, size:] = later.root[shared], 0.0
    return earlier._replace(mean=mean, root=root)


def _mass_and_moment(state: JointState, params: JointParams) -> tuple[Array, Array]:
    """Computes mass m and first moment m r, shape (4,), and their rows of the covariance's root, shape (4, k)."""
    properties, rows = parameters_with_scale(state, params)
    mass, center = 1.0 / properties[MASS], properties[CENTER]
    of_mass = -(mass**2) * rows[MASS]
    return np.append(mass, mass * center), np.vstack((of_mass, np.outer(center, of_mass) + mass * rows[CENTER]))
