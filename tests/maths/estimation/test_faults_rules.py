"""Rules of the hypothesis filter on cases small enough for exact arithmetic: priors, draws, order, passes, verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from faults_probe import JETS, commands_of, known_vehicle, make_params, samples_of
from joint_probe import some_sample
from numpy.testing import assert_allclose

from massprop_drake.maths.estimation.faults import passes, proposals, tree, verdicts
from massprop_drake.maths.estimation.faults import search as searches
from massprop_drake.maths.estimation.faults.alarms import Alarm, Rest, Watch
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.maths.estimation.faults.fault_events import (
    ANEW,
    Event,
    Hypothesis,
    log_weight_deficit,
    no_fault_hypothesis,
)
from massprop_drake.maths.estimation.faults.priors import Priors, force_correction
from massprop_drake.maths.estimation.faults.proposals import Birth
from massprop_drake.maths.estimation.faults.screening import begin_screening
from massprop_drake.maths.estimation.faults.search import StartSearch
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.faults.verdicts import Declared, pending_probability
from massprop_drake.maths.estimation.joint.bank import empty_bank
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Cause, Kind, Score, apply_cause
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.start import Kept

PRIORS = Priors(jet_per_hour=2e-3, together=0.03, drifting=0.2, reading_per_hour=5e-4, intermittent=0.3)
PARAMS = make_params()._replace(priors=PRIORS, rates=np.arange(1.0, JETS + 1.0))
JOINT = PARAMS.joint
KNOWN = known_vehicle(JOINT)


def of_jets(*jets: int, sign: int = 1) -> Cause:
    return Cause(Kind.JETS, jets, (sign,) * len(jets), (0,) * len(jets))


def hypothesis(*onsets_s: float, weight: float = 0.0, before: float = -math.inf, jet: int = 3) -> Hypothesis:
    """A hypothesis in which the force of a jet has begun, and changed, at times; now it is 10 s, cycle 100."""
    one = no_fault_hypothesis(KNOWN._replace(time_s=10.0), 100, JOINT)
    events = tuple(Event(of_jets(jet), onset_s, NO_SCORE) for onset_s in onsets_s)
    return one._replace(events=events, weight=weight, before=before)


def alarm(*times_s: float, gaps: tuple[int, ...] = (1, 2, 4)) -> Any:
    """An alarm with onsets 5, 7 and 11 at times."""
    states = tuple(KNOWN._replace(time_s=time_s) for time_s in times_s)
    screen = SimpleNamespace(onsets=(5, 7, 11), gaps=gaps)
    return Alarm(12, states, (), screen, np.zeros(0))  # type: ignore[arg-type]


def test_the_span_of_an_onset_is_the_time_since_the_one_before() -> None:
    spans = [proposals._onset_span_s(alarm(0.3, 0.5, 0.9), place) for place in range(3)]
    assert spans == pytest.approx([0.1, 0.2, 0.4])  # the first by the mean of the second's cycles
    assert proposals._onset_span_s(alarm(0.3, gaps=(3,)), 0) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("cause", "expected"),
    [
        (Cause(Kind.LIES, component=7), 5e-4 * 0.2 / 3600.0),
        (of_jets(0), 2e-3 * 1.0 * 0.2 / 3600.0 * 0.8),
        (of_jets(1, 4), 2e-3 * 3.5 * 0.2 / 3600.0 * 0.8 * 0.03),
        (of_jets(3, sign=-1), 2e-3 * 4.0 * 0.2 / 3600.0 * 0.8),
    ],
)
def test_the_prior_of_an_event_is_its_rate_over_the_span_of_its_onset(cause: Cause, expected: float) -> None:
    seen = alarm(0.3, 0.5, 0.9)
    found = proposals._log_prior(hypothesis(8.0), Contender(cause, 7, 0.0), seen, PARAMS)
    assert found == pytest.approx(math.log(expected))
    both = proposals._log_prior(hypothesis(8.0), Contender(of_jets(3, 0), 7, 0.0), seen, PARAMS)
    change = proposals._log_change_probability((3, 1), hypothesis(8.0), 0.2, PRIORS)
    assert both == pytest.approx(math.log(2e-3 * 0.2 / 3600.0 * 0.8) + change)


@pytest.mark.parametrize("changes", [0, 1, 4])
def test_a_force_changes_as_often_as_it_has_by_bayes_rule(changes: int) -> None:
    """Rarely, ten times an hour, or once a second with a probability of 0.3: Poisson events over two seconds."""
    onsets_s = (8.0, *np.linspace(8.5, 9.5, changes))
    rates, likely = np.array([10.0 / 3600.0, 1.0]), np.array([0.7, 0.3])
    likely = likely * rates**changes * np.exp(-2.0 * rates)
    expected = (likely / likely.sum()) @ rates * 0.1
    found = proposals._log_change_probability((3, 1), hypothesis(*onsets_s), 0.1, PRIORS)
    assert found == pytest.approx(math.log(expected))
    assert proposals._log_change_probability((3, 1), hypothesis(*onsets_s), 1e4, PRIORS) == math.log(0.5)


def test_a_strong_walk_costs_its_size_and_a_weak_one_nothing() -> None:
    """Kalata's tracking index: in sigmas of the reading, as the innovation is."""
    unit = np.array([2.0, 3.0])
    walked = 1e8 * unit * math.sqrt(2.0 * 0.1 / 5.0)
    assert proposals._following_cost(1e8, 5.0, unit, 0.1) == pytest.approx(np.log(walked).sum(), abs=1e-3)
    assert proposals._following_cost(1e-12, 5.0, unit, 0.1) < 1e-5


