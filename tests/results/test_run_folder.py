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
from conftest import SENSOR_ERRORS

from massprop_drake import InputError, Run, load_scenario, simulate
from massprop_drake.display import figures
from massprop_drake.display.page import summary_html
from massprop_drake.inputs.model import digest
from massprop_drake.results.folder import require_writable
from massprop_drake.results.json_arrays import parameters_from_names

FILES = ALL_FILES - {"figures"}
LEAN = {"pictures": False, "report": False}


@pytest.fixture(scope="session")
def folder(short_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short run's folder, without figures."""
    return short_run.save(tmp_path_factory.mktemp("runs") / "short", pictures=False)


def _assert_same(one: Run, other: Run) -> None:
    """Bit for bit, but for the time it took."""
    assert {**one.summary, "timing": None} == {**other.summary, "timing": None}
    assert set(one.signals) == set(other.signals)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(one.covariance, other.covariance)


NUMBER = (int, float)
MAYBE = (int, float, type(None))
# shapes as they are promised: a type, or a list with its length and what is in it
MATRIX, VECTOR = (3, (3, NUMBER)), (3, NUMBER)
PROPERTIES = {"inverse_inertia": MATRIX, "center_of_mass": VECTOR, "mass_reciprocal": NUMBER}
PERCENT = {"inverse_inertia": (3, (3, MAYBE)), "center_of_mass": (3, MAYBE), "mass_reciprocal": MAYBE}
NIS = dict.fromkeys(("rotation_nis_mean", "translation_nis_mean"), MAYBE)
DERIVED = {"mass": MAYBE, "mass_std": MAYBE, "inertia": MATRIX, "inertia_std": MATRIX, "physically_possible": bool}
BEYOND = dict.fromkeys(("rotation_nis_beyond", "translation_nis_beyond"), MAYBE)
WITHIN = dict.fromkeys(("rotation_nis_within", "translation_nis_within"), MAYBE)
FLAGGED = {"parameter": str, "flag": str, "reason": str, "share": MAYBE, "jet": (str, type(None)), "left": MAYBE}
SUMMARY: dict[str, Any] = {
    **{"format": int, "version": str, "scenario": str, "vehicle": str, "units": str, "seed": int, "duration_s": float},
    **{"completeness": str, "completeness_detail": list, "estimates": PROPERTIES, "standard_deviations": PROPERTIES},
    "covariance": (10, (10, NUMBER)),
    "derived": {**DERIVED, "nearest_possible": (dict, type(None))},
    **{"truth": PROPERTIES, "percent_error": PERCENT},
    **{"detections": list, "events": list, "unconfirmed": list, "untested": list},
    "fault_probability": type(None),  # the thesis's detector gives none
    "consistency": {**NIS, "samples": int, "verdict": str, "reasons": list, **BEYOND, "diagnoses": list, **WITHIN},
    "identifiability": (10, {**FLAGGED, "bound": MAYBE}),
    "injected": list,
    "autopilot": {
        **{"firings": int, "propellant_mass": float, "lp_solves": int, "lp_infeasible": int},
        **{"jets_out_of_use": list, "jets_left_in": list, "control_authority": {"before": dict, "after": dict}},
    },
    "provenance": {"drake": str, "numpy": str, "vehicle_sha256": str, "scenario_sha256": str, "engine": str},
    "timing": {
        **{"wall_s": float, "real_time_factor": float},
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


def test_the_summary_has_the_promised_keys_and_shapes(short_run: Run, folder: Path) -> None:
    _assert_shape(short_run.summary, SUMMARY, "summary")
    _assert_shape(json.loads((folder / "summary.json").read_text(encoding="utf-8")), SUMMARY, "summary.json")
    assert short_run.summary["format"] == 1
    open_loop = simulate(load_scenario("jet_pulses", ["duration_s=2"])).summary
    assert list(open_loop) == list(SUMMARY)
    assert list(open_loop["autopilot"]) == list(SUMMARY["autopilot"])
    assert open_loop["autopilot"].pop("firings") == 1  # L4L at 1 s
    assert open_loop["autopilot"].pop("propellant_mass") > 0.0
    assert {*open_loop["autopilot"].values(), open_loop["timing"]["cycle_us"]["jet_selection"]} == {None}


def test_the_summary_says_what_the_signals_say(short_run: Run) -> None:
    run, summary, vehicle = short_run, short_run.summary, short_run.scenario.vehicle_data
    np.testing.assert_array_equal(parameters_from_names(summary["estimates"]), run["estimate"][-1])
    np.testing.assert_array_equal(parameters_from_names(summary["standard_deviations"]), run["standard_deviation"][-1])
    truth = parameters_from_names(summary["truth"])
    np.testing.assert_array_equal(truth, run["truth"][-1])
    percent = 100.0 * (run["estimate"][-1] - truth) / np.abs(truth)
    np.testing.assert_allclose(parameters_from_names(summary["percent_error"]), percent, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(summary["covariance"])), run["standard_deviation"][-1], rtol=1e-14)
    np.testing.assert_allclose(summary["truth"]["inverse_inertia"] @ vehicle.nominal.inertia, np.eye(3), atol=1e-12)
    used = run["rotation_used"][:, 0] != 0.0
    assert summary["consistency"]["samples"] == used.sum()
    assert summary["consistency"]["rotation_nis_mean"] == pytest.approx(run["rotation_nis"][used].mean(), rel=1e-14)
    command = run["command"][:-1]
    before = np.vstack([np.zeros(44), command[:-1]])
    assert summary["autopilot"]["firings"] == ((command > 0.0) & (before == 0.0)).sum()
    # thrust is instantaneous here, so flow x time; the mass is a difference of 5900, 1e-12 of it
    used_mass = (command @ vehicle.mass_flows).sum() * vehicle.sample_period_s
    assert summary["autopilot"]["propellant_mass"] == pytest.approx(used_mass, abs=1e-8)
    assert summary["autopilot"]["lp_solves"] == run["selection_counts"][-1, 0]
    assert summary["timing"]["real_time_factor"] == pytest.approx(run.time_s[-1] / summary["timing"]["wall_s"])
    assert summary["provenance"]["scenario_sha256"] == digest(run.scenario)
    assert summary["provenance"]["vehicle_sha256"] == digest(vehicle)
    other = load_scenario("sample_maneuver", ["duration_s=7", "mass.process_noise_std=1e-9"])
    assert digest(other) != digest(run.scenario)
    assert digest(other.vehicle_data) == digest(vehicle)


def test_every_signal_is_described_and_samples_lie_at_multiples_of_the_period(short_run: Run, folder: Path) -> None:
    with np.load(folder / "history.npz", allow_pickle=False) as stored:
        description, shapes = json.loads(str(stored["_description"])), {name: stored[name].shape for name in stored}
    names = set(short_run.signals)
    assert set(short_run.units) == set(short_run.components) == set(description) == names
    assert set(shapes) == {"time_s", "_description", *names}
    for name, values in short_run.signals.items():
        columns = short_run.components[name]
        assert description[name] == {"unit": short_run.units[name], "components": list(columns)}
        assert values.shape == shapes[name] == (88, len(columns)), name
        assert values.dtype == np.float64, name
        assert "{" not in short_run.units[name], name
    assert [short_run.units[name] for name in ("gyro", "acc2", "thrust")] == ["rad/s", "ft/s", "lbf"]
    assert short_run.components["command"] == short_run.scenario.vehicle_data.designations
    np.testing.assert_array_equal(short_run.time_s, 0.08 * np.arange(88))


def test_the_sample_at_the_end_is_used_like_any_other(short_run: Run) -> None:
    """Estimates do not change when the run goes on: the last row is final."""
    one = simulate(load_scenario("sample_maneuver", ["duration_s=6.4"]))
    np.testing.assert_array_equal(one["estimate"], short_run["estimate"][: one.time_s.size])
    np.testing.assert_array_equal(one["rate"], short_run["rate"][: one.time_s.size])


def test_a_saved_run_reads_back_and_runs_again_bit_for_bit(short_run: Run, folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    assert [path.name for path in folder.parent.iterdir()] == ["short"]  # nothing else beside it
    again = Run.load(folder)
    assert again.scenario == load_scenario(folder / "scenario.yaml") == short_run.scenario
    assert (again.summary, again.units, again.components) == (short_run.summary, short_run.units, short_run.components)
    _assert_same(again, short_run)
    reached: list[float] = []
    _assert_same(simulate(load_scenario(folder), progress=reached.append), short_run)
    assert reached == sorted(reached)
    assert reached[-1] == short_run.time_s[-1]
    state = json.loads((folder / "filter_state.json").read_text(encoding="utf-8"))
    assert state["time_s"] == 6.96  # the last multiple of 0.08 s before 7 s
    np.testing.assert_array_equal(state["estimate"], short_run["estimate"][-1])
    np.testing.assert_array_equal(state["covariance"], short_run.covariance)


def test_telemetry_has_the_promised_columns_and_its_numbers_read_back_exactly(short_run: Run, folder: Path) -> None:
    with (folder / "telemetry.csv").open(encoding="utf-8", newline="") as file:
        heading, *rows = list(csv.reader(file))
    packages = ("gyro", "acc1", "acc2", "acc3")
    jets = [f"jet_{designation}" for designation in short_run.scenario.vehicle_data.designations]
    assert heading == ["time_s", *(f"{name}_{axis}" for name in packages for axis in "xyz"), *jets]
    assert {len(row) for row in rows} == {len(heading)}
    numbers = np.array([[float(cell) for cell in row[:13]] for row in rows])
    logged = np.hstack([short_run.time_s[:, None], *(short_run[name] for name in packages)])
    np.testing.assert_array_equal(numbers, logged)
    commands = np.array([[float(cell) for cell in row[13:]] for row in rows[:-1]])
    np.testing.assert_array_equal(commands, short_run["command"][:-1])
    assert commands.any()
    assert rows[-1][13:] == [""] * 44  # nothing is commanded beyond the end


BROKEN = {
    "telemetry.csv": "records.rows.write_csv",
    "history.npz": "results.run_content.write_npz",
    "scenario.yaml": "display.run.yaml_text",
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
        if name != "figures" and isinstance(arguments[0], Path):
            arguments[0].write_text("begun", encoding="utf-8")
        raise error

    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    monkeypatch.setattr(path, fail)


@pytest.mark.parametrize("name", BROKEN)
def test_a_part_that_fails_takes_no_other_with_it(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    _broken(monkeypatch, name, LookupError("no way"))
    with pytest.raises(LookupError, match="no way"):
        short_run.save(tmp_path / "run", replay=True)
    left = {path.name for path in (tmp_path / "run").iterdir()}
    assert left == {*BROKEN, "filter_state.json", "summary.json", "manifest.json"} - {name}
    content = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert content["missing"] == [f"{name}: LookupError: no way"]
    assert "ended" not in content
    assert require_writable(tmp_path / "run").found  # it is ours, whole
    if name not in ("scenario.yaml", "history.npz"):
        loaded = Run.load(tmp_path / "run")
        np.testing.assert_array_equal(loaded["estimate"], short_run["estimate"])
        assert loaded.results.missing == tuple(content["missing"])


@pytest.mark.parametrize("name", ["replay.html", "history.npz"])
def test_an_interrupted_run_is_saved_without_pages(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
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
        (("events", "statistic"), 1),  # may be unknown
        (("events", "onset_s"), 0),  # may not
        (("detections", "time_s"), 0),
        (("injected", "start_s"), 0),
    ],
)
def test_a_number_that_is_not_finite_is_noted(
    stuck_run: Run, tmp_path: Path, place: tuple[str, str], kept: int
) -> None:
    name, field = place
    records = list(getattr(stuck_run.results, name))
    records[0] = records[0]._replace(**{field: math.nan})
    results = replace(stuck_run.results, **{name: tuple(records)})
    run = Run(stuck_run.scenario, results, stuck_run.time_s, stuck_run.signals, stuck_run.state)
    with pytest.raises(ArithmeticError, match="is no finite number"):
        run.save(tmp_path / "run", **LEAN)
    loaded = Run.load(tmp_path / "run").results
    assert loaded.missing == (f"{name}[0].{field}: ArithmeticError: is no finite number",)
    assert len(getattr(loaded, name)) == len(records) - 1 + kept


def test_a_full_disk_is_told_and_leaves_nothing_new(
    short_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()  # an empty folder is taken
    target = short_run.save(tmp_path / "run", **LEAN)
    before = {path: path.read_bytes() for path in target.iterdir()}
    assert {path.name for path in before} == FILES - {"report.html"}
    (tmp_path / "plain").mkdir()
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode  # temporary folders are private: a run is not
    _broken(monkeypatch, "history.npz", OSError(28, "No space left on device"))
    with pytest.raises(InputError, match=r"run: cannot be written: No space left on device"):
        short_run.save(target, **LEAN)
    assert {path: path.read_bytes() for path in target.iterdir()} == before
    assert {path.name for path in tmp_path.iterdir()} == {"run", "plain"}


def test_a_damaged_run_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no run that can be read"):
        Run.load(tmp_path)
    for name, share in itertools.product(("summary.json", "history.npz", "scenario.yaml"), (0.0, 0.5)):
        for path in folder.iterdir():
            content = path.read_bytes()
            (tmp_path / path.name).write_bytes(content[: int(share * len(content))] if path.name == name else content)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            Run.load(tmp_path)
    gc.collect()  # a file left open is noticed here, and not in some later test


def test_a_seed_gives_its_run_bit_for_bit_and_others_differ() -> None:
    noisy = ["duration_s=4", f"sensors.errors={SENSOR_ERRORS}"]
    one, again, other = (simulate(load_scenario("sample_maneuver", [*noisy, f"seed={seed}"])) for seed in (7, 7, 8))
    _assert_same(again, one)
    for name in ("gyro", "acc1"):  # acc1 is quantized only: the phase is drawn, too
        assert not np.array_equal(other[name], one[name])
    overrides = ["duration_s=4", "sensors.quantizer_phase=equal"]  # nothing is drawn
    one, two = (simulate(load_scenario("sample_maneuver", [*overrides, f"seed={seed}"])) for seed in (1, 2))
    for name in one.signals:
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)


def test_a_run_is_seen_in_notebooks_and_tables(short_run: Run) -> None:
    assert "orbiter: sample_maneuver" in summary_html(short_run)
    with pytest.raises(KeyError, match=r"no signal 'rates'; did you mean 'rate'\?"):
        short_run["rates"]
    frame, data = short_run.to_pandas(), short_run.to_xarray()
    np.testing.assert_array_equal(frame.index, short_run.time_s)
    np.testing.assert_array_equal(frame["rate"]["y"], short_run["rate"][:, 1])
    np.testing.assert_array_equal(frame["command"]["R4R"], short_run["command"][:, 28])
    assert data["force"].attrs["units"] == "lbf"
    np.testing.assert_array_equal(data["rate"].sel(rate_component="z"), short_run["rate"][:, 2])
    np.testing.assert_array_equal(data["time_s"], short_run.time_s)
