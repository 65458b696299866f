"""Members of a group that are followed side by side."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import small_params, some_sample
from test_joint_bank import ready

from massprop_drake.maths.estimation.detectors import members as dut
from massprop_drake.maths.estimation.detectors import multi_hypothesis
from massprop_drake.maths.estimation.detectors.members import Member, Members
from massprop_drake.maths.estimation.detectors.multi_hypothesis import (
    JetsDeclared,
    Judged,
    JumpDeclared,
    Status,
    Word,
    ways_of,
)
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.cycle import JointEvidence, step
from massprop_drake.maths.estimation.joint.decision import LAST, Decision, Outcome
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Counted, Counting, Kind, Runner, Score, opened
from massprop_drake.maths.estimation.joint.race import Race
from massprop_drake.maths.estimation.joint.screen import Contender

PARAMS = small_params(second_order=False, flows=np.zeros(6), thrust_sigma=0.0)
STATE = ready()._replace(slot_jet=np.full(2, -1.0))
SETTLED = 20


def member(jet: int, likelihood: float = 0.0, cells: float | None = None, settled: int = SETTLED) -> Member:
    """One that has a group of jets 0 and 1 in its first slot, itself the likeliest, declared with a force of 3."""
    joint = opened(STATE, Cause(Kind.JETS, (jet,), (1,), (1,)), PARAMS)
    method = multi_hypothesis.initial(PARAMS)
    row = np.zeros(2 * PARAMS.places.jets)
    row[[jet, 1 - jet]] = 1.0, 2.0
    listed, announced = method.members.copy(), method.announced.copy()
    listed[0], announced[0] = row, 3.0
    method = method._replace(members=listed, announced=announced)
    score = Score(likelihood, likelihood if cells is None else cells, 0.0, 0.0)
    return Member(joint, method, score, settled=settled, groups=(group_of(jet, 1 - jet),))


def group_of(*jets: int) -> JetsDeclared:
    """A group as its first member sees it."""
    each = len(jets)
    return JetsDeclared(Word.GROUP, jets, (1,) * each, (3.0,) * each, (1.0,) * each, 7.0)


def racing(one: Member, cycles: int, fits: bool = False) -> Member:
    """It with a race that has been open so long."""
    screen = screens.begin((STATE, 0), (1,), (1,), np.zeros(12), PARAMS)._replace(cycle=cycles)
    score = Score(0.0, 0.0, 12.0 if fits else 100.0, 12.0)
    run = Runner(Cause(Kind.JETS, (2,), (1,), (1,)), 1, (), cycles, STATE, score, False)
    race = Race(1, (STATE, STATE), screen, (run,))
    return one._replace(method=one.method._replace(race=race), settled=0)


def judged(*each: Member, said: bool = True, cycles: int = 0, also: tuple[Member, ...] = ()) -> dut.Followed:
    """What becomes of a cycle; the group has been said, or not, and others have been followed before."""
    found = Judged(each[0].method, None, None, (), Status())
    groups = frozenset({frozenset({(0, 1), (1, 1)})} if said else ())
    counting = Counting(np.zeros(12), np.zeros(12))
    params = multi_hypothesis.HypothesisParams(PARAMS)
    tried = dut._first_of_groups((*each, *also))
    return dut._compared(found, Members(each, counting, groups, cycles, tried), params)


def words(found: dut.Followed) -> list[tuple[int, tuple[int, ...]]]:
    return [(each.word, each.jets) for each in found.judged.declarations if isinstance(each, JetsDeclared)]


@pytest.mark.parametrize(("likelihood", "cells", "told"), [(-13, -13, True), (-11, -13, False), (-13, -11, False)])
def test_who_is_behind_by_noise_and_by_cells_is_out_and_who_is_left_is_named(
    likelihood: float, cells: float, told: bool
) -> None:
    found = judged(member(0), member(1, likelihood, cells))
    assert words(found) == [(Word.FAILED, (0,))] * told
    assert len(found.members.each) == (0 if told else 2)
    assert found.judged.replacement is None
    assert np.count_nonzero(found.judged.state.members[0]) == (1 if told else 2)


def test_the_best_takes_the_place_of_one_that_is_behind() -> None:
    wrong, right = member(0, -13.0), member(1)
    waiting = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    found = judged(wrong, right._replace(waiting=(waiting,)))
    assert found.judged.replacement is right.joint
    assert found.judged.state.members[0].argmax() == 1
    assert words(found) == [(Word.FAILED, (1,)), (Word.FAILED, (3,))]


def test_what_was_said_of_the_wrong_one_alone_is_taken_back() -> None:
    """And not what has not been said yet, or what the right one says as well."""
    wrong, right = member(0, -13.0), member(1)
    joint = opened(wrong.joint, Cause(Kind.JETS, (2,), (1,), (1,)), PARAMS)
    listed, announced = wrong.method.members.copy(), wrong.method.announced.copy()
    listed[1, 2], announced[1] = 1.0, 5.0
    wrong = wrong._replace(joint=joint, method=wrong.method._replace(members=listed, announced=announced))
    assert words(judged(wrong, right)) == [(Word.WITHDRAWN, (2,)), (Word.FAILED, (1,))]
    unsaid = JetsDeclared(Word.FAILED, (2,), (1,), (5.0,), (1.0,), 0.0)
    assert words(judged(wrong._replace(waiting=(unsaid,)), right)) == [(Word.FAILED, (1,))]


@pytest.mark.parametrize(("cycles", "fits", "lost"), [(24, False, False), (25, False, True), (25, True, False)])
def test_who_finds_no_explanation_that_another_has_is_lost(cycles: int, fits: bool, lost: bool) -> None:
    found = judged(racing(member(0), cycles, fits), member(1))
    assert (found.judged.replacement is not None) == lost


def test_who_needs_a_jump_for_what_another_explains_as_it_is_is_lost() -> None:
    """And that jump is not said."""
    jump = JumpDeclared(False, 0.0, 1.0, 0.1, np.zeros(3), np.ones(3))
    for raced, expected in ((SETTLED - 1, True), (SETTLED, False), (0, False)):
        found = judged(member(0, settled=0)._replace(raced=raced, waiting=(jump,)), member(1))
        assert (found.judged.replacement is not None) == expected
        assert jump not in found.judged.declarations or not expected


@pytest.mark.parametrize(("said", "adds"), [(Word.FAILED, True), (Word.GROUP, True), (Word.CHANGED, False)])
def test_a_further_failure_is_something_more(said: Word, adds: bool) -> None:
    assert dut._adds(JetsDeclared(said, (3,), (1,), (10.0,), (1.0,), 0.0)) == adds


def test_while_nobody_has_an_explanation_nobody_is_lost() -> None:
    assert len(judged(racing(member(0), 50), racing(member(1), 50)).members.each) == 2


def test_what_is_said_waits_for_a_race_that_is_young_and_a_jump_for_any() -> None:
    said = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    jump = JumpDeclared(False, 0.0, 1.0, 0.1, np.zeros(3), np.ones(3))
    for each, other, expected in (
        (said, racing(member(1), 11), False),
        (said, racing(member(1), 13), True),
        (said, member(1), True),
        (jump, racing(member(1), 20), False),
        (jump, member(1, settled=11), False),
        (jump, member(1), True),
    ):
        found = judged(member(0)._replace(waiting=(each,)), other)
        assert (each in found.judged.declarations) == expected
        assert bool(found.members.each[0].waiting) != expected


def knowing(one: Member, jet: int) -> Member:
    """It with a further jet in its second slot."""
    slots = one.joint.slot_jet.copy()
    slots[1] = jet
    return one._replace(joint=one.joint._replace(slot_jet=slots, slot_sign=np.ones(2)))


def led(one: Member, *causes: Cause) -> Member:
    """It with hypotheses that lead its race."""
    race = one.method.race
    assert race is not None
    leading = tuple(Contender(cause, 1, 50.0, (3.0,), (0.1,)) for cause in causes)
    return one._replace(method=one.method._replace(race=race._replace(leading=leading)))


def test_what_takes_more_failures_than_another_finds_waits_two_seconds_for_it() -> None:
    """Two jets that fail at once are rare, but explain nearly as much as a group's wrong member and one jet do."""
    said = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    third = Cause(Kind.JETS, (4,), (1,), (1,))
    first = knowing(member(0), 3)._replace(waiting=(said,))
    for other, expected in (
        (member(1, settled=24), False),
        (member(1, settled=25), True),
        (knowing(member(1, settled=0), 4), True),
        (member(1, settled=24)._replace(waiting=(JumpDeclared(False, 0.0, 1.0, 0.1, np.zeros(3), np.ones(3)),)), True),
        (led(racing(member(1), 25), third), True),  # takes as many
        (led(racing(member(0), 25), Cause(Kind.JETS, (0,), (1,), (1,))), False),
        (led(racing(member(0), 26), Cause(Kind.JETS, (0,), (1,), (1,))), True),
        (racing(member(1), 13), True),  # nobody leads
    ):
        found = judged(first, other)
        assert (said in found.judged.declarations) == expected


