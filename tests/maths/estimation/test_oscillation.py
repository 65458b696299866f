"""The mode inside a vehicle that residuals show."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from massprop_drake.maths.estimation.offline.oscillation import gauss_markov_spectrum, increment_spectrum, mode_response


@pytest.mark.parametrize(("frequency_hz", "damping"), [(0.05, 0.02), (1.1, 0.3)])
def test_a_driven_mode_moves_as_its_differential_equation_has_it(frequency_hz: float, damping: float) -> None:
    """q'' + 2 zeta w q' + w^2 q = -u, from rest, by steps of u in between rows."""
    period_s, omega = 0.08, 2.0 * np.pi * frequency_hz
    time_s = period_s * np.arange(200)
    u = np.where((time_s >= 2.0) & (time_s < 5.0), 0.7, 0.0) - 0.2 * (time_s >= 9.0)
    steps = np.diff(u, prepend=0.0)
    state, rates = np.zeros(2), [0.0]
    for value in u[:-1]:
        solved = solve_ivp(
            lambda _, y, value=value: [y[1], -value - 2.0 * damping * omega * y[1] - omega**2 * y[0]],
            (0.0, period_s),
            state,
            rtol=1e-10,
            atol=1e-12,
        )
        state = solved.y[:, -1]
        rates.append(float(state[1]))
    found = mode_response(steps[None], time_s, frequency_hz, damping)
    np.testing.assert_allclose(found, [rates], atol=1e-8)


def test_lines_have_the_power_of_a_walk_and_of_noise() -> None:
    """Means over 500 walks of 300 rows each, with white noise of one: three neighbors, so 1.5 % by chance."""
    generator = np.random.default_rng(4)
    n, walk, period_s = 300, 3.0, 0.1
    power = np.zeros(148)
    for _ in range(500):
        left = np.cumsum(generator.normal(0.0, walk * np.sqrt(period_s), n)) + generator.normal(size=n)
        lines = increment_spectrum(left, period_s * np.arange(n))
        power += lines.power / (walk**2 + lines.noise) / 500
    np.testing.assert_allclose(power, 1.0, atol=0.12)
    assert power.mean() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("constant_s", [0.3, 200.0])
def test_lines_of_a_disturbance_have_its_power(constant_s: float) -> None:
    """Means over 1000 processes of 200 rows each, begun as they go on: three neighbors, so 2 % by chance."""
    generator = np.random.default_rng(5)
    n, period_s, left = 200, 0.1, np.zeros((1000, 200))
    kept, power, acting = np.exp(-period_s / constant_s), np.zeros(98), generator.normal(size=1000)
    for row in range(1, n):
        left[:, row] = left[:, row - 1] + period_s * acting
        acting = kept * acting + np.sqrt(1.0 - kept**2) * generator.normal(size=1000)
    for each in left:
        lines = increment_spectrum(each, period_s * np.arange(n))
        power += (
            lines.power / np.convolve(gauss_markov_spectrum(constant_s, lines), np.full(3, 1.0 / 3.0), "valid") / 1000
        )
    assert power.mean() == pytest.approx(1.0, abs=0.03)
