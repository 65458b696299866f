"""Flies chunks of cases in a child process that can crash, hang or grow without harm.

What runs here, in a worker of Dask or anywhere else, never loads Drake.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_LIFE = 60  # cases that one child flies: Drake 1.51 keeps 7 MB of every simulation
_LOOK_S = 0.25  # between two looks at a child's memory
_START_S = 120.0  # that a child may take to load everything
_ATTEMPTS = 2  # a child killed from outside took an innocent case with it


class CannotFlyError(RuntimeError):
    """A worker that cannot fly any case."""


class Child:
    """A process that flies cases, replaced when its time has come.

    Args:
        setup: as of `flight.Flights`.
    """

    def __init__(self, setup: Mapping[str, Any]):
        self._setup = setup
        self._process: subprocess.Popen[bytes] | None = None
        self._rest = b""
        self._flown = 0
        self.execution: dict[str, str] = {}

    def fly(self, case: Mapping[str, Any], time_s: float, memory_mb: float) -> dict[str, Any]:
        """The answer to one case: `row` or `failed`, with times; never an exception of the case.

        Args:
            case: the request.
            time_s, memory_mb: what it may take, s of wall time and MB of resident memory.
        """
        answer: dict[str, Any] = {}
        for _ in range(_ATTEMPTS):
            self._ready()
            began = time.perf_counter()
            answer = self._ask(json.dumps(case), time_s, memory_mb)
            self._flown += 1
            if "crashed" not in answer:
                break
        if "crashed" in answer:
            answer = {"failed": answer["crashed"], "wall_s": time.perf_counter() - began, "cpu_s": None}
        return answer

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    stream.close()
            self._process, self._rest, self._flown = None, b"", 0

    def _ready(self) -> None:
        """Starts a process where there is none, or the one that there is has flown enough."""
        if self._flown >= _LIFE:
            self.close()
        if self._process is not None:
            return
        one_thread = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "massprop_drake.studies.campaign.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **one_thread},
        )
        hello = self._ask(json.dumps(self._setup), _START_S, float("inf"))
        if "execution" not in hello:
            self.close()
            raise CannotFlyError(f"a process for the cases does not start: {hello.get('failed') or hello['crashed']}")
        self.execution = hello["execution"]

    def _ask(self, request: str, time_s: float, memory_mb: float) -> dict[str, Any]:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        began = time.perf_counter()
        try:
            process.stdin.write(request.encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            return self._ended(process)
        while b"\n" not in self._rest:
            if select.select([process.stdout], [], [], _LOOK_S)[0]:
                read = os.read(process.stdout.fileno(), 1 << 20)
                if not read:
                    return self._ended(process)
                self._rest += read
                continue
            spent = time.perf_counter() - began
            if spent > time_s:
                self.close()
                return {"failed": f"took longer than {time_s:g} s", "wall_s": spent, "cpu_s": None}
            used = _resident_mb(process.pid)
            if used > memory_mb:
                self.close()
                return {"failed": f"needed more than {memory_mb:g} MB of memory", "wall_s": spent, "cpu_s": None}
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _ended(self, process: subprocess.Popen[bytes]) -> dict[str, Any]:
        status = process.wait()
        self.close()
        if status < 0:
            return {"crashed": f"its process was ended by {signal.Signals(-status).name}"}
        return {"crashed": f"its process ended with status {status}"}


def _resident_mb(pid: int) -> float:
    import psutil  # noqa: PLC0415 (optional, comes with Dask)

    try:
        return float(psutil.Process(pid).memory_info().rss) / 1e6
    except psutil.Error:
        return 0.0


_children: dict[str, Child] = {}


def fly_chunk(
    setup: Mapping[str, Any], cases: Sequence[Mapping[str, Any]], time_s: float, memory_mb: float
) -> dict[str, Any]:
    """Flies some cases; a task of Dask.

    Args:
        setup: as of `flight.Flights`, with `key`, its digest.
        cases: requests.
        time_s, memory_mb: what each may take.

    Returns:
        `answers`, one for each case, and `execution`: of the process that flew them.
    """
    key = setup["key"]
    for other in [name for name in _children if name != key]:
        _children.pop(other).close()
    if key not in _children:
        _children[key] = Child(setup)
        atexit.register(_children[key].close)
    child = _children[key]
    return {"answers": [child.fly(case, time_s, memory_mb) for case in cases], "execution": child.execution}


def shares_folder(folder: str, token: str) -> bool:
    """Whether this worker sees the driver's folder."""
    return Path(folder, token).is_file()
