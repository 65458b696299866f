"""Folder of a campaign, read for its report: rows and draws together, by cell of the sweep."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign_file import CampaignSpec
from massprop_drake.inputs.scenario import split_key, value_at
from massprop_drake.studies.campaign import store
from massprop_drake.studies.campaign.counts import COLUMNS, Counts, Row, Status, count_cases, sum_counts
from massprop_drake.studies.campaign.plan import case_name

_NOT_SHOWN = ("estimate", "truth")  # columns that no figure needs, by the first part of their names


class Cell(NamedTuple):
    """Cases that have the same settings of the sweep.

    Attributes:
        settings: what the cell has, by dotted key; empty without a sweep.
        planned: number of its cases.
        rows: of those that have been tried, by sample; with `sample` and the draws in columns `draw.<label>`.
        label: in short what tells it from the other cells.
    """

    settings: Mapping[str, Any]
    planned: int
    rows: Sequence[Row]
    label: str

    @property
    def numbers(self) -> Counts:
        """Counts of the cell's cases by outcome."""
        return count_cases(self.rows, self.planned)


class _ColumnRow(Mapping[str, Any]):
    """Row as a view of columns that all rows share, which saves memory."""

    __slots__ = ("_columns", "_index")

    def __init__(self, columns: Mapping[str, Sequence[Any]], index: int):
        self._columns, self._index = columns, index

    def __getitem__(self, name: str) -> Any:
        return self._columns[name][self._index]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


class Study(NamedTuple):
    """Content of a campaign's folder.

    Attributes:
        folder: as it was given.
        spec: the campaign.
        cells: of its sweep, in their order.
        reference: number of the cell with the base scenario's own settings, or of the first.
        labels: of what is drawn.
        execution: how cases were executed; empty before the first.
        kept: links to the folders or reports of kept cases, relative to the campaign's folder, by case.
    """

    folder: Path
    spec: CampaignSpec
    cells: Sequence[Cell]
    reference: int
    labels: Sequence[str]
    execution: Mapping[str, str]
    kept: Mapping[int, str]

    @property
    def rows(self) -> list[Row]:
        """Rows of all cells."""
        return [row for cell in self.cells for row in cell.rows]

    @property
    def status(self) -> Status:
        """Counts of the cases by outcome, in all and by cell."""
        return _status(self.cells)


def read(folder: str | Path) -> Study:
    """Reads a campaign's folder for its report: results and draws, by cell of the sweep.

    Raises:
        InputError: when it holds no campaign, or nothing has been flown.
    """
    path = Path(folder)
    facts = store.read_metadata(path)
    spec = store.planned_spec(path)
    columns = [name for name in store.schema(spec.file.times_s).names if name.partition(".")[0] not in _NOT_SHOWN]
    plan_table = store.read_draws(path)
    cells = _read_cells(path, spec, plan_table, columns)
    if not any(cell.rows for cell in cells):
        raise InputError(f"{path}: no case has been flown yet; `massprop campaign run` does that")
    reference = _reference_cell(spec, [cell.settings for cell in cells])
    labels = [name.removeprefix("draw.") for name in plan_table.column_names if name.startswith("draw.")]
    execution = json.loads(facts.get("execution", "{}"))
    return Study(path, spec, cells, reference, labels, execution, _kept_case_folders(path))


def status(folder: Path, spec: CampaignSpec) -> Status:
    """Counts the cases in a campaign's folder by outcome, in all and by cell; none need be flown.

    Raises:
        InputError: when it holds no campaign, or what it holds is damaged.
    """
    return _status(_read_cells(folder, spec, store.read_draws(folder), COLUMNS))


def _status(cells: Sequence[Cell]) -> Status:
    """Makes the status of a campaign from the cells of its sweep."""
    return Status(
        sum_counts(cell.numbers for cell in cells), [(cell.label, cell.settings, cell.numbers) for cell in cells]
    )


