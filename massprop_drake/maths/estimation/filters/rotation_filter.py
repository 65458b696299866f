r"""The second-order filter for inverse inertia and center of mass from rate increments.

Measurement of one sample, bilinear in the state x (order in `mass_properties`):

    z = w_k - w_{k-1} = h(x) + noise                                          (2-47), (2-55)

With h, H, b, D and dynamic coupling as in `rate_increments`, and S the covariance of x,

    h^  = h(x^) + b,    Y = H S H^T + D + R                                   (2-117), (2-120)

The update is Joseph's form (2-126). The extended Kalman filter is the same without b and D (2.6).

Thrust errors may be considered, see `considered`, with G = [g_1 ... g_n], g_j = I^-1 (a_j + lambda_j x r_cm), and a_j
and lambda_j the impulses of one sigma alone. With H_j as H for them, the products of both errors, sum_j beta_j H_j dx,
stand in for what G says too little of while the estimates are poor. They add to h^ and to the noise

    sum_j H_j Psi_j,    Pi = sum_j H_j S H_j^T + sum_jk (H_j Psi_k) (H_k Psi_j)^T.

The thesis subtracts dynamic coupling as if it were known. MODEL takes it into h and H as soon as the diagonal of the
inverse inertia is known to half its size.

Source: D. R. Levy, MIT S.M. thesis, 1983, section 2.4; considered thrust errors and MODEL are our own.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import Action, Adaptation
from massprop_drake.maths.estimation.filters.considered import add_effect_covariance, add_noise, update_sensitivity
from massprop_drake.maths.estimation.filters.rate_increments import (
    coupling_increment,
    coupling_jacobian,
    rate_increment,
    rate_increment_jacobian,
    rate_increment_jacobians,
    second_order_terms,
    thrust_error_effects,
)
from massprop_drake.maths.estimation.redundancy import Rule, combine_packages
from massprop_drake.maths.kernels import kernel, numbers, rows3, take_elements
from massprop_drake.maths.linear_algebra import (
    Array,
    congruence,
    inverse_positive_definite,
    is_positive_definite,
    quadratic_form,
)
from massprop_drake.maths.mass_properties import ELEMENT, N_ROTATION


class RotationCoupling(IntEnum):
    """Treatment of dynamic coupling."""

    SUBTRACT = 0
    IGNORE = 1
    HYBRID = 2  # subtract once the estimates are good enough
    MODEL = 3  # in prediction and Jacobian


_IDENTITY, _UNIT = np.eye(N_ROTATION), np.eye(3)
_WHAT = "the rotation filter's innovation covariance"


class RotationParams(NamedTuple):
    """Parameters of the rotation filter.

    Attributes:
        period_s: sample period, s.
        gyro_variances: of the error of one reading of each gyro package, the preferred one first, per
            component, rad^2/s^2, shape (s,).
        rule: how several gyros make one measurement, see `estimation.redundancy`.
        second_order: the second-order filter, or (False) the extended Kalman filter.
        coupling: SUBTRACT, IGNORE, HYBRID or MODEL.
        coupling_limit: HYBRID subtracts once the largest variance of the innovation is below this
            many times the largest variance of the measurement noise.
        jump_threshold: on a NIS above this the covariance is incremented (2-138); infinity: never.
        jump_covariance: what is then added, in state order, shape (9, 9).
        process_noise: covariance added per sample (2-123), shape (9, 9).
        disturbance_covariance: R^d of a rate increment, rad^2/s^2, shape (3, 3).
        largest_turn: rad that the vehicle may turn in a sample for the sample to count: the mean of two
            rates stands for the rate between them.
        bias, curvature: whether the second-order filter has b (2-118) and D (2-121); without both it is the
            extended Kalman filter.
    """

    period_s: float
    gyro_variances: Array
    rule: Rule
    second_order: bool
    coupling: RotationCoupling
    coupling_limit: float
    jump_threshold: float
    jump_covariance: Array
    process_noise: Array
    disturbance_covariance: Array
    largest_turn: float = math.inf
    bias: bool = True
    curvature: bool = True


class RotationSample(NamedTuple):
    """Sample as the rotation filter takes it.

    Attributes:
        increment: measured rate increment z, rad/s, body axes, shape (3,).
        rate: mean of the two readings that bound the sample, rad/s, body axes, shape (3,).
        noise: covariance R^z of the increment, rad^2/s^2, shape (3, 3).
        gyro_variance: of the gyros' part in it, per component, rad^2/s^2.
        angular_impulse, linear_impulse: a and lambda over the sample, shape (3,) each.
        firing: whether an impulse acted.
        thrust_errors: impulses of one sigma of each jet's thrust error, shape (n_jets, 6); None: thrust
            is taken as known.
    """

    increment: Array
    rate: Array
    noise: Array
    gyro_variance: float
    angular_impulse: Array
    linear_impulse: Array
    firing: bool
    thrust_errors: Array | None = None


class RotationInnovation(NamedTuple):
    """Measured minus predicted rate increment of one sample, before any update.

    Attributes:
        innovation: e, rad/s, body axes, NaN where not measured, shape (3,).
        covariance: Y, rad^2/s^2, NaN likewise, shape (3, 3).
        information: the inverse of Y.
        jacobian: H, shape (3, 9).
        noise: D + R, with considered thrust errors also Pi, rad^2/s^2, shape (3, 3).
        effects: L = H Psi + G, what one sigma of each jet's thrust error does to the innovation, rad/s, shape
            (3, n_jets); None where no thrust error is considered.
        subtract_coupling: whether the hybrid rule asks for the subtraction of dynamic coupling.
        nis: e^T Y^-1 e; chi-square with 3 degrees of freedom for a consistent filter.
    """

    innovation: Array
    covariance: Array
    information: Array
    jacobian: Array
    noise: Array
    effects: Array | None
    subtract_coupling: bool
    nis: float


class RotationState(NamedTuple):
    """State of the rotation filter.

    Attributes:
        estimate: x, shape (9,).
        covariance: S, shape (9, 9).
        sensitivity: Psi, the part of the error that comes of each jet's thrust error, per sigma of it, shape
            (9, n_jets); None where thrust is taken as known.
    """

    estimate: Array
    covariance: Array
    sensitivity: Array | None = None


@kernel
def independent_covariance(covariance: Array, sensitivity: Array | None) -> Array:
    """Computes S_0, the part of the covariance independent of thrust errors, S - Psi Psi^T, shape (9, 9)."""
    if sensitivity is None:
        return covariance
    return covariance - sensitivity @ sensitivity.T


class RotationCycle(NamedTuple):
    """State of the rotation filter after a sample, measured or not, used or not.

    Attributes:
        jumped: whether the covariance was incremented first (2-138).
    """

    state: RotationState
    used: bool
    jumped: bool


@kernel
def innovate(
    state: RotationState, sample: RotationSample, subtract_coupling_before: bool, params: RotationParams
) -> RotationInnovation:
    r"""Computes a rate increment's innovation, (2-117) to (2-121), and NIS, dynamic coupling subtracted if due.

    The hybrid rule looks at the innovation's covariance, which says something about the estimates only
    while jets fire; a coasting sample keeps the last decision, `subtract_coupling_before`. Whatever the rule
    says, nothing is subtracted while the estimated inverse inertia is not positive definite.

    Raises:
        NotPositiveDefiniteError: when Y is not positive definite.
    """
    estimate, covariance = state.estimate, state.covariance
    noise = sample.noise + params.disturbance_covariance
    total_noise, innovation = noise, sample.increment
    subtract_coupling = subtract_coupling_before
    modeled = params.coupling == RotationCoupling.MODEL and _knows_inertia(estimate, covariance)
    effects = None
    if sample.firing:
        jacobian = rate_increment_jacobian(estimate, sample.angular_impulse, sample.linear_impulse)
        if modeled:
            jacobian += coupling_jacobian(take_elements(estimate, ELEMENT), sample.rate, params.period_s)
        innovation = sample.increment - rate_increment(estimate, sample.angular_impulse, sample.linear_impulse)
        if params.second_order:
            bias, curvature = second_order_terms(covariance, sample.linear_impulse)
            if params.bias:
                innovation -= bias
            if params.curvature:
                total_noise = noise + curvature
        innovation, total_noise, effects = _add_thrust_errors(
            (innovation, total_noise), jacobian, state, state.sensitivity, sample.thrust_errors
        )
        apart = congruence(jacobian, independent_covariance(covariance, state.sensitivity)) + total_noise
        innovation_covariance = add_effect_covariance(apart, effects)
        # a thrust that is off by a little is not what the subtraction waits for
        limit = params.coupling_limit * _largest_variance(noise)
        subtract_coupling = _largest_variance(apart) < limit
    else:
        jacobian, innovation_covariance = np.zeros((3, N_ROTATION)), noise
        if modeled:
            jacobian = coupling_jacobian(take_elements(estimate, ELEMENT), sample.rate, params.period_s)
            innovation_covariance = congruence(jacobian, covariance) + noise
    if params.coupling != RotationCoupling.HYBRID:
        subtract_coupling = params.coupling == RotationCoupling.SUBTRACT or modeled
    if subtract_coupling:
        inverse_inertia = take_elements(estimate, ELEMENT)
        if is_positive_definite(inverse_inertia):
            innovation = innovation - coupling_increment(inverse_inertia, sample.rate, params.period_s)
    information = inverse_positive_definite(innovation_covariance, _WHAT)
    nis = quadratic_form(innovation, information)
    return RotationInnovation(
        innovation, innovation_covariance, information, jacobian, total_noise, effects, subtract_coupling, nis
    )


@kernel
def _add_thrust_errors(
    innovation_and_noise: tuple[Array, Array],
    jacobian: Array,
    state: RotationState,
    sensitivity: Array | None,
    thrust_errors: Array | None,
) -> tuple[Array, Array, Array | None]:
    """Adds products of thrust and state errors to innovation and noise; returns both and L, None if not considered."""
    if thrust_errors is None or sensitivity is None:
        return innovation_and_noise[0], innovation_and_noise[1], None
    effects = jacobian @ sensitivity + thrust_error_effects(state.estimate, thrust_errors)
    acting = thrust_errors.any(axis=1)
    jacobians = rate_increment_jacobians(state.estimate, thrust_errors[acting])
    through = jacobians @ sensitivity[:, acting]  # H_j Psi_k, shape (j, 3, k)
    spread: Array = (jacobians @ state.covariance @ jacobians.transpose(0, 2, 1)).sum(axis=0)
    spread = spread + np.einsum("jak,kbj->ab", through, through)
    return innovation_and_noise[0] - np.einsum("jij->i", through), innovation_and_noise[1] + spread, effects


@kernel
def _largest_variance(covariance: Array) -> float:
    """Returns the largest variance on a covariance's diagonal."""
    (a, _, _), (_, b, _), (_, _, c) = rows3(covariance)
    return max(a, b, c)


