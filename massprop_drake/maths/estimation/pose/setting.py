"""Data of a vehicle that is followed in a fixed frame, as its file states them, and the parameters made of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filter import Setup
from massprop_drake.maths.estimation.pose.delays import divide_delays
from massprop_drake.maths.estimation.pose.outcome import mass_regression
from massprop_drake.maths.estimation.pose.pose_layout import Parts, PoseParams, Poses, make_parts
from massprop_drake.maths.estimation.pose.pose_start import VehiclePrior, prior
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, MASS_RECIPROCAL, symmetric_matrix

_LAGS = 12.0  # time constants after which a lag is over
_SIGMAS = 5.0  # by which a delay may be off
_TURN = 0.3  # rad by which the vehicle may turn in a sample as far as is known at the start
_FASTEST = 1.0  # rad/s, likewise
_NEVER_S = 1e-6  # least that commands are kept for


class Valves(NamedTuple):
    """Timing of valves after their commands, with 1-sigma, by kind of jet; shape (n_kinds,) each.

    Attributes:
        delays_s, delay_stds_s: after a command.
        lags_s, lag_stds: time constants, and their relative 1-sigma.
        openings_s, opening_stds_s: by how much later they open than they close.
        pulse_scatters: relative 1-sigma of a pulse as a whole.
    """

    delays_s: Array
    delay_stds_s: Array
    lags_s: Array
    lag_stds: Array
    openings_s: Array
    opening_stds_s: Array
    pulse_scatters: Array


class Around(NamedTuple):
    """Disturbances of the vehicle besides its jets: mean or 1-sigma, in the vehicle's units.

    Attributes:
        drag, drag_std, angular_drag, angular_drag_std: force over speed, and torque over rate.
        slope_std, slope_walk, turn_std, turn_walk, heading_turn_std: accelerations.
        velocity_walk, rate_walk: white ones.
        kicks_per_minute, kick_velocity, kick_rate: sporadic ones.
    """

    drag: float
    drag_std: float
    angular_drag: float
    angular_drag_std: float
    slope_std: float
    slope_walk: float
    turn_std: float
    turn_walk: float
    heading_turn_std: float
    velocity_walk: float
    rate_walk: float
    kicks_per_minute: float
    kick_velocity: float
    kick_rate: float


class Tracking(NamedTuple):
    """Data of a vehicle that is followed in a fixed frame.

    Attributes:
        positions: of the jets, vehicle frame, ft or m, shape (n_jets, 3).
        forces: of the jets at full thrust, body axes, lbf or N, shape (n_jets, 3).
        valves: see `Valves`.
        around: see `Around`.
        mass_std: relative.
        common_std, common_walk: relative, of what all thrusts share, and of its change in one second.
        planar: whether x, y and heading alone are free.
        fixed: which of the ten parameters are known, shape (10,).
        position_stds, attitude_stds: of the pose sensors, infinity: not measured, shape (n_poses,).
        time_stds_s: of their stamps, shape (n_poses,).
        outliers: share of samples that are poor, of all of them.
        points: that they track, and their 1-sigma, vehicle frame, shapes (n_poses, 3) and (n_poses,).
        point_stds: see there.
        velocity_positions, velocity_stds: of the velocity sensors, shapes (n, 3) and (n,).
    """

    positions: Array
    forces: Array
    valves: Valves
    around: Around
    mass_std: float
    common_std: float
    common_walk: float
    planar: bool
    fixed: np.ndarray
    position_stds: Array
    attitude_stds: Array
    time_stds_s: Array
    outliers: float
    points: Array
    point_stds: Array
    velocity_positions: Array
    velocity_stds: Array


def make_params(setup: Setup, tracking: Tracking, *, hypotheses: bool) -> PoseParams:
    """Makes the parameters of the pose estimator from a vehicle's setup and its tracking.

    Args:
        hypotheses: whether a jet may stand open.
    """
    thrust, valves = setup.thrust, tracking.valves
    mass = 1.0 / float(setup.nominal[MASS_RECIPROCAL])
    jets = thrust.flows.size, valves.delays_s.size
    parts = make_parts(*jets, tracking.position_stds.size, setup.gyros.quanta.size, setup.accelerometers.quanta.size)
    observable_std, unobservable_std = _mass_stds(setup, tracking)
    vehicle_prior = _make_prior(setup, tracking, parts, observable_std)
    supposed = _select_supposed(vehicle_prior, parts, hypotheses=hypotheses)
    vehicle_prior.rest_std[supposed] = 1.0  # a place for each; zero but for the hypothesis that supposes it
    start, covariance, free = prior(vehicle_prior, _select_fixed(parts, tracking, setup), parts)
    places = np.flatnonzero(np.isin(free, supposed))
    covariance[places], covariance[:, places] = 0.0, 0.0
    around = tracking.around
    delays = divide_delays(valves.delays_s, valves.delay_stds_s, setup.period_s)
    lagging = _LAGS * np.max(valves.lags_s * np.exp(_SIGMAS * valves.lag_stds), initial=0.0)
    unsure = _SIGMAS * (valves.delay_stds_s + valves.opening_stds_s)
    late = np.max(np.abs(valves.delays_s) + np.abs(valves.openings_s) + unsure, initial=_NEVER_S)
    made = PoseParams(
        parts=parts,
        free=free,
        start=start,
        covariance=covariance,
        pushes=tracking.forces / mass,
        positions=tracking.positions,
        kinds=thrust.kinds,
        nominal_mass=mass,
        mass_std=observable_std,
        unseen_std=unobservable_std,
        thrust_std=thrust.uncertainty,
        longest_s=float(np.max(delays.shifts_s) + lagging + late),
        rate_noise=around.rate_walk,
        velocity_noise=around.velocity_walk,
        push_walk=around.slope_walk,
        turn_walk=around.turn_walk,
        common_walk=tracking.common_walk,
        scatter=thrust.repeatability,
        pulse_scatter=valves.pulse_scatters[thrust.kinds],
        kicks_per_s=around.kicks_per_minute / 60.0,
        kick_velocity=around.kick_velocity,
        kick_rate=around.kick_rate,
        pose=Poses(tracking.position_stds**2, tracking.attitude_stds**2, tracking.time_stds_s**2, tracking.outliers),
        gyro_variances=setup.gyro_variances,
        velocity_positions=tracking.velocity_positions,
        velocity_variances=tracking.velocity_stds**2,
        accelerometer_positions=setup.accelerometer_positions,
        accelerometer_variances=setup.accelerometer_variances,
        planar=tracking.planar,
        of_mass=np.zeros(parts.size),
        delays=delays,
    )
    return made._replace(of_mass=mass_regression(np.ones(thrust.flows.size, dtype=bool), made)[0])


def _select_supposed(vehicle_prior: VehiclePrior, parts: Parts, *, hypotheses: bool) -> np.ndarray:
    """Returns indices of elements fixed unless a hypothesis frees them: delays, a jet's open share, a push."""
    indices = np.arange(parts.delay.start, parts.delay.stop)
    if hypotheses:
        indices = np.append(indices, np.arange(parts.push.start, parts.push.stop))
    exact = indices[vehicle_prior.rest_std[indices] == 0.0]
    return np.append(exact, parts.open.start) if hypotheses else exact


