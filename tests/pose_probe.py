"""An invented vehicle that is followed in a fixed frame, for tests: parameters, a bank in flight, commands."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from massprop_drake.inputs.params import estimation_params
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.vehicle_parts import Surroundings
from massprop_drake.maths.estimation.pose import delays, pose_hypotheses
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseOutcome, PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import (
    Commands,
    Delays,
    PoseBank,
    PoseParams,
    PoseReadings,
    Poses,
    make_parts,
)
from massprop_drake.maths.estimation.pose.pose_start import initialize_bank
from massprop_drake.maths.linear_algebra import Array

JETS = 4
KINDS = np.array([0, 0, 1, 1])
_POSITIONS = np.array([[0.5, 0.2, 0.1], [-0.4, 0.3, -0.2], [0.1, -0.5, 0.3], [0.2, 0.4, -0.4]])
_PUSHES = np.array([[0.0, 0.02, 0.01], [0.015, 0.0, -0.02], [0.02, 0.01, 0.0], [-0.01, -0.015, 0.02]])
MASS = 8.0
SPIN = MASS * np.linalg.inv(np.array([[0.5, 0.03, -0.02], [0.03, 0.7, 0.04], [-0.02, 0.04, 0.9]]))


class Sensors(NamedTuple):
    """How many there are of each kind."""

    poses: int = 1
    velocities: int = 0
    gyros: int = 0
    accelerometers: int = 0


ONE_POSE = Sensors()
QUIET = ("rate_noise", "velocity_noise", "push_walk", "turn_walk", "common_walk", "unseen_std")
QUIET += ("kicks_per_s", "kick_velocity", "kick_rate")


def small_params(sensors: Sensors = ONE_POSE, *, planar: bool = False, **changed: Any) -> PoseParams:
    """Four jets of two kinds; everything that goes with the motion and the sensors is free."""
    parts = make_parts(JETS, 2, sensors.poses, sensors.gyros, sensors.accelerometers)
    pushes = _PUSHES * [1.0, 1.0, 0.0] if planar else _PUSHES
    start = np.zeros(parts.size)
    start[parts.thrust] = 1.0
    start[parts.spin] = SPIN[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    start[parts.lag] = np.log(0.02)
    free = np.arange(parts.size) if not planar else in_plane(parts)
    settings: dict[str, Any] = {
        "parts": parts,
        "free": free,
        "start": start,
        "covariance": 1e-4 * np.eye(free.size),
        "pushes": pushes,
        "positions": _POSITIONS,
        "kinds": KINDS,
        "nominal_mass": MASS,
        "mass_std": 0.3,
        "thrust_std": np.array([0.05, 0.03, 0.04, 0.02]),
        "longest_s": 1.0,
        "scatter": np.zeros(JETS),
        "pulse_scatter": np.zeros(JETS),
        "pose": Poses(*(1e-6 * (1.0 + np.arange(sensors.poses)) for _ in range(2)), np.zeros(sensors.poses)),
        "gyro_variances": np.full(sensors.gyros, 1e-6),
        "velocity_positions": np.array([[0.1, -0.2, 0.3], [0.0, 0.3, 0.1]])[: sensors.velocities],
        "velocity_variances": np.full(sensors.velocities, 1e-6),
        "accelerometer_positions": np.array([[0.3, 0.1, -0.2], [-0.4, 0.2, 0.1]])[: sensors.accelerometers],
        "accelerometer_variances": np.full(sensors.accelerometers, 1e-6),
        "planar": planar,
        "of_mass": np.zeros(parts.size),
        "delays": Delays(np.zeros(1), np.zeros(1), np.zeros((2, 2)), 1.0),
    }
    return PoseParams(**(dict.fromkeys(QUIET, 0.0) | settings | changed))


IN_PLANE = {"spin": (2,), "push": (0, 1, 5)} | dict.fromkeys(("attitude", "rate", "gyro_bias"), (2,))
IN_PLANE |= dict.fromkeys(("center", "position", "velocity", "point", "gathered", "acceleration_bias"), (0, 1))


def in_plane(parts: Any) -> np.ndarray:
    """Places of what can move in a plane: x, y of places, z of turns, the element zz."""
    kept = []
    for name, whole in zip(parts._fields[:-1], parts[:-1], strict=True):
        places, size = np.arange(whole.start, whole.stop), 6 if name in ("spin", "push") else 3
        kept.append(places[np.isin(np.arange(places.size) % size, IN_PLANE[name])] if name in IN_PLANE else places)
    return np.concatenate(kept)


def some_bank(params: PoseParams, opens: tuple[int, ...] = (-1, 2), seed: int = 3) -> PoseBank:
    """Filters in flight, each with a state and a covariance of its own."""
    random, parts, count = np.random.default_rng(seed), params.parts, len(opens)
    off = np.zeros((count, parts.size))
    off[:, params.free] = random.standard_normal((count, params.free.size))
    mean = params.start + 0.02 * off
    mean[:, parts.spin] = params.start[parts.spin] * (1.0 + 0.05 * off[:, parts.spin])
    mean[:, parts.delay], mean[:, parts.opening] = 0.03 + 0.005 * off[:, parts.delay], 0.01
    mean[:, parts.drag] = 0.1, 0.2
    mean[:, parts.rate] = 0.05 * off[:, parts.rate]
    mean[:, parts.velocity] = 0.1 * off[:, parts.velocity]
    mean[:, parts.attitude] = 0.0
    mean[:, parts.tilt] = (0.03, -0.02) if params.planar else 0.0
    mean[:, parts.open] = 0.4
    mean[:, parts.pulse] = 0.0
    turn = random.standard_normal((count, 3)) * ([0.0, 0.0, 1.0] if params.planar else [1.0, 1.0, 1.0])
    root = 1e-3 * random.standard_normal((count, params.free.size, params.free.size))
    spun, reference = 0.01 * random.standard_normal((count, 3, 3)), 0.02 * random.standard_normal((count, 3))
    covariance, turned = (part @ np.swapaxes(part, 1, 2) for part in (root, spun))
    return PoseBank(mean, covariance, Rotation.from_rotvec(turn).as_matrix(), np.array(opens), reference, turned)


def moved(bank: PoseBank, params: PoseParams, place: int, by: float) -> PoseBank:
    """The bank with one element changed; the attitude by turning."""
    mean, rotation, turn = bank.mean.copy(), bank.rotation, params.parts.attitude
    if turn.start <= place < turn.stop:
        rotation = rotation @ Rotation.from_rotvec(by * np.eye(3)[place - turn.start]).as_matrix()
    else:
        mean[:, place] += by
    return bank._replace(mean=mean, rotation=rotation)


def pulses() -> Commands:
    """Pulses of all jets, some across the interval from 1 s to 1.1 s, some a fraction."""
    levels = np.array([[0, 0, 1, 0], [1, 0, 0, 0.5], [1, 1, 0, 0.5], [0, 1, 1, 0]], dtype=float)
    return Commands(np.array([0.8, 0.95, 1.0, 1.05]), levels)


def nothing_read(params: PoseParams) -> PoseReadings:
    """No sensor has read anything."""
    sensors = params.pose.position_variances, params.velocity_variances, params.gyro_variances
    poses, *others = (np.full((part.size, 3), np.nan) for part in (*sensors, params.accelerometer_variances))
    return PoseReadings(poses, np.full((len(poses), 3, 3), np.nan), *others)


# ------------------------------------------------------------------------------------------- flights


class Truth(NamedTuple):
    """True constants of a flight in a plane."""

    factors: Array  # thrust of each jet over nominal
    open: tuple[int, float, float] = (0, 0.0, np.inf)  # jet and share that stands open, and since when
    push: tuple[float, float] = (0.0, np.inf)  # acceleration along x, and since when


def bearing(**changed: Any) -> Vehicle:
    """The bundled air-bearing satellite on a floor that does nothing, with valves that act as told."""
    vehicle = load_vehicle("air_bearing")
    valve = {"command_delay_s": 0.0, "command_delay_std_s": 0.0, "opening_delay_std_s": 0.0, "repeatability": 0.02}
    kinds = {"nozzle": vehicle.jet_kinds["nozzle"].model_copy(update=valve)}
    around = Surroundings(velocity_walk=2e-4, rate_walk=2e-3)
    return again(vehicle, **({"jet_kinds": kinds, "surroundings": around} | changed))


def again(vehicle: Vehicle, **changed: Any) -> Vehicle:
    """The vehicle with other data, and nothing kept of what was worked out from those before."""
    return Vehicle.model_validate(vehicle.model_copy(update=changed).model_dump())


def params_of(vehicle: Vehicle, **settings: Any) -> PoseParams:
    """Parameters of its estimator with hypotheses."""
    scenario = resolve_scenario({"name": "flight", "vehicle": vehicle} | settings)
    made: PoseParams = estimation_params(scenario).filter_params.pose
    return made


def told(vehicle: Vehicle, rows: int, seed: int = 0) -> Array:
    """Commands of pulses of two to four samples, jets in turn, shape (rows, n_jets)."""
    random, jets = np.random.default_rng(seed), len(vehicle.jets)
    commands, row = np.zeros((rows, jets)), 4
    while row < rows - 4:
        length = int(random.integers(2, 5))
        for jet in random.permutation(jets)[:2]:
            commands[row : row + length, jet] = 1.0
        row += length + int(random.integers(1, 3))
    return commands


def planar_poses(vehicle: Vehicle, commands: Array, truth: Truth, seed: int = 1) -> Array:
    """x, y and heading at every sample, as a sensor without errors of its stamps reads them, shape (rows, 3).

    By small steps, of a body in a plane whose valves follow through the nominal lag.
    """
    random, period, jets = np.random.default_rng(seed), vehicle.sample_period_s, len(vehicle.jets)
    lag = np.array([vehicle.jet_kinds[jet.kind].time_constant_s for jet in vehicle.jets])
    jet, share, since_s = truth.open
    turns = np.cross(vehicle.positions, vehicle.thrusts)[:, 2] / vehicle.nominal.inertia[2, 2]
    place, speed, level = np.zeros(3), np.zeros(3), np.zeros(jets)
    around, pose, steps, rows = vehicle.surroundings, vehicle.poses[0], 16, []
    step, noise = period / steps, np.array([pose.position_std, pose.position_std, pose.attitude_std], dtype=float)
    walks = np.array([around.velocity_walk, around.velocity_walk, around.rate_walk]) / np.sqrt(step)
    for row, command in enumerate(commands):
        rows.append(place + noise * random.standard_normal(3))
        for part in range(steps):
            now = (row + part / steps) * period
            before = level
            level = command + (level - command) * np.exp(-step / lag)
            acts = 0.5 * (before + level)
            acts[jet] += (share if now >= since_s else 0.0) * (1.0 - acts[jet])
            force = (acts * truth.factors) @ vehicle.thrusts / vehicle.nominal.mass
            cosine, sine = np.cos(place[2]), np.sin(place[2])
            gained = np.array([cosine * force[0] - sine * force[1], sine * force[0] + cosine * force[1], 0.0])
            gained[0] += truth.push[0] if now >= truth.push[1] else 0.0
            gained[2] = (acts * truth.factors) @ turns
            gained = gained + walks * random.standard_normal(3)
            place = place + step * speed + 0.5 * step**2 * gained
            speed = speed + step * gained
    return np.array(rows)


class Flown(NamedTuple):
    """Parameters, the hypotheses at the end of a flight, and what was named with its time."""

    params: PoseParams
    tried: Tried
    named: list[tuple[float, PoseOutcome]]


def flown(vehicle: Vehicle, truth: Truth, rows: int = 100, late: int = 0, parts: bool = False) -> Flown:
    """Follows a flight whose commands act so many samples late, with parts of possible delays or without."""
    params, period, commands = params_of(vehicle), vehicle.sample_period_s, told(vehicle, rows)
    acting = np.vstack((np.zeros((late, len(vehicle.jets))), commands[: rows - late]))
    times_s, none, tried, named = period * np.arange(rows), np.zeros((0, 3)), None, []
    for row, read in enumerate(planar_poses(vehicle, acting, truth)):
        turn = Rotation.from_euler("z", read[2]).as_matrix()
        seen = PoseReadings(np.append(read[:2], 0.0)[None], turn[None], none, none, none)
        if tried is None:
            first = initialize_bank(seen, params)
            every = delays.split_by_delay(first, params) if parts else [first]
            many = [pose_hypotheses.begin_hypotheses(one, 0.0, params) for one in every]
            tried = delays.join_delays(many, params) if parts else many[0]
            continue
        since = max(row - 40, 0)
        lately = Commands(times_s[since : row + 1], commands[since : row + 1])
        tried, _ = delays.advance_over_delays(tried, lately, (times_s[row - 1], times_s[row]), seen, params)
        tried, found = delays.name_failure_over_delays(tried, times_s[row], PoseRules(), params)
        if found is not None:
            named.append((times_s[row], found))
    assert tried is not None
    return Flown(params, tried, named)
