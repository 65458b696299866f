"""Card: performance of the estimator, kind of flight by kind of flight, in one table.

    python benchmarks/card.py [--kinds KIND ...] [--quick] [--first N] [--against COMMIT] [--write docs | baseline]
    python benchmarks/card.py --flight KIND NUMBER
    python benchmarks/card.py --baseline [--write docs]

Flies the kinds of `card.yaml` on this machine's processors, by compiled kernels where numba is installed, and prints
a row a kind. The number of a flight is its seed, and everything in it is drawn from that: a flight flown alone, on
another worker or after a kill is the same bit for bit. Results are kept in `runs/card` by the code that flew them, and
no flight is flown twice. All of it takes a night; `--quick`, a tenth of it, a quarter of an hour on two processors.
`baseline.parquet` has the flights of one version, so that others can be held against it without flying it again;
`--baseline` shows these alone. `docs/card.md` has the columns by which a reader decides, the terminal all of them.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import tarfile
import time
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from flights import table

from massprop_drake.errors import InputError
from massprop_drake.studies.campaign import engine, store
from massprop_drake.studies.campaign.plan import FLOWN

_HERE = Path(__file__).parent
_ROOT = _HERE.parent
_RUNS = Path("runs") / "card"
_BASELINE = _HERE / "baseline.parquet"
_PACKAGE = ("massprop_drake", "diagrams", "scenarios")
_USUAL = 100  # flights of a kind
_QUICK = 10  # a tenth of them
_LIMIT_S, _LIMIT_MB = 3600.0, 4000.0  # of one flight
_SAY_S = 20.0  # between two lines of progress
_COLUMNS = pa.schema(
    [
        *((name, pa.int64()) for name in ("case_id", "number")),
        *((name, pa.string()) for name in ("kind", "status", "reason", "facts", "timed", "worker")),
        *((name, pa.float64()) for name in ("wall_s", "cpu_s")),
    ]
)


class Case(NamedTuple):
    """Flight of the card.

    Attributes:
        case_id: number of its own, from all that it is drawn from.
        kind: of `card.yaml`.
        number: of the flight, its seed.
    """

    case_id: int
    kind: str
    number: int


class Version(NamedTuple):
    """Version of the code that flies.

    Attributes:
        package: folder that holds the package.
        label: commit, and whether there are changes since.
        folder: of its results.
    """

    package: Path
    label: str
    folder: Path


class Card(NamedTuple):
    """Content of `card.yaml`.

    Attributes:
        groups: names of the kinds of each group, by title.
        kinds: what each kind is, by name.
        headlines: sentences for the README with what each is about.
    """

    groups: Mapping[str, Sequence[str]]
    kinds: Mapping[str, Mapping[str, Any]]
    headlines: Sequence[Mapping[str, Any]]


def load_card() -> Card:
    """Reads `card.yaml`."""
    content = yaml.safe_load((_HERE / "card.yaml").read_text())
    groups = content["groups"]
    kinds = {name: spec for group in groups.values() for name, spec in group.items()}
    return Card({title: list(group) for title, group in groups.items()}, kinds, content["headlines"])


def case(card: Card, kind: str, number: int) -> Case:
    """Identifies a flight by its kind, draw and number."""
    spec = card.kinds[kind]
    drawn = [spec["draw"], spec.get("with", {}), spec.get("stream", kind), spec.get("hours", False), kind, number]
    digest = hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).digest()
    return Case(int.from_bytes(digest[:7], "big"), kind, number)


def here(compiled: bool) -> Version:
    """Returns the package beside this folder."""
    try:
        changed = _git("status", "--porcelain", "--", *_PACKAGE)
        label = _git("rev-parse", "--short=12", "HEAD") + (" with changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        label = "unknown"
    return Version(_ROOT, label, _folder(_ROOT, compiled))


def of_commit(commit: str, compiled: bool) -> Version:
    """Unpacks the package of a commit beside the results.

    Raises:
        InputError: when there is no such commit.
    """
    try:
        name = _git("rev-parse", "--short=12", f"{commit}^{{commit}}")
    except subprocess.CalledProcessError:
        raise InputError(f"--against {commit}: there is no such commit") from None
    tree = (_RUNS / "trees" / name).resolve()
    if not tree.exists():
        packed = subprocess.run(["git", "archive", name, *_PACKAGE], cwd=_ROOT, capture_output=True, check=True).stdout
        partial = tree.with_suffix(f".{os.getpid()}")
        with tarfile.open(fileobj=BytesIO(packed)) as archive:
            archive.extractall(partial, filter="data")
        partial.rename(tree)
    return Version(tree, name, _folder(tree, compiled))


def _git(*arguments: str) -> str:
    """Returns the output of a command of git."""
    found = subprocess.run(["git", *arguments], cwd=_ROOT, capture_output=True, check=True, text=True)
    return found.stdout.strip()


def _folder(package: Path, compiled: bool) -> Path:
    """Returns the folder of results, named by all code that makes them."""
    digest = hashlib.sha256()
    drawing = [_HERE / "fly.py", *(_HERE / "flights").glob("[!t]*.py")]  # all but table.py, which judges afterwards
    every = (path for name in _PACKAGE for path in (package / name).rglob("*"))
    flying = [path for path in every if path.suffix in (".py", ".yaml", ".sdf")]
    for path in [*sorted(drawing), *sorted(flying)]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return _RUNS / (digest.hexdigest()[:12] + ("-compiled" if compiled else ""))


def fly(version: Version, card: Card, cases: Sequence[Case], *, compiled: bool, workers: int | None) -> None:
    """Flies those of the cases that have no result yet."""
    version.folder.mkdir(parents=True, exist_ok=True)
    store.remove_failed_rows(version.folder, [one.case_id for one in cases])
    done = {row["case_id"] for row in flown_before(version)}
    todo = [one for one in cases if one.case_id not in done]
    if not todo:
        return
    kept = version.folder / "execution.json"
    execution = json.loads(kept.read_text()) if kept.exists() else None
    setup = {
        "kinds": card.kinds,
        "compiled": compiled,
        "program": str(_HERE / "fly.py"),
        "package": str(version.package),
        "keep": "none",
        "folder": str(version.folder),
    }
    work = engine.CampaignWork(setup, todo, frozenset(), _LIMIT_S, _LIMIT_MB)
    known = {one.case_id: one for one in todo}
    began = said = time.monotonic()
    flown = 0
    with engine.local_client(min(workers or len(os.sched_getaffinity(0)), len(todo))) as client:
        for chunk in engine.fly_chunks(client, work, execution, version.folder):
            if execution is None:
                execution = chunk.execution
                kept.write_text(json.dumps(execution))
            rows = [{**row, **known[row["case_id"]]._asdict()} for row in chunk.rows]
            store.write_rows(version.folder, rows, _COLUMNS)
            flown += len(rows)
            if time.monotonic() - said > _SAY_S or flown == len(todo):
                said = time.monotonic()
                print(f"{flown} of {len(todo)} flights, {said - began:.0f} s", file=sys.stderr, flush=True)


def flown_before(version: Version) -> list[dict[str, Any]]:
    """Returns rows of the flights of a version, the baseline's among them where that is of the same."""
    rows = store.read_rows(version.folder)
    found = {row["case_id"]: row for row in ([] if rows is None else rows.to_pylist())}
    if _BASELINE.exists():
        baseline = pq.read_table(_BASELINE)
        if baseline.schema.metadata[b"version"].decode() == version.folder.name:
            found |= {row["case_id"]: row for row in baseline.to_pylist()}
    return list(found.values())


