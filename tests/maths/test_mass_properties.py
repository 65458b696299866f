"""The ten mass properties: packing, table 5-2, derived quantities and their uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import (
    ELEMENT,
    N_ROTATION,
    NAMES,
    MassProperties,
    converged,
    converged_rows,
    could_be_inertia,
    derived,
    initial_standard_deviation,
    pack,
    percent_error,
    six_elements,
    symmetric,
)

# Levy 1983, table 5-2: the orbiter's inverse inertia as printed, 11, 22, 33, 23, 13, 12, 1/(slug-ft^2)
TABLE_5_2_INVERSE = [1.1433330e-06, 1.4817527e-07, 1.4308619e-07, 5.7047686e-11, 4.0054992e-08, 1.3780696e-09]
TABLE_5_2_MASS_RECIPROCAL = 1.6925887e-04  # 1/slug


def ten(inertia: Array, center: tuple[float, float, float] = (1.0, 2.0, 3.0), mass: float = 4.0) -> Array:
    return MassProperties(mass, np.array(center), inertia).vector()


def box(mass: float, x: float, y: float, z: float) -> Array:
    return mass / 12.0 * np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])


def test_elements_stand_in_the_order_of_the_state() -> None:
    matrix = np.array([[11.0, 12.0, 13.0], [12.0, 22.0, 23.0], [13.0, 23.0, 33.0]])
    np.testing.assert_array_equal(six_elements(matrix), [11, 22, 33, 23, 13, 12])
    np.testing.assert_array_equal(symmetric(np.array([11.0, 22.0, 33.0, 23.0, 13.0, 12.0])), matrix)
    np.testing.assert_array_equal(symmetric(np.arange(6.0)), ELEMENT)


def test_names_spell_the_order_of_the_elements() -> None:
    axes = "xyz"
    for i in range(3):
        for j in range(i, 3):
            assert NAMES[ELEMENT[i, j]] == f"I{axes[i]}{axes[j]}_inv"
    assert NAMES[6:] == ("x_cm", "y_cm", "z_cm", "m_inv")
    assert len(NAMES) == N_ROTATION + 1


def test_packing_puts_center_and_mass_reciprocal_last() -> None:
    packed = pack(symmetric(np.arange(1.0, 7.0)), np.array([7.0, 8.0, 9.0]), 10.0)
    np.testing.assert_array_equal(packed, np.arange(1.0, 11.0))


def test_vector_of_hand_value() -> None:
    # diag(2, [[5, 1], [1, 3]]) has the inverse diag(1/2, [[3, -1], [-1, 5]] / 14)
    vector = ten(np.array([[2.0, 0.0, 0.0], [0.0, 5.0, 1.0], [0.0, 1.0, 3.0]]))
    np.testing.assert_allclose(vector, [0.5, 3 / 14, 5 / 14, -1 / 14, 0.0, 0.0, 1.0, 2.0, 3.0, 0.25], rtol=1e-14)


def test_orbiters_inverse_is_that_of_table_5_2(orbiter: Vehicle) -> None:
    vector = orbiter.nominal.vector()
    # eight digits are printed, but computed with about seven: the reciprocal of the printed mass differs from the
    # printed one by 1e-7. The small product elements lose one more digit by cancellation
    np.testing.assert_allclose(vector[:6], TABLE_5_2_INVERSE, rtol=1e-5)
    np.testing.assert_allclose(vector[9], TABLE_5_2_MASS_RECIPROCAL, rtol=2e-7)


def test_box_has_a_possible_inertia() -> None:
    assert could_be_inertia(box(3.0, 1.0, 2.0, 4.0))


def test_thin_plate_is_the_limit_of_the_possible() -> None:
    # moments 1, 2, 3: the largest equals the sum of the others
    assert could_be_inertia(np.diag([1.0, 2.0, 3.0]))
    assert not could_be_inertia(np.diag([1.0, 2.0, 3.001]))
    assert could_be_inertia(np.diag([1.0, 2.0, 3.001]), tolerance=1e-3)  # 0.001 of a trace of 6.001


def test_triangle_inequality_holds_for_principal_moments_not_for_the_diagonal() -> None:
    # moments 1, 1, 2.5 turned by 45 degrees about y: diagonal 1.75, 1, 1.75 alone would pass
    matrix = np.array([[1.75, 0.0, 0.75], [0.0, 1.0, 0.0], [0.75, 0.0, 1.75]])
    assert not could_be_inertia(matrix)


@pytest.mark.parametrize(
    "inertia",
    [
        np.diag([1.0, 1.0, -1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.diag([1.0, 1.0, np.nan]),
        np.diag([1.0, np.inf, np.inf]),
    ],
)
def test_indefinite_or_not_finite_inertia_is_impossible(inertia: Array) -> None:
    assert not could_be_inertia(inertia)


def test_derived_mass_and_inertia_undo_the_inverses(orbiter: Vehicle) -> None:
    answer = derived(orbiter.nominal.vector(), np.zeros((10, 10)))
    assert answer.mass == pytest.approx(orbiter.nominal.mass, rel=1e-14)
    assert answer.mass_std == 0.0
    assert answer.physically_possible
    assert answer.inertia is not None
    # inverted twice; the condition number is 8
    np.testing.assert_allclose(answer.inertia, orbiter.nominal.inertia, rtol=0.0, atol=1e-14 * 7e6)
    np.testing.assert_array_equal(answer.inertia_std, np.zeros((3, 3)))


def test_derived_inertia_std_agrees_with_finite_differences(orbiter: Vehicle) -> None:
    estimate = orbiter.nominal.vector()
    rng = np.random.default_rng(1)
    # correlated errors of the six elements, between 0.1 % and 1 % of the diagonal
    scale = 1e-3 * np.sqrt(estimate[[0, 1, 2, 1, 0, 0]] * estimate[[0, 1, 2, 2, 2, 1]])
    factor = scale[:, None] * rng.standard_normal((6, 8))
    covariance = np.zeros((10, 10))
    covariance[:6, :6] = factor @ factor.T

    jacobian = np.empty((6, 6))
    for column in range(6):
        step = np.zeros(6)
        step[column] = 0.1 * scale[column]
        ahead, behind = (np.linalg.inv(symmetric(estimate[:6] + sign * step)) for sign in (1.0, -1.0))
        jacobian[:, column] = six_elements(ahead - behind) / (2.0 * step[column])
    expected = np.sqrt(np.diag(jacobian @ covariance[:6, :6] @ jacobian.T))

    # steps of 1e-4 of the diagonal: the central difference errs by about (1e-4)^2, with a condition of 8
    answer = derived(estimate, covariance)
    assert answer.inertia_std is not None
    np.testing.assert_allclose(answer.inertia_std, symmetric(expected), rtol=1e-6)


def test_derived_inertia_std_of_hand_value() -> None:
    # I^-1 = diag(1/2, 1/4, 1/5): dI_ij = -I_i dI^-1_ij I_j
    estimate = np.array([0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    deviation = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-3
    answer = derived(estimate, np.diag([*deviation**2, 0.0, 0.0, 0.0, 0.0]))
    expected = np.array([[4.0, 48.0, 50.0], [48.0, 32.0, 80.0], [50.0, 80.0, 75.0]]) * 1e-3
    np.testing.assert_allclose(answer.inertia_std, expected, rtol=1e-12)


def test_derived_std_agrees_with_samples() -> None:
    rng = np.random.default_rng(2)
    estimate = ten(np.array([[4.0, 0.3, -0.2], [0.3, 5.0, 0.4], [-0.2, 0.4, 6.0]]))
    deviation = np.array([2e-4] * 6 + [0.1] * 3 + [5e-4])
    samples = estimate + deviation * rng.standard_normal((40_000, 10))
    answer = derived(estimate, np.diag(deviation**2))
    # a standard deviation from n samples errs by 1 / sqrt(2 n) = 0.35 %; the terms beyond first order
    # are (2e-4 * 6)^2 of it at most
    masses = 1.0 / samples[:, 9]
    assert answer.mass_std == pytest.approx(masses.std(), rel=5 * 0.0035)
    inertias = np.linalg.inv(samples[:, ELEMENT])
    np.testing.assert_allclose(answer.inertia_std, inertias.std(axis=0), rtol=5 * 0.0035)


def test_derived_mass_is_missing_where_its_reciprocal_is_not_positive() -> None:
    estimate = ten(box(3.0, 1.0, 2.0, 4.0))
    for reciprocal in (0.0, -0.1):
        estimate[9] = reciprocal
        answer = derived(estimate, np.eye(10))
        assert answer.mass is None
        assert answer.mass_std is None
        assert answer.inertia is not None
        assert not answer.physically_possible


def test_derived_inertia_is_missing_where_its_inverse_is_singular() -> None:
    estimate = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5])  # first two rows equal
    for elements in (estimate, np.array([0.0] * 9 + [0.5])):  # at the start nothing is known
        answer = derived(elements, np.eye(10))
        assert answer.mass == 2.0
        assert answer.inertia is None
        assert answer.inertia_std is None
        assert not answer.physically_possible


def test_derived_inertia_that_no_body_has_is_shown_but_called_impossible() -> None:
    answer = derived(ten(np.diag([1.0, 1.0, 3.0])), np.zeros((10, 10)))
    np.testing.assert_allclose(answer.inertia, np.diag([1.0, 1.0, 3.0]), rtol=1e-14)
    assert not answer.physically_possible


def test_initial_standard_deviation_of_hand_value() -> None:
    # products: 0.5 sqrt(4*9) = 3, 0.5 sqrt(1*9) = 1.5, 0.5 sqrt(1*4) = 1, each against half the nominal
    nominal = np.array([1.0, 4.0, 9.0, 0.0, -8.0, 0.1, 10.0, -0.2, 0.0, 0.25])
    deviation = initial_standard_deviation(nominal, 0.5, 2.0)
    np.testing.assert_allclose(deviation, [0.5, 2.0, 4.5, 3.0, 4.0, 1.0, 5.0, 2.0, 2.0, 0.125], rtol=1e-15)


def test_initial_standard_deviation_without_floors_is_the_fraction_alone() -> None:
    nominal = np.array([1.0, 4.0, 9.0, 0.0, -8.0, 0.1, 10.0, -0.2, 0.0, 0.25])
    deviation = initial_standard_deviation(nominal, 0.5, 2.0, floors=False)
    np.testing.assert_array_equal(deviation, 0.5 * np.abs(nominal))


def test_initial_standard_deviation_without_a_floor_of_the_center_still_has_those_of_products() -> None:
    nominal = np.array([1.0, 4.0, 9.0, 0.0, -8.0, 0.1, 10.0, -0.2, 0.0, 0.25])
    deviation = initial_standard_deviation(nominal, 1.0, None)
    np.testing.assert_array_equal(deviation[6:9], [10.0, 0.2, 0.0])
    np.testing.assert_array_equal(deviation[3:6], [6.0, 8.0, 2.0])


def test_initial_standard_deviation_leaves_the_nominal_alone() -> None:
    nominal = np.array([1.0, 4.0, 9.0, 0.0, -8.0, 0.1, 10.0, -0.2, 0.0, 0.25])
    before = nominal.copy()
    initial_standard_deviation(nominal, 1.0, 5.0)
    np.testing.assert_array_equal(nominal, before)


def test_percent_error_is_relative_to_the_size_of_the_truth() -> None:
    truth = np.array([2.0, 1.0, 1.0, 0.5, -0.5, 0.1, 10.0, -4.0, 1.0, 0.1])
    estimate = np.array([2.02, 0.9, 1.0, 0.55, -0.6, 0.1, 9.0, -5.0, 1.5, 0.2])
    expected = [1.0, -10.0, 0.0, 10.0, -20.0, 0.0, -10.0, -25.0, 50.0, 100.0]
    np.testing.assert_allclose(percent_error(estimate, truth), expected, rtol=1e-12, atol=1e-12)


def test_percent_error_of_a_truth_that_is_as_good_as_zero_is_not_a_number() -> None:
    # floors: 1e-9 sqrt(4*9) = 6e-9, 1e-9 sqrt(1*9) = 3e-9, 1e-9 sqrt(1*4) = 2e-9; 1e-9 * 5 of the center
    truth = np.array([1.0, 4.0, 9.0, 5e-9, 4e-9, -1e-9, 3.0, 4.0, 4e-9, 1.0])
    error = percent_error(np.zeros(10), truth)
    np.testing.assert_array_equal(np.isnan(error), [False, False, False, True, False, True, False, False, True, False])
    truth[[3, 5, 8]] = [7e-9, -3e-9, 6e-9]
    assert not np.isnan(percent_error(np.zeros(10), truth)).any()


def test_percent_error_that_no_number_can_hold_is_not_a_number() -> None:
    truth = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 2.2e-311, 0.0, 0.0, 1.0])
    error = percent_error(np.full(10, 0.1), truth)
    assert np.isnan(error[6])
    assert error[0] == pytest.approx(-90.0)


# standard deviations just inside the limits 1 %, 0.5 and 2 % of an estimate
CONVERGED_ESTIMATE = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.1])
CONVERGED_STD = np.array([0.0099, 0.0199, 0.0299, 9.0, 9.0, 9.0, 0.49, 0.49, 0.49, 0.0019])
LIMITS = np.array([0.01, 0.5, 0.02])


def test_estimates_within_their_limits_have_converged() -> None:
    assert converged(CONVERGED_STD, CONVERGED_ESTIMATE, LIMITS)


@pytest.mark.parametrize(
    ("element", "value"),
    [(0, 0.0101), (1, 0.0201), (2, 0.0301), (6, 0.51), (7, 0.51), (8, 0.51), (9, 0.0021), (0, 0.0), (9, 0.0)],
)
def test_one_element_outside_its_limit_prevents_convergence(element: int, value: float) -> None:
    deviation = CONVERGED_STD.copy()
    deviation[element] = value
    assert not converged(deviation, CONVERGED_ESTIMATE, LIMITS)


@pytest.mark.parametrize("element", [0, 1, 2, 9])
def test_negative_estimate_of_a_positive_quantity_prevents_convergence(element: int) -> None:
    estimate = CONVERGED_ESTIMATE.copy()
    estimate[element] *= -1.0
    assert not converged(CONVERGED_STD, estimate, LIMITS)


def test_many_samples_are_judged_as_each_alone() -> None:
    rng = np.random.default_rng(5)
    limits = np.array([0.5, 0.6, 0.7])
    estimate = rng.uniform(-0.1, 1.0, (400, 10))
    deviation = rng.uniform(-0.02, 0.7, (400, 10)) * np.where(rng.random((400, 1)) < 0.5, 0.4, 1.0)
    deviation[0, 9] = np.nan
    each = [converged(d, e, limits) for d, e in zip(deviation, estimate, strict=True)]
    assert 5 < sum(each) < 395
    np.testing.assert_array_equal(converged_rows(deviation, estimate, limits), each)
