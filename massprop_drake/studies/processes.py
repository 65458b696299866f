"""What studies in several processes share."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker


@contextlib.contextmanager
def ctrl_c_held() -> Iterator[None]:
    """Leaves Ctrl-C to this process, after the block: processes and threads started in it never see one."""
    resource_tracker.ensure_running()  # which would let it through again when the first process starts
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
