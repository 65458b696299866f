r"""Detection of failed jets by cumulative sums (CUSUM), jet by jet: a baseline to compare others with.

Of each tested sample the innovations e with covariance Y are projected on each jet's signature c,

    z = c^T Y^-1 e / sqrt(c^T Y^-1 c),

standard normal while nothing fails. Two one-sided sums gather what points the same way,

    g+ <- max(0, g+ + z - k),    g- <- max(0, g- - z - k),

too much thrust and, in samples that the jet was told to fire in, too little; k is the drift. The largest sum above
the threshold h declares its jet, and all sums begin anew. Jets of its cluster whose sums are above the threshold as
well cannot be told from it. The magnitude is that of all samples since the sum was last zero,

    f = sum c^T Y^-1 e / sum c^T Y^-1 c.

Source: E. S. Page, Continuous inspection schemes, Biometrika 41, 1954; signatures as in `jet_tests`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Action
from massprop_drake.maths.estimation.detector import STATUS, Detector, Evidence, Judgment, KnownJets, Verdict
from massprop_drake.maths.estimation.detectors.jet_tests import information, is_testable, isolate, jet_tests, signatures
from massprop_drake.maths.estimation.detectors.known_forces import known_force
from massprop_drake.maths.linear_algebra import Array


class CusumParams(NamedTuple):
    """Parameters of the detector.

    Attributes:
        period_s, clusters, unit_wrenches, thrusts, limits: see `detector.KnownJets`.
        drift: k, in standard deviations of one sample.
        threshold: h, of a sum.
    """

    period_s: float
    clusters: NDArray[np.int_]
    unit_wrenches: Array
    thrusts: Array
    limits: Array
    drift: float
    threshold: float


class CusumState(NamedTuple):
    """State of the detector between samples; the first axis is the side, too much thrust and too little.

    Attributes:
        sums: g, shape (2, n_jets).
        projection, strength: gathered since the sum was last zero, shape (2, n_jets) each.
        onset_s: end of the sample at which it was last zero, s, shape (2, n_jets).
        force, variance, removed, closed: see `detector.Detector`.
    """

    sums: Array
    projection: Array
    strength: Array
    onset_s: Array
    force: Array
    variance: Array
    removed: Array
    closed: Array


LAYOUT = Layout(
    "cusum",
    sums=(2, "jets"),
    projection=(2, "jets"),
    strength=(2, "jets"),
    onset_s=(2, "jets"),
    force="jets",
    variance="jets",
    removed="jets",
    closed="jets",
)


def make_params(jets: KnownJets, options: Any) -> CusumParams:
    """Makes the CUSUM detector's parameters from the jets' data and a scenario's block `detector`."""
    return CusumParams(
        jets.period_s, jets.clusters, jets.unit_wrenches, jets.thrusts, jets.limits, options.drift, options.threshold
    )


def initial_state(n_jets: int) -> CusumState:
    """Returns the CUSUM detector's state with all sums zero and no known forces."""
    return CusumState(*np.zeros((4, 2, n_jets)), *np.zeros((4, n_jets)))


def judge(state: CusumState, evidence: Evidence, params: CusumParams) -> Judgment:
    """Adds a testable sample to the sums, and declares the jet of the largest one if above the threshold.

    Raises:
        NotPositiveDefiniteError: when an innovation covariance is not positive definite.
    """
    if not is_testable(evidence, params.limits):
        blank = np.full(params.clusters.size, np.nan)
        return Judgment(state, NO_ADAPTATION, STATUS.make(tested=0.0, alarm=0.0, detector_event=0.0), blank, blank)
    state = add_sample(state, evidence, params)
    likelihood = state.sums.max(axis=0)
    sides = state.sums.argmax(axis=0)
    every = np.arange(params.clusters.size)
    with np.errstate(invalid="ignore"):
        magnitude = np.where(likelihood > 0.0, state.projection[sides, every] / state.strength[sides, every], 0.0)
    isolation = isolate(likelihood, params.clusters)
    jet, side = isolation.jet, int(sides[isolation.jet])
    alarm = bool(likelihood[jet] > params.threshold)
    alike = (params.clusters == isolation.cluster) & (likelihood > params.threshold)
    status = STATUS.make(
        tested=1.0,
        alarm=alarm,
        detector_event=Verdict.DECLARED if alarm else Verdict.NOTHING,
        suspected_cluster=isolation.cluster,
        suspected_jet=jet,
        jet_isolated=alarm and int(alike.sum()) == 1,
        suspected_magnitude=float(magnitude[jet]),
        suspected_magnitude_std=float(state.strength[side, jet]) ** -0.5 if likelihood[jet] > 0.0 else 0.0,
        suspected_likelihood=float(likelihood[jet]),
        cluster_margin=isolation.cluster_margin,
        jet_margin=isolation.jet_margin,
        onset=float(state.onset_s[side, jet]),
        alarms=float(alarm),
    )
    if not alarm:
        return Judgment(state, NO_ADAPTATION, status, likelihood, magnitude)
    state = _declare_failure(state, alike, jet, float(magnitude[jet]), status.suspected_magnitude_std**2)
    adaptation = NO_ADAPTATION._replace(action=Action.REJECT)
    return Judgment(state, adaptation, status, likelihood, magnitude)


def add_sample(state: CusumState, evidence: Evidence, params: CusumParams) -> CusumState:
    """Returns the state with a sample added to each jet's sums; one that falls to zero has its onset reset."""
    never = np.zeros(params.clusters.size, dtype=bool)
    coefficients = signatures(params.unit_wrenches, evidence.estimate, params.period_s)
    inverse = information(evidence.covariance, evidence.coupled)
    tests = jet_tests(coefficients, evidence.innovation, inverse, never, never)
    strength = 1.0 / tests.variance
    normalized = tests.magnitude * np.sqrt(strength)
    # what is known to have failed already is not suspected again, and a jet that rests cannot give too little
    fresh = (state.removed == 0.0) & (state.variance == 0.0)
    counted = np.stack([fresh, fresh & (evidence.command > 0.0)])
    step = np.stack([normalized, -normalized]) - params.drift
    sums = np.where(counted, np.maximum(state.sums + step, 0.0), state.sums)
    begun = sums > 0.0
    return state._replace(
        sums=sums,
        projection=np.where(begun, state.projection + counted * (tests.magnitude * strength), 0.0),
        strength=np.where(begun, state.strength + counted * strength, 0.0),
        onset_s=np.where(begun, state.onset_s, evidence.time_s),
    )


def _declare_failure(
    state: CusumState, suspected_jets: NDArray[np.bool_], jet: int, force: float, variance: float
) -> CusumState:
    """Returns the state after a failure: sums reset, suspected jets removed, excess thrust a known force."""
    anew = initial_state(suspected_jets.size)
    known, spread = state.force.copy(), state.variance.copy()
    if force > 0.0:
        known[jet], spread[jet] = force, variance
    return anew._replace(
        onset_s=state.onset_s,
        force=known,
        variance=spread,
        removed=np.where(suspected_jets, 1.0, state.removed),
        closed=state.closed,
    )


DETECTOR = Detector(
    params=make_params,
    initial=lambda params: initial_state(params.clusters.size),
    layout=lambda params: LAYOUT.sized(jets=params.clusters.size),
    known_force=known_force,
    judge=judge,
)
