"""What a map makes of columns: units, axes, clocks, commands, and what cannot be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_probe import (
    Flight,
    as_map,
    flight,
    made_of,
    require_the_flight,
    telemetry,
    usual_columns,
    usual_map,
    write_csv,
)

from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.records.mapping import Mapped, MappedTable, comes_faster, mapped, preview, table
from massprop_drake.records.recording import open_recording

GYRO = "{kind: gyro, columns: [wx, wy, wz]"
ACC = "{kind: accelerometer, columns: [vx, vy, vz]"


@pytest.fixture(scope="module")
def one() -> Flight:
    return flight(load_vehicle("free_flyer"))


@pytest.fixture
def log(one: Flight, tmp_path: Path) -> Callable[..., Path]:
    """Writes the flight as a table, some columns otherwise."""

    def write(**instead: object) -> Path:
        return write_csv(
            tmp_path / "log.csv", {name: one for name, one in (usual_columns(one) | instead).items() if one is not None}
        )

    return write


def understood(path: Path, text: str, one: Flight) -> Mapped:
    by = as_map(text)
    return mapped(open_recording(path, by), by, one.vehicle, "map.yaml")


def refused(action: Callable[[], object]) -> str:
    with pytest.raises(InputError) as told:
        action()
    return str(told.value)


# --------------------------------------------------------------------------- units, axes, signs


def test_units_and_axes(one: Flight, log: Callable[..., Path]) -> None:
    # recorder: forward, left, up; deg/s, mm/s, ms
    turn = np.array([1.0, -1.0, -1.0])
    path = log(
        t=1000.0 * one.time_s,
        **{f"w{axis}": np.degrees(one.rates * turn)[:, index] for index, axis in enumerate("xyz")},
        **{f"v{axis}": 1e3 * (one.velocities * turn)[:, index] + 7.0 for index, axis in enumerate("xyz")},
    )
    text = usual_map(
        one,
        time="{column: t, unit: ms}",
        gyro=f"{GYRO}, unit: deg/s, axes: [x, -y, -z]}}",
        acc=f"{ACC}, gives: integral, unit: mm/s, zero: [7, 7, 7], rotation: [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}}",
    )
    require_the_flight(telemetry(path, text, one.vehicle), one)


def test_a_permutation_of_axes_names_the_recorders(one: Flight, log: Callable[..., Path]) -> None:
    # the vehicle's x is minus the recorder's z, its y the recorder's x, its z minus the recorder's y
    x, y, z = one.rates.T
    path = log(wx=y, wy=-z, wz=-x)
    require_the_flight(telemetry(path, usual_map(one, gyro=f"{GYRO}, axes: [-z, x, -y]}}"), one.vehicle), one)


def test_readings_that_rows_repeat_are_left_out(one: Flight, log: Callable[..., Path]) -> None:
    last = (np.arange(len(one.time_s)) + 1) // 3 * 3 - 1  # read anew in rows 2, 5, ...
    held = {f"w{axis}": one.rates[np.maximum(last, 0), index] for index, axis in enumerate("xyz")}
    text = usual_map(one, gyro=f"{GYRO}, every: 3}}")
    found = telemetry(log(**held), text, one.vehicle)
    expected = np.where(np.arange(len(one.time_s)) % 3 == 2, one.rates[:, 1], np.nan)
    np.testing.assert_array_equal(found["gyro_y"], expected)
    np.testing.assert_array_equal(found["acc_y"], one.velocities[:, 1])
    text = text.replace("every: 3", "every: 2")
    assert "sensors.gyro.every: 2 does not fit" in refused(lambda: telemetry(log(**held), text, one.vehicle))
    text = usual_map(one, acc=f"{ACC}, gives: increment, unit: m/s, every: 3}}")
    assert "every goes with gives: integral" in refused(lambda: as_map(text))


def test_a_vehicle_in_feet(tmp_path: Path) -> None:
    one = flight(load_vehicle("orbiter"))
    text = usual_map(one, acc=f"{ACC}, gives: integral, unit: m/s}}").replace("  acc:", "  acc1:")
    columns = usual_columns(one)
    columns |= {f"f{axis}": np.full(len(one.time_s), 100.0) for axis in "xyz"}
    path = write_csv(tmp_path / "log.csv", columns)
    text += "known_force: {columns: [fx, fy, fz], unit: N}\nknown_torque: {columns: [fx, fy, fz], unit: N*m}\n"
    found = telemetry(path, text, one.vehicle)
    np.testing.assert_allclose(found["acc1_y"], one.velocities[:, 1] / 0.3048, rtol=1e-12)
    np.testing.assert_allclose(found["known_force_x"], 100.0 / 4.4482216152605, rtol=1e-12)
    np.testing.assert_allclose(found["known_torque_z"], 100.0 / 1.3558179483314004, rtol=1e-9)


def test_rates_that_cannot_be(one: Flight, log: Callable[..., Path]) -> None:
    path = log(wz=400.0 + one.rates[:, 2])
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message == (
        f"{path}: sensor 'gyro' turns at up to {400 + one.rates[:, 2].max():.4g} rad/s as rad/s, more than half a turn "
        "in a sample of 0.05 s or than any gyro measures; it looks like degrees: `unit: deg/s`"
    )
    found = telemetry(path, usual_map(one, gyro=f"{GYRO}, unit: deg/s}}"), one.vehicle)
    assert found["gyro_z"][0] == pytest.approx(np.radians(400.0 + one.rates[0, 2]))
    path = log(wz=np.where(np.arange(len(one.time_s)) == 5, 400.0, one.rates[:, 2]))  # one spike is no unit
    assert telemetry(path, usual_map(one), one.vehicle)["gyro_z"][5] == 400.0


def test_accelerations_that_cannot_be(one: Flight, log: Callable[..., Path]) -> None:
    path = log(vx=1e6 * one.velocities[:, 0])
    text = usual_map(one, acc=f"{ACC}, gives: mean, unit: m/s^2}}")
    assert "sensor 'acc' accelerates at up to" in refused(lambda: telemetry(path, text, one.vehicle))
    text = usual_map(one, acc=f"{ACC}, gives: integral, unit: m/s}}")
    assert "check its unit, and what it `gives`" in refused(lambda: telemetry(path, text, one.vehicle))


# ---------------------------------------------------------------------------------------- poses

HALF = np.sqrt(0.5)


@pytest.mark.parametrize(
    ("columns", "attitude"),
    [
        ({"qw": HALF, "qx": 0.0, "qy": 0.0, "qz": HALF}, "quaternion: [qw, qx, qy, qz], order: wxyz"),
        ({"qw": -HALF, "qx": 0.0, "qy": 0.0, "qz": -HALF}, "quaternion: [qx, qy, qz, qw], order: xyzw"),
        (
            {"qw": HALF, "qx": 0.0, "qy": 0.0, "qz": -HALF},
            "quaternion: [qw, qx, qy, qz], order: wxyz, rotates: world_to_body",
        ),
        ({"h": 90.0}, "heading: h, angle_unit: deg"),
        ({"r": 0.0, "p": 0.0, "h": np.pi / 2}, "angles: [r, p, h]"),
    ],
)
def test_attitudes_in_every_form(
    columns: dict[str, float], attitude: str, one: Flight, log: Callable[..., Path]
) -> None:
    count = len(one.time_s)
    path = log(**{name: np.full(count, value) for name, value in columns.items()})
    text = usual_map(one).replace("commands:", f"  cam: {{kind: attitude, {attitude}}}\ncommands:")
    found = understood(path, text, one).channels["cam"]
    np.testing.assert_allclose(found.values, np.tile([HALF, 0.0, 0.0, HALF], (count, 1)), atol=1e-15)


def test_angles_turn_about_z_then_y_then_x(one: Flight, log: Callable[..., Path]) -> None:
    roll, pitch, yaw = 0.3, -0.5, 1.1
    path = log(**{name: np.full(len(one.time_s), value) for name, value in (("r", roll), ("p", pitch), ("h", yaw))})
    text = usual_map(one).replace("commands:", "  cam: {kind: attitude, angles: [r, p, h]}\ncommands:")
    found = understood(path, text, one).channels["cam"].values[0]
    halves = [(np.cos(angle / 2), np.sin(angle / 2)) for angle in (roll, pitch, yaw)]
    (cr, sr), (cp, sp), (cy, sy) = halves
    by_hand = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    np.testing.assert_allclose(found, by_hand, atol=1e-15)


def test_a_pose_in_other_frames(one: Flight, log: Callable[..., Path]) -> None:
    """From east-north-up and forward-left-up to north-east-down and forward-right-down: facing north is no turn."""
    count = len(one.time_s)
    quarter = {"qw": HALF, "qx": 0.0, "qy": 0.0, "qz": HALF}  # of east to north
    path = log(**{name: np.full(count, value) for name, value in (quarter | {"px": 1e3, "py": 2e3, "pz": 3e3}).items()})
    pose = (
        "{kind: pose, position: [px, py, pz], unit: mm, quaternion: [qw, qx, qy, qz], order: wxyz, "
        "axes: [x, -y, -z], world_axes: [y, x, -z]}"
    )
    found = understood(path, usual_map(one).replace("commands:", f"  cam: {pose}\ncommands:"), one).channels["cam"]
    np.testing.assert_allclose(found.values[0], [2.0, 1.0, -3.0, 1.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_body_axes_that_are_exchanged(one: Flight, log: Callable[..., Path]) -> None:
    """The recorder does not turn; the vehicle's x points along minus its z, and so along minus the world's z."""
    path = log(h=np.zeros(len(one.time_s)))
    text = usual_map(one).replace("commands:", "  cam: {kind: attitude, heading: h, axes: [-z, x, -y]}\ncommands:")
    w, *rest = understood(path, text, one).channels["cam"].values[0]
    q = np.array(rest)

    def turned(vector: list[float]) -> np.ndarray:
        return vector + 2.0 * np.cross(q, np.cross(q, vector) + w * np.array(vector))

    np.testing.assert_allclose(turned([1.0, 0.0, 0.0]), [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(turned([0.0, 1.0, 0.0]), [1.0, 0.0, 0.0], atol=1e-12)


def test_what_is_no_quaternion(one: Flight, log: Callable[..., Path]) -> None:
    path = log(q=np.full(len(one.time_s), 0.7))
    text = usual_map(one).replace(
        "commands:", "  cam: {kind: attitude, quaternion: [q, q, q, q], order: wxyz}\ncommands:"
    )
    assert "have length 1.4, and a quaternion that turns has length 1" in refused(lambda: understood(path, text, one))


def test_degrees_that_are_called_radians(one: Flight, log: Callable[..., Path]) -> None:
    path = log(h=(np.linspace(100.0, 300.0, len(one.time_s)) + 180.0) % 360.0 - 180.0)
    text = usual_map(one).replace("commands:", "  cam: {kind: attitude, heading: h}\ncommands:")
    assert "h jumps by 360, and the map has it in radians" in refused(lambda: understood(path, text, one))
    path = log(t=1e-3 * one.time_s, h=np.linspace(0.0, 60.0, len(one.time_s)))
    text = text.replace("{column: t}", "{column: t, unit: s}")
    assert "is rad the unit of its angles?" in refused(lambda: understood(path, text, one))


def test_what_is_not_estimated_from_is_said(one: Flight, log: Callable[..., Path]) -> None:
    path = log(h=np.zeros(len(one.time_s)))
    pose = "  cam: {kind: pose, position: [h, h, null], heading: h}\ncommands:"
    made = made_of(path, usual_map(one).replace("commands:", pose), one.vehicle)
    assert made.notes == ["pose 'cam' of the map is not estimated from: vehicle 'free_flyer' has no such sensor"]
    assert not [name for name in made.header if name.startswith("cam")]
    text = usual_map(one).replace("commands:", pose)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("  gyro"))
    message = refused(lambda: telemetry(path, text, one.vehicle))
    assert message.startswith("map.yaml: names accelerometer 'acc', pose 'cam', and no gyro 'gyro'")


def test_a_missing_axis_is_said(one: Flight, log: Callable[..., Path]) -> None:
    text = usual_map(one, gyro="{kind: gyro, columns: [null, null, wz]}")
    message = refused(lambda: telemetry(log(), text, one.vehicle))
    assert message.startswith("map.yaml: sensors.gyro: has no x, y; the estimators take a package of three axes")


# --------------------------------------------------------------------------------------- clocks


def test_clocks(one: Flight, log: Callable[..., Path]) -> None:
    """Commands are stamped by a clock that is 2 s behind and gains 1 in 1000."""
    path = log(t=one.time_s + 5.0, t2=5.0 - 2.0 + one.time_s * 1.001)
    commands = usual_map(one).partition("commands: ")[2].splitlines()[0]
    own = commands[:-1] + ", time: {column: t2, offset_s: 2.0, drift: 0.001}}"
    require_the_flight(telemetry(path, usual_map(one, commands=own), one.vehicle), one)
    apart = telemetry(path, usual_map(one, commands=own.replace("2.0", "1.95")), one.vehicle)  # one row early
    np.testing.assert_allclose(apart["jet_T1"][:-2], one.commands[1:-1, 0], atol=1e-9)


def test_a_clock_that_goes_back(one: Flight, log: Callable[..., Path]) -> None:
    times = one.time_s.copy()
    times[40:] -= 1.0
    path = log(t=times)
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message == (
        f"{path}, line 42: time goes back, from 1.95 to 1 s; has the clock been set? Give the parts one by one"
    )


def test_rows_without_time_and_rows_logged_twice(one: Flight, log: Callable[..., Path]) -> None:
    times = [*map(str, one.time_s)]
    times[7], times[9] = "", times[8]
    made = made_of(log(t=times), usual_map(one), one.vehicle)
    assert sum(len(block.lines) for block in made.blocks([0])) == len(one.time_s) - 2
    assert [note.partition(": ")[2] for note in made.notes[:2]] == [
        "1 rows left out that have no time",
        "1 rows left out whose time is that of the row before",
    ]


def test_a_column_that_is_no_time(one: Flight, log: Callable[..., Path]) -> None:
    path = log(t=np.zeros(len(one.time_s)))
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message == f"{path}: most rows have the time of the row before; does t hold the time, in s?"


def test_stamps_since_1970_count_from_the_first(one: Flight, log: Callable[..., Path]) -> None:
    path = log(t=[f"{1_700_000_000 + time:.6f}" for time in one.time_s])
    found = telemetry(path, usual_map(one), one.vehicle)
    require_the_flight(found, one, close=1e-12)
    assert found["time_s"][0] == 0.0


def test_times_from_differences(one: Flight, log: Callable[..., Path]) -> None:
    random = np.random.default_rng(3)
    true = np.concatenate([[0.0], np.cumsum(random.uniform(0.04, 0.07, len(one.time_s) - 1))])
    place, heading = 0.3 * np.sin(true), 2.0 * true
    rates = [np.diff(values, prepend=values[0]) / np.diff(true, prepend=-1.0) for values in (place, heading)]
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    path = log(x=np.round(place, 7), dx=np.round(rates[0], 7), h=np.round(wrapped, 7), dh=np.round(rates[1], 7))
    both = "{value: x, rate: dx}, {value: h, value_unit: rad, rate: dh, rate_unit: rad/s}"
    text = usual_map(one, time=f"{{column: t, differences: [{both}]}}")
    found = understood(path, text, one)
    np.testing.assert_allclose(found.rows.time_s, true, atol=2e-6)
    assert "where the log says 0.05 s; 0 of 59 are the median step" in found.notes[0]
    without = understood(path, usual_map(one, time=f"{{differences: [{both}]}}"), one)
    np.testing.assert_allclose(without.rows.time_s, true, atol=2e-6)
    path = log(x=place, dx=np.cos(true), h=wrapped, dh=rates[1])  # a velocity, not a difference
    message = refused(lambda: understood(path, text, one))
    assert "would have been taken over unlike steps in the same row" in message
    path = log(x=place, dx=random.normal(size=len(place)), h=wrapped, dh=rates[1])
    assert "time.differences:" in refused(
        lambda: understood(path, usual_map(one, time="{column: t, differences: [{value: x, rate: dx}]}"), one)
    )


def test_a_column_of_time_is_needed(one: Flight, log: Callable[..., Path]) -> None:
    message = refused(lambda: understood(log(), usual_map(one, time="{}"), one))
    assert message.endswith("log.csv has no stamps of its own: name the column, `time: {column: ...}`")


# --------------------------------------------------------------------------------- many samples


def dense(one: Flight, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Times `count` times as dense, and the index of the flight's row in each."""
    rows = np.arange(count * (len(one.time_s) - 1) + 1)
    return one.vehicle.sample_period_s / count * rows, rows // count


