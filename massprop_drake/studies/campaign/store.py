"""Storage of a campaign: its file, its plan and its results, a Parquet file for each of them and for each chunk.

The folder is the truth: what is in it has been flown, and nothing else needs to be remembered to go on.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign_file import CampaignSpec, campaign_from
from massprop_drake.inputs.yaml import Document, read_text
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.results.exchange import stage
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.studies.campaign.plan import FAILED, PlannedCase

PLAN, RESULTS, CASES, FILE, BASE = "plan.parquet", "results", "cases", "campaign.yaml", "base.yaml"
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


def planned_spec(folder: Path) -> CampaignSpec:
    """Reads the campaign that a folder was planned for, from the files within the folder."""
    text = read_text(folder / FILE)
    document = Document(text, str(folder / FILE))
    document.data["base"] = str((folder / BASE).resolve())
    document.data.pop("set", None)  # is in the base
    return campaign_from(document, folder)


def schema(times_s: Sequence[float]) -> pa.Schema:
    """Returns Parquet columns of a campaign's results, with errors at the end and at some times, s."""
    number, text = pa.float64(), pa.string()
    columns: list[tuple[str, pa.DataType]] = [
        ("case_id", pa.int64()),
        ("status", text),  # FLOWN or FAILED
        ("reason", text),  # why it failed to run
        ("failing", pa.list_(text)),
        ("duration_s", number),
    ]
    for suffix in ("", *(f"@{time:g}" for time in times_s)):
        for quantity in ("estimate", "error", "sigma", *(("truth",) if not suffix else ())):
            columns += [(f"{quantity}{suffix}.{name}", number) for name in NAMES]
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


def write_text(path: Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    with stage(path.parent) as prepared:
        partial = prepared.partial / path.name
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)


def _write(path: Path, table: pa.Table) -> None:
    """Writes a Parquet file whole or not at all, with checksums."""
    with stage(path.parent) as prepared:
        partial = prepared.partial / path.name
        pq.write_table(table, partial, write_page_checksum=True)
        partial.replace(path)


def _read(path: Path, columns: Sequence[str] | None, required_column: str, remedy: str) -> pa.Table:
    """Reads some columns of a campaign's Parquet file as a table; InputError if it is missing or damaged.

    Args:
        path: of the file.
        columns: to read; None: all.
        required_column: a column that it must have.
        remedy: what to do about a damaged one.
    """
    chosen = None if columns is None else list(columns)
    try:
        table = pq.read_table(path, columns=chosen, page_checksum_verification=True)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: is damaged: {' '.join(str(error).split())}; {remedy}") from None
    if not {*(chosen or (required_column,))} <= set(table.column_names):
        raise InputError(f"{path}: is not as a campaign writes it; {remedy}")
    return table


# --------------------------------------------------------------------------------------------- plan


def write_plan(folder: Path, cases: Sequence[PlannedCase], metadata: Mapping[str, str]) -> None:
    """Writes the plan as a Parquet file: every case, with its draws in columns of their own.

    Args:
        folder: the campaign's.
        cases: all of them.
        metadata: about the plan as a whole, such as the digest of the campaign.
    """
    columns = {
        "case_id": pa.array([case.case_id for case in cases], pa.int64()),
        "sample": pa.array([case.sample for case in cases], pa.int64()),
        "cell": pa.array([case.cell for case in cases], pa.int64()),
        "seed": pa.array([case.seed for case in cases], pa.int64()),
        "digest": pa.array([case.digest for case in cases], pa.string()),
        "record": pa.array([case.record for case in cases], pa.string()),
    }
    for label in cases[0].drawn:
        columns[f"draw.{label}"] = _to_column([case.drawn[label] for case in cases])
    for key in cases[0].swept:
        columns[f"sweep.{key}"] = _to_column([case.swept[key] for case in cases])
    columns["case"] = pa.array([json.dumps(case._asdict()) for case in cases], pa.string())
    _write(folder / PLAN, pa.table(columns).replace_schema_metadata(metadata))


