"""Flights of drawn vehicles: two minutes of turns and translations about all axes, with an event half-way.

Every number is a vehicle of its own: 8 kg to 8 t, a box of drawn proportions, 12 to 24 jets at drawn places and some
degrees off the axes that push it at up to 0.1 m/s^2, sampled 5 to 25 times a second, gyros whose quantum is a fifth to
a three-thousandth of what one jet changes the rate by in a sample, accelerometers from a half to a three-hundredth. The
true body is 30 % off what the vehicle's file says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linprog

from flights.flight import AXES, STATED_LAG, Array, Flight, Random, failure, thrusts, truth
from massprop_drake.maths.mass_properties import MassProperties, perturb_body

# what happens when: from, to, and the end of the flight, s
_SPANS: Mapping[str, tuple[float, float, float]] = {
    "late": (62.0, 68.0, 120.0),
    "early": (0.5, 15.0, 60.0),
    "before_translation": (20.0, 32.0, 70.0),
}


class Drawn(NamedTuple):
    """Drawn vehicle and its flight.

    Attributes:
        vehicle: content of its file.
        autopilot: settings of it.
        nominal: mass properties that the file states.
        thrust: of a jet, N.
    """

    vehicle: dict[str, Any]
    autopilot: dict[str, Any]
    nominal: MassProperties
    thrust: float


def draw_vehicle(random: Random) -> Drawn:
    """Draws a vehicle that its jets can push and turn in every direction."""
    mass = float(np.exp(random.uniform(np.log(8.0), np.log(8000.0))))
    half = 0.6 * (mass / 200.0) ** (1.0 / 3.0) * np.exp(random.uniform(-0.4, 0.4, 3))
    second = mass * half**2 / 3.0 * np.exp(random.uniform(-0.3, 0.3, 3))
    center = 0.1 * half * random.standard_normal(3)
    body = MassProperties(mass, center, np.diag(second.sum() - second))
    nominal = perturb_body(
        body,
        mass_factor=1.0,
        shift=np.zeros(3),
        second_moment_factors=np.ones(3),
        rotation=0.1 * random.standard_normal(3),
    )
    period = float(random.choice([0.04, 0.08, 0.1, 0.2]))
    push = float(np.exp(random.uniform(np.log(0.005), np.log(0.1))))  # of two jets, m/s^2
    thrust = 0.5 * mass * push
    places, directions = _jets(random, half, center)
    turn = thrust * float(half.mean()) / float(np.diag(nominal.inertia).mean())  # of one jet, rad/s^2
    gyro = turn * period / float(np.exp(random.uniform(np.log(5.0), np.log(3000.0))))
    accelerometer = thrust / mass * period / float(np.exp(random.uniform(np.log(2.0), np.log(300.0))))
    vehicle = {
        "name": "drawn",
        "description": "drawn",
        "source": "drawn",
        "units": "si",
        "sample_period_s": period,
        "mass_properties": {
            "mass": mass,
            "center_of_mass": center.tolist(),
            "inertia": nominal.inertia.tolist(),
        },
        "uncertainty": 0.3,
        "gyros": [{"name": "gyro", "quantum": gyro, "noise_std": gyro * float(random.uniform(0.2, 2.0))}],
        "accelerometers": [
            {
                "name": "imu",
                "position": (0.7 * half * random.uniform(-1.0, 1.0, 3)).tolist(),
                "quantum": accelerometer,
                "noise_std": accelerometer * float(random.uniform(0.2, 2.0)),
            }
        ],
        "jet_kinds": {
            "thruster": {
                "nominal_thrust": thrust,
                "specific_impulse_s": 220.0,
                "time_constant_s": period * float(random.uniform(0.05, 0.3)),
                "minimum_on_time_s": period,
            }
        },
        "jets": [
            {
                "number": number + 1,
                "designation": f"J{number + 1}",
                "cluster": number // 2 + 1,
                "kind": "thruster",
                "position": place.tolist(),
                "direction": direction.tolist(),
                "thrust": thrust,
            }
            for number, (place, direction) in enumerate(zip(places, directions, strict=True))
        ],
    }
    rate = turn * float(random.uniform(0.4, 1.2))
    autopilot = {
        "jet_kinds": ["thruster"],
        "discrete_rate": rate,
        "hold_rate_limit": rate / 15.0,
        "capture_rate": rate / 15.0,
        "rate_deadband": rate / 15.0,
        "resolve_rate": rate / 8.0,
        "acceleration": push,
        "horizon_s": 2.0,
    }
    return Drawn(vehicle, autopilot, nominal, thrust)


def _jets(random: Random, half: Array, center: Array) -> tuple[Array, Array]:
    """Draws places and directions of jets, two to four along each way of each axis, that control six axes."""
    while True:
        each = int(random.integers(2, 5))
        places, directions = [], []
        for axis in range(3):
            for sign in (1.0, -1.0):
                for corner in range(each):
                    place = half * random.uniform(0.4, 1.0, 3) * np.where(random.random(3) < 0.5, -1.0, 1.0)
                    across = [(axis + 1) % 3, (axis + 2) % 3][corner % 2]
                    place[across] = abs(place[across]) * (1.0 if corner // 2 == 0 else -1.0)
                    place[axis] = -sign * half[axis]
                    direction = sign * np.eye(3)[axis] + 0.12 * random.standard_normal(3)
                    places.append(place)
                    directions.append(direction / np.linalg.norm(direction))
        found = np.array(places), np.array(directions)
        if _control_six_axes(*found, center, half):
            return found


def _control_six_axes(places: Array, directions: Array, center: Array, half: Array) -> bool:
    """Tests for an impulse either way along and about each axis by half of the jets' thrust."""
    arms = (places - center) / half.mean()
    wrenches = np.hstack((np.cross(arms, directions), directions)).T
    for axis in range(6):
        for sign in (1.0, -1.0):
            wanted = 0.5 * sign * np.eye(6)[axis]
            if linprog(np.ones(len(places)), A_eq=wrenches, b_eq=wanted, bounds=(0.0, 1.0)).status != 0:
                return False
    return True


