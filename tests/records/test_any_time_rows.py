"""Rows of vehicles that are followed in a fixed frame: at any time, with gaps, with cells that are missing."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import InputError, estimate, load_vehicle
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Accelerometer, Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.reader import Reader, Rows, columns, write_csv

PERIOD = 0.1  # of the tracked flyer


@pytest.fixture
def flyer() -> Vehicle:
    return load_vehicle("tracked_flyer")


def table(times: Array, vehicle: Vehicle) -> Array:
    """Numbers that have nothing in common, with a quaternion that is one."""
    random = np.random.default_rng(3)
    values = random.standard_normal((times.size, len(columns(vehicle))))
    values[:, 0] = times
    values[:, 4:8] = 1.0, 0.0, 0.0, 0.0
    values[:, -12:] = random.random((times.size, 12)) < 0.3
    return values


def written(path: Path, values: Array, vehicle: Vehicle, names: list[str] | None = None) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names or columns(vehicle))
        writer.writerows([["" if np.isnan(cell) else repr(float(cell)) for cell in row] for row in values])
    return path


def read(path: Path, vehicle: Vehicle) -> tuple[Rows, Reader]:
    reader = Reader(path, vehicle, gyro=None)
    blocks = list(reader)
    reader.close()
    assert len(blocks) == 1
    return blocks[0], reader


def test_rows_may_come_at_any_time(flyer: Vehicle, tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    times = 17.0 + np.cumsum(random.uniform(0.01, 0.2, 50))
    values = table(times, flyer)
    rows, reader = read(written(tmp_path / "log.csv", values, flyer), flyer)
    np.testing.assert_array_equal(rows.time_s, times)
    np.testing.assert_array_equal(rows.tracked, values[:, 1:8])
    np.testing.assert_array_equal(rows.commands, values[:, 8:])
    assert reader.record.gaps == 0


def test_more_than_two_and_a_half_periods_without_a_row_are_a_gap(flyer: Vehicle, tmp_path: Path) -> None:
    for step, gaps in ((0.24, 0), (0.26, 1), (3.0, 1)):
        times = np.array([0.0, 0.1, 0.2, 0.2 + step, 0.3 + step])
        rows, reader = read(written(tmp_path / "log.csv", table(times, flyer), flyer), flyer)
        assert reader.record.gaps == gaps
        assert rows.time_s.size == 5 + gaps
        if gaps:
            filled = int(np.flatnonzero(~rows.recorded)[0])
            assert rows.time_s[filled] == pytest.approx(0.2 + min(PERIOD, 0.5 * step))
            assert rows.tracked is not None
            assert np.isnan(rows.tracked[filled]).all()
            assert np.isnan(rows.commands[filled]).all()


def test_time_that_stands_still_or_goes_back_is_left_out_and_counted(flyer: Vehicle, tmp_path: Path) -> None:
    times = np.array([0.0, 0.1, 0.1, 0.05, 0.2])
    rows, reader = read(written(tmp_path / "log.csv", table(times, flyer), flyer), flyer)
    np.testing.assert_array_equal(rows.time_s, [0.0, 0.1, 0.2])
    assert (reader.record.duplicates, reader.record.backward) == (1, 1)


def test_cells_that_are_missing_are_nothing_read(flyer: Vehicle, tmp_path: Path) -> None:
    values = table(0.1 * np.arange(6), flyer)
    values[2, 1:4] = np.nan
    values[3, 5] = np.nan
    rows, _ = read(written(tmp_path / "log.csv", values, flyer), flyer)
    np.testing.assert_array_equal(rows.tracked, values[:, 1:8])


def test_columns_of_position_alone_are_enough_to_read(flyer: Vehicle, tmp_path: Path) -> None:
    values = table(0.1 * np.arange(6), flyer)
    kept = [place for place, name in enumerate(columns(flyer)) if "_q" not in name]
    names = [columns(flyer)[place] for place in kept]
    rows, _ = read(written(tmp_path / "log.csv", values[:, kept], flyer, names), flyer)
    assert rows.tracked is not None
    np.testing.assert_array_equal(rows.tracked[:, :3], values[:, 1:4])
    assert np.isnan(rows.tracked[:, 3:]).all()


def test_what_is_written_is_read_again(flyer: Vehicle, tmp_path: Path) -> None:
    values = table(np.array([0.0, 0.07, 0.19, 0.31]), flyer)
    values[1, 1:4] = np.nan
    rows, _ = read(written(tmp_path / "log.csv", values, flyer), flyer)
    write_csv(tmp_path / "again.csv", flyer, [rows])
    back, _ = read(tmp_path / "again.csv", flyer)
    for one, other in zip(rows, back, strict=True):
        np.testing.assert_array_equal(one, other)


def test_accelerations_are_integrated_over_what_has_passed(tmp_path: Path) -> None:
    acc = Accelerometer(name="acc", position=(0, 0, 0), quantum=0.0, noise_std=1e-3)
    vehicle = again(load_vehicle("tracked_flyer"), accelerometers=(acc,))
    names = [name.replace("acc_", "acc_accel_") for name in columns(vehicle)]
    times = np.array([0.0, 0.05, 0.2])
    values = np.zeros((3, len(names)))
    values[:, 0] = times
    first = names.index("acc_accel_x")
    values[:, first] = 1.0, 2.0, 4.0
    rows, _ = read(written(tmp_path / "log.csv", values, vehicle, names), vehicle)
    np.testing.assert_allclose(rows.readings["acc"][:, 0], [0.1, 0.2, 0.8], rtol=1e-12)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"known_force_x": 0.0}, "has column 'known_force_x' but not all of known_force_x, _y, _z"),
        ({"jet_T3": None}, "no column jet_T3"),
    ],
)
def test_columns_that_cannot_be_are_refused(
    changed: dict[str, Any], message: str, flyer: Vehicle, tmp_path: Path
) -> None:
    values = dict(zip(columns(flyer), table(0.1 * np.arange(5), flyer).T, strict=True))
    for name, value in changed.items():
        if value is None:
            del values[name]
        else:
            values[name] = np.full(5, value)
    path = written(tmp_path / "log.csv", np.column_stack(list(values.values())), flyer, list(values))
    with pytest.raises(InputError, match=message):
        read(path, flyer)


def test_a_record_without_any_sensor_says_which_columns_it_lacks(flyer: Vehicle, tmp_path: Path) -> None:
    values = table(0.1 * np.arange(5), flyer)
    names = [name.replace("cameras", "kameras") for name in columns(flyer)]
    with pytest.raises(InputError, match=r"no column cameras_x.*needs time_s, its sensors and a column for each jet"):
        read(written(tmp_path / "log.csv", values, flyer, names), flyer)


def test_a_record_at_odd_times_with_gaps_is_estimated_to_its_end(flyer: Vehicle, tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    times = np.cumsum(random.uniform(0.03, 0.15, 40))
    times[20:] += 2.0
    values = table(times, flyer)
    values[:, 1:4] = 1e-4 * random.standard_normal((40, 3))
    values[:, -12:] = 0.0
    values[7, 1:8] = np.nan
    run = estimate(written(tmp_path / "log.csv", values, flyer), resolved({"name": "log", "vehicle": flyer}))
    assert run.time_s[-1] == times[-1]
    quality = run.summary["data_quality"]
    assert quality["gaps"]["count"] == 1
    assert np.isfinite(run["estimate"]).all()
    assert run.results.detections == ()


def test_known_outside_forces_are_read(flyer: Vehicle, tmp_path: Path) -> None:
    force = {"known_force_x": 0.1, "known_force_y": 0.0, "known_force_z": -0.2}
    values = dict(zip(columns(flyer), table(0.1 * np.arange(5), flyer).T, strict=True))
    values |= {name: np.full(5, value) for name, value in force.items()}
    rows, _ = read(written(tmp_path / "log.csv", np.column_stack(list(values.values())), flyer, list(values)), flyer)
    assert rows.outside_wrench is not None
    np.testing.assert_array_equal(rows.outside_wrench, np.tile([0.0, 0.0, 0.0, 0.1, 0.0, -0.2], (5, 1)))
