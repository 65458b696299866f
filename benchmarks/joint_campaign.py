"""Flights of the joint filter with its detector by kinds: what is declared, how soon, what the estimates are worth.

    python benchmarks/joint_campaign.py [KIND ...] [--first 0] [--count 10] [--compiled] [--write FILE] [--each]

The number of a flight is its seed, and everything in it is drawn from that. Jets lag by 15 ms, of which the filter is
told 5 % too much; flights of odd number have thrusts off by 1 %, as stated, the others exact ones that the filter takes
for such, unless the kind says otherwise; where each jet has its turn, it has it with either in turn. Flights with
failures: the sample maneuver, 5 s of hold, in which something begins, and 25 s of rotations and translations. With
`--write` each flight is added to a file as a line of JSON, and flights that are in it already are not flown again: a
campaign may be stopped, and its table printed with `--count 0`.

A flight with failures is

    right     each that acted was named, and nothing else
    grouped   each was named or is in a group that counts, of 3 jets at most that are within 6 nats when it is said or
              a sample before, since a group is also said because none of it explains the newest sample; that what has
              fired cannot tell them apart is the detector's own condition for a group
    silent    something that acted was not said, or only to be unexplained
    wide      a group with the right jet that does not count: the target takes it for wrong
    wrong     a jet that had not failed, a group without one that had, a jump or a false reading where there was none,
              a jump that is said twice
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import Run, estimate, load_scenario, simulate
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.mass_properties import MassProperties, perturbed
from massprop_drake.results.summary import from_names
from massprop_drake.signals import SYMBOLS

Array = NDArray[np.float64]
Random = np.random.Generator

LOOP = ("execution.engine=loop", "plant.lag_factor=0.9523809523809523")
AFTER_S = 48.0  # when something begins, at the soonest
PERIOD_S = 0.08
IN_A_GROUP, NATS = 3, 6.0  # of a group that counts
FAR = 6.0  # sigmas: a flight that ends farther off is lost, whatever was said of it
BIAS = 5e-4  # rad/s
_HAPPENING = ("failures", "jumps")  # what is in a scenario's plant beside its vehicle
VERDICTS = ("right", "grouped", "silent", "wide", "wrong")


class Flight(NamedTuple):
    """What is to be flown.

    Attributes:
        scenario: name of a bundled one.
        settings: of it.
        expected: kind of event that ought to be said besides jets, "" if none.
        dispersed: thrusts off and stated to be off, 1-sigma; None: by its number.
        recorded: makes the record that is estimated, from the flight; None: what is estimated in flight counts.
    """

    scenario: str
    settings: tuple[str, ...] = ()
    expected: str = ""
    dispersed: tuple[float, float] | None = None
    recorded: Callable[[Run, Random], Record] | None = None


class Record(NamedTuple):
    """Telemetry.

    Attributes:
        time_s: of each row, s, shape (n,).
        rates: of the gyro, rad/s, shape (n, 3).
        velocities: of each accelerometer, by name, ft/s, shape (n, 3).
        commands: from each row on, shape (n, n_jets).
    """

    time_s: Array
    rates: Array
    velocities: Mapping[str, Array]
    commands: Array


def setting(key: str, value: object) -> str:
    """A setting as `--set` takes it."""
    return f"{key}={json.dumps(value)}"


@cache
def vehicle() -> Any:
    """The orbiter."""
    return load_scenario("orbiter_maneuver").vehicle_data


def primaries() -> list[str]:
    """Designations of the primary jets."""
    return [jet.designation for jet in vehicle().jets if jet.kind == "primary"]


@cache
def commanded() -> list[str]:
    """Jets that a flight without failures commands after the sample maneuver."""
    run = simulate(load_scenario("payload_docking", ["jumps=[]", *LOOP]))
    told = np.array(run["command"])[run.time_s > AFTER_S + 1.0].any(axis=0)
    return [vehicle().designations[jet] for jet in np.flatnonzero(told)]


def drawn(random: Random, mass: float, shift: float, moments: float, turn: float) -> str:
    """A true body about the nominal one: relative 1-sigma of mass and second moments, ft, and rad."""
    body = perturbed(
        vehicle().nominal,
        mass_factor=float(np.exp(mass * random.standard_normal())),
        shift=shift * random.standard_normal(3),
        second_moment_factors=np.exp(moments * random.standard_normal(3)),
        rotation=turn * random.standard_normal(3),
    )
    return _as_setting(body)


def _as_setting(body: MassProperties) -> str:
    return setting(
        "plant.mass_properties",
        {"mass": body.mass, "center_of_mass": body.center_of_mass.tolist(), "inertia": body.inertia.tolist()},
    )


def usual(random: Random) -> str:
    """A true body as a vehicle may differ from its file."""
    return drawn(random, 0.05, 0.3, 0.03, np.radians(1.0))


# --- healthy flights


def from_zero(random: Random, number: int) -> Flight:
    """Drawn truth, estimates from zero."""
    return Flight("orbiter_maneuver", (usual(random),))


def from_nominal(random: Random, number: int) -> Flight:
    """Drawn truth, estimates from nominal."""
    return Flight("orbiter_maneuver", (usual(random), "estimation.start=nominal"))


def from_prior(random: Random, number: int) -> Flight:
    """Truth off by 30 %, which the start states."""
    body = drawn(random, 0.3, vehicle().center_of_mass_floor, 0.3, np.radians(5.0))
    return Flight("orbiter_maneuver", (body, "estimation={filter: joint, start: nominal, std_fraction: 0.3}"))


def windows(random: Random, controllers: Sequence[str], last_s: float, hold_s: tuple[float, float]) -> str:
    """Windows of hand controllers one after the other, each some time out of detent and about as long in it."""
    now, found = 1.0, []
    while now < last_s:
        ends = now + random.uniform(*hold_s)
        axis = random.choice(["+x", "-x", "+y", "-y", "+z", "-z"])
        found.append({"controller": random.choice(controllers), "axis": axis, "start_s": now, "end_s": ends})
        now = ends + random.uniform(1.0, 3.0)
    return json.dumps(
        [{key: value if isinstance(value, float) else str(value) for key, value in one.items()} for one in found]
    )


def translations(random: Random, number: int) -> Flight:
    """Drawn truth, translations alone."""
    return Flight(
        "orbiter_maneuver", (usual(random), f"maneuver={windows(random, ['thc'], 55.0, (1.0, 3.0))}", "duration_s=60")
    )


def pulses(random: Random, number: int) -> Flight:
    """Drawn truth, pulses of one to four samples alone."""
    given = windows(random, ["rhc", "thc"], 55.0, (0.08, 0.32))
    return Flight("orbiter_maneuver", (usual(random), f"maneuver={given}", "duration_s=60"))


def ten_minutes(random: Random, number: int) -> Flight:
    """Ten minutes, thrusts dispersed by 1 %, settings as they are."""
    return Flight("healthy_long", (*_AS_IT_IS, usual(random)), dispersed=(0.01, 0.01))


def mismatch(random: Random, number: int) -> Flight:
    """Drawn truth, thrusts off by 2 %, 1 % stated."""
    return Flight("payload_docking", ("jumps=[]", usual(random)), dispersed=(0.02, 0.01))


def gyro_bias(random: Random, number: int) -> Flight:
    """A gyro's bias as its 1-sigma says."""
    bias = (BIAS * random.standard_normal(3)).tolist()
    errors = setting("sensors.errors", [{"sensor": "gyro", "bias": bias}])
    return Flight("orbiter_maneuver", (errors, f"vehicle.gyros[0].bias_std={BIAS}"), dispersed=(0.0, 0.0))


