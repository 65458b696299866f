"""Sensors at rates of their own: a step of the joint filter for every reading, from files, tables and in real time."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import Estimator, Run, estimate, load_vehicle, simulate
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.runners.recorded import estimation_settings

FAST, PERIOD = 0.025, 0.1
PULSES = [
    ("XP1", 0.3, 1.1),
    ("YN1", 0.6, 1.2),
    ("ZP2", 1.3, 1.9),
    ("XN2", 1.5, 2.1),
    ("YP2", 2.2, 2.8),
    ("ZN1", 2.4, 3.2),
]


def at_rates(vehicle: Vehicle, period_s: float) -> Vehicle:
    """The vehicle with a gyro at 40 Hz and an accelerometer at 10 Hz."""
    rates = {"gyros": 1.0 / FAST, "accelerometers": 10.0}
    parts: dict[str, Any] = {
        kind: tuple(one.model_copy(update={"rate_hz": rate}) for one in getattr(vehicle, kind))
        for kind, rate in rates.items()
    }
    return again(vehicle, sample_period_s=period_s, **parts)


def case(vehicle: Vehicle, **more: Any) -> Scenario:
    return resolve_scenario(
        {"name": "rates", "vehicle": vehicle, "duration_s": 3.5, "seed": 4, "detector": {"kind": "off"}}
        | {"execution": {"engine": "loop"}}
        | more
    )


@pytest.fixture(scope="module")
def servicer() -> Vehicle:
    return load_vehicle("servicer")


@pytest.fixture(scope="module")
def flown(servicer: Vehicle) -> Run:
    """A flight whose readings are at 40 Hz, with jets that switch at tenths of a second."""
    inertia = [[56.0, -0.8, 1.0], [-0.8, 24.0, -0.5], [1.0, -0.5, 51.0]]
    truth = {"mass": 170.0, "center_of_mass": [0.04, 0.015, -0.02], "inertia": inertia}
    pulses = [{"jet": jet, "start_s": start_s, "end_s": end_s} for jet, start_s, end_s in PULSES]
    fast = again(servicer, sample_period_s=FAST)
    return simulate(case(fast, jet_schedule=pulses, plant={"mass_properties": truth}), look_back=False)


def written(path: Path, columns: dict[str, Array], rows: Array) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        table = np.column_stack(list(columns.values()))[rows]
        writer.writerows([["" if np.isnan(cell) else repr(float(cell)) for cell in row] for row in table])
    return path


def parts_of(run: Run, vehicle: Vehicle) -> dict[str, dict[str, Array]]:
    """Columns of a gyro at 40 Hz, an accelerometer and jets at 10 Hz, empty where nothing is read or told."""
    signals, every = run.signals, round(PERIOD / FAST)
    slow = np.arange(len(signals["time_s"])) % every == 0
    time_s = {"time_s": np.round(signals["time_s"], 9)}
    rates = {f"gyro_{axis}": signals["gyro"][:, place] for place, axis in enumerate("xyz")}
    read = {f"acc_{axis}": np.where(slow, signals["acc"][:, place], np.nan) for place, axis in enumerate("xyz")}
    told = {
        f"jet_{jet}": np.where(slow, signals["command"][:, place], np.nan)
        for place, jet in enumerate(vehicle.designations)
    }
    return {"gyro": time_s | rates, "acc": time_s | read, "jets": time_s | told}


def test_several_files_give_what_one_table_gives(flown: Run, servicer: Vehicle, tmp_path: Path) -> None:
    parts, slowly = parts_of(flown, servicer), at_rates(servicer, PERIOD)
    every = np.arange(len(flown.signals["time_s"]))
    slow = every[:: round(PERIOD / FAST)]
    files = [
        written(tmp_path / f"{name}.csv", columns, every if name == "gyro" else slow) for name, columns in parts.items()
    ]
    table = written(tmp_path / "all.csv", parts["gyro"] | parts["acc"] | parts["jets"], every)
    one, several = estimate(table, case(slowly)), estimate(files, case(servicer))  # the record tells its rates itself
    np.testing.assert_array_equal(one.signals["estimate"], several.signals["estimate"])
    assert several.summary["data_quality"]["warnings"] == []
    assert len(one.signals["time_s"]) == every.size
    estimates, truth = one.signals["estimate"], np.array(flown.results.truth)
    off = (estimates[-1] - truth) / one.signals["standard_deviation"][-1]
    assert (np.abs(off) < 3.5).all()
    turned = one.signals["standard_deviation"][-1] / one.signals["standard_deviation"][0]
    assert (turned[[0, 1, 2, 9]] < 0.5).all()


def fed(estimator: Estimator, run: Run, between: int) -> Estimator:
    """The estimator after all samples of a run at 10 Hz, with calls in between that read nothing."""
    signals = run.signals
    for row, time_s in enumerate(signals["time_s"].tolist()):
        estimator.step(time_s, signals["gyro"][row], signals["acc"][row], signals["command"][row])
        for part in range(1, between + 1):
            estimator.step(time_s + PERIOD * part / (between + 1))
    return estimator


def test_calls_that_read_nothing_lose_and_gain_nothing(servicer: Vehicle) -> None:
    pulses = [{"jet": jet, "start_s": start_s, "end_s": end_s} for jet, start_s, end_s in PULSES]
    truth = {
        "mass": 172.0,
        "center_of_mass": [0.03, 0.01, -0.015],
        "inertia": [[54.0, -0.6, 0.8], [-0.6, 25.0, -0.4], [0.8, -0.4, 53.0]],
    }
    run = simulate(case(servicer, jet_schedule=pulses, plant={"mass_properties": truth}), look_back=False)
    settings = estimation_settings(case(at_rates(servicer, PERIOD)))
    plain, cut = (fed(Estimator(settings.vehicle_data, settings), run, between) for between in (0, 2))
    sigma = np.sqrt(np.diag(plain.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(cut.covariance)), sigma, rtol=0.02)
    ends = [estimator.nearest_possible() for estimator in (plain, cut)]
    assert ends[0] is not None
    assert ends[1] is not None
    assert (np.abs(ends[1] - ends[0]) < 0.1 * sigma).all()
