"""What the filters do with a sample that shows a failed jet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import mass_params, rotation_params, spd

from massprop_drake.maths.estimation.adaptation import (
    LAYOUT,
    NO_ADAPTATION,
    Action,
    Adaptation,
    pack_adaptation,
    unpack_adaptation,
)
from massprop_drake.maths.estimation.detectors.jet_tests import jet_tests
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import MassInnovation, MassMeasurement, MassSample, MassState
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCycle,
    RotationInnovation,
    RotationMeasurement,
    RotationSample,
    RotationState,
)
from massprop_drake.maths.linear_algebra import Array

# linear, so that the joint filter below is exact
ROTATION = rotation_params(second_order=False, jump_covariance=np.diag(np.full(9, 7.0)))
MASS = mass_params(jump_variance=4.0, jump_window=3)
CORRECTIONS = [Action.CORRECT, Action.CORRECT_THESIS]


class Scene(NamedTuple):
    """One sample in which a jet fails, as both filters see it: moderate numbers, nothing diagonal."""

    turned: RotationState
    sample: RotationSample
    turning: RotationInnovation
    moved: MassState
    pushed: MassSample
    moving: MassInnovation
    signature: Array  # translation first

    @property
    def seen(self) -> Array:
        return np.concatenate([self.moving.innovation, self.turning.innovation])

    def adaptation(self, action: int, *, with_translation: bool = True) -> Adaptation:
        """What the detector hands to the filters (4-29) to (4-32)."""
        information = np.zeros((6, 6))
        information[3:, 3:] = self.turning.information
        if with_translation:
            information[:3, :3] = self.moving.information
        allowed = np.array([False])
        tests = jet_tests(self.signature[None, :], self.seen, information, allowed, allowed)
        effect = tests.magnitude[0] * self.signature
        spread = tests.variance[0] * np.outer(self.signature, self.signature)
        return Adaptation(action, effect[:3], effect[3:], spread[:3, :3], spread[3:, 3:], mass_jumped=False)

    def rotated(self, adaptation: Adaptation, usable: bool = True, **params: object) -> RotationCycle:
        measurement = RotationMeasurement(self.sample, self.turning)
        return rotation_filter.finish(self.turned, measurement, usable, adaptation, ROTATION._replace(**params))

    def weighed(self, adaptation: Adaptation, usable: bool = True, **params: object) -> mass_filter.MassCycle:
        measurement = MassMeasurement(self.pushed, self.moving)
        return mass_filter.finish(self.moved, measurement, usable, True, adaptation, MASS._replace(**params))


@pytest.fixture
def scene() -> Scene:
    rng = np.random.default_rng(1)
    turned = RotationState(rng.normal(size=9), spd(rng, 9))
    noise, impulses = spd(rng, 3), rng.normal(size=(2, 3))
    sample = RotationSample(rng.normal(size=3), np.zeros(3), noise, 0.0, *impulses, firing=True)
    moved = MassState(0.7, 0.3, np.array([[0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.2, 3.0, -1.0]]))
    pushed = MassSample(rng.normal(size=3), spd(rng, 3), impulses[1])
    turning = rotation_filter.innovate(turned, sample, False, ROTATION)
    return Scene(turned, sample, turning, moved, pushed, mass_filter.innovate(moved, pushed), rng.normal(size=6))


def joint_filter(scene: Scene) -> tuple[Array, Array]:
    """Mean and covariance of [x; 1/m; f] by the best linear update, nothing known of f beforehand."""
    h, noise, prior = np.zeros((6, 11)), np.zeros((6, 6)), np.zeros((11, 11))
    h[:3, 9], h[3:, :9], h[:, 10] = scene.pushed.linear_impulse, scene.turning.jacobian, scene.signature
    noise[:3, :3], noise[3:, 3:] = scene.moving.noise, scene.turning.noise
    prior[:9, :9], prior[9, 9] = np.linalg.inv(scene.turned.covariance), 1.0 / scene.moved.variance
    covariance = np.linalg.inv(prior + h.T @ np.linalg.inv(noise) @ h)
    change = covariance @ h.T @ np.linalg.inv(noise) @ scene.seen
    return np.array([*scene.turned.estimate, scene.moved.mass_reciprocal, 0.0]) + change, covariance


def test_the_correction_is_the_best_linear_update_with_an_unknown_force(scene: Scene) -> None:
    # both filters with the one force: what the joint filter says of each, without what it says of both together
    mean, covariance = joint_filter(scene)
    adaptation, added = scene.adaptation(Action.CORRECT), 0.25 * np.eye(9)
    turned, weighed = scene.rotated(adaptation, process_noise=added), scene.weighed(adaptation)
    assert turned.used
    assert weighed.used
    assert_allclose(turned.state.estimate, mean[:9], rtol=1e-9, atol=1e-10)
    assert_allclose(turned.state.covariance, covariance[:9, :9] + added, atol=1e-10)
    assert_allclose(weighed.state.mass_reciprocal, mean[9], rtol=1e-9)
    assert_allclose(weighed.state.variance, covariance[9, 9], rtol=1e-9)
    effect = np.concatenate([adaptation.translation, adaptation.rotation])
    assert_allclose(effect, mean[10] * scene.signature, rtol=1e-9)
    # from rates alone the same, with velocities that tell nothing
    blind = scene._replace(moving=scene.moving._replace(noise=1e12 * scene.moving.noise))
    mean, covariance = joint_filter(blind)
    turned = scene.rotated(scene.adaptation(Action.CORRECT, with_translation=False))
    assert_allclose(turned.state.estimate, mean[:9], rtol=1e-8, atol=1e-9)
    assert_allclose(turned.state.covariance, covariance[:9, :9], atol=1e-9)


def test_a_rejected_sample_leaves_the_state_but_for_process_noise(scene: Scene) -> None:
    noise, adaptation = np.diag(np.arange(9.0)), scene.adaptation(Action.REJECT)
    rejected = scene.rotated(adaptation, process_noise=noise, jump_threshold=0.0)
    assert_array_equal(rejected.state.estimate, scene.turned.estimate)
    assert_array_equal(rejected.state.covariance, scene.turned.covariance + noise)
    weighed = scene.weighed(adaptation, process_noise=0.5, jump_threshold=0.0)
    assert weighed.state[:2] == (0.7, 0.8)
    assert (rejected.used, rejected.jumped, weighed.used, weighed.jumped) == (False, False, False, False)


@pytest.mark.parametrize("action", CORRECTIONS)
def test_a_corrected_sample_empties_the_window_of_the_jump_test(scene: Scene, action: int) -> None:
    # its sums are of plain updates: what they gathered says nothing of the estimate that a correction leaves
    assert scene.weighed(NO_ADAPTATION, jump_threshold=1e9).state.window.any()
    assert not scene.weighed(scene.adaptation(action), jump_threshold=1e9).state.window.any()


@pytest.mark.parametrize("action", CORRECTIONS)
def test_no_jump_is_looked_for_while_a_jet_explains_the_sample(scene: Scene, action: int) -> None:
    for cycle in (scene.rotated, scene.weighed):
        assert cycle(NO_ADAPTATION, jump_threshold=0.0).jumped
        assert not cycle(scene.adaptation(action), jump_threshold=0.0).jumped


def test_after_a_jump_the_sample_is_used_with_the_raised_variance(scene: Scene) -> None:
    jumped = NO_ADAPTATION._replace(mass_jumped=True)
    result = scene.weighed(jumped)
    assert result.used
    # the scalar filter in information form, its variance raised by the setting, 4
    impulse, noise = scene.pushed.linear_impulse, np.linalg.inv(scene.moving.noise)
    updated = 1.0 / (1.0 / 4.3 + impulse @ noise @ impulse)
    assert_allclose(result.state.variance, updated, rtol=1e-10)
    expected = 0.7 + updated * (impulse @ noise @ scene.moving.innovation)
    assert_allclose(result.state.mass_reciprocal, expected, rtol=1e-10)
    # a sample that cannot be used, or is not there, raises the variance all the same
    blind = scene._replace(moving=scene.moving._replace(innovation=np.full(3, np.nan), nis=np.nan))
    for other in (scene.weighed(jumped, False), blind.weighed(jumped)):
        assert not other.used
        assert other.state[:2] == (0.7, 4.3)


def test_packing_and_back() -> None:
    rng = np.random.default_rng(2)
    for action, jumped in zip(Action, (True, False, True, False), strict=True):
        parts = rng.normal(size=(2, 3)), rng.normal(size=(2, 3, 3))
        adaptation = Adaptation(action, *parts[0], *parts[1], mass_jumped=jumped)
        vector = pack_adaptation(adaptation)
        assert vector.shape == (LAYOUT.size,)
        for ours, theirs in zip(unpack_adaptation(vector), adaptation, strict=True):
            assert_array_equal(ours, theirs)
    assert not pack_adaptation(NO_ADAPTATION).any()
    assert unpack_adaptation(np.zeros(LAYOUT.size)) is NO_ADAPTATION
