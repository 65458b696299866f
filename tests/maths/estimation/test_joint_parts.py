"""Wheels, engines, mounting, tanks, disturbances and modes in the joint filter: against motion, and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_probe import (
    INVERSE,
    PERIOD,
    POSITIONS,
    TRUTH,
    central_differences,
    derivatives,
    read_as,
    small_params,
    some_sample,
    some_state,
    unread,
)
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from massprop_drake.inputs.moving import Slosh, mode_params
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint.beginning import begin_from_readings, initial_joint_state
from massprop_drake.maths.estimation.joint.burns import Burn, engine_impulse, make_burn, shut_engine_settings
from massprop_drake.maths.estimation.joint.disturbance_states import (
    NO_DISTURBANCE,
    DisturbanceParams,
    discretize_disturbance,
    disturbance_noise,
    disturbance_noise_root,
)
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    INERTIA,
    MASS,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
    PartCounts,
    make_places,
)
from massprop_drake.maths.estimation.joint.modes import ModeParams
from massprop_drake.maths.estimation.joint.orientation import STILL
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict, propagate_root
from massprop_drake.maths.estimation.joint.sensitivity import linearize_cycle, propagate_to_update
from massprop_drake.maths.estimation.joint.tanks import TankParams, draw_propellant
from massprop_drake.maths.estimation.joint.wheels import (
    UNSPUN,
    Spun,
    WheelParams,
    append_reading_errors,
    wheel_impulses,
)
from massprop_drake.maths.estimation.offline.swings import Locked, add_modes
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import ELEMENT, MassProperties, six_elements
from massprop_drake.maths.vehicle.depletion import Tanks, structure_after_draining
from massprop_drake.maths.vehicle.engine_thrust import EngineParams
from massprop_drake.maths.vehicle.mounting import mounting_errors
from massprop_drake.systems.multibody.plants import parse_plant

STILLNESS = np.zeros((1, 6))  # a command
AXES = np.array([[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
WHEELS = WheelParams(AXES, np.array([0.01, 0.02, 0.015]), 0.005, np.full(3, 0.02), np.full(3, 50.0))
SPEEDS = Spun(np.array([90.0, -70.0, 120.0]), np.array([96.0, -78.0, 117.0]), np.zeros(3), np.ones(3))
DIRECTION, GIMBALS = np.array([0.0, 0.6, 0.8]), np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
ENGINES = EngineParams(
    positions=np.array([[0.3, -0.5, -1.2]]),
    directions=DIRECTION[None],
    axes=GIMBALS[None],
    normals=GIMBALS[None],
    thrusts=np.array([8.0]),
    levels=np.array([0.0, 0.5, 1.0]),
    flows=np.array([[0.0, 2e-3, 5e-3]]),
    read_std=np.array([[0.002, 0.001, 0.001]]),
    rates=np.array([[0.5, 0.1, 0.1]]),
    constants_s=np.array([[0.0, 0.2, 0.0]]),
    stops=np.array([[1.0, 0.2, 0.2]]),
    least=np.zeros(1),
    measured=np.ones(1),
)
BURN = Burn(np.array([[[0.6, 0.05, -0.08], [0.65, 0.06, -0.07], [0.7, 0.07, -0.06]]]), np.full((1, 3), 1e-3))
ERRORS = np.array([0.02, -0.03, 0.04, -0.02, 0.05, -0.03])
EACH = mounting_errors(small_params().wrenches, POSITIONS, np.full((6, 2), (0.02, 0.01)))
TANKS = TankParams(
    outlets=np.array([[0.3, -0.4, 0.1], [-0.5, 0.2, 0.3]]),
    columns=np.array([[0.144, 0.0, 0.192], [0.0, -0.3, 0.0]]),
    spreads=np.array([0.02 * (np.eye(3) + np.outer(axis, axis)) for axis in ([0.6, 0.0, 0.8], [0.0, -1.0, 0.0])]),
    feeds=np.array([[1.0, 0, 1, 0, 1, 0], [0, 1, 0, 1, 0, 0]]),  # the sixth jet draws from none
    capacities=np.array([2.0, 3.0]),
    fill=np.array([1.3, 2.1]),
    fill_sigma=np.array([0.1, 0.2]),
    flow_sigma=np.array([0.01, 0.02]),
)
CROSSING = np.zeros((3, 3, 3))
CROSSING[0, 1], CROSSING[1, 0] = [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]
MODES = ModeParams(
    np.array([[1.2, 0.0, 0.3], [0.0, 1.1, 0.0], [0.2, 0.4, 1.0]]),
    np.array([[0.3, 0.8, -0.2], [-0.7, 0.1, 0.4], [0.5, -0.6, 0.1]]),
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
DISTURBANCE = DisturbanceParams((np.diag([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03]) + 1e-4 * np.eye(6)[::-1])[:, :5], 2.0)


def made(counts: PartCounts, sigmas: Array, uncertain: tuple[bool, ...] = (), **changed: Any) -> JointParams:
    """The small vehicle with further parts, of whose parameters these are the sigmas; of first order."""
    return small_params(
        places=make_places(counts, 2, (True, True, *uncertain), True, 2, ticks=2),
        prior_sigma=np.concatenate((np.ones(6 + 2 + 6 + 6), sigmas, np.zeros(1 + 2 + 2))),
        second_order=False,
        **changed,
    )


COUNTS, STEADY = PartCounts(6, 2, 2), np.zeros(6)
WITH_WHEELS = made(COUNTS._replace(wheels=3), np.ones(3), (True,), wheels=WHEELS, flows=STEADY)
WITH_ENGINE = made(COUNTS._replace(engines=1), np.array([0.01, 0.01, 0.02, 0.02, 0.01, 0.01]), engines=ENGINES)
MOUNTED = made(COUNTS._replace(mounts=EACH.jets.size), np.ones(EACH.jets.size), mounting=EACH)
WITH_TANKS = made(
    COUNTS._replace(components=1, tanks=2),
    np.ones(2),
    (False, True),
    disturbance=DisturbanceParams(np.full((6, 1), 1e-5), 100.0),
    tanks=TANKS,
    flows=np.linspace(0.1, 0.2, 6),
)
DISTURBED = made(COUNTS._replace(components=5), np.zeros(0), disturbance=DISTURBANCE)
SWINGING = made(COUNTS._replace(modes=3, parts=2), np.ones(12), modes=MODES, flows=STEADY)


def part(params: JointParams, name: str) -> slice:
    """Place of a part of the state."""
    begin = getattr(params.places, name)
    return slice(begin, begin + getattr(params.places, f"n_{name}"))


FILL = slice(WITH_TANKS.places.thrust - 2, WITH_TANKS.places.thrust)
SWING, ENGINE = part(SWINGING, "swing"), part(WITH_ENGINE, "engine")
MASSES, GATHERED = slice(MASS, MASS + 1), slice(VELOCITY, VELOCITY + 3)


def state_of(params: JointParams) -> JointState:
    """A state in flight: tanks as they begin, an engine nearly as stated, modes displaced and moving."""
    state = some_state(params)
    mean, root = state.mean.copy(), state.root
    if params is WITH_TANKS:
        mean[FILL] = TANKS.fill
    if params is WITH_ENGINE:
        mean[ENGINE] *= 0.1
    if params is SWINGING:
        mean[SWING], root = [0.05, -0.03, 0.02, 0.1, 0.08, -0.06], 1e-3 * root
    return state._replace(mean=mean, root=root)


PROPERTIES = (INERTIA, CENTER, MASSES)
GATHERING = ((RATE, 5e-3), (GATHERED, 2e-2))  # in the latter the turning is by rates to be read
FILLING = ((INERTIA, 2e-2), (CENTER, 2e-2), (FILL, 2e-2))
STRONG = ((RATE, 6e-2), (GATHERED, 6e-2), (SWING, 6e-2))  # coupling; some products of second order are left out
# rows of the derivative and how far each may be off, relative to the largest of each group of columns
DERIVATIVES: dict[str, tuple[JointParams, tuple[tuple[slice, float], ...], tuple[slice, ...], tuple[str, ...]]] = {
    "engine": (WITH_ENGINE, GATHERING, (*PROPERTIES, ENGINE), ("scale",)),
    "mounting": (MOUNTED, GATHERING, PROPERTIES, ("mount", "thrust")),
    "wheels": (WITH_WHEELS, ((RATE, 5e-3),), (INERTIA, CENTER), ("slow", "wheel", "scale")),
    "tanks": (WITH_TANKS, FILLING, (*PROPERTIES, FILL), ("thrust", "tank")),
    "what fills": (WITH_TANKS, ((FILL, 1e-3),), (), ("force", "scale")),
    "disturbance": (DISTURBED, ((RATE, 2e-4), (slice(VELOCITY, VELOCITY + 6), 2e-4)), (), ("slow",)),
    "modes": (SWINGING, STRONG, (*PROPERTIES, SWING), ("moving", "thrust", "scale")),
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives_agree_with_central_differences(name: str) -> None:
    params, rows, columns, names = DERIVATIVES[name]
    burn = {"burn": BURN} if params is WITH_ENGINE else {}
    around = (STILL, SPEEDS if params is WITH_WHEELS else UNSPUN)
    found, expected = derivatives(state_of(params), some_sample(params, **burn), params, around)
    found, expected = found - np.eye(params.places.size), expected - np.eye(params.places.size)
    groups = (*columns, *(part(params, each) for each in names))
    for row, least in rows:
        shown = [np.abs(expected[row, group]).max() for group in groups]
        assert max(shown) > 1e-5
        for group, scale in zip(groups, shown, strict=True):
            if scale > 0.0:
                np.testing.assert_allclose(found[row, group], expected[row, group], atol=least * scale + 1e-11)


def predicted(state: JointState, sample: JointSample, params: JointParams, rate: Array | None = None) -> Prediction:
    """A prediction, with the rate at its end known or not."""
    read = unread(params) if rate is None else read_as(rate, params)
    return predict(state, estimate_forces(state, sample, params), read, params, (sample.frames, sample.speeds))


PRODUCTS = {
    "inertia": (MOUNTED, INERTIA, 1.0),
    "thrusts": (MOUNTED, part(MOUNTED, "thrust"), 20.0),
    "forces": (MOUNTED, part(MOUNTED, "force"), 1.0),
    "mounting": (MOUNTED, part(MOUNTED, "mount"), 20.0),
    "engine": (WITH_ENGINE, ENGINE, 1.0),
    "wheels": (WITH_WHEELS, part(WITH_WHEELS, "wheel"), 20.0),
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_products_of_errors_count(name: str) -> None:
    """Mean and covariance of their products with errors of center of mass or inertia, by drawn errors."""
    (plain, own, times), rng, draws = PRODUCTS[name], np.random.default_rng(3), 2000
    params, state, size = plain._replace(second_order=True), some_state(plain), plain.places.size
    others = INERTIA if name == "wheels" else CENTER
    root, rows = 0.0 * state.root, np.r_[others, own]
    root[rows] = 0.02 * rng.standard_normal((len(rows), root.shape[1])) / np.sqrt(root.shape[1])
    root[own] *= times
    state = state._replace(root=root)
    sample = some_sample(params, speeds=SPEEDS if name == "wheels" else UNSPUN)
    if name == "engine":
        sample = sample._replace(burn=BURN, commands=STILLNESS)

    def change(errors: Array) -> Array:
        return predicted(state._replace(mean=state.mean + errors, root=0.0 * root), sample, params).mean[RATE]

    straight, of_own, of_others = change(np.zeros(size)), 0.02 * times * np.eye(size)[own], 0.02 * np.eye(size)[others]
    by_own, by_others = (np.array([change(each) - straight for each in steps]) for steps in (of_own, of_others))
    mixed = np.array([[change(one + other) - straight for other in of_others] for one in of_own])
    mixed = (mixed - by_own[:, None] - by_others) / (0.02**2 * times)  # linear in either
    errors = rng.standard_normal((draws, root.shape[1])) @ root.T
    left = np.einsum("di,dj,ijk->dk", errors[:, own], errors[:, others], mixed)
    found, first = predicted(state, sample, params), predicted(state, sample, plain)
    bias = found.mean[RATE] - first.mean[RATE]
    np.testing.assert_allclose(bias, left.mean(axis=0), atol=4.0 * left.std(axis=0).max() / np.sqrt(draws))
    np.testing.assert_allclose(np.diag(found.noise - first.noise)[:3], left.var(axis=0), rtol=0.4)


def resting(params: JointParams, rate: list[float]) -> JointState:
    """A state at the truth in which no jet fires."""
    state = some_state(params)
    mean = state.mean.copy()
    mean[13:], mean[RATE], mean[INERTIA] = 0.0, rate, params.start[INERTIA]
    return state._replace(mean=mean, level=np.zeros(6), root=1e-3 * state.root)


def turned(rate: Array, start: Array, end: Array) -> Array:
    """Rate after an interval in which the wheels' speeds change linearly, by the equation of motion."""
    inertia, change = np.linalg.inv(INVERSE), (end - start) / PERIOD

    def flow(time_s: float, w: Array) -> Array:
        h = (WHEELS.inertias * (start + change * time_s)) @ AXES
        return np.asarray(INVERSE @ (-(WHEELS.inertias * change) @ AXES - np.cross(w, inertia @ w + h)))

    return np.asarray(solve_ivp(flow, (0.0, PERIOD), rate, rtol=1e-11, atol=1e-13).y[:, -1])


