"""Estimating from recorded telemetry: the answers of the run that made it, gaps, going on, what is told of it."""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vehicle_flights import windows

from massprop_drake import InputError, Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records.reader import Reader
from massprop_drake.results.detections import DetectionRecord

LOOP = "execution.engine=loop"
FAILURE = [
    "duration_s=13.2",
    LOOP,
    "estimation={filter: thesis, start: nominal, std_fraction: 0.01}",
    windows(
        *(("thc", "+x", 0.4, 3.2), ("thc", "+y", 3.8, 6.0)),
        *(("rhc", "+x", 6.8, 7.8), ("rhc", "+z", 8.4, 9.4), ("rhc", "+y", 10.0, 11.0)),
    ),
    "failures=[{kind: stuck_on, jet: R4R, start_s: 12}]",
]
FROM_ESTIMATORS = (
    "estimate",
    "standard_deviation",
    "converged",
    "rotation_innovation",
    "rotation_nis",
    "rotation_used",
    "mass_nis",
    "mass_used",
    "likelihood",
    "detector_event",
    "suspected_magnitude",
    "onset",
    "known_force",
)


@pytest.fixture(scope="session")
def failed_run() -> Run:
    """A flight from near the truth whose jet sticks on at 12 s; do not change its arrays."""
    return simulate(load_scenario("stuck_on_29", FAILURE))


