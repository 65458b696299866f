r"""The ten mass properties: their order, packing, derived quantities and first uncertainty.

The rotational state, the order used everywhere (2-49):

    x = [Ixx^-1, Iyy^-1, Izz^-1, Iyz^-1, Ixz^-1, Ixy^-1, x_cm, y_cm, z_cm]

elements of the inverse inertia matrix about the center of mass in body axes, and the center of mass
in the vehicle frame. The mass reciprocal 1/m is the tenth. Products carry the tensor's sign: they are
the matrix entries, I_xy = -integral of x y dm (2-12).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths import attitude, linear_algebra
from massprop_drake.maths.kernels import kernel, numbers, take_elements
from massprop_drake.maths.linear_algebra import Array, is_positive_definite, symmetrized

NAMES = ("Ixx_inv", "Iyy_inv", "Izz_inv", "Iyz_inv", "Ixz_inv", "Ixy_inv", "x_cm", "y_cm", "z_cm", "m_inv")
N_ROTATION = 9  # elements of the rotational state
INVERSE_INERTIA, CENTER_OF_MASS, MASS_RECIPROCAL = slice(0, 6), slice(6, 9), 9  # places in the ten parameters

# element (i, j) of the inverse inertia is x[ELEMENT[i, j]]
ELEMENT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
_ROWS = np.array([0, 1, 2, 1, 0, 0])
_COLUMNS = np.array([0, 1, 2, 2, 2, 1])


class MassProperties(NamedTuple):
    """Mass, center of mass and inertia of a rigid body: truth, nominal and estimate alike.

    Attributes:
        mass: slug or kg.
        center_of_mass: in the vehicle frame, ft or m, shape (3,).
        inertia: about the center of mass, body axes, slug-ft^2 or kg-m^2, shape (3, 3).
    """

    mass: float
    center_of_mass: Array
    inertia: Array

    def vector(self) -> Array:
        """Returns the ten parameters (inverse inertia, center of mass, 1/mass) in order, shape (10,)."""
        inverse = symmetrized(linear_algebra.inverse(self.inertia))
        return pack(inverse, self.center_of_mass, 1.0 / self.mass)


@kernel
def parallel_axis(arm: Array) -> Array:
    """Computes |a|^2 1 - a a^T: inertia of a unit mass at an arm, shape (3, 3)."""
    return (arm @ arm) * np.eye(3) - np.outer(arm, arm)


def attach_body(body: MassProperties, mass: float, position: Array, inertia: Array) -> MassProperties:
    """Computes mass properties after a body is attached or, with negative mass, released.

    By the parallel-axis theorem, I_total = I_1 + m_1 (d_1^2 1 - d_1 d_1^T) + the same of the other, about
    the new center of mass.

    Args:
        body: before.
        mass: of the other, slug or kg; negative: it leaves.
        position: of its center of mass in the vehicle frame, ft or m, shape (3,).
        inertia: of it about its own center of mass, body axes, shape (3, 3); negative if it leaves.
    """
    total = body.mass + mass
    center = (body.mass * body.center_of_mass + mass * position) / total

    def offset(of_mass: Any, point: Array) -> Array:
        """Computes the parallel-axis inertia of a mass at a place about the new center of mass."""
        return np.asarray(of_mass * parallel_axis(point - center))

    moved = body.inertia + offset(body.mass, body.center_of_mass) + inertia + offset(mass, position)
    return MassProperties(total, center, symmetrized(moved))


def perturb_body(
    body: MassProperties, *, mass_factor: float, shift: Array, second_moment_factors: Array, rotation: Array
) -> MassProperties:
    r"""Changes mass, center of mass, second moments and axes of a body; the result is physically possible.

    The second moments of the mass distribution, E = (tr I / 2) 1 - I, are positive semidefinite for every body, and
    every such matrix belongs to one. They are scaled along their principal axes, which are then turned.

    Args:
        body: before.
        mass_factor: of the mass, positive.
        shift: of the center of mass, ft or m, shape (3,).
        second_moment_factors: of the principal second moments in ascending order, positive, shape (3,).
        rotation: rotation vector of the principal axes, body axes, rad, shape (3,).
    """
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    turned = attitude.rotation_matrix(attitude.from_rotation_vector(rotation)) @ axes
    second = symmetrized((turned * (moments * second_moment_factors)) @ turned.T)
    inertia = np.trace(second) * np.eye(3) - second
    return MassProperties(body.mass * mass_factor, body.center_of_mass + shift, inertia)


class Spread(NamedTuple):
    """Standard deviations of mass properties about those of a body, as `draw_body` takes them.

    Attributes:
        mass: of the mass, as a factor less one: 0.1 for 10 % more or less.
        center_of_mass: of each coordinate, ft or m.
        second_moments: of each principal second moment, likewise.
        axes: of the rotation of the principal axes about each axis, rad.
    """

    mass: float
    center_of_mass: float
    second_moments: float
    axes: float


def draw_body(body: MassProperties, spread: Spread, z: Array) -> MassProperties:
    """Draws mass properties about a body's by ten standard normal numbers, (10,), scaled by a spread."""
    return perturb_body(
        body,
        mass_factor=(1.0 + spread.mass) ** float(z[0]),
        shift=spread.center_of_mass * z[1:4],
        second_moment_factors=(1.0 + spread.second_moments) ** z[4:7],
        rotation=spread.axes * z[7:10],
    )


