"""One sample of the true vehicle: readings of its sensors, then its motion under its jets.

The parts are those that the systems of the `vehicle` diagram call one by one; a plain loop calls `sense` and `step`.
What is drawn by chance, and what is a function of time alone, is made for many samples ahead, see `Ahead`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle import reaction_jets, rigid_body, true_failures
from massprop_drake.maths.vehicle.depletion import NO_TANKS, Tanks, drain_tanks, structure_after_draining
from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, move_to_origin, next_deviation
from massprop_drake.maths.vehicle.on_times import has_pulse
from massprop_drake.maths.vehicle.reaction_jets import JetThrusts
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    ORIGIN_VELOCITY,
    RATE,
    SPIN_INTEGRAL,
    STRUCTURE,
    Body,
    Jump,
    round_as_stored,
)
from massprop_drake.maths.vehicle.sensing import (
    PackageErrors,
    TruePackage,
    limit_to_range,
    nearest_mark,
    point_velocity,
    quantize,
    read_with_memory,
    read_without_memory,
    vibration_at,
)
from massprop_drake.maths.vehicle.true_failures import Failure, FailureTable

_QUIET = np.zeros(6)
NO_FILL = np.zeros(0)
_DISTURBANCE = "disturbance"  # stream of its noise
_CENTER = STRUCTURE.slice("center_of_mass")
_MEMORY = 10  # numbers that a package remembers besides late readings


class Packages(NamedTuple):
    """All packages of sensors as arrays, see `sensing.TruePackage` and `sensing.SensorModel`, shape (n, ...).

    Attributes:
        plain: whether all do no more than quantize.
    """

    plain: bool
    exact: NDArray[np.bool_]
    remembers: NDArray[np.bool_]
    shakes: NDArray[np.bool_]
    integrates: NDArray[np.bool_]
    positions: Array
    scale_factors: Array
    smoothings: Array
    biases: Array
    walk_stds: Array
    noise_stds: Array
    quanta: Array
    phases: Array
    delays: NDArray[np.int_]
    limits: Array


def pack_packages(packages: tuple[TruePackage, ...]) -> Packages:
    """Packs sensor packages' errors, positions and kinds into arrays, a row per package."""
    models = [package.model for package in packages]
    nowhere = np.zeros(3)

    def vectors(name: str) -> Array:
        """Collects a vector attribute of all sensor models, shape (n_packages, 3)."""
        return np.array([getattr(model, name) for model in models], dtype=float).reshape(-1, 3)

    def numbers(name: str) -> Array:
        """Collects a scalar attribute of all sensor models, shape (n_packages,)."""
        return np.array([getattr(model, name) for model in models], dtype=float)

    exact = np.array([model.exact and not model.remembers for model in models], dtype=np.bool_)
    quanta, limits = numbers("quantum"), numbers("limit")
    return Packages(
        bool((exact & (quanta > 0.0) & np.isinf(limits)).all()),
        exact,
        np.array([model.remembers for model in models], dtype=np.bool_),
        np.array([model.vibration is not None for model in models], dtype=np.bool_),
        np.array([package.position is not None for package in packages], dtype=np.bool_),
        np.array([nowhere if one.position is None else one.position for one in packages]).reshape(-1, 3),
        vectors("scale_factor"),
        numbers("smoothing"),
        vectors("bias"),
        numbers("walk_std"),
        numbers("noise_std"),
        quanta,
        vectors("phase"),
        np.array([model.delay for model in models], dtype=np.int_),
        limits,
    )


class Truth(NamedTuple):
    """True vehicle as arrays, for the arithmetic of a sample.

    Attributes:
        period_s: sample period, s, and step of the body.
        mass: at the start, slug or kg.
        jets: see `JetThrusts`.
        failures: what jets deliver in place of what they are told.
        packages: see `Packages`.
        pushed: whether something pushes besides the jets.
        push: what does; its numbers are of no meaning where nothing does.
        tanks: that jets empty.
        structure: at the start, see `VehicleState`.
    """

    period_s: float
    mass: float
    jets: JetThrusts
    failures: FailureTable
    packages: Packages
    pushed: bool
    push: DisturbanceModel
    tanks: Tanks
    structure: Array


