"""The source distribution holds real files, and the wheel made of it the package as it stands here."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from conftest import LINKED, REPOSITORY, build, checkout

PACKAGE = REPOSITORY / "massprop_drake"
SHIPPED = (".py", ".yaml", ".sdf", ".html", ".css", ".js", ".txt", ".typed")


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
    assert {name.partition("/")[0] for name in names} & {"reproduction", "tests"} == set()


def test_the_wheel_made_of_it_is_the_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    assert sorted(held) == sorted(_expected())
    assert held == _expected()
    assert {"massprop_drake/diagrams/closed_loop.py", "massprop_drake/scenarios/sample_maneuver.yaml"} <= set(held)


def _as_text(link: Path) -> None:
    """A link as git leaves it where there are none, and some programs that unpack archives."""
    target = os.readlink(link)
    link.unlink()
    link.write_text(target, encoding="utf-8")


def _unlinked(folder: Path, way: str) -> Path:
    source = checkout(folder)
    for name in LINKED:
        link = source / "massprop_drake" / name
        _as_text(link) if way == "text" else link.unlink()
    return source


def _loading(*search: Path) -> subprocess.CompletedProcess[str]:
    """Loads a bundled scenario and a diagram in a process that finds the package in some folders alone."""
    program = (
        "import site, sys\n"
        "for folder in sys.argv[1:]: site.addsitedir(folder)\n"
        "from massprop_drake import load_scenario\n"
        "load_scenario('sample_maneuver')\n"
        "import massprop_drake.diagrams.closed_loop as loaded\n"
        "print(loaded.__file__)\n"
    )
    others = [path for path in sys.path if path.endswith("site-packages")]
    command = [sys.executable, "-S", "-c", program, *map(str, search)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(others)}
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=search[0], check=False)


@pytest.mark.parametrize("way", ["text", "nothing"])
def test_a_checkout_without_links_builds_the_whole_wheel(tmp_path: Path, way: str) -> None:
    (tmp_path / "checkout").mkdir()
    source = _unlinked(tmp_path / "checkout", way)
    with zipfile.ZipFile(build("wheel", source, tmp_path / "wheel")) as archive:
        held = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    assert sorted(held) == sorted(_expected())
    assert held == _expected()


def test_a_checkout_without_links_is_whole_once_it_is_installed_for_editing(tmp_path: Path) -> None:
    (tmp_path / "checkout").mkdir()
    source = _unlinked(tmp_path / "checkout", "text")
    bare = _loading(source)
    assert bare.returncode == 1
    assert "InputError: massprop_drake is not whole: 'massprop_drake.scenarios' is missing" in bare.stderr
    with zipfile.ZipFile(build("editable", source, tmp_path / "editable")) as archive:
        archive.extractall(tmp_path / "site")
    done = _loading(tmp_path / "site")
    assert done.stdout.strip() == str(source / "diagrams" / "closed_loop.py"), done.stderr


def test_a_checkout_that_lacks_a_folder_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "checkout").mkdir()
    source = checkout(tmp_path / "checkout")
    shutil.rmtree(source / "scenarios")
    with pytest.raises(subprocess.CalledProcessError) as caught:
        build("wheel", source, tmp_path / "built")
    (line,) = caught.value.stderr.splitlines()
    assert line == f"{source}: has no folder scenarios/, which massprop_drake needs; get the whole repository"
