"""State that compiled code keeps between calls, in numba's own form; loads numba, so only `kernels` loads it.

Python holds no more than a reference, which is passed in no time, however large the bundle is.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import types
from numba.experimental import structref

from massprop_drake.maths._kept import check_cache_files

# nobody calls it from C; kept where `kernels` says, or nowhere
_njit: Any = numba.njit(cache=bool(numba.config.CACHE_DIR), no_cfunc_wrapper=True)  # type: ignore


def _compile_checked(function: Any) -> Any:
    """Compiles a function with cache files that are checked before use."""
    return check_cache_files(_njit(function))


@structref.register
class HeldType(types.StructRef):
    """Type of a holder, by the type of what it holds."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Returns the fields' names and types, types of literal constants widened to plain ones."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Held(structref.StructRefProxy):
    """Python's reference to a holder."""


structref.define_proxy(Held, HeldType, ["value"])


@_compile_checked  # type: ignore[untyped-decorator]
def hold(value: Any) -> Any:
    """Puts a bundle into a new holder, which compiled code can assign to."""
    return Held(value)  # type: ignore[no-untyped-call] # numba's


@_compile_checked  # type: ignore[untyped-decorator]
def release(holder: Any) -> Any:
    """Returns the bundle of a holder, in Python's form."""
    return holder.value