def test_what_another_finds_in_place_of_what_is_said_is_compared_for_a_second_first() -> None:
    """By samples that count for all, of which there are none while a third is undecided; for four seconds at most."""
    said = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    third = member(4, settled=2)
    for own, its, beside, settled, differ, expected in (
        (10, 20, (), 20, True, False),
        (20, 10, (), 20, True, False),
        (11, 11, (), 20, True, True),
        (11, 11, (third,), 49, True, False),
        (11, 11, (third,), 50, True, True),
        (0, 0, (), 20, False, True),
    ):
        first = member(0)._replace(waiting=(said,), compared=own, found=frozenset({3}))
        other = member(1, settled=settled)._replace(compared=its, found=frozenset({4 if differ else 3}))
        assert (said in judged(first, other, *beside).judged.declarations) == expected
    alone = member(0)._replace(found=frozenset({3}))
    assert not dut._may_object(member(1)._replace(found=frozenset({4})), alone)  # has nothing to say
    for cycles, expected in ((25, True), (26, False)):
        one = racing(first._replace(compared=0), cycles, fits=True)
        assert dut._may_object(member(1)._replace(found=frozenset({4})), one) == expected


def test_what_has_been_found_is_known_from_decision_to_decision() -> None:
    """Also where a race is decided in the cycle in which it begins; who goes on beside has found it in its way."""
    after, report = step(STATE, some_sample(PARAMS), PARAMS)
    nobody = np.zeros(report.used.shape[0], dtype=np.bool_)
    said = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    for declared, expected, settled in (((said,), {(Word.FAILED, ways_of(said))}, 0), ((), {9}, SETTLED + 1)):
        found = Judged(multi_hypothesis.initial(PARAMS), None, None, declared, Status())
        one = member(0)._replace(compared=5, found=frozenset({9}))
        gone_on = dut._after(one, found, after, report, Counted(nobody, nobody), PARAMS)
        assert gone_on.found == expected
        assert gone_on.settled == settled
        assert gone_on.compared == (0 if declared else 5)


