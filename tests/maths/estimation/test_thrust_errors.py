"""Considered thrust errors in both filters, against a filter of the state and all thrust errors written out."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import STATE, mass_params, rotation_params, spd

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Action, Adaptation
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassInnovation, MassSample, MassState
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rate_increments import (
    rate_increment,
    rate_increment_jacobian,
    second_order_terms,
)
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCoupling,
    RotationInnovation,
    RotationSample,
    RotationState,
)
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT

N_JETS = 4
ROTATION, MASS = rotation_params(), mass_params()


def thrust_errors_of(rng: np.random.Generator, size: float = 0.1) -> Array:
    """Impulses of one sigma of each jet's thrust error; the last jet does not fire."""
    return size * rng.normal(size=(N_JETS, 6)) * np.array([[1.0]] * (N_JETS - 1) + [[0.0]])


def rotation_case(rng: np.random.Generator, size: float = 0.1) -> tuple[RotationState, RotationSample]:
    """A part of the covariance that thrust errors made, and one that they did not."""
    psi = size * rng.normal(size=(9, N_JETS))
    noise, (z, angular, linear) = 0.01 * spd(rng, 3), rng.normal(size=(3, 3))
    sample = RotationSample(z, np.zeros(3), noise, 0.0, angular, linear, True, thrust_errors_of(rng))
    return RotationState(STATE, size**2 * spd(rng, 9) + psi @ psi.T, psi), sample


def mass_case(rng: np.random.Generator) -> tuple[MassState, MassSample]:
    psi = 0.05 * rng.normal(size=N_JETS)
    noise, (measured, impulse) = 0.05 * spd(rng, 3), rng.normal(size=(2, 3))
    sample = MassSample(measured, noise, impulse, thrust_errors_of(rng, 0.3)[:, 3:].T)
    return MassState(0.3, 0.01 + float(psi @ psi), empty_window(1), psi), sample


def rotation_parts(state: RotationState, sample: RotationSample) -> tuple[Any, ...]:
    """x, S, Psi, H, G of an estimate, e and R: products of both errors, sum_j beta_j H_j dx, pair by pair."""
    (estimate, covariance, psi), errors = state, sample.thrust_errors
    jacobians = [rate_increment_jacobian(estimate, jet[:3], jet[3:]) for jet in errors]
    bias, curvature = second_order_terms(covariance, sample.linear_impulse)
    e = sample.increment - rate_increment(estimate, sample.angular_impulse, sample.linear_impulse) - bias
    e = e - sum(h @ column for h, column in zip(jacobians, psi.T, strict=True))
    noise = sample.noise + curvature + sum(h @ covariance @ h.T for h in jacobians)
    for j, k in itertools.product(range(len(errors)), repeat=2):
        noise += np.outer(jacobians[j] @ psi[:, k], jacobians[k] @ psi[:, j])

    def effects(at: Array) -> Array:
        return np.column_stack([at[ELEMENT] @ (jet[:3] + np.cross(jet[3:], at[6:])) for jet in errors])

    jacobian = rate_increment_jacobian(estimate, sample.angular_impulse, sample.linear_impulse)
    return estimate, covariance, psi, jacobian, effects, e, noise


def mass_parts(state: MassState, sample: MassSample) -> tuple[Any, ...]:
    """The same of 1/m, with lambda_j in place of H_j."""
    errors, psi = sample.thrust_errors.T, state.sensitivity
    mean = sum(jet * part for jet, part in zip(errors, psi, strict=True))
    noise = sample.noise + sum(state.variance * np.outer(jet, jet) for jet in errors) + np.outer(mean, mean)
    e = sample.measured - sample.linear_impulse * state.mass_reciprocal - mean
    x, covariance = np.array([state.mass_reciprocal]), np.array([[state.variance]])
    return x, covariance, psi[None], sample.linear_impulse[:, None], lambda at: errors.T * at, e, noise


def augmented(covariance: Array, psi: Array) -> Array:
    """Covariance of [x; beta]; beta has unit variances."""
    return np.block([[covariance, psi], [psi.T, np.eye(psi.shape[1])]])


def by_hand(parts: tuple[Any, ...], action: int = Action.NONE, effect: Any = 0.0, spread: Any = 0.0) -> list[Array]:
    """The Schmidt-Kalman filter of [x; beta] in Joseph's form, made again with G where it led to: x, S and Psi."""
    estimate, covariance, psi, jacobian, effects, e, noise = parts
    joint, at, size = augmented(covariance, psi), estimate, estimate.size
    for _ in range(2):
        design = np.hstack([jacobian, effects(at)])
        gained = spread if action == Action.CORRECT_THESIS else 0.0
        gain = joint @ design.T @ np.linalg.inv(design @ joint @ design.T + noise + gained)
        gain[size:] = 0.0
        kept = np.eye(len(joint)) - gain @ design
        after = kept @ joint @ kept.T + gain @ (noise + spread) @ gain.T
        at = estimate + gain[:size] @ (e - effect)
    return [at, after[:size, :size], after[:size, size:]]


def turned(state: RotationState, sample: RotationSample, adaptation: Adaptation = NO_ADAPTATION, **params: Any) -> Any:
    """The rotation filter after a sample."""
    chosen = ROTATION._replace(**params)
    innovation = rotation_filter.innovate(state, sample, False, chosen)
    return rotation_filter.update(state, sample, innovation, adaptation, chosen).state


