"""Chance in a diagram's context: `SetRandomContext` and Drake's Monte Carlo vary all that is drawn, repeatably."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from massprop_drake import InputError, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, vehicle
from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import Scenario


def flown(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", ["sensors.quantizer_phase=seeded", "duration_s=5", *overrides])


def own(scenario: Scenario) -> Diagram:
    """A user's diagram that has the vehicle among its parts, its jets told to be quiet but one."""
    builder = DiagramBuilder()
    body = builder.AddNamedSystem("body", vehicle.build(scenario))
    told = np.array(scenario.vehicle_data.designations) == "R4R"
    command = builder.AddSystem(ConstantVectorSource(told.astype(float)))
    for name in ("command", "held_command"):
        builder.Connect(command.get_output_port(), body.GetInputPort(name))
    for name in ("gyro", "thrust", "mass_properties", "body_state"):
        builder.ExportOutput(body.GetOutputPort(name), name)
    return builder.Build()


NOISY = "sensors.errors=[{sensor: gyro, noise_std: 2.0e-4}]"
SPREAD = "plant.dispersion={mass_percent: 3, center_of_mass: 0.5, second_moments_percent: 5, axes_deg: 2}"
SHAKEN = "sensors.errors=[{sensor: gyro, quantum: 0, vibration: [{frequency_hz: 2, amplitude: [1.0e-3, 0, 0]}]}]"
DRAWN = {
    "noise": ("gyro", NOISY),
    "intermittent failures": ("thrust", "failures=[{jet: R4R, kind: intermittent, probability: 0.5, start_s: 0}]"),
    "true thrusts": ("thrust", "plant.thrust_dispersion=0.02"),
    "phases of quantizers": ("gyro", "name=plain"),
    "phases of vibration": ("gyro", SHAKEN),
    "start of a disturbance": ("body_state", "plant.disturbance={torque_std: [100, 100, 100]}"),
    "mass properties": ("mass_properties", SPREAD),
}


def said(diagram: Diagram, port: str, draw: int | None = None) -> np.ndarray:
    """Values of a port at some samples; with a draw, of a context that it has randomized."""
    simulator, found = Simulator(diagram), []
    context = simulator.get_mutable_context()
    if draw is not None:
        diagram.SetRandomContext(context, RandomGenerator(draw))
    for time_s in np.arange(0.0, 1.25, 0.08):  # into the maneuver's first window
        simulator.AdvanceTo(time_s)
        found.append(diagram.GetOutputPort(port).Eval(context))
    return np.array(found)


@pytest.mark.parametrize("chance", DRAWN)
def test_a_random_context_varies_what_is_drawn_and_its_generator_repeats_it(chance: str) -> None:
    (port, override), build = DRAWN[chance], own if chance == "intermittent failures" else closed_loop.build
    diagram = build(flown(override))
    default, first, again, other = (said(diagram, port, draw) for draw in (None, 1, 1, 2))
    assert_array_equal(first, again)
    assert len({tuple(values.ravel()) for values in (default, first, other)}) == 3
    assert_array_equal(said(diagram, port), default)  # a new context is the scenario's own
    if chance == "noise":  # at every sample, of as much noise as the scenario says
        assert ((default != first) & (default != other)).any(axis=1).all()
        assert 1e-4 < np.std((first - default)[:12]) / np.sqrt(2.0) < 4e-4
        assert (said(build(flown(override, "seed=1")), port, 1) != first).any()  # the scenario's seed still counts


def test_a_copy_of_a_context_has_its_seed_and_the_default_context_the_scenarios_own() -> None:
    diagram = own(flown(NOISY))
    context: Any = diagram.CreateDefaultContext()
    readings = [diagram.GetOutputPort("gyro").Eval(context)]
    diagram.SetRandomContext(context, RandomGenerator(3))
    readings.append(diagram.GetOutputPort("gyro").Eval(context))
    assert_array_equal(diagram.GetOutputPort("gyro").Eval(context.Clone()), readings[1])
    diagram.SetDefaultContext(context)
    assert_array_equal(diagram.GetOutputPort("gyro").Eval(context), readings[0])
    assert (readings[0] != readings[1]).all()


def test_chance_adds_no_state_and_no_part_where_there_is_none() -> None:
    quiet = vehicle.build(load_scenario("sample_maneuver", ["sensors.quantizer_phase=equal"]))
    assert not quiet.HasSubsystemNamed("noise_seed")
    assert vehicle.build(flown()).CreateDefaultContext().num_discrete_state_groups() == 1  # the body's


def test_a_monte_carlo_simulation_over_one_diagram() -> None:
    diagram = closed_loop.build(flown(NOISY))

    def measured(system: Any, context: Any) -> float:
        return float(system.GetOutputPort("gyro").Eval(context)[0])

    first, again = (
        [run.output for run in MonteCarloSimulation(lambda _: Simulator(diagram), measured, 0.8, 5, RandomGenerator(7))]
        for _ in range(2)
    )
    assert len(set(first)) == 5
    assert again == first


def test_drawn_mass_properties_are_the_seeds_alike_in_both_engines() -> None:
    scenario = flown(SPREAD, "duration_s=1", "seed=4")
    runs = [simulate(flown(SPREAD, "duration_s=1", "seed=4", f"execution.engine={how}")) for how in ("diagram", "loop")]
    expected = true_params.true_properties(scenario).vector()
    assert_allclose(runs[0]["truth"][0], expected, rtol=1e-12)
    assert 0.001 < np.abs(expected / scenario.vehicle_data.nominal.vector() - 1.0)[:3].max() < 0.3
    for name in ("truth", "rate", "acc1", "estimate"):
        assert_array_equal(runs[0][name], runs[1][name], err_msg=name)
    with pytest.raises(InputError, match=r"has mass properties that are drawn.*leave out plant.dispersion"):
        own(load_scenario("sample_maneuver", [SPREAD])).ToAutoDiffXd()
    with pytest.raises(InputError, match=r"plant.dispersion.axes_deg: vehicle 'air_bearing' moves in a plane"):
        load_scenario("air_bearing_pulses", ["plant.dispersion.axes_deg=1"])
