"""Reading recorded telemetry: what is accepted, what is left out and counted, and what stops with a message."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again
from telemetry_probe import PERIOD_S, Log, toy_vehicle

from massprop_drake import InputError
from massprop_drake.inputs.vehicle_file import JetCommands, Vehicle
from massprop_drake.records.reader import (
    AT_STAMPS,
    WRENCH,
    Continuation,
    Reader,
    Rows,
    check,
    scenario_name,
    write_csv,
)


@pytest.fixture
def toy(toy_data: dict[str, Any]) -> Vehicle:
    return toy_vehicle(toy_data)


@pytest.fixture
def log(toy: Vehicle) -> Log:
    return Log(toy)


def _read(path: Path | str, vehicle: Vehicle, **options: Any) -> tuple[Rows, Reader]:
    reader = Reader(path, vehicle, gyro="gyro", **options)
    return _joined(list(reader)), reader


def _joined(blocks: list[Rows]) -> Rows:
    wrenches = [block.outside_wrench for block in blocks if block.outside_wrench is not None]
    return Rows(
        np.concatenate([block.time_s for block in blocks]),
        {name: np.vstack([block.readings[name] for block in blocks]) for name in blocks[0].readings},
        np.vstack([block.commands for block in blocks]),
        np.vstack(wrenches) if wrenches else None,
        np.concatenate([block.recorded for block in blocks]),
    )


def _assert_same(one: Rows, other: Rows) -> None:
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(one.commands, other.commands)
    np.testing.assert_array_equal(one.recorded, other.recorded)
    for name, values in one.readings.items():
        np.testing.assert_array_equal(values, other.readings[name])


# --------------------------------------------------------------------------------------- accepted


def test_a_log_reads_as_it_was_written(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    table = np.array(log.rows, dtype=float)
    np.testing.assert_array_equal(rows.time_s, table[:, 0])
    np.testing.assert_array_equal(rows.readings["gyro"], table[:, 1:4])
    np.testing.assert_array_equal(rows.readings["acc"], table[:, 4:7])
    np.testing.assert_array_equal(rows.commands, table[:, 7:])
    assert rows.recorded.all()
    assert rows.outside_wrench is None
    record = reader.record
    assert (record.rows, record.gaps, record.jitter, record.duplicates, record.backward) == (60, 0, 0, 0, 0)
    assert record.period_s == pytest.approx(PERIOD_S)
    assert record.missing == {"gyro": 0, "acc": 0}


@pytest.mark.parametrize("rows_per_block", [1, 2, 7, 59, 60, 61])
def test_the_size_of_blocks_does_not_matter(log: Log, toy: Vehicle, tmp_path: Path, rows_per_block: int) -> None:
    del log.rows[20:23]
    log.rows[31] = list(log.rows[30])
    for row in (3, 4, 40):
        log.set(row, "gyro_x", "")
    path = log.write(tmp_path / "log.csv")
    one, reader = _read(path, toy)
    other, again = _read(path, toy, rows_per_block=rows_per_block)
    _assert_same(one, other)
    assert vars(reader.record) | {"interval_sum_s": 0} == vars(again.record) | {"interval_sum_s": 0}
    assert reader.record.interval_sum_s == pytest.approx(again.record.interval_sum_s)


@pytest.mark.parametrize("seed", range(6))
def test_rows_taken_together_are_those_taken_one_by_one(log: Log, toy: Vehicle, tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    for row in sorted(random.choice(np.arange(2, 58), 12, replace=False).tolist(), reverse=True):
        what = random.integers(6)
        if what < 2:
            del log.rows[row]
        elif what == 2:
            log.rows.insert(row, list(log.rows[row]))
        elif what == 3:
            log.set(row, "time_s", "")
        elif what == 4:
            log.set(row, "time_s", str(float(log.rows[row][0]) + 0.03 * PERIOD_S))
        else:
            log.rows[row], log.rows[row + 1] = log.rows[row + 1], log.rows[row]
    path = log.write(tmp_path / "log.csv")
    together, reader = _read(path, toy)
    one_by_one, again = _read(path, toy, rows_per_block=1)
    _assert_same(together, one_by_one)
    assert vars(reader.record) == vars(again.record)  # to the last bit of the sums
    assert reader.record.gaps > 0


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.rstrip("\n"),
        lambda text: text.replace(",", " , "),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: re.sub(r"[^,\n]+", lambda cell: f'"{cell.group()}"', text),
    ],
    ids=["byte-order mark", "crlf", "cr", "no last newline", "blanks", "empty lines", "quotes"],
)
def test_ways_of_writing_csv(log: Log, toy: Vehicle, tmp_path: Path, change: Callable[[str], str]) -> None:
    expected, _ = _read(log.write(tmp_path / "log.csv"), toy)
    path = tmp_path / "other.csv"
    path.write_bytes(change(log.text()).encode())
    rows, _ = _read(path, toy)
    _assert_same(rows, expected)


def test_columns_come_in_any_order(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    expected, _ = _read(log.write(tmp_path / "log.csv"), toy)
    log.header.reverse()
    for row in log.rows:
        row.reverse()
    rows, _ = _read(log.write(tmp_path / "reversed.csv"), toy)
    _assert_same(rows, expected)


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NULL", "n/a", "-", "  "])
def test_missing_cells(log: Log, toy: Vehicle, tmp_path: Path, cell: str) -> None:
    log.set(5, "gyro_y", cell)
    log.set(6, "jet_J3", cell)
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert np.isnan(rows.readings["gyro"][5]).tolist() == [False, True, False]
    assert np.flatnonzero(np.isnan(rows.commands).any(axis=1)).tolist() == [6]
    assert reader.record.missing == {"gyro": 1, "acc": 0}


def test_a_fraction_beyond_its_range_by_rounding_is_taken_for_the_end_of_it(
    log: Log, toy: Vehicle, tmp_path: Path
) -> None:
    log.set(5, "jet_J3", "1.0000000001")
    log.set(6, "jet_J3", "-0.0000000001")
    rows, _ = _read(log.write(tmp_path / "log.csv"), toy)
    assert rows.commands[5:7, 2].tolist() == [1.0, 0.0]


def test_columns_not_used_are_named_with_what_may_have_been_meant(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.add("note", ["hello"] * 60)  # text does no harm there
    for axis in "xyz":
        log.drop(f"acc_{axis}")
        log.add(f"Acc_{axis}", ["0"] * 60)
    _, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert reader.record.unknown == {"note": "", "Acc_x": "acc_x", "Acc_y": "acc_y", "Acc_z": "acc_z"}
    assert reader.record.absent == ["acc"]


def test_a_package_that_the_log_lacks_is_missing_throughout(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    for axis in "xyz":
        log.drop(f"acc_{axis}")
    rows, _ = _read(log.write(tmp_path / "log.csv"), toy)
    assert np.isnan(rows.readings["acc"]).all()


def test_known_outside_forces(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    for index, name in enumerate(WRENCH):
        log.add(name, ["" if row == 3 else f"{row + 0.1 * index:g}" for row in range(60)])
    rows, _ = _read(log.write(tmp_path / "log.csv"), toy)
    assert rows.outside_wrench is not None
    np.testing.assert_allclose(rows.outside_wrench[2], [2.0, 2.1, 2.2, 2.3, 2.4, 2.5])  # torque, then force
    np.testing.assert_array_equal(rows.outside_wrench[3], np.zeros(6))  # an empty cell is zero


def test_accelerations_are_integrated_over_the_sample(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    for axis in "xyz":
        log.drop(f"acc_{axis}")
        log.add(f"acc_accel_{axis}", ["2.0"] * 60)
    log.set(4, "acc_accel_x", "")
    path = log.write(tmp_path / "log.csv")
    for rows_per_block in (1, 1024):
        rows, reader = _read(path, toy, rows_per_block=rows_per_block)
        velocity = rows.readings["acc"]
        np.testing.assert_allclose(velocity[:4, 0], [0.2, 0.4, 0.6, 0.8])  # V_k = V_k-1 + a_k T
        assert np.isnan(velocity[4]).tolist() == [True, False, False]
        np.testing.assert_allclose(velocity[5:7, 0], [1.0, 1.2])  # and on from there
        np.testing.assert_allclose(reader.velocity["acc"], [11.8, 12.0, 12.0])
        assert reader.record.unknown == {}


# ------------------------------------------------------------------------------------------- time


def test_time_may_start_anywhere(toy: Vehicle, tmp_path: Path) -> None:
    rows, reader = _read(Log(toy, start_s=1.7e9).write(tmp_path / "log.csv"), toy)
    assert (rows.time_s.size, reader.record.gaps) == (60, 0)


def test_jitter_is_accepted_and_counted(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.set(10, "time_s", "1.0049")
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert rows.recorded.all()
    assert (reader.record.jitter, reader.record.gaps) == (2, 0)  # late, and then early
    assert reader.record.largest_jitter_s == pytest.approx(0.0049)


def test_as_much_jitter_as_there_may_be_is_none_too_much_after_a_million_seconds(
    log: Log, toy: Vehicle, tmp_path: Path
) -> None:
    for row in range(60):
        log.set(row, "time_s", repr(1e6 + 0.1 * row + 0.005 * (row % 2)))
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert rows.recorded.all()
    assert (reader.record.jitter, reader.record.gaps) == (59, 0)


def test_rows_may_be_half_a_period_off_where_commands_switch_with_them(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    for row in range(60):
        log.set(row, "time_s", repr(0.1 * row + 0.02 * (row % 2)))
    path = log.write(tmp_path / "log.csv")
    assert _read(path, toy)[1].record.gaps == 59
    reader = Reader(path, toy, gyro="gyro")
    reader.jitter = AT_STAMPS
    assert all(rows.recorded.all() for rows in reader)
    assert reader.record.gaps == 0


@pytest.mark.parametrize(
    ("rows_lost", "length_s", "break_s"), [(1, 0.2, 3.0), (5, 0.6, 3.0)], ids=["one row", "five rows"]
)
def test_a_gap_is_marked_by_one_row_without_readings(
    log: Log, toy: Vehicle, tmp_path: Path, rows_lost: int, length_s: float, break_s: float
) -> None:
    del log.rows[30 : 30 + rows_lost]
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert np.flatnonzero(~rows.recorded).tolist() == [30]
    assert rows.time_s[30] == pytest.approx(break_s)
    assert (np.diff(rows.time_s) > 0.0).all()
    assert np.isnan(rows.readings["gyro"][30]).all()
    assert np.isnan(rows.commands[30]).all()
    record = reader.record
    assert (record.rows, record.gaps) == (60 - rows_lost, 1)
    assert record.longest_gap_s == record.gap_sum_s == pytest.approx(length_s)
    assert record.first_gaps == [(pytest.approx(2.9), pytest.approx(length_s))]


def test_an_interval_that_is_too_short_is_a_gap_as_well(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    for row in range(30, 60):
        log.set(row, "time_s", repr(0.1 * row - 0.04))
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert reader.record.gaps == 1
    assert rows.time_s[30] == pytest.approx(2.93)  # between the two


def test_rows_whose_time_does_not_go_on_are_left_out(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.rows.insert(30, list(log.rows[29]))
    log.rows.insert(40, list(log.rows[20]))
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert (rows.time_s.size, rows.recorded.all()) == (60, True)
    assert (reader.record.duplicates, reader.record.backward, reader.record.first_late_line) == (1, 1, 32)


def test_a_clock_that_has_been_set_back_stops(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.rows.extend([list(row) for row in log.rows[:30]])
    with pytest.raises(InputError, match=r"line 86: time_s has not gone beyond 5\.9 s for 25 rows, here 2\.4; has the"):
        _read(log.write(tmp_path / "log.csv"), toy)


@pytest.mark.parametrize(("factor", "found"), [(0.5, "0.05"), (10.0, "1"), (1000.0, "100")])
def test_another_sample_period_stops(log: Log, toy: Vehicle, tmp_path: Path, factor: float, found: str) -> None:
    for row in range(60):
        log.set(row, "time_s", repr(factor * 0.1 * row))
    path = log.write(tmp_path / "log.csv")
    with pytest.raises(InputError, match=rf"rows are {found} s apart, but the sample period of vehicle 'toy' is 0.1 s"):
        _read(path, toy)
    if factor == 1000.0:
        with pytest.raises(InputError, match="as with ms in place of s"):
            _read(path, toy)
    log.rows = log.rows[:5]  # fewer rows than it takes to be sure, but all there are
    with pytest.raises(InputError, match=f"rows are {found} s apart"):
        _read(log.write(path), toy)


def test_rows_without_a_time_are_left_out(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.set(30, "time_s", "")
    rows, reader = _read(log.write(tmp_path / "log.csv"), toy)
    assert (reader.record.without_time, reader.record.gaps) == (1, 1)
    assert rows.recorded.sum() == 59


def test_going_on_from_an_earlier_part(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    path = log.write(tmp_path / "log.csv")
    whole, _ = _read(path, toy)
    after = Continuation(float(whole.time_s[19]), np.full(12, np.nan), np.zeros(6), {})
    rows, reader = _read(path, toy, after=after)
    np.testing.assert_array_equal(rows.time_s, whole.time_s[20:])
    np.testing.assert_array_equal(reader.before[0], whole.commands[19])  # of the row there again
    assert (reader.record.before_start, reader.record.gaps, reader.record.duplicates) == (19, 0, 0)
    # without that row: the command that was saved
    log.rows = log.rows[20:]
    saved = after._replace(command=np.full(12, 0.5))
    rows, reader = _read(log.write(path), toy, after=saved)
    assert reader.record.gaps == 0
    np.testing.assert_array_equal(reader.before[0], saved.command)
    # later still: a gap
    log.rows = log.rows[5:]
    rows, reader = _read(log.write(path), toy, after=saved)
    assert (reader.record.gaps, rows.recorded[0]) == (1, False)
    with pytest.raises(InputError, match="has no usable row later than 9 s, where the earlier run ended"):
        _read(path, toy, after=saved._replace(time_s=9.0))


# ------------------------------------------------------------------------------------------ refused


def _with(change: Callable[[Log], Any]) -> Callable[[Log], str]:
    def changed(log: Log) -> str:
        change(log)
        return log.text()

    return changed


REFUSED: dict[str, tuple[Callable[[Log], str], str]] = {
    "empty file": (lambda _: "", r"log\.csv: is empty; expected a line of column names"),
    "empty lines": (lambda _: "\n\n", "is empty"),
    "header alone": (_with(lambda log: log.rows.clear()), "has no usable row; expected a row per sample"),
    "no header": (lambda log: log.text().split("\n", 1)[1], "line 1: has numbers; expected a line of column names"),
    "semicolons": (lambda log: log.text().replace(",", ";"), "separated by semicolons; expected commas"),
    "tabs": (lambda log: log.text().replace(",", "\t"), "separated by tabs; expected commas"),
    "text": (_with(lambda log: log.set(4, "gyro_z", "off")), r"line 6, column gyro_z: 'off' is not a number; leave"),
    "underscore": (_with(lambda log: log.set(4, "gyro_z", "1_0")), "line 6, column gyro_z: '1_0' is not a number"),
    "infinite": (_with(lambda log: log.set(4, "gyro_z", "-inf")), "line 6, column gyro_z: is infinite"),
    "too large": (_with(lambda log: log.set(4, "gyro_z", "1e999")), "line 6, column gyro_z: is infinite"),
    "huge": (_with(lambda log: log.set(4, "acc_z", "-1e13")), "column acc_z: -1e.13 is too large to mean anything"),
    "fraction": (
        _with(lambda log: log.set(4, "jet_J2", "1.5")),
        r"line 6, column jet_J2: 1.5 is no fraction of 0 to 1$",
    ),
    "negative": (_with(lambda log: log.set(4, "jet_J2", "-0.1")), "column jet_J2: -0.1 is no fraction of 0 to 1$"),
    "percent": (
        _with(lambda log: log.set(4, "jet_J2", "100")),
        "100 is no fraction of 0 to 1; the commands look",
    ),
    "twice": (_with(lambda log: log.add("gyro_x", ["0"] * 60)), "line 1: column 'gyro_x' appears twice; keep one"),
    "no time": (
        _with(lambda log: log.drop("time_s")),
        "no column time_s; vehicle 'toy' needs time_s, its",
    ),
    "all": (
        lambda log: log.text().replace("jet_", "valve_"),
        r"and 1?\d more.*; 'massprop map' proposes what another program's columns mean$",
    ),
    "no jet": (_with(lambda log: log.drop("jet_J7")), "no column jet_J7; vehicle"),
    "no gyro": (_with(lambda log: [log.drop(f"gyro_{a}") for a in "xyz"]), "no columns gyro_x, gyro_y, gyro_z; vehi"),
    "part of a gyro": (_with(lambda log: log.drop("gyro_y")), "no column gyro_y; vehicle"),
    "part of an accelerometer": (_with(lambda log: log.drop("acc_y")), "has column 'acc_x' but no 'acc_y'; give all"),
    "part of a force": (_with(lambda log: log.add("known_force_x", ["0"] * 60)), "has column 'known_force_x' but not"),
    "ragged": (
        _with(lambda log: [row.pop() for row in log.rows[:20]]),
        "11 of 11 rows have another number of cells than the 19",
    ),
    "NUL": (lambda log: log.text().replace("5.0", "5\0", 1), "holds a NUL byte"),
    "quotes": (lambda log: log.text().replace("\n0.4", '\n"0.4"x', 1), "line 6: not comma-separated values"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_used_is_told(log: Log, toy: Vehicle, tmp_path: Path, name: str) -> None:
    change, message = REFUSED[name]
    path = tmp_path / "log.csv"
    path.write_text(change(log), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        _read(path, toy)
    assert str(caught.value).startswith(str(path))


def test_a_misspelled_column_is_recognized(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.header[log.column("gyro_y")] = "gryo_y"
    with pytest.raises(InputError, match=r"no column gyro_y \(is 'gryo_y' meant to be 'gyro_y'\?\)"):
        _read(log.write(tmp_path / "log.csv"), toy)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32"])
def test_another_encoding_is_told(log: Log, toy: Vehicle, tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(log.text(), encoding=encoding)
    with pytest.raises(InputError, match=r"not a text file in UTF-8|NUL byte"):
        _read(path, toy)


def test_no_file_and_a_folder(toy: Vehicle, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.csv: no such file"):
        _read(tmp_path / "nowhere.csv", toy)
    with pytest.raises(InputError, match="is a folder; name a telemetry file"):
        _read(tmp_path, toy)
    with pytest.raises(InputError, match="has the character NUL"):
        _read("a\0b.csv", toy)


def test_a_line_without_end_is_refused(toy: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s," * 200_000, encoding="utf-8")
    with pytest.raises(InputError, match="line 1: is longer than a row of telemetry can be"):
        _read(path, toy)


def test_a_few_ragged_rows_are_left_out(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    log.rows[30].pop()
    log.rows[40].append("7")
    path = tmp_path / "log.csv"
    path.write_text(log.text()[:-20], encoding="utf-8")  # and the last row is cut
    rows, reader = _read(path, toy)
    assert rows.recorded.sum() == 57
    assert reader.ragged == (3, 32, True)


# ------------------------------------------------------------------------------- streams, Parquet


def test_rows_of_a_stream_are_handed_out_as_they_come(log: Log, toy: Vehicle) -> None:
    lines = log.text().splitlines(keepends=True)
    given = 0

    class Stream(io.RawIOBase):
        def readable(self) -> bool:
            return True

        def readinto(self, buffer: Any) -> int:
            nonlocal given
            if given == len(lines):
                return 0
            data = lines[given].encode()
            given += 1
            buffer[: len(data)] = data
            return len(data)

    reader = Reader("-", toy, gyro="gyro", stream=Stream())
    for number, rows in enumerate(reader, start=1):
        assert rows.time_s.size == 1
        assert given == number + 1  # the header and this row: the next has not been asked for
    assert number == 60


def test_parquet_reads_like_csv(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    log.set(7, "gyro_x", "nan")
    expected, _ = _read(log.write(tmp_path / "log.csv"), toy)
    columns = {name: [float(row[index]) for row in log.rows] for index, name in enumerate(log.header)}
    columns["gyro_x"] = [None if np.isnan(value) else value for value in columns["gyro_x"]]  # type: ignore[misc]
    columns["jet_J1"] = [value == 1.0 for value in columns["jet_J1"]]
    parquet.write_table(arrow.table(columns), tmp_path / "log.parquet", row_group_size=17)
    rows, reader = _read(tmp_path / "log.parquet", toy)
    _assert_same(rows, expected)
    assert reader.done == 1.0
    assert len(reader.sha256()) == 64
    columns["gyro_y"] = ["text"] * 60  # type: ignore[list-item]
    parquet.write_table(arrow.table(columns), tmp_path / "text.parquet")
    with pytest.raises(InputError, match="column gyro_y: holds string; expected numbers"):
        _read(tmp_path / "text.parquet", toy)
    columns["gyro_y"] = [float("inf")] * 60
    parquet.write_table(arrow.table(columns), tmp_path / "inf.parquet")
    with pytest.raises(InputError, match="row 1, column gyro_y: is infinite"):
        _read(tmp_path / "inf.parquet", toy)


def test_what_is_no_parquet_is_told(toy: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(InputError, match="not a Parquet file that can be read"):
        _read(path, toy)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"reading Parquet needs pyarrow: pip install 'massprop-drake\[parquet\]'"):
        _read(path, toy)


# ---------------------------------------------------------------------------------------- writing


def test_what_is_written_reads_back_and_gaps_stay_gaps(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    del log.rows[30:33]
    for name in WRENCH:
        log.add(name, ["0.25"] * 57)
    rows, _ = _read(log.write(tmp_path / "log.csv"), toy)
    write_csv(tmp_path / "again.csv", toy, [rows])
    again, _ = _read(tmp_path / "again.csv", toy)
    _assert_same(again, rows)
    np.testing.assert_array_equal(again.outside_wrench, rows.outside_wrench)


# --------------------------------------------------------------------------------------- checking


def test_check_says_what_is_in_a_log(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    del log.rows[30:33]
    path = log.write(tmp_path / "log.csv")
    found = check(path, toy)
    assert check(path) == found | {"period_s": pytest.approx(0.1)}
    assert (found["rows"], found["gaps"], found["late"]) == (57, 1, 0)
    assert found["period_s"] == pytest.approx(0.1)


def test_check_without_a_vehicle_looks_at_the_structure(log: Log, tmp_path: Path) -> None:
    log.header[0] = "Time_s"
    with pytest.raises(InputError, match=r"no column time_s \(is 'Time_s' meant to be 'time_s'\?\)"):
        check(log.write(tmp_path / "log.csv"))
    log.header[0] = "time_s"
    log.set(3, "jet_J1", "on")
    with pytest.raises(InputError, match="line 5, column jet_J1: 'on' is not a number"):
        check(log.write(tmp_path / "log.csv"))


@pytest.mark.parametrize(
    ("telemetry", "name"), [("a/my flight (2).csv", "my_flight_2_"), ("-", "stdin"), ("__.csv", "telemetry")]
)
def test_a_name_is_made_of_the_files(telemetry: str, name: str) -> None:
    assert scenario_name(telemetry) == name


# ------------------------------------------------------------------------------------- on-times


def told(log: Log, vehicle: Vehicle, value: float, *, as_time: bool = False, onset_s: float | None = None) -> Log:
    """The log whose first jet has one command in all rows, or on-time, and one onset."""
    jet = vehicle.designations[0]
    for row in range(60):
        log.set(row, f"jet_{jet}", repr(value))
    if as_time:
        log.header[log.column(f"jet_{jet}")] = f"on_{jet}_s"
    if onset_s is not None:
        log.add(f"onset_{jet}_s", [repr(onset_s)] * 60)
    return log


def test_on_times_in_seconds_are_shares_of_a_sample(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    path = told(log, toy, 0.25 * PERIOD_S, as_time=True).write(tmp_path / "log.csv")
    (rows,) = list(Reader(path, toy, gyro="gyro"))
    np.testing.assert_allclose(rows.commands[:, 0], 0.25, rtol=1e-12)
    assert rows.onsets_s is not None
    np.testing.assert_array_equal(rows.onsets_s[:, 0], 0.0)  # as the vehicle says: at the start
    late = again(toy, jet_commands=JetCommands(at="end"))
    (rows,) = list(Reader(path, late, gyro="gyro"))
    np.testing.assert_allclose(rows.onsets_s[:, 0], 0.75 * PERIOD_S, rtol=1e-12)


def test_onsets_are_read_and_written(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    onset_s = 0.1 * PERIOD_S
    path = told(log, toy, 0.5, onset_s=onset_s).write(tmp_path / "log.csv")
    (rows,) = list(Reader(path, toy, gyro="gyro"))
    assert rows.onsets_s is not None
    np.testing.assert_array_equal(rows.onsets_s[:, 0], onset_s)
    write_csv(tmp_path / "again.csv", toy, [rows])
    (second,) = list(Reader(tmp_path / "again.csv", toy, gyro="gyro"))
    np.testing.assert_array_equal(second.onsets_s, rows.onsets_s)
    np.testing.assert_array_equal(second.commands, rows.commands)


def test_jets_that_switch_with_samples_have_no_onsets(log: Log, toy: Vehicle, tmp_path: Path) -> None:
    (rows,) = list(Reader(log.write(tmp_path / "log.csv"), toy, gyro="gyro"))
    assert rows.onsets_s is None
    quick = again(toy, jet_commands=JetCommands.model_validate({"as": "on_time"}))
    (rows,) = list(Reader(tmp_path / "log.csv", quick, gyro="gyro"))
    assert rows.onsets_s is not None


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("on", 1.2, r"log\.csv, line 2, column on_.*_s: 0\.\d+ s is no on-time of 0 to .* s, the sample period"),
        ("on", -0.1, "is no on-time of 0 to"),
        ("onset", 0.6, r"line 2, column onset_.*_s: opens after .* s for .* s, which is not within the sample of"),
        ("onset", -0.1, "which is not within the sample"),
    ],
)
def test_times_that_are_not_within_a_sample_are_refused(
    column: str, value: float, message: str, log: Log, toy: Vehicle, tmp_path: Path
) -> None:
    if column == "on":
        told(log, toy, value * PERIOD_S, as_time=True)
    else:
        told(log, toy, 0.5, onset_s=value * PERIOD_S)
    path = log.write(tmp_path / "log.csv")
    with pytest.raises(InputError, match=message):
        list(Reader(path, toy, gyro="gyro"))
