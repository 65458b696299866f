"""The race's own rules: who runs as a filter, in which order, and who is compared with whom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_probe import all_of, small_params, some_state

from massprop_drake.maths.estimation.detectors import multi_hypothesis
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import decision
from massprop_drake.maths.estimation.joint import race as races
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import (
    JUMP_SHARES,
    NO_SCORE,
    Cause,
    Kind,
    Runner,
    Score,
    opened,
)
from massprop_drake.maths.estimation.joint.layout import JointState, make_places
from massprop_drake.maths.estimation.joint.race import History, Race
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

PARAMS = small_params(places=make_places((6, 2, 2), 2, (False, False), False, 2), second_order=False)
NOW, ONSET = 10, 4
STATE: JointState = some_state(PARAMS)._replace(
    slot_jet=np.full(2, -1.0), slot_sign=np.ones(2), slot_on_top=np.zeros(2), level=np.zeros(6)
)
JUMP = Cause(Kind.JUMP)


def leak(*jets: int) -> Cause:
    return Cause(Kind.JETS, jets, (1,) * len(jets), (1,) * len(jets))


def stuck(jet: int) -> Cause:
    return Cause(Kind.JETS, (jet,), (1,), (0,))


def running(
    cause: Cause, likelihood: float = 0.0, cycle: int = NOW, nis: float = 12.0, cells: float | None = None
) -> Runner:
    """A filter that has arrived at a cycle, with six tenths of full thrust for each jet."""
    state = opened(STATE, cause, PARAMS)
    mean = state.mean.copy()
    for index, jet in enumerate(cause.jets):
        mean[PARAMS.places.force + index] = 0.6 * PARAMS.thrusts[jet]
    root = 1e-3 * np.eye(state.root.shape[0])
    score = Score(likelihood, likelihood if cells is None else cells, nis, 12.0)
    return Runner(cause, ONSET, (), cycle, state._replace(mean=mean, root=root), score, False)


def with_half_the_force(run: Runner) -> Runner:
    """It with three tenths of full thrust for each jet, which is little."""
    mean = run.state.mean.copy()
    mean[PARAMS.places.force : PARAMS.places.force + len(run.cause.jets)] *= 0.5
    return run._replace(state=run.state._replace(mean=mean))


def race(*runs: Runner, leading: tuple[Contender, ...] = ()) -> Race:
    screen = screens.begin((STATE, 0), (ONSET,), (1,), np.zeros(12), PARAMS)
    screen = screen._replace(cycle=NOW, scores=(NO_SCORE,) * (NOW + 1))
    return Race(1, (STATE, STATE), screen, runs, leading)


def contender(cause: Cause, lead: float) -> Contender:
    return Contender(cause, ONSET, lead, (1.0,) * len(cause.jets), (0.1,) * len(cause.jets))


def causes(found: Race) -> list[Cause]:
    return [run.cause for run in found.runs]


def test_both_ways_of_failing_run_and_are_no_rivals() -> None:
    now = race(running(leak(0), 100.0))
    some = [contender(stuck(0), 100.5), contender(leak(0), 100.0), contender(leak(1), 95.0)]
    standing = races.standings(now, some, PARAMS)
    assert set(causes(races.running(now, standing, 2, PARAMS))) == {leak(0), stuck(0), leak(1)}
    assert [each.contender.cause for each in races.rivals(standing)] == [leak(0), leak(1)]


def test_a_filter_stays_where_the_first_order_says_that_its_way_is_not_possible() -> None:
    now = race(running(leak(0), 100.0))
    standing = races.standings(now, [contender(stuck(0), 90.0)], PARAMS)
    assert [each.contender.cause for each in standing] == [leak(0), stuck(0)]


def test_jets_that_are_added_to_what_explains_all_must_be_far_likelier() -> None:
    now = race(running(leak(0), 100.0))
    some = [contender(leak(0), 100.0), contender(leak(0, 1), 105.0), contender(leak(2, 3), 90.0)]
    named = [each.contender.cause for each in races.standings(now, some, PARAMS)]
    assert named == [leak(0), leak(2, 3)]
    some[1] = contender(leak(0, 1), 140.0)
    assert races.standings(now, some, PARAMS)[0].contender.cause == leak(0, 1)


def test_the_jump_runs_before_rivals_that_are_nearer() -> None:
    many = [contender(leak(jet), 100.0 - jet) for jet in range(6)] + [contender(leak(0, 1), 99.9)]
    now = race()
    found = races.running(now, races.standings(now, [*many, contender(JUMP, 60.0)], PARAMS), 2, PARAMS)
    assert causes(found)[:2] == [leak(0), JUMP]
    assert len(causes(found)) == 6


def test_a_jump_is_heard_before_jets_are_named_where_jets_fired_as_it_may_have_happened() -> None:
    """However far behind the first order has it; once it has run what it has measured counts."""
    led, late, rules = running(leak(0), 1000.0), contender(JUMP, 10.0), decision.Rules()

    def both(fired: bool, *runs: Runner) -> tuple[bool, decision.Outcome]:
        now = race(led, *runs)
        now = now._replace(screen=now.screen._replace(fired=fired))
        standing = races.standings(now, [contender(leak(0), 1000.0), late], PARAMS)
        runs_on = JUMP in causes(races.running(now, standing, 2, PARAMS))
        return runs_on, decision.decided(now, standing, True, rules, PARAMS).outcome

    assert both(True) == (True, decision.Outcome.OPEN)
    assert both(False) == (False, decision.Outcome.JETS)
    assert both(True, running(JUMP, 10.0)) == (False, decision.Outcome.JETS)


def test_what_led_is_kept_for_the_sample_that_surprises_it() -> None:
    first, second = running(leak(0), 100.0), running(leak(1), 99.0)
    far = [contender(leak(2, 3), 400.0), contender(leak(0), 100.0), contender(leak(1), 99.0)]
    now = race(first, second)
    assert leak(0) in races.running(now, races.standings(now, far, PARAMS), 2, PARAMS).out
    led = race(first, second, leading=(contender(leak(0), 100.0), contender(leak(1), 99.0)))
    found = races.running(led, races.standings(led, far, PARAMS), 2, PARAMS)
    assert {leak(0), leak(1)} <= set(causes(found))
    assert not found.out


def test_filters_at_the_present_stay_there_before_others_catch_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def one_more(run: Runner, *_: Any) -> Runner:
        return run._replace(cycle=run.cycle + 1)

    monkeypatch.setattr(races, "stepped", one_more)
    monkeypatch.setattr(History, "at", lambda *_: races.Record(None, None))  # type: ignore[arg-type]
    now = race(running(leak(0), cycle=NOW - 6), running(leak(1), cycle=NOW - 1))
    now = now._replace(screen=now.screen._replace(counted=(all_of(12),) * NOW))
    found, left = races.stepped_on(now, 3, History(NOW, ()), np.zeros(2), PARAMS)
    assert [run.cycle for run in found.runs] == [NOW - 4, NOW]
    assert left == 0


def test_a_hypothesis_whose_filter_comes_to_nothing_leaves_the_race(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not the run with it: the filter that knows of nothing goes on."""

    def lost(run: Runner, *_: Any) -> Runner:
        if run.cause == leak(0):
            raise NotPositiveDefiniteError(np.zeros((1, 1)), "a covariance", 1.0)
        return run._replace(cycle=run.cycle + 1)

    monkeypatch.setattr(races, "stepped", lost)
    now = race(running(leak(0), cycle=NOW - 1), running(leak(1), cycle=NOW - 1))
    now = now._replace(screen=now.screen._replace(counted=(all_of(12),) * NOW))
    history = History(NOW, tuple(races.Record(None, None) for _ in range(NOW)))  # type: ignore[arg-type]
    found, _ = races.stepped_on(now, 8, history, np.zeros(2), PARAMS)
    assert causes(found) == [leak(1)]
    assert found.out == {leak(0)}


