"""Execution of a case, on which the bits of its result may depend: versions and processor."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from importlib.metadata import version

import numpy as np

_PACKAGES = ("massprop-drake", "drake", "numpy", "scipy")


def execution(*, compiled: bool = False) -> dict[str, str]:
    """Returns versions and processor features on which results depend, by name, of this process.

    Two processes for which this is equal give the same bits.
    """
    import scipy.linalg  # noqa: F401, PLC0415 (loads the BLAS that is to be named)
    from threadpoolctl import threadpool_info  # noqa: PLC0415 (optional)

    blas = sorted(
        f"{library['internal_api']} {library['version']} {library.get('architecture', '')}".strip()
        for library in threadpool_info()
        if library["user_api"] == "blas"
    )
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in (*_PACKAGES, *(("numba",) if compiled else ()))},
        "system": f"{sys.platform} {platform.machine()} {' '.join(platform.libc_ver())}".strip(),
        "blas": ", ".join(dict.fromkeys(blas)),
        "simd": " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])),
    }


def differences(execution: Mapping[str, str], reference: Mapping[str, str]) -> list[str]:
    """Lists in words how versions and processor of an execution differ from a reference; empty if equal."""
    return [
        f"{name} {execution.get(name, 'unknown')} instead of {reference.get(name, 'unknown')}"
        for name in dict.fromkeys([*reference, *execution])
        if execution.get(name) != reference.get(name)
    ]
