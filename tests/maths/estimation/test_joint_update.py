"""The joint update in root form, readings that count and when, rebase, guard, and the common thrust scale."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from joint_probe import PERIOD, TRUTH, central_differences, small_params, some_sample, some_state

from massprop_drake.maths.estimation.joint.beginning import begin_from_readings, initial_joint_state
from massprop_drake.maths.estimation.joint.covariance import compress_root, joseph_update
from massprop_drake.maths.estimation.joint.crossing import Crossing, update_by_crossings
from massprop_drake.maths.estimation.joint.guard import is_converged, reset_guard, update_guard
from massprop_drake.maths.estimation.joint.joint_cycle import step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointState, make_places
from massprop_drake.maths.estimation.joint.measurement import (
    combine_gyros,
    find_changed,
    fix_velocity_reference,
    predict_outputs,
    select_counting,
)
from massprop_drake.maths.estimation.joint.quantized import match_moments
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params()
PLACES = PARAMS.places
RNG = np.random.default_rng(3)


def close(found: Array, expected: Array, atol: float = 1e-11) -> None:
    """Covariances agree after scaling to a unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(expected), 1e-300))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=atol)


def josephs(before: Array, jacobian: Array, variances: Array) -> tuple[Array, Array]:
    """Gain and covariance of an update."""
    gain = before @ jacobian.T @ np.linalg.inv(jacobian @ before @ jacobian.T + np.diag(variances))
    rest = np.eye(before.shape[0]) - gain @ jacobian
    return gain, rest @ before @ rest.T + gain @ np.diag(variances) @ gain.T


def test_update_is_josephs() -> None:
    root, jacobian, innovation = np.tril(RNG.standard_normal((7, 7))), RNG.standard_normal((3, 7)), np.ones(3)
    variances = np.array([0.1, 0.2, 0.3])
    gain, covariance = josephs(root @ root.T, jacobian, variances)
    found = joseph_update(root, jacobian @ root, variances, innovation, 0)
    close(found.root @ found.root.T, covariance)
    np.testing.assert_allclose(found.correction, gain @ innovation, rtol=1e-10, atol=1e-13)
    total = jacobian @ root @ root.T @ jacobian.T + np.diag(variances)
    np.testing.assert_allclose(found.upper.T @ found.upper, total, rtol=1e-10)
    np.testing.assert_allclose(found.half_gain @ np.linalg.inv(found.upper.T), gain, rtol=1e-9, atol=1e-12)
    assert not np.triu(found.root, 1).any()


