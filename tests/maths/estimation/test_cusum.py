"""Cumulative sums: by hand, in noise, and in flight."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import sure_evidence

from massprop_drake import Scenario, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.adaptation import Action
from massprop_drake.maths.estimation.detector import Judgment, Verdict
from massprop_drake.maths.estimation.detectors import DETECTORS
from massprop_drake.maths.estimation.detectors.cusum import CusumState
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.linear_algebra import Array

STUCK, PERIOD_S = 28, 0.08
VARIANCES = np.repeat([0.0344**2 / 6.0, 1.52e-6**2 / 6.0], 3)  # of velocity and rate increments, section 5.5
DETECTOR, TOLD = DETECTORS["cusum"], np.eye(44)[STUCK]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("stuck_on_29", ["detector={kind: cusum, drift: 1.0, threshold: 20.0}"])


class Bench:
    """The detector of the orbiter, sure of the mass properties, fed with innovations made up for the purpose."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario):
        self.params = DETECTOR.params(params.known_jets(scenario), scenario.detector)
        self.properties = vehicle.nominal.vector()
        self.signature = signatures(self.params.unit_wrenches, self.properties, PERIOD_S)[STUCK]
        self.strength = float(self.signature @ (self.signature / VARIANCES))
        self.state: CusumState = DETECTOR.initial(self.params)
        self.sample = 0

    def step(self, innovation: Array, command: Array | None = None, *, usable: bool = True) -> Judgment:
        self.sample += 1
        about = {"usable": usable} | ({} if command is None else {"command": command, "firing": True})
        seen = sure_evidence(self.sample * PERIOD_S, innovation, self.properties, np.diag(VARIANCES), **about)
        judgment = DETECTOR.judge(self.state, seen, self.params)
        self.state = judgment.state
        return judgment

    def pushed(self, count: float, command: Array | None = None) -> Judgment:
        """The next cycle, in which the jet pushes so many standard deviations too much."""
        return self.step(count / np.sqrt(self.strength) * self.signature, command)


@pytest.fixture
def bench(orbiter: Vehicle, scenario: Scenario) -> Bench:
    return Bench(orbiter, scenario)


def test_sums_by_hand(bench: Bench) -> None:
    # three samples of 4, 0.5 and 2.5 standard deviations, drift 1: 3, 2.5, 4
    for size, expected in ((4.0, 3.0), (0.5, 2.5), (2.5, 4.0)):
        judgment = bench.pushed(size)
        assert_allclose(judgment.likelihood[STUCK], expected, rtol=1e-12)
    magnitude = (4.0 + 0.5 + 2.5) / 3.0 / np.sqrt(bench.strength)
    assert_allclose(judgment.magnitude[STUCK], magnitude, rtol=1e-12)
    assert judgment.status.detector_event == Verdict.NOTHING
    assert_allclose(judgment.status.suspected_magnitude_std, (3.0 * bench.strength) ** -0.5, rtol=1e-12)
    assert judgment.status.onset == 0.0
    bench.pushed(-5.5)  # a sum that falls to zero begins anew
    state = bench.state
    assert (state.sums[0, STUCK], state.projection[0, STUCK], state.strength[0, STUCK]) == (0.0, 0.0, 0.0)
    assert state.onset_s[0, STUCK] == 4 * PERIOD_S


def test_a_jet_that_rests_cannot_give_too_little(bench: Bench) -> None:
    for _ in range(20):
        judgment = bench.pushed(-4.0)
    assert bench.state.sums[1, STUCK] == 0.0
    judgment = bench.pushed(-4.0, TOLD)
    assert_allclose(bench.state.sums[1, STUCK], 3.0, rtol=1e-12)
    assert judgment.status.tested == 1.0


def test_it_is_declared_and_all_sums_begin_anew(bench: Bench) -> None:
    judgment = bench.step(868.8 * bench.signature)
    status = judgment.status
    assert (status.detector_event, status.suspected_jet, status.jet_isolated) == (Verdict.DECLARED, STUCK, 0.0)
    assert not bench.state.sums.any()
    # the jets of its cluster whose sums are above the threshold too cannot be told from it
    alike = (bench.params.clusters == 12) & (judgment.likelihood > 20.0)
    assert_array_equal(bench.state.removed, alike)
    assert alike[STUCK]
    assert_allclose([status.suspected_magnitude, bench.state.force[STUCK]], 868.8, rtol=1e-9)
    assert_allclose(bench.state.variance[STUCK], 1.0 / bench.strength, rtol=1e-9)
    # what is known is not declared again
    assert bench.step(868.8 * bench.signature).status.suspected_jet != STUCK


def test_a_loss_of_thrust_is_declared_and_gives_no_known_force(bench: Bench) -> None:
    status = bench.step(-868.8 * bench.signature, TOLD).status
    assert (status.detector_event, status.suspected_jet) == (Verdict.DECLARED, STUCK)
    assert_allclose(status.suspected_magnitude, -868.8, rtol=1e-9)
    assert not bench.state.force.any()


@pytest.mark.parametrize(("size", "declared"), [(20.9, False), (21.1, True)])
def test_a_sum_declares_above_the_threshold_and_its_sample_teaches_nothing(
    bench: Bench, size: float, *, declared: bool
) -> None:
    judgment = bench.pushed(size)  # drift 1, threshold 20
    assert judgment.status.alarm == declared
    assert judgment.status.detector_event == (Verdict.DECLARED if declared else Verdict.NOTHING)
    assert judgment.adaptation.action == (Action.REJECT if declared else Action.NONE)


def test_a_sample_that_cannot_be_tested_changes_nothing(bench: Bench) -> None:
    bench.pushed(4.0)
    before = bench.state
    assert bench.step(868.8 * bench.signature, usable=False).status.tested == 0.0
    assert np.isnan(bench.step(np.full(6, np.nan)).likelihood).all()
    assert bench.state is before


def test_noise_is_declared_rarely(bench: Bench) -> None:
    # with k = 1 the odds of a sum beyond h fall as e^(-2 h): some ln(1000 x 44) / 2 = 5.3 is the largest of all
    noise = np.sqrt(VARIANCES) * np.random.default_rng(3).standard_normal((1000, 6))
    assert 3.0 < max(float(bench.step(each).likelihood.max()) for each in noise) < 9.0


def test_it_finds_a_failure_in_flight() -> None:
    overrides = [
        "duration_s=14",
        "execution.engine=loop",
        "estimation={filter: thesis, start: nominal, std_fraction: 0.001}",
        "failures=[{kind: stuck_on, jet: R4R, start_s: 12}]",
        "detector={kind: cusum}",
    ]
    (entry,) = simulate(load_scenario("stuck_on_29", overrides)).summary["detections"]
    assert (entry["cluster"], entry["kind"]) == (12, "jet_on")
    assert entry["jet"] in ("R4R", None)
    assert 12.0 <= entry["time_s"] <= 13.0
