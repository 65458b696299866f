"""A package of three integrating accelerometers."""

from __future__ import annotations

from numpy.typing import ArrayLike

from massprop_drake.maths.vehicle.sensing import SensorModel
from massprop_drake.systems.arguments import vector
from massprop_drake.systems.vehicle.sensor import Sensor, StatedPackage


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
        compiled: whether its kernel is.

    Raises:
        ValueError: when it is no vector, or there is none.
    """

    def __init__(
        self,
        package: str | StatedPackage,
        model: SensorModel | None = None,
        *,
        position: ArrayLike | None = None,
        compiled: bool = False,
    ):
        name = package if isinstance(package, str) else package.name
        place = getattr(package, "position", None) if position is None else position
        if place is None:
            raise ValueError(f"accelerometer '{name}': where does it stand? Give its position")
        made = vector(f"accelerometer '{name}': position", place, 3)
        super().__init__(package, model, made, compiled=compiled)
