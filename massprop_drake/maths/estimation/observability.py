r"""Observability of a vehicle's mass properties, and activity and isolability of its jets.

Everything here is geometry and noise, with the mass properties given: no data and no filter.

**Activity.** The rank and condition of the activity matrix (1-1), scaled to one unit and unit columns.

**Observability.** The rows that one jet's impulse gives are those of the two filters,

    [ A_6(a + lambda x r_cm),  I^-1 [lambda x],  0 ]   of a rate increment       (2-102)
    [ 0,                       0,           lambda ]   of a velocity increment   (3-37)

They are linear in the impulses, so jets fired together show nothing that they do not show one by one. A
combination of parameters that all rows leave alone cannot be estimated, however long the jets fire.

**Isolability.** With c_j the signature of jet j (4-12) and Y the covariance of one sample's
increments, G = C Y^-1 C^T holds all that a single-sample test can see: signatures as vectors in units of
the noise. A failure of jet j by f is expected to lead that of jet i in likelihood argument (4-28) by

    f^2 (G_jj - G_ij^2 / G_ii) = f^2 G_jj sin^2(angle between them).

Source: D. R. Levy, MIT S.M. thesis, 1983, for the equations named; what is made of them is our own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.filters.rate_increments import rate_increment_jacobians
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import N_ROTATION

_RANK_TOLERANCE = 1e-9  # of the largest singular value
_COLLINEAR = 1e-12  # sin^2 of an angle that rounding cannot tell from zero


class Activity(NamedTuple):
    """Conditioning of the jets' push in six dimensions.

    Attributes:
        rank: of the activity matrix, 0 to 6.
        condition: largest by smallest singular value once scaled; infinite below rank 6. 1: the jets
            push equally well in every direction.
    """

    rank: int
    condition: float


def activity_rank(activity: Array, typical_arm: float) -> Activity:
    """Computes rank and condition of the jets' activity matrix, independent of units and of thrusts.

    Rotation rows are multiplied by a typical arm, so that all are accelerations of a point, and each
    column is brought to length one, so that only where jets are and point to counts.

    Args:
        activity: activity vectors as columns, rotation first, shape (6, n_jets).
        typical_arm: of the jets, ft or m, positive.
    """
    scaled = activity * np.array([typical_arm] * 3 + [1.0] * 3)[:, None]
    values = np.zeros(6)
    found = np.linalg.svd(scaled / np.linalg.norm(scaled, axis=0), compute_uv=False)
    values[: found.size] = found
    rank = int((values > _RANK_TOLERANCE * values[0]).sum())
    return Activity(rank, float(values[0] / values[5]) if rank == 6 else np.inf)


def impulse_jacobian(wrenches: Array, mass_properties: Array, *, accelerometer: bool) -> Array:
    """Computes d(increments)/d(ten parameters) for a unit impulse of each jet, shape (n_jets * 3 or 6, 10).

    Args:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        mass_properties: the ten parameters, shape (10,).
        accelerometer: whether velocity increments are measured.
    """
    rows = np.zeros((wrenches.shape[0], 6 if accelerometer else 3, 10))
    rows[:, :3, :N_ROTATION] = rate_increment_jacobians(mass_properties[:N_ROTATION], wrenches)
    if accelerometer:
        rows[:, 3:, 9] = wrenches[:, 3:]
    return rows.reshape(-1, 10)


def unobservable_combinations(jacobian: Array, parameter_scales: Array) -> Array:
    """Computes the null space of a Jacobian: unobservable parameter combinations, shape (10 - rank, 10).

    Reduced so that each names as few parameters as can be: the first that it names has weight 1 and
    appears in no other.

    Args:
        jacobian: see `impulse_jacobian`, shape (n, 10).
        parameter_scales: such as 1-sigmas before any measurement, units of the combinations, positive, shape (10,).
    """
    scaled = jacobian * parameter_scales
    # rows of rotation and translation differ in unit, as those of strong and weak jets do in size
    size = np.linalg.norm(scaled, axis=1)
    scaled = scaled[size > 0.0] / size[size > 0.0, None]
    count = parameter_scales.size
    if scaled.shape[0] == 0:
        return np.eye(count)
    # of the triangular factor, which has the same values and rows, and ten rows instead of hundreds
    _, values, rows = np.linalg.svd(np.linalg.qr(scaled, mode="r"), full_matrices=True)
    rank = int((values > _RANK_TOLERANCE * values[0]).sum())
    return _reduce_rows(rows[rank:])


def _reduce_rows(rows: Array) -> Array:
    """Computes the reduced row echelon form of independent rows, with pivoting; rounding below 1e-6 becomes zero."""
    result = rows.copy()
    row = 0
    for column in range(result.shape[1]):
        if row == result.shape[0]:
            break
        pivot = row + int(np.abs(result[row:, column]).argmax())
        if abs(result[pivot, column]) < 1e-6:
            continue
        result[[row, pivot]] = result[[pivot, row]]
        result[row] /= result[row, column]
        others = np.arange(result.shape[0]) != row
        result[others] -= np.outer(result[others, column], result[row])
        row += 1
    result[np.abs(result) < 1e-6] = 0.0
    return result


def whiten_signatures(signatures: Array, covariance: Array) -> Array:
    """Whitens jets' signatures c (innovations by unit failures), noise covariance L L^T, to L^-1 c, (n_jets, k).

    Args:
        signatures: c of every jet, shape (n_jets, k).
        covariance: Y, shape (k, k).
    """
    return np.linalg.solve(np.linalg.cholesky(covariance), signatures.T).T


def _sizes_and_directions(signatures: Array) -> tuple[Array, Array]:
    """Computes lengths of signatures, shape (n,), and unit vectors, shape (n, k); both zero if negligible."""
    size = np.linalg.norm(signatures, axis=1)
    size = np.where(size > _RANK_TOLERANCE * size.max(), size, 0.0)
    return size, signatures * np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)[:, None]


class Pair(NamedTuple):
    """Two jets and the distance between their signatures.

    Attributes:
        first, second: indices of the jets, the smaller first.
        angle: between the lines of their signatures, rad, 0 to pi/2.
        opposed: whether they point against each other: one that fails off then looks like the other
            failing on; else one failing on looks like the other failing on.
    """

    first: int
    second: int
    angle: float
    opposed: bool


def jet_pairs(signatures: Array) -> list[Pair]:
    """Lists all pairs of jets with the angle between their signatures, the smallest angle first.

    Args:
        signatures: in units of the noise, see `whiten_signatures`, shape (n_jets, k); a jet that shows nothing
            (all but zero beside the others) looks like no other.
    """
    size, units = _sizes_and_directions(signatures)
    visible = np.flatnonzero(size)
    found = []
    for place, second in enumerate(visible.tolist()):
        for first in visible[:place].tolist():
            opposed = bool(units[first] @ units[second] < 0.0)
            chord = units[first] + units[second] if opposed else units[first] - units[second]
            # exact for small angles too, unlike the arc cosine
            angle = 2.0 * math.asin(min(0.5 * float(np.linalg.norm(chord)), 1.0))
            found.append(Pair(first, second, angle, opposed))
    return sorted(found, key=lambda pair: (round(pair.angle, 12), pair.first, pair.second))


class Isolability(NamedTuple):
    """Smallest failure of each jet that one sample is expected to assign to it.

    Attributes:
        force: magnitude, lbf or N, infinite where the sample never can, shape (n_jets,).
        rival: index of the jet that it is hardest to tell from, -1 where none looks alike at all,
            shape (n_jets,).
    """

    force: Array
    rival: NDArray[np.int_]


def smallest_isolable(signatures: Array, margin: float, *, lost: bool) -> Isolability:
    r"""Computes each jet's smallest failure (off if ``lost``, else on) that one sample isolates, and its hardest rival.

    Assumptions: the mass properties are known; the noise is at its mean, so half of all samples fall
    short; every other jet is off, and so can only be suspected of giving too much. A jet failing on
    is then rivalled by jets whose signatures point its way, one that loses thrust while it fires alone
    by those that point against it. Where other jets fire too, rivals of both kinds count.

    Args:
        signatures: in units of the noise per unit force, see `whiten_signatures`, shape (n_jets, k).
        margin: in likelihood argument, see `jet_tests.isolate`.
        lost: whether the jet loses thrust while it fires; else it gives thrust untold.
    """
    size, units = _sizes_and_directions(signatures)
    toward = -units if lost else units
    cosine = units @ toward.T
    np.fill_diagonal(cosine, 0.0)
    rival = cosine.argmax(axis=1)
    rivalled = cosine.max(axis=1) > 0.0
    # sin^2 from the chord, exact for small angles too
    chord = ((units - toward[rival]) ** 2).sum(axis=1)
    apart = np.where(rivalled, chord * (1.0 - 0.25 * chord), 1.0)
    alike = apart < _COLLINEAR
    never = alike | (size == 0.0)
    force = np.sqrt(margin / np.where(never, 1.0, apart)) / np.where(never, 1.0, size)
    return Isolability(np.where(never, np.inf, force), np.where(rivalled, rival, -1))


def span_basis(vectors: Array, tolerance: float = 1e-6) -> Array:
    """Computes an orthonormal basis of the space that vectors span, as rows, shape (rank, 3).

    Args:
        vectors: shape (n, 3).
        tolerance: relative to the largest singular value.
    """
    _, values, rows = np.linalg.svd(vectors)
    return rows[: int((values > tolerance * max(float(values[0]), 1e-300)).sum())]