def dense_log(one: Flight, tmp_path: Path, count: int, velocities: np.ndarray, jitter: float = 0.0) -> Path:
    time_s, rows = dense(one, count)
    random = np.random.default_rng(2)
    rates = np.column_stack([np.interp(time_s, one.time_s, one.rates[:, axis]) for axis in range(3)])
    columns = {
        "t": time_s + jitter * random.uniform(-1.0, 1.0, time_s.size),
        **{f"w{axis}": rates[:, index] for index, axis in enumerate("xyz")},
        **{f"v{axis}": velocities[:, index] for index, axis in enumerate("xyz")},
        **{f"u{index + 1}": one.commands[rows, index].astype(int) for index in range(len(one.jets))},
    }
    return write_csv(tmp_path / "dense.csv", columns)


@pytest.mark.parametrize("gives", ["integral", "increment", "mean", "instant"])
def test_a_faster_log_gives_rows_a_period_apart(gives: str, one: Flight, tmp_path: Path) -> None:
    count = 10
    time_s, _ = dense(one, count)
    integral = np.column_stack([np.interp(time_s, one.time_s, one.velocities[:, axis]) for axis in range(3)])
    step = one.vehicle.sample_period_s / count
    increments = np.diff(integral, axis=0, prepend=integral[:1])
    # an instant is that of the piece that ends: at corners the trapezoids are out by half a step's change
    values = {"integral": integral, "increment": increments, "mean": increments / step, "instant": increments / step}[
        gives
    ]
    unit = "m/s" if gives in ("integral", "increment") else "m/s^2"
    path = dense_log(one, tmp_path, count, values)
    found = telemetry(path, usual_map(one, acc=f"{ACC}, gives: {gives}, unit: {unit}}}"), one.vehicle)
    if gives != "instant":
        require_the_flight(found, one)
        return
    slopes = np.diff(one.velocities, axis=0) / one.vehicle.sample_period_s
    by_hand = slopes.copy()
    by_hand[1:] -= 0.5 / count * (slopes[1:] - slopes[:-1])
    np.testing.assert_allclose(found["acc_accel_y"][2:], by_hand[1:, 1], atol=1e-9)
    made = made_of(path, usual_map(one, acc=f"{ACC}, gives: instant, unit: m/s^2}}"), one.vehicle)
    assert "'acc' is integrated from 10 instants a row: approximate while jets switch" in made.notes[0]


