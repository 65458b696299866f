"""The hand controllers: a timeline played back."""

from __future__ import annotations

import numpy as np
import pytest
from systems_probe import PERIOD_S, feedthrough, inputs, outputs

from massprop_drake.systems.autopilot.hand_controllers import HandControllers, Window


def _at(dut: HandControllers, time_s: float) -> list[float]:
    context = dut.CreateDefaultContext()
    context.SetTime(time_s)
    return dut.GetOutputPort("hand_controllers").Eval(context).tolist()


def test_topology() -> None:
    dut = HandControllers(())
    assert inputs(dut) == {}
    assert outputs(dut) == {"hand_controllers": 6}
    assert feedthrough(dut) == {"hand_controllers": set()}


def test_without_windows_all_controllers_rest_in_detent() -> None:
    assert _at(HandControllers(()), 3.0) == [0.0] * 6


@pytest.mark.parametrize(
    ("time_s", "expected"),
    [
        (0.96, 0.0),
        (np.nextafter(1.0, 0.0), 0.0),
        (1.0, -1.0),  # in force from its start
        (2.0, -1.0),
        (np.nextafter(3.0, 0.0), -1.0),
        (3.0, 0.0),  # and no longer at its end
        (3.04, 0.0),
    ],
)
def test_a_window_is_in_force_from_its_start_until_before_its_end(time_s: float, expected: float) -> None:
    dut = HandControllers((Window(channel=1, sign=-1.0, start_s=1.0, end_s=3.0),))
    assert _at(dut, time_s) == [0.0, expected, 0.0, 0.0, 0.0, 0.0]


def test_windows_of_different_channels_act_together() -> None:
    dut = HandControllers(
        (
            Window(channel=0, sign=1.0, start_s=1.0, end_s=3.0),
            Window(channel=5, sign=-1.0, start_s=2.0, end_s=4.0),
        )
    )
    assert _at(dut, 1.5) == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert _at(dut, 2.5) == [1.0, 0.0, 0.0, 0.0, 0.0, -1.0]
    assert _at(dut, 3.5) == [0.0, 0.0, 0.0, 0.0, 0.0, -1.0]


def test_one_window_may_follow_another_of_its_channel_without_a_gap() -> None:
    dut = HandControllers(
        (
            Window(channel=2, sign=1.0, start_s=1.0, end_s=2.0),
            Window(channel=2, sign=-1.0, start_s=2.0, end_s=3.0),
        )
    )
    assert [_at(dut, time_s)[2] for time_s in (1.0, 1.92, 2.0, 2.96)] == [1.0, 1.0, -1.0, -1.0]


def test_a_window_that_starts_on_a_sample_is_in_force_at_that_sample() -> None:
    # samples lie at k T as the computer multiplies, windows where the decimal point puts them
    for sample in range(1, 700):
        start_s = float(f"{8 * sample / 100:.2f}")
        dut = HandControllers((Window(channel=0, sign=1.0, start_s=start_s, end_s=start_s + 1.0),))
        assert _at(dut, sample * PERIOD_S)[0] == 1.0
        assert _at(dut, (sample - 1) * PERIOD_S)[0] == 0.0
