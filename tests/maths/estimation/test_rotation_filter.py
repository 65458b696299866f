"""The second-order filter against its full form, sampling, batch least squares and symmetries."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from params_probe import rotation_params

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCoupling,
    RotationInnovation,
    RotationInterval,
    RotationMemory,
    RotationParams,
    RotationSample,
    RotationState,
    angular_block,
    coupling_increment,
    coupling_jacobian,
    finish,
    innovate,
    joseph_update,
    measure,
    rate_increment,
    rate_increment_jacobian,
    second_order_terms,
    update,
)
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError, is_covariance, skew
from massprop_drake.maths.mass_properties import ELEMENT, MassProperties, six_elements, symmetric
from massprop_drake.maths.vehicle.rigid_body import RATE, body_of, initial_state, step

PERIOD = 0.08  # s
NONE = np.zeros(3)
SETTINGS = rotation_params(period_s=PERIOD)

# a body of moderate numbers: inertia of a few units, center of mass within a unit
INVERSE = np.linalg.inv(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]))
STATE = np.concatenate([six_elements(INVERSE), [0.5, -0.3, 0.2]])
ANGULAR = np.array([0.7, -1.1, 0.4])
LINEAR = np.array([0.9, 0.6, -1.3])
TORQUE_ALONE = np.array([1.0 / 2.0, 2.0, 1.0 / 3.0])
TUMBLING = np.array([0.3, -0.4, 0.5])  # rad/s


def angular_matrix(angular: Array) -> Array:
    """A of (2-53), written out."""
    a1, a2, a3 = angular
    return np.array(
        [
            [a1, 0, 0, 0, a3, a2, 0, 0, 0],
            [0, a2, 0, a3, 0, a1, 0, 0, 0],
            [0, 0, a3, a2, a1, 0, 0, 0, 0],
        ]
    )


def linear_matrices(linear: Array) -> Array:
    """The three matrices Lambda of (2-54), written out, shape (3, 9, 9)."""
    l1, l2, l3 = linear
    b1, b2, b3, none = [0, -l3, l2], [l3, 0, -l1], [-l2, l1, 0], [0, 0, 0]
    blocks = np.array([[b1, none, none, none, b3, b2], [none, b2, none, b3, none, b1], [none, none, b3, b2, b1, none]])
    matrices = np.zeros((3, 9, 9))
    matrices[:, :6, 6:] = blocks
    matrices[:, 6:, :6] = blocks.transpose(0, 2, 1)
    return matrices


def full_model(states: Array, angular: Array, linear: Array) -> Array:
    """h of (2-55), A x + 1/2 x^T Lambda x, for one state or many."""
    curvature = np.einsum("...i,kij,...j->...k", states, linear_matrices(linear), states)
    return states @ angular_matrix(angular).T + 0.5 * curvature


def random_covariance(rng: np.random.Generator, size: float = 1.0) -> Array:
    """Correlated; standard deviations within a decade, about ``size``."""
    factor = rng.standard_normal((9, 12)) / np.sqrt(12.0)
    scale = size * 10.0 ** rng.uniform(-0.5, 0.5, 9)
    return np.outer(scale, scale) * (factor @ factor.T)


def sample_of(increment: Array, **changes: Any) -> RotationSample:
    noise = np.array([[4e-4, 1e-4, 0.0], [1e-4, 3e-4, 0.0], [0.0, 0.0, 2e-4]])
    return RotationSample(increment, NONE, noise, 0.0, ANGULAR, LINEAR, firing=True)._replace(**changes)


class Cycled(NamedTuple):
    """Both halves of a cycle."""

    sample: RotationSample
    innovation: RotationInnovation
    estimate: Array
    covariance: Array
    used: bool
    jumped: bool


def cycled(params: RotationParams = SETTINGS, **changes: Any) -> Cycled:
    arguments: dict[str, Any] = {
        "estimate": STATE,
        "covariance": random_covariance(np.random.default_rng(1), 0.01),
        "rate_before": np.array([0.010, -0.020, 0.005]),
        "subtract_coupling": False,
        "rate": np.array([0.012, -0.500, 0.150]),
        "reading_variance": 0.5e-4,
        "extra_noise": None,
        "angular_impulse": ANGULAR,
        "linear_impulse": LINEAR,
        "usable": True,
        "firing": True,
    }
    arguments |= changes
    usable = arguments.pop("usable")
    state = RotationState(arguments.pop("estimate"), arguments.pop("covariance"))
    memory = RotationMemory(arguments.pop("rate_before")[None], arguments.pop("subtract_coupling"))
    rates = arguments.pop("rate")[None]
    params = params._replace(gyro_variances=np.array([arguments.pop("reading_variance")]))
    interval = RotationInterval(acting=arguments.pop("firing"), **arguments)
    measurement = measure(state, memory, rates, interval, params)
    done = finish(state, measurement, usable, NO_ADAPTATION, params)
    return Cycled(
        measurement.sample, measurement.innovation, done.state.estimate, done.state.covariance, done.used, done.jumped
    )


# ---------------------------------------------------------------- measurement function


def test_first_linear_impulse_matrix_is_that_of_the_sources_example() -> None:
    # lambda = (1, 2, 3): I^-1_11 meets (lambda x r)_1 = 2 z - 3 y, I^-1_12 the second, I^-1_13 the third
    block = linear_matrices(np.array([1.0, 2.0, 3.0]))[0, :6, 6:]
    np.testing.assert_array_equal(block, [[0, -3, 2], [0, 0, 0], [0, 0, 0], [0, 0, 0], [-2, 1, 0], [3, 0, -1]])


def test_angular_block_is_the_left_part_of_the_written_out_matrix() -> None:
    np.testing.assert_array_equal(angular_block(ANGULAR), angular_matrix(ANGULAR)[:, :6])


def test_rate_increment_of_hand_value() -> None:
    # lambda x r = (1, 0, 0) x (0, 2, 0) = (0, 0, 2); a + that = (1, 1, 3); I^-1 rows (1, .5, 0), (.5, 2, 0), (0, 0, 4)
    state = np.array([1.0, 2.0, 4.0, 0.0, 0.0, 0.5, 0.0, 2.0, 0.0])
    increment = rate_increment(state, np.array([1.0, 1.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(increment, [1.5, 2.5, 12.0])


def test_rate_increment_equals_the_full_form() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        state, angular, linear = rng.standard_normal(9), *rng.standard_normal((2, 3))
        expected = full_model(state, angular, linear)
        # two dozen products of numbers up to three, cubed
        np.testing.assert_allclose(rate_increment(state, angular, linear), expected, rtol=0.0, atol=5e-14)


def test_rate_increment_is_what_an_impulse_about_the_center_of_mass_gives(orbiter: Vehicle) -> None:
    # I^-1 sum r x T dt with arms from the center of mass, jet by jet
    nominal = orbiter.nominal
    command = np.zeros(44)
    command[[3, 14, 33]] = 1.0
    arms = orbiter.positions - nominal.center_of_mass
    torque = command @ np.cross(arms, orbiter.thrusts)
    impulse = PERIOD * command @ orbiter.wrenches
    increment = rate_increment(nominal.vector()[:9], impulse[:3], impulse[3:])
    # torques of 8e4 lbf-ft cancel down to the smallest increment
    expected = PERIOD * np.linalg.solve(nominal.inertia, torque)
    np.testing.assert_allclose(increment, expected, rtol=0.0, atol=1e-14 * np.abs(expected).max())


def test_jacobian_equals_the_full_form_and_central_differences() -> None:
    # A + x^T Lambda (2-102). h is bilinear, so central differences err by rounding alone: 1e-16 / 1e-3
    rng = np.random.default_rng(3)
    for _ in range(20):
        state, angular, linear = rng.standard_normal(9), *rng.standard_normal((2, 3))
        jacobian = rate_increment_jacobian(state, angular, linear)
        written_out = angular_matrix(angular) + np.einsum("i,kij->kj", state, linear_matrices(linear))
        np.testing.assert_allclose(jacobian, written_out, rtol=0.0, atol=1e-14)
        for column in range(9):
            change = 1e-3 * np.eye(9)[column]
            ahead, behind = (rate_increment(state + sign * change, angular, linear) for sign in (1.0, -1.0))
            np.testing.assert_allclose(jacobian[:, column], (ahead - behind) / 2e-3, rtol=0.0, atol=1e-11)


def test_hessian_is_the_linear_impulse_matrix() -> None:
    # the jacobian is linear in the state (2-103): central differences err by rounding alone
    expected = linear_matrices(LINEAR)
    for column in range(9):
        change = 1e-3 * np.eye(9)[column]
        ahead, behind = (rate_increment_jacobian(STATE + sign * change, ANGULAR, LINEAR) for sign in (1.0, -1.0))
        np.testing.assert_allclose((ahead - behind) / 2e-3, expected[:, :, column], rtol=0.0, atol=1e-12)


# ---------------------------------------------------------------- second-order terms


def test_second_order_terms_equal_the_traces_of_the_full_form() -> None:
    # (2-118) and (2-121): 1/2 tr(Lambda_i S), 1/2 tr(Lambda_i S Lambda_j S)
    rng = np.random.default_rng(4)
    for _ in range(20):
        covariance, linear = random_covariance(rng), rng.standard_normal(3)
        bias, curvature = second_order_terms(covariance, linear)
        products = linear_matrices(linear) @ covariance
        expected_bias = 0.5 * np.einsum("kii->k", products)
        expected_curvature = 0.5 * np.einsum("kij,lji->kl", products, products)
        # sums of up to 81 products; epsilon times the largest of them
        size = np.abs(products).max()
        np.testing.assert_allclose(bias, expected_bias, rtol=0.0, atol=1e-14 * size)
        np.testing.assert_allclose(curvature, expected_curvature, rtol=0.0, atol=1e-14 * size**2)


def test_second_order_terms_of_hand_value() -> None:
    # only dI^-1_11 (variance 4) and dz (variance 9, covariance 3 with it) are unknown; lambda = (0, 2, 0):
    # (lambda x dr)_1 = 2 dz, so the term is 2 dI^-1_11 dz along x: b = 2 * 3, D = 4 (4 * 9 + 3 * 3)
    covariance = np.zeros((9, 9))
    covariance[0, 0], covariance[8, 8] = 4.0, 9.0
    covariance[0, 8] = covariance[8, 0] = 3.0
    bias, curvature = second_order_terms(covariance, np.array([0.0, 2.0, 0.0]))
    np.testing.assert_array_equal(bias, [6, 0, 0])
    np.testing.assert_array_equal(curvature, np.diag([180.0, 0.0, 0.0]))


def test_second_order_terms_vanish_where_the_center_of_mass_is_known() -> None:
    covariance = random_covariance(np.random.default_rng(5))
    covariance[6:] = 0.0
    covariance[:, 6:] = 0.0
    bias, curvature = second_order_terms(covariance, LINEAR)
    np.testing.assert_array_equal(bias, NONE)
    np.testing.assert_array_equal(curvature, np.zeros((3, 3)))


def test_second_order_terms_are_the_moments_of_sampled_quadratic_forms() -> None:
    # lemma (2-112) with A, B the linear-impulse matrices: for x of mean zero, 1/2 x^T Lambda_i x has the mean
    # b_i, and the product of two has the mean D_ij + b_i b_j
    rng = np.random.default_rng(6)
    covariance = random_covariance(rng)
    bias, curvature = second_order_terms(covariance, LINEAR)
    count = 400_000
    forms = full_model(rng.standard_normal((count, 9)) @ np.linalg.cholesky(covariance).T, NONE, LINEAR)
    # standard errors from the sampled spread itself; 5 of them
    assert (np.abs(forms.mean(axis=0) - bias) < 5.0 * forms.std(axis=0) / np.sqrt(count)).all()
    for i in range(3):
        for j in range(i, 3):
            products = forms[:, i] * forms[:, j]
            expected = curvature[i, j] + bias[i] * bias[j]
            assert abs(products.mean() - expected) < 5.0 * products.std() / np.sqrt(count)


def test_innovation_of_a_gaussian_state_has_zero_mean_and_the_covariance_claimed() -> None:
    # (2-117) to (2-120), the gain's E{e dx^T} = H S, and so a mean NIS of 3, by sampling state and noise
    rng = np.random.default_rng(7)
    covariance = random_covariance(rng, 0.5)
    dut = innovate(RotationState(STATE, covariance), sample_of(NONE), False, SETTINGS)
    noise = sample_of(NONE).noise
    count = 400_000
    errors = rng.standard_normal((count, 9)) @ np.linalg.cholesky(covariance).T
    measured = full_model(STATE + errors, ANGULAR, LINEAR)
    measured += rng.standard_normal((count, 3)) @ np.linalg.cholesky(noise).T
    innovations = measured + dut.innovation  # that of a measurement of zero is minus the prediction

    def within_five_standard_errors(products: Array, expected: Array) -> bool:
        return bool((np.abs(products.mean(axis=0) - expected) < 5.0 * products.std(axis=0) / np.sqrt(count)).all())

    assert within_five_standard_errors(innovations, NONE)
    assert within_five_standard_errors(innovations[:, :, None] * innovations[:, None], dut.covariance)
    assert within_five_standard_errors(innovations[:, :, None] * errors[:, None], dut.jacobian @ covariance)
    nis = np.einsum("ni,ij,nj->n", innovations, dut.information, innovations)
    assert within_five_standard_errors(nis[:, None], np.array([3.0]))
    # the test can tell: without b and D the mean and the covariance are off by many standard errors
    bias, curvature = second_order_terms(covariance, LINEAR)
    assert not within_five_standard_errors(innovations + bias, NONE)
    assert not within_five_standard_errors(innovations[:, :, None] * innovations[:, None], dut.covariance - curvature)


# ---------------------------------------------------------------- innovation and update


def test_innovation_of_the_second_order_filter_is_put_together_from_its_terms() -> None:
    covariance = random_covariance(np.random.default_rng(8), 0.1)
    increment = np.array([0.3, -0.2, 0.1])
    disturbance = np.diag([1e-4, 2e-4, 3e-4])
    dut = innovate(
        RotationState(STATE, covariance),
        sample_of(increment),
        False,
        SETTINGS._replace(disturbance_covariance=disturbance),
    )
    bias, curvature = second_order_terms(covariance, LINEAR)
    jacobian = rate_increment_jacobian(STATE, ANGULAR, LINEAR)
    noise = curvature + sample_of(increment).noise + disturbance
    total = jacobian @ covariance @ jacobian.T + noise
    expected = increment - rate_increment(STATE, ANGULAR, LINEAR) - bias
    # the same sums in another order
    np.testing.assert_allclose(dut.innovation, expected, rtol=1e-13)
    np.testing.assert_allclose(dut.noise, noise, rtol=1e-13)
    np.testing.assert_allclose(dut.covariance, total, rtol=1e-12)
    np.testing.assert_allclose(dut.information @ total, np.eye(3), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(dut.jacobian, jacobian)
    assert dut.nis == pytest.approx(expected @ np.linalg.solve(total, expected), rel=1e-11)


def test_extended_filter_leaves_out_bias_and_curvature_but_keeps_the_jacobian() -> None:
    covariance = random_covariance(np.random.default_rng(9), 0.1)
    increment = np.array([0.3, -0.2, 0.1])
    sample = sample_of(increment)
    dut = innovate(RotationState(STATE, covariance), sample, False, SETTINGS._replace(second_order=False))
    second = innovate(RotationState(STATE, covariance), sample, False, SETTINGS)
    bias, curvature = second_order_terms(covariance, LINEAR)
    np.testing.assert_array_equal(dut.jacobian, second.jacobian)
    np.testing.assert_array_equal(dut.noise, sample.noise)
    np.testing.assert_allclose(dut.innovation, increment - rate_increment(STATE, ANGULAR, LINEAR), rtol=1e-14)
    np.testing.assert_allclose(dut.innovation - second.innovation, bias, rtol=1e-10)
    np.testing.assert_allclose(second.covariance - dut.covariance, curvature, rtol=1e-10)
    assert np.abs(bias).min() > 1e-4  # they do matter here
    assert np.diag(curvature).min() > 1e-4


def test_extended_and_second_order_filter_agree_where_the_center_of_mass_is_known() -> None:
    covariance = random_covariance(np.random.default_rng(10), 0.1)
    covariance[6:] = 0.0
    covariance[:, 6:] = 0.0
    second, extended = (
        cycled(SETTINGS._replace(second_order=second_order), covariance=covariance) for second_order in (True, False)
    )
    np.testing.assert_array_equal(second.estimate, extended.estimate)
    np.testing.assert_array_equal(second.covariance, extended.covariance)


def test_joseph_form_equals_the_short_form() -> None:
    # S - K H S (2-116) with K = S H^T Y^-1 (2-119), x + K e (2-115)
    rng = np.random.default_rng(11)
    for _ in range(10):
        covariance = random_covariance(rng, 0.3)
        dut = innovate(RotationState(STATE, covariance), sample_of(0.1 * rng.standard_normal(3)), False, SETTINGS)
        estimate, updated, _ = joseph_update(
            RotationState(STATE, covariance), dut.innovation, dut.information, dut.jacobian, dut.noise
        )
        gain = np.linalg.solve(dut.covariance, dut.jacobian @ covariance).T
        # conditioning of Y below 1e4; the covariance relative to its scale
        np.testing.assert_allclose(estimate, STATE + gain @ dut.innovation, rtol=0.0, atol=1e-12)
        scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
        short = covariance - gain @ dut.jacobian @ covariance
        np.testing.assert_allclose(updated / scale, short / scale, rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(updated, updated.T)


def test_used_sample_is_updated_by_joseph_and_then_gets_process_noise() -> None:
    process_noise = random_covariance(np.random.default_rng(12), 1e-3)
    dut = cycled(SETTINGS._replace(process_noise=process_noise))
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    e = dut.innovation
    estimate, updated, _ = joseph_update(
        RotationState(STATE, covariance), e.innovation, e.information, e.jacobian, e.noise
    )
    assert dut.used
    assert not dut.jumped
    np.testing.assert_array_equal(dut.estimate, estimate)
    np.testing.assert_array_equal(dut.covariance, updated + process_noise)


def test_increment_is_new_reading_minus_old_and_rate_their_mean() -> None:
    dut = cycled()
    np.testing.assert_allclose(dut.sample.increment, [0.002, -0.480, 0.145], rtol=1e-14)
    np.testing.assert_allclose(dut.sample.rate, [0.011, -0.260, 0.0775], rtol=1e-14)


def test_update_reduces_uncertainty_and_leaves_a_covariance() -> None:
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    dut = cycled()
    assert is_covariance(dut.covariance)
    assert (np.diag(dut.covariance) < np.diag(covariance)).all()


def test_innovation_covariance_that_is_not_positive_definite_is_an_error() -> None:
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance is not positive definite"):
        cycled(covariance=np.zeros((9, 9)), reading_variance=0.0, extra_noise=np.diag([1e-4, -1e-4, 1e-4]))


def test_cycle_leaves_its_inputs_alone() -> None:
    inputs = {
        "estimate": STATE.copy(),
        "covariance": random_covariance(np.random.default_rng(1), 0.01),
        "rate_before": np.array([0.1, 0.2, 0.3]),
        "rate": np.array([0.2, -0.1, 0.4]),
        "extra_noise": 1e-4 * np.eye(3),
        "angular_impulse": ANGULAR.copy(),
        "linear_impulse": LINEAR.copy(),
    }
    before = {name: value.copy() for name, value in inputs.items()}
    jumping = SETTINGS._replace(
        coupling=RotationCoupling.SUBTRACT, jump_threshold=0.0, jump_covariance=np.eye(9), process_noise=np.eye(9)
    )
    for firing in (True, False):
        cycled(jumping, **inputs, firing=firing)
    for name, value in inputs.items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


# ---------------------------------------------------------------- samples that are not used


@pytest.mark.parametrize("missing", ["rate", "rate_before"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_missing_reading_keeps_the_state(missing: str, axis: int) -> None:
    reading = np.array([0.01, 0.02, 0.03])
    reading[axis] = np.nan
    process_noise = 1e-6 * np.eye(9)
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    dut = cycled(SETTINGS._replace(process_noise=process_noise), **{missing: reading}, subtract_coupling=True)
    assert not dut.used
    assert not dut.jumped
    assert np.isnan(dut.innovation.nis)
    assert np.isnan(dut.innovation.innovation).all()
    assert dut.innovation.subtract_coupling
    np.testing.assert_array_equal(dut.estimate, STATE)
    np.testing.assert_array_equal(dut.covariance, covariance + process_noise)


@pytest.mark.parametrize(("usable", "firing"), [(False, True), (True, False), (False, False)])
def test_sample_that_is_not_steady_or_not_firing_is_shown_but_not_used(usable: bool, firing: bool) -> None:
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    dut = cycled(usable=usable, firing=firing)
    assert not dut.used
    assert np.isfinite(dut.innovation.nis)
    np.testing.assert_array_equal(dut.estimate, STATE)
    np.testing.assert_array_equal(dut.covariance, covariance)


def test_coasting_leaves_the_covariance_unchanged_but_for_process_noise() -> None:
    process_noise = 1e-6 * np.eye(9)
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    dut = cycled(
        SETTINGS._replace(process_noise=process_noise), firing=False, angular_impulse=NONE, linear_impulse=NONE
    )
    np.testing.assert_array_equal(dut.covariance, covariance + process_noise)


def test_coasting_innovation_is_the_increment_with_the_sensors_noise() -> None:
    disturbance = np.diag([1e-4, 2e-4, 3e-4])
    dut = cycled(
        SETTINGS._replace(disturbance_covariance=disturbance), firing=False, angular_impulse=NONE, linear_impulse=NONE
    ).innovation
    np.testing.assert_allclose(dut.innovation, [0.002, -0.480, 0.145], rtol=1e-14)
    np.testing.assert_allclose(dut.covariance, np.diag([2e-4, 3e-4, 4e-4]), rtol=1e-14)
    np.testing.assert_array_equal(dut.noise, dut.covariance)
    np.testing.assert_array_equal(dut.jacobian, np.zeros((3, 9)))
    # 0.002^2 / 2e-4 + 0.48^2 / 3e-4 + 0.145^2 / 4e-4
    assert dut.nis == pytest.approx(0.02 + 768.0 + 52.5625, rel=1e-12)


def test_coasting_the_modeled_coupling_is_as_uncertain_as_the_estimates() -> None:
    covariance, noise = 1e-4 * random_covariance(np.random.default_rng(2), 1.0), 1e-3 * np.eye(3)
    rate = np.array([1.0, -2.0, 1.5])
    sample = RotationSample(np.zeros(3), rate, noise, 0.0, NONE, NONE, firing=False)
    params = SETTINGS._replace(coupling=RotationCoupling.MODEL)
    dut = innovate(RotationState(STATE, covariance), sample, False, params)
    slope = np.empty((3, 6))
    for element in range(6):
        step = np.zeros(9)
        step[element] = 1e-6
        sides = [coupling_increment((STATE + sign * step)[ELEMENT], rate, PERIOD) for sign in (1.0, -1.0)]
        slope[:, element] = (sides[0] - sides[1]) / 2e-6
    expected = slope @ covariance[:6, :6] @ slope.T + noise
    assert np.abs(expected - noise).max() > 0.1 * np.abs(noise).max()  # the case shows something
    np.testing.assert_allclose(dut.covariance, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("element", [0, 1, 2])
@pytest.mark.parametrize(("fraction", "modeled"), [(0.49, True), (0.51, False)])
def test_coupling_is_modeled_once_the_diagonal_is_known_to_half_its_size(
    element: int, fraction: float, *, modeled: bool
) -> None:
    deviation = 0.1 * np.abs(STATE)
    deviation[element] = fraction * STATE[element]
    sample = RotationSample(np.zeros(3), np.array([1.0, -2.0, 1.5]), np.eye(3), 0.0, NONE, NONE, firing=False)
    params = SETTINGS._replace(coupling=RotationCoupling.MODEL)
    dut = innovate(RotationState(STATE, np.diag(deviation**2)), sample, False, params)
    assert dut.innovation.any() == dut.jacobian.any() == modeled


# ---------------------------------------------------------------- dynamic coupling


def test_coupling_increment_of_hand_value() -> None:
    # I = diag(1, 2, 4), w = (1, 2, 3): w x Iw = (1, 2, 3) x (1, 4, 12) = (12, -9, 2); -I^-1 of it times 0.5 s
    increment = coupling_increment(np.diag([1.0, 0.5, 0.25]), np.array([1.0, 2.0, 3.0]), 0.5)
    np.testing.assert_allclose(increment, [-6.0, 2.25, -0.25], rtol=1e-15)


def coasting_increment(period: float) -> tuple[Array, Array]:
    """True increment of one torque-free sample, and what the mean rate makes of its coupling."""
    properties = MassProperties(1.0, np.zeros(3), np.linalg.inv(INVERSE))
    before = initial_state(1.0)
    before[RATE] = TUMBLING
    after = step(before, np.zeros(7), np.zeros((0, 7)), (), period, body_of(properties))
    predicted = coupling_increment(INVERSE, 0.5 * (before[RATE] + after[RATE]), period)
    return after[RATE] - before[RATE], predicted


def test_coupling_increment_is_what_a_torque_free_body_shows() -> None:
    # the mean of the two rates makes it right to second order: what is left falls with the third power of
    # the period, by 8 when that is halved
    left = []
    for period in (PERIOD, 0.5 * PERIOD):
        measured, predicted = coasting_increment(period)
        assert np.abs(measured).max() > 1e-3
        np.testing.assert_allclose(predicted, measured, rtol=0.0, atol=2e-4 * np.abs(measured).max())
        left.append(np.linalg.norm(measured - predicted))
    assert left[0] / left[1] == pytest.approx(8.0, rel=0.05)


@pytest.mark.parametrize("firing", [True, False])
def test_subtracted_coupling_leaves_the_innovation_of_the_impulse(firing: bool) -> None:
    # a measured increment of prediction plus coupling: nothing is left when it is subtracted, and the coupling
    # when it is not
    covariance = 1e-12 * np.eye(9)
    rate = TUMBLING
    coupling = coupling_increment(INVERSE, rate, PERIOD)
    increment = coupling + firing * rate_increment(STATE, ANGULAR, LINEAR)
    sample = sample_of(increment, rate=rate, firing=firing)
    subtracted = innovate(
        RotationState(STATE, covariance), sample, False, SETTINGS._replace(coupling=RotationCoupling.SUBTRACT)
    )
    ignored = innovate(RotationState(STATE, covariance), sample, True, SETTINGS)
    np.testing.assert_allclose(subtracted.innovation, NONE, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(ignored.innovation, coupling, rtol=0.0, atol=1e-15)
    assert subtracted.subtract_coupling
    assert not ignored.subtract_coupling
    np.testing.assert_array_equal(subtracted.covariance, ignored.covariance)


def hybrid(factor: float, firing: bool = True, before: bool = False) -> RotationInnovation:
    """A sample of the hybrid rule with the largest innovation variance at ``factor`` times the noise's, 4e-4."""
    # noise diag(3, 2, 4) e-4, half of its largest from the disturbance; a = (1/2, 2, 1/3) and S = s on the
    # diagonal of the inverse inertia alone: Y = noise + s diag(1/4, 4, 1/9), largest along y
    variance = (factor * 4e-4 - 2e-4) / 4.0
    covariance = np.diag([variance] * 3 + [0.0] * 6)
    sample = sample_of(
        NONE,
        rate=TUMBLING,
        noise=2e-4 * np.eye(3),
        angular_impulse=TORQUE_ALONE,
        linear_impulse=NONE,
        firing=firing,
    )
    params = SETTINGS._replace(
        coupling=RotationCoupling.HYBRID, coupling_limit=50.0, disturbance_covariance=np.diag([1e-4, 0.0, 2e-4])
    )
    return innovate(RotationState(STATE, covariance), sample, before, params)


