"""Workers that fly chunks of cases in a child process that can crash, hang or grow without harm.

What runs here, in a worker of Dask or anywhere else, never loads Drake.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import platform
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from massprop_drake.errors import InputError
from massprop_drake.studies.threads import ONE_THREAD

LIFE = 60  # cases that one child flies: Drake keeps 5 to 8 MB of every simulation by a diagram
_LOOK_S = 0.1  # between two looks at a child's memory
_START_S = 120.0  # that a child may take to load everything
_ATTEMPTS = 2  # of a case: a kill from outside, or what the cases before have left in memory, is no fault of it
STARTS = 3  # of a child
_TAIL = 2000  # bytes of what a child said last


class CannotFlyError(RuntimeError):
    """Error of a worker that cannot fly any case."""


class _LostError(RuntimeError):
    """Error of a child that has ended, or been ended, before it answered."""


class Child:
    """Process that flies cases, replaced after a while.

    Args:
        setup: as of `campaign_flight.Flights`.
    """

    def __init__(self, setup: Mapping[str, Any]):
        self._setup = setup
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] | None = None  # its standard error
        self._rest = b""
        self._flown = 0
        self._is_over = False
        self.execution: dict[str, str] = {}

    def fly(self, case: Mapping[str, Any], time_s: float, memory_mb: float) -> dict[str, Any]:
        """Flies one case; returns its row, or text why it failed, with times; raises no exception of the case.

        Args:
            case: the request.
            time_s, memory_mb: what it may take, s of wall time and MB of resident memory.

        Raises:
            CannotFlyError: when no process for it can be started.
        """
        failed = ""
        for _ in range(_ATTEMPTS):
            self._ensure_process()
            self._flown += 1
            began = time.perf_counter()
            try:
                return self._ask(case, time_s, memory_mb)
            except TimeoutError as error:
                failed = str(error)
                break
            except _LostError as error:
                failed = str(error)
        return {"failed": failed, "wall_s": time.perf_counter() - began, "cpu_s": None}

    def close(self) -> None:
        """Ends the process; the next case starts another one."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout, self._stderr):
                if stream is not None:
                    with contextlib.suppress(BrokenPipeError):  # what it has not read
                        stream.close()
            self._process, self._rest, self._flown = None, b"", 0

    def end(self) -> None:
        """Ends the process for good, from any thread: the case in progress fails, and no other is flown."""
        self._is_over = True
        if (process := self._process) is not None:
            process.kill()

    def _ensure_process(self) -> None:
        """Starts a process where none runs, or where the present one has flown its maximum of cases."""
        if self._process is not None and (self._flown >= LIFE or self._process.poll() is not None):
            self.close()
        problem = ""
        for _ in range(STARTS):
            if self._is_over:
                raise CannotFlyError("the campaign has ended")
            if self._process is not None:
                return
            try:
                self._start()
            except (_LostError, TimeoutError) as error:
                problem = str(error)
        if self._process is None:
            raise CannotFlyError(f"{platform.node()}: no process for the cases can be started: {problem}")

    def _start(self) -> None:
        """Starts the process, and sends it the settings common to all cases."""
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 (`close` closes it)
        program, package = ["-m", "massprop_drake.studies.campaign.child"], {}
        if "program" in self._setup:  # as a file: the package may be of a version that has no such child
            program, package = [str(Path(__file__).with_name("child.py"))], {"PYTHONPATH": self._setup["package"]}
        self._process = subprocess.Popen(
            [sys.executable, "-P", *program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env={**os.environ, **package, **ONE_THREAD},
            start_new_session=True,  # Ctrl-C is for whoever started it
        )
        self.execution = self._ask(self._setup, _START_S, float("inf"))["execution"]

    def _ask(self, request: Mapping[str, Any], time_s: float, memory_mb: float) -> dict[str, Any]:
        """Sends a request to the process and returns its answer; ends the process where none comes."""
        try:
            line = self._exchange(json.dumps(request), time_s, memory_mb)
        except (_LostError, TimeoutError):
            self.close()
            raise
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _exchange(self, request: str, time_s: float, memory_mb: float) -> bytes:
        """Sends a line to the process and returns its reply; raises an error beyond limits of time and memory."""
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        began = time.perf_counter()
        ready = select.poll()
        ready.register(process.stdout, select.POLLIN)
        try:
            process.stdin.write(request.encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            raise _LostError(self._describe_end(process)) from None
        while b"\n" not in self._rest:
            if ready.poll(1000.0 * _LOOK_S):
                read = os.read(process.stdout.fileno(), 1 << 20)
                if not read:
                    raise _LostError(self._describe_end(process))
                self._rest += read
            elif time.perf_counter() - began > time_s:
                raise TimeoutError(f"took longer than {time_s:g} s")
            elif _resident_mb(process.pid) > memory_mb:
                raise _LostError(f"needed more than {memory_mb:g} MB of memory")
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _describe_end(self, process: subprocess.Popen[bytes]) -> str:
        """Returns text on how a process ended, with its last output."""
        status = process.wait()
        assert self._stderr is not None
        self._stderr.seek(max(0, self._stderr.seek(0, os.SEEK_END) - _TAIL))
        output = [line.strip() for line in self._stderr.read().decode(errors="replace").splitlines() if line.strip()]
        ending = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        return ": ".join([f"its process {ending}", *output[-1:]])


def _resident_mb(pid: int) -> float:
    """Returns the resident memory of a process, MB; 0 where it has ended."""
    import psutil  # noqa: PLC0415 (optional, comes with Dask)

    try:
        return float(psutil.Process(pid).memory_info().rss) / 1e6
    except psutil.Error:
        return 0.0


_here = threading.local()  # the child of each thread, one where the worker is as we start it
_children: dict[str, list[Child]] = {}  # all of a campaign


def fly_chunk(
    setup: Mapping[str, Any], cases: Sequence[Mapping[str, Any]], time_s: float, memory_mb: float
) -> dict[str, Any]:
    """Flies a chunk of cases in a child process, as a Dask task; returns answers, execution and worker.

    Args:
        setup: as of `campaign_flight.Flights`, with `key`, which tells it from others. With `program`, a file, its
            `Flights` fly the cases, with the package that is in the folder `package`.
        cases: requests.
        time_s, memory_mb: what each may take.

    Returns:
        `answers`, one for each case; `execution` of the process that flew them; `worker`, the machine.

    Raises:
        CannotFlyError: when no process for them can be started.
    """
    child: Child | None = getattr(_here, "child", None)
    if child is None or _here.key != setup["key"]:
        if child is not None:
            child.close()
        child = _here.child = Child(setup)
        _here.key = setup["key"]
        _children.setdefault(setup["key"], []).append(child)
    answers = [child.fly(case, time_s, memory_mb) for case in cases]
    return {"answers": answers, "execution": child.execution, "worker": platform.node()}


def end_campaign_work(key: str) -> None:
    """Ends all child processes of a worker for a campaign, by the campaign's key."""
    for child in _children.pop(key, []):
        child.end()


@atexit.register
def _end_all() -> None:
    """Ends all child processes of this worker when it exits."""
    for key in list(_children):
        end_campaign_work(key)


def require_shared(setup: Mapping[str, Any]) -> None:
    """Checks that this worker sees the driver's campaign folder, where run folders may be kept.

    Args:
        setup: `folder`, and `token`: the name of a file that the driver has put into it; None where none are kept.

    Raises:
        InputError: when it is not.
    """
    if setup["token"] is not None and not Path(setup["folder"], setup["token"]).is_file():
        raise InputError(
            f"{platform.node()} does not see {setup['folder']}, in which run folders are to be kept; give a folder "
            "that all machines share, or `keep: none`"
        )
