"""The detector by hypotheses, flown against a truth that is the filter's own prediction with something wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_probe import PERIOD, all_of, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.detectors import hypotheses
from massprop_drake.maths.estimation.detectors import multi_hypothesis as detector
from massprop_drake.maths.estimation.detectors.multi_hypothesis import (
    Declaration,
    HypothesisParams,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Word,
)
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import race as races
from massprop_drake.maths.estimation.joint.cycle import JointEvidence, Sample, step
from massprop_drake.maths.estimation.joint.decision import Decision, Outcome, decided
from massprop_drake.maths.estimation.joint.hypotheses import (
    FIT,
    NO_SCORE,
    Cause,
    Kind,
    Runner,
    Score,
    jumping,
    opened,
    without_increments,
)
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState, make_places, pack
from massprop_drake.maths.estimation.joint.measurement import outputs, rebased
from massprop_drake.maths.estimation.joint.prediction import drive, predict
from massprop_drake.maths.estimation.joint.race import Standing
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import initial_standard_deviation

JOINT = small_params(
    places=make_places((6, 2, 2), 2, (False, False), False, 2), second_order=False, flows=np.zeros(6), thrust_sigma=0.0
)
PARAMS = HypothesisParams(JOINT)
PLACES = JOINT.places
LITTLE = 0.05  # of full thrust


def settled_filter(params: JointParams = JOINT) -> JointState:
    """A filter that has settled, to a part in ten thousand."""
    state = some_state(params)
    mean, root = state.mean.copy(), np.zeros_like(state.root)
    mean[10:] = 0.0
    sigma = np.concatenate([1e-4 * np.abs(mean[:10]), np.full(3, 1e-5), np.full(6, 1e-4), np.full(2, 0.05)])
    root[: sigma.size, : sigma.size] = np.diag(sigma)
    return state._replace(
        mean=mean,
        root=root,
        level=np.zeros(6),
        spin=np.zeros(6),
        reference=np.zeros(3),
        slot_jet=np.full(2, -1.0),
        slot_sign=np.ones(2),
        guarded=True,
        freed=True,
        firing_count=100.0,
    )


def failed(truth: JointState, jet: int, sign: int, force: float) -> JointState:
    """The truth with a failure in the first slot; what is less than half of full thrust is a leak."""
    mean = truth.mean.copy()
    mean[PLACES.force] = force
    on_top = np.array([float(sign > 0 and force < 0.5 * JOINT.thrusts[jet]), 0.0])
    return truth._replace(
        mean=mean, slot_jet=np.array([jet, -1.0]), slot_sign=np.array([float(sign), 1.0]), slot_on_top=on_top
    )


class Flight:
    """Filter and detector against a truth; what was declared, at which cycle."""

    def __init__(self, params: HypothesisParams = PARAMS, seed: int = 0):
        self.params, self.rng = params, np.random.default_rng(seed)
        self.filter = self.truth = settled_filter(params.joint)
        draw = self.filter.root[:10, :10] @ self.rng.standard_normal(10)
        self.truth = self.truth._replace(mean=self.truth.mean + np.pad(draw, (0, PLACES.size - 10)))
        self.state = detector.initial(params.joint)
        self.said: list[tuple[int, Declaration]] = []
        self.judgments: list[detector.Judged] = []
        self.cycle = 0

    def command(self) -> Array:
        """Two jets at a time, a little, so that it does not turn fast."""
        pattern = np.zeros(6)
        pattern[(self.cycle // 4) % 6] = pattern[(self.cycle // 4 + 2) % 6] = LITTLE * (self.cycle % 8 < 6)
        return pattern

    def fly(self, cycles: int, lie: tuple[int, float] | None = None) -> Flight:
        """Flies on; the lie is a component and what it is off by, at the first of these cycles."""
        joint = self.params.joint
        for k in range(cycles):
            self.cycle += 1
            sample = some_sample(joint, time_s=self.cycle * PERIOD, commands=self.command()[None])
            acting = drive(self.truth, sample.durations_s, sample.commands, np.zeros(6), on_ticks(), joint)
            prediction = predict(self.truth, acting, unread(joint), joint)
            self.truth = self.truth._replace(
                mean=prediction.mean,
                spin=self.truth.spin + prediction.spin,
                level=acting.firing.level,
                slope=acting.firing.slope,
            )
            read, _ = outputs(self.truth.mean, self.truth.reference, self.truth.spin, joint)
            read = read + self.rng.standard_normal(12) * np.sqrt(joint.variances)
            if lie is not None and k == 0:
                read[lie[0]] += lie[1]
            self.take(sample._replace(rates=read[:6].reshape(2, 3), velocities=read[6:].reshape(2, 3)))
        return self

    def take(self, sample: Sample) -> None:
        """One cycle of filter and detector."""
        after, report = step(self.filter, sample, self.params.joint)
        judgment = detector.judge(self.state, self.filter, after, report, sample, self.params)
        self.filter = after if judgment.replacement is None else judgment.replacement
        self.state = judgment.state
        self.said += [(self.cycle, declaration) for declaration in judgment.declarations]
        self.judgments.append(judgment)

    def only(self, kind: type) -> Any:
        """The only declaration, which is of a kind."""
        assert [type(declaration) for _, declaration in self.said] == [kind]
        return self.said[0][1]

    def errors(self) -> Array:
        """Of the ten parameters, in sigmas."""
        deviation = np.sqrt(np.sum(self.filter.root[:10] ** 2, axis=1))
        result: Array = (self.filter.mean[:10] - self.truth.mean[:10]) / deviation
        return result


def test_nothing_is_said_of_a_healthy_flight() -> None:
    flown = Flight().fly(120)
    assert not flown.said
    assert np.abs(flown.errors()).max() < 4.5
    assert (flown.state.commanded > 0).all()


@pytest.mark.parametrize(("jet", "sign", "share"), [(1, 1, 1.0), (4, 1, 0.03), (0, -1, 1.0)])
def test_a_failed_jet_is_named_and_what_was_learned_since_is_undone(jet: int, sign: int, share: float) -> None:
    flown = Flight().fly(40)
    force = share * float(JOINT.thrusts[jet])
    flown.truth = failed(flown.truth, jet, sign, force)
    flown.fly(40)
    said = flown.only(JetsDeclared)
    assert (said.word, said.jets, said.signs) == (Word.FAILED, (jet,), (sign,))
    assert abs(said.forces[0] - force) < 4.5 * said.sigmas[0]
    assert said.onset_s == pytest.approx(40 * PERIOD, abs=4 * PERIOD)
    assert np.abs(flown.errors()).max() < 4.5
    row = PLACES.force
    assert abs(flown.filter.mean[row] - force) < 4.5 * np.linalg.norm(flown.filter.root[row])


def test_jets_that_fire_together_are_a_group_until_one_fires_alone() -> None:
    """Two jets in one place that have always been commanded together: nothing can tell which does not fire."""
    wrenches = JOINT.wrenches.copy()
    wrenches[1] = wrenches[0]
    params = HypothesisParams(JOINT._replace(wrenches=wrenches, thrusts=np.linalg.norm(wrenches[:, 3:], axis=1)))
    flown = Flight(params)

    def only(*jets: int) -> None:
        together = np.isin(np.arange(6), jets) * LITTLE
        flown.command = lambda: together * (flown.cycle % 6 < 3)  # type: ignore[method-assign]

    only(0, 1)
    flown.fly(40)
    thrust = float(params.joint.thrusts[0])
    flown.truth = failed(flown.truth, 0, -1, thrust)
    flown.fly(30)
    said = flown.only(JetsDeclared)
    assert said.word == Word.GROUP
    assert sorted(said.jets) == [0, 1]
    assert said.apart.jet in said.jets
    assert detector.untested(flown.state) == (2, 3, 4, 5)

    known, now = flown.state, flown.filter  # what is said of the slot later is of the group
    mean = now.mean.copy()
    mean[PLACES.force] *= 0.5
    _, (changed,) = detector._known_now(known, now._replace(mean=mean), params.joint)
    assert isinstance(changed, JetsDeclared)
    assert (changed.word, changed.jets, changed.signs) == (Word.CHANGED, said.jets, said.signs)
    unsaid = known._replace(announced=np.zeros(2), onsets=np.array([3.0, np.nan]))
    told, (late,) = detector._known_now(unsaid, now, params.joint)
    assert isinstance(late, JetsDeclared)
    assert (late.word, late.jets, late.apart.jet) == (Word.GROUP, said.jets, said.apart.jet)
    assert (changed.onset_s, late.onset_s) == (now.time_s, 3.0)  # of a drift, and of what a race has found before
    assert np.isnan(told.onsets).all()

    likeliest, other = said.jets  # it is the other
    flown.truth = failed(flown.truth, other, -1, thrust)
    only(likeliest)
    flown.fly(40)
    only(other)
    flown.fly(40)
    _, (_, gone), (_, last) = flown.said
    assert isinstance(gone, JetsDeclared)
    assert isinstance(last, JetsDeclared)
    assert (gone.word, gone.jets) == (Word.WITHDRAWN, said.jets)
    assert gone.onset_s == pytest.approx(70 * PERIOD, abs=2 * PERIOD)
    assert (last.word, last.jets) == (Word.FAILED, (other,))
    assert (np.count_nonzero(flown.state.members, axis=1) == 1).all()  # now it is told apart


def test_nobody_is_blamed_for_a_force_that_nothing_explains() -> None:
    """A slot that a race left behind undecided says nothing, however its force changes."""
    flown = Flight()
    slots = flown.filter.slot_jet.copy()
    slots[0], mean = 3.0, flown.filter.mean.copy()
    for force in (0.0, 0.8, 0.1):
        mean[PLACES.force] = force
        left = flown.filter._replace(slot_jet=slots, mean=mean)
        assert detector._known_now(flown.state, left, JOINT)[1] == ()


def test_nothing_is_tested_while_a_reading_is_held_as_lying_or_missing() -> None:
    flown = Flight().fly(40)
    lying = np.zeros(12)
    lying[4] = 1.0
    for cycle, held in enumerate((True, False)):
        if held:
            flown.state = flown.state._replace(lying=lying)
        flown.fly(1, lie=(4, 1.0) if held else None)
        assert flown.judgments[-1].status.tested is not held, cycle
    assert not flown.state.lying.any()
    blind = some_sample(JOINT, time_s=99.0, velocities=np.zeros((2, 3)), rates=np.full((2, 3), np.nan))
    flown.take(blind)
    assert not flown.judgments[-1].status.tested


@pytest.mark.parametrize(("component", "off"), [(4, 1e-3), (8, 0.5)])
def test_a_reading_that_lies_once_is_named_and_does_no_harm(component: int, off: float) -> None:
    flown = Flight().fly(40)
    flown.fly(30, lie=(component, off))
    said = flown.only(ReadingDeclared)
    assert said.component == component
    assert not flown.state.lying.any()
    assert all(judged.status.tested for judged in flown.judgments[1:])
    assert np.abs(flown.errors()).max() < 4.5


GAINED, WHERE = 1.5, np.array([0.4, -0.2, 0.3])


def loaded() -> Flight:
    """A flight that has just gained a payload."""
    widest = initial_standard_deviation(JOINT.start, 1.0, 0.1)  # as filters are told it: a jump is 0.3 of that
    flown = Flight(HypothesisParams(JOINT._replace(increment_sigma=widest))).fly(40)
    mean = rebased(flown.truth, JOINT).mean.copy()
    mass = 1.0 / mean[9]
    center = (mass * mean[6:9] + GAINED * WHERE) / (mass + GAINED)
    flown.truth = rebased(flown.truth, JOINT)
    mean[6:9], mean[9] = center, 1.0 / (mass + GAINED)
    flown.truth = flown.truth._replace(mean=mean)
    return flown


def test_a_jump_is_said_with_a_size_only_if_its_filter_fits_and_the_mass_shows() -> None:
    flown = loaded()
    while flown.state.race is None or not any(run.cause.kind == Kind.JUMP for run in flown.state.race.runs):
        flown.fly(1)
    race, joint = flown.state.race, flown.params.joint
    run = next(run for run in race.runs if run.cause.kind == Kind.JUMP)
    weighed = loaded().fly(110).filter
    for misfit, state, known in (
        (FIT - 0.1, weighed, True),
        (FIT + 0.1, weighed, False),
        (FIT - 0.1, run.state, False),
    ):
        score = run.score._replace(nis=run.score.degrees + misfit * np.sqrt(2.0 * run.score.degrees))
        contender = Contender(run.cause, run.onset, 500.0)
        standing = Standing(contender, run._replace(score=score, state=state), contender, 500.0, 0.0, 500.0)
        after, now, (said,) = detector._concluded(flown.state, flown.filter, Decision(Outcome.JUMP, standing), joint)
        assert isinstance(said, JumpDeclared)
        assert [np.isfinite(said.mass), np.isfinite(said.mass_sigma)] == [known, known]
        assert now is state
        assert after.earlier is race.states[0]  # its size is measured later in either case


def test_a_jump_learns_nothing_while_it_may_not_have_happened() -> None:
    flown = loaded()
    while flown.state.race is None:
        flown.fly(1)
    race, history, quiet = flown.state.race, flown.state.history, without_increments(flown.params.joint)
    onset, still = race.screen.began, np.zeros(PLACES.n_force)
    run = Runner(Cause(Kind.JUMP), onset, (), onset, race.states[0], NO_SCORE, False)
    (within,) = races.stepped_on(race._replace(runs=(run,)), 1, history, still, quiet)[0].runs
    before, sample = opened(race.states[0], run.cause, quiet), history.at(onset + 1).sample
    np.testing.assert_allclose(within.state.mean[:10], before.mean[:10], rtol=1e-12)
    widths = [np.sqrt(np.sum(state.root[:10] ** 2, axis=1)) for state in (within.state, before)]
    np.testing.assert_allclose(*widths, rtol=1e-9)
    np.testing.assert_allclose(within.state.mean[10:13], sample.rates.mean(axis=0), atol=1e-5)

    over = race.screen.onsets[-1]  # one cycle after the last onset it learns
    (now,) = races.stepped_on(race._replace(runs=(run,)), over + 1 - onset, history, still, quiet)[0].runs
    assert now.cycle == over + 1
    np.testing.assert_allclose(now.state.mean[:10], before.mean[:10], rtol=1e-12)
    assert now.entry == now.score


def test_until_a_jump_happens_nothing_has() -> None:
    flown = loaded()
    while flown.state.race is None:
        flown.fly(1)
    race, history, quiet = flown.state.race, flown.state.history, without_increments(flown.params.joint)
    onset = race.screen.began
    run = Runner(Cause(Kind.JUMP), onset, (), onset, race.states[0], NO_SCORE, False)
    sample, counts = history.at(onset + 1).sample, all_of(12)
    likely, unlikely = Score(1e6, 1e6, 1.0, 3.0), Score(-1e6, -1e6, 1.0, 3.0)
    assert jumping(run, sample, likely, counts, quiet).score == likely
    assert jumping(run, sample, unlikely, counts, quiet).score.degrees == 12.0


def test_a_jump_is_announced_once_with_its_size() -> None:
    flown = loaded().fly(110)
    (_, found), (_, said) = flown.said
    assert isinstance(found, JumpDeclared)
    assert isinstance(said, JumpDeclared)
    assert (found.measured, said.measured) == (False, True)
    assert said.mass_sigma < 0.2 * GAINED
    assert abs(said.mass - GAINED) < 4.5 * said.mass_sigma
    assert (np.abs(said.position - WHERE) < 4.5 * said.position_sigma).all()
    assert np.abs(flown.errors()).max() < 4.5


def test_the_same_cycle_judged_again_gives_the_same_and_changes_nothing_that_came_in() -> None:
    flown = Flight().fly(40)
    flown.truth = failed(flown.truth, 1, 1, 0.03)
    flown.fly(2)
    joint = flown.params.joint
    sample = some_sample(
        joint, time_s=99.0, commands=np.zeros((1, 6)), rates=np.full((2, 3), 0.01), velocities=np.zeros((2, 3))
    )
    after, report = step(flown.filter, sample, joint)
    kept = [pack(flown.filter, PLACES), pack(after, PLACES), flown.state.bank.learned.copy()]
    first = detector.judge(flown.state, flown.filter, after, report, sample, flown.params)
    second = detector.judge(flown.state, flown.filter, after, report, sample, flown.params)
    for one, other in zip((first, second), (second, first), strict=True):
        assert (one.published is None) == (other.published is None)
        if one.published is not None and other.published is not None:
            np.testing.assert_array_equal(pack(one.published, PLACES), pack(other.published, PLACES))
        assert one.declarations == other.declarations
    for was, now in zip(kept, [pack(flown.filter, PLACES), pack(after, PLACES), flown.state.bank.learned], strict=True):
        np.testing.assert_array_equal(was, now)
    assert first.status.racing


def test_what_a_jet_gives_too_much_while_it_is_told_to_fire_may_be_its_thrusts_error() -> None:
    floors = {
        (sign, told): detector._floor(0, sign, told, True, JOINT) / JOINT.thrusts[0]
        for sign in (1, -1)
        for told in (True, False)
    }
    assert floors[1, True] == floors[-1, True] == floors[-1, False] == pytest.approx(0.1)
    assert floors[1, False] < 0.01
    flight = Flight().fly(40)
    over = flight.state.history.records[-1].link
    on = over.amount > 0.5 * over.duration_s
    assert [detector._told(jet, over) for jet in range(6)] == on.tolist()


def test_what_began_shortly_before_a_decision_is_in_the_bank_after_it() -> None:
    patient = PARAMS._replace(rules=PARAMS.rules._replace(lead_nothing=1e4))
    flight = Flight(patient).fly(60)
    flight.truth = failed(flight.truth, 0, 1, 0.004 * JOINT.thrusts[0])
    while not flight.said:
        flight.fly(1)
    bank, history, since = flight.state.bank, flight.state.history, flight.cycle - 60
    assert since > 4
    assert 1 < len(bank.states) == len(history.records) <= since
    np.testing.assert_array_equal(np.diff(bank.cycles), 1.0)
    assert bank.cycles[-1] == history.last == flight.cycle
    sigma = np.sqrt(np.sum(flight.filter.root**2, axis=1))
    off = np.abs(bank.states[-1].mean - flight.filter.mean)
    assert (off <= 1e-3 * sigma).all()  # on the winner's way, but for what its impulse still builds up


def test_a_race_about_what_has_just_begun_looks_before_what_nothing_explained() -> None:
    """And one that begins later looks where the bank has it."""
    bank = banks.empty(JOINT.places)._replace(cycles=np.arange(10.0, 16.0))
    total = np.array([100.0, 100.0, 100.0, 50.0, 80.0, 90.0])
    for explained, cycle, expected in ((12, 16, 2), (12, 24, 2), (12, 25, 5), (9, 16, 5), (-1, 16, 5)):
        state = detector.initial(JOINT)._replace(bank=bank, explained=explained, cycle=cycle)
        assert detector._onset(state, total) == expected


def test_a_covariance_without_a_root_is_said_with_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: Any) -> Any:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    flight = Flight()
    sample = some_sample(JOINT, time_s=3.5)
    after, report = step(flight.filter, sample, JOINT)
    evidence = JointEvidence(flight.filter, after, report, sample, False)
    assert hypotheses.judge(hypotheses.initial(PARAMS), evidence, PARAMS).replacement is None
    monkeypatch.setattr(detector, "judge", lost)
    with pytest.raises(NotPositiveDefiniteError, match=r"compares hypotheses is not .* at t = 3\.5 s"):
        hypotheses.judge(hypotheses.initial(PARAMS), evidence, PARAMS)


@pytest.mark.parametrize("drifts", [True, False])
def test_the_force_of_a_jet_that_was_found_to_drift_is_followed(monkeypatch: pytest.MonkeyPatch, drifts: bool) -> None:
    """It walks on from what it was found to be; of one that is not known to drift a constant force is believed."""

    def found(*given: Any) -> Decision:
        made = decided(*given)
        if made.winner is None or made.winner.contender.cause.kind != Kind.JETS:
            return made
        cause = made.winner.contender.cause._replace(drifts=drifts)
        return made._replace(winner=made.winner._replace(contender=made.winner.contender._replace(cause=cause)))

    monkeypatch.setattr(detector, "decided", found)
    flown, thrust = Flight().fly(40), float(JOINT.thrusts[0])
    for cycle in range(120):
        flown.truth = failed(flown.truth, 0, -1, (0.1 + 0.01 * PERIOD * cycle) * thrust)
        flown.fly(1)
    assert {(type(said), said.jets) for _, said in flown.said} == {(JetsDeclared, (0,))}
    assert (flown.state.erratic[0] == pytest.approx(0.03 * PERIOD)) == drifts
    row = PLACES.force
    off = abs(flown.filter.mean[row] - flown.truth.mean[row])
    assert (off < 4.5 * np.linalg.norm(flown.filter.root[row])) == drifts
    assert np.abs(flown.errors()).max() < 4.5
