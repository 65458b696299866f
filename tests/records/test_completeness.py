"""Records of which something is missing: read as far as they are valid, and said how far that is."""

from __future__ import annotations

import json
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
    Flight,
    as_map,
    flight,
    px4_topics,
    require_the_flight,
    telemetry,
    usual_columns,
    usual_map,
    write_bag,
    write_csv,
    write_ulog,
)

from massprop_drake.errors import InputError
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.records.reader import check, vehicle_scenario
from massprop_drake.records.recording import Recording, open_recording
from massprop_drake.records.tables import Loss, completeness
from massprop_drake.runners.recorded import estimate

ROWS = 60


@pytest.fixture(scope="module")
def one() -> Flight:
    return flight(load_vehicle("free_flyer"), ROWS)


def refused(action: Callable[[], object]) -> str:
    with pytest.raises(InputError) as told:
        action()
    return str(told.value)


def bag_map(one: Flight) -> str:
    jets = ", ".join(f"{jet}: 'data[{index}]'" for index, jet in enumerate(one.jets))
    return (
        "sensors:\n"
        "  gyro: {kind: gyro, topic: /imu, columns: [angular_velocity.x, angular_velocity.y, angular_velocity.z]}\n"
        "  acc: {kind: accelerometer, topic: /imu, gives: mean, unit: m/s^2,\n"
        "        columns: [linear_acceleration.x, linear_acceleration.y, linear_acceleration.z]}\n"
        f"commands: {{topic: /jets, columns: {{{jets}}}}}\n"
    )


def losses_of(found: Recording) -> str:
    return " | ".join(f"{one.kind}: {one.text}" for one in found.losses)


