"""True jets over a sample: levels of thrust from commands, mean forces and a wrench profile.

Within a sample each jet's level goes from where it was toward its target with its time constant, in closed form; see
`maths.vehicle.thrust`. What a failed jet's target is: `maths.vehicle.true_failures`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.kernels import kernel, value_of
from massprop_drake.maths.linear_algebra import Array, cross_products
from massprop_drake.maths.noise import Seed, normal_sample
from massprop_drake.maths.vehicle.on_times import split_sample
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH
from massprop_drake.maths.vehicle.thrust import LagFactors, lag_factors, level_after, mean_level
from massprop_drake.maths.vehicle.true_failures import FailureTable, apply_failures

_TORQUE, _FORCE, _UP, _FLOW = slice(0, 3), slice(3, 6), 5, 6  # in a jet's wrench
_LEAST_FACTOR = 0.01  # above zero: a failed jet's force is a multiple of its thrust


def draw_thrust_factors(seed: Seed, spread: Any, count: int) -> Array:
    """Draws each jet's ratio of true to nominal thrust by a seed, shape (count,); ones without spread.

    Args:
        spread: 1-sigma, relative.

    Raises:
        ValueError: when the spread is symbolic.
    """
    if value_of(spread) == 0.0:
        return np.ones(count)
    factors = 1.0 + spread * normal_sample(seed, "thrust dispersion", 0, count)
    return np.array([factor if value_of(factor) > _LEAST_FACTOR else _LEAST_FACTOR for factor in factors])


def true_wrenches(nominal: Array, factors: Array, floor: Array | None = None) -> Array:
    """Computes each jet's torque, force and mass flow at its true full thrust, shape (n_jets, 7).

    Args:
        nominal: torque about the vehicle origin, force, mass flow at nominal thrust, shape (n_jets, 7).
        factors: true over nominal thrust, shape (n_jets,).
        floor: center of mass of a vehicle that glides on a floor, shape (3,): the floor takes force along z, and
            torque about the center of mass but about z. None: the vehicle is free.
    """
    wrenches = factors[:, None] * nominal
    if floor is not None:
        wrenches[:, _UP] = 0.0
        wrenches[:, _TORQUE][:, :2] = cross_products(floor, wrenches[:, _FORCE])[:, :2]
    return wrenches


class JetThrusts(NamedTuple):
    """True jets; those of one time constant are a class, so that a few exponentials carry all transients.

    Attributes:
        wrenches: torque about the vehicle origin, force, mass flow at full thrust, shape (n_jets, 7).
        forces: size of each jet's force, lbf or N, shape (n_jets,).
        time_constants_s: of each jet, s, shape (n_jets,).
        lag: factors of a sample period.
        class_wrenches: see `class_wrenches`.
        class_constants_s: the distinct positive time constants, s, shape (n_classes,).
    """

    wrenches: Array
    forces: Array
    time_constants_s: Array
    lag: LagFactors
    class_wrenches: Array
    class_constants_s: Array


def class_wrenches(wrenches: Array, time_constants_s: Array, class_constants_s: Array) -> Array:
    """Returns per distinct time constant the wrenches of its jets, zero for others, (n_classes, n_jets, 7)."""
    members = [(time_constants_s == constant)[:, None] * wrenches for constant in class_constants_s.tolist()]
    return np.array(members).reshape(len(members), *wrenches.shape)


def make_jets(wrenches: Array, time_constants_s: Array, period_s: float) -> JetThrusts:
    """Collects the true jets: wrenches, forces, lag factors of a period, and classes of equal time constant.

    Args:
        wrenches, time_constants_s: see `JetThrusts`.
    """
    forces = np.sqrt((wrenches[:, _FORCE] * wrenches[:, _FORCE]).sum(axis=1))
    distinct_s = np.array(sorted({constant for constant in time_constants_s.tolist() if constant > 0.0}), dtype=float)
    lag, classes = lag_factors(time_constants_s, period_s), class_wrenches(wrenches, time_constants_s, distinct_s)
    return JetThrusts(wrenches, forces, time_constants_s, lag, classes, distinct_s)


@kernel
def next_level(level: Array, target: Array, jets: JetThrusts) -> Array:
    """Computes thrust levels (1: full) a sample later, under the target held over it, shape (n_jets,)."""
    return level_after(level, target, jets.lag.remaining)


@kernel
def mean_force(level: Array, target: Array, jets: JetThrusts) -> Array:
    """Computes the mean force of each jet over the coming sample, lbf or N, shape (n_jets,).

    Args:
        level: now, which does not matter where no jet lags, shape (n_jets,).
        target: target of that sample, shape (n_jets,).
    """
    if jets.lag.instantaneous:
        return jets.forces * target
    return jets.forces * mean_level(level, target, jets.lag.mean)


@kernel
def wrench_profile(level: Array, target: Array, jets: JetThrusts) -> Array:
    """Computes the coming sample's wrench profile: steady wrench, then the decaying part per time constant.

    Arguments as `mean_force`; shape (1 + n_classes, 7).
    """
    profile = np.empty((1 + jets.class_constants_s.size, jets.wrenches.shape[1]), dtype=target.dtype)
    profile[0] = np.dot(target, jets.wrenches)
    if jets.class_constants_s.size:
        difference = level - target
        for index in range(jets.class_constants_s.size):
            profile[1 + index] = difference @ jets.class_wrenches[index]
    return profile


@kernel
def propellant_used(force: Array, period_s: float, feeds: Array, jets: JetThrusts) -> Array:
    """Computes propellant mass drawn from each tank over a sample by jets' mean forces, slug or kg, (n_tanks,).

    Args:
        force: mean force of each jet over it, lbf or N, shape (n_jets,).
        feeds: 1 for each jet that draws from a tank, shape (n_tanks, n_jets).
    """
    return feeds @ (force / jets.forces * jets.wrenches[:, _FLOW]) * period_s


class LevelCourse(NamedTuple):
    """Levels over a sample whose jets open or close within it, piece by piece.

    Attributes:
        lengths_s: of the pieces, s, shape (k,).
        begins: level of each jet at the beginning of each, shape (k, n_jets).
        targets: what it tends to, likewise.
        end: level at the end of the sample, shape (n_jets,).
        mean: over the sample, shape (n_jets,).
    """

    lengths_s: Array
    begins: Array
    targets: Array
    end: Array
    mean: Array


@kernel
def level_course(
    level: Array,
    commands: tuple[Array, Array, Array],
    timing_s: tuple[float, float],
    faults: tuple[FailureTable, NDArray[np.bool_]],
    time_constants_s: Array,
) -> LevelCourse:
    """Computes thrust levels (1: full) over a sample, in pieces of constant target, failures included.

    Args:
        level: at its beginning, shape (n_jets,).
        commands: command and onset, see `on_times`, and 1 for each jet whose manifold is closed, shape (n_jets,) each.
        timing_s: when the sample begins, and its length, s.
        faults: failures, and which of them strike, see `true_failures.draw_strikes`.
        time_constants_s: of each jet, s, shape (n_jets,).
    """
    (command, onset_s, closed), (since_s, period_s), (failures, strikes) = commands, timing_s, faults
    lengths, targets = split_sample(command, onset_s, period_s, (0.0, period_s))
    begins, mean = np.empty_like(targets), np.zeros_like(level)
    for piece in range(lengths.size):
        length_s = lengths[piece]
        if failures.jets.size:
            targets[piece] = apply_failures(targets[piece], since_s, length_s, strikes, failures)
        targets[piece] *= 1.0 - closed
        begins[piece] = level
        after = np.empty_like(level)
        for jet in range(level.size):
            tau_s, target = time_constants_s[jet], targets[piece, jet]
            left = math.exp(-length_s / tau_s) if tau_s > 0.0 else 0.0
            after[jet] = level_after(level[jet], target, left)
            mean[jet] += mean_level(level[jet], target, tau_s / length_s * (1.0 - left)) * (length_s / period_s)
        level = after
        since_s += length_s
    return LevelCourse(lengths, begins, targets, level, mean)


def profile_size(n_lags: int, pieces: int = 1) -> int:
    """Returns the length of a wrench profile: 7 (1 + n_lags) for each piece, and one more each if there are several."""
    return N_WRENCH * (1 + n_lags) if pieces == 1 else pieces * (1 + N_WRENCH * (1 + n_lags))


def profile_by_pieces(levels: LevelCourse, jets: JetThrusts, pieces: int) -> Array:
    """Packs length and wrench profile of each piece of a sample in which jets switch, shape (pieces, any).

    Args:
        levels: of the levels.
        pieces: the largest number that there can be; further ones have no length.

    Raises:
        ValueError: when there are more.
    """
    count = levels.lengths_s.size
    if count > pieces:
        raise ValueError(f"jets open and close at {count - 1} times in a sample, where {pieces - 1} were foreseen")
    profile = np.zeros((pieces, profile_size(jets.class_constants_s.size, pieces) // pieces))
    profile[:count, 0] = levels.lengths_s
    for piece in range(count):
        profile[piece, 1:] = wrench_profile(levels.begins[piece], levels.targets[piece], jets).ravel()
    return profile
