"""Files of other programs: read as they are written, and as far as they are valid, which is said."""

from __future__ import annotations

import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Massprop
from record_probe import (
    ONE,
    as_map,
    bag_map,
    jet_columns,
    made_of,
    px4_topics,
    refused,
    require_the_flight,
    telemetry,
    ulog_map,
    usual_columns,
    usual_map,
    write_bag,
    write_csv,
    write_mat73,
    write_ulog,
)

from massprop_drake.records.completeness import Loss, completeness
from massprop_drake.records.recording import open_recording
from massprop_drake.records.structure_check import check
from massprop_drake.records.topics import Recording

ROWS = 60


def losses_of(found: Recording) -> str:
    return " | ".join(f"{loss.kind}: {loss.text}" for loss in found.losses)


def as_text(path: Path) -> tuple[Path, str]:
    """Semicolons, decimal commas, a line of units and remarks."""
    write_csv(path := path.with_suffix(".txt"), usual_columns(ONE), delimiter=";")
    lines = path.read_text(encoding="utf-8").replace(".", ",").splitlines()
    units = ";".join(["s"] * len(lines[0].split(";")))
    path.write_text("\n".join(["logged by us", lines[0], units, *lines[1:3], "# off", *lines[3:]]), encoding="utf-8")
    return path, usual_map(ONE, more="csv: {separator: ';', decimal: ',', skip: 1, below: 1, comment: '#'}")


VECTORS = {
    "gyro": "{kind: gyro, columns: ['w[0]', 'w[1]', 'w[2]']}",
    "acc": "{kind: accelerometer, gives: integral, unit: m/s, columns: ['v[0]', 'v[1]', 'v[2]']}",
}


def fired() -> list[list[str]]:
    return [[jet for jet, on in zip(ONE.jets, row, strict=True) if on] for row in ONE.commands]


