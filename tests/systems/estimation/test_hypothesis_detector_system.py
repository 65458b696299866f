"""The detector by hypotheses as a system: ports, what it remembers, clone and reset."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from systems_probe import feedthrough, inputs, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, estimation
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.systems.estimation.hypothesis_detector import HypothesisDetector
from massprop_drake.systems.layouts import HYPOTHESIS_REPORT

N = 44
LEAK_S = 7.0


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """A leak in a flight whose filter starts near the truth and soon settles."""
    return load_scenario(
        "leak_named",
        [
            "duration_s=9",
            "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
            "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
            f"failures=[{{kind: leak, jet: L4D, start_s: {LEAK_S}, force: 10}}]",
        ],
    )


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario)


def system(scenario: Scenario) -> HypothesisDetector:
    dut: Any = estimation.build(scenario).GetSubsystemByName("hypothesis_detector")
    return dut


def test_topology(scenario: Scenario) -> None:
    dut = system(scenario)
    assert inputs(dut) == {"evidence": 0}
    told = {"reconfiguration": 7 + N, "closed": N, "report": 14 + 4 * N, "hypothesis_report": 21 + 12 * N}
    told["fault_probability"] = N + 2
    assert outputs(dut) == {"replacement": 0, "published": 0, **told, "held_closed": N}
    depends = feedthrough(dut)
    assert depends.pop("held_closed") == set()
    assert all(on == {"evidence"} for on in depends.values())


def test_ports_of_the_diagram(scenario: Scenario) -> None:
    dut = estimation.build(scenario)
    assert not {"replacement", "published"} & set(inputs(dut))
    sizes = {"reconfiguration": 7 + N, "closed": N, "held_closed": N, "detector_report": 14 + 4 * N}
    sizes |= {"hypothesis_report": 21 + 12 * N, "fault_probability": N + 2}
    assert sizes.items() <= outputs(dut).items()


def test_a_leak_is_declared_and_its_jet_put_out_of_use(scenario: Scenario, flown: Run) -> None:
    (said,) = flown.results.detections
    jet = scenario.vehicle_data.jet_index("L4D")
    assert (said.kind, said.jet, said.jets, said.isolated_to) == ("jet_on", "L4D", ("L4D",), "jet")
    assert said.onset_s == pytest.approx(LEAK_S, abs=0.2)
    assert said.magnitude is not None
    assert said.magnitude_std is not None
    assert abs(said.magnitude - 10.0) < 4.5 * said.magnitude_std
    after = flown.time_s > said.time_s
    assert (flown["out_of_use"][after, jet] == 1.0).all()
    assert (np.abs(flown["known_force"][after, jet] - 10.0) < 1.5).all()  # at first it is known to half a pound
    assert not np.delete(flown["known_force"], jet, axis=1).any()


def _simulator(scenario: Scenario) -> tuple[Any, Simulator]:
    diagram = closed_loop.build(scenario)
    simulator = Simulator(diagram)
    simulator.Initialize()
    return diagram, simulator


def test_a_cloned_and_a_reset_context_repeat_the_run(scenario: Scenario, flown: Run) -> None:
    """Cloned in the middle of a race; what is logged at a sample is what was used."""
    diagram, simulator = _simulator(scenario)
    end = len(flown.time_s) - 3
    racing = np.flatnonzero(flown["racing"][:, 0])
    middle = int(racing[len(racing) // 2])

    def same(context: Any) -> None:
        np.testing.assert_array_equal(diagram.GetOutputPort("estimate").Eval(context), flown["estimate"][end])
        row = HYPOTHESIS_REPORT.sized(jets=N).read(diagram.GetOutputPort("hypothesis_report").Eval(context))
        np.testing.assert_array_equal(row.verdict, flown["verdict"][end])

    simulator.AdvanceTo(flown.time_s[middle] + 0.01)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(flown.time_s[end])
    same(simulator.get_context())
    other = Simulator(diagram, clone)
    other.Initialize()
    other.AdvanceTo(flown.time_s[end])
    same(other.get_context())
    simulator.reset_context(diagram.CreateDefaultContext())
    simulator.Initialize()
    simulator.AdvanceTo(flown.time_s[end])
    same(simulator.get_context())


def test_outputs_at_a_sample_are_the_same_before_and_after_its_update(scenario: Scenario, flown: Run) -> None:
    """Drake updates abstract state before the discrete state of others at the same instant."""
    diagram, simulator = _simulator(scenario)
    (said,) = flown.results.detections
    row = int(np.searchsorted(flown.time_s, said.time_s - 1e-9))
    simulator.AdvanceTo(flown.time_s[row])
    dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("hypothesis_detector")
    context = dut.GetMyContextFromRoot(simulator.get_context())
    names = ("reconfiguration", "report", "hypothesis_report")
    before = {name: dut.GetOutputPort(name).Eval(context).copy() for name in names}
    assert before["reconfiguration"][0] == 1.0
    simulator.AdvancePendingEvents()
    for name in names:
        np.testing.assert_array_equal(dut.GetOutputPort(name).Eval(context), before[name], err_msg=name)


def test_the_filter_goes_on_from_the_likeliest_hypothesis_whose_estimates_are_published(
    scenario: Scenario, flown: Run
) -> None:
    """From the sample on at which another becomes the likeliest."""
    diagram, simulator = _simulator(scenario)
    parts: Any = diagram.GetSubsystemByName("estimation")
    detector, estimator = (parts.GetSubsystemByName(name) for name in ("hypothesis_detector", "joint_estimator"))
    replaced = 0
    for row in np.flatnonzero(flown["hypotheses"][:, 0] > 1.0):
        simulator.AdvanceTo(flown.time_s[row])
        told, own = (part.GetMyContextFromRoot(simulator.get_context()) for part in (detector, estimator))
        state = detector.GetOutputPort("replacement").Eval(told)
        if state == ():
            continue
        after = estimator.GetOutputPort("evidence").Eval(own).after
        np.testing.assert_array_equal(flown["estimate"][row], state.mean[:10])  # exact thrusts: no scale
        replaced += bool((state.mean[:10] != after.mean[:10]).any() and (state.slot_jet >= 0.0).any())
        simulator.AdvanceTo(flown.time_s[row] + 0.01)
        np.testing.assert_array_equal(estimator.GetOutputPort("predicted").Eval(own), state.mean[:10])
    assert replaced > 0


def test_a_clone_shares_what_is_never_changed(scenario: Scenario) -> None:
    dut = system(scenario)
    context = dut.CreateDefaultContext()
    memory = context.get_abstract_state(0).get_value()
    assert context.Clone().get_abstract_state(0).get_value() is memory
    assert copy.deepcopy(memory) is memory


def test_the_first_sample_says_nothing(scenario: Scenario) -> None:
    dut = system(scenario)
    context = dut.CreateDefaultContext()
    joint: Any = estimation.build(scenario).GetSubsystemByName("joint_estimator")
    of_joint = joint.CreateDefaultContext()
    for name in ("gyro", "acc1", "acc2", "acc3"):
        joint.GetInputPort(name).FixValue(of_joint, np.zeros(3))
    joint.GetInputPort("jet_commands").FixValue(of_joint, np.zeros(N))
    evidence = joint.GetOutputPort("evidence").Eval(of_joint)
    assert isinstance(evidence, JointEvidence)
    dut.GetInputPort("evidence").FixValue(context, Value[object](evidence))
    first = dut.GetOutputPort("report").Eval(context).copy()
    assert dut.GetOutputPort("replacement").Eval(context) == dut.GetOutputPort("published").Eval(context) == ()
    np.testing.assert_array_equal(dut.GetOutputPort("report").Eval(context), first)
    np.testing.assert_array_equal(dut.GetOutputPort("closed").Eval(context), np.zeros(N))
