"""Comparison of campaigns case by case: the same draws with other settings.

Each column is a campaign, or a cell of its sweep. Columns are compared in pairs of cases with the same draws, so that
the draws themselves do not blur the difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake.display import plotted
from massprop_drake.errors import InputError
from massprop_drake.studies.campaign import charts, merit, report_words, statistics
from massprop_drake.studies.campaign.campaign_report import FORMAT, figure_data
from massprop_drake.studies.campaign.counts import Row, ends_wrong, select_flown, select_judgeable
from massprop_drake.studies.campaign.merit import MEANINGS, InjectedEvent
from massprop_drake.studies.campaign.plan import case_name
from massprop_drake.studies.campaign.reading import Cell, Study, flatten, read
from massprop_drake.studies.campaign.statistics import Paired

_HERE = Path(__file__).parent
_MOST_LISTED = 20  # cases that became something else
_MOST_DIFFERENCES = 60  # settings that differ
_HOUR_S = 3600.0


class Column(NamedTuple):
    """Column of the comparison: a campaign, or a cell of its sweep.

    Attributes:
        label: the campaign's folder, and the settings of the cell where there are several.
        study: the campaign.
        cell: of the sweep; the only one without a sweep.
        baseline: number of the column that it is compared with; its own for a baseline.
    """

    label: str
    study: Study
    cell: Cell
    baseline: int


class Measure(NamedTuple):
    """Difference between two columns in one respect.

    Attributes:
        words: that name it.
        unit: of values and difference; "%" for a share.
        values: of the baseline and of the other column, over the pairs.
        paired: the difference.
        measured_on: what pairs are of.
    """

    words: str
    unit: str
    values: tuple[float, float]
    paired: Paired
    measured_on: str


# ------------------------------------------------------------------------------------------- pairing


def columns(studies: Sequence[Study]) -> list[Column]:
    """Returns a column for each cell of all campaigns, with the index of the column it is compared with.

    A cell is compared with the first campaign's cell of the same settings of the sweep, or with its reference; a cell
    of the first campaign with its reference.

    Raises:
        InputError: when there is nothing to compare, or draws differ.
    """
    first = studies[0]
    if len(studies) == 1 and len(first.cells) == 1:
        raise InputError(f"{first.folder}: is one campaign without a sweep; give another folder to compare it with")
    names = [study.folder.name for study in studies]
    columns_found = []
    for number, study in enumerate(studies):
        name = study.folder.name if names.count(study.folder.name) == 1 else str(study.folder)
        for cell in study.cells:
            parts = [name] if len(studies) > 1 else []
            parts += [cell.label] if len(study.cells) > 1 else []
            same = [index for index, other in enumerate(first.cells) if number and other.settings == cell.settings]
            columns_found.append(Column(": ".join(parts), study, cell, same[0] if same else first.reference))
    for column in columns_found:
        _require_same_draws(columns_found[column.baseline], column)
    return columns_found


def _require_same_draws(baseline: Column, column: Column) -> None:
    """Checks that cases of two columns have the same draws and differ in settings alone, else InputError."""
    folder, there = column.study.folder, baseline.study.folder
    file, base_file = column.study.spec.file, baseline.study.spec.file
    refused = "cases cannot be compared in pairs"
    if set(column.study.labels) != set(baseline.study.labels):
        only = [f"{label} only in {folder}" for label in column.study.labels if label not in baseline.study.labels]
        only += [f"{label} only in {there}" for label in baseline.study.labels if label not in column.study.labels]
        raise InputError(f"{folder}: draws other quantities than {there}, so that {refused}: {'; '.join(only)}")
    if (file.method, file.seed) != (base_file.method, base_file.seed):
        raise InputError(
            f"{folder}: is drawn by {file.method} with seed {file.seed}, {there} by {base_file.method} with seed "
            f"{base_file.seed}, so that {refused}; give both the same"
        )
    if column.study.spec.base.vehicle_data.designations != baseline.study.spec.base.vehicle_data.designations:
        raise InputError(f"{folder}: flies another vehicle than {there}, so that {refused}")
    rows = {row["sample"]: row for row in baseline.cell.rows}
    compared = ("seed", "record", *(f"draw.{label}" for label in column.study.labels))
    for row in column.cell.rows:
        same = rows.get(row["sample"])
        for name in compared:
            if same is not None and same[name] != row[name]:
                quantity = name.removeprefix("draw.")
                raise InputError(
                    f"{folder}: sample {row['sample']}: {quantity} is {row[name]}, in {there} {same[name]}, "
                    f"so that {refused}"
                )
    if column is not baseline and not pair_cases(baseline, column):
        raise InputError(f"{folder}: has no case in common with {there} that both have flown")


def pair_cases(baseline: Column, column: Column) -> list[tuple[Row, Row]]:
    """Pairs the rows of cases with the same sample number that both columns have flown."""
    rows = {row["sample"]: row for row in select_flown(baseline.cell.rows)}
    return [(rows[row["sample"]], row) for row in select_flown(column.cell.rows) if row["sample"] in rows]


def pair_events(case_pairs: Sequence[tuple[Row, Row]]) -> list[tuple[InjectedEvent, InjectedEvent]]:
    """Pairs the injected failures of the same jet in paired cases, where they acted in both."""
    event_pairs = []
    for first, second in case_pairs:
        events = [{event.injected["jet"]: event for event in merit.events([row])} for row in (first, second)]
        event_pairs += [(events[0][jet], event) for jet, event in events[1].items() if jet in events[0]]
    return event_pairs


# ------------------------------------------------------------------------------------------ measures


def measures(case_pairs: Sequence[tuple[Row, Row]]) -> list[Measure]:
    """Computes paired differences, second less first case, of shares, delays, errors and NEES."""
    event_pairs = pair_events(case_pairs)
    known = [pair for pair in case_pairs if None not in (pair[0]["largest_sigmas"], pair[1]["largest_sigmas"])]
    nees = [pair for pair in case_pairs if None not in (pair[0]["nees.rotation"], pair[1]["nees.rotation"])]
    found_in_both = [pair for pair in event_pairs if pair[0].right and pair[1].right]
    judged = [pair for pair in case_pairs if len(select_judgeable(pair)) == len(pair)]
    measures_found = [
        _false_rate_measure(judged),
        _share_measure("Cases with a false declaration", judged, lambda row: row["n_false"] > 0, "cases"),
        _share_measure(
            "Cases that end with a healthy jet out of use", judged, lambda row: bool(row["healthy_jets_out"]), "cases"
        ),
        _share_measure(MEANINGS["ended_wrong"].words, known, ends_wrong, "cases"),
        _share_measure(MEANINGS["failing"].words, judged, lambda row: bool(row["failing"]), "cases"),
        _share_measure(MEANINGS["isolated"].words, event_pairs, lambda event: event.right, "failures"),
        _share_measure(MEANINGS["named"].words, event_pairs, _has_outcome("named"), "failures"),
        _share_measure(MEANINGS["wrong"].words, event_pairs, _has_outcome("wrong"), "failures"),
        _median_measure("Delay of what both found", "s", found_in_both, lambda event: event.delay_s, "failures"),
        _median_measure("Largest error, in claimed sigma", "sigma", known, lambda row: row["largest_sigmas"], "cases"),
        _median_measure("NEES of the rotational parameters", "", nees, lambda row: row["nees.rotation"], "cases"),
    ]
    return [measure for measure in measures_found if measure.paired.difference.n]


def _has_outcome(outcome: str) -> Callable[[InjectedEvent], bool]:
    """Makes a function that tests whether an injected failure had an outcome."""
    return lambda event: bool(event.injected["outcome"] == outcome)


def _share_measure(
    label: str, pairs: Sequence[tuple[Any, Any]], condition: Callable[[Any], bool], measured_on: str
) -> Measure:
    """Computes the shares of pairs whose first and second member fulfill a condition, and the paired difference."""
    first, second = [condition(pair[0]) for pair in pairs], [condition(pair[1]) for pair in pairs]
    n = max(len(pairs), 1)
    return Measure(label, "%", (sum(first) / n, sum(second) / n), statistics.paired_share(first, second), measured_on)


def _median_measure(
    label: str, unit: str, pairs: Sequence[tuple[Any, Any]], value: Callable[[Any], float], measured_on: str
) -> Measure:
    """Computes medians of a value over the first and second members of pairs, and their paired difference."""
    first, second = [value(pair[0]) for pair in pairs], [value(pair[1]) for pair in pairs]
    paired = statistics.paired_median([b - a for a, b in zip(first, second, strict=True)])
    middle = statistics.median(first).value, statistics.median(second).value
    return Measure(f"{label}, median", unit, middle, paired, measured_on)


def _false_rate_measure(case_pairs: Sequence[tuple[Row, Row]]) -> Measure:
    """Computes false declarations per hour of both campaigns, and their paired mean difference."""
    hours = [sum(pair[member]["duration_s"] for pair in case_pairs) / _HOUR_S for member in (0, 1)]
    counts = [sum(pair[member]["n_false"] for pair in case_pairs) for member in (0, 1)]
    differences = [second["n_false"] - first["n_false"] for first, second in case_pairs]
    paired = statistics.paired_mean(differences, scale=len(case_pairs) / hours[0] if hours[0] else math.nan)
    rates = (counts[0] / hours[0], counts[1] / hours[1]) if all(hours) else (math.nan, math.nan)
    return Measure("False declarations", "1/h", rates, paired, "cases")


# ------------------------------------------------------------------------------------------- as data


def summary(folders: Sequence[str | Path]) -> dict[str, Any]:
    """Returns differences between campaigns, or between the cells of one, as data for JSON; see `page`."""
    compared = columns([read(folder) for folder in folders])
    return {
        "format": FORMAT,
        "columns": [
            {
                "label": column.label,
                "folder": str(column.study.folder),
                "settings": dict(column.cell.settings),
                "baseline": column.baseline,
                "figures": {name: figure_data(figure) for name, figure in merit.figures(column.cell.rows).items()},
                "differences": [
                    {
                        "what": measure.words,
                        "baseline": _finite(measure.values[0]),
                        "here": _finite(measure.values[1]),
                        "difference": figure_data(measure.paired.difference),
                        "larger": measure.paired.up,
                        "smaller": measure.paired.down,
                        "p": _finite(measure.paired.p),
                    }
                    for measure in _column_measures(compared, number)
                ],
            }
            for number, column in enumerate(compared)
        ],
        "settings": _differing_settings(compared),
    }


def _finite(value: float) -> float | None:
    """Returns the value, or None where it is not finite."""
    return value if math.isfinite(value) else None


def _column_measures(compared: Sequence[Column], index: int) -> list[Measure]:
    """Computes the paired differences of a column from its baseline; empty for a baseline."""
    column = compared[index]
    return [] if column.baseline == index else measures(pair_cases(compared[column.baseline], column))


def _differing_settings(compared: Sequence[Column]) -> list[dict[str, Any]]:
    """Lists settings and versions that differ between columns, by key, with each column's value."""
    flat = []
    for column in compared:
        one = flatten(column.study.spec.base.model_dump(mode="json"), vectors=False)
        one |= column.cell.settings
        one |= {f"(version) {name}": value for name, value in column.study.execution.items()}
        flat.append(one)
    keys = dict.fromkeys(key for one in flat for key in one)
    differing = [key for key in keys if any(one.get(key) != flat[0].get(key) for one in flat)]
    return [{"key": key, "values": [one.get(key) for one in flat]} for key in differing[:_MOST_DIFFERENCES]]


