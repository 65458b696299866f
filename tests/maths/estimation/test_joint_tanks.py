"""Tanks in the joint filter: against the parallel-axis theorem, and differences."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import TRUTH, derivatives, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint.disturbance_states import DisturbanceParams
from massprop_drake.maths.estimation.joint.joint_cycle import begun, driven, initial
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, MASS, N_PROPERTIES, VELOCITY, make_places
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.tanks import TankParams, drawn
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, six_elements
from massprop_drake.maths.vehicle.depletion import Tanks, emptied

AXES = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
FEEDS = np.array([[1.0, 0, 1, 0, 1, 0], [0, 1, 0, 1, 0, 0]])  # the sixth jet draws from none
TANKS = TankParams(
    outlets=np.array([[0.3, -0.4, 0.1], [-0.5, 0.2, 0.3]]),
    columns=AXES * np.array([[0.24], [0.3]]),
    spreads=np.array([0.02 * (np.eye(3) + np.outer(axis, axis)) for axis in AXES]),
    feeds=FEEDS,
    capacities=np.array([2.0, 3.0]),
    fill=np.array([1.3, 2.1]),
    fill_sigma=np.array([0.1, 0.2]),
    flow_sigma=np.array([0.01, 0.02]),
)
PARAMS = small_params(
    places=make_places((6, 2, 2, 0, 1, 0, 0, 2), 2, (True, True, False, True), True, 2, ticks=2),
    prior_sigma=np.append(np.ones(6 + 2 + 6 + 6 + 2), np.zeros(1 + 2 + 2)),
    disturbance=DisturbanceParams(np.full((6, 1), 1e-5), 100.0),
    tanks=TANKS,
    flows=np.linspace(0.1, 0.2, 6),
    second_order=False,
)
PLACES = PARAMS.places
FILL = slice(PLACES.thrust - 2, PLACES.thrust)


def structure_of(properties: Array) -> Array:
    """Inertia and center of mass of the ten parameters, as the true vehicle has them."""
    return np.concatenate((six_elements(np.linalg.inv(properties[:6][ELEMENT])), properties[CENTER]))


def filled(mean: Array) -> Array:
    """A state's estimate with tanks as they begin."""
    mean = mean.copy()
    mean[FILL] = TANKS.fill
    return mean


def test_slices_leave_by_the_parallel_axis_theorem() -> None:
    """The estimate changes as the true vehicle does, by an oracle of a tank done by hand: a disk less."""
    used = np.array([0.004, 0.0])  # one after the other is of the second order
    found = drawn(TRUTH, TANKS.fill, used, 1.0, TANKS)
    true = Tanks(TANKS.outlets, TANKS.columns, TANKS.spreads, FEEDS)
    after = emptied(structure_of(TRUTH), 1.0 / TRUTH[MASS], TANKS.fill, used, true)
    inverse = six_elements(np.linalg.inv(after[:6][ELEMENT]))
    moved = TRUTH[:6] + found.change[:6]
    np.testing.assert_allclose(moved, inverse, atol=1e-5 * np.abs(inverse - TRUTH[:6]).max())
    shift = after[6:] - TRUTH[CENTER]
    np.testing.assert_allclose(found.change[CENTER], shift, atol=1e-9 * np.abs(shift).max())
    np.testing.assert_array_equal(found.change[N_PROPERTIES:], -used)
    both = drawn(TRUTH, TANKS.fill, np.array([0.004, 0.003]), 1.0, TANKS)
    second = drawn(TRUTH, TANKS.fill, np.array([0.0, 0.003]), 1.0, TANKS)
    np.testing.assert_allclose(both.change, found.change + second.change, rtol=1e-12, atol=1e-15)


