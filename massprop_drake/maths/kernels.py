"""Kernels: functions of arrays and numbers, written once, run by numpy, that can be compiled.

`kernel` marks a function and leaves it as it is. `compile_kernel` gives the compiled form of one, for whoever asks for
it (`execution.compiled` of a scenario): numba then compiles it together with all kernels that it calls. Nothing is
compiled unasked, so no bit of a result depends on what is installed.

A kernel keeps to the subset of numpy that numba compiles; for the few idioms that are fast in numpy and unknown to
numba there are functions that say what they mean in the other form, `idiom`: here `numbers`, `rows3`, `take_elements`,
`as_iterable`, `select_where`, `value_of`, `fill`, `read_bundle`.

Kernels of the true vehicle run on arrays of Drake's AutoDiffXd and Expression, too: new arrays take the `dtype` of what
came in, and a branch or a count asks for `value_of` a number.

Between Python and compiled code every array and number is converted, each way, which takes longer than the arithmetic.
So a kernel that is called from Python takes a whole cycle, and what it keeps from one to the next stays in numba's own
form within a `Holder`. Within compiled code a bundle is passed as a reference (`_bundles`), and what compiled code
alone calls is turned into machine code together with its caller (`_linking`).

Compiled code is kept in a folder of the user's cache that is named by a digest of the sources of all kernels, since
numba itself looks at the file of the outermost one alone. What was kept is checked before it is used (`_kept`). Where
it cannot be written nothing is kept: numba would go on beside the sources, by their files. That something is being
compiled, or cannot be kept, the logger `massprop_drake` says as a warning.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from functools import cache, wraps
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

_KERNELS: list[Callable[..., Any]] = []
_IDIOMS: list[tuple[Callable[..., Any], Callable[[Any], None]]] = []  # with what tells numba of each
_CALLED: Any = {"no_cfunc_wrapper": True}  # nobody calls a kernel from C
_LOG = logging.getLogger("massprop_drake")
_BARE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # what is called by compiled code alone needs neither


def kernel(function: F) -> F:
    """Registers a function as a kernel, to be compiled where wanted; returns it unchanged."""
    _KERNELS.append(function)
    return function


def idiom(compiled_form: Callable[..., Any]) -> Callable[[F], F]:
    """Makes a decorator that registers a function's other form for numba, which compiled code uses instead.

    Args:
        compiled_form: that form, with the same arguments.
    """

    def register(function: F) -> F:
        """Registers the function with its other form; returns it unchanged."""
        _IDIOMS.append(
            (
                function,
                lambda extending: extending.overload(function, jit_options=_BARE)(
                    _overload_for_all_types(compiled_form)
                ),
            )
        )
        return function

    return register


class Holder:
    """Holder of data that a kernel keeps between calls; compiled code has one of its own, see `make_holder`.

    Args:
        value: a bundle of arrays, numbers and such bundles, whose types never change.
    """

    __slots__ = ("value",)

    def __init__(self, value: Any):
        self.value = value


# ------------------------------------------------------------------- idioms that numba has in another form


def numbers(vector: Array, _count: int) -> Any:
    """Returns the elements of a vector as plain numbers, to be unpacked; the caller states their count."""
    return vector.tolist()


def _rows3(matrix):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `rows3`: returns the nine elements of a 3x3 matrix as three rows of plain numbers."""
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


@idiom(_rows3)
def rows3(matrix: Array) -> Any:
    """Returns the nine elements of a 3x3 matrix as three rows of plain numbers."""
    return matrix.tolist()


def _take_elements(vector, indices):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `take_elements`: returns the elements of a vector at a table of indices, in the table's shape."""
    result = np.empty(indices.shape)
    flat, index = result.ravel(), indices.ravel()
    for place in range(index.size):
        flat[place] = vector[index[place]]
    return flat.reshape(indices.shape)


@idiom(_take_elements)
def take_elements(vector: Array, indices: NDArray[np.int_]) -> Array:
    """Returns the elements of a vector at a table of indices, in the table's shape."""
    return vector[indices]


def _itself(vector):  # type: ignore[no-untyped-def] # compiled alone
    """Returns a vector itself: what compiled code iterates over."""
    return vector


@idiom(_itself)
def as_iterable(vector: NDArray[Any]) -> Any:
    """Converts a vector to a list for iteration; compiled code iterates over the vector itself."""
    return vector.tolist()