def test_samples_that_have_been_compared_are_counted_from_a_decision_on() -> None:
    after, report = step(STATE, some_sample(PARAMS), PARAMS)
    found = Judged(multi_hypothesis.initial(PARAMS), None, None, (), Status())
    nobody = np.zeros(report.used.shape[0], dtype=np.bool_)
    for one, expected in ((member(0), 5), (racing(member(0), 20, fits=True), 0)):
        gone_on = dut._after(one._replace(compared=5), found, after, report, Counted(nobody, nobody), PARAMS)
        assert gone_on.compared == expected


def test_while_something_waits_hypotheses_are_compared() -> None:
    """So that where the run ends, it is listed as what was not decided."""
    said = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (1.0,), 0.0)
    first = member(0)._replace(waiting=(said,), status=Status(leads=((3, 50.0),)))
    for each, expected in ((first, True), (member(0), False)):
        found = judged(each, racing(member(1), 5))
        assert found.judged.status.racing == expected
        assert found.judged.status.leads == (((3, 50.0),) if expected else ())


def test_what_waits_is_to_be_said_by_a_detector_that_goes_on_alone() -> None:
    first = member(0)
    said = JetsDeclared(Word.FAILED, (0,), (1,), (3.0,), (1.0,), 7.0)
    kept = dut.as_said(Members((first._replace(waiting=(said,)), member(1))), first.method)
    assert kept.announced[0] == 0.0
    assert kept.onsets[0] == 7.0
    both = Members((first, member(1)))
    assert dut.as_said(both, first.method).announced[0] == 0.0
    assert dut.as_said(both._replace(said=frozenset({ways_of(group_of(0, 1))})), first.method).announced[0] == 3.0
    assert dut.as_said(Members(), first.method) is first.method