@pytest.mark.parametrize("known", [True, False])
def test_wheels_turn_the_vehicle_as_the_equation_of_motion_has_it(known: bool) -> None:
    """Also where the inertia is not known yet: then what turning h takes still is."""
    state = resting(WITH_WHEELS, [0.25, -0.2, 0.15] if known else [2.5e-4, -2e-4, 1.5e-4])
    if not known:
        state.root[:6] *= 1e6
    rate = state.mean[RATE]
    after = turned(rate, SPEEDS.start, SPEEDS.end)
    found = predicted(state, some_sample(WITH_WHEELS, commands=STILLNESS, speeds=SPEEDS), WITH_WHEELS, after)
    assert found.coupled == known
    own = 0.0 if known else float(after @ after) * PERIOD  # the most that coupling by the vehicle's own inertia is
    np.testing.assert_allclose(found.mean[RATE], after, atol=1e-6 * np.abs(after - rate).max() + own)
    assert found.noise[0, 0] >= own**2


def test_errors_of_the_speeds_that_are_read_turn_the_vehicle_less_than_is_taken_for_known() -> None:
    rate = np.array([0.2, -0.3, 0.1])
    spun = Spun(SPEEDS.start, SPEEDS.end, kept=np.array([0.3, 1.0, 0.0]), drawn=np.array([0.5, 0.0, 1.0]))
    found = append_reading_errors(discretize_disturbance(NO_DISTURBANCE, PERIOD), spun, INVERSE, rate * PERIOD, WHEELS)
    for begun, error in ((True, 1.0), (False, 0.0)):
        start = error * WHEELS.speed_std
        end = spun.kept * start if begun else spun.drawn * WHEELS.speed_std
        unread = wheel_impulses(Spun(start, end, spun.kept, spun.drawn), rate, rate, PERIOD, WHEELS) @ INVERSE
        np.testing.assert_allclose((found.begun if begun else found.drawn)[:3].T, -unread, rtol=1e-12)


