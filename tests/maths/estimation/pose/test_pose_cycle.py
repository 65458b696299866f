"""Start, update and outcome of a filter in a fixed frame: by draws, Gaussians, and quadrature in one dimension."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, MASS, SPIN, Sensors, nothing_read, pulses, small_params, some_bank
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from massprop_drake.maths.estimation.pose.outcome import estimated_properties
from massprop_drake.maths.estimation.pose.pose_cycle import PoseCycled, merge_banks, step
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Parts, PoseBank, PoseParams, Poses, make_parts
from massprop_drake.maths.estimation.pose.pose_measurement import compare_readings
from massprop_drake.maths.estimation.pose.pose_prediction import predict_bank
from massprop_drake.maths.estimation.pose.pose_start import VehiclePrior, initialize_bank, prior
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

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
    still = np.zeros((1, 3)), np.zeros((1, 3, 3))
    return PoseBank(params.start[None], params.covariance[None], np.eye(3)[None], np.array([-1]), *still), params


def cycled(read: float, **more: Any) -> tuple[PoseCycled, PoseParams]:
    bank, params = one_dimension(**more)
    readings = nothing_read(params)
    readings.positions[0, 0] = read
    return step(bank, NOTHING, SPAN, readings, params), params


# probability of what may happen, 1-sigma of x before the reading, and of the reading
WAYS = (
    (1.0 - CHANCE - POOR, PRIOR, NOISE),
    (CHANCE, np.hypot(PRIOR, KICK), NOISE),
    (POOR, PRIOR, 5.0 * NOISE),
)


@pytest.mark.parametrize("read", [0.0, 0.12, 0.4])
def test_the_estimate_has_the_moments_of_the_posterior(read: float) -> None:
    x = np.linspace(-1.5, 1.5, 60_001)
    posterior = sum(chance * norm.pdf(x, scale=before) * norm.pdf(read, x, noise) for chance, before, noise in WAYS)
    posterior = posterior / np.trapezoid(posterior, x)
    mean = np.trapezoid(x * posterior, x)
    variance = np.trapezoid((x - mean) ** 2 * posterior, x)
    found, params = cycled(read)
    likely = sum(chance * norm.pdf(read, scale=np.hypot(before, noise)) for chance, before, noise in WAYS)
    assert float(found.likelihood[0]) == pytest.approx(np.log(likely), rel=1e-12)
    whole = found.bank
    if found.doubt is not None:  # what would be after a kick is kept apart for a sample
        whole = merge_banks(found.bank, found.doubt.bank, found.doubt.share, params)
    assert float(whole.mean[0, params.parts.position.start]) == pytest.approx(mean, abs=1e-8)
    assert float(whole.covariance[0, 0, 0]) == pytest.approx(variance, rel=1e-6)
    kicked = CHANCE * norm.pdf(read, scale=np.hypot(np.hypot(PRIOR, KICK), NOISE)) / np.exp(found.likelihood[0])
    assert float(found.kicked[0]) == pytest.approx(kicked, rel=1e-9)


def test_without_kicks_and_poor_readings_it_is_a_kalman_filter() -> None:
    plain = Poses(np.array([NOISE**2]), np.array([1e-6]), np.zeros(1))
    found, params = cycled(0.05, kicks_per_s=0.0, pose=plain)
    gain = PRIOR**2 / (PRIOR**2 + NOISE**2)
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
    ahead = predict_bank(bank, pulses(), *SPAN, params).bank
    moved = predict_bank(bank._replace(mean=scaled), pulses(), *SPAN, params).bank
    for share, learns in ((1.0, False), (0.05, True)):
        readings, expected = nothing_read(params), ahead.mean + share * (moved.mean - ahead.mean)
        readings.rates[0] = expected[0, parts.rate] + expected[0, parts.gyro_bias]
        found = step(bank, pulses(), SPAN, readings, params).bank
        changes = np.abs(found.mean - ahead.mean)
        assert (changes[0, parts.spin] > 0.0).any() == learns
        assert changes[1, parts.spin].max() > 0.0  # the other filter learns
        if not learns:
            assert changes[0, parts.rate].max() > 1e-3  # and so does the rest
            by = compare_readings(ahead, readings, params)
            assert by is not None
            before, rows = ahead.covariance[0], by.jacobian[0]
            gain = before @ rows.T @ np.linalg.inv(rows @ before @ rows.T + by.variance[0])
            gain[parts.spin] = 0.0
            left = np.eye(before.shape[0]) - gain @ rows
            hand = left @ before @ left.T + gain @ by.variance[0] @ gain.T
            np.testing.assert_allclose(found.covariance[0], hand, rtol=1e-9, atol=1e-12 * np.abs(hand).max())


def test_a_covariance_that_is_none_says_so_with_its_time() -> None:
    params = small_params()
    bank, readings = some_bank(params), nothing_read(params)
    readings.positions[0] = 0.0
    broken = bank._replace(covariance=-np.repeat(np.eye(params.free.size)[None], 2, 0))
    with pytest.raises(NotPositiveDefiniteError, match=r"the pose estimator's covariance.*1[.]1"):
        step(broken, pulses(), SPAN, readings, params)


ELEMENTS = SPIN[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
THRUST_STD = np.array([0.004, 0.006, 0.005, 0.003])


def _inverse_root() -> Array:
    """Root of the covariance of J, shape (6, 6); a hundredth of it, correlated."""
    random = np.random.default_rng(9)
    return np.asarray(0.01 / MASS * ELEMENTS[:3].mean() * random.standard_normal((6, 6)) / np.sqrt(6.0))


MASS_STD, COMMON_STD = 0.01, 0.008


def known(parts: Parts) -> VehiclePrior:
    root, rest = MASS * _inverse_root(), (np.full(parts.size, 0.25), np.full(parts.size, 0.1))
    return VehiclePrior(ELEMENTS, root @ root.T, MASS_STD, COMMON_STD, THRUST_STD, *rest)


def drawn(count: int) -> Array:
    """Factors, common scale and K of vehicles that are drawn, shape (count, 11)."""
    random = np.random.default_rng(12)
    mass = MASS * (1.0 + MASS_STD * random.standard_normal((count, 1)))
    inverse = ELEMENTS / MASS + random.standard_normal((count, 6)) @ _inverse_root().T
    common = COMMON_STD * random.standard_normal((count, 1))
    own = 1.0 + THRUST_STD * random.standard_normal((count, JETS))
    return np.hstack((MASS / mass * own + common, common, mass * inverse))


def test_the_priors_covariances_are_those_of_drawn_vehicles() -> None:
    parts = make_parts(JETS, 2, 1, 0, 0)
    mean, covariance, free = prior(known(parts), np.zeros(parts.size, dtype=bool), parts)
    shown = slice(0, parts.spin.stop)
    np.testing.assert_array_equal(free[shown], np.arange(parts.spin.stop))
    sample = drawn(40_000)
    # the linearization is right to a hundredth of the errors, the draws to 1 in sqrt(40000)
    deviation = np.sqrt(np.diag(covariance)[shown])
    correlation = covariance[shown, shown] / np.outer(deviation, deviation)
    np.testing.assert_allclose(np.cov(sample.T) / np.outer(deviation, deviation), correlation, atol=0.03)
    np.testing.assert_allclose(sample.mean(axis=0), mean[shown], atol=0.03 * deviation.max())
    assert np.abs(correlation[parts.thrust, parts.spin]).max() > 0.5  # a heavy vehicle has a large K and small g


# ----------------------------------------------------------------------------------- first readings


def _at_the_start(sensors: Sensors, **more: object) -> PoseParams:
    parts = make_parts(JETS, 2, sensors.poses, sensors.gyros, sensors.accelerometers)
    mean, covariance, free = prior(known(parts), np.zeros(parts.size, dtype=bool), parts)
    return small_params(sensors, start=mean, covariance=covariance, free=free, **more)


def test_the_first_reading_places_the_center_of_mass_with_its_correlations() -> None:
    params = _at_the_start(Sensors(poses=2))
    parts, read = params.parts, nothing_read(params)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    read.rotations[1], read.positions[1] = turn, (1.0, 2.0, 3.0)
    bank = initialize_bank(read, params)
    second = slice(parts.point.start + 3, parts.point.stop)
    mean = params.start
    np.testing.assert_array_equal(bank.rotation[0], turn)
    np.testing.assert_allclose(bank.mean[0, parts.position], [1, 2, 3] - turn @ (mean[second] - mean[parts.center]))
    # by draws of point, center and attitude: p = reading - R (p_s - r)
    random, count = np.random.default_rng(3), 20_000
    point, center = (mean[part] + 0.1 * random.standard_normal((count, 3)) for part in (second, parts.center))
    off = np.sqrt(2e-6) * random.standard_normal((2, count, 3))
    places = [1, 2, 3] + off[0] - (point - center) @ turn.T
    rows = np.column_stack((places, point, center))
    every = np.arange(parts.size)
    columns = np.concatenate((every[parts.position], every[second], every[parts.center]))
    own = bank.covariance[0][np.ix_(columns, columns)]
    np.testing.assert_allclose(own, np.cov(rows.T), atol=0.03 * own.max())
    attitude = bank.covariance[0][parts.attitude, parts.attitude]
    np.testing.assert_allclose(attitude, 2e-6 * np.eye(3), rtol=1e-12)


# ------------------------------------------------------------------------------------------ outcome


def _read(params: PoseParams, by: Array, seen: Array, noise: float) -> tuple[Array, Array, float, float]:
    """State, its covariance, mu and its variance after readings of the state: all of one Gaussian, conditioned."""
    parts, free, of_mass = params.parts, params.free, params.mass_std**2
    with_mass = np.zeros(parts.size)
    with_mass[parts.thrust], with_mass[parts.spin] = of_mass, -of_mass * ELEMENTS
    joint = np.block([[params.covariance, with_mass[free, None]], [with_mass[None, free], np.array([[of_mass]])]])
    rows = np.column_stack((by, np.zeros(len(by))))
    gain = joint @ rows.T @ np.linalg.inv(rows @ joint @ rows.T + noise**2 * np.eye(len(by)))
    change, after = gain @ seen, joint - gain @ rows @ joint
    mean = params.start.copy()
    mean[free] += change[:-1]
    return mean, after[:-1, :-1], 1.0 + float(change[-1]), float(after[-1, -1])


def test_the_mass_is_what_the_exact_gaussian_says_of_it() -> None:
    params = _at_the_start(Sensors(), mass_std=0.01, thrust_std=THRUST_STD)
    by = np.zeros((6, params.free.size))
    by[[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, params.parts.spin.start, params.parts.spin.start + 2]] = 1.0
    seen = np.array([0.013, 0.008, 0.016, 0.006, 0.1, -0.2])
    for rows in (slice(0, 4), slice(0, 6), slice(4, 6)):
        mean, covariance, mu, variance = _read(params, by[rows], seen[rows], 0.002)
        values, found = estimated_properties(mean, covariance, np.ones(JETS, dtype=bool), params)
        assert values[9] * MASS == pytest.approx(mu, rel=1e-9)
        assert found[9, 9] * MASS**2 == pytest.approx(variance, rel=1e-6)
        np.testing.assert_allclose(values[:6], mean[params.parts.spin] * mu / MASS, rtol=1e-9)
    assert variance < 0.98 * 0.01**2  # of what the inertia is known by, K says something of the mass


def test_jets_that_have_failed_say_nothing_of_the_mass() -> None:
    params = _at_the_start(Sensors(), mass_std=0.01, thrust_std=THRUST_STD)
    mean = params.start.copy()
    mean[1] = 0.2
    healthy = np.array([True, False, True, True])
    values, covariance = estimated_properties(mean, params.covariance, healthy, params)
    assert values[9] == pytest.approx(1.0 / MASS, rel=1e-12)
    wrong, _ = estimated_properties(mean, params.covariance, np.ones(JETS, dtype=bool), params)
    assert wrong[9] < 0.9999 / MASS
    # before anything is read the mass is as well known as it was, and so is J
    assert covariance[9, 9] == pytest.approx((0.01 / MASS) ** 2, rel=1e-9)
    root = _inverse_root()
    np.testing.assert_allclose(covariance[:6, :6], root @ root.T, rtol=1e-6, atol=1e-12 * np.abs(covariance).max())