def weighed(state: MassState, sample: MassSample, adaptation: Adaptation = NO_ADAPTATION) -> MassState:
    """The mass filter after a sample."""
    return mass_filter.update(state, sample, mass_filter.innovate(state, sample), adaptation, MASS).state


def same(ours: RotationState | MassState, theirs: list[Array]) -> None:
    mine = ours if isinstance(ours, RotationState) else (ours.mass_reciprocal, ours.variance, ours.sensitivity)
    for one, other in zip(mine, theirs, strict=True):
        assert_allclose(np.ravel(one), np.ravel(other), rtol=1e-9, atol=1e-12)


CASES = [(rotation_case, rotation_parts, turned), (mass_case, mass_parts, weighed)]
both = pytest.mark.parametrize(("case", "parts", "updated"), CASES, ids=["rotation", "mass"])
Functions = Callable[..., Any]


@both
@pytest.mark.parametrize("action", [Action.NONE, Action.CORRECT, Action.CORRECT_THESIS])
def test_an_update_is_that_of_state_and_thrust_errors_together(
    case: Functions, parts: Functions, updated: Functions, action: int
) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        state, sample = case(rng)
        effect = rng.normal(size=3) * (action != Action.NONE)
        spread = 0.05 * np.outer(effect, effect)
        adaptation = Adaptation(action, 0.3 * effect, 0.3 * effect, spread, spread, mass_jumped=False)
        same(updated(state, sample, adaptation), by_hand(parts(state, sample), action, 0.3 * effect, spread))
    rejected = updated(state, sample, adaptation._replace(action=Action.REJECT))
    assert_array_equal(rejected.sensitivity, state.sensitivity)


@both
def test_the_innovations_covariance_is_that_of_state_and_thrust_errors_together(
    case: Functions, parts: Functions, updated: Functions
) -> None:
    state, sample = case(np.random.default_rng(2))
    estimate, covariance, psi, jacobian, effects, e, noise = parts(state, sample)
    dut: RotationInnovation | MassInnovation = (
        rotation_filter.innovate(state, sample, False, ROTATION)
        if updated is turned
        else mass_filter.innovate(state, sample)
    )
    design = np.hstack([jacobian, effects(estimate)])
    assert_allclose(dut.innovation, e, rtol=1e-12)
    assert_allclose(dut.noise, noise, rtol=1e-12)
    assert_allclose(dut.covariance, design @ augmented(covariance, psi) @ design.T + noise, rtol=1e-12)
    # what one sigma of each does to the innovation: by way of the estimates, and directly
    assert_allclose(dut.effects, design @ np.vstack([psi, np.eye(N_JETS)]), rtol=1e-12)
    if updated is turned:  # coasting no thrust error bears on the sample
        coasting = rotation_filter.innovate(state, sample._replace(firing=False), False, ROTATION)
        assert coasting.effects is None


def test_packages_one_after_the_other_are_as_many_updates() -> None:
    rng = np.random.default_rng(5)
    state, sample = rotation_case(rng)
    each = tuple(sample._replace(increment=sample.increment + 0.1 * rng.normal(size=3)) for _ in range(3))
    params = ROTATION._replace(rule=Rule.SERIAL)
    innovation = rotation_filter.innovate(state, sample, False, params)
    turning = rotation_filter.RotationMeasurement(sample, innovation, each)
    dut, expected = rotation_filter.finish(state, turning, True, NO_ADAPTATION, params).state, state
    for part in each:
        expected = RotationState(*by_hand(rotation_parts(expected, part)))
    same(dut, list(expected))
    moved, pushed = mass_case(rng)
    many = tuple(pushed._replace(measured=pushed.measured + 0.1 * rng.normal(size=3)) for _ in range(3))
    moving = mass_filter.MassMeasurement(pushed, mass_filter.innovate(moved, pushed), many)
    weight = mass_filter.finish(moved, moving, True, True, NO_ADAPTATION, MASS).state
    for part in many:
        reciprocal, variance, psi = by_hand(mass_parts(moved, part))
        moved = moved._replace(mass_reciprocal=reciprocal.item(), variance=variance.item(), sensitivity=psi[0])
    same(weight, [moved.mass_reciprocal, moved.variance, moved.sensitivity])


@pytest.mark.parametrize("factor", [40.0, 60.0])
def test_the_hybrid_rule_does_not_wait_for_thrust(factor: float) -> None:
    # Y without thrust errors is 40 or 60 times the noise, the limit 50; with them a thousand times
    torque = np.array([0.5, 2.0, 1.0 / 3.0])
    covariance = np.diag([(factor - 1.0) * 4e-4 / 4.0] * 3 + [0.0] * 6)
    errors, psi = np.zeros((N_JETS, 6)), np.zeros((9, N_JETS))
    errors[0, :3], psi[:3, 0] = 0.05 * torque, 0.3  # the rest of S comes of thrust errors
    sample = RotationSample(np.zeros(3), np.zeros(3), 4e-4 * np.eye(3), 0.0, torque, np.zeros(3), True, errors)
    params = rotation_params(coupling=RotationCoupling.HYBRID, coupling_limit=50.0)
    state = RotationState(STATE, covariance + psi @ psi.T, psi)
    dut = rotation_filter.innovate(state, sample, False, params)
    assert dut.covariance.diagonal().max() > 500.0 * 4e-4
    assert dut.subtract_coupling == (factor < 50.0)
