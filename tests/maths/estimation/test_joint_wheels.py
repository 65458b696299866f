"""Reaction wheels in the joint filter: against the equations of motion, differences, and readings of their speeds."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import INVERSE, PERIOD, central_differences, read_as, small_params, some_sample, some_state, unread
from scipy.integrate import solve_ivp

from massprop_drake.maths.estimation.joint.joint_cycle import begun, driven, initial
from massprop_drake.maths.estimation.joint.layout import INERTIA, RATE, make_places
from massprop_drake.maths.estimation.joint.prediction import predict, propagated
from massprop_drake.maths.estimation.joint.wheels import Spun, WheelParams, spun, turn_by
from massprop_drake.maths.linear_algebra import Array

AXES = np.array([[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
WHEELS = WheelParams(AXES, np.array([0.01, 0.02, 0.015]), 0.005, np.full(3, 0.02), np.full(3, 50.0))
PARAMS = small_params(
    places=make_places((6, 2, 2, 0, 0, 3), 2, (True, True, True), True, 2, ticks=2),
    prior_sigma=np.append(np.ones(6 + 2 + 6 + 6 + 3), np.zeros(1 + 2 + 2)),
    wheels=WHEELS,
    second_order=False,
    flows=np.zeros(6),
)
PLACES = PARAMS.places
SLOW = slice(PLACES.slow, PLACES.thrust)
START, END = np.array([90.0, -70.0, 120.0]), np.array([96.0, -78.0, 117.0])
READ = Spun(START, END, np.zeros(3), np.ones(3))
STILL = np.zeros((1, 6))


def turned(rate: Array, speeds: tuple[Array, Array], inertias: Array = WHEELS.inertias) -> Array:
    """Rate after an interval in which the wheels' speeds change linearly, by the equation of motion."""
    inertia, change = np.linalg.inv(INVERSE), (speeds[1] - speeds[0]) / PERIOD

    def flow(time_s: float, w: Array) -> Array:
        h = (inertias * (speeds[0] + change * time_s)) @ AXES
        return np.asarray(INVERSE @ (-(inertias * change) @ AXES - np.cross(w, inertia @ w + h)))

    return np.asarray(solve_ivp(flow, (0.0, PERIOD), rate, rtol=1e-11, atol=1e-13).y[:, -1])


def resting() -> Array:
    """A state's estimate at the truth in which no jet fires."""
    mean = some_state(PARAMS).mean.copy()
    mean[13:] = 0.0
    mean[RATE] = [0.25, -0.2, 0.15]
    mean[INERTIA] = initial(PARAMS).mean[INERTIA]
    return mean


@pytest.mark.parametrize("known", [True, False])
def test_wheels_turn_the_vehicle_as_the_equation_of_motion_has_it(known: bool) -> None:
    """Also where the inertia is not known yet: then what turning h takes still is."""
    mean = resting()
    if not known:
        mean[RATE] *= 1e-3  # what coupling makes of the rate is noise then
    state = some_state(PARAMS)._replace(mean=mean, level=np.zeros(6))
    root = state.root.copy()
    root[:6] *= 1e-3 if known else 1e3
    sample = some_sample(PARAMS, commands=STILL, outside=np.zeros(6), speeds=READ)
    state, after = state._replace(root=root), turned(mean[RATE], (START, END))
    found = predict(state, driven(state, sample, PARAMS), read_as(after, PARAMS), PARAMS, (sample.frames, READ))
    assert found.coupled == known
    own = 0.0 if known else float(after @ after) * PERIOD  # the most that coupling by the vehicle's own inertia is
    np.testing.assert_allclose(found.mean[RATE], after, atol=1e-6 * np.abs(after - mean[RATE]).max() + own)
    assert found.noise[0, 0] >= own**2


