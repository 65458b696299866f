"""The joint filter as a system: ports, replacement, clone and reset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from systems_probe import fed, feedthrough, inputs, output, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, estimation
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.systems.estimation.joint_estimator import JointEstimator


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("orbiter_maneuver", ["duration_s=4", "detector={kind: off}"])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario)


def system(scenario: Scenario) -> JointEstimator:
    dut: Any = estimation.build(scenario).GetSubsystemByName("joint_estimator")
    return dut


def test_topology(scenario: Scenario) -> None:
    dut = system(scenario)
    sensors = dict.fromkeys(("gyro", "acc2", "acc1", "acc3"), 3)
    told = {"jet_commands": 44, "outside_wrench": 6, "record_time": 1, "command": 44}
    assert inputs(dut) == {**sensors, **told, "replacement": 0, "published": 0}
    ten = {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
    reports = {"rotation_report": 28, "mass_report": 11, "joint_report": 3}
    assert outputs(dut) == {"predicted": 10, "evidence": 0, **ten, **reports}
    depends = feedthrough(dut)
    assert depends["predicted"] == set()
    assert depends["evidence"] == set(inputs(dut)) - {"replacement", "published"}
    for name in (*ten, *reports):
        assert depends[name] == set(inputs(dut)), name


def test_ports_of_the_diagram(scenario: Scenario) -> None:
    dut = estimation.build(scenario)
    told = {"jet_commands": 44, "outside_wrench": 6, "record_time": 1, "command": 44, "replacement": 0, "published": 0}
    assert inputs(dut) == {**told, **dict.fromkeys(("gyro", "acc1", "acc2", "acc3"), 3)}
    ten = {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
    reports = {"impulses": 8, "rotation_report": 28, "mass_report": 11, "joint_report": 3, "evidence": 0}
    assert outputs(dut) == {**ten, **reports}


def _connected(dut: JointEstimator, run: Run, row: int) -> Any:
    return fed(dut, run, row, ("gyro", "acc1", "acc2", "acc3"))


def _go_on(dut: JointEstimator, context: Any) -> None:
    """The update at this sample, and the time of the next."""
    dut._update(context, context.get_mutable_state())
    context.SetTime(context.get_time() + 0.08)


def test_a_replacement_is_what_is_reported_and_what_the_next_cycle_begins_with(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = _connected(dut, flown, 0)
    evidence = output(dut, context, "evidence")
    assert isinstance(evidence, JointEvidence)
    own = output(dut, context, "estimate")
    other = evidence.after._replace(mean=evidence.after.mean + 1e-9)
    dut.GetInputPort("replacement").FixValue(context, Value[object](other))
    np.testing.assert_allclose(output(dut, context, "estimate"), own + 1e-9, rtol=1e-15)
    assert output(dut, context, "evidence").after is evidence.after
    _go_on(dut, context)
    np.testing.assert_array_equal(output(dut, context, "predicted"), output(dut, context, "predicted"))
    np.testing.assert_allclose(output(dut, context, "predicted"), own + 1e-9, rtol=1e-15)


def test_what_is_published_is_reported_and_the_filter_goes_on_from_its_own(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = _connected(dut, flown, 0)
    own, evidence = output(dut, context, "estimate"), output(dut, context, "evidence")
    other = evidence.after._replace(mean=evidence.after.mean + 1e-9, root=2.0 * evidence.after.root)
    deviation = output(dut, context, "standard_deviation")
    dut.GetInputPort("published").FixValue(context, Value[object](other))
    np.testing.assert_allclose(output(dut, context, "estimate"), own + 1e-9, rtol=1e-15)
    np.testing.assert_allclose(output(dut, context, "standard_deviation"), 2.0 * deviation)
    np.testing.assert_allclose(output(dut, context, "rotation_report")[:9], own[:9] + 1e-9, rtol=1e-15)
    _go_on(dut, context)
    np.testing.assert_array_equal(output(dut, context, "predicted"), own)


def test_nothing_as_a_replacement_is_none(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = _connected(dut, flown, 0)
    own = output(dut, context, "covariance")
    dut.GetInputPort("replacement").FixValue(context, Value[object](()))
    np.testing.assert_array_equal(output(dut, context, "covariance"), own)


def test_what_is_logged_at_a_sample_is_what_the_next_one_begins_with(scenario: Scenario, flown: Run) -> None:
    diagram = closed_loop.build(scenario)
    simulator = Simulator(diagram)
    simulator.Initialize()
    for row in (7, 20, 31):
        simulator.AdvanceTo(flown.time_s[row] - 0.01)  # after the update at the sample before
        dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("joint_estimator")
        context = dut.GetMyContextFromRoot(simulator.get_context())
        np.testing.assert_array_equal(output(dut, context, "predicted"), flown["estimate"][row - 1])


def test_a_cloned_and_a_reset_context_repeat_the_run(scenario: Scenario, flown: Run) -> None:
    diagram = closed_loop.build(scenario)
    port = diagram.GetOutputPort("estimate")
    simulator = Simulator(diagram)
    simulator.Initialize()
    middle, end = 25, 45
    simulator.AdvanceTo(flown.time_s[middle] + 0.01)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(flown.time_s[end])
    np.testing.assert_array_equal(port.Eval(simulator.get_context()), flown["estimate"][end])
    other = Simulator(diagram, clone)
    other.Initialize()
    other.AdvanceTo(flown.time_s[end])
    np.testing.assert_array_equal(port.Eval(other.get_context()), flown["estimate"][end])
    simulator.reset_context(diagram.CreateDefaultContext())
    simulator.Initialize()
    simulator.AdvanceTo(flown.time_s[end])
    np.testing.assert_array_equal(port.Eval(simulator.get_context()), flown["estimate"][end])
