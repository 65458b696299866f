"""The real-time estimator: the diagram's answers without the diagram."""

from __future__ import annotations

import copy
import json
import math
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Estimator, EstimatorStep, InputError, Run, Scenario, Vehicle, load_scenario, simulate
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import resolved

STILL = np.zeros(3)
OFF = np.zeros(44)


def _replay(run: Run, accelerometer: str = "acc2") -> tuple[Estimator, list[EstimatorStep]]:
    """The estimator over a run's readings and commands."""
    dut = Estimator(run.scenario.vehicle_data, run.scenario)
    samples = zip(run.time_s, run["gyro"], run[accelerometer], run["command"], strict=True)
    return dut, [dut.step(*sample) for sample in samples]


def test_it_equals_the_diagram_sample_by_sample(sample_run: Run) -> None:
    # the same functions on the same numbers: not a bit of difference
    dut, steps = _replay(sample_run)
    np.testing.assert_array_equal([step.time_s for step in steps], sample_run.time_s)
    np.testing.assert_array_equal([step.estimate for step in steps], sample_run["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], sample_run["standard_deviation"])
    np.testing.assert_array_equal([step.converged for step in steps], sample_run["converged"][:, 0])
    np.testing.assert_array_equal([step.used for step in steps], sample_run["rotation_used"][:, 0])
    np.testing.assert_array_equal([step.mass_used for step in steps], sample_run["mass_used"][:, 0])
    np.testing.assert_array_equal([step.rotation_nis for step in steps], sample_run["rotation_nis"][:, 0])
    np.testing.assert_array_equal([step.mass_nis for step in steps], sample_run["mass_nis"][:, 0])
    np.testing.assert_array_equal(dut.covariance, sample_run.covariance)
    assert sample_run["rotation_used"].sum() > 100  # there was something to compare
    assert sample_run["converged"][-1, 0] == 1.0


def test_it_equals_the_diagram_with_other_settings() -> None:
    overrides = [
        "duration_s=24",
        "rotation={filter: extended, coupling: subtract, jump: none, disturbance_std: 1e-7}",
        "mass={compensation: transverse_centripetal, process_noise_std: 1e-8}",
        "estimation={start: nominal, thrust_transient: gate_lag}",
        "plant.thrust_transient=vehicle",
        "sensors.accelerometer=acc3",
    ]
    run = simulate(load_scenario("sample_maneuver", overrides))
    _, steps = _replay(run, "acc3")
    np.testing.assert_array_equal([step.estimate for step in steps], run["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], run["standard_deviation"])
    assert run["mass_used"].any()


def _two_gyros(*overrides: str) -> Scenario:
    """The sample maneuver with a second, coarser gyro."""
    data = load_scenario("sample_maneuver", list(overrides)).model_dump(mode="json")
    vehicle = load_scenario("sample_maneuver").vehicle_data.model_dump(mode="json")
    vehicle["gyros"].append({**vehicle["gyros"][0], "name": "gyro2", "quantum": 3e-6})
    return resolved({**data, "vehicle": vehicle})


def _all_packages(run: Run) -> tuple[Estimator, list[EstimatorStep]]:
    """The estimator over a run's commands and the readings of all packages."""
    vehicle = run.scenario.vehicle_data
    dut, steps = Estimator(vehicle, run.scenario), []
    for sample, time_s in enumerate(run.time_s):
        gyros = {package.name: run[package.name][sample] for package in vehicle.gyros}
        accelerometers = {package.name: run[package.name][sample] for package in vehicle.accelerometers}
        steps.append(dut.step(time_s, gyros, accelerometers, run["command"][sample]))
    return dut, steps


@pytest.mark.parametrize("errors", [False, True], ids=["thrust known", "thrust errors considered"])
@pytest.mark.parametrize(
    "combine",
    [
        "{gyros: single, accelerometers: single}",
        "{gyros: serial, accelerometers: serial}",
        "{gyros: weighted_average, accelerometers: weighted_average}",
        "{gyros: average, accelerometers: weighted_average, correlated: true}",
        "{gyros: most_accurate, accelerometers: mid_value}",
    ],
)
def test_it_equals_the_diagram_with_several_packages(combine: str, *, errors: bool) -> None:
    overrides = ["duration_s=16", f"sensors.combine={combine}", "estimation.start=nominal"]
    if errors:
        overrides += ["plant.thrust_dispersion=0.01", "estimation.thrust_uncertainty=0.01"]
    run = simulate(_two_gyros(*overrides))
    dut, steps = _all_packages(run)
    np.testing.assert_array_equal([step.estimate for step in steps], run["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], run["standard_deviation"])
    np.testing.assert_array_equal([step.used for step in steps], run["rotation_used"][:, 0])
    np.testing.assert_array_equal([step.mass_used for step in steps], run["mass_used"][:, 0])
    np.testing.assert_array_equal([step.rotation_nis for step in steps], run["rotation_nis"][:, 0])
    np.testing.assert_array_equal([step.mass_nis for step in steps], run["mass_nis"][:, 0])
    np.testing.assert_array_equal([step.alarm for step in steps], run["alarm"][:, 0])
    np.testing.assert_array_equal(dut.covariance, run.covariance)
    assert run["rotation_used"].sum() > 20


def test_it_equals_the_diagram_with_thrust_errors_and_a_failing_jet() -> None:
    overrides = ["duration_s=56", "plant.thrust_dispersion=0.01", "estimation.thrust_uncertainty=0.01"]
    run = simulate(load_scenario("stuck_on_29", overrides))
    _, steps = _replay(run)
    np.testing.assert_array_equal([step.estimate for step in steps], run["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], run["standard_deviation"])
    np.testing.assert_array_equal([step.alarm for step in steps], run["alarm"][:, 0])
    (found,) = [step.detection for step in steps if step.detection is not None]
    assert (found.kind, found.jet) == ("jet", run.scenario.vehicle_data.designations[28])


def test_a_given_start_is_where_estimator_and_diagram_begin() -> None:
    nominal = load_scenario("sample_maneuver").vehicle_data.nominal.vector()
    deviation = 0.05 * np.abs(nominal) + np.array([0.0] * 3 + [1e-9] * 3 + [0.1] * 3 + [0.0])
    covariance = np.diag(deviation**2)
    covariance[0, 6] = covariance[6, 0] = 0.3 * deviation[0] * deviation[6]
    given = {"covariance": covariance.tolist()}
    data = load_scenario("sample_maneuver", ["duration_s=7"]).model_dump(mode="json")
    data["estimation"] |= {"start": "given", "given": given}
    run = simulate(resolved(data))
    dut, steps = _replay(run)
    np.testing.assert_array_equal(steps[0].estimate, nominal)
    np.testing.assert_allclose(steps[0].standard_deviation, deviation, rtol=1e-14)
    np.testing.assert_array_equal([step.estimate for step in steps], run["estimate"])
    np.testing.assert_array_equal(dut.covariance, run.covariance)
    np.testing.assert_allclose(Estimator(run.scenario.vehicle_data, run.scenario).covariance, covariance, rtol=1e-14)
    assert run["rotation_used"].any()


def test_where_the_preferred_accelerometer_is_missing_the_next_takes_over(sample_run: Run) -> None:
    used = np.flatnonzero(sample_run["mass_used"][:, 0])
    dut = Estimator(sample_run.scenario.vehicle_data, sample_run.scenario)
    lost = used[5]
    for sample in range(lost + 4):
        velocities = {name: sample_run[name][sample] for name in ("acc1", "acc2", "acc3")}
        if sample == lost:
            velocities["acc2"] = np.full(3, np.nan)
        step = dut.step(
            sample_run.time_s[sample], sample_run["gyro"][sample], velocities, sample_run["command"][sample]
        )
        assert step.mass_used == (sample_run["mass_used"][sample, 0] != 0.0)
        same = np.array_equal(step.estimate, sample_run["estimate"][sample])
        assert same == (sample < lost)


def test_a_saturated_reading_counts_as_missing(toy_data: dict[str, Any]) -> None:
    toy_data["gyros"][0]["range"] = 0.5
    toy_data["accelerometers"][0]["range"] = 10.0
    vehicle = Vehicle.model_validate(toy_data)
    dut = Estimator(vehicle, resolved({"estimation": {"filter": "thesis"}}))
    on = np.zeros(12)
    on[0] = 1.0
    seen = []
    for number, (rate, velocity) in enumerate(
        [(0.1, 0.0)] * 3 + [(-0.5, 0.0), (0.1, 0.0), (0.1, 10.0)] + [(0.1, 0.0)] * 3
    ):
        step = dut.step(0.1 * number, [rate, 0.0, 0.0], [0.0, velocity, 0.0], on)
        seen.append((step.used, bool(np.isfinite(step.mass_nis))))
    # a combination is steady from its second interval on; the mass filter needs the rates too
    full, none, turning = (True, True), (False, False), (True, False)
    assert seen == [none, (False, True), full, none, none, turning, turning, full, full]


def test_a_command_that_is_not_known_costs_two_samples(orbiter: Vehicle) -> None:
    dut = Estimator(orbiter, load_scenario("sample_maneuver", ["estimation.start=nominal"]))
    on, unknown = OFF.copy(), OFF.copy()
    on[orbiter.jet_index("R4R")] = 1.0
    unknown[:] = np.nan
    commands = (on, on, unknown, on, on, on)
    steps = [dut.step(0.08 * k, STILL, STILL, command) for k, command in enumerate(commands)]
    # the interval that begins with the third step, and the one after it, are judged one step later
    assert [step.used for step in steps] == [False, False, True, False, False, True]
    for step in steps:
        assert np.isfinite(step.estimate).all()
        assert np.isfinite(step.standard_deviation).all()


def test_an_outside_wrench_is_what_a_jet_of_the_same_wrench_would_be(orbiter: Vehicle) -> None:
    jet = orbiter.jet_index("R4R")
    on = OFF.copy()
    on[jet] = 1.0
    settings = load_scenario("sample_maneuver", ["estimation.start=nominal"])
    firing, pushed = Estimator(orbiter, settings), Estimator(orbiter, settings)
    for k in range(6):
        rates, velocities = [1e-4 * k, 2e-4 * k, -1e-4 * k], [0.01 * k, 0.0, 0.0]
        one = firing.step(0.08 * k, rates, velocities, on)
        other = pushed.step(0.08 * k, rates, velocities, OFF, orbiter.wrenches[jet])
        if k == 0:
            continue
        # the jet's first interval is not steady, the outside force's is
        assert (one.used, other.used) == (k > 1, True)
    assert not np.array_equal(other.estimate, orbiter.nominal.vector())
    plain = Estimator(orbiter, settings)
    for k in range(3):
        step = plain.step(0.08 * k, [1e-4 * k, 0.0, 0.0], STILL, OFF, np.zeros(6))
        assert not step.used


def test_an_outside_wrench_of_a_wrong_shape_is_refused(orbiter: Vehicle) -> None:
    with pytest.raises(ValueError, match=r"outside_wrench must have shape \(6,\), got \(3,\)"):
        Estimator(orbiter).step(0.0, STILL, STILL, OFF, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_outside_wrench_that_is_not_finite_is_refused_at_once(orbiter: Vehicle, bad: float) -> None:
    """Taken in, it would make every later step fail."""
    dut = Estimator(orbiter, resolved({"estimation": {"filter": "thesis"}}))
    dut.step(0.0, STILL, STILL, OFF)
    with pytest.raises(ValueError, match="outside_wrench must be finite"):
        dut.step(0.08, STILL, STILL, OFF, [0.0, bad, 0.0, 0.0, 0.0, 0.0])
    assert np.isfinite(dut.step(0.08, STILL, STILL, OFF).rotation_nis)
    assert np.isfinite(dut.step(0.16, STILL, STILL, OFF).rotation_nis)


def test_readings_by_the_names_of_their_packages(short_run: Run) -> None:
    _, steps = _replay(short_run)
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    for sample, step in enumerate(steps):
        accelerometers = {name: short_run[name][sample] for name in ("acc1", "acc2", "acc3")}
        gyros = {"gyro": short_run["gyro"][sample]}
        again = dut.step(short_run.time_s[sample], gyros, accelerometers, short_run["command"][sample])
        np.testing.assert_array_equal(again.estimate, step.estimate)


def test_lists_and_reused_buffers_are_read_at_once(short_run: Run) -> None:
    _, steps = _replay(short_run)
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    gyro, accelerometer, command = np.empty(3), np.empty(3), np.empty(44)
    for sample, step in enumerate(steps):
        gyro[:], accelerometer[:] = short_run["gyro"][sample], short_run["acc2"][sample]
        command[:] = short_run["command"][sample]
        again = dut.step(short_run.time_s[sample], gyro, accelerometer, command)
        np.testing.assert_array_equal(again.estimate, step.estimate)
        for buffer in (gyro, accelerometer, command):
            buffer[:] = np.nan
    assert short_run["rotation_used"].any()
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    dut.step(0.0, [0.0, 0.0, 0.0], [0, 0, 0], [0.0] * 44)


def test_the_default_settings_are_those_of_a_scenario_that_states_nothing(orbiter: Vehicle) -> None:
    step = Estimator(orbiter).step(0.0, STILL, STILL, OFF)
    np.testing.assert_array_equal(step.estimate, orbiter.nominal.vector())
    np.testing.assert_allclose(step.standard_deviation[9], 0.3 / orbiter.nominal.mass, rtol=1e-14)


def test_the_settings_are_used_with_the_vehicle_that_is_given(toy_data: dict[str, Any]) -> None:
    # settings may be of any vehicle; the given one counts
    vehicle = Vehicle.model_validate(toy_data)
    step = Estimator(vehicle, load_scenario("sample_maneuver")).step(0.0, STILL, STILL, np.zeros(12))
    np.testing.assert_array_equal(step.estimate, np.zeros(10))  # start: zero
    np.testing.assert_allclose(step.standard_deviation[9], 0.01, rtol=1e-14)  # 100 % of 1 / 100 kg


def test_the_first_sample_measures_nothing(orbiter: Vehicle) -> None:
    step = Estimator(orbiter).step(0.0, [0.1, 0.2, 0.3], [1.0, 2.0, 3.0], np.ones(44))
    assert (step.used, step.mass_used) == (False, False)
    assert np.isnan(step.rotation_nis)
    assert np.isnan(step.mass_nis)


def test_missing_readings_are_skipped_and_counted_as_not_used(sample_run: Run) -> None:
    """A reading that is missing costs the two increments that it bounds, and nothing else."""
    used = sample_run["rotation_used"][:, 0] != 0.0
    mass_used = sample_run["mass_used"][:, 0] != 0.0
    # a missing gyro reading between two used samples, and a missing accelerometer reading later
    no_gyro = next(k for k in range(1, used.size - 1) if used[k] and used[k + 1])
    no_velocity = next(k for k in range(no_gyro + 5, used.size - 1) if mass_used[k] and mass_used[k + 1])
    dut = Estimator(sample_run.scenario.vehicle_data, sample_run.scenario)
    steps = []
    for sample, time_s in enumerate(sample_run.time_s[: no_velocity + 5]):
        gyro = np.full(3, np.nan) if sample == no_gyro else sample_run["gyro"][sample]
        velocity = np.full(3, np.nan) if sample == no_velocity else sample_run["acc2"][sample]
        steps.append(dut.step(time_s, gyro, velocity, sample_run["command"][sample]))
        assert np.isfinite(steps[-1].estimate).all()
        assert np.isfinite(steps[-1].standard_deviation).all()
    lost = [k for k, step in enumerate(steps) if used[k] and not step.used]
    assert lost == [no_gyro, no_gyro + 1]
    mass_lost = [k for k, step in enumerate(steps) if mass_used[k] and not step.mass_used]
    assert mass_lost == [no_gyro, no_gyro + 1, no_velocity, no_velocity + 1]  # the mass filter needs the rates too
    for sample in (no_gyro, no_gyro + 1):
        assert np.isnan(steps[sample].rotation_nis)
        assert np.isnan(steps[sample].mass_nis)
        np.testing.assert_array_equal(steps[sample].estimate, steps[no_gyro - 1].estimate)
    assert steps[no_velocity].used == used[no_velocity]  # the gyro was there


def test_commands_act_from_the_step_they_are_given_on(orbiter: Vehicle) -> None:
    """The increment between two samples belongs to the command given with the first."""
    settings = load_scenario("sample_maneuver", ["estimation.start=nominal"])
    dut = Estimator(orbiter, settings)
    on = OFF.copy()
    on[orbiter.jet_index("R4R")] = 1.0
    used = [dut.step(0.08 * k, STILL, STILL, command).used for k, command in enumerate((on, on, OFF, OFF, OFF))]
    # [0, T) on for the first time, [T, 2 T) steady: used at 2 T; then off, a change at 3 T, then coasting
    assert used == [False, False, True, False, False]


@pytest.mark.parametrize("time_s", [0.16, 0.08, -1.0, np.nan])
def test_time_must_go_forward(orbiter: Vehicle, time_s: float) -> None:
    dut = Estimator(orbiter)
    dut.step(0.08, STILL, STILL, OFF)
    dut.step(0.16, STILL, STILL, OFF)
    with pytest.raises(ValueError, match=r"time must go forward: .* after 0\.16 s"):
        dut.step(time_s, STILL, STILL, OFF)


@pytest.mark.parametrize(
    ("gyro", "accelerometers", "commands", "words"),
    [
        ([0.0, 0.0], STILL, OFF, r"gyro must have shape \(3,\), got \(2,\)"),
        (0.0, STILL, OFF, r"gyro must have shape \(3,\), got \(\)"),
        (STILL, np.zeros((3, 3)), OFF, r"accelerometers must have shape \(3,\), got \(3, 3\)"),
        (STILL, STILL, np.zeros(38), r"commands must have shape \(44,\), got \(38,\)"),
        (STILL, STILL, 1.0, r"commands must have shape \(44,\), got \(\)"),
        (STILL, STILL, OFF + 1.001, "commands must be fractions from 0 to 1"),
        (STILL, STILL, OFF - 0.001, "commands must be fractions from 0 to 1"),
        ({"gyro2": STILL}, STILL, OFF, r"gyro: 'gyro2' is no package; the vehicle has \['gyro'\]"),
        ({}, STILL, OFF, r"gyro: no reading; the vehicle has \['gyro'\]"),
        (STILL, {"acc1": STILL, "acc7": STILL}, OFF, "accelerometers: 'acc7' is no package; the vehicle has"),
    ],
)
def test_bad_samples_are_refused(orbiter: Vehicle, gyro: Any, accelerometers: Any, commands: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Estimator(orbiter).step(0.0, gyro, accelerometers, commands)


def test_a_refused_sample_leaves_no_trace(short_run: Run) -> None:
    _, steps = _replay(short_run)
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    for sample, step in enumerate(steps):
        with pytest.raises(ValueError, match="commands"):
            dut.step(short_run.time_s[sample], [9.0, 9.0, 9.0], [9.0, 9.0, 9.0], np.full(44, 2.0))
        readings = short_run["gyro"][sample], short_run["acc2"][sample]
        again = dut.step(short_run.time_s[sample], *readings, short_run["command"][sample])
        np.testing.assert_array_equal(again.estimate, step.estimate)


def test_what_a_step_returns_stays_as_it_was(short_run: Run) -> None:
    dut, steps = _replay(short_run)
    kept = steps[-1].estimate.copy()
    steps[-1].estimate[:] = 7.0  # a caller may do as they like with their copy
    steps[-1].standard_deviation[:] = 7.0
    again = dut.step(short_run.time_s[-1] + 0.08, STILL * np.nan, STILL * np.nan, OFF)
    np.testing.assert_array_equal(again.estimate, kept)


def test_of_a_vehicle_without_accelerometer_the_mass_is_not_observed(toy_data: dict[str, Any]) -> None:
    del toy_data["accelerometers"]
    vehicle = Vehicle.model_validate(toy_data)
    step = Estimator(vehicle).step(0.0, STILL, None, np.zeros(len(vehicle.jets)))
    assert np.isnan(step.estimate[9])
    assert np.isfinite(step.estimate[:9]).all()
    with pytest.raises(ValueError, match="vehicle 'toy' has no accelerometer, which the filters of the thesis need"):
        Estimator(vehicle, load_scenario("sample_maneuver", ["estimation.filter=thesis"]))


def test_settings_that_name_a_package_of_another_vehicle_are_refused(toy_data: dict[str, Any]) -> None:
    """The docstring promises it: another package would be used without a word."""
    settings = load_scenario("sample_maneuver", ["sensors.accelerometer=acc3"])
    with pytest.raises(ValueError, match="acc3"):
        Estimator(Vehicle.model_validate(toy_data), settings)


def test_a_scenario_of_a_program_serves_as_settings(orbiter: Vehicle) -> None:
    settings = resolved({"estimation": {"start": "zero"}})
    np.testing.assert_array_equal(Estimator(orbiter, settings).step(0.0, STILL, STILL, OFF).estimate, np.zeros(10))
    settings = Scenario(seed=3)
    np.testing.assert_array_equal(
        Estimator(orbiter, settings).step(0.0, STILL, STILL, OFF).estimate, orbiter.nominal.vector()
    )


# -------------------------------------------------------------------------------------- kept states


def _steps(dut: Estimator, run: Run, samples: range) -> list[EstimatorStep]:
    return [
        dut.step(
            run.time_s[k], run["gyro"][k], {name: run[name][k] for name in ("acc1", "acc2", "acc3")}, run["command"][k]
        )
        for k in samples
    ]


def _assert_same_steps(steps: list[EstimatorStep], others: list[EstimatorStep]) -> None:
    for step, other in zip(steps, others, strict=True):
        for name in EstimatorStep._fields:
            found, expected = getattr(step, name), getattr(other, name)
            if isinstance(found, np.ndarray):
                np.testing.assert_array_equal(found, expected, err_msg=name)
            else:  # numbers, NaN among them, or a detection
                assert repr(found) == repr(expected), name


@pytest.mark.parametrize("after", ["first alarm", "declaration", "known force"])
def test_it_goes_on_from_a_kept_state_bit_for_bit(stuck_run: Run, after: str) -> None:
    """In the middle of a failure, through JSON and in another estimator."""
    whole = Estimator(stuck_run.scenario.vehicle_data, stuck_run.scenario)
    steps = _steps(whole, stuck_run, range(stuck_run.time_s.size))
    alarms = [k for k, step in enumerate(steps) if step.alarm]
    declared = next(k for k, step in enumerate(steps) if step.detection is not None)
    cut = {"first alarm": alarms[0] + 1, "declaration": declared + 1, "known force": declared + 5}[after]
    assert alarms[0] < declared  # there is a middle

    first = Estimator(stuck_run.scenario.vehicle_data, stuck_run.scenario)
    _steps(first, stuck_run, range(cut))
    text = json.dumps(first.state, allow_nan=False)
    second = Estimator(stuck_run.scenario.vehicle_data, stuck_run.scenario)
    second.restore(json.loads(text))
    rest = range(cut, stuck_run.time_s.size)
    _assert_same_steps(_steps(second, stuck_run, rest), steps[cut:])
    np.testing.assert_array_equal(second.covariance, whole.covariance)
    assert json.dumps(second.state) == json.dumps(whole.state)
    if cut > declared:
        assert steps[cut].known_wrench.any()


def test_a_state_kept_before_the_first_sample_is_a_new_estimator(short_run: Run) -> None:
    scenario = short_run.scenario
    fresh, restored = (Estimator(scenario.vehicle_data, scenario) for _ in range(2))
    kept = json.loads(json.dumps(fresh.state, allow_nan=False))
    _steps(restored, short_run, range(20))
    restored.restore(kept)
    _assert_same_steps(_steps(restored, short_run, range(40)), _steps(fresh, short_run, range(40)))


def test_outside_forces_and_unknown_commands_are_kept(short_run: Run) -> None:
    scenario = short_run.scenario
    wrench, command = np.array([10.0, 0.0, 0.0, 0.0, -2.0, 0.0]), np.full(44, np.nan)
    answers = []
    for kept in (False, True):
        dut = Estimator(scenario.vehicle_data, scenario)
        dut.step(0.0, STILL, STILL, command, wrench)
        if kept:
            state = json.loads(json.dumps(dut.state, allow_nan=False))
            dut = Estimator(scenario.vehicle_data, scenario)
            dut.restore(state)
        answers.append([dut.step(0.08 * k, STILL, STILL, OFF, wrench) for k in (1, 2, 3)])
    _assert_same_steps(*answers)
    assert answers[0][-1].used


def test_a_kept_state_does_not_change_with_the_estimator(short_run: Run) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    _steps(dut, short_run, range(20))
    state = dut.state
    text = json.dumps(state)
    _steps(dut, short_run, range(20, 40))
    assert json.dumps(state) == text


def test_time_must_go_forward_after_a_restored_state_too(short_run: Run) -> None:
    dut, other = (Estimator(short_run.scenario.vehicle_data, short_run.scenario) for _ in range(2))
    _steps(dut, short_run, range(20))
    other.restore(dut.state)
    with pytest.raises(ValueError, match="time must go forward"):
        other.step(short_run.time_s[19], STILL, STILL, OFF)


def test_a_runs_filter_state_serves(stuck_run: Run, tmp_path: Path) -> None:
    """What a simulated run leaves is what the estimator knows after its telemetry."""
    folder = stuck_run.save(tmp_path / "run", pictures=False, report=False)
    saved = json.loads((folder / "filter_state.json").read_text(encoding="utf-8"))
    dut, whole = (Estimator(stuck_run.scenario.vehicle_data, stuck_run.scenario) for _ in range(2))
    steps = _steps(whole, stuck_run, range(stuck_run.time_s.size))
    dut.restore(saved)
    np.testing.assert_array_equal(dut.covariance, whole.covariance)
    assert dut.state["states"] == whole.state["states"]
    assert dut.state["time_s"] == stuck_run.time_s[-1]
    # the file does not say what is commanded beyond the end: that interval is not usable
    later = dut.step(stuck_run.time_s[-1] + 0.08, STILL, STILL, OFF)
    assert not later.used
    np.testing.assert_array_equal(later.estimate, steps[-1].estimate)
    np.testing.assert_array_equal(later.known_wrench, steps[-1].known_wrench)
    assert later.known_wrench.any()


def test_a_state_of_another_vehicle_is_refused(short_run: Run, toy_data: dict[str, Any]) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    other = Estimator(Vehicle.model_validate(toy_data))
    before = json.dumps(dut.state)
    with pytest.raises(InputError, match=r"state: is of vehicle 'toy' with the digest .* and 'orbiter' here"):
        dut.restore(other.state)
    assert json.dumps(dut.state) == before


def test_a_state_of_other_settings_is_refused(short_run: Run) -> None:
    vehicle = short_run.scenario.vehicle_data
    dut = Estimator(vehicle, short_run.scenario)
    before = json.dumps(dut.state)
    without = Estimator(vehicle, load_scenario("sample_maneuver", ["detector.kind=off"]))
    with pytest.raises(InputError, match=r"is of other settings: detector.kind was 'off' and is 'cglr'; go on with"):
        dut.restore(without.state)
    with pytest.raises(InputError, match=r"is of other settings: detector.kind was 'cglr' and is 'off'"):
        without.restore(dut.state)
    assert json.dumps(dut.state) == before


@pytest.mark.parametrize("lost", ["time_s", "command", "states"])
def test_a_state_that_lacks_a_part_is_refused(short_run: Run, lost: str) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    state = {name: value for name, value in dut.state.items() if name != lost}
    with pytest.raises(InputError, match=f"state: {lost}: missing"):
        dut.restore(state)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 3}, "format: input should be less than or equal to 2, got 3"),
        ({"made_with": None}, "has no 'made_with'"),
        ({"time_s": float("inf")}, "time_s: input should be a finite number"),
        ({"time_s": "1"}, "time_s: input should be a valid number"),
        ({"command": [2.0] * 44}, "command"),
        ({"outside_wrench": [0.0] * 5}, "outside_wrench: must have 6 values"),
        ({"states": {}}, "the saved state of failure_detector has sizes none"),
        ({"more": 1}, "more: unknown key"),
    ],
)
def test_a_damaged_state_is_refused_and_the_estimator_goes_on(
    short_run: Run, change: dict[str, Any], words: str
) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    _steps(dut, short_run, range(20))
    before = json.dumps(dut.state)
    with pytest.raises(InputError, match=f"state: .*{words}|state: {words}"):
        dut.restore({**dut.state, **change})
    assert json.dumps(dut.state) == before


def test_a_state_with_a_covariance_that_is_none_is_refused(short_run: Run) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    state = json.loads(json.dumps(dut.state))
    state["states"]["rotation_estimator"][0][9] = -1.0
    with pytest.raises(InputError, match="state: states: the covariance of the estimates must be symmetric"):
        dut.restore(state)


def test_a_state_of_format_1_is_taken_with_one_warning(short_run: Run) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    _steps(dut, short_run, range(20))
    kept = dut.state
    old = {key: value for key, value in kept.items() if key not in ("format", "made_with")}
    with pytest.warns(RenamedWarning, match=r"state: is of format 1, .* which does not say") as caught:
        dut.restore(old)
    assert len(caught) == 1
    assert json.dumps(dut.state) == json.dumps(kept)


NO_SAMPLES: dict[str, tuple[dict[str, Any], str]] = {
    "infinite time": ({"time_s": math.inf}, "time_s must be finite"),
    "time before all": ({"time_s": -math.inf}, "time_s must be finite"),
    "unknown time": ({"time_s": math.nan}, "time must go forward"),
    "time in words": ({"time_s": "soon"}, "time_s must be numbers"),
    "no time": ({"time_s": None}, "time must go forward|time_s must be numbers"),
    "two times": ({"time_s": [1.0, 2.0]}, r"time_s must have shape \(\)"),
    "huge time": ({"time_s": 1e300}, "time_s must be finite and at most"),
    "infinite rate": ({"gyro": [0.0, math.inf, 0.0]}, "gyro must be finite"),
    "huge rate": ({"gyro": [0.0, 1e300, 0.0]}, "gyro must be finite and at most"),
    "four rates": ({"gyro": [0.0] * 4}, r"gyro must have shape \(3,\)"),
    "rate in words": ({"gyro": ["x", 0.0, 0.0]}, "gyro must be numbers"),
    "ragged rates": ({"gyro": [[0.0], 0.0, 0.0]}, "gyro must be numbers"),
    "complex rate": ({"gyro": [1j, 0.0, 0.0]}, "gyro must be numbers"),
    "too large a whole number": ({"gyro": [10**400, 0, 0]}, "gyro must be numbers"),
    "infinite velocity": ({"accelerometers": [math.inf] * 3}, "accelerometers must be finite"),
    "command of two": ({"commands": np.full(44, 2.0)}, "commands must be fractions"),
    "infinite command": ({"commands": np.full(44, math.inf)}, "commands must be finite"),
    "no commands": ({"commands": None}, "commands must be given with every sample"),
    "few commands": ({"commands": np.zeros(43)}, "commands must have shape"),
    "unknown wrench": ({"outside_wrench": [math.nan] * 6}, "outside_wrench must be finite"),
    "infinite wrench": ({"outside_wrench": [math.inf] * 6}, "outside_wrench must be finite"),
    "short wrench": ({"outside_wrench": [0.0] * 3}, "outside_wrench must have shape"),
}


@pytest.mark.parametrize("name", NO_SAMPLES)
def test_what_is_no_sample_is_refused_and_leaves_the_state(short_run: Run, name: str) -> None:
    change, words = NO_SAMPLES[name]
    dut, other = (Estimator(short_run.scenario.vehicle_data, short_run.scenario) for _ in range(2))
    _steps(dut, short_run, range(20))
    _steps(other, short_run, range(20))
    before = json.dumps(dut.state)
    sample = {"time_s": short_run.time_s[20], "gyro": STILL, "accelerometers": STILL, "commands": OFF, **change}
    with pytest.raises(ValueError, match=words):
        dut.step(**sample)
    assert json.dumps(dut.state) == before
    _assert_same_steps(_steps(dut, short_run, range(20, 25)), _steps(other, short_run, range(20, 25)))


def test_it_needs_neither_drake_nor_matplotlib() -> None:
    program = (
        "import sys\n"
        "from massprop_drake import Estimator, load_vehicle\n"
        "estimator = Estimator(load_vehicle('orbiter'))\n"
        "estimator.step(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 44)\n"
        "slow = {'pydrake', 'matplotlib', 'scipy', 'typer'}\n"
        "print(sorted(slow & {name.partition('.')[0] for name in sys.modules}))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_nearest_possible_estimate_on_request(orbiter: Vehicle) -> None:
    """What a body can have is the estimate; from zero, where nothing is known, there is none."""
    dut = Estimator(orbiter, load_scenario("sample_maneuver", ["estimation.start=nominal"]))
    step = dut.step(0.0, STILL, STILL, OFF)
    near = dut.nearest_possible()
    assert near is not None
    np.testing.assert_array_equal(near, step.estimate)
    assert Estimator(orbiter, load_scenario("sample_maneuver", ["estimation.start=zero"])).nearest_possible() is None


# --------------------------------------------------------------------------------- copies of what users hold

COPIES = {"pickle": lambda held: pickle.loads(pickle.dumps(held)), "deepcopy": copy.deepcopy, "copy": copy.copy}
JOINT = ("estimation={filter: joint, start: nominal}", "mass={}", "detector={kind: hypotheses}")
COPIED: dict[str, tuple[str, tuple[str, ...]]] = {
    "thesis, cglr": ("sample_maneuver", ("duration_s=7",)),
    "thesis, cusum": ("sample_maneuver", ("duration_s=7", "detector={kind: cusum}")),
    "thesis, off": ("sample_maneuver", ("duration_s=7", "detector={kind: off}")),
    "joint, a race under way": (
        "stuck_on_29",
        ("duration_s=4", *JOINT, "failures=[{kind: stuck_on, jet: R4R, start_s: 2.5}]"),
    ),
    "pose": ("air_bearing_pulses", ("duration_s=1",)),
}


@pytest.mark.parametrize("name", COPIED)
def test_a_copy_goes_on_bit_for_bit(name: str) -> None:
    scenario = load_scenario(COPIED[name][0], list(COPIED[name][1]))
    run, vehicle = simulate(scenario), scenario.vehicle_data
    samples = []
    for k, time_s in enumerate(run.time_s):
        read = [{one.name: run[one.name][k] for one in some} for some in (vehicle.gyros, vehicle.accelerometers)]
        tracked = {one.name: run[one.name][k] for one in vehicle.tracked}
        samples.append((time_s, *(one or None for one in read), run["command"][k], None, tracked))
    dut, copies = Estimator(vehicle, scenario), []
    for k, sample in enumerate(samples):
        if k in (1, len(samples) - 12):
            copies += [make(dut) for make in COPIES.values()]
        done = dut.step(*sample)
        for other in copies:
            _assert_same_steps([other.step(*sample)], [done])
    for other in copies:
        assert other.state == dut.state
        np.testing.assert_array_equal(other.covariance, dut.covariance)


@pytest.mark.parametrize("way", COPIES)
def test_vehicle_scenario_and_run_can_be_copied(short_run: Run, way: str) -> None:
    make = COPIES[way]
    scenario = make(short_run.scenario)
    assert scenario == short_run.scenario
    assert make(scenario.vehicle_data) == scenario.vehicle_data
    run = make(short_run)
    assert run.summary == short_run.summary
    assert run.units == short_run.units
    np.testing.assert_array_equal(run["estimate"], short_run["estimate"])
    again = simulate(scenario)
    np.testing.assert_array_equal(again["estimate"], short_run["estimate"])
