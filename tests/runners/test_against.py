"""A record beside a simulation of its commands: what differs, and what is said to explain it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Run, estimate, load_scenario, simulate
from massprop_drake.display import motion_plots, plots
from massprop_drake.display.page import report_html
from massprop_drake.errors import InputError
from massprop_drake.maths.estimation.offline.flight_model import columns
from massprop_drake.results import table
from massprop_drake.results.against import Against, name_unknowns
from massprop_drake.results.regression_model import make_model
from massprop_drake.results.summary import Summary
from massprop_drake.runners.simulation_comparison import compare_with_simulation

FLIGHT = [
    "duration_s=30",
    "detector.kind=off",
    "execution.engine=loop",
    "estimation={filter: thesis, start: nominal, std_fraction: 0.001, thrust_transient: gate}",
]
INERTIA = [[883308.0, -8120.0, -247270.0], [-8120.0, 6748840.0, -418.0], [-247270.0, -418.0, 7058020.0]]


def flown(folder: Path, name: str, *overrides: str) -> Path:
    run = simulate(load_scenario("sample_maneuver", [*FLIGHT, *overrides]), look_back=False)
    return run.save(folder / name, pictures=False, report=False)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of the vehicle as it is known, with its center of mass elsewhere, and with a weak jet."""
    folder = tmp_path_factory.mktemp("runs")
    flown(folder, "known")
    flown(folder, "weak", "failures=[{kind: degraded, jet: L4D, start_s: 0, fraction: 0.6}]")
    moved = {"mass": 5910.0, "center_of_mass": [32.5, 0.06667, 2.13334], "inertia": INERTIA}
    flown(folder, "moved", f"plant.mass_properties={json.dumps(moved)}")
    return folder


def said(run: Run) -> Against:
    """What the run says of the record beside the simulation."""
    assert run.results.against is not None
    return run.results.against


def put_beside(runs: Path, record: str, against: str = "known") -> Run:
    """A record estimated with the settings of a run, beside its simulation."""
    scenario = load_scenario(runs / against)
    return compare_with_simulation(estimate(runs / record / "telemetry.csv", scenario), runs / against)


@pytest.fixture(scope="module")
def weak(runs: Path) -> Run:
    """The record of a weak jet beside the vehicle as it is known."""
    return put_beside(runs, "weak")


def test_a_run_s_own_record_is_as_simulated(runs: Path) -> None:
    run = put_beside(runs, "known")
    found = said(run)
    assert found.causes == ()
    assert 0.3 < (found.misfit or 0.0) < 1.3
    assert "are as simulated" in found.in_words()
    # the reading that it begins with is rounded, which is all that is left
    quantum = load_scenario(runs / "known").vehicle_data.gyro("gyro").quantum
    assert np.abs(run["against.gyro"] - run["gyro"]).max() < 4.0 * quantum
    assert [one.signal for one in found.residuals[:3]] == ["gyro_x", "gyro_y", "gyro_z"]


def test_a_weak_jet_explains_all_of_it(weak: Run) -> None:
    run, found = weak, said(weak)
    (cause,) = found.causes
    assert cause.what == "thrust of L4D"
    assert cause.size == pytest.approx(-40.0, abs=5.0 * cause.size_std)
    assert cause.size_std < 0.1
    assert cause.together > 0.999
    left = run["gyro"] - run["against.gyro"]
    np.testing.assert_allclose([one.rms for one in found.residuals[:3]], np.sqrt((left**2).mean(axis=0)), rtol=1e-9)
    worst = found.residuals[1]
    assert worst.largest == left[np.abs(left[:, 1]).argmax(), 1]
    assert worst.largest_s == run.time_s[np.abs(left[:, 1]).argmax()]


def test_a_center_of_mass_elsewhere_is_found_with_what_goes_along(runs: Path) -> None:
    found = said(put_beside(runs, "moved"))
    first = found.causes[0]
    truth = load_scenario(runs / "known").vehicle_data.nominal.center_of_mass
    assert first.what == "x_cm"
    assert first.size == pytest.approx(32.5 - truth[0], abs=0.01)
    assert [one.together for one in found.causes] == sorted(one.together for one in found.causes)


def test_after_a_gap_it_begins_with_the_record_s_rate(runs: Path, tmp_path: Path) -> None:
    rows = (runs / "weak" / "telemetry.csv").read_text("utf-8").splitlines()
    (tmp_path / "gap.csv").write_text("\n".join([*rows[:150], *rows[190:]]) + "\n", encoding="utf-8")
    run = compare_with_simulation(estimate(tmp_path / "gap.csv", load_scenario(runs / "known")), runs / "known")
    gap = int(np.flatnonzero(run["gap"][:, 0])[0])
    assert np.isnan(run["against.gyro"][gap + 1 :]).sum() == 0
    np.testing.assert_array_equal(run["against.gyro"][gap + 1], run["gyro"][gap + 1])
    np.testing.assert_allclose(run["against.acc2"][gap + 1], run["acc2"][gap + 1])


