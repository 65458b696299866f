"""Whole cycles as one system: ports, what they depend on, what is remembered, clone and reset."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from systems_probe import fed, feedthrough, inputs, output, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, estimation, open_loop
from massprop_drake.systems import CycleEstimator

N, FLOATER_JETS = 44, 8
LEAK_S = 7.0
SENSORS = dict.fromkeys(("gyro", "acc2", "acc1", "acc3"), 3)
TEN = {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
REPORTS = {"impulses": 8, "rotation_report": 28, "mass_report": 11}


@pytest.fixture(scope="module")
def leaking() -> Scenario:
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
def floating() -> Scenario:
    """A vehicle whose pose a camera follows."""
    return load_scenario("air_bearing_pulses", ["duration_s=3"])


@pytest.fixture(scope="module")
def leaked(leaking: Scenario) -> Run:
    return simulate(leaking)


@pytest.fixture(scope="module")
def floated(floating: Scenario) -> Run:
    return simulate(floating)


def system(scenario: Scenario) -> CycleEstimator:
    dut: Any = estimation.build(scenario).GetSubsystemByName("estimator")
    return dut


def judged(jets: int) -> dict[str, int]:
    """Ports that a detector by hypotheses adds."""
    sizes = {"reconfiguration": 7 + jets, "closed": jets, "held_closed": jets, "detector_report": 14 + 4 * jets}
    return {**sizes, "hypothesis_report": 24 + 12 * jets, "fault_probability": jets + 2}


# --------------------------------------------------------------------------------------------- ports


def test_topology(leaking: Scenario) -> None:
    dut = system(leaking)
    assert inputs(dut) == {**SENSORS, "jet_commands": N, "outside_wrench": 6, "record_time": 1, "command": N}
    assert outputs(dut) == {"predicted": 10, **TEN, **REPORTS, "joint_report": 3, **judged(N)}
    depends = feedthrough(dut)
    assert depends.pop("predicted") == depends.pop("held_closed") == set()
    assert all(on == set(inputs(dut)) for on in depends.values())


def test_topology_without_a_detector() -> None:
    dut = system(load_scenario("orbiter_maneuver", ["detector={kind: off}"]))
    assert outputs(dut) == {"predicted": 10, **TEN, **REPORTS, "joint_report": 3}


def test_topology_with_a_camera(floating: Scenario) -> None:
    dut, jets = system(floating), FLOATER_JETS
    assert inputs(dut) == {"mocap": 7, "jet_commands": jets, "outside_wrench": 6, "record_time": 1, "command": jets}
    assert outputs(dut) == {"predicted": 10, **TEN, **REPORTS, "pose_report": 24 + 2 * jets, **judged(jets)}


@pytest.mark.parametrize("name", ["leaking", "floating"])
def test_ports_of_the_diagram_are_those_of_the_system(name: str, request: pytest.FixtureRequest) -> None:
    scenario = request.getfixturevalue(name)
    diagram, dut = estimation.build(scenario), system(scenario)
    assert inputs(diagram) == inputs(dut)
    assert outputs(diagram) == {port: size for port, size in outputs(dut).items() if port != "predicted"}


def test_a_sensor_that_is_not_connected_reads_nothing(floating: Scenario) -> None:
    dut = system(floating)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("jet_commands").FixValue(context, np.zeros(FLOATER_JETS))
    np.testing.assert_allclose(output(dut, context, "estimate")[9], 1.0 / 23.09)


def test_the_first_sample_says_nothing(leaking: Scenario, leaked: Run) -> None:
    dut = system(leaking)
    context = fed(dut, leaked, 0, tuple(SENSORS))
    np.testing.assert_array_equal(output(dut, context, "closed"), np.zeros(N))
    np.testing.assert_array_equal(output(dut, context, "reconfiguration"), np.zeros(7 + N))
    np.testing.assert_array_equal(output(dut, context, "fault_probability"), [*np.zeros(N), 1.0, 0.0])


# -------------------------------------------------------------------------------------------- cycles


def test_a_leak_is_declared_and_its_jet_put_out_of_use(leaking: Scenario, leaked: Run) -> None:
    (said,) = leaked.results.detections
    jet = leaking.vehicle_data.jet_index("L4D")
    assert (said.kind, said.jet, said.jets, said.isolated_to) == ("jet_on", "L4D", ("L4D",), "jet")
    assert said.onset_s == pytest.approx(LEAK_S, abs=0.2)
    assert said.magnitude is not None
    assert said.magnitude_std is not None
    assert abs(said.magnitude - 10.0) < 4.5 * said.magnitude_std
    after = leaked.time_s > said.time_s
    assert (leaked["out_of_use"][after, jet] == 1.0).all()
    assert (np.abs(leaked["known_force"][after, jet] - 10.0) < 1.5).all()  # at first it is known to half a pound
    assert not np.delete(leaked["known_force"], jet, axis=1).any()


# -------------------------------------------------------------------------------------- in a diagram


def _flying(scenario: Scenario) -> tuple[Any, Simulator]:
    diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario)
    simulator = Simulator(diagram)
    simulator.Initialize()
    return diagram, simulator


@pytest.mark.parametrize(("name", "flown"), [("leaking", "leaked"), ("floating", "floated")])
def test_a_cloned_and_a_reset_context_repeat_the_run(name: str, flown: str, request: pytest.FixtureRequest) -> None:
    """Cloned while hypotheses are followed, where they are."""
    run: Run = request.getfixturevalue(flown)
    diagram, simulator = _flying(request.getfixturevalue(name))
    end = len(run.time_s) - 3
    followed = np.flatnonzero(run["racing"][:, 0] > 0.0)
    middle = int(followed[len(followed) // 2]) if followed.size else end // 2

    def same(context: Any) -> None:
        np.testing.assert_array_equal(diagram.GetOutputPort("estimate").Eval(context), run["estimate"][end])
        probability = diagram.GetOutputPort("fault_probability").Eval(context)
        np.testing.assert_array_equal(probability[:-2], run["fault_probability"][end])

    simulator.AdvanceTo(run.time_s[middle] + 0.01)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(run.time_s[end])
    same(simulator.get_context())
    other = Simulator(diagram, clone)
    other.Initialize()
    other.AdvanceTo(run.time_s[end])
    same(other.get_context())
    simulator.reset_context(diagram.CreateDefaultContext())
    simulator.Initialize()
    simulator.AdvanceTo(run.time_s[end])
    same(simulator.get_context())


@pytest.mark.parametrize(("name", "flown"), [("leaking", "leaked"), ("floating", "floated")])
def test_what_is_logged_at_a_sample_is_what_the_next_one_begins_with(
    name: str, flown: str, request: pytest.FixtureRequest
) -> None:
    run: Run = request.getfixturevalue(flown)
    diagram, simulator = _flying(request.getfixturevalue(name))
    dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("estimator")
    for row in (7, 20, 31):
        simulator.AdvanceTo(run.time_s[row] - 0.01)  # after the update at the sample before
        context = dut.GetMyContextFromRoot(simulator.get_context())
        np.testing.assert_array_equal(output(dut, context, "predicted"), run["estimate"][row - 1])


def test_outputs_at_a_sample_are_the_same_before_and_after_its_update(leaking: Scenario, leaked: Run) -> None:
    """Drake updates abstract state before the discrete state of others at the same instant."""
    diagram, simulator = _flying(leaking)
    (said,) = leaked.results.detections
    row = int(np.searchsorted(leaked.time_s, said.time_s - 1e-9))
    simulator.AdvanceTo(leaked.time_s[row])
    dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("estimator")
    context = dut.GetMyContextFromRoot(simulator.get_context())
    names = ("predicted", "estimate", "reconfiguration", "detector_report", "hypothesis_report")
    before = {name: output(dut, context, name).copy() for name in names}
    assert before["reconfiguration"][0] == 1.0
    simulator.AdvancePendingEvents()
    for name in names:
        np.testing.assert_array_equal(output(dut, context, name), before[name], err_msg=name)


def test_a_clone_shares_what_is_never_changed(leaking: Scenario) -> None:
    context = system(leaking).CreateDefaultContext()
    memory = context.get_abstract_state(0).get_value()
    assert context.Clone().get_abstract_state(0).get_value() is memory
    assert copy.deepcopy(memory) is memory
