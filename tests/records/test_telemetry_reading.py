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
from conftest import cube_data
from pose_probe import again
from telemetry_probe import PERIOD_S, Log, toy_vehicle

from massprop_drake import InputError, load_vehicle
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import JetCommands
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.control_rows import Thinning
from massprop_drake.records.reader import AT_STAMPS, Reader
from massprop_drake.records.rows import WRENCH, Continuation, Rows, scenario_name, telemetry_columns, write_csv
from massprop_drake.records.structure_check import check

TOY = toy_vehicle(cube_data())


class Written(Log):
    """The toy vehicle's log, and the file that it is written to."""

    def __init__(self, folder: Path):
        super().__init__(TOY)
        self.path = folder / "log.csv"

    def times(self, at: Callable[[int], float]) -> None:
        for row in range(len(self.rows)):
            self.set(row, "time_s", repr(at(row)))

    def read(self, vehicle: Vehicle = TOY, **options: Any) -> tuple[Rows, Reader]:
        return read(self.write(self.path), vehicle, **options)

    def refused(self, said: str, **options: Any) -> None:
        with pytest.raises(InputError, match=said) as caught:
            self.read(**options)
        assert str(caught.value).startswith(str(self.path))


@pytest.fixture
def log(tmp_path: Path) -> Written:
    return Written(tmp_path)


def read(path: Path | str, vehicle: Vehicle = TOY, gyro: str | None = "gyro", **options: Any) -> tuple[Rows, Reader]:
    """All rows together, and their reader."""
    reader = Reader(path, vehicle, gyro=gyro, **options)
    blocks = list(reader)

    def joined(parts: list[Any]) -> Any:
        return None if any(part is None for part in parts) else np.concatenate(parts)

    readings = {name: joined([block.readings[name] for block in blocks]) for name in blocks[0].readings}
    fields = {name: joined([getattr(block, name) for block in blocks]) for name in Rows._fields if name != "readings"}
    return Rows(readings=readings, **fields), reader


def require_same(one: Rows, other: Rows) -> None:
    for name, values in one._asdict().items():
        np.testing.assert_equal(getattr(other, name), values, err_msg=name)


def test_a_log_reads_as_it_was_written(log: Written) -> None:
    rows, reader = log.read()
    parts = (rows.time_s[:, None], rows.readings["gyro"], rows.readings["acc"], rows.commands)
    np.testing.assert_array_equal(np.hstack(parts), np.array(log.rows, dtype=float))
    assert rows.recorded.all()
    assert rows.outside_wrench is None
    record = reader.record
    assert (record.rows, record.gaps, record.jitter, record.duplicates, record.backward) == (60, 0, 0, 0, 0)
    assert (record.period_s, record.missing) == (pytest.approx(PERIOD_S), {"gyro": 0, "acc": 0})
    found = check(log.path, TOY)
    assert (found["rows"], found["gaps"], found["late"], found["period_s"]) == (60, 0, 0, pytest.approx(0.1))


@pytest.mark.parametrize("seed", range(4))
def test_the_size_of_blocks_does_not_matter(log: Written, seed: int) -> None:
    random = np.random.default_rng(seed)
    for row in sorted(random.choice(np.arange(2, 58), 12, replace=False).tolist(), reverse=True):
        match random.integers(7):
            case 0 | 1:
                del log.rows[row]
            case 2:
                log.rows.insert(row, list(log.rows[row]))
            case 3:
                log.set(row, "time_s", "")
            case 4:
                log.set(row, "time_s", str(float(log.rows[row][0]) + 0.03 * PERIOD_S))
            case 5:
                log.set(row, "gyro_x", "")
            case _:
                log.rows[row], log.rows[row + 1] = log.rows[row + 1], log.rows[row]
    together, reader = log.read()
    assert reader.record.gaps > 0
    for size in (1, 7):
        other, by_blocks = log.read(rows_per_block=size)
        require_same(together, other)
        sums = {"interval_sum_s": 0.0}
        assert vars(reader.record) | sums == vars(by_blocks.record) | sums
        assert reader.record.interval_sum_s == pytest.approx(by_blocks.record.interval_sum_s)


WAYS: dict[str, Callable[[str], str]] = {
    "byte-order mark": lambda text: "\ufeff" + text,
    "crlf": lambda text: text.replace("\n", "\r\n"),
    "cr": lambda text: text.replace("\n", "\r"),
    "no last newline": lambda text: text.rstrip("\n"),
    "blanks": lambda text: text.replace(",", " , "),
    "empty lines": lambda text: text.replace("\n", "\n\n"),
    "quotes": lambda text: re.sub(r"[^,\n]+", lambda cell: f'"{cell.group()}"', text),
    "order": lambda text: "\n".join(",".join(reversed(line.split(","))) for line in text.splitlines()),
}


