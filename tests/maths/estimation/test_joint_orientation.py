"""Attitude among the joint filter's states: against integration, differences, and sampling."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, central_differences, small_params, some_sample, some_state, unread

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagated,
    to_rotation_vector,
)
from massprop_drake.maths.estimation.joint import prediction as predictions
from massprop_drake.maths.estimation.joint.joint_cycle import JointSample, begun, driven, initial, step
from massprop_drake.maths.estimation.joint.layout import AttitudeSensors, JointParams, JointState, make_places
from massprop_drake.maths.estimation.joint.measurement import outputs, told_by_trackers
from massprop_drake.maths.estimation.joint.orientation import STILL, UNTURNED, shared_attitude, turned
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict
from massprop_drake.maths.estimation.joint.sensitivity import carried, link
from massprop_drake.maths.estimation.joint.wheels import UNSPUN
from massprop_drake.maths.linear_algebra import Array

STD = 5e-5  # rad, of a tracker's reading
RATES = np.array([[0.3, -0.2, 0.1], [0.28, -0.1, 0.25]])
FRAMES = np.stack([from_rotation_vector(np.array([0.4, -1.0, 2.0])), from_rotation_vector(np.array([0.5, -1.0, 2.1]))])


def tracked_params(**changed: object) -> JointParams:
    """The small vehicle with a tracker, without lag."""
    settings: dict[str, object] = {
        "places": make_places((6, 2, 2, 1), 0, (True, False), True, 2),
        "prior_sigma": np.append(np.ones(6 + 6), np.zeros(1 + 2)),
        "variances": np.array([1e-10] * 3 + [2e-10] * 3 + [1e-8] * 6 + [STD**2] * 3),
        "quanta": np.zeros(15),
        "time_constants_s": np.zeros(6),
        "trackers": AttitudeSensors(np.array([STD**2]), np.zeros(1), np.zeros(1)),
        "second_order": False,
    }
    return small_params(**(settings | changed))


PARAMS = tracked_params()
PLACES = PARAMS.places
ATTITUDE = slice(PLACES.attitude, PLACES.attitude + 3)
UNSEEN = np.full((1, 3), np.nan)


def integrated(attitude: Array, rates: Array, steps: int = 400) -> Array:
    """Attitude after a rate that goes from one to the other in a straight line."""
    for k in range(steps):
        rate = rates[0] + (k + 0.5) / steps * (rates[1] - rates[0])
        attitude = propagated(attitude, rate, PERIOD / steps)
    return attitude


def angle_between(one: Array, other: Array) -> float:
    return float(np.linalg.norm(to_rotation_vector(multiply(one, conjugate(other)))))


def test_an_interval_turns_the_attitude_as_integration_does() -> None:
    psi = np.array([0.02, -0.01, 0.03])
    start = multiply(from_rotation_vector(psi), FRAMES[0])
    after, _ = turned(psi, FRAMES, RATES, np.zeros(3), PERIOD)
    expected = integrated(start, RATES)
    assert angle_between(multiply(from_rotation_vector(after), FRAMES[1]), expected) < 1e-7
    assert angle_between(propagated(start, RATES.mean(axis=0), PERIOD), expected) > 1e-5  # without coning


@pytest.mark.parametrize("index", [0, 1])
def test_the_attitude_by_the_rates_agrees_with_central_differences(index: int) -> None:
    frames = np.stack((FRAMES[0], integrated(FRAMES[0], RATES)))

    def after(rate: Array) -> Array:
        rates = RATES.copy()
        rates[index] = rate
        return turned(np.zeros(3), frames, rates, np.zeros(3), PERIOD)[0]

    _, by_rates = turned(np.zeros(3), frames, RATES, np.zeros(3), PERIOD)
    found = central_differences(after, RATES[index], np.full(3, 1e-5))
    np.testing.assert_allclose(by_rates[index], found, atol=5e-5 * PERIOD)


def test_a_bow_turns_it_by_its_mean_for_the_interval() -> None:
    bow = np.array([1e-3, -2e-3, 3e-3])
    after, _ = turned(np.zeros(3), STILL, np.zeros((2, 3)), bow, PERIOD)
    np.testing.assert_allclose(after, PERIOD * bow, rtol=1e-6)


def test_readings_and_state_tell_of_one_attitude_whatever_is_shared() -> None:
    true = from_rotation_vector(np.array([1.0, 0.2, -2.0]))
    missing = np.full(4, np.nan)
    shared, told = shared_attitude(FRAMES[0], RATES[0], PERIOD, np.stack((2.0 * true, missing)))
    np.testing.assert_allclose(shared, true, rtol=1e-15)  # what a tracker has read is shared from then on
    np.testing.assert_allclose(told[0], 0.0, atol=1e-15)
    assert np.isnan(told[1]).all()
    shared, told = shared_attitude(FRAMES[0], RATES[0], PERIOD, np.stack((missing, missing)))
    np.testing.assert_array_equal(shared, propagated(FRAMES[0], RATES[0], PERIOD))
    assert np.isnan(told).all()
    off = np.array([1e-3, 0.0, 2e-3])
    other = multiply(from_rotation_vector(off), -true)  # of the other sign, which is the same attitude
    np.testing.assert_allclose(
        shared_attitude(UNTURNED, RATES[0], PERIOD, np.stack((true, other)))[1][1], off, atol=1e-15
    )


def about_itself(state: JointState, sample: JointSample) -> tuple[Array, Prediction]:
    """Frames whose second one is the attitude that is predicted from the first, and the prediction with them."""
    acting = driven(state, sample, PARAMS)
    reached = predict(state, acting, unread(PARAMS), PARAMS, (FRAMES, UNSPUN)).mean[ATTITUDE]
    frames = np.stack((FRAMES[0], multiply(from_rotation_vector(reached), FRAMES[1])))
    return frames, predict(state, acting, unread(PARAMS), PARAMS, (frames, UNSPUN))


def test_how_errors_go_over_to_the_attitude_agrees_with_central_differences() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    state.mean[ATTITUDE] = 0.0
    frames, prediction = about_itself(state, sample)

    def after(mean: Array) -> Array:
        there = state._replace(mean=mean)
        return predict(there, driven(there, sample, PARAMS), unread(PARAMS), PARAMS, (frames, UNSPUN)).mean[ATTITUDE]

    expected = central_differences(after, state.mean, 1e-5 * np.maximum(np.abs(state.mean), 1e-2))
    found = predictions.propagated(np.eye(PLACES.size), prediction, PARAMS)[ATTITUDE, : PLACES.size]
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    # the bow by coupling is taken as known: in an interval in which the rate doubles that is .2 % of what inertia does
    np.testing.assert_allclose(found / scale, expected / scale, atol=5e-3)
    assert np.abs(expected[:, :9]).max() > 1e-3  # by the mass properties, by way of the rate
    noisy = prediction._replace(noise=np.diag([1e-8, 4e-8, 9e-8, 0, 0, 0]))
    columns = predictions.propagated(np.zeros((PLACES.size, 1)), noisy, PARAMS)[ATTITUDE]
    np.testing.assert_allclose(columns @ columns.T, noisy.attitude[1] @ noisy.noise[:3, :3] @ noisy.attitude[1].T)


def test_columns_beside_the_filter_are_carried_as_its_own_errors() -> None:
    state = some_state(PARAMS)._replace(guarded=True, time_s=0.0)
    sample = some_sample(PARAMS, rates=np.zeros((2, 3)), velocities=np.zeros((2, 3)), attitudes=UNSEEN, frames=FRAMES)
    _, report = step(state, sample, PARAMS)
    over = link(state, report, sample, PARAMS)
    assert report.course is not None
    expected = predictions.propagated(np.eye(PLACES.size), report.course.expected.prediction, PARAMS)[:, : PLACES.size]
    found = carried(np.eye(PLACES.size), np.zeros((6, PLACES.size)), over, PLACES)
    np.testing.assert_allclose(found[ATTITUDE], expected[ATTITUDE], rtol=1e-12)
    forced = carried(np.zeros((PLACES.size, 1)), np.array([[1.0], [0], [0], [0], [0], [0]]), over, PLACES)
    np.testing.assert_allclose(forced[ATTITUDE, 0], over.attitude[1][:, 0])  # half an interval in mean


def test_without_a_reading_at_the_start_the_first_one_tells_the_attitude() -> None:
    still = some_sample(PARAMS, rates=np.zeros((2, 3)), velocities=np.zeros((2, 3)), commands=np.zeros((1, 6)))
    state = begun(initial(PARAMS), still._replace(attitudes=UNSEEN), PARAMS)
    off = np.array([[0.5, -0.3, 0.2]])
    state, report = step(state, still._replace(attitudes=off), PARAMS)
    np.testing.assert_allclose(state.mean[ATTITUDE], off[0], atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.sum(state.root[ATTITUDE] ** 2, axis=1)), STD, rtol=1e-3)
    assert report.used[12:].all()
    assert np.isfinite(report.log_likelihood)


def told(error: Array, params: JointParams, rate: Array) -> Array:
    """Variances of a tracker's reading that lies off by an error."""
    innovation = np.append(np.zeros(12), error)
    projected = np.zeros((15, 3))
    projected[12:] = 0.5 * STD * np.eye(3)
    variances, floors = told_by_trackers(innovation, projected, rate, params.floors, params)
    np.testing.assert_array_equal(variances[12:], floors[12:])
    np.testing.assert_array_equal(variances[:12], params.variances[:12])
    np.testing.assert_array_equal(floors[:12], params.floors[:12])
    return variances[12:]


