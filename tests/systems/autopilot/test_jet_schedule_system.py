"""The jet schedule: a table played back, a row per sample."""

from __future__ import annotations

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.systems.autopilot.jet_schedule import JetSchedule

TABLE = np.array([[1.0, 0.0], [0.25, 1.0], [0.0, 0.5]])


def test_topology() -> None:
    dut = JetSchedule(TABLE, period_s=PERIOD_S)
    assert inputs(dut) == {}
    assert outputs(dut) == {"command": 2, "held_command": 2}
    assert feedthrough(dut) == {"command": set(), "held_command": set()}
    assert dut.CreateDefaultContext().get_discrete_state(0).size() == 2


def test_row_k_is_commanded_at_sample_k_and_nothing_after_the_last() -> None:
    dut = JetSchedule(TABLE, period_s=PERIOD_S)
    context = dut.CreateDefaultContext()
    for row in (*TABLE, [0.0, 0.0], [0.0, 0.0]):
        np.testing.assert_array_equal(dut.GetOutputPort("command").Eval(context), row)
        advance(dut, context)


def test_the_held_command_is_that_of_the_sample_before() -> None:
    dut = JetSchedule(TABLE, period_s=PERIOD_S)
    context = dut.CreateDefaultContext()
    for row in ([0.0, 0.0], *TABLE, [0.0, 0.0]):
        np.testing.assert_array_equal(dut.GetOutputPort("held_command").Eval(context), row)
        advance(dut, context)


def test_the_sample_number_survives_the_rounding_of_its_time() -> None:
    table = np.arange(1000.0)[:, None] / 1000.0
    dut = JetSchedule(table, period_s=PERIOD_S)
    context = dut.CreateDefaultContext()
    for sample in range(1000):
        for time_s in (sample * PERIOD_S, np.nextafter(sample * PERIOD_S, -1.0), np.nextafter(sample * PERIOD_S, 1e9)):
            context.SetTime(time_s)
            assert dut.GetOutputPort("command").Eval(context)[0] == table[sample, 0]


def test_the_table_is_copied() -> None:
    table = TABLE.copy()
    dut = JetSchedule(table, period_s=PERIOD_S)
    table[:] = 0.75
    np.testing.assert_array_equal(dut.GetOutputPort("command").Eval(dut.CreateDefaultContext()), TABLE[0])


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        (np.zeros(4), r"a row per sample and a column per jet, got shape \(4,\)"),
        (np.full((2, 4), 1.1), "from 0 to 1"),
        (np.full((2, 4), np.nan), "from 0 to 1"),
    ],
)
def test_what_is_no_table_of_commands_is_refused(commands: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        JetSchedule(commands, period_s=PERIOD_S)


def test_onsets_are_played_back_beside_the_commands() -> None:
    onsets_s = np.array([[np.nan, 0.0], [0.01, 0.0], [0.0, 0.02]])
    dut = JetSchedule(TABLE, period_s=PERIOD_S, onsets_s=onsets_s)
    assert outputs(dut) == {"command": 2, "held_command": 2, "command_onset": 2, "held_command_onset": 2}
    assert feedthrough(dut)["held_command_onset"] == set()
    context, before = dut.CreateDefaultContext(), np.full(2, np.nan)
    for row in (*onsets_s, np.full(2, np.nan)):
        np.testing.assert_array_equal(dut.GetOutputPort("command_onset").Eval(context), row)
        np.testing.assert_array_equal(dut.GetOutputPort("held_command_onset").Eval(context), before)
        before = row
        advance(dut, context)
    with pytest.raises(ValueError, match=r"onsets must be a table like that of commands, \(3, 2\), got shape \(2, 2\)"):
        JetSchedule(TABLE, period_s=PERIOD_S, onsets_s=onsets_s[:2])
