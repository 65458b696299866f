"""What the tests of the command line share."""

from __future__ import annotations

from collections.abc import Callable
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
    """What a command left on the streams, and its exit status."""

    status: int
    out: str
    err: str


Massprop = Callable[..., Outcome]