def test_one_instant_a_row_cannot_be_integrated(one: Flight, log: Callable[..., Path]) -> None:
    text = usual_map(one, acc=f"{ACC}, gives: instant, unit: m/s^2}}")
    message = refused(lambda: telemetry(log(), text, one.vehicle))
    assert "1 times a sample period of 0.05 s, does not tell what the jets gave in between" in message


def test_a_hole_is_not_bridged(one: Flight, tmp_path: Path) -> None:
    count = 5
    time_s, _ = dense(one, count)
    values = np.ones((time_s.size, 3))
    path = dense_log(one, tmp_path, count, values)
    lines = path.read_text(encoding="utf-8").splitlines()
    del lines[52:56]  # between rows 10 and 11: after the header samples 51 to 54
    path.write_text("\n".join(lines), encoding="utf-8")
    found = telemetry(path, usual_map(one, acc=f"{ACC}, gives: mean, unit: m/s^2}}"), one.vehicle)
    assert np.flatnonzero(np.isnan(found["acc_accel_x"])).tolist() == [0, 11]
    np.testing.assert_allclose(found["acc_accel_x"][12:], 1.0)


def test_rows_keep_their_own_times(one: Flight, tmp_path: Path) -> None:
    path = dense_log(one, tmp_path, 20, np.zeros((20 * 59 + 1, 3)), jitter=1e-4)
    found = telemetry(path, usual_map(one), one.vehicle)
    assert len(found["time_s"]) == 60
    steps = np.diff(found["time_s"])
    assert 0.0 < np.abs(steps - 0.05).max() < 4e-4


