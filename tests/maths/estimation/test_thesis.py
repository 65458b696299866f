"""The thesis's pair of filters: the rules that diagram, estimator and replay share."""

from __future__ import annotations

import numpy as np
import pytest
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, KnownForce, known_force_of
from massprop_drake.maths.estimation.filter import NOT_MEASURED, Interval
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.filters.mass_filter import MassInnovation, MassMeasurement, MassSample, MassState
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.thesis import ThesisParams, Turning
from massprop_drake.maths.estimation.impulses import Impulses

MEAN_LEVEL = np.array([1.0, 0.5])
ERRORS = np.arange(12.0).reshape(2, 6)
KNOWN = KnownForce(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]), 2.0 * np.eye(3), 3.0 * np.eye(3))
SILENT = KnownForce(np.zeros(6), np.zeros((3, 3)), np.zeros((3, 3)))  # a jet stuck on that is told to fire


def _interval(*, usable: bool = True, firing: bool = False, known: KnownForce = NO_KNOWN_FORCE) -> Interval:
    impulses = Impulses(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), usable, firing, MEAN_LEVEL, MEAN_LEVEL)
    return Interval(impulses, known)


# ------------------------------------------------------------------------------------- known forces


def test_a_known_force_acts_when_it_pushes_or_is_uncertain() -> None:
    assert KNOWN.acts
    assert KNOWN._replace(wrench=np.zeros(6)).acts
    assert KNOWN._replace(translation_spread=np.zeros((3, 3))).acts
    assert not SILENT.acts
    assert not NO_KNOWN_FORCE.acts


def test_a_packed_known_force_of_zeros_is_none() -> None:
    assert known_force_of(np.zeros(24)) is NO_KNOWN_FORCE
    read = known_force_of(np.arange(24.0))
    np.testing.assert_array_equal(read.wrench, np.arange(6.0))
    np.testing.assert_array_equal(read.translation_spread, np.arange(6.0, 15.0).reshape(3, 3))
    np.testing.assert_array_equal(read.rotation_spread, np.arange(15.0, 24.0).reshape(3, 3))


@pytest.mark.parametrize(
    ("firing", "known", "acting"),
    [
        (False, NO_KNOWN_FORCE, False),
        (True, NO_KNOWN_FORCE, True),
        (False, KNOWN, True),
        (True, KNOWN, True),
        (False, SILENT, False),
    ],
)
def test_something_acts_when_a_jet_fires_or_a_known_force_does(firing: bool, known: KnownForce, acting: bool) -> None:
    seen = thesis.rotation_interval(_interval(firing=firing, known=known), None)
    assert seen.acting == acting


@pytest.mark.parametrize(("known", "noise"), [(NO_KNOWN_FORCE, False), (SILENT, False), (KNOWN, True)])
def test_the_uncertainty_of_a_known_force_is_extra_noise_of_either_filter(known: KnownForce, noise: bool) -> None:
    rotation = thesis.rotation_interval(_interval(known=known), None).extra_noise
    translation = thesis.mass_interval(_interval(known=known), None).extra_noise
    if noise:
        np.testing.assert_array_equal(rotation, 3.0 * np.eye(3))
        np.testing.assert_array_equal(translation, 2.0 * np.eye(3))
    else:
        assert rotation is None
        assert translation is None


@pytest.mark.parametrize("usable", [False, True])
@pytest.mark.parametrize("firing", [False, True])
@pytest.mark.parametrize("known", [NO_KNOWN_FORCE, KNOWN])
def test_the_rotation_filter_learns_from_steady_commanded_thrust_alone(
    usable: bool, firing: bool, known: KnownForce
) -> None:
    assert thesis.is_learning(_interval(usable=usable, firing=firing, known=known)) == (usable and firing)


def test_a_known_force_alone_teaches_neither_filter() -> None:
    # it may have ceased: what it is known by is the detector's to follow
    params = _params()
    for firing, learnt in ((False, False), (True, True)):
        interval, state = _interval(firing=firing, known=KNOWN), thesis.initial_state(params)
        for reading in (0.0, 0.5):
            rates = velocities = np.full((1, 3), reading)
            measurement = thesis.measure(state, rates, velocities, interval, params)
            step = thesis.finish(state, measurement, interval, NO_ADAPTATION, params)
            before, state = state, step.state
        assert (step.rotation.rotation_used, step.mass.mass_used) == (learnt, learnt)
        assert (state.rotation.estimate != before.rotation.estimate).any() == learnt
        assert (state.mass.mass_reciprocal != before.mass.mass_reciprocal) == learnt


# ------------------------------------------------------------------------------------ thrust errors


def test_thrust_errors_count_by_the_mean_level_of_their_jet() -> None:
    rotation = thesis.rotation_interval(_interval(), ERRORS).thrust_errors
    np.testing.assert_array_equal(rotation, [ERRORS[0], 0.5 * ERRORS[1]])
    translation = thesis.mass_interval(_interval(), thesis.linear_errors(ERRORS)).thrust_errors
    assert translation is not None
    np.testing.assert_array_equal(translation.T, [ERRORS[0, 3:], 0.5 * ERRORS[1, 3:]])


def test_thrust_that_is_known_has_no_errors() -> None:
    assert thesis.linear_errors(None) is None
    assert thesis.rotation_interval(_interval(), None).thrust_errors is None
    assert thesis.mass_interval(_interval(), None).thrust_errors is None


def test_what_both_innovations_share_is_the_sum_over_jets() -> None:
    translation, rotation = np.arange(6.0).reshape(3, 2), np.arange(6.0, 12.0).reshape(3, 2)
    shared = thesis.shared_covariance(translation, rotation)
    expected = sum(np.outer(translation[:, jet], rotation[:, jet]) for jet in range(2))
    np.testing.assert_allclose(shared, expected, rtol=1e-15)


