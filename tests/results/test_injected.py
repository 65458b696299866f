"""What became of each failure of a scenario: when it acted, what it was declared as, and what was declared besides."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.injected import InjectedRecord, false_declarations, injected_outcomes

Array = NDArray[np.float64]

PERIOD_S = 0.08
N_ROWS = 100
PAYLOAD = "[{{kind: {}, time_s: {}, mass: 100, position: [0, 0, 0]}}]"
STUCK_ON = "{kind: stuck_on, jet: R4R, start_s: 4.0}"
STUCK_OFF = "{kind: stuck_off, jet: F2R, start_s: 4.0}"


def scenario(*failures: str, jumps: str = "[]", more: tuple[str, ...] = ()) -> Scenario:
    given = [f"failures=[{', '.join(failures)}]", f"jumps={jumps}", "plant.thrust_transient=none", *more]
    return load_scenario("sample_maneuver", ["duration_s=8", "estimation.thrust_transient=gate", *given])


def flown(case: Scenario, tested: slice = slice(0, N_ROWS), **commands: slice) -> dict[str, Array]:
    """Signals of jets that do at once all that they are told in some rows; R4R is on from row 50 where it fails."""
    jet_index = case.vehicle_data.jet_index
    command = np.zeros((N_ROWS, len(case.vehicle_data.jets)))
    for jet, rows in commands.items():
        command[rows, jet_index(jet)] = 1.0
    thrust = command * np.linalg.norm(case.vehicle_data.thrusts, axis=1) * params.thrust_factors(case)
    if any(failure.kind == "stuck_on" for failure in case.failures):
        thrust[50:, jet_index("R4R")] = 870.0
    was_tested = np.zeros((N_ROWS, 1))
    was_tested[tested] = 1.0
    time_s = PERIOD_S * np.arange(N_ROWS)
    return {"time_s": time_s, "command": command, "thrust": thrust, "tested": was_tested, "alarm": 0.0 * was_tested}


def declared(time_s: float, **how: Any) -> DetectionRecord:
    given = {"kind": "jet_on", "cluster": 12, "jet": "R4R", "isolated_to": "jet", "magnitude": 870.0} | how
    return DetectionRecord(onset_s=time_s, time_s=time_s, magnitude_std=1.0, statistic=1.0e4, alarms=3, **given)


def jump(time_s: float) -> DetectionRecord:
    return declared(time_s, kind=JUMP, cluster=None, jet=None, isolated_to=None, magnitude=None)


def test_a_jet_stuck_off_acts_when_it_is_first_told_to_fire() -> None:
    case = scenario(STUCK_OFF)
    signals = flown(case, F2R=slice(70, 80))
    signals["thrust"][70:80] = 0.0
    signals["alarm"][[60, 75, 78]] = 1.0  # the first is before it acts
    (record,) = injected_outcomes(case, signals, [])
    lost = pytest.approx(-case.vehicle_data.jets[case.vehicle_data.jet_index("F2R")].thrust)
    times = 4.0, 70 * PERIOD_S, 75 * PERIOD_S, None
    assert record == InjectedRecord("stuck_off", "F2R", *times, "missed", None, lost)
    (record,) = injected_outcomes(case, flown(case, F2R=slice(10, 20), F1U=slice(60, 80)), [declared(7.0)])
    assert (record.outcome, record.first_acted_s, record.declared_s, record.force) == ("never_acted", None, None, None)


def test_a_failure_acts_while_it_lasts_and_is_tested() -> None:
    case = scenario("{kind: leak, jet: R4R, force: 40, start_s: 4.0, end_s: 5.0}")
    signals, jet = flown(case), case.vehicle_data.jet_index("R4R")
    signals["thrust"][(signals["time_s"] > 3.99) & (signals["time_s"] < 4.99), jet] = 40.0
    signals["thrust"][90:, jet] = 3.0  # not its doing
    (record,) = injected_outcomes(case, signals, [])
    assert record.force == pytest.approx(40.0)
    case = scenario(STUCK_ON)
    assert [one.outcome for one in injected_outcomes(case, flown(case, tested=slice(0, 40)), [])] == ["not_tested"]


def test_a_dispersed_jet_is_held_against_what_it_gives_when_well() -> None:
    case = load_scenario("sample_maneuver", ["plant.thrust_dispersion=0.05", f"failures=[{STUCK_OFF}]", "duration_s=8"])
    (record,) = injected_outcomes(case, flown(case, F2R=slice(55, 80)), [])
    assert record.outcome == "never_acted"


def test_nothing_of_a_jet_that_lags_is_taken_for_its_failure() -> None:
    leak = "failures=[{kind: leak, jet: F2R, force: 0.001, start_s: 8}]"
    jumps = f"jumps={PAYLOAD.format('release', 8.24)}"
    case = load_scenario("stuck_off_11", ["duration_s=9", leak, jumps, "plant.thrust_transient=vehicle"])
    record, payload = simulate(case, look_back=False).results.injected or ()
    assert record.force == pytest.approx(0.001, rel=1e-6)
    assert record.first_acted_s == pytest.approx(8.0)
    assert (payload.kind, payload.jet, payload.first_acted_s, payload.force) == ("release", None, 8.24, None)


DOCKED = PAYLOAD.format("release", 5.0)


@pytest.mark.parametrize(
    ("found", "failures", "jumps", "expected"),
    [
        ([declared(5.0)], [STUCK_ON], "[]", [("named", None, 5.0)]),
        ([declared(5.0, jet=None, isolated_to="cluster")], [STUCK_ON], "[]", [("group", None, 5.0)]),
        ([declared(5.0, jet="R2R")], [STUCK_ON], "[]", [("wrong", "R2R", 5.0)]),
        ([declared(5.0, jet=None, isolated_to="cluster", cluster=3)], [STUCK_ON], "[]", [("wrong", "cluster 3", 5.0)]),
        ([jump(5.0)], [STUCK_ON], "[]", [("wrong", JUMP, 5.0)]),
        ([declared(3.0)], [STUCK_ON], "[]", [("missed", None, None)]),  # before it acted
        ([declared(4.5, jet="R2R"), declared(5.0)], [STUCK_ON], "[]", [("named", None, 5.0)]),  # a wrong one was first
        ([declared(5.0), jump(6.0)], [STUCK_ON], DOCKED, [("named", None, 5.0), ("named", None, 6.0)]),
        ([declared(5.0)], [STUCK_ON], DOCKED, [("named", None, 5.0), ("missed", None, None)]),  # each has its own
        ([declared(6.0)], [], DOCKED, [("wrong", "R4R", 6.0)]),
    ],
)
def test_a_failure_is_what_it_is_declared_as(
    found: list[DetectionRecord], failures: list[str], jumps: str, expected: list[Any]
) -> None:
    case = scenario(*failures, jumps=jumps)
    became = injected_outcomes(case, flown(case), found)
    assert [(one.outcome, one.taken_for, one.declared_s) for one in became] == expected


def test_an_alarm_after_a_declaration_is_of_something_else_and_others_are_false() -> None:
    case = scenario(STUCK_ON, jumps=PAYLOAD.format("dock", 3.0))
    signals = flown(case)
    signals["alarm"][52:54] = 1.0
    jet, payload = injected_outcomes(case, signals, [jump(3.5), declared(53 * PERIOD_S)])
    assert jet.first_alarm_s == pytest.approx(52 * PERIOD_S)
    assert (payload.declared_s, payload.first_alarm_s) == (3.5, None)
    case = scenario(STUCK_ON, jumps=PAYLOAD.format("release", 6.0))
    found = [declared(2.0, jet="F1F"), declared(4.5), declared(5.0, jet="F2F"), declared(7.0, jet="F3F")]
    causes = false_declarations(case.vehicle_data, injected_outcomes(case, flown(case), found), found)
    assert causes == {0: "healthy", 2: "failure", 3: "jump"}
