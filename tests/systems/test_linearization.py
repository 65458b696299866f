"""Linear systems of diagrams with several groups of state."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import Linearize

from massprop_drake import InputError, Scenario, load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE
from massprop_drake.systems.linearization import linearized

TURNING = "plant.initial_rate=[0.02, -0.01, 0.03]"


def smooth(name: str, *overrides: str) -> Scenario:
    """With sensors that remember, and do not quantize."""
    packages = load_scenario(name).vehicle_data.sensors
    errors = ", ".join(f"{{sensor: {one.name}, quantum: 0, noise_std: 0, bandwidth_hz: 2.0}}" for one in packages)
    return load_scenario(name, [f"sensors.errors=[{errors}]", *overrides])


def trimmed(scenario: Scenario) -> tuple[Diagram, Any]:
    """A vehicle that turns, with every jet half on."""
    dut = vehicle.build(scenario)
    context = dut.CreateDefaultContext()
    for name in ("command", "held_command"):
        dut.GetInputPort(name).FixValue(context, np.full(len(scenario.vehicle_data.jets), 0.5))
    return dut, context


@pytest.mark.parametrize("name", ["small_satellite_maneuver", "lander_maneuver"])
def test_lag_and_memory_are_linearized_as_differences_have_it(name: str) -> None:
    scenario = smooth(name, TURNING)
    dut, context = trimmed(scenario)
    found, states = (linearized(dut, context, ["command"], outputs) for outputs in (["gyro"], []))
    for matrix in "AB":
        assert_array_equal(getattr(states, matrix)(), getattr(found, matrix)())
    assert states.C().shape[0] == states.D().shape[0] == 0
    assert found.time_period() == scenario.vehicle_data.sample_period_s
    sizes = [context.get_discrete_state(group).size() for group in range(context.num_discrete_state_groups())]
    assert len(sizes) > 2
    assert found.A().shape == (sum(sizes), sum(sizes))
    groups = np.cumsum([0, *sizes])
    body = groups[sizes.index(N_STATE)]
    for place, step in ((body + RATE.start + 1, 1e-4), (body, 1e-4), (int(groups[1]) - 1, 1e-3)):
        group, ahead = int(np.searchsorted(groups, place, side="right")) - 1, []
        for sign in (1.0, -1.0):
            moved = context.Clone()
            dut.GetInputPort("command").FixValue(moved, dut.GetInputPort("command").Eval(context))
            vector = moved.get_mutable_discrete_state(group)
            vector.SetAtIndex(place - groups[group], vector.GetAtIndex(place - groups[group]) + sign * step)
            updated = dut.EvalUniquePeriodicDiscreteUpdate(moved)
            ahead.append(np.concatenate([updated.get_vector(k).CopyToVector() for k in range(len(sizes))]))
        expected = (ahead[0] - ahead[1]) / (2.0 * step)
        atol = 1e-6 * np.abs(expected).max() + 1e-11  # of rounding, over the step
        assert_allclose(found.A()[:, place], expected, rtol=1e-6, atol=atol)


def test_of_one_group_it_is_what_drake_makes() -> None:
    quiet = "sensors.errors=[{sensor: gyro, quantum: 0, noise_std: 0}, {sensor: acc, quantum: 0, noise_std: 0}]"
    one_group = [quiet, "plant.time_step=0", "plant.thrust_transient=none", TURNING]
    dut, context = trimmed(load_scenario("small_satellite_maneuver", one_group))
    found = linearized(dut, context, ["held_command"], ["gyro"])
    ports = dut.GetInputPort("held_command").get_index(), dut.GetOutputPort("gyro").get_index()
    drakes = Linearize(dut, context, *ports, equilibrium_check_tolerance=1e9)
    for name in "ABCD":
        assert_allclose(getattr(found, name)(), getattr(drakes, name)(), rtol=1e-12, atol=1e-15)
    assert found.time_period() == 0.0


LANDER = smooth("lander_maneuver")


@pytest.mark.parametrize(
    ("scenario", "inputs", "outputs", "message"),
    [
        (smooth("lander_maneuver", "plant.time_step=0"), ["command"], [], r"continuous and discrete state.*time_step"),
        (LANDER, ["command"], ["gyros"], "there is no output port 'gyros'; did you mean 'gyro'"),
        (LANDER, ["command", "command"], ["gyro"], "input port 'command' is named twice; name it once"),
        (None, [], ["body_poses"], "output port 'body_poses' has no numbers, which alone have derivatives"),
    ],
)
def test_what_has_no_linear_system_is_refused(
    scenario: Scenario | None, inputs: Any, outputs: list[str], message: str
) -> None:
    if scenario is None:
        dut: Any = MultibodyPlant(0.0)
        dut.Finalize()
        context = dut.CreateDefaultContext()
    else:
        dut, context = trimmed(scenario)
    with pytest.raises(InputError, match=message):
        linearized(dut, context, inputs, outputs)