class VehicleParams(NamedTuple):
    """Parameters of the true vehicle.

    Attributes:
        period_s: sample period, s, and step of the body.
        seed: of noise and intermittent failures.
        jets: see `JetThrusts`.
        failures: what jets deliver in place of what they are told.
        packages: of sensors, in the vehicle's order.
        disturbance: what pushes besides the jets; None: nothing.
        jumps: of the mass properties, by sample.
        body, structure: at the start, see `VehicleState`.
        planar: whether a floor carries the vehicle, see `reaction_jets.true_wrenches`.
        tanks: that jets empty.
        fill: propellant in each at the start, slug or kg, shape (n_tanks,).
    """

    period_s: float
    seed: int
    jets: JetThrusts
    failures: tuple[Failure, ...]
    packages: tuple[TruePackage, ...]
    disturbance: DisturbanceModel | None
    jumps: Mapping[int, tuple[Jump, ...]]
    body: Array
    structure: Array
    planar: bool = False
    tanks: Tanks = NO_TANKS
    fill: Array = NO_FILL


def pack_truth(params: VehicleParams) -> Truth:
    """Packs the parameters of the true vehicle for the compiled cycle: jets, packages, tanks, failures."""
    push = DisturbanceModel(_QUIET, _QUIET, 0.0, _QUIET) if params.disturbance is None else params.disturbance
    return Truth(
        params.period_s,
        float(params.body[MASS]),
        params.jets,
        true_failures.failure_table(params.failures),
        pack_packages(params.packages),
        params.disturbance is not None,
        push,
        params.tanks,
        params.structure,
    )


class Ahead(NamedTuple):
    """Random draws and scheduled events of some samples, a row each.

    Attributes:
        noise: of the packages, standard normal, shape (n, n_packages, 6).
        shaking: vibration in their readings, shape (n, n_packages, 3).
        push: standard normal, shape (n, 6).
        strikes: see `true_failures.draw_strikes`, shape (n, n_failures).
        jumps: whether mass properties jump, shape (n,).
    """

    noise: Array
    shaking: Array
    push: Array
    strikes: NDArray[np.bool_]
    jumps: NDArray[np.bool_]


def draw_ahead(first_sample: int, count: int, params: VehicleParams) -> Ahead:
    """Draws noise, vibration, disturbance and intermittent failures of coming samples, a row per sample.

    Args:
        first_sample: sample.
    """
    packages, failures = params.packages, params.failures
    made = Ahead(
        np.zeros((count, len(packages), 6)),
        np.zeros((count, len(packages), 3)),
        np.zeros((count, 6)),
        np.zeros((count, len(failures)), dtype=np.bool_),
        np.array([first_sample + row in params.jumps for row in range(count)], dtype=np.bool_),
    )
    for index, package in enumerate(packages):
        for row in range(count if package.model.noisy else 0):
            made.noise[row, index] = normal_sample(params.seed, package.name, first_sample + row, 6)
        for row in range(count if package.model.vibration is not None else 0):
            made.shaking[row, index] = vibration_at(package.model, (first_sample + row) * params.period_s)
    for row in range(count if params.disturbance is not None else 0):
        made.push[row] = normal_sample(params.seed, _DISTURBANCE, first_sample + row, 6)
    for row in range(count if failures else 0):
        made.strikes[row] = true_failures.draw_strikes(failures, first_sample + row, params.period_s, params.seed)
    return made


class VehicleState(NamedTuple):
    """State of the vehicle at a sample.

    Attributes:
        body: see `rigid_body`, shape (23,).
        structure: packed as `rigid_body.STRUCTURE`.
        constants: of the body's motion, with the momentum of its wheels as the coming step begins.
        level: thrust level of each jet a sample ago, shape (n_jets,).
        target: what it has tended to since, shape (n_jets,).
        deviation: of the disturbance, see `Disturbance`, shape (6,).
        memories: of the packages, a row each, shape (n_packages, 10 + 3 times the longest delay).
        fill: propellant in each tank, slug or kg, shape (n_tanks,).
    """

    body: Array
    structure: Array
    constants: Body
    level: Array
    target: Array
    deviation: Array
    memories: Array
    fill: Array


def initial_state(params: VehicleParams) -> VehicleState:
    """Returns the vehicle's state before the first sample: jets commanded off, sensors' memories zero."""
    off = np.zeros(params.jets.forces.size)
    longest = max((package.model.delay for package in params.packages), default=0)
    return VehicleState(
        params.body,
        params.structure,
        rigid_body.constants_from_structure(params.structure),
        off,
        true_failures.delivered_levels(off, -1, params.period_s, params.failures, params.seed),
        _QUIET if params.disturbance is None else params.disturbance.before,
        np.zeros((len(params.packages), _MEMORY + 3 * longest)),
        params.fill,
    )


