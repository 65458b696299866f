"""The true vehicle against Drake's MultibodyPlant, and its two plants against each other."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, Propeller, PropellerInfo
from pydrake.multibody.tree import RotationalInertia, SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderLowPassFilter, LogVectorOutput

from massprop_drake import Run, Vehicle, simulate
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.maths.attitude import conjugate, multiply, rotation_matrix, to_rotation_vector
from massprop_drake.systems.autopilot.jet_schedule import JetSchedule

Array = NDArray[np.float64]

DURATION_S = 9.6  # of 120 samples
TOLERANCE = 1e-9  # rad/s, and rad: what the two kinds of plant and the truth must agree to over 50 s
# With a lag the stepped plant's rates are within 7e-11 rad/s of the truth, which adds up over 50 s
LAGGING_ANGLE = 1e-8  # rad

# the filter that takes least time: what is estimated does not matter here
PLANT_ALONE = {"estimation": {"filter": "thesis"}, "detector": {"kind": "off"}}


class Motion(NamedTuple):
    """A body's motion at the samples: rate, body axes, attitude q_NB, velocity and position, inertial axes."""

    rate: Array
    attitude: Array
    velocity: Array
    position: Array


def motion(run: Run) -> Motion:
    return Motion(*(run[name] for name in Motion._fields))


def pulses(commands: Array, vehicle: Vehicle) -> list[dict[str, Any]]:
    """A table of commands as a jet schedule; edges half a sample early, so that rounding cannot move them."""
    period, found = vehicle.sample_period_s, []
    for jet, designation in enumerate(vehicle.designations):
        edges = np.flatnonzero(np.diff(np.concatenate([[0.0], commands[:, jet], [0.0]])))
        for first, last in edges.reshape(-1, 2).tolist():
            times = {"start_s": max(0.0, (first - 0.5) * period), "end_s": (last - 0.5) * period}
            found.append({"jet": designation, **times})
    return found


@pytest.fixture(scope="module")
def commands(sample_run: Run) -> Array:
    """Jets commanded in the sample maneuver, a row per sample: from its last rotation into its translations."""
    return sample_run["command"][280:400]


@pytest.fixture(scope="module")
def prescribed(orbiter: Vehicle, commands: Array) -> Callable[..., Run]:
    """Runs these commands in open loop, by choices of the plant; each choice once."""
    data = {**PLANT_ALONE, "vehicle": "orbiter", "duration_s": DURATION_S, "jet_schedule": pulses(commands, orbiter)}

    @cache
    def run(**plant: Any) -> Run:
        return simulate(resolve_scenario({**data, "plant": {"depletion": False, **plant}}), look_back=False)

    return run


def truth_of(vehicle: Vehicle, commands: Array, *, lag: bool) -> Motion:
    """The same by Drake: a free body with a propeller for each jet, and a low-pass filter for the lag."""
    period = vehicle.sample_period_s
    properties = vehicle.nominal
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = properties.inertia
    inertia = RotationalInertia(xx, yy, zz, xy, xz, yz)
    body = plant.AddRigidBody("vehicle", SpatialInertia.MakeFromCentralInertia(properties.mass, np.zeros(3), inertia))
    plant.Finalize()

    jets = []
    fires = np.flatnonzero(commands.any(axis=0))
    for jet in (vehicle.jets[index] for index in fires):  # a propeller pushes along its z axis
        axis = np.array(jet.direction) / np.linalg.norm(jet.direction)
        pose = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2), jet.position - properties.center_of_mass)
        jets.append(PropellerInfo(body.index(), pose, jet.thrust, 0.0))
    propellers = builder.AddSystem(Propeller(jets))
    schedule = builder.AddSystem(JetSchedule(commands[:, fires], period_s=period))
    if lag:
        filters = builder.AddSystem(FirstOrderLowPassFilter(vehicle.time_constants_s[fires]))
        builder.Connect(schedule.GetOutputPort("held_command"), filters.get_input_port())
        builder.Connect(filters.get_output_port(), propellers.get_command_input_port())
    else:
        builder.Connect(schedule.GetOutputPort("held_command"), propellers.get_command_input_port())
    builder.Connect(plant.get_body_poses_output_port(), propellers.get_body_poses_input_port())
    builder.Connect(propellers.get_spatial_forces_output_port(), plant.get_applied_spatial_force_input_port())
    sink = LogVectorOutput(plant.get_state_output_port(), builder, period)

    simulator = Simulator(builder.Build())
    # error control alone leaves 1e-8 rad where thrust sets in: a third of a time constant leaves 1e-10
    longest = 0.005 if lag else period
    config = SimulatorConfig(
        integration_scheme="runge_kutta5", max_step_size=longest, accuracy=1e-12, use_error_control=True
    )
    ApplySimulatorConfig(config, simulator)
    context = simulator.get_mutable_context()
    simulator.Initialize()
    simulator.AdvanceTo(commands.shape[0] * period)
    # quaternion, position, angular velocity and velocity, all in the world
    states = np.array(sink.FindLog(context).data().T)
    rate = np.array([rotation_matrix(state[:4]).T @ state[7:10] for state in states])
    return Motion(rate, states[:, :4], states[:, 10:], states[:, 4:7])


