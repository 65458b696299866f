"""Parameters of the vehicle's systems: named, of the context, and what a run goes by."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import PERFECT_SENSOR
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram
from systems_probe import PERIOD_S

from massprop_drake import InputError, load_scenario
from massprop_drake.diagrams import closed_loop, vehicle
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.rigid_body import MASS
from massprop_drake.systems import IntegratingAccelerometer, RateGyro, ReactionJets, RigidBodyPlant

BODY = MassProperties(10.0, np.array([1.0, 0.0, 0.0]), np.diag([2.0, 4.0, 5.0]))
END_S = 1.6


def plant() -> tuple[Any, Any]:
    dut = RigidBodyPlant(BODY, time_step=PERIOD_S)
    return dut, dut.CreateDefaultContext()


# ------------------------------------------------------------------------------------------- access


def test_parameters_are_read_by_name() -> None:
    dut, context = plant()
    values = dut.parameters.get(context)
    assert values.mass == 10.0
    np.testing.assert_array_equal(values.center_of_mass, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(values.inertia, [2.0, 4.0, 5.0, 0.0, 0.0, 0.0])
    assert dut.parameters.names == (
        *("mass", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z"),
        *("inertia_xx", "inertia_yy", "inertia_zz", "inertia_yz", "inertia_xz", "inertia_xy"),
    )
    # to Drake they are one group
    np.testing.assert_array_equal(context.get_numeric_parameter(0).CopyToVector(), dut.parameters.defaults)


def test_parameters_are_set_by_name_and_others_stay() -> None:
    dut, context = plant()
    dut.parameters.set(context, mass=12.0, center_of_mass_y=0.5)
    assert dut.parameters.get(context).mass == 12.0
    np.testing.assert_array_equal(dut.parameters.get(context).center_of_mass, [1.0, 0.5, 0.0])
    assert dut.parameters.get(dut.CreateDefaultContext()).mass == 10.0  # of the other context


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mas": 1.0}, r"parameter 'mas' of rigid_body: no such parameter; did you mean 'mass'\?"),
        (
            {"inertia": np.eye(3)},
            r"parameter 'inertia' of rigid_body: must be a vector of 6 numbers, got shape \(3, 3\)",
        ),
        ({"mass": [1.0, 2.0]}, r"parameter 'mass' of rigid_body: must be a number, got shape \(2,\)"),
        ({"mass": np.nan}, r"parameter 'mass' of rigid_body: must be finite, got nan"),
        ({"mass": None}, r"parameter 'mass' of rigid_body: must be finite, got None"),
        ({"mass": "heavy"}, r"parameter 'mass' of rigid_body: must be a number, got 'heavy'"),
        ({"inertia": 1j}, r"parameter 'inertia' of rigid_body: must be a vector of 6 numbers, got 1j"),
    ],
)
def test_a_parameter_that_is_not_meant_is_told(values: dict[str, Any], message: str) -> None:
    dut, context = plant()
    with pytest.raises(InputError, match=message):
        dut.parameters.set(context, **values)


def test_an_impossible_inertia_is_told() -> None:
    dut, context = plant()
    dut.parameters.set(context, inertia_xx=-1.0)
    with pytest.raises(InputError, match=r"plant 'rigid_body': inertia \(xx, yy, zz, yz, xz, xy\) must be positive"):
        dut.GetOutputPort("mass_properties").Eval(context)


# ------------------------------------------------------------------------------------ what they do


def test_outputs_follow_the_mass_properties() -> None:
    dut, context = plant()
    dut.parameters.set(context, mass=20.0, inertia_xx=8.0, center_of_mass_x=3.0)
    assert dut.GetOutputPort("body_state").Eval(context)[MASS] == 20.0
    np.testing.assert_array_equal(dut.GetOutputPort("structure").Eval(context), [8.0, 4.0, 5.0, 0, 0, 0, 3.0, 0, 0])
    np.testing.assert_allclose(
        dut.GetOutputPort("mass_properties").Eval(context), [0.125, 0.25, 0.2, 0, 0, 0, 3.0, 0, 0, 0.05], rtol=1e-15
    )


@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_mass_that_is_used_up_is_state(time_step: float) -> None:
    dut = RigidBodyPlant(BODY, time_step=time_step)
    simulator = Simulator(dut)
    context: Any = simulator.get_mutable_context()
    port = "wrench_profile" if time_step else "wrench"
    dut.GetInputPort(port).FixValue(context, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    simulator.AdvanceTo(PERIOD_S)
    simulator.AdvancePendingEvents()
    assert dut.parameters.get(context).mass == 10.0
    used = 2.0 * PERIOD_S * (2.0 if time_step else 1.0)  # a stepped body is that of the next sample already
    assert dut.GetOutputPort("body_state").Eval(context)[MASS] == pytest.approx(10.0 - used, rel=1e-14)


def test_a_thrust_factor_scales_force_torque_and_flow() -> None:
    wrenches = np.arange(1.0, 15.0).reshape(2, 7)
    dut = ReactionJets(wrenches=wrenches, time_constants_s=np.zeros(2), period_s=PERIOD_S)
    context = dut.CreateDefaultContext()
    for name in ("command", "held_command"):
        dut.GetInputPort(name).FixValue(context, np.ones(2))
    before = dut.GetOutputPort("thrust").Eval(context)
    dut.parameters.set(context, thrust_factor_1=0.5)
    np.testing.assert_allclose(dut.GetOutputPort("thrust").Eval(context), before * [1.0, 0.5], rtol=1e-15)
    for name in ("wrench", "wrench_profile"):
        np.testing.assert_allclose(dut.GetOutputPort(name).Eval(context), wrenches[0] + 0.5 * wrenches[1], rtol=1e-15)


@pytest.mark.parametrize("make", [RateGyro, IntegratingAccelerometer])
def test_errors_of_a_sensor_are_those_of_the_context(make: Any) -> None:
    place = {} if make is RateGyro else {"position": np.zeros(3)}
    dut = make("package", PERFECT_SENSOR._replace(integrates=make is not RateGyro), **place)
    context = dut.CreateDefaultContext()
    body = np.zeros(23)
    body[4:7] = body[14:17] = [0.11, -0.28, 0.4]
    dut.GetInputPort("body_state").FixValue(context, body)

    def reading(**errors: Any) -> np.ndarray:
        dut.parameters.set(context, **errors)
        return dut.GetOutputPort("reading").Eval(context)

    np.testing.assert_allclose(reading(), [0.11, -0.28, 0.4], rtol=1e-15)
    np.testing.assert_allclose(reading(scale_factor_x=1.0), [0.22, -0.28, 0.4], rtol=1e-15)
    np.testing.assert_allclose(reading(scale_factor_x=0.0, quantum=0.1), [0.1, -0.3, 0.4], rtol=1e-14)
    np.testing.assert_allclose(reading(phase=[0.25, 0.25, 0.25]), [0.075, -0.325, 0.375], rtol=1e-14)
    np.testing.assert_allclose(reading(quantum=0.0, limit=0.3), [0.11, -0.28, 0.3], rtol=1e-15)
    if make is RateGyro:
        np.testing.assert_allclose(reading(bias=[0.0, 0.0, -0.2]), [0.11, -0.28, 0.2], rtol=1e-15)


def test_noise_or_memory_that_a_sensor_was_not_built_with_is_refused() -> None:
    dut = IntegratingAccelerometer("acc", PERFECT_SENSOR._replace(integrates=True), position=np.zeros(3))
    context = dut.CreateDefaultContext()
    dut.GetInputPort("body_state").FixValue(context, np.zeros(23))
    dut.parameters.set(context, noise_std=0.1)
    with pytest.raises(InputError, match="sensor 'acc' has no noise: build it with a noise_std above zero"):
        dut.GetOutputPort("reading").Eval(context)
    dut.parameters.set(context, noise_std=0.0, bias_x=0.1)
    with pytest.raises(InputError, match="sensor 'acc' has no memory: build it with a bias or a walk_std"):
        dut.GetOutputPort("reading").Eval(context)


# --------------------------------------------------------------------- sweeps over one diagram


def own(diagram: Diagram, context: Any, name: str) -> tuple[Any, Any]:
    system = diagram.GetSubsystemByName("vehicle").GetSubsystemByName(name)
    return system.parameters, system.GetMyMutableContextFromRoot(context)


def flown(diagram: Diagram, **changed: dict[str, Any]) -> np.ndarray:
    """Body, thrust and readings at the end of a run with some parameters, by system."""
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    for name, values in changed.items():
        parameters, mine = own(diagram, context, name)
        parameters.set(mine, **values)
    simulator.AdvanceTo(END_S)
    ports = ("body_state", "structure", "mass_properties", "thrust", "gyro", "acc1")
    return np.concatenate([diagram.GetOutputPort(name).Eval(context) for name in ports])


def stated(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", ["duration_s=5", "seed=3", *overrides])


LIGHT = {"mass": 5000.0, "center_of_mass": [88.0, 0.1, 30.0], "inertia": [1.2e6, 6e6, 7e6, 100.0, -2e5, 500.0]}
CHANGES: dict[str, tuple[dict[str, dict[str, Any]], list[str]]] = {
    "mass properties": (
        {"rigid_body": LIGHT},
        [
            "plant.mass_properties={mass: 5000, center_of_mass: [88.0, 0.1, 30.0], "
            "inertia: [[1.2e+6, 500, -2.0e+5], [500, 6.0e+6, 100], [-2.0e+5, 100, 7.0e+6]]}"
        ],
    ),
    "dispersion": ({"reaction_jets": {"thrust_dispersion": 0.03}}, ["plant.thrust_dispersion=0.03"]),
    "sensors": (
        {"gyro": {"scale_factor_x": 0.01, "quantum": 1e-5}, "acc1": {"scale_factor": [0.1, 0.2, 0.3]}},
        [
            "sensors.errors=[{sensor: gyro, scale_factor: [0.01, 0, 0], quantum: 1.0e-5}, "
            "{sensor: acc1, scale_factor: [0.1, 0.2, 0.3]}]"
        ],
    ),
}


@pytest.mark.parametrize("step", ["null", "0"])
@pytest.mark.parametrize("change", CHANGES)
def test_a_parameter_changes_a_run_as_the_scenario_would(change: str, step: str) -> None:
    parameters, overrides = CHANGES[change]
    diagram = closed_loop.build(stated(f"plant.time_step={step}"))
    default, changed = flown(diagram), flown(diagram, **parameters)
    np.testing.assert_array_equal(changed, flown(closed_loop.build(stated(f"plant.time_step={step}", *overrides))))
    assert (changed != default).any()
    np.testing.assert_array_equal(flown(diagram), default)


def test_a_payload_leaves_a_vehicle_of_other_mass_properties() -> None:
    jump = "jumps=[{kind: release, time_s: 0.4, mass: 300, position: [88, 2, 31]}]"
    _, overrides = CHANGES["mass properties"]
    found = flown(closed_loop.build(stated(jump)), rigid_body=LIGHT)
    np.testing.assert_array_equal(found, flown(closed_loop.build(stated(jump, *overrides))))


def test_a_floor_carries_a_vehicle_wherever_its_center_of_mass_is() -> None:
    scenario = load_scenario("air_bearing_pulses")
    diagram = vehicle.build(scenario)
    context: Any = diagram.CreateDefaultContext()
    jets = len(scenario.vehicle_data.jets)
    for name in ("command", "held_command"):
        diagram.GetInputPort(name).FixValue(context, np.linspace(0.2, 1.0, jets))
    body = diagram.GetSubsystemByName("rigid_body")
    body.parameters.set(body.GetMyMutableContextFromRoot(context), center_of_mass=[0.02, -0.03, 0.05])
    profile = diagram.GetSubsystemByName("reaction_jets").GetOutputPort("wrench_profile")
    wrench = profile.Eval(profile.get_system().GetMyContextFromRoot(context))[:7]
    about_center = wrench[:3] - np.cross([0.02, -0.03, 0.05], wrench[3:6])
    np.testing.assert_allclose(about_center[:2], 0.0, atol=1e-15)
    assert wrench[5] == 0.0
    assert about_center[2] != 0.0
