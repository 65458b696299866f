"""Modes inside the vehicle in the joint filter: against bodies and joints of MultibodyPlant, and differences."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import PERIOD, central_differences, derivatives, small_params, some_sample, some_state, unread
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.analysis import Simulator

from massprop_drake.inputs.moving import HingedPanel, Slosh, mode_params
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint.joint_cycle import begun, driven, initial, step
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, MASS, RATE, VELOCITY, PartCounts, make_places
from massprop_drake.maths.estimation.joint.modes import ModeParams
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.sensitivity import carried, impulse_columns, link
from massprop_drake.maths.estimation.offline.swings import Locked, with_modes
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.systems.multibody.plants import parsed_plant

PUSH = np.array([[1.2, 0.0, 0.3], [0.0, 1.1, 0.0], [0.2, 0.4, 1.0]])
TURN = np.array([[0.3, 0.8, -0.2], [-0.7, 0.1, 0.4], [0.5, -0.6, 0.1]])
CROSSING = np.zeros((3, 3, 3))
CROSSING[0, 1], CROSSING[1, 0] = [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]
MODES = ModeParams(
    PUSH,
    TURN,
    CROSSING,
    np.array([[0.0, 0.0, -2.0], [0.0, 0.0, -2.0], [0.0, 0.0, 0.0]]),
    np.array([[0.3, -0.2, 0.0], [0.3, -0.2, 0.0], [0.0, 0.0, 0.0]]),
    0.1 * np.array([np.diag([1.0, 2.0, 0.5]), np.diag([0.3, 0.2, 1.0]), np.zeros((3, 3))]),
    2.0 * np.pi * np.array([0.4, 0.4, 1.5]),
    np.array([0.05, 0.05, 0.01]),
    np.array([0, 0, 1]),
    np.array([[0.05, 0.1, 0.5, 0.02, 0.03, 0.01], [0.02, 0.05, 0.3, 0.01, 0.02, 0.03]]),
    np.full(3, 0.01),
    np.full(3, 0.1),
)
PARAMS = small_params(
    places=make_places(PartCounts(6, 2, 2, modes=3, parts=2), 2, (True, True), True, 2, ticks=2),
    prior_sigma=np.append(np.ones(6 + 2 + 6 + 6 + 12), np.zeros(1 + 2 + 2)),
    modes=MODES,
    second_order=False,
    flows=np.zeros(6),
)
PLACES = PARAMS.places
SWING = slice(PLACES.swing, PLACES.swing + PLACES.n_swing)
MOVING = slice(PLACES.moving, PLACES.moving + PLACES.n_moving)


def swinging_state() -> Array:
    """A state's estimate with modes displaced and moving."""
    mean = some_state(PARAMS).mean.copy()
    mean[SWING] = [0.05, -0.03, 0.02, 0.1, 0.08, -0.06]
    return mean


def test_derivatives_agree_with_central_differences() -> None:
    state = some_state(PARAMS)._replace(mean=swinging_state())
    state = state._replace(root=1e-3 * state.root)
    sample = some_sample(PARAMS)
    found, expected = derivatives(state, sample, PARAMS)
    thrust = slice(PLACES.thrust, PLACES.thrust + PLACES.n_thrust)
    scale = slice(PLACES.scale, PLACES.scale + 1)
    for rows in (RATE, slice(VELOCITY, VELOCITY + 3), SWING):  # strongly coupled; some products of second order are not
        for columns in (INERTIA, CENTER, slice(MASS, MASS + 1), SWING, MOVING, thrust, scale):
            size = np.abs(expected[rows, columns]).max()
            np.testing.assert_allclose(found[rows, columns] / size, expected[rows, columns] / size, atol=6e-2)


FORCE, TORQUE, PUSHED = np.array([3.0, 2.0, -1.0]), np.array([1.0, -1.5, 0.7]), 10
STEPS, SUBSTEPS = 70, 2