def _make_prior(setup: Setup, tracking: Tracking, parts: Parts, mass_std: float) -> VehiclePrior:
    """Makes means and 1-sigmas of the state before the first sample from the vehicle's data."""
    valves, around, mass = tracking.valves, tracking.around, 1.0 / float(setup.nominal[MASS_RECIPROCAL])
    rest, deviation = np.zeros(parts.size), np.zeros(parts.size)
    inertia = np.linalg.inv(symmetric_matrix(setup.nominal[:6]))
    turning = inertia[2, 2] if tracking.planar else np.trace(inertia) / 3.0
    rest[parts.center] = setup.estimate[CENTER_OF_MASS]
    deviation[parts.center] = np.sqrt(np.diag(setup.covariance)[CENTER_OF_MASS])
    rest[parts.delay], deviation[parts.delay] = valves.delays_s, valves.delay_stds_s
    lagging = valves.lags_s > 0.0
    rest[parts.lag] = np.log(np.where(lagging, valves.lags_s, 1e-9))
    deviation[parts.lag] = np.where(lagging, valves.lag_stds, 0.0)
    rest[parts.opening], deviation[parts.opening] = valves.openings_s, valves.opening_stds_s
    deviation[parts.pulse] = valves.pulse_scatters[setup.thrust.kinds]
    rest[parts.drag] = around.drag / mass, around.angular_drag / turning
    deviation[parts.drag] = around.drag_std / mass, around.angular_drag_std / turning
    deviation[parts.push] = np.repeat((around.slope_std, around.turn_std), 3)
    deviation[parts.tilt] = around.heading_turn_std
    arm = max(setup.thrust.arm, np.finfo(float).tiny)
    deviation[parts.position], deviation[parts.velocity] = arm, arm / setup.period_s
    deviation[parts.attitude], deviation[parts.rate] = np.pi, min(_TURN / setup.period_s, _FASTEST)
    rest[parts.point] = tracking.points.ravel()
    deviation[parts.point] = np.repeat(tracking.point_stds, 3)
    for part, packages in ((parts.gyro_bias, setup.gyros), (parts.acceleration_bias, setup.accelerometers)):
        deviation[part] = np.repeat(packages.bias_std, 3)
    deviation[parts.gathered] = np.repeat(np.sqrt(setup.accelerometer_variances), 3)
    covariance, known = setup.covariance[:6, :6] * mass**2, tracking.fixed[:6]
    covariance[known], covariance[:, known] = 0.0, 0.0
    spin, each = setup.nominal[:6] * mass, setup.thrust.uncertainty
    return VehiclePrior(spin, covariance, mass_std, tracking.common_std, each, rest, deviation)