def wrench(level: float, angles: Array, errors: Array) -> Array:
    """Torque about the vehicle origin and force, by scipy's rotations."""
    outer = Rotation.from_rotvec(GIMBALS[0] * (angles[0] + errors[2]))
    along = (outer * Rotation.from_rotvec(GIMBALS[1] * (angles[1] + errors[3]))).apply(DIRECTION)
    force = 8.0 * level * (1.0 + errors[0] * (1.0 - level) + errors[1] * level) * along
    place = ENGINES.positions[0] + errors[4] * GIMBALS[0] + errors[5] * GIMBALS[1]
    return np.concatenate((np.cross(place, force), force))


def test_an_engine_moves_the_vehicle_as_the_equations_of_motion_have_it() -> None:
    state = resting(WITH_ENGINE, [0.05, -0.04, 0.03])
    state.mean[ENGINE] = ERRORS
    mean, inertia = state.mean, np.linalg.inv(INVERSE)

    def flow(time_s: float, at: Array) -> Array:
        share = time_s / PERIOD
        acting = wrench(0.6 + 0.1 * share, np.array([0.05 + 0.02 * share, -0.08 + 0.02 * share]), ERRORS)
        torque = acting[:3] - np.cross(mean[CENTER], acting[3:])
        return np.concatenate((INVERSE @ (torque - np.cross(at[:3], inertia @ at[:3])), acting))

    after = solve_ivp(flow, (0.0, PERIOD), np.append(mean[RATE], np.zeros(6)), rtol=1e-11, atol=1e-14).y[:, -1]
    pushed = engine_impulse(BURN, ERRORS, PERIOD, ENGINES)
    np.testing.assert_allclose(pushed.impulse, after[3:], rtol=1e-6)
    levels = np.array([0.6, 0.65, 0.7])
    np.testing.assert_allclose(pushed.used, PERIOD * (2e-3 + (levels.mean() - 0.5) / 0.5 * 3e-3))
    found = predicted(state, some_sample(WITH_ENGINE, commands=STILLNESS, burn=BURN), WITH_ENGINE, after[:3])
    changed = np.abs(after[:3] - mean[RATE]).max()
    np.testing.assert_allclose(found.mean[RATE], after[:3], atol=1e-4 * changed)  # the level's rise bows the rate
    gained = after[6:] * mean[MASS] * (1.0 + 0.5 * pushed.used * mean[MASS])  # the mass falls as it burns
    np.testing.assert_allclose(found.mean[GATHERED], gained, atol=2e-3 * np.abs(gained).max())

    def shifted(offsets: Array) -> Array:
        return engine_impulse(Burn(BURN.points + offsets, BURN.std), STEADY, PERIOD, ENGINES).impulse

    noise = engine_impulse(BURN, STEADY, PERIOD, ENGINES).noise  # level and angles are off over the whole interval
    by_offsets = central_differences(shifted, np.zeros(3), np.full(3, 1e-4))
    np.testing.assert_allclose(noise, 1e-3 * by_offsets.T, atol=1e-9)


