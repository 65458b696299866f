"""Chance in a diagram's context: `SetRandomContext` and Drake's Monte Carlo vary all that is drawn, repeatably."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from massprop_drake import InputError, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, vehicle
from massprop_drake.inputs import true_params
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
    for name in ("gyro", "thrust", "mass_properties"):
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


DRAWN = {
    "true thrusts": ("thrust", ["plant.thrust_dispersion=0.02"]),
    "the phases of quantizers": ("gyro", []),
    "the phases of vibration": (
        "gyro",
        ["sensors.errors=[{sensor: gyro, quantum: 0, vibration: [{frequency_hz: 2, amplitude: [1.0e-3, 0, 0]}]}]"],
    ),
    "the start of a disturbance": ("body_state", ["plant.disturbance={torque_std: [100, 100, 100]}"]),
}


@pytest.mark.parametrize("chance", DRAWN)
def test_what_the_seed_draws_before_a_run_varies_with_it(chance: str) -> None:
    port, overrides = DRAWN[chance]
    scenario = load_scenario("sample_maneuver", ["sensors.quantizer_phase=seeded", "duration_s=5", *overrides])
    diagram = closed_loop.build(scenario)

    def first(generator: RandomGenerator | None = None) -> np.ndarray:
        simulator = Simulator(diagram)
        context = simulator.get_mutable_context()
        if generator is not None:
            diagram.SetRandomContext(context, generator)
        simulator.AdvanceTo(1.2)  # in the maneuver's first window
        return diagram.GetOutputPort(port).Eval(context)

    default, one, again, other = first(), *(first(RandomGenerator(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert len({tuple(values) for values in (default, one, other)}) == 3
    np.testing.assert_array_equal(first(), default)


def test_unless_drawn_it_is_what_the_scenario_s_seed_draws() -> None:
    overrides = ["plant.thrust_dispersion=0.02", "seed=5", "failures=[{kind: leak, jet: F1L, force: 10, start_s: 0}]"]
    scenario = load_scenario("sample_maneuver", overrides)
    diagram = vehicle.build(scenario)
    context: Any = diagram.CreateDefaultContext()
    wrenches, jets = true_params.plant_wrenches(scenario), scenario.vehicle_data.designations
    (leak,) = true_params.jet_failures(scenario)
    for jet in range(len(jets)):
        command = np.eye(len(jets))[jet]
        for name in ("command", "held_command"):
            diagram.GetInputPort(name).FixValue(context, command)
        thrust = diagram.GetOutputPort("thrust").Eval(context)
        command[leak.jet] += leak.amount
        expected = command * np.linalg.norm(wrenches[:, 3:6], axis=1)
        np.testing.assert_array_equal(thrust, expected)


def test_nothing_is_drawn_where_nothing_is_by_chance() -> None:
    diagram = vehicle.build(load_scenario("sample_maneuver", ["sensors.quantizer_phase=equal"]))
    assert not diagram.HasSubsystemNamed("noise_seed")
    drawn = vehicle.build(load_scenario("sample_maneuver"))
    assert drawn.CreateDefaultContext().num_discrete_state_groups() == 1  # the body's: chance adds none


def test_a_monte_carlo_simulation_of_twenty_over_one_diagram() -> None:
    everything = ["plant.thrust_dispersion=0.02", "plant.disturbance={torque_std: [100, 100, 100]}"]
    diagram = closed_loop.build(noisy(*everything))

    def outputs() -> list[tuple[float, ...]]:
        def measured(system: Any, context: Any) -> float:
            found.append(tuple(float(system.GetOutputPort(port).Eval(context).sum()) for port in ports))
            return found[-1][0]

        found: list[tuple[float, ...]] = []
        MonteCarloSimulation(
            make_simulator=lambda generator: Simulator(diagram),
            output=measured,
            final_time=1.2,
            num_samples=20,
            generator=RandomGenerator(7),
        )
        return found

    ports = ("thrust", "gyro", "acc1", "body_state")
    first = outputs()
    for values in zip(*first, strict=True):
        assert len(set(values)) == 20
    assert outputs() == first


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


def test_what_is_drawn_is_passed_on_to_another_scalar_type() -> None:
    quiet = ", ".join(f"{{sensor: {name}, quantum: 0}}" for name in ("gyro", "acc1", "acc2", "acc3"))
    diagram = own(load_scenario("sample_maneuver", [f"sensors.errors=[{quiet}]", "plant.thrust_dispersion=0.02"]))
    context, converted = diagram.CreateDefaultContext(), diagram.ToAutoDiffXd()
    other = converted.CreateDefaultContext()
    for seed in (1, 2):
        diagram.SetRandomContext(context, RandomGenerator(seed))
        other.SetTimeStateAndParametersFrom(context)
        expected = diagram.GetOutputPort("thrust").Eval(context)
        found = converted.GetOutputPort("thrust").Eval(other)
        np.testing.assert_allclose([one.value() for one in found], expected, rtol=1e-15)


def test_true_mass_properties_are_drawn_with_a_dispersion() -> None:
    """Draws are the seed's, alike in both engines; in a random context they are new, and repeatable."""
    spread = "plant.dispersion={mass_percent: 3, center_of_mass: 0.5, second_moments_percent: 5, axes_deg: 2}"
    scenario = load_scenario("sample_maneuver", [spread, "duration_s=1", "seed=4"])
    diagram = own(scenario)
    truths = [
        readings(diagram, None if one is None else RandomGenerator(one), "mass_properties") for one in (None, 1, 2, 1)
    ]
    expected = true_params.true_properties(scenario).vector()
    np.testing.assert_allclose(truths[0][0], expected, rtol=1e-12)
    assert 0.001 < np.abs(expected / scenario.vehicle_data.nominal.vector() - 1.0)[:3].max() < 0.3
    np.testing.assert_array_equal(truths[1], truths[3])
    assert all((np.abs(one[0] - other[0]) > 0.0).all() for one, other in itertools.combinations(truths[:3], 2))
    runs = []
    for engine in ("diagram", "loop"):
        runs.append(simulate(load_scenario("sample_maneuver", [spread, "duration_s=1", f"execution.engine={engine}"])))
    for name in ("truth", "rate", "acc1", "estimate"):
        np.testing.assert_array_equal(runs[0][name], runs[1][name], err_msg=name)
    with pytest.raises(InputError, match=r"has mass properties that are drawn.*leave out plant.dispersion"):
        diagram.ToAutoDiffXd()


def test_axes_do_not_tilt_in_a_plane() -> None:
    with pytest.raises(InputError, match=r"plant.dispersion.axes_deg: vehicle 'air_bearing' moves in a plane"):
        load_scenario("air_bearing_pulses", ["plant.dispersion.axes_deg=1"])
