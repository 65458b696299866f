r"""Failures of jets while the start has not converged, as hypotheses with weights.

A start knows too little of the vehicle to judge a failure from a snapshot: the filter learns what a failed jet does as
what the vehicle is like. So samples are kept. Once something contradicts the start, all are gone over anew under each
hypothesis, from the state before the first with what an increment adds:

    screening   ranks jets and onsets to first order, see `screening`; once more with onsets about the likeliest
    passes      of the hypothesis that nothing has failed, of each jet near the likeliest, and at last of those that
                something acts which nobody stated, see `passes`

Screenings begin at the nominal vehicle, or where passes end that explain all without a failure. They are repeated about
the end of the likeliest passes, until they propose nobody new. The first order only proposes. Hypotheses near the
likeliest are then brought to the newest sample.

Where none of them explains what came since, something has happened meanwhile, and all are gone over anew at once. Where
none explains what the search began with, more samples are waited for.

Samples are kept anew from when on rotation is known: what they show is judged from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults import passes
from massprop_drake.maths.estimation.faults import screening as screenings
from massprop_drake.maths.estimation.faults.passes import PassFit
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.estimation.faults.screening import Screening
from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.guard import reset_guard, update_guard
from massprop_drake.maths.estimation.joint.hypotheses import STIRS, Cause, Kind, Score, stronger_disturbances
from massprop_drake.maths.estimation.joint.joint_cycle import Report, incremented_root
from massprop_drake.maths.estimation.joint.joint_sample import JointSample, has_impulse
from massprop_drake.maths.estimation.joint.lag_prior import choose_lag_priors
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.start import LONGEST, STEPS, Kept
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

_QUIET_S = 2.0  # for which samples are kept while nothing acts
_WAIT_S = 1.0  # from a contradiction to its search: less tells few jets apart
_SCREENING = 3  # steps of a pass in the time of one of a screening
_ROUNDS = 3  # of screenings at most: compute budget
_JETS = 8  # that have passes after a screening: compute budget
_NEAR = 30.0  # nats within which hypotheses are told
_FAR = 100.0  # nats behind at the same sample, at which passes are given up
_FIRST_ORDER = 0.2  # of a lead, by which the first order may be off at the nominal vehicle
_AT_THE_END = 1e-3  # the same about the end of passes that explain the readings
_MISFIT = 10.0  # standard deviations of chi-square at which a hypothesis does not explain the readings, as in a start
_NOTHING = Contender(Cause(Kind.NOTHING), 0, 0.0)


class StartSearch(NamedTuple):
    """Kept samples of a start, and the search over them. Never changed; a cycle makes a new one.

    Attributes:
        under_way: whether anything is kept.
        entry: state before the first kept sample; once contradicted, with what an increment adds.
        kept: samples since.
        acted: whether a jet was told to fire in any of them.
        contradicted: whether something has contradicted the start.
        due_s: time at which the next search begins, s.
        until: number of samples that the search goes over; 0: none is under way.
        rounds: screenings begun, but for those with finer onsets.
        screening: see `Screening`; None: it has ended.
        tried: causes, and causes with their onsets, that have had passes.
        final: whether the search goes over all samples up to the newest.
        rotation_known: whether what jets do to the rates was known before the first kept sample.
    """

    under_way: bool = True
    entry: JointState | None = None
    kept: tuple[Kept, ...] = ()
    acted: bool = False
    contradicted: bool = False
    due_s: float = math.inf
    until: int = 0
    rounds: int = 0
    screening: Screening | None = None
    fits: tuple[PassFit, ...] = ()
    tried: frozenset[object] = frozenset()
    final: bool = False
    rotation_known: bool = False

    @property
    def beginning(self) -> JointState:
        """Filter state before the first kept sample, which must exist."""
        assert self.entry is not None, "something is kept"
        return self.entry

    @property
    def horizon(self) -> int:
        """Number of kept samples that Gauss-Newton passes filter."""
        return len(self.kept) if self.final else self.until

    def is_done(self, fit: PassFit) -> bool:
        """Tests whether a fit's passes have ended, with all samples filtered."""
        return fit.arrived and fit.done == self.horizon


