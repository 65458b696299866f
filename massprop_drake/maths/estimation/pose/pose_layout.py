r"""Layout of state and parameters of the estimator in a fixed frame.

The state, of which only what is free has a place,

    g_j | c | K (6: xx, yy, zz, yz, xz, xy) | r (3) | delay, ln lag and opening per kind | k_v, k_w | s (6) | t (2)
    | p (3) | phi (3) | v (3) | w (3) | p_s (3 per tracked point) | gyro bias (3 per package)
    | gathered velocity (3 per accelerometer) | acceleration bias (3 per package) | h
    | e (per jet)

with g_j = (F_j/F_j0)(m_0/m), what jet j accelerates over what it nominally would; c the part of it that all jets
share, as a supply's pressure; K = m I^-1; r the center of mass; k_v and k_w drag over mass and over inertia; s what
else accelerates, in the fixed frame, and turns, in body axes; t torque that goes as cosine and sine of the heading,
over inertia; p the center of mass in the fixed frame, phi the error of the attitude in body axes, v the velocity in
the fixed frame, w the rate in body axes; p_s the points that are tracked, vehicle frame; h how far one jet, which a
hypothesis names, stands open; e by how much the present pulse of each jet is stronger than its pulses are.

The mass is no element. With mu = m_0/m and independent b_j of each jet, g_j = mu (1 + b_j) + c is linear, so that no
linearization can make the common scale of all thrusts look observed: mu follows by conditioning (`outcome`).

Everything has a bank's filters first: shapes are (n_filters, ...).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array

Places = np.ndarray  # of integers
PUSHED = -2  # see `PoseBank.opens`


class Parts(NamedTuple):
    """Places of the parts in the whole state, free or not.

    Attributes:
        thrust, common, spin, center, delay, lag, opening, drag, push, tilt, position, attitude, velocity, rate, point,
            gyro_bias, gathered, acceleration_bias, open, pulse: see the module.
        size: of all.
    """

    thrust: slice
    common: slice
    spin: slice
    center: slice
    delay: slice
    lag: slice
    opening: slice
    drag: slice
    push: slice
    tilt: slice
    position: slice
    attitude: slice
    velocity: slice
    rate: slice
    point: slice
    gyro_bias: slice
    gathered: slice
    acceleration_bias: slice
    open: slice
    pulse: slice
    size: int


def make_parts(n_jets: int, n_kinds: int, n_points: int, n_gyros: int, n_accelerometers: int) -> Parts:
    """Computes the slice of each part of the filter's state from the numbers of jets, kinds and sensors.

    Args:
        n_jets, n_kinds: how many there are.
        n_points, n_gyros, n_accelerometers: number of packages.
    """
    sensors = [3 * n_points, 3 * n_gyros, 3 * n_accelerometers, 3 * n_accelerometers]
    sizes = [n_jets, 1, 6, 3, n_kinds, n_kinds, n_kinds, 2, 6, 2, 3, 3, 3, 3, *sensors, 1, n_jets]
    ends = np.cumsum(sizes).tolist()
    slices = {name: slice(end - size, end) for name, end, size in zip(Parts._fields, ends, sizes, strict=False)}
    return Parts(**slices, size=ends[-1])


class PoseParams(NamedTuple):
    """Parameters of the estimator.

    Attributes:
        parts: see `Parts`.
        free: places of what is estimated, in order, shape (n,).
        start: of the whole state, shape (size,).
        covariance: of what is free at the start, shape (n, n).
        pushes: acceleration of the nominal vehicle by each jet, body axes, ft/s^2 or m/s^2, shape (n_jets, 3).
        positions: of the jets, vehicle frame, ft or m, shape (n_jets, 3).
        kinds: index of each jet's kind, shape (n_jets,).
        nominal_mass: slug or kg.
        mass_std: relative 1-sigma of the mass, as far as readings may show it.
        unseen_std: the same where nothing that moves with a force is read, as by a star tracker alone: then it plays
            no part in the state, with g_j = 1 + b_j + c and K = m_0 I^-1, since of mass and thrust the turns show
            the product with K alone.
        thrust_std: relative 1-sigma of each jet's thrust by itself, shape (n_jets,).
        longest_s: how long after a command all that it did is over, s.
        rate_noise, velocity_noise: of white accelerations, rad/s^1.5 and m/s^1.5.
        push_walk, turn_walk: of s, m/s^2.5 and rad/s^2.5.
        common_walk: of c, 1/s^.5.
        scatter: relative 1-sigma of what each jet gives over a sample, white, shape (n_jets,).
        pulse_scatter: relative 1-sigma of a pulse as a whole, shape (n_jets,).
        kicks_per_s: how often something pushes the vehicle that the model does not have.
        kick_velocity, kick_rate: 1-sigma of it, m/s and rad/s.
        pose: see `Poses`.
        gyro_variances: of one reading, shape (n_gyros,).
        velocity_positions, velocity_variances: vehicle frame, and of one reading, shapes (n_velocities, 3) and
            (n_velocities,).
        accelerometer_positions, accelerometer_variances: shapes (n_accelerometers, 3) and (n_accelerometers,).
        planar: whether x, y and heading alone are free.
        of_mass: how m_0/m goes with the state while no jet has failed, see `outcome`, shape (size,).
        delays: see `Delays`.
    """

    parts: Parts
    free: Places
    start: Array
    covariance: Array
    pushes: Array
    positions: Array
    kinds: np.ndarray
    nominal_mass: float
    mass_std: float
    unseen_std: float
    thrust_std: Array
    longest_s: float
    rate_noise: float
    velocity_noise: float
    push_walk: float
    turn_walk: float
    common_walk: float
    scatter: Array
    pulse_scatter: Array
    kicks_per_s: float
    kick_velocity: float
    kick_rate: float
    pose: Poses
    gyro_variances: Array
    velocity_positions: Array
    velocity_variances: Array
    accelerometer_positions: Array
    accelerometer_variances: Array
    planar: bool
    of_mass: Array
    delays: Delays


class Delays(NamedTuple):
    """Parts into which the possible delays of commands are divided, see `delays`.

    Attributes:
        shifts_s: of each, from the stated delay, that of the stated one first, shape (n,).
        chances: logarithm of the probability of each beforehand, shape (n,).
        stds_s: 1-sigma within the stated one and within the others, by kind of jet, shape (2, n_kinds).
        reach_s: what one filter can hold, 1-sigma.
    """

    shifts_s: Array
    chances: Array
    stds_s: Array
    reach_s: float


class Poses(NamedTuple):
    """Sensors of position and attitude.

    Attributes:
        position_variances, attitude_variances: of one reading, m^2 and rad^2; infinity: not measured, shape (n,).
        jitter_variances: of their stamps, s^2, shape (n,).
        outliers: share of samples whose readings are poor.
        outlier_scale: how many times as noisy they are then.
        tells: what is expected of a reading, as a multiple of its variance, beyond which it cannot be told whether it
            is a poor one.
    """

    position_variances: Array
    attitude_variances: Array
    jitter_variances: Array
    outliers: float = 0.0
    outlier_scale: float = 10.0
    tells: float = 100.0


class PoseBank(NamedTuple):
    """Filters side by side, after a sample. Never changed; a cycle makes a new one.

    Attributes:
        mean: of the whole state, zero for phi, shape (n_filters, size).
        covariance: of what is free, shape (n_filters, n, n).
        rotation: body to fixed frame, shape (n_filters, 3, 3).
        opens: jet that h is of, -1: none, `PUSHED`: none, and what else accelerates is a push, which accelerometers
            feel, and no slope, which they do not, shape (n_filters,).
        reference: rate when accelerometers began to gather, shape (n_filters, 3).
        turned: integral of w w^T since, shape (n_filters, 3, 3).
    """

    mean: Array
    covariance: Array
    rotation: Array
    opens: np.ndarray
    reference: Array
    turned: Array

    def select(self, filters: slice) -> PoseBank:
        """Returns a bank of the filters in a slice."""
        return PoseBank(*(part[filters] for part in self))


class Commands(NamedTuple):
    """Commands to the jets, as far back as they still act, and known outside forces.

    Attributes:
        time_s: from when on each row holds, until the next one does; the last one for ever, increasing, shape (k,).
        levels: commanded, NaN where not known, shape (k, n_jets).
        outside: mean torque about the vehicle origin and force over the interval that is followed, body axes, shape
            (6,); None: none.
    """

    time_s: Array
    levels: Array
    outside: Array | None = None


class PoseReadings(NamedTuple):
    """Readings of all sensors at one moment, NaN where they did not read.

    Attributes:
        positions: of tracked points, fixed frame, ft or m, shape (n_poses, 3).
        rotations: body to fixed frame, shape (n_poses, 3, 3).
        velocities: of tracked points, fixed frame, shape (n_velocities, 3).
        rates: shape (n_gyros, 3).
        gathered: integrals of accelerations, body axes, shape (n_accelerometers, 3).
    """

    positions: Array
    rotations: Array
    velocities: Array
    rates: Array
    gathered: Array
