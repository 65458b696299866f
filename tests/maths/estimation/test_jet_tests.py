"""Tests of single samples for failed jets: against loops, symmetries, the laws of chance and the thesis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import binom, chi2, kstest, ncx2

from massprop_drake.inputs.params import unit_wrenches
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detectors.jet_tests import (
    Isolation,
    JetTests,
    Signs,
    UncertainSignatures,
    isolate,
    jet_tests,
    signatures,
    uncertain_jet_tests,
)
from massprop_drake.maths.estimation.filters.rotation_filter import rate_increment_jacobian, rate_increment_jacobians
from massprop_drake.maths.estimation.filters.thesis import joint_covariance
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT, pack

PERIOD_S = 0.08


class Case(NamedTuple):
    """The orbiter at its nominal mass properties, with the sensors of section 5.5 of the thesis."""

    wrenches: Array  # of a unit force along each jet
    properties: Array
    coefficients: Array
    translation: Array  # covariances
    rotation: Array
    clusters: Array
    thrusts: Array

    @property
    def information(self) -> Array:
        return blocks(np.linalg.inv(self.translation), np.linalg.inv(self.rotation))

    @property
    def whole(self) -> Array:
        """Y = blkdiag(Y_zeta, Y_z), shape (6, 6)."""
        return blocks(self.translation, self.rotation)

    @property
    def allowed(self) -> Array:
        """No jet ruled out by its sign."""
        return np.zeros(len(self.wrenches), dtype=bool)


def blocks(translation: Array, rotation: Array) -> Array:
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = translation, rotation
    return whole


@pytest.fixture(scope="module")
def case(orbiter: Vehicle) -> Case:
    wrenches, properties = unit_wrenches(orbiter), orbiter.nominal.vector()
    return Case(
        wrenches,
        properties,
        signatures(wrenches, properties, PERIOD_S),
        0.0344**2 / 6.0 * np.eye(3),  # ft^2/s^2
        1.52e-6**2 / 6.0 * np.eye(3),  # rad^2/s^2
        np.array([jet.cluster for jet in orbiter.jets]),
        np.array([jet.thrust for jet in orbiter.jets]),
    )


def judged(case: Case, innovation: Array, off: Array | None = None, on: Array | None = None) -> JetTests:
    """The certain tests of one innovation; no sign is ruled out unless said."""
    negative = case.allowed if off is None else off
    positive = case.allowed if on is None else on
    return jet_tests(case.coefficients, innovation, case.information, negative, positive)


def skewed_case(case: Case) -> Case:
    """The same with covariances that are neither diagonal nor equal."""
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(2, 3, 3)) + 2.0 * np.eye(3)
    return case._replace(
        translation=2e-4 * mixing[0] @ mixing[0].T / 5.0, rotation=4e-13 * mixing[1] @ mixing[1].T / 5.0
    )


def an_innovation(case: Case, seed: int = 2) -> Array:
    """Of the size of a soft failure plus noise."""
    noise = np.random.default_rng(seed).normal(size=6)
    return 20.0 * case.coefficients[17] + np.linalg.cholesky(case.whole) @ noise


# ------------------------------------------------------------------------------------------ signatures


def test_signatures_against_the_formula_jet_by_jet(case: Case, orbiter: Vehicle) -> None:
    mass_reciprocal, center = case.properties[9], case.properties[6:9]
    inverse_inertia = case.properties[ELEMENT]
    expected = []
    for jet in orbiter.jets:
        direction = np.array(jet.direction) / np.linalg.norm(jet.direction)
        turning = inverse_inertia @ np.cross(np.array(jet.position) - center, direction)
        expected.append(np.concatenate([mass_reciprocal * direction, turning]) * PERIOD_S)
    # torque about the center of mass is a difference of two moments twenty times larger at worst
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(case.coefficients / scale, expected / scale, atol=1e-13)


def test_signature_by_hand() -> None:
    # unit force along +y at (2, 0, 0), center of mass (0.5, 0, 0), I^-1 = diag(1, 2, 4), 1/m = 0.1, 0.5 s:
    # dv = 0.1 x 0.5 along y; dw = 4 x 1.5 x 0.5 about z
    wrench = np.array([[0.0, 0.0, 2.0, 0.0, 1.0, 0.0]])
    properties = pack(np.diag([1.0, 2.0, 4.0]), np.array([0.5, 0.0, 0.0]), 0.1)
    np.testing.assert_allclose(signatures(wrench, properties, 0.5), [[0.0, 0.05, 0.0, 0.0, 0.0, 3.0]], rtol=1e-15)


def test_products_of_inertia_mix_the_axes_of_a_signature() -> None:
    # torque 1 about x alone, I^-1_xz = 0.3 and I^-1_xy = 0.2
    inverse = np.array([[1.0, 0.2, 0.3], [0.2, 2.0, 0.4], [0.3, 0.4, 4.0]])
    wrench = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    result = signatures(wrench, pack(inverse, np.zeros(3), 0.1), 1.0)
    np.testing.assert_allclose(result, [[0.0, 0.0, 0.0, 1.0, 0.2, 0.3]], rtol=1e-15)


# --------------------------------------------------------------------------------------- certain tests


def test_magnitude_variance_and_likelihood_against_loops(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case)
    information = np.linalg.inv(case.whole)
    result = judged(case, innovation)
    for jet, c in enumerate(case.coefficients):
        strength = c @ information @ c
        np.testing.assert_allclose(result.magnitude[jet], c @ information @ innovation / strength, rtol=1e-9)
        np.testing.assert_allclose(result.variance[jet], 1.0 / strength, rtol=1e-10)
        likelihood = (c @ information @ innovation) ** 2 / strength
        # relative to what there is: a small argument is a difference of large terms
        total = innovation @ information @ innovation
        np.testing.assert_allclose(result.likelihood[jet], likelihood, rtol=1e-9, atol=1e-12 * total)
        np.testing.assert_allclose(result.unexplained[jet], total - likelihood, rtol=1e-9, atol=1e-12 * total)


def test_the_magnitude_is_the_weighted_least_squares_fit(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case)
    root = np.linalg.inv(np.linalg.cholesky(case.whole))
    result = judged(case, innovation)
    for jet in (0, 16, 28, 41):
        fitted, left, *_ = np.linalg.lstsq((root @ case.coefficients[jet])[:, None], root @ innovation, rcond=None)
        np.testing.assert_allclose(result.magnitude[jet], fitted[0], rtol=1e-9)
        np.testing.assert_allclose(result.unexplained[jet], left[0], rtol=1e-9)


def test_a_failure_without_noise_is_measured_exactly_and_leaves_nothing(case: Case) -> None:
    for jet, force in ((28, 868.819), (10, -874.185), (23, 10.4)):
        result = judged(case, force * case.coefficients[jet])
        np.testing.assert_allclose(result.magnitude[jet], force, rtol=1e-12)
        assert result.likelihood.argmax() == jet
        # rounding of the difference of two equal arguments
        assert abs(result.unexplained[jet]) < 1e-12 * result.likelihood[jet]


def test_a_jet_that_is_off_cannot_have_lost_thrust(case: Case) -> None:
    innovation = an_innovation(case)
    free = judged(case, innovation)
    off = np.arange(len(case.wrenches)) % 2 == 0
    ruled = judged(case, innovation, off=off)
    out = off & (free.magnitude < 0.0)
    assert 5 < out.sum() < 20  # the case shows something
    assert not ruled.magnitude[out].any()
    assert not ruled.likelihood[out].any()
    total = innovation @ np.linalg.inv(case.whole) @ innovation
    np.testing.assert_allclose(ruled.unexplained[out], total, rtol=1e-12)
    for kept, known in zip(ruled, free, strict=True):
        np.testing.assert_array_equal(kept[~out], known[~out])
    np.testing.assert_array_equal(ruled.variance, free.variance)


def test_the_mirror_rule_is_the_sign_rule_of_the_opposite_innovation(case: Case) -> None:
    innovation = an_innovation(case)
    on = np.arange(len(case.wrenches)) % 3 == 0
    mirrored, ruled = judged(case, -innovation, on=on), judged(case, innovation, off=on)
    assert (judged(case, innovation).magnitude[on] < 0.0).any()
    np.testing.assert_array_equal(mirrored.magnitude, -ruled.magnitude)
    np.testing.assert_array_equal(mirrored.likelihood, ruled.likelihood)
    np.testing.assert_array_equal(mirrored.unexplained, ruled.unexplained)


# ------------------------------------------------------------------------------------ uncertain tests


def uncertainty(case: Case, fraction: float = 0.02) -> tuple[Array, float]:
    """S with correlations, and the variance of 1/m, of estimates known to a fraction."""
    rng = np.random.default_rng(3)
    deviation = fraction * np.array([*case.properties[:3], 3e-8, 3e-8, 3e-8, 30.0, 3.0, 3.0])
    mixing = np.eye(9) + 0.3 * rng.normal(size=(9, 9))
    correlation = mixing @ mixing.T
    size = np.sqrt(np.diag(correlation))
    return correlation / np.outer(size, size) * np.outer(deviation, deviation), (5 * fraction * case.properties[9]) ** 2


def judged_again(
    case: Case,
    innovation: Array,
    state_covariance: Array,
    mass_variance: float,
    off: Array | None = None,
    cross: Array | None = None,
) -> JetTests:
    negative = case.allowed if off is None else off
    return uncertain_jet_tests(
        judged(case, innovation, off),
        innovation,
        case.whole,
        UncertainSignatures(
            case.coefficients,
            case.wrenches * PERIOD_S,
            case.properties,
            joint_covariance(state_covariance, mass_variance),
            np.zeros((6, 10)) if cross is None else cross,
        ),
        Signs(negative, case.allowed),
    )


def test_certain_estimates_leave_the_tests_as_they_are(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case)
    off = np.arange(len(case.wrenches)) % 2 == 0
    certain = judged(case, innovation, off)
    again = judged_again(case, innovation, np.zeros((9, 9)), 0.0, off)
    total = innovation @ np.linalg.inv(case.whole) @ innovation
    np.testing.assert_allclose(again.magnitude, certain.magnitude, rtol=1e-9)
    np.testing.assert_allclose(again.variance, certain.variance, rtol=1e-9)
    np.testing.assert_allclose(again.likelihood, certain.likelihood, atol=1e-9 * total)
    np.testing.assert_allclose(again.unexplained, certain.unexplained, atol=1e-9 * total)


def test_uncertain_tests_against_the_full_form_jet_by_jet(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case) * 10.0
    covariance, mass_variance = uncertainty(case)
    certain = judged(case, innovation)
    result = judged_again(case, innovation, covariance, mass_variance)
    plain = innovation @ np.linalg.inv(case.whole) @ innovation
    for jet, (wrench, c) in enumerate(zip(case.wrenches, case.coefficients, strict=True)):
        force = certain.magnitude[jet]
        h = rate_increment_jacobian(case.properties[:9], wrench[:3] * PERIOD_S, wrench[3:] * PERIOD_S)
        push = wrench[3:] * PERIOD_S
        grown = case.whole + force**2 * blocks(mass_variance * np.outer(push, push), h @ covariance @ h.T)
        information = np.linalg.inv(grown)
        strength = c @ information @ c
        magnitude = c @ information @ innovation / strength
        left = innovation @ information @ innovation - magnitude**2 * strength
        likelihood = plain - left - np.log(np.linalg.det(grown @ np.linalg.inv(case.whole)))
        np.testing.assert_allclose(result.magnitude[jet], magnitude, rtol=1e-8)
        np.testing.assert_allclose(result.variance[jet], 1.0 / strength, rtol=1e-8)
        np.testing.assert_allclose(result.unexplained[jet], left, rtol=1e-8, atol=1e-10 * plain)
        np.testing.assert_allclose(result.likelihood[jet], max(likelihood, 0.0), rtol=1e-8, atol=1e-10 * plain)


def test_signs_that_are_ruled_out_stay_so_when_signatures_are_uncertain(case: Case) -> None:
    innovation = an_innovation(case)
    off = np.ones(len(case.wrenches), dtype=bool)
    out = judged(case, innovation).magnitude < 0.0
    again = judged_again(case, innovation, *uncertainty(case), off)
    assert 5 < out.sum() < 40
    assert not again.magnitude[out].any()
    assert not again.likelihood[out].any()
    total = innovation @ np.linalg.inv(case.whole) @ innovation
    np.testing.assert_allclose(again.unexplained[out], total, rtol=1e-12)
    assert (again.likelihood >= 0.0).all()


def test_estimates_that_are_off_take_the_neighbor_only_without_their_uncertainty(case: Case) -> None:
    # jet 29 sticks on while the arms of the aft jets are believed 1.08 ft too short: jet 30, as far behind
    # jet 29, then seems to have the true arm
    believed = case.properties.copy()
    believed[6] -= 1.08
    off_by = case._replace(properties=believed, coefficients=signatures(case.wrenches, believed, PERIOD_S))
    innovation = 868.8 * case.coefficients[28]
    off = np.ones(len(case.wrenches), dtype=bool)
    wrong = isolate(judged(off_by, innovation, off).likelihood, case.clusters)
    assert wrong.cluster == 12
    assert wrong.jet != 28
    assert wrong.jet_margin > 6.0
    spread = np.zeros((9, 9))
    spread[6, 6] = 1.08**2
    aware = judged_again(off_by, innovation, spread, 0.0, off)
    cautious = isolate(aware.likelihood, case.clusters)
    assert cautious.cluster == 12
    assert cautious.cluster_margin > 6.0
    assert cautious.jet_margin < 6.0
    # 1.08 ft is 1 sigma: the true jet is among those that explain it
    assert aware.unexplained[28] < 20.5
    assert judged(off_by, innovation, off).unexplained[28] > 20.5


def test_jacobians_are_those_of_the_rotation_filter(case: Case) -> None:
    result = rate_increment_jacobians(case.properties, case.wrenches * PERIOD_S)
    for jet, impulse in enumerate(case.wrenches * PERIOD_S):
        expected = rate_increment_jacobian(case.properties[:9], impulse[:3], impulse[3:])
        np.testing.assert_allclose(result[jet], expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max(axis=0).min())


def test_a_signature_moves_with_the_estimates_by_its_jacobian(case: Case) -> None:
    # the signature is bilinear in inverse inertia and center of mass: central differences are exact
    jacobian = rate_increment_jacobians(case.properties, case.wrenches * PERIOD_S)
    for element in range(9):
        size = 0.5 * np.abs(case.properties[element])
        sides = []
        for sign in (1.0, -1.0):
            moved = case.properties.copy()
            moved[element] += sign * size
            sides.append(signatures(case.wrenches, moved, PERIOD_S)[:, 3:])
        slope = (sides[0] - sides[1]) / (2.0 * size)
        np.testing.assert_allclose(slope, jacobian[:, :, element], atol=1e-12 * np.abs(sides[0]).max() / size)


# ----------------------------------------------------------------------------------------- symmetries


def test_permuting_the_jets_permutes_the_answer(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case)
    covariance, mass_variance = uncertainty(case)
    off = np.arange(len(case.wrenches)) % 2 == 0
    order = np.random.default_rng(4).permutation(len(case.wrenches))
    shuffled = case._replace(wrenches=case.wrenches[order], clusters=case.clusters[order])
    shuffled = shuffled._replace(coefficients=signatures(shuffled.wrenches, case.properties, PERIOD_S))
    plain = judged_again(case, innovation, covariance, mass_variance, off)
    permuted = judged_again(shuffled, innovation, covariance, mass_variance, off[order])
    for ours, theirs in zip(plain, permuted, strict=True):
        # sums run in another order
        np.testing.assert_allclose(theirs, ours[order], rtol=1e-10, atol=1e-10 * np.abs(ours).max())
    found, again = isolate(plain.likelihood, case.clusters), isolate(permuted.likelihood, shuffled.clusters)
    assert order[again.jet] == found.jet
    assert again.cluster == found.cluster
    np.testing.assert_allclose(again[2:], found[2:], rtol=1e-8)


def test_units_change_magnitudes_only(case: Case) -> None:
    case = skewed_case(case)
    innovation = an_innovation(case)
    covariance, mass_variance = uncertainty(case)
    length, mass = 0.3048, 14.59390  # m per ft, kg per slug
    force = mass * length  # N per lbf: 4.448221, as the rounded tables have it
    inertia = mass * length**2
    scale = np.array([1.0 / inertia] * 6 + [length] * 3)
    wrenches = case.wrenches * np.array([length] * 3 + [1.0] * 3)  # torque of a unit force, and its direction
    properties = case.properties * np.append(scale, 1.0 / mass)
    si = Case(
        wrenches,
        properties,
        signatures(wrenches, properties, PERIOD_S),
        case.translation * length**2,
        case.rotation,
        case.clusters,
        case.thrusts * force,
    )
    moved = innovation * np.array([length] * 3 + [1.0] * 3)
    for ours, theirs in (
        (judged(case, innovation), judged(si, moved)),
        (
            judged_again(case, innovation, covariance, mass_variance),
            judged_again(si, moved, covariance * np.outer(scale, scale), mass_variance / mass**2),
        ),
    ):
        top = ours.likelihood.max()
        np.testing.assert_allclose(theirs.likelihood, ours.likelihood, atol=1e-9 * top)
        np.testing.assert_allclose(theirs.unexplained, ours.unexplained, atol=1e-9 * top)
        np.testing.assert_allclose(theirs.magnitude, ours.magnitude * force, rtol=1e-8)
        np.testing.assert_allclose(theirs.variance, ours.variance * force**2, rtol=1e-9)


# ------------------------------------------------------------------------------------------ isolation


def test_isolation_compares_clusters_first_and_then_the_jets_in_one() -> None:
    likelihood = np.array([3.0, 10.0, 40.0, 31.0, 2.0, 25.0])
    clusters = np.array([1, 1, 7, 7, 7, 4])
    # cluster 7 leads cluster 4 by 40 - 25, its first jet the second by 40 - 31
    assert isolate(likelihood, clusters) == Isolation(jet=2, cluster=7, cluster_margin=15.0, jet_margin=9.0)


def test_a_jet_alone_in_its_cluster_leads_it_by_all_it_has() -> None:
    found = isolate(np.array([3.0, 12.0, 5.0]), np.array([1, 2, 1]))
    assert found == Isolation(jet=1, cluster=2, cluster_margin=7.0, jet_margin=12.0)


def test_a_tie_leaves_no_margin() -> None:
    within = isolate(np.array([20.0, 20.0, 1.0]), np.array([1, 1, 2]))
    assert (within.cluster, within.cluster_margin, within.jet_margin) == (1, 19.0, 0.0)
    between = isolate(np.array([20.0, 1.0, 20.0]), np.array([1, 1, 2]))
    assert (between.cluster_margin, between.jet_margin) == (0.0, 19.0)


def test_one_cluster_alone_leads_by_all_it_has() -> None:
    assert isolate(np.array([9.0, 2.0]), np.array([3, 3])) == Isolation(0, 3, 9.0, 7.0)


def test_nothing_seen_leads_by_nothing() -> None:
    found = isolate(np.zeros(4), np.array([1, 1, 2, 2]))
    assert found[2:] == (0.0, 0.0)


# ----------------------------------------------------------------- separations of the thesis reference


def cluster_lead(likelihood: Array, clusters: Array, cluster: int) -> int:
    """The cluster of the largest argument outside a cluster."""
    elsewhere = np.where(clusters == cluster, -1.0, likelihood)
    return int(clusters[elsewhere.argmax()])


# Table 5-2 truth, Y of section 5.5, whole-interval failure, all jets off, no noise; reference section 6, each
# number to half its last printed digit
@pytest.mark.parametrize(
    ("number", "force", "statistic", "within", "between", "next_cluster", "deviation"),
    [
        (29, 868.819, (8.07e5, 0.005e5), (289.0, 0.5), (17_800.0, 50.0), 7, 0.97),
        (39, 24.483, (1121.0, 0.5), (2.8, 0.05), (582.0, 0.5), 2, 0.73),
        (24, 0.015 * 691.018, (260.0, 0.5), (0.04, 0.005), (81.0, 0.5), 8, 0.64),
        (27, 10.0, (7.7, 0.05), None, (0.11, 0.005), 8, None),
    ],
)
def test_separations_of_the_thesis(
    case: Case,
    number: int,
    force: float,
    statistic: tuple[float, float],
    within: tuple[float, float] | None,
    between: tuple[float, float],
    next_cluster: int,
    deviation: float | None,
) -> None:
    jet = number - 1
    off = np.ones(len(case.wrenches), dtype=bool)
    result = judged(case, force * case.coefficients[jet], off)
    found = isolate(result.likelihood, case.clusters)
    assert (found.jet, found.cluster) == (jet, case.clusters[jet])
    assert abs(result.likelihood[jet] - statistic[0]) <= statistic[1]
    assert abs(found.cluster_margin - between[0]) <= between[1]
    assert cluster_lead(result.likelihood, case.clusters, found.cluster) == next_cluster
    if within is not None:
        assert abs(found.jet_margin - within[0]) <= within[1]
    if deviation is not None:
        assert abs(np.sqrt(result.variance[jet]) - deviation) <= 0.005


def test_the_neighbors_that_compete_are_those_of_the_thesis(case: Case) -> None:
    off = np.ones(len(case.wrenches), dtype=bool)

    def ranking(number: int, force: float) -> list[int]:
        result = judged(case, force * case.coefficients[number - 1], off)
        return (np.argsort(-result.likelihood)[:4] + 1).tolist()

    assert ranking(29, 868.819)[:2] == [29, 30]
    assert ranking(39, 24.483)[:2] == [39, 9]
    assert ranking(24, 10.4) == [24, 25, 26, 42]
    # a leak of jet 27 looks like one of 2.5 lbf in cluster 8 or of 1.3 lbf in cluster 5
    result = judged(case, 10.0 * case.coefficients[26], off)
    best = {cluster: np.where(case.clusters == cluster, result.likelihood, -1.0).argmax() for cluster in (5, 8)}
    assert abs(result.magnitude[best[8]] - 2.5) <= 0.05
    assert abs(result.magnitude[best[5]] - 1.3) <= 0.05


def test_the_opposing_jet_firing_narrows_the_lead_of_a_stuck_jet(case: Case) -> None:
    # jet 17 is on, so that it may have failed off: the lead over cluster 8 is 32.8
    off = np.ones(len(case.wrenches), dtype=bool)
    off[16] = False
    result = judged(case, 868.819 * case.coefficients[28], off)
    found = isolate(result.likelihood, case.clusters)
    assert found.jet == 28
    assert abs(found.cluster_margin - 32.8) <= 0.05
    assert cluster_lead(result.likelihood, case.clusters, 12) == 8
    assert result.magnitude[16] < -800.0


@pytest.mark.parametrize("with_the_other", [True, False])
def test_a_stuck_off_jet_stands_out_from_its_neighbor(case: Case, *, with_the_other: bool) -> None:
    off = np.ones(len(case.wrenches), dtype=bool)
    off[10] = False
    off[11] = not with_the_other
    result = judged(case, -874.185 * case.coefficients[10], off)
    found = isolate(result.likelihood, case.clusters)
    assert found.jet == 10
    assert abs(result.likelihood[10] - 1.08e6) <= 0.005e6
    assert abs(found.cluster_margin - 1940.0) <= 5.0
    assert cluster_lead(result.likelihood, case.clusters, 5) == 2
    assert abs(np.sqrt(result.variance[10]) - 0.84) <= 0.005
    expected, tolerance = (2.0e4, 0.05e4) if with_the_other else (1.08e6, 0.005e6)
    assert abs(found.jet_margin - expected) <= tolerance


# -------------------------------------------------------------------------------------- laws of chance

SAMPLES = 20_000
SOFT = 23  # jet 24, told apart from noise at a few pounds: 1-sigma 0.64 lbf


class Draws(NamedTuple):
    """Tests of many innovations that hold noise alone, no sign ruled out."""

    likelihood: Array  # (SAMPLES, n_jets)
    magnitude: Array
    unexplained: Array


@pytest.fixture(scope="module")
def quiet(case: Case) -> Draws:
    rng = np.random.default_rng(5)
    noise = rng.normal(size=(SAMPLES, 6)) @ np.linalg.cholesky(case.whole).T
    information, allowed = case.information, case.allowed
    tests = [jet_tests(case.coefficients, e, information, allowed, allowed) for e in noise]
    return Draws(*(np.array([getattr(test, name) for test in tests]) for name in Draws._fields))


@pytest.mark.parametrize("jet", [0, 14, 23, 28, 38])
def test_without_a_failure_the_statistic_of_one_jet_is_chi_square(quiet: Draws, jet: int) -> None:
    # under the null hypothesis a p-value below 1e-3 comes once in a thousand seeds; this seed is fixed
    assert kstest(quiet.likelihood[:, jet], chi2(1).cdf).pvalue > 1e-3
    # and what the jet leaves of a six-dimensional innovation has five degrees of freedom
    assert kstest(quiet.unexplained[:, jet], chi2(5).cdf).pvalue > 1e-3


def test_without_a_failure_magnitudes_are_unbiased_with_their_variance(quiet: Draws, case: Case) -> None:
    variance = judged(case, case.coefficients[0]).variance
    # mean: standard error sigma / sqrt(n); variance: relative standard error sqrt(2 / n); the largest of 44
    # jets, far from independent, stays within 4 of them
    mean = quiet.magnitude.mean(axis=0) / np.sqrt(variance / SAMPLES)
    assert np.abs(mean).max() < 4.0
    spread = quiet.magnitude.var(axis=0) / variance - 1.0
    assert np.abs(spread).max() < 4.0 * np.sqrt(2.0 / SAMPLES)


def test_the_sign_rule_silences_a_jet_half_of_the_time(quiet: Draws) -> None:
    low, high = binom.interval(0.999, SAMPLES, 0.5)
    assert low <= (quiet.magnitude[:, SOFT] < 0.0).sum() <= high


def test_alarms_of_all_jets_together_are_as_rare_as_the_reference_says(quiet: Draws, case: Case) -> None:
    # with all jets off: the largest of 44 exceeds 6.63 in 4.8 % of samples, and a cluster leads by six in
    # 0.15 %; 99.9 % intervals for the rates at the edges of the printed digits
    likelihood = np.where(quiet.magnitude < 0.0, 0.0, quiet.likelihood)
    exceeding = (likelihood.max(axis=1) > 6.63).sum()
    assert binom.ppf(0.0005, SAMPLES, 0.0475) <= exceeding <= binom.ppf(0.9995, SAMPLES, 0.0485)
    leading = sum(isolate(row, case.clusters).cluster_margin > 6.0 for row in likelihood[likelihood.max(axis=1) > 6.0])
    assert binom.ppf(0.0005, SAMPLES, 0.00145) <= leading <= binom.ppf(0.9995, SAMPLES, 0.00155)


@pytest.mark.parametrize("deviations", [1.0, 2.5, 4.0])
def test_a_failure_is_detected_as_often_as_the_noncentral_law_says(quiet: Draws, case: Case, deviations: float) -> None:
    # tests are linear: a failure of f adds f to the estimated magnitude of its jet, and the noise stays
    variance = judged(case, case.coefficients[SOFT]).variance[SOFT]
    force = deviations * np.sqrt(variance)
    # the shift itself is the module's answer to the failure alone
    shift = judged(case, force * case.coefficients[SOFT]).magnitude[SOFT]
    likelihood = (quiet.magnitude[:, SOFT] + shift) ** 2 / variance
    detected = (likelihood > 6.63).sum()
    expected = ncx2.sf(6.63, 1, deviations**2)
    low, high = binom.interval(0.999, SAMPLES, expected)
    assert low <= detected <= high


def test_a_failure_in_noise_is_measured_without_bias(case: Case) -> None:
    rng = np.random.default_rng(6)
    count, force, jet = 1000, 10.4, SOFT
    noise = rng.normal(size=(count, 6)) @ np.linalg.cholesky(case.whole).T
    tests = [judged(case, force * case.coefficients[jet] + e) for e in noise]
    magnitude = np.array([test.magnitude[jet] for test in tests])
    variance = tests[0].variance[jet]
    assert abs(magnitude.mean() - force) < 3.5 * np.sqrt(variance / count)
    assert abs(magnitude.var() / variance - 1.0) < 3.5 * np.sqrt(2.0 / count)
    likelihood = np.array([test.likelihood[jet] for test in tests])
    assert kstest(likelihood, ncx2(1, force**2 / variance).cdf).pvalue > 1e-3
    # what the cause leaves unexplained does not depend on how large it is
    assert kstest(np.array([test.unexplained[jet] for test in tests]), chi2(5).cdf).pvalue > 1e-3


def test_what_a_jet_leaves_unexplained_is_chi_square_for_uncertain_estimates_too(case: Case) -> None:
    # the estimates are drawn around the truth by their covariance, 2 % of them, the innovation comes from the
    # truth: 868.8 lbf of jet 29 then miss the signature by many sigma of the sensors
    rng = np.random.default_rng(7)
    count, force, jet = 600, 868.8, 28
    covariance, mass_variance = uncertainty(case)
    deviation = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(deviation, deviation))
    left, naive, error = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        believed = case.properties.copy()
        believed[:9] += deviation * (root @ rng.normal(size=9))
        believed[9] += np.sqrt(mass_variance) * rng.normal()
        mistaken = case._replace(properties=believed, coefficients=signatures(case.wrenches, believed, PERIOD_S))
        innovation = force * case.coefficients[jet] + np.linalg.cholesky(case.whole) @ rng.normal(size=6)
        result = judged_again(mistaken, innovation, covariance, mass_variance)
        left[k] = result.unexplained[jet]
        error[k] = (result.magnitude[jet] - force) / np.sqrt(result.variance[jet])
        naive[k] = judged(mistaken, innovation).unexplained[jet]
    assert kstest(left, chi2(5).cdf).pvalue > 1e-3
    # the magnitude's own variance holds as well: mean square 1 within 3.5 standard errors sqrt(2 / n)
    assert abs((error**2).mean() - 1.0) < 3.5 * np.sqrt(2.0 / count)
    assert naive.mean() > 100.0  # with the estimates taken as certain, it would not pass as the cause