class SearchOutcome(NamedTuple):
    """Hypothesis about the start.

    Attributes:
        state: after the newest sample.
        cause: one jet, or nothing: the start was stated too well.
        onset_s: time of the last sample before the failure, s.
        since_s: time of the state from which the kept samples are gone over, s.
        score: of all kept samples, from the same entry for all.
        log_prior: without what the force is worth (`priors.force_correction`), nats.
    """

    state: JointState
    cause: Cause
    onset_s: float
    since_s: float
    score: Score
    log_prior: float


BEGUN, OVER = StartSearch(), StartSearch(under_way=False)


def advance_search(
    search: StartSearch, state: JointState, report: Report, sample: JointSample, priors: Priors, params: JointParams
) -> tuple[StartSearch, tuple[SearchOutcome, ...]]:
    """Keeps a sample of the initialization, searches for faults once readings contradict it; returns outcomes at end.

    Returns:
        The search, and once passes have gone over all samples, the hypotheses within 30 nats of the likeliest, which
        comes first; keeping then begins anew.
    """
    if not search.under_way or not state.started or params.places.n_force == 0:
        return search, ()
    if search.until == 0 and len(search.kept) >= LONGEST * params.rates.steps:
        return OVER, ()
    if report.rotation_known and not (search.rotation_known or search.contradicted):
        search = BEGUN._replace(rotation_known=True)
    search = _add_sample(search, state, Kept(sample, report.course is None), params)
    if not search.contradicted and (report.contradicted or report.incremented):
        wide = compress_root(incremented_root(search.beginning.root, params), params.places.thrust)
        entry = search.beginning._replace(root=wide)
        search = search._replace(entry=entry, contradicted=True, due_s=sample.time_s + _WAIT_S)
    if search.until == 0:
        if sample.time_s < search.due_s:
            return search, ()
        search = _begin_search(search, priors, params)
    try:
        search = _run_search_steps(search, priors, params)
    except (NotPositiveDefiniteError, np.linalg.LinAlgError):
        search = _postpone_search(search)
    if not (search.final and all(map(search.is_done, search.fits))):
        return search, ()
    near = _fits_near_likeliest(search, priors, params)
    if not near or near[0].score.misfit >= _MISFIT:
        return _restart_search(search, sample.time_s), ()
    return BEGUN, tuple(_make_outcome(each, search, params) for each in near)


def _add_sample(search: StartSearch, state: JointState, kept_sample: Kept, params: JointParams) -> StartSearch:
    """Adds a sample to those kept; drops older ones while no impulse acts and nothing contradicts the filter."""
    entry, kept = (state if search.entry is None else search.entry), (*search.kept, kept_sample)
    acted = search.acted or has_impulse(kept_sample.sample, params)
    if not (acted or search.contradicted) and kept_sample.sample.time_s - entry.time_s > _QUIET_S:
        entry, kept = state, (kept_sample,)
    return search._replace(entry=entry, kept=kept, acted=acted)


def _begin_search(search: StartSearch, priors: Priors, params: JointParams) -> StartSearch:
    """Begins the search over the kept samples, with a fit of the hypothesis that no jet has failed."""
    entry = search.beginning
    about = passes.linearization_point(entry, entry, params)
    nothing = passes.begin_fit(_NOTHING, math.log(priors.start), about, entry, params)
    return search._replace(entry=entry, until=len(search.kept), rounds=0, screening=None, fits=(nothing,))


