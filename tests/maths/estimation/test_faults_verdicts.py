"""Declarations of the hypothesis filter: made, withdrawn, groups, modes, and nothing while rivals wait."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from faults_probe import JETS, commands_of, fail, known_vehicle, make_params, samples_of
from numpy.testing import assert_array_equal

from massprop_drake.maths.estimation.faults import hypothesis_filter
from massprop_drake.maths.estimation.faults.declarations import (
    JumpDeclared,
    Mode,
    ReadingDeclared,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.faults.fault_events import ANEW, Event, Hypothesis, no_fault_hypothesis
from massprop_drake.maths.estimation.faults.proposals import Birth
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.faults.verdicts import (
    Verdicts,
    fault_probabilities,
    jet_fault_probabilities,
    pending_probability,
    update_verdicts,
)
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Cause, Kind, apply_cause
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence, step

PARAMS = make_params(quantum=3e-3)
JOINT = PARAMS.joint
THRUSTS = JOINT.thrusts


def hypothesis(weight: float, *failures: tuple[int, int, float], others: tuple[Cause, ...] = ()) -> Hypothesis:
    """A hypothesis of some log weight, by jet, sign and share of full thrust of its failures, each known to 1 %."""
    state, events = known_vehicle(JOINT)._replace(time_s=9.0), []
    for jet, sign, share in failures:
        cause = Cause(Kind.JETS, (jet,), (sign,), (0,))
        state = apply_cause(state, cause, JOINT)
        mean, root = state.mean.copy(), state.root.copy()
        row = JOINT.places.force + len(events)
        mean[row], root[row] = share * THRUSTS[jet], 0.0
        root[row, row] = 0.01 * THRUSTS[jet]
        state = state._replace(mean=mean, root=root)
        events.append(Event(cause, 8.0 + 0.1 * len(events), NO_SCORE))
    events += [Event(cause, 8.5, NO_SCORE) for cause in others]
    one = no_fault_hypothesis(state, 90, JOINT)
    run = one.run._replace(cause=events[-1].cause if events else one.run.cause, onset=80)
    return one._replace(run=run, events=tuple(events), weight=weight)


def tree_of(*hypotheses: Hypothesis, births: tuple[Birth, ...] = ()) -> Tree:
    return Tree(90, hypotheses, births)


def declared(tree: Tree, samples: int, verdicts: Verdicts | None = None) -> tuple[Verdicts, list[Any]]:
    """Declarations while nothing changes but the time."""
    verdicts, said = verdicts or Verdicts(), []
    for number in range(samples):
        later = tuple(
            each._replace(run=each.run._replace(state=each.run.state._replace(time_s=9.0 + 0.1 * number)))
            for each in tree.hypotheses
        )
        verdicts, more = update_verdicts(verdicts, tree._replace(hypotheses=later), PARAMS)
        said += more
    return verdicts, said


NOTHING = hypothesis(-12.0)
LEAKS = hypothesis(0.0, (3, 1, 0.3))


@pytest.mark.parametrize(
    ("happens", "behind"),
    [
        (LEAKS, 6.9),
        (hypothesis(0.0, others=(Cause(Kind.LIES, component=7),)), 6.9),
        (hypothesis(0.0, others=(Cause(Kind.UNKNOWN),)), 6.9),
        (hypothesis(0.0, others=(Cause(Kind.JUMP),)), 11.5),
    ],
)
def test_what_is_sure_is_declared_once(happens: Hypothesis, behind: float) -> None:
    """As many false declarations an hour of a payload as of a jet, which is a hundred times as rare: a thousandth."""
    for margin, count in ((-0.1, 0), (0.1, 1)):
        assert len(declared(tree_of(happens, NOTHING._replace(weight=-behind - margin)), 4)[1]) == count


@pytest.mark.parametrize(("weight", "withdrawn"), [(-0.1, False), (0.1, True)])
def test_what_becomes_less_likely_than_not_is_withdrawn(weight: float, withdrawn: bool) -> None:
    verdicts, (said,) = declared(tree_of(LEAKS, NOTHING), 2)
    assert (said.word, said.jets, said.signs, said.onset_s) == (Word.FAILED, (3,), (1,), 8.0)
    assert (said.forces[0], said.sigmas[0]) == (pytest.approx(0.3 * THRUSTS[3]), pytest.approx(0.01 * THRUSTS[3]))
    rest, said = declared(tree_of(LEAKS, NOTHING._replace(weight=weight)), 3, verdicts)
    assert [one.word for one in said] == [Word.WITHDRAWN] * withdrawn
    again = declared(tree_of(LEAKS, NOTHING), 3, rest)[1]
    assert [one.word for one in again] == [Word.FAILED] * withdrawn


def test_what_waits_keeps_a_jet_from_being_declared_or_withdrawn() -> None:
    """A rival without the jet, and a child with it; one that is hopeless does not."""
    both, rival = hypothesis(0.0, (3, 1, 0.3), (5, 1, 0.3)), hypothesis(0.0, (5, 1, 0.3))
    waits = tree_of(LEAKS, NOTHING, births=(Birth(rival, -4.0, LEAKS.events, 1.0),))
    assert pending_probability((3, 1), waits) == pytest.approx(np.exp(-3.0) / (1.0 + np.exp(-3.0)))
    assert pending_probability((5, 1), waits) == 0.0
    for birth, count in (
        (waits.births[0], 0),
        (Birth(rival, -14.0, LEAKS.events, 1.0), 1),
        (Birth(both, 0.0, None, 9.0), 1),
    ):
        assert len(declared(waits._replace(births=(birth,)), 5)[1]) == count
    verdicts, _ = declared(tree_of(LEAKS, NOTHING), 2)
    unlikely = tree_of(LEAKS._replace(weight=-20.0), NOTHING._replace(weight=0.0))
    for child, count in ((both, 0), (rival, 1)):
        births = (Birth(child, 4.0, NOTHING.events, 1.0),)
        assert len(declared(unlikely._replace(births=births), 1, verdicts)[1]) == count


def test_the_smallest_set_of_jets_of_which_one_has_failed_is_a_group_after_two_seconds() -> None:
    alike = tree_of(hypothesis(0.5, (3, 1, 0.3)), hypothesis(0.0, (5, 1, 0.2)), hypothesis(-9.0, (0, 1, 0.2)), NOTHING)
    assert declared(alike, 18)[1] == []
    verdicts, (said,) = declared(alike, 25)
    assert (said.word, said.jets, said.signs) == (Word.GROUP, (3, 5), (1, 1))
    assert said.forces == (pytest.approx(0.3 * THRUSTS[3]), pytest.approx(0.2 * THRUSTS[5]))
    assert declared(alike, 25, verdicts)[1] == []
    for before in ({(3, 1)}, {(3, 1), (5, 1), (0, 1)}):  # part of it, or it is part of what was declared
        assert declared(alike, 25, Verdicts(groups=frozenset({frozenset(before)})))[1] == []
    _, later = declared(tree_of(LEAKS, NOTHING), 3, verdicts)
    assert [(one.word, one.jets) for one in later] == [(Word.FAILED, (3,))]


def test_four_jets_are_no_group() -> None:
    alike = tree_of(*(hypothesis(0.0, (jet, 1, 0.3)) for jet in range(4)))
    assert declared(alike, 40)[1] == []


def test_a_force_below_what_is_called_a_failure_is_none() -> None:
    """A leak of less than two thousandths of full thrust, a loss of less than a tenth."""
    for sign, floor in ((1, 0.002), (-1, 0.1)):
        for share, expected in ((floor, 0.5), (floor + 0.01, 0.8413), (floor - 0.01, 0.1587)):
            found = jet_fault_probabilities(tree_of(hypothesis(0.0, (3, sign, share))), JOINT)
            assert found[3, sign] == pytest.approx(expected, abs=1e-3)


def test_a_fault_mode_is_what_its_force_is_like() -> None:
    for sign, share, walk, mode in (
        *((1, 0.9, 0.0, Mode.STUCK_ON), (1, 0.4, 0.0, Mode.LEAK), (-1, 0.95, 0.0, Mode.STUCK_OFF)),
        *((-1, 0.5, 0.0, Mode.LOSS), (1, 0.2, 0.03, Mode.DRIFTING), (-1, 0.2, ANEW, Mode.INTERMITTENT)),
    ):
        one = hypothesis(0.0, (3, sign, share))._replace(walks=np.array([walk, 0.0, 0.0, 0.0]))
        assert fault_probabilities(tree_of(one, NOTHING), JOINT).modes[3] == mode


def test_odds_add_up() -> None:
    push = Cause(Kind.UNKNOWN)
    tree = tree_of(
        hypothesis(0.0, (3, 1, 0.3)),
        hypothesis(-0.5, (5, -1, 0.8)),
        hypothesis(-1.0, (3, 1, 0.4), (5, -1, 0.7)),
        hypothesis(-2.0, others=(push,)),
        hypothesis(-3.0),
    )
    found, share = fault_probabilities(tree, JOINT), np.exp([0.0, -0.5, -1.0, -2.0, -3.0])
    share = share / share.sum()
    assert found.none == pytest.approx(share[4])
    assert found.unknown == pytest.approx(share[3])
    assert found.jets[3] == pytest.approx(share[0] + share[2])
    assert found.jets[5] == pytest.approx(share[1] + share[2])
    both = share[2]
    assert found.none + found.unknown + found.jets.sum() - both == pytest.approx(1.0)
    assert found.forces[3] == pytest.approx(0.3 * THRUSTS[3])
    assert found.forces[5] == pytest.approx(-0.8 * THRUSTS[5])
    assert np.isnan(np.delete(found.forces, [3, 5])).all()
    assert found.hypotheses == 5


def test_what_else_happens_is_declared_by_its_kind() -> None:
    earlier = known_vehicle(JOINT)._replace(time_s=8.4)
    causes = (Cause(Kind.JUMP), Cause(Kind.LIES, component=7), Cause(Kind.UNKNOWN))
    one = hypothesis(0.0, others=causes)._replace(earlier=earlier)
    verdicts, said = declared(tree_of(one, NOTHING), 4)
    assert {type(each) for each in said} == {JumpDeclared, ReadingDeclared, Unexplained}
    assert [each.onset_s for each in said] == [8.5] * 3
    assert next(each for each in said if isinstance(each, ReadingDeclared)).component == 7
    assert verdicts.earlier is earlier
    ended = hypothesis(0.0, others=(*causes, Cause(Kind.UNKNOWN)))
    assert declared(tree_of(ended, NOTHING), 4, verdicts)[1] == []


def test_a_jet_that_is_named_alone_is_out_of_use_until_it_is_well() -> None:
    """A jet leaks for a while: its declaration is withdrawn, and the autopilot uses it again."""
    changes = {20: fail(3, 0.3 * THRUSTS[3], 1, 1), 32: fail(3, 0.0, 1, 1)}
    samples, _ = samples_of(JOINT, commands_of(45, idle=(3,)), changes)
    state, filtered = hypothesis_filter.initial(PARAMS), known_vehicle(JOINT)
    states, probable = [], []
    for sample in samples:
        after, report = step(filtered, sample, JOINT)
        judgment = hypothesis_filter.judge(state, JointEvidence(filtered, after, report, sample, False), PARAMS)
        state, filtered = judgment.state, after if judgment.replacement is None else judgment.replacement
        states.append(state)
        probable.append(judgment.own.fault_probability[3])
    named = [state.verdicts.ways == {(3, 1)} for state in states]
    failed, well = named.index(True), 45 - named[::-1].index(True)
    assert 20 <= failed < 25
    assert 32 <= well < 37
    assert named[failed:well] == [True] * (well - failed)
    for declared, state in zip(named, states, strict=True):
        assert_array_equal(state.removed, 1.0 * declared * np.eye(JETS)[3])
        assert not np.delete(state.force, 3).any()
    assert states[30].force[3] == pytest.approx(0.3 * THRUSTS[3], rel=0.2)
    assert probable[30] > 0.999
    assert probable[-1] < 0.1  # that it leaks by less than is known
