"""From vehicles that are followed in a fixed frame to the parameters of the pose filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import InputError, load_scenario, load_vehicle, simulate
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles
from massprop_drake.inputs.vehicle_sensors import PoseSensor, VelocitySensor
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, NAMES

STARS, SPEED = PoseSensor(name="stars", attitude_std=1e-3), VelocitySensor(name="v", noise_std=1e-3)


def made(vehicle: Vehicle, **settings: Any) -> Any:
    return params.estimation_params(
        resolve_scenario({"name": "made", "vehicle": vehicle} | settings)
    ).filter_params.pose


def free(found: Any, part: slice) -> list[int]:
    """Places of a part of the state that are estimated."""
    return [int(place) - part.start for place in found.free if part.start <= place < part.stop]


def test_vehicles_that_are_followed_choose_their_filter() -> None:
    for name in bundled_vehicles():
        scenario = resolve_scenario({"name": "usual", "vehicle": name})
        assert (scenario.estimation.filter == "pose") == load_vehicle(name).needs_pose_filter
    assert made(again(load_vehicle("tracked_flyer"), poses=(STARS,))).free.size  # and a bench with a star tracker
    flown = resolve_scenario({"name": "wrong", "vehicle": "tracked_flyer", "duration_s": 1.0})
    with pytest.raises(InputError, match="has no gyro, which an autopilot flies by; prescribe"):
        simulate(flown)


def test_in_a_plane_x_y_and_the_heading_alone_are_free() -> None:
    found = made(load_vehicle("air_bearing"))
    parts = found.parts
    for part in (parts.center, parts.position, parts.velocity, parts.point):
        assert free(found, part) == [0, 1]
    for part in (parts.attitude, parts.rate, parts.spin):
        assert free(found, part) == [2]
    assert free(found, parts.push) == [0, 1, 5]
    known = params.known_parameters(resolve_scenario({"name": "made", "vehicle": "air_bearing"}))
    assert np.array(NAMES)[~known].tolist() == ["Izz_inv", "x_cm", "y_cm", "m_inv"]


def test_fixed_parameters_have_no_sigma_and_keep_their_value() -> None:
    found = made(again(load_vehicle("tracked_flyer"), fixed=("m_inv", "Ixx_inv", "z_cm")))
    assert (found.mass_std, free(found, found.parts.center)) == (0.0, [0, 1])
    scenario = load_scenario("air_bearing_pulses", ["duration_s=0.5", "execution.engine=loop"])
    fixed = again(scenario.vehicle_data, fixed=("m_inv", "x_cm"))
    run = simulate(resolve_scenario({**scenario.model_dump(exclude_unset=True), "vehicle": fixed}), look_back=False)
    deviation, estimate = run["standard_deviation"], run["estimate"]
    assert np.isnan(deviation[:, [6, MASS_RECIPROCAL]]).all()
    np.testing.assert_array_equal(estimate[:, [6, MASS_RECIPROCAL]], [[0.0, 1.0 / fixed.nominal.mass]] * len(estimate))
    assert np.isfinite(deviation[:, [2, 7]]).all()


def test_hypotheses_have_a_place_for_a_push_where_none_is_expected() -> None:
    found = made(load_vehicle("tracked_flyer"))
    parts = found.parts
    assert (free(found, parts.push), free(found, parts.open)) == ([*range(6)], [0])
    places = np.flatnonzero((found.free >= parts.push.start) & (found.free < parts.push.stop))
    np.testing.assert_array_equal(found.covariance[places], 0.0)
    without = made(load_vehicle("tracked_flyer"), detector={"kind": "off"})
    assert free(without, parts.push) == free(without, parts.open) == []


def test_a_floor_carries_what_would_lift_or_tip() -> None:
    vehicle = load_vehicle("air_bearing")
    jets = [jet.model_copy(update={"position": (*jet.position[:2], 0.05)}) for jet in vehicle.jets]
    jets[0] = jets[0].model_copy(update={"direction": (-0.8, 0.0, 0.6)})
    wrenches = true_params.plant_wrenches(
        resolve_scenario({"name": "made", "vehicle": again(vehicle, jets=tuple(jets))})
    )
    np.testing.assert_array_equal(wrenches[:, 5], 0.0)
    turns = wrenches[:, :3] - np.cross(vehicle.nominal.center_of_mass, wrenches[:, 3:6])  # about the center of mass
    np.testing.assert_allclose(turns[:, :2], 0.0, atol=1e-15)
    assert np.abs(turns[:, 2]).min() > 0.01
