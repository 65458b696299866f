"""Named numeric parameters of a system."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector_, NumericParameterIndex

from massprop_drake.errors import InputError, suggestion

_GROUP = 0  # the one group of a system's numeric parameters


class Named(NamedTuple):
    """Named parameter.

    Attributes:
        default: its value in a new context, a number or a vector.
        labels: of the elements of a vector, such as "xyz"; a number has none.
    """

    default: ArrayLike
    labels: Sequence[str] = ()


class Parameters:
    """Reads and sets a system's numeric parameters in a context, by name.

        plant.parameters.get(context).mass
        plant.parameters.set(context, mass=120.0, center_of_mass=[0.1, 0.0, 0.0])
        plant.parameters.set(context, inertia_xx=35.0)

    `SetRandomContext`, Drake's, puts parameters back to their defaults: set them after it.

    The context is the system's own: `plant.GetMyMutableContextFromRoot(root)` in a diagram. To Drake the parameters are
    one group, `context.get_numeric_parameter(0)`, with its elements in the order of `names`.

    Args:
        system: that has them.
        scalar: its scalar type T.
        fields: the parameters by name, in their order.

    Attributes:
        names: of the elements: a number's own, a vector's with the element's label, as in `center_of_mass_x`.
        defaults: values of the elements in a new context.
        ticket: for what depends on them.
    """

    def __init__(self, system: Any, scalar: Any, fields: Mapping[str, Named]):
        self._system = system
        self._record = _record(fields)
        self._places: dict[str, int | slice] = {}
        names: list[str] = []
        values: list[float] = []
        for name, (default, labels) in fields.items():
            begin = len(names)
            names += [f"{name}_{label}" for label in labels] or [name]
            values += np.ravel(default).tolist()
            self._places[name] = slice(begin, len(names)) if labels else begin
        self.names, self.defaults = tuple(names), np.array(values)
        if self.defaults.size != len(names):
            raise ValueError(f"parameters {', '.join(fields)}: {len(names)} names for {self.defaults.size} values")
        vector = BasicVector_[scalar](len(names))
        vector.SetFromVector(np.array([scalar(value) for value in values]))
        system.DeclareNumericParameter(vector)
        self.ticket = system.numeric_parameter_ticket(NumericParameterIndex(_GROUP))

    def get(self, context: Any) -> Any:
        """Returns all parameters in a context, as a named tuple of numbers and vectors."""
        self._system.ValidateContext(context)
        vector = self.vector(context)
        return self._record._make([vector[place] for place in self._places.values()])

    def vector(self, context: Any) -> Any:
        """Returns all elements in the order of `names`, shape (n,)."""
        return context.get_numeric_parameter(_GROUP).CopyToVector()

    def element(self, context: Any, name: str) -> Any:
        """Returns one element by its name."""
        return context.get_numeric_parameter(_GROUP).GetAtIndex(self.names.index(name))

    def set(self, context: Any, **values: Any) -> None:
        """Writes parameters, or single elements of them, into a context, and leaves the others unchanged.

        Raises:
            InputError: when there is no such parameter, or a value has not its size.
        """
        self._system.ValidateContext(context)
        vector = self.vector(context)
        for name, value in values.items():
            place = self._places.get(name, self.names.index(name) if name in self.names else None)
            if place is None:
                known = [*self._places, *self.names]
                raise InputError(f"{self._describe_parameter(name)}: no such parameter{suggestion(name, known)}")
            size = np.shape(vector[place])
            expected = f"a vector of {size[0]} numbers" if size else "a number"
            try:
                array = np.asarray(value, dtype=float if vector.dtype == float else None)
            except (TypeError, ValueError):
                raise InputError(f"{self._describe_parameter(name)}: must be {expected}, got {value!r}") from None
            if array.shape != size:
                raise InputError(f"{self._describe_parameter(name)}: must be {expected}, got shape {array.shape}")
            if array.dtype != object and not np.isfinite(array).all():
                raise InputError(f"{self._describe_parameter(name)}: must be finite, got {value}")
            vector[place] = array[()]
        context.get_mutable_numeric_parameter(_GROUP).SetFromVector(vector)

    def _describe_parameter(self, name: str) -> str:
        """Names a parameter and its system, for messages."""
        return f"parameter '{name}' of {self._system.get_name()}"


def _record(fields: Mapping[str, Named]) -> Any:
    """Makes a named tuple class with the fields of a system."""
    return namedtuple("Values", list(fields))
