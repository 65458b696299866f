"""Jets, wheels and sensors as the design of a maneuver takes them, from a scenario."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot.jet_selection import least_cycles
from massprop_drake.maths.maneuver.actions import Craft

Array = NDArray[np.float64]


def craft(scenario: Scenario, without: frozenset[str] = frozenset()) -> Craft:
    """The vehicle as a maneuver commands it, at rest and as its file has it.

    Args:
        scenario: with the joint filter.
        without: designations of jets that are not to be fired.
    """
    vehicle = scenario.vehicle_data
    made, wheels = params.estimation_params(scenario).filter_params.joint, vehicle.wheels
    fires = [place for place, name in enumerate(vehicle.designations) if name not in without]
    return Craft(
        params=made,
        properties=made.nominal,
        period_s=vehicle.sample_period_s,
        flows=np.array(vehicle.mass_flows),
        least=np.maximum(least_cycles(vehicle.minimum_on_times_s, vehicle.sample_period_s), 1.0).astype(int),
        jets=np.array(fires, dtype=int),
        torques=np.array([wheel.torque or 0.0 for wheel in wheels]),
        rate=np.zeros(3),
        speeds=np.array([scenario.plant.wheel_speeds.get(wheel.name, 0.0) for wheel in wheels]),
        every=_every(scenario),
    )


def _every(scenario: Scenario) -> NDArray[np.int_]:
    """Samples between two readings of each component that the joint filter reads."""
    vehicle = scenario.vehicle_data
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    own_hz = [one.rate_hz for one in packages] + [one.rate_hz for one in params.trackers(scenario)]
    rate_hz = [one or 1.0 / vehicle.sample_period_s for one in own_hz]
    samples = [max(1, round(1.0 / (rate * vehicle.sample_period_s))) for rate in rate_hz]
    return np.repeat(np.array(samples, dtype=int), 3)
