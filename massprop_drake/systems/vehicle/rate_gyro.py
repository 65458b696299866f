"""A package of three rate gyros."""

from __future__ import annotations

from massprop_drake.maths.vehicle.sensing import SensorModel
from massprop_drake.systems.vehicle.sensor import Sensor, StatedPackage


class RateGyro(Sensor):
    """Measures the angular rate, rad/s, body axes; ports, state and timing as `Sensor`.

    Assumptions and limitations: the package's axes are the body's; its position does not matter.
    """

    def __init__(self, package: str | StatedPackage, model: SensorModel | None = None, *, compiled: bool = False):
        super().__init__(package, model, compiled=compiled)
