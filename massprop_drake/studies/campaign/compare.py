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
from massprop_drake.studies.campaign.reading import Cell, Study, leaves, read
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
        cell: of it.
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
    found = []
    for number, study in enumerate(studies):
        name = study.folder.name if names.count(study.folder.name) == 1 else str(study.folder)
        for cell in study.cells:
            parts = [name] if len(studies) > 1 else []
            parts += [cell.label] if len(study.cells) > 1 else []
            same = [at for at, other in enumerate(first.cells) if number and other.settings == cell.settings]
            found.append(Column(": ".join(parts), study, cell, same[0] if same else first.reference))
    for column in found:
        _require_same_draws(found[column.baseline], column)
    return found


def _require_same_draws(baseline: Column, column: Column) -> None:
    """Checks that cases of two columns have the same draws and differ in settings alone, else InputError."""
    here, there = column.study.folder, baseline.study.folder
    file, other = column.study.spec.file, baseline.study.spec.file
    refused = "cases cannot be compared in pairs"
    if set(column.study.labels) != set(baseline.study.labels):
        only = [f"{label} only in {here}" for label in column.study.labels if label not in baseline.study.labels]
        only += [f"{label} only in {there}" for label in baseline.study.labels if label not in column.study.labels]
        raise InputError(f"{here}: draws other quantities than {there}, so that {refused}: {'; '.join(only)}")
    if (file.method, file.seed) != (other.method, other.seed):
        raise InputError(
            f"{here}: is drawn by {file.method} with seed {file.seed}, {there} by {other.method} with seed "
            f"{other.seed}, so that {refused}; give both the same"
        )
    if column.study.spec.base.vehicle_data.designations != baseline.study.spec.base.vehicle_data.designations:
        raise InputError(f"{here}: flies another vehicle than {there}, so that {refused}")
    rows = {row["sample"]: row for row in baseline.cell.rows}
    compared = ("seed", "record", *(f"draw.{label}" for label in column.study.labels))
    for row in column.cell.rows:
        same = rows.get(row["sample"])
        for name in compared:
            if same is not None and same[name] != row[name]:
                what = name.removeprefix("draw.")
                raise InputError(
                    f"{here}: sample {row['sample']}: {what} is {row[name]}, in {there} {same[name]}, so that {refused}"
                )
    if column is not baseline and not pair_cases(baseline, column):
        raise InputError(f"{here}: has no case in common with {there} that both have flown")


def pair_cases(baseline: Column, column: Column) -> list[tuple[Row, Row]]:
    """Pairs the rows of cases with the same sample number that both columns have flown."""
    rows = {row["sample"]: row for row in select_flown(baseline.cell.rows)}
    return [(rows[row["sample"]], row) for row in select_flown(column.cell.rows) if row["sample"] in rows]


def pair_events(paired: Sequence[tuple[Row, Row]]) -> list[tuple[InjectedEvent, InjectedEvent]]:
    """Pairs the injected failures of the same jet in paired cases, where they acted in both."""
    found = []
    for first, second in paired:
        events = [{event.injected["jet"]: event for event in merit.events([row])} for row in (first, second)]
        found += [(events[0][jet], event) for jet, event in events[1].items() if jet in events[0]]
    return found


# ------------------------------------------------------------------------------------------ measures


def measures(paired: Sequence[tuple[Row, Row]]) -> list[Measure]:
    """Computes paired differences, second less first case, of shares, delays, errors and NEES."""
    events = pair_events(paired)
    known = [pair for pair in paired if None not in (pair[0]["largest_sigmas"], pair[1]["largest_sigmas"])]
    nees = [pair for pair in paired if None not in (pair[0]["nees.rotation"], pair[1]["nees.rotation"])]
    both = [pair for pair in events if pair[0].right and pair[1].right]
    judged = [pair for pair in paired if len(select_judgeable(pair)) == len(pair)]
    found = [
        _false_rate_measure(judged),
        _share_measure("Cases with a false declaration", judged, lambda row: row["n_false"] > 0, "cases"),
        _share_measure(
            "Cases that end with a healthy jet out of use", judged, lambda row: bool(row["healthy_jets_out"]), "cases"
        ),
        _share_measure(MEANINGS["ended_wrong"].words, known, ends_wrong, "cases"),
        _share_measure(MEANINGS["failing"].words, judged, lambda row: bool(row["failing"]), "cases"),
        _share_measure(MEANINGS["isolated"].words, events, lambda event: event.right, "failures"),
        _share_measure(MEANINGS["named"].words, events, _has_outcome("named"), "failures"),
        _share_measure(MEANINGS["wrong"].words, events, _has_outcome("wrong"), "failures"),
        _median_measure("Delay of what both found", "s", both, lambda event: event.delay_s, "failures"),
        _median_measure("Largest error, in claimed sigma", "sigma", known, lambda row: row["largest_sigmas"], "cases"),
        _median_measure("NEES of the rotational parameters", "", nees, lambda row: row["nees.rotation"], "cases"),
    ]
    return [measure for measure in found if measure.paired.difference.n]


def _has_outcome(outcome: str) -> Callable[[InjectedEvent], bool]:
    return lambda event: bool(event.injected["outcome"] == outcome)


