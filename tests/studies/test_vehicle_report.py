"""What `massprop check` says of a vehicle."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from massprop_drake import load_vehicle
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.studies.vehicle_report import DIRECTIONS, largest_accelerations, vehicle_report


def _vehicle(data: dict[str, Any]) -> Vehicle:
    return validate_data(Vehicle, data)


def _report(data: dict[str, Any], n_pairs: int = 5) -> dict[str, Any]:
    return vehicle_report(_vehicle(data), n_pairs)


def _jets(data: dict[str, Any], *jets: tuple[tuple[float, ...], tuple[float, ...]]) -> dict[str, Any]:
    """The data with jets of 10 N at these positions in these directions instead."""
    template = data["jets"][0]
    data["jets"] = [
        {**template, "number": n, "cluster": n, "designation": f"J{n}", "position": position, "direction": direction}
        for n, (position, direction) in enumerate(((list(p), list(d)) for p, d in jets), start=1)
    ]
    return data


ON_WHEELS = ("cubesat", "servicer_on_wheels")  # which the filters of the thesis do not take


@pytest.mark.parametrize("name", [name for name in bundled_vehicles() if name not in ON_WHEELS])
def test_every_bundled_vehicle_pushes_everywhere_and_shows_everything(name: str) -> None:
    vehicle = load_vehicle(name)
    report = vehicle_report(vehicle)
    planar = vehicle.motion == "planar"
    assert report["control"]["rank"] == (3 if planar else 6)
    assert planar or 1.0 <= report["control"]["condition"] < 10.0
    assert len(report["control"]["missing"]) == (6 if planar else 0)
    estimated = 4 if planar else 10
    assert report["observability"] == {"rank": estimated, "estimated": estimated, "unobservable": []}
    assert len(report["alike"]) == 5
    assert [entry["jet"] for entry in report["isolable"]] == list(vehicle.designations)
    json.dumps(report, allow_nan=False)


def test_reach_of_a_hand_value(toy_data: dict[str, Any]) -> None:
    """A 100 kg body, inertia diag(100, 120, 140), with two jets of 10 N in each direction of each axis."""
    toy_data["mass_properties"]["inertia"] = np.diag([100.0, 120.0, 140.0]).tolist()
    found = _report(toy_data)["control"]
    assert tuple(found["reach"]) == DIRECTIONS
    # along x push two jets, 1 m either side of the axis: 20 N
    # about z push one of them and one that pushes back on the other side: 20 N-m
    expected = [20.0 / 140.0, 20.0 / 100.0, 20.0 / 120.0]  # about z, x and y: jets along x, y and z
    for axis, rotation in zip("zxy", expected, strict=True):
        for sign in "+-":
            assert found["reach"][f"turn {sign}{axis}"] == pytest.approx(rotation, rel=1e-6)
            assert found["reach"][f"translate {sign}{axis}"] == pytest.approx(0.2, rel=1e-6)


def test_reach_agrees_with_another_solver() -> None:
    """HiGHS, both to the solvers' tolerances of 1e-7 and better in rows of a largest element 1."""
    vehicle = load_vehicle("orbiter")
    activity = activity_vectors(vehicle.wrenches, vehicle.nominal.vector())
    rows = activity / np.abs(activity).max(axis=1, keepdims=True)
    directions = [sign * axis for axis in np.eye(6) for sign in (1.0, -1.0)]
    for direction, found in zip(directions, largest_accelerations(activity), strict=True):
        least = linprog(-direction @ rows, A_eq=rows[direction == 0.0], b_eq=np.zeros(5), bounds=(0.0, 1.0))
        np.testing.assert_allclose(found, -least.fun * np.abs(activity[direction != 0.0]).max(), rtol=1e-6)


def test_without_accelerometer_the_mass_is_not_observable(toy_data: dict[str, Any]) -> None:
    toy_data["accelerometers"] = []
    report = _report(toy_data)
    assert report["observability"] == {"rank": 9, "estimated": 10, "unobservable": [{"m_inv": 1.0}]}
    assert "no accelerometer: the mass cannot be observed" in report["notes"]
    # all the torque of a jet is about one axis, so two about the same one are alike by the gyro
    assert report["alike"][0]["angle_rad"] == pytest.approx(0.0, abs=1e-12)
    assert len(report["isolable"]) == 12


def test_hardest_pairs_and_smallest_failures_of_a_hand_value(toy_data: dict[str, Any]) -> None:
    """Two parallel jets 0.02 m apart, and one against the first on its line."""
    toy_data["mass_properties"]["inertia"] = np.diag([100.0, 100.0, 100.0]).tolist()
    toy_data["accelerometers"][0]["position"] = [0.0, 0.0, 0.0]  # no transverse noise
    jets = [((0, 1.0, 0), (1, 0, 0)), ((0, 1.02, 0), (1, 0, 0)), ((0, 1.0, 0), (-1, 0, 0))]
    report = _report(_jets(toy_data, *jets), n_pairs=2)
    # per newton over 0.1 s: 1e-3 m/s, and -y 1e-3 rad/s about z; increments' noise q sqrt(2 / 12)
    velocity, rate = 1e-3 / (1e-3 / math.sqrt(6.0)), 1e-3 / (1e-6 / math.sqrt(6.0))
    seen = [(velocity, -rate), (velocity, -1.02 * rate), (-velocity, rate)]
    angle = math.atan2(1.02 * rate, velocity) - math.atan2(rate, velocity)
    assert [(pair["jets"], pair["opposed"]) for pair in report["alike"]] == [
        (["J1", "J3"], True),
        (["J1", "J2"], False),
    ]
    assert report["alike"][0]["angle_rad"] == 0.0
    assert report["alike"][1]["angle_rad"] == pytest.approx(angle, rel=1e-9)
    on = math.sqrt(6.0) / (math.hypot(*seen[0]) * math.sin(angle))
    first, second, third = report["isolable"]
    assert first["on"] == {"force": pytest.approx(on, rel=1e-9), "rival": "J2"}
    assert first["lost"] == {"force": None, "rival": "J3"}
    assert second["lost"] == {
        "force": pytest.approx(math.sqrt(6.0) / (math.hypot(*seen[1]) * math.sin(angle)), rel=1e-9),
        "rival": "J3",
    }
    assert third["on"] == {"force": pytest.approx(math.sqrt(6.0) / math.hypot(*seen[2]), rel=1e-9), "rival": None}
