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

Considered thrust errors enter as in `rotation_filter`, with L = lambda Psi + [lambda_1 ... lambda_n] / m, and with
lambda_j in place of H_j.

Source: D. R. Levy, MIT S.M. thesis, 1983, chapter 3; R'_ij and considered thrust errors are our own.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import Action, Adaptation
from massprop_drake.maths.estimation.filters.mass_jump import empty_window, jump_test, small_gain_growth
from massprop_drake.maths.estimation.redundancy import Rule, combined
from massprop_drake.maths.linear_algebra import Array, inverse_positive_definite, skew


class Compensation(IntEnum):
    """Which accelerations by rotation are taken out of a velocity increment."""

    NONE = 0
    TRANSVERSE = 1
    TRANSVERSE_CENTRIPETAL = 2


_TELLING = 1e4  # a jump's variance by one sample, relative to that of a jump, above which it says nothing
_IDENTITY = np.eye(3)
_WHAT = "the mass filter's innovation covariance"
_NOT_MEASURED = np.full(3, np.nan)


class MassParams(NamedTuple):
    """What shapes the mass filter.

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
    """What the rotation filter says of a sample.

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


def compensated(
    velocity_increment: Array, velocity_noise: Array, arm: Array, rotation: Rotation, params: MassParams
) -> tuple[Array, Array]:
    r"""The velocity increment freed of rotation, zeta' (3-57) or (3-77), and its covariance R' (3-80b).

    Args:
        velocity_increment: zeta, ft/s or m/s, body axes, shape (3,).
        velocity_noise: R^zeta, shape (3, 3).
        arm: r^, accelerometer from the estimated center of mass, ft or m, shape (3,).
        rotation: over the sample, see `Rotation`.
        params: for the period and what is compensated; where the covariance is not to grow by W and S_cm (the
            thesis's COV), R' = R^zeta.
    """
    if params.compensation == Compensation.NONE:
        return velocity_increment, velocity_noise
    mixing = _mixing(rotation, params)
    result = velocity_increment - mixing @ arm
    if params.compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        # E{[v x]^2} = -2 var (3-69) for an error v independent of the reading, as a quantizer's is; the
        # mean of two readings has a quarter of the increment's variance
        result += 0.5 * rotation.variance * params.period_s * arm
    if not params.compensation_covariance:
        return result, velocity_noise
    # W: E{[v x] M [v x]^T} = var (tr(M) 1 - M) with M = r^ r^T + S_cm (3-56)
    arm_moment = arm[:, None] * arm + rotation.center_covariance
    trace = arm_moment[0, 0] + arm_moment[1, 1] + arm_moment[2, 2]
    covariance = mixing @ rotation.center_covariance @ mixing.T + velocity_noise
    covariance += rotation.variance * (trace * _IDENTITY - arm_moment)
    return result, covariance


def _mixing(rotation: Rotation, params: MassParams) -> Array:
    """O + O' (3-41), (3-64): what makes a velocity increment of an arm; O alone for TRANSVERSE, shape (3, 3)."""
    mixing = skew(rotation.increment)
    if params.compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        spin = skew(rotation.rate)
        mixing = mixing + spin @ spin * params.period_s
    return mixing


def shared_covariance(arms: tuple[Array, Array], rotation: Rotation, params: MassParams) -> Array:
    """R'_ij - R^d of two accelerometers: what their compensated velocity increments share, shape (3, 3).

    Args:
        arms: r^_i and r^_j, from the estimated center of mass, ft or m, shape (3,) each.
        rotation, params: see `compensated`.
    """
    if params.compensation == Compensation.NONE or not params.compensation_covariance:
        return np.zeros((3, 3))
    mixing = _mixing(rotation, params)
    moment = np.outer(*arms) + rotation.center_covariance
    shared: Array = mixing @ rotation.center_covariance @ mixing.T
    return shared + rotation.variance * (np.trace(moment) * _IDENTITY - moment.T)