# -------------------------------------------------------------------------------------------- as page


def page(folders: Sequence[str | Path]) -> str:
    """Returns the comparison of campaigns as the text of one HTML file that needs no network.

    Args:
        folders: of campaigns; the first is what the others are compared with.

    Raises:
        InputError: when one holds no campaign that has been run, or they do not have the same draws.
    """
    return plotted.page(_HERE / "compare.html", page_content(columns([read(folder) for folder in folders])))


def page_content(compared: Sequence[Column]) -> dict[str, Any]:
    """Makes the content of the comparison page: texts, tables and plots as plain values."""
    figures = [merit.figures(column.cell.rows) for column in compared]
    labels = [column.label for column in compared]
    plots = []
    if any(merit.events(column.cell.rows) for column in compared):
        curves = {column.label: merit.detection_curve(merit.events(column.cell.rows)) for column in compared}
        plots.append(charts.delays(curves, grouping="by column"))
        points = [merit.operating_point(column.cell.rows, chr(ord("A") + n)) for n, column in enumerate(compared)]
        own = compared[0].baseline
        plots.append(charts.operating_curve([], points[:own] + points[own + 1 :], points[own], "settings"))
    return {
        "title": "Campaigns compared: " + ", ".join(dict.fromkeys(column.study.spec.file.name for column in compared)),
        "columns": [{"letter": chr(ord("A") + n), "label": label} for n, label in enumerate(labels)],
        "settings": [
            {"key": row["key"], "values": ["-" if value is None else str(value) for value in row["values"]]}
            for row in _differing_settings(compared)
        ],
        "figures": [
            {
                "words": MEANINGS[name].words,
                "cells": [report_words.figure_row(name, column_figures[name]) for column_figures in figures],
            }
            for name in MEANINGS
            if any(column_figures[name].n for column_figures in figures)
        ],
        "pairs": [
            {
                "label": column.label,
                "baseline": labels[column.baseline],
                "n": len(pair_cases(compared[column.baseline], column)),
                "rows": [_measure_row(measure) for measure in _column_measures(compared, number)],
                "changed": _changed_cases(compared[column.baseline], column),
            }
            for number, column in enumerate(compared)
            if column.baseline != number
        ],
        "plots": plots,
    }