def test_it_is_kept_shown_and_read_back(weak: Run, tmp_path: Path) -> None:
    run = weak
    run.save(tmp_path / "kept", pictures=False, report=False)
    again = Run.load(tmp_path / "kept")
    assert again.results.against == run.results.against
    assert Summary.from_json(run.results.as_json()).against == run.results.against
    assert again.units["against.gyro"] == "rad/s"
    assert {"against_rates", "against_velocities"} <= set(plots.available_plots(plots.source(again)))
    read, simulated = motion_plots.against_rates(plots.source(again)).panels[2].marks
    np.testing.assert_allclose(simulated.y, np.degrees(run["against.gyro"][:, 1]))  # type: ignore[union-attr]
    assert read.label == "gyro, as read"  # type: ignore[union-attr]
    html = report_html(again)
    (cells,) = table.cause_sheet(said(run)).rows
    for cell in cells:
        assert cell in html


def test_another_vehicle_is_refused(runs: Path, tmp_path: Path) -> None:
    simulate(load_scenario("free_flyer_maneuver", ["duration_s=1"])).save(
        tmp_path / "other", pictures=False, report=False
    )
    record = estimate(runs / "known" / "telemetry.csv", load_scenario(runs / "known"))
    other = load_scenario(tmp_path / "other").vehicle_data.name
    with pytest.raises(InputError, match=f"is of vehicle '{other}', whose .* are not those of 'orbiter'"):
        compare_with_simulation(record, tmp_path / "other")


@pytest.mark.parametrize(
    ("scenario", "group", "names", "units"),
    [
        ("servicer_on_wheels_leak", "wheel", ["inertia of wheel RW1", "inertia of wheel RW2"], ["%", "%"]),
        ("servicer_on_wheels_leak", "fill", ["propellant in hydrazine at the start"], ["kg"]),
        ("servicer_on_wheels_leak", "flow", ["flow out of hydrazine"], ["%"]),
        (
            "lander_burn",
            "engine",
            [
                "thrust of engine descent at level 0",
                "thrust of engine descent at level 1",
                "direction of engine descent",
            ],
            ["%", "%", "rad", "rad", "m", "m"],
        ),
        ("servicer_slosh_stated", "moving", ["participation of tank", "frequency of tank"], ["%", "%", "%", "m"]),
        ("servicer_panel_stated", "moving", ["participation of left"], ["%", "%", "%", "m"]),
        ("servicer_panel_stated", "accelerometer_gain", ["scale of acc x"], ["%"]),
    ],
)
def test_every_unknown_has_its_own_name(scenario: str, group: str, names: list[str], units: list[str]) -> None:
    case = load_scenario(scenario)
    model = make_model(case)
    labels = name_unknowns(case, model, model.prior)
    assert len(labels) == model.prior.size
    own = [label for label in labels[getattr(columns(model), group)] if label is not None]
    assert [label.unit for label in own][: len(units)] == units
    assert all(label.what.startswith(name) for label, name in zip(own, names, strict=False))
    assert labels[columns(model).shift.start - 1] is not None
    assert labels[columns(model).shift] == [None] * 9


def test_mounting_is_named_by_jet_with_the_size_of_a_sigma() -> None:
    case = load_scenario("small_satellite_leak")
    kinds = {
        name: kind.model_copy(update={"direction_std": 0.02}) for name, kind in case.vehicle_data.jet_kinds.items()
    }
    vehicle = case.vehicle_data.model_copy(update={"jet_kinds": kinds})
    case = case.model_copy(update={"vehicle": vehicle})
    model = make_model(case)
    first = name_unknowns(case, model, model.prior)[columns(model).mount][0]
    assert first is not None
    assert first == (f"direction of {vehicle.designations[0]}, first axis", "rad", 0.02)


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of a vehicle that wheels turn, with inertias as stated and otherwise."""
    folder = tmp_path_factory.mktemp("turned")
    for name, dispersion in (("stated", 0.0), ("other", 0.1)):
        settings = ["duration_s=10", "failures=[]", "detector.kind=off", f"plant.wheel_dispersion={dispersion}"]
        run = simulate(load_scenario("cubesat_leak", settings), look_back=False)
        run.save(folder / name, pictures=False, report=False)
    return folder


def test_wheels_turn_in_the_simulation_as_the_record_reads_them(turned: Path) -> None:
    found = said(put_beside(turned, "other", "other"))
    assert found.causes == ()
    assert all((one.rms or 0.0) < 2.0 * one.noise for one in found.residuals)


def test_a_difference_below_a_reading_s_noise_is_explained_by_what_it_is(turned: Path) -> None:
    found = said(put_beside(turned, "other", "stated"))
    assert found.causes[0].what.startswith("inertia of wheel")
    assert "are not as simulated" in found.in_words()


def test_engines_burn_in_the_simulation_as_the_record_reads_them(tmp_path: Path) -> None:
    burn = "engine_schedule=[{engine: descent, start_s: 1, end_s: 8, level: 0.4}]"
    settings = ["duration_s=8", "failures=[]", "detector.kind=off", burn]
    simulate(load_scenario("lander_burn", settings), look_back=False).save(
        tmp_path / "own", pictures=False, report=False
    )
    run = put_beside(tmp_path, "own", "own")
    assert said(run).causes == ()
    gained = np.ptp(run["acc"], axis=0).max()
    assert np.abs(run["acc"] - run["against.acc"]).max() < 0.01 * gained


def test_the_sentence_says_of_which_readings_it_is_and_what_came_then() -> None:
    declared = Against("runs/one", 3.0, 0.92, (), (), "jet XP1: stuck on").in_words()
    assert declared.startswith("readings before 3.00 s are as simulated: 0.92 times")
    assert declared.endswith("; then declared: jet XP1: stuck on")
    assert Against("runs/one", None, 5.0, (), ()).in_words().startswith("readings are not as simulated: 5 times")
