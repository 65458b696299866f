"""The house: rooms import one way, and what promises to need no Drake needs none.

The reproduction stands beside the package, and counts here as its last room: it imports all, and nothing imports it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
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
    {"systems", "inputs"},
    {"records"},
    {"results"},
    {"diagrams"},
    {"display"},
    {"runners"},
    {"studies"},
    {"cli"},
    {BESIDE},
)
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
MOST_ARROWS = 45  # between rooms at the top
WITH_NUMBA = ("maths._bundles", "maths._holding", "maths._kept", "maths._linking")
WITHOUT_DRAKE = ("inputs", "records", "results", "maths", "errors", "runners.estimator")
# what rooms import from outside, and rooms that they know besides themselves
OUTSIDE = {"maths": {"numpy"}, "systems": {"numpy", "pydrake"}, "diagrams": {"numpy", "pydrake"}}
KNOWN = {"systems": {"errors", "maths"}, "diagrams": {"maths", "systems", "inputs", "results"}}
# outside names, and the modules beyond a room that use them
USERS = {
    "pydrake": ({"systems", "diagrams"}, {"runners.drake_engine", "display.graphs", "display.links", "display.stage"}),
    "typer": ({"cli"}, {f"{BESIDE}.command"}),
    "rich": ({"cli"}, {f"{BESIDE}.command"}),
    "click": ({"cli"}, {f"{BESIDE}.command"}),
    "matplotlib": ({BESIDE}, {"display.figures"}),
}


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


def _imports(tree: ast.AST, *, inside_functions: bool = True) -> set[str]:
    """Full names of the modules that a module imports; imports for types alone do not count."""
    found: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
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


TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}
IMPORTS = {name: _imports(tree) for name, tree in TREES.items()}


def _own(imported: set[str]) -> set[str]:
    """Modules of the package, without its name, and of the reproduction."""
    ours = (name for name in imported if name.partition(".")[0] in (PACKAGE, BESIDE) and name != PACKAGE)
    return {name.removeprefix(f"{PACKAGE}.") for name in ours}


def _outside(name: str) -> set[str]:
    """Top-level names of what a module imports that is neither ours nor the standard library's."""
    tops = {_top(imported) for imported in IMPORTS[name]}
    return tops - {PACKAGE, BESIDE, "__future__"} - set(sys.stdlib_module_names)


def _of(room: str) -> list[str]:
    return [name for name in MODULES if name == room or name.startswith(f"{room}.")]


def _top(name: str) -> str:
    return name.partition(".")[0]


def _rooms(name: str) -> set[str]:
    """Rooms that a module imports from, but its own."""
    return {_top(imported) for imported in _own(IMPORTS[name])} - {_top(name)}


def test_the_modules_are_found() -> None:
    # the tests below would pass on nothing
    assert {_top(name) for name in MODULES if name} >= set(FLOOR)
    assert min(len(_of(room)) for room in ("maths", "systems", "diagrams")) > 5
    assert "numpy" in _outside("maths.attitude")
    assert "diagrams.estimation" in _own(IMPORTS["diagrams.closed_loop"])
    loose = {path.stem for path in (REPOSITORY / PACKAGE).glob("*.py")}
    assert loose == {"__init__", "__main__", "errors"}


def test_rooms_import_what_stands_below_them() -> None:
    upward = [
        f"{name} imports {other}"
        for name in MODULES
        if _top(name) in FLOOR
        for other in _rooms(name)
        if FLOOR.get(other, -1) >= FLOOR[_top(name)]
    ]
    assert upward == []
    assert {name for name in MODULES if BESIDE in _rooms(name)} == set()


def test_few_arrows_join_the_rooms() -> None:
    inner = [name for name, path in MODULES.items() if path.name != "__init__.py" and _top(name) != BESIDE]
    arrows = {(_top(name), other) for name in inner for other in _rooms(name)}
    assert len(arrows) <= MOST_ARROWS, "\n".join(f"{a} -> {b}" for a, b in sorted(arrows))


def test_rooms_know_what_they_may() -> None:
    # kernels are compiled where somebody asks for it
    numba = {"maths.kernels", *WITH_NUMBA}
    for room, allowed in OUTSIDE.items():
        for name in _of(room):
            assert _outside(name) <= (allowed | {"numba"} if name in numba else allowed), name
    for room, known in KNOWN.items():
        assert [name for name in _of(room) if not _rooms(name) <= known] == []
    assert _outside("runners.estimator") <= {"numpy"}
    assert not _rooms("runners.estimator") & {"systems", "diagrams", "display", "cli"}
    assert not _own(IMPORTS["runners.estimator"]) & {"display.run", "runners.simulate"}
    for name in set(_of("display")) - {"display.graphs"}:  # what is shown of a run does not run it
        assert not _rooms(name) & {"runners", "systems", "diagrams", "cli"}, name
        assert "display.run" not in _own(IMPORTS[name]), name


@pytest.mark.parametrize("package", USERS)
def test_packages_are_used_where_they_belong(package: str) -> None:
    rooms, others = USERS[package]
    users = {name for name in MODULES if package in _outside(name)}
    beyond = {name for name in users if _top(name) not in rooms}
    assert beyond == others if package in ("pydrake", "matplotlib") else beyond <= others


def test_only_the_entries_know_the_command_line() -> None:
    users = {name for name in MODULES if "cli" in _rooms(name)}
    assert users == {"__main__", f"{BESIDE}.__main__", f"{BESIDE}.command"}


def test_pydrake_is_imported_module_by_module() -> None:
    # pydrake.all takes a third of a second and 60 MB
    assert [name for name, imported in IMPORTS.items() if imported & {"pydrake", "pydrake.all"}] == []


def test_what_needs_no_drake_loads_none() -> None:
    names = [f"{PACKAGE}.{name}" for room in WITHOUT_DRAKE for name in _of(room) if name not in WITH_NUMBA]
    program = (
        "import sys, importlib\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'pydrake', 'matplotlib'}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_imports_go_in_circles() -> None:
    first = {name: _imports(tree, inside_functions=False) for name, tree in TREES.items()}
    TopologicalSorter({name: _run_first(name, imported) for name, imported in first.items()}).prepare()


def _run_first(name: str, imported: set[str]) -> set[str]:
    """Modules that are run before a module can be: those that it imports, and the packages that hold these."""
    of_others = _own(imported) & set(MODULES)
    packages = {other[:end] for other in of_others for end in range(len(other)) if other[end] == "."}
    holds_it = {name[:end] for end in range(len(name)) if name[end] == "."}
    return of_others | ((packages & set(MODULES)) - holds_it - {name})


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


def test_packed_vectors_are_read_by_their_layouts() -> None:
    bare = [
        f"{name}, line {node.lineno}: {ast.unparse(node)}"
        for name in (*_of("systems"), *_of("diagrams"), *_of("runners"))
        for node in ast.walk(TREES[name])
        if isinstance(node, ast.Subscript) and _bare(node.slice)
        if not (isinstance(node.value, ast.Attribute) and node.value.attr == "shape")
    ]
    assert bare == []


def test_tests_that_hang_fail_and_use_one_thread_each(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.pluginmanager.hasplugin("timeout")
    assert float(pytestconfig.getini("timeout")) > 0.0
    assert {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"} == {1}
