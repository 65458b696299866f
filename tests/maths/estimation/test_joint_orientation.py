"""Attitude among the joint filter's states: against integration, differences, and sampling."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, central_differences, derivatives, small_params, some_sample, some_state, unread

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagate_attitude,
    to_rotation_vector,
)
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces
from massprop_drake.maths.estimation.joint.layout import AttitudeSensors, make_places
from massprop_drake.maths.estimation.joint.measurement import add_tracker_variances
from massprop_drake.maths.estimation.joint.orientation import STILL, UNTURNED, shared_attitude, turn_attitude
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.prediction import propagate_root as propagated_root
from massprop_drake.maths.estimation.joint.wheels import UNSPUN
from massprop_drake.maths.linear_algebra import Array

STD = 5e-5  # rad, of a tracker's reading
RATES = np.array([[0.3, -0.2, 0.1], [0.28, -0.1, 0.25]])
FRAMES = np.stack([from_rotation_vector(np.array([0.4, -1.0, 2.0])), from_rotation_vector(np.array([0.5, -1.0, 2.1]))])


PARAMS = small_params(  # the small vehicle with a tracker, without lag
    places=make_places((6, 2, 2, 1), 0, (True, False), True, 2),
    prior_sigma=np.append(np.ones(6 + 6), np.zeros(1 + 2)),
    variances=np.array([1e-10] * 3 + [2e-10] * 3 + [1e-8] * 6 + [STD**2] * 3),
    quanta=np.zeros(15),
    time_constants_s=np.zeros(6),
    trackers=AttitudeSensors(np.array([STD**2]), np.zeros(1), np.zeros(1)),
    second_order=False,
)
PLACES = PARAMS.places
ATTITUDE = slice(PLACES.attitude, PLACES.attitude + 3)
BORDER = np.sqrt((np.log(0.98 / 0.02) + 1.5 * np.log(100.25 / 1.25)) / (0.5 / 1.25 - 0.5 / 100.25))


def integrated(attitude: Array, rates: Array, steps: int = 400) -> Array:
    """Attitude after a rate that goes from one to the other in a straight line."""
    for k in range(steps):
        rate = rates[0] + (k + 0.5) / steps * (rates[1] - rates[0])
        attitude = propagate_attitude(attitude, rate, PERIOD / steps)
    return attitude


def test_an_interval_turns_the_attitude_as_integration_does() -> None:
    psi = np.array([0.02, -0.01, 0.03])
    start = multiply(from_rotation_vector(psi), FRAMES[0])
    after, _ = turn_attitude(psi, FRAMES, RATES, np.zeros(3), PERIOD)
    expected = integrated(start, RATES)
    plain = propagate_attitude(start, RATES.mean(axis=0), PERIOD)  # without coning
    for found, off in ((multiply(from_rotation_vector(after), FRAMES[1]), 1e-7), (plain, 1.0)):
        assert np.linalg.norm(to_rotation_vector(multiply(found, conjugate(expected)))) < off
    assert np.linalg.norm(to_rotation_vector(multiply(plain, conjugate(expected)))) > 1e-5


def test_the_attitude_by_the_rates_and_by_their_bow() -> None:
    frames = np.stack((FRAMES[0], integrated(FRAMES[0], RATES)))

    def after(rates: Array) -> Array:
        return turn_attitude(np.zeros(3), frames, rates.reshape(2, 3), np.zeros(3), PERIOD)[0]

    found = np.hstack(turn_attitude(np.zeros(3), frames, RATES, np.zeros(3), PERIOD)[1])
    expected = central_differences(after, RATES.ravel(), np.full(6, 1e-5))
    np.testing.assert_allclose(found, expected, atol=5e-5 * PERIOD)
    bow = np.array([1e-3, -2e-3, 3e-3])  # turns it by its mean for the interval
    bowed, _ = turn_attitude(np.zeros(3), STILL, np.zeros((2, 3)), bow, PERIOD)
    np.testing.assert_allclose(bowed, PERIOD * bow, rtol=1e-6)


def test_readings_and_state_tell_of_one_attitude_whatever_is_shared() -> None:
    true = from_rotation_vector(np.array([1.0, 0.2, -2.0]))
    missing = np.full(4, np.nan)
    shared, told = shared_attitude(FRAMES[0], RATES[0], PERIOD, np.stack((2.0 * true, missing)))
    np.testing.assert_allclose(shared, true, rtol=1e-15)  # what a tracker has read is shared from then on
    np.testing.assert_allclose(told[0], 0.0, atol=1e-15)
    assert np.isnan(told[1]).all()
    shared, told = shared_attitude(FRAMES[0], RATES[0], PERIOD, np.stack((missing, missing)))
    np.testing.assert_array_equal(shared, propagate_attitude(FRAMES[0], RATES[0], PERIOD))
    assert np.isnan(told).all()
    off = np.array([1e-3, 0.0, 2e-3])
    other = multiply(from_rotation_vector(off), -true)  # of the other sign, which is the same attitude
    _, told = shared_attitude(UNTURNED, RATES[0], PERIOD, np.stack((true, other)))
    np.testing.assert_allclose(told[1], off, atol=1e-15)


def test_errors_go_over_to_the_attitude_as_differences_and_its_own_noise_say() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    state.mean[ATTITUDE] = 0.0
    acting = estimate_forces(state, sample, PARAMS)
    reached = predict(state, acting, unread(PARAMS), PARAMS, (FRAMES, UNSPUN)).mean[ATTITUDE]
    frames = np.stack((FRAMES[0], multiply(from_rotation_vector(reached), FRAMES[1])))  # the second one is predicted
    found, expected = (each[ATTITUDE] for each in derivatives(state, sample, PARAMS, (frames, UNSPUN)))
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    # the bow by coupling is taken as known: in an interval in which the rate doubles that is .2 % of what inertia does
    np.testing.assert_allclose(found / scale, expected / scale, atol=5e-3)
    assert np.abs(expected[:, :9]).max() > 1e-3  # by the mass properties, by way of the rate
    prediction = predict(state, acting, unread(PARAMS), PARAMS, (frames, UNSPUN))
    noisy = prediction._replace(noise=np.diag([1e-8, 4e-8, 9e-8, 0, 0, 0]))
    columns = propagated_root(np.zeros((PLACES.size, 1)), noisy, PARAMS)[ATTITUDE]
    np.testing.assert_allclose(columns @ columns.T, noisy.attitude[1] @ noisy.noise[:3, :3] @ noisy.attitude[1].T)


@pytest.mark.parametrize(
    ("off", "rate", "outliers", "stamp_variance", "variance"),
    [
        (1.0, 0.0, 0.02, 0.0, STD**2),
        (6.0, 0.0, 0.02, 0.0, 100.0 * STD**2),  # likelier a poor one
        (6.0, 0.0, 0.0, 0.0, STD**2),  # where none is stated
        # the border is where both are as likely: ln .98 - x^2/2/1.25 = ln .02 - 3/2 ln (100.25/1.25) - x^2/2/100.25
        (0.999 * BORDER, 0.0, 0.02, 0.0, STD**2),
        (1.001 * BORDER, 0.0, 0.02, 0.0, 100.0 * STD**2),
        (0.0, 0.5, 0.0, 1e-6, STD**2 + 1e-6 * 0.25),  # a stamp that is off turns a reading with the rate
    ],
)
def test_the_variance_of_a_trackers_reading(
    off: float, rate: float, outliers: float, stamp_variance: float, variance: float
) -> None:
    sensors = AttitudeSensors(np.array([STD**2]), np.array([stamp_variance]), np.array([outliers]))
    params, turning = PARAMS._replace(trackers=sensors), np.array([0.6, 0.0, 0.8]) * rate
    innovation, projected = np.append(np.zeros(12), [off * STD, 0.0, 0.0]), np.zeros((15, 3))
    projected[12:] = 0.5 * STD * np.eye(3)
    variances, floors = add_tracker_variances(innovation, projected, turning, params.floors, params)
    np.testing.assert_allclose(variances[12:], variance)
    np.testing.assert_array_equal(variances[12:], floors[12:])
    np.testing.assert_array_equal([variances[:12], floors[:12]], [params.variances[:12], params.floors[:12]])