@kernel
def sense(state: VehicleState, row: int, draws: Ahead, params: Truth) -> tuple[Array, Array]:
    """Computes readings of all packages, shape (n_packages, 3), and the packages' memories after them.

    Args:
        state: at the sample.
        row: of the sample in `draws`.
    """
    packages, memories = params.packages, state.memories
    signals = _signals(state.body, packages)
    if packages.plain:
        return nearest_mark(signals, packages.quanta.reshape(-1, 1), packages.phases), memories
    readings = np.empty(signals.shape)
    if has_nonzero(packages.remembers):
        memories = memories.copy()
    for index in range(packages.quanta.size):
        signal = signals[index]
        if packages.exact[index]:
            reading = quantize(signal, packages.quanta[index], packages.phases[index])
            readings[index] = limit_to_range(reading, packages.limits[index])
            continue
        errors, noise = _package_errors(index, params), draws.noise[row, index]
        shaking = draws.shaking[row, index, : 3 * int(packages.shakes[index])]
        if packages.remembers[index]:
            size = _MEMORY + 3 * packages.delays[index]
            readings[index], memories[index, :size] = read_with_memory(
                signal, memories[index, :size], noise, shaking, errors
            )
        else:
            readings[index] = read_without_memory(signal, noise, shaking, errors)
    return readings, memories


@kernel
def _signals(body: Array, packages: Packages) -> Array:
    """Computes each package's error-free signal, rate or velocity, shape (n_packages, 3)."""
    rate, origin, spin = body[RATE], body[ORIGIN_VELOCITY], body[SPIN_INTEGRAL]
    signals = np.empty(packages.positions.shape)
    for index in range(packages.quanta.size):
        gathers = packages.integrates[index]
        signals[index] = point_velocity(origin, rate, spin, packages.positions[index]) if gathers else rate
    return signals


@kernel
def _package_errors(index: int, params: Truth) -> PackageErrors:
    """Returns the errors of a sensor package, by its index."""
    packages = params.packages
    return PackageErrors(
        params.period_s,
        packages.scale_factors[index],
        packages.smoothings[index],
        packages.biases[index],
        packages.walk_stds[index],
        packages.integrates[index],
        packages.noise_stds[index],
        packages.quanta[index],
        packages.phases[index],
        packages.delays[index],
        packages.limits[index],
    )


@kernel
def step(
    state: VehicleState, commands: tuple[Array, Array, Array], sample: int, draw_row: tuple[Ahead, int], params: Truth
) -> tuple[VehicleState, Array]:
    """Advances the vehicle by a sample; returns its state, memories unchanged, and each jet's mean force.

    Args:
        state: at the sample.
        commands: fraction commanded, 0 to 1, onset, see `on_times`, and 1 for each jet whose manifold is closed, shape
            (n_jets,) each.
        sample: its number.
        draw_row: what is to come, and which row of it is the sample's.

    Raises:
        OutOfMassError: when the jets use up the vehicle's mass.
        OutOfPropellantError: when they draw more from a tank than is in it.
        SpunUpError: when the vehicle makes more than a turn in it.
    """
    jets, (coming, row) = params.jets, draw_row
    command, onset_s, closed = commands
    if has_pulse(command, onset_s):
        return _step_by_pieces(state, commands, sample, draw_row, params)
    target = command
    if params.failures.jets.size:
        target = true_failures.apply_failures(
            command, sample * params.period_s, params.period_s, coming.strikes[row], params.failures
        )
    target = target * (1.0 - closed)
    level = state.level if jets.lag.instantaneous else reaction_jets.next_level(state.level, state.target, jets)
    profile = reaction_jets.wrench_profile(level, target, jets)
    deviation, push = _step_disturbance(state, draw_row, params)
    if params.pushed:
        profile[0, :6] += push
    force = reaction_jets.mean_force(level, target, jets)
    structure, fill, constants = _drain_by_firings(state, force, params)
    body = rigid_body.step(state.body, profile[0], profile[1:], jets.class_constants_s, params.period_s, constants)
    body, structure, constants = _finish_step(body, structure, state, params)
    after = VehicleState(body, structure, constants, level, target, deviation, state.memories, fill)
    return after, force


