"""Posterior probabilities and histories in runs, records, real time and ports, by a detector that has them by heart."""

from __future__ import annotations

from typing import Any

import pytest
from odds_probe import detector, history, odds
from pydrake.systems.analysis import Simulator

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import closed_loop
from massprop_drake.maths.estimation.detectors import DETECTORS
from massprop_drake.maths.estimation.faults.fault_report import History, Odds
from massprop_drake.systems.views import port_view

N, R4R, F1U = 44, 28, 10
PERIOD_S = 0.08
FORK = 60  # row at which another history becomes the likeliest, by a fork twenty rows before


def told(sample: int) -> tuple[Odds, History | None]:
    """Nothing at first, then perhaps a jet, and something unknown."""
    if sample < FORK:
        return odds(N, {}, none=1.0), None
    past = history((FORK - 20) * PERIOD_S, (52.0, 50.0), (9e4, 60.0)) if sample == FORK else None
    return odds(N, {R4R: 0.9, F1U: 0.02}, none=0.07, unknown=0.03), past


@pytest.fixture(scope="module")
def by_heart() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(DETECTORS, "hypotheses", detector(told))
        yield


@pytest.fixture(scope="module")
def scenario(by_heart: None) -> Scenario:
    joint = ["estimation={filter: joint, start: nominal}", "mass={}", "rotation={}", "detector={kind: hypotheses}"]
    return load_scenario("sample_maneuver", ["duration_s=8", *joint])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


def test_a_run_keeps_them_and_sums_them_up(flown: Run) -> None:
    assert (flown["fault_probability"][FORK:, R4R] == 0.9).all()
    assert not flown["fault_probability"][:FORK].any()
    assert flown.units["fault_force"] == "lbf"
    found, names = flown.summary["fault_probability"], flown.scenario.vehicle_data.designations
    assert list(found) == [names[R4R], names[F1U], "none", "unknown"]
    assert found[names[R4R]] == {"probability": 0.9, "mode": "leak", "force": 10.0, "force_std": 0.25}
    assert (found["none"], found["unknown"]) == (0.07, 0.03)
    (suspected,) = flown.results.unconfirmed
    assert (suspected.jets, suspected.statistic) == ((names[R4R],), 0.9)
    assert "fault_probabilities" in flown.plot.all()


def test_the_verdict_judges_the_likeliest_history(flown: Run) -> None:
    replaced = slice(FORK - 19, FORK + 1)
    for name, total in (("rotation", 52.0), ("mass", 9e4)):
        used = flown[f"{name}_used"][:, 0] != 0.0
        part = flown["gyro_components" if name == "rotation" else "accelerometer_components"][:, 0]
        assert used[replaced].any()
        kept = used.copy()
        kept[replaced] = False
        nis = (flown[f"{name}_nis"][kept, 0] * part[kept] / 3.0).sum() + total
        expected = part[kept].sum() + (50.0 if name == "rotation" else 60.0)
        summed = flown.results.consistency
        mean = summed.rotation_nis_mean if name == "rotation" else summed.translation_nis_mean
        assert mean == pytest.approx(3.0 * nis / expected, rel=1e-12)
    assert flown.results.consistency.verdict == "inconsistent"  # a false name: its own sums count
    assert all("translation" in reason for reason in flown.results.consistency.reasons)


def test_the_port_has_the_jets_then_none_and_unknown(scenario: Scenario) -> None:
    diagram: Any = closed_loop.build(scenario, findings=True)
    simulator, view = Simulator(diagram), port_view("fault_probability", scenario.vehicle_data.designations)
    for row, expected in ((FORK - 1, (0.0, 0.0, 1.0, 0.0)), (FORK, (0.9, 0.02, 0.07, 0.03))):
        simulator.AdvanceTo(row * PERIOD_S)
        port = view(diagram.GetOutputPort("fault_probability").Eval(simulator.get_context()))
        assert (port[R4R], port[F1U], port.none, port.unknown) == expected
    simulator.AdvanceTo(scenario.duration_s)
    simulator.AdvancePendingEvents()
    assert diagram.GetOutputPort("fault_probability").Eval(simulator.get_context())[R4R] == 0.9


def test_the_verdict_while_it_flies_is_the_summary_s(scenario: Scenario, flown: Run) -> None:
    diagram = closed_loop.build(scenario, findings=True)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(flown.time_s[-1])
    simulator.AdvancePendingEvents()
    verdict, summed = diagram.GetOutputPort("verdict").Eval(simulator.get_context()), flown.results.consistency
    assert verdict.samples == summed.samples
    assert list(verdict.reasons) == list(summed.reasons)
    for name in ("rotation_nis_mean", "translation_nis_mean", "rotation_nis_beyond", "translation_nis_within"):
        assert getattr(verdict, name) == pytest.approx(getattr(summed, name), rel=1e-9), name
