"""One sample of the true vehicle: what its sensors read, then what its jets make of it.

The parts are those that the systems of the `vehicle` diagram call one by one; a plain loop calls `sense` and `step`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.kernels import chosen, kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle import reaction_jets, rigid_body
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, about_origin, next_deviation
from massprop_drake.maths.vehicle.reaction_jets import JetsParams, Thrusters
from massprop_drake.maths.vehicle.rigid_body import ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL, STRUCTURE, Body, Jump
from massprop_drake.maths.vehicle.sensing import Package, point_velocity, quantized, sense_now
from massprop_drake.maths.vehicle.sensing import sense as sense_and_remember

_QUIET = np.zeros(6)
_NO_PUSH = np.empty(0)
_DISTURBANCE = "disturbance"  # stream of its noise
_CENTER = STRUCTURE.slice("center_of_mass")


class ExactPackages(NamedTuple):
    """The packages of sensors whose readings are the truth but for quantum and range.

    Attributes:
        integrates: whether each is an accelerometer, shape (n,).
        positions: of those, vehicle frame, ft or m, shape (n, 3).
        quanta: steps of their readings, shape (n,).
        phases: where the marks lie, in quanta, shape (n, 3).
        limits: largest reading either way, shape (n,).
    """

    integrates: NDArray[np.bool_]
    positions: Array
    quanta: Array
    phases: Array
    limits: Array


@kernel
def exact_readings(body: Array, holder: Any) -> Array:
    """Readings of the exact packages, shape (n, 3).

    Args:
        body: state of the body, see `rigid_body`, shape (23,).
        holder: of `ExactPackages`.
    """
    packages = holder.value
    readings = np.empty(packages.positions.shape)
    rate, origin, spin = body[RATE], body[ORIGIN_VELOCITY], body[SPIN_INTEGRAL]
    for index in range(packages.quanta.size):
        signal, limit = rate, packages.limits[index]
        if packages.integrates[index]:
            signal = point_velocity(origin, rate, spin, packages.positions[index])
        reading = quantized(signal, packages.quanta[index], packages.phases[index])
        readings[index] = reading if limit == math.inf else np.minimum(np.maximum(reading, -limit), limit)
    return readings


class Motion(NamedTuple):
    """What the arithmetic of a sample takes that does not change from one to the next.

    Attributes:
        jets: see `Thrusters`.
        period_s: length of a sample, s.
    """

    jets: Thrusters
    period_s: float


class Moved(NamedTuple):
    """Body and jets a sample later.

    Attributes:
        body: see `rigid_body`, shape (23,).
        level: thrust levels at the beginning of the sample, shape (n_jets,).
        thrust: mean forces over it, lbf or N, shape (n_jets,).
    """

    body: Array
    level: Array
    thrust: Array


@kernel
def moved(body: Array, level: Array, targets: Array, push: Array, constants: Body, holder: Any) -> Moved:
    """One sample of jets and body.

    Args:
        body: state at its beginning, shape (23,).
        level: thrust levels a sample before, shape (n_jets,).
        targets: of the levels over the sample before and this one, shape (2, n_jets).
        push: torque about the vehicle origin and force besides the jets', shape (6,); empty: none.
        constants: of the body's motion.
        holder: of `Motion`.

    Raises:
        OutOfMassError: when the jets use up the vehicle's mass.
        SpunUpError: when the vehicle makes more than a turn in it.
    """
    motion = holder.value
    jets, coming = motion.jets, targets[1]
    now = level if jets.lag.instantaneous else reaction_jets.level_now(level, targets[0], jets)
    profile = reaction_jets.wrench_profile(now, coming, jets)
    if push.size:
        profile[0, :6] += push
    after = rigid_body.step(body, profile[0], profile[1:], jets.class_constants_s, motion.period_s, constants)
    return Moved(after, now, reaction_jets.mean_force(now, coming, jets))


class Kernels(NamedTuple):
    """The functions that do the arithmetic: those above, or their compiled forms."""

    exact_readings: Callable[[Array, Any], Array]
    moved: Callable[[Array, Array, Array, Array, Body, Any], Moved]


def kernels(*, compiled: bool = False) -> Kernels:
    """The kernels of a vehicle's sample."""
    return Kernels(chosen(exact_readings, compiled), chosen(moved, compiled))


class VehicleParams(NamedTuple):
    """The true vehicle.

    Attributes:
        period_s: sample period, s, and step of the body.
        seed: of the noise.
        jets: see `JetsParams`.
        packages: of sensors, in the vehicle's order.
        disturbance: what pushes besides the jets; None: nothing.
        jumps: of the mass properties, by sample.
        body, structure: at the start, see `VehicleState`.
        exact, places: holder of the exact packages, and their places among all.
        motion: holder of `Motion`.
        kernels: see `Kernels`.
    """

    period_s: float
    seed: int
    jets: JetsParams
    packages: tuple[Package, ...]
    disturbance: DisturbanceModel | None
    jumps: Mapping[int, tuple[Jump, ...]]
    body: Array
    structure: Array
    exact: Any
    places: tuple[int, ...]
    motion: Any
    kernels: Kernels


