"""Hypotheses: columns beside one filter against filters of their own, and what each opens with."""

from __future__ import annotations

import numpy as np
import pytest
from joint_probe import small_params
from test_joint_bank import Flight, flight, ready

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import (
    BOW,
    JUMP_SHARES,
    NO_SCORE,
    SHARES,
    Cause,
    Kind,
    Runner,
    cost_of_a_lie,
    jump_sigma,
    kicked,
    masked,
    misfits,
    opened,
    restless,
    slot_of,
    stepped,
    torn,
    without_increments,
)
from massprop_drake.maths.estimation.joint.joint_cycle import step
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.sensitivity import carried, corrected, link, smeared
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params(second_order=False, flows=np.zeros(6), thrust_sigma=0.0)
QUIET = without_increments(PARAMS)
PLACES = PARAMS.places
NONE = np.zeros(2)


def empty_slots(state: JointState) -> JointState:
    """No known failures."""
    root, mean = state.root.copy(), state.mean.copy()
    root[PLACES.force :] = mean[PLACES.force :] = 0.0
    return state._replace(
        mean=mean, root=np.linalg.qr(root.T, mode="r").T, slot_jet=np.full(2, -1.0), slot_sign=np.ones(2)
    )


@pytest.fixture(scope="module")
def flown() -> Flight:
    return flight(empty_slots(ready()), PARAMS)


@pytest.fixture(scope="module")
def flown_off_ticks() -> Flight:
    return flight(empty_slots(ready()), PARAMS, jitter_s=1e-3)


def screen_of(
    flown: Flight, onsets: tuple[int, ...], params: JointParams = PARAMS, *, single: bool = False
) -> screens.Screen:
    """The screen over the whole flight; its cycles count from one, after the first state."""
    read = np.zeros(12)
    gaps = tuple(1 for _ in onsets)
    screen = screens.begin((flown.states[0], 0), onsets, gaps, read, params, single=single)
    for over in flown.links:
        screen = screens.screened(screen, over, params)
    return screen


def run_of(flown: Flight, run: Runner, params: JointParams = QUIET) -> Runner:
    """A filter of its own over the rest of the flight."""
    for cycle in range(run.cycle, len(flown.links)):
        run = stepped(run, flown.samples[cycle], flown.links[cycle], NONE, 0.0, params)
    return run


def test_a_screen_of_single_jets_finds_what_the_whole_one_does_of_them(flown: Flight) -> None:
    whole, single = screen_of(flown, (2, 4, 7)), screen_of(flown, (2, 4, 7), single=True)
    jets = PARAMS.places.jets
    assert single.information.shape == (3, jets, 5, 5)
    sets = np.array([[1, 1 + 2 * jets, 1 + 3 * jets], [1 + 4 * jets, 1 + jets, 1 + 2 * jets]])
    for index in range(3):
        np.testing.assert_allclose(single.among(index, sets), whole.among(index, sets), rtol=1e-12)
    allowed, known = np.ones(2 * jets, dtype=np.bool_), np.zeros(2 * jets)
    found = {each.cause: each for each in screens.contenders(single, allowed, known, PARAMS)}
    others = [each for each in screens.contenders(whole, allowed, known, PARAMS) if each.cause in found]
    assert all(len(cause.jets) == 1 for cause in found)
    for each in others:
        assert each.lead == pytest.approx(found[each.cause].lead, rel=1e-9)
        assert each.onset == found[each.cause].onset


