"""Readings in a fixed frame: what is expected by hand, every row against differences, what a plane leaves."""

from __future__ import annotations

import numpy as np
import pytest
from pose_probe import Sensors, moved, nothing_read, small_params, some_bank
from scipy.spatial.transform import Rotation

from massprop_drake.maths.estimation.pose.pose_layout import PoseBank, PoseParams, PoseReadings, Poses
from massprop_drake.maths.estimation.pose.pose_measurement import Compared, compare_readings
from massprop_drake.maths.estimation.pose.turning import rotation_vectors, rotations

ALL = Sensors(poses=2, velocities=2, gyros=2, accelerometers=2)


def seen(bank: PoseBank, params: PoseParams, row: int = 0) -> PoseReadings:
    """What all sensors read if a filter is right, written by hand."""
    parts, mean, rotation = params.parts, bank.mean[row], bank.rotation[row]
    center, position = mean[parts.center], mean[parts.position]
    velocity, rate = mean[parts.velocity], mean[parts.rate]
    points, biases = mean[parts.point].reshape(-1, 3), mean[parts.gyro_bias].reshape(-1, 3)
    gathered = mean[parts.gathered].reshape(-1, 3)
    turned, changed = bank.turned[row], rate - bank.reference[row]
    swing = [
        c + np.cross(changed, x - center) + turned @ (x - center) - np.trace(turned) * (x - center)
        for c, x in zip(gathered, params.accelerometer_positions, strict=True)
    ]
    return PoseReadings(
        positions=np.array([position + rotation @ (point - center) for point in points]),
        rotations=np.array([rotation for _ in points]),
        velocities=np.array([velocity + rotation @ np.cross(rate, x - center) for x in params.velocity_positions]),
        rates=rate + biases,
        gathered=np.array(swing),
    )


def beside(bank: PoseBank, readings: PoseReadings, params: PoseParams) -> Compared:
    found = compare_readings(bank, readings, params)
    assert found is not None
    return found


def off(readings: PoseReadings) -> PoseReadings:
    """Other readings, by some noise; attitudes by a small turn."""
    random = np.random.default_rng(8)
    turn = Rotation.from_rotvec(1e-3 * random.standard_normal((len(readings.rotations), 3))).as_matrix()
    noisy = [part + 0.01 * random.standard_normal(part.shape) for part in readings]
    return PoseReadings(noisy[0], readings.rotations @ turn, *noisy[2:])


def test_what_is_expected_is_what_a_right_filter_reads() -> None:
    params = small_params(ALL)
    bank = some_bank(params, opens=(-1, 1, 2))
    for row in range(3):
        found = beside(bank, seen(bank, params, row), params)
        np.testing.assert_allclose(found.innovation[row], 0.0, atol=1e-14)
        assert np.abs(found.innovation[(row + 1) % 3]).min() > 1e-9


@pytest.mark.parametrize("planar", [False, True], ids=["free", "planar"])
def test_every_row_is_a_difference_of_the_innovation(planar: bool) -> None:
    params = small_params(ALL, planar=planar)
    bank = some_bank(params)
    readings = off(seen(bank, params))
    if planar:
        heading = Rotation.from_euler("z", 1e-3).as_matrix()
        readings = readings._replace(rotations=bank.rotation[:1] @ np.stack([heading, heading.T]))
    found, step = beside(bank, readings, params), 1e-6
    for column, place in enumerate(params.free):
        ahead, behind = (beside(moved(bank, params, place, by), readings, params).innovation for by in (step, -step))
        expected = (behind - ahead) / (2.0 * step)  # the innovation is the reading less what is expected
        attitude = params.parts.attitude.start <= place < params.parts.attitude.stop
        tolerance = 2e-3 if attitude else 1e-8  # an attitude's innovation is of first order in itself
        np.testing.assert_allclose(found.jacobian[0, :, column], expected[0], atol=tolerance, err_msg=str(place))


def test_what_is_missing_has_no_row_and_a_component_alone_has_one() -> None:
    params = small_params(ALL)
    bank = some_bank(params)
    assert compare_readings(bank, nothing_read(params), params) is None
    readings = nothing_read(params)
    readings.positions[1, 1] = 0.3
    readings.rates[0] = 0.1, np.nan, 0.2
    found = beside(bank, readings, params)
    assert found.innovation.shape == (2, 3)
    np.testing.assert_array_equal(found.turning, [False, True, True])
    expected = seen(bank, params)
    rates = (readings.rates[0] - expected.rates[0])[[0, 2]]
    np.testing.assert_allclose(found.innovation[0], [0.3 - expected.positions[1, 1], *rates])


def test_a_stamps_jitter_shifts_a_position_by_the_points_velocity_and_an_attitude_by_the_rate() -> None:
    """Against drawn stamps: what is read a little later, less what is expected now."""
    jitter_s = 1e-3
    poses = Poses(np.array([1e-12]), np.array([1e-12]), np.array([jitter_s**2]))
    params = small_params(pose=poses)
    bank, parts = some_bank(params, opens=(-1,)), params.parts
    bank.mean[0, parts.rate] = 0.9, -1.3, 0.7
    bank.mean[0, parts.point] = 0.8, -0.5, 0.3
    found = beside(bank, seen(bank, params), params)
    drawn = []
    for late_s in jitter_s * np.random.default_rng(4).standard_normal(800):
        turn = Rotation.from_rotvec(late_s * bank.mean[0, parts.rate]).as_matrix()
        mean = bank.mean.copy()
        mean[:, parts.position] += late_s * mean[:, parts.velocity]
        late = seen(bank._replace(mean=mean, rotation=bank.rotation @ turn), params)
        drawn.append(beside(bank, late, params).innovation[0])
    sampled = np.array(drawn).T @ np.array(drawn) / len(drawn)
    own = found.variance[0]
    for block in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(own[block, block], sampled[block, block], atol=0.2 * own[block, block].max())
    assert np.abs(own[:3, :3] - np.diag(np.diag(own[:3, :3]))).max() > 0.1 * own[:3, :3].max()


@pytest.mark.parametrize("angle", [0.0, 1e-7, 9.9e-5, 1.01e-4, 1.0, np.pi - 1e-9, np.pi])
def test_rotations_are_those_of_scipy_and_come_back_up_to_half_a_turn(angle: float) -> None:
    axes = np.random.default_rng(11).standard_normal((50, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    found = rotations(vectors)
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), atol=2e-15)
    back = rotation_vectors(found)
    if angle == np.pi:  # about either side of the axis
        back *= np.sign(np.sum(back * vectors, axis=1))[:, None]
    np.testing.assert_allclose(back, vectors, atol=1e-12, rtol=1e-9)