def test_a_jump_waits_for_all_that_run_and_a_small_one_longer() -> None:
    jump = running(JUMP, 100.0)
    mean = jump.state.mean.copy()
    mean[:6], mean[9] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), 1.0  # a body
    jump = jump._replace(state=jump.state._replace(mean=mean))
    late = running(leak(0), cycle=NOW - 3)
    assert decision._jump_explains(race(jump, running(leak(0))), jump, 2)
    assert not decision._jump_explains(race(jump, late), jump, 2)
    small = jump._replace(share=JUMP_SHARES[1])
    assert not decision._jump_explains(race(small), small, 11)
    assert decision._jump_explains(race(small), small, 12)


def test_a_jump_grows_as_soon_as_a_large_one_is_likelier() -> None:
    small = running(JUMP, 100.0)._replace(share=JUMP_SHARES[1])
    now = race(small)
    some = [contender(JUMP, 100.0)]
    found = races.running(now, races.standings(now, some, PARAMS), 2, PARAMS)
    assert found.runs[0] is not small
    assert found.runs[0].share == JUMP_SHARES[0]
    some = [contender(JUMP, 100.0)._replace(share=JUMP_SHARES[1])]
    assert races.running(now, races.standings(now, some, PARAMS), 2, PARAMS).runs[0] is small


def test_a_known_force_that_changes_is_likelier_than_any_new_failure() -> None:
    known = opened(STATE, leak(0), PARAMS)
    now = race()._replace(states=(known, known))
    found = races.standings(now, [contender(leak(1), 100.0), contender(leak(0), 96.0)], PARAMS)
    assert found[0].contender.cause == leak(0)
    assert found[0].odds - found[1].odds == pytest.approx(np.log(30 * 12) - 4.0)


def test_of_two_ways_that_are_as_likely_the_jet_is_stuck() -> None:
    now = race(running(leak(0), 100.0), running(stuck(0), 99.5))
    some = [contender(leak(0), 100.0), contender(stuck(0), 99.5)]
    assert races.rivals(races.standings(now, some, PARAMS))[0].contender.cause == stuck(0)
    now = race(running(leak(0), 103.0), running(stuck(0), 99.5))
    assert races.rivals(races.standings(now, some, PARAMS))[0].contender.cause == leak(0)


def test_filters_are_as_far_apart_as_cells_put_them_and_the_best_is_where_it_was() -> None:
    now = race(running(leak(0), 100.0, cells=90.0), running(leak(1), 95.0, cells=110.0))
    some = [contender(leak(0), 100.0), contender(leak(1), 95.0), contender(leak(2), 99.0)]
    standing = races.standings(now, some, PARAMS)
    assert [each.contender.cause for each in standing] == [leak(1), leak(2), leak(0)]
    assert [each.contender.lead for each in standing] == pytest.approx([100.0, 99.0, 80.0], abs=0.2)


def test_a_filter_for_which_cells_are_too_unlikely_does_not_fit() -> None:
    assert running(leak(0), 100.0, cells=95.0).fits
    assert not running(leak(0), 100.0, cells=93.0).fits
    late = running(leak(0), 100.0, cells=93.0)._replace(entry=Score(50.0, 48.0, 0.0, 0.0))
    assert late.fits  # before its onset it has said nothing


def test_over_what_is_known_to_first_order_alone_twice_the_lead_is_asked_for() -> None:
    now = race(running(leak(0), 100.0), running(leak(1), 91.0))
    some = [contender(leak(0), 100.0), contender(leak(1), 91.0), contender(leak(2), 91.0)]
    best, *others = races.standings(now, some, PARAMS)
    one, other = sorted(others, key=lambda each: each.contender.cause.jets)
    assert races.leads(best, one, 6.0)
    assert not races.leads(best, other, 6.0)
    assert races.leads(best, other._replace(linear=80.0, contender=contender(leak(2), 80.0)), 6.0)


def test_the_first_order_says_nothing_where_a_filter_fits_that_it_has_far_off() -> None:
    some = [contender(leak(0), 100.0), contender(leak(1), 105.0)]
    for measured, expected in ((111.0, -5.0), (130.0, 25.0)):
        now = race(running(leak(0), measured))
        best, other = races.standings(now, some, PARAMS)
        assert races.margin(best, other) == pytest.approx(expected, abs=0.2)


def test_two_failures_that_explain_no_more_than_one_of_them_are_none() -> None:
    some = [contender(leak(0), 100.0), contender(leak(0, 1), 99.0), contender(leak(1, 2), 99.0)]
    named = [each.contender.cause for each in races.standings(race(), some, PARAMS)]
    assert named == [leak(0), leak(1, 2)]


def test_a_filter_begins_anew_when_what_it_takes_for_the_onset_costs_half_of_what_decides() -> None:
    kicks = (((0.2,), (0.04,)), ((0.6,), (0.11,)))
    for had, expected in zip(kicks, (False, True), strict=True):
        run = running(leak(0), 100.0)._replace(kicks=had)
        now = race(run)
        some = [contender(leak(0), 100.0)._replace(kicks=((0.1,), (0.02,)))]
        found = races.running(now, races.standings(now, some, PARAMS), 2, PARAMS)
        assert (found.runs[0].cycle == ONSET) == expected


def test_while_the_leader_does_not_fit_others_run_that_are_far_behind_to_first_order() -> None:
    some = [contender(leak(0), 1e6), contender(leak(1), 1e6 - 500.0)]
    for nis, expected in ((12.0, {leak(0)}), (200.0, {leak(0), leak(1)})):
        now = race(running(leak(0), 1e6, nis=nis))
        assert set(causes(races.running(now, races.standings(now, some, PARAMS), 2, PARAMS))) == expected


def surprised(cause: Cause, nis: float, likelihood: float = 100.0) -> Runner:
    """A filter whose newest sample, of six components, has a NIS; so has all, if that is more than it explains."""
    run = running(cause, likelihood, nis=max(12.0, nis))
    return run._replace(newest=Score(0.0, 0.0, nis, 6.0))


def judged(*runs: Runner, leading: tuple[Contender, ...], others: tuple[Contender, ...] = ()) -> decision.Decision:
    now = race(*runs, leading=leading)
    standing = races.standings(now, [*leading, *others], PARAMS)
    return decision.decided(now, standing, True, decision.Rules(), PARAMS)


def test_what_led_alone_is_named_when_something_new_begins() -> None:
    led = (contender(leak(0), 100.0),)
    rival = contender(leak(1), 95.0)  # close to first order: by itself a reason to wait
    found = judged(surprised(leak(0), 60.0), leading=led, others=(rival,))
    assert found.outcome == decision.Outcome.JETS
    assert found.shaken
    assert found.winner is not None
    assert found.winner.contender.cause == leak(0)
    assert judged(surprised(leak(0), 6.0), leading=led, others=(rival,)).outcome == decision.Outcome.OPEN
    assert judged(surprised(leak(0), 60.0), leading=(), others=(*led, rival)).outcome == decision.Outcome.OPEN


def test_what_led_was_wrong_where_another_explains_the_newest_sample() -> None:
    led, runs = (contender(leak(0), 100.0),), (surprised(leak(0), 60.0), surprised(leak(1), 6.0, 99.0))
    found = judged(*runs, leading=led, others=(contender(leak(1), 99.0),))
    assert not found.shaken


def test_what_led_was_right_where_another_explains_all_but_the_newest_sample_too() -> None:
    """Whoever fits may still be as surprised as they are: something new has begun."""
    other = surprised(leak(1), 60.0, 99.0)
    other = other._replace(score=other.score._replace(nis=12.0))
    assert other.fits
    found = judged(
        surprised(leak(0), 60.0), other, leading=(contender(leak(0), 100.0),), others=(contender(leak(1), 99.0),)
    )
    assert found.shaken
    assert found.winner is not None
    assert found.winner.contender.cause == leak(0)


