"""The joint prediction: against differences, the body's equations of motion, and sampling."""

from __future__ import annotations

from typing import Any

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

from massprop_drake.maths.estimation.joint.lagged_impulses import Firing, effects_of
from massprop_drake.maths.estimation.joint.layout import JointState
from massprop_drake.maths.estimation.joint.prediction import (
    RateRead,
    coupling,
    drive,
    error_rows,
    gathered_rows,
    largest_coupling,
    predict,
    propagated,
    turning,
)
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, MassProperties, six_elements, symmetric
from massprop_drake.maths.vehicle import rigid_body

PARAMS = small_params(second_order=False)
PLACES = PARAMS.places
SAMPLE = some_sample(PARAMS, outside=np.array([0.01, -0.02, 0.03, 0.02, 0.01, -0.03]))
UNREAD = unread(PARAMS)


def test_the_rate_at_the_end_is_the_mean_of_prediction_and_reading_by_their_variances() -> None:
    state = some_state(PARAMS)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), PARAMS)
    alone = predict(state, acting, UNREAD, PARAMS)
    spread = np.sum(propagated(state.root, alone, PARAMS)[10:13] ** 2, axis=1)
    read = np.array([0.3, -0.2, np.nan])
    variance = np.array([spread[0], 4.0 * spread[1], np.inf])
    found = predict(state, acting, RateRead(read, np.zeros((3, PLACES.size)), variance), PARAMS)
    mean = (alone.end / spread + np.nan_to_num(read) / variance) / (1.0 / spread + 1.0 / variance)
    np.testing.assert_allclose(found.end, mean, atol=2e-3)  # but for the coupling, which that rate changes
    assert np.abs(found.end - alone.end)[:2].min() > 0.02


def test_an_error_of_the_rate_times_that_of_the_center_of_mass_is_noise_on_what_accelerometers_gather() -> None:
    state = some_state(PARAMS)
    state = state._replace(slot_jet=np.full_like(state.slot_jet, -1))
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), PARAMS)
    read = read_as(state.mean[10:13] + np.array([0.003, -0.001, 0.002]), PARAMS)._replace(variance=np.full(3, 1e-4))
    first = predict(state, acting, read, PARAMS)
    both = predict(state, acting, read, PARAMS._replace(second_order=True))
    spread = np.sum(propagated(state.root, first, PARAMS)[10:13] ** 2, axis=1)
    left = (1.0 / (1.0 / spread + 1e4)).max()
    added = (both.noise - first.noise)[3:, 3:]
    np.testing.assert_allclose(added, left * np.sum(state.root[6:9] ** 2) * np.eye(3), rtol=0.02, atol=1e-12 * left)


def predicted_mean(mean: Array, state: JointState, rate_read: RateRead) -> Array:
    """Rate, c of both accelerometers with what the interval has turned them by, and mu after it.

    Bows are left out, as their derivatives are. The arm of what is turned stays: it is in the outputs' derivative.
    """
    arms = PARAMS.accelerometer_positions - state.mean[6:9]
    state = state._replace(mean=mean)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), PARAMS)
    acting = acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))
    found = predict(state, acting, rate_read, PARAMS)
    turned = turning(np.zeros(3), np.zeros(3), found.spin)
    both = found.mean[13:19].reshape(2, 3) + arms @ turned.T
    return np.concatenate([found.mean[10:13], both.ravel(), found.mean[9:10]])


@pytest.mark.parametrize("read", [1.0, 0.6, 0.0])
def test_jacobian_agrees_with_central_differences(read: float) -> None:
    state = some_state(PARAMS)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), PARAMS)
    end = predict(state, acting, UNREAD, PARAMS).end + np.array([3e-6, -1e-6, 2e-6])  # what is read, about
    rate_read = read_as(end, PARAMS) if read else UNREAD
    if 0.0 < read < 1.0:  # the reading corrects the rate by about that share
        spread = np.sum(state.root[10:13] ** 2, axis=1)
        rate_read = rate_read._replace(variance=spread * (1.0 / read - 1.0))
    acting = acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))
    prediction = predict(state, acting, rate_read, PARAMS)
    size = PLACES.size
    expected = np.zeros((10, size))
    expected[:3], expected[:3, 10:13] = prediction.rate_rows, np.eye(3) + prediction.rate_rows[:, 10:13]
    for package in range(2):
        rows = slice(3 + 3 * package, 6 + 3 * package)
        expected[rows] = gathered_rows(prediction, package)
        expected[rows, 13 + 3 * package : 16 + 3 * package] += np.eye(3)
        bias = PLACES.acceleration_bias + 3 * package
        expected[rows, bias : bias + 3] += PERIOD * PARAMS.acceleration_bias_sigma * np.eye(3)
    expected[9, 9] = prediction.mass_factor
    steps = 1e-5 * np.maximum(np.abs(state.mean), 1e-2)
    found = central_differences(lambda mean: predicted_mean(mean, state, rate_read), state.mean, steps)
    # what flows by thrust errors and forces is left out of mu's own row and, of second order, out of c's
    found[9, PLACES.thrust :] = 0.0
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-9)
    atol = 2e-4 if 0.0 < read < 1.0 else 1e-4  # where both count, the share depends on what is predicted
    np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-4, atol=atol)
    assert np.abs(expected[:3, :6] @ TRUTH[:6]).min() > 0.0


