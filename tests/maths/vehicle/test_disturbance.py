"""A disturbance: how it goes on, how large it is, and how long it remembers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, about_origin, kept_share, next_deviation
from massprop_drake.maths.vehicle.rigid_body import torque_about_center

STD = np.array([2.0, 0.0, 3.0, 1.0, 0.5, 4.0])


def _model(kept: float) -> DisturbanceModel:
    return DisturbanceModel(np.zeros(6), STD, kept, np.zeros(6))


def test_the_share_kept_after_the_correlation_time_is_one_over_e() -> None:
    assert kept_share(100.0, 0.08) ** (100.0 / 0.08) == pytest.approx(math.exp(-1.0), rel=1e-12)


def test_next_deviation_of_hand_value() -> None:
    # 0.6 of what was, and sqrt(1 - 0.36) = 0.8 of a sigma of noise
    noise = np.array([1.0, 5.0, -2.0, 0.0, 1.0, 0.5])
    before = np.array([1.0, 0.0, 1.0, 2.0, 0.0, -1.0])
    np.testing.assert_allclose(
        next_deviation(before, noise, _model(0.6)), [2.2, 0.0, -4.2, 1.2, 0.4, 1.0], rtol=1e-14, atol=1e-15
    )


def test_size_and_memory_over_a_long_time() -> None:
    rng = np.random.default_rng(1)
    kept, n = 0.9, 20_000
    deviation, values = STD * rng.standard_normal(6), np.empty((n, 6))
    for row in range(n):
        deviation = next_deviation(deviation, rng.standard_normal(6), _model(kept))
        values[row] = deviation
    # (1 + 0.9) / (1 - 0.9) = 19 samples count as one: 1000 independent ones, of which a sigma is known to 2 %
    np.testing.assert_allclose(values.std(axis=0), STD, rtol=0.08)
    for lag in (1, 5, 20):
        correlation = (values[lag:] * values[:-lag]).mean(axis=0)
        np.testing.assert_allclose(correlation[STD > 0.0] / STD[STD > 0.0] ** 2, kept**lag, rtol=0.0, atol=0.15)


def test_about_the_origin_and_back() -> None:
    rng = np.random.default_rng(2)
    for disturbance, center in zip(rng.standard_normal((9, 6)), rng.standard_normal((9, 3)), strict=True):
        moved = about_origin(disturbance, center)
        np.testing.assert_allclose(torque_about_center(moved, center), disturbance[:3], rtol=0.0, atol=1e-14)
        np.testing.assert_array_equal(moved[3:], disturbance[3:])


def test_a_force_at_the_center_of_mass_turns_about_the_origin() -> None:
    # (1, 0, 0) x (0, 0, 3) = (0, -3, 0)
    moved = about_origin(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 3.0]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(moved, [0.5, -3.0, 0.0, 0.0, 0.0, 3.0])