@kernel
def _knows_inertia(estimate: Array, covariance: Array) -> bool:
    """Tests whether the inverse inertia is positive definite and its diagonal known to half its size."""
    deviation = np.sqrt(np.diag(covariance)[:3])
    known = bool((deviation < 0.5 * estimate[:3]).all())
    return known and is_positive_definite(take_elements(estimate, ELEMENT))


@kernel
def _joseph_update(
    state: RotationState, innovation: Array, information: Array, jacobian: Array, noise: Array, effects: Array | None
) -> RotationState:
    """Updates estimate (2-115) and covariance in Joseph's form (2-126), symmetrized; Schmidt-Kalman with effects."""
    independent = independent_covariance(state.covariance, state.sensitivity)
    gain = _cross_covariance(independent @ jacobian.T, state.sensitivity, effects) @ information
    kept = _IDENTITY - gain @ jacobian
    covariance = congruence(kept, independent) + congruence(gain, noise)
    sensitivity = update_sensitivity(state.sensitivity, gain, effects)
    covariance = _total_covariance(covariance, sensitivity, effects)
    return RotationState(state.estimate + gain @ innovation, 0.5 * (covariance + covariance.T), sensitivity)


@kernel
def _cross_covariance(independent_part: Array, sensitivity: Array | None, effects: Array | None) -> Array:
    """Computes the covariance of state and innovation, S_0 H^T + Psi L^T, from its independent part, shape (9, 3)."""
    if effects is None or sensitivity is None:
        return independent_part
    return independent_part + sensitivity @ effects.T


