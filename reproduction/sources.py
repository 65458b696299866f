"""Follows imports to the end, without running them, to find the code that a result depends on."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import massprop_drake

PACKAGE = Path(massprop_drake.__file__).parent
_HERE = Path(__file__).parent
_SHOWS = "display"  # draws what has been computed: a run imports it to show itself


@lru_cache(maxsize=64)
def code_digest(*starts: Path, package: Path = PACKAGE) -> str:
    """Computes a digest of the source files that some modules import, themselves included.

    Args:
        starts: files of the modules, of `massprop_drake`, of this package or of neither.
        package: folder of `massprop_drake`, whose modules are followed as those of this package are.
    """
    digest = hashlib.sha256()
    for name, path in sorted(
        (_relative_name(path, package), path) for path in imported_files(*starts, package=package)
    ):
        digest.update(name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _relative_name(path: Path, package: Path) -> str:
    """Returns a file's path relative to the parent of its package, wherever that lies."""
    home = next((home for home in (package, _HERE) if path.is_relative_to(home)), path)
    return path.relative_to(home.parent).as_posix()


def imported_files(*starts: Path, package: Path = PACKAGE) -> set[Path]:
    """Finds the files of both packages that some modules import, at once or inside functions, directly or not.

    Imports for types alone are passed over, and so is the room that only shows results.

    Args:
        starts: files of the modules, which are among those returned.
        package: folder of `massprop_drake`.
    """
    files: set[Path] = set()
    waiting = list(starts)
    while waiting:
        path = waiting.pop()
        if path not in files:
            files.add(path)
            names = _imported_names(ast.parse(path.read_bytes()))
            waiting += [file for name in names for home in (package, _HERE) for file in _files_of_import(name, home)]
    return files


def _imported_names(tree: ast.AST) -> Iterator[str]:
    """Yields the names that a module imports; of `from a import b` both a and a.b, which may be a module."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        yield from _imported_names(node)


def _files_of_import(name: str, package: Path) -> Iterator[Path]:
    """Yields the files that run when a name is imported: each package's `__init__`, and the module's own."""
    top, *parts = name.split(".")
    if top != package.name or parts[:1] == [_SHOWS]:
        return
    folder = package
    yield folder / "__init__.py"
    for part in parts:
        module, folder = folder / f"{part}.py", folder / part
        if module.is_file():
            yield module
        elif (folder / "__init__.py").is_file():
            yield folder / "__init__.py"
        else:
            return