@pytest.mark.parametrize(("factor", "subtract"), [(50.1, False), (49.9, True), (2.0, True), (1e6, False)])
@pytest.mark.parametrize("before", [True, False])
def test_hybrid_subtracts_once_the_innovations_variance_is_below_its_limit(
    factor: float, subtract: bool, before: bool
) -> None:
    dut = hybrid(factor, before=before)
    assert np.diag(dut.covariance).max() == pytest.approx(factor * 4e-4, rel=1e-12)
    assert dut.subtract_coupling is subtract
    prediction = rate_increment(STATE, TORQUE_ALONE, NONE)
    coupling = coupling_increment(INVERSE, TUMBLING, PERIOD)
    np.testing.assert_allclose(dut.innovation, -prediction - subtract * coupling, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("factor", [2.0, 1e6])
def test_coasting_keeps_the_hybrid_rules_last_decision(before: bool, factor: float) -> None:
    dut = hybrid(factor, firing=False, before=before)
    assert dut.subtract_coupling is before
    coupling = coupling_increment(INVERSE, TUMBLING, PERIOD)
    np.testing.assert_allclose(dut.innovation, -before * coupling, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    "elements",
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # as at the start
        [1.0, 1.0, -1.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 1.0, 0.0, 0.0, 2.0],
    ],
)
def test_nothing_is_subtracted_while_the_estimated_inverse_inertia_is_impossible(elements: list[float]) -> None:
    estimate = np.array([*elements, 0.5, -0.3, 0.2])
    sample = sample_of(np.array([0.1, 0.2, 0.3]), rate=TUMBLING)
    covariance = random_covariance(np.random.default_rng(13), 0.1)
    subtracting, ignoring = (
        innovate(RotationState(estimate, covariance), sample, False, SETTINGS._replace(coupling=coupling))
        for coupling in (RotationCoupling.SUBTRACT, RotationCoupling.IGNORE)
    )
    np.testing.assert_array_equal(subtracting.innovation, ignoring.innovation)
    assert subtracting.subtract_coupling  # the rule asks, the estimate does not allow


