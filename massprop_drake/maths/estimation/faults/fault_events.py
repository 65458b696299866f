"""Hypotheses about faults: each a filter state, a log weight and a list of fault events."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.priors import Params, force_correction, log_feasible_force
from massprop_drake.maths.estimation.joint.bank import OLDEST
from massprop_drake.maths.estimation.joint.guard import reset_guard
from massprop_drake.maths.estimation.joint.hypotheses import (
    NO_SCORE,
    Cause,
    Kind,
    Runner,
    Score,
    add_force_noise,
    add_push_impulse,
    extra_impulse_sigmas,
    run_hypothesis_cycle,
)
from massprop_drake.maths.estimation.joint.joint_cycle import restart
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lag_prior import log_mixture
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.sensitivity import Link
from massprop_drake.maths.linear_algebra import Array

NOTHING = Cause(Kind.NOTHING)
ANEW = 1e6  # walk of a force that is another at every interval, in full thrusts a second
Way = tuple[int, int]  # a jet, and 1: it gives too much, or -1: too little
Part = tuple[Any, ...]  # of what a hypothesis has happen: a way, or a kind and a component, and the how manieth time


class Event(NamedTuple):
    """Fault event: its mode, component and onset.

    Attributes:
        onset_s: time of the sample before it.
        score: sum over the readings until then.
    """

    cause: Cause
    onset_s: float
    score: Score


class Hypothesis(NamedTuple):
    """History of fault events, with the filter that takes it for true.

    Attributes:
        run: filter, with the newest event and the log likelihood of all readings since the common origin.
        events: oldest first.
        prior: log prior of the events, nats.
        opened_at: of each slot the force before it changed last, NaN: it is new; lbf or N, shape (n_force,).
        walks: of each slot the 1-sigma by which its force walks, in full thrusts a second, or `ANEW`, shape (n_force,).
        decided: jets that give too much of which it is assumed whether that comes on top of the command.
        push: see `joint.hypotheses.pushed`.
        earlier: state before the newest jump of the mass properties; None: there was none.
        jumped: by what share of the mass that was expected to be, see `jump_sigma`; zero: there was none.
        watch: see `alarms.Watch`; None: it is not watched.
        root_until_s: time until which it is kept, whatever its weight.
        origin: see `proposals.Origin`; None: of the tree's beginning.
        review: see `review.Review`; None: it is not reviewed.
        weight: see `update_weight`.
        before: that before the newest sample.
        trail: log likelihood after each of its newest cycles.
    """

    run: Runner
    events: tuple[Event, ...]
    prior: float
    opened_at: Array
    walks: Array
    decided: frozenset[int] = frozenset()
    push: float = 0.0
    earlier: JointState | None = None
    jumped: float = 0.0
    watch: Any = None
    origin: Any = None
    review: Any = None
    root_until_s: float = -math.inf
    weight: float = 0.0
    before: float = -math.inf
    trail: tuple[float, ...] = ()

    @property
    def alarm(self) -> Any:
        """Alarm that its readings have raised, see `alarms.Alarm`; None: there is none."""
        return None if self.watch is None else self.watch.alarm

    @property
    def parts(self) -> tuple[Part, ...]:
        """Events as keys (jet, sign, count) or (kind, component, count), where count is of earlier equal events."""
        found: list[Part] = []
        for event in self.events:
            cause = event.cause
            ways: list[Part] = [(way,) for way in sorted(cause.failures)]
            for one in ways if cause.kind == Kind.JETS else [cause.part]:
                found.append((*one, sum(part[:-1] == one for part in found)))
        return tuple(found)

    @property
    def key(self) -> tuple[Any, ...]:
        """Key that equal hypotheses share: their events, and their present forces, push, disturbance and jump."""
        state = self.run.state
        slots = zip(state.slot_jet, state.slot_sign, state.slot_on_top, self.walks, strict=True)
        forces = frozenset((int(jet), int(sign), int(on_top), walk) for jet, sign, on_top, walk in slots if jet >= 0)
        jumped = 0.0 if state.guarded else self.jumped
        return frozenset(self.parts), forces, self.push, (state.stir, state.stir_s), jumped

    @property
    def ways(self) -> frozenset[Way]:
        """Jet failures of the history, as pairs of jet index and sign: 1 too much thrust, -1 too little."""
        return frozenset(way for event in self.events for way in event.cause.failures)


def no_fault_hypothesis(state: JointState, cycle: int, params: JointParams) -> Hypothesis:
    """Makes the hypothesis that no fault has happened, from a filter state."""
    n = params.places.n_force
    return Hypothesis(Runner(NOTHING, cycle, (), cycle, state, NO_SCORE), (), 0.0, np.full(n, np.nan), np.zeros(n))


def slot_force(state: JointState, slot: int, params: JointParams) -> tuple[float, float]:
    """Returns estimate and 1-sigma of the failed jet's force in a slot of the filter state, lbf or N."""
    row = params.places.force + slot
    return float(state.mean[row]), float(np.sqrt(np.sum(state.root[row] ** 2)))


