"""A sensor of the attitude against the stars."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths import attitude
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import QUATERNION
from massprop_drake.systems.vehicle.trackers import Tracker


class StarTracker(Tracker):
    """Measures the attitude: a unit quaternion, scalar first, from vehicle to inertial axes; ports as `Tracker`.

    The error is a small turn about the vehicle's axes, new at each sample.

    Args:
        name: of the sensor.
        noise_std: 1-sigma about each axis, rad; a number, or three, as a boresight is poorer.

    Raises:
        ValueError: when noise_std is negative, or neither one number nor three.
    """

    def __init__(self, name: str = "star_tracker", *, noise_std: float | tuple[float, float, float] | Array):
        super().__init__(name, 4, 3)
        std = np.asarray(noise_std, dtype=float)
        if std.shape not in ((), (3,)) or not (std >= 0.0).all():
            raise ValueError(
                f"star tracker '{name}': noise_std must be a number or three, zero or more; got {noise_std}"
            )
        self._std = np.broadcast_to(std, 3)

    def _read(self, body: Array, center: Array, noise: Array) -> Array:
        return attitude.multiply(body[QUATERNION], attitude.from_rotation_vector(self._std * noise))
