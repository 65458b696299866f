"""`massprop map` and `massprop estimate --map`: what is shown, what is written, and one message for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Massprop
from record_probe import Flight, flight, px4_topics, usual_columns, usual_map, write_csv, write_ulog
from record_probe import flown as followed

from massprop_drake import load_scenario, simulate
from massprop_drake.display.run import Run
from massprop_drake.inputs.vehicle_file import load_vehicle

FREE_FLYER = ("--vehicle", "free_flyer")


@pytest.fixture(scope="module")
def one() -> Flight:
    return flight(load_vehicle("free_flyer"))


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(load_scenario("free_flyer_maneuver", ["duration_s=3", "execution={engine: loop}"]))


def in_other_words(flown: Run, path: Path) -> tuple[Path, Path]:
    """The run's telemetry as another program would have it: deg/s, mm/s, other axes, ms, a bit mask, and its map."""
    columns = {
        "Time [ms]": 1e3 * flown.time_s,
        **{f"rate {axis}": np.degrees(flown["gyro"][:, place]) for axis, place in (("roll", 0), ("yaw", 2))},
        "rate pitch": -np.degrees(flown["gyro"][:, 1]),
        **{f"dv{axis}": 1e3 * flown["acc"][:, place] for place, axis in enumerate("XYZ")},
        "valves": np.nan_to_num(flown["command"]) @ 2 ** np.arange(12),
    }
    columns["valves"] = [*map(str, columns["valves"][:-1].astype(int)), ""]
    bits = ", ".join(f"{jet}: {bit}" for bit, jet in enumerate(load_vehicle("free_flyer").designations))
    (path / "map.yaml").write_text(
        "time: {column: 'Time [ms]', unit: ms}\n"
        "sensors:\n"
        "  gyro: {kind: gyro, columns: [rate roll, rate pitch, rate yaw], unit: deg/s, axes: [x, -y, z]}\n"
        "  acc: {kind: accelerometer, gives: integral, columns: [dvX, dvY, dvZ], unit: mm/s}\n"
        f"commands: {{mask: {{column: valves, bits: {{{bits}}}}}}}\n",
        encoding="utf-8",
    )
    return write_csv(path / "log.csv", columns), path / "map.yaml"


def test_a_mapped_record_gives_the_runs_own_estimates(massprop: Massprop, flown: Run, tmp_path: Path) -> None:
    log, by = in_other_words(flown, tmp_path)
    flown.save(tmp_path / "run", pictures=False, report=False)
    done = massprop("estimate", log, "--map", by, "--like", tmp_path / "run", "--json", "--no-report")
    assert done.status == 0, done.err
    found, own = json.loads(done.out), flown.summary
    np.testing.assert_allclose(
        found["estimates"]["inverse_inertia"], own["estimates"]["inverse_inertia"], rtol=1e-7, atol=1e-6
    )
    assert found["estimates"]["mass_reciprocal"] == pytest.approx(own["estimates"]["mass_reciprocal"], rel=1e-9)
    assert found["data_quality"]["rows"] == len(flown.time_s)


