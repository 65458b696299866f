"""Small inputs from reports of users of such tools, and the right answer to each."""

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
Array = np.ndarray
Table = dict[str, list[str]]


def windows(*told: tuple[str, str, float, float]) -> list[dict[str, Any]]:
    """Hand controllers out of detent: which, axis, from and to, s."""
    return [dict(zip(("controller", "axis", "start_s", "end_s"), each, strict=True)) for each in told]


def scenario(folder: Path, content: Mapping[str, Any], *settings: str) -> Scenario:
    """A scenario from what its file would hold; the vehicles of this page lie beside it."""
    for vehicle in VEHICLES.glob("*.yaml"):
        (folder / vehicle.name).write_bytes(vehicle.read_bytes())
    path = folder / "scenario.yaml"
    path.write_text(json.dumps({"name": "case", **content}), encoding="utf-8")
    return load_scenario(path, [LOOP, *settings])


SERVICER = {
    "vehicle": "servicer.yaml",
    "autopilot": {"jet_kinds": ["cold_gas"], "discrete_rate": 0.0174532925, "acceleration": 0.004},
    "plant": {
        "mass_properties": {
            "mass": 432.0,
            "center_of_mass": [0.05, -0.02, 0.06],
            "inertia": [[66.0, -2.0, 1.5], [-2.0, 79.0, -3.0], [1.5, -3.0, 86.0]],
        }
    },
}
TURNS = windows(
    ("rhc", "+x", 0.5, 2.5), ("rhc", "-x", 3, 5), ("rhc", "+y", 5.5, 7.5),
    ("rhc", "-y", 8, 10), ("rhc", "+z", 10.5, 12.5),
)  # fmt: skip
TRANSLATIONS = windows(("thc", "+x", 13, 15), ("thc", "+y", 15.5, 17.5), ("thc", "+z", 18, 20))


HEALTHY = {**SERVICER, "duration_s": 20.5, "seed": 3, "maneuver": [*TURNS, *TRANSLATIONS]}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Twenty seconds of turns and translations of a healthy 432 kg satellite whose file says 400 kg."""
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


def written(path: Path, columns: Mapping[str, Sequence[str]]) -> Path:
    """A record as a file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def scaled(columns: Table, **factors: float) -> Table:
    """A record with all columns that begin with a word times a factor, empty cells left empty."""
    result = {}
    for name, cells in columns.items():
        size = factors.get(name.partition("_")[0], 1.0)
        result[name] = cells if size == 1.0 else [cell and repr(size * float(cell)) for cell in cells]
    return result


def settings_of(folder: Path, start: str = "nominal", by: str = "joint") -> Scenario:
    """The scenario that the record is estimated with, by a filter."""
    estimation = (f"estimation.start={start}", f"estimation.filter={by}")
    return scenario(folder, HEALTHY, "detector.kind=off", *estimation)  # verdicts need none, and it takes long


# ------------------------------------------------------------------- 01: a factor that no innovation shows


@pytest.mark.parametrize(
    ("told", "start", "words"),
    [
        (1.0, "nominal", ()),
        (0.6, "nominal", ()),
        (
            0.1,
            "nominal",
            ("inertia and mass end at 1/9.", "commands or thrusts were 1/9.", "on-times in s in place of"),
        ),
        (0.01, "nominal", ("inertia and mass end at 1/9", "fractions in place of percent would make it 1/100")),
        (
            0.224809,
            "nominal",
            ("inertia and mass end at 1/4.", "commands or thrusts were 1/4.", "would make it 1/4.448"),
        ),
        (0.1, "zero", ()),
    ],
)
def test_commands_off_by_a_factor_are_inconsistent_and_the_factor_is_named(
    table: Table, tmp_path: Path, told: float, start: str, words: tuple[str, ...]
) -> None:
    """Thrust and mass share a scale: the end is compared with the start, which claims nothing where it is zero."""
    record = written(tmp_path / "log.csv", scaled(table, jet=told))
    found = estimate(record, settings_of(tmp_path, start)).summary["consistency"]
    if not words:
        assert not any("the start" in reason for reason in found["reasons"])
        assert found["verdict"] == "consistent"
        return
    assert found["verdict"] == "inconsistent"
    assert all(part in found["reasons"][0] for part in words), found["reasons"]
    assert "of its sigmas off" in found["reasons"][0]