# ---------------------------------------------------------------- covariance incrementation


def test_covariance_is_incremented_on_a_large_nis_as_if_it_had_been_larger_before() -> None:
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    jump = random_covariance(np.random.default_rng(14), 0.1)
    process_noise = 1e-6 * np.eye(9)
    plain = SETTINGS._replace(process_noise=process_noise)
    nis = cycled(plain).innovation.nis
    dut = cycled(plain._replace(jump_threshold=0.999 * nis, jump_covariance=jump))
    enlarged = cycled(plain, covariance=covariance + jump)
    assert dut.used
    assert dut.jumped
    assert dut.innovation.nis == nis  # what is shown is the innovation that raised the alarm
    np.testing.assert_array_equal(dut.estimate, enlarged.estimate)
    np.testing.assert_array_equal(dut.covariance, enlarged.covariance)


def test_covariance_is_not_incremented_below_the_threshold() -> None:
    nis = cycled().innovation.nis
    dut = cycled(SETTINGS._replace(jump_threshold=1.001 * nis, jump_covariance=np.eye(9)))
    assert not dut.jumped
    np.testing.assert_array_equal(dut.covariance, cycled().covariance)
    np.testing.assert_array_equal(dut.estimate, cycled().estimate)


def test_covariance_is_not_incremented_by_a_sample_that_is_not_used() -> None:
    dut = cycled(SETTINGS._replace(jump_threshold=0.0, jump_covariance=np.eye(9)), usable=False)
    assert not dut.jumped
    np.testing.assert_array_equal(dut.covariance, random_covariance(np.random.default_rng(1), 0.01))