def as_parquet(path: Path) -> tuple[Path, str]:
    """Stamps since 1970, vectors, and lists of jets."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415

    stamps = (1_700_000_000_000_000_000 + np.round(ONE.time_s * 1e9)).astype(np.int64)
    rates = pyarrow.array(ONE.rates.tolist(), pyarrow.list_(pyarrow.float64(), 3))
    columns = {"at": pyarrow.array(stamps, pyarrow.timestamp("ns")), "w": rates, "v": ONE.velocities.tolist()}
    table = pyarrow.table(columns | {"fired": fired(), "remark": ["x"] * ROWS})
    parquet.write_table(table, path := path.with_suffix(".parquet"))
    return path, usual_map(ONE, time="{column: at}", commands="{listed: {column: fired}}", **VECTORS)


def in_structures() -> tuple[dict[str, Any], str]:
    imu = {"t": ONE.time_s, "w": np.degrees(ONE.rates), "v": {"sum": ONE.velocities}}
    text = usual_map(
        ONE,
        gyro="{kind: gyro, topic: imu, unit: deg/s, columns: ['w[0]', 'w[1]', 'w[2]']}",
        acc="{kind: accelerometer, topic: imu, gives: integral, unit: m/s, "
        "columns: ['v.sum[0]', 'v.sum[1]', 'v.sum[2]']}",
        commands=f"{{topic: rcs, columns: {jet_columns(ONE, 'u[{}]', 0)}}}",
    )
    return {"imu": imu, "rcs": {"t": ONE.time_s, "u": ONE.commands}, "scalar": 3.0}, text


def as_mat(path: Path) -> tuple[Path, str]:
    from scipy.io import savemat  # noqa: PLC0415

    variables, text = in_structures()
    savemat(path := path.with_suffix(".mat"), variables)
    return path, text


def as_mat73(path: Path) -> tuple[Path, str]:
    pytest.importorskip("h5py")
    variables, text = in_structures()
    return write_mat73(path.with_suffix(".mat"), variables), text


def as_loose_mat(path: Path) -> tuple[Path, str]:
    """Vectors, and cells of names."""
    from scipy.io import savemat  # noqa: PLC0415

    cells = np.empty((ROWS, 1), dtype=object)
    cells[:, 0] = [" ".join(jets) for jets in fired()]
    variables = {"t": ONE.time_s, "w": ONE.rates, "v": ONE.velocities.T, "on": cells, "other": np.arange(7.0)}
    savemat(path := path.with_suffix(".mat"), variables)
    return path, usual_map(ONE, commands="{listed: {column: on}}", **VECTORS)


def as_ulog(path: Path) -> tuple[Path, str]:
    """The second instance of a topic holds the readings."""
    pytest.importorskip("pyulog")
    topics = px4_topics(ONE)
    topics["vehicle_imu/1"] = topics["vehicle_imu"]
    topics["vehicle_imu"] = (ONE.time_s + 3.0, {"delta_velocity": ONE.rates})
    write_ulog(path := path.with_suffix(".ulg"), topics, {"CA_THRUSTER_CNT": 12})
    assert open_recording(path).parameters == {"CA_THRUSTER_CNT": 12.0}
    return path, ulog_map(ONE).replace("vehicle_imu", "vehicle_imu/1")


def as_bag(kind: str, packed: str = "") -> Callable[[Path], tuple[Path, str]]:
    def write(path: Path) -> tuple[Path, str]:
        pytest.importorskip("rosbags")
        return write_bag(path.with_suffix(".bag") if kind == "ros1" else path, ONE, kind, packed), bag_map(ONE)

    return write


WRITTEN: dict[str, Callable[[Path], tuple[Path, str]]] = {
    **{"csv": lambda path: (write_csv(path.with_suffix(".csv"), usual_columns(ONE)), usual_map(ONE))},
    **{"text": as_text, "parquet": as_parquet, "mat": as_mat, "mat 7.3": as_mat73, "loose mat": as_loose_mat},
    **{"ulog": as_ulog, "ros1": as_bag("ros1"), "sqlite3": as_bag("sqlite3"), "mcap": as_bag("mcap")},
    **{f"sqlite3 {packed}": as_bag("sqlite3", packed) for packed in ("FILE", "MESSAGE")},
    **{f"mcap {packed}": as_bag("mcap", packed) for packed in ("FILE", "MESSAGE", "STORAGE")},
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_file_gives_the_flight_back(name: str, tmp_path: Path) -> None:
    path, text = WRITTEN[name](tmp_path / "log")
    found = telemetry(path, text, ONE.vehicle)
    require_the_flight(found, ONE)
    assert completeness(open_recording(path, as_map(text)).losses) == "complete"
    assert found["time_s"][0] == pytest.approx(3.0 if name == "ulog" else 0.0, abs=1e-9)  # not since 1970


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("log.csv", b"", "is empty; expected a line of column names"),
        ("log.csv", b"t,wx,wy,wz\n", "is empty: it has no row of data"),
        ("log.csv", b"0,1,2,3\n0,1,2,3\n", "line 1: has numbers; expected a line of column names"),
        ("log.csv", b"t,wx\n" + b"0,1\n" * 20 + b"0,1,2\n" * 20, "20 of 40 rows have another number of cells than the"),
        ("log.xls", b"x", "'.xls' is no ending of a record that is known; known are .bag, .csv"),
        ("log.mat", b"nothing of the kind" * 20, "not a .mat file that can be read"),
        ("log.ulg", b"no log of this kind", "not a ULog"),
        ("log.ulg", b"ULog\x01\x12\x35\x01" + bytes(8), "is empty"),
        ("log.bag", b"#ROS", "not"),
        ("log.db3", b"SQLite format 3\0" * 30, "is cut off"),
    ],
)
def test_what_is_no_record_is_refused(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    message = refused(lambda: open_recording(path))
    assert message.startswith(str(path))
    assert said in message


def test_what_does_not_go_with_the_map_is_named(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(ONE), delimiter=";")

    def said(text: str) -> str:
        return refused(lambda: telemetry(path, text, ONE.vehicle)).removeprefix(str(path))

    semicolons = "columns are separated by semicolons; give `csv: {separator: ';'}` in the map"
    assert said(usual_map(ONE)) == f", line 1: {semicolons}"
    columns = usual_columns(ONE) | {"wy": [*map(str, ONE.rates[:-1, 1]), "broken"]}
    write_csv(path, columns)
    assert said(usual_map(ONE)) == ", line 61, column wy: 'broken' is not a number"
    write_csv(path, usual_columns(ONE) | {"wx": [*ONE.rates[:-1, 0], 1e300]})
    assert "1e+300 is too large to mean anything" in said(usual_map(ONE))
    write_csv(path, {"clock_s" if name == "t" else name: values for name, values in usual_columns(ONE).items()})
    assert said(usual_map(ONE, time="{column: clok_s}")) == ": no column 'clok_s'; did you mean 'clock_s'?"
    path, text = as_text(tmp_path / "log")
    units = "line 3, column t: 's' is not a number; is it a line of units? Give `csv: {below: 1}` in the map"
    assert said(text.replace("below: 1, ", "")) == f", {units}"
    path, text = as_parquet(tmp_path / "log")
    assert said(text.replace("column: fired", "column: remarks")) == ": no column 'remarks'; did you mean 'remark'?"
    path, text = as_bag("ros1")(tmp_path / "log")
    assert said(text.replace("/jets", "/jet")) == ": no topic '/jet'; did you mean '/jets'?"
    none = ": has topics, and the map names none: give `topic`, one of /imu, /jets"
    assert said(text.replace("topic: /jets, ", "")) == none


@pytest.mark.parametrize("name", ["log.csv", "log.mcap", "log.ulg", "log"])
@pytest.mark.parametrize("command", ["map", "check", "estimate"])
def test_what_needs_a_map_or_is_no_file_is_told(name: str, command: str, massprop: Massprop, tmp_path: Path) -> None:
    vehicle = () if command == "check" else ("--vehicle", "free_flyer")
    os.mkfifo(tmp_path / name)
    done = massprop(command, tmp_path / name, *vehicle)
    assert (done.status, (done.err + done.out).count("\n")) == (2, 1)
    assert f"{tmp_path / name}: is a pipe, not a file" in done.err + done.out
    if name == "log.ulg" and command != "map":
        (tmp_path / name).unlink()
        write_ulog(tmp_path / name, px4_topics(ONE), {})
        done = massprop(command, tmp_path / name, *vehicle)
        needs = f"{tmp_path / name}: is a ULog, and needs a map of what is in it: 'massprop map' proposes one"
        assert done.status == 2
        assert needs in done.err + done.out


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A storage file of each kind; those of ROS 2 lie in their bag's folder."""
    pytest.importorskip("rosbags")
    folder = tmp_path_factory.mktemp("bags")
    return {
        "ros1": write_bag(folder / "log.bag", ONE, "ros1"),
        "sqlite3": write_bag(folder / "lite", ONE, "sqlite3") / "lite.db3",
        "mcap": write_bag(folder / "log", ONE, "mcap") / "log.mcap",
    }


