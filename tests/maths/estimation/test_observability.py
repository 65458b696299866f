"""What jets and sensors can do, against cases worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake.maths.estimation.detectors.jet_tests import isolate, jet_tests
from massprop_drake.maths.estimation.observability import (
    activity_rank,
    impulse_jacobian,
    pairs,
    smallest_isolable,
    span,
    unobservable,
    whitened,
)
from massprop_drake.maths.mass_properties import pack
from massprop_drake.maths.vehicle.thrust import thrust_wrenches

Array = NDArray[np.float64]

# inertia diag(1/2, 1/3, 1/4) and products, center of mass off the axes, mass 2
PROPERTIES = pack(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]), np.array([0.1, -0.2, 0.3]), 0.5)
ONES = np.ones(10)


def _wrenches(*jets: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Array:
    """Of jets given as position and force."""
    positions, forces = (np.array([jet[part] for jet in jets]) for part in (0, 1))
    return thrust_wrenches(positions, forces)


# ------------------------------------------------------------------------------------------ activity


def test_six_orthogonal_equal_columns_have_condition_one() -> None:
    # rotation rows are in rad/s^2 at an arm of 2 m: columns 1/2 there weigh as much as columns 1 of translation
    found = activity_rank(np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0]), 2.0)
    assert found.rank == 6
    assert found.condition == pytest.approx(1.0, rel=1e-14)


def test_neither_thrust_nor_unit_changes_rank_and_condition() -> None:
    rng = np.random.default_rng(1)
    activity = rng.standard_normal((6, 9))
    expected = activity_rank(activity, 1.5)
    # jets a thousand times weaker, and feet for meters: translation and arm grow, rotation stays
    weaker = activity * np.where(np.arange(9) < 4, 1e-3, 1.0)
    feet = weaker * np.array([1.0] * 3 + [3.28] * 3)[:, None]
    found = activity_rank(feet, 1.5 * 3.28)
    assert found.rank == expected.rank == 6
    assert found.condition == pytest.approx(expected.condition, rel=1e-12)


def test_condition_of_a_hand_value() -> None:
    # two of the six columns at an angle of 60 deg: their Gram matrix has eigenvalues 1 +- 1/2
    activity = np.eye(6)
    activity[:2, 1] = 0.5, math.sqrt(0.75)
    assert activity_rank(activity, 1.0).condition == pytest.approx(math.sqrt(3.0), rel=1e-12)


@pytest.mark.parametrize(("columns", "rank"), [([0, 1, 2, 3, 4], 5), ([0, 0, 0], 1), ([0, 1, 2, 3, 4, 4, 4], 5)])
def test_missing_directions_lower_the_rank(columns: list[int], rank: int) -> None:
    found = activity_rank(np.eye(6)[:, columns], 1.0)
    assert found == (rank, math.inf)


# ------------------------------------------------------------------------------------- observability


def test_a_jet_along_each_axis_shows_all_ten_parameters() -> None:
    wrenches = _wrenches(((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 1, 0)), ((1, 0, 0), (0, 0, 1)))
    # 3 jets give 9 rows of rotation for 9 parameters
    jacobian = impulse_jacobian(wrenches, PROPERTIES, accelerometer=True)
    assert jacobian.shape == (18, 10)
    assert unobservable(jacobian, ONES).shape == (0, 10)


def test_without_accelerometer_the_mass_stays_hidden() -> None:
    wrenches = _wrenches(((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 1, 0)), ((1, 0, 0), (0, 0, 1)))
    jacobian = impulse_jacobian(wrenches, PROPERTIES, accelerometer=False)
    assert jacobian.shape == (9, 10)
    np.testing.assert_array_equal(unobservable(jacobian, ONES), np.eye(10)[9:])


def test_couples_show_the_inertia_but_neither_mass_nor_center_of_mass() -> None:
    couples = np.hstack([np.eye(3), np.zeros((3, 3))])
    jacobian = impulse_jacobian(couples, PROPERTIES, accelerometer=True)
    np.testing.assert_array_equal(unobservable(jacobian, ONES), np.eye(10)[6:])


def test_parallel_forces_hide_where_the_center_of_mass_lies_along_them() -> None:
    # along z, at four places: no torque about z, so I^-1_zz is not seen either
    wrenches = _wrenches(*(((x, y, 0.0), (0.0, 0.0, 1.0)) for x, y in ((1, 1), (-1, 1), (1, -1), (-1, -1))))
    hidden = unobservable(impulse_jacobian(wrenches, PROPERTIES, accelerometer=True), ONES)
    np.testing.assert_array_equal(hidden, np.eye(10)[[2, 8]])


def test_one_jet_leaves_a_combination_that_can_be_named() -> None:
    # force along x at (0, 1, 0), inertia the identity, center of mass at the origin: moment (0, 0, -1), so
    # dw = (-Ixz^-1, -Iyz^-1, -Izz^-1) and by dr: x cross dr = (0, -dz, dy). Seen: Ixz^-1; Iyz^-1 + dz; Izz^-1 - dy
    properties = pack(np.eye(3), np.zeros(3), 1.0)
    hidden = unobservable(impulse_jacobian(_wrenches(((0, 1, 0), (1, 0, 0))), properties, accelerometer=True), ONES)
    expected = np.zeros((6, 10))
    expected[[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 5, 6]] = 1.0  # Ixx, Iyy, Izz with y, Iyz with z, Ixy, x
    expected[2, 7] = 1.0
    expected[3, 8] = -1.0
    np.testing.assert_allclose(hidden, expected, rtol=0.0, atol=1e-12)


def test_jets_fired_together_show_nothing_more() -> None:
    jets = _wrenches(((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (1, 0, 0)), ((1, 0.5, 0), (0, 1, 0)))
    alone = unobservable(impulse_jacobian(jets, PROPERTIES, accelerometer=True), ONES)
    sums = np.vstack([jets, jets[0] + jets[1], jets[1] + 2.0 * jets[2], jets.sum(axis=0)])
    together = unobservable(impulse_jacobian(sums, PROPERTIES, accelerometer=True), ONES)
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-9)


def test_weak_jets_and_small_units_hide_nothing() -> None:
    wrenches = _wrenches(((0, 1, 0), (1e3, 0, 0)), ((0, 0, 1), (0, 1e-2, 0)), ((1, 0, 0), (0, 0, 1)))
    scale = np.array([1e-7] * 6 + [30.0] * 3 + [1e-4])
    small = PROPERTIES * np.array([1e-7] * 6 + [1.0] * 3 + [1e-4])
    assert unobservable(impulse_jacobian(wrenches, small, accelerometer=True), scale).shape == (0, 10)


# --------------------------------------------------------------------------------------------- alike


def test_pairs_come_in_order_of_their_angles() -> None:
    tilt = 1e-9  # rad: its cosine is one to the last digit
    signatures = np.array([[1.0, 0.0], [-3.0 * math.cos(tilt), 3.0 * math.sin(tilt)], [2.0, 2.0]])
    first, second, third = pairs(signatures)
    assert first[:2] == (0, 1)
    assert first.angle == pytest.approx(tilt, rel=1e-6)
    assert first.opposed
    # the third line lies at 45 deg to the first, and to the second but for the tilt
    for pair in (second, third):
        assert pair.angle == pytest.approx(math.pi / 4.0, abs=2e-9)
    assert {second[:2], third[:2]} == {(0, 2), (1, 2)}
    assert [pair.opposed for pair in sorted((second, third))] == [False, True]


def test_whitening_gives_the_inverse_covariance_as_metric() -> None:
    rng = np.random.default_rng(2)
    root = rng.standard_normal((4, 4))
    covariance = root @ root.T + np.eye(4)
    signatures = rng.standard_normal((3, 4))
    seen = whitened(signatures, covariance)
    np.testing.assert_allclose(seen @ seen.T, signatures @ np.linalg.inv(covariance) @ signatures.T, rtol=1e-10)


# ------------------------------------------------------------------------------------------ isolable


def test_smallest_isolable_force_of_a_hand_value() -> None:
    # jets 0 and 1 at 30 deg, signature 2 and 1 per unit force; jet 2 against jet 0, at 150 deg
    def at(degrees: float, length: float) -> list[float]:
        return [length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees))]

    seen = np.array([at(0.0, 2.0), at(30.0, 1.0), at(150.0, 1.0)])
    on = smallest_isolable(seen, 6.0, lost=False)
    # f^2 4 sin^2 30 = 6; f^2 sin^2 30 = 6; jets 1 and 2 are 120 deg apart and jet 0 150: no rival of jet 2
    np.testing.assert_allclose(on.force, [math.sqrt(6.0), math.sqrt(24.0), math.sqrt(6.0)], rtol=1e-12)
    assert on.rival.tolist() == [1, 0, -1]
    lost = smallest_isolable(seen, 6.0, lost=True)
    # against jet 0: jet 2 by 30 deg from its opposite; jet 1 against jet 2: 60 deg
    np.testing.assert_allclose(lost.force, [math.sqrt(6.0), math.sqrt(8.0), math.sqrt(24.0)], rtol=1e-12)
    assert lost.rival.tolist() == [2, 2, 0]


def test_opposed_on_one_line_never_shows_which_failed_off() -> None:
    seen = np.array([[1.0, 2.0, 0.5], [-1.0, -2.0, -0.5]]) / 3.0
    assert smallest_isolable(seen, 6.0, lost=True).force.tolist() == [math.inf, math.inf]
    assert np.isfinite(smallest_isolable(seen, 6.0, lost=False).force).all()


def test_a_single_jet_has_no_rival() -> None:
    found = smallest_isolable(np.array([[3.0, 4.0]]), 6.0, lost=False)
    np.testing.assert_allclose(found.force, [math.sqrt(6.0) / 5.0], rtol=1e-14)
    assert found.rival.tolist() == [-1]


@pytest.mark.parametrize("lost", [False, True])
def test_the_detectors_own_test_reaches_the_margin_at_that_force(lost: bool) -> None:
    """The margin of `jet_failures` on a sample without noise, jets other than the failed one off."""
    rng = np.random.default_rng(3)
    coefficients = rng.standard_normal((5, 6))
    found = smallest_isolable(coefficients, 6.0, lost=lost)
    for jet in range(5):
        off = np.arange(5) != jet if lost else np.ones(5, dtype=bool)
        innovation = coefficients[jet] * found.force[jet] * (-1.0 if lost else 1.0)
        tests = jet_tests(coefficients, innovation, np.eye(6), off, np.zeros(5, dtype=bool))
        isolation = isolate(tests.likelihood, np.arange(5))
        assert isolation.jet == jet
        assert isolation.cluster_margin == pytest.approx(6.0, rel=1e-9)


def test_a_jet_that_shows_nothing_is_never_found_and_looks_like_no_other() -> None:
    seen = np.array([[1e-17, 0.0], [3.0, 4.0], [4.0, 3.0]])
    found = smallest_isolable(seen, 6.0, lost=False)
    assert found.force[0] == math.inf
    assert found.rival.tolist() == [-1, 2, 1]
    assert np.isfinite(found.force[1:]).all()
    assert [pair[:2] for pair in pairs(seen)] == [(1, 2)]


# ---------------------------------------------------------------------------------------------- span


def test_span_of_vectors() -> None:
    plane = span(np.array([[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [5.0, 0.0, 0.0]]))
    assert plane.shape == (2, 3)
    np.testing.assert_allclose(plane[:, 2], 0.0, atol=1e-15)
    assert span(np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -1e-3]])).shape == (1, 3)
    assert span(np.zeros((4, 3))).shape == (0, 3)
