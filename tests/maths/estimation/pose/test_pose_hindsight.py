"""A record beside a vehicle: sensitivities against differences, and what a small error looks like."""

from __future__ import annotations

from typing import Any

import numpy as np
from pose_probe import JETS, MASS, Sensors, small_params

from massprop_drake.maths.estimation.pose import pose_hindsight
from massprop_drake.maths.estimation.pose.pose_hindsight import Assumed, PoseRecord
from massprop_drake.maths.estimation.pose.pose_layout import PoseBank, PoseParams
from massprop_drake.maths.estimation.pose.pose_measurement import predict_readings
from massprop_drake.maths.estimation.pose.pose_prediction import predict_bank
from massprop_drake.maths.linear_algebra import Array

ROWS, PERIOD_S = 36, 0.1
ALL = Sensors(poses=2, velocities=1, gyros=1, accelerometers=1)


def make(sensors: Sensors = ALL, **changed: Any) -> PoseParams:
    made = small_params(sensors, **changed)
    variances = np.full(made.free.size, 1e-4)
    for name, variance in (("velocity", 1.0), ("rate", 0.1)):
        variances[np.isin(made.free, np.arange(made.parts.size)[getattr(made.parts, name)])] = variance
    return made._replace(covariance=np.diag(variances), rate_noise=1e-4, velocity_noise=1e-4)


def body(made: PoseParams) -> Array:
    """A vehicle with a value for everything that may be other than thought."""
    parts = made.parts
    at = pose_hindsight.unknowns_from_state(made.start, 1.0 / MASS, made)
    at[parts.thrust] = [1.05, 0.9, 1.0, 0.97]
    at[parts.center] = [0.02, -0.03, 0.01]
    at[parts.delay], at[parts.opening], at[parts.lag] = [0.03, 0.05], [0.01, -0.005], [0.02, 0.03]
    at[parts.drag], at[parts.push], at[parts.tilt] = [0.05, 0.08], 1e-3 * np.arange(1, 7), [2e-3, -1e-3]
    at[parts.point] = 0.1 * np.arange(parts.point.stop - parts.point.start)
    at[parts.gyro_bias], at[parts.acceleration_bias] = 1e-3, 2e-3
    return at


def flown(at: Array, made: PoseParams) -> PoseRecord:
    """What a vehicle reads that is told some pulses, without noise."""
    movable = np.setdiff1d(np.arange(made.parts.size), np.arange(made.parts.size)[made.parts.open])
    known = pose_hindsight.known_vehicle_params(Assumed(at), movable, made)
    random = np.random.default_rng(4)
    levels = np.repeat((random.random((ROWS // 3, JETS)) < 0.3).astype(float), 3, axis=0)
    record = PoseRecord(PERIOD_S * np.arange(ROWS), levels, [])
    mean, n = known.start.copy(), movable.size
    mean[made.parts.rate], mean[made.parts.velocity] = [0.05, -0.02, 0.03], [0.1, 0.0, -0.05]
    rate = mean[made.parts.rate]
    bank = PoseBank(mean[None], np.zeros((1, n, n)), np.eye(3)[None], np.array([-1]), rate[None], np.zeros((1, 3, 3)))
    readings = [predict_readings(bank, known)]
    for row in range(1, ROWS):
        bank = predict_bank(bank, record.commands(row), *record.time_s[row - 1 : row + 1].tolist(), known).bank
        readings.append(predict_readings(bank, known))
    return record._replace(readings=readings)


def places(made: PoseParams) -> np.ndarray:
    return np.flatnonzero(pose_hindsight.select_unknowns(made.parts))


def test_derivatives_of_the_state() -> None:
    made = make()
    at = body(made)
    by = pose_hindsight.state_derivatives(at, made)
    for place in places(made):
        step = np.zeros_like(at)
        step[place] = 1e-6 * max(abs(at[place]), 0.01)
        ahead, back = (pose_hindsight.state_from_unknowns(at + move, made) for move in (step, -step))
        np.testing.assert_allclose(by[:, place], (ahead - back) / (2.0 * step[place]), rtol=1e-6, atol=1e-8)


def test_a_vehicles_own_record_has_no_misfit_and_no_score() -> None:
    made = make()
    at = body(made)
    found = pose_hindsight.record_equations(flown(at, made), Assumed(at), np.arange(made.parts.size), made)
    assert found.readings == (ROWS - 1) * (2 * 6 + 3 + 3 + 3)
    assert found.misfit < 0.01 * found.readings  # what is not linear in the first samples
    told = found.information.diagonal() > 0.0
    assert told[places(made)].mean() > 0.9
    assert np.abs(found.score[told] / np.sqrt(found.information.diagonal()[told])).max() < 0.5


def test_one_pass_finds_what_is_a_little_other_than_thought() -> None:
    made = make(Sensors(poses=1))
    truth, movable = body(made), np.arange(made.parts.size)
    record = flown(truth, made)
    wrong = truth.copy()
    chosen = [made.parts.thrust.start + 1, made.parts.center.start, made.parts.delay.start]
    wrong[chosen] += [0.01, 2e-3, 1e-3]
    found = pose_hindsight.record_equations(record, Assumed(wrong), movable, made)
    move = np.linalg.solve(found.information[np.ix_(chosen, chosen)], found.score[chosen])
    np.testing.assert_allclose(move, truth[chosen] - wrong[chosen], rtol=0.05)
