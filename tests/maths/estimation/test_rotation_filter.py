"""The second-order filter against its full form, and its rules."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import INVERSE, STATE, rotation_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.rate_increments import (
    coupling_increment,
    coupling_jacobian,
    rate_increment,
    rate_increment_jacobian,
    second_order_terms,
)
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCoupling,
    RotationCycle,
    RotationInnovation,
    RotationInterval,
    RotationMemory,
    RotationParams,
    RotationSample,
    RotationState,
    finish,
    innovate,
    measure,
)
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import ELEMENT

PERIOD = 0.08  # s
NONE = np.zeros(3)
SETTINGS = rotation_params(period_s=PERIOD)
ANGULAR, LINEAR = np.array([0.7, -1.1, 0.4]), np.array([0.9, 0.6, -1.3])
TUMBLING = np.array([0.3, -0.4, 0.5])  # rad/s
NOISE = np.array([[4e-4, 1e-4, 0.0], [1e-4, 3e-4, 0.0], [0.0, 0.0, 2e-4]])


def angular_matrix(angular: Array) -> Array:
    """A of (2-53), written out."""
    a1, a2, a3 = angular
    rows = [[a1, 0, 0, 0, a3, a2, 0, 0, 0], [0, a2, 0, a3, 0, a1, 0, 0, 0], [0, 0, a3, a2, a1, 0, 0, 0, 0]]
    return np.array(rows)


def linear_matrices(linear: Array) -> Array:
    """The three matrices Lambda of (2-54), written out, shape (3, 9, 9)."""
    l1, l2, l3 = linear
    b1, b2, b3, none = [0, -l3, l2], [l3, 0, -l1], [-l2, l1, 0], [0, 0, 0]
    blocks = np.array([[b1, none, none, none, b3, b2], [none, b2, none, b3, none, b1], [none, none, b3, b2, b1, none]])
    matrices = np.zeros((3, 9, 9))
    matrices[:, :6, 6:], matrices[:, 6:, :6] = blocks, blocks.transpose(0, 2, 1)
    return matrices


def full_model(states: Array, angular: Array, linear: Array) -> Array:
    """h of (2-55), A x + 1/2 x^T Lambda x, for one state or many."""
    curvature = np.einsum("...i,kij,...j->...k", states, linear_matrices(linear), states)
    return states @ angular_matrix(angular).T + 0.5 * curvature


def random_covariance(seed: int | np.random.Generator, size: float = 1.0, known_center: bool = False) -> Array:
    """Correlated; standard deviations within a decade, about ``size``."""
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((9, 12)) / np.sqrt(12.0)
    scale = size * 10.0 ** rng.uniform(-0.5, 0.5, 9) * (~np.array([False] * 6 + [known_center] * 3))
    return np.outer(scale, scale) * (factor @ factor.T)


COVARIANCE = random_covariance(1, 0.01)


def innovated(covariance: Array, increment: Array = NONE, before: bool = False, **params: Any) -> RotationInnovation:
    """The innovation of one sample, the impulses' by default; ``of`` changes the sample."""
    plain = RotationSample(increment, NONE, NOISE, 0.0, ANGULAR, LINEAR, firing=True)
    sample = plain._replace(**params.pop("of", {}))
    estimate = params.pop("estimate", STATE)
    return innovate(RotationState(estimate, covariance), sample, before, SETTINGS._replace(**params))


class Given(NamedTuple):
    """A sample of one gyro, and what is known before it."""

    params: RotationParams = SETTINGS
    estimate: Array = STATE
    covariance: Array = COVARIANCE
    before: Array = np.array([0.010, -0.020, 0.005])
    rate: Array = np.array([0.012, -0.500, 0.150])
    subtract_coupling: bool = False
    reading_variance: float = 0.5e-4
    angular: Array = ANGULAR
    linear: Array = LINEAR
    extra_noise: Array | None = None

    def having(self, **params: Any) -> Given:
        return self._replace(params=self.params._replace(**params))

    def cycled(self, usable: bool = True, firing: bool = True) -> tuple[RotationCycle, RotationInnovation]:
        params = self.params._replace(gyro_variances=np.array([self.reading_variance]))
        state, memory = (
            RotationState(self.estimate, self.covariance),
            RotationMemory(self.before[None], self.subtract_coupling),
        )
        interval = RotationInterval(self.angular, self.linear, firing, self.extra_noise)
        measurement = measure(state, memory, self.rate[None], interval, params)
        return finish(state, measurement, usable, NO_ADAPTATION, params), measurement.innovation


