"""From single samples to declared failures: counting, what follows, and what is left alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import detector_settings_of as settings_of
from params_probe import evidence

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation import adaptation
from massprop_drake.maths.estimation.detector import KNOWN_FORCE, NO_KNOWN_FORCE, Verdict
from massprop_drake.maths.estimation.detectors.cglr import (
    LAYOUT,
    CglrParams,
    DetectorCycle,
    DetectorSample,
    DetectorState,
    cycle,
    initial_state,
    judged,
    known_force,
    status,
)
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.estimation.filters.rotation_filter import rate_increment_jacobian
from massprop_drake.maths.estimation.filters.thesis import joint_covariance, shared_covariance
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

PERIOD_S = 0.08
packed = LAYOUT.sized(jets=44).pack
N = 44
# indices of jets: 29 and its neighbor 30, 11, the vernier 39 and the primaries 9 and 10 beside it
STUCK, NEIGHBOR, LOST, VERNIER, BESIDE_VERNIER = 28, 29, 10, 38, (8, 9)
VELOCITY_VARIANCE, RATE_VARIANCE = 0.0344**2 / 6.0, 1.52e-6**2 / 6.0  # section 5.5 of the thesis
LIMITS = np.array([0.02, 1.0, 0.2])  # of convergence: diagonal, ft, mass reciprocal
THRUSTS = {STUCK: 868.819, LOST: 874.185}  # lbf
QUIET = np.zeros(6)
FIRING = {"command": np.eye(N)[0], "firing": True}  # jet 1 is on


class Bench:
    """A detector of the orbiter, fed with innovations made up for the purpose. No noise unless said.

    Signatures count as certain and manifolds stay open unless said, so that every number is exact.
    """

    def __init__(self, vehicle: Vehicle, **params: Any):
        plain = settings_of()._replace(signature_uncertainty=False, limits=LIMITS)
        self.params: CglrParams = plain._replace(**params)
        self.properties = vehicle.nominal.vector()
        self.signatures = signatures(self.params.unit_wrenches, self.properties, PERIOD_S)
        self.state = initial_state(N)
        self.number = 0  # of the sample

    @property
    def sure(self) -> Array:
        """S of estimates as good as exact; a variance of zero would say that nothing was ever measured."""
        return np.diag(np.append((1e-9 * self.properties[:3]) ** 2, np.zeros(6)))

    def given(self, innovation: Array, **changes: Any) -> dict[str, Any]:
        """What the filters hand over while coasting, sure of their estimates, but for the changes."""
        properties = changes.pop("mass_properties", self.properties)
        return {
            "time_s": self.number * PERIOD_S,
            "command": np.zeros(N),
            "usable": True,
            "firing": False,
            "translation": innovation[:3],
            "rotation": innovation[3:],
            "translation_covariance": VELOCITY_VARIANCE * np.eye(3),
            "rotation_covariance": RATE_VARIANCE * np.eye(3),
            "rotation_estimate": properties[:9],
            "state_covariance": self.sure,
            "mass_estimate": np.array([properties[9], (1e-9 * properties[9]) ** 2]),
            **changes,
        }

    def step(self, innovation: Array, **changes: Any) -> DetectorCycle:
        """The next cycle."""
        self.number += 1
        result = judged(self.state, evidence(**self.given(innovation, **changes)), self.params)
        self.state = result.state
        return result

    def failing(self, jet: int, force: float, **changes: Any) -> DetectorCycle:
        """The next cycle, which shows a failure of a jet and no noise."""
        if force < 0.0:
            command = np.zeros(N)
            command[jet] = 1.0
            changes = {"command": command, "firing": True, **changes}
        return self.step(force * self.signatures[jet], **changes)

    def idle(self, cycles: int, **changes: Any) -> None:
        """Cycles that show nothing."""
        for _ in range(cycles):
            self.step(QUIET, **changes)

    def declare(self, jet: int, force: float) -> DetectorCycle:
        """The cycles that declare a failure."""
        for _ in range(self.params.alarms_to_declare):
            result = self.failing(jet, force)
        assert result.finding.event == Verdict.DECLARED
        return result

    @property
    def information(self) -> Array:
        return np.diag([1.0 / VELOCITY_VARIANCE] * 3 + [1.0 / RATE_VARIANCE] * 3)

    def unexplained(self, jet: int, size: float) -> Array:
        """An innovation that has nothing to do with a jet: g = size, no part along its signature."""
        c = self.signatures[jet]
        direction = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
        weighted = self.information @ c
        direction = direction - c * (weighted @ direction) / (weighted @ c)
        return direction * np.sqrt(size / (direction @ self.information @ direction))


@pytest.fixture
def bench(orbiter: Vehicle) -> Bench:
    return Bench(orbiter)


# ----------------------------------------------------------------------------------------- one sample


def test_a_failure_gives_an_alarm_that_says_what_failed(bench: Bench) -> None:
    finding = bench.failing(STUCK, 868.8).finding
    assert finding.tested
    assert finding.alarm
    assert finding.jet_isolated
    assert (finding.isolation.jet, finding.isolation.cluster) == (STUCK, 12)
    np.testing.assert_allclose(finding.magnitude, 868.8, rtol=1e-12)
    c = bench.signatures[STUCK]
    np.testing.assert_allclose(finding.magnitude_std, (c @ bench.information @ c) ** -0.5, rtol=1e-12)
    assert (finding.event, finding.alarms) == (Verdict.NOTHING, 1.0)
    # it began in the interval that ends with this sample, number 1
    assert finding.onset_s == 0.0


def test_noise_alone_gives_no_alarm(bench: Bench) -> None:
    result = bench.step(0.5 * bench.unexplained(STUCK, 1.0))
    assert result.finding.tested
    assert not result.finding.alarm
    assert result.state == initial_state(N)[:1] + result.state[1:]  # nothing is suspected
    assert result.adaptation == adaptation.NO_ADAPTATION


def test_an_alarm_can_name_the_cluster_and_leave_the_jet_open(bench: Bench) -> None:
    # the margin within the cluster is 2.8, reference figures 5-22 to 5-24
    finding = bench.failing(VERNIER, 24.483).finding
    assert finding.alarm
    assert not finding.jet_isolated
    assert finding.isolation.cluster == 4


@pytest.mark.parametrize(
    ("setting", "action"),
    [
        ("correct", adaptation.Action.CORRECT),
        ("correct_thesis", adaptation.Action.CORRECT_THESIS),
        ("reject", adaptation.Action.REJECT),
    ],
)
def test_an_alarm_takes_the_signature_out_of_the_innovations(orbiter: Vehicle, setting: str, action: int) -> None:
    bench = Bench(orbiter, action=settings_of(f"detector.on_detection={setting}").action)
    result = bench.failing(STUCK, 868.8)
    c = bench.signatures[STUCK]
    assert result.adaptation.action == action
    np.testing.assert_allclose(result.adaptation.translation, 868.8 * c[:3], rtol=1e-12)
    np.testing.assert_allclose(result.adaptation.rotation, 868.8 * c[3:], rtol=1e-12)
    # (4-32): C = c c^T / (c^T Y^-1 c)
    spread = np.outer(c, c) / (c @ bench.information @ c)
    np.testing.assert_allclose(result.adaptation.translation_spread, spread[:3, :3], rtol=1e-12)
    np.testing.assert_allclose(result.adaptation.rotation_spread, spread[3:, 3:], rtol=1e-12)
    assert not result.adaptation.mass_jumped


def test_the_tests_of_every_jet_are_handed_on(bench: Bench) -> None:
    tests = bench.failing(STUCK, 868.8).tests
    assert tests.likelihood.argmax() == STUCK
    # all jets are off: none has lost thrust
    assert (tests.magnitude >= 0.0).all()
    assert (tests.magnitude == 0.0).any()


def test_a_jet_that_fires_may_have_lost_thrust(bench: Bench) -> None:
    finding = bench.failing(LOST, -874.2).finding
    assert finding.isolation.jet == LOST
    np.testing.assert_allclose(finding.magnitude, -874.2, rtol=1e-12)
    # the same innovation with the jet off has to be another jet's doing
    other = bench.step(-874.2 * bench.signatures[LOST]).finding
    assert other.isolation.jet != LOST
    assert other.magnitude > 0.0


def test_a_jet_commanded_in_part_counts_as_on(bench: Bench) -> None:
    command = np.zeros(N)
    command[LOST] = 0.3
    assert bench.failing(LOST, -200.0, command=command).finding.isolation.jet == LOST


def test_a_jet_that_is_on_gives_no_more_than_it_should_by_the_mirror_rule_alone(orbiter: Vehicle) -> None:
    command = np.zeros(N)
    command[STUCK] = 1.0
    by_default = Bench(orbiter).failing(STUCK, 100.0, command=command)
    assert by_default.finding.isolation.jet == STUCK
    mirrored = Bench(orbiter, mirror_sign_rule=True).failing(STUCK, 100.0, command=command)
    assert mirrored.finding.isolation.jet == NEIGHBOR
    assert mirrored.tests.likelihood[STUCK] == 0.0
    # a jet that is off may give too much under either rule
    assert Bench(orbiter, mirror_sign_rule=True).failing(STUCK, 100.0).finding.isolation.jet == STUCK


# -------------------------------------------------------------------------- what is tested, and what not


@pytest.mark.parametrize(
    "reason",
    [
        {"usable": False},
        {"state_covariance": np.eye(9)},
        {"translation": np.full(3, np.nan)},
        {"rotation": np.full(3, np.nan)},
    ],
    ids=["combination not steady", "estimates not converged", "no velocity", "no rate"],
)
def test_a_sample_that_says_nothing_is_not_tested(bench: Bench, reason: dict[str, Any]) -> None:
    result = bench.failing(STUCK, 868.8, **reason)
    assert not result.finding.tested
    assert not result.finding.alarm
    assert result.finding.event == Verdict.NOTHING
    assert all(np.isnan(values).all() for values in result.tests)
    assert result.adaptation == adaptation.NO_ADAPTATION
    np.testing.assert_array_equal(packed(result.state), packed(initial_state(N)))


def test_a_coasting_sample_is_tested(bench: Bench) -> None:
    assert bench.failing(STUCK, 868.8, firing=False).finding.alarm


def test_a_gated_sample_neither_counts_nor_breaks_the_run(bench: Bench) -> None:
    bench.failing(STUCK, 868.8)
    gated = bench.failing(STUCK, 868.8, usable=False)
    assert gated.state.alarms == 1.0
    assert bench.failing(STUCK, 868.8).finding.event == Verdict.DECLARED


def test_what_was_handed_in_is_not_changed(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    before = packed(bench.state).copy()
    state = bench.state
    for innovation, params in (
        (3.0 * bench.signatures[STUCK], bench.params),
        (-500.0 * bench.signatures[STUCK], bench.params),
        (300.0 * bench.signatures[0], bench.params._replace(alarms_to_declare=1)),
    ):
        judged(state, evidence(**bench.given(innovation)), params)
    np.testing.assert_array_equal(packed(state), before)


# --------------------------------------------------------------------------------------------- counting


@pytest.mark.parametrize("needed", [1, 2, 3, 5])
def test_a_failure_is_declared_at_the_nth_alarm_in_a_row(orbiter: Vehicle, needed: int) -> None:
    bench = Bench(orbiter, alarms_to_declare=needed)
    findings = [bench.failing(STUCK, 868.8).finding for _ in range(needed)]
    assert [finding.event for finding in findings] == [Verdict.NOTHING] * (needed - 1) + [Verdict.DECLARED]
    assert [finding.alarms for finding in findings] == [float(k + 1) for k in range(needed)]
    # since the interval before the first of them
    assert {finding.onset_s for finding in findings} == {0.0}


def test_nothing_is_ever_declared_when_that_is_off(orbiter: Vehicle) -> None:
    bench = Bench(orbiter, alarms_to_declare=0)
    findings = [bench.failing(STUCK, 868.8).finding for _ in range(20)]
    assert all(finding.alarm and finding.event == Verdict.NOTHING for finding in findings)
    assert findings[-1].alarms == 20.0
    assert not bench.state.removed.any()
    assert not bench.state.force.any()


@pytest.mark.parametrize(
    ("apart", "usable", "event"),
    [
        (1, True, Verdict.DECLARED),
        (2, True, Verdict.DECLARED),
        (3, True, Verdict.DECLARED),
        (4, True, Verdict.NOTHING),
        (3, False, Verdict.DECLARED),
        (4, False, Verdict.DECLARED),
        (25, False, Verdict.DECLARED),
        (26, False, Verdict.NOTHING),
    ],
)
def test_alarms_are_in_a_row_when_not_too_far_apart(bench: Bench, apart: int, event: int, *, usable: bool) -> None:
    # three cycles where the samples between were tested and showed nothing, 25 where none could be tested
    assert bench.params.alarm_gap == 3
    bench.failing(STUCK, 868.8)
    bench.idle(apart - 1, usable=usable)
    finding = bench.failing(STUCK, 868.8).finding
    assert finding.event == event
    # in a row: since the first; too far apart: the run begins anew with this one
    first, last = 0.0, apart * PERIOD_S
    np.testing.assert_allclose(finding.onset_s, first if event == Verdict.DECLARED else last, atol=1e-12)
    assert finding.alarms == (2.0 if event == Verdict.DECLARED else 1.0)


def test_the_gap_is_counted_from_the_last_alarm(orbiter: Vehicle) -> None:
    bench = Bench(orbiter, alarms_to_declare=3)
    for _ in range(2):
        bench.failing(STUCK, 868.8)
        bench.idle(2)
    assert bench.failing(STUCK, 868.8).finding.event == Verdict.DECLARED


def test_a_suspicion_without_a_further_alarm_is_dropped(bench: Bench) -> None:
    bench.failing(STUCK, 868.8)
    bench.idle(2)
    assert bench.state.cluster == 12.0
    bench.idle(1)
    assert (bench.state.cluster, bench.state.alarms) == (-1.0, 0.0)


def test_an_alarm_of_another_cluster_starts_the_count_anew(bench: Bench) -> None:
    bench.failing(STUCK, 868.8)
    other = bench.failing(VERNIER, 24.483).finding
    assert (other.event, other.alarms) == (Verdict.NOTHING, 1.0)
    np.testing.assert_allclose(other.onset_s, PERIOD_S, rtol=1e-12)
    back = bench.failing(STUCK, 868.8).finding
    assert (back.event, back.alarms) == (Verdict.NOTHING, 1.0)


def test_alarms_of_two_jets_of_a_cluster_count_together(bench: Bench) -> None:
    bench.failing(STUCK, 868.8)
    finding = bench.failing(NEIGHBOR, 868.8).finding
    assert (finding.event, finding.isolation.jet) == (Verdict.DECLARED, NEIGHBOR)


def test_the_count_starts_anew_after_a_declaration(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    assert bench.state.cluster == -1.0
    first = bench.failing(LOST, -874.2).finding
    assert (first.event, first.alarms) == (Verdict.NOTHING, 1.0)
    assert bench.failing(LOST, -874.2).finding.event == Verdict.DECLARED
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), [LOST, STUCK])


# ------------------------------------------------------------------------------------------- thresholds


def test_the_margin_is_a_setting_for_the_cluster_and_for_the_jet(orbiter: Vehicle) -> None:
    # jet 29: the cluster leads by 17 800, the jet by 289 (reference, figure 5-17)
    found = {margin: Bench(orbiter, margin=margin).failing(STUCK, 868.819).finding for margin in (280.0, 300.0, 2e4)}
    assert [found[margin].jet_isolated for margin in found] == [True, False, False]
    assert [found[margin].alarm for margin in found] == [True, True, False]


def test_a_threshold_on_the_likelihood_argument(orbiter: Vehicle) -> None:
    # the leak of jet 24 has 260 (reference, figure 5-25)
    assert Bench(orbiter, threshold=259.0).failing(23, 10.365).finding.alarm
    assert not Bench(orbiter, threshold=262.0).failing(23, 10.365).finding.alarm


def test_a_threshold_on_the_magnitude_holds_for_both_signs(orbiter: Vehicle) -> None:
    assert Bench(orbiter, magnitude_threshold=10.0).failing(23, 10.4).finding.alarm
    assert not Bench(orbiter, magnitude_threshold=11.0).failing(23, 10.4).finding.alarm
    assert Bench(orbiter, magnitude_threshold=800.0).failing(LOST, -874.2).finding.alarm
    assert not Bench(orbiter, magnitude_threshold=900.0).failing(LOST, -874.2).finding.alarm


# ----------------------------------------------------------------------------------------- jet or jump


@pytest.mark.parametrize(("size", "alarm"), [(20.0, True), (21.0, False)])
def test_an_alarm_that_leaves_too_much_unexplained_is_no_jets(bench: Bench, size: float, *, alarm: bool) -> None:
    finding = bench.step(868.8 * bench.signatures[STUCK] + bench.unexplained(STUCK, size)).finding
    assert finding.isolation.cluster_margin > 6.0
    np.testing.assert_allclose(finding.unexplained, size, rtol=1e-6)  # a difference from 8e5
    assert finding.alarm == alarm


def test_without_a_limit_it_is_a_jets_all_the_same(orbiter: Vehicle) -> None:
    bench = Bench(orbiter, unexplained_limit=np.inf)
    assert bench.step(868.8 * bench.signatures[STUCK] + bench.unexplained(STUCK, 1000.0)).finding.alarm


def test_an_innovation_that_no_jet_explains_is_a_jump_of_the_mass_properties(bench: Bench) -> None:
    bench.number = 9
    odd = 868.8 * bench.signatures[STUCK] + bench.unexplained(STUCK, 100.0)
    result = bench.step(odd, **FIRING)
    assert (result.finding.event, result.finding.alarm) == (Verdict.JUMP, False)
    np.testing.assert_allclose(result.finding.onset_s, 9 * PERIOD_S, rtol=1e-12)
    assert result.finding.alarms == 1.0
    assert result.adaptation.action == adaptation.Action.NONE
    assert result.adaptation.mass_jumped


def test_a_jump_shows_only_while_an_impulse_acts(bench: Bench) -> None:
    odd = 868.8 * bench.signatures[STUCK] + bench.unexplained(STUCK, 100.0)
    result = bench.step(odd, firing=False)
    assert result.finding.event == Verdict.NOTHING
    assert result.adaptation == adaptation.NO_ADAPTATION


@pytest.mark.parametrize(("nis", "event"), [(49.0, Verdict.NOTHING), (51.0, Verdict.JUMP)])
def test_a_jump_is_beyond_doubt_at_fifty_of_the_rotations_nis(orbiter: Vehicle, nis: float, event: int) -> None:
    bench = Bench(orbiter, margin=1e9)  # no jet is ever accused
    innovation = np.array([5.0, 5.0, 5.0, 0.0, 0.0, 0.0])  # the velocity's part does not count
    innovation[3:] = np.sqrt(nis * RATE_VARIANCE / 3.0) * np.array([1.0, -1.0, 1.0])
    assert bench.step(innovation, **FIRING).finding.event == event


def test_a_known_force_alone_that_ceases_is_no_jump_of_the_mass_properties(bench: Bench) -> None:
    # jet 15 has pushed with 50 lbf and stops while nothing is commanded. A jet of cluster 8 that pushes with 13
    # lbf explains it almost as well, so there is no alarm; but mass properties show in proportion to an impulse,
    # and the only one is of the force in question
    with_known(bench, 14, 50.0, 0.01)
    result = bench.step(-50.0 * bench.signatures[14], firing=False)
    assert result.finding.isolation.jet == 14
    assert result.finding.isolation.cluster_margin < 6.0
    assert result.finding.event != Verdict.JUMP
    assert not result.adaptation.mass_jumped


def test_two_jets_that_explain_a_sample_alike_make_no_jump_of_it(bench: Bench) -> None:
    # jet 12 (F4R) stuck on while jet 5 (F3L), its mirror image, is fired against it: "jet 5 stuck off" leaves
    # as little unexplained. That neither leads is no sign of a jump (reference, 8.5), and the sample must not
    # teach the filters anything as it is
    stuck, opposed = 11, 4
    command = np.eye(N)[opposed]
    midway = 0.5 * (bench.signatures[stuck] - bench.signatures[opposed])  # within the noise of both
    result = bench.step(870.5 * midway, command=command, firing=True)
    assert result.finding.isolation.cluster_margin < 6.0
    assert result.tests.unexplained[[stuck, opposed]].max() < 20.5
    assert result.finding.event == Verdict.NOTHING
    assert not result.adaptation.mass_jumped
    assert result.adaptation.action != adaptation.Action.NONE


def test_a_failure_that_a_jet_explains_is_not_taken_for_a_jump(bench: Bench) -> None:
    result = bench.failing(LOST, -874.2)
    assert result.finding.event == Verdict.NOTHING
    assert not result.adaptation.mass_jumped


def test_a_jump_leaves_suspicion_and_known_forces_alone(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    before = bench.state
    odd = 868.8 * bench.signatures[0] + bench.unexplained(0, 1000.0)
    assert bench.step(odd, **FIRING).finding.event == Verdict.JUMP
    np.testing.assert_array_equal(packed(bench.state), packed(before))


# ------------------------------------------------------------------------------------------ declaration


def test_declaring_a_force_makes_it_known_and_takes_the_jet_out_of_use(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), [STUCK])
    np.testing.assert_array_equal(np.flatnonzero(bench.state.variance), [STUCK])
    np.testing.assert_allclose(bench.state.force[STUCK], 868.8, rtol=1e-12)
    c = bench.signatures[STUCK]
    np.testing.assert_allclose(bench.state.variance[STUCK], 1.0 / (c @ bench.information @ c), rtol=1e-12)
    assert np.count_nonzero(bench.state.force) == 1


def test_declaring_a_loss_of_thrust_takes_the_jet_out_of_use_alone(bench: Bench) -> None:
    bench.declare(LOST, -874.2)
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), [LOST])
    assert not bench.state.force.any()
    assert not bench.state.variance.any()


def test_the_jets_that_cannot_be_told_apart_are_taken_out_together(bench: Bench) -> None:
    result = bench.declare(VERNIER, 24.483)
    likelihood = result.tests.likelihood
    alike = [jet for jet in (VERNIER, *BESIDE_VERNIER) if likelihood[jet] >= likelihood[VERNIER] - 6.0]
    assert len(alike) > 1  # the margin to jet 9 is 2.8
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), sorted(alike))
    # one of them is taken to push
    np.testing.assert_array_equal(np.flatnonzero(bench.state.force), [VERNIER])


def test_a_jet_that_stays_in_use_is_not_declared_again(bench: Bench) -> None:
    # without it control would be lost, so it is commanded on and keeps missing its thrust: one failure, one
    # declaration, and each sample goes on being corrected
    bench.declare(LOST, -874.2)
    results = [bench.failing(LOST, -874.2) for _ in range(4)]
    assert [result.finding.event for result in results] == [Verdict.NOTHING] * 4
    assert all(result.adaptation.action == adaptation.Action.CORRECT for result in results)


def test_closing_the_manifold_stops_all_its_jets(orbiter: Vehicle) -> None:
    manifolds = settings_of("detector.close_manifold=true").manifolds
    sharing = [jet for jet, name in enumerate(orbiter.designations) if name[:2] == "R4"]
    np.testing.assert_array_equal(np.flatnonzero(manifolds == manifolds[STUCK]), sharing)
    bench = Bench(orbiter, manifolds=manifolds)
    bench.failing(STUCK, 868.8)
    assert not bench.state.closed.any()
    assert bench.failing(STUCK, 868.8).finding.event == Verdict.DECLARED
    np.testing.assert_array_equal(np.flatnonzero(bench.state.closed), sharing)
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), sharing)
    # nothing pushes any more, so nothing is known
    assert not bench.state.force.any()
    bench.declare(LOST, -874.2)
    expected = [jet for jet, name in enumerate(orbiter.designations) if name[:2] in ("R4", "F2")]
    np.testing.assert_array_equal(np.flatnonzero(bench.state.closed), expected)


def test_manifolds_stay_open_by_default(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    assert not bench.state.closed.any()


# -------------------------------------------------------------------------------------------- known force


def test_a_known_forces_wrench_and_spread(bench: Bench) -> None:
    assert known_force(bench.state, bench.properties, np.zeros(N), bench.params) is NO_KNOWN_FORCE
    force, variance = np.zeros(N), np.zeros(N)
    force[[STUCK, 23]] = 868.8, 10.4
    variance[[STUCK, 23]] = 0.9, 0.4
    state = bench.state._replace(force=force, variance=variance)
    known = known_force(state, bench.properties, np.zeros(N), bench.params)
    wrenches = bench.params.unit_wrenches
    np.testing.assert_allclose(known.wrench, 868.8 * wrenches[STUCK] + 10.4 * wrenches[23], rtol=1e-12)
    c = bench.signatures
    spread = 0.9 * np.outer(c[STUCK], c[STUCK]) + 0.4 * np.outer(c[23], c[23])
    np.testing.assert_allclose(known.translation_spread, spread[:3, :3], rtol=1e-12)
    np.testing.assert_allclose(known.rotation_spread, spread[3:, 3:], rtol=1e-12)
    assert known.wrench.size + known.translation_spread.size + known.rotation_spread.size == KNOWN_FORCE.size


def with_known(bench: Bench, jet: int, force: float, variance: float) -> None:
    forces, variances, removed = np.zeros((3, N))
    forces[jet], variances[jet], removed[jet] = force, variance, 1.0
    bench.state = bench.state._replace(force=forces, variance=variances, removed=removed)


def grown(bench: Bench, velocity_variance: float, rate_variance: float) -> dict[str, Array]:
    """Covariances of innovations whose sensors have these variances and whose known force is uncertain."""
    known = known_force(bench.state, bench.properties, np.zeros(N), bench.params)
    return {
        "translation_covariance": velocity_variance * np.eye(3) + known.translation_spread,
        "rotation_covariance": rate_variance * np.eye(3) + known.rotation_spread,
    }


def test_a_known_force_is_followed_by_a_kalman_filter(bench: Bench) -> None:
    # rates alone tell: the velocity's noise is a million times that of the sensors. Against the information
    # form with the sensors' noise, which knows nothing of the innovation's covariance
    with_known(bench, STUCK, 860.0, 1.0)
    c = bench.signatures[STUCK]
    force, information = 860.0, 1.0
    rng = np.random.default_rng(8)
    for _ in range(5):
        noise = np.append(np.zeros(3), np.sqrt(RATE_VARIANCE) * rng.normal(size=3))
        innovation = (860.6 - bench.state.force[STUCK]) * c + noise
        result = bench.step(innovation, **grown(bench, 1e6 * VELOCITY_VARIANCE, RATE_VARIANCE))
        assert not result.finding.alarm
        seen = c[3:] @ innovation[3:] / RATE_VARIANCE
        information += c[3:] @ c[3:] / RATE_VARIANCE
        force += seen / information
        # the velocity's part is a millionth of a part of a hundred thousandth
        np.testing.assert_allclose(bench.state.force[STUCK], force, rtol=1e-9)
        np.testing.assert_allclose(bench.state.variance[STUCK], 1.0 / information, rtol=1e-6)


def test_velocity_and_rate_both_tell_of_a_known_force(bench: Bench) -> None:
    # an accelerometer and a gyro that each know the force to 1 lbf in a sample: from a variance of 1 lbf^2
    # the information is 1 + 1 + 1 afterwards, the gain of a unit force's innovation 1/3 + 1/3
    with_known(bench, STUCK, 860.0, 1.0)
    c = bench.signatures[STUCK]
    result = bench.step(0.3 * c, **grown(bench, float(c[:3] @ c[:3]), float(c[3:] @ c[3:])))
    assert not result.finding.alarm
    np.testing.assert_allclose(bench.state.variance[STUCK], 1.0 / 3.0, rtol=1e-9)
    np.testing.assert_allclose(bench.state.force[STUCK], 860.0 + 0.3 * 2.0 / 3.0, rtol=1e-9)


def test_the_variance_of_a_known_force_has_a_floor(bench: Bench) -> None:
    with_known(bench, STUCK, 868.8, 1.0)
    for _ in range(300):
        bench.step(QUIET, **grown(bench, VELOCITY_VARIANCE, RATE_VARIANCE))
    # 300 samples of 0.97 lbf would know it to 0.056 lbf
    assert bench.state.variance[STUCK] == bench.params.force_variance_floor == (1e-4 * 888.646) ** 2
    assert bench.state.force[STUCK] == 868.8


def test_a_known_force_is_not_followed_on_samples_that_are_not_tested(bench: Bench) -> None:
    with_known(bench, STUCK, 868.8, 1.0)
    bench.step(2.0 * bench.signatures[STUCK], usable=False)
    assert (bench.state.force[STUCK], bench.state.variance[STUCK]) == (868.8, 1.0)


def test_an_alarm_about_a_known_force_corrects_it(bench: Bench) -> None:
    with_known(bench, STUCK, 868.8, 0.01)
    finding = bench.step(-400.0 * bench.signatures[STUCK]).finding
    # that the jet is off does not matter: what it gives is known to be some hundred pounds
    assert finding.alarm
    assert finding.isolation.jet == STUCK
    assert finding.event == Verdict.NOTHING
    np.testing.assert_allclose(bench.state.force[STUCK], 468.8, rtol=1e-9)
    c = bench.signatures[STUCK]
    np.testing.assert_allclose(bench.state.variance[STUCK], 1.0 / (c @ bench.information @ c), rtol=1e-9)
    # it is no suspicion of a new failure
    assert bench.state.cluster == -1.0


def test_a_known_force_that_has_ceased_is_withdrawn(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    bench.number = 20
    result = bench.step(-868.0 * bench.signatures[STUCK])
    assert result.finding.event == Verdict.WITHDRAWN
    np.testing.assert_allclose(result.finding.onset_s, 20 * PERIOD_S, rtol=1e-12)
    assert not bench.state.force.any()
    assert not bench.state.variance.any()
    assert bench.state.removed[STUCK] == 1.0  # a jet that failed once is not used again
    # the sample itself is corrected like that of any alarm
    np.testing.assert_allclose(result.adaptation.rotation, -868.0 * bench.signatures[STUCK][3:], rtol=1e-9)


@pytest.mark.parametrize(
    ("left", "event"), [(2.9, Verdict.WITHDRAWN), (3.1, Verdict.NOTHING), (-2.9, Verdict.WITHDRAWN)]
)
def test_a_known_force_is_withdrawn_below_three_sigma(bench: Bench, left: float, event: int) -> None:
    with_known(bench, STUCK, 868.8, 0.01)
    c = bench.signatures[STUCK]
    sigma = (c @ bench.information @ c) ** -0.5  # of the force by one sample
    finding = bench.step((left * sigma - 868.8) * c).finding
    assert finding.event == event
    expected = 0.0 if event == Verdict.WITHDRAWN else left * sigma
    np.testing.assert_allclose(bench.state.force[STUCK], expected, rtol=1e-9, atol=1e-12)


def test_a_declared_and_a_corrected_force_are_not_known_better_than_the_floor(orbiter: Vehicle) -> None:
    bench = Bench(orbiter, force_variance_floor=400.0)  # a sample knows the force to about 1 lbf
    bench.declare(STUCK, 868.8)
    assert bench.state.variance[STUCK] == 400.0
    bench.step(-400.0 * bench.signatures[STUCK])
    np.testing.assert_allclose(bench.state.force[STUCK], 468.8, rtol=1e-9)
    assert bench.state.variance[STUCK] == 400.0


def test_a_known_force_that_has_ceased_is_withdrawn_though_a_healthy_jet_could_explain_it(bench: Bench) -> None:
    # a jet of cluster 8 pushing with 13 lbf looks much like jet 15 no longer pushing with 50; but the one is known
    # to have failed, and a force that is no longer there must not be made up for
    with_known(bench, 14, 50.0, 0.01)
    events = []
    for _ in range(5):
        result = bench.step(-bench.state.force[14] * bench.signatures[14])
        assert result.finding.isolation.jet == 14
        events.append(result.finding.event)
        if events[-1] == Verdict.WITHDRAWN:
            break
    assert events[-1] == Verdict.WITHDRAWN
    assert not bench.state.force.any()


def test_a_withdrawn_force_can_be_declared_again(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    bench.step(-868.8 * bench.signatures[STUCK])
    bench.declare(STUCK, 868.8)
    np.testing.assert_allclose(bench.state.force[STUCK], 868.8, rtol=1e-12)


def test_another_failure_is_found_while_a_force_is_known(bench: Bench) -> None:
    bench.declare(STUCK, 868.8)
    bench.declare(LOST, -874.2)
    np.testing.assert_allclose(bench.state.force[STUCK], 868.8, rtol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(bench.state.removed), [LOST, STUCK])


# ------------------------------------------------------------------------------------ uncertain signatures


def test_uncertain_estimates_keep_the_detector_from_naming_the_neighbor(orbiter: Vehicle) -> None:
    # the arms of the aft jets are believed 1.08 ft short, which is one sigma: jet 30 seems to have the arm
    # of jet 29
    spread = Bench(orbiter).sure
    spread[6, 6] = 1.08**2
    believed = orbiter.nominal.vector()
    believed[6] -= 1.08
    about = {"mass_properties": believed, "state_covariance": spread}
    unaware = Bench(orbiter, unexplained_limit=np.inf, limits=2.0 * LIMITS).failing(STUCK, 868.8, **about).finding
    assert (unaware.isolation.jet, unaware.jet_isolated) == (NEIGHBOR, True)
    aware = Bench(orbiter, signature_uncertainty=True, limits=2.0 * LIMITS).failing(STUCK, 868.8, **about).finding
    assert aware.alarm
    assert aware.isolation.cluster == 12
    assert not aware.jet_isolated


# ------------------------------------------------------------------------------- considered thrust errors


def erring(bench: Bench, jet: int, velocity_variance: float = VELOCITY_VARIANCE) -> dict[str, Any]:
    """A jet that fires, its thrust known to 1 %: what its error adds to the covariances."""
    effects = np.zeros((2, 3, N))
    effects[:, :, jet] = 0.01 * THRUSTS[jet] * bench.signatures[jet].reshape(2, 3)
    return {
        "command": np.eye(N)[jet],
        "firing": True,
        "translation_covariance": velocity_variance * np.eye(3) + effects[0] @ effects[0].T,
        "rotation_covariance": RATE_VARIANCE * np.eye(3) + effects[1] @ effects[1].T,
        "shared_covariance": shared_covariance(effects[0], effects[1]),
    }


def test_what_translation_and_rotation_share_of_thrust_errors() -> None:
    rng = np.random.default_rng(10)
    translation, rotation = rng.normal(size=(2, 3, 5))
    expected = sum(np.outer(translation[:, jet], rotation[:, jet]) for jet in range(5))
    np.testing.assert_allclose(shared_covariance(translation, rotation), expected, rtol=1e-13)
    for nothing in ((None, rotation), (translation, None), (None, None), (translation, np.zeros((3, 5)))):
        assert shared_covariance(*nothing) is None


@pytest.mark.parametrize("uncertain", [False, True])
def test_tests_with_a_shared_covariance_against_the_full_form_jet_by_jet(orbiter: Vehicle, *, uncertain: bool) -> None:
    bench = Bench(orbiter, signature_uncertainty=uncertain, unexplained_limit=np.inf)
    rng = np.random.default_rng(11)
    effects = rng.normal(size=(2, 3, 6))
    effects[0] *= 2.0 * np.sqrt(VELOCITY_VARIANCE)
    effects[1] *= 2.0 * np.sqrt(RATE_VARIANCE)
    blocks = [variance * np.eye(3) for variance in (VELOCITY_VARIANCE, RATE_VARIANCE)]
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = blocks
    stacked = np.vstack([effects[0], effects[1]])
    whole += stacked @ stacked.T
    innovation = 200.0 * bench.signatures[STUCK] + np.linalg.cholesky(whole) @ rng.normal(size=6)
    given = filters(
        bench,
        innovation,
        command=np.full(N, 1.0),  # so that no sign is ruled out
        translation_covariance=whole[:3, :3],
        rotation_covariance=whole[3:, 3:],
        shared_covariance=shared_covariance(effects[0], effects[1]),
    )
    tests = judged(bench.state, evidence(**given), bench.params).tests
    scale = np.sqrt(whole.diagonal())
    plain = whole / np.outer(scale, scale)
    e = innovation / scale
    for jet, c in enumerate(bench.signatures / scale):
        grown = plain
        if uncertain:
            force = c @ np.linalg.solve(plain, e) / (c @ np.linalg.solve(plain, c))
            wrench = bench.params.unit_wrenches[jet] * PERIOD_S
            h = rate_increment_jacobian(bench.properties[:9], wrench[:3], wrench[3:])
            spread = np.zeros((6, 6))
            spread[:3, :3] = given["mass_estimate"][1] * np.outer(wrench[3:], wrench[3:])
            spread[3:, 3:] = h @ given["state_covariance"] @ h.T
            grown = plain + force**2 * spread / np.outer(scale, scale)
        information = np.linalg.inv(grown)
        strength = c @ information @ c
        magnitude = c @ information @ e / strength
        left = e @ information @ e - magnitude**2 * strength
        likelihood = e @ np.linalg.inv(plain) @ e - left - np.log(np.linalg.det(grown) / np.linalg.det(plain))
        total = e @ np.linalg.inv(plain) @ e
        np.testing.assert_allclose(tests.magnitude[jet], magnitude, rtol=1e-7)
        np.testing.assert_allclose(tests.variance[jet], 1.0 / strength, rtol=1e-7)
        np.testing.assert_allclose(tests.likelihood[jet], max(likelihood, 0.0), rtol=1e-7, atol=1e-9 * total)
        np.testing.assert_allclose(tests.unexplained[jet], left, rtol=1e-7, atol=1e-9 * total)


def test_a_jet_that_is_off_by_its_usual_error_raises_no_alarm(bench: Bench) -> None:
    # 2.5 sigma of 1 %, 21.7 lbf: for a known thrust a failure beyond doubt, here 2.5^2 = 6.25 of one sigma
    usual = 0.025 * THRUSTS[STUCK] * bench.signatures[STUCK]
    for sign in (1.0, -1.0):
        result = bench.step(sign * usual, **erring(bench, STUCK))
        assert result.finding.tested
        assert not result.finding.alarm
        assert result.finding.event == Verdict.NOTHING
        assert result.adaptation == adaptation.NO_ADAPTATION
        # 1-sigma 8.7 lbf of the thrust and 0.97 lbf of the sensors: 21.7^2 / (8.7^2 + 0.97^2)
        np.testing.assert_allclose(result.tests.likelihood[STUCK], 6.17, rtol=2e-3)
        naive = bench.step(sign * usual, command=np.eye(N)[STUCK], firing=True)
        assert naive.finding.isolation.jet == STUCK
        assert naive.adaptation.action != adaptation.Action.NONE
        assert naive.finding.alarm == (sign > 0.0)  # too little of it could be the opposite jet's doing


@pytest.mark.parametrize("jet", [LOST, STUCK])
def test_a_jet_that_fails_while_thrust_is_uncertain_is_found(bench: Bench, jet: int) -> None:
    for _ in range(2):
        finding = bench.step(-THRUSTS[jet] * bench.signatures[jet], **erring(bench, jet)).finding
        assert finding.alarm
        assert finding.isolation.jet == jet
        # its thrust is known to 1 %, the sensors tell 0.84 and 0.97 lbf (reference, figures 5-16 to 5-21)
        sensed = {LOST: 0.84, STUCK: 0.97}[jet]
        np.testing.assert_allclose(finding.magnitude_std, np.hypot(0.01 * THRUSTS[jet], sensed), rtol=1e-3)
    assert finding.event == Verdict.DECLARED


def test_a_usual_error_in_translation_and_rotation_is_one_chance_and_not_two(bench: Bench) -> None:
    # an accelerometer as good as the gyro. Both are off by 2.5 sigma together, as one jet's thrust makes them:
    # e^T Y^-1 e = 2.5^2 with the shared block, twice that without it
    about = erring(bench, STUCK, velocity_variance=1e-12)
    usual = 0.025 * THRUSTS[STUCK] * bench.signatures[STUCK]
    for shared, expected in ((about["shared_covariance"], 2.5**2), (None, 2.0 * 2.5**2)):
        tests = bench.step(usual, **(about | {"shared_covariance": shared})).tests
        np.testing.assert_allclose(tests.likelihood[STUCK] + tests.unexplained[STUCK], expected, rtol=0.02)


@pytest.mark.parametrize(
    ("likelihood", "bearing", "threshold", "alarm"),
    [
        (14.0, False, 16.0, True),  # no thrust error bears on the sample: the margin of six alone
        (14.0, True, 16.0, False),
        (18.0, True, 16.0, True),
        (14.0, True, 0.0, True),
        (18.0, True, 20.0, False),
    ],
)
def test_the_dispersion_threshold_holds_where_thrust_errors_bear(
    orbiter: Vehicle, likelihood: float, threshold: float, *, bearing: bool, alarm: bool
) -> None:
    # vernier 39 leads the next cluster by half of its argument (reference, figure 5-22)
    bench = Bench(orbiter, dispersion_threshold=threshold)
    c = bench.signatures[VERNIER]
    force = np.sqrt(likelihood / (c @ bench.information @ c))
    faint = 1e-12 * np.sqrt(VELOCITY_VARIANCE * RATE_VARIANCE) * np.ones((3, 3))
    finding = bench.failing(VERNIER, force, shared_covariance=faint if bearing else None).finding
    assert finding.isolation.cluster_margin > 6.0
    assert finding.alarm == alarm


def test_the_larger_of_both_thresholds_holds(orbiter: Vehicle) -> None:
    # the leak of jet 24 has 260 (reference, figure 5-25)
    for threshold, alarm in ((259.0, True), (262.0, False)):
        bench = Bench(orbiter, threshold=threshold, dispersion_threshold=16.0)
        faint = 1e-12 * np.sqrt(VELOCITY_VARIANCE * RATE_VARIANCE) * np.ones((3, 3))
        assert bench.failing(23, 10.365, shared_covariance=faint).finding.alarm == alarm


@pytest.mark.parametrize("missing", ["translation", "rotation"])
def test_an_innovation_that_was_not_measured_is_not_tested_whatever_thrust_does(bench: Bench, missing: str) -> None:
    about = erring(bench, LOST) | {missing: np.full(3, np.nan), f"{missing}_covariance": np.full((3, 3), np.nan)}
    result = bench.step(-THRUSTS[LOST] * bench.signatures[LOST], **about)
    assert not result.finding.tested
    assert np.isnan(result.tests.likelihood).all()
    assert result.adaptation == adaptation.NO_ADAPTATION


def test_a_shared_covariance_that_cannot_be_is_reported(bench: Bench) -> None:
    about = erring(bench, LOST, velocity_variance=1e-12)
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance"):
        bench.step(QUIET, **(about | {"shared_covariance": 2.0 * about["shared_covariance"]}))


# ---------------------------------------------------------------------------- from the filters, and to logs


def filters(bench: Bench, innovation: Array, **changes: Any) -> dict[str, Any]:
    """What filters hand over that know their estimates to a part in a thousand or a hundred."""
    deviation = np.concatenate([0.001 * bench.properties[:3], np.full(3, 1e-10), np.full(3, 0.01)])
    unsure = {
        "time_s": 1.6,
        "state_covariance": np.diag(deviation**2),
        "mass_estimate": np.array([bench.properties[9], (0.01 * bench.properties[9]) ** 2, 1.0, 2.0]),
    }
    return bench.given(innovation, **(unsure | changes))


def test_what_the_filters_know_makes_the_sample(orbiter: Vehicle) -> None:
    bench = Bench(orbiter, signature_uncertainty=True)
    innovation = 868.8 * bench.signatures[STUCK] + bench.unexplained(STUCK, 3.0)
    given = filters(bench, innovation)
    ours = judged(bench.state, evidence(**given), bench.params)
    covariance = np.diag([VELOCITY_VARIANCE] * 3 + [RATE_VARIANCE] * 3)
    sample = DetectorSample(
        time_s=1.6,
        command=np.zeros(N),
        firing=False,
        innovation=innovation,
        covariance=covariance,
        information=np.linalg.inv(covariance),
        thrust_errors=False,
        mass_properties=bench.properties,
        parameter_covariance=joint_covariance(given["state_covariance"], given["mass_estimate"][1]),
        cross_covariance=np.zeros((6, 10)),
    )
    theirs = cycle(bench.state, sample, bench.params)
    np.testing.assert_allclose(status(ours), status(theirs), rtol=1e-9)
    for mine, other in zip(ours.tests, theirs.tests, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-8, atol=1e-8 * np.abs(other).max())
    np.testing.assert_allclose(adaptation.packed(ours.adaptation), adaptation.packed(theirs.adaptation), rtol=1e-9)


@pytest.mark.parametrize(
    "poor",
    [
        {"state_covariance": np.diag([(0.03 * 1.14e-6) ** 2, *[1e-16] * 2, *[1e-20] * 3, *[1e-4] * 3])},
        {"state_covariance": np.diag([*[1e-20] * 6, 1e-4, 1e-4, 1.1])},
        {"mass_estimate": np.array([1.69e-4, (0.21 * 1.69e-4) ** 2])},
        {"mass_estimate": np.array([-1.69e-4, 1e-12])},
    ],
    ids=["diagonal", "center of mass", "mass reciprocal", "negative mass"],
)
def test_nothing_is_tested_before_the_estimates_have_converged(bench: Bench, poor: dict[str, Any]) -> None:
    innovation = 868.8 * bench.signatures[STUCK]
    assert judged(bench.state, evidence(**filters(bench, innovation)), bench.params).finding.alarm
    guarded = judged(bench.state, evidence(**filters(bench, innovation, **poor)), bench.params)
    assert not guarded.finding.tested


def test_a_covariance_that_lost_definiteness_is_reported(bench: Bench) -> None:
    bad = filters(bench, QUIET, rotation_covariance=np.diag([1.0, -1.0, 1.0]))
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance"):
        judged(bench.state, evidence(**bad), bench.params)


def test_the_log_of_a_cycle(bench: Bench) -> None:
    bench.number = 4
    bench.failing(STUCK, 868.819)
    result = bench.failing(STUCK, 868.819)
    expected = [
        1.0,  # tested
        1.0,  # alarm
        1.0,  # declared
        12.0,  # cluster
        28.0,  # jet
        1.0,  # isolated
        868.819,
        0.967,  # lbf, 1-sigma; this and the next three: reference, figures 5-16 to 5-18
        806_646.0,
        17_805.5,
        288.97,
        0.0,
        4 * PERIOD_S,
        2.0,  # alarms
    ]
    np.testing.assert_allclose(status(result), expected, rtol=1e-3, atol=1e-6)


def test_packing_a_state_and_back() -> None:
    rng = np.random.default_rng(9)
    state = DetectorState(12.0, 2.0, 1.0, 50.08, rng.normal(size=6), *rng.normal(size=(4, N)))
    layout = LAYOUT.sized(jets=N)
    vector = layout.pack(state)
    assert vector.shape == (10 + 4 * N,)
    for ours, theirs in zip(layout.read(vector), state, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    start = layout.read(layout.pack(initial_state(N)))
    assert start.cluster == -1.0
    assert not any(np.any(part) for part in start[1:])


def test_alarms_that_push_opposite_ways_are_not_a_row(bench: Bench) -> None:
    # one bad reading enters two increments with opposite signs: two alarms, but no failure
    bench.failing(STUCK, 400.0)
    second = bench.failing(STUCK, -400.0)
    assert second.finding.alarm
    assert second.finding.event == Verdict.NOTHING
    assert second.finding.alarms == 1.0
    assert bench.failing(STUCK, -400.0).finding.event == Verdict.DECLARED


def test_a_tie_of_opposed_jets_is_declared_as_the_loss_of_the_one_that_is_told_to_fire(orbiter: Vehicle) -> None:
    bench = Bench(orbiter)
    opposed, losing = STUCK + 1, STUCK + 2  # of one cluster; the first of equals is the likeliest
    wrenches = bench.params.unit_wrenches.copy()
    wrenches[opposed] = -wrenches[losing]
    bench.params = bench.params._replace(unit_wrenches=wrenches)
    bench.signatures = signatures(wrenches, bench.properties, PERIOD_S)
    first = bench.failing(losing, -868.8)
    assert first.finding.magnitude > 0.0
    declared = bench.failing(losing, -868.8).finding
    assert declared.event == Verdict.DECLARED
    assert declared.isolation.jet == losing
    assert declared.magnitude == pytest.approx(-868.8, rel=1e-9)
    assert not bench.state.force.any()
    assert bench.state.removed[[opposed, losing]].all()
    # were it the other one after all, it would show once both rest, and be declared as stuck on
    bench.failing(opposed, 868.8)
    assert bench.failing(opposed, 868.8).finding.event == Verdict.DECLARED
    assert bench.state.force[opposed] == pytest.approx(868.8, rel=1e-9)


def test_a_jet_stuck_on_gives_no_more_when_it_is_told_to_fire(bench: Bench) -> None:
    bench.declare(STUCK, 868.819)
    told = np.zeros(N)
    told[STUCK] = 1.0
    resting = known_force(bench.state, bench.properties, np.zeros(N), bench.params)
    firing = known_force(bench.state, bench.properties, told, bench.params)
    np.testing.assert_allclose(np.linalg.norm(resting.wrench[3:]), 868.819, rtol=1e-9)
    assert not firing.wrench.any()
    assert not firing.rotation_spread.any()
    # nor does such a sample say anything about the force
    before = bench.state.force[STUCK], bench.state.variance[STUCK]
    bench.step(0.5 * bench.signatures[STUCK], command=told, firing=True)
    assert (bench.state.force[STUCK], bench.state.variance[STUCK]) == before


def test_a_leak_comes_on_top_of_what_is_commanded(bench: Bench) -> None:
    bench.declare(STUCK, 60.0)
    told = np.zeros(N)
    told[STUCK] = 1.0
    firing = known_force(bench.state, bench.properties, told, bench.params)
    np.testing.assert_allclose(np.linalg.norm(firing.wrench[3:]), 60.0, rtol=1e-9)
