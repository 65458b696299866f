"""When a jump of the mass properties may have been, as far as readings and commands tell it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import load_scenario, simulate
from massprop_drake.cli import show
from massprop_drake.results.detections import JUMP, DetectionRecord, placed, since

TIME_S = np.arange(40) * 0.5
STEPS = {"gyro": 0.1}


def jump(onset_s: float, time_s: float = 18.0) -> DetectionRecord:
    return DetectionRecord(onset_s, time_s, JUMP, None, None, None, None, None, 50.0, 1)


def signals(fired: list[int], alarms: list[int], moved: int | None = None) -> dict[str, NDArray[np.float64]]:
    """Commands of two jets in the intervals after some rows, alarms at some, and a gyro that moves once."""
    command, gyro, alarm = np.zeros((40, 2)), np.zeros((40, 3)), np.zeros((40, 1))
    command[fired, 1], alarm[alarms] = 1.0, 1.0
    if moved is not None:
        gyro[moved:, 2] = 1.0
    return {"time_s": TIME_S, "command": command, "gyro": gyro, "alarm": alarm}


def blocks(whole: dict[str, NDArray[np.float64]], rows: int) -> Iterator[dict[str, NDArray[np.float64]]]:
    for first in range(0, TIME_S.size, rows):
        yield {name: values[first : first + rows] for name, values in whole.items()}


@pytest.mark.parametrize("rows", [1, 7, 40])
def test_nothing_tells_the_moment_from_the_last_firing_to_the_next_alarm(rows: int) -> None:
    whole = signals([4, 6, 20, 30], [8, 21, 22, 31])
    found = placed([jump(9.0), jump(12.0)], blocks(whole, rows), STEPS)
    assert [(one.earliest_s, one.latest_s) for one in found] == [(3.5, 10.5), (10.5, 15.5)]
    assert since(found[0]) == "begun between 3.50 and 10.50 s"


def test_while_something_acts_it_was_after_the_comparison_begins() -> None:
    (found,) = placed([jump(9.0)], blocks(signals([17, 18, 19], [20]), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (9.0, 10.0)
    (found,) = placed([jump(9.0)], blocks(signals([4], [20], moved=18), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (9.0, 10.0)


def test_it_lies_between_the_beginning_and_its_declaration() -> None:
    (found,) = placed([jump(9.0, 12.0)], blocks(signals([], [30]), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (0.0, 12.0)
    failed = jump(9.0)._replace(kind="jet_on")
    assert placed([failed], blocks(signals([], []), 7), STEPS) == [failed]


def test_a_docking_while_nothing_fires_is_said_with_its_interval() -> None:
    settings = ["duration_s=59", "execution.engine=loop"]
    docked = "jumps=[{kind: dock, time_s: 55, mass: 500, position: [60, 0, -3]}]"
    run = simulate(load_scenario("payload_docking", [*settings, docked]), look_back=False)
    (found,) = run.results.detections
    assert found.kind == JUMP
    assert found.earliest_s is not None
    assert found.latest_s is not None
    assert found.earliest_s < 55.0 < found.latest_s
    fired_s = run.time_s[(run["command"] > 0.0).any(axis=1)]
    assert not ((fired_s >= found.earliest_s - 1e-9) & (fired_s < 55.0)).any()
    assert found.latest_s == found.time_s  # no jet is in question, so that no alarm shows it sooner
    assert run.summary["detections"][0]["latest_s"] == found.latest_s
    assert since(found) in show._detected(found, run.scenario.vehicle_data)
