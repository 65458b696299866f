r"""Who has won a race, and what is said of it.

With L_0, L_J, L_S of nothing, jump and a reading that lies, L_1 of the likeliest jets, L_2 of the likeliest *other*
set of jets, in nats, and cycles counted from the alarm:

    jets     L_1 - L_2 > 6, L_1 - L_J > 6, L_1 - L_S > 6, L_1 - L_0 > 12, f > 3 sigma of each, and they fit; a pair
             after three samples; before settled only forces of a tenth of full thrust
    group    the same against all but those that differ in one jet, which what has fired cannot tell apart, and are two
             at most or of one cluster; and at once where something new begins that none of them explains
    lie      L_S leads all by 6 and nothing by 12, after 6 cycles
    jump     L_J leads all by 6, two samples at least; where it does not fit twelve, and it must leave no more than a
             hundredth of the misfit; announced if settled and L_J - L_0 > 100, else taken as an increment
    nothing  L_0 leads after 12 cycles, or is within 8 after 75; and fits

and what is still open after 250 cycles is a group of however many, or unexplained.

A hypothesis *fits* whose NIS is at most 6 standard deviations above its expectation.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import Kind, Runner
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.race import FIT, OUT, Race, Standing, margin
from massprop_drake.maths.estimation.joint.screen import Contender

SIGNIFICANT = 3.0  # sigmas of a force
UNSETTLED_FLOOR = 0.1  # of full thrust: before settled a start that still learns explains less than that by jets
_LIE_AFTER = 6  # cycles: a lie that ends is told from a rate that has changed by what follows it
_JUMP_AFTER = 2  # samples: in one of them a pair of jets explains as much
_JUMP_THAT_MISFITS_AFTER = 12  # samples
_SURPRISED = 3.0  # standard deviations of a sample's chi-square: one in a hundred
_LITTLE = 0.01  # of the misfit of nothing, left by a jump that does not fit
_PAIR_AFTER = 3  # samples: two jets and their onsets explain nearly all of the six increments of one or two
_JUMP_AT_LEAST = 1000.0  # nats before settled: less is a start that still learns
_INCREMENT_AFTER = 25  # cycles: a filter that was a little off, no payload
_NOTHING_AFTER, _NOTHING_NEAR, _NOTHING_LATE = 12, 8.0, 75
_GROUP_AFTER = 100  # cycles: a leak that is not told apart in 8 s will not be soon
_GROUP_OF_LOSSES_AFTER = 4  # cycles: jets that fire together stay alike however long they do
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
        group: further jets that what has fired cannot tell from the winner's; of an open race those so far.
        shaken: whether it was decided because none of them explains the newest sample: something new has begun.
    """

    outcome: Outcome
    winner: Standing | None = None
    group: tuple[Contender, ...] = ()
    shaken: bool = False


def decided(race: Race, standing: list[Standing], settled: bool, rules: Rules, params: JointParams) -> Decision:
    """The decision after a cycle.

    Args:
        race: its screen has arrived at the present.
        standing: see `race.standings`.
        settled: whether the filter's start is over.
        rules: see `Rules`.
        params: see `JointParams`.
    """
    interrupted = _interrupted(race, standing)
    if interrupted is not None:
        return interrupted
    cycles = race.screen.cycle - race.triggered + 1
    jump = next(each for each in standing if each.contender.cause.kind == Kind.JUMP)
    best = standing[0]
    lead = best.contender.lead
    kind = best.contender.cause.kind
    clear = lead > rules.lead_nothing and all(margin(best, other) > rules.lead for other in standing[1:])
    if kind == Kind.JETS and best.run is not None and (jump.run is not None or jump.contender.lead < lead - OUT):
        large = settled or _large(best.contender, params)
        found = _of_jets(race, standing, cycles, clear, rules, params) if large else Decision(Outcome.OPEN)
        if found.outcome != Outcome.OPEN or found.group:
            return found
    if kind == Kind.JUMP and jump.run is not None and clear and _jump_explains(race, jump.run, cycles):
        if settled and lead > rules.jump:
            return Decision(Outcome.JUMP, jump)
        if cycles >= _INCREMENT_AFTER or (not settled and lead > _JUMP_AT_LEAST):
            return Decision(Outcome.INCREMENT, jump)
    if kind == Kind.LIES and best.run is not None and clear and cycles >= _LIE_AFTER:
        return Decision(Outcome.LIES, best)
    nothing_fits = race.screen.scores[-1].misfit < FIT
    if nothing_fits and cycles >= _NOTHING_AFTER and lead <= 0.0:
        return Decision(Outcome.NOTHING)
    if nothing_fits and cycles >= _NOTHING_LATE and lead <= _NOTHING_NEAR:
        return Decision(Outcome.NOTHING)
    if cycles >= LAST:
        return _at_last(standing, rules, nothing_fits)
    return Decision(Outcome.OPEN)


