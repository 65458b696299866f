"""Test firings in flight: questions that make it fire, what it fires, and when it rests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from systems_probe import inputs, outputs

from massprop_drake import load_scenario
from massprop_drake.errors import InputError
from massprop_drake.inputs import crafts
from massprop_drake.maths.maneuver.onboard import FiringTest, missed, suspects
from massprop_drake.systems.autopilot.firing_test import FiringTestSystem

N = 12


def settings(**block: Any) -> FiringTest:
    whole = {"when": "group", "patience_s": 0.3, **block}
    made = crafts.firing_test(
        load_scenario("small_satellite_maneuver", ["estimation.filter=joint", f"autopilot.test_firing={whole}"])
    )
    assert made is not None
    return made


def known(dut: FiringTestSystem, context: Any, share: float = 0.01) -> None:
    """Estimates at their nominal values, known to a share."""
    nominal = settings().craft.properties
    size = share * np.append(np.abs(nominal[:3]), np.full(3, np.abs(nominal[:3]).mean()))
    deviation = np.concatenate((size, np.full(3, 0.01), [share * nominal[9]]))
    dut.GetInputPort("estimate").FixValue(context, nominal)
    dut.GetInputPort("covariance").FixValue(context, np.diag(deviation**2).ravel())
    dut.GetInputPort("gyro").FixValue(context, np.zeros(3))


def probabilities(of: dict[int, float]) -> np.ndarray:
    found = np.zeros(N + 2)
    found[list(of)] = list(of.values())
    found[N] = 1.0 - found[:N].sum()
    return found


def stepped(dut: FiringTestSystem, simulator: Simulator, samples: int) -> np.ndarray:
    """Commands of the coming samples, shape (samples, n_jets)."""
    found = []
    for _ in range(samples):
        simulator.AdvanceTo(round(simulator.get_context().get_time() + 0.1, 9))
        found.append(dut.GetOutputPort("command").Eval(simulator.get_context()).copy())
    return np.array(found)


def test_topology() -> None:
    dut = FiringTestSystem(settings())
    assert inputs(dut) == {"estimate": 10, "covariance": 100, "fault_probability": N + 2, "gyro": 3}
    assert outputs(dut) == {"command": N, "tests": 1}


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        ({}, ()),
        ({8: 1.0}, ()),  # it is known which
        ({8: 0.2, 11: 0.2}, ()),  # it may be that nothing has failed
        ({8: 0.6, 11: 0.4}, (8, 11)),
        ({8: 0.88}, (8,)),  # has it?
        ({8: 0.6, 11: 0.37, 2: 0.02, 5: 0.001}, (2, 8, 11)),
    ],
)
def test_a_question_is_which_jet_has_failed_or_whether(of: dict[int, float], expected: tuple[int, ...]) -> None:
    assert suspects(probabilities(of), settings()) == expected


def test_it_fires_once_when_a_question_has_stood_for_a_while() -> None:
    made = settings()
    dut = FiringTestSystem(made)
    context = dut.CreateDefaultContext()
    known(dut, context)
    simulator = Simulator(dut, context)
    port = dut.GetInputPort("fault_probability")
    port.FixValue(context, probabilities({}))
    assert not stepped(dut, simulator, 6).any()
    port.FixValue(context, probabilities({8: 0.5, 9: 0.5}))
    assert not stepped(dut, simulator, 3).any()
    fired = stepped(dut, simulator, 20)
    assert fired.any()
    assert fired[:, [8, 9]].any(axis=0).all()  # a loss shows only where each fires
    assert dut.GetOutputPort("tests").Eval(context)[0] >= 1.0
    port.FixValue(context, probabilities({8: 1.0}))
    stepped(dut, simulator, 20)
    assert not stepped(dut, simulator, 20).any()


def test_a_target_that_is_known_asks_for_nothing() -> None:
    made = settings(when="target", targets={"mass": "1%"})
    nominal = made.craft.properties
    covariance = np.full((10, 10), np.nan)
    covariance[9, 9] = (0.009 * nominal[9]) ** 2
    assert not missed(covariance, made)
    covariance[9, 9] = (0.02 * nominal[9]) ** 2
    assert missed(covariance, made)
    covariance[9, 9] = np.nan  # nobody has estimated it
    assert missed(covariance, made)


@pytest.mark.parametrize(
    ("block", "words"),
    [
        ("{when: target}", "needs at least one"),
        ("{when: group, targets: {mass: 1%}}", "targets go with when: target"),
        ("{when: group, without: [T1]}", "no jet 'T1'"),
        ("{when: target, targets: {weight: 1%}}", "no such quantity"),
        ("{when: group, limits: {speed: 1 m/s}}", "no such limit"),
    ],
)
def test_what_cannot_be_asked_is_one_message(block: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        crafts.firing_test(
            load_scenario("small_satellite_maneuver", ["estimation.filter=joint", f"autopilot.test_firing={block}"])
        )
    assert words in str(caught.value)


def test_it_needs_the_joint_filter_and_an_autopilot() -> None:
    thesis = load_scenario("small_satellite_maneuver", ["autopilot.test_firing={when: target, targets: {mass: 1%}}"])
    with pytest.raises(InputError, match=r"goes with estimation\.filter: joint"):
        crafts.firing_test(thesis)
    pulse = ["maneuver=[]", "jet_schedule=[{jet: ZP1, start_s: 1, end_s: 2}]", "autopilot.test_firing={when: group}"]
    with pytest.raises(InputError, match="does not go with jet_schedule"):
        load_scenario("small_satellite_maneuver", pulse)
    with pytest.raises(InputError, match="needs an autopilot"):
        load_scenario(
            "small_satellite_maneuver",
            ["maneuver=[]", "autopilot={engaged: false, test_firing: {when: group}}"],
        )
