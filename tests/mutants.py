"""Whether the tests can fail: makes single edits, one at a time, and runs the tests that must notice.

    python tests/mutants.py [WORD ...]

The edits stand in `mutants.yaml`: a file, a text that stands in it once, what is put there instead, and what pytest is
given. With words, only those are made whose file or tests contain one. Each is made in a throw-away copy of the
repository, two at a time. Exit status 1 when one survives, or can no longer be made, or a test fails without any.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from ruamel.yaml import YAML

REPOSITORY = Path(__file__).resolve().parent.parent
LIST = Path(__file__).with_name("mutants.yaml")
WORKERS = 2
LIMIT_S = 600.0  # a hang counts as noticed
NOT_COPIED = (".git", ".venv", "build", "dist", "runs", "__pycache__", ".*_cache", "*.egg-info")
FAILED, INTERRUPTED = 1, 2  # pytest's exit status: a test failed; a test file could not be imported


class Mutant(NamedTuple):
    """One edit.

    Attributes:
        file: below the repository.
        old, new: text, and what takes its place.
        tests: what pytest is given.
    """

    file: str
    old: str
    new: str
    tests: list[str]


def load() -> list[Mutant]:
    """All edits."""
    return [Mutant(**entry) for entry in YAML(typ="safe", pure=True).load(LIST)]


@contextmanager
def made(mutant: Mutant, root: Path) -> Iterator[bool]:
    """Makes an edit for a while; False where its text does not stand in the file exactly once."""
    path = root / mutant.file
    content = path.read_text(encoding="utf-8") if path.exists() else ""
    if content.count(mutant.old) != 1:
        yield False
        return
    try:
        _write(path, content.replace(mutant.old, mutant.new))
        yield True
    finally:
        _write(path, content)


def _write(path: Path, content: str) -> None:
    path.write_text(content, encoding="utf-8")
    # compiled code is told by time in seconds and size, which an edit may leave as they were
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()


def said(tests: list[str], root: Path, limit_s: float | None) -> subprocess.CompletedProcess[str]:
    """What pytest says of some tests, up to the first that fails."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=limit_s, check=False)


def outcome(mutant: Mutant, root: Path) -> tuple[str, str]:
    """What became of an edit, "killed" if it was noticed, and by which test."""
    with made(mutant, root) as applies:
        if not applies:
            return "does not apply", ""
        try:
            done = said(mutant.tests, root, LIMIT_S)
        except subprocess.TimeoutExpired:
            return "killed", f"by time: {LIMIT_S:g} s"
    if done.returncode == FAILED:
        return "killed", next((line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))), "")
    if done.returncode == 0:
        return "survived", ""
    broken = "breaks the import of a test" if done.returncode == INTERRUPTED else "pytest cannot run"
    return broken, (done.stdout + done.stderr)[-500:]


def main() -> int:
    """Makes the edits and prints what becomes of each."""
    words = sys.argv[1:]
    chosen = [m for m in load() if not words or any(word in " ".join([m.file, *m.tests]) for word in words)]
    free: SimpleQueue[Path] = SimpleQueue()
    began, killed = time.monotonic(), 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(WORKERS) as pool:
        for number in range(WORKERS):
            root = Path(folder) / str(number)
            shutil.copytree(REPOSITORY, root, symlinks=True, ignore=shutil.ignore_patterns(*NOT_COPIED))
            free.put(root)

        # `python -m pytest` in the copy puts the copy's package first; nothing else may come before it
        os.environ.pop("PYTHONPATH", None)
        healthy = said(sorted({test for mutant in chosen for test in mutant.tests}), root, None)
        if healthy.returncode != 0:
            print(f"{healthy.stdout[-2000:]}{healthy.stderr[-500:]}\na test fails without any edit")
            return 1

        def run(mutant: Mutant) -> tuple[str, str]:
            root = free.get()
            try:
                return outcome(mutant, root)
            finally:
                free.put(root)

        for mutant, (what, detail) in zip(chosen, pool.map(run, chosen), strict=True):
            killed += what == "killed"
            print(f"{what:14} {mutant.file}: {' '.join(mutant.old.split())[:80]}  {detail}", flush=True)
    print(f"{killed} of {len(chosen)} killed in {time.monotonic() - began:.0f} s")
    return int(killed < len(chosen))


if __name__ == "__main__":
    sys.exit(main())
