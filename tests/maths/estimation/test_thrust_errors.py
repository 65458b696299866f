"""Considered thrust errors in both filters, against a filter of the state and all thrust errors written out."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Action, Adaptation
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassSample, MassState
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCoupling,
    RotationParams,
    RotationSample,
    RotationState,
    rate_increment,
    rate_increment_jacobian,
    rate_increment_jacobians,
    second_order_terms,
    thrust_error_effects,
)
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, six_elements

N_JETS = 4
INVERSE = np.linalg.inv(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]))
STATE = np.array([*six_elements(INVERSE), 0.5, -0.3, 0.2])
ROTATION, MASS = rotation_params(), mass_params()


def spd(rng: np.random.Generator, size: int) -> Array:
    mixing = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    return mixing @ mixing.T / size


def thrust_errors_of(rng: np.random.Generator, size: float = 0.1) -> Array:
    """Impulses of one sigma of each jet's thrust error; the last jet does not fire."""
    errors = size * rng.normal(size=(N_JETS, 6))
    errors[-1] = 0.0
    return errors


def rotation_state(rng: np.random.Generator, size: float = 0.1) -> RotationState:
    """A part of the covariance that thrust errors made, and one that they did not."""
    sensitivity = size * rng.normal(size=(9, N_JETS))
    return RotationState(STATE, size**2 * spd(rng, 9) + sensitivity @ sensitivity.T, sensitivity)


def rotation_sample(rng: np.random.Generator, **changes: Any) -> RotationSample:
    sample = RotationSample(
        increment=rng.normal(size=3),
        rate=np.zeros(3),
        noise=0.01 * spd(rng, 3),
        gyro_variance=0.0,
        angular_impulse=rng.normal(size=3),
        linear_impulse=rng.normal(size=3),
        firing=True,
        thrust_errors=thrust_errors_of(rng),
    )
    return sample._replace(**changes)


def effects_by_hand(estimate: Array, errors: Array) -> Array:
    """G, jet by jet: I^-1 (a_j + lambda_j x r_cm)."""
    inverse = estimate[ELEMENT]
    return np.column_stack([inverse @ (jet[:3] + np.cross(jet[3:], estimate[6:])) for jet in errors])


def products_by_hand(state: RotationState, errors: Array) -> tuple[Array, Array]:
    """Mean and covariance of sum_j beta_j H_j dx, pair by pair."""
    assert state.sensitivity is not None
    jacobians = [rate_increment_jacobian(state.estimate, jet[:3], jet[3:]) for jet in errors]
    mean = sum(h @ psi for h, psi in zip(jacobians, state.sensitivity.T, strict=True))
    total = sum(h @ state.covariance @ h.T for h in jacobians)
    for j, k in itertools.product(range(len(errors)), repeat=2):
        total += np.outer(jacobians[j] @ state.sensitivity[:, k], jacobians[k] @ state.sensitivity[:, j])
    return np.asarray(mean), np.asarray(total)


def schmidt(
    joint: Array, design: Array, noise: Array, size: int, gained: Array | None = None, spread: Array | None = None
) -> tuple[Array, Array]:
    """Gain and covariance of [x; beta], the gain's rows of beta set to zero, in Joseph's form.

    Args:
        joint: covariance of [x; beta].
        design: [H, G].
        noise: of the measurement, as the gain has it.
        size: of x.
        gained: added to the noise for the gain.
        spread: added to the noise in Joseph's form.
    """
    innovation = design @ joint @ design.T + noise + (0.0 if gained is None else gained)
    gain = joint @ design.T @ np.linalg.inv(innovation)
    gain[size:] = 0.0
    kept = np.eye(len(joint)) - gain @ design
    total = noise + (0.0 if spread is None else spread)
    return gain[:size], kept @ joint @ kept.T + gain @ total @ gain.T


def augmented(covariance: Array, sensitivity: Array) -> Array:
    """Covariance of [x; beta]; beta has unit variances."""
    return np.block([[covariance, sensitivity], [sensitivity.T, np.eye(sensitivity.shape[1])]])