def alone(bag: Path, folder: Path) -> Path:
    """A copy of a storage file, without what lies beside it."""
    return Path(shutil.copy(bag, folder / bag.name))


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_bag_is_read_as_far_as_it_goes(kind: str, bags: dict[str, Path], tmp_path: Path) -> None:
    path = alone(bags[kind], tmp_path)
    path.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    found = open_recording(path, as_map(bag_map(ONE)))
    assert completeness(found.losses) == "truncated", losses_of(found)
    assert f"{path}: is cut off" in losses_of(found)
    assert 0.2 * ROWS < found.topics["/jets"].rows <= ROWS
    require_the_flight(telemetry(path, bag_map(ONE), ONE.vehicle), ONE, rows=slice(found.topics["/imu"].rows))


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "ulog"])
def test_no_damage_is_more_than_bad_input(kind: str, bags: dict[str, Path], tmp_path: Path) -> None:
    """Eight files each, cut off or overwritten anywhere: read, or refused with one message."""
    path = as_ulog(tmp_path / "log")[0] if kind == "ulog" else alone(bags[kind], tmp_path)
    content, chance, refusals = path.read_bytes(), random.Random(kind), 0
    for number in range(8):
        damaged, place = bytearray(content), chance.randrange(len(content))
        if number % 2:
            del damaged[place:]
        else:
            size = min(chance.choice([1, 8, 300, 4096]), len(content) - place)
            damaged[place : place + size] = chance.randbytes(size)
        path.write_bytes(damaged)
        try:
            found = open_recording(path)
        except ValueError as error:
            refusals += 1
            assert str(error).startswith(f"{path}: ")  # noqa: PT017 (a refusal is one of two right answers)
        else:
            assert number % 2 == 0 or completeness(found.losses) == "truncated" or kind == "ulog"
    assert refusals < 8


def edited(bag: Path, folder: Path, *statements: str) -> Path:
    """A copy of a bag in SQLite with its database changed."""
    folder = Path(shutil.copytree(bag.parent, folder / "edited"))
    with sqlite3.connect(folder / bag.name) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    return folder


