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


def _held(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}


def test_the_source_distribution_holds_real_files(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        members = archive.getmembers()
    assert [member.name for member in members if not (member.isfile() or member.isdir())] == []
    names = {member.name.partition("/")[2] for member in members if member.isfile()}
    assert names >= {*_expected(), "pyproject.toml", "README.md", "LICENSE"}
    assert {name.partition("/")[0] for name in names} & {"reproduction", "tests"} == set()


def test_the_wheel_made_of_it_is_the_package(wheel: Path) -> None:
    held = _held(wheel)
    assert sorted(held) == sorted(_expected())
    assert held == _expected()
    assert {"massprop_drake/diagrams/closed_loop.py", "massprop_drake/scenarios/sample_maneuver.yaml"} <= set(held)


@pytest.fixture(scope="module")
def unlinked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout without links, as git leaves it where there are none, and as some unpackers do: a text, nothing."""
    source = checkout(tmp_path_factory.mktemp("checkout"))
    as_text, absent = (source / "massprop_drake" / name for name in LINKED)
    target = os.readlink(as_text)
    as_text.unlink()
    as_text.write_text(target, encoding="utf-8")
    absent.unlink()
    return source


def _loading(search: Path) -> subprocess.CompletedProcess[str]:
    """Loads a bundled scenario and a diagram in a process that finds the package in a folder alone."""
    program = (
        "import site, sys\n"
        "site.addsitedir(sys.argv[1])\n"
        "from massprop_drake import load_scenario\n"
        "load_scenario('sample_maneuver')\n"
        "import massprop_drake.diagrams.closed_loop as loaded\n"
        "print(loaded.__file__)\n"
    )
    others = [path for path in sys.path if path.endswith("site-packages")]
    command = [sys.executable, "-S", "-c", program, str(search)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(others)}
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=search, check=False)


def test_a_checkout_without_links_is_whole_once_it_is_built_or_installed_for_editing(
    unlinked: Path, tmp_path: Path
) -> None:
    bare = _loading(unlinked)
    assert bare.returncode == 1
    assert "InputError: massprop_drake is not whole: 'massprop_drake.scenarios' is missing" in bare.stderr
    with zipfile.ZipFile(build("editable", unlinked, tmp_path / "editable")) as archive:
        archive.extractall(tmp_path / "site")
    done = _loading(tmp_path / "site")
    assert done.stdout.strip() == str(unlinked / "diagrams" / "closed_loop.py"), done.stderr
    held = _held(build("wheel", unlinked, tmp_path / "wheel"))
    assert sorted(held) == sorted(_expected())
    assert held == _expected()


def test_a_checkout_that_lacks_a_folder_is_refused_in_a_line(unlinked: Path, tmp_path: Path) -> None:
    source = shutil.copytree(unlinked, tmp_path / "checkout", ignore=shutil.ignore_patterns("scenarios"))
    with pytest.raises(subprocess.CalledProcessError) as caught:
        build("wheel", source, tmp_path / "built")
    (line,) = caught.value.stderr.splitlines()
    assert line == f"{source}: has no folder scenarios/, which massprop_drake needs; get the whole repository"
