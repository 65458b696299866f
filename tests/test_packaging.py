"""The source distribution holds real files, and the wheel made of it the package as it stands here."""

from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

from conftest import LINKED, REPOSITORY

PACKAGE = REPOSITORY / "massprop_drake"
SHIPPED = (".py", ".yaml", ".html", ".css", ".js", ".txt", ".typed")


def _expected() -> dict[str, bytes]:
    """The package's files: code, vehicles, scenarios, pages; what is beside them in linked folders stays out."""
    roots = [PACKAGE, *(PACKAGE / name for name in LINKED)]  # globbing does not follow links
    files = [path for root in roots for path in root.rglob("*") if path.suffix in SHIPPED]
    return {path.relative_to(REPOSITORY).as_posix(): path.read_bytes() for path in files}


def test_the_source_distribution_holds_real_files(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        members = archive.getmembers()
    assert [member.name for member in members if not (member.isfile() or member.isdir())] == []
    names = {member.name.partition("/")[2] for member in members if member.isfile()}
    assert names >= {*_expected(), "pyproject.toml", "README.md", "LICENSE"}


def test_the_wheel_made_of_it_is_the_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    assert sorted(held) == sorted(_expected())
    assert held == _expected()
    assert {"massprop_drake/diagrams/closed_loop.py", "massprop_drake/scenarios/sample_maneuver.yaml"} <= set(held)