def test_what_the_recorder_counted_is_compared(bags: dict[str, Path], tmp_path: Path) -> None:
    folder = edited(bags["sqlite3"], tmp_path, "DELETE FROM messages WHERE id > 100")
    said = f"{folder}/metadata.yaml counted 120 messages, 100 were read: /imu 50 of 60, /jets 50 of 60"
    assert open_recording(folder, as_map(bag_map(ONE))).losses == (Loss("truncated", said),)
    (folder / "metadata.yaml").unlink()
    said = f"{folder}: has no metadata.yaml: the recorder did not finish it"
    assert open_recording(folder).losses == (Loss("truncated", said),)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: [", encoding="utf-8")
    assert losses_of(open_recording(folder)).startswith(f"damaged: {folder}/metadata.yaml: cannot be read: ")
    shutil.rmtree(folder)
    later = "UPDATE messages SET timestamp = timestamp + 4000000000 WHERE id = 120"
    folder = edited(bags["sqlite3"], tmp_path, "DELETE FROM messages WHERE id < 11", later)
    assert completeness(open_recording(folder).losses) == "damaged"  # its end is there


OTHERS = {
    "/health": ("my_msgs/msg/Health", bytes(8)),
    "/nothing": ("sensor_msgs/msg/Imu", b""),
    "/garbage": ("std_msgs/msg/String", bytes(range(200))),
}


def test_topics_that_nobody_asked_for_are_named_and_refuse_nothing(bags: dict[str, Path], tmp_path: Path) -> None:
    statements = ["UPDATE messages SET data = x'00010000' WHERE id IN (21, 23)"]  # two of /imu
    for number, (name, (msgtype, content)) in enumerate(OTHERS.items(), 10):
        statements.append(f"INSERT INTO topics VALUES({number}, '{name}', '{msgtype}', 'cdr', '', '')")
        for stamp in range(6):
            values = f"{number}, {1_700_000_000_000_000_000 + stamp}, x'{content.hex()}'"
            statements.append(f"INSERT INTO messages(topic_id, timestamp, data) VALUES({values})")
    folder = edited(bags["sqlite3"], tmp_path, *statements)
    found = open_recording(folder)
    assert {name: topic.rows for name, topic in found.topics.items()} == {"/imu": ROWS - 2, "/jets": ROWS}
    assert f"damaged: {folder}: 2 messages of /imu cannot be read, and left out: " in losses_of(found)
    for name, (msgtype, _) in OTHERS.items():
        assert any(f"topic {name}, of type {msgtype}, is left out: " in note for note in found.notes), name
    message = refused(lambda: telemetry(folder, bag_map(ONE).replace("/jets", "/health"), ONE.vehicle))
    why = "cannot be read: its type is not defined in the bag, and none of ROS 2's own"
    assert message == f"{folder}: topic /health, of type my_msgs/msg/Health, {why}"


def test_an_mcap_file_without_message_index(bags: dict[str, Path], tmp_path: Path) -> None:
    path = alone(bags["mcap"], tmp_path)
    content = path.read_bytes()
    place = int.from_bytes(content[-28:-20], "little")
    while content[place] != 0x08:
        place += 9 + int.from_bytes(content[place + 1 : place + 9], "little")
    size = int.from_bytes(content[place + 1 : place + 9], "little")
    body = content[place + 9 : place + 9 + size]
    body = body[:32] + bytes(12) + body[44 + int.from_bytes(body[32:36], "little") :]
    record = b"\x08" + len(body).to_bytes(8, "little") + body
    path.write_bytes(content[:place] + record + content[place + 9 + size :])
    assert losses_of(open_recording(path)) == ""
    require_the_flight(telemetry(path, bag_map(ONE), ONE.vehicle), ONE)


def test_a_ulog_that_is_cut_off_or_has_dropouts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, text = as_ulog(tmp_path / "log")
    content = path.read_bytes()
    path.write_bytes(content + 2 * (b"\x02\x00O" + (25).to_bytes(2, "little")))
    assert losses_of(open_recording(path)) == f"damaged: {path}: the logger dropped data 2 times, 50 ms in all"
    path.write_bytes(content[:-7])
    said = f"{path}: is cut off: it ends within a message, 7 bytes short, which is left out"
    assert made_of(path, text, ONE.vehicle).losses == (Loss("truncated", said),)
    message = refused(lambda: telemetry(path, f"{text}cut_off: refuse\n", ONE.vehicle))
    assert message == f"{said}; the map has `cut_off: refuse`"
    assert capsys.readouterr().out == ""  # what pyulog prints would spoil --json


CUT = "truncated: {}: is cut off within line 5, which is left out"


@pytest.mark.parametrize(
    ("ends", "rows", "said"),
    [
        ("0.3,1.5,2.5", 4, ""),  # nobody has to end the last line
        ("0.3,1.5,2.", 3, CUT),
        ("0.3", 3, CUT),
        ('0.3,1.5,"2', 3, CUT),
        ("0.3,1.5,2.5\n\0\0\0\0\0\0", 4, "truncated: {}: has nothing but zeros from line 6 on"),
        ("0.3,1\0\0\0\0\0\0", 3, "truncated: {}: has nothing but zeros from line 5 on | " + CUT),
        ("0.3,1\n0.4,1,2\n", 4, "damaged: {}: 1 row left out with a wrong number of cells, the first in line 5"),
    ],
)
def test_the_end_of_a_text_file(ends: str, rows: int, said: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a,b\n0.0,1.5,2.5\n0.1,1.5,2.5\n0.2,1.5,2.5\n" + ends, encoding="utf-8")
    found = open_recording(path)
    assert (found.topics[""].rows, losses_of(found)) == (rows, said.replace("{}", str(path)))
    by_reader = check(path)  # which is another
    assert (by_reader["rows"], by_reader["completeness"]) == (rows, completeness(found.losses))
    assert by_reader["completeness_detail"] == [loss.text for loss in found.losses]


def test_damaged_parts_of_a_parquet_file_are_left_out(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415

    path = tmp_path / "log.parquet"
    table = pyarrow.table({"time_s": ONE.time_s, "a": ONE.rates[:, 0]})
    parquet.write_table(table, path, row_group_size=20, write_page_checksum=True, compression="none", use_dictionary=[])
    content = bytearray(path.read_bytes())
    place = content.index(ONE.rates[30, 0].tobytes())
    content[place : place + 8] = bytes(8)
    path.write_bytes(content)
    found = open_recording(path)
    assert losses_of(found).startswith(f"damaged: {path}: rows 21 to 40 are damaged, and left out: ")
    assert (found.topics[""].rows, found.topics[""].where(20)) == (40, f"{path}, row 41")
    assert (check(path)["rows"], check(path)["completeness"]) == (40, "damaged")
    path.write_bytes(content[:-100])
    assert refused(lambda: open_recording(path)).endswith("its end is missing, which says where its columns are")


N = 30


def cells(*items: Any) -> Any:
    found = np.empty(len(items), dtype=object)
    found[:] = items
    return found


STRANGE = {
    "nested": (cells(*[cells(1.0, cells(2.0, 3.0))] * N), "x (cells in cells)"),
    "structures of arrays": (np.array([(np.zeros(4), 1.0)] * 3, dtype=[("a", "O"), ("b", "O")]), "x (structures)"),
    "cells in two dimensions": (np.array([[1.0, "a"]] * N, dtype=object), "x (cells in rows and columns)"),
    "short": (np.arange(5.0), "x (of 5 values)"),
    "in a structure": ({"a": np.arange(N), "d": cells(cells(1.0, 2.0), 3.0)}, "x.d (cells in cells)"),
}


@pytest.mark.parametrize("what", STRANGE)
def test_variables_that_give_no_columns_are_named(what: str, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(N) * 0.1, "w": np.zeros((N, 3)), "x": STRANGE[what][0]})
    found = open_recording(path)
    assert list(found.topics[""].columns) == ["t", "w[0]", "w[1]", "w[2]"]
    assert found.notes == (f"{path}: left out: {STRANGE[what][1]}",)
    if what == "nested":  # and nothing else
        savemat(path, {"x": STRANGE[what][0]})
        why = f"has no variable that gives columns: {STRANGE[what][1]}"
        assert refused(lambda: open_recording(path)) == f"{path}: {why}"


@pytest.mark.parametrize("compressed", [False, True])
def test_a_mat_file_that_is_cut_off_has_its_first_variables(compressed: bool, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path = tmp_path / "log.mat"
    noise = np.random.default_rng(1).random((N, 3))
    savemat(path, {"t": np.arange(N) * 0.1, "w": noise, "last": noise}, do_compression=compressed)
    content = bytearray(path.read_bytes())
    path.write_bytes(content[:-100])
    found = open_recording(path)
    assert list(found.topics[""].columns) == ["t", "w[0]", "w[1]", "w[2]"]
    assert found.losses == (Loss("truncated", f"{path}: is cut off: it ends within a variable, 100 bytes short"),)
    if compressed:  # which has a checksum
        content[-40] ^= 1
        path.write_bytes(content)
        assert losses_of(open_recording(path)).startswith(f"damaged: {path}: the variable that begins at byte ")
