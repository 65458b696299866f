"""Flights of a small vehicle with hypotheses: who is named and when, odds, bounds of what it costs, disturbances."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from faults_probe import JETS, Flown, commands_of, dock, fail, flight, known_vehicle, make_params, push
from joint_probe import PERIOD, some_sample, unread

from massprop_drake.maths.estimation.faults.alarms import Watch, WatchedCycle, likelihood_loss
from massprop_drake.maths.estimation.faults.declarations import (
    DisturbanceDeclared,
    JetsDeclared,
    JumpDeclared,
    Mode,
    ReadingDeclared,
    Word,
)
from massprop_drake.maths.estimation.faults.fault_events import no_fault_hypothesis
from massprop_drake.maths.estimation.faults.priors import Params
from massprop_drake.maths.estimation.faults.tree import probabilities
from massprop_drake.maths.estimation.faults.verdicts import fault_probabilities
from massprop_drake.maths.estimation.joint.bank import empty_bank
from massprop_drake.maths.estimation.joint.hypotheses import (
    NO_SCORE,
    STIRS,
    Cause,
    Kind,
    Score,
    add_disturbance_drift,
    apply_cause,
    unstated_disturbance_sigmas,
)
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces
from massprop_drake.maths.estimation.joint.layout import RATE
from massprop_drake.maths.estimation.joint.prediction import predict, propagate_root

ROUNDED, NOISY = make_params(quantum=3e-3), make_params()
THRUSTS = NOISY.joint.thrusts
ONSET = 30  # index of the first interval of a failure
COMMANDS = commands_of(50, idle=(3,))
COMMANDS[46:49, 3] = 1.0  # which tells a leak from a jet that is stuck
PARAMETERS = pytest.mark.parametrize("params", [ROUNDED, NOISY], ids=["rounded", "noisy"])


def of(one: object, kind: type[Any]) -> Any:
    """A declaration of a kind."""
    assert isinstance(one, kind)
    return one


def worst(flown: Flown) -> float:
    """Largest error of the ten parameters at the end, in their sigma."""
    state = flown.filters[-1]
    sigma = np.linalg.norm(state.root[:10], axis=1)
    return float(np.abs((state.mean - flown.truths[-1].mean)[:10] / sigma).max())


@PARAMETERS
def test_of_a_healthy_flight_one_hypothesis_is_left(params: Params) -> None:
    flown = flight(params, COMMANDS)
    assert flown.said == []
    assert [len(tree.hypotheses) for tree in flown.trees] == [1] * len(flown.trees)
    assert all(fault_probabilities(tree, params.joint).none == 1.0 for tree in flown.trees)
    assert worst(flown) < 4.0


@pytest.mark.parametrize(
    ("params", "jet", "sign", "share", "mode"),
    [
        (NOISY, 3, 1, 1.0, Mode.STUCK_ON),
        (ROUNDED, 3, 1, 0.2, Mode.LEAK),
        (ROUNDED, 1, -1, 1.0, Mode.STUCK_OFF),
        (NOISY, 0, -1, 0.4, Mode.LOSS),
    ],
    ids=["stuck on", "leak", "stuck off", "loss"],
)
def test_a_failed_jet_is_named_with_its_force(params: Params, jet: int, sign: int, share: float, mode: Mode) -> None:
    """Within half a second of its first effect, at the right onset, nobody else; what is learned stays right.

    What was likely before is let go, once a review of what is likely now looks for what may have happened instead.
    """
    force, on_top = share * THRUSTS[jet], int(mode == Mode.LEAK)
    flown = flight(params, COMMANDS, changes={ONSET: fail(jet, force, sign, on_top)})
    ((time_s, one),) = flown.said
    said = of(one, JetsDeclared)
    assert (said.word, said.jets, said.signs) == (Word.FAILED, (jet,), (sign,))
    acts = ONSET + int(np.argmax(COMMANDS[ONSET:, jet] > 0.0)) if sign < 0 else ONSET
    assert time_s - 0.1 * acts <= 0.5
    assert abs(said.onset_s - 0.1 * ONSET) <= 0.1 + 0.1 * (acts - ONSET)
    assert abs(said.forces[0] - force) < 4.5 * said.sigmas[0]
    for after in range(ONSET):
        assert flown.probability(jet, after) == 0.0
    found, leader = fault_probabilities(flown.tree, params.joint), flown.tree.leader
    assert found.jets[jet] > 0.999
    assert np.delete(found.jets, jet).max() < 1e-3
    assert found.modes[jet] == mode
    assert abs(sign * found.forces[jet] - force) < 4.5 * found.sigmas[jet]
    assert worst(flown) < 4.0
    if sign > 0:
        assert (leader.run.state.slot_on_top[0], leader.decided) == (on_top, {jet})
    assert any(not each.events for each in flown.trees[ONSET + 1].hypotheses)
    assert min(each.weight for each in flown.tree.hypotheses) > leader.weight - 30.0


def test_a_payload_is_a_jump_and_no_jet() -> None:
    flown = flight(NOISY, COMMANDS, changes={ONSET: dock(NOISY.joint, 0.3)})
    ((time_s, one),) = flown.said
    said = of(one, JumpDeclared)
    assert time_s < 0.1 * ONSET + 0.6
    assert said.onset_s == pytest.approx(0.1 * ONSET)
    assert not said.measured
    assert fault_probabilities(flown.tree, NOISY.joint).jets.max() < 1e-3
    assert worst(flown) < 4.0


@pytest.mark.parametrize(("params", "component"), [(ROUNDED, 1), (NOISY, 7)])
def test_a_false_reading_is_named_and_costs_nothing(params: Params, component: int) -> None:
    flown = flight(params, COMMANDS, false={ONSET: 0.5 * np.eye(12)[component]})
    ((_, one),) = flown.said
    said = of(one, ReadingDeclared)
    assert (said.component, said.onset_s) == (component, pytest.approx(0.1 * ONSET))
    assert fault_probabilities(flown.tree, params.joint).jets.max() < 1e-3
    assert worst(flown) < 4.0


def test_a_force_that_its_vehicle_cannot_have_is_something_unknown() -> None:
    """A push that no jet gives, from outside: nobody is named."""
    params = ROUNDED
    rng = np.random.default_rng(3)
    pushes = {row: 0.2 * rng.standard_normal(12) for row in range(ONSET, ONSET + 12)}
    flown = flight(params, COMMANDS, false=pushes)
    assert not [one for _, one in flown.said if isinstance(one, JetsDeclared)]
    assert fault_probabilities(flown.tree, params.joint).jets.max() < 0.5


def test_a_failure_beside_a_known_one_is_named_among_so_many_hypotheses() -> None:
    """Sixteen, besides what was likely before an alarm; the likeliest comes first; each key stands once."""
    changes = {20: fail(3, 0.3 * THRUSTS[3], 1, 1), 33: fail(1, THRUSTS[1], -1)}
    flown = flight(ROUNDED, COMMANDS[:42], changes=changes)
    assert [of(one, JetsDeclared).jets for _, one in flown.said] == [(3,), (1,)]
    assert [of(one, JetsDeclared).word for _, one in flown.said] == [Word.FAILED] * 2
    assert max(len(tree.hypotheses) for tree in flown.trees) > 4
    for tree in flown.trees:
        shares = [share for _, share in probabilities(tree)]
        assert sum(shares) == pytest.approx(1.0)
        assert shares == sorted(shares, reverse=True)
        now_s = tree.leader.run.state.time_s
        others = [each for each in tree.hypotheses if each.root_until_s < now_s]
        assert len({each.key for each in others}) == len(others) <= 16
        assert len(tree.hypotheses) <= 16 + JETS
        found = fault_probabilities(tree, ROUNDED.joint)
        assert 0.0 <= found.none + found.unknown <= 1.0 + 1e-12
        assert ((found.jets >= 0.0) & (found.jets <= 1.0)).all()
        assert found.hypotheses == len(tree.hypotheses)


def test_a_sample_that_lacks_a_sensor_is_no_surprise() -> None:
    """A tracker in every third sample adds to its log likelihood what others lack; misfit alone is news."""
    hypothesis, score, records = no_fault_hypothesis(known_vehicle(NOISY.joint), 0, NOISY.joint), NO_SCORE, []
    for number in range(12):
        tracked = 25.0 if number % 3 == 0 else 0.0
        score = score.plus(Score(50.0 + tracked, 12.0, 12.0))
        records.append(WatchedCycle(None, None, score))
    watch = Watch(empty_bank(NOISY.joint.places), tuple(records))
    assert likelihood_loss(hypothesis) == likelihood_loss(hypothesis._replace(watch=watch)) == 0.0
    off = WatchedCycle(None, None, score.plus(Score(20.0, 42.0, 12.0)))
    assert likelihood_loss(hypothesis._replace(watch=watch._replace(records=(*records, off)))) == pytest.approx(15.0)


PARAMS = make_params(unstated=6)
JOINT = PARAMS.joint
PLACES = JOINT.places
OWN = slice(PLACES.unstated, PLACES.unstated + 6)
KNOWN = known_vehicle(JOINT)


def swinging(count: int, onset: int) -> dict[int, object]:
    """An acceleration of every component that swings once in some four seconds, from an interval on."""
    most = 0.02 * JOINT.unstated.diagonal()
    phases = np.arange(6.0)
    return {k: push(JOINT, most * np.sin(1.6 * PERIOD * (k - onset) + phases)) for k in range(onset, count)}


def test_something_unstated_is_said_with_its_size_and_no_jet_is_named() -> None:
    flown = flight(PARAMS, commands_of(40), changes=swinging(40, 10))
    said = [one for _, one in flown.said]
    assert not [one for one in said if isinstance(one, JetsDeclared)]
    first = next(one for one in said if isinstance(one, DisturbanceDeclared))
    torque, force = unstated_disturbance_sigmas(0.02, JOINT)
    assert 0.1 * torque < first.torque < 10.0 * torque
    assert 0.1 * force < first.force < 10.0 * force


def test_a_failed_jet_is_named_where_something_unstated_may_act() -> None:
    flown = flight(PARAMS, commands_of(40), changes={15: fail(2, 0.1 * JOINT.thrusts[2], on_top=1)})
    named = {one.jets for _, one in flown.said if isinstance(one, JetsDeclared)}
    assert named == {(2,)}
    assert not [one for _, one in flown.said if isinstance(one, DisturbanceDeclared)]


def test_it_stays_as_strong_as_it_is_while_nothing_is_read() -> None:
    acts = apply_cause(KNOWN, Cause(Kind.WANDER, component=4), JOINT)
    sample = some_sample(JOINT, commands=np.zeros((1, 6)))
    prediction = predict(acts, estimate_forces(acts, sample, JOINT), unread(JOINT), JOINT)
    root = propagate_root(acts.root, prediction, JOINT)
    np.testing.assert_allclose(root[OWN] @ root[OWN].T, STIRS[4][0] ** 2 * np.eye(6), rtol=1e-9, atol=1e-15)
    turned = np.sqrt(np.sum(root[RATE] ** 2, axis=1))
    given = STIRS[4][0] * PERIOD * JOINT.unstated.diagonal()[:3]
    assert (turned > 0.95 * given).all()


def test_what_has_acted_until_now_has_made_parameters_less_well_known() -> None:
    acts = KNOWN._replace(stir=0.1)
    once = add_disturbance_drift(acts, 0.0, PERIOD, JOINT)
    share = once.root[0, 0] / KNOWN.root[0, 0]
    assert share > 2.0
    np.testing.assert_allclose(abs(once.root[:10, :10]), share * abs(KNOWN.root[:10, :10]), atol=1e-18)
    again = add_disturbance_drift(acts, 0.1, PERIOD, JOINT)
    np.testing.assert_allclose(abs(again.root[:10, :10]), abs(KNOWN.root[:10, :10]), atol=1e-18)
