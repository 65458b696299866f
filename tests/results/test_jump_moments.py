"""When a jump of the mass properties may have been, as far as readings and commands tell it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake.results.detections import JUMP, DetectionRecord, bound_jump_times, onset_in_words

TIME_S = np.arange(40) * 0.5
STEPS = {"gyro": 0.1}


def jump(onset_s: float, time_s: float = 18.0) -> DetectionRecord:
    return DetectionRecord(onset_s, time_s, JUMP, None, None, None, None, None, 50.0, 1)


def blocks(
    fired: list[int], alarms: list[int], moved: int | None = None, *, rows: int = 7
) -> Iterator[dict[str, NDArray[np.float64]]]:
    """Commands of two jets in the intervals after some rows, alarms at some, and a gyro that moves once."""
    command, gyro, alarm = np.zeros((40, 2)), np.zeros((40, 3)), np.zeros((40, 1))
    command[fired, 1], alarm[alarms] = 1.0, 1.0
    if moved is not None:
        gyro[moved:, 2] = 1.0
    whole = {"time_s": TIME_S, "command": command, "gyro": gyro, "alarm": alarm}
    for first in range(0, TIME_S.size, rows):
        yield {name: values[first : first + rows] for name, values in whole.items()}


@pytest.mark.parametrize("rows", [1, 7, 40])
def test_nothing_tells_the_moment_from_the_last_firing_to_the_next_alarm(rows: int) -> None:
    found = bound_jump_times([jump(9.0), jump(12.0)], blocks([4, 6, 20, 30], [8, 21, 22, 31], rows=rows), STEPS)
    assert [(one.earliest_s, one.latest_s) for one in found] == [(3.5, 10.5), (10.5, 15.5)]
    assert onset_in_words(found[0]) == "begun between 3.50 and 10.50 s"


@pytest.mark.parametrize(
    ("record", "fired", "alarms", "moved", "within"),
    [
        (jump(9.0), [17, 18, 19], [20], None, (9.0, 10.0)),  # while something acts it was after the comparison begins
        (jump(9.0), [4], [20], 18, (9.0, 10.0)),
        (jump(9.0, 12.0), [], [30], None, (0.0, 12.0)),  # between the beginning and its declaration
        (jump(9.0)._replace(kind="jet_on"), [], [], None, (None, None)),
    ],
)
def test_it_lies_where_nothing_shows_it(
    record: DetectionRecord, fired: list[int], alarms: list[int], moved: int | None, within: tuple[float, float]
) -> None:
    (found,) = bound_jump_times([record], blocks(fired, alarms, moved), STEPS)
    assert (found.earliest_s, found.latest_s) == within