@pytest.fixture(scope="session")
def failed_folder(failed_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return failed_run.save(tmp_path_factory.mktemp("runs") / "failed", pictures=False)


@pytest.fixture(scope="session")
def replayed(failed_run: Run, failed_folder: Path) -> Run:
    """The replay of its telemetry."""
    return estimate(failed_folder / "telemetry.csv", failed_run.scenario)


def _table(folder: Path) -> tuple[list[str], list[list[str]]]:
    with (folder / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = list(csv.reader(file))
    return header, rows


def _write(path: Path, header: list[str], rows: list[list[str]]) -> Path:
    path.write_text("".join(",".join(row) + "\n" for row in [header, *rows]), encoding="utf-8")
    return path


def _assert_equal_estimates(run: Run, replay: Run, last: int | None = None) -> None:
    """Bit for bit, of all rows or of so many at the end."""
    for name in FROM_ESTIMATORS:
        if name in run.signals:
            expected = run[name] if last is None else run[name][-last:]
            np.testing.assert_array_equal(replay[name], expected, err_msg=name)
    np.testing.assert_array_equal(replay.covariance, run.covariance)
    for key in ("estimates", "standard_deviations", "covariance", "derived", "detections"):
        assert replay.summary[key] == run.summary[key], key


# -------------------------------------------------------------------------------------- round trip


def test_a_failure_is_found_again_and_a_sound_record_has_no_warnings(
    failed_run: Run, failed_folder: Path, replayed: Run, tmp_path: Path
) -> None:
    _assert_equal_estimates(failed_run, replayed)
    quality = replayed.summary["data_quality"]
    assert quality["warnings"] == []
    for name, counts in quality["samples"].items():
        assert sum(counts.values()) == quality["rows"] == 166, name
    replayed.save(tmp_path / "replay", pictures=False, report=False)
    assert (tmp_path / "replay" / "telemetry.csv").read_bytes() == (failed_folder / "telemetry.csv").read_bytes()
    (entry,) = replayed.summary["detections"]
    assert (entry["jet"], entry["kind"]) == ("R4R", "jet_on")
    assert replayed["known_force"][-1].any()  # the force counts as known from then on


# ------------------------------------------------------------------------------------------ summary


def test_nothing_is_said_of_the_truth(failed_run: Run, replayed: Run) -> None:
    summary = replayed.summary
    nothing = {"inverse_inertia": [[None] * 3] * 3, "center_of_mass": [None] * 3, "mass_reciprocal": None}
    assert summary["truth"] == summary["percent_error"] == nothing
    assert list(summary) == [*failed_run.summary, "data_quality"]
    assert summary["autopilot"]["lp_solves"] is None
    assert summary["provenance"]["telemetry"] == "telemetry.csv"
    assert len(summary["provenance"]["telemetry_sha256"]) == 64
    assert not replayed.scenario.failures
    assert not replayed.scenario.maneuver
    json.dumps(summary, allow_nan=False)


def test_how_many_rows_are_read_at_once_changes_nothing(
    failed_folder: Path, replayed: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(Reader.__init__.__kwdefaults__, "rows_per_block", 7)
    again = estimate(failed_folder / "telemetry.csv", replayed.scenario)
    for part in ("autopilot", "detections"):
        assert again.summary[part] == replayed.summary[part], part
    assert again.summary["data_quality"]["samples"] == replayed.summary["data_quality"]["samples"]
    for name, value in replayed.summary["consistency"].items():
        mean = name.endswith("_mean")  # of sums, in another order
        assert again.summary["consistency"][name] == (pytest.approx(value) if mean else value), name
    np.testing.assert_array_equal(again["estimate"], replayed["estimate"])


# --------------------------------------------------------------------------------------- imperfect


Change = Callable[[list[str], list[list[str]]], None]


def _cells(column: str, new: Callable[[str], str], rows: slice = slice(None)) -> Change:
    """Replaces the cells of columns that begin so."""

    def change(header: list[str], table: list[list[str]]) -> None:
        for row in table[rows]:
            row[:] = [new(cell) if name.startswith(column) else cell for name, cell in zip(header, row, strict=True)]

    return change


def _set(column: str, rows: slice, text: str) -> Change:
    return _cells(column, lambda _: text, rows)


def _scaled(column: str, factor: float) -> Change:
    return _cells(column, lambda cell: repr(factor * float(cell)))


def _changed(folder: Path, path: Path, *changes: Change) -> Path:
    header, rows = _table(folder)
    for change in changes:
        change(header, rows)
    return _write(path, header, rows)


def test_estimates_are_kept_over_a_gap(failed_run: Run, failed_folder: Path, tmp_path: Path) -> None:
    header, rows = _table(failed_folder)
    del rows[80:110]
    run = estimate(_write(tmp_path / "gap.csv", header, rows), failed_run.scenario)
    (gap,) = np.flatnonzero(run["gap"][:, 0])
    assert gap == 80
    np.testing.assert_array_equal(run["estimate"][80], run["estimate"][81])
    assert (run["rotation_used"][80:83] == 0.0).all()  # differences start anew, and the command is unknown at first
    assert np.isfinite(run["estimate"]).all()
    quality = run.summary["data_quality"]
    assert quality["gaps"]["count"] == 1
    assert quality["gaps"]["longest_s"] == pytest.approx(31 * 0.08)
    assert quality["samples"]["rotation"]["first_after_start_or_gap"] == 2
    assert any("1 gap in time, 2.48 s the longest, the first after 6.32 s" in text for text in quality["warnings"])
    assert len(run.summary["detections"]) == 1


@pytest.mark.parametrize(
    ("column", "reason", "filters"),
    [
        ("gyro", "gyro_missing", ["rotation", "mass"]),
        ("acc", "accelerometer_missing", ["mass"]),
        ("jet_R4R", "command_missing", ["rotation", "mass"]),  # one of them is enough
    ],
)
def test_what_is_missing_is_skipped_at_that_sample_alone(
    failed_run: Run, failed_folder: Path, tmp_path: Path, column: str, reason: str, filters: list[str]
) -> None:
    (used,) = np.nonzero(failed_run["mass_used"][:, 0])
    at = int(used[10])
    if column.startswith("jet_"):
        at -= 1  # the command of the interval before
    path = _changed(failed_folder, tmp_path / "log.csv", _set(column, slice(at, at + 1), ""))
    run = estimate(path, failed_run.scenario)
    counts = run.summary["data_quality"]["samples"]
    for name in ("rotation", "mass"):
        assert counts[name][reason] == ((1 if column.startswith("jet_") else 2) if name in filters else 0), name
    assert counts["mass"]["used"] < failed_run.summary["consistency"]["samples"]
    assert (counts["rotation"]["used"] == failed_run.summary["consistency"]["samples"]) == ("rotation" not in filters)
    assert np.isfinite(run["estimate"]).all()


WRONG: dict[str, tuple[Change, str]] = {
    "degrees": (_scaled("gyro", 57.29578), "gyro changes by 57.3 times .*; it looks like degrees in place of radians"),
    "meters": (_scaled("acc2", 0.3048), "acc2 changes by 0.3.* times .*; it looks like meters in place of feet"),
    "sign": (_scaled("gyro", -1.0), "gyro changes by -1 times .*; it looks like a wrong sign or wrong axes"),
    "stuck": (_set("gyro_y", slice(95, None), "0.001"), r"gyro_y stands still from 7.6 to 13.2 s while the jets com"),
    "jump": (_set("gyro_z", slice(100, 101), "0.3"), r"gyro jumps 2 times by more than all jets could .* at 8 s"),
    "no command": (
        _set("jet_", slice(100, 103), ""),
        r"commands unknown from 8 s to 8.24 s \(3 of 166 samples\): not tested for failures there, and these samples",
    ),
    "missing": (_set("acc2_x", slice(100, 103), ""), "acc2 is missing in 3 rows"),
    "unread": (
        _set("gyro", slice(0, None), ""),
        "no sample was tested for failed jets, since the estimates did not conv",
    ),
    "no firing": (_set("jet_", slice(None), "0"), "no sample could be used for .* reason was: coasting"),
}


def without_detector(run: Run) -> Scenario:
    """The run's settings; wrong readings would keep a detector busy."""
    detector = run.scenario.detector.model_copy(update={"kind": "off"})
    return run.scenario.model_copy(update={"detector": detector})


@pytest.mark.parametrize("name", list(WRONG))
def test_what_is_wrong_with_a_record_is_told(failed_run: Run, failed_folder: Path, tmp_path: Path, name: str) -> None:
    change, message = WRONG[name]
    scenario = failed_run.scenario if name == "unread" else without_detector(failed_run)
    run = estimate(_changed(failed_folder, tmp_path / "log.csv", change), scenario)
    warnings = run.summary["data_quality"]["warnings"]
    assert any(re.search(message, text) for text in warnings), warnings


def test_a_reading_is_stuck_though_it_has_taught_the_filter_that_nothing_moves_it(tmp_path: Path) -> None:
    settings = ["duration_s=15", "failures=[]", "detector.kind=off", "execution.engine=loop"]
    run = simulate(load_scenario("small_satellite_maneuver", settings), look_back=False)
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    stuck = _set("gyro_x", slice(int(0.4 * run.time_s.size), None), "0.001")
    found = estimate(_changed(folder, tmp_path / "log.csv", stuck), run.scenario)
    assert any("gyro_x stands still from" in text for text in found.summary["data_quality"]["warnings"])


def test_units_of_gyro_and_accelerometers_that_are_both_wrong_are_told(
    failed_run: Run, failed_folder: Path, tmp_path: Path
) -> None:
    changes = _scaled("gyro", 57.29578), *(_scaled(name, 0.3048) for name in ("acc1", "acc2", "acc3"))
    run = estimate(_changed(failed_folder, tmp_path / "log.csv", *changes), without_detector(failed_run))
    warnings = " ".join(run.summary["data_quality"]["warnings"])
    assert "it looks like degrees in place of radians" in warnings
    assert warnings.count("it looks like meters in place of feet") == 3


def test_readings_at_the_end_of_the_range_are_counted(
    failed_run: Run, failed_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(Reader.__init__.__kwdefaults__, "rows_per_block", 1)
    vehicle = failed_run.scenario.vehicle_data
    limit = float(np.abs(failed_run["gyro"]).max())
    gyro = vehicle.gyros[0].model_copy(update={"range": limit})
    scenario = failed_run.scenario.model_copy(update={"vehicle": vehicle.model_copy(update={"gyros": (gyro,)})})
    quality = estimate(failed_folder / "telemetry.csv", scenario).summary["data_quality"]
    assert quality["saturated"]["gyro"] == (np.abs(failed_run["gyro"]) >= limit * (1.0 - 1e-9)).any(axis=1).sum() > 0
    assert any("gyro is at the end of its range" in text for text in quality["warnings"])


def test_what_the_vehicles_own_rate_changes_is_no_jump_and_no_wrong_unit(tmp_path: Path) -> None:
    """A turn of 1.5 rad/s moves an accelerometer 60 ft off the axis by 10 ft/s in a sample, and more than all jets."""
    case = load_scenario("orbiter_maneuver", ["plant.initial_rate=[0, 0, 1.5]", "duration_s=6", LOOP])
    folder = simulate(case, look_back=False).save(tmp_path / "run", pictures=False, report=False)
    for change, jumps in ((_set("gyro_x", slice(0), ""), set()), (_set("gyro_x", slice(20, 21), "9"), {"gyro"})):
        run = estimate(_changed(folder, tmp_path / "log.csv", change), case)
        quality = run.summary["data_quality"]
        assert quality["jumps"].keys() == jumps
        assert not any("changes by" in text for text in quality["warnings"])


# ----------------------------------------------------------------------------------------- going on


@pytest.mark.parametrize(("after", "begin"), [(-40, 1), (-1, 0), (1, 0)])
def test_a_record_may_be_split_anywhere(
    failed_folder: Path, replayed: Run, failed_run: Run, tmp_path: Path, after: int, begin: int
) -> None:
    """Also about the row at which the failure is declared; that at the boundary is in both parts, or in the first."""
    header, rows = _table(failed_folder)
    cut = int(np.searchsorted(failed_run.time_s, failed_run.results.detections[0].time_s)) + after
    first = estimate(_write(tmp_path / "one.csv", header, rows[: cut + 1]), failed_run.scenario)
    first.save(tmp_path / "one", pictures=False, report=False)
    rest = _write(tmp_path / "rest.csv", header, rows[cut + begin :])
    whole = failed_folder / "telemetry.csv"
    for record in (rest, whole) if after == 1 else (rest,):
        second = estimate(record, failed_run.scenario, resume_from=tmp_path / "one")
        assert second.time_s.size == len(rows) - cut - 1
        _assert_equal_estimates(replayed, second, last=second.time_s.size)
        assert second.state["states"] == replayed.state["states"]
        assert second.summary["data_quality"]["gaps"]["count"] == 0
        if record == whole:
            assert second.summary["data_quality"]["before_start"] == cut  # what the earlier part had is skipped


def test_a_state_of_other_settings_or_another_vehicle_is_refused(failed_folder: Path, toy_data: dict[str, Any]) -> None:
    words = r"filter_state.json: is of other settings: detector.kind was 'cglr' and is 'off'.*; go on with"
    with pytest.raises(InputError, match=words):
        estimate("nowhere.csv", load_scenario(failed_folder, ["detector.kind=off"]), resume_from=failed_folder)
    with pytest.raises(InputError, match=r"is of vehicle 'orbiter' with the digest .* and 'toy' here has .*; go on"):
        estimate("nowhere.csv", Scenario(vehicle=Vehicle.model_validate(toy_data)), resume_from=failed_folder)


NO_RUN_LEAVES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "unknown format": (lambda state: state.update(format=3), "format: input should be less than or equal to 2, got 3"),
    "no fingerprint": (lambda state: state.pop("made_with"), "has no 'made_with'"),
    "negative row": (lambda state: state.update(row=-1), "row: input should be greater"),
    "recent times back": (lambda state: state["recent_s"].reverse(), "recent_s: must go forward"),
    "another time": (lambda state: state.update(time_s=1e-6), "recent_s: must end at time_s"),
    "strange detection": (lambda state: state["detections"][0].update(kind="x"), r"detections\[0\].kind: 'x' is not"),
    "jet 44": (lambda state: state["detections"][0].update(jet_index=44), "has no jet of index 44"),
    "velocity": (lambda state: state.update(velocity={"acc1": [1.0]}), "velocity.acc1: must have 3 values"),
    "short state": (lambda state: state["states"]["impulse_model"][0].pop(), "impulse_model has sizes"),
    "one more state": (lambda state: state["states"].update(x=[[1.0]]), "state of x has sizes"),
    "another covariance": (lambda state: state["covariance"][0].__setitem__(0, 1.0), "covariance: is unlike"),
}
# group, place in its vector, value, message
PUT: dict[str, tuple[str, int, float | None, str]] = {
    "asymmetric": ("rotation_estimator", 9 + 1, 1e-9, "covariance of the estimates must be symmetric"),
    "negative variance": ("rotation_estimator", 9, -1.0, "positive semidefinite"),
    "unknown estimate": ("rotation_estimator", 0, None, "only readings may be missing"),
    "certain": ("mass_estimator", 1, 0.0, "positive definite"),
    "negative mass": ("mass_estimator", 0, -1e-4, "cannot be negative"),
    "another 1/m": ("mass_estimator", 0, 2e-4, "estimate: is unlike the one in 'states'"),
    "level of two": ("impulse_model", -1, 2.0, "must be fractions"),
    "half removed": ("failure_detector", -1, 0.5, "must be 0 or 1"),
}


@pytest.mark.parametrize("name", [*NO_RUN_LEAVES, *PUT, "torn", "not finite"])
def test_a_state_that_no_run_leaves_is_refused(failed_folder: Path, failed_run: Run, tmp_path: Path, name: str) -> None:
    state = json.loads((failed_folder / "filter_state.json").read_text(encoding="utf-8"))
    text = {"torn": "", "not finite": '{"row": 1e400}'}.get(name)
    words = "not valid JSON"
    if name in PUT:
        group, place, value, words = PUT[name]
        state["states"][group][0][place] = value
    elif name in NO_RUN_LEAVES:
        change, words = NO_RUN_LEAVES[name]
        change(state)
    (tmp_path / "filter_state.json").write_text(json.dumps(state) if text is None else text, encoding="utf-8")
    with pytest.raises(InputError, match=f"filter_state.json: .*{words}"):
        estimate(failed_folder / "telemetry.csv", failed_run.scenario, resume_from=tmp_path)


# ------------------------------------------------------------------------------------------- others


def test_rows_of_a_stream_are_estimated_as_they_come(failed_folder: Path, failed_run: Run, replayed: Run) -> None:
    found: list[DetectionRecord] = []
    content = (failed_folder / "telemetry.csv").read_bytes()
    run = estimate("-", failed_run.scenario, stream=io.BytesIO(content), declared=found.append)
    _assert_equal_estimates(replayed, run)
    assert [entry.jet for entry in found] == ["R4R"]
    assert run.summary["provenance"]["telemetry_sha256"] == replayed.summary["provenance"]["telemetry_sha256"]


def test_neither_the_estimator_nor_estimating_nor_its_report_loads_drake(failed_folder: Path, tmp_path: Path) -> None:
    program = f"""
import sys
from massprop_drake import Estimator, estimate, load_scenario
scenario = load_scenario({str(failed_folder / "scenario.yaml")!r})
Estimator(scenario.vehicle_data, scenario).step(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 44)
print(*{{"pydrake", "matplotlib", "scipy", "typer"}} & {{name.partition(".")[0] for name in sys.modules}})
estimate({str(failed_folder / "telemetry.csv")!r}, scenario).save({str(tmp_path / "again")!r}, pictures=False)
print("pydrake" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["", "False"]
    assert (tmp_path / "again" / "report.html").exists()
