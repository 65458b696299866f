"""Derivatives of the true vehicle by Drake's scalar types, against differences of the float diagram."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.symbolic import Evaluate, MakeVectorVariable
from pydrake.systems.framework import Diagram, OutputPortIndex
from pydrake.systems.primitives import Linearize

from massprop_drake import InputError, load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.rigid_body import MASS, N_STATE, QUATERNION, RATE, VELOCITY

STEPS = {"stepped": "null", "continuous": "0"}
TOLERANCE = 1e-6  # of the largest derivative of the same quantity, in units of what varies


def smooth(name: str, *overrides: str) -> Scenario:
    """A bundled scenario with sensors that are off by their scale alone."""
    packages, scale = load_scenario(name).vehicle_data.sensors, "scale_factor: [1.0e-3, 0, -2.0e-3]"
    errors = ", ".join(f"{{sensor: {one.name}, quantum: 0, noise_std: 0, {scale}}}" for one in packages)
    return load_scenario(name, [f"sensors.errors=[{errors}]", *overrides])


class Point:
    """A diagram of the vehicle at a point of its state, its commands and its parameters, all in one vector."""

    def __init__(self, scenario: Scenario, diagram: Diagram):
        self.diagram, self._n_jets = diagram, len(scenario.vehicle_data.jets)
        self.context: Any = diagram.CreateDefaultContext()
        self.continuous = self.context.num_continuous_states() > 0
        # a continuous body is within a sample, of which nothing but the held command counts
        self.context.SetTime(0.3 * scenario.vehicle_data.sample_period_s if self.continuous else 0.0)
        self._plant, self._jets = (diagram.GetSubsystemByName(name) for name in ("rigid_body", "reaction_jets"))
        self.commanded, other = ("held_command", "command") if self.continuous else ("command", "held_command")
        diagram.GetInputPort(other).FixValue(self.context, np.full(self._n_jets, 0.5))

    def set(self, vector: np.ndarray) -> None:
        """Puts a vector of state, commands, and parameters of plant and jets into the context."""
        n = self._n_jets
        state, commands, levels, properties, factors = np.split(vector, np.cumsum([N_STATE, n, n, 10]))
        plant, jets = (each.GetMyMutableContextFromRoot(self.context) for each in (self._plant, self._jets))
        body = plant.get_mutable_continuous_state_vector() if self.continuous else plant.get_mutable_discrete_state(0)
        body.SetFromVector(state)
        self.diagram.GetInputPort(self.commanded).FixValue(self.context, commands)
        if jets.num_discrete_state_groups() and jets.get_discrete_state(0).size() > 1:  # they lag
            kept = jets.get_mutable_discrete_state(0)
            kept.SetFromVector(np.append(levels, kept.GetAtIndex(n)))
        plant.get_mutable_numeric_parameter(0).SetFromVector(properties)
        self._jets.parameters.set(jets, thrust_factor=factors)

    def evaluated(self) -> np.ndarray:
        """Next state, or its derivative, and every output."""
        if self.continuous:
            ahead = [self.diagram.EvalTimeDerivatives(self.context).get_vector().CopyToVector()]
        else:
            updated = self.diagram.EvalUniquePeriodicDiscreteUpdate(self.context)
            ahead = [updated.get_vector(group).CopyToVector() for group in range(updated.num_groups())]
        ports = [self.diagram.get_output_port(OutputPortIndex(i)) for i in range(self.diagram.num_output_ports())]
        return np.concatenate([*ahead, *(port.Eval(self.context) for port in ports)])


def vector_at(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """A generic point, turning and under thrust, and the size of each of its numbers."""
    data = scenario.vehicle_data
    n, inertia, mass = len(data.jets), data.nominal.inertia, data.nominal.mass
    body, jets = np.full(N_STATE, 0.1), np.linspace(0.1, 0.9, n)
    body[QUATERNION] = np.array([0.9, 0.2, -0.3, 0.25]) / np.linalg.norm([0.9, 0.2, -0.3, 0.25])
    body[RATE], body[VELOCITY], body[MASS] = [0.04, -0.03, 0.02], [1.0, 2.0, -1.0], -0.01 * mass
    six = inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    vector = np.concatenate([body, jets, jets[::-1], [mass], data.nominal.center_of_mass, six, 0.9 + 0.2 * jets])
    sizes = np.ones(vector.size)
    sizes[RATE], sizes[MASS], sizes[N_STATE + 2 * n] = 0.1, mass, mass
    sizes[N_STATE + 2 * n + 4 :][:6] = np.trace(inertia)
    return vector, sizes


def differences(point: Point, vector: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Jacobian by central differences of fourth order, each column times the size of what varies."""
    columns = []
    for place, size in enumerate(sizes):
        found = []
        for steps in (-2, -1, 1, 2):
            moved = vector.copy()
            moved[place] += steps * 1e-3 * size
            point.set(moved)
            found.append(point.evaluated())
        columns.append((found[0] - 8.0 * found[1] + 8.0 * found[2] - found[3]) / 12e-3)
    point.set(vector)
    return np.column_stack(columns)