def test_draws_are_due_at_ages_of_powers_of_two() -> None:
    drawn, ages = -1, list[int]()
    for age in range(40):
        if tree._is_draw_due(age, drawn):
            drawn = age
            ages.append(age)
    assert ages == [0, 1, 2, 4, 8, 16, 32]
    assert tree._is_draw_due(7, 2)  # one that was missed
    assert not tree._is_draw_due(-1, -1)


def births_of(draws: str, leads: Sequence[float]) -> list[Birth]:
    return [Birth(hypothesis(), lead, None, 1.0, draw) for draw, lead in zip(draws, leads, strict=True)]


def test_the_best_of_each_draw_goes_first_then_the_second_of_each() -> None:
    births = births_of("aaabb", [-1.0, -2.0, -3.0, -9.0, -8.0])
    births[1] = births[1]._replace(doubt=4.0)  # it might be likeliest
    ordered = tree._interleave_proposals(births, {})
    assert [(one.origin, one.ahead) for one in ordered] == [("a", -2), ("b", -8), ("a", -1), ("b", -9), ("a", -3)]


@pytest.mark.parametrize(
    ("than", "expected"),
    [
        (None, (-3.0, None)),
        ((8.0,), (-3.0, (8.0,))),  # still likely
        ((9.0,), (-3.0 - 2.0, None)),  # far behind now, and 2 nats then
        ((7.0,), (-3.0 - 5.0, None)),  # far behind, and was: within what is likely
        ((6.0,), None),  # the leader continues it
        ((5.0,), (-3.0, None)),  # gone
    ],
)
def test_a_proposal_is_compared_with_what_is_still_likely(than: tuple[float, ...] | None, expected: Any) -> None:
    """Else with the likeliest, by how far the other was behind that before the newest sample."""
    one = Tree(
        100,
        (
            hypothesis(6.0, 8.5, before=-1.0),
            hypothesis(8.0, weight=-29.0),
            hypothesis(9.0, weight=-31.0, before=-3.0),
            hypothesis(7.0, weight=-31.0, before=-30.0),
        ),
    )
    events = None if than is None else hypothesis(*than).events
    found = tree._detach_reference(Birth(hypothesis(), -3.0, events, 1.0), one)
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert (found.ahead, None if found.than is None else (found.than[0].onset_s,)) == expected


def test_a_history_is_that_of_the_samples_since_it_parted_from_the_one_before() -> None:
    before, leader = hypothesis(6.0, 7.0), hypothesis(6.0, 8.0)
    fork = leader.events[1]._replace(score=Score(1.0, 2.0, 3.0))
    leader = leader._replace(events=(leader.events[0], fork), run=leader.run._replace(score=Score(5.0, 8.0, 9.0)))
    found = tree._record_history(Tree(100, (leader,)), before).history
    assert found is not None
    assert (found.since_s, found.score[:3]) == (8.0, (4.0, 6.0, 6.0))
    for earlier in (leader, leader._replace(events=(*leader.events, before.events[0]))):
        assert tree._record_history(Tree(100, (leader,)), earlier).history is None


def test_what_an_alarm_leaves_out_counts_as_waiting() -> None:
    """All of one that has not been drawn from; of a draw what is not followed, against the hypothesis that it names."""
    other = hypothesis(9.0, weight=-3.0)
    for drawn, rest, total in (
        (-1, None, 1.0),
        (2, None, 0.0),
        (2, Rest(-2.0, None), math.exp(-2.0)),
        (2, Rest(-1.0, other.events), math.exp(-4.0)),
        (2, Rest(5.0, None), 1.0),
        (-1, Rest(-2.0, None), 1.0 + math.exp(-2.0)),
    ):
        watch = Watch(empty_bank(JOINT.places), (), alarm(0.3)._replace(drawn=drawn, rest=rest))
        found = pending_probability((3, 1), Tree(100, (hypothesis(8.0)._replace(watch=watch), other)))
        assert found == pytest.approx(total / (1.0 + total))


