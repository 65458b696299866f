"""Reflections without the orthogonal factor in compiled code; loads numba, so only `kernels` loads it.

numba's form of `np.linalg.qr` makes that factor in any case, which takes as long again, and turns the matrix round.
Where numba is another, its form it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload
from numba.np import linalg

from massprop_drake.maths.linear_algebra import lower_factor


def _by_lapack(columns: Any) -> Any:
    linalg.ensure_lapack()
    reflect = linalg._LAPACK().numba_ez_geqrf(columns.dtype)
    kind, finite = ord(linalg.get_blas_kind(columns.dtype, "qr")), linalg._check_finite_matrix

    def reflected(columns):  # type: ignore[no-untyped-def] # compiled alone
        n, k = columns.shape
        finite(columns)
        least = min(n, k)
        work, tau = np.empty((n, k)), np.empty(least)
        work[:] = columns  # row by row, to LAPACK its transpose
        if reflect(kind, k, n, work.ctypes, k, tau.ctypes) < 0:
            raise np.linalg.LinAlgError("LAPACK: geqrf")
        result = np.zeros((n, least))
        for row in range(n):
            for column in range(min(row + 1, least)):
                result[row, column] = work[row, column]
        return result

    return reflected


def _by_numba(_columns: Any) -> Any:
    def reflected(columns):  # type: ignore[no-untyped-def] # compiled alone
        _, upper = np.linalg.qr(columns.T)
        return np.ascontiguousarray(upper.T)

    return reflected


_THERE = all(hasattr(linalg, name) for name in ("ensure_lapack", "_LAPACK", "get_blas_kind", "_check_finite_matrix"))
_BARE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@overload(lower_factor, jit_options=_BARE)
def _lower_factor(columns):  # type: ignore[no-untyped-def] # of types
    return _by_lapack(columns) if _THERE else _by_numba(columns)
