"""A package of three integrating accelerometers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from massprop_drake.maths.vehicle.rigid_body import ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import SensorModel, point_velocity
from massprop_drake.systems.arguments import vector
from massprop_drake.systems.vehicle.sensor import Sensor, StatedPackage

Array = NDArray[np.float64]


class IntegratingAccelerometer(Sensor):
    """Measures the time integral, in body axes, of the specific force where it stands.

    Ports, state and timing as `Sensor`; the reading is in ft/s or m/s. A rigid body's motion about its
    center of mass is part of it (3-17); gravity is not.

    Assumptions and limitations: its axes are the body's. A bandwidth limits the integral, a bias is one
    of the acceleration.

    Args:
        package: its name, or a package of a vehicle, such as `vehicle.accelerometer("acc1")`; see `Sensor`.
        model: its errors; default those that the package states.
        position: in the vehicle frame, ft or m, shape (3,); default that of the package.

    Raises:
        ValueError: when it is no vector, or there is none.
    """

    def __init__(
        self, package: str | StatedPackage, model: SensorModel | None = None, *, position: ArrayLike | None = None
    ):
        super().__init__(package, model)
        place = getattr(package, "position", None) if position is None else position
        if place is None:
            raise ValueError(f"accelerometer '{self.get_name()}': where does it stand? Give its position")
        self._position = vector(f"accelerometer '{self.get_name()}': position", place, 3)

    def _signal(self, body_state: Array) -> Array:
        return point_velocity(body_state[ORIGIN_VELOCITY], body_state[RATE], body_state[SPIN_INTEGRAL], self._position)
