"""Standard streams of the program: users' text is printed as it is, and a stream that fails stops no work."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast


def escape_unprintable(content: object, encoding: str = "utf-8") -> str:
    r"""Replaces characters that a terminal would obey, or cannot show, by escapes; returns the text.

    All text that is not the program's own passes here on its way to a terminal. Control characters, ends of lines
    among them, escape sequences, marks that turn the direction of writing, lone surrogates, and what the encoding
    lacks stand as escapes such as `\x1b`.

    Args:
        content: what is to be printed, in one line.
        encoding: of the stream.
    """
    shown = "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in str(content))
    return shown.encode(encoding, "backslashreplace").decode(encoding)


def say(line: object) -> None:
    """Prints one line on standard output, however long."""
    _print_line(sys.stdout, line)


def note(line: object) -> None:
    """Prints one line from the program itself on the error stream."""
    _print_line(sys.stderr, f"massprop: {line}")


def _print_line(stream: TextIO, line: object) -> None:
    """Prints one line on a stream, with unprintable characters escaped, at once."""
    stream.write(escape_unprintable(line, stream.encoding or "utf-8") + "\n")
    stream.flush()


class Stream:
    """Standard stream that never raises: after its first failure it takes everything and prints nothing.

    Work whose result cannot be printed is thus finished and saved, and its end tells why nothing was printed.

    Attributes:
        failure: the first one; None: none.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream
        self.failure: OSError | None = None
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Writes text unless the stream has failed, and returns the text's length."""
        self._try_to_print(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flushes the stream unless it has failed."""
        self._try_to_print(self._stream.flush)

    def _try_to_print(self, action: Callable[[], object]) -> None:
        """Calls a function that writes or flushes, unless the stream has failed; stores an OSError it raises."""
        if self.failure is not None:
            return
        try:
            action()
        except OSError as error:
            self.failure = error
            with contextlib.suppress(OSError):  # what still waits goes nowhere when the interpreter ends
                _redirect_to_null(self._stream.fileno(), os.O_WRONLY)


@contextlib.contextmanager
def guard_streams() -> Iterator[Stream]:
    """Replaces, in a with block, the standard streams by ones that never raise; yields standard output.

    A stream that was closed is empty when it is read and fails when it is written to; no file opened later takes
    its place.
    """
    before = sys.stdin, sys.stdout, sys.stderr
    stdin, stdout, stderr = (
        stream or _replace_closed_stream(number, mode)
        for number, (stream, mode) in enumerate(zip(before, "rww", strict=True))
    )
    output = Stream(stdout)
    sys.stdin, sys.stdout, sys.stderr = stdin, cast(TextIO, output), cast(TextIO, Stream(stderr))
    try:
        yield output
    finally:
        sys.stdin, sys.stdout, sys.stderr = before


def _replace_closed_stream(descriptor: int, mode: str) -> TextIO:
    """Opens the null device in place of a standard stream that was closed before the program began."""
    _redirect_to_null(descriptor, os.O_RDONLY)
    return cast(TextIO, open(descriptor, mode, encoding="utf-8", closefd=False))


def _redirect_to_null(descriptor: int, flags: int) -> None:
    """Redirects a file descriptor to the null device."""
    nowhere = os.open(os.devnull, flags)
    if nowhere != descriptor:  # as it is when the descriptor was free
        os.dup2(nowhere, descriptor)
        os.close(nowhere)
