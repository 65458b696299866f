"""A disturbance among the joint filter's states: against matrix exponentials, differences, and composition."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, central_differences, small_params, some_sample, some_state, unread
from scipy.linalg import expm

from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint.disturbance_states import DisturbanceParams, come, wandered
from massprop_drake.maths.estimation.joint.joint_cycle import begun, driven, initial, step
from massprop_drake.maths.estimation.joint.layout import RATE, VELOCITY, make_places
from massprop_drake.maths.estimation.joint.prediction import predict, propagated
from massprop_drake.maths.estimation.joint.sensitivity import carried, link
from massprop_drake.maths.linear_algebra import Array

ACCELERATIONS = np.diag([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03]) + 1e-4 * np.eye(6)[::-1]
DISTURBANCE = DisturbanceParams(np.ascontiguousarray(ACCELERATIONS[:, :5]), 2.0)
PARAMS = small_params(
    places=make_places((6, 2, 2, 0, 5), 2, (True, True), True, 2, ticks=2),
    disturbance=DISTURBANCE,
    second_order=False,
)
PLACES = PARAMS.places
SLOW = slice(PLACES.slow, PLACES.thrust)


def discretized(disturbance: DisturbanceParams, duration_s: float) -> tuple[Array, Array]:
    """Transition of w, c and z over an interval, and the covariance that comes: by Van Loan's matrix exponential."""
    a, n = disturbance.accelerations, disturbance.accelerations.shape[1]
    flow, spread = np.zeros((6 + n, 6 + n)), np.zeros((6 + n, 6 + n))
    flow[:6, 6:], flow[6:, 6:] = a, -np.eye(n) / disturbance.time_constant_s
    spread[6:, 6:] = 2.0 / disturbance.time_constant_s * np.eye(n)
    both = expm(duration_s * np.block([[-flow, spread], [np.zeros_like(flow), flow.T]]))
    through = both[6 + n :, 6 + n :].T
    return through, through @ both[: 6 + n, 6 + n :]


@pytest.mark.parametrize("constant_s", [0.02, 0.1, 2.0, 15.0])
def test_an_interval_is_that_of_the_matrix_exponential(constant_s: float) -> None:
    disturbance = DISTURBANCE._replace(time_constant_s=constant_s)
    wander, n = wandered(disturbance, PERIOD), 5
    through, covariance = discretized(disturbance, PERIOD)
    np.testing.assert_allclose(wander.begun, through[:6, 6:], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(wander.kept * np.eye(n), through[6:, 6:], rtol=1e-9, atol=1e-15)
    columns = np.block(
        [[wander.drawn, np.zeros((6, n))], [wander.along * np.eye(n), wander.apart * np.eye(n)]],
    )
    scale = np.sqrt(np.outer(covariance.diagonal(), covariance.diagonal())) + 1e-300
    np.testing.assert_allclose(columns @ columns.T / scale, covariance / scale, atol=2e-6)
    np.testing.assert_allclose(come(wander), (columns @ columns.T)[:6, :6], atol=1e-30)


def test_what_a_disturbance_does_agrees_with_central_differences() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    assert np.abs(state.mean[SLOW]).max() > 0.1

    def after(mean: Array) -> Array:
        there = state._replace(mean=mean)
        return predict(there, driven(there, sample, PARAMS), unread(PARAMS), PARAMS).mean

    expected = central_differences(after, state.mean, 1e-4 * np.maximum(np.abs(state.mean), 1e-2))[:, SLOW]
    prediction = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS)
    found = propagated(np.eye(PLACES.size), prediction, PARAMS)[:, SLOW]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected[RATE]).max() > 1e-4
    assert np.abs(expected[VELOCITY : VELOCITY + 6]).max() > 1e-3


def test_columns_beside_the_filter_are_carried_as_its_own_errors() -> None:
    state = some_state(PARAMS)._replace(guarded=True, time_s=0.0)
    sample = some_sample(PARAMS, rates=np.zeros((2, 3)), velocities=np.zeros((2, 3)))
    _, report = step(state, sample, PARAMS)
    assert report.course is not None
    over = link(state, report, sample, PARAMS)
    columns = np.zeros((PLACES.size, 5))
    columns[SLOW] = np.eye(5)
    own = propagated(columns, report.course.expected.prediction, PARAMS)[:, :5]
    after = carried(columns, np.zeros((6, 5)), over, PLACES)
    np.testing.assert_allclose(after[SLOW], own[SLOW], rtol=1e-14)
    np.testing.assert_allclose(after[RATE], own[RATE], rtol=1e-14)
    both = 0.5 * (own[VELOCITY : VELOCITY + 3] + own[VELOCITY + 3 : VELOCITY + 6])
    np.testing.assert_allclose(0.5 * (after[VELOCITY : VELOCITY + 3] + after[VELOCITY + 3 : VELOCITY + 6]), both)


def test_the_bank_knows_how_uncertain_a_disturbance_makes_what_has_been_since() -> None:
    still = PARAMS._replace(repeatability=np.zeros(6), rate_walk=1e-4)
    state = initial(still)
    state = state._replace(root=1e-9 * np.eye(PLACES.size), started=True, guarded=True)
    first = state
    bank, covariance = banks.empty(PLACES), np.zeros((PLACES.size, 1))
    rest = np.zeros((1, 6))
    for number in range(6):
        sample = some_sample(
            still,
            time_s=(number + 1) * PERIOD,
            commands=rest,
            rates=np.zeros((2, 3)),
            velocities=np.zeros((2, 3)),
        )
        after, report = step(state, sample, still)
        assert report.course is not None
        over = link(state, report, sample, still)
        bank = banks.advanced(bank, over, PLACES)
        if number > 0:
            covariance = propagated(covariance, report.course.expected.prediction, still)
        bank, state = banks.taken(bank, over, after, number, still), after
        if number == 0:
            first = after
    rows = np.r_[RATE.start : RATE.stop, VELOCITY : VELOCITY + 3, PLACES.slow : PLACES.thrust]
    expected = covariance[rows] @ covariance[rows].T
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(bank.noise[0] / scale, expected / scale, atol=1e-4)
    np.testing.assert_allclose(bank.kept[0], np.exp(-5 * PERIOD / DISTURBANCE.time_constant_s))
    assert bank.states[0] is first
    along = np.zeros((PLACES.size, 5))
    along[SLOW] = np.eye(5)
    for number in range(5):
        sample = some_sample(still, time_s=(number + 2) * PERIOD, commands=rest)
        prediction = predict(first, driven(first, sample, still), unread(still), still)
        along = propagated(along, prediction, still)[:, :5]
    found = bank.rows[0][:, SLOW]
    np.testing.assert_allclose(found[:3], along[RATE], rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(found[3:], along[VELOCITY : VELOCITY + 3], rtol=1e-3, atol=1e-8)


def test_after_a_gap_is_known_what_is_left_of_a_disturbance() -> None:
    state = some_state(PARAMS)._replace(time_s=1.0)
    after = begun(state, some_sample(PARAMS, time_s=3.0), PARAMS)
    kept = np.exp(-1.0)  # a gap of one time constant
    np.testing.assert_allclose(after.mean[SLOW], kept * state.mean[SLOW])
    before, now = (each.root[SLOW] @ each.root[SLOW].T for each in (state, after))
    np.testing.assert_allclose(now, kept**2 * before + (1.0 - kept**2) * np.eye(5))
    first = begun(initial(PARAMS), some_sample(PARAMS, time_s=7.0), PARAMS)
    np.testing.assert_allclose(first.root[SLOW] @ first.root[SLOW].T, np.eye(5), atol=1e-15)
