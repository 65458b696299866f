"""Which readings count, and when each is taken in."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, TRUTH, small_params, some_sample

from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.joint_cycle import JointSample, begun, crossed, initial, step
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams, JointState, make_places
from massprop_drake.maths.estimation.joint.measurement import changed, counted, outputs
from massprop_drake.maths.estimation.joint.quantized import sites

QUANTUM = 1e-4
CELLS = np.array([QUANTUM] * 3 + [2 * QUANTUM] * 3)
PARAMS = small_params(
    places=make_places((6, 1, 1), 2, (False, False), False, 2),
    prior_sigma=np.append(np.ones(2), np.zeros(2)),
    accelerometer_positions=np.zeros((1, 3)),
    variances=CELLS**2 / 12,
    quanta=CELLS,
    cells=CELLS,
    floors=(0.01 * CELLS) ** 2,
    dithered=np.zeros(6),
    thrust_sigma=0.0,
    start_root=np.diag(np.abs(TRUTH) * 1e-9),
)


def reading(rates: list[float], params: JointParams = PARAMS, number: int = 1) -> JointSample:
    """A sample without commands and with some rates."""
    empty = some_sample(params)
    return empty._replace(
        time_s=number * PERIOD,
        commands=np.zeros_like(empty.commands),
        outside=np.zeros(6),
        rates=np.array([rates]),
        velocities=np.zeros((1, 3)),
    )


def after(*readings: list[float], params: JointParams = PARAMS) -> JointState:
    """The state after some rates were read."""
    state = begun(initial(params), reading(readings[0], params, 0), params)
    for number, rates in enumerate(readings[1:], start=1):
        state, _ = step(state, reading(rates, params, number), params)
    return state


def test_a_reading_that_stays_does_not_count_and_one_that_differs_does() -> None:
    before = np.array([0.0, 1.0, np.nan, np.nan, 0.0, 0.0])
    now = np.array([QUANTUM, 1.0, 2.0, np.nan, np.nan, 0.0])
    assert changed(now, before, PARAMS).tolist() == [True, False, True, False, False, False]
    sure, at = np.zeros(6), np.nan_to_num(now)
    assert counted(now, before, at, sure, PARAMS.floors, PARAMS)[0].tolist() == [True, False, True, False, False, False]


def test_a_reading_off_its_prediction_or_sharper_than_it_counts() -> None:
    same, sure = np.zeros(6), np.full(6, (0.1 * QUANTUM) ** 2)
    predicted = np.array([0.0, 0.81 * QUANTUM, 0.79 * QUANTUM, 0.0, 0.0, 0.0])  # half a quantum and three sigmas: .80
    assert counted(same, same, predicted, sure, PARAMS.floors, PARAMS)[0].tolist() == [
        False,
        True,
        False,
        False,
        False,
        False,
    ]
    unsure = np.where(np.arange(6) == 2, (0.51 * QUANTUM) ** 2, 0.0)
    assert counted(same, same, same, unsure, PARAMS.floors, PARAMS)[0].tolist() == [
        False,
        False,
        True,
        False,
        False,
        False,
    ]


def test_each_sample_of_a_dithered_sensor_counts() -> None:
    params = PARAMS._replace(dithered=np.array([1.0, 0, 0, 0, 0, 0]))
    same, sure = np.zeros(6), np.zeros(6)
    assert counted(same, same, same, sure, params.floors, params)[0].tolist() == [
        True,
        False,
        False,
        False,
        False,
        False,
    ]
    assert counted(np.full(6, np.nan), same, same, sure, params.floors, params)[0].tolist() == [False] * 6


def test_the_last_reading_before_a_change_is_taken_in_with_its_own_state_and_once() -> None:
    state = after([0.0, 0, 0], [0.0, 0, 0], [0.0, 0, 0])
    assert state.fresh.tolist() == [1.0] * 6
    now, crossing = crossed(
        state, state.mean[:N_PROPERTIES], reading([QUANTUM, 0.0, 0.0], number=3), PARAMS.floors, PARAMS
    )
    assert np.flatnonzero(crossing.rows.any(axis=1)).tolist() == [0]
    assert crossing.log_likelihood < 0.0
    assert np.sum(now.root[10] ** 2) < np.sum(state.root[10] ** 2)  # it is known better where the rate was
    again, nothing = crossed(
        now, now.mean[:N_PROPERTIES], reading([QUANTUM, 0.0, 0.0], number=3), PARAMS.floors, PARAMS
    )
    assert nothing.log_likelihood == 0.0
    np.testing.assert_array_equal(again.mean, now.mean)


def test_a_reading_that_counted_already_is_not_taken_in_again() -> None:
    state = after([0.0, 0, 0], [QUANTUM, 0, 0])
    assert state.fresh[0] == 0.0
    _, crossing = crossed(state, state.mean[:N_PROPERTIES], reading([0.0, 0.0, 0.0], number=2), PARAMS.floors, PARAMS)
    assert not crossing.rows.any()


def test_nothing_is_taken_in_across_a_reading_that_is_missing() -> None:
    state = after([0.0, 0, 0], [0.0, 0, 0], [np.nan, 0, 0])
    assert state.fresh[0] == 0.0
    _, crossing = crossed(
        state, state.mean[:N_PROPERTIES], reading([QUANTUM, 0.0, 0.0], number=3), PARAMS.floors, PARAMS
    )
    assert not crossing.rows.any()


def test_a_rate_that_stands_still_is_not_known_ever_better() -> None:
    """The same constraint again and again is one constraint."""
    few, many = (after(*[[0.0, 0.0, 0.0]] * number) for number in (5, 50))
    np.testing.assert_allclose(np.sum(many.root[10:13] ** 2, axis=1), np.sum(few.root[10:13] ** 2, axis=1), rtol=1e-6)


def test_what_is_taken_in_is_the_site_of_the_reading_with_the_state_of_its_own_sample() -> None:
    state = after([0.0, 0, 0], [0.0, 0, 0])
    now, told = crossed(state, state.mean[:N_PROPERTIES], reading([QUANTUM, 0, 0], number=2), PARAMS.floors, PARAMS)
    values, jacobian = outputs(state.mean, state.reference, state.spin, PARAMS)
    before = state.root @ state.root.T
    variance = jacobian[0] @ before @ jacobian[0]
    site = sites(-values[:1], np.array([[variance]]), PARAMS.cells[:1], PARAMS.floors[:1])
    gain = before @ jacobian[0] / (variance + site.variance[0])
    assert told.log_likelihood == pytest.approx(site.log_likelihood[0])
    through = told.half_gain @ told.rows  # K H
    np.testing.assert_allclose(through, np.outer(gain, jacobian[0]), rtol=1e-7, atol=1e-16)
    assert not told.rows[1:].any()
    np.testing.assert_allclose(now.mean, state.mean + gain * site.innovation[0], rtol=1e-9, atol=1e-18)
    rest = np.eye(before.shape[0]) - np.outer(gain, jacobian[0])
    joseph = rest @ before @ rest.T + site.variance[0] * np.outer(gain, gain)
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    np.testing.assert_allclose((now.root @ now.root.T - joseph) / np.outer(scale, scale), 0.0, atol=1e-9)


def test_a_cycle_has_the_likelihood_of_both_readings() -> None:
    state, later = after([0.0, 0, 0], [0.0, 0, 0])._replace(guarded=True), reading([QUANTUM, 0.0, 0.0], number=2)
    now, told = crossed(state, state.mean[:N_PROPERTIES], later, PARAMS.floors, PARAMS)
    (_, report), (_, alone) = step(state, later, PARAMS), step(now, later, PARAMS)
    assert report.log_likelihood == pytest.approx(told.log_likelihood + alone.log_likelihood)
    assert report.course is not None
    np.testing.assert_array_equal(report.course.crossing.correction, told.correction)


def test_a_reading_that_changes_back_counts_twice() -> None:
    for number, rate in ((2, QUANTUM), (3, 0.0)):
        state = after([0.0, 0, 0], [0.0, 0, 0], *[[QUANTUM, 0.0, 0.0]] * (number - 2))
        _, report = step(state, reading([rate, 0.0, 0.0], number=number), PARAMS)
        assert report.used[0]


def test_a_kept_state_may_lack_readings() -> None:
    params = JointFilterParams(PARAMS, PERIOD)
    first = joint.initial(params)
    groups = joint.saved(first, params)
    np.testing.assert_array_equal(joint.restored(groups, params).joint.read, first.joint.read)
    wrong = joint.saved(first._replace(joint=first.joint._replace(fresh=np.ones(6))), params)
    with pytest.raises(ValueError, match="0 where no reading is kept"):
        joint.restored(wrong, params)
