"""Sensors that see the vehicle from outside, in the fixed frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem_

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import N_STATE, STRUCTURE
from massprop_drake.maths.vehicle.tracking import N_NOISE, PoseModel, is_due, read_pose, read_velocity
from massprop_drake.systems.arguments import require_vector
from massprop_drake.systems.caching import declare_output
from massprop_drake.systems.scalars import float_class, refuse, template


@template
def Tracker_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the base class of trackers for a scalar type T, see `Tracker`."""

    class Sighting(LeafSystem_[T]):
        """Base class of all trackers.

        Ports:
            body_state (in, 23), structure (in, 9): see `RigidBodyPlant`. Required.
            noise (in, n_noise): independent standard normal numbers, new at each sample. Required.
            reading (out, size): in the fixed frame.

        State: none.

        Timing: the reading at t_k is of the body at t_k, but for the error of the stamp.

        Attributes:
            n_noise: count of the numbers that it takes at each sample.
        """

        def _construct(self, name: str, size: int, n_noise: int, *, converter: Any = None) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name(name)
            self._sizes = name, size, n_noise
            self.n_noise = n_noise
            self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
            self._structure = self.DeclareVectorInputPort("structure", STRUCTURE.size)
            self._noise = self.DeclareVectorInputPort("noise", n_noise, RandomDistribution.kGaussian)
            inputs = (self._body_state, self._structure, self._noise)
            read = {port.ticket() for port in inputs} | self._time_tickets()
            declare_output(self, "reading", size, self._calc_reading, read)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the tracker from one of another scalar type."""
            Sighting._construct(self, *other._sizes, converter=converter)

        def _time_tickets(self) -> set[Any]:
            """Returns the ticket of the time where it decides whether anything is read, else none."""
            return set()

        def _is_due(self, _context: Any) -> bool:
            """Tests whether a reading is due at this sample: always, but for a rate of its own."""
            return True

        def _read(self, body: Any, center: Any, noise: Any) -> Any:
            """Computes the reading from body state, center of mass and noise; subclasses define it."""
            raise NotImplementedError

        def _calc_reading(self, context: Any) -> Any:
            """Computes the tracker's reading from body and structure, NaN where none is due, shape (size,)."""
            if not self._is_due(context):
                _, size, _ = self._sizes
                return np.full(size, np.nan)
            center = STRUCTURE.read(self._structure.Eval(context)).center_of_mass
            return self._read(self._body_state.Eval(context), center, self._noise.Eval(context))

    return Sighting


@template
def PoseTracker_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of pose trackers for a scalar type T, see `PoseTracker`."""

    class PoseSeen(Tracker_[T]):  # type: ignore[misc, valid-type]
        """Measures position and attitude, see `maths.vehicle.tracking`; ports, state and timing as `Tracker`.

        The reading (7) is the tracked point's position, ft or m, and the quaternion from body to fixed frame, scalar
        first; NaN for a part that is not measured, and at samples between two readings at a rate of its own.

        Scalars: float; AutoDiffXd and Expression where time_std_s and outliers are 0.

        Args:
            name: of the sensor.
            model: see `PoseModel`.

        Raises:
            InputError: in a conversion of readings without derivatives.
        """

        def _construct(self, name: str, model: PoseModel, *, converter: Any = None) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            self._model = model
            Tracker_[T].__init__(self, name, 7, N_NOISE, converter=converter)
            require_vector(f"sensor '{name}': point", model.point, 3)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the tracker from one of another scalar type; raises InputError where T has no derivatives."""
            name, model = other.get_name(), other._model
            random = ["has stamps or readings that are wrong by chance"] if model.time_std_s or model.outliers else []
            refuse(T, f"sensor '{name}'", random, "set its time_std_s and outliers to 0, or leave the sensor out")
            PoseSeen._construct(self, name, model, converter=converter)

        def _time_tickets(self) -> set[Any]:
            """Returns the ticket of the time where the tracker has a rate of its own, else none."""
            return {self.time_ticket()} if math.isfinite(self._model.rate_hz) else set()

        def _is_due(self, context: Any) -> bool:
            """Tests whether a pose is due at this sample by the tracker's rate."""
            return math.isinf(self._model.rate_hz) or is_due(context.get_time(), self._model)

        def _read(self, body: Any, center: Any, noise: Any) -> Any:
            """Computes position (3) and quaternion (4) of the tracked point from body state, center and noise."""
            return read_pose(body, center, noise, self._model)

    return PoseSeen


@template
def VelocityTracker_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of velocity trackers for a scalar type T, see `VelocityTracker`."""

    class VelocitySeen(Tracker_[T]):  # type: ignore[misc, valid-type]
        """Measures the velocity of a point, ft/s or m/s, fixed frame; ports, state and timing as `Tracker`.

        Scalars: float, AutoDiffXd and Expression.

        Args:
            name: of the sensor.
            position: of the point, vehicle frame, ft or m, shape (3,).
            noise_std: of each component, 1-sigma.
        """

        def _construct(self, name: str, *, position: Array, noise_std: float, converter: Any = None) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            Tracker_[T].__init__(self, name, 3, 3, converter=converter)
            self._position = require_vector(f"sensor '{name}': position", np.asarray(position, dtype=float), 3)
            self._noise_std = noise_std

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the tracker from one of another scalar type."""
            arguments = {"position": other._position, "noise_std": other._noise_std}
            VelocitySeen._construct(self, other.get_name(), converter=converter, **arguments)

        def _read(self, body: Any, center: Any, noise: Any) -> Any:
            """Computes the velocity of the point, ft/s or m/s, from body state, center and noise, shape (3,)."""
            return read_velocity(body, center, noise, self._position, self._noise_std)

    return VelocitySeen


Tracker: Any = float_class(Tracker_, "Tracker")
PoseTracker: Any = float_class(PoseTracker_, "PoseTracker")
VelocityTracker: Any = float_class(VelocityTracker_, "VelocityTracker")
