"""Vehicles that are followed in a fixed frame: what their files may say, and the one message for what they may not."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again
from test_vehicle_file import DELETED

from massprop_drake import InputError, load_scenario, load_vehicle, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import PoseSensor, Vehicle, VelocitySensor, bundled_vehicles
from massprop_drake.inputs.yaml import Document, to_yaml
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, NAMES


def data(name: str = "air_bearing") -> dict[str, Any]:
    """The data of a bundled vehicle."""
    return dict(load_vehicle(name).model_dump(mode="json", exclude_unset=True))


def written(path: Path, changes: dict[str, Any]) -> Path:
    """A vehicle file with some keys other than those of the air-bearing satellite; dots lead inside."""
    one = data()
    for key, value in changes.items():
        *inside, last = key.split(".")
        at: Any = one
        for part in inside:
            at = at[int(part)] if part.isdigit() else at[part]
        if value is DELETED:
            del at[last]
        else:
            at[last] = value
    path.write_text(to_yaml(one), encoding="utf-8")
    return path


MOCAP = {"name": "mocap", "position_std": 1e-4, "attitude_std": 1e-3}
REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "products of a plane": (
        {"mass_properties.inertia": [[0.3, 0.0, 0.01], [0.0, 0.3, 0.0], [0.01, 0.0, 0.3]]},
        "mass_properties.inertia: with motion: planar products xz and yz play no part; give 0",
        "inertia",
    ),
    "a jet along z": (
        {"jets.2.direction": [0, 0, 1]},
        "jets[2].direction: with motion: planar a jet along z moves nothing",
        "direction",
    ),
    "position without attitude": (
        {"poses": [{"name": "mocap", "position_std": 1e-4}], "gyros": [{"name": "g", "quantum": 0, "noise_std": 1e-3}]},
        "poses: positions and velocities in a fixed frame need a pose sensor with attitude_std",
        "poses:",
    ),
    "velocity without attitude": (
        {"poses": [], "velocities": [{"name": "v", "noise_std": 1e-3}], "gyros": [{"name": "g", "quantum": 1e-6}]},
        "velocities: positions and velocities in a fixed frame need a pose sensor with attitude_std",
        "velocities:",
    ),
    "a pose that measures nothing": (
        {"poses": [MOCAP, {"name": "cam"}]},
        "sensor 'cam' measures nothing: give position_std, attitude_std or both",
        "name: cam",
    ),
    "no attitude and no gyro": ({"poses": [], "motion": "free"}, "gyros: is empty; this field is required", "gyros:"),
    "two of one name": (
        {"poses": [MOCAP, dict(MOCAP)]},
        "sensors: name 'mocap' appears twice; it must be unique",
        "poses",
    ),
    "a heading that no free vehicle has": (
        {"motion": "free"},
        "surroundings.heading_turn_std: goes with motion: planar, which has a heading; here it must be 0",
        "heading_turn_std",
    ),
    "an unknown parameter that is fixed": ({"fixed": ["mass"]}, "fixed[0]", "fixed"),
    "a disturbance in a fixed frame": (
        {"disturbance": {"torque_std": 1.0, "time_constant_s": 60.0}},
        "disturbance: is not estimated in a fixed frame; state surroundings.slope_std and surroundings.turn_std",
        "disturbance",
    ),
    "a share of poor readings that leaves none": ({"poses.0.outliers": 0.5}, "poses[0].outliers", "outliers"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_said_once_with_its_line(case: str, tmp_path: Path) -> None:
    changes, message, at = REFUSED[case]
    path = written(tmp_path / "wrong.yaml", changes)
    with pytest.raises(InputError) as caught:
        load_vehicle(path)
    said = str(caught.value)
    assert message in said
    assert len(said.splitlines()) == 1, said
    if case == "two of one name":  # of which neither is the wrong one
        return
    line = re.search(r"line (\d+)", said)
    assert line is not None, said
    lines = path.read_text(encoding="utf-8").splitlines()
    near = "\n".join(lines[max(int(line[1]) - 2, 0) : int(line[1]) + 1])
    assert at in near, (said, near)


TRACKED = "which needs pose"
MISMATCHED: dict[str, tuple[dict[str, Any], str]] = {
    "joint": ({"estimation": {"filter": "joint"}}, f"joint does not go with vehicle 'air_bearing', {TRACKED}"),
    "pose": (
        {"vehicle": "orbiter", "estimation": {"filter": "pose"}},
        "pose does not go with vehicle 'orbiter', which has no pose or velocity sensor; use joint",
    ),
    "detector": ({"detector": {"kind": "hypotheses"}}, "detector"),
}


@pytest.mark.parametrize(("settings", "message"), MISMATCHED.values(), ids=MISMATCHED)
def test_settings_that_do_not_go_with_the_vehicle_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        resolved({"name": "wrong", "vehicle": "air_bearing", **settings})
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_autopilot_needs_a_gyro() -> None:
    scenario = resolved({"name": "wrong", "vehicle": "tracked_flyer", "duration_s": 1.0})
    with pytest.raises(
        InputError, match=r"vehicle 'tracked_flyer' has no gyro, which an autopilot flies by; prescribe"
    ):
        simulate(scenario)


def test_a_tracked_vehicle_chooses_its_filter_and_detector() -> None:
    for name in bundled_vehicles():
        scenario = resolved({"name": "usual", "vehicle": name})
        tracked = load_vehicle(name).needs_pose_filter
        assert (scenario.estimation.filter == "pose") == tracked
        assert (scenario.detector.kind == "thrust_factors") == tracked
    bench = again(load_vehicle("tracked_flyer"), poses=(PoseSensor(name="stars", attitude_std=1e-3),))
    assert resolved({"name": "usual", "vehicle": bench}).estimation.filter == "pose"


def test_columns_are_named_after_their_sensors() -> None:
    cameras = (PoseSensor(name="one", attitude_std=0.1), PoseSensor(name="two", position_std=0.1))
    vehicle = again(load_vehicle("tracked_flyer"), poses=cameras, velocities=(VelocitySensor(name="v", noise_std=1.0),))
    parts = ("x", "y", "z", "qw", "qx", "qy", "qz")
    expected = [f"{name}_{part}" for name in ("one", "two") for part in parts] + ["v_x", "v_y", "v_z"]
    assert list(vehicle.tracked_columns) == expected
    assert "2 pose sensors, 1 velocity sensor" in repr(vehicle)


# ----------------------------------------------------------------------------------------- parameters


def _made(vehicle: Vehicle, **settings: Any) -> Any:
    return params.estimation_params(resolved({"name": "made", "vehicle": vehicle} | settings)).filter_params


def _free(made: Any, part: slice) -> list[int]:
    return [int(place) - part.start for place in made.pose.free if part.start <= place < part.stop]


def test_in_a_plane_x_y_and_the_heading_alone_are_free() -> None:
    made = _made(load_vehicle("air_bearing"))
    parts = made.pose.parts
    for part in (parts.center, parts.position, parts.velocity, parts.point):
        assert _free(made, part) == [0, 1]
    for part in (parts.attitude, parts.rate, parts.spin):
        assert _free(made, part) == [2]
    assert _free(made, parts.push) == [0, 1, 5]
    known = params.known_parameters(resolved({"name": "made", "vehicle": "air_bearing"}))
    assert np.array(NAMES)[~known].tolist() == ["Izz_inv", "x_cm", "y_cm", "m_inv"]


def test_fixed_parameters_have_no_sigma_and_keep_their_value() -> None:
    vehicle = again(load_vehicle("tracked_flyer"), fixed=("m_inv", "Ixx_inv", "z_cm"))
    made = _made(vehicle)
    assert made.pose.mass_std == 0.0
    assert _free(made, made.pose.parts.center) == [0, 1]
    scenario = load_scenario("air_bearing_pulses", ["duration_s=2"])
    fixed = again(scenario.vehicle_data, fixed=("m_inv", "x_cm"))
    run = simulate(resolved({**scenario.model_dump(exclude_unset=True, exclude={"vehicle_data"}), "vehicle": fixed}))
    deviation, estimate = run["standard_deviation"], run["estimate"]
    assert np.isnan(deviation[:, [6, MASS_RECIPROCAL]]).all()
    np.testing.assert_array_equal(estimate[:, MASS_RECIPROCAL], 1.0 / fixed.nominal.mass)
    np.testing.assert_array_equal(estimate[:, 6], 0.0)
    assert np.isfinite(deviation[:, [2, 7]]).all()


def test_a_weighed_mass_begins_with_the_scales_sigma_unless_the_scenario_says_otherwise() -> None:
    weighed = again(load_vehicle("air_bearing"), mass_std=0.2)
    assert _made(weighed).pose.mass_std == pytest.approx(0.2 / 23.09, rel=1e-12)
    assert _made(load_vehicle("air_bearing")).pose.mass_std == pytest.approx(0.3, rel=1e-9)
    given = _made(weighed, estimation={"start": "nominal", "std_fraction": 0.1})
    assert given.pose.mass_std == pytest.approx(0.1, rel=1e-9)


def test_what_nothing_measures_is_not_free() -> None:
    stars = PoseSensor(name="stars", attitude_std=1e-3)
    made = _made(again(load_vehicle("tracked_flyer"), poses=(stars,)))
    assert _free(made, made.pose.parts.position) == _free(made, made.pose.parts.velocity) == []
    assert (made.pose.mass_std, made.pose.unseen_std) == (0.0, pytest.approx(0.3, rel=1e-9))
    speed = VelocitySensor(name="v", noise_std=1e-3)
    moving = _made(again(load_vehicle("tracked_flyer"), poses=(stars,), velocities=(speed,)))
    assert _free(moving, moving.pose.parts.velocity) == [0, 1, 2]
    assert moving.pose.unseen_std == 0.0


def test_hypotheses_have_a_place_for_a_push_where_none_is_expected() -> None:
    made = _made(load_vehicle("tracked_flyer"))
    parts = made.pose.parts
    assert _free(made, parts.push) == [*range(6)]
    assert _free(made, parts.open) == [0]
    places = np.flatnonzero((made.pose.free >= parts.push.start) & (made.pose.free < parts.push.stop))
    np.testing.assert_array_equal(made.pose.covariance[places], 0.0)
    without = _made(load_vehicle("tracked_flyer"), detector={"kind": "off"})
    assert _free(without, parts.push) == _free(without, parts.open) == []


def test_common_scale_and_own_sigmas_of_jets_reach_the_filter() -> None:
    vehicle = load_vehicle("air_bearing")
    jets = tuple(
        jet.model_copy(update={"thrust_uncertainty": 0.01 if jet.number == 3 else None}) for jet in vehicle.jets
    )
    made = _made(again(vehicle, jets=jets, common_scale_walk=0.013)).pose
    np.testing.assert_allclose(made.thrust_std, [0.05, 0.05, 0.01, *[0.05] * 5])
    assert made.common_walk == 0.013
    place = int(np.flatnonzero(made.free == made.parts.common.start)[0])
    assert made.covariance[place, place] == pytest.approx(0.05**2)
    assert made.kicks_per_s == pytest.approx(10.0 / 60.0)


def test_a_pose_model_measures_what_its_sensor_does() -> None:
    scenario = resolved({"name": "made", "vehicle": "air_bearing"})
    model = params.pose_model(scenario, PoseSensor(name="stars", attitude_std=2e-3, time_std_s=1e-3, outliers=0.1))
    assert math.isinf(model.position_std)
    assert (model.attitude_std, model.time_std_s, model.outliers, model.planar) == (2e-3, 1e-3, 0.1, True)


def test_a_floor_carries_what_would_lift_or_tip() -> None:
    vehicle = load_vehicle("air_bearing")
    jets = [jet.model_copy(update={"position": (*jet.position[:2], 0.05)}) for jet in vehicle.jets]
    jets[0] = jets[0].model_copy(update={"direction": (-0.8, 0.0, 0.6)})
    scenario = resolved({"name": "made", "vehicle": again(vehicle, jets=tuple(jets))})
    wrenches = params.plant_wrenches(scenario)
    center = scenario.vehicle_data.nominal.center_of_mass
    np.testing.assert_array_equal(wrenches[:, 5], 0.0)
    turns = wrenches[:, :3] - np.cross(center, wrenches[:, 3:6])  # about the center of mass
    np.testing.assert_allclose(turns[:, :2], 0.0, atol=1e-15)
    assert np.abs(turns[:, 2]).min() > 0.01


def test_a_file_of_its_data_gives_the_vehicle_again() -> None:
    for name in ("air_bearing", "tracked_flyer"):
        text = to_yaml(data(name))
        assert Vehicle.model_validate(Document(text, "again.yaml").data) == load_vehicle(name)
