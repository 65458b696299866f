"""Reaction wheels on a body of a MultibodyPlant and on both kinds of the rigid plant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import Scenario, load_scenario, load_vehicle, simulate
from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Wheel
from massprop_drake.maths.vehicle.wheel_motors import draw_inertias

AXIS, SPIN = np.array([0.6, 0.0, 0.8]), 0.02  # kg-m^2
LINK = """<?xml version="1.0"?>
<sdf version="1.9"><model name="one"><link name="bus"><inertial>
<pose>0.04 0 -0.02 0 0 0</pose><mass>500</mass>
<inertia><ixx>95</ixx><iyy>130</iyy><izz>142</izz><ixy>-1.2</ixy><ixz>2.5</ixz><iyz>-0.8</iyz></inertia>
</inertial></link></model></sdf>"""


def with_wheels() -> Vehicle:
    wheels = (
        Wheel(name="W1", axis=tuple(AXIS), inertia=SPIN, quantum=0.05, torque=0.2),
        Wheel(name="W2", axis=(0.0, 1.0, 0.0), inertia=0.015, quantum=0.05, torque=0.2),
    )
    return again(load_vehicle("small_satellite"), wheels=wheels)


def flight(plant: dict[str, Any], **changed: Any) -> Scenario:
    turned = [
        {"wheel": "W1", "start_s": 0.2, "end_s": 1.4, "torque": 0.1},
        {"wheel": "W2", "start_s": 0.5, "end_s": 1.5, "torque": -0.5},
    ]
    fired = [{"jet": "YP1", "start_s": 0.4, "end_s": 1.0}]
    started = {"wheel_speeds": {"W1": 60.0}, "initial_rate": [0.1, -0.2, 0.05], "wheel_dispersion": 0.02}
    own = {"vehicle": with_wheels(), "duration_s": 2.0, "wheel_schedule": turned, "jet_schedule": fired}
    return resolve_scenario(own | {"plant": plant | started, "detector": {"kind": "off"}} | changed)


def test_one_body_moves_as_the_rigid_plant_does() -> None:
    rigid, stepped = (
        simulate(flight({"time_step": step, "depletion": False}), look_back=False) for step in (0.0, None)
    )
    other = simulate(flight({"kind": "multibody", "model": LINK, "body": "bus"}), look_back=False)
    moved = dict.fromkeys(("rate", "velocity", "position", "attitude"), 1e-8)
    for name, least in (moved | {"gyro": 1e-5, "W1": 1e-12, "acc": 2e-4}).items():
        np.testing.assert_allclose(other[name], rigid[name], atol=least, err_msg=name)
    np.testing.assert_allclose(stepped["rate"], rigid["rate"], atol=1e-9)
    unmoved = np.array(flight({}).plant.initial_rate)
    assert np.abs(rigid["rate"] - unmoved).max() > 0.01
    made = stepped.scenario
    inertias = draw_inertias(true_params.wheels_model(made), made.seed)
    for name, speed in (("W1", 60.0 + 0.1 * 1.2 / inertias[0]), ("W2", -0.2 * 1.0 / inertias[1])):  # not by 0.5 N m
        read = stepped[name][:, 0]
        assert abs(read[-1] - speed) < 0.1
        np.testing.assert_allclose(read / 0.05, np.round(read / 0.05), atol=1e-9)


def test_wheels_that_the_vehicle_has_not_are_refused() -> None:
    with pytest.raises(ValueError, match="'W3' is no wheel of vehicle 'small_satellite'; valid are: W1, W2"):
        flight({}, wheel_schedule=[{"wheel": "W3", "start_s": 0.0, "end_s": 1.0, "torque": 0.1}])
    with pytest.raises(ValueError, match="'W1' is no wheel of vehicle 'small_satellite'"):
        load_scenario("small_satellite_leak", ["plant.wheel_speeds={W1: 3.0}"])
