"""Jets, wheels and sensors as the design of a maneuver takes them, from a scenario."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import asked, params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot.jet_selection import least_cycles
from massprop_drake.maths.maneuver.actions import Craft
from massprop_drake.maths.maneuver.onboard import FiringTest
from massprop_drake.maths.maneuver.planning import Cost

MARGIN = 0.15  # by which share each 1-sigma is smaller than asked, since the truth is not nominal; probability
SECOND = 0.05  # what a second costs, in seconds of a jet's propellant; a preference


def make_craft(scenario: Scenario, excluded_jets: frozenset[str] = frozenset()) -> Craft:
    """Makes the vehicle model of a maneuver design: at rest, with the jets that may be fired and the wheels.

    Args:
        scenario: with the joint filter.
        excluded_jets: designations of jets that are not to be fired.
    """
    vehicle = scenario.vehicle_data
    joint_params, wheels = params.estimation_params(scenario).filter_params.joint, vehicle.wheels
    usable_jets = [index for index, name in enumerate(vehicle.designations) if name not in excluded_jets]
    return Craft(
        params=joint_params,
        properties=joint_params.nominal,
        period_s=vehicle.sample_period_s,
        flows=np.array(vehicle.mass_flows),
        least=np.maximum(least_cycles(vehicle.minimum_on_times_s, vehicle.sample_period_s), 1.0).astype(int),
        jets=np.array(usable_jets, dtype=int),
        torques=np.array([wheel.torque or 0.0 for wheel in wheels]),
        rate=np.zeros(3),
        speeds=np.array([scenario.plant.wheel_speeds.get(wheel.name, 0.0) for wheel in wheels]),
        every=_samples_per_reading(scenario),
    )


def firing_test(scenario: Scenario) -> FiringTest | None:
    """Makes the settings of test firings that the autopilot flies; None: the scenario has no such block."""
    block, vehicle = scenario.autopilot.test_firing, scenario.vehicle_data
    if block is None:
        return None
    if scenario.estimation.filter != "joint":
        raise InputError("autopilot.test_firing: goes with estimation.filter: joint")
    if block.when == "group" and scenario.detector.kind != "hypotheses":
        raise InputError("autopilot.test_firing: when: group goes with detector.kind: hypotheses")
    for name in block.without:
        if name not in vehicle.designations:
            raise InputError(f"autopilot.test_firing.without: no jet '{name}'{suggestion(name, vehicle.designations)}")
    craft = make_craft(scenario, frozenset(block.without))
    targets = asked.parse_targets(block.targets, craft.properties, vehicle)
    no_suspects = asked.parse_suspects((), block.force, vehicle, craft.jets)
    flow = float(np.median(craft.flows[craft.jets]))
    thrusts = np.linalg.norm(vehicle.thrusts, axis=1)
    return FiringTest(
        craft=craft,
        targets=asked.make_aims(targets, no_suspects, craft.params, asked.AimSettings(scenario.faults, 0.0, False)),
        forces=np.abs(asked.parse_failure_forces(block.force, vehicle, range(thrusts.size))),
        thrusts=thrusts,
        odds=asked.declaration_log_odds(scenario.faults),
        limits=asked.parse_limits(block.limits, vehicle),
        cost=Cost(1.0 / flow, SECOND),
        margin=MARGIN,
        patience_s=block.patience_s,
        groups=block.when == "group",
    )


def _samples_per_reading(scenario: Scenario) -> NDArray[np.int_]:
    """Returns samples per reading of each sensor component that the joint filter reads, shape (3 n_sensors,)."""
    vehicle = scenario.vehicle_data
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    own_hz = [sensor.rate_hz for sensor in packages] + [sensor.rate_hz for sensor in params.trackers(scenario)]
    rate_hz = [sensor or 1.0 / vehicle.sample_period_s for sensor in own_hz]
    samples = [max(1, round(1.0 / (rate * vehicle.sample_period_s))) for rate in rate_hz]
    return np.repeat(np.array(samples, dtype=int), 3)
