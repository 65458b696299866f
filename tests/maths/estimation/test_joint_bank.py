"""The bank of onsets: against the filter's own prediction from a snapshot, differences, and dense linear algebra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from joint_probe import PERIOD, central_differences, elapsed, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint.bank import Bank, averaging, onset_of, output_rows
from massprop_drake.maths.estimation.joint.joint_cycle import JointSample, driven, step
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import outputs, rate_read, readings
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.sensitivity import Link, carried, corrected, link
from massprop_drake.maths.estimation.joint.ticks import Pace, stamped, started
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params(second_order=False, flows=np.zeros(6))
PLACES = PARAMS.places
CYCLES = 12


class Flight(NamedTuple):
    """States after each cycle, and what each cycle made of its sample."""

    states: list[JointState]
    samples: list[JointSample]
    links: list[Link]


def flight(first: JointState, params: JointParams, cycles: int = CYCLES, jitter_s: float = 0.0) -> Flight:
    """A settled filter whose readings are what it predicts, and noise; stamps are off their ticks by so much."""
    rng, of_stamps = np.random.default_rng(5), np.random.default_rng(1)
    states, samples, links, commands = [first], [], [], np.zeros((2, 6))
    clock = started(0.0, commands[0])
    for k in range(cycles):
        commands = np.vstack((commands[1], rng.uniform(size=6) < 0.4)).astype(float)
        stamp_s = (k + 1) * PERIOD + jitter_s * of_stamps.standard_normal()
        clock, interval = elapsed(clock, stamp_s, (commands[0], commands[1]), Pace(PERIOD))
        pieces = {"durations_s": interval.durations_s, "commands": interval.commands, "timing": interval.timing}
        sample = some_sample(params, time_s=(k + 1) * PERIOD, **pieces)
        told, _ = stamped(states[-1], sample.timing, params)
        acting = driven(told, sample, params)
        prediction = predict(told, acting, unread(params), params)
        read, _ = outputs(prediction.mean, first.reference, states[-1].spin + prediction.spin, params)
        read = read + rng.standard_normal(12) * np.sqrt(params.variances)
        sample = sample._replace(rates=read[:6].reshape(2, 3), velocities=read[6:].reshape(2, 3))
        after, report = step(states[-1], sample, params)
        links.append(link(states[-1], report, sample, params))
        states.append(after)
        samples.append(sample)
    return Flight(states, samples, links)


def ready(seed: int = 0) -> JointState:
    """A settled state with small errors."""
    state = some_state(PARAMS, seed)._replace(guarded=True, firing_count=100.0)
    return state._replace(root=np.linalg.cholesky(0.01 * state.root @ state.root.T))


def banked(flown: Flight) -> list[Bank]:
    """The bank before the update of each cycle."""
    bank, before = banks.empty(PLACES), []
    for cycle, over in enumerate(flown.links):
        bank = banks.advanced(bank, over, PLACES)
        before.append(bank)
        bank = banks.taken(bank, over, flown.states[cycle + 1], cycle, PARAMS)
    return before


def unlearned(mean: Array, flown: Flight, onset: int, last: int) -> Array:
    """Outputs at a cycle, predicted by the filter from an earlier state without learning."""
    state = flown.states[onset + 1]
    moved_s = PARAMS.tick_sigma * (mean - state.mean)[PLACES.ticks : PLACES.ticks + 2]
    state = state._replace(mean=mean, level=state.level + moved_s @ state.tick_slope)
    for cycle in range(onset + 1, last + 1):
        sample = flown.samples[cycle]
        acting = driven(state, sample, PARAMS)
        prediction = predict(state, acting, rate_read(sample.rates, state.mean, PARAMS), PARAMS)
        state = state._replace(
            mean=prediction.mean,
            spin=state.spin + prediction.spin,
            level=acting.firing.level,
            slope=acting.firing.slope,
            tick_slope=acting.tick_slope,
        )
    values, _ = outputs(state.mean, state.reference, state.spin, PARAMS)
    return values


@pytest.mark.parametrize("jitter_s", [0.0, 1e-3])
def test_residual_is_that_of_the_filters_own_prediction_from_the_snapshot(jitter_s: float) -> None:
    flown = flight(ready(), PARAMS, jitter_s=jitter_s)
    bank = banked(flown)[-1]
    over, last = flown.links[-1], flown.samples[-1]
    read = readings(last.rates, last.velocities, last.attitudes)
    filters_own = np.abs(over.innovation).max()
    for index, cycle in enumerate(bank.cycles):
        onset = int(cycle)
        expected = read - unlearned(flown.states[onset + 1].mean, flown, onset, CYCLES - 1)
        found = over.innovation + over.jacobian @ bank.learned[index]
        off = np.abs(found - expected) / np.sqrt(PARAMS.variances if jitter_s else PARAMS.variances.min())
        assert off.max() < (0.05 if jitter_s else 0.02)
        assert np.abs(found - over.innovation).max() > 1e-3 * filters_own or onset == CYCLES - 2


@pytest.mark.parametrize("jitter_s", [0.0, 1e-3])
def test_rows_are_the_derivative_of_that_prediction(jitter_s: float) -> None:
    flown = flight(ready(), PARAMS, jitter_s=jitter_s)
    bank, over = banked(flown)[-1], flown.links[-1]
    mean = averaging(over.read, PLACES)
    assert mean is not None
    scale = np.sqrt(np.sum(flown.states[3].root ** 2, axis=1))
    for index in (2, 6):
        onset = int(bank.cycles[index])
        jacobian = central_differences(
            lambda at, o=onset: unlearned(at, flown, o, CYCLES - 1), flown.states[onset + 1].mean, 0.1 * scale
        )
        found = output_rows(bank, index, mean @ over.jacobian, PARAMS)
        difference = (found - mean @ jacobian) * scale
        size = np.abs(mean @ jacobian * scale).max(axis=1, keepdims=True)
        assert (np.abs(difference) < 0.02 * size).all()


def test_statistics_agree_with_dense_linear_algebra() -> None:
    flown = flight(ready(), PARAMS)
    bank, over = banked(flown)[-1], flown.links[-1]
    found = banks.tested(bank, over, 0.0, PARAMS)
    assert found is not None
    mean = np.zeros((6, 12))
    for axis in range(3):
        mean[axis, [axis, 3 + axis]] = mean[3 + axis, [6 + axis, 9 + axis]] = 0.5
    on_outputs = np.hstack([mean @ over.jacobian[:, 10:13], mean @ (over.jacobian[:, 13:16] + over.jacobian[:, 16:19])])
    for index in (0, 4, 8):
        residual = mean @ (over.innovation + over.jacobian @ bank.learned[index])
        rows = output_rows(bank, index, mean @ over.jacobian, PARAMS)
        root = bank.states[index].root
        total = rows @ root @ root.T @ rows.T + mean @ np.diag(PARAMS.variances) @ mean.T
        total += on_outputs @ bank.noise[index] @ on_outputs.T
        weighted = np.linalg.solve(total, residual)
        assert found.total[index] == pytest.approx(residual @ weighted, rel=1e-8)
        for jet in range(6):
            signature = on_outputs @ over.effects[jet]
            projection, energy = signature @ weighted, signature @ np.linalg.solve(total, signature)
            seconds = bank.missing[index, jet] if projection > 0 else bank.given[index, jet]
            shows = seconds > 0.5 * PERIOD
            expected = projection**2 / energy if shows else 0.0
            assert found.likelihood[index, jet] == pytest.approx(expected, rel=1e-7)
            if shows:
                limit = PARAMS.thrusts[jet]
                force = np.clip(projection / energy / seconds, -limit, limit)
                assert found.force[index, jet] == pytest.approx(force, rel=1e-7)


def test_an_onset_that_foretells_nothing_is_left_out_and_the_others_are_tested() -> None:
    flown = flight(ready(), PARAMS)
    bank, over = banked(flown)[-1], flown.links[-1]
    expected = banks.tested(bank, over, 0.0, PARAMS)
    assert expected is not None
    lost = [state._replace(root=1e9 * state.root) if index == 2 else state for index, state in enumerate(bank.states)]
    found = banks.tested(bank._replace(states=tuple(lost)), over, 0.0, PARAMS)
    assert found is not None
    others = np.arange(len(lost)) != 2
    np.testing.assert_array_equal(found.total[others], expected.total[others])
    assert expected.total[2] > 0.0
    assert found.total[2] == found.likelihood[2].max() == 0.0
    whole = tuple(state._replace(root=1e9 * state.root) for state in bank.states)
    assert banks.tested(bank._replace(states=whole), over, 0.0, PARAMS) is None


def test_what_is_left_out_goes_through_the_filter_as_a_column() -> None:
    """A filter that starts off by x ends off by its column, with the same readings and gains."""
    start = ready(2)
    flown = flight(start, PARAMS)
    rng = np.random.default_rng(8)
    off = 0.05 * start.root @ rng.standard_normal(PLACES.size)
    state, column = start._replace(mean=start.mean + off), off.reshape(-1, 1)
    for cycle, over in enumerate(flown.links):
        state, report = step(state, flown.samples[cycle], PARAMS)
        before = carried(column, np.zeros((6, 1)), over, PLACES)
        shown = over.jacobian @ before
        np.testing.assert_allclose(
            report.innovation - over.innovation, -shown[:, 0], atol=3e-2 * np.abs(shown).max() + 1e-12
        )
        column = corrected(before, shown, over)
    deviation = np.sqrt(np.sum(state.root**2, axis=1))
    np.testing.assert_allclose((state.mean - flown.states[-1].mean) / deviation, column[:, 0] / deviation, atol=2e-3)


def test_test_says_nothing_where_an_axis_has_no_reading_or_nothing_can_reach_the_level() -> None:
    flown = flight(ready(), PARAMS)
    bank, over = banked(flown)[-1], flown.links[-1]
    blind = over.read.copy()
    blind[[1, 4]] = np.nan
    assert banks.tested(bank, over._replace(read=blind), 0.0, PARAMS) is None
    assert banks.tested(bank, over, 1e9, PARAMS) is None
    assert banks.tested(banks.empty(PLACES), over, 0.0, PARAMS) is None
    one = over.read.copy()
    one[1] = np.nan
    assert banks.tested(bank, over._replace(read=one), 0.0, PARAMS) is not None  # the other package reads


def test_onsets_reach_back_and_stay_few() -> None:
    flown = flight(ready(), PARAMS, 1)
    over, state = flown.links[0], flown.states[1]
    bank = banks.empty(PLACES)
    for cycle in range(300):
        bank = banks.taken(banks.advanced(bank, over, PLACES), over, state, cycle, PARAMS)
    ages = 299 - bank.cycles
    assert ages.shape[0] <= banks.ONSETS
    assert ages[-3:].tolist() == [2, 1, 0]
    assert 130 < ages[0] <= banks.OLDEST
    gaps = -np.diff(ages)
    assert (gaps <= np.maximum(2.0, 0.5 * ages[:-1])).all()


def test_the_youngest_of_the_onsets_that_explain_as_much() -> None:
    assert onset_of(np.array([50.0, 49.0, 40.0, 10.0]), 0.7) == 2