def test_what_led_was_wrong_where_it_had_not_explained_well_what_came_before() -> None:
    led = (contender(leak(0), 100.0),)
    for before, expected in ((15.0, True), (18.0, False)):  # of six components, 6 + 3 sqrt(12) = 16.4
        run = running(leak(0), 100.0, nis=before + 60.0)._replace(newest=Score(0.0, 0.0, 60.0, 6.0))
        assert judged(run, leading=led).shaken == expected


def test_what_led_was_wrong_where_cells_say_that_it_had_not_explained_what_came_before() -> None:
    led = (contender(leak(0), 100.0),)
    for excess, expected in ((5.9, True), (6.1, False)):
        run = running(leak(0), 100.0, nis=75.0, cells=100.0 - excess)._replace(newest=Score(0.0, 0.0, 60.0, 6.0))
        assert judged(run, leading=led).shaken == expected


def test_those_explain_all_that_no_filter_has_put_behind_and_no_jump_may_be_it() -> None:
    rules = decision.Rules()
    now = race(running(leak(0), 96.0), running(leak(1), 80.0))
    some = [contender(leak(0), 96.0), contender(leak(1), 80.0), contender(leak(2), 100.0), contender(leak(3), 80.0)]
    found = decision.explaining(races.standings(now, some, PARAMS), (), rules)
    assert [each.contender.cause for each in found] == [leak(0), leak(2)]  # the likeliest has no filter yet
    last = tuple(found)
    assert not decision.explaining(races.standings(now, [*some, contender(JUMP, 98.0)], PARAMS), last, rules)
    lost = race(running(leak(0), 96.0, nis=100.0))
    assert not decision.explaining(races.standings(lost, some, PARAMS), (), rules)
    little = race(running(leak(0), 11.0))  # nothing explains as much
    assert not decision.explaining(races.standings(little, [contender(leak(0), 11.0)], PARAMS), last, rules)


def test_who_led_last_stays_while_it_is_not_behind_and_wherever_nobody_fits() -> None:
    """What begins makes a neighbor fit by chance for a sample, or two others at once that are far behind."""
    rules = decision.Rules()
    some = [contender(leak(jet), 100.0 - jet) for jet in range(3)]
    last = tuple(races.standings(race(*(running(leak(jet), 100.0 - jet) for jet in range(3))), some, PARAMS))
    far = running(leak(2), 80.0, nis=100.0)
    now = race(running(leak(0), 100.0, nis=100.0), running(leak(1), 99.0), far)
    found = decision.explaining(races.standings(now, [*some[:2], contender(leak(2), 80.0)], PARAMS), last, rules)
    assert [each.contender.cause for each in found] == [leak(1), leak(0)]
    assert found[1].run is not None
    assert not found[1].run.fits
    now = race(running(leak(0), 100.0, nis=100.0), running(leak(1, 2), 70.0), far)
    both = [some[0], contender(leak(1, 2), 70.0), some[2]]
    assert decision.explaining(races.standings(now, both, PARAMS), last, rules) is last


def test_runners_up_explain_all_and_are_less_than_twelve_nats_behind() -> None:
    now = race(
        running(leak(0), 100.0),
        running(stuck(0), 99.0),
        running(leak(1), 89.0),
        running(leak(2), 87.0),
        running(leak(3), 95.0, nis=100.0),
        running(leak(4), 93.0),
    )
    some = [contender(run.cause, run.score.likelihood) for run in now.runs]
    winner, *others = races.standings(now, [*some, contender(leak(5), 99.0), contender(JUMP, 99.0)], PARAMS)
    found = decision.runners_up(winner, others)
    assert [each.contender.cause for each in found] == [leak(4), leak(1)]


def test_of_a_group_each_member_may_be_it_and_of_a_jet_whoever_runs_up() -> None:
    """Each with itself as the likeliest of the group."""
    now = race(running(leak(0), 100.0), running(leak(1), 99.0), running(leak(2), 98.0), running(leak(3), 80.0))
    some = [contender(run.cause, run.score.likelihood) for run in now.runs]
    standing = races.standings(now, some, PARAMS)
    state = multi_hypothesis.initial(PARAMS)._replace(race=now)
    winner, *others = standing
    members = tuple(each.contender for each in others[:2])
    alternatives = (tuple(each.failures[0] for each in (winner.contender, *members)),)
    group = decision.Decision(decision.Outcome.GROUP, winner, members, alternatives)
    for named, causes_of_it in ((group, [1, 2]), (decision.Decision(decision.Outcome.JETS, winner), [1, 2])):
        found = multi_hypothesis._otherwise(state, named, standing)
        assert [each.winner.contender.cause for each in found if each.winner] == [leak(jet) for jet in causes_of_it]
    first, second = multi_hypothesis._otherwise(state, group, standing)
    assert [failure.jet for failure in first.alternatives[0]] == [1, 0, 2]
    assert [failure.jet for failure in second.alternatives[0]] == [2, 0, 1]
    assert [each.cause for each in second.group] == [leak(0), leak(1)]


@pytest.mark.parametrize(
    ("surprised", "shaken", "expected"), [(30.0, True, (-9.0, -7.0)), (30.0, False, (-29.0, -7.0))]
)
def test_others_are_as_far_behind_as_readings_and_what_is_known_beforehand_have_them(
    monkeypatch: pytest.MonkeyPatch, surprised: float, shaken: bool, expected: tuple[float, float]
) -> None:
    """By noise and by cells: the winner is a force that is known to change, which is likelier beforehand.

    Something new that surprises one more than another in the newest sample is no reason for that one.
    """

    def standing(likelihood: float, cells: float, beforehand: float, newest: float = 0.0) -> races.Standing:
        run = running(leak(0), likelihood + newest, cells=cells)._replace(newest=Score(newest, 0.0, surprised, 6.0))
        one = contender(leak(0), likelihood)
        return races.Standing(one, run, one, likelihood, beforehand, likelihood)

    monkeypatch.setattr(multi_hypothesis, "_concluded", lambda state, joint, *_: (state, joint, ["said"]))
    named = decision.Decision(decision.Outcome.JETS, standing(101.0, 100.0, 5.0), shaken=shaken)
    other = named._replace(winner=standing(97.0, 98.0, 0.0, newest=-20.0))
    state = multi_hypothesis.initial(PARAMS)
    (found,) = multi_hypothesis.had_others_won(multi_hypothesis.Otherwise(state, STATE, named, (other,)), PARAMS)
    assert (found.as_noise, found.odds) == pytest.approx(expected)
    assert (found.state, found.joint, found.declarations) == (state, STATE, ("said",))


@pytest.mark.parametrize("best", [leak(0), JUMP])
def test_what_decides_must_show_to_first_order_too_where_that_is_about_right(best: Cause) -> None:
    """A filter is off it by as much as chance takes it; farther off the first order is wrong."""
    for linear, expected in ((100.0 - 40.0, 5.0), (100.0 - 60.0, 20.0)):
        one, other = (
            races.Standing(contender(cause, lead), running(cause, lead), contender(cause, lead), first, 0.0, lead)
            for cause, lead, first in ((best, 100.0, linear), (leak(1), 80.0, linear - 5.0))
        )
        assert races.ahead(one, other) == expected


