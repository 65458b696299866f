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
from massprop_drake.maths.estimation import cycle, whole
from massprop_drake.maths.estimation import estimation_ports as ports
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, pack_adaptation
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample
from massprop_drake.maths.estimation.detector import KNOWN_FORCE, NO_KNOWN_FORCE, STATUS, unpack_known_force
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.impulses import LAYOUT as IMPULSES
from massprop_drake.maths.kernels import Holder, read_bundle
from massprop_drake.systems.layouts import MASS_REPORT, ROTATION_REPORT

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
    params, called = params_for(kind), []
    state, before = cycle.initial_state(params), copy.deepcopy(leaves(params))

    def noted(part: str, function: Any, *arguments: Any) -> Any:
        called.append(part)
        return function(*arguments)

    for sample, step in zip(samples(kind), steps_of(kind), strict=True):
        kept = copy.deepcopy((state, sample))
        assert_same(cycle.step(state, sample, params, noted), step)
        assert_same((state, sample), kept)
        state = step.state
    parts = [cycle.ESTIMATORS, *([] if params.detector is None else [cycle.DETECTOR]), cycle.ESTIMATORS]
    assert called == COUNT * parts
    assert_same(tuple(before), params)
    sample = samples(kind)[5]  # no outside wrench is one of zero
    assert not sample.outside_wrench.any()
    assert_same(cycle.step(steps_of(kind)[4].state, sample._replace(outside_wrench=None), params), steps_of(kind)[5])


@pytest.mark.parametrize("kind", ["plain", "no detector"])
def test_one_kernel_gives_the_bits_of_the_parts(kind: str) -> None:
    params, steps, given = params_for(kind), steps_of(kind), samples(kind)
    widths = (IMPULSES.size, ROTATION_REPORT.size, MASS_REPORT.size, STATUS.size + 4 * N)
    rows, asked = whole.ThesisRows(*(np.zeros((COUNT, width)) for width in widths)), whole.empty_requests(N)
    taken = ("time_s", "rates", "velocities", "command", "outside_wrench")
    block = whole.Samples(*(np.array([getattr(sample, name) for sample in given]) for name in taken))
    state = Holder(cycle.initial_state(params))
    reached = np.array([0, COUNT])
    whole.advance(state, Holder(whole.ThesisBlock(block, rows, asked)), reached, Holder(whole.kernel_params(params)))
    assert_same(state.value, steps[-1].state)
    assert_array_equal(rows.rotation_report, [ROTATION_REPORT.pack(step.filtered.rotation) for step in steps])
    assert_array_equal(rows.mass_report, [MASS_REPORT.pack(step.filtered.mass) for step in steps])
    if kind == "plain":
        assert_array_equal(rows.detector_report[:, : STATUS.size], [STATUS.pack(one.judgment.status) for one in steps])
        assert_array_equal(asked.force, steps[-1].state.detector.force)


@pytest.mark.parametrize(
    ("override", "covered"),
    [
        ("duration_s=1", True),
        ("detector.kind=off", True),
        ("detector.kind=cusum", False),
        ("sensors.combine.accelerometers=average", False),
        ("estimation.thrust_uncertainty=0.01", False),
    ],
)
def test_what_the_kernel_does_not_do_is_left_to_the_parts(override: str, covered: bool) -> None:
    assert whole.covers(params_of.estimation_params(load_scenario("sample_maneuver", [override]))) == covered


@pytest.mark.parametrize("kind", ["plain", "no detector"])
def test_kernels_of_systems_one_after_the_other_are_a_cycle_bit_by_bit(kind: str) -> None:
    """Packed, and called as the systems of a diagram call them."""
    made = params_for(kind)
    groups = cycle.save_state(cycle.initial_state(made), made)
    rotation, mass = made.filter_params.rotation, made.filter_params.mass
    of_rotation, of_mass = thesis.rotation_layout(rotation, 0), thesis.mass_layout(mass, 0)
    turned = ports.RotationVector(*of_rotation.read(groups["rotation_estimator"])[:-1])
    moved = ports.MassVector(*of_mass.read(groups["mass_estimator"])[:-1])
    lagging = Holder(ports.Lagging(made.impulse_per_level, made.lag, made.period_s))
    rotating, weighing = (
        Holder(ports.make_rotation_filter(rotation, turned)),
        Holder(ports.make_mass_filter(mass, moved)),
    )
    judging = None if made.detector is None else Holder(ports.make_detector(made.detector_params))
    for sample, step in zip(samples(kind), steps_of(kind), strict=True):
        command, of_rotation, of_mass = sample.command, groups["rotation_estimator"], groups["mass_estimator"]
        row = ports.impulses(groups["impulse_model"], command, sample.outside_wrench, lagging)
        told, force = row[: IMPULSES.size].copy(), KNOWN_FORCE.pack(NO_KNOWN_FORCE)
        if judging is not None and read_bundle(groups["failure_detector"], judging.value.state).variance.any():
            predicted = np.append(of_rotation[:9], of_mass[0])
            force = ports.known_force(groups["failure_detector"], predicted, command, judging)
        if unpack_known_force(force).acts:
            told[:6] += force[:6] * made.period_s
        turned_row = ports.measure_rotation(of_rotation, sample.rates, told, force, rotating)
        said = turned_row[: thesis.TURNING.sized(jets=0).size]
        moved_row = ports.measure_mass(of_mass, sample.velocities, said, told, force, weighing)
        asked = pack_adaptation(NO_ADAPTATION)
        if judging is not None:
            seen, detector = moved_row[:213], groups["failure_detector"]
            judged = ports.run_detector(detector, sample.time_s, command, told, seen, judging)
            asked, groups["failure_detector"] = judged[:26], judged[33 : 33 + detector.size]
        turned_row = ports.finish_rotation(turned_row, asked, rotating)
        moved_row = ports.finish_mass(moved_row, asked, weighing)
        assert_array_equal(turned_row[: ROTATION_REPORT.size], ROTATION_REPORT.pack(step.filtered.rotation))
        assert_array_equal(moved_row[: MASS_REPORT.size], MASS_REPORT.pack(step.filtered.mass))
        groups["impulse_model"] = np.append(command, row[IMPULSES.size + N :])
        groups["rotation_estimator"] = turned_row[ROTATION_REPORT.size :]
        groups["mass_estimator"] = moved_row[MASS_REPORT.size :]
        for name, vector in cycle.save_state(step.state, made).items():
            assert_array_equal(groups[name], vector, err_msg=f"{name} at {sample.time_s}")


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
def test_a_state_that_is_saved_goes_on_bit_for_bit(kind: str) -> None:
    params, steps, number = params_for(kind), steps_of(kind), 25
    for state in (cycle.initial_state(params), steps[number - 1].state):
        restored = cycle.restore_state(cycle.save_state(state, params), params)
        assert_same(restored, state)
        assert type(restored.detector) is type(state.detector)
    for step, expected in zip(run_on(restored, kind, number), steps[number:], strict=True):
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


def test_the_filter_goes_on_from_a_state_that_the_detector_hands_back() -> None:
    params, steps, sample = params_for(), steps_of("plain"), samples()[-1]
    before, earlier = steps[-2].state, steps[3].state.filter
    measured = cycle.measure(before, sample, params)
    judgment = cycle.judge(before, sample, measured, params)
    after = cycle.finish(before, sample, measured, judgment._replace(replacement=earlier), params)
    assert after.state.filter is earlier
    assert_same(after.state.detector, steps[-1].state.detector)
    assert_same(steps[-1].filtered.rotation, after.filtered.rotation)  # what is logged is the measurement's own
