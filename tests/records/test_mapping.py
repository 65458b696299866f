"""Maps of columns: units, axes, clocks, commands, poses, and refusals."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from pose_probe import again
from record_probe import (
    ONE,
    as_map,
    columns_of,
    flight,
    jet_columns,
    made_of,
    refused,
    require_the_flight,
    telemetry,
    usual_columns,
    usual_map,
    write_csv,
)

from massprop_drake import estimate, load_vehicle
from massprop_drake.inputs.record_map import load_map, rotation_of
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_sensors import Gyro, PoseSensor, VelocitySensor
from massprop_drake.maths.attitude import from_rotation_vector
from massprop_drake.records.channels import Mapped
from massprop_drake.records.mapped_rows import is_oversampled, make_table
from massprop_drake.records.mapping import apply_map
from massprop_drake.records.recording import open_recording

GYRO = "{kind: gyro, columns: [wx, wy, wz]"
ACC = "{kind: accelerometer, columns: [vx, vy, vz]"
COMMANDS = f"{{columns: {jet_columns(ONE, 'u{}', 1)}"
N = len(ONE.time_s)


@pytest.fixture
def log(tmp_path: Path) -> Callable[..., Path]:
    """Writes the flight as a table, some columns otherwise."""

    def write(**instead: object) -> Path:
        columns = {name: values for name, values in (usual_columns(ONE) | instead).items() if values is not None}
        return write_csv(tmp_path / "log.csv", columns)

    return write


def understood(path: Path, text: str) -> Mapped:
    by = as_map(text)
    return apply_map(open_recording(path, by), by, ONE.vehicle, "map.yaml")


def found_in(path: Path, text: str) -> dict[str, np.ndarray]:
    return telemetry(path, text, ONE.vehicle)


def test_units_and_axes(log: Callable[..., Path]) -> None:
    # recorder: forward, left, up; deg/s, mm/s, ms
    turn = np.array([1.0, -1.0, -1.0])
    path = log(
        t=1000.0 * ONE.time_s,
        **{f"w{axis}": np.degrees(ONE.rates * turn)[:, index] for index, axis in enumerate("xyz")},
        **{f"v{axis}": 1e3 * (ONE.velocities * turn)[:, index] + 7.0 for index, axis in enumerate("xyz")},
    )
    text = usual_map(
        ONE,
        time="{column: t, unit: ms}",
        gyro=f"{GYRO}, unit: deg/s, axes: [x, -y, -z]}}",
        acc=f"{ACC}, gives: integral, unit: mm/s, zero: [7, 7, 7], rotation: [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}}",
    )
    require_the_flight(found_in(path, text), ONE)
    # the vehicle's x is minus the recorder's z, its y the recorder's x, its z minus the recorder's y
    x, y, z = ONE.rates.T
    require_the_flight(found_in(log(wx=y, wy=-z, wz=-x), usual_map(ONE, gyro=f"{GYRO}, axes: [-z, x, -y]}}")), ONE)
    assert rotation_of(("-z", "x", "y")).tolist() == [[0, 0, -1], [1, 0, 0], [0, 1, 0]]


def test_a_vehicle_in_feet(tmp_path: Path) -> None:
    orbiter = flight(load_vehicle("orbiter"))
    text = usual_map(orbiter).replace("  acc:", "  acc1:")
    path = write_csv(tmp_path / "log.csv", usual_columns(orbiter) | {f"f{axis}": np.full(N, 100.0) for axis in "xyz"})
    text += "known_force: {columns: [fx, fy, fz], unit: N}\nknown_torque: {columns: [fx, fy, fz], unit: N*m}\n"
    found = telemetry(path, text, orbiter.vehicle)
    np.testing.assert_allclose(found["acc1_y"], orbiter.velocities[:, 1] / 0.3048, rtol=1e-12)
    np.testing.assert_allclose(found["known_force_x"], 100.0 / 4.4482216152605, rtol=1e-12)
    np.testing.assert_allclose(found["known_torque_z"], 100.0 / 1.3558179483314004, rtol=1e-9)


HALF = np.sqrt(0.5)


def with_camera(pose: str) -> str:
    return usual_map(ONE).replace("commands:", f"  cam: {{kind: attitude, {pose}}}\ncommands:")


@pytest.mark.parametrize(
    ("columns", "attitude"),
    [
        ((HALF, 0.0, 0.0, HALF), "quaternion: [q0, q1, q2, q3], order: wxyz"),
        ((-HALF, 0.0, 0.0, -HALF), "quaternion: [q1, q2, q3, q0], order: xyzw"),
        ((HALF, 0.0, 0.0, -HALF), "quaternion: [q0, q1, q2, q3], order: wxyz, rotates: world_to_body"),
        ((90.0,), "heading: q0, angle_unit: deg"),
        ((0.0, 0.0, np.pi / 2), "angles: [q0, q1, q2]"),
    ],
)
def test_attitudes_in_every_form(columns: tuple[float, ...], attitude: str, log: Callable[..., Path]) -> None:
    path = log(**{f"q{index}": np.full(N, value) for index, value in enumerate(columns)})
    found = understood(path, with_camera(attitude)).channels["cam"]
    np.testing.assert_allclose(found.values, np.tile([HALF, 0.0, 0.0, HALF], (N, 1)), atol=1e-15)


def test_angles_turn_about_z_then_y_then_x(log: Callable[..., Path]) -> None:
    angles = (0.3, -0.5, 1.1)
    path = log(**{name: np.full(N, value) for name, value in zip("rph", angles, strict=True)})
    found = understood(path, with_camera("angles: [r, p, h]")).channels["cam"].values[0]
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in angles)
    by_hand = [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy]
    by_hand += [cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
    np.testing.assert_allclose(found, by_hand, atol=1e-15)


def test_body_axes_that_are_exchanged(log: Callable[..., Path]) -> None:
    """The recorder does not turn; the vehicle's x points along minus its z, and so along minus the world's z."""
    found = understood(log(h=np.zeros(N)), with_camera("heading: h, axes: [-z, x, -y]")).channels["cam"].values[0]
    w, q = found[0], found[1:]
    for vector, expected in (([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]), ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0])):
        turned = vector + 2.0 * np.cross(q, np.cross(q, vector) + w * np.array(vector))
        np.testing.assert_allclose(turned, expected, atol=1e-12)


def test_clocks(log: Callable[..., Path]) -> None:
    """Commands are stamped by a clock that is 2 s behind and gains 1 in 1000."""
    path = log(t=ONE.time_s + 5.0, t2=5.0 - 2.0 + ONE.time_s * 1.001)
    own = COMMANDS + ", time: {column: t2, offset_s: 2.0, drift: 0.001}}"
    require_the_flight(found_in(path, usual_map(ONE, commands=own)), ONE)
    apart = found_in(path, usual_map(ONE, commands=own.replace("2.0", "1.95")))  # one row early
    np.testing.assert_allclose(apart["jet_T1"][:-2], ONE.commands[1:-1, 0], atol=1e-9)


def test_rows_without_time_and_rows_logged_twice(log: Callable[..., Path]) -> None:
    times = [f"{1_700_000_000 + time:.6f}" for time in ONE.time_s]
    times[7], times[9] = "", times[8]
    made = made_of(log(t=times), usual_map(ONE), ONE.vehicle)
    (block,) = made.blocks([0])
    assert (len(block.lines), block.lines[0], made.place, block.values[0, 0]) == (N - 2, 2, "line", 0.0)
    assert [note.partition(": ")[2] for note in (*made.notes, *made.information)] == [
        "1 rows left out that have no time",
        "1 rows left out whose time is that of the row before",
        "times count from 1700000000 s of its clock",
    ]


def test_times_from_differences(log: Callable[..., Path]) -> None:
    random = np.random.default_rng(3)
    true = np.concatenate([[0.0], np.cumsum(random.uniform(0.04, 0.07, N - 1))])
    place, heading = 0.3 * np.sin(true), 2.0 * true
    rates = [np.diff(values, prepend=values[0]) / np.diff(true, prepend=-1.0) for values in (place, heading)]
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    path = log(x=np.round(place, 7), dx=np.round(rates[0], 7), h=np.round(wrapped, 7), dh=np.round(rates[1], 7))
    both = "{value: x, rate: dx}, {value: h, value_unit: rad, rate: dh, rate_unit: rad/s}"
    text = usual_map(ONE, time=f"{{column: t, differences: [{both}]}}")
    found = understood(path, text)
    np.testing.assert_allclose(found.rows.time_s, true, atol=2e-6)
    assert "where the log says 0.05 s; 0 of 59 are the median step" in found.notes[0]
    without = understood(path, usual_map(ONE, time=f"{{differences: [{both}]}}"))
    np.testing.assert_allclose(without.rows.time_s, true, atol=2e-6)
    path = log(x=place, dx=np.cos(true), h=wrapped, dh=rates[1])  # a velocity, not a difference
    assert "would have been taken over unlike steps in the same row" in refused(lambda: understood(path, text))
    path = log(x=place, dx=random.normal(size=N))
    alone = usual_map(ONE, time="{column: t, differences: [{value: x, rate: dx}]}")
    assert "time.differences:" in refused(lambda: understood(path, alone))


def dense_log(tmp_path: Path, count: int, gives: str, jitter: float = 0.0) -> tuple[Path, str, np.ndarray]:
    """The flight `count` times as dense, its map, and the integrals of acceleration."""
    rows = np.arange(count * (N - 1) + 1)
    time_s, step = ONE.vehicle.sample_period_s / count * rows, ONE.vehicle.sample_period_s / count
    rates, integral = (
        np.column_stack([np.interp(time_s, ONE.time_s, values[:, axis]) for axis in range(3)])
        for values in (ONE.rates, ONE.velocities)
    )
    increments = np.diff(integral, axis=0, prepend=integral[:1])
    # an instant is that of the piece that ends: at corners the trapezoids are out by half a step's change
    mean = increments / step
    values = {"integral": integral, "increment": increments, "mean": mean, "instant": mean}[gives]
    columns = {
        "t": time_s + jitter * np.random.default_rng(2).uniform(-1.0, 1.0, time_s.size),
        **{f"w{axis}": rates[:, index] for index, axis in enumerate("xyz")},
        **{f"v{axis}": values[:, index] for index, axis in enumerate("xyz")},
        **{f"u{index + 1}": ONE.commands[rows // count, index].astype(int) for index in range(len(ONE.jets))},
    }
    unit = "m/s" if gives in ("integral", "increment") else "m/s^2"
    text = usual_map(ONE, acc=f"{ACC}, gives: {gives}, unit: {unit}}}")
    return write_csv(tmp_path / "dense.csv", columns), text, integral


@pytest.mark.parametrize("gives", ["integral", "increment", "mean", "instant"])
def test_a_faster_log_gives_rows_a_period_apart(gives: str, tmp_path: Path) -> None:
    path, text, integral = dense_log(tmp_path, 10, gives)
    found = found_in(path, text)
    if gives == "instant":
        slopes = np.diff(ONE.velocities, axis=0) / ONE.vehicle.sample_period_s
        by_hand = slopes[1:] - 0.05 * (slopes[1:] - slopes[:-1])
        np.testing.assert_allclose(found["acc_accel_y"][2:], by_hand[:, 1], atol=1e-9)
        notes = made_of(path, text, ONE.vehicle).notes
        assert "'acc' is integrated from 10 instants a row: approximate while jets switch" in notes[0]
        return
    require_the_flight(found, ONE)
    record = understood(path, text)
    assert is_oversampled(record)
    every = columns_of(make_table(record, "gyro", own_times=True))
    np.testing.assert_allclose(every["time_s"], 0.005 * np.arange(len(integral)), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(every["acc_y"] - every["acc_y"][0], integral[:, 1] - integral[0, 1], atol=1e-12)
    np.testing.assert_array_equal(every["jet_T4"], ONE.commands[np.arange(len(integral)) // 10, 3])
    assert not np.isnan(every["gyro_x"]).any()


def test_a_hole_is_not_bridged(tmp_path: Path) -> None:
    path, text, _ = dense_log(tmp_path, 5, "mean")
    lines = path.read_text(encoding="utf-8").splitlines()
    del lines[52:56]  # between rows 10 and 11: after the header samples 51 to 54
    path.write_text("\n".join(lines), encoding="utf-8")
    assert np.flatnonzero(np.isnan(found_in(path, text)["acc_accel_x"])).tolist() == [0, 11]


def test_commands_that_were_already_in_force(log: Callable[..., Path]) -> None:
    late = np.vstack([np.zeros((1, len(ONE.jets))), ONE.commands[:-1]])
    path = log(**{f"u{index + 1}": late[:, index] for index in range(len(ONE.jets))})
    found = found_in(path, usual_map(ONE, commands=COMMANDS + ", acts: until_row}"))
    require_the_flight(found, ONE)
    assert np.isnan(found["jet_T1"][-1])


def test_masks_and_lists_of_jets(log: Callable[..., Path]) -> None:
    masks = (ONE.commands @ 2 ** np.arange(len(ONE.jets))[::-1]).astype(int)
    bits = ", ".join(f"{jet}: {len(ONE.jets) - 1 - index}" for index, jet in enumerate(ONE.jets))
    text = usual_map(ONE, commands=f"{{mask: {{column: valves, bits: {{{bits}}}}}}}")
    require_the_flight(found_in(log(valves=masks), text), ONE)
    path = log(valves=masks + 2**14)
    assert made_of(path, text, ONE.vehicle).notes == [f"{path}: column valves has bit 14, which is no jet's"]
    assert "-1 is no bit mask" in refused(lambda: found_in(log(valves=np.full(N, -1)), text))
    names = ", ".join(f"{jet}: v{index}" for index, jet in enumerate(ONE.jets))
    text = usual_map(ONE, commands=f"{{listed: {{column: on, names: {{{names}}}}}}}")
    path = log(on=[f"[{';'.join(f'v{place}' for place in np.flatnonzero(row))}]" for row in ONE.commands])
    require_the_flight(found_in(path, text), ONE)
    message = refused(lambda: found_in(log(on=["v1 v77"] * N), text))
    assert "line 2, column on: 'v77' is no jet's name" in message


def test_commands_logged_when_they_change(tmp_path: Path) -> None:
    """By times of their own, which lie within rows: the share of the row is what counts."""
    from scipy.io import savemat  # noqa: PLC0415

    path, rest = tmp_path / "log.mat", np.zeros((3, len(ONE.jets) - 1))
    events = {"t": np.array([0.0, 0.5125, 1.0]), "u": np.column_stack([[0.0, 1.0, 0.0], rest])}
    imu, late = {"t": ONE.time_s, "w": ONE.rates}, {"t": ONE.time_s + 0.02, "v": ONE.velocities}
    savemat(path, {"imu": imu | {"v": ONE.velocities}, "dv": late, "rcs": events})
    text = usual_map(
        ONE,
        gyro="{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
        commands=f"{{topic: rcs, on_change: true, columns: {jet_columns(ONE, 'u[{}]', 0)}}}",
        more="topic: imu",
    )
    made = made_of(path, text, ONE.vehicle)
    found = columns_of(made)
    by_hand = np.where((ONE.time_s >= 0.55 - 1e-9) & (ONE.time_s < 1.0 - 1e-9), 1.0, 0.0)
    by_hand[10] = 0.75
    np.testing.assert_allclose(found["jet_T1"], by_hand, atol=1e-9)
    assert "in 1 of 60 rows a jet switches within the row" in made.notes[0]
    assert found["onset_T1_s"][10] == pytest.approx(0.0125, abs=1e-9)
    assert np.isnan(np.delete(found["onset_T1_s"], 10)).all()
    apart = made_of(path, text.replace("on_change: true", "on_change: false"), ONE.vehicle)
    assert apart.notes[0].startswith("commands are logged every 0.5 s, and a sample is 0.05 s")
    never = refused(lambda: found_in(path, text.replace("accelerometer, ", "accelerometer, topic: dv, ")))
    assert "no sample of 'acc' was taken within 5 % of a sample period of a row" in never


GROWS = np.linspace(100.0, 300.0, N)
WRONG: list[tuple[dict[str, Any], dict[str, str], str]] = [
    ({"wz": 400.0 + ONE.rates[:, 2]}, {}, "sensor 'gyro' turns at up to *it looks like degrees: `unit: deg/s`"),
    (
        {"wz": 4e4 + ONE.rates[:, 2]},
        {"gyro": f"{GYRO}, unit: deg/s}}"},
        "a unit 1000 times smaller would fit: `unit: mdeg/s`",
    ),
    ({"vx": 1e6 * ONE.velocities[:, 0]}, {}, "check its unit, and what it `gives`"),
    ({"h": np.full(N, 0.7)}, {"pose": "quaternion: [h, h, h, h], order: wxyz"}, "have length 1.4, and a quaternion th"),
    ({"h": (GROWS + 180.0) % 360.0 - 180.0}, {"pose": "heading: h"}, "h jumps by 360, and the map has it in radians"),
    ({"t": 1e-3 * ONE.time_s, "h": 0.3 * GROWS}, {"pose": "heading: h"}, "is rad the unit of its angles?"),
    ({"t": np.where(np.arange(N) < 40, 0.0, -1.0) + ONE.time_s}, {}, ", line 42: time goes back, from 1.95 to 1 s; ha"),
    ({}, {"time": "{}"}, "log.csv has no stamps of its own: name the column, `time: {column: ...}`"),
    ({}, {"gyro": "{kind: gyro, columns: [null, null, wz]}"}, "map.yaml: sensors.gyro: has no x, y; the estimators ta"),
    ({}, {"acc": f"{ACC}, gives: instant, unit: m/s^2}}"}, "1 times a sample period of 0.05 s, does not tell what"),
    ({"t": 0.02 / 0.05 * ONE.time_s}, {}, "no multiple of it; set sample_period_s to 0.04 or 0.06"),
    ({"u3": np.full(N, 7.0)}, {}, ", line 2, column u3: 7 is no command between closed and open"),
    ({}, {"commands": f"{COMMANDS.replace('T12:', 'T13:')}}}"}, "map.yaml: commands: 'T13' is no jet of vehicle 'free"),
    (
        {},
        {"commands": f"{COMMANDS.replace(', T12: ' + chr(39) + 'u12' + chr(39), '')}}}"},
        "does not say where to find jet T12",
    ),
    ({}, {"gyro": f"{GYRO}}}\n  gyr: {GYRO}}}"}, "map.yaml: sensors.gyr: vehicle 'free_flyer' has no gyro of this nam"),
]


@pytest.mark.parametrize(("columns", "parts", "said"), WRONG, ids=[said[:40] for *_, said in WRONG])
def test_misfits_are_told(columns: dict[str, Any], parts: dict[str, str], said: str, log: Callable[..., Path]) -> None:
    text = with_camera(parts["pose"]) if "pose" in parts else usual_map(ONE, **parts)
    message = refused(lambda: found_in(log(**columns), text))
    assert re.search(re.escape(said).replace(r"\*", ".*"), message), message
    if "jumps" not in said and "deg" in said:  # one spike is no unit
        spike = log(wz=np.where(np.arange(N) == 5, 400.0, ONE.rates[:, 2]))
        assert found_in(spike, usual_map(ONE))["gyro_z"][5] == 400.0


GOOD = """
topic: imu
time: {column: t, differences: [{value: x, rate: dx}]}
sensors:
  gyro: {kind: gyro, columns: [wx, wy, null], unit: deg/s}
  acc: {kind: accelerometer, topic: /acc, columns: [ax, ay, az], unit: g, gives: mean, time: {column: t2}}
  cam: {kind: pose, position: [px, py, pz], quaternion: [a, b, c, d], order: xyzw}
  sun: {kind: attitude, angles: [r, p, h]}
