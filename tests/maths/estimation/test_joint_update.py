"""The joint update in root form, which readings count, rebase, and the common thrust scale."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import central_differences, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint.covariance import compressed, semidefinite_root, updated
from massprop_drake.maths.estimation.joint.guard import converged, guarded, unguarded
from massprop_drake.maths.estimation.joint.measurement import changed, counted, outputs, rate_read, rebased
from massprop_drake.maths.estimation.joint.prediction import drive, predict, propagated
from massprop_drake.maths.estimation.joint.thrust_scale import partitioned, reported
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params()
PLACES = PARAMS.places
RNG = np.random.default_rng(3)


def close(found: Array, expected: Array, atol: float = 1e-11) -> None:
    """Covariances agree after scaling to a unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(expected), 1e-300))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=atol)


def test_update_is_josephs() -> None:
    n, m = 7, 3
    root = np.tril(RNG.standard_normal((n, n)))
    jacobian, variances, innovation = RNG.standard_normal((m, n)), np.array([0.1, 0.2, 0.3]), RNG.standard_normal(m)
    before = root @ root.T
    total = jacobian @ before @ jacobian.T + np.diag(variances)
    gain = before @ jacobian.T @ np.linalg.inv(total)
    rest = np.eye(n) - gain @ jacobian
    expected = rest @ before @ rest.T + gain @ np.diag(variances) @ gain.T
    found = updated(root, jacobian @ root, variances, innovation, 0)
    close(found.root @ found.root.T, expected)
    np.testing.assert_allclose(found.correction, gain @ innovation, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(found.upper.T @ found.upper, total, rtol=1e-10)
    np.testing.assert_allclose(found.half_gain @ np.linalg.inv(found.upper.T), gain, rtol=1e-9, atol=1e-12)
    assert not np.triu(found.root, 1).any()


def test_update_by_what_is_known_a_million_million_times_better() -> None:
    """A covariance would have no digit left: the ratio of variances is 1e24."""
    jacobian = np.array([[1.0, 1.0], [1.0, 1.0]])
    found = updated(np.eye(2), jacobian, np.full(2, 1e-24), np.zeros(2), 0)
    covariance = found.root @ found.root.T
    total = np.array([1.0, 1.0]) @ found.root
    assert total @ total == pytest.approx(0.5e-24, rel=1e-2)
    np.testing.assert_allclose(covariance, [[0.5, -0.5], [-0.5, 0.5]], atol=1e-12)


def test_units_change_no_digit() -> None:
    columns = RNG.standard_normal((5, 9))
    scale = 2.0 ** np.array([-40.0, 3, 0, 20, -7])
    np.testing.assert_array_equal(
        np.abs(compressed(scale[:, None] * columns, 2)), np.abs(scale[:, None] * compressed(columns, 2))
    )


@pytest.mark.parametrize("still", [0, 2, 3, 5])
def test_a_root_is_triangular_in_its_order_and_keeps_the_rows_that_are_so(still: int) -> None:
    """First come those from the third on, of which some are triangular already."""
    ordered = RNG.standard_normal((5, 9))
    ordered[:still] = np.tril(ordered)[:still]
    columns = np.vstack((ordered[3:], ordered[:3]))
    found = compressed(columns, 2)
    np.testing.assert_allclose(found @ found.T, columns @ columns.T, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(np.triu(np.vstack((found[2:], found[:2])), 1), np.zeros((5, 5)))
    np.testing.assert_array_equal(found[2 : 2 + min(still, 3)], columns[2 : 2 + min(still, 3), :5])


def test_root_of_a_singular_matrix() -> None:
    half = RNG.standard_normal((6, 2))
    root = semidefinite_root(half @ half.T)
    np.testing.assert_allclose(root @ root.T, half @ half.T, atol=1e-12)
    assert not semidefinite_root(np.zeros((6, 6))).any()


def test_outputs_and_their_jacobian() -> None:
    state = some_state(PARAMS)
    # C is known, and w's part of it is not differentiated
    _, jacobian = outputs(state.mean, state.reference, state.spin, PARAMS)
    steps = np.full(PLACES.size, 1e-4)
    found = central_differences(lambda mean: outputs(mean, state.reference, state.spin, PARAMS)[0], state.mean, steps)
    np.testing.assert_allclose(found, jacobian, atol=1e-9)


def test_which_components_count() -> None:
    cases = [
        # read, read before, predicted, its 1-sigma
        (0.0, 0.0, 0.4, 0.1, False),  # within its cell, as before
        (1.0, 0.0, 0.6, 0.1, True),  # has changed
        (0.0, 0.0, 0.9, 0.1, True),  # 0.9 off, more than 1/2 + 0.3
        (0.0, 0.0, 0.7, 0.1, False),  # 0.7 off, less than that
        (0.0, 0.0, 0.0, 0.6, True),  # not even known to half a cell
        (np.nan, 0.0, 5.0, 0.6, False),  # missing
        (0.0, np.nan, 0.0, 0.1, True),  # the first
    ]
    read, before, predicted, deviation, counts = (np.array(column) for column in zip(*cases, strict=True))
    n = read.size
    params = small_params(cells=np.ones(n), floors=np.full(n, 1e-4), dithered=np.zeros(n), variances=np.full(n, 1 / 12))
    np.testing.assert_array_equal(counted(read, before, predicted, deviation**2, params.floors, params)[0], counts)
    np.testing.assert_array_equal(changed(read, before, params), [False, True, False, False, False, False, True])
    every, _ = counted(read, before, predicted, deviation**2, params.floors, params._replace(dithered=np.ones(n)))
    np.testing.assert_array_equal(every, ~np.isnan(read))


def test_the_floor_widens_what_is_off() -> None:
    """Half a quantum and three sigmas: of the floor alone, 0.01, where the prediction is exact."""
    params = small_params(cells=np.ones(2), floors=np.full(2, 1e-4), dithered=np.zeros(2), variances=np.full(2, 1 / 12))
    found, floors = counted(np.zeros(2), np.zeros(2), np.array([0.529, 0.531]), np.zeros(2), params.floors, params)
    np.testing.assert_array_equal(found, [False, True])
    np.testing.assert_array_equal(floors, [1e-4, params.variances[1]])  # what stays and is off: rounding as noise


def test_rate_read_is_weighted_and_free_of_bias() -> None:
    mean = np.zeros(PLACES.size)
    mean[PLACES.gyro_bias : PLACES.gyro_bias + 6] = [100.0, 0, 0, -50, 0, 0]
    rates = np.array([[0.001, 0.02, np.nan], [-0.0005, 0.05, np.nan]])
    found = rate_read(rates, mean, PARAMS)
    np.testing.assert_allclose(found.rate[:2], [0.0, (2 * 0.02 + 0.05) / 3], atol=1e-15)  # variances 1 and 2
    assert np.isnan(found.rate[2])
    assert found.variance[2] == np.inf
    np.testing.assert_allclose(found.variance[:2] * (1.0 / PARAMS.variances[:2] + 1.0 / PARAMS.variances[3:5]), 1.0)
    steps = np.full(PLACES.size, 1e-3)
    rows = central_differences(lambda mean: rate_read(rates, mean, PARAMS).rate[:2], mean, steps)
    np.testing.assert_allclose(found.rows[:2], rows, atol=1e-12)
    assert not found.rows[2].any()


def test_rebase_keeps_outputs_and_their_covariance() -> None:
    state = some_state(PARAMS)
    after = rebased(state, PARAMS)
    assert not after.spin.any()
    before_outputs, before_jacobian = outputs(state.mean, state.reference, state.spin, PARAMS)
    after_outputs, after_jacobian = outputs(after.mean, after.reference, after.spin, PARAMS)
    np.testing.assert_allclose(after_outputs, before_outputs, rtol=1e-12, atol=1e-15)
    left, right = before_jacobian @ state.root, after_jacobian @ after.root
    close(right @ right.T, left @ left.T, 1e-8)
    # and a center of mass that changes now is not carried back into what was gathered
    assert not after_jacobian[6:, 6:9].any()


def test_partition_keeps_the_distribution_of_what_is_observed() -> None:
    """The same covariance of predicted outputs before and after, over an interval of all jets that fired."""
    params = small_params(flows=np.zeros(6), second_order=False)
    state = some_state(params)
    mean, root = state.mean.copy(), state.root.copy()
    mean[PLACES.thrust : PLACES.thrust + 6] = mean[PLACES.scale] = 0.0
    root[PLACES.scale] = 0.0
    root[PLACES.thrust : PLACES.thrust + 6] *= 1e3
    state, amount = (
        state._replace(mean=mean, root=compressed(root, PLACES.thrust)),
        np.array([0.1, 0, 0.2, 0.3, 0, 0.1]),
    )
    assert partitioned(state, np.zeros(6), params) is state  # nothing has fired
    after = partitioned(state, amount, params)
    assert partitioned(after, np.ones(6), params) is after  # once for all
    results = []
    for each in (state, after):
        sample = some_sample(params)
        prediction = predict(
            each,
            drive(each, sample.durations_s, sample.commands, np.zeros(6), on_ticks(), params),
            unread(params),
            params,
        )
        _, jacobian = outputs(prediction.mean, each.reference, each.spin + prediction.spin, params)
        rows = jacobian @ propagated(each.root, prediction, params)
        results.append((prediction.mean[10:], rows @ rows.T))
    np.testing.assert_allclose(results[1][0], results[0][0], rtol=1e-12)
    close(results[1][1], results[0][1], 1e-8)
    # what is reported is what it was, too
    one, other = reported(state, params), reported(after, params)
    np.testing.assert_allclose(other[0], one[0])
    close(other[1] @ other[1].T, one[1] @ one[1].T, 1e-8)
    # the scale itself is seen by nothing but outside forces
    sample = some_sample(params)
    prediction = predict(
        after,
        drive(after, sample.durations_s, sample.commands, np.zeros(6), on_ticks(), params),
        unread(params),
        params,
    )
    assert not prediction.rate_rows[:, PLACES.scale].any()


def test_guard_latches_and_lets_go_at_a_jump() -> None:
    state = some_state(PARAMS)
    poor = state._replace(root=1e3 * state.root)
    assert not converged(poor, PARAMS)
    assert not guarded(poor, True, PARAMS).guarded
    first = guarded(state, True, PARAMS)
    assert (first.guarded, first.firing_count) == (True, 1.0)
    assert guarded(first, False, PARAMS).firing_count == 1.0
    worse = guarded(first._replace(root=1e3 * first.root), True, PARAMS)
    assert worse.guarded
    assert worse.firing_count == 2.0
    assert not unguarded(worse).guarded
    assert unguarded(worse).firing_count == 0.0
    # what a vehicle cannot show is not judged
    unjudged = PARAMS._replace(guard_relative=np.full(4, np.inf), guard_center=np.full(3, np.inf))
    assert converged(poor, unjudged)
