"""A diagram of one's own gives a run like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from massprop_drake import InputError, Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation, vehicle
from massprop_drake.display.page import report_html
from massprop_drake.maths.vehicle.rigid_body import N_STATE


class Doubled(LeafSystem):
    """A system of one's own."""

    def __init__(self) -> None:
        super().__init__()
        self.set_name("mine")
        self._state = self.DeclareVectorInputPort("body_state", N_STATE)
        self.DeclareVectorOutputPort("doubled", 2, self._calc)

    def _calc(self, context: Any, output: Any) -> None:
        output.SetFromVector(2.0 * self._state.Eval(context)[:2])


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("sample_maneuver", ["duration_s=4"])


@pytest.fixture(scope="module")
def bundled(scenario: Scenario) -> Run:
    return simulate(scenario)


def wired(scenario: Scenario) -> tuple[DiagramBuilder, LeafSystem]:
    """The closed loop, with a system beside it."""
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("loop", closed_loop.build(scenario))
    mine = builder.AddSystem(Doubled())
    builder.Connect(loop.GetOutputPort("body_state"), mine.GetInputPort("body_state"))
    return builder, mine


def by_hand(scenario: Scenario, *, estimating: bool) -> DiagramBuilder:
    """The parts, each by itself in a builder."""
    parts = DiagramBuilder()
    pilot = parts.AddNamedSystem("autopilot", autopilot.build(scenario))
    body = parts.AddNamedSystem("vehicle", vehicle.build(scenario))
    for name in ("command", "held_command"):
        parts.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
    parts.Connect(body.GetOutputPort("gyro"), pilot.GetInputPort("gyro"))
    if not estimating:
        return parts
    estimators = parts.AddNamedSystem("estimation", estimation.build(scenario))
    parts.Connect(pilot.GetOutputPort("held_command"), estimators.GetInputPort("jet_commands"))
    for name in scenario.vehicle_data.sensor_names():
        if estimators.HasInputPort(name):
            parts.Connect(body.GetOutputPort(name), estimators.GetInputPort(name))
    if estimators.HasOutputPort("reconfiguration"):
        parts.Connect(estimators.GetOutputPort("reconfiguration"), pilot.GetInputPort("reconfiguration"))
    return parts


def assert_same(one: Run, other: Run) -> None:
    for name, values in other.signals.items():
        np.testing.assert_array_equal(one[name], values, err_msg=name)
    assert one.results.covariance.tobytes() == other.results.covariance.tobytes()
    assert one.state == other.state


def test_it_gives_the_same_bits_with_its_own_signals_beside(scenario: Scenario, bundled: Run, tmp_path: Path) -> None:
    builder, mine = wired(scenario)
    run = simulate(scenario, diagram=builder, log=[mine.GetOutputPort("doubled")])
    assert_same(run, bundled)
    assert run["mine.doubled"].shape == (run.time_s.size, 2)
    assert (run.units["mine.doubled"], run.components["mine.doubled"]) == ("-", ("0", "1"))
    again = Run.load(run.save(tmp_path / "run", pictures=False, report=False))
    np.testing.assert_array_equal(again["mine.doubled"], run["mine.doubled"])
    assert "What was learned" in report_html(again)


def test_a_diagram_that_is_built_is_run(scenario: Scenario, bundled: Run) -> None:
    assert_same(simulate(scenario, diagram=closed_loop.build(scenario)), bundled)


def test_parts_that_are_wired_by_hand_are_found(scenario: Scenario, bundled: Run) -> None:
    assert_same(simulate(scenario, diagram=by_hand(scenario, estimating=True)), bundled)


def test_what_a_run_keeps_must_be_there(scenario: Scenario) -> None:
    with pytest.raises(InputError, match="no output port 'impulses', which a run keeps"):
        simulate(scenario, diagram=by_hand(scenario, estimating=False))


def test_a_log_needs_a_builder(scenario: Scenario) -> None:
    _, mine = wired(scenario)
    with pytest.raises(InputError, match="log takes output ports"):
        simulate(scenario, log=[mine.GetOutputPort("doubled")])
