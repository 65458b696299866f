"""What became of each failure of a scenario: when it acted, what it was declared as, and what was declared besides."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.injected import InjectedRecord, false_declarations, what_became

Array = NDArray[np.float64]

PERIOD_S = 0.08
N_ROWS = 100


def scenario(*failures: str, jumps: str = "[]", transient: str = "none") -> Scenario:
    overrides = [f"failures=[{', '.join(failures)}]", f"jumps={jumps}", f"plant.thrust_transient={transient}"]
    return load_scenario("sample_maneuver", ["duration_s=8", "estimation.thrust_transient=gate", *overrides])


def number(case: Scenario, jet: str) -> int:
    return case.vehicle_data.designations.index(jet)


def flown(case: Scenario, commands: dict[str, slice], tested: slice = slice(0, N_ROWS)) -> dict[str, Array]:
    """Signals of jets that are told to fire in some rows, and do all of it at once."""
    command = np.zeros((N_ROWS, len(case.vehicle_data.jets)))
    for jet, rows in commands.items():
        command[rows, number(case, jet)] = 1.0
    thrust = command * np.linalg.norm(case.vehicle_data.thrusts, axis=1) * params.thrust_factors(case)
    was_tested = np.zeros((N_ROWS, 1))
    was_tested[tested] = 1.0
    time_s = PERIOD_S * np.arange(N_ROWS)
    return {"time_s": time_s, "command": command, "thrust": thrust, "tested": was_tested, "alarm": 0.0 * was_tested}


def declared(time_s: float, **how: Any) -> DetectionRecord:
    given = {"kind": "jet_on", "cluster": 12, "jet": "R4R", "isolated_to": "jet", "magnitude": 870.0} | how
    return DetectionRecord(onset_s=time_s, time_s=time_s, magnitude_std=1.0, statistic=1.0e4, alarms=3, **given)


JUMP = {"kind": "mass_property_jump", "cluster": None, "jet": None, "isolated_to": None, "magnitude": None}
STUCK_ON = "{kind: stuck_on, jet: R4R, start_s: 4.0}"
STUCK_OFF = "{kind: stuck_off, jet: F2R, start_s: 4.0}"


# --------------------------------------------------------------------------------- when it acts


def test_a_jet_stuck_off_acts_when_it_is_first_told_to_fire() -> None:
    case = scenario(STUCK_OFF)
    signals = flown(case, {"F2R": slice(70, 80)})
    signals["thrust"][70:80] = 0.0
    signals["alarm"][[60, 75, 78]] = 1.0  # the first is before it acts
    (record,) = what_became(case, signals, [])
    thrust = case.vehicle_data.jets[number(case, "F2R")].thrust
    assert record == InjectedRecord(
        "stuck_off", "F2R", 4.0, 70 * PERIOD_S, 75 * PERIOD_S, None, "missed", None, pytest.approx(-thrust)
    )


def test_a_jet_stuck_off_that_is_never_told_to_fire_never_acts() -> None:
    case = scenario(STUCK_OFF)
    (record,) = what_became(case, flown(case, {"F2R": slice(10, 20), "F1U": slice(60, 80)}), [declared(7.0)])
    assert (record.outcome, record.first_acted_s, record.declared_s, record.force) == ("never_acted", None, None, None)


def test_a_failure_that_is_over_acts_no_longer() -> None:
    case = scenario("{kind: leak, jet: R4R, force: 40, start_s: 4.0, end_s: 5.0}")
    signals = flown(case, {})
    rows = (signals["time_s"] > 3.99) & (signals["time_s"] < 4.99)
    signals["thrust"][rows, number(case, "R4R")] = 40.0
    signals["thrust"][90:, number(case, "R4R")] = 3.0  # not its doing
    (record,) = what_became(case, signals, [])
    assert record.force == pytest.approx(40.0)


def test_a_dispersed_jet_is_held_against_what_it_gives_when_well() -> None:
    case = load_scenario("sample_maneuver", ["plant.thrust_dispersion=0.05", f"failures=[{STUCK_OFF}]", "duration_s=8"])
    (record,) = what_became(case, flown(case, {"F2R": slice(55, 80)}), [])
    assert record.outcome == "never_acted"


@pytest.mark.parametrize("transient", ["none", "vehicle"])
def test_nothing_of_a_jet_that_lags_is_taken_for_its_failure(transient: str) -> None:
    case = load_scenario(
        "stuck_off_11",
        [
            "duration_s=9",
            "failures=[{kind: leak, jet: F2R, force: 0.001, start_s: 8}]",
            f"plant.thrust_transient={transient}",
        ],
    )
    run = simulate(case, look_back=False)
    (record,) = run.results.injected or ()
    assert record.force == pytest.approx(0.001, rel=1e-6)
    assert record.first_acted_s == pytest.approx(8.0)


def test_a_payload_acts_when_it_leaves() -> None:
    run = simulate(load_scenario("payload_release", ["duration_s=45.5", "execution.engine=loop"]), look_back=False)
    (record,) = run.results.injected or ()
    assert (record.kind, record.jet, record.first_acted_s, record.force) == ("release", None, 45.0, None)


def test_nothing_has_been_tested() -> None:
    case = scenario(STUCK_ON)
    signals = flown(case, {}, tested=slice(0, 40))
    signals["thrust"][50:, number(case, "R4R")] = 870.0
    assert [record.outcome for record in what_became(case, signals, [])] == ["not_tested"]


# --------------------------------------------------------------------------- what it is taken for


def outcome_of(found: list[DetectionRecord], *failures: str, jumps: str = "[]") -> list[tuple[str, Any, Any]]:
    case = scenario(*failures, jumps=jumps)
    signals = flown(case, {})
    signals["thrust"][50:, number(case, "R4R")] = 870.0
    return [(one.outcome, one.taken_for, one.declared_s) for one in what_became(case, signals, found)]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (declared(5.0), ("named", None, 5.0)),
        (declared(5.0, jet=None, isolated_to="cluster"), ("group", None, 5.0)),
        (declared(5.0, jet="R2R"), ("wrong", "R2R", 5.0)),
        (declared(5.0, jet=None, isolated_to="cluster", cluster=3), ("wrong", "cluster 3", 5.0)),
        (declared(5.0, **JUMP), ("wrong", "mass_property_jump", 5.0)),
        (declared(3.0), ("missed", None, None)),  # before it acted
    ],
)
def test_a_failed_jet_is_what_it_is_declared_as(entry: DetectionRecord, expected: tuple[Any, ...]) -> None:
    assert outcome_of([entry], STUCK_ON) == [expected]


def test_the_right_declaration_counts_although_a_wrong_one_came_first() -> None:
    assert outcome_of([declared(4.5, jet="R2R"), declared(5.0)], STUCK_ON) == [("named", None, 5.0)]


def test_each_failure_has_its_own_declaration() -> None:
    jump = "[{kind: release, time_s: 5.0, mass: 100, position: [0, 0, 0]}]"
    found = [declared(5.0), declared(6.0, **JUMP)]
    assert outcome_of(found, STUCK_ON, jumps=jump) == [("named", None, 5.0), ("named", None, 6.0)]
    assert outcome_of(found[:1], STUCK_ON, jumps=jump) == [("named", None, 5.0), ("missed", None, None)]
    assert outcome_of([declared(6.0)], jumps=jump) == [("wrong", "R4R", 6.0)]


def test_an_alarm_after_a_declaration_is_of_something_else() -> None:
    case = scenario(STUCK_ON, jumps="[{kind: dock, time_s: 3.0, mass: 100, position: [0, 0, 0]}]")
    signals = flown(case, {})
    signals["thrust"][50:, number(case, "R4R")] = 870.0
    signals["alarm"] = np.zeros((N_ROWS, 1))
    signals["alarm"][52:54] = 1.0
    jet, payload = what_became(case, signals, [declared(3.5, **JUMP), declared(53 * PERIOD_S)])
    assert jet.first_alarm_s == pytest.approx(52 * PERIOD_S)
    assert (payload.declared_s, payload.first_alarm_s) == (3.5, None)


# ------------------------------------------------------------------------------------ what is false


def test_a_declaration_that_no_failure_explains_is_false_and_has_a_cause() -> None:
    case = scenario(STUCK_ON, jumps="[{kind: release, time_s: 6.0, mass: 100, position: [0, 0, 0]}]")
    signals = flown(case, {})
    signals["thrust"][50:, number(case, "R4R")] = 870.0
    found = [declared(2.0, jet="F1F"), declared(4.5), declared(5.0, jet="F2F"), declared(7.0, jet="F3F")]
    injected = what_became(case, signals, found)
    causes = false_declarations(case.vehicle_data, injected, found)
    assert causes == {0: "healthy", 2: "failure", 3: "jump"}


# ---------------------------------------------------------------------------------- in the summary


def test_a_summary_tells_it(stuck_run: Run) -> None:
    (told,) = stuck_run.summary["injected"]
    (entry,) = stuck_run.results.detections
    assert told["outcome"] == "named"
    assert told["declared_s"] == entry.time_s
    assert told["magnitude"] == entry.magnitude
    assert told["force"] == pytest.approx(entry.magnitude, rel=1e-3)
    assert told["start_s"] <= told["first_acted_s"] <= told["first_alarm_s"] <= told["declared_s"]
