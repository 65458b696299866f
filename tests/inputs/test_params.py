"""From a scenario's choices to numbers and arrays of plant, sensors, filters and detectors."""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
import pytest
from scipy.stats import chi2

from massprop_drake import Scenario, load_scenario, load_vehicle
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.estimation_blocks import FaultMode, FaultsBlock
from massprop_drake.inputs.model import list_keys
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.maths.estimation import redundancy
from massprop_drake.maths.estimation.faults.declarations import Mode
from massprop_drake.maths.estimation.faults.hypothesis_filter import Params
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.noise import uniform_phase


def sample(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", list(overrides))


@pytest.mark.parametrize(
    ("duration_s", "samples"), [(0.08, 1), (50.0, 625), (0.15, 1), (0.16, 2), (0.56, 7), (4.0, 50)]
)
def test_the_last_sample_is_at_or_just_before_the_end(duration_s: float, samples: int) -> None:
    assert params.sample_count(sample(f"duration_s={duration_s}")) == samples


def test_a_pulse_is_commanded_at_the_samples_from_its_start_until_before_its_end() -> None:
    # 0.56 s is sample 7, 0.8 s sample 10; 0.1 s lies between samples 1 and 2, 0.3 s between 3 and 4
    pulses = (("R4R", 0.56, 0.8), ("F1F", 0.1, 0.3), ("L4L", 1.9, 99.0))
    schedule = [{"jet": jet, "start_s": start_s, "end_s": end_s} for jet, start_s, end_s in pulses]
    scenario = resolve_scenario({"duration_s": 2.0, "jet_schedule": schedule})
    table, onsets_s = params.scheduled_jet_commands(scenario)
    assert onsets_s is None
    assert table.shape == (25, 44)
    assert set(np.unique(table)) == {0.0, 1.0}
    names = scenario.vehicle_data.designations
    on = {names[jet]: np.flatnonzero(table[:, jet]).tolist() for jet in np.flatnonzero(table.any(axis=0))}
    assert on == {"R4R": [7, 8, 9], "F1F": [2, 3], "L4L": [24]}


def test_what_the_filters_start_from(sample_maneuver: Scenario) -> None:
    vehicle = sample_maneuver.vehicle_data
    nominal = vehicle.nominal.vector()
    np.testing.assert_array_equal(params.initial_estimate(sample_maneuver), np.zeros(10))
    # 100 % of the nominal values, and no floors
    np.testing.assert_allclose(params.initial_covariance(sample_maneuver), np.diag(nominal**2), rtol=1e-15)
    default = sample("estimation={}")
    np.testing.assert_array_equal(params.initial_estimate(default), nominal)
    covariance = params.initial_covariance(default)
    np.testing.assert_array_equal(covariance, np.diag(covariance.diagonal()))
    deviation = np.sqrt(covariance.diagonal())
    np.testing.assert_allclose(deviation[[0, 1, 2, 9]], 0.3 * nominal[[0, 1, 2, 9]], rtol=1e-15)
    assert deviation[5] == pytest.approx(0.3 * math.sqrt(nominal[0] * nominal[1]), rel=1e-14)
    assert deviation[7] == vehicle.center_of_mass_floor  # 30 % of 0.07 ft would be less
    zero = params.initial_covariance(sample("estimation={start: zero}"))
    np.testing.assert_allclose(np.sqrt(zero[0, 0]), nominal[0], rtol=1e-15)


def test_a_given_start_is_taken_as_it_is() -> None:
    deviation = [1e-7, 1e-8, 1e-8, 1e-9, 1e-9, 1e-9, 1.0, 2.0, 3.0, 1e-5]
    known = resolve_scenario({"estimation": {"start": "given", "given": {"standard_deviation": deviation}}})
    np.testing.assert_array_equal(params.initial_estimate(known), load_vehicle("orbiter").nominal.vector())
    np.testing.assert_allclose(params.initial_covariance(known), np.diag(np.square(deviation)), rtol=1e-15)
    covariance = np.diag(np.square(deviation))
    covariance[0, 6] = covariance[6, 0] = 0.5e-7
    other = {"mass": 5000.0, "center_of_mass": [30.0, 0.0, 2.0], "inertia": np.diag([9e5, 7e6, 7.2e6]).tolist()}
    given = {"covariance": covariance.tolist(), "mass_properties": other}
    correlated = resolve_scenario({"estimation": {"start": "given", "given": given}})
    np.testing.assert_array_equal(params.initial_covariance(correlated), covariance)
    expected = [1.0 / 9e5, 1.0 / 7e6, 1.0 / 7.2e6, 0.0, 0.0, 0.0, 30.0, 0.0, 2.0, 1.0 / 5000.0]
    np.testing.assert_allclose(params.initial_estimate(correlated), expected, rtol=1e-14)


def test_limits_of_convergence() -> None:
    arm = load_vehicle("orbiter").rms_arm
    np.testing.assert_allclose(params.convergence_limits(sample()), [0.02, 0.03 * arm, 0.2], rtol=1e-15)
    assert params.convergence_limits(sample("estimation.convergence.center_of_mass=1.5"))[1] == 1.5


@pytest.mark.parametrize(("test", "window", "shared"), [("glr", 2, 2), ("glr", 40, 40), ("single_sample", 40, 1)])
def test_the_false_alarm_rate_of_a_mass_jump_is_shared_by_the_window(test: str, window: int, shared: int) -> None:
    rate = "mass.jump_false_alarm_rate=1e-3"
    found = params.mass_params(sample(f"mass.jump={test}", f"mass.jump_window={window}", rate))
    assert (found.jump_window, found.jump_threshold) == (shared, pytest.approx(chi2.isf(1e-3 / shared, 1), rel=1e-9))


def test_rules_and_packages_reach_the_filters_in_order_of_preference(toy_data: dict[str, Any]) -> None:
    combine = "sensors.combine={gyros: average, accelerometers: mid_value, correlated: true}"
    scenario = sample("sensors.accelerometer=acc3", combine)
    turning, moving = params.thesis_params(scenario).rotation, params.mass_params(scenario)
    assert (turning.rule, moving.rule, moving.correlated) == (redundancy.Rule.AVERAGE, redundancy.Rule.MID_VALUE, True)
    packages = {package.name: package for package in scenario.vehicle_data.accelerometers}
    in_order = [packages[name] for name in ("acc3", "acc1", "acc2")]
    np.testing.assert_array_equal(moving.positions, [package.position for package in in_order])
    np.testing.assert_array_equal(moving.variances, [package.variance for package in in_order])
    np.testing.assert_array_equal(turning.gyro_variances, [scenario.vehicle_data.gyros[0].variance])
    assert params.accelerometers(sample())[0].name == "acc2"  # the vehicle's preferred one
    toy_data["gyros"].append({"name": "spare", "quantum": 1e-5})
    assert params.gyro(resolve_scenario({"vehicle": toy_data})).name == "gyro"
    assert params.gyro(resolve_scenario({"vehicle": toy_data, "sensors": {"gyro": "spare"}})).name == "spare"


def test_sensor_errors_are_those_of_the_vehicle_and_the_scenario() -> None:
    stated = "{sensor: acc1, bias: [1, 2, 3], bias_random_walk: 0.5, quantum: 0.25, delay_samples: 3}"
    scenario = sample("seed=4", f"sensors.errors=[{stated}]", "vehicle.gyros[0].range=0.5")
    gyro, acc1, acc2, _ = (true_params.sensor_model(scenario, package) for package in scenario.vehicle_data.sensors)
    assert (gyro.quantum, gyro.delay, gyro.integrates, gyro.remembers) == (1.52e-6, 0, False, False)
    assert (gyro.limit, acc1.limit) == (0.5, math.inf)
    np.testing.assert_array_equal(gyro.phase, uniform_phase(4, "gyro", 3))
    np.testing.assert_array_equal(acc1.bias, [1.0, 2.0, 3.0])
    assert (acc1.quantum, acc1.delay, acc1.integrates) == (0.25, 3, True)
    assert acc1.walk_std == pytest.approx(0.5 * math.sqrt(0.08))  # 1-sigma after one second
    assert (acc2.quantum, acc2.walk_std) == (0.0344, 0.0)
    equal = sample("sensors.quantizer_phase=equal")
    assert not true_params.sensor_model(equal, equal.vehicle_data.gyros[0]).phase.any()


def test_each_jet_is_off_by_its_own_fraction_drawn_from_the_seed() -> None:
    np.testing.assert_array_equal(params.thrust_factors(sample("seed=3")), np.ones(44))
    scenario = sample("seed=7", "plant.thrust_dispersion=0.02")
    factors = [params.thrust_factors(scenario.model_copy(update={"seed": seed})) for seed in range(25)]
    assert np.unique(factors).size == 25 * 44
    # 1100 draws: mean 1 and deviation 0.02 within 5 standard errors
    assert abs(np.mean(factors) - 1.0) < 5.0 * 0.02 / math.sqrt(1100)
    assert abs(np.std(factors) / 0.02 - 1.0) < 5.0 / math.sqrt(2.0 * 1100)
    double = params.thrust_factors(sample("seed=7", "plant.thrust_dispersion=0.04"))
    np.testing.assert_allclose(double - 1.0, 2.0 * (factors[7] - 1.0), rtol=1e-12)
    # torque, force and flow go with the thrust; what the estimators take for true is not touched
    nominal = true_params.plant_wrenches(sample())
    np.testing.assert_allclose(true_params.plant_wrenches(scenario), nominal * factors[7][:, None], rtol=1e-15)
    np.testing.assert_array_equal(nominal[:, 6], scenario.vehicle_data.mass_flows)
    assert not true_params.plant_wrenches(sample("plant.depletion=false"))[:, 6].any()


# with the second seed the leaking jet's draw lies 3.6 sigma low: 1 - 3.6 x 0.3 is below zero
@pytest.mark.parametrize(("seed", "dispersion"), [(0, 0.1), (1249, 0.3)])
def test_a_leak_gives_the_force_it_states_whatever_the_jets_thrust(seed: int, dispersion: float) -> None:
    scenario = load_scenario("leak_24", [f"seed={seed}", f"plant.thrust_dispersion={dispersion}"])
    (failure,) = true_params.jet_failures(scenario)
    force = failure.amount * np.linalg.norm(true_params.plant_wrenches(scenario)[failure.jet, 3:6])
    assert force == pytest.approx(scenario.failures[0].force, rel=1e-12)
    assert params.thrust_factors(scenario)[failure.jet] != 1.0


def joint_of(name: str, *overrides: str) -> JointFilterParams:
    found: JointFilterParams = params.estimation_params(load_scenario(name, list(overrides))).filter_params
    return found


def joint(*overrides: str) -> JointParams:
    return joint_of("orbiter_maneuver", "joint={}", *overrides).joint


def test_vehicle_keys_reach_the_filter_by_kind() -> None:
    primary, vernier = "vehicle.jet_kinds.primary", "vehicle.jet_kinds.vernier"
    found = joint(
        f"{primary}.thrust_uncertainty=0.02",
        f"{vernier}.thrust_uncertainty=0.01",
        f"{primary}.lag_uncertainty=0.1",
        f"{primary}.repeatability=0.001",
        "vehicle.gyros[0].bias_std=1e-5",
        "vehicle.accelerometers[1].bias_std=1e-3",
        "vehicle.tank_fraction=0.1",
    )
    places = found.places
    assert (places.n_thrust, places.n_lag, places.n_gyro_bias, places.n_acceleration_bias) == (44, 2, 3, 9)
    assert (found.thrust_sigma, found.lag_sigma) == (0.02, 0.2)
    assert (found.gyro_bias_sigma, found.acceleration_bias_sigma, found.tank_fraction) == (1e-5, 1e-3, 0.1)
    prior = dict(zip(range(places.thrust, places.size), found.prior_sigma, strict=True))
    assert [prior[places.thrust], prior[places.thrust + 43]] == [1.0, 0.5]
    assert [prior[places.lag], prior[places.lag + 1]] == [0.5, 1.0]
    # the preferred accelerometer, acc2, is the first
    assert [prior[places.acceleration_bias + 3 * package] for package in range(3)] == [1.0, 0.0, 0.0]
    assert prior[places.scale] == 0.0
    np.testing.assert_array_equal(found.repeatability, [0.001] * 38 + [0.0] * 6)


def test_a_disturbance_accelerates_the_nominal_vehicle() -> None:
    found = joint("vehicle.disturbance={torque_std: [100, 0, 300], force_std: 50, time_constant_s: 60}")
    assert found.places.unstated - found.places.slow == 5
    assert found.disturbance.time_constant_s == 60.0
    nominal = load_vehicle("orbiter").nominal
    expected = np.zeros((6, 5))
    expected[:3, 0], expected[:3, 1] = (np.linalg.inv(nominal.inertia) * [100.0, 0.0, 300.0])[:, [0, 2]].T
    expected[3:, 2:] = 50.0 / nominal.mass * np.eye(3)
    np.testing.assert_allclose(found.disturbance.accelerations, expected, rtol=1e-12, atol=1e-18)
    none = ("vehicle.accelerometers=[]", "vehicle.preferred_accelerometer=null")
    alone = joint(*none, "vehicle.disturbance={torque_std: 1, force_std: 1, time_constant_s: 60}")
    assert alone.places.unstated - alone.places.slow == 3  # no reading shows a force


def test_defaults_of_the_joint_filter() -> None:
    found = joint()  # its figures are pinned by docs/scenario.md and docs/vehicle.md
    np.testing.assert_allclose(found.thresholds, chi2.isf(1.5e-5, [1, 2, 3]))
    np.testing.assert_array_equal(found.quanta, [1.52e-6] * 3 + [0.0344] * 9)
    np.testing.assert_allclose(found.start_root @ found.start_root.T, np.diag(found.increment_sigma**2))
    narrow = joint("estimation.start=nominal")
    np.testing.assert_array_equal(narrow.increment_sigma, found.increment_sigma)  # always of the widest start
    assert np.diag(narrow.start_root)[0] == pytest.approx(0.3 * found.increment_sigma[0])
    dithered = joint_of("small_satellite_maneuver", "estimation={filter: joint}", "mass={}").joint
    np.testing.assert_array_equal(dithered.quanta, np.zeros(6))  # it needs no quantum
    assert joint_of("orbiter_maneuver", "joint.switching=stamps").at_stamps


JETS = 44  # of the orbiter


def faults(*overrides: str) -> Params:
    found: Params = params.detector_params(load_scenario("leak_named", list(overrides)))
    return found


def test_every_prior_has_its_key_and_reaches_the_detector() -> None:
    block = FaultsBlock()
    assert set(FaultsBlock.model_fields) == {*Priors._fields, "slots", "modes", "jets"}
    assert Priors(*(getattr(block, name) for name in Priors._fields)) == Priors()
    for key in list_keys(FaultsBlock):
        assert (key.unit == "1/h") == key.name.endswith("per_hour"), key
    assert get_args(FaultMode) == tuple(mode.name.lower() for mode in Mode if mode != Mode.NONE)
    changed = {name: 0.9 * getattr(Priors(), name) for name in Priors._fields}
    found = faults(*(f"faults.{name}={value!r}" for name, value in changed.items()))
    assert found.priors == Priors(**changed)
    np.testing.assert_array_equal(found.allowed, np.ones(2 * JETS))
    np.testing.assert_array_equal(found.rates, np.ones(JETS))
    for overrides, slots in (([], 4), (["faults.slots=2"], 2), (["faults.slots=2", "detector.kind=off"], 0)):
        assert joint_of("leak_named", *overrides).joint.places.n_force == slots


@pytest.mark.parametrize(
    ("modes", "more", "less"),
    [("stuck_on", 1.0, 0.0), ("leak", 1.0, 0.0), ("loss", 0.0, 1.0), ("drifting", 1.0, 1.0), ("leak, loss", 1.0, 1.0)],
)
def test_modes_say_whether_a_jet_may_give_more_or_less(modes: str, more: float, less: float) -> None:
    np.testing.assert_array_equal(faults(f"faults.modes=[{modes}]").allowed, [more] * JETS + [less] * JETS)
    jet = load_vehicle("orbiter").jet_index("R4R")
    found = faults(f"faults={{jet_per_hour: 0.002, jets: {{R4R: {{modes: [{modes}], per_hour: 0.01}}}}}}")
    assert (found.allowed[jet], found.allowed[JETS + jet]) == (more, less)
    assert found.allowed.sum() == 2 * JETS - 2 + more + less
    assert found.rates[jet] == pytest.approx(5.0)  # in terms of the usual rate
    assert np.delete(found.rates, jet) == pytest.approx(1.0)