def assert_same(found: Motion, expected: Motion, angle: float) -> None:
    np.testing.assert_allclose(found.rate, expected.rate, rtol=0.0, atol=TOLERANCE)
    turned = [multiply(conjugate(a), b) for a, b in zip(found.attitude, expected.attitude, strict=True)]
    assert max(np.linalg.norm(to_rotation_vector(each)) for each in turned) < angle
    # the angle turns a velocity change of about 1 ft/s, and all that time of it is in the position
    np.testing.assert_allclose(found.velocity, expected.velocity, rtol=0.0, atol=angle)
    np.testing.assert_allclose(found.position, expected.position, rtol=0.0, atol=50.0 * angle)


@pytest.mark.parametrize("transient", ["none", "vehicle"])
def test_both_plants_move_as_a_multibody_plant_does(
    prescribed: Callable[..., Run], commands: Array, orbiter: Vehicle, transient: str
) -> None:
    """With a lag, as one with filters does."""
    stepped, continuous = (prescribed(thrust_transient=transient, time_step=step) for step in (None, 0.0))
    np.testing.assert_array_equal(stepped["command"][:-1], commands)
    assert commands.any(axis=0).sum() > 10  # many jets take part
    angle, expected = TOLERANCE, truth_of(orbiter, commands, lag=transient == "vehicle")
    if transient == "vehicle":
        angle = LAGGING_ANGLE
        without = prescribed(thrust_transient="none", time_step=None)  # or the same thing would be compared twice
        assert np.abs(without["rate"] - expected.rate).max() > 1e5 * TOLERANCE
    for run in (stepped, continuous):
        assert_same(motion(run), expected, angle)


@pytest.mark.parametrize("transient", ["none", "vehicle"])
def test_firing_uses_up_thrust_times_time_over_specific_impulse_in_both_plants(
    prescribed: Callable[..., Run], orbiter: Vehicle, transient: str
) -> None:
    run, continuous = (prescribed(thrust_transient=transient, depletion=True, time_step=step) for step in (None, 0.0))
    mass, forces = 1.0 / run["truth"][:, 9], np.linalg.norm(orbiter.thrusts, axis=1)
    flow = (run["thrust"] / forces) @ orbiter.mass_flows
    np.testing.assert_allclose(np.diff(mass), -flow[:-1] * orbiter.sample_period_s, rtol=0.0, atol=1e-11)
    constant = prescribed(thrust_transient=transient, time_step=None)
    np.testing.assert_array_equal(constant["truth"][:, 9], 1.0 / orbiter.nominal.mass)
    assert_same(motion(run), motion(continuous), TOLERANCE if transient == "none" else LAGGING_ANGLE)
    np.testing.assert_allclose(run["truth"], continuous["truth"], rtol=1e-12)
    for name in ("acc1", "acc2", "acc3"):  # a reading near the edge of a quantum may fall on either side
        np.testing.assert_allclose(run[name], continuous[name], rtol=0.0, atol=0.0345)
    np.testing.assert_allclose(run["thrust"], continuous["thrust"], rtol=1e-12, atol=1e-12)
