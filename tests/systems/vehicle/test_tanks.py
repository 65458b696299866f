"""Tanks of the true vehicle: what jets draw moves its mass properties, in the diagram, in the loop and by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from massprop_drake import InputError, Run, load_vehicle, simulate
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.mass_properties import ELEMENT

Array = NDArray[np.float64]
TANK: dict[str, Any] = {
    "name": "fuel",
    "outlet": [0.05, 0.1, -0.35],
    "axis": [0.0, 0.0, 1.0],
    "length": 0.8,
    "radius": 0.25,
    "capacity": 44.0,
    "propellant": 40.0,
    "feeds": ["main"],
}


def vehicle(*tanks: dict[str, Any]) -> dict[str, Any]:
    """The servicer with tanks, thrust without lag, and a specific impulse so low that they empty soon."""
    made = load_vehicle("servicer").model_dump()
    for kind in made["jet_kinds"].values():
        kind |= {"specific_impulse_s": 20.0, "time_constant_s": 0.0}
    return made | {"tanks": list(tanks or (TANK,))}


def flown(**changed: Any) -> Run:
    """Two seconds in which main jets fire apart from each other, and one of the small ones with them."""
    pulses = [("M1", 0.0, 1.6), ("M4", 0.2, 1.9), ("M2", 0.5, 1.2), ("YP1", 0.3, 1.5)]
    schedule = [{"jet": jet, "start_s": start, "end_s": end} for jet, start, end in pulses]
    plant = {"propellant": {"fuel": 30.0}, "thrust_dispersion": 0.02, **changed.pop("plant", {})}
    off = {"detector": {"kind": "off"}}
    made = {"vehicle": vehicle(), "duration_s": 2.0, "seed": 3, "plant": plant, "jet_schedule": schedule, **off}
    return simulate(Scenario.model_validate(made | changed), look_back=False)


def test_diagram_and_loop_agree_to_the_bit() -> None:
    one, other = flown(), flown(execution={"engine": "loop"})
    for name in ("truth", "propellant", "rate", "position", "velocity", "acc"):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert one["propellant"][0, 0] == 30.0
    assert one["propellant"][-1, 0] < 29.6


def test_a_continuous_plant_has_the_same_truth() -> None:
    stepped, continuous = flown(), flown(plant={"time_step": 0.0, "accuracy": 1e-10})
    np.testing.assert_array_equal(continuous["propellant"], stepped["propellant"])
    np.testing.assert_allclose(continuous["truth"], stepped["truth"], rtol=1e-9, atol=1e-12)
    gained = np.abs(stepped["rate"]).max()
    np.testing.assert_allclose(continuous["rate"], stepped["rate"], atol=1e-7 * gained)
    np.testing.assert_allclose(continuous["velocity"], stepped["velocity"], atol=3e-7)


def test_the_rate_is_that_of_eulers_equation_with_what_is_left() -> None:
    """Integrate it by itself, with inertia and center of mass that go along as propellant leaves."""
    run = flown(duration_s=1.0)
    truth, rate, period = run["truth"], run["rate"], 0.1
    data = run.scenario.vehicle_data
    ways = data.thrusts / np.linalg.norm(data.thrusts, axis=1)[:, None]
    for row in range(10):
        forces = run["thrust"][row][:, None] * ways

        def turning(time_s: float, w: Array, row: int = row, forces: Array = forces) -> Array:
            now = truth[row] + (truth[row + 1] - truth[row]) * time_s / period
            inverse = now[:6][ELEMENT]
            torque = np.cross(data.positions - now[6:9], forces).sum(axis=0)
            return np.asarray(inverse @ (torque - np.cross(w, np.linalg.inv(inverse) @ w)))

        after = solve_ivp(turning, (0.0, period), rate[row], rtol=1e-11, atol=1e-14).y[:, -1]
        np.testing.assert_allclose(rate[row + 1], after, atol=2e-9)


def test_an_empty_tank_ends_a_run_in_one_message() -> None:
    with pytest.raises(InputError, match=r"at t = [\d.]+ s tank 'fuel' is empty; put more in it"):
        flown(plant={"propellant": {"fuel": 0.1}})


def test_a_tank_that_is_not_there_or_holds_less_is_refused() -> None:
    other = TANK | {"name": "spare", "feeds": ["M2"], "propellant": 1.0}
    with pytest.raises(ValueError, match="jet M2 draws from tank 'fuel' already"):
        Scenario.model_validate({"vehicle": vehicle(TANK, other), "duration_s": 1.0})
    with pytest.raises(ValueError, match="'feul' is no tank of vehicle 'servicer'; did you mean 'fuel'"):
        flown(plant={"propellant": {"feul": 3.0}})
    with pytest.raises(ValueError, match="must be between 0 and the tank's capacity, 44, got 50"):
        flown(plant={"propellant": {"fuel": 50.0}})
