"""A cycle of the joint estimator: start, considered errors, the bound, bad numbers, and a whole maneuver."""

from __future__ import annotations

import bound_probe as bound
import numpy as np
import pytest
from joint_probe import INVERSE, PERIOD, TRUTH, read_as, small_params, some_sample, some_state, unread, vehicle_params

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.joint.joint_cycle import JointSample, initial, step
from massprop_drake.maths.estimation.joint.layout import JointState, pack, state_layout, unpack
from massprop_drake.maths.estimation.joint.measurement import outputs
from massprop_drake.maths.estimation.joint.prediction import drive, predict
from massprop_drake.maths.estimation.joint.thrust_scale import reported
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError, is_covariance, skew
from massprop_drake.results.run import Run

PARAMS = small_params()
PLACES = PARAMS.places
RATES = np.array([[0.01, -0.02, 0.03], [0.011, -0.02, 0.03]])
VELOCITIES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


def test_a_state_is_one_flat_vector() -> None:
    state = some_state(PARAMS)._replace(guarded=True, firing_count=7.0)
    vector = pack(state, PLACES)
    assert vector.shape == (state_layout(PLACES).size,)
    for one, other in zip(unpack(vector, PLACES), state, strict=True):
        np.testing.assert_array_equal(one, other)


def test_start_is_what_is_read() -> None:
    sample = some_sample(PARAMS, rates=RATES, velocities=VELOCITIES)
    state, report = step(initial(PARAMS), sample, PARAMS)
    assert state.started
    assert not report.used.any()
    np.testing.assert_allclose(state.mean[10:13], (2 * RATES[0] + RATES[1]) / 3)  # variances 1 and 2
    np.testing.assert_allclose(state.mean[13:19], VELOCITIES.ravel())
    covariance = state.root @ state.root.T
    column = PLACES.gyro_bias
    assert covariance[10, column] == pytest.approx(-2 / 3 * PARAMS.gyro_bias_sigma)
    shares = PARAMS.gyro_bias_sigma**2 * (4 / 9 + 1 / 9)
    assert covariance[10, 10] == pytest.approx(1 / (1 / 1e-10 + 1 / 2e-10) + shares)


def test_accelerometers_say_nothing_at_the_start_of_a_rate_from_which_they_are_counted() -> None:
    """What they read then has their own error, whatever that of the rate is, and tells nothing of it."""
    state, _ = step(initial(PARAMS), some_sample(PARAMS, rates=RATES, velocities=VELOCITIES), PARAMS)
    _, jacobian = outputs(state.mean, state.reference, state.spin, PARAMS)
    read = jacobian[6:] @ state.root
    np.testing.assert_allclose(read @ read.T, np.diag(PARAMS.variances[6:]), atol=1e-20)
    np.testing.assert_allclose(read @ state.root[10:13].T, np.zeros((6, 3)), atol=1e-20)


def spun(samples: int) -> tuple[Array, Array]:
    """Rate of a free body that spins, and what two accelerometers have gathered: shapes (n, 3) and (n, 2, 3)."""
    inertia, arms = np.linalg.inv(INVERSE), PARAMS.accelerometer_positions - TRUTH[6:9]

    def motion(state: Array) -> Array:
        rate = state[:3]
        turned = [skew(rate) @ skew(rate) @ arm for arm in arms]
        return np.concatenate([-INVERSE @ np.cross(rate, inertia @ rate), *turned])

    state, found, h = np.concatenate([[0.12, -0.08, 0.1], np.zeros(6)]), [], PERIOD / 4
    for _ in range(samples):
        found.append(state)
        for _ in range(4):
            k1 = motion(state)
            k2 = motion(state + 0.5 * h * k1)
            k3 = motion(state + 0.5 * h * k2)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + motion(state + h * k3))
    flown = np.array(found)
    swung = np.cross((flown[:, :3] - flown[0, :3])[:, None], arms)
    return flown[:, :3], flown[:, 3:].reshape(-1, 2, 3) + swung


