"""A cache entry that several ports and an update share, so that they cannot disagree."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from pydrake.common.value import Value
from pydrake.systems.framework import DependencyTicket, LeafSystem, ValueProducer

from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

T = TypeVar("T")

NOTHING = ()  # in an abstract value, which cannot hold None in every version of Drake


class Stopwatch:
    """Adds up the time that a system's mathematics takes, without its inputs' evaluation.

    A measurement of the computer, not of the model: no result depends on it.
    """

    def __init__(self) -> None:
        self.spent_s = 0.0

    def measure(self, function: Callable[..., T], *arguments: Any) -> T:
        """Calls a function and adds the time it took."""
        began = time.perf_counter()
        result = function(*arguments)
        self.spent_s += time.perf_counter() - began
        return result


class Cached:
    """One computation of a system, done once per change of what it depends on.

    Args:
        system: the system it belongs to; Drake keeps what Python has put into a diagram for good in any case.
        description: name of the entry.
        compute: bound method `compute(context) -> result` of the system; a covariance that loses
            definiteness in it is reported with the time and the system's name.
        prerequisites: tickets of all it reads.
    """

    def __init__(
        self,
        system: LeafSystem,
        description: str,
        compute: Callable[[Any], Any],
        prerequisites: Iterable[DependencyTicket],
    ):
        where = f"{system.get_name()}: {description}"

        def calc(context: Any, value: Any) -> None:
            try:
                value.set_value((compute(context),))
            except NotPositiveDefiniteError as error:
                raise error.at(context.get_time(), where) from None

        entry = system.DeclareCacheEntry(
            description, ValueProducer(allocate=lambda: Value[object](NOTHING), calc=calc), set(prerequisites)
        )
        self._entry = entry  # asked for each time, it would take as long as all else
        self.ticket = entry.ticket()

    def get(self, context: Any) -> Any:
        """The result for a context."""
        return self._entry.EvalAbstract(context).get_value()[0]


def state_of(context: Any) -> Array:
    """The discrete state of a system that has one group of it; a copy, since Drake's own changes."""
    vector: Array = context.get_discrete_state_vector().CopyToVector()
    return vector