def _element(values: Any, index: int) -> Any:
    """Returns an element of a vector; of a plain number, that number."""
    return values[index] if np.ndim(values) else values


def _select_where(condition, if_true, if_false):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled form of `select_where`."""
    result = np.empty(condition.size)
    for index in range(condition.size):
        result[index] = _element(if_true, index) if condition[index] else _element(if_false, index)
    return result


@idiom(_select_where)
def select_where(condition: NDArray[np.bool_], if_true: Any, if_false: Any) -> Array:
    """Selects elements of ``if_true`` where a condition holds, of ``if_false`` elsewhere; compiles faster than numba's.

    Args:
        condition: in compiled code of shape (n,).
        if_true, if_false: shape (n,), or numbers.
    """
    return np.where(condition, if_true, if_false)


def _real(number):  # type: ignore[no-untyped-def] # compiled alone
    """Converts a plain number to float, in compiled code."""
    return float(number)


@idiom(_real)
def value_of(number: Any) -> float:
    """Converts a float, an AutoDiffXd or a constant Expression to its value, a float, without derivatives.

    Raises:
        ValueError: when it is an Expression that has variables.
    """
    try:
        return float(number)
    except TypeError:
        if hasattr(number, "value"):
            return float(number.value())
    if number.GetVariables().size():
        raise ValueError(f"a number is needed here, and {number} has variables; give them values")
    return float(number.Evaluate())


def fill(row: Array, values: Any) -> None:
    """Writes arrays and numbers into a vector one after the other, in place, as `Layout.pack` orders them."""
    begin = 0
    for value in values:
        if isinstance(value, np.ndarray):
            end = begin + value.size
            row[begin:end] = value if value.ndim == 1 else value.ravel()
            begin = end
        else:
            row[begin] = value
            begin += 1


def read_bundle(vector: Array, like: Any) -> Any:
    """Unpacks the beginning of a vector into a bundle shaped as ``like``, arrays as views: the inverse of `fill`.

    Args:
        vector: with the fields in their order.
        like: a bundle of arrays and numbers.
    """
    values, begin = [], 0
    for field in like:
        if isinstance(field, np.ndarray):
            values.append(vector[begin : begin + field.size].reshape(field.shape))
            begin += field.size
        else:
            values.append(type(field)(vector[begin]))
            begin += 1
    return type(like)(*values)


# --------------------------------------------------------------------------------------- compiling


class Compiler(NamedTuple):
    """Compiler of kernels.

    Attributes:
        version: of numba.
        folder: of compiled code; None: it is not kept.
        timer: of compilation in this process; code that is read from the folder takes none.
    """

    version: str
    folder: Path | None
    timer: Any

    @property
    def spent_s(self) -> float:
        """Time spent with compiling in this process, s."""
        return float(self.timer.duration) if self.timer.done else 0.0


def _load_all_kernels() -> None:
    """Imports every module of `maths`, so that all kernels are registered."""
    folder = Path(__file__).parent
    for path in sorted(folder.rglob("*.py")):
        if not path.name.startswith("_"):
            importlib.import_module(".".join((__package__, *path.relative_to(folder).with_suffix("").parts)))


def has_compiler() -> bool:
    """Tests whether numba, the compiler of kernels, is installed."""
    return importlib.util.find_spec("numba") is not None


def require_compiler() -> None:
    """Raises InputError when numba, the compiler of kernels, is not installed."""
    if not has_compiler():
        raise InputError("execution.compiled: needs numba: pip install 'massprop-drake[fast]', or leave it out")


@cache
def compiler() -> Compiler:
    """Prepares numba for kernels, once per process; returns its version, cache folder and timer.

    Raises:
        InputError: when it is not there, or cannot be loaded.
    """
    require_compiler()
    os.environ.setdefault("NUMBA_OPT", "1")  # more takes twice as long to compile, and gains nothing here
    try:
        import numba  # noqa: PLC0415 (optional, slow to load)
        from numba import extending  # noqa: PLC0415
        from numba.core import event  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f"execution.compiled: numba cannot be loaded: {error}") from None
    warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)  # of small matrices that are not contiguous
    _load_all_kernels()
    folder = _writable_cache_folder()
    from massprop_drake.maths import _bundles, _linking  # noqa: F401, PLC0415 (load numba)

    _linking.delay_machine_code()
    _register_idioms(extending)
    for function in _KERNELS:
        extending.register_jitable(**_BARE)(function)
    timer = _make_timer(event, "" if folder is None else f"; they are kept in {folder}")
    event.register("numba:compile", timer)
    with _use_cache_folder(folder):
        from massprop_drake.maths import _holding  # noqa: F401, PLC0415 (loads numba)
    return Compiler(metadata.version("numba"), folder, timer)


@contextmanager
def _use_cache_folder(folder: Path | None) -> Iterator[None]:
    """Sets numba's cache folder within the context and restores its setting after."""
    import numba  # noqa: PLC0415 (optional, slow to load)

    before = numba.config.CACHE_DIR
    setattr(numba.config, "CACHE_DIR", str(folder or ""))  # noqa: B010 (made at run time)
    try:
        yield
    finally:
        setattr(numba.config, "CACHE_DIR", before)  # noqa: B010


