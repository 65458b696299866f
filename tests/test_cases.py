"""Small inputs from reports of users of such tools, and the right answer to each; numbers are those of the cases."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run, Scenario, estimate, load_scenario, simulate

VEHICLES = Path(__file__).parent / "data" / "cases"
LOOP = "execution.engine=loop"
AS_FLOWN = ("detector.kind=off", "estimation.filter=thesis")  # gives the joint filter's record bit for bit, sooner
DEGREE = np.pi / 180.0
Array = np.ndarray
Table = dict[str, list[str]]
Known = Callable[[Array, Array], Array]


def windows(*told: str, begin_s: float = 0.5, hold_s: float = 1.0, pause_s: float = 0.3) -> list[dict[str, Any]]:
    """Hand controllers out of detent, one after the other: which, and axis."""
    starts = [round(begin_s + number * (hold_s + pause_s), 3) for number in range(len(told))]
    return [
        {"controller": one[:3], "axis": one[4:], "start_s": start_s, "end_s": round(start_s + hold_s, 3)}
        for one, start_s in zip(told, starts, strict=True)
    ]


def pulses(*told: tuple[str, float, float]) -> list[dict[str, Any]]:
    """A schedule of jets, each from and to, s."""
    return [dict(zip(("jet", "start_s", "end_s"), each, strict=True)) for each in told]


def scenario(folder: Path, content: Mapping[str, Any], *settings: str) -> Scenario:
    """A scenario from what its file would hold; the vehicles of this page lie beside it."""
    for vehicle in VEHICLES.glob("*.yaml"):
        (folder / vehicle.name).write_bytes(vehicle.read_bytes())
    path = folder / "scenario.yaml"
    path.write_text(json.dumps({"name": "case", **content}), encoding="utf-8")
    return load_scenario(path, [LOOP, *settings])


TRUE_INERTIA = [[66.0, -2.0, 1.5], [-2.0, 79.0, -3.0], [1.5, -3.0, 86.0]]
SERVICER = {
    "vehicle": "servicer.yaml",
    "autopilot": {"jet_kinds": ["cold_gas"], "discrete_rate": 0.0174532925, "acceleration": 0.004},
    "plant": {"mass_properties": {"mass": 432.0, "center_of_mass": [0.05, -0.02, 0.06], "inertia": TRUE_INERTIA}},
}
ROTATIONS, SHIFTS = ("rhc +x", "rhc -x", "rhc +y", "rhc -y", "rhc +z"), ("thc +x", "thc +y", "thc +z")
MANEUVER = [*windows(*ROTATIONS), *windows(*SHIFTS, begin_s=7.0, hold_s=1.5)]
HEALTHY = {**SERVICER, "duration_s": 12.5, "seed": 3, "maneuver": MANEUVER}
# inertia is known to a few tenths of a percent after longer turns
TURNS = windows(*ROTATIONS, hold_s=2.0, pause_s=0.5)
LONGER = {**HEALTHY, "duration_s": 20.5, "maneuver": [*TURNS, *windows(*SHIFTS, begin_s=13.0, hold_s=2.0, pause_s=0.5)]}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Turns and translations of a healthy 432 kg satellite whose file says 400 kg."""
    return simulate(scenario(tmp_path_factory.mktemp("flown"), HEALTHY, *AS_FLOWN), look_back=False)


def recorded(run: Run, folder: Path) -> Table:
    """The record of a run, by columns."""
    run.save(folder, pictures=False, report=False)
    with (folder / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, map(list, zip(*rows, strict=True)), strict=True))


