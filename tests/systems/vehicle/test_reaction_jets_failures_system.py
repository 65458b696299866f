"""Failed jets in the plant: what the reaction jets deliver then, stepped and continuous."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance

from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind
from massprop_drake.systems.vehicle.reaction_jets_system import ReactionJets

# three jets of 5, 2 and 4 lbf; torque, force and mass flow
WRENCHES = np.array(
    [
        [1.0, 2.0, -3.0, 3.0, 4.0, 0.0, 0.02],
        [0.0, -7.0, 0.5, 0.0, 0.0, -2.0, 0.01],
        [4.0, 0.0, 1.0, 0.0, -4.0, 0.0, 0.03],
    ]
)
FORCES = np.array([5.0, 2.0, 4.0])
NONE = [0.0, 0.0, 0.0]
TAU = 0.04  # s; half a period: exp(-2) is left after one
LEFT = math.exp(-2.0)
MEAN = 0.5 * (1.0 - LEFT)  # of a difference, on average over a period
ROUNDING = 1e-11  # see test_failures: the share of a sample that a failure covers


def make(
    *failures: Failure, constants: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 0
) -> tuple[ReactionJets, Any]:
    dut = ReactionJets(
        wrenches=WRENCHES,
        time_constants_s=np.array(constants),
        period_s=PERIOD_S,
        failures=failures,
        seed=seed,
    )
    context = dut.CreateDefaultContext()
    command(dut, context, NONE, NONE)
    return dut, context


def command(dut: ReactionJets, context: Any, coming: list[float], held: list[float]) -> None:
    dut.GetInputPort("command").FixValue(context, coming)
    dut.GetInputPort("held_command").FixValue(context, held)


def out(dut: ReactionJets, context: Any, name: str) -> np.ndarray:
    return dut.GetOutputPort(name).Eval(context)


def fly(dut: ReactionJets, context: Any, commands: list[list[float]]) -> np.ndarray:
    """Mean thrust over each sample of a schedule, as the closed loop wires it, shape (samples, 3)."""
    thrust = []
    held = NONE
    for coming in commands:
        command(dut, context, coming, held)
        thrust.append(out(dut, context, "thrust"))
        advance(dut, context)
        held = coming
        command(dut, context, coming, held)
    return np.array(thrust)


def test_a_stuck_jet_pushes_from_its_onset_on() -> None:
    dut, context = make(Failure(0, FailureKind.STUCK_ON, 2 * PERIOD_S, math.inf))
    thrust = fly(dut, context, [NONE] * 4)
    np.testing.assert_allclose(thrust[:, 0], [0.0, 0.0, 5.0, 5.0], atol=ROUNDING)
    assert not thrust[:, 1:].any()


def test_a_failure_that_ends() -> None:
    dut, context = make(Failure(1, FailureKind.STUCK_OFF, PERIOD_S, 3 * PERIOD_S))
    thrust = fly(dut, context, [[0.0, 1.0, 0.0]] * 5)
    np.testing.assert_allclose(thrust[:, 1], [2.0, 0.0, 0.0, 2.0, 2.0], atol=ROUNDING)


def test_a_leak_pushes_besides_what_is_commanded_and_uses_propellant() -> None:
    # half a lbf of a jet of 5 lbf
    dut, context = make(Failure(0, FailureKind.LEAK, 0.0, math.inf, amount=0.5))
    command(dut, context, [1.0, 0.0, 0.0], NONE)
    np.testing.assert_allclose(out(dut, context, "wrench_profile"), 1.1 * WRENCHES[0], rtol=1e-12)
    command(dut, context, NONE, NONE)
    np.testing.assert_allclose(out(dut, context, "wrench_profile"), 0.1 * WRENCHES[0], rtol=1e-12)
    np.testing.assert_allclose(out(dut, context, "thrust"), [0.5, 0.0, 0.0], rtol=1e-12)


def test_a_leak_is_of_its_force_whatever_the_jet_s_thrust() -> None:
    dut, context = make(Failure(0, FailureKind.LEAK, 0.0, math.inf, amount=0.5))
    dut.parameters.set(context, thrust_factor_0=0.8)
    np.testing.assert_allclose(out(dut, context, "thrust"), [0.5, 0.0, 0.0], rtol=1e-12)


def test_a_degraded_jet_loses_torque_force_and_flow_alike() -> None:
    dut, context = make(Failure(2, FailureKind.DEGRADED, 0.0, math.inf, amount=0.25))
    command(dut, context, [0.0, 0.0, 1.0], NONE)
    np.testing.assert_allclose(out(dut, context, "wrench_profile"), 0.25 * WRENCHES[2], rtol=1e-12)


def test_an_onset_within_a_sample_gives_its_part_of_the_impulse() -> None:
    dut, context = make(Failure(0, FailureKind.STUCK_ON, PERIOD_S + 0.02, math.inf))
    np.testing.assert_allclose(fly(dut, context, [NONE] * 3)[:, 0], [0.0, 5.0 * 0.75, 5.0], atol=1e-10)


def test_a_stuck_jet_builds_its_thrust_up() -> None:
    # mean over the first sample 1 - (1 - exp(-2)) / 2; the second begins exp(-2) short of full thrust
    dut, context = make(Failure(0, FailureKind.STUCK_ON, PERIOD_S, math.inf), constants=(TAU, 0.0, 0.0))
    expected = [0.0, 1.0 - MEAN, 1.0 - LEFT * MEAN, 1.0 - LEFT**2 * MEAN]
    np.testing.assert_allclose(fly(dut, context, [NONE] * 4)[:, 0], 5.0 * np.array(expected), atol=1e-10)


def test_a_jet_that_sticks_off_while_it_fires_tails_off() -> None:
    dut, context = make(Failure(1, FailureKind.STUCK_OFF, 2 * PERIOD_S, math.inf), constants=(0.0, TAU, 0.0))
    level = 1.0 - LEFT**2  # after two samples of building up
    expected = [1.0 - MEAN, 1.0 - LEFT * MEAN, level * MEAN, level * LEFT * MEAN]
    thrust = fly(dut, context, [[0.0, 1.0, 0.0]] * 4)[:, 1]
    np.testing.assert_allclose(thrust, 2.0 * np.array(expected), atol=1e-10)


FAILURES = (
    Failure(0, FailureKind.STUCK_ON, 1.5 * PERIOD_S, 4.25 * PERIOD_S),
    Failure(1, FailureKind.LEAK, PERIOD_S, math.inf, amount=0.2),
    Failure(2, FailureKind.INTERMITTENT, 0.0, math.inf, amount=0.5, probability=0.5, stream="failure 2 of C"),
)
SCHEDULE = [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.5, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize("constants", [(0.0, 0.0, 0.0), (TAU, 0.0, 0.015)])
def test_the_continuous_wrench_is_the_stepped_profile_at_every_instant(constants: tuple[float, float, float]) -> None:
    # the profile of the sample at t_k, decided before the update, against the wrench after it
    dut, context = make(*FAILURES, constants=constants)
    lags = np.array(dut.lag_time_constants_s)
    held = NONE
    for number, coming in enumerate(SCHEDULE):
        command(dut, context, coming, held)
        profile = out(dut, context, "wrench_profile").reshape(-1, 7)
        advance(dut, context)
        command(dut, context, NONE, coming)  # from here on only what is held may count
        for elapsed in (0.01, 0.04, 0.0799):
            context.SetTime(number * PERIOD_S + elapsed)
            expected = profile[0] + np.exp(-elapsed / lags) @ profile[1:]
            np.testing.assert_allclose(out(dut, context, "wrench"), expected, atol=1e-11)
        context.SetTime((number + 1) * PERIOD_S)
        held = coming


def test_the_mean_thrust_is_the_profiles_mean() -> None:
    # the force in the profile, integrated over the sample, is the logged thrust along each jet
    dut, context = make(*FAILURES, constants=(TAU, TAU, TAU))
    directions = WRENCHES[:, 3:6] / FORCES[:, None]
    held = NONE
    for coming in SCHEDULE:
        command(dut, context, coming, held)
        steady, dying = out(dut, context, "wrench_profile").reshape(-1, 7)
        force = (steady + MEAN * dying)[3:6]
        np.testing.assert_allclose(out(dut, context, "thrust") @ directions, force, atol=1e-11)
        advance(dut, context)
        command(dut, context, coming, coming)
        held = coming


def test_an_intermittent_jet_fails_by_the_runs_seed_alone() -> None:
    def record(seed: int) -> list[float]:
        dut, context = make(FAILURES[2], seed=seed)
        return fly(dut, context, [[0.0, 0.0, 1.0]] * 40)[:, 2].tolist()

    first = record(seed=1)
    np.testing.assert_allclose(sorted(set(np.round(first, 9))), [2.0, 4.0])
    assert first == record(seed=1)
    # two independent records of 40 samples agree throughout with a probability of 1e-12
    assert first != record(seed=2)


def close(dut: ReactionJets, context: Any, coming: list[float], held: list[float]) -> None:
    dut.GetInputPort("closed").FixValue(context, coming)
    dut.GetInputPort("held_closed").FixValue(context, held)


def test_a_closed_manifold_stops_whatever_its_jets_do() -> None:
    failures = (
        Failure(0, FailureKind.STUCK_ON, 0.0, math.inf),
        Failure(1, FailureKind.LEAK, 0.0, math.inf, amount=0.2),
    )
    dut, context = make(*failures)
    close(dut, context, [1.0, 1.0, 0.0], NONE)
    command(dut, context, [1.0, 1.0, 1.0], NONE)
    np.testing.assert_allclose(out(dut, context, "thrust"), [0.0, 0.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(out(dut, context, "wrench_profile"), WRENCHES[2], atol=1e-12)


def test_thrust_tails_off_when_the_manifold_closes() -> None:
    # full thrust for long, then the manifold closes: the mean of exp(-s / tau), then exp(-2) of it
    dut, context = make(Failure(0, FailureKind.STUCK_ON, 0.0, math.inf), constants=(TAU, 0.0, 0.0))
    close(dut, context, NONE, NONE)
    fly(dut, context, [NONE] * 20)  # exp(-40) short of full thrust
    close(dut, context, [1.0, 0.0, 0.0], NONE)
    command(dut, context, NONE, NONE)
    np.testing.assert_allclose(out(dut, context, "thrust")[0], 5.0 * MEAN, rtol=1e-10)
    # at this instant the valve's past still counts: full thrust
    np.testing.assert_allclose(out(dut, context, "wrench"), WRENCHES[0], rtol=1e-10)
    advance(dut, context)
    close(dut, context, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(out(dut, context, "thrust")[0], 5.0 * LEFT * MEAN, rtol=1e-10)
    context.SetTime(20 * PERIOD_S + 0.04)
    np.testing.assert_allclose(out(dut, context, "wrench"), math.exp(-1.0) * WRENCHES[0], rtol=1e-10)