def test_coupling_and_its_derivatives() -> None:
    start, end = np.array([0.3, -0.4, 0.5]), np.array([0.35, -0.3, 0.45])
    inertia = np.linalg.inv(INVERSE)
    bow = np.zeros((3, 3))
    found = coupling((INVERSE, inertia), (start, end), np.zeros((2, 3)), bow, PERIOD)
    # by Gauss-Legendre, exact for a product of two straight lines
    nodes = 0.5 + 0.5 * np.polynomial.legendre.leggauss(3)[0]
    weights = 0.5 * np.polynomial.legendre.leggauss(3)[1]
    exact = np.zeros(3)
    for node, weight in zip(nodes, weights, strict=True):
        rate = start + node * (end - start)
        exact -= weight * PERIOD * INVERSE @ np.cross(rate, inertia @ rate)
    np.testing.assert_allclose(found[0], exact, rtol=1e-13)

    def by_inertia(elements: Array) -> Array:
        inverse = symmetric(elements)
        return coupling((inverse, np.linalg.inv(inverse)), (start, end), np.zeros((2, 3)), bow, PERIOD).change

    six, steps = six_elements(INVERSE), np.full(6, 1e-6)
    np.testing.assert_allclose(found[1], central_differences(by_inertia, six, steps), atol=1e-9)
    for index, at in ((2, start), (3, end)):

        def by_rate(rate: Array, index: int = index) -> Array:
            ends = (rate, end) if index == 2 else (start, rate)
            return coupling((INVERSE, inertia), tuple(ends), np.zeros((2, 3)), bow, PERIOD).change

        np.testing.assert_allclose(found[index], central_differences(by_rate, at, np.full(3, 1e-6)), atol=1e-9)


def flown(state: JointState, factor: float) -> tuple[Array, Array, Array]:
    """Truth of the interval by the equations of motion: rate after, spin integral, and what c gathers."""
    inertia = np.linalg.inv(INVERSE)
    properties = MassProperties(10.0, TRUTH[6:9], inertia)
    body = rigid_body.initial_state(10.0)
    body[rigid_body.RATE] = state.mean[10:13]
    seven = np.column_stack([factor * PARAMS.wrenches, np.zeros(6)])
    steady = SAMPLE.commands[0] @ seven
    transient = np.array([(state.level - SAMPLE.commands[0])[part] @ seven[part] for part in (slice(3), slice(3, 6))])
    after = rigid_body.step(body, steady, transient, (0.015, 0.03), PERIOD, rigid_body.body_of(properties))
    center = np.cross(after[rigid_body.RATE] - state.mean[10:13], TRUTH[6:9])
    spin = after[rigid_body.SPIN_INTEGRAL]
    xx, yy, zz, yz, xz, xy = spin
    turn = np.array([[-(yy + zz), xy, xz], [xy, -(xx + zz), yz], [xz, yz, -(xx + yy)]])
    return after[rigid_body.RATE], spin, after[rigid_body.ORIGIN_VELOCITY] + center + turn @ TRUTH[6:9]


def exact_state(levels: float) -> JointState:
    """A state at the truth: no thrust error, no failure, jets half built up."""
    state = some_state(PARAMS)
    mean = state.mean.copy()
    mean[13:] = 0.0
    mean[10:13] = [0.5, -0.4, 0.3]
    return state._replace(mean=mean, level=levels * state.level)