@pytest.mark.parametrize("jets", [(0,), (0, 1)])
def test_a_narrower_force_to_begin_with_makes_nothing_likelier(jets: tuple[int, ...]) -> None:
    """By the sum over a grid of what the readings say, with the one and with the other density."""
    thrusts = PARAMS.thrusts[list(jets)]
    expected = tuple((0.2 * thrust, 0.05 * thrust) for thrust in thrusts)
    run = running(leak(*jets), 100.0)._replace(expected=expected)
    mean, sigma = np.array(expected).T
    half = np.array([[0.02, 0.0], [0.015, 0.008]])[: len(jets), : len(jets)] * thrusts[:, None]
    force, covariance = 0.23 * thrusts, half @ half.T
    axes = [np.linspace(0.05, 0.4, 701) * thrust for thrust in thrusts]
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*axes)], axis=1)

    def log_density(at: np.ndarray, precise: np.ndarray) -> np.ndarray:
        off = grid - at
        square: np.ndarray = np.einsum("ij,jk,ik->i", off, precise, off)
        return 0.5 * (np.linalg.slogdet(precise)[1] - square)

    after = log_density(force, np.linalg.inv(covariance))
    ratio = log_density(np.zeros(len(jets)), np.diag(thrusts**-2.0)) - log_density(mean, np.diag(sigma**-2.0))
    oracle = np.log(np.sum(np.exp(after + ratio)) / np.sum(np.exp(after)))
    assert races._regained(run, force, covariance, PARAMS) == pytest.approx(oracle, abs=1e-3)
    assert races._regained(run._replace(cycle=ONSET), force, covariance, PARAMS) == 0.0


def test_a_filter_opens_with_what_the_first_order_has_found_unless_the_force_is_known_or_nothing_is() -> None:
    thrust = float(PARAMS.thrusts[0])
    found = contender(leak(0), 100.0)._replace(force=(0.3 * thrust,), sigma=(0.01 * thrust,))
    assert races._expected(race(), found, PARAMS)[0] == pytest.approx((0.3 * thrust, 0.05 * thrust))
    vague = found._replace(sigma=(0.3 * thrust,))
    assert races._expected(race(), vague, PARAMS) == ((0.0, thrust),)
    known = race()._replace(states=(opened(STATE, leak(0), PARAMS), STATE))
    assert races._expected(known, found, PARAMS) == ((0.0, thrust),)
    state = opened(STATE, leak(0), PARAMS, expected=((0.3 * thrust, 0.05 * thrust),))
    row = PARAMS.places.force
    assert state.mean[row] - STATE.mean[row] == pytest.approx(0.3 * thrust)
    gained = np.sum(state.root[row] ** 2) - np.sum(STATE.root[row] ** 2)
    assert gained == pytest.approx((0.05 * thrust) ** 2)


def test_a_little_force_must_lead_by_twice_as_much_for_eight_seconds() -> None:
    """It does little harm meanwhile; what is stuck is named at once."""
    for little, behind, cycles, expected in (
        (True, 11.0, 50, False),
        (True, 13.0, 50, True),
        (True, 8.0, 100, True),
        (False, 8.0, 50, True),
    ):
        cause, other = (leak(0), leak(1)) if little else (stuck(0), stuck(1))
        runs = [running(cause, 100.0), running(other, 100.0 - behind)]
        if little:
            runs = [with_half_the_force(run) for run in runs]
        now = race(*runs)._replace(triggered=NOW - cycles)
        standing = races.standings(now, [contender(cause, 100.0), contender(other, 100.0 - behind)], PARAMS)
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.JETS) == expected


def test_two_little_forces_at_once_must_lead_by_three_times_as_much_however_late() -> None:
    for little, behind, cycles, expected in (
        (True, 17.0, 50, False),
        (True, 17.0, 120, False),
        (True, 19.0, 50, True),
        (False, 8.0, 50, True),
    ):
        first, other = (Cause(Kind.JETS, jets, (1, 1), (int(little),) * 2) for jets in ((0, 1), (0, 2)))
        runs = [running(first, 100.0), running(other, 100.0 - behind)]
        if little:
            runs = [with_half_the_force(run) for run in runs]
        now = race(*runs)._replace(triggered=NOW - cycles)
        some = [contender(cause, lead) for cause, lead in ((first, 100.0), (other, 100.0 - behind))]
        found = decision.decided(now, races.standings(now, some, PARAMS), True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.JETS) == expected


def test_two_at_once_that_no_longer_explain_what_comes_are_not_named_but_who_led_alone_beside_them() -> None:
    pair, one = running(leak(0, 1), 100.0, cycle=NOW - 6), running(leak(2), 99.0, cycle=NOW - 6)
    standing = [
        races.Standing(contender(run.cause, 100.0), run, contender(run.cause, 100.0), 100.0, 0.0, 100.0)
        for run in (pair, one)
    ]
    lost = running(leak(3), 100.0, nis=100.0)
    for led, expected in ((standing, [leak(2)]), (standing[:1], [])):
        now = race(lost)._replace(led=tuple(led))
        found = decision.decided(
            now, races.standings(now, [contender(leak(3), 100.0)], PARAMS), True, decision.Rules(), PARAMS
        )
        assert [found.winner.contender.cause for _ in range(1) if found.winner is not None] == expected


def test_who_led_alone_is_remembered_while_two_at_once_explain_what_has_come_since() -> None:
    """For two seconds."""
    for ago, expected in ((20, leak(2)), (26, leak(0, 1))):
        one = running(leak(2), 99.0, cycle=NOW - ago)
        led = races.Standing(contender(leak(2), 99.0), one, contender(leak(2), 99.0), 99.0, 0.0, 99.0)
        now = race(running(leak(0, 1), 100.0))._replace(led=(led,))
        standing = races.standings(now, [contender(leak(0, 1), 100.0)], PARAMS)
        found = multi_hypothesis._led(now, standing, decision.Decision(decision.Outcome.OPEN), decision.Rules())
        assert [each.contender.cause for each in found.led] == [expected]


def test_who_the_newest_sample_alone_puts_behind_leads_for_one_more() -> None:
    """What begins in the midst of a sample favors one of them by chance."""
    behind = running(leak(1), 60.0)._replace(newest=Score(-38.0, -38.0, 60.0, 6.0))
    long_since = running(leak(2), 60.0)._replace(newest=Score(-18.0, -18.0, 60.0, 6.0))
    for lead, expected in ((100.0, [leak(1)]), (108.0, [])):
        led = (contender(leak(0), lead), contender(leak(1), 60.0), contender(leak(2), 60.0))
        rival = contender(leak(3), lead - 11.0)  # so that nobody is clear
        now = race(running(leak(0), lead), behind, long_since, leading=led)._replace(clear=leak(0))
        found = decision.decided(now, races.standings(now, [*led, rival], PARAMS), True, decision.Rules(), PARAMS)
        assert found.outcome == decision.Outcome.OPEN
        assert found.winner is not None
        assert [each.cause for each in found.group] == expected


def test_those_that_led_are_named_as_they_stood_before_the_first_sample_that_surprised_one_of_them() -> None:
    led = (contender(leak(0), 100.0), contender(leak(1), 99.0))
    runs = running(leak(0), 100.0), running(leak(1), 99.0)
    before = [
        races.Standing(each, run._replace(cycle=NOW - ago), each, 100.0, 0.0, 100.0)
        for each, run, ago in zip(led, runs, (2, 2), strict=True)
    ]
    shaken = [surprised(leak(0), 60.0), surprised(leak(1), 60.0, 99.0)]
    third = races.Standing(
        contender(leak(2), 98.0), running(leak(2), 98.0, NOW - 2), contender(leak(2), 98.0), 98.0, 0.0, 98.0
    )
    just = [each._replace(run=running(each.contender.cause, 100.0, NOW - 1)) for each in before]
    for remembered, cycle in (((*before, third), NOW - 2), (before[:1], NOW), (just, NOW), ((), NOW)):
        now = race(*shaken, leading=led)._replace(led=tuple(remembered))
        found = decision.decided(now, races.standings(now, [*led], PARAMS), True, decision.Rules(), PARAMS)
        assert found.shaken
        assert found.winner is not None
        assert found.winner.run is not None
        assert found.winner.run.cycle == cycle
        assert [each.cause for each in found.group] == [leak(1)]


