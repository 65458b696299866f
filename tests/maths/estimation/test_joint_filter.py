"""The joint filter in the registry: states as vectors, reports, replacement, and intervals that are not a period."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_probe import PERIOD, TRUTH, small_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import GROUP, JointFilterParams, JointFilterState, JointMeasurement
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.estimation.joint.covariance import in_order
from massprop_drake.maths.estimation.joint.joint_cycle import expect
from massprop_drake.maths.estimation.joint.layout import CENTER, RATE, make_places, state_layout
from massprop_drake.maths.estimation.joint.prediction import drive
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import skew, triangular_rows

PARAMS = JointFilterParams(small_params(), PERIOD)
PLACES = PARAMS.joint.places
RATES = np.array([[0.01, -0.02, 0.03], [0.011, -0.02, 0.03]])
VELOCITIES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
OFF = np.zeros(6)


def told(time_s: float, command: Any = OFF, **given: Any) -> Told:
    start = {"stamp_s": time_s, "coming": None, "outside_wrench": np.zeros(6)}
    return Told(time_s, command=np.array(command, dtype=float), **(start | given))


def flown(cycles: int, params: JointFilterParams = PARAMS) -> tuple[JointFilterState, JointMeasurement]:
    """The filter after some cycles in which jets fire at random."""
    rng = np.random.default_rng(3)
    state = joint.initial(params)
    for k in range(cycles):
        command = (rng.uniform(size=6) < 0.4).astype(float)
        rates = RATES + 1e-3 * k * np.array([1.0, -2.0, 0.5])
        measurement = joint.step(state, rates, VELOCITIES + 0.01 * k, told(k * PERIOD, command), params)
        state = measurement.state
    return state, measurement


def test_it_stands_in_the_registry() -> None:
    assert FILTERS["joint"] is joint.FILTER


def test_a_state_comes_back_from_its_vector() -> None:
    state, _ = flown(5)
    groups = joint.saved(state, PARAMS)
    assert set(groups) == {GROUP}
    again = joint.restored(groups, PARAMS)
    for one, other in zip(
        (*again.joint, *again.clock, *again[2:4]), (*state.joint, *state.clock, *state[2:4]), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("field", "index", "value", "message"),
    [
        ("mean", 3, np.nan, "only commands and readings may be missing"),
        ("root", PLACES.size - 1, 0.5, "must be lower triangular"),
        ("root", PLACES.thrust * PLACES.size + 1, 0.5, "must be lower triangular"),
        ("level", 0, 1.5, "fractions of 0 to 1"),
        ("firing_count", 0, -1.0, "zero or positive"),
        ("lag_open", 0, 0.5, "lag_open must be 0 or 1"),
        ("slot_jet", 0, 0.5, "a jet's index and a sign"),
        ("slot_jet", 0, 6.0, "a jet's index and a sign"),
        ("slot_sign", 0, 0.0, "a jet's index and a sign"),
    ],
)
def test_what_no_filter_leaves_is_refused(field: str, index: int, value: float, message: str) -> None:
    vector = joint.packed(flown(5)[0], PARAMS)
    vector[state_layout(PLACES).slice(field).start + index] = value
    with pytest.raises(ValueError, match=message):
        joint.restored({GROUP: vector}, PARAMS)


def test_an_impossible_clock_is_refused() -> None:
    state, _ = flown(3)
    for clock in (state.clock._replace(number=0.5), state.clock._replace(earlier=np.full(6, 2.0))):
        with pytest.raises(ValueError, match="joint_estimator: "):
            joint.restored(joint.saved(state._replace(clock=clock), PARAMS), PARAMS)


def test_reports_have_what_the_cycle_says() -> None:
    state, measurement = flown(6)
    report = measurement.evidence.report
    step = joint.finish(state, measurement, None, NO_ADAPTATION, PARAMS)  # type: ignore[arg-type]
    assert step.mass is not None
    np.testing.assert_array_equal(np.append(step.rotation.estimate, step.mass.mass_reciprocal), report.estimate)
    variances = np.append(step.rotation.standard_deviation**2, step.mass.variance)
    np.testing.assert_allclose(variances, report.covariance.diagonal())
    np.testing.assert_array_equal(step.rotation.rotation_innovation, report.innovation[:3])
    np.testing.assert_array_equal(step.mass.mass_innovation, report.innovation[6:9])
    before, sample = measurement.evidence.before, measurement.evidence.sample
    acting = drive(before, sample.durations_s, sample.commands, sample.outside, on_ticks(), PARAMS.joint)
    projected = expect(before, acting, sample, PARAMS.joint).projected  # before any increment
    expected = np.sqrt((projected @ projected.T).diagonal() + PARAMS.joint.variances)
    deviations = np.append(step.rotation.rotation_innovation_std, step.mass.mass_innovation_std)
    np.testing.assert_allclose(deviations, expected[[0, 1, 2, 6, 7, 8]])
    assert (step.own.gyro_components, step.own.accelerometer_components) == (6, 6)  # nothing is quantized
    assert step.rotation.rotation_nis == pytest.approx(3.0 * report.gyro_nis / 6)
    assert step.mass.mass_nis == pytest.approx(3.0 * report.accelerometer_nis / 6)
    assert report.gyro_nis <= report.nis * (1.0 + 1e-9)


def test_a_replacement_is_reported_and_gone_on_from() -> None:
    state, measurement = flown(6)
    own = joint.done(measurement, PARAMS)
    off = np.zeros(PLACES.size)
    off[CENTER] = 1.0
    other = measurement.state.joint._replace(mean=measurement.state.joint.mean + off, guarded=True, firing_count=60.0)
    step = FILTERS["joint"].replaced(own, other, PARAMS)
    np.testing.assert_allclose(step.rotation.estimate, own.rotation.estimate + off[:9])
    assert step.state.joint is other
    assert step.state.clock is state.clock
    assert (own.own.settled, step.own.settled) == (0.0, 1.0)
    np.testing.assert_array_equal(step.rotation.rotation_innovation, own.rotation.rotation_innovation)


def test_without_accelerometer_the_mass_is_not_observed() -> None:
    params = small_params()
    without = params._replace(
        places=make_places((6, 2, 0), 2, (True, False), True, 2),
        prior_sigma=np.append(np.ones(6 + 2 + 6), np.zeros(3)),
        accelerometer_positions=np.empty((0, 3)),
        variances=params.variances[:6],
        **{name: getattr(params, name)[:6] for name in ("quanta", "cells", "floors", "dithered")},
        guard_relative=np.array([0.02, 0.02, 0.02, np.inf]),
    )
    made = JointFilterParams(without, PERIOD)
    first = joint.step(joint.initial(made), RATES, np.empty((0, 3)), told(0.0), made)
    after = joint.step(first.state, RATES, np.empty((0, 3)), told(PERIOD), made)
    step = joint.done(after, made)
    assert step.mass is None
    assert np.isnan(step.state.estimate[9])
    assert np.isnan(step.state.covariance[9]).all()
    assert np.isfinite(step.state.covariance[:9, :9]).all()


def test_a_gap_keeps_what_is_known_of_the_vehicle_and_begins_rates_anew() -> None:
    state, _ = flown(12)
    stamp = state.clock.stamp_s + 30.0
    unknown = told(13 * PERIOD, np.full(6, np.nan), stamp_s=stamp, coming=OFF)
    measurement = joint.step(state, RATES + 0.3, VELOCITIES + 5.0, unknown, PARAMS)
    after = measurement.state
    assert measurement.evidence.anew
    assert not measurement.evidence.report.used.any()
    np.testing.assert_array_equal(after.estimate, state.estimate)
    np.testing.assert_allclose(after.covariance, state.covariance, rtol=1e-9)
    places, mean = PARAMS.joint.places, state.joint.mean
    biases = PARAMS.joint.gyro_bias_sigma * mean[places.gyro_bias : places.gyro_bias + 6].reshape(2, 3)
    unbiased = RATES + 0.3 - biases
    np.testing.assert_allclose(after.joint.mean[RATE], (2 * unbiased[0] + unbiased[1]) / 3, rtol=1e-12)
    np.testing.assert_allclose(after.joint.mean[13:19], (VELOCITIES + 5.0).ravel())
    covariance = after.joint.root @ after.joint.root.T
    for package, position in enumerate(PARAMS.joint.accelerometer_positions):  # but for what the rate has of its bias
        of_rate = skew(position - after.joint.mean[6:9]) @ covariance[RATE]
        rows = covariance[13 + 3 * package : 16 + 3 * package]
        np.testing.assert_allclose(rows[:, :10], of_rate[:, :10], rtol=1e-9, atol=1e-15)
    assert triangular_rows(in_order(after.joint.root, places.thrust)) == places.size


def test_outside_impulses_are_of_the_true_interval() -> None:
    state, _ = flown(3)
    wrench = np.array([0.0, 0, 0, 1.0, 0, 0])
    late = state.clock.stamp_s + 1.04 * PERIOD
    measurement = joint.step(state, RATES, VELOCITIES, told(4 * PERIOD, stamp_s=late, outside_wrench=wrench), PARAMS)
    np.testing.assert_allclose(measurement.evidence.sample.outside, 1.04 * PERIOD * wrench)


def test_several_packages_are_more_rows() -> None:
    """Two packages of one reading are as good as one of half the variance."""
    no_biases = np.append(np.ones(6 + 2), np.zeros(6 + 6 + 1 + 2 + 2))
    halved = np.array([5e-11] * 3 + [1.0] * 3 + [5e-9] * 3 + [1.0] * 3)
    single = small_params(variances=halved, prior_sigma=no_biases)
    double = small_params(variances=np.array([1e-10] * 6 + [1e-8] * 6), prior_sigma=no_biases)
    same = np.tile(single.accelerometer_positions[:1], (2, 1))
    found = []
    for params in (single, double):
        made = JointFilterParams(params._replace(accelerometer_positions=same), PERIOD)
        state = joint.initial(made)
        for k in range(4):
            rates, velocities = np.tile(RATES[:1] * (1 + k), (2, 1)), np.tile(VELOCITIES[:1] * (1 + k), (2, 1))
            state = joint.step(state, rates, velocities, told(k * PERIOD, [1, 0, 1, 0, 0, 0]), made).state
        found.append(state)
    np.testing.assert_allclose(found[0].estimate, found[1].estimate, rtol=1e-5)
    np.testing.assert_allclose(np.diag(found[0].covariance), np.diag(found[1].covariance), rtol=1e-5)
    assert not np.allclose(found[0].estimate, TRUTH, rtol=1e-3)
