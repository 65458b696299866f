"""Whole cycles as one system: ports, what they depend on, what is remembered, clone and reset."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator
from systems_probe import LEAKS, feedthrough, give, inputs, leaked, output, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, estimation, open_loop, replay
from massprop_drake.systems import CycleEstimator

FLOATS = load_scenario("air_bearing_pulses", ["duration_s=1"])  # a vehicle whose pose a camera follows
SENSORS = dict.fromkeys(("gyro", "acc2", "acc1", "acc3"), 3)
TEN = {"predicted": 10, "estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
REPORTS = {"impulses": 8, "rotation_report": 28, "mass_report": 11}


def system(scenario: Scenario) -> CycleEstimator:
    dut: Any = estimation.build(scenario).GetSubsystemByName("estimator")
    return dut


def judged(jets: int) -> dict[str, int]:
    """Ports that a detector by hypotheses adds."""
    sizes = {"reconfiguration": 7 + jets, "closed": jets, "held_closed": jets, "detector_report": 14 + 4 * jets}
    return {**sizes, "hypothesis_report": 24 + 12 * jets, "fault_probability": jets + 2}


@pytest.mark.parametrize(
    ("scenario", "jets", "read", "said"),
    [
        (LEAKS, 44, SENSORS, {"joint_report": 3, **judged(44)}),
        (load_scenario("orbiter_maneuver", ["detector={kind: off}"]), 44, SENSORS, {"joint_report": 3}),
        (FLOATS, 8, {"mocap": 7}, {"pose_report": 24 + 2 * 8, **judged(8)}),
    ],
    ids=["leaks", "no detector", "floats"],
)
def test_topology(scenario: Scenario, jets: int, read: dict[str, int], said: dict[str, int]) -> None:
    dut, diagram = system(scenario), estimation.build(scenario)
    assert inputs(dut) == {**read, "jet_commands": jets, "outside_wrench": 6, "record_time": 1, "command": jets}
    assert outputs(dut) == {**TEN, **REPORTS, **said}
    assert inputs(diagram) == inputs(dut)
    assert outputs(diagram) == {port: size for port, size in outputs(dut).items() if port != "predicted"}
    depends = feedthrough(dut)
    assert {name for name, on in depends.items() if not on} == {"predicted", "held_closed"} & set(depends)
    assert all(on in (set(), set(inputs(dut))) for on in depends.values())


def test_the_first_sample_says_nothing_and_a_sensor_that_is_not_connected_reads_nothing() -> None:
    dut = system(FLOATS)
    context = dut.CreateDefaultContext()
    assert_allclose(output(dut, context, "estimate", jet_commands=np.zeros(8))[9], 1.0 / 23.09)
    dut = system(LEAKS)
    context = dut.CreateDefaultContext()
    give(dut, context, jet_commands=np.zeros(44), **dict.fromkeys(SENSORS, np.zeros(3)))
    for name in ("closed", "reconfiguration"):
        assert not output(dut, context, name).any()
    assert_array_equal(output(dut, context, "fault_probability"), [*np.zeros(44), 1.0, 0.0])
    memory = context.get_abstract_state(0).get_value()  # a clone shares what is never changed
    assert context.Clone().get_abstract_state(0).get_value() is memory is copy.deepcopy(memory)


@pytest.mark.parametrize("scenario", [LEAKS, FLOATS], ids=["leaks", "floats"])
def test_a_context_on_its_way_is_that_of_the_run_and_so_is_its_clone(scenario: Scenario) -> None:
    """Drake updates abstract state before the discrete state of others at the same instant."""
    run: Run = leaked() if scenario is LEAKS else simulate(scenario)
    diagram = (open_loop if scenario.jet_schedule else closed_loop).build(scenario)
    simulator, end = Simulator(diagram), len(run.time_s) - 3
    dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("estimator")
    declared = [int(np.searchsorted(run.time_s, said.time_s - 1e-9)) for said in run.results.detections]
    names = ("predicted", "estimate", "reconfiguration", "detector_report", "hypothesis_report")
    for row in (7, *declared):
        simulator.AdvanceTo(run.time_s[row] - 0.01)  # after the update at the sample before
        context = dut.GetMyContextFromRoot(simulator.get_context())
        assert_array_equal(output(dut, context, "predicted"), run["estimate"][row - 1])
        simulator.AdvanceTo(run.time_s[row])
        before = {name: output(dut, context, name).copy() for name in names}
        assert before["reconfiguration"][0] == (row in declared)
        simulator.AdvancePendingEvents()
        for name in names:
            assert_array_equal(output(dut, context, name), before[name], err_msg=name)
    simulator.AdvanceTo(run.time_s[row] + 0.01)
    other = Simulator(diagram, simulator.get_context().Clone())  # hypotheses are followed by now
    for flown in (simulator, other):
        flown.AdvanceTo(run.time_s[end])
        assert_array_equal(diagram.GetOutputPort("estimate").Eval(flown.get_context()), run["estimate"][end])


def test_between_two_samples_of_a_replay_outputs_are_those_of_the_newest() -> None:
    """Whatever is read then was read before: no time has gone by for the filter."""
    run, rows = leaked(), np.arange(4)
    diagram = replay.build(LEAKS)
    simulator, source = Simulator(diagram), diagram.GetSubsystemByName("telemetry_source")
    context = simulator.get_mutable_context()
    given = {name: run[name][rows] for name in SENSORS}
    source.extend(source.GetMyMutableContextFromRoot(context), run.time_s[rows], given, run["command"][rows], None)
    for row in rows[1:]:
        simulator.AdvanceTo(run.time_s[row] + 0.02)
        for name in ("estimate", "standard_deviation"):
            assert_array_equal(diagram.GetOutputPort(name).Eval(context), run[name][row], err_msg=name)
