"""Parts of what is possible of a delay: the mixture by hand, parts that are given up or become one, and a flight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, Truth, bearing, params_of, planar_poses, pose_columns, small_params, some_bank, told

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.estimation.pose import delays, pose_hypotheses, pose_start
from massprop_drake.maths.estimation.pose.delays import FAR, parts_of
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Delays, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

PERIOD = 0.1


def _density(made: Delays, where_s: Array) -> Array:
    """Of the sum of parts."""
    stds = np.where(made.shifts_s == 0.0, made.stds_s[0, 0], made.stds_s[1, 0])
    each = np.exp(-0.5 * ((where_s[:, None] - made.shifts_s) / stds) ** 2) / (stds * np.sqrt(2.0 * np.pi))
    return np.asarray(each @ np.exp(made.chances))


# ------------------------------------------------------------------------------------------- parts


def test_a_wide_stated_delay_is_the_sum_of_its_parts() -> None:
    made = parts_of(np.array([0.6]), np.array([0.08]), PERIOD)
    assert made.shifts_s[0] == 0.0
    np.testing.assert_allclose(np.exp(made.chances).sum(), 1.0)
    where = np.linspace(-0.16, 0.16, 65)
    stated = np.exp(-0.5 * (where / 0.08) ** 2) / (0.08 * np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(_density(made, where), stated, atol=0.1 * stated.max())


def test_a_narrow_stated_delay_stays_what_it_is_and_the_rest_is_nearly_flat() -> None:
    made = parts_of(np.array([0.6]), np.array([0.01]), PERIOD)
    np.testing.assert_array_equal(made.stds_s, [[0.01], [0.05]])
    assert np.exp(made.chances[0]) == pytest.approx(1.0 - FAR * 10 / 11)
    far = _density(made, np.linspace(0.2, 0.4, 41))
    assert far.max() < 1.3 * far.min()
    assert far.mean() == pytest.approx(FAR / 11 / PERIOD, rel=0.02)


def test_no_part_is_before_what_has_been_commanded() -> None:
    made = parts_of(np.array([0.06]), np.array([0.02]), PERIOD)
    np.testing.assert_allclose(np.sort(made.shifts_s), PERIOD * np.arange(-1, 6))


@pytest.mark.parametrize("kinds", [1, 2])
def test_a_delay_that_is_stated_as_exact_is_so_but_for_a_file_that_is_not_right(kinds: int) -> None:
    made = parts_of(np.full(kinds, 0.6), np.zeros(kinds), PERIOD)
    assert made.shifts_s[0] == 0.0
    assert np.exp(made.chances[0]) == pytest.approx(1.0 - FAR * 10 / 11)
    np.testing.assert_array_equal(made.stds_s, [np.zeros(kinds), np.full(kinds, 0.05)])


def test_several_kinds_keep_their_own() -> None:
    made = parts_of(np.array([0.06, 0.3, 0.1]), np.array([0.08, 0.01, 0.0]), PERIOD)
    np.testing.assert_array_equal(made.stds_s, [[0.08, 0.01, 0.0], [0.08, 0.05, 0.05]])


# --------------------------------------------------------------------------------------- made up ones


def _parts(shifts: tuple[float, ...] = (0.0, 0.1), std: float = 0.05, **changed: Any) -> tuple[list[Tried], PoseParams]:
    count = len(shifts)
    chances = np.log(np.append(0.9, np.full(count - 1, 0.1 / max(count - 1, 1))))
    made = Delays(np.array(shifts), chances, np.full((2, 2), std), 0.05)
    params = small_params(delays=made, **changed)
    bank = some_bank(params, opens=(-1,))
    return [pose_hypotheses.begun(one, 0.0, params) for one in delays.split(bank, params)], params


def test_a_split_shifts_the_delay_of_every_kind_and_nothing_else() -> None:
    parts, params = _parts()
    first, second = (one.bank for one in parts)
    moved = second.mean - first.mean
    np.testing.assert_allclose(moved[:, params.parts.delay], 0.1)
    moved[:, params.parts.delay] = 0.0
    assert not moved.any()
    places = np.flatnonzero(np.isin(params.free, np.arange(params.parts.delay.start, params.parts.delay.stop)))
    np.testing.assert_allclose(first.covariance[0][places, places], 0.05**2)


def test_the_likeliest_is_first_and_one_far_behind_is_given_up() -> None:
    parts, params = _parts((0.0, 0.1, 0.2))
    parts = [one._replace(total=total) for one, total in zip(parts, (0.0, 3.0, -13.0), strict=True)]
    ordered = delays._ordered(parts)
    assert ordered.bank is parts[1].bank
    assert [one.bank for one in ordered.elsewhere] == [parts[0].bank]
    assert delays.settled(ordered, 2.9)
    assert not delays.settled(ordered, 3.1)
    assert delays.gathered(parts, params).bank is parts[0].bank


def test_two_that_one_filter_can_hold_become_one_by_moments() -> None:
    parts, params = _parts((0.0, 0.04), std=0.02)
    one, other = (part._replace(total=total) for part, total in zip(parts, (0.0, -1.0), strict=True))
    (both,) = delays._merged([one, other], params)
    share = 1.0 / (1.0 + np.e)
    at = params.parts.delay.start
    place = int(np.flatnonzero(params.free == at)[0])
    assert both.bank.mean[0, at] == pytest.approx(one.bank.mean[0, at] + share * 0.04)
    variance = 0.02**2 + share * (1.0 - share) * 0.04**2
    assert both.bank.covariance[0, place, place] == pytest.approx(variance)
    np.testing.assert_allclose(both.likelihood, one.likelihood, atol=1e-12)
    assert delays.weight(both) == pytest.approx(np.logaddexp(delays.weight(one), delays.weight(other)))


def test_two_that_are_far_apart_or_in_doubt_stay_two() -> None:
    parts, params = _parts((0.0, 0.1), std=0.02)
    assert len(delays._merged(parts, params)) == 2
    parts, params = _parts((0.0, 0.04), std=0.02)
    doubtful = parts[0]._replace(doubt=pose_hypotheses.Doubt(parts[0].bank, np.zeros(2 + 2 * JETS)))
    assert len(delays._merged([doubtful, parts[1]], params)) == 2
    known = parts[0].known.copy()
    known[0] = 1.0
    assert len(delays._merged([parts[0]._replace(known=known), parts[1]], params)) == 2


def test_nothing_is_named_while_another_delay_is_as_likely() -> None:
    parts, params = _parts((0.0, 0.1))
    likelihood = np.full(2 + 2 * JETS, -50.0)
    likelihood[0], likelihood[2] = 0.0, 40.0
    bank = parts[0].bank  # of which jet 1 is known to be weak
    sure = parts[0]._replace(likelihood=likelihood, bank=bank._replace(covariance=1e-4 * bank.covariance))
    near = sure._replace(elsewhere=(sure._replace(total=-1.0),))
    for samples, open_one in ((30, near), (pose_hypotheses.STEADY, sure)):
        tried, found = open_one, None
        for index in range(samples):
            now = 0.01 * (1.0 + index)
            tried, found = delays.judged(tried, now, PoseRules(), params)
        assert (found is None) == (open_one is near)
    assert tried.elsewhere == ()


def test_a_part_that_runs_off_is_left_out_and_the_last_one_says_so() -> None:
    parts, params = _parts((0.0, 0.1))
    broken = parts[0].bank.covariance.copy()
    broken[0] = -np.eye(broken.shape[1])
    bad = parts[0]._replace(bank=parts[0].bank._replace(covariance=broken))
    commands = Commands(np.zeros(0), np.zeros((0, JETS)))
    pose = PoseReadings(np.zeros((1, 3)), np.eye(3)[None], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    after, _ = delays.advanced(bad._replace(elsewhere=(parts[1],)), commands, (0.0, 0.1), pose, params)
    assert after.elsewhere == ()
    assert np.isfinite(after.bank.mean).all()
    with pytest.raises(NotPositiveDefiniteError):
        delays.advanced(bad, commands, (0.0, 0.1), pose, params)


# ------------------------------------------------------------------------------------------ a flight


def _followed(vehicle: Vehicle, late: int, rows: int = 200) -> tuple[Tried, PoseParams]:
    """What is known after a flight whose commands act so many samples later than the file says."""
    commands = told(vehicle, rows)
    acting = np.vstack((np.zeros((late, len(vehicle.jets))), commands[: rows - late]))
    read = pose_columns(planar_poses(vehicle, acting, Truth(np.ones(len(vehicle.jets)))))
    params, period = params_of(vehicle), vehicle.sample_period_s
    kept = Commands(period * np.arange(rows), commands)
    none = np.zeros((0, 3))
    readings = [PoseReadings(row[None, :3], rotation_matrix(row[3:])[None], none, none, none) for row in read]
    first = pose_start.begun(readings[0], params)
    tried = delays.gathered(
        [pose_hypotheses.alone(one, np.zeros(17), 0.0) for one in delays.split(first, params)], params
    )
    for row in range(1, rows):
        span_s = (period * (row - 1), period * row)
        begin = max(row - 40, 0)
        recent = Commands(kept.time_s[begin : row + 1], kept.levels[begin : row + 1])
        tried, _ = delays.advanced(tried, recent, span_s, readings[row], params)
    return tried, params


@pytest.mark.parametrize("stated_s", [0.01, 0.0])
def test_a_delay_that_is_far_off_is_found_within_its_sigma(stated_s: float) -> None:
    vehicle = bearing()
    update = {"command_delay_s": 0.0, "command_delay_std_s": stated_s}
    kind = vehicle.jet_kinds["nozzle"].model_copy(update=update)
    vehicle = vehicle.model_copy(update={"jet_kinds": {"nozzle": kind}})
    tried, params = _followed(vehicle, 3)
    assert tried.elsewhere == ()
    place = int(np.flatnonzero(params.free == params.parts.delay.start)[0])
    sigma = np.sqrt(tried.bank.covariance[0, place, place])
    assert sigma < 0.01
    assert abs(tried.bank.mean[0, params.parts.delay.start] - 3 * vehicle.sample_period_s) < 3.0 * sigma + 0.001


def test_a_delay_that_is_exact_stays_so() -> None:
    tried, params = _followed(bearing(), 0)
    place = int(np.flatnonzero(params.free == params.parts.delay.start)[0])
    assert delays.settled(tried, 6.0)
    assert tried.bank.mean[0, params.parts.delay.start] == 0.0
    assert tried.bank.covariance[0, place, place] == 0.0


def test_one_that_is_sure_does_not_swallow_a_wide_one_that_is_less_likely() -> None:
    parts, params = _parts((0.0, 0.02), std=0.02)
    places = delays._places(params)
    covariance = parts[0].bank.covariance.copy()
    covariance[:, places, :], covariance[:, :, places] = 0.0, 0.0
    sure = parts[0]._replace(bank=parts[0].bank._replace(covariance=covariance))
    for ahead, left in ((-5.0, 2), (5.0, 1)):  # of the wide one
        assert len(delays._merged([sure._replace(total=0.0), parts[1]._replace(total=ahead)], params)) == left


def test_what_is_known_of_several_delays_is_that_of_all_by_moments() -> None:
    parts, params = _parts((0.0, 0.1), std=0.02)
    alone = [one._replace(likelihood=np.append(0.0, np.full(1 + 2 * JETS, -np.inf))) for one in parts]
    both = alone[0]._replace(elsewhere=(alone[1]._replace(total=-np.log(3.0)),))
    found, at = delays.overall(both, params), params.parts.delay.start
    assert found.mean.shape[0] == 1
    assert found.mean[0, at] == pytest.approx(parts[0].bank.mean[0, at] + 0.025)
    place = int(np.flatnonzero(params.free == at)[0])
    assert found.covariance[0, place, place] == pytest.approx(0.02**2 + 0.25 * 0.75 * 0.1**2)