def _maneuver(random: Random, span: str, ends_s: float) -> list[dict[str, Any]]:
    """Draws windows of hand controllers: each axis by itself, turns first, then any; translations late if asked for."""
    windows: list[dict[str, Any]] = []

    def add(controller: str, axis: str, now: float) -> float:
        ends = now + float(random.uniform(1.0, 2.5))
        windows.append({"controller": controller, "axis": axis, "start_s": now, "end_s": ends})
        return ends + float(random.uniform(0.5, 2.0))

    now, turns_until = 1.0, 45.0 if span == "before_translation" else 0.0
    for axis in random.permutation(["+x", "+y", "+z"]).tolist():
        now = add("rhc", axis, now)
    while now < turns_until:
        now = add("rhc", str(random.choice(AXES)), now)
    for axis in random.permutation(["+x", "+y", "+z"]).tolist():
        now = add("thc", axis, now)
    while now < ends_s - 5.0:
        controller = "rhc" if random.random() < 0.5 else "thc"
        now = add(controller, str(random.choice(AXES)), now)
    return windows


def _pulses(random: Random, ship: Drawn, ends_s: float) -> list[dict[str, Any]]:
    """Draws pulses of two to four jets at a time, most of a tenth of a sample to a whole one, from any time on."""
    names, period_s = [one["designation"] for one in ship.vehicle["jets"]], ship.vehicle["sample_period_s"]
    told: list[dict[str, Any]] = []
    free, now_s = dict.fromkeys(names, -1), 1.0  # the last sample in which a jet is on
    while now_s < ends_s - 1.0:
        for name in random.choice(names, int(random.integers(2, 5)), replace=False).tolist():
            start_s = now_s + period_s * float(random.choice([0.0, random.uniform(0.0, 1.0)]))
            samples = random.uniform(0.1, 1.0) if random.random() < 0.7 else random.uniform(1.0, 10.0)
            end_s = start_s + period_s * float(samples)
            if int(start_s / period_s) > free[name]:
                told.append({"jet": name, "start_s": start_s, "end_s": end_s})
                free[name] = int(end_s / period_s)
        now_s += period_s * float(random.uniform(3.0, 10.0))
    return told