@kernel
def _total_covariance(independent_part: Array, sensitivity: Array | None, effects: Array | None) -> Array:
    """Computes the whole covariance of the state, S_0 + Psi Psi^T, from S_0, independent of thrust errors, (9, 9)."""
    if effects is None or sensitivity is None:
        return independent_part
    return independent_part + sensitivity @ sensitivity.T


@kernel
def update(
    state: RotationState,
    sample: RotationSample,
    innovation: RotationInnovation,
    adaptation: Adaptation,
    params: RotationParams,
) -> RotationCycle:
    """Updates estimate and covariance by one usable firing sample, then in time (2-123).

    When the innovation's NIS exceeds the jump threshold, the covariance is first incremented and the
    innovation formed again from the same measurement (2-138), unless a jet's failure explains it.

    Raises:
        NotPositiveDefiniteError: when an innovation covariance is not positive definite.
    """
    if adaptation.action == Action.REJECT:
        return RotationCycle(_propagate(state, params), False, False)
    before, innovation, jumped = _inflate_after_jump(state, sample, innovation, adaptation, params)
    return RotationCycle(_propagate(_apply_measurement(before, sample, innovation, adaptation), params), True, jumped)


@kernel
def _inflate_after_jump(
    state: RotationState,
    sample: RotationSample,
    innovation: RotationInnovation,
    adaptation: Adaptation,
    params: RotationParams,
) -> tuple[RotationState, RotationInnovation, bool]:
    """Inflates the covariance if NIS exceeds the jump threshold (2-138) and no jet failed; also returns innovation."""
    if not (adaptation.action == Action.NONE and innovation.nis > params.jump_threshold):
        return state, innovation, False
    wider = RotationState(state.estimate, state.covariance + params.jump_covariance, state.sensitivity)
    return wider, innovate(wider, sample, innovation.subtract_coupling, params), True


