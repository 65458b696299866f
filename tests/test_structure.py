"""The house: rooms import one way, and what promises to need no Drake needs none.

The reproduction stands beside the package, and counts here as its last room: it imports all, and nothing imports it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

REPOSITORY = Path(__file__).parent.parent
PACKAGE = "massprop_drake"
BESIDE = "reproduction"
LINKS = ("diagrams", "scenarios")

# what a room may import stands on an earlier floor; rooms of one floor do not know each other
FLOORS = (
    {"errors"},
    {"maths"},
    {"signals"},
    {"systems", "inputs"},
    {"records"},
    {"results"},
    {"diagrams"},
    {"runners"},
    {"display"},
    {"studies"},
    {"cli"},
    {BESIDE},
)
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
# a run shows itself: its figures, pages and notebook display are loaded when they are asked for
EXCEPTIONS = {("results.run", "display")}
MOST_ARROWS = 60  # between rooms at the top
WITH_NUMBA = ("maths._bundles", "maths._holding", "maths._kept", "maths._linking")
WITHOUT_DRAKE = ("inputs", "records", "results", "maths", "signals", "errors", "runners.estimator")


def _modules() -> dict[str, Path]:
    """Every module by its name without the package's; packages by their `__init__`."""
    found = {}
    # diagrams and scenarios are links, which globbing does not follow
    for folder, top in ((BESIDE, ""), (PACKAGE, PACKAGE), *((f"{PACKAGE}/{link}", PACKAGE) for link in LINKS)):
        for path in sorted((REPOSITORY / folder).rglob("*.py")):
            parts = path.relative_to(REPOSITORY / top).with_suffix("").parts
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


MODULES = _modules()


def _is_for_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _imports(tree: ast.AST, *, inside_functions: bool = True) -> set[str]:
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
            assert node.level == 0, "relative import"
            assert node.module is not None
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if whole.removeprefix(f"{PACKAGE}.") in MODULES else node.module)
        found |= _imports(node, inside_functions=inside_functions)
    return found


@cache
def trees() -> dict[str, ast.Module]:
    """Every module, parsed when the first test asks for one."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


@cache
def imports() -> dict[str, set[str]]:
    """Names that each module imports."""
    return {name: _imports(tree) for name, tree in trees().items()}


@cache
def first_imports() -> dict[str, set[str]]:
    """Names that each module imports before it can be used."""
    return {name: _imports(tree, inside_functions=False) for name, tree in trees().items()}


def _own(imported: set[str]) -> set[str]:
    """Modules of the package, without its name, and of the reproduction."""
    ours = (name for name in imported if name.partition(".")[0] in (PACKAGE, BESIDE) and name != PACKAGE)
    return {name.removeprefix(f"{PACKAGE}.") for name in ours}


def _outside(name: str) -> set[str]:
    """Top-level names of what a module imports that is neither ours nor the standard library's."""
    tops = {imported.partition(".")[0] for imported in imports()[name]}
    return tops - {PACKAGE, BESIDE, "__future__"} - set(sys.stdlib_module_names)


def _of(room: str) -> list[str]:
    return [name for name in MODULES if name == room or name.startswith(f"{room}.")]


def _top(name: str) -> str:
    return name.partition(".")[0]


