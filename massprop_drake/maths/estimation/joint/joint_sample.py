"""Sample of the joint estimator: the readings at the end of an interval, and what acted over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.burns import UNLIT, Burn
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.orientation import STILL
from massprop_drake.maths.estimation.joint.ticks import Timing
from massprop_drake.maths.estimation.joint.wheels import UNSPUN, Spun, is_any_wheel_driven
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

UNTRACKED = np.zeros((0, 3))  # readings of no tracker


class JointSample(NamedTuple):
    """Sample as a cycle takes it.

    Attributes:
        time_s: of the readings.
        durations_s: of the pieces of the interval that ends then, each with a constant command, shape (n_pieces,).
        commands: fraction commanded in each piece, NaN where not known, shape (n_pieces, n_jets).
        outside: impulse of known outside forces over the interval, angular about the vehicle origin and linear,
            shape (6,).
        rates: readings of the gyro packages, NaN where missing, rad/s, shape (n_gyros, 3).
        velocities: readings of the accelerometer packages, NaN where missing, ft/s or m/s, shape
            (n_accelerometers, 3).
        timing: see `ticks.Timing`.
        attitudes: readings of the trackers relative to the shared attitude, NaN where missing, see `orientation`, rad,
            shape (n_trackers, 3).
        frames: shared attitude before and after the interval, quaternions, shape (2, 4).
        speeds: see `wheels.Spun`.
        burn: see `burns.Burn`.
    """

    time_s: float
    durations_s: Array
    commands: Array
    outside: Array
    rates: Array
    velocities: Array
    timing: Timing
    attitudes: Array = UNTRACKED
    frames: Array = STILL
    speeds: Spun = UNSPUN
    burn: Burn = UNLIT


@kernel
def has_outside_impulse(sample: JointSample, params: JointParams) -> bool:
    """Tests whether known outside forces, engines or wheels act on the vehicle in a sample's interval."""
    known = bool(np.any(sample.outside != 0.0)) or bool(np.any(sample.burn.points[:, :, 0] != 0.0))
    return known or is_any_wheel_driven(sample.speeds, params.wheels)


def has_impulse(sample: JointSample, params: JointParams) -> bool:
    """Tests whether jets, engines, wheels or known outside forces act in a sample's interval."""
    return bool((sample.commands > 0.0).any() or has_outside_impulse(sample, params))