def test_prediction_at_the_truth_is_the_motion() -> None:
    """The bow takes nearly all of what a straight line leaves."""
    state = exact_state(1.0)
    factor = 3.0
    params = PARAMS._replace(wrenches=factor * PARAMS.wrenches, flows=np.zeros(6))
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, np.zeros(6), on_ticks(), params)
    rate, spin, gathered = flown(state, factor)
    straight = acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))
    errors, spins = [], []
    for each in (straight, acting):
        prediction = predict(state, each, read_as(rate, params), params)
        errors.append(np.abs(prediction.mean[10:13] - rate).max())
        np.testing.assert_allclose(prediction.mean[13:16], gathered, rtol=2e-2)
        spins.append(np.abs(prediction.spin - spin).max())
    through = np.abs(rate - state.mean[10:13]).max()
    assert errors[0] > 1e-4 * through
    assert errors[1] < 0.01 * errors[0]
    assert spins[1] < 0.01 * spins[0]


def test_a_vehicle_that_turns_fast_turns_on_as_torque_free_motion_has_it() -> None:
    """Without a reading: what a few rounds for the rate at the end leave would gather, sample by sample."""
    state = exact_state(0.0)
    mean = state.mean.copy()
    mean[10:13] = [0.25, -0.2, 0.15]
    state = state._replace(mean=mean)
    inertia = np.linalg.inv(INVERSE)
    acting = drive(state, SAMPLE.durations_s, 0.0 * SAMPLE.commands, np.zeros(6), on_ticks(), PARAMS)
    rate = mean[10:13]
    for _ in range(1000):  # Runge and Kutta's fourth order, in steps of a thousandth

        def turned(w: Array) -> Array:
            return np.asarray(-INVERSE @ np.cross(w, inertia @ w))

        h = PERIOD / 1000
        k1 = turned(rate)
        k2 = turned(rate + 0.5 * h * k1)
        k3 = turned(rate + 0.5 * h * k2)
        rate = rate + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + turned(rate + h * k3))
    turned_by = np.abs(rate - mean[10:13]).max()
    assert turned_by > 1e-3
    found = predict(state, acting, UNREAD, PARAMS)
    np.testing.assert_allclose(found.mean[10:13], rate, rtol=0.0, atol=1e-8 * turned_by)

    def after(start: Array) -> Array:
        known = mean.copy()
        known[10:13] = start
        return predict(state._replace(mean=known), acting, UNREAD, PARAMS).mean[10:13]

    slope = central_differences(after, mean[10:13], np.full(3, 1e-4))
    np.testing.assert_allclose(np.eye(3) + found.rate_rows[:, 10:13], slope, rtol=0.0, atol=1e-6)


def sampled(state: JointState, firing: Firing, draws: int) -> Array:
    """Products of errors of the ten parameters with one another and with thrust errors, sampled."""
    rng = np.random.default_rng(5)
    errors = state.root @ rng.standard_normal((state.root.shape[1], draws))
    share = PARAMS.thrust_sigma * firing.amount[:, None] * errors[PLACES.thrust : PLACES.thrust + 6]
    impulse, extra = firing.amount @ PARAMS.wrenches, share.T @ PARAMS.wrenches
    moment = extra[:, :3] + np.cross(extra[:, 3:], state.mean[6:9])
    inverse = errors[:6].T[:, ELEMENT]  # of each draw, shape (draws, 3, 3)
    both = np.einsum("nij,nj->ni", inverse, np.cross(impulse[3:], errors[6:9].T))
    thrust = np.einsum("nij,nj->ni", inverse, moment)
    thrust += np.cross(extra[:, 3:], errors[6:9].T) @ symmetric(state.mean[:6])
    return np.hstack([both + thrust, extra[:, 3:] * errors[9][:, None]])


def test_second_order_terms_are_the_moments_of_the_products() -> None:
    """Without the correlation of ten parameters and thrust errors, which the covariance leaves out, exactly."""
    params = small_params(second_order=True)
    state = some_state(params)
    root = np.zeros_like(state.root)
    size = root.shape[0]
    root[:10, :10] = np.tril(np.random.default_rng(1).standard_normal((10, 10))) * np.abs(TRUTH)[:, None] * 0.3
    root[PLACES.thrust : PLACES.thrust + 6] = np.eye(size)[PLACES.thrust : PLACES.thrust + 6]
    state = state._replace(root=root)
    mean = state.mean.copy()
    mean[10:] = 0.0
    state = state._replace(mean=mean)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, np.zeros(6), on_ticks(), params)
    read = read_as(np.zeros(3), params)  # what is not known of the rate is noise, too
    first = predict(state, acting, read, params._replace(second_order=False))
    second = predict(state, acting, read, params)
    draws = sampled(state, acting.firing, 40_000)
    bias = (second.mean - first.mean)[10:16]
    spread = np.sqrt(np.diag(second.noise))
    np.testing.assert_allclose(draws.mean(axis=0) / spread, bias / spread, atol=0.02)
    np.testing.assert_allclose(
        np.cov(draws.T) / np.outer(spread, spread), second.noise / np.outer(spread, spread), atol=0.05
    )


