"""Flights of vehicles that are tracked in a fixed frame, by a simulator of its own.

It has a rigid body in small steps with valves that act late and through a lag, drag, a floor that is not level, and a
controller that answers the pose sensor. It draws mass properties, thrusts, valves and surroundings as the vehicle's
file states them. Vehicles are the bundled ones, or drawn, too: four to sixteen jets anywhere on a body of 2 to 500 kg
that they can hold, in a plane or free, with sensors and surroundings of a size that such a body can be held by.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from flights.flight import Array
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle

_STEP_S = 0.005
_BEHIND = 400  # steps of commands that are kept


class Case(NamedTuple):
    """Departures of a flight from what the vehicle's file says.

    Attributes:
        delay_off: samples by which commands act later.
        pressure_loss: share of all thrusts that is lost in the flight, evenly.
        failures: whether a jet is dead, or gives less than a third, in half of the flights.
        late: whether the jet dies in the flight, at a time that is drawn.
        noise: factor on everything that the file calls noise.
        whole: whether pulses scatter as a whole, by the size that the file states of a sample.
        rough: whether quaternions change their sign, poses are missing for up to a second, and stamps are off.
    """

    delay_off: float = 0.0
    pressure_loss: float = 0.0
    failures: bool = True
    late: bool = False
    noise: float = 1.0
    whole: bool = False
    rough: bool = False


class Truth(NamedTuple):
    """True vehicle of a flight.

    Attributes:
        mass, center, inertia: of the body.
        thrusts: forces of the jets, body axes, shape (n_jets, 3).
        dead: index of the dead jet, -1: none.
        left: share of its thrust that it still gives.
        since_s: onset, s.
    """

    mass: float
    center: Array
    inertia: Array
    thrusts: Array
    dead: int
    left: float
    since_s: float


class _Body(NamedTuple):
    position: Array
    velocity: Array
    rotation: Array
    rate: Array


class _Valves(NamedTuple):
    level: Array
    wanted: Array
    strength: Array


class TrackedFlight:
    """A flight of a vehicle that is tracked in a fixed frame, in small steps, with its controller.

    Args:
        vehicle: parsed vehicle file.
        case: departures from the file.
        seed: of every draw.
        duration_s: of the flight.
    """

    def __init__(self, vehicle: Vehicle, case: Case, seed: int, duration_s: float):
        self.vehicle, self.case, self.duration_s = vehicle, case, duration_s
        self._random = random = np.random.default_rng(seed)
        normal = random.standard_normal
        n_jets = len(vehicle.jets)
        self._planar = vehicle.motion == "planar"
        nominal, around = vehicle.nominal, vehicle.surroundings
        scales = (vehicle.mass_std or vehicle.uncertainty * nominal.mass) / nominal.mass
        mass = nominal.mass * (1.0 + min(scales, 0.1) * normal())
        stretch = np.diag(np.exp(0.1 * normal(3)))
        inertia = stretch @ nominal.inertia @ stretch
        center = nominal.center_of_mass + vehicle.center_of_mass_floor * normal(3)
        if self._planar:
            center[2] = nominal.center_of_mass[2]
        factors = 1.0 + vehicle.thrust_uncertainties * normal(n_jets)
        factors *= 1.0 + vehicle.common_scale_uncertainty * normal()
        dead = int(random.integers(n_jets)) if case.failures and random.random() < 0.5 else -1
        left, since_s = 1.0, 0.0
        if dead >= 0:
            left = 0.0 if random.random() < 0.5 else random.uniform(0.0, 0.3)
        if case.late:
            since_s = duration_s * random.uniform(0.15, 0.6)
        self.truth = Truth(mass, center, inertia, vehicle.thrusts * factors[:, None], dead, left, since_s)
        kinds, of = list(vehicle.jet_kinds.values()), vehicle.kind_indices
        errors = normal((3, len(kinds)))
        delays = np.array([kind.command_delay_s for kind in kinds])
        delays = delays + errors[0] * [kind.command_delay_std_s for kind in kinds]
        delays = np.maximum(delays, 0.0) + case.delay_off * vehicle.sample_period_s
        lags = np.array([kind.time_constant_s for kind in kinds])
        lags = np.maximum(lags, 1e-6) * np.exp(errors[1] * [kind.lag_uncertainty for kind in kinds])
        late = np.array([kind.opening_delay_s for kind in kinds])
        late = late + errors[2] * [kind.opening_delay_std_s for kind in kinds]
        self.delays, self._lags, self._late = delays[of], lags[of], late[of]
        self._drag = abs(around.drag + 0.5 * around.drag_std * normal())
        self._angular_drag = abs(around.angular_drag + 0.5 * around.angular_drag_std * normal())
        slope, turn, tilt = normal(3), normal(3), normal(2)
        self._slope, self._turn = around.slope_std * slope, around.turn_std * turn
        self._tilt = around.heading_turn_std * tilt
        if self._planar:
            self._slope[2] = 0.0
            self._turn[:2] = 0.0
        self._points = [np.array(pose.point) + pose.point_std * normal(3) for pose in vehicle.poses]
        self._blind_s, self._inverse = (-1.0, -1.0), np.linalg.inv(inertia)
        self._repeat = np.array([kind.repeatability for kind in kinds])[of]

    def rows(self) -> tuple[Array, Array]:
        """Flies, and returns rows of telemetry and the rotation at the end."""
        period, n_jets = self.vehicle.sample_period_s, len(self.vehicle.jets)
        body = _Body(np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3))
        valves = _Valves(np.zeros(n_jets), np.zeros(n_jets), np.ones(n_jets))
        switches: list[tuple[float, Array]] = [(-1.0, np.zeros(n_jets))]
        rows: list[Array] = []
        before, now = (body.position, np.zeros(3)), 0.0
        for sample in range(int(self.duration_s / period)):
            sample_s = sample * period
            drawn = 1.0 + self.case.noise * self._repeat * self._random.standard_normal(n_jets)
            if not self.case.whole:
                valves = valves._replace(strength=drawn)
            while now < sample_s - 1e-9:
                step = min(_STEP_S, sample_s - now)
                valves, mean = self._opened(valves, self._wanted(switches, now + 0.5 * step), drawn, step)
                body = self._moved(body, (mean * valves.strength)[:, None] * self._thrusts(now), step)
                now += step
            read = self._read(*body)
            command = self._commanded(read, before, sample_s, period)
            before = read[0], read[1]
            switches = [*switches, (sample_s, command)][-_BEHIND:]
            rows.append(np.concatenate(([sample_s], self._roughened(read[2], sample_s), command)))
            if self.case.rough:
                rows[-1][0] += 0.02 * period * np.clip(self._random.standard_normal(), -3.0, 3.0)
        return np.array(rows), body.rotation

    def _thrusts(self, time_s: float) -> Array:
        """Computes forces of jets at full thrust, shape (n_jets, 3)."""
        truth = self.truth
        thrusts = truth.thrusts * (1.0 - self.case.pressure_loss * time_s / self.duration_s)
        if truth.dead >= 0 and time_s >= truth.since_s:
            thrusts[truth.dead] *= truth.left
        return thrusts

    def _opened(self, valves: _Valves, wanted: Array, drawn: Array, step: float) -> tuple[_Valves, Array]:
        """Advances valves by a step; returns valves and their mean levels over it."""
        strength = valves.strength
        if self.case.whole:
            strength = np.where((wanted > 0.0) & (valves.wanted == 0.0), drawn, strength)
        left, off = np.exp(-step / self._lags), valves.level - wanted
        return _Valves(wanted + off * left, wanted, strength), wanted + off * (1.0 - left) * self._lags / step

    def _moved(self, body: _Body, gives: Array, step: float) -> _Body:
        """Advances the body by a step with forces of its jets."""
        position, velocity, rotation, rate = body
        truth, around, random = self.truth, self.vehicle.surroundings, self._random
        force = rotation @ gives.sum(axis=0) - self._drag * velocity + truth.mass * self._slope
        arms = self.vehicle.positions - truth.center
        torque = _crossed(arms, gives).sum(axis=0) - self._angular_drag * rate
        turn = self._turn.copy()
        heading = np.arctan2(rotation[1, 0], rotation[0, 0])
        turn[2] += self._tilt @ (np.cos(heading), np.sin(heading))
        spin = self._inverse @ (torque - _crossed(rate, truth.inertia @ rate)) + turn
        if self._planar:
            force[2] = 0.0
            spin = np.array([0.0, 0.0, torque[2] / truth.inertia[2, 2] + turn[2]])
        white = self.case.noise * np.sqrt(step) * random.standard_normal(6)
        faster = velocity + step * force / truth.mass + around.velocity_walk * white[:3] * self._moves
        turning = rate + step * spin + around.rate_walk * white[3:] * self._turns
        if random.random() < around.kicks_per_minute / 60.0 * step:
            kick = self.case.noise * random.standard_normal(6)
            faster = faster + around.kick_velocity * kick[:3] * self._moves
            turning = turning + around.kick_rate * kick[3:] * self._turns
        middle = rate + 0.5 * step * spin
        return _Body(position + 0.5 * step * (velocity + faster), faster, rotation @ _turned(step * middle), turning)

    def _roughened(self, read: Array, time_s: float) -> Array:
        """Adds errors to the columns of sensors of one row."""
        if not self.case.rough:
            return read
        random, first = self._random, 3 * len(self.vehicle.gyros)
        poses = slice(first, first + 7 * len(self.vehicle.poses))
        result = read.copy()
        if random.random() < 0.5:
            result[poses].reshape(-1, 7)[:, 3:] *= -1.0
        if time_s > self._blind_s[1] and random.random() < 0.1 * self.vehicle.sample_period_s:  # every ten seconds
            self._blind_s = time_s, time_s + random.uniform(0.0, 1.0)
        if self._blind_s[0] <= time_s < self._blind_s[1] and time_s > 1.0:
            result[poses] = np.nan
        return result

    @property
    def _moves(self) -> Array:
        return np.array([1.0, 1.0, 0.0]) if self._planar else np.ones(3)

    @property
    def _turns(self) -> Array:
        return np.array([0.0, 0.0, 1.0]) if self._planar else np.ones(3)

    def _wanted(self, switches: list[tuple[float, Array]], time_s: float) -> Array:
        """Computes valve levels that commands drive to, delayed, and further delayed where they open."""
        wanted = np.zeros(len(self.vehicle.jets))
        open_at = time_s - self.delays - self._late
        close_at = time_s - self.delays
        for jet in range(wanted.size):
            state = _at(switches, close_at[jet], jet)
            later = _at(switches, open_at[jet], jet)
            if self._late[jet] >= 0.0:
                wanted[jet] = state and later
            else:
                wanted[jet] = state or later
        return wanted

    def _read(self, position: Array, velocity: Array, rotation: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Reads position and attitude for the controller, and all columns of sensors."""
        vehicle, random, truth = self.vehicle, self._random, self.truth
        columns_, seen, turned = [], position, np.zeros(3)
        for gyro in vehicle.gyros:
            columns_.append(rate + self.case.noise * np.sqrt(gyro.variance) * random.standard_normal(3))
        for pose, point in zip(vehicle.poses, self._points, strict=True):
            arm = point - truth.center
            late = pose.time_std_s * random.standard_normal()
            where = position + rotation @ arm + late * (velocity + rotation @ _crossed(rate, arm))
            poor = self.case.noise * (10.0 if random.random() < pose.outliers else 1.0)
            if pose.position_std is None:
                where = np.full(3, np.nan)
            else:
                where = where + poor * pose.position_std * random.standard_normal(3) * self._moves
                seen = where
            if pose.attitude_std is None:
                quaternion = np.full(4, np.nan)
            else:
                noise = poor * pose.attitude_std * random.standard_normal(3) * self._turns
                read = rotation @ _turned(late * rate) @ _turned(noise)
                quaternion, turned = _quaternion(read), _vector(read)
            columns_ += [where, quaternion]
        for speed in vehicle.velocities:
            columns_.append(velocity + self.case.noise * speed.noise_std * random.standard_normal(3))
        return seen, turned, np.concatenate(columns_)

    def _commanded(
        self, read: tuple[Array, Array, Array], before: tuple[Array, Array], time_s: float, period: float
    ) -> Array:
        """Commands jets toward a goal that moves on, by position and attitude and their differences."""
        vehicle = self.vehicle
        stage = int(time_s / 12.0)
        draw = np.random.default_rng(stage + 17)
        arm = vehicle.rms_arm
        goal, heading = 4.0 * arm * draw.uniform(-1.0, 1.0, 3), 0.8 * draw.uniform(-1.0, 1.0, 3)
        rotation = _turned(read[1])
        off = rotation.T @ (goal - read[0]) * self._moves
        speed = rotation.T @ (read[0] - before[0]) / period
        turn = _vector(rotation.T @ _turned(heading * self._turns))
        spin = _vector(_turned(before[1]).T @ rotation) / period
        acceleration = 0.25 * off - 0.9 * speed
        angular = 0.5 * turn - 1.3 * spin
        wrench = np.concatenate((vehicle.nominal.inertia @ angular, vehicle.nominal.mass * acceleration))
        arms = vehicle.positions - vehicle.nominal.center_of_mass
        effects = np.hstack((np.cross(arms, vehicle.thrusts), vehicle.thrusts))
        scale = np.concatenate((np.full(3, 1.0 / arm), np.ones(3)))
        gain = (effects * scale) @ (wrench * scale)
        size = np.sum((effects * scale) ** 2, axis=1)
        return (gain / size > 0.35 + 0.3 * self._random.random(gain.size)).astype(float)


