"""A disturbance: how it goes on, how large it is, and how long it remembers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, decay_factor, next_deviation

STD = np.array([2.0, 0.0, 3.0, 1.0, 0.5, 4.0])


def test_size_and_memory_over_a_long_time() -> None:
    assert decay_factor(100.0, 0.08) ** (100.0 / 0.08) == pytest.approx(math.exp(-1.0), rel=1e-12)
    rng, kept, n = np.random.default_rng(1), 0.9, 20_000
    model = DisturbanceModel(np.zeros(6), STD, kept, np.zeros(6))
    deviation, values = STD * rng.standard_normal(6), np.empty((n, 6))
    for row in range(n):
        values[row] = deviation = next_deviation(deviation, rng.standard_normal(6), model)
    # (1 + 0.9) / (1 - 0.9) = 19 samples count as one: 1000 independent ones, of which a sigma is known to 2 %
    assert_allclose(values.std(axis=0), STD, rtol=0.08)
    for lag in (1, 5, 20):
        correlation = (values[lag:] * values[:-lag]).mean(axis=0)
        assert_allclose(correlation[STD > 0.0] / STD[STD > 0.0] ** 2, kept**lag, rtol=0.0, atol=0.15)
