"""One sample of the true vehicle: what its sensors read, then what its jets make of it.

The parts are those that the systems of the `vehicle` diagram call one by one; a plain loop calls `sense` and `step`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle import reaction_jets, rigid_body
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, disturbed, next_deviation
from massprop_drake.maths.vehicle.reaction_jets import JetsParams
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH, ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL, STRUCTURE, Jump
from massprop_drake.maths.vehicle.sensing import Package, point_velocity, sense_now
from massprop_drake.maths.vehicle.sensing import sense as sense_and_remember

_QUIET = np.zeros(6)
_DISTURBANCE = "disturbance"  # stream of its noise
_CENTER = STRUCTURE.slice("center_of_mass")


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
    """

    period_s: float
    seed: int
    jets: JetsParams
    packages: tuple[Package, ...]
    disturbance: DisturbanceModel | None
    jumps: Mapping[int, tuple[Jump, ...]]
    body: Array
    structure: Array


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
    body, time_s = state.body, sample * params.period_s
    readings, memories = [], state.memories
    for index, (name, model, position, exact, remembers) in enumerate(params.packages):
        rate = body[RATE]
        signal = rate
        if position is not None:
            signal = point_velocity(body[ORIGIN_VELOCITY], rate, body[SPIN_INTEGRAL], position)
        if exact and not remembers:
            readings.append(model.read(signal))
            continue
        noise = normal_sample(params.seed, name, sample, 6) if model.noisy else _QUIET
        if remembers:
            reading, memory = sense_and_remember(signal, memories[index], noise, model, time_s)
            memories = (*memories[:index], memory, *memories[index + 1 :])
        else:
            reading = sense_now(signal, noise, model, time_s)
        readings.append(reading)
    return readings, memories


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
    coming = reaction_jets.target(command, closed, sample, jets)
    level = state.level
    if not jets.lag.instantaneous:
        held = reaction_jets.target(state.command, state.closed, sample - 1, jets)
        level = reaction_jets.level_now(level, held, jets)
    profile = reaction_jets.wrench_profile(level, coming, jets)
    if sample in params.jumps:
        body, structure = rigid_body.jumped(body, structure, params.jumps[sample])
    deviation = state.deviation
    if params.disturbance is not None:
        noise = normal_sample(params.seed, _DISTURBANCE, sample, 6)
        deviation = next_deviation(deviation, noise, params.disturbance)
        profile = disturbed(profile, params.disturbance.mean + deviation, structure[_CENTER])
    rows = profile.reshape(-1, N_WRENCH)
    after = rigid_body.step(
        body,
        rows[0],
        rows[1:],
        jets.classes.time_constants_s,
        params.period_s,
        rigid_body.body_of_structure(structure),
    )
    thrust = reaction_jets.mean_force(level, coming, jets)
    return VehicleStep(VehicleState(after, structure, level, command, closed, deviation, state.memories), thrust)