@pytest.mark.parametrize("gives", ["integral", "increment", "mean"])
def test_a_faster_log_gives_every_reading_at_its_own_time(gives: str, one: Flight, tmp_path: Path) -> None:
    count = 10
    time_s, rows = dense(one, count)
    integral = np.column_stack([np.interp(time_s, one.time_s, one.velocities[:, axis]) for axis in range(3)])
    increments = np.diff(integral, axis=0, prepend=integral[:1])
    step = one.vehicle.sample_period_s / count
    values = {"integral": integral, "increment": increments, "mean": increments / step}[gives]
    unit = "m/s^2" if gives == "mean" else "m/s"
    record = understood(
        dense_log(one, tmp_path, count, values), usual_map(one, acc=f"{ACC}, gives: {gives}, unit: {unit}}}"), one
    )
    assert comes_faster(record)
    made = table(record, "gyro", own_times=True)
    assert made.own_times
    found = dict(
        zip(made.header, np.vstack([b.values for b in made.blocks(list(range(len(made.header))))]).T, strict=True)
    )
    np.testing.assert_allclose(found["time_s"], time_s, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found["acc_y"] - found["acc_y"][0], integral[:, 1] - integral[0, 1], atol=1e-12)
    np.testing.assert_array_equal(found[f"jet_{one.jets[3]}"], one.commands[rows, 3])
    assert not np.isnan(found["gyro_x"]).any()


