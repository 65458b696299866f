"""The file of a map: what it names, and what is wrong in it, with its line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from record_probe import as_map

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import load_map, rotation_of

PAGE = Path(__file__).parent.parent.parent / "docs" / "records.md"
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


def test_what_is_read() -> None:
    by = as_map(GOOD)
    assert by.topics == {"imu", "/acc", "rcs"}
    expected = "t x dx wx wy ax ay az t2 px py pz a b c d r p h u1 u2 fx fy fz"
    assert by.columns == set(expected.split())
    assert by.row_sensor == "gyro"
    masked = GOOD.replace("columns: {T1: u1, T2: u2}", "mask: {column: bits, bits: {T1: 0, T2: 1}}")
    assert "bits" in as_map(masked).columns
    assert as_map(masked).commands.jets == ["T1", "T2"]


def test_axes_as_a_matrix() -> None:
    assert rotation_of(("-z", "x", "y")).tolist() == [[0, 0, -1], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("unit: deg/s", "unit: m/s", "line 5: sensors.gyro.unit: 'm/s' is a unit of velocity; expected one of rate"),
        ("gives: mean", "gives: integral", "line 6: sensors.acc: unit 'g' does not fit gives: integral"),
        ("order: xyzw", "heading: q", "line 7: sensors.cam: give one of quaternion and heading"),
        (", order: xyzw", "", "line 7: sensors.cam: quaternion and order belong together"),
        ("order: xyzw", "order: xyzw, axes: [x, y, -z]", "axes: [x, y, -z] is left-handed"),
        ("unit: deg/s", "axes: [x, x, z]", "sensors.gyro.axes: must name each of x, y and z once, got [x, x, z]"),
        ("unit: deg/s", "axes: [y, x, z], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "either axes or rotation"),
        ("unit: deg/s", "rotation: [[1, 0, 0], [0, 1, 0], [0, 1, 1]]", "rotation: its rows must be at right angles"),
        ("[wx, wy, null]", "[null, null, null]", "columns: none is named"),
        ("[wx, wy, null]", "[wx, wy]", "sensors.gyro.columns: must have 3 values, got 2"),
        (
            "{T1: u1, T2: u2}",
            "{T1: u1}, listed: {column: c}",
            "commands: give one of columns, mask and listed, got columns and",
        ),
        ("{T1: u1, T2: u2}", "{T1: u1}, on: 0", "commands: on and off must differ, got 0"),
        ("rate: dx", "rate: dx, rate_unit: rad/s", "rate_unit 'rad/s' is none of a rate of 'm'"),
        ("unit: N", "unit: N*m", "known_force: unit 'N*m' is none of a force"),
        ("topic: imu", "topic: imu\nrows: none", "rows: 'none' is not one of sensors (gyro, acc, cam, sun)"),
        ("kind: attitude, angles: [r, p, h]", "kind: attitude", "sensors.sun: give quaternion, angles or heading"),
        ("time: {column: t2}", "time: {column: t2, drift: 2}", "sensors.acc.time.drift: input should be less than 0.5"),
        ("sensors:", "sensor:", "unknown key; did you mean 'sensors'?"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as told:
        as_map(GOOD.replace(old, new))
    assert said in told.value.problems[0]


def test_a_file(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(GOOD, encoding="utf-8")
    assert load_map(tmp_path / "map.yaml") == as_map(GOOD)
    with pytest.raises(InputError, match="no such file"):
        load_map(tmp_path / "none.yaml")


def test_the_pages_examples_are_maps() -> None:
    examples = re.findall(r"^```yaml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert len(examples) == 2
    assert [next(iter(as_map(text).sensors)) for text in examples] == ["mocap", "gyro"]