def test_nothing_is_shared_where_no_error_bears_on_the_sample() -> None:
    effects = np.ones((3, 2))
    assert thesis.shared_covariance(None, effects) is None
    assert thesis.shared_covariance(effects, None) is None
    assert thesis.shared_covariance(effects, np.zeros((3, 2))) is None


# ---------------------------------------------------------------------------------- what is judged


def _turning(effects: np.ndarray | None) -> Turning:
    return Turning(
        innovation=np.array([1.0, 2.0, 3.0]),
        innovation_covariance=5.0 * np.eye(3),
        increment=np.zeros(3),
        rate=np.zeros(3),
        rate_variance=0.0,
        estimate=np.arange(9.0),
        covariance=np.eye(9),
        cross_covariance=np.zeros((3, 9)),
        effects=effects,
        sensitivity=None if effects is None else np.zeros((9, 2)),
    )


def test_the_joint_covariance_shares_nothing_between_the_mass_and_the_others() -> None:
    rotation = np.arange(81.0).reshape(9, 9)
    covariance = thesis.joint_covariance(rotation, 7.0)
    np.testing.assert_array_equal(covariance[:9, :9], rotation)
    np.testing.assert_array_equal(covariance[9], [0.0] * 9 + [7.0])
    np.testing.assert_array_equal(covariance[:, 9], [0.0] * 9 + [7.0])


@pytest.mark.parametrize("coupled", [False, True])
def test_both_innovations_stand_side_by_side_translation_first(coupled: bool) -> None:
    effects = np.full((3, 2), 0.5)
    innovation = MassInnovation(np.array([7.0, 8.0, 9.0]), 4.0 * np.eye(3), np.eye(3), np.eye(3), effects, 0.0)
    moving = MassMeasurement(MassSample(np.zeros(3), np.eye(3), np.zeros(3)), innovation)
    seen = thesis.joint(
        _turning(effects if coupled else None), moving, MassState(0.25, 0.5, empty_window(1), np.zeros(2))
    )
    np.testing.assert_array_equal(seen.innovation, [7.0, 8.0, 9.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(seen.covariance[:3, :3], 4.0 * np.eye(3))
    np.testing.assert_array_equal(seen.covariance[3:, 3:], 5.0 * np.eye(3))
    np.testing.assert_array_equal(seen.covariance[:3, 3:], np.full((3, 3), 0.5 * coupled))
    np.testing.assert_array_equal(seen.covariance, seen.covariance.T)
    assert seen.coupled == coupled
    np.testing.assert_array_equal(seen.estimate, [*range(9), 0.25])
    np.testing.assert_array_equal(seen.estimate_covariance, thesis.joint_covariance(np.eye(9), 0.5))


def _params(*, mass: bool = True, errors: bool = False) -> ThesisParams:
    return ThesisParams(
        rotation_params(gyro_variances=np.full(1, 1e-6)),
        mass_params(variances=np.full(1, 1e-6)) if mass else None,
        np.arange(1.0, 11.0),
        np.diag(np.arange(1.0, 11.0)),
        ERRORS if errors else None,
    )


def test_an_unsteady_sample_and_a_vehicle_without_accelerometer_give_no_evidence() -> None:
    for mass, usable, seen in ((True, True, True), (True, False, False), (False, True, False)):
        params = _params(mass=mass)
        state = thesis.initial_state(params)
        velocities = np.zeros((1 if mass else 0, 3))
        interval = _interval(usable=usable)
        measurement = thesis.measure(state, np.zeros((1, 3)), velocities, interval, params)
        assert (thesis.evidence(state, measurement, interval) is not NOT_MEASURED) == seen


def test_without_accelerometer_the_mass_is_not_observed() -> None:
    params = _params(mass=False)
    state = thesis.initial_state(params)
    measurement = thesis.measure(state, np.zeros((1, 3)), np.empty((0, 3)), _interval(), params)
    step = thesis.finish(state, measurement, _interval(), NO_ADAPTATION, params)
    assert step.mass is None
    np.testing.assert_array_equal(thesis.predicted(step.state), [*range(1, 10), np.nan])
    np.testing.assert_array_equal(np.argwhere(np.isnan(thesis.covariance(step.state))), [[9, 9]])


# -------------------------------------------------------------------------------------- kept states


@pytest.mark.parametrize("mass", [False, True])
@pytest.mark.parametrize("errors", [False, True])
def test_a_state_that_is_saved_is_restored(mass: bool, errors: bool) -> None:
    params = _params(mass=mass, errors=errors)
    start = thesis.initial_state(params)
    velocities = np.ones((1 if mass else 0, 3))
    interval = _interval(firing=True)
    step = thesis.finish(
        start, thesis.measure(start, np.ones((1, 3)), velocities, interval, params), interval, NO_ADAPTATION, params
    )
    groups = thesis.saved(step.state, params)
    assert set(groups) == {"rotation_estimator", *(["mass_estimator"] if mass else [])}
    assert all(vector.ndim == 1 for vector in groups.values())
    restored = thesis.restored(groups, params)
    again = thesis.saved(restored, params)
    for name, vector in groups.items():
        np.testing.assert_array_equal(vector, again[name])
    assert (restored.mass is None) == (not mass)
    assert (restored.rotation.sensitivity is None) == (not errors)
    np.testing.assert_array_equal(restored.rotation.estimate, step.state.rotation.estimate)
    np.testing.assert_array_equal(restored.rotation.covariance, step.state.rotation.covariance)
    np.testing.assert_array_equal(restored.memory.rates, np.ones((1, 3)))