@pytest.fixture(scope="module")
def table(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Its record, by columns."""
    return recorded(flown, tmp_path_factory.mktemp("table") / "run")


def estimated(folder: Path, columns: Mapping[str, Sequence[str]], content: Mapping[str, Any], *settings: str) -> Run:
    """Estimates from a record of these columns."""
    with (folder / "log.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return estimate(folder / "log.csv", scenario(folder, content, *settings))


def scaled(columns: Table, word: str, factor: float) -> Table:
    """A record with all columns that begin with a word times a factor."""
    return {
        name: [cell and repr(factor * float(cell)) for cell in cells] if name.startswith(f"{word}_") else cells
        for name, cells in columns.items()
    }


@pytest.mark.parametrize(
    ("told", "start", "words"),
    [
        (0.6, "nominal", ()),
        (
            0.1,
            "nominal",
            ("inertia and mass end at 1/9.", "commands or thrusts were 1/9.", "on-times in s in place"),
        ),
        (0.224809, "nominal", ("inertia and mass end at 1/4.", "would make it 1/4.448")),
        (0.1, "zero", ()),
    ],
)
def test_01_commands_off_by_a_factor_are_inconsistent_and_the_factor_is_named(
    table: Table, tmp_path: Path, told: float, start: str, words: tuple[str, ...]
) -> None:
    """Thrust and mass share a scale: the end is compared with the start, which claims nothing where it is zero."""
    settings = (f"estimation.start={start}", "estimation.filter=joint", "detector.kind=off")
    if told == 0.224809:  # so little off that it takes longer to tell
        table = recorded(simulate(scenario(tmp_path, LONGER, *AS_FLOWN), look_back=False), tmp_path / "run")
    found = estimated(tmp_path, scaled(table, "jet", told), HEALTHY, *settings).summary["consistency"]
    assert found["verdict"] == ("inconsistent" if words else "consistent")
    assert all(part in found["reasons"][0] for part in (*words, *["of its sigmas off"] * bool(words)))


@pytest.mark.parametrize(
    ("sensor", "factor", "words", "by"),
    [
        ("gyro", DEGREE, "gyro: readings are 1/57.3 times what they should be: radians in place of degrees", "thesis"),
        ("gyro", 1 / DEGREE, "gyro: readings are 57.3 times what they should be: degrees in place of radians", "joint"),
        (
            "gyro",
            0.1,
            "gyro: readings are 1/10 times what they should be: increments of angle in place of rates",
            "thesis",
        ),
        ("imu", 9.80665, "imu: readings are 9.807 times what they should be: m/s^2 in place of g", "joint"),
        ("imu", 1000.0, "imu: readings are 1000 times what they should be", "thesis"),
        ("gyro_y", -1.0, "axis gyro y has the wrong sign", "joint"),
    ],
)
def test_08_a_common_factor_of_readings_is_the_first_reason(
    table: Table, tmp_path: Path, sensor: str, factor: float, words: str, by: str
) -> None:
    """Hindsight begins with what either filter ends at."""
    columns = scaled(table, sensor, factor)
    if sensor in table:
        columns = {**table, sensor: [repr(factor * float(cell)) for cell in table[sensor]]}
    settings = ("estimation.start=nominal", f"estimation.filter={by}", "detector.kind=off")
    found = estimated(tmp_path, columns, HEALTHY, *settings).summary["consistency"]
    assert (found["verdict"], found["reasons"][0]) == ("inconsistent", words)


def standing(run: Run) -> list[Any]:
    """Declarations that were not withdrawn."""
    return [one for one in run.summary["detections"] if one["withdrawn_s"] is None]


def test_02_a_jet_that_sticks_off_before_the_first_translation_is_named(tmp_path: Path) -> None:
    """After the turns rotation alone shows ZP1."""
    maneuver = [*TURNS, *windows("rhc -z", begin_s=13.0, hold_s=2.0), *windows("thc +z", begin_s=16.0, hold_s=3.0)]
    failure = {"kind": "stuck_off", "jet": "ZP1", "start_s": 15.5}
    flight = {**SERVICER, "duration_s": 17.5, "seed": 5, "failures": [failure], "maneuver": maneuver}
    (injected,) = simulate(scenario(tmp_path, flight)).summary["injected"]
    assert injected["outcome"] == "named"
    assert injected["declared_s"] - injected["first_acted_s"] <= 1.0


def told_at(columns: Table, known: Known, jets: str = "") -> Table:
    """A record with no commands of jets whose names begin so where they are not known, by the rows' times, numbers."""
    times = np.array(columns["time_s"], dtype=float)
    there = known(times, np.arange(times.size)).tolist()
    return {
        name: [cell if told else "" for cell, told in zip(cells, there, strict=True)]
        if name.startswith(f"jet_{jets}")
        else cells
        for name, cells in columns.items()
    }


def ten(part: Mapping[str, Any]) -> Array:
    """The ten parameters, or their 1-sigma, of a summary."""
    inertia = np.array(part["inverse_inertia"])[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return np.array([*inertia, *part["center_of_mass"], part["mass_reciprocal"]])


@pytest.mark.parametrize(
    ("known", "jets", "said"),
    [
        (
            lambda time_s, _: (time_s < 7.55) | (time_s > 10.55),
            "",
            "commands unknown from 7.6 s to 10.6 s (30 of 126 samples)",
        ),
        (lambda _, row: row % 17 != 8, "", "commands unknown from 0.8 s to 0.9 s, from 2.5 s to 2.6 s, "),
        (
            lambda time_s, _: time_s < 0.0,
            "YP1",
            "commands of jet YP1 unknown from 0 s on (125 of 126 samples): not tested for failures there, and what "
            "they may have given teaches nothing",
        ),
    ],
    ids=("three seconds", "single rows", "one jet"),
)
def test_03_nothing_is_declared_where_commands_are_unknown(
    flown: Run, table: Table, tmp_path: Path, known: Known, jets: str, said: str
) -> None:
    """The jets go on, but what they are told is not known for a while; they are healthy."""
    run = estimated(tmp_path, told_at(table, known, jets), {**SERVICER, "duration_s": 12.5})
    assert run.summary["detections"] == []
    probabilities = [one for one in run.summary["fault_probability"].values() if isinstance(one, Mapping)]
    assert all(one["probability"] <= 0.01 for one in probabilities)
    off = ten(run.summary["estimates"]) - ten(flown.summary["truth"])
    np.testing.assert_array_less(np.abs(off), 3.0 * ten(run.summary["standard_deviations"]))
    warnings = " ".join(run.summary["data_quality"]["warnings"])
    assert said in warnings
    assert "not tested" in warnings


def test_03_what_is_learned_is_that_of_the_commands_that_are_known(table: Table, tmp_path: Path) -> None:
    """Without propellant used by nobody knows which jets, by which mass properties drift."""
    told = {**SERVICER, "duration_s": 12.5, "joint": {"tank_fraction": 0}}
    flight = {name: cells[:106] for name, cells in table.items()}
    ended = estimated(tmp_path, told_at(flight, lambda time_s, _: time_s < 8.55), told)
    cut = estimated(tmp_path, {name: cells[:87] for name, cells in flight.items()}, told)
    (stretch,) = ended.summary["data_quality"]["unknown_commands"]
    assert len(stretch.pop("jets")) == 12
    assert stretch == {"from_s": pytest.approx(8.6), "to_s": pytest.approx(10.5), "samples": 19}
    for name in ("estimate", "standard_deviation"):
        np.testing.assert_array_equal(ended[name][:87], cut[name])
    assert (ended["standard_deviation"][-1] <= 1.001 * cut["standard_deviation"][-1]).all()


@pytest.mark.parametrize(
    ("failure", "known"),
    [
        ({"kind": "leak", "jet": "YN2", "start_s": 12.7, "force": 0.1}, lambda t, _: (t < 12.6) | (t > 14.1)),
        ({"kind": "stuck_on", "jet": "ZP1", "start_s": 14.7}, lambda _, row: row % 17 != 8),
    ],
)
def test_03_failures_are_found_where_commands_are_known(failure: dict[str, Any], known: Known, tmp_path: Path) -> None:
    """After the commands are there again, and between rows without."""
    maneuver = [*MANEUVER, *windows("thc -x", begin_s=12.6, hold_s=2.0)]
    flight = {**SERVICER, "seed": 3, "maneuver": maneuver, "duration_s": 15.8, "failures": [failure]}
    columns = recorded(simulate(scenario(tmp_path, flight, *AS_FLOWN), look_back=False), tmp_path / "run")
    (found,) = standing(estimated(tmp_path, told_at(columns, known), flight))
    assert found["jet"] == failure["jet"]


def tracked(folder: Path, *settings: str) -> Run:
    """A thruster leaks on a satellite that has a star tracker beside gyro and accelerometer."""
    content = {
        "vehicle": "client_servicer.yaml",
        "duration_s": 12.9,
        "seed": 1,
        "maneuver": MANEUVER,
        "autopilot": {"discrete_rate": 0.0174532925, "acceleration": 0.008},
        "failures": [{"kind": "leak", "jet": "T7", "start_s": 9.9, "force": 0.1}],
    }
    return simulate(scenario(folder, content, "vehicle.poses=[{name: st, attitude_std: 5.0e-5}]", *settings))


def test_13_a_run_is_saved_whatever_a_detector_leaves_out(tmp_path: Path) -> None:
    """Of poses: its detector knows no biases, and has no jet to name."""
    run = tracked(tmp_path, "estimation.filter=pose", "duration_s=15.9")
    run.save(tmp_path / "run", pictures=False, report=False)
    again = Run.load(tmp_path / "run")
    assert "unexplained" in [event.kind for event in run.results.events]
    assert again.results.events == run.results.events
    assert again.plot.failure_magnitude() is not None


def test_13_a_further_sensor_makes_nothing_worse(tmp_path: Path) -> None:
    """Without the tracker the leak is named in a second or so."""
    (found,) = standing(tracked(tmp_path))
    assert found["jet"] == "T7"
    assert found["time_s"] <= 11.9


def test_15_a_pulse_shorter_than_the_sample_period_lasts_as_long_as_it_says(tmp_path: Path) -> None:
    """Pulses of 35 ms at a period of 100 ms, one from a sample's time on, one within a sample."""
    told = pulses(("T1", 0.5, 0.535), ("T7", 1.02, 1.055), ("T9", 1.5, 2.0))
    run = simulate(scenario(tmp_path, {"vehicle": "client_servicer.yaml", "duration_s": 2.5, "jet_schedule": told}))
    on_s = dict(zip(run.scenario.vehicle_data.designations, run["command"].sum(axis=0) * 0.1, strict=True))
    assert {jet: on_s[jet] for jet in ("T1", "T7", "T9")} == pytest.approx({"T1": 0.035, "T7": 0.035, "T9": 0.5})


def test_17_a_leak_is_named_at_another_sample_period() -> None:
    """The orbiter at a quarter of its rate."""
    run = simulate(load_scenario("leak_named", [LOOP, "vehicle.sample_period_s=0.32", "duration_s=51"]))
    assert [one["jet"] for one in standing(run)] == ["L4D"]
    assert run.summary["consistency"]["verdict"] == "consistent"


def test_20_what_is_known_decides_and_not_how_often_jets_have_fired(tmp_path: Path) -> None:
    """Thirteen pulses make the mass known to 1 %, then ZP1 leaks 5 % while nothing fires."""
    told = pulses(
        *(("XN1", 0.5, 0.6), ("ZP2", 0.8, 0.9), ("YN1", 1.1, 1.2), ("ZN2", 1.4, 1.5), ("ZN1", 1.7, 1.8)),
        *(("ZP1", 2.0, 2.1), ("YN1", 2.3, 2.5), ("ZN1", 2.7, 2.8), ("YN2", 3.0, 3.1), ("XP2", 3.3, 3.5)),
        *(("ZN1", 3.7, 3.8), ("XP1", 4.0, 4.4), ("YP1", 4.6, 4.8)),
    )
    content = {
        "vehicle": "small_satellite",
        "duration_s": 7.5,
        "seed": 1,
        "estimation": {"filter": "joint"},
        "joint": {"tank_fraction": 0},
        "detector": {"kind": "hypotheses"},
        "plant": {"thrust_dispersion": 0.01},
        "jet_schedule": told,
        "failures": [{"kind": "leak", "jet": "ZP1", "start_s": 6.0, "force": 0.25}],
    }
    (found,) = standing(simulate(scenario(tmp_path, content)))
    assert found["jet"] == "ZP1"
    assert found["time_s"] <= 7.0


WHEELS = np.array([[0.707, 0.0, 0.707], [-0.707, 0.0, 0.707], [0.0, 0.707, 0.707], [0.0, -0.707, 0.707]])
SPIN = 0.005  # kg-m^2, of each wheel
INERTIA = np.array([[19.0, 0.5, -0.3], [0.5, 30.0, 0.6], [-0.3, 0.6, 33.0]])


def turned_by_wheels(period_s: float, count: int) -> tuple[Array, Array, Array]:
    """Times, rates and wheel speeds of a body that wheels alone turn; the coupling by steps of a twentieth."""
    steps, time_s = 20, period_s * np.arange(count)

    def speed(time: float) -> Array:
        return 300.0 * np.sin(time * np.array([0.5, 0.7, 0.9, 1.1]))

    rate, rates, step = np.zeros(3), [np.zeros(3)], period_s / steps
    for begin in time_s[:-1].tolist():
        for each in range(steps):
            now = begin + each * step
            momentum = SPIN * WHEELS.T @ speed(now + 0.5 * step)
            torque = -SPIN * WHEELS.T @ (speed(now + step) - speed(now)) / step
            middle = rate
            for _ in range(2):
                gained = np.linalg.solve(INERTIA, torque - np.cross(middle, INERTIA @ middle + momentum)) * step
                middle = rate + 0.5 * gained
            rate = rate + gained
        rates.append(rate)
    return time_s, np.array(rates), np.array([speed(time) for time in time_s])


def wheels_alone(folder: Path, factor: float | None) -> Mapping[str, Any]:
    """Estimate with four wheels, speeds to .1 rpm, the second's inertia so many times; None: of which no file knows."""
    # with wrong wheels there are more and more failures to think of
    time_s, rates, speeds = turned_by_wheels(0.1, 75 if factor == 1.2 else 300)
    random = np.random.default_rng(16)
    columns = {"time_s": list(map(repr, time_s.tolist()))}
    for axis, name in enumerate("xyz"):
        noisy = rates[:, axis] + 1e-4 * random.standard_normal(time_s.size)
        columns[f"mems_{name}"] = [f"{value:.5f}" for value in noisy]
        columns[f"imu_{name}"] = [f"{value:.5f}" for value in 5e-5 * random.standard_normal(time_s.size)]
    columns |= {f"jet_T{number}": ["0"] * time_s.size for number in range(1, 13)}
    vehicle = {"vehicle": "client_servicer.yaml"}
    if factor is None:
        where = "vehicle.accelerometers[0].position=[0.02, 0.01, -0.01]"  # at the center of mass: it reads its noise
        return estimated(folder, columns, vehicle, where, "detector.kind=off").summary
    tick = 0.1 * np.pi / 30.0  # a tenth of a revolution a minute
    for wheel, column in enumerate(speeds.T):
        columns[f"RW{wheel + 1}_speed"] = [repr(tick * round(value / tick)) for value in column.tolist()]
    stated = [{"name": f"RW{n + 1}", "axis": axis, "inertia": SPIN} for n, axis in enumerate(WHEELS.tolist())]
    stated[1]["inertia"] = factor * SPIN
    return estimated(folder, columns, vehicle, f"vehicle.wheels={json.dumps(stated)}").summary


def test_16_wheels_that_are_in_the_vehicle_file_show_the_inertia(tmp_path: Path) -> None:
    found = wheels_alone(tmp_path, 1.0)
    deviation = np.array(found["derived"]["inertia_std"])
    assert (np.abs(np.array(found["derived"]["inertia"]) - INERTIA) < 4.0 * deviation).all()
    assert (deviation.diagonal() < 0.05 * INERTIA.diagonal()).all()
    assert found["consistency"]["verdict"] == "consistent"


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (None, "unmodeled torques without a force, such as wheels whose speed changes"),
        (1.2, "wheel RW2: its inertia is 0.83"),
    ],
)
def test_16_wheels_that_no_file_has_or_has_wrong_are_named(tmp_path: Path, factor: float | None, words: str) -> None:
    """Torques without a force are no leak."""
    found = wheels_alone(tmp_path, factor)
    assert words in found["consistency"]["reasons"][0]
    assert found["detections"] == []