def test_a_reading_that_is_likelier_a_poor_one_has_the_variance_of_one() -> None:
    poor = AttitudeSensors(np.array([STD**2]), np.zeros(1), np.array([0.02]))
    params, still = tracked_params(trackers=poor), np.zeros(3)
    np.testing.assert_allclose(told(np.full(3, STD), params, still), STD**2)
    np.testing.assert_allclose(told(np.full(3, 6.0 * STD), params, still), 100.0 * STD**2)
    np.testing.assert_allclose(told(np.full(3, 6.0 * STD), PARAMS, still), STD**2)  # where none is stated
    # the border is where both are as likely: ln .98 - x^2/2/1.25 = ln .02 - 3/2 ln (100.25/1.25) - x^2/2/100.25
    border = np.sqrt((np.log(0.98 / 0.02) + 1.5 * np.log(100.25 / 1.25)) / (0.5 / 1.25 - 0.5 / 100.25))
    for share, variance in ((0.999, STD**2), (1.001, 100.0 * STD**2)):
        np.testing.assert_allclose(told(np.array([share * border * STD, 0.0, 0.0]), params, still), variance)


def test_a_stamp_that_is_off_turns_a_reading_with_the_rate() -> None:
    late = AttitudeSensors(np.array([STD**2]), np.array([1e-6]), np.zeros(1))
    found = told(np.zeros(3), tracked_params(trackers=late), np.array([0.3, 0.0, 0.4]))
    np.testing.assert_allclose(found, STD**2 + 1e-6 * 0.25)