@cache
def _loaded(name: str) -> frozenset[str]:
    """All that is loaded with a module, of the package and from outside, followed to the end."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        here = waiting.pop()
        if here in found:
            continue
        found.add(here)
        for imported in first_imports()[here]:
            if not imported.startswith(PACKAGE):
                found.add(imported)
        for own in _own(first_imports()[here]):
            parts = own.split(".")
            waiting += [".".join(parts[:length]) for length in range(1, len(parts) + 1)]  # its packages, too
    return frozenset(found)


def test_the_modules_are_found() -> None:
    # the tests below would pass on nothing
    assert {_top(name) for name in MODULES if name} >= set(FLOOR)
    assert len(_of("maths")) > 15
    assert len(_of("systems")) > 15
    assert len(_of("diagrams")) > 5
    assert "numpy" in _outside("maths.attitude")
    assert "maths.linear_algebra" in _own(imports()["maths.attitude"])
    assert "diagrams.estimation" in _own(imports()["diagrams.closed_loop"])


def test_no_loose_modules_stand_at_the_top() -> None:
    loose = {path.stem for path in (REPOSITORY / PACKAGE).glob("*.py")}
    assert loose == {"__init__", "__main__", "errors", "signals"}


@pytest.mark.parametrize("name", [name for name in MODULES if _top(name) in FLOOR])
def test_a_room_imports_what_stands_below_it(name: str) -> None:
    room = _top(name)
    for imported in _own(imports()[name]):
        other = _top(imported)
        if other == room or (name, other) in EXCEPTIONS:
            continue
        assert FLOOR.get(other, -1) < FLOOR[room], f"{name} imports {imported}"


def test_nothing_in_the_package_imports_the_reproduction() -> None:
    users = {name for name in MODULES if BESIDE in {_top(imported) for imported in _own(imports()[name])}}
    assert users <= set(_of(BESIDE))


def test_the_exceptions_are_inside_functions() -> None:
    for name, room in EXCEPTIONS:
        assert room in {_top(imported) for imported in _own(imports()[name])}, "no longer needed"
        assert room not in {_top(imported) for imported in _own(first_imports()[name])}


def test_few_arrows_join_the_rooms() -> None:
    arrows = {
        (_top(name), _top(imported))
        for name in MODULES
        if MODULES[name].name != "__init__.py" and _top(name) != BESIDE
        for imported in _own(imports()[name])
        if _top(name) != _top(imported)
    }
    assert len(arrows) <= MOST_ARROWS, "\n".join(f"{a} -> {b}" for a, b in sorted(arrows))


@pytest.mark.parametrize("name", _of("maths"))
def test_mathematics_knows_numpy_and_itself(name: str) -> None:
    # kernels are compiled where somebody asks for it
    assert _outside(name) <= ({"numpy", "numba"} if name in {"maths.kernels", *WITH_NUMBA} else {"numpy"})


@pytest.mark.parametrize("name", _of("systems"))
def test_systems_know_drake_numpy_mathematics_and_themselves(name: str) -> None:
    assert _outside(name) <= {"numpy", "pydrake"}
    assert {_top(imported) for imported in _own(imports()[name])} <= {
        "errors",
        "maths",
        "systems",
    }  # errors: messages for users


@pytest.mark.parametrize("name", _of("diagrams"))
def test_diagrams_know_what_they_wire_and_what_they_are_given(name: str) -> None:
    assert _outside(name) <= {"numpy", "pydrake"}
    assert {_top(imported) for imported in _own(imports()[name])} <= {
        "maths",
        "systems",
        "inputs",
        "results",
        "diagrams",
    }


def test_the_estimator_knows_numpy_alone() -> None:
    assert _outside("runners.estimator") <= {"numpy"}
    own = _own(imports()["runners.estimator"])
    assert not {_top(imported) for imported in own} & {"systems", "diagrams", "display", "cli"}
    assert not own & {"results.run", "runners.simulate"}


@pytest.mark.parametrize("name", [name for name in _of("display") if name != "display.graphs"])
def test_what_is_shown_of_a_run_does_not_run_it(name: str) -> None:
    own = _own(imports()[name])
    assert not {_top(imported) for imported in own} & {"runners", "systems", "diagrams", "cli"}
    assert "results.run" not in own


@pytest.mark.parametrize("room", WITHOUT_DRAKE)
def test_what_needs_no_drake_loads_none(room: str) -> None:
    for name in _of(room):
        outside = {_top(imported) for imported in _loaded(name) if imported not in MODULES}
        assert not outside & {"pydrake", "matplotlib"}, name


def test_a_fresh_interpreter_agrees_that_no_drake_is_loaded() -> None:
    names = [f"{PACKAGE}.{name}" for room in WITHOUT_DRAKE for name in _of(room) if name not in WITH_NUMBA]
    program = (
        "import sys, importlib\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'pydrake', 'matplotlib'}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_drake_stays_where_it_belongs() -> None:
    users = {name for name in MODULES if "pydrake" in _outside(name)}
    elsewhere = {name for name in users if _top(name) not in {"systems", "diagrams"}}
    assert elsewhere == {"runners.simulated", "display.graphs", "display.links", "display.stage"}


def test_only_the_entries_know_the_command_line() -> None:
    users = {name for name in MODULES if "cli" in {_top(imported) for imported in _own(imports()[name])}}
    assert users - set(_of("cli")) == {"__main__", f"{BESIDE}.__main__", f"{BESIDE}.command"}


def test_what_measures_claims_knows_neither_entries_nor_pictures() -> None:
    for module in ("claims", "measures", "analytic", "checks", "cases", "runner"):
        name = f"{BESIDE}.{module}"
        assert "matplotlib" not in _outside(name)
        assert not {imported for imported in _own(imports()[name]) if "entries" in imported or "catalog" in imported}


def test_terminals_are_the_command_lines_business() -> None:
    users = {name for name in MODULES if _outside(name) & {"typer", "rich", "click"}}
    assert users - set(_of("cli")) == {f"{BESIDE}.command"}


def test_matplotlib_is_the_figures_business() -> None:
    users = {name for name in MODULES if "matplotlib" in _outside(name)}
    assert {name for name in users if _top(name) != BESIDE} == {"display.figures"}


def test_pydrake_is_imported_module_by_module() -> None:
    # pydrake.all takes a third of a second and 60 MB
    for name, imported in imports().items():
        assert "pydrake.all" not in imported, name
        assert "pydrake" not in imported, name


def test_no_imports_go_in_circles() -> None:
    graph = {name: _run_first(name, imported) for name, imported in first_imports().items()}
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


def _run_first(name: str, imported: set[str]) -> set[str]:
    """Modules that are run before a module can be: those that it imports, and the packages that hold these."""
    of_others = _own(imported) & set(MODULES)
    packages = {other[:end] for other in of_others for end in range(len(other)) if other[end] == "."}
    holds_it = {name[:end] for end in range(len(name)) if name[end] == "."}
    return of_others | ((packages & set(MODULES)) - holds_it - {name})


def test_every_module_says_what_it_is() -> None:
    for name, tree in trees().items():
        assert ast.get_docstring(tree), name


def _bare(index: ast.expr) -> bool:
    """Whether an index has a number in it, beyond the first, the last, and all after the first."""
    match index:
        case ast.Constant(value=int(value)):
            return value not in (0, -1)
        case ast.Slice(lower=lower, upper=upper):
            return any(isinstance(end, ast.Constant) and end.value not in (0, 1) for end in (lower, upper))
        case ast.Tuple(elts=parts):
            return any(map(_bare, parts))
    return False


@pytest.mark.parametrize("name", [*_of("systems"), *_of("diagrams"), *_of("runners")])
def test_packed_vectors_are_read_by_their_layouts(name: str) -> None:
    for node in ast.walk(trees()[name]):
        if isinstance(node, ast.Subscript) and _bare(node.slice):
            of_shape = isinstance(node.value, ast.Attribute) and node.value.attr == "shape"
            assert of_shape, f"{name}, line {node.lineno}: {ast.unparse(node)}"


def test_a_test_that_hangs_fails(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.pluginmanager.hasplugin("timeout")
    assert float(pytestconfig.getini("timeout")) > 0.0


def test_tests_use_one_thread_each() -> None:
    assert {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"} == {1}
