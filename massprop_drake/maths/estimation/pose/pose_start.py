r"""Prior before the first sample, and the effect of the first readings.

With sigma_M of the mass, sigma_T of each jet's thrust by itself and sigma_C of what all jets share, relative,

    cov g = (sigma_M^2 + sigma_C^2) 1 1^T + sigma_T^2,    cov (g, c) = sigma_C^2,    cov (K, g) = -K sigma_M^2

and K = m J, J the inverse inertia, has cov K = m^2 cov J + K K^T sigma_M^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_layout import Parts, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.turning import skew_matrices
from massprop_drake.maths.linear_algebra import Array, symmetrized


class VehiclePrior(NamedTuple):
    """Prior before the first sample, 1-sigma each; zero: fixed.

    Attributes:
        spin: m J of the nominal vehicle, six elements, shape (6,).
        inverse_covariance: of J, times m^2, shape (6, 6).
        mass_std, common_std: relative.
        thrust_std: relative, shape (n_jets,).
        rest: mean of the whole state, of which thrust, common and spin play no part, shape (size,).
        rest_std: of it, likewise, shape (size,).
    """

    spin: Array
    inverse_covariance: Array
    mass_std: float
    common_std: float
    thrust_std: Array
    rest: Array
    rest_std: Array


def prior(vehicle_prior: VehiclePrior, fixed: np.ndarray, parts: Parts) -> tuple[Array, Array, np.ndarray]:
    """Computes the prior: mean of the state, (size,), covariance of its free elements, (n, n), and their indices.

    Args:
        fixed: whether an element is, whatever its sigma, shape (size,).
    """
    mean, covariance = vehicle_prior.rest.copy(), np.diag(vehicle_prior.rest_std**2)
    thrust, common, spin = parts.thrust, parts.common, parts.spin
    mean[thrust], mean[common], mean[spin] = 1.0, 0.0, vehicle_prior.spin
    shared, of_mass = vehicle_prior.common_std**2, vehicle_prior.mass_std**2
    covariance[thrust, thrust] = of_mass + shared + np.diag(vehicle_prior.thrust_std**2)
    covariance[thrust, common] = covariance[common, thrust] = shared
    covariance[common, common] = shared
    covariance[spin, spin] = vehicle_prior.inverse_covariance + of_mass * np.outer(
        vehicle_prior.spin, vehicle_prior.spin
    )
    covariance[spin, thrust] = -of_mass * vehicle_prior.spin[:, None]
    covariance[thrust, spin] = covariance[spin, thrust].T
    free = np.flatnonzero((np.diag(covariance) > 0.0) & ~fixed)
    return mean, covariance[np.ix_(free, free)], free


def initialize_bank(readings: PoseReadings, params: PoseParams) -> PoseBank:
    """Initializes one filter by the first sample's readings of attitude and position; returns a bank of one.

    Nothing tells whether a first reading is a poor one: where there are such, it counts as one.
    """
    poor = params.pose.outlier_scale**2 if params.pose.outliers > 0.0 else 1.0
    parts, mean = params.parts, params.start.copy()
    size = parts.size
    whole = np.zeros((size, size))
    whole[np.ix_(params.free, params.free)] = params.covariance
    rotation = np.eye(3)
    for place, read in enumerate(readings.rotations):
        if np.isfinite(read).all():
            rotation = read.copy()
            whole[parts.attitude], whole[:, parts.attitude] = 0.0, 0.0
            whole[parts.attitude, parts.attitude] = poor * params.pose.attitude_variances[place] * np.eye(3)
            break
    located = first_pose_sensor(readings)
    if located is not None:
        columns, read = tracked_point(located, parts), readings.positions[located]
        arm = mean[columns] - mean[parts.center]
        mean[parts.position] = np.where(np.isfinite(read), read - rotation @ arm, 0.0)
        rows = np.zeros((3, size))  # p = reading - R (p_s - r)
        rows[:, columns], rows[:, parts.center] = -rotation, rotation
        rows[:, parts.attitude] = rotation @ skew_matrices(arm)
        whole[parts.position] = rows @ whole
        whole[:, parts.position] = whole[parts.position].T
        own = rows @ whole @ rows.T
        whole[parts.position, parts.position] = own + poor * params.pose.position_variances[located] * np.eye(3)
    gathered = readings.gathered.ravel()
    mean[parts.gathered] = np.where(np.isnan(gathered), 0.0, gathered)
    covariance = symmetrized(whole[np.ix_(params.free, params.free)])
    rate = mean[parts.rate]
    still = np.zeros((1, 3, 3))
    return PoseBank(mean[None], covariance[None], rotation[None], np.array([-1]), rate[None].copy(), still)


def can_initialize(readings: PoseReadings, params: PoseParams) -> bool:
    """Tests whether readings suffice to initialize position and attitude, as far as sensors measure these."""
    turned = np.isfinite(readings.rotations).all(axis=(1, 2)).any()
    placed = np.isfinite(readings.positions[:, :2]).all(axis=1).any()
    needs_turn = np.isfinite(params.pose.attitude_variances).any()
    needs_place = np.isfinite(params.pose.position_variances).any()
    return bool((turned or not needs_turn) and (placed or not needs_place))


def first_pose_sensor(readings: PoseReadings) -> int | None:
    """Returns the index of the first pose sensor whose position was read; None: none was."""
    return next((place for place, read in enumerate(readings.positions) if np.isfinite(read).any()), None)


def tracked_point(sensor: int, parts: Parts) -> slice:
    """Returns the slice of the state that holds the point tracked by a pose sensor."""
    return slice(parts.point.start + 3 * sensor, parts.point.start + 3 * sensor + 3)
