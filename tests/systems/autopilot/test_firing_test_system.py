"""Test firings in flight: questions that make it fire, what it fires, and when it rests."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from systems_probe import give, inputs, output, outputs

from massprop_drake import load_scenario
from massprop_drake.errors import InputError
from massprop_drake.inputs import crafts
from massprop_drake.maths.maneuver.onboard import FiringTest, misses_target, suspects
from massprop_drake.systems import FiringTestSystem

N = 12


@cache
def settings(block: str = "{when: group, force: 40%, patience_s: 0.3}", *more: str) -> FiringTest:
    overrides = ["estimation.filter=joint", f"autopilot.test_firing={block}", *more]
    made = crafts.firing_test(load_scenario("small_satellite_maneuver", overrides))
    assert made is not None
    return made


def probabilities(of: dict[int, float]) -> np.ndarray:
    found = np.zeros(N + 2)
    found[list(of)] = list(of.values())
    found[N] = 1.0 - found[:N].sum()
    return found


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        ({}, ()),
        ({8: 0.2, 11: 0.2}, ()),  # it may be that nothing has failed
        ({8: 0.88}, (8,)),  # has it?
        ({8: 0.6, 11: 0.37, 2: 0.02, 5: 0.001}, (2, 8, 11)),
    ],
)
def test_a_question_is_which_jet_has_failed_or_whether(of: dict[int, float], expected: tuple[int, ...]) -> None:
    assert suspects(probabilities(of), settings()) == expected


def test_it_fires_once_when_a_question_has_stood_for_a_while() -> None:
    dut, nominal = FiringTestSystem(settings()), settings().craft.properties
    assert inputs(dut) == {"estimate": 10, "covariance": 100, "fault_probability": N + 2, "gyro": 3}
    assert outputs(dut) == {"command": N, "tests": 1}
    context = dut.CreateDefaultContext()
    inertia = np.abs(nominal[:3])
    deviation = 0.01 * np.concatenate((inertia, np.full(3, inertia.mean()), np.ones(3), [nominal[9]]))
    give(dut, context, estimate=nominal, covariance=np.diag(deviation**2).ravel(), gyro=np.zeros(3))
    simulator, fired = Simulator(dut, context), []
    for of, samples in (({}, 3), ({8: 0.5, 9: 0.5}, 3), ({8: 0.5, 9: 0.5}, 8), ({8: 1.0}, 1), ({8: 1.0}, 3)):
        give(dut, context, fault_probability=probabilities(of))
        rows = []
        for _ in range(samples):
            simulator.AdvanceTo(round(context.get_time() + 0.1, 9))
            rows.append(output(dut, context, "command").copy())
        fired.append(np.array(rows))
    assert [rows.any() for rows in fired[:3]] == [False, False, True]
    assert fired[2][:, [8, 9]].any(axis=0).all()  # a loss shows only where each fires
    assert output(dut, context, "tests")[0] >= 1.0
    assert not fired[4].any()  # it is answered


@pytest.mark.parametrize(("share", "expected"), [(0.009, False), (0.02, True), (np.nan, True)])
def test_a_target_that_is_known_asks_for_nothing(share: float, *, expected: bool) -> None:
    made, covariance = settings("{when: target, targets: {mass: 1%}}"), np.full((10, 10), np.nan)
    covariance[9, 9] = (share * made.craft.properties[9]) ** 2  # NaN: nobody has estimated it
    assert misses_target(covariance, made) == expected


@pytest.mark.parametrize(
    ("block", "more", "words"),
    [
        ("{when: target}", [], "needs at least one"),
        ("{when: group, without: [T1]}", [], "no jet 'T1'"),
        ("{when: target, targets: {weight: 1%}}", [], "no such quantity"),
        ("{when: group, limits: {speed: 1 m/s}}", [], "no such limit"),
        ("{when: group}", ["estimation.filter=thesis"], "goes with estimation.filter: joint"),
        ("{when: group}", ["maneuver=[]", "autopilot.engaged=false"], "needs an autopilot"),
    ],
)
def test_what_cannot_be_asked_is_one_message(block: str, more: list[str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        settings(block, *more)