def test_a_map_is_proposed_shown_written_and_checked(massprop: Massprop, one: Flight, tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", usual_columns(one))
    done = massprop("map", log, *FREE_FLYER, "--out", "map.yaml")
    assert done.status == 0
    assert done.out.startswith("# Proposed for log.csv and vehicle free_flyer. Why it is so:\n# - time: column t")
    assert "the first rows as they are understood" in done.out
    assert all(f"gyro {axis} rad/s" in done.out for axis in "xyz")
    found = json.loads(massprop("map", log, *FREE_FLYER, "--json").out)
    assert set(found) == {"map", "reasons", "lacking", "left_out", "rows", "notes"}
    assert found["rows"][1]["sensors"]["gyro"]["x"] == pytest.approx(one.rates[1, 0])
    assert "jets open" in done.out
    about = "map.yaml: ok: map of a record, gyro 'gyro', velocity 'velocity', commands of 12 jets\n"
    assert massprop("check", "map.yaml").out == about
    shown = massprop("map", log, *FREE_FLYER, "--map", "map.yaml")
    assert shown.out.startswith("gyro: the rates follow the commands with a correlation of 0.07 (x 0.16, ")
    assert "\nthe first rows as they are understood" in shown.out
    again = massprop("map", log, *FREE_FLYER, "--out", "map.yaml")
    assert again.status == 0, again.err
    by = Path("map.yaml")
    by.write_text(by.read_text(encoding="utf-8").replace("column: t", "column:  t"), encoding="utf-8")
    again = massprop("map", log, *FREE_FLYER, "--out", "map.yaml")
    assert again.status == 2
    assert "map.yaml: is there already, and not as we wrote it" in again.err


def test_axes_are_judged_before_units_are_refused(massprop: Massprop, tmp_path: Path) -> None:
    one = followed(load_vehicle("free_flyer"), 1)
    rates = {f"w{axis}": 1e3 * np.degrees(one.rates[:, index]) for index, axis in enumerate("xyz")}
    log = write_csv(tmp_path / "log.csv", usual_columns(one) | rates)
    gyro = "{kind: gyro, columns: [wx, wy, wz], unit: deg/s, axes: [x, -y, -z]}"
    (tmp_path / "map.yaml").write_text(usual_map(one, gyro=gyro), encoding="utf-8")
    done = massprop("map", log, *FREE_FLYER, "--map", tmp_path / "map.yaml")
    assert (done.status, done.out) == (2, "acc: the readings follow the commands with a correlation of 0.99\n")
    warning, refusal = done.err.splitlines()
    assert "warning: gyro: the rates go against what the jets should do" in warning
    assert "(x 1.00, y -1.00, z -1.00)" in warning
    assert refusal.endswith("a unit 1000 times smaller would fit: `unit: mdeg/s`")


def test_what_is_not_found_ends_with_2_after_what_is(massprop: Massprop, tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", {"t": [0.0, 0.05, 0.1], "wx": [1, 2, 3], "wy": [1, 2, 3], "wz": [1, 2, 3]})
    done = massprop("map", log, *FREE_FLYER)
    assert done.status == 2
    assert "# What is to be filled in:" in done.out
    assert done.err.count("\n") == 1
    assert "no commands were found" in done.err


def test_a_vehicle_and_a_map_of_a_px4_log(massprop: Massprop, one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    parameters: dict[str, Any] = {"CA_THRUSTER_CNT": 2}
    for index, sign in enumerate((1.0, -1.0)):
        parameters |= {f"CA_THRUSTER{index}_PY": 0.1 * sign, f"CA_THRUSTER{index}_CT": 1.0}
        parameters |= {f"CA_THRUSTER{index}_AX": sign, f"CA_THRUSTER{index}_AZ": 0.0}
    log = write_ulog(tmp_path / "log.ulg", px4_topics(one), parameters)
    made = massprop("map", log, "--make-vehicle", "box.yaml", "--mass", "15", "--inertia", "0.2,0.2,0.3")
    assert (made.status, made.out) == (0, "box.yaml: 2 thrusters; what is assumed stands at its beginning\n")
    assert massprop("check", "box.yaml", "--quiet").status == 0
    done = massprop("map", log, "--vehicle", "box.yaml", "--out", "map.yaml")
    assert done.status == 0
    assert "actuator_motors, control[0] the vehicle's first jet" in done.out
    done = massprop("estimate", log, "--vehicle", "box.yaml", "--map", "map.yaml", "--quiet", "--no-report")
    assert (done.status, done.err) == (0, "")
    assert "PX4 logs neither mass nor inertia" in massprop("map", log, "--make-vehicle", "other.yaml").err
    assert (
        "--inertia 1,2: must be three numbers"
        in massprop("map", log, "--make-vehicle", "other.yaml", "--mass", "1", "--inertia", "1,2").err
    )


# ------------------------------------------------------------------- one message, exit status 2


def test_bad_input_is_one_message(massprop: Massprop, one: Flight, tmp_path: Path) -> None:
    usual = usual_columns(one)
    log = write_csv(tmp_path / "log.csv", usual)
    fast = write_csv(tmp_path / "fast.csv", usual | {"wx": np.full(60, 400.0)})
    back = write_csv(tmp_path / "back.csv", usual | {"t": np.where(np.arange(60) < 30, one.time_s, one.time_s - 1.0)})
    empty = write_csv(tmp_path / "empty.csv", {name: [] for name in usual})
    text = usual_map(one)
    maps = {
        "good": text,
        "topic": "topic: imu\n" + text,
        "kind": text.replace("kind: gyro", "kind: gyros"),
        "unit": text.replace("kind: gyro,", "kind: gyro, unit: mm,"),
        "column": text.replace("wx", "w_x"),
        "jet": text.replace("T3:", "T33:"),
        "key": text.replace("columns: [wx", "column: [wx"),
        "yaml": text + "  - [",
    }
    for name, content in maps.items():
        (tmp_path / f"{name}.yaml").write_text(content, encoding="utf-8")
    cases = {
        (log, "kind"): "kind.yaml, line 3: sensors.gyro: kind 'gyros' is not one of gyro, accelerometer, velocity, ",
        (log, "unit"): "unit.yaml, line 3: sensors.gyro.unit: 'mm' is a unit of length; expected one of rate",
        (log, "column"): "log.csv: no column 'w_x'",
        (log, "jet"): "jet.yaml: commands: 'T33' is no jet of vehicle 'free_flyer'",
        (log, "key"): "key.yaml, line 3: sensors.gyro.column: unknown key; did you mean 'columns'?",
        (log, "yaml"): "yaml.yaml: not valid YAML",
        (log, "topic"): "log.csv: is a table without topics, and the map names topic 'imu'",
        (log, "none"): "none.yaml: no such file",
        (fast, "good"): "fast.csv: sensor 'gyro' turns at up to 400 rad/s as rad/s, more than half a turn in a sample",
        (back, "good"): "back.csv, line 32: time goes back, from 1.45 to 0.5 s",
        (empty, "good"): "empty.csv: is empty: it has no row of data",
    }
    for (record, name), said in cases.items():
        done = massprop("estimate", record, *FREE_FLYER, "--map", tmp_path / f"{name}.yaml")
        assert (done.status, done.out) == (2, ""), name
        assert done.err.count("\n") == 1, done.err
        assert said in done.err, done.err
    done = massprop("estimate", "-", *FREE_FLYER, "--map", tmp_path / "good.yaml")
    assert (done.status, done.err.count("\n")) == (2, 1)
