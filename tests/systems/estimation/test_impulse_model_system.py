"""The impulse model: impulses of the interval that ended, and the steady-combination gate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems_probe import PERIOD_S, feedthrough, give, inputs, output, outputs, sample

from massprop_drake.systems import ImpulseModel

# torque about the vehicle origin and force of two jets
WRENCHES = np.array([[10.0, -20.0, 30.0, 1.0, 2.0, 3.0], [0.0, 5.0, 0.0, -4.0, 0.0, 0.5]])


def made() -> tuple[ImpulseModel, Any]:
    dut = ImpulseModel(wrenches=WRENCHES, time_constants_s=np.zeros(2), period_s=PERIOD_S)
    return dut, dut.CreateDefaultContext()


def test_topology() -> None:
    dut, context = made()
    assert inputs(dut) == {"jet_commands": 2, "known_force": 24, "outside_wrench": 6}
    assert outputs(dut) == {"impulses": 8, "mean_level": 2}
    assert feedthrough(dut) == {"impulses": set(inputs(dut)), "mean_level": {"jet_commands", "outside_wrench"}}
    assert context.get_discrete_state(0).size() == 4


@pytest.mark.parametrize(
    ("before", "now", "usable", "firing"),
    [
        (None, [1.0, 0.0], 0.0, 1.0),  # before the first sample all jets are taken as off
        ([1.0, 0.0], [1.0, 0.0], 1.0, 1.0),  # steady
        ([1.0, 0.0], [0.0, 0.0], 0.0, 0.0),  # tail-off
        ([0.5, 0.0], [0.5, 0.0], 0.0, 1.0),  # a fraction is never steady
        ([1.0, math.nan], [1.0, 0.0], 0.0, 1.0),  # an unknown command costs two samples
        ([1.0, 0.0], [1.0, math.nan], 0.0, 1.0),
    ],
)
def test_impulses_are_wrench_times_the_period_of_samples_that_are_usable_when_steady(
    before: list[float] | None, now: list[float], usable: float, firing: float
) -> None:
    dut, context = made()
    if before is not None:
        sample(dut, context, "impulses", jet_commands=before)
    found = sample(dut, context, "impulses", jet_commands=now)
    assert_allclose(found[:6], np.nan_to_num(now) @ WRENCHES * PERIOD_S, rtol=1e-14, atol=1e-18)
    assert_array_equal(found[6:], [usable, firing])


def test_an_outside_wrench_and_a_known_force_add_over_the_interval() -> None:
    dut, context = made()
    outside = np.array([1.0, 0.0, -2.0, 0.0, 3.0, 0.0])
    give(dut, context, outside_wrench=outside, jet_commands=np.zeros(2))
    assert_allclose(sample(dut, context, "impulses"), [*outside * PERIOD_S, 1.0, 1.0], rtol=1e-14)  # as firing
    known = np.arange(1.0, 7.0)
    give(dut, context, jet_commands=[1.0, 0.0], known_force=[*known, *np.ones(18)])
    expected = (outside + known + WRENCHES[0]) * PERIOD_S
    assert_allclose(output(dut, context, "impulses")[:6], expected, rtol=1e-14)
    assert not output(dut, context, "mean_level")[1:].any()
