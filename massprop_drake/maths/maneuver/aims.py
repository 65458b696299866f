r"""Aims of a maneuver, and the distance of a course of commands from them.

With M what is known of the parameters before, G what the course shows (`information`), C = (M + G)^-1 without forces,
and e a combination of parameters, its 1-sigma is (e^T C e)^1/2. A force f of a jet j that leaks is told from what jet k
would do instead when its expected log likelihood ratio, with everything else free,

    delta = 1/2 f^2 (S_jj - max(S_jk, 0)^2 / S_kk),    S = G_ff - G_f C G_f^T,

is as large as the doubt that may be left asks for. From nothing at all it is told when

    delta = 1/2 f^2 S_jj - 1/2 log(1 + F^2 S_jj)

is, with F the most that the force might have been; that a jet fails at all is unlikely besides. A jump of the
mass properties may explain the leak as well; in units of what is expected of one it leads nothing by

    1/2 f^2 S_ju (1 + S_uu)^-1 S_uj - 1/2 log det(1 + S_uu),

which is taken off. In all a ratio says how far there is to go: 1-sigma over the wanted one, and (wanted delta over
delta)^1/2, which falls with firing like a 1-sigma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.estimation.joint.screen import maximize_likelihood
from massprop_drake.maths.linear_algebra import Array, scaled_root

_TINY = float(np.finfo(np.float64).tiny)
FOLLOWED = 3  # samples that a detector takes at least, to follow what it proposes: compute budget
_NOTHING = 1e-9  # nats: two that nothing tells apart; so that their ratio is a number


class Aims(NamedTuple):
    """Targets of a maneuver: 1-sigmas of parameters, and failures to be told apart.

    Attributes:
        combinations: e of each, of all parameters without forces, shape (n, n_known).
        deviations: 1-sigma of each that is wanted, shape (n,).
        pairs: failures of each pair that is to be told apart, j and k, as `bound.advance_force_effects` orders them,
            k = -1: j is to be told from what is no failure, integers, shape (p, 2).
        forces: of j, lbf or N, shape (p,).
        most: that it might have been, lbf or N, shape (p,).
        odds: delta that is wanted, nats, shape (p,).
        jumps: variances of jumps of the mass properties, see `hypotheses.jump_variances`; none: they are not weighed.
        jump: log probability of each, nats.
    """

    combinations: Array
    deviations: Array
    pairs: np.ndarray
    forces: Array
    most: Array
    odds: Array
    jumps: Array = np.zeros((0, N_PROPERTIES))
    jump: float = -math.inf


class Known(NamedTuple):
    """Information on the parameters before a maneuver.

    Attributes:
        information: M of the parameters that are not known exactly, shape (n, n).
        of: which these are, integers, shape (n,).
    """

    information: Array
    of: np.ndarray


class Reached(NamedTuple):
    """Precision that a course reaches, compared with the aims.

    Attributes:
        deviations: 1-sigma of each combination, shape (n,).
        deltas: of each pair, nats, shape (p,).
        ratios: of all, combinations first; none above 1: all is reached, shape (n + p,).
    """

    deviations: Array
    deltas: Array
    ratios: Array

    @property
    def shortfall(self) -> float:
        """Sum of the logs of all ratios of reached to wanted precision above 1; zero: all aims are reached."""
        return float(np.log(np.maximum(self.ratios, 1.0)).sum())


def compare_with_aims(information: Array, prior: Known, aims: Aims) -> Reached:
    """Computes 1-sigmas and failure separations from a course's information, and their ratios to the aims.

    Args:
        information: G with forces, see `information.FollowedCourse`, shape (k, k).
    """
    of, first = prior.of, aims.combinations.shape[1]
    total = prior.information + information[np.ix_(of, of)]
    root, size = scaled_root(total)
    half = np.linalg.solve(root, (aims.combinations[:, of] * size).T)
    deviations = np.sqrt(np.sum(half * half, axis=0))
    ratios = [deviations / aims.deviations]
    deltas = np.zeros(0)
    if aims.pairs.size > 0:
        by_forces = np.linalg.solve(root, size.reshape(-1, 1) * information[of][:, first:])
        left = information[first:, first:] - by_forces.T @ by_forces
        own, other = aims.pairs.T
        another = expected_llr_other_jet(left[own, own], left[own, other], left[other, other], aims.forces)
        nothing = expected_llr_no_failure(left[own, own], aims.forces, aims.most)
        if aims.jumps.size:
            nothing -= np.logaddexp(0.0, aims.jump + expected_llr_jumps(left, own, aims.forces, aims.jumps))
        deltas = np.maximum(np.where(other < 0, nothing, another), _NOTHING)
        ratios.append(np.sqrt(aims.odds / deltas))
    return Reached(deviations, deltas, np.concatenate(ratios))


def expected_llr_other_jet(own_info: Array, cross_info: Array, other_info: Array, force: Array | float) -> Array:
    """Computes the expected log likelihood ratio of a jet's failure to the best-fitting other jet's, nats.

    No jet gives less than nothing: where the other would have to, no force at all suits best.

    Args:
        own_info, cross_info, other_info: S_jj, S_jk and S_kk, of shapes that fit.
        force: f, lbf or N.
    """
    return 0.5 * force**2 * (own_info - np.maximum(cross_info, 0.0) ** 2 / np.maximum(other_info, _TINY))


def expected_llr_no_failure(information: Array, force: Array | float, largest_force: Array | float) -> Array:
    """Computes the expected log likelihood ratio of a failure of unknown force to no failure, nats."""
    return 0.5 * force**2 * information - 0.5 * np.log1p(largest_force**2 * np.maximum(information, 0.0))


def expected_llr_jumps(information: Array, failures: np.ndarray, force: Array, variances: Array) -> Array:
    """Computes log likelihood ratios of mass-property jumps to no fault, where jets fail, nats, shape (p,).

    Args:
        information: S, jumps last, in units of the largest, shape (f, f).
        failures: failures, integers, shape (p,).
        force: f of each, lbf or N, shape (p,).
        variances: see `hypotheses.jump_variances`.
    """
    jumps = slice(-variances.shape[1], None)
    leads = maximize_likelihood(
        information[jumps, jumps], (force * information[jumps, failures]).T, variances[:, None]
    )[0]
    found: Array = np.logaddexp.reduce(leads, axis=0)
    return found
