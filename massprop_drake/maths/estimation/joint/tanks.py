"""Tanks whose propellant is used: a known change of J, r and mu, and its derivatives.

Equations: theory page of the joint filter, "Tanks"; the slice's oracle is `vehicle.depletion`. The third order in q
mu is left out, some 1e-4 of an interval's change at the most. Derivatives by propellant, flow errors, J, r, mu,
thrust errors, s and forces of failed jets are taken to first order in q. Accelerometers have gathered what they have:
r that moves by d in an interval moves c_s by O d, see `measurement`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel, take_elements
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, parallel_axis

_CENTER, _MASS, _N = 6, 9, 10  # places among the ten parameters, as `layout` has them, which imports this
_IDENTITY = np.eye(3)
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # row and column of the six elements
_EACH = np.array([1.0 * (element == ELEMENT) for element in range(6)])  # of J by each of its elements, (6, 3, 3)


class TankParams(NamedTuple):
    """The tanks of a vehicle.

    Attributes:
        outlets: middle of the end at which propellant stands, vehicle frame, ft or m, shape (n, 3).
        columns: c_k, ft/slug or m/kg, shape (n, 3).
        spreads: D, ft^2 or m^2, shape (n, 3, 3).
        feeds: 1 for each jet that draws from a tank, shape (n, n_jets).
        capacities: propellant in a full tank, slug or kg, shape (n,).
        fill: p_k at the start, slug or kg, shape (n,).
        fill_sigma: 1-sigma of it, shape (n,).
        flow_sigma: sigma_k, shape (n,).
    """

    outlets: Array
    columns: Array
    spreads: Array
    feeds: Array
    capacities: Array
    fill: Array
    fill_sigma: Array
    flow_sigma: Array


NO_TANKS = TankParams(
    np.zeros((0, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
    np.zeros((0, 0)),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
)


class TankChange(NamedTuple):
    """Change of the ten parameters and of the propellant by what jets draw from tanks.

    Attributes:
        change: of the ten, but of mu by the flow errors alone, then of each p_k, shape (10 + n,).
        used: propellant of each tank in the scale of thrust, slug or kg, shape (n,).
        by_used: derivative of the change by that, of mu included, shape (10 + n, n).
        by_state: derivative of the change by the ten parameters, of mu by itself left out, and by the p_k, shape
            (10 + n, 10 + n).
    """

    change: Array
    used: Array
    by_used: Array
    by_state: Array


@kernel
def draw_propellant(properties: Array, fill: Array, used: Array, scale: float, tanks: TankParams) -> TankChange:
    """Computes changes of inertia, center of mass and tank fills (1/m aside) by drawn propellant, with derivatives.

    Args:
        properties: the ten parameters, shape (10,).
        fill: p_k, shape (n,).
        used: q_k, shape (n,).
        scale: 1 + sigma_T s.
    """
    n = used.shape[0]
    change, by_used, by_state = np.zeros(_N + n), np.zeros((_N + n, n)), np.zeros((_N + n, _N + n))
    inverse, center, reciprocal = take_elements(properties, ELEMENT), properties[_CENTER:_MASS], properties[_MASS]
    for tank in range(n):
        q, column = used[tank], tanks.columns[tank]
        height = min(max(fill[tank] - 0.5 * scale * q, 0.0), tanks.capacities[tank])
        arm = tanks.outlets[tank] + column * height - center
        about = parallel_axis(arm) / (1.0 - reciprocal * q)
        second, by_lightness = about + tanks.spreads[tank], inverse @ about @ inverse * (q * q / (1.0 - reciprocal * q))
        turned = inverse @ second
        by_mass = turned @ inverse
        whole = q * by_mass + (q * q) * (turned @ by_mass)
        move = -reciprocal / (1.0 - reciprocal * q) * arm
        for element, (i, j) in enumerate(_PAIRS):
            change[element] += whole[i, j]
            by_used[element, tank] = by_mass[i, j]
            by_state[element, _MASS] += by_lightness[i, j]
            by_element = q * (_EACH[element] @ turned.T + turned @ _EACH[element])
            for other, (k, m) in enumerate(_PAIRS):
                by_state[other, element] += by_element[k, m]
        for axis in range(3):
            change[_CENTER + axis] += q * move[axis]
            by_used[_CENTER + axis, tank] = move[axis]
            by_state[_CENTER + axis, _CENTER + axis] += q * reciprocal
            by_state[_CENTER + axis, _MASS] -= q * arm[axis]
            by_center = _arm_derivative(inverse, arm, -_IDENTITY[axis]) * q
            for element, (i, j) in enumerate(_PAIRS):
                by_state[element, _CENTER + axis] += by_center[i, j]
        if 0.0 < height < tanks.capacities[tank]:
            by_fill = _arm_derivative(inverse, arm, column) * q
            for element, (i, j) in enumerate(_PAIRS):
                by_state[element, _N + tank] = by_fill[i, j]
            by_state[_CENTER:_MASS, _N + tank] = -q * reciprocal * column
        by_used[_MASS, tank] = reciprocal * reciprocal
        change[_N + tank] = -scale * q
        by_used[_N + tank, tank] = -scale
    return TankChange(change, used, by_used, by_state)


@kernel
def _arm_derivative(inverse: Array, arm: Array, direction: Array) -> Array:
    """Computes the derivative of J N J, N the parallel-axis matrix, along a direction of the arm, shape (3, 3)."""
    crossed = np.outer(arm, direction)
    return inverse @ ((2.0 * (arm @ direction)) * _IDENTITY - crossed - crossed.T) @ inverse