def test_a_tank_may_be_emptied_at_once_or_by_slices() -> None:
    true = Tanks(TANKS.outlets, TANKS.columns, TANKS.spreads, FEEDS)
    start, mass = structure_of(TRUTH), 1.0 / TRUTH[MASS]
    whole = emptied(start, mass, TANKS.fill, TANKS.fill, true)
    part, left = start, TANKS.fill.copy()
    for _ in range(7):
        part = emptied(part, mass - (TANKS.fill - left).sum(), left, TANKS.fill / 7.0, true)
        left = left - TANKS.fill / 7.0
    np.testing.assert_allclose(part, whole, rtol=1e-12, atol=1e-13)
    rod = TANKS.fill[1] * (0.3 * TANKS.fill[1]) ** 2 / 12.0 + TANKS.fill[1] * 0.02  # of the second, across its axis
    alone = emptied(start, mass, TANKS.fill, np.array([0.0, TANKS.fill[1]]), true)
    left_mass = mass - TANKS.fill[1]
    middle = TANKS.outlets[1] + TANKS.columns[1] * 0.5 * TANKS.fill[1]
    center = (mass * TRUTH[CENTER] - TANKS.fill[1] * middle) / left_mass
    np.testing.assert_allclose(alone[6:], center, rtol=1e-12)
    arm, own = middle - TRUTH[CENTER], center - TRUTH[CENTER]
    about = start[0] - rod - TANKS.fill[1] * (arm[1] ** 2 + arm[2] ** 2) - left_mass * (own[1] ** 2 + own[2] ** 2)
    assert alone[0] == pytest.approx(about, rel=1e-12)


def test_derivatives_agree_with_central_differences() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    state = state._replace(mean=filled(state.mean))
    found, expected = derivatives(state, sample, PARAMS)
    change = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS).mean - state.mean
    parts = (INERTIA, CENTER, slice(MASS, MASS + 1), FILL, slice(PLACES.thrust, PLACES.thrust + 6))
    for row in (INERTIA, CENTER, FILL):  # of what changes in an interval, itself small, to a part in a hundred
        for group in (*parts, slice(PLACES.tank, PLACES.tank + 2)):
            own = np.abs(expected[row, group] - np.eye(PLACES.size)[row, group]).max()
            np.testing.assert_allclose(found[row, group], expected[row, group], atol=0.02 * own + 1e-11)
    for others in (slice(PLACES.force, PLACES.force + 2), slice(PLACES.scale, PLACES.scale + 1)):
        own = np.abs(expected[FILL, others]).max()
        np.testing.assert_allclose(found[FILL, others], expected[FILL, others], atol=1e-3 * own)
        assert own > 1e-5
    assert np.abs(expected[:MASS, PLACES.tank]).max() > 1e-7
    assert np.abs(change[CENTER]).max() > 1e-5


def test_what_accelerometers_have_gathered_stays() -> None:
    """The center of mass that moves in an interval moves none of the readings before it."""
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    state = state._replace(mean=filled(state.mean))
    prediction = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS)
    fixed = PARAMS._replace(tanks=TANKS._replace(feeds=0.0 * FEEDS))
    plain = predict(state, driven(state, sample, fixed), unread(fixed), fixed)
    part, shift = slice(VELOCITY, VELOCITY + 3), prediction.mean[CENTER] - state.mean[CENTER]
    moved = prediction.mean[part] - plain.mean[part]
    assert np.abs(moved - prediction.turned @ shift).max() < 0.02 * np.abs(prediction.turned @ shift).max()


def test_propellant_stays_in_a_gap_and_an_empty_tank_is_no_lower_than_its_outlet() -> None:
    state = initial(PARAMS)
    np.testing.assert_array_equal(state.mean[FILL], TANKS.fill)
    np.testing.assert_allclose(np.sqrt(np.sum(state.root[FILL] ** 2, axis=1)), TANKS.fill_sigma)
    after = begun(state, some_sample(PARAMS, time_s=30.0), PARAMS)
    np.testing.assert_array_equal(after.mean[FILL], TANKS.fill)
    np.testing.assert_allclose(np.sqrt(np.sum(after.root[FILL] ** 2, axis=1)), TANKS.fill_sigma)
    used = np.array([1e-3, 0.0])
    below, empty = (drawn(TRUTH, np.array([fill, 2.1]), used, 1.0, TANKS) for fill in (-0.5, 5e-4))
    np.testing.assert_array_equal(below.change[:N_PROPERTIES], empty.change[:N_PROPERTIES])
    assert not below.by_state[:N_PROPERTIES, N_PROPERTIES].any()