def test_a_period_that_is_no_multiple(one: Flight, tmp_path: Path) -> None:
    time_s = 0.02 * np.arange(100)
    columns = {"t": time_s, **{name: np.zeros(100) for name in usual_columns(one) if name != "t"}}
    path = write_csv(tmp_path / "log.csv", columns)
    assert "no multiple of it; set sample_period_s to 0.04 or 0.06" in refused(
        lambda: telemetry(path, usual_map(one), one.vehicle)
    )


# ------------------------------------------------------------------------------------- commands


def test_commands_that_were_already_in_force(one: Flight, log: Callable[..., Path]) -> None:
    late = np.vstack([np.zeros((1, len(one.jets))), one.commands[:-1]])
    path = log(**{f"u{index + 1}": late[:, index] for index in range(len(one.jets))})
    commands = usual_map(one).partition("commands: ")[2].splitlines()[0]
    found = telemetry(path, usual_map(one, commands=commands[:-1] + ", acts: until_row}"), one.vehicle)
    require_the_flight(found, one)
    assert np.isnan(found["jet_T1"][-1])


@pytest.mark.parametrize(
    ("scale", "keys"),
    [
        (lambda share: 100.0 * share, "unit: '%'"),
        (lambda share: 0.05 * share, "unit: s"),
        (lambda share: 40.0 * share, "unit: ms, on: 40"),
        (lambda share: 1000.0 + 1000.0 * share, "off: 1000, on: 2000"),
        (lambda share: 1.0 - share, "off: 1, on: 0"),
        (lambda share: 0.2 + 0.6 * share, "threshold: 0.5"),
    ],
)
def test_commands_in_other_units(
    scale: Callable[..., np.ndarray], keys: str, one: Flight, log: Callable[..., Path]
) -> None:
    path = log(**{f"u{index + 1}": scale(one.commands[:, index]) for index in range(len(one.jets))})
    commands = usual_map(one).partition("commands: ")[2].splitlines()[0]
    require_the_flight(telemetry(path, usual_map(one, commands=f"{commands[:-1]}, {keys}}}"), one.vehicle), one)


