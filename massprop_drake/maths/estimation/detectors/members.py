r"""Those that may have failed instead, followed side by side until one explains what comes, and the others do not.

A group is found where something new begins before its members are told apart, or after long enough. The filter goes on
from the likeliest, which may be wrong: then the next failure has to be explained by one that has not happened, and what
takes its part is another jet, or a jump. A jet that is named alone leads by six nats, and so is wrong once in a few
hundred times. So the others that explain all, too, and have a filter go on as well, each with a detector of its own,
and whoever explains as well what one of these names goes on beside it in turn. Each is worth
the log likelihood of its filter, to begin with what it was behind by, over every sample at which none of them has a
race open or has just decided one. Who is twelve nats behind is not followed any longer, nor who has found no
explanation in two seconds where another has, nor who needs a
further failure, or a jump, for what another explains without an alarm, or more failures than another has explained all
by for two seconds. Where that is the one that the filter goes on from, the best takes its place, and what was said of
it alone is taken back. What is said in the meantime waits until each has decided, for a second, or two where that takes
fewer failures, and where they have found different things until they have been compared for a second. Of a group whose
members what has fired could tell apart, and which was found only since something new began, nothing is said while they
are followed. Who is left alone of one is named; what nothing has settled by the time that a race may last is said to be
a group of those that are left. Who never was followed, for want of a filter as far or of a place, has not been spoken
against, and stays in the group.

What shakes all that led may be no new failure: two at once look like one until something turns the body another way. So
where they are named for that, the race also goes on as if it were not decided, beside them. It takes their place if it
finds an explanation and none of them does, and ends when one of them has explained all for two seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.detectors import multi_hypothesis
from massprop_drake.maths.estimation.detectors.multi_hypothesis import (
    Declaration,
    HypothesisParams,
    JetsDeclared,
    Judged,
    JumpDeclared,
    Status,
    Unexplained,
    Way,
    Ways,
    Word,
    ways_of,
)
from massprop_drake.maths.estimation.joint.cycle import JointEvidence, Report, Sample, step
from massprop_drake.maths.estimation.joint.decision import LAST
from massprop_drake.maths.estimation.joint.hypotheses import (
    NO_SCORE,
    Score,
    told,
)
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

_BEHIND = 12.0  # nats: twice what decides, since each has decided other things since
_PATIENCE = 12  # cycles of a race for which what others say waits
_LOST = 25  # cycles of a race after which an explanation is overdue that another has found
_MOST = 4  # that are followed at once
_SETTLING = 3  # cycles after a decision before it counts: what is new may have begun in several ways


class Member(NamedTuple):
    """One of those that may have failed.

    Attributes:
        joint: its filter's state.
        method: what its detector remembers.
        score: see the module.
        waiting: what its detector has declared since, and has not been said.
        status: of the cycle in which it found the last group, else of that in which it declared something last.
        newest: what the newest sample would add to the score.
        settled: cycles since its last decision; zero while a race is open.
        compared: samples since its last decision that are in everybody's score.
        found: what it found when it last found anything, in short.
        raced: cycles of a race that has just ended with something declared; else zero.
        groups: that it has been found to belong to, itself the first of each.
        undecided: whether in it the race has gone on as if it were not decided.
    """

    joint: JointState
    method: multi_hypothesis.State
    score: Score = NO_SCORE
    waiting: tuple[Declaration, ...] = ()
    status: Status = Status()
    newest: Score = NO_SCORE
    settled: int = 0
    compared: int = 0
    found: frozenset[object] = frozenset()
    raced: int = 0
    groups: tuple[JetsDeclared, ...] = ()
    undecided: bool = False


class Members(NamedTuple):
    """All that are followed, the one first that the filter goes on from; none: nothing is open.

    Attributes:
        each: see `Member`.
        said: jets and signs of each group that has been said.
        cycles: since the first were.
        tried: who of each group has been followed, if only for a cycle.
    """

    each: tuple[Member, ...] = ()
    said: frozenset[Ways] = frozenset()
    cycles: int = 0
    tried: frozenset[tuple[Ways, Way]] = frozenset()


class Followed(NamedTuple):
    """What becomes of a cycle.

    Attributes:
        judged: as `multi_hypothesis.judge` has it of the one that the filter goes on from.
        members: to remember.
    """

    judged: Judged
    members: Members


def follow(
    members: Members, method: multi_hypothesis.State, evidence: JointEvidence, params: HypothesisParams
) -> Followed:
    """A cycle of the detector, with those that are followed beside.

    Args:
        members: after the last cycle.
        method: what the detector remembers of it.
        evidence: of the filter's cycle.
        params: see `HypothesisParams`.

    Raises:
        NotPositiveDefiniteError: see `joint.cycle.step`.
    """
    report, sample = evidence.report, evidence.sample
    found = multi_hypothesis.judge(method, evidence.before, evidence.after, report, sample, params)
    now = found.goes_on_from(evidence.after)
    if found.otherwise is not None and not members.each:
        until_now = Member(evidence.before, method)
        one = _after(until_now, found, now, report)._replace(newest=NO_SCORE)
        each = (one, *_beside(until_now, one, found, params.joint))
        return _said(one.waiting, found, Members(each, tried=_first_of_groups(each)))
    if not members.each:
        return Followed(found, members)
    if report.course is None:  # nothing before a gap can be compared
        return Followed(found._replace(declarations=(*members.each[0].waiting, *found.declarations)), Members())
    first = _after(members.each[0], found, now, report)
    on, further = [first], list(_beside(members.each[0], first, found, params.joint))
    for member in members.each[1:]:
        gone_on = _gone_on(member, sample, params)
        on += gone_on[:1]
        further += gone_on[1:]
    each = _at_most(on, further)
    known = [_known(one) for one in each]
    tried = members.tried | _first_of_groups([*on, *(one for one in further if _known(one) in known)])
    cycles = members.cycles + 1 if len(each) == len(on) else 0
    return _compared(found, members._replace(each=each, cycles=cycles, tried=tried), params)


def _first_of_groups(each: Iterable[Member]) -> frozenset[tuple[Ways, Way]]:
    """Whom members take of each of their groups."""
    return frozenset((ways_of(group), _first(group)) for member in each for group in member.groups)


def _first(group: JetsDeclared) -> Way:
    """Likeliest jet of a group, and its sign."""
    return group.jets[0], group.signs[0]


def _gone_on(member: Member, sample: Sample, params: HypothesisParams) -> tuple[Member, ...]:
    """A member after one more cycle, and who is as likely as what it names then; none where its detector finds no
    explanation, or its filter comes to nothing.
    """
    try:
        after, report = step(member.joint, sample, params.joint)
        judged = multi_hypothesis.judge(member.method, member.joint, after, report, sample, params)
    except (NotPositiveDefiniteError, np.linalg.LinAlgError):
        return ()
    if report.course is None or any(isinstance(each, Unexplained) for each in judged.declarations):
        return ()
    one = _after(member, judged, judged.goes_on_from(after), report)
    return one, *_beside(member, one, judged, params.joint)


def _beside(before: Member, one: Member, judged: Judged, params: JointParams) -> Iterator[Member]:
    """Who might have been instead of what a member has just named, each with its own view of it.

    Args:
        before: the member before the cycle.
        one: after it.
        judged: what it made of it.
        params: see `JointParams`.
    """
    if judged.otherwise is None:
        return
    for each in multi_hypothesis.had_others_won(judged.otherwise, params):
        score = Score(before.score.likelihood + each.odds, 0.0, 0.0)
        other = before._replace(
            joint=each.joint,
            method=each.state,
            score=score,
            settled=0,
            compared=0,
            found=one.found,
            raced=one.raced,
        )
        yield _has_found(other, each.declarations, judged)
    if judged.otherwise.named.shaken:
        state = multi_hypothesis.goes_on(judged.otherwise)
        yield before._replace(joint=judged.otherwise.joint, method=state, settled=0, raced=0, undecided=True)


def _has_found(member: Member, declarations: tuple[Declaration, ...], judged: Judged) -> Member:
    """A member with what it has found; of groups that are followed because something new has begun nothing waits to be
    said.
    """
    groups = tuple(each for each in declarations if isinstance(each, JetsDeclared) and each.word == Word.GROUP)
    named = None if judged.otherwise is None else judged.otherwise.named
    followed = named is not None and (named.shaken or len(named.alternatives) > 1)
    others = tuple(each for each in declarations if not (isinstance(each, JetsDeclared) and each.word == Word.GROUP))
    return member._replace(
        waiting=(*member.waiting, *(others if followed else declarations)),
        groups=(*member.groups, *groups),
        status=judged.status if groups or (declarations and not member.groups) else member.status,
    )


def _at_most(each: list[Member], further: list[Member]) -> tuple[Member, ...]:
    """Those that are followed and who comes beside, but for those of whom there is one already and the least likely."""
    found = [one for one in each if not one.undecided]
    for one in sorted(further, key=lambda member: -_worth(member)):
        new = not one.undecided and all(_known(one) != _known(other) for other in found)
        if new and len(found) < _MOST:
            found.append(one)
    undecided = [one for one in (*each, *further) if one.undecided]
    return *found, *undecided[:1]


def _worth(member: Member) -> float:
    return member.score.likelihood


def _known(member: Member) -> Ways:
    """Jets and signs of a member's known failures."""
    joint = member.joint
    slots = np.flatnonzero(joint.slot_jet >= 0)
    return frozenset((int(joint.slot_jet[slot]), int(joint.slot_sign[slot])) for slot in slots.tolist())