def _at(switches: list[tuple[float, Array]], time_s: float, jet: int) -> bool:
    for since_s, command in reversed(switches):
        if since_s <= time_s:
            return bool(command[jet] > 0.0)
    return False


def _crossed(a: Array, b: Array) -> Array:
    """Computes the cross product of rows, faster than `numpy.cross`."""
    parts = ((1, 2), (2, 0), (0, 1))
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in parts], axis=-1)


def _turned(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _vector(rotation: Array) -> Array:
    quaternion = _quaternion(rotation)
    sine = float(np.linalg.norm(quaternion[1:]))
    return np.zeros(3) if sine < 1e-12 else 2.0 * np.arctan2(sine, quaternion[0]) / sine * quaternion[1:]


def _quaternion(rotation: Array) -> Array:
    values, vectors = np.linalg.eigh(
        np.array(
            [
                [np.trace(rotation), *(rotation[[2, 0, 1], [1, 2, 0]] - rotation[[1, 2, 0], [2, 0, 1]])],
                [
                    rotation[2, 1] - rotation[1, 2],
                    2 * rotation[0, 0] - np.trace(rotation),
                    rotation[0, 1] + rotation[1, 0],
                    rotation[0, 2] + rotation[2, 0],
                ],
                [
                    rotation[0, 2] - rotation[2, 0],
                    rotation[0, 1] + rotation[1, 0],
                    2 * rotation[1, 1] - np.trace(rotation),
                    rotation[1, 2] + rotation[2, 1],
                ],
                [
                    rotation[1, 0] - rotation[0, 1],
                    rotation[0, 2] + rotation[2, 0],
                    rotation[1, 2] + rotation[2, 1],
                    2 * rotation[2, 2] - np.trace(rotation),
                ],
            ]
        )
    )
    found = vectors[:, np.argmax(values)]
    return found if found[0] >= 0.0 else -found


def drawn_vehicle(seed: int) -> Vehicle:
    """Draws a vehicle that its jets can hold: mass, shape, jets, valves, sensors and surroundings."""
    random = np.random.default_rng([seed, 4])
    planar = bool(random.random() < 0.5)
    mass = float(np.exp(random.uniform(np.log(2.0), np.log(500.0))))
    sides = (mass / random.uniform(200.0, 1000.0)) ** (1 / 3) * random.uniform(0.7, 1.4, 3)
    inertia = np.diag((mass / 12.0) * (np.sum(sides**2) - sides**2))
    period = float(random.choice([0.05, 0.1, 0.2]))
    arm = 0.5 * float(np.linalg.norm(sides[:2]))
    acceleration = arm * float(random.uniform(0.06, 0.3))
    turning = acceleration * mass * arm / inertia[2, 2]
    thrust = acceleration * mass
    jets = _drawn_jets(random, sides, planar)

    def size(least: float, most: float) -> float:
        return float(np.exp(random.uniform(np.log(least), np.log(most))))

    kind = {
        "nominal_thrust": thrust,
        "specific_impulse_s": 60.0,
        "thrust_uncertainty": random.uniform(0.01, 0.05),
        "repeatability": size(0.01, 0.3),
        "time_constant_s": random.uniform(0.05, 0.4) * period,
        "lag_uncertainty": 0.5,
        "command_delay_s": random.uniform(0.0, 1.5) * period,
        "command_delay_std_s": random.uniform(0.1, 0.6) * period,
        "opening_delay_std_s": random.uniform(0.0, 0.2) * period,
        "minimum_on_time_s": period,
    }
    camera = {
        "name": "cameras",
        "position_std": acceleration * period * size(0.02, 0.15),
        "attitude_std": turning * period * size(0.02, 0.15),
        "time_std_s": 0.02 * period,
        "outliers": 0.01,
        "point_std": 0.03 * arm,
    }
    around = {
        "drag_std": 0.05 * mass,
        "angular_drag_std": 0.05 * float(inertia[2, 2]),
        "slope_std": 0.1 * acceleration,
        "turn_std": 0.1 * turning,
        "velocity_walk": acceleration * size(0.004, 0.05),
        "rate_walk": turning * size(0.004, 0.1),
        "kicks_per_minute": float(random.choice([0.0, 5.0])),
        "kick_velocity": 0.2 * acceleration,
        "kick_rate": 0.5 * turning,
    }
    data = {
        "name": f"drawn_{seed}",
        "units": "si",
        "sample_period_s": period,
        "mass_properties": {"mass": mass, "center_of_mass": [0.0, 0.0, 0.0], "inertia": inertia.tolist()},
        "center_of_mass_std": 0.03 * arm,
        "common_scale_uncertainty": 0.03,
        "motion": "planar" if planar else "free",
        "surroundings": around,
        "gyros": [],
        "poses": [camera],
        "jet_kinds": {"jet": kind},
        "jets": [
            {
                "number": number,
                "designation": f"J{number}",
                "cluster": number,
                "kind": "jet",
                "position": place.tolist(),
                "direction": direction.tolist(),
                "thrust": thrust * random.uniform(0.9, 1.1),
            }
            for number, (place, direction) in enumerate(jets, start=1)
        ],
    }
    return Vehicle.model_validate(data)


def _drawn_jets(random: np.random.Generator, sides: Array, planar: bool) -> list[tuple[Array, Array]]:
    """Draws places on a body's surface and directions along its axes that control all axes in which it can move."""
    scale = 2.0 / float(np.linalg.norm(sides))
    while True:
        count = int(random.integers(4, 13) if planar else random.integers(8, 17))
        jets, wrenches = [], []
        for _ in range(count):
            axis = int(random.integers(2 if planar else 3))
            sign = float(random.choice([-1.0, 1.0]))
            place = 0.5 * sides * random.uniform(-1.0, 1.0, 3)
            place[axis] = -sign * 0.5 * sides[axis]  # the plume leaves the body
            if planar:
                place[2] = 0.0
            direction = sign * np.eye(3)[axis]
            jets.append((place, direction))
            wrenches.append(np.concatenate((direction, scale * np.cross(place, direction))))
        effects = np.array(wrenches).T[[0, 1, 5]] if planar else np.array(wrenches).T
        goals = np.vstack((np.eye(len(effects)), -np.eye(len(effects))))
        if all(nnls(effects, goal)[1] < 1e-6 and nnls(effects, goal)[0].sum() < 8.0 for goal in goals):
            return jets


def drawn_flight(
    seed: int, *, vehicle: str, seconds: float, departures: Mapping[str, Any], told: Mapping[str, float], walk: float
) -> tuple[Vehicle, TrackedFlight]:
    """Draws a flight, and the vehicle file for its estimator.

    Args:
        seed: of every draw.
        vehicle: name of a bundled vehicle; "": one is drawn.
        seconds: duration, s.
        departures: of `Case`.
        told: of each kind of jet, in place of what its file says.
        walk: stated walk of what all thrusts share, 1-sigma in one second.
    """
    stated = load_vehicle(vehicle) if vehicle else drawn_vehicle(seed)
    stated = stated.model_copy(update={"common_scale_walk": walk})
    flight = TrackedFlight(stated, Case(**departures), seed, seconds)
    kinds = {kind: one.model_copy(update=dict(told)) for kind, one in stated.jet_kinds.items()}
    return stated.model_copy(update={"jet_kinds": kinds}), flight


def true_parameters(truth: Truth, vehicle: Vehicle) -> Array:
    """Returns the ten parameters, see `maths.mass_properties`, shape (10,)."""
    inverse = np.linalg.inv(truth.inertia)
    if vehicle.motion == "planar":
        inverse[2, 2] = 1.0 / truth.inertia[2, 2]
    return np.concatenate((inverse[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]], truth.center, [1.0 / truth.mass]))


def tenth_pulse(rows: Array, truth: Truth, vehicle: Vehicle) -> float | None:
    """Returns the time of a dead jet's tenth command, s; None: never."""
    if truth.dead < 0:
        return None
    fires = rows[:, -len(vehicle.jets) + truth.dead] * (rows[:, 0] >= truth.since_s)
    begins = np.flatnonzero(np.diff(fires, prepend=0.0) > 0.0)
    return float(rows[begins[9], 0]) if begins.size > 9 else None
