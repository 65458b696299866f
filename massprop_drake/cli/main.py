"""Entry point of the command line: its exit status, and its message when it ends early.

Exit statuses: 0 success, 1 an internal failure or a result that cannot be printed, 2 bad input, 128 and its number
for a signal (130 after Ctrl-C, 143 after SIGTERM). A reader of standard output that leaves is no failure.
"""

from __future__ import annotations

import codecs
import contextlib
import locale
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from massprop_drake.cli.streams import Stream, guard_streams, note
from massprop_drake.errors import InputError, in_words, require_text
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.studies import threads

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
AGAIN_S = 0.5  # after which an interruption that somebody has swallowed is raised again


class Interrupted(BaseException):
    """Signal that asks the program to end."""


class SavedWork:
    """Work that a command has saved on disk, reported when it ends before its result is printed."""

    def __init__(self) -> None:
        self._file: Path | None = None
        self._before: tuple[int, ...] | None = None
        self._written, self._otherwise = "", "nothing was saved"

    def watch(self, file: Path, saved: str, unsaved: str = "nothing was saved") -> None:
        """Sets the file whose change shows that the work is saved, and what to say before and after it.

        Args:
            file: that the command writes last or together with all others.
            saved: what to say once it is another file than now.
            unsaved: what to say until then.
        """
        self._file, self._before, self._written, self._otherwise = file, _file_identity(file), saved, unsaved

    @property
    def saved(self) -> bool:
        """True if the watched file has been written since it was set."""
        return self._file is not None and _file_identity(self._file) != self._before

    def __str__(self) -> str:
        return self._written if self.saved else self._otherwise


def _file_identity(file: Path) -> tuple[int, ...] | None:
    """Returns device, inode and time of change of a file, which a rewrite changes; None: there is no file."""
    try:
        status = os.stat(file)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_mtime_ns


def _load_massprop() -> Any:
    """Imports and returns the Typer app of `massprop`."""
    from massprop_drake.cli.app import app  # noqa: PLC0415 (slow to load, and a signal is told from the start)

    return app


def main(load_app: Callable[[], Any] = _load_massprop, name: str = "massprop") -> None:
    """Runs the command line in `sys.argv` and ends the process with its exit status.

    Args:
        load_app: loads the commands, a `typer.Typer`.
        name: of the program, shown in its help.
    """
    os.environ.update(threads.default_blas_threads(os.environ))  # before numpy is loaded
    status = run(load_app, name)
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # the command has ended: its status stands
    sys.exit(status)


def run(load_app: Callable[[], Any] = _load_massprop, name: str = "massprop") -> int:
    """Runs the command line in `sys.argv`, prints any error as one message, and returns the exit status."""
    saved_work = SavedWork()
    with guard_streams() as output, _raise_on_signals() as received, _print_short_warnings():
        try:
            try:
                status = _run_command(saved_work, load_app, name)
                output.flush()
            except Exception as error:  # the last line of defense: say it
                if received:  # which the code that it met turned into an error of its own
                    raise Interrupted from error
                status = _report_error(error, saved_work)
            status = _report_unprinted(output, saved_work, status)
        except Interrupted:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            word = "interrupted" if received[0] == signal.SIGINT else f"ended by {signal.Signals(received[0]).name}"
            note(f"{word}: {saved_work}")
            status = 128 + received[0]
    return status


def _run_command(saved_work: SavedWork, load_app: Callable[[], Any], name: str) -> int:
    """Checks arguments and locale, runs the command, and returns its exit status."""
    for argument in sys.argv[1:]:
        require_text(argument)
    if codecs.lookup(locale.getpreferredencoding(False)).name == "ascii":
        raise InputError("Drake does not load where text is ASCII, as in the C locale; set PYTHONUTF8=1")
    return load_app()(prog_name=name, standalone_mode=False, obj=saved_work) or 0


def _report_error(error: Any, saved_work: SavedWork) -> int:
    """Prints an error, and what is saved nevertheless, on the error stream; returns the exit status."""
    saved = f"; {saved_work}" if saved_work.saved else ""
    if isinstance(error, InputError):
        note(f"{error}{saved}")
        return 2

    import typer  # noqa: PLC0415 (slow to load)

    usage_error: Any = typer.BadParameter.__base__  # wrong usage of whichever kind
    if isinstance(error, usage_error):
        if message := error.format_message().rstrip("."):  # none where help was shown for want of a command
            note(f"{message}{'' if message.endswith('?') else '.'} {' '.join(error.ctx.get_usage().split())}")
        return 2
    note(f"internal failure: {in_words(error)}{saved}")
    return 1


def _report_unprinted(output: Stream, saved_work: SavedWork, status: int) -> int:
    """Prints, if standard output has failed, that and what is saved; returns the exit status."""
    if output.failure is None:
        return status
    messages = [str(saved_work)] if saved_work.saved else []
    if isinstance(output.failure, BrokenPipeError):  # nobody reads, and is told where it can be read if anywhere
        for line in messages:
            note(line)
        return status
    note("; ".join([f"the result cannot be printed: {output.failure.strerror}", *messages]))
    return status or 1


@contextlib.contextmanager
def _raise_on_signals() -> Iterator[list[int]]:
    """Converts, in a with block, signals to end into an exception; a second signal ends the process at once.

    Code that the exception meets can swallow it, a destructor for one: it is raised again until it is on its way.

    Yields:
        The number of the signal received, if any.
    """
    received: list[int] = []
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    alarm, timer = signal.getsignal(signal.SIGALRM), signal.getitimer(signal.ITIMER_REAL)
    heeded = [number for number, handler in before.items() if handler is not signal.SIG_IGN]

    def receive(number: int, _: FrameType | None) -> None:
        """Raises the exception for a first signal, and has later ones end the process."""
        for heeded_number in heeded:
            signal.signal(heeded_number, signal.SIG_DFL)
        received.append(number)
        signal.signal(signal.SIGALRM, receive_again)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        raise Interrupted

    def receive_again(_: int, __: FrameType | None) -> None:
        """Raises the exception again, until it is on its way."""
        handled = sys.exception()  # what a cleanup that is under way was begun for
        while handled is not None and not isinstance(handled, Interrupted):
            handled = handled.__context__
        if handled is None:
            raise Interrupted

    for number in heeded:
        signal.signal(number, receive)
    try:
        yield received
    finally:
        for number in heeded:
            signal.signal(number, before[number])
        if received:
            signal.signal(signal.SIGALRM, alarm)
            signal.setitimer(signal.ITIMER_REAL, *timer)


@contextlib.contextmanager
def _print_short_warnings() -> Iterator[None]:
    """Prints, in a with block, warnings as one-line messages: those on old names once each."""
    printed: set[str] = set()

    def print_warning(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        """Prints a warning as one line, each text once."""
        place = "" if issubclass(category, RenamedWarning) else f"{filename}:{lineno}: {category.__name__}: "
        words = f"{place}{message}"
        if words not in printed:
            printed.add(words)
            note(words)

    with warnings.catch_warnings():
        warnings.simplefilter("always", RenamedWarning)
        warnings.showwarning = print_warning
        yield