@kernel
def _apply_measurement(
    state: RotationState, sample: RotationSample, innovation: RotationInnovation, adaptation: Adaptation
) -> RotationState:
    """Updates estimate and covariance by one rate increment, adapted to a jet's failure."""
    information, noise, error = innovation.information, innovation.noise, innovation.innovation
    enlarged = np.zeros((3, 3))  # gains have it besides
    if adaptation.action != Action.NONE:
        error = error - adaptation.rotation
        noise = noise + adaptation.rotation_spread
    if adaptation.action == Action.CORRECT_THESIS:
        enlarged = adaptation.rotation_spread
        information = inverse_positive_definite(innovation.covariance + enlarged, _WHAT)
    after = _joseph_update(state, error, information, innovation.jacobian, noise, innovation.effects)
    first = state, error, (noise, innovation.noise, enlarged)
    return _repeat_update(after, first, innovation.jacobian, state.sensitivity, sample.thrust_errors)


@kernel
def _repeat_update(
    first_update: RotationState,
    update_inputs: tuple[RotationState, Array, tuple[Array, Array, Array]],
    jacobian: Array,
    sensitivity: Array | None,
    thrust_errors: Array | None,
) -> RotationState:
    """Repeats the update with thrust-error effects G at the first update's estimate, where they are considered.

    Args:
        update_inputs: state, innovation, and noises: corrected, as measured, and what gains have besides.
        jacobian: H.
        sensitivity, thrust_errors: of that state, and of the sample.
    """
    if thrust_errors is None or sensitivity is None:
        return first_update
    state, error, (noise, measured, enlarged) = update_inputs
    effects = jacobian @ sensitivity + thrust_error_effects(first_update.estimate, thrust_errors)
    covariance = (
        congruence(jacobian, independent_covariance(state.covariance, sensitivity))
        + effects @ effects.T
        + measured
        + enlarged
    )
    information = inverse_positive_definite(covariance, _WHAT)
    return _joseph_update(state, error, information, jacobian, noise, effects)


@kernel
def _propagate(state: RotationState, params: RotationParams) -> RotationState:
    """Adds a random walk's covariance over a cycle to the state's covariance (2-123)."""
    return RotationState(state.estimate, state.covariance + params.process_noise, state.sensitivity)


class RotationMeasurement(NamedTuple):
    """Sample of the rotation filter and its innovation.

    Attributes:
        sample: what was measured, by all gyros together.
        innovation: before any update; NaN where not measured.
        each: the packages' own samples, where the update is made with one after the other.
    """

    sample: RotationSample
    innovation: RotationInnovation
    each: tuple[RotationSample, ...] = ()


class RotationMemory(NamedTuple):
    """Memory of the rotation filter of the sample before.

    Attributes:
        rates: readings of the gyros, in the order of the parameters' variances, rad/s, NaN where missing,
            shape (s, 3).
        subtract_coupling: the hybrid rule's last decision.
    """

    rates: Array
    subtract_coupling: bool


class RotationInterval(NamedTuple):
    """Known inputs of a sample interval before it is measured.

    Attributes:
        angular_impulse, linear_impulse: a and lambda, shape (3,) each.
        acting: whether a known impulse acted.
        extra_noise: of the increment, besides the gyros' and the disturbance, rad^2/s^2, shape (3, 3); None: none.
        thrust_errors: see `RotationSample`.
    """

    angular_impulse: Array
    linear_impulse: Array
    acting: bool
    extra_noise: Array | None = None
    thrust_errors: Array | None = None


def uses_one_package(params: RotationParams) -> bool:
    """Tests whether a measurement is of a single gyro, not a combination of several."""
    return params.rule == Rule.SINGLE or params.gyro_variances.size == 1


