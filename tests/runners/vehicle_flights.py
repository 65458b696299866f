"""Flights of bundled vehicles with quick valves, open loop, for several tests."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from pose_probe import again

from massprop_drake import Estimator, EstimatorStep, Run, Scenario, load_vehicle
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle


def quick(name: str, kind: str, **changed: Any) -> Vehicle:
    """A bundled vehicle whose valves can be open for 10 ms."""
    vehicle = load_vehicle(name)
    valve = {"minimum_on_time_s": 0.01, "thrust_uncertainty": 0.01, **changed}
    return again(vehicle, jet_kinds={kind: vehicle.jet_kinds[kind].model_copy(update=valve)})


def windows(*told: tuple[str, str, float, float]) -> str:
    """An override of a scenario: hand controllers, each with its axis, start and end."""
    names = ("controller", "axis", "start_s", "end_s")
    return f"maneuver={json.dumps([dict(zip(names, one, strict=True)) for one in told])}"


def step(dut: Estimator, run: Run, row: int) -> EstimatorStep:
    """A step of the estimator, with all that a run read and commanded at a row."""
    vehicle = run.scenario.vehicle_data
    rates, velocities, tracked = (
        {one.name: run[one.name][row] for one in some} or None
        for some in (vehicle.gyros, vehicle.accelerometers, vehicle.tracked)
    )
    onsets_s = run["command_onset"][row] if "command_onset" in run.signals else None
    return dut.step(run.time_s[row], rates, velocities, run["command"][row], tracked=tracked, onsets_s=onsets_s)


def pulses(vehicle: Vehicle, until_s: float, seed: int = 0) -> list[dict[str, Any]]:
    """Pulses of 10 to 90 ms, some longer, from a sample's beginning on or within it."""
    random, told, time_s = np.random.default_rng(seed), list[dict[str, Any]](), 0.5
    while time_s < until_s - 1.0:
        for jet in random.choice(vehicle.designations, 2, replace=False):
            start_s = time_s + (0.0 if random.random() < 0.5 else random.uniform(0.0, 0.05))
            length_s = random.uniform(0.01, 0.09) if random.random() < 0.7 else random.uniform(0.1, 0.4)
            told.append({"jet": str(jet), "start_s": float(start_s), "end_s": float(start_s + length_s)})
        time_s += 0.6
    return told


def small_pulses(duration_s: float, vehicle: Vehicle | None = None, **more: Any) -> Scenario:
    """Pulses of the small satellite, whose body and thrusts are as stated but for 1 % of thrust."""
    vehicle = vehicle or quick("small_satellite", "hydrazine")
    own = {"name": "pulses", "vehicle": vehicle, "duration_s": duration_s, "seed": 3, "joint": {"tank_fraction": 0}}
    plant = {"dispersion": {}, "thrust_dispersion": 0.01, **more.pop("plant", {})}
    loop = {"execution": {"engine": "loop"}}
    return resolve_scenario(own | {"plant": plant, "jet_schedule": pulses(vehicle, duration_s)} | loop | more)
