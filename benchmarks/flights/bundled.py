"""Flights of bundled scenarios as they are, with another seed each."""

from __future__ import annotations

from collections.abc import Sequence

from flights.flight import Flight, Random


def scenario(_random: Random, _number: int, *, name: str, settings: Sequence[str] = ()) -> Flight:
    """Flies a bundled scenario.

    Args:
        name: of the scenario.
        settings: overrides of it.
    """
    return Flight(name, ("execution.engine=loop", *settings))
