"""A jet that fails before a start has converged: found by going over the start again."""

from __future__ import annotations

import json

import numpy as np
import pytest
from joint_probe import small_params, some_state, unrounded
from replay_probe import replayed

from massprop_drake import Estimator, Run, estimate, load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.detectors.multi_hypothesis import JetsDeclared, Word
from massprop_drake.maths.estimation.detectors.multi_hypothesis import _found as found_by
from massprop_drake.maths.estimation.detectors.multi_hypothesis import initial as nothing_known
from massprop_drake.maths.estimation.joint import cycle, early
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.cycle import Sample
from massprop_drake.maths.estimation.joint.decision import Rules
from massprop_drake.maths.estimation.joint.early import BEGUN, OVER, Early, Fit, Found
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, Score, opened
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Contender
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.results.summary import from_names
from massprop_drake.runners.recorded import settings_alone

ACCELEROMETERS = ("acc2", "acc1", "acc3")  # the preferred one first, as the filter has them
SETTINGS = ("plant.lag_factor=0.9523809523809523", "seed=3")
LEAK = ("estimation.start=zero", "duration_s=8", "failures=[{kind: leak, jet: F1U, start_s: 1.48, force: 50}]")
ON = ("estimation.start=nominal", "duration_s=10", "failures=[{kind: stuck_on, jet: R2D, start_s: 1.1}]")
OFF = ("estimation.start=zero", "duration_s=10", "failures=[{kind: stuck_off, jet: R4D, start_s: 1.08}]")


def flight(settings: tuple[str, ...], engine: str = "loop") -> Run:
    return simulate(load_scenario("orbiter_maneuver", [*SETTINGS, *settings, f"execution.engine={engine}"]))


@pytest.fixture(scope="module")
def flown() -> Run:
    """A leak that begins before the second axis has been turned."""
    return flight(LEAK)


@pytest.fixture(scope="module")
def params(flown: Run) -> JointParams:
    return inputs.joint_params(flown.scenario).joint


def only_one(run: Run, jet: str) -> float:
    """Errors over their 1-sigma at the end, at most, of a run in which a jet and nothing else has been named."""
    summary = run.summary
    assert [each["jet"] for each in summary["detections"]] == [jet]
    assert summary["injected"][0]["outcome"] == "named"
    deviation = from_names(summary["standard_deviations"])
    return float(np.abs((from_names(summary["estimates"]) - run["truth"][-1]) / deviation).max())


def test_a_leak_is_named_and_taken_off_what_the_vehicle_is_like(flown: Run) -> None:
    assert only_one(flown, "F1U") < 6.0  # without it they are dozens of sigmas off, and never converge
    (record,) = flown.summary["detections"]
    assert record["magnitude"] == pytest.approx(50.0, abs=4.0 * record["magnitude_std"])
    assert record["onset_s"] == pytest.approx(1.48, abs=0.08)


@pytest.mark.parametrize(("settings", "jet"), [(ON, "R2D"), (OFF, "R4D")])
def test_a_jet_that_is_stuck_is_named(settings: tuple[str, ...], jet: str) -> None:
    assert only_one(flight(settings), jet) < 6.0


