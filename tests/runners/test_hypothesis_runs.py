"""The detector by hypotheses through every runner: the same bits, restarts, what is said and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_probe import Massprop
from replay_probe import replayed

from massprop_drake import Estimator, InputError, Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.runners.recorded import settings_alone

ACCELEROMETERS = ("acc1", "acc2", "acc3")
LOOP = "execution.engine=loop"  # the diagram's bits, sooner
NEAR = [
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """A leak in a flight whose filter starts near the truth and soon settles."""
    return load_scenario(
        "leak_named", ["duration_s=9", *NEAR, "failures=[{kind: leak, jet: L4D, start_s: 7, force: 10}]"]
    )


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("hypotheses") / "run", pictures=False, report=False)


def test_record_and_replay_diagram_give_the_bits_of_the_flight(flown: Run, folder: Path) -> None:
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    second = replayed(folder / "telemetry.csv", settings_alone(flown.scenario))
    for name, expected in second.signals.items():
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
        np.testing.assert_array_equal(flown[name], expected, err_msg=name)
    assert {"verdict", "verdict_onset", "racing", "jump_mass", "likelihood", "known_force"} <= set(second.signals)
    assert flown["racing"].any()
    assert found.state["states"] == flown.state["states"] == second.states
    assert found.summary["detections"] == flown.summary["detections"] != []


def _steps(dut: Estimator, run: Run, rows: range) -> list[tuple[float, str, str | None]]:
    """Steps over rows of a run, which must give its estimates; what is declared when."""
    said = []
    for row in rows:
        readings = {name: run[name][row] for name in ACCELEROMETERS}
        step = dut.step(run.time_s[row], run["gyro"][row], readings, run["command"][row])
        np.testing.assert_array_equal(step.estimate, run["estimate"][row])
        if row + 1 < len(run.time_s):  # the autopilot does without them from the next sample on
            np.testing.assert_array_equal(step.removed, run["out_of_use"][row + 1] == 1.0)
        if step.detection is not None:
            said.append((step.time_s, step.detection.kind, step.detection.jet))
    return said


def test_the_estimator_gives_them_too(scenario: Scenario, flown: Run) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    (record,) = flown.results.detections
    assert _steps(dut, flown, range(len(flown.time_s))) == [(record.time_s, "jet", "L4D")]


def test_after_a_restart_what_was_said_is_not_said_again(scenario: Scenario, flown: Run) -> None:
    """The bank begins anew; hypotheses, their forces and the jets out of use are those of before."""
    dut = Estimator(scenario.vehicle_data, scenario)
    (record,) = flown.results.detections
    row = int(np.searchsorted(flown.time_s, record.time_s)) + 1
    _steps(dut, flown, range(row))
    kept = json.loads(json.dumps(dut.state))
    again = Estimator(scenario.vehicle_data, scenario)
    again.restore(kept)
    assert again.state == kept
    assert _steps(again, flown, range(row, len(flown.time_s))) == []


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, None, "must be finite"),
        (44, -1.0, "zero or positive"),
        (88, 0.5, "removed must be 0 or 1"),
        (132, 0.5, "an index is out of its range"),
        (133, 1.0, "ends too soon"),
        (134, 0.5, "counts must be whole numbers"),
    ],
)
def test_an_edited_state_is_refused(scenario: Scenario, place: int, value: float | None, message: str) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    kept = dut.state
    kept["states"]["hypothesis_detector"][0][place] = value
    with pytest.raises(InputError, match=f"hypothesis_detector: .*{message}"):
        dut.restore(kept)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["detector={kind: cglr}"], "cglr does not go with estimation.filter: joint; use hypotheses or off"),
        (
            ["estimation={filter: thesis}", "joint={}"],
            "hypotheses does not go with estimation.filter: thesis; use cglr or cusum or off",
        ),
        (["detector={kind: hypotheses, margin: 6}"], "margin"),
        (["detector={kind: cusum, slots: 2}"], "slots"),
        (["faults.slots=0"], "slots"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_scenario("leak_named", overrides)


def test_a_gap_in_the_record_begins_the_bank_anew(scenario: Scenario, folder: Path, tmp_path: Path) -> None:
    lines = (folder / "telemetry.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    holes = tmp_path / "holes.csv"
    holes.write_text("".join(lines[:40] + lines[52:]), encoding="utf-8")
    found = estimate(holes, load_scenario(folder))
    assert {said.jet for said in found.results.detections} <= {"L4D"}
    names, probable = found.scenario.vehicle_data.designations, found["fault_probability"][-1]
    assert {name for name, share in zip(names, probable, strict=True) if share > 0.1} <= {"L3D", "L4D", "L5D"}
    assert probable[names.index("L4D")] > 0.1  # less is known after a gap, and its neighbors look alike for a while


def test_a_payload_that_docks_is_weighed() -> None:
    """In a flight of the joint filter that has settled."""
    run = simulate(
        load_scenario(
            "payload_docking",
            ["duration_s=38", LOOP, *NEAR, "jumps=[{kind: dock, time_s: 12, mass: 500, position: [60, 0, -3]}]"],
        ),
        look_back=False,
    )
    (said,) = run.results.detections
    assert (said.kind, said.jet, said.jets, said.isolated_to) == ("mass_property_jump", None, (), None)
    assert said.mass is not None
    assert said.mass_std is not None
    assert said.mass_std < 0.1 * said.mass
    assert abs(said.mass - 500.0) < 4.0 * said.mass_std
    error = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(error).max() < 4.5


def test_a_stuck_jet_is_named_by_the_command(massprop: Massprop) -> None:
    """From zero, thrusts of the file with their stated uncertainty; declared within two samples."""
    stuck = ["duration_s=41", "failures=[{kind: stuck_on, jet: R4R, start_s: 40}]"]
    out = massprop(
        "run", "leak_named", "--out", "K", "--no-figures", *(word for one in stuck for word in ("--set", one))
    )
    assert out.status == 0
    assert "detected:    jet R4R (cluster 12): stuck on, +868." in out.out
    summary = json.loads(Path("K/summary.json").read_text(encoding="utf-8"))
    (said,) = summary["detections"]
    assert (said["jet"], said["jets"], said["isolated_to"]) == ("R4R", ["R4R"], "jet")
    assert said["time_s"] - said["onset_s"] < 0.3
    assert summary["injected"][0]["outcome"] == "named"
    assert "jet R4R: stuck on" in Path("K/report.html").read_text(encoding="utf-8")


def _sooner(name: str, by_s: float, *overrides: str) -> Run:
    """A bundled scenario from near the truth, its failures some seconds sooner."""
    failures = [one.model_dump(exclude_none=True) for one in load_scenario(name).failures]
    for one in failures:
        one.update({key: one[key] - by_s for key in ("start_s", "end_s") if key in one})
    return simulate(load_scenario(name, [LOOP, *NEAR, f"failures={json.dumps(failures)}", *overrides]), look_back=False)


def test_a_leak_of_half_a_percent_is_named() -> None:
    run = _sooner("leak_small", 40.0, "duration_s=11")
    (said,) = run.results.detections
    assert (said.jet, said.kind, said.mode) == ("L4D", "jet_on", "leak")
    assert said.magnitude is not None
    assert said.magnitude_std is not None
    assert abs(said.magnitude - 5.0) < 4.0 * said.magnitude_std < 1.0
    assert said.time_s - 8.0 < 3.0


def test_two_leaks_at_once_are_both_named() -> None:
    run = _sooner("two_at_once", 40.0, "duration_s=10")
    assert run.results.injected is not None
    assert {said.jet for said in run.results.detections} == {"R4R", "F2F"}
    assert [(one.jet, one.outcome) for one in run.results.injected] == [("R4R", "named"), ("F2F", "named")]
    assert all(abs(said.onset_s - 8.0) <= 0.16 for said in run.results.detections)


def test_a_group_whose_likeliest_was_wrong_is_settled_by_what_comes() -> None:
    """A second leak begins before two jets are told apart; the likelier of them has not failed."""
    failures = [
        {"kind": "leak", "jet": "F3D", "start_s": 49.48298047580158, "force": 10.0},
        {"kind": "leak", "jet": "F3U", "start_s": 48.48298047580158, "force": 10.0},
    ]
    told = [
        "jumps=[]",
        f"failures={json.dumps(failures)}",
        "plant.thrust_dispersion=0.01",
        "plant.lag_factor=0.9523809523809523",
    ]
    given = [*told, "joint.thrust_uncertainty=0.01", "seed=991037", "duration_s=54", LOOP]
    run = simulate(load_scenario("payload_docking", given), look_back=False)
    said = sorted((each.kind, each.jets) for each in run.results.events)
    assert said == [("failed", ("F3D",)), ("failed", ("F3U",))]
    errors = (np.array(run["estimate"][-1]) - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < 4.0


def test_a_jet_that_comes_and_goes_is_said_to_be_erratic(tmp_path: Path) -> None:
    run = simulate(load_scenario("intermittent_jet", ["duration_s=50", LOOP]), look_back=False)
    first, said = run.results.detections
    assert (first.jet, first.erratic_s) == ("R4R", None)
    assert first.withdrawn_s is not None
    assert first.withdrawn_s < said.time_s
    assert (said.jet, said.pattern, said.withdrawn_s) == ("R4R", "intermittent", None)
    assert said.erratic_s is not None
    assert said.erratic_s - 48.0 < 3.0
    assert {event.kind for event in run.results.events} >= {"failed", "erratic"}
    assert run.results.unconfirmed == ()
    assert run.results.injected is not None
    acted = [one for one in run.results.injected if one.outcome != "never_acted"]
    assert {one.outcome for one in acted} == {"named"}
    assert len(acted) == 3
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    again = estimate(folder / "telemetry.csv", run.scenario).results
    assert (again.detections, again.events) == (run.results.detections, run.results.events)
    assert (again.unconfirmed, again.untested) == (run.results.unconfirmed, run.results.untested)


def test_stated_dispersions_of_thrust_are_no_failure() -> None:
    near = "estimation={filter: joint, start: nominal, std_fraction: 0.05}"
    run = simulate(load_scenario("dispersed_thrust", ["duration_s=16", LOOP, near]), look_back=False)
    results = run.results
    assert (results.detections, results.events, results.unconfirmed) == ((), (), ())
    (untested,) = results.untested
    assert untested.reason.startswith("never commanded")
    fired = run["command"].max(axis=0) > 0.0
    names = run.scenario.vehicle_data.designations
    assert set(untested.jets) == {jet for jet, once in zip(names, fired, strict=True) if not once}
