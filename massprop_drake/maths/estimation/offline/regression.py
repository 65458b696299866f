r"""Batch regression of a flight: all readings explained at once, and tests of what is left over.

Over a stretch of a record the rate is its value at the beginning and the sum of what jets, coupling and known forces
have added since, the velocity likewise, so that with theta all that may be unknown,

    y_k = y_0 + sum_{i <= k} d_i(theta) + v_k,    v_k: white, noise and rounding, of variance R.

That is a regression, whatever filter has flown. Its columns are the ten parameters, the thrust error of each jet, the
error of the lag of each kind, biases, and what a flight should not have: torques, drag, wheels, gains of axes.
With those that the filter reckons with (of prior variance Lambda^-1), the information A = X^T R^-1 X and the score
h = X^T R^-1 e

- bound each parameter: the 1-sigma that A and the start leave is the least for rounding taken as noise;
- test all else (Lagrange's multiplier, or score, test). With the fitted columns marginalized, the score U of a group of
  others has the covariance S if they are zero, so that U^T S^-1 U is chi-square distributed, and S^-1 U is how large
  they are. Errors that are stated with a 1-sigma of s have estimates of variance s^2 + 1/S.

Initial values are eliminated by taking means off. Where stamps are off their ticks, these lie on a line through the
stamps, as far as it is known: its two errors are unknowns of each stretch, and eliminated, too. A reading that has not
moved by a quantum since one was used says nothing new and is left out, as in the joint estimator. About the middle of
each stretch the ten parameters are those at the end with as much more propellant, and within it they go along a
straight line. Noise that gathers, of walks and of a disturbance, is made white by `whitening`. Coupling is taken with
the rates as they are read, and without such noise in the last passes of a fit with those that come of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.estimation.offline.flight_model import (
    FlightModel,
    Stretch,
    columns,
    has_accumulating_noise,
    is_physical,
    relevant_unknowns,
)
from massprop_drake.maths.estimation.offline.normal_equations import (
    HeldRows,
    NormalEquations,
    equations_about,
    sum_equations,
)
from massprop_drake.maths.estimation.offline.swings import can_swing
from massprop_drake.maths.estimation.offline.thrust_course import ThrustCourse, prepare_stretch, thrust_course
from massprop_drake.maths.linear_algebra import Array

_PASSES = 8
_SETTLED = 1e-2  # squared sigmas that a pass would still gain
_NEARLY = 100.0  # squared sigmas: a pass that would gain less is the last but one, as a rule


class FlightFit(NamedTuple):
    """Fit of the readings by the unknowns that are estimated.

    Attributes:
        at: estimate of all unknowns, shape (n,).
        normal: about it.
        settled: whether the passes have come to an end.
    """

    at: Array
    normal: NormalEquations
    settled: bool


class ScoreTest(NamedTuple):
    """A test of some unknowns.

    Attributes:
        statistic: chi-square distributed if they are what is stated.
        degrees: of freedom.
        size: estimate of each, shape (k,).
        least: smallest sum of squares that is left once they are explained.
    """

    statistic: float
    degrees: int
    size: Array
    least: float


def fit_flight(stretches: Sequence[Stretch], start: Array, model: FlightModel) -> FlightFit:
    """Fits all unknowns to a flight's readings by Gauss-Newton iterations; returns point and equations.

    What begins far from the truth may go farther with every pass: where they do not settle, the point of those gone
    through that leaves least unexplained is taken.

    Args:
        stretches: of the flight.
        start: where to begin, shape (n,).
    """
    alone = has_accumulating_noise(model)  # what gathers is in the rates that are read, and in no others
    fit = _iterate_fit(stretches, start, model, is_final=alone)
    return fit if alone or not fit.settled else _iterate_fit(stretches, fit.at, model._replace(followed=True))


def _iterate_fit(stretches: Sequence[Stretch], start: Array, model: FlightModel, *, is_final: bool = True) -> FlightFit:
    """Runs Gauss-Newton iterations until they settle; unknowns only tested are left out unless ``is_final``.

    Once they are near, the readings that count stay the same: else each pass may choose those that the next does not.
    """
    at = best = start.copy()
    least = np.inf
    free = np.flatnonzero(model.sigma > 0.0)
    sigma, lag, moving = model.sigma[free], columns(model).lag, columns(model).moving
    read = [prepare_stretch(stretch, model) for stretch in stretches]
    told: list[ThrustCourse] = []
    told_for, wanted, complete, near = at, relevant_unknowns(model), False, False
    held = list[HeldRows]()
    for number in range(_PASSES):
        complete = is_final and (complete or number == _PASSES - 1)
        if not told or (at[lag] != told_for[lag]).any():
            told, told_for = [thrust_course(one, at, model) for one in read], at
        held = held if near else [{} for _ in read]
        parts = [
            equations_about(at, course, model, None if complete else wanted, rows)
            for course, rows in zip(told, held, strict=True)
        ]
        total = sum_equations(parts, model)
        if total.per_reading < least:
            least, best = total.per_reading, at
        scaled = total.information[np.ix_(free, free)] * np.outer(sigma, sigma) + np.eye(free.shape[0])
        right = total.score[free] * sigma + (model.prior[free] - at[free]) / sigma
        step = np.linalg.solve(scaled, right)
        gain, sound = float(step @ right), bool(np.isfinite(step).all())
        if not sound:
            break
        if gain < _SETTLED and (complete or not is_final):
            return FlightFit(at, total, True)
        complete = gain < _NEARLY
        near = near or complete
        if gain < _SETTLED:
            continue  # it was the last one, but for the unknowns that are only put to the test
        move = np.zeros_like(at)
        move[free] = step * sigma
        while not (is_physical(at + move) and can_swing((at + move)[:N_PROPERTIES], (at + move)[moving], model.modes)):
            move *= 0.5  # modes that have more than all of the inertia run away
        at = at + move
    parts = [equations_about(best, thrust_course(one, best, model), model, None) for one in read]
    total = sum_equations(parts, model)
    return FlightFit(best, total, False)


class Reckoned(NamedTuple):
    """Unknowns that are estimated in tests of others, which all have them in common.

    Attributes:
        free: places of what is reckoned with, shape (f,).
        sigma: their 1-sigma, shape (f,).
        score: h with what is known before the flight taken for the origin, shape (n,).
        solved: (A + 1)^-1 of these, in units of their 1-sigma, times their information with every unknown, and their
            score, shape (f, n + 1).
    """

    free: NDArray[np.int_]
    sigma: Array
    score: Array
    solved: Array


def estimated_unknowns(fit: FlightFit, model: FlightModel, tested: NDArray[np.int_] | slice = slice(0)) -> Reckoned:
    """Solves for the estimated unknowns, tested ones left out, once for all score tests of other unknowns.

    Args:
        tested: places of those unknowns.
    """
    total, others = fit.normal, model.sigma > 0.0
    others[tested] = False
    free = np.flatnonzero(others)
    sigma = model.sigma[free]
    off = np.zeros_like(fit.at)
    off[free] = fit.at[free] - model.prior[free]
    off[tested] = fit.at[tested]
    vector = total.score + total.information @ off
    inner = total.information[np.ix_(free, free)] * np.outer(sigma, sigma) + np.eye(free.shape[0])
    right = np.column_stack((total.information[free], vector[free])) * sigma[:, None]
    return Reckoned(free, sigma, vector, np.asarray(np.linalg.solve(inner, right), dtype=np.float64))


def score_test(
    fit: FlightFit,
    indices: NDArray[np.int_],
    model: FlightModel,
    stated_std: float = 0.0,
    max_std: float = np.inf,
    estimated: Reckoned | None = None,
) -> ScoreTest:
    """Tests unknowns against their stated values; returns statistic, degrees of freedom, sizes and misfit.

    Args:
        indices: their places, in units that are alike, integers, shape (k,).
        model: see `FlightModel`; where they are reckoned with, they are no longer.
        stated_std: their 1-sigma; zero: that they are zero.
        max_std: largest 1-sigma of a combination of them that is tested.
        estimated: what is reckoned with at all, which it is that serves where they are not.
    """
    total, size = fit.normal, np.zeros(indices.shape[0])
    if estimated is None or (model.sigma[indices] > 0.0).any():
        estimated = estimated_unknowns(fit, model, indices)
    shown = total.information[indices, indices] != 0.0  # of others nothing is known
    there = indices[shown]
    cross = total.information[np.ix_(there, estimated.free)] * estimated.sigma
    information = total.information[np.ix_(there, there)] - cross @ estimated.solved[:, there]
    of_group = estimated.score[there] - cross @ estimated.solved[:, -1]
    if not (np.isfinite(information).all() and np.isfinite(of_group).all()):
        return ScoreTest(0.0, 0, size, total.misfit)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    known = values > max(1.0 / max_std**2, 1e-9 * float(np.max(np.abs(total.information[there, there]), initial=0.0)))
    if not known.any():
        return ScoreTest(0.0, 0, size, total.misfit)
    along = (vectors.T @ of_group)[known] / values[known]
    statistic = float(np.sum(along**2 / (1.0 / values[known] + stated_std**2)))
    gained = float(np.sum(along**2 * values[known]))
    size[shown] = vectors[:, known] @ along
    return ScoreTest(statistic, int(known.sum()), size, max(total.misfit - gained, 0.0))