@pytest.mark.parametrize("measured", [True, False])
def test_readings_of_an_engine_are_what_is_or_what_is_to_be(measured: bool) -> None:
    quick = {"rates": np.full((1, 3), 1e4), "constants_s": np.zeros((1, 3))}
    engines, told = ENGINES._replace(measured=np.array([float(measured)]), **quick), np.array([[0.5, 0.1, 0.0]])
    missing = np.full((1, 3), np.nan)
    first, setting = make_burn(shut_engine_settings(1), told, PERIOD, engines)
    assert first.points[0, -1, 0] == (0.5 if measured else 0.0)
    moved = np.hypot(0.5 / np.sqrt(12.0), 0.25 * 0.002)  # when the level has moved is not known
    assert first.std[0, 0] == pytest.approx(moved if measured else 0.0, rel=1e-3)
    second, setting = make_burn(setting, missing, PERIOD, engines)
    np.testing.assert_allclose(second.points[0, -1], told[0], atol=1e-6)
    if not measured:  # Simpson's rule has the mean of a level that jumps as the interval begins
        np.testing.assert_allclose(np.array([1.0, 4.0, 1.0]) @ second.points[0] / 6.0, told[0], atol=1e-3)
    third, _ = make_burn(setting, missing, PERIOD, engines)
    lost_s = 2.0 * PERIOD if measured else 0.0  # a command holds
    np.testing.assert_allclose(third.std, np.hypot(engines.read_std * [[0.5, 1.0, 1.0]], engines.rates * lost_s))


