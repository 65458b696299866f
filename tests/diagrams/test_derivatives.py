"""Derivatives of the true vehicle by Drake's scalar types, against differences of the float diagram."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.symbolic import Evaluate, MakeVectorVariable
from pydrake.systems.framework import Diagram, OutputPortIndex
from pydrake.systems.primitives import FirstOrderTaylorApproximation, Linearize

from massprop_drake import InputError, load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.rigid_body import MASS, N_STATE, QUATERNION, RATE, VELOCITY

FLOWN = ("sample_maneuver", "small_satellite_maneuver", "lander_maneuver", "free_flyer_maneuver")
STEPS = {"stepped": "null", "continuous": "0"}
TOLERANCE = 1e-6  # of the largest derivative of the same quantity, in units of what varies


def smooth(name: str, *overrides: str) -> Scenario:
    """A bundled scenario with sensors that are off by their scale alone."""
    packages = load_scenario(name).vehicle_data.sensors
    errors = ", ".join(
        f"{{sensor: {one.name}, quantum: 0, noise_std: 0, scale_factor: [1.0e-3, 0, -2.0e-3]}}" for one in packages
    )
    return load_scenario(name, [f"sensors.errors=[{errors}]", *overrides])


class Point:
    """A diagram of the vehicle at a point of its state, its commands and its parameters, all in one vector.

    Args:
        scenario: of it.
        diagram: built of that, of any scalar type.
    """

    def __init__(self, scenario: Scenario, diagram: Diagram):
        self.diagram, self._n_jets = diagram, len(scenario.vehicle_data.jets)
        self.context: Any = diagram.CreateDefaultContext()
        self.continuous = self.context.num_continuous_states() > 0
        # a continuous body is within a sample, of which nothing but the held command counts
        self.context.SetTime(0.3 * scenario.vehicle_data.sample_period_s if self.continuous else 0.0)
        self._plant, self._jets = (diagram.GetSubsystemByName(name) for name in ("rigid_body", "reaction_jets"))
        self.commanded = "held_command" if self.continuous else "command"
        other = "command" if self.continuous else "held_command"
        diagram.GetInputPort(other).FixValue(self.context, np.full(self._n_jets, 0.5))

    def _own(self, system: Any) -> Any:
        return system.GetMyMutableContextFromRoot(self.context)

    @property
    def body(self) -> Any:
        """State of the body."""
        own = self._own(self._plant)
        return own.get_mutable_continuous_state_vector() if self.continuous else own.get_mutable_discrete_state(0)

    @property
    def levels(self) -> Any:
        """Levels of the jets and their time; None where no jet lags."""
        own = self._own(self._jets)
        lags = own.num_discrete_state_groups() and own.get_discrete_state(0).size() > 1
        return own.get_mutable_discrete_state(0) if lags else None

    def set(self, vector: np.ndarray) -> None:
        """Puts a vector of state, commands, and parameters of plant and jets into the context."""
        n = self._n_jets
        body, commands, levels, properties, factors = np.split(vector, np.cumsum([N_STATE, n, n, 10]))
        self.body.SetFromVector(body)
        self.diagram.GetInputPort(self.commanded).FixValue(self.context, commands)
        if self.levels is not None:
            self.levels.SetFromVector(np.append(levels, self.levels.GetAtIndex(n)))
        self._own(self._plant).get_mutable_numeric_parameter(0).SetFromVector(properties)
        self._jets.parameters.set(self._own(self._jets), thrust_factor=factors)

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
    body = np.full(N_STATE, 0.1)
    body[QUATERNION] = np.array([0.9, 0.2, -0.3, 0.25]) / np.linalg.norm([0.9, 0.2, -0.3, 0.25])
    body[RATE], body[VELOCITY], body[MASS] = [0.04, -0.03, 0.02], [1.0, 2.0, -1.0], -0.01 * mass
    jets = np.linspace(0.1, 0.9, n)
    six = inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    vector = np.concatenate([body, jets, jets[::-1], [mass], data.nominal.center_of_mass, six, 0.9 + 0.2 * jets])
    sizes = np.ones(vector.size)
    sizes[RATE] = 0.1
    sizes[MASS] = sizes[N_STATE + 2 * n] = mass
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


def gradient(numbers: np.ndarray, count: int) -> np.ndarray:
    """Derivatives of some numbers by all that varies, a row each."""
    return np.array([one.derivatives() if one.derivatives().size else np.zeros(count) for one in numbers])


def agree(found: np.ndarray, expected: np.ndarray, value: np.ndarray) -> None:
    """Compares jacobians row by row; ``value``: of each quantity, by whose last digits differences are rough."""
    rough = 1e-11 * np.abs(value)[:, None]
    scale = np.abs(expected).max(axis=1, keepdims=True)
    worst = np.abs(found - expected) - (TOLERANCE * scale + rough)
    assert worst.max() <= 0.0, np.argwhere(worst > 0.0)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("lag", ["none", "vehicle"])
@pytest.mark.parametrize("name", FLOWN)
def test_jacobians_of_state_commands_and_parameters(name: str, lag: str, step: str) -> None:
    scenario = smooth(name, f"plant.time_step={STEPS[step]}", f"plant.thrust_transient={lag}")
    diagram = vehicle.build(scenario)
    vector, sizes = vector_at(scenario)
    expected = differences(flown := Point(scenario, diagram), vector, sizes)
    converted = Point(scenario, diagram.ToAutoDiffXd())
    converted.set(InitializeAutoDiff(vector).ravel())
    result = converted.evaluated()
    np.testing.assert_allclose(values(result), flown.evaluated(), rtol=1e-11, atol=1e-13)
    agree(gradient(result, vector.size) * sizes, expected, values(result))
    assert (np.abs(expected[:N_STATE]).max(axis=0) > 0.0).sum() > N_STATE  # of state, jets and parameters


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", FLOWN)
def test_linearize_takes_the_whole_diagram(name: str, step: str) -> None:
    scenario = smooth(name, f"plant.time_step={STEPS[step]}", "plant.thrust_transient=none")
    diagram = vehicle.build(scenario)
    vector, sizes = vector_at(scenario)
    point = Point(scenario, diagram)
    expected, value = differences(point, vector, sizes) / sizes, point.evaluated()
    n = len(scenario.vehicle_data.jets)
    ports = diagram.GetInputPort(point.commanded).get_index(), diagram.GetOutputPort("gyro").get_index()
    reading = N_STATE + sum(diagram.get_output_port(OutputPortIndex(i)).size() for i in range(int(ports[1])))
    for made in (
        FirstOrderTaylorApproximation(diagram, point.context, *ports),
        Linearize(diagram, point.context, *ports, equilibrium_check_tolerance=1e9),
    ):
        in_size, gyro = sizes[:N_STATE], slice(reading, reading + 3)
        agree(made.A() * in_size, expected[:N_STATE, :N_STATE] * in_size, value[:N_STATE])
        agree(made.B(), expected[:N_STATE, N_STATE:][:, :n], value[:N_STATE])
        agree(made.C() * in_size, expected[gyro, :N_STATE] * in_size, value[gyro])
        assert not made.D().any()
    period = scenario.vehicle_data.sample_period_s
    assert made.time_period() == (0.0 if point.continuous else period)


@pytest.mark.parametrize("step", STEPS)
def test_a_vehicle_at_rest_is_a_trim(step: str) -> None:
    scenario = smooth("sample_maneuver", f"plant.time_step={STEPS[step]}")
    diagram = vehicle.build(scenario)
    context = diagram.CreateDefaultContext()
    for name in ("command", "held_command"):
        diagram.GetInputPort(name).FixValue(context, np.zeros(44))
    ports = diagram.GetInputPort("command").get_index(), diagram.GetOutputPort("gyro").get_index()
    rate = np.zeros(N_STATE)
    rate[RATE] = 1.0
    drift = Linearize(diagram, context, *ports).A() @ rate  # it does not accelerate
    np.testing.assert_allclose(drift[RATE], np.ones(3) if step == "stepped" else np.zeros(3), atol=1e-12)


@pytest.mark.parametrize("lag", ["none", "vehicle"])
def test_the_symbolic_equations_of_motion_are_those_of_the_floats(lag: str) -> None:
    scenario = smooth("small_satellite_maneuver", "plant.time_step=0", f"plant.thrust_transient={lag}")
    diagram = vehicle.build(scenario)
    vector, _ = vector_at(scenario)
    flown, symbolic = Point(scenario, diagram), Point(scenario, diagram.ToSymbolic())
    flown.set(vector)
    variables = MakeVectorVariable(vector.size, "x")
    symbolic.set(variables)
    found = Evaluate(symbolic.evaluated(), dict(zip(variables, vector, strict=True)))
    np.testing.assert_allclose(found.ravel(), flown.evaluated(), rtol=1e-11, atol=1e-13)


def test_noise_vibration_a_disturbance_and_failures_have_derivatives_too() -> None:
    # they add to a reading, or to a wrench, and leave the jacobian of the body as it is but for the stuck jet
    added = [
        "plant.disturbance={torque: [100, 0, 0], force_std: [1, 0, 0]}",
        "plant.thrust_dispersion=0.05",
        "failures=[{kind: stuck_on, jet: F1F, start_s: 0}, {kind: leak, jet: F1L, start_s: 0, force: 10}]",
        "sensors.errors=[{sensor: gyro, quantum: 0, noise_std: 1.0e-4, vibration: [{frequency_hz: 3, "
        "amplitude: [1.0e-3, 0, 0]}]}, "
        + ", ".join(f"{{sensor: acc{i}, quantum: 0, bias: [1.0e-3, 0, 0], bandwidth_hz: 4}}" for i in (1, 2, 3))
        + "]",
    ]
    scenario = load_scenario("sample_maneuver", added)
    diagram = vehicle.build(scenario)
    vector, _ = vector_at(scenario)
    flown, converted = Point(scenario, diagram), Point(scenario, diagram.ToAutoDiffXd())
    flown.set(vector)
    converted.set(InitializeAutoDiff(vector).ravel())
    for name in ("gyro", "acc1", "thrust"):
        found = converted.diagram.GetOutputPort(name).Eval(converted.context)
        expected = diagram.GetOutputPort(name).Eval(flown.context)
        np.testing.assert_allclose(values(found), expected, rtol=1e-11, atol=1e-13)
    gyro = gradient(converted.diagram.GetOutputPort("gyro").Eval(converted.context), vector.size)
    np.testing.assert_array_equal(gyro[:, RATE], np.eye(3))


QUANTIZED = r"sensor 'gyro' quantizes its readings, so it has no form for {}: give it sensors.errors: \[{{sensor: gyro"


@pytest.mark.parametrize("scalar", ["AutoDiffXd", "Expression"])
def test_a_quantizer_refuses_and_says_how_to_do_without(scalar: str) -> None:
    diagram = vehicle.build(load_scenario("sample_maneuver", ["plant.time_step=0"]))
    convert = diagram.ToAutoDiffXd if scalar == "AutoDiffXd" else diagram.ToSymbolic
    with pytest.raises(InputError, match=QUANTIZED.format(scalar)):
        convert()


def test_linearize_says_so_of_a_quantizer() -> None:
    diagram = vehicle.build(load_scenario("sample_maneuver"))
    with pytest.raises(InputError, match=QUANTIZED.format("AutoDiffXd")):
        Linearize(diagram, diagram.CreateDefaultContext())


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], r"plant 'rigid_body' moves by steps .* no form for Expression: set plant.time_step: 0"),
        (
            ["plant.time_step=0", "failures=[{kind: intermittent, jet: F1F, start_s: 0, probability: 0.5}]"],
            r"'reaction_jets' has a jet that fails intermittently .*leave the intermittent failures out",
        ),
    ],
)
def test_other_parts_without_a_symbolic_form_refuse_too(overrides: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        vehicle.build(smooth("sample_maneuver", *overrides)).ToSymbolic()


def test_a_quantum_set_in_a_converted_context_is_refused_there() -> None:
    diagram = vehicle.build(smooth("sample_maneuver")).ToAutoDiffXd()
    context = diagram.CreateDefaultContext()
    gyro = diagram.GetSubsystemByName("gyro")
    gyro.parameters.set(gyro.GetMyMutableContextFromRoot(context), quantum=AutoDiffXd(1e-4))
    with pytest.raises(InputError, match="sensor 'gyro' quantizes its readings"):
        diagram.GetOutputPort("gyro").Eval(context)