def _after(member: Member, judged: Judged, now: JointState, report: Report) -> Member:
    race, more = member.method.race, tuple(each for each in judged.declarations if _adds(each))
    decided = bool(more) or (race is not None and judged.state.race is None)
    settled = 0 if decided or judged.state.race is not None else member.settled + 1
    member = _has_found(member, judged.declarations, judged)
    return member._replace(
        joint=now,
        method=judged.state,
        newest=told(report),
        settled=settled,
        compared=member.compared if settled > 0 else 0,
        found=frozenset(map(_in_short, more)) if more else member.found,
        raced=race.cycles if race is not None and more else 0,
    )


def _adds(declaration: Declaration) -> bool:
    """Whether it says that something more has happened."""
    if isinstance(declaration, JetsDeclared):
        return declaration.word in (Word.FAILED, Word.GROUP)
    return isinstance(declaration, JumpDeclared) and not declaration.measured


def _counted_in(each: tuple[Member, ...]) -> tuple[Member, ...]:
    """Members with the newest sample in their scores, if all have one to compare."""
    if any(member.settled < _SETTLING for member in each if not member.undecided):
        return each
    scores = [one.score.plus(one.newest) for one in each]
    return tuple(
        member._replace(score=score, compared=member.compared + 1) for member, score in zip(each, scores, strict=True)
    )


