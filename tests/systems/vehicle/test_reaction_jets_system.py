"""The reaction jets: thrust and wrench, instantaneous and with a lag, of healthy and of failed jets."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems_probe import PERIOD_S, advance, feedthrough, give, inputs, output, outputs

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import split_sample
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind
from massprop_drake.systems import ReactionJets

# three jets of 5, 2 and 4 lbf
WRENCHES = np.array(
    [
        [1.0, 2.0, -3.0, 3.0, 4.0, 0.0, 0.02],
        [0.0, -7.0, 0.5, 0.0, 0.0, -2.0, 0.01],
        [4.0, 0.0, 1.0, 0.0, -4.0, 0.0, 0.03],
    ]
)
FORCES, NONE = np.array([5.0, 2.0, 4.0]), np.zeros(3)
TAU = 0.04  # s; half a period: exp(-2) is left after one
LEFT = math.exp(-2.0)
MEAN = 0.5 * (1.0 - LEFT)  # of a difference, on average over a period
ROUNDING = 1e-11  # the share of a sample that a failure covers is a difference of times


def jets(*failures: Failure, constants: tuple[float, ...] = (0.0, 0.0, 0.0), **given: Any) -> tuple[Any, Any]:
    dut = ReactionJets(
        wrenches=WRENCHES, time_constants_s=np.array(constants), period_s=PERIOD_S, failures=failures, **given
    )
    context = dut.CreateDefaultContext()
    give(dut, context, command=NONE, held_command=NONE)
    return dut, context


def fly(dut: Any, context: Any, commands: Any) -> Array:
    """Mean thrust over each sample of a schedule, as the closed loop wires it, shape (samples, 3)."""
    thrust = []
    for command in commands:
        thrust.append(output(dut, context, "thrust", command=command))
        advance(dut, context)
        give(dut, context, held_command=command)
    return np.array(thrust)


def failing(kind: FailureKind, jet: int, start: float = 0.0, end: float = math.inf, **values: Any) -> Failure:
    """With times in samples."""
    return Failure(jet, kind, start * PERIOD_S, end * PERIOD_S, **values)


@pytest.mark.parametrize(
    ("constants", "classes"), [((0, 0, 0), ()), ((TAU, TAU, 0), (TAU,)), ((TAU, 0.01, 0), (0.01, TAU))]
)
def test_topology(constants: tuple[float, ...], classes: tuple[float, ...]) -> None:
    dut, context = jets(constants=constants)
    assert inputs(dut) == {"command": 3, "held_command": 3, "closed": 3, "held_closed": 3, "seed": 1}
    assert outputs(dut) == {"thrust": 3, "wrench": 7, "wrench_profile": 7 * (1 + len(classes))}
    # wrench feeds the continuous plant: with `command` in it, sensors and autopilot would close a loop
    held = {"held_command", "held_closed", "seed"}
    assert feedthrough(dut) == {"thrust": set(inputs(dut)), "wrench": held, "wrench_profile": set(inputs(dut))}
    assert dut.lag_time_constants_s == classes
    # without state, so that `Linearize` finds the body's alone
    assert context.is_stateless() == (not classes)


def test_instantaneous_thrust_is_the_command() -> None:
    dut, context = jets()
    give(dut, context, command=[1.0, 0.5, 0.0], held_command=[0.0, 1.0, 0.0])
    assert_allclose(output(dut, context, "thrust"), [5.0, 1.0, 0.0], rtol=1e-15)
    assert_allclose(output(dut, context, "wrench_profile"), [1.0, -1.5, -2.75, 3.0, 4.0, -1.0, 0.025], rtol=1e-15)
    assert_allclose(output(dut, context, "wrench"), WRENCHES[1], rtol=1e-15)
    # half the mean thrust uses half of its propellant
    tanks, context = jets(feeds=np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    give(tanks, context, command=[1.0, 0.5, 0.5])
    assert_allclose(output(tanks, context, "drained"), PERIOD_S * np.array([0.025, 0.015]), rtol=1e-14)


MANY = (
    failing(FailureKind.STUCK_ON, 0, 1.5, 4.25),
    failing(FailureKind.LEAK, 1, 1, amount=0.2),
    failing(FailureKind.INTERMITTENT, 2, amount=0.5, probability=0.5, stream="failure 2 of C"),
)
SCHEDULE = [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.5, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize("failures", [(), MANY])
@pytest.mark.parametrize("constants", [(0.0, 0.0, 0.0), (TAU, 0.0, 0.015)])
def test_stepped_and_continuous_plant_get_the_same_thrust(
    failures: tuple[Failure, ...], constants: tuple[float, ...]
) -> None:
    """The profile of a sample, decided before the update, against the wrench after it, and its mean against thrust."""
    dut, context = jets(*failures, constants=constants)
    lags, directions = np.array(dut.lag_time_constants_s), WRENCHES[:, 3:6] / FORCES[:, None]
    for number, command in enumerate(SCHEDULE):
        profile = output(dut, context, "wrench_profile", command=command).reshape(-1, 7)
        mean = profile[0] + lags / PERIOD_S * (1.0 - np.exp(-PERIOD_S / lags)) @ profile[1:]
        assert_allclose(output(dut, context, "thrust") @ directions, mean[3:6], atol=1e-11)
        advance(dut, context)
        give(dut, context, command=NONE, held_command=command)  # from here on only what is held may count
        for elapsed in (0.01, 0.04, 0.0799):
            context.SetTime(number * PERIOD_S + elapsed)
            expected = profile[0] + np.exp(-elapsed / lags) @ profile[1:]
            assert_allclose(output(dut, context, "wrench"), expected, atol=1e-11)
        context.SetTime((number + 1) * PERIOD_S)


def test_a_closed_manifold_stops_whatever_its_jets_do() -> None:
    """Thrust tails off then: the mean of exp(-s / tau), and exp(-2) of it in the sample after."""
    dut, context = jets(
        failing(FailureKind.STUCK_ON, 0), failing(FailureKind.LEAK, 1, amount=0.2), constants=(TAU, 0, 0)
    )
    give(dut, context, closed=NONE, held_closed=NONE)
    fly(dut, context, [NONE] * 20)  # exp(-40) short of full thrust
    give(dut, context, closed=[1.0, 1.0, 0.0], command=[1.0, 1.0, 1.0])
    assert_allclose(output(dut, context, "thrust"), [5.0 * MEAN, 0.0, 4.0], rtol=1e-10, atol=1e-12)
    # at this instant the valves' past still counts
    assert_allclose(output(dut, context, "wrench"), WRENCHES[0] + 0.1 * WRENCHES[1], rtol=1e-10, atol=1e-10)
    advance(dut, context)
    give(dut, context, held_closed=[1.0, 1.0, 0.0])
    assert_allclose(output(dut, context, "thrust")[0], 5.0 * LEFT * MEAN, rtol=1e-10)
    context.SetTime(20 * PERIOD_S + 0.04)
    assert_allclose(output(dut, context, "wrench"), math.exp(-1.0) * WRENCHES[0], rtol=1e-10, atol=1e-10)


def test_jets_that_open_within_a_sample_give_their_thrust_then() -> None:
    dut, context = jets(pieces=4)
    command, onset = np.array([0.5, 0.25, 1.0]), np.array([0.02, 0.02, 0.0])
    give(dut, context, held_command_onset=NONE, command_onset=onset, command=command)
    assert_allclose(output(dut, context, "thrust"), FORCES * command, rtol=1e-12)
    profile = output(dut, context, "wrench_profile").reshape(4, 8)
    lengths, levels = split_sample(command, onset, PERIOD_S, (0.0, PERIOD_S))
    assert_allclose(profile[:, 0], lengths, atol=1e-15)
    assert_allclose(profile[:, 1:], levels @ WRENCHES, atol=1e-12)
    advance(dut, context)
    give(dut, context, held_command=command, held_command_onset=onset)
    for elapsed, level in ((0.01, [0, 0, 1]), (0.03, [1, 1, 1]), (0.05, [1, 0, 1]), (0.07, [0, 0, 1])):
        context.SetTime(elapsed)
        assert_allclose(output(dut, context, "wrench"), level @ WRENCHES, atol=1e-12)
    for missing, read in (("command_onset", "thrust"), ("held_command_onset", "wrench")):
        dut, context = jets(pieces=4)
        give(dut, context, **{name: NONE for name in ("command_onset", "held_command_onset") if name != missing})
        with pytest.raises(RuntimeError, match=rf"\({missing}\) of System ::reaction_jets .* is not connected"):
            dut.GetOutputPort(read).Eval(context)


def test_parameters_and_a_floor_change_the_wrench() -> None:
    dut, context = jets(failing(FailureKind.LEAK, 2, amount=0.5))
    dut.parameters.set(context, thrust_factor_1=0.5, thrust_factor_2=0.8)
    give(dut, context, command=[1.0, 1.0, 0.0], held_command=[1.0, 1.0, 0.0])
    assert_allclose(output(dut, context, "thrust"), [5.0, 1.0, 0.5], rtol=1e-12)  # a leak is of its force
    for name in ("wrench_profile", "wrench"):
        expected = WRENCHES[0] + 0.5 * WRENCHES[1] + 0.125 * WRENCHES[2]
        assert_allclose(output(dut, context, name), expected, rtol=1e-12)
        advance(dut, context)
    floor, context = jets(planar=True)
    center = np.array([0.02, -0.03, 0.05])
    give(floor, context, command=[1.0, 1.0, 0.5], structure=[*np.ones(6), *center])
    wrench = output(floor, context, "wrench_profile")
    about_center = wrench[:3] - np.cross(center, wrench[3:6])
    assert_allclose([*about_center[:2], wrench[5]], 0.0, atol=1e-15)
    free = np.array([1.0, 1.0, 0.5]) @ WRENCHES
    assert_array_equal(wrench[[2, 3, 4, 6]], free[[2, 3, 4, 6]])
