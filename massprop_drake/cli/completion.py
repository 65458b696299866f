"""Completion in a shell: bundled names, runs, and files."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

from massprop_drake.inputs.kinds import Kind, bundled_files


def make_completer(kind: Kind) -> Callable[[str], list[str]]:
    """Makes a shell completer: from a word's beginning to bundled names of a kind, files and folders."""

    def complete(incomplete: str) -> list[str]:
        """Lists bundled names, files and folders that begin with a word."""
        return [name for name in bundled_files(kind) if name.startswith(incomplete)] + _paths(
            incomplete, (".yaml", ".yml")
        )

    return complete


def complete_diagrams(incomplete: str) -> list[str]:
    """Lists bundled diagrams whose names begin with a word, without importing them, which would load Drake."""
    package = find_spec("massprop_drake.diagrams")
    names = [] if package is None else [found.name for found in iter_modules(package.submodule_search_locations)]
    return [name for name in names if name.startswith(incomplete) and not name.startswith("_")]


def complete_formats(incomplete: str) -> list[str]:
    """Lists the export formats that begin with a word."""
    return [name for name in ("mcap", "rerun") if name.startswith(incomplete)]


def complete_run_folders(incomplete: str) -> list[str]:
    """Lists folders of runs, here, in runs/ and in the folder of a word, that begin with the word."""
    beside = Path(incomplete or ".") if incomplete.endswith("/") or not incomplete else Path(incomplete).parent
    places = {beside, Path(), Path("runs")}
    found = {str(path.parent) for place in places for path in place.glob("*/summary.json")}
    return sorted(name for name in found if name.startswith(incomplete)) or _paths(incomplete, ())


def _paths(incomplete: str, endings: tuple[str, ...]) -> list[str]:
    """Lists folders, and files with one of these endings, whose paths begin with a word."""
    beside = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    if not beside.is_dir():
        return []
    found = []
    for path in sorted(beside.iterdir()):
        if path.is_dir() or path.suffix in endings:
            found.append(f"{path}/" if path.is_dir() else str(path))
    return [name for name in found if name.startswith(incomplete) and not Path(name).name.startswith(".")]
