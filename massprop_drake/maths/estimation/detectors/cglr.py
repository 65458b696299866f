r"""The constrained generalized likelihood ratio (CGLR): from tests of single samples to declared failures.

One cycle of the detector (section 4.3 to 4.5 of the thesis, with the rules marked [own]):

- A sample is tested when both innovations are there, the combination of jets was steady (the empty one
  counts as steady), and the estimates have converged [own].
- An alarm names a cluster by the margin of six. It passes as a jet's only if the jet leaves no more
  unexplained than chance would; otherwise the mass properties may have jumped [own], which is left to
  the filters' own tests.
- Where thrust errors are considered, they count in the covariance of the innovations, and what translation
  and rotation share of them in its blocks off the diagonal. They last, so a chance alarm would come again
  at each firing: while jets fire, an alarm must stand out by more [own].
- A sample that a jet explains, but two jets alike, is not used by the filters [own].
- While an alarm stands, its signature is taken out of the innovations before the filters use them.
- Alarms of one cluster that follow each other closely enough, and push the same way, declare a failure: one
  bad reading enters two increments with opposite signs [own]. Samples that were not
  tested neither count nor break the row. A force that should not
  be there then becomes a known force, followed by a filter of one state [own]; the jets in question are
  to be taken out of use. Where it may as well be that a jet which is told to fire does not, that is
  declared: nothing then has to be countered, and a jet stuck on shows again when the others rest [own].
- An alarm about a jet whose force is known already corrects that force; when nothing is left of it the
  declaration is withdrawn [own].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.arrays import NUMBER, Layout
from massprop_drake.maths.estimation.adaptation import Action, Adaptation, passive_adaptation
from massprop_drake.maths.estimation.detector import STATUS, Detector, Evidence, Judgment, KnownJets, Verdict
from massprop_drake.maths.estimation.detectors.jet_tests import (
    Isolation,
    JetTests,
    UncertainSignatures,
    information,
    is_testable,
    isolate,
    jet_tests,
    signatures,
    uncertain_jet_tests,
)
from massprop_drake.maths.estimation.detectors.known_forces import excess_share, known_force
from massprop_drake.maths.kernels import kernel, select_where
from massprop_drake.maths.linear_algebra import Array, has_nonzero, inverse_positive_definite, quadratic_form

_AMBIGUOUS = 25.0  # likelihood argument of a failure beyond doubt, whichever jet it is
_LONGEST_GATE = 25.0  # cycles that alarms in a row may lie apart with no sample tested between them
_JUMP_NIS = 50.0  # of the rotation filter: a jump beyond doubt (chi-square, 3 degrees: 1e-10)
_FORCE_FLOOR = 1e-4  # least 1-sigma of a known force, relative to the strongest jet's
_QUIET = -1.0  # no cluster is suspected
_NOTHING, _DECLARED, _JUMP, _WITHDRAWN = (
    int(event) for event in (Verdict.NOTHING, Verdict.DECLARED, Verdict.JUMP, Verdict.WITHDRAWN)
)
_REJECT = int(Action.REJECT)


class CglrParams(NamedTuple):
    """Parameters of the detector.

    Attributes:
        period_s: sample period, s.
        clusters: index of each jet's cluster, shape (n_jets,).
        unit_wrenches: torque about the vehicle origin and force of a unit force along each jet, shape
            (n_jets, 6).
        thrusts: full force of each jet, lbf or N, shape (n_jets,).
        margin: by which a cluster, and a jet in it, must lead.
        threshold: least likelihood argument of an alarm.
        dispersion_threshold: the same for samples on which considered thrust errors bear.
        magnitude_threshold: least magnitude of an alarm, lbf or N.
        mirror_sign_rule: whether a jet that is on cannot give too much.
        signature_uncertainty: whether signatures count as uncertain.
        unexplained_limit: largest g of a jet's alarm.
        alarms_to_declare: alarms in a row that declare a failure; 0: never declare.
        alarm_gap: cycles between two alarms in a row at the most, where samples tested in between show
            nothing; gated samples neither count nor break the row, for up to 25 cycles.
        action: what the filters do on an alarm, see `estimation.adaptation`.
        force_variance_floor: of a known force, lbf^2 or N^2.
        manifolds: index of the manifold that is closed when a jet's failure is declared, -1: none is,
            shape (n_jets,).
        limits: of convergence, below which samples are tested; see `mass_properties.is_converged`, shape (3,).
    """

    period_s: float
    clusters: NDArray[np.int_]
    unit_wrenches: Array
    thrusts: Array
    margin: float
    threshold: float
    dispersion_threshold: float
    magnitude_threshold: float
    mirror_sign_rule: bool
    signature_uncertainty: bool
    unexplained_limit: float
    alarms_to_declare: int
    alarm_gap: int
    action: Action
    force_variance_floor: float
    manifolds: NDArray[np.int_]
    limits: Array


def make_params(jets: KnownJets, options: Any) -> CglrParams:
    """Makes the CGLR detector's parameters from the jets' data and a scenario's block `detector`."""
    limit = options.unexplained_limit
    return CglrParams(
        period_s=jets.period_s,
        clusters=jets.clusters,
        unit_wrenches=jets.unit_wrenches,
        thrusts=jets.thrusts,
        margin=options.margin,
        threshold=options.threshold,
        dispersion_threshold=options.dispersion_threshold,
        magnitude_threshold=options.magnitude_threshold,
        mirror_sign_rule=options.mirror_sign_rule,
        signature_uncertainty=options.signature_uncertainty,
        unexplained_limit=math.inf if limit is None else limit,
        alarms_to_declare=options.reconfigure_after or 0,
        alarm_gap=options.alarm_gap,
        action=Action[options.on_detection.upper()],
        force_variance_floor=(_FORCE_FLOOR * float(jets.thrusts.max())) ** 2,
        manifolds=jets.manifolds if options.close_manifold else np.full_like(jets.manifolds, -1),
        limits=jets.limits,
    )