@pytest.fixture(scope="module")
def bags(one: Flight, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A storage file of each kind; those of ROS 2 lie in their bag's folder."""
    pytest.importorskip("rosbags")
    folder = tmp_path_factory.mktemp("bags")
    return {
        "ros1": write_bag(folder / "log.bag", one, "ros1"),
        "sqlite3": write_bag(folder / "lite", one, "sqlite3") / "lite.db3",
        "mcap": write_bag(folder / "log", one, "mcap") / "log.mcap",
    }


def alone(bag: Path, folder: Path) -> Path:
    """A copy of a storage file, without what lies beside it."""
    return Path(shutil.copy(bag, folder / bag.name))


# ------------------------------------------------------------------------------------------- bags


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("share", [0.6, 0.8, 0.95, 0.999])
def test_a_bag_that_is_cut_off_is_read_as_far_as_it_goes(
    kind: str, share: float, bags: dict[str, Path], one: Flight, tmp_path: Path
) -> None:
    path = alone(bags[kind], tmp_path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    found = open_recording(path, as_map(bag_map(one)))
    assert completeness(found.losses) == "truncated", losses_of(found)
    assert f"{path}: is cut off" in losses_of(found)
    rows = found.topics["/jets"].rows
    assert 0.2 * ROWS < rows <= ROWS
    require_the_flight(telemetry(path, bag_map(one), one.vehicle), one, rows=slice(found.topics["/imu"].rows))


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_damage_within_a_bag_costs_what_it_hits(kind: str, bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    path = alone(bags[kind], tmp_path)
    content = bytearray(path.read_bytes())
    half = len(content) // 2
    content[half : half + 900] = random.Random(3).randbytes(900)
    path.write_bytes(content)
    found = open_recording(path)
    assert completeness(found.losses) == "damaged"
    read = sum(topic.rows for topic in found.topics.values())
    assert f"{path}: its recorder counted 120 messages, " in losses_of(found)
    assert 40 < read < 120


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_nothing_is_left_of_a_beginning(kind: str, bags: dict[str, Path], tmp_path: Path) -> None:
    path = alone(bags[kind], tmp_path)
    content = path.read_bytes()
    for size in (0, 5, 40, 600):
        path.write_bytes(content[:size])
        message = refused(lambda: open_recording(path))
        assert message.startswith(f"{path}: is cut off" if size > 5 else f"{path}: {'not' if size else 'is empty'}")


def test_what_the_recorder_counted_is_compared(bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(bags["sqlite3"].parent, tmp_path / "lite"))
    file = folder / "lite.db3"
    with sqlite3.connect(file) as connection:
        connection.execute("DELETE FROM messages WHERE id > 100")
    connection.close()
    found = open_recording(folder, as_map(bag_map(one)))
    said = f"{folder}/metadata.yaml counted 120 messages, 100 were read: /imu 50 of 60, /jets 50 of 60"
    assert found.losses == (Loss("truncated", said),)
    alone_said = f"{folder}/metadata.yaml counted 120 messages in lite.db3, 100 were read"
    assert open_recording(file).losses == (Loss("truncated", alone_said),)
    with sqlite3.connect(file) as connection:
        connection.execute("DELETE FROM messages WHERE id < 11")
        connection.execute("UPDATE messages SET timestamp = timestamp + 4000000000 WHERE id = 100")
    connection.close()
    assert completeness(open_recording(folder).losses) == "damaged"  # its end is there


def with_pending_messages(bag: Path, folder: Path, mode: str) -> Path:
    """A bag of SQLite whose last messages are still in a file beside it, as after a recorder was killed."""
    folder = Path(shutil.copytree(bag, folder / f"killed_{mode}"))
    file = next(folder.glob("*.db3"))
    work = folder / "work.db3"
    file.rename(work)
    connection = sqlite3.connect(work, isolation_level=None)
    connection.execute(f"PRAGMA journal_mode={mode}")
    connection.execute("PRAGMA wal_autocheckpoint=0")
    if mode == "wal":
        rows = connection.execute("SELECT * FROM messages WHERE id > 80").fetchall()
        connection.execute("DELETE FROM messages WHERE id > 80")
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.executemany("INSERT INTO messages VALUES(?, ?, ?, ?)", rows)
    else:  # half of a transaction that deletes has reached the file
        connection.execute("PRAGMA cache_size=1")
        connection.execute("PRAGMA cache_spill=1")
        connection.execute("BEGIN")
        connection.execute("UPDATE messages SET data = zeroblob(400)")
    shutil.copy(work, file)
    beside = f"-{'wal' if mode == 'wal' else 'journal'}"
    shutil.copy(f"{work}{beside}", f"{file}{beside}")
    connection.close()
    for left in folder.glob("work.db3*"):
        left.unlink()
    return folder


@pytest.mark.parametrize("mode", ["wal", "delete"])
def test_messages_that_wait_beside_a_database_are_read(
    mode: str, bags: dict[str, Path], one: Flight, tmp_path: Path
) -> None:
    folder = with_pending_messages(bags["sqlite3"].parent, tmp_path, mode)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert len(before) == 3
    found = open_recording(folder)
    assert completeness(found.losses) == "complete"
    require_the_flight(telemetry(folder, bag_map(one), one.vehicle), one)
    require_the_flight(telemetry(folder / "lite.db3", bag_map(one), one.vehicle), one)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before  # nothing of it has changed


def test_a_recorder_that_was_killed_has_written_no_metadata(bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    for kind in ("sqlite3", "mcap"):
        folder = Path(shutil.copytree(bags[kind].parent, tmp_path / kind))
        (folder / "metadata.yaml").unlink()
        require_the_flight(telemetry(folder, bag_map(one), one.vehicle), one)
        said = f"{folder}: has no metadata.yaml: the recorder did not finish it"
        assert open_recording(folder).losses == (Loss("truncated", said),)
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: [", encoding="utf-8")
        assert losses_of(open_recording(folder)).startswith(f"damaged: {folder}/metadata.yaml: cannot be read: ")


def split(bag: Path, folder: Path, packed: bool) -> Path:
    """The bag in two files, each with half of the messages."""
    from ruamel.yaml import YAML  # noqa: PLC0415

    folder = Path(shutil.copytree(bag, folder / f"split_{packed}"))
    first = next(folder.glob("*.db3"))
    second = folder / "second.db3"
    shutil.copy(first, second)
    for file, lost in ((first, "> 60"), (second, "<= 60")):
        with sqlite3.connect(file) as connection:
            connection.execute(f"DELETE FROM messages WHERE id {lost}")
        connection.close()
    names = [first.name, second.name]
    yaml, path = YAML(typ="safe"), folder / "metadata.yaml"
    about = yaml.load(path)["rosbag2_bagfile_information"]
    if packed:
        zstd = pytest.importorskip("backports.zstd")
        for file in (first, second):
            Path(f"{file}.zst").write_bytes(zstd.compress(file.read_bytes()))
            file.unlink()
        names = [f"{name}.zst" for name in names]
        about |= {"compression_format": "zstd", "compression_mode": "FILE"}
    about["relative_file_paths"] = names
    about["files"] = [{"path": name, "message_count": 60} for name in names]
    with path.open("w", encoding="utf-8") as file:
        yaml.dump({"rosbag2_bagfile_information": about}, file)
    return folder


@pytest.mark.parametrize("packed", [False, True])
def test_a_bag_in_several_files(packed: bool, bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    folder = split(bags["sqlite3"].parent, tmp_path, packed)
    assert completeness(open_recording(folder).losses) == "complete"
    require_the_flight(telemetry(folder, bag_map(one), one.vehicle), one)
    second = next(folder.glob("second*"))
    if packed:  # a part that is cut off
        second.write_bytes(second.read_bytes()[:-500])
        assert f"truncated: {second}: is cut off: its compressed data do not end" in losses_of(open_recording(folder))
    stray = folder / f"stray{''.join(second.suffixes)}"
    second.rename(stray)
    found = open_recording(folder)
    assert losses_of(found).startswith(f"damaged: {second}: is not there, of 60 messages | truncated: ")
    assert found.notes[0] == f"{stray}: is not read: metadata.yaml does not name it"
    require_the_flight(telemetry(folder, bag_map(one), one.vehicle), one, rows=slice(30))


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "STORAGE"])
@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_compressed_bags(plugin: str, mode: str, one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    if (plugin, mode) == ("SQLITE3", "STORAGE"):
        pytest.skip("SQLite has none of its own")
    path = write_bag(tmp_path / "log", one, plugin.lower(), mode)
    found = open_recording(path)
    assert (completeness(found.losses), found.topics["/imu"].rows) == ("complete", ROWS)
    require_the_flight(telemetry(path, bag_map(one), one.vehicle), one)


# --------------------------------------------------------------- topics that nobody asked for


def with_more_topics(bag: Path, folder: Path, topics: dict[str, tuple[str, bytes]]) -> Path:
    """The bag with six messages more of each of some topics, by name: type and content."""
    folder = Path(shutil.copytree(bag, folder / "more"))
    with sqlite3.connect(next(folder.glob("*.db3"))) as connection:
        for number, (name, (msgtype, content)) in enumerate(topics.items(), 10):
            connection.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '', '')", (number, name, msgtype))
            for index in range(6):
                stamp = 1_700_000_000_000_000_000 + index
                row = (number, stamp, content)
                connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", row)
    connection.close()
    return folder


OTHERS = {
    "/rosout": ("rcl_interfaces/msg/Log", bytes(12)),
    "/health": ("my_msgs/msg/Health", bytes(8)),
    "/nothing": ("sensor_msgs/msg/Imu", b""),
    "/garbage": ("std_msgs/msg/String", bytes(range(200))),
}


def test_topics_that_nobody_asked_for_are_named_and_refuse_nothing(
    bags: dict[str, Path], one: Flight, massprop: Massprop, tmp_path: Path
) -> None:
    folder = with_more_topics(bags["sqlite3"].parent, tmp_path, OTHERS)
    require_the_flight(telemetry(folder, bag_map(one), one.vehicle), one)
    found = open_recording(folder)
    assert set(found.topics) == {"/imu", "/jets"}
    for name, (msgtype, _) in OTHERS.items():
        assert any(f"topic {name}, of type {msgtype}, is left out: " in note for note in found.notes), name
    done = massprop("map", folder, "--vehicle", "free_flyer")
    assert done.status == 0
    assert "topic: /jets" in done.out
    assert all(f"topic {name}, of type " in done.err for name in OTHERS)


def test_a_topic_that_the_map_names_and_nobody_can_read(bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    folder = with_more_topics(bags["sqlite3"].parent, tmp_path, OTHERS)
    message = refused(lambda: telemetry(folder, bag_map(one).replace("/jets", "/health"), one.vehicle))
    assert message == (
        f"{folder}: topic /health, of type my_msgs/msg/Health, cannot be read: its type is not defined in the bag, and "
        "none of ROS 2's own"
    )


def test_single_messages_that_cannot_be_read_are_counted(bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(bags["sqlite3"].parent, tmp_path / "lite"))
    with sqlite3.connect(folder / "lite.db3") as connection:
        connection.execute("UPDATE messages SET data = x'00010000' WHERE id IN (21, 23)")  # two of /imu
    connection.close()
    found = open_recording(folder, as_map(bag_map(one)))
    assert f"damaged: {folder}: 2 messages of /imu cannot be read, and left out: " in losses_of(found)
    assert (found.topics["/imu"].rows, found.topics["/jets"].rows) == (ROWS - 2, ROWS)


def without_index(content: bytes) -> bytes:
    """An MCAP file as a writer without message indexes leaves it: chunk indexes that name none."""
    index = content.index(b"\x08", int.from_bytes(content[-28:-20], "little"))
    place = int.from_bytes(content[-28:-20], "little")
    out = bytearray(content)
    while out[place] != 0x08:
        place += 9 + int.from_bytes(out[place + 1 : place + 9], "little")
    assert index <= place
    size = int.from_bytes(out[place + 1 : place + 9], "little")
    body = out[place + 9 : place + 9 + size]
    offsets = int.from_bytes(body[32:36], "little")
    body = body[:32] + bytes(4) + bytes(8) + body[36 + offsets + 8 :]
    return bytes(out[:place] + b"\x08" + len(body).to_bytes(8, "little") + body + out[place + 9 + size :])


def test_an_mcap_file_without_message_index(bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    path = alone(bags["mcap"], tmp_path)
    path.write_bytes(without_index(path.read_bytes()))
    found = open_recording(path)
    assert (losses_of(found), found.topics["/imu"].rows) == ("", ROWS)
    require_the_flight(telemetry(path, bag_map(one), one.vehicle), one)


# ------------------------------------------------------------------------------------------ ULog


def test_dropouts_of_a_ulog_are_counted(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {})
    path.write_bytes(path.read_bytes() + 2 * (b"\x02\x00O" + (25).to_bytes(2, "little")))
    found = open_recording(path)
    assert found.losses == (Loss("damaged", f"{path}: the logger dropped data 2 times, 50 ms in all"),)


# ---------------------------------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("ends", "rows", "said"),
    [
        ("0.3,1.5,2.5\n", 4, ""),
        ("0.3,1.5,2.5", 4, ""),  # nobody has to end the last line
        ("0.3,1.5,2.", 3, "truncated: {}: is cut off within line 5, which is left out"),
        ("0.3,1.5,-", 3, "truncated: {}: is cut off within line 5, which is left out"),
        ("0.3,1.", 3, "truncated: {}: is cut off within line 5, which is left out"),
        ("0.3", 3, "truncated: {}: is cut off within line 5, which is left out"),
        ("0.3,1.5,2.5\n\0\0\0\0\0\0", 4, "truncated: {}: has nothing but zeros from line 6 on"),
        (
            "0.3,1\0\0\0\0\0\0",
            3,
            "truncated: {}: has nothing but zeros from line 5 on | "
            "truncated: {}: is cut off within line 5, which is left out",
        ),
        (
            "0.3,1.5\n0.4,1.5,2.5\n",
            4,
            "damaged: {}: 1 row left out with a wrong number of cells, the first in line 5",
        ),
        ('0.3,1.5,"2', 3, "truncated: {}: is cut off within line 5, which is left out"),
    ],
)
def test_the_end_of_a_text_file(ends: str, rows: int, said: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a,b\n0.0,1.5,2.5\n0.1,1.5,2.5\n0.2,1.5,2.5\n" + ends, encoding="utf-8")
    found = open_recording(path)
    assert (found.topics[""].rows, losses_of(found)) == (rows, said.replace("{}", str(path)))
    telemetry_says = check(path)  # which is read by another reader
    assert telemetry_says["rows"] == rows
    assert telemetry_says["completeness"] == completeness(found.losses)
    assert telemetry_says["completeness_detail"] == [one.text for one in found.losses]


def test_a_map_may_refuse_what_is_cut_off(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    path.write_text(path.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    text = usual_map(one, more="cut_off: refuse")
    message = refused(lambda: telemetry(path, text, one.vehicle))
    assert message == f"{path}: is cut off within line 61, which is left out; the map has `cut_off: refuse`"


def test_damaged_parts_of_a_parquet_file_are_left_out(one: Flight, tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415

    path = tmp_path / "log.parquet"
    table = pyarrow.table({"time_s": one.time_s, "a": one.rates[:, 0]})
    parquet.write_table(table, path, row_group_size=20, write_page_checksum=True, compression="none", use_dictionary=[])
    content = bytearray(path.read_bytes())
    place = content.index(one.rates[30, 0].tobytes())
    content[place : place + 8] = bytes(8)
    path.write_bytes(content)
    found = open_recording(path)
    assert losses_of(found).startswith(f"damaged: {path}: rows 21 to 40 are damaged, and left out: ")
    assert found.topics[""].rows == 40
    assert found.topics[""].where(20) == f"{path}, row 41"
    again = check(path)
    assert (again["rows"], again["completeness"]) == (40, "damaged")


# ------------------------------------------------------------------------------------------ .mat


def _cells(*items: Any) -> Any:
    found = np.empty(len(items), dtype=object)
    found[:] = items
    return found


N = 30
STRANGE = {
    "nested": (_cells(*[_cells(1.0, _cells(2.0, 3.0))] * N), "x (cells in cells)"),
    "one nested": (_cells(1.0, _cells(2.0, 3.0)), "x (cells in cells)"),
    "mixed": (_cells(*[3.0, {"a": 1.0}] * (N // 2)), "x (cells in cells)"),
    "structures of arrays": (np.array([(np.zeros(4), 1.0)] * 3, dtype=[("a", "O"), ("b", "O")]), "x (structures)"),
    "cells in two dimensions": (np.array([[1.0, "a"]] * N, dtype=object), "x (cells in rows and columns)"),
    "complex": (np.exp(1j * np.arange(N)), "x (complex numbers)"),
    "cube": (np.zeros((N, 3, 3)), "x (of 30 x 3 x 3 values)"),
    "image": (np.zeros((N, 100)), "x (of more than 64 columns)"),
    "short": (np.arange(5.0), "x (of 5 values)"),
    "in a structure": ({"a": np.arange(N), "d": _cells(_cells(1.0, 2.0), 3.0)}, "x.d (cells in cells)"),
}


@pytest.mark.parametrize("what", STRANGE)
def test_variables_that_give_no_columns_are_named(what: str, massprop: Massprop, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(N) * 0.1, "w": np.zeros((N, 3)), "x": STRANGE[what][0]})
    found = open_recording(path)
    assert list(found.topics[""].columns) == ["t", "w[0]", "w[1]", "w[2]"]
    assert found.notes == (f"{path}: left out: {STRANGE[what][1]}",)
    done = massprop("map", path, "--vehicle", "free_flyer")
    assert (done.status, done.err.count("\n")) == (2, 2)  # no commands; and what is left out
    assert STRANGE[what][1] in done.err


def test_a_file_of_nothing_else_says_why_it_gives_no_columns(tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path = tmp_path / "log.mat"
    savemat(path, {"log": STRANGE["nested"][0], "runs": STRANGE["structures of arrays"][0]})
    why = "has no variable that gives columns: log (cells in cells), runs (structures)"
    assert refused(lambda: open_recording(path)) == f"{path}: {why}"


def test_structures_and_cells_of_a_row_each_are_columns(tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path, stamps = tmp_path / "log.mat", 1.7e9 + 0.1 * np.arange(N)
    rows = np.array([(stamp, 2.0) for stamp in stamps], dtype=[("t", "O"), ("u", "O")])
    fired = _cells(*["T1" if index % 2 else "" for index in range(N)])
    savemat(path, {"runs": rows, "cells": _cells(*stamps.tolist()), "fired": fired})
    found = open_recording(path)
    np.testing.assert_array_equal(found.topics["runs"].numbers("t"), stamps)
    np.testing.assert_array_equal(found.topics[""].numbers("cells"), stamps)
    assert found.topics[""].texts("fired")[:3] == ["", "T1", ""]


@pytest.mark.parametrize("compressed", [False, True])
def test_a_mat_file_that_is_cut_off_has_its_first_variables(compressed: bool, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    path = tmp_path / "log.mat"
    noise = np.random.default_rng(1).random((N, 3))
    savemat(path, {"t": np.arange(N) * 0.1, "w": noise, "last": noise}, do_compression=compressed)
    content = path.read_bytes()
    path.write_bytes(content[:-100])
    found = open_recording(path)
    assert list(found.topics[""].columns) == ["t", "w[0]", "w[1]", "w[2]"]
    assert found.losses == (Loss("truncated", f"{path}: is cut off: it ends within a variable, 100 bytes short"),)
    if compressed:  # which has a checksum
        damaged = bytearray(content)
        damaged[-40] ^= 1
        path.write_bytes(damaged)
        assert losses_of(open_recording(path)).startswith(f"damaged: {path}: the variable that begins at byte ")


# ------------------------------------------------------------------------------ whatever is damaged


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "ulog"])
def test_no_damage_is_more_than_bad_input(kind: str, bags: dict[str, Path], one: Flight, tmp_path: Path) -> None:
    """A dozen files each, cut off or overwritten anywhere: read, or refused with one message."""
    if kind == "ulog":
        pytest.importorskip("pyulog")
        path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {})
    else:
        path = alone(bags[kind], tmp_path)
    content, chance = path.read_bytes(), random.Random(kind)
    for number in range(12):
        damaged, place = bytearray(content), chance.randrange(len(content))
        if number % 2:
            del damaged[place:]
        else:
            size = min(chance.choice([1, 8, 300, 4096]), len(content) - place)
            damaged[place : place + size] = chance.randbytes(size)
        path.write_bytes(damaged)
        try:
            found = open_recording(path)
        except InputError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017 (a refusal is one of two right answers)
        else:
            assert number % 2 == 0 or completeness(found.losses) == "truncated" or kind == "ulog"


# ------------------------------------------------------------------------------------ commands


def test_a_run_says_how_complete_its_record_is(massprop: Massprop, tmp_path: Path, one: Flight) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    (tmp_path / "map.yaml").write_text(usual_map(one), encoding="utf-8")
    scenario = vehicle_scenario("log", "free_flyer")
    whole = estimate(path, scenario, record_map=tmp_path / "map.yaml").summary
    assert (whole["completeness"], whole["completeness_detail"]) == ("complete", [])
    how = ("--vehicle", "free_flyer", "--map", tmp_path / "map.yaml")
    path.write_text(path.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    done = massprop("estimate", path, *how, "--no-figures", "--out", tmp_path / "cut")
    said = f"{path}: is cut off within line 61, which is left out"
    assert (done.status, done.err) == (0, "")
    assert f"truncated:   {said}\n" in done.out
    summary = json.loads((tmp_path / "cut" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["completeness"], summary["completeness_detail"]) == ("truncated", [said])
    assert summary["data_quality"]["rows"] == ROWS - 1
    report = (tmp_path / "cut" / "report.html").read_text(encoding="utf-8")
    assert f"The record is truncated: {said}." in report


@pytest.mark.parametrize("name", ["log.csv", "log.parquet", "log.mcap", "log.ulg", "log"])
@pytest.mark.parametrize("command", ["map", "check", "estimate", "estimate --map"])
def test_a_pipe_is_no_record(name: str, command: str, massprop: Massprop, tmp_path: Path, one: Flight) -> None:
    os.mkfifo(tmp_path / name)
    (tmp_path / "map.yaml").write_text(usual_map(one), encoding="utf-8")
    more = (tmp_path / "map.yaml",) if command.endswith("--map") else ()
    verb, *options = command.split()
    done = massprop(verb, tmp_path / name, *([] if verb == "check" else ["--vehicle", "free_flyer"]), *options, *more)
    assert done.status == 2
    assert f"{tmp_path / name}: is a pipe, not a file" in done.err + done.out
    assert (done.err + done.out).count("\n") == 1


def test_fifty_thousand_columns(massprop: Massprop, tmp_path: Path, one: Flight) -> None:
    columns = usual_columns(one) | {f"c{index}": np.zeros(ROWS) for index in range(50_000)}
    path = write_csv(tmp_path / "log.csv", {name: values[:2] for name, values in columns.items()})
    done = massprop("map", path, "--vehicle", "free_flyer")
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1)
    assert f"{path}: has {50_000 + 19} columns, and a map is proposed for at most 4096" in done.err
    found = telemetry(path, usual_map(one), one.vehicle)  # a map says which of them matter
    np.testing.assert_array_equal(found["gyro_x"], one.rates[:2, 0])


@pytest.mark.parametrize(
    ("place", "number", "said"),
    [
        ("time", "{column: t, offset_s: 1e300}", "time.offset_s: input should be less than or equal to 10000000000"),
        ("time", "{column: t, offset_s: -1e300}", "time.offset_s: input should be greater than or equal to "),
        ("commands", "off: -1e300", "commands.off: input should be greater than or equal to"),
        ("commands", "on: 1e300", "commands.on: input should be less than or equal to"),
        ("commands", "threshold: -1e300", "commands.threshold: input should be greater than 0"),
        ("gyro", "zero: [1e300, 0, 0]", "sensor 'gyro' turns at up to 1e+300 rad/s"),
        ("gyro", "rotation: [[1e300, 0, 0], [0, 1, 0], [0, 0, 1]]", "rotation: its rows must be at right angles"),
    ],
)
def test_absurd_numbers_in_a_map_are_one_message(
    place: str, number: str, said: str, one: Flight, tmp_path: Path
) -> None:
    path = write_csv(tmp_path / "log.csv", usual_columns(one))
    usual = {"gyro": "{kind: gyro, columns: [wx, wy, wz], NUMBER}", "commands": "{NUMBER, columns: JETS}"}
    jets = "{" + ", ".join(f"{jet}: u{index + 1}" for index, jet in enumerate(one.jets)) + "}"
    part = usual.get(place, "NUMBER").replace("NUMBER", number).replace("JETS", jets)
    assert said in refused(lambda: telemetry(path, usual_map(one, **{place: part}), one.vehicle))


@pytest.mark.parametrize(("column", "what"), [("t", "its time, 1e+300 s,"), ("wx", "column gyro_x: 1e+300")])
def test_absurd_numbers_in_a_record_are_told_by_their_line(column: str, what: str, one: Flight, tmp_path: Path) -> None:
    columns = usual_columns(one)
    columns[column] = [*columns[column][:-1], 1e300]
    path = write_csv(tmp_path / "log.csv", columns)
    message = refused(lambda: telemetry(path, usual_map(one), one.vehicle))
    assert message.startswith(f"{path}, line 61")
    assert f"{what} is too large to mean anything" in message


def test_a_folder_of_a_bag_is_told_what_it_needs(bags: dict[str, Path], massprop: Massprop) -> None:
    folder = bags["mcap"].parent
    for command in (("check", folder), ("estimate", folder, "--vehicle", "free_flyer")):
        done = massprop(*command)
        assert done.status == 2
        assert (
            f"{folder}: is a ROS bag, and needs a map of what is in it: 'massprop map' proposes one"
            in done.out + done.err
        )
