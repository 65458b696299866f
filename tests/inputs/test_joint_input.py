"""Keys of the joint filter in scenario and vehicle files, and what becomes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.stats import chi2

from massprop_drake import InputError, Scenario, load_scenario, load_vehicle
from massprop_drake.inputs import params
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.scenario import HypothesesBlock, JointBlock, bundled_scenarios, resolved
from massprop_drake.maths.estimation.filters.joint import chi_square_limit
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.records.reader import vehicle_scenario
from massprop_drake.runners.recorded import settings_alone

_KEYS = (
    *("thrust_uncertainty", "lag_uncertainty", "tank_fraction", "rate_walk", "velocity_walk"),
    *("increment_rate", "settled_after"),
)


def joint(*overrides: str) -> Scenario:
    return load_scenario("orbiter_maneuver", list(overrides))


def made(*overrides: str) -> JointParams:
    return params.joint_params(joint("joint={}", *overrides)).joint


NEW = {
    *("orbiter_maneuver", "leak_named", "leak_small", "two_at_once", "intermittent_jet", "dispersed_thrust"),
    *("payload_docking", "air_bearing_pulses", "small_satellite_leak", "cubesat_leak", "lander_burn"),
    *("servicer_arm", "servicer_panel", "servicer_slosh", "servicer_on_wheels_leak"),
    *("servicer_panel_stated", "servicer_slosh_stated"),
}


@pytest.mark.parametrize("name", sorted(set(bundled_scenarios()) - NEW))
def test_scenarios_of_before_are_pinned_to_the_thesis(name: str) -> None:
    text = (Path(__file__).parents[2] / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8")
    assert YAML(typ="safe", pure=True).load(text)["estimation"]["filter"] == "thesis"
    assert load_scenario(name).estimation.filter == "thesis"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("rotation.filter=extended", r"rotation\.filter: is a key of estimation\.filter: thesis"),
        (
            "mass.jump=none",
            r"mass\.jump: is a key of estimation\.filter: thesis, and the filter is joint; leave it out",
        ),
        ("sensors.combine.gyros=average", r"sensors\.combine\.gyros: is a key of estimation\.filter: thesis"),
        ("estimation.thrust_transient=gate", r"estimation\.thrust_transient: is a key of"),
        ("estimation.thrust_uncertainty=0.01", r"estimation\.thrust_uncertainty: is a key of"),
        (
            "detector.kind=cglr",
            r"detector\.kind: cglr does not go with estimation\.filter: joint; use hypotheses or off",
        ),
        ("detector.kind=cusum", r"detector\.kind: cusum does not go with"),
    ],
)
def test_keys_of_the_thesis_are_refused_with_the_joint_filter(override: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        joint(override)
    assert len(raised.value.problems) == 1


def test_keys_of_the_joint_filter_are_refused_with_the_thesis() -> None:
    with pytest.raises(InputError, match=r"joint\.rate_walk: is a key of estimation\.filter: joint, and the filter is"):
        load_scenario("sample_maneuver", ["joint.rate_walk=1e-7"])


@pytest.mark.parametrize(
    ("data", "chosen"),
    [
        ({}, ("joint", "hypotheses")),
        ({"estimation": {"start": "zero"}}, ("joint", "hypotheses")),
        ({"estimation": {"filter": "joint"}}, ("joint", "hypotheses")),
        ({"estimation": {"filter": "joint"}, "faults": {"slots": 2}}, ("joint", "hypotheses")),
        ({"faults": {"slots": 2}}, ("joint", "hypotheses")),
        ({"detector": {"kind": "off"}}, ("joint", "off")),
        ({"estimation": {"filter": "thesis"}}, ("thesis", "cglr")),
        ({"estimation": {"filter": "thesis"}, "detector": {"margin": 8}}, ("thesis", "cglr")),
        # files of before there was a choice name no filter, and have keys of the thesis's alone
        ({"rotation": {"filter": "extended"}}, ("thesis", "cglr")),
        ({"mass": {}}, ("thesis", "cglr")),
        ({"estimation": {"thrust_transient": "gate"}}, ("thesis", "cglr")),
        ({"sensors": {"combine": {"gyros": "average"}}}, ("thesis", "cglr")),
        ({"detector": {"kind": "cusum"}}, ("thesis", "cusum")),
        ({"rotation": {}, "detector": {"kind": "off"}}, ("thesis", "off")),
    ],
)
def test_filter_and_detector_of_a_scenario(data: dict[str, Any], chosen: tuple[str, str]) -> None:
    for scenario in (resolved(data), Scenario.model_validate(data)):
        assert (scenario.estimation.filter, scenario.detector.kind) == chosen
    assert resolved(YAML(typ="safe", pure=True).load(yaml_text(scenario))).detector.kind == chosen[1]


def test_what_names_nothing_is_the_joint_filter_with_its_detector() -> None:
    assert (Scenario().estimation.filter, Scenario().detector) == ("joint", HypothesesBlock())
    alone = vehicle_scenario("flight", "orbiter")
    assert alone.model_copy(update={"name": "scenario", "vehicle": "orbiter"}) == Scenario()
    old = vehicle_scenario("flight", "orbiter", ["estimation.filter=thesis", "rotation.jump=none"])
    assert (old.rotation.coupling, old.rotation.jump) == ("model", "none")
    assert (old.mass.compensation, old.detector.kind) == ("transverse_centripetal", "cglr")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"rotation": {"jump": "none"}, "joint": {"rate_walk": 1e-7}}, r"rotation\.jump: is a key of .* thesis"),
        ({"detector": {"kind": "hypotheses"}, "mass": {"jump": "none"}}, r"mass\.jump: is a key of"),
        (
            {"estimation": {"filter": "joint"}, "detector": {"kind": "cglr"}},
            "cglr does not go with .* joint; use",
        ),
        (
            {"estimation": {"filter": "thesis"}, "detector": {"kind": "hypotheses"}},
            "hypotheses does not go with estimation.filter: thesis; use cglr or cusum or off",
        ),
        ({"detector": {"threshold": 30}}, "threshold: is a key of kind: cglr, and the kind is hypotheses"),
        ({"detector": {"slot": 3}}, "detector.slot: unknown key"),
        ({"faults": {"slot": 3}}, "unknown key; did you mean .slots."),
        (
            {"faults": {}, "rotation": {"jump": "none"}},
            r"rotation\.jump: is a key of .* thesis, and the filter is joint",
        ),
        (
            {"estimation": {"filter": "thesis"}, "detector": {"trigger": 30}},
            "detector.trigger: unknown key; valid are: kind, margin",
        ),
        ({"estimation": {"filter": "neither"}}, "estimation.filter: 'neither' is not one of"),
        ({"estimation": {"filter": ["joint"]}}, "estimation.filter: .* is not one of"),
        ({"estimation": None}, "estimation: .*mapping"),
        ({"detector": None}, "detector: .*mapping"),
    ],
)
def test_what_does_not_go_together_is_refused(data: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        resolved(data)
    assert len(raised.value.problems) == 1


def test_instantaneous_thrust_in_the_plant_is_known_to_the_filter_and_stays_so_without_the_plant() -> None:
    assert joint().joint.thrust_transient == "vehicle"
    instantaneous = joint("plant.thrust_transient=none")
    assert instantaneous.joint.thrust_transient == "none"
    assert not params.joint_params(settings_alone(instantaneous)).joint.time_constants_s.any()
    wrong = joint("plant.thrust_transient=none", "joint.thrust_transient=vehicle")
    assert params.joint_params(wrong).joint.time_constants_s.all()
    assert made("plant.thrust_transient=none").places.n_lag == 0  # nothing to estimate


def test_a_resolved_scenario_is_read_back_as_it_is() -> None:
    data = YAML(typ="safe", pure=True).load(yaml_text(joint("joint.rate_walk=1e-7")))
    assert resolved(data) == joint("joint.rate_walk=1e-7")


def test_vehicle_keys_reach_the_filter_by_kind() -> None:
    primary, vernier = "vehicle.jet_kinds.primary", "vehicle.jet_kinds.vernier"
    found = made(
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
    found = made("vehicle.disturbance={torque_std: [100, 0, 300], force_std: 50, time_constant_s: 60}")
    assert found.places.unstated - found.places.slow == 5
    assert found.disturbance.time_constant_s == 60.0
    nominal = load_vehicle("orbiter").nominal
    expected = np.zeros((6, 5))
    expected[:3, 0], expected[:3, 1] = (np.linalg.inv(nominal.inertia) * [100.0, 0.0, 300.0])[:, [0, 2]].T
    expected[3:, 2:] = 50.0 / nominal.mass * np.eye(3)
    np.testing.assert_allclose(found.disturbance.accelerations, expected, rtol=1e-12, atol=1e-18)
    assert made().places.unstated == made().places.slow
    none = ("vehicle.accelerometers=[]", "vehicle.preferred_accelerometer=null")
    alone = made(*none, "vehicle.disturbance={torque_std: 1, force_std: 1, time_constant_s: 60}")
    assert alone.places.unstated - alone.places.slow == 3  # no reading shows a force


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ("{time_constant_s: 60}", "vehicle.disturbance: nothing is said to act; give torque_std, force_std or both"),
        ("{torque_std: [1, -1, 0], time_constant_s: 60}", "vehicle.disturbance.torque_std: must be zero or positive"),
        ("{torque_std: 1}", "vehicle.disturbance.time_constant_s"),
        ("{torque_std: 1, time_constant_s: 0}", "vehicle.disturbance.time_constant_s"),
        ("{torque_std: [1, 2], time_constant_s: 60}", "vehicle.disturbance.torque_std"),
        ("{torque_std: true, time_constant_s: 60}", "vehicle.disturbance.torque_std"),
    ],
)
def test_a_disturbance_that_cannot_be_is_refused(stated: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        joint(f"vehicle.disturbance={stated}")
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_scenario_keys_replace_those_of_the_vehicle() -> None:
    found = made("joint={thrust_uncertainty: 0, lag_uncertainty: 0, rate_walk: 1.0e-7, settled_after: 5}")
    assert (found.places.n_thrust, found.places.n_lag, found.places.n_scale) == (0, 0, 0)
    assert (found.rate_walk, found.settled_after) == (1e-7, 5.0)


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("thrust_transient", "none", "time_constants_s"),
        ("thrust_uncertainty", 0.02, "thrust_sigma"),
        ("lag_uncertainty", 0.1, "lag_sigma"),
        ("tank_fraction", 0.05, "tank_fraction"),
        ("rate_walk", 1e-7, "rate_walk"),
        ("velocity_walk", 1e-3, "velocity_walk"),
        ("increment_rate", 1e-4, "thresholds"),
        ("settled_after", 7, "settled_after"),
    ],
)
def test_every_key_of_the_block_has_its_effect(key: str, value: object, field: str) -> None:
    assert set(JointBlock.model_fields) == {"thrust_transient", "switching", *_KEYS}
    before, after = getattr(made(), field), getattr(made(f"joint.{key}={value}"), field)
    assert not np.array_equal(before, after)


def test_commands_may_be_said_to_switch_at_stamps() -> None:
    assert not params.joint_params(joint("joint={}")).at_stamps
    assert params.joint_params(joint("joint.switching=stamps")).at_stamps
    with pytest.raises(InputError, match="switching"):
        joint("joint.switching=rows")


def test_defaults() -> None:
    found = made()
    np.testing.assert_allclose(found.thresholds, chi2.isf(1.5e-5, [1, 2, 3]))
    assert (found.thrust_sigma, found.lag_sigma, found.tank_fraction) == (0.01, 0.2, 0.01)
    np.testing.assert_array_equal(found.guard_relative, [0.02, 0.02, 0.02, 0.2])
    vehicle = load_vehicle("orbiter")
    np.testing.assert_allclose(found.guard_center, 0.03 * vehicle.rms_arm)
    np.testing.assert_array_equal(found.quanta, [1.52e-6] * 3 + [0.0344] * 9)
    np.testing.assert_allclose(found.start_root @ found.start_root.T, np.diag(found.increment_sigma**2))
    narrow = made("estimation.start=nominal")
    np.testing.assert_array_equal(narrow.increment_sigma, found.increment_sigma)  # always of the widest start
    assert np.diag(narrow.start_root)[0] == pytest.approx(0.3 * found.increment_sigma[0])


def test_a_sensor_that_dithers_itself_has_no_quantum() -> None:
    found = params.joint_params(load_scenario("small_satellite_maneuver", ["estimation={filter: joint}", "mass={}"]))
    np.testing.assert_array_equal(found.joint.quanta, np.zeros(6))


def test_a_given_covariance_is_taken_whole() -> None:
    sigma = 0.1 * made().increment_sigma
    covariance = np.diag(sigma**2)
    covariance[0, 1] = covariance[1, 0] = 0.5 * sigma[0] * sigma[1]
    scenario = joint("estimation.start=given", f"estimation.given={{covariance: {covariance.tolist()}}}", "joint={}")
    root = params.joint_params(scenario).joint.start_root
    np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-9, atol=1e-25)
    np.testing.assert_array_equal(np.triu(root, 1), np.zeros((10, 10)))


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 18])
@pytest.mark.parametrize("rate", [0.3, 1.5e-5, 1e-60])
def test_limits_of_chi_square(rate: float, degrees: int) -> None:
    assert chi_square_limit(rate, degrees) == pytest.approx(chi2.isf(rate, degrees), rel=1e-9)