def _begin_disturbance_fits(search: StartSearch, priors: Priors, params: JointParams) -> tuple[PassFit, ...]:
    """Makes a fit for each level of a slow disturbance, not stated, that acts since before the first kept sample.

    They have one pass, about the end of the likeliest; where that moves them, another to the newest sample.
    """
    near, entry = _fits_near_likeliest(search, priors, params), search.beginning
    about = passes.linearization_point(near[0].state if near else entry, entry, params)
    prior = math.log(priors.disturbed / len(STIRS))
    causes = (Cause(Kind.WANDER, component=stir) for stir in stronger_disturbances(entry, params) if stir % 4 == 1)
    fits = (passes.begin_fit(_NOTHING._replace(cause=one), prior, about, entry, params) for one in causes)
    return tuple(one._replace(passes=passes.MOST) for one in fits)


def _postpone_search(search: StartSearch) -> StartSearch:
    """Postpones a search that has found nothing until the kept samples span twice the time."""
    return _restart_search(search, 2.0 * search.kept[-1].sample.time_s - search.beginning.time_s)


def _restart_search(search: StartSearch, due_s: float) -> StartSearch:
    """Makes a new search over the same kept samples, due at some time, s."""
    return StartSearch(True, search.entry, search.kept, search.acted, True, due_s)


def _run_search_steps(search: StartSearch, priors: Priors, params: JointParams) -> StartSearch:
    """Advances the search for faults in the initialization by the filter steps that one cycle may spend."""
    left = STEPS
    while left > 0 and search.until > 0:
        screening = search.screening
        if screening is not None and screening.screen.cycle < search.until:
            left, kept = left - _SCREENING, search.kept[screening.screen.cycle]
            search = search._replace(screening=screenings.step_screening(screening, kept, params))
        elif screening is not None:
            finer = screenings.refine_onsets(screening, search.kept[: search.until], params)
            search = search._replace(screening=finer) if finer else _begin_jet_passes(search, screening, priors, params)
        elif not all(map(search.is_done, search.fits)):
            ahead = (each for each in search.fits if not search.is_done(each))
            # those that have arrived come first, then first passes, then the likeliest
            first = min(ahead, key=lambda each: (not each.arrived, each.passes > 1, -each.reached))
            search, left = _step_one_fit(search, first, params), left - 1
        elif not search.final:
            search = _begin_next_round(search, priors, params)
        elif any(passes.has_moved(each, params) for each in search.fits):
            again = (passes.begin_last_pass(each, search.beginning, params) for each in search.fits)
            search = search._replace(fits=tuple(again))
        else:
            break
    return search


def _begin_jet_passes(search: StartSearch, screening: Screening, priors: Priors, params: JointParams) -> StartSearch:
    """Adds fits of jets that a first-order test finds likely; if none is new after round 1, extends all to newest."""
    found, entry, about = screenings.rank_jets(screening, params), search.beginning, screening.about
    told = _fits_near_likeliest(_without_disturbances(search), priors, params)
    sure = search.rounds > 1 and bool(told) and told[0].score.misfit < _MISFIT
    best = max((each.lead for each in found), default=0.0)
    reach = max(_NEAR, (_AT_THE_END if sure else _FIRST_ORDER) * best)
    near = [each for each in found if each.lead > best - reach and _tried_key(each, sure) not in search.tried][:_JETS]
    with_priors = [(each, screenings.log_prior(each, screening, search.kept, priors)) for each in near]
    fits = tuple(passes.begin_fit(each, prior, about, entry, params) for each, prior in with_priors)
    tried = search.tried | {_tried_key(each, known) for each in near for known in (False, True)}
    final = not fits and search.rounds > 1
    search = search._replace(screening=None, fits=search.fits + fits, tried=tried)
    return _extend_to_newest(search, priors, params) if final else search


def _tried_key(proposal: Contender, cause_only: bool) -> object:
    """Returns the key that marks a jet failure as already fitted: its cause and onset, or the cause alone."""
    return proposal.cause.key if cause_only else (proposal.cause.key, proposal.onset)