def updated_by_hand(
    state: RotationState, sample: RotationSample, adaptation: Adaptation = NO_ADAPTATION
) -> RotationState:
    """The second-order filter of [x; beta], the update made again with G where it led to."""
    assert state.sensitivity is not None
    assert sample.thrust_errors is not None
    estimate, covariance = state.estimate, state.covariance
    jacobian = rate_increment_jacobian(estimate, sample.angular_impulse, sample.linear_impulse)
    bias, curvature = second_order_terms(covariance, sample.linear_impulse)
    mean, products = products_by_hand(state, sample.thrust_errors)
    noise = sample.noise + curvature + products
    error = sample.increment - rate_increment(estimate, sample.angular_impulse, sample.linear_impulse) - bias - mean
    gained = spread = np.zeros((3, 3))
    if adaptation.action != Action.NONE:
        error, spread = error - adaptation.rotation, adaptation.rotation_spread
    if adaptation.action == Action.CORRECT_THESIS:
        gained = adaptation.rotation_spread
    joint, at = augmented(covariance, state.sensitivity), estimate
    for _ in range(2):
        design = np.hstack([jacobian, effects_by_hand(at, sample.thrust_errors)])
        gain, after = schmidt(joint, design, noise, 9, gained, spread)
        at = estimate + gain @ error
    return RotationState(at, after[:9, :9], after[:9, 9:])


def same(ours: RotationState, theirs: RotationState) -> None:
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-12)


def adapted(rng: np.random.Generator, action: int) -> Adaptation:
    if action == Action.NONE:
        return NO_ADAPTATION
    effect, force = rng.normal(size=6), 0.3
    spread = 0.05 * np.outer(effect, effect)
    return Adaptation(action, force * effect[:3], force * effect[3:], spread[:3, :3], spread[3:, 3:], mass_jumped=False)


def turned(
    state: RotationState,
    sample: RotationSample,
    adaptation: Adaptation = NO_ADAPTATION,
    params: RotationParams = ROTATION,
) -> RotationState:
    """The rotation filter after a sample."""
    innovation = rotation_filter.innovate(state, sample, False, params)
    return rotation_filter.update(state, sample, innovation, adaptation, params).state


def weighed(state: MassState, sample: MassSample, adaptation: Adaptation = NO_ADAPTATION) -> MassState:
    """The mass filter after a sample."""
    return mass_filter.update(state, sample, mass_filter.innovate(state, sample), adaptation, MASS).state


# ---------------------------------------------------------------------------------- rotation filter


def test_effect_of_a_thrust_error_of_hand_value() -> None:
    # I^-1 = diag(1, 2, 4), r = (0, 2, 0): a = (1, 1, 1) and lambda = (1, 0, 0) give a + lambda x r = (1, 1, 3)
    state = np.array([1.0, 2.0, 4.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0])
    errors = np.array([[1.0, 1.0, 1.0, 1.0, 0.0, 0.0], [0.0] * 6])
    np.testing.assert_array_equal(thrust_error_effects(state, errors), [[1.0, 0.0], [2.0, 0.0], [12.0, 0.0]])


def test_jacobians_of_all_jets_are_those_of_each() -> None:
    errors = thrust_errors_of(np.random.default_rng(1))
    for ours, jet in zip(rate_increment_jacobians(STATE, errors), errors, strict=True):
        np.testing.assert_allclose(ours, rate_increment_jacobian(STATE, jet[:3], jet[3:]), rtol=1e-14, atol=1e-16)


def test_the_innovations_covariance_is_that_of_state_and_thrust_errors_together() -> None:
    rng = np.random.default_rng(2)
    state, sample = rotation_state(rng), rotation_sample(rng)
    dut = rotation_filter.innovate(state, sample, False, ROTATION)
    design = np.hstack([dut.jacobian, effects_by_hand(STATE, sample.thrust_errors)])
    _, curvature = second_order_terms(state.covariance, sample.linear_impulse)
    noise = sample.noise + curvature + products_by_hand(state, sample.thrust_errors)[1]
    expected = design @ augmented(state.covariance, state.sensitivity) @ design.T + noise
    np.testing.assert_allclose(dut.noise, noise, rtol=1e-12)
    np.testing.assert_allclose(dut.covariance, expected, rtol=1e-12)
    # what one sigma of each does to the innovation: by way of the estimates, and directly
    np.testing.assert_allclose(dut.effects, design @ np.vstack([state.sensitivity, np.eye(N_JETS)]), rtol=1e-12)


