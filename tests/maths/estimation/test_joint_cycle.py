"""A cycle of the joint filter: start, considered errors, the bound, bad numbers, states as vectors, and a maneuver."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from joint_probe import PERIOD, small_params, some_sample, some_state

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import GROUP, JointFilterParams, JointFilterState, JointMeasurement
from massprop_drake.maths.estimation.filters.registry import FILTERS
from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.covariance import order_root_rows
from massprop_drake.maths.estimation.joint.innovation import predict_cycle
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces, step
from massprop_drake.maths.estimation.joint.layout import CENTER, RATE, state_layout
from massprop_drake.maths.estimation.joint.measurement import predict_outputs
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError, triangular_rows

PARAMS = small_params()
PLACES = PARAMS.places
RATES = np.array([[0.01, -0.02, 0.03], [0.011, -0.02, 0.03]])
VELOCITIES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
READ = some_sample(PARAMS, rates=RATES, velocities=VELOCITIES)
STILL = np.zeros((1, 6))


def test_a_start_is_as_its_readings_say() -> None:
    state, report = step(initial_joint_state(PARAMS), READ, PARAMS)
    assert state.started
    assert not report.used.any()
    np.testing.assert_allclose(state.mean[10:13], (2 * RATES[0] + RATES[1]) / 3)  # variances 1 and 2
    np.testing.assert_allclose(state.mean[13:19], VELOCITIES.ravel())
    covariance, column = state.root @ state.root.T, PLACES.gyro_bias
    assert covariance[10, column] == pytest.approx(-2 / 3 * PARAMS.gyro_bias_sigma)
    shares = PARAMS.gyro_bias_sigma**2 * (4 / 9 + 1 / 9)
    assert covariance[10, 10] == pytest.approx(1 / (1 / 1e-10 + 1 / 2e-10) + shares)
    # accelerometers have their own error then, whatever that of the rate is, and tell nothing of it
    _, jacobian = predict_outputs(state.mean, state.reference, state.spin, PARAMS)
    read = jacobian[6:] @ state.root
    np.testing.assert_allclose(read @ read.T, np.diag(PARAMS.variances[6:]), atol=1e-20)
    np.testing.assert_allclose(read @ state.root[10:13].T, np.zeros((6, 3)), atol=1e-20)


def test_the_start_is_incremented_where_gyros_contradict_it() -> None:
    state = some_state(PARAMS)
    sample = some_sample(PARAMS, rates=RATES + 0.5)
    _, report = step(state, sample, PARAMS)
    _, settled = step(state._replace(guarded=True, firing_count=60.0), sample, PARAMS)
    _, idle = step(state, sample._replace(commands=STILL), PARAMS)
    assert (report.incremented, settled.incremented, idle.incremented) == (True, False, False)
    assert np.trace(report.covariance) > 2.0 * np.trace(settled.covariance)


def test_an_overflow_is_an_error_with_its_time() -> None:
    state = some_state(PARAMS)
    with pytest.raises(NotPositiveDefiniteError) as raised:
        step(state._replace(root=1e200 * state.root), READ._replace(time_s=12.5), PARAMS)
    assert raised.value.time_s == 12.5
    assert raised.value.matrix.shape == state.root.shape


FILTER = JointFilterParams(PARAMS, PERIOD)
OFF = np.zeros(6)


def told(time_s: float, command: Any = OFF, **given: Any) -> Told:
    start = {"stamp_s": time_s, "coming": None, "outside_wrench": np.zeros(6)}
    return Told(time_s, command=np.array(command, dtype=float), **(start | given))


@cache
def flown() -> tuple[JointFilterState, JointMeasurement]:
    """The filter after some cycles in which jets fire at random."""
    rng, state = np.random.default_rng(3), joint.initial_state(FILTER)
    for k in range(8):
        rates, fired = RATES + 1e-3 * k * np.array([1.0, -2.0, 0.5]), (rng.uniform(size=6) < 0.4).astype(float)
        measurement = joint.step(state, rates, VELOCITIES + 0.01 * k, told(k * PERIOD, fired), FILTER)
        state = measurement.state
    return state, measurement


def test_a_state_comes_back_from_its_vector() -> None:
    state, _ = flown()
    groups = joint.save_state(state, FILTER)
    assert {name: vector.ndim for name, vector in groups.items()} == {GROUP: 1}
    again = joint.restore_state(groups, FILTER)
    for one, other in zip((*again.joint, *again.clock), (*state.joint, *state.clock), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(again.covariance, state.covariance)


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
        ("read", 0, np.nan, "0 where no reading is kept"),
    ],
)
def test_an_impossible_state_is_refused(field: str, index: int, value: float, message: str) -> None:
    state, _ = flown()
    fresh = np.ones(12) if field == "read" else state.joint.fresh
    vector = joint.pack_filter_state(state._replace(joint=state.joint._replace(fresh=fresh)), FILTER)
    vector[state_layout(PLACES).slice(field).start + index] = value
    with pytest.raises(ValueError, match=message):
        joint.restore_state({GROUP: vector}, FILTER)


def test_reports_say_what_the_cycle_does_and_a_replacement_is_gone_on_from() -> None:
    state, measurement = flown()
    report = measurement.evidence.report
    own = joint.finish(state, measurement, None, NO_ADAPTATION, FILTER)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.append(own.rotation.estimate, own.mass.mass_reciprocal), report.estimate)
    variances = np.append(own.rotation.standard_deviation**2, own.mass.variance)
    np.testing.assert_allclose(variances, report.covariance.diagonal())
    innovations = np.append(own.rotation.rotation_innovation, own.mass.mass_innovation)
    np.testing.assert_array_equal(innovations, report.innovation[[0, 1, 2, 6, 7, 8]])
    before, sample = measurement.evidence.before, measurement.evidence.sample
    projected = predict_cycle(
        before, estimate_forces(before, sample, PARAMS), sample, PARAMS
    ).projected  # not incremented
    expected = np.sqrt((projected @ projected.T).diagonal() + PARAMS.variances)
    deviations = np.append(own.rotation.rotation_innovation_std, own.mass.mass_innovation_std)
    np.testing.assert_allclose(deviations, expected[[0, 1, 2, 6, 7, 8]])
    assert (own.own.gyro_components, own.own.accelerometer_components) == (6, 6)  # nothing is quantized
    assert own.rotation.rotation_nis == pytest.approx(3.0 * report.gyro_nis / 6)
    assert own.mass.mass_nis == pytest.approx(3.0 * report.accelerometer_nis / 6)
    assert report.gyro_nis <= report.nis * (1.0 + 1e-9)

    off = np.zeros(PLACES.size)
    off[CENTER] = 1.0
    other = measurement.state.joint._replace(mean=measurement.state.joint.mean + off, guarded=True, firing_count=60.0)
    replaced = FILTERS["joint"].replaced(own, other, FILTER)
    np.testing.assert_allclose(replaced.rotation.estimate, own.rotation.estimate + off[:9])
    assert replaced.state.joint is other
    assert replaced.state.clock is state.clock
    assert (own.own.settled, replaced.own.settled) == (0.0, 1.0)
    np.testing.assert_array_equal(replaced.rotation.rotation_innovation, own.rotation.rotation_innovation)


def test_a_gap_keeps_the_vehicle_and_begins_rates_anew() -> None:
    state, _ = flown()
    unknown = told(9 * PERIOD, np.full(6, np.nan), stamp_s=state.clock.stamp_s + 30.0, coming=OFF)
    measurement = joint.step(state, RATES + 0.3, VELOCITIES + 5.0, unknown, FILTER)
    after = measurement.state
    assert measurement.evidence.anew
    assert not measurement.evidence.report.used.any()
    np.testing.assert_array_equal(after.estimate, state.estimate)
    np.testing.assert_allclose(after.covariance, state.covariance, rtol=1e-9)
    biases = state.joint.mean[PLACES.gyro_bias : PLACES.gyro_bias + 6].reshape(2, 3)
    unbiased = RATES + 0.3 - PARAMS.gyro_bias_sigma * biases
    np.testing.assert_allclose(after.joint.mean[RATE], (2 * unbiased[0] + unbiased[1]) / 3, rtol=1e-12)
    assert triangular_rows(order_root_rows(after.joint.root, PLACES.thrust)) == PLACES.size
    # outside impulses are of the true interval
    wrench, late = np.array([0.0, 0, 0, 1.0, 0, 0]), state.clock.stamp_s + 1.04 * PERIOD
    measurement = joint.step(state, RATES, VELOCITIES, told(9 * PERIOD, stamp_s=late, outside_wrench=wrench), FILTER)
    np.testing.assert_allclose(measurement.evidence.sample.outside, 1.04 * PERIOD * wrench)
