"""Imports point one way, as the design has it."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
PACKAGE = "massprop_drake"

# folders of the repository and the package names they are installed under
FOLDERS = {
    "massprop_drake": PACKAGE,
    "massprop_drake/maths": f"{PACKAGE}.maths",
    "massprop_drake/reproduction": f"{PACKAGE}.reproduction",
    "massprop_drake/reproduction/entries": f"{PACKAGE}.reproduction.entries",
    "massprop_drake/systems": f"{PACKAGE}.systems",
    "massprop_drake/report": f"{PACKAGE}.report",
    "massprop_drake/vehicles": f"{PACKAGE}.vehicles",
    "diagrams": f"{PACKAGE}.diagrams",
    "scenarios": f"{PACKAGE}.scenarios",
}


def _modules() -> dict[str, Path]:
    """Every module of the package by its full name."""
    found = {}
    for folder, package in FOLDERS.items():
        for path in sorted((REPOSITORY / folder).glob("*.py")):
            found[package if path.stem == "__init__" else f"{package}.{path.stem}"] = path
    return found


MODULES = _modules()


def _is_for_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _imports(tree: ast.AST, module: str, *, inside_functions: bool = True) -> set[str]:
    """Full names of the modules that a module imports; imports for types alone do not count."""
    found: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if _is_for_types_only(node):
            continue
        if not inside_functions and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            assert node.module is not None
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if whole in MODULES else node.module)
        found |= _imports(node, module, inside_functions=inside_functions)
    return found


IMPORTS = {name: _imports(ast.parse(path.read_text(encoding="utf-8")), name) for name, path in MODULES.items()}
FIRST_IMPORTS = {
    name: _imports(ast.parse(path.read_text(encoding="utf-8")), name, inside_functions=False)
    for name, path in MODULES.items()
}


def _of(package: str) -> list[str]:
    """The modules of a package, itself included."""
    return [name for name in MODULES if name == package or name.startswith(f"{package}.")]


def _outside(name: str) -> set[str]:
    """Top-level names of what a module imports from neither the package nor the standard library."""
    tops = {imported.partition(".")[0] for imported in IMPORTS[name]}
    return tops - {PACKAGE, "__future__"} - set(sys.stdlib_module_names)


def _own(name: str) -> set[str]:
    """What a module imports from the package, without the package's name."""
    return {imported.removeprefix(f"{PACKAGE}.") for imported in IMPORTS[name] if imported.startswith(f"{PACKAGE}.")}


def _own_packages(name: str) -> set[str]:
    return {imported.partition(".")[0] for imported in _own(name)}


def test_the_modules_are_found() -> None:
    # the tests below would pass on nothing
    assert len(_of(f"{PACKAGE}.maths")) > 10
    assert len(_of(f"{PACKAGE}.systems")) > 10
    assert len(_of(f"{PACKAGE}.diagrams")) > 5
    assert {"cli", "run", "simulation", "figures"} <= {name.removeprefix(f"{PACKAGE}.") for name in MODULES}
    assert "numpy" in _outside(f"{PACKAGE}.maths.attitude")
    assert "maths.linear_algebra" in _own(f"{PACKAGE}.maths.attitude")
    assert "diagrams.estimation" in _own(f"{PACKAGE}.diagrams.closed_loop")


@pytest.mark.parametrize("name", _of(f"{PACKAGE}.maths"))
def test_mathematics_knows_numpy_and_itself(name: str) -> None:
    assert _outside(name) <= {"numpy"}
    assert _own_packages(name) <= {"maths"}


@pytest.mark.parametrize("name", _of(f"{PACKAGE}.systems"))
def test_systems_know_drake_numpy_mathematics_and_themselves(name: str) -> None:
    assert _outside(name) <= {"numpy", "pydrake"}
    assert _own_packages(name) <= {"maths", "systems"}


@pytest.mark.parametrize("name", _of(f"{PACKAGE}.diagrams"))
def test_diagrams_know_what_they_wire_and_what_they_are_given(name: str) -> None:
    assert _outside(name) <= {"numpy", "pydrake"}
    # vehicle: the types that settings hand out
    assert _own_packages(name) <= {"maths", "systems", "settings", "scenario", "vehicle", "diagrams"}


