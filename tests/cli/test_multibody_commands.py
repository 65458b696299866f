"""Commands on scenarios with a multibody model: checked with it, run, and run again from the folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from massprop_drake import load_scenario

SCENARIO = "vehicle: servicer\nduration_s: 1\nplant: {kind: multibody, model: m.sdf, body: bus}\n"
GOOD: str = load_scenario("servicer_slosh").plant.model  # type: ignore[union-attr]

POINT = (
    "<sdf version='1.9'><model name='m'><link name='bus'><inertial><mass>180</mass>"
    "<inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial></link></model></sdf>"
)
MIMIC = "<robot name='m'>" + "".join(
    f"<link name='{name}'><inertial><mass value='2'/>"
    "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    for name in ("bus", "one", "two")
)
for joint, child, more in (("j", "one", ""), ("k", "two", "<mimic joint='j'/>")):
    MIMIC += f"<joint name='{joint}' type='revolute'><parent link='bus'/><child link='{child}'/><axis xyz='0 0 1'/>"
    MIMIC += f"<limit effort='1' lower='-0.5' upper='1' velocity='1'/>{more}</joint>"
MIMIC += "</robot>"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a scenario and its model."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(SCENARIO)
    (tmp_path / "m.sdf").write_text(GOOD)
    return tmp_path


@pytest.mark.parametrize(
    ("model", "body", "message"),
    [
        (GOOD, "bus", None),
        (
            GOOD,
            "hull",
            "s.yaml: plant.body: 'hull' is no body of the MultibodyPlant; bodies are: bus, propellant, ring",
        ),
        (GOOD.replace("53.8", "-53.8"), "bus", "s.yaml: plant.model: Drake cannot read this SDF: A link named bus has"),
        (
            GOOD.replace(' version="1.9"', ""),
            "bus",
            "s.yaml, line 3: plant.model: m.sdf: has no version; begin with <sdf version='1.9'>",
        ),
        (POINT, "bus", "s.yaml: plant.model: Drake cannot move this model: An internal mass matrix associated with"),
        (MIMIC, "bus", "s.yaml: plant.model: has a constraint, such as <mimic>, which a continuous plant cannot keep"),
        ("no model", "bus", "s.yaml, line 3: plant.model: m.sdf: is neither SDF nor URDF: no XML, syntax error"),
        (None, "bus", "s.yaml, line 3: plant.model: 'm.sdf' is neither a bundled model nor the file m.sdf"),
    ],
)
def test_a_scenario_is_checked_with_its_model(
    massprop: Any, folder: Path, model: str | None, body: str, message: str | None
) -> None:
    (folder / "s.yaml").write_text(SCENARIO.replace("bus", body))
    (folder / "m.sdf").write_text(model or "")
    if model is None:
        (folder / "m.sdf").unlink()
    done = massprop("check", "s.yaml")
    assert done.status == (0 if message is None else 2)
    said = done.out + done.err
    assert len(said.strip().splitlines()) == 1
    assert ("s.yaml: ok" if message is None else message) in said


def test_a_run_goes_again_from_its_folder_without_the_model(massprop: Any, folder: Path) -> None:
    bare = ("--no-report", "--no-figures", "--quiet")
    assert massprop("run", "s.yaml", "--out", "first", *bare).status == 0
    (folder / "m.sdf").unlink()
    assert massprop("run", "first", "--out", "second", *bare).status == 0
    for name in ("telemetry.csv", "scenario.yaml"):
        assert (folder / "first" / name).read_bytes() == (folder / "second" / name).read_bytes()
    assert massprop("view", "second", "--out", "replay.html").status == 0
    assert "links" in (folder / "replay.html").read_text(encoding="utf-8")
