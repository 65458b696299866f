"""Rows that come whenever anything is read: commands that hold, readings that lack, integrals of their own."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import InputError, load_vehicle
from massprop_drake.inputs.vehicle_file import Vehicle, times_per_s
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import continued, pieces
from massprop_drake.records.control_rows import Thinning
from massprop_drake.records.reader import Reader, Rows

PERIOD = 0.1  # of the servicer


@pytest.fixture(scope="module")
def servicer() -> Vehicle:
    return load_vehicle("servicer")


def written(path: Path, vehicle: Vehicle, cells: dict[float, dict[str, float]]) -> Path:
    """A table with a row for every time, and cells empty where nothing is said of a column."""
    names = ["time_s", *(f"{name}_{axis}" for name in ("gyro", "acc") for axis in "xyz")]
    names += [name for name in ("known_torque_x", "known_torque_y", "known_torque_z", "acc_accel_x") if name in cells]
    names += [f"jet_{jet}" for jet in vehicle.designations]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({"time_s": repr(time), **row} for time, row in cells.items())
    return path


def gyro(value: float) -> dict[str, float]:
    return {f"gyro_{axis}": value for axis in "xyz"}


def jets(vehicle: Vehicle, **on: float) -> dict[str, float]:
    return {f"jet_{jet}": on.get(jet, 0.0) for jet in vehicle.designations}


def read(path: Path, vehicle: Vehicle) -> tuple[Rows, Reader]:
    reader = Reader(path, vehicle, gyro="gyro")
    reader.own_times = True
    (block,) = list(reader)
    return block, reader


def test_commands_hold_in_rows_that_have_none_for_about_a_period(servicer: Vehicle, tmp_path: Path) -> None:
    cells = {0.0: gyro(0.0) | jets(servicer, XP1=1.0), **{0.02 * k: gyro(0.0) for k in range(1, 9)}}
    rows, _ = read(written(tmp_path / "log.csv", servicer, cells), servicer)
    column = servicer.designations.index("XP1")
    np.testing.assert_array_equal(rows.commands[:6, column], 1.0)
    assert np.isnan(rows.commands[6:]).all()  # 0.12 s and later: not known
    np.testing.assert_array_equal(rows.told, [True] + [False] * 8)


def test_a_command_that_is_told_replaces_the_one_that_holds(servicer: Vehicle, tmp_path: Path) -> None:
    cells = {
        0.0: gyro(0.0) | jets(servicer, XP1=1.0),
        0.05: gyro(0.0),
        0.07: jets(servicer, XP2=1.0),
        0.10: gyro(0.0),
    }
    rows, _ = read(written(tmp_path / "log.csv", servicer, cells), servicer)
    columns = [servicer.designations.index(name) for name in ("XP1", "XP2")]
    np.testing.assert_array_equal(rows.commands[:, columns], [[1, 0], [1, 0], [0, 1], [0, 1]])


def test_rows_without_commands_at_several_times_a_sample_are_found(servicer: Vehicle, tmp_path: Path) -> None:
    mixed = {0.02 * k: gyro(0.0) | (jets(servicer) if k % 5 == 0 else {}) for k in range(100)}
    reader = Reader(written(tmp_path / "mixed.csv", servicer, mixed), servicer, gyro="gyro")
    assert reader.readings_per_s() == pytest.approx(50.0)
    reader.own_times = True
    assert sum(rows.time_s.size for rows in reader) == 100  # the block that was looked at is read as ever
    plain = {0.1 * k: gyro(0.0) | (jets(servicer) if k != 7 else {}) for k in range(30)}
    regular = Reader(written(tmp_path / "plain.csv", servicer, plain), servicer, gyro="gyro")
    assert regular.readings_per_s() is None
    regular.close()


def test_faster_rows_that_all_have_commands_are_refused_as_before(servicer: Vehicle, tmp_path: Path) -> None:
    cells = {0.02 * k: gyro(0.0) | jets(servicer) for k in range(40)}
    reader = Reader(written(tmp_path / "log.csv", servicer, cells), servicer, gyro="gyro")
    assert reader.readings_per_s() is None
    with pytest.raises(InputError, match=r"rows are 0\.02 s apart"):
        list(reader)


def test_times_in_another_unit_are_refused(servicer: Vehicle, tmp_path: Path) -> None:
    cells = {20.0 * k: gyro(0.0) | jets(servicer) for k in range(40)}
    with pytest.raises(InputError, match=r"rows are 20 s apart"):
        read(written(tmp_path / "log.csv", servicer, cells), servicer)


def test_readings_lack_by_their_own_cadence(servicer: Vehicle, tmp_path: Path) -> None:
    cells = {0.02 * k: gyro(0.0) | (jets(servicer) if k % 5 == 0 else {}) for k in range(200)}
    for k in range(0, 200, 5):
        cells[0.02 * k] |= {f"acc_{axis}": 0.0 for axis in "xyz"}
    for lost in (50, 51, 52, 100):
        cells[0.02 * lost] = {name: value for name, value in cells[0.02 * lost].items() if "gyro" not in name}
    _, reader = read(written(tmp_path / "log.csv", servicer, cells), servicer)
    assert reader.record.missing == {"gyro": 4, "acc": 0}


def test_an_on_time_goes_on_within_its_sample() -> None:
    command, onset_s = np.array([0.5, 0.2, 1.0, 0.0, 0.4, np.nan]), np.array([0.02, 0.0, 0.0, np.nan, np.nan, np.nan])
    edges = np.linspace(0.0, PERIOD, 6)
    given = np.zeros(6)
    for since, until in pairwise(edges.tolist()):
        left, opens = continued(command[None], onset_s[None], np.array([since]), PERIOD)
        lengths, levels = pieces(left[0], opens[0], PERIOD, (0.0, until - since))
        given += lengths @ levels
    np.testing.assert_allclose(given, command * PERIOD, rtol=0.0, atol=1e-12)  # a level of 0.4 gives as much as before


def test_thinned_rows_are_those_with_commands_a_period_apart() -> None:
    n = 21
    times, told = 0.02 * np.arange(n), np.arange(n) % 5 == 0
    rates: Array = np.zeros((n, 3))
    rows = Rows(times, {"gyro": rates}, np.zeros((n, 1)), None, np.ones(n, dtype=bool), told=told)
    chosen, signals = Thinning(PERIOD, ["gyro"]).of(rows, {"alarm": np.arange(n)[:, None]})
    np.testing.assert_allclose(chosen.time_s, [0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(signals["alarm"][:, 0], [0, 5, 10, 15, 20])


def test_times_of_several_rates_are_counted_once(servicer: Vehicle) -> None:
    assert times_per_s([10.0, 50.0]) == 50.0
    assert times_per_s([10.0, 50.0, 4.0]) == 52.0  # every other of the 4 falls between
    sensors = tuple(one.model_copy(update={"rate_hz": 50.0}) for one in servicer.gyros)
    assert not servicer.has_own_rates
    assert again(servicer, gyros=sensors).readings_per_s == 50.0