def test_commands_without_a_scale(one: Flight, log: Callable[..., Path]) -> None:
    commands = usual_map(one).partition("commands: ")[2].splitlines()[0]
    for keys in ("off: 1", "unit: ms, off: 50"):
        text = usual_map(one, commands=f"{commands[:-1]}, {keys}}}")
        assert "is what `on` is, too" in refused(lambda text=text: telemetry(log(), text, one.vehicle))


def test_commands_that_are_no_share(one: Flight, log: Callable[..., Path]) -> None:
    path = log(u3=np.full(len(one.time_s), 7.0))
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message.startswith(f"{path}, line 2, column u3: 7 is no command between closed and open")


def test_a_bit_mask(one: Flight, log: Callable[..., Path]) -> None:
    weights = 2 ** np.arange(len(one.jets))[::-1]
    path = log(valves=(one.commands @ weights).astype(int))
    bits = ", ".join(f"{jet}: {len(one.jets) - 1 - index}" for index, jet in enumerate(one.jets))
    text = usual_map(one, commands=f"{{mask: {{column: valves, bits: {{{bits}}}}}}}")
    require_the_flight(telemetry(path, text, one.vehicle), one)
    path = log(valves=(one.commands @ weights).astype(int) + 2**14)
    assert made_of(path, text, one.vehicle).notes == [f"{path}: column valves has bit 14, which is no jet's"]
    assert "-1 is no bit mask" in refused(lambda: telemetry(log(valves=np.full(60, -1)), text, one.vehicle))