def test_coarse_gyros_beside_fine_accelerometers_leave_the_filter_honest() -> None:
    """An error of the rate turns what accelerometers gather, sample after sample, all the same way."""
    rates, velocities = spun(150)
    variances = np.array([1e-6] * 6 + [1e-10] * 6)
    sigma = np.array([*(np.abs(TRUTH[:6]) * 1e-3), 0.01, 0.01, 0.01, 1e-4])
    no_biases = np.append(np.ones(6 + 2), np.zeros(6 + 6 + 1 + 2 + 2))
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        begun = TRUTH + sigma * rng.standard_normal(10)
        params = small_params(start=begun, start_root=np.diag(sigma), variances=variances, prior_sigma=no_biases)
        state = initial(params)
        for rate, gathered in zip(rates, velocities, strict=True):
            read = rate + 1e-3 * rng.standard_normal((2, 3)), gathered + 1e-5 * rng.standard_normal((2, 3))
            sample = some_sample(params, commands=np.zeros((1, 6)), rates=read[0], velocities=read[1])
            state, _ = step(state, sample, params)
        off = np.concatenate([state.mean[6:9] - TRUTH[6:9], state.mean[10:13] - rates[-1]])
        rows = np.vstack([state.root[6:9], state.root[10:13]])
        squares.append(off @ np.linalg.solve(rows @ rows.T, off))
    assert 2.0 < np.mean(squares) < 9.0  # 6 on average


def test_what_is_missing_at_the_start_is_taken_later() -> None:
    velocities, rates = VELOCITIES.copy(), np.full((2, 3), np.nan)
    velocities[1] = np.nan
    state, _ = step(initial(PARAMS), some_sample(PARAMS, rates=rates, velocities=velocities), PARAMS)
    late = some_sample(PARAMS, commands=np.zeros((1, 6)), rates=RATES, velocities=VELOCITIES)
    state, _ = step(state, late, PARAMS)
    np.testing.assert_allclose(state.mean[10:13], RATES[0], atol=2e-3)
    values, _ = outputs(state.mean, state.reference, state.spin, PARAMS)
    np.testing.assert_allclose(values[6:], VELOCITIES.ravel(), atol=5e-3)  # it turned at an unknown rate before


def test_thrust_errors_are_estimated_from_the_first_firing_on_and_no_state_is_changed() -> None:
    state = some_state(PARAMS)
    kept = pack(state, PLACES)
    sample = some_sample(PARAMS, rates=RATES, velocities=VELOCITIES)
    estimated, _ = step(state, sample, PARAMS)
    b = slice(PLACES.thrust, PLACES.thrust + 6)
    assert (estimated.mean[b] != state.mean[b]).all()
    np.testing.assert_array_equal(pack(state, PLACES), kept)
    assert is_covariance(estimated.root @ estimated.root.T)


def test_nothing_read_is_prediction_alone() -> None:
    state = some_state(PARAMS)
    after, report = step(state, some_sample(PARAMS), PARAMS)
    assert report.nis == 0.0
    acting = drive(state, np.array([PERIOD]), some_sample(PARAMS).commands, np.zeros(6), on_ticks(), PARAMS)
    np.testing.assert_array_equal(after.mean, predict(state, acting, unread(PARAMS), PARAMS).mean)


def test_which_readings_count_can_be_given() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS, rates=RATES, velocities=VELOCITIES)
    missing = sample._replace(rates=np.where(np.eye(2, 3) > 0.0, np.nan, RATES))
    counts = np.arange(12) % 2 == 0
    _, report = step(state, missing, PARAMS, counts)
    np.testing.assert_array_equal(np.flatnonzero(report.used), [2, 6, 8, 10])
    chosen, own = step(state, sample, PARAMS)
    given, again = step(state, sample, PARAMS, own.used)
    np.testing.assert_array_equal(pack(given, PLACES), pack(chosen, PLACES))
    assert again.log_likelihood == own.log_likelihood
    nothing, _ = step(state, sample, PARAMS, np.zeros(12, dtype=bool))
    assert np.flatnonzero(nothing.fresh).size == 12  # they wait for the next sample


def test_the_start_is_incremented_where_gyros_contradict_it() -> None:
    state = some_state(PARAMS)
    unread = np.full((2, 3), np.nan)
    sample = some_sample(PARAMS, rates=RATES + 0.5, velocities=unread)
    after, report = step(state, sample, PARAMS)
    assert report.incremented
    _, plain = step(state._replace(guarded=True, firing_count=60.0), sample, PARAMS)
    assert np.trace(report.covariance) > 2.0 * np.trace(plain.covariance)
    assert after.root.shape == state.root.shape
    assert not plain.incremented  # settled
    _, report = step(state, sample._replace(commands=np.zeros((1, 6))), PARAMS)
    assert not report.incremented  # nothing fires