def test_whoever_explains_all_is_followed_from_what_it_is_behind_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """And says what it has to say only if it turns out to be it."""
    named, other = member(0), member(1)
    said, instead = (JetsDeclared(Word.FAILED, (jet,), (1,), (3.0,), (1.0,), 0.0) for jet in (0, 1))
    would = multi_hypothesis.Other(other.method, other.joint, (instead,), -8.0, -10.0)
    decision = Decision(Outcome.JETS)
    otherwise = multi_hypothesis.Otherwise(named.method, named.joint, decision, (decision,))
    found = Judged(named.method, None, None, (said,), Status(), otherwise)
    monkeypatch.setattr(multi_hypothesis, "judge", lambda *_: found)
    monkeypatch.setattr(multi_hypothesis, "had_others_won", lambda *_: (would,))
    sample = some_sample(PARAMS)
    evidence = JointEvidence(STATE, *step(STATE, sample, PARAMS), sample, False)
    after = dut.follow(Members(), named.method, evidence, multi_hypothesis.HypothesisParams(PARAMS))
    assert after.judged.declarations == (said,)
    assert [each.waiting for each in after.members.each] == [(), (instead,)]
    assert after.members.each[1].score == Score(-8.0, -10.0, 0.0, 0.0)
    assert after.members.said == frozenset()


def test_a_group_that_is_followed_since_something_new_began_is_not_said_before_it_is_told_apart() -> None:
    """What waits of it neither, but that hypotheses are compared is logged, with how likely each is."""
    changed = JetsDeclared(Word.CHANGED, (0, 1), (1, 1), (3.0, np.nan), (1.0, np.nan), 7.0)
    status = Status(leads=((0, 50.0), (1, 48.0)))
    first, other = member(0)._replace(waiting=(changed,), status=status), member(1, -5.0)
    found = judged(first, other, said=False)
    assert found.judged.declarations == ()
    assert found.judged.status.racing
    assert found.judged.status.leads == ((0, 50.0), (1, 45.0))
    found = judged(first._replace(waiting=()), member(1, -13.0), said=False)
    assert words(found) == [(Word.FAILED, (0,))]
    (said,) = found.judged.declarations
    assert isinstance(said, JetsDeclared)
    assert said.onset_s == 7.0


@pytest.mark.parametrize(("behind", "told"), [(-5.0, (Word.GROUP, (0, 1))), (-7.0, (Word.FAILED, (0,)))])
def test_what_nothing_settles_is_a_group_of_those_that_are_left(
    behind: float, told: tuple[int, tuple[int, ...]]
) -> None:
    found = judged(member(0), member(1, behind), said=False, cycles=LAST)
    assert words(found) == [told]
    assert found.members == Members()


def test_who_has_never_been_followed_stays_in_the_group() -> None:
    """Nothing has spoken against it: so said at the end, and not before."""
    for settled, told in ((25, [(Word.GROUP, (0, 1))]), (24, [])):
        assert words(judged(member(0, settled=settled), undecided(0), said=False)) == told
    found = judged(member(0, settled=24), undecided(0), said=False, also=(member(1),))
    assert words(found) == [(Word.FAILED, (0,))]


