"""Multibody models, SDF or URDF: found, read as text, and checked as far as that goes without Drake."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.yaml import exists, read_text

_MOST_LETTERS = 500_000  # half of what a scenario's file may have
_SUFFIXES = (".sdf", ".urdf")
_NEEDED = {"sdf": ("mass", "inertia/ixx", "inertia/iyy", "inertia/izz"), "robot": ("mass", "inertia")}
_POSITIONS = {
    **dict.fromkeys(("revolute", "continuous"), (1, "rad")),
    **{"prismatic": (1, "{length}"), "universal": (2, "rad"), "ball": (3, "rad")},
}
_ELSEWHERE = {"mesh": "draw it with boxes, cylinders and the like", "include": "put the other model's text in"}


def bundled_models() -> list[str]:
    """Lists the file names of the bundled multibody models, SDF and URDF, sorted."""
    folder = resources.files("massprop_drake.scenarios").joinpath("models")
    return sorted(item.name for item in folder.iterdir() if item.name.endswith(_SUFFIXES))


def model_text(model: str, folder: Path) -> str:
    """Returns the checked SDF or URDF text of a multibody model.

    Args:
        model: the text itself, the name of a bundled one, or a file.
        folder: what the file is relative to.

    Raises:
        InputError: when there is none, or it is no model that could be a vehicle.
    """
    if model.lstrip().startswith("<"):
        require_model(model, "")
        return model
    path = Path(os.path.normpath(folder / model))
    if exists(path):
        text = read_text(path).removeprefix("\ufeff")  # a byte order mark
    elif model in bundled_models():
        text = resources.files("massprop_drake.scenarios").joinpath("models", model).read_text(encoding="utf-8")
    else:
        known = bundled_models()
        raise InputError(f"'{model}' is neither a bundled model nor the file {path}{suggestion(model, known)}")
    require_model(text, f"{model}: ")
    return text.strip() + "\n"


def model_kind(text: str) -> Literal["sdf", "urdf"]:
    """Returns the format of a model's text, "sdf" or "urdf", by its first element."""
    return "urdf" if ElementTree.fromstring(text.strip()).tag == "robot" else "sdf"


class ModelJoint(NamedTuple):
    """A joint between two links of a model.

    Attributes:
        name: of the joint.
        positions: numbers that say how it stands.
        unit: of these, with {length} for the vehicle's.
    """

    name: str
    positions: int
    unit: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the joint's positions: that of the joint, with an axis where there are several."""
        return (self.name,) if self.positions == 1 else tuple(f"{self.name}_{axis}" for axis in "xyz"[: self.positions])


def model_joints(text: str) -> tuple[ModelJoint, ...]:
    """Lists the movable joints in a model's SDF or URDF text, in its order, without those of the same name."""
    joints = [
        ModelJoint(str(joint.get("name")), *_POSITIONS[kind])
        for joint in ElementTree.fromstring(text.strip()).iter("joint")
        if (kind := str(joint.get("type"))) in _POSITIONS and _parent_link(joint) != "world"
    ]
    names = [joint.name for joint in joints]
    return tuple(joint for joint in joints if names.count(joint.name) == 1)


def _parent_link(joint: ElementTree.Element) -> str:
    """Returns the name of a joint's parent link, an attribute in URDF, a text in SDF; empty if there is none."""
    parent = joint.find("parent")
    return "" if parent is None else parent.get("link", (parent.text or "").strip())


def require_model(text: str, label: str) -> None:
    """Raises InputError unless a text is complete SDF or URDF whose links all have mass and inertia."""
    if len(text) > _MOST_LETTERS:
        raise InputError(f"{label}has {len(text)} characters; a run keeps a model of at most {_MOST_LETTERS}")
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        raise InputError(f"{label}is neither SDF nor URDF: no XML, {error}") from None
    if root.tag not in _NEEDED:
        raise InputError(
            f"{label}is neither SDF nor URDF, whose first elements are <sdf> and <robot>: found <{root.tag}>"
        )
    if root.tag == "sdf" and not root.get("version"):
        raise InputError(f"{label}has no version; begin with <sdf version='1.9'>")
    for tag, remedy in _ELSEWHERE.items():
        if root.find(f".//{tag}") is not None:
            raise InputError(f"{label}has <{tag}>, but a run keeps the model's text alone; {remedy}")
    for link in root.iter("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if root.tag == "robot" and name == "world":
            continue
        missing = (
            "inertial" if inertial is None else next((n for n in _NEEDED[root.tag] if inertial.find(n) is None), "")
        )
        if missing:
            raise InputError(
                f"{label}link '{name}' has no <{missing.rpartition('/')[2]}>: every link needs its own mass and inertia"
            )
        mass = inertial.find("mass") if inertial is not None else None
        given = "" if mass is None else mass.get("value", mass.text or "").strip()
        if not _is_positive(given):
            raise InputError(f"{label}link '{name}': mass must be a positive number, got '{given}'")


def _is_positive(number: str) -> bool:
    """Tests whether a text is a finite number above zero."""
    try:
        return 0.0 < float(number) < math.inf
    except ValueError:
        return False


@contextlib.contextmanager
def attribute_errors_to(field: str) -> Iterator[None]:
    """Converts a ValueError within the context to an InputError that names a field of the scenario."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"scenario: {field}: {error}") from None