def test_an_onset_is_the_same_whatever_others_the_screen_has(flown: Flight) -> None:
    """Those that are still to come are left out until they do."""
    both, later = screen_of(flown, (2, 7)), screen_of(flown, (7,))
    alone = screen_of(flown, (2,))
    np.testing.assert_allclose(both.information[0], alone.information[0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(both.projection[1], later.projection[0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(both.jump_information, alone.jump_information, rtol=1e-12)
    assert np.diagonal(both.information[1]).any()


def filtered_alone(flown: Flight, onset: int, columns: Array, variances: Array) -> tuple[float, Array]:
    """L against no failure and amplitudes, by dense least squares over all innovations."""
    dense = np.vstack(columns)
    rows, values = [], []
    for k, over in enumerate(flown.links):
        half = np.linalg.cholesky(over.covariance)
        rows.append(np.linalg.solve(half, dense[12 * k : 12 * (k + 1)]))
        values.append(np.linalg.solve(half, over.innovation))
    whitened, residual = np.vstack(rows), np.concatenate(values)
    total = np.eye(residual.size) + whitened @ np.diag(variances) @ whitened.T
    lead = -0.5 * (residual @ np.linalg.solve(total, residual) - residual @ residual)
    lead -= 0.5 * np.linalg.slogdet(total)[1]
    return float(lead), np.diag(variances) @ whitened.T @ np.linalg.solve(total, residual)


@pytest.mark.parametrize(("jet", "sign", "on_top"), [(0, 1, 0), (0, 1, 1), (3, 1, 0), (3, 1, 1), (0, -1, 0)])
def test_a_column_agrees_with_a_filter_that_has_the_force_in_a_slot(
    flown: Flight, jet: int, sign: int, on_top: int
) -> None:
    """Likelihood, force and its sigma, for a force that readings know to a thousandth of its prior."""
    _compare_with_a_slot(flown, jet, sign, on_top)


@pytest.mark.parametrize(("jet", "sign", "on_top"), [(3, 1, 1), (0, -1, 0)])
def test_so_it_does_where_stamps_are_off_their_ticks(flown_off_ticks: Flight, jet: int, sign: int, on_top: int) -> None:
    _compare_with_a_slot(flown_off_ticks, jet, sign, on_top)


def _compare_with_a_slot(flown: Flight, jet: int, sign: int, on_top: int) -> None:
    onset = 3
    screen = screen_of(flown, (onset,))
    column = 6 + jet if sign < 0 else jet if on_top else 24 + jet
    index, kick = np.array([column, 12 + jet, 18 + jet]), 0.1
    lead, amplitude, covariance = screens.explained(
        screen.information[0][np.ix_(index, index)],
        screen.projection[0][index],
        np.array([PARAMS.thrusts[jet], kick, SHARES[1] * kick]) ** 2,
    )
    none = Runner(Cause(Kind.NOTHING), 0, (), onset, flown.states[onset], NO_SCORE)
    cause = Cause(Kind.JETS, (jet,), (sign,), (on_top,))
    run = run_of(flown, none._replace(cause=cause, onset=onset, kicks=((kick,), (SHARES[1] * kick,), (0.0,))))
    none = run_of(flown, none)
    row = PLACES.force + slot_of(run.state, jet, sign)
    assert run.state.mean[row] == pytest.approx(amplitude[0], abs=0.1 * np.sqrt(covariance[0, 0]))
    assert np.linalg.norm(run.state.root[row]) == pytest.approx(np.sqrt(covariance[0, 0]), rel=2e-2)
    assert run.score.likelihood - none.score.likelihood == pytest.approx(lead, abs=0.3)


def test_jets_may_have_given_otherwise_in_the_interval_of_a_jump(flown: Flight) -> None:
    """By the share that the mass properties change by, of what those gave that fired; the others gave nothing."""
    state, over = flown.states[3], flown.links[3]
    wide = torn(state, 0.3, over, PARAMS)
    fired = np.flatnonzero(over.amount > 0.0)
    columns = smeared(over, PARAMS.places)[:, fired] * (
        0.3 * PARAMS.thrusts[fired] * over.amount[fired] / over.duration_s
    )
    np.testing.assert_allclose(wide.root @ wide.root.T, state.root @ state.root.T + columns @ columns.T, atol=1e-12)


def test_a_jump_is_expected_as_large_as_it_is_likeliest(flown: Flight) -> None:
    """Of a vehicle that has not changed a small jump is likelier than a large one; of the mass that tells nothing."""
    large_lead, small_lead = screens.jumps(screen_of(flown, (3,)), PARAMS)
    assert small_lead > large_lead
    small = opened(flown.states[3], Cause(Kind.JUMP), PARAMS, JUMP_SHARES[1]).root[:10]
    large = opened(flown.states[3], Cause(Kind.JUMP), PARAMS).root[:10]
    before = flown.states[3].root[:10]
    added = [np.diag(root @ root.T - before @ before.T) for root in (small, large)]
    assert added[0] / added[1] == pytest.approx([*0.04 * np.ones(9), 1.0], rel=1e-6)


def test_a_jump_shifts_the_center_of_mass_by_the_share_of_the_vehicles_size() -> None:
    """However small its coordinates are where the vehicle's frame begins."""
    sigma = jump_sigma(PARAMS._replace(increment_sigma=1e-6 * PARAMS.increment_sigma, arm=2.0), 0.3)
    assert np.linalg.norm(sigma[6:9]) == pytest.approx(0.6)
    assert np.ptp(sigma[6:9]) == 0.0
    np.testing.assert_allclose(np.delete(sigma, slice(6, 9)), 3e-7 * np.delete(PARAMS.increment_sigma, slice(6, 9)))


def test_a_reading_that_lies_once(flown: Flight) -> None:
    """It is left out at once, costs its share, and is read again as soon as it fits; the column says the same."""
    onset, component, off = 4, 7, 1.0
    links, samples, states = list(flown.links), list(flown.samples), list(flown.states)
    velocities = samples[onset].velocities.copy()
    velocities.flat[component - 6] += off
    samples[onset] = samples[onset]._replace(velocities=velocities)
    for cycle in range(onset, len(links)):
        states[cycle + 1], report = step(states[cycle], samples[cycle], QUIET)
        links[cycle] = link(states[cycle], report, samples[cycle], QUIET)
    lied = Flight(states, samples, links)
    cause = Cause(Kind.LIES, component=component)
    run = run_of(lied, Runner(cause, onset, (), onset, states[onset], NO_SCORE, True))
    assert not run.lying
    honest = run_of(flown, Runner(Cause(Kind.NOTHING), 0, (), onset, flown.states[onset], NO_SCORE))
    assert run.score.likelihood == pytest.approx(
        honest.score.likelihood - cost_of_a_lie(component, PARAMS), abs=10.0
    )  # but for what that reading would have said
    none = run_of(lied, Runner(Cause(Kind.NOTHING), 0, (), onset, states[onset], NO_SCORE))
    found = screens.contenders(screen_of(lied, (onset,)), np.ones(12, dtype=np.bool_), np.zeros(12), PARAMS)
    first = next(each for each in found if each.cause.kind == Kind.LIES)
    assert first.cause == cause
    assert first.lead == pytest.approx(run.score.likelihood - none.score.likelihood, rel=0.02)
    deviation = np.sqrt(np.sum(honest.state.root**2, axis=1))
    assert (np.abs(run.state.mean - honest.state.mean)[:19] < 1.0 * deviation[:19]).all()


def test_a_reading_that_stands_still_lies_once(flown: Flight) -> None:
    """What it repeats, a sensor that stands still would say again: it costs next to nothing, another lie its share."""
    onset, component, count = 4, 1, 5
    cause = Cause(Kind.LIES, component=component)
    costs = []
    for each in (0.0, 1.0):
        links, samples = list(flown.links), list(flown.samples)
        for row in range(onset, onset + count):
            rates, said = samples[row].rates.copy(), 3.0 + each * (row - onset)
            rates.flat[component] = said
            samples[row] = samples[row]._replace(rates=rates)
            read = links[row].read.copy()
            read[component] = said
            links[row] = links[row]._replace(read=read)
        lied = Flight(flown.states, samples, links)
        run = run_of(lied, Runner(cause, onset, (), onset, flown.states[onset], NO_SCORE, True))
        assert not run.lying
        costs.append(-run.score.likelihood)
    gained = cost_of_a_lie(component, PARAMS) - cost_of_a_lie(component, PARAMS, 0.0)
    assert gained == pytest.approx(np.log(2e4))
    assert costs[1] - costs[0] == pytest.approx((count - 1) * gained)


def test_what_the_jets_hypothesis_opens_with(flown: Flight) -> None:
    state, over = flown.states[2], flown.links[2]
    cause = Cause(Kind.JETS, (4, 1), (1, -1), (0, 0))
    found = kicked(opened(state, cause, PARAMS), cause, np.array([0.2, 0.3]), over, PARAMS)
    assert found.slot_jet.tolist() == [4.0, 1.0]
    assert found.slot_sign.tolist() == [1.0, -1.0]
    impulses = smeared(over, PLACES)[:, [4, 1]] * [0.2, 0.3]
    slots = np.zeros((PLACES.size, 2))
    slots[PLACES.force :] = np.diag(PARAMS.thrusts[[4, 1]])
    expected = state.root @ state.root.T + impulses @ impulses.T + slots @ slots.T
    turned = BOW * over.duration_s * np.linalg.norm(state.mean[RATE]) * np.linalg.norm(impulses[RATE])
    expected[RATE, RATE] += turned**2 * np.eye(3)
    np.testing.assert_allclose(found.root @ found.root.T, expected, atol=1e-12)
    # the same jet again: its force may have changed, in the slot it has
    again = opened(found, Cause(Kind.JETS, (4,), (1,), (0,)), PARAMS)
    assert again.slot_jet.tolist() == [4.0, 1.0]
    row = PLACES.force
    assert again.root[row] @ again.root[row] == pytest.approx(2 * PARAMS.thrusts[4] ** 2)
    assert slot_of(found, 3, 1) == -1
    # an erratic one is anew every time
    anew = restless(again, np.array([1.0, 0.0]), PARAMS)
    covariance = anew.root @ anew.root.T
    assert covariance[row, row] == pytest.approx(PARAMS.thrusts[4] ** 2)
    np.testing.assert_allclose(np.delete(covariance[row], row), 0.0, atol=1e-12)


def test_an_impulse_does_what_is_as_uncertain_as_the_parameters(flown: Flight) -> None:
    """Against drawn parameters and impulses."""
    state, over, kick = flown.states[2], flown.links[2], 0.4
    cause = Cause(Kind.JETS, (4,), (1,), (0,))
    root = state.root.copy()
    root[:10] = 0.0
    root[:10, :10] = np.diag(0.02 * np.abs(state.mean[:10]))
    state = state._replace(root=root)
    first = kicked(state, cause, np.array([kick]), over, PARAMS)
    second = kicked(state, cause, np.array([kick]), over, PARAMS._replace(second_order=True))
    added = (second.root @ second.root.T - first.root @ first.root.T)[10:16, 10:16]
    random = np.random.default_rng(4)
    errors = random.standard_normal((20_000, root.shape[1])) @ root[:10].T
    seconds = random.normal(scale=kick, size=20_000) * over.duration_s / PARAMS.thrusts[4]
    wrench = PARAMS.wrenches[4:5]
    given = effects_of(wrench, state.mean)[0]
    draws = seconds[:, None] * [effects_of(wrench, state.mean[:10] + one)[0] - given for one in errors]
    moves = draws.std(axis=0) > 0.0
    assert moves.sum() > 3
    sigma = draws.std(axis=0)[moves]
    found = added[np.ix_(moves, moves)] / np.outer(sigma, sigma)
    np.testing.assert_allclose(found, np.corrcoef(draws[:, moves].T), atol=0.05)


def test_a_force_that_drifts_walks_in_its_own_slot(flown: Flight) -> None:
    """By a share of its full thrust over an interval, as independent of the rest as it was."""
    state = opened(flown.states[2], Cause(Kind.JETS, (4,), (1,), (1,)), PARAMS)
    after, row = restless(state, np.array([0.02, 0.0]), PARAMS), PLACES.force
    expected = np.zeros((PLACES.size, PLACES.size))
    expected[row, row] = (0.02 * PARAMS.thrusts[4]) ** 2
    gained = after.root @ after.root.T - state.root @ state.root.T
    np.testing.assert_allclose(gained, expected, atol=1e-12)
    assert restless(state, NONE, PARAMS) is state


def test_small_jets_are_not_favored() -> None:
    params = PARAMS._replace(thrusts=np.array([1.0, 1, 1, 1, 1, 0.1]))
    assert screens.rarity(params)[5] == pytest.approx(np.log(0.1))


def test_contenders_agree_with_dense_least_squares(flown: Flight) -> None:
    """One jet that is stuck on and one that leaks, from all innovations at once instead of sample by sample."""
    screen = screen_of(flown, (3,))
    columns = {}
    for name, jet, at_onset in (("step", 2, False), ("kick", 2, True), ("step2", 5, False), ("kick2", 5, True)):
        column, shown_all = np.zeros((PLACES.size, 1)), []
        for cycle, over in enumerate(flown.links):
            forcing = np.zeros((6, 1))
            if at_onset and cycle == 3:
                forcing[:, 0] = over.effects[jet] * over.duration_s
            elif not at_onset and cycle >= 3:
                untold = over.duration_s - over.amount[jet]
                forcing[:, 0] = over.effects[jet] * (untold if name == "step" else over.duration_s)
            before = carried(column, forcing, over, PLACES)
            shown = over.jacobian @ before
            column = corrected(before, shown, over)
            shown_all.append(shown)
        columns[name] = np.vstack(shown_all)
    variances = np.array([1.0, 0.01, 0.25, 0.04])
    dense = np.hstack([columns[name] for name in ("step", "kick", "step2", "kick2")])
    lead, amplitude = filtered_alone(flown, 3, dense, variances)
    index = np.array([24 + 2, 12 + 2, 5, 12 + 5])
    found, amplitudes, _ = screens.explained(
        screen.information[0][np.ix_(index, index)], screen.projection[0][index], variances
    )
    assert found == pytest.approx(lead, rel=1e-6)
    np.testing.assert_allclose(amplitudes, amplitude, rtol=1e-6, atol=1e-12)


def test_where_nothing_has_moved_there_is_no_contender(flown: Flight) -> None:
    screen = screens.begin((flown.states[0], 0), (0,), (1,), np.zeros(12), PARAMS)
    found = screens.contenders(screen, np.ones(12, dtype=np.bool_), np.zeros(12), PARAMS)
    assert found == []


def test_a_reading_that_is_missing_has_not_shown_that_it_fits(flown: Flight) -> None:
    after, sample = flown.states[3], flown.samples[3]
    _, report = step(after, sample, QUIET)
    assert not misfits(report, 7, PARAMS)
    _, report = step(after, masked(sample, 7), QUIET)
    assert misfits(report, 7, PARAMS)


def test_who_explains_all_alone_takes_no_place_of_two_that_do(monkeypatch: pytest.MonkeyPatch, flown: Flight) -> None:
    """What two jets do together a third does alone: with whatever else, it is likelier than they."""
    monkeypatch.setattr(screens, "_PAIRS", 1)
    screen, jets = screen_of(flown, (3,)), PARAMS.places.jets
    shown = 20.0 * np.random.default_rng(5).standard_normal((screen.projection.shape[1], 40))
    shown[0] = shown[1] + shown[2]
    force = 0.3 * PARAMS.thrusts.min()
    screen = screen._replace(information=(shown @ shown.T)[None], projection=(shown @ shown[0] * force)[None])
    allowed, known = np.ones(2 * jets, dtype=np.bool_), np.zeros(2 * jets)
    found = screens._likely_pairs(screen, 0, np.arange(2 * jets), (allowed, known), PARAMS)
    assert found[0].tolist() == [1, 2]


def test_a_force_above_its_stated_thrust_is_as_rare_as_a_second_failure() -> None:
    """Up to what jets give at most, which is more where more is stated."""
    exact = PARAMS._replace(places=PARAMS.places._replace(n_thrust=0))
    thrust = PARAMS.thrusts[2]
    covariance = np.array([[(0.005 * thrust) ** 2]])

    def cost(force: float, params: JointParams) -> float:
        return float(screens.too_much(np.array([[force * thrust]]), covariance[None], np.array([[2]]), params)[0])

    assert cost(1.0, exact) == 0.0
    assert cost(1.01, exact) == pytest.approx(0.5 * 2.0**2)
    assert cost(1.045, exact) == pytest.approx(screens.PAIR_PRIOR)
    assert cost(1.07, exact) == pytest.approx(screens.PAIR_PRIOR + 0.5 * 4.0**2)
    assert cost(-0.01, exact) == pytest.approx(0.5 * 2.0**2)
    for stated, force, expected in ((0.01, 1.03, 0.0), (0.01, 1.04, 2.0), (0.05, 1.15, 0.0), (0.05, 1.16, 2.0)):
        params = PARAMS._replace(thrust_sigma=stated)
        assert cost(force, params) == pytest.approx(expected, abs=1e-9)
        np.testing.assert_allclose(screens.most_forces(params), max(1.05, 1.0 + 3.0 * stated) * params.thrusts)


@pytest.mark.parametrize(
    ("signs", "told", "later", "expected"),
    [((-1,), 0.0, 100.9, 2), ((-1,), 0.0, 101.1, 5), ((-1,), 0.5, 100.9, 5), ((1,), 0.0, 100.9, 5)],
)
def test_an_onset_at_which_a_jet_had_nothing_to_lose_is_kept(
    monkeypatch: pytest.MonkeyPatch, flown: Flight, signs: tuple[int, ...], told: float, later: float, expected: int
) -> None:
    """A jet that is told to fire for one sample only: from then on, the force is not told from its first impulse."""
    screen = screen_of(flown, (2, 5))
    acting = screen.acting.copy()
    acting[0, 0, PLACES.jets + 3] = told
    cause = Cause(Kind.JETS, (3,), signs, (0,))
    leads = (100.0, later)
    monkeypatch.setattr(
        screens, "_singles", lambda screen, index, *_: [screens.Contender(cause, screen.onsets[index], leads[index])]
    )
    for name in ("_pairs", "_lies"):
        monkeypatch.setattr(screens, name, lambda *_: [])
    every = np.ones(2 * PLACES.jets, dtype=np.bool_)
    found = screens.contenders(screen._replace(acting=acting), every, np.zeros(2 * PLACES.jets), PARAMS)
    one = next(each for each in found if each.cause == cause)
    assert one.onset == expected
    assert one.at_onsets == ((2, 100.0), (5, later))
