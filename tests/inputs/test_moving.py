"""Parts that move inside a vehicle, as files state them."""

from __future__ import annotations

from typing import Any

import numpy as np

from massprop_drake.inputs.moving import HingedPanel, Slosh
from massprop_drake.inputs.params import modes
from massprop_drake.inputs.scenario import load_scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import load_vehicle

SLOSH: dict[str, Any] = {
    **{"name": "tank", "kind": "slosh", "mass": 4.0, "position": [0.1, 0.2, 0.3], "axes": ["x", [0, 0.6, 0.8]]},
    **{"frequency_hz": 0.1, "damping": 0.02},
}
PANEL: dict[str, Any] = {
    **{"name": "array", "kind": "panel", "hinge": [0.0, 0.5, 0.1], "axis": [1, 0, 0], "mass": 3.0},
    **{"center_of_mass": [0.2, 1.5, 0.1], "frequency_hz": 1.0, "damping": 0.005},
}


def test_a_panel_participates_as_its_points_do() -> None:
    """As sums over points of a flat panel give, which is turned about its hinge by a small angle."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.6, 41), np.linspace(0.6, 2.4, 41))
    points = np.stack((x.ravel(), y.ravel(), np.full(x.size, 0.1)), axis=1)
    each = 3.0 / len(points)
    ways = np.cross([1.0, 0.0, 0.0], points - [0.0, 0.5, 0.1])
    inertia = each * float(np.sum(ways**2))
    ways /= np.sqrt(inertia)
    ((push, turn),) = HingedPanel.model_validate({**PANEL, "inertia": inertia}).modes
    np.testing.assert_allclose(push, each * ways.sum(axis=0), atol=1e-12)
    expected = each * np.cross(points, ways).sum(axis=0)
    np.testing.assert_allclose(turn[0], expected[0], rtol=1e-12)  # others by products that are not stated


def test_slosh_has_a_mode_for_each_axis() -> None:
    part = Slosh.model_validate(SLOSH)
    pairs = part.modes
    np.testing.assert_allclose([push for push, _ in pairs], [[2.0, 0.0, 0.0], [0.0, 1.2, 1.6]])
    np.testing.assert_allclose(pairs[1][1], 2.0 * np.cross([0.1, 0.2, 0.3], [0.0, 0.6, 0.8]))
    arm, step = np.array([0.1, 0.2, 0.3]), 1e-6
    for swell, (push, _) in zip(part.swelling(np.zeros(3)), pairs, strict=True):
        there = [arm + sign * step * push / 4.0 for sign in (-1.0, 1.0)]
        before, after = (4.0 * (p @ p * np.eye(3) - np.outer(p, p)) for p in there)
        np.testing.assert_allclose(swell, (after - before) / (2.0 * step), atol=1e-7)


def test_modes_of_one_mass_go_round_and_others_do_not() -> None:
    vehicle = load_vehicle("servicer")
    told = vehicle.model_copy(update={"moving": (Slosh.model_validate(SLOSH),)})
    found = modes(told)
    np.testing.assert_allclose(found.crossing[0, 1], np.cross([0.0, 0.6, 0.8], [1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(found.crossing[0, 1], -found.crossing[1, 0])
    assert (found.start > 0.0).all()
    assert (found.shaken >= found.start).all()
    np.testing.assert_allclose(found.sigmas, [[0.025, 0.05, 0.5, *3 * [0.05 * vehicle.rms_arm]]])
    assert [part.name for part in load_scenario("servicer_panel_stated").vehicle_data.moving] == ["left", "right"]


def test_a_part_that_vehicle_and_scenario_both_state_is_one() -> None:
    """Estimators and files take the vehicle of a scenario beside the scenario."""
    scenario = load_scenario("servicer_slosh_stated")
    both = scenario.model_copy(update={"vehicle": scenario.vehicle_data})
    assert [part.name for part in both.vehicle_data.moving] == ["tank"]
    assert resolve_scenario(both.model_dump(mode="json")).vehicle_data == scenario.vehicle_data
