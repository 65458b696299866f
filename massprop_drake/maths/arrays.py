"""Named fields of packed vectors: of ports, states and logs.

    IMPULSES = Layout("impulses", angular_impulse=3, linear_impulse=3, usable=FLAG, firing=FLAG)
    IMPULSES.read(vector).usable                  # in place of vector[6] != 0.0
    IMPULSES.columns(log)["angular_impulse"]      # of a log with a row per sample

No vector is indexed by bare numbers elsewhere.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import nan, prod
from operator import itemgetter, methodcaller
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NUMBER, FLAG = "number", "flag"  # a field of one element: read as a float, and as whether it is not zero

Shape = int | str | tuple[int | str, ...]


class Field(NamedTuple):
    """A field that is logged under its own name, as a signal.

    Attributes:
        label: what it is, in words.
        unit: with {length}, {mass}, {force} for the vehicle's units; "-" for none.
        component: name of its one column; the field's own where empty.
        shape: see `Layout`.
    """

    label: str
    unit: str = "-"
    component: str = ""
    shape: Shape = NUMBER


class Layout:
    """Layout of a packed vector: its fields in their order.

    Args:
        name: of the vector.
        fields: of each its size, its shape (filled row by row), NUMBER or FLAG, or a `Field`. A size may be a word
            such as "jets", which `sized` replaces.

    Attributes:
        size: number of elements.
        logged: the fields that are signals.
    """

    def __init__(self, name: str, /, **fields: Shape | Field):
        self.name = name
        self.logged = {key: field for key, field in fields.items() if isinstance(field, Field)}
        self._shapes: dict[str, Shape] = {
            key: field.shape if isinstance(field, Field) else field for key, field in fields.items()
        }
        self._made = _named_tuple(name, tuple(fields))
        self._slices: dict[str, slice] = {}
        self._of_sizes: dict[tuple[tuple[str, int], ...], Layout] = {}
        sizes = [_sizes(shape) for shape in self._shapes.values()]
        if any(isinstance(size, str) for part in sizes for size in part):
            return  # of no size before `sized`
        edges = np.cumsum([0, *(prod(part) for part in sizes)]).tolist()
        self.size: int = edges[-1]
        self._slices = {key: slice(*pair) for key, pair in zip(self._shapes, pairwise(edges), strict=True)}
        places = [
            part.start if shape in (NUMBER, FLAG) else part
            for shape, part in zip(self._shapes.values(), self._slices.values(), strict=True)
        ]
        self._parts: Callable[[Array], tuple[Any, ...]] = (
            itemgetter(*places) if len(places) > 1 else lambda vector: (vector[places[0]],)
        )
        self._places = [
            (place, isinstance(shape, tuple)) for place, shape in zip(places, self._shapes.values(), strict=True)
        ]
        # fields that are not just a view
        self._converted = [
            (index, _converter(shape))
            for index, shape in enumerate(self._shapes.values())
            if not isinstance(shape, int)
        ]

    def __repr__(self) -> str:
        return f"<Layout {self.name}: {self.describe()}>"

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def sized(self, **sizes: int) -> Layout:
        """Returns the layout with named sizes replaced by numbers, as `LAYOUT.sized(jets=44)`; cached."""
        key = tuple(sizes.items())
        if key not in self._of_sizes:
            self._of_sizes[key] = self._replace_sizes(sizes)
        return self._of_sizes[key]

    def _replace_sizes(self, sizes: dict[str, int]) -> Layout:
        """Makes a new layout with named sizes replaced by numbers."""

        def replace_words(shape: Shape) -> Shape:
            """Replaces the names of sizes in one field's shape by numbers."""
            if isinstance(shape, tuple):
                return tuple(sizes.get(part, part) if isinstance(part, str) else part for part in shape)
            return sizes.get(shape, shape) if isinstance(shape, str) else shape

        fields: dict[str, Shape | Field] = {key: replace_words(shape) for key, shape in self._shapes.items()}
        logged = {key: field._replace(shape=replace_words(field.shape)) for key, field in self.logged.items()}
        return Layout(self.name, **(fields | logged))

    def slice(self, name: str) -> slice:
        """Returns the slice of the vector that holds a field."""
        return self._slices[name]

    def read(self, vector: Array) -> Any:
        """Unpacks a vector into a named tuple of its fields: array views, floats and booleans."""
        values: Any = self._parts(vector)
        if self._converted:
            values = list(values)
            for index, converted in self._converted:
                values[index] = converted(values[index])
        return _new(self._made, values)

    def make(self, **values: Any) -> Any:
        """Makes a named tuple of the layout's fields by name; NaN where no value is passed."""
        return self._made._make([values.get(key, nan) for key in self._shapes])

    def pack(self, values: Sequence[Any]) -> Array:
        """Packs fields into a vector in their order, shape (size,): the inverse of `read`."""
        vector = np.empty(self.size)
        for (place, is_matrix), value in zip(self._places, values, strict=True):
            vector[place] = value.ravel() if is_matrix else value
        return vector

    def columns(self, log: Array) -> dict[str, Array]:
        """Splits a log, a row per sample, into a dict from each field to its columns, shape (n, field size)."""
        return {key: log[:, part] for key, part in self._slices.items()}

    def shapes(self) -> Iterator[tuple[str, tuple[int | str, ...]]]:
        """Yields each field's name and shape; (1,) for a number or a flag."""
        return ((key, _sizes(shape)) for key, shape in self._shapes.items())

    def describe(self) -> str:
        """Describes all fields and their sizes in a line, as a port's documentation lists them."""
        return ", ".join(f"{key} ({' x '.join(map(str, shape))})" for key, shape in self.shapes())


_new: Any = tuple.__new__


def _converter(shape: Shape) -> Callable[[Any], Any]:
    """Returns the function that converts a field's slice to bool, float or an array of its shape."""
    if shape == FLAG:
        return bool
    return float if shape == NUMBER else methodcaller("reshape", shape)


def _named_tuple(name: str, fields: tuple[str, ...]) -> Any:
    """Makes the named tuple class of a layout's fields, once per name and fields."""
    return namedtuple(name, fields)


def _sizes(shape: Shape) -> tuple[int | str, ...]:
    """Returns a field's shape as a tuple, (1,) for a number or a flag."""
    if shape in (NUMBER, FLAG):
        return (1,)
    return shape if isinstance(shape, tuple) else (shape,)
