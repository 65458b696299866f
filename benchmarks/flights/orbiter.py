"""Flights of the orbiter: the sample maneuver, 5 s of hold in which something happens, 25 s of maneuvers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from flights.flight import STATED_LAG, Flight, Random, failure, setting, thrusts, truth, windows
from flights.records import RECORDED
from massprop_drake import load_scenario, simulate
from massprop_drake.maths.estimation.faults.priors import LEAST_LEAK, Priors
from massprop_drake.maths.mass_properties import perturb_body

_LOOP = ("execution.engine=loop", f"plant.lag_factor={STATED_LAG}")
_AFTER_S = 48.0  # when something happens, at the soonest
_SOON_FIRED = ("F1F", "F2F", "F1D", "F2D", "F2U", "L1L", "L1U", "L3D", "L4D", "R1R", "R1U", "R4D")  # before 8 s
_BIAS = 5e-4  # rad/s


@cache
def _vehicle() -> Any:
    return load_scenario("orbiter_maneuver").vehicle_data


@cache
def _jets(mode: str) -> list[str]:
    """Lists jets that may fail so: all leak, primary jets are stuck on, those that are commanded are stuck off."""
    if mode == "leak":
        return list(_vehicle().designations)
    if mode in ("stuck_on", "intermittent"):
        return [jet.designation for jet in _vehicle().jets if jet.kind == "primary"]
    return _commanded()


@cache
def _commanded() -> list[str]:
    """Lists jets commanded after a possible failure; commands do not depend on the filter."""
    quick = ("detector.kind=off", "estimation.filter=thesis", "joint={}")
    run = simulate(load_scenario("payload_docking", ["jumps=[]", *_LOOP, *quick]), look_back=False)
    commanded = np.array(run["command"])[run.time_s > _AFTER_S + 1.0].any(axis=0)
    return [_vehicle().designations[jet] for jet in np.flatnonzero(commanded)]


def _drawn(random: Random, mass: float, shift: float, moments: float, turn: float) -> str:
    """Draws a true body: relative 1-sigma of mass and second moments, ft, and rad."""
    body = perturb_body(
        _vehicle().nominal,
        mass_factor=float(np.exp(mass * random.standard_normal())),
        shift=shift * random.standard_normal(3),
        second_moment_factors=np.exp(moments * random.standard_normal(3)),
        rotation=turn * random.standard_normal(3),
    )
    return truth(body)


def _usual(random: Random) -> str:
    """Draws a true body as a vehicle may differ from its file."""
    return _drawn(random, 0.05, 0.3, 0.03, np.radians(1.0))


def _begins(random: Random) -> float:
    """Draws when something happens, s."""
    return _AFTER_S + float(random.uniform(0.0, 1.0))


def _ready(scenario: str, settings: tuple[str, ...], how: str, number: int, record: str = "") -> Flight:
    recorded = RECORDED[record] if record else None
    return Flight(scenario, (*_LOOP, *settings, *thrusts(how, number)), recorded=recorded)


# --- healthy


def healthy(random: Random, number: int, *, start: str = "zero", how: str = "either", record: str = "") -> Flight:
    """Draws a healthy flight of the sample maneuver.

    Args:
        random: to draw with.
        number: of the flight.
        start: "zero", "nominal", or "off": truth 30 % off, as the start says.
        how: see `flight.thrusts`.
        record: see `records.RECORDED`.
    """
    if start == "off":
        body = _drawn(random, 0.3, _vehicle().center_of_mass_floor, 0.3, np.radians(5.0))
        told = "estimation={filter: joint, start: nominal, std_fraction: 0.3}"
    else:
        body, told = _usual(random), f"estimation.start={start}"
    return _ready("orbiter_maneuver", (body, told), how, number, record)


def pulses(random: Random, number: int, *, controllers: list[str], hold_s: list[float]) -> Flight:
    """Draws a healthy minute of commands of some length alone."""
    given = windows(random, controllers, (1.0, 55.0), (hold_s[0], hold_s[1]))
    return _ready("orbiter_maneuver", (_usual(random), setting("maneuver", given), "duration_s=60"), "either", number)


def ten_minutes(random: Random, number: int) -> Flight:
    """Draws ten healthy minutes with thrusts dispersed by 1 %."""
    as_it_is = ("plant.thrust_transient=vehicle", "estimation={filter: joint, start: zero}", "rotation={}", "mass={}")
    return _ready("healthy_long", (*as_it_is, _usual(random)), "dispersed", number)


def hours(random: Random, number: int) -> Flight:
    """Draws six healthy hours, the sample maneuver every ten minutes; odd ones with `joint.tank_fraction` null."""
    program = [window.model_dump() for window in load_scenario("orbiter_maneuver").maneuver]
    late = [
        {**one, "start_s": one["start_s"] + begin, "end_s": one["end_s"] + begin}
        for begin in range(0, 21600, 600)
        for one in program
    ]
    told = () if number % 2 == 0 else ("joint.tank_fraction=null",)
    flown = (setting("maneuver", late), "duration_s=21600", _usual(random), *told)
    return _ready("orbiter_maneuver", flown, "either", number)


def mismatch(random: Random, number: int, *, how: str) -> Flight:
    """Draws a healthy flight with thrusts off as `how` says."""
    return _ready("payload_docking", ("jumps=[]", _usual(random)), how, number)


def bias(random: Random, number: int) -> Flight:
    """Draws a healthy flight with a gyro's bias of the stated size."""
    drawn = (_BIAS * random.standard_normal(3)).tolist()
    errors = setting("sensors.errors", [{"sensor": "gyro", "bias": drawn}])
    return _ready("orbiter_maneuver", (errors, f"vehicle.gyros[0].bias_std={_BIAS}"), "exact", number)