def test_diagram_record_and_estimator_give_the_bits_of_the_loop(
    flown: Run, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = flown.save(tmp_path_factory.mktemp("early") / "run", pictures=False, report=False)
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    second = replayed(folder / "telemetry.csv", settings_alone(flown.scenario))
    for name, expected in second.signals.items():
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
        np.testing.assert_array_equal(flown[name], expected, err_msg=name)
    dut = Estimator(flown.scenario.vehicle_data, flown.scenario)
    assert steps(dut, flown, range(len(flown.time_s))) == ["F1U"]


def test_what_has_been_found_goes_on_after_a_restart_and_a_search_under_way_is_given_up(flown: Run) -> None:
    (record,) = flown.summary["detections"]
    named = int(np.searchsorted(flown.time_s, record["time_s"])) + 1
    assert flown["racing"][named - 2]
    for row, said in ((named, []), (named - 2, [])):
        dut = Estimator(flown.scenario.vehicle_data, flown.scenario)
        steps(dut, flown, range(row))
        kept = json.loads(json.dumps(dut.state))
        again = Estimator(flown.scenario.vehicle_data, flown.scenario)
        again.restore(kept)
        assert steps(again, flown, range(row, named + 3), same=False) == said


def steps(dut: Estimator, run: Run, rows: range, *, same: bool = True) -> list[str | None]:
    """Jets that are named over rows of a run; whether its estimates must be those of the run."""
    named = []
    for row in rows:
        readings = {name: run[name][row] for name in ACCELEROMETERS}
        step = dut.step(run.time_s[row], run["gyro"][row], readings, run["command"][row])
        if same:
            np.testing.assert_array_equal(step.estimate, run["estimate"][row])
        if step.detection is not None:
            named.append(step.detection.jet)
    return named


# ------------------------------------------------------------------------------------------ by hand


def samples(run: Run) -> list[Sample]:
    """Of a run, from the second on."""
    velocities = np.stack([run[name] for name in ACCELEROMETERS], axis=1)
    rows = range(1, len(run.time_s))
    command = run["command"]
    return [
        Sample(
            float(run.time_s[row]),
            np.array([0.08]),
            command[row - 1 : row],
            np.zeros(6),
            run["gyro"][row : row + 1],
            velocities[row],
            on_ticks(),
        )
        for row in rows
    ]


def entered(run: Run, params: JointParams) -> JointState:
    velocities = np.stack([run[name][0] for name in ACCELEROMETERS])
    first = Sample(0.0, np.array([0.08]), np.zeros((1, 44)), np.zeros(6), run["gyro"][:1], velocities, on_ticks())
    return cycle.begun(cycle.initial(params), first, params)


def test_a_healthy_start_that_is_contradicted_is_left_as_it_is() -> None:
    run = flight(("estimation.start=zero", "duration_s=5", "detector.kind=off"))
    own = inputs.joint_params(load_scenario("orbiter_maneuver")).joint
    entry, kept, searches = entered(run, own), BEGUN, set()
    for number, sample in enumerate(samples(run)):
        kept, found = early.followed(kept, entry, sample, number == 25, (Rules(), own))
        assert found is None
        searches.add(None if kept.search is None else kept.search.until)
    assert searches >= {None, 38}  # one has been made, and has come to nothing
    assert kept.due > 1.25 * 38


@pytest.mark.parametrize(
    ("again", "expected"),
    [((), {38}), ((40,), {38, 53}), ((58,), {38, 71})],
    ids=["once", "while it is searched", "after"],
)
def test_what_contradicts_the_start_anew_is_searched_for_anew(again: tuple[int, ...], expected: set[int]) -> None:
    """And what is not, when there is twice as much."""
    run = flight(("estimation.start=zero", "duration_s=5.8", "detector.kind=off"))
    own = inputs.joint_params(load_scenario("orbiter_maneuver")).joint
    entry, kept, searches = entered(run, own), BEGUN, set()
    for number, sample in enumerate(samples(run)):
        kept, _ = early.followed(kept, entry, sample, number in (25, *again), (Rules(), own))
        searches.update(() if kept.search is None else (kept.search.until,))
    assert searches == expected


def test_nothing_is_searched_where_nothing_contradicts(flown: Run, params: JointParams) -> None:
    entry, kept = entered(flown, params), BEGUN
    for sample in samples(flown):
        kept, found = early.followed(kept, entry, sample, False, (Rules(), params))
        assert kept.search is None
        assert found is None
    assert len(kept.kept) <= len(flown.time_s)
    assert early.followed(kept._replace(kept=kept.kept[:1] * 400), entry, kept.kept[0], True, (Rules(), params)) == (
        OVER,
        None,
    )


def test_while_nothing_acts_only_the_last_seconds_are_kept(flown: Run, params: JointParams) -> None:
    entry, kept = entered(flown, params), BEGUN
    quiet = samples(flown)[0]
    for number in range(60):
        before = entry._replace(time_s=float(number))
        kept, _ = early.followed(kept, before, quiet, False, (Rules(), params))
        assert len(kept.kept) <= 25
    assert kept.entry is not None
    assert kept.entry.time_s == 60.0 - len(kept.kept)


def test_a_contradicted_start_may_have_been_stated_too_well() -> None:
    own = small_params()
    entry = some_state(own)
    doubted = early._with_doubt(Early(True, entry, ()), own).entry
    assert doubted is not None
    added = doubted.root @ doubted.root.T - entry.root @ entry.root.T
    np.testing.assert_allclose(np.diag(added)[:N_PROPERTIES], own.increment_sigma**2, rtol=1e-9)


@pytest.mark.parametrize(
    ("grid", "onsets"),
    [
        ((40, 0, 3), tuple(range(0, 40, 3))),
        ((400, 100, 5), tuple(range(60, 141, 5))),
        ((30, 28, 1), tuple(range(20, 30))),
        ((50, 4, 1), tuple(range(17))),
        ((50, 7, 3), tuple(range(1, 50, 3))),
    ],
)
def test_onsets_are_about_the_likeliest_and_among_the_samples(
    grid: tuple[int, int, int], onsets: tuple[int, ...]
) -> None:
    found, gaps = early._grid(*grid)
    assert found == onsets
    assert grid[1] in found
    assert gaps == tuple(grid[2] if onset else 1 for onset in found)


def test_where_passes_are_linearized_is_a_body_and_no_jet_gives_more_than_it_can() -> None:
    own = small_params()
    state = some_state(own)
    mean = state.mean.copy()
    mean[own.places.force :] = (-3.0, 1e3)
    about = early._possible(mean, state, own)
    most = 1.05 * own.thrusts[int(state.slot_jet[1])]
    np.testing.assert_allclose(about[own.places.force :], (0.0, most))
    np.testing.assert_array_equal(about[: own.places.force], mean[: own.places.force])
    mean[1] = -mean[1]
    np.testing.assert_array_equal(early._possible(mean, state, own)[:N_PROPERTIES], own.nominal)


def _fit(own: JointParams, score: Score, force: float) -> Fit:
    cause = Cause(Kind.JETS, (0,), (1,), (1,))
    state = opened(some_state(own)._replace(slot_jet=np.full(2, -1.0)), cause, own)
    state.mean[own.places.force] = force
    return Fit(Contender(cause, 3, 0.0), state.mean, state, score)


def test_a_lead_is_the_least_by_cells_and_by_noise_and_counts_what_jets_cannot_give() -> None:
    own = small_params()
    one, other = _fit(own, Score(10.0, 7.0, 0.0, 1.0), 0.5), _fit(own, Score(1.0, 2.0, 0.0, 1.0), 0.5)
    assert early.ahead(one, other, own) == pytest.approx(5.0)
    beyond = _fit(own, Score(1.0, 2.0, 0.0, 1.0), 3.0)
    sigma = np.sqrt(np.sum(beyond.state.root[own.places.force] ** 2))
    cost = 0.5 * ((3.0 - 1.05 * own.thrusts[0]) / sigma) ** 2 + screens.PAIR_PRIOR
    stated = 0.5 * ((3.0 - 1.03 * own.thrusts[0]) / sigma) ** 2
    assert early.ahead(one, beyond, own) == pytest.approx(5.0 + min(stated, cost))


def test_a_pass_is_linear_in_the_force_it_estimates(flown: Run, params: JointParams) -> None:
    """However far force and mass properties are from where it is linearized: their product is of second order."""
    own = unrounded(params)
    sample = next(each for each in samples(flown) if each.commands.any())
    state = opened(entered(flown, own), Cause(Kind.JETS, (5,), (1,), (1,)), own)
    about, there, slot = state.mean.copy(), state.mean.copy(), own.places.force
    about[:N_PROPERTIES], about[slot] = flown["truth"][0], 300.0
    there[:N_PROPERTIES], there[slot] = 1.5 * flown["truth"][0], 800.0

    def after(share: float) -> np.ndarray:
        mean = (1.0 - share) * state.mean + share * there
        return cycle.gone_over(state._replace(mean=mean), sample, about, own)[0].mean

    scale = np.maximum(np.abs(after(1.0) - after(0.0)), 1e-9)
    np.testing.assert_allclose((after(0.3) - 0.7 * after(0.0) - 0.3 * after(1.0)) / scale, 0.0, atol=1e-6)


@pytest.mark.parametrize(("force", "others", "word"), [(50.0, (), Word.FAILED), (50.0, (40.0,), Word.GROUP)])
def test_what_is_found_is_said_of_all_that_it_may_be(
    params: JointParams, flown: Run, force: float, others: tuple[float, ...], word: Word
) -> None:
    cause, instead = Cause(Kind.JETS, (5,), (1,), (1,)), Cause(Kind.JETS, (6,), (1,), (1,))
    state = opened(entered(flown, params), cause, params)
    state.mean[params.places.force] = force
    found = Found(state, cause, 1.5, tuple((instead, each, 2.0) for each in others))
    remembered, (said,) = found_by(nothing_known(params), found, params)
    assert isinstance(said, JetsDeclared)
    assert (said.word, said.jets, said.onset_s) == (word, (5, 6)[: 1 + len(others)], 1.5)
    assert remembered.announced[0] == force
    np.testing.assert_array_equal(remembered.members[0, [5, 6]], (1.0, 2.0 * len(others)))


def test_what_is_too_little_to_be_said_is_remembered(params: JointParams, flown: Run) -> None:
    cause = Cause(Kind.JETS, (5,), (1,), (1,))
    state = opened(entered(flown, params), cause, params)
    state.mean[params.places.force] = 0.5
    remembered, said = found_by(nothing_known(params), Found(state, cause, 1.5, ()), params)
    assert said == ()
    assert remembered.announced[0] == 0.0
    assert remembered.onsets[0] == 1.5
    assert remembered.members[0, 5] == 1.0
