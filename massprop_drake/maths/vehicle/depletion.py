r"""Tanks that jets empty: mass, center of mass and inertia as propellant is used up.

Propellant stands in a tank as a column from the outlet on, along c for each unit of its mass: its surface is at
outlet + c p with a mass p in it. What jets use of it is a slice q at the surface, with its middle at the arm rho from
the center of mass r of a body of mass m and inertia I. By the parallel-axis theorem, exactly,

    m' = m - q,    r' = r - q rho/m',    I' = I - q m/m' (|rho|^2 1 - rho rho^T) - q (D + q^2/12 (|c|^2 1 - c c^T)),

I' about r', with D the second moment of a disk of the column's radius, for each unit of mass. A slice leaves with the
motion of the structure where it lies: the rate stays as it is, and what propellant that flows to a nozzle does to the
rate ("jet damping") is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import parallel_axis, symmetric_matrix


class Tanks(NamedTuple):
    """The tanks of a vehicle.

    Attributes:
        outlets: middle of the end at which propellant stands, vehicle frame, ft or m, shape (n, 3).
        columns: c, ft/slug or m/kg, shape (n, 3).
        spreads: D, ft^2 or m^2, shape (n, 3, 3).
        feeds: 1 for each jet that draws from a tank, shape (n, n_jets).
    """

    outlets: Array
    columns: Array
    spreads: Array
    feeds: Array


NO_TANKS = Tanks(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 0)))


class OutOfPropellantError(ArithmeticError):
    """Error of jets that draw more from a tank than is in it.

    Args:
        tank: its index.
        time_s: when, once a system that knows the time passes the error on.
    """

    def __init__(self, tank: int, time_s: float = float("nan")):
        self.tank, self.time_s = tank, time_s
        super().__init__(f"at {time_s} s jets draw more from tank {tank} than is in it")

    def at(self, time_s: float) -> OutOfPropellantError:
        """Returns the same error with the simulation time added, s."""
        return OutOfPropellantError(self.tank, time_s)


@kernel
def structure_after_draining(structure: Array, mass: float, propellant: Array, drawn: Array, tanks: Tanks) -> Array:
    """Computes the vehicle's inertia (six) and center of mass after propellant use, shape (9,).

    Args:
        structure: the same before, packed as `rigid_body.STRUCTURE`.
        mass: of the vehicle before, slug or kg.
        propellant: propellant in each tank before, slug or kg, shape (n,).
        drawn: of it that is used, slug or kg, shape (n,); negative: it is put in.
    """
    inertia, center = symmetric_matrix(structure[:6]), structure[6:9].copy()
    for tank in range(drawn.shape[0]):
        q, column = drawn[tank], tanks.columns[tank]
        if q == 0.0:
            continue
        arm = tanks.outlets[tank] + column * (propellant[tank] - 0.5 * q) - center
        left = mass - q
        slab = (q * q / 12.0) * parallel_axis(column)
        inertia = inertia - (q * mass / left) * parallel_axis(arm)
        inertia = inertia - q * (tanks.spreads[tank] + slab)
        center = center - (q / left) * arm
        mass = left
    result = np.empty(9)
    for element, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        result[element] = inertia[i, j]
    result[6:9] = center
    return result


@kernel
def drain_tanks(propellant: Array, drawn: Array) -> Array:
    """Computes propellant left in each tank after use, slug or kg, shape (n,); raises when there is too little.

    Args:
        propellant: before, slug or kg, shape (n,).
        drawn: likewise.

    Raises:
        OutOfPropellantError: when there is not so much.
    """
    left = propellant - drawn
    for tank in range(propellant.shape[0]):
        if left[tank] < 0.0:
            raise OutOfPropellantError(tank)
    return left