def has_cached_kernels() -> bool:
    """Tests whether compiled kernels are in the cache folder already.

    Raises:
        InputError: when numba is not there.
    """
    require_compiler()
    _load_all_kernels()
    return any(_cache_path().rglob("*.nbi"))


def _cache_path() -> Path:
    """Returns the cache folder of compiled kernels of this version of the sources."""
    named = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    return Path(named or os.path.expanduser("~/.cache")) / "massprop_drake" / _digest()


def _writable_cache_folder() -> Path | None:
    """Makes and returns the cache folder of compiled kernels; None, with a warning, where it cannot."""
    folder = _cache_path()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        _LOG.warning(
            "compiled kernels cannot be kept in %s (%s), and are compiled anew by every process; name a folder that "
            "can be written in NUMBA_CACHE_DIR",
            folder,
            error.strerror,
        )
        return None


def _make_timer(event: Any, message_end: str) -> Any:
    """Makes the listener that times compilation and logs its first start; `message_end`: appended to that message."""

    class Timer(event.TimingListener):  # type: ignore[misc] # what numba has
        """Listener that times compilations."""

        said = False

        def on_start(self, compilation: Any) -> None:
            """Starts timing; logs, at the first compilation of this package's kernels, that it takes a minute."""
            home = compilation.data["dispatcher"].py_func.__module__ or ""  # none of what numba makes itself
            if home.startswith("massprop_drake.") and not self.said:
                _LOG.warning("kernels are being compiled, which takes about a minute, once%s", message_end)
                self.said = True
            super().on_start(compilation)

    return Timer()


def _digest() -> str:
    """Computes a digest of all kernels' sources and of the versions of Python, numpy and numba, 16 digits."""
    functions = {*_KERNELS, *(function for function, _ in _IDIOMS)}
    own = {
        __file__,
        *(str(Path(__file__).with_name(f"_{name}.py")) for name in ("bundles", "holding", "kept", "linking")),
    }
    files = sorted({inspect.getfile(function) for function in functions} | own)
    content = hashlib.sha256()
    for file in files:
        content.update(Path(file).read_bytes())
    for part in (sys.version, np.__version__, metadata.version("numba")):
        content.update(part.encode())
    return content.hexdigest()[:16]


def _register_idioms(extending: Any) -> None:
    """Registers all idioms' compiled forms with numba."""
    for _, teach in _IDIOMS:
        teach(extending)
    extending.overload(numbers, jit_options=_BARE, prefer_literal=True)(_numbers)
    extending.overload(_element, jit_options=_BARE)(_element_of)
    extending.overload(fill, jit_options=_BARE)(_fill)
    extending.overload(read_bundle, jit_options=_BARE)(_read_bundle)


def _numbers(vector, _count):  # type: ignore[no-untyped-def] # of types
    """Makes the compiled form of `numbers` for a literal count."""
    last = _count.literal_value - 1
    if last == 0:
        return lambda vector, _count: (vector[0],)
    return lambda vector, _count: (*numbers(vector, last), vector[last])


def _element_of(values, index):  # type: ignore[no-untyped-def] # of types
    """Makes the compiled form of element access, for a vector or a number."""
    return (lambda values, index: values[index]) if getattr(values, "ndim", 0) else (lambda values, index: values)