def write_metadata(folder: Path, metadata: Mapping[str, str]) -> None:
    """Replaces the metadata that are stored with the plan."""
    _write(folder / PLAN, _read_plan_table(folder, None).replace_schema_metadata(metadata))


def _to_column(values: Sequence[Any]) -> pa.Array:
    """Converts values to a Parquet column: numbers, words or booleans as such, others and mixtures as JSON."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(value is None or abs(value) <= 2**53 for value in values):
        return pa.array(values, pa.int64())
    if kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if kinds in ({str}, {bool}):
        return pa.array(values)
    return pa.array([json.dumps(value) for value in values], pa.string())


def read_plan(folder: Path) -> tuple[list[PlannedCase], dict[str, str]]:
    """Reads a plan's cases and its metadata; InputError where no plan can be read."""
    table = _read_plan_table(folder, ["case"])
    return [PlannedCase(**json.loads(text)) for text in table["case"].to_pylist()], _metadata(table)


def read_metadata(folder: Path) -> dict[str, str]:
    """Reads a plan's metadata, without the cases; InputError where no plan can be read."""
    return _metadata(_read_plan_table(folder, ["case_id"]))


def _metadata(table: pa.Table) -> dict[str, str]:
    """Returns a table's metadata as text by key."""
    return {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}


def read_draws(folder: Path) -> pa.Table:
    """Reads the plan as a table of sample, cell, seed, draws and swept values, without the JSON of the cases."""
    return _read_plan_table(folder, None).drop_columns(["case", "digest"])


def _read_plan_table(folder: Path, columns: Sequence[str] | None) -> pa.Table:
    """Reads some columns of the plan as a table; InputError where there is no plan."""
    if not (folder / PLAN).is_file():
        raise InputError(f"{folder}: holds no campaign: there is no {PLAN}")
    return _read(folder / PLAN, columns, "case", "remove it, and plan the campaign anew from its file")


# ------------------------------------------------------------------------------------------ results


def write_rows(folder: Path, rows: Sequence[Mapping[str, Any]], columns: pa.Schema) -> Path:
    """Writes the result rows of one chunk of cases as a new Parquet file and returns its path."""
    results = folder / RESULTS
    results.mkdir(exist_ok=True)
    first, last = rows[0]["case_id"], rows[-1]["case_id"]
    path = results / f"{first:06d}-{last:06d}.parquet"
    _write(path, pa.Table.from_pylist([dict(row) for row in rows], schema=columns))
    return path


def flown_ids(folder: Path) -> set[int]:
    """Returns the numbers of all cases that have a result row, failed ones included."""
    case_ids: set[int] = set()
    for path in _chunk_files(folder):
        case_ids.update(_read_chunk(path, ["case_id"])["case_id"].to_pylist())
    return case_ids


def remove_failed_rows(folder: Path, case_ids: Collection[int]) -> None:
    """Removes the result rows of the given cases where they failed to run."""
    for path in _chunk_files(folder):
        table = _read_chunk(path, None)
        failed = pc.and_(pc.is_in(table["case_id"], pa.array(case_ids, pa.int64())), pc.equal(table["status"], FAILED))
        kept = table.filter(pc.invert(failed))
        if not kept.num_rows:
            path.unlink()
        elif kept.num_rows < table.num_rows:
            _write(path, kept)


def read_rows(folder: Path, columns: Sequence[str] | None = None) -> pa.Table | None:
    """Reads all result rows as a table, sorted by case; None where there are none.

    Args:
        folder: the campaign's.
        columns: to read, `case_id` among them; default all.

    Raises:
        InputError: when a file of them is damaged.
    """
    tables = [_read_chunk(path, columns) for path in _chunk_files(folder)]
    if not tables:
        return None
    return pa.concat_tables(tables).sort_by("case_id")


def _chunk_files(folder: Path) -> list[Path]:
    """Lists the Parquet files of results, one per chunk of cases."""
    return sorted((folder / RESULTS).glob("*.parquet"))


def _read_chunk(path: Path, columns: Sequence[str] | None) -> pa.Table:
    """Reads some columns of one chunk's result rows as a table."""
    return _read(path, columns, "case_id", "remove it, and --resume flies its cases again")
