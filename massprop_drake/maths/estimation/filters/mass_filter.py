r"""The Kalman filter for the mass reciprocal from velocity increments.

Measurement of one sample at an accelerometer, r = r'_acc - r_cm from the center of mass:

    zeta = V_k - V_{k-1} = lambda / m + dw x r + [w x (w x r)] dt + noise        (3-32), (3-37)

The transverse and, optionally, the centripetal part are subtracted with the measured rates and the
estimated center of mass, and the measurement's covariance grows by what is unknown of them:

    zeta' = zeta - dw x r^ - [w^ x (w^ x r^)] dt + 2 var(w^) dt r^               (3-57), (3-77)
    R'    = R + W + (O + O') S_cm (O + O')^T                                     (3-80b)
    O = [dw x],  O' = [w^ x]^2 dt,  W = E{ [v x] (r^ r^T + S_cm) [v x]^T }       (3-41), (3-64), (3-56)

with v the noise of the measured increment dw, and w^ the mean of the two readings. Then one Kalman
update (3-83) to (3-87), its variance in Joseph's form.

Several accelerometers make one zeta' by a rule of `estimation.redundancy`. Their errors share what is unknown of
the rotation, so that with M_ij = r^_i r^_j^T + S_cm

    R'_ij = R^d + var(v) (tr(M_ij) 1 - M_ij^T) + (O + O') S_cm (O + O')^T,    i != j

Thrust errors may be considered, see `considered`, with H = lambda and G = [lambda_1 ... lambda_n] / m; the products of
both errors have lambda_j in place of H_j of `rotation_filter`.

Source: D. R. Levy, MIT S.M. thesis, 1983, chapter 3; R'_ij and considered thrust errors are our own.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import Action, Adaptation
from massprop_drake.maths.estimation.filters.considered import add_effect_covariance, add_noise, update_sensitivity
from massprop_drake.maths.estimation.filters.mass_jump import empty_window, jump_test, small_gain_growth
from massprop_drake.maths.estimation.redundancy import Rule, combine_packages
from massprop_drake.maths.kernels import kernel, numbers
from massprop_drake.maths.linear_algebra import Array, congruence, inverse_positive_definite, quadratic_form, skew


class Compensation(IntEnum):
    """Accelerations by rotation that are taken out of a velocity increment."""

    NONE = 0
    TRANSVERSE = 1
    TRANSVERSE_CENTRIPETAL = 2


_TELLING = 1e4  # a jump's variance by one sample, relative to that of a jump, above which it says nothing
_IDENTITY = np.eye(3)
_WHAT = "the mass filter's innovation covariance"


class MassParams(NamedTuple):
    """Parameters of the mass filter.

    Attributes:
        period_s: sample period, s.
        positions: of the accelerometers, the preferred one first, vehicle frame, ft or m, shape (s, 3).
        variances: of the error of one reading of each, per component, shape (s,).
        rule: how they make one measurement, see `estimation.redundancy`.
        correlated: whether what they share counts.
        compensation: NONE, TRANSVERSE or TRANSVERSE_CENTRIPETAL.
        compensation_covariance: whether R' grows by what is unknown of the compensation.
        process_noise: variance of 1/m added per sample (3-82).
        jump_variance: of 1/m, added when the mass properties have jumped.
        jump_threshold: on the likelihood argument of a jump of 1/m (3-110); infinity: no test.
        jump_window: samples that the test looks back, 1: the single-sample test.
        disturbance_covariance: R^d of a velocity increment, ft^2/s^2 or m^2/s^2, shape (3, 3).
        small_gain: whether the variance after a jump is the thesis's, for small gains.
    """

    period_s: float
    positions: Array
    variances: Array
    rule: Rule
    correlated: bool
    compensation: Compensation
    compensation_covariance: bool
    process_noise: float
    jump_variance: float
    jump_threshold: float
    jump_window: int
    disturbance_covariance: Array
    small_gain: bool = False


class Rotation(NamedTuple):
    """Data of a sample that the mass filter takes from the rotation filter.

    Attributes:
        increment: measured rate increment dw, rad/s, NaN where missing, shape (3,).
        rate: mean measured rate w^, rad/s, likewise.
        variance: of the increment's error per component, rad^2/s^2.
        center: predicted center of mass, vehicle frame, ft or m, shape (3,).
        center_covariance: S_cm, shape (3, 3).
    """

    increment: Array
    rate: Array
    variance: float
    center: Array
    center_covariance: Array


@kernel
def compensate_rotation(
    velocity_increment: Array, velocity_noise: Array, arm: Array, rotation: Rotation, params: MassParams
) -> tuple[Array, Array]:
    r"""Computes the velocity increment less its part by rotation, (3-57) or (3-77), and covariance R' (3-80b).

    Args:
        velocity_increment: zeta, ft/s or m/s, body axes, shape (3,).
        velocity_noise: R^zeta, shape (3, 3).
        arm: r^, accelerometer from the estimated center of mass, ft or m, shape (3,).
        params: for the period and what is compensated; where the covariance is not to grow by W and S_cm (the
            thesis's COV), R' = R^zeta.
    """
    if params.compensation == Compensation.NONE:
        return velocity_increment, velocity_noise
    mixing = _arm_jacobian(rotation, params)
    result = velocity_increment - np.dot(mixing, arm)
    if params.compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        # E{[v x]^2} = -2 var (3-69) for an error v independent of the reading, as a quantizer's is; the
        # mean of two readings has a quarter of the increment's variance
        result += 0.5 * rotation.variance * params.period_s * arm
    if not params.compensation_covariance:
        return result, velocity_noise
    # W: E{[v x] M [v x]^T} = var (tr(M) 1 - M) with M = r^ r^T + S_cm (3-56)
    arm_moment = arm[:, None] * arm + rotation.center_covariance
    trace = arm_moment[0, 0] + arm_moment[1, 1] + arm_moment[2, 2]
    covariance = congruence(mixing, rotation.center_covariance) + velocity_noise
    covariance += rotation.variance * (trace * _IDENTITY - arm_moment)
    return result, covariance


@kernel
def _arm_jacobian(rotation: Rotation, params: MassParams) -> Array:
    """Computes d(velocity increment)/d(arm), O + O' (3-41), (3-64); O alone for TRANSVERSE, shape (3, 3)."""
    mixing = skew(rotation.increment)
    if params.compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        spin = skew(rotation.rate)
        mixing = mixing + spin @ spin * params.period_s
    return mixing


def shared_covariance(arms: tuple[Array, Array], rotation: Rotation, params: MassParams) -> Array:
    """Computes R'_ij - R^d of two accelerometers: their compensated increments' common covariance, shape (3, 3).

    The arms r^_i and r^_j are from the estimated center of mass, ft or m, shape (3,) each.
    """
    if params.compensation == Compensation.NONE or not params.compensation_covariance:
        return np.zeros((3, 3))
    mixing = _arm_jacobian(rotation, params)
    moment = np.outer(*arms) + rotation.center_covariance
    shared = congruence(mixing, rotation.center_covariance)
    return shared + rotation.variance * (np.trace(moment) * _IDENTITY - moment.T)


class MassState(NamedTuple):
    """State of the mass filter.

    Attributes:
        mass_reciprocal: 1/m, 1/slug or 1/kg.
        variance: of its error.
        window: of the jump test, shape (n, 3).
        sensitivity: Psi, see `rotation_filter.RotationState`, shape (n_jets,); None where thrust is taken
            as known.
    """

    mass_reciprocal: float
    variance: float
    window: Array
    sensitivity: Array | None = None


@kernel
def independent_variance(variance: float, sensitivity: Array | None) -> float:
    """Computes S_0, the part of the variance of 1/m independent of thrust errors, S - Psi^T Psi."""
    if sensitivity is None:
        return variance
    return variance - float(sensitivity @ sensitivity)


class MassSample(NamedTuple):
    """Sample as the mass filter takes it.

    Attributes:
        measured: zeta', velocity increment freed of rotation, ft/s or m/s, body axes, shape (3,).
        noise: its covariance R', shape (3, 3).
        linear_impulse: lambda, lbf-s or N-s, shape (3,).
        thrust_errors: linear impulses of one sigma of each jet's thrust error, shape (3, n_jets); None:
            thrust is taken as known.
    """

    measured: Array
    noise: Array
    linear_impulse: Array
    thrust_errors: Array | None = None


class MassInnovation(NamedTuple):
    """Measured minus predicted velocity increment of one sample, before any update.

    Attributes:
        innovation: epsilon, ft/s or m/s, body axes, shape (3,).
        covariance: Y^zeta, shape (3, 3).
        information: its inverse.
        noise: R', with considered thrust errors also the products' covariance, see `rotation_filter`, shape (3, 3).
        effects: L = lambda Psi + G, what one sigma of each jet's thrust error does to the innovation, shape
            (3, n_jets); None where no thrust error is considered.
        nis: epsilon^T Y^-1 epsilon; at most 3 on average for a consistent filter (a quantizer larger
            than the signal shows less noise than its covariance).
    """

    innovation: Array
    covariance: Array
    information: Array
    noise: Array
    effects: Array | None
    nis: float


class MassCycle(NamedTuple):
    """State of the mass filter after a sample, measured or not, used or not."""

    state: MassState
    used: bool
    jumped: bool


@kernel
def innovate(state: MassState, sample: MassSample) -> MassInnovation:
    """Computes a velocity increment's innovation (3-85), its covariance (3-87) and NIS.

    Raises:
        NotPositiveDefiniteError: when Y^zeta is not positive definite.
    """
    impulse = sample.linear_impulse
    innovation = sample.measured - impulse * state.mass_reciprocal
    effects = _innovation_effects(impulse, state.sensitivity, sample.thrust_errors, state.mass_reciprocal)
    innovation, noise = _add_thrust_errors(
        innovation, sample.noise, state.variance, state.sensitivity, sample.thrust_errors
    )
    covariance = _innovation_covariance(
        independent_variance(state.variance, state.sensitivity), impulse, effects, noise
    )
    information = inverse_positive_definite(covariance, _WHAT)
    nis = quadratic_form(innovation, information)
    return MassInnovation(innovation, covariance, information, noise, effects, nis)


@kernel
def _add_thrust_errors(
    innovation: Array, noise: Array, variance: float, sensitivity: Array | None, thrust_errors: Array | None
) -> tuple[Array, Array]:
    """Returns innovation and noise with products of thrust errors and 1/m's error added, where considered."""
    if thrust_errors is None or sensitivity is None:
        return innovation, noise
    mean = thrust_errors @ sensitivity
    return innovation - mean, noise + variance * (thrust_errors @ thrust_errors.T) + np.outer(mean, mean)


@kernel
def _innovation_effects(
    impulse: Array, sensitivity: Array | None, thrust_errors: Array | None, mass_reciprocal: float
) -> Array | None:
    """Computes the innovation's sensitivity to thrust errors, L = lambda Psi + G, shape (3, n_jets); or None."""
    if thrust_errors is None or sensitivity is None:
        return None
    return impulse[:, None] * sensitivity + thrust_errors * mass_reciprocal


@kernel
def _innovation_covariance(variance: float, impulse: Array, effects: Array | None, noise: Array) -> Array:
    """Computes the innovation covariance Y^zeta (3-87) from variance S_0, thrust-error effects and noise, (3, 3)."""
    return add_effect_covariance(impulse[:, None] * (impulse * variance) + noise, effects)


@kernel
def update(
    state: MassState, sample: MassSample, innovation: MassInnovation, adaptation: Adaptation, params: MassParams
) -> MassCycle:
    """Updates 1/m by a velocity increment, (3-83) to (3-86), tests for a jump, then updates in time (3-82).

    A jump of the mass reciprocal is tested for, and corrected, unless a jet's failure explains the sample; see
    `mass_jump`.
    """
    if adaptation.action == Action.REJECT:
        return MassCycle(_propagate(state, params), False, False)
    after, gain = _apply_measurement(_clear_jump_window(state, adaptation, params), sample, innovation, adaptation)
    kept = 1.0 - float(gain @ sample.linear_impulse)
    return _test_jump(after, 1.0 - kept, (sample, innovation), adaptation, params)


@kernel
def _clear_jump_window(state: MassState, adaptation: Adaptation, params: MassParams) -> MassState:
    """Returns the state with the jump test's window cleared, if the update is adapted to a jet's failure."""
    if adaptation.action == Action.NONE:
        return state
    return MassState(state.mass_reciprocal, state.variance, empty_window(params.jump_window), state.sensitivity)


@kernel
def _test_jump(
    state: MassState,
    scalar_gain: float,
    measurement: tuple[MassSample, MassInnovation],
    adaptation: Adaptation,
    params: MassParams,
) -> MassCycle:
    """Tests for a jump of 1/m after an update of gain kappa^T lambda, corrects one, and updates in time (3-82)."""
    jumped = False
    reciprocal, variance, window = state.mass_reciprocal, state.variance, state.window
    if params.jump_threshold < math.inf and adaptation.action == Action.NONE:
        sample, innovation = measurement
        impulse, information = sample.linear_impulse, innovation.information
        test = jump_test(window, impulse, information, innovation.innovation, scalar_gain)
        # a couple of jets leaves an impulse of rounding errors, which shows no jump
        telling = test.growth < _TELLING * params.jump_variance
        jumped = telling and test.likelihood > params.jump_threshold
        window = test.window
        if jumped:
            growth = small_gain_growth(variance, impulse, information) if params.small_gain else test.growth
            reciprocal += test.correction
            variance += growth
            window = empty_window(params.jump_window)
    return MassCycle(_propagate(MassState(reciprocal, variance, window, state.sensitivity), params), True, jumped)


@kernel
def _apply_measurement(
    state: MassState, sample: MassSample, innovation: MassInnovation, adaptation: Adaptation
) -> tuple[MassState, Array]:
    """Updates 1/m and variance by one velocity increment; returns the state and the gain kappa, shape (3,)."""
    information, noise, error = innovation.information, innovation.noise, innovation.innovation
    enlarged = np.zeros((3, 3))  # gains have it besides
    if adaptation.action != Action.NONE:
        error = error - adaptation.translation
        noise = noise + adaptation.translation_spread
    if adaptation.action == Action.CORRECT_THESIS:
        enlarged = adaptation.translation_spread
        information = inverse_positive_definite(innovation.covariance + enlarged, _WHAT)
    first = _joseph_update(state, sample.linear_impulse, error, information, noise, innovation.effects)
    made_with = state, sample, (error, noise, innovation.noise, enlarged)
    return _repeat_update(first, made_with, state.sensitivity, sample.thrust_errors, innovation.effects)


@kernel
def _repeat_update(
    first_update: tuple[MassState, Array],
    update_inputs: tuple[MassState, MassSample, tuple[Array, Array, Array, Array]],
    sensitivity: Array | None,
    thrust_errors: Array | None,
    effects: Array | None,
) -> tuple[MassState, Array]:
    """Repeats the update with thrust-error effects G at the first update's estimate, where they are considered.

    Args:
        update_inputs: state, sample, innovation, and noises: corrected, as measured, and what gains have besides.
        sensitivity, thrust_errors, effects: of that state, the sample and the innovation.
    """
    if thrust_errors is None or sensitivity is None or effects is None:
        return first_update
    state, sample, (error, noise, measured, enlarged) = update_inputs
    impulse = sample.linear_impulse
    again = _innovation_effects(impulse, sensitivity, thrust_errors, first_update[0].mass_reciprocal)
    covariance = _innovation_covariance(independent_variance(state.variance, sensitivity), impulse, again, measured)
    information = inverse_positive_definite(covariance + enlarged, _WHAT)
    return _joseph_update(state, impulse, error, information, noise, again)


@kernel
def _joseph_update(
    state: MassState, impulse: Array, innovation: Array, information: Array, noise: Array, effects: Array | None
) -> tuple[MassState, Array]:
    """Updates 1/m (3-83), (3-86) and its variance in Joseph's form; returns the state and the gain, shape (3,)."""
    independent = independent_variance(state.variance, state.sensitivity)
    gain = information @ _cross_covariance(independent * impulse, state.sensitivity, effects)
    kept = 1.0 - float(gain @ impulse)
    variance = kept * kept * independent + quadratic_form(gain, noise)
    sensitivity = update_sensitivity(state.sensitivity, gain, effects)
    variance = _total_variance(variance, sensitivity, effects)
    reciprocal = state.mass_reciprocal + float(gain @ innovation)
    return MassState(reciprocal, variance, state.window, sensitivity), gain


@kernel
def _cross_covariance(independent_part: Array, sensitivity: Array | None, effects: Array | None) -> Array:
    """Computes the covariance of 1/m with the innovation from its part independent of thrust errors, shape (3,)."""
    if effects is None or sensitivity is None:
        return independent_part
    return independent_part + effects @ sensitivity


@kernel
def _total_variance(independent_part: float, sensitivity: Array | None, effects: Array | None) -> float:
    """Computes the whole variance of 1/m: S_0, independent of thrust errors, plus that by considered thrust errors."""
    if effects is None or sensitivity is None:
        return independent_part
    return independent_part + float(sensitivity @ sensitivity)


@kernel
def _propagate(state: MassState, params: MassParams) -> MassState:
    """Adds a random walk's variance over a cycle to the variance of 1/m (3-82)."""
    return MassState(state.mass_reciprocal, state.variance + params.process_noise, state.window, state.sensitivity)


class MassMeasurement(NamedTuple):
    """Sample of the mass filter and its innovation.

    Attributes:
        sample: what was measured, of all accelerometers together.
        innovation: before any update; NaN where not measured.
        each: the packages' own samples, where the update is made with one after the other.
    """

    sample: MassSample
    innovation: MassInnovation
    each: tuple[MassSample, ...] = ()


class MassInterval(NamedTuple):
    """Known inputs of a sample interval before it is measured.

    Attributes:
        linear_impulse: lambda, lbf-s or N-s, shape (3,).
        extra_noise: common to all packages, besides the disturbance, shape (3, 3); None: none.
        thrust_errors: see `MassSample`.
    """

    linear_impulse: Array
    extra_noise: Array | None = None
    thrust_errors: Array | None = None


def uses_one_package(params: MassParams) -> bool:
    """Tests whether a measurement is of a single accelerometer, not a combination of several."""
    return params.rule == Rule.SINGLE or params.variances.size == 1


def measure(
    state: MassState,
    velocities_before: Array,
    velocities: Array,
    interval: MassInterval,
    rotation: Rotation,
    params: MassParams,
) -> MassMeasurement:
    """Makes the sample of a cycle, the velocity increment less rotation, and its innovation.

    The velocities are readings of the accelerometers at the sample's two ends, in the order of the parameters'
    positions, ft/s or m/s, NaN where missing, shape (s, 3) each.
    """
    increments = velocities - velocities_before
    turns = params.compensation == Compensation.NONE or _is_measured(rotation.increment)
    indices = [index for index in range(len(increments)) if turns and _is_measured(increments[index])]
    if uses_one_package(params) or len(indices) < 2:
        return MassMeasurement(
            *measure_first_usable(state, (velocities_before, velocities), interval, rotation, params)
        )
    compensated = [_compensate_package(index, increments, rotation, params) for index in indices]
    disturbance = add_noise(params.disturbance_covariance, interval.extra_noise)
    covariances = _stacked_covariance(compensated, indices, rotation, params)
    measurements = np.array([increment for increment, _ in compensated])
    measured, noise = combine_packages(measurements, covariances, params.rule, correlated=params.correlated)
    # what disturbs the body is common to all packages: no average makes it less
    sample = MassSample(measured, noise + disturbance, interval.linear_impulse, interval.thrust_errors)
    each: tuple[MassSample, ...] = ()
    if params.rule == Rule.SERIAL and not params.correlated:
        each = tuple(sample._replace(measured=increment, noise=own + disturbance) for increment, own in compensated)
    return MassMeasurement(sample, innovate(state, sample), each)


@kernel
def measure_first_usable(
    state: MassState, velocities: tuple[Array, Array], interval: MassInterval, rotation: Rotation, params: MassParams
) -> tuple[MassSample, MassInnovation]:
    """Makes sample and innovation of the first accelerometer that reads; NaN without, or if rotation is not known."""
    increments = velocities[1] - velocities[0]
    if params.compensation == Compensation.NONE or _is_measured(rotation.increment):
        for index in range(increments.shape[0]):
            if _is_measured(increments[index]):
                measured, own = _compensate_package(index, increments, rotation, params)
                noise = own + add_noise(params.disturbance_covariance, interval.extra_noise)
                sample = MassSample(measured, noise, interval.linear_impulse, interval.thrust_errors)
                return sample, innovate(state, sample)
    nothing, unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    blank = MassSample(nothing, unknown, interval.linear_impulse, interval.thrust_errors)
    return blank, MassInnovation(nothing, unknown, unknown, unknown, None, math.nan)


@kernel
def _is_measured(increment: Array) -> bool:
    """Tests whether all three components of an increment are finite."""
    x, y, z = numbers(increment, 3)
    return math.isfinite(x + y + z)


@kernel
def _compensate_package(index: int, increments: Array, rotation: Rotation, params: MassParams) -> tuple[Array, Array]:
    """Computes one accelerometer's velocity increment less rotation, shape (3,), and its covariance."""
    noise = 2.0 * params.variances[index] * _IDENTITY
    return compensate_rotation(increments[index], noise, params.positions[index] - rotation.center, rotation, params)


def _stacked_covariance(
    compensated: list[tuple[Array, Array]], indices: list[int], rotation: Rotation, params: MassParams
) -> Array:
    """Computes covariances R'_ij of accelerometers that read, disturbance aside; zero for i != j unless correlated."""
    count = len(compensated)
    covariances = np.zeros((count, count, 3, 3))
    for i, j in np.ndindex(count, count):
        if i == j:
            covariances[i, i] = compensated[i][1]
        elif params.correlated:
            arms = params.positions[indices[i]] - rotation.center, params.positions[indices[j]] - rotation.center
            covariances[i, j] = shared_covariance(arms, rotation, params)
    return covariances


def finish(
    state: MassState,
    measurement: MassMeasurement,
    usable: bool,
    firing: bool,
    adaptation: Adaptation,
    params: MassParams,
) -> MassCycle:
    """Updates the mass filter by a measurement if usable and firing, then adds process noise; returns state and flags.

    After a jump of the mass properties beyond doubt the variance is raised, and the sample used with it. A sample is
    `usable` when the combination of jets was steady, and `firing` when a known impulse acted. With the packages' own
    samples the update is made with one after the other.
    """
    sample, innovation, each = measurement
    if not (each and usable and firing) or adaptation.action == Action.REJECT:
        return finish_one(state, (sample, innovation), (usable, firing), adaptation, params)
    if adaptation.mass_jumped:
        state = _raise_variance(state, params)
        innovation = innovate(state, sample)
    after, kept = _clear_jump_window(state, adaptation, params), 1.0
    for part in each:
        after, gain = _apply_measurement(after, part, innovate(after, part), adaptation)
        kept *= 1.0 - float(gain @ part.linear_impulse)
    return _test_jump(after, 1.0 - kept, (sample, innovation), adaptation, params)


@kernel
def finish_one(
    state: MassState,
    measurement: tuple[MassSample, MassInnovation],
    usable_and_firing: tuple[bool, bool],
    adaptation: Adaptation,
    params: MassParams,
) -> MassCycle:
    """Updates the mass filter by one measurement if its interval is usable and firing, then adds process noise."""
    sample, innovation = measurement
    usable, firing = usable_and_firing
    there = not math.isnan(innovation.nis)
    if adaptation.mass_jumped:
        state = _raise_variance(state, params)
        if there:
            innovation = innovate(state, sample)
    if not (there and usable and firing):
        return MassCycle(_propagate(state, params), False, False)
    return update(state, sample, innovation, adaptation, params)


@kernel
def _raise_variance(state: MassState, params: MassParams) -> MassState:
    """Inflates the variance of 1/m after a jump of the mass properties that is beyond doubt."""
    return MassState(state.mass_reciprocal, state.variance + params.jump_variance, state.window, state.sensitivity)
