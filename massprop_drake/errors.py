"""Error that says what is wrong with a user's input, and words that its messages share."""

from __future__ import annotations

import contextlib
import difflib
import logging
from collections.abc import Iterable, Iterator


class InputError(ValueError):
    """Bad input: a file, a field, an option.

    Args:
        problems: one sentence each, saying what, where, and what would be right.
    """

    def __init__(self, *problems: str):
        self.problems = problems
        more = len(problems) - 1
        tail = "" if more == 0 else f" (and {more} more problem{'s' if more > 1 else ''})"
        super().__init__(problems[0] + tail)


def in_words(error: BaseException) -> str:
    """Describes an error in one line, for messages."""
    if isinstance(error, InputError):
        return str(error)
    if not isinstance(error, Exception):
        return "interrupted"
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def require_text(name: str) -> None:
    """Checks that a name or an argument is text that a result can hold; raises InputError if not.

    Raises:
        InputError: when it has bytes that are no text, or the character NUL.
    """
    if "\0" in name:
        raise InputError(f"{name}: has the character NUL, which no file's name has")
    if any("\ud800" <= character <= "\udfff" for character in name):
        raise InputError(f"{name}: has bytes that are no text in this system's encoding; rename what is named so")


def moment(time_s: float) -> str:
    """Formats a time in s for messages: six digits, and a hundredth of a second also where that takes more."""
    return f"{time_s:.6g}" if abs(time_s) < 1e4 else f"{time_s:.2f}".rstrip("0").rstrip(".")


def counted(count: int, noun: str) -> str:
    """Formats a count with its noun, plural but for one, such as "3 jets"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def suggestion(word: object, known: Iterable[str]) -> str:
    """Suggests a close valid word ('; did you mean ...?'), or lists the valid words."""
    valid = [*known]
    close = difflib.get_close_matches(str(word), valid, n=1)
    if close:
        return f"; did you mean '{close[0]}'?"
    shown = ", ".join(valid[:30]) + (", ..." if len(valid) > 30 else "")
    return f"; valid are: {shown}" if valid else ""


def dotted(path: tuple[str | int, ...]) -> str:
    """Formats the path of a field in an input file, such as jets[3].direction."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
    return text


@contextlib.contextmanager
def collect_drake_warnings() -> Iterator[list[str]]:
    """Collects the warnings that Drake logs, in place of its lines on the error stream."""
    messages: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            """Stores the message of a log record."""
            messages.append(record.getMessage())

    log = logging.getLogger("drake")
    handlers, propagates = log.handlers, log.propagate
    log.handlers, log.propagate = [Collector(logging.WARNING)], False
    try:
        yield messages
    finally:
        log.handlers, log.propagate = handlers, propagates
