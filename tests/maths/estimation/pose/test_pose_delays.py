"""Parts of what is possible of a delay: the mixture by hand, what is known of all, and a flight that is late."""

from __future__ import annotations

import numpy as np
import pytest
from pose_probe import JETS, Truth, again, bearing, flown, small_params, some_bank

from massprop_drake.maths.estimation.pose import delays, pose_hypotheses
from massprop_drake.maths.estimation.pose.delays import FAR, parts_of
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Delays, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

PERIOD = 0.1


def test_parts_sum_to_a_wide_delay_and_to_a_flat_rest_of_a_narrow_one() -> None:
    wide, narrow = (
        parts_of(np.array([0.6]), np.array([0.08]), PERIOD),
        parts_of(np.array([0.6]), np.array([0.01]), PERIOD),
    )

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
    soon = parts_of(np.array([0.06, 0.3]), np.array([0.08, 0.01]), PERIOD)
    np.testing.assert_allclose(np.sort(soon.shifts_s), PERIOD * np.arange(-1, 6))  # none before what is commanded
    np.testing.assert_array_equal(soon.stds_s, [[0.08, 0.01], [0.08, 0.05]])


def parts() -> tuple[list[Tried], PoseParams]:
    """Hypotheses for a delay as stated and for one a sample longer."""
    made = Delays(np.array([0.0, 0.1]), np.log([0.9, 0.1]), np.full((2, 2), 0.02), 0.05)
    params = small_params(delays=made)
    bank = some_bank(params, opens=(-1,))
    return [pose_hypotheses.begun(one, 0.0, params) for one in delays.split(bank, params)], params


def test_what_is_known_of_several_delays_is_that_of_all_by_moments() -> None:
    two, params = parts()
    at = params.parts.delay.start
    np.testing.assert_allclose((two[1].bank.mean - two[0].bank.mean)[:, at : at + 2], 0.1)
    alone = [one._replace(likelihood=np.append(0.0, np.full(1 + 2 * JETS, -np.inf))) for one in two]
    both = alone[0]._replace(elsewhere=(alone[1]._replace(total=-np.log(3.0)),))
    found = delays.overall(both, params)
    assert found.mean[0, at] == pytest.approx(two[0].bank.mean[0, at] + 0.025)
    place = int(np.flatnonzero(params.free == at)[0])
    assert found.covariance[0, place, place] == pytest.approx(0.02**2 + 0.25 * 0.75 * 0.1**2)


def test_nothing_is_named_while_another_delay_is_as_likely() -> None:
    two, params = parts()
    likelihood = np.full(2 + 2 * JETS, -50.0)
    likelihood[0], likelihood[2] = 0.0, 40.0
    bank = two[0].bank  # of which jet 1 is known to be weak
    sure = two[0]._replace(likelihood=likelihood, bank=bank._replace(covariance=1e-4 * bank.covariance))
    near = sure._replace(elsewhere=(sure._replace(total=-1.0),))
    for samples, tried in ((30, near), (pose_hypotheses.STEADY, sure)):
        found = None
        for index in range(samples):
            tried, found = delays.judged(tried, 0.01 * (1.0 + index), PoseRules(), params)  # noqa: PLW2901 (it goes on)
        assert (found is None) == (samples == 30)
    assert tried.elsewhere == ()


def test_a_part_that_runs_off_is_left_out_and_the_last_one_says_so() -> None:
    two, params = parts()
    broken = two[0].bank.covariance.copy()
    broken[0] = -np.eye(broken.shape[1])
    bad = two[0]._replace(bank=two[0].bank._replace(covariance=broken))
    commands = Commands(np.zeros(0), np.zeros((0, JETS)))
    pose = PoseReadings(np.zeros((1, 3)), np.eye(3)[None], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    after, _ = delays.advanced(bad._replace(elsewhere=(two[1],)), commands, (0.0, 0.1), pose, params)
    assert after.elsewhere == ()
    assert np.isfinite(after.bank.mean).all()
    with pytest.raises(NotPositiveDefiniteError):
        delays.advanced(bad, commands, (0.0, 0.1), pose, params)


@pytest.mark.parametrize(("stated_s", "late"), [(0.01, 3), (0.0, 3), (0.0, 0)])
def test_a_delay_that_is_far_off_is_found_and_an_exact_one_stays_so(stated_s: float, late: int) -> None:
    """Of commands that act so many samples later than the file says."""
    kind = bearing().jet_kinds["nozzle"].model_copy(update={"command_delay_std_s": stated_s})
    vehicle = again(bearing(), jet_kinds={"nozzle": kind})
    found = flown(vehicle, Truth(np.ones(len(vehicle.jets))), late=late, parts=True)
    tried, params = found.tried, found.params
    place = int(np.flatnonzero(params.free == params.parts.delay.start)[0])
    sigma = np.sqrt(tried.bank.covariance[0, place, place])
    off = tried.bank.mean[0, params.parts.delay.start] - late * vehicle.sample_period_s
    if late == 0:
        assert delays.settled(tried, 6.0)
        assert off == sigma == 0.0
    else:
        assert tried.elsewhere == ()
        assert sigma < 0.01
        assert abs(off) < 3.0 * sigma + 0.001