class DetectorState(NamedTuple):
    """State of the detector between samples.

    Attributes:
        cluster: index of the cluster under suspicion, -1: none.
        alarms: so many in a row have named it.
        since: cycles since the last of them.
        onset_s: end of the last sample before the first of them, s.
        effect: of the last of them on the innovations, f c, shape (6,).
        force: known force of each jet, lbf or N, shape (n_jets,).
        variance: of it; zero where no force is known, shape (n_jets,).
        removed: 1 for each jet to be taken out of use, shape (n_jets,).
        closed: 1 for each jet whose manifold has been closed, shape (n_jets,).
    """

    cluster: float
    alarms: float
    since: float
    onset_s: float
    effect: Array
    force: Array
    variance: Array
    removed: Array
    closed: Array


LAYOUT = Layout(
    "cglr",
    cluster=NUMBER,
    alarms=NUMBER,
    since=NUMBER,
    onset_s=NUMBER,
    effect=6,
    force="jets",
    variance="jets",
    removed="jets",
    closed="jets",
)


def initial_state(n_jets: int) -> DetectorState:
    """Returns the detector's state without suspicion, known forces or jets removed."""
    return DetectorState(_QUIET, 0.0, 0.0, 0.0, np.zeros(6), *np.zeros((4, n_jets)))


class CglrFinding(NamedTuple):
    """Finding of the detector about one sample.

    Attributes:
        alarm: whether an alarm passed as a jet's.
        isolation: see `jet_tests.isolate`; of no meaning when not tested.
        jet_isolated: whether the alarm names the jet.
        magnitude: of the likeliest jet, lbf or N.
        magnitude_std: 1-sigma of it.
        unexplained: g of the likeliest jet.
        event: NOTHING, DECLARED, JUMP or WITHDRAWN.
        onset_s: of the alarms in a row that this one belongs to, s.
        alarms: how many they are.
    """

    tested: bool
    alarm: bool
    isolation: Isolation
    jet_isolated: bool
    magnitude: float
    magnitude_std: float
    unexplained: float
    event: int
    onset_s: float
    alarms: float


class DetectorCycle(NamedTuple):
    """Result of one cycle.

    Attributes:
        tests: of every jet; arguments are NaN where the sample was not tested.
    """

    state: DetectorState
    tests: JetTests
    finding: CglrFinding
    adaptation: Adaptation


