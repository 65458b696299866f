"""Simulated runs that the numbers of their scenario bring to an end."""

from __future__ import annotations

import itertools
import re
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from telemetry_probe import toy_vehicle

from massprop_drake import InputError, Run, load_scenario, simulate
from massprop_drake.diagrams import closed_loop
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filters import rotation_filter
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

# a jet of 10 N and 70 s uses 0.0145673 kg/s
FLOW = 10.0 / (9.80665 * 70.0)


def _pushing(toy_data: dict[str, Any], mass: float, **changes: Any) -> Scenario:
    """Two jets push along x from 0.2 s on."""
    toy_data["mass_properties"]["mass"] = mass
    pulses = [{"jet": jet, "start_s": 0.2, "end_s": 1.0} for jet in ("J1", "J2")]
    data = {"vehicle": toy_vehicle(toy_data), "duration_s": 1.0, "jet_schedule": pulses, **changes}
    return validate_data(Scenario, data)


@pytest.mark.parametrize("time_step", [None, 0.0])
def test_a_vehicle_that_runs_out_of_mass_is_told(toy_data: dict[str, Any], time_step: float | None) -> None:
    scenario = _pushing(toy_data, 2.0 * FLOW * 0.35, plant={"time_step": time_step})  # lasts until 0.55 s
    left = f"{2.0 * FLOW * 0.05:.6g} kg are left" if time_step is None else "kg are left"
    with pytest.raises(InputError, match=rf"at t = 0\.5\S* s the vehicle runs out of mass: .*{left}"):
        simulate(scenario)


def test_an_accuracy_that_cannot_be_had_is_told(toy_data: dict[str, Any]) -> None:
    scenario = _pushing(toy_data, 100.0, plant={"time_step": 0.0})
    plant = scenario.plant.model_copy(update={"accuracy": 1e-100})  # no file may ask for it
    scenario = scenario.model_copy(update={"plant": plant})
    with pytest.raises(InputError, match=r"plant.accuracy: the continuous plant cannot be integrated to 1e-100"):
        simulate(scenario)


def test_a_covariance_that_loses_definiteness_is_named(
    toy_data: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    innovate, calls = rotation_filter.innovate, itertools.count()

    def failing(*arguments: Any) -> Any:
        if next(calls) == 4:
            raise NotPositiveDefiniteError(np.zeros((3, 3)), "the rotation filter's innovation covariance")
        return innovate(*arguments)

    monkeypatch.setattr(rotation_filter, "innovate", failing)
    with pytest.raises(InputError) as caught:
        simulate(_pushing(toy_data, 100.0, estimation={"filter": "thesis"}))
    message = str(caught.value)
    assert "scenario 'scenario': the filters cannot go on: rotation_estimator: " in message
    assert re.search(
        r"the rotation filter's innovation covariance is not positive definite at t = 0\.\d s; check", message
    )
    assert "\n" not in message


class _Interrupts(LeafSystem):
    """A user's system that raises once, at its update at a time, in the middle of the simulator's step."""

    def __init__(self, at_s: float, period_s: float):
        super().__init__()
        self.set_name("interrupts")
        self._next_s = at_s
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(period_s, 0.0, self._update)

    def _update(self, context: Any, _state: Any) -> None:
        if context.get_time() >= self._next_s:
            self._next_s = np.inf
            raise KeyboardInterrupt


def test_a_run_interrupted_in_the_middle_of_a_step_has_its_state() -> None:
    scenario = load_scenario("small_satellite_leak", ["duration_s=6"])
    builder = DiagramBuilder()
    builder.AddNamedSystem("loop", closed_loop.build(scenario))
    builder.AddSystem(_Interrupts(3.0, 0.1))
    kept: list[Run] = []
    with pytest.raises(KeyboardInterrupt):
        simulate(scenario, diagram=builder, keep=kept.append)
    (run,) = kept
    whole = simulate(load_scenario("small_satellite_leak", ["duration_s=3"]))
    assert run.results.missing == ()
    assert run.time_s[-1] == whole.time_s[-1] == 3.0
    assert run.state["states"] == whole.state["states"]
    np.testing.assert_array_equal(run["estimate"], whole["estimate"])