def test_a_list_of_jets(one: Flight, log: Callable[..., Path]) -> None:
    path = log(on=[f"[{';'.join(f'v{place}' for place in np.flatnonzero(row))}]" for row in one.commands])
    names = ", ".join(f"{jet}: v{index}" for index, jet in enumerate(one.jets))
    text = usual_map(one, commands=f"{{listed: {{column: on, names: {{{names}}}}}}}")
    require_the_flight(telemetry(path, text, one.vehicle), one)
    path = log(on=["v1 v77"] * len(one.time_s))
    assert "line 2, column on: 'v77' is no jet's name" in refused(lambda: telemetry(path, text, one.vehicle))


def test_commands_logged_when_they_change(one: Flight, tmp_path: Path) -> None:
    """By times of their own, which lie within rows: the share of the row is what counts."""
    from scipy.io import savemat  # noqa: PLC0415

    rest = np.zeros((3, len(one.jets) - 1))
    events = {"t": np.array([0.0, 0.5125, 1.0]), "u": np.column_stack([[0.0, 1.0, 0.0], rest])}
    imu = {"t": one.time_s, "w": one.rates, "v": one.velocities}
    savemat(tmp_path / "log.mat", {"imu": imu, "rcs": events})
    columns = ", ".join(f"{jet}: 'u[{index}]'" for index, jet in enumerate(one.jets))
    text = usual_map(
        one,
        gyro="{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
        commands=f"{{topic: rcs, on_change: true, columns: {{{columns}}}}}",
        more="topic: imu",
    )
    found = telemetry(tmp_path / "log.mat", text, one.vehicle)
    by_hand = np.where((one.time_s >= 0.55 - 1e-9) & (one.time_s < 1.0 - 1e-9), 1.0, 0.0)
    by_hand[10] = 0.75
    np.testing.assert_allclose(found[f"jet_{one.jets[0]}"], by_hand, atol=1e-9)
    held = made_of(tmp_path / "log.mat", text, one.vehicle)
    assert "in 1 of 60 rows a jet switches within the row" in held.notes[0]
    onset_s = column(held, f"onset_{one.jets[0]}_s")
    assert onset_s[10] == pytest.approx(0.0125, abs=1e-9)
    assert np.isnan(np.delete(onset_s, 10)).all()
    apart = made_of(tmp_path / "log.mat", text.replace("on_change: true", "on_change: false"), one.vehicle)
    assert apart.notes[0].startswith("commands are logged every 0.5 s, and a sample is 0.05 s")