def test_the_bound_is_the_covariance_of_a_filter_that_stays_at_the_truth() -> None:
    """Readings without errors keep the estimate at the truth; then only terms of second order differ."""
    params = small_params(second_order=False, guard_relative=np.zeros(4))
    flow_free = params._replace(flows=np.zeros(6))
    rng = np.random.default_rng(2)
    truth = np.zeros(PLACES.size)
    truth[:10] = TRUTH
    nothing = np.full((2, 3), np.nan)
    first = some_sample(params, rates=np.zeros((2, 3)), velocities=np.zeros((2, 3)))
    state, _ = step(initial(flow_free), first, flow_free)
    least = bound.start(first, truth, flow_free)
    for k in range(12):
        commands = (rng.uniform(size=(1, 6)) < 0.4).astype(float)
        sample = some_sample(params, time_s=k * PERIOD, commands=commands, rates=nothing, velocities=nothing)
        acting = drive(state, sample.durations_s, commands, np.zeros(6), on_ticks(), flow_free)
        # the truth's rate at the end follows from itself: twice, as the coupling takes the reading
        rate = predict(state, acting, unread(flow_free), flow_free).mean[10:13]
        for _ in range(8):
            prediction = predict(state, acting, read_as(rate, flow_free), flow_free)
            rate = prediction.mean[10:13]
        read, _ = outputs(prediction.mean, state.reference, state.spin + prediction.spin, flow_free)
        sample = sample._replace(rates=read[:6].reshape(2, 3), velocities=read[6:].reshape(2, 3))
        state, report = step(state, sample, flow_free)
        # to what two rounds leave of the coupling in the rate that the reading corrects
        np.testing.assert_allclose(state.mean[:10], TRUTH, rtol=1e-6)
        least = bound.step(
            least, sample, bound.true_mean(TRUTH, rate, np.zeros(PLACES.size - 19), flow_free), report.used, flow_free
        )
    expected = np.linalg.norm(reported(state, flow_free)[1], axis=1)
    np.testing.assert_allclose(bound.deviation(least), expected, rtol=1e-6)
    assert (bound.deviation(least)[[0, 1, 2, 9]] < 0.1 * np.diag(params.start_root)[[0, 1, 2, 9]]).all()


def test_an_overflow_is_an_error_with_its_time_and_never_a_number_that_is_none() -> None:
    state = some_state(PARAMS)
    sample = some_sample(PARAMS, time_s=12.5, rates=RATES, velocities=VELOCITIES)
    with pytest.raises(NotPositiveDefiniteError) as raised:
        step(state._replace(root=1e200 * state.root), sample, PARAMS)
    assert raised.value.time_s == 12.5
    assert raised.value.matrix.shape == state.root.shape


def maneuver(run: Run, vehicle: Vehicle, first: JointState | None, rows: range) -> JointState:
    """The joint estimator over some rows of a run of instantaneous thrust."""
    params = vehicle_params(vehicle, lag=False)
    state = first or initial(params)
    period = np.array([vehicle.sample_period_s])
    velocities = np.stack([run[package.name] for package in vehicle.accelerometers], axis=1)
    for row in rows:
        command = run["command"][max(row - 1, 0)][None]
        sample = JointSample(
            run.time_s[row], period, command, np.zeros(6), run["gyro"][row][None], velocities[row], on_ticks()
        )
        state, _ = step(state, sample, params)
    return state


def test_sample_maneuver_from_zero(sample_run: Run, orbiter: Vehicle) -> None:
    """To the thousandth of a percent on the diagonal, consistently; and a state put back goes on with the same bits."""
    params = vehicle_params(orbiter, lag=False)
    middle = maneuver(sample_run, orbiter, None, range(300))
    state = maneuver(sample_run, orbiter, middle, range(300, 450))
    truth = sample_run["truth"][449]
    error = state.mean[:10] - truth
    deviation = np.sqrt(np.sum(state.root[:10] ** 2, axis=1))
    assert np.abs(error[:3] / truth[:3]).max() < 1e-4
    assert np.abs(error[9] / truth[9]) < 1e-2
    assert np.abs(error / deviation).max() < 4.5
    assert state.guarded
    again = maneuver(sample_run, orbiter, unpack(pack(middle, params.places), params.places), range(300, 310))
    straight = maneuver(sample_run, orbiter, middle, range(300, 310))
    np.testing.assert_array_equal(pack(again, params.places), pack(straight, params.places))
