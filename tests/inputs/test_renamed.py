"""Names of version 0.1: accepted with one warning that says what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_probe import Massprop

from massprop_drake import InputError, load_scenario, load_vehicle
from massprop_drake.inputs.renamed import RenamedWarning

DATA = Path(__file__).parents[1] / "data"
LANDED = DATA / "landed_0_1"


def test_old_keys_of_a_vehicle_are_read_with_one_warning() -> None:
    with pytest.warns(RenamedWarning) as caught:
        vehicle = load_vehicle(LANDED / "cube.yaml")
    assert [solid.color for solid in vehicle.shape] == ["#c2503c", "#5b6470"]
    assert [str(warning.message) for warning in caught] == [
        f"{LANDED / 'cube.yaml'}: colour is now color; version 0.4 will know the new name alone"
    ]


def test_each_file_with_old_keys_has_its_warning() -> None:
    with pytest.warns(RenamedWarning) as caught:
        scenario = load_scenario(LANDED / "turned_cube.yaml")
    assert scenario.sensors.quantizer_phase == "equal"
    said = [str(warning.message) for warning in caught]
    assert [message.partition(": ")[0] for message in said] == [
        str(LANDED / "turned_cube.yaml"),
        str(LANDED / "cube.yaml"),
    ]
    assert "quantiser_phase is now quantizer_phase" in said[0]


def test_a_vehicle_inside_a_scenario_is_named_in_the_same_warning() -> None:
    with pytest.warns(RenamedWarning) as caught:
        scenario = load_scenario(LANDED / "run")
    assert scenario.vehicle_data.shape[0].color == "#c2503c"
    (warning,) = caught
    assert "colour is now color, quantiser_phase is now quantizer_phase" in str(warning.message)


@pytest.mark.parametrize("override", ["sensors.quantiser_phase=equal", "sensors={quantiser_phase: equal}"])
def test_old_keys_in_an_override_are_taken_with_a_warning(override: str) -> None:
    with pytest.warns(RenamedWarning, match=r"--set sensors.*: quantiser_phase is now quantizer_phase") as caught:
        scenario = load_scenario("sample_maneuver", ["sensors.quantizer_phase=seeded", override])
    assert scenario.sensors.quantizer_phase == "equal"
    assert len(caught) == 1


def test_an_old_key_beside_the_new_one_is_given_twice(tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("sensors:\n  quantiser_phase: equal\n  quantizer_phase: equal\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 3: sensors\.quantizer_phase: the key appears twice, first in line 2"):
        load_scenario(path)


def test_a_bad_value_under_an_old_key_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("name: bad\nsensors:\n  gyro: null\n  quantiser_phase: other\n", encoding="utf-8")
    with pytest.warns(RenamedWarning), pytest.raises(InputError, match=r"line 4: sensors\.quantizer_phase: 'other'"):
        load_scenario(path)


def test_an_old_word_elsewhere_is_no_old_key(tmp_path: Path) -> None:
    path = tmp_path / "elsewhere.yaml"
    path.write_text("colour: red\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 1: colour: unknown key"):
        load_scenario(path)


def test_the_command_line_says_it_in_a_line(massprop: Massprop) -> None:
    done = massprop("check", LANDED / "turned_cube.yaml", LANDED / "cube.yaml", "--json")
    assert done.status == 0
    assert [line.partition(": ")[0] for line in done.err.splitlines()] == ["massprop", "massprop"]
    assert "cube.yaml: colour is now color; version 0.4 will know the new name alone" in done.err