def six_hours(random: Random, number: int) -> Flight:
    """The sample maneuver every ten minutes for six hours."""
    program = [window.model_dump() for window in load_scenario("orbiter_maneuver").maneuver]
    late = [
        {**one, "start_s": one["start_s"] + begin, "end_s": one["end_s"] + begin}
        for begin in range(0, 21600, 600)
        for one in program
    ]
    flown = setting("maneuver", late)
    told = () if number % 2 == 0 else ("joint.tank_fraction=null",)
    return Flight("orbiter_maneuver", (flown, "duration_s=21600", usual(random), *told))


_AS_IT_IS = ("plant.thrust_transient=vehicle", "estimation={filter: joint, start: zero}", "rotation={}", "mass={}")


# --- failures


_EITHER = ((0.0, 0.0), (0.01, 0.01))  # exact thrusts, and such that are off by 1 % and stated to be


def failing(*failures: Mapping[str, Any]) -> Flight:
    """The usual flight with failures."""
    return Flight("payload_docking", ("jumps=[]", setting("failures", failures)))


def leak(jet: str, start_s: float, force: float = 10.0) -> dict[str, Any]:
    """A leak."""
    return {"kind": "leak", "jet": jet, "start_s": start_s, "force": force}


def stuck(kind: str, jet: str, start_s: float) -> dict[str, Any]:
    """A jet that is stuck on or off."""
    return {"kind": f"stuck_{kind}", "jet": jet, "start_s": start_s}


