"""Exports of runs for the viewers of others: as files, or played to a viewer that is open."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from massprop_drake.cli.streams import note
from massprop_drake.display import export
from massprop_drake.display.run import Run
from massprop_drake.errors import InputError
from massprop_drake.results.folder import require_file, require_files, write_file, write_files
from massprop_drake.results.manifest import read as read_manifest
from massprop_drake.results.run_content import read_summary


class WrittenExport(NamedTuple):
    """Export that was written.

    Attributes:
        file: path.
        bytes: size.
        rows: samples in it.
        signals: names of the signals in it.
        notes: sentences on what the run does not tell.
    """

    file: str
    bytes: int
    rows: int
    signals: list[str]
    notes: list[str]


class ExportOptions(NamedTuple):
    """Options of an export.

    Attributes:
        to: name of the format.
        epoch: time of the run's time zero, in seconds since 1970 or as a date; None: times are those of the run.
        force: keep what is there and not ours.
    """

    to: str
    epoch: str | None
    force: bool


def write(folder: Path, out: Path | None, options: ExportOptions, watch: Callable[[Path, str], None]) -> WrittenExport:
    """Writes a run as a file for a viewer; returns the file's path, size, number of rows and signals.

    Args:
        folder: of the run.
        out: the file to write; None: `run.<ending>` in the run's folder.
        options: format and options.
        watch: is told the file, and what to say once it is written.

    Raises:
        InputError: when there is no such run or format, or the file cannot be written.
    """
    chosen, epoch_s = export.find_format(options.to), parse_epoch(options.epoch)
    read_summary(folder)
    name = f"run.{chosen.ending}"
    target = out or folder / name
    is_elsewhere = os.path.realpath(target) != os.path.realpath(folder / name)
    if is_elsewhere:
        require_file(target, chosen.name, force=options.force, reads=[folder])
    else:
        require_files(folder, [name], force=options.force)
    manifest = read_manifest(folder)
    watch(target, f"the export is saved in {target}")
    run = Run.load(folder)
    content = export.Content(run, epoch_s=epoch_s)

    def write_export(path: Path) -> None:
        """Writes the export to a path."""
        export.write(content, options.to, path)

    if is_elsewhere:
        write_file(target, write_export, chosen.name, force=options.force, reads=[folder])
    else:
        write_files(
            folder, {name: write_export}, force=options.force, manifest_id=None if manifest is None else manifest.id
        )
    return WrittenExport(
        str(target), target.stat().st_size, run.time_s.size, list(content.outline.series), list(content.outline.notes)
    )


def play(folder: Path, options: ExportOptions, port: int | None, speed: float, *, quiet: bool) -> str:
    """Plays a run to a viewer on this machine until its end, and returns the viewer's address.

    Raises:
        InputError: when there is no such run or format, or no viewer.
    """
    export.find_format(options.to)
    epoch_s = parse_epoch(options.epoch)
    read_summary(folder)
    replay = export.Replay(Run.load(folder), options.to, port=port, speed=speed, epoch_s=epoch_s)
    if not quiet:
        note(
            f"waiting for a viewer at {replay.address}; in Foxglove: Open connection, Foxglove WebSocket"
            if replay.is_served
            else f"the run is shown by the viewer at {replay.address}"
        )
    replay.play()
    return replay.address


def parse_epoch(epoch: str | None) -> float | None:
    """Parses seconds since 1970, or an ISO date (in UTC by default), to seconds since 1970; None stays None."""
    if epoch is None:
        return None
    try:
        return float(epoch)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(epoch)
    except ValueError:
        raise InputError(f"--epoch {epoch}: must be seconds since 1970 or a date such as 2026-03-01T12:00:00") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
