"""Sensors in a fixed frame of a vehicle that is stepped without Drake: they read what the diagram's trackers do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle import PoseSensor
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle.rigid_body import STRUCTURE
from massprop_drake.maths.vehicle.tracking import N_NOISE, pose_read, velocity_read

Array = NDArray[np.float64]


class Trackers:
    """All of a vehicle's sensors in the fixed frame.

    Args:
        scenario: for the vehicle, and the seed of their noise.

    Attributes:
        sizes: numbers that each reads, by name.
    """

    def __init__(self, scenario: Scenario):
        sensors = scenario.vehicle_data.tracked
        self.sizes = {sensor.name: len(sensor.columns) for sensor in sensors}
        self._seed = scenario.seed
        self._poses = {one.name: params.pose_model(scenario, one) for one in sensors if isinstance(one, PoseSensor)}
        self._points = {
            one.name: (np.array(one.position), one.noise_std) for one in sensors if not isinstance(one, PoseSensor)
        }

    def read(self, body: Array, structure: Array, sample: int) -> dict[str, Array]:
        """What each reads of the true vehicle at a sample, NaN where it measures nothing.

        Args:
            body: state, see `maths.vehicle.rigid_body`, shape (23,).
            structure: packed as `rigid_body.STRUCTURE`.
            sample: its number.
        """
        center = STRUCTURE.read(structure).center_of_mass
        readings = {}
        for name in self.sizes:
            if name in self._poses:
                noise = normal_sample(self._seed, name, sample, N_NOISE)
                readings[name] = pose_read(body, center, noise, self._poses[name])
            else:
                noise = normal_sample(self._seed, name, sample, 3)
                readings[name] = velocity_read(body, center, noise, *self._points[name])
        return readings