def _mass_stds(setup: Setup, tracking: Tracking) -> tuple[float, float]:
    """Computes the 1-sigma of m_0/m that readings can reduce, and the one that they cannot; one is zero."""
    whole = 0.0 if tracking.fixed[MASS_RECIPROCAL] else tracking.mass_std
    moves = np.isfinite(tracking.position_stds).any() or tracking.velocity_stds.size
    return (whole, 0.0) if moves or setup.accelerometer_variances.size else (0.0, whole)


def _select_fixed(parts: Parts, tracking: Tracking, setup: Setup) -> np.ndarray:
    """Flags the elements of the state that cannot move or are known exactly, shape (size,)."""
    fixed = np.zeros(parts.size, dtype=bool)
    fixed[parts.center] |= tracking.fixed[CENTER_OF_MASS]
    if not np.isfinite(tracking.position_stds).any():
        fixed[parts.position] = True
        fixed[parts.point] = True
        if not tracking.velocity_stds.size and not setup.accelerometer_variances.size:
            fixed[parts.velocity] = True
    if not np.isfinite(tracking.attitude_stds).any():
        fixed[parts.attitude] = True
    if tracking.planar:
        fixed[parts.spin] |= np.arange(6) != 2
        fixed[parts.push.start + 2 : parts.push.start + 5] = True
        moving = parts.center, parts.position, parts.velocity, parts.point
        for part in (*moving, parts.gathered, parts.acceleration_bias):
            fixed[part.start + 2 : part.stop : 3] = True
        for part in (parts.attitude, parts.rate, parts.gyro_bias):
            fixed[part.start : part.stop : 3] = True
            fixed[part.start + 1 : part.stop : 3] = True
    return fixed


def movable_indices(setup: Setup, parts: Parts) -> np.ndarray:
    """Returns sorted indices of state elements that follow the motion or may differ from the vehicle's file."""
    assert setup.tracking is not None, "made for a vehicle that is followed in a fixed frame"
    fixed, valves = _select_fixed(parts, setup.tracking, setup), setup.tracking.valves
    fixed[parts.open] = True
    fixed[parts.lag] |= valves.lags_s == 0.0
    fixed[parts.pulse] |= valves.pulse_scatters[setup.thrust.kinds] == 0.0
    fixed[parts.spin] |= setup.tracking.fixed[:6]
    return np.flatnonzero(~fixed)


def known_parameters(tracking: Tracking) -> np.ndarray:
    """Flags mass-property parameters without a sigma: fixed ones, and in a plane those without effect, (10,)."""
    known = np.asarray(tracking.fixed, dtype=bool).copy()
    if tracking.planar:
        known[[0, 1, 3, 4, 5, 8]] = True
    return known