@pytest.mark.parametrize("way", WAYS)
def test_ways_of_writing_csv(log: Written, tmp_path: Path, way: str) -> None:
    (tmp_path / "other.csv").write_bytes(WAYS[way](log.text()).encode())
    require_same(log.read()[0], read(tmp_path / "other.csv")[0])


def test_missing_cells_and_fractions_beyond_their_range_by_rounding(log: Written) -> None:
    for row, cell in enumerate(["", "NaN", "NULL", "n/a", "-", "  "], 5):
        log.set(row, "gyro_y", cell)
        log.set(row + 10, "jet_J3", cell)
    log.set(30, "jet_J3", "1.0000000001")
    log.set(31, "jet_J3", "-0.0000000001")
    rows, reader = log.read()
    np.testing.assert_array_equal(np.isnan(rows.readings["gyro"][5:11]), [[False, True, False]] * 6)
    assert np.flatnonzero(np.isnan(rows.commands).any(axis=1)).tolist() == [*range(15, 21)]
    assert reader.record.missing == {"gyro": 6, "acc": 0}
    assert rows.commands[30:32, 2].tolist() == [1.0, 0.0]


def test_accelerations_are_integrated_over_the_sample(log: Written) -> None:
    for axis in "xyz":
        log.drop(f"acc_{axis}")
        log.add(f"acc_accel_{axis}", ["2.0"] * 60)
    log.set(4, "acc_accel_x", "")
    for rows_per_block in (1, 1024):
        rows, reader = log.read(rows_per_block=rows_per_block)
        velocity = rows.readings["acc"]
        np.testing.assert_allclose(velocity[:4, 0], [0.2, 0.4, 0.6, 0.8])  # V_k = V_k-1 + a_k T
        assert np.isnan(velocity[4]).tolist() == [True, False, False]
        np.testing.assert_allclose(velocity[5:7, 0], [1.0, 1.2])  # and on from there
        np.testing.assert_allclose(reader.velocity["acc"], [11.8, 12.0, 12.0])


def test_jitter_is_accepted_and_counted(log: Written) -> None:
    log.set(10, "time_s", "1.0049")
    rows, reader = log.read()
    assert rows.recorded.all()
    assert (reader.record.jitter, reader.record.gaps) == (2, 0)  # late, and then early
    assert reader.record.largest_jitter_s == pytest.approx(0.0049)
    log.times(lambda row: 1e6 + 0.1 * row + 0.005 * (row % 2))  # none too much after a million seconds
    record = log.read()[1].record
    assert (record.jitter, record.gaps) == (59, 0)
    log.times(lambda row: 0.1 * row + 0.02 * (row % 2))
    assert log.read()[1].record.gaps == 59
    reader = Reader(log.path, TOY, gyro="gyro")
    reader.jitter = AT_STAMPS  # where commands switch with the rows, these may be half a period off
    assert all(rows.recorded.all() for rows in reader)
    assert reader.record.gaps == 0


@pytest.mark.parametrize(("rows_lost", "length_s"), [(1, 0.2), (5, 0.6)])
def test_a_gap_is_marked_by_one_row_without_readings(log: Written, rows_lost: int, length_s: float) -> None:
    del log.rows[30 : 30 + rows_lost]
    rows, reader = log.read()
    assert np.flatnonzero(~rows.recorded).tolist() == [30]
    assert rows.time_s[30] == pytest.approx(3.0)
    assert (np.diff(rows.time_s) > 0.0).all()
    assert np.isnan([*rows.readings["gyro"][30], *rows.commands[30]]).all()
    record = reader.record
    assert (record.rows, record.gaps) == (60 - rows_lost, 1)
    assert record.longest_gap_s == record.gap_sum_s == pytest.approx(length_s)
    assert record.first_gaps == [(pytest.approx(2.9), pytest.approx(length_s))]


def test_an_interval_that_is_too_short_is_a_gap_as_well(log: Written) -> None:
    log.times(lambda row: 0.1 * row - 0.04 * (row >= 30))
    rows, reader = log.read()
    assert (reader.record.gaps, rows.time_s[30]) == (1, pytest.approx(2.93))  # between the two


