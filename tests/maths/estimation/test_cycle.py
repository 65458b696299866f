"""A cycle of estimation: its parts in turn, kept and taken up again, and nothing changed behind one's back."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from massprop_drake import load_scenario
from massprop_drake.inputs import params as params_of
from massprop_drake.inputs.scenario import resolved
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample
from massprop_drake.maths.linear_algebra import Array

N = 44
STUCK = 28  # index of jet 29
COUNT = 40  # samples; from the 15th on jet 29 pushes


@cache
def _params(kind: str = "plain") -> EstimationParams:
    data = load_scenario("stuck_on_29").model_dump(mode="json")
    data["estimation"] |= {"start": "nominal", "std_fraction": 0.001}
    if kind == "thrust errors":
        data["estimation"] |= {"thrust_uncertainty": 0.01, "thrust_transient": "gate_lag"}
    if kind == "no detector":
        data["detector"]["kind"] = "off"
    if kind == "no accelerometer":
        bare = {"accelerometers": [], "preferred_accelerometer": None}
        data["vehicle"] = load_scenario("stuck_on_29").vehicle_data.model_dump(mode="json") | bare
    return params_of.estimation_params(resolved(data))


@cache
def _samples() -> tuple[Sample, ...]:
    """The orbiter in free fall: jets 1 and 3 in turn, then jet 29 as well, and a reading missing now and then."""
    vehicle = load_scenario("stuck_on_29").vehicle_data
    period = vehicle.sample_period_s
    rate, velocity, command = np.zeros(3), np.zeros((3, 3)), np.zeros(N)
    nominal, rng, samples = vehicle.nominal, np.random.default_rng(1), []
    positions = np.array([package.position for package in params_of.accelerometers(load_scenario("stuck_on_29"))])
    for number in range(COUNT):
        level = command.copy()
        if number > 15:
            level[STUCK] = 1.0
        wrench = level @ vehicle.wrenches
        outside = np.zeros(6)
        if number % 10 == 9:
            outside = np.array([50.0, 0.0, -20.0, 0.0, 3.0, 0.0])
        torque = wrench[:3] + outside[:3] - np.cross(nominal.center_of_mass, wrench[3:] + outside[3:])
        turn = np.linalg.solve(nominal.inertia, torque) * period
        rate = rate + turn
        velocity = velocity + (wrench[3:] + outside[3:]) / nominal.mass * period
        velocity = velocity + np.cross(turn, positions - nominal.center_of_mass)
        rates = np.round((rate + 1e-7 * rng.normal(size=3)) / 1.52e-6) * 1.52e-6
        velocities = velocity + 1e-3 * rng.normal(size=(3, 3))
        if number == 11:
            rates = np.full(3, np.nan)
        if number == 13:
            velocities[0] = np.nan
        samples.append(Sample(number * period, rates[None], velocities, command, outside))
        command = np.zeros(N)
        command[(0, 2)[number // 8 % 2]] = 1.0
    return tuple(samples)


def _leaves(value: Any) -> list[Any]:
    """All arrays and numbers of nested tuples."""
    if isinstance(value, tuple):
        return [leaf for part in value for leaf in _leaves(part)]
    return [value]


def _assert_same(one: Any, other: Any) -> None:
    ones, others = _leaves(one), _leaves(other)
    assert len(ones) == len(others)
    for left, right in zip(ones, others, strict=True):
        if left is None or right is None:
            assert left is right
        else:
            np.testing.assert_array_equal(left, right)


def _sample(sample: Sample, params: EstimationParams) -> Sample:
    """A sample as a vehicle with these parameters reads it."""
    return sample if _observed(params) else sample._replace(velocities=np.empty((0, 3)))


def _observed(params: EstimationParams) -> bool:
    return params.filter_params.mass is not None


def _run(params: EstimationParams, state: EstimationState, samples: tuple[Sample, ...]) -> list[EstimationStep]:
    steps = []
    for sample in samples:
        steps.append(cycle.step(state, _sample(sample, params), params))
        state = steps[-1].state
    return steps


def test_the_thrust_level_builds_up_from_sample_to_sample() -> None:
    # a jet told to fire in every sample: a lag leaves exp(-k T / tau) of the way to go after k samples
    params, state = _params("thrust errors"), cycle.initial_state(_params("thrust errors"))
    command = np.eye(N)[STUCK]
    for number in range(1, 4):
        reading = np.zeros((1, 3)), np.zeros((3, 3))
        state = cycle.step(state, Sample(number * 0.08, *reading, command), params).state
        np.testing.assert_allclose(state.level, command * -np.expm1(-number * 0.08 / 0.015), rtol=1e-12)


KINDS = ("plain", "thrust errors", "no detector", "no accelerometer")


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_is_its_parts_in_turn(kind: str) -> None:
    params = _params(kind)
    state = cycle.initial_state(params)
    for sample, step in zip(_samples(), _run(params, state, _samples()), strict=True):
        seen = _sample(sample, params)
        measured = cycle.measure(state, seen, params)
        judgment = None if params.detector is None else cycle.judge(state, seen, measured, params)
        done = cycle.finish(state, seen, measured, judgment, params)
        _assert_same(done, step)
        called: list[str] = []

        def noted(part: str, function: Callable[..., Any], *arguments: Any, called: list[str] = called) -> Any:
            called.append(part)
            return function(*arguments)

        _assert_same(cycle.step(state, seen, params, noted), step)
        judged = [] if params.detector is None else [cycle.DETECTOR]
        assert called == [cycle.ESTIMATORS, *judged, cycle.ESTIMATORS]
        state = done.state


def test_the_failure_is_found_and_its_force_known() -> None:
    """So that what the other tests compare is not a vehicle at rest."""
    steps = _run(_params(), cycle.initial_state(_params()), _samples())
    events = [step.judgment.status.detector_event for step in steps if step.judgment is not None]
    assert np.count_nonzero(events) >= 1
    known = steps[-1].state.detector
    assert np.flatnonzero(known.variance).tolist() == [STUCK]
    np.testing.assert_allclose(known.force[STUCK], 868.8, rtol=0.01)
    assert steps[-1].interval.known.acts
    assert not steps[10].interval.known.acts
    assert sum(step.filtered.rotation.rotation_used for step in steps) > 10
    assert sum(step.filtered.mass is not None and step.filtered.mass.mass_used for step in steps) > 10


@pytest.mark.parametrize("kind", KINDS)
def test_no_input_is_modified(kind: str) -> None:
    params = _params(kind)
    before = copy.deepcopy(params)
    state = cycle.initial_state(params)
    for sample in _samples():
        seen = _sample(sample, params)
        kept, kept_sample = copy.deepcopy(state), copy.deepcopy(seen)
        done = cycle.step(state, seen, params)
        _assert_same(state, kept)
        _assert_same(seen, kept_sample)
        state = done.state
    arrays = [leaf for leaf in _leaves(before) if isinstance(leaf, np.ndarray)]
    for left, right in zip(arrays, [leaf for leaf in _leaves(params) if isinstance(leaf, np.ndarray)], strict=True):
        np.testing.assert_array_equal(left, right)


# -------------------------------------------------------------------------------------- kept states


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [0, 16, 17, 18, 30], ids="before sample {}".format)
def test_a_state_that_is_saved_goes_on_bit_for_bit(kind: str, number: int) -> None:
    params = _params(kind)
    start = cycle.initial_state(params)
    whole = _run(params, start, _samples())
    state = whole[number - 1].state if number else start
    groups = cycle.saved(state, params)
    assert all(vector.ndim == 1 for vector in groups.values())
    kept = {name: vector.copy() for name, vector in groups.items()}
    restored = cycle.restored(kept, params)
    _assert_same(restored, state)
    assert type(restored.detector) is type(state.detector)
    rest = _run(params, restored, _samples()[number:])
    for step, expected in zip(rest, whole[number:], strict=True):
        _assert_same(step, expected)


def test_saved_vectors_go_by_the_part_that_holds_them() -> None:
    sizes = {
        kind: {
            name: vector.size for name, vector in cycle.saved(cycle.initial_state(_params(kind)), _params(kind)).items()
        }
        for kind in KINDS
    }
    window = 3 * _params().filter_params.mass.jump_window
    plain = {"impulse_model": 2 * N, "rotation_estimator": 9 + 81 + 4, "mass_estimator": 11 + window}
    detector = {"failure_detector": 10 + 4 * N}
    assert sizes["plain"] == plain | detector
    assert sizes["no detector"] == plain
    errors = {"rotation_estimator": 9 + 81 + 4 + 9 * N, "mass_estimator": 11 + window + N}
    assert sizes["thrust errors"] == plain | detector | errors
    assert sizes["no accelerometer"] == {name: plain[name] for name in ("impulse_model", "rotation_estimator")}


# --------------------------------------------------------------------------- without an accelerometer


def test_without_accelerometer_rotation_is_estimated_all_the_same() -> None:
    params = _params("no accelerometer")
    quiet = _samples()[:16]  # before anything fails
    alone = _run(params, cycle.initial_state(params), quiet)
    both = _run(_params("no detector"), cycle.initial_state(_params("no detector")), quiet)
    for step, other in zip(alone, both, strict=True):
        _assert_same(step.filtered.rotation, other.filtered.rotation)
        assert step.filtered.mass is None
        assert step.judgment is None
    covariance: Array = params.filter.covariance(alone[-1].state.filter)
    np.testing.assert_array_equal(np.argwhere(np.isnan(covariance)), [[9, 9]])
    assert np.isnan(params.filter.predicted(alone[-1].state.filter)[9])
    assert any(step.filtered.rotation.rotation_used for step in alone)


# ------------------------------------------------------------------------------------- known forces


def test_a_known_force_enters_the_impulses_of_the_next_sample() -> None:
    params = _params()
    steps = _run(params, cycle.initial_state(params), _samples())
    declared = next(index for index, step in enumerate(steps) if step.state.detector.variance.any())
    assert not steps[declared].interval.known.acts
    known = steps[declared + 1].interval
    assert known.known.acts
    sample = _samples()[declared + 1]
    expected = (sample.command @ params.impulse_per_level) + known.known.wrench * params.period_s
    found = np.concatenate([known.impulses.angular_impulse, known.impulses.linear_impulse])
    outside = np.zeros(6) if sample.outside_wrench is None else sample.outside_wrench * params.period_s
    np.testing.assert_allclose(found, expected + outside, rtol=1e-12, atol=1e-9)


def test_no_outside_wrench_is_one_of_zero() -> None:
    params = _params()
    state = cycle.initial_state(params)
    quiet = _samples()[5]
    assert quiet.outside_wrench is not None
    assert not quiet.outside_wrench.any()
    _assert_same(cycle.step(state, quiet, params), cycle.step(state, quiet._replace(outside_wrench=None), params))


def test_the_filter_goes_on_from_a_state_that_the_detector_hands_back() -> None:
    params, samples = _params(), _samples()
    steps = _run(params, cycle.initial_state(params), samples)
    before, sample = steps[-2].state, samples[-1]
    measured = cycle.measure(before, sample, params)
    judgment = cycle.judge(before, sample, measured, params)
    assert judgment is not None
    earlier = steps[3].state.filter
    after = cycle.finish(before, sample, measured, judgment._replace(replacement=earlier), params)
    assert after.state.filter is earlier
    _assert_same(after.state.detector, steps[-1].state.detector)
    _assert_same(steps[-1].filtered.rotation, after.filtered.rotation)  # what is logged is the measurement's own
