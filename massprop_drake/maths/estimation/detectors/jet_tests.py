r"""Jet-failure detection and isolation by the constrained generalized likelihood ratio (CGLR).

A jet that gives f more force than it was told to, along its direction d, adds f c to the innovations,

    c = [ d / m ; I^-1 (r' - r_cm) x d ] dt                                       (4-12),

translation first. From one sample's innovations e with covariance Y = blkdiag(Y_zeta, Y_z), for every jet,

    f = c^T Y^-1 e / (c^T Y^-1 c)   (4-25),     l = (c^T Y^-1 e)^2 / (c^T Y^-1 c)   (4-28),

constrained in sign: a jet that is off cannot lose thrust. The jet is found in two steps, the cluster
and the jet in it, each by a margin of six: twice a log-likelihood ratio of twenty to one.

The signature c follows from estimates, so it is itself uncertain: of its error the innovations have f J_j dx, with
dx the error of the ten parameters, of covariance Sigma, J_j = [0, d dt; H_j, 0] and H_j = H((r' x d) dt, d dt).
It adds to what the same dx does to them through the commanded jets. With Gamma = cov(e, dx) of a healthy sample the
covariance under the hypothesis of jet j is

    Y_j = Y + f (Gamma J_j^T + J_j Gamma^T) + f^2 J_j Sigma J_j^T,

less than Y where a jet that was told to fire does not. What the jet leaves unexplained is
g = e^T Y_j^-1 e - (c^T Y_j^-1 e)^2 / (c^T Y_j^-1 c), chi-square with five degrees of freedom if it is the cause, and
its likelihood argument against no failure

    l = e^T Y^-1 e - g - ln(|Y_j| / |Y|),

which is (4-28) when c is certain.

Source: D. R. Levy, MIT S.M. thesis, 1983, chapter 4; the uncertainty of the signature is our own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.detector import Evidence
from massprop_drake.maths.estimation.filters.rate_increments import rate_increment_jacobians
from massprop_drake.maths.kernels import idiom, kernel, numbers, select_where, take_elements
from massprop_drake.maths.linear_algebra import (
    Array,
    NotPositiveDefiniteError,
    deviations,
    inverse_positive_definite,
    inverses,
    log_determinants,
    quadratic_form,
    stack_times,
    stack_times_stack,
    stack_times_vector,
    stack_times_vectors,
    times_stack,
)
from massprop_drake.maths.mass_properties import ELEMENT, N_ROTATION, is_converged

_WHAT = "the detector's innovation covariance"


class JetTests(NamedTuple):
    """The test of every jet on one sample.

    Attributes:
        magnitude: f, lbf or N, signed: negative is missing thrust; shape (n_jets,).
        variance: of f if the jet is the cause, shape (n_jets,).
        likelihood: argument l; zero where the sign rules the jet out, shape (n_jets,).
        unexplained: g, what the jet leaves of e^T Y^-1 e, shape (n_jets,).
    """

    magnitude: Array
    variance: Array
    likelihood: Array
    unexplained: Array


@kernel
def is_testable(evidence: Evidence, limits: Array) -> bool:
    """Tests whether a sample can be tested for failures: steady jets, innovations there, filters converged.

    Args:
        limits: of convergence, see `mass_properties.is_converged`, shape (3,).
    """
    innovation = evidence.innovation
    if not (evidence.usable and math.isfinite(innovation[0]) and math.isfinite(innovation[3])):
        return False
    return is_converged(deviations(evidence.estimate_covariance), evidence.estimate, limits)


@kernel
def information(covariance: Array, coupled: bool) -> Array:
    """Computes the inverse of the covariance of both filters' innovations, shape (6, 6).

    Args:
        covariance: Y, shape (6, 6).
        coupled: whether its blocks off the diagonal are not zero.

    Raises:
        NotPositiveDefiniteError: when it is not positive definite.
    """
    if coupled:
        return _inverse(covariance)
    inverse = np.zeros((6, 6))
    inverse[:3, :3] = inverse_positive_definite(covariance[:3, :3], _WHAT)
    inverse[3:, 3:] = inverse_positive_definite(covariance[3:, 3:], _WHAT)
    return inverse


def _plain_inverse(covariance):  # type: ignore[no-untyped-def] # compiled alone
    """Inverts a matrix in compiled code, without the scaling of `_inverse`."""
    return np.linalg.inv(covariance)


@idiom(_plain_inverse)
def _inverse(covariance: Array) -> Array:
    """Inverts a covariance matrix of any size, scaled to a unit diagonal on the way."""
    scale = np.sqrt(covariance.diagonal())
    try:
        factor = np.linalg.cholesky(covariance / (scale[:, None] * scale))
    except np.linalg.LinAlgError:
        raise NotPositiveDefiniteError(covariance, _WHAT) from None
    half = np.linalg.inv(factor) / scale
    result: Array = half.T @ half
    return result


@kernel
def signatures(unit_wrenches: Array, mass_properties: Array, period_s: float) -> Array:
    """Computes each jet's effect c on the innovations per unit force (4-12), translation first, shape (n_jets, 6).

    Args:
        unit_wrenches: torque about the vehicle origin and force of a unit force along each jet, shape
            (n_jets, 6).
        mass_properties: the ten parameters, shape (10,).
        period_s: sample period, s.
    """
    directions = unit_wrenches[:, 3:]
    result = np.empty((unit_wrenches.shape[0], 6))
    result[:, :3] = directions * (mass_properties[9] * period_s)
    x, y, z = numbers(mass_properties[6:9] * period_s, 3)
    arm = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # transpose of [r_cm x] dt
    torque = unit_wrenches[:, :3] * period_s - np.dot(directions, arm)
    result[:, 3:] = np.dot(torque, take_elements(mass_properties, ELEMENT))
    return result


@kernel
def jet_tests(
    jet_signatures: Array, innovation: Array, information: Array, impossible_negative: Array, impossible_positive: Array
) -> JetTests:
    """Tests each jet's failure against no failure; returns likelihood arguments and forces by jet.

    Args:
        jet_signatures: c of every jet, shape (n_jets, 6).
        innovation: e, translation first, shape (6,).
        information: inverse of Y, shape (6, 6).
        impossible_negative: jets that cannot have lost thrust, boolean, shape (n_jets,).
        impossible_positive: jets that cannot give too much, boolean, shape (n_jets,).
    """
    weighted = np.dot(jet_signatures, information)
    projection = np.dot(weighted, innovation)
    strength = (weighted * jet_signatures).sum(axis=1)
    magnitude = projection / strength
    likelihood = projection * magnitude
    ruled_out = (impossible_negative & (magnitude < 0.0)) | (impossible_positive & (magnitude > 0.0))
    magnitude[ruled_out] = 0.0
    likelihood[ruled_out] = 0.0
    total = quadratic_form(innovation, information)
    return JetTests(magnitude, 1.0 / strength, likelihood, total - likelihood)


class UncertainSignatures(NamedTuple):
    """Signatures of the jets, and the sources of their uncertainty.

    Attributes:
        coefficients: c of every jet, shape (n_jets, 6).
        impulses: angular about the vehicle origin and linear, of a unit force along each jet over a sample,
            shape (n_jets, 6).
        mass_properties: the ten parameters, shape (10,).
        covariance: Sigma, of their errors, shape (10, 10).
        cross_covariance: Gamma, of the innovations with these errors, shape (6, 10).
    """

    coefficients: Array
    impulses: Array
    mass_properties: Array
    covariance: Array
    cross_covariance: Array


@kernel
def uncertain_jet_tests(
    tests: JetTests,
    innovation: Array,
    covariance: Array,
    signatures: UncertainSignatures,
    impossible_negative: Array,
    impossible_positive: Array,
) -> JetTests:
    """Tests each jet's failure again, with its signature's uncertainty in the innovation covariance.

    Args:
        tests: the same sample's tests with certain signatures, whose magnitudes scale the uncertainty.
        innovation: e, translation first, shape (6,).
        covariance: Y, shape (6, 6).
        impossible_negative, impossible_positive: as in `jet_tests`.
    """
    failed_covariances = covariances_given_failure(tests.magnitude, covariance, signatures)
    # scaled: translation and rotation differ by many orders of magnitude
    scale = deviations(covariance)
    failed_covariances /= scale[:, None] * scale
    c, e = signatures.coefficients / scale, innovation / scale
    weight = inverses(failed_covariances)
    weighted_c, weighted_e = stack_times_vectors(weight, c), stack_times_vector(weight, e)
    projection = weighted_c @ e
    strength = (weighted_c * c).sum(axis=1)
    magnitude = projection / strength
    unexplained = weighted_e @ e - projection * magnitude
    growth = log_determinants(failed_covariances) - np.linalg.slogdet(covariance / (scale[:, None] * scale))[1]
    total = tests.unexplained + tests.likelihood
    likelihood = np.maximum(total - unexplained - growth, 0.0)
    ruled_out = (impossible_negative & (magnitude <= 0.0)) | (impossible_positive & (magnitude >= 0.0))
    magnitude[ruled_out] = 0.0
    likelihood[ruled_out] = 0.0
    return JetTests(magnitude, 1.0 / strength, likelihood, select_where(ruled_out, total, unexplained))


@kernel
def covariances_given_failure(forces: Array, covariance: Array, signatures: UncertainSignatures) -> Array:
    """Computes the innovation covariance Y_j under each jet's failure, shape (n_jets, 6, 6).

    Args:
        forces: f of each jet, lbf or N, shape (n_jets,).
        covariance: Y, shape (6, 6).
    """
    jacobians = np.zeros((forces.size, 6, N_ROTATION + 1))  # f_j J_j
    jacobians[:, :3, N_ROTATION] = signatures.impulses[:, 3:]
    jacobians[:, 3:, :N_ROTATION] = rate_increment_jacobians(signatures.mass_properties, signatures.impulses)
    jacobians *= forces.reshape((-1, 1, 1))
    transposed = jacobians.transpose((0, 2, 1))
    shared = times_stack(signatures.cross_covariance, transposed)
    own = stack_times_stack(stack_times(jacobians, signatures.covariance), transposed)
    return covariance + shared + shared.transpose((0, 2, 1)) + own


class Isolation(NamedTuple):
    """Outcome of the two steps of isolation (section 4.3 of the thesis).

    Attributes:
        jet: index of the jet of the largest argument.
        cluster: index of its cluster.
        cluster_margin: its argument minus the largest of any other cluster.
        jet_margin: its argument minus the largest of any other jet of the cluster.
    """

    jet: int
    cluster: int
    cluster_margin: float
    jet_margin: float


@kernel
def isolate(likelihood: Array, clusters: NDArray[np.int_]) -> Isolation:
    """Finds the likeliest jet and its cluster, and their margins over the next jet and the next cluster.

    Args:
        likelihood: argument of every jet, shape (n_jets,).
        clusters: index of each jet's cluster, shape (n_jets,).
    """
    jet = int(likelihood.argmax())
    largest = float(likelihood[jet])
    same = clusters == clusters[jet]
    elsewhere = likelihood[~same]
    same_cluster = select_where(same, likelihood, 0.0)
    same_cluster[jet] = 0.0
    elsewhere_most = float(elsewhere.max()) if elsewhere.size else 0.0
    return Isolation(jet, int(clusters[jet]), largest - elsewhere_most, largest - float(same_cluster.max()))