def test_a_deficit_is_that_at_the_cycle_of_the_one_behind() -> None:
    leader = hypothesis(8.0)._replace(prior=-4.0, trail=(1.0, 20.0, 40.0))
    late = hypothesis(9.0)._replace(prior=-7.0)
    run = late.run._replace(onset=90, score=Score(15.0, 0.0, 0.0))
    for cycle, expected in ((100, 40.0), (99, 20.0), (98, 1.0)):
        behind = late._replace(run=run._replace(cycle=cycle))
        assert log_weight_deficit(behind, leader) == pytest.approx(expected - 4.0 - 15.0 + 7.0)
    for unknown in (run._replace(cycle=97), run._replace(cycle=101), run._replace(onset=100)):
        assert log_weight_deficit(late._replace(run=unknown), leader) == 0.0


def fit_of(share: float, sigma: float, sign: int) -> passes.PassFit:
    """A fit of the failure of jet 2, whose force is some share of full thrust within so many."""
    cause = of_jets(2, sign=sign)
    state, row = apply_cause(KNOWN, cause, JOINT), JOINT.places.force
    mean, root = state.mean.copy(), state.root.copy()
    mean[row], root[row] = share * JOINT.thrusts[2], 0.0
    root[row, [row, 0]] = np.array([0.8, 0.6]) * sigma * JOINT.thrusts[2]
    contender = Contender(cause, 1, 0.0, force=(2.0 * JOINT.thrusts[2],))
    fit = passes.begin_fit(contender, -20.0, KNOWN.mean, KNOWN, JOINT)
    return fit._replace(state=state._replace(mean=mean, root=root), scores=(NO_SCORE, Score(7.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("share", "sign", "on_top"), [(0.49, 1, 1), (0.51, 1, 0), (0.3, -1, 0)], ids=["leak", "stuck", "loss"]
)
def test_a_pass_goes_on_from_the_force_where_the_last_ended(share: float, sign: int, on_top: int) -> None:
    fit, slot = fit_of(share, 0.01, sign), JOINT.places.force
    thrust = float(JOINT.thrusts[2])
    assert fit.about[slot] == pytest.approx(1.05 * thrust)  # no jet gives more
    again = passes.begin_pass(fit, KNOWN, JOINT)
    assert again.about[slot] == pytest.approx(share * thrust)
    assert again.contender.cause.on_top == (on_top,)
    assert (again.passes, again.reached, again.done) == (2, 7.0, 0)
    worth = force_correction(share * thrust, 0.01 * thrust, thrust, PRIORS, is_loss=sign < 0)
    assert passes.log_weight(fit, PRIORS, JOINT) == pytest.approx(7.0 - 20.0 + worth)


def fit_weighing(weight: float, cause: Cause, onset: int = 0) -> passes.PassFit:
    """A fit of some log weight, but for what the force is worth."""
    contender = Contender(cause, onset, 0.0, force=(0.0,) * len(cause.jets))
    fit = passes.begin_fit(contender, -2.0, KNOWN.mean, KNOWN, JOINT)
    return fit._replace(scores=(NO_SCORE, Score(weight + 2.0, 0.0, 0.0)))


def test_hypotheses_of_a_start_are_those_within_thirty_nats_one_for_each_cause() -> None:
    nothing, drifts = Cause(Kind.NOTHING), Cause(Kind.WANDER, component=1)
    fits = (
        fit_weighing(-29.9, drifts),
        fit_weighing(-5.0, Cause(Kind.JUMP), 3),
        fit_weighing(0.0, nothing, 3),
        fit_weighing(-4.0, Cause(Kind.JUMP), 1),
        fit_weighing(-30.1, Cause(Kind.UNKNOWN)),
    )
    near = searches._fits_near_likeliest(StartSearch(fits=fits), PRIORS, JOINT)
    assert [(each.contender.cause.kind, each.contender.onset) for each in near] == [
        *((Kind.NOTHING, 3), (Kind.JUMP, 1), (Kind.WANDER, 0))
    ]
    assert searches._without_disturbances(StartSearch(fits=fits)).fits == fits[1:]


def test_an_outcome_begins_with_the_last_sample_before_its_onset() -> None:
    kept = tuple(Kept(sample, False) for sample in samples_of(JOINT, commands_of(4))[0])
    search = StartSearch(entry=KNOWN._replace(time_s=-0.5), kept=kept)
    for onset, onset_s in ((0, -0.5), (1, 0.1), (3, 0.3)):
        found = searches._make_outcome(fit_weighing(7.0, of_jets(2), onset), search, JOINT)
        assert (found.onset_s, found.since_s) == pytest.approx((onset_s, -0.5))
        assert (found.score.likelihood, found.log_prior) == (9.0, -2.0)
    later = searches._postpone_search(search._replace(acted=True, fits=(fit_weighing(0.0, of_jets(2)),), final=True))
    assert later.due_s == pytest.approx(0.4 + 0.9)  # when twice as many are kept
    assert later == StartSearch(True, search.entry, kept, True, True, later.due_s)


@pytest.mark.parametrize(
    ("time_s", "acted", "contradicted", "command", "forgets"),
    [
        (1.9, False, False, 0.0, False),
        (2.1, False, False, 0.0, True),
        (2.1, True, False, 0.0, False),
        (2.1, False, True, 0.0, False),
        (2.1, False, False, 1.0, False),
    ],
)
def test_samples_of_a_start_are_forgotten_after_two_seconds_in_which_nothing_acts(
    time_s: float, acted: bool, contradicted: bool, command: float, forgets: bool
) -> None:
    latest = Kept(some_sample(JOINT, time_s=time_s, commands=np.full((1, JETS), command)), False)
    earlier, before = Kept(some_sample(JOINT), False), KNOWN._replace(time_s=time_s - 0.1)
    search = StartSearch(entry=KNOWN, kept=(earlier,), acted=acted, contradicted=contradicted)
    found = searches._add_sample(search, before, latest, JOINT)
    assert found.kept == ((latest,) if forgets else (earlier, latest))
    assert found.entry is (before if forgets else KNOWN)
    assert found.acted == (acted or command > 0.0)


@pytest.mark.parametrize(
    ("around", "onsets"),
    [(None, range(0, 20, 2)), ((9, 1), range(1, 18)), ((5, 2), range(1, 20, 2)), ((3, 1), range(17))],
)
def test_onsets_of_a_screening_are_everywhere_or_about_one(around: tuple[int, int] | None, onsets: range) -> None:
    kept = tuple(Kept(sample, False) for sample in samples_of(JOINT, commands_of(20))[0])
    found = begin_screening(KNOWN, KNOWN.mean, kept, around, JOINT).screen
    assert found.onsets == tuple(onsets)
    assert found.gaps == tuple(onsets.step if onset > 0 else 1 for onset in onsets)


@pytest.mark.parametrize(
    ("share", "sigma", "changes", "walk", "expected", "word"),
    [
        (0.35, 0.02, 0, 0.0, (0.3, 0.02), None),  # the same force
        (0.35, 0.009, 0, 0.0, (0.35, 0.009), None),  # known better
        (0.45, 0.02, 0, 0.0, (0.45, 0.02), Word.CHANGED),
        (0.15, 0.02, 2, 0.0, (0.15, 0.02), Word.ERRATIC),
        (0.45, 0.05, 0, 0.0, (0.3, 0.02), None),  # not significant
        (0.39, 0.001, 0, 0.0, (0.39, 0.001), None),  # significant, and little
        (0.35, 0.02, 0, ANEW, (0.35, math.hypot(0.02, 1.0)), Word.ERRATIC),
        (0.35, 0.02, 3, ANEW, (0.35, math.hypot(0.02, 1.0)), None),  # said already
    ],
)
def test_a_declared_force_has_changed_by_three_sigmas_and_a_tenth(
    share: float, sigma: float, changes: int, walk: float, expected: tuple[float, float], word: Word | None
) -> None:
    thrust = float(JOINT.thrusts[2])
    fit, one = fit_of(share, sigma, 1), Declared((2, 1), 0.3 * thrust, 0.02 * thrust, changes)
    leader = hypothesis(8.0, jet=2)
    leader = leader._replace(run=leader.run._replace(state=fit.state), walks=np.array([walk, 0.0, 0.0, 0.0]))
    found, said = verdicts._update_declared(one, leader, JOINT)
    assert said == word
    assert_allclose([found.force, found.sigma], np.array(expected) * thrust, rtol=1e-9)
    assert found.changes == (3 if walk == ANEW else changes + (word is not None))
    assert verdicts._update_declared(one._replace(way=(4, 1)), leader, JOINT)[1] is None
