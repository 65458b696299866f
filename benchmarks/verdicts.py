"""How often a healthy flight is called consistent, and what is said of flights with a fault that nobody states.

    python benchmarks/verdicts.py [--healthy 200] [--faults 10] [--first 0]

Each flight is judged as both filters would have it: with the joint filter's knowledge of thrust and lag, and with the
thesis's. Flights are flown with the thesis's filter; for the verdict the filter does not matter, but that its estimate
is where the regression begins. Truth is drawn: 5 % of the mass, 3 % of the second moments, 1 degree.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.maths.mass_properties import perturbed
from massprop_drake.results.hindsight import looked_back
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]
Change = Callable[[Array, Run, np.random.Generator], Array]

PLAIN = ("mass={}", "joint={}", "detector.kind=off")
JOINT = "estimation={filter: joint, start: zero}"
THESIS = "estimation={filter: thesis, start: zero, thrust_transient: gate_lag, thrust_uncertainty: %g}"
FLIGHTS = ("orbiter_maneuver", "orbiter_maneuver", "free_flyer_maneuver", "small_satellite_maneuver", "lander_maneuver")
ORBITER = FLIGHTS[0]


class Fault(NamedTuple):
    """A fault, and what ought to be said of it.

    Attributes:
        kind: of the diagnosis.
        plant: settings of the flight.
        told: of the estimators, besides.
        stated: 1-sigma of thrusts that they are told.
        change: of the gyro's readings.
    """

    kind: str
    plant: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    stated: float = 0.0
    change: Change | None = None


def _late(readings: Array, run: Run, random: np.random.Generator) -> Array:
    """Readings that are taken a millisecond (1-sigma) off their stamps."""
    period_s, quantum = 0.08, 1.52e-6
    late = 1e-3 * random.standard_normal((readings.shape[0], 1))
    change = np.diff(run["rate"], axis=0) / period_s
    after, before = np.vstack((change, change[-1:])), np.vstack((change[:1], change))
    moved: Array = np.round((readings + late * np.where(late > 0.0, after, before)) / quantum) * quantum
    return moved


FAULTS: Mapping[str, Fault] = {
    "thrusts dispersed by 2 %, 1 % stated": Fault("thrust", ("plant.thrust_dispersion=0.02",), stated=0.01),
    "thrusts dispersed by 1 %, none stated": Fault("thrust", ("plant.thrust_dispersion=0.01",)),
    "a torque of 100 ft-lbf": Fault("torque", ("plant.disturbance.torque=[0, 100, 0]",)),
    "a torque that wanders, 20 ft-lbf": Fault(
        "drift", ("plant.disturbance.torque_std=[20, 20, 20]", "plant.disturbance.correlation_time_s=100")
    ),
    "stamps off by 1 ms": Fault("jitter", change=_late),
    "lag 50 % off, 5 % stated": Fault(
        "lag", ("plant.lag_factor=1.5",), ("vehicle.jet_kinds.primary.lag_uncertainty=0.05",)
    ),
    "gyro axis reversed": Fault("gyro_sign", change=lambda readings, *_: readings * np.array([1.0, -1.0, 1.0])),
    "jet L1A reversed in the vehicle's file": Fault("jet", told=("vehicle.jets[14].direction=[-0.985, 0, -0.174]",)),
    "gyro bias of 5e-4 rad/s": Fault("gyro_bias", ("sensors.errors=[{sensor: gyro, bias: [5e-4, 0, 0]}]",)),
}


def flown(name: str, settings: tuple[str, ...], seed: int, stated: float) -> Run:
    """A flight with drawn truth."""
    random = np.random.default_rng(seed)
    base = load_scenario(name, [*PLAIN, THESIS % stated, *settings, f"seed={seed}"])
    given = base.plant.mass_properties
    nominal = (base.vehicle_data.mass_properties if given is None else given).properties()
    body = perturbed(
        nominal,
        mass_factor=1.0 + 0.05 * random.standard_normal(),
        shift=0.01 * base.vehicle_data.rms_arm * random.standard_normal(3),
        second_moment_factors=1.0 + 0.03 * random.standard_normal(3),
        rotation=np.radians(random.standard_normal(3)),
    )
    truth = (
        f"plant.mass_properties={{mass: {body.mass!r}, center_of_mass: {body.center_of_mass.tolist()}, "
        f"inertia: {body.inertia.tolist()}}}"
    )
    scenario = load_scenario(name, [*PLAIN, THESIS % stated, *settings, truth, f"seed={seed}"])
    return simulate(scenario)


def verdicts(name: str, fault: Fault, seed: int) -> list[list[str]]:
    """What is said with either filter's knowledge, the first cause first."""
    run = flown(name, fault.plant, seed, fault.stated)
    signals: Mapping[str, Array] = run.signals
    rows = {key: np.array(signals[key]) for key in signals} | {"time_s": np.array(run.time_s)}
    if fault.change is not None:
        rows["gyro"] = fault.change(rows["gyro"], run, np.random.default_rng(seed))
    spool = Spool(index="time_s")
    spool.append(rows)
    exact = (f"joint={{thrust_uncertainty: {fault.stated}, tank_fraction: 0}}", *fault.told)
    found = []
    for filter_ in ((JOINT, *exact), (THESIS % fault.stated, *fault.told)):
        told = load_scenario(name, [*PLAIN, *filter_])
        back = looked_back(told, spool, rows["estimate"][-1], ())
        found.append([f"{one.kind} ({one.statistic:.3g} > {one.threshold:.3g})" for one in back.diagnoses])
    return found


def main() -> None:
    """Prints how many of the healthy flights are called consistent, and a line a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--healthy", type=int, default=200)
    parser.add_argument("--faults", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    for title, fault in FAULTS.items() if arguments.faults else ():
        found = [verdicts(ORBITER, fault, seed) for seed in range(arguments.first, arguments.first + arguments.faults)]
        for filter_, column in zip(("joint", "thesis"), zip(*found, strict=True), strict=True):
            firsts = Counter(said[0].partition(" ")[0] if said else "nothing" for said in column)
            more = sum(len(said) > 1 for said in column)
            right = firsts[fault.kind]
            print(f"{title}, {filter_}: right {right} of {len(column)}; {dict(firsts)}; more said {more}", flush=True)
    counts = [0, 0]
    for number in range(arguments.healthy):
        name = FLIGHTS[number % len(FLIGHTS)]
        for index, said in enumerate(verdicts(name, Fault(""), arguments.first + number)):
            counts[index] += not said
            if said:
                print(f"healthy {name}, seed {arguments.first + number}, {('joint', 'thesis')[index]}: {said}")
        if number % 20 == 19:
            print(f"healthy: {counts} of {number + 1} without a word", flush=True)


if __name__ == "__main__":
    main()