def test_products_with_thrust_errors_have_the_mean_of_their_correlation() -> None:
    params = small_params()
    state = some_state(params)
    mean = state.mean.copy()
    mean[10:] = 0.0
    root = state.root.copy()
    root[PLACES.thrust : PLACES.thrust + 6] *= 1e3
    root[:10] *= 1e2
    state = state._replace(mean=mean, root=root)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, np.zeros(6), on_ticks(), params)
    bias = (predict(state, acting, UNREAD, params).mean - predict(state, acting, UNREAD, PARAMS).mean)[10:16]
    draws = sampled(state, acting.firing, 20_000)
    np.testing.assert_allclose(bias, draws.mean(axis=0), atol=4 * draws.std(axis=0).max() / np.sqrt(20_000))


@pytest.mark.parametrize("correlated", [False, True])
def test_products_with_errors_of_failed_jets_forces_have_their_moments(correlated: bool) -> None:
    """Against drawn forces and parameters, of a leak and of a jet that gives too little."""
    params = small_params()
    plain, forces = some_state(params), slice(PLACES.force, PLACES.force + 2)
    mean, root = plain.mean.copy(), plain.root.copy()
    mean[10:], root[10:] = 0.0, 0.0
    mean[6:9] = params.accelerometer_positions.mean(axis=0)  # so that turning adds nothing to what they gather
    root[:10] *= 1e2
    known = plain._replace(
        mean=mean,
        root=root,
        slot_jet=np.array([2.0, 4.0]),
        slot_sign=np.array([1.0, -1.0]),
        slot_on_top=np.array([1.0, 0.0]),
    )
    unknown, first = root.copy(), 0 if correlated else 10
    unknown[forces, first : first + 3] = [[0.2, 0.1, -0.1], [0.1, 0.3, 0.5]]
    acting = drive(known, SAMPLE.durations_s, SAMPLE.commands, np.zeros(6), on_ticks(), params)
    seconds = np.array([PERIOD, -acting.firing.amount[4]]) / params.thrusts[[2, 4]]
    assert seconds[1] < 0.0
    drawn = np.random.default_rng(3).standard_normal((40_000, root.shape[1]))
    errors, off = drawn @ unknown[:10].T, drawn @ unknown[forces].T * seconds
    wrenches = params.wrenches[[2, 4]]
    given = effects_of(wrenches, known.mean)
    changed = np.array([effects_of(wrenches, known.mean[:10] + one) - given for one in errors])
    draws = np.einsum("nk,nkc->nc", off, changed)
    sigma = draws.std(axis=0)
    read = read_as(np.zeros(3), params)._replace(variance=np.full(3, 1e-14))  # what is left of the rate is noise, too
    without, found = (predict(known._replace(root=each), acting, read, params) for each in (root, unknown))
    added = (found.noise - without.noise) / np.outer(sigma, sigma)
    np.testing.assert_allclose((found.mean - without.mean)[10:16] / sigma, draws.mean(axis=0) / sigma, atol=0.03)
    if not correlated:  # whose squares the noise leaves out
        np.testing.assert_allclose(added, np.cov(draws.T) / np.outer(sigma, sigma), atol=0.05)


