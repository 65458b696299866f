"""What is known before the first sample, and what a state says of the mass properties: against draws and Gaussians."""

from __future__ import annotations

import numpy as np
import pytest
from pose_probe import JETS, MASS, SPIN, Sensors, nothing_read, small_params
from scipy.spatial.transform import Rotation

from massprop_drake.maths.estimation.pose.outcome import outcome
from massprop_drake.maths.estimation.pose.pose_layout import Parts, PoseParams, make_parts
from massprop_drake.maths.estimation.pose.pose_start import Beforehand, begun, prior
from massprop_drake.maths.linear_algebra import Array

ELEMENTS = SPIN[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
THRUST_STD = np.array([0.004, 0.006, 0.005, 0.003])


def _inverse_root() -> Array:
    """Root of the covariance of J, shape (6, 6); a hundredth of it, correlated."""
    random = np.random.default_rng(9)
    return np.asarray(0.01 / MASS * ELEMENTS[:3].mean() * random.standard_normal((6, 6)) / np.sqrt(6.0))


def known(parts: Parts, mass_std: float = 0.01, common_std: float = 0.008) -> Beforehand:
    root = _inverse_root()
    rest_std = np.full(parts.size, 0.1)
    return Beforehand(
        ELEMENTS, MASS**2 * root @ root.T, mass_std, common_std, THRUST_STD, np.full(parts.size, 0.25), rest_std
    )


def drawn(count: int, mass_std: float = 0.01, common_std: float = 0.008) -> Array:
    """Factors, common scale and K of vehicles that are drawn, shape (count, 11)."""
    random = np.random.default_rng(12)
    mass = MASS * (1.0 + mass_std * random.standard_normal(count))
    inverse = ELEMENTS / MASS + random.standard_normal((count, 6)) @ _inverse_root().T
    common = common_std * random.standard_normal(count)
    own = 1.0 + THRUST_STD * random.standard_normal((count, JETS))
    factors = MASS / mass[:, None] * own + common[:, None]
    return np.column_stack((factors, common, mass[:, None] * inverse))


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


def test_what_has_no_sigma_or_cannot_move_is_not_free() -> None:
    parts = make_parts(JETS, 2, 1, 0, 0)
    fixed = np.zeros(parts.size, dtype=bool)
    fixed[parts.point] = True
    given = known(parts, mass_std=0.0, common_std=0.0)
    given.rest_std[parts.drag] = 0.0
    mean, covariance, free = prior(given._replace(thrust_std=np.array([0.0, 0.1, 0.0, 0.1])), fixed, parts)
    gone = {0, 2, parts.common.start, *range(*parts.drag.indices(parts.size)), *range(*parts.point.indices(parts.size))}
    assert set(range(parts.size)) - set(free.tolist()) == gone
    assert covariance.shape == (free.size, free.size)
    np.testing.assert_array_equal(mean[parts.drag], 0.25)


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
    bank = begun(read, params)
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
    """State, its covariance, mu and its variance after readings of the state: all of one Gaussian, conditioned.

    Args:
        params: whose start is the prior.
        by: what is read of what is free, shape (m, n).
        seen: the readings, less what the start has, shape (m,).
        noise: of them, 1-sigma.
    """
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
        values, found = outcome(mean, covariance, np.ones(JETS, dtype=bool), params)
        assert values[9] * MASS == pytest.approx(mu, rel=1e-9)
        assert found[9, 9] * MASS**2 == pytest.approx(variance, rel=1e-6)
        np.testing.assert_allclose(values[:6], mean[params.parts.spin] * mu / MASS, rtol=1e-9)
    assert variance < 0.98 * 0.01**2  # of what the inertia is known by, K says something of the mass


def test_jets_that_have_failed_say_nothing_of_the_mass() -> None:
    params = _at_the_start(Sensors())
    params = params._replace(mass_std=0.01, thrust_std=THRUST_STD)
    mean = params.start.copy()
    mean[1] = 0.2
    healthy = np.array([True, False, True, True])
    values, covariance = outcome(mean, params.covariance, healthy, params)
    assert values[9] == pytest.approx(1.0 / MASS, rel=1e-12)
    wrong, _ = outcome(mean, params.covariance, np.ones(JETS, dtype=bool), params)
    assert wrong[9] < 0.9999 / MASS
    # before anything is read the mass is as well known as it was, and so is J
    assert covariance[9, 9] == pytest.approx((0.01 / MASS) ** 2, rel=1e-9)
    root = _inverse_root()
    np.testing.assert_allclose(covariance[:6, :6], root @ root.T, rtol=1e-6, atol=1e-12 * np.abs(covariance).max())


def test_the_parameters_vary_as_the_state_does() -> None:
    """Against draws: the state, and a mu of it by conditioning."""
    params = _at_the_start(Sensors())
    params = params._replace(mass_std=0.01, thrust_std=THRUST_STD)
    _, covariance = outcome(params.start, params.covariance, np.ones(JETS, dtype=bool), params)
    sample = drawn(40_000)
    mass = MASS * (1.0 + 0.01 * np.random.default_rng(12).standard_normal(40_000))  # as `drawn` has it
    ten = np.column_stack((sample[:, 5:] / mass[:, None], 1.0 / mass))
    places = [*range(6), 9]
    deviation = np.sqrt(np.diag(covariance))[places]
    own = covariance[np.ix_(places, places)] / np.outer(deviation, deviation)
    np.testing.assert_allclose(np.cov(ten.T) / np.outer(deviation, deviation), own, atol=0.03)