def test_who_has_been_followed_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also who is the same as one that is followed already."""
    first, other = member(0), member(1)
    monkeypatch.setattr(dut, "_beside", lambda *_: (other,))
    monkeypatch.setattr(multi_hypothesis, "judge", lambda state, *_: Judged(state, None, None, (), Status()))
    sample = some_sample(PARAMS)
    evidence = JointEvidence(STATE, *step(STATE, sample, PARAMS), sample, False)
    params = multi_hypothesis.HypothesisParams(PARAMS)
    for each in ((first,), (first, other._replace(groups=()))):
        counting = Counting(np.zeros(12), np.zeros(12))
        after = dut.follow(Members(each, counting), first.method, evidence, params)
        group = ways_of(group_of(0, 1))
        assert after.members.tried == {(group, (0, 1)), (group, (1, 1))}


def test_what_is_agreed_on_is_said_while_another_group_is_followed() -> None:
    """And nobody speaks of it again."""
    second = group_of(2, 3)
    both = [one._replace(groups=(*one.groups, second)) for one in (member(0), member(0, -5.0))]
    found = judged(both[0], both[1], said=False, also=(member(1),))
    assert (Word.FAILED, (0,)) in words(found)
    assert all(ways_of(group) != frozenset({(0, 1), (1, 1)}) for one in found.members.each for group in one.groups)


def test_who_needs_more_failures_than_another_explains_all_by_is_lost() -> None:
    """Where that one has explained all for two seconds, and not by a jump."""
    jump = JumpDeclared(False, 0.0, 1.0, 0.1, np.zeros(3), np.ones(3))
    joint = opened(member(0).joint, Cause(Kind.JETS, (2,), (1,), (1,)), PARAMS)
    greedy = member(0, settled=0)._replace(joint=joint, raced=60)
    for settled, expected in ((25, True), (24, False)):
        assert (judged(greedy, member(1, settled=settled)).judged.replacement is not None) == expected
    jumped = member(1, settled=25)._replace(waiting=(jump,))
    assert judged(greedy, jumped).judged.replacement is None


def test_a_jet_that_comes_and_goes_is_not_two_against_each_other() -> None:
    """Whatever the forces of two say, which stay where those of one may be anything in every sample."""
    erratic = np.array([1.0, 0.0])
    restless = member(0)._replace(method=member(0).method._replace(erratic=erratic))
    more = knowing(member(0, 100.0), 2)
    for one, settled, lost in ((restless, 3, True), (restless, 2, False), (member(0), 3, False)):
        for each in ((one._replace(settled=settled), more), (more, one._replace(settled=settled))):
            assert all(left is not more for left in dut._left(each, 12.0)) == lost


def test_whose_race_is_led_by_more_failures_than_another_explains_all_by_is_lost() -> None:
    """Where nobody leads it may come to anything."""
    more, as_many = Cause(Kind.JETS, (2, 3), (1, 1), (1, 1)), Cause(Kind.JETS, (2,), (1,), (1,))
    other = knowing(member(1, settled=25), 3)
    for cause, settled, cycles, expected in (
        (more, 25, 25, True),
        (more, 25, 24, False),
        (as_many, 25, 60, False),
        (more, 24, 60, False),
        (None, 25, 60, False),
    ):
        one = racing(member(0), cycles, fits=True)
        one = one if cause is None else led(one, cause)
        assert (judged(one, other._replace(settled=settled)).judged.replacement is not None) == expected


def undecided(settled: int) -> Member:
    """The race gone on as if it were not decided; it has found an explanation so long ago."""
    return member(2, settled=settled)._replace(groups=(), undecided=True)


def test_the_race_that_goes_on_wins_where_nobody_who_was_named_explains_what_came() -> None:
    lost = racing(member(0), 25)
    found = judged(lost, undecided(3))
    assert found.judged.replacement is not None
    assert 2 in found.judged.replacement.slot_jet
    assert not any(one.undecided for one in found.members.each)
    for first, other in (
        (racing(member(0), 24), undecided(3)),
        (lost, undecided(2)),
        (member(0, settled=3), undecided(9)),
    ):
        kept = judged(first, other)
        assert kept.judged.replacement is None
        assert [one.undecided for one in kept.members.each] == [False, True]


def test_the_race_that_goes_on_ends_when_somebody_has_explained_all_for_two_seconds() -> None:
    for settled, expected in ((24, 2), (25, 0)):
        assert len(judged(member(0, settled=settled), undecided(0)).members.each) == expected


def test_at_most_four_are_followed_the_likeliest_of_those_that_come_and_none_twice() -> None:
    each = [member(0), member(1)]
    further = [member(jet, likelihood) for jet, likelihood in ((2, -3.0), (3, -1.0), (4, -2.0), (1, 0.0))]
    found = dut._at_most(each, [*further, undecided(0), undecided(0)])
    assert [max(jet for jet, _ in dut._known(one)) for one in found[:4]] == [0, 1, 3, 4]
    assert [one.undecided for one in found[4:]] == [True]


def test_samples_count_where_all_have_one_to_compare() -> None:
    newest = Score(5.0, 4.0, 3.0, 2.0)
    for settled, expected in ((3, 5.0), (2, 0.0)):
        found = judged(member(0)._replace(newest=newest), member(1, settled=settled)._replace(newest=newest))
        assert [each.score.likelihood for each in found.members.each] == [expected, expected]
