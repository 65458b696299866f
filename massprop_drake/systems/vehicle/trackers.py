"""Sensors that see the vehicle from outside, in the fixed frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import N_STATE, STRUCTURE
from massprop_drake.maths.vehicle.tracking import N_NOISE, PoseModel, pose_read, velocity_read
from massprop_drake.systems.arguments import vector


class Tracker(LeafSystem):
    """What trackers have in common.

    Ports:
        body_state (in, 23), structure (in, 9): see `RigidBodyPlant`. Required.
        noise (in, n_noise): independent standard normal numbers, new at each sample. Required.
        reading (out, size): in the fixed frame.

    State: none.

    Timing: the reading at t_k is of the body at t_k, but for the error of the stamp.

    Attributes:
        n_noise: how many numbers it takes at each sample.
    """

    def __init__(self, name: str, size: int, n_noise: int):
        super().__init__()
        self.set_name(name)
        self.n_noise = n_noise
        self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
        self._structure = self.DeclareVectorInputPort("structure", STRUCTURE.size)
        self._noise = self.DeclareVectorInputPort("noise", n_noise, RandomDistribution.kGaussian)
        inputs = (self._body_state, self._structure, self._noise)
        read = {self.input_port_ticket(port.get_index()) for port in inputs}
        self.DeclareVectorOutputPort("reading", size, self._calc, prerequisites_of_calc=read)

    def _read(self, body: Array, center: Array, noise: Array) -> Array:
        raise NotImplementedError

    def _calc(self, context: Any, output: Any) -> None:
        center = STRUCTURE.read(self._structure.Eval(context)).center_of_mass
        output.SetFromVector(self._read(self._body_state.Eval(context), center, self._noise.Eval(context)))


class PoseTracker(Tracker):
    """Measures position and attitude, see `maths.vehicle.tracking`; ports, state and timing as `Tracker`.

    The reading (7) is the tracked point's position, ft or m, and the quaternion from body to fixed frame, scalar
    first; NaN for what is not measured.

    Args:
        name: of the sensor.
        model: see `PoseModel`.
    """

    def __init__(self, name: str, model: PoseModel):
        super().__init__(name, 7, N_NOISE)
        vector(f"sensor '{name}': point", model.point, 3)
        self._model = model

    def _read(self, body: Array, center: Array, noise: Array) -> Array:
        return pose_read(body, center, noise, self._model)


class VelocityTracker(Tracker):
    """Measures the velocity of a point, ft/s or m/s, fixed frame; ports, state and timing as `Tracker`.

    Args:
        name: of the sensor.
        position: of the point, vehicle frame, ft or m, shape (3,).
        noise_std: of each component, 1-sigma.
    """

    def __init__(self, name: str, *, position: Array, noise_std: float):
        super().__init__(name, 3, 3)
        self._position = vector(f"sensor '{name}': position", np.asarray(position, dtype=float), 3)
        self._noise_std = noise_std

    def _read(self, body: Array, center: Array, noise: Array) -> Array:
        return velocity_read(body, center, noise, self._position, self._noise_std)
