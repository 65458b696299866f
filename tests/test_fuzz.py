"""Spoilt files of every kind: whatever is in them, a result or one message, and nothing half-written.

`MASSPROP_FUZZ=20` makes twenty times as many cases; `MASSPROP_FUZZ=all` also runs all ten thousand of the command line.
"""

from __future__ import annotations

import copy
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import TOY
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from malformed_probe import KINDS, QUIET, Case, Sound, judged
from ruamel.yaml import YAML
from telemetry_probe import Log, toy_vehicle

from massprop_drake import InputError, Scenario, estimate, load_vehicle
from massprop_drake.inputs.scenario import EstimationBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.records.reader import Reader, check

ALL = os.environ.get("MASSPROP_FUZZ") == "all"
TIMES = 20 if ALL else int(os.environ.get("MASSPROP_FUZZ", "1"))
CELLS = [
    "",
    "nan",
    "inf",
    "-",
    "x",
    "1e400",
    "1e308",
    "-1e308",
    "-1",
    "2",
    "50",
    "0.5",
    "1_0",
    "٣",
    '"',
    "1,1",
    "\0",
    "0x1",
]
NAMES = ["time_s", "gyro_x", "acc_z", "jet_J1", "jet_", "", " ", "known_force_x", "acc_accel_x", "GYRO_X", "é", "1"]

