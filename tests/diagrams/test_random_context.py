"""Chance in a diagram's context: `SetRandomContext` and Drake's Monte Carlo vary the noise, repeatably."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from massprop_drake import load_scenario
from massprop_drake.diagrams import closed_loop, vehicle
from massprop_drake.inputs.scenario import Scenario

NOISY = "sensors.errors=[{sensor: gyro, noise_std: 2.0e-4}]"
FAILS = "failures=[{jet: R4R, kind: intermittent, probability: 0.5, start_s: 0}]"
END_S = 0.8  # of a run, some samples


def noisy(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", [NOISY, "duration_s=5", *overrides])


def own(scenario: Scenario) -> Diagram:
    """A user's diagram that has the vehicle among its parts, its jets told to be quiet but one."""
    builder = DiagramBuilder()
    body = builder.AddNamedSystem("body", vehicle.build(scenario))
    jets = scenario.vehicle_data.designations
    command = builder.AddSystem(ConstantVectorSource((np.array(jets) == "R4R").astype(float)))
    for name in ("command", "held_command"):
        builder.Connect(command.get_output_port(), body.GetInputPort(name))
    for name in ("gyro", "thrust"):
        builder.ExportOutput(body.GetOutputPort(name), name)
    return builder.Build()


def built(of: str, scenario: Scenario) -> Diagram:
    return closed_loop.build(scenario) if of == "closed_loop" else own(scenario)


def readings(diagram: Diagram, generator: RandomGenerator | None = None, port: str = "gyro") -> np.ndarray:
    """Values of a port at every sample of a run; with a generator, of a context that it has randomized."""
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    if generator is not None:
        diagram.SetRandomContext(context, generator)
    found = [diagram.GetOutputPort(port).Eval(context)]
    for time_s in np.arange(0.08, END_S, 0.08):
        simulator.AdvanceTo(time_s)
        found.append(diagram.GetOutputPort(port).Eval(context))
    return np.array(found)


@pytest.mark.parametrize("of", ["closed_loop", "own"])
def test_a_random_context_varies_the_noise_and_its_generator_repeats_it(of: str) -> None:
    diagram = built(of, noisy())
    default = readings(diagram)
    first, again, other = (readings(diagram, RandomGenerator(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    for one, two in ((default, first), (default, other), (first, other)):
        assert (one != two).any(axis=1).all()  # at every sample, the first one included
    spread = np.std(first - default) / np.sqrt(2.0)
    assert 1e-4 < spread < 4e-4  # of as much noise as the scenario says
    np.testing.assert_array_equal(readings(diagram), default)  # a new context is the scenario's own


@pytest.mark.parametrize("of", ["closed_loop", "own"])
def test_the_seed_of_the_scenario_still_counts(of: str) -> None:
    drawn = [readings(built(of, noisy(f"seed={seed}")), RandomGenerator(1)) for seed in (0, 1)]
    assert (drawn[0] != drawn[1]).any(axis=1).all()


def test_a_copy_of_a_context_has_its_seed_and_the_default_context_the_scenarios_own() -> None:
    diagram = built("own", noisy())
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.SetRandomContext(context, RandomGenerator(3))
    first = diagram.GetOutputPort("gyro").Eval(context)
    copied = context.Clone()
    simulator.AdvanceTo(END_S)
    np.testing.assert_array_equal(diagram.GetOutputPort("gyro").Eval(copied), first)
    context.SetTime(0.0)
    diagram.SetDefaultContext(context)
    np.testing.assert_array_equal(diagram.GetOutputPort("gyro").Eval(context), readings(diagram)[0])


def test_intermittent_failures_vary_with_it() -> None:
    diagram = own(noisy(FAILS))
    default = readings(diagram, port="thrust")
    first, again = (readings(diagram, RandomGenerator(1), "thrust") for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (first != default).any()


@pytest.mark.parametrize("of", ["closed_loop", "own"])
def test_monte_carlo_gives_other_outputs_and_the_same_again(of: str) -> None:
    diagram = built(of, noisy())

    def outputs() -> list[float]:
        def measured(system: Any, context: Any) -> float:
            return float(system.GetOutputPort("gyro").Eval(context)[0])

        found = MonteCarloSimulation(
            make_simulator=lambda generator: Simulator(diagram),
            output=measured,
            final_time=END_S,
            num_samples=3,
            generator=RandomGenerator(7),
        )
        return [one.output for one in found]

    first = outputs()
    assert len(set(first)) == 3
    assert outputs() == first
