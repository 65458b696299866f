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
from numpy.typing import NDArray
from telemetry_probe import Log, toy_vehicle

from massprop_drake import InputError, Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.diagrams import estimation
from massprop_drake.display import plots
from massprop_drake.display.figures import Plots
from massprop_drake.records.reader import Reader
from massprop_drake.records.rows import vehicle_scenario
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

FAILURE = ["duration_s=33", "failures=[{kind: stuck_on, jet: R4R, start_s: 30}]"]
LAG = ["plant.thrust_transient=vehicle", "estimation.thrust_transient=gate_lag"]
NOISE = "sensors.errors=[{sensor: gyro, noise_std: 2.0e-6, bias: [1.0e-6, 0, 0]}, {sensor: acc2, noise_std: 0.01}]"
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
    """The first 33 s of the maneuver with a jet that sticks on at 30 s; do not change its arrays."""
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


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("sample_maneuver", ["duration_s=27", NOISE]),
        ("sample_maneuver", ["duration_s=12", *LAG]),
        ("sample_maneuver", ["duration_s=8", "plant.time_step=0", *LAG]),
        ("stuck_on_29", [*FAILURE, *LAG, NOISE]),
        ("jet_pulses", ["duration_s=6"]),
    ],
    ids=["noise", "lag", "continuous plant", "failure, lag and noise", "open loop"],
)
def test_a_runs_telemetry_gives_the_runs_estimates(scenario: str, overrides: list[str], tmp_path: Path) -> None:
    run = simulate(load_scenario(scenario, overrides))
    run.save(tmp_path / "run", pictures=False, report=False)
    replay = estimate(tmp_path / "run" / "telemetry.csv", load_scenario(tmp_path / "run"))
    _assert_equal_estimates(run, replay)
    np.testing.assert_array_equal(replay.time_s, run.time_s)
    assert replay.summary["consistency"]["samples"] == run.summary["consistency"]["samples"]
    assert replay.summary["autopilot"]["firings"] == run.summary["autopilot"]["firings"]


def test_a_failure_is_found_again(failed_run: Run, replayed: Run) -> None:
    _assert_equal_estimates(failed_run, replayed)
    (entry,) = replayed.summary["detections"]
    assert (entry["jet"], entry["kind"]) == ("R4R", "jet_on")
    assert replayed["known_force"][-1].any()  # the force counts as known from then on


def test_the_replay_of_a_replay_is_the_same(
    failed_run: Run, failed_folder: Path, replayed: Run, tmp_path: Path
) -> None:
    replayed.save(tmp_path / "replay", pictures=False, report=False)
    assert (tmp_path / "replay" / "telemetry.csv").read_bytes() == (failed_folder / "telemetry.csv").read_bytes()
    loaded = Run.load(tmp_path / "replay")
    _assert_equal_estimates(failed_run, loaded)
    assert loaded.summary == replayed.summary
    assert loaded.units == replayed.units
    assert load_scenario(tmp_path / "replay") == replayed.scenario
    for name in replayed.signals:
        if name != "time_s":
            np.testing.assert_array_equal(loaded[name], replayed[name], err_msg=name)


def test_times_are_the_records_own(failed_run: Run, failed_folder: Path, tmp_path: Path) -> None:
    header, rows = _table(failed_folder)
    for row in rows:
        row[0] = repr(float(row[0]) + 1000.0)
    replay = estimate(_write(tmp_path / "late.csv", header, rows), failed_run.scenario)
    np.testing.assert_array_equal(replay["estimate"], failed_run["estimate"])
    np.testing.assert_allclose(replay.time_s, failed_run.time_s + 1000.0, rtol=0.0, atol=1e-9)
    (expected,), (entry,) = failed_run.summary["detections"], replay.summary["detections"]
    for key in ("onset_s", "time_s"):
        assert entry[key] == pytest.approx(expected[key] + 1000.0, abs=1e-9)
    assert replay.summary["duration_s"] == pytest.approx(32.96)


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


