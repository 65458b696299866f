r"""Gauss-Newton iterations over a start under one hypothesis about a failed jet.

A pass is a filter over the kept samples, linearized about x*, with the jet's force opened at its onset. Where it ends
is the next x*, until the end stays. The log likelihood of a hypothesis is that of its last pass.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.priors import Priors, force_correction
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.crossing import update_by_crossings
from massprop_drake.maths.estimation.joint.hypotheses import (
    NO_SCORE,
    Cause,
    Kind,
    Score,
    add_failure_impulses,
    apply_cause,
    failure_slot,
)
from massprop_drake.maths.estimation.joint.joint_cycle import restart
from massprop_drake.maths.estimation.joint.lag_prior import choose_lag_priors, log_mixture, switch_lag_priors
from massprop_drake.maths.estimation.joint.layout import MASS, N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.relinearization import run_relinearized
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.sensitivity import collect_cycle_terms, linearize_terms
from massprop_drake.maths.estimation.joint.start import Kept, is_pass_converged
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

MOST = 6  # passes, three as a rule: compute budget
_LATE = 2  # passes to the newest sample, during each of which more come: compute budget
_CLOSE = 3.0  # sigmas by which samples that came since may move the end of the last pass


class PassFit(NamedTuple):
    """Gauss-Newton iteration of one hypothesis over the start.

    Attributes:
        contender: cause, onset as the number of kept samples before it, and what the first order says of it.
        log_prior: without what its force is worth, nats.
        about: x*, shape (size,).
        state: after the samples that the present pass has gone over.
        scores: after each of these, nothing first.
        earlier: scores of the pass before.
        passes: begun.
        arrived: whether a pass has ended where it began.
    """

    contender: Contender
    log_prior: float
    about: Array
    state: JointState
    scores: tuple[Score, ...] = (NO_SCORE,)
    earlier: tuple[Score, ...] = ()
    passes: int = 1
    arrived: bool = False

    @property
    def done(self) -> int:
        """Number of kept samples that the present Gauss-Newton pass has filtered."""
        return len(self.scores) - 1

    @property
    def score(self) -> Score:
        """Score (log likelihood, NIS) of the samples that the present pass has filtered."""
        return self.scores[-1]

    @property
    def reached(self) -> float:
        """Log likelihood at the end of the previous pass, nats; -inf: there is none."""
        return self.earlier[-1].likelihood if self.earlier else -math.inf


def begin_fit(
    proposal: Contender, log_prior: float, linearization_point: Array, entry_state: JointState, params: JointParams
) -> PassFit:
    """Begins a Gauss-Newton fit of a fault hypothesis to the initialization's samples, linearized at a given estimate.

    Args:
        linearization_point: x*, of which the proposal replaces the failed jets' forces, shape (size,).
        entry_state: state before the first kept sample.
    """
    linearization_point, cause = linearization_point.copy(), proposal.cause
    for jet, sign, force in zip(cause.jets, cause.signs, proposal.force, strict=True):
        linearization_point[params.places.force + failure_slot(entry_state, jet, sign)] = min(
            max(force, 0.0), screens.largest_jet_forces(params)[jet]
        )
    return PassFit(proposal, log_prior, linearization_point, entry_state)


def begin_pass(fit: PassFit, entry_state: JointState, params: JointParams) -> PassFit:
    """Returns a fit with its next Gauss-Newton pass begun, linearized about the estimate at the end of the last."""
    contender = fit.contender._replace(cause=_cause_by_force(fit, params), force=_failed_jet_forces(fit, params)[0])
    begins = choose_lag_priors(entry_state, fit.state, params)
    again = begin_fit(contender, fit.log_prior, linearization_point(fit.state, entry_state, params), begins, params)
    return again._replace(earlier=fit.scores, passes=fit.passes + 1)


def linearization_point(state: JointState, entry_state: JointState, params: JointParams) -> Array:
    """Returns the next linearization point: a state's estimate, but forces of failed jets by `entry_state`, (size,).

    Mass properties that no body has are replaced by those of the nominal vehicle.
    """
    about = state.mean.copy()
    if not (about[[0, 1, 2, MASS]] > 0.0).all():
        about[:N_PROPERTIES] = params.nominal
    forces = slice(params.places.force, params.places.force + params.places.n_force)
    about[forces] = entry_state.mean[forces]
    return about


def step_fit(fit: PassFit, kept_sample: Kept, params: JointParams) -> PassFit | None:
    """Filters the next kept sample in a Gauss-Newton pass; returns the fit, or None if the filter diverged.

    In its first two intervals a jet may give an impulse besides, since its onset lies within one.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            state, score = _filter_sample(fit, kept_sample, params)
        except (NotPositiveDefiniteError, np.linalg.LinAlgError):
            return None
    if not (np.isfinite(state.mean).all() and np.isfinite(state.root).all()):
        return None
    return fit._replace(state=state, scores=(*fit.scores, score))


