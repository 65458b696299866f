"""Hypotheses and their events: the same by which key, twins of a jet on top of its commands or in their place, gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from faults_probe import commands_of, fail, flight, known_vehicle, make_params, samples_of
from joint_probe import some_sample

from massprop_drake.maths.estimation.faults.fault_events import (
    ANEW,
    Event,
    Hypothesis,
    begun,
    behind,
    force_of,
    gone_on,
    regained,
    split,
    weighed,
)
from massprop_drake.maths.estimation.faults.priors import force_correction, log_possible
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Cause, Kind, opened

PARAMS = make_params()
JOINT = PARAMS.joint


def hypothesis(*causes: Cause) -> Hypothesis:
    """A hypothesis with these events, the forces of its jets in slots, half of full thrust each."""
    state = known_vehicle(JOINT)
    for cause in causes:
        state = opened(state, cause, JOINT) if cause.kind == Kind.JETS else state
    mean = state.mean.copy()
    mean[JOINT.places.force :] = np.where(state.slot_jet >= 0, 0.5 * JOINT.thrusts[state.slot_jet.astype(int)], 0.0)
    one = begun(state._replace(mean=mean), 5, JOINT)
    events = tuple(Event(cause, float(number), NO_SCORE) for number, cause in enumerate(causes))
    run = one.run._replace(cause=causes[-1] if causes else one.run.cause, onset=3)
    return one._replace(run=run, events=events)


def of_jet(jet: int, sign: int = 1, on_top: int = 0) -> Cause:
    return Cause(Kind.JETS, (jet,), (sign,), (on_top,))


@pytest.mark.parametrize("kind", [Kind.JUMP, Kind.LIES, Kind.UNKNOWN])
def test_a_jet_is_nothing_else_that_has_its_number(kind: Kind) -> None:
    """The loss of jet 4 is no unknown push, that of jet 2 no jump; a leak of jet 3 no false reading of component 1."""
    sign = 1 if kind == Kind.LIES else -1
    other = Cause(kind, component=sign)
    one = hypothesis(of_jet(int(kind), sign), other)
    assert set(hypothesis(of_jet(int(kind), sign)).parts).isdisjoint(hypothesis(other).parts)
    assert one.parts[-1] == (kind, sign, 0)


def test_histories_are_the_same_by_what_happened_in_any_order_and_what_is() -> None:
    one = hypothesis(of_jet(2), of_jet(4, -1))
    assert one.key == hypothesis(of_jet(4, -1), of_jet(2))._replace(weight=7.0, prior=-3.0).key
    others = [
        hypothesis(of_jet(2)),
        hypothesis(of_jet(2), of_jet(4, -1), of_jet(4, -1)),
        hypothesis(of_jet(2, on_top=1), of_jet(4, -1)),
        hypothesis(of_jet(2), of_jet(4, 1)),
        one._replace(push=0.1),
        one._replace(walks=np.array([ANEW, 0.0, 0.0, 0.0])),
    ]
    assert len({each.key for each in (one, *others)}) == 7


def test_a_jet_that_gives_too_much_is_on_top_or_in_place_once_it_is_commanded() -> None:
    """Twins, each with half of the prior; later commands ask no more."""
    one = hypothesis(of_jet(2), of_jet(4, -1))
    idle = some_sample(JOINT, commands=np.array([[1.0, 1, 0, 1, 1, 1]]))
    assert split(one, idle) == (one,)
    fires = some_sample(JOINT, commands=np.array([[0.0, 0, 1, 0, 0, 0]]))
    twins = split(one, fires)
    assert [each.run.state.slot_on_top[0] for each in twins] == [0.0, 1.0]
    for each in twins:
        assert each.prior == pytest.approx(one.prior - math.log(2.0))
        assert each.decided == {2}
        assert each.run.state.slot_on_top[1] == one.run.state.slot_on_top[1]
        assert split(each, fires) == (each,)
    assert twins[0].key != twins[1].key


def test_a_proposal_is_compared_with_what_another_was_worth_at_the_same_cycle() -> None:
    other = hypothesis()._replace(prior=-1.0)
    for cycle, likelihood in ((6, -2.0), (7, -3.0), (8, -3.5)):
        score = NO_SCORE._replace(likelihood=likelihood)
        other = gone_on(other, other.run._replace(cycle=cycle, score=score), JOINT)
    one = hypothesis(of_jet(2))._replace(prior=-17.0)
    one = one._replace(run=one.run._replace(onset=5, cycle=7, score=NO_SCORE._replace(likelihood=-8.0)))
    assert behind(one, other) == pytest.approx((-3.0 - 1.0) - (-8.0 - 17.0))
    assert behind(one._replace(run=one.run._replace(cycle=5)), other) == 0.0  # it has not begun
    before = one._replace(run=one.run._replace(onset=2, cycle=4))
    assert behind(before, other) == 0.0  # of that cycle nothing is kept


def test_a_gap_takes_what_is_known_of_the_motion_and_keeps_events_and_forces() -> None:
    samples, _ = samples_of(JOINT, commands_of(3))
    one = hypothesis(of_jet(2))._replace(root_until_s=9.0)
    after = regained(one, samples[2], 9, JOINT)
    assert (after.events, after.prior, after.run.cycle) == (one.events, one.prior, 9)
    assert after.run.score == one.run.score
    assert force_of(after.run.state, 0, JOINT) == pytest.approx(force_of(one.run.state, 0, JOINT))
    assert after.run.state.time_s == samples[2].time_s
    rate = np.mean(samples[2].rates, axis=0)
    np.testing.assert_allclose(after.run.state.mean[10:13], rate, atol=5e-3)
    assert np.linalg.norm(one.run.state.mean[10:13] - rate) > 0.01


def test_a_weight_is_likelihood_prior_and_what_forces_are_worth() -> None:
    one = hypothesis(of_jet(2), of_jet(4, -1))
    one = one._replace(prior=-20.0, run=one.run._replace(score=NO_SCORE._replace(likelihood=7.0)))
    worth = [
        force_correction(*force_of(one.run.state, slot, JOINT), float(JOINT.thrusts[jet]), PARAMS.priors, missing=less)
        for slot, jet, less in ((0, 2, False), (1, 4, True))
    ]
    assert weighed(one, PARAMS).weight == pytest.approx(7.0 - 20.0 + sum(worth))
    erratic = one._replace(walks=np.array([ANEW, 0.0, 0.0, 0.0]))
    assert weighed(erratic, PARAMS).weight == pytest.approx(7.0 - 20.0 + worth[1])
    drifting = one._replace(walks=np.array([0.03, 0.0, 0.0, 0.0]))
    possible = log_possible(*force_of(one.run.state, 0, JOINT), float(JOINT.thrusts[2]))
    assert weighed(drifting, PARAMS).weight == pytest.approx(7.0 - 20.0 + possible + worth[1])
    changed = one._replace(opened_at=np.array([0.3, np.nan, np.nan, np.nan]))
    assert weighed(changed, PARAMS).weight != pytest.approx(weighed(one, PARAMS).weight)
    unopened = one._replace(run=one.run._replace(onset=one.run.cycle))
    assert weighed(unopened, PARAMS).weight == pytest.approx(-13.0)


@pytest.mark.parametrize(("on_top", "share"), [(1, 0.2), (0, 1.0)])
def test_commands_tell_a_leak_from_a_jet_that_is_stuck(on_top: int, share: float) -> None:
    commands = commands_of(40, idle=(3,))
    commands[26:29, 3] = 1.0
    flown = flight(PARAMS, commands, changes={15: fail(3, share * JOINT.thrusts[3], 1, on_top)})
    leader = flown.tree.leader
    assert leader.ways == {(3, 1)}
    assert leader.run.state.slot_on_top[0] == on_top
    assert leader.decided == {3}