@kernel
def run_cycle(state: DetectorState, evidence: Evidence, params: CglrParams) -> DetectorCycle:
    """Tests a sample for jet failures; returns the new state, tests of all jets, finding and adaptation.

    Raises:
        NotPositiveDefiniteError: when an innovation covariance is not positive definite.
    """
    if not is_testable(evidence, params.limits):
        return _skip_sample(state)
    state = _age_suspicion(state)
    inverse = information(evidence.covariance, evidence.coupled)
    coefficients, tests, isolation = _test_jets(state, evidence, inverse, params)
    jet = isolation.jet
    explains = float(tests.unexplained[jet]) < params.unexplained_limit
    threshold = max(params.threshold, params.dispersion_threshold) if evidence.coupled else params.threshold
    alarm = bool(
        isolation.cluster_margin > params.margin
        and tests.likelihood[jet] >= threshold
        and abs(tests.magnitude[jet]) >= params.magnitude_threshold
        and explains
    )
    beyond_doubt = bool(tests.likelihood[jet] > _AMBIGUOUS and explains)
    event, onset_s, alarms, begun_s = _NOTHING, 0.0, 0.0, evidence.time_s - params.period_s
    adaptation = passive_adaptation(0, False)
    if not alarm:
        state = _end_without_alarm(state, params)
    if (alarm or beyond_doubt) and state.variance[jet] > 0.0:
        # whatever else could explain it, its force is not what it was
        adaptation = _make_correction(coefficients[jet], tests, jet, params)
        state, event = _correct_known_force(state, tests, jet, params)
        onset_s, alarms = begun_s, 1.0
    elif alarm:
        adaptation = _make_correction(coefficients[jet], tests, jet, params)
        state = _count_alarm(state, isolation, float(tests.magnitude[jet]) * coefficients[jet], inverse, begun_s)
        onset_s, alarms = state.onset_s, state.alarms
        state, event, jet = _declare_failure(state, tests, isolation, params)
    elif beyond_doubt:  # a jet has failed, but which one the sample does not say: no jump, and nothing to learn from
        adaptation = passive_adaptation(_REJECT, False)
    elif evidence.firing and _rotation_nis(evidence) > _JUMP_NIS:
        # without a commanded impulse mass properties do not show
        event, onset_s, alarms = _JUMP, begun_s, 1.0
        adaptation = passive_adaptation(0, True)
    else:
        state = _update_known_forces(state, coefficients, evidence, params)
    finding = CglrFinding(
        True,
        alarm,
        Isolation(jet, isolation.cluster, isolation.cluster_margin, isolation.jet_margin),
        alarm and isolation.jet_margin > params.margin,
        float(tests.magnitude[jet]),
        float(np.sqrt(tests.variance[jet])),
        float(tests.unexplained[jet]),
        event,
        onset_s,
        alarms,
    )
    return DetectorCycle(state, tests, finding, adaptation)


@kernel
def _test_jets(
    state: DetectorState, evidence: Evidence, information: Array, params: CglrParams
) -> tuple[Array, JetTests, Isolation]:
    """Tests all jets, suspicious ones again with uncertain signatures; returns signatures, tests, isolation."""
    coefficients = signatures(params.unit_wrenches, evidence.estimate, params.period_s)
    known, off = state.variance > 0.0, evidence.command == 0.0
    impossible_negative, impossible_positive = off & ~known, np.zeros(off.size, dtype=np.bool_)
    if params.mirror_sign_rule:
        impossible_positive = ~off & ~known
    tests = jet_tests(coefficients, evidence.innovation, information, impossible_negative, impossible_positive)
    isolation = isolate(tests.likelihood, params.clusters)
    suspicious = isolation.cluster_margin > params.margin or tests.likelihood[isolation.jet] > _AMBIGUOUS
    if suspicious and params.signature_uncertainty:
        uncertain = UncertainSignatures(
            coefficients,
            params.unit_wrenches * params.period_s,
            evidence.estimate,
            evidence.estimate_covariance,
            evidence.cross_covariance,
        )
        tests = uncertain_jet_tests(
            tests, evidence.innovation, evidence.covariance, uncertain, impossible_negative, impossible_positive
        )
        isolation = isolate(tests.likelihood, params.clusters)
    return coefficients, tests, isolation