class MassState(NamedTuple):
    """What the mass filter knows.

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

    @property
    def independent(self) -> float:
        """S_0: the part of the variance that does not come of thrust errors."""
        if self.sensitivity is None:
            return self.variance
        return self.variance - float(self.sensitivity @ self.sensitivity)


class MassSample(NamedTuple):
    """What one sample brings to the mass filter.

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


class MassUpdate(NamedTuple):
    """State of the mass filter after one sample.

    Attributes:
        state: see `MassState`.
        jumped: whether the jump test found a jump.
    """

    state: MassState
    jumped: bool


def innovate(state: MassState, sample: MassSample) -> MassInnovation:
    """The innovation of one sample (3-85) and its covariance (3-87).

    Args:
        state: predicted, see `MassState`.
        sample: see `MassSample`.

    Raises:
        NotPositiveDefiniteError: when Y^zeta is not positive definite.
    """
    impulse, noise = sample.linear_impulse, sample.noise
    innovation = sample.measured - impulse * state.mass_reciprocal
    effects = _effects(state, sample, state.mass_reciprocal)
    if sample.thrust_errors is not None and state.sensitivity is not None:
        mean = sample.thrust_errors @ state.sensitivity  # of the products of both errors
        innovation = innovation - mean
        noise = noise + state.variance * (sample.thrust_errors @ sample.thrust_errors.T) + np.outer(mean, mean)
    covariance = _innovation_covariance(state, impulse, effects, noise)
    information = inverse_positive_definite(covariance, _WHAT)
    nis = float(innovation @ information @ innovation)
    return MassInnovation(innovation, covariance, information, noise, effects, nis)


def _effects(state: MassState, sample: MassSample, mass_reciprocal: float) -> Array | None:
    """L = lambda Psi + G, shape (3, n_jets), with G at a mass reciprocal; None where thrust is taken as known."""
    if sample.thrust_errors is None or state.sensitivity is None:
        return None
    effects: Array = sample.linear_impulse[:, None] * state.sensitivity + sample.thrust_errors * mass_reciprocal
    return effects


def _innovation_covariance(state: MassState, impulse: Array, effects: Array | None, noise: Array) -> Array:
    """Y^zeta (3-87), and what considered thrust errors add."""
    covariance: Array = impulse[:, None] * (impulse * state.independent) + noise
    return covariance if effects is None else covariance + effects @ effects.T


def update(
    state: MassState,
    sample: MassSample,
    innovation: MassInnovation,
    adaptation: Adaptation,
    params: MassParams,
    each: tuple[MassSample, ...] = (),
) -> MassUpdate:
    """Measurement update (3-83), (3-86), variance in Joseph's form of (3-84), then (3-82).

    A jump of the mass reciprocal is tested for, and corrected, unless a jet's failure explains the
    sample; see `mass_jump`.

    Args:
        state: predicted, see `MassState`.
        sample: see `MassSample`.
        innovation: what `innovate` made of the same sample.
        adaptation: see `estimation.adaptation`.
        params: see `MassParams`.
        each: the packages' own samples, where the update is made with one after the other.
    """
    if adaptation.action == Action.REJECT:
        return MassUpdate(_later(state, params), jumped=False)
    plain = adaptation.action == Action.NONE
    if not plain:
        state = state._replace(window=empty_window(params.jump_window))  # its sums are of plain updates
    after, kept = state, 1.0
    for part in each or (sample,):
        own = innovation if not each else innovate(after, part)
        after, gain = _updated(after, part, own, adaptation)
        kept *= 1.0 - float(gain @ part.linear_impulse)
    jumped = False
    if params.jump_threshold < math.inf and plain:
        impulse, information, error = sample.linear_impulse, innovation.information, innovation.innovation
        test = jump_test(state.window, impulse, information, error, 1.0 - kept)
        # a couple of jets leaves an impulse of rounding errors, which shows no jump
        telling = test.growth < _TELLING * params.jump_variance
        jumped = telling and test.likelihood > params.jump_threshold
        after = after._replace(window=test.window)
        if jumped:
            growth = small_gain_growth(after.variance, impulse, information) if params.small_gain else test.growth
            after = after._replace(
                mass_reciprocal=after.mass_reciprocal + test.correction,
                variance=after.variance + growth,
                window=empty_window(params.jump_window),
            )
    return MassUpdate(_later(after, params), jumped)


