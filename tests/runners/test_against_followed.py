"""A record that is followed in a fixed frame beside a simulation of its commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Run, estimate, load_scenario, simulate
from massprop_drake.errors import InputError
from massprop_drake.results.against import Against
from massprop_drake.results.against_followed import rotation_differences
from massprop_drake.runners.simulation_comparison import compare_with_simulation

FLIGHT = ["duration_s=14", "detector.kind=off", "execution.engine=loop", "plant.thrust_dispersion=0"]
WEAK = "failures=[{kind: degraded, jet: T6, start_s: 0, fraction: 0.4}]"


def flown(folder: Path, name: str, *overrides: str) -> Path:
    run = simulate(load_scenario("air_bearing_pulses", [*FLIGHT, *overrides]), look_back=False)
    run.save(folder / name, pictures=False, report=False)
    return folder / name


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of the vehicle as it is known, and with a weak jet."""
    folder = tmp_path_factory.mktemp("runs")
    flown(folder, "known", "failures=[]")
    flown(folder, "weak", WEAK)
    return folder


@pytest.fixture(scope="module")
def records(runs: Path) -> dict[str, Run]:
    """Estimates from the telemetry of both runs; `compare_with_simulation` changes nothing in them."""
    scenario = load_scenario(runs / "known")
    return {name: estimate(runs / name / "telemetry.csv", scenario) for name in ("known", "weak")}


@pytest.fixture(scope="module")
def weak(runs: Path, records: dict[str, Run]) -> Run:
    """The record of a weak jet beside the vehicle as it is known."""
    return compare_with_simulation(records["weak"], runs / "known")


def said(run: Run) -> Against:
    assert run.results.against is not None
    return run.results.against


def test_a_weak_jet_explains_the_record(weak: Run) -> None:
    found = said(weak)
    first = found.causes[0]
    assert first.what == "thrust of T6"
    assert first.size == pytest.approx(-60.0, abs=3.0 * first.size_std)
    assert first.size_std < 10.0
    assert found.until_s is None
    assert [one.signal for one in found.residuals] == ["mocap_x", "mocap_y", "mocap turned, z"]


def test_residuals_are_those_of_what_was_simulated(weak: Run) -> None:
    left = weak["mocap"][:, :2] - weak["against.mocap"][:, :2]
    rms = np.sqrt(np.nanmean(left**2, axis=0))
    found = said(weak).residuals
    np.testing.assert_allclose([one.rms for one in found[:2]], rms, rtol=1e-9)
    assert found[0].noise == 7e-5
    assert (rms > 40.0 * 7e-5).all()
    about_z = rotation_differences(weak["mocap"][:, 3:], weak["against.mocap"][:, 3:])[:, 2]
    assert found[2].rms == pytest.approx(np.sqrt(np.nanmean(about_z**2)))


def test_a_runs_own_record_is_as_simulated(runs: Path, records: dict[str, Run]) -> None:
    found = said(compare_with_simulation(records["known"], runs / "known"))
    assert found.causes == ()
    assert 0.7 < (found.misfit or 0.0) < 1.2
    assert "are as simulated" in found.in_words()
    assert max(one.rms or 0.0 for one in found.residuals) < 0.02


def test_what_cannot_be_simulated_is_refused(records: dict[str, Run], tmp_path: Path) -> None:
    flown(
        tmp_path,
        "heavier",
        "failures=[]",
        "duration_s=2",
        "jumps=[{kind: dock, time_s: 1, mass: 1, position: [0, 0, 0]}]",
    )
    with pytest.raises(InputError, match="payloads come or leave"):
        compare_with_simulation(records["known"], tmp_path / "heavier")
    flown(tmp_path, "other", "failures=[]", "duration_s=1", "vehicle.jets[0].position=[0.145, 0.07, 0.0]")
    with pytest.raises(InputError, match="whose places of jets are not those of 'air_bearing'"):
        compare_with_simulation(records["known"], tmp_path / "other")
