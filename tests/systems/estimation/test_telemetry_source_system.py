"""The source of recorded telemetry: which row is served when."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.systems.framework import OutputPortIndex

from massprop_drake.systems.estimation.telemetry_source import TelemetrySource

Array = NDArray[np.float64]

PERIOD_S = 0.1
TIMES = 100.0 + PERIOD_S * np.arange(5)
GYRO = np.arange(15.0).reshape(5, 3)
COMMANDS = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.5], [np.nan, 0.0], [0.0, 1.0]])
WRENCH = np.arange(30.0).reshape(5, 6)


def _source(**options: float) -> TelemetrySource:
    return TelemetrySource(["gyro"], n_jets=2, period_s=PERIOD_S, **options)  # type: ignore[arg-type]


def _served(dut: TelemetrySource, context: Any, port: str, time_s: float) -> Array:
    context.SetTime(time_s)
    value: Array = dut.GetOutputPort(port).Eval(context)
    return value


def test_topology() -> None:
    dut = _source()
    assert dut.num_input_ports() == 0
    ports = [dut.get_output_port(OutputPortIndex(index)) for index in range(dut.num_output_ports())]
    assert {port.get_name(): port.size() for port in ports} == {
        "gyro": 3,
        "jet_commands": 2,
        "command": 2,
        "outside_wrench": 6,
        "record_time": 1,
    }
    context = dut.CreateDefaultContext()
    assert context.num_total_states() == 0
    assert context.num_abstract_parameters() == 1


def test_a_row_is_served_at_its_sample_and_its_command_one_later() -> None:
    dut = _source()
    context = dut.CreateDefaultContext()
    assert dut.extend(context, TIMES, {"gyro": GYRO}, COMMANDS, WRENCH) == 4
    for row in range(5):
        time_s = row * PERIOD_S
        np.testing.assert_array_equal(_served(dut, context, "gyro", time_s), GYRO[row])
        np.testing.assert_array_equal(_served(dut, context, "command", time_s), COMMANDS[row])
        np.testing.assert_array_equal(_served(dut, context, "record_time", time_s), TIMES[row : row + 1])
        before = COMMANDS[row - 1] if row else np.zeros(2)  # all jets off before the first row
        np.testing.assert_array_equal(_served(dut, context, "jet_commands", time_s), before)
        np.testing.assert_array_equal(
            _served(dut, context, "outside_wrench", time_s), WRENCH[row - 1] if row else np.zeros(6)
        )


def test_the_window_moves_and_what_is_served_stays_the_same() -> None:
    dut = _source()
    context = dut.CreateDefaultContext()
    dut.extend(context, TIMES[:2], {"gyro": GYRO[:2]}, COMMANDS[:2], None)
    assert dut.extend(context, TIMES[2:4], {"gyro": GYRO[2:4]}, COMMANDS[2:4], None) == 3
    np.testing.assert_array_equal(_served(dut, context, "jet_commands", 0.2), COMMANDS[1])  # across the blocks
    np.testing.assert_array_equal(_served(dut, context, "gyro", 0.3), GYRO[3])
    for time_s in (0.1, 0.4):
        with pytest.raises(IndexError, match=r"row \d is not in the window of rows 2 to 3"):
            _served(dut, context, "gyro", time_s)


def test_rows_may_begin_later_after_a_command_that_is_given() -> None:
    dut = _source(first_row=7)
    context = dut.CreateDefaultContext()
    dut.begin(context, np.array([0.0, 1.0]), np.full(6, 2.0))
    assert dut.extend(context, TIMES, {"gyro": GYRO}, COMMANDS, WRENCH) == 11
    np.testing.assert_array_equal(_served(dut, context, "jet_commands", 7 * PERIOD_S), [0.0, 1.0])
    np.testing.assert_array_equal(_served(dut, context, "outside_wrench", 7 * PERIOD_S), np.full(6, 2.0))
    np.testing.assert_array_equal(_served(dut, context, "gyro", 7 * PERIOD_S), GYRO[0])


def test_an_unknown_command_stays_unknown() -> None:
    dut = _source()
    context = dut.CreateDefaultContext()
    dut.extend(context, TIMES, {"gyro": GYRO}, COMMANDS, WRENCH)
    np.testing.assert_array_equal(_served(dut, context, "jet_commands", 0.4), [math.nan, 0.0])
    assert math.isnan(_served(dut, context, "command", 0.3)[0])


def test_each_context_has_rows_of_its_own() -> None:
    dut = _source()
    one, other = dut.CreateDefaultContext(), dut.CreateDefaultContext()
    dut.extend(one, TIMES, {"gyro": GYRO}, COMMANDS, WRENCH)
    clone = one.Clone()
    dut.extend(one, TIMES, {"gyro": -GYRO}, COMMANDS, WRENCH)
    dut.extend(other, TIMES[:1], {"gyro": GYRO[4:]}, COMMANDS[:1], None)
    np.testing.assert_array_equal(_served(dut, one, "gyro", 0.5), -GYRO[0])
    np.testing.assert_array_equal(_served(dut, other, "gyro", 0.0), GYRO[4])
    np.testing.assert_array_equal(_served(dut, clone, "gyro", 0.0), GYRO[0])


def test_what_was_given_before_is_not_served_again() -> None:
    dut = _source()
    context = dut.CreateDefaultContext()
    dut.extend(context, TIMES[:2], {"gyro": GYRO[:2]}, COMMANDS[:2], None)
    np.testing.assert_array_equal(_served(dut, context, "gyro", 0.1), GYRO[1])
    dut.extend(context, TIMES[2:], {"gyro": GYRO[2:]}, COMMANDS[2:], None)
    with pytest.raises(IndexError, match="row 1 is not in the window of rows 2 to 4"):  # at the same time
        dut.GetOutputPort("gyro").Eval(context)
