"""A package of three integrating accelerometers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.vehicle.rigid_body import ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import SensorModel, point_velocity
from massprop_drake.systems.vehicle.sensor import Sensor

Array = NDArray[np.float64]


class IntegratingAccelerometer(Sensor):
    """Measures the time integral, in body axes, of the specific force where it stands.

    Ports, state and timing as `Sensor`; the reading is in ft/s or m/s. A rigid body's motion about its
    center of mass is part of it (3-17); gravity is not.

    Assumptions and limitations: its axes are the body's. A bandwidth limits the integral, a bias is one
    of the acceleration.

    Args:
        name: of the system, the package's name.
        model: its errors.
        position: in the vehicle frame, ft or m, shape (3,).
    """

    def __init__(self, name: str, model: SensorModel, *, position: Array):
        super().__init__(name, model)
        self._position = np.array(position, dtype=float)

    def _signal(self, body_state: Array) -> Array:
        return point_velocity(body_state[ORIGIN_VELOCITY], body_state[RATE], body_state[SPIN_INTEGRAL], self._position)