def _step_one_fit(search: StartSearch, fit: PassFit, params: JointParams) -> StartSearch:
    """Returns the search with a fit advanced by one filter step, or removed if it is far less likely."""
    after = passes.step_fit(fit, search.kept[fit.done], params)
    if after is not None and after.done == search.horizon and not after.arrived:
        after = passes.end_pass(after, search.beginning, params)
    told = () if search.final else _without_disturbances(search).fits
    explain = [each for each in told if each.arrived and each.score.misfit < _MISFIT]
    best = max(explain, key=lambda each: each.score.likelihood, default=None)
    if after is not None and best is not None:
        least = best.scores[min(after.done, best.done)].likelihood - _FAR
        after = after if after.score.likelihood >= least else None
    fits = (after if each is fit else each for each in search.fits)
    return search._replace(fits=tuple(each for each in fits if each is not None))


def _begin_next_round(search: StartSearch, priors: Priors, params: JointParams) -> StartSearch:
    """Begins another first-order test about the likeliest fit, or extends all fits to the newest sample.

    Where nothing that has failed explains the readings, screenings begin at the end of its passes.
    """
    if Kind.WANDER in search.tried or (search.rounds > 0 and (not search.fits or search.rounds >= _ROUNDS)):
        return _extend_to_newest(search, priors, params)
    entry, kept = search.beginning, search.kept[: search.until]
    near = _fits_near_likeliest(_without_disturbances(search), priors, params)
    around, rounds, end = None, search.rounds + 1, near[0].state if near else entry
    if search.rounds > 0:
        around = (near[0].contender.onset, 1)
    elif near and near[0].score.misfit < _MISFIT:
        rounds = 2
    else:
        end = entry
    about, begins = passes.linearization_point(end, entry, params), choose_lag_priors(entry, end, params)
    screening = screenings.begin_screening(begins, about, kept, around, params)
    return search._replace(rounds=rounds, screening=screening)


def _extend_to_newest(search: StartSearch, priors: Priors, params: JointParams) -> StartSearch:
    """Adds fits of unstated disturbances; if tried already, extends likely fits to the newest sample, or postpones."""
    if Kind.WANDER not in search.tried:
        fits = search.fits + _begin_disturbance_fits(search, priors, params)
        return search._replace(fits=fits, tried=search.tried | {Kind.WANDER})
    near = _fits_near_likeliest(search, priors, params)
    if not near or near[0].score.misfit >= _MISFIT:
        return _postpone_search(search)
    return search._replace(fits=tuple(each._replace(passes=1) for each in near), final=True)


def _without_disturbances(search: StartSearch) -> StartSearch:
    """Returns the search with fits of unstated disturbances removed, as they explain any other event too."""
    return search._replace(fits=tuple(each for each in search.fits if each.contender.cause.kind != Kind.WANDER))


def _fits_near_likeliest(search: StartSearch, priors: Priors, params: JointParams) -> tuple[PassFit, ...]:
    """Returns the likeliest fit of each cause with a log weight near the largest, likeliest first."""
    weighed = [(passes.log_weight(each, priors, params), each) for each in search.fits]
    weighed.sort(key=lambda pair: -pair[0])
    near: dict[object, PassFit] = {}
    for weight, each in weighed:
        if weight >= weighed[0][0] - _NEAR:
            near.setdefault(each.contender.cause.key, each)
    return tuple(near.values())


def _make_outcome(fit: PassFit, search: StartSearch, params: JointParams) -> SearchOutcome:
    """Makes the search's outcome from a fit: filter state, cause, onset, score and log prior."""
    onset, state = fit.contender.onset, update_guard(fit.state, has_impulse(search.kept[-1].sample, params), params)
    since_s = search.beginning.time_s
    onset_s = search.kept[onset - 1].sample.time_s if onset > 0 else since_s
    state = state if state.guarded else reset_guard(state)
    return SearchOutcome(state, fit.contender.cause, onset_s, since_s, fit.score, fit.log_prior)
