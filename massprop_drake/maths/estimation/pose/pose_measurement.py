r"""Readings in a fixed frame, and their derivatives.

    position of a tracked point    p + R (p_s - r)
    attitude                       R, its error phi in body axes
    velocity of a tracked point    v + R (w x (p_s - r))
    rate                           w + bias
    gathered velocity              c + O (x - r),    O = [(w - w_0) x] + C - tr C 1

with C the integral of w w^T. A stamp that is off by dt shifts a position by the point's velocity times dt, and an
attitude by the rate's: its variance enters the readings' covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_layout import PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.turning import matrix_vector_products, rotation_vectors, skew_matrices
from massprop_drake.maths.linear_algebra import Array, cross_products

_EYE = np.eye(3)
_PLANE = np.array([0, 1])  # of what is in the fixed frame, where motion is planar
_HEADING = np.array([2])  # of what is in body axes
_SPACE = np.arange(3)


class Compared(NamedTuple):
    """Readings beside the predictions of a bank.

    Attributes:
        innovation: shape (n_filters, m).
        jacobian: by what is free, shape (n_filters, m, n).
        variance: of the readings, shape (n_filters, m, m).
        turning: which components are of attitude and rate, and not of place and velocity, shape (m,).
        poses: which are of a pose sensor, shape (m,).
    """

    innovation: Array
    jacobian: Array
    variance: Array
    turning: np.ndarray
    poses: np.ndarray


class _Rows:
    """Readings as they are collected."""

    def __init__(self, bank: PoseBank, params: PoseParams):
        self._count, self._params = bank.mean.shape[0], params
        self._rows: list[tuple[Array, Array, Array, list[tuple[bool, bool]]]] = []

    def add(
        self, error: Array, derivatives: dict[str, Array], covariance: Array, axes: np.ndarray, kind: tuple[bool, bool]
    ) -> None:
        """Adds a reading of three components: innovation, derivatives by part of the state, covariance, axes, kind.

        The kind is whether it is of attitude or rate, and whether of a pose sensor.
        """
        axes = axes[np.isfinite(error[0, axes])]
        if axes.size == 0 or not np.isfinite(covariance).all():
            return
        parts = self._params.parts
        jacobian = np.zeros((self._count, axes.size, parts.size))
        for name, block in derivatives.items():
            part, _, place = name.partition(":")
            columns = getattr(parts, part)
            begin = columns.start + 3 * int(place or 0)
            jacobian[:, :, begin : begin + 3] += np.broadcast_to(block, (self._count, 3, 3))[:, axes]
        own = np.broadcast_to(covariance, (self._count, 3, 3))[:, axes[:, None], axes]
        self._rows.append((error[:, axes], jacobian[:, :, self._params.free], own, [kind] * axes.size))

    def stack(self) -> Compared | None:
        """Stacks all readings added so far into innovations, Jacobians and covariances; None: there are none."""
        if not self._rows:
            return None
        innovations, jacobians, variances, kinds = zip(*self._rows, strict=True)
        innovation, jacobian = (np.concatenate(part, axis=1) for part in (innovations, jacobians))
        variance, end = np.zeros((*innovation.shape, innovation.shape[1])), 0
        for block in variances:
            begin, end = end, end + block.shape[1]
            variance[:, begin:end, begin:end] = block
        return Compared(innovation, jacobian, variance, *np.concatenate(kinds).T)


def compare_readings(bank: PoseBank, readings: PoseReadings, params: PoseParams) -> Compared | None:
    """Computes innovations, Jacobians and covariances of readings by a bank of filters; None: nothing is read."""
    parts, rotation = params.parts, bank.rotation
    rows = _Rows(bank, params)
    in_frame, in_body = (_PLANE, _HEADING) if params.planar else (_SPACE, _SPACE)
    position, velocity, rate = (bank.mean[:, part] for part in (parts.position, parts.velocity, parts.rate))
    sensors = params.pose
    for index in range(readings.positions.shape[0]):
        point = parts.point.start + 3 * index
        arm = bank.mean[:, point : point + 3] - bank.mean[:, parts.center]
        moves = velocity + matrix_vector_products(rotation, cross_products(rate, arm))
        jitter = sensors.jitter_variances[index]
        white = np.diag(np.full(3, sensors.position_variances[index]))
        variance = white + jitter * moves[:, :, None] * moves[:, None, :]
        by = {
            "position": _EYE,
            "attitude": -rotation @ skew_matrices(arm),
            "center": -rotation,
            f"point:{index}": rotation,
        }
        error = readings.positions[index] - position - matrix_vector_products(rotation, arm)
        rows.add(error, by, variance, in_frame, (False, True))
        variance = np.diag(np.full(3, sensors.attitude_variances[index])) + jitter * rate[:, :, None] * rate[:, None, :]
        error = np.full_like(rate, np.nan)
        if np.isfinite(readings.rotations[index]).all():
            error = rotation_vectors(np.swapaxes(rotation, 1, 2) @ readings.rotations[index])
        rows.add(error, {"attitude": _EYE}, variance, in_body, (True, True))
    for index, variance in enumerate(params.velocity_variances):
        arm = params.velocity_positions[index] - bank.mean[:, parts.center]
        moved = cross_products(rate, arm)
        by = {
            "velocity": _EYE,
            "attitude": -rotation @ skew_matrices(moved),
            "rate": -rotation @ skew_matrices(arm),
            "center": -rotation @ skew_matrices(rate),
        }
        error = readings.velocities[index] - velocity - matrix_vector_products(rotation, moved)
        rows.add(error, by, variance * _EYE, in_frame, (False, False))
    for index, variance in enumerate(params.gyro_variances):
        bias = bank.mean[:, parts.gyro_bias][:, 3 * index : 3 * index + 3]
        by = {"rate": _EYE, f"gyro_bias:{index}": _EYE}
        rows.add(readings.rates[index] - rate - bias, by, variance * _EYE, in_body, (True, False))
    if params.accelerometer_variances.size:
        trace = np.trace(bank.turned, axis1=1, axis2=2)[:, None, None]
        turn = skew_matrices(rate - bank.reference) + bank.turned - trace * _EYE
        for index, variance in enumerate(params.accelerometer_variances):
            arm = params.accelerometer_positions[index] - bank.mean[:, parts.center]
            begin = parts.gathered.start + 3 * index
            by = {f"gathered:{index}": _EYE, "rate": -skew_matrices(arm), "center": -turn}
            error = readings.gathered[index] - bank.mean[:, begin : begin + 3] - matrix_vector_products(turn, arm)
            rows.add(error, by, variance * _EYE, in_frame, (False, False))
    return rows.stack()


def predict_readings(bank: PoseBank, params: PoseParams) -> PoseReadings:
    """Predicts the readings of error-free sensors by the first filter of a bank."""
    parts, rotation = params.parts, bank.rotation[0]
    mean = bank.mean[0]
    center, rate, velocity = mean[parts.center], mean[parts.rate], mean[parts.velocity]
    points = mean[parts.point].reshape(-1, 3) - center
    arms = params.velocity_positions - center
    biases = mean[parts.gyro_bias].reshape(-1, 3)
    turn = skew_matrices(rate - bank.reference[0]) + bank.turned[0] - np.trace(bank.turned[0]) * _EYE
    reach = params.accelerometer_positions - center
    return PoseReadings(
        positions=mean[parts.position] + points @ rotation.T,
        rotations=np.repeat(rotation[None], len(points), axis=0),
        velocities=velocity + cross_products(rate, arms) @ rotation.T,
        rates=rate + biases,
        gathered=mean[parts.gathered].reshape(-1, 3) + reach @ turn.T,
    )