def _race_for(member: Member) -> int:
    """Cycles for which a race has been open without an explanation that fits; zero: none is."""
    race = member.method.race
    if race is None or race.leading:
        return 0
    arrived = [run for run in race.runs if run.cycle == race.screen.cycle]
    return race.cycles if arrived and not any(run.fits for run in arrived) else 0


def _ahead(one: Member, other: Member) -> float:
    """By how much a member is ahead of another, nats."""
    return one.score.likelihood - other.score.likelihood


def _needs_more(member: Member, each: tuple[Member, ...]) -> bool:
    """Whether it has just explained by something more what another explains as it is, without any alarm, or explains by
    more failures, or what leads its race after two seconds does, what another has for as long, without a jump, which
    would explain anything.
    """
    race = member.method.race
    if member.raced == 0 and (race is None or race.cycles < _LOST):
        return False
    failures = _taken(member)
    as_well = [other for other in each if other.settled >= _LOST and len(_known(other)) < len(failures)]
    as_well = [other for other in as_well if not _has_jumped(other)]
    return bool(as_well) or (member.raced > 0 and any(other.settled > member.raced for other in each))


def _comes_and_goes(one: Member, other: Member) -> bool:
    """Whether a jet of one comes and goes, and explains all without what another has failed besides.

    That a force may be anything in every sample costs it more nats than forces cost that stay for a while. So two
    against each other, one of them stuck and the other coming and going, would be likelier than one that does.
    """
    return one.settled >= _SETTLING and bool((one.method.erratic == 1.0).any()) and _known(one) < _known(other)


def _has_jumped(member: Member) -> bool:
    """Whether a jump waits to be said, which explains nearly all."""
    return any(isinstance(each, JumpDeclared) for each in member.waiting)


