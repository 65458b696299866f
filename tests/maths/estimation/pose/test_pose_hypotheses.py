"""Hypotheses about jets and delays: rules on likelihoods made up, moments by hand, saved state, and flights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, Truth, bearing, flown, small_params, some_bank

from massprop_drake.maths.estimation.pose import delays, keeping, pose_hypotheses
from massprop_drake.maths.estimation.pose.delays import FAR, divide_delays
from massprop_drake.maths.estimation.pose.pose_cycle import Doubt
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseOutcome, PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Delays, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

RULES = PoseRules()
PUSH = 2 * JETS
PERIOD = 0.1


def fresh(**changed: Any) -> tuple[Tried, PoseParams]:
    params = small_params(**changed)
    bank = some_bank(params, opens=(-1,))
    bank.mean[0, params.parts.open] = 0.0
    return pose_hypotheses.begin_hypotheses(bank, 0.0, params), params


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
        tried, said = pose_hypotheses.name_failure(tried._replace(renewed_s=now), now, RULES, params)
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


@pytest.mark.parametrize(("factor", "std"), [(0.95, 0.001), (0.7, 0.15)], ids=["below a tenth", "below 3 sigma"])
def test_odds_alone_name_no_jet_that_lost_little(factor: float, std: float) -> None:
    tried, params = fresh()
    _, found = judged_often(with_odds(_weak(tried, 1, factor, std), (1, 300.0)), params, 20)
    assert found == [None] * 20


def test_what_nothing_tells_apart_is_a_group_after_patience_and_nothing_is_taken() -> None:
    tried, params = fresh()
    tried = with_odds(_weak(_weak(tried, 1), 3), (1, 20.0), (3, 17.0), (0, 13.0))
    count = round(pose_hypotheses.PATIENCE_S / PERIOD) + pose_hypotheses.STEADY
    tried, found = judged_often(tried, params, count, first_s=0.0)
    first = next(index for index, said in enumerate(found) if said is not None)
    assert first * PERIOD == pytest.approx(pose_hypotheses.PATIENCE_S + (pose_hypotheses.STEADY - 1) * PERIOD, abs=1e-9)
    said = found[first]
    assert said is not None
    assert said.members == (1, 3)  # the third is 7 nats behind
    assert said.lead[0] == pytest.approx(7.0)
    np.testing.assert_array_equal(tried.known, 0.0)


def test_a_jet_is_named_once_it_has_led_for_ten_samples_and_all_begin_anew_from_it() -> None:
    tried, params = fresh()
    weak = _weak(tried, 1)
    taken, found = judged_often(with_odds(weak, (1, 20.0)), params, pose_hypotheses.STEADY)
    assert found[:-1] == [None] * (pose_hypotheses.STEADY - 1)
    said = found[-1]
    assert said is not None
    assert (said.members, said.onset_s) == ((1,), 0.0)
    assert said.lead == pytest.approx((70.0, 20.0))
    assert said.share[0] == pytest.approx(0.9, abs=1e-6)
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


HEALTHY = 1.0 + 0.04 * np.random.default_rng(21).standard_normal(8)


@pytest.mark.parametrize(
    ("truth", "member", "size"),
    [
        (Truth(HEALTHY), None, None),
        (Truth(np.where(np.arange(8) == 4, 0.25, HEALTHY)), 4, 0.75),
        (Truth(HEALTHY, open=(2, 0.6, 3.0)), 8 + 2, 0.6),
        (Truth(HEALTHY, push=(0.02, 3.0)), 16, None),
    ],
    ids=["healthy", "weak from the beginning", "stands open", "pushed while it turns"],
)
def test_what_fails_in_a_flight_is_named_and_nothing_else(truth: Truth, member: int | None, size: float | None) -> None:
    found = flown(bearing(), truth)
    assert [one.members for _, one in found.named] == ([] if member is None else [(member,)])
    for time_s, one in found.named if size is not None else ():
        assert abs(one.share[0] - size) < 3.0 * one.share[1]
        assert time_s < 10.0
    if member == 8 + 2:
        assert float(found.tried.bank.mean[0, found.params.parts.open.start]) == pytest.approx(0.6, abs=0.1)


def _some() -> tuple[Tried, Commands, PoseParams]:
    params = small_params()
    bank = some_bank(params, opens=(-1,))
    bank = bank._replace(covariance=0.5 * (bank.covariance + np.swapaxes(bank.covariance, 1, 2)))
    first = pose_hypotheses.begin_hypotheses(bank, 1.0, params)
    likelihood = first.likelihood.copy()
    likelihood[3] = -np.inf
    count = likelihood.size
    first = first._replace(likelihood=likelihood, led_s=2.5, leader=4, steady=3, total=-12.5)
    first = first._replace(apart=np.arange(float(count**2)).reshape(count, count))
    second = first._replace(doubt=Doubt(first.bank, np.linspace(0.0, 1.0, count)), apart=None, total=-20.0)
    third = pose_hypotheses.make_single_filter(bank, np.zeros(1 + 2 * JETS), 1.0)
    levels = np.array([[0.0, 1.0, np.nan, 0.5], [1.0, 0.0, 0.0, 0.0]])
    return first._replace(elsewhere=(second, third)), Commands(np.array([0.7, 0.9]), levels), params


def _same(one: Any, other: Any) -> None:
    if not isinstance(one, tuple):
        np.testing.assert_array_equal(one, other)
        return
    for own, its in zip(one, other, strict=True):
        _same(own, its)


def test_all_of_it_comes_back_to_the_bit() -> None:
    tried, commands, params = _some()
    _same((tried, commands), keeping.unpack_hypotheses(keeping.pack_hypotheses(tried, commands), params))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda vector: vector[:-1], "hypotheses are cut short"),
        (lambda vector: np.append(-1.0, vector[1:]), "hypotheses must be counted by whole numbers"),
        (lambda vector: np.concatenate((vector[:1], [0.0], vector[2:12])), "hypotheses are of another number"),
        (lambda vector: np.concatenate((vector[:2], [0.9, 0.7], vector[4:])), "commands must be in order of time"),
        (lambda vector: np.concatenate((vector[:4], [1.5], vector[5:])), "commands must be fractions of 0 to 1"),
        (lambda vector: np.concatenate((vector[:12], [7.0], vector[13:])), "hypotheses are of another number of jets"),
        (lambda vector: np.concatenate((vector[:13], [np.nan], vector[14:])), "hypotheses must be numbers"),
    ],
)
def test_what_no_run_leaves_is_refused(change: Any, message: str) -> None:
    tried, commands, params = _some()
    with pytest.raises(ValueError, match=message):
        keeping.unpack_hypotheses(change(keeping.pack_hypotheses(tried, commands)), params)


def test_parts_sum_to_a_wide_delay_and_to_a_flat_rest_of_a_narrow_one() -> None:
    wide, narrow = (divide_delays(np.array([0.6]), np.array([std_s]), PERIOD) for std_s in (0.08, 0.01))

    def density(made: Delays, where_s: np.ndarray) -> np.ndarray:
        stds = np.where(made.shifts_s == 0.0, made.stds_s[0, 0], made.stds_s[1, 0])
        each = np.exp(-0.5 * ((where_s[:, None] - made.shifts_s) / stds) ** 2) / (stds * np.sqrt(2.0 * np.pi))
        return np.asarray(each @ np.exp(made.chances))

    where = np.linspace(-0.16, 0.16, 65)
    stated = np.exp(-0.5 * (where / 0.08) ** 2) / (0.08 * np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(density(wide, where), stated, atol=0.1 * stated.max())
    np.testing.assert_array_equal(narrow.stds_s, [[0.01], [0.05]])
    assert np.exp(narrow.chances[0]) == pytest.approx(1.0 - FAR * 10 / 11)
    far = density(narrow, np.linspace(0.2, 0.4, 41))
    assert far.max() < 1.3 * far.min()
    assert far.mean() == pytest.approx(FAR / 11 / PERIOD, rel=0.02)
    soon = divide_delays(np.array([0.06, 0.3]), np.array([0.08, 0.01]), PERIOD)
    np.testing.assert_allclose(np.sort(soon.shifts_s), PERIOD * np.arange(-1, 6))  # none before what is commanded
    np.testing.assert_array_equal(soon.stds_s, [[0.08, 0.01], [0.08, 0.05]])


def parts() -> tuple[list[Tried], PoseParams]:
    """Hypotheses for a delay as stated and for one a sample longer."""
    made = Delays(np.array([0.0, 0.1]), np.log([0.9, 0.1]), np.full((2, 2), 0.02), 0.05)
    params = small_params(delays=made)
    bank = some_bank(params, opens=(-1,))
    return [pose_hypotheses.begin_hypotheses(one, 0.0, params) for one in delays.split_by_delay(bank, params)], params


def test_what_is_known_of_several_delays_is_that_of_all_by_moments() -> None:
    two, params = parts()
    at = params.parts.delay.start
    np.testing.assert_allclose((two[1].bank.mean - two[0].bank.mean)[:, at : at + 2], 0.1)
    alone = [one._replace(likelihood=np.append(0.0, np.full(1 + 2 * JETS, -np.inf))) for one in two]
    both = alone[0]._replace(elsewhere=(alone[1]._replace(total=-np.log(3.0)),))
    found = delays.merge_delays(both, params)
    assert found.mean[0, at] == pytest.approx(two[0].bank.mean[0, at] + 0.025)
    place = int(np.flatnonzero(params.free == at)[0])
    assert found.covariance[0, place, place] == pytest.approx(0.02**2 + 0.25 * 0.75 * 0.1**2)


def test_nothing_is_named_while_another_delay_is_as_likely() -> None:
    two, params = parts()
    bank = two[0].bank  # of which jet 1 is known to be weak
    sure = with_odds(two[0]._replace(bank=bank._replace(covariance=1e-4 * bank.covariance)), (1, 40.0))
    near = sure._replace(elsewhere=(sure._replace(total=-1.0),))
    for samples, tried in ((30, near), (pose_hypotheses.STEADY, sure)):
        found = None
        for index in range(samples):
            tried, found = delays.name_failure_over_delays(tried, 0.01 * (1.0 + index), PoseRules(), params)  # noqa: PLW2901 (it goes on)
        assert (found is None) == (samples == 30)
    assert tried.elsewhere == ()


def test_a_part_that_runs_off_is_left_out_and_the_last_one_says_so() -> None:
    two, params = parts()
    broken = two[0].bank.covariance.copy()
    broken[0] = -np.eye(broken.shape[1])
    bad = two[0]._replace(bank=two[0].bank._replace(covariance=broken))
    commands = Commands(np.zeros(0), np.zeros((0, JETS)))
    pose = PoseReadings(np.zeros((1, 3)), np.eye(3)[None], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    after, _ = delays.advance_over_delays(bad._replace(elsewhere=(two[1],)), commands, (0.0, 0.1), pose, params)
    assert after.elsewhere == ()
    assert np.isfinite(after.bank.mean).all()
    with pytest.raises(NotPositiveDefiniteError):
        delays.advance_over_delays(bad, commands, (0.0, 0.1), pose, params)


@pytest.mark.parametrize(("late", "rows"), [(3, 90), (0, 40)])
def test_an_exact_delay_that_is_far_off_is_found_and_a_right_one_stays_so(late: int, rows: int) -> None:
    """Telemetry of commands that act so many samples later than the file says."""
    vehicle = bearing()
    found = flown(vehicle, Truth(np.ones(len(vehicle.jets))), rows=rows, late=late, parts=True)
    tried, params = found.tried, found.params
    place = int(np.flatnonzero(params.free == params.parts.delay.start)[0])
    sigma = np.sqrt(tried.bank.covariance[0, place, place])
    off = tried.bank.mean[0, params.parts.delay.start] - late * vehicle.sample_period_s
    if late == 0:
        assert delays.is_delay_settled(tried, 6.0)
        assert off == sigma == 0.0
    else:
        assert tried.elsewhere == ()
        assert sigma < 0.01
        assert abs(off) < 3.0 * sigma + 0.001