@pytest.mark.parametrize(
    "name", ["vehicle", "scenario", "models", "errors", "tables", "telemetry", "history", "signals", "settings"]
)
def test_the_bottom_does_not_know_what_stands_on_it(name: str) -> None:
    above = {"systems", "diagrams", "simulation", "estimating", "run", "figures", "graphs", "reproduction", "cli"}
    assert not _own_packages(f"{PACKAGE}.{name}") & above
    assert "pydrake" not in _outside(f"{PACKAGE}.{name}")
    assert "matplotlib" not in _outside(f"{PACKAGE}.{name}")


def test_the_estimator_knows_no_drake() -> None:
    assert _outside(f"{PACKAGE}.estimator") <= {"numpy"}
    assert not _own_packages(f"{PACKAGE}.estimator") & {"systems", "diagrams", "simulation", "run", "figures", "cli"}


def test_figures_know_no_run() -> None:
    assert not _own_packages(f"{PACKAGE}.figures") & {"run", "simulation", "systems", "diagrams"}


@pytest.mark.parametrize("name", _of(f"{PACKAGE}.report"))
def test_reports_know_no_run_but_what_it_looks_like(name: str) -> None:
    assert not _own_packages(name) & {"run", "simulation", "estimating", "systems", "diagrams", "cli"}


def test_a_run_does_not_know_how_it_was_made() -> None:
    assert not _own_packages(f"{PACKAGE}.run") & {"simulation", "estimating", "systems", "diagrams", "graphs"}
    assert "pydrake" not in _outside(f"{PACKAGE}.run")


def test_drake_stays_in_systems_diagrams_and_what_runs_them() -> None:
    users = {name.removeprefix(f"{PACKAGE}.").partition(".")[0] for name in MODULES if "pydrake" in _outside(name)}
    assert users == {"systems", "diagrams", "simulation", "estimating", "graphs", "report"}


def test_nothing_but_its_entry_knows_the_command_line() -> None:
    users = {name for name in MODULES if "cli" in _own_packages(name)}
    assert users <= {f"{PACKAGE}.__main__"}


def test_only_the_command_line_stands_on_the_reproduction() -> None:
    users = {name for name in MODULES if "reproduction" in _own_packages(name)}
    assert users - set(_of(f"{PACKAGE}.reproduction")) == {f"{PACKAGE}.cli"}


def test_what_measures_claims_knows_neither_entries_nor_pictures() -> None:
    for module in ("claims", "measures", "analytic", "checks", "cases", "runner"):
        name = f"{PACKAGE}.reproduction.{module}"
        assert "matplotlib" not in _outside(name)
        assert not {imported for imported in _own(name) if "entries" in imported or "catalogue" in imported}, name


def test_terminals_are_the_command_lines_business() -> None:
    users = {name for name in MODULES if _outside(name) & {"typer", "rich", "click"}}
    assert users == {f"{PACKAGE}.cli"}


def test_matplotlib_is_the_figures_business() -> None:
    users = {name for name in MODULES if "matplotlib" in _outside(name)}
    assert {name for name in users if not name.startswith(f"{PACKAGE}.reproduction.")} == {f"{PACKAGE}.figures"}


def test_pydrake_is_imported_module_by_module() -> None:
    # pydrake.all takes a third of a second and 60 MB
    for name, imported in IMPORTS.items():
        assert "pydrake.all" not in imported, name
        assert "pydrake" not in imported, name


def test_no_imports_go_in_circles() -> None:
    graph = {name: {other for other in imported if other in MODULES} for name, imported in FIRST_IMPORTS.items()}
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join((*trail[trail.index(name) :], name))
        if name in done:
            return
        for other in sorted(graph[name]):
            visit(other, (*trail, name))
        done.add(name)

    for name in graph:
        visit(name, ())


def test_every_module_says_what_it_is() -> None:
    for name, path in MODULES.items():
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), name
