"""A campaign's folder: its file, its plan and its results, a Parquet file for each of them and for each chunk.

The folder is the truth: what is in it has been flown, and nothing else needs to be remembered to go on.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from massprop_drake.errors import InputError
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.studies.campaign.plan import PlannedCase

PLAN, RESULTS, CASES, FILE, BASE = "plan.parquet", "results", "cases", "campaign.yaml", "base.yaml"
_PARTIAL = ".part"
# what depends on where and when a case was flown, not on the case
CIRCUMSTANCES = ("wall_s", "cpu_s", "worker")

_DECLARED = pa.struct(
    [
        ("kind", pa.string()),
        ("cluster", pa.int64()),
        ("jet", pa.string()),
        ("onset_s", pa.float64()),
        ("time_s", pa.float64()),
        ("magnitude", pa.float64()),
        ("magnitude_std", pa.float64()),
        ("statistic", pa.float64()),
        ("withdrawn_s", pa.float64()),
        ("false", pa.bool_()),
        ("cause", pa.string()),
    ]
)
_TEXTS = ("kind", "jet", "outcome", "taken_for")
_INJECTED = pa.struct(
    [(name, pa.string() if name in _TEXTS else pa.float64()) for name in InjectedRecord._fields]
)  # fmt: skip


def schema(times_s: Sequence[float]) -> pa.Schema:
    """Columns of the results of a campaign that keeps errors at some times besides the end."""
    number, text = pa.float64(), pa.string()
    columns: list[tuple[str, pa.DataType]] = [
        ("case_id", pa.int64()),
        ("status", text),  # flown, or failed to run
        ("reason", text),  # why it failed to run
        ("failing", pa.list_(text)),
        ("duration_s", number),
    ]
    for suffix in ("", *(f"@{time:g}" for time in times_s)):
        for what in ("estimate", "error", "sigma", *(("truth",) if not suffix else ())):
            columns += [(f"{what}{suffix}.{name}", number) for name in NAMES]
    columns += [
        ("largest_sigmas", number),
        ("worst_parameter", text),
        ("nees.rotation", number),
        ("nees.mass", number),
        ("nis.rotation", number),
        ("nis.translation", number),
        ("samples", pa.int64()),
        ("converged_s", number),
        ("injected", pa.list_(_INJECTED)),
        ("declared", pa.list_(_DECLARED)),
        ("n_false", pa.int64()),
        ("jets_out_of_use", pa.list_(text)),
        ("healthy_jets_out", pa.list_(text)),
        ("firings", pa.int64()),
        ("propellant_mass", number),
        ("lp_infeasible", pa.int64()),
        ("wall_s", number),
        ("cpu_s", number),
        ("worker", text),
    ]
    return pa.schema(columns)


def write_table(path: Path, table: pa.Table) -> None:
    """Writes a Parquet file whole or not at all."""
    with _whole(path) as partial:
        pq.write_table(table, partial)


def write_text(path: Path, text: str) -> None:
    """Writes a file of text whole or not at all."""
    with _whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yields the name of a file to write, which takes the place of another once it is written."""
    partial = path.with_name(f".{path.name}{_PARTIAL}")  # one process at a time is at work in the folder
    try:
        yield partial
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def tidy(folder: Path) -> None:
    """Removes what interrupted writing left."""
    for path in [*folder.glob(f".*{_PARTIAL}"), *(folder / RESULTS).glob(f".*{_PARTIAL}")]:
        path.unlink(missing_ok=True)


# --------------------------------------------------------------------------------------------- plan


def write_plan(folder: Path, cases: Iterable[PlannedCase], facts: Mapping[str, str]) -> None:
    """Writes every case, with what is drawn in columns of their own.

    Args:
        folder: the campaign's.
        cases: all of them.
        facts: about the plan as a whole, such as the digest of the campaign, kept as metadata.
    """
    rows = []
    for case in cases:
        given = {**{f"draw.{label}": value for label, value in case.drawn.items()}}
        given |= {f"sweep.{key}": value for key, value in case.swept.items()}
        rows.append(
            {
                "case_id": case.case_id,
                "sample": case.sample,
                "cell": case.cell,
                "seed": case.seed,
                "digest": case.digest,
                "record": case.record,
                **{name: _cell(value) for name, value in given.items()},
                "case": json.dumps(case._asdict()),
            }
        )
    table = pa.Table.from_pylist(rows)
    write_table(folder / PLAN, table.replace_schema_metadata({**facts}))


def _cell(value: Any) -> Any:
    return value if isinstance(value, (int, float, str, bool)) or value is None else json.dumps(value)


def read_plan(folder: Path) -> tuple[list[PlannedCase], dict[str, str]]:
    """Reads back what `write_plan` wrote: cases and facts.

    Raises:
        InputError: when there is no plan that can be read.
    """
    table, facts = _plan(folder, "case")
    return [PlannedCase(**json.loads(text)) for text in table["case"].to_pylist()], facts


def read_facts(folder: Path) -> dict[str, str]:
    """The facts alone.

    Raises:
        InputError: when there is no plan that can be read.
    """
    return _plan(folder, "case_id")[1]


def _plan(folder: Path, column: str) -> tuple[pa.Table, dict[str, str]]:
    path = folder / PLAN
    try:
        table = pq.read_table(path, columns=[column])
    except FileNotFoundError:
        raise InputError(f"{folder}: holds no campaign: there is no {PLAN}") from None
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    return table, {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}


def read_draws(folder: Path) -> pa.Table:
    """The plan as a table: sample, cell, seed, and what was drawn and swept, without the cases as such."""
    table = pq.read_table(folder / PLAN)
    return table.drop_columns(["case", "digest"])


# ------------------------------------------------------------------------------------------ results


def write_rows(folder: Path, rows: Sequence[Mapping[str, Any]], columns: pa.Schema) -> Path:
    """Writes the rows of one chunk."""
    place = folder / RESULTS
    place.mkdir(exist_ok=True)
    first, last = rows[0]["case_id"], rows[-1]["case_id"]
    path = place / f"{first:06d}-{last:06d}.parquet"
    write_table(path, pa.Table.from_pylist([dict(row) for row in rows], schema=columns))
    return path


def flown_ids(folder: Path) -> set[int]:
    """Numbers of the cases that have a row."""
    found: set[int] = set()
    for path in _chunks(folder):
        found.update(_read(path, ["case_id"])["case_id"].to_pylist())
    return found


def read_rows(folder: Path, columns: Sequence[str] | None = None) -> pa.Table | None:
    """All rows in the order of their cases; None where there are none."""
    tables = [_read(path, columns) for path in _chunks(folder)]
    if not tables:
        return None
    return pa.concat_tables(tables).sort_by("case_id")


def _chunks(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / RESULTS).glob("*.parquet") if not path.name.startswith("."))


def _read(path: Path, columns: Sequence[str] | None) -> pa.Table:
    try:
        return pq.read_table(path, columns=None if columns is None else list(columns))
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {error}; remove it, and --resume flies its cases again") from None
