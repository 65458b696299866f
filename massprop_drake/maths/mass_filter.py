r"""The Kalman filter for the mass reciprocal from velocity increments.

Measurement of one sample at an accelerometer, r = r'_acc - r_cm from the centre of mass:

    zeta = V_k - V_{k-1} = lambda / m + dw x r + [w x (w x r)] dt + noise        (3-32), (3-37)

The transverse and, optionally, the centripetal part are subtracted with the measured rates and the
estimated centre of mass, and the measurement's covariance grows by what is unknown of them:

    zeta' = zeta - dw x r^ - [w^ x (w^ x r^)] dt + 2 var(w^) dt r^               (3-57), (3-77)
    R'    = R + W + (O + O') S_cm (O + O')^T                                     (3-80b)
    O = [dw x],  O' = [w^ x]^2 dt,  W = E{ [v x] (r^ r^T + S_cm) [v x]^T }       (3-41), (3-64), (3-56)

with v the noise of the measured increment dw, and w^ the mean of the two readings. Then one Kalman
update (3-83) to (3-87), its variance in Joseph's form.

Source: D. R. Levy, MIT S.M. thesis, 1983, chapter 3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.adaptation import CORRECT_THESIS, NO_ACTION, REJECT, Adaptation
from massprop_drake.maths.linear_algebra import Array, inverse_positive_definite, skew
from massprop_drake.maths.mass_jump import empty_window, jump_test

NO_COMPENSATION, TRANSVERSE, TRANSVERSE_CENTRIPETAL = 0, 1, 2

_IDENTITY = np.eye(3)
_NOT_MEASURED = np.full(3, np.nan)


def compensated(
    velocity_increment: Array,
    velocity_noise: Array,
    rate_increment: Array,
    rate: Array,
    rate_variance: float,
    arm: Array,
    center_covariance: Array,
    period_s: float,
    compensation: int,
    grow_covariance: bool,
) -> tuple[Array, Array]:
    r"""The velocity increment freed of rotation, zeta' (3-57) or (3-77), and its covariance R' (3-80b).

    Args:
        velocity_increment: zeta, ft/s or m/s, body axes, shape (3,).
        velocity_noise: R^zeta, shape (3, 3).
        rate_increment: measured dw, rad/s, shape (3,).
        rate: mean measured rate over the sample, rad/s, shape (3,).
        rate_variance: of the error of dw per component, rad^2/s^2.
        arm: r^, accelerometer from the estimated centre of mass, ft or m, shape (3,).
        center_covariance: S_cm, shape (3, 3), predicted.
        period_s: sample period, s.
        compensation: NO_COMPENSATION, TRANSVERSE or TRANSVERSE_CENTRIPETAL.
        grow_covariance: whether R' grows by W and S_cm (the thesis's COV); without it R' = R^zeta.
    """
    if compensation == NO_COMPENSATION:
        return velocity_increment, velocity_noise
    mixing = skew(rate_increment)
    if compensation == TRANSVERSE_CENTRIPETAL:
        spin = skew(rate)
        mixing = mixing + spin @ spin * period_s
    result = velocity_increment - mixing @ arm
    if compensation == TRANSVERSE_CENTRIPETAL:
        # E{[v x]^2} = -2 var (3-69) for an error v independent of the reading, as a quantiser's is; the
        # mean of two readings has a quarter of the increment's variance
        result += 0.5 * rate_variance * period_s * arm
    if not grow_covariance:
        return result, velocity_noise
    # W: E{[v x] M [v x]^T} = var (tr(M) 1 - M) with M = r^ r^T + S_cm (3-56)
    arm_moment = arm[:, None] * arm + center_covariance
    trace = arm_moment[0, 0] + arm_moment[1, 1] + arm_moment[2, 2]
    covariance = mixing @ center_covariance @ mixing.T + velocity_noise
    covariance += rate_variance * (trace * _IDENTITY - arm_moment)
    return result, covariance


class MassSettings(NamedTuple):
    """What shapes the mass filter.

    Attributes:
        period_s: sample period, s.
        compensation: NO_COMPENSATION, TRANSVERSE or TRANSVERSE_CENTRIPETAL.
        compensation_covariance: whether R' grows by what is unknown of the compensation.
        process_noise: variance of 1/m added per sample (3-82).
        jump_variance: of 1/m, added when the mass properties have jumped.
        jump_threshold: on the likelihood argument of a jump of 1/m (3-110); infinity: no test.
        jump_window: samples that the test looks back, 1: the single-sample test.
        disturbance_covariance: R^d of a velocity increment, ft^2/s^2 or m^2/s^2, shape (3, 3).
    """

    period_s: float
    compensation: int
    compensation_covariance: bool
    process_noise: float
    jump_variance: float
    jump_threshold: float
    jump_window: int
    disturbance_covariance: Array


class MassSample(NamedTuple):
    """What one sample brings to the mass filter.

    Attributes:
        increment: measured velocity increment zeta, ft/s or m/s, body axes, shape (3,).
        noise: its covariance R^zeta, shape (3, 3).
        arm: accelerometer from the predicted centre of mass, ft or m, shape (3,).
        center_covariance: S_cm, predicted, shape (3, 3).
        rate_increment: measured rate increment, rad/s, shape (3,).
        rate: mean measured rate, rad/s, shape (3,).
        rate_variance: of the rate increment's error per component, rad^2/s^2.
        linear_impulse: lambda, lbf-s or N-s, shape (3,).
    """

    increment: Array
    noise: Array
    arm: Array
    center_covariance: Array
    rate_increment: Array
    rate: Array
    rate_variance: float
    linear_impulse: Array


class MassInnovation(NamedTuple):
    """Measured minus predicted velocity increment of one sample, before any update.

    Attributes:
        innovation: epsilon, ft/s or m/s, body axes, shape (3,).
        covariance: Y^zeta, shape (3, 3).
        information: its inverse.
        noise: R', shape (3, 3).
        nis: epsilon^T Y^-1 epsilon; at most 3 on average for a consistent filter (a quantiser larger
            than the signal shows less noise than its covariance).
    """

    innovation: Array
    covariance: Array
    information: Array
    noise: Array
    nis: float


class MassUpdate(NamedTuple):
    """State of the mass filter after one sample.

    Attributes:
        mass_reciprocal: 1/m, 1/slug or 1/kg.
        variance: of its error.
        window: of the jump test, shape (n, 3).
        jumped: whether the jump test found a jump.
    """

    mass_reciprocal: float
    variance: float
    window: Array
    jumped: bool


def innovate(
    mass_reciprocal: float,
    variance: float,
    sample: MassSample,
    settings: MassSettings,
) -> MassInnovation:
    """The innovation of one sample (3-85) and its covariance (3-87).

    Args:
        mass_reciprocal, variance: predicted 1/m and its variance.
        sample: see `MassSample`.
        settings: see `MassSettings`.

    Raises:
        NotPositiveDefiniteError: when Y^zeta is not positive definite.
    """
    measured, noise = compensated(
        sample.increment,
        sample.noise + settings.disturbance_covariance,
        sample.rate_increment,
        sample.rate,
        sample.rate_variance,
        sample.arm,
        sample.center_covariance,
        settings.period_s,
        settings.compensation,
        settings.compensation_covariance,
    )
    impulse = sample.linear_impulse
    innovation = measured - impulse * mass_reciprocal
    covariance = impulse[:, None] * (impulse * variance) + noise
    information = inverse_positive_definite(covariance, "innovation covariance")
    nis = float(innovation @ information @ innovation)
    return MassInnovation(innovation, covariance, information, noise, nis)


def update(
    mass_reciprocal: float,
    variance: float,
    window: Array,
    linear_impulse: Array,
    innovation: MassInnovation,
    adaptation: Adaptation,
    settings: MassSettings,
) -> MassUpdate:
    """Measurement update (3-83), (3-86), variance in Joseph's form of (3-84), then (3-82).

    A jump of the mass reciprocal is tested for, and corrected, unless a jet's failure explains the
    sample; see `maths.mass_jump`.

    Args:
        mass_reciprocal, variance: predicted 1/m and its variance.
        window: of the jump test, shape (n, 3).
        linear_impulse: lambda over the sample, lbf-s or N-s, shape (3,).
        innovation: what `measure` made of the sample.
        adaptation: see `maths.adaptation`.
        settings: see `MassSettings`.
    """
    if adaptation.action == REJECT:
        return MassUpdate(mass_reciprocal, variance + settings.process_noise, window, jumped=False)
    information, noise, error = innovation.information, innovation.noise, innovation.innovation
    if adaptation.action != NO_ACTION:
        error = error - adaptation.translation
        noise = noise + adaptation.translation_spread
        window = empty_window(settings.jump_window)  # its sums are of plain updates
    if adaptation.action == CORRECT_THESIS:
        enlarged = innovation.covariance + adaptation.translation_spread
        information = inverse_positive_definite(enlarged, "innovation covariance")
    gain = variance * (information @ linear_impulse)
    kept = 1.0 - float(gain @ linear_impulse)
    mass_reciprocal += float(gain @ error)
    variance = kept * kept * variance + float(gain @ noise @ gain)
    jumped = False
    if settings.jump_threshold < math.inf and adaptation.action == NO_ACTION:
        test = jump_test(window, linear_impulse, information, error, gain)
        window = test.window
        jumped = test.likelihood > settings.jump_threshold
        if jumped:
            mass_reciprocal += test.correction
            variance += test.growth
            window = empty_window(settings.jump_window)
    return MassUpdate(mass_reciprocal, variance + settings.process_noise, window, jumped)


class MassMeasurement(NamedTuple):
    """A sample's impulse and its innovation.

    Attributes:
        linear_impulse: lambda, lbf-s or N-s, shape (3,).
        innovation: before any update; NaN where not measured.
    """

    linear_impulse: Array
    innovation: MassInnovation


def measure(
    mass_reciprocal: float,
    variance: float,
    velocity_before: Array,
    velocity: Array,
    noise: Array,
    arm: Array,
    center_covariance: Array,
    rate_increment: Array,
    rate: Array,
    rate_variance: float,
    linear_impulse: Array,
    settings: MassSettings,
) -> MassMeasurement:
    """First half of a cycle: the increment and its innovation.

    Args:
        mass_reciprocal, variance: predicted 1/m and its variance.
        velocity_before, velocity: readings at the sample's two ends, ft/s or m/s, NaN where missing.
        noise: covariance of their difference, shape (3, 3).
        arm: accelerometer from the predicted centre of mass, ft or m, shape (3,).
        center_covariance: of the predicted centre of mass, shape (3, 3).
        rate_increment, rate: measured increment and mean of the rate, rad/s, NaN where missing.
        rate_variance: of the rate increment's error per component, rad^2/s^2.
        linear_impulse: lambda over the sample, lbf-s or N-s, shape (3,).
        settings: see `MassSettings`.
    """
    increment = velocity - velocity_before
    needed = sum(increment.tolist())
    if settings.compensation != NO_COMPENSATION:
        needed += sum(rate_increment.tolist())
    if math.isfinite(needed):
        sample = MassSample(
            increment, noise, arm, center_covariance, rate_increment, rate, rate_variance, linear_impulse
        )
        innovation = innovate(mass_reciprocal, variance, sample, settings)
    else:
        innovation = MassInnovation(_NOT_MEASURED, noise, noise, noise, math.nan)
    return MassMeasurement(linear_impulse, innovation)


def finish(
    mass_reciprocal: float,
    variance: float,
    window: Array,
    measurement: MassMeasurement,
    usable: bool,
    firing: bool,
    adaptation: Adaptation,
    settings: MassSettings,
) -> MassCycle:
    """Second half of a cycle: the update, when the sample can be used.

    After a jump of the mass properties beyond doubt the variance is raised, and the sample used with
    it.

    Args:
        mass_reciprocal, variance: predicted 1/m and its variance.
        window: of the jump test, shape (n, 3).
        measurement: what `measure` made of the sample.
        usable: whether the combination of jets was steady.
        firing: whether a known impulse acted.
        adaptation: see `maths.adaptation`.
        settings: see `MassSettings`.
    """
    impulse, innovation = measurement
    if adaptation.mass_jumped:
        variance = variance + settings.jump_variance
        if not math.isnan(innovation.nis):
            grown = innovation.covariance + impulse[:, None] * (impulse * settings.jump_variance)
            information = inverse_positive_definite(grown, "innovation covariance")
            innovation = innovation._replace(covariance=grown, information=information)
    if math.isnan(innovation.nis) or not (usable and firing):
        return MassCycle(mass_reciprocal, variance + settings.process_noise, window, used=False, jumped=False)
    updated = update(mass_reciprocal, variance, window, impulse, innovation, adaptation, settings)
    return MassCycle(*updated[:3], used=adaptation.action != REJECT, jumped=updated.jumped)


class MassCycle(NamedTuple):
    """State of the mass filter after a cycle, measured or not, used or not.

    Attributes:
        mass_reciprocal: 1/m.
        variance: of its error.
        window: of the jump test, shape (n, 3).
        used: whether the estimate was updated.
        jumped: whether the jump test found a jump.
    """

    mass_reciprocal: float
    variance: float
    window: Array
    used: bool
    jumped: bool