def _share_measure(
    words: str, of: Sequence[tuple[Any, Any]], holds: Callable[[Any], bool], measured_on: str
) -> Measure:
    """Computes the shares of pairs whose first and second member fulfill a condition, and the paired difference."""
    first, second = [holds(pair[0]) for pair in of], [holds(pair[1]) for pair in of]
    n = max(len(of), 1)
    return Measure(words, "%", (sum(first) / n, sum(second) / n), statistics.paired_share(first, second), measured_on)


def _median_measure(
    words: str, unit: str, of: Sequence[tuple[Any, Any]], value: Callable[[Any], float], measured_on: str
) -> Measure:
    """Computes medians of a value over the first and second members of pairs, and their paired difference."""
    first, second = [value(pair[0]) for pair in of], [value(pair[1]) for pair in of]
    paired = statistics.paired_median([b - a for a, b in zip(first, second, strict=True)])
    middle = statistics.median(first).value, statistics.median(second).value
    return Measure(f"{words}, median", unit, middle, paired, measured_on)


def _false_rate_measure(of: Sequence[tuple[Row, Row]]) -> Measure:
    """Computes false declarations per hour of both campaigns, and their paired mean difference."""
    hours = [sum(pair[which]["duration_s"] for pair in of) / _HOUR_S for which in (0, 1)]
    counts = [sum(pair[which]["n_false"] for pair in of) for which in (0, 1)]
    differences = [second["n_false"] - first["n_false"] for first, second in of]
    paired = statistics.paired_mean(differences, scale=len(of) / hours[0] if hours[0] else math.nan)
    rates = (counts[0] / hours[0], counts[1] / hours[1]) if all(hours) else (math.nan, math.nan)
    return Measure("False declarations", "1/h", rates, paired, "cases")


# ------------------------------------------------------------------------------------------- as data


def summary(folders: Sequence[str | Path]) -> dict[str, Any]:
    """Returns differences between campaigns, or between the cells of one, as data for JSON.

    Args:
        folders: of campaigns; the first is what the others are compared with.

    Raises:
        InputError: when one holds no campaign that has been run, or they do not have the same draws.
    """
    found = columns([read(folder) for folder in folders])
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
                    for measure in _column_measures(found, number)
                ],
            }
            for number, column in enumerate(found)
        ],
        "settings": _differing_settings(found),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _column_measures(found: Sequence[Column], number: int) -> list[Measure]:
    column = found[number]
    return [] if column.baseline == number else measures(pair_cases(found[column.baseline], column))


def _differing_settings(found: Sequence[Column]) -> list[dict[str, Any]]:
    """Lists settings and versions that differ between columns, by key, with each column's value."""
    flat = []
    for column in found:
        one = leaves(column.study.spec.base.model_dump(mode="json"), vectors=False)
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
    return plotted.page(_HERE / "compare.html", contents(columns([read(folder) for folder in folders])))


def contents(found: Sequence[Column]) -> dict[str, Any]:
    """Makes the content of the comparison page: texts, tables and plots as plain values."""
    figures = [merit.figures(column.cell.rows) for column in found]
    labels = [column.label for column in found]
    plots = []
    if any(merit.events(column.cell.rows) for column in found):
        curves = {column.label: merit.detection_curve(merit.events(column.cell.rows)) for column in found}
        plots.append(charts.delays(curves, what="by column"))
        points = [merit.operating_point(column.cell.rows, chr(ord("A") + n)) for n, column in enumerate(found)]
        own = found[0].baseline
        plots.append(charts.operating_curve([], points[:own] + points[own + 1 :], points[own], "settings"))
    return {
        "title": "Campaigns compared: " + ", ".join(dict.fromkeys(column.study.spec.file.name for column in found)),
        "columns": [{"letter": chr(ord("A") + n), "label": label} for n, label in enumerate(labels)],
        "settings": [
            {"key": row["key"], "values": ["-" if value is None else str(value) for value in row["values"]]}
            for row in _differing_settings(found)
        ],
        "figures": [
            {
                "words": MEANINGS[name].words,
                "cells": [report_words.figure_row(name, one[name]) for one in figures],
            }
            for name in MEANINGS
            if any(one[name].n for one in figures)
        ],
        "pairs": [
            {
                "label": column.label,
                "baseline": labels[column.baseline],
                "n": len(pair_cases(found[column.baseline], column)),
                "rows": [_measure_row(measure) for measure in _column_measures(found, number)],
                "changed": _changed_cases(found[column.baseline], column),
            }
            for number, column in enumerate(found)
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
    found = []
    for first, second in pair_cases(baseline, column):
        became = [_outcome_text(row) for row in (first, second)]
        if became[0] != became[1]:
            found.append({"case": case_name(second["case_id"]), "first": became[0], "second": became[1]})
    return {"n": len(found), "rows": found[:_MOST_LISTED]}


def _outcome_text(row: Row) -> str:
    """Describes the outcome of a case in words, without numbers."""
    parts = [f"{one['jet'] or one['kind']} {one['outcome'].replace('_', ' ')}" for one in row["injected"]]
    parts += [f"taken for {one['taken_for']}" for one in row["injected"] if one["taken_for"]]
    if row["n_false"]:
        parts.append(f"{row['n_false']} false")
    if ends_wrong(row):
        parts.append("ends wrong")
    if row["healthy_jets_out"]:
        parts.append(f"healthy out: {', '.join(row['healthy_jets_out'])}")
    return "; ".join(parts) or "nothing"