def sensor_fault(random: Random, number: int, *, record: str) -> Flight:
    """Draws a healthy flight with a fault of a sensor in its record."""
    return _ready("orbiter_maneuver", (), "either", number, record)


def untold(
    random: Random, number: int, *, plant: Sequence[str] = (), told: Sequence[str] = (), record: str = ""
) -> Flight:
    """Draws a healthy flight with something that its files do not state, without a detector.

    Args:
        random: to draw with.
        number: of the flight.
        plant: overrides of the flight.
        told: overrides of what the record is estimated by.
        record: see `records.RECORDED`.
    """
    usual = (_usual(random), "estimation.start=nominal", "detector.kind=off")
    flight = _ready("orbiter_maneuver", usual, "exact", number, record)
    return flight._replace(settings=(*flight.settings, *plant), told=tuple(told))


# --- failures


def fails(random: Random, number: int, *, mode: str, how: str = "either", record: str = "", **options: Any) -> Flight:
    """Draws a flight with one failure, each jet in its turn.

    Args:
        random: to draw with.
        number: of the flight.
        mode: see `flight.failure`; or "intermittent", stuck on for half of each of eight seconds; or "none".
        how: see `flight.thrusts`.
        record: see `records.RECORDED`.
        options: `size` of the failure, see `flight.failure`; `jet`, its designation; of `_sampled`.
    """
    start_s, failures = _begins(random), []
    size, jet = options.pop("size", 0.0), options.pop("jet", "")
    if mode != "none":
        jets = [jet] if jet else _jets(mode)
        turn, which = divmod(number, len(jets))
        if how == "either" and not jet:
            number = turn + which  # each jet with exact and with dispersed thrusts
        if mode == "intermittent":
            starts = [start_s + second for second in range(8)]
            failures = [{**failure("stuck_on", jets[which], one), "end_s": one + 0.5} for one in starts]
        else:
            failures = [failure(mode, jets[which], start_s, size)]
    settings = ("jumps=[]", setting("failures", failures), *_sampled(**options))
    return _ready("payload_docking", settings, how, number, record)


def as_the_priors(random: Random, number: int) -> Flight:
    """Draws a flight with a failure as the priors of the hypothesis filter have it: any jet, any force.

    Flights on which a probability is what it says: of those drawn otherwise, such as leaks of one size, it need not be.
    """
    priors, start_s, jets = Priors(), _begins(random), list(_vehicle().jets)
    failed = [jets.pop(int(random.integers(len(jets))))]
    if random.random() < priors.together * len(jets):
        failed.append(jets[int(random.integers(len(jets)))])
    failures = []
    for jet in failed:
        full, more = random.random() < priors.full_thrust, random.random() < 0.5
        share = float(np.exp(random.uniform(np.log(LEAST_LEAK), 0.0)) if more else random.uniform())
        mode = ("stuck_on" if full else "leak") if more else ("stuck_off" if full else "degraded")
        failures.append(failure(mode, jet.designation, start_s, share * jet.thrust if more else share))
    return _ready("payload_docking", ("jumps=[]", setting("failures", failures)), "either", number)


def _sampled(*, period_s: float = 0.0, gyro: float = 1.0, accelerometers: float = 1.0) -> list[str]:
    """Overrides how the orbiter is sampled: period, s (0: its own), and factors on the quanta of its sensors."""
    vehicle = _vehicle()
    factors = {"gyros": (gyro, vehicle.gyros), "accelerometers": (accelerometers, vehicle.accelerometers)}
    return [
        *([f"vehicle.sample_period_s={period_s}"] if period_s else []),
        *(
            f"vehicle.{kind}[{index}].quantum={factor * package.quantum}"
            for kind, (factor, packages) in factors.items()
            for index, package in enumerate(packages)
            if factor != 1.0
        ),
    ]


def early(random: Random, number: int, *, mode: str) -> Flight:
    """Draws a flight with a failure in its first 15 s, from zero or nominal; a leak is one of 50 or 10 lbf."""
    start_s, large = float(random.uniform(0.0, 15.0)), number // 4 % 2 == 0
    if mode == "leak":
        found = failure(
            "leak", str(random.choice(_jets("stuck_on" if large else "leak"))), start_s, 50.0 if large else 10.0
        )
    else:
        found = failure(mode, str(random.choice(_jets(mode) if mode == "stuck_on" else list(_SOON_FIRED))), start_s)
    start = ("zero", "nominal")[number // 2 % 2]
    given = setting("failures", [found]), _usual(random), f"estimation.start={start}"
    return _ready("orbiter_maneuver", given, "either", number)


def two(random: Random, number: int, *, modes: list[str], apart_s: float) -> Flight:
    """Draws a flight with failures of two jets, either of them first."""
    start_s, jets = _begins(random), list[str]()
    for mode in modes:
        jets.append(str(random.choice([jet for jet in _jets(mode) if jet not in jets])))
    starts = (start_s, start_s + apart_s)
    if random.random() < 0.5:
        starts = starts[::-1]
    made = [failure(mode, jet, begin, 10.0) for mode, jet, begin in zip(modes, jets, starts, strict=True)]
    return _ready("payload_docking", ("jumps=[]", setting("failures", made)), "either", number)


def payload(random: Random, number: int, *, event: str, record: str = "") -> Flight:
    """Draws a flight in which a payload of 200 to 2000 slug comes ("dock") or leaves ("release")."""
    jump = {
        "kind": event,
        "time_s": _begins(random),
        "mass": float(random.choice([200.0, 500.0, 1000.0, 2000.0])),
        "position": [float(random.uniform(30.0, 60.0)), float(random.uniform(-5.0, 5.0)), -3.0],
    }
    how = "exact" if record else "either"
    return _ready("payload_docking", (setting("jumps", [jump]),), how, number, record)
