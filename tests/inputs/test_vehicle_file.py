"""Vehicles: bundled ones against the figures of their sources, and what follows from a file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from ruamel.yaml import YAML
from scipy.stats import chi2

from massprop_drake import load_scenario, load_vehicle, simulate
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles
from massprop_drake.inputs.vehicle_parts import MassPropertiesModel
from massprop_drake.inputs.yaml import Document, to_yaml
from massprop_drake.maths.mass_properties import is_possible_inertia, six_elements, symmetric_matrix

DATA = REPOSITORY / "tests" / "data"


def table(name: str, **where: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if where.items() <= row.items()]


def test_the_orbiter_has_the_jets_of_table_5_1(orbiter: Vehicle) -> None:
    stated = [
        (jet.number, jet.designation, jet.cluster, jet.kind, *jet.position, *jet.direction, jet.thrust, jet.mass_flow)
        for jet in orbiter.jets
    ]
    columns = ("x_ft", "y_ft", "z_ft", "dir_x", "dir_y", "dir_z", "thrust_lbf")
    expected = [
        (int(row["jet"]), row["designation"], int(row["cluster"]), row["kind"], *(float(row[key]) for key in columns))
        for row in table("table_5_1_rcs_jets.csv")
    ]
    assert len(stated) == 44
    assert stated == [(*row, None) for row in expected]


def test_the_orbiter_has_the_mass_properties_of_tables_5_2_and_5_3(orbiter: Vehicle) -> None:
    published = {row["quantity"]: float(row["value"]) for row in table("table_5_2_mass_properties.csv")}
    properties, elements = orbiter.mass_properties, ("11", "22", "33", "23", "13", "12")
    centers = [published[f"center_of_mass_{axis}"] for axis in (1, 2, 3)]
    assert (properties.mass, list(properties.center_of_mass)) == (published["mass"], centers)
    inertia = [published[f"inertia_{element}"] for element in elements]
    np.testing.assert_array_equal(six_elements(np.array(properties.inertia)), inertia)
    # eight digits are printed, but the inverses differ from those of the printed inertia in the seventh:
    # they bear the marks of single precision, whose rounding (2^-24) adds up over an inversion
    inverses = [published[f"inverse_inertia_{element}"] for element in elements]
    vector = orbiter.nominal.vector()
    np.testing.assert_allclose(vector, [*inverses, *centers, published["mass_reciprocal"]], rtol=2e-6, atol=0.0)
    inverse = symmetric_matrix(vector[:6])
    for row in table("table_5_3_estimates.csv"):
        what, _, place = row["parameter"].rpartition("_")
        if what == "inverse_inertia":
            value = inverse[int(place[0]) - 1, int(place[1]) - 1]
        else:
            value = vector[5 + int(place)] if what == "center_of_mass" else vector[9]
        mantissa, _, exponent = row["true"].partition("E")
        last_digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        # table 5-3 cuts 5.7047686e-11 to 5.7047: a whole unit of the last digit
        np.testing.assert_allclose(value, float(row["true"]), rtol=0.0, atol=last_digit)


def test_the_orbiter_has_the_sensors_of_section_5_2(orbiter: Vehicle) -> None:
    assert orbiter.sensor_names() == ["gyro", "acc1", "acc2", "acc3"]
    np.testing.assert_allclose(orbiter.gyros[0].quantum, math.radians(8.7e-5), rtol=1e-2)
    np.testing.assert_allclose(orbiter.gyros[0].variance, 1.52e-6**2 / 12.0, rtol=1e-14)  # of a uniform error
    for package in orbiter.accelerometers:
        np.testing.assert_allclose(package.quantum, 0.0105 / 0.3048, rtol=2e-3)  # 1.05 cm/s in ft/s
        assert package.noise_std == 0.0
    # left, middle and right of one another
    assert [package.position[1] for package in orbiter.accelerometers] == [-1.146, 0.0, 1.146]
    assert (orbiter.preferred_accelerometer, orbiter.units, orbiter.sample_period_s) == ("acc2", "us", 0.08)


OTHERS = ["small_satellite", "free_flyer", "lander"]


def content(vehicle: str) -> dict[str, Any]:
    """The file as it stands."""
    text = resources.files("massprop_drake.vehicles").joinpath(f"{vehicle}.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = YAML(typ="safe", pure=True).load(text)
    return found


def numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a file's content by its place; an entry of a list by its name, if it has one."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from numbers(part, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from numbers(part, f"{path}.{part.get('name', index) if isinstance(part, dict) else index}")
    elif isinstance(value, int | float):
        yield path, float(value)


@pytest.mark.parametrize("vehicle", ["orbiter", *OTHERS])
def test_every_figure_is_that_of_its_source(vehicle: str) -> None:
    stated = {key: value for key, value in content(vehicle).items() if key not in ("jets", "shape")}
    expected = {row["key"]: float(row["value"]) for row in table("vehicle_figures.csv", vehicle=vehicle)}
    assert dict(numbers(stated)) == expected


@pytest.mark.parametrize("vehicle", OTHERS)
def test_every_jet_is_where_and_what_its_source_says(vehicle: str) -> None:
    words, figures = ("number", "designation", "cluster", "kind"), ("x", "y", "z", "dir_x", "dir_y", "dir_z", "thrust")
    stated = [
        [*(str(jet[key]) for key in words), *map(float, (*jet["position"], *jet["direction"], jet["thrust"]))]
        for jet in content(vehicle)["jets"]
    ]
    rows = table("vehicle_jets.csv", vehicle=vehicle)
    assert stated == [[*(row[key] for key in words), *(float(row[key]) for key in figures)] for row in rows]


@pytest.mark.parametrize("name", bundled_vehicles())
def test_a_bundled_vehicle_is_sound_and_reads_back_equal(tmp_path: Path, name: str) -> None:
    vehicle = load_vehicle(name)
    assert (vehicle.name, vehicle.doubts) == (name, [])
    assert vehicle.description and vehicle.source  # noqa: PT018
    assert is_possible_inertia(vehicle.nominal.inertia)
    path = tmp_path / "again.yaml"
    path.write_text(yaml_text(vehicle), encoding="utf-8")
    assert load_vehicle(path) == vehicle
    assert Vehicle.model_validate(Document(to_yaml(content(name)), "again.yaml").data) == vehicle


@pytest.mark.parametrize("name", ["free_flyer", "lander", "small_satellite"])
def test_estimates_of_a_bundled_vehicle_are_as_good_as_they_claim(name: str) -> None:
    """Half its maneuver, with a seed that played no part in choosing it; the truth is well off the nominal values."""
    settings = ["seed=1983", "execution.engine=loop", "duration_s=30"]
    run = simulate(load_scenario(f"{name}_maneuver", settings), look_back=False)
    assert run["converged"][-1, 0] == 1.0
    assert (run["standard_deviation"][-1] < 0.5 * run["standard_deviation"][0]).all()  # all ten show
    error = run["estimate"][-1] - run["truth"][-1]
    scale = np.sqrt(run.covariance.diagonal())
    nees = float(error / scale @ np.linalg.solve(run.covariance / np.outer(scale, scale), error / scale))
    # far too small would be as wrong; 1e-3 either way
    assert chi2.ppf(1e-3, 10) < nees < chi2.ppf(1.0 - 1e-3, 10)
    assert (run.summary["detections"], run.summary["autopilot"]["lp_infeasible"]) == ([], 0)


def test_what_follows_from_the_orbiters_data(orbiter: Vehicle) -> None:
    assert orbiter.unit_names == {"length": "ft", "mass": "slug", "force": "lbf"}
    # thrust x direction / |direction|: jet F3L's direction is (-0.024, 1, 0.001)
    index = orbiter.jet_index("F3L")
    direction = np.array([-0.024, 1.0, 0.001])
    thrust = 870.553 * direction / np.linalg.norm(direction)
    np.testing.assert_allclose(orbiter.thrusts[index], thrust, rtol=1e-14)
    torque = np.cross([94.607, -5.971, 3.396], thrust)
    np.testing.assert_allclose(orbiter.wrenches[index], [*torque, *thrust], rtol=1e-13)
    # flow = nominal thrust / (g0 x specific impulse), plume impingement or not
    np.testing.assert_allclose(orbiter.mass_flows[index], 871.0 / (9.80665 / 0.3048 * 285.0), rtol=1e-12)
    with pytest.raises(KeyError):
        orbiter.jet_index("R9R")
    with pytest.raises(ValueError, match="frozen"):
        orbiter.sample_period_s = 0.1  # type: ignore[misc]


def test_what_follows_from_a_files_data(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    # twelve jets at distance 1 of the vehicle origin, center of mass moved by 2 along z: jets on the z axis at
    # distances 1 and 3 (two of each sign of force), the others at sqrt(5)
    toy_data["mass_properties"]["center_of_mass"] = [0.0, 0.0, 2.0]
    toy_data["jets"][3]["mass_flow"] = 0.125
    path = tmp_path / "toy.yaml"
    path.write_text(to_yaml(toy_data), encoding="utf-8")
    vehicle = load_vehicle(path)
    assert vehicle.designations == tuple(f"J{number}" for number in range(1, 13))
    np.testing.assert_allclose(vehicle.mass_flows, [10.0 / (9.80665 * 70.0)] * 3 + [0.125] + [10.0 / 686.4655] * 8)
    np.testing.assert_allclose(vehicle.rms_arm, math.sqrt((2 * 1.0 + 2 * 9.0 + 8 * 5.0) / 12.0), rtol=1e-14)
    assert vehicle.center_of_mass_floor == pytest.approx(0.1 * vehicle.rms_arm)
    assert Vehicle.model_validate({**toy_data, "center_of_mass_std": 0.25}).center_of_mass_floor == 0.25
    toy_data["jets"][0]["direction"] = [1.0015, 0.0, 0.0]  # a printed direction is made a unit vector
    np.testing.assert_allclose(Vehicle.model_validate(toy_data).thrusts[0], [10.0, 0.0, 0.0], rtol=1e-15)


points = arrays.arrays(float, (6, 3), elements=st.floats(-3.0, 3.0).filter(lambda x: x == 0.0 or abs(x) > 1e-3))


@settings(max_examples=25, derandomize=True, deadline=None, database=None)
@given(points=points)
def test_inertia_of_point_masses_is_accepted_and_beyond_the_triangle_refused(points: Any) -> None:
    second = points.T @ points + 1e-3 * np.eye(3)
    inertia = np.trace(second) * np.eye(3) - second
    model = MassPropertiesModel(mass=1.0, center_of_mass=(0.0, 0.0, 0.0), inertia=inertia.tolist())
    np.testing.assert_array_equal(model.properties().inertia, inertia)
    moments, axes = np.linalg.eigh(inertia)
    moments[2] = 1.001 * (moments[0] + moments[1])
    beyond = axes @ np.diag(moments) @ axes.T
    with pytest.raises(ValueError, match="exceeds the sum of the other two"):
        MassPropertiesModel(mass=1.0, center_of_mass=(0.0, 0.0, 0.0), inertia=(0.5 * (beyond + beyond.T)).tolist())
