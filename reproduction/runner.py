"""Runs cases in two processes and keeps each result in a file of its own.

A file appears whole or not at all, and its name holds a digest of all that the result depends on, so
that work interrupted at any time goes on where it was: what is there and can be read in full is taken,
everything else is run.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from massprop_drake.results.exchange import recover, stage
from massprop_drake.studies.processes import defer_ctrl_c

if TYPE_CHECKING:  # a process that runs cases loads no more than these need
    from reproduction.cases import Case
    from reproduction.claims import Phase, Signals


WORKERS = 2
_BATCH = 120  # runs of one pair of processes: with some versions of Drake memory grows with every run
_KEY = 20  # hexadecimal digits of a digest in a file's name
_RESULT = re.compile(rf"(?P<case>.+)-\d\d-(?P<key>[0-9a-f]{{{_KEY}}})\.npz")


class Store:
    """Keeps the results of cases, a file per case and seed.

    Args:
        folder: where; made when it is not there.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        recover(folder)
        self._keys: dict[str, str] = {}

    def path(self, case: Case, seed: int) -> Path:
        """Returns the path of the file of one result."""
        key = self._keys.get(case.name) or self._keys.setdefault(case.name, case.key()[:_KEY])
        return self._folder / f"{case.name}-{seed:02d}-{key}.npz"

    def get(self, case: Case, seed: int) -> Signals | None:
        """Reads a result; None where there is none that can be read in full."""
        return _read(self.path(case, seed))

    def missing(self, cases: Iterable[Case]) -> list[tuple[Case, int, Path]]:
        """Lists what is still to be run: case, seed and file to write."""
        wanted = [(case, seed, self.path(case, seed)) for case in cases for seed in range(case.seeds)]
        return [(case, seed, path) for case, seed, path in wanted if _read(path) is None]

    def phases(self, cases: Mapping[str, Case]) -> list[Phase]:
        """Reads the results of cases by label, phase by phase; a case of one seed is part of every phase.

        Raises:
            LookupError: when one has not been run.
        """
        seeds = _phase_count(cases)
        single = {label: self._require_result(case, 0) for label, case in cases.items() if case.seeds == 1}
        several = {label: case for label, case in cases.items() if case.seeds > 1}
        return [
            single | {label: self._require_result(case, seed) for label, case in several.items()}
            for seed in range(seeds)
        ]

    def _require_result(self, case: Case, seed: int) -> Signals:
        """Reads a result; raises LookupError where it has not been run."""
        result = self.get(case, seed)
        if result is None:
            raise LookupError(f"case '{case.name}', seed {seed}, has not been run")
        return result

    def tidy(self) -> None:
        """Removes superseded results of known cases."""
        for path in self._folder.glob("*.npz"):
            name = _RESULT.fullmatch(path.name)
            if name and self._keys.get(name["case"], name["key"]) != name["key"]:
                path.unlink(missing_ok=True)


def _phase_count(cases: Mapping[str, Case]) -> int:
    """Counts the phases that all of some cases have, those of one seed being part of every phase."""
    return min((case.seeds for case in cases.values() if case.seeds > 1), default=1)


def needed(groups: Iterable[Mapping[str, Case]]) -> list[Case]:
    """Merges groups of cases: each case once, with as many seeds as the phases of its largest group."""
    merged: dict[str, Case] = {}
    for cases in groups:
        phases = _phase_count(cases)
        for case in cases.values():
            seeds = min(case.seeds, phases)
            if case.name not in merged or merged[case.name].seeds < seeds:
                merged[case.name] = replace(case, seeds=seeds)
    return list(merged.values())


def run_missing(store: Store, cases: Sequence[Case], progress: Callable[[int, int], None] | None = None) -> int:
    """Runs what is missing of some cases, and returns the number of runs.

    Args:
        store: keeps the results.
        cases: to run, each once.
        progress: called with the number of runs done and of all, those found included.

    Raises:
        RuntimeError: when a run fails, naming it.
    """
    total = sum(case.seeds for case in cases)
    work = store.missing(cases)
    done = total - len(work)
    report = progress or (lambda *_: None)
    report(done, total)
    remaining = iter(work)
    while batch := list(islice(remaining, _BATCH)):
        for _ in _run_batch(batch):
            done += 1
            report(done, total)
    store.tidy()
    return len(work)


def _run_batch(batch: list[tuple[Case, int, Path]]) -> Iterable[None]:
    """Runs a batch of cases in worker processes, and yields after each."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(WORKERS, len(batch)), mp_context=context, initializer=_start_worker)
    try:
        with defer_ctrl_c():  # also in the workers, which inherit it while they load
            futures = {pool.submit(_run_one, *work): work for work in batch}
        for future in as_completed(futures):
            case, seed, _ = futures[future]
            try:
                future.result()
            except (ArithmeticError, ValueError) as error:
                raise RuntimeError(f"case '{case.name}', seed {seed}: {error}") from error
            yield
    finally:
        pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Arranges that a worker ends when its parent is gone; after Ctrl-C it waits for the runs under way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    """Waits for the end of the parent process, then exits."""
    parent.join()
    os._exit(1)


def _run_one(case: Case, seed: int, path: Path) -> None:
    """Runs one case with a seed and writes its result."""
    write_result(path, case.run(seed))


def write_result(path: Path, result: Signals) -> None:
    """Writes one result, whole or not at all."""
    with stage(path.parent) as prepared:
        partial = prepared.partial / path.name
        np.savez_compressed(partial, **result)  # type: ignore[arg-type]
        partial.replace(path)


def _read(path: Path) -> Signals | None:
    """Reads a result's arrays in full; None when the file is missing or not whole."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, KeyError):
        return None
