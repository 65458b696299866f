r"""Those that may have failed instead, followed side by side until one explains what comes, and the others do not.

A group is named where something new begins before its members are told apart, or after long enough. The filter goes on
from the likeliest, which may be wrong: then the next failure has to be explained by one that has not happened, and what
takes its part is another jet, or a jump. A jet that is named alone leads by six nats, and so is wrong once in a few
hundred times. So the others that explain all, too, and have a filter go on as well, each with a detector of its own,
and each is worth

    L' = sum ln P(its cells)    and    L = -1/2 sum (e^T Y^-1 e + ln |Y|)

of its filter (`hypotheses`), to begin with what it was behind by; over the components that have moved, or have not for
six samples, of every sample at which none of them has a race open or has just decided one. Who is twelve nats behind by
both is not followed any longer, nor who has found no explanation in two seconds where another has, nor who needs a
further failure, or a jump, for what another explains without an alarm. Where that is the one that the filter goes on
from, the best takes its place, and what was said of it alone is taken back. What is said in the meantime waits until
each has decided, a second at most. Who is left alone of a group is named. A group that nothing has settled by the time
that a race may last stays one.
"""

from __future__ import annotations

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
    Word,
)
from massprop_drake.maths.estimation.joint.cycle import JointEvidence, Report, Sample, step
from massprop_drake.maths.estimation.joint.decision import LAST
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Counting, Score, after_cycle, counted_by_readings
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import readings
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

_BEHIND = 12.0  # nats: twice what decides, since each has decided other things since
_PATIENCE = 12  # cycles of a race for which what others say waits
_LOST = 25  # cycles of a race after which an explanation is overdue that another has found
_SETTLING = 3  # cycles after a decision before it counts: what is new may have begun in several ways


class Member(NamedTuple):
    """One of those that may have failed.

    Attributes:
        joint: its filter's state.
        method: what its detector remembers.
        score: see the module.
        waiting: what its detector has declared since, and has not been said.
        status: of the cycle in which it declared that last.
        newest: what the newest sample would add to the score.
        settled: cycles since its last decision; zero while a race is open.
        raced: cycles of a race that has just ended with something declared; else zero.
    """

    joint: JointState
    method: multi_hypothesis.State
    score: Score = NO_SCORE
    waiting: tuple[Declaration, ...] = ()
    status: Status = Status()
    newest: Score = NO_SCORE
    settled: int = 0
    raced: int = 0


class Members(NamedTuple):
    """All that are followed, the one first that the filter goes on from; none: nothing is open.

    Attributes:
        each: see `Member`.
        counting: see `Counting`.
        group: jets and signs of all of it; none: one was named alone.
        cycles: since then.
    """

    each: tuple[Member, ...] = ()
    counting: Counting | None = None
    group: frozenset[tuple[int, int]] = frozenset()
    cycles: int = 0


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
    read = readings(sample.rates, sample.velocities)
    if found.otherwise is not None and not members.each:
        said = list(found.declarations)
        counting = Counting(np.where(np.isnan(read), 0.0, read), np.zeros(read.shape[0]))
        others = tuple(
            Member(each.joint, each.state, Score(each.as_noise, each.odds, 0.0, 0.0), _unsaid(each.declarations, said))
            for each in multi_hypothesis.had_others_won(found.otherwise, params.joint)
        )
        groups = [each for each in found.declarations if isinstance(each, JetsDeclared) and each.word == Word.GROUP]
        group = frozenset(zip(groups[-1].jets, groups[-1].signs, strict=True)) if groups else frozenset()
        return Followed(found, Members((Member(now, found.state), *others), counting, group))
    if not members.each or members.counting is None:
        return Followed(found, members)
    if report.course is None:  # nothing before a gap can be compared
        return Followed(found._replace(declarations=(*members.each[0].waiting, *found.declarations)), Members())
    mask, counting = counted_by_readings(members.counting, read, np.zeros(read.shape[0], dtype=np.bool_), params.joint)
    each = [_after(members.each[0], found, now, report, mask, params.joint)]
    for member in members.each[1:]:
        gone_on = _gone_on(member, sample, mask, params)
        if gone_on is not None:
            each.append(gone_on)
    return _compared(found, members._replace(each=tuple(each), counting=counting, cycles=members.cycles + 1), params)


def _gone_on(member: Member, sample: Sample, mask: np.ndarray, params: HypothesisParams) -> Member | None:
    """A member after one more cycle; None where its detector finds no explanation, or its filter comes to nothing."""
    try:
        after, report = step(member.joint, sample, params.joint)
        judged = multi_hypothesis.judge(member.method, member.joint, after, report, sample, params)
    except (NotPositiveDefiniteError, np.linalg.LinAlgError):
        return None
    if report.course is None or any(isinstance(each, Unexplained) for each in judged.declarations):
        return None
    return _after(member, judged, judged.goes_on_from(after), report, mask, params.joint)


