"""Which readings count while of a failed jet's force nothing is known."""

from __future__ import annotations

import numpy as np
from joint_probe import INVERSE, PERIOD, TRUTH, small_params, some_sample, some_state

from massprop_drake.maths.estimation.joint.cycle import initial, step
from massprop_drake.maths.estimation.joint.hypotheses import restless
from massprop_drake.maths.estimation.joint.layout import make_places
from massprop_drake.maths.estimation.joint.measurement import told_by_one, unknown_forces

QUANTUM = 1e-4
PARAMS = small_params(
    places=make_places((6, 1, 1), 2, (False, False), False, 2),
    prior_sigma=np.append(np.ones(2), np.zeros(2)),
    accelerometer_positions=np.zeros((1, 3)),
    variances=np.array([QUANTUM**2 / 12] * 3 + [4 * QUANTUM**2 / 12] * 3),
    quanta=np.array([QUANTUM] * 3 + [2 * QUANTUM] * 3),
    thrust_sigma=0.0,
    start_root=np.diag(np.abs(TRUTH) * 1e-9),
)


def test_a_force_is_unknown_where_it_may_be_anything() -> None:
    state = some_state(PARAMS)
    assert unknown_forces(state, PARAMS) == 0
    assert unknown_forces(restless(state, np.array([1.0, 0.0]), PARAMS), PARAMS) == 1
    assert unknown_forces(restless(state, np.ones(2), PARAMS), PARAMS) == 2
    empty = state._replace(slot_jet=np.array([1.0, -1.0]))
    assert unknown_forces(restless(state, np.ones(2), PARAMS)._replace(slot_jet=empty.slot_jet), PARAMS) == 1


def test_what_one_reading_tells_is_taken_off_the_others() -> None:
    """Of four predictions that two unknown forces move, the two that tell most; the others as the normal law has it."""
    rng = np.random.default_rng(3)
    known, effects = 1e-3 * rng.standard_normal((4, 3)), np.array([[1.0, 0], [3, 0.1], [0.2, 2], [0.1, 1]])
    projected, variances = np.hstack((known, effects)), np.array([1e-4, 1e-4, 3e-4, 1e-4])
    read = np.zeros(4)
    deviation, telling = told_by_one(projected, read, 2, variances)
    assert telling.tolist() == [False, True, True, False]
    whole = projected @ projected.T
    told = whole[:, telling] @ np.linalg.inv(whole[np.ix_(telling, telling)] + np.diag(variances[telling]))
    np.testing.assert_allclose(deviation**2, np.diag(whole - told @ whole[telling]), rtol=1e-6)
    deviation, telling = told_by_one(projected, np.array([0.0, np.nan, 0, 0]), 1, variances)
    assert telling.tolist() == [False, False, True, False]
    _, telling = told_by_one(projected, np.full(4, np.nan), 2, variances)
    assert not telling.any()
    deviation, telling = told_by_one(projected, read, 0, variances)
    assert not telling.any()
    np.testing.assert_allclose(deviation, np.sqrt(np.diag(whole)))


def test_a_rate_that_stands_still_is_not_read_anew_because_a_jet_may_have_given_anything() -> None:
    """A vehicle at rest, a jet that is expected to do anything: its readings are the same again and again.

    All that is told is that the jet gives nothing. Across what it pushes the rate is known no better than by a reading.
    """
    state = initial(PARAMS)._replace(slot_jet=np.array([1.0, -1.0]), guarded=True, freed=True)
    still = some_sample(PARAMS, rates=np.zeros((1, 3)), velocities=np.zeros((1, 3)))
    still = still._replace(commands=np.zeros((1, 6)))
    for cycle in range(60):
        state, report = step(
            restless(state, np.array([1.0, 0.0]), PARAMS), still._replace(time_s=PERIOD * (1 + cycle)), PARAMS
        )
        assert cycle == 0 or report.used.sum() == 1
    torque, force = np.split(PARAMS.wrenches[1], 2)
    across = np.cross(INVERSE @ (torque - np.cross(TRUTH[6:9], force)), [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    sigma = np.linalg.norm(across @ state.root[10:13])
    assert sigma > 0.5 * QUANTUM / np.sqrt(12.0)
