"""Prediction over an interval: its linearization against differences, its mean against an integrated rigid body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, Sensors, moved, pulses, small_params, some_bank
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseBank, PoseParams
from massprop_drake.maths.estimation.pose.pose_prediction import Predicted, predict_bank
from massprop_drake.maths.linear_algebra import Array

BEGIN_S, END_S = 1.0, 1.1
SPAN_S = END_S - BEGIN_S
_SMALL = 1e-14


OUTSIDE = np.array([0.03, -0.05, 0.08, 0.2, -0.3, 0.1])


def _after(bank: PoseBank, params: PoseParams) -> Predicted:
    outside = OUTSIDE if params.of_mass.any() else None
    return predict_bank(bank, pulses()._replace(outside=outside), BEGIN_S, END_S, params)


def differences(bank: PoseBank, params: PoseParams) -> Array:
    """Derivatives of what is free by what was free before, central differences, shape (n_filters, n, n)."""
    turn, step = params.parts.attitude, 1e-6
    columns = []
    for place in params.free:
        ahead, behind = (_after(moved(bank, params, place, by), params).bank for by in (step, -step))
        change = ahead.mean - behind.mean
        between = np.swapaxes(behind.rotation, 1, 2) @ ahead.rotation
        change[:, turn] = Rotation.from_matrix(between).as_rotvec()
        columns.append(change[:, params.free] / (2.0 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("outside", [False, True], ids=["alone", "pushed"])
@pytest.mark.parametrize("planar", [False, True], ids=["free", "planar"])
def test_every_derivative_is_a_difference_of_the_mean(planar: bool, outside: bool) -> None:
    params = small_params(Sensors(poses=2, gyros=1, accelerometers=2), planar=planar)
    if outside:
        weights = np.zeros(params.parts.size)
        weights[params.parts.thrust], weights[params.parts.common] = 0.2, -0.8
        params = params._replace(of_mass=weights)
    bank = some_bank(params, opens=(-1, 2, 0, PUSHED))
    bank.mean[:, params.parts.pulse] = 0.1, -0.2, 0.05, 0.15
    done = _after(bank._replace(covariance=_SMALL * bank.covariance), params)  # so that no product of errors shows
    found, expected = done.through, differences(bank._replace(covariance=np.zeros_like(bank.covariance)), params)
    carried = found @ bank.covariance @ np.swapaxes(found, 1, 2)
    np.testing.assert_allclose(done.bank.covariance / _SMALL, carried, rtol=0, atol=1e-12)
    parts, free = params.parts, params.free
    rows = {
        name: (free >= part.start) & (free < part.stop) for name, part in zip(parts._fields, parts[:-1], strict=False)
    }
    checked = 0
    for row, in_row in rows.items():
        for column, in_column in rows.items():
            if not (in_row.any() and in_column.any()):
                continue
            own, hand = found[:, in_row][..., in_column], expected[:, in_row][..., in_column]
            # of the turn within an interval, .02 rad here, the first order is taken
            tolerance = 0.01 if row in ("rate", "attitude") or column == "rate" else 1e-6
            tolerance = tolerance * np.abs(hand).max() + 1e-8
            np.testing.assert_allclose(own, hand, rtol=0, atol=tolerance, err_msg=f"{row} by {column}")
            checked += int(np.abs(hand).max() > 1e-6)
    assert checked >= 60  # blocks that are not zero


def _flown(params: PoseParams, bank: PoseBank, on: Array, outside: Array) -> tuple[Array, Array, Array, Array]:
    """Position, velocity, rotation and rate of a rigid body with jets that are on all the time, finely integrated."""
    parts, mean = params.parts, bank.mean[0]
    spin = mean[parts.spin][[0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(3, 3)
    inertia = np.linalg.inv(spin)
    force = (on * mean[parts.thrust]) @ params.pushes
    moment = np.cross(params.positions - mean[parts.center], params.pushes * (on * mean[parts.thrust])[:, None]).sum(0)
    linear, angular = mean[parts.drag]
    inverse = (1.0 + (mean - params.start) @ params.of_mass) / params.nominal_mass
    force = force + inverse * outside[3:]
    moment = moment + inverse * (outside[:3] - np.cross(mean[parts.center], outside[3:]))

    def rates(_: float, y: Array) -> Array:
        rotation = Rotation.from_quat(y[6:10])
        velocity, rate = y[3:6], y[10:]
        acceleration = rotation.apply(force) - linear * velocity + mean[parts.push][:3]
        heading = np.arctan2(rotation.as_matrix()[1, 0], rotation.as_matrix()[0, 0])
        turned = mean[parts.push][3:] + np.eye(3)[2] * (mean[parts.tilt] @ (np.cos(heading), np.sin(heading)))
        gyroscopic = spin @ np.cross(rate, inertia @ rate)
        swing = 0.5 * (rotation * Rotation.from_quat([*rate, 0.0])).as_quat() * np.linalg.norm(rate)
        return np.concatenate((velocity, acceleration, swing, spin @ moment - gyroscopic - angular * rate + turned))

    first = np.concatenate(
        (mean[parts.position], mean[parts.velocity], Rotation.from_matrix(bank.rotation[0]).as_quat(), mean[parts.rate])
    )
    last = solve_ivp(rates, (0.0, SPAN_S), first, rtol=1e-11, atol=1e-13).y[:, -1]
    return last[:3], last[3:6], Rotation.from_quat(last[6:10]).as_matrix(), last[10:]


@pytest.mark.parametrize("outside", [np.zeros(6), OUTSIDE], ids=["alone", "pushed"])
def test_free_motion_is_that_of_an_integrated_rigid_body(outside: Array) -> None:
    params = small_params(Sensors(poses=1))
    weights = np.zeros(params.parts.size)
    weights[params.parts.thrust] = 0.2
    params = params._replace(of_mass=weights)
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, params.parts.rate] = 0.2, -0.15, 0.25  # 2 deg in the interval
    bank.mean[0, params.parts.drag] = 0.06, 0.04  # of what jets add in the interval it takes nothing: 3 in 1000
    bank = bank._replace(covariance=np.zeros_like(bank.covariance))
    on = np.array([1.0, 0.0, 1.0, 0.0])
    after = predict_bank(bank, Commands(np.array([-5.0]), on[None], outside), BEGIN_S, END_S, params).bank
    position, velocity, rotation, rate = _flown(params, bank, on, outside)
    parts, mean = params.parts, after.mean[0]
    first = bank.mean[0]
    # what turns while it turns is of third order in a tenth of a second: some parts in a thousand of what changes
    for part, true in ((parts.velocity, velocity), (parts.position, position), (parts.rate, rate)):
        change = true - first[part]
        np.testing.assert_allclose(mean[part] - first[part], change, rtol=0, atol=5e-3 * np.abs(change).max())
    off = Rotation.from_matrix(after.rotation[0].T @ rotation).magnitude()
    assert off < 5e-3 * Rotation.from_matrix(bank.rotation[0].T @ rotation).magnitude()


def test_accelerometers_gather_what_is_no_gravity_in_body_axes() -> None:
    params = small_params(Sensors(accelerometers=1))
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, params.parts.drag] = 0.0
    bank = bank._replace(covariance=np.zeros_like(bank.covariance))
    bank.mean[0, params.parts.push] = 0.3  # of a table that is off level: not felt
    on = np.array([1.0, 0.0, 0.0, 1.0])
    after = predict_bank(bank, Commands(np.array([-5.0]), on[None]), BEGIN_S, END_S, params).bank
    parts, mean = params.parts, bank.mean[0]
    felt = SPAN_S * ((on * mean[parts.thrust]) @ params.pushes + mean[parts.acceleration_bias])
    np.testing.assert_allclose(after.mean[0, parts.gathered] - mean[parts.gathered], felt, rtol=1e-12)
    middle = 0.5 * (mean[parts.rate] + after.mean[0, parts.rate])
    np.testing.assert_allclose(after.turned[0] - bank.turned[0], SPAN_S * np.outer(middle, middle), atol=1e-15)


def test_products_of_errors_have_the_moments_of_drawn_ones() -> None:
    random = np.random.default_rng(5)
    params = small_params()
    parts, free = params.parts, params.free
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, parts.rate] = 0.0
    spread = np.zeros((free.size, free.size))
    uncertain = [*range(parts.spin.start, parts.spin.stop), *range(JETS)]  # K and thrusts, all correlated
    root = random.standard_normal((len(uncertain), len(uncertain))) / np.sqrt(len(uncertain))
    root[:6] *= 0.3 * params.start[parts.spin][:3].mean()
    root[6:] *= 0.4
    spread[np.ix_(uncertain, uncertain)] = root @ root.T
    on = Commands(np.array([-5.0]), np.array([[1.0, 0.0, 1.0, 1.0]]))
    done = predict_bank(bank._replace(covariance=spread[None]), on, BEGIN_S, END_S, params).bank

    drawn = random.standard_normal((60_000, len(uncertain))) @ root.T
    mean = bank.mean[0]
    spins = (mean[parts.spin] + drawn[:, :6])[:, [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(-1, 3, 3)
    factors = (mean[parts.thrust] + drawn[:, 6:]) * on.levels[0] * SPAN_S
    moments = factors @ np.cross(params.positions - mean[parts.center], params.pushes)
    turned = np.einsum("nij,nj->ni", spins, moments)
    certain = predict_bank(bank._replace(covariance=0.0 * spread[None]), on, BEGIN_S, END_S, params).bank
    bias = (done.mean - certain.mean)[0, parts.rate]
    sampled = turned.mean(axis=0) - (certain.mean[0, parts.rate] - mean[parts.rate] * np.exp(-0.2 * SPAN_S))
    sampled = sampled + SPAN_S * mean[parts.push][3:]
    deviation = turned.std(axis=0)
    np.testing.assert_allclose(bias, sampled, atol=5.0 * deviation.max() / np.sqrt(drawn.shape[0]))
    assert np.abs(bias).max() > 20.0 * deviation.max() / np.sqrt(drawn.shape[0])  # it shows
    found = done.covariance[0][np.ix_(*[np.flatnonzero((free >= parts.rate.start) & (free < parts.rate.stop))] * 2)]
    np.testing.assert_allclose(found, np.cov(turned.T), atol=0.02 * deviation.max() ** 2)
    linear = _after(bank, params).through[0]
    first_order = (linear @ spread @ linear.T)[parts.rate, parts.rate]
    assert np.abs(found - first_order).max() > 0.05 * deviation.max() ** 2  # without the products it is missed


def _noisy(**more: Any) -> PoseParams:
    noise = {"rate_noise": 0.01, "velocity_noise": 0.02}
    walks = {"push_walk": 1e-3, "turn_walk": 2e-3, "common_walk": 0.01}
    return small_params(Sensors(accelerometers=2), **(noise | walks | more))


def _added(params: PoseParams, commands: Commands | None = None) -> Array:
    """Covariance of the whole state after an interval, of one that was known exactly."""
    bank = some_bank(params, opens=(-1, 2))
    bank = bank._replace(covariance=np.zeros_like(bank.covariance))
    return predict_bank(bank, pulses() if commands is None else commands, BEGIN_S, END_S, params).bank.covariance


def test_white_accelerations_are_those_of_a_wiener_process_and_its_integral() -> None:
    params = _noisy(common_walk=0.0, push_walk=0.0, turn_walk=0.0)
    found, parts = _added(params)[0], params.parts
    for once, twice, density in ((parts.velocity, parts.position, 4e-4), (parts.rate, parts.attitude, 1e-4)):
        np.testing.assert_allclose(found[once, once], density * SPAN_S * np.eye(3), rtol=1e-12)
        np.testing.assert_allclose(found[once, twice], density * SPAN_S**2 / 2.0 * np.eye(3), rtol=1e-12)
        np.testing.assert_allclose(found[twice, twice], density * SPAN_S**3 / 3.0 * np.eye(3), rtol=1e-12)


def test_an_accelerometer_feels_what_changes_the_velocity() -> None:
    params = _noisy(kicks_per_s=0.1, kick_velocity=0.3, kick_rate=0.1)
    bank, parts = some_bank(params, opens=(-1,)), params.parts
    bank = bank._replace(covariance=np.zeros_like(bank.covariance))
    ahead = predict_bank(bank, pulses(), BEGIN_S, END_S, params)
    turn = bank.rotation[0] @ Rotation.from_rotvec(0.5 * SPAN_S * bank.mean[0, parts.rate]).as_matrix()
    for found in (ahead.bank.covariance[0], ahead.kick[0] @ ahead.kick[0].T):
        first, second = (slice(begin, begin + 3) for begin in range(parts.gathered.start, parts.gathered.stop, 3))
        own = found[parts.velocity, parts.velocity]
        for felt in (found[first, first] @ turn.T, found[first, parts.velocity]):
            np.testing.assert_allclose(turn @ felt, own, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found[first, second], found[first, first], atol=1e-12)


def test_a_pulse_scatters_as_a_whole_until_the_next_one_opens() -> None:
    """Of what one jet gives in two intervals: errors add up within a pulse, and are independent of the next one."""
    params = small_params(pulse_scatter=np.full(JETS, 0.2))
    parts = params.parts
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, parts.rate] = 0.0
    bank = bank._replace(covariance=np.zeros_like(bank.covariance))
    whole, two = ([(0.0, 1), (0.9, 0)], [(0.0, 1), (0.37, 0), (0.45, 1), (0.9, 0)])
    spreads = []
    for switches in (whole, two):
        levels = np.outer([level for _, level in switches], np.eye(JETS)[0])
        commands = Commands(np.array([time_s for time_s, _ in switches]), levels)
        now = predict_bank(bank, commands, -0.1, 0.4, params).bank
        now = predict_bank(now, commands, 0.4, 0.8, params).bank
        spreads.append(np.sqrt(np.trace(now.covariance[0][parts.velocity, parts.velocity])))
    size = np.linalg.norm(bank.mean[0, 0] * params.pushes[0])
    delay_s, late_s = bank.mean[0, [parts.delay.start, parts.opening.start]]
    lag_s = np.exp(bank.mean[0, parts.lag.start])
    on_s = 0.8 - delay_s - late_s - lag_s  # of what has been given by then
    assert spreads[0] == pytest.approx(0.2 * size * on_s, rel=0.02)
    first_s, second_s = 0.37 - late_s, 0.35 - delay_s - late_s - lag_s
    assert spreads[1] == pytest.approx(0.2 * size * np.hypot(first_s, second_s), rel=0.06)


def test_the_common_scale_takes_all_factors_with_it() -> None:
    params = small_params(common_walk=0.01)
    found, parts = _added(params, Commands(np.zeros(0), np.zeros((0, JETS))))[0], params.parts
    factors = some_bank(params).mean[0, parts.thrust]
    places = [*range(JETS), parts.common.start]
    own = 0.01 * np.sqrt(SPAN_S) * np.append(factors, 1.0)
    np.testing.assert_allclose(found[np.ix_(places, places)], np.outer(own, own), rtol=1e-12)
