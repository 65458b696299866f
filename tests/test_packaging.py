"""The source distribution holds real files, and the wheel made of it the package as it stands here."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from conftest import REPOSITORY

PACKAGE = REPOSITORY / "massprop_drake"
SHIPPED = (".py", ".yaml", ".html", ".css", ".js", ".typed")
LINKED = ("diagrams", "scenarios")
BUILD = "import sys, setuptools.build_meta as b; getattr(b, f'build_{sys.argv[1]}')(sys.argv[2])"


def _build(kind: str, source: Path, target: Path) -> Path:
    pytest.importorskip("setuptools", minversion="77")
    command = [sys.executable, "-W", "ignore", "-c", BUILD, kind, str(target)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (built,) = target.iterdir()
    return built


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, source)
    for name in ("massprop_drake", *LINKED):
        shutil.copytree(REPOSITORY / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    return _build("sdist", source, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(source, filter="data")
    (unpacked,) = source.iterdir()
    return _build("wheel", unpacked, tmp_path_factory.mktemp("wheel"))


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