# ------------------------------------------------------------------- 08: readings off by a common factor

DEGREE = np.pi / 180.0


@pytest.mark.parametrize(
    ("sensor", "factor", "words", "by"),
    [
        ("gyro", DEGREE, "gyro: readings are 1/57.3 times what they should be: radians in place of degrees", "thesis"),
        (
            "gyro",
            1.0 / DEGREE,
            "gyro: readings are 57.3 times what they should be: degrees in place of radians",
            "joint",
        ),
        (
            "gyro",
            0.1,
            "gyro: readings are 1/10 times what they should be: increments of angle in place of rates",
            "thesis",
        ),
        (
            "gyro",
            10.0,
            "gyro: readings are 10 times what they should be: rates in place of increments of angle",
            "thesis",
        ),
        ("gyro", 1000.0, "gyro: readings are 1000 times what they should be", "joint"),
        ("gyro", 30.0 / np.pi, "gyro: readings are 9.549 times what they should be: rpm in place of rad/s", "thesis"),
        ("imu", 1.0 / 9.80665, "imu: readings are 1/9.807 times what they should be: g in place of m/s^2", "thesis"),
        ("imu", 9.80665, "imu: readings are 9.807 times what they should be: m/s^2 in place of g", "joint"),
        ("imu", 0.3048, "imu: readings are 1/3.281 times what they should be: meters in place of feet", "thesis"),
        ("imu", 1000.0, "imu: readings are 1000 times what they should be", "thesis"),
    ],
)
def test_a_common_factor_of_readings_is_the_first_reason(
    table: Table, tmp_path: Path, sensor: str, factor: float, words: str, by: str
) -> None:
    """Hindsight begins with what either filter ends at."""
    record = written(tmp_path / "log.csv", scaled(table, **{sensor: factor}))
    found = estimate(record, settings_of(tmp_path, by=by)).summary["consistency"]
    assert found["verdict"] == "inconsistent"
    assert found["reasons"][0] == words
    assert not any("wrong sign" in reason for reason in found["reasons"])


def test_an_axis_with_the_wrong_sign_is_still_told(table: Table, tmp_path: Path) -> None:
    turned = {**table, "gyro_y": [repr(-float(cell)) for cell in table["gyro_y"]]}
    found = estimate(written(tmp_path / "log.csv", turned), settings_of(tmp_path)).summary["consistency"]
    assert "gyro y has the wrong sign" in found["reasons"][0]


# ------------------------------------------------------------------- failures: what is known decides, and nothing else


def standing(run: Run) -> list[Any]:
    """Declarations that were not withdrawn."""
    return [one for one in run.summary["detections"] if one["withdrawn_s"] is None]


def test_a_jet_that_sticks_off_before_the_first_translation_is_named(tmp_path: Path) -> None:
    """02: after the turns inertia is known to a few tenths of a percent, and rotation alone shows ZP1.

    By other seeds it is first told from ZN1, on the same line, when it is not commanded any more.
    """
    turns = [*TURNS, *windows(("rhc", "-z", 13, 15))]
    failure = {"kind": "stuck_off", "jet": "ZP1", "start_s": 15.5}
    flight = {**SERVICER, "duration_s": 20, "seed": 5, "failures": [failure]}
    told = windows(("thc", "+z", 16, 19))
    run = simulate(scenario(tmp_path, {**flight, "maneuver": [*turns, *told]}))
    (injected,) = run.summary["injected"]
    assert injected["outcome"] == "named"
    assert injected["declared_s"] - injected["first_acted_s"] <= 1.0


