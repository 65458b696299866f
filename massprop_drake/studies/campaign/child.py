"""Process that flies cases, one after the other: reads requests and writes results, a JSON line each.

It is a process of its own because a run can crash or hang in compiled code, and because memory of Drake grows with
every simulation; whoever started it replaces it. It ends with the one that started it, and when nobody asks anything
of it any more.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

_PARENT_DEATH_SIGNAL = 1  # of Linux's prctl
IDLE_S = 60  # without a request: whoever ran the campaign has been killed, and its worker waits for another


def main() -> None:
    """Flies the cases requested on standard input and replies with a JSON line each, until the input ends."""
    _end_with_the_parent()
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # whatever prints must not come between
    requests = _read_requests()
    setup = next(requests, None)
    if setup is None:
        return

    from massprop_drake.errors import InputError  # noqa: PLC0415 (the parent's end is to be noticed from the first)
    from massprop_drake.studies.campaign.execution import execution  # noqa: PLC0415

    flights = _make_flights(setup)
    _reply(replies, {"execution": execution(compiled=flights.compiled)})
    for request in requests:
        began, spent = time.perf_counter(), time.process_time()
        try:
            answer: dict[str, Any] = {"row": flights.fly(request)}
        except InputError as error:
            answer = {"failed": str(error)}
        except Exception as error:  # a case that raises is a result, too
            answer = {"failed": f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"}
        answer |= {"wall_s": time.perf_counter() - began, "cpu_s": time.process_time() - spent}
        _reply(replies, answer)


def _make_flights(setup: Mapping[str, Any]) -> Any:
    """Loads the module that flies cases, and makes an object of its class Flights, see `worker.fly_chunk`."""
    if "program" not in setup:
        from massprop_drake.studies.campaign.campaign_flight import Flights  # noqa: PLC0415 (loads Drake)

        return Flights(setup)
    sys.path.insert(0, os.path.dirname(setup["program"]))
    spec = importlib.util.spec_from_file_location("program", setup["program"])
    assert spec is not None
    assert spec.loader is not None
    program = importlib.util.module_from_spec(spec)
    sys.modules["program"] = program
    spec.loader.exec_module(program)
    return program.Flights(setup)


def _read_requests() -> Iterator[dict[str, Any]]:
    """Yields requests, JSON lines on standard input; an alarm ends the process when idle for `IDLE_S`."""
    while True:
        signal.alarm(IDLE_S)
        line = sys.stdin.readline()
        signal.alarm(0)
        if not line:
            return
        yield json.loads(line)


def _reply(stream: TextIO, content: dict[str, Any]) -> None:
    """Writes one reply as a JSON line."""
    stream.write(json.dumps(content) + "\n")


def _end_with_the_parent() -> None:
    """Arranges that this process ends when its parent process has been killed."""
    parent = os.getppid()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)

    def watch() -> None:
        """Polls the parent process, and exits when it is gone."""
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main()
