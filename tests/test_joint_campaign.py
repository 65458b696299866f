"""How the campaign of the joint filter judges what was said of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from script_probe import script

from massprop_drake import load_scenario, simulate


@pytest.fixture(scope="module")
def campaign() -> ModuleType:
    return script(Path(__file__).parents[1] / "benchmarks" / "joint_campaign.py")


def event(kind: str, time_s: float, *jets: str) -> dict[str, Any]:
    return {"kind": kind, "time_s": time_s, "jets": list(jets)}


def test_verdicts(campaign: ModuleType) -> None:
    failed = {"A": 48.0, "B": 49.0}

    def judged(*events: dict[str, Any], apart: float = 3.0, expected: str = "") -> str:
        def differ(_time_s: float, _jets: Sequence[str]) -> float:
            return apart

        verdict: str = campaign.judged(events, {} if expected else failed, expected, differ)[0]
        return verdict

    named = event("failed", 48.5, "A")
    assert judged(named, event("failed", 50.0, "B")) == "right"
    assert judged(named) == "silent"
    assert judged(named, event("failed", 48.6, "B")) == "wrong"  # before it has acted
    assert judged(named, event("failed", 50.0, "C")) == "wrong"
    assert judged(named, event("jump", 50.0)) == "wrong"
    assert judged(named, event("group", 50.0, "C", "B", "D")) == "grouped"
    assert judged(named, event("group", 50.0, "C", "B", "D"), apart=6.1) == "wide"
    assert judged(named, event("group", 50.0, "C", "B", "D", "E")) == "wide"
    assert judged(named, event("group", 50.0, "C", "D")) == "wrong"
    assert judged(named, event("group", 50.0, "C", "B"), event("failed", 51.0, "B")) == "right"
    assert judged(event("jump", 50.0), expected="jump") == "right"
    assert judged(event("jump", 50.0), event("jump", 55.0), expected="jump") == "wrong"
    assert judged(expected="jump") == "silent"


def test_delays_count_from_when_a_failure_acts_to_its_first_name(campaign: ModuleType) -> None:
    events = [event("group", 48.5, "A", "C"), event("failed", 50.0, "A")]
    _, told = campaign.judged(events, {"A": 48.0, "B": 49.0}, "", lambda *_: 0.0)
    assert told == {"A": 48.5, "B": np.inf}


def test_every_kind_is_a_scenario(campaign: ModuleType) -> None:
    """Three numbers of each, but for what needs a flight to be drawn."""
    for kind, draw in campaign.KINDS.items():
        if {"off", "drift", "degraded"} & set(kind.split("_")):
            continue
        for number in range(3):
            flight = draw(np.random.default_rng([number, *kind.encode()]), number)
            again = draw(np.random.default_rng([number, *kind.encode()]), number)
            assert flight == again
            settings = campaign.settings_of(flight, number)
            assert campaign.load_scenario(flight.scenario, settings).seed == number


def test_flights_that_end_far_off_are_told_whatever_was_said(
    campaign: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    def result(number: int, error: float, verdict: str) -> Any:
        of_nothing: list[float] = []
        return campaign.Result(
            "payload", number, "right", [], of_nothing, [0.1] * 9 + [error], of_nothing, [0.0] * 10, [3.0, 3.0], [], [],
            1.0, verdict,
        )  # fmt: skip

    campaign.report("payload", [result(0, 5.9, "consistent"), result(1, 1.0, "consistent")])
    assert "BEYOND" not in capsys.readouterr().out
    campaign.report("payload", [result(3, -6.1, "consistent"), result(4, 7.0, "inconsistent")])
    assert "BEYOND 6 SIGMA 2, of these called consistent 1: 3 4" in capsys.readouterr().out


def test_the_bound_lies_beside_what_was_estimated() -> None:
    accuracy = script(Path(__file__).parents[1] / "benchmarks" / "joint_accuracy.py")
    case = load_scenario("orbiter_maneuver", ["duration_s=16", "execution.engine=loop"])
    found = accuracy.compared(case, simulate(case))
    assert np.isfinite(found.bounds).all()
    assert np.abs(found.bounds).max() < 6.0
    assert np.abs(found.sigmas).max() < 6.0
