"""Number of threads of BLAS: one, since the matrices here are small, and sharing one costs more than it takes.

With two threads on two cores the look back on a run takes five times the processor time. BLAS reads its number when it
is loaded, so whoever starts a process says it: the command line for its own, a campaign for those of its cases.
"""

from __future__ import annotations

from collections.abc import Mapping

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def default_blas_threads(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns environment variables that limit BLAS to one thread; none where the user has set a number."""
    return {} if any(name in environment for name in ONE_THREAD) else dict(ONE_THREAD)
