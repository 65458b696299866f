"""A diagram of one's own gives a run like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from massprop_drake import InputError, Run, Scenario, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation, vehicle
from massprop_drake.display.page import report_html
from massprop_drake.inputs import params
from massprop_drake.maths.vehicle.rigid_body import N_STATE
from massprop_drake.systems import JetSchedule, MassPropertyEstimator


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
    assert "Mass, center of mass, inertia" in report_html(again)


def test_parts_that_are_wired_by_hand_are_found(scenario: Scenario, bundled: Run) -> None:
    assert_same(simulate(scenario, diagram=by_hand(scenario, estimating=True)), bundled)


# ------------------------------------------------------------------- ports of other names, truth by a table


def plant(scenario: Scenario) -> Diagram:
    """Jets, body and sensors that fly a schedule, with ports of names that a run does not know."""
    parts = DiagramBuilder()
    commands, _ = params.scheduled_jet_commands(scenario)
    schedule = parts.AddSystem(JetSchedule(commands, period_s=scenario.vehicle_data.sample_period_s))
    body = parts.AddNamedSystem("body", vehicle.build(scenario))
    for name in ("command", "held_command"):
        parts.Connect(schedule.GetOutputPort(name), body.GetInputPort(name))
    parts.ExportOutput(schedule.GetOutputPort("held_command"), "u")
    for name in (*scenario.vehicle_data.sensor_names(), "mass_properties", "thrust"):
        parts.ExportOutput(body.GetOutputPort(name), f"y_{name}")
    slices = {"w": slice(4, 7), "q": slice(0, 4), "v": slice(10, 13)}
    for name, part in slices.items():
        picked = parts.AddNamedSystem(name, MatrixGain(np.eye(N_STATE)[part]))
        parts.Connect(body.GetOutputPort("body_state"), picked.get_input_port())
        parts.ExportOutput(picked.get_output_port(), name)
    made = parts.Build()
    made.set_name("mine")
    return made


def beside_a_plant(scenario: Scenario) -> DiagramBuilder:
    """An estimator beside that plant."""
    builder = DiagramBuilder()
    mine = builder.AddSystem(plant(scenario))
    estimator = builder.AddSystem(MassPropertyEstimator(scenario))
    builder.Connect(mine.GetOutputPort("u"), estimator.GetInputPort("jet_commands"))
    for name in scenario.vehicle_data.sensor_names():
        builder.Connect(mine.GetOutputPort(f"y_{name}"), estimator.GetInputPort(name))
    return builder


@pytest.fixture(scope="module")
def scheduled() -> Scenario:
    return load_scenario("jet_pulses", ["duration_s=6"])


@pytest.fixture(scope="module")
def open_loop_run(scheduled: Scenario) -> Run:
    return simulate(scheduled)


TABLE = {"rate": "w", "attitude": "q", "velocity": "v", "mass_properties": "y_mass_properties", "thrust": "y_thrust"}


def test_a_table_names_the_truth_of_a_plant_of_ones_own(
    scheduled: Scenario, open_loop_run: Run, tmp_path: Path
) -> None:
    run = simulate(scheduled, diagram=beside_a_plant(scheduled), truth=TABLE)
    assert {"rate", "attitude", "velocity", "truth", "thrust"} <= set(run.signals)
    assert "position" not in run.signals
    for name in set(run.signals) - {"command"}:
        # what is derived from the mass reciprocal may differ in the last bit
        np.testing.assert_allclose(run[name], open_loop_run[name], rtol=1e-14, err_msg=name)
    np.testing.assert_array_equal(run["command"][:-1], open_loop_run["command"][:-1])
    assert np.isnan(run["command"][-1]).all()  # nobody knows it yet
    np.testing.assert_allclose(run.results.truth, open_loop_run.results.truth, rtol=1e-14)
    assert run.state["states"] == open_loop_run.state["states"]
    again = Run.load(run.save(tmp_path / "run", replay=True, pictures=False))
    np.testing.assert_array_equal(again["rate"], run["rate"])
    assert "within 3 sigma of the truth" in report_html(again)


def test_without_a_truth_the_run_knows_none(scheduled: Scenario, open_loop_run: Run, tmp_path: Path) -> None:
    run = simulate(scheduled, diagram=beside_a_plant(scheduled))
    assert not {"rate", "attitude", "velocity", "position", "truth", "thrust", "torque", "force"} & set(run.signals)
    np.testing.assert_array_equal(run["estimate"], open_loop_run["estimate"])
    assert np.isnan(run.results.truth).all()
    assert run.results.injected is None
    assert run.results.autopilot.propellant_mass == pytest.approx(
        open_loop_run.results.autopilot.propellant_mass, rel=0.05
    )
    again = Run.load(run.save(tmp_path / "run", replay=True, pictures=False))
    assert "The truth is unknown" in report_html(again)


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        ({"rates": "w"}, "truth: no run keeps a true 'rates'; did you mean 'rate'?"),
        ({"rate": "omega"}, "truth: rate: the diagram has no output port 'omega'"),
        ({"rate": "q"}, "truth: rate: must be a port of 3 numbers; 'q' has 4 numbers"),
        ({"attitude": "w"}, "truth: attitude: must be a port of 4 numbers; 'w' has 3 numbers"),
        ({"rate": 3}, "truth: rate: must be an output port or its name, got 3"),
    ],
)
def test_a_wrong_table_is_refused(scheduled: Scenario, truth: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        simulate(scheduled, diagram=beside_a_plant(scheduled), truth=truth)
    assert str(caught.value) == message


def test_a_diagram_that_cannot_be_flown_is_refused(scenario: Scenario) -> None:
    slow = load_scenario("sample_maneuver", ["duration_s=4", "vehicle.sample_period_s=0.16"])
    with pytest.raises(InputError, match=r"its estimator samples every 0\.16 s, the scenario's vehicle every 0\.08 s"):
        simulate(scenario, diagram=closed_loop.build(slow))
    with pytest.raises(InputError, match="diagram: must be a Diagram or a DiagramBuilder, got str"):
        simulate(scenario, diagram="closed_loop")
    builder, _ = wired(scenario)
    builder.AddNamedSystem("mine", MatrixGain(np.eye(2)))
    with pytest.raises(InputError, match="two of its systems are named 'mine'; rename one"):
        simulate(scenario, diagram=builder)
    builder, mine = wired(scenario)
    gain = builder.AddSystem(MatrixGain(np.eye(2)))
    builder.Connect(gain.get_output_port(), gain.get_input_port())
    with pytest.raises(InputError, match="simulate: diagram: Reported algebraic loop"):
        simulate(scenario, diagram=builder, log=[mine.GetOutputPort("doubled")])
    builder, _ = wired(scenario)
    simulate(scenario, diagram=builder)
    with pytest.raises(InputError, match=r"simulate: diagram: DiagramBuilder: Build\(\) .* has already been called"):
        simulate(scenario, diagram=builder)


SERVICER = Scenario(vehicle="servicer", duration_s=2.0)


def commanded(level: float) -> DiagramBuilder:
    """A vehicle whose second jet is commanded by one number, and an estimator."""
    known, builder = SERVICER.vehicle_data, DiagramBuilder()
    pilot = builder.AddNamedSystem("pilot", ConstantVectorSource(level * np.eye(len(known.jets))[1]))
    body = builder.AddNamedSystem("body", vehicle.build(SERVICER))
    estimator = builder.AddSystem(MassPropertyEstimator(SERVICER))
    for name in ("command", "held_command"):
        builder.Connect(pilot.get_output_port(), body.GetInputPort(name))
    for name in known.sensor_names():
        builder.Connect(body.GetOutputPort(name), estimator.GetInputPort(name))
    builder.Connect(pilot.get_output_port(), estimator.GetInputPort("jet_commands"))
    return builder


@pytest.mark.parametrize(
    ("level", "message"),
    [
        (1.5, "command: at t = 0 s jet M2 is commanded by 1.5; it must be from 0 to 1, the fraction of full thrust"),
        (np.nan, "at t = 0 s a command of the jets is NaN; each must be from 0 to 1"),
    ],
)
def test_a_command_that_no_jet_can_follow_is_refused(level: float, message: str) -> None:
    with pytest.raises(InputError) as caught:
        simulate(SERVICER, diagram=commanded(level))
    assert message in str(caught.value)
