"""What jets and sensors can do, against cases worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import INVERSE

from massprop_drake.maths.estimation.observability import (
    activity_rank,
    impulse_jacobian,
    jet_pairs,
    smallest_isolable,
    span_basis,
    unobservable_combinations,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import pack
from massprop_drake.maths.vehicle.thrust import thrust_wrenches

# inertia and products of a few units, center of mass off the axes, mass 2
PROPERTIES = pack(INVERSE, np.array([0.1, -0.2, 0.3]), 0.5)
ONES = np.ones(10)
AXES = (((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 1, 0)), ((1, 0, 0), (0, 0, 1)))  # position and force of jets


def hidden_by(*jets: tuple[tuple[float, ...], tuple[float, ...]], accelerometer: bool = True) -> Array:
    wrenches = thrust_wrenches(*(np.array([jet[part] for jet in jets], dtype=float) for part in (0, 1)))
    return unobservable_combinations(impulse_jacobian(wrenches, PROPERTIES, accelerometer=accelerometer), ONES)


def test_condition_of_hand_values_whatever_thrust_and_unit() -> None:
    # rotation rows are in rad/s^2 at an arm of 2 m: columns 1/2 there weigh as much as columns 1 of translation
    assert activity_rank(np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0]), 2.0) == pytest.approx((6, 1.0), rel=1e-14)
    # two of the six columns at an angle of 60 deg: their Gram matrix has eigenvalues 1 +- 1/2
    activity = np.eye(6)
    activity[:2, 1] = 0.5, math.sqrt(0.75)
    # jets a thousand times weaker, and feet for meters: translation and arm grow, rotation stays
    other = activity * np.where(np.arange(6) < 4, 1e-3, 1.0) * np.array([1.0] * 3 + [3.28] * 3)[:, None]
    for found in (activity_rank(activity, 1.0), activity_rank(other, 3.28)):
        assert found == pytest.approx((6, math.sqrt(3.0)), rel=1e-12)


@pytest.mark.parametrize(("columns", "rank"), [([0, 1, 2, 3, 4], 5), ([0, 0, 0], 1), ([0, 1, 2, 3, 4, 4, 4], 5)])
def test_missing_directions_lower_the_rank(columns: list[int], rank: int) -> None:
    assert activity_rank(np.eye(6)[:, columns], 1.0) == (rank, math.inf)


def test_a_jet_along_each_axis_shows_all_ten_parameters() -> None:
    assert hidden_by(*AXES).shape == (0, 10)
    # without accelerometer the mass stays hidden
    assert_array_equal(hidden_by(*AXES, accelerometer=False), np.eye(10)[9:])
    # weak jets and small units hide nothing
    scale = np.array([1e-7] * 6 + [30.0] * 3 + [1e-4])
    small = PROPERTIES * np.array([1e-7] * 6 + [1.0] * 3 + [1e-4])
    wrenches = thrust_wrenches(*(np.array([jet[part] for jet in AXES], dtype=float) for part in (0, 1)))
    uneven = wrenches * np.array([[1e3], [1e-2], [1.0]])
    assert unobservable_combinations(impulse_jacobian(uneven, small, accelerometer=True), scale).shape == (0, 10)


def test_what_few_jets_hide() -> None:
    couples = np.hstack([np.eye(3), np.zeros((3, 3))])
    jacobian = impulse_jacobian(couples, PROPERTIES, accelerometer=True)
    assert_array_equal(unobservable_combinations(jacobian, ONES), np.eye(10)[6:])
    # forces along z, at four places: no torque about z, so I^-1_zz is not seen either
    hidden = hidden_by(*(((x, y, 0), (0, 0, 1)) for x in (1, -1) for y in (1, -1)))
    assert_array_equal(hidden, np.eye(10)[[2, 8]])
    # jets fired together show nothing more
    jets = thrust_wrenches(np.array([[0, 1, 0], [0, 0, 1], [1, 0.5, 0]]), np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    sums = np.vstack([jets, jets[0] + jets[1], jets[1] + 2.0 * jets[2], jets.sum(axis=0)])
    alone, together = (
        unobservable_combinations(impulse_jacobian(w, PROPERTIES, accelerometer=True), ONES) for w in (jets, sums)
    )
    assert_allclose(together, alone, rtol=0.0, atol=1e-9)


def test_one_jet_leaves_a_combination_that_can_be_named() -> None:
    # force along x at (0, 1, 0), inertia the identity, center of mass at the origin: moment (0, 0, -1), so
    # dw = (-Ixz^-1, -Iyz^-1, -Izz^-1) and by dr: x cross dr = (0, -dz, dy). Seen: Ixz^-1; Iyz^-1 + dz; Izz^-1 - dy
    wrench = thrust_wrenches(np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]))
    jacobian = impulse_jacobian(wrench, pack(np.eye(3), np.zeros(3), 1.0), accelerometer=True)
    expected = np.eye(10)[[0, 1, 2, 3, 5, 6]]  # Ixx, Iyy, Izz with y, Iyz with z, Ixy, x
    expected[2, 7], expected[3, 8] = 1.0, -1.0
    assert_allclose(unobservable_combinations(jacobian, ONES), expected, rtol=0.0, atol=1e-12)


def test_pairs_come_in_order_of_their_angles() -> None:
    tilt = 1e-9  # rad: its cosine is one to the last digit
    # the third line lies at 45 deg to the first, and to the second but for the tilt
    signatures = np.array([[1.0, 0.0], [-3.0 * math.cos(tilt), 3.0 * math.sin(tilt)], [2.0, 2.0]])
    first, *others = jet_pairs(signatures)
    assert first == (0, 1, pytest.approx(tilt, rel=1e-6), True)
    quarter = pytest.approx(math.pi / 4.0, abs=2e-9)
    assert sorted(others) == [(0, 2, quarter, False), (1, 2, quarter, True)]


def at(degrees: float, length: float = 1.0) -> list[float]:
    return [length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees))]


@pytest.mark.parametrize(
    ("seen", "lost", "force", "rival"),
    [
        # f^2 4 sin^2 30 = 6; f^2 sin^2 30 = 6; jets 1 and 2 are 120 deg apart and jet 0 150: no rival of jet 2
        ([at(0, 2), at(30), at(150)], False, [math.sqrt(6), math.sqrt(24), math.sqrt(6)], [1, 0, -1]),
        # against jet 0: jet 2 by 30 deg from its opposite; jet 1 against jet 2: 60 deg
        ([at(0, 2), at(30), at(150)], True, [math.sqrt(6), math.sqrt(8), math.sqrt(24)], [2, 2, 0]),
        ([at(63, 1), at(243, 1)], True, [math.inf, math.inf], [1, 0]),  # opposed on one line
        ([[3.0, 4.0]], False, [math.sqrt(6) / 5], [-1]),  # alone
        # a jet that shows nothing is never found and looks like no other
        ([[1e-17, 0.0], [3.0, 4.0], [4.0, 3.0]], False, [math.inf, *[math.sqrt(6) / 1.4] * 2], [-1, 2, 1]),
    ],
)
def test_smallest_isolable_force_of_hand_values(
    seen: list[list[float]], lost: bool, force: list[float], rival: list[int]
) -> None:
    found = smallest_isolable(np.array(seen), 6.0, lost=lost)
    assert_allclose(found.force, force, rtol=1e-12)
    assert found.rival.tolist() == rival


def test_span_of_vectors() -> None:
    plane = span_basis(np.array([[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [5.0, 0.0, 0.0]]))
    assert plane.shape == (2, 3)
    assert_allclose(plane[:, 2], 0.0, atol=1e-15)
    assert span_basis(np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -1e-3]])).shape == (1, 3)
    assert span_basis(np.zeros((4, 3))).shape == (0, 3)