def baseline(card: Card) -> tuple[Version, dict[str, table.Row]]:
    """The version whose flights `baseline.parquet` has, and their statistics by kind."""
    content = pq.read_table(_BASELINE)
    facts = {key.decode(): text.decode() for key, text in content.schema.metadata.items()}
    flights: dict[str, list[dict[str, Any]]] = {kind: [] for kind in card.kinds}
    for row in content.to_pylist():
        flights[row["kind"]].append(row)
    version = Version(_ROOT, facts["commit"], _RUNS / facts["version"])
    return version, statistics(card, {kind: rows for kind, rows in flights.items() if rows})


def results(version: Version, card: Card, cases: Sequence[Case]) -> dict[str, table.Row]:
    """Computes statistics of the flights by kind."""
    wanted = {one.case_id for one in cases}
    flights: dict[str, list[dict[str, Any]]] = {one.kind: [] for one in cases}
    for row in flown_before(version):
        if row["case_id"] in wanted:
            flights[row["kind"]].append(row)
    return statistics(card, flights)


def statistics(card: Card, flights: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, table.Row]:
    """Statistics of rows of results by kind; says which flights failed to run."""
    for kind, each in flights.items():
        for row in sorted(each, key=lambda row: row["number"]):
            if row["facts"] is None:
                print(f"{kind} {row['number']} failed to run: {row['reason']}", file=sys.stderr)
    return {kind: table.counted(each, card.kinds[kind]) for kind, each in flights.items()}


def document(card: Card, found: Mapping[str, table.Row], version: Version, first: int) -> str:
    """Formats the card with all columns, a table a group."""
    parts = ["# Card", f"Commit `{version.label}`, flights from number {first} on.", table.LEGEND.strip()]
    for title, kinds in card.groups.items():
        rows = [table.cells(card.kinds[kind], found[kind]) for kind in kinds if kind in found]
        if rows:
            parts += [f"## {title}", table.markdown(table.HEADER, rows)]
    return "\n\n".join(parts) + "\n"


def page(card: Card, found: Mapping[str, table.Row], version: Version, first: int) -> str:
    """Formats the page of the card: one table, with the columns by which a reader decides."""
    rows = []
    for title, kinds in card.groups.items():
        of_group = [table.brief_cells(card.kinds[kind], found[kind]) for kind in kinds if kind in found]
        if of_group:
            rows += [[f"**{title}**"], *of_group]  # Markdown fills a short row up
    parts = [
        "# Card",
        "What the estimator is worth, a row for each kind of flight. "
        f"Commit `{version.label}`, flights from number {first} on.",
        table.brief_legend(found.values()),
        table.markdown(table.BRIEF, rows),
        "`benchmarks/card.yaml` says how each kind is drawn. `python benchmarks/card.py --baseline` prints all "
        "columns: intervals, groups, calibration, errors of forces and payloads, time of a step. "
        "`python benchmarks/card.py --write docs` flies all with the present code, and writes this page anew.",
    ]
    return "\n\n".join(parts) + "\n"


