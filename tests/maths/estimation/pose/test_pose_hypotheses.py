"""Hypotheses about jets: rules on likelihoods that are made up, moments by hand, and flights of a body of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, Truth, bearing, flown, small_params, some_bank

from massprop_drake.maths.estimation.pose import pose_hypotheses
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseOutcome, PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import PoseParams

RULES = PoseRules()
PUSH = 2 * JETS
PERIOD = 0.1


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


@pytest.mark.parametrize(("factor", "std"), [(0.95, 0.001), (0.7, 0.15)], ids=["below a tenth", "below 3 sigma"])
def test_odds_alone_name_no_jet_that_lost_little(factor: float, std: float) -> None:
    tried, params = fresh()
    _, found = judged_often(with_odds(_weak(tried, 1, factor, std), (1, 300.0)), params, 20)
    assert found == [None] * 20


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


def test_jets_are_named_in_flights_and_nobody_in_a_healthy_one() -> None:
    """A jet that was weak before the record began, and one that comes to stand open."""
    healthy = 1.0 + 0.04 * np.random.default_rng(21).standard_normal(8)
    assert flown(bearing(), Truth(healthy)).named == []
    weak = flown(bearing(), Truth(np.where(np.arange(8) == 4, 0.25, healthy)))
    ((time_s, found),) = weak.named
    assert found.members == (4,)
    assert abs(found.share[0] - 0.75) < 3.0 * found.share[1]
    assert time_s < 10.0
    opens = flown(bearing(), Truth(healthy, open=(2, 0.6, 3.0)))
    assert [one.members for _, one in opens.named] == [(8 + 2,)]
    assert float(opens.tried.bank.mean[0, opens.params.parts.open.start]) == pytest.approx(0.6, abs=0.1)


def test_a_push_is_no_jets() -> None:
    """Along x in the fixed frame, as strong as a jet, while the vehicle turns."""
    healthy = 1.0 + 0.04 * np.random.default_rng(21).standard_normal(8)
    named = flown(bearing(), Truth(healthy, push=(0.02, 3.0))).named
    assert {one.members for _, one in named} == {(16,)}
