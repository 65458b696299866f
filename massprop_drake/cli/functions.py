"""Functions of the user's own, named as MODULE:FUNCTION or FILE.py:FUNCTION."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import massprop_drake
from massprop_drake.cli.streams import note
from massprop_drake.errors import InputError, collect_drake_warnings, suggestion

_OURS = str(Path(massprop_drake.__file__).parent)


def file_stem(target: str) -> str:
    """Makes the stem of file names for a function: the last word of its module, and its own name."""
    module, _, name = target.rpartition(":")
    return re.sub(r"\W+", "_", f"{Path(module.removesuffix('.py')).name.rpartition('.')[2]}_{name}")


@contextlib.contextmanager
def guard_user_code(target: str) -> Iterator[None]:
    """Converts, in a with block, errors of the user's code into one InputError; its output goes to stderr.

    Args:
        target: as given, for the message.

    Raises:
        InputError: with the error's own words, file and line.
    """
    with collect_drake_warnings() as logged:
        try:
            with contextlib.redirect_stdout(sys.stderr):
                yield
        except InputError:
            raise
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # Drake ends the process where a demand is not met, and logs why
            message = error.msg if isinstance(error, SyntaxError) else str(error)
            words = " ".join("; ".join([*logged, message]).split()) or "no message"
            raise InputError(f"{target}: {type(error).__name__}: {words}{_error_location(error)}") from None
    for line in logged:
        note(line)


def call(target: str) -> Any:
    """Imports a user's function, calls it without arguments and returns its result.

    Args:
        target: `module:function`, of a module that Python finds from the current folder on, or `file.py:function`.

    Raises:
        InputError: when there is no such module or function, it needs arguments, or it raises.
    """
    module, _, name = target.rpartition(":")
    if not module.strip(".") or not name:
        raise InputError(f"{target}: give MODULE:FUNCTION or FILE.py:FUNCTION, such as my_loop.py:build")
    function = _find_function(_import_module(module, target), name, target)
    with guard_user_code(target):
        return function()


def _import_module(source: str, target: str) -> ModuleType:
    """Imports a module by its dotted name or its file's path, and returns it; raises InputError."""
    if not (source.endswith(".py") or os.sep in source):
        with _search_folder_first(Path.cwd()), guard_user_code(target):
            try:
                return importlib.import_module(source)
            except ModuleNotFoundError as error:
                if error.name is None or not f"{source}.".startswith(f"{error.name}."):
                    raise
            raise InputError(
                f"{target}: there is no module '{source}' here; of a file give its path, such as {source}.py"
            )
    path = Path(source)
    if not path.is_file():
        raise InputError(f"{target}: there is no file {source}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{target}: {source} is no Python file")
    module = importlib.util.module_from_spec(spec)
    with _search_folder_first(path.resolve().parent), guard_user_code(target):
        spec.loader.exec_module(module)
    return module


@contextlib.contextmanager
def _search_folder_first(folder: Path) -> Iterator[None]:
    """Makes Python search a folder for modules first, in a with block."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # the code may have taken it away
            sys.path.remove(str(folder))


def _find_function(module: ModuleType, name: str, target: str) -> Callable[[], Any]:
    """Returns the function of a name in a module; raises InputError unless it can be called without arguments."""
    function = getattr(module, name, None)
    if not callable(function):
        problem = "is no function" if hasattr(module, name) else "is not there"
        theirs = {key: value for key, value in vars(module).items() if inspect.isfunction(value)}
        own = [key for key, value in theirs.items() if value.__module__ == module.__name__ and not key.startswith("_")]
        raise InputError(f"{target}: '{name}' {problem}{suggestion(name, own)}")
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # of a function that is not Python's
        parameters = []
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    needed = [one.name for one in parameters if one.default is one.empty and one.kind not in variable]
    if needed:
        raise InputError(f"{target}: needs arguments, {', '.join(needed)}; give a function that needs none")
    result: Callable[[], Any] = function
    return result


def _error_location(error: BaseException) -> str:
    """Formats file and line of the user's code that raised an error as " (file, line n)"; empty: none."""
    if isinstance(error, SyntaxError) and error.filename:
        return f" ({_shortened_path(error.filename)}, line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    user_frames = [frame for frame in frames if not _is_installed(frame.filename)]
    return f" ({_shortened_path(user_frames[-1].filename)}, line {user_frames[-1].lineno})" if user_frames else ""


def _is_installed(filename: str) -> bool:
    """Tests whether a file belongs to this package, to Python or to an installed package."""
    return filename.startswith(("<", _OURS, sys.prefix, sys.base_prefix)) or "site-packages" in Path(filename).parts


def _shortened_path(filename: str) -> str:
    """Shortens a path that lies below the current folder to one relative to it."""
    path, here = Path(filename), Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