def headlines(card: Card, found: Mapping[str, table.Row]) -> str:
    """Formats the sentences of the README."""
    lines = []
    for one in card.headlines:
        rows = [found[kind] for kind in one["kinds"] if kind in found]
        if rows:
            lines.append(f"- {table.headline(one['says'], rows)}")
    return "\n".join([*lines, "", "Shares are in percent, with their 95 % interval."])


def write_docs(card: Card, found: Mapping[str, table.Row], version: Version, first: int) -> None:
    """Writes docs/card.md, and the README's headlines."""
    (_ROOT / "docs" / "card.md").write_text(page(card, found, version, first))
    readme = _ROOT / "README.md"
    text, count = re.subn(
        r"(?s)(<!-- card:headlines -->\n).*?(<!-- /card:headlines -->)",
        lambda match: f"{match[1]}{headlines(card, found)}\n{match[2]}",
        readme.read_text(),
    )
    if count:
        readme.write_text(text)


def write_baseline(version: Version, cases: Sequence[Case]) -> None:
    """Writes the flights of a version into one file."""
    wanted = {one.case_id for one in cases}
    rows = [row for row in flown_before(version) if row["case_id"] in wanted and row["status"] == FLOWN]
    facts = {"version": version.folder.name, "commit": version.label}
    made = pa.Table.from_pylist(sorted(rows, key=lambda row: (row["kind"], row["number"])), schema=_COLUMNS)
    pq.write_table(made.replace_schema_metadata(facts), _BASELINE, compression="zstd", compression_level=19)


def show(card: Card, version: Version, found: Mapping[str, table.Row], first: int, *, write: bool) -> None:
    """Prints the card with all columns, or writes the page and the headlines."""
    if write:
        write_docs(card, found, version, first)
    else:
        print(document(card, found, version, first))
        print(headlines(card, found))


def main() -> None:
    """Flies missing flights, and prints or writes the table."""
    card = load_card()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=list(card.kinds), metavar="KIND", help=", ".join(card.kinds))
    parser.add_argument("--first", type=int, default=0, help="number of the first flight, its seed")
    parser.add_argument("--count", type=int, help="flights of each kind, instead of what card.yaml says")
    parser.add_argument("--quick", action="store_true", help="a tenth of the flights")
    parser.add_argument("--against", metavar="COMMIT", help="fly the same with the package of a commit, and compare")
    parser.add_argument("--commit", metavar="COMMIT", help="the card of another commit's package")
    parser.add_argument(
        "--write", choices=["docs", "baseline"], help="docs/card.md and README's headlines; or baseline.parquet"
    )
    parser.add_argument("--flight", nargs=2, metavar=("KIND", "NUMBER"), help="fly one alone, and print its facts")
    parser.add_argument("--workers", type=int, help="processes; default: one for each processor")
    parser.add_argument("--numpy", action="store_true", help="kernels in numpy, also where numba is installed")
    parser.add_argument("--baseline", action="store_true", help="the table of the flights in baseline.parquet")
    parser.add_argument("--no-flights", action="store_true", help="the table of what has been flown")
    given = parser.parse_args()
    compiled = not given.numpy and importlib.util.find_spec("numba") is not None
    if given.flight:
        from fly import Flights  # noqa: PLC0415 (loads Drake)

        alone = Flights({"kinds": card.kinds, "compiled": compiled})
        print(alone.fly({"kind": given.flight[0], "number": int(given.flight[1])})["facts"])
        return
    if given.baseline:
        show(card, *baseline(card), 0, write=given.write == "docs")
        return
    cases = []
    for kind in given.kinds or card.kinds:
        usual = card.kinds[kind].get("flights", _USUAL)
        count = given.count or (max(1, usual // _QUICK) if given.quick else usual)
        cases += [case(card, kind, number) for number in range(given.first, given.first + count)]
    # the longest first, so that no processor ends alone with them; then a flight of each kind after the other
    cases.sort(key=lambda one: (not card.kinds[one.kind].get("hours", False), one.number))
    version = of_commit(given.commit, compiled) if given.commit else here(compiled)
    versions = [version, *([of_commit(given.against, compiled)] if given.against else [])]
    for each in versions:
        if not given.no_flights:
            fly(each, card, cases, compiled=compiled, workers=given.workers)
    found = [results(each, card, cases) for each in versions]
    if given.against:
        rows = [table.versus(card.kinds[kind], now, found[1][kind]) for kind, now in found[0].items()]
        print(f"{versions[1].label} -> {versions[0].label}\n\n{table.markdown(table.VERSUS, rows)}")
    elif given.write == "baseline":
        write_baseline(version, cases)
    else:
        show(card, version, found[0], given.first, write=bool(given.write))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(f"card: {error}", file=sys.stderr)
        sys.exit(2)