def test_incremented_covariance_keeps_the_decision_on_coupling_when_forced() -> None:
    covariance = random_covariance(np.random.default_rng(1), 0.01)
    jump = random_covariance(np.random.default_rng(14), 0.1)
    params = SETTINGS._replace(coupling=RotationCoupling.SUBTRACT, jump_threshold=0.0, jump_covariance=jump)
    sample = sample_of(np.array([0.1, 0.2, 0.3]), rate=TUMBLING)
    first = innovate(RotationState(STATE, covariance), sample, False, params)
    dut = update(RotationState(STATE, covariance), sample, first, NO_ADAPTATION, params)
    again = innovate(RotationState(STATE, covariance + jump), sample, False, params)
    expected = joseph_update(
        RotationState(STATE, covariance + jump), again.innovation, again.information, again.jacobian, again.noise
    )
    np.testing.assert_array_equal(dut.state.estimate, expected.estimate)


# ---------------------------------------------------------------- whole runs


def random_run(rng: np.random.Generator, samples: int, noise_std: float) -> list[dict[str, Array]]:
    """Samples of known impulses and of the increments they give the body above, with noise."""
    run = []
    for _ in range(samples):
        angular, linear = rng.standard_normal((2, 3))
        increment = full_model(STATE, angular, linear) + noise_std * rng.standard_normal(3)
        run.append(
            {
                "rate_before": NONE,
                "rate": increment,
                "reading_variance": 0.5 * noise_std**2,
                "angular_impulse": angular,
                "linear_impulse": linear,
            }
        )
    return run


