"""Stopwatch for the mathematics of a cycle, by part."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from contextvars import ContextVar, Token
from time import perf_counter
from typing import Any, TypeVar

from massprop_drake.maths.estimation.cycle import DETECTOR, ESTIMATORS

__all__ = ["DETECTOR", "ESTIMATORS", "JET_SELECTION", "Stopwatch", "time_call"]

T = TypeVar("T")

JET_SELECTION = "jet_selection"  # a part of a cycle besides those of `maths.estimation.cycle`


class Stopwatch:
    """Adds up the time of systems' mathematics while it runs, without the evaluation of their inputs.

        with Stopwatch() as watch:
            simulator.AdvanceTo(10.0)
        watch.spent_s[ESTIMATORS]

    A measurement of the computer, not of the model: no result depends on it. It belongs to whoever runs a diagram, so
    that systems remember nothing of it; where none runs, nothing is measured.

    Attributes:
        spent_s: time by part, s; a part that has not been called is not in it.
    """

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self._tokens: list[Token[dict[str, float] | None]] = []

    def __enter__(self) -> Stopwatch:
        self._tokens.append(_RUNNING.set(self.spent_s))
        return self

    def __exit__(self, *_: object) -> None:
        _RUNNING.reset(self._tokens.pop())


_RUNNING: ContextVar[dict[str, float] | None] = ContextVar("stopwatch", default=None)


def time_call(part: str, function: Callable[..., T], *arguments: Any) -> T:
    """Calls a function and returns its result; adds the time it took to a part of the running stopwatch."""
    spent_s = _RUNNING.get()
    if spent_s is None:
        return function(*arguments)
    began = perf_counter()
    result = function(*arguments)
    spent_s[part] += perf_counter() - began
    return result
