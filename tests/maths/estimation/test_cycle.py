"""A cycle of estimation: its parts in turn, kept and taken up again, and nothing changed behind one's back."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake import load_scenario
from massprop_drake.inputs import params as params_of
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample

N, STUCK = 44, 28  # jets, and the index of jet 29
COUNT = 40  # samples; from the 15th on jet 29 pushes
KINDS = ("plain", "thrust errors", "no detector", "no accelerometer")


@cache
def params_for(kind: str = "plain") -> EstimationParams:
    data = load_scenario("stuck_on_29").model_dump(mode="json")
    data["estimation"] |= {"start": "nominal", "std_fraction": 0.001}
    if kind == "thrust errors":
        data["estimation"] |= {"thrust_uncertainty": 0.01, "thrust_transient": "gate_lag"}
    if kind == "no detector":
        data["detector"]["kind"] = "off"
    if kind == "no accelerometer":
        bare = {"accelerometers": [], "preferred_accelerometer": None}
        data["vehicle"] = load_scenario("stuck_on_29").vehicle_data.model_dump(mode="json") | bare
    return params_of.estimation_params(resolve_scenario(data))


@cache
def samples(kind: str = "plain") -> tuple[Sample, ...]:
    """The orbiter in free fall: jets 1 and 3 in turn, then jet 29 as well, and a reading missing now and then."""
    scenario = load_scenario("stuck_on_29")
    vehicle, made = scenario.vehicle_data, []
    nominal, period, rng = vehicle.nominal, vehicle.sample_period_s, np.random.default_rng(1)
    rate, velocity, command = np.zeros(3), np.zeros((3, 3)), np.zeros(N)
    arms = np.array([package.position for package in params_of.accelerometers(scenario)]) - nominal.center_of_mass
    for number in range(COUNT):
        level = command.copy()
        level[STUCK] += number > 15
        outside = np.array([50.0, 0.0, -20.0, 0.0, 3.0, 0.0]) * (number % 10 == 9)
        wrench = level @ vehicle.wrenches + outside
        turn = np.linalg.solve(nominal.inertia, wrench[:3] - np.cross(nominal.center_of_mass, wrench[3:])) * period
        rate = rate + turn
        velocity = velocity + wrench[3:] / nominal.mass * period + np.cross(turn, arms)
        rates = np.round((rate + 1e-7 * rng.normal(size=3)) / 1.52e-6) * 1.52e-6
        velocities = velocity + 1e-3 * rng.normal(size=(3, 3))
        if number == 11:
            rates[:] = np.nan
        if number == 13:
            velocities[0] = np.nan
        if kind == "no accelerometer":
            velocities = np.empty((0, 3))
        made.append(Sample(number * period, rates[None], velocities, command, outside))
        command = np.eye(N)[(0, 2)[number // 8 % 2]]
    return tuple(made)


def leaves(value: Any) -> list[Any]:
    """All arrays and numbers of nested tuples."""
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, tuple) else [value]


def assert_same(one: Any, other: Any) -> None:
    for left, right in zip(leaves(one), leaves(other), strict=True):
        if left is None or right is None or callable(left):
            assert left is right
        else:
            assert_array_equal(left, right)


def run_on(state: EstimationState, kind: str, since: int = 0) -> list[EstimationStep]:
    steps = []
    for sample in samples(kind)[since:]:
        steps.append(cycle.step(state, sample, params_for(kind)))
        state = steps[-1].state
    return steps


@cache
def steps_of(kind: str) -> list[EstimationStep]:
    return run_on(cycle.initial_state(params_for(kind)), kind)


def test_the_thrust_level_builds_up_from_sample_to_sample() -> None:
    # a jet told to fire in every sample: a lag leaves exp(-k T / tau) of the way to go after k samples
    params = params_for("thrust errors")
    state, command = cycle.initial_state(params), np.eye(N)[STUCK]
    for number in range(1, 4):
        sample = Sample(number * 0.08, np.zeros((1, 3)), np.zeros((3, 3)), command)
        state = cycle.step(state, sample, params).state
        assert_allclose(state.level, command * -np.expm1(-number * 0.08 / 0.015), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_is_its_parts_in_turn_and_changes_no_input(kind: str) -> None:
    params = params_for(kind)
    state, before, called = cycle.initial_state(params), copy.deepcopy(leaves(params)), []

    def noted(part: str, function: Any, *arguments: Any) -> Any:
        called.append(part)
        return function(*arguments)

    for sample, step in zip(samples(kind), steps_of(kind), strict=True):
        kept = copy.deepcopy((state, sample))
        measured = cycle.measure(state, sample, params)
        judgment = None if params.detector is None else cycle.judge(state, sample, measured, params)
        done = cycle.finish(state, sample, measured, judgment, params)
        assert_same(done, step)
        assert_same(cycle.step(state, sample, params, noted), step)
        assert_same((state, sample), kept)
        state = done.state
    parts = [cycle.ESTIMATORS, *([] if params.detector is None else [cycle.DETECTOR]), cycle.ESTIMATORS]
    assert called == COUNT * parts
    assert_same(tuple(before), params)


def test_the_failure_is_found_and_its_force_enters_the_impulses_of_the_next_sample() -> None:
    steps, params = steps_of("plain"), params_for()
    assert sum(step.judgment.status.detector_event for step in steps) >= 1
    known = steps[-1].state.detector
    assert np.flatnonzero(known.variance).tolist() == [STUCK]
    assert_allclose(known.force[STUCK], 868.8, rtol=0.01)
    assert sum(step.filtered.rotation.rotation_used for step in steps) > 10
    assert sum(step.filtered.mass.mass_used for step in steps) > 10
    declared = next(index for index, step in enumerate(steps) if step.state.detector.variance.any())
    assert not steps[declared].interval.known.acts
    interval, sample = steps[declared + 1].interval, samples()[declared + 1]
    assert interval.known.acts
    expected = sample.command @ params.impulse_per_level
    expected = expected + (interval.known.wrench + sample.outside_wrench) * params.period_s
    found = np.concatenate([interval.impulses.angular_impulse, interval.impulses.linear_impulse])
    assert_allclose(found, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [0, 17, 30], ids="before sample {}".format)
def test_a_state_that_is_saved_goes_on_bit_for_bit(kind: str, number: int) -> None:
    params, whole = params_for(kind), steps_of(kind)
    state = whole[number - 1].state if number else cycle.initial_state(params)
    groups = cycle.save_state(state, params)
    assert all(vector.ndim == 1 for vector in groups.values())
    restored = cycle.restore_state({name: vector.copy() for name, vector in groups.items()}, params)
    assert_same(restored, state)
    assert type(restored.detector) is type(state.detector)
    for step, expected in zip(run_on(restored, kind, number), whole[number:], strict=True):
        assert_same(step, expected)


def test_saved_vectors_go_by_the_part_that_holds_them() -> None:
    window = 3 * params_for().filter_params.mass.jump_window
    rotation = {"impulse_model": 2 * N, "rotation_estimator": 9 + 81 + 4}
    mass, detector = {"mass_estimator": 11 + window}, {"failure_detector": 10 + 4 * N}
    errors = {"rotation_estimator": 9 + 81 + 4 + 9 * N, "mass_estimator": 11 + window + N}
    expected = (rotation | mass | detector, rotation | errors | detector, rotation | mass, rotation)
    for kind, sizes in zip(KINDS, expected, strict=True):
        groups = cycle.save_state(cycle.initial_state(params_for(kind)), params_for(kind))
        assert {name: vector.size for name, vector in groups.items()} == sizes


def test_no_outside_wrench_is_one_of_zero() -> None:
    params, quiet = params_for(), samples()[5]
    state = cycle.initial_state(params)
    assert not quiet.outside_wrench.any()
    assert_same(cycle.step(state, quiet, params), cycle.step(state, quiet._replace(outside_wrench=None), params))


def test_the_filter_goes_on_from_a_state_that_the_detector_hands_back() -> None:
    params, steps, sample = params_for(), steps_of("plain"), samples()[-1]
    before, earlier = steps[-2].state, steps[3].state.filter
    measured = cycle.measure(before, sample, params)
    judgment = cycle.judge(before, sample, measured, params)
    after = cycle.finish(before, sample, measured, judgment._replace(replacement=earlier), params)
    assert after.state.filter is earlier
    assert_same(after.state.detector, steps[-1].state.detector)
    assert_same(steps[-1].filtered.rotation, after.filtered.rotation)  # what is logged is the measurement's own
