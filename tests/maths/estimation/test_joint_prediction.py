"""The joint prediction: against differences, the body's equations of motion, and sampling."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import (
    INVERSE,
    PERIOD,
    TRUTH,
    central_differences,
    read_as,
    small_params,
    some_sample,
    some_state,
    unread,
)
from scipy.integrate import solve_ivp

from massprop_drake.maths.estimation.joint.forcing import Drive
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict, propagate_root
from massprop_drake.maths.estimation.joint.rate_coupling import RateRead, largest_coupling, turning_matrix
from massprop_drake.maths.estimation.joint.thrust_scale import separate_scale
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle import rigid_body

PARAMS = small_params(second_order=False)
PLACES = PARAMS.places
SAMPLE = some_sample(PARAMS, outside=np.array([0.01, -0.02, 0.03, 0.02, 0.01, -0.03]))
ALONE = some_sample(PARAMS)  # without known outside forces
STILL = some_sample(PARAMS, commands=np.zeros((1, 6)))
UNREAD = unread(PARAMS)


def predicted(
    state: JointState, params: JointParams = PARAMS, read: RateRead = UNREAD, sample: JointSample = SAMPLE
) -> Prediction:
    return predict(state, estimate_forces(state, sample, params), read, params)


def straight(state: JointState, sample: JointSample = SAMPLE) -> Drive:
    """Impulses whose bows are left out, as their derivatives are."""
    acting = estimate_forces(state, sample, PARAMS)
    return acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))


def moved(state: JointState, **parts: Array) -> JointState:
    """The state with some elements of its estimate, `from_n` meaning from that element on."""
    mean = state.mean.copy()
    for name, value in parts.items():
        mean[int(name.removeprefix("from_")) :][: np.size(value)] = value
    return state._replace(mean=mean)


def test_the_rate_at_the_end_is_the_mean_of_prediction_and_reading_by_their_variances() -> None:
    state = some_state(PARAMS)
    alone = predicted(state)
    spread = np.sum(propagate_root(state.root, alone, PARAMS)[10:13] ** 2, axis=1)
    read, variance = np.array([0.3, -0.2, np.nan]), np.array([spread[0], 4.0 * spread[1], np.inf])
    found = predicted(state, read=RateRead(read, np.zeros((3, PLACES.size)), variance))
    mean = (alone.end / spread + np.nan_to_num(read) / variance) / (1.0 / spread + 1.0 / variance)
    np.testing.assert_allclose(found.end, mean, atol=2e-3)  # but for the coupling, which that rate changes
    assert np.abs(found.end - alone.end)[:2].min() > 0.02


@pytest.mark.parametrize("read", [1.0, 0.6, 0.0])
def test_jacobian_agrees_with_central_differences(read: float) -> None:
    """Of the rate, c of both accelerometers with what the interval has turned them by, and mu."""
    state = some_state(PARAMS)
    rate_read = read_as(predicted(state).end + np.array([3e-6, -1e-6, 2e-6]), PARAMS) if read else UNREAD
    if 0.0 < read < 1.0:  # the reading corrects the rate by about that share
        spread = np.sum(state.root[10:13] ** 2, axis=1)
        rate_read = rate_read._replace(variance=spread * (1.0 / read - 1.0))
    arms = PARAMS.accelerometer_positions - state.mean[6:9]  # of what is turned: in the outputs' derivative

    def after(mean: Array) -> Array:
        at = state._replace(mean=mean)
        found = predict(at, straight(at), rate_read, PARAMS)
        both = found.mean[13:19].reshape(2, 3) + arms @ turning_matrix(np.zeros(3), np.zeros(3), found.spin).T
        return np.concatenate([found.mean[10:13], both.ravel(), found.mean[9:10]])

    found = central_differences(after, state.mean, 1e-5 * np.maximum(np.abs(state.mean), 1e-2))
    # what flows by thrust errors and forces is left out of mu's own row and, of second order, out of c's
    found[9, PLACES.thrust :] = 0.0
    prediction = predict(state, straight(state), rate_read, PARAMS)
    expected = transition(prediction)[[*range(10, 19), 9]]
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    atol = 2e-4 if 0.0 < read < 1.0 else 1e-4  # where both count, the share depends on what is predicted
    np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-4, atol=atol)
    assert np.abs(expected[:3, :6] @ TRUTH[:6]).min() > 0.0


def transition(prediction: Prediction) -> Array:
    """Derivative of the state after an interval by that before it."""
    return propagate_root(np.eye(PLACES.size), prediction, PARAMS)[:, : PLACES.size]


def test_covariance_goes_over_by_the_jacobian_and_noise() -> None:
    params = small_params(rate_walk=1e-6, velocity_walk=1e-4, repeatability=np.full(6, 1e-3), tank_fraction=0.1)
    state = some_state(params)
    prediction = predicted(state, params)
    spread, moves = np.zeros((PLACES.size, 6)), np.eye(PLACES.size)[:, :10]
    spread[10:13, :3], spread[13:16, 3:], spread[16:19, 3:] = np.eye(3), np.eye(3), np.eye(3)
    spread[13:16, :3], spread[16:19, :3] = prediction.apart[1]
    # what accelerometers have gathered stays as it was
    moves[13:16, 6:9] = moves[16:19, 6:9] = turning_matrix(state.mean[10:13], state.reference, state.spin)
    over = transition(prediction) @ state.root
    expected = over @ over.T + spread @ prediction.noise @ spread.T + moves @ np.diag(prediction.drift) @ moves.T
    root, scale = propagate_root(state.root, prediction, params), np.sqrt(np.diag(expected))
    np.testing.assert_allclose(root @ root.T / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-12)
    used = float(estimate_forces(state, SAMPLE, params).firing.amount @ params.flows)
    assert prediction.drift[6] == pytest.approx(0.1**2 * 0.01 * TRUTH[9] * used, rel=0.1)
    assert prediction.noise[0, 0] > (1e-6) ** 2 * PERIOD
    walk, still = (predicted(state, params._replace(rate_walk=0.0, velocity_walk=walk)) for walk in (1e-2, 0.0))
    added = np.diag([0.0, 0.0, 0.0, 1e-4, 1e-4, 1e-4]) * PERIOD
    np.testing.assert_allclose(walk.noise - still.noise, added, rtol=1e-9, atol=1e-15)


def exact_state(rate: list[float], levels: float) -> JointState:
    """A state at the truth: no thrust error, no failure, jets half built up or shut."""
    state = moved(some_state(PARAMS), from_13=np.zeros(PLACES.size - 13), from_10=np.array(rate))
    return state._replace(level=levels * state.level)


def test_prediction_at_the_truth_is_the_motion() -> None:
    """Rate, spin integral and c by the equations of motion; the bow takes nearly all that a straight line leaves."""
    state, factor = exact_state([0.5, -0.4, 0.3], 1.0), 3.0
    body = rigid_body.initial_state(10.0)
    body[rigid_body.RATE] = state.mean[10:13]
    seven, off = np.column_stack([factor * PARAMS.wrenches, np.zeros(6)]), state.level - SAMPLE.commands[0]
    transient = np.array([off[part] @ seven[part] for part in (slice(3), slice(3, 6))])
    whole = rigid_body.motion_constants(MassProperties(10.0, TRUTH[6:9], np.linalg.inv(INVERSE)))
    after = rigid_body.step(body, SAMPLE.commands[0] @ seven, transient, (0.015, 0.03), PERIOD, whole)
    rate, spin = after[rigid_body.RATE], after[rigid_body.SPIN_INTEGRAL]
    turned = np.cross(rate - state.mean[10:13], TRUTH[6:9]) + turning_matrix(rate, rate, spin) @ TRUTH[6:9]
    gathered = after[rigid_body.ORIGIN_VELOCITY] + turned

    params = PARAMS._replace(wrenches=factor * PARAMS.wrenches, flows=np.zeros(6))
    bowed = estimate_forces(state, ALONE, params)
    lines = bowed._replace(firing=bowed.firing._replace(bow=np.zeros((3, 6))))
    first, second = (predict(state, acting, read_as(rate, params), params) for acting in (lines, bowed))
    np.testing.assert_allclose(second.mean[13:16], gathered, rtol=2e-2)
    errors, spins = (
        [np.abs(each).max() for each in part]
        for part in zip(*((found.mean[10:13] - rate, found.spin - spin) for found in (first, second)), strict=True)
    )
    assert errors[0] > 1e-4 * np.abs(rate - state.mean[10:13]).max()
    assert errors[1] < 0.01 * errors[0]
    assert spins[1] < 0.01 * spins[0]


def test_a_vehicle_that_turns_fast_turns_on_as_torque_free_motion_has_it() -> None:
    """Without a reading: what a few rounds for the rate at the end leave would gather, sample by sample."""
    start, inertia = np.array([0.25, -0.2, 0.15]), np.linalg.inv(INVERSE)
    state = exact_state(start.tolist(), 0.0)
    course = solve_ivp(lambda _, w: INVERSE @ np.cross(inertia @ w, w), (0.0, PERIOD), start, rtol=1e-12, atol=1e-14)
    rate = course.y[:, -1]
    turned_by = np.abs(rate - start).max()
    assert turned_by > 1e-3
    found = predicted(state, sample=STILL)
    np.testing.assert_allclose(found.mean[10:13], rate, rtol=0.0, atol=1e-8 * turned_by)
    slope = central_differences(
        lambda at: predicted(moved(state, from_10=at), sample=STILL).mean[10:13], start, np.full(3, 1e-4)
    )
    np.testing.assert_allclose(np.eye(3) + found.rate_rows[:, 10:13], slope, rtol=0.0, atol=1e-6)


def test_a_force_in_a_slot_is_that_much_thrust() -> None:
    """A jet that leaks a tenth gives what it would if commanded a tenth; one that lacks a third, two thirds."""
    params = small_params(time_constants_s=np.zeros(6), second_order=False)
    none = moved(some_state(params), from_13=np.zeros(PLACES.size - 13))._replace(level=np.zeros(6))

    def after(force: float, sign: float, command: float) -> Array:
        commands = command * np.eye(6)[1:2]
        state = none._replace(slot_sign=np.array([sign, -1.0]))
        state = moved(state, **{f"from_{PLACES.force}": np.array([force * params.thrusts[1]])})
        return predicted(state, params, sample=some_sample(params, commands=commands)).mean[9:19]

    np.testing.assert_allclose(after(0.1, 1.0, 0.0), after(0.0, 1.0, 0.1), rtol=1e-12)
    np.testing.assert_allclose(after(1.0 / 3.0, -1.0, 1.0), after(0.0, -1.0, 2.0 / 3.0), rtol=1e-12)


def test_coupling_that_is_not_known_yet_is_noise_that_bounds_it_for_every_body() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        spread = rng.standard_normal((3, 3)) * np.exp(2.0 * rng.standard_normal(3))
        second = spread @ spread.T
        inertia, rate = np.trace(second) * np.eye(3) - second, 0.1 * rng.standard_normal(3)
        change = np.linalg.solve(inertia, np.cross(rate, inertia @ rate)) * PERIOD
        assert np.linalg.norm(change) <= largest_coupling(rate, np.zeros(3), PERIOD)
    known = some_state(PARAMS)
    unknown = known._replace(root=known.root.copy())
    unknown.root[0, 0] = 10.0 * known.mean[0]
    without, covered = (predicted(state, sample=STILL) for state in (known, unknown))
    assert (without.coupled, covered.coupled) == (True, False)
    assert without.noise[0, 0] < covered.noise[0, 0]
    rate = known.mean[10:13]
    assert np.sqrt(covered.noise[0, 0]) >= float(rate @ rate) * PERIOD * (1.0 - 1e-12)


def test_the_common_scale_of_fired_jets_is_a_state_of_its_own_and_nothing_else_changes() -> None:
    """Covariances of inertia, mass, thrusts and forces stay; the scale is the mean error of fired jets."""
    state = some_state(PARAMS)
    state.root[PLACES.scale] = 0.0
    fired = np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    split = separate_scale(state, 0.01 * fired, PARAMS)
    np.testing.assert_array_equal(split.mean, state.mean)
    back, sigma = np.eye(PLACES.size), PARAMS.thrust_sigma
    back[PLACES.thrust : PLACES.thrust + 6, PLACES.scale] = 1.0
    for index in (*range(6), 9):
        back[index, PLACES.scale] = -sigma * state.mean[index]
    for index in range(PLACES.force, PLACES.force + PLACES.n_force):
        back[index, PLACES.scale] = sigma * state.mean[index]
    back[PLACES.scale] = 0.0
    size = np.linalg.norm(state.root, axis=1) + 1e-12
    before, after = state.root @ state.root.T, split.root @ split.root.T
    np.testing.assert_allclose((back @ after @ back.T - before) / np.outer(size, size), 0.0, atol=1e-12)
    of_fired = fired @ before[PLACES.thrust : PLACES.thrust + 6, PLACES.thrust : PLACES.thrust + 6] @ fired / 9.0
    assert after[PLACES.scale, PLACES.scale] == pytest.approx(of_fired)