def _updated(
    state: MassState, sample: MassSample, innovation: MassInnovation, adaptation: Adaptation
) -> tuple[MassState, Array]:
    """The state after one measurement, and the gain kappa, shape (3,)."""
    information, noise, error = innovation.information, innovation.noise, innovation.innovation
    enlarged = None
    if adaptation.action != Action.NONE:
        error = error - adaptation.translation
        noise = noise + adaptation.translation_spread
    if adaptation.action == Action.CORRECT_THESIS:
        enlarged = adaptation.translation_spread
        information = inverse_positive_definite(innovation.covariance + enlarged, _WHAT)
    after, gain = _joseph_update(state, sample.linear_impulse, error, information, noise, innovation.effects)
    if innovation.effects is not None:
        effects = _effects(state, sample, after.mass_reciprocal)
        covariance = _innovation_covariance(state, sample.linear_impulse, effects, innovation.noise)
        if enlarged is not None:
            covariance = covariance + enlarged
        information = inverse_positive_definite(covariance, _WHAT)
        after, gain = _joseph_update(state, sample.linear_impulse, error, information, noise, effects)
    return after, gain


def _joseph_update(
    state: MassState, impulse: Array, error: Array, information: Array, noise: Array, effects: Array | None
) -> tuple[MassState, Array]:
    """(3-83), (3-86) and the variance in Joseph's form; Schmidt-Kalman with effects."""
    sensitivity, independent = state.sensitivity, state.independent
    shared = independent * impulse
    if effects is not None and sensitivity is not None:
        shared = shared + effects @ sensitivity
    gain = information @ shared
    kept = 1.0 - float(gain @ impulse)
    variance = kept * kept * independent + float(gain @ noise @ gain)
    if effects is not None and sensitivity is not None:
        sensitivity = sensitivity - gain @ effects
        variance += float(sensitivity @ sensitivity)
    reciprocal = state.mass_reciprocal + float(gain @ error)
    return state._replace(mass_reciprocal=reciprocal, variance=variance, sensitivity=sensitivity), gain


def _later(state: MassState, params: MassParams) -> MassState:
    """The time update (3-82) of a random walk."""
    return state._replace(variance=state.variance + params.process_noise)


class MassMeasurement(NamedTuple):
    """A sample and its innovation.

    Attributes:
        sample: what was measured, of all accelerometers together.
        innovation: before any update; NaN where not measured.
        each: the packages' own samples, where the update is made with one after the other.
    """

    sample: MassSample
    innovation: MassInnovation
    each: tuple[MassSample, ...] = ()


class MassInterval(NamedTuple):
    """What is known of a sample interval before it is measured.

    Attributes:
        linear_impulse: lambda, lbf-s or N-s, shape (3,).
        extra_noise: common to all packages, besides the disturbance, shape (3, 3); None: none.
        thrust_errors: see `MassSample`.
    """

    linear_impulse: Array
    extra_noise: Array | None = None
    thrust_errors: Array | None = None


