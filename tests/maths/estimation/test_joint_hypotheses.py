"""Bank of onsets, screen and hypotheses: against filters of their own, differences, and dense linear algebra."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from joint_probe import PERIOD, elapsed, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import hypotheses as h
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import combine_gyros, predict_outputs, readings
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.sensitivity import (
    Link,
    linearize_cycle,
    propagate_to_update,
    propagate_update,
    unit_force_errors,
)
from massprop_drake.maths.estimation.joint.separation import find_separation
from massprop_drake.maths.estimation.joint.ticks import Pace, start_clock, update_by_stamp
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import level_onsets

UNSURE = small_params(second_order=False, flows=np.zeros(6))  # of thrusts
PARAMS = small_params(second_order=False, flows=np.zeros(6), thrust_sigma=0.0)
QUIET = h.without_increments(PARAMS)
PLACES, CYCLES = PARAMS.places, 12
NONE = np.zeros(2)


class Flight(NamedTuple):
    """States after each cycle, and what each cycle made of its sample."""

    states: list[JointState]
    samples: list[JointSample]
    links: list[Link]


def flight(first: JointState, params: JointParams, jitter_s: float = 0.0) -> Flight:
    """A settled filter whose readings are what it predicts, and noise; stamps are off their ticks by so much."""
    rng, of_stamps = np.random.default_rng(5), np.random.default_rng(1)
    states, samples, links, commands = [first], [], [], np.zeros((2, 6))
    clock = start_clock(0.0, commands[0], level_onsets(6))
    for k in range(CYCLES):
        commands = np.vstack((commands[1], rng.uniform(size=6) < 0.4)).astype(float)
        stamp_s = (k + 1) * PERIOD + jitter_s * of_stamps.standard_normal()
        clock, interval = elapsed(clock, stamp_s, (commands[0], commands[1]), Pace(PERIOD))
        pieces = {"durations_s": interval.durations_s, "commands": interval.commands, "timing": interval.timing}
        sample = some_sample(params, time_s=(k + 1) * PERIOD, **pieces)
        told, _ = update_by_stamp(states[-1], sample.timing, params)
        prediction = predict(told, estimate_forces(told, sample, params), unread(params), params)
        read, _ = predict_outputs(prediction.mean, first.reference, states[-1].spin + prediction.spin, params)
        read = read + rng.standard_normal(12) * np.sqrt(params.variances)
        samples.append(sample._replace(rates=read[:6].reshape(2, 3), velocities=read[6:].reshape(2, 3)))
        after, report = step(states[-1], samples[-1], params)
        links.append(linearize_cycle(states[-1], report, samples[-1], params))
        states.append(after)
    return Flight(states, samples, links)


def ready(seed: int = 0, *, slots: bool = True) -> JointState:
    """A settled state with small errors, with known failures or without."""
    state = some_state(UNSURE, seed)._replace(guarded=True, firing_count=100.0)
    state = state._replace(root=np.linalg.cholesky(0.01 * state.root @ state.root.T))
    if slots:
        return state
    state.root[PLACES.force :] = state.mean[PLACES.force :] = 0.0
    root = np.linalg.qr(state.root.T, mode="r").T
    return state._replace(root=root, slot_jet=np.full(2, -1.0), slot_sign=np.ones(2))


ON_TICKS, OFF_TICKS = 0.0, 1e-3  # s, of stamps


@cache
def flown(jitter_s: float = ON_TICKS, *, sound: bool = False) -> Flight:
    """Flight of a filter that knows two failures and is unsure of thrusts, or of one without failures."""
    return flight(ready(slots=not sound), PARAMS if sound else UNSURE, jitter_s)


def banked(flown: Flight) -> banks.Since:
    """The recursion since each onset, the first after the first cycle, before the update of the last cycle."""
    since = banks.empty_bank(PLACES).since
    for cycle, over in enumerate(flown.links):
        before = banks.advance_recursion(since, over, PLACES)
        since, _ = banks.add_onset(before, over.correction, float(cycle), UNSURE)
    return before


MEAN = np.kron(np.eye(2), np.hstack([0.5 * np.eye(3)] * 2))  # of packages


def output_rows(since: banks.Since, index: int, over: Link) -> tuple[Array, Array]:
    """Derivative of averaged outputs by the state at an onset, and by changes of w and c."""
    jacobian = MEAN @ over.jacobian
    on_outputs = banks.rate_output_derivative(jacobian, PLACES)
    return banks.output_rows(since, index, jacobian, on_outputs, UNSURE), on_outputs


def unlearned(mean: Array, flown: Flight, onset: int) -> Array:
    """Outputs at the last cycle, predicted by the filter from an earlier state without learning."""
    state = flown.states[onset + 1]
    moved_s = UNSURE.tick_sigma * (mean - state.mean)[PLACES.ticks : PLACES.ticks + 2]
    state = state._replace(mean=mean, level=state.level + moved_s @ state.tick_slope)
    for sample in flown.samples[onset + 1 :]:
        acting = estimate_forces(state, sample, UNSURE)
        prediction = predict(state, acting, combine_gyros(sample.rates, state.mean, UNSURE), UNSURE)
        firing, spin = acting.firing, state.spin + prediction.spin
        state = state._replace(mean=prediction.mean, spin=spin, tick_slope=acting.tick_slope)
        state = state._replace(level=firing.level, slope=firing.slope)
    return predict_outputs(state.mean, state.reference, state.spin, UNSURE)[0]


@pytest.mark.parametrize("jitter_s", [ON_TICKS, OFF_TICKS])
def test_the_bank_has_residual_and_derivative_of_the_filters_own_prediction_from_each_onset(jitter_s: float) -> None:
    of, rng = flown(jitter_s), np.random.default_rng(2)
    since, over, last = banked(of), of.links[-1], of.samples[-1]
    read = readings(last.rates, last.velocities, last.attitudes)
    np.testing.assert_array_equal(banks.averaging_matrix(over.read, PLACES)[0], MEAN)
    scale = np.sqrt(np.sum(of.states[3].root ** 2, axis=1))
    for index, onset in enumerate(since.cycles.astype(int).tolist()):
        at = of.states[onset + 1].mean
        found = over.innovation + over.jacobian @ since.learned[index]
        off = np.abs(found - read + unlearned(at, of, onset))
        off /= np.sqrt(UNSURE.variances if jitter_s else UNSURE.variances.min())
        assert off.max() < (0.05 if jitter_s else 0.02)
        assert np.abs(found - over.innovation).max() > 1e-3 * np.abs(over.innovation).max() or onset == CYCLES - 2
        if index not in (2, 6):
            continue
        rows, _ = output_rows(since, index, over)
        for away in 0.1 * scale * rng.choice([-1.0, 1.0], (6, scale.size)):
            difference = MEAN @ (unlearned(at + away, of, onset) - unlearned(at - away, of, onset)) / 2.0
            assert (np.abs(rows @ away - difference) < 0.02 * np.abs(rows * away).max(axis=1)).all()


def test_statistics_agree_with_dense_linear_algebra() -> None:
    of = flown()
    since, over, states = banked(of), of.links[-1], of.states[1:]
    roots = banks.Roots([state.root for state in states], range(len(states)))
    found, some = banks.test_onsets(since, roots, over, 0.0, UNSURE)
    assert some
    for index in (0, 4, 8):
        residual = MEAN @ (over.innovation + over.jacobian @ since.learned[index])
        rows, on_outputs = output_rows(since, index, over)
        rows = rows @ states[index].root
        total = rows @ rows.T + MEAN @ np.diag(UNSURE.variances) @ MEAN.T
        total += on_outputs @ since.noise[index] @ on_outputs.T
        weighted = np.linalg.solve(total, residual)
        assert found.total[index] == pytest.approx(residual @ weighted, rel=1e-8)
        for jet in range(6):
            signature = on_outputs @ over.effects[jet]
            projection, energy = signature @ weighted, signature @ np.linalg.solve(total, signature)
            seconds = since.missing[index, jet] if projection > 0 else since.given[index, jet]
            shows = seconds > 0.5 * PERIOD
            force = np.clip(projection / energy / max(seconds, 1e-9), -UNSURE.thrusts[jet], UNSURE.thrusts[jet])
            assert found.likelihood[index, jet] == pytest.approx(projection**2 / energy * shows, rel=1e-8)
            assert found.force[index, jet] == pytest.approx(force * shows, rel=1e-8)


def test_an_error_left_out_goes_through_the_filter_as_a_column() -> None:
    """A filter that starts off by x ends off by its column, with the same readings and gains."""
    start = ready(2)
    of = flight(start, UNSURE)
    off = 0.05 * start.root @ np.random.default_rng(8).standard_normal(PLACES.size)
    state, column = start._replace(mean=start.mean + off), off.reshape(-1, 1)
    for over, sample in zip(of.links, of.samples, strict=True):
        state, report = step(state, sample, UNSURE)
        before = propagate_to_update(column, np.zeros((6, 1)), over, PLACES)
        shown = over.jacobian @ before
        least = 3e-2 * np.abs(shown).max() + 1e-12
        np.testing.assert_allclose(report.innovation - over.innovation, -shown[:, 0], atol=least)
        column = propagate_update(before, shown, over)
    deviation = np.sqrt(np.sum(state.root**2, axis=1))
    np.testing.assert_allclose((state.mean - of.states[-1].mean) / deviation, column[:, 0] / deviation, atol=2e-3)


def screen_of(of: Flight, onset: int) -> screens.Screen:
    """The screen over the whole flight; its cycles count from one, after the first state."""
    screen = screens.begin_screen((of.states[0], 0), (onset,), (1,), np.zeros(12), PARAMS)
    for over in of.links:
        screen = screens.advance_screen(screen, over, PARAMS)
    return screen


@pytest.mark.parametrize("sign", [1, -1], ids=["leaks, by waiting", "losses, by firing"])
def test_a_separation_is_when_the_screen_goes_on_to_tell_two_jets_apart(sign: int) -> None:
    of, forces, cycles = flown(sound=True), (0.04, 0.05), 12
    begun, interval = screen_of(of, 3), of.links[-1]
    steps = np.array([1, 4]) + (0 if sign > 0 else 6)
    after = dict[int, list[float]]()
    for single in (-1, 1, 4):
        screen, after[single] = begun, []
        fired = np.where(np.arange(6) == single, interval.duration_s, 0.0)
        for _ in range(cycles):
            screen = screens.advance_screen(screen, interval._replace(amount=fired), PARAMS)
            total = screen.information[0][np.ix_(steps, steps)]
            after[single].append(float(forces[0] ** 2 * (total[0, 0] - total[0, 1] ** 2 / total[1, 1])))
    by = -1 if sign > 0 else max((1, 4), key=lambda jet: after[jet][7])
    level = 0.5 * (after[by][6] + after[by][7])
    members = [(1, sign, forces[0]), (4, sign, forces[1])]
    found = find_separation(begun, interval, 3, members, level, PARAMS)
    assert found.jet == by
    assert found.coasting_s == pytest.approx(8 * interval.duration_s if sign > 0 else np.nan, nan_ok=True)


def run_of(of: Flight, run: h.Runner) -> h.Runner:
    """A filter of its own over the rest of the flight."""
    for cycle in range(run.cycle, CYCLES):
        run = h.run_hypothesis_cycle(run, of.samples[cycle], of.links[cycle], NONE, 0.0, QUIET)
    return run


def nothing(of: Flight, onset: int) -> h.Runner:
    return h.Runner(h.Cause(h.Kind.NOTHING), 0, (), onset, of.states[onset], h.NO_SCORE)


@pytest.mark.parametrize(
    ("jitter_s", "jet", "sign", "on_top"),
    [(ON_TICKS, 0, 1, 0), (ON_TICKS, 3, 1, 1), (ON_TICKS, 0, -1, 0), (OFF_TICKS, 3, 1, 1)],
)
def test_a_column_agrees_with_a_filter_that_has_the_force_in_a_slot(
    jitter_s: float, jet: int, sign: int, on_top: int
) -> None:
    of, onset = flown(jitter_s, sound=True), 3
    screen = screen_of(of, onset)
    column = 6 + jet if sign < 0 else jet if on_top else 24 + jet
    index, kick = np.array([column, 12 + jet, 18 + jet]), 0.1
    prior = np.array([PARAMS.thrusts[jet], kick, h.SHARES[1] * kick]) ** 2
    information, projection = screen.information[0][np.ix_(index, index)], screen.projection[0][index]
    lead, amplitude, covariance = screens.maximize_likelihood(information, projection, prior)
    cause, none = h.Cause(h.Kind.JETS, (jet,), (sign,), (on_top,)), nothing(of, onset)
    run = run_of(of, none._replace(cause=cause, onset=onset, kicks=((kick,), (h.SHARES[1] * kick,), (0.0,))))
    row = PLACES.force + h.failure_slot(run.state, jet, sign)
    assert run.state.mean[row] == pytest.approx(amplitude[0], abs=0.1 * np.sqrt(covariance[0, 0]))
    assert np.linalg.norm(run.state.root[row]) == pytest.approx(np.sqrt(covariance[0, 0]), rel=2e-2)
    assert run.score.likelihood - run_of(of, none).score.likelihood == pytest.approx(lead, abs=0.3)


@pytest.mark.parametrize(
    ("stated", "force", "expected"),
    [
        (0.0, 1.0, 0.0),
        (0.0, 1.01, 2.0),
        (0.0, 1.045, screens.PAIR_PRIOR),
        (0.0, 1.07, screens.PAIR_PRIOR + 8.0),
        (0.0, -0.01, 2.0),
        (0.01, 1.03, 0.0),
        (0.01, 1.04, 2.0),
        (0.05, 1.16, 2.0),  # and more than that no jet gives
    ],
)
def test_a_force_above_its_stated_thrust_is_as_rare_as_a_second_failure(
    stated: float, force: float, expected: float
) -> None:
    thrust, params = PARAMS.thrusts[2], PARAMS._replace(thrust_sigma=stated)
    variance, jets = np.array([[[(0.005 * thrust) ** 2]]]), np.array([[2]])
    found = screens.excess_force_cost(np.array([[force * thrust]]), variance, jets, params)
    assert found[0] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(screens.largest_jet_forces(params), max(1.05, 1.0 + 3.0 * stated) * params.thrusts)


def test_a_jump_of_mass_properties_is_as_large_as_a_payload_of_its_share() -> None:
    """Of a vehicle that has not changed a small jump is likelier than a large one; of the mass that tells nothing."""
    of = flown(sound=True)
    large_lead, small_lead = screens.jump_log_likelihoods(screen_of(of, 3), PARAMS)
    assert small_lead > large_lead
    jumped = [h.apply_cause(of.states[3], h.Cause(h.Kind.JUMP), PARAMS, share) for share in reversed(h.JUMP_SHARES)]
    before, *roots = (state.root[:10] for state in (of.states[3], *jumped))
    added = [np.diag(root @ root.T - before @ before.T) for root in roots]
    assert added[0] / added[1] == pytest.approx([*0.04 * np.ones(9), 1.0], rel=1e-6)
    # a shift of the center of mass is by the vehicle's size, however small its coordinates are
    sigma = h.jump_sigma(PARAMS._replace(increment_sigma=1e-6 * PARAMS.increment_sigma, arm=2.0), 0.3)
    np.testing.assert_allclose(sigma[6:9], 0.6 / np.sqrt(3.0))
    np.testing.assert_allclose(np.delete(sigma, slice(6, 9)), 3e-7 * np.delete(PARAMS.increment_sigma, slice(6, 9)))


def test_a_hypothesis_of_failed_jets_opens_with_their_forces_and_impulses() -> None:
    state, over = flown(sound=True).states[2], flown(sound=True).links[2]
    cause = h.Cause(h.Kind.JETS, (4, 1), (1, -1), (0, 0))
    found = h.add_failure_impulses(h.apply_cause(state, cause, PARAMS), cause, np.array([0.2, 0.3]), over, PARAMS)
    assert (found.slot_jet.tolist(), found.slot_sign.tolist()) == ([4.0, 1.0], [1.0, -1.0])
    impulses, slots = unit_force_errors(over, PLACES)[:, [4, 1]] * [0.2, 0.3], np.zeros((PLACES.size, 2))
    slots[PLACES.force :] = np.diag(PARAMS.thrusts[[4, 1]])
    expected = state.root @ state.root.T + impulses @ impulses.T + slots @ slots.T
    turned = h.BOW * over.duration_s * np.linalg.norm(state.mean[RATE]) * np.linalg.norm(impulses[RATE])
    expected[RATE, RATE] += turned**2 * np.eye(3)
    np.testing.assert_allclose(found.root @ found.root.T, expected, atol=1e-12)
    # the same jet again: its force may have changed, in the slot it has
    again, row = h.apply_cause(found, h.Cause(h.Kind.JETS, (4,), (1,), (0,)), PARAMS), PLACES.force
    assert again.slot_jet.tolist() == [4.0, 1.0]
    assert again.root[row] @ again.root[row] == pytest.approx(2 * PARAMS.thrusts[4] ** 2)
    assert h.failure_slot(found, 3, 1) == -1
    # that of an intermittent one is drawn anew every time, that of a drifting one walks by a share of its thrust
    covariance = again.root @ again.root.T
    for walk, kept, own in ((1.0, 0.0, 0.0), (0.02, 1.0, covariance[row, row])):
        after = h.add_force_noise(again, np.array([walk, 0.0]), PARAMS)
        expected = covariance.copy()
        expected[row] *= kept
        expected[:, row] *= kept
        expected[row, row] = own + (walk * PARAMS.thrusts[4]) ** 2
        np.testing.assert_allclose(after.root @ after.root.T, expected, atol=1e-12)
    assert h.add_force_noise(again, NONE, PARAMS) is again
