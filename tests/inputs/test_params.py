"""From a scenario's choices to numbers and arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from massprop_drake import Scenario, load_scenario
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import JetPulse, resolved
from massprop_drake.maths.estimation import redundancy
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.noise import uniform_phase


def _pulses(*pulses: tuple[str, float, float]) -> Scenario:
    schedule = [{"jet": jet, "start_s": start_s, "end_s": end_s} for jet, start_s, end_s in pulses]
    return resolved({"duration_s": 2.0, "jet_schedule": schedule})


def _initial_deviation(scenario: Scenario) -> NDArray[np.float64]:
    """1-sigma of the ten parameters at the start, which nothing correlates."""
    covariance = params.initial_covariance(scenario)
    np.testing.assert_array_equal(covariance, np.diag(covariance.diagonal()))
    return np.sqrt(covariance.diagonal())


@pytest.mark.parametrize(
    ("duration_s", "samples"), [(0.08, 1), (50.0, 625), (0.15, 1), (0.16, 2), (0.56, 7), (4.0, 50)]
)
def test_the_last_sample_is_at_or_just_before_the_end(duration_s: float, samples: int) -> None:
    assert params.sample_count(load_scenario("sample_maneuver", [f"duration_s={duration_s}"])) == samples


def test_a_pulse_is_commanded_at_the_samples_from_its_start_until_before_its_end() -> None:
    # 0.56 s is sample 7, 0.8 s sample 10; 0.1 s lies between samples 1 and 2, 0.3 s between 3 and 4
    table, onsets_s = params.commands(_pulses(("R4R", 0.56, 0.8), ("F1F", 0.1, 0.3), ("L4L", 1.9, 99.0)))
    assert onsets_s is None
    assert table.shape == (25, 44)
    assert set(np.unique(table)) == {0.0, 1.0}
    designations = load_scenario("sample_maneuver").vehicle_data.designations
    on = {designations[jet]: np.flatnonzero(table[:, jet]).tolist() for jet in np.flatnonzero(table.any(axis=0))}
    assert on == {"R4R": [7, 8, 9], "F1F": [2, 3], "L4L": [24]}


def test_pulses_at_any_multiple_of_the_period_begin_and_end_on_their_samples(sample_maneuver: Scenario) -> None:
    for sample in range(625):
        start_s, end_s = (float(f"{8 * k / 100:.2f}") for k in (sample, sample + 1))
        pulse = JetPulse(jet="R4R", start_s=start_s, end_s=end_s)
        table, _ = params.commands(sample_maneuver.model_copy(update={"jet_schedule": (pulse,)}))
        assert np.flatnonzero(table.any(axis=1)).tolist() == [sample]


def test_what_the_filters_start_from(sample_maneuver: Scenario) -> None:
    nominal = sample_maneuver.vehicle_data.nominal.vector()
    np.testing.assert_array_equal(params.initial_estimate(sample_maneuver), np.zeros(10))
    # 100 % of the nominal values, and no floors
    np.testing.assert_allclose(_initial_deviation(sample_maneuver), np.abs(nominal), rtol=1e-15)
    default = load_scenario("sample_maneuver", ["estimation={}"])
    np.testing.assert_array_equal(params.initial_estimate(default), nominal)
    deviation = _initial_deviation(default)
    np.testing.assert_allclose(deviation[[0, 1, 2, 9]], 0.3 * nominal[[0, 1, 2, 9]], rtol=1e-15)
    assert deviation[5] == pytest.approx(0.3 * math.sqrt(nominal[0] * nominal[1]), rel=1e-14)
    assert deviation[7] == default.vehicle_data.center_of_mass_floor  # 30 % of 0.07 ft would be less
    zero = load_scenario("sample_maneuver", ["estimation={start: zero}"])
    np.testing.assert_allclose(_initial_deviation(zero)[0], nominal[0], rtol=1e-15)


def test_settings_of_the_rotation_filter() -> None:
    default = params.rotation_params(load_scenario("sample_maneuver"))
    assert (default.second_order, default.coupling, default.coupling_limit) == (
        True,
        rotation_filter.RotationCoupling.HYBRID,
        50.0,
    )
    assert default.jump_threshold == 25.0
    changed = params.rotation_params(
        load_scenario(
            "sample_maneuver",
            [
                "rotation={filter: extended, coupling: ignore, jump: none, jump_std_fraction: 0.5}",
                "rotation.disturbance_std=0.1",
                "rotation.process_noise_std=[0,0,0,0,0,0,2,0,0]",
            ],
        )
    )
    assert (changed.second_order, changed.coupling) == (False, rotation_filter.RotationCoupling.IGNORE)
    assert changed.jump_threshold == math.inf
    np.testing.assert_allclose(changed.disturbance_covariance, 0.01 * np.eye(3), rtol=1e-15)
    np.testing.assert_allclose(changed.process_noise, np.diag([0, 0, 0, 0, 0, 0, 4.0, 0, 0]), rtol=1e-15)
    np.testing.assert_allclose(changed.jump_covariance, 0.25 * default.jump_covariance, rtol=1e-14)


@pytest.mark.parametrize("window", [2, 5, 40])
def test_the_false_alarm_rate_of_a_mass_jump_is_shared_by_the_window(window: int) -> None:
    overrides = ["mass.jump=glr", f"mass.jump_window={window}", "mass.jump_false_alarm_rate=1e-3"]
    dut = params.mass_params(load_scenario("sample_maneuver", overrides))
    assert dut.jump_window == window
    assert dut.jump_threshold == pytest.approx(chi2.isf(1e-3 / window, 1), rel=1e-9)
    single = params.mass_params(load_scenario("sample_maneuver", [*overrides[1:], "mass.jump=single_sample"]))
    assert (single.jump_window, single.jump_threshold) == (1, pytest.approx(chi2.isf(1e-3, 1), rel=1e-9))


def test_settings_of_the_mass_filter() -> None:
    default = params.mass_params(load_scenario("sample_maneuver"))
    assert (default.compensation, default.compensation_covariance) == (mass_filter.Compensation.TRANSVERSE, True)
    changed = params.mass_params(
        load_scenario("sample_maneuver", ["mass={compensation: none, process_noise_std: 3.0, disturbance_std: 0.1}"])
    )
    assert changed.compensation == mass_filter.Compensation.NONE
    assert changed.process_noise == 9.0
    np.testing.assert_allclose(changed.disturbance_covariance, 0.01 * np.eye(3), rtol=1e-15)


def test_lags_are_used_where_they_are_asked_for() -> None:
    vehicle = load_scenario("sample_maneuver").vehicle_data
    for plant, estimator in (("none", "gate"), ("vehicle", "gate"), ("none", "gate_lag"), ("vehicle", "gate_lag")):
        overrides = [f"plant.thrust_transient={plant}", f"estimation.thrust_transient={estimator}"]
        scenario = load_scenario("sample_maneuver", overrides)
        expected = vehicle.time_constants_s if plant == "vehicle" else np.zeros(44)
        np.testing.assert_array_equal(params.plant_time_constants(scenario), expected)
        expected = vehicle.time_constants_s if estimator == "gate_lag" else np.zeros(44)
        np.testing.assert_array_equal(params.estimator_time_constants(scenario), expected)


def test_packages_in_use(toy_data: dict[str, Any]) -> None:
    assert [package.name for package in params.accelerometers(load_scenario("sample_maneuver"))] == [
        "acc2",
        "acc1",
        "acc3",
    ]  # the vehicle's preferred one
    assert params.accelerometers(load_scenario("sample_maneuver", ["sensors.accelerometer=acc3"]))[0].name == "acc3"
    toy_data["gyros"].append({"name": "spare", "quantum": 1e-5})
    assert params.gyro(resolved({"vehicle": toy_data})).name == "gyro"
    assert params.gyro(resolved({"vehicle": toy_data, "sensors": {"gyro": "spare"}})).name == "spare"
    assert params.accelerometers(resolved({"vehicle": toy_data}))[0].name == "acc"  # the first
    del toy_data["accelerometers"]
    assert params.accelerometers(resolved({"vehicle": toy_data})) == ()


def test_sensor_errors_are_those_of_the_vehicle_and_the_scenario() -> None:
    scenario = load_scenario(
        "sample_maneuver",
        [
            "seed=4",
            "sensors.errors=[{sensor: acc1, bias: [1, 2, 3], bias_random_walk: 0.5, quantum: 0.25, delay_samples: 3}]",
        ],
    )
    gyro, acc1, acc2, _ = (params.sensor_model(scenario, package) for package in scenario.vehicle_data.sensors)
    assert (gyro.quantum, gyro.delay, gyro.integrates, gyro.remembers) == (1.52e-6, 0, False, False)
    np.testing.assert_array_equal(gyro.phase, uniform_phase(4, "gyro", 3))
    np.testing.assert_array_equal(acc1.bias, [1.0, 2.0, 3.0])
    assert (acc1.quantum, acc1.delay, acc1.integrates) == (0.25, 3, True)
    assert acc1.walk_std == pytest.approx(0.5 * math.sqrt(0.08))  # 1-sigma after one second
    assert (acc2.quantum, acc2.walk_std) == (0.0344, 0.0)
    equal = load_scenario("sample_maneuver", ["sensors.quantizer_phase=equal"])
    assert not params.sensor_model(equal, equal.vehicle_data.gyros[0]).phase.any()


def test_the_true_vehicle_may_differ_from_the_nominal() -> None:
    scenario = load_scenario(
        "sample_maneuver",
        [
            "plant.mass_properties={mass: 5000, center_of_mass: [30, 0, 2]}",
            "plant.mass_properties.inertia=[[9e5, 0, 0], [0, 7e6, 0], [0, 0, 7e6]]",
        ],
    )
    assert params.true_properties(scenario).mass == 5000.0
    assert params.true_properties(load_scenario("sample_maneuver")).mass == scenario.vehicle_data.nominal.mass


def test_propellant_flows_only_where_it_depletes() -> None:
    scenario = load_scenario("sample_maneuver")
    np.testing.assert_array_equal(params.plant_wrenches(scenario)[:, 6], scenario.vehicle_data.mass_flows)
    assert not params.plant_wrenches(load_scenario("sample_maneuver", ["plant.depletion=false"]))[:, 6].any()


def test_jets_are_selectable_by_their_kind() -> None:
    assert params.selectable(load_scenario("sample_maneuver")).sum() == 38
    assert params.selectable(load_scenario("sample_maneuver", ["autopilot.jet_kinds=[vernier]"])).sum() == 6


def test_limits_of_convergence() -> None:
    scenario = load_scenario("sample_maneuver")
    np.testing.assert_allclose(
        params.convergence_limits(scenario), [0.02, 0.03 * scenario.vehicle_data.rms_arm, 0.2], rtol=1e-15
    )
    stated = load_scenario("sample_maneuver", ["estimation.convergence.center_of_mass=1.5"])
    assert params.convergence_limits(stated)[1] == 1.5


# ----------------------------------------------------------------------------------------- a given start


def test_a_given_start_is_taken_as_it_is() -> None:
    deviation = [1e-7, 1e-8, 1e-8, 1e-9, 1e-9, 1e-9, 1.0, 2.0, 3.0, 1e-5]
    nominal = load_scenario("sample_maneuver").vehicle_data.nominal.vector()
    known = resolved({"estimation": {"start": "given", "given": {"standard_deviation": deviation}}})
    np.testing.assert_array_equal(params.initial_estimate(known), nominal)
    np.testing.assert_allclose(params.initial_covariance(known), np.diag(np.square(deviation)), rtol=1e-15)
    covariance = np.diag(np.square(deviation))
    covariance[0, 6] = covariance[6, 0] = 0.5e-7
    other = {"mass": 5000.0, "center_of_mass": [30.0, 0.0, 2.0], "inertia": np.diag([9e5, 7e6, 7.2e6]).tolist()}
    given = {"covariance": covariance.tolist(), "mass_properties": other}
    correlated = resolved({"estimation": {"start": "given", "given": given}})
    np.testing.assert_array_equal(params.initial_covariance(correlated), covariance)
    expected = [1.0 / 9e5, 1.0 / 7e6, 1.0 / 7.2e6, 0.0, 0.0, 0.0, 30.0, 0.0, 2.0, 1.0 / 5000.0]
    np.testing.assert_allclose(params.initial_estimate(correlated), expected, rtol=1e-14)


# -------------------------------------------------------------------------------------------- thrust


def test_thrust_is_nominal_unless_dispersed() -> None:
    np.testing.assert_array_equal(params.thrust_factors(load_scenario("sample_maneuver", ["seed=3"])), np.ones(44))


def test_each_jet_is_off_by_its_own_fraction_drawn_from_the_seed() -> None:
    factors = np.array(
        [
            params.thrust_factors(load_scenario("sample_maneuver", [f"seed={seed}", "plant.thrust_dispersion=0.02"]))
            for seed in range(25)
        ]
    )
    again = load_scenario("sample_maneuver", ["seed=7", "plant.thrust_dispersion=0.02"])
    np.testing.assert_array_equal(params.thrust_factors(again), factors[7])
    assert len(np.unique(factors)) == factors.size
    # 1100 draws: mean 1 and deviation 0.02 within 5 standard errors
    assert abs(factors.mean() - 1.0) < 5.0 * 0.02 / math.sqrt(factors.size)
    assert abs(factors.std() / 0.02 - 1.0) < 5.0 / math.sqrt(2.0 * factors.size)
    # twice the dispersion is twice the error of each
    double = load_scenario("sample_maneuver", ["seed=7", "plant.thrust_dispersion=0.04"])
    np.testing.assert_allclose(params.thrust_factors(double) - 1.0, 2.0 * (factors[7] - 1.0), rtol=1e-12)


def test_torque_force_and_flow_of_a_jet_go_with_its_thrust() -> None:
    overrides = ["seed=7", "plant.thrust_dispersion=0.02"]
    dispersed, nominal = load_scenario("sample_maneuver", overrides), load_scenario("sample_maneuver")
    expected = params.plant_wrenches(nominal) * params.thrust_factors(dispersed)[:, None]
    np.testing.assert_allclose(params.plant_wrenches(dispersed), expected, rtol=1e-15)
    # what the estimators take for true is not touched
    np.testing.assert_array_equal(dispersed.vehicle_data.wrenches, nominal.vehicle_data.wrenches)


def test_a_leak_gives_the_force_it_states_whatever_the_jets_thrust() -> None:
    scenario = load_scenario("leak_24", ["plant.thrust_dispersion=0.1"])
    (failure,) = params.jet_failures(scenario)
    force = failure.amount * np.linalg.norm(params.plant_wrenches(scenario)[failure.jet, 3:6])
    assert force == pytest.approx(scenario.failures[0].force, rel=1e-12)
    assert params.thrust_factors(scenario)[failure.jet] != 1.0


def test_a_jet_drawn_as_dead_leaks_as_stated_all_the_same() -> None:
    # with this seed the leaking jet's draw lies 3.6 sigma low: 1 - 3.6 x 0.3 is below zero
    scenario = load_scenario("leak_24", ["seed=1249", "plant.thrust_dispersion=0.3"])
    (failure,) = params.jet_failures(scenario)
    assert 0.0 < params.thrust_factors(scenario)[failure.jet] < 0.02
    force = failure.amount * np.linalg.norm(params.plant_wrenches(scenario)[failure.jet, 3:6])
    assert force == pytest.approx(scenario.failures[0].force, rel=1e-12)


def test_thrust_errors_are_those_of_one_sigma_at_full_level() -> None:
    assert params.thrust_errors(load_scenario("sample_maneuver")) is None
    scenario = load_scenario("sample_maneuver", ["estimation.thrust_uncertainty=0.02"])
    np.testing.assert_allclose(params.thrust_errors(scenario), 0.02 * 0.08 * scenario.vehicle_data.wrenches, rtol=1e-14)


# -------------------------------------------------------------------------------------------- sensors


def test_rules_and_packages_reach_the_filters_in_order_of_preference() -> None:
    overrides = [
        "sensors.accelerometer=acc3",
        "sensors.combine={gyros: average, accelerometers: mid_value, correlated: true}",
    ]
    scenario = load_scenario("sample_maneuver", overrides)
    turning, moving = params.rotation_params(scenario), params.mass_params(scenario)
    assert (turning.rule, moving.rule, moving.correlated) == (redundancy.Rule.AVERAGE, redundancy.Rule.MID_VALUE, True)
    packages = {package.name: package for package in scenario.vehicle_data.accelerometers}
    in_order = [packages[name] for name in ("acc3", "acc1", "acc2")]
    np.testing.assert_array_equal(moving.positions, [package.position for package in in_order])
    np.testing.assert_array_equal(moving.variances, [package.variance for package in in_order])
    np.testing.assert_array_equal(turning.gyro_variances, [scenario.vehicle_data.gyros[0].variance])


def test_a_sensors_range_is_that_of_the_vehicle(toy_data: dict[str, Any]) -> None:
    toy_data["gyros"][0]["range"] = 0.5
    scenario = resolved({"vehicle": toy_data})
    models = [params.sensor_model(scenario, package).limit for package in scenario.vehicle_data.sensors]
    assert models == [0.5, math.inf]


def test_jets_may_be_slower_than_the_estimators_are_told() -> None:
    scenario = load_scenario("orbiter_maneuver", ["plant.lag_factor=1.5"])
    np.testing.assert_allclose(params.plant_time_constants(scenario), 0.0225)
    np.testing.assert_allclose(params.estimator_time_constants(scenario), 0.015)
    instantaneous = load_scenario("orbiter_maneuver", ["plant.lag_factor=1.5", "plant.thrust_transient=none"])
    assert not params.plant_time_constants(instantaneous).any()
