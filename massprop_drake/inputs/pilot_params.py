"""Parameters of the autopilot, from a scenario's choices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from massprop_drake.inputs.params import (
    accelerometers,
    convergence_limits,
    engines,
    gyros,
    sample_count,
    scheduled_jet_commands,
    selectable_jets,
    unit_wrenches,
    wheels,
)
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot.gimbal_control import GimbalControl
from massprop_drake.maths.autopilot.jet_selection import jet_forces
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, Window
from massprop_drake.maths.autopilot.pulses import Pulses, max_edges, valve_pulses, whole_cycle_pulses
from massprop_drake.maths.autopilot.wheel_control import WheelControlParams, torque_shares
from massprop_drake.maths.flight import FlightParams, PilotParams
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS
from massprop_drake.maths.vehicle.on_times import PLACES, max_pieces
from massprop_drake.maths.vehicle.vehicle_cycle import VehicleParams, pack_truth


def phase_space_params(scenario: Scenario) -> PhaseSpaceParams:
    """Makes the settings of the phase-space controller."""
    autopilot = scenario.autopilot
    return PhaseSpaceParams(
        period_s=scenario.vehicle_data.sample_period_s,
        discrete_rate=autopilot.discrete_rate,
        hold_gain=autopilot.hold_gain,
        hold_rate_limit=autopilot.hold_rate_limit,
        capture_rate=autopilot.capture_rate,
        rate_deadband=autopilot.rate_deadband,
        acceleration=autopilot.acceleration,
        horizon_s=autopilot.horizon_s,
        resolve_rate=autopilot.resolve_rate,
        resolve_after_s=autopilot.resolve_after_s,
    )


def controller_windows(scenario: Scenario) -> tuple[Window, ...]:
    """Lists the windows in which hand controllers are out of detent: channel 0 to 5, sign, start and end in s."""
    return tuple(
        Window(
            channel=(0 if window.controller == "rhc" else 3) + "xyz".index(window.axis[-1]),
            sign=1.0 if window.axis[0] == "+" else -1.0,
            start_s=window.start_s,
            end_s=window.end_s,
        )
        for window in scenario.maneuver
    )


def jet_selection_arguments(scenario: Scenario) -> dict[str, Any]:
    """Makes the keyword arguments of the system of jet selection, see `systems.autopilot.selector.Selector`."""
    vehicle = scenario.vehicle_data
    return {
        "wrenches": vehicle.wrenches,
        "mass_flows": vehicle.mass_flows,
        "minimum_on_times_s": vehicle.minimum_on_times_s,
        "selectable": selectable_jets(scenario),
        "mass_properties": vehicle.nominal.vector(),
        "period_s": vehicle.sample_period_s,
        "pulses": pulses(scenario),
    }


def pulses(scenario: Scenario) -> Pulses:
    """Makes the parameters of pulses that the autopilot commands: whole cycles, or on-times where asked for."""
    vehicle, selected = scenario.vehicle_data, scenario.autopilot.jet_selection
    if scenario.open_loop or selected.output == "cycles":
        return whole_cycle_pulses(len(vehicle.jets))
    opening_place, accumulates = PLACES[vehicle.jet_commands.at], selected.below_minimum == "accumulate"
    return valve_pulses(
        vehicle.minimum_on_times_s, vehicle.on_time_quanta_s, vehicle.sample_period_s, opening_place, accumulates
    )


def flight_params(scenario: Scenario, plant: VehicleParams) -> FlightParams:
    """Makes the parameters of the plant, as of `vehicle_params`, and its autopilot at a sample."""
    vehicle, names = scenario.vehicle_data, scenario.vehicle_data.sensor_names()
    flies = not scenario.open_loop
    pilot = PilotParams(
        phase_space_params(scenario),
        jet_forces(vehicle.wrenches),
        unit_wrenches(vehicle),
        float(vehicle.nominal.vector()[MASS_RECIPROCAL]),
        flies and scenario.autopilot.mass_properties == "estimated",
        convergence_limits(scenario),
        pulses(scenario),
    )
    return FlightParams(
        pack_truth(plant),
        pilot,
        flies,
        flies and closes_manifolds(scenario),
        np.array([names.index(package.name) for package in gyros(scenario)], dtype=np.int_),
        np.array([names.index(package.name) for package in accelerometers(scenario)], dtype=np.int_),
    )


def wheel_control(scenario: Scenario) -> WheelControlParams | None:
    """Makes the parameters of attitude control by reaction wheels; None: the autopilot does not use them."""
    vehicle, block = scenario.vehicle_data, scenario.autopilot.wheels
    if block is None:
        return None
    known, settings = wheels(vehicle), phase_space_params(scenario)
    return WheelControlParams(
        axes=known.axes,
        shares=torque_shares(known.axes),
        inertias=known.inertias,
        most=known.most * known.inertias,
        fastest=np.array([wheel.fastest for wheel in vehicle.wheels]),
        inertia=vehicle.nominal.inertia,
        rate_gain=block.rate_gain,
        unload_above=math.inf if block.unload_above is None else block.unload_above,
        unload_below=block.unload_below,
        unload_rate=1.5 * settings.rate_deadband if block.unload_rate is None else block.unload_rate,
        settings=settings,
    )


def wheel_torques(scenario: Scenario) -> Array:
    """Makes the prescribed torque of each wheel at each sample, ft-lbf or N-m, shape (n_samples, n_wheels)."""
    vehicle = scenario.vehicle_data
    names, period = [wheel.name for wheel in vehicle.wheels], vehicle.sample_period_s
    table = np.zeros((sample_count(scenario), len(names)))
    for pulse in scenario.wheel_schedule:
        first, last = (math.ceil(time / period - 1e-9) for time in (pulse.start_s, pulse.end_s))
        table[first:last, names.index(pulse.wheel)] = pulse.torque
    return table


def gimbal_control(scenario: Scenario) -> GimbalControl:
    """Makes the controller that holds zero rate in burns by the engines' gimbals."""
    vehicle, bandwidth = scenario.vehicle_data, scenario.autopilot.gimbal_bandwidth
    return GimbalControl(engines(vehicle), vehicle.nominal, bandwidth, vehicle.sample_period_s)


def engine_commands(scenario: Scenario) -> Array:
    """Makes the prescribed level and two gimbal angles, rad, of engines by sample, shape (n_samples, 3 n_engines)."""
    vehicle = scenario.vehicle_data
    names, period = [engine.name for engine in vehicle.engines], vehicle.sample_period_s
    table = np.zeros((sample_count(scenario), len(names), N_CHANNELS))
    for burn in scenario.engine_schedule:
        first, last = (math.ceil(time / period - 1e-9) for time in (burn.start_s, burn.end_s))
        table[first:last, names.index(burn.engine)] = (burn.level, *burn.gimbal)
    return table.reshape(len(table), -1)


def max_pieces_per_sample(scenario: Scenario) -> int:
    """Returns the largest number of pieces into which jet switching splits a sample; 1: no jet switches within one."""
    if not scenario.open_loop:
        return 1 + max_edges(pulses(scenario))
    table, onset_s = scheduled_jet_commands(scenario)
    return 1 if onset_s is None else max_pieces(table, onset_s, scenario.vehicle_data.sample_period_s)


def closes_manifolds(scenario: Scenario) -> bool:
    """Tests whether a declared failure closes the jet's manifold, as the detector's block says."""
    return bool(getattr(scenario.detector, "close_manifold", False))