def test_derivatives_agree_with_central_differences() -> None:
    state = some_state(PARAMS)
    sample = some_sample(PARAMS, speeds=READ)

    def after(mean: Array) -> Array:
        there = state._replace(mean=mean)
        around = sample.frames, READ
        return predict(there, driven(there, sample, PARAMS), unread(PARAMS), PARAMS, around).mean

    expected = central_differences(after, state.mean, 1e-4 * np.maximum(np.abs(state.mean), 1e-2))
    prediction = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS, (sample.frames, READ))
    found = propagated(np.eye(PLACES.size), prediction, PARAMS)[:, : PLACES.size]
    groups = (
        INERTIA,
        slice(6, 9),
        RATE,
        SLOW,
        slice(PLACES.wheel, PLACES.wheel + 3),
        slice(PLACES.scale, PLACES.scale + 1),
    )
    for group in groups:  # what the bows of the rate depend on is left out
        scale = np.abs(expected[RATE, group]).max()
        np.testing.assert_allclose(found[RATE, group] / scale, expected[RATE, group] / scale, atol=5e-3)
    assert np.abs(expected[RATE, PLACES.wheel]).max() > 1e-5
    assert np.abs(expected[RATE, PLACES.scale]).max() > 1e-5


def test_what_readings_are_off_by_is_taken_back_with_the_next() -> None:
    """Errors of readings at both ends, as states have them, give the motion at the true speeds."""
    mean, errors = resting(), (np.array([0.5, -1.0, 2.0]), np.array([-1.5, 0.3, 1.0]))
    true = tuple(read - error * WHEELS.speed_std for read, error in zip((START, END), errors, strict=True))
    mean[SLOW] = errors[0]
    state = some_state(PARAMS)._replace(mean=mean, level=np.zeros(6))
    state = state._replace(root=1e-3 * state.root)
    sample = some_sample(PARAMS, commands=STILL, outside=np.zeros(6), speeds=READ)
    after = turned(mean[RATE], (true[0], true[1]))
    found = predict(state, driven(state, sample, PARAMS), read_as(after, PARAMS), PARAMS, (sample.frames, READ))
    rate = found.mean[RATE] + found.wander.drawn[:3] @ errors[1]
    plain = turned(mean[RATE], (START, END))
    np.testing.assert_allclose(rate - plain, after - plain, atol=2e-3 * np.abs(after - plain).max())
    np.testing.assert_array_equal(found.mean[SLOW], np.zeros(3))
    np.testing.assert_array_equal(found.wander.along, np.ones(3))


def test_a_speed_that_is_not_read_counts_as_the_last_and_may_have_become_any() -> None:
    speeds, last = spun(START, np.array([1.0, np.nan, 2.0]), PERIOD, WHEELS)
    np.testing.assert_array_equal(last, [1.0, -70.0, 2.0])
    np.testing.assert_array_equal(speeds.end, last)
    np.testing.assert_array_equal(speeds.kept, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(speeds.drawn, [1.0, 50.0 * PERIOD / 0.02, 1.0])
    first, last = spun(np.full(3, np.nan), np.array([1.0, np.nan, 2.0]), PERIOD, WHEELS)
    np.testing.assert_array_equal(first.start, first.end)
    np.testing.assert_array_equal(last, [1.0, np.nan, 2.0])
    assert not turn_by(first, WHEELS)
    assert turn_by(READ, WHEELS)


def test_after_a_gap_readings_have_new_errors() -> None:
    state = some_state(PARAMS)._replace(time_s=1.0)
    missing = READ._replace(kept=np.array([0.0, 1.0, 0.0]))
    after = begun(state, some_sample(PARAMS, time_s=3.0, speeds=missing), PARAMS)
    sigmas = np.sqrt(np.sum(after.root[SLOW] ** 2, axis=1))
    np.testing.assert_allclose(sigmas, [1.0, 1e3 / 0.02, 1.0])
    np.testing.assert_array_equal(after.mean[SLOW], np.zeros(3))
