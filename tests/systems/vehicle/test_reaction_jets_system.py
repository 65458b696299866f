"""The reaction jets: thrust and wrench, instantaneous and with a lag."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.systems.vehicle.reaction_jets_system import ReactionJets

# two jets: 5 lbf along (3, 4, 0) / 5, and 2 lbf along -z; torque, force and mass flow
WRENCHES = np.array([[1.0, 2.0, -3.0, 3.0, 4.0, 0.0, 0.02], [0.0, -7.0, 0.5, 0.0, 0.0, -2.0, 0.01]])
FORCES = np.array([5.0, 2.0])
TAU = 0.04  # s; half a period: exp(-2) is left after one


def _dut(time_constants_s: tuple[float, float]) -> tuple[ReactionJets, Any]:
    dut = ReactionJets(wrenches=WRENCHES, time_constants_s=np.array(time_constants_s), period_s=PERIOD_S)
    context = dut.CreateDefaultContext()
    _command(dut, context, [0.0, 0.0], [0.0, 0.0])
    return dut, context


def _command(dut: ReactionJets, context: Any, coming: list[float], held: list[float]) -> None:
    dut.GetInputPort("command").FixValue(context, coming)
    dut.GetInputPort("held_command").FixValue(context, held)


def _out(dut: ReactionJets, context: Any, name: str) -> np.ndarray:
    return dut.GetOutputPort(name).Eval(context)


@pytest.mark.parametrize(
    ("constants", "classes"), [((0.0, 0.0), 0), ((TAU, TAU), 1), ((TAU, 0.0), 1), ((TAU, 0.01), 2)]
)
def test_topology(constants: tuple[float, float], classes: int) -> None:
    dut, _ = _dut(constants)
    assert inputs(dut) == {"command": 2, "held_command": 2, "closed": 2, "held_closed": 2, "seed": 1}
    assert outputs(dut) == {"thrust": 2, "wrench": 7, "wrench_profile": 7 * (1 + classes)}
    # wrench feeds the continuous plant: with `command` in it, sensors and autopilot would close a loop
    assert feedthrough(dut) == {
        "thrust": {"command", "held_command", "closed", "held_closed", "seed"},
        "wrench": {"held_command", "held_closed", "seed"},
        "wrench_profile": {"command", "held_command", "closed", "held_closed", "seed"},
    }
    assert len(dut.lag_time_constants_s) == classes


def test_instantaneous_thrust_is_the_command_of_the_coming_sample() -> None:
    dut, context = _dut((0.0, 0.0))
    _command(dut, context, [1.0, 0.5], [0.0, 1.0])
    np.testing.assert_allclose(_out(dut, context, "thrust"), [5.0, 1.0], rtol=1e-15)
    # one row: no part that dies away
    expected = [1.0, 2.0 - 3.5, -3.0 + 0.25, 3.0, 4.0, -1.0, 0.025]
    np.testing.assert_allclose(_out(dut, context, "wrench_profile"), expected, rtol=1e-15)


def test_the_instantaneous_wrench_is_that_of_the_held_command() -> None:
    dut, context = _dut((0.0, 0.0))
    _command(dut, context, [1.0, 0.5], [0.0, 1.0])
    np.testing.assert_allclose(_out(dut, context, "wrench"), WRENCHES[1], rtol=1e-15)


def test_thrust_builds_up_over_a_sample() -> None:
    # the mean of 1 - exp(-s / tau) over one period T = 2 tau is 1 - (1 - exp(-2)) / 2
    dut, context = _dut((TAU, 0.0))
    _command(dut, context, [1.0, 1.0], [0.0, 0.0])
    mean = 1.0 - 0.5 * (1.0 - math.exp(-2.0))
    np.testing.assert_allclose(_out(dut, context, "thrust"), [5.0 * mean, 2.0], rtol=1e-14)


def test_the_profile_is_what_the_sample_tends_to_and_what_dies_away() -> None:
    dut, context = _dut((TAU, 0.01))
    assert dut.lag_time_constants_s == (0.01, TAU)
    # first sample: both from nothing toward 1 and 0.5
    _command(dut, context, [1.0, 0.5], [0.0, 0.0])
    steady, fast, slow = _out(dut, context, "wrench_profile").reshape(3, 7)
    np.testing.assert_allclose(steady, WRENCHES[0] + 0.5 * WRENCHES[1], rtol=1e-15)
    np.testing.assert_allclose(fast, -0.5 * WRENCHES[1], rtol=1e-15)
    np.testing.assert_allclose(slow, -WRENCHES[0], rtol=1e-15)


def test_the_level_goes_on_from_where_the_last_sample_left_it() -> None:
    dut, context = _dut((TAU, TAU))
    _command(dut, context, [1.0, 1.0], [0.0, 0.0])
    advance(dut, context)
    # at the second sample the held command has acted for one period: level 1 - exp(-2); now jet 2 goes off
    _command(dut, context, [1.0, 0.0], [1.0, 1.0])
    level = 1.0 - math.exp(-2.0)
    steady, dying = _out(dut, context, "wrench_profile").reshape(2, 7)
    np.testing.assert_allclose(steady, WRENCHES[0], rtol=1e-15)
    np.testing.assert_allclose(dying, (level - 1.0) * WRENCHES[0] + level * WRENCHES[1], rtol=1e-13)
    # mean over the sample: target + (level - target) (1 - exp(-2)) / 2
    half = 0.5 * (1.0 - math.exp(-2.0))
    np.testing.assert_allclose(
        _out(dut, context, "thrust"), [5.0 * (1.0 + (level - 1.0) * half), 2.0 * level * half], rtol=1e-13
    )


def test_the_wrench_follows_the_lag_between_samples() -> None:
    dut, context = _dut((TAU, TAU))
    _command(dut, context, [1.0, 1.0], [0.0, 0.0])
    advance(dut, context)  # the update at 0; the held command is now that of [0, T)
    _command(dut, context, [1.0, 1.0], [1.0, 1.0])
    for elapsed in (0.0, 0.3 * TAU, TAU, PERIOD_S):
        context.SetTime(elapsed)
        level = 1.0 - math.exp(-elapsed / TAU)
        np.testing.assert_allclose(_out(dut, context, "wrench"), level * WRENCHES.sum(axis=0), rtol=1e-13, atol=1e-16)


def test_wrench_profile_and_wrench_agree_over_a_sample() -> None:
    """What the stepped plant is told and what the continuous plant sees are the same thrust."""
    dut, context = _dut((TAU, 0.01))
    _command(dut, context, [1.0, 0.0], [0.0, 0.0])
    advance(dut, context)
    _command(dut, context, [0.0, 1.0], [1.0, 0.0])
    rows = _out(dut, context, "wrench_profile").reshape(3, 7)
    advance(dut, context)
    _command(dut, context, [0.0, 0.0], [0.0, 1.0])
    for elapsed in (0.0, 0.01, 0.03, 0.0799):
        context.SetTime(PERIOD_S + elapsed)
        fast, slow = math.exp(-elapsed / 0.01), math.exp(-elapsed / TAU)
        np.testing.assert_allclose(
            _out(dut, context, "wrench"), rows[0] + rows[1] * fast + rows[2] * slow, rtol=1e-12, atol=1e-15
        )


def test_instantaneous_jets_remember_nothing() -> None:
    dut, context = _dut((0.0, 0.0))
    _command(dut, context, [1.0, 1.0], [1.0, 1.0])
    # neither state nor an update, so that `Linearize` finds the body's state alone
    assert dut.GetUniquePeriodicDiscreteUpdateAttribute() is None
    assert context.is_stateless()
