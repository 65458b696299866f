"""A cycle: the mixture's likelihood and moments by quadrature in one dimension, kicks, poor readings, an odd K."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import Sensors, nothing_read, pulses, small_params, some_bank
from scipy.stats import norm

from massprop_drake.maths.estimation.pose.pose_cycle import PoseCycled, merged, step
from massprop_drake.maths.estimation.pose.pose_layout import Commands, PoseBank, PoseParams, Poses
from massprop_drake.maths.estimation.pose.pose_measurement import compared
from massprop_drake.maths.estimation.pose.pose_prediction import predicted
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

SPAN = (1.0, 1.1)
PRIOR, NOISE, KICK = 0.02, 0.01, 0.15  # 1-sigma of the position, of its reading, and of a kick at the interval's end
CHANCE, POOR = 0.2, 0.1
NOTHING = Commands(np.zeros(0), np.zeros((0, 4)))


def one_dimension(**more: Any) -> tuple[PoseBank, PoseParams]:
    """A vehicle of which x alone is not known, with kicks and poor readings."""
    whole = small_params()
    place = whole.parts.position.start
    settings: dict[str, Any] = {
        "free": np.array([place]),
        "covariance": np.array([[PRIOR**2]]),
        "kicks_per_s": -np.log(1.0 - CHANCE) / 0.1,
        "kick_velocity": KICK * np.sqrt(3.0) / 0.1,  # at any time in the interval it moves it so far
        "pose": Poses(np.array([NOISE**2]), np.array([1e-6]), np.zeros(1), POOR, 5.0),
    }
    params = small_params(**(settings | more))
    bank = PoseBank(
        params.start[None],
        params.covariance[None],
        np.eye(3)[None],
        np.array([-1]),
        np.zeros((1, 3)),
        np.zeros((1, 3, 3)),
    )
    return bank, params


def cycled(read: float, **more: Any) -> PoseCycled:
    bank, params = one_dimension(**more)
    readings = nothing_read(params)
    readings.positions[0, 0] = read
    return step(bank, NOTHING, SPAN, readings, params)


def ways() -> tuple[tuple[float, float, float], ...]:
    """Probability of what may happen, 1-sigma of x before the reading, and of the reading."""
    return (
        (1.0 - CHANCE - POOR, PRIOR, NOISE),
        (CHANCE, np.hypot(PRIOR, KICK), NOISE),
        (POOR, PRIOR, 5.0 * NOISE),
    )


@pytest.mark.parametrize("read", [0.0, 0.12, 0.4])
def test_the_estimate_has_the_moments_of_the_posterior(read: float) -> None:
    x = np.linspace(-1.5, 1.5, 60_001)
    posterior = sum(chance * norm.pdf(x, scale=before) * norm.pdf(read, x, noise) for chance, before, noise in ways())
    posterior = posterior / np.trapezoid(posterior, x)
    mean = np.trapezoid(x * posterior, x)
    variance = np.trapezoid((x - mean) ** 2 * posterior, x)
    found = cycled(read)
    likely = sum(chance * norm.pdf(read, scale=np.hypot(before, noise)) for chance, before, noise in ways())
    assert float(found.likelihood[0]) == pytest.approx(np.log(likely), rel=1e-12)
    _, params = one_dimension()
    whole = found.bank
    if found.doubt is not None:  # what would be after a kick is kept apart for a sample
        whole = merged(found.bank, found.doubt.bank, found.doubt.share, params)
    assert float(whole.mean[0, params.parts.position.start]) == pytest.approx(mean, abs=1e-8)
    assert float(whole.covariance[0, 0, 0]) == pytest.approx(variance, rel=1e-6)
    kicked = CHANCE * norm.pdf(read, scale=np.hypot(np.hypot(PRIOR, KICK), NOISE)) / np.exp(found.likelihood[0])
    assert float(found.kicked[0]) == pytest.approx(kicked, rel=1e-9)
    assert float(found.nis[0]) == pytest.approx(read**2 / (PRIOR**2 + NOISE**2), rel=1e-9)


def test_a_reading_that_cannot_be_told_from_a_poor_one_counts_as_poor_but_is_as_likely_as_it_is() -> None:
    wide = {"covariance": np.array([[0.2**2]]), "kicks_per_s": 0.0, "kick_velocity": 0.0}
    for read in (0.0, 0.3):
        found = cycled(read, **wide)
        hand = sum(
            chance * norm.pdf(read, scale=np.hypot(0.2, noise)) for chance, noise in ((0.9, NOISE), (0.1, 5 * NOISE))
        )
        assert float(found.likelihood[0]) == pytest.approx(np.log(hand), rel=1e-12)
        assert float(found.bank.covariance[0, 0, 0]) == pytest.approx(1.0 / (0.2**-2 + (5.0 * NOISE) ** -2), rel=1e-9)


def test_without_kicks_and_poor_readings_it_is_a_kalman_filter() -> None:
    plain = Poses(np.array([NOISE**2]), np.array([1e-6]), np.zeros(1))
    found = cycled(0.05, kicks_per_s=0.0, pose=plain)
    gain = PRIOR**2 / (PRIOR**2 + NOISE**2)
    _, params = one_dimension()
    assert float(found.bank.mean[0, params.parts.position.start]) == pytest.approx(gain * 0.05, rel=1e-12)
    assert float(found.bank.covariance[0, 0, 0]) == pytest.approx((1.0 - gain) * PRIOR**2, rel=1e-12)
    np.testing.assert_array_equal(found.kicked, 0.0)


def test_a_k_that_is_no_bodys_is_only_considered() -> None:
    """Of two filters one, with a large variance of K, is told by its rate that K would be negative.

    By hand, Schmidt: rows of K get no gain, and keep their covariance.
    """
    params = small_params(Sensors(poses=1, gyros=1))
    parts, bank = params.parts, some_bank(params, opens=(-1, -1))
    covariance = 1e-8 * np.repeat(np.eye(params.free.size)[None], 2, 0)
    covariance[0][parts.spin, parts.spin] = (0.5 * params.start[parts.spin][:3].mean()) ** 2 * np.eye(6)
    bank, scaled = bank._replace(covariance=covariance), bank.mean.copy()
    scaled[:, parts.spin] *= -4.0
    ahead = predicted(bank, pulses(), *SPAN, params).bank
    moved = predicted(bank._replace(mean=scaled), pulses(), *SPAN, params).bank
    for share, learns in ((1.0, False), (0.05, True)):
        readings, expected = nothing_read(params), ahead.mean + share * (moved.mean - ahead.mean)
        readings.rates[0] = expected[0, parts.rate] + expected[0, parts.gyro_bias]
        found = step(bank, pulses(), SPAN, readings, params).bank
        changes = np.abs(found.mean - ahead.mean)
        assert (changes[0, parts.spin] > 0.0).any() == learns
        assert changes[1, parts.spin].max() > 0.0  # the other filter learns
        if not learns:
            assert changes[0, parts.rate].max() > 1e-3  # and so does the rest
            by = compared(ahead, readings, params)
            assert by is not None
            before, rows = ahead.covariance[0], by.jacobian[0]
            gain = before @ rows.T @ np.linalg.inv(rows @ before @ rows.T + by.variance[0])
            gain[parts.spin] = 0.0
            left = np.eye(before.shape[0]) - gain @ rows
            hand = left @ before @ left.T + gain @ by.variance[0] @ gain.T
            np.testing.assert_allclose(found.covariance[0], hand, rtol=1e-9, atol=1e-12 * np.abs(hand).max())


def test_a_covariance_that_is_none_says_so_with_its_time() -> None:
    params = small_params()
    bank = some_bank(params)
    readings = nothing_read(params)
    readings.positions[0] = 0.0
    broken = bank._replace(covariance=-np.repeat(np.eye(params.free.size)[None], 2, 0))
    with pytest.raises(NotPositiveDefiniteError, match="the pose estimator's covariance") as caught:
        step(broken, pulses(), SPAN, readings, params)
    assert "1.1" in str(caught.value)
