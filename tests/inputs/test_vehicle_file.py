"""Vehicle files: the orbiter against its published tables, and what is wrong with a wrong file."""

from __future__ import annotations

import copy
import csv
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from numpy.typing import NDArray

from massprop_drake import InputError, load_vehicle
from massprop_drake.inputs.model import validated, yaml_text
from massprop_drake.inputs.vehicle_file import MassPropertiesModel, Vehicle, bundled_vehicles
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.maths.mass_properties import six_elements, symmetric

DATA = REPOSITORY / "tests" / "data"
DELETED = object()


def _table(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _half_last_digit(printed: str) -> float:
    """Half a unit in the last printed place of a number such as 6.7488400E+06."""
    mantissa, _, exponent = printed.partition("E")
    return 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def _published(quantity: str) -> float:
    """A number of table 5-2."""
    return next(float(row["value"]) for row in _table("table_5_2_mass_properties.csv") if row["quantity"] == quantity)


# ------------------------------------------------------------------------------------- the orbiter


def test_the_orbiter_has_the_jets_of_table_5_1(orbiter: Vehicle) -> None:
    table = _table("table_5_1_rcs_jets.csv")
    assert len(table) == len(orbiter.jets) == 44
    for row, jet in zip(table, orbiter.jets, strict=True):
        assert (jet.number, jet.designation, jet.cluster, jet.kind) == (
            int(row["jet"]),
            row["designation"],
            int(row["cluster"]),
            row["kind"],
        )
        assert jet.position == (float(row["x_ft"]), float(row["y_ft"]), float(row["z_ft"]))
        assert jet.direction == (float(row["dir_x"]), float(row["dir_y"]), float(row["dir_z"]))
        assert jet.thrust == float(row["thrust_lbf"])
        assert jet.mass_flow is None


def test_the_orbiter_has_the_mass_properties_of_table_5_2(orbiter: Vehicle) -> None:
    properties = orbiter.mass_properties
    assert properties.mass == _published("mass")
    assert properties.center_of_mass == tuple(_published(f"center_of_mass_{axis}") for axis in (1, 2, 3))
    published = [_published(f"inertia_{element}") for element in ("11", "22", "33", "23", "13", "12")]
    np.testing.assert_array_equal(six_elements(np.array(properties.inertia)), published)


def test_the_inverses_of_table_5_2_follow(orbiter: Vehicle) -> None:
    parameters = orbiter.nominal.vector()
    names = [f"inverse_inertia_{element}" for element in ("11", "22", "33", "23", "13", "12")]
    names += [f"center_of_mass_{axis}" for axis in (1, 2, 3)] + ["mass_reciprocal"]
    for value, name in zip(parameters, names, strict=True):
        # eight digits are printed, but the inverses differ from those of the printed inertia in the seventh:
        # they bear the marks of single precision, whose rounding (2^-24) adds up over an inversion
        tolerance = 0.0 if name.startswith("center") else 2e-6
        np.testing.assert_allclose(value, _published(name), rtol=tolerance, atol=0.0)


def test_the_true_values_of_table_5_3_are_those_of_table_5_2(orbiter: Vehicle) -> None:
    inverse = symmetric(orbiter.nominal.vector()[:6])
    center = orbiter.nominal.center_of_mass
    for row in _table("table_5_3_estimates.csv"):
        what, _, place = row["parameter"].rpartition("_")
        if what == "inverse_inertia":
            value = inverse[int(place[0]) - 1, int(place[1]) - 1]
        elif what == "center_of_mass":
            value = center[int(place) - 1]
        else:
            value = 1.0 / orbiter.nominal.mass
        # table 5-3 cuts 5.7047686e-11 to 5.7047: a whole unit of the last digit
        np.testing.assert_allclose(value, float(row["true"]), rtol=0.0, atol=2.0 * _half_last_digit(row["true"]))


def test_the_orbiter_has_the_sensors_of_section_5_2(orbiter: Vehicle) -> None:
    assert [gyro.name for gyro in orbiter.gyros] == ["gyro"]
    # 8.7e-5 deg/s
    np.testing.assert_allclose(orbiter.gyros[0].quantum, math.radians(8.7e-5), rtol=1e-2)
    assert [package.name for package in orbiter.accelerometers] == ["acc1", "acc2", "acc3"]
    for package in orbiter.accelerometers:
        np.testing.assert_allclose(package.quantum, 0.0105 / 0.3048, rtol=2e-3)  # 1.05 cm/s in ft/s
        assert package.noise_std == 0.0
    # left, middle and right of one another
    assert [package.position[1] for package in orbiter.accelerometers] == [-1.146, 0.0, 1.146]
    assert orbiter.preferred_accelerometer == "acc2"
    assert orbiter.sensor_names() == ["gyro", "acc1", "acc2", "acc3"]


def test_what_follows_from_the_orbiters_data(orbiter: Vehicle) -> None:
    assert orbiter.units == "us"
    assert orbiter.sample_period_s == 0.08
    assert orbiter.unit_names == {"length": "ft", "mass": "slug", "force": "lbf"}
    # thrust x direction / |direction|: jet F3L's direction is (-0.024, 1, 0.001)
    index = orbiter.jet_index("F3L")
    direction = np.array([-0.024, 1.0, 0.001])
    thrust = 870.553 * direction / np.linalg.norm(direction)
    np.testing.assert_allclose(orbiter.thrusts[index], thrust, rtol=1e-14)
    np.testing.assert_allclose(
        np.linalg.norm(orbiter.thrusts, axis=1), [jet.thrust for jet in orbiter.jets], rtol=1e-14
    )
    torque = np.cross([94.607, -5.971, 3.396], thrust)
    np.testing.assert_allclose(orbiter.wrenches[index], [*torque, *thrust], rtol=1e-13)
    # flow = nominal thrust / (g0 x specific impulse), plume impingement or not
    np.testing.assert_allclose(orbiter.mass_flows[index], 871.0 / (9.80665 / 0.3048 * 285.0), rtol=1e-12)
    np.testing.assert_allclose(
        orbiter.mass_flows[orbiter.jet_index("L5D")], 25.0 / (9.80665 / 0.3048 * 265.0), rtol=1e-12
    )
    # a gyro's quantization is uniform: variance quantum^2 / 12
    np.testing.assert_allclose(orbiter.gyros[0].variance, (1.52e-6) ** 2 / 12.0, rtol=1e-14)
    with pytest.raises(KeyError):
        orbiter.jet_index("R9R")


def test_the_root_mean_square_arm(toy_data: dict[str, Any]) -> None:
    # twelve jets at distance 1 of the vehicle origin, center of mass moved by 2 along z: jets on the z axis at
    # distances 1 and 3 (two of each sign of force), the others at sqrt(5)
    toy_data["mass_properties"]["center_of_mass"] = [0.0, 0.0, 2.0]
    vehicle = Vehicle.model_validate(toy_data)
    np.testing.assert_allclose(vehicle.rms_arm, math.sqrt((2 * 1.0 + 2 * 9.0 + 8 * 5.0) / 12.0), rtol=1e-14)
    assert vehicle.center_of_mass_floor == pytest.approx(0.1 * vehicle.rms_arm)
    stated = Vehicle.model_validate({**toy_data, "center_of_mass_std": 0.25})
    assert stated.center_of_mass_floor == 0.25


# --------------------------------------------------------------------------------------- good files


def _written(folder: Path, data: dict[str, Any]) -> Path:
    path = folder / "toy.yaml"
    path.write_text(to_yaml(data), encoding="utf-8")
    return path


def test_every_bundled_vehicle_loads_by_its_name() -> None:
    assert "orbiter" in bundled_vehicles()
    for name in bundled_vehicles():
        vehicle = load_vehicle(name)
        assert vehicle.name == name
        assert vehicle.description
        assert vehicle.source


def test_a_vehicle_is_read_from_a_file(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    vehicle = load_vehicle(_written(tmp_path, toy_data))
    assert vehicle.name == "toy"
    assert vehicle.designations == tuple(f"J{number}" for number in range(1, 13))
    assert vehicle.unit_names == {"length": "m", "mass": "kg", "force": "N"}
    np.testing.assert_allclose(vehicle.mass_flows, 10.0 / (9.80665 * 70.0), rtol=1e-14)


@pytest.mark.parametrize("name", bundled_vehicles())
def test_a_vehicle_written_out_reads_back_equal(tmp_path: Path, name: str) -> None:
    vehicle = load_vehicle(name)
    path = tmp_path / "again.yaml"
    path.write_text(yaml_text(vehicle), encoding="utf-8")
    assert load_vehicle(path) == vehicle


@pytest.mark.parametrize(
    ("text", "value"), [("1e-6", 1e-6), ("1.0e-6", 1e-6), ("2", 2.0), ("+.5", 0.5), ("1.", 1.0), ("3E+02", 300.0)]
)
def test_numbers_are_read_as_people_write_them(
    tmp_path: Path, toy_data: dict[str, Any], text: str, value: float
) -> None:
    toy_data["gyros"][0]["quantum"] = "PLACEHOLDER"
    path = _written(tmp_path, toy_data)
    path.write_text(path.read_text(encoding="utf-8").replace("PLACEHOLDER", text), encoding="utf-8")
    assert load_vehicle(path).gyros[0].quantum == value


def test_a_stated_mass_flow_is_taken(toy_data: dict[str, Any]) -> None:
    toy_data["jets"][3]["mass_flow"] = 0.125
    assert Vehicle.model_validate(toy_data).mass_flows[3] == 0.125


def test_a_printed_direction_is_made_a_unit_vector(toy_data: dict[str, Any]) -> None:
    toy_data["jets"][0]["direction"] = [1.0015, 0.0, 0.0]
    np.testing.assert_allclose(Vehicle.model_validate(toy_data).thrusts[0], [10.0, 0.0, 0.0], rtol=1e-15)


def test_a_vehicle_cannot_be_changed(orbiter: Vehicle) -> None:
    with pytest.raises(ValueError, match="frozen"):
        orbiter.sample_period_s = 0.1  # type: ignore[misc]


# ---------------------------------------------------------------------------------------- bad files


def _spoilt(data: dict[str, Any], path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    spoilt = copy.deepcopy(data)
    *inner, last = path
    here: Any = spoilt
    for part in inner:
        here = here[part]
    if value is DELETED:
        del here[last]
    elif isinstance(here, list) and last == len(here):
        here.append(value)
    else:
        here[last] = value
    return spoilt


def _diagonal(x: float, y: float, z: float) -> list[list[float]]:
    return [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]


INERTIA = ("mass_properties", "inertia")


@pytest.mark.parametrize(
    ("path", "value", "field", "words"),
    [
        pytest.param(
            ("jets", 1, "direction"),
            [0.0, 1.0, 0.5],
            "jets[1].direction",
            "length 1 within 0.002, got 1.118",
            id="direction",
        ),
        pytest.param(("jets", 0, "direction"), [0.0, 0.0, 0.0], "jets[0].direction", "length 1", id="no direction"),
        pytest.param(INERTIA, _diagonal(1.0, 1.0, 0.0), "mass_properties.inertia", "positive definite", id="singular"),
        pytest.param(INERTIA, _diagonal(-1.0, 1.0, 1.0), "mass_properties.inertia", "positive definite", id="negative"),
        pytest.param(
            INERTIA,
            _diagonal(1.0, 1.0, 2.1),
            "mass_properties.inertia",
            "exceeds the sum of the other two",
            id="triangle",
        ),
        pytest.param((*INERTIA, 0, 1), 5.0, "mass_properties.inertia", "must be symmetric", id="asymmetric"),
        pytest.param(
            (*INERTIA, 1, 1), math.nan, "mass_properties.inertia[1][1]", "finite number, got nan", id="NaN in inertia"
        ),
        pytest.param(("mass_properties", "mass"), math.nan, "mass_properties.mass", "finite number, got nan", id="NaN"),
        pytest.param(
            ("mass_properties", "mass"), math.inf, "mass_properties.mass", "finite number, got inf", id="infinite"
        ),
        pytest.param(("mass_properties", "mass"), 0.0, "mass_properties.mass", "greater than 0, got 0.0", id="no mass"),
        pytest.param(("jets", 2, "position"), [1.0, 0.0, 0.0, 0.0], "jets[2].position", "3", id="four coordinates"),
        pytest.param(("jets", 2, "position"), 1.0, "jets[2].position", "got 1.0", id="scalar"),
        pytest.param(
            ("jets", 0, "thrusts"), 1.0, "jets[0].thrusts", "unknown key; did you mean 'thrust'?", id="unknown"
        ),
        pytest.param(("color",), "red", "color", "unknown key; valid are: name, description", id="unknown at the top"),
        pytest.param(("jets", 3, "thrust"), DELETED, "jets[3].thrust", "missing", id="missing"),
        pytest.param(("units",), DELETED, "units", "missing", id="missing at the top"),
        pytest.param(
            ("jets", 4, "designation"), "J1", "jets", "designation 'J1' appears twice", id="designation twice"
        ),
        pytest.param(("jets", 4, "number"), 1, "jets", "number 1 appears twice", id="number twice"),
        pytest.param(("jets", 4, "kind"), "primry", "jets[4].kind", "did you mean 'primary'?", id="kind"),
        pytest.param(("jets", 4, "thrust"), -10.0, "jets[4].thrust", "greater than 0, got -10.0", id="thrust"),
        pytest.param(("jets", 4, "thrust"), "10", "jets[4].thrust", "valid number, got '10'", id="text for a number"),
        pytest.param(("jets", 4, "thrust"), True, "jets[4].thrust", "valid number, got True", id="flag for a number"),
        pytest.param(("jets", 4, "number"), 5.5, "jets[4].number", "integer, got 5.5", id="fraction for an integer"),
        pytest.param(("jets",), [], "jets", "at least 1", id="no jets"),
        pytest.param(
            ("preferred_accelerometer",), "ac", "preferred_accelerometer", "did you mean 'acc'?", id="preferred"
        ),
        pytest.param(("gyros", 0, "name"), "acc", "sensors", "name 'acc' appears twice", id="sensor twice"),
        pytest.param(("gyros", 0, "quantum"), 0.0, "gyros[0]", "cannot use a perfect sensor", id="perfect sensor"),
        pytest.param(("gyros", 0, "quantum"), -1.0, "gyros[0].quantum", "greater than or equal to 0", id="quantum"),
        pytest.param(("units",), "metric", "units", "'metric' is not one of 'us' or 'si'", id="units"),
        pytest.param(("sample_period_s",), 0.0, "sample_period_s", "greater than 0", id="period"),
        pytest.param(
            ("jet_kinds", "primary", "specific_impulse_s"),
            0.0,
            "jet_kinds.primary.specific_impulse_s",
            "greater than 0",
            id="impulse",
        ),
        pytest.param(
            ("jet_kinds", "primary", "time_constant_s"),
            -0.1,
            "jet_kinds.primary.time_constant_s",
            "greater than or equal to 0",
            id="lag",
        ),
    ],
)
def test_a_wrong_field_is_named_with_its_file(
    tmp_path: Path, toy_data: dict[str, Any], path: tuple[Any, ...], value: Any, field: str, words: str
) -> None:
    file = _written(tmp_path, _spoilt(toy_data, path, value))
    with pytest.raises(InputError) as caught:
        load_vehicle(file)
    problem = caught.value.problems[0]
    assert re.match(re.escape(str(file)) + r"(, line \d+)?: " + re.escape(field) + ": ", problem), problem
    assert words in problem.split(field, 1)[1]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "field", "words"),
    [
        pytest.param(("jets", 2, "position"), [1.0, 0.0], "jets[2].position", "3", id="two coordinates"),
        pytest.param(INERTIA, _diagonal(9.0, 9.0, 9.0)[:2], "mass_properties.inertia", "3", id="two rows"),
        pytest.param(("gyros", 0, "quantum"), 0.0, "gyros[0]", "perfect sensor", id="perfect sensor"),
    ],
)
def test_one_mistake_gives_one_message_that_fits(
    tmp_path: Path, toy_data: dict[str, Any], path: tuple[Any, ...], value: Any, field: str, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_vehicle(_written(tmp_path, _spoilt(toy_data, path, value)))
    assert len(caught.value.problems) == 1, caught.value.problems
    problem = caught.value.problems[0]
    assert "this field is required" not in problem  # it is there
    assert words in problem.split(field, 1)[1]


def test_the_line_is_that_of_the_field(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    toy_data["jets"][7]["thrust"] = -3.25
    file = _written(tmp_path, toy_data)
    line = next(n for n, text in enumerate(file.read_text(encoding="utf-8").splitlines(), 1) if "-3.25" in text)
    with pytest.raises(InputError, match=re.escape(f"{file}, line {line}: jets[7].thrust")):
        load_vehicle(file)


def test_several_mistakes_are_all_found(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    toy_data["jets"][7]["thrust"] = -3.25
    toy_data["color"] = "red"
    del toy_data["units"]
    with pytest.raises(InputError, match=r"\(and 2 more problems\)") as caught:
        load_vehicle(_written(tmp_path, toy_data))
    assert len(caught.value.problems) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: a\nunits: si\nname: b\n", r", line 3: name: the key appears twice, first in line 1"),
        (
            "jets:\n  - number: 1\n    number: 2\n",
            r", line 3: jets\[0\]\.number: the key appears twice, first in line 2",
        ),
        ("name: [a\nb: c\n", r": not valid YAML: .*line 2"),
        ("a:\n\t- b\n", r": not valid YAML: .*line 2"),
        ("a: \x07\n", r": not valid YAML: "),
        ("", r": the document is empty"),
        ("# nothing but a remark\n", r": the document is empty"),
        ("- a\n- b\n", r": the document is no mapping"),
        ("a: 1\n---\nb: 2\n", r": not valid YAML: .*document"),
        ("a: !!python/object:os.system 1\n", r": not valid YAML: "),
        ("? [a, b]\n: 1\n", r", line 1: a key must be a plain word"),
    ],
)
def test_what_is_no_good_yaml_is_named_with_its_file(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(str(file)) + words) as caught:
        load_vehicle(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["a: &x\n  b: *x\n", "a: " + 1000 * "[" + 1000 * "]" + "\n"], ids=["alias", "depth"])
def test_yaml_without_an_end_is_refused_like_other_bad_yaml(tmp_path: Path, text: str) -> None:
    file = tmp_path / "endless.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(str(file))):
        load_vehicle(file)


def test_a_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.yaml: no such file"):
        load_vehicle(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match="is a folder, and no run's"):
        load_vehicle(tmp_path)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: \xe9t\xe9\n")
    with pytest.raises(InputError, match=r"latin\.yaml: not a text file in UTF-8"):
        load_vehicle(latin)


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'orbitr' is neither a bundled vehicle nor a file; did you mean 'orbiter'\?"):
        load_vehicle("orbitr")
    with pytest.raises(InputError, match=r"valid are: .*orbiter"):
        load_vehicle("qqq")


def test_a_name_too_long_for_a_file_is_refused_like_any_other() -> None:
    with pytest.raises(InputError):
        load_vehicle("x" * 300)


def test_a_sensor_must_not_take_the_name_of_another_signal(toy_data: dict[str, Any]) -> None:
    """Its readings would replace that signal, or the diagram could not be built."""
    for name in ("rate", "time_s", "thrust", "estimate", "impulses", "rigid_body", "noise_source"):
        toy_data["gyros"][0]["name"] = name
        with pytest.raises(ValueError, match=name):
            Vehicle.model_validate(toy_data)


# --------------------------------------------------------------------------------- mass properties


def _random_inertia(rng: np.random.Generator) -> NDArray[np.float64]:
    """Of twenty random point masses: possible by construction."""
    points = rng.standard_normal((20, 3)) * rng.uniform(0.1, 3.0, 3)
    second = points.T @ points
    return np.trace(second) * np.eye(3) - second


def test_every_inertia_of_point_masses_is_accepted() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        inertia = _random_inertia(rng)
        model = MassPropertiesModel(mass=1.0, center_of_mass=(0.0, 0.0, 0.0), inertia=inertia.tolist())
        np.testing.assert_array_equal(model.properties().inertia, inertia)


def test_every_inertia_beyond_the_triangle_is_refused() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        moments, axes = np.linalg.eigh(_random_inertia(rng))
        moments[2] = 1.001 * (moments[0] + moments[1])
        inertia = axes @ np.diag(moments) @ axes.T
        inertia = 0.5 * (inertia + inertia.T)
        with pytest.raises(ValueError, match="exceeds the sum of the other two"):
            MassPropertiesModel(mass=1.0, center_of_mass=(0.0, 0.0, 0.0), inertia=inertia.tolist())


def test_a_vehicle_without_gyro_is_refused_with_a_reason(toy_data: dict[str, Any]) -> None:
    reason = "this field is required: without measured rates neither inertia nor center of mass can be estimated"
    with pytest.raises(InputError, match=f"gyros: is empty; {reason}"):
        validated(Vehicle, {**toy_data, "gyros": []})
    del toy_data["gyros"]
    with pytest.raises(InputError, match=f"gyros: missing; {reason}"):
        validated(Vehicle, toy_data)
