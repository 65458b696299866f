"""Whether the tests can fail: makes single edits, one at a time, and runs the tests that must notice.

    python tests/mutants.py [WORD ...]
    python tests/mutants.py --random 200 --seed 1

The edits stand in `mutants.yaml`: a file, a text that stands in it once, what is put there instead, and what pytest is
given. With words, only those are made whose file or tests contain one. Each is made in a throw-away copy of the
repository, two at a time. Exit status 1 when one survives, or can no longer be made, or a test fails without any.

With `--random`, edits of the estimation and of the systems are drawn (`random_edits`). All tests are run once to see
which run which line; then each edit meets the quickest of those that run its line. Exit status 1 when less than
80 % are noticed: some edits change nothing that anybody could see.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from coverage import CoverageData
from random_edits import draw
from ruamel.yaml import YAML

REPOSITORY = Path(__file__).resolve().parent.parent
LIST = Path(__file__).with_name("mutants.yaml")
WORKERS = 2
LIMIT_S = 600.0  # a hang counts as noticed
DRAWN_FROM = ("massprop_drake/maths/estimation", "massprop_drake/systems")
BUDGET_S = 30.0  # of tests that a drawn edit meets, as long as they took without it: a compute budget
SHARE = 0.8  # of drawn edits that must be noticed
NOT_COPIED = (".git", ".venv", "build", "dist", "runs", "__pycache__", ".*_cache", "*.egg-info")
FAILED, INTERRUPTED, USAGE = 1, 2, 4  # pytest's exit status: a test failed; a test file, or conftest, is not imported


class Mutant(NamedTuple):
    """One edit.

    Attributes:
        file: below the repository.
        old, new: text, and what takes its place.
        tests: what pytest is given.
        shown: the edit in a line.
    """

    file: str
    old: str
    new: str
    tests: list[str]
    shown: str = ""


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
        if not mutant.tests:
            return "not run", "by any test"
        try:
            done = said(mutant.tests, root, LIMIT_S)
        except subprocess.TimeoutExpired:
            return "killed", f"by time: {LIMIT_S:g} s"
    if done.returncode == FAILED:
        return "killed", next((line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))), "")
    if done.returncode == 0:
        return "survived", ""
    if mutant.shown and done.returncode in (INTERRUPTED, USAGE):
        return "killed", "by import"
    broken = "breaks the import of a test" if done.returncode == INTERRUPTED else "pytest cannot run"
    return broken, (done.stdout + done.stderr)[-500:]


def drawn(number: int, seed: int, root: Path) -> list[Mutant]:
    """Edits drawn at random, each with the tests that run its line, quickest first, within the budget."""
    by_line, seconds = _runs_of(root)
    paths = [path for room in DRAWN_FROM for path in (root / room).rglob("*.py")]
    by_file = defaultdict(set)  # lines that run at import, such as constants, are what any test of the file may notice
    for (file, _), tests_of_line in by_line.items():
        by_file[file] |= tests_of_line
    found = []
    for edit in draw(paths, number, seed):
        name = str(edit.path.relative_to(root))
        tests, spent = [], 0.0
        for test in sorted(by_line[name, edit.line] or by_file[name], key=lambda test: (seconds.get(test, 0.0), test)):
            spent += seconds.get(test, 0.0)
            if tests and spent > BUDGET_S:
                break
            tests.append(test)
        found.append(Mutant(name, edit.path.read_text(encoding="utf-8"), edit.text, tests, edit.shown))
    return found


def _runs_of(root: Path) -> tuple[dict[tuple[str, int], set[str]], dict[str, float]]:
    """Tests that run each line of each file, and the seconds that each takes, from one run of all."""
    report = root / "report.xml"
    flags = ["--cov=massprop_drake", "--cov-context=test", "--cov-report=", f"--junitxml={report}"]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not documentation"]
    subprocess.run([*command, "-n", str(WORKERS), *flags, "tests"], cwd=root, check=True)
    seconds: dict[str, float] = defaultdict(float)
    for case in ET.parse(report).iter("testcase"):
        file = case.attrib["classname"].replace(".", "/") + ".py"
        seconds[f"{file}::{case.attrib['name']}"] += float(case.attrib["time"])
    of_file = defaultdict(list)
    for test in seconds:
        of_file[test.partition("::")[0]].append(test)
    data = CoverageData(str(root / ".coverage"))
    data.read()
    by_line: dict[tuple[str, int], set[str]] = defaultdict(set)
    for path in data.measured_files():
        name = os.path.relpath(os.path.realpath(path), root)
        for line, contexts in data.contexts_by_lineno(path).items():
            for context in contexts:
                test, _, part = context.partition("|")
                # what a fixture runs may be shared: any test of the file may be the one that looks at it
                by_line[name, line] |= set(of_file[test.partition("::")[0]] if part == "setup" else {test}) - {""}
    return by_line, seconds


def main() -> int:
    """Makes the edits and prints what becomes of each."""
    parser = argparse.ArgumentParser(description="Makes single edits and runs the tests that must notice.")
    parser.add_argument("words", nargs="*", metavar="WORD", help="of files or tests of the listed edits to make")
    parser.add_argument("--random", type=int, metavar="N", help="draw N edits in place of the listed ones")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    asked = parser.parse_args()
    free: SimpleQueue[Path] = SimpleQueue()
    began, killed = time.monotonic(), 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(WORKERS) as pool:
        roots = [Path(os.path.realpath(folder)) / str(number) for number in range(WORKERS)]
        for root in roots:
            shutil.copytree(REPOSITORY, root, symlinks=True, ignore=shutil.ignore_patterns(*NOT_COPIED))
            free.put(root)
        # `python -m pytest` in the copy puts the copy's package first; nothing else may come before it
        os.environ.pop("PYTHONPATH", None)
        if asked.random:
            chosen, share = drawn(asked.random, asked.seed, roots[0]), SHARE
        else:
            words = asked.words or [""]
            chosen = [m for m in load() if any(word in " ".join([m.file, *m.tests]) for word in words)]
            share = 1.0
            healthy = said(sorted({test for mutant in chosen for test in mutant.tests}), roots[0], None)
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
            shown = mutant.shown or " ".join(mutant.old.split())[:80]
            print(f"{what:14} {mutant.file}: {shown}  {detail}", flush=True)
    print(f"{killed} of {len(chosen)} killed in {time.monotonic() - began:.0f} s")
    return int(killed < share * len(chosen))


if __name__ == "__main__":
    sys.exit(main())