def parts(name: str) -> list[Slosh | HingedPanel]:
    """Moving parts of a bundled model, from its masses, inertias and springs."""
    if name == "slosh":
        frequency = np.sqrt(0.0328 / 0.3413) / (2.0 * np.pi)
        own = {
            "frequency_hz": frequency,
            "damping": 0.0198,
            "position": (-0.1, 0.0, 0.2),
            "axes": ("x", "y"),
            "pivot": (-0.1, 0.0, -0.1),
        }
        return [Slosh(name="tank", kind="slosh", mass=3.68, **own)]
    inertia = 0.972 + 3.6 * 0.91**2
    own = {
        "frequency_hz": np.sqrt(110.4 / inertia) / (2.0 * np.pi),
        "damping": 0.1757 / (2.0 * np.sqrt(110.4 * inertia)),
    }
    return [
        HingedPanel(
            **{"name": side, "kind": "panel", "hinge": (0.0, 0.45 * sign, 0.0), "axis": (1.0, 0.0, 0.0), "mass": 3.6},
            **{"center_of_mass": (0.0, 1.36 * sign, 0.0), "inertia": inertia, **own},
        )
        for side, sign in (("left", 1.0), ("right", -1.0))
    ]


def of_plant(name: str) -> tuple[Array, MassProperties]:
    """Rates of the bus after an impulse of a second, at each interval's end, by MultibodyPlant; and the whole."""
    plant = parsed_plant(load_scenario(f"servicer_{name}").plant.model, "sdf")  # type: ignore[union-attr]
    simulator = Simulator(plant)
    context, bus = simulator.get_mutable_context(), plant.GetBodyByName("bus")
    mass, center = plant.CalcTotalMass(context), plant.CalcCenterOfMassPositionInWorld(context)
    turned = plant.CalcSpatialInertia(context, plant.world_frame(), [body.index() for body in bodies(plant)])
    inertia = turned.Shift(center).CalcRotationalInertia().CopyToFullMatrix3()
    rates = []
    for number in range(STEPS):
        for _ in range(SUBSTEPS):  # turned with the bus, as it is in the middle
            on, turn = ExternallyAppliedSpatialForce(), bus.EvalPoseInWorld(context).rotation().matrix()
            rate = turn.T @ bus.EvalSpatialVelocityInWorld(context).rotational()
            turn = turn @ (np.eye(3) + skew(rate * PERIOD / (2.0 * SUBSTEPS)))
            on.body_index, on.p_BoBq_B = bus.index(), np.zeros(3)
            on.F_Bq_W = SpatialForce(turn @ TORQUE * (number < PUSHED), turn @ FORCE * (number < PUSHED))
            plant.get_applied_spatial_force_input_port().FixValue(context, [on])
            simulator.AdvanceTo(context.get_time() + PERIOD / SUBSTEPS)
        turn = bus.EvalPoseInWorld(context).rotation().matrix()
        rates.append(turn.T @ bus.EvalSpatialVelocityInWorld(context).rotational())
    return np.array(rates), MassProperties(mass, center, inertia)


def bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """All bodies but the world."""
    return [plant.get_body(BodyIndex(index)) for index in range(1, plant.num_bodies())]


@pytest.mark.parametrize(("name", "within", "without"), [("slosh", 2e-5, 1.5e-4), ("panel", 1e-5, 5e-3)])
def test_rates_after_an_impulse_agree_with_multibody_plant(name: str, within: float, without: float) -> None:
    """Within what is left of second order, rad/s; with the modes locked they would be off by far more."""
    expected, whole = of_plant(name)
    told = mode_params(parts(name), (whole.mass, whole.center_of_mass, whole.inertia), np.ones((1, 6)), 0.5)
    n = told.frequencies.size
    params = small_params(
        places=make_places(PartCounts(6, 1, 1, modes=n), 0, (False, False), False, 0, ticks=2),
        prior_sigma=np.zeros(2),
        modes=told,
        second_order=False,
        nominal=whole.vector(),
    )
    state = some_state(params)
    mean = np.zeros(params.places.size)
    mean[:10] = whole.vector()
    state = state._replace(mean=mean, root=1e-9 * np.eye(mean.size), level=np.zeros(6))
    locked, off = mean.copy(), np.zeros(2)
    for number, rate in enumerate(expected):
        outside = np.concatenate((TORQUE, FORCE)) * PERIOD * (number < PUSHED)
        sample = some_sample(params, commands=np.zeros((1, 6)), outside=outside)
        rates = []
        for one in (state.mean, locked):
            there = state._replace(mean=one)
            rates.append(predict(there, driven(there, sample, params), unread(params), params).mean)
        state, locked = state._replace(mean=rates[0]), rates[1].copy()
        locked[params.places.swing : params.places.swing + 2 * n] = 0.0
        off = np.maximum(off, [np.abs(one[RATE] - rate).max() for one in (rates[0], locked)])
    assert off[0] < within
    assert off[1] > without


