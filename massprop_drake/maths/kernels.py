"""Kernels: functions of arrays and numbers that are written once, run by numpy, and can be compiled.

`kernel` marks a function and leaves it as it is. `compiled` gives the compiled form of one, for whoever asks for it
(`execution.compiled` of a scenario): numba then compiles it together with all kernels that it calls. Nothing is
compiled unasked, so no bit of a result depends on what is installed.

A kernel keeps to the subset of numpy that numba compiles; for the few idioms that are fast in numpy and unknown to
numba there are functions here: `numbers`, `rows3`, `picked`.

Compiled code is kept in a folder of the user's cache that is named by a digest of the sources of all kernels, since
numba itself looks at the file of the outermost one alone.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import sys
import warnings
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

_KERNELS: list[Callable[..., Any]] = []
_registered: set[Callable[..., Any]] = set()


def kernel(function: F) -> F:
    """Marks a function as a kernel; it stays what it is."""
    _KERNELS.append(function)
    return function


# ------------------------------------------------------------------- idioms that numba has in another form


def numbers(vector: Array, _count: int) -> Any:
    """The elements of a vector as plain numbers, to be unpacked; how many is written out where it is called."""
    return vector.tolist()


def rows3(matrix: Array) -> Any:
    """The rows of a 3x3 matrix as plain numbers."""
    return matrix.tolist()


def picked(vector: Array, places: NDArray[np.int_]) -> Array:
    """Elements of a vector at a table of places, in the table's shape."""
    return vector[places]


# --------------------------------------------------------------------------------------- compiling


class Compiler(NamedTuple):
    """What compiles.

    Attributes:
        version: of numba.
        folder: of compiled code.
        timer: of compilation in this process; code that is read from the folder takes none.
    """

    version: str
    folder: Path
    timer: Any

    @property
    def spent_s(self) -> float:
        """Time spent with compiling in this process, s."""
        return float(self.timer.duration) if self.timer.done else 0.0


def _gathered() -> None:
    """Loads every module that holds kernels, so that all are known."""
    from massprop_drake.maths import attitude, linear_algebra, mass_properties  # noqa: F401, PLC0415
    from massprop_drake.maths.autopilot import phase_space  # noqa: F401, PLC0415
    from massprop_drake.maths.estimation.detectors import jet_tests  # noqa: F401, PLC0415
    from massprop_drake.maths.estimation.filters import thesis  # noqa: F401, PLC0415
    from massprop_drake.maths.vehicle import cycle, reaction_jets, rigid_body, sensing, thrust  # noqa: F401, PLC0415


@cache
def compiler() -> Compiler:
    """Makes numba ready to compile kernels.

    Raises:
        InputError: when it is not there.
    """
    os.environ.setdefault("NUMBA_OPT", "1")  # more takes twice as long to compile, and gains nothing here
    try:
        import numba  # noqa: PLC0415 (optional, slow to load)
        from numba import extending  # noqa: PLC0415
        from numba.core import event  # noqa: PLC0415
    except ImportError:
        raise InputError(
            "execution.compiled: needs numba: pip install 'massprop-drake[fast]', or leave it out"
        ) from None
    warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)  # of small matrices that are not contiguous
    _gathered()
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = home / "massprop_drake" / _digest()
    setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 (made at run time)
    _teach(extending)
    for function in _KERNELS:
        extending.register_jitable(function)
    timer = event.TimingListener()
    event.register("numba:compile", timer)
    return Compiler(metadata.version("numba"), folder, timer)


def _digest() -> str:
    """Of the sources of all kernels, and of what compiles them."""
    files = sorted({inspect.getfile(function) for function in _KERNELS} | {__file__})
    content = hashlib.sha256()
    for file in files:
        content.update(Path(file).read_bytes())
    for part in (sys.version, np.__version__, metadata.version("numba")):
        content.update(part.encode())
    return content.hexdigest()[:16]


def _teach(extending: Any) -> None:
    """Tells numba what the idioms above are."""
    from massprop_drake.maths.linear_algebra import nonzero  # noqa: PLC0415 (a kernel's module itself)

    for idiom, meaning in ((rows3, _rows3), (nonzero, _any_nonzero), (picked, _picked)):
        extending.overload(idiom)(_always(meaning))
    extending.overload(numbers, prefer_literal=True)(_numbers)


def _numbers(vector, _count):  # type: ignore[no-untyped-def] # of types
    elements = ", ".join(f"vector[{index}]" for index in range(_count.literal_value))
    return eval(f"lambda vector, _count: ({elements},)")


def _rows3(matrix):  # type: ignore[no-untyped-def] # compiled alone
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


def _always(meaning: Callable[..., Any]) -> Callable[..., Any]:
    """What `overload` asks for: a function of the arguments' types, here the same for all, with their names."""
    names = ", ".join(inspect.signature(meaning).parameters)
    made: Callable[..., Any] = eval(f"lambda {names}: meaning", {"meaning": meaning})
    return made


def _any_nonzero(vector):  # type: ignore[no-untyped-def] # compiled alone
    return np.any(vector != 0.0)


def _picked(vector, places):  # type: ignore[no-untyped-def] # compiled alone
    result = np.empty(places.shape)
    flat, index = result.ravel(), places.ravel()
    for place in range(index.size):
        flat[place] = vector[index[place]]
    return flat.reshape(places.shape)


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The compiled form of a kernel; it compiles itself at the first call, or is read from the cache.

    Raises:
        InputError: when numba is not there.
    """
    compiler()
    import numba  # noqa: PLC0415 (optional, slow to load)

    return numba.njit(cache=True)(function)


def chosen(function: F, compile_it: bool) -> F:
    """A kernel, or its compiled form."""
    return compiled(function) if compile_it else function  # type: ignore[return-value]


def plain(value: Any) -> Any:
    """A bundle with the numbers of its enumeration members in their place; numba takes long over each member."""
    if isinstance(value, IntEnum):
        return int(value)
    if isinstance(value, tuple):
        parts = [plain(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def with_compiled(bundle: Any) -> Any:
    """A bundle of parameters with the compiled form of each kernel that is among its fields."""
    kernels = {name: value for name, value in bundle._asdict().items() if callable(value) and value in _KERNELS}
    return bundle._replace(**{name: compiled(function) for name, function in kernels.items()})