def test_who_led_is_remembered_as_it_stood_before_a_sample_that_surprises_one_of_them() -> None:
    """And until when they explained nearly all."""
    led = (contender(leak(0), 100.0), contender(leak(1), 99.0))
    calm = (running(leak(0), 100.0), running(leak(1), 99.0))
    some = (running(leak(0), 100.0), surprised(leak(1), 60.0, 99.0))
    for runs, known, old in ((calm, (0, 1), False), (some, (0, 1), True), (some, (0,), False)):
        now = race(*runs, leading=led)
        before = tuple(races.standings(race(*calm), [*led], PARAMS))
        now = now._replace(led=tuple(each for each in before if each.contender.cause.jets[0] in known))
        standing = races.standings(now, [*led], PARAMS)
        made = decision.Decision(decision.Outcome.OPEN, standing[0], (standing[1].contender,))
        found = multi_hypothesis._led(now, standing, made, decision.Rules())
        assert all(one is other for one, other in zip(found.led, now.led, strict=False)) == old
        assert len(found.led) == 2
        assert found.until == NOW
    lost = race(running(leak(0), 100.0, nis=200.0))._replace(led=before, until=NOW - 3)
    nobody = decision.Decision(decision.Outcome.OPEN)
    standing = races.standings(lost, [*led], PARAMS)
    assert multi_hypothesis._led(lost, standing, nobody, decision.Rules()).until == NOW - 3
    nearly = race(running(leak(0), 100.0, cells=90.0))._replace(led=before, until=NOW - 3)  # behind noise by ten nats
    standing = races.standings(nearly, [*led], PARAMS)
    assert standing[0].run is not None
    assert not standing[0].run.fits
    assert multi_hypothesis._led(nearly, standing, nobody, decision.Rules()).until == NOW


def test_half_a_second_without_an_explanation_counts_from_the_last_that_nearly_was_one() -> None:
    led = races.Standing(
        contender(leak(0), 90.0), running(leak(0), 90.0, NOW - 8), contender(leak(0), 90.0), 90.0, 0.0, 90.0
    )
    for until, expected in ((NOW - 5, False), (NOW - 6, True), (-1, True)):
        now = race(running(leak(3), 100.0, nis=200.0))._replace(led=(led,), until=until)
        standing = races.standings(now, [contender(leak(3), 100.0)], PARAMS)
        assert decision.decided(now, standing, True, decision.Rules(), PARAMS).shaken == expected


def test_what_is_named_since_something_new_began_explains_all_until_it_no_longer_nearly_fits() -> None:
    run = running(leak(0), 100.0, cycle=NOW - 6)
    standing = races.Standing(contender(leak(0), 100.0), run, contender(leak(0), 100.0), 100.0, 0.0, 100.0)
    for shaken, until, expected in ((True, NOW - 2, NOW - 2), (True, -1, NOW - 6), (False, NOW - 2, -1)):
        made = decision.Decision(decision.Outcome.JETS, standing, shaken=shaken)
        assert multi_hypothesis._explained(made, race()._replace(until=until)) == expected


def test_of_two_alternatives_each_sees_its_own_failures_first() -> None:
    first, second = (
        contender(leak(*jets), 100.0)._replace(force=force)
        for jets, force in (((0, 3), (1.0, 2.0)), ((1, 4), (3.0, 4.0)))
    )
    alternatives = ((first.failures[0], second.failures[0]), (first.failures[1], second.failures[1]))
    found = multi_hypothesis._seen_from(second, alternatives)
    assert [[failure.jet for failure in group] for group in found] == [[1, 0], [4, 3]]
    assert [group[0].force for group in found] == [3.0, 4.0]
    assert multi_hypothesis._seen_from(contender(leak(1, 5), 100.0), alternatives) == ()


def test_had_nothing_been_decided_the_race_would_go_on_and_nobody_would_lead() -> None:
    now = race(running(leak(0), 100.0), leading=(contender(leak(0), 100.0),))
    state = multi_hypothesis.initial(PARAMS)._replace(race=now)
    decided = decision.Decision(decision.Outcome.JETS)
    found = multi_hypothesis.goes_on(multi_hypothesis.Otherwise(state, STATE, decided, ()))
    assert found.race is not None
    assert (found.race.runs, found.race.leading, found.race.led) == (now.runs, (), ())


def test_a_race_looks_at_two_onsets_before_the_one_that_its_statistic_favors() -> None:
    """The youngest of those that come near is taken, so that the true one is rather before it."""
    cycles = np.arange(2.0, 9.0)
    bank = banks.empty(PARAMS.places)._replace(cycles=cycles, states=(STATE,) * 7)
    link = type("Link", (), {"read": np.zeros(12)})()
    history = History(8, tuple(races.Record(None, link) for _ in range(8)))  # type: ignore[arg-type]
    found = races.begin(bank, 4, 9, history, PARAMS)
    assert found.screen.onsets == (4, 5, 6, 7)
    assert found.screen.began == 3


def test_two_forces_that_are_impossible_together_cost_what_no_two_that_are_possible_can_explain() -> None:
    """Each is within its sigmas; their sum is far below zero."""
    possible, impossible = running(leak(0, 1), 100.0), running(leak(2, 3), 120.0)
    rows = PARAMS.places.force + np.arange(2)
    root, mean = impossible.state.root.copy(), impossible.state.mean.copy()
    root[rows], mean[rows] = 0.0, [-2.0, -1.0]
    root[rows, rows[0]], root[rows, rows[1]] = [2.0, -2.0], [0.1, 0.1]
    impossible = impossible._replace(state=impossible.state._replace(root=root, mean=mean))
    some = [contender(leak(0, 1), 100.0), contender(leak(2, 3), 120.0)]
    first, second = races.standings(race(possible, impossible), some, PARAMS)
    assert first.contender.cause == leak(0, 1)
    assert second.contender.sigma == pytest.approx((2.0025, 2.0025), abs=1e-3)
    # the sum is -3 with a sigma of .2; the nearest that is possible is none at all
    assert second.odds == pytest.approx(first.odds + 20.0 - 0.5 * 15.0**2, abs=1.0)


def test_all_that_led_are_a_group_of_however_many_when_something_new_begins() -> None:
    led = tuple(contender(leak(jet), 100.0 - 0.1 * jet) for jet in range(5))
    found = judged(*(surprised(leak(jet), 60.0, 100.0 - 0.1 * jet) for jet in range(4)), leading=led)
    assert found.outcome == decision.Outcome.GROUP
    assert {failure.jet for failure in found.alternatives[0]} == {0, 1, 2, 3, 4}  # the last has no filter yet


def test_jets_that_are_stuck_are_a_group_once_they_lead_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decision, "_alike", lambda *_: True)
    two = (contender(stuck(0), 100.0), contender(stuck(1), 99.0))
    runs = (running(stuck(0), 100.0), running(stuck(1), 99.0))
    for near, expected in ((90.0, decision.Outcome.OPEN), (80.0, decision.Outcome.GROUP)):
        now = race(*runs)
        standing = races.standings(now, [*two, contender(stuck(2), near)], PARAMS)
        assert decision.decided(now, standing, True, decision.Rules(), PARAMS).outcome == expected


@pytest.mark.parametrize(
    ("jets", "behind", "expected"),
    [
        (3, 1.0, decision.Outcome.GROUP),
        (4, 1.0, decision.Outcome.OPEN),  # of one cluster: more than can be acted on
        (2, 7.0, decision.Outcome.OPEN),  # alike to first order alone: a filter leads
    ],
)
def test_a_group_of_leaks_is_said_after_eight_seconds_only_if_it_is_narrow(
    monkeypatch: pytest.MonkeyPatch, jets: int, behind: float, expected: decision.Outcome
) -> None:
    monkeypatch.setattr(decision, "_alike", lambda *_: True)
    runs = [running(leak(jet), 100.0 - min(jet, 1) * behind) for jet in range(jets)]
    mean = np.where(runs[0].state.mean == 0.6 * PARAMS.thrusts[0], 0.3 * PARAMS.thrusts[0], runs[0].state.mean)
    little = [run._replace(state=run.state._replace(mean=mean)) for run in runs]
    some = [contender(run.cause, 95.0) for run in runs]
    rules = decision.Rules(clusters=np.zeros(len(PARAMS.thrusts), dtype=np.intp))
    monkeypatch.setattr(decision, "ahead", lambda *_: 1.0)
    monkeypatch.setattr(decision, "leads", lambda *_, **__: False)
    for cycles, outcome in ((90, decision.Outcome.OPEN), (100, expected)):
        now = race(*little)._replace(triggered=NOW - cycles + 1)
        found = decision.decided(now, races.standings(now, some, PARAMS), True, rules, PARAMS)
        assert found.outcome == outcome


