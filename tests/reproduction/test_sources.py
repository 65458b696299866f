"""Results are kept while the code that computes them stays as it is, whatever else is edited."""

from __future__ import annotations

import ast
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from conftest import REPOSITORY

from reproduction.sources import PACKAGE, code_digest, imported_files

SIMULATE = Path("runners/simulate.py")


@pytest.fixture(scope="module", autouse=True)
def _parsed_once() -> Iterator[None]:
    """Copies of the package are the same text but for an edit, and a text is parsed to the same tree."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ast, "parse", cache(ast.parse))
        yield


def _written(folder: Path, **modules: str) -> Path:
    """A package of modules by name, '__' for a dot."""
    package = folder / PACKAGE.name
    for name, text in modules.items():
        path = package / (name.replace("__", "/") + ".py")
        for parent in (path.parent, *path.parent.parents):
            if parent.is_relative_to(package):
                parent.mkdir(parents=True, exist_ok=True)
                (parent / "__init__.py").touch()
        path.write_text(text, encoding="utf-8")
    return package


def _names(files: set[Path], package: Path) -> set[str]:
    return {path.relative_to(package).as_posix() for path in files}


def test_imports_are_followed_to_the_end(tmp_path: Path) -> None:
    package = _written(
        tmp_path,
        runners__simulate="import numpy\nfrom massprop_drake.maths import filters, noise\n",
        maths__noise="def draw():\n    from massprop_drake.maths.seeds import seed\n    return seed\n",
        maths__seeds="import massprop_drake.maths.noise\nseed = 0\n",
        maths__filters__mass="",
        maths__unused="",
        display__page="",
    )
    assert _names(imported_files(package / SIMULATE, package=package), package) == {
        "__init__.py",
        "runners/simulate.py",
        "maths/__init__.py",
        "maths/filters/__init__.py",
        "maths/noise.py",
        "maths/seeds.py",
    }


def test_what_shows_results_and_what_is_for_types_is_passed_over(tmp_path: Path) -> None:
    text = """
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from massprop_drake.studies import vehicle
def show():
    from massprop_drake.display import page
"""
    package = _written(tmp_path, runners__simulate=text, studies__vehicle="", display__page="")
    assert _names(imported_files(package / SIMULATE, package=package), package) == {"runners/simulate.py"}


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package, to be edited."""
    ignored = shutil.ignore_patterns("__pycache__", "*.yaml", "graphs")
    return shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=ignored)


def _digest(package: Path) -> str:
    code_digest.cache_clear()
    return code_digest(package / SIMULATE, package=package)


def test_an_edit_of_what_computes_a_flight_changes_its_key(copied: Path) -> None:
    counted = {copied / name for name in ("maths/noise.py", "diagrams/closed_loop.py", "inputs/params.py")}
    assert counted <= imported_files(copied / SIMULATE, package=copied)
    before = _digest(copied)
    with (copied / "systems/vehicle/rate_gyro.py").open("a", encoding="utf-8") as file:
        file.write("# edited\n")
    assert _digest(copied) != before


def test_an_edit_of_what_shows_it_does_not(copied: Path) -> None:
    before = _digest(copied)
    for room in ("display", "cli", "studies"):
        for path in (copied / room).rglob("*.py"):
            path.write_text("# edited\n", encoding="utf-8")
    assert _digest(copied) == before


def test_the_key_is_that_of_the_code_wherever_it_lies(copied: Path) -> None:
    assert _digest(copied) == code_digest(PACKAGE / SIMULATE)


def test_no_module_is_imported_by_a_name_that_cannot_be_followed() -> None:
    # but for the names of packages, loaded when they are first used
    lazy = {PACKAGE / name for name in ("__init__.py", "inputs/renamed.py", "systems/__init__.py")}
    for path in imported_files(PACKAGE / SIMULATE) - lazy:
        assert "import_module" not in path.read_text(encoding="utf-8"), path
        assert "__import__" not in path.read_text(encoding="utf-8"), path


def test_a_module_outside_the_package_counts_with_what_it_imports(tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text("from massprop_drake.maths.attitude import conjugate\n", encoding="utf-8")
    assert imported_files(mine) == {
        mine,
        *(PACKAGE / name for name in ("__init__.py", "maths/__init__.py", "maths/attitude.py")),
        *(imported_files(PACKAGE / "maths" / "attitude.py")),
    }
    before = code_digest(mine)
    mine.write_text("from massprop_drake.maths.attitude import conjugate  # edited\n", encoding="utf-8")
    code_digest.cache_clear()
    assert code_digest(mine) != before


def test_a_calculation_counts_with_what_it_imports_of_both_packages() -> None:
    here = REPOSITORY / "reproduction"
    found = imported_files(here / "checks.py")
    assert {here / name for name in ("__init__.py", "checks.py", "analytic.py", "measures.py")} <= found
    assert PACKAGE / "maths" / "vehicle" / "rigid_body.py" in found
    assert not {here / name for name in ("report.py", "catalog.py", "entry.py")} & found
