"""The start of the joint filter, gone over again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from joint_probe import unrounded

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState
from massprop_drake.maths.estimation.joint import joint_cycle, start
from massprop_drake.maths.estimation.joint.joint_cycle import OWN_CHOICE, JointSample, cycled, gone_over
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.start import BEGUN, LONGEST, OVER, STEPS, Kept
from massprop_drake.maths.estimation.joint.thrust_scale import reported
from massprop_drake.maths.estimation.joint.ticks import on_ticks

END_S = 10.0
ACCELEROMETERS = ("acc2", "acc1", "acc3")  # the preferred one first, as the filter has them


@pytest.fixture(scope="module")
def flown() -> Run:
    """The beginning of a maneuver in which the second order alone leads to a wrong center of mass."""
    settings = ["plant.lag_factor=0.9523809523809523", "plant.thrust_dispersion=0.01", "joint.thrust_uncertainty=0.01"]
    given = ["detector.kind=off", "execution.engine=loop", f"duration_s={END_S}", "seed=50009"]
    return simulate(load_scenario("orbiter_maneuver", [*settings, *given]))


@pytest.fixture(scope="module")
def params(flown: Run) -> JointFilterParams:
    return inputs.joint_params(flown.scenario)


def cycles(run: Run, params: JointFilterParams, kept: start.Start = BEGUN) -> Iterator[JointFilterState]:
    """States of the filter over the telemetry of a run."""
    state = joint.initial(params)._replace(start=kept)
    velocities = np.stack([run[name] for name in ACCELEROMETERS], axis=1)
    for row, time_s in enumerate(run.time_s.tolist()):
        told = Told(time_s, time_s, run["command"][max(row - 1, 0)], None, np.zeros(6))
        state = joint.step(state, run["gyro"][row].reshape(1, 3), velocities[row], told, params).state
        yield state


def nees(state: JointState, run: Run, params: JointFilterParams) -> float:
    """Square of the errors of the ten parameters over their covariance: ten if it is honest."""
    estimate, rows = reported(state, params.joint)
    deviation = np.sqrt(np.sum(rows * rows, axis=1))
    scaled = (estimate - run["truth"][-1]) / deviation
    half = rows / deviation[:, None]
    return float(scaled @ np.linalg.solve(half @ half.T, scaled))


def test_a_start_from_zero_does_not_lock_on_wrongly(flown: Run, params: JointFilterParams) -> None:
    *_, alone = cycles(flown, params, OVER)
    *_, gone_over_again = cycles(flown, params)
    assert nees(alone.joint, flown, params) < 30.0  # 200 where outputs are linearized at the rate that was predicted
    assert nees(gone_over_again.joint, flown, params) < 30.0
    assert gone_over_again.joint.guarded
    assert gone_over_again.start == OVER


def test_a_pass_is_spread_over_cycles_and_nothing_has_converged_meanwhile(
    flown: Run, params: JointFilterParams, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []

    def counting(state: JointState, sample: JointSample, about: np.ndarray, own: JointParams) -> object:
        made[-1] += 1
        return gone_over(state, sample, about, own)

    monkeypatch.setattr(start, "gone_over", counting)
    under_pass = 0
    states = cycles(flown, params)
    while True:
        made.append(0)
        state = next(states, None)
        if state is None:
            break
        if state.start.under_pass is not None:
            under_pass += 1
            assert not state.joint.guarded
    assert under_pass > 2
    assert max(made) == STEPS


def test_a_pass_about_what_is_known_is_the_filters_own_cycle(flown: Run, params: JointFilterParams) -> None:
    *_, state = cycles(flown, params)
    own = unrounded(params.joint)
    root = state.joint.root.copy()
    root[:N_PROPERTIES] *= 1e-9  # nothing of second order
    known = state.joint._replace(root=root)
    fired = np.flatnonzero(flown["command"].any(axis=1))[-1]
    velocities = np.stack([flown[name][-1] for name in ACCELEROMETERS])
    command = flown["command"][fired].reshape(1, -1)
    sample = JointSample(
        known.time_s + 0.08, np.array([0.08]), command, np.zeros(6), flown["gyro"][-1:], velocities, on_ticks()
    )
    expected = cycled(known, sample, np.full_like(own.thresholds, np.inf), OWN_CHOICE, own)
    after, nis, components = gone_over(known, sample, known.mean, own)
    np.testing.assert_allclose(after.mean, expected.state.mean, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(after.root @ after.root.T, expected.state.root @ expected.state.root.T, atol=1e-10)
    assert components == expected.expected.used.sum()
    assert nis == pytest.approx(expected.nis, rel=1e-2)


def test_a_pass_is_linear_in_what_it_estimates(flown: Run) -> None:
    """However far mass properties and biases are from where it is linearized, and the rates that go with them."""
    own = inputs.joint_params(load_scenario("orbiter_maneuver", ["vehicle.gyros[0].bias_std=5e-4"])).joint
    own = unrounded(own)
    places, row = own.places, int(np.flatnonzero(flown["command"].any(axis=1))[4])
    velocities = np.stack([flown[name][row + 1] for name in ACCELEROMETERS])
    readings = flown["gyro"][row + 1].reshape(1, 3), velocities
    sample = JointSample(
        0.08, np.array([0.08]), flown["command"][row].reshape(1, -1), np.zeros(6), *readings, on_ticks()
    )
    state = joint_cycle.begun(joint_cycle.initial(own), sample, own)
    about = state.mean.copy()
    about[:N_PROPERTIES] = flown["truth"][0]
    about[places.gyro_bias : places.gyro_bias + 3] = (1.0, -0.5, 2.0)
    there = state.mean.copy()
    there[:N_PROPERTIES] = 1.5 * flown["truth"][0]
    there[places.gyro_bias : places.gyro_bias + 3] = (-2.0, 1.0, 0.5)
    there[RATE] -= own.gyro_bias_sigma * there[places.gyro_bias : places.gyro_bias + 3]

    def after(share: float) -> np.ndarray:
        mean = (1.0 - share) * state.mean + share * there
        return gone_over(state._replace(mean=mean), sample, about, own)[0].mean

    scale = np.maximum(np.abs(after(1.0) - after(0.0)), 1e-9)
    np.testing.assert_allclose((after(0.3) - 0.7 * after(0.0) - 0.3 * after(1.0)) / scale, 0.0, atol=1e-6)


def test_nothing_is_kept_before_anything_acts(flown: Run, params: JointFilterParams) -> None:
    first = int(np.flatnonzero(flown["command"].any(axis=1))[0])
    for row, state in enumerate(cycles(flown, params)):
        assert bool(state.start.kept) == (row > first)
        if row > first:
            break


def test_a_start_that_takes_too_long_stands_as_it_is(flown: Run, params: JointFilterParams) -> None:
    for state in cycles(flown, params):
        if len(state.start.kept) > 3:
            break
    long = state.start._replace(kept=state.start.kept[:1] * LONGEST)
    done = joint_cycle.step(state.joint, state.start.kept[-1].sample, params.joint)
    kept, after = start.followed(long, state.joint, done, state.start.kept[-1], params.joint)
    assert kept == OVER
    assert after is done[0]


def test_passes_that_do_not_explain_the_readings_change_nothing(flown: Run, params: JointFilterParams) -> None:
    guarded = next(state.joint for state in cycles(flown, params, OVER) if state.joint.guarded)
    states = cycles(flown, params)
    kept = next(state.start for state in states if state.start.under_pass is not None)
    off = [
        one._replace(sample=one.sample._replace(rates=one.sample.rates + 0.01 * (-1) ** k))
        for k, one in enumerate(kept.kept)
    ]
    wrong = kept._replace(kept=tuple(off), under_pass=None)
    own, report = joint_cycle.step(guarded, off[-1].sample, params.joint)
    done = own._replace(guarded=True), report
    after = own
    for _ in range(100):
        wrong, after = start.followed(wrong, guarded, done, off[-1], params.joint)
        if not wrong.under_way:
            break
    assert wrong == start.CONTRADICTED
    assert after is done[0]


def test_an_increment_on_the_way_widens_what_passes_begin_with(flown: Run, params: JointFilterParams) -> None:
    kept = next(state.start for state in cycles(flown, params) if len(state.start.kept) > 3)
    assert kept.entry is not None
    about = kept.entry
    plain = start._begun(kept, about, 1, params.joint)
    wide = start._begun(kept._replace(incremented=True), about, 1, params.joint)
    added = (wide.state.root @ wide.state.root.T - plain.state.root @ plain.state.root.T)[:10, :10]
    np.testing.assert_allclose(added, np.diag(params.joint.increment_sigma**2), rtol=1e-9, atol=1e-18)


def test_a_gap_in_the_start_is_gone_over_as_a_gap(flown: Run, params: JointFilterParams) -> None:
    kept = next(state.start for state in cycles(flown, params) if len(state.start.kept) > 6)
    entry = kept.entry
    assert entry is not None
    last = kept.kept[3].sample
    gap = kept._replace(kept=(*kept.kept[:3], Kept(last, anew=True)))
    under_pass, arrived = start._begun(gap, entry, 1, params.joint), False
    while not arrived:
        under_pass, arrived = start._gone_on(gap, under_pass, params.joint)
    np.testing.assert_allclose(under_pass.state.mean[RATE], last.rates[0], rtol=1e-12)
