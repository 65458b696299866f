"""Processes of studies: functions that all studies in several processes share."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import resource_tracker
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


@contextlib.contextmanager
def defer_ctrl_c() -> Iterator[None]:
    """Blocks SIGINT during a block; processes and threads that are started in it never receive one."""
    resource_tracker.ensure_running()  # which would let it through again when the first process starts
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def call_in_process(function: Callable[_P, _R], *arguments: _P.args, **options: _P.kwargs) -> _R:
    """Calls a function in a process of its own, whose memory is freed after; returns its result.

    Args:
        function: of a module; what it takes, returns and raises must be picklable.
        arguments: of it.
        options: of it, by name.
    """
    pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
    try:
        with defer_ctrl_c():
            future = pool.submit(function, *arguments, **options)
        return future.result()
    finally:
        pool.shutdown(cancel_futures=True)
