"""The estimator in a fixed frame as a system: ports, replacement, clone and reset; trackers beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from systems_probe import fed, feedthrough, inputs, output, outputs

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import estimation, open_loop
from massprop_drake.maths.estimation.filters.pose import PoseEvidence
from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION
from massprop_drake.maths.vehicle.tracking import PoseModel
from massprop_drake.systems.estimation.pose_estimator import PoseEstimator
from massprop_drake.systems.vehicle.trackers import PoseTracker, VelocityTracker

JETS = 8
SEEN = ("mocap", "command")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("air_bearing_pulses", ["duration_s=3"])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario)


def system(scenario: Scenario) -> PoseEstimator:
    dut: Any = estimation.build(scenario).GetSubsystemByName("pose_estimator")
    return dut


def _connected(dut: PoseEstimator, run: Run, row: int) -> Any:
    return fed(dut, run, row, SEEN)


def _advanced(dut: PoseEstimator, context: Any, run: Run, row: int) -> None:
    """The update at a row, and the readings of the next one."""
    dut._update(context, context)
    fed(dut, run, row + 1, SEEN, context)


def test_topology(scenario: Scenario) -> None:
    dut = system(scenario)
    told = {"jet_commands": JETS, "record_time": 1, "command": JETS, "outside_wrench": 6}
    assert inputs(dut) == {"mocap": 7, **told, "replacement": 0, "published": 0}
    ten = {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
    reports = {"rotation_report": 28, "mass_report": 11, "pose_report": 24 + 2 * JETS}
    assert outputs(dut) == {"predicted": 10, "evidence": 0, **ten, **reports}
    depends = feedthrough(dut)
    assert depends["predicted"] == set()
    assert depends["evidence"] == set(inputs(dut)) - {"replacement", "published"}
    for name in (*ten, *reports):
        assert depends[name] == set(inputs(dut)), name


def test_a_replacement_is_what_is_reported_and_what_the_next_cycle_begins_with(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = _connected(dut, flown, 0)
    evidence = output(dut, context, "evidence")
    assert isinstance(evidence, PoseEvidence)
    own = output(dut, context, "estimate")
    bank = evidence.tried.bank
    center = dut._params.pose.parts.center
    mean = bank.mean.copy()
    mean[:, center.start] += 1e-3
    other = evidence.tried._replace(bank=bank._replace(mean=mean), elsewhere=())
    dut.GetInputPort("replacement").FixValue(context, Value[object](other))
    expected = own + 1e-3 * np.eye(10)[6]
    np.testing.assert_allclose(output(dut, context, "estimate"), expected, rtol=1e-12)
    dut.GetInputPort("replacement").FixValue(context, Value[object](()))
    np.testing.assert_array_equal(output(dut, context, "estimate"), own)
    dut.GetInputPort("replacement").FixValue(context, Value[object](other))
    _advanced(dut, context, flown, 0)
    np.testing.assert_allclose(output(dut, context, "predicted"), expected, rtol=1e-12)


def test_what_is_published_is_what_is_reported_alone(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = _connected(dut, flown, 0)
    tried = output(dut, context, "evidence").tried
    own = output(dut, context, "estimate")
    mean = tried.bank.mean.copy()
    mean[:, dut._params.pose.parts.center.start] += 1e-3
    other = tried._replace(bank=tried.bank._replace(mean=mean), elsewhere=())
    dut.GetInputPort("published").FixValue(context, Value[object](other))
    np.testing.assert_allclose(output(dut, context, "estimate"), own + 1e-3 * np.eye(10)[6], rtol=1e-12)
    _advanced(dut, context, flown, 0)
    np.testing.assert_array_equal(output(dut, context, "predicted"), own)


def test_a_sensor_that_is_not_connected_reads_nothing(scenario: Scenario, flown: Run) -> None:
    dut = system(scenario)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("jet_commands").FixValue(context, np.zeros(JETS))
    assert not output(dut, context, "evidence").tested
    np.testing.assert_allclose(output(dut, context, "estimate")[9], 1.0 / 23.09)


def test_what_is_logged_at_a_sample_is_what_was_used_at_it(scenario: Scenario, flown: Run) -> None:
    diagram = open_loop.build(scenario)
    simulator = Simulator(diagram)
    simulator.Initialize()
    for row in (7, 20, 31):
        simulator.AdvanceTo(flown.time_s[row] - 0.01)  # after the update at the sample before
        dut: Any = diagram.GetSubsystemByName("estimation").GetSubsystemByName("pose_estimator")
        context = dut.GetMyContextFromRoot(simulator.get_context())
        np.testing.assert_array_equal(output(dut, context, "predicted"), flown["estimate"][row - 1])
        simulator.AdvanceTo(flown.time_s[row])
        context = dut.GetMyContextFromRoot(simulator.get_context())
        np.testing.assert_array_equal(dut.GetInputPort("mocap").Eval(context), flown["mocap"][row])
        np.testing.assert_array_equal(output(dut, context, "estimate"), flown["estimate"][row])


def test_a_cloned_and_a_reset_context_repeat_the_run(scenario: Scenario, flown: Run) -> None:
    diagram = open_loop.build(scenario)
    port = diagram.GetOutputPort("estimate")
    simulator = Simulator(diagram)
    simulator.Initialize()
    middle, end = 15, 35
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


# ------------------------------------------------------------------------------------------ trackers


@pytest.mark.parametrize("kind", ["pose", "velocity"])
def test_a_tracker_reads_the_true_body_from_its_structure(kind: str) -> None:
    model = PoseModel(np.array([0.2, 0.0, 0.0]), 0.01, 0.02, 0.0, 0.0, planar=False)
    pose = PoseTracker("cam", model)
    velocity = VelocityTracker("cam", position=np.array([0.2, 0.0, 0.0]), noise_std=0.1)
    dut: Any = pose if kind == "pose" else velocity
    body = np.zeros(N_STATE)
    body[QUATERNION], body[POSITION] = (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
    structure = np.zeros(9)
    assert inputs(dut) == {"body_state": N_STATE, "structure": 9, "noise": dut.n_noise}
    assert feedthrough(dut)["reading"] == set(inputs(dut))
    context = dut.CreateDefaultContext()
    dut.GetInputPort("body_state").FixValue(context, body)
    dut.GetInputPort("structure").FixValue(context, structure)
    dut.GetInputPort("noise").FixValue(context, np.eye(dut.n_noise)[0])
    expected = [1.21, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0] if kind == "pose" else [0.1, 0.0, 0.0]
    np.testing.assert_allclose(output(dut, context, "reading"), expected, atol=1e-12)
