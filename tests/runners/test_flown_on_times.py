"""An autopilot that flies on-times: in both engines, from a record, and against whole cycles."""

from __future__ import annotations

from typing import Any

import numpy as np
from pose_probe import again

from massprop_drake import Scenario, load_vehicle, simulate
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle

PERIOD_S, CLOCK_S, MINIMUM_S = 0.1, 0.001, 0.01
SETTINGS = {"hold_rate_limit": 0.0035, "capture_rate": 0.0035, "acceleration": 0.006, "horizon_s": 1.0}


def vehicle(**changed: Any) -> Vehicle:
    """The small satellite with valves that can be open for 10 ms, in steps of 1 ms."""
    stated = load_vehicle("small_satellite")
    valve = {"minimum_on_time_s": MINIMUM_S, "on_time_quantum_s": CLOCK_S, **changed}
    return again(stated, jet_kinds={"hydrazine": stated.jet_kinds["hydrazine"].model_copy(update=valve)})


def flight(output: str = "on_time", deadband: float = 0.0005, **more: Any) -> Scenario:
    own = {"name": "on_times", "vehicle": vehicle(), "duration_s": 4.5, "seed": 4, "detector": {"kind": "off"}}
    turns = [{"controller": "rhc", "axis": "+x", "start_s": 0.5, "end_s": 1.5}]
    moves = [{"controller": "thc", "axis": "+y", "start_s": 2.0, "end_s": 3.5}]
    pilot = {**SETTINGS, "rate_deadband": deadband, "jet_selection": {"output": output}}
    return resolved(own | {"maneuver": turns + moves, "autopilot": pilot, "execution": {"engine": "loop"}} | more)


def test_attitude_is_held_better_and_for_less_propellant_than_by_whole_cycles() -> None:
    pushed = {"plant": {"disturbance": {"torque": [0.01, -0.006, 0.008]}}, "maneuver": [], "duration_s": 25.0}
    pushed |= {"estimation": {"filter": "thesis"}}  # the quickest, whose estimates nothing here asks for
    rms, used = {}, {}
    for output in ("cycles", "on_time"):
        run = simulate(flight(output, **pushed))
        held, mass = run["attitude_error"][80:], 1.0 / run["truth"][:, 9]
        rms[output], used[output] = float(np.sqrt(np.mean(held**2))), mass[80] - mass[-1]
    assert rms["on_time"] < 0.5 * rms["cycles"]
    assert used["on_time"] < 0.5 * used["cycles"]