def _filter_sample(fit: PassFit, kept_sample: Kept, params: JointParams) -> tuple[JointState, Score]:
    """Filters the next kept sample, linearized about x*; returns the filter state after it and the total score."""
    state, score, about, sample = fit.state, fit.score, fit.about, kept_sample.sample
    cause, kicks, age = fit.contender.cause, fit.contender.kicks, fit.done - fit.contender.onset
    if cause.kind == Kind.WANDER and age == 0:
        state = apply_cause(state, cause, params)
    if cause.jets and (age == 0 or 0 < age < len(kicks)):
        state, crossing = update_by_crossings(state, about[:N_PROPERTIES], sample, params.floors, params)
        score = score.plus(Score(crossing.log_likelihood, 0.0, 0.0))
        state = apply_cause(state, cause, params) if age == 0 else state
        if age < len(kicks) and not kept_sample.anew:
            _, course, _ = run_relinearized(state, sample, about, params)
            over = linearize_terms(collect_cycle_terms(about, course, sample), params)
            state = add_failure_impulses(state, cause, np.array(kicks[age]), over, params)
    if kept_sample.anew:
        return restart(state, sample, params)[0], score
    state, course, of_gyros = run_relinearized(state, sample, about, params)
    state, likelier = switch_lag_priors(state, params)
    return state, score.plus(Score(course.log_likelihood + likelier, course.nis, course.degrees, *of_gyros))


def end_pass(fit: PassFit, entry_state: JointState, params: JointParams) -> PassFit:
    """Ends a Gauss-Newton pass over all samples: returns the fit marked as ended, or with another pass begun."""
    wanders = fit.passes > 2 and fit.scores[len(fit.earlier) - 1].likelihood < fit.reached
    stays = is_pass_converged(fit.state, fit.about, params.places)
    if wanders or fit.passes >= MOST or (stays and _cause_by_force(fit, params) == fit.contender.cause):
        return fit._replace(arrived=True)
    return begin_pass(fit, entry_state, params)


def has_moved(fit: PassFit, params: JointParams) -> bool:
    """Tests whether newer samples have moved the estimate off its linearization point, and a pass more is allowed."""
    return fit.passes < _LATE and not is_pass_converged(fit.state, fit.about, params.places, _CLOSE)


def begin_last_pass(fit: PassFit, entry_state: JointState, params: JointParams) -> PassFit:
    """Begins a fit's last pass if newer samples have moved its estimate; else returns the fit unchanged."""
    return begin_pass(fit, entry_state, params)._replace(arrived=True) if has_moved(fit, params) else fit


def _cause_by_force(fit: PassFit, params: JointParams) -> Cause:
    """Returns the fit's cause, with each jet of excess thrust set to leaking or stuck on by its estimated force."""
    cause = fit.contender.cause
    shares = np.array(_failed_jet_forces(fit, params)[0]) / params.thrusts[list(cause.jets)]
    on_top = (int(sign > 0 and share < screens.LEAK) for sign, share in zip(cause.signs, shares.tolist(), strict=True))
    return cause._replace(on_top=tuple(on_top))


def _failed_jet_forces(fit: PassFit, params: JointParams) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns estimates and 1-sigmas of the failed jets' forces, lbf or N; empty without a failed jet."""
    cause = fit.contender.cause
    rows = [params.places.force + failure_slot(fit.state, *way) for way in zip(cause.jets, cause.signs, strict=True)]
    mean, root = fit.state.mean[rows], fit.state.root[rows]
    return tuple(mean.tolist()), tuple(np.sqrt(np.sum(root**2, axis=1)).tolist())


def log_weight(fit: PassFit, priors: Priors, params: JointParams) -> float:
    """Computes a fit's log weight: likelihood, prior, and corrections for lags and failed jets' forces, nats."""
    cause, forces = fit.contender.cause, zip(*_failed_jet_forces(fit, params), strict=True)
    return (
        fit.score.likelihood
        + fit.log_prior
        + log_mixture(fit.state, params)
        + sum(
            force_correction(force, sigma, float(params.thrusts[jet]), priors, is_loss=sign < 0)
            for jet, sign, (force, sigma) in zip(cause.jets, cause.signs, forces, strict=True)
        )
    )