def test_recursive_estimate_equals_batch_least_squares_where_the_model_is_linear() -> None:
    # center of mass exactly known: z = A_6(a + lambda x r) x_6 + v, solved at once in information form
    rng = np.random.default_rng(15)
    noise_std = 0.02
    run = random_run(rng, 60, noise_std)
    prior = random_covariance(rng)[:6, :6]
    estimate = np.concatenate([np.zeros(6), STATE[6:]])
    covariance = np.zeros((9, 9))
    covariance[:6, :6] = prior
    information, right_side = np.linalg.inv(prior), np.zeros(6)
    for sample in run:
        done = cycled(estimate=estimate, covariance=covariance, **sample)
        estimate, covariance = done.estimate, done.covariance
        matrix = angular_matrix(sample["angular_impulse"] + np.cross(sample["linear_impulse"], STATE[6:]))[:, :6]
        information += matrix.T @ matrix / noise_std**2
        right_side += matrix.T @ sample["rate"] / noise_std**2
    batch = np.linalg.solve(information, right_side)
    # the first update takes the covariance down by up to 1e5, and loses that many digits: 1e5 epsilon
    np.testing.assert_allclose(estimate[:6], batch, rtol=0.0, atol=2e-11 * np.abs(batch).max())
    np.testing.assert_allclose(covariance[:6, :6], np.linalg.inv(information), rtol=0.0, atol=2e-11 * noise_std**2)
    # what was exactly known stays so
    np.testing.assert_array_equal(estimate[6:], STATE[6:])
    np.testing.assert_array_equal(covariance[6:], np.zeros((3, 9)))
    np.testing.assert_array_equal(covariance[:, 6:], np.zeros((9, 3)))