commands: {topic: rcs, columns: {T1: u1, T2: u2}}
known_force: {columns: [fx, fy, fz], unit: N}
"""


def test_what_a_map_names(tmp_path: Path) -> None:
    by = as_map(GOOD)
    assert by.topics == {"imu", "/acc", "rcs"}
    names = "t x dx wx wy ax ay az t2 px py pz a b c d r p h u1 u2 fx fy fz"
    assert sorted(by.columns) == sorted(names.split())
    masked = as_map(GOOD.replace("columns: {T1: u1, T2: u2}", "mask: {column: bits, bits: {T1: 0, T2: 1}}"))
    assert "bits" in masked.columns
    assert masked.commands.jets == ["T1", "T2"]
    (tmp_path / "map.yaml").write_text(GOOD, encoding="utf-8")
    assert load_map(tmp_path / "map.yaml") == by
    page = (REPOSITORY / "docs" / "records.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```yaml\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    assert [next(iter(as_map(text).sensors)) for text in examples] == ["mocap", "gyro"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("unit: deg/s", "unit: m/s", "line 5: sensors.gyro.unit: 'm/s' is a unit of velocity; expected one of rate"),
        ("unit: deg/s", "unit: deg/s^2", "'deg/s^2' is a unit of something else"),
        ("unit: deg/s", "unit: degg/s", "did you mean 'deg'?"),
        (
            "unit: deg/s",
            "unit: furlong",
            "'furlong' is no unit that is known; expected one of rate (rad/s, deg/s or rpm)",
        ),
        ("unit: deg/s", "unit: kdps", "'kdps' is no unit that is known: of 'dps' there are 'dps', 'mdps', "),
        ("order: xyzw", "heading: q", "line 7: sensors.cam: give one of quaternion and heading"),
        (", order: xyzw", "", "line 7: sensors.cam: quaternion and order belong together"),
        ("order: xyzw", "order: xyzw, axes: [x, y, -z]", "axes: [x, y, -z] is left-handed"),
        ("unit: deg/s", "axes: [y, x, z], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "either axes or rotation"),
        ("unit: deg/s", "rotation: [[1, 0, 0], [0, 1, 0], [0, 1, 1]]", "rotation: its rows must be at right angles"),
        ("{T1: u1, T2: u2}", "{T1: u1}, listed: {column: c}", "commands: give one of columns, mask and listed, got co"),
        ("{T1: u1, T2: u2}", "{T1: u2, T2: u2}", "commands: jet T1 and jet T2 both have column 'u2': name each"),
        ("columns: {T1: u1, T2: u2}", "mask: {column: c, bits: {T1: 3, T2: 3}}", "jet T1 and jet T2 both have bit 3"),
        ("columns: {T1: u1, T2: u2}", "listed: {column: c, names: {T1: a, T2: a}}", "T1 and jet T2 both have name 'a'"),
        ("[wx, wy, null]", "[wx, wx, null]", "line 5: sensors.gyro.columns: the first axis and the second both have c"),
        ("rate: dx", "rate: dx, rate_unit: rad/s", "rate_unit 'rad/s' is none of a rate of 'm'"),
        ("unit: N", "unit: N*m", "known_force: unit 'N*m' is none of a force"),
        ("topic: imu", "topic: imu\nrows: none", "rows: 'none' is not one of sensors (gyro, acc, cam, sun)"),
        ("unit: g, gives: mean", "unit: m/s, gives: increment, every: 3", "every goes with gives: integral"),
    ],
)
def test_a_wrong_map_is_told_with_its_place(old: str, new: str, said: str) -> None:
    assert old in GOOD
    assert said in refused(lambda: as_map(GOOD.replace(old, new)))


FLYER, ROWS = load_vehicle("tracked_flyer"), 24
CAMERAS = "{kind: pose, position: [px, py, pz], unit: mm, heading: h, angle_unit: deg}"


def seen(rows: np.ndarray, more: dict[str, Any]) -> dict[str, Any]:
    """A table at 20 Hz, in which the camera has read at some rows alone; degrees and millimeters."""
    random = np.random.default_rng(6)
    values = dict(zip(("px", "py", "pz", "h"), random.standard_normal((4, ROWS)), strict=True))
    jets = (random.random((ROWS, 12)) < 0.2).astype(int)
    return {
        "t": 3.0 + 0.05 * np.arange(ROWS),
        **{
            name: [repr(float(x)) if row in rows else "" for row, x in enumerate(each)] for name, each in values.items()
        },
        **{f"u{jet + 1}": jets[:, jet] for jet in range(12)},
        **more,
    }


def followed(pose: str = CAMERAS, more: str = "") -> str:
    jets = ", ".join(f"T{jet + 1}: u{jet + 1}" for jet in range(12))
    return f"time: {{column: t}}\nsensors:\n  cameras: {pose}\n{more}commands: {{columns: {{{jets}}}}}\n"


def test_a_row_whenever_anything_was_read_or_commanded(tmp_path: Path) -> None:
    sensors = {"gyros": (Gyro(name="gyro", quantum=0.0, noise_std=1e-3),)}
    vehicle = again(FLYER, **sensors, velocities=(VelocitySensor(name="speed", noise_std=1e-3),))
    rows = np.arange(1, ROWS, 4)
    rates = {f"w{axis}": [repr(0.01 * row) if row % 3 == 0 else "" for row in range(ROWS)] for axis in "xyz"}
    given = seen(rows, rates | {f"v{axis}": 0.1 * np.arange(ROWS) for axis in "xyz"})
    more = "  gyro: {kind: gyro, columns: [wx, wy, wz]}\n  speed: {kind: velocity, columns: [vx, vy, vz], unit: mm/s}\n"
    by = as_map(followed(more=more))
    path = write_csv(tmp_path / "log.csv", given)
    made = make_table(apply_map(open_recording(path, by), by, vehicle, "map.yaml"), None)
    found = columns_of(made)
    np.testing.assert_allclose(found["time_s"] - found["time_s"][0], given["t"] - given["t"][0], atol=1e-9)
    there = np.isfinite(found["cameras_x"])
    np.testing.assert_array_equal(np.flatnonzero(there), rows)
    np.testing.assert_allclose(found["cameras_x"][there], [1e-3 * float(given["px"][row]) for row in rows], rtol=1e-12)
    half = [0.5 * np.radians(float(given["h"][row])) for row in rows]
    np.testing.assert_allclose(found["cameras_qz"][there] / found["cameras_qw"][there], np.tan(half), rtol=1e-9)
    np.testing.assert_allclose(found["speed_y"], 1e-4 * np.arange(ROWS), rtol=1e-12)
    np.testing.assert_allclose(found["gyro_x"][::3], 0.01 * np.arange(0, ROWS, 3), atol=1e-12)
    for jet in range(12):
        np.testing.assert_array_equal(found[f"jet_T{jet + 1}"][:-1], given[f"u{jet + 1}"][:-1])
    assert made.notes == []


def test_records_of_a_followed_vehicle_are_estimated_from_or_refused(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", seen(np.arange(0, ROWS, 2), {}))
    scenario = resolve_scenario({"name": "log", "vehicle": FLYER, "detector": {"kind": "off"}})
    run = estimate(path, scenario, record_map=as_map(followed()))
    # of the first reading the filter begins, and every second row has none
    used = np.flatnonzero(run["rotation_used"][:, 0] == 1.0)
    np.testing.assert_array_equal(used, np.arange(2, len(run.time_s), 2))
    attitude = as_map(followed("{kind: attitude, heading: h, angle_unit: deg}"))
    alone = columns_of(make_table(apply_map(open_recording(path, attitude), attitude, FLYER, "map.yaml"), None))
    assert np.isfinite(alone["cameras_qw"][::2]).all()
    wrong = refused(lambda: telemetry(path, followed().replace("cameras:", "camera:"), load_vehicle("free_flyer")))
    assert "names pose 'camera', and no gyro 'gyro'" in wrong
    empty = write_csv(tmp_path / "log.csv", seen(np.zeros(0), {}))
    assert len(refused(lambda: estimate(empty, scenario, record_map=as_map(followed()))).splitlines()) == 1


def test_an_attitude_goes_to_the_nearest_row_turned_there_by_the_rate(tmp_path: Path) -> None:
    """A star tracker at its own times, beside a gyro whose samples are the rows."""
    from scipy.io import savemat  # noqa: PLC0415

    vehicle = again(ONE.vehicle, poses=(PoseSensor(name="st", attitude_std=1e-4),))
    rate, read_s = np.array([0.2, -0.1, 0.3]), 0.013 + 5.3 * vehicle.sample_period_s * np.arange(7)
    turned = np.array([from_rotation_vector(rate * time_s) for time_s in read_s])
    imu = {"t": ONE.time_s, "w": np.tile(rate, (N, 1)), "v": ONE.velocities, "u": ONE.commands}
    savemat(tmp_path / "log.mat", {"imu": imu, "stars": {"t": read_s, "q": turned}})
    stars = "{kind: attitude, topic: stars, quaternion: ['q[0]', 'q[1]', 'q[2]', 'q[3]'], order: wxyz}"
    text = usual_map(
        ONE,
        gyro="{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc=f"{{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}}\n  st: {stars}",
        commands=f"{{columns: {jet_columns(ONE, 'u[{}]', 0)}}}",
        more="topic: imu",
    )
    made = made_of(tmp_path / "log.mat", text, vehicle)
    found = columns_of(made)
    there = np.flatnonzero(np.isfinite(found["st_qw"]))
    np.testing.assert_array_equal(there, np.round(read_s / vehicle.sample_period_s).astype(int))
    expected = np.array([from_rotation_vector(rate * time_s) for time_s in ONE.time_s[there]])
    read = np.column_stack([found[f"st_{part}"][there] for part in ("qw", "qx", "qy", "qz")])
    np.testing.assert_allclose(read, expected, atol=1e-12)
    assert not [note for note in made.notes if "not estimated from" in note]
    notes = made_of(tmp_path / "log.mat", text, ONE.vehicle).notes
    assert "attitude 'st' of the map is not estimated from: vehicle 'free_flyer' has no such sensor" in " ".join(notes)