def exact_packages(packages: tuple[Package, ...]) -> tuple[ExactPackages, tuple[int, ...]]:
    """The exact ones among some packages, and their places."""
    places = tuple(index for index, package in enumerate(packages) if package.exact and not package.remembers)
    found = [packages[place] for place in places]
    nowhere = np.zeros(3)
    return (
        ExactPackages(
            np.array([one.position is not None for one in found], dtype=bool),
            np.array([nowhere if one.position is None else one.position for one in found]).reshape(-1, 3),
            np.array([one.model.quantum for one in found]),
            np.array([one.model.phase for one in found]).reshape(-1, 3),
            np.array([one.model.limit for one in found]),
        ),
        places,
    )


class VehicleState(NamedTuple):
    """The vehicle at a sample.

    Attributes:
        body: see `rigid_body`, shape (23,).
        structure: packed as `rigid_body.STRUCTURE`.
        level: thrust level of each jet a sample ago, shape (n_jets,).
        command: fraction commanded over the sample that ends, shape (n_jets,).
        closed: 1 for each jet whose manifold was closed over it, shape (n_jets,); None: none can be.
        deviation: of the disturbance, see `Disturbance`, shape (6,).
        memories: of the packages.
    """

    body: Array
    structure: Array
    level: Array
    command: Array
    closed: Array | None
    deviation: Array
    memories: tuple[Array, ...]


def initial_state(params: VehicleParams, *, closes: bool = False) -> VehicleState:
    """The vehicle at the first sample: jets off.

    Args:
        params: see `VehicleParams`.
        closes: whether manifolds can be closed.
    """
    off = np.zeros(params.jets.forces.size)
    deviation = _QUIET if params.disturbance is None else params.disturbance.before
    memories = tuple(np.zeros(package.model.memory_size) for package in params.packages)
    return VehicleState(params.body, params.structure, off, off, off if closes else None, deviation, memories)


def sense(state: VehicleState, sample: int, params: VehicleParams) -> tuple[list[Array], tuple[Array, ...]]:
    """Readings of every package at a sample, shape (3,) each, and what they remember.

    Args:
        state: at the sample.
        sample: its number.
        params: see `VehicleParams`.
    """
    body, memories = state.body, state.memories
    readings = dict(zip(params.places, params.kernels.exact_readings(body, params.exact), strict=True))
    for index, (name, model, position, _, remembers) in enumerate(params.packages):
        if index in readings:
            continue
        signal, time_s = body[RATE], sample * params.period_s
        if position is not None:
            signal = point_velocity(body[ORIGIN_VELOCITY], signal, body[SPIN_INTEGRAL], position)
        noise = normal_sample(params.seed, name, sample, 6) if model.noisy else _QUIET
        if remembers:
            reading, memory = sense_and_remember(signal, memories[index], noise, model, time_s)
            memories = (*memories[:index], memory, *memories[index + 1 :])
        else:
            reading = sense_now(signal, noise, model, time_s)
        readings[index] = reading
    return [readings[index] for index in range(len(params.packages))], memories


class VehicleStep(NamedTuple):
    """A sample of the vehicle.

    Attributes:
        state: at the next sample; memories are those given.
        thrust: mean force of each jet over the sample, lbf or N, shape (n_jets,).
    """

    state: VehicleState
    thrust: Array


def step(state: VehicleState, command: Array, closed: Array | None, sample: int, params: VehicleParams) -> VehicleStep:
    """The vehicle from one sample to the next.

    Args:
        state: at the sample.
        command: fraction commanded over it, 0 to 1, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed over it, shape (n_jets,); None: none can be.
        sample: number of the sample.
        params: see `VehicleParams`.

    Raises:
        OutOfMassError: when the jets use up the vehicle's mass.
        SpunUpError: when the vehicle makes more than a turn in it.
    """
    jets, body, structure = params.jets, state.body, state.structure
    coming = held = reaction_jets.target(command, closed, sample, jets)
    if not jets.lag.instantaneous:
        held = reaction_jets.target(state.command, state.closed, sample - 1, jets)
    if sample in params.jumps:
        body, structure = rigid_body.jumped(body, structure, params.jumps[sample])
    deviation, push = state.deviation, _NO_PUSH
    if params.disturbance is not None:
        noise = normal_sample(params.seed, _DISTURBANCE, sample, 6)
        deviation = next_deviation(deviation, noise, params.disturbance)
        push = about_origin(params.disturbance.mean + deviation, structure[_CENTER])
    constants = rigid_body.body_of_structure(structure)
    after = params.kernels.moved(body, state.level, np.array([held, coming]), push, constants, params.motion)
    return VehicleStep(
        VehicleState(after.body, structure, after.level, command, closed, deviation, state.memories), after.thrust
    )
