"""Kinds of input files: the bundled ones of each, and the message where one is given for another."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal

from massprop_drake.errors import InputError, suggestion

Kind = Literal["vehicle", "scenario", "campaign"]

KINDS: tuple[Kind, ...] = ("vehicle", "scenario", "campaign")
_PLACES: dict[Kind, tuple[str, ...]] = {
    "vehicle": ("vehicles",),
    "scenario": ("scenarios",),
    "campaign": ("scenarios", "campaigns"),
}
_OF_A_SCENARIO = {"maneuver", "jet_schedule", "failures", "jumps", "duration_s"}  # keys that no other kind has
_USES: dict[Kind, str] = {
    "vehicle": "a scenario flies it by its key 'vehicle', and 'massprop estimate --vehicle' takes it",
    "scenario": "'massprop run' takes it, and a campaign by its key 'base'",
    "campaign": "'massprop campaign run' takes it",
}


def bundled_files(kind: Kind) -> list[str]:
    """Lists the sorted names, without suffix, of the bundled files of a kind; raises InputError for no folder."""
    items = _bundled_folder(kind).iterdir()
    return sorted(item.name.removesuffix(".yaml") for item in items if item.name.endswith(".yaml"))


def bundled_text(kind: Kind, name: str) -> str:
    """Returns the YAML text of a bundled file."""
    return _bundled_folder(kind).joinpath(f"{name}.yaml").read_text(encoding="utf-8")


def _bundled_folder(kind: Kind) -> Traversable:
    """Returns the folder of the bundled files of a kind; raises InputError where the package lacks it."""
    package, *below = _PLACES[kind]
    try:
        return resources.files(f"massprop_drake.{package}").joinpath(*below)
    except ModuleNotFoundError as error:
        raise InputError(
            f"massprop_drake is not whole: '{error.name}' is missing, as in a checkout without symbolic links that is "
            "not installed; install it by 'pip install -e .' in the repository"
        ) from None


def file_kind(data: Mapping[str, Any]) -> Kind:
    """Returns the kind of an input file, vehicle, scenario or campaign, by the keys of its data."""
    if "jets" in data or "jet_kinds" in data:
        return "vehicle"
    return "campaign" if "base" in data else "scenario"


def describe_folder(path: Path) -> str | None:
    """Writes which commands take the folder of a run or campaign, as the end of a message; None: it is neither."""
    if (path / "plan.parquet").is_file():
        return f"is a campaign's folder; 'massprop campaign report {path}' and the like take it"
    if (path / "scenario.yaml").is_file():
        return f"is a run's folder; 'massprop run {path}', 'massprop report {path}' and the like take it"
    return None


def require_kind(data: Mapping[str, Any], expected: Kind, source: str) -> None:
    """Raises InputError where a file's data are plainly of another kind than expected."""
    kind = file_kind(data)
    if kind != expected and (kind != "scenario" or data.keys() & _OF_A_SCENARIO):
        raise InputError(f"{source}: is a {kind}, not a {expected}: {_USES[kind]}")


def require_known_name(name: str, expected: Kind) -> None:
    """Raises InputError for a name that is not bundled and, without suffix or folder, is no path of a file."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.parent != Path():
        return
    for kind in KINDS:
        if kind != expected and name in bundled_files(kind):
            raise InputError(f"'{name}' is a {kind}, not a {expected}: {_USES[kind]}")
    raise InputError(f"'{name}' is neither a bundled {expected} nor a file{suggestion(name, bundled_files(expected))}")
