"""Flights of drawn vehicles, by kinds: does the joint filter with its detector hold on vehicles nobody has chosen?

    python benchmarks/drawn_vehicles.py [KIND ...] [--first 0] [--count 20] [--compiled] [--each]

Every number is a vehicle of its own: 8 kg to 8 t, a box of drawn proportions, 12 to 24 jets at drawn places and some
degrees off the axes that push it at up to 0.1 m/s^2, sampled 5 to 25 times a second, gyros whose quantum is a fifth to
a three-thousandth of what one jet changes the rate by in a sample, accelerometers from a half to a three-hundredth. The
true body is 30 % off what the vehicle's file says, the lag 5 % off, thrusts of odd numbers 1 % off, as stated. It turns
and translates for a minute about all axes; then something happens, and it maneuvers for another minute.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import yaml
from joint_campaign import FAR, in_words, judged, setting
from numpy.typing import NDArray
from scipy.optimize import linprog

from massprop_drake import load_scenario, simulate
from massprop_drake.maths.mass_properties import MassProperties, perturbed
from massprop_drake.results.summary import from_names

Array = NDArray[np.float64]
Random = np.random.Generator

KINDS = ("healthy", "on", "off", "leak", "dock", "release", "off_then_dock")
HAPPENS_S, ENDS_S = (62.0, 68.0), 120.0
EARLY_S, EARLY_ENDS_S = (0.5, 15.0), 60.0


class Drawn(NamedTuple):
    """A vehicle and what it may do.

    Attributes:
        vehicle: as its file has it.
        autopilot: settings of it.
        nominal: body that the file states.
        thrust: of a jet, N.
    """

    vehicle: dict[str, Any]
    autopilot: dict[str, Any]
    nominal: MassProperties
    thrust: float


def drawn(random: Random) -> Drawn:
    """A vehicle that its jets can push and turn in every direction."""
    mass = float(np.exp(random.uniform(np.log(8.0), np.log(8000.0))))
    half = 0.6 * (mass / 200.0) ** (1.0 / 3.0) * np.exp(random.uniform(-0.4, 0.4, 3))
    second = mass * half**2 / 3.0 * np.exp(random.uniform(-0.3, 0.3, 3))
    center = 0.1 * half * random.standard_normal(3)
    body = MassProperties(mass, center, np.diag(second.sum() - second))
    nominal = perturbed(
        body,
        mass_factor=1.0,
        shift=np.zeros(3),
        second_moment_factors=np.ones(3),
        rotation=0.1 * random.standard_normal(3),
    )
    period = float(random.choice([0.04, 0.08, 0.1, 0.2]))
    push = float(np.exp(random.uniform(np.log(0.005), np.log(0.1))))  # of two jets, m/s^2
    thrust = 0.5 * mass * push
    places, directions = jets(random, half, center)
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


def jets(random: Random, half: Array, center: Array) -> tuple[Array, Array]:
    """Places and directions of jets, two to four along each way of each axis, that together do everything."""
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
        if does_everything(*found, center, half):
            return found


def does_everything(places: Array, directions: Array, center: Array, half: Array) -> bool:
    """Whether half of the mean thrust of all jets, at the most, is enough for an impulse either way about each axis."""
    arms = (places - center) / half.mean()
    wrenches = np.hstack((np.cross(arms, directions), directions)).T
    for axis in range(6):
        for sign in (1.0, -1.0):
            wanted = 0.5 * sign * np.eye(6)[axis]
            if linprog(np.ones(len(places)), A_eq=wrenches, b_eq=wanted, bounds=(0.0, 1.0)).status != 0:
                return False
    return True


def maneuver(random: Random, ends_s: float) -> list[dict[str, Any]]:
    """Each axis by itself, and then whatever comes; again after something has happened."""
    windows: list[dict[str, Any]] = []

    def add(controller: str, axis: str, now: float) -> float:
        ends = now + float(random.uniform(1.0, 2.5))
        windows.append({"controller": controller, "axis": axis, "start_s": now, "end_s": ends})
        return ends + float(random.uniform(0.5, 2.0))

    now = 1.0
    for controller in ("rhc", "thc"):
        for axis in random.permutation(["+x", "+y", "+z"]).tolist():
            now = add(controller, axis, now)
    while now < ends_s - 5.0:
        controller = "rhc" if random.random() < 0.5 else "thc"
        now = add(controller, str(random.choice(["+x", "-x", "+y", "-y", "+z", "-z"])), now)
    return windows


def happens(
    kind: str, random: Random, ship: Drawn, true: MassProperties, early: bool
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Failures and jumps of a kind."""
    start_s = float(random.uniform(*(EARLY_S if early else HAPPENS_S)))
    jet = str(random.choice([one["designation"] for one in ship.vehicle["jets"]]))
    share = float(np.exp(random.uniform(np.log(0.05), np.log(0.4))))
    position = [float(one) for one in ship.nominal.center_of_mass + random.uniform(-1.0, 1.0, 3) * arm(ship)]
    docks = {"kind": "dock", "time_s": start_s, "mass": share * ship.nominal.mass, "position": position}
    failures = {
        "on": [{"kind": "stuck_on", "jet": jet, "start_s": start_s}],
        "off": [{"kind": "stuck_off", "jet": jet, "start_s": start_s}],
        "leak": [
            {"kind": "leak", "jet": jet, "start_s": start_s, "force": ship.thrust * float(random.uniform(0.02, 0.3))}
        ],
        "off_then_dock": [{"kind": "stuck_off", "jet": jet, "start_s": start_s}],
    }
    jumps = {
        "dock": [docks],
        "release": [leaves(random, true, start_s)],
        "off_then_dock": [{**docks, "time_s": start_s + float(random.uniform(5.0, 15.0))}],
    }
    return failures.get(kind, []), jumps.get(kind, [])


