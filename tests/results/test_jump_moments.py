"""When a jump of the mass properties may have been, as far as readings and commands tell it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import load_scenario, simulate
from massprop_drake.results.detections import JUMP, DetectionRecord, placed, since

TIME_S = np.arange(40) * 0.5
STEPS = {"gyro": 0.1}


def jump(onset_s: float, time_s: float = 18.0) -> DetectionRecord:
    return DetectionRecord(onset_s, time_s, JUMP, None, None, None, None, None, 50.0, 1)


def signals(fired: list[int], moved: int | None = None) -> dict[str, NDArray[np.float64]]:
    """Commands of two jets in the intervals after some rows, and a gyro that moves once."""
    command, gyro = np.zeros((40, 2)), np.zeros((40, 3))
    command[fired, 1] = 1.0
    if moved is not None:
        gyro[moved:, 2] = 1.0
    return {"time_s": TIME_S, "command": command, "gyro": gyro}


def blocks(whole: dict[str, NDArray[np.float64]], rows: int) -> Iterator[dict[str, NDArray[np.float64]]]:
    for first in range(0, TIME_S.size, rows):
        yield {name: values[first : first + rows] for name, values in whole.items()}


@pytest.mark.parametrize("rows", [1, 7, 40])
def test_between_two_firings_nothing_tells_the_moment(rows: int) -> None:
    found = placed([jump(9.0), jump(12.0)], blocks(signals([4, 6, 20, 30]), rows), STEPS)
    assert [(one.earliest_s, one.latest_s) for one in found] == [(3.5, 10.0), (10.5, 15.0)]
    assert since(found[0]) == "begun between 3.50 and 10.00 s"


def test_what_is_felt_is_told() -> None:
    (found,) = placed([jump(9.0)], blocks(signals([4, 20], moved=18), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (9.0, 10.0)  # it begins where the reading has moved
    (found,) = placed([jump(10.2)], blocks(signals([19, 20, 21]), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (None, None)
    assert since(found) == "since 10.20 s"


def test_it_lies_between_the_beginning_and_its_declaration() -> None:
    (found,) = placed([jump(9.0, 12.0)], blocks(signals([]), 7), STEPS)
    assert (found.earliest_s, found.latest_s) == (0.0, 12.0)
    failed = jump(9.0)._replace(kind="jet_on")
    assert placed([failed], blocks(signals([]), 7), STEPS) == [failed]


def test_a_docking_while_nothing_fires_is_said_with_its_interval() -> None:
    settings = ["duration_s=59", "execution.engine=loop"]
    docked = "jumps=[{kind: dock, time_s: 55, mass: 500, position: [60, 0, -3]}]"
    run = simulate(load_scenario("payload_docking", [*settings, docked]))
    (found,) = run.results.detections
    assert found.kind == JUMP
    assert found.earliest_s is not None
    assert found.latest_s is not None
    assert found.earliest_s < 55.0 < found.latest_s
    fired_s = run.time_s[(run["command"] > 0.0).any(axis=1)]
    assert not ((fired_s >= found.earliest_s - 1e-9) & (fired_s < found.latest_s - 1e-9)).any()
    assert run.summary["detections"][0]["latest_s"] == found.latest_s
