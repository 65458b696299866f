"""Maps that are proposed for logs of many programs give the flight back; vehicles are made of a log's parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_probe import (
    ONE,
    Flight,
    flown,
    px4_topics,
    refused,
    require_the_flight,
    telemetry,
    usual_columns,
    write_bag,
    write_csv,
    write_ulog,
)

from massprop_drake import estimate, load_vehicle
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.records.mapped_rows import make_table
from massprop_drake.records.mapping import apply_map
from massprop_drake.records.names import column_quantity, read_name
from massprop_drake.records.proposal import Proposal, make_proposal
from massprop_drake.records.px4 import vehicle_from_log
from massprop_drake.records.recording import open_recording
from massprop_drake.records.rows import vehicle_scenario
from massprop_drake.records.stamps import parse_stamp

Array = NDArray[np.float64]
FLOWN = flown(load_vehicle("free_flyer"), 1)  # which follows its commands; `ONE` does not
VELOCITIES = {f"dv_{axis}": FLOWN.velocities[:, index] for index, axis in enumerate("xyz")}


def proposed(path: Path, vehicle: Vehicle = FLOWN.vehicle) -> Proposal:
    return make_proposal(open_recording(path), vehicle)


def said(found: Proposal) -> str:
    return "\n".join([*found.lacking, *found.warnings, *found.reasons])


def require_found(path: Path, flight: Flight = FLOWN) -> Proposal:
    """The proposal is whole, and gives the flight."""
    found = proposed(path, flight.vehicle)
    assert found.lacking == []
    rows = telemetry(path, to_yaml(found.data), flight.vehicle)
    for index, axis in enumerate("xyz"):
        if f"acc_{axis}" in rows:  # increments are summed from nothing
            rows[f"acc_{axis}"] += flight.velocities[0, index] - rows[f"acc_{axis}"][0]
        elif f"acc_accel_{axis}" not in rows:  # a log without velocities
            rows[f"acc_{axis}"] = flight.velocities[:, index]
    rows |= {f"jet_{jet}": np.nan_to_num(rows[f"jet_{jet}"]) for jet in flight.jets}
    flight = flight._replace(commands=np.vstack([flight.commands[:-1], np.zeros((1, len(flight.jets)))]))
    np.testing.assert_allclose(rows["time_s"] - rows["time_s"][0], flight.time_s, atol=5e-7)  # a double's, since 1970
    require_the_flight(rows | {"time_s": flight.time_s}, flight, close=1e-8)
    return found


def log_of(folder: Path, flight: Flight = FLOWN, **instead: Any) -> Path:
    """The flight with columns called as usual, but increments by their name; some columns otherwise, or not."""
    columns = {name: values for name, values in usual_columns(flight).items() if not name.startswith("v")}
    columns |= VELOCITIES if flight is FLOWN else {}
    return write_csv(folder / "log.csv", {name: one for name, one in (columns | instead).items() if one is not None})


def commands_of(values: Array) -> dict[str, Array]:
    return {f"u{index + 1}": values[:, index] for index in range(values.shape[1])}


def test_a_proposal_is_estimated_from(tmp_path: Path) -> None:
    short = flown(FLOWN.vehicle, 2, rows=25)
    path = log_of(tmp_path, short)
    by = validate_data(RecordMap, proposed(path).data)
    run = estimate(path, vehicle_scenario("log", "free_flyer", ["detector.kind=off"]), record_map=by)
    assert run.summary["data_quality"]["rows"] == 25


def test_names_are_read() -> None:
    for column, expected in {
        "qw": (("q",), 0, ""),
        "wy [deg/s]": (("w",), 1, "deg/s"),
        "angularVelocity.z": (("angular", "velocity"), 2, ""),
        "acc[1]": (("acc",), 1, ""),
        "yaw_rate_radps": (("yaw", "rate"), -1, "rad/s"),
        "dvx_mm_s": (("dv",), 0, "mm/s"),
        "GYRO_X_MDPS": (("gyro",), 0, "mdps"),
        "wx_µrad_s": (("w",), 0, "µrad/s"),
        "acc_z_ug": (("acc",), 2, "ug"),
        "x_m": ((), 0, "m"),
        "q": (("pqr",), 1, ""),
        "thruster_12": (("thruster", "12"), -1, ""),
    }.items():
        found = read_name(column)
        assert (found.words, found.axis, found.unit) == expected, column


COMMANDS: dict[str, tuple[Callable[[Array], Array], dict[str, Any]]] = {
    "milliseconds": (lambda on: 50.0 * on, {"unit": "ms"}),
    "a byte": (lambda on: 255 * on.astype(int), {"on": 255.0}),
    "pulses": (lambda on: 1000.0 + 1000.0 * on, {"off": 1000.0, "on": 2000.0}),
    "pulses, disarmed": (lambda on: np.where(np.arange(len(on))[:, None] < 5, 900.0, 1000.0 + 1000.0 * on), {}),
    "inverted pulses": (lambda on: 2000.0 - 1000.0 * on, {"off": 2000.0, "on": 1000.0}),
    "pulses that scatter": (
        lambda on: 1000.0 + 900.0 * on + np.arange(len(on))[:, None] % 3 - 1.0,
        {"off": 1000.0, "on": 1900.0, "threshold": 0.5},
    ),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_scales_of_commands(name: str, tmp_path: Path) -> None:
    scale, wanted = COMMANDS[name]
    found = require_found(log_of(tmp_path, **commands_of(scale(FLOWN.commands))))
    assert {key: found.data["commands"].get(key) for key in wanted} == wanted


def bits(one: Flight) -> dict[str, Any]:
    return {"valve_bits": (one.commands @ 2 ** np.arange(len(one.jets))).astype(int)}


def on_times(one: Flight) -> dict[str, Any]:
    return {f"{jet}_on_s": 0.05 * on for jet, on in zip(one.jets, one.commands.T, strict=True)}


def names(one: Flight) -> dict[str, Any]:
    return {"fired": [" ".join(jet for jet, on in zip(one.jets, row, strict=True) if on) for row in one.commands]}


@pytest.mark.parametrize("form", [bits, names, on_times])
def test_masks_lists_and_on_times(form: Callable[[Flight], dict[str, Any]], tmp_path: Path) -> None:
    require_found(log_of(tmp_path, ONE, **dict.fromkeys(commands_of(ONE.commands)), **form(ONE)), ONE)


def test_units_of_commands_are_told_by_the_jets(tmp_path: Path) -> None:
    row, jet = np.arange(400)[:, None], np.arange(12)
    # on-times up to 40 ms of 50 could be percent, too: the jets turn the vehicle twice as much as these would
    slower = {f"w{axis}": 0.8 * FLOWN.rates[:, index] for index, axis in enumerate("xyz")}
    for instead, unit in (
        (commands_of(np.where((row == 300) & (jet == 0), 1.0, 0.05 * FLOWN.commands)), "s"),  # one is a full command
        (commands_of(40.0 * FLOWN.commands) | slower, "ms"),
    ):
        found = proposed(log_of(tmp_path, **instead))
        assert (found.data["commands"]["unit"], found.data["sensors"]["gyro"]["unit"]) == (unit, "rad/s")


@pytest.mark.parametrize(("name", "unit"), [("w{}_mdps", "mdps"), ("w{}", "mdeg/s")])
def test_thousandths_of_a_degree_are_told_by_name_and_by_the_jets(name: str, unit: str, tmp_path: Path) -> None:
    rates = {name.format(axis): 1e3 * np.degrees(FLOWN.rates[:, index]) for index, axis in enumerate("xyz")}
    found = require_found(log_of(tmp_path, **(dict.fromkeys(("wx", "wy", "wz")) | rates)))
    assert found.data["sensors"]["gyro"]["unit"] == unit


@pytest.mark.parametrize(("late", "words"), [(2, "2 rows before"), (-1, "1 row after")])
def test_commands_that_are_logged_late_are_warned_of(late: int, words: str, tmp_path: Path) -> None:
    path = log_of(tmp_path, **commands_of(np.roll(FLOWN.commands, late, axis=0)))
    found = proposed(path)
    offset_s = -late * FLOWN.vehicle.sample_period_s
    assert words in found.warnings[0]
    assert f"offset_s: {offset_s:g}" in found.warnings[0]
    found.data["commands"] |= {"acts": "from_row", "time": {"column": "t", "offset_s": offset_s}}
    rows = telemetry(path, to_yaml(found.data), FLOWN.vehicle)
    np.testing.assert_array_equal(rows["jet_T1"][10:-10], FLOWN.commands[10:-10, 0])


SERVICER = load_vehicle("servicer")
FAST = flown(SERVICER.model_copy(update={"sample_period_s": SERVICER.sample_period_s / 5}), 2, 1500, 30)


@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize("unit", ["1", "ms"])
def test_a_log_faster_than_samples_is_judged_by_its_own_rows(late: int, unit: str, tmp_path: Path) -> None:
    """Jets lag behind their valves by more than a row, which is no lateness of the commands."""
    period_s = FAST.vehicle.sample_period_s
    commands = np.roll(FAST.commands, -late, axis=0) * (1.0 if unit == "1" else 1e3 * period_s)
    columns = {f"{jet}_ms" if unit == "ms" else jet: one for jet, one in zip(FAST.jets, commands.T, strict=True)}
    found = proposed(log_of(tmp_path, FAST, **dict.fromkeys(commands_of(commands)), **columns), SERVICER)
    assert found.data["commands"].get("unit", "1") == unit
    if late:
        assert "2 rows after" in found.warnings[0]
        assert f"offset_s: {late * period_s:g}" in found.warnings[0]
    assert len(found.warnings) == (late > 0)


def test_a_delay_that_the_vehicle_states_is_no_lateness(tmp_path: Path) -> None:
    delay = {"command_delay_s": 2 * FAST.vehicle.sample_period_s}
    kinds = {name: kind.model_copy(update=delay) for name, kind in SERVICER.jet_kinds.items()}
    path = log_of(tmp_path, FAST, **commands_of(np.roll(FAST.commands, -2, axis=0)))
    assert proposed(path, load_vehicle("servicer").model_copy(update={"jet_kinds": kinds})).warnings == []


@pytest.mark.parametrize("later", [False, True])
@pytest.mark.parametrize("wrong", [{"wy": -FLOWN.rates[:, 1]}, {"wx": FLOWN.rates[:, 2], "wz": FLOWN.rates[:, 0]}])
def test_when_commands_act_is_told_whatever_the_axes(wrong: dict[str, Array], later: bool, tmp_path: Path) -> None:
    logged = np.roll(FLOWN.commands, 1, axis=0) if later else FLOWN.commands
    coasting = np.flatnonzero(np.convolve(FLOWN.commands.sum(axis=1), np.ones(5), "same") == 0.0)[-1]
    wrong = {name: values + 10.0 * (np.arange(values.size) > coasting) for name, values in wrong.items()}  # and a jump
    found = proposed(log_of(tmp_path, **wrong, **commands_of(logged)))
    assert found.data["commands"]["acts"] == ("until_row" if later else "from_row")
    assert ["poorly" in one for one in found.warnings] == [True]


def test_a_clock_of_another_period_is_found_or_said(tmp_path: Path) -> None:
    columns = {name: values for name, values in usual_columns(FLOWN).items() if name[0] not in "tv"}
    slower = FLOWN.vehicle.model_copy(update={"sample_period_s": 0.08})
    for name, words in (("UPTIME_MS", "in ms as its name says"), ("alpha", "rises by 50 a row, which in")):
        path = write_csv(tmp_path / "log.csv", {name: 1e3 * FLOWN.time_s, **columns, **VELOCITIES})
        found = proposed(path, slower)
        assert words in said(found)
        assert bool(found.lacking) == (name == "alpha")


def test_telemetry_needs_no_map(tmp_path: Path) -> None:
    """Onsets of jets P1 and P2 are no positions."""
    columns = {"time_s": FLOWN.time_s, **{f"gyro_{axis}": FLOWN.rates[:, place] for place, axis in enumerate("xyz")}}
    columns |= {f"jet_{jet}": FLOWN.commands[:, index] for index, jet in enumerate(FLOWN.jets)}
    path = write_csv(tmp_path / "log.csv", columns)
    assert "'massprop estimate' reads it without a map" in said(proposed(path))
    assert proposed(path).warnings == []
    onsets = {f"onset_{jet}_s": 0.0 * FLOWN.time_s for jet in FLOWN.jets}
    assert "by a map it loses when jets open" in proposed(write_csv(path, columns | onsets)).warnings[0]
    assert [column_quantity(read_name(name)) for name in ("onset_P1_s", "P1_m", "P1")] == ["", "position", "position"]


CLOCKS: dict[str, Callable[[Array], dict[str, Any]]] = {
    "seconds and nanoseconds": lambda t: {
        "secs": 1_455_210_114 + np.floor(t + 1e-9).astype(int),
        "nsecs": np.round(1e9 * (t - np.floor(t + 1e-9))).astype(int),
    },
    "a date with blanks": lambda t: {"Sat.UTCGregorian": [f"01 Jan 2000 11:59:{10 + s:06.3f}" for s in t]},
    "a clock alone": lambda t: {"time": [f"9:00:{10 + s:06.3f}" for s in t]},
    "a date beside": lambda t: {"date": ["2024-02-28"] * len(t), "time": [f"23:59:{10 + s:06.3f}" for s in t]},
    "no name of a time": lambda t: {"alpha": 1e3 * t + 7.0},
    "stamps without a name": lambda t: {"alpha": [f"2024-05-01T12:00:{10 + s:06.3f}Z" for s in t]},
    "a counter before it": lambda t: {"tick": np.arange(len(t)), "gps_us": 1e6 * t},
    "a change of zones": lambda t: {
        "t": [f"2024-03-31T0{1 + (s >= 5)}:59:{30 + s:06.3f}+0{int(s >= 5)}:00" for s in t]
    },
}


@pytest.mark.parametrize("name", CLOCKS)
def test_clocks(name: str, tmp_path: Path) -> None:
    columns = {name: values for name, values in usual_columns(FLOWN).items() if name[0] not in "tv"}
    require_found(write_csv(tmp_path / "log.csv", CLOCKS[name](FLOWN.time_s) | columns | VELOCITIES))


def test_stamps() -> None:
    noon = np.datetime64("2024-05-01T12:00:00", "ns")
    for text, seconds in {
        "2024-05-01T12:00:00.25Z": 0.25,
        "2024-05-01 14:00:00.000000001+02:00": 1e-9,
        "2024-05-01T12:00:00 UTC": 0.0,
        "2024-122T23:00:00+11:00": 0.0,
        "01 May 2024 12:00:03.000": 3.0,
    }.items():
        assert (parse_stamp(text) - noon) / np.timedelta64(1, "s") == pytest.approx(seconds), text
    for text in ("12", "T1 T2", "2024-13-01T00:00:00", "x 2024-05-01", "1.5.2024", "2024-05-01T12:00:00+1"):
        assert parse_stamp(text) is None, text


def test_what_jets_do_tells_increments_from_their_sums(tmp_path: Path) -> None:
    gained = np.diff(FLOWN.velocities, axis=0, prepend=FLOWN.velocities[:1])
    for values, gives in ((gained, "increment"), (np.cumsum(gained, axis=0), "integral")):
        found = proposed(log_of(tmp_path, **{f"dv_{axis}": values[:, index] for index, axis in enumerate("xyz")}))
        assert found.data["sensors"]["acc"]["gives"] == gives


def planar(exact: bool) -> dict[str, Any]:
    """A log of a planar vehicle: pose, and rates that are differences, or not quite."""
    random = np.random.default_rng(4)
    time_s = np.cumsum(random.uniform(0.045, 0.065, 200))
    values = {"x_m": 0.3 * np.sin(time_s), "y_m": 0.2 * np.cos(1.3 * time_s), "yaw_rad": 0.5 * time_s}
    slopes = (0.3 * np.cos(time_s), -0.26 * np.sin(1.3 * time_s), 0.5 + 0.01 * np.sin(9.0 * time_s))
    steps = np.diff(time_s, prepend=0.0)
    rates = [np.nan_to_num(np.diff(one, prepend=np.nan) / steps) for one in values.values()] if exact else slopes
    return {
        "step": np.arange(200),
        "nominal_time_s": 0.05 * np.arange(200),
        **values,
        **dict(zip(("vx_mps", "vy_mps", "yaw_rate_radps"), rates, strict=True)),
        **{
            jet: (random.random(200) < 0.3).astype(int)
            for jet in (*ONE.jets, *load_vehicle("air_bearing").designations)
        },
    }


def test_rates_that_are_differences_are_no_sensors_but_tell_the_time(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", planar(exact=True))
    found = proposed(path)
    assert found.lacking == []
    (pose,) = found.data["sensors"].values()
    assert (pose["position"], pose["heading"]) == (["x_m", "y_m", None], "yaw_rad")
    assert [pair["rate"] for pair in found.data["time"]["differences"]] == ["vx_mps", "vy_mps", "yaw_rate_radps"]
    write_csv(path, planar(exact=False))
    found = proposed(path)
    assert set(found.data["sensors"]) == {"pose", "velocity", "gyro"}
    assert found.data["sensors"]["gyro"]["columns"] == [None, None, "yaw_rate_radps"]
    assert "differences" not in found.data["time"]
    followed = proposed(path, load_vehicle("air_bearing"))  # which has one sensor alone
    assert list(followed.data["sensors"]) == ["mocap"]


@pytest.mark.parametrize("names", [["RWX_RPM", "RWY_RPM", "RWZ_RPM"], ["wheel1 [rpm]", "wheel2 [rpm]", "wheel3 [rpm]"]])
def test_speeds_of_wheels_are_found_and_read(tmp_path: Path, names: list[str]) -> None:
    vehicle, row = load_vehicle("cubesat"), np.arange(40)
    columns: dict[str, Any] = {"MET [ms]": 1000 + 100 * row}
    columns |= {f"W_{axis} [deg/s]": 0.01 * row * factor for axis, factor in zip("XYZ", (1, -2, 3), strict=True)}
    columns |= {f"THR{number}_ON_MS": 100 * (row % 8 == number - 1) for number in range(1, 9)}
    path = write_csv(tmp_path / "log.csv", columns | dict.fromkeys(names, 600.0 + row), delimiter=";")
    data = proposed(path, vehicle).data
    found = [(key, one["kind"], one["speed"], one["unit"]) for key, one in data["sensors"].items() if key != "gyro"]
    assert found == [(key, "wheel", name, "rpm") for key, name in zip(("RWX", "RWY", "RWZ"), names, strict=True)]
    recording = open_recording(path)
    rows = make_table(apply_map(recording, RecordMap.model_validate(data), vehicle), "gyro")
    (block,) = rows.blocks([rows.header.index("RWY_speed")])
    assert block.values[0, 0] == pytest.approx(600.0 * 2.0 * np.pi / 60.0)
    data["sensors"]["RW7"] = {"kind": "wheel", "speed": names[0], "unit": "rpm"}
    message = refused(lambda: apply_map(recording, RecordMap.model_validate(data), vehicle))
    assert "sensors.RW7: vehicle 'cubesat' has no wheel of this name" in message


FORMS: dict[str, tuple[Callable[[list[str]], list[str]], dict[str, Any]]] = {
    "TUM": (
        lambda lines: ["# trajectory", "# file: 'a.bag'", f"# {lines[0]}", *lines[1:]],
        {"separator": " ", "skip": 2},
    ),
    "in columns": (
        lambda lines: ["".join(f"{cell:>24s}" for cell in one.split()) for one in lines],
        {"separator": " "},
    ),
    "remarks between": (lambda lines: [f"# {lines[0]}", *lines[1:50], "# half", *lines[50:]], {"comment": "#"}),
    "for a spreadsheet": (
        lambda lines: ["sep=;", *(one.replace(" ", ";").replace(".", ",") for one in lines)],
        {"separator": ";", "skip": 1, "decimal": ","},
    ),
    "units below": (
        lambda lines: [lines[0], " ".join(["s", *["rad/s"] * 3, *["-"] * (len(lines[0].split()) - 4)]), *lines[1:]],
        {"below": 1},
    ),
}


@pytest.mark.parametrize("name", FORMS)
def test_forms_of_text(name: str, tmp_path: Path) -> None:
    form, wanted = FORMS[name]
    columns = {name: values for name, values in usual_columns(FLOWN).items() if not name.startswith("v")}
    path = write_csv(tmp_path / "log.txt", columns | VELOCITIES, delimiter=" ")
    path.write_text("\n".join(form(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")
    found = require_found(path)
    assert {key: found.data.get("csv", {}).get(key) for key in wanted} == wanted


@pytest.mark.parametrize("kind", ["ros1", "mat", "px4"])
def test_topics_of_a_recording(kind: str, tmp_path: Path) -> None:
    if kind == "ros1":
        pytest.importorskip("rosbags")
        path = write_bag(tmp_path / "log.bag", ONE, kind)
    elif kind == "px4":
        pytest.importorskip("pyulog")
        path = write_ulog(tmp_path / "log.ulg", px4_topics(ONE), {})
    else:
        from scipy.io import savemat  # noqa: PLC0415

        path = tmp_path / "log.mat"
        rcs = {"time_ms": 1e3 * ONE.time_s, **{f"valve{i}": ONE.commands[:, i] for i in range(len(ONE.jets))}}
        increments = np.diff(ONE.velocities, axis=0, prepend=0.0)
        savemat(path, {"rcs": rcs, "imu": {"t": ONE.time_s, "gyro": ONE.rates, "dv": increments}})
    found = proposed(path, ONE.vehicle)
    assert found.lacking == []
    if kind == "ros1":
        found.data["sensors"]["acc"]["gives"] = "mean"
    require_the_flight(telemetry(path, to_yaml(found.data), ONE.vehicle), ONE)


WARNED: dict[str, tuple[dict[str, Any], str]] = {
    "a jet less": ({"u12": None}, "there is none for jet T12"),
    "signs": ({"wz": -FLOWN.rates[:, 2]}, "gyro: the rates follow the commands poorly, with a correlation of "),
    "signs of velocities": (
        {name: -values for name, values in VELOCITIES.items()},
        "acc: the readings go against what the jets should do, by a correlation of -0.99",
    ),
    "what is no acceleration": (
        {**dict.fromkeys(VELOCITIES), **{f"pump_a{index}": FLOWN.commands[:, 2 * index] for index in (1, 2, 3)}},
        "acc: the readings follow the commands poorly, with a correlation of 0.",
    ),
    "a cell of text": (
        {"u3": [*map(str, FLOWN.commands[:-1, 2]), "ERR"]},
        "line 401, column u3: 'ERR' is not a number",
    ),
    "whole seconds": (
        {"t": np.floor(FLOWN.time_s)},
        "column t are coarse: they stand still for up to 20 rows and then go on by 1 s",
    ),
    "hundredths": (
        {"t": np.round(FLOWN.time_s + 0.013 * np.sin(FLOWN.time_s), 2)},
        "column t are coarse, to 0.01 s, 20 % of the sample period",
    ),
    "falling": ({"t": FLOWN.time_s[::-1]}, "column t falls from row to row"),
    "an odd date": (
        {"t": [f"11/02/2016 17:00:{s:09.6f}" for s in FLOWN.time_s]},
        "line 2, column t: '11/02/2016 17:00:00.000000' is neither a number nor an ISO 8601",
    ),
    "commands of both signs": (
        commands_of(0.5 * FLOWN.commands * np.where(np.arange(400) % 2, 1.0, -1.0)[:, None]),
        "go from -0.5 to 0.5, which is neither a share, percent, an on-time",
    ),
    "a rare command": (
        commands_of(np.where(np.arange(400)[:, None] + np.arange(12) == 399, 65535.0, 900.0 + 1100.0 * FLOWN.commands)),
        "commands: 65535 is rare, and neither of them",
    ),
}


@pytest.mark.parametrize("name", WARNED)
def test_what_is_doubtful_in_a_log_is_told(name: str, tmp_path: Path) -> None:
    instead, words = WARNED[name]
    assert words in said(proposed(log_of(tmp_path, **instead)))


@pytest.mark.parametrize(("name", "jets"), [("thr_a", 12), ("thr_a", 3), ("a", 12), ("v", 12), ("vlv_", 12)])
def test_what_is_named_after_jets_is_no_reading(name: str, jets: int, tmp_path: Path) -> None:
    """Valves a1, a2 and so on are no accelerations, with a column for each jet or not."""
    valves = {f"{name}{index + 1}": FLOWN.commands[:, index] for index in range(jets)}
    own = dict.fromkeys(commands_of(FLOWN.commands)) if jets == 12 else {}
    found = proposed(log_of(tmp_path, **dict.fromkeys(VELOCITIES), **own, **valves))
    assert (list(found.data["sensors"]), found.lacking, found.warnings) == (["gyro"], [], [])
    assert found.data["commands"]["columns"]["T1"] == (f"{name}1" if jets == 12 else "u1")


def test_what_cannot_be_found_is_said(tmp_path: Path) -> None:
    found = proposed(write_csv(tmp_path / "log.csv", {"alpha": [1, 2, 3], "beta": [1, 5, 2]}))
    needs = ["no column of time was found", "no sensor was found", "no commands were found"]
    assert [sentence.partition(":")[0] for sentence in found.lacking] == needs
    assert proposed(log_of(tmp_path)).warnings == []


def parameters() -> dict[str, Any]:
    """Of four thrusters in a plane, the rest at PX4's defaults."""
    found: dict[str, Any] = {"CA_THRUSTER_CNT": 4, "EKF2_IMU_POS_X": 0.05}
    places = ((-0.12, -0.12, 1.0), (0.12, -0.12, -1.0), (-0.12, 0.12, 1.0), (0.12, 0.12, -1.0))
    for index, (x, y, axis) in enumerate(places):
        values = {"PX": x, "PY": y, "PZ": 0.0, "AX": axis, "AY": 0.0, "AZ": 0.0, "CT": 1.4}
        found |= {f"CA_THRUSTER{index}_{name}": value for name, value in values.items()}
    return found


