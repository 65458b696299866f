"""Every entry of the reproduction, in the order of the thesis."""

from __future__ import annotations

from massprop_drake.errors import InputError, suggestion
from reproduction.entries import (
    conclusions,
    drawings,
    errata,
    failures,
    maneuver,
    mass,
    rotation,
    soft_failures,
    tables,
    text,
)
from reproduction.entry import Entry

ENTRIES: tuple[Entry, ...] = (
    *drawings.ENTRIES,
    *tables.ENTRIES,
    *maneuver.ENTRIES,
    *rotation.ENTRIES,
    *mass.ENTRIES,
    *text.ENTRIES,
    *failures.ENTRIES,
    *soft_failures.ENTRIES,
    *conclusions.ENTRIES,
    *errata.ENTRIES,
)


def select_entries(names: list[str] | None) -> list[Entry]:
    """Picks entries by name, in the order of the thesis; all of them without names.

    Raises:
        InputError: naming one that there is not.
    """
    known = [entry.name for entry in ENTRIES]
    for name in names or ():
        if name not in known:
            raise InputError(f"'{name}' is no figure or table of the reproduction{suggestion(name, known)}")
    return [entry for entry in ENTRIES if not names or entry.name in names]