@pytest.mark.parametrize("still", [0, 2, 5])
def test_a_root_is_triangular_in_its_order_and_keeps_the_rows_that_are_so(still: int) -> None:
    """First come those from the third on, of which some are triangular already; units change no digit."""
    ordered = RNG.standard_normal((5, 9))
    ordered[:still] = np.tril(ordered)[:still]
    columns = np.vstack((ordered[3:], ordered[:3]))
    found = compress_root(columns, 2)
    np.testing.assert_allclose(found @ found.T, columns @ columns.T, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(np.triu(np.vstack((found[2:], found[:2])), 1), np.zeros((5, 5)))
    np.testing.assert_array_equal(found[2 : 2 + min(still, 3)], columns[2 : 2 + min(still, 3), :5])
    scale = 2.0 ** np.array([[-40.0], [3], [0], [20], [-7]])
    np.testing.assert_array_equal(np.abs(compress_root(scale * columns, 2)), np.abs(scale * found))


def test_outputs_and_rate_read_have_their_derivatives() -> None:
    state = some_state(PARAMS)
    # C is known, and w's part of it is not differentiated
    _, jacobian = predict_outputs(state.mean, state.reference, state.spin, PARAMS)
    steps = np.full(PLACES.size, 1e-4)
    outputs = partial(predict_outputs, reference=state.reference, spin=state.spin, params=PARAMS)
    differences = central_differences(lambda mean: outputs(mean)[0], state.mean, steps)
    np.testing.assert_allclose(differences, jacobian, atol=1e-9)

    mean = np.zeros(PLACES.size)
    mean[PLACES.gyro_bias : PLACES.gyro_bias + 6] = [100.0, 0, 0, -50, 0, 0]
    rates = np.array([[0.001, 0.02, np.nan], [-0.0005, 0.05, np.nan]])
    read = combine_gyros(rates, mean, PARAMS)
    np.testing.assert_allclose(read.rate, [0.0, (2 * 0.02 + 0.05) / 3, np.nan], atol=1e-15)  # variances 1 and 2
    expected = 1.0 / (1.0 / PARAMS.variances[:3] + 1.0 / PARAMS.variances[3:6])
    np.testing.assert_allclose(read.variance, [*expected[:2], np.inf])
    differences = central_differences(lambda at: combine_gyros(rates, at, PARAMS).rate, mean, steps)
    np.testing.assert_allclose(read.rows[:2], differences[:2], atol=1e-12)
    assert not read.rows[2].any()


def test_which_readings_count() -> None:
    cases = [
        # read, read before, predicted, its 1-sigma
        (0.0, 0.0, 0.4, 0.1, False),  # within its cell, as before
        (1.0, 0.0, 0.6, 0.1, True),  # has changed
        (0.0, 0.0, 0.81, 0.1, True),  # off by more than 1/2 + 3 sigmas
        (0.0, 0.0, 0.79, 0.1, False),  # by less than that
        (0.0, 0.0, 0.531, 0.0, True),  # the floor alone widens: 0.01
        (0.0, 0.0, 0.529, 0.0, False),
        (0.0, 0.0, 0.0, 0.51, True),  # not even known to half a cell
        (np.nan, 0.0, 5.0, 0.6, False),  # missing
        (0.0, np.nan, 0.0, 0.1, True),  # the first
    ]
    read, before, predicted, deviation, counts = (np.array(column) for column in zip(*cases, strict=True))
    n = read.size
    params = small_params(cells=np.ones(n), floors=np.full(n, 1e-4), dithered=np.zeros(n), variances=np.full(n, 1 / 12))
    found, floors = select_counting(read, before, predicted, deviation**2, params.floors, params)
    np.testing.assert_array_equal(found, counts)
    assert (floors[4], floors[5]) == (params.variances[4], 1e-4)  # one that stays and is off: rounding as noise
    np.testing.assert_array_equal(find_changed(read, before, params), [False, True, *[False] * 6, True])
    dithered = params._replace(dithered=np.ones(n))
    every, _ = select_counting(read, before, predicted, deviation**2, params.floors, dithered)
    np.testing.assert_array_equal(every, ~np.isnan(read))


QUANTUM = 1e-4
CELLS = np.array([QUANTUM] * 3 + [2 * QUANTUM] * 3)
ROUNDED = small_params(
    places=make_places((6, 1, 1), 2, (False, False), False, 2),
    prior_sigma=np.append(np.ones(2), np.zeros(2)),
    accelerometer_positions=np.zeros((1, 3)),
    variances=CELLS**2 / 12,
    quanta=CELLS,
    cells=CELLS,
    floors=(0.01 * CELLS) ** 2,
    dithered=np.zeros(6),
    thrust_sigma=0.0,
    start_root=np.diag(np.abs(TRUTH) * 1e-9),
)


def reading(number: int, first: float = 0.0) -> JointSample:
    """A sample without commands whose first rate is so many quanta; the others are zero."""
    rates = np.array([[first * QUANTUM, 0.0, 0.0]])
    still = some_sample(ROUNDED, commands=np.zeros((1, 6)), velocities=np.zeros((1, 3)))
    return still._replace(time_s=number * PERIOD, rates=rates)


def taken_in(state: JointState) -> tuple[JointState, Crossing]:
    """The state with readings taken in that a changed one shows to have been the last of their cell."""
    return update_by_crossings(state, state.mean[:N_PROPERTIES], reading(2, 1.0), ROUNDED.floors, ROUNDED)


def test_the_last_reading_before_a_change_is_taken_in_with_its_own_state_and_once() -> None:
    state, _ = step(begin_from_readings(initial_joint_state(ROUNDED), reading(0), ROUNDED), reading(1), ROUNDED)
    assert state.fresh.tolist() == [1.0] * 6
    state.mean[RATE] = 0.3 * QUANTUM  # the last of its cell lies below the next one, and what is predicted within it
    now, told = taken_in(state)
    values, jacobian = predict_outputs(state.mean, state.reference, state.spin, ROUNDED)
    before, row = state.root @ state.root.T, jacobian[:1]
    site = match_moments(-values[:1], row @ before @ row.T, ROUNDED.cells[:1], ROUNDED.floors[:1])
    gain, covariance = josephs(before, row, site.variance)
    assert told.log_likelihood == pytest.approx(site.log_likelihood[0])
    np.testing.assert_allclose(told.half_gain @ told.rows, gain @ row, rtol=1e-7, atol=1e-16)  # K H
    assert np.flatnonzero(told.rows.any(axis=1)).tolist() == [0]
    np.testing.assert_allclose(now.mean, state.mean + gain @ site.innovation, rtol=1e-9, atol=1e-18)
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    np.testing.assert_allclose((now.root @ now.root.T - covariance) / np.outer(scale, scale), 0.0, atol=1e-9)
    again, nothing = taken_in(now)
    assert nothing.log_likelihood == 0.0
    np.testing.assert_array_equal(again.mean, now.mean)
    # a cycle has the likelihood of both readings
    (after, report), (_, alone) = (step(each._replace(guarded=True), reading(2, 1.0), ROUNDED) for each in (state, now))
    assert after.fresh.tolist() == [0.0, *[1.0] * 5]
    assert report.log_likelihood == pytest.approx(told.log_likelihood + alone.log_likelihood)
    np.testing.assert_array_equal(report.course.crossing.correction, told.correction)


def test_rebase_keeps_outputs_and_their_covariance() -> None:
    state = some_state(PARAMS)
    now = fix_velocity_reference(state, PARAMS)
    assert not now.spin.any()
    (values, jacobian), (after_values, after_jacobian) = (
        predict_outputs(each.mean, each.reference, each.spin, PARAMS) for each in (state, now)
    )
    np.testing.assert_allclose(after_values, values, rtol=1e-12, atol=1e-15)
    left, right = jacobian @ state.root, after_jacobian @ now.root
    close(right @ right.T, left @ left.T, 1e-8)
    # and a center of mass that changes now is not carried back into what was gathered
    assert not after_jacobian[6:, 6:9].any()


def test_guard_latches_and_lets_go_at_a_jump() -> None:
    state = some_state(PARAMS)
    poor = state._replace(root=1e3 * state.root)
    assert not update_guard(poor, True, PARAMS).guarded
    first = update_guard(state, True, PARAMS)
    assert (first.guarded, first.firing_count) == (True, 1.0)
    assert update_guard(first, False, PARAMS).firing_count == 1.0
    worse = update_guard(first._replace(root=1e3 * first.root), True, PARAMS)
    assert (worse.guarded, worse.firing_count) == (True, 2.0)
    assert (reset_guard(worse).guarded, reset_guard(worse).firing_count) == (False, 0.0)
    # what a vehicle cannot show is not judged
    unjudged = PARAMS._replace(guard_relative=np.full(4, np.inf), guard_center=np.full(3, np.inf))
    assert is_converged(poor, unjudged)
    assert not is_converged(poor, PARAMS)
