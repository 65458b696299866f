"""Cumulative sums: by hand, in noise, and as a detector of the diagram, the estimator and the record alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from params_probe import evidence

from massprop_drake import Scenario, Vehicle, estimate, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.maths.estimation.adaptation import Action
from massprop_drake.maths.estimation.detector import Evidence, Judgment, Verdict
from massprop_drake.maths.estimation.detectors import DETECTORS
from massprop_drake.maths.estimation.detectors.cusum import CusumParams, CusumState
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.linear_algebra import Array

N, STUCK, PERIOD_S = 44, 28, 0.08
VARIANCES = np.repeat([0.0344**2 / 6.0, 1.52e-6**2 / 6.0], 3)  # of velocity and rate increments, section 5.5
DETECTOR = DETECTORS["cusum"]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("stuck_on_29", ["detector={kind: cusum, drift: 1.0, threshold: 20.0}"])


@pytest.fixture(scope="module")
def chosen(scenario: Scenario) -> CusumParams:
    made: CusumParams = DETECTOR.params(params.jets(scenario), scenario.detector)
    return made


class Bench:
    """The detector of the orbiter, sure of the mass properties, fed with innovations made up for the purpose."""

    def __init__(self, vehicle: Vehicle, chosen: CusumParams):
        self.params = chosen
        self.properties = vehicle.nominal.vector()
        self.signatures = signatures(chosen.unit_wrenches, self.properties, PERIOD_S)
        self.state: CusumState = DETECTOR.initial(chosen)
        self.sample = 0

    def seen(self, innovation: Array, command: Array | None = None, *, usable: bool = True) -> Evidence:
        return evidence(
            time_s=self.sample * PERIOD_S,
            command=np.zeros(N) if command is None else command,
            usable=usable,
            firing=command is not None,
            translation=innovation[:3],
            rotation=innovation[3:],
            translation_covariance=np.diag(VARIANCES[:3]),
            rotation_covariance=np.diag(VARIANCES[3:]),
            rotation_estimate=self.properties[:9],
            state_covariance=np.diag(np.append((1e-9 * self.properties[:3]) ** 2, np.zeros(6))),
            mass_estimate=np.array([self.properties[9], (1e-9 * self.properties[9]) ** 2]),
        )

    def step(self, innovation: Array, command: Array | None = None, *, usable: bool = True) -> Judgment:
        self.sample += 1
        judgment = DETECTOR.judge(self.state, self.seen(innovation, command, usable=usable), self.params)
        self.state = judgment.state
        return judgment

    def deviations(self, jet: int, count: float) -> Array:
        """The innovation by which a jet pushes so many standard deviations too much."""
        c = self.signatures[jet]
        pushed: Array = count * c / np.sqrt(c @ (c / VARIANCES))
        return pushed


@pytest.fixture
def bench(orbiter: Vehicle, chosen: CusumParams) -> Bench:
    return Bench(orbiter, chosen)


def test_sums_by_hand(bench: Bench) -> None:
    # three samples of 4, 0.5 and 2.5 standard deviations, drift 1: 3, 2.5, 4
    for size, expected in ((4.0, 3.0), (0.5, 2.5), (2.5, 4.0)):
        judgment = bench.step(bench.deviations(STUCK, size))
        np.testing.assert_allclose(judgment.likelihood[STUCK], expected, rtol=1e-12)
    c = bench.signatures[STUCK]
    strength = c @ (c / VARIANCES)
    np.testing.assert_allclose(judgment.magnitude[STUCK], (4.0 + 0.5 + 2.5) / 3.0 / np.sqrt(strength), rtol=1e-12)
    assert judgment.status.detector_event == Verdict.NOTHING


def test_a_sum_that_falls_to_zero_begins_anew(bench: Bench) -> None:
    bench.step(bench.deviations(STUCK, 2.0))
    bench.step(bench.deviations(STUCK, -5.0))
    assert bench.state.sums[0, STUCK] == 0.0
    assert bench.state.strength[0, STUCK] == 0.0
    assert bench.state.onset_s[0, STUCK] == 2 * PERIOD_S


def test_a_jet_that_rests_cannot_give_too_little(bench: Bench) -> None:
    for _ in range(20):
        judgment = bench.step(bench.deviations(STUCK, -4.0))
    assert bench.state.sums[1, STUCK] == 0.0
    told = np.eye(N)[STUCK]
    before = bench.state.sums[1, STUCK]
    judgment = bench.step(bench.deviations(STUCK, -4.0), told)
    np.testing.assert_allclose(bench.state.sums[1, STUCK] - before, 3.0, rtol=1e-12)
    assert judgment.status.tested == 1.0


def test_it_is_declared_and_all_sums_begin_anew(bench: Bench) -> None:
    judgment = bench.step(868.8 * bench.signatures[STUCK])
    assert judgment.status.detector_event == Verdict.DECLARED
    assert judgment.status.suspected_jet == STUCK
    np.testing.assert_allclose(judgment.status.suspected_magnitude, 868.8, rtol=1e-9)
    assert not bench.state.sums.any()
    assert bench.state.removed[STUCK] == 1.0
    np.testing.assert_allclose(bench.state.force[STUCK], 868.8, rtol=1e-9)
    # what is known is not declared again
    assert bench.step(868.8 * bench.signatures[STUCK]).status.suspected_jet != STUCK


@pytest.mark.parametrize(("size", "declared"), [(20.9, False), (21.1, True)])
def test_a_sum_declares_above_the_threshold_and_its_sample_teaches_nothing(
    bench: Bench, size: float, *, declared: bool
) -> None:
    # drift 1, threshold 20
    judgment = bench.step(bench.deviations(STUCK, size))
    assert judgment.status.alarm == declared
    assert judgment.status.detector_event == (Verdict.DECLARED if declared else Verdict.NOTHING)
    assert judgment.adaptation.action == (Action.REJECT if declared else Action.NONE)


def test_a_sample_that_cannot_be_tested_changes_nothing(bench: Bench) -> None:
    bench.step(bench.deviations(STUCK, 4.0))
    before = bench.state
    assert bench.step(868.8 * bench.signatures[STUCK], usable=False).status.tested == 0.0
    assert np.isnan(bench.step(np.full(6, np.nan)).likelihood).all()
    assert bench.state is before


def test_noise_is_declared_rarely(bench: Bench) -> None:
    rng = np.random.default_rng(3)
    largest = 0.0
    for _ in range(2000):
        judgment = bench.step(np.sqrt(VARIANCES) * rng.standard_normal(6))
        assert judgment.status.detector_event == Verdict.NOTHING
        largest = max(largest, float(judgment.likelihood.max()))
    # with k = 1 the odds of a sum beyond h fall as e^(-2 h): some ln(2000 x 44) / 2 = 5.7 is the largest of all
    assert 3.0 < largest < 9.0


@pytest.mark.parametrize(
    ("name", "jet", "sign"),
    [("stuck_on_29", "R4R", 1.0), ("stuck_off_11", "F2R", -1.0), ("leak_24", "L4D", 1.0)],
)
def test_it_finds_the_failures_of_the_bundled_scenarios(name: str, jet: str, sign: float, tmp_path: Path) -> None:
    overrides = [
        "duration_s=53",
        "execution.engine=loop",
        "estimation={filter: thesis, start: nominal, std_fraction: 0.001}",
    ]
    case = load_scenario(name, overrides)
    case = case.model_copy(update={"detector": load_scenario(name, ["detector={kind: cusum}"]).detector})
    run = simulate(case)
    (entry,) = run.summary["detections"]
    vehicle = case.vehicle_data
    assert entry["cluster"] == vehicle.jets[vehicle.jet_index(jet)].cluster
    assert entry["jet"] in (jet, None)
    assert np.sign(entry["magnitude"]) == sign
    assert 50.0 <= entry["time_s"] <= 51.0
    # from its record, without Drake, the same
    run.save(tmp_path / "run", pictures=False, report=False)
    again = estimate(tmp_path / "run" / "telemetry.csv", case)
    np.testing.assert_array_equal(again["likelihood"], run["likelihood"])
    np.testing.assert_array_equal(again["known_force"], run["known_force"])
    assert again.summary["detections"] == run.summary["detections"]


def test_keys_of_another_detector_are_refused() -> None:
    with pytest.raises(ValueError, match=r"detector\.margin: is a key of kind: cglr"):
        load_scenario("stuck_on_29", ["detector={kind: cusum, margin: 6.0}"])
    with pytest.raises(ValueError, match="kind 'cusun' is not one of cglr, off, cusum"):
        load_scenario("stuck_on_29", ["detector={kind: cusun}"])
