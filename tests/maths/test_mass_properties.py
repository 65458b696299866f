"""The ten mass properties: packing, table 5-2, derived quantities and their uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import (
    ELEMENT,
    N_ROTATION,
    NAMES,
    MassProperties,
    are_converged,
    attach_body,
    derive_mass_and_inertia,
    initial_standard_deviation,
    is_converged,
    is_possible_inertia,
    pack,
    percent_error,
    six_elements,
    symmetric_matrix,
)

# Levy 1983, table 5-2: the orbiter's inverse inertia as printed, 11, 22, 33, 23, 13, 12, 1/(slug-ft^2)
TABLE_5_2_INVERSE = [1.1433330e-06, 1.4817527e-07, 1.4308619e-07, 5.7047686e-11, 4.0054992e-08, 1.3780696e-09]
TABLE_5_2_MASS_RECIPROCAL = 1.6925887e-04  # 1/slug


def ten(inertia: Array, mass: float = 4.0) -> Array:
    return MassProperties(mass, np.array([1.0, 2.0, 3.0]), inertia).vector()


def test_elements_stand_in_the_order_of_the_state() -> None:
    matrix = np.array([[11.0, 12.0, 13.0], [12.0, 22.0, 23.0], [13.0, 23.0, 33.0]])
    assert_array_equal(six_elements(matrix), [11, 22, 33, 23, 13, 12])
    assert_array_equal(symmetric_matrix(six_elements(matrix)), matrix)
    assert_array_equal(symmetric_matrix(np.arange(6.0)), ELEMENT)
    assert_array_equal(
        pack(symmetric_matrix(np.arange(1.0, 7.0)), np.array([7.0, 8.0, 9.0]), 10.0), np.arange(1.0, 11.0)
    )
    axes = "xyz"
    assert [NAMES[ELEMENT[i, j]] for i in range(3) for j in range(i, 3)] == [
        f"I{axes[i]}{axes[j]}_inv" for i in range(3) for j in range(i, 3)
    ]
    assert NAMES[6:] == ("x_cm", "y_cm", "z_cm", "m_inv")
    assert len(NAMES) == N_ROTATION + 1


def test_the_parallel_axis_theorem_against_point_masses() -> None:
    def of_cloud(masses: Array, places: Array) -> MassProperties:
        center = masses @ places / masses.sum()
        inertias = [m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, places - center, strict=True)]
        return MassProperties(masses.sum(), center, np.sum(inertias, axis=0))

    rng = np.random.default_rng(1)
    masses, places = rng.uniform(0.5, 2.0, 11), rng.normal(size=(11, 3))
    both, body, payload = of_cloud(masses, places), of_cloud(masses[:7], places[:7]), of_cloud(masses[7:], places[7:])
    docked = attach_body(body, *payload)
    released = attach_body(both, -payload.mass, payload.center_of_mass, -payload.inertia)
    for found, expected in ((docked, both), (released, body)):
        for one, other in zip(found, expected, strict=True):
            assert_allclose(one, other, rtol=1e-14, atol=1e-13)


@pytest.mark.parametrize(
    ("inertia", "possible"),
    [
        (np.diag([20.0, 17.0, 5.0]), True),  # a box
        (np.diag([1.0, 2.0, 3.0]), True),  # a plate is the limit: the largest equals the sum of the others
        (np.diag([1.0, 2.0, 3.001]), False),
        # moments 1, 1, 2.5 turned by 45 degrees about y: the diagonal alone would pass
        (np.array([[1.75, 0.0, 0.75], [0.0, 1.0, 0.0], [0.75, 0.0, 1.75]]), False),
        (np.diag([1.0, 1.0, -1.0]), False),
        (np.diag([1.0, 1.0, 0.0]), False),
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), False),
        (np.diag([1.0, 1.0, np.nan]), False),
        (np.diag([1.0, np.inf, np.inf]), False),
    ],
)
def test_a_body_can_have_an_inertia(inertia: Array, possible: bool) -> None:
    assert is_possible_inertia(inertia) == possible
    assert is_possible_inertia(np.diag([1.0, 2.0, 3.001]), tolerance=1e-3)  # 0.001 of a trace of 6.001


def test_derived_std_is_that_of_the_differentials(orbiter: Vehicle) -> None:
    estimate, rng = orbiter.nominal.vector(), np.random.default_rng(1)
    # correlated errors of the six elements, between 0.1 % and 1 % of the diagonal
    scale = 1e-3 * np.sqrt(estimate[[0, 1, 2, 1, 0, 0]] * estimate[[0, 1, 2, 2, 2, 1]])
    factor, covariance = scale[:, None] * rng.standard_normal((6, 8)), np.zeros((10, 10))
    covariance[:6, :6], covariance[9, 9] = factor @ factor.T, (1e-3 * estimate[9]) ** 2
    jacobian = np.empty((6, 6))
    for column in range(6):
        step = 0.1 * scale[column] * np.eye(6)[column]
        ahead, behind = (np.linalg.inv(symmetric_matrix(estimate[:6] + sign * step)) for sign in (1.0, -1.0))
        jacobian[:, column] = six_elements(ahead - behind) / (2.0 * step[column])
    expected = np.sqrt(np.diag(jacobian @ covariance[:6, :6] @ jacobian.T))
    answer = derive_mass_and_inertia(estimate, covariance)
    assert answer.physically_possible
    assert answer.inertia is not None
    assert_allclose(answer.inertia, orbiter.nominal.inertia, rtol=0.0, atol=1e-14 * 7e6)  # inverted twice
    # steps of 1e-4 of the diagonal: the central difference errs by about (1e-4)^2, with a condition of 8
    assert_allclose(answer.inertia_std, symmetric_matrix(expected), rtol=1e-6)
    assert answer.mass == pytest.approx(orbiter.nominal.mass, rel=1e-14)
    assert answer.mass_std == pytest.approx(1e-3 * orbiter.nominal.mass, rel=1e-12)


SINGULAR = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5])  # first two rows equal
BOX = ten(np.diag([20.0, 17.0, 5.0]))


@pytest.mark.parametrize(
    ("estimate", "mass", "inertia"),
    [
        (np.append(BOX[:9], 0.0), None, np.diag([20.0, 17.0, 5.0])),
        (np.append(BOX[:9], -0.1), None, np.diag([20.0, 17.0, 5.0])),
        (SINGULAR, 2.0, None),
        (np.array([0.0] * 9 + [0.5]), 2.0, None),  # at the start nothing is known
        (ten(np.diag([1.0, 1.0, 3.0])), 4.0, np.diag([1.0, 1.0, 3.0])),  # no body has it, and yet it is shown
    ],
)
def test_what_no_body_has_is_said(estimate: Array, mass: float | None, inertia: Array | None) -> None:
    answer = derive_mass_and_inertia(estimate, np.eye(10))
    assert (answer.mass, answer.mass_std is None) == (mass, mass is None)
    assert not answer.physically_possible
    assert (answer.inertia is None) == (answer.inertia_std is None) == (inertia is None)
    if inertia is not None:
        assert_allclose(answer.inertia, inertia, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("floor", "floors", "expected"),
    [
        # products: 0.5 sqrt(4*9) = 3, 0.5 sqrt(1*9) = 1.5, 0.5 sqrt(1*4) = 1, each against half the nominal
        (2.0, True, [0.5, 2.0, 4.5, 3.0, 4.0, 1.0, 5.0, 2.0, 2.0, 0.125]),
        (None, True, [0.5, 2.0, 4.5, 3.0, 4.0, 1.0, 5.0, 0.1, 0.0, 0.125]),
        (2.0, False, [0.5, 2.0, 4.5, 0.0, 4.0, 0.05, 5.0, 0.1, 0.0, 0.125]),
    ],
)
def test_initial_standard_deviation_of_hand_value(floor: float | None, floors: bool, expected: list[float]) -> None:
    nominal = np.array([1.0, 4.0, 9.0, 0.0, -8.0, 0.1, 10.0, -0.2, 0.0, 0.25])
    assert_allclose(initial_standard_deviation(nominal, 0.5, floor, floors=floors), expected, rtol=1e-15)


def test_percent_error_is_relative_to_the_size_of_the_truth() -> None:
    truth = np.array([2.0, 1.0, 1.0, 0.5, -0.5, 0.1, 10.0, -4.0, 1.0, 0.1])
    estimate = np.array([2.02, 0.9, 1.0, 0.55, -0.6, 0.1, 9.0, -5.0, 1.5, 0.2])
    expected = [1.0, -10.0, 0.0, 10.0, -20.0, 0.0, -10.0, -25.0, 50.0, 100.0]
    assert_allclose(percent_error(estimate, truth), expected, rtol=1e-12, atol=1e-12)
    # floors: 1e-9 sqrt(4*9) = 6e-9, 1e-9 sqrt(1*9) = 3e-9, 1e-9 sqrt(1*4) = 2e-9; 1e-9 * 5 of the center
    truth = np.array([1.0, 4.0, 9.0, 5e-9, 4e-9, -1e-9, 3.0, 4.0, 4e-9, 1.0])
    assert np.flatnonzero(np.isnan(percent_error(np.zeros(10), truth))).tolist() == [3, 5, 8]
    truth[[3, 5, 8]] = [7e-9, -3e-9, 6e-9]
    assert not np.isnan(percent_error(np.zeros(10), truth)).any()
    error = percent_error(np.full(10, 0.1), np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 2.2e-311, 0.0, 0.0, 1.0]))
    assert np.isnan(error[6])  # which no number can hold
    truth[6:10] = [2e-9, 9e-10, 0.0, 4.0]  # a center at the origin: 1e-9 of the radius of gyration, sqrt(4 / 1)
    assert np.isnan(percent_error(np.ones(10), truth)[6:9]).all()
    assert error[0] == pytest.approx(-90.0)


# standard deviations just inside the limits 1 %, 0.5 and 2 % of an estimate
ESTIMATE = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.1])
DEVIATION = np.array([0.0099, 0.0199, 0.0299, 9.0, 9.0, 9.0, 0.49, 0.49, 0.49, 0.0019])
LIMITS = np.array([0.01, 0.5, 0.02])


@pytest.mark.parametrize("element", [None, 0, 1, 2, 6, 7, 8, 9])
def test_estimates_have_converged_when_each_is_within_its_limit(element: int | None) -> None:
    assert is_converged(DEVIATION, ESTIMATE, LIMITS)
    for value, sign in ((1.06, 1.0), (0.0, 1.0), (1.0, -1.0)):
        deviation, estimate = DEVIATION.copy(), ESTIMATE.copy()
        if element is not None:
            deviation[element] *= value
            estimate[element] *= sign
        good = element is None or (element in (6, 7, 8) and value != 1.06)
        assert is_converged(deviation, estimate, LIMITS) == good
        assert are_converged(deviation[None], estimate[None], LIMITS).tolist() == [good]
        known = np.arange(10) == (9 if element is None else element)  # what is known blocks nothing
        assert are_converged(deviation[None], estimate[None], LIMITS, known).all()
    assert not are_converged(np.full((1, 10), np.nan), ESTIMATE[None], LIMITS).any()
