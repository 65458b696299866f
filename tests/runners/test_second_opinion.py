"""Recorded telemetry estimated twice: by the plain cycle, and by the replay diagram in Drake's simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from replay_probe import replayed

from massprop_drake import Scenario, estimate, load_scenario, simulate
from massprop_drake.inputs.scenario import bundled_scenarios, resolved
from massprop_drake.runners.recorded import settings_alone

EARLIER_S = 42.0
# below what the sensors resolve, and later than there is time for here: test_pose_runs.py flies on to the second
UNSEEN = {"leak_27", "air_bearing_pulses", "lander_burn"}
UNTESTED = {"servicer_on_wheels_leak"}  # which wheels hold: hardly a thruster has fired by then


def _shortened(name: str) -> Scenario:
    """A bundled scenario cut short; one in which something happens has it early, and starts near the truth."""
    data = load_scenario(name).model_dump(mode="json")
    if data["plant"]["kind"] == "rigid":
        data["execution"]["engine"] = "loop"
    if not data["failures"] and not data["jumps"]:
        return resolved(data | {"duration_s": 10.0})
    if data["estimation"]["filter"] == "pose":  # what has failed did so before the record begins
        return resolved(data | {"duration_s": 4.0})
    for failure in data["failures"]:
        failure["start_s"] -= EARLIER_S
        failure["end_s"] = failure["end_s"] and failure["end_s"] - EARLIER_S
    for jump in data["jumps"]:
        jump["time_s"] -= EARLIER_S
    data["estimation"] |= {"start": "nominal", "std_fraction": 0.001}
    data["plant"]["mass_properties"] = None  # the vehicle is as its file says
    if data["estimation"]["filter"] == "joint":  # finds what happens soon, and takes more time a sample
        return resolved(data | {"duration_s": 8.0, "joint": data["joint"] | {"settled_after": 10}})
    return resolved(data | {"duration_s": 16.0})


@pytest.mark.parametrize("name", bundled_scenarios())
def test_the_cycle_and_the_diagram_agree_bit_for_bit(name: str, tmp_path: Path) -> None:
    run = simulate(_shortened(name), look_back=False)  # by the loop; test_loop.py compares it with the diagram
    telemetry = run.save(tmp_path / "run", pictures=False, report=False) / "telemetry.csv"
    found = estimate(telemetry, run.scenario)
    second = replayed(telemetry, settings_alone(run.scenario))
    for signal, expected in second.signals.items():
        np.testing.assert_array_equal(found[signal], expected, err_msg=signal)
    detected = set() if run.scenario.detector.kind == "off" else {"likelihood", "known_force"}
    weighed = {"mass_nis"} if run.scenario.vehicle_data.accelerometers else set()
    assert {"estimate", "rotation_nis", *weighed, *detected} <= set(second.signals)
    np.testing.assert_array_equal(found.covariance, second.covariance)
    assert found.state is not None
    assert found.state["states"] == second.states
    assert found["rotation_used"].sum() > 5
    if run.scenario.failures or run.scenario.jumps:
        assert name in UNTESTED or found["tested"].any()
        assert name in UNSEEN | UNTESTED or found["alarm"].any() or found["detector_event"].any()