def test_estimates_from_nothing_find_the_truth_within_their_covariance() -> None:
    # second-order filter from a zero inverse inertia and a center of mass one unit off; NEES of 9 elements,
    # chi-square quantiles 1e-4 and 1 - 1e-4: 0.78 and 33.7
    rng = np.random.default_rng(16)
    estimate, covariance = np.zeros(9), np.diag(np.array([1.0] * 6 + [1.0] * 3) ** 2)
    for sample in random_run(rng, 150, 1e-3):
        done = cycled(estimate=estimate, covariance=covariance, **sample)
        estimate, covariance = done.estimate, done.covariance
    error = estimate - STATE
    assert is_covariance(covariance)
    assert np.sqrt(np.diag(covariance)).max() < 1e-3
    assert 0.78 < error @ np.linalg.solve(covariance, error) < 33.7


def run_through(
    run: list[dict[str, Any]], estimate: Array, covariance: Array, params: RotationParams
) -> tuple[Array, Array, list[float]]:
    """Estimate and covariance at the end, NIS of all samples; some must jump, and some subtract coupling."""
    cycles = []
    for sample in run:
        cycles.append(cycled(params, estimate=estimate, covariance=covariance, **sample))
        estimate, covariance = cycles[-1].estimate, cycles[-1].covariance
    assert {done.jumped for done in cycles} == {True, False}
    assert {done.innovation.subtract_coupling for done in cycles} == {True, False}
    return estimate, covariance, [done.innovation.nis for done in cycles]


