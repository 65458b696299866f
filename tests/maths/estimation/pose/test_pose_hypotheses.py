"""Hypotheses about jets: rules on likelihoods that are made up, moments by hand, and flights of a body of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, Truth, again, bearing, params_of, planar_poses, pulses, small_params, some_bank, told
from scipy.spatial.transform import Rotation

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.pose import pose_hypotheses, pose_start
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseOutcome, PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import Array

RULES = PoseRules()
PUSH = 2 * JETS
PERIOD = 0.1


# ------------------------------------------------------------------------------------------- banks


def fresh(**changed: Any) -> tuple[Tried, PoseParams]:
    params = small_params(**changed)
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, params.parts.open] = 0.0
    return pose_hypotheses.begun(bank, 0.0, params), params


def with_odds(tried: Tried, *leads: tuple[int, float]) -> Tried:
    """The hypotheses with likelihoods made up; those not named are far behind."""
    likelihood = np.full(2 + 2 * JETS, -50.0)
    likelihood[0] = 0.0
    for member, lead in leads:
        likelihood[1 + member] = lead
    return tried._replace(likelihood=likelihood)


def judged_often(
    tried: Tried, params: PoseParams, samples: int, first_s: float = 0.1
) -> tuple[Tried, list[PoseOutcome | None]]:
    """So many samples with the same likelihoods."""
    found = []
    for index in range(samples):
        now = first_s + PERIOD * index
        tried, said = pose_hypotheses.judged(tried._replace(renewed_s=now), now, RULES, params)
        found.append(said)
    return tried, found


def test_a_weak_jet_gives_anything_of_what_the_healthy_ones_give_and_varies_with_them() -> None:
    tried, _ = fresh()
    first, own = tried.bank.covariance[0], tried.bank.covariance[1 + 1]
    factors = tried.bank.mean[0, :JETS]
    typical = factors[[0, 2, 3]].mean()
    assert float(tried.bank.mean[2, 1]) == pytest.approx(0.5 * typical, rel=1e-12)
    random = np.random.default_rng(6)
    drawn = random.multivariate_normal(np.zeros(first.shape[0]), first, 20_000)
    drawn[:, 1] = 0.5 * drawn[:, [0, 2, 3]].mean(axis=1) + 0.3 * typical * random.standard_normal(len(drawn))
    deviation = np.sqrt(own.diagonal())
    scale = np.outer(deviation, deviation)
    np.testing.assert_allclose(np.cov(drawn.T) / scale, own / scale, atol=0.04)


def test_a_jet_that_stands_open_and_a_push_have_what_they_may_be_of() -> None:
    tried, params = fresh()
    opening = params.parts.open.start
    np.testing.assert_array_equal(tried.bank.opens, [-1, *[-1] * JETS, *range(JETS), PUSHED])
    assert tried.bank.mean[1 + JETS + 2, opening] == 0.5
    grown = tried.bank.covariance - tried.bank.covariance[0]
    assert float(grown[1 + JETS + 2, opening, opening]) == pytest.approx(0.09, rel=1e-9)
    push = params.parts.push
    largest = np.linalg.norm(params.pushes, axis=1).max()
    np.testing.assert_allclose(grown[-1].diagonal()[push][:3], (0.5 * largest) ** 2, rtol=1e-9)
    assert np.count_nonzero(np.abs(grown[-1]) > 1e-15) == 6


def test_before_the_record_a_push_is_as_probable_as_all_failures_of_jets_together() -> None:
    tried, _ = fresh()
    odds = np.exp(tried.likelihood)
    np.testing.assert_allclose(odds[1:-1], pose_hypotheses.BEFORE, rtol=1e-12)
    assert odds[-1] == pytest.approx(odds[1:-1].sum(), rel=1e-12)


def test_merged_filters_have_the_moments_of_both() -> None:
    params = small_params()
    one, other = some_bank(params, opens=(0, 1), seed=1), some_bank(params, opens=(0, 1), seed=2)
    near = one.rotation @ Rotation.from_rotvec([[0.01, -0.02, 0.03], [0.02, 0.0, -0.01]]).as_matrix()
    other = other._replace(rotation=near)
    share = np.array([0.3, 0.8])
    found = pose_hypotheses.merged(one, other, share, params)
    turn = params.parts.attitude
    second = other.mean.copy()
    second[:, turn] = [[0.01, -0.02, 0.03], [0.02, 0.0, -0.01]]
    for row, part in enumerate(share):
        mean = (1.0 - part) * one.mean[row] + part * second[row]
        squares = sum(
            weight * (covariance + np.outer(at, at))
            for weight, covariance, at in (
                (1.0 - part, one.covariance[row], one.mean[row]),
                (part, other.covariance[row], second[row]),
            )
        )
        np.testing.assert_allclose(found.covariance[row], squares - np.outer(mean, mean), atol=1e-12)
        rest = np.delete(np.arange(mean.size), turn)
        np.testing.assert_allclose(found.mean[row, rest], mean[rest], rtol=1e-12)
        turned = Rotation.from_rotvec(mean[turn]).as_matrix()
        np.testing.assert_allclose(found.rotation[row], one.rotation[row] @ turned, atol=1e-12)
    np.testing.assert_array_equal(found.mean[:, turn], 0.0)


# ------------------------------------------------------------------------------------------- rules


def _weak(tried: Tried, jet: int, factor: float = 0.1, std: float = 0.02) -> Tried:
    """A hypothesis whose filter has found its jet to give a share of the others."""
    mean, covariance = tried.bank.mean.copy(), tried.bank.covariance.copy()
    others = np.delete(np.arange(JETS), jet)
    mean[1 + jet, jet] = factor * float(np.median(mean[1 + jet, others]))
    covariance[1 + jet] = std**2 * np.eye(covariance.shape[1])
    return tried._replace(bank=tried.bank._replace(mean=mean, covariance=covariance))


def test_a_jet_is_named_once_it_has_led_for_ten_samples() -> None:
    tried, params = fresh()
    tried, found = judged_often(with_odds(_weak(tried, 1), (1, 20.0)), params, pose_hypotheses.STEADY)
    assert found[:-1] == [None] * (pose_hypotheses.STEADY - 1)
    said = found[-1]
    assert said is not None
    assert said.members == (1,)
    assert said.lead == pytest.approx((70.0, 20.0))
    assert said.share[0] == pytest.approx(0.9, abs=1e-6)
    assert said.onset_s == 0.0


def test_a_sample_that_says_otherwise_begins_the_count_anew() -> None:
    tried, params = fresh()
    leads = with_odds(_weak(_weak(tried, 1), 2), (1, 20.0))
    tried, found = judged_often(leads, params, pose_hypotheses.STEADY - 1)
    tried, found = judged_often(with_odds(tried, (2, 20.0)), params, 1, 1.0)  # another one leads
    assert (tried.leader, tried.steady) == (2, 1)
    tried, found = judged_often(with_odds(tried, (1, 20.0)), params, pose_hypotheses.STEADY - 1, 1.1)
    assert found == [None] * (pose_hypotheses.STEADY - 1)
    tried, found = judged_often(with_odds(tried, (1, 11.0)), params, 1, 2.0)  # not far enough ahead of no failure
    assert (tried.leader, tried.steady) == (-1, 0)
    assert np.isnan(tried.led_s)


@pytest.mark.parametrize(("factor", "std"), [(0.95, 0.001), (0.7, 0.15)], ids=["below a tenth", "below 3 sigma"])
def test_odds_alone_name_no_jet_that_lost_little(factor: float, std: float) -> None:
    tried, params = fresh()
    _, found = judged_often(with_odds(_weak(tried, 1, factor, std), (1, 300.0)), params, 20)
    assert found == [None] * 20


def test_what_healthy_jets_differ_by_counts_in_the_size_of_a_loss() -> None:
    for thrust_std, named in ((0.02, True), (0.15, False)):
        tried, params = fresh(thrust_std=np.full(JETS, thrust_std))
        _, found = judged_often(with_odds(_weak(tried, 1, 0.7, 1e-3), (1, 300.0)), params, pose_hypotheses.STEADY)
        assert (found[-1] is not None) == named


def test_what_nothing_tells_apart_is_a_group_after_patience_and_nothing_is_taken() -> None:
    tried, params = fresh()
    tried = with_odds(_weak(_weak(tried, 1), 3), (1, 20.0), (3, 17.0), (0, 13.0))
    count = round(pose_hypotheses.PATIENCE_S / PERIOD) + pose_hypotheses.STEADY
    found = []
    for index in range(count):
        tried, said = pose_hypotheses.judged(tried._replace(renewed_s=PERIOD * index), PERIOD * index, RULES, params)
        found.append(said)
    first = next(index for index, said in enumerate(found) if said is not None)
    assert first * PERIOD == pytest.approx(pose_hypotheses.PATIENCE_S + (pose_hypotheses.STEADY - 1) * PERIOD, abs=1e-9)
    said = found[first]
    assert said is not None
    assert said.members == (1, 3)  # the third is 7 nats behind
    assert said.lead[0] == pytest.approx(7.0)
    np.testing.assert_array_equal(tried.known, 0.0)


def test_what_is_named_is_the_first_filter_and_all_begin_anew_from_it() -> None:
    tried, params = fresh()
    weak = _weak(tried, 1)
    taken, found = judged_often(with_odds(weak, (1, 20.0)), params, pose_hypotheses.STEADY)
    assert found[-1] is not None
    np.testing.assert_array_equal(np.flatnonzero(taken.known), [1])
    np.testing.assert_array_equal(taken.bank.mean[0], weak.bank.mean[2])
    np.testing.assert_array_equal(taken.bank.covariance[0], weak.bank.covariance[2])
    assert taken.likelihood[0] == 0.0
    assert np.isneginf(taken.likelihood[2])  # it is known, and no question any more
    # the healthy ones alone say what a weak jet is weak against
    others = taken.bank.mean[0, [2, 3]].mean()
    assert float(taken.bank.mean[1, 0]) == pytest.approx(0.5 * others, rel=1e-12)


def test_once_a_jet_stands_open_no_second_one_is_looked_for() -> None:
    tried, params = fresh()
    mean, covariance = tried.bank.mean.copy(), tried.bank.covariance.copy()
    covariance[1 + JETS + 2] = 1e-4 * np.eye(covariance.shape[1])
    mean[1 + JETS + 2, params.parts.open] = 0.6
    tried = tried._replace(bank=tried.bank._replace(mean=mean, covariance=covariance))
    tried, found = judged_often(with_odds(tried, (JETS + 2, 20.0)), params, pose_hypotheses.STEADY)
    said = found[-1]
    assert said is not None
    assert said.share[0] == pytest.approx(0.6)
    assert np.isneginf(tried.likelihood[1 + JETS : 1 + 2 * JETS]).all()
    np.testing.assert_array_equal(tried.bank.opens, 2)


def test_a_push_is_taken_but_may_come_again() -> None:
    tried, params = fresh()
    tried, found = judged_often(with_odds(tried, (PUSH, 20.0)), params, pose_hypotheses.STEADY)
    said = found[-1]
    assert said is not None
    assert said.members == (PUSH,)
    np.testing.assert_array_equal(tried.known, 0.0)
    assert np.isfinite(tried.likelihood).all()


def test_every_renewal_a_jet_may_also_have_failed_now() -> None:
    tried, params = fresh()
    before = with_odds(tried, (0, 5.0))
    later = pose_hypotheses.RENEWAL_S
    same, _ = pose_hypotheses.judged(before, later - 0.1, RULES, params)
    assert same.renewed_s == 0.0
    np.testing.assert_array_equal(same.likelihood, before.likelihood)
    renewed, _ = pose_hypotheses.judged(before, later, RULES, params)
    assert renewed.renewed_s == later
    chance = pose_hypotheses.BEFORE * later / pose_hypotheses.AGAIN_S
    np.testing.assert_allclose(renewed.likelihood[1 + 1], np.log(np.exp(-50.0) + chance), rtol=1e-12)
    np.testing.assert_allclose(renewed.likelihood[1], np.log(np.exp(5.0) + chance), rtol=1e-12)
    np.testing.assert_allclose(renewed.likelihood[-1], np.log(np.exp(-50.0) + 2 * JETS * chance), rtol=1e-12)
    np.testing.assert_array_equal(renewed.onset_s[1:3], [0.0, later])  # the leader holds on, the other begins now
    assert len(renewed.bank.mean) == len(before.bank.mean)
    again = pose_hypotheses.failing(before.bank, before.known, params)
    np.testing.assert_allclose(renewed.bank.mean[2], again.mean[1], rtol=1e-9)


def test_likelihoods_gather_what_every_sample_says_against_no_failure() -> None:
    tried, params = fresh()
    readings = PoseReadings(np.zeros((1, 3)), np.eye(3)[None], *(np.full((0, 3), np.nan) for _ in range(3)))
    after, done = pose_hypotheses.advanced(tried, pulses(), (1.0, 1.1), readings, params)
    expected = tried.likelihood + done.likelihood
    np.testing.assert_allclose(after.likelihood, expected - expected[0], rtol=1e-12)
    assert np.unique(done.likelihood).size > JETS


# ------------------------------------------------------------------------------------------ flights


class Said:
    """What is named in a flight, with times, and the hypotheses at its end."""

    def __init__(self, vehicle: Vehicle, truth: Truth, rows: int = 200, commands: Array | None = None):
        self.params = params_of(vehicle)
        commands = told(vehicle, rows) if commands is None else commands
        read = planar_poses(vehicle, commands, truth)
        period = vehicle.sample_period_s
        nothing = np.full((0, 3), np.nan)
        given = Commands(period * np.arange(rows), commands)
        self.named: list[tuple[float, tuple[int, ...], PoseOutcome]] = []
        self.tried: Tried | None = None
        for row in range(rows):
            now = period * row
            turn = Rotation.from_euler("z", read[row, 2]).as_matrix()
            seen = PoseReadings(np.append(read[row, :2], 0.0)[None], turn[None], nothing, nothing, nothing)
            if self.tried is None:
                self.tried = pose_hypotheses.begun(pose_start.begun(seen, self.params), now, self.params)
                continue
            since = max(row - 10, 0)
            lately = Commands(given.time_s[since : row + 1], given.levels[since : row + 1])
            self.tried, _ = pose_hypotheses.advanced(self.tried, lately, (now - period, now), seen, self.params)
            self.tried, found = pose_hypotheses.judged(self.tried, now, RULES, self.params)
            if found is not None:
                self.named.append((now, found.members, found))


def _healthy() -> Array:
    return 1.0 + 0.04 * np.random.default_rng(21).standard_normal(8)


def test_none_is_named_in_a_healthy_flight() -> None:
    assert Said(bearing(), Truth(_healthy())).named == []


def test_a_jet_that_was_weak_before_the_record_began_is_named_with_its_loss() -> None:
    factors = _healthy()
    factors[4] = 0.25
    said = Said(bearing(), Truth(factors))
    assert [members for _, members, _ in said.named] == [(4,)]
    share, deviation = said.named[0][2].share
    assert abs(share - 0.75) < 3.0 * deviation
    assert said.named[0][0] < 10.0


def test_a_jet_that_comes_to_stand_open_is_named() -> None:
    said = Said(bearing(), Truth(_healthy(), open=(2, 0.6, 3.0)))
    assert [members for _, members, _ in said.named] == [(8 + 2,)]
    assert said.tried is not None
    assert float(said.tried.bank.mean[0, said.params.parts.open.start]) == pytest.approx(0.6, abs=0.1)


def test_a_push_is_no_jets() -> None:
    """Along x in the fixed frame, as strong as a jet, while the vehicle turns."""
    said = Said(bearing(), Truth(_healthy(), push=(0.02, 3.0)))
    assert said.named
    assert {members for _, members, _ in said.named} == {(16,)}


def test_two_jets_that_nothing_tells_apart_are_a_group() -> None:
    """Side by side, of the same strength, and always told to fire together."""
    vehicle = bearing()
    jets = list(vehicle.jets)
    jets[1] = jets[0].model_copy(update={"designation": "T2", "number": 2, "cluster": 2})
    vehicle = again(vehicle, jets=tuple(jets))
    commands = told(vehicle, 300)
    commands[:, 1] = commands[:, 0] = np.maximum(commands[:, 0], commands[:, 1])
    factors = _healthy()
    factors[1] = 0.0
    said = Said(vehicle, Truth(factors), 300, commands)
    assert said.named
    assert {frozenset(members) for _, members, _ in said.named} == {frozenset((0, 1))}