def _taken(member: Member) -> Ways:
    """Jets and signs that a member explains by, of its race what leads; empty while nobody does."""
    race = member.method.race
    if race is None:
        return _known(member)
    leading = [zip(each.cause.jets, each.cause.signs, strict=True) for each in race.leading[:1]]
    return _known(member).union(*leading) if leading else frozenset()


def _left(each: tuple[Member, ...], behind: float) -> tuple[Member, ...]:
    """Those that are not lost and not so far behind, nats, the best first where the first is none of them."""
    decided = [member for member in each if not member.undecided]
    found = [member for member in decided if _race_for(member) < _LOST and not _needs_more(member, each)]
    found = [member for member in found if not any(_comes_and_goes(other, member) for other in found)]
    undecided = [] if any(member.settled >= _LOST for member in found) else [one for one in each if one.undecided]
    if not found and any(one.settled >= _SETTLING for one in undecided):
        return (undecided[0]._replace(undecided=False),)
    if not any(member.settled >= _SETTLING for member in found):
        found = decided
    best = max(found, key=lambda member: min(_ahead(member, other) for other in found))
    left = [member for member in found if _ahead(best, member) <= behind]
    return *sorted(left, key=lambda member: (member is not each[0], member is not best)), *undecided


def _compared(found: Judged, members: Members, params: HypothesisParams) -> Followed:
    """What is said, by whom."""
    first, *_ = each = _counted_in(members.each)
    left = _left(each, _BEHIND if members.cycles < LAST else params.rules.lead)
    said: list[Declaration] = []
    judged = found
    if left[0] is not first:
        said += _taken_back(first, left[0])
        first = left[0]
        judged = found._replace(state=first.method, replacement=first.joint, published=None)
    members = members._replace(each=left)
    if any(_may_object(member, first) for member in left[1:] if not member.undecided):
        return _said(tuple(said), judged, members)
    over = len(left) == 1 or members.cycles >= LAST
    settled = _settled(left, members.tried, over=over)
    narrower = [_narrowed(member, settled, params.joint) for member in left]
    first, told = narrower[0]
    said += (each for each in told if ways_of(each) not in members.said)
    said += (each for each in first.waiting if _may_be_said(each, settled, members))
    judged = judged._replace(state=first.method)
    if over:
        status = judged.status if len(left) == 1 else _in_question(members)
        return Followed(judged._replace(declarations=tuple(said), status=status), Members())
    return _said(tuple(said), judged, members._replace(each=tuple(member for member, _ in narrower)))


def _settled(left: tuple[Member, ...], tried: frozenset[tuple[Ways, Way]], *, over: bool) -> dict[Ways, Ways]:
    """Who is left of each group of which one is, or any that nothing more will be found of: also those of it that have
    never been followed, since nothing has spoken against them.

    Args:
        left: those that are followed still.
        tried: see `Members`.
        over: whether nothing more will be found.
    """
    found: dict[Ways, Ways] = {}
    decided = [member for member in left if not member.undecided]
    for group in left[0].groups:
        ways = ways_of(group)
        takes = [{_first(each) for each in member.groups if ways_of(each) == ways} for member in decided]
        whom = frozenset(way for way in ways if (ways, way) not in tried).union(*takes)
        if over or (all(takes) and len(whom) == 1):
            found[ways] = whom
    return found


def _narrowed(
    member: Member, settled: dict[Ways, Ways], params: JointParams
) -> tuple[Member, tuple[JetsDeclared, ...]]:
    """A member that knows who is left of its groups, and what that says."""
    method = member.method
    told: list[JetsDeclared] = []
    for group in member.groups:
        if ways_of(group) in settled:
            method, said = multi_hypothesis.narrowed(method, member.joint, group, settled[ways_of(group)], params)
            told += said
    groups = tuple(each for each in member.groups if ways_of(each) not in settled)
    return member._replace(method=method, groups=groups), tuple(told)


def _may_be_said(waiting: Declaration, settled: dict[Ways, Ways], members: Members) -> bool:
    """Whether nothing better is said of it now, and what it is about has been said if it is a group."""
    if not isinstance(waiting, JetsDeclared):
        return True
    group = ways_of(waiting)
    held = (ways_of(each) for each in _held(members.each[0], members.said))
    known = group not in held or waiting.word == Word.GROUP
    return group not in settled and known


