"""Maps proposed for logs of many programs: their proposal gives the flight back, and is accepted by its reader."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Massprop
from layout_probe import GRID_S, flown, write_any
from numpy.typing import NDArray
from record_probe import Flight, require_the_flight, telemetry, usual_columns, write_csv, write_ulog

from massprop_drake import estimate
from massprop_drake.errors import InputError
from massprop_drake.inputs.model import validated
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.records.proposal import Proposal, propose
from massprop_drake.records.reader import vehicle_scenario
from massprop_drake.records.recording import open_recording, stamp_of

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def one() -> Flight:
    return flown(load_vehicle("free_flyer"), 1)


@pytest.fixture(scope="module")
def short() -> Flight:
    return flown(load_vehicle("free_flyer"), 2, rows=80)


def proposed(path: Path, vehicle: Vehicle) -> Proposal:
    return propose(open_recording(path), vehicle)


def require_found(path: Path, one: Flight) -> Proposal:
    """The proposal is whole, and gives the flight."""
    found = proposed(path, one.vehicle)
    assert found.lacking == []
    rows = telemetry(path, to_yaml(found.data), one.vehicle)
    for index, axis in enumerate("xyz"):  # increments are summed from nothing
        if f"acc_{axis}" in rows:
            rows[f"acc_{axis}"] += one.velocities[0, index] - rows[f"acc_{axis}"][0]
    rows |= {f"jet_{jet}": np.nan_to_num(rows[f"jet_{jet}"]) for jet in one.jets}
    one = one._replace(commands=np.vstack([one.commands[:-1], np.zeros((1, len(one.jets)))]))
    np.testing.assert_allclose(rows["time_s"] - rows["time_s"][0], one.time_s, atol=5e-7)  # a double's, since 1970
    require_the_flight(rows | {"time_s": one.time_s}, one, close=1e-8)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_any_layout_gives_the_flight(seed: int, one: Flight, tmp_path: Path) -> None:
    require_found(write_any(tmp_path / "log.csv", one, seed), one)


@pytest.mark.parametrize("seed", range(100, 104))
def test_a_proposal_is_estimated_from(seed: int, short: Flight, tmp_path: Path) -> None:
    path = write_any(tmp_path / "log.csv", short, seed)
    by = validated(RecordMap, proposed(path, short.vehicle).data)
    run = estimate(path, vehicle_scenario("log", "free_flyer"), record_map=by)
    assert run.results.data_quality is not None
    assert run.results.data_quality["rows"] == len(short.time_s)


COMMANDS: dict[str, tuple[Callable[[Array], Array], dict[str, Any]]] = {
    "0 and 1": (lambda on: on.astype(int), {}),
    "percent": (lambda on: 100.0 * on, {"unit": "%"}),
    "seconds": (lambda on: 0.05 * on, {"unit": "s"}),
    "milliseconds": (lambda on: 50.0 * on, {"unit": "ms"}),
    "microseconds": (lambda on: 5e4 * on, {"unit": "us"}),
    "a byte": (lambda on: 255 * on.astype(int), {"on": 255.0}),
    "volts": (lambda on: 28.0 * on, {"on": 28.0}),
    "pulses": (lambda on: 1000.0 + 1000.0 * on, {"off": 1000.0, "on": 2000.0}),
    "pulses, disarmed": (lambda on: np.where(np.arange(len(on))[:, None] < 5, 900.0, 1000.0 + 1000.0 * on), {}),
    "inverted": (lambda on: (1 - on).astype(int), {"off": 1.0, "on": 0.0}),
    "narrow pulses": (lambda on: 1100.0 + 800.0 * on, {"off": 1100.0, "on": 1900.0}),
    "pulses that no default fits": (lambda on: 900.0 + 1050.0 * on, {"off": 900.0, "on": 1950.0}),
    "inverted pulses": (lambda on: 2000.0 - 1000.0 * on, {"off": 2000.0, "on": 1000.0}),
    "SBUS": (lambda on: 172.0 + 1639.0 * on, {"off": 172.0, "on": 1811.0}),
    "1 and 2": (lambda on: 1.0 + on, {"off": 1.0, "on": 2.0}),
    "milliamperes": (lambda on: 4.0 + 16.0 * on, {"off": 4.0, "on": 20.0}),
    "signs": (lambda on: 2.0 * on - 1.0, {"off": -1.0, "on": 1.0}),
    "pulses that scatter": (
        lambda on: 1000.0 + 900.0 * on + np.arange(len(on))[:, None] % 3 - 1.0,
        {"off": 1000.0, "on": 1900.0, "threshold": 0.5},
    ),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_scales_of_commands(name: str, one: Flight, tmp_path: Path) -> None:
    scale, wanted = COMMANDS[name]
    values = scale(one.commands)
    columns = usual_columns(one) | {f"u{index + 1}": values[:, index] for index in range(len(one.jets))}
    columns = {key: value for key, value in columns.items() if not key.startswith("v")}
    columns |= {f"dv_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}
    found = require_found(write_csv(tmp_path / "log.csv", columns), one)
    told = {key: found.data["commands"].get(key) for key in wanted}
    assert told == wanted


def test_a_command_that_is_no_level_is_named(one: Flight, tmp_path: Path) -> None:
    values = 900.0 + 1100.0 * one.commands
    values[-1, 0] = 65535.0
    columns = usual_columns(one) | {f"u{index + 1}": values[:, index] for index in range(len(one.jets))}
    path = write_csv(tmp_path / "log.csv", columns)
    found = proposed(path, one.vehicle)
    assert found.data["sensors"]["gyro"]["unit"] == "rad/s"
    assert "commands: 65535 is rare, and neither of them" in found.reasons
    with pytest.raises(InputError, match="line 401, column u1: 65535 is no command between closed and open"):
        telemetry(path, to_yaml(found.data), one.vehicle)


def test_on_times_with_one_full_command_are_told_by_the_jets(one: Flight, tmp_path: Path) -> None:
    values = 0.05 * one.commands
    values[300, 0] = 1.0
    columns = usual_columns(one) | {f"u{index + 1}": values[:, index] for index in range(len(one.jets))}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert found.data["commands"]["unit"] == "s"
    assert found.data["sensors"]["gyro"]["unit"] == "rad/s"


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad/s"), (1e3, "mrad/s"), (180.0 / np.pi, "deg/s")])
def test_units_of_rates_are_told_by_the_jets(factor: float, unit: str, one: Flight, tmp_path: Path) -> None:
    columns = usual_columns(one) | {f"w{axis}": factor * one.rates[:, index] for index, axis in enumerate("xyz")}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert found.data["sensors"]["gyro"]["unit"] == unit


@pytest.mark.parametrize(("late", "words"), [(2, "2 rows before"), (4, "4 rows before"), (-1, "1 row after")])
def test_commands_that_are_logged_late_are_warned_of(late: int, words: str, one: Flight, tmp_path: Path) -> None:
    shifted = np.roll(one.commands, late, axis=0)
    columns = usual_columns(one) | {f"u{index + 1}": shifted[:, index] for index in range(len(one.jets))}
    path = write_csv(tmp_path / "log.csv", columns)
    found = proposed(path, one.vehicle)
    assert words in found.warnings[0]
    offset_s = -late * one.vehicle.sample_period_s
    assert f"offset_s: {offset_s:g}" in found.warnings[0]
    found.data["commands"] |= {"acts": "from_row", "time": {"column": "t", "offset_s": offset_s}}
    rows = telemetry(path, to_yaml(found.data), one.vehicle)
    np.testing.assert_array_equal(rows[f"jet_{one.jets[0]}"][10:-10], one.commands[10:-10, 0])


def test_rates_that_follow_no_interval_are_warned_of(one: Flight, tmp_path: Path) -> None:
    assert not proposed(write_csv(tmp_path / "right.csv", usual_columns(one)), one.vehicle).warnings
    columns = usual_columns(one) | {"wz": -one.rates[:, 2]}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert "look at axes, signs, units and which jet is which" in "\n".join(found.warnings)


def test_on_times_short_of_the_period_are_told_by_the_jets(one: Flight, tmp_path: Path) -> None:
    """On-times up to 40 ms of 50 could be percent, too: the jets turn the vehicle twice as much as these would."""
    columns = usual_columns(one) | {f"u{index + 1}": 40.0 * one.commands[:, index] for index in range(len(one.jets))}
    columns |= {f"w{axis}": 0.8 * one.rates[:, index] for index, axis in enumerate("xyz")}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert found.data["commands"]["unit"] == "ms"


def test_commands_that_can_be_nothing_are_said(one: Flight, tmp_path: Path) -> None:
    signed = 0.5 * one.commands * np.where(np.arange(len(one.commands)) % 2, 1.0, -1.0)[:, None]
    columns = usual_columns(one) | {f"u{index + 1}": signed[:, index] for index in range(len(one.jets))}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert "go from -0.5 to 0.5, which is neither a share, percent, an on-time" in found.lacking[0]


NOT_ALL = {
    "a jet is lacking": ("u12", "there is none for jet"),
    "half of the jets": ("u1", "there is none for jet"),
}


@pytest.mark.parametrize("name", NOT_ALL)
def test_jets_without_a_column_are_named(name: str, one: Flight, tmp_path: Path) -> None:
    lost, words = NOT_ALL[name]
    columns = {key: value for key, value in usual_columns(one).items() if key != lost}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert words in found.lacking[0]
    assert one.jets[int(lost[1:]) - 1] in found.lacking[0]


CLOCKS: dict[str, Callable[[Array], dict[str, Any]]] = {
    "seconds and nanoseconds": lambda t: {
        "secs": GRID_S + np.floor(t + 1e-9).astype(int),
        "nsecs": np.round(1e9 * (t - np.floor(t + 1e-9))).astype(int),
    },
    "seconds and microseconds": lambda t: {
        "tv_sec": np.floor(t + 1e-9).astype(int),
        "tv_usec": np.round(1e6 * (t - np.floor(t + 1e-9))).astype(int),
    },
    "with the day of the year": lambda t: {"UTC": [f"2024-122T23:59:{10 + s:09.6f}Z" for s in t]},
    "a date with blanks": lambda t: {"Sat.UTCGregorian": [f"01 Jan 2000 11:59:{10 + s:06.3f}" for s in t]},
    "a clock alone": lambda t: {"time": [f"9:00:{10 + s:06.3f}" for s in t]},
    "days": lambda t: {"time [days]": t / 86400.0},
    "milliseconds that are called seconds": lambda t: {"time_s": 1e3 * t},
    "no name of a time": lambda t: {"alpha": 1e3 * t + 7.0},
    "a counter before it": lambda t: {"tick": np.arange(len(t)), "gps_us": 1e6 * t},
}


@pytest.mark.parametrize("name", CLOCKS)
def test_clocks(name: str, one: Flight, tmp_path: Path) -> None:
    columns = {key: value for key, value in usual_columns(one).items() if key != "t"}
    columns = {key: value for key, value in columns.items() if not key.startswith("v")}
    columns |= {f"dv_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}
    require_found(write_csv(tmp_path / "log.csv", CLOCKS[name](one.time_s) | columns), one)


def test_coarse_stamps_are_said(one: Flight, tmp_path: Path) -> None:
    whole = proposed(write_csv(tmp_path / "a.csv", usual_columns(one) | {"t": np.floor(one.time_s)}), one.vehicle)
    assert "column t are coarse: they stand still for up to 20 rows and then go on by 1 s" in whole.lacking[0]
    rounded = usual_columns(one) | {"t": np.round(one.time_s + 0.013 * np.sin(one.time_s), 2)}
    found = proposed(write_csv(tmp_path / "b.csv", rounded), one.vehicle)
    assert any("column t are coarse, to 0.01 s, 20 % of the sample period" in reason for reason in found.reasons)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2024-05-01T12:00:00.25Z", 0.25),
        ("2024-05-01 14:00:00.000000001+02:00", 1e-9),
        ("2024-05-01 06:30:00 -0530", 0.0),
        ("2024-05-01T12:00:00+00", 0.0),
        ("2024-05-01T12:00:00 UTC", 0.0),
        ("2024-122T23:00:00+11:00", 0.0),
        ("2024-122T12:00:01", 1.0),
        ("2024/05/01 12:00:02,5", 2.5),
        ("01 May 2024 12:00:03.000", 3.0),
    ],
)
def test_stamps(text: str, seconds: float) -> None:
    stamp = stamp_of(text)
    assert stamp is not None
    assert (stamp - np.datetime64("2024-05-01T12:00:00", "ns")) / np.timedelta64(1, "s") == pytest.approx(seconds)


def test_dates_and_times_of_day_are_read_together(one: Flight, tmp_path: Path) -> None:
    zero = np.datetime64("2024-02-28T23:59:50", "ms")
    stamps = [str(zero + np.timedelta64(round(1e3 * s), "ms")).split("T") for s in one.time_s]
    columns = {key: value for key, value in usual_columns(one).items() if key != "t"}
    columns |= {"date": [day for day, _ in stamps], "time": [clock for _, clock in stamps]}
    path = write_csv(tmp_path / "log.csv", columns)
    data = proposed(path, one.vehicle).data
    assert data["time"] == {"column": "time", "date": "date"}
    found = telemetry(path, to_yaml(data), one.vehicle)
    np.testing.assert_allclose(np.diff(found["time_s"]), np.diff(one.time_s), atol=1e-6)


def test_why_a_column_is_no_clock_is_said(one: Flight, tmp_path: Path) -> None:
    falling = usual_columns(one) | {"t": one.time_s[::-1]}
    found = proposed(write_csv(tmp_path / "falling.csv", falling), one.vehicle)
    assert "column t falls from row to row" in found.lacking[0]
    days = usual_columns(one) | {"t": [f"11/02/2016 17:00:{s:09.6f}" for s in one.time_s]}
    found = proposed(write_csv(tmp_path / "days.csv", days), one.vehicle)
    assert "line 2, column t: '11/02/2016 17:00:00.000000' is neither a number nor an ISO 8601" in found.lacking[0]
    coarse = proposed(write_csv(tmp_path / "a.csv", usual_columns(one) | {"t": np.floor(one.time_s)}), one.vehicle)
    assert sum("are coarse" in reason for reason in coarse.lacking) == 1


def test_a_cell_of_text_among_numbers_is_named(one: Flight, tmp_path: Path) -> None:
    cells = [*map(str, one.commands[:, 2])]
    cells[300] = "ERR"
    found = proposed(write_csv(tmp_path / "log.csv", usual_columns(one) | {"u3": cells}), one.vehicle)
    assert "line 302, column u3: 'ERR' is not a number" in found.warnings[0]


def test_clocks_of_several_zones_are_one_time(one: Flight, tmp_path: Path) -> None:
    zero = np.datetime64("2024-03-31T00:59:50", "ms")
    stamps = [str(zero + np.timedelta64(round(1e3 * s), "ms")) for s in one.time_s]
    local = [str(zero + np.timedelta64(round(1e3 * s) + 3_600_000, "ms")) for s in one.time_s]
    summer = [f"{text}Z" if row < 200 else f"{local[row]}+01:00" for row, text in enumerate(stamps)]
    path = write_csv(
        tmp_path / "log.csv",
        usual_columns(one) | {"t": [f"{text}Z" for text in stamps], "tc": [f"{text}+01:00" for text in local]},
    )
    data = proposed(path, one.vehicle).data
    data["commands"]["time"] = {"column": "tc"}
    data["time"] = {"column": "t"}
    rows = telemetry(path, to_yaml(data), one.vehicle)
    assert all(np.isfinite(rows[f"jet_{jet}"][:-1]).all() for jet in one.jets)
    changed = write_csv(tmp_path / "summer.csv", usual_columns(one) | {"t": summer})
    found = telemetry(changed, to_yaml(proposed(changed, one.vehicle).data), one.vehicle)
    np.testing.assert_allclose(np.diff(found["time_s"]), np.diff(one.time_s), atol=1e-6)


@pytest.mark.parametrize("text", ["12", "T1 T2", "2024-13-01T00:00:00", "x 2024-05-01", "1.5.2024"])
def test_other_texts_are_no_stamps(text: str) -> None:
    assert stamp_of(text) is None


def test_stamps_that_are_none_are_named(one: Flight, tmp_path: Path) -> None:
    columns = usual_columns(one) | {"t": ["2024-05-01T12:00:00", *["later"] * 399]}
    path = write_csv(tmp_path / "log.csv", columns)
    text = to_yaml(proposed(path, one.vehicle).data | {"time": {"column": "t"}})
    with pytest.raises(Exception, match=r"line 3, column t: 'later' is neither a number nor an ISO 8601 stamp"):
        telemetry(path, text, one.vehicle)


FORMS: dict[str, tuple[Callable[[list[str]], list[str]], dict[str, Any]]] = {
    "TUM": (
        lambda lines: ["# trajectory", "# file: 'a.bag'", f"# {lines[0]}", *lines[1:]],
        {"separator": " ", "skip": 2},
    ),
    "EuRoC": (lambda lines: [f"#{lines[0].replace(' ', ',')}", *(one.replace(" ", ",") for one in lines[1:])], {}),
    "in columns": (
        lambda lines: ["".join(f"{cell:>24s}" for cell in one.split()) for one in lines],
        {"separator": " "},
    ),
    "remarks between": (lambda lines: [f"# {lines[0]}", *lines[1:50], "# half", *lines[50:]], {"comment": "#"}),
    "for a spreadsheet": (
        lambda lines: ["sep=;", *(one.replace(" ", ";") for one in lines)],
        {"separator": ";", "skip": 1},
    ),
    "units below": (
        lambda lines: [lines[0], " ".join(["s", *["deg/s"] * 3, *["-"] * (len(lines[0].split()) - 4)]), *lines[1:]],
        {"below": 1},
    ),
}


@pytest.mark.parametrize("name", FORMS)
def test_forms_of_text(name: str, one: Flight, tmp_path: Path) -> None:
    form, wanted = FORMS[name]
    columns = {key: value for key, value in usual_columns(one).items() if not key.startswith("v")}
    columns |= {f"dv_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}
    if name == "units below":
        columns |= {f"w{axis}": np.degrees(one.rates[:, index]) for index, axis in enumerate("xyz")}
    path = write_csv(tmp_path / "log.txt", columns, delimiter=" ")
    path.write_text("\n".join(form(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")
    found = require_found(path, one)
    assert {key: found.data.get("csv", {}).get(key) for key in wanted} == wanted


def test_names_that_begin_with_a_mark_may_be_given_with_it(one: Flight, tmp_path: Path) -> None:
    path = write_csv(
        tmp_path / "log.csv", {f"{'#' if key == 't' else ''}{key}": x for key, x in usual_columns(one).items()}
    )
    data = proposed(path, one.vehicle).data
    for name in ("t", "#t"):
        telemetry(path, to_yaml(data | {"time": {"column": name}}), one.vehicle)


def test_every_column_that_is_left_out_is_named(one: Flight, tmp_path: Path) -> None:
    others = {f"other{index:03d}": np.zeros(400) for index in range(150)}
    found = proposed(write_csv(tmp_path / "log.csv", usual_columns(one) | others), one.vehicle)
    assert set(others) <= set(found.left_out)
    assert all(name in "\n".join(found.reasons) for name in others)
    assert "..." not in "\n".join(found.reasons)


def test_what_is_no_reading_is_left_out(one: Flight, tmp_path: Path) -> None:
    others = {
        f"{name}_{axis}": np.ones(400) for name in ("gyro_bias", "rate_cmd", "wheel_speed", "acc_std") for axis in "xyz"
    }
    found = require_found(write_csv(tmp_path / "log.csv", others | usual_without_velocities(one)), one)
    assert set(others) <= set(found.left_out)


def usual_without_velocities(one: Flight) -> dict[str, Any]:
    columns = {key: value for key, value in usual_columns(one).items() if not key.startswith("v")}
    return columns | {f"dv_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}


def test_sensor_combined(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    means = np.diff(one.velocities, axis=0, prepend=one.velocities[:1]) / one.vehicle.sample_period_s
    commands = np.pad(one.commands, ((0, 0), (0, 16 - one.commands.shape[1])), constant_values=np.nan)
    topics = {
        "sensor_combined": (one.time_s + 3.0, {"gyro_rad": one.rates, "accelerometer_m_s2": means}),
        "actuator_motors": (one.time_s + 3.0, {"control": commands}),
        "cpuload": (one.time_s[::20] + 3.0, {"load": one.time_s[::20]}),
    }
    found = require_found(write_ulog(tmp_path / "log.ulg", topics, {}), one)
    assert found.data["sensors"]["acc"]["gives"] == "mean"
    assert "cpuload" in found.left_out
    assert "control[12] to control[15]" in found.left_out


# ---------------------------------------------------------------------------- at the command line


def test_check_doubts_on_times_in_fractions(massprop: Massprop, one: Flight, tmp_path: Path) -> None:
    columns = {
        "time_s": one.time_s,
        **{f"gyro_{axis}": one.rates[:, index] for index, axis in enumerate("xyz")},
        **{f"jet_{jet}": 0.05 * one.commands[:, index] for index, jet in enumerate(one.jets)},
    }
    log = write_csv(tmp_path / "log.csv", columns)
    done = massprop("check", log, "--vehicle", "free_flyer")
    assert done.status == 0
    assert "warning: no command of the whole record exceeds 0.05, and the sample period is 0.05 s" in done.out
    odd = np.where(np.arange(400) == 300, 1.0, 0.05 * one.commands[:, 0])
    done = massprop("check", write_csv(tmp_path / "odd.csv", columns | {"jet_T1": odd}), "--vehicle", "free_flyer")
    assert "commands that open a jet are no more than 0.05, and the sample period is 0.05 s" in done.out
    whole = write_csv(tmp_path / "whole.csv", columns | {"jet_T1": one.commands[:, 0]})
    assert "warning" not in massprop("check", whole, "--vehicle", "free_flyer").out


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (100.0, "look like percent: divide by 100"),
        (50.0, "look like on-times in ms: divide by 50"),
        (5e4, "look like on-times in us: divide by 50000"),
        (255.0, "look like numbers of 0 to 255: divide by 255"),
        (1.5, "1.5 is no fraction of 0 to 1\n"),
    ],
)
def test_commands_beyond_1_are_told_apart(
    scale: float, said: str, massprop: Massprop, one: Flight, tmp_path: Path
) -> None:
    columns = {
        "time_s": one.time_s,
        **{f"gyro_{axis}": one.rates[:, index] for index, axis in enumerate("xyz")},
        **{f"jet_{jet}": scale * one.commands[:, index] for index, jet in enumerate(one.jets)},
    }
    done = massprop("check", write_csv(tmp_path / "log.csv", columns), "--vehicle", "free_flyer")
    assert done.status == 2
    assert said in done.out + done.err


def test_a_record_that_would_be_refused_is_said_with_its_map(massprop: Massprop, one: Flight, tmp_path: Path) -> None:
    slow = write_csv(tmp_path / "log.csv", usual_columns(one) | {"t": 3.0 * one.time_s})
    done = massprop("map", slow, "--vehicle", "free_flyer")
    assert done.status == 0
    assert "warning: 'massprop estimate' will refuse it as it stands" in done.err
    assert "rows are 0.15 s apart" in done.err


# ------------------------------------------------------------------------------------ whole logs


def test_a_log_of_on_times_with_wheels_and_a_star_tracker(one: Flight, tmp_path: Path) -> None:
    """Everything at once: semicolons, units in brackets, sums called increments, jets by number, columns besides."""
    zero, quaternion = np.zeros(400), [["", "0.5"][row % 2] for row in range(400)]
    columns: dict[str, Any] = {"MET [ms]": np.round(1e6 + 1e3 * one.time_s).astype(int)}
    columns |= {f"W_{axis} [deg/s]": np.degrees(one.rates[:, index]) for index, axis in enumerate("XYZ")}
    columns |= {f"DV_{axis} [mm/s]": 1e3 * one.velocities[:, index] for index, axis in enumerate("XYZ")}
    names = {jet: f"THR{index + 1:02d}_ON_MS" for index, jet in enumerate(one.jets)}
    columns |= {name: 50 * one.commands[:, index].astype(int) for index, name in enumerate(names.values())}
    left = {
        **{f"RW{index}_RPM": zero for index in range(1, 5)},
        **{f"ST_Q{index}": quaternion for index in range(1, 5)},
    }
    found = require_found(write_csv(tmp_path / "log.csv", columns | left, delimiter=";"), one)
    assert found.data == {
        "time": {"column": "MET [ms]", "unit": "ms"},
        "sensors": {
            "gyro": {"kind": "gyro", "columns": [f"W_{axis} [deg/s]" for axis in "XYZ"], "unit": "deg/s"},
            "acc": {
                "kind": "accelerometer",
                "columns": [f"DV_{axis} [mm/s]" for axis in "XYZ"],
                "unit": "mm/s",
                "gives": "integral",
            },
        },
        "commands": {"columns": names, "unit": "ms", "acts": "from_row"},
        "csv": {"separator": ";"},
    }
    assert found.left_out == [*left]


def test_commands_logged_late_are_told_although_pulses_are_long(one: Flight, tmp_path: Path) -> None:
    """Both intervals follow the rates: with pulses of twenty samples the one before by a correlation of 1 to 0.9."""
    long = flown(one.vehicle, 3, longest=20)
    columns = usual_without_velocities(long)
    late = np.vstack([long.commands[:1], long.commands[:-1]])
    columns |= {f"u{index + 1}": late[:, index] for index in range(len(long.jets))}
    found = require_found(write_csv(tmp_path / "log.csv", columns), long)
    assert found.data["commands"]["acts"] == "until_row"
