"""The source of recorded telemetry: which row is served when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from systems_probe import inputs, output, outputs

from massprop_drake.systems import TelemetrySource

PERIOD_S = 0.1
TIMES = 100.0 + PERIOD_S * np.arange(5)
GYRO = np.arange(15.0).reshape(5, 3)
COMMANDS = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.5], [np.nan, 0.0], [0.0, 1.0]])
WRENCH = np.arange(30.0).reshape(5, 6)


def source(**options: Any) -> tuple[TelemetrySource, Any]:
    dut = TelemetrySource(["gyro"], n_jets=2, period_s=PERIOD_S, **options)
    return dut, dut.CreateDefaultContext()


def fill(dut: TelemetrySource, context: Any, rows: slice, sign: float = 1.0) -> int:
    return dut.extend(context, TIMES[rows], {"gyro": sign * GYRO[rows]}, COMMANDS[rows], WRENCH[rows], COMMANDS[rows])


def served(dut: TelemetrySource, context: Any, port: str, row: int) -> Any:
    context.SetTime(row * PERIOD_S)
    return output(dut, context, port)


def test_a_row_is_served_at_its_sample_and_its_command_one_later() -> None:
    dut, context = source(within=True)
    assert inputs(dut) == {}
    onsets = {"held_command_onset": 2, "command_onset": 2}
    expected = {"gyro": 3, "jet_commands": 2, "command": 2, "outside_wrench": 6, "record_time": 1}
    assert (outputs(dut), outputs(source()[0])) == (expected | onsets, expected)
    assert (context.num_total_states(), context.num_abstract_parameters()) == (0, 1)
    assert (fill(dut, context, slice(0, 2)), fill(dut, context, slice(2, 5))) == (1, 4)
    for row in range(2, 5):
        assert_array_equal(served(dut, context, "gyro", row), GYRO[row])
        assert_array_equal(served(dut, context, "record_time", row), TIMES[row : row + 1])
        for port in ("command", "command_onset"):
            assert_array_equal(served(dut, context, port, row), COMMANDS[row])
        for port in ("jet_commands", "held_command_onset"):  # across the blocks, too
            assert_array_equal(served(dut, context, port, row), COMMANDS[row - 1])
        assert_array_equal(served(dut, context, "outside_wrench", row), WRENCH[row - 1])
    for row in (1, 5):  # what was given before is not served again
        with pytest.raises(IndexError, match=rf"row {row} is not in the window of rows 2 to 4"):
            served(dut, context, "gyro", row)


def test_before_the_first_row_jets_are_off_or_as_they_were() -> None:
    for begun in (False, True):
        dut, context = source(first_row=7)
        if begun:
            dut.begin(context, np.array([0.0, 1.0]), np.full(6, 2.0))
        assert fill(dut, context, slice(0, 5)) == 11
        assert_array_equal(served(dut, context, "jet_commands", 7), [0.0, float(begun)])
        assert_array_equal(served(dut, context, "outside_wrench", 7), np.full(6, 2.0 * begun))


def test_each_context_has_rows_of_its_own() -> None:
    dut, one = source()
    fill(dut, one, slice(0, 5))
    clone = one.Clone()
    fill(dut, one, slice(0, 5), -1.0)
    assert_array_equal(served(dut, one, "gyro", 5), -GYRO[0])
    assert_array_equal(served(dut, clone, "gyro", 0), GYRO[0])
