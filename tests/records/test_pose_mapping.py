"""Records of other programs of a vehicle that is followed in a fixed frame: every channel at its own time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again
from record_probe import as_map, write_csv

from massprop_drake import InputError, estimate, load_vehicle
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Gyro, PoseSensor, Vehicle, VelocitySensor
from massprop_drake.maths.attitude import from_rotation_vector
from massprop_drake.records.mapping import MappedTable, mapped, table
from massprop_drake.records.recording import open_recording

ROWS = 40
JETS = 12


@pytest.fixture
def flyer() -> Vehicle:
    return load_vehicle("tracked_flyer")


def columns_of(cam_rows: np.ndarray) -> dict[str, Any]:
    """A table at 20 Hz, in which the camera has read at some rows alone; degrees and millimeters."""
    random = np.random.default_rng(6)
    times = 3.0 + 0.05 * np.arange(ROWS)
    place, heading = 5.0 * random.standard_normal((ROWS, 3)), 10.0 * random.standard_normal(ROWS)
    seen = np.isin(np.arange(ROWS), cam_rows)

    def cells(values: np.ndarray) -> list[str]:
        return [repr(float(value)) if there else "" for value, there in zip(values, seen, strict=True)]

    jets = (random.random((ROWS, JETS)) < 0.2).astype(int)
    return {
        "t": times,
        **{f"p{axis}": cells(place[:, index]) for index, axis in enumerate("xyz")},
        "h": cells(heading),
        **{f"u{jet + 1}": jets[:, jet] for jet in range(JETS)},
    }


def text(
    pose: str = "{kind: pose, position: [px, py, pz], unit: mm, heading: h, angle_unit: deg}", more: str = ""
) -> str:
    jets = ", ".join(f"T{jet + 1}: u{jet + 1}" for jet in range(JETS))
    return f"time: {{column: t}}\nsensors:\n  cameras: {pose}\n{more}commands: {{columns: {{{jets}}}}}\n"


def made_of(path: Path, by: str, vehicle: Vehicle) -> tuple[MappedTable, dict[str, np.ndarray]]:
    given = as_map(by)
    made = table(mapped(open_recording(path, given), given, vehicle, "map.yaml"), None)
    values = np.vstack([block.values for block in made.blocks(list(range(len(made.header))))])
    return made, dict(zip(made.header, values.T, strict=True))


def test_a_row_whenever_anything_was_read_or_commanded(flyer: Vehicle, tmp_path: Path) -> None:
    rows = np.arange(1, ROWS, 3)
    given = columns_of(rows)
    made, found = made_of(write_csv(tmp_path / "log.csv", given), text(), flyer)
    np.testing.assert_allclose(found["time_s"] - found["time_s"][0], given["t"] - given["t"][0], atol=1e-9)
    seen = np.isfinite(found["cameras_x"])
    np.testing.assert_array_equal(np.flatnonzero(seen), rows)
    np.testing.assert_allclose(found["cameras_x"][seen], [1e-3 * float(given["px"][row]) for row in rows], rtol=1e-12)
    half = [0.5 * np.radians(float(given["h"][row])) for row in rows]
    np.testing.assert_allclose(found["cameras_qz"][seen] / found["cameras_qw"][seen], np.tan(half), rtol=1e-9)
    for jet in range(JETS):
        np.testing.assert_array_equal(found[f"jet_T{jet + 1}"][:-1], given[f"u{jet + 1}"][:-1])
    assert made.notes == []


def test_two_sensors_read_at_rows_of_their_own(flyer: Vehicle, tmp_path: Path) -> None:
    vehicle = again(flyer, gyros=(Gyro(name="gyro", quantum=0.0, noise_std=1e-3),))
    given = columns_of(np.arange(0, ROWS, 4))
    for axis in "xyz":
        given[f"w{axis}"] = [repr(0.01 * row) if row % 3 == 0 else "" for row in range(ROWS)]
    _, found = made_of(
        write_csv(tmp_path / "log.csv", given), text(more="  gyro: {kind: gyro, columns: [wx, wy, wz]}\n"), vehicle
    )
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(found["cameras_x"])), np.arange(0, ROWS, 4))
    there = np.flatnonzero(np.isfinite(found["gyro_x"]))
    np.testing.assert_array_equal(there, np.arange(0, ROWS, 3))
    np.testing.assert_allclose(found["gyro_x"][there], 0.01 * there, atol=1e-12)


def test_a_velocity_goes_to_its_sensor(flyer: Vehicle, tmp_path: Path) -> None:
    vehicle = again(flyer, velocities=(VelocitySensor(name="speed", noise_std=1e-3),))
    given = columns_of(np.arange(ROWS)) | {f"v{axis}": 0.1 * np.arange(ROWS) for axis in "xyz"}
    by = text(more="  speed: {kind: velocity, columns: [vx, vy, vz], unit: mm/s}\n")
    _, found = made_of(write_csv(tmp_path / "log.csv", given), by, vehicle)
    np.testing.assert_allclose(found["speed_y"], 1e-4 * np.arange(ROWS), rtol=1e-12)


def test_an_attitude_alone_is_a_pose_without_position(flyer: Vehicle, tmp_path: Path) -> None:
    by = text("{kind: attitude, heading: h, angle_unit: deg}")
    _, found = made_of(write_csv(tmp_path / "log.csv", columns_of(np.arange(ROWS))), by, flyer)
    assert np.isfinite(found["cameras_qw"]).all()
    assert "cameras_x" not in found or np.isnan(found["cameras_x"]).all()


def test_a_sensor_that_the_vehicle_does_not_have_is_refused(flyer: Vehicle, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", columns_of(np.arange(ROWS)))
    with pytest.raises(
        InputError, match=r"sensors\.camera: vehicle 'tracked_flyer' has no pose of this name"
    ) as caught:
        made_of(path, text().replace("cameras:", "camera:"), flyer)
    assert len(str(caught.value).splitlines()) == 1


def test_a_record_in_which_no_sensor_reads_is_refused(flyer: Vehicle, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", columns_of(np.zeros(0)))
    with pytest.raises(InputError) as caught:
        made_of(path, text(), flyer)
    assert len(str(caught.value).splitlines()) == 1


def test_a_mapped_record_is_estimated_from(flyer: Vehicle, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", columns_of(np.arange(0, ROWS, 2)))
    scenario = resolved({"name": "log", "vehicle": flyer, "detector": {"kind": "off"}})
    run = estimate(path, scenario, record_map=as_map(text()))
    used = run["rotation_used"][:, 0] == 1.0
    # of the first reading the filter begins, and every second row has none
    np.testing.assert_array_equal(np.flatnonzero(used), np.arange(2, len(used), 2))


def test_an_attitude_goes_to_the_nearest_row_turned_there_by_the_rate(tmp_path: Path) -> None:
    """A star tracker at its own times, beside a gyro whose samples are the rows."""
    from scipy.io import savemat  # noqa: PLC0415

    plain = load_vehicle("free_flyer")
    vehicle = again(plain, poses=(PoseSensor(name="st", attitude_std=1e-4),))
    period_s, count, rate = vehicle.sample_period_s, 40, np.array([0.2, -0.1, 0.3])
    rows_s = period_s * np.arange(count)
    read_s = 0.013 + 5.3 * period_s * np.arange(7)
    turned = np.array([from_rotation_vector(rate * time_s) for time_s in read_s])
    random = np.random.default_rng(3)
    commands = (random.random((count, JETS)) < 0.2).astype(float)
    velocity = np.linspace(0.0, 0.1, 3 * count).reshape(count, 3)
    imu = {"t": rows_s, "w": np.tile(rate, (count, 1)), "v": velocity, "u": commands}
    savemat(tmp_path / "log.mat", {"imu": imu, "stars": {"t": read_s, "q": turned}})
    named = ", ".join(f"{jet}: 'u[{index}]'" for index, jet in enumerate(vehicle.designations))
    by = (
        "time: {column: t}\ntopic: imu\nsensors:\n"
        "  gyro: {kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}\n"
        "  acc: {kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}\n"
        "  st: {kind: attitude, topic: stars, quaternion: ['q[0]', 'q[1]', 'q[2]', 'q[3]'], order: wxyz}\n"
        f"commands: {{columns: {{{named}}}}}\n"
    )
    given, recording = as_map(by), tmp_path / "log.mat"
    made = table(mapped(open_recording(recording, given), given, vehicle, "map.yaml"), "gyro")
    values = np.vstack([block.values for block in made.blocks(list(range(len(made.header))))])
    found = dict(zip(made.header, values.T, strict=True))
    there = np.flatnonzero(np.isfinite(found["st_qw"]))
    np.testing.assert_array_equal(there, np.round(read_s / period_s).astype(int))
    expected = np.array([from_rotation_vector(rate * time_s) for time_s in rows_s[there]])
    read = np.column_stack([found[f"st_{part}"][there] for part in ("qw", "qx", "qy", "qz")])
    np.testing.assert_allclose(read, expected, atol=1e-12)
    assert not [note for note in made.notes if "not estimated from" in note]
    wrong = as_map(by.replace("  st:", "  stars:"))
    other = open_recording(recording, wrong)
    with pytest.raises(InputError, match=r"sensors\.stars: vehicle 'free_flyer' has no pose of this name"):
        mapped(other, wrong, vehicle, "map.yaml")
