"""Filters on the vehicle's diagram: Drake's steady-state Kalman filter, and an extended one by its scalar types.

Drake's own extended Kalman filter has no Python binding in 1.51.1 and 1.58.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.systems.analysis import Simulator
from pydrake.systems.estimators import DiscreteTimeSteadyStateKalmanFilter, LuenbergerObserver
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Linearize

from massprop_drake import load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE

RATE_AT_START = np.array([0.02, -0.01, 0.015])  # rad/s, of which the filters know nothing
NOISE = 2e-4  # rad/s, 1-sigma of a reading


def satellite(noise: float, *overrides: str) -> Scenario:
    errors = ", ".join(f"{{sensor: {name}, quantum: 0, noise_std: {noise}}}" for name in ("gyro", "acc"))
    # without lag, so that the body's is the one group of state, as both filters want it
    quiet = [f"sensors.errors=[{errors}]", "plant.thrust_transient=none"]
    return load_scenario("small_satellite_maneuver", [*quiet, *overrides])


def turning() -> Scenario:
    return satellite(NOISE, f"plant.initial_rate={RATE_AT_START.tolist()}")


def commands(sample: int) -> np.ndarray:
    """Two jets on, others by turns."""
    told = np.zeros(12)
    told[[0, 5, sample // 10 % 12]] = 1.0
    return told


class Flight:
    """A diagram of the vehicle, sample by sample."""

    def __init__(self, diagram: Diagram):
        self.diagram, self.context = diagram, diagram.CreateDefaultContext()
        self.body: Any = self.context.get_discrete_state(0)

    def step(self, sample: int, period_s: float) -> None:
        """Takes the command of a sample to the next."""
        told = commands(sample)
        for name in ("command", "held_command"):
            self.diagram.GetInputPort(name).FixValue(self.context, told)
        updated = self.diagram.EvalUniquePeriodicDiscreteUpdate(self.context).get_vector(0).CopyToVector()
        self.context.get_mutable_discrete_state(0).SetFromVector(updated)
        self.context.SetTime((sample + 1) * period_s)

    def out(self, name: str) -> np.ndarray:
        """A port's value."""
        value: np.ndarray = self.diagram.GetOutputPort(name).Eval(self.context)
        return value


def split(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and jacobian of some numbers."""
    rows = [one.derivatives() if one.derivatives().size else np.zeros(N_STATE) for one in numbers]
    return np.array([one.value() for one in numbers]), np.array(rows)


def test_an_extended_kalman_filter_by_automatic_differentiation_finds_the_rate() -> None:
    scenario = turning()
    period_s = scenario.vehicle_data.sample_period_s
    truth, model = Flight(vehicle.build(scenario)), Flight(vehicle.build(satellite(0.0)).ToAutoDiffXd())
    estimate = model.body.CopyToVector()
    estimate = np.array([one.value() for one in estimate])
    covariance = np.diag(np.full(N_STATE, 1e-8))
    covariance[RATE, RATE] = np.diag(np.full(3, 0.02**2))
    process = 1e-16 * np.eye(N_STATE)
    for sample in range(60):
        model.context.get_mutable_discrete_state(0).SetFromVector(InitializeAutoDiff(estimate).ravel())
        predicted, observed = split(model.out("gyro"))
        innovation = covariance @ observed.T
        gain = innovation @ np.linalg.inv(observed @ innovation + NOISE**2 * np.eye(3))
        estimate = estimate + gain @ (truth.out("gyro") - predicted)
        covariance = covariance - gain @ observed @ covariance
        if sample == 59:
            break
        model.context.get_mutable_discrete_state(0).SetFromVector(InitializeAutoDiff(estimate).ravel())
        model.step(sample, period_s)
        estimate, moved = split(model.body.CopyToVector())
        covariance = moved @ covariance @ moved.T + process
        truth.step(sample, period_s)
    error, sigma = estimate[RATE] - truth.out("body_state")[RATE], np.sqrt(np.diag(covariance)[RATE])
    assert (sigma < 0.25 * NOISE).all()  # 60 readings: a seventh or so of the noise of one
    assert (np.abs(error) < 4.0 * sigma).all()


def seen(scenario: Scenario, name: str) -> Diagram:
    """The vehicle with one input, its commands, and one output, the body's state."""
    builder = DiagramBuilder()
    body = builder.AddNamedSystem("vehicle", vehicle.build(scenario))
    quiet = builder.AddSystem(ConstantVectorSource(np.zeros(12)))
    builder.Connect(quiet.get_output_port(), body.GetInputPort("held_command"))
    builder.ExportInput(body.GetInputPort("command"), "command")
    builder.ExportOutput(body.GetOutputPort("body_state"), "body_state")
    built = builder.Build()
    built.set_name(name)
    return built


def test_drake_s_observer_with_a_steady_state_kalman_gain_follows_the_vehicle() -> None:
    model = seen(satellite(0.0), "model")
    context = model.CreateDefaultContext()
    model.get_input_port().FixValue(context, np.zeros(12))
    line = Linearize(model, context)
    gain = DiscreteTimeSteadyStateKalmanFilter(line.A(), line.C(), 1e-8 * np.eye(N_STATE), 1e-8 * np.eye(N_STATE))

    builder = DiagramBuilder()
    truth = builder.AddNamedSystem("truth", seen(turning(), "truth"))
    observer = builder.AddNamedSystem("observer", LuenbergerObserver(model, context, gain))
    command = builder.AddSystem(ConstantVectorSource(commands(0)))
    builder.Connect(command.get_output_port(), truth.get_input_port())
    builder.Connect(truth.get_output_port(), observer.GetInputPort("observed_system_output"))
    builder.Connect(command.get_output_port(), observer.GetInputPort("observed_system_input"))
    builder.ExportOutput(truth.get_output_port(), "truth")
    builder.ExportOutput(observer.get_output_port(), "estimate")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    at_rest = context.get_discrete_state(0).CopyToVector()
    root = simulator.get_mutable_context()
    observer.GetMyMutableContextFromRoot(root).get_mutable_discrete_state(0).SetFromVector(at_rest)
    errors = []
    for _ in range(2):
        found = [diagram.GetOutputPort(name).Eval(root)[RATE] for name in ("truth", "estimate")]
        errors.append(np.abs(found[0] - found[1]).max())
        simulator.AdvanceTo(3.0)
    assert errors[0] > 0.01
    assert errors[1] < 1e-6
