"""Failures in flights whose lag is not the file's: they are found as if it were, and the lag is said to be wrong."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from massprop_drake import load_scenario, simulate

NONE = ("plant.thrust_transient=none", "joint.thrust_transient=vehicle")
FAILURES: dict[str, dict[str, Any]] = {
    "on": {"kind": "stuck_on", "jet": "L2L"},
    "off": {"kind": "stuck_off", "jet": "L1A"},
    "leak": {"kind": "leak", "jet": "L5D", "force": 10.0},
}


@pytest.mark.parametrize(("factor", "mode"), [(0.0, "leak"), (2.0, "on"), (3.0, "on"), (3.0, "off")])
def test_a_failure_is_named_at_any_lag(factor: float, mode: str) -> None:
    """Tests lags of nothing to three times the stated one; thrusts are off by 1 %, as stated."""
    lag = NONE if factor == 0.0 else (f"plant.lag_factor={factor}",)
    told = ("estimation.start=nominal", "joint={}", "plant.thrust_dispersion=0.01", "duration_s=27", "seed=3")
    failures = f"failures={json.dumps([{**FAILURES[mode], 'start_s': 24.3}])}"
    run = simulate(load_scenario("orbiter_maneuver", ["execution.engine=loop", *told, *lag, failures]))
    (found,) = run.summary["detections"]
    (injected,) = run.summary["injected"]
    assert (found["jet"], found["withdrawn_s"], injected["outcome"]) == (FAILURES[mode]["jet"], None, "named")
    assert injected["declared_s"] - injected["first_acted_s"] <= 1.0
    assert run.summary["consistency"]["reasons"][0].startswith("lag wrong: primary jets build up with ")
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < 3.5