def update_weight(hypothesis: Hypothesis, params: Params) -> Hypothesis:
    """Returns a hypothesis with its log weight updated: likelihood, priors of events and lags, force correction."""
    state = hypothesis.run.state
    total = hypothesis.run.score.likelihood + hypothesis.prior + log_mixture(state, params.joint)
    if hypothesis.run.age > 0:
        for slot in np.flatnonzero((state.slot_jet >= 0) & (hypothesis.walks != ANEW)).tolist():
            force, sigma = slot_force(state, slot, params.joint)
            thrust, about = float(params.joint.thrusts[int(state.slot_jet[slot])]), float(hypothesis.opened_at[slot])
            if hypothesis.walks[slot] > 0.0:
                total += log_feasible_force(force, sigma, thrust)
                continue
            before, missing = None if math.isnan(about) else about, bool(state.slot_sign[slot] < 0.0)
            total += force_correction(force, sigma, thrust, params.priors, is_loss=missing, old_force=before)
    return hypothesis._replace(weight=total)


def needs_special_cycle(hypothesis: Hypothesis, duration_s: float, params: JointParams) -> bool:
    """Tests whether the next filter cycle must add an impulse near a failure's onset, or leave out a reading."""
    run = hypothesis.run
    return run.lying or (run.cause.kind == Kind.JETS and extra_impulse_sigmas(run, duration_s, params) is not None)


def add_interval_noise(hypothesis: Hypothesis, interval: Link, params: JointParams) -> JointState:
    """Returns the filter state with noise of walking forces and unknown pushes over the next interval added."""
    state = add_force_noise(hypothesis.run.state, force_walk_sigmas(hypothesis, interval.duration_s), params)
    return add_push_impulse(state, hypothesis.push, interval, params)


def force_walk_sigmas(hypothesis: Hypothesis, duration_s: float) -> Array:
    """Computes 1-sigmas of jet forces' random walks in an interval, in full thrusts, shape (n_force,)."""
    walks: Array = np.minimum(hypothesis.walks * duration_s, 1.0)
    return walks


def record_cycle(hypothesis: Hypothesis, runner: Runner, params: JointParams) -> Hypothesis:
    """Returns a hypothesis with its filter replaced, and the log likelihood so far appended to its trail."""
    kept = OLDEST * params.rates.steps
    return hypothesis._replace(run=runner, trail=(*hypothesis.trail, runner.score.likelihood)[-kept:])


def log_weight_deficit(hypothesis: Hypothesis, reference: Hypothesis) -> float:
    """Computes how far a hypothesis's log weight is below another's at the same cycle, nats; 0: not known."""
    since = reference.run.cycle - hypothesis.run.cycle
    if hypothesis.run.age <= 0 or not 0 <= since < len(reference.trail):
        return 0.0
    return reference.trail[-1 - since] + reference.prior - hypothesis.run.score.likelihood - hypothesis.prior


def advance_hypothesis(
    hypothesis: Hypothesis, sample: JointSample, interval: Link, params: JointParams, *, starting: bool
) -> Hypothesis:
    """Advances a hypothesis's filter by one sample, and records its log likelihood.

    Args:
        starting: whether the filter's start is under way: hypotheses that are compared converge together.

    Raises:
        NotPositiveDefiniteError: see `joint_cycle.step`.
    """
    run = run_hypothesis_cycle(
        hypothesis.run, sample, interval, force_walk_sigmas(hypothesis, interval.duration_s), hypothesis.push, params
    )
    return record_cycle(hypothesis, run._replace(state=reset_guard(run.state)) if starting else run, params)


def split_on_command(hypothesis: Hypothesis, sample: JointSample) -> tuple[Hypothesis, ...]:
    """Splits a hypothesis when a jet with excess thrust is first commanded: its force adds to thrust or replaces it."""
    state = hypothesis.run.state
    fires = np.flatnonzero((sample.commands > 0.0).any(axis=0)).tolist()
    for slot in np.flatnonzero((state.slot_jet >= 0) & (state.slot_sign > 0.0)).tolist():
        jet = int(state.slot_jet[slot])
        if jet in hypothesis.decided or jet not in fires:
            continue
        first = hypothesis._replace(
            prior=hypothesis.prior - math.log(2.0), decided=hypothesis.decided | {jet}, watch=None
        )
        other = state.slot_on_top.copy()
        other[slot] = 1.0 - other[slot]
        twin = first._replace(
            run=first.run._replace(state=state._replace(slot_on_top=other)), root_until_s=-math.inf, review=None
        )
        return (first._replace(watch=hypothesis.watch), twin)
    return (hypothesis,)


def restart_hypothesis(hypothesis: Hypothesis, sample: JointSample, cycle: int, params: JointParams) -> Hypothesis:
    """Returns a hypothesis with its filter restarted after a gap, and its fault tests and their origin dropped."""
    after, _ = restart(hypothesis.run.state, sample, params)
    recorded = record_cycle(hypothesis, hypothesis.run._replace(state=after, cycle=cycle), params)
    return recorded._replace(watch=None, origin=None, review=None)
