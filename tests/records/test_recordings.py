"""Files of other programs, written by the libraries that read them, and damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_probe import (
    Flight,
    flight,
    jet_columns,
    made_of,
    px4_topics,
    require_the_flight,
    telemetry,
    usual_columns,
    usual_map,
    write_bag,
    write_csv,
    write_mat73,
    write_ulog,
)

from massprop_drake.cli.checks import checked
from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.records.reader import vehicle_scenario
from massprop_drake.records.recording import open_recording
from massprop_drake.records.tables import Loss
from massprop_drake.runners.recorded import estimate


@pytest.fixture(scope="module")
def one() -> Flight:
    return flight(load_vehicle("free_flyer"))


def refused(action: Callable[[], object]) -> str:
    with pytest.raises(InputError) as told:
        action()
    return str(told.value)


# ------------------------------------------------------------------------------------------ text


def test_csv(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    found = telemetry(path, usual_map(one), one.vehicle)
    require_the_flight(found, one)
    assert found["jet_T1"][-1] == one.commands[-1, 0]


def test_csv_with_semicolons_commas_units_and_remarks(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.txt", usual_columns(one), delimiter=";")
    lines = path.read_text(encoding="utf-8").replace(".", ",").splitlines()
    units = ";".join(["s"] * len(lines[0].split(";")))
    path.write_text(
        "\n".join(["logged by us", lines[0], units, *lines[1:3], "# stopped", *lines[3:]]), encoding="utf-8"
    )
    form = "csv: {separator: ';', decimal: ',', skip: 1, below: 1, comment: '#'}"
    require_the_flight(telemetry(path, usual_map(one, more=form), one.vehicle), one)
    message = refused(lambda: telemetry(path, usual_map(one, more=form.replace("below: 1, ", "")), one.vehicle))
    assert (
        message
        == f"{path}, line 3, column t: 's' is not a number; is it a line of units? Give `csv: {{below: 1}}` in the map"
    )


def test_a_row_cut_short_is_left_out_and_counted(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    path.write_text(path.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    made = made_of(path, usual_map(one), one.vehicle)
    assert (made.ragged.count, made.ragged.last_incomplete) == (1, True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty; expected a line of column names"),
        ("t,wx,wy,wz\n", "is empty: it has no row of data"),
        ("0,1,2,3\n0,1,2,3\n", "line 1: has numbers; expected a line of column names"),
        ("t,wx,wx,wz\n0,1,2,3\n", "line 1: column 'wx' appears twice; keep one of them"),
        ("t,wx\n" + "0,1\n" * 20 + "0,1,2\n" * 20, "20 of 40 rows have another number of cells than the 2 columns"),
        ("t,wx\n0,\0\n", "line 2: holds a NUL byte"),
        ("t,wx\n0,\xff\n", "not a text file in UTF-8"),
    ],
)
def test_no_table(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="latin-1")
    assert said in refused(lambda: open_recording(path))


def test_separators_other_than_the_maps_are_named(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one), delimiter=";")
    assert (
        refused(lambda: telemetry(path, usual_map(one), one.vehicle))
        == f"{path}, line 1: columns are separated by semicolons; give `csv: {{separator: ';'}}` in the map"
    )


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("t,wx\n0,1.5\n1,2\n", {}),
        ("t;wx\n0;1.5\n1;2\n", {"separator": ";"}),
        ("t;wx\n0;1\n1;2,5\n", {"separator": ";", "decimal": ","}),
        ("t\twx\n0\t1e3\n", {"separator": "\t"}),
        ("t\n0\n", {}),
    ],
)
def test_without_a_map_separator_and_decimal_mark_are_told_by_the_first_lines(
    text: str, form: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text, encoding="utf-8")
    assert open_recording(path).form.model_dump(exclude_defaults=True) == form


def test_what_is_no_number_is_told_by_its_line(one: Flight, tmp_path: Path) -> None:
    columns = usual_columns(one)
    columns["wy"] = [*map(str, columns["wy"][:-1]), "broken"]
    path = write_csv(tmp_path / "log.csv", columns)
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message == f"{path}, line 61, column wy: 'broken' is not a number"
    columns["wy"][-1] = "inf"
    write_csv(path, columns)
    assert "line 61, column wy: is infinite" in refused(lambda: telemetry(path, usual_map(one), one.vehicle))


def test_missing_columns_and_files(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    message = refused(lambda: telemetry(path, usual_map(one, time="{column: tt}"), one.vehicle))
    assert message.startswith(f"{path}: no column 'tt'")
    write_csv(path, {"clock_s" if name == "t" else name: values for name, values in usual_columns(one).items()})
    message = refused(lambda: telemetry(path, usual_map(one, time="{column: clok_s}"), one.vehicle))
    assert message == f"{path}: no column 'clok_s'; did you mean 'clock_s'?"  # which the map does not name
    assert refused(lambda: open_recording(tmp_path / "none.csv")) == f"{tmp_path / 'none.csv'}: no such file"
    assert "is a folder, and no ROS 2 bag" in refused(lambda: open_recording(tmp_path))
    other = tmp_path / "log.xls"
    other.write_bytes(b"x")
    assert "'.xls' is no ending of a record that is known; known are .bag, .csv" in refused(
        lambda: open_recording(other)
    )
    assert "not with standard input" in refused(lambda: open_recording("-"))


# --------------------------------------------------------------------------------------- Parquet


def test_parquet_with_vectors_and_lists_of_jets(one: Flight, tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415

    fired = [[jet for jet, on in zip(one.jets, row, strict=True) if on] for row in one.commands]
    stamps = pyarrow.array(
        (1_700_000_000_000_000_000 + np.round(one.time_s * 1e9)).astype(np.int64), pyarrow.timestamp("ns")
    )
    table = pyarrow.table(
        {
            "at": stamps,
            "w": pyarrow.array(one.rates.tolist(), pyarrow.list_(pyarrow.float64(), 3)),
            "v": one.velocities.tolist(),
            "fired": fired,
            "remark": ["x"] * len(fired),
        }
    )
    parquet.write_table(table, tmp_path / "log.parquet")
    text = usual_map(
        one,
        time="{column: at}",
        gyro="{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
        commands="{listed: {column: fired}}",
    )
    require_the_flight(telemetry(tmp_path / "log.parquet", text, one.vehicle), one)
    other = text.replace("column: fired", "column: remarks")
    message = refused(lambda: telemetry(tmp_path / "log.parquet", other, one.vehicle))
    assert message.endswith("no column 'remarks'; did you mean 'remark'?")  # which the map does not name
    (tmp_path / "bad.parquet").write_bytes((tmp_path / "log.parquet").read_bytes()[:-100])
    message = refused(lambda: open_recording(tmp_path / "bad.parquet"))
    assert message.endswith("it is cut off: its end is missing, which says where its columns are")


# ------------------------------------------------------------------------------------------ .mat


def in_structures(one: Flight) -> dict[str, object]:
    return {
        "imu": {"t": one.time_s, "w": np.degrees(one.rates), "v": {"sum": one.velocities}},
        "rcs": {"t": one.time_s, "u": one.commands},
        "scalar": 3.0,
    }


def mat_map(one: Flight) -> str:
    return usual_map(
        one,
        gyro="{kind: gyro, topic: imu, unit: deg/s, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, topic: imu, gives: integral, unit: m/s, "
        "columns: ['v.sum[0]', 'v.sum[1]', 'v.sum[2]']}",
        commands=f"{{topic: rcs, columns: {jet_columns(one, 'u[{}]', 0)}}}",
    )


def test_mat(one: Flight, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    savemat(tmp_path / "log.mat", in_structures(one))
    require_the_flight(telemetry(tmp_path / "log.mat", mat_map(one), one.vehicle), one)


def test_mat_of_loose_vectors_and_cells(one: Flight, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    cells = np.empty((len(one.time_s), 1), dtype=object)
    cells[:, 0] = [" ".join(jet for jet, on in zip(one.jets, row, strict=True) if on) for row in one.commands]
    idle = int(np.flatnonzero(one.commands.sum(axis=1) == one.commands.sum(axis=1).min())[0])
    before, cells[idle, 0] = cells[idle, 0], "none"
    variables = {"t": one.time_s, "w": one.rates, "v": one.velocities.T, "on": cells, "other": np.arange(7.0)}
    savemat(tmp_path / "log.mat", variables)
    text = usual_map(
        one,
        gyro="{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
        commands="{listed: {column: on}}",
    )
    assert "'none' is no jet's name" in refused(lambda: telemetry(tmp_path / "log.mat", text, one.vehicle))
    cells[idle, 0] = before
    savemat(tmp_path / "log.mat", variables)
    require_the_flight(telemetry(tmp_path / "log.mat", text, one.vehicle), one)


def test_mat_of_version_7_3(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    path = write_mat73(tmp_path / "log.mat", in_structures(one))
    require_the_flight(telemetry(path, mat_map(one), one.vehicle), one)
    path.write_bytes(path.read_bytes()[:3000])
    message = refused(lambda: open_recording(path))
    assert message == f"{path}: not a .mat file that can be read: it is cut off, and HDF5 gives nothing of such a file"


def test_no_mat(tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(b"nothing of the kind" * 20)
    assert "not a .mat file that can be read" in refused(lambda: open_recording(tmp_path / "log.mat"))


# ------------------------------------------------------------------------------------------ ULog


def ulog_map(one: Flight, more: str = "") -> str:
    columns = jet_columns(one, "control[{}]", 0)
    return (
        "sensors:\n"
        "  gyro: {kind: gyro, topic: vehicle_angular_velocity, columns: ['xyz[0]', 'xyz[1]', 'xyz[2]']}\n"
        "  acc: {kind: accelerometer, topic: vehicle_imu, gives: increment, unit: m/s,\n"
        "        columns: ['delta_velocity[0]', 'delta_velocity[1]', 'delta_velocity[2]']}\n"
        f"commands: {{topic: actuator_motors, missing: 'off', columns: {columns}}}\n{more}\n"
    )


def test_ulog(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {"CA_THRUSTER_CNT": 12})
    require_the_flight(telemetry(path, ulog_map(one), one.vehicle), one)
    found = open_recording(path)
    assert found.parameters == {"CA_THRUSTER_CNT": 12.0}
    assert set(found.topics) == {"vehicle_angular_velocity", "vehicle_imu", "actuator_motors", "cpuload"}


def test_a_second_instance_of_a_topic(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    topics = px4_topics(one)
    topics["vehicle_imu/1"] = topics["vehicle_imu"]
    topics["vehicle_imu"] = (one.time_s + 3.0, {"delta_velocity": one.rates})
    path = write_ulog(tmp_path / "log.ulg", topics, {})
    require_the_flight(telemetry(path, ulog_map(one).replace("vehicle_imu", "vehicle_imu/1"), one.vehicle), one)


def test_a_ulog_that_is_cut_off(one: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {})
    path.write_bytes(path.read_bytes()[:-7])
    said = f"{path}: is cut off: it ends within a message, 7 bytes short, which is left out"
    made = made_of(path, ulog_map(one), one.vehicle)
    assert made.losses == (Loss("truncated", said),)
    message = refused(lambda: telemetry(path, ulog_map(one, "cut_off: refuse"), one.vehicle))
    assert message == f"{said}; the map has `cut_off: refuse`"
    assert capsys.readouterr().out == ""  # what pyulog prints would spoil --json


def test_without_a_map_a_ulog_is_told_what_it_is(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {})
    scenario = vehicle_scenario("log", "orbiter")
    for read in (lambda: estimate(path, scenario), lambda: checked(str(path), None)):
        assert refused(read).startswith(
            f"{path}: is a ULog, and needs a map of what is in it: 'massprop map' proposes one"
        )
    path.write_bytes(b"ULog, but not of this kind")
    for read in (lambda: estimate(path, scenario), lambda: checked(str(path), None)):
        assert refused(read).startswith(f"{path}: not a ULog: it does not begin as one; besides, a ULog needs a map")
    assert refused(lambda: checked(str(tmp_path / "none.ulg"), None)) == f"{tmp_path}/none.ulg: no such file"


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "is empty"), (b"no log of this kind", "not a ULog"), (b"ULog\x01\x12\x35\x01" + bytes(8), "is empty")],
)
def test_no_ulog(content: bytes, said: str, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    (tmp_path / "log.ulg").write_bytes(content)
    assert said in refused(lambda: open_recording(tmp_path / "log.ulg"))


def test_a_topic_that_is_not_logged(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    topics = px4_topics(one)
    del topics["vehicle_imu"]
    path = write_ulog(tmp_path / "log.ulg", topics, {})
    message = refused(lambda: telemetry(path, ulog_map(one), one.vehicle))
    assert message.startswith(f"{path}: no topic 'vehicle_imu'; valid are: vehicle_angular_velocity, actuator_motors")


# ------------------------------------------------------------------------------------------ bags


def bag_map(one: Flight) -> str:
    return (
        "sensors:\n"
        "  gyro: {kind: gyro, topic: /imu, columns: [angular_velocity.x, angular_velocity.y, angular_velocity.z]}\n"
        "  acc: {kind: accelerometer, topic: /imu, gives: mean, unit: m/s^2,\n"
        "        columns: [linear_acceleration.x, linear_acceleration.y, linear_acceleration.z]}\n"
        f"commands: {{topic: /jets, columns: {jet_columns(one, 'data[{}]', 0)}}}\n"
    )


KINDS = (("ros1", "log.bag", "log.bag"), ("sqlite3", "log", "log/log.db3"), ("mcap", "log", "log/log.mcap"))


@pytest.mark.parametrize(("kind", "name", "file"), KINDS)
def test_bags(kind: str, name: str, file: str, one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / name, one, kind)
    found = telemetry(path, bag_map(one), one.vehicle)
    require_the_flight(found, one)
    assert abs(found["time_s"][0]) < 1e-9  # counted from the first message, by the header's clock
    if name != file:
        require_the_flight(telemetry(tmp_path / file, bag_map(one), one.vehicle), one)


def test_topics_of_a_bag(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / "log.bag", one, "ros1")
    message = refused(lambda: telemetry(path, bag_map(one).replace("/jets", "/jet"), one.vehicle))
    assert message == f"{path}: no topic '/jet'; did you mean '/jets'?"
    message = refused(lambda: telemetry(path, bag_map(one).replace("topic: /jets, ", ""), one.vehicle))
    assert message == f"{path}: has topics, and the map names none: give `topic`, one of /imu, /jets"
