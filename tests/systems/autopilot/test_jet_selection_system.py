"""Jet selection as a system: bursts of whole cycles, and when a request is taken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.maths.autopilot.phase_space import Urgency
from massprop_drake.systems.autopilot.jet_selection_system import JetSelection

# Twelve make-believe jets: jet 2 i gives +1 and jet 2 i + 1 gives -1 of the i-th component of torque about
# the origin and force. With mass 1, unit inertia and the center of mass at the origin, a request is met by
# on-times equal to its elements.
N = 12
WRENCHES = np.zeros((N, 6))
for _axis in range(6):
    WRENCHES[2 * _axis, _axis] = 1.0
    WRENCHES[2 * _axis + 1, _axis] = -1.0
UNIT_BODY = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def _dut(*, minimum_s: float = PERIOD_S, selectable: NDArray[np.bool_] | None = None) -> tuple[JetSelection, Any]:
    dut = JetSelection(
        wrenches=WRENCHES,
        mass_flows=np.ones(N),
        minimum_on_times_s=np.full(N, minimum_s),
        selectable=np.ones(N, dtype=bool) if selectable is None else selectable,
        mass_properties=UNIT_BODY,
        period_s=PERIOD_S,
    )
    context = dut.CreateDefaultContext()
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    return dut, context


def _ask(dut: JetSelection, context: Any, change: list[float], urgency: float, limit_s: float = np.inf) -> None:
    dut.GetInputPort("request").FixValue(context, [*change, limit_s, urgency])


def _fly(dut: JetSelection, context: Any, samples: int) -> np.ndarray:
    """The commands of the coming samples under the request as it is, shape (samples, N)."""
    commands = []
    for _ in range(samples):
        commands.append(dut.GetOutputPort("command").Eval(context))
        advance(dut, context)
    return np.array(commands)


def _counts(dut: JetSelection, context: Any) -> list[float]:
    return dut.GetOutputPort("counts").Eval(context).tolist()


def test_topology() -> None:
    dut, context = _dut()
    told = {"estimate": 10, "converged": 1, "reconfiguration": 7 + N, "prescribed": N}
    assert inputs(dut) == {"request": 8, **told}
    assert outputs(dut) == {"command": N, "held_command": N, "delivered": 3, "counts": 4, "out_of_use": N}
    # held_command feeds the continuous plant and the estimators, delivered the controller: loops that
    # only their being state breaks
    assert feedthrough(dut) == {
        "command": {"request", "estimate", "converged", "reconfiguration", "prescribed"},
        "held_command": set(),
        "delivered": set(),
        "counts": set(),
        "out_of_use": set(),
    }
    assert context.num_discrete_state_groups() == 6


def test_without_a_request_no_jet_fires() -> None:
    dut, context = _dut()
    assert not _fly(dut, context, 3).any()
    assert _counts(dut, context) == [0.0, 0.0, 0.0, 1.0]


def test_on_times_are_fired_as_whole_cycles_from_the_sample_of_the_request_on() -> None:
    # +x torque for 0.25 s: 3.1 cycles, so 3; -z force for 0.13 s: 1.6 cycles, so 2
    dut, context = _dut()
    _ask(dut, context, [0.25, 0.0, 0.0, 0.0, 0.0, -0.13], Urgency.WHEN_IDLE)
    first = dut.GetOutputPort("command").Eval(context)
    assert np.flatnonzero(first).tolist() == [0, 11]
    advance(dut, context)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    commands = _fly(dut, context, 4)
    assert commands[:, 0].tolist() == [1.0, 1.0, 0.0, 0.0]
    assert commands[:, 11].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not np.delete(commands, [0, 11], axis=1).any()


def test_the_held_command_is_the_command_of_the_sample_before() -> None:
    dut, context = _dut()
    _ask(dut, context, [0.16, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    held = dut.GetOutputPort("held_command")
    assert not held.Eval(context).any()
    command = dut.GetOutputPort("command").Eval(context)
    advance(dut, context)
    np.testing.assert_array_equal(held.Eval(context), command)


def test_a_request_waits_for_the_running_burst_unless_it_is_urgent() -> None:
    dut, context = _dut()
    _ask(dut, context, [0.16, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    _fly(dut, context, 1)
    _ask(dut, context, [0.0, 0.08, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    commands = _fly(dut, context, 2)
    assert np.flatnonzero(commands[0]).tolist() == [0]  # the second cycle of the first request
    assert np.flatnonzero(commands[1]).tolist() == [2]  # then the second request
    assert _counts(dut, context)[0] == 2.0

    _ask(dut, context, [0.16, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    _fly(dut, context, 1)
    _ask(dut, context, [0.0, 0.0, 0.08, 0.0, 0.0, 0.0], Urgency.AT_ONCE)
    assert np.flatnonzero(_fly(dut, context, 1)[0]).tolist() == [4]


def test_an_urgent_request_of_nothing_ends_the_burst() -> None:
    dut, context = _dut()
    _ask(dut, context, [0.0, 0.0, 0.0, 0.4, 0.0, 0.0], Urgency.AT_ONCE, limit_s=2.0)
    _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.AT_ONCE)
    assert not _fly(dut, context, 1).any()
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    assert not _fly(dut, context, 1).any()


@pytest.mark.parametrize(("on_time_s", "cycles"), [(0.039, 0), (0.041, 1), (0.119, 1), (0.121, 2)])
def test_on_times_are_rounded_to_the_nearest_cycle(on_time_s: float, cycles: int) -> None:
    dut, context = _dut()
    _ask(dut, context, [0.0, -on_time_s, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    fired = _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    fired = np.vstack([fired, _fly(dut, context, 4)])
    assert fired.sum() == cycles
    assert fired[:, 3].sum() == cycles


def test_a_short_on_time_is_raised_to_the_jets_minimum() -> None:
    dut, context = _dut(minimum_s=0.2)  # 2.5 cycles, so 3
    _ask(dut, context, [0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    fired = _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    assert np.vstack([fired, _fly(dut, context, 4)])[:, 0].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0]


def test_a_request_too_small_for_a_cycle_is_solved_once_and_again_only_when_it_has_grown() -> None:
    dut, context = _dut()
    _ask(dut, context, [0.03, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert not _fly(dut, context, 5).any()
    assert _counts(dut, context)[0] == 1.0
    # half a cycle is 0.04 s: a change of 0.01 rad/s is needed
    _ask(dut, context, [0.0399, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert not _fly(dut, context, 1).any()
    assert _counts(dut, context)[0] == 1.0
    _ask(dut, context, [0.0401, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert np.flatnonzero(_fly(dut, context, 1)[0]).tolist() == [0]
    assert _counts(dut, context)[0] == 2.0
    # the memory of the refusal is gone with the firing
    _ask(dut, context, [0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert np.flatnonzero(_fly(dut, context, 1)[0]).tolist() == [0]


def test_delivered_is_the_velocity_change_of_the_command_that_is_held() -> None:
    # jets 6 and 11 push +x and -z with 1 each for one cycle, mass 1
    dut, context = _dut()
    _ask(dut, context, [0.0, 0.0, 0.0, 0.16, 0.0, -0.08], Urgency.AT_ONCE, limit_s=2.0)
    assert not dut.GetOutputPort("delivered").Eval(context).any()
    advance(dut, context)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    np.testing.assert_allclose(dut.GetOutputPort("delivered").Eval(context), [0.08, 0.0, -0.08], rtol=1e-15)
    advance(dut, context)
    np.testing.assert_allclose(dut.GetOutputPort("delivered").Eval(context), [0.08, 0.0, 0.0], rtol=1e-15)
    advance(dut, context)
    assert not dut.GetOutputPort("delivered").Eval(context).any()


def test_delivered_is_reckoned_with_the_mass_in_use() -> None:
    # by the estimate the body has half the mass: one cycle gives twice the velocity
    dut, context = _dut()
    estimate = UNIT_BODY.copy()
    estimate[9] = 2.0
    dut.GetInputPort("estimate").FixValue(context, estimate)
    for converged, delivered in ((0.0, 0.08), (1.0, 0.16)):
        dut.GetInputPort("converged").FixValue(context, [converged])
        _ask(dut, context, [0.0, 0.0, 0.0, 0.8, 0.0, 0.0], Urgency.AT_ONCE, limit_s=2.0)
        advance(dut, context)
        np.testing.assert_allclose(dut.GetOutputPort("delivered").Eval(context), [delivered, 0.0, 0.0], rtol=1e-15)


def test_jets_that_may_not_be_selected_never_fire() -> None:
    selectable = np.ones(N, dtype=bool)
    selectable[0] = False  # nothing else turns about +x
    dut, context = _dut(selectable=selectable)
    _ask(dut, context, [0.16, 0.08, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert np.flatnonzero(_fly(dut, context, 1)[0]).tolist() == [2]
    assert _counts(dut, context)[2] == 1.0  # met by the closest reachable


def test_a_translation_beyond_its_time_is_met_in_part_and_counted() -> None:
    # 0.8 ft/s in at most 0.4 s at 1 ft/s^2: half of it
    dut, context = _dut()
    _ask(dut, context, [0.0, 0.0, 0.0, 0.0, 0.8, 0.0], Urgency.AT_ONCE, limit_s=0.4)
    commands = _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    assert np.vstack([commands, _fly(dut, context, 6)])[:, 8].sum() == 5.0
    counts = _counts(dut, context)
    assert counts[1:3] == [1.0, 0.0]
    np.testing.assert_allclose(counts[3], 0.5, rtol=1e-8)  # the program gives up 1e-9 on purpose


def test_estimates_are_used_once_they_have_converged() -> None:
    # by the estimate the body is twice as hard to turn about x, so on-times double
    dut, context = _dut()
    estimate = UNIT_BODY.copy()
    estimate[0] = 0.5
    dut.GetInputPort("estimate").FixValue(context, estimate)
    dut.GetInputPort("converged").FixValue(context, [0.0])
    _ask(dut, context, [0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    commands = _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    assert np.vstack([commands, _fly(dut, context, 3)])[:, 0].sum() == 1.0
    dut.GetInputPort("converged").FixValue(context, [1.0])
    _ask(dut, context, [0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    commands = _fly(dut, context, 1)
    _ask(dut, context, [0.0] * 6, Urgency.NONE)
    assert np.vstack([commands, _fly(dut, context, 3)])[:, 0].sum() == 2.0


def test_estimates_that_have_not_converged_may_be_anything() -> None:
    dut, context = _dut()
    dut.GetInputPort("estimate").FixValue(context, np.full(10, np.nan))
    dut.GetInputPort("converged").FixValue(context, [0.0])
    _ask(dut, context, [0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert np.flatnonzero(_fly(dut, context, 1)[0]).tolist() == [0]


def test_asking_for_the_command_changes_nothing() -> None:
    dut, context = _dut()
    _ask(dut, context, [0.16, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    for _ in range(3):
        dut.GetOutputPort("command").Eval(context)
    assert _counts(dut, context)[0] == 0.0
    assert not dut.GetOutputPort("held_command").Eval(context).any()
    assert _fly(dut, context, 3)[:, 0].tolist() == [1.0, 1.0, 1.0]  # asked again as soon as the burst is over