@kernel
def _skip_sample(state: DetectorState) -> DetectorCycle:
    """Makes the detector's result for a sample that cannot be tested: nothing found, the suspicion aged."""
    blank = np.full(state.force.size, np.nan)
    nothing = CglrFinding(False, False, Isolation(0, 0, 0.0, 0.0), False, 0.0, 0.0, 0.0, _NOTHING, 0.0, 0.0)
    return DetectorCycle(
        _age_suspicion(state), JetTests(blank, blank, blank, blank), nothing, passive_adaptation(0, False)
    )


@kernel
def _rotation_nis(evidence: Evidence) -> float:
    """Computes the NIS of the rotation part of the innovation."""
    rotation = evidence.innovation[3:]
    return quadratic_form(rotation, inverse_positive_definite(evidence.covariance[3:, 3:]))


@kernel
def _with_suspicion(state: DetectorState, cluster: float, alarms: float, age: float) -> DetectorState:
    """Returns the detector's state with another suspected cluster, alarms in a row, and cycles since the last alarm."""
    return DetectorState(
        cluster, alarms, age, state.onset_s, state.effect, state.force, state.variance, state.removed, state.closed
    )


@kernel
def _with_known_forces(state: DetectorState, force: Array, variance: Array) -> DetectorState:
    """Returns the detector's state with other known forces of failed jets, and their variances."""
    return DetectorState(
        state.cluster,
        state.alarms,
        state.since,
        state.onset_s,
        state.effect,
        force,
        variance,
        state.removed,
        state.closed,
    )


@kernel
def _age_suspicion(state: DetectorState) -> DetectorState:
    """Returns the detector's state with its suspicion a cycle older, or dropped after the longest gap."""
    if state.cluster == _QUIET:
        return state
    if state.since >= _LONGEST_GATE:
        return _with_suspicion(state, _QUIET, 0.0, 0.0)
    return _with_suspicion(state, state.cluster, state.alarms, state.since + 1.0)


@kernel
def _end_without_alarm(state: DetectorState, params: CglrParams) -> DetectorState:
    """Drops the suspicion after a sample without alarm, if the gap since the last alarm is too long."""
    if state.cluster != _QUIET and state.since >= params.alarm_gap:
        return _with_suspicion(state, _QUIET, 0.0, 0.0)
    return state


@kernel
def _make_correction(signature: Array, tests: JetTests, jet: int, params: CglrParams) -> Adaptation:
    """Makes the adaptation that subtracts the likeliest jet's effect from the innovations (4-29) to (4-32)."""
    effect = float(tests.magnitude[jet]) * signature
    spread = float(tests.variance[jet]) * (signature[:, None] * signature)
    return Adaptation(params.action, effect[:3], effect[3:], spread[:3, :3].copy(), spread[3:, 3:].copy(), False)


@kernel
def _count_alarm(
    state: DetectorState, isolation: Isolation, effect: Array, information: Array, interval_start_s: float
) -> DetectorState:
    """Counts an alarm for its cluster; a different cluster or an opposite force starts a new count."""
    cluster = float(isolation.cluster)
    confirms = state.cluster == cluster and float(effect @ information @ state.effect) > 0.0
    onset_s, alarms = (state.onset_s, state.alarms + 1.0) if confirms else (interval_start_s, 1.0)
    force, variance, removed, closed = state.force, state.variance, state.removed, state.closed
    return DetectorState(cluster, alarms, 0.0, onset_s, effect, force, variance, removed, closed)


@kernel
def _declare_failure(
    state: DetectorState, tests: JetTests, isolation: Isolation, params: CglrParams
) -> tuple[DetectorState, int, int]:
    """Declares a failure when there are enough alarms in a row; returns the state, the event and the jet."""
    jet, force, variance = isolation.jet, state.force, state.variance
    removed, closed = state.removed, state.closed
    known_already = removed[jet] != 0.0 and tests.magnitude[jet] < 0.0  # declared, but still in use
    if params.alarms_to_declare == 0 or state.alarms < params.alarms_to_declare or known_already:
        return state, _NOTHING, jet
    # the jets that the data cannot tell apart are in question together
    alike = (params.clusters == isolation.cluster) & (tests.likelihood >= tests.likelihood[jet] - params.margin)
    missing = alike & (tests.magnitude < 0.0)
    if tests.magnitude[jet] > 0.0 and missing.any():
        jet = int(select_where(missing, tests.likelihood, -1.0).argmax())
    manifold = params.manifolds[jet]
    if manifold >= 0:
        alike = alike | (params.manifolds == manifold)
        closed = select_where(params.manifolds == manifold, 1.0, closed)
    if tests.magnitude[jet] > 0.0 and manifold < 0:
        force, variance = force.copy(), variance.copy()
        force[jet] = tests.magnitude[jet]
        variance[jet] = max(float(tests.variance[jet]), params.force_variance_floor)
    removed = select_where(alike, 1.0, removed)
    after = DetectorState(_QUIET, 0.0, 0.0, state.onset_s, state.effect, force, variance, removed, closed)
    return after, _DECLARED, jet