def test_rows_whose_time_does_not_go_on_are_left_out(log: Written) -> None:
    log.set(50, "time_s", "")
    log.rows.insert(30, list(log.rows[29]))
    log.rows.insert(40, list(log.rows[20]))
    rows, reader = log.read()
    record = reader.record
    assert (rows.recorded.sum(), record.gaps, record.without_time) == (59, 1, 1)
    assert (record.duplicates, record.backward, record.first_late_line) == (1, 1, 32)
    log.rows.extend([list(row) for row in log.rows[:30]])
    log.refused(r"time_s has not gone beyond 5\.9 s for 25 rows, here 2\.4; has the")


@pytest.mark.parametrize(("factor", "found"), [(0.5, "0.05"), (1000.0, "100 s apart*as with ms in place of s")])
def test_another_sample_period_stops(log: Written, factor: float, found: str) -> None:
    log.times(lambda row: factor * 0.1 * row)
    pattern = f"rows are {found}".replace("*", ".*")
    log.refused(pattern)
    log.rows = log.rows[:5]  # fewer rows than it takes to be sure, but all there are
    log.refused(pattern)


def test_going_on_from_an_earlier_part(log: Written) -> None:
    whole, _ = log.read()
    after = Continuation(float(whole.time_s[19]), np.full(12, np.nan), np.zeros(6), {})
    rows, reader = log.read(previous=after)
    np.testing.assert_array_equal(rows.time_s, whole.time_s[20:])
    np.testing.assert_array_equal(reader.before[0], whole.commands[19])  # of the row there again
    assert (reader.record.before_start, reader.record.gaps, reader.record.duplicates) == (19, 0, 0)
    # without that row: the command that was saved
    log.rows = log.rows[20:]
    saved = after._replace(command=np.full(12, 0.5))
    rows, reader = log.read(previous=saved)
    assert reader.record.gaps == 0
    np.testing.assert_array_equal(reader.before[0], saved.command)
    log.rows = log.rows[5:]  # later still: a gap
    rows, reader = log.read(previous=saved)
    assert (reader.record.gaps, rows.recorded[0]) == (1, False)
    log.refused("has no usable row later than 9 s, where the earlier run ended", previous=saved._replace(time_s=9.0))


def put(row: int, name: str, cell: str) -> Callable[[Log], str]:
    def text(log: Log) -> str:
        log.set(row, name, cell)
        return log.text()

    return text


def without(*names: str) -> Callable[[Log], str]:
    def text(log: Log) -> str:
        for name in names:
            log.drop(name)
        return log.text()

    return text


