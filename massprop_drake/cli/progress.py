"""A progress bar on a terminal, for long work."""

from __future__ import annotations

import sys
import time
from typing import Any

from rich.console import Console

from massprop_drake.cli.streams import escape_unprintable

AFTER_S = 2.0  # shorter work shows no bar


class Progress:
    """Shows a progress bar on a terminal once the work has taken a while.

    Args:
        title: of the work.
        total: amount of it, in any unit.
        shown: whether a bar may be shown at all.
    """

    def __init__(self, title: str, total: float, *, shown: bool):
        self._title = title
        self._total = total
        self._shown = shown and sys.stderr.isatty()
        self._began = time.monotonic()
        self._bar: Any = None

    def __enter__(self) -> Progress:
        return self

    def __call__(self, reached: float) -> None:
        """Moves the bar to the amount of work that is done, in the unit of the total; short work shows no bar."""
        if not self._shown or time.monotonic() - self._began < AFTER_S:
            return
        if self._bar is None:
            from rich import progress  # noqa: PLC0415 (only for long work)

            title = progress.TextColumn("{task.description}", "progress.description", markup=False)
            _, *others = progress.Progress.get_default_columns()
            console = Console(stderr=True)
            self._bar = progress.Progress(title, *others, console=console, transient=True)
            self._bar.start()
            self._task = self._bar.add_task(escape_unprintable(self._title, console.encoding), total=self._total)
        self._bar.update(self._task, completed=reached)

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
