"""Review of a likely hypothesis: alternatives to its newest event, linearized about itself.

A screen beside its own filter, from the onset of that event on, with the forces of the event known to be what they were
before: first orders are those of hypotheses near it, and stay good as long as it explains its readings, however long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.alarms import Alarm, Rest
from massprop_drake.maths.estimation.faults.fault_events import Hypothesis, force_walk_sigmas
from massprop_drake.maths.estimation.faults.priors import Params
from massprop_drake.maths.estimation.faults.proposals import Birth, Origin, rank_proposals
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import (
    Kind,
    Runner,
    Score,
    cycle_score,
    failure_slot,
    prepare_cycle,
)
from massprop_drake.maths.estimation.joint.joint_cycle import step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.screen import Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link, linearize_cycle
from massprop_drake.maths.linear_algebra import Array

_NEAR = 10.0  # nats behind the likeliest within which a hypothesis explains its readings as well as others


class Review(NamedTuple):
    """Review in progress.

    Attributes:
        run: the hypothesis's filter, from the screen's first onset on.
        calm: log likelihood and misfit when the hypothesis was likely last, nats: from then on the first order alone
            says how much it does not explain, as of an alarm.
        drawn: age of the newest draw.
        rest: see `alarms.Alarm`.
    """

    run: Runner
    screen: Screen
    calm: tuple[float, float]
    drawn: int = -1
    rest: Rest | None = None


def is_reviewable(hypothesis: Hypothesis) -> bool:
    """Tests whether a hypothesis's newest event can be reviewed: a jet failure with constant forces."""
    return (
        hypothesis.origin is not None
        and hypothesis.run.cause.kind == Kind.JETS
        and hypothesis.run.age > 0
        and not hypothesis.walks.any()
    )


def begin_review(hypothesis: Hypothesis, params: JointParams) -> Review:
    """Begins the test of alternatives to a hypothesis's newest event, at the first onset of its origin."""
    origin: Origin = hypothesis.origin
    run = hypothesis.run
    state, first = origin.states[0], origin.onsets[0]
    screen = screens.begin_screen((state, first), origin.onsets, origin.gaps, origin.read, params)
    return Review(
        Runner(run.cause, run.onset, run.kicks, first, state, origin.scores[0]),
        screen,
        (origin.scores[0].likelihood, 0.0),
    )


def advance_review(
    review: Review, hypothesis: Hypothesis, sample: JointSample, interval: Link, params: JointParams
) -> Review:
    """Advances the test of alternatives to a hypothesis's newest event by one sample.

    Raises:
        NotPositiveDefiniteError: see `joint_cycle.step`.
    """
    run = review.run
    before, likelihood = prepare_cycle(
        run, sample, interval, force_walk_sigmas(hypothesis, interval.duration_s), 0.0, params
    )
    before = before._replace(
        slot_on_top=np.where(
            before.slot_jet == hypothesis.run.state.slot_jet, hypothesis.run.state.slot_on_top, before.slot_on_top
        )
    )
    after, report = step(before, sample, params)
    score = run.score.plus(Score(likelihood, 0.0, 0.0)).plus(cycle_score(report))
    screen = screens.advance_screen(review.screen, linearize_cycle(before, report, sample, params), params)
    return review._replace(run=run._replace(cycle=run.cycle + 1, state=after, score=score), screen=screen)


def is_force_significant(review: Review, hypothesis: Hypothesis, params: JointParams) -> bool:
    """Tests whether the forces of the newest event differ significantly from the forces before it.

    Until then its impulses in the first two intervals explain all readings, and those of any other jet as well.
    """
    _, posterior = _event_force_density(review, hypothesis, params)
    return posterior < -_NEAR


def draw_alternatives(
    review: Review, hypothesis: Hypothesis, hypotheses: Sequence[Hypothesis], params: Params
) -> tuple[Review, list[Birth], Rest | None]:
    """Proposes alternatives to the newest event; returns review, proposals, and summed weight of those left out."""
    origin: Origin = hypothesis.origin
    if hypothesis.weight > max(other.weight for other in hypotheses) - _NEAR:
        review = review._replace(calm=(review.run.score.likelihood, review.screen.misfit))
    of_forces, posterior = _event_force_density(review, hypothesis, params.joint)
    screen = screens.condition_screen(review.screen, *of_forces)
    level = review.calm[0] - 0.5 * (review.screen.misfit - review.calm[1]) + posterior
    alarm = Alarm(origin.cycle, origin.states, origin.scores, screen, origin.read)
    births, rest = rank_proposals(origin.parent, alarm, level + origin.parent.prior, hypotheses, params, error=0.0)
    return review, births, rest


def _event_force_density(
    review: Review, hypothesis: Hypothesis, params: JointParams
) -> tuple[tuple[np.ndarray, Array, Array], float]:
    """Returns state rows, deviation and covariance of the newest event's forces, and a log density ratio, nats.

    By the ratio of Savage and Dickey: posterior over prior density of the forces where they were, nats.
    """
    state, cause = review.run.state, hypothesis.run.cause
    slots = np.array([failure_slot(state, *way) for way in zip(cause.jets, cause.signs, strict=True)])
    rows = params.places.force + slots
    before: Array = np.nan_to_num(hypothesis.opened_at[slots])
    away, half = before - state.mean[rows], state.root[rows]
    covariance = half @ half.T
    _, volume = np.linalg.slogdet(covariance)
    posterior = -0.5 * float(away @ np.linalg.solve(covariance, away)) - 0.5 * float(volume)
    prior = -sum(math.log(float(params.thrusts[jet])) for jet in cause.jets)
    return (rows, away, covariance), posterior - prior
