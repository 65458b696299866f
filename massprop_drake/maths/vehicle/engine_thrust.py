r"""Engines with a throttle and a gimbal: their response to a command, and their force and its place.

An engine at p with the force F at the level 1, along d where its gimbal is at zero, whose gimbal turns about the axis
a_1 of the vehicle and then about a_2, which turns along with it, gives at the level l and the angles t_1, t_2

    f = F l (1 + b_0 (1 - l) + b_1 l) R(a_1, t_1 + c_1) R(a_2, t_2 + c_2) d    at    p + o_1 e_1 + o_2 e_2

with e_1 and e_2 normal to d. Its six errors are b_0 and b_1 of the thrust at the levels 0 and 1, relative; c_1 and c_2
of the direction, rad; o_1 and o_2 of the place. An engine without a gimbal has e_1 and e_2 for its axes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, cross, skew

N_ERRORS = 6  # of an engine
N_CHANNELS = 3  # level and two angles


class EngineParams(NamedTuple):
    """The engines of a vehicle.

    Attributes:
        positions: p, vehicle frame, ft or m, shape (n, 3).
        directions: d, of the force on the vehicle, unit vectors, shape (n, 3).
        axes: a_1 and a_2, unit vectors at gimbal zero, shape (n, 2, 3).
        normals: e_1 and e_2, likewise.
        thrusts: F, lbf or N, shape (n,).
        levels: between which the flow is linear, rising from 0 to 1, shape (k,).
        flows: of propellant at these, slug/s or kg/s, shape (n, k).
        rates: most that level and angles change by in a second, shape (n, 3).
        constants_s: time constants by which they follow a command, zero: at once, shape (n, 3).
        stops: largest level, and largest angles either way, rad, shape (n, 3).
        read_std: 1-sigma of one reading, of the level relative to it, and of the angles, rad, shape (n, 3).
        least: levels that are read and lie below say that it is shut, shape (n,).
        measured: 1 where they are read as they are, 0 where a reading is a command, shape (n,).
    """

    positions: Array
    directions: Array
    axes: Array
    normals: Array
    thrusts: Array
    levels: Array
    flows: Array
    rates: Array
    constants_s: Array
    stops: Array
    read_std: Array
    least: Array
    measured: Array


_NONE = np.zeros((0, N_CHANNELS))
NO_ENGINES = EngineParams(
    positions=_NONE,
    directions=_NONE,
    axes=np.zeros((0, 2, 3)),
    normals=np.zeros((0, 2, 3)),
    thrusts=np.zeros(0),
    levels=np.array([0.0, 1.0]),
    flows=np.zeros((0, 2)),
    rates=_NONE,
    constants_s=_NONE,
    stops=_NONE,
    read_std=_NONE,
    least=np.zeros(0),
    measured=np.zeros(0),
)


def channel_mask(engines: EngineParams) -> np.ndarray:
    """Flags the channels (level, two angles) that each engine has, shape (n, 3); a fixed engine has no angles."""
    turns = engines.stops[:, 1:] > 0.0
    return np.hstack((np.ones((turns.shape[0], 1), dtype=np.bool_), turns))


def reading_std(settings: Array, engines: EngineParams) -> Array:
    """Computes 1-sigmas of engine readings (level, two angles), shape (n, 3); zero for a shut engine's level.

    Args:
        settings: levels and angles, shape (n, 3).
    """
    std = engines.read_std.copy()
    std[:, 0] *= np.abs(settings[:, 0])
    return std


def follow_command(settings: Array, command: Array, duration_s: float, engines: EngineParams) -> tuple[Array, Array]:
    """Computes engine levels and angles after following a command with lag and rate limits, and their mean until then.

    Args:
        settings: at the start, shape (n, 3).
        command: command, shape (n, 3).
        duration_s: how long, s.

    Returns:
        As they are then, and their mean until then, shape (n, 3) each.
    """
    off, rates, constants_s = command - settings, engines.rates, engines.constants_s
    limited_s = np.maximum(np.abs(off) / rates - constants_s, 0.0)  # until the lag alone is slower
    at_rate_s = np.minimum(limited_s, duration_s)
    there = settings + np.sign(off) * rates * at_rate_s
    rest_s, lagged = duration_s - at_rate_s, constants_s > 0.0
    constants_s = np.where(lagged, constants_s, 1.0)
    arrived = np.where(at_rate_s < limited_s, 1.0, 0.0)  # what has no lag is where it is told to be, once it is there
    left = np.where(lagged, np.exp(-rest_s / constants_s), arrived)
    left_s = np.where(lagged, constants_s * (1.0 - left), 0.0)
    at_rate = 0.5 * (settings + there) * at_rate_s
    mean = (at_rate + command * rest_s - (command - there) * left_s) / duration_s if duration_s > 0.0 else settings
    return np.asarray(command - (command - there) * left), np.asarray(mean)


class Thrust(NamedTuple):
    """Force of an engine at some levels and angles, and its derivatives.

    Attributes:
        place: where it acts, vehicle frame, ft or m, shape (3,).
        along: its directions, shape (m, 3).
        force: its sizes, lbf or N, shape (m,).
        by_angles: derivatives of the directions by the two angles, shape (2, m, 3).
    """

    place: Array
    along: Array
    force: Array
    by_angles: Array


@kernel
def thrust(engine: int, settings: Array, errors: Array, engines: EngineParams) -> Thrust:
    """Computes an engine's force, its direction and place, and derivatives of the direction by gimbal angles.

    Args:
        engine: index of the engine.
        settings: its levels and angles, rad, shape (m, 3).
        errors: its six, see the module, shape (6,).
    """
    first, second, normals = engines.axes[engine, 0], engines.axes[engine, 1], engines.normals[engine]
    one, two, level = settings[:, 1] + errors[2], settings[:, 2] + errors[3], settings[:, 0]
    straight = np.ones((settings.shape[0], 1)) * engines.directions[engine]
    along = rotate_about(first, one, rotate_about(second, two, straight))
    by_angles = np.empty((2, settings.shape[0], 3))
    by_angles[0] = along @ skew(first).T
    turned = rotate_about(first, one, np.ones((settings.shape[0], 1)) * second)
    for k in range(settings.shape[0]):
        by_angles[1, k] = cross(turned[k], along[k])
    force = engines.thrusts[engine] * level * (1.0 + errors[0] * (1.0 - level) + errors[1] * level)
    place = engines.positions[engine] + errors[4] * normals[0] + errors[5] * normals[1]
    return Thrust(place, along, force, by_angles)


@kernel
def rotate_about(axis: Array, angles: Array, vectors: Array) -> Array:
    """Rotates vectors about a unit axis, each by its own angle, rad (Rodrigues' formula), shape (m, 3)."""
    cosines, sines = np.cos(angles).reshape(-1, 1), np.sin(angles).reshape(-1, 1)
    along = (vectors @ axis).reshape(-1, 1) * axis
    return along + (vectors - along) * cosines + (vectors @ skew(axis).T) * sines


@kernel
def wrenches_of(position: Array, forces: Array) -> Array:
    """Computes torques about the vehicle origin, and forces, of forces at a place, shape (m, 6)."""
    return np.hstack((forces @ skew(position).T, forces))
