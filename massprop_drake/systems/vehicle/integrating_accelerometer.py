"""A package of three integrating accelerometers."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from massprop_drake.maths.vehicle.sensing import SensorModel
from massprop_drake.systems.arguments import require_vector
from massprop_drake.systems.scalars import float_class, template
from massprop_drake.systems.vehicle.sensor import Sensor_, StatedPackage


@template
def IntegratingAccelerometer_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of three-axis accelerometer packages for a scalar type T, see `IntegratingAccelerometer`."""

    class VelocityTriad(Sensor_[T]):  # type: ignore[misc, valid-type]
        """Measures the time integral, in body axes, of the specific force where it stands.

        Ports, parameters, state, timing and scalars as `Sensor`; the reading is in ft/s or m/s. A rigid body's motion
        about its center of mass is part of it (3-17); gravity is not.

        Assumptions and limitations: its axes are the body's. A bandwidth limits the integral, a bias is one
        of the acceleration.

        Args:
            package: its name, or a package of a vehicle, such as `vehicle.accelerometer("acc1")`; see `Sensor`.
            model: its errors; default those that the package states.
            position: in the vehicle frame, ft or m, shape (3,); default that of the package.
            options: `draws`, `seed` and `compiled` as `Sensor` has them.

        Raises:
            ValueError: when the position is no vector, or there is none.
        """

        def _construct(
            self,
            package: str | StatedPackage,
            model: SensorModel | None = None,
            *,
            position: ArrayLike | None = None,
            converter: Any = None,
            **options: Any,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class, the position by default the package's."""
            name = package if isinstance(package, str) else package.name
            stated_position = getattr(package, "position", None) if position is None else position
            if stated_position is None:
                raise ValueError(f"accelerometer '{name}': where does it stand? Give its position")
            vector = require_vector(f"accelerometer '{name}': position", stated_position, 3)
            Sensor_[T].__init__(self, package, model, vector, converter=converter, **options)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the package from one of another scalar type."""
            Sensor_[T].__init__(self, other, converter=converter)

    return VelocityTriad


IntegratingAccelerometer: Any = float_class(IntegratingAccelerometer_, "IntegratingAccelerometer")