FLYING = {**SERVICER, "seed": 3, "maneuver": [*TURNS, *TRANSLATIONS, *windows(("thc", "-x", 20.5, 22.5))]}


def told_at(table: Table, known: Callable[[Array], Array], jets: str = "") -> Table:
    """A record with no commands of jets whose names begin so where they are not known, by the rows' times."""
    there = known(np.array(table["time_s"], dtype=float)).tolist()
    return {
        name: [cell if told else "" for cell, told in zip(cells, there, strict=True)]
        if name.startswith(f"jet_{jets}")
        else cells
        for name, cells in table.items()
    }


def without(table: Table, there: Callable[[Array], Array]) -> Table:
    """A record without rows that are not there, by their times."""
    rows = np.flatnonzero(there(np.array(table["time_s"], dtype=float))).tolist()
    return {name: [cells[row] for row in rows] for name, cells in table.items()}


def row_numbers(time_s: Array) -> Array:
    return np.arange(time_s.size)


def ten(part: Mapping[str, Any]) -> Array:
    """The ten parameters, or their 1-sigma, of a summary."""
    inertia = np.array(part["inverse_inertia"])[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return np.array([*inertia, *part["center_of_mass"], part["mass_reciprocal"]])


UNKNOWN: dict[str, tuple[Callable[[Table], Table], str]] = {
    "ends": (
        lambda table: told_at(table, lambda time_s: time_s < 15.95),
        "commands unknown from 16 s on (45 of 206 samples)",
    ),
    "ends while jets fire": (
        lambda table: told_at(table, lambda time_s: time_s < 18.55),
        "commands unknown from 18.6 s on (19 of 206 samples)",
    ),
    "three seconds": (
        lambda table: told_at(table, lambda time_s: (time_s < 14.05) | (time_s > 17.05)),
        "commands unknown from 14.1 s to 17.1 s (30 of 206 samples)",
    ),
    "the beginning": (
        lambda table: told_at(table, lambda time_s: time_s > 2.05),
        "commands unknown from 0 s to 2.1 s (21 of 206 samples)",
    ),
    "all": (lambda table: told_at(table, lambda time_s: time_s < 0.0), "commands unknown from 0 s on (205 of 206"),
    "single rows": (
        lambda table: told_at(table, lambda time_s: row_numbers(time_s) % 17 != 8),
        "commands unknown from 0.8 s to 0.9 s, from 2.5 s to 2.6 s, ",
    ),
    "rows that are not there": (lambda table: without(table, lambda time_s: row_numbers(time_s) % 17 != 8), "gap"),
    "each second row": (
        lambda table: told_at(table, lambda time_s: row_numbers(time_s) % 2 == 0),
        "and 97 more times (102 of 206 samples)",
    ),
    "one jet": (
        lambda table: told_at(table, lambda time_s: time_s < 0.0, "YP1"),
        "commands of jet YP1 unknown from 0 s on (205 of 206 samples): not tested for failures there, and what they "
        "may have given teaches nothing",
    ),
    "two jets for a while": (
        lambda table: told_at(table, lambda time_s: (time_s < 14.05) | (time_s > 17.05), "ZN"),
        "commands of jets ZN1, ZN2 unknown from 14.1 s to 17.1 s (30 of 206 samples)",
    ),
    "with readings": (
        lambda table: {
            name: [*cells[:150], *[""] * 10, *cells[160:]] if name != "time_s" else cells
            for name, cells in table.items()
        },
        "commands unknown from 15 s to 16 s (10 of 206 samples)",
    ),
}


@pytest.mark.parametrize("kind", list(UNKNOWN))
def test_nothing_is_declared_where_commands_are_unknown(flown: Run, table: Table, tmp_path: Path, kind: str) -> None:
    """03: the jets go on, but what they are told is not known for a while; they are healthy."""
    change, said = UNKNOWN[kind]
    run = estimate(written(tmp_path / "log.csv", change(table)), scenario(tmp_path, {**SERVICER, "duration_s": 20.5}))
    assert run.summary["detections"] == []
    assert all(one["probability"] <= 0.01 for one in probable(run).values())
    off = ten(run.summary["estimates"]) - ten(flown.summary["truth"])
    np.testing.assert_array_less(np.abs(off), 3.0 * ten(run.summary["standard_deviations"]))
    warnings = " ".join(run.summary["data_quality"]["warnings"])
    assert said in warnings
    assert kind == "rows that are not there" or "not tested" in warnings


def probable(run: Run) -> dict[str, Any]:
    """Probabilities of the jets' failures."""
    return {jet: one for jet, one in run.summary["fault_probability"].items() if isinstance(one, Mapping)}


def test_what_is_learned_is_that_of_the_commands_that_are_known(table: Table, tmp_path: Path) -> None:
    """Without propellant used by nobody knows which jets, by which mass properties drift."""
    told = scenario(tmp_path, {**SERVICER, "duration_s": 20.5, "joint": {"tank_fraction": 0}})
    ended = estimate(written(tmp_path / "ended.csv", UNKNOWN["ends while jets fire"][0](table)), told)
    cut = estimate(written(tmp_path / "cut.csv", {name: cells[:187] for name, cells in table.items()}), told)
    (stretch,) = ended.summary["data_quality"]["unknown_commands"]
    assert len(stretch.pop("jets")) == 12
    assert stretch == {"from_s": pytest.approx(18.6), "to_s": pytest.approx(20.5), "samples": 19}
    for name in ("estimate", "standard_deviation"):
        np.testing.assert_array_equal(ended[name][:187], cut[name])
    assert (ended["standard_deviation"][-1] <= 1.001 * cut["standard_deviation"][-1]).all()


SOON = {"kind": "leak", "jet": "YN2", "start_s": 20.6, "force": 0.1}


@pytest.mark.parametrize(
    ("failure", "known"),
    [
        (SOON, lambda time_s: time_s < 22.95),
        ({**SOON, "start_s": 22.6}, lambda time_s: (time_s < 19) | (time_s > 22)),
        (SOON, lambda time_s: (time_s < 20.5) | (time_s > 22)),
        ({"kind": "stuck_on", "jet": "ZP1", "start_s": 22.6}, lambda time_s: row_numbers(time_s) % 17 != 8),
    ],
)
def test_failures_are_found_where_commands_are_known(
    failure: dict[str, Any], known: Callable[[Array], Array], tmp_path: Path
) -> None:
    """03: before the commands end, after they are there again, and while they were unknown."""
    flight = {**FLYING, "duration_s": 25.0, "failures": [failure]}
    table = recorded(simulate(scenario(tmp_path, flight, *AS_FLOWN), look_back=False), tmp_path / "run")
    run = estimate(written(tmp_path / "log.csv", told_at(table, known)), scenario(tmp_path, flight))
    (found,) = standing(run)
    assert found["jet"] == failure["jet"]


@pytest.mark.parametrize("period_s", [0.06, 0.25])
def test_unknown_commands_at_other_sample_periods(period_s: float, tmp_path: Path) -> None:
    flight, other = {**FLYING, "duration_s": 20.5}, f"vehicle.sample_period_s={period_s}"
    flown = simulate(scenario(tmp_path, flight, *AS_FLOWN, other), look_back=False)
    table = told_at(recorded(flown, tmp_path / "run"), lambda time_s: (time_s < 14.05) | (time_s > 17.05))
    run = estimate(written(tmp_path / "log.csv", table), scenario(tmp_path, flight, other))
    assert run.summary["detections"] == []
    assert all(one["probability"] <= 0.01 for one in probable(run).values())
    off = ten(run.summary["estimates"]) - ten(flown.summary["truth"])
    np.testing.assert_array_less(np.abs(off), 3.0 * ten(run.summary["standard_deviations"]))


def test_a_pulse_shorter_than_the_sample_period_lasts_as_long_as_it_says(tmp_path: Path) -> None:
    """15: pulses of 35 ms at a period of 100 ms, one from a sample's time on, one within a sample."""
    pulses = [("T1", 0.5, 0.535), ("T7", 1.02, 1.055), ("T9", 1.5, 2.0)]
    told = [dict(zip(("jet", "start_s", "end_s"), pulse, strict=True)) for pulse in pulses]
    run = simulate(scenario(tmp_path, {"vehicle": "client_servicer.yaml", "duration_s": 2.5, "jet_schedule": told}))
    on_s = dict(zip(run.scenario.vehicle_data.designations, run["command"].sum(axis=0) * 0.1, strict=True))
    assert {jet: pytest.approx(on_s[jet], abs=1e-9) for jet, _, _ in pulses} == {"T1": 0.035, "T7": 0.035, "T9": 0.5}


def test_a_leak_is_named_at_another_sample_period() -> None:
    """17: the orbiter at a quarter of its rate."""
    run = simulate(load_scenario("leak_named", [LOOP, "vehicle.sample_period_s=0.32"]))
    assert [one["jet"] for one in standing(run)] == ["L4D"]
    assert run.summary["consistency"]["verdict"] == "consistent"


def test_what_is_known_decides_and_not_how_often_jets_have_fired(tmp_path: Path) -> None:
    """20: thirteen pulses make the mass known to 1 %, then ZP1 leaks 5 % while nothing fires."""
    pulses = (
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
        "jet_schedule": [dict(zip(("jet", "start_s", "end_s"), pulse, strict=True)) for pulse in pulses],
        "failures": [{"kind": "leak", "jet": "ZP1", "start_s": 6.0, "force": 0.25}],
    }
    run = simulate(scenario(tmp_path, content))
    (found,) = standing(run)
    assert found["jet"] == "ZP1"
    assert found["time_s"] <= 7.0


# ------------------------------------------------------------------- 13: a further sensor


def tracked(folder: Path, *settings: str) -> Run:
    """A thruster leaks on a satellite that has a star tracker beside gyro and accelerometer."""
    content = {
        "vehicle": "client_servicer.yaml",
        "duration_s": 22.0,
        "seed": 1,
        "maneuver": [*TURNS, *TRANSLATIONS],
        "autopilot": {"discrete_rate": 0.0174532925, "acceleration": 0.008},
        "failures": [{"kind": "leak", "jet": "T7", "start_s": 16.0, "force": 0.1}],
    }
    return simulate(scenario(folder, content, "vehicle.poses=[{name: st, attitude_std: 5.0e-5}]", *settings))


def test_a_run_is_saved_whatever_a_detector_leaves_out(tmp_path: Path) -> None:
    """Of poses: its detector knows no biases, and has no jet to name."""
    run = tracked(tmp_path, "estimation.filter=pose")
    run.save(tmp_path / "run", pictures=False, report=False)
    again = Run.load(tmp_path / "run")
    assert "unexplained" in [event.kind for event in run.results.events]
    assert again.results.events == run.results.events
    assert again.plot.failure_magnitude() is not None


def test_a_further_sensor_makes_nothing_worse(tmp_path: Path) -> None:
    """Without the tracker the leak is named in a second or so."""
    (found,) = standing(tracked(tmp_path, "duration_s=19"))
    assert found["jet"] == "T7"
    assert found["time_s"] <= 18.0


# ------------------------------------------------------------------- 16: wheels

WHEELS = np.array([[0.707, 0.0, 0.707], [-0.707, 0.0, 0.707], [0.0, 0.707, 0.707], [0.0, -0.707, 0.707]])
SPIN = 0.005  # kg-m^2, of each wheel
INERTIA = np.array([[19.0, 0.5, -0.3], [0.5, 30.0, 0.6], [-0.3, 0.6, 33.0]])


def turned_by_wheels(period_s: float, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, rates and wheel speeds of a body that wheels alone turn; the coupling by steps of a twentieth."""
    steps, time_s = 20, period_s * np.arange(count)

    def speed(time: float) -> np.ndarray:
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


@pytest.mark.parametrize("seed", [1, 2])
def test_wheels_that_no_file_has_are_named(tmp_path: Path, seed: int) -> None:
    """Torques without a force are no leak; the accelerometer is at the center of mass and reads its noise alone."""
    time_s, rates, _ = turned_by_wheels(0.1, 300)
    random = np.random.default_rng(seed)
    columns = {"time_s": list(map(repr, time_s.tolist()))}
    for axis, name in enumerate("xyz"):
        noisy = rates[:, axis] + 1e-4 * random.standard_normal(time_s.size)
        columns[f"mems_{name}"] = [f"{value:.5f}" for value in noisy]
        columns[f"imu_{name}"] = [f"{value:.5f}" for value in 5e-5 * random.standard_normal(time_s.size)]
    columns |= {f"jet_T{number}": ["0"] * time_s.size for number in range(1, 13)}
    where = "vehicle.accelerometers[0].position=[0.02, 0.01, -0.01]"
    case = scenario(tmp_path, {"vehicle": "client_servicer.yaml"}, where, "detector.kind=off")
    reasons = estimate(written(tmp_path / "log.csv", columns), case).summary["consistency"]["reasons"]
    assert "unmodeled torques without a force, such as wheels whose speed changes" in reasons[0]


def wheels_alone(folder: Path, factor: float = 1.0) -> Any:
    """Estimate with four wheels in a pyramid, speeds to .1 rpm, the inertia of the second stated so many times."""
    time_s, rates, speeds = turned_by_wheels(0.1, 300)
    random = np.random.default_rng(16)
    columns = {"time_s": list(map(repr, time_s.tolist()))}
    for axis, name in enumerate("xyz"):
        noisy = rates[:, axis] + 1e-4 * random.standard_normal(time_s.size)
        columns[f"mems_{name}"] = [f"{value:.5f}" for value in noisy]
        columns[f"imu_{name}"] = [f"{value:.5f}" for value in 5e-5 * random.standard_normal(time_s.size)]
    columns |= {f"jet_T{number}": ["0"] * time_s.size for number in range(1, 13)}
    tick = 0.1 * np.pi / 30.0  # a tenth of a revolution a minute
    for wheel, column in enumerate(speeds.T):
        columns[f"RW{wheel + 1}_speed"] = [repr(tick * round(value / tick)) for value in column.tolist()]
    stated = [{"name": f"RW{n + 1}", "axis": axis, "inertia": SPIN} for n, axis in enumerate(WHEELS.tolist())]
    stated[1]["inertia"] = factor * SPIN
    case = scenario(folder, {"vehicle": "client_servicer.yaml"}, f"vehicle.wheels={json.dumps(stated)}")
    return estimate(written(folder / "log.csv", columns), case).summary


def test_wheels_that_are_in_the_vehicle_file_show_the_inertia(tmp_path: Path) -> None:
    """16: four wheels in a pyramid, speeds to .1 rpm."""
    found = wheels_alone(tmp_path)
    deviation = np.array(found["derived"]["inertia_std"])
    assert (np.abs(np.array(found["derived"]["inertia"]) - INERTIA) < 4.0 * deviation).all()
    assert (deviation.diagonal() < 0.05 * INERTIA.diagonal()).all()
    assert found["consistency"]["verdict"] == "consistent"


def test_a_wheel_whose_inertia_is_another_than_stated_is_named(tmp_path: Path) -> None:
    reasons = wheels_alone(tmp_path, 1.2)["consistency"]["reasons"]
    assert reasons[0].startswith("wheel RW2: its inertia is 0.83")
