"""Engines in the joint filter: against the equations of motion, differences, and what commands and readings tell."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import (
    INVERSE,
    PERIOD,
    central_differences,
    derivatives,
    read_as,
    small_params,
    some_sample,
    some_state,
    unread,
)
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from massprop_drake.maths.estimation.joint.burns import Burn, at_rest, burnt, push
from massprop_drake.maths.estimation.joint.joint_cycle import driven, initial
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, MASS, RATE, VELOCITY, make_places
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.engine_thrust import NO_ENGINES, EngineParams, follow

DIRECTION = np.array([0.0, 0.6, 0.8])
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
SIGMAS = np.array([0.01, 0.01, 0.02, 0.02, 0.01, 0.01])
ENGINES = EngineParams(
    positions=np.array([[0.3, -0.5, -1.2]]),
    directions=DIRECTION[None],
    axes=AXES[None],
    normals=AXES[None],
    thrusts=np.array([8.0]),
    levels=np.array([0.0, 0.5, 1.0]),
    flows=np.array([[0.0, 2e-3, 5e-3]]),
    read_std=np.array([[0.002, 0.001, 0.001]]),
    rates=np.array([[0.5, 0.1, 0.1]]),
    constants_s=np.array([[0.0, 0.2, 0.0]]),
    stops=np.array([[1.0, 0.2, 0.2]]),
    least=np.zeros(1),
    measured=np.ones(1),
)
PARAMS = small_params(
    places=make_places((6, 2, 2, 0, 0, 0, 1), 2, (True, True), True, 2, ticks=2),
    prior_sigma=np.concatenate((np.ones(6 + 2 + 6 + 6), SIGMAS, np.zeros(1 + 2 + 2))),
    engines=ENGINES,
    second_order=False,
)
PLACES = PARAMS.places
OWN = slice(PLACES.engine, PLACES.engine + PLACES.n_engine)
READ = Burn(np.array([[[0.6, 0.05, -0.08], [0.65, 0.06, -0.07], [0.7, 0.07, -0.06]]]), np.full((1, 3), 1e-3))
ERRORS = np.array([0.02, -0.03, 0.04, -0.02, 0.05, -0.03])
STILL = np.zeros((1, 6))


def wrench(level: float, angles: Array, errors: Array) -> Array:
    """Torque about the vehicle origin and force, by scipy's rotations."""
    outer = Rotation.from_rotvec(AXES[0] * (angles[0] + errors[2]))
    along = (outer * Rotation.from_rotvec(AXES[1] * (angles[1] + errors[3]))).apply(DIRECTION)
    force = 8.0 * level * (1.0 + errors[0] * (1.0 - level) + errors[1] * level) * along
    place = ENGINES.positions[0] + errors[4] * AXES[0] + errors[5] * AXES[1]
    return np.concatenate((np.cross(place, force), force))


def test_impulse_is_the_integral_of_the_turned_force() -> None:
    def flow(time_s: float, _: Array) -> Array:
        share = time_s / PERIOD
        return wrench(0.6 + 0.1 * share, np.array([0.05 + 0.02 * share, -0.08 + 0.02 * share]), ERRORS)

    expected = solve_ivp(flow, (0.0, PERIOD), np.zeros(6), rtol=1e-12, atol=1e-14).y[:, -1]
    found = push(READ, ERRORS, PERIOD, ENGINES)
    np.testing.assert_allclose(found.impulse, expected, rtol=1e-6)
    levels = np.array([0.6, 0.65, 0.7])
    np.testing.assert_allclose(found.used, PERIOD * (2e-3 + (levels.mean() - 0.5) / 0.5 * 3e-3))


def test_derivatives_of_the_impulse_agree_with_central_differences() -> None:
    expected = central_differences(lambda errors: push(READ, errors, PERIOD, ENGINES).impulse, ERRORS, np.full(6, 1e-4))
    np.testing.assert_allclose(push(READ, ERRORS, PERIOD, ENGINES).by_errors.T, expected, atol=1e-8)


def test_noise_is_that_of_level_and_angles_over_the_whole_interval() -> None:
    def shifted(offsets: Array) -> Array:
        return push(Burn(READ.points + offsets, READ.std), np.zeros(6), PERIOD, ENGINES).impulse

    by_offsets = central_differences(shifted, np.zeros(3), np.full(3, 1e-4))
    found = push(READ, np.zeros(6), PERIOD, ENGINES).noise
    np.testing.assert_allclose(found, 1e-3 * by_offsets.T, atol=1e-9)
    shut = Burn(np.zeros((1, 3, 3)), np.array([[0.0, 1.0, 1.0]]))
    assert not push(shut, ERRORS, PERIOD, ENGINES).noise.any()


