"""True engines: against an integration of the equations of motion, in both kinds of plants; failures; the gimbal."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from massprop_drake import Run, simulate
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import load_vehicle

Array = NDArray[np.float64]
ENGINE = {
    "name": "main",
    "position": [-0.3, 0.02, -0.01],
    "direction": [1.0, 0.0, 0.0],
    "thrust": 8.0,
    "specific_impulse_s": [{"level": 0.2, "specific_impulse_s": 200.0}, {"level": 1.0, "specific_impulse_s": 230.0}],
    "level_time_constant_s": 0.15,
    "level_noise_std": 0.0,
    "gimbal": {"axes": [[0, 1, 0], [0, 0, 1]], "stop": 0.2, "rate": 0.1, "noise_std": 0.0},
}
BURN = {"engine": "main", "start_s": 0.5, "end_s": 2.0, "level": 0.8, "gimbal": [0.05, -0.08]}
ERRORS = {"thrust": [0.02, -0.01], "direction": [0.01, -0.02], "position": [0.005, -0.004]}


def scenario(engine: dict[str, Any] | None = None, **changed: Any) -> Scenario:
    """The small satellite with an engine that burns for a second and a half."""
    data = load_vehicle("small_satellite").model_dump()
    for jet in data["jets"]:
        jet.pop("mass_flow", None)
    engines = [{**ENGINE, **(engine or {})}]
    made = {"vehicle": {**data, "engines": engines}, "duration_s": 3.0, "engine_schedule": [BURN]}
    plant = {"engine_errors": {"main": ERRORS}, **changed.pop("plant", {})}
    return Scenario.model_validate({**made, "detector": {"kind": "off"}, "plant": plant, **changed})


def followed(time_s: float) -> tuple[float, Array]:
    """Level and angles as they follow the schedule."""
    on_s = min(max(time_s - 0.5, 0.0), 1.5)
    level = 0.8 * (1.0 - np.exp(-on_s / 0.15)) * np.exp(-max(time_s - 2.0, 0.0) / 0.15)
    at_rate = 0.1 * on_s
    back = 0.1 * max(time_s - 2.0, 0.0)
    return level, np.array([max(min(at_rate, 0.05) - back, 0.0), min(max(-at_rate, -0.08) + back, 0.0)])


def integrated(made: Scenario, until_s: float) -> tuple[Array, float]:
    """Rate and mass at the end, by equations written down once more."""
    body = made.vehicle_data.nominal

    def flow(time_s: float, state: Array) -> Array:
        level, (one, two) = followed(time_s)
        turned = Rotation.from_rotvec([0.0, one + 0.01, 0.0]) * Rotation.from_rotvec([0.0, 0.0, two - 0.02])
        force = 8.0 * level * (1.0 + 0.02 * (1.0 - level) - 0.01 * level) * turned.apply([1.0, 0.0, 0.0])
        place = np.array([-0.3, 0.02 + 0.005, -0.01 - 0.004])
        torque = np.cross(place - body.center_of_mass, force)
        rate = np.linalg.solve(body.inertia, torque - np.cross(state[:3], body.inertia @ state[:3]))
        known = [(0.0, 0.0), (0.2, 8.0 * 0.2 / (9.80665 * 200.0)), (1.0, 8.0 / (9.80665 * 230.0))]
        return np.append(rate, -np.interp(level, *np.array(known).T))

    start = np.append(np.zeros(3), body.mass)
    end = solve_ivp(flow, (0.0, until_s), start, rtol=1e-10, atol=1e-12, max_step=0.01).y[:, -1]
    return end[:3], float(end[3])


@cache
def flown(step: float | None = None) -> Run:
    """A run of it with either plant; do not change its arrays."""
    return simulate(scenario(plant={"time_step": step}), look_back=False)


@pytest.mark.parametrize("step", [None, 0.0])
def test_the_vehicle_moves_as_the_equations_of_motion_have_it(step: float | None) -> None:
    run = flown(step)
    rate, mass = integrated(run.scenario, float(run.time_s[-1]))
    # a step has the mean of the wrench over a sample, by fifty instants
    np.testing.assert_allclose(run["rate"][-1], rate, atol=2e-4 * np.abs(rate).max())
    assert 1.0 / run["truth"][-1, 9] == pytest.approx(mass, abs=1e-4 * (run.scenario.vehicle_data.nominal.mass - mass))


def test_what_telemetry_has_is_what_is_or_what_is_told() -> None:
    measured = flown()["main"]
    commanded = simulate(scenario({"telemetry": "commanded"}, duration_s=1.5), look_back=False)["main"]
    row = 10
    level, angles = followed(row * 0.1)
    np.testing.assert_allclose(measured[row], [level, *angles], atol=1e-9)
    np.testing.assert_allclose(commanded[row], [0.8, 0.05, -0.08], atol=1e-12)


def test_an_engine_that_is_out_gives_nothing_and_one_that_is_stuck_goes_on() -> None:
    out = simulate(
        scenario(engine_failures=[{"engine": "main", "kind": "out", "start_s": 0.2}], duration_s=1.5), look_back=False
    )
    assert np.abs(out["rate"]).max() == 0.0
    stuck = {"engine": "main", "kind": "level_stuck", "start_s": 1.8}
    goes_on = simulate(scenario(engine_failures=[stuck]), look_back=False)
    assert goes_on["main"][-1, 0] == pytest.approx(followed(1.8)[0], abs=1e-6)


def test_a_gimbal_holds_the_rate() -> None:
    """A center of mass off the line of thrust turns the vehicle, unless the gimbal points the thrust through it."""
    burn = [{**BURN, "gimbal": [0.0, 0.0], "end_s": 4.0}]
    held, free = (
        simulate(
            scenario(duration_s=4.0, engine_schedule=burn, autopilot={"gimbal_bandwidth": bandwidth}), look_back=False
        )
        for bandwidth in (1.5, 0.0)
    )
    assert np.abs(held["rate"][-1]).max() < 0.1 * np.abs(free["rate"][-1]).max()
    assert np.abs(held["main"][-5, 1:]).max() > 0.01