def _said(said: tuple[Declaration, ...], judged: Judged, members: Members) -> Followed:
    """What becomes of a cycle in which something is said, if only nothing, and those that are followed go on."""
    first, *others = members.each
    groups = (ways_of(each) for each in said if isinstance(each, JetsDeclared) and each.word == Word.GROUP)
    rest = tuple(other._replace(waiting=_unsaid(other.waiting, said)) for other in others)
    members = members._replace(
        each=(first._replace(waiting=_unsaid(first.waiting, said)), *rest), said=members.said.union(groups)
    )
    return Followed(_logged(judged._replace(declarations=said), members), members)


def _held(member: Member, said: frozenset[Ways]) -> tuple[JetsDeclared, ...]:
    """Groups that a member has found and that are not said while their members are followed."""
    return tuple(each for each in member.groups if ways_of(each) not in said)


def _logged(judged: Judged, members: Members) -> Judged:
    """With what is logged while something waits: that hypotheses are compared, and which."""
    first = members.each[0]
    if judged.status.racing or not (first.waiting or _held(first, members.said)):
        return judged
    return judged._replace(status=_in_question(members))


def _in_question(members: Members) -> Status:
    """What is logged of those that something waits for: their leads, of groups with what has come since."""
    first = members.each[0]
    leads = dict(first.status.leads)
    for member in members.each:
        for group, of_first in zip(_held(member, members.said), _held(first, members.said), strict=False):
            leads[group.jets[0]] = leads.get(of_first.jets[0], 0.0) + _worth(member) - _worth(first)
    return first.status._replace(racing=True, leads=tuple(leads.items()))


def as_said(members: Members, method: multi_hypothesis.State) -> multi_hypothesis.State:
    """What a detector remembers that goes on alone: what has not been said of jets is to be said by it."""
    if not members.each:
        return method
    first = members.each[0]
    for each in (*first.waiting, *_held(first, members.said)):
        if isinstance(each, JetsDeclared) and each.word in (Word.FAILED, Word.GROUP):
            method = multi_hypothesis.unannounced(method, first.joint, each)
    return method


def _may_object(other: Member, first: Member) -> bool:
    """Whether what is said waits for another.

    For a second of its race; of a jump until its race has been decided and compared. Of anything more for two seconds
    of its race, and two after it, where that takes fewer failures; and until they have been compared for a second where
    each has found something else last, but not longer than four seconds, or two of a race.
    """
    if _has_jumped(first) and other.settled < _PATIENCE:
        return True
    race = other.method.race
    if race is not None and race.cycles <= _PATIENCE:
        return True
    if not any(map(_adds, first.waiting)):
        return False
    if _takes_fewer(other, first) and (other.settled if race is None else race.cycles - 1) < _LOST:
        return True
    own = first.method.race
    compared = min(other.compared, first.compared) >= _PATIENCE
    lapsed = other.settled >= 2 * _LOST or (own is not None and own.cycles > _LOST)
    return race is None and bool(other.found - first.found) and not (compared or lapsed)


def _takes_fewer(other: Member, first: Member) -> bool:
    """Whether a member explains by fewer failures, and no jump, or what leads its race, what another has explained."""
    return 0 < len(_taken(other)) < len(_known(first)) and not _has_jumped(other)


def _unsaid(waiting: tuple[Declaration, ...], said: tuple[Declaration, ...]) -> tuple[Declaration, ...]:
    """What is still to be said where a member turns out to be it."""
    told = [_in_short(each) for each in said]
    return tuple(each for each in waiting if _in_short(each) not in told)


def _in_short(declaration: Declaration) -> object:
    """What a declaration says, without its figures."""
    if isinstance(declaration, JetsDeclared):
        return declaration.word, ways_of(declaration)
    return type(declaration)


def _taken_back(first: Member, best: Member) -> list[Declaration]:
    """Jets that were named by what turns out to be wrong, and that the best says nothing of."""
    known = multi_hypothesis.announced_jets(best.method, best.joint)
    waiting = {jet for each in first.waiting if isinstance(each, JetsDeclared) for jet in each.jets}
    return [
        JetsDeclared(Word.WITHDRAWN, (jet,), (sign,), (0.0,), (sigma,), first.joint.time_s)
        for (jet, sign), sigma in multi_hypothesis.announced_jets(first.method, first.joint).items()
        if (jet, sign) not in known and jet not in waiting
    ]
