"""Runs entries, measures their claims, draws their pictures, and writes the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from massprop_drake.results.folder import resumable_folder
from massprop_drake.studies.reproduction import report
from massprop_drake.studies.reproduction.claims import judge
from massprop_drake.studies.reproduction.entry import Entry
from massprop_drake.studies.reproduction.report import Reproduced
from massprop_drake.studies.reproduction.runner import Store, needed, run_missing


def reproduce(
    entries: Sequence[Entry], folder: Path, progress: Callable[[int, int], None] | None = None
) -> list[Reproduced]:
    """Reproduces some entries into a folder, taking up what an earlier call has finished.

    Args:
        entries: which.
        folder: of reports, `figures/` and `cache/`; new, empty, or an earlier reproduction's.
        progress: called with the number of steps done and of all: runs, and entries drawn.

    Raises:
        InputError: when the folder holds something else or cannot be written.
        RuntimeError: when a run fails.
    """
    resumable_folder(folder, "reproduction")
    store = Store(folder / "cache")
    (folder / "figures").mkdir(exist_ok=True)
    say = progress or (lambda *_: None)
    cases = needed(entry.cases for entry in entries)
    runs = sum(case.seeds for case in cases)
    run_missing(store, cases, lambda done, _: say(done, runs + len(entries)))
    results = []
    for number, entry in enumerate(entries, start=1):
        results.append(_reproduced(entry, store, folder))
        say(runs + number, runs + len(entries))
    report.write(folder, results)
    return results


def _reproduced(entry: Entry, store: Store, folder: Path) -> Reproduced:
    phases = store.phases(entry.cases)
    pictures = []
    for name, draw in entry.pictures.items():
        picture = Path("figures") / f"{name}.png"
        draw(phases).savefig(folder / picture)
        pictures.append(picture)
    return Reproduced(entry, tuple(judge(claim, phases) for claim in entry.claims), tuple(pictures))
