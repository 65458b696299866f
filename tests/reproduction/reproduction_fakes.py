"""Cheap cases for the tests of the runner, in a module that another process can import."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reproduction.runner import Store, run_missing

LOG = "REPRODUCTION_FAKES_LOG"  # environment: a folder in which each execution leaves a file
FREE = 3  # as many runs of a process are not held up
GO = "go"  # file in that folder, for which all others wait


def held_up(seed: int) -> dict[str, NDArray[np.float64]]:
    """Work that goes on until somebody has looked."""
    folder = os.environ.get(LOG)
    if folder:
        Path(folder, f"{seed:02d}-{os.getpid()}").touch()
        first = min(int(path.name.partition("-")[0]) for path in Path(folder).glob("[0-9]*"))
        while seed >= first + FREE and not Path(folder, GO).exists():
            time.sleep(0.01)
    return quick(seed)


def quick(seed: int) -> dict[str, NDArray[np.float64]]:
    """Numbers that depend on the seed alone."""
    return {"values": np.random.default_rng(seed).standard_normal(200)}


def failing(seed: int) -> dict[str, NDArray[np.float64]]:
    """Fails for one seed."""
    if seed == 1:
        raise ArithmeticError("lost definiteness")
    return quick(seed)


@dataclass(frozen=True)
class Work:
    """Case that another process loads at once."""

    name: str
    run: Callable[[int], dict[str, NDArray[np.float64]]]
    seeds: int

    def key(self) -> str:
        return "0" * 40


SLOW = Work("slow", held_up, seeds=32)
FAILING = Work("failing", failing, seeds=2)

if __name__ == "__main__":
    # the functions by the name under which workers find them
    from reproduction_fakes import SLOW as WORK

    # what a shell starts in the background ignores Ctrl-C, and so would this
    signal.signal(signal.SIGINT, signal.default_int_handler)
    run_missing(Store(Path(sys.argv[1])), [WORK])
