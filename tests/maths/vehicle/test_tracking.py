"""What sensors in a fixed frame read: by hand, and their noise by its moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION, RATE, VELOCITY
from massprop_drake.maths.vehicle.tracking import POOR, PoseModel, pose_read, velocity_read

CENTER, POINT = np.array([0.1, -0.2, 0.05]), np.array([0.4, 0.3, -0.1])
TURN = Rotation.from_rotvec([0.4, -0.9, 0.3])
QUIET = np.array([*[0.0] * 7, 5.0])  # and not a poor one


def body() -> Array:
    state = np.zeros(N_STATE)
    state[POSITION], state[VELOCITY] = (1.0, 2.0, 3.0), (0.1, -0.2, 0.3)
    x, y, z, w = TURN.as_quat()
    state[QUATERNION], state[RATE] = (w, x, y, z), (0.5, -0.4, 0.7)
    return state


def model(**changed: object) -> PoseModel:
    usual = PoseModel(POINT, 0.01, 0.02, 0.0, 0.0, planar=False)
    return usual._replace(**changed)


def test_a_pose_is_where_the_point_is_and_how_the_body_is_turned() -> None:
    reading = pose_read(body(), CENTER, QUIET, model())
    np.testing.assert_allclose(reading[:3], body()[POSITION] + TURN.apply(POINT - CENTER), rtol=1e-12)
    np.testing.assert_allclose(np.abs(reading[3:] @ body()[QUATERNION]), 1.0, rtol=1e-12)


def test_a_velocity_is_that_of_a_point_that_swings() -> None:
    found = velocity_read(body(), CENTER, np.array([1.0, 0.0, -2.0]), POINT, 0.1)
    swing = TURN.apply(np.cross([0.5, -0.4, 0.7], POINT - CENTER))
    np.testing.assert_allclose(found, np.array([0.1, -0.2, 0.3]) + swing + [0.1, 0.0, -0.2], rtol=1e-12)


def test_a_late_stamp_reads_what_comes_a_little_later() -> None:
    late = QUIET.copy()
    late[6] = 2.0
    reading = pose_read(body(), CENTER, late, model(time_std_s=0.01))
    after = TURN * Rotation.from_rotvec(0.02 * np.array([0.5, -0.4, 0.7]))
    place = [1, 2, 3] + 0.02 * np.array([0.1, -0.2, 0.3]) + after.apply(POINT - CENTER)
    np.testing.assert_allclose(reading[:3], place, rtol=1e-9)
    np.testing.assert_allclose(Rotation.from_quat(reading[[4, 5, 6, 3]]).as_matrix(), after.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("planar", [False, True])
def test_noise_has_its_sigmas_about_each_axis(planar: bool) -> None:
    random = np.random.default_rng(7)
    usual = model(planar=planar)
    noise = random.standard_normal((4000, 8))
    read = np.array([pose_read(body(), CENTER, one, usual) for one in noise])
    exact = pose_read(body(), CENTER, QUIET, usual)
    deviation = (read[:, :3] - exact[:3]).std(axis=0)
    np.testing.assert_allclose(deviation, [0.01, 0.01, 0.0 if planar else 0.01], atol=5e-4)
    turned = TURN.inv() * Rotation.from_quat(read[:, [4, 5, 6, 3]])
    shown = turned.as_rotvec().std(axis=0)
    np.testing.assert_allclose(shown, [0.0, 0.0, 0.02] if planar else [0.02] * 3, atol=1e-3)


def test_some_are_poor_all_of_them_at_once() -> None:
    noise = np.ones(8)
    noise[6] = 0.0
    exact = pose_read(body(), CENTER, QUIET, model())
    for drawn, times in ((-1.3, POOR), (-1.2, 1.0)):  # a tenth is below -1.28
        noise[7] = drawn
        reading = pose_read(body(), CENTER, noise, model(outliers=0.1))
        np.testing.assert_allclose(reading[:3] - exact[:3], 0.01 * times, rtol=1e-9)


def test_what_is_not_measured_is_missing() -> None:
    nowhere = pose_read(body(), CENTER, QUIET, model(position_std=np.inf))
    assert np.isnan(nowhere[:3]).all()
    assert np.isfinite(nowhere[3:]).all()
    unturned = pose_read(body(), CENTER, QUIET, model(attitude_std=np.inf))
    assert np.isfinite(unturned[:3]).all()
    assert np.isnan(unturned[3:]).all()
