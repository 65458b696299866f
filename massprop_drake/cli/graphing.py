"""Graphs of diagrams, ours and the user's own: found by name, and written as DOT and SVG."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from massprop_drake.cli import functions
from massprop_drake.cli.sources import load_recovered_scenario
from massprop_drake.display import graphs
from massprop_drake.errors import InputError, suggestion
from massprop_drake.results.folder import require_files, require_no_run, write_files


def find_diagram_builders(names: Sequence[str] | None, like: str | None) -> dict[str, Callable[[], Any]]:
    """Maps names of files to functions that build the diagrams to draw, bundled ones and the user's own.

    Args:
        names: ours, or functions of the user's own, see `functions.call`; None or none: all that a scenario has.
        like: scenario to build ours for; None: those that they are drawn for.

    Raises:
        InputError: when one is not there, or two would have one name.
    """
    case = None if like is None else load_recovered_scenario(like, [])
    builders: dict[str, Callable[[], Any]] = {}
    for name in dict.fromkeys(names or graphs.diagram_names(case)):
        is_users = ":" in name
        if not is_users and name not in graphs.DIAGRAMS:
            if name.endswith(".py"):
                raise InputError(f"'{name}' is a file; say which of its functions builds the diagram: {name}:build")
            raise InputError(f"'{name}' is no diagram{suggestion(name, list(graphs.DIAGRAMS))}")
        if is_users and case is not None:
            raise InputError(f"--like: '{name}' is built by a function of your own, which takes no scenario")
        stem = functions.file_stem(name) if is_users else name
        if stem in builders:
            raise InputError(f"{name}: its files would be called {stem}, as those of another; draw it apart")
        builders[stem] = partial(_build_user_diagram, name) if is_users else partial(graphs.build, name, case)
    return builders


def _build_user_diagram(target: str) -> Any:
    """Calls a user's function and returns its result as a Drake diagram."""
    result = functions.call(target)
    with functions.guard_user_code(target):
        return graphs.as_diagram(result, target)


def write(builders: Mapping[str, Callable[[], Any]], out: Path, *, force: bool) -> tuple[list[Path], bool]:
    """Builds diagrams and writes graphs of them; returns the files, and whether SVG could be drawn.

    Args:
        builders: of diagrams, by the names of their files.
        out: the folder to write.
        force: keep what is there and not ours.

    Raises:
        InputError: when the folder cannot be written, or a diagram cannot be built.
    """
    require_no_run(out)
    names = [f"{name}{part}.{kind}" for name in builders for part in ("", "_overview") for kind in ("dot", "svg")]
    require_files(out, names, force=force)
    files: dict[str, bytes] = {}
    drawn = True
    for name, build in builders.items():
        diagram = build()
        shallow, deep = graphs.dot_text(diagram, 1), graphs.dot_text(diagram, 2)
        drawings = {"": shallow, "_overview": graphs.overview_text(diagram)}
        for suffix, dot in (drawings | ({} if deep == shallow else {"_inside": deep})).items():
            files[f"{name}{suffix}.dot"] = dot.encode()
            svg = graphs.svg_text(dot)
            drawn = drawn and svg is not None
            if svg is not None:
                files[f"{name}{suffix}.svg"] = svg.encode()
    write_files(out, files, force=force)
    return [out / name for name in files], drawn