def test_covariance_goes_over_by_the_jacobian_and_noise() -> None:
    params = small_params(rate_walk=1e-6, velocity_walk=1e-4, repeatability=np.full(6, 1e-3), tank_fraction=0.1)
    state = some_state(params)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), params)
    prediction = predict(state, acting, UNREAD, params)
    transition = np.eye(PLACES.size)
    transition[10:13] += prediction.rate_rows
    for package in range(2):
        rows = slice(13 + 3 * package, 16 + 3 * package)
        transition[rows] += gathered_rows(prediction, package)
        begin = PLACES.acceleration_bias + 3 * package
        transition[rows, begin : begin + 3] += PERIOD * params.acceleration_bias_sigma * np.eye(3)
    transition[9, 9] = prediction.mass_factor
    noise = np.zeros((PLACES.size, PLACES.size))
    spread = np.zeros((PLACES.size, 6))
    spread[10:13, :3], spread[13:16, 3:], spread[16:19, 3:] = np.eye(3), np.eye(3), np.eye(3)
    spread[13:16, :3], spread[16:19, :3] = prediction.apart[1]
    noise = spread @ prediction.noise @ spread.T
    turned = turning(state.mean[10:13], state.reference, state.spin)
    moves = np.eye(PLACES.size)[:, :10]
    moves[13:16, 6:9] = moves[16:19, 6:9] = turned  # what accelerometers have gathered stays as it was
    noise += moves @ np.diag(prediction.drift) @ moves.T
    expected = transition @ state.root @ state.root.T @ transition.T + noise
    root = propagated(state.root, prediction, params)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(root @ root.T / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-12)
    assert prediction.drift[6] == pytest.approx(
        0.1**2 * 0.01 * TRUTH[9] * float(acting.firing.amount @ params.flows), rel=0.1
    )
    assert prediction.noise[0, 0] > (1e-6) ** 2 * PERIOD


def test_a_force_in_a_slot_is_that_much_thrust() -> None:
    """A jet that leaks a tenth of its thrust gives what it would if commanded a tenth, while it is off."""
    params = small_params(time_constants_s=np.zeros(6), second_order=False)
    state = some_state(params)
    mean = state.mean.copy()
    mean[PLACES.thrust :] = 0.0
    mean[PLACES.force] = 0.1 * params.thrusts[1]
    off = state._replace(mean=mean, level=np.zeros(6))

    def after(state: JointState, command: float) -> Array:
        commands: Any = np.zeros((1, 6))
        commands[0, 1] = command
        return predict(
            state, drive(state, SAMPLE.durations_s, commands, np.zeros(6), on_ticks(), params), UNREAD, params
        ).mean

    mean = mean.copy()
    mean[PLACES.force] = 0.0
    np.testing.assert_allclose(after(off, 0.0)[9:19], after(off._replace(mean=mean), 0.1)[9:19], rtol=1e-12)
    # and one that gives a third less, when it is on
    less = off.mean.copy()
    less[PLACES.force] = params.thrusts[1] / 3.0
    less = off._replace(mean=less, slot_sign=np.array([-1.0, -1.0]))
    np.testing.assert_allclose(after(less, 1.0)[9:19], after(off._replace(mean=mean), 2.0 / 3.0)[9:19], rtol=1e-12)


def test_rows_of_parameters_do_not_depend_on_the_rest() -> None:
    state = some_state(PARAMS)
    acting = drive(state, SAMPLE.durations_s, SAMPLE.commands, SAMPLE.outside, on_ticks(), PARAMS)
    rate_rows, velocity_rows = error_rows(state, acting, PARAMS)
    assert not rate_rows[:, : PLACES.thrust].any()
    assert not velocity_rows[:, : PLACES.thrust].any()
    assert rate_rows[:, PLACES.scale].any()  # known outside forces show the scale


def test_coupling_that_is_not_known_yet_is_noise_that_bounds_it_for_every_body() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        spread = rng.standard_normal((3, 3)) * np.exp(2.0 * rng.standard_normal(3))
        second = spread @ spread.T
        inertia = np.trace(second) * np.eye(3) - second
        rate = 0.1 * rng.standard_normal(3)
        change = np.linalg.solve(inertia, np.cross(rate, inertia @ rate)) * PERIOD
        assert np.linalg.norm(change) <= largest_coupling(rate, np.zeros(3), PERIOD)
    state = some_state(PARAMS)
    unknown = state.root.copy()
    unknown[0, 0] = 10.0 * state.mean[0]
    noises = []
    for root in (state.root, unknown):
        at = state._replace(root=root)
        acting = drive(at, np.array([PERIOD]), np.zeros((1, 6)), np.zeros(6), on_ticks(), PARAMS)
        prediction = predict(at, acting, UNREAD, PARAMS)
        noises.append((prediction.coupled, prediction.noise))
    (known, without), (blind, covered) = noises
    assert (known, blind) == (True, False)
    assert without[0, 0] < covered[0, 0]
    assert np.sqrt(covered[0, 0]) >= float(state.mean[10:13] @ state.mean[10:13]) * PERIOD * (1.0 - 1e-12)