def values(numbers: np.ndarray) -> np.ndarray:
    return np.array([one.value() for one in numbers])


def agree(found: np.ndarray, expected: np.ndarray, value: np.ndarray) -> None:
    """Compares jacobians row by row; ``value``: of each quantity, by whose last digits differences are rough."""
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found - expected) <= TOLERANCE * scale + 1e-11 * np.abs(value)[:, None]).all()


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("lag", ["none", "vehicle"])
def test_jacobians_of_state_commands_and_parameters(lag: str, step: str) -> None:
    name = "small_satellite_maneuver" if step == "stepped" else "lander_maneuver"
    scenario = smooth(name, f"plant.time_step={STEPS[step]}", f"plant.thrust_transient={lag}")
    diagram, (vector, sizes) = vehicle.build(scenario), vector_at(scenario)
    flown, converted = Point(scenario, diagram), Point(scenario, diagram.ToAutoDiffXd())
    expected = differences(flown, vector, sizes)
    converted.set(InitializeAutoDiff(vector).ravel())
    result = converted.evaluated()
    assert_allclose(values(result), flown.evaluated(), rtol=1e-11, atol=1e-13)
    found = np.array([one.derivatives() if one.derivatives().size else np.zeros(vector.size) for one in result])
    agree(found * sizes, expected, values(result))
    assert (np.abs(expected[:N_STATE]).max(axis=0) > 0.0).sum() > N_STATE  # of state, jets and parameters
    if lag == "none":  # Drake's own takes state of one group
        n, gyro = len(scenario.vehicle_data.jets), diagram.GetOutputPort("gyro")
        ports = diagram.GetInputPort(flown.commanded).get_index(), gyro.get_index()
        line = Linearize(diagram, flown.context, *ports, equilibrium_check_tolerance=1e9)
        own, value = sizes[:N_STATE], values(result)
        agree(line.A() * own, expected[:N_STATE, :N_STATE], value[:N_STATE])
        agree(line.B(), expected[:N_STATE, N_STATE:][:, :n], value[:N_STATE])
        assert line.time_period() == (0.0 if flown.continuous else scenario.vehicle_data.sample_period_s)
    if step == "continuous":  # and the symbolic equations of motion are those of the floats
        symbolic, variables = Point(scenario, diagram.ToSymbolic()), MakeVectorVariable(vector.size, "x")
        symbolic.set(variables)
        evaluated = Evaluate(symbolic.evaluated(), dict(zip(variables, vector, strict=True)))
        assert_allclose(evaluated.ravel(), flown.evaluated(), rtol=1e-11, atol=1e-13)


QUANTIZED = r"sensor 'gyro' quantizes its readings, so it has no form for {}: give it sensors.errors: \[{{sensor: gyro"
CHANCE = "failures=[{kind: intermittent, jet: F1F, start_s: 0, probability: 0.5}]"


@pytest.mark.parametrize(
    ("scenario", "convert", "message"),
    [
        (load_scenario("sample_maneuver"), Diagram.ToAutoDiffXd, QUANTIZED.format("AutoDiffXd")),
        (load_scenario("sample_maneuver", ["plant.time_step=0"]), Diagram.ToSymbolic, QUANTIZED.format("Expression")),
        (
            load_scenario("sample_maneuver"),
            lambda diagram: Linearize(diagram, diagram.CreateDefaultContext()),
            QUANTIZED.format("AutoDiffXd"),
        ),
        (
            smooth("sample_maneuver"),
            Diagram.ToSymbolic,
            r"plant 'rigid_body' moves by steps .* no form for Expression: set plant.time_step: 0",
        ),
        (
            smooth("sample_maneuver", "plant.time_step=0", CHANCE),
            Diagram.ToSymbolic,
            r"'reaction_jets' has a jet that fails intermittently .*leave the intermittent failures out",
        ),
    ],
)
def test_parts_without_derivatives_refuse_and_say_how_to_do_without(
    scenario: Scenario, convert: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        convert(vehicle.build(scenario))


def test_a_quantum_set_in_a_converted_context_is_refused_there() -> None:
    diagram = vehicle.build(smooth("sample_maneuver")).ToAutoDiffXd()
    context, gyro = diagram.CreateDefaultContext(), diagram.GetSubsystemByName("gyro")
    gyro.parameters.set(gyro.GetMyMutableContextFromRoot(context), quantum=AutoDiffXd(1e-4))
    with pytest.raises(InputError, match="sensor 'gyro' quantizes its readings"):
        diagram.GetOutputPort("gyro").Eval(context)