def _read_cells(folder: Path, spec: CampaignSpec, plan_table: Any, result_columns: Sequence[str]) -> list[Cell]:
    """Reads the cells of a sweep: each with its settings, label, planned number and result rows.

    Args:
        folder: the campaign's.
        spec: the campaign.
        plan_table: the plan as a table, see `store.read_draws`.
        result_columns: columns of results to read.
    """
    table = store.read_rows(folder, result_columns)
    row_by_case = {case_id: number for number, case_id in enumerate(plan_table["case_id"].to_pylist())}
    columns = {
        name: plan_table[name].to_pylist()
        for name in plan_table.column_names
        if name in ("sample", "cell", "seed", "record") or name.startswith("draw.")
    }
    values = {name: [] if table is None else table[name].to_pylist() for name in result_columns}
    plan_rows = [row_by_case[case_id] for case_id in values["case_id"]]
    values |= {name: [column[number] for number in plan_rows] for name, column in columns.items()}
    rows: dict[int, list[Row]] = {}
    for index in range(len(plan_rows)):
        rows.setdefault(values["cell"][index], []).append(_ColumnRow(values, index))
    sweep = spec.file.sweep
    settings = [dict(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values())]
    keys, texts = find_varying_keys(settings)
    labels_of = [
        ", ".join(f"{key.rpartition('.')[2]} {value}" for key, value in zip(keys, cell, strict=True)) for cell in texts
    ]
    return [
        Cell(cell, columns["cell"].count(number), rows.get(number, []), labels_of[number] or "all cases")
        for number, cell in enumerate(settings)
    ]


def find_varying_keys(settings: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Returns settings' keys that differ between cells, and their values as text, a row per cell.

    A key that only follows from those before it is left out, and so is what all cells share.

    Args:
        settings: of each cell, what the sweep sets, by dotted key.
    """
    cells = [flatten(dict(cell)) for cell in settings]
    columns: dict[str, list[str]] = {}
    rows: list[tuple[str, ...]] = [()] * len(cells)
    for key in dict.fromkeys(key for cell in cells for key in cell):
        column = [_value_text(cell.get(key, "-")) for cell in cells]
        wider = [(*row, value) for row, value in zip(rows, column, strict=True)]
        if len(set(wider)) > len(set(rows)):
            columns[key], rows = column, wider
    return list(columns), rows


def flatten(value: Any, path: str = "", *, vectors: bool = True) -> dict[str, Any]:
    """Flattens nested data to a dict of values by dotted path; `vectors`: lists of plain values are not split."""
    nested = (Mapping, list, tuple)
    if isinstance(value, Mapping):
        parts = {f"{path}.{name}" if path else name: part for name, part in value.items()}
    elif isinstance(value, (list, tuple)) and not (vectors and not any(isinstance(part, nested) for part in value)):
        parts = {f"{path}[{number}]": part for number, part in enumerate(value)}
    else:
        return {path: value}
    return {inner: leaf for key, part in parts.items() for inner, leaf in flatten(part, key, vectors=vectors).items()}


def _value_text(value: Any) -> str:
    """Formats a setting of the sweep as YAML text."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, (int, float)):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value_text, value)) + "]"
    return str(value)


def _reference_cell(spec: CampaignSpec, settings: Sequence[Mapping[str, Any]]) -> int:
    """Returns the number of the cell whose settings are those of the base scenario, or 0."""
    base = spec.base.model_dump(mode="json")
    for number, cell in enumerate(settings):
        if all(_is_same_value(value_at(base, split_key(key, key)), value) for key, value in cell.items()):
            return number
    return 0


def _is_same_value(first: Any, second: Any) -> bool:
    """Tests whether two settings are equal, numbers to rounding."""
    if isinstance(first, (int, float)) and isinstance(second, (int, float)):
        return math.isclose(first, second)
    return bool(first == second)


def _kept_case_folders(folder: Path) -> dict[int, str]:
    """Maps numbers of kept cases to the path of their report or folder, relative to the campaign's."""
    paths = {}
    for path in (folder / store.CASES).glob("*"):
        if path.name.isdecimal() and path.name == case_name(int(path.name)) and path.is_dir():
            report = "report.html" if (path / "report.html").exists() else ""
            paths[int(path.name)] = f"{store.CASES}/{path.name}/{report}"
    return paths