@kernel
def _drain_by_firings(state: VehicleState, force: Array, params: Truth) -> tuple[Array, Array, Body]:
    """Drains the tanks by a sample's firings; returns structure, fill, and motion constants in its middle.

    Args:
        state: before it.
        force: mean force of each jet over it, lbf or N, shape (n_jets,).
    """
    if state.fill.size == 0:
        return state.structure, state.fill, state.constants
    used = reaction_jets.propellant_used(force, params.period_s, params.tanks.feeds, params.jets)
    left = drain_tanks(state.fill, used)
    after = structure_after_draining(state.structure, state.body[MASS], state.fill, used, params.tanks)
    middle, wheels = rigid_body.constants_kernel(0.5 * (state.structure + after)), _wheels(state.constants)
    return after, left, rigid_body.add_wheel_momentum(middle, wheels)


@kernel
def _wheels(body: Body) -> Array:
    """Returns the wheels' angular momentum as a step begins and its time derivative, body axes, shape (6,)."""
    return np.array(body.momentum + body.momentum_rate)


@kernel
def _finish_step(body: Array, structure: Array, previous: VehicleState, params: Truth) -> tuple[Array, Array, Body]:
    """Applies center-of-mass shift and rounding after a step; returns body, structure and motion constants.

    Args:
        body: as the step leaves it.
        structure: after it.
        previous: the vehicle before it.
    """
    constants = previous.constants
    if previous.fill.size > 0:
        rate, shift = 0.5 * (previous.body[RATE] + body[RATE]), structure[_CENTER] - previous.structure[_CENTER]
        body = body + rigid_body.center_shift_increment(body, rate, shift)
        structure = round_as_stored(structure, params.structure)
        constants = rigid_body.constants_kernel(structure)
    body[MASS] = round_as_stored(body[MASS], params.mass)
    return body, structure, constants


@kernel
def _step_by_pieces(
    state: VehicleState, commands: tuple[Array, Array, Array], sample: int, draw_row: tuple[Ahead, int], params: Truth
) -> tuple[VehicleState, Array]:
    """Advances the vehicle as `step`, over a sample within which jets open or close, piece by piece."""
    jets, (coming, row) = params.jets, draw_row
    level = state.level if jets.lag.instantaneous else reaction_jets.next_level(state.level, state.target, jets)
    when, failing = (sample * params.period_s, params.period_s), (params.failures, coming.strikes[row])
    over = reaction_jets.level_course(level, commands, when, failing, jets.time_constants_s)
    deviation, push = _step_disturbance(state, draw_row, params)
    force = jets.forces * over.mean
    structure, fill, constants = _drain_by_firings(state, force, params)
    body, wheels, since_s = state.body, _wheels(constants), 0.0
    for piece in range(over.lengths_s.size):
        profile = reaction_jets.wrench_profile(over.begins[piece], over.targets[piece], jets)
        profile[0, :6] += push
        constants_s, moved = jets.class_constants_s, rigid_body.add_wheel_momentum(constants, wheels, since_s)
        body = rigid_body.step(body, profile[0], profile[1:], constants_s, over.lengths_s[piece], moved)
        since_s += over.lengths_s[piece]
    body, structure, constants = _finish_step(body, structure, state, params)
    after = VehicleState(body, structure, constants, over.end, over.end, deviation, state.memories, fill)
    return after, force


@kernel
def _step_disturbance(state: VehicleState, draw_row: tuple[Ahead, int], params: Truth) -> tuple[Array, Array]:
    """Computes the disturbance's next deviation, and its wrench about the vehicle origin, shape (6,) each."""
    if not params.pushed:
        return state.deviation, np.zeros(6)
    coming, row = draw_row
    deviation = next_deviation(state.deviation, coming.push[row], params.push)
    return deviation, move_to_origin(params.push.mean + deviation, state.structure[_CENTER])


def apply_sample_jumps(state: VehicleState, sample: int, params: VehicleParams) -> VehicleState:
    """Applies the mass-property jumps of a sample to the vehicle; returns its state after them."""
    body, structure = rigid_body.apply_jumps(state.body, state.structure, params.jumps[sample])
    body[MASS] = round_as_stored(body[MASS], float(params.body[MASS]))
    structure = round_as_stored(structure, params.structure)
    return state._replace(body=body, structure=structure, constants=rigid_body.constants_from_structure(structure))


def update_floor_wrenches(truth: Truth, structure: Array, params: VehicleParams) -> Truth:
    """Returns a floor vehicle's truth with jet wrenches about the center of mass after a jump."""
    jets = params.jets
    wrenches = reaction_jets.true_wrenches(jets.wrenches, np.ones(jets.forces.size), structure[_CENTER])
    classes = reaction_jets.class_wrenches(wrenches, jets.time_constants_s, jets.class_constants_s)
    return truth._replace(jets=truth.jets._replace(wrenches=wrenches, class_wrenches=classes))
