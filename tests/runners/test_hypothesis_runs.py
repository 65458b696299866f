"""The detector by hypotheses through every runner: the same bits, restarts, what is said and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from vehicle_flights import step

from massprop_drake import Estimator, Run, Scenario, load_scenario, simulate

NEAR = [
    "execution.engine=loop",
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """A leak in a flight whose filter starts near the truth and soon settles."""
    return load_scenario(
        "leak_named", ["duration_s=9", *NEAR, "failures=[{kind: leak, jet: L4D, start_s: 7, force: 10}]"]
    )


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


def _steps(dut: Estimator, run: Run, rows: range) -> list[tuple[float, str, str | None]]:
    """Steps over rows of a run, which must give its estimates; what is declared when."""
    said = []
    for row in rows:
        now = step(dut, run, row)
        np.testing.assert_array_equal(now.estimate, run["estimate"][row])
        if row + 1 < len(run.time_s):  # the autopilot does without them from the next sample on
            np.testing.assert_array_equal(now.removed, run["out_of_use"][row + 1] == 1.0)
        if now.detection is not None:
            said.append((now.time_s, now.detection.kind, now.detection.jet))
    return said


def test_after_a_restart_what_was_said_is_not_said_again(scenario: Scenario, flown: Run) -> None:
    """The bank begins anew; hypotheses, their forces and the jets out of use are those of before."""
    dut = Estimator(scenario.vehicle_data, scenario)
    (record,) = flown.results.detections
    row = int(np.searchsorted(flown.time_s, record.time_s)) + 1
    jet = scenario.vehicle_data.designations.index(record.jet or "")
    assert record.probability == flown["fault_probability"][row - 1, jet] > 0.99
    _steps(dut, flown, range(row))
    kept = json.loads(json.dumps(dut.state))
    again = Estimator(scenario.vehicle_data, scenario)
    again.restore(kept)
    assert again.state == kept
    assert _steps(again, flown, range(row, len(flown.time_s))) == []
