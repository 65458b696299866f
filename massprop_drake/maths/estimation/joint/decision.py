r"""Who has won a race, and what is said of it.

With L_0, L_J, L_S of nothing, jump and a reading that lies, L_1 of the likeliest jets, L_2 of the likeliest *other*
set of jets, in nats, and cycles counted from the alarm:

    jets     L_1 - L_2 > 6, L_1 - L_J > 6, L_1 - L_S > 6, L_1 - L_0 > 12, f > 3 sigma of a single one, and they fit,
             for two samples where the first has put others behind that led until then; a pair after three samples;
             before settled only forces of a tenth of full thrust; of less than half of its thrust, or than a tenth of
             the strongest jet's, half a second after the alarm, and for a second only by what is read over two at once,
             since for so long two look like one, and for eight seconds L_1 - L_2 > 12, 9 over two at once; of two such
             at once L_1 - L_2 > 18; that a known force changes for half a second only by what is read, later also as
             it is likelier beforehand
    group    the same against all but those that differ in one jet, which what has fired cannot tell apart, and are two
             at most or of one cluster; or differ in jets of the same clusters; of little forces after eight seconds,
             and not before the end unless it is narrow; and at once where something new begins that none of them
             explains, but not of two at once
    lie      L_S leads all by 6 and nothing by 12, after 6 cycles
    jump     L_J leads all by 6, two samples at least, a small one twelve, one that does not fit twelve, and it must
             leave no more than a hundredth of the misfit; announced if settled and L_J - L_0 > 100, else an increment
    nothing  L_0 leads after 12 cycles, or is within 8 after 75; and fits

and what is still open after 250 cycles is named, alone or as a group of however many, or unexplained: of filters by
cells and by noise, but not to first order, which leaves out too much of so many readings.

A hypothesis *fits* whose NIS is at most 6 standard deviations above its expectation, and which since its onset has not
made white noise likelier than the cells of the readings by 6 nats (`hypotheses`). Over one that is compared only to
first order twice the lead is asked for.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import FIT, Cause, Kind, Runner
from massprop_drake.maths.estimation.joint.layout import INERTIA, MASS, JointParams
from massprop_drake.maths.estimation.joint.race import (
    A_SECOND,
    HALF_A_SECOND,
    NEAR,
    OUT,
    SHAKEN,
    SURPRISED,
    Race,
    Standing,
    ahead,
    apart,
    is_unheard,
    leads,
    margin,
    overrated,
    rivals,
)
from massprop_drake.maths.estimation.joint.screen import Contender, FailedJet
from massprop_drake.maths.mass_properties import ELEMENT

SIGNIFICANT = 3.0  # sigmas of a force
UNSETTLED_FLOOR = 0.1  # of full thrust: before settled a start that still learns explains less than that by jets
_LIE_AFTER = 6  # cycles: a lie that ends is told from a rate that has changed by what follows it
_JUMP_AFTER = 2  # samples: in one of them a pair of jets explains as much
_DOUBTFUL_JUMP_AFTER = 12  # samples: one that misfits may yet learn; a small one fits jets that began at another onset
_LITTLE_FORCE, _LITTLE_SHARE = 0.1, 0.5  # of the strongest jet's thrust, and of the jet's own
_CERTAINLY = 2.0  # times the lead, of what does little harm meanwhile: rounding moves a lead by ten nats by chance
_OF_TWO = 3.0  # of two such at once: there are twenty times as many to compare, and their common force is hardly known
_OVER_MORE = 1.5  # over more failures, of which the lead is mostly that they are rare: no chance moves that
_WELL = 3.0  # standard deviations of chi-square: of who explains all so far, one in a thousand is above
_LITTLE = 0.01  # of the misfit of nothing, left by a jump that does not fit
_PAIR_AFTER = 3  # samples: two jets and their onsets explain nearly all of the six increments of one or two
_JUMP_AT_LEAST = 1000.0  # nats before settled: less is a start that still learns
_INCREMENT_AFTER = 25  # cycles: a filter that was a little off, no payload
_NOTHING_AFTER, _NOTHING_NEAR, _NOTHING_LATE = 12, 8.0, 75
_GROUP_AFTER = 100  # cycles: a leak that is not told apart in 8 s will not be soon
_GROUP_SOON_AFTER = 4  # cycles: of jets that are stuck, on or off, and lead all others; it is needed at once
_GROUP = 3  # jets at most
ALIKE = 12.0  # separation below which jets look alike: twice the lead
LAST = 250  # cycles of a race


class Outcome(IntEnum):
    """How a race ends."""

    OPEN = 0
    NOTHING = 1
    JETS = 2
    GROUP = 3
    JUMP = 4
    INCREMENT = 5
    LIES = 6
    UNEXPLAINED = 7


class Rules(NamedTuple):
    """What decides; see the module.

    Attributes:
        lead: over every other hypothesis, nats.
        lead_nothing: over no failure, nats.
        jump: over no failure, of a jump that is announced, nats.
        clusters: index of each jet's cluster, shape (n_jets,); None: they are in none.
    """

    lead: float = 6.0
    lead_nothing: float = 12.0
    jump: float = 100.0
    clusters: np.ndarray | None = None


class Decision(NamedTuple):
    """A decision and whom it is about.

    Attributes:
        outcome: see `Outcome`.
        winner: see `Standing`; None where nothing has happened.
        group: hypotheses with other jets that what has fired cannot tell from the winner's; of an open race those that
            are not behind the likeliest so far.
        alternatives: the failures that they differ in, each of the winner's and then those it may be instead.
        shaken: whether it was decided because none of them explains the newest samples: something new has begun.
        clear: whether the winner leads all others by enough.
    """

    outcome: Outcome
    winner: Standing | None = None
    group: tuple[Contender, ...] = ()
    alternatives: tuple[tuple[FailedJet, ...], ...] = ()
    shaken: bool = False
    clear: bool = False


def decided(race: Race, standing: list[Standing], settled: bool, rules: Rules, params: JointParams) -> Decision:
    """The decision after a cycle.

    Args:
        race: its screen has arrived at the present.
        standing: see `race.standings`.
        settled: whether the filter's start is over.
        rules: see `Rules`.
        params: see `JointParams`.
    """
    standing = rivals(standing)
    cycles = race.cycles
    interrupted = _interrupted(race, standing, rules) if cycles > HALF_A_SECOND else None
    interrupted = interrupted or _left_behind(race, standing, rules)
    if interrupted is not None:
        return interrupted
    jump = next((each for each in standing if each.contender.cause.kind == Kind.JUMP), None)
    best = standing[0]
    lead, found = best.contender.lead, Decision(Outcome.OPEN)
    kind = best.contender.cause.kind
    clear = lead > rules.lead_nothing and all(
        leads(best, other, _asked(race, best, other, rules, params)) for other in standing[1:]
    )
    if (
        kind == Kind.JETS
        and best.run is not None
        and (jump is None or jump.run is not None or _is_behind(race, jump, lead))
    ):
        large = settled or _large(best.contender, params)
        found = _of_jets(race, standing, cycles, clear, rules, params) if large else found
        if found.outcome != Outcome.OPEN:
            return found
    if kind == Kind.JUMP and best.run is not None and clear and _jump_explains(race, best.run, cycles):
        if settled and lead > rules.jump:
            return Decision(Outcome.JUMP, best)
        if cycles >= _INCREMENT_AFTER or (not settled and lead > _JUMP_AT_LEAST):
            return Decision(Outcome.INCREMENT, best)
    if kind == Kind.LIES and best.run is not None and clear and cycles >= _LIE_AFTER:
        return Decision(Outcome.LIES, best)
    nothing_fits = race.screen.scores[-1].misfit < FIT
    largest = max(each.contender.lead for each in standing)
    if nothing_fits and cycles >= _NOTHING_AFTER and largest <= 0.0:
        return Decision(Outcome.NOTHING)
    if nothing_fits and cycles >= _NOTHING_LATE and largest <= _NOTHING_NEAR:
        return Decision(Outcome.NOTHING)
    if cycles >= LAST:
        return _at_last(standing, rules, nothing_fits)
    return found


def _asked(race: Race, best: Standing, other: Standing, rules: Rules, params: JointParams) -> float:
    """Lead over another hypothesis, nats: more of a little force for eight seconds, and of two such at once."""
    little = [each for each in _new(race, best) if _is_little((each,), params)]
    if len(little) > 1:
        return _OF_TWO * rules.lead
    if not little or race.cycles >= _GROUP_AFTER:
        return rules.lead
    more = len(other.contender.cause.jets) > len(best.contender.cause.jets)
    return (_OVER_MORE if more else _CERTAINLY) * rules.lead


def _new(race: Race, standing: Standing) -> list[FailedJet]:
    """Its failures of jets that nothing is known of."""
    return [each for each in standing.contender.failures if each.jet not in race.states[0].slot_jet]


def _is_behind(race: Race, jump: Standing, lead: float) -> bool:
    """Whether a jump need not be heard before jets are named."""
    return jump.contender.lead <= 0.0 or (jump.contender.lead < lead - OUT and not is_unheard(race, jump))


def _jump_explains(race: Race, run: Runner, cycles: int) -> bool:
    """Whether a jump may win: a large one fits only once the filter has learned it, but leaves little at once.

    What is left must be a body, and all that run must have arrived: a jump of ten parameters explains the same as they.
    """
    if any(other.cycle < race.screen.cycle for other in race.runs):
        return False
    if run.state.mean[MASS] <= 0.0 or np.linalg.eigvalsh(run.state.mean[INERTIA][ELEMENT])[0] <= 0.0:
        return False
    if run.fits:
        return cycles >= (_DOUBTFUL_JUMP_AFTER if run.is_small else _JUMP_AFTER)
    return run.score.misfit < _LITTLE * race.screen.scores[-1].misfit and cycles >= _DOUBTFUL_JUMP_AFTER


def _of_jets(
    race: Race, standing: list[Standing], cycles: int, clear: bool, rules: Rules, params: JointParams
) -> Decision:
    best, run = standing[0].contender, standing[0].run
    assert run is not None, "only a filter of its own decides"
    pair = len(best.cause.jets) > 1  # of jets that push alike the sum may be known alone: it leads over either of them
    significant = pair or abs(best.force[0]) > SIGNIFICANT * best.sigma[0]
    known = any(jet in race.states[0].slot_jet for jet in best.cause.jets)
    undecided = Decision(Outcome.OPEN)
    if run.age < len(run.kicks):  # what is not known of its first intervals is not all in its state
        return undecided
    if best.cause.drifts and any(each.cause.drifts and each.cycle < race.screen.cycle for each in race.runs):
        return undecided
    if not run.fits or best.lead <= rules.lead_nothing or not (significant or known):
        return undecided
    if (pair and cycles < _PAIR_AFTER) or overrated(race, standing[0], params) is not None:
        return undecided
    until_now = tuple(each for each in race.leading if each.cause != best.cause)
    if clear and not known and race.clear != best.cause and _surprised(standing, until_now):
        return Decision(Outcome.OPEN, standing[0], until_now, clear=True)
    if clear:
        little = _is_new_and_little(race, standing[0], params)
        shown = cycles > HALF_A_SECOND or (_shown_by_readings(standing, rules) and not little)
        shown = shown and not (little and run.age < A_SECOND and _may_be_two(standing, rules))
        return Decision(Outcome.JETS if shown else Outcome.OPEN, standing[0], clear=True)
    near = _near(standing, rules)
    alternatives = _alternatives((best, *near), rules)
    cleared = all(leads(standing[0], other, rules.lead) for other in standing[1:] if other.contender not in near)
    stuck = not all(best.cause.on_top) and not _is_little(best.failures, params)
    if cleared and stuck:
        ready = cycles >= _GROUP_SOON_AFTER
    else:
        ready = cycles >= _GROUP_AFTER and _is_narrow(best, near, alternatives, rules)
    if alternatives and ready and _alike(race, best, alternatives, params):
        return Decision(Outcome.GROUP, standing[0], near, alternatives)
    led = near or _not_cleared(standing, rules)
    if not all(each.cause.kind == Kind.JETS for each in led):
        return undecided
    return Decision(Outcome.OPEN, standing[0], (*led, *_put_behind(standing, until_now, led, rules, params)))


def _is_little(failures: tuple[FailedJet, ...], params: JointParams) -> bool:
    """Whether some jet gives on top what does little harm in half a second: for so long two of them look like one."""
    little = np.maximum(_LITTLE_FORCE * params.thrusts.max(), _LITTLE_SHARE * params.thrusts)
    most = ((each.jet, each.force + screens.BOUND * each.sigma) for each in failures if each.sign > 0)
    return any(force < little[jet] for jet, force in most)


def _is_new_and_little(race: Race, best: Standing, params: JointParams) -> bool:
    """Whether it says of some jet that nothing is known of that it gives little."""
    return _is_little(tuple(_new(race, best)), params)


def _may_be_two(standing: list[Standing], rules: Rules) -> bool:
    """Whether the best leads two others at once by no more than that these are rare."""
    return not all(leads(standing[0], other, rules.lead, read=True) for other in standing[1:])


def _surprised(standing: list[Standing], until_now: tuple[Contender, ...]) -> list[Standing]:
    """Those that led until now that the newest sample surprises: it may be of something new."""
    causes = {each.cause for each in until_now}
    some = (each for each in standing if each.contender.cause in causes)
    return [each for each in some if each.run is not None and each.run.newest.surprise >= SURPRISED]


def _put_behind(
    standing: list[Standing],
    until_now: tuple[Contender, ...],
    led: tuple[Contender, ...],
    rules: Rules,
    params: JointParams,
) -> list[Contender]:
    """Those that led until now that the newest sample alone puts behind: one more must show it."""
    best, causes = standing[0], {each.cause for each in led}
    some = [each for each in _surprised(standing, until_now) if each.contender.cause not in causes]
    return [each.contender for each in some if apart(best, each, params, shaken=True) < rules.lead]


def _shown_by_readings(standing: list[Standing], rules: Rules) -> bool:
    """Whether the best leads all that were less likely beforehand by what was read since, too."""
    best = standing[0]
    unlikelier = [each for each in standing[1:] if each.beforehand < best.beforehand]
    return all(best.contender.lead - each.contender.lead > rules.lead for each in unlikelier)


def _alternatives(likely: tuple[Contender, ...], rules: Rules, most: int = _GROUP) -> tuple[tuple[FailedJet, ...], ...]:
    """What hypotheses differ in, see `Decision`; none: in more than can be said in a few words.

    Args:
        likely: the likeliest first.
        rules: see `Rules`.
        most: jets of different clusters in a group.
    """
    if not all(each.cause.kind == Kind.JETS for each in likely):
        return ()
    common = frozenset.intersection(*(each.cause.failures for each in likely))
    differing = [[f for f in each.failures if (f.jet, f.sign) not in common] for each in likely]
    single = all(len(each) == 1 for each in differing)
    if rules.clusters is None:
        return (tuple(each[0] for each in differing),) if single and len(likely) <= most else ()
    clusters = rules.clusters
    patterns = {tuple(sorted((int(clusters[f.jet]), f.sign) for f in each)) for each in differing}
    if single and (len(likely) <= most or len(patterns) == 1):
        return (tuple(each[0] for each in differing),)
    if len(patterns) > 1:
        return ()
    found: dict[tuple[int, int], dict[int, FailedJet]] = {}
    for failure in (failure for each in differing[1:] for failure in each):
        found.setdefault((int(clusters[failure.jet]), failure.sign), {}).setdefault(failure.jet, failure)
    named = {failure.jet for failure in differing[0]}
    instead = [found[int(clusters[failure.jet]), failure.sign] for failure in differing[0]]
    return tuple(
        (failure, *(other for other in others.values() if other.jet not in named))
        for failure, others in zip(differing[0], instead, strict=True)
    )


def _is_narrow(
    best: Contender, near: tuple[Contender, ...], alternatives: tuple[tuple[FailedJet, ...], ...], rules: Rules
) -> bool:
    """Whether a group is as small as it will be: three for a jet at most, of whom no filter leads another."""
    alike = all(best.lead - each.lead < rules.lead for each in near)
    return alike and all(len(each) <= _GROUP for each in alternatives)


def _alike(race: Race, best: Contender, alternatives: tuple[tuple[FailedJet, ...], ...], params: JointParams) -> bool:
    """Whether what has fired could not have told one failure from those it may be instead."""
    if len(alternatives) > 1:  # jets of the same clusters, each with the forces that go with the others
        return True
    first, *others = alternatives[0]
    shared = tuple(failure for failure in best.failures if failure != first)
    apart = (screens.separation(race.screen, best.onset, (first, other), shared, params) for other in others)
    return all(each < ALIKE for each in apart)


def _interrupted(race: Race, standing: list[Standing], rules: Rules) -> Decision | None:
    """What becomes of those that led, one or several: named where none of them explains the newest sample.

    They wait for the next sample where that is in doubt, or where the newest alone has made another of them lead: what
    begins in the midst of a sample favors one of them by chance; if the next is no better they are named as they stood
    before that. Where another explains the newest sample, too, it was they that were wrong, and so it was where none of
    them had explained all before it well: two failures at once look like one for a while. Those of them that have no
    filter at the present cannot say; they are named with the others.
    """
    now = {each.contender.cause: each for each in standing}
    led = [now[each.cause]._replace(contender=each) for each in race.leading if each.cause in now]
    runs = [each.run for each in led if each.run is not None]
    if not any(_explained_well(run) for run in runs) or led[0].run is None:
        return None
    surprises = [run.newest.surprise for run in runs]
    others = [each for each in standing if each.contender.cause not in {one.contender.cause for one in led}]
    fitting = [each.run for each in others if each.run is not None and each.run.fits]
    if min(surprises) >= SURPRISED and any(run.newest.surprise < SURPRISED for run in fitting):
        return None
    if min(surprises) >= SHAKEN:
        before = as_they_stood(race, {each.contender.cause for each in led})
        waited = all(each.run is not None and each.run.cycle < race.screen.cycle - 1 for each in before)
        return _named(list(before) if before and waited else led, race, rules)
    if min(surprises) >= SURPRISED:
        return Decision(Outcome.OPEN, led[0], tuple(each.contender for each in led[1:]))
    first = standing[0].contender.cause
    if first in [each.contender.cause for each in led[1:]]:
        rest = tuple(each.contender for each in led if each.contender.cause != first)
        return Decision(Outcome.OPEN, standing[0], rest)
    return None


def as_they_stood(race: Race, causes: set[Cause]) -> tuple[Standing, ...]:
    """Those of these causes that led last, if all of them did; else none."""
    found = tuple(each for each in race.led if each.contender.cause in causes)
    return found if len(found) == len(causes) else ()


def runners_up(winner: Standing, standing: list[Standing]) -> list[Standing]:
    """Other jets that explain all as well and are behind by less than twice what decides, the likeliest first.

    Args:
        winner: the jets that are named.
        standing: those with a filter as far.
    """
    near = [
        each
        for each in standing
        if each.contender.cause.kind == Kind.JETS
        and each.contender.cause.named != winner.contender.cause.named
        and (each.run is not None and each.run.fits)
        and ahead(winner, each) < NEAR
    ]
    return sorted(near, key=lambda each: ahead(winner, each))


def _explained_well(run: Runner) -> bool:
    """Whether a filter explained all before the newest sample, and well."""
    before = run.before_newest
    return before.misfit <= _WELL


def explaining(standing: list[Standing], last: tuple[Standing, ...], rules: Rules) -> tuple[Standing, ...]:
    """Jets that explain all so far and are not behind, those first that have a filter; none where a jump may be it.

    What begins slowly is in all of them before it shows, and makes one fit for a sample more than another by chance. So
    who led last stays while it is not behind, though it no longer fits; and all stay, as they were, where nobody who is
    not behind fits.

    Args:
        standing: see `race.standings`.
        last: who did before, see `Race.led`.
        rules: see `Rules`.
    """
    best, *others = rivals(standing)
    near = [best, *(each for each in others if not leads(best, each, rules.lead))]
    if any(each.contender.cause.kind != Kind.JETS for each in near):
        return ()
    fit = [each for each in near if each.run is not None and each.run.fits]
    if not fit:
        return last
    if not any(each.contender.lead > rules.lead_nothing for each in fit):
        return ()
    doubtful = {each.contender.cause for each in last} - {each.contender.cause for each in fit}
    stay = [each for each in near if each.run is not None and each.contender.cause in doubtful]
    return (*fit, *stay, *(each for each in near if each.run is None))


def _left_behind(race: Race, standing: list[Standing], rules: Rules) -> Decision | None:
    """What becomes of those that led, where for half a second nothing has explained what came since.

    What begins slowly shakes none of them, and is in all of them before it shows. Who nearly fits is not named, but
    says that they were wrong rather than that something is new.
    """
    if race.leading or not race.led or any(each.run is not None and nearly_fits(each.run) for each in standing):
        return None
    until = max(race.until, min(each.run.cycle for each in race.led if each.run is not None))
    return _named(list(race.led), race, rules) if race.screen.cycle - until >= HALF_A_SECOND else None


def nearly_fits(run: Runner) -> bool:
    """Whether a filter explains the readings but for what one of many filters of the truth may be off by chance."""
    return run.score.misfit < FIT


def _named(led: list[Standing], race: Race, rules: Rules) -> Decision | None:
    """Those that led as a decision; None where what they differ in is not said in a few words.

    Two at once that have explained all for a while, and no longer do, are no explanation of what is so rare: where one
    alone has led beside them, it was that, and something else began.
    """
    led = [each for each in led if is_one(race, each)]
    if not led or led[0].run is None:
        return None
    if len(led) == 1:
        return Decision(Outcome.JETS, led[0], shaken=True)
    group = tuple(each.contender for each in led)
    alternatives = _alternatives(group, rules, most=len(group))
    return Decision(Outcome.GROUP, led[0], group[1:], alternatives, shaken=True) if alternatives else None


def is_one(race: Race, standing: Standing) -> bool:
    """Whether it is no more than one further failure."""
    return len(set(standing.contender.cause.jets) - set(race.states[0].slot_jet.tolist())) < 2


def _large(contender: Contender, params: JointParams) -> bool:
    """Whether each force is one that may be believed before settled."""
    jets = contender.cause.jets
    return all(f > UNSETTLED_FLOOR * params.thrusts[jet] for f, jet in zip(contender.force, jets, strict=True))


def _near(standing: list[Standing], rules: Rules) -> tuple[Contender, ...]:
    """Those that the best does not lead by enough."""
    return tuple(each.contender for each in standing[1:] if ahead(standing[0], each) < rules.lead)


def _not_cleared(standing: list[Standing], rules: Rules) -> tuple[Contender, ...]:
    """Those that the best does not lead by enough where what is known of them to first order counts, too."""
    return tuple(each.contender for each in standing[1:] if margin(standing[0], each) <= rules.lead)


def _at_last(standing: list[Standing], rules: Rules, nothing_fits: bool) -> Decision:
    best = next((each for each in standing if each.run is not None), None)
    if best is None or best.contender.lead <= rules.lead_nothing:
        return Decision(Outcome.NOTHING if nothing_fits else Outcome.UNEXPLAINED)
    if best.run is not None and not best.run.fits:
        return Decision(Outcome.UNEXPLAINED, best)
    if best.contender.cause.kind == Kind.JUMP:
        return Decision(Outcome.INCREMENT, best)
    near = tuple(each.contender for each in standing if each is not best and best.odds - each.odds < rules.lead)
    alternatives = _alternatives((best.contender, *near), rules, most=len(near) + 1)
    if best is standing[0] and best.contender.cause.kind == Kind.JETS and (alternatives or not near):
        return Decision(Outcome.GROUP if near else Outcome.JETS, best, near, alternatives)
    return Decision(Outcome.UNEXPLAINED, best)
