"""Parts that move inside the vehicle, such as sloshing propellant or a hinged panel, as modes of the joint state.

Equations: theory page of the joint filter, "Parts that move inside" (Likins, Dynamics and Control of Flexible Space
Vehicles, JPL TR 32-1329), with Phi_v (root of mass) and Phi_w (root of inertia) the participations, A, D and K of the
modes with the vehicle's own motion eliminated. Participation in rotation is stated about the vehicle origin; about r
it is Phi_w - r x Phi_v. Derivatives by anything in A, D and K are integrals of exp(A (T - s)) times a residual, by
Simpson's rule. Errors of a part's position p are parameters: off by p it has Phi_w + p x Phi_v. Where thrust has a
common scale s, inertia and mass in A, and in what modes give back, are those with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, cross

SIZE, FREQUENCY, DAMPING, POSITION, ERRORS = 0, 1, 2, 3, 6  # order of the errors of a part, and how many there are
_TERMS = 10  # of the exponential's series: arithmetic, they leave 2e-11 of what is below half
_SMALL = 0.5  # largest norm to which the series applies: arithmetic
_LEAST = 0.05  # physics: of what is stated, a part that moves has no less participation, frequency or damping


class ModeParams(NamedTuple):
    """Parameters of a vehicle's modes.

    Attributes:
        translation: Phi_v, body axes, root of slug or kg, shape (n, 3).
        rotation: Phi_w about the vehicle origin, root of slug-ft^2 or kg-m^2, shape (n, 3).
        crossing: e_j x e_i of the directions in which modes i and j displace one mass, zero of others, shape (n, n, 3).
        bow: by half of eta^2 a mass on an arm is displaced off its direction, times its mass: b = -n/L of a pendulum
            with the arm L n, zero of others, 1/ft or 1/m, shape (n, 3).
        bow_turn: that at its place about the nominal center of mass, rho x b, shape (n, 3).
        swelling: I_1 about the nominal center of mass, root of slug times ft or of kg times m, shape (n, 3, 3).
        frequencies: w_n, rad/s, shape (n,).
        dampings: zeta, shape (n,).
        parts: index of the part that each belongs to, integers, shape (n,).
        sigmas: 1-sigma of each part's participation, frequency and damping, relative, and of the three coordinates of
            its position, ft or m, shape (n_parts, 6).
        start: 1-sigma of eta before the first sample, shape (n,).
        shaken: 1-sigma of eta after something of which nothing is known, likewise.
    """

    translation: Array
    rotation: Array
    crossing: Array
    bow: Array
    bow_turn: Array
    swelling: Array
    frequencies: Array
    dampings: Array
    parts: np.ndarray
    sigmas: Array
    start: Array
    shaken: Array


NO_MODES = ModeParams(
    np.zeros((0, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 0, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0, dtype=np.int_),
    np.zeros((0, ERRORS)),
    np.zeros(0),
    np.zeros(0),
)


class Rigid(NamedTuple):
    """The vehicle with its modes locked.

    Attributes:
        inverse: J, with the common scale of thrusts in it, shape (3, 3).
        lightness: mu, likewise.
        center: r, ft or m, shape (3,).
    """

    inverse: Array
    lightness: float
    center: Array


class Swing(NamedTuple):
    """Motion of the modes over an interval.

    Attributes:
        push, turn: Phi_v and Phi_w about the center of mass as they are estimated, shape (n, 3).
        stiffness, drag: diagonals of K and D, shape (n,).
        lightness: A^-1, shape (n, n).
        over, half: what becomes of eta and eta', over the interval and over half of it, shape (2 n, 2 n).
        driven, half_driven: eta and eta' by f, likewise, shape (2 n, n).
    """

    push: Array
    turn: Array
    stiffness: Array
    drag: Array
    lightness: Array
    over: Array
    half: Array
    driven: Array
    half_driven: Array


@kernel
def _matrix_exponential(matrix: Array) -> Array:
    """Computes the exponential of a square matrix, by Taylor series, scaling and squaring."""
    squarings = 0
    norm = np.abs(matrix).sum(axis=1).max()
    while norm > _SMALL:
        norm *= 0.5
        squarings += 1
    scaled = matrix * 0.5**squarings
    identity = np.eye(matrix.shape[0])
    result = identity + scaled / _TERMS
    for term in range(_TERMS - 1, 0, -1):
        result = identity + (scaled @ result) / term
    for _ in range(squarings):
        result = result @ result
    return result


@kernel
def estimated_part_ratios(errors: Array, modes: ModeParams) -> Array:
    """Returns moving parts' participation, frequency, damping relative to stated; position shifts, shape (n_parts, 6).

    Args:
        errors: estimates in units of their sigmas, shape (6 n_parts,); none: as stated.
    """
    ratios = np.ones(modes.sigmas.shape)
    ratios[:, POSITION:] = 0.0
    if errors.shape[0] > 0:
        scaled_errors = modes.sigmas * errors.reshape(-1, ERRORS)
        ratios[:, :POSITION] = np.maximum(1.0 + scaled_errors[:, :POSITION], _LEAST)
        ratios[:, POSITION:] = scaled_errors[:, POSITION:]
    return ratios


@kernel
def mode_motion(rigid: Rigid, part_ratios: Array, duration_s: float, modes: ModeParams) -> Swing:
    """Computes transition matrices and coupling of the modes over an interval, at estimated parameters.

    Args:
        part_ratios: see `estimated_part_ratios`.
    """
    n = modes.frequencies.shape[0]
    mode_ratios = part_ratios[modes.parts]
    push = mode_ratios[:, SIZE].copy().reshape(-1, 1) * modes.translation
    turn = mode_ratios[:, SIZE].copy().reshape(-1, 1) * modes.rotation
    for mode in range(n):
        turn[mode] += cross(mode_ratios[mode, POSITION:] - rigid.center, push[mode])
    frequencies = mode_ratios[:, FREQUENCY] * modes.frequencies
    stiffness, drag = frequencies**2, 2.0 * mode_ratios[:, DAMPING] * modes.dampings * frequencies
    inertia = np.eye(n) - rigid.lightness * (push @ push.T) - turn @ rigid.inverse @ turn.T
    lightness = np.linalg.inv(inertia)
    rates = np.zeros((3 * n, 3 * n))
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n, :n] = -lightness * stiffness
    rates[n : 2 * n, n : 2 * n] = -lightness * drag
    rates[n : 2 * n, 2 * n :] = -lightness
    half = _matrix_exponential(rates * (0.5 * duration_s))
    over = half @ half
    return Swing(
        push,
        turn,
        stiffness,
        drag,
        lightness,
        over[: 2 * n, : 2 * n].copy(),
        half[: 2 * n, : 2 * n].copy(),
        over[: 2 * n, 2 * n :].copy(),
        half[: 2 * n, 2 * n :].copy(),
    )


def mode_sigmas(displacement_sigmas: Array, modes: ModeParams) -> Array:
    """Returns 1-sigmas of modal displacements and rates, shape (2 n,), from those of the displacements (n,)."""
    return np.concatenate((displacement_sigmas, displacement_sigmas * modes.frequencies))