REFUSED: dict[str, tuple[Callable[[Log], str], str]] = {
    "empty": (lambda _: "", r"log\.csv: is empty; expected a line of column names"),
    "no header": (lambda log: log.text().split("\n", 1)[1], "line 1: has numbers; expected a line of column names"),
    "text": (put(4, "gyro_z", "off"), r"line 6, column gyro_z: 'off' is not a number; leave"),
    "infinite": (put(4, "gyro_z", "1e999"), "line 6, column gyro_z: is infinite"),
    "negative": (put(4, "jet_J2", "-0.1"), "column jet_J2: -0.1 is no fraction of 0 to 1$"),
    "percent": (put(4, "jet_J2", "100"), "100 is no fraction of 0 to 1; the commands look"),
    "misspelled": (lambda log: log.text().replace("gyro_y", "gryo_y"), r"gyro_y \(is 'gryo_y' meant to be 'gyro_y'\?"),
    "all": (lambda log: log.text().replace("jet_", "valve_"), r"and 1?\d more.*; 'massprop map' proposes what another"),
    "no gyro": (without("gyro_x", "gyro_y", "gyro_z"), "no columns gyro_x, gyro_y, gyro_z; vehi"),
    "part of one": (without("acc_y"), "has column 'acc_x' but no 'acc_y'; give all"),
    "quotes": (lambda log: log.text().replace("\n0.4", '\n"0.4"x', 1), "line 6: not comma-separated values"),
    "no end": (lambda log: "time_s," * 200_000, "line 1: is longer than a row of telemetry can be"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_told(log: Written, name: str) -> None:
    change, message = REFUSED[name]
    log.path.write_text(change(log), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read(log.path)
    assert str(caught.value).startswith(str(log.path))


def test_other_encodings_and_what_is_no_file_are_told(log: Written, tmp_path: Path) -> None:
    log.path.write_text(log.text(), encoding="utf-16")
    for name, said in (
        ("log.csv", r"not a text file in UTF-8|NUL byte"),
        ("nowhere.csv", "no such file"),
        ("", "is a folder; name a telemetry file"),
        ("a\0b.csv", "has the character NUL"),
    ):
        with pytest.raises(InputError, match=said):
            read(tmp_path / name)
    log.set(3, "jet_J1", "on")  # also by the structure alone
    with pytest.raises(InputError, match="line 5, column jet_J1: 'on' is not a number"):
        check(log.write(log.path))
    named = {"a/my flight (2).csv": "my_flight_2_", "-": "stdin", "__.csv": "telemetry"}
    assert {name: scenario_name(name) for name in named} == named


def test_rows_of_a_stream_are_handed_out_as_they_come(log: Written) -> None:
    lines, given = log.text().splitlines(keepends=True), 0

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

    reader = Reader("-", TOY, gyro="gyro", stream=Stream())
    for number, rows in enumerate(reader, start=1):
        assert rows.time_s.size == 1
        assert given == number + 1  # the header and this row: the next has not been asked for
    assert number == 60


def test_parquet_reads_like_csv(log: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    log.set(7, "gyro_x", "nan")
    table: dict[str, list[Any]] = {
        name: [float(row[place]) for row in log.rows] for place, name in enumerate(log.header)
    }
    table["gyro_x"][7] = None
    table["jet_J1"] = [value == 1.0 for value in table["jet_J1"]]
    path = tmp_path / "log.parquet"
    parquet.write_table(arrow.table(table), path, row_group_size=17)
    rows, reader = read(path)
    require_same(rows, log.read()[0])
    assert (reader.done, len(reader.sha256())) == (1.0, 64)
    values = {"holds string; expected": "text", "is infinite": float("inf"), "4.*is too large to": 2**62}
    for said, value in values.items():
        parquet.write_table(arrow.table(table | {"gyro_y": [value] * 60}), path)
        with pytest.raises(InputError, match=f"column gyro_y: {said}"):
            read(path)
    path.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(InputError, match="not a Parquet file that can be read"):
        read(path)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"reading Parquet needs pyarrow: pip install 'massprop-drake\[parquet\]'"):
        read(path)


def test_what_is_written_reads_back(log: Written, tmp_path: Path) -> None:
    del log.rows[30:33]  # a gap stays a gap
    for index, name in enumerate(WRENCH):
        log.add(name, ["" if row == 3 else f"{row + 0.1 * index:g}" for row in range(57)])
    log.add("onset_J1_s", [repr(0.1 * PERIOD_S)] * 57)
    for row in range(57):
        log.set(row, "jet_J1", "0.5")
    rows, _ = log.read()
    assert rows.outside_wrench is not None
    np.testing.assert_allclose(rows.outside_wrench[2], [2.0, 2.1, 2.2, 2.3, 2.4, 2.5])  # torque, then force
    np.testing.assert_array_equal(rows.outside_wrench[3], np.zeros(6))  # an empty cell is zero
    assert rows.onsets_s is not None
    np.testing.assert_array_equal(rows.onsets_s[:30, 0], 0.1 * PERIOD_S)
    write_csv(tmp_path / "again.csv", TOY, [rows])
    require_same(read(tmp_path / "again.csv")[0], rows)


def test_on_times_in_seconds_are_shares_of_a_sample(log: Written) -> None:
    assert log.read()[0].onsets_s is None  # of jets that switch with samples
    assert log.read(again(TOY, jet_commands=JetCommands.model_validate({"as": "on_time"})))[0].onsets_s is not None
    for row in range(60):
        log.set(row, "jet_J1", repr(0.25 * PERIOD_S))
    log.header[log.column("jet_J1")] = "on_J1_s"
    rows, _ = log.read()
    np.testing.assert_allclose(rows.commands[:, 0], 0.25, rtol=1e-12)
    np.testing.assert_array_equal(rows.onsets_s[:, 0], 0.0)  # as the vehicle says: at the start
    rows, _ = log.read(again(TOY, jet_commands=JetCommands(at="end")))
    np.testing.assert_allclose(rows.onsets_s[:, 0], 0.75 * PERIOD_S, rtol=1e-12)
    for share, said in ((1.2, r"line 2, column on_J1_s: 0\.12 s is no on-time of 0 to 0\.1 s, the"), (-0.1, "no on-t")):
        log.set(0, "on_J1_s", repr(share * PERIOD_S))
        log.refused(said)


FLYER = load_vehicle("tracked_flyer")


def table_at(times: Array) -> dict[str, Array]:
    """Numbers that have nothing in common, with a quaternion that is one."""
    random = np.random.default_rng(3)
    found = {name: random.standard_normal(times.size) for name in telemetry_columns(FLYER)}
    found |= {name: (values < 0.3).astype(float) for name, values in found.items() if name.startswith("jet_")}
    return found | {f"cameras_q{part}": np.full(times.size, float(part == "w")) for part in "wxyz"} | {"time_s": times}


def written(path: Path, cells: dict[str, Array]) -> Path:
    lines = [",".join(cells)]
    for row in np.column_stack(list(cells.values())):
        lines.append(",".join("" if np.isnan(cell) else repr(float(cell)) for cell in row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_rows_may_come_at_any_time_and_read_back(tmp_path: Path) -> None:
    cells = table_at(17.0 + np.cumsum(np.random.default_rng(4).uniform(0.01, 0.2, 50)))
    cells["cameras_x"][2] = cells["cameras_qx"][3] = np.nan  # nothing read
    rows, reader = read(written(tmp_path / "log.csv", cells), FLYER, None)
    np.testing.assert_array_equal(rows.time_s, cells["time_s"])
    tracked = [f"cameras_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    np.testing.assert_array_equal(rows.tracked, np.column_stack([cells[name] for name in tracked]))
    assert reader.record.gaps == 0
    write_csv(tmp_path / "again.csv", FLYER, [rows])
    require_same(read(tmp_path / "again.csv", FLYER, None)[0], rows)
    alone = {name: values for name, values in cells.items() if "_q" not in name}  # position is enough to read
    assert np.isnan(read(written(tmp_path / "log.csv", alone), FLYER, None)[0].tracked[:, 3:]).all()


@pytest.mark.parametrize(("step", "gaps"), [(0.24, 0), (0.26, 1), (3.0, 1)])
def test_more_than_two_and_a_half_periods_without_a_row_are_a_gap(step: float, gaps: int, tmp_path: Path) -> None:
    times = np.array([0.0, 0.1, 0.1, 0.05, 0.2, 0.2 + step, 0.3 + step])
    rows, reader = read(written(tmp_path / "log.csv", table_at(times)), FLYER, None)
    assert (reader.record.gaps, reader.record.duplicates, reader.record.backward) == (gaps, 1, 1)
    assert rows.time_s.size == 5 + gaps
    for filled in np.flatnonzero(~rows.recorded):
        assert rows.time_s[filled] == pytest.approx(0.2 + min(0.1, 0.5 * step))
        assert np.isnan(rows.tracked[filled]).all()


SERVICER = load_vehicle("servicer")


def own(path: Path, told: dict[float, str], times: list[float]) -> tuple[Rows, Reader]:
    """Reads rates at all times, and commands where they are told: one jet's is 1, or none."""
    names = ["time_s", *(f"{name}_{axis}" for name in ("gyro", "acc") for axis in "xyz")]
    cells = {name: np.full(len(times), np.nan if name.startswith("acc") else 0.0) for name in names}
    cells["time_s"] = np.array(times)
    for jet in SERVICER.designations:
        cells[f"jet_{jet}"] = np.array([float(told[time] == jet) if time in told else np.nan for time in times])
    reader = Reader(written(path, cells), SERVICER, gyro="gyro")
    reader.own_times = True
    (block,) = list(reader)
    return block, reader


def test_commands_hold_in_rows_that_have_none_for_about_a_period(tmp_path: Path) -> None:
    times, path = [0.02 * k for k in range(9)], tmp_path / "log.csv"
    first, second = (SERVICER.designations.index(jet) for jet in ("XP1", "XP2"))
    rows, reader = own(path, {0.0: "XP1"}, times)
    np.testing.assert_array_equal(rows.commands[:6, first], 1.0)
    assert np.isnan(rows.commands[6:]).all()  # 0.12 s and later: not known
    np.testing.assert_array_equal(rows.told, [True] + [False] * 8)
    assert reader.record.missing == {"gyro": 0, "acc": 0}
    every = [0.02 * k for k in range(200) if k not in (50, 51, 52, 100)]  # readings lack by their own cadence
    assert own(path, dict.fromkeys(every[::5], ""), every)[1].record.missing["gyro"] == 4
    rows, _ = own(path, {0.0: "XP1", times[3]: "XP2"}, times)
    np.testing.assert_array_equal(rows.commands[:6, [first, second]], [[1, 0]] * 3 + [[0, 1]] * 3)


def test_thinned_rows_are_those_with_commands_a_period_apart() -> None:
    times, told = 0.02 * np.arange(21), np.arange(21) % 5 == 0
    rows = Rows(times, {"gyro": np.zeros((21, 3))}, np.zeros((21, 1)), None, np.ones(21, dtype=bool), told=told)
    chosen, signals = Thinning(PERIOD_S, ["gyro"]).select(rows, {"alarm": np.arange(21)[:, None]})
    np.testing.assert_allclose(chosen.time_s, [0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(signals["alarm"][:, 0], [0, 5, 10, 15, 20])