def _jump_explains(race: Race, run: Runner, cycles: int) -> bool:
    """Whether a jump may win: a large one fits only once the filter has learned it, but leaves little at once."""
    if run.score.misfit < FIT:
        return cycles >= _JUMP_AFTER
    little = run.score.misfit < _LITTLE * race.screen.scores[-1].misfit
    return little and cycles >= _JUMP_THAT_MISFITS_AFTER


def _of_jets(
    race: Race, standing: list[Standing], cycles: int, clear: bool, rules: Rules, params: JointParams
) -> Decision:
    best, run = standing[0].contender, standing[0].run
    assert run is not None, "only a filter of its own decides"
    significant = all(abs(force) > SIGNIFICANT * sigma for force, sigma in zip(best.force, best.sigma, strict=True))
    known = any(jet in race.states[0].slot_jet for jet in best.cause.jets)
    undecided = Decision(Outcome.OPEN)
    if run.cycle - run.onset < len(run.kicks):  # what is not known of its first intervals is not all in its state
        return undecided
    if run.score.misfit >= FIT or best.lead <= rules.lead_nothing or not (significant or known):
        return undecided
    if len(best.cause.jets) > 1 and cycles < _PAIR_AFTER:
        return undecided
    if clear:
        return Decision(Outcome.JETS, standing[0])
    group = _group(race, best, _near(standing, rules), rules, params)
    if group:
        patience = _GROUP_OF_LOSSES_AFTER if best.cause.signs[0] < 0 else _GROUP_AFTER
        return Decision(Outcome.GROUP if cycles >= patience else Outcome.OPEN, standing[0], group)
    return undecided


def _group(
    race: Race, best: Contender, near: tuple[Contender, ...], rules: Rules, params: JointParams
) -> tuple[Contender, ...]:
    """Those that differ from the best in one jet, which what has fired cannot tell from the best's; none: others are.

    They are few, or of one cluster.
    """
    if not all(each.cause.kind == Kind.JETS for each in near):
        return ()
    common = frozenset.intersection(best.cause.failures, *(each.cause.failures for each in near))
    differing = [[f for f in each.failures if (f.jet, f.sign) not in common] for each in (best, *near)]
    if any(len(each) != 1 for each in differing):
        return ()
    first, others = differing[0][0], [each[0] for each in differing[1:]]
    few = len(others) < _GROUP
    clusters = rules.clusters
    cluster = clusters is not None and len({int(clusters[each.jet]) for each in (first, *others)}) == 1
    if not (cluster or few):
        return ()
    shared = tuple(f for f in best.failures if (f.jet, f.sign) in common)
    apart = (screens.separation(race.screen, best.onset, (first, other), shared, params) for other in others)
    return near if all(each < ALIKE for each in apart) else ()


def _interrupted(race: Race, standing: list[Standing]) -> Decision | None:
    """The group that led, where none of it explains the newest sample; it waits for the next where that is in doubt.

    What begins in the midst of a sample favors one of the group by chance.
    """
    now = {each.contender.cause: each for each in standing}
    of_group = [now[each.cause] for each in race.leading if each.cause in now]
    surprises = [each.run.newest.misfit for each in of_group if each.run is not None]
    if not race.leading or len(surprises) < len(race.leading) or min(surprises) < _SURPRISED:
        return None
    shaken = min(surprises) >= FIT
    return Decision(Outcome.GROUP if shaken else Outcome.OPEN, of_group[0], race.leading[1:], shaken)


def _large(contender: Contender, params: JointParams) -> bool:
    """Whether each force is one that may be believed before settled."""
    jets = contender.cause.jets
    return all(f > UNSETTLED_FLOOR * params.thrusts[jet] for f, jet in zip(contender.force, jets, strict=True))


def _near(standing: list[Standing], rules: Rules) -> tuple[Contender, ...]:
    """Those that the best does not lead by enough."""
    return tuple(each.contender for each in standing[1:] if each.odds > standing[0].odds - rules.lead)


def _at_last(standing: list[Standing], rules: Rules, nothing_fits: bool) -> Decision:
    best = next((each for each in standing if each.run is not None), None)
    if best is None or best.contender.lead <= rules.lead_nothing:
        return Decision(Outcome.NOTHING if nothing_fits else Outcome.UNEXPLAINED)
    if best.run is not None and best.run.score.misfit >= FIT:
        return Decision(Outcome.UNEXPLAINED, best)
    if best.contender.cause.kind == Kind.JUMP:
        return Decision(Outcome.INCREMENT, best)
    near = _near(standing, rules)
    if best is standing[0] and all(c.cause.kind == Kind.JETS for c in (best.contender, *near)):
        return Decision(Outcome.GROUP, best, near)
    return Decision(Outcome.UNEXPLAINED, best)