@kernel
def symmetric_matrix(elements: Array) -> Array:
    """Makes the symmetric 3x3 matrix of six elements in the order 11, 22, 33, 23, 13, 12."""
    return take_elements(elements, ELEMENT)


def six_elements(matrix: Array) -> Array:
    """Returns the six elements 11, 22, 33, 23, 13, 12 of a symmetric 3x3 matrix."""
    return matrix[_ROWS, _COLUMNS]


def pack(inverse_inertia: Array, center_of_mass: Array, mass_reciprocal: float) -> Array:
    """Packs inverse inertia, center of mass and 1/mass into the vector of ten parameters, shape (10,)."""
    return np.concatenate([six_elements(inverse_inertia), center_of_mass, [mass_reciprocal]])


def is_possible_inertia(inertia: Array, tolerance: float = 1e-9) -> bool:
    """Tests whether some mass distribution has an inertia matrix: moments meet the triangle inequality.

    The matrix must be positive definite, and no principal moment may exceed the sum of the other two:
    half the trace times the identity, minus the inertia, must be positive semidefinite.

    Args:
        inertia: symmetric, shape (3, 3).
        tolerance: allowed violation of the triangle inequality, relative to the trace.
    """
    if not np.all(np.isfinite(inertia)) or not is_positive_definite(inertia):
        return False
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[2] - moments[0] - moments[1] <= tolerance * moments.sum())


class Derived(NamedTuple):
    """Mass and inertia that follow from an estimate of their inverses, with first-order 1-sigma.

    Attributes:
        mass: slug or kg; None where the estimate of 1/m is not positive.
        mass_std: slug or kg; None likewise.
        inertia: about the center of mass, slug-ft^2 or kg-m^2, shape (3, 3); None where the
            estimated inverse is singular.
        inertia_std: of each element, shape (3, 3); None likewise.
        physically_possible: whether a rigid body can have this mass and this inertia.
    """

    mass: float | None
    mass_std: float | None
    inertia: Array | None
    inertia_std: Array | None
    physically_possible: bool


def derive_mass_and_inertia(estimate: Array, covariance: Array) -> Derived:
    r"""Computes mass and inertia matrix, with 1-sigmas, from the estimated inverses and their covariance.

    The uncertainties follow from the differentials dI = -I d(I^-1) I and dm = -m^2 d(1/m).

    Args:
        estimate: the ten parameters, shape (10,).
        covariance: of their errors, shape (10, 10).
    """
    reciprocal = float(estimate[9])
    mass = mass_std = None
    if reciprocal > 0.0:
        mass = 1.0 / reciprocal
        mass_std = mass**2 * float(np.sqrt(covariance[9, 9]))
    inverse = symmetric_matrix(estimate[:6])
    scale = np.abs(inverse).max()
    if not scale > 0.0 or np.linalg.cond(inverse / scale) > 1e12:
        return Derived(mass, mass_std, None, None, False)
    inertia = symmetrized(linear_algebra.inverse(inverse))
    jacobian = np.empty((6, 6))
    for column in range(6):
        direction = symmetric_matrix(np.eye(6)[column])
        jacobian[:, column] = -six_elements(inertia @ direction @ inertia)
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance[:6, :6], jacobian)
    possible = not reciprocal <= 0.0 and is_possible_inertia(inertia)  # not observed (NaN) says nothing against it
    return Derived(mass, mass_std, inertia, symmetric_matrix(np.sqrt(np.maximum(variance, 0.0))), possible)


def initial_standard_deviation(
    nominal: Array, fraction: float, center_of_mass_floor: float | None, *, floors: bool = True
) -> Array:
    r"""Computes prior 1-sigmas of the ten parameters, a fraction of nominal values, shape (10,).

    A nominal value that is zero or small cannot scale its own uncertainty, so with ``floors``
    each product element has at least the fraction times sqrt(I_ii^-1 I_jj^-1), and each coordinate of
    the center of mass at least its floor.

    Args:
        nominal: the ten nominal parameters, shape (10,).
        fraction: 1-sigma relative to the nominal value (1: 100 %).
        center_of_mass_floor: ft or m; None leaves the center of mass without one.
        floors: whether the floors apply; without them a zero nominal is taken as exactly known.
    """
    deviation = fraction * np.abs(nominal)
    if floors:
        diagonal = np.abs(nominal[:3])
        for element, (i, j) in zip((3, 4, 5), ((1, 2), (0, 2), (0, 1)), strict=True):
            deviation[element] = max(deviation[element], fraction * np.sqrt(diagonal[i] * diagonal[j]))
        if center_of_mass_floor is not None:
            deviation[6:9] = np.maximum(deviation[6:9], center_of_mass_floor)
    return deviation