def _after(
    member: Member, judged: Judged, now: JointState, report: Report, mask: np.ndarray, params: JointParams
) -> Member:
    race = member.method.race
    decided = race is not None and judged.state.race is None
    settled = 0 if decided or judged.state.race is not None else member.settled + 1
    raced = race.cycles if race is not None and decided and any(map(_adds, judged.declarations)) else 0
    waiting = (*member.waiting, *judged.declarations)
    status = judged.status if judged.declarations else member.status
    newest = after_cycle(NO_SCORE, report, mask, params)
    return Member(now, judged.state, member.score, waiting, status, newest, settled, raced)


def _adds(declaration: Declaration) -> bool:
    """Whether it says that something more has happened."""
    if isinstance(declaration, JetsDeclared):
        return declaration.word in (Word.FAILED, Word.GROUP)
    return isinstance(declaration, JumpDeclared) and not declaration.measured


def _counted_in(each: tuple[Member, ...]) -> tuple[Member, ...]:
    """Members with the newest sample in their scores, if all have one to compare."""
    if any(member.settled < _SETTLING for member in each):
        return each
    scores = [Score(*(a + b for a, b in zip(one.score, one.newest, strict=True))) for one in each]
    return tuple(member._replace(score=score) for member, score in zip(each, scores, strict=True))


def _race_for(member: Member) -> int:
    """Cycles for which a race has been open without an explanation that fits; zero: none is."""
    race = member.method.race
    if race is None or race.leading or any(run.fits and run.cycle == race.screen.cycle for run in race.runs):
        return 0
    return race.cycles


def _ahead(one: Member, other: Member) -> float:
    """By how much a member is ahead of another by noise and by cells, nats: the least, as for hypotheses of a race."""
    return min(one.score.likelihood - other.score.likelihood, one.score.cells - other.score.cells)


def _needs_more(member: Member, each: tuple[Member, ...]) -> bool:
    """Whether it has just explained by something more what another explains as it is, without any alarm."""
    return member.raced > 0 and any(other.settled > member.raced for other in each)


def _left(each: tuple[Member, ...]) -> tuple[Member, ...]:
    """Those that are not lost and not behind, the best first where the first is none of them."""
    found = [member for member in each if _race_for(member) < _LOST and not _needs_more(member, each)]
    if not any(member.settled >= _SETTLING for member in found):
        found = list(each)
    best = max(found, key=lambda member: min(_ahead(member, other) for other in found))
    left = [member for member in found if _ahead(best, member) <= _BEHIND]
    return tuple(sorted(left, key=lambda member: (member is not each[0], member is not best)))


def _compared(found: Judged, members: Members, params: HypothesisParams) -> Followed:
    """What is said, by whom."""
    first, *_ = each = _counted_in(members.each)
    left = _left(each)
    said: list[Declaration] = []
    judged = found
    if left[0] is not first:
        said += _taken_back(first, left[0])
        first = left[0]
        judged = found._replace(state=first.method, replacement=first.joint, published=None)
    if any(_may_object(member, first) for member in left[1:]):
        status = _undecided(first) if first.waiting else found.status
        return Followed(judged._replace(declarations=tuple(said), status=status), members._replace(each=left))
    said += first.waiting
    if len(left) == 1 or members.cycles >= LAST:
        if len(left) == 1:
            state, alone = multi_hypothesis.left_alone(first.method, first.joint, members.group, params.joint)
            judged, said = judged._replace(state=state), [*alone, *said]
        return Followed(judged._replace(declarations=tuple(said)), Members())
    rest = tuple(other._replace(waiting=_unsaid(other.waiting, said)) for other in left[1:])
    return Followed(
        judged._replace(declarations=tuple(said)), members._replace(each=(first._replace(waiting=()), *rest))
    )


def _undecided(first: Member) -> Status:
    """What is logged while something waits: that hypotheses are compared, those that would be declared among them."""
    return first.status._replace(racing=True)


def as_said(members: Members, method: multi_hypothesis.State) -> multi_hypothesis.State:
    """What a detector remembers that goes on alone: what has not been said of jets is to be said by it."""
    if not members.each:
        return method
    first = members.each[0]
    for each in first.waiting:
        if isinstance(each, JetsDeclared) and each.word in (Word.FAILED, Word.GROUP):
            method = multi_hypothesis.unannounced(method, first.joint, each)
    return method


def _may_object(other: Member, first: Member) -> bool:
    """Whether what is said waits for another's race, for a second; or, of a jump, which explains nearly all, until that
    has been decided and compared.
    """
    jumped = any(isinstance(each, JumpDeclared) for each in first.waiting)
    if jumped and other.settled < _PATIENCE:
        return True
    race = other.method.race
    return race is not None and race.cycles <= _PATIENCE


def _unsaid(waiting: tuple[Declaration, ...], said: list[Declaration]) -> tuple[Declaration, ...]:
    """What is still to be said where a member turns out to be it."""
    told = [_in_short(each) for each in said]
    return tuple(each for each in waiting if _in_short(each) not in told)


def _in_short(declaration: Declaration) -> object:
    """What a declaration says, without its figures."""
    if isinstance(declaration, JetsDeclared):
        return declaration.word, frozenset(zip(declaration.jets, declaration.signs, strict=True))
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
