"""Mean and covariance of both innovations while a jet fails, by sampling: what filters and detector claim.

Errors of the estimates, thrust errors and noise are drawn, the body is pushed by the true impulses, and the
innovations' moments are compared with those of `thesis.evidence` and `jet_tests.covariances_given_failure`. The center
of mass is known, so that what is claimed is exact, up to what both innovations share of products of two errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE
from massprop_drake.maths.estimation.detectors.jet_tests import (
    UncertainSignatures,
    covariances_given_failure,
    signatures,
)
from massprop_drake.maths.estimation.filter import Interval, Joint
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.filters.mass_filter import MassState
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rotation_filter import RotationMemory, RotationState
from massprop_drake.maths.estimation.filters.thesis import ThesisParams, ThesisState
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, pack

PAIRS = 100_000
PERIOD_S = 0.5
N_JETS = 4
FORCE = np.array([3.0, 2.0, 4.0, 2.5])
ON = np.array([1.0, 1.0, 0.0, 0.0])
INERTIA = np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]])
CENTER, MASS = np.array([0.5, -0.3, 0.2]), 5.0
PROPERTIES = pack(np.linalg.inv(INERTIA), CENTER, 1.0 / MASS)
RATE_VARIANCE, VELOCITY_VARIANCE = 2e-5, 1e-4
STUCK_ON, STUCK_OFF = (2, FORCE[2]), (0, -FORCE[0])  # jet, and what it gives too much


class Case(NamedTuple):
    """A sample in which two jets are told to fire, as the filters see it, and as it is drawn."""

    seen: Joint  # of a measurement of zero
    wrenches: Array  # of a unit force along each jet, shape (n_jets, 6)
    sensitivity: Array  # Psi of the ten parameters, shape (10, n_jets)
    independent: Array  # root of S_0, shape (10, 10)
    thrust_std: float

    def covariance(self, jet: int, force: float) -> Array:
        """Y_j."""
        c = signatures(self.wrenches, PROPERTIES, PERIOD_S)
        uncertain = UncertainSignatures(
            c, self.wrenches * PERIOD_S, PROPERTIES, self.seen.estimate_covariance, self.seen.cross_covariance
        )
        result: Array = covariances_given_failure(np.full(N_JETS, force), self.seen.covariance, uncertain)[jet]
        return result

    def mean(self, jet: int, force: float) -> Array:
        """f c_j."""
        result: Array = force * signatures(self.wrenches, PROPERTIES, PERIOD_S)[jet]
        return result

    def drawn(self, jet: int, force: float) -> Array:
        """Innovations of pairs of opposite draws, in whose mean nothing of first order is left, shape (2, PAIRS, 6)."""
        drawn = np.random.default_rng(1).standard_normal((PAIRS, N_JETS + 16))
        beta, apart, noise = np.split(np.stack([drawn, -drawn]), [N_JETS, N_JETS + 10], axis=2)
        errors = beta @ self.sensitivity.T + apart @ self.independent.T
        truth = PROPERTIES + errors
        given = ON * FORCE * (1.0 + self.thrust_std * beta)
        given[..., jet] += force
        impulse = given @ self.wrenches * PERIOD_S
        moment = impulse[..., :3] + np.cross(impulse[..., 3:], CENTER)
        turned = np.einsum("snij,snj->sni", truth[..., ELEMENT], moment)
        pushed = truth[..., 9:] * impulse[..., 3:]
        noise = noise * np.sqrt([VELOCITY_VARIANCE] * 3 + [RATE_VARIANCE] * 3)
        return np.concatenate([pushed, turned], axis=2) + noise + self.seen.innovation


def case(thrust_std: float) -> Case:
    """Estimates known to some percent; with thrust errors, half of what is not known came of them."""
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(N_JETS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    wrenches = np.hstack([np.cross(rng.normal(size=(N_JETS, 3)), directions), directions])
    size = np.array([*0.06 * PROPERTIES[:3], *[0.02] * 3, 0.0, 0.0, 0.0, 0.06 * PROPERTIES[9]])
    considered = thrust_std > 0.0
    sensitivity = 0.5 * size[:, None] * rng.normal(size=(10, N_JETS)) * considered
    independent = np.diag(size)
    independent[:6, :6] @= np.eye(6) + 0.3 * rng.normal(size=(6, 6))
    covariance = independent @ independent.T + sensitivity @ sensitivity.T
    impulse = ON * FORCE @ wrenches * PERIOD_S
    params = ThesisParams(
        rotation_params(period_s=PERIOD_S, gyro_variances=np.full(1, 0.5 * RATE_VARIANCE)),
        mass_params(period_s=PERIOD_S, variances=np.full(1, 0.5 * VELOCITY_VARIANCE)),
        PROPERTIES,
        covariance,
        thrust_std * FORCE[:, None] * wrenches * PERIOD_S if considered else None,
    )
    state = ThesisState(
        RotationState(PROPERTIES[:9], covariance[:9, :9], sensitivity[:9] if considered else None),
        RotationMemory(np.zeros((1, 3)), False),
        MassState(PROPERTIES[9], covariance[9, 9], empty_window(1), sensitivity[9] if considered else None),
        np.zeros((1, 3)),
    )
    interval = Interval(Impulses(impulse[:3], impulse[3:], True, True, ON, ON), NO_KNOWN_FORCE)
    measurement = thesis.measure(state, np.zeros((1, 3)), np.zeros((1, 3)), interval, params)
    return Case(thesis.evidence(state, measurement, interval), wrenches, sensitivity, independent, thrust_std)


def sampled(innovations: Array) -> tuple[Array, Array, Array, Array]:
    """Mean and its bounds, covariance and its bounds: five standard errors."""
    mean = innovations.mean(axis=(0, 1))
    products = ((innovations - mean)[..., :, None] * (innovations - mean)[..., None, :]).mean(axis=0)
    root = 5.0 / np.sqrt(PAIRS)
    bounds = root * innovations.mean(axis=0).std(axis=0) + 1e-13  # rounding, where nothing of second order is left
    return mean, bounds, products.mean(axis=0), root * products.std(axis=0)


@pytest.mark.parametrize("thrust_std", [0.0, 0.1], ids=["thrust known", "thrust errors considered"])
@pytest.mark.parametrize("failure", [STUCK_ON, STUCK_OFF], ids=["stuck on", "stuck off"])
def test_moments_of_both_innovations_while_a_jet_fails(failure: tuple[int, float], thrust_std: float) -> None:
    dut = case(thrust_std)
    claimed, (jet, force) = dut.covariance(*failure), failure
    mean, mean_bounds, covariance, bounds = sampled(dut.drawn(*failure))
    assert (np.abs(mean - dut.mean(*failure)) < mean_bounds).all()
    assert (np.abs(covariance - claimed) < bounds).all()
    # the test can tell: no term of either may be left out
    jacobian = np.zeros((6, 10))
    jacobian[:3, 9] = dut.wrenches[jet, 3:] * PERIOD_S
    moment = np.cross(dut.wrenches[jet, 3:], CENTER) + dut.wrenches[jet, :3]
    for row in range(3):
        jacobian[3 + row, ELEMENT[row]] = moment * PERIOD_S
    cross = force * dut.seen.cross_covariance @ jacobian.T
    square = force**2 * jacobian @ dut.seen.estimate_covariance @ jacobian.T
    for part in (cross, cross.T, square):
        assert (np.abs(covariance - (claimed - part)) > 2.0 * bounds).any()
    assert_allclose(claimed, dut.seen.covariance + cross + cross.T + square, rtol=1e-12, atol=1e-15)
