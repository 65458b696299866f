"""What sensors in a fixed frame read: by hand, and their noise by its moments."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION, RATE, VELOCITY
from massprop_drake.maths.vehicle.tracking import POOR, PoseModel, is_due, read_pose, read_velocity

CENTER, POINT = np.array([0.1, -0.2, 0.05]), np.array([0.4, 0.3, -0.1])
TURN = Rotation.from_rotvec([0.4, -0.9, 0.3])
RATE_NOW, MOVES = np.array([0.5, -0.4, 0.7]), np.array([0.1, -0.2, 0.3])
QUIET = np.array([*[0.0] * 7, 5.0])  # and not a poor one
BODY = np.zeros(N_STATE)
BODY[POSITION], BODY[VELOCITY], BODY[RATE] = (1.0, 2.0, 3.0), MOVES, RATE_NOW
BODY[QUATERNION] = TURN.as_quat(scalar_first=True)


def read(noise: Array = QUIET, **changed: object) -> Array:
    usual = PoseModel(POINT, 0.01, 0.02, 0.0, 0.0, planar=False)
    return read_pose(BODY, CENTER, noise, usual._replace(**changed))


@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_a_pose_is_where_the_point_is_and_how_the_body_is_turned(late_s: float) -> None:
    """A late stamp reads what comes a little later."""
    noise = QUIET.copy()
    noise[6] = 2.0
    reading, then = read(noise, time_std_s=0.5 * late_s), TURN * Rotation.from_rotvec(late_s * RATE_NOW)
    assert_allclose(reading[:3], [1, 2, 3] + late_s * MOVES + then.apply(POINT - CENTER), rtol=1e-9)
    assert_allclose(Rotation.from_quat(reading[3:], scalar_first=True).as_matrix(), then.as_matrix(), atol=1e-9)


def test_a_velocity_is_that_of_a_point_that_swings() -> None:
    found = read_velocity(BODY, CENTER, np.array([1.0, 0.0, -2.0]), POINT, 0.1)
    assert_allclose(found, MOVES + TURN.apply(np.cross(RATE_NOW, POINT - CENTER)) + [0.1, 0.0, -0.2], rtol=1e-12)


@pytest.mark.parametrize("planar", [False, True])
def test_noise_has_its_sigmas_about_each_axis(planar: bool) -> None:
    found = np.array([read(one, planar=planar) for one in np.random.default_rng(7).standard_normal((4000, 8))])
    assert_allclose((found[:, :3] - read()[:3]).std(axis=0), [0.01, 0.01, 0.0 if planar else 0.01], atol=5e-4)
    shown = (TURN.inv() * Rotation.from_quat(found[:, 3:], scalar_first=True)).as_rotvec().std(axis=0)
    assert_allclose(shown, [0.0, 0.0, 0.02] if planar else [0.02] * 3, atol=1e-3)


def test_some_are_poor_all_of_them_at_once_and_what_is_not_measured_is_missing() -> None:
    for drawn, times in ((-1.3, POOR), (-1.2, 1.0)):  # a tenth is below -1.28
        noise = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, drawn])
        assert_allclose(read(noise, outliers=0.1)[:3] - read()[:3], 0.01 * times, rtol=1e-9)
    for missing, there in (("position_std", [False] * 3 + [True] * 4), ("attitude_std", [True] * 3 + [False] * 4)):
        assert np.isfinite(read(**{missing: np.inf})).tolist() == there


def test_a_sensor_of_its_own_rate_is_read_at_the_first_sample_after_its_time() -> None:
    slow = PoseModel(POINT, 0.01, 0.02, 0.0, 0.0, planar=False, rate_hz=4.0, period_s=0.1)
    assert [k for k in range(1, 11) if is_due(0.1 * k, slow)] == [3, 5, 8, 10]
    assert is_due(0.1, slow._replace(rate_hz=np.inf))
