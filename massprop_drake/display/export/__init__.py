"""Exports of a run for other viewers: Foxglove and PlotJuggler by MCAP, and Rerun."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from massprop_drake.display.export.content import Content as Content
from massprop_drake.display.export.content import SampleBlock
from massprop_drake.errors import InputError

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

_FRAME_S = 0.05  # between two things that are sent to a viewer
_LOOK_S = 0.5  # between two looks at whether a viewer has come


class Format(NamedTuple):
    """Format of an export.

    Attributes:
        name: as `--to` takes it.
        ending: of its files.
        package: of Python that writes it.
        module: of ours that calls the package.
    """

    name: str
    ending: str
    package: str
    module: str


FORMATS = {
    one.name: one
    for one in (
        Format("mcap", "mcap", "foxglove-sdk", "foxglove_stream"),
        Format("rerun", "rrd", "rerun-sdk", "rerun_stream"),
    )
}


def find_format(name: str) -> Format:
    """Returns the export format of a name, such as "mcap".

    Raises:
        InputError: when there is none, or the package that writes it is not installed.
    """
    if name not in FORMATS:
        raise InputError(f"'{name}' is no format to export to; valid are: {', '.join(FORMATS)}")
    _load_stream_module(FORMATS[name])
    return FORMATS[name]


def write(content: Content, format_name: str, path: Path) -> None:
    """Writes a run's content into a new file in an export format, chosen by name.

    Raises:
        InputError: when the format is not known, or its package is missing.
    """
    _load_stream_module(find_format(format_name)).write(content, path)


class Replay:
    """Plays a run to a viewer on this machine at the speed at which it happened.

    Args:
        run: simulated, or estimated from telemetry.
        to: name of the format, whose viewer it is.
        port: of the viewer or, for Foxglove, of the server that it connects to; None: the usual one.
        speed: times real time.
        epoch_s: time of the run's time zero, s since 1970; None: times are those of the run.

    Attributes:
        address: of the viewer or the server.
        is_served: whether the viewer connects to us, so that it has to be waited for.

    Raises:
        InputError: as `write`; or there is no viewer, the port is taken, or the speed is not above zero.
    """

    def __init__(
        self, run: RunContent, to: str, *, port: int | None = None, speed: float = 1.0, epoch_s: float | None = None
    ):
        if not (math.isfinite(speed) and speed > 0.0):
            raise InputError(f"--speed {speed:g}: must be a number above zero, such as 10 for ten times real time")
        stream = _load_stream_module(find_format(to))
        self._content, self._speed = Content(run, epoch_s=epoch_s), speed
        self._viewer = stream.connected(self._content.outline, stream.PORT if port is None else port)
        self.address: str = self._viewer.address
        self.is_served: bool = self._viewer.is_served

    def play(self) -> None:
        """Waits for a viewer, then sends it the run's samples at their times; returns at the end of the run."""
        try:
            while not self._viewer.wait(_LOOK_S):
                pass
            self._viewer.begin()
            began = time.monotonic()
            for block in self._content.stretches():
                for part in _split_block(block, round(1e9 * _FRAME_S * self._speed)):
                    due_s = 1e-9 * int(part.time_ns[0] - self._content.outline.start_ns) / self._speed
                    time.sleep(max(0.0, began + due_s - time.monotonic()))
                    self._viewer.put(part)
        finally:
            self.close()

    def close(self) -> None:
        """Closes the connection to the viewer; `play` does so itself."""
        self._viewer.close()


def _split_block(block: SampleBlock, length_ns: int) -> Iterator[SampleBlock]:
    """Yields a sample block in shorter blocks of some length, ns, or of one row."""
    first, times = 0, block.time_ns
    for row in range(1, times.size + 1):
        if row == times.size or times[row] - times[first] >= length_ns:
            yield block.part(first, row)
            first = row


def _load_stream_module(target: Format) -> Any:
    """Imports the module that writes an export format; InputError if its package is missing."""
    try:
        return import_module(f"{__name__}.{target.module}")
    except ImportError:
        raise InputError(
            f"exporting to {target.name} needs {target.package}: pip install 'massprop-drake[{target.name}]'"
        ) from None
