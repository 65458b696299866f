"""Diagnoses of drawn vehicles: a lag or a delay that the file has wrong, and wheels that it does not have."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Scenario, estimate, load_scenario, simulate

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
KEPT = ("plant.lag_factor=1", "detector.kind=off", "duration_s=30")


@pytest.fixture(scope="module", autouse=True)
def _flights() -> Iterator[None]:
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


def drawn(folder: Path, number: int, *settings: str) -> Scenario:
    """A healthy flight of a vehicle of its own."""
    from flights import vehicles  # noqa: PLC0415 (beside the tests, see `_flights`)

    flight = vehicles.vehicle(np.random.default_rng([number, 7]), number, happens="healthy")
    (folder / "vehicle.yaml").write_text(json.dumps(flight.vehicle))
    (folder / "scenario.yaml").write_text(json.dumps({**flight.scenario, "vehicle": "vehicle.yaml"}))
    return load_scenario(folder / "scenario.yaml", [*flight.settings, *KEPT, *settings])


@pytest.mark.parametrize(("number", "factor"), [(2, 0.0), (5, 3.0)])
def test_a_lag_that_the_file_has_wrong_is_named_and_found(tmp_path: Path, number: int, factor: float) -> None:
    """Tests lags of nothing or three times the stated one; the estimates do not suffer."""
    none = ("plant.thrust_transient=none", "joint.thrust_transient=vehicle")
    run = simulate(drawn(tmp_path, number, *(none if factor == 0.0 else (f"plant.lag_factor={factor}",))))
    (kind,) = run.scenario.vehicle_data.jet_kinds.values()
    reason = run.summary["consistency"]["reasons"][0]
    told = 1e3 * kind.time_constant_s
    found = float(reason.removeprefix("lag wrong: thruster jets build up with ").split(" ms")[0])
    assert found == pytest.approx(factor * told, abs=0.05 * told)
    assert reason.endswith(f"told {told:.3g} ms")
    assert np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max() < 3.5


def test_commands_that_are_logged_a_sample_off_are_named_and_one_row_that_is_off_is_no_delay(tmp_path: Path) -> None:
    scenario = drawn(tmp_path, 2)
    run = simulate(scenario)
    assert run.summary["consistency"]["verdict"] == "consistent"
    run.save(tmp_path / "run", pictures=False, report=False)
    with (tmp_path / "run" / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    jets = [place for place, name in enumerate(header) if name.startswith("jet_")]
    gyros = [place for place, name in enumerate(header) if name.startswith("gyro")]
    period_ms = 1e3 * scenario.vehicle_data.sample_period_s
    for shift, words in ((1, "later"), (-1, "earlier"), (0, "")):
        moved = [list(row) for row in rows]
        for place, row in enumerate(moved):
            for jet in jets:
                row[jet] = rows[min(max(place + shift, 0), len(rows) - 1)][jet]
        for place in gyros if shift == 0 else ():
            moved[-1][place] = repr(float(rows[-1][place]) + 0.1)
        with (tmp_path / "log.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([header, *moved])
        found = estimate(tmp_path / "log.csv", scenario).summary["consistency"]
        if shift == 0:
            assert "delay" not in [one["kind"] for one in found["diagnoses"]]
        else:
            told = f"delay wrong: commands act {period_ms:.3g} ms {words} than they are logged"
            assert found["reasons"][0].startswith(told)