def measure(
    state: RotationState, memory: RotationMemory, rates: Array, interval: RotationInterval, params: RotationParams
) -> RotationMeasurement:
    """Makes the sample of a cycle, the rate increment of one or several gyros, and its innovation.

    The readings `rates` are as in `RotationMemory`, shape (s, 3).
    """
    increments, means = rates - memory.rates, 0.5 * (rates + memory.rates)
    indices = [index for index in range(len(rates)) if _is_usable_increment(increments[index], means[index], params)]
    if uses_one_package(params) or len(indices) < 2:
        return RotationMeasurement(*measure_first_usable(state, memory, rates, interval, params))
    own = [2.0 * params.gyro_variances[index] * _UNIT for index in indices]
    covariances = np.zeros((len(indices), len(indices), 3, 3))
    covariances[np.arange(len(indices)), np.arange(len(indices))] = own
    increment, noise = combine_packages(increments[indices], covariances, params.rule)
    mean, _ = combine_packages(means[indices], covariances, params.rule)
    sample = _make_sample(increment, mean, noise, interval)
    each: tuple[RotationSample, ...] = ()
    if params.rule == Rule.SERIAL:
        each = tuple(
            _make_sample(increments[index], means[index], noise, interval)
            for index, noise in zip(indices, own, strict=True)
        )
    return RotationMeasurement(sample, innovate(state, sample, memory.subtract_coupling, params), each)


@kernel
def measure_first_usable(
    state: RotationState, memory: RotationMemory, rates: Array, interval: RotationInterval, params: RotationParams
) -> tuple[RotationSample, RotationInnovation]:
    """Makes sample and innovation of the first gyro with a usable increment; NaN where there is none."""
    increments, means = rates - memory.rates, 0.5 * (rates + memory.rates)
    for index in range(rates.shape[0]):
        if _is_usable_increment(increments[index], means[index], params):
            noise = 2.0 * params.gyro_variances[index] * _UNIT
            sample = _make_sample(increments[index], means[index], noise, interval)
            return sample, innovate(state, sample, memory.subtract_coupling, params)
    nothing, unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    sample = _make_sample(nothing, nothing, unknown, interval)
    coasting = np.zeros((3, N_ROTATION))
    blank = RotationInnovation(nothing, unknown, unknown, coasting, unknown, None, memory.subtract_coupling, math.nan)
    return sample, blank


@kernel
def _is_usable_increment(increment: Array, mean_rate: Array, params: RotationParams) -> bool:
    """Tests whether a gyro has both readings, and the vehicle turns by less than the limit between them."""
    x, y, z = numbers(mean_rate, 3)
    a, b, c = numbers(increment, 3)
    # NaN compares as false
    return math.sqrt(x * x + y * y + z * z) * params.period_s <= params.largest_turn and math.isfinite(a + b + c)


@kernel
def _make_sample(increment: Array, mean_rate: Array, noise: Array, interval: RotationInterval) -> RotationSample:
    """Makes the rotation filter's sample of a measured rate increment and the interval's known impulse."""
    return RotationSample(
        increment,
        mean_rate,
        add_noise(noise, interval.extra_noise),
        float(noise[0, 0]),
        interval.angular_impulse,
        interval.linear_impulse,
        interval.acting,
        interval.thrust_errors,
    )


def finish(
    state: RotationState, measurement: RotationMeasurement, usable: bool, adaptation: Adaptation, params: RotationParams
) -> RotationCycle:
    """Updates the rotation filter by a measurement if usable and firing, adds process noise; returns state and flags.

    A sample is used when both readings are there, the jets' combination was steady, and an impulse acted; `usable` says
    the latter two. With the packages' own samples the update is made with one after the other.
    """
    sample, innovation, each = measurement
    if not (each and usable and sample.firing) or adaptation.action == Action.REJECT:
        return finish_one(state, (sample, innovation), usable, adaptation, params)
    state, innovation, jumped = _inflate_after_jump(state, sample, innovation, adaptation, params)
    for part in each:
        own = innovate(state, part, innovation.subtract_coupling, params)
        state = _apply_measurement(state, part, own, adaptation)
    return RotationCycle(_propagate(state, params), True, jumped)


@kernel
def finish_one(
    state: RotationState,
    measurement: tuple[RotationSample, RotationInnovation],
    usable: bool,
    adaptation: Adaptation,
    params: RotationParams,
) -> RotationCycle:
    """Updates the rotation filter by a single or combined gyro measurement if usable and firing; adds process noise."""
    sample, innovation = measurement
    if math.isnan(innovation.nis) or not (usable and sample.firing):
        return RotationCycle(_propagate(state, params), False, False)
    return update(state, sample, innovation, adaptation, params)
