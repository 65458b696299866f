"""Cache entries: results that several ports and an update share, so that they cannot disagree, and workspaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import Any, Generic, TypeVar

from pydrake.common.value import Value
from pydrake.systems.framework import DependencyTicket, LeafSystem, ValueProducer

from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

T = TypeVar("T")
Part = slice | Callable[[Any], Array]  # of a cached row, or what is made of a cached result

NOTHING = ()  # in an abstract value, which cannot hold None in every version of Drake


class Cached:
    """Computation of a system, done once per change of its inputs.

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
        label = f"{system.get_name()}: {description}"

        def calc(context: Any, value: Any) -> None:
            """Computes the result for a context, and stores it in the cache entry."""
            try:
                value.set_value(_Result((compute(context),)))
            except NotPositiveDefiniteError as error:
                raise error.at(context.get_time(), label) from None

        entry = system.DeclareCacheEntry(
            description, ValueProducer(allocate=lambda: Value[object](NOTHING), calc=calc), set(prerequisites)
        )
        self._entry = entry  # asked for each time, it would take as long as all else
        self.ticket = entry.ticket()

    def get(self, context: Any) -> Any:
        """Returns the result for a context, computed anew only where a prerequisite has changed."""
        return self._entry.EvalAbstract(context).get_value()[0]


class _Result(tuple[Any]):
    """Result in a context. Never changed, so that a clone of the context shares it."""

    __slots__ = ()

    def __deepcopy__(self, _memo: Any) -> _Result:
        return self


class Scratch(Generic[T]):
    """Workspace of which each context has its own, and which a computation may change.

    No answer may depend on what the workspace has been used for: it saves time alone. In Drake a cache entry that
    depends on nothing; a clone of a context begins with a new one.

    Args:
        system: the system it belongs to.
        description: name of the entry.
        make: makes a workspace.
    """

    def __init__(self, system: LeafSystem, description: str, make: Callable[[], T]):
        producer = ValueProducer(allocate=lambda: Value[object](_Workspace(make)), calc=lambda _context, _value: None)
        self._entry = system.DeclareCacheEntry(description, producer, {system.nothing_ticket()})

    def get(self, context: Any) -> T:
        """Returns the workspace that belongs to a context."""
        workspace: T = self._entry.EvalAbstract(context).get_value().get()
        return workspace


class _Workspace(Generic[T]):
    """Workspace of a `Scratch` in a context, made when it is first asked for."""

    def __init__(self, make: Callable[[], T]):
        self._make = make
        self._made: tuple[T, ...] = ()

    def get(self) -> T:
        """Returns the workspace, which the first call makes."""
        if not self._made:
            self._made = (self._make(),)
        return self._made[0]

    def __deepcopy__(self, _memo: Any) -> _Workspace[T]:
        """Returns an empty workspace, for the clone of a context to make its own."""
        return _Workspace(self._make)


def declare_output(
    system: LeafSystem, name: str, size: int, compute: Callable[[Any], Any], prerequisites: Iterable[DependencyTicket]
) -> None:
    """Declares a vector output port that a function of the context computes, with tickets of its inputs."""
    system.DeclareVectorOutputPort(
        name,
        size,
        lambda context, output: output.SetFromVector(compute(context)),
        prerequisites_of_calc=set(prerequisites),
    )


def declare_outputs(system: LeafSystem, entry: Cached, ports: Iterable[tuple[str, int, Part]]) -> None:
    """Declares vector output ports, name, size and selection each, that select from a cached result."""
    for name, size, selection in ports:
        select = _make_selector(selection)
        declare_output(system, name, size, lambda context, select=select: select(entry.get(context)), {entry.ticket})  # type: ignore[misc]


def declare_update(system: LeafSystem, entry: Cached, period_s: float, selection: Part) -> None:
    """Declares a periodic update that sets the discrete state, one group, to a selection of a cached result."""
    select = _make_selector(selection)

    def update(context: Any, state: Any) -> None:
        """Writes the selected part of the cached result into the discrete state."""
        state.set_value(select(entry.get(context)))

    system.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=update)


def _make_selector(selection: Part) -> Callable[[Any], Array]:
    """Makes a function that selects part of a cached result."""
    return itemgetter(selection) if isinstance(selection, slice) else selection


def state_of(context: Any) -> Array:
    """Returns a copy of the discrete state vector of a system that has one group of it."""
    vector: Array = context.get_discrete_state_vector().CopyToVector()
    return vector
