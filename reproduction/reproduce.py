"""Runs entries, measures their claims, draws their pictures, and writes the report."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

from massprop_drake.results.folder import require_files, resumable_folder, write_files
from reproduction import report
from reproduction.claims import judge
from reproduction.entry import Entry
from reproduction.report import Reproduced
from reproduction.runner import Store, needed, run_missing


def reproduce(
    entries: Sequence[Entry],
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    force: bool = False,
) -> list[Reproduced]:
    """Reproduces some entries into a folder, taking up what an earlier call has finished.

    Args:
        entries: which.
        folder: of reports, `figures/` and `cache/`; new, empty, or an earlier reproduction's.
        progress: called with the number of steps done and of all: runs, and entries drawn.
        force: keep a folder, figures and reports that are there and not ours as `<name>.1`, `<name>.2`, ....

    Raises:
        InputError: when the folder holds something else, cannot be written, or another process is at work in it.
        RuntimeError: when a run fails.
    """
    say = progress or (lambda *_: None)
    with resumable_folder(folder, "reproduction", force=force) as path:
        pictures = [str(_picture_path(name)) for entry in entries for name in entry.pictures]
        require_files(folder, [*pictures, *report.PAGES], force=force)
        store = Store(path / "cache")
        cases = needed(entry.cases for entry in entries)
        runs = sum(case.seeds for case in cases)
        run_missing(store, cases, lambda done, _: say(done, runs + len(entries)))
        results = []
        for number, entry in enumerate(entries, start=1):
            results.append(_judge_entry(entry, store, folder, force=force))
            say(runs + number, runs + len(entries))
        report.write(folder, results, force=force)
        return results


def _judge_entry(entry: Entry, store: Store, folder: Path, *, force: bool) -> Reproduced:
    """Judges the claims of an entry, draws and writes its pictures, and returns the results."""
    phases = store.phases(entry.cases)
    pictures = {}
    for name, draw in entry.pictures.items():
        content = io.BytesIO()
        draw(phases).savefig(content, format="png")
        pictures[_picture_path(name)] = content.getvalue()
    write_files(folder, {str(picture): content for picture, content in pictures.items()}, force=force)
    return Reproduced(entry, tuple(judge(claim, phases) for claim in entry.claims), tuple(pictures))


def _picture_path(name: str) -> Path:
    """Returns the path of a picture, relative to the folder of the reproduction."""
    return Path("figures") / f"{name}.png"
