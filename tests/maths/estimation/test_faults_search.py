"""Jets that fail while the start has not converged: hypotheses with weights, from the start gone over anew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from faults_probe import known_vehicle, make_params, samples_of

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.faults.fault_events import Way
from massprop_drake.maths.estimation.faults.passes import begin_fit, step_fit
from massprop_drake.maths.estimation.faults.priors import Params, Priors
from massprop_drake.maths.estimation.faults.search import BEGUN, SearchOutcome, advance_search
from massprop_drake.maths.estimation.faults.tree import Tree, probabilities, tree_from_search
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint import relinearization
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.start import Kept
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale

ACCELEROMETERS = ("acc2", "acc1", "acc3")  # the preferred one first, as the filter has them
SETTINGS = ("plant.lag_factor=0.9523809523809523", "seed=3", "execution.engine=loop")
LEAK = ("estimation.start=zero", "duration_s=10", "failures=[{kind: leak, jet: F1U, start_s: 1.48, force: 50}]")
ON = ("estimation.start=nominal", "duration_s=7", "failures=[{kind: stuck_on, jet: R2D, start_s: 1.1}]")
OFF = ("estimation.start=zero", "duration_s=9.5", "failures=[{kind: stuck_off, jet: R4D, start_s: 1.08}]")
DISPERSED = ("plant.thrust_dispersion=0.01", "joint.thrust_uncertainty=0.01")


def flight(settings: Sequence[str]) -> Run:
    """A flight without a detector; its filter has slots for forces, for all that."""
    return simulate(load_scenario("orbiter_maneuver", [*SETTINGS, *settings, "detector.kind=off"]))


def params_of(settings: Sequence[str]) -> JointFilterParams:
    return inputs.estimation_params(load_scenario("orbiter_maneuver", [*SETTINGS, *settings])).filter_params


def cycles(run: Run, params: JointFilterParams) -> Iterator[JointEvidence]:
    """Cycles of the filter over the telemetry of a run."""
    state = joint.initial_state(params)
    velocities = np.stack([run[name] for name in ACCELEROMETERS], axis=1)
    for row, time_s in enumerate(run.time_s.tolist()):
        told = Told(time_s, time_s, run["command"][max(row - 1, 0)], None, np.zeros(6))
        done = joint.step(state, run["gyro"][row].reshape(1, 3), velocities[row], told, params)
        state = done.state
        yield done.evidence


def searched(evidence: Iterator[JointEvidence], params: JointParams) -> tuple[tuple[SearchOutcome, ...], float]:
    """What is found first, and when, s."""
    search = BEGUN
    for each in evidence:
        if each.report.starting or search.contradicted:
            search, found = advance_search(search, each.before, each.report, each.sample, Priors(), params)
            if found:
                return found, each.sample.time_s
    return (), np.inf


def probabilities_of(found: tuple[SearchOutcome, ...], params: JointParams) -> dict[frozenset[Way], float]:
    """Posterior probability of each hypothesis by the jets that have failed in it."""
    tree = tree_from_search(found, Tree(), Params(params, Priors(), np.zeros(0), np.zeros(0)))
    return {each.ways: share for each, share in probabilities(tree)}


def nees(found: SearchOutcome, run: Run, time_s: float, params: JointParams) -> float:
    """Square of the errors of the ten parameters over their covariance."""
    estimate, rows = parameters_with_scale(found.state, params)
    error = estimate - run["truth"][int(np.searchsorted(run.time_s, time_s))]
    deviation = np.sqrt(np.sum(rows * rows, axis=1))
    half = rows / deviation[:, None]
    return float((error / deviation) @ np.linalg.solve(half @ half.T, error / deviation))


@pytest.mark.parametrize(
    ("settings", "jet", "sign", "onset_s"),
    [
        (LEAK, "F1U", 1, 1.48),
        ((*ON, *DISPERSED), "R2D", 1, 1.1),
        (OFF, "R4D", -1, 1.08),
    ],
    ids=["leak", "on with thrusts dispersed", "off"],
)
def test_the_jet_that_has_failed_is_certain_and_taken_off_what_the_vehicle_is_like(
    settings: tuple[str, ...], jet: str, sign: int, onset_s: float
) -> None:
    run, own = flight(settings), params_of(settings)
    found, time_s = searched(cycles(run, own), own.joint)
    named = {(run.scenario.vehicle_data.designations.index(jet), sign)}
    assert probabilities_of(found, own.joint)[frozenset(named)] > 0.999
    assert nees(found[0], run, time_s, own.joint) < 29.6  # ten degrees, once in a thousand
    if sign > 0:  # of a jet that is lost nothing shows before it is told to fire
        assert found[0].onset_s == pytest.approx(onset_s, abs=0.24)


def test_a_contradiction_by_chance_is_put_down_to_the_start() -> None:
    settings = ("estimation.start=zero", "duration_s=7")
    run, own = flight(settings), params_of(settings)
    evidence = [
        each._replace(report=each.report._replace(contradicted=number == 25))
        for number, each in enumerate(cycles(run, own))
    ]
    found, time_s = searched(iter(evidence), own.joint)
    assert probabilities_of(found, own.joint)[frozenset()] > 0.999
    assert nees(found[0], run, time_s, own.joint) < 29.6


def test_a_pass_is_linear_in_the_force_it_estimates() -> None:
    """However far force and mass properties are from where it is linearized: their product is of second order."""
    own = make_params().joint
    (first_sample, sample), _ = samples_of(own, np.eye(6)[[0, 2]])
    contender = Contender(Cause(Kind.JETS, (5,), (1,), (1,)), 0, 0.0, force=(0.3,))
    entry = known_vehicle(own)
    first = step_fit(begin_fit(contender, 0.0, entry.mean, entry, own), Kept(first_sample, False), own)
    assert first is not None
    about, state, slot = first.about.copy(), first.state, own.places.force
    about[:N_PROPERTIES] = own.nominal
    there = state.mean.copy()
    there[:N_PROPERTIES], there[slot] = 1.5 * own.nominal, 0.8

    def after(share: float) -> np.ndarray:
        mean = (1.0 - share) * state.mean + share * there
        return relinearization.run_relinearized(state._replace(mean=mean), sample, about, own)[0].mean

    scale = np.maximum(np.abs(after(1.0) - after(0.0)), 1e-9)
    np.testing.assert_allclose((after(0.3) - 0.7 * after(0.0) - 0.3 * after(1.0)) / scale, 0.0, atol=1e-6)
