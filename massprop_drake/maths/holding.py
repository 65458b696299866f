"""What compiled code keeps from one call to the next, in numba's own form; loads numba, so that only `kernels` loads it.

Python holds no more than a reference, which is passed in no time, however large the bundle is.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import types
from numba.experimental import structref


@structref.register
class HeldType(types.StructRef):
    """Type of a holder, by the type of what it holds."""

    def preprocess_fields(self, fields: Any) -> Any:
        """The fields with types that are not those of constants."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Held(structref.StructRefProxy):  # type: ignore[misc] # numba has no types
    """Python's reference to a holder."""


structref.define_proxy(Held, HeldType, ["value"])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def hold(value: Any) -> Any:
    """A holder of a bundle."""
    return Held(value)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def release(holder: Any) -> Any:
    """The bundle, in Python's form."""
    return holder.value