def transformed_run(run: list[dict[str, Any]], rates: Array, angular: Array, linear: Array) -> list[dict[str, Any]]:
    """The same samples with rates, angular and linear impulses seen through three matrices."""
    return [
        {
            "rate_before": rates @ sample["rate_before"],
            "rate": rates @ sample["rate"],
            "reading_variance": sample["reading_variance"],  # the same about any axis
            "angular_impulse": angular @ sample["angular_impulse"],
            "linear_impulse": linear @ sample["linear_impulse"],
        }
        for sample in run
    ]


def symmetry_settings(rng: np.random.Generator) -> RotationParams:
    """Everything that can matter at once: coupling, process noise, disturbance, and some increments."""
    disturbance = rng.standard_normal((3, 4)) * 1e-3
    return SETTINGS._replace(
        coupling=RotationCoupling.HYBRID,
        jump_threshold=4.0,
        jump_covariance=random_covariance(rng, 1e-2),
        process_noise=random_covariance(rng, 1e-4),
        disturbance_covariance=disturbance @ disturbance.T,
    )


def symmetry_run(rng: np.random.Generator) -> list[dict[str, Any]]:
    run = random_run(rng, 25, 1e-2)
    for sample in run:
        sample["rate_before"] = 0.3 * rng.standard_normal(3)
        sample["rate"] = sample["rate_before"] + sample["rate"]
    return run