def test_the_vehicle_moves_as_the_equations_of_motion_have_it() -> None:
    mean = some_state(PARAMS).mean.copy()
    mean[13:] = 0.0
    mean[RATE], mean[INERTIA], mean[OWN] = [0.05, -0.04, 0.03], initial(PARAMS).mean[INERTIA], ERRORS
    inertia, center, start_s = np.linalg.inv(INVERSE), mean[CENTER], 1.0 / mean[MASS]

    def flow(time_s: float, state: Array) -> Array:
        share = time_s / PERIOD
        acting = wrench(0.6 + 0.1 * share, np.array([0.05 + 0.02 * share, -0.08 + 0.02 * share]), ERRORS)
        rate, torque = state[:3], acting[:3] - np.cross(center, acting[3:])
        return np.concatenate((INVERSE @ (torque - np.cross(rate, inertia @ rate)), acting[3:] / start_s))

    after = solve_ivp(flow, (0.0, PERIOD), np.append(mean[RATE], np.zeros(3)), rtol=1e-11, atol=1e-14).y[:, -1]
    state = some_state(PARAMS)._replace(mean=mean, level=np.zeros(6))
    state = state._replace(root=1e-3 * state.root)
    sample = some_sample(PARAMS, commands=STILL, burn=READ)
    acting = driven(state, sample, PARAMS)
    found = predict(state, acting, read_as(after[:3], PARAMS), PARAMS)
    changed = np.abs(after[:3] - mean[RATE]).max()
    np.testing.assert_allclose(found.mean[RATE], after[:3], atol=1e-4 * changed)  # the level's rise bows the rate
    used = acting.engines.used * mean[MASS]
    grown = found.mean[VELOCITY : VELOCITY + 3] - 0.5 * used * after[3:]  # the mass falls as it burns
    turned = found.rate_rows[:, OWN]
    np.testing.assert_allclose(grown, after[3:], atol=2e-3 * np.abs(after[3:]).max())
    assert np.abs(turned).max() > 1e-3


def test_derivatives_agree_with_central_differences() -> None:
    state = some_state(PARAMS)
    mean = state.mean.copy()
    mean[OWN] *= 0.1
    state, sample = state._replace(mean=mean), some_sample(PARAMS, burn=READ)
    found, expected = derivatives(state, sample, PARAMS)
    rows = ((RATE, 5e-3), (slice(VELOCITY, VELOCITY + 3), 2e-2))  # in the latter the turning is by rates to be read
    for group in (INERTIA, CENTER, slice(MASS, MASS + 1), OWN, slice(PLACES.scale, PLACES.scale + 1)):
        for row, least in rows:
            scale = np.abs(expected[row, group]).max()
            if scale > 0.0:
                np.testing.assert_allclose(found[row, group] / scale, expected[row, group] / scale, atol=least)


def test_products_of_errors_count() -> None:
    """Mean and covariance of the products of an engine's errors with those of the center of mass, by drawn errors."""
    params = PARAMS._replace(second_order=True)
    state = some_state(params)
    root = 0.0 * state.root
    rng = np.random.default_rng(3)
    rows = [*range(6, 9), *range(OWN.start, OWN.stop)]
    root[rows] = 0.02 * rng.standard_normal((len(rows), root.shape[1])) / np.sqrt(root.shape[1])
    state = state._replace(root=root)
    sample = some_sample(params, commands=STILL, burn=READ)

    def change(errors: Array) -> Array:
        there = state._replace(mean=state.mean + errors, root=0.0 * root)
        return predict(there, driven(there, sample, params), unread(params), params).mean[RATE]

    found = predict(state, driven(state, sample, params), unread(params), params)
    drawn = root @ rng.standard_normal((root.shape[1], 300))
    straight = change(np.zeros(root.shape[0]))
    alone = np.zeros((root.shape[0], 1))
    alone[OWN] = 1.0
    left = np.array(
        [change(one) - change(one * alone[:, 0]) - change(one * (1.0 - alone[:, 0])) + straight for one in drawn.T]
    )
    np.testing.assert_allclose(found.mean[RATE] - straight, left.mean(axis=0), atol=4.0 * left.std(axis=0).max() / 17.0)
    plain = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS)
    added = np.diag(found.noise[:3, :3] - plain.noise[:3, :3])
    np.testing.assert_allclose(added, left.var(axis=0), rtol=0.4)


