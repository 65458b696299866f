"""Parts of a run, made one by one, so that a failure of one leaves the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from massprop_drake.errors import in_words
from massprop_drake.inputs.model import Real, Text

_Part = TypeVar("_Part")


class EarlyEnd(NamedTuple):
    """End of a run that did not reach the end of its scenario or record.

    Attributes:
        time_s: of the last sample, s.
        reason: why it ended.
    """

    time_s: Real
    reason: Text


class PartsMade:
    """Makes parts of a run's output, and notes those that fail.

    Args:
        strict: raise what a part raises, instead.

    Attributes:
        missing: a line for each part that could not be made, with the reason.
        error: the first that was noted; None: none.
    """

    def __init__(self, *, strict: bool = False):
        self._strict = strict
        self.missing: list[str] = []
        self.error: Exception | None = None

    def make(self, name: str, make: Callable[[], _Part], substitute: _Part) -> _Part:
        """Returns the result of a callable; where it raises, notes name and reason, and returns a substitute."""
        try:
            return make()
        except Exception as error:
            if self._strict:
                raise
            self.note(name, error)
            return substitute

    def note(self, name: str, error: Exception) -> None:
        """Appends name and reason to the list of missing parts, and stores the first error."""
        self.missing.append(f"{name}: {in_words(error)}")
        self.error = self.error or error
