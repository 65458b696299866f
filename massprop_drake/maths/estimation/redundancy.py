r"""Combination of several packages of the same sensor into one measurement (sections 2.4.6 and 3.4 of the thesis).

With z_j the measurement of package j and R_j its covariance:

- SINGLE: the first package that is there.
- MOST_ACCURATE: that of the smallest trace of R_j.
- MID_VALUE: component by component the middle one; of an even number the mean of the two in the middle.
  Its covariance is taken as the mean of all R_j: it serves to shut out a bad package, not to average noise.
- AVERAGE: z = sum_j z_j / s, R = sum_j R_j / s^2                               (2-146), (3-90), (3-91)
- WEIGHTED_AVERAGE: R = (sum_j R_j^-1)^-1, z = R sum_j R_j^-1 z_j               (2-141), (2-142), (3-88), (3-89)
- SERIAL: the filter is updated with one package after the other; for tests the weighted average stands
  for all.

These covariances take the packages' errors as independent. Where their cross-covariances R_ij are given,
AVERAGE has R = sum_ij R_ij / s^2, and WEIGHTED_AVERAGE is the best linear one,
R = (E^T C^-1 E)^-1 with C the stacked covariance and E the stacked identities; SERIAL becomes that, in one
update.

Source: D. R. Levy, MIT S.M. thesis, 1983; the cross-covariances are our own.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from massprop_drake.maths.linear_algebra import Array, inverse, symmetrized


class Rule(IntEnum):
    """Rule by which several packages make one measurement."""

    SINGLE = 0
    MOST_ACCURATE = 1
    MID_VALUE = 2
    AVERAGE = 3
    WEIGHTED_AVERAGE = 4
    SERIAL = 5


def combine_packages(
    measurements: Array, covariances: Array, rule: int, *, correlated: bool = False
) -> tuple[Array, Array]:
    """Combines several packages' measurements into one, shape (3,), with covariance, shape (3, 3).

    Args:
        measurements: of the packages that are there, at least one, in order of preference, shape (s, 3).
        covariances: R_ij, the diagonal blocks being the packages' own, shape (s, s, 3, 3).
        rule: see `Rule`.
        correlated: whether the blocks off the diagonal count.
    """
    count = measurements.shape[0]
    if count == 1 or rule == Rule.SINGLE:
        return measurements[0], covariances[0, 0]
    own = covariances[np.arange(count), np.arange(count)]
    if rule == Rule.MOST_ACCURATE:
        best = int(np.trace(own, axis1=1, axis2=2).argmin())
        return measurements[best], own[best]
    if rule == Rule.MID_VALUE:
        return np.median(measurements, axis=0), own.mean(axis=0)
    if rule == Rule.AVERAGE:
        total = covariances.sum(axis=(0, 1)) if correlated else own.sum(axis=0)
        return measurements.mean(axis=0), total / count**2
    if correlated:
        stacked = inverse(covariances.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count))
        weights = stacked.reshape(count, 3, count, 3).sum(axis=0).transpose(1, 0, 2)  # E^T C^-1, package by package
    else:
        weights = np.linalg.inv(own)
    covariance = symmetrized(inverse(weights.sum(axis=0)))
    return covariance @ np.einsum("jab,jb->a", weights, measurements), covariance
