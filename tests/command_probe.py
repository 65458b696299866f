"""Helpers of the tests of the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

# of a run's folder
FILES = {
    "report.html",
    "filter_state.json",
    "history.npz",
    "manifest.json",
    "scenario.yaml",
    "summary.json",
    "telemetry.csv",
    "figures",
}


class Outcome(NamedTuple):
    """Exit status of a command, and what it left on the streams."""

    status: int
    out: str
    err: str


Massprop = Callable[..., Outcome]


def require_refused(done: Outcome, *words: str) -> None:
    """Requires one message on the error stream and status 2, and nothing else."""
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1), done
    assert done.err.startswith("massprop: ")
    assert done.err.endswith("\n")
    for word in words:
        assert word in done.err, done.err


def contents() -> dict[str, bytes]:
    """Every file below the current folder."""
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def everything() -> list[str]:
    """Everything below the current folder, by name."""
    return sorted(str(path) for path in Path().rglob("*"))