def _fill(row, values):  # type: ignore[no-untyped-def] # of types
    """Makes the compiled form of `fill` for the numba types of a row and its values."""
    lines = ["def filled(row, values):", "    begin = 0"]
    fields = getattr(values, "field_dict", None)  # of a bundle, by name
    named = (
        {f"values[{index}]": kind for index, kind in enumerate(values.types)}
        if fields is None
        else {f"values.{name}": kind for name, kind in fields.items()}
    )
    for value, kind in named.items():
        rank = getattr(kind, "ndim", 0)
        if rank == 0:
            lines += [f"    row[begin] = {value}", "    begin += 1"]
            continue
        indices = ", ".join("ijk"[:rank])
        for depth in range(rank):
            lines.append(f"{'    ' * (depth + 1)}for {'ijk'[depth]} in range({value}.shape[{depth}]):")
        indent = "    " * (rank + 1)
        lines += [f"{indent}row[begin] = {value}[{indices}]", f"{indent}begin += 1"]
    made: dict[str, Any] = {}
    exec("\n".join(lines), made)
    return made["filled"]


def _read_bundle(vector, like):  # type: ignore[no-untyped-def] # of types
    """Makes the compiled form of `read_bundle` for the numba type of a bundle."""
    lines = ["def taken(vector, like):", "    begin = 0"]
    for name, kind in like.field_dict.items():
        if getattr(kind, "ndim", 0):
            lines += [f"    end = begin + like.{name}.size"]
            lines += [f"    _{name} = vector[begin:end].reshape(like.{name}.shape)", "    begin = end"]
        else:
            number = {"bool": "vector[begin] != 0.0", "int64": "int(vector[begin])"}.get(str(kind), "vector[begin]")
            lines += [f"    _{name} = {number}", "    begin += 1"]
    lines.append(f"    return bundle({', '.join(f'_{name}' for name in like.field_dict)})")
    made: dict[str, Any] = {"bundle": like.bundle}
    exec("\n".join(lines), made)
    return made["taken"]


def _overload_for_all_types(compiled_form: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps a function as numba's `overload` wants it: the same for all argument types, names unchanged."""

    @wraps(compiled_form)
    def of_types(*_kinds: Any, **_named: Any) -> Callable[..., Any]:
        """Returns the compiled form, whatever the argument types."""
        return compiled_form

    return of_types


@cache
def compile_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a kernel's compiled form, which compiles at its first call or loads from the cache.

    Raises:
        InputError: when numba is not there.
    """
    folder = compiler().folder
    import numba  # noqa: PLC0415 (optional, slow to load)

    from massprop_drake.maths._kept import check_cache_files  # noqa: PLC0415 (loads numba)

    with _use_cache_folder(folder):
        return check_cache_files(numba.njit(cache=folder is not None, **_CALLED)(function))


def compile_kernel_if(function: F, compile_it: bool) -> F:
    """Returns a kernel's compiled form where ``compile_it``, else the kernel itself."""
    return compile_kernel(function) if compile_it else function  # type: ignore[return-value]


def make_holder(value: Any, compile_it: bool) -> Any:
    """Puts a bundle (named tuple) into a mutable holder, a compiled one where ``compile_it``."""
    return make_shared_holder(_copy_for_compiler(value), compile_it) if compile_it else Holder(value)


def make_shared_holder(value: Any, compile_it: bool) -> Any:
    """Makes a holder of a bundle whose arrays are shared with the caller, not copied.

    Args:
        value: with contiguous arrays that may be written to, and no enumeration members.
        compile_it: whether compiled code is to have it.
    """
    if not compile_it:
        return Holder(value)
    compiler()
    from massprop_drake.maths._holding import hold  # noqa: PLC0415 (loads numba)

    return hold(value)


def _copy_for_compiler(value: Any) -> Any:
    """Copies a bundle with contiguous arrays and plain numbers for enumeration members, as numba wants."""
    if isinstance(value, np.ndarray):
        return np.array(value, order="C")
    if isinstance(value, IntEnum):
        return int(value)
    if isinstance(value, tuple):
        parts = [_copy_for_compiler(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def read_holder(holder: Any) -> Any:
    """Returns the bundle in a plain or compiled holder, as a named tuple."""
    if isinstance(holder, Holder):
        return holder.value
    from massprop_drake.maths._holding import release  # noqa: PLC0415 (loads numba)

    return release(holder)
