"""Jets of unknown command, which may have given anything that they can over an interval.

Equations: theory page of the joint filter, "Unknown commands", with D and U as there. A prior by which each interval
is a coin of its own would be off by the same sigma each time, and the filter would learn from it: so nothing is
assumed. Along U nothing is learned or tested; across U an error of J or r turns what the jets gave, linearized at the
openings that the readings show, the least squares solution with the least departure from a half.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.lagged_impulses import Firing, effects_of, replace_firing
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_WIDE = 10.0  # times what the strongest jet gives in the interval: an opening's 1-sigma, by which none is told
EXPECTED = -0.5 * (1.0 + math.log(2.0))  # nats, of a reading that is expected as well as it is read, over its best
_SAME = 1e-12  # of the largest squared effect: less is rounding of directions that are the same


class Directions(NamedTuple):
    """Directions in which the changes of w and c may be anything.

    Attributes:
        number: of them, r; zero: none.
        spread: their 1-sigma, in those of readings.
        basis: U in units of w and c, columns from r on zero, shape (6, 6).
        dual: its columns give the components along U, shape (6, 6).
    """

    number: float
    spread: float
    basis: Array
    dual: Array


@kernel
def unknown_directions(mean: Array, firing: Firing, params: JointParams) -> Directions:
    """Computes directions of rate and velocity that jets of unknown command can change by any amount.

    Args:
        mean: state's estimate, shape (size,).
    """
    basis, dual = np.zeros((6, 6)), np.zeros((6, 6))
    if not firing.unknown.any():
        return Directions(0.0, 0.0, basis, dual)
    sigmas = reading_sigmas(params)
    effects = effects_of(params.wrenches, mean) / sigmas * firing.duration_s
    values, vectors = np.linalg.eigh(effects[firing.unknown].T @ effects[firing.unknown])
    count = 0
    for place in range(6):
        if values[place] > _SAME * values[5]:
            basis[:, count] = vectors[:, place] * sigmas
            dual[:, count] = vectors[:, place] / sigmas
            count += 1
    return Directions(float(count), _WIDE * np.sqrt((effects**2).sum(axis=1).max()), basis, dual)


def is_untestable(firing: Firing, directions: Directions) -> bool:
    """Tests whether jets of unknown command leave nothing to test: no direction of rate, velocity, or no jet."""
    return bool(directions.number == directions.basis.shape[0] or firing.unknown.all())


@kernel
def unknown_impulse_covariance(directions: Directions) -> Array:
    """Computes the near-infinite covariance along directions of unknown jets in rate and velocity, shape (6, 6)."""
    wide = directions.spread * directions.basis
    return wide @ wide.T


@kernel
def remove_directions(rate_rows: Array, velocity_rows: Array, directions: Directions) -> tuple[Array, Array]:
    """Removes components along unknown jets' directions from derivatives of rate and velocity, (3, size) each."""
    if directions.number == 0.0:
        return rate_rows, velocity_rows
    rows = np.vstack((rate_rows, velocity_rows))
    rows = rows - directions.basis @ (directions.dual.T @ rows)
    return rows[:3].copy(), rows[3:].copy()


@kernel
def firing_shown_by_readings(
    error: Array, mean: Array, firing: Firing, directions: Directions, params: JointParams
) -> Firing:
    """Returns the firing with on-times of unknown jets solved from readings, if all are there, within the interval.

    Args:
        error: of the predicted changes of w and c by the readings, NaN where none is there, shape (6,).
        mean: state's estimate, shape (size,).
        firing: as predicted.
    """
    if np.isnan(error).any():
        return firing
    # D U (U^T D^T D U)^-1 U^T error, of the jets that are not known
    along = (effects_of(params.wrenches, mean) @ directions.dual)[:, : int(directions.number)]
    along = along * firing.unknown.reshape(-1, 1)
    solution = along @ np.linalg.solve(along.T @ along, (directions.dual.T @ error)[: int(directions.number)])
    amount = firing.amount + firing.unknown * solution
    least, most = np.minimum(firing.amount, 0.0), np.maximum(firing.amount, firing.duration_s)
    return replace_firing(firing, np.minimum(np.maximum(amount, least), most), firing.level)


@kernel
def reading_sigmas(params: JointParams) -> Array:
    """Returns 1-sigmas of the mean over packages of rate and velocity readings, shape (6,)."""
    places, sigmas = params.places, np.ones(6)
    for begin, first, packages in ((0, 0, places.gyros), (3, 3 * places.gyros, places.accelerometers)):
        for axis in range(3):
            information = 0.0
            for package in range(packages):
                information += 1.0 / params.variances[first + 3 * package + axis]
            if information > 0.0:
                sigmas[begin + axis] = 1.0 / np.sqrt(information)
    return sigmas
