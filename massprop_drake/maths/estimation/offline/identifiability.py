r"""Information of a flight on each parameter, and the jet that would add the most.

The rows H that a second of a jet's full thrust gives (`observability.impulse_jacobian`) would reduce the covariance P
of the ten parameters to

    P - P H^T (H P H^T + R)^-1 H P,    R: of the increments of rate and velocity,

so that the share of each parameter's 1-sigma that would be left can be told before anything is fired.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import CENTER_OF_MASS

FIRING_S = 1.0  # of a jet whose effect is foretold
_TOLD = float(np.sqrt(0.5))  # share of the start's 1-sigma, above which the start tells more than the flight
_PRODUCTS = ((3, 1, 2), (4, 0, 2), (5, 0, 1))  # element, and the diagonal elements that scale it


class Flag(StrEnum):
    """Status of a parameter after a flight."""

    IDENTIFIED = "identified"  # the flight has shown it, as well as is asked
    WEAK = "weak"  # the flight has shown it, less well than is asked
    NOT_EXCITED = "not_excited"  # the start tells more of it than the flight
    NOT_OBSERVABLE = "not_observable"  # these jets and sensors cannot show it
    FIXED = "fixed"  # it is known, or plays no part, and is not estimated


def predict_best_firing(covariance: Array, jacobians: Array, noise: Array) -> tuple[NDArray[np.int_], Array]:
    """Predicts per parameter the jet whose one-second firing leaves the least 1-sigma, and its ratio to today's.

    Args:
        covariance: P of the ten parameters; rows and columns of what is not observed are NaN, shape (10, 10).
        jacobians: H of each jet, shape (n_jets, k, 10).
        noise: R, shape (k, k).

    Returns:
        Index of the jet, and share of the 1-sigma that would be left, NaN where there is none to reduce, shape (10,).
    """
    known = np.flatnonzero(covariance.diagonal() > 0.0)  # NaN is not
    p, h = covariance[np.ix_(known, known)], jacobians[:, :, known]
    gained = h @ p
    reduction = np.einsum("jki,jki->ji", gained, np.linalg.solve(gained @ h.transpose(0, 2, 1) + noise, gained))
    share = np.clip(1.0 - reduction / p.diagonal(), 0.0, 1.0)
    jet, left = np.zeros(10, dtype=int), np.full(10, np.nan)
    jet[known] = share.argmin(axis=0)
    left[known] = np.sqrt(share.min(axis=0))
    return jet, left


def requested_deviation(estimate: Array, limits: Array) -> Array:
    """Computes the 1-sigma required of each parameter by the convergence limits, shape (10,).

    A product element may be off by as much as the root of the product of its two diagonal elements.

    Args:
        estimate: the ten parameters, or others that scale them, shape (10,).
        limits: see `mass_properties.is_converged`, shape (3,).
    """
    diagonal, center, reciprocal = limits.tolist()
    result = diagonal * np.abs(estimate)
    for element, first, second in _PRODUCTS:
        result[element] = diagonal * np.sqrt(np.abs(estimate[first] * estimate[second]))
    result[CENTER_OF_MASS] = center
    result[9] = reciprocal * abs(estimate[9])
    return result


def classify_parameters(
    initial_deviation: Array, deviation: Array, limit: Array, unobservable: NDArray[np.bool_]
) -> list[Flag]:
    """Returns the status of each parameter by its 1-sigma before and after a flight.

    Args:
        initial_deviation: 1-sigma before any measurement, shape (10,).
        deviation: 1-sigma now, NaN where not observed, shape (10,).
        limit: 1-sigma that is asked, see `requested_deviation`, shape (10,).
        unobservable: which parameters jets and sensors cannot show, shape (10,).
    """
    found = []
    for before, now, enough, unseen in zip(initial_deviation, deviation, limit, unobservable, strict=True):
        if unseen or np.isnan(now):
            found.append(Flag.NOT_OBSERVABLE)
        elif now > _TOLD * before:
            found.append(Flag.NOT_EXCITED)
        else:
            found.append(Flag.IDENTIFIED if now < enough else Flag.WEAK)
    return found
