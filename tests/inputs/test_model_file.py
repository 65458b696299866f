"""Models of multibody plants as files: found, checked without Drake, and kept in the scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from massprop_drake import InputError, load_scenario
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.model_file import ModelJoint, bundled_models, model_joints, model_text
from massprop_drake.inputs.scenario import MultibodyBlock, Scenario

INERTIAL = "<inertial><mass>180</mass><inertia><ixx>50</ixx><iyy>26</iyy><izz>55</izz></inertia></inertial>"
ARM = f"<link name='arm'>{INERTIAL}</link>"


def joint(name: str = "j", kind: str = "revolute", parent: str = "bus") -> str:
    return f"<joint name='{name}' type='{kind}'><parent>{parent}</parent><child>arm</child></joint>"


def sdf(more: str = "", inertial: str = INERTIAL) -> str:
    return f"<sdf version='1.9'><model name='m'><link name='bus'>{inertial}</link>{more}</model></sdf>"


URDF = (
    "<robot name='m'><link name='world'/><link name='bus'><inertial><mass value='180'/>"
    "<inertia ixx='50' iyy='26' izz='55' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>"
)


def scenario(folder: Path, model: str = "a.sdf", **plant: Any) -> Scenario:
    """A scenario in a folder, whose file names a model beside it."""
    keys = {"kind": "multibody", "model": model, "body": "bus", **plant}
    lines = [f"  {key}: {value}" for key, value in keys.items()]
    (folder / "s.yaml").write_text("\n".join(["vehicle: servicer", "duration_s: 2", "plant:", *lines, ""]))
    return load_scenario(folder / "s.yaml")


def test_a_model_is_found_beside_its_scenario_or_by_name_and_kept_as_text(tmp_path: Path) -> None:
    (tmp_path / "a.sdf").write_text(sdf(ARM + joint()))
    found = scenario(tmp_path)
    assert isinstance(found.plant, MultibodyBlock)
    assert found.plant.model == sdf(ARM + joint()) + "\n"
    assert found.plant.joint_columns == ("j",)
    (tmp_path / "a.sdf").unlink()
    (tmp_path / "again.yaml").write_text(yaml_text(found))
    assert load_scenario(tmp_path / "again.yaml") == found
    bundled = scenario(tmp_path, "servicer_arm.sdf").plant
    assert isinstance(bundled, MultibodyBlock)
    assert 'name="shoulder"' in bundled.model


def test_the_text_stands_in_lines_of_its_own(tmp_path: Path) -> None:
    written = yaml_text(scenario(tmp_path, "servicer_arm.sdf"))
    assert "\n  model: |\n    <?xml" in written


def test_bundled_models_are_listed() -> None:
    assert bundled_models() == ["servicer_arm.sdf", "servicer_panel.sdf", "servicer_slosh.sdf"]


def test_joints_are_named_with_what_they_have() -> None:
    text = sdf(ARM + joint("a") + joint("b", "prismatic") + joint("c", "ball") + joint("w", parent="world"))
    assert model_joints(text) == (ModelJoint("a", 1, "rad"), ModelJoint("b", 1, "{length}"), ModelJoint("c", 3, "rad"))
    assert ModelJoint("c", 3, "rad").columns == ("c_x", "c_y", "c_z")
    assert model_joints(sdf(ARM + joint("a") + joint("a") + joint("f", "fixed"))) == ()  # one name, two joints


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", r"m\.sdf: is neither SDF nor URDF: no XML, syntax error"),
        ("", r"m\.sdf: is neither SDF nor URDF: no XML, no element found"),
        ("<html/>", r"is neither SDF nor URDF, whose first elements are <sdf> and <robot>: found <html>"),
        (sdf(inertial=""), r"link 'bus' has no <inertial>: every link needs its own mass and inertia"),
        (sdf(inertial=INERTIAL.replace("mass", "was")), r"link 'bus' has no <mass>"),
        (sdf(inertial=INERTIAL.replace("<izz>55</izz>", "")), r"link 'bus' has no <izz>"),
        (sdf(inertial=INERTIAL.replace("180", "0")), r"link 'bus': mass must be a positive number, got '0'"),
        (sdf(inertial=INERTIAL.replace("180", "x")), r"link 'bus': mass must be a positive number, got 'x'"),
        (URDF.replace("<link name='world'/>", "<link name='tip'/>"), r"link 'tip' has no <inertial>"),
        (sdf(f"<!--{'x' * 600_000}-->"), r"m\.sdf: has 600\d{3} characters; a run keeps a model of at most 500000"),
        (sdf("<include><uri>a</uri></include>"), r"has <include>, but a run keeps the model's text alone"),
        (sdf("<visual><geometry><mesh/></geometry></visual>"), r"has <mesh>, but a run keeps the model's text alone"),
    ],
)
def test_what_is_no_model_of_a_vehicle_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.sdf").write_text(text)
    with pytest.raises(InputError, match=message):
        model_text("m.sdf", tmp_path)


def test_a_urdf_may_name_the_world(tmp_path: Path) -> None:
    assert model_text(URDF, tmp_path) == URDF


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"model": "b.sdf"},
            r"s\.yaml, line 5: plant\.model: 'b\.sdf' is neither a bundled model nor the file .*b\.sdf",
        ),
        ({"depletion": "false"}, r"plant\.depletion: is a key of kind: rigid, and the kind is multibody"),
        ({"time_step": "0"}, r"plant\.time_step: is a key of kind: rigid, and the kind is multibody"),
        ({"moves": "[{joint: j, start_s: 1, end_s: 1, position: 0}]"}, r"end_s must be later than start_s, got 1 to 1"),
        (
            {"moves": "[{joint: j, start_s: 1, end_s: 3, position: 0}, {joint: j, start_s: 2, end_s: 4, position: 0}]"},
            r"plant\.moves\[1\]: overlaps moves\[0\] on the same axis, jet or joint \(j\): 2 to 4 s and 1 to 3 s",
        ),
        ({"joints": "[{joint: j}, {joint: j}]"}, r"plant\.joints\[1\]\.joint: 'j' has an entry already; give one"),
    ],
)
def test_a_wrong_key_is_named_with_its_line(tmp_path: Path, keys: dict[str, str], message: str) -> None:
    (tmp_path / "a.sdf").write_text(sdf())
    with pytest.raises(InputError, match=message):
        scenario(tmp_path, **keys)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["execution.engine=loop"], r"loop does not cover a continuous plant, whose steps are Drake's; use diagram"),
        (
            ["jumps=[{kind: dock, time_s: 1, mass: 2, position: [0, 0, 0]}]"],
            r"jumps: a multibody plant knows no payload that leaves or comes",
        ),
        (["plant.mass_properties=null"], r"plant\.mass_properties: is a key of kind: rigid"),
        (["plant.kind=rigid"], None),
    ],
)
def test_what_does_not_go_with_the_kind_is_refused(overrides: list[str], message: str | None) -> None:
    if message is None:
        assert load_scenario("servicer_slosh", overrides).plant.kind == "rigid"
        return
    with pytest.raises(InputError, match=message):
        load_scenario("servicer_slosh", overrides)


def test_keys_of_a_multibody_plant_mean_nothing_to_a_rigid_one() -> None:
    with pytest.raises(InputError, match=r"plant\.model: is a key of kind: multibody, and the kind is rigid"):
        load_scenario("sample_maneuver", ["plant.model=servicer_arm.sdf"])