ROWS, EVERY = 60, 3  # of which the tracker reads one


def flown(seed: int, params: JointParams, *, tracked: bool) -> tuple[JointState, Array, Array]:
    """The filter after a flight of a vehicle that is drawn, the truth of its parameters, and its true attitude.

    The true attitude is integrated by itself, from rates that the prediction gives at the truth.
    """
    rng, places = np.random.default_rng(seed), params.places
    truth, state = initial(params), initial(params)
    mean = np.zeros(places.size)
    mean[:10] = params.start + params.start_root @ rng.standard_normal(10)
    mean[places.thrust : places.scale] = rng.standard_normal(places.scale - places.thrust)
    truth = truth._replace(mean=mean, started=True)
    attitude = frame = from_rotation_vector(rng.standard_normal(3))
    for row in range(ROWS):
        commands = (rng.uniform(size=(1, 6)) < 0.4).astype(float) if row else np.zeros((1, 6))
        sample = some_sample(params, time_s=row * PERIOD, commands=commands)
        if row:
            acting = driven(truth, sample, params)
            ends = predict(truth, acting, unread(params), params)
            attitude = integrated(attitude, np.stack((truth.mean[10:13], ends.mean[10:13])), steps=8)
            truth = truth._replace(mean=ends.mean, spin=truth.spin + ends.spin)
        read, _ = outputs(truth.mean, truth.reference, truth.spin, params)
        read = read + np.sqrt(params.variances) * rng.standard_normal(15)
        seen = np.full((1, 4), np.nan)
        if row % EVERY == 0:
            seen[0] = multiply(attitude, from_rotation_vector(STD * rng.standard_normal(3)))
        if not tracked:
            seen[:] = np.nan
        before, (frame, told_of) = frame, shared_attitude(frame, read[:3], PERIOD, seen)
        sample = sample._replace(
            rates=read[:6].reshape(2, 3),
            velocities=read[6:12].reshape(2, 3),
            attitudes=told_of,
            frames=np.stack((before, frame)),
        )
        state, _ = step(state, sample, params) if row else (begun(state, sample, params), None)
    estimated = multiply(from_rotation_vector(state.mean[ATTITUDE]), frame)
    off = to_rotation_vector(multiply(attitude, conjugate(estimated)))
    return state, truth.mean - state.mean, off


def test_errors_are_as_large_as_stated_and_the_tracker_shows_the_gyros_biases() -> None:
    """The squared error in its own covariance, over flights of vehicles that are drawn, is chi-square."""
    params = tracked_params(
        places=make_places((6, 2, 2, 1), 0, (True, False), False, 2),
        prior_sigma=np.append(np.ones(6), np.zeros(2)),
        thrust_sigma=0.0,
        start_root=np.diag(np.abs(PARAMS.start) * 0.01),
        gyro_bias_sigma=1e-3,
        flows=np.zeros(6),
        guard_relative=np.zeros(4),
    )
    places, flights = params.places, 30
    biases = slice(places.gyro_bias, places.gyro_bias + 6)
    total = {"properties": 0.0, "biases": 0.0, "attitude": 0.0}
    for seed in range(flights):
        state, error, off = flown(seed, params, tracked=True)
        error[ATTITUDE] = off
        for name, part in (("properties", slice(0, 10)), ("biases", biases), ("attitude", ATTITUDE)):
            root = state.root[part]
            total[name] += error[part] @ np.linalg.solve(root @ root.T, error[part])
    for name, degrees in (("properties", 10), ("biases", 6), ("attitude", 3)):
        mean, spread = total[name] / flights, np.sqrt(2.0 * degrees / flights)
        assert abs(mean - degrees) < 3.3 * spread, (name, mean)
    state, _, _ = flown(0, params, tracked=True)
    without, _, _ = flown(0, params, tracked=False)
    sigma, plain = (np.sqrt(np.sum(each.root**2, axis=1)) for each in (state, without))
    assert (sigma[: PLACES.attitude] <= plain[: PLACES.attitude] * (1.0 + 1e-3)).all()
    assert (sigma[biases] < 0.25 * plain[biases]).all()
