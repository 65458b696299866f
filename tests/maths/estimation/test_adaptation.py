"""What the filters do with a sample that shows a failed jet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.adaptation import LAYOUT, NO_ADAPTATION, Action, Adaptation, packed, unpacked
from massprop_drake.maths.estimation.detectors.jet_tests import jet_tests
from massprop_drake.maths.estimation.filters import mass_filter, mass_jump, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassInnovation, MassParams, MassSample, MassState
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationInnovation,
    RotationParams,
    RotationSample,
    RotationState,
)
from massprop_drake.maths.linear_algebra import Array, is_covariance

ROTATION = rotation_params(
    second_order=False,  # linear, so that the joint filter below is exact
    jump_covariance=np.diag(np.full(9, 7.0)),
)
MASS = mass_params(jump_variance=4.0, jump_window=3)


def spd(rng: np.random.Generator, size: int) -> Array:
    mixing = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    return mixing @ mixing.T / size


class Scene(NamedTuple):
    """One sample in which a jet fails, as both filters see it: moderate numbers, nothing diagonal."""

    estimate: Array  # of the rotation filter
    covariance: Array
    sample: RotationSample
    turning: RotationInnovation
    mass_reciprocal: float
    variance: float
    pushed: MassSample
    moving: MassInnovation
    signature: Array  # translation first

    def adaptation(self, action: int, *, with_translation: bool = True) -> Adaptation:
        """What the detector hands to the filters (4-29) to (4-32)."""
        seen = np.concatenate([self.moving.innovation, self.turning.innovation])
        information = np.zeros((6, 6))
        information[3:, 3:] = self.turning.information
        if with_translation:
            information[:3, :3] = self.moving.information
        allowed = np.array([False])
        tests = jet_tests(self.signature[None, :], seen, information, allowed, allowed)
        effect = tests.magnitude[0] * self.signature
        spread = tests.variance[0] * np.outer(self.signature, self.signature)
        return Adaptation(action, effect[:3], effect[3:], spread[:3, :3], spread[3:, 3:], mass_jumped=False)

    @property
    def linear_impulse(self) -> Array:
        return self.pushed.linear_impulse

    @property
    def turning_state(self) -> RotationState:
        return RotationState(self.estimate, self.covariance)

    @property
    def moving_state(self) -> MassState:
        return MassState(self.mass_reciprocal, self.variance, mass_jump.empty_window(3))

    def rotated(self, adaptation: Adaptation, params: RotationParams = ROTATION) -> rotation_filter.RotationUpdate:
        return rotation_filter.update(self.turning_state, self.sample, self.turning, adaptation, params)

    def weighed(self, adaptation: Adaptation, params: MassParams = MASS) -> mass_filter.MassUpdate:
        return mass_filter.update(self.moving_state, self.pushed, self.moving, adaptation, params)


@pytest.fixture
def scene() -> Scene:
    rng = np.random.default_rng(1)
    estimate, covariance, noise = rng.normal(size=9), spd(rng, 9), spd(rng, 3)
    angular, linear = rng.normal(size=3), rng.normal(size=3)
    sample = RotationSample(rng.normal(size=3), np.zeros(3), noise, 0.0, angular, linear, firing=True)
    turning = rotation_filter.innovate(RotationState(estimate, covariance), sample, False, ROTATION)
    mass_reciprocal, variance, velocity_noise = 0.7, 0.3, spd(rng, 3)
    pushed = MassSample(rng.normal(size=3), velocity_noise, linear)
    moving = mass_filter.innovate(MassState(mass_reciprocal, variance, mass_jump.empty_window(3)), pushed)
    signature = rng.normal(size=6)
    return Scene(estimate, covariance, sample, turning, mass_reciprocal, variance, pushed, moving, signature)


def joint_filter(scene: Scene) -> tuple[Array, Array]:
    """The best linear update of [x; 1/m; f], nothing known of f beforehand, by the information form.

    Returns:
        Mean (11) and covariance (11, 11).
    """
    h = np.zeros((6, 11))
    h[:3, 9] = scene.linear_impulse
    h[3:, :9] = scene.turning.jacobian
    h[:, 10] = scene.signature
    noise = np.zeros((6, 6))
    noise[:3, :3], noise[3:, 3:] = scene.moving.noise, scene.turning.noise
    prior = np.zeros((11, 11))
    prior[:9, :9] = np.linalg.inv(scene.covariance)
    prior[9, 9] = 1.0 / scene.variance
    covariance = np.linalg.inv(prior + h.T @ np.linalg.inv(noise) @ h)
    seen = np.concatenate([scene.moving.innovation, scene.turning.innovation])
    change = covariance @ h.T @ np.linalg.inv(noise) @ seen
    return np.concatenate([scene.estimate, [scene.mass_reciprocal], [0.0]]) + change, covariance


def test_the_correction_is_the_best_linear_update_with_an_unknown_force(scene: Scene) -> None:
    # both filters with the one force: what the joint filter says of each, without what it says of both together
    mean, covariance = joint_filter(scene)
    adaptation = scene.adaptation(Action.CORRECT)
    turned, weighed = scene.rotated(adaptation), scene.weighed(adaptation)
    np.testing.assert_allclose(turned.state.estimate, mean[:9], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(turned.state.covariance, covariance[:9, :9], atol=1e-10)
    np.testing.assert_allclose(weighed.state.mass_reciprocal, mean[9], rtol=1e-9)
    np.testing.assert_allclose(weighed.state.variance, covariance[9, 9], rtol=1e-9)
    # and the force itself
    effect = np.concatenate([adaptation.translation, adaptation.rotation])
    np.testing.assert_allclose(effect, mean[10] * scene.signature, rtol=1e-9)


def test_the_correction_from_rates_alone(scene: Scene) -> None:
    # the same with velocities that tell nothing
    blind = scene._replace(moving=scene.moving._replace(noise=1e12 * scene.moving.noise))
    mean, covariance = joint_filter(blind)
    turned = scene.rotated(scene.adaptation(Action.CORRECT, with_translation=False))
    np.testing.assert_allclose(turned.state.estimate, mean[:9], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(turned.state.covariance, covariance[:9, :9], atol=1e-9)


def test_a_correction_keeps_the_failure_out_of_the_estimates(scene: Scene) -> None:
    # whatever the force, the estimates come out the same
    estimates = []
    for force in (0.0, 5.0, -300.0):
        effect = force * scene.signature
        failed = scene._replace(
            turning=scene.turning._replace(innovation=scene.turning.innovation + effect[3:]),
            moving=scene.moving._replace(innovation=scene.moving.innovation + effect[:3]),
        )
        adaptation = failed.adaptation(Action.CORRECT)
        estimates.append(
            np.append(failed.rotated(adaptation).state.estimate, failed.weighed(adaptation).state.mass_reciprocal)
        )
    # three hundred times the size cancels
    np.testing.assert_allclose(estimates[1:], [estimates[0]] * 2, atol=1e-11)
    plain = scene.rotated(NO_ADAPTATION).state.estimate
    assert np.abs(estimates[0][:9] - plain).max() > 0.01  # the force takes some of what the sample tells


def test_a_correction_costs_what_the_force_took(scene: Scene) -> None:
    # S + K C K^T is above what the plain update leaves, and not above what was there before
    plain = scene.rotated(NO_ADAPTATION).state.covariance
    corrected = scene.rotated(scene.adaptation(Action.CORRECT)).state.covariance
    assert np.linalg.eigvalsh(corrected - plain).min() > -1e-12
    assert np.linalg.eigvalsh(corrected - plain).max() > 1e-3
    assert np.linalg.eigvalsh(scene.covariance - corrected).min() > -1e-12
    assert is_covariance(corrected)


def test_the_thesis_form_uses_smaller_gains_and_claims_more(scene: Scene) -> None:
    # from rates alone C = c c^T / (c^T Y^-1 c), so that (Y + C)^-1 c is half of Y^-1 c: the gain along c is
    # halved, the gain on the corrected innovation, which has no part along c, is not, and half of K C K^T is
    # given back instead of all (the reference's remark on (4-34), (4-35))
    best = scene.rotated(scene.adaptation(Action.CORRECT, with_translation=False))
    thesis = scene.rotated(scene.adaptation(Action.CORRECT_THESIS, with_translation=False))
    np.testing.assert_allclose(thesis.state.estimate, best.state.estimate, rtol=1e-9, atol=1e-11)
    gain = scene.covariance @ scene.turning.jacobian.T @ scene.turning.information
    spread = scene.adaptation(Action.CORRECT, with_translation=False).rotation_spread
    np.testing.assert_allclose(
        best.state.covariance - thesis.state.covariance, 0.5 * gain @ spread @ gain.T, atol=1e-11
    )


def test_the_thesis_form_in_full(scene: Scene) -> None:
    # (4-34), (4-35) and the updates with them, written out
    adaptation = scene.adaptation(Action.CORRECT_THESIS)
    jacobian, covariance = scene.turning.jacobian, scene.covariance
    gain = covariance @ jacobian.T @ np.linalg.inv(scene.turning.covariance + adaptation.rotation_spread)
    turned = scene.rotated(adaptation)
    expected = scene.estimate + gain @ (scene.turning.innovation - adaptation.rotation)
    np.testing.assert_allclose(turned.state.estimate, expected, rtol=1e-10)
    np.testing.assert_allclose(turned.state.covariance, covariance - gain @ jacobian @ covariance, atol=1e-11)
    impulse, variance = scene.linear_impulse, scene.variance
    kappa = variance * np.linalg.inv(scene.moving.covariance + adaptation.translation_spread) @ impulse
    weighed = scene.weighed(adaptation)
    expected_mass = scene.mass_reciprocal + kappa @ (scene.moving.innovation - adaptation.translation)
    np.testing.assert_allclose(weighed.state.mass_reciprocal, expected_mass, rtol=1e-10)
    np.testing.assert_allclose(weighed.state.variance, (1.0 - kappa @ impulse) * variance, rtol=1e-10)


def test_a_rejected_sample_leaves_the_state_but_for_process_noise(scene: Scene) -> None:
    noisy = ROTATION._replace(process_noise=np.diag(np.arange(9.0)), jump_threshold=0.0)
    rejected = scene.rotated(scene.adaptation(Action.REJECT), noisy)
    np.testing.assert_array_equal(rejected.state.estimate, scene.estimate)
    np.testing.assert_array_equal(rejected.state.covariance, scene.covariance + np.diag(np.arange(9.0)))
    assert not rejected.jumped
    weighed = scene.weighed(scene.adaptation(Action.REJECT), MASS._replace(process_noise=0.5, jump_threshold=0.0))
    assert (weighed.state.mass_reciprocal, weighed.state.variance) == (scene.mass_reciprocal, scene.variance + 0.5)
    assert not weighed.jumped
    assert not weighed.state.window.any()


@pytest.mark.parametrize("action", [Action.CORRECT, Action.CORRECT_THESIS])
def test_a_corrected_sample_empties_the_window_of_the_jump_test(scene: Scene, action: int) -> None:
    # its sums are of plain updates: what they gathered says nothing of the estimate that a correction leaves
    gathered = np.array([[0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.2, 3.0, -1.0]])
    state = scene.moving_state._replace(window=gathered)
    plain = mass_filter.update(state, scene.pushed, scene.moving, NO_ADAPTATION, MASS._replace(jump_threshold=1e9))
    assert plain.state.window.any()
    params = MASS._replace(jump_threshold=1e9)
    corrected = mass_filter.update(state, scene.pushed, scene.moving, scene.adaptation(action), params)
    assert not corrected.state.window.any()


@pytest.mark.parametrize(
    ("action", "used"), [(Action.CORRECT, True), (Action.CORRECT_THESIS, True), (Action.REJECT, False)]
)
def test_a_rejected_sample_does_not_count_as_used(scene: Scene, action: int, *, used: bool) -> None:
    adaptation = scene.adaptation(action)
    measurement = rotation_filter.RotationMeasurement(scene.sample, scene.turning)
    turned = rotation_filter.finish(scene.turning_state, measurement, True, adaptation, ROTATION)
    assert turned.used == used
    pushed = mass_filter.MassMeasurement(scene.pushed, scene.moving)
    weighed = mass_filter.finish(scene.moving_state, pushed, True, True, adaptation, MASS)
    assert weighed.used == used


def test_process_noise_is_added_after_a_correction(scene: Scene) -> None:
    adaptation = scene.adaptation(Action.CORRECT)
    noise = 0.25 * np.eye(9)
    noisy, plain = scene.rotated(adaptation, ROTATION._replace(process_noise=noise)), scene.rotated(adaptation)
    np.testing.assert_allclose(noisy.state.covariance - plain.state.covariance, noise, atol=1e-14)


@pytest.mark.parametrize("action", [Action.CORRECT, Action.CORRECT_THESIS])
def test_covariance_is_not_incremented_while_a_jet_explains_the_sample(scene: Scene, action: int) -> None:
    eager = ROTATION._replace(jump_threshold=0.0)
    assert scene.rotated(NO_ADAPTATION, eager).jumped
    explained = scene.rotated(scene.adaptation(action), eager)
    assert not explained.jumped
    np.testing.assert_array_equal(explained.state.covariance, scene.rotated(scene.adaptation(action)).state.covariance)


# ------------------------------------------------------------------------------------- a jump of the mass


def finished(scene: Scene, adaptation: Adaptation, *, usable: bool = True) -> mass_filter.MassCycle:
    measurement = mass_filter.MassMeasurement(scene.pushed, scene.moving)
    return mass_filter.finish(scene.moving_state, measurement, usable, True, adaptation, MASS)


JUMPED = NO_ADAPTATION._replace(mass_jumped=True)


def test_after_a_jump_the_sample_is_used_with_the_raised_variance(scene: Scene) -> None:
    result = finished(scene, JUMPED)
    assert result.used
    # the scalar filter in information form, its variance raised by the setting, 4
    variance = scene.variance + 4.0
    noise = np.linalg.inv(scene.moving.noise)
    impulse = scene.linear_impulse
    updated = 1.0 / (1.0 / variance + impulse @ noise @ impulse)
    np.testing.assert_allclose(result.state.variance, updated, rtol=1e-10)
    expected = scene.mass_reciprocal + updated * (impulse @ noise @ scene.moving.innovation)
    np.testing.assert_allclose(result.state.mass_reciprocal, expected, rtol=1e-10)


def test_a_jump_raises_the_variance_even_of_a_sample_that_is_not_used(scene: Scene) -> None:
    result = finished(scene, JUMPED, usable=False)
    assert not result.used
    assert (result.state.mass_reciprocal, result.state.variance) == (scene.mass_reciprocal, scene.variance + 4.0)
    blind = scene._replace(moving=scene.moving._replace(innovation=np.full(3, np.nan), nis=np.nan))
    assert finished(blind, JUMPED).state.variance == scene.variance + 4.0


# ------------------------------------------------------------------------------------------------ packing


def test_packing_and_back() -> None:
    rng = np.random.default_rng(2)
    for action, jumped in (
        (Action.CORRECT, False),
        (Action.CORRECT_THESIS, True),
        (Action.REJECT, False),
        (Action.NONE, True),
    ):
        adaptation = Adaptation(
            action, *rng.normal(size=(2, 3)), rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), mass_jumped=jumped
        )
        vector = packed(adaptation)
        assert vector.shape == (LAYOUT.size,)
        for ours, theirs in zip(unpacked(vector), adaptation, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_nothing_to_do_packs_to_zeros() -> None:
    assert not packed(NO_ADAPTATION).any()
    assert unpacked(np.zeros(LAYOUT.size)) is NO_ADAPTATION
