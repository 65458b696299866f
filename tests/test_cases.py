"""Small inputs from reports of users of such tools, and the right answer to each."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run, Scenario, estimate, load_scenario, simulate

VEHICLES = Path(__file__).parent / "data" / "cases"
LOOP = "execution.engine=loop"
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


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Twenty seconds of turns and translations of a healthy 432 kg satellite whose file says 400 kg."""
    folder = tmp_path_factory.mktemp("flown")
    return simulate(
        scenario(
            folder,
            {**SERVICER, "duration_s": 20.5, "seed": 3, "maneuver": [*TURNS, *TRANSLATIONS]},
            "detector.kind=off",
        )
    )


@pytest.fixture(scope="module")
def table(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Its record, by columns."""
    folder = tmp_path_factory.mktemp("table") / "run"
    flown.save(folder, pictures=False, report=False)
    with (folder / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, map(list, zip(*rows, strict=True)), strict=True))


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


def settings_of(run: Run, start: str = "nominal") -> Scenario:
    """The scenario that a record of a run is estimated with."""
    estimation = run.scenario.estimation.model_copy(update={"start": start})
    without = run.scenario.detector.model_copy(update={"kind": "off"})  # verdicts need none, and it takes long
    return run.scenario.model_copy(update={"estimation": estimation, "detector": without})


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
    flown: Run, table: Table, tmp_path: Path, told: float, start: str, words: tuple[str, ...]
) -> None:
    """Thrust and mass share a scale: the end is compared with the start, which claims nothing where it is zero."""
    record = written(tmp_path / "log.csv", scaled(table, jet=told))
    found = estimate(record, settings_of(flown, start)).summary["consistency"]
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
    ("sensor", "factor", "words"),
    [
        ("gyro", DEGREE, "gyro: readings are 1/57.3 times what they should be: radians in place of degrees"),
        ("gyro", 1.0 / DEGREE, "gyro: readings are 57.3 times what they should be: degrees in place of radians"),
        ("gyro", 0.1, "gyro: readings are 1/10 times what they should be: increments of angle in place of rates"),
        ("gyro", 10.0, "gyro: readings are 10 times what they should be: rates in place of increments of angle"),
        ("gyro", 1000.0, "gyro: readings are 1000 times what they should be"),
        ("gyro", 30.0 / np.pi, "gyro: readings are 9.549 times what they should be: rpm in place of rad/s"),
        ("imu", 1.0 / 9.80665, "imu: readings are 1/9.807 times what they should be: g in place of m/s^2"),
        ("imu", 9.80665, "imu: readings are 9.807 times what they should be: m/s^2 in place of g"),
        ("imu", 0.3048, "imu: readings are 1/3.281 times what they should be: meters in place of feet"),
        ("imu", 1000.0, "imu: readings are 1000 times what they should be"),
    ],
)
def test_a_common_factor_of_readings_is_the_first_reason(
    flown: Run, table: Table, tmp_path: Path, sensor: str, factor: float, words: str
) -> None:
    record = written(tmp_path / "log.csv", scaled(table, **{sensor: factor}))
    found = estimate(record, settings_of(flown)).summary["consistency"]
    assert found["verdict"] == "inconsistent"
    assert found["reasons"][0] == words
    assert not any("wrong sign" in reason for reason in found["reasons"])


def test_an_axis_with_the_wrong_sign_is_still_told(flown: Run, table: Table, tmp_path: Path) -> None:
    turned = {**table, "gyro_y": [repr(-float(cell)) for cell in table["gyro_y"]]}
    found = estimate(written(tmp_path / "log.csv", turned), settings_of(flown)).summary["consistency"]
    assert "gyro y has the wrong sign" in found["reasons"][0]
