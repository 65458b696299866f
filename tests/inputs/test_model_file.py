"""Models of multibody plants as files: found, checked without Drake, and kept in the scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from massprop_drake import InputError, load_scenario
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.model_file import ModelJoint, bundled_models, model_joints, model_text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock

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
    bundled = scenario(tmp_path, "servicer_arm.sdf")
    assert isinstance(bundled.plant, MultibodyBlock)
    assert 'name="shoulder"' in bundled.plant.model
    assert "\n  model: |\n    <?xml" in yaml_text(bundled)  # in lines of its own
    assert bundled_models() == ["servicer_arm.sdf", "servicer_panel.sdf", "servicer_slosh.sdf"]
    with pytest.raises(
        InputError, match=r"line 5: plant\.model: 'b\.sdf' is neither a bundled model nor the file .*b\.sdf"
    ):
        scenario(tmp_path, "b.sdf")


def test_joints_are_named_with_what_they_have() -> None:
    text = sdf(ARM + joint("a") + joint("b", "prismatic") + joint("c", "ball") + joint("w", parent="world"))
    assert model_joints(text) == (ModelJoint("a", 1, "rad"), ModelJoint("b", 1, "{length}"), ModelJoint("c", 3, "rad"))
    assert ModelJoint("c", 3, "rad").columns == ("c_x", "c_y", "c_z")
    assert model_joints(sdf(ARM + joint("a") + joint("a") + joint("f", "fixed"))) == ()  # one name, two joints


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", r"m\.sdf: is neither SDF nor URDF: no XML, syntax error"),
        ("<html/>", r"is neither SDF nor URDF, whose first elements are <sdf> and <robot>: found <html>"),
        (sdf(inertial=""), r"link 'bus' has no <inertial>: every link needs its own mass and inertia"),
        (sdf(inertial=INERTIAL.replace("<izz>55</izz>", "")), r"link 'bus' has no <izz>"),
        (sdf(inertial=INERTIAL.replace("180", "0")), r"link 'bus': mass must be a positive number, got '0'"),
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
    assert model_text(URDF, tmp_path) == URDF  # which may name the world