def test_what_the_map_lacks_of_the_vehicle(one: Flight, log: Callable[..., Path]) -> None:
    text = usual_map(one)
    message = refused(lambda: telemetry(log(), text.replace("T12:", "T13:"), one.vehicle))
    assert message.startswith("map.yaml: commands: 'T13' is no jet of vehicle 'free_flyer'; did you mean 'T")
    message = refused(lambda: telemetry(log(), text.replace(", T12: 'u12'", ""), one.vehicle))
    assert message == "map.yaml: commands: does not say where to find jet T12"
    message = refused(lambda: telemetry(log(), text.replace("  gyro:", "  gyr:"), one.vehicle))
    assert message == "map.yaml: sensors.gyr: vehicle 'free_flyer' has no gyro of this name; did you mean 'gyro'?"
    assert "acc" in refused(
        lambda: telemetry(
            log(), text.replace("  acc: {kind: accelerometer, gives: integral", "  acc: {kind: velocity"), one.vehicle
        )
    )


def test_sensors_that_never_meet_the_rows(one: Flight, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    imu = {"t": one.time_s, "w": one.rates}
    savemat(
        tmp_path / "log.mat",
        {"imu": imu, "dv": {"t": one.time_s + 0.02, "v": one.velocities}, "rcs": {"t": one.time_s, "u": one.commands}},
    )
    columns = ", ".join(f"{jet}: 'u[{index}]'" for index, jet in enumerate(one.jets))
    text = usual_map(
        one,
        gyro="{kind: gyro, topic: imu, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, topic: dv, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
        commands=f"{{topic: rcs, columns: {{{columns}}}}}",
    )
    message = refused(lambda: telemetry(tmp_path / "log.mat", text, one.vehicle))
    assert "no sample of 'acc' was taken within 5 % of a sample period of a row" in message


def test_preview(one: Flight, log: Callable[..., Path]) -> None:
    shown = preview(understood(log(), usual_map(one), one), 3)
    assert [row["time_s"] for row in shown] == pytest.approx([0.0, 0.05, 0.1])
    assert shown[1]["sensors"]["gyro"]["y"] == pytest.approx(one.rates[1, 1])
    assert set(shown[2]["jets"]) == {jet for jet, on in zip(one.jets, one.commands[2], strict=True) if on}


def test_the_table_names_lines_of_the_file(one: Flight, log: Callable[..., Path]) -> None:
    by = as_map(usual_map(one))
    made = table(mapped(open_recording(log(), by), by, one.vehicle), "gyro")
    assert (made.place, next(made.blocks([0])).lines[0]) == ("line", 2)
    assert made.done == 1.0


def column(rows: MappedTable, name: str) -> np.ndarray:
    (block,) = rows.blocks([rows.header.index(name)])
    return block.values[:, 0]


def test_on_times_lie_in_a_sample_where_map_or_vehicle_say(one: Flight, log: Callable[..., Path]) -> None:
    on_ms = {f"u{index + 1}": 50.0 * one.commands[:, index] for index in range(len(one.jets))}
    text = usual_map(one).replace("commands: {", "commands: {unit: ms, at: end, ")
    assert not any(name.startswith("onset_") for name in made_of(log(**on_ms), text, one.vehicle).header)  # all or none
    on_ms["u1"] = np.full(len(one.time_s), 20.0)
    found = made_of(log(**on_ms), text, one.vehicle)
    np.testing.assert_allclose(column(found, "jet_T1")[:-1], 0.4, rtol=1e-12)
    np.testing.assert_allclose(column(found, "onset_T1_s")[:-1], 0.03, rtol=1e-12)
    plain = made_of(log(**on_ms), text.replace("at: end, ", ""), one.vehicle)
    np.testing.assert_array_equal(column(plain, "onset_T1_s")[:-1], 0.0)
    shares = usual_map(one).replace("commands: {", "commands: {at: end, ")
    assert "at goes with on-times" in refused(lambda: made_of(log(), shares, one.vehicle))
