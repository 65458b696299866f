"""A run and its folder: what is in it, that it reads back, and that it appears whole or not at all."""

from __future__ import annotations

import csv
import gc
import itertools
import json
import math
import pkgutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import FILES as ALL_FILES

from massprop_drake import InputError, Run, load_scenario, simulate
from massprop_drake.display import figures
from massprop_drake.inputs.model import digest
from massprop_drake.results.folder import require_writable
from massprop_drake.results.summary import by_name, from_names

FILES = ALL_FILES - {"figures"}
FIGURES = {
    "attitude_error",
    "clusters",
    "innovations",
    "mass_innovations",
    "phase_plane",
    "propellant",
    "center_of_mass",
    "consistency",
    "detection_timeline",
    "failure_magnitude",
    "forces",
    "inverse_inertia_diagonal",
    "inverse_inertia_products",
    "jets",
    "likelihoods",
    "margins",
    "mass_reciprocal",
    "rates",
    "torques",
    "velocities",
}


@pytest.fixture(scope="session")
def folder(short_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short run's folder, without figures."""
    return short_run.save(tmp_path_factory.mktemp("runs") / "short", pictures=False)


def _without_timing(summary: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in summary.items() if key != "timing"}


def _assert_same(one: Run, other: Run) -> None:
    """Bit for bit, but for the time it took."""
    assert _without_timing(one.summary) == _without_timing(other.summary)
    assert set(one.signals) == set(other.signals)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(one.covariance, other.covariance)


# ------------------------------------------------------------------------------------------ summary

NUMBER = (int, float)
MAYBE = (int, float, type(None))
# shapes as they are promised: a type, or a list with its length and what is in it
MATRIX, VECTOR = (3, (3, NUMBER)), (3, NUMBER)
PROPERTIES = {"inverse_inertia": MATRIX, "center_of_mass": VECTOR, "mass_reciprocal": NUMBER}
PERCENT = {"inverse_inertia": (3, (3, MAYBE)), "center_of_mass": (3, MAYBE), "mass_reciprocal": MAYBE}
SUMMARY: dict[str, Any] = {
    "format": int,
    "version": str,
    "scenario": str,
    "vehicle": str,
    "units": str,
    "seed": int,
    "duration_s": float,
    "completeness": str,
    "completeness_detail": list,
    "estimates": PROPERTIES,
    "standard_deviations": PROPERTIES,
    "covariance": (10, (10, NUMBER)),
    "derived": {
        "mass": MAYBE,
        "mass_std": MAYBE,
        "inertia": MATRIX,
        "inertia_std": MATRIX,
        "physically_possible": bool,
        "nearest_possible": (dict, type(None)),
    },
    "truth": PROPERTIES,
    "percent_error": PERCENT,
    "detections": list,
    "events": list,
    "unconfirmed": list,
    "untested": list,
    "fault_probability": type(None),  # the thesis's detector gives none
    "consistency": {
        "rotation_nis_mean": MAYBE,
        "translation_nis_mean": MAYBE,
        "samples": int,
        "verdict": str,
        "reasons": list,
        "rotation_nis_beyond": MAYBE,
        "translation_nis_beyond": MAYBE,
        "diagnoses": list,
        "rotation_nis_within": MAYBE,
        "translation_nis_within": MAYBE,
    },
    "identifiability": (
        10,
        {
            "parameter": str,
            "flag": str,
            "reason": str,
            "share": MAYBE,
            "jet": (str, type(None)),
            "left": MAYBE,
            "bound": MAYBE,
        },
    ),
    "injected": list,
    "autopilot": {
        "firings": int,
        "propellant_mass": float,
        "lp_solves": int,
        "lp_infeasible": int,
        "jets_out_of_use": list,
        "jets_left_in": list,
        "control_authority": {"before": dict, "after": dict},
    },
    "provenance": {"drake": str, "numpy": str, "vehicle_sha256": str, "scenario_sha256": str, "engine": str},
    "timing": {
        "wall_s": float,
        "real_time_factor": float,
        "cycle_us": {"estimators": float, "detector": MAYBE, "jet_selection": MAYBE},
    },
}


def _assert_shape(value: Any, shape: Any, where: str) -> None:
    if isinstance(shape, dict):
        assert isinstance(value, dict), where
        assert list(value) == list(shape), where
        for key, inner in shape.items():
            _assert_shape(value[key], inner, f"{where}.{key}")
    elif isinstance(shape, tuple) and isinstance(shape[0], int):
        assert isinstance(value, list), where
        assert len(value) == shape[0], where
        for index, item in enumerate(value):
            _assert_shape(item, shape[1], f"{where}[{index}]")
    else:
        assert isinstance(value, shape), f"{where}: {value!r}"


def test_the_summary_has_the_promised_keys_and_shapes(sample_run: Run, folder: Path) -> None:
    _assert_shape(sample_run.summary, SUMMARY, "summary")
    _assert_shape(json.loads((folder / "summary.json").read_text(encoding="utf-8")), SUMMARY, "summary.json")
    assert sample_run.summary["format"] == 1


def test_the_summary_of_an_open_loop_has_no_jet_selection() -> None:
    summary = simulate(load_scenario("jet_pulses", ["duration_s=2"])).summary
    assert list(summary) == list(SUMMARY)
    assert summary["autopilot"] == {
        "firings": 1,  # L4L at 1 s
        "propellant_mass": summary["autopilot"]["propellant_mass"],
        "lp_solves": None,
        "lp_infeasible": None,
        "jets_out_of_use": None,
        "jets_left_in": None,
        "control_authority": None,
    }
    assert summary["timing"]["cycle_us"]["jet_selection"] is None


def test_the_summary_says_what_the_signals_say(sample_run: Run) -> None:
    summary = sample_run.summary
    np.testing.assert_array_equal(from_names(summary["estimates"]), sample_run["estimate"][-1])
    np.testing.assert_array_equal(from_names(summary["standard_deviations"]), sample_run["standard_deviation"][-1])
    truth = from_names(summary["truth"])
    np.testing.assert_array_equal(truth, sample_run["truth"][-1])
    np.testing.assert_allclose(
        from_names(summary["percent_error"]),
        100.0 * (sample_run["estimate"][-1] - truth) / np.abs(truth),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        np.sqrt(np.diag(summary["covariance"])), sample_run["standard_deviation"][-1], rtol=1e-14
    )
    assert (summary["scenario"], summary["vehicle"], summary["units"]) == ("sample_maneuver", "orbiter", "us")
    assert (summary["seed"], summary["duration_s"], summary["detections"]) == (0, 50.0, [])
    used = sample_run["rotation_used"][:, 0] != 0.0
    assert summary["consistency"]["samples"] == used.sum()
    np.testing.assert_allclose(
        summary["consistency"]["rotation_nis_mean"], sample_run["rotation_nis"][used].mean(), rtol=1e-14
    )


def test_the_matrices_of_the_summary_are_symmetric_and_in_their_order(sample_run: Run) -> None:
    parameters = sample_run["truth"][-1]
    matrix = np.array(sample_run.summary["truth"]["inverse_inertia"])
    np.testing.assert_array_equal(matrix, matrix.T)
    inertia = sample_run.scenario.vehicle_data.nominal.inertia
    np.testing.assert_allclose(matrix @ inertia, np.eye(3), atol=1e-12)
    # Ixx, Iyy, Izz, Iyz, Ixz, Ixy
    np.testing.assert_array_equal(parameters[3:6], [matrix[1, 2], matrix[0, 2], matrix[0, 1]])


def test_missing_numbers_are_null_and_back() -> None:
    parameters = np.array([1.0, 2.0, 3.0, np.nan, 5.0, 6.0, 7.0, 8.0, np.nan, 10.0])
    named = by_name(parameters)
    assert named == {
        "inverse_inertia": [[1.0, 6.0, 5.0], [6.0, 2.0, None], [5.0, None, 3.0]],
        "center_of_mass": [7.0, 8.0, None],
        "mass_reciprocal": 10.0,
    }
    np.testing.assert_array_equal(from_names(named), parameters)


def test_firings_and_propellant_are_those_of_the_commands(sample_run: Run) -> None:
    command = sample_run["command"][:-1]
    vehicle = sample_run.scenario.vehicle_data
    before = np.vstack([np.zeros(44), command[:-1]])
    assert sample_run.summary["autopilot"]["firings"] == ((command > 0.0) & (before == 0.0)).sum()
    # thrust is instantaneous here, so flow x time; the mass is a difference of 5900, 1e-12 of it
    np.testing.assert_allclose(
        sample_run.summary["autopilot"]["propellant_mass"],
        (command @ vehicle.mass_flows).sum() * vehicle.sample_period_s,
        atol=1e-8,
    )
    assert sample_run.summary["autopilot"]["lp_solves"] == sample_run["selection_counts"][-1, 0]


def test_the_provenance_is_that_of_the_content(sample_run: Run) -> None:
    provenance = sample_run.summary["provenance"]
    assert provenance["scenario_sha256"] == digest(sample_run.scenario)
    assert provenance["vehicle_sha256"] == digest(sample_run.scenario.vehicle_data)
    assert provenance["numpy"] == np.__version__
    other = load_scenario("sample_maneuver", ["mass.process_noise_std=1e-9"])
    assert digest(other) != provenance["scenario_sha256"]
    assert digest(other.vehicle_data) == provenance["vehicle_sha256"]


# ------------------------------------------------------------------------------------------ signals


def test_every_signal_is_described(sample_run: Run) -> None:
    assert set(sample_run.units) == set(sample_run.components) == set(sample_run.signals)
    for name, values in sample_run.signals.items():
        assert values.shape == (626, len(sample_run.components[name])), name
        assert values.dtype == np.float64, name
        assert "{" not in sample_run.units[name], name
    assert sample_run.units["gyro"] == "rad/s"
    assert sample_run.units["acc2"] == "ft/s"
    assert sample_run.units["thrust"] == "lbf"
    assert sample_run.components["command"] == sample_run.scenario.vehicle_data.designations


def test_samples_lie_at_the_multiples_of_the_period(sample_run: Run) -> None:
    np.testing.assert_array_equal(sample_run.time_s, 0.08 * np.arange(626))


def test_the_sample_at_the_end_is_used_like_any_other() -> None:
    """Estimates do not change when the run goes on: the last row is final."""
    for duration_s in (6.0, 6.4, 6.48):
        one = simulate(load_scenario("sample_maneuver", [f"duration_s={duration_s}"]))
        longer = simulate(load_scenario("sample_maneuver", ["duration_s=7"]))
        last = one.time_s.size
        np.testing.assert_array_equal(one["estimate"], longer["estimate"][:last])
        np.testing.assert_array_equal(one["rate"], longer["rate"][:last])


# -------------------------------------------------------------------------------------------- files


def test_the_folder_holds_the_promised_files(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    assert [path for path in folder.parent.iterdir() if path.name != "short"] == []  # nothing else beside it


def test_a_saved_run_reads_back_bit_for_bit(short_run: Run, folder: Path) -> None:
    again = Run.load(folder)
    assert again.scenario == short_run.scenario
    assert again.summary == short_run.summary
    _assert_same(again, short_run)
    assert again.units == short_run.units
    assert again.components == short_run.components


def test_the_saved_scenario_is_the_one_that_was_run(short_run: Run, folder: Path) -> None:
    assert load_scenario(folder) == short_run.scenario
    assert load_scenario(folder / "scenario.yaml") == short_run.scenario
    _assert_same(simulate(load_scenario(folder)), short_run)


def test_telemetry_has_the_promised_columns_and_its_numbers_read_back_exactly(short_run: Run, folder: Path) -> None:
    with (folder / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        heading, *rows = list(csv.reader(file))
    sensors = [f"{name}_{axis}" for name in ("gyro", "acc1", "acc2", "acc3") for axis in "xyz"]
    jets = [f"jet_{designation}" for designation in short_run.scenario.vehicle_data.designations]
    assert heading == ["time_s", *sensors, *jets]
    assert len(rows) == short_run.time_s.size
    assert all(len(row) == len(heading) for row in rows)
    numbers = np.array([[float(cell) for cell in row[:13]] for row in rows])
    np.testing.assert_array_equal(numbers[:, 0], short_run.time_s)
    for index, name in enumerate(("gyro", "acc1", "acc2", "acc3")):
        np.testing.assert_array_equal(numbers[:, 1 + 3 * index : 4 + 3 * index], short_run[name])
    commands = np.array([[float(cell) for cell in row[13:]] for row in rows[:-1]])
    np.testing.assert_array_equal(commands, short_run["command"][:-1])
    assert commands.any()
    assert rows[-1][13:] == [""] * 44  # nothing is commanded beyond the end
    assert "" not in rows[-1][:13]  # its sensors are part of the run


def test_missing_readings_are_empty_cells(short_run: Run, tmp_path: Path) -> None:
    signals = dict(short_run.signals)
    signals["gyro"] = signals["gyro"].copy()
    signals["gyro"][2, 1] = np.nan
    run = Run(short_run.scenario, short_run.results, short_run.time_s, signals)
    run.save(tmp_path / "run", pictures=False, report=False)
    with (tmp_path / "run" / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[2]["gyro_y"] == ""
    assert rows[2]["gyro_x"] != ""


def test_the_history_describes_itself(short_run: Run, folder: Path) -> None:
    with np.load(folder / "history.npz", allow_pickle=False) as stored:
        names = set(stored.files)
        description = json.loads(str(stored["_description"]))
        assert names == {"time_s", "_description", *short_run.signals}
        assert set(description) == set(short_run.signals)
        for name, about in description.items():
            assert set(about) == {"unit", "components"}
            assert stored[name].shape == (short_run.time_s.size, len(about["components"]))
            assert about["unit"] == short_run.units[name]


def test_the_filter_state_is_that_of_the_end(short_run: Run, folder: Path) -> None:
    state = json.loads((folder / "filter_state.json").read_text(encoding="utf-8"))
    assert state["time_s"] == 6.96  # the last multiple of 0.08 s before 7 s
    np.testing.assert_array_equal(state["estimate"], short_run["estimate"][-1])
    np.testing.assert_array_equal(state["covariance"], short_run.covariance)


def test_every_figure_is_drawn_without_complaint(short_run: Run, tmp_path: Path) -> None:
    # with the windows of the whole maneuver, of which this run sees two
    short_run.save(tmp_path / "run")
    figures = list((tmp_path / "run" / "figures").iterdir())
    assert {path.stem for path in figures} == FIGURES
    for path in figures:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG\r\n\x1a\n"), path.name
        assert content.endswith(b"IEND\xaeB`\x82"), path.name


# -------------------------------------------------------------------------- whole or not at all


class _BrokenError(Exception):
    """What a bug in the middle of saving would raise."""


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


BROKEN = {
    "telemetry.csv": "results.run.Run._write_telemetry",
    "history.npz": "results.run.Run._write_history",
    "filter_state.json": "results.run.Run._filter_state",
    "scenario.yaml": "results.run.yaml_text",
    "figures": "display.figures.Plots.save",
    "replay.html": "display.flight3d.replay_html",
    "report.html": "display.page.report_html",
}


def _broken(monkeypatch: pytest.MonkeyPatch, name: str, error: BaseException, times: int = 1000) -> None:
    """Lets the making of a file fail, after it has begun to write."""
    path = f"massprop_drake.{BROKEN[name]}"
    real, calls = pkgutil.resolve_name(path), itertools.count()

    def fail(*arguments: Any, **options: Any) -> object:
        if next(calls) >= times:
            return real(*arguments, **options)
        if name != "figures" and isinstance(arguments[-1], Path):
            arguments[-1].write_text("begun", encoding="utf-8")
        raise error

    monkeypatch.setattr(path, fail)


@pytest.mark.parametrize("name", BROKEN)
def test_a_part_that_fails_takes_no_other_with_it(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    _broken(monkeypatch, name, _BrokenError("no way"))
    with pytest.raises(_BrokenError):
        short_run.save(tmp_path / "run", replay=True)
    left = {path.name for path in (tmp_path / "run").iterdir()}
    assert left == {*BROKEN, "summary.json", "manifest.json"} - {name}
    content = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert content["missing"] == [f"{name}: _BrokenError: no way"]
    assert "ended" not in content
    assert require_writable(tmp_path / "run").found  # it is ours, whole
    if name in ("telemetry.csv", "filter_state.json", "figures", "replay.html", "report.html"):
        loaded = Run.load(tmp_path / "run")
        np.testing.assert_array_equal(loaded["estimate"], short_run["estimate"])
        assert loaded.results.missing == tuple(content["missing"])


def test_a_figure_that_fails_takes_no_other_with_it(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise _BrokenError("no way")

    broken = pkgutil.resolve_name("matplotlib.figure.Figure")()
    broken.savefig = fail
    monkeypatch.setattr(
        figures.Plots, "all", lambda plots: {"rates": plots.rates(), "margins": broken, "jets": plots.jets()}
    )
    with pytest.raises(_BrokenError):
        short_run.save(tmp_path / "run", report=False)
    assert {path.name for path in (tmp_path / "run" / "figures").iterdir()} == {"rates.png", "jets.png"}
    assert Run.load(tmp_path / "run").results.missing == ("figures: _BrokenError: no way",)


@pytest.mark.parametrize("name", ["figures", "replay.html", "report.html", "history.npz"])
def test_an_interrupted_run_is_saved_without_pages(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    _broken(monkeypatch, name, KeyboardInterrupt(), times=1)
    with pytest.raises(KeyboardInterrupt):
        short_run.save(tmp_path / "run", replay=True)
    assert {path.name for path in tmp_path.iterdir()} == {"run"}
    loaded = Run.load(tmp_path / "run")
    np.testing.assert_array_equal(loaded["estimate"], short_run["estimate"])
    assert loaded.results.missing == ("figures and pages: interrupted",)
    assert not (tmp_path / "run" / "report.html").exists()


@pytest.mark.parametrize(
    ("place", "kept"),
    [
        (("events", 0, "statistic"), 1),  # may be unknown
        (("events", 0, "onset_s"), 0),  # may not
        (("detections", 0, "time_s"), 0),
        (("injected", 0, "start_s"), 0),
    ],
)
def test_a_number_that_is_not_finite_is_noted(
    stuck_run: Run, tmp_path: Path, place: tuple[str, int, str], kept: int
) -> None:
    name, index, field = place
    records = list(getattr(stuck_run.results, name))
    records[index] = records[index]._replace(**{field: math.nan})
    results = replace(stuck_run.results, **{name: tuple(records)})
    run = Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals, stuck_run.state)
    with pytest.raises(ArithmeticError, match="is no finite number"):
        run.save(tmp_path / "run", pictures=False, report=False)
    loaded = Run.load(tmp_path / "run").results
    assert loaded.missing == (f"{name}[{index}].{field}: ArithmeticError: is no finite number",)
    assert len(getattr(loaded, name)) == len(records) - 1 + kept


def test_a_full_disk_is_told_and_leaves_nothing(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Run, "_write_history", fail)
    with pytest.raises(InputError, match=r"run: cannot be written: No space left on device"):
        short_run.save(tmp_path / "run", pictures=False, report=False)
    assert list(tmp_path.iterdir()) == []


def test_a_failure_leaves_the_earlier_run_as_it_was(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = short_run.save(tmp_path / "run", pictures=False, report=False)
    before = _contents(target)

    def fail(*_: object) -> None:
        raise _BrokenError

    monkeypatch.setattr(Run, "_write_history", fail)
    with pytest.raises(_BrokenError):
        short_run.save(target, pictures=False, report=False)
    assert _contents(tmp_path / "run.1") == before
    assert {path.name for path in tmp_path.iterdir()} == {"run", "run.1"}


def test_an_earlier_run_is_replaced_altogether(short_run: Run, tmp_path: Path) -> None:
    target = short_run.save(tmp_path / "run", pictures=False)
    short_run.save(target, pictures=False, report=False)
    assert {path.name for path in target.iterdir()} == FILES - {"report.html"}
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_empty_folder_is_taken(short_run: Run, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    short_run.save(tmp_path / "run", pictures=False, report=False)
    assert {path.name for path in (tmp_path / "run").iterdir()} == FILES - {"report.html"}


def test_missing_parents_are_made(short_run: Run, tmp_path: Path) -> None:
    short_run.save(tmp_path / "a" / "b" / "run", pictures=False, report=False)
    assert {path.name for path in (tmp_path / "a" / "b" / "run").iterdir()} == FILES - {"report.html"}


def test_files_of_others_are_kept(short_run: Run, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work", encoding="utf-8")
    with pytest.raises(InputError, match=r"not of an earlier run.*: thesis.txt; give another folder, or --force"):
        short_run.save(tmp_path / "mine", pictures=False, report=False)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]
    short_run.save(tmp_path / "mine", force=True, pictures=False, report=False)
    assert {path.name for path in (tmp_path / "mine").iterdir()} == FILES - {"report.html"}
    assert (tmp_path / "mine.1" / "thesis.txt").read_text(encoding="utf-8") == "years of work"
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "mine.1"}


def test_a_file_is_no_folder(short_run: Run, tmp_path: Path) -> None:
    (tmp_path / "run").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match="run: is a file; give a folder to write to"):
        short_run.save(tmp_path / "run", force=True, pictures=False, report=False)
    with pytest.raises(InputError, match=r"below: cannot be written: .*; give a folder you may write to"):
        short_run.save(tmp_path / "run" / "below", pictures=False, report=False)
    assert (tmp_path / "run").read_text(encoding="utf-8") == "x"


def test_files_have_the_permissions_of_other_files(short_run: Run, tmp_path: Path) -> None:
    # temporary folders are private to their owner: a run is not
    (tmp_path / "plain").mkdir()
    target = short_run.save(tmp_path / "run", pictures=False, report=False)
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode


# ---------------------------------------------------------------------------------- loading


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: there is no such run"):
        Run.load(tmp_path / "nowhere")
    with pytest.raises(InputError, match="holds no run that can be read"):
        Run.load(tmp_path)


@pytest.mark.parametrize("name", ["summary.json", "history.npz", "scenario.yaml"])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_damaged_run_is_refused(short_run: Run, tmp_path: Path, name: str, share: float) -> None:
    target = short_run.save(tmp_path / "run", pictures=False, report=False)
    content = (target / name).read_bytes()
    (target / name).write_bytes(content[: int(share * len(content))])
    raised: type[Exception] | None = None
    try:
        Run.load(target)
    except Exception as error:
        raised = type(error)
    gc.collect()  # a file left open is noticed here, and not in some later test
    assert raised is InputError


# ------------------------------------------------------------------------------------ repeatability


def test_the_same_seed_gives_the_same_run_bit_for_bit(noisy_run: Run) -> None:
    _assert_same(simulate(noisy_run.scenario), noisy_run)


def test_seeds_differ(noisy_run: Run) -> None:
    other = simulate(noisy_run.scenario.model_copy(update={"seed": 8}))
    assert not np.array_equal(other["gyro"], noisy_run["gyro"])
    assert not np.array_equal(other["acc1"], noisy_run["acc1"])  # quantized only: the phase is drawn, too
    assert other.summary["estimates"] != noisy_run.summary["estimates"]


def test_without_anything_drawn_the_seed_does_not_matter() -> None:
    overrides = ["duration_s=4", "sensors.quantizer_phase=equal"]
    one = simulate(load_scenario("sample_maneuver", [*overrides, "seed=1"]))
    two = simulate(load_scenario("sample_maneuver", [*overrides, "seed=2"]))
    for name in one.signals:
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)


def test_progress_is_reported_up_to_the_end() -> None:
    reached: list[float] = []
    run = simulate(load_scenario("sample_maneuver", ["duration_s=12"]), progress=reached.append)
    assert reached == sorted(reached)
    assert reached[-1] == run.time_s[-1]
    assert len(reached) > 1


def test_progress_does_not_change_the_run(short_run: Run) -> None:
    _assert_same(simulate(short_run.scenario, progress=lambda _: None), short_run)


def test_timing_is_measured(sample_run: Run) -> None:
    timing = sample_run.summary["timing"]
    assert timing["wall_s"] > 0.0
    assert math.isclose(timing["real_time_factor"], 50.0 / timing["wall_s"])
    assert timing["cycle_us"]["estimators"] > 0.0
    assert timing["cycle_us"]["jet_selection"] > 0.0
