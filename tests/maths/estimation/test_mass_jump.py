"""The windowed test for jumps of the mass reciprocal: against its sums, and single samples."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_equal
from params_probe import mass_params

from massprop_drake import load_scenario
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.mass_filter import (
    MassCycle,
    MassInnovation,
    MassSample,
    MassState,
    innovate,
    update,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window, jump_test
from massprop_drake.maths.linear_algebra import Array


class Firing(NamedTuple):
    """Impulses, noises and innovation covariances of a Kalman filter for 1/m over some samples."""

    impulses: Array  # (n, 3)
    noises: Array  # R', (n, 3, 3)
    informations: Array  # inverses of Y, (n, 3, 3)
    variances: Array  # predicted, then after each sample, (n + 1,)
    shares: Array  # kappa^T lambda of each sample, (n,)


def firing(samples: int) -> Firing:
    """Moderate numbers: a sample tells about as much as is known before."""
    rng = np.random.default_rng(1)
    impulses, mixing = rng.normal(size=(samples, 3)), rng.normal(size=(samples, 3, 3)) + 1.5 * np.eye(3)
    noises = mixing @ mixing.transpose(0, 2, 1)
    informations, variances, shares = [], [0.5], []
    for impulse, noise in zip(impulses, noises, strict=True):
        informations.append(np.linalg.inv(np.outer(impulse, impulse) * variances[-1] + noise))
        shares.append(variances[-1] * impulse @ informations[-1] @ impulse)
        variances.append((1.0 - shares[-1]) * variances[-1])
    return Firing(impulses, noises, np.array(informations), np.array(variances), np.array(shares))


def test_the_recursion_against_the_sums() -> None:
    samples, length, flight = 6, 4, firing(6)
    innovations = np.random.default_rng(2).normal(size=(samples, 3))

    def effect(k: int, theta: int) -> float:
        """f of (3-97): the sum over samples of what each update takes up, written out."""
        return sum(np.prod(1.0 - flight.shares[i + 1 : k + 1]) * flight.shares[i] for i in range(theta, k + 1))

    window = empty_window(length)
    for k in range(samples):
        before = window.copy()
        sample = flight.impulses[k], flight.informations[k], innovations[k], float(flight.shares[k])
        test = jump_test(window, *sample)
        assert_array_equal(window, before)  # what was handed in is not changed
        window = test.window
        assert window.shape == (length, 3)
        for row, theta in enumerate(range(k - length + 1, k + 1)):  # the newest last
            if theta < 0:
                assert not window[row].any()
                continue
            since = range(theta, k + 1)
            g = [flight.impulses[i] * (1.0 - effect(i - 1, theta)) for i in since]  # (3-100)
            y, e = flight.informations[theta : k + 1], innovations[theta : k + 1]
            information = sum(a @ b @ a for a, b in zip(g, y, strict=True))  # (3-104)
            projection = sum(a @ b @ c for a, b, c in zip(g, y, e, strict=True))  # (3-105)
            assert_allclose(window[row], [effect(k, theta), information, projection], rtol=1e-10)
        f, c, d = window[window[:, 1] > 0.0].T  # the likeliest is reported
        best = int((d**2 / c).argmax())
        expected = d / c, d**2 / c, (1.0 - f) * d / c, (1.0 - f) ** 2 / c
        assert_allclose(test[1:], [each[best] for each in expected], rtol=1e-14)


def test_a_sample_without_an_impulse_tells_nothing() -> None:
    test = jump_test(empty_window(2), np.zeros(3), np.eye(3), np.ones(3), 0.0)
    assert test[1:] == (0.0, 0.0, 0.0, 0.0)


def updated(flight: Firing, error: float, length: int = 1, **params: Any) -> MassCycle:
    """The filter after one sample that shows an error of its estimate, 2."""
    seen, information = flight.impulses[0] * error + np.array([0.1, -0.2, 0.3]), flight.informations[0]
    nis = float(seen @ information @ seen)
    innovation = MassInnovation(seen, np.linalg.inv(information), information, flight.noises[0], None, nis)
    state = MassState(2.0, flight.variances[0], empty_window(length))
    sample = MassSample(np.full(3, np.nan), flight.noises[0], flight.impulses[0])
    chosen = mass_params(jump_variance=1.0, jump_window=length, **params)
    return update(state, sample, innovation, NO_ADAPTATION, chosen)


def test_after_a_single_sample_jump_the_sample_alone_counts() -> None:
    # a threshold that anything exceeds, against weighted least squares of this sample: variance
    # 1 / (lambda^T R'^-1 lambda), the corrected (3-118)
    flight = firing(1)
    result = updated(flight, 0.4, jump_threshold=0.0)
    impulse, information = flight.impulses[0], np.linalg.inv(flight.noises[0])
    alone = impulse @ information @ impulse
    seen = impulse * 2.4 + np.array([0.1, -0.2, 0.3])
    assert result.jumped
    assert_allclose(result.state[:2], [impulse @ information @ seen / alone, 1.0 / alone], rtol=1e-10)


def test_the_filter_jumps_when_the_statistic_exceeds_its_threshold() -> None:
    flight = firing(1)
    quiet = updated(flight, 4.0, 3)
    seen = flight.impulses[0] * 4.0 + np.array([0.1, -0.2, 0.3])
    share = 1.0 - (1.0 - float(flight.shares[0]))  # what the filter's own share is to the last bit
    test = jump_test(empty_window(3), flight.impulses[0], flight.informations[0], seen, share)
    below, above = (updated(flight, 4.0, 3, jump_threshold=test.likelihood * factor) for factor in (0.999, 1.001))
    assert (quiet.jumped, below.jumped, above.jumped) == (False, True, False)
    expected = quiet.state.mass_reciprocal + test.correction, quiet.state.variance + test.growth
    assert_allclose(below.state[:2], expected, rtol=1e-12)
    assert not below.state.window.any()  # the next jump is looked for from here
    assert_array_equal(above.state.window, test.window)
    assert above.state[:2] == quiet.state[:2]


@pytest.mark.parametrize(("gain", "ratio"), [(0.8, 7.4), (0.004, 1.016)])
def test_the_thesiss_variance_over_that_of_the_sample_alone(gain: float, ratio: float) -> None:
    # lambda = (0, 0, 2), R' = 4: the sample alone has variance 1, gain g means a prior variance of g / (1 - g);
    # the thesis: 3 (1 - g) g / (1 - g) + Y / 4 with Y = 4 / (1 - g)
    state = MassState(0.3, gain / (1.0 - gain), empty_window(1))
    sample = MassSample(np.array([0.0, 0.0, 1.0]), 4.0 * np.eye(3), np.array([0.0, 0.0, 2.0]))
    chosen = [
        inputs.mass_params(load_scenario("sample_maneuver", [f"mass.jump={jump}"]))
        for jump in ("single_sample", "single_sample_thesis")
    ]
    assert_equal(chosen[1]._replace(small_gain=False)._asdict(), chosen[0]._asdict())
    always = [params._replace(jump_threshold=0.0, jump_variance=1.0) for params in chosen]
    exact, thesis = (update(state, sample, innovate(state, sample), NO_ADAPTATION, each).state for each in always)
    assert exact.variance == pytest.approx(1.0, rel=1e-12)
    assert thesis.variance == pytest.approx(3.0 * gain + 1.0 / (1.0 - gain), rel=1e-12)
    assert thesis.variance == pytest.approx(ratio, rel=1e-3)
    assert thesis.mass_reciprocal == exact.mass_reciprocal
