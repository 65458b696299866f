"""Results are kept while the code that computes them stays as it is, whatever else is edited."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from conftest import REPOSITORY

from reproduction.sources import PACKAGE, code_digest, imported_files

SIMULATE = Path("runners/simulate.py")


SHOW = """
from typing import TYPE_CHECKING
import numpy
from massprop_drake.maths import filters, noise
if TYPE_CHECKING:
    from massprop_drake.studies import vehicle
def show():
    from massprop_drake.display import page
"""
MODULES = {
    SIMULATE: SHOW,
    Path("maths/noise.py"): "def draw():\n    from massprop_drake.maths.seeds import seed\n    return seed\n",
    Path("maths/seeds.py"): "import massprop_drake.maths.noise\nseed = 0\n",
    **{
        Path(name): "" for name in ("maths/filters/mass.py", "maths/unused.py", "display/page.py", "studies/vehicle.py")
    },
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of these modules."""
    package = tmp_path / PACKAGE.name
    for name, text in MODULES.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        for folder in (package / name).parents[: len(name.parents)]:
            (folder / "__init__.py").touch()
        (package / name).write_text(text, encoding="utf-8")
    return package


def test_imports_are_followed_to_the_end(package: Path) -> None:
    found = imported_files(package / SIMULATE, package=package)
    assert {path.relative_to(package).as_posix() for path in found} == {
        *("__init__.py", "runners/simulate.py", "maths/__init__.py", "maths/filters/__init__.py"),
        *("maths/noise.py", "maths/seeds.py"),
    }


def test_an_edit_of_what_computes_a_flight_changes_its_key_and_of_what_shows_it_does_not(package: Path) -> None:
    def digest(of: Path) -> str:
        code_digest.cache_clear()
        return code_digest(of / SIMULATE, package=of)

    before = digest(package)
    assert before == digest(shutil.copytree(package, package.parent / "elsewhere" / package.name))
    for edited, changes in (("display/page.py", False), ("maths/unused.py", False), ("maths/seeds.py", True)):
        with (package / edited).open("a", encoding="utf-8") as file:
            file.write("# edited\n")
        assert (digest(package) != before) == changes


def test_what_a_flight_runs_is_found_and_nothing_is_imported_by_a_name_that_cannot_be_followed() -> None:
    # but for the names of packages, loaded when they are first used, and kernels, all of which a compiler must know
    lazy = {PACKAGE / name for name in ("__init__.py", "inputs/renamed.py", "systems/__init__.py", "maths/kernels.py")}
    found = imported_files(PACKAGE / SIMULATE)
    counted = ("maths/noise.py", "diagrams/closed_loop.py", "inputs/params.py", "systems/vehicle/rate_gyro.py")
    assert {PACKAGE / name for name in counted} <= found
    assert {path.relative_to(PACKAGE).parts[0] for path in found} & {"display", "cli", "studies"} == set()
    for path in found - lazy:
        assert "import_module" not in path.read_text(encoding="utf-8"), path
        assert "__import__" not in path.read_text(encoding="utf-8"), path


def test_a_calculation_counts_with_what_it_imports_of_both_packages(tmp_path: Path) -> None:
    here = REPOSITORY / "reproduction"
    found = imported_files(here / "checks.py")
    assert {here / name for name in ("__init__.py", "checks.py", "analytic.py", "measures.py")} <= found
    assert PACKAGE / "maths" / "vehicle" / "rigid_body.py" in found
    assert not {here / name for name in ("report.py", "catalog.py", "entry.py")} & found
    mine, used = tmp_path / "mine.py", PACKAGE / "maths" / "attitude.py"  # a module of neither
    mine.write_text("from massprop_drake.maths.attitude import conjugate\n", encoding="utf-8")
    packages = {PACKAGE / "__init__.py", PACKAGE / "maths" / "__init__.py"}
    assert imported_files(mine) == {mine, *packages, *imported_files(used)}
