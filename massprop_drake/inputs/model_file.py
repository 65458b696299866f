"""Multibody models, SDF or URDF: found, read as text, and checked as far as that goes without Drake."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.yaml import exists, read_text

_SUFFIXES = (".sdf", ".urdf")
_NEEDED = {"sdf": ("mass", "inertia/ixx", "inertia/iyy", "inertia/izz"), "robot": ("mass", "inertia")}
_ELSEWHERE = {"mesh": "draw it with boxes, cylinders and the like", "include": "put the other model's text in"}


def bundled_models() -> list[str]:
    """Lists the models that come with the package."""
    folder = resources.files("massprop_drake.scenarios").joinpath("models")
    return sorted(item.name for item in folder.iterdir() if item.name.endswith(_SUFFIXES))


def model_text(model: str, folder: Path) -> str:
    """The text of a model.

    Args:
        model: the text itself, the name of a bundled one, or a file.
        folder: what the file is relative to.

    Raises:
        InputError: when there is none, or it is no model that could be a vehicle.
    """
    if model.lstrip().startswith("<"):
        require_model(model, "")
        return model
    beside = Path(os.path.normpath(folder / model))
    if exists(beside):
        text = read_text(beside)
    elif model in bundled_models():
        text = resources.files("massprop_drake.scenarios").joinpath("models", model).read_text(encoding="utf-8")
    else:
        known = bundled_models()
        raise InputError(f"'{model}' is neither a bundled model nor the file {beside}{suggestion(model, known)}")
    require_model(text, f"{model}: ")
    return text.strip() + "\n"


def require_model(text: str, where: str) -> None:
    """Makes sure that a text is SDF or URDF whose links all have mass and inertia, and that it is complete.

    Args:
        text: of the model.
        where: begins the message.

    Raises:
        InputError: when it is not.
    """
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        raise InputError(f"{where}is neither SDF nor URDF: no XML, {error}") from None
    if root.tag not in _NEEDED:
        raise InputError(
            f"{where}is neither SDF nor URDF, whose first elements are <sdf> and <robot>: found <{root.tag}>"
        )
    for tag, remedy in _ELSEWHERE.items():
        if root.find(f".//{tag}") is not None:
            raise InputError(f"{where}has <{tag}>, but a run keeps the model's text alone; {remedy}")
    for link in root.iter("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if root.tag == "robot" and name == "world":
            continue
        missing = (
            "inertial" if inertial is None else next((n for n in _NEEDED[root.tag] if inertial.find(n) is None), "")
        )
        if missing:
            raise InputError(
                f"{where}link '{name}' has no <{missing.rpartition('/')[2]}>: every link needs its own mass and inertia"
            )


@contextlib.contextmanager
def blamed(field: str) -> Iterator[None]:
    """Turns an error of a system into one that names the field of the scenario in which the reason lies."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"scenario: {field}: {error}") from None