@pytest.mark.parametrize("action", [Action.NONE, Action.CORRECT, Action.CORRECT_THESIS])
def test_the_rotation_filters_update_is_that_of_state_and_thrust_errors_together(action: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        state, sample, adaptation = rotation_state(rng), rotation_sample(rng), adapted(rng, action)
        same(turned(state, sample, adaptation), updated_by_hand(state, sample, adaptation))


def test_the_second_pass_matters() -> None:
    # from an estimate of zero G is zero too: without it the first sample would count as free of thrust errors
    rng = np.random.default_rng(4)
    state = RotationState(np.zeros(9), spd(rng, 9), np.zeros((9, N_JETS)))
    sample = rotation_sample(rng)
    innovation = rotation_filter.innovate(state, sample, False, ROTATION)
    assert innovation.effects is not None
    assert not innovation.effects.any()
    dut = turned(state, sample)
    same(dut, updated_by_hand(state, sample))
    assert np.abs(dut.sensitivity[:, :-1]).max() > 1e-3
    assert not dut.sensitivity[:, -1].any()  # the jet that did not fire


def test_gyros_one_after_the_other_are_as_many_updates() -> None:
    rng = np.random.default_rng(5)
    params = rotation_params(rule=Rule.SERIAL)
    state, sample = rotation_state(rng), rotation_sample(rng)
    each = tuple(sample._replace(increment=sample.increment + 0.1 * rng.normal(size=3)) for _ in range(3))
    innovation = rotation_filter.innovate(state, sample, False, params)
    dut = rotation_filter.update(state, sample, innovation, NO_ADAPTATION, params, each).state
    expected = state
    for part in each:
        expected = updated_by_hand(expected, part)
    same(dut, expected)


@pytest.mark.parametrize("second_order", [True, False])
def test_without_thrust_errors_the_plain_filters_numbers_stay(*, second_order: bool) -> None:
    rng = np.random.default_rng(6)
    params = rotation_params(second_order=second_order)
    covariance = 0.01 * spd(rng, 9)
    plain, considering = RotationState(STATE, covariance), RotationState(STATE, covariance, np.zeros((9, N_JETS)))
    for _ in range(5):
        sample = rotation_sample(rng, thrust_errors=np.zeros((N_JETS, 6)))
        states = []
        for state, part in ((plain, sample._replace(thrust_errors=None)), (considering, sample)):
            states.append(turned(state, part, params=params))
        plain, considering = states
        np.testing.assert_array_equal(considering.estimate, plain.estimate)
        np.testing.assert_array_equal(considering.covariance, plain.covariance)
        assert not considering.sensitivity.any()


def test_covariance_stays_above_what_thrust_errors_make_of_it() -> None:
    rng = np.random.default_rng(7)
    params = rotation_params(jump_threshold=40.0, jump_covariance=0.01 * np.eye(9), process_noise=1e-9 * np.eye(9))
    state, jets = RotationState(STATE, 0.01 * spd(rng, 9), np.zeros((9, N_JETS))), rng.normal(size=(N_JETS, 6))
    truth = STATE + 0.05 * rng.normal(size=9)
    for _ in range(200):
        on = rng.integers(0, 2, size=N_JETS)
        impulse = on @ jets
        z = rate_increment(truth, impulse[:3], impulse[3:]) + 1e-3 * rng.normal(size=3)
        errors = 0.05 * on[:, None] * jets
        sample = RotationSample(z, np.zeros(3), 1e-6 * np.eye(3), 0.0, impulse[:3], impulse[3:], True, errors)
        state = turned(state, sample, params=params)
        scale = np.sqrt(state.covariance.diagonal())
        assert np.linalg.eigvalsh(state.independent / np.outer(scale, scale)).min() > -1e-10
    # two hundred samples did not average a constant error away
    assert (state.sensitivity**2).sum() > 0.1 * np.trace(state.covariance)


def test_a_rejected_sample_leaves_the_sensitivity() -> None:
    rng = np.random.default_rng(8)
    state, sample = rotation_state(rng), rotation_sample(rng)
    dut = turned(state, sample, adapted(rng, Action.REJECT))
    np.testing.assert_array_equal(dut.sensitivity, state.sensitivity)
    np.testing.assert_array_equal(dut.covariance, state.covariance)


def test_coasting_no_thrust_error_bears_on_the_sample() -> None:
    rng = np.random.default_rng(9)
    innovation = rotation_filter.innovate(rotation_state(rng), rotation_sample(rng, firing=False), False, ROTATION)
    assert innovation.effects is None


def test_moments_of_the_innovation_by_sampling() -> None:
    # center of mass known: z = h(x; a, lambda) + sum_j beta_j h(x; a_j, lambda_j) + v has exactly the covariance
    # claimed, products of both errors included. 5 standard errors of 400 000 samples
    rng = np.random.default_rng(10)
    count = 400_000
    covariance = np.zeros((9, 9))
    covariance[:6, :6] = 0.5 * spd(rng, 6)
    state = RotationState(STATE, covariance, np.zeros((9, N_JETS)))
    sample = rotation_sample(rng, increment=np.zeros(3), thrust_errors=thrust_errors_of(rng, 1.0))
    dut = rotation_filter.innovate(state, sample, False, ROTATION)
    drawn = STATE[:6] + rng.standard_normal((count, 6)) @ np.linalg.cholesky(covariance[:6, :6]).T
    inverses = drawn[:, ELEMENT]
    scaled = np.column_stack([np.ones(count), rng.standard_normal((count, N_JETS))])
    impulses = np.vstack([np.append(sample.angular_impulse, sample.linear_impulse), sample.thrust_errors])
    moments = scaled @ (impulses[:, :3] + np.cross(impulses[:, 3:], STATE[6:]))
    measured = np.einsum("nij,nj->ni", inverses, moments)
    measured += rng.standard_normal((count, 3)) @ np.linalg.cholesky(sample.noise).T
    innovations = measured + dut.innovation  # that of a measurement of zero is minus the prediction
    assert (np.abs(innovations.mean(axis=0)) < 5.0 * innovations.std(axis=0) / np.sqrt(count)).all()
    products = innovations[:, :, None] * innovations[:, None]
    bounds = 5.0 * products.std(axis=0) / np.sqrt(count)
    assert (np.abs(products.mean(axis=0) - dut.covariance) < bounds).all()
    # the test can tell: neither the products nor the effects may be left out
    without = dut.covariance - products_by_hand(state, sample.thrust_errors)[1]
    assert (np.abs(products.mean(axis=0) - without) > 2.0 * bounds).any()
    without = dut.covariance - dut.effects @ dut.effects.T
    assert (np.abs(products.mean(axis=0) - without) > 2.0 * bounds).any()


def test_errors_are_those_that_the_covariance_claims() -> None:
    # inverse inertia known to some percent and the center of mass exactly, so that products of both errors stay
    # far below the noise, and thrust off by 5 % for good, which stands far above it. Mean NEES of 6 elements: 6,
    # standard error sqrt(12 / 400)
    rng = np.random.default_rng(11)
    runs, jets = 400, rng.normal(size=(3, 6))
    covariance = np.zeros((9, 9))
    covariance[:6, :6] = 1e-4 * spd(rng, 6)
    root = np.linalg.cholesky(covariance[:6, :6])
    commands = [np.array(on) for on in ([1, 0, 0], [1, 1, 0], [0, 1, 1], [0, 0, 1])]
    nees, naive = np.empty(runs), np.empty(runs)
    for run in range(runs):
        inverse = STATE[:6] + root @ rng.standard_normal(6)
        truth = np.append(inverse, STATE[6:])
        factors = 1.0 + 0.05 * rng.standard_normal(3)
        considering, plain = RotationState(STATE, covariance, np.zeros((9, 3))), RotationState(STATE, covariance)
        for on in commands:
            impulse, true = on @ jets, (on * factors) @ jets
            increment = rate_increment(truth, true[:3], true[3:]) + 5e-3 * rng.standard_normal(3)
            errors = 0.05 * on[:, None] * jets
            sample = RotationSample(increment, np.zeros(3), 25e-6 * np.eye(3), 0.0, impulse[:3], impulse[3:], True)
            plain = turned(plain, sample)
            considering = turned(considering, sample._replace(thrust_errors=errors))
        for state, scores in ((considering, nees), (plain, naive)):
            error = state.estimate[:6] - truth[:6]
            scores[run] = error @ np.linalg.solve(state.covariance[:6, :6], error)
    assert abs(nees.mean() - 6.0) < 5.0 * np.sqrt(12.0 / runs)
    assert naive.mean() > 20.0  # taken as known, thrust makes the filter far too sure


@pytest.mark.parametrize("factor", [40.0, 60.0])
def test_the_hybrid_rule_does_not_wait_for_thrust(factor: float) -> None:
    # Y without thrust errors is 40 or 60 times the noise, the limit 50; with them a thousand times
    torque = np.array([0.5, 2.0, 1.0 / 3.0])
    variance = (factor - 1.0) * 4e-4 / 4.0
    covariance = np.diag([variance] * 3 + [0.0] * 6)
    sample = RotationSample(np.zeros(3), np.zeros(3), 4e-4 * np.eye(3), 0.0, torque, np.zeros(3), firing=True)
    params = rotation_params(coupling=RotationCoupling.HYBRID, coupling_limit=50.0)
    plain = rotation_filter.innovate(RotationState(STATE, covariance), sample, False, params)
    assert plain.subtract_coupling == (factor < 50.0)
    errors = np.zeros((N_JETS, 6))
    errors[0, :3] = 0.05 * torque
    # the rest of S comes of thrust errors
    sensitivity = np.zeros((9, N_JETS))
    sensitivity[:3, 0] = 0.3
    state = RotationState(STATE, covariance + sensitivity @ sensitivity.T, sensitivity)
    dut = rotation_filter.innovate(state, sample._replace(thrust_errors=errors), False, params)
    assert dut.covariance.diagonal().max() > 500.0 * 4e-4
    assert dut.subtract_coupling == (factor < 50.0)


# -------------------------------------------------------------------------------------- mass filter


def mass_state(rng: np.random.Generator, size: float = 0.05) -> MassState:
    sensitivity = size * rng.normal(size=N_JETS)
    return MassState(0.3, 0.01 + float(sensitivity @ sensitivity), empty_window(1), sensitivity)


def mass_sample(rng: np.random.Generator, **changes: Any) -> MassSample:
    errors = thrust_errors_of(rng, 0.3)[:, 3:].T
    return MassSample(rng.normal(size=3), 0.05 * spd(rng, 3), rng.normal(size=3), errors)._replace(**changes)


def mass_products_by_hand(state: MassState, sample: MassSample) -> tuple[Array, Array]:
    """Mean of sum_j beta_j lambda_j d(1/m), pair by pair, and R' with their covariance."""
    assert state.sensitivity is not None
    assert sample.thrust_errors is not None
    errors, psi = sample.thrust_errors.T, state.sensitivity
    noise = sample.noise + sum(state.variance * np.outer(jet, jet) for jet in errors)
    for j, k in itertools.product(range(N_JETS), repeat=2):
        noise = noise + psi[k] * psi[j] * np.outer(errors[j], errors[k])
    return sum(jet * part for jet, part in zip(errors, psi, strict=True)), noise


def weighed_by_hand(state: MassState, sample: MassSample, adaptation: Adaptation = NO_ADAPTATION) -> MassState:
    """The filter of [1/m; beta], the update made again with G where it led to."""
    assert state.sensitivity is not None
    assert sample.thrust_errors is not None
    joint = augmented(np.array([[state.variance]]), state.sensitivity[None])
    mean, noise = mass_products_by_hand(state, sample)
    error = sample.measured - sample.linear_impulse * state.mass_reciprocal - mean
    gained = spread = np.zeros((3, 3))
    if adaptation.action != Action.NONE:
        error, spread = error - adaptation.translation, adaptation.translation_spread
    if adaptation.action == Action.CORRECT_THESIS:
        gained = adaptation.translation_spread
    at = state.mass_reciprocal
    for _ in range(2):
        design = np.column_stack([sample.linear_impulse, sample.thrust_errors * at])
        gain, after = schmidt(joint, design, noise, 1, gained, spread)
        at = state.mass_reciprocal + float((gain @ error)[0])
    return MassState(at, float(after[0, 0]), state.window, after[0, 1:])


def same_mass(ours: MassState, theirs: MassState) -> None:
    np.testing.assert_allclose(ours[:2], theirs[:2], rtol=1e-10)
    np.testing.assert_allclose(ours.sensitivity, theirs.sensitivity, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("action", [Action.NONE, Action.CORRECT, Action.CORRECT_THESIS])
def test_the_mass_filters_update_is_that_of_state_and_thrust_errors_together(action: int) -> None:
    rng = np.random.default_rng(12)
    for _ in range(10):
        state, sample, adaptation = mass_state(rng), mass_sample(rng), adapted(rng, action)
        same_mass(weighed(state, sample, adaptation), weighed_by_hand(state, sample, adaptation))


def test_the_mass_innovations_covariance_is_that_of_state_and_thrust_errors_together() -> None:
    rng = np.random.default_rng(13)
    state, sample = mass_state(rng), mass_sample(rng)
    dut = mass_filter.innovate(state, sample)
    design = np.column_stack([sample.linear_impulse, 0.3 * sample.thrust_errors])
    _, noise = mass_products_by_hand(state, sample)
    expected = design @ augmented(np.array([[state.variance]]), state.sensitivity[None]) @ design.T + noise
    np.testing.assert_allclose(dut.noise, noise, rtol=1e-12)
    np.testing.assert_allclose(dut.covariance, expected, rtol=1e-12)
    np.testing.assert_allclose(dut.effects, design @ np.vstack([state.sensitivity, np.eye(N_JETS)]), rtol=1e-12)


def test_accelerometers_one_after_the_other_are_as_many_updates() -> None:
    rng = np.random.default_rng(14)
    state, sample = mass_state(rng), mass_sample(rng)
    each = tuple(sample._replace(measured=sample.measured + 0.1 * rng.normal(size=3)) for _ in range(3))
    dut = mass_filter.update(state, sample, mass_filter.innovate(state, sample), NO_ADAPTATION, MASS, each).state
    expected = state
    for part in each:
        expected = weighed_by_hand(expected, part)
    same_mass(dut, expected)


def test_without_thrust_errors_the_plain_mass_filters_numbers_stay() -> None:
    rng = np.random.default_rng(15)
    plain = MassState(0.3, 0.02, empty_window(1))
    considering = plain._replace(sensitivity=np.zeros(N_JETS))
    for _ in range(5):
        sample = mass_sample(rng, thrust_errors=np.zeros((3, N_JETS)))
        states = []
        for state, part in ((plain, sample._replace(thrust_errors=None)), (considering, sample)):
            states.append(weighed(state, part))
        plain, considering = states
        assert considering[:2] == plain[:2]
        assert not considering.sensitivity.any()


def test_variance_stays_above_what_thrust_errors_make_of_it() -> None:
    rng = np.random.default_rng(16)
    state, jets = MassState(0.0, 1.0, empty_window(1), np.zeros(N_JETS)), rng.normal(size=(3, N_JETS))
    for _ in range(200):
        on = rng.integers(0, 2, size=N_JETS)
        impulse = jets @ on
        measured = 0.3 * impulse + 1e-3 * rng.normal(size=3)
        sample = MassSample(measured, 1e-6 * np.eye(3), impulse, 0.05 * jets * on)
        state = weighed(state, sample)
        assert state.independent > -1e-12 * state.variance
    assert state.sensitivity @ state.sensitivity > 0.1 * state.variance


def test_errors_of_the_mass_are_those_that_the_variance_claims() -> None:
    # thrust off by 5 % for good, noise of a thousandth. Mean NEES: 1, standard error sqrt(2 / 600)
    rng = np.random.default_rng(17)
    runs, jets = 600, rng.normal(size=(3, 3)) + 2.0 * np.eye(3)
    commands = [np.array(on) for on in ([1, 0, 0], [1, 1, 0], [0, 1, 1], [0, 0, 1])]
    nees, naive = np.empty(runs), np.empty(runs)
    for run in range(runs):
        truth = 0.3 + 0.01 * rng.standard_normal()
        factors = 1.0 + 0.05 * rng.standard_normal(3)
        considering = MassState(0.3, 1e-4, empty_window(1), np.zeros(3))
        plain = considering._replace(sensitivity=None)
        for on in commands:
            measured = (on * factors) @ jets * truth + 1e-3 * rng.standard_normal(3)
            sample = MassSample(measured, 1e-6 * np.eye(3), on @ jets, 0.05 * (on[:, None] * jets).T)
            considering = weighed(considering, sample)
            plain = weighed(plain, sample._replace(thrust_errors=None))
        for state, scores in ((considering, nees), (plain, naive)):
            scores[run] = (state.mass_reciprocal - truth) ** 2 / state.variance
    assert abs(nees.mean() - 1.0) < 5.0 * np.sqrt(2.0 / runs)
    assert naive.mean() > 100.0