def test_what_leads_is_remembered_with_whatever_is_not_behind() -> None:
    now = race(running(leak(0), 100.0), running(leak(1), 96.0))
    some = [contender(leak(0), 100.0), contender(leak(1), 96.0), contender(leak(2), 70.0)]
    found = decision.decided(now, races.standings(now, some, PARAMS), True, decision.Rules(), PARAMS)
    assert found.outcome == decision.Outcome.OPEN
    assert [each.cause for each in found.group] == [leak(1)]
    found = decision.decided(
        now, races.standings(now, [*some, contender(JUMP, 98.0)], PARAMS), True, decision.Rules(), PARAMS
    )
    assert found.winner is None  # a jump is as likely: no jet leads


def test_a_lead_must_last_where_the_newest_sample_has_put_others_behind() -> None:
    """What begins in it favors one of those that led by chance; those are not behind before the next."""
    until_now, rules = (contender(leak(0), 100.0), contender(leak(1), 99.0)), decision.Rules()
    for nis, clear, expected in ((30.0, None, True), (6.0, None, False), (30.0, leak(0), False)):
        other = running(leak(1), 80.0)._replace(newest=Score(0.0, 0.0, nis, 6.0))
        now = race(running(leak(0), 100.0), other, leading=until_now)._replace(clear=clear)
        standing = races.standings(now, [contender(leak(0), 100.0), contender(leak(1), 80.0)], PARAMS)
        found = decision.decided(now, standing, True, rules, PARAMS)
        assert (found.outcome == decision.Outcome.OPEN) == expected
        assert found.clear
        assert [each.cause for each in found.group] == [leak(1)] * expected


def test_those_that_led_are_named_where_nothing_explains_what_came_since() -> None:
    """As they were when they led; not where something fits, or half a second has not gone by."""
    lost = running(leak(0), 100.0, nis=100.0)
    for ago, fitting, expected in ((6, False, True), (5, False, False), (6, True, False)):
        last = tuple(running(leak(jet), 50.0, cycle=NOW - ago) for jet in (0, 1))
        led = tuple(
            races.Standing(contender(run.cause, 50.0), run, contender(run.cause, 50.0), 50.0, 0.0, 50.0) for run in last
        )
        other = running(leak(2), 99.0, nis=12.0 if fitting else 100.0)
        now = race(lost, other)._replace(led=led)
        standing = races.standings(now, [contender(leak(0), 100.0), contender(leak(2), 99.0)], PARAMS)
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.GROUP) == expected
        if expected:
            assert found.winner == led[0]
            assert {failure.jet for failure in found.alternatives[0]} == {0, 1}


def test_of_many_that_are_as_likely_those_run_on_that_run() -> None:
    """They would else take each other's place before any has arrived at the present."""
    young = [running(leak(jet), 50.0, cycle=ONSET + 1) for jet in (3, 4, 5)]
    now = race(*young)
    some = [contender(leak(jet), 50.0 - 0.1 * jet) for jet in range(6)]
    some += [contender(leak(0, jet), 49.0) for jet in range(1, 6)]
    found = causes(races.running(now, races.standings(now, some, PARAMS), 2, PARAMS))
    assert found[:4] == [leak(0), leak(3), leak(4), leak(5)]


def test_a_liar_is_heard_once_it_has_arrived_whatever_the_first_order_says() -> None:
    lie = Cause(Kind.LIES, component=1)
    late = running(lie, cycle=NOW - 3)._replace(lying=True)
    for triggered, expected in ((NOW - 3, True), (NOW - 20, False)):
        now = race(running(leak(0), 100.0), late)._replace(triggered=triggered)
        found = races.running(now, races.standings(now, [contender(leak(0), 100.0)], PARAMS), 2, PARAMS)
        assert (lie in causes(found)) == expected


def test_a_reading_that_lies_keeps_its_place_while_it_explains_all() -> None:
    """Beside a jump, of which the first order says little, many jets seem near; none of them has been heard."""
    lie = Cause(Kind.LIES, component=1)
    some = [contender(leak(jet), 99.0) for jet in range(6)] + [contender(JUMP, 100.0), contender(lie, 70.0)]
    for nis, lead, expected in ((12.0, 87.0, True), (200.0, 87.0, False), (12.0, 30.0, False)):
        now = race(running(JUMP, 100.0), running(lie, lead, nis=nis))._replace(triggered=NOW - 20)
        found = causes(races.running(now, races.standings(now, some, PARAMS), 2, PARAMS))
        assert found[0] == JUMP
        assert (lie in found) == expected