def compare_through(transform: Array, rates: Array, angular: Array, linear: Array) -> None:
    """Filters a run in two descriptions; ``transform`` takes the state of the one to that of the other."""
    rng = np.random.default_rng(17)
    params, run = symmetry_settings(rng), symmetry_run(rng)
    estimate, covariance = 0.9 * STATE, random_covariance(rng, 0.3)
    ours = run_through(run, estimate, covariance, params)
    theirs = run_through(
        transformed_run(run, rates, angular, linear),
        transform @ estimate,
        transform @ covariance @ transform.T,
        params._replace(
            jump_covariance=transform @ params.jump_covariance @ transform.T,
            process_noise=transform @ params.process_noise @ transform.T,
            disturbance_covariance=rates @ params.disturbance_covariance @ rates.T,
        ),
    )
    # rounding: an update takes the covariance down by up to 1e5, so 1e5 epsilon in units of the 1-sigma
    scale = np.sqrt(np.diag(theirs[1]))
    np.testing.assert_allclose(transform @ ours[0] / scale, theirs[0] / scale, rtol=1e-12, atol=2e-11)
    expected = transform @ ours[1] @ transform.T
    np.testing.assert_allclose(
        expected / np.outer(scale, scale), theirs[1] / np.outer(scale, scale), rtol=0.0, atol=2e-11
    )
    np.testing.assert_allclose(ours[2], theirs[2], rtol=1e-10)


def test_estimates_follow_a_change_of_units() -> None:
    # ft, slug, lbf to m, kg, N; the slug is 1 lbf s^2 / ft = 14.59390 kg, so the units stay consistent
    length, force = 0.3048, 4.4482216152605
    mass = force / length
    assert mass == pytest.approx(14.59390, rel=1e-6)
    transform = np.diag([1.0 / (mass * length**2)] * 6 + [length] * 3)
    compare_through(transform, np.eye(3), force * length * np.eye(3), force * np.eye(3))


def turned_state(rotation: Array) -> Array:
    """What a rotation of the axes does to the state, shape (9, 9)."""
    transform = np.zeros((9, 9))
    for element in range(6):
        transform[:6, element] = six_elements(rotation @ symmetric(np.eye(6)[element]) @ rotation.T)
    transform[6:, 6:] = rotation
    return transform


def test_estimates_follow_a_cyclic_permutation_of_the_axes() -> None:
    # x, y, z become y, z, x; so 11, 22, 33, 23, 13, 12 become 22, 33, 11, 13, 12, 23
    permutation = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    transform = turned_state(permutation)
    np.testing.assert_array_equal(transform @ np.arange(1.0, 10.0), [2, 3, 1, 5, 6, 4, 8, 9, 7])
    compare_through(transform, permutation, permutation, permutation)


def test_estimates_follow_a_rotation_of_the_axes() -> None:
    rotation = np.linalg.qr(np.random.default_rng(18).standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    compare_through(turned_state(rotation), rotation, rotation, rotation)


def test_estimates_follow_a_shift_of_the_vehicle_frame() -> None:
    # origin moved by -s: the center of mass by s, angular impulses by s x lambda; errors as they were
    rng = np.random.default_rng(19)
    shift = np.array([2.0, -1.0, 0.5])
    params, run = symmetry_settings(rng), symmetry_run(rng)
    estimate, covariance = 0.9 * STATE, random_covariance(rng, 0.3)
    ours = run_through(run, estimate, covariance, params)
    moved = [
        sample | {"angular_impulse": sample["angular_impulse"] + skew(shift) @ sample["linear_impulse"]}
        for sample in run
    ]
    offset = np.concatenate([np.zeros(6), shift])
    theirs = run_through(moved, estimate + offset, covariance, params)
    # rounding as above
    np.testing.assert_allclose(theirs[0], ours[0] + offset, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(theirs[1], ours[1], rtol=0.0, atol=2e-11 * np.abs(ours[1]).max())
    np.testing.assert_allclose(theirs[2], ours[2], rtol=1e-10)


def test_elements_of_the_state_stand_where_the_filter_looks_for_them() -> None:
    np.testing.assert_array_equal(STATE[ELEMENT], INVERSE)


def test_the_jacobian_of_dynamic_coupling_is_its_derivative() -> None:
    rate = np.array([0.3, -0.2, 0.5])
    numerical = np.zeros((3, 9))
    for element in range(6):
        step = np.zeros(9)
        step[element] = 1e-6 * np.abs(STATE[:6]).max()
        ahead, behind = ((STATE + sign * step)[ELEMENT] for sign in (1.0, -1.0))
        difference = coupling_increment(ahead, rate, 0.08) - coupling_increment(behind, rate, 0.08)
        numerical[:, element] = difference / (2.0 * step[element])
    jacobian = coupling_jacobian(STATE[ELEMENT], rate, 0.08)
    np.testing.assert_allclose(jacobian, numerical, rtol=1e-6, atol=1e-8 * np.abs(numerical).max())


def test_a_sample_that_turns_by_more_than_the_limit_is_not_used() -> None:
    params = SETTINGS._replace(largest_turn=0.1, gyro_variances=np.array([1e-12]))
    state = RotationState(STATE, np.diag(np.square(0.1 * np.abs(STATE) + 1e-12)))
    for rate, measured in ((0.09 / PERIOD, True), (0.11 / PERIOD, False)):
        rates = np.array([[rate, 0.0, 0.0]])
        dut = measure(
            state, RotationMemory(rates, False), rates, RotationInterval(np.zeros(3), np.zeros(3), False), params
        )
        assert np.isfinite(dut.innovation.nis) == measured