_NOTHING = 1e-9  # of what scales a value: less is zero for every practical purpose


def product_floors(diagonal: Array) -> Array:
    """Computes magnitudes below which products 23, 13, 12 of a matrix count as zero, shape (..., 3).

    They are 1e-9 of sqrt(A_ii A_jj).

    Args:
        diagonal: elements 11, 22, 33, shape (..., 3).
    """
    size = np.abs(diagonal)
    floors: Array = _NOTHING * np.sqrt(size[..., [1, 0, 0]] * size[..., [2, 2, 1]])
    return floors


def zero_floors(parameters: Array) -> Array:
    """Computes magnitudes below which the ten parameters count as zero and have no percentage, shape (..., 10).

    That of a product is 1e-9 of sqrt(I_ii^-1 I_jj^-1), that of a coordinate of the center of mass 1e-9 of the vector's
    length or, where that is larger and the mass is known, of the largest radius of gyration; the others have none.

    Args:
        parameters: in their order, shape (..., 10).
    """
    floors = np.zeros_like(parameters)
    floors[..., 3:6] = product_floors(parameters[..., :3])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        gyration = np.sqrt(np.abs(parameters[..., MASS_RECIPROCAL] / np.abs(parameters[..., :3]).min(axis=-1)))
    gyration = np.where(np.isfinite(gyration), gyration, 0.0)
    length = np.linalg.norm(parameters[..., CENTER_OF_MASS], axis=-1)
    floors[..., CENTER_OF_MASS] = _NOTHING * np.fmax(length, gyration)[..., None]
    return floors


def percent_error(estimate: Array, truth: Array) -> Array:
    """Computes 100 (estimate - truth) / |truth| per parameter; NaN where truth counts as zero or is not finite."""
    known = np.abs(truth) > zero_floors(truth)
    error = np.full(10, np.nan)
    with np.errstate(over="ignore"):
        error[known] = 100.0 * (estimate[known] - truth[known]) / np.abs(truth[known])
    error[np.isinf(error)] = np.nan
    return error


@kernel
def join_ten_parameters(rotational: Array, mass_reciprocal: float) -> Array:
    """Joins nine values of the rotational parameters and one of 1/mass to a vector, shape (10,)."""
    result = np.empty(N_ROTATION + 1)
    result[:N_ROTATION] = rotational
    result[MASS_RECIPROCAL] = mass_reciprocal
    return result


def are_converged(
    standard_deviation: Array, estimate: Array, limits: Array, known: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Flags samples at which estimates have converged, see `is_converged`, shape (n,).

    Args:
        standard_deviation, estimate, limits: see there.
        known: which of the ten parameters are not estimated, and block nothing, shape (10,); None: none.
    """
    diagonal, center, reciprocal = limits.tolist()
    relative = np.append(np.full(3, diagonal), reciprocal)
    scaled = [0, 1, 2, 9]
    s, x = standard_deviation[:, scaled], estimate[:, scaled]
    good = (s > 0.0) & (s < relative * x)
    placed = standard_deviation[:, CENTER_OF_MASS] < center
    if known is not None:
        good |= known[scaled]
        placed |= known[CENTER_OF_MASS]
    return good.all(axis=1) & placed.all(axis=1)


@kernel
def is_converged(standard_deviation: Array, estimate: Array, limits: Array) -> bool:
    r"""Tests whether 1-sigmas of inverse inertia's diagonal, center of mass and 1/mass are below their limits.

    The center of mass in length, the others relative to their estimates, which must be positive.

    Args:
        standard_deviation: of the ten parameters, shape (10,).
        estimate: the ten parameters, shape (10,).
        limits: relative limit of the diagonal, limit of the center of mass (ft or m), relative limit
            of the mass reciprocal, shape (3,).
    """
    s = numbers(standard_deviation, 10)
    x = numbers(estimate, 10)
    diagonal, center, reciprocal = numbers(limits, 3)
    return (
        0.0 < s[0] < diagonal * x[0]
        and 0.0 < s[1] < diagonal * x[1]
        and 0.0 < s[2] < diagonal * x[2]
        and s[6] < center
        and s[7] < center
        and s[8] < center
        and 0.0 < s[9] < reciprocal * x[9]
    )