def begins(random: Random) -> float:
    """When something begins, s."""
    return AFTER_S + float(random.uniform(0.0, 1.0))


def one(kind: str) -> Callable[[Random, int], Flight]:
    """One failure, of each jet in turn."""

    def draw(random: Random, number: int) -> Flight:
        start_s = begins(random)
        jets = {"leak": list(vehicle().designations), "on": primaries(), "off": commanded()}[kind]
        turn, which = divmod(number, len(jets))
        failure = leak(jets[which], start_s) if kind == "leak" else stuck(kind, jets[which], start_s)
        return failing(failure)._replace(dispersed=_EITHER[(turn + which) % 2])

    return draw


def early(kind: str) -> Callable[[Random, int], Flight]:
    """One failure in the first 15 s of a start, from zero or nominal: leaks of 10 lbf, of every second of 50."""

    def draw(random: Random, number: int) -> Flight:
        start_s, large = float(random.uniform(0.0, 15.0)), number // 4 % 2 == 0
        if kind == "leak":
            among = primaries() if large else list(vehicle().designations)
            failure = leak(str(random.choice(among)), start_s, 50.0 if large else 10.0)
        else:
            failure = stuck(kind, str(random.choice(primaries() if kind == "on" else _SOON_TOLD)), start_s)
        start = ("zero", "nominal")[number // 2 % 2]
        given = setting("failures", [failure]), usual(random), f"estimation.start={start}"
        return Flight("orbiter_maneuver", given)

    return draw


_SOON_TOLD = ("F1F", "F2F", "F1D", "F2D", "F2U", "L1L", "L1U", "L3D", "L4D", "R1R", "R1U", "R4D")  # before 8 s


def small_leak(random: Random, number: int) -> Flight:
    """A leak of 5 lbf of L4D."""
    return failing(leak("L4D", begins(random), 5.0))


def two(first: str, second: str, apart_s: float) -> Callable[[Random, int], Flight]:
    """Two failures of different jets."""

    def draw(random: Random, number: int) -> Flight:
        start_s = begins(random)
        jets: list[str] = []
        for kind in (first, second):
            among = {"leak": list(vehicle().designations), "on": primaries(), "off": commanded()}[kind]
            jets.append(str(random.choice([jet for jet in among if jet not in jets])))
        kinds, starts = (first, second), (start_s, start_s + apart_s)
        if random.random() < 0.5:
            starts = starts[::-1]
        made = [
            leak(jet, begin) if kind == "leak" else stuck(kind, jet, begin)
            for kind, jet, begin in zip(kinds, jets, starts, strict=True)
        ]
        return failing(*made)

    return draw


def intermittent(random: Random, number: int) -> Flight:
    """A jet on its own for half of each of eight seconds."""
    start_s, jet = begins(random), primaries()[number % len(primaries())]
    return failing(*({**stuck("on", jet, start_s + k), "end_s": start_s + k + 0.5} for k in range(8)))


def degraded(random: Random, number: int) -> Flight:
    """A jet that gives 60 %."""
    return failing(
        {"kind": "degraded", "jet": commanded()[number % len(commanded())], "start_s": begins(random), "fraction": 0.6}
    )


def drift(random: Random, number: int) -> Flight:
    """A jet that weakens by 1 % a second."""
    jet = commanded()[number % len(commanded())]
    return failing({"kind": "drift", "jet": jet, "start_s": begins(random), "rate_per_s": -0.01})


def payload(random: Random, number: int) -> Flight:
    """A payload that leaves or comes."""
    jump = {
        "kind": ("release", "dock")[number // 2 % 2],
        "time_s": begins(random),
        "mass": float(random.choice([200.0, 500.0, 1000.0, 2000.0])),
        "position": [float(random.uniform(30.0, 60.0)), float(random.uniform(-5.0, 5.0)), -3.0],
    }
    return Flight("payload_docking", (setting("jumps", [jump]),), expected="jump")


# --- records


def taken(run: Run) -> Record:
    """The telemetry of a run."""
    packages = [each.name for each in run.scenario.vehicle_data.accelerometers]
    velocities = {name: np.array(run[name]) for name in packages}
    return Record(np.array(run.time_s), np.array(run["gyro"]), velocities, np.array(run["command"]))


def firing(run: Run, random: Random) -> int:
    """A row after 30 s in the interval before which jets fired."""
    rows = np.flatnonzero((run.time_s[1:-20] > 30.0) & run["command"][:-21].any(axis=1)) + 1
    return int(random.choice(rows))


def lying(run: Run, random: Random) -> Record:
    """One reading that is wrong: of a gyro by .02, .2 or 3 rad/s, of an accelerometer by 10 ft/s."""
    record, row, axis = taken(run), firing(run, random), int(random.integers(3))
    kind = run.scenario.seed % 4
    if kind < 3:
        record.rates[row, axis] += (0.02, 0.2, 3.0)[kind]
    else:
        record.velocities["acc2"][row, axis] += 10.0
    return record


def frozen(run: Run, random: Random) -> Record:
    """An axis of the gyro that stands still for a second while it turns."""
    record, axis = taken(run), int(random.integers(3))
    turning = np.flatnonzero(np.abs(np.diff(record.rates[:, axis])) > 1e-4)
    turning = turning[(record.time_s[turning] > 30.0) & (turning < len(record.time_s) - 30)]
    row = int(random.choice(turning))
    record.rates[row : row + 13, axis] = record.rates[row, axis]
    return record


def off_stamps(run: Run, random: Random) -> Record:
    """Readings 1 ms off their ticks, 1 sigma, at most 2, and stamped as they were taken.

    The jets' commands are flown again with a sample each millisecond, and the readings next to those times are
    taken. More than 2 ms is left out: rows that are 4 ms off the sample period are gaps.
    """
    command, step_s = np.array(run["command"]), 1e-3
    pulses = []
    for jet, name in enumerate(vehicle().designations):
        edges = np.diff(np.concatenate(([0.0], command[:, jet], [0.0])))
        for begin, end in zip(np.flatnonzero(edges > 0.0), np.flatnonzero(edges < 0.0), strict=True):
            pulses.append({"jet": name, "start_s": max(begin * PERIOD_S - 1e-6, 0.0), "end_s": end * PERIOD_S - 1e-6})
    plain = ("estimation={filter: thesis}", "joint={}", "mass={}", "detector.kind=off", "maneuver=[]")
    given = run.scenario.plant.mass_properties
    body = setting("plant.mass_properties", None if given is None else given.model_dump())
    told = (setting("jet_schedule", pulses), f"vehicle.sample_period_s={step_s}", "plant.lag_factor=1.0", body)
    kinds = [f"vehicle.jet_kinds.{kind}.time_constant_s={0.015 / 1.05}" for kind in ("primary", "vernier")]
    flown = "execution.engine=loop", setting("execution.compiled", run.scenario.execution.compiled)
    happening = [
        setting(key, [each.model_dump(mode="json") for each in getattr(run.scenario, key)]) for key in _HAPPENING
    ]
    settings = [*plain, *told, *kinds, *flown, *happening, f"duration_s={run.time_s[-1]}", f"seed={run.scenario.seed}"]
    fine = simulate(load_scenario("orbiter_maneuver", settings))
    off = np.round(np.clip(1e-3 * random.standard_normal(len(run.time_s)), -2e-3, 2e-3) / step_s).astype(int)
    rows = np.round(run.time_s / step_s).astype(int) + off
    rows = np.clip(rows, 0, len(fine.time_s) - 1)
    every = taken(fine)
    velocities = {name: values[rows] for name, values in every.velocities.items()}
    return Record(every.time_s[rows], every.rates[rows], velocities, command)


def off_its_ticks(flight: Callable[[Random, int], Flight]) -> Callable[[Random, int], Flight]:
    """A kind with exact thrusts, and stamps off by 1 ms, true ones in the record."""

    def made(random: Random, number: int) -> Flight:
        return flight(random, number)._replace(dispersed=(0.0, 0.0), recorded=off_stamps)

    return made


def false_reading(random: Random, number: int) -> Flight:
    """A reading that lies, in the record."""
    return Flight("orbiter_maneuver", (), "false_reading", recorded=lying)


def stuck_axis(random: Random, number: int) -> Flight:
    """A gyro axis that stands still for a second, in the record."""
    return Flight("orbiter_maneuver", (), "false_reading", recorded=frozen)


def stamps(random: Random, number: int) -> Flight:
    """Stamps off by 1 ms, true ones in the record."""
    return Flight("orbiter_maneuver", (usual(random),), dispersed=(0.0, 0.0), recorded=off_stamps)


def written(record: Record, path: Path) -> None:
    """The record as a file."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        packages = ["gyro", *record.velocities]
        jets = [f"jet_{name}" for name in vehicle().designations]
        writer.writerow(["time_s", *(f"{name}_{axis}" for name in packages for axis in "xyz"), *jets])
        columns = np.column_stack((record.time_s, record.rates, *record.velocities.values(), record.commands))
        writer.writerows(columns.tolist())


HEALTHY: Mapping[str, Callable[[Random, int], Flight]] = {
    "zero": from_zero,
    "nominal": from_nominal,
    "prior": from_prior,
    "translations": translations,
    "pulses": pulses,
    "long": ten_minutes,
    "mismatch": mismatch,
    "gyro_bias": gyro_bias,
    "stamps": stamps,
    "six_hours": six_hours,
}
FAILING: Mapping[str, Callable[[Random, int], Flight]] = {
    "on": one("on"),
    "off": one("off"),
    "leak": one("leak"),
    "early_on": early("on"),
    "early_off": early("off"),
    "early_leak": early("leak"),
    "small_leak": small_leak,
    "on_on": two("on", "on", 1.0),
    "off_off": two("off", "off", 1.0),
    "on_off": two("on", "off", 1.0),
    "leak_leak": two("leak", "leak", 1.0),
    "on_on_at_once": two("on", "on", 0.0),
    "off_off_at_once": two("off", "off", 0.0),
    "on_off_at_once": two("on", "off", 0.0),
    "leak_leak_at_once": two("leak", "leak", 0.0),
    "intermittent": intermittent,
    "degraded": degraded,
    "drift": drift,
    "payload": payload,
    "lie": false_reading,
    "stuck_axis": stuck_axis,
    "stamps_on": off_its_ticks(one("on")),
    "stamps_off": off_its_ticks(one("off")),
    "stamps_leak": off_its_ticks(one("leak")),
    "stamps_payload": off_its_ticks(payload),
}
KINDS = {**HEALTHY, **FAILING}


# --- what becomes of a flight


class Result(NamedTuple):
    """What one flight leaves for the table.

    Attributes:
        kind, number: of the flight.
        verdict: see the module.
        said: everything that was said, in words.
        delays_s: from when each failure first acted to its name or group, s.
        sigmas: errors over their 1-sigma, at the end, or the largest once settled where a flight is hours long.
        sizes: errors of the masses of payloads over their 1-sigma, as measured.
        percent: errors, %, null where the truth is as good as zero.
        nis: mean of the gyros' and of the accelerometers', of three components.
        jets_out: healthy jets out of use.
        diagnoses: kinds of what is said in hindsight.
        spent_s: time that it took.
        consistency: the verdict on it, "" where an older version flew.
    """

    kind: str
    number: int
    verdict: str
    said: list[str]
    delays_s: list[float]
    sigmas: list[float]
    sizes: list[float]
    percent: list[float | None]
    nis: list[float | None]
    jets_out: list[str]
    diagnoses: list[str]
    spent_s: float
    consistency: str = ""

    @property
    def farthest(self) -> float:
        """The largest error over its 1-sigma."""
        return max(map(abs, self.sigmas))


def judged(
    events: Iterable[Mapping[str, Any]],
    failed: Mapping[str, float],
    expected: str,
    apart: Callable[[float, Sequence[str]], float],
) -> tuple[str, dict[str, float]]:
    """The verdict, and when each failed jet was first named or in a group that counts, s.

    Args:
        events: of the summary.
        failed: when each jet that has failed first acted, s.
        expected: see `Flight`.
        apart: by which jets differ in likelihood at a time, nats.
    """
    named: dict[str, float] = {}
    grouped: dict[str, float] = {}
    wide, wrong, met = False, False, not expected
    for event in events:
        kind, jets, now = event["kind"], event["jets"], event["time_s"]
        right = [jet for jet in jets if jet in failed and failed[jet] <= now]
        if kind == "failed":
            named |= {jet: named.get(jet, now) for jet in right}
            wrong |= not right
        elif kind == "group":
            counts = len(jets) <= IN_A_GROUP and apart(now, jets) <= NATS
            grouped |= {jet: grouped.get(jet, now) for jet in right if counts}
            wide |= bool(right) and not counts
            wrong |= not right
        elif kind in {"jump", "false_reading"}:
            wrong |= kind != expected or (met and kind == "jump")
            met |= kind == expected
    told = {jet: min(named.get(jet, np.inf), grouped.get(jet, np.inf)) for jet in failed}
    if wrong:
        return "wrong", told
    if wide:
        return "wide", told
    if not met or not all(np.isfinite(list(told.values()))):
        return "silent", told
    return ("right" if failed.keys() <= named.keys() else "grouped"), told


def in_words(event: Mapping[str, Any]) -> str:
    """An event in a few words."""
    about = "/".join(event["jets"]) or event["axis"] or ""
    size = "" if event["magnitude"] is None else f" {event['magnitude']:.4g}"
    mass = "" if event["mass"] is None else f" {event['mass']:.4g}"
    return f"{event['time_s']:.2f} {event['kind']} {about}{size}{mass}".rstrip()


def settings_of(flight: Flight, number: int) -> list[str]:
    """All that a flight sets."""
    off, stated = flight.dispersed or _EITHER[number % 2]
    thrusts = f"plant.thrust_dispersion={off}", f"joint.thrust_uncertainty={stated}"
    return [*LOOP, *flight.settings, *thrusts, f"seed={number}"]


def fly(kind: str, number: int, compiled: bool) -> Result:
    """Flies one, and judges it."""
    began = time.perf_counter()
    random = np.random.default_rng([number, *kind.encode()])
    flight = KINDS[kind](random, number)
    how = ["execution.compiled=true"] if compiled else []
    scenario = load_scenario(flight.scenario, [*settings_of(flight, number), *how])
    run = simulate(scenario)
    truth = np.array(run["truth"][-1])
    acted = {
        one["jet"]: one["first_acted_s"]
        for one in run.summary["injected"][::-1]
        if one["kind"] not in ("release", "dock")
    }
    failed = {jet: since for jet, since in acted.items() if jet and since is not None}
    if flight.recorded is not None:
        run = again(flight.recorded(run, random), scenario)
    return result(kind, number, flight, run, (truth, failed, scenario), began)


def again(record: Record, scenario: Scenario) -> Run:
    """The estimates from a record."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "telemetry.csv"
        written(record, path)
        return estimate(path, scenario)


def result(
    kind: str, number: int, flight: Flight, run: Run, true: tuple[Array, dict[str, float], Scenario], began: float
) -> Result:
    """What a run leaves."""
    truth, failed, flown = true  # of a record the scenario says nothing of what happens
    summary = run.summary
    order = run.scenario.vehicle_data.designations

    def apart(time_s: float, jets: Sequence[str]) -> float:
        row = int(np.argmin(np.abs(run.time_s - time_s)))
        leads = np.array(run["likelihood"][row - 1 : row + 1])[:, [order.index(jet) for jet in jets]]
        return float(np.nanmin(np.ptp(leads, axis=1)))

    verdict, told = judged(summary["events"], failed, flight.expected, apart)
    if kind == "six_hours":
        settled = run.time_s > 60.0
        every = (run["estimate"] - run["truth"])[settled] / run["standard_deviation"][settled]
        sigmas = every[np.argmax(np.abs(every), axis=0), np.arange(10)]
    else:
        deviation = from_names(summary["standard_deviations"])
        sigmas = (from_names(summary["estimates"]) - truth) / deviation
    scale = np.abs(truth)
    percent = 100.0 * (from_names(summary["estimates"]) - truth) / np.where(scale > 0.0, scale, np.nan)
    consistency = summary["consistency"]
    out = np.flatnonzero(run["out_of_use"][-1]).tolist() if "out_of_use" in run.signals else []
    return Result(
        kind,
        number,
        verdict,
        [in_words(event) for event in summary["events"]],
        [told[jet] - since for jet, since in failed.items() if np.isfinite(told[jet])],
        sigmas.tolist(),
        sizes(summary["events"], flown),
        [None if np.isnan(one) else float(one) for one in percent],
        [consistency["rotation_nis_mean"], consistency["translation_nis_mean"]],
        [order[jet] for jet in out if order[jet] not in failed],
        [one["kind"] for one in consistency["diagnoses"]],
        round(time.perf_counter() - began, 2),
        consistency["verdict"],
    )


def sizes(events: Iterable[Mapping[str, Any]], scenario: Scenario) -> list[float]:
    """Errors of the masses of payloads over their 1-sigma, as measured."""
    brought = sum(jump.mass if jump.kind == "dock" else -jump.mass for jump in scenario.jumps)
    known = [event for event in events if event["kind"] == "jump_measured" and event["mass"] is not None]
    return [(event["mass"] - brought) / event["mass_std"] for event in known]


# --- tables


def report(kind: str, results: Sequence[Result]) -> None:
    """Prints the table of a kind."""
    counts = Counter(one.verdict for one in results)
    print(f"\n{kind}: {len(results)} flights, {np.mean([one.spent_s for one in results]):.1f} s each")
    if kind in FAILING:
        print("  " + ", ".join(f"{name} {counts[name]}" for name in VERDICTS))
    else:
        print(f"  with a declaration {sum(bool(one.said) for one in results)}", end=", ")
        print(f"healthy jets out of use {sum(len(one.jets_out) for one in results)}")
    delays = np.array([delay for one in results for delay in one.delays_s])
    if delays.size:
        shown = np.median(delays), np.quantile(delays, 0.9), delays.max()
        print("  delay, s: median {:.2f}, 90 % {:.2f}, worst {:.2f}".format(*shown))
    measured = np.abs([size for one in results for size in one.sizes])
    if measured.size:
        print(f"  payloads measured {measured.size}, largest error {measured.max():.1f} sigma")
    sigmas = np.array([one.sigmas for one in results])
    rms, most = np.sqrt(np.mean(sigmas**2, axis=0)), np.abs(sigmas)
    flight, which = map(int, np.unravel_index(np.argmax(most), most.shape))
    print(f"  z RMS {rms.min():.2f} to {rms.max():.2f}, of all {np.sqrt(np.mean(sigmas**2)):.2f}", end=", ")
    print(f"largest {sigmas[flight, which]:.1f} ({SYMBOLS[which]}, flight {results[flight].number})", end=", ")
    print(f"coverage of 3 sigma {100.0 * (most <= 3.0).mean():.1f} %")
    if lost := [one for one in results if one.farthest > FAR]:
        trusted = sum(one.consistency == "consistent" for one in lost)
        print(
            f"  BEYOND {FAR:g} SIGMA {len(lost)}, of these called consistent {trusted}:", *(one.number for one in lost)
        )
    diagonal = np.array([[value or 0.0 for value in one.percent[:3]] for one in results])
    print(f"  diagonal RMS {np.sqrt(np.mean(diagonal**2)):.4f} %", end="")
    hindsight = Counter(one.diagnoses[0] if one.diagnoses else "nothing" for one in results)
    print(f"; said first in hindsight: {dict(hindsight)}", flush=True)


def flown_before(path: Path | None) -> list[Result]:
    """Flights in the file."""
    if path is None or not path.exists():
        return []
    return [Result(**json.loads(line)) for line in path.read_text().splitlines()]


def main() -> None:
    """Flies, and prints a table a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", choices=[[], *KINDS], metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--first", type=int, default=0, help="number of the first flight, its seed")
    parser.add_argument("--count", type=int, default=10, help="flights of each kind")
    parser.add_argument("--compiled", action="store_true", help="compiled kernels: the extra `fast`")
    parser.add_argument("--write", type=Path, help="file of flights, one a line; those in it are not flown again")
    parser.add_argument("--each", action="store_true", help="print every flight, not only those that are not right")
    arguments = parser.parse_args()
    before = flown_before(arguments.write)
    for kind in arguments.kind or KINDS:
        results = [each for each in before if each.kind == kind]
        flown = {each.number for each in results}
        for number in range(arguments.first, arguments.first + arguments.count):
            if number in flown:
                continue
            made = fly(kind, number, arguments.compiled)
            results.append(made)
            if arguments.write is not None:
                with arguments.write.open("a") as file:
                    print(json.dumps(made._asdict()), file=file)
            odd = bool(made.said or made.jets_out) if kind in HEALTHY else made.verdict != "right"
            if odd or arguments.each or made.farthest > FAR:
                print(
                    f"{kind} {number}: {made.verdict}; {'; '.join(made.said)}; z {made.farthest:.1f}",
                    flush=True,
                )
        if results:
            report(kind, results)


if __name__ == "__main__":
    main()