GIVEN = Given()


def test_jacobian_equals_the_full_form_and_central_differences() -> None:
    # A + x^T Lambda (2-102). h is bilinear, so central differences err by rounding alone: 1e-16 / 1e-3
    rng = np.random.default_rng(3)
    for _ in range(20):
        state, angular, linear = rng.standard_normal(9), *rng.standard_normal((2, 3))
        increment = rate_increment(state, angular, linear)
        assert_allclose(increment, full_model(state, angular, linear), rtol=0.0, atol=5e-14)
        jacobian = rate_increment_jacobian(state, angular, linear)
        written_out = angular_matrix(angular) + np.einsum("i,kij->kj", state, linear_matrices(linear))
        assert_allclose(jacobian, written_out, rtol=0.0, atol=1e-14)
        for column, change in enumerate(1e-3 * np.eye(9)):
            ahead, behind = (rate_increment(state + sign * change, angular, linear) for sign in (1.0, -1.0))
            assert_allclose(jacobian[:, column], (ahead - behind) / 2e-3, rtol=0.0, atol=1e-11)


def test_second_order_terms_equal_the_traces_of_the_full_form() -> None:
    # (2-118) and (2-121): 1/2 tr(Lambda_i S), 1/2 tr(Lambda_i S Lambda_j S)
    rng = np.random.default_rng(4)
    for _ in range(20):
        covariance, linear = random_covariance(rng), rng.standard_normal(3)
        bias, curvature = second_order_terms(covariance, linear)
        products = linear_matrices(linear) @ covariance
        # sums of up to 81 products; epsilon times the largest of them
        size = np.abs(products).max()
        assert_allclose(bias, 0.5 * np.einsum("kii->k", products), rtol=0.0, atol=1e-14 * size)
        expected = 0.5 * np.einsum("kij,lji->kl", products, products)
        assert_allclose(curvature, expected, rtol=0.0, atol=1e-14 * size**2)
    for term in second_order_terms(random_covariance(5, known_center=True), LINEAR):
        assert not term.any()


@pytest.mark.parametrize(
    ("params", "with_bias", "with_curvature"),
    [({}, 1, 1), ({"second_order": False}, 0, 0), ({"bias": False}, 0, 1), ({"curvature": False}, 1, 0)],
)
def test_innovation_is_put_together_from_its_terms(params: dict[str, Any], with_bias: int, with_curvature: int) -> None:
    covariance, increment = random_covariance(8, 0.1), np.array([0.3, -0.2, 0.1])
    disturbance = np.diag([1e-4, 2e-4, 3e-4])
    dut = innovated(covariance, increment, disturbance_covariance=disturbance, **params)
    bias, curvature = second_order_terms(covariance, LINEAR)
    jacobian = rate_increment_jacobian(STATE, ANGULAR, LINEAR)
    noise = with_curvature * curvature + NOISE + disturbance
    total = jacobian @ covariance @ jacobian.T + noise
    expected = increment - rate_increment(STATE, ANGULAR, LINEAR) - with_bias * bias
    # the same sums in another order
    assert_allclose(dut.innovation, expected, rtol=1e-12)
    assert_allclose(dut.noise, noise, rtol=1e-13)
    assert_allclose(dut.covariance, total, rtol=1e-12)
    assert_allclose(dut.information @ total, np.eye(3), rtol=0.0, atol=1e-12)
    assert_array_equal(dut.jacobian, jacobian)
    assert dut.nis == pytest.approx(expected @ np.linalg.solve(total, expected), rel=1e-11)
    assert np.abs([*bias, *np.diag(curvature)]).min() > 1e-5  # they do matter here