def _measure_row(measure: Measure) -> dict[str, Any]:
    """Makes the table row of a paired difference: values, difference, interval and p-value as text."""
    difference, up, down, p = measure.paired
    scale, unit = (100.0, "points") if measure.unit == "%" else (1.0, measure.unit)

    def number(value: float) -> str:
        """Formats a signed difference, in percentage points for shares."""
        if not math.isfinite(value):
            return "-" if math.isnan(value) else "unknown"
        return f"{scale * value:+.3g}" if value else "0"

    bounded = not math.isnan(difference.low)
    return {
        "words": measure.words,
        "values": [
            report_words.format_figure(statistics.Figure(value, math.nan, math.nan, 0), measure.unit)
            for value in measure.values
        ],
        "difference": f"{number(difference.value)} {unit}".rstrip(),
        "interval": " to ".join(map(number, (difference.low, difference.high))) if bounded else "",
        "up": up,
        "down": down,
        "p": "-" if math.isnan(p) else f"{p:.2g}",
        "sure": not math.isnan(p) and p < 1.0 - statistics.CONFIDENCE,
        "n": f"{difference.n:g} {measure.measured_on}",
    }


def _changed_cases(baseline: Column, column: Column) -> dict[str, Any]:
    """Returns the number of cases with another outcome than in the baseline, and rows of the first ones."""
    changed = []
    for first, second in pair_cases(baseline, column):
        outcomes = [_outcome_text(row) for row in (first, second)]
        if outcomes[0] != outcomes[1]:
            changed.append({"case": case_name(second["case_id"]), "first": outcomes[0], "second": outcomes[1]})
    return {"n": len(changed), "rows": changed[:_MOST_LISTED]}


def _outcome_text(row: Row) -> str:
    """Describes a case in words: outcomes of failures, false declarations, a wrong end, and healthy jets out of use."""
    parts = [f"{record['jet'] or record['kind']} {record['outcome'].replace('_', ' ')}" for record in row["injected"]]
    parts += [f"taken for {record['taken_for']}" for record in row["injected"] if record["taken_for"]]
    if row["n_false"]:
        parts.append(f"{row['n_false']} false")
    if ends_wrong(row):
        parts.append("ends wrong")
    if row["healthy_jets_out"]:
        parts.append(f"healthy out: {', '.join(row['healthy_jets_out'])}")
    return "; ".join(parts) or "nothing"