def structure_of(properties: Array) -> Array:
    """Inertia and center of mass of the ten parameters, as the true vehicle has them."""
    return np.concatenate((six_elements(np.linalg.inv(properties[:6][ELEMENT])), properties[CENTER]))


TRUE = Tanks(TANKS.outlets, TANKS.columns, TANKS.spreads, TANKS.feeds)


def test_slices_leave_a_tank_by_the_parallel_axis_theorem() -> None:
    """The estimate changes as the true vehicle does, by an oracle of a tank done by hand: a disk less."""
    used = np.array([0.004, 0.0])  # one after the other is of the second order
    found = draw_propellant(TRUTH, TANKS.fill, used, 1.0, TANKS)
    after = structure_after_draining(structure_of(TRUTH), 1.0 / TRUTH[MASS], TANKS.fill, used, TRUE)
    inverse = six_elements(np.linalg.inv(after[:6][ELEMENT]))
    np.testing.assert_allclose(TRUTH[:6] + found.change[:6], inverse, atol=1e-5 * np.abs(inverse - TRUTH[:6]).max())
    shift = after[6:] - TRUTH[CENTER]
    np.testing.assert_allclose(found.change[CENTER], shift, atol=1e-9 * np.abs(shift).max())
    np.testing.assert_array_equal(found.change[N_PROPERTIES:], -used)
    both, second = (draw_propellant(TRUTH, TANKS.fill, np.array([each, 0.003]), 1.0, TANKS) for each in (0.004, 0.0))
    np.testing.assert_allclose(both.change, found.change + second.change, rtol=1e-12, atol=1e-15)
    below, empty = (draw_propellant(TRUTH, np.array([fill, 2.1]), used, 1.0, TANKS) for fill in (-0.5, 2e-3))
    np.testing.assert_array_equal(below.change[:N_PROPERTIES], empty.change[:N_PROPERTIES])  # no lower than its outlet
    assert not below.by_state[:N_PROPERTIES, N_PROPERTIES].any()