def test_innovation_covariance_that_is_not_positive_definite_is_an_error() -> None:
    given = GIVEN._replace(covariance=np.zeros((9, 9)), reading_variance=0.0, extra_noise=np.diag([1e-4, -1e-4, 1e-4]))
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance is not positive definite"):
        given.cycled()


@pytest.mark.parametrize("missing", ["rate", "before", "steadiness", "firing"])
def test_a_sample_that_is_missing_or_cannot_be_used_keeps_the_state(missing: str) -> None:
    for axis in range(3):
        reading = {missing: np.where(np.arange(3) == axis, np.nan, 0.01)} if missing in Given._fields else {}
        given = GIVEN._replace(**reading, subtract_coupling=True).having(process_noise=1e-6 * np.eye(9))
        given = given.having(jump_threshold=0.0, coupling=RotationCoupling.HYBRID)
        dut, innovation = given.cycled(missing != "steadiness", missing != "firing")
        assert (dut.used, dut.jumped, innovation.subtract_coupling) == (False, False, True)
        assert np.isnan([innovation.nis, *innovation.innovation]).all() == bool(reading)
        assert_array_equal(dut.state.estimate, STATE)
        assert_array_equal(dut.state.covariance, COVARIANCE + 1e-6 * np.eye(9))


def test_coupling_increment_of_hand_value_and_its_derivative() -> None:
    # I = diag(1, 2, 4), w = (1, 2, 3): w x Iw = (1, 2, 3) x (1, 4, 12) = (12, -9, 2); -I^-1 of it times 0.5 s
    increment = coupling_increment(np.diag([1.0, 0.5, 0.25]), np.array([1.0, 2.0, 3.0]), 0.5)
    assert_allclose(increment, [-6.0, 2.25, -0.25], rtol=1e-15)
    jacobian = coupling_jacobian(INVERSE, TUMBLING, PERIOD)
    for element, change in enumerate(1e-6 * np.eye(9)):
        ahead, behind = (coupling_increment((STATE + s * change)[ELEMENT], TUMBLING, PERIOD) for s in (1.0, -1.0))
        assert_allclose(jacobian[:, element], (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("firing", [True, False])
def test_coupling_is_subtracted_where_the_rule_asks_and_the_inertia_is_possible(firing: bool) -> None:
    possible, *impossible = STATE[:6], np.zeros(6), [1, 1, -1, 0, 0, 0], [1, 1, 1, 0, 0, 2]  # as at the start, ...
    for elements in (possible, *impossible):
        estimate = np.append(elements, STATE[6:])
        coupling = coupling_increment(INVERSE, TUMBLING, PERIOD) if elements is possible else NONE
        for rule in (RotationCoupling.SUBTRACT, RotationCoupling.IGNORE):
            asks, of = rule == RotationCoupling.SUBTRACT, {"rate": TUMBLING, "firing": firing}
            dut = innovated(1e-12 * np.eye(9), NONE, not asks, of=of, estimate=estimate, coupling=rule)
            assert dut.subtract_coupling == asks  # whatever the estimate allows
            expected = -firing * rate_increment(estimate, ANGULAR, LINEAR) - asks * coupling
            assert_allclose(dut.innovation, expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(("factor", "subtract"), [(50.1, False), (49.9, True), (2.0, True), (1e6, False)])
@pytest.mark.parametrize("before", [True, False])
def test_hybrid_subtracts_once_the_innovations_variance_is_below_its_limit(
    factor: float, subtract: bool, before: bool
) -> None:
    # noise diag(3, 2, 4) e-4, half of its largest from the disturbance; a = (1/2, 2, 1/3) and S = s on the
    # diagonal of the inverse inertia alone: Y = noise + s diag(1/4, 4, 1/9), largest along y
    torque = np.array([0.5, 2.0, 1.0 / 3.0])
    covariance = np.diag([(factor * 4e-4 - 2e-4) / 4.0] * 3 + [0.0] * 6)
    of = {"rate": TUMBLING, "noise": 2e-4 * np.eye(3), "angular_impulse": torque, "linear_impulse": NONE}
    hybrid = {"coupling": RotationCoupling.HYBRID, "coupling_limit": 50.0}
    hybrid["disturbance_covariance"] = np.diag([1e-4, 0.0, 2e-4])
    dut = innovated(covariance, NONE, before, of=of, **hybrid)
    assert np.diag(dut.covariance).max() == pytest.approx(factor * 4e-4, rel=1e-12)
    coasting = innovated(covariance, NONE, before, of=of | {"firing": False}, **hybrid)  # keeps the last decision
    assert (dut.subtract_coupling, coasting.subtract_coupling) == (subtract, before)
    coupling, prediction = coupling_increment(INVERSE, TUMBLING, PERIOD), rate_increment(STATE, torque, NONE)
    assert_allclose(dut.innovation, -prediction - subtract * coupling, rtol=0.0, atol=1e-15)
    assert_allclose(coasting.innovation, -before * coupling, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("firing", [True, False])
@pytest.mark.parametrize("element", [0, 1, 2])
@pytest.mark.parametrize(("fraction", "modeled"), [(0.49, True), (0.51, False)])
def test_coupling_is_modeled_once_the_diagonal_is_known_to_half_its_size(
    element: int, fraction: float, *, modeled: bool, firing: bool
) -> None:
    deviation = np.append(0.01 * np.abs(STATE[:6]), [0.0, 0.0, 0.0])
    deviation[element] = fraction * STATE[element]
    covariance, rate = np.diag(deviation**2), np.array([1.0, -2.0, 1.5])
    dut = innovated(covariance, of={"rate": rate, "firing": firing}, coupling=RotationCoupling.MODEL)
    slope = firing * rate_increment_jacobian(STATE, ANGULAR, LINEAR)
    prediction = firing * rate_increment(STATE, ANGULAR, LINEAR)
    if modeled:  # as uncertain as the estimates
        slope = slope + coupling_jacobian(INVERSE, rate, PERIOD)
        prediction = prediction + coupling_increment(INVERSE, rate, PERIOD)
    assert_allclose(dut.innovation, -prediction, rtol=1e-12)
    assert_allclose(dut.jacobian, slope, rtol=1e-12, atol=1e-15)
    assert_allclose(dut.covariance, slope @ covariance @ slope.T + NOISE, rtol=1e-10)


@pytest.mark.parametrize("coupling", [RotationCoupling.IGNORE, RotationCoupling.SUBTRACT])
def test_covariance_is_incremented_on_a_large_nis_as_if_it_had_been_larger_before(coupling: int) -> None:
    jump, plain = random_covariance(14, 0.1), GIVEN.having(process_noise=1e-6 * np.eye(9), coupling=coupling)
    quiet, innovation = plain.cycled()
    below, shown = plain.having(jump_threshold=0.999 * innovation.nis, jump_covariance=jump).cycled()
    above, _ = plain.having(jump_threshold=1.001 * innovation.nis, jump_covariance=jump).cycled()
    enlarged, _ = plain._replace(covariance=COVARIANCE + jump).cycled()
    assert (below.used, below.jumped, above.jumped) == (True, True, False)
    assert shown.nis == innovation.nis  # what is shown is the innovation that raised the alarm
    for dut, expected in ((below, enlarged), (above, quiet)):
        assert_array_equal(dut.state.estimate, expected.state.estimate)
        assert_array_equal(dut.state.covariance, expected.state.covariance)


def test_a_sample_that_turns_by_more_than_the_limit_is_not_used() -> None:
    for rate, measured in ((0.09 / PERIOD, True), (0.11 / PERIOD, False)):
        given = GIVEN._replace(before=rate * np.eye(3)[0], rate=rate * np.eye(3)[0]).having(largest_turn=0.1)
        assert np.isfinite(given.cycled(firing=False)[1].nis) == measured
