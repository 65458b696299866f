"""A vehicle of several bodies: its start, its joints' drives, and the star tracker beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from systems_probe import feedthrough, inputs, outputs

from massprop_drake.maths.attitude import conjugate, multiply, to_rotation_vector
from massprop_drake.maths.vehicle.joint_moves import Move
from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION, RATE, VELOCITY
from massprop_drake.systems.multibody import MultibodyVehicle, StarTracker

STOWED = {"shoulder": 1.57, "elbow": -2.8}
OUT = {"shoulder": (Move(0.5, 5.5, 0.4),), "elbow": (Move(1.0, 7.0, -0.2), Move(7.0, 8.0, -0.4))}


def _vehicle(**given: Any) -> MultibodyVehicle:
    made = {
        "positions": STOWED,
        "rates": {},
        "rate": np.zeros(3),
        "moves": {},
        "drive_frequency_hz": 2.0,
        "shown": ("shoulder", "elbow"),
    }
    return MultibodyVehicle(arm(), "bus", **{**made, **given})


def _flown(dut: MultibodyVehicle, *times_s: float) -> list[dict[str, np.ndarray]]:
    """The truth at some times, with no force from outside."""
    builder = DiagramBuilder()
    builder.AddSystem(dut)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = dut.GetMyMutableContextFromRoot(root)
    dut.GetInputPort("wrench").FixValue(context, np.zeros(7))
    dut.set_initial_velocities(root)
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    rows = []
    for time_s in times_s:
        simulator.AdvanceTo(time_s)
        rows.append({name: dut.GetOutputPort(name).Eval(context) for name in outputs(dut)})
    return rows


def test_topology() -> None:
    dut = _vehicle()
    assert inputs(dut) == {"wrench": 7}
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10, "joint_positions": 2}
    assert not any(feedthrough(dut).values())
    assert "joint_positions" not in outputs(_vehicle(shown=()))


def test_it_starts_along_the_inertial_axes_with_its_center_of_mass_at_rest_and_at_the_origin() -> None:
    rate = np.array([0.1, -0.2, 0.3])
    (start,) = _flown(_vehicle(rates={"shoulder": 0.5, "elbow": -1.0}, rate=rate), 0.0)
    body = start["body_state"]
    np.testing.assert_allclose(body[QUATERNION], [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(body[RATE], rate, atol=1e-15)
    np.testing.assert_allclose(body[[*range(7, 13)]], 0.0, atol=1e-15)
    np.testing.assert_allclose(start["joint_positions"], [1.57, -2.8], atol=0.0)
    assert body.size == N_STATE
    assert POSITION.start == 7
    assert VELOCITY.stop == 13


def test_driven_joints_follow_their_moves_and_push_nothing_outside() -> None:
    dut = _vehicle(moves=OUT, rate=np.array([0.02, 0.0, 0.01]))
    start, middle, there, end = _flown(dut, 0.0, 4.0, 7.0, 10.0)
    # halfway through its way at half the time, by symmetry of the profile
    assert middle["joint_positions"][1] == pytest.approx(-1.5, abs=5e-3)
    np.testing.assert_allclose(there["joint_positions"], [0.4, -0.2], atol=5e-3)
    np.testing.assert_allclose(end["joint_positions"], [0.4, -0.4], atol=1e-3)  # held against what the turning asks
    # no force from outside: the common center of mass stays, while it moves in the vehicle
    np.testing.assert_allclose(end["body_state"][[*range(7, 13)]], 0.0, atol=1e-8)
    assert end["structure"][6] - start["structure"][6] > 0.05


def test_joints_without_a_drive_are_free() -> None:
    spinning = _vehicle(rate=np.array([0.0, 0.0, 1.0]))
    start, end = _flown(spinning, 0.0, 2.0)
    assert np.abs(end["joint_positions"] - start["joint_positions"]).min() > 0.1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"positions": {"wrist": 1.0}},
            r"'wrist' is no joint of one degree of freedom in the model; joints are: elbow",
        ),
        ({"moves": {"wrist": ()}}, r"'wrist' is no joint"),
    ],
)
def test_an_unknown_joint_is_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _vehicle(**given)


# ------------------------------------------------------------------------------------ star tracker


def _seen(dut: StarTracker, attitude: np.ndarray, noise: np.ndarray) -> np.ndarray:
    context, body = dut.CreateDefaultContext(), np.zeros(N_STATE)
    body[QUATERNION] = attitude
    dut.GetInputPort("body_state").FixValue(context, body)
    dut.GetInputPort("structure").FixValue(context, np.zeros(9))
    dut.GetInputPort("noise").FixValue(context, noise)
    return dut.GetOutputPort("reading").Eval(context)


def test_a_star_tracker_errs_by_a_small_turn_about_the_vehicles_axes() -> None:
    attitude = np.array([0.5, -0.5, 0.5, 0.5])
    dut = StarTracker("stars", noise_std=(1e-4, 1e-4, 1e-3))
    assert outputs(dut) == {"reading": 4}
    np.testing.assert_array_equal(_seen(dut, attitude, np.zeros(3)), attitude)
    turned = multiply(conjugate(attitude), _seen(dut, attitude, np.array([1.0, -2.0, 0.5])))
    np.testing.assert_allclose(to_rotation_vector(turned), [1e-4, -2e-4, 5e-4], rtol=1e-9)


@pytest.mark.parametrize("std", [-1.0, (1.0, 2.0), (1.0, -1.0, 0.0)])
def test_a_star_tracker_without_proper_noise_is_refused(std: Any) -> None:
    with pytest.raises(ValueError, match=r"star tracker 'stars': noise_std must be a number or three, zero or more"):
        StarTracker("stars", noise_std=std)
