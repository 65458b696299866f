"""Sensor of the attitude against the stars."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.maths import attitude
from massprop_drake.maths.kernels import value_of
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import QUATERNION
from massprop_drake.systems.scalars import float_class, template
from massprop_drake.systems.vehicle.trackers import Tracker_


@template
def StarTracker_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of star trackers for a scalar type T, see `StarTracker`."""

    class StarsSeen(Tracker_[T]):  # type: ignore[misc, valid-type]
        """Measures the attitude: a unit quaternion, scalar first, from vehicle to inertial axes; ports as `Tracker`.

        The error is a small turn about the vehicle's axes, new at each sample.

        Scalars: float, AutoDiffXd and Expression; the noise must be numbers.

        Args:
            name: of the sensor.
            noise_std: 1-sigma about each axis, rad; a number, or three, as a boresight is poorer.

        Raises:
            ValueError: when noise_std is negative or not finite, or neither one number nor three.
        """

        def _construct(
            self,
            name: str = "star_tracker",
            *,
            noise_std: float | tuple[float, float, float] | Array,
            converter: Any = None,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            Tracker_[T].__init__(self, name, 4, 3, converter=converter)
            std = np.asarray(noise_std, dtype=float)
            if std.shape not in ((), (3,)) or not (np.isfinite(std) & (std >= 0.0)).all():
                raise ValueError(
                    f"star tracker '{name}': noise_std must be a number or three, zero or more; got {noise_std}"
                )
            self._std = np.broadcast_to(std, 3)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the tracker from one of another scalar type."""
            StarsSeen._construct(self, other.get_name(), noise_std=other._std, converter=converter)

        def _read(self, body: Any, center: Any, noise: Any) -> Any:
            """Computes the attitude quaternion, turned by the noise about the axes, shape (4,)."""
            turn = self._std * np.array([value_of(number) for number in noise])
            return attitude.multiply(body[QUATERNION], attitude.from_rotation_vector(turn))

    return StarsSeen


StarTracker: Any = float_class(StarTracker_, "StarTracker")