def measure(
    state: MassState,
    velocities_before: Array,
    velocities: Array,
    interval: MassInterval,
    rotation: Rotation,
    params: MassParams,
) -> MassMeasurement:
    """First half of a cycle: the increment and its innovation.

    Args:
        state: predicted, see `MassState`.
        velocities_before, velocities: readings of the accelerometers at the sample's two ends, in the order
            of the parameters' positions, ft/s or m/s, NaN where missing, shape (s, 3) each.
        interval: see `MassInterval`.
        rotation: see `Rotation`.
        params: see `MassParams`.
    """
    linear_impulse, extra_noise, thrust_errors = interval
    increments = velocities - velocities_before
    disturbance = params.disturbance_covariance
    if extra_noise is not None:
        disturbance = disturbance + extra_noise
    there = []
    if params.compensation == Compensation.NONE or math.isfinite(sum(rotation.increment.tolist())):
        for index, increment in enumerate(increments.tolist()):
            if math.isfinite(increment[0] + increment[1] + increment[2]):
                there.append(index)
                if params.rule == Rule.SINGLE:
                    break
    if not there:
        unknown = np.full((3, 3), np.nan)
        sample = MassSample(_NOT_MEASURED, unknown, linear_impulse)
        blank = MassInnovation(_NOT_MEASURED, unknown, unknown, unknown, None, math.nan)
        return MassMeasurement(sample, blank)

    freed = [
        compensated(
            increments[index],
            2.0 * params.variances[index] * _IDENTITY,
            params.positions[index] - rotation.center,
            rotation,
            params,
        )
        for index in there
    ]
    if len(freed) == 1:
        measured, noise = freed[0]
    else:
        covariances = _stacked_covariance(freed, there, rotation, params)
        measurements = np.array([increment for increment, _ in freed])
        measured, noise = combined(measurements, covariances, params.rule, correlated=params.correlated)
    # what disturbs the body is common to all packages: no average makes it less
    sample = MassSample(measured, noise + disturbance, linear_impulse, thrust_errors)
    each: tuple[MassSample, ...] = ()
    if params.rule == Rule.SERIAL and not params.correlated and len(freed) > 1:
        each = tuple(sample._replace(measured=increment, noise=own + disturbance) for increment, own in freed)
    return MassMeasurement(sample, innovate(state, sample), each)


def _stacked_covariance(
    freed: list[tuple[Array, Array]],
    there: list[int],
    rotation: Rotation,
    params: MassParams,
) -> Array:
    """R'_ij, without disturbance, of the packages that are there, shape (s, s, 3, 3)."""
    count = len(freed)
    covariances = np.zeros((count, count, 3, 3))
    for i in range(count):
        covariances[i, i] = freed[i][1]
        for j in range(count):
            if i == j or not params.correlated:
                continue
            arms = tuple(params.positions[there[k]] - rotation.center for k in (i, j))
            covariances[i, j] = shared_covariance((arms[0], arms[1]), rotation, params)
    return covariances


def finish(
    state: MassState,
    measurement: MassMeasurement,
    usable: bool,
    firing: bool,
    adaptation: Adaptation,
    params: MassParams,
) -> MassCycle:
    """Second half of a cycle: the update, when the sample can be used.

    After a jump of the mass properties beyond doubt the variance is raised, and the sample used with
    it.

    Args:
        state: predicted, see `MassState`.
        measurement: what `measure` made of the sample.
        usable: whether the combination of jets was steady.
        firing: whether a known impulse acted.
        adaptation: see `estimation.adaptation`.
        params: see `MassParams`.
    """
    sample, innovation, each = measurement
    measured = not math.isnan(innovation.nis)
    if adaptation.mass_jumped:
        state = state._replace(variance=state.variance + params.jump_variance)
        if measured:
            innovation = innovate(state, sample)
    if not (measured and usable and firing):
        return MassCycle(_later(state, params), used=False, jumped=False)
    updated = update(state, sample, innovation, adaptation, params, each)
    return MassCycle(updated.state, used=adaptation.action != Action.REJECT, jumped=updated.jumped)


class MassCycle(NamedTuple):
    """State of the mass filter after a cycle, measured or not, used or not.

    Attributes:
        state: see `MassState`.
        used: whether the estimate was updated.
        jumped: whether the jump test found a jump.
    """

    state: MassState
    used: bool
    jumped: bool
