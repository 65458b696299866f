"""An extended Kalman filter on the vehicle's diagram, by its scalar types.

Drake's own extended Kalman filter has no Python binding in 1.51.1 and 1.58.
"""

from __future__ import annotations

import numpy as np
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.systems.framework import Diagram

from massprop_drake import load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE

NOISE = 2e-4  # rad/s, 1-sigma of a reading
TURNING = "plant.initial_rate=[0.02, -0.01, 0.015]"  # of which the filter knows nothing
TOLD = np.zeros(12)
TOLD[[0, 5]] = 1.0


def satellite(noise: float, *overrides: str) -> Scenario:
    errors = ", ".join(f"{{sensor: {name}, quantum: 0, noise_std: {noise}}}" for name in ("gyro", "acc"))
    # without lag, so that the body's is the one group of state, as the filter wants it
    quiet = [f"sensors.errors=[{errors}]", "plant.thrust_transient=none"]
    return load_scenario("small_satellite_maneuver", [*quiet, *overrides])


class Flight:
    """A diagram of the vehicle, sample by sample."""

    def __init__(self, diagram: Diagram):
        self.diagram, self.context = diagram, diagram.CreateDefaultContext()
        for name in ("command", "held_command"):
            diagram.GetInputPort(name).FixValue(self.context, TOLD)

    def step(self, sample: int) -> np.ndarray:
        """Goes on to the next sample, and returns the body there."""
        updated = self.diagram.EvalUniquePeriodicDiscreteUpdate(self.context).get_vector(0).CopyToVector()
        self.put(updated)
        self.context.SetTime((sample + 1) * 0.1)
        return updated

    def put(self, body: np.ndarray) -> None:
        self.context.get_mutable_discrete_state(0).SetFromVector(body)

    def out(self, name: str) -> np.ndarray:
        value: np.ndarray = self.diagram.GetOutputPort(name).Eval(self.context)
        return value


def split(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and jacobian of some numbers."""
    rows = [one.derivatives() if one.derivatives().size else np.zeros(N_STATE) for one in numbers]
    return np.array([one.value() for one in numbers]), np.array(rows)


def test_an_extended_kalman_filter_by_automatic_differentiation_finds_the_rate() -> None:
    truth, model = Flight(vehicle.build(satellite(NOISE, TURNING))), Flight(vehicle.build(satellite(0.0)).ToAutoDiffXd())
    estimate, covariance = split(model.context.get_discrete_state(0).CopyToVector())[0], np.diag(np.full(N_STATE, 1e-8))
    covariance[RATE, RATE] = np.diag(np.full(3, 0.02**2))
    for sample in range(60):
        model.put(InitializeAutoDiff(estimate).ravel())
        predicted, observed = split(model.out("gyro"))
        innovation = covariance @ observed.T
        gain = innovation @ np.linalg.inv(observed @ innovation + NOISE**2 * np.eye(3))
        estimate = estimate + gain @ (truth.out("gyro") - predicted)
        covariance = covariance - gain @ observed @ covariance
        error, sigma = estimate[RATE] - truth.out("body_state")[RATE], np.sqrt(np.diag(covariance)[RATE])
        model.put(InitializeAutoDiff(estimate).ravel())
        estimate, moved = split(model.step(sample))
        covariance = moved @ covariance @ moved.T + 1e-16 * np.eye(N_STATE)
        truth.step(sample)
    assert (sigma < 0.25 * NOISE).all()  # 60 readings: a seventh or so of the noise of one
    assert (np.abs(error) < 4.0 * sigma).all()