def test_a_stretch_of_a_record_swings_and_its_derivatives_agree_with_differences() -> None:
    """Also by eta at the beginning, by superposition: what begins displaced, less what begins at rest."""
    rows, generator = 12, np.random.default_rng(4)
    series = np.cumsum(1e-3 * generator.normal(size=(2, 3, rows)), axis=-1)
    series -= series[..., :1]
    nothing, impulses = np.zeros((10, 3, rows)), 0.1 * generator.normal(size=(3, rows - 1))
    rate = series[0] + np.array([[0.02], [-0.01], [0.015]])
    locked = Locked(series[0], series[1], rate, impulses, np.full(rows - 1, PERIOD), nothing, nothing)
    properties, errors = PARAMS.nominal, np.array([0.3, -0.5, 0.2, 0.1, 0.4, -0.3, 0.2, 0.1, 0.5, -0.2, 0.3, 0.4])

    def after(unknowns: Array) -> Array:
        found = with_modes(locked, unknowns[:10], unknowns[10:], MODES)
        return np.concatenate((found.rate.ravel(), found.velocity.ravel()))

    whole = np.concatenate((properties, errors))
    expected = central_differences(after, whole, 1e-4 * np.maximum(np.abs(whole), 1e-2))
    found = with_modes(locked, properties, errors, MODES)
    by = np.concatenate((found.by_rate[:22].reshape(22, -1), found.by_velocity[:22].reshape(22, -1)), axis=1).T
    for columns in (INERTIA, CENTER, slice(MASS, MASS + 1), slice(10, 22)):
        size = np.abs(expected[:, columns]).max()
        np.testing.assert_allclose(by[:, columns] / size, expected[:, columns] / size, atol=3e-2)
    assert found.by_rate.shape == (22 + 6, 3, rows)
    np.testing.assert_array_equal(found.by_rate[..., 0], 0.0)
    assert (np.abs(found.by_rate[22:]).max(axis=(1, 2)) > 1e-3).all()


def test_the_bank_follows_how_errors_go_through_modes_and_what_forces_shake_them_to() -> None:
    state = some_state(PARAMS)._replace(mean=swinging_state(), started=True, guarded=True)
    state = state._replace(root=1e-6 * state.root)
    bank, columns = banks.empty(PLACES), np.eye(PLACES.size)
    for number in range(5):
        sample = some_sample(PARAMS, time_s=(number + 1) * PERIOD)
        after, report = step(state, sample, PARAMS)
        over = link(state, report, sample, PARAMS)
        bank = banks.advanced(bank, over, PLACES)
        if number > 0:
            columns = carried(columns, np.zeros((6, PLACES.size)), over, PLACES)
        bank, state = banks.taken(bank, over, after, number, PARAMS), after
    found, known = bank.rows[0], np.r_[0:13, SWING, PLACES.thrust : PLACES.thrust + 6, MOVING]
    np.testing.assert_allclose(found[:3][:, known], columns[RATE][:, known], atol=1e-12)
    np.testing.assert_allclose(found[6:][:, known], columns[SWING][:, known], atol=1e-12)
    jets = over.duration_s * over.effects.T
    shaken = impulse_columns(jets, over, PLACES)[SWING]
    more = step(state, some_sample(PARAMS, time_s=6 * PERIOD), PARAMS)[1]
    assert more.course is not None
    by_jets = more.course.expected.prediction.swung.rows[:, PLACES.thrust : PLACES.thrust + 6]
    told = more.course.acting.firing.amount * PARAMS.thrust_sigma * PARAMS.thrusts / over.duration_s
    np.testing.assert_allclose(by_jets, shaken * told, atol=0.05 * np.abs(by_jets).max())


def test_after_a_gap_modes_may_have_been_shaken_and_before_the_first_sample_are_as_stated() -> None:
    first = initial(PARAMS)
    spread = np.sqrt(np.sum(begun(first, some_sample(PARAMS), PARAMS).root[SWING] ** 2, axis=1))
    np.testing.assert_allclose(spread, np.concatenate((MODES.start, MODES.start * MODES.frequencies)))
    state = some_state(PARAMS)._replace(mean=swinging_state(), started=True)
    after = begun(state, some_sample(PARAMS, time_s=3.0), PARAMS)
    np.testing.assert_array_equal(after.mean[SWING], 0.0)
    spread = np.sqrt(np.sum(after.root[SWING] ** 2, axis=1))
    np.testing.assert_allclose(spread, np.concatenate((MODES.shaken, MODES.shaken * MODES.frequencies)))
