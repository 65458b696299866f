"""Burns of an engine: mass properties and errors of the engine at once, failures of engine and jets, records."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run, simulate
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import load_vehicle


def scenario(seed: int, telemetry: str = "measured", **changed: Any) -> Scenario:
    """The small satellite, drawn, with pulses of its jets and then a burn of its engine, canted and displaced."""
    random, data = np.random.default_rng(seed), load_vehicle("small_satellite").model_dump()
    for jet in data["jets"]:
        jet.pop("mass_flow", None)
    engine = {
        "name": "main",
        "position": [-0.3, 0.0, 0.0],
        "direction": [1.0, 0.0, 0.0],
        "thrust": 4.0,
        "direction_std": 0.009,
        "position_std": 0.005,
        "specific_impulse_s": 220.0,
        "level_time_constant_s": 0.1,
        "level_noise_std": 0.0005 if telemetry == "measured" else 0.0,
        "gimbal": {
            "axes": [[0, 1, 0], [0, 0, 1]],
            "stop": 0.15,
            "rate": 0.3,
            "noise_std": 0.0002 if telemetry == "measured" else 0.0,
        },
        "telemetry": telemetry,
    }
    names = [jet["designation"] for jet in data["jets"]]
    jets = [
        {"jet": jet, "start_s": float(begin), "end_s": begin + float(random.choice([0.2, 0.4]))}
        for begin in (*np.arange(0.5, 6.5, 0.6).round(1).tolist(), 8.5, 10.0, 11.5)
        for jet in random.choice(names, 2, replace=False).tolist()
    ]
    gimbal = [(0.0, 0.0), (0.03, -0.02), (-0.02, 0.03), (0.01, 0.0)]
    burns = [
        {"engine": "main", "start_s": start_s, "end_s": start_s + 1.5, "level": 0.6, "gimbal": angles}
        for start_s, angles in zip((7.0, 8.5, 10.0, 11.5), gimbal, strict=True)
    ]
    spread = {"mass_percent": 8.0, "center_of_mass": 0.02, "second_moments_percent": 8.0}
    plant = {"dispersion": spread, "thrust_dispersion": 0.01, "engine_dispersion": 1.0}
    made = {"vehicle": {**data, "engines": [engine]}, "duration_s": 13.0, "seed": seed, "plant": plant}
    return Scenario.model_validate({**made, "jet_schedule": jets, "engine_schedule": burns, **changed})


@cache
def flown(seed: int) -> Run:
    """A healthy flight."""
    return simulate(scenario(seed))


def test_a_burn_is_explained_and_shows_a_scale() -> None:
    run = flown(3)
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < 3.5
    assert run.results.consistency.verdict == "consistent", run.results.consistency.reasons
    assert run.results.events == ()


@pytest.mark.parametrize(("kind", "axis"), [("out", "level"), ("gimbal_2_stuck", "gimbal_2")])
def test_an_engine_that_does_not_follow_is_named_and_no_jet(kind: str, axis: str) -> None:
    failures = [{"engine": "main", "kind": kind, "start_s": 7.8}]
    run = simulate(scenario(4, "commanded", engine_failures=failures), look_back=False)
    found = [event for event in run.results.events if event.kind == "engine_failed"]
    assert [(one.sensor, one.axis) for one in found] == [("main", axis)]
    assert not run.results.detections
    assert found[0].time_s < 12.8
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < 3.5


def test_a_jet_that_sticks_on_in_a_burn_is_named_and_no_engine() -> None:
    made = scenario(5)
    jet = made.vehicle_data.designations[2]
    run = simulate(scenario(5, failures=[{"jet": jet, "kind": "stuck_on", "start_s": 9.5}]), look_back=False)
    assert [(one.kind, one.jet) for one in run.results.detections] == [("jet_on", jet)]
    assert not [event for event in run.results.events if event.kind == "engine_failed"]
    assert run.results.detections[0].time_s < 11.5
