"""Sensors in a fixed frame of a vehicle that is stepped without Drake, equal to the diagram's trackers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import PoseSensor, VelocitySensor
from massprop_drake.maths.noise import normal_sample
from massprop_drake.maths.vehicle.rigid_body import STRUCTURE
from massprop_drake.maths.vehicle.tracking import N_NOISE, is_due, read_pose, read_velocity

Array = NDArray[np.float64]


class Trackers:
    """Sensors in the fixed frame of a vehicle.

    Args:
        scenario: for the vehicle, and the seed of their noise.

    Attributes:
        size: numbers that all of them read.
    """

    def __init__(self, scenario: Scenario):
        sensors = scenario.vehicle_data.tracked
        ends = np.cumsum([0, *(len(sensor.columns) for sensor in sensors)]).tolist()
        parts = zip(sensors, pairwise(ends), strict=True)
        simulated = true_params.simulated_non_inertial(scenario)
        self._parts = {sensor.name: slice(*ends) for sensor, ends in parts if sensor in simulated}
        self.size: int = ends[-1]
        self._seed = scenario.seed
        self._poses = {
            one.name: true_params.pose_model(scenario, one) for one in sensors if isinstance(one, PoseSensor)
        }
        self._points = {
            one.name: (np.array(one.position), one.noise_std) for one in sensors if isinstance(one, VelocitySensor)
        }

    def read(self, body: Array, structure: Array, sample: int) -> Array:
        """Computes readings in the fixed frame from the true state, NaN where nothing is measured, shape (size,).

        Args:
            body: state, see `maths.vehicle.rigid_body`, shape (23,).
            structure: packed as `rigid_body.STRUCTURE`.
            sample: its number.
        """
        center = STRUCTURE.read(structure).center_of_mass
        readings = np.full(self.size, np.nan)
        for name, part in self._parts.items():
            if name in self._poses:
                model = self._poses[name]
                noise = normal_sample(self._seed, name, sample, N_NOISE)
                due = is_due(sample * model.period_s, model)
                readings[part] = read_pose(body, center, noise, model) if due else np.nan
            else:
                noise = normal_sample(self._seed, name, sample, 3)
                readings[part] = read_velocity(body, center, noise, *self._points[name])
        return readings

    def ports(self, rows: Array) -> dict[str, Array]:
        """Maps sensors to their columns of rows of readings, shape (n, size), as `read` returns them."""
        return {name: rows[:, part] for name, part in self._parts.items()}
