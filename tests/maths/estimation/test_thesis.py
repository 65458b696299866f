"""The thesis's pair of filters: the rules that diagram, estimator and replay share."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, KnownForce, unpack_known_force
from massprop_drake.maths.estimation.filter import NOT_MEASURED, FilterStep, Interval, Joint
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.filters.thesis import ThesisParams, ThesisState
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT

LEVEL = np.array([1.0, 0.5])
ERRORS = 0.1 * np.arange(12.0).reshape(2, 6)
KNOWN = KnownForce(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]), 2.0 * np.eye(3), 3.0 * np.eye(3))
SILENT = KnownForce(np.zeros(6), np.zeros((3, 3)), np.zeros((3, 3)))  # a jet stuck on that is told to fire


def params_of(*, mass: bool = True, errors: bool = False) -> ThesisParams:
    return ThesisParams(
        rotation_params(gyro_variances=np.full(1, 1e-6)),
        mass_params(variances=np.full(1, 1e-6)) if mass else None,
        np.arange(1.0, 11.0),
        np.diag(np.arange(1.0, 11.0)),
        ERRORS if errors else None,
    )


def cycled(
    params: ThesisParams,
    state: ThesisState,
    reading: float,
    *,
    usable: bool = True,
    firing: bool = True,
    known: KnownForce = NO_KNOWN_FORCE,
) -> tuple[Joint, FilterStep]:
    """Evidence, and the cycle."""
    impulses = Impulses(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), usable, firing, LEVEL, LEVEL)
    readings, interval = np.full((1, 3), reading), Interval(impulses, known)
    velocities = readings[: 0 if params.mass is None else 1]
    measurement = thesis.measure(state, readings, velocities, interval, params)
    seen = thesis.evidence(state, measurement, interval)
    return seen, thesis.finish(state, measurement, interval, NO_ADAPTATION, params)


def second(params: ThesisParams, **about: object) -> tuple[ThesisState, Joint, FilterStep]:
    """State before a second sample, and what is made of it."""
    state = cycled(params, thesis.initial_state(params), 0.0)[1].state
    return state, *cycled(params, state, 0.5, **about)


def test_a_known_force_acts_when_it_pushes_or_is_uncertain() -> None:
    assert KNOWN.acts
    assert KNOWN._replace(wrench=np.zeros(6)).acts
    assert KNOWN._replace(translation_spread=np.zeros((3, 3))).acts
    assert not SILENT.acts
    assert not NO_KNOWN_FORCE.acts
    assert unpack_known_force(np.zeros(24)) is NO_KNOWN_FORCE
    read = unpack_known_force(np.arange(24.0))
    assert_array_equal(np.concatenate([np.ravel(part) for part in read]), np.arange(24.0))


@pytest.mark.parametrize("known", [NO_KNOWN_FORCE, SILENT, KNOWN])
@pytest.mark.parametrize(("usable", "firing"), [(True, True), (True, False), (False, True)])
def test_filters_learn_from_steady_commanded_thrust_alone(usable: bool, firing: bool, known: KnownForce) -> None:
    # a known force alone is no reason: it may have ceased
    state, seen, step = second(params_of(), usable=usable, firing=firing, known=known)
    learning = usable and firing
    assert (step.rotation.rotation_used, step.mass.mass_used) == (learning, learning)
    assert (step.state.rotation.estimate != state.rotation.estimate).any() == learning
    assert (step.state.mass.mass_reciprocal != state.mass.mass_reciprocal) == learning
    assert (seen is not NOT_MEASURED) == usable


def test_a_known_force_acts_and_its_uncertainty_is_noise_of_either_filter() -> None:
    for firing in (True, False):
        plain, silent, known = (
            second(params_of(), firing=firing, known=each)[1] for each in (NO_KNOWN_FORCE, SILENT, KNOWN)
        )
        assert_array_equal(plain.covariance, silent.covariance)
        if firing:
            added = known.covariance - plain.covariance
            assert_allclose(added, np.diag([2.0] * 3 + [3.0] * 3), rtol=1e-9, atol=1e-9)
    assert known.cross_covariance[3:].any()  # the impulse of a known force counts
    assert not plain.cross_covariance[3:].any()


@pytest.mark.parametrize("errors", [False, True])
def test_both_innovations_stand_side_by_side_translation_first(errors: bool) -> None:
    state, seen, step = second(params_of(errors=errors))
    assert_array_equal(seen.innovation, [*step.mass.mass_innovation, *step.rotation.rotation_innovation])
    stds = [*step.mass.mass_innovation_std, *step.rotation.rotation_innovation_std]
    assert_allclose(np.sqrt(np.diag(seen.covariance)), stds, rtol=1e-14)
    assert_array_equal(seen.covariance, seen.covariance.T)
    assert_array_equal(seen.estimate, [*state.rotation.estimate, state.mass.mass_reciprocal])
    expected = np.zeros((10, 10))
    expected[:9, :9], expected[9, 9] = state.rotation.covariance, state.mass.variance
    assert seen.coupled == errors
    shared = np.zeros((3, 3))
    if errors:  # the sum over jets of what one sigma of each does to both, thrust errors by the mean level of their jet
        rotation, translation = state.rotation.sensitivity, state.mass.sensitivity
        expected[:9, 9] = expected[9, :9] = rotation @ translation
        given, inverse = ERRORS * LEVEL[:, None], state.rotation.estimate[ELEMENT]
        center, mass_reciprocal = state.rotation.estimate[6:], state.mass.mass_reciprocal
        for jet in range(2):
            turning = inverse @ (given[jet, :3] + np.cross(given[jet, 3:], center))
            moment = np.cross([4.0, 5.0, 6.0], center) + np.array([1.0, 2.0, 3.0])
            turning += rotation[:6, jet][ELEMENT] @ moment
            turning += inverse @ np.cross([4.0, 5.0, 6.0], rotation[6:, jet])
            moving = given[jet, 3:] * mass_reciprocal + np.array([4.0, 5.0, 6.0]) * translation[jet]
            shared += np.outer(moving, turning)
    assert_allclose(seen.covariance[:3, 3:], shared, rtol=1e-9, atol=1e-12)
    assert_allclose(seen.estimate_covariance, expected, rtol=1e-14)


@pytest.mark.parametrize("mass", [False, True])
@pytest.mark.parametrize("errors", [False, True])
def test_a_state_that_is_saved_is_restored(mass: bool, errors: bool) -> None:
    params = params_of(mass=mass, errors=errors)
    _, seen, step = second(params)
    groups = thesis.save_state(step.state, params)
    assert set(groups) == {"rotation_estimator", *(["mass_estimator"] if mass else [])}
    restored = thesis.restore_state(groups, params)

    def flat(parts: object) -> list[Array]:
        return [each for part in parts for each in flat(part)] if isinstance(parts, tuple) else [np.asarray(parts)]

    for ours, theirs in zip(flat(restored), flat(step.state), strict=True):
        assert_array_equal(ours, theirs)
    unknown = np.isnan(thesis.parameter_covariance(step.state))
    assert np.argwhere(unknown).tolist() == ([] if mass else [[9, 9]])
    assert (seen is NOT_MEASURED, step.mass is None) == (not mass, not mass)
    assert_array_equal(np.isnan(thesis.predicted_parameters(step.state)), unknown.diagonal())