def test_what_is_commanded_follows_with_a_lag_and_at_most_at_a_rate() -> None:
    now, told, constants_s, rates = np.zeros(3), np.array([1.0, 0.05, -0.3]), np.array([0.0, 0.2, 0.1]), np.full(3, 0.5)
    engines = ENGINES._replace(constants_s=constants_s[None], rates=rates[None])

    def flow(_: float, at: Array) -> Array:
        off = told - at[:3]
        lagged = np.where(constants_s > 0.0, off / np.maximum(constants_s, 1e-12), np.sign(off) * 1e9)
        return np.concatenate((np.clip(lagged, -rates, rates), at[:3]))

    for during_s in (0.05, 0.3, 0.9):
        course = solve_ivp(flow, (0.0, during_s), np.append(now, now), rtol=1e-9, atol=1e-11, max_step=1e-3).y[:, -1]
        end, mean = follow(now[None], told[None], during_s, engines)
        np.testing.assert_allclose(end[0], course[:3], atol=1e-4)
        np.testing.assert_allclose(mean[0], course[3:] / during_s, atol=1e-4)
    np.testing.assert_allclose(follow(now[None], told[None], 9.0, engines)[0], told[None], atol=1e-12)


@pytest.mark.parametrize("measured", [True, False])
def test_readings_are_what_is_or_what_is_to_be(measured: bool) -> None:
    engines = ENGINES._replace(measured=np.array([1.0 if measured else 0.0]), rates=np.full((1, 3), 100.0))
    engines = engines._replace(constants_s=np.zeros((1, 3)))
    first, setting = burnt(at_rest(1), np.array([[0.5, 0.1, 0.0]]), PERIOD, engines)
    assert first.points[0, -1, 0] == (0.5 if measured else 0.0)
    second, setting = burnt(setting, np.full((1, 3), np.nan), PERIOD, engines)
    np.testing.assert_allclose(second.points[0, -1], [0.5, 0.1, 0.0], atol=1e-6)
    third, _ = burnt(setting, np.full((1, 3), np.nan), PERIOD, engines)
    lost_s = 2.0 * PERIOD if measured else 0.0  # a command holds
    np.testing.assert_allclose(third.std, np.hypot(engines.read_std * [[0.5, 1.0, 1.0]], engines.rates * lost_s))


def test_the_mean_of_what_follows_is_that_of_the_rule() -> None:
    """Simpson's rule has the mean of a level that jumps as the interval begins."""
    engines = ENGINES._replace(measured=np.zeros(1), rates=np.full((1, 3), 1e4), constants_s=np.zeros((1, 3)))
    _, setting = burnt(at_rest(1), np.array([[0.5, 0.1, 0.0]]), PERIOD, engines)
    burn, _ = burnt(setting, np.array([[0.5, 0.1, 0.0]]), PERIOD, engines)
    np.testing.assert_allclose(np.array([1.0, 4.0, 1.0]) @ burn.points[0] / 6.0, [0.5, 0.1, 0.0], atol=1e-3)


def test_when_a_level_has_moved_between_readings_is_not_known() -> None:
    engines = ENGINES._replace(rates=np.array([[10.0 / PERIOD, 1.0, 1.0]]))
    burn, _ = burnt(at_rest(1), np.array([[0.5, 0.0, 0.0]]), PERIOD, engines)
    np.testing.assert_allclose(burn.std[0, 0], 0.5 / np.sqrt(12.0) * 0.95, rtol=1e-3)
    slow, _ = burnt(
        at_rest(1), np.array([[0.5, 0.0, 0.0]]), PERIOD, engines._replace(rates=np.full((1, 3), 0.5 / PERIOD))
    )
    assert slow.std[0, 0] < 1e-3


def test_an_engine_that_was_never_read_is_shut() -> None:
    burn, setting = burnt(at_rest(1), np.full((1, 3), np.nan), PERIOD, ENGINES)
    burn, _ = burnt(setting, np.full((1, 3), np.nan), PERIOD, ENGINES)
    assert not push(burn, np.zeros(6), PERIOD, ENGINES).noise.any()


def test_without_engines_nothing_is_given() -> None:
    burn, setting = burnt(at_rest(0), np.zeros((0, 3)), PERIOD, NO_ENGINES)
    assert push(burn, np.zeros(0), PERIOD, NO_ENGINES).used == 0.0
    assert setting.now.shape == (0, 3)