def test_a_race_moves_past_its_last_onset_to_the_one_that_the_test_has(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def begin(bank: banks.Bank, index: int, *_: object) -> Race:
        begun.append(index)
        return race()

    monkeypatch.setattr(races, "begin", begin)
    bank = banks.empty(PARAMS.places)._replace(cycles=ONSET + np.arange(4.0))
    now = race()
    now = now._replace(screen=now.screen._replace(onsets=(ONSET, ONSET + 1)), states=(STATE,) * 3)
    for onset, tested, expected in ((1, 3, 3), (1, 0, 1), (1, -1, 1), (0, 3, 0)):
        some = [contender(leak(0), 100.0)._replace(onset=ONSET + onset)]
        races.moved(now, races.standings(now, some, PARAMS), bank, History(NOW, ()), tested, PARAMS)
        assert begun.pop() == expected
    # a jump explains all since the alarm, or most: what the test has is of a filter that has learned wrongly meanwhile
    some = [contender(JUMP, 95.0), contender(leak(0), 90.0)._replace(onset=ONSET + 1)]
    for nis, lead, expected in ((12.0, 95.0, 1), (200.0, 95.0, 1), (12.0, 85.0, 1), (200.0, 85.0, 3)):
        fitting = now._replace(runs=(running(JUMP, lead, nis=nis)._replace(share=JUMP_SHARES[1]),))
        races.moved(fitting, races.standings(fitting, some, PARAMS), bank, History(NOW, ()), 3, PARAMS)
        assert begun.pop() == expected


@pytest.mark.parametrize(
    ("nis", "quiet", "other", "fits", "onset", "expected"),
    [
        (60.0, 7, 60.0, True, ONSET + 1, True),
        (12.0, 7, 60.0, True, ONSET + 1, False),  # that nothing has happened explains it
        (60.0, 6, 60.0, True, ONSET + 1, False),  # what the alarm was of may still begin
        (60.0, 7, 6.0, True, ONSET + 1, False),  # a hypothesis explains it
        (60.0, 7, 6.0, False, ONSET + 1, True),  # one that explains nothing else
        (60.0, 7, 60.0, True, ONSET, False),  # it began where the race is about
    ],
)
def test_a_race_of_chance_is_overtaken_by_what_surprises_everybody(
    nis: float, quiet: int, other: float, fits: bool, onset: int, expected: bool
) -> None:
    run = surprised(leak(0), other)
    now = race(run._replace(score=run.score._replace(nis=12.0 if fits else 200.0)))
    scores = (Score(0.0, 0.0, 60.0, 60.0), Score(0.0, 0.0, 60.0 + nis, 66.0))
    now = now._replace(screen=now.screen._replace(scores=scores), quiet=quiet)
    assert races.overtaken(now, onset) == expected


def test_a_race_is_quiet_while_nothing_explains_all_and_nobody_leads_it_by_enough() -> None:
    for nis, lead, expected in ((60.0, 12.0, True), (60.0, 12.1, False), (200.0, 12.0, False)):
        now = race()
        now = now._replace(screen=now.screen._replace(scores=(Score(0.0, 0.0, nis, 60.0),)))
        standing = [some_standing(leak(0), 9.0), some_standing(JUMP, lead)]
        assert races.is_quiet(now, standing, 12.0) == expected


def some_standing(cause: Cause, lead: float) -> races.Standing:
    one = contender(cause, lead)
    return races.Standing(one, None, one, lead, 0.0, lead)


def test_a_race_moves_where_a_small_jump_leads_jets_by_more_than_their_onset_may_cost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    elsewhere = race()._replace(screen=race().screen._replace(onsets=(ONSET - 1, ONSET)))
    monkeypatch.setattr(races, "begin", lambda *_: elsewhere)
    bank = banks.empty(PARAMS.places)._replace(cycles=np.array([float(ONSET)]))
    some = [contender(JUMP, 100.0), contender(leak(0), 100.0)]
    small, large = (running(JUMP, 100.0)._replace(share=share) for share in reversed(JUMP_SHARES))
    for jump, jets, expected in ((small, 90.0, True), (small, 98.0, False), (large, 90.0, False)):
        now = race(jump, running(leak(0), jets))
        found = races.moved(now, races.standings(now, some, PARAMS), bank, History(NOW, ()), -1, PARAMS)
        assert (found is elsewhere) == expected
    now = race()
    assert races.moved(now, [], bank, History(NOW, ()), -1, PARAMS) is now  # it has not arrived at the present


def test_what_led_begins_anew_at_a_better_onset_unless_the_newest_sample_surprises_it() -> None:
    for nis, expected in ((6.0, True), (60.0, False)):
        run = surprised(leak(0), nis)._replace(onset=ONSET - 1)
        better = contender(leak(0), 105.0)._replace(at_onsets=((ONSET - 1, 100.0), (ONSET, 105.0)))
        now = race(run, leading=(contender(leak(0), 100.0),))
        now = now._replace(screen=now.screen._replace(onsets=(ONSET - 1, ONSET)), states=(STATE, STATE, STATE))
        found = races.running(now, races.standings(now, [better], PARAMS), 2, PARAMS)
        assert (found.runs[0].cycle == ONSET) == expected


def test_a_filter_at_a_wrong_onset_begins_anew_and_is_not_out() -> None:
    far = running(leak(0), 100.0, nis=200.0)._replace(onset=ONSET - 1)
    for at_the_other, expected in ((1000.0, False), (90.0, True)):
        some = contender(leak(0), max(at_the_other, 100.0))
        some = some._replace(at_onsets=((ONSET - 1, 100.0), (ONSET, at_the_other)))
        now = race(far)
        now = now._replace(screen=now.screen._replace(onsets=(ONSET - 1, ONSET)), states=(STATE, STATE, STATE))
        standing = races.standings(now, [contender(leak(1, 2), 1000.0), some], PARAMS)
        found = races.running(now, standing, 2, PARAMS)
        assert (leak(0) in found.out) == expected


def test_a_kick_that_the_force_cannot_have_given_is_no_failure() -> None:
    """The filter begins anew with what its force can have given; until then nothing is named."""
    for kick, expected in ((0.1, False), (100.0, True)):
        run = running(leak(0), 100.0)._replace(kicks=((kick,), (0.2 * kick,)))
        found = contender(leak(0), 100.0)._replace(kicks=run.kicks)  # the first order has it so large, too
        now = race(run)
        standing = races.standings(now, [found], PARAMS)
        assert (races.overrated(now, standing[0], PARAMS) is not None) == expected
        anew = races.running(now, standing, 2, PARAMS).runs[0]
        assert (anew.cycle == ONSET) == expected
        assert anew.kicks[0][0] < 1.0
        assert anew.kicks[1][0] == pytest.approx(0.2 * anew.kicks[0][0])
        named = decision.decided(now, standing, True, decision.Rules(), PARAMS).outcome == decision.Outcome.JETS
        assert named != expected


def test_a_kick_of_a_force_that_has_ceased_is_one_of_what_it_was() -> None:
    """Thrust of a jet that was stuck ends in the midst of a sample: what it gives by now is nothing."""
    known = STATE._replace(mean=STATE.mean.copy(), slot_jet=np.array([0.0, -1.0]))
    for had, expected in ((0.0, True), (3.0, False)):
        known.mean[PARAMS.places.force] = had
        run = running(leak(0), 100.0)._replace(kicks=((2.0,), (0.4,)))
        run = run._replace(state=run.state._replace(mean=run.state.mean.copy()))
        run.state.mean[PARAMS.places.force] = 0.0
        now = race(run)._replace(states=(known, known, known))
        standing = races.standings(now, [contender(leak(0), 100.0)], PARAMS)
        assert standing[0].contender.force == (0.0,)
        assert (races.overrated(now, standing[0], PARAMS) is not None) == expected


def test_a_lead_must_show_by_cells_and_by_noise() -> None:
    for likelihood, cells, expected in ((100.0, 90.0, False), (90.0, 100.0, False), (90.0, 90.0, True)):
        now = race(running(leak(0), 100.0), running(leak(1), likelihood, cells=cells))
        standing = races.standings(now, [contender(leak(0), 100.0), contender(leak(1), 90.0)], PARAMS)
        first = next(each for each in standing if each.contender.cause == leak(0))
        other = next(each for each in standing if each.contender.cause == leak(1))
        assert (races.ahead(first, other) > 6.0) == expected


def test_that_a_known_force_changes_must_show_at_first_and_not_only_be_likelier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(races, "_known", lambda _: {(0, 1)})
    for rival, cycles, expected in ((97.0, 6, False), (90.0, 6, True), (97.0, 7, True)):
        now = race(running(leak(0), 100.0), running(leak(1), rival))._replace(triggered=NOW + 1 - cycles)
        standing = races.standings(now, [contender(leak(0), 100.0), contender(leak(1), rival)], PARAMS)
        assert standing[0].beforehand > 5.0
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.JETS) == expected


def test_forces_that_drift_are_heard_where_no_jets_explain_all_any_more() -> None:
    """Those of single jets that led, ahead of all that are to be heard; and they stay until they have arrived."""
    drifting = [leak(jet)._replace(drifts=True) for jet in (0, 1)]
    some = [contender(leak(0), 100.0), contender(leak(1), 99.0), contender(leak(2, 3), 98.0)]
    for nis, expected in ((200.0, drifting), (12.0, [])):
        now = race(running(leak(0), 100.0, nis=200.0), running(leak(1), 99.0, nis=nis), running(JUMP, 50.0))
        standing = races.standings(now, [*some, contender(JUMP, 50.0)], PARAMS)
        led = tuple(each for each in standing if each.contender.cause in (leak(0), leak(1)))
        found = races.running(now._replace(led=led), standing, 2, PARAMS)
        assert causes(found)[: len(expected)] == expected
        assert any(cause.drifts for cause in causes(found)) == bool(expected)
        assert all(run.onset == ONSET and not run.expected for run in found.runs if run.cause.drifts)
    late = running(drifting[0], cycle=NOW - 3)
    now = race(running(leak(1), 100.0), late)
    assert drifting[0] in causes(races.running(now, races.standings(now, some, PARAMS), 2, PARAMS))


