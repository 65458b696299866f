"""State of the joint estimator before the first sample, at it, and after a gap."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
    n_assumed,
)
from massprop_drake.maths.estimation.joint.measurement import POOR, readings
from massprop_drake.maths.estimation.joint.modes import mode_sigmas
from massprop_drake.maths.estimation.joint.wheels import initial_speed_sigmas
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.vehicle.disturbance import decay_factor

_UNREAD = 1e6  # sigmas of a reading that what was not read at the start may be off


def initial_joint_state(params: JointParams) -> JointState:
    """Returns the filter's state before the first sample: nominal mean, and root of the prior covariance."""
    places = params.places
    mean, root = np.zeros(places.size), np.zeros((places.size, places.size))
    mean[:N_PROPERTIES] = params.start
    root[:N_PROPERTIES, :N_PROPERTIES] = params.start_root
    for element in range(places.slow, places.slow + places.n_slow):
        root[element, element] = 0.0 if 0 <= element - places.unstated < places.n_unstated else 1.0
    swing = slice(places.swing, places.swing + places.n_swing)
    root[swing, swing] = np.diag(mode_sigmas(params.modes.start, params.modes))
    for element in range(places.thrust, places.size):
        root[element, element] = params.prior_sigma[element - places.thrust]
    for tank in range(places.tanks):
        element = places.fill + tank
        mean[element], root[element, element] = params.tanks.fill[tank], params.tanks.fill_sigma[tank]
    jets = places.jets
    return JointState(
        mean=mean,
        root=compress_root(root, places.thrust),
        level=np.zeros(jets),
        slope=np.zeros(jets),
        tick_slope=np.zeros((2, jets)),
        level_std=np.zeros(jets),
        spin=np.zeros(6),
        reference=np.zeros(3),
        read=np.full(places.outputs, np.nan),
        fresh=np.zeros(places.outputs),
        slot_jet=np.full(places.n_force, -1.0),
        slot_sign=np.ones(places.n_force),
        slot_on_top=np.zeros(places.n_force),
        time_s=0.0,
        started=False,
        guarded=False,
        firing_count=0.0,
        lag_open=np.zeros(places.n_lag),
        assumed=np.full(n_assumed(places), np.nan),
        stir=0.0,
        stir_s=1.0,
    )


def begin_from_readings(state: JointState, sample: JointSample, params: JointParams) -> JointState:
    """Resets rate, velocity and attitude of the filter's state to the readings of a first sample or after a gap.

    They are uncorrelated with the rest, but that with a gyro bias the rate's error is that of the reading less the
    bias, and that the rate from which the turning of accelerometers is counted has the error of that rate: what they
    read then says nothing of it. What is not read starts at zero and as good as unknown. Of a disturbance is known what
    is left of it.
    """
    places = params.places
    mean = state.mean.copy()
    first, last = RATE.start, places.slow
    root = np.zeros((places.size, places.size + last - first))
    root[:first, : places.size], root[last:, : places.size] = state.root[:first], state.root[last:]
    reading_column = places.size - first  # a column for the reading of each of these rows
    for axis in range(3):
        row = RATE.start + axis
        weights = np.zeros(places.gyros)
        for package in range(places.gyros):
            if not np.isnan(sample.rates[package, axis]):
                weights[package] = 1.0 / params.variances[3 * package + axis]
        total = float(weights.sum())
        if total == 0.0:
            root[row, reading_column + row] = _UNREAD * np.sqrt(params.variances[axis])
            continue
        root[row, reading_column + row] = np.sqrt(1.0 / total)
        mean[row] = 0.0
        for package in range(places.gyros):
            if weights[package] > 0.0:
                relative_weight = weights[package] / total
                mean[row] += relative_weight * sample.rates[package, axis]
                if places.n_gyro_bias > 0:
                    bias, shift = places.gyro_bias + 3 * package + axis, relative_weight * params.gyro_bias_sigma
                    mean[row] -= shift * mean[bias]
                    root[row] -= shift * root[bias]
    for package in range(places.accelerometers):
        for axis in range(3):
            row, value = VELOCITY + 3 * package + axis, sample.velocities[package, axis]
            deviation = np.sqrt(params.variances[3 * (places.gyros + package) + axis])
            missing = np.isnan(value)
            mean[row] = 0.0 if missing else value
            root[row, reading_column + row] = _UNREAD * deviation if missing else deviation
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        arm = params.accelerometer_positions[package] - mean[CENTER]
        root[part] += skew(arm) @ root[RATE]
    for axis in range(places.n_attitude):
        row = places.attitude + axis
        own_variances = params.trackers.variances * np.where(params.trackers.outliers > 0.0, POOR**2, 1.0)
        present = ~np.isnan(sample.attitudes[:, axis])
        mean[row], root[row, reading_column + row] = 0.0, _UNREAD * np.sqrt(own_variances[0])
        if present.any():
            weights = 1.0 / own_variances[present]
            mean[row] = weights @ sample.attitudes[present, axis] / weights.sum()
            root[row, reading_column + row] = np.sqrt(1.0 / weights.sum())
    if places.n_slow > 0:
        decay, spread = _slow_state_decay(state, sample, params)
        noise_columns = np.zeros((places.size, places.n_slow))
        slow = slice(places.slow, places.slow + places.n_slow)
        noise_columns[slow] = np.diag(spread * np.sqrt(1.0 - decay**2))
        mean[slow] *= decay
        root[slow] *= decay.reshape(-1, 1)
        root = np.hstack((root, noise_columns))
    mean, root = _reset_modes(state, mean, root, params)
    reading = readings(sample.rates, sample.velocities, sample.attitudes)
    return state._replace(
        mean=mean,
        root=compress_root(root, places.thrust),
        spin=np.zeros(6),
        reference=mean[RATE].copy(),
        read=reading,
        fresh=np.zeros(reading.shape[0]),
        time_s=sample.time_s,
        started=True,
    )


def _reset_modes(state: JointState, mean: Array, root: Array, params: JointParams) -> tuple[Array, Array]:
    """Returns mean and root, moving parts' modes reset to rest with 1-sigmas of a shaken vehicle if started before."""
    places = params.places
    if places.n_swing == 0 or not state.started:
        return mean, root
    swing = slice(places.swing, places.swing + places.n_swing)
    shaken = np.zeros((places.size, places.n_swing))
    shaken[swing] = np.diag(mode_sigmas(params.modes.shaken, params.modes))
    mean[swing], root[swing] = 0.0, 0.0
    return mean, np.hstack((root, shaken))


def _slow_state_decay(state: JointState, sample: JointSample, params: JointParams) -> tuple[Array, Array]:
    """Computes decay factor over a gap, and stationary 1-sigma, of disturbance, wheel and tank states, (n_slow,)."""
    places = params.places
    first_tank = places.n_slow - places.tanks
    first_wheel, unstated = first_tank - places.wheels, places.unstated - places.slow
    decay, spread, elapsed_s = np.zeros(places.n_slow), np.ones(places.n_slow), max(sample.time_s - state.time_s, 0.0)
    decay[:unstated] = decay_factor(params.disturbance.time_constant_s, elapsed_s)
    decay[unstated:first_wheel], spread[unstated:first_wheel] = decay_factor(state.stir_s, elapsed_s), state.stir
    spread[first_wheel:first_tank] = initial_speed_sigmas(sample.speeds.kept, params.wheels)
    decay[first_tank:] = 1.0
    return decay, spread