def test_a_vehicle_of_the_parameters(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")

    def made(more: dict[str, Any], mass: float | None = 15.0) -> Any:
        given = {name: value for name, value in (parameters() | more).items() if value is not None}
        recording = open_recording(write_ulog(tmp_path / "log.ulg", px4_topics(ONE), given))
        return vehicle_from_log(recording, "box", mass, (0.2, 0.2, 0.3))

    vehicle = validate_data(Vehicle, made({}).data)
    assert vehicle.designations == ("T0", "T1", "T2", "T3")
    np.testing.assert_allclose(vehicle.thrusts[1], [-1.4, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(vehicle.wrenches[1, :3], np.cross([0.12, -0.12, 0.0], [-1.4, 0.0, 0.0]), rtol=1e-6)
    assert vehicle.sample_period_s == pytest.approx(0.05)
    assert vehicle.accelerometers[0].position == pytest.approx((0.05, 0.0, 0.0))
    assert 0.005 < vehicle.gyros[0].noise_std < 0.02  # the flight's rates are a random walk of 0.01 a row
    assert proposed(tmp_path / "log.ulg", vehicle).lacking == []
    assert "PX4 logs neither mass nor inertia: give --mass and --inertia" in refused(lambda: made({}, None))
    assert "has no parameter CA_THRUSTER_CNT above zero" in refused(lambda: made({"CA_THRUSTER_CNT": None}))
    assert "thruster 2 has no direction or no thrust" in refused(lambda: made({"CA_THRUSTER2_CT": 0.0}))
    assert "mass_properties.mass" in refused(lambda: made({}, -1.0))
