"""Bodies joined to a vehicle, taken as one: mass properties and motion of their center of mass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array, symmetrized
from massprop_drake.maths.mass_properties import MassProperties


class Bodies(NamedTuple):
    """Rigid bodies, each in a frame of its own.

    Attributes:
        masses: slug or kg, shape (n,).
        centers: center of mass in the body's frame, ft or m, shape (n, 3).
        inertias: about the body's own center of mass, in the body's axes, shape (n, 3, 3).
    """

    masses: Array
    centers: Array
    inertias: Array


class BodyPlaces(NamedTuple):
    """Poses of bodies' frames in one frame.

    Attributes:
        rotations: from the body's axes to those of that frame, shape (n, 3, 3).
        origins: of the body's frame, ft or m, shape (n, 3).
    """

    rotations: Array
    origins: Array


def composite_body(bodies: Bodies, poses: BodyPlaces) -> MassProperties:
    """Computes mass, center of mass and inertia of all bodies together, in the frame of their poses."""
    turned = poses.rotations
    centers = poses.origins + np.einsum("nij,nj->ni", turned, bodies.centers)
    mass = float(bodies.masses.sum())
    center = bodies.masses @ centers / mass
    arms = centers - center
    offsets = np.einsum("ni,ni->n", arms, arms)[:, None, None] * np.eye(3) - np.einsum("ni,nj->nij", arms, arms)
    inertias = turned @ bodies.inertias @ turned.transpose(0, 2, 1)
    return MassProperties(mass, center, symmetrized((inertias + bodies.masses[:, None, None] * offsets).sum(axis=0)))


def center_velocity(bodies: Bodies, poses: BodyPlaces, rates: Array, velocities: Array) -> Array:
    """Computes the velocity of all bodies' common center of mass, in the frame of their poses, shape (3,).

    Args:
        bodies: that move.
        poses: of them.
        rates: angular velocity of each body, rad/s, shape (n, 3).
        velocities: of the origin of each body's frame, shape (n, 3).
    """
    arms = np.einsum("nij,nj->ni", poses.rotations, bodies.centers)
    moved: Array = bodies.masses @ (velocities + np.cross(rates, arms)) / bodies.masses.sum()
    return moved


def sensed_derivatives(rotation: Array, rate: Array, acceleration: Array, gravity: Array) -> Array:
    """Computes time derivatives of the accelerometers' and the rate-product integrals, shape (9,).

    Args:
        rotation: R_NB of the body that carries the sensors, shape (3, 3).
        rate: angular velocity, rad/s, inertial axes, shape (3,).
        acceleration: of the origin of its frame, inertial axes, shape (3,).
        gravity: field strength there, inertial axes, shape (3,).
    """
    x, y, z = rotation.T @ rate
    specific_force = rotation.T @ (acceleration - gravity)
    return np.array([*specific_force, x * x, y * y, z * z, y * z, x * z, x * y])
