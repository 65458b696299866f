"""Tests of single samples for failed jets: against loops, symmetries, the laws of chance and the thesis."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.inputs.params import unit_wrenches
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detectors.jet_tests import (
    Isolation,
    JetTests,
    UncertainSignatures,
    isolate,
    jet_tests,
    signatures,
    uncertain_jet_tests,
)
from massprop_drake.maths.estimation.filters.rate_increments import rate_increment_jacobian
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT

PERIOD_S, N = 0.08, 44
OFF, ALLOWED, HALF = np.ones(N, dtype=bool), np.zeros(N, dtype=bool), np.arange(N) % 2 == 0


class Case(NamedTuple):
    """The orbiter at its nominal mass properties, with the sensors of section 5.5 of the thesis."""

    wrenches: Array  # of a unit force along each jet
    properties: Array
    coefficients: Array
    whole: Array  # Y
    clusters: Array

    def tests(self, innovation: Array, off: Array = ALLOWED, on: Array = ALLOWED) -> JetTests:
        """The certain tests of one innovation; no sign is ruled out unless said."""
        return jet_tests(self.coefficients, innovation, np.linalg.inv(self.whole), off, on)

    def uncertain(self, innovation: Array, covariance: Array, off: Array = ALLOWED) -> JetTests:
        """The tests again, with estimates of this covariance, shape (10, 10)."""
        impulses, cross = self.wrenches * PERIOD_S, np.zeros((6, 10))
        uncertain = UncertainSignatures(self.coefficients, impulses, self.properties, covariance, cross)
        return uncertain_jet_tests(
            self.tests(innovation, off), innovation, self.whole, uncertain, off, np.zeros_like(off)
        )

    def failing(self, number: int, force: float, off: Array = OFF) -> tuple[JetTests, Isolation]:
        """Tests and isolation of a failure without noise, by the number of its jet."""
        result = self.tests(force * self.coefficients[number - 1], off)
        return result, isolate(result.likelihood, self.clusters)


@pytest.fixture(scope="module")
def case(orbiter: Vehicle) -> Case:
    wrenches, properties = unit_wrenches(orbiter), orbiter.nominal.vector()
    whole = np.diag(np.repeat([0.0344**2 / 6.0, 1.52e-6**2 / 6.0], 3))  # ft^2/s^2, rad^2/s^2
    clusters = np.array([jet.cluster for jet in orbiter.jets])
    return Case(wrenches, properties, signatures(wrenches, properties, PERIOD_S), whole, clusters)


@pytest.fixture(scope="module")
def skewed(case: Case) -> tuple[Case, Array]:
    """The same with a covariance that is far from diagonal, and an innovation: a soft failure and noise."""
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(6, 6)) + 2.0 * np.eye(6)
    whole = np.sqrt(case.whole) @ mixing @ mixing.T @ np.sqrt(case.whole) / 5.0
    return case._replace(whole=whole), 20.0 * case.coefficients[17] + np.linalg.cholesky(whole) @ rng.normal(size=6)


@pytest.fixture(scope="module")
def spread(case: Case) -> Array:
    """Covariance of estimates known to 2 %, with correlations; 1/m to 10 %, apart."""
    mixing = np.eye(9) + 0.3 * np.random.default_rng(3).normal(size=(9, 9))
    correlation = mixing @ mixing.T
    deviation = 0.02 * np.array([*case.properties[:3], 3e-8, 3e-8, 3e-8, 30.0, 3.0, 3.0])
    deviation /= np.sqrt(np.diag(correlation))
    covariance = np.zeros((10, 10))
    covariance[:9, :9] = correlation * np.outer(deviation, deviation)
    covariance[9, 9] = (0.1 * case.properties[9]) ** 2
    return covariance


def test_signatures_against_the_formula_jet_by_jet(case: Case, orbiter: Vehicle) -> None:
    center, inverse_inertia = case.properties[6:9], case.properties[ELEMENT]
    expected = []
    for jet in orbiter.jets:
        direction = np.array(jet.direction) / np.linalg.norm(jet.direction)
        turning = inverse_inertia @ np.cross(np.array(jet.position) - center, direction)
        expected.append(np.concatenate([case.properties[9] * direction, turning]) * PERIOD_S)
    # torque about the center of mass is a difference of two moments twenty times larger at worst
    scale = np.abs(expected).max(axis=0)
    assert_allclose(case.coefficients / scale, expected / scale, atol=1e-13)


def test_magnitude_variance_and_likelihood_against_loops(skewed: tuple[Case, Array]) -> None:
    case, innovation = skewed
    information, result = np.linalg.inv(case.whole), case.tests(innovation)
    total = innovation @ information @ innovation
    for jet, c in enumerate(case.coefficients):
        strength, projection = c @ information @ c, c @ information @ innovation
        ours = [part[jet] for part in result]
        assert_allclose(ours[:2], [projection / strength, 1.0 / strength], rtol=1e-9)
        # relative to what there is: a small argument is a difference of large terms
        likelihood = projection**2 / strength
        assert_allclose(ours[2:], [likelihood, total - likelihood], rtol=1e-9, atol=1e-12 * total)


def test_a_jet_that_is_off_cannot_have_lost_thrust(skewed: tuple[Case, Array], spread: Array) -> None:
    case, innovation = skewed
    free, ruled = case.tests(innovation), case.tests(innovation, off=HALF)
    out = HALF & (free.magnitude < 0.0)
    assert 5 < out.sum() < 20  # the case shows something
    again = case.uncertain(innovation, spread, HALF)
    for tests in (ruled, again):
        assert not tests.magnitude[out].any()
        assert not tests.likelihood[out].any()
        total = innovation @ np.linalg.inv(case.whole) @ innovation
        assert_allclose(tests.unexplained[out], total, rtol=1e-9)
    assert (again.likelihood >= 0.0).all()
    for kept, known in zip(ruled, free, strict=True):
        assert_array_equal(kept[~out], known[~out])
    assert_array_equal(ruled.variance, free.variance)
    # the mirror rule is the sign rule of the opposite innovation
    mirrored = case.tests(-innovation, on=HALF)
    for ours, theirs in zip(mirrored, ruled._replace(magnitude=-ruled.magnitude), strict=True):
        assert_array_equal(ours, theirs)


def test_uncertain_tests_against_the_full_form_jet_by_jet(skewed: tuple[Case, Array], spread: Array) -> None:
    case, innovation = skewed
    certain, result = case.tests(innovation), case.uncertain(innovation, spread)
    plain = innovation @ np.linalg.inv(case.whole) @ innovation
    for jet, (wrench, c) in enumerate(zip(case.wrenches * PERIOD_S, case.coefficients, strict=True)):
        jacobian = np.zeros((6, 10))
        jacobian[:3, 9] = wrench[3:]
        jacobian[3:, :9] = rate_increment_jacobian(case.properties[:9], wrench[:3], wrench[3:])
        grown = case.whole + certain.magnitude[jet] ** 2 * jacobian @ spread @ jacobian.T
        information = np.linalg.inv(grown)
        strength = c @ information @ c
        magnitude = c @ information @ innovation / strength
        left = innovation @ information @ innovation - magnitude**2 * strength
        likelihood = plain - left - np.log(np.linalg.det(grown @ np.linalg.inv(case.whole)))
        ours = [part[jet] for part in result]
        assert_allclose(ours[:2], [magnitude, 1.0 / strength], rtol=1e-8)
        assert_allclose(ours[2:], [max(likelihood, 0.0), left], rtol=1e-8, atol=1e-9 * plain)
    again = case.uncertain(innovation, np.zeros((10, 10)), HALF)  # certain estimates leave the tests as they are
    for ours, theirs in zip(again, case.tests(innovation, off=HALF), strict=True):
        assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * plain)


@pytest.mark.parametrize(
    ("likelihood", "clusters", "expected"),
    [
        # cluster 7 leads cluster 4 by 40 - 25, its first jet the second by 40 - 31
        ([3.0, 10.0, 40.0, 31.0, 2.0, 25.0], [1, 1, 7, 7, 7, 4], (2, 7, 15.0, 9.0)),
        ([3.0, 12.0, 5.0], [1, 2, 1], (1, 2, 7.0, 12.0)),  # alone in its cluster: leads it by all that it has
        ([20.0, 20.0, 1.0], [1, 1, 2], (0, 1, 19.0, 0.0)),  # a tie leaves no margin
        ([20.0, 1.0, 20.0], [1, 1, 2], (0, 1, 0.0, 19.0)),
        ([9.0, 2.0], [3, 3], (0, 3, 9.0, 7.0)),
        ([0.0, 0.0, 0.0], [1, 1, 2], (0, 1, 0.0, 0.0)),
    ],
)
def test_isolation_compares_clusters_first_and_then_the_jets_in_one(
    likelihood: list[float], clusters: list[int], expected: tuple[float, ...]
) -> None:
    assert isolate(np.array(likelihood), np.array(clusters)) == expected


BUT_17, BUT_11, BUT_11_AND_12 = (~np.isin(np.arange(N), jets) for jets in ([16], [10], [10, 11]))


# Table 5-2 truth, Y of section 5.5, whole-interval failure, no noise; reference section 6, each number to half its last
# printed digit. All jets are off but those that the case says
@pytest.mark.parametrize(
    ("number", "force", "off", "expected"),  # statistic, lead within and between clusters, the next one, 1-sigma
    [
        (29, 868.819, OFF, ((8.07e5, 0.005e5), (289.0, 0.5), (17_800.0, 50.0), 7, 0.97)),
        (39, 24.483, OFF, ((1121.0, 0.5), (2.8, 0.05), (582.0, 0.5), 2, 0.73)),
        (24, 0.015 * 691.018, OFF, ((260.0, 0.5), (0.04, 0.005), (81.0, 0.5), 8, 0.64)),
        (27, 10.0, OFF, ((7.7, 0.05), None, (0.11, 0.005), 8, None)),
        # the opposing jet fires, so that it may have failed off: the lead over its cluster is small
        (29, 868.819, BUT_17, ((8.07e5, 0.005e5), None, (32.8, 0.05), 8, 0.97)),
        (11, -874.185, BUT_11_AND_12, ((1.08e6, 0.005e6), (2.0e4, 0.05e4), (1940.0, 5.0), 2, 0.84)),
        (11, -874.185, BUT_11, ((1.08e6, 0.005e6), (1.08e6, 0.005e6), (1940.0, 5.0), 2, 0.84)),
    ],
)
def test_separations_of_the_thesis(case: Case, number: int, force: float, off: Array, expected: Any) -> None:
    statistic, within, between, next_cluster, deviation = expected
    result, found = case.failing(number, force, off)
    jet = number - 1
    assert found[:2] == (jet, case.clusters[jet])
    assert_allclose(result.magnitude[jet], force, rtol=1e-12)
    assert abs(result.unexplained[jet]) < 1e-12 * result.likelihood[jet]
    assert abs(result.likelihood[jet] - statistic[0]) <= statistic[1]
    assert abs(found.cluster_margin - between[0]) <= between[1]
    elsewhere = np.where(case.clusters == found.cluster, -1.0, result.likelihood)
    assert case.clusters[elsewhere.argmax()] == next_cluster
    assert within is None or abs(found.jet_margin - within[0]) <= within[1]
    assert deviation is None or abs(np.sqrt(result.variance[jet]) - deviation) <= 0.005
