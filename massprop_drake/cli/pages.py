"""Pages of existing runs: the report and the replay again, and runs side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from massprop_drake.cli import show
from massprop_drake.cli.streams import say
from massprop_drake.display.run import Run
from massprop_drake.errors import InputError
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.results.folder import is_ours, require_file, require_files, write_files, write_page
from massprop_drake.results.manifest import read as read_manifest
from massprop_drake.results.run_content import read_summary
from massprop_drake.results.summary import Summary

REPORT, REPLAY = "report.html", "replay.html"


def write(
    name: str,
    folder: Path,
    out: Path | None,
    *,
    force: bool,
    watch: Callable[[Path, str], None],
) -> Path:
    """Writes the report or the replay of a run as HTML, into its folder or elsewhere; returns the file's path.

    With a replay in the run's folder its report is written anew, so that it leads there.

    Args:
        name: `REPORT` or `REPLAY`.
        folder: of the run.
        out: the file to write; None: `name` in the run's folder.
        force: keep what is there and not ours.
        watch: is told the file, and what to say once it is written.

    Raises:
        InputError: when there is no such run, or the file cannot be written.
    """
    read_summary(folder)
    kind, target = name.partition(".")[0], out or folder / name
    is_elsewhere = os.path.realpath(target) != os.path.realpath(folder / name)
    if is_elsewhere:
        require_file(target, kind, force=force, reads=[folder])
    else:
        require_files(folder, [name], force=force)
    manifest = read_manifest(folder)
    watch(target, f"the {kind} is saved in {target}")

    run = Run.load(folder)
    if is_elsewhere:
        write_page(target, _page_html(name, run, None), kind, force=force, reads=[folder])
        return target
    pages = {name: _page_html(name, run, folder).encode()}
    if name == REPLAY and (force or is_ours(folder, REPORT)):
        pages[REPORT] = _page_html(REPORT, run, None, replay=REPLAY).encode()
    write_files(folder, pages, force=force, manifest_id=None if manifest is None else manifest.id)
    return target


def _page_html(name: str, run: Run, folder: Path | None, replay: str | None = None) -> str:
    """Returns the report or the replay of a run as HTML; the report links to the replay in the folder."""
    if name == REPLAY:
        from massprop_drake.display.flight3d import replay_html  # noqa: PLC0415 (loads Drake)

        return replay_html(run)
    from massprop_drake.display.page import report_html  # noqa: PLC0415 (loads templates)

    if folder is not None and is_ours(folder, REPLAY):
        replay = REPLAY
    return report_html(run, replay=replay)


def compare(runs: Sequence[Path], out: Path | None, *, force: bool) -> tuple[list[tuple[str, Summary]], Any, Path]:
    """Writes a page that compares runs; returns name and summary of each, their vehicle, and the page's path.

    Args:
        runs: folders, two at least.
        out: the file to write; None: `runs/comparison.html`.
        force: keep what is there and not ours.

    Raises:
        InputError: when they are not runs of one vehicle, or the file cannot be written.
    """
    if len(runs) < 2:
        raise InputError(f"{runs[0]}: give two folders of runs or more to compare")
    summaries = [(str(folder), read_summary(folder)) for folder in runs]
    vehicle = load_scenario(runs[0]).vehicle_data
    for name, results in summaries:
        if (results.vehicle, results.units) != (vehicle.name, vehicle.units):
            raise InputError(
                f"{name}: is of vehicle '{results.vehicle}' in units {results.units}, and {runs[0]} of "
                f"'{vehicle.name}' in {vehicle.units}; compare runs of one vehicle"
            )
    target = out or Path("runs") / "comparison.html"
    if out is None:
        target.parent.mkdir(exist_ok=True)
    require_file(target, "comparison", force=force, reads=runs)
    from massprop_drake.display.comparison import comparison_html  # noqa: PLC0415 (loads templates)

    page = comparison_html([(str(folder), Run.load(folder)) for folder in runs])
    write_page(target, page, "comparison", force=force, reads=runs)
    return summaries, vehicle, target


def print_comparison(summaries: Sequence[tuple[str, Summary]], vehicle: Any, target: Path) -> None:
    """Prints the table of runs side by side, the findings of each run, and the path of the page."""
    show.print_side_by_side(summaries, vehicle)
    show.print_run_findings(summaries, vehicle)
    say(f"plots:       {target}")