def vehicle(random: Random, number: int, *, happens: str, span: str = "late", within: bool = False) -> Flight:
    """Draws a flight of a drawn vehicle.

    Args:
        random: to draw with.
        number: of the flight and of its vehicle.
        happens: "healthy", "stuck_on", "stuck_off", "leak" (2 to 30 %), "dock", "release" or "off_then_dock".
        span: when: "late", "early" (first 15 s) or "before_translation" (turns known, nothing translated yet).
        within: whether jets open and close within samples, by pulses and without an autopilot.
    """
    ship = draw_vehicle(np.random.default_rng([number]))
    true = perturb_body(
        ship.nominal,
        mass_factor=float(np.exp(0.3 * random.standard_normal())),
        shift=0.1 * _arm(ship) * random.standard_normal(3),
        second_moment_factors=np.exp(0.3 * random.standard_normal(3)),
        rotation=0.1 * random.standard_normal(3),
    )
    first_s, last_s, ends_s = _SPANS[span]
    failures, jumps = _happens(random, happens, ship, true, float(random.uniform(first_s, last_s)))
    flown: dict[str, Any] = {"maneuver": _maneuver(random, span, ends_s), "autopilot": ship.autopilot}
    if within:
        ship.vehicle["jet_kinds"]["thruster"]["minimum_on_time_s"] = 0.05 * ship.vehicle["sample_period_s"]
        flown = {"jet_schedule": _pulses(random, ship, ends_s)}
    scenario = {
        "name": "drawn",
        "duration_s": ends_s,
        **flown,
        "failures": failures,
        "jumps": jumps,
        "execution": {"engine": "loop"},
    }
    told = (truth(true), f"plant.lag_factor={STATED_LAG}", *thrusts("either", number))
    return Flight(scenario, told, ship.vehicle)


def _happens(
    random: Random, kind: str, ship: Drawn, true: MassProperties, start_s: float
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Draws failures and payloads of a kind."""
    jet = str(random.choice([one["designation"] for one in ship.vehicle["jets"]]))
    share = float(np.exp(random.uniform(np.log(0.05), np.log(0.4))))
    place = [float(one) for one in ship.nominal.center_of_mass + random.uniform(-1.0, 1.0, 3) * _arm(ship)]
    dock = {"kind": "dock", "time_s": start_s, "mass": share * ship.nominal.mass, "position": place}
    match kind:
        case "stuck_on" | "stuck_off":
            return [failure(kind, jet, start_s)], []
        case "leak":
            return [failure(kind, jet, start_s, ship.thrust * float(random.uniform(0.02, 0.3)))], []
        case "dock":
            return [], [dock]
        case "release":
            return [], [_release(random, true, start_s)]
        case "off_then_dock":
            later_s = start_s + float(random.uniform(5.0, 15.0))
            return [failure("stuck_off", jet, start_s)], [{**dock, "time_s": later_s}]
    return [], []


def _arm(ship: Drawn) -> float:
    """Computes the radius of gyration of a vehicle, m."""
    return float(np.sqrt(np.trace(ship.nominal.inertia) / ship.nominal.mass))


def _release(random: Random, true: MassProperties, start_s: float) -> dict[str, Any]:
    """Draws a payload that leaves, placed so that what remains is a body with half of its second moment to spare."""
    mass = true.mass * float(random.uniform(0.03, 0.15))
    second = 0.5 * np.trace(true.inertia) * np.eye(3) - true.inertia
    way = random.standard_normal(3)
    reduced = mass * true.mass / (true.mass - mass)
    arm = way * np.sqrt(0.5 / (reduced * way @ np.linalg.solve(second, way)))
    position = true.center_of_mass + arm * (true.mass - mass) / true.mass
    return {"kind": "release", "time_s": start_s, "mass": mass, "position": position.tolist()}