def arm(ship: Drawn) -> float:
    """Size of a vehicle, m."""
    return float(np.sqrt(np.trace(ship.nominal.inertia) / ship.nominal.mass))


def leaves(random: Random, true: MassProperties, start_s: float) -> dict[str, Any]:
    """A payload that leaves, from where half of what could be a body's there is left."""
    mass = true.mass * float(random.uniform(0.03, 0.15))
    second = 0.5 * np.trace(true.inertia) * np.eye(3) - true.inertia
    way = random.standard_normal(3)
    reduced = mass * true.mass / (true.mass - mass)
    arm = way * np.sqrt(0.5 / (reduced * way @ np.linalg.solve(second, way)))
    # what leaves is as far from the whole's center of mass as the rest allows
    position = true.center_of_mass + arm * (true.mass - mass) / true.mass
    return {"kind": "release", "time_s": start_s, "mass": mass, "position": position.tolist()}


def fly(kind: str, number: int, compiled: bool, early: bool = False) -> tuple[str, list[str], Array, str]:
    """Flies one: what was made of it, what was said, errors over their 1-sigma at the end, and the verdict."""
    random = np.random.default_rng([number, *kind.encode()])
    ship = drawn(np.random.default_rng([number]))
    true = perturbed(
        ship.nominal,
        mass_factor=float(np.exp(0.3 * random.standard_normal())),
        shift=0.1 * arm(ship) * random.standard_normal(3),
        second_moment_factors=np.exp(0.3 * random.standard_normal(3)),
        rotation=0.1 * random.standard_normal(3),
    )
    failures, jumps = happens(kind, random, ship, true, early)
    ends_s = EARLY_ENDS_S if early else ENDS_S
    body = {"mass": true.mass, "center_of_mass": true.center_of_mass.tolist(), "inertia": true.inertia.tolist()}
    off = 0.01 if number % 2 else 0.0
    settings = [
        setting("failures", failures),
        setting("jumps", jumps),
        "execution.engine=loop",
        "plant.lag_factor=0.9523809523809523",
        f"plant.thrust_dispersion={off}",
        f"joint.thrust_uncertainty={off}",
        *(["execution.compiled=true"] if compiled else []),
    ]
    with TemporaryDirectory() as folder:
        (Path(folder) / "vehicle.yaml").write_text(yaml.safe_dump(ship.vehicle))
        scenario = {
            "name": f"{kind}_{number}",
            "vehicle": "vehicle.yaml",
            "duration_s": ends_s,
            "seed": number,
            "maneuver": maneuver(random, ends_s),
            "autopilot": ship.autopilot,
            "plant": {"mass_properties": body},
        }
        path = Path(folder) / "scenario.yaml"
        path.write_text(yaml.safe_dump(scenario))
        run = simulate(load_scenario(path, settings))
    summary = run.summary
    deviation = from_names(summary["standard_deviations"])
    sigmas = (from_names(summary["estimates"]) - np.array(run["truth"][-1])) / deviation
    acted = [one for one in summary["injected"] if one["kind"] not in ("dock", "release")]
    failed = {one["jet"]: one["first_acted_s"] for one in acted if one["first_acted_s"] is not None}
    verdict, _ = judged(summary["events"], failed, "jump" if jumps else "", lambda _, __: 0.0)
    return verdict, [in_words(event) for event in summary["events"]], sigmas, summary["consistency"]["verdict"]


def main() -> None:
    """Flies, and prints a line a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", choices=[[], *KINDS], metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--first", type=int, default=0, help="number of the first flight, its seed and its vehicle")
    parser.add_argument("--count", type=int, default=20, help="flights of each kind")
    parser.add_argument("--early", action="store_true", help="something happens in the first 15 s; a minute each")
    parser.add_argument("--compiled", action="store_true", help="compiled kernels: the extra `fast`")
    parser.add_argument("--each", action="store_true", help="print every flight, not only those that are not right")
    arguments = parser.parse_args()
    for kind in arguments.kind or KINDS:
        verdicts: Counter[str] = Counter()
        errors, unsaid = [], 0
        for number in range(arguments.first, arguments.first + arguments.count):
            verdict, said, sigmas, consistency = fly(kind, number, arguments.compiled, arguments.early)
            most = float(np.abs(sigmas).max())
            verdicts[verdict] += 1
            errors.append(sigmas)
            unsaid += most > FAR and consistency == "consistent"
            if arguments.each or verdict != "right" or most > FAR:
                print(f"{kind} {number}: {verdict}; {'; '.join(said)}; z {most:.1f}, {consistency}", flush=True)
        every = np.abs(errors)
        counts = ", ".join(f"{name} {count}" for name, count in verdicts.most_common())
        far = f"beyond {FAR:g} sigma {int((every.max(axis=1) > FAR).sum())}, of these called consistent {unsaid}"
        print(f"{kind}: {counts}; {far}; coverage of 3 sigma {100.0 * (every <= 3.0).mean():.1f} %", flush=True)


if __name__ == "__main__":
    main()
