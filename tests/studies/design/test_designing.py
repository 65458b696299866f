"""Designs of maneuvers: against flights, with limits, suspects and what is known already, and what cannot be had."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from massprop_drake import Design, Run, design, load_scenario, load_vehicle, simulate
from massprop_drake.cli.app import app
from massprop_drake.errors import InputError
from massprop_drake.inputs.estimation_blocks import CglrBlock
from massprop_drake.inputs.scenario_fields import ExecutionBlock
from massprop_drake.studies.design import designing, saving


@pytest.fixture(scope="module")
def weighed() -> Design:
    """The servicer's mass to 2 %, which one firing or two tell, within narrow limits and without two jets."""
    asked = {"rate": "1 deg/s", "time": "20 s"}
    return design(load_vehicle("servicer"), {"mass": "2%"}, limits=asked, without=["XP1", "XP2"], flights=1)


def test_flights_are_as_predicted(weighed: Design) -> None:
    (mass,) = weighed.targets
    assert (mass.name, mass.unit) == ("mass", "kg")
    assert mass.asked == pytest.approx(0.02 * mass.value)
    assert mass.floor < mass.predicted <= mass.asked / 1.15
    for flown in mass.flown:  # estimates that have not converged are foretold with products of errors as noise
        assert 0.75 * mass.predicted < flown < 1.1 * mass.predicted
    assert max(map(abs, mass.errors)) < 4.0 * mass.asked


def test_limits_are_kept_in_flight(weighed: Design) -> None:
    quick = {"seed": 3, "detector": CglrBlock(kind="off"), "execution": ExecutionBlock(engine="loop")}
    run = simulate(weighed.scenario.model_copy(update=quick), look_back=False)
    assert np.linalg.norm(run["rate"], axis=1).max() == pytest.approx(weighed.rate, rel=0.05)
    assert weighed.rate <= math.radians(1.0)
    fired = {pulse.jet for pulse in weighed.scenario.jet_schedule}
    assert fired
    assert not fired & {"XP1", "XP2"}
    assert run.time_s[-1] == pytest.approx(weighed.duration_s)
    flow = dict(zip(weighed.scenario.vehicle_data.designations, weighed.scenario.vehicle_data.mass_flows, strict=True))
    used = sum(flow[pulse.jet] * (pulse.end_s - pulse.start_s) for pulse in weighed.scenario.jet_schedule)
    assert used == pytest.approx(weighed.propellant)


def test_its_folder_flies(weighed: Design, tmp_path: Path) -> None:
    folder = saving.save(weighed, tmp_path / "design")
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files == {
        "scenario.yaml", "design.json", "design.html", "manifest.json", "figures/front.png", "figures/firings.png",
    }  # fmt: skip
    again = load_scenario(folder)
    assert again.jet_schedule == weighed.scenario.jet_schedule
    assert again.open_loop
    content = json.loads((folder / "design.json").read_text(encoding="utf-8"))
    assert content["targets"][0]["predicted"] == weighed.targets[0].predicted
    page = (folder / "design.html").read_text(encoding="utf-8")
    assert "plot-front" in page
    assert "mass, 180 kg: 1-sigma" in page
    assert saving.save(weighed, folder) == folder  # what is unchanged is replaced


def test_the_command_turns_a_vehicle_by_wheels_at_no_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody flies meanwhile: where only wheels turn, an autopilot would undo it by jets."""
    made, out = list[Design](), tmp_path / "out"
    monkeypatch.setattr(designing, "design", lambda *given, **more: made.append(design(*given, **more)) or made[-1])
    words = ["design", "cubesat", "--target", "Ixx=5%", "--flights", "1", "--out", str(out)]
    printed = CliRunner().invoke(app, words)
    assert printed.exit_code == 0
    assert "Ixx, 0.041 kg-m^2: 1-sigma" in printed.stdout
    assert "RWX" in printed.stdout
    assert (out / "design.html").exists()
    (found,) = made
    assert found.propellant == 0.0
    assert {pulse.wheel for pulse in found.scenario.wheel_schedule} == {"RWX"}
    assert found.scenario.open_loop
    np.testing.assert_allclose(found.targets[0].flown, found.targets[0].predicted, rtol=0.1)
    wrong = CliRunner().invoke(app, ["design", "servicer", "--target", "mass", "--out", str(tmp_path / "none")])
    assert isinstance(wrong.exception, InputError)
    assert not (tmp_path / "none").exists()


@pytest.fixture(scope="module")
def run() -> Run:
    """A flight in which the vehicle becomes known, by an autopilot."""
    settings = ["duration_s=10", "estimation.filter=joint", "detector.kind=off", "execution.engine=loop"]
    return simulate(load_scenario("small_satellite_maneuver", settings), look_back=False)


def test_it_goes_on_from_what_a_run_knows(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    with pytest.raises(InputError, match="the run is of vehicle 'small_satellite', not of 'servicer'"):
        design(load_vehicle("servicer"), {"mass": "1%"}, known=run)
    found = design(run.scenario, {"mass": "1%", "inertia": "1%"}, known=folder, limits={"rate": "2 deg/s"})
    mass, *moments = found.targets
    assert mass.before / mass.value > 0.25  # it has only turned
    assert max(one.before / one.value for one in moments) < 0.02
    assert found.begins_s == 10.0
    assert not found.scenario.open_loop  # the autopilot that flew goes on
    assert all(pulse.start_s >= 10.0 for pulse in found.scenario.jet_schedule)
    flown = simulate(found.scenario.model_copy(update={"detector": run.scenario.detector}), look_back=False)
    np.testing.assert_array_equal(flown["rate"][: run.time_s.size], run["rate"])
    share = flown.covariance[9, 9] ** 0.5 / flown.results.estimates[9]
    assert 0.8 * mass.predicted / mass.value < share < 1.05 * mass.asked / mass.value  # holding attitude tells more


@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("servicer", {"targets": {"weight": "1%"}}, "target 'weight': no such quantity"),
        ("servicer", {"targets": {"mass": "1 m"}}, "'m' does not fit; write it like 1%"),
        ("servicer", {"targets": {"mass": "0.1%"}}, "common scale of all thrusts"),
        ("cubesat", {"targets": {"mass": "1%"}}, "No firing of these jets shows 1/m"),
        ("servicer", {"targets": {}}, "nothing is asked for"),
        ("servicer", {"targets": {"mass": "2%"}, "limits": {"rate": "0.001 deg/s"}}, "rate 0.001 deg/s: forbids every"),
        ("servicer", {"targets": {"mass": "2%"}, "limits": {"speed": "1"}}, "no such limit"),
        ("servicer", {"targets": {"mass": "2%"}, "without": ["T1"]}, "without 'T1': no such jet"),
        ("servicer", {"suspects": ["XP1"], "force": "200%"}, "is more than the thrust of XP1"),
        ("servicer", {"suspects": ["XP1"], "force": "-5%", "without": ["XP1"]}, "gives less only while it fires"),
        ("air_bearing", {"targets": {"mass": "2%"}}, "in a fixed frame"),
    ],
)
def test_what_cannot_be_had_is_one_message(name: str, asked: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match="design: ") as caught:
        design(load_vehicle(name), **asked)  # type: ignore[arg-type]
    assert words in str(caught.value)