quick = settings(
    max_examples=200 * TIMES,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def _toy_data() -> dict[str, Any]:
    """A vehicle with four jets: few columns, so that changes strike."""
    data: dict[str, Any] = YAML(typ="safe", pure=True).load(TOY)
    data["jets"] = [
        {
            "number": number,
            "designation": f"J{number}",
            "cluster": number,
            "kind": "primary",
            "position": [1.0, 0.0, 0.0],
            "direction": direction,
            "thrust": 10.0,
        }
        for number, direction in enumerate(([0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), 1)
    ]
    return data


VEHICLE = toy_vehicle(_toy_data())
THESIS = Scenario(vehicle=VEHICLE, estimation=EstimationBlock(filter="thesis"))


# -------------------------------------------------------------------------------------- telemetry


@st.composite
def spoilt_logs(draw: st.DrawFn) -> bytes:
    """A small log after a few things have happened to it."""
    log = Log(VEHICLE, n_rows=draw(st.sampled_from([0, 1, 3, 25, 40])))
    for _ in range(draw(st.integers(0, 3))):
        _spoil_table(draw, log)
    content = log.text()
    separator = draw(st.sampled_from([",", ",", ",", ";", "\t", " "]))
    content = content.replace(",", separator)
    encoding = draw(st.sampled_from(["utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"]))
    data = bytearray(content.encode(encoding, errors="replace"))
    for _ in range(draw(st.integers(0, 2))):
        if data:
            data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data[: draw(st.integers(0, len(data)))] if draw(st.integers(0, 5)) == 0 else data)


def _spoil_table(draw: st.DrawFn, log: Log) -> None:  # noqa: PLR0912 (a case for each kind of damage)
    rows, header = log.rows, log.header
    row = draw(st.integers(0, max(len(rows) - 1, 0)))
    column = draw(st.integers(0, len(header) - 1))
    match draw(st.integers(0, 8)):
        case 0 if rows and column < len(rows[row]):
            rows[row][column] = draw(st.sampled_from(CELLS))
        case 1:
            del rows[row : row + draw(st.integers(1, 12))]
        case 2 if rows:
            rows[row:row] = [list(rows[draw(st.integers(0, len(rows) - 1))])] * draw(st.sampled_from([1, 2, 30]))
        case 3 if rows:
            del rows[row][column:]
        case 4:
            header[column] = draw(st.sampled_from(NAMES))
        case 5:
            del header[column]
            for cells in rows:
                del cells[column : column + 1]
        case 6:
            header.append(draw(st.sampled_from(NAMES)))
            for cells in rows:
                cells.append(draw(st.sampled_from(["0", "1", "", "7.5"])))
        case 7:  # a whole column
            text = draw(st.sampled_from(CELLS))
            for cells in rows:
                if column < len(cells):
                    cells[column] = text
        case _:
            rows.reverse()


def _ends_well(call: Callable[[], Any]) -> None:
    """With a result, or with messages that say something."""
    problems: tuple[str, ...] = ()
    try:
        call()
    except InputError as error:
        problems = error.problems
    assert all(len(problem) > 10 for problem in problems)


@quick
@given(content=spoilt_logs())
def test_spoilt_telemetry_is_read_or_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    _ends_well(lambda: list(Reader(path, VEHICLE, gyro="gyro", rows_per_block=8)))
    _ends_well(lambda: check(path))


@settings(quick, max_examples=150 * TIMES)
@given(content=spoilt_logs(), scenario=st.sampled_from([THESIS] * 4 + [Scenario(vehicle=VEHICLE)]))
def test_spoilt_telemetry_is_estimated_or_refused(content: bytes, scenario: Scenario) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "log.csv"
        path.write_bytes(content)

        def run() -> None:
            result = estimate(path, scenario, folder=folder)
            result.save(folder / "run", pictures=False)
            _assert_whole(folder / "run")

        _ends_well(run)
        assert {entry.name for entry in folder.iterdir()} <= {"log.csv", "run"}


def _assert_whole(folder: Path) -> None:
    """The folder is whole."""
    assert {entry.name for entry in folder.iterdir()} == {
        "report.html",
        "filter_state.json",
        "history.npz",
        "manifest.json",
        "scenario.yaml",
        "summary.json",
        "telemetry.csv",
    }


# ---------------------------------------------------------------------------------------- vehicles

VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, float("nan"), float("inf"), "", "x", "gyro", "time_s", "jet_J1"]),
    st.lists(st.floats(-2.0, 2.0), max_size=4),
    st.just({}),
    st.just([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
)


def _places(data: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Paths of every value in nested data."""
    found = [path] if path else []
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        found.extend(_places(value, (*path, key)))
    return found


@st.composite
def spoilt_vehicles(draw: st.DrawFn) -> str:
    """A vehicle file after a few things have happened to it."""
    data: Any = _toy_data()
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(_places(data)))
        here = data
        for part in path[:-1]:
            here = here[part]
        match draw(st.integers(0, 3)):
            case 0:
                del here[path[-1]]
            case 1 if isinstance(here, dict):
                here[f"{path[-1]}x"] = here.pop(path[-1])
            case _:
                here[path[-1]] = copy.deepcopy(draw(VALUES))
        if not data:
            break
    text = to_yaml(data)
    if draw(st.integers(0, 3)) == 0:
        cut = draw(st.integers(0, len(text)))
        text = text[:cut] + draw(st.sampled_from(["", "\t", ":", "- ", "{", "&a *a", "é", "\x07"])) + text[cut + 1 :]
    return text


@quick
@given(text=spoilt_vehicles())
def test_spoilt_vehicle_files_are_read_or_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    _ends_well(lambda: load_vehicle(path))


@settings(quick, max_examples=40 * TIMES)
@given(text=spoilt_vehicles())
def test_a_vehicle_that_is_read_can_be_estimated_with(text: str, tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")

    def run() -> None:
        vehicle: Vehicle = load_vehicle(path)
        log = Log(vehicle, n_rows=25)
        estimate(log.write(tmp_path / "log.csv"), Scenario(vehicle=vehicle))

    _ends_well(run)


def test_the_log_that_is_spoilt_is_sound(tmp_path: Path) -> None:
    # the tests above would pass if everything was refused
    path = Log(VEHICLE).write(tmp_path / "log.csv")
    assert estimate(path, THESIS).summary["data_quality"]["rows"] == 60
    with pytest.raises(InputError):
        check(tmp_path / "nowhere.csv")


# ------------------------------------------------------------------------------- the command line

SAMPLE = 8  # cases of each kind


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    """Sound files of every kind that the command line reads."""
    return Sound(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "vehicle.yaml", "sound.yaml", "scheduled.yaml", "log.csv"],
        ["run", "sound.yaml", "--out", "out", *QUIET],
        ["run", "scheduled.yaml", "--out", "out", *QUIET],
        ["run", "run", "--out", "out", *QUIET],
        ["estimate", "log.csv", "--like", "run", "--out", "out", *QUIET],
        ["estimate", "log.csv", "--resume-from", "run", "--out", "out", *QUIET],
        ["estimate", "log.csv", "--resume-from", "estimated", "--out", "out", *QUIET],
        ["view", "estimated", "--out", "page.html"],
    ],
)
def test_what_is_spoilt_below_is_sound(sound: Sound, tmp_path: Path, arguments: list[str]) -> None:
    verdict = judged(lambda *_: Case(arguments, "none"), 0, sound, tmp_path)
    assert (verdict.status, verdict.fault) == (0, ""), verdict.said


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_input_ends_in_a_result_or_a_message(sound: Sound, tmp_path: Path, kind: str) -> None:
    """Status 0 with a whole result or 2 with a message; no traceback, nothing half-written, within five seconds."""
    make, count = KINDS[kind]
    statuses, faults = set(), []
    for number in range(count) if ALL else range(0, count, count // SAMPLE):
        with tempfile.TemporaryDirectory(dir=tmp_path) as here:
            verdict = judged(make, number, sound, Path(here))
        statuses.add(verdict.status)
        if verdict.fault:
            faults.append(f"{kind} {number}: {verdict.damage}: {verdict.arguments}: {verdict.fault}: {verdict.said}")
    assert not faults, "\n".join([f"{len(faults)} faults", *faults])
    assert 2 in statuses  # there was something to refuse
