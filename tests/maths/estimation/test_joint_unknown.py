"""Jets whose commands are not known: what readings show of what they gave, and that it teaches nothing."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint.forcing import compute_forces
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import RATE, VELOCITY, JointState
from massprop_drake.maths.estimation.joint.measurement import predict_outputs
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.relinearization import run_relinearized
from massprop_drake.maths.estimation.joint.unknown import is_untestable, remove_directions, unknown_impulse_covariance
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params(time_constants_s=np.zeros(6))
STATE = some_state(PARAMS)._replace(guarded=True, slot_jet=np.full(2, -1.0))
COMMANDS = np.array([[1.0, 0, 1, 0, 0, 1]])


def unknown(*jets: int) -> JointSample:
    """A sample in which commands of some jets are not known."""
    commands = COMMANDS.copy()
    commands[0, list(jets)] = np.nan
    return some_sample(PARAMS, commands=commands)


def read(sample: JointSample, openings_s: Array) -> JointSample:
    """The sample with the readings that its commands give where jets that are not told are open for so long."""
    told = np.where(np.isnan(sample.commands), openings_s / PERIOD, sample.commands)
    acting = compute_forces(STATE, sample._replace(commands=told), PARAMS)
    prediction = predict(STATE, acting, unread(PARAMS), PARAMS)
    values, _ = predict_outputs(prediction.mean, STATE.reference, STATE.spin + prediction.spin, PARAMS)
    return sample._replace(rates=values[:6].reshape(2, 3), velocities=values[6:].reshape(2, 3))


@pytest.mark.parametrize(("jets", "number"), [((), 0), ((1,), 1), ((1, 4), 2), (range(6), 6)])
def test_jets_open_the_directions_that_they_span(jets: tuple[int, ...], number: int) -> None:
    anything = estimate_forces(STATE, unknown(*jets), PARAMS).anything
    assert anything.number == number
    covariance = unknown_impulse_covariance(anything)
    assert np.linalg.matrix_rank(covariance, tol=1e-9 * np.abs(covariance).max() if jets else None) == number
    rows = np.random.default_rng(1).standard_normal((6, PARAMS.places.size))
    left = np.vstack(remove_directions(rows[:3], rows[3:], anything))
    np.testing.assert_allclose(anything.dual.T @ left, 0.0, atol=1e-9 * np.abs(anything.dual).max())
    if number == 0:
        np.testing.assert_array_equal(left, rows)
    wrenches = PARAMS.wrenches.copy()
    wrenches[4] = -2.0 * wrenches[1]  # on one line
    lines = estimate_forces(STATE, unknown(*jets), PARAMS._replace(wrenches=wrenches)).anything
    assert lines.number == number - (4 in jets)


@pytest.mark.parametrize(("openings_s", "shown"), [((0.03, 0.08), (0.03, 0.08)), ((0.13, -0.05), (PERIOD, 0.0))])
def test_readings_show_how_long_jets_were_open(openings_s: tuple[float, ...], shown: tuple[float, ...]) -> None:
    """No longer than the interval."""
    sample = read(unknown(1, 4), np.array([0.0, openings_s[0], 0.0, 0.0, openings_s[1], 0.0]))
    amount = estimate_forces(STATE, sample, PARAMS).firing.amount
    np.testing.assert_allclose(amount[[1, 4]], shown, rtol=0.01)
    np.testing.assert_array_equal(amount[[0, 2, 3, 5]], PERIOD * COMMANDS[0, [0, 2, 3, 5]])


def test_where_no_command_is_known_nothing_is_learned_and_nothing_tested() -> None:
    sample = read(unknown(*range(6)), np.array([0.1, 0, 0.1, 0, 0.1, 0]))
    sample.rates[1] = sample.velocities[1] = np.nan  # two packages tell of each other's biases
    after, report = step(STATE, sample, PARAMS)
    np.testing.assert_allclose(after.mean[:9], STATE.mean[:9], rtol=1e-6)
    before, now = (state.root[:9] @ state.root[:9].T for state in (STATE, after))
    np.testing.assert_allclose(np.sqrt(np.diag(now)), np.sqrt(np.diag(before)), rtol=1e-4)
    assert is_untestable(report.course.acting.firing, report.course.acting.anything)
    assert report.gyro_degrees == 0.0
    biases = PARAMS.gyro_bias_sigma * after.mean[PARAMS.places.gyro_bias : PARAMS.places.gyro_bias + 3]
    np.testing.assert_allclose(after.mean[RATE] + biases, sample.rates[0], atol=5e-5)


@pytest.mark.parametrize("again", [False, True])
def test_nothing_is_learned_of_how_long_a_jet_was_open(again: bool) -> None:
    def after(opening_s: float) -> JointState:
        sample = read(unknown(1), np.full(6, opening_s))
        return run_relinearized(STATE, sample, STATE.mean, PARAMS)[0] if again else step(STATE, sample, PARAMS)[0]

    closed, half, open_ = (after(opening_s) for opening_s in (0.0, 0.05, 0.1))
    first = VELOCITY + 3 * PARAMS.places.accelerometers
    parameters = np.r_[:9, first : PARAMS.places.size]  # the mass falls by the propellant
    sigmas = np.sqrt(np.sum(STATE.root**2, axis=1))[parameters]
    for state in (closed, open_):
        moved = (state.mean - half.mean)[parameters] / np.where(sigmas > 0.0, sigmas, 1.0)
        assert np.abs(moved).max() < 0.02
