r"""A jet that fails before a start has converged: the start, gone over again under each hypothesis.

A start knows too little of the vehicle for a race from a snapshot (`race`): what a failed jet does is learned as what
the vehicle is like, the covariance is incremented, and the estimates never converge, or to something else. But its
readings are there. When something contradicts the start, all of them are gone over from the state before the first,
with what an increment adds, since it may as well have been stated too well, and linearized about x* as in `start`:

    screening    a filter that knows of nothing, with columns beside it for every jet and sixteen onsets (`screen`); of
                 single jets the likeliest, at its likeliest onset,
    pass         is a filter of its own with a force from that onset on; where it ends is the next x*,

until a pass ends where it began, with the same jet and its onset to a cycle: the method of Gauss and Newton, which
looks at all hypotheses anew wherever it goes. It begins where the vehicle's file puts the mass properties, if the start
does not; that is a place to linearize at and no knowledge. One that ends without explaining the readings is out, and
all is done again without it.

Of a large force the first order is off by more than neighbors differ, so every other jet that is near has passes of its
own from x* on. The winner leads these as in a race, by cells and with rounding as noise, and nothing by eight times as
much, as all before a start is over. The filter goes on from the end of its passes. Until somebody wins, all is done
again whenever there is twice as much to go over, or something has contradicted the start anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.covariance import compressed
from massprop_drake.maths.estimation.joint.cycle import Sample, crossed, incremented_root, relinearized
from massprop_drake.maths.estimation.joint.decision import SIGNIFICANT, Rules
from massprop_drake.maths.estimation.joint.guard import guarded
from massprop_drake.maths.estimation.joint.hypotheses import (
    FIT,
    NO_SCORE,
    Cause,
    Kind,
    Score,
    kicked,
    opened,
    slot_of,
)
from massprop_drake.maths.estimation.joint.layout import MASS, N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import readings
from massprop_drake.maths.estimation.joint.race import NEAR, known_forces
from massprop_drake.maths.estimation.joint.screen import Contender, Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link, linked, traced
from massprop_drake.maths.estimation.joint.start import LONGEST, STEPS, stays
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

BEFORE_SETTLED = 8.0  # times what is asked for of a settled filter
_SCREENING = 2  # steps of a pass in the time of one of a screening
_ONSETS = 16  # of a screening
_QUIET = 25  # cycles that are kept while nothing acts
_WAIT = 12  # cycles from a contradiction to the first search: a second
_MORE = 2.0  # times as many for the next: all together take no more than twice the last
_PASSES = 8  # of Gauss and Newton at most; three or four as a rule
_CLOSE = 3.0  # sigmas by which the last may move: with each more sample others of its components count
_LENIENT = 1.5  # times its thrust that a jet may be found to give where a screening is linearized far off
_BETTER = 0.9  # of the misfit of the last pass that another must not exceed: else it has ended
_TRIES = 4  # that may end without explaining the readings
_OTHERS = 2  # jets beside the likeliest that are heard in any case
_RIVALS = 5  # with passes of their own
_FIRST_ORDER = 1e-3  # of a lead, by which the first order may be off
_GROUP_AFTER = 100  # cycles from the contradiction: who is not told apart by then will not be soon
_GROUP = 4  # jets


class Fit(NamedTuple):
    """Passes of a filter that takes one failure for true.

    Attributes:
        contender: see `Contender`.
        about: where they are linearized, shape (size,).
        state: after what the present one has gone over.
        score: of it.
        done: number of samples of it.
        passes: begun.
    """

    contender: Contender
    about: Array
    state: JointState
    score: Score = NO_SCORE
    done: int = 0
    passes: int = 1

    @property
    def fits(self) -> bool:
        """Whether it explains the readings."""
        return self.score.misfit < FIT


class Search(NamedTuple):
    """A search under way.

    Attributes:
        until: number of samples that it goes over.
        about: where its screening is linearized, shape (size,).
        state: of the screening's filter.
        screen: see `Screen`.
        screenings: begun.
        fit: of the likeliest; None: the screening is under way.
        last: fit of the likeliest of the last screening.
        out: causes that turned out not to explain the readings.
        passed_over: causes whose pass, for all that the first order says of them, explains less than the last.
        beside: the likeliest, whose passes have ended without explaining the readings, while others have a fit instead.
        instead: such as have no fit yet.
        best: whose passes have ended and explain them; None: nobody yet.
        rivals: fits of others that are near, finished.
        waiting: others that are near, and have no fit yet.
        won: it leads all others, or a group does, and catches up with the present.
        group: others that cannot be told from it.
    """

    until: int
    about: Array
    state: JointState
    screen: Screen
    screenings: int = 1
    fit: Fit | None = None
    last: Fit | None = None
    out: frozenset[Cause] = frozenset()
    passed_over: frozenset[Cause] = frozenset()
    beside: Cause | None = None
    instead: tuple[Contender, ...] = ()
    best: Fit | None = None
    rivals: tuple[Fit, ...] = ()
    waiting: tuple[Contender, ...] = ()
    won: bool = False
    group: tuple[Fit, ...] = ()


class Early(NamedTuple):
    """What is kept of a start in case a jet fails in it. Never changed; a cycle makes a new one.

    Attributes:
        under_way: whether anything is kept.
        entry: state before the first sample that is kept.
        kept: samples since.
        acted: whether a jet was told to fire in any of them.
        contradicted: number of samples kept when something first contradicted the start; 0: nothing has.
        again: when something did so last.
        due: number of samples kept with which the next search begins.
        search: see `Search`.
    """

    under_way: bool = False
    entry: JointState | None = None
    kept: tuple[Sample, ...] = ()
    acted: bool = False
    contradicted: int = 0
    again: int = 0
    due: int = 0
    search: Search | None = None


class Found(NamedTuple):
    """A jet that has failed before the start had converged.

    Attributes:
        state: of the filter that takes it for true.
        cause: see `Cause`.
        onset_s: when it began.
        group: causes that it may be instead, with the force and its 1-sigma of each, lbf or N.
    """

    state: JointState
    cause: Cause
    onset_s: float
    group: tuple[tuple[Cause, float, float], ...]


BEGUN, OVER = Early(under_way=True), Early()


def followed(
    early: Early, before: JointState, sample: Sample, contradicted: bool, given: tuple[Rules, JointParams]
) -> tuple[Early, Found | None]:
    """What is kept after a cycle, and who has failed if that is known by now.

    Args:
        early: before the cycle, under way.
        before: the filter's state before it, `started`.
        sample: of it.
        contradicted: whether something contradicts the start in this cycle.
        given: see `Rules` and `JointParams`.
    """
    rules, params = given
    if len(early.kept) >= LONGEST and early.search is None:
        return OVER, None
    early = _with_sample(early, before, sample)
    if contradicted:
        early = _doubted_again(early) if early.contradicted else _with_doubt(early, params)
    search = early.search
    if search is None:
        if early.contradicted == 0 or len(early.kept) < early.due:
            return early, None
        search = _begun(early, len(early.kept), frozenset(), params)
    until = search.until
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            search = _gone_on(search, early, rules, params)
    except (NotPositiveDefiniteError, np.linalg.LinAlgError):  # it came to nothing
        search = None
    if search is None:
        return early._replace(search=None, due=_due_after(early, until)), None
    if _has_arrived(search, early):
        return OVER, _found(search, early, params)
    return early._replace(search=search), None


def _with_sample(early: Early, before: JointState, sample: Sample) -> Early:
    acted = early.acted or _acts(sample)
    entry, kept = (before if early.entry is None else early.entry), (*early.kept, sample)
    if not acted and len(kept) > _QUIET:
        entry, kept = before, (sample,)
    return early._replace(entry=entry, kept=kept, acted=acted)


def _acts(sample: Sample) -> bool:
    """Whether anything pushes the vehicle in a sample."""
    return bool((sample.commands > 0.0).any() or sample.outside.any())


def _with_doubt(early: Early, params: JointParams) -> Early:
    """What is kept, contradicted: by a jet, or since the start was stated too well, as an increment has it."""
    entry, count = early.entry, len(early.kept)
    assert entry is not None, "something is kept"
    wide = entry._replace(root=compressed(incremented_root(entry.root, params), params.places.thrust))
    return early._replace(entry=wide, contradicted=count, again=count, due=count + _WAIT)


def _doubted_again(early: Early) -> Early:
    """What is kept, contradicted once more: what nobody was found for may have been of chance, and something new."""
    count = len(early.kept)
    return early._replace(again=count, due=min(early.due, count + _WAIT))


def _due_after(early: Early, until: int) -> int:
    """When the next search begins after one of so many samples has found nobody."""
    again = early.again + _WAIT if early.again > until else LONGEST + 1
    return min(int(_MORE * len(early.kept)) + 1, max(again, len(early.kept) + 1))


# ---------------------------------------------------------------------------------------- a search


def _begun(early: Early, count: int, out: frozenset[Cause], params: JointParams) -> Search:
    """A search of so many samples, the first."""
    entry = early.entry
    assert entry is not None, "something is kept"
    about = _possible(entry.mean, entry, params)
    onsets, gaps = _grid(count, 0, -(-count // _ONSETS))
    return Search(count, about, entry, _screen(early, onsets, gaps, params), out=out)


def _screen(early: Early, onsets: tuple[int, ...], gaps: tuple[int, ...], params: JointParams) -> Screen:
    entry, first = early.entry, early.kept[0]
    assert entry is not None, "something is kept"
    return screens.begin((entry, 0), onsets, gaps, readings(first.rates, first.velocities), params, single=True)


def _grid(count: int, middle: int, gap: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Onsets about one, and the intervals that each stands for."""
    first = middle % gap if middle < gap * (_ONSETS // 2) else middle - gap * (_ONSETS // 2)
    onsets = tuple(range(first, count, gap))[: _ONSETS + 1]
    return onsets, tuple(gap if onset > 0 else 1 for onset in onsets)


def _possible(mean: Array, state: JointState, params: JointParams) -> Array:
    """Where to linearize: an estimate, with the file's mass properties if its own are none, and forces that jets have.

    Args:
        mean: the estimate, shape (size,).
        state: with its slots.
        params: see `JointParams`.
    """
    about = mean.copy()
    if not (about[[0, 1, 2, MASS]] > 0.0).all():
        about[:N_PROPERTIES] = params.nominal
    for slot in np.flatnonzero(state.slot_jet >= 0):
        row, most = params.places.force + slot, screens.most_forces(params)[int(state.slot_jet[slot])]
        about[row] = min(max(about[row], 0.0), most)
    return about


def _gone_on(search: Search, early: Early, rules: Rules, params: JointParams) -> Search | None:
    """The search after a cycle's steps; None: nobody is found."""
    left = STEPS
    while left > 0:
        if search.won and search.best is not None:
            best = search.best
            if _has_arrived(search, early):
                return search
            if best.done == len(early.kept):  # what came since has moved it
                search = search._replace(best=_passed_again(best, early, params))
                continue
            left -= 1
            search = search._replace(best=_passed(best, search, early, params))
        elif search.fit is None and search.screen.cycle < search.until:
            left -= _SCREENING
            search = _screened(search, early, params)
        elif search.fit is not None and search.fit.done < search.until:
            left -= 1
            search = search._replace(fit=_passed(search.fit, search, early, params))
        else:
            after = _turned(search, early, rules, params)
            if after is None:
                return None
            search = after
    return search


def _turned(search: Search, early: Early, rules: Rules, params: JointParams) -> Search | None:
    """The search where a screening or a pass has ended."""
    if search.fit is None:
        tried = search.passed_over
        likeliest = next((each for each in _singles(search, early, params) if each.cause not in tried), None)
        if likeliest is None or _is_healthy(search, likeliest, rules):
            return None
        return search._replace(fit=_fit(likeliest, search.about, early))
    fit, best = search.fit, search.best
    if best is None and search.beside is None:
        return _after_pass(search, fit, early, params)
    if fit.passes < _PASSES // 2 and not stays(fit.state, fit.about):
        return search._replace(fit=_passed_again(fit, early, params))
    if best is None:
        return _after_pass_beside(search, fit, early, params)
    if fit.contender.cause != best.contender.cause:
        search = search._replace(rivals=(*search.rivals, fit))
    elif fit.fits:
        search = search._replace(best=fit)
    if search.waiting:
        return search._replace(fit=_fit(search.waiting[0], search.about, early), waiting=search.waiting[1:])
    return _decided(search, early, rules, params)


def _after_pass(search: Search, fit: Fit, early: Early, params: JointParams) -> Search | None:
    """The search after a pass of the likeliest: another screening, those that are near it, or all without it."""
    last, gap, cause = search.last, search.screen.gaps[-1], fit.contender.cause
    worse = last is not None and not fit.fits and fit.score.misfit > last.score.misfit
    if last is not None and worse and cause != last.contender.cause:
        return search._replace(passed_over=search.passed_over | {cause}, fit=None)
    again = last is not None and last.contender.cause == cause and gap == 1
    if again and fit.fits:
        return search._replace(best=fit, waiting=_near(search, fit, early, params))
    if last is not None and again and fit.score.misfit > _BETTER * last.score.misfit:
        return _beside(search, fit, early, params)
    if search.screenings >= _PASSES:
        return _without(search, cause, early, params)
    finer = max(1, 2 * gap // _ONSETS) if gap > 1 else 1
    onsets, gaps = _grid(search.until, fit.contender.onset, finer)
    entry = early.entry
    assert entry is not None, "something is kept"
    return search._replace(
        about=_possible(fit.state.mean, fit.state, params),
        state=entry,
        screen=_screen(early, onsets, gaps, params),
        screenings=search.screenings + 1,
        fit=None,
        last=fit,
    )


def _is_healthy(search: Search, likeliest: Contender, rules: Rules) -> bool:
    """Whether nothing explains all, and no jet far more, where passes have found what the vehicle is like."""
    enough = likeliest.lead > BEFORE_SETTLED * rules.lead_nothing
    return search.screenings > 1 and not enough and search.screen.scores[-1].misfit < FIT


def _beside(search: Search, fit: Fit, early: Early, params: JointParams) -> Search:
    """The search with passes of what is beside the likeliest: what is linearized about that favors it.

    First its failure at the onsets beside its own, then other jets.
    """
    contender = fit.contender
    onsets = [each for each in (contender.onset + 1, contender.onset - 1) if 0 <= each < search.until]
    named = search.passed_over | {contender.cause}
    others = [each for each in _singles(search, early, params) if each.cause not in named]
    first, *rest = [*(contender._replace(onset=each) for each in onsets), *others[:_OTHERS]]
    about = fit.about
    return search._replace(fit=_fit(first, about, early), about=about, instead=tuple(rest), beside=contender.cause)


def _after_pass_beside(search: Search, fit: Fit, early: Early, params: JointParams) -> Search | None:
    """The search where passes of what is beside the likeliest have ended."""
    if fit.fits:
        return search._replace(best=fit, waiting=_near(search, fit, early, params))
    if search.instead:
        return search._replace(fit=_fit(search.instead[0], search.about, early), instead=search.instead[1:])
    assert search.beside is not None, "they are beside something"
    return _without(search, search.beside, early, params)


def _without(search: Search, cause: Cause, early: Early, params: JointParams) -> Search | None:
    """All again without a cause that does not explain the readings; None: it was the last to be tried."""
    out = search.out | {cause}
    return None if len(out) >= _TRIES else _begun(early, search.until, out, params)


def _fit(contender: Contender, about: Array, early: Early) -> Fit:
    assert early.entry is not None, "something is kept"
    return Fit(contender, about, early.entry)


def _passed_again(fit: Fit, early: Early, params: JointParams) -> Fit:
    """Another pass of it, from where the last has ended."""
    again = _fit(fit.contender, _possible(fit.state.mean, fit.state, params), early)
    return again._replace(passes=fit.passes + 1)


def _has_arrived(search: Search, early: Early) -> bool:
    """Whether somebody has won and its passes have gone over all up to the present."""
    best = search.best
    if not search.won or best is None or best.done < len(early.kept):
        return False
    return stays(best.state, best.about, _CLOSE) or best.passes >= _PASSES


def _singles(search: Search, early: Early, params: JointParams) -> list[Contender]:
    """Single jets that may have failed, to first order, likeliest first."""
    assert early.entry is not None, "something is kept"
    known = known_forces(early.entry, params)
    allowed = (np.ones_like(known) if (early.entry.slot_jet < 0).any() else known) > 0.0
    lenient = params._replace(thrusts=_LENIENT * params.thrusts)
    found = screens.contenders(search.screen, allowed, known, lenient)
    return [each for each in found if each.cause.kind == Kind.JETS and each.cause not in search.out]


def _near(search: Search, best: Fit, early: Early, params: JointParams) -> tuple[Contender, ...]:
    """Others that may be as likely as the best for all that the first order says, each in its likelier way.

    The next two are heard in any case: of a large force the first order favors whom it is linearized about.
    """
    lead, named = best.contender.lead, best.contender.cause.named
    reach = max(NEAR, _FIRST_ORDER * lead)
    found: dict[object, Contender] = {}
    for each in _singles(search, early, params):
        near = lead - each.lead < reach or len(found) < _OTHERS
        if each.cause.named != named and each.cause != search.beside and near:
            found.setdefault(each.cause.named, each)
    return tuple(found.values())[:_RIVALS]


# ------------------------------------------------------------------------------------------- steps


def _over(state: JointState, sample: Sample, about: Array, params: JointParams) -> tuple[JointState, Link]:
    after, course = relinearized(state, sample, about, params)
    return after, linked(traced(about, course, sample), params)


def _screened(search: Search, early: Early, params: JointParams) -> Search:
    """The screening after one more sample."""
    sample = early.kept[search.screen.cycle]
    state, link = _over(search.state, sample, search.about, params)
    screen = screens.screened(search.screen, link, params)
    return search._replace(state=state, screen=screen)


def _passed(fit: Fit, search: Search, early: Early, params: JointParams) -> Fit:
    """A fit after one more sample; beyond those that the search goes over it is not scored."""
    contender, done, sample = fit.contender, fit.done, early.kept[fit.done]
    state, _ = crossed(fit.state, fit.about[:N_PROPERTIES], sample, params.floors, params)
    if done == contender.onset:
        state = opened(state, contender.cause, params)
    if 0 <= done - contender.onset < len(contender.kicks):  # along what the jet does there, not at the screening's x*
        _, link = _over(state, sample, fit.about, params)
        state = kicked(state, contender.cause, np.array(contender.kicks[done - contender.onset]), link, params)
    state, link = _over(state, sample, fit.about, params)
    score = fit.score
    if done < search.until:
        score = score.plus(Score(link.log_likelihood, link.nis, link.degrees))
    return fit._replace(state=state, score=score, done=done + 1)


# ---------------------------------------------------------------------------------------- decision


def _force(fit: Fit, params: JointParams) -> tuple[float, float]:
    """The force of a fit, and its 1-sigma."""
    cause = fit.contender.cause
    row = params.places.force + slot_of(fit.state, cause.jets[0], cause.signs[0])
    return float(fit.state.mean[row]), float(np.sqrt(np.sum(fit.state.root[row] ** 2)))


def _believed(fit: Fit, params: JointParams) -> float:
    """Logarithm of how likely it is but for the readings, nats."""
    force, sigma = _force(fit, params)
    return screens.believed(fit.contender.cause, np.array([force]), np.array([[sigma**2]]), params)


def ahead(one: Fit, other: Fit, params: JointParams) -> float:
    """Lead of a fit over another, nats."""
    beforehand = _believed(one, params) - _believed(other, params)
    return beforehand + one.score.likelihood - other.score.likelihood


def _decided(search: Search, early: Early, rules: Rules, params: JointParams) -> Search | None:
    """The search where everybody near has been heard: somebody wins, or nobody."""
    assert search.best is not None, "one explains the readings"
    heard = [search.best, *(each for each in search.rivals if each.fits)]
    best = max(heard, key=lambda each: each.score.likelihood + _believed(each, params))
    nothing = search.screen.scores[-1].likelihood
    lead = best.score.likelihood + _believed(best, params) - nothing
    force, sigma = _force(best, params)
    if lead <= BEFORE_SETTLED * rules.lead_nothing or force <= SIGNIFICANT * sigma:
        return None
    group = tuple(each for each in heard if each is not best and ahead(best, each, params) <= NEAR)
    if group and (len(early.kept) < early.contradicted + _GROUP_AFTER or len(group) >= _GROUP):
        return None
    return search._replace(best=best._replace(passes=1), won=True, group=group)


def _found(search: Search, early: Early, params: JointParams) -> Found:
    best = search.best
    assert best is not None, "one has won"
    assert early.entry is not None, "something is kept"
    onset, sample = best.contender.onset, early.kept[-1]
    onset_s = early.kept[onset - 1].time_s if onset > 0 else early.entry.time_s
    group = tuple((each.contender.cause, *_force(each, params)) for each in search.group)
    return Found(guarded(best.state, _acts(sample), params), best.contender.cause, onset_s, group)