@pytest.mark.parametrize("constant_s", [0.02, 2.0, 15.0])
def test_a_disturbance_goes_over_as_the_matrix_exponential_has_it(constant_s: float) -> None:
    """Transition of w, c and z, and the covariance that comes, by Van Loan's block matrix."""
    disturbance, a, n = DISTURBANCE._replace(time_constant_s=constant_s), DISTURBANCE.accelerations, 5
    flow, white = np.zeros((11, 11)), np.zeros((11, 11))
    flow[:6, 6:], flow[6:, 6:], white[6:, 6:] = a, -np.eye(n) / constant_s, 2.0 / constant_s * np.eye(n)
    both = expm(PERIOD * np.block([[-flow, white], [np.zeros_like(flow), flow.T]]))
    through = both[11:, 11:].T
    covariance, wander = through @ both[:11, 11:], discretize_disturbance(disturbance, PERIOD)
    np.testing.assert_allclose(wander.begun, through[:6, 6:], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(wander.kept * np.eye(n), through[6:, 6:], rtol=1e-9, atol=1e-15)
    columns = disturbance_noise_root(wander)
    scale = np.sqrt(np.outer(covariance.diagonal(), covariance.diagonal())) + 1e-300
    np.testing.assert_allclose(columns @ columns.T / scale, covariance / scale, atol=2e-6)
    np.testing.assert_allclose(disturbance_noise(wander), (columns @ columns.T)[:6, :6], atol=1e-30)


def test_the_bank_knows_how_uncertain_a_disturbance_makes_the_outputs_since() -> None:
    params = DISTURBED._replace(rate_walk=1e-4)
    slow, size = part(params, "slow"), params.places.size
    state = first = initial_joint_state(params)._replace(root=1e-9 * np.eye(size), started=True, guarded=True)
    since, covariance, along = banks.empty_bank(params.places).since, np.zeros((size, 1)), np.zeros((size, 5))
    along[slow] = np.eye(5)
    for number in range(6):
        still = {"commands": STILLNESS, "rates": np.zeros((2, 3)), "velocities": np.zeros((2, 3))}
        sample = some_sample(params, time_s=(number + 1) * PERIOD, **still)
        after, report = step(state, sample, params)
        over = linearize_cycle(state, report, sample, params)
        since = banks.advance_recursion(since, over, params.places)
        if number > 0:
            covariance = propagate_root(covariance, report.course.expected.prediction, params)
            along = propagate_root(along, predicted(first, sample, params), params)[:, :5]
        (since, _), state = banks.add_onset(since, over.correction, float(number), params), after
        first = after if number == 0 else first
    rows = np.r_[10:13, VELOCITY : VELOCITY + 3, slow]
    expected = covariance[rows] @ covariance[rows].T
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(since.noise[0] / scale, expected / scale, atol=1e-4)
    np.testing.assert_allclose(since.kept[0], np.exp(-5 * PERIOD / DISTURBANCE.time_constant_s))
    np.testing.assert_allclose(since.rows[0][:, slow], along[rows[:6]], rtol=1e-3, atol=1e-8)


FORCE, TORQUE, PUSHED = np.array([3.0, 2.0, -1.0]), np.array([1.0, -1.5, 0.7]), 10
STEPS, SUBSTEPS = 70, 2


def parts() -> list[Slosh]:
    """Moving parts of the bundled model, from its masses and springs."""
    own: dict[str, Any] = {"frequency_hz": np.sqrt(0.0328 / 0.3413) / (2.0 * np.pi), "damping": 0.0198}
    where = {"position": (-0.1, 0.0, 0.2), "axes": ("x", "y"), "pivot": (-0.1, 0.0, -0.1)}
    return [Slosh(name="tank", kind="slosh", mass=3.68, **own, **where)]


def of_plant() -> tuple[Array, MassProperties]:
    """Rates of the bus after an impulse of a second, at each interval's end, by MultibodyPlant; and the whole."""
    plant = parse_plant(load_scenario("servicer_slosh").plant.model, "sdf")  # type: ignore[union-attr]
    simulator = Simulator(plant)
    context, bus = simulator.get_mutable_context(), plant.GetBodyByName("bus")
    mass, center = plant.CalcTotalMass(context), plant.CalcCenterOfMassPositionInWorld(context)
    bodies = [BodyIndex(index) for index in range(1, plant.num_bodies())]
    whole = plant.CalcSpatialInertia(context, plant.world_frame(), bodies)
    inertia, rates = whole.Shift(center).CalcRotationalInertia().CopyToFullMatrix3(), []

    def turned_rate() -> tuple[Array, Array]:
        turn = bus.EvalPoseInWorld(context).rotation().matrix()
        return turn, turn.T @ bus.EvalSpatialVelocityInWorld(context).rotational()

    for number in range(STEPS):
        for _ in range(SUBSTEPS):  # turned with the bus, as it is in the middle
            on, (turn, rate) = ExternallyAppliedSpatialForce(), turned_rate()
            turn = turn @ (np.eye(3) + skew(rate * PERIOD / (2.0 * SUBSTEPS)))
            on.body_index, on.p_BoBq_B = bus.index(), np.zeros(3)
            on.F_Bq_W = SpatialForce(turn @ TORQUE * (number < PUSHED), turn @ FORCE * (number < PUSHED))
            plant.get_applied_spatial_force_input_port().FixValue(context, [on])
            simulator.AdvanceTo(context.get_time() + PERIOD / SUBSTEPS)
        rates.append(turned_rate()[1])
    return np.array(rates), MassProperties(mass, center, inertia)


def test_rates_after_an_impulse_agree_with_multibody_plant() -> None:
    """Within what is left of second order, rad/s; with the modes locked they would be off by far more."""
    expected, whole = of_plant()
    modes = mode_params(parts(), (whole.mass, whole.center_of_mass, whole.inertia), np.ones((1, 6)), 0.5)
    n = modes.frequencies.size
    params = small_params(
        places=make_places(PartCounts(6, 1, 1, modes=n), 0, (False, False), False, 0, ticks=2),
        prior_sigma=np.zeros(2),
        modes=modes,
        second_order=False,
        nominal=whole.vector(),
    )
    mean = np.zeros(params.places.size)
    mean[:10] = whole.vector()
    state = some_state(params)._replace(mean=mean, root=1e-9 * np.eye(mean.size), level=np.zeros(6))
    locked, off = state, np.zeros(2)
    for number, rate in enumerate(expected):
        outside = np.concatenate((TORQUE, FORCE)) * PERIOD * (number < PUSHED)
        sample = some_sample(params, commands=STILLNESS, outside=outside)
        state, locked = (one._replace(mean=predicted(one, sample, params).mean) for one in (state, locked))
        locked.mean[params.places.swing : params.places.swing + 2 * n] = 0.0
        off = np.maximum(off, [np.abs(one.mean[RATE] - rate).max() for one in (state, locked)])
    assert off[0] < 2e-5
    assert off[1] > 1.5e-4


def test_a_stretch_of_a_record_swings_and_its_derivatives_agree_with_differences() -> None:
    """Also by eta at the beginning, by superposition: what begins displaced, less what begins at rest."""
    rows, generator = 6, np.random.default_rng(4)
    series = np.cumsum(1e-3 * generator.normal(size=(2, 3, rows)), axis=-1)
    series -= series[..., :1]
    nothing, impulses = np.zeros((10, 3, rows)), 0.1 * generator.normal(size=(3, rows - 1))
    rate = series[0] + np.array([[0.02], [-0.01], [0.015]])
    locked = Locked(series[0], series[1], rate, impulses, np.full(rows - 1, PERIOD), nothing, nothing)
    whole = np.append(SWINGING.nominal, [0.3, -0.5, 0.2, 0.1, 0.4, -0.3, 0.2, 0.1, 0.5, -0.2, 0.3, 0.4])

    def after(unknowns: Array) -> Array:
        found = add_modes(locked, unknowns[:10], unknowns[10:], MODES)
        return np.concatenate((found.rate.ravel(), found.velocity.ravel()))

    expected = central_differences(after, whole, 1e-4 * np.maximum(np.abs(whole), 1e-2))
    found = add_modes(locked, whole[:10], whole[10:], MODES)
    by = np.concatenate((found.by_rate[:22].reshape(22, -1), found.by_velocity[:22].reshape(22, -1)), axis=1).T
    for columns in (*PROPERTIES, slice(10, 22)):
        size = np.abs(expected[:, columns]).max()
        np.testing.assert_allclose(by[:, columns] / size, expected[:, columns] / size, atol=3e-2)
    assert found.by_rate.shape == (22 + 6, 3, rows)
    np.testing.assert_array_equal(found.by_rate[..., 0], 0.0)
    assert (np.abs(found.by_rate[22:]).max(axis=(1, 2)) > 1e-3).all()


def test_after_a_gap_is_known_what_is_left_of_each_part() -> None:
    state, slow = some_state(DISTURBED)._replace(time_s=1.0), part(DISTURBED, "slow")
    after = begin_from_readings(state, some_sample(DISTURBED, time_s=3.0), DISTURBED)  # a gap of one time constant
    kept = np.exp(-1.0)
    np.testing.assert_allclose(after.mean[slow], kept * state.mean[slow])
    before, now = (each.root[slow] @ each.root[slow].T for each in (state, after))
    np.testing.assert_allclose(now, kept**2 * before + (1.0 - kept**2) * np.eye(5))
    tanks = begin_from_readings(initial_joint_state(WITH_TANKS), some_sample(WITH_TANKS, time_s=30.0), WITH_TANKS)
    np.testing.assert_array_equal(tanks.mean[FILL], TANKS.fill)
    shaken = begin_from_readings(state_of(SWINGING)._replace(started=True), some_sample(SWINGING, time_s=3.0), SWINGING)
    wheels = SPEEDS._replace(kept=np.array([0.0, 1.0, 0.0]))  # the readings of the others have new errors
    turned_on = begin_from_readings(
        some_state(WITH_WHEELS), some_sample(WITH_WHEELS, time_s=3.0, speeds=wheels), WITH_WHEELS
    )
    for found, own, expected in (
        (tanks, FILL, TANKS.fill_sigma),
        (shaken, SWING, np.append(MODES.shaken, MODES.shaken * MODES.frequencies)),
        (turned_on, part(WITH_WHEELS, "slow"), [1.0, 1e3 / 0.02, 1.0]),
    ):
        np.testing.assert_allclose(np.sqrt(np.sum(found.root[own] ** 2, axis=1)), expected)


def test_a_force_beside_the_filter_shakes_modes_as_thrust_does_within_it() -> None:
    places, thrust = SWINGING.places, part(SWINGING, "thrust")
    state = state_of(SWINGING)._replace(started=True, guarded=True)
    state, sample = state._replace(root=1e-3 * state.root), some_sample(SWINGING, time_s=PERIOD)
    state.mean[SWING] = 0.0  # what is displaced swings otherwise, to second order
    _, report = step(state, sample, SWINGING)
    over = linearize_cycle(state, report, sample, SWINGING)
    by_jets = report.course.expected.prediction.swung.rows[:, thrust]
    shares = report.course.acting.firing.amount * SWINGING.thrust_sigma * SWINGING.thrusts / over.duration_s
    shaken = propagate_to_update(np.zeros((places.size, 6)), over.duration_s * over.effects.T, over, places)[SWING]
    np.testing.assert_allclose(by_jets, shaken * shares, atol=0.05 * np.abs(by_jets).max())