@kernel
def _correct_known_force(
    state: DetectorState, tests: JetTests, jet: int, params: CglrParams
) -> tuple[DetectorState, int]:
    """Corrects a known force by an alarm's estimate, zero if insignificant; returns the state and the event."""
    force, variance = state.force.copy(), state.variance.copy()
    force[jet] += tests.magnitude[jet]
    variance[jet] = max(float(tests.variance[jet]), params.force_variance_floor)
    event = _NOTHING
    if not abs(force[jet]) > 3.0 * math.sqrt(variance[jet]):
        force[jet] = variance[jet] = 0.0
        event = _WITHDRAWN
    return _with_known_forces(state, force, variance), event


@kernel
def _update_known_forces(
    state: DetectorState, jet_signatures: Array, evidence: Evidence, params: CglrParams
) -> DetectorState:
    """Updates each known force and its variance, a scalar Kalman filter, by a sample without alarm."""
    if not has_nonzero(state.variance):
        return state
    jets = np.flatnonzero(state.variance)
    force, variance = state.force.copy(), state.variance.copy()
    moving = inverse_positive_definite(evidence.covariance[:3, :3], "innovation covariance")
    turning = inverse_positive_definite(evidence.covariance[3:, 3:], "innovation covariance")
    excess = excess_share(state, jets, evidence.command, params)
    for index in range(jets.size):
        jet = jets[index]
        prior = float(variance[jet])
        information, projection = 1.0 / prior, 0.0
        for begin in (0, 3):
            # Y holds prior c c^T already: c^T (Y - prior c c^T)^-1 = c^T Y^-1 / (1 - prior c^T Y^-1 c)
            signature = excess[index] * jet_signatures[jet, begin : begin + 3]
            weighted = (moving if begin == 0 else turning) @ signature
            share = 1.0 - prior * float(weighted @ signature)
            information += float(weighted @ signature) / share
            projection += float(weighted @ evidence.innovation[begin : begin + 3]) / share
        force[jet] += projection / information
        variance[jet] = max(1.0 / information, params.force_variance_floor)
    return _with_known_forces(state, force, variance)


@kernel
def status_values(result: DetectorCycle) -> tuple[Any, ...]:
    """Returns the values of a cycle's log row, in the order of `detector.STATUS`."""
    finding, isolation = result.finding, result.finding.isolation
    return (
        finding.tested,
        finding.alarm,
        finding.event,
        isolation.cluster,
        isolation.jet,
        finding.jet_isolated,
        finding.magnitude,
        finding.magnitude_std,
        float(result.tests.likelihood[isolation.jet]),
        isolation.cluster_margin,
        isolation.jet_margin,
        finding.unexplained,
        finding.onset_s,
        finding.alarms,
    )


def status(result: DetectorCycle) -> Any:
    """Makes a cycle's log row, `detector.STATUS`, of what the detector has found."""
    return STATUS.make(**dict(zip(STATUS, status_values(result), strict=True)))


def _judge(state: DetectorState, evidence: Evidence, params: CglrParams) -> Judgment:
    """Runs a cycle of the detector; returns its result as a judgment."""
    result = run_cycle(state, evidence, params)
    return Judgment(result.state, result.adaptation, status(result), result.tests.likelihood, result.tests.magnitude)


DETECTOR = Detector(
    params=make_params,
    initial=lambda params: initial_state(params.clusters.size),
    layout=lambda params: LAYOUT.sized(jets=params.clusters.size),
    known_force=known_force,
    judge=_judge,
)
