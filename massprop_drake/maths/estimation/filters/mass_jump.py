r"""Jumps of the mass reciprocal by a windowed generalized likelihood ratio.

Had the mass reciprocal jumped by nu at sample theta, the innovation at a later used sample k would be
off by g nu, and the estimate by f nu (3-96) to (3-100):

    g_k = lambda_k (1 - f_k-1),    f_k = (1 - kappa_k^T lambda_k) f_k-1 + kappa_k^T lambda_k,    f_theta-1 = 0

For each theta in a window the information C and the projection d gather over the samples since,

    C = sum g^T Y^-1 g  (3-104),    d = sum g^T Y^-1 epsilon  (3-105),

the jump is estimated by d / C (3-103), and d^2 / C (3-109) is chi-square with one degree of freedom
while nothing jumps, for each theta by itself; the largest over the window is tested at the false-alarm
rate divided by the window's length (the thesis's "N degrees of freedom" is an error).

On a jump the estimate moves by (1 - f) d / C and its variance grows by (1 - f)^2 / C (3-111), (3-113),
exact for the right theta since the innovations of an optimal filter are orthogonal to its error. A
window of one sample is the single-sample test (3-114) to (3-118), whose variance is then that of the
one sample alone, 1 / (lambda^T R'^-1 lambda).

The thesis takes that variance as 3 sigma_old^2 + 1 / (lambda^T Y^-1 lambda) for small gains (3-118), with a
cross term (3-117) that is in truth zero; `small_gain_growth` is that form.

Source: D. R. Levy, MIT S.M. thesis, 1983, sections 3.6 and 3.7.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel, numbers, select_where
from massprop_drake.maths.linear_algebra import Array, quadratic_form


class JumpTest(NamedTuple):
    """Outcome of the jump test for one used sample.

    Attributes:
        window: f, C, d of each theta, the newest last, shape (n, 3); C is zero where there is none yet.
        jump: estimate of the likeliest jump, 1/slug or 1/kg.
        likelihood: its argument d^2 / C.
        correction: what to add to the estimate if there was a jump.
        growth: what to add to its variance then.
    """

    window: Array
    jump: float
    likelihood: float
    correction: float
    growth: float


def jump_threshold(false_alarm_rate: float, window: int) -> float:
    """Computes the jump test's threshold: chi-square of one degree, false-alarm rate divided by the window's length.

    Args:
        false_alarm_rate: of the test, per used sample.
        window: samples that it looks back; the rate is divided among them.
    """
    return NormalDist().inv_cdf(0.5 * false_alarm_rate / window) ** 2


@kernel
def empty_window(length: int) -> Array:
    """Returns the jump test's window of zeros, holding no sample, shape (length, 3)."""
    return np.zeros((length, 3))


@kernel
def jump_test(
    window: Array, linear_impulse: Array, information: Array, innovation: Array, scalar_gain: float
) -> JumpTest:
    """Updates the windowed GLR test for a jump of 1/m by a sample; returns window, jump, GLR and corrections.

    Args:
        window: of the sample before, shape (n, 3).
        linear_impulse: lambda, shape (3,).
        information: inverse of Y^zeta, shape (3, 3).
        innovation: epsilon, shape (3,).
        scalar_gain: kappa^T lambda of the update with this sample.
    """
    window = np.vstack((window[1:], np.zeros((1, 3))))
    weight = information @ linear_impulse
    strength, seen = float(weight @ linear_impulse), float(weight @ innovation)
    left = 1.0 - window[:, 0]
    used = window[:, 1] > 0.0
    used[-1] = True
    window[:, 1] += select_where(used, left * left * strength, 0.0)
    window[:, 2] += select_where(used, left * seen, 0.0)
    window[:, 0] = select_where(used, (1.0 - scalar_gain) * window[:, 0] + scalar_gain, 0.0)
    some = window[:, 1] > 0.0
    likelihood = select_where(some, window[:, 2] ** 2 / select_where(some, window[:, 1], 1.0), 0.0)
    best = int(likelihood.argmax())
    f, c, d = numbers(window[best], 3)
    if c == 0.0:
        return JumpTest(window, 0.0, 0.0, 0.0, 0.0)
    return JumpTest(window, d / c, float(likelihood[best]), (1.0 - f) * d / c, (1.0 - f) ** 2 / c)


@kernel
def small_gain_growth(variance: float, linear_impulse: Array, information: Array) -> float:
    """Computes the thesis's term (3-118) to add to the variance of 1/m after a jump in one sample.

    Args:
        variance: of 1/m after the ordinary update.
        linear_impulse: lambda, shape (3,).
        information: inverse of Y^zeta, shape (3, 3).
    """
    return 2.0 * variance + 1.0 / quadratic_form(linear_impulse, information)