def test_propellant_is_that_of_the_commands(failed_run: Run, replayed: Run) -> None:
    vehicle = failed_run.scenario.vehicle_data
    expected = (failed_run["command"][:-1] @ vehicle.mass_flows).sum() * vehicle.sample_period_s
    assert replayed.summary["autopilot"]["propellant_mass"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("rows_per_block", [1, 7])
def test_how_many_rows_are_read_at_once_changes_nothing(
    failed_folder: Path, replayed: Run, rows_per_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(Reader.__init__.__kwdefaults__, "rows_per_block", rows_per_block)
    again = estimate(failed_folder / "telemetry.csv", replayed.scenario)
    for part in ("autopilot", "detections"):
        assert again.summary[part] == replayed.summary[part], part
    assert again.summary["data_quality"]["samples"] == replayed.summary["data_quality"]["samples"]
    for name, value in replayed.summary["consistency"].items():
        mean = name.endswith("_mean")  # of sums, in another order
        assert again.summary["consistency"][name] == (pytest.approx(value) if mean else value), name
    np.testing.assert_array_equal(again["estimate"], replayed["estimate"])


def test_a_sound_record_has_no_warnings(replayed: Run) -> None:
    quality = replayed.summary["data_quality"]
    assert quality["warnings"] == []
    for name, counts in quality["samples"].items():
        assert sum(counts.values()) == quality["rows"] == 413, name
    assert quality["samples"]["rotation"]["used"] == replayed.summary["consistency"]["samples"]
    assert quality["units"]["gyro"]["slope"] == pytest.approx(1.0, abs=0.01)


def test_figures_need_no_truth(replayed: Run) -> None:
    names = {name for name, figure in Plots(plots.source(replayed)).all().items() if figure.axes}
    assert {"gyro_readings", "accelerometer_velocities", "jets", "inverse_inertia_diagonal", "consistency"} <= names
    assert {"likelihoods", "margins", "failure_magnitude", "detection_timeline", "mass_reciprocal"} <= names
    assert not {"rates", "velocities", "torques", "forces"} & names


# --------------------------------------------------------------------------------------- imperfect


Change = Callable[[list[str], list[list[str]]], None]


def _set(column: str, rows: slice, text: str) -> Change:
    def change(header: list[str], table: list[list[str]]) -> None:
        for row in table[rows]:
            for index, name in enumerate(header):
                if name.startswith(column):
                    row[index] = text

    return change


def _scaled(column: str, factor: float) -> Change:
    def change(header: list[str], table: list[list[str]]) -> None:
        for row in table:
            for index, name in enumerate(header):
                if name.startswith(column):
                    row[index] = repr(factor * float(row[index]))

    return change


def _changed(folder: Path, path: Path, *changes: Change) -> Path:
    header, rows = _table(folder)
    for change in changes:
        change(header, rows)
    return _write(path, header, rows)


def test_estimates_are_kept_over_a_gap(failed_run: Run, failed_folder: Path, tmp_path: Path) -> None:
    header, rows = _table(failed_folder)
    del rows[200:230]
    run = estimate(_write(tmp_path / "gap.csv", header, rows), failed_run.scenario)
    (gap,) = np.flatnonzero(run["gap"][:, 0])
    assert gap == 200
    np.testing.assert_array_equal(run["estimate"][200], run["estimate"][201])
    assert (run["rotation_used"][200:203] == 0.0).all()  # differences start anew, and the command is unknown at first
    assert np.isfinite(run["estimate"]).all()
    quality = run.summary["data_quality"]
    assert quality["gaps"]["count"] == 1
    assert quality["gaps"]["longest_s"] == pytest.approx(31 * 0.08)
    assert quality["samples"]["rotation"]["first_after_start_or_gap"] == 2
    assert any("1 gap in time, 2.48 s the longest, the first after 15.92 s" in text for text in quality["warnings"])
    assert len(run.summary["detections"]) == 1


def test_a_run_that_was_loaded_is_saved_as_it_was(failed_run: Run, failed_folder: Path, tmp_path: Path) -> None:
    header, rows = _table(failed_folder)
    del rows[20:30]
    record = _write(tmp_path / "gap.csv", header, rows[:40])  # cut, so that its last row has a command
    run = estimate(record, failed_run.scenario)
    run.save(tmp_path / "once", pictures=False, report=False)
    Run.load(tmp_path / "once").save(tmp_path / "again", pictures=False, report=False)
    for name in ("telemetry.csv", "history.npz", "filter_state.json"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "once" / name).read_bytes(), name
    assert (tmp_path / "once" / "telemetry.csv").read_bytes() == record.read_bytes()


@pytest.mark.parametrize(
    ("column", "reason", "filters"),
    [
        ("gyro", "gyro_missing", ["rotation", "mass"]),
        ("acc", "accelerometer_missing", ["mass"]),
        ("jet_", "command_missing", ["rotation", "mass"]),
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


def test_where_one_of_three_accelerometers_is_missing_the_others_go_on(
    failed_run: Run, failed_folder: Path, tmp_path: Path
) -> None:
    path = _changed(failed_folder, tmp_path / "log.csv", _set("acc2", slice(100, 300), ""))
    run = estimate(path, failed_run.scenario)
    assert run.summary["data_quality"]["missing"]["acc2"] == 200
    counts = run.summary["data_quality"]["samples"]["mass"]
    assert counts["used"] == int(failed_run["mass_used"].sum())
    assert counts["accelerometer_missing"] == 0
    assert abs(run["estimate"][-1, 9] - failed_run["estimate"][-1, 9]) < run["standard_deviation"][-1, 9]


def test_without_accelerometer_the_mass_is_as_at_the_start(
    failed_run: Run, failed_folder: Path, tmp_path: Path
) -> None:
    header, rows = _table(failed_folder)
    keep = [index for index, name in enumerate(header) if not name.startswith("acc")]
    path = _write(tmp_path / "log.csv", [header[i] for i in keep], [[row[i] for i in keep] for row in rows])
    run = estimate(path, failed_run.scenario)
    np.testing.assert_array_equal(run["estimate"][-1, 9], run["estimate"][0, 9])
    assert run.summary["data_quality"]["absent_sensors"] == ["acc1", "acc2", "acc3"]
    warnings = " ".join(run.summary["data_quality"]["warnings"])
    assert "the record has no accelerometer: the mass is not observable in it" in warnings


WRONG: dict[str, tuple[Change, str]] = {
    "degrees": (_scaled("gyro", 57.29578), "gyro changes by 57.3 times .*; it looks like degrees in place of radians"),
    "g": (_scaled("acc2", 1.0 / 32.174), "acc2 changes by 0.0.* times .*; it looks like g in place of ft/s"),
    "meters": (_scaled("acc2", 0.3048), "acc2 changes by 0.3.* times .*; it looks like meters in place of feet"),
    "milli": (_scaled("gyro", 1000.0), "gyro changes by 1e.03 times .*; it looks like a factor of 1000"),
    "sign": (_scaled("gyro", -1.0), "gyro changes by -1 times .*; it looks like a wrong sign or wrong axes"),
    "stuck": (_set("gyro_y", slice(250, None), "0.001"), r"gyro_y stands still from 20 to 32.96 s while the jets com"),
    "jump": (_set("gyro_z", slice(100, 101), "0.3"), r"gyro jumps 2 times by more than all jets could .* at 8 s"),
    "no command": (
        _set("jet_", slice(100, 103), ""),
        r"commands unknown from 8 s to 8.24 s \(3 of 413 samples\): not tested for failures there, and these samples",
    ),
    "missing": (_set("acc2_x", slice(100, 103), ""), "acc2 is missing in 3 rows"),
    "no firing": (_set("jet_", slice(None), "0"), "no sample could be used for .* reason was: coasting"),
}


@pytest.mark.parametrize("name", list(WRONG))
def test_what_is_wrong_with_a_record_is_told(failed_run: Run, failed_folder: Path, tmp_path: Path, name: str) -> None:
    change, message = WRONG[name]
    scenario = failed_run.scenario.model_copy(
        update={"detector": failed_run.scenario.detector.model_copy(update={"kind": "off"})}
    )
    run = estimate(_changed(failed_folder, tmp_path / "log.csv", change), scenario)
    warnings = run.summary["data_quality"]["warnings"]
    assert any(re.search(message, text) for text in warnings), warnings


def test_units_of_gyro_and_accelerometers_that_are_both_wrong_are_told(
    failed_run: Run, failed_folder: Path, tmp_path: Path
) -> None:
    changes = _scaled("gyro", 57.29578), *(_scaled(name, 0.3048) for name in ("acc1", "acc2", "acc3"))
    run = estimate(_changed(failed_folder, tmp_path / "log.csv", *changes), failed_run.scenario)
    warnings = " ".join(run.summary["data_quality"]["warnings"])
    assert "it looks like degrees in place of radians" in warnings
    assert warnings.count("it looks like meters in place of feet") == 3


@pytest.mark.parametrize("spike", [False, True])
def test_what_the_vehicles_own_rate_changes_is_no_jump_and_no_wrong_unit(tmp_path: Path, spike: bool) -> None:
    """A turn of 1.5 rad/s moves an accelerometer 60 ft off the axis by 10 ft/s in a sample, and more than all jets."""
    turning = ["plant.initial_rate=[0, 0, 1.5]", "duration_s=8"]
    case = load_scenario("orbiter_maneuver", turning)
    folder = simulate(case).save(tmp_path / "run", pictures=False, report=False)
    change = _set("gyro_x", slice(20, 21), "9") if spike else _set("gyro_x", slice(0), "")
    run = estimate(_changed(folder, tmp_path / "log.csv", change), case)
    quality = run.summary["data_quality"]
    assert quality["jumps"].keys() == ({"gyro"} if spike else set())
    assert not any("changes by" in text for text in quality["warnings"])


@pytest.mark.parametrize("rows_per_block", [1, 1024])
def test_readings_at_the_end_of_the_range_are_counted(
    failed_run: Run, failed_folder: Path, rows_per_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(Reader.__init__.__kwdefaults__, "rows_per_block", rows_per_block)
    vehicle = failed_run.scenario.vehicle_data
    limit = float(np.abs(failed_run["gyro"]).max())
    gyro = vehicle.gyros[0].model_copy(update={"range": limit})
    scenario = failed_run.scenario.model_copy(update={"vehicle": vehicle.model_copy(update={"gyros": (gyro,)})})
    quality = estimate(failed_folder / "telemetry.csv", scenario).summary["data_quality"]
    assert quality["saturated"]["gyro"] == (np.abs(failed_run["gyro"]) >= limit * (1.0 - 1e-9)).any(axis=1).sum() > 0
    assert any("gyro is at the end of its range" in text for text in quality["warnings"])


# ----------------------------------------------------------------------------------------- going on


@pytest.mark.parametrize("cut", [50, 250, 375, 376, 377, 378, 379, 400])  # the failure is declared around 377
def test_a_record_may_be_split_anywhere(
    failed_folder: Path, replayed: Run, failed_run: Run, tmp_path: Path, cut: int
) -> None:
    header, rows = _table(failed_folder)
    first = estimate(_write(tmp_path / "one.csv", header, rows[: cut + 1]), failed_run.scenario)
    first.save(tmp_path / "one", pictures=False, report=False)
    for begin in (cut, cut + 1):  # the row at the boundary is in both parts, or in the first alone
        rest = _write(tmp_path / f"from_{begin}.csv", header, rows[begin:])
        second = estimate(rest, failed_run.scenario, resume_from=tmp_path / "one")
        assert second.time_s.size == len(rows) - cut - 1
        _assert_equal_estimates(replayed, second, last=second.time_s.size)
        assert second.state["states"] == replayed.state["states"]
        assert second.summary["data_quality"]["gaps"]["count"] == 0


def test_rows_that_an_earlier_part_had_are_skipped(
    failed_folder: Path, replayed: Run, failed_run: Run, tmp_path: Path
) -> None:
    header, rows = _table(failed_folder)
    path = _write(tmp_path / "one.csv", header, rows[:301])
    estimate(path, failed_run.scenario).save(tmp_path / "one", pictures=False, report=False)
    second = estimate(failed_folder / "telemetry.csv", failed_run.scenario, resume_from=tmp_path / "one")
    _assert_equal_estimates(replayed, second, last=112)
    assert second.summary["data_quality"]["before_start"] == 300


def test_a_simulated_run_can_be_gone_on_from(failed_folder: Path, replayed: Run, tmp_path: Path) -> None:
    scenario = load_scenario("stuck_on_29", [*FAILURE, "duration_s=24"])
    simulate(scenario).save(tmp_path / "run", pictures=False, report=False)
    second = estimate(failed_folder / "telemetry.csv", scenario, resume_from=tmp_path / "run")
    _assert_equal_estimates(replayed, second, last=second.time_s.size)


def test_accelerations_and_outside_forces_go_on_as_well(toy_data: dict[str, Any], tmp_path: Path) -> None:
    scenario = Scenario(vehicle=toy_vehicle(toy_data))
    log = Log(toy_vehicle(toy_data))
    for axis in "xyz":
        column = log.column(f"acc_{axis}")
        velocity = np.array([float(row[column]) for row in log.rows])
        log.drop(f"acc_{axis}")
        log.add(f"acc_accel_{axis}", [repr(float(value)) for value in np.diff(velocity, prepend=0.0) / 0.1])
    for name in ("known_force", "known_torque"):
        for axis in "xyz":
            log.add(f"{name}_{axis}", ["0.001"] * 60)
    whole = estimate(log.write(tmp_path / "whole.csv"), scenario)
    rows = log.rows
    log.rows = rows[:31]
    estimate(log.write(tmp_path / "one.csv"), scenario).save(tmp_path / "one", pictures=False, report=False)
    log.rows = rows[30:]
    second = estimate(log.write(tmp_path / "two.csv"), scenario, resume_from=tmp_path / "one")
    _assert_equal_estimates(whole, second, last=29)
    np.testing.assert_array_equal(second["acc"], whole["acc"][-29:])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("detector.kind=off", "detector.kind was 'cglr' and is 'off'"),
        ("mass.jump=glr", "mass.jump was 'single_sample' and is 'glr'"),
        ("rotation.jump_threshold=11.34", "rotation.jump_threshold was 25.0 and is 11.34"),
        ("sensors.accelerometer=acc3", "sensors.accelerometer was None and is 'acc3'"),
        ("estimation.start=nominal", "estimation.start was 'zero' and is 'nominal'"),
    ],
)
def test_a_state_of_other_settings_is_refused(failed_folder: Path, failed_run: Run, override: str, words: str) -> None:
    other = load_scenario(failed_folder, [override])
    with pytest.raises(InputError, match=f"filter_state.json: is of other settings: .*{words}.*; go on with"):
        estimate("nowhere.csv", other, resume_from=failed_folder)


def test_what_is_not_the_estimators_may_differ(failed_folder: Path, tmp_path: Path) -> None:
    overrides = ["failures=[]", "seed=3", "plant.depletion=false", "sensors.quantizer_phase=equal", "name=other"]
    with pytest.raises(InputError, match="no such file"):  # of the record: the state has been taken
        estimate(tmp_path / "nowhere.csv", load_scenario(failed_folder, overrides), resume_from=failed_folder)


def test_a_state_of_another_vehicle_is_refused(failed_folder: Path, toy_data: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"is of vehicle 'orbiter' with the digest .* and 'toy' here has .*; go on"):
        estimate("nowhere.csv", Scenario(vehicle=toy_vehicle(toy_data)), resume_from=failed_folder)
    vehicle = load_scenario(failed_folder).vehicle_data
    heavier = vehicle.model_copy(update={"uncertainty": 0.31})
    with pytest.raises(InputError, match=r"is of vehicle 'orbiter' with the digest .* and 'orbiter' here has"):
        estimate("nowhere.csv", Scenario(vehicle=heavier), resume_from=failed_folder)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not valid JSON"),
        ("[]", "input should be a valid mapping"),
        ("{}", "time_s: missing"),
        ('{"row": 1e400}', "not valid JSON: 1e400 is not finite"),
        ('{"row": NaN}', "not valid JSON: NaN is not finite"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_a_damaged_state_is_refused(failed_run: Run, tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(InputError, match=r"filter_state.json: no such file"):
        estimate("nowhere.csv", failed_run.scenario, resume_from=tmp_path)
    (tmp_path / "filter_state.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=f"filter_state.json: {words}"):
        estimate("nowhere.csv", failed_run.scenario, resume_from=tmp_path)


def _put(state: dict[str, Any], group: str, place: int, value: Any) -> None:
    state["states"][group][0][place] = value


def _asymmetric(state: dict[str, Any]) -> None:
    _put(state, "rotation_estimator", 9 + 1, 1e-9)  # the covariance begins after nine estimates


def _indefinite(state: dict[str, Any]) -> None:
    for place in (9 + 1, 9 + 9):
        vector = state["states"]["rotation_estimator"][0]
        vector[place] = 1.1 * (vector[9] * vector[9 + 10]) ** 0.5


NO_RUN_LEAVES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "unknown format": (lambda state: state.update(format=3), "format: input should be less than or equal to 2, got 3"),
    "no fingerprint": (lambda state: state.pop("made_with"), "has no 'made_with'"),
    "one more key": (lambda state: state.update(more=1), "more: unknown key"),
    "word for a row": (lambda state: state.update(row="x"), "row: input should be a valid integer"),
    "negative row": (lambda state: state.update(row=-1), "row: input should be greater"),
    "flag for a time": (lambda state: state.update(time_s=True), "time_s: input should be a valid number"),
    "recent times back": (lambda state: state["recent_s"].reverse(), "recent_s: must go forward"),
    "another time": (lambda state: state.update(time_s=1e-6), "recent_s: must end at time_s"),
    "no recent times": (lambda state: state.update(recent_s=[]), "recent_s: "),
    "command of two": (lambda state: state.update(command=[2.0] * 44), "command.*less than or equal to 1"),
    "detections of words": (lambda state: state.update(detections=["x"]), r"detections\[0\]: "),
    "strange detection": (lambda state: state["detections"][0].update(kind="x"), r"detections\[0\].kind: 'x' is not"),
    "jet 44": (lambda state: state["detections"][0].update(jet_index=44), "has no jet of index 44"),
    "velocity": (lambda state: state.update(velocity={"acc1": [1.0]}), "velocity.acc1: must have 3 values"),
    "short state": (lambda state: state["states"]["impulse_model"][0].pop(), "impulse_model has sizes"),
    "one more state": (lambda state: state["states"].update(x=[[1.0]]), "state of x has sizes"),
    "asymmetric": (_asymmetric, "covariance of the estimates must be symmetric"),
    "indefinite": (_indefinite, "covariance of the estimates must be symmetric and positive semidefinite"),
    "negative variance": (lambda state: _put(state, "rotation_estimator", 9, -1.0), "positive semidefinite"),
    "negative variance of 1/m": (lambda state: _put(state, "mass_estimator", 1, -1e-9), "positive semidefinite"),
    "unknown estimate": (lambda state: _put(state, "rotation_estimator", 0, None), "only readings may be missing"),
    "unknown 1/m": (lambda state: _put(state, "mass_estimator", 0, None), "only readings may be missing"),
    "certain": (lambda state: _put(state, "mass_estimator", 1, 0.0), "positive definite"),
    "negative mass": (lambda state: _put(state, "mass_estimator", 0, -1e-4), "cannot be negative"),
    "negative inertia": (lambda state: _put(state, "rotation_estimator", 0, -1e-6), "cannot be negative"),
    "another estimate": (
        lambda state: state["estimate"].__setitem__(9, 1.0),
        "estimate: is unlike the one in 'states'",
    ),
    "another 1/m": (lambda state: _put(state, "mass_estimator", 0, 2e-4), "estimate: is unlike the one in 'states'"),
    "another covariance": (lambda state: state["covariance"][0].__setitem__(0, 1.0), "covariance: is unlike"),
    "nine estimates": (lambda state: state["estimate"].pop(), "estimate: "),
    "nine rows": (lambda state: state["covariance"].pop(), "covariance: "),
    "level of two": (lambda state: _put(state, "impulse_model", -1, 2.0), "must be fractions"),
    "unknown alarms": (lambda state: _put(state, "failure_detector", 1, None), "failure_detector: must be finite"),
    "half removed": (lambda state: _put(state, "failure_detector", -1, 0.5), "must be 0 or 1"),
}


@pytest.mark.parametrize("name", NO_RUN_LEAVES)
def test_a_state_that_no_run_leaves_is_refused(failed_folder: Path, failed_run: Run, tmp_path: Path, name: str) -> None:
    change, words = NO_RUN_LEAVES[name]
    state = json.loads((failed_folder / "filter_state.json").read_text(encoding="utf-8"))
    change(state)
    (tmp_path / "filter_state.json").write_text(json.dumps(state), encoding="utf-8")
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


def test_signals_lie_on_disk_and_the_logs_do_not_grow(replayed: Run) -> None:
    assert isinstance(replayed.signals, Spool)
    assert replayed["gyro"].shape == (413, 3)


def test_progress_ends_with_the_file(failed_folder: Path, failed_run: Run) -> None:
    reached: list[float] = []
    estimate(failed_folder / "telemetry.csv", failed_run.scenario, progress=reached.append)
    assert reached == sorted(reached)
    assert reached[-1] == 1.0


def test_known_outside_forces_reach_the_estimators(toy_data: dict[str, Any], tmp_path: Path) -> None:
    scenario = Scenario(vehicle=toy_vehicle(toy_data))
    if not estimation.build(scenario).HasInputPort("outside_wrench"):
        pytest.skip("the estimation diagram takes no outside forces yet")
    log = Log(toy_vehicle(toy_data))
    plain = estimate(log.write(tmp_path / "plain.csv"), scenario)
    for axis in "xyz":
        log.add(f"known_force_{axis}", ["1.0"] * 60)
    pushed = estimate(log.write(tmp_path / "pushed.csv"), scenario)
    assert not np.array_equal(plain["estimate"], pushed["estimate"])


def test_default_settings_with_a_vehicle() -> None:
    scenario = vehicle_scenario("flight", "orbiter", ["estimation.start=zero"])
    assert (scenario.name, scenario.vehicle_data.name, scenario.estimation.start) == ("flight", "orbiter", "zero")
    with pytest.raises(InputError, match="did you mean"):
        vehicle_scenario("flight", "orbiter", ["estimation.strat=zero"])  # codespell:ignore


def test_that_no_sample_was_tested_for_failed_jets_is_said(
    failed_run: Run, failed_folder: Path, tmp_path: Path
) -> None:
    path = _changed(failed_folder, tmp_path / "log.csv", _set("gyro", slice(0, None), ""))
    (warning,) = [
        text for text in estimate(path, failed_run.scenario).summary["data_quality"]["warnings"] if "tested" in text
    ]
    assert "no sample was tested for failed jets, since the estimates did not converge" in warning
    assert "Ixx⁻¹ is known to" in warning
    assert "(2 % is asked)" in warning
    whole = estimate(failed_folder / "telemetry.csv", failed_run.scenario)
    assert not any("tested" in text for text in whole.summary["data_quality"]["warnings"])


def test_neither_estimating_nor_its_report_loads_drake(failed_folder: Path, tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from massprop_drake import estimate, load_scenario\n"
        f"scenario = load_scenario({str(failed_folder / 'scenario.yaml')!r})\n"
        f"found = estimate({str(failed_folder / 'telemetry.csv')!r}, scenario)\n"
        f"found.save({str(tmp_path / 'again')!r}, pictures=False)\n"
        "print('pydrake' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
    assert (tmp_path / "again" / "report.html").exists()