def test_who_explained_all_until_a_second_ago_is_heard_with_a_force_that_drifts() -> None:
    """One opposite may have ceased to do so before, while the other still did."""
    first = surprised(leak(0), 200.0)
    now = race(first, running(leak(1), 100.0))
    some = [contender(leak(1), 100.0), contender(leak(0), 99.0)]
    after = races.running(now, races.standings(now, some, PARAMS), 2, PARAMS)
    assert [each.contender.cause for each in after.ceased] == [leak(0)]
    assert not any(cause.drifts for cause in causes(after))
    second = surprised(leak(1), 200.0)
    for ago, expected in ((1, {0, 1}), (races.A_SECOND, {1})):
        ceased = tuple(each._replace(run=first._replace(cycle=NOW - ago)) for each in after.ceased)
        then = race(second)._replace(ceased=ceased)
        found = races.running(then, races.standings(then, some[:1], PARAMS), 2, PARAMS)
        assert {cause.jets[0] for cause in causes(found) if cause.drifts} == expected


def test_a_force_that_drifts_wins_once_all_that_may_have_arrived() -> None:
    drifting = [leak(jet)._replace(drifts=True) for jet in (0, 1)]
    for cycle, expected in ((NOW - 1, decision.Outcome.OPEN), (NOW, decision.Outcome.JETS)):
        now = race(running(drifting[0], 1000.0), running(drifting[1], 900.0, cycle=cycle))._replace(triggered=NOW - 20)
        standing = races.standings(now, [], PARAMS)
        assert decision.decided(now, standing, True, decision.Rules(), PARAMS).outcome == expected


def test_a_force_that_drifts_is_not_compared_to_first_order() -> None:
    """That has a constant force, and would leave to whatever is added to it what it has changed by."""
    drifting = leak(0)._replace(drifts=True)
    some = [contender(leak(0), 40.0), contender(leak(0, 1), 80.0)]
    now = race(running(leak(0), 40.0, nis=200.0), running(drifting, 100.0))
    standing = races.standings(now, some, PARAMS)
    assert [each.contender.cause for each in standing] == [drifting, leak(0)]
    constant = races.standings(race(running(leak(0), 100.0)), some, PARAMS)
    assert standing[0].contender.lead == pytest.approx(constant[0].contender.lead - 6.0)


def test_what_gives_little_is_named_half_a_second_after_the_alarm() -> None:
    """Two of them may look like one until then; a jet that is off is named at once, and one that gives much."""
    for share, sign, cycles, expected in (
        (0.05, 1, 6, False),
        (0.05, 1, 7, True),
        (0.6, 1, 3, True),
        (0.05, -1, 3, True),
    ):
        cause = Cause(Kind.JETS, (0,), (sign,), (int(sign > 0),))
        run = running(cause, 100.0)
        mean = run.state.mean.copy()
        mean[PARAMS.places.force] = share * PARAMS.thrusts.max()
        now = race(run._replace(state=run.state._replace(mean=mean)))._replace(triggered=NOW + 1 - cycles)
        standing = races.standings(now, [contender(cause, 100.0)], PARAMS)
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.JETS) == expected
        assert found.clear


def test_what_gives_little_must_lead_two_at_once_by_what_is_read_for_a_second() -> None:
    """Of its onset, whenever the alarm was; later the rarity of two counts, and always where they share the jet, or
    much is given.
    """
    for share, jets, age, cycles, expected in (
        (0.05, (1, 2), 11, 11, False),
        (0.05, (1, 2), 11, 20, False),
        (0.05, (1, 2), 12, 12, True),
        (0.05, (1, 2), 12, 7, True),
        (0.05, (0, 1), 11, 11, True),
        (0.6, (1, 2), 11, 11, True),
    ):
        run = running(leak(0), 100.0)
        mean = run.state.mean.copy()
        mean[PARAMS.places.force] = share * PARAMS.thrusts.max()
        both = running(leak(*jets), 100.0)  # twelve behind since they are two
        since = NOW - age
        run, both = (each._replace(onset=since) for each in (run._replace(state=run.state._replace(mean=mean)), both))
        now = race(run, both)._replace(triggered=NOW + 1 - cycles)
        standing = races.standings(now, [contender(leak(0), 100.0), contender(leak(*jets), 88.0)], PARAMS)
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert (found.outcome == decision.Outcome.JETS) == expected


def test_at_last_filters_alone_tell_who_is_in_a_group() -> None:
    """By cells and by noise; to first order another leads."""
    for noise, cells, expected in ((90.0, 290.0, []), (90.0, 295.0, [leak(0, 2)]), (95.0, 290.0, [leak(0, 2)])):
        one, other = running(leak(0, 1), 100.0, cells=300.0), running(leak(0, 2), noise, cells=cells)
        now = race(one, other)._replace(triggered=NOW + 1 - decision.LAST)
        standing = races.standings(now, [contender(leak(0, 1), 100.0), contender(leak(0, 2), 110.0)], PARAMS)
        found = decision.decided(now, standing, True, decision.Rules(), PARAMS)
        assert found.outcome == (decision.Outcome.GROUP if expected else decision.Outcome.JETS)
        assert found.winner is not None
        assert found.winner.contender.cause == leak(0, 1)
        assert [each.cause for each in found.group] == expected


def test_for_half_a_second_nothing_is_named_because_something_new_begins() -> None:
    now = race(surprised(leak(0), 60.0), leading=(contender(leak(0), 100.0),))
    for cycles, expected in ((6, False), (7, True)):
        young = now._replace(triggered=NOW + 1 - cycles)
        standing = races.standings(young, [contender(leak(0), 100.0), contender(leak(1), 95.0)], PARAMS)
        assert decision.decided(young, standing, True, decision.Rules(), PARAMS).shaken == expected


def test_what_a_filter_took_for_its_onset_may_be_all_that_it_is_off_the_first_order_by() -> None:
    """Where both have the same force it begins anew, though it fits and is far from the first order."""
    narrow, wide = ((0.06,), (0.01,)), ((0.6,), (0.1,))
    for force, expected in ((0.6, True), (1.0, False)):
        run = running(leak(0), 100.0)._replace(kicks=wide)
        some = [contender(leak(0), 122.0)._replace(force=(force * PARAMS.thrusts[0],), kicks=narrow)]
        now = race(run)
        found = races.running(now, races.standings(now, some, PARAMS), 2, PARAMS)
        assert (found.runs[0].cycle == ONSET) == expected
    run = running(leak(0), 100.0)._replace(kicks=wide)  # what is less likely to first order costs it nothing
    less = contender(leak(0), 78.0)._replace(force=(0.6 * PARAMS.thrusts[0],), kicks=narrow)
    assert races.running(race(run), races.standings(race(run), [less], PARAMS), 2, PARAMS).runs[0].cycle == NOW
    # at another onset the jet was told otherwise, and kicked otherwise
    elsewhere = contender(leak(0), 122.0)._replace(
        force=(0.6 * PARAMS.thrusts[0],), kicks=narrow, onset=ONSET + 1, at_onsets=((ONSET, 121.5), (ONSET + 1, 122.0))
    )
    now = race(running(leak(0), 100.0)._replace(kicks=wide))
    now = now._replace(screen=now.screen._replace(onsets=(ONSET, ONSET + 1)), states=(STATE,) * 3)
    assert races.running(now, races.standings(now, [elsewhere], PARAMS), 2, PARAMS).runs[0].cycle == NOW


def test_onsets_are_compared_with_each_other_to_first_order() -> None:
    other = contender(leak(0), 104.0)._replace(onset=ONSET + 1)
    for there, expected in ((100.0, True), (103.5, False)):
        now = race(running(leak(0), 101.0))
        now = now._replace(screen=now.screen._replace(onsets=(ONSET, ONSET + 1)), states=(STATE,) * 3)
        some = [other._replace(at_onsets=((ONSET, there), (ONSET + 1, 104.0)))]
        found = races.running(now, races.standings(now, some, PARAMS), 2, PARAMS)
        assert (found.runs[0].onset == ONSET + 1) == expected
