"""A package of three rate gyros."""

from __future__ import annotations

from typing import Any

from massprop_drake.maths.vehicle.sensing import SensorModel
from massprop_drake.systems.scalars import float_class, template
from massprop_drake.systems.vehicle.sensor import Sensor_, StatedPackage


@template
def RateGyro_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of three-axis rate gyros for a scalar type T, see `RateGyro`."""

    class RateTriad(Sensor_[T]):  # type: ignore[misc, valid-type]
        """Measures the angular rate, rad/s, body axes; ports, parameters, state, timing and scalars as `Sensor`.

        Assumptions and limitations: the package's axes are the body's; its position does not matter.
        """

        def _construct(
            self,
            package: str | StatedPackage,
            model: SensorModel | None = None,
            *,
            converter: Any = None,
            **options: Any,
        ) -> None:
            """Declares ports, parameters and state; arguments as `Sensor`."""
            Sensor_[T].__init__(self, package, model, converter=converter, **options)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the gyro from one of another scalar type."""
            Sensor_[T].__init__(self, other, converter=converter)

    return RateTriad


RateGyro: Any = float_class(RateGyro_, "RateGyro")
