"""An entry: one figure, table or section of the thesis, with its cases, claims and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from reproduction.cases import Case
from reproduction.claims import Claim, Phases

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Entry:
    """A figure, a table or a section of the thesis.

    Attributes:
        name: as for `--only`.
        title: a line.
        cases: what it needs run, by the label under which claims and pictures find it in a phase.
        claims: what the thesis says of it.
        pictures: functions that draw the results of all phases, by file name.
    """

    name: str
    title: str
    cases: Mapping[str, Case]
    claims: tuple[Claim, ...]
    pictures: Mapping[str, Callable[[Phases], Figure]] = field(default_factory=dict)
