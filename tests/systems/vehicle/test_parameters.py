"""Parameters of the vehicle's systems: named, of the context, and what a run goes by."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram
from systems_probe import PERIOD_S, output

from massprop_drake import InputError, load_scenario
from massprop_drake.diagrams import closed_loop
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.rigid_body import MASS
from massprop_drake.systems import RigidBodyPlant

BODY = MassProperties(10.0, np.array([1.0, 0.0, 0.0]), np.diag([2.0, 4.0, 5.0]))


def plant(time_step: float = PERIOD_S) -> tuple[Any, Any]:
    dut = RigidBodyPlant(BODY, time_step=time_step)
    return dut, dut.CreateDefaultContext()


def test_parameters_are_read_and_set_by_name() -> None:
    dut, context = plant()
    assert_array_equal(context.get_numeric_parameter(0).CopyToVector(), dut.parameters.defaults)  # one group to Drake
    assert dut.parameters.names == (
        *("mass", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z"),
        *("inertia_xx", "inertia_yy", "inertia_zz", "inertia_yz", "inertia_xz", "inertia_xy"),
    )
    dut.parameters.set(context, mass=12.0, center_of_mass_y=0.5)
    values = dut.parameters.get(context)
    assert values.mass == 12.0 == dut.parameters.element(context, "mass")
    assert_array_equal(values.center_of_mass, [1.0, 0.5, 0.0])
    assert_array_equal(values.inertia, [2.0, 4.0, 5.0, 0.0, 0.0, 0.0])
    assert dut.parameters.get(dut.CreateDefaultContext()).mass == 10.0  # of the other context


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mas": 1.0}, r"parameter 'mas' of rigid_body: no such parameter; did you mean 'mass'\?"),
        ({"inertia": np.eye(3)}, r"'inertia' of rigid_body: must be a vector of 6 numbers, got shape \(3, 3\)"),
        ({"mass": np.nan}, r"parameter 'mass' of rigid_body: must be finite, got nan"),
        ({"mass": "heavy"}, r"parameter 'mass' of rigid_body: must be a number, got 'heavy'"),
        ({"inertia_xx": -1.0}, r"plant 'rigid_body': inertia \(xx, yy, zz, yz, xz, xy\) must be positive"),
    ],
)
def test_a_parameter_that_is_not_meant_is_told(values: dict[str, Any], message: str) -> None:
    dut, context = plant()

    def used() -> None:
        dut.parameters.set(context, **values)
        output(dut, context, "mass_properties")

    with pytest.raises(InputError, match=message):
        used()


@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_mass_that_is_used_up_is_state(time_step: float) -> None:
    dut, _ = plant(time_step)
    simulator = Simulator(dut)
    context: Any = simulator.get_mutable_context()
    output(dut, context, "body_state", **{"wrench_profile" if time_step else "wrench": 2.0 * np.eye(7)[6]})
    simulator.AdvanceTo(PERIOD_S)
    simulator.AdvancePendingEvents()
    assert dut.parameters.get(context).mass == 10.0
    used = 2.0 * PERIOD_S * (2.0 if time_step else 1.0)  # a stepped body is that of the next sample already
    assert output(dut, context, "body_state")[MASS] == pytest.approx(10.0 - used, rel=1e-14)


def flown(diagram: Diagram, **changed: dict[str, Any]) -> np.ndarray:
    """Body, thrust and readings at the end of a run with some parameters, by system."""
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    for name, values in changed.items():
        system = diagram.GetSubsystemByName("vehicle").GetSubsystemByName(name)
        system.parameters.set(system.GetMyMutableContextFromRoot(context), **values)
    simulator.AdvanceTo(1.6)
    ports = ("body_state", "structure", "mass_properties", "thrust", "gyro", "acc1")
    return np.concatenate([diagram.GetOutputPort(name).Eval(context) for name in ports])


def built(*overrides: str) -> Diagram:
    return closed_loop.build(load_scenario("sample_maneuver", ["duration_s=5", "seed=3", *overrides]))


JUMP = "jumps=[{kind: release, time_s: 0.4, mass: 300, position: [88, 2, 31]}]"
CHANGES: dict[str, tuple[dict[str, dict[str, Any]], str]] = {
    "mass properties": (
        {"rigid_body": {"mass": 5e3, "center_of_mass": [88.0, 0.1, 30], "inertia": [1.2e6, 6e6, 7e6, 100, -2e5, 500]}},
        "plant.mass_properties={mass: 5000, center_of_mass: [88.0, 0.1, 30.0], "
        "inertia: [[1.2e+6, 500, -2.0e+5], [500, 6.0e+6, 100], [-2.0e+5, 100, 7.0e+6]]}",
    ),
    "dispersion": ({"reaction_jets": {"thrust_dispersion": 0.03}}, "plant.thrust_dispersion=0.03"),
    "sensors": (
        {"gyro": {"scale_factor_x": 0.01, "quantum": 1e-5}, "acc1": {"scale_factor": [0.1, 0.2, 0.3]}},
        "sensors.errors=[{sensor: gyro, scale_factor: [0.01, 0, 0], quantum: 1.0e-5}, "
        "{sensor: acc1, scale_factor: [0.1, 0.2, 0.3]}]",
    ),
}


@pytest.mark.parametrize(
    ("change", "given"),
    [("mass properties", "plant.time_step=0"), ("mass properties", JUMP), ("dispersion", JUMP), ("sensors", JUMP)],
)
def test_a_parameter_changes_a_run_as_the_scenario_would(change: str, given: str) -> None:
    parameters, override = CHANGES[change]
    diagram = built(given)
    default, changed = flown(diagram), flown(diagram, **parameters)
    assert_array_equal(changed, flown(built(given, override)))
    assert (changed != default).any()
    assert_array_equal(flown(diagram), default)
