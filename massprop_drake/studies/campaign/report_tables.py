"""Tables of a campaign's report, as plain values."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.results.detections import JUMP
from massprop_drake.studies.campaign import charts, merit, statistics
from massprop_drake.studies.campaign.counts import Row, select_flown, select_judgeable
from massprop_drake.studies.campaign.merit import CAUSES, DELAYS_S, MEANINGS, OUTCOMES, InjectedEvent
from massprop_drake.studies.campaign.plan import case_name
from massprop_drake.studies.campaign.reading import Study
from massprop_drake.studies.campaign.report_plots import coverage_by_sigma
from massprop_drake.studies.campaign.report_words import figure_row, format_figure, format_interval
from massprop_drake.studies.campaign.statistics import SizeCurve

_MAIN = (  # of a cell, side by side
    "false_declarations_per_hour", "false_declarations_in_case", "healthy_jets_out", "ended_wrong", "failing",
    "isolated", "named", *(f"found_within_{delay:g}_s" for delay in DELAYS_S), "delay_50_percent_s", "coverage_3_sigma",
    "nees_in_band",
)  # fmt: skip


def sweep(study: Study) -> dict[str, Any] | None:
    """Makes the table of the main figures of all cells, side by side; None for a single cell."""
    if len(study.cells) < 2:
        return None
    by_cell = [merit.figures(cell.rows) for cell in study.cells]
    names = [name for name in _MAIN if any(figures[name].n for figures in by_cell)]
    return {
        "cells": [cell.label for cell in study.cells],
        "reference": study.reference,
        "cases": [len(select_flown(cell.rows)) for cell in study.cells],
        "rows": [
            {
                "words": MEANINGS[name].words,
                "values": [format_figure(figures[name], MEANINGS[name].unit, interval=False) for figures in by_cell],
                "intervals": [figure_row(name, figures[name])["interval"] for figures in by_cell],
            }
            for name in names
        ],
    }


def false_declaration_rows(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Makes table rows of false declarations by cause: number, hours, rate and interval."""
    table = []
    for cause in (*CAUSES, None):
        declarations = merit.false_declarations(rows, cause)
        hours = merit.hours(select_judgeable(rows), cause)
        if not hours:
            continue
        figure = merit.false_rate(rows, cause)
        table.append(
            {
                "cause": "all" if cause is None else MEANINGS[f"false_declarations_per_hour_{cause}"].words,
                "count": str(len(declarations)),
                "withdrawn": str(sum(entry["withdrawn_s"] is not None for entry in declarations)),
                "hours": f"{hours:.3g}",
                "rate": format_figure(figure, "", interval=False),
                "interval": format_interval(figure, ""),
            }
        )
    return table


def false_declarations_by_jet(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Returns declared jets, clusters or jumps with their number of false declarations, most frequent first."""
    names = (
        entry["jet"] or ("a jump of the mass properties" if entry["cluster"] is None else f"cluster {entry['cluster']}")
        for entry in merit.false_declarations(rows)
    )
    return Counter(names).most_common(15)


def healthy_jets_out(rows: Sequence[Row], clusters: Mapping[str, int]) -> dict[str, Any]:
    """Returns the share of cases with healthy jets out outside failed clusters; jets with numbers there and within.

    Args:
        rows: of a cell.
        clusters: number of each jet's cluster, by designation.
    """
    related: Counter[str] = Counter()
    elsewhere: Counter[str] = Counter()
    cases = 0
    good = select_judgeable(rows)
    for row in good:
        failed = {clusters.get(record["jet"]) for record in row["injected"] if record["first_acted_s"] is not None}
        jets_elsewhere = [jet for jet in row["healthy_jets_out"] if clusters.get(jet) not in failed]
        elsewhere.update(jets_elsewhere)
        related.update(jet for jet in row["healthy_jets_out"] if jet not in jets_elsewhere)
        cases += bool(jets_elsewhere)
    return {
        "share": format_figure(statistics.share(cases, len(good)), "%"),
        "jets": [(jet, elsewhere[jet], related[jet]) for jet, _ in (elsewhere + related).most_common(15)],
    }


def outcomes(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Makes table rows of numbers of injected failures by kind and outcome."""
    table: list[dict[str, Any]] = []
    for kind, counts in merit.count_outcomes(rows).items():
        acted = sum(counts.values()) - counts["never_acted"]
        table.append({"kind": kind.replace("_", " "), "acted": acted, **{name: counts[name] for name in OUTCOMES}})
    if len(table) > 1:
        table.append({"kind": "all", **{name: sum(row[name] for row in table) for name in ("acted", *OUTCOMES)}})
    return table


def delays(failures: Sequence[InjectedEvent]) -> list[dict[str, Any]]:
    """Makes table rows of share found and detection delay by kind of failure."""
    table = []
    groups = merit.group_events(failures, "kind")
    for kind, group in [*groups.items(), *([("all", list(failures))] if len(groups) > 1 else [])]:
        curve = merit.detection_curve(group)
        tested = [event for event in group if event.injected["outcome"] != "not_tested"]
        table.append(
            {
                "kind": kind.replace("_", " "),
                "n": len(group),
                "found": format_figure(merit.share_of_events(group, lambda event: event.right), "%"),
                "of_tested": format_figure(merit.share_of_events(tested, lambda event: event.right), "%"),
                "within": [format_figure(curve.at(delay), "%") for delay in DELAYS_S],
                "median": format_figure(curve.quantile(0.5), "s"),
            }
        )
    return table


def jump_confusion_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Makes a table row each for failed jets and moved payloads: numbers of cases by what was declared."""
    table = []
    for payloads, truth in ((False, "a failed jet"), (True, "a payload that moved")):
        events = merit.events(rows, payloads=payloads)
        if not events:
            continue
        counts = Counter(_declaration_text(event) for event in events)
        table.append({"what": truth, "n": len(events), "counts": [counts[column] for column in _DECLARED_AS]})
    return table


_DECLARED_AS = ("the jet or its cluster", "another jet", "a jump", "nothing")


def _declaration_text(event: InjectedEvent) -> str:
    """Returns in words what an injected failure or payload event was declared as."""
    jet, a_jump = event.injected["jet"], event.injected["taken_for"] == JUMP
    if event.right:
        return "a jump" if jet is None else "the jet or its cluster"
    if event.injected["outcome"] != "wrong":
        return "nothing"
    return "a jump" if a_jump else "another jet"


def smallest_found_rows(failures: Sequence[InjectedEvent], force_unit: str) -> list[dict[str, str]]:
    """Makes table rows by jet: failures found, missed, and the size found with probability 0.9."""
    table = []
    for jet, group in merit.group_events(failures, "jet").items():
        found_sizes = [merit.failure_size(event) for event in group if event.right]
        missed_sizes = [merit.failure_size(event) for event in group if not event.right]
        curve = statistics.size_curve([merit.failure_size(event) for event in group], [event.right for event in group])
        table.append(
            {
                "jet": jet,
                "found": f"{len(found_sizes)} of {len(group)}",
                "smallest": f"{min(found_sizes):.3g} {force_unit}" if found_sizes else "-",
                "largest_left": f"{max(missed_sizes):.3g} {force_unit}" if missed_sizes else "-",
                "size_90": _size_90_text(curve, force_unit),
            }
        )
    return sorted(table, key=lambda row: row["jet"])


def _size_90_text(curve: SizeCurve | None, force_unit: str) -> str:
    """Formats the failure size found with probability 0.9."""
    if curve is None:
        return "-"
    return f"below {curve.smallest:.3g} {force_unit}" if curve.finds_all else format_figure(curve.size_90, force_unit)


def magnitudes(failures: Sequence[InjectedEvent], force_unit: str) -> list[dict[str, Any]]:
    """Makes table rows of bias, RMS and coverage of declared forces by kind of failure."""
    table = []
    for kind, group in merit.group_events(failures, "kind").items():
        pairs = merit.magnitude_errors(group)
        if not pairs:
            continue
        sigmas = [abs(z) for _, z in pairs]
        table.append(
            {
                "kind": kind.replace("_", " "),
                "n": str(len(pairs)),
                "bias": format_figure(statistics.mean([error for error, _ in pairs]), force_unit),
                "rms": f"{math.sqrt(sum(error**2 for error, _ in pairs) / len(pairs)):.3g} {force_unit}",
                "within": [
                    format_figure(statistics.share(sum(z <= bound for z in sigmas), len(sigmas)), "%")
                    for bound in (1, 2, 3)
                ],
            }
        )
    return table


def consistency_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Makes table rows, by what failed and was found, of cases wrong at the end, coverage and NEES in band."""
    groups: dict[str, list[Row]] = {"nothing failed": [], "all failures found": [], "a failure not found": []}
    for row in select_flown(rows):
        outcomes_acted = [record["outcome"] for record in row["injected"] if record["outcome"] != "never_acted"]
        right = all(outcome in ("named", "group") for outcome in outcomes_acted)
        groups[
            "nothing failed" if not outcomes_acted else "all failures found" if right else "a failure not found"
        ].append(row)
    return [
        {
            "group": name,
            "n": str(len(group)),
            "wrong": format_figure(merit.ended_wrong_share(group), "%"),
            "covered": format_figure(merit.coverage(group), "%"),
            "nees": format_figure(
                statistics.share_in_band(merit.known_values(group, "nees.rotation"), N_ROTATION), "%"
            ),
            "nees_mass": format_figure(statistics.share_in_band(merit.known_values(group, "nees.mass"), 1), "%"),
        }
        for name, group in groups.items()
        if group
    ]


def coverage(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Makes table rows of coverage and mean error of each parameter."""
    table = []
    for name in NAMES:
        sigmas = merit.normalized_errors(rows, name)
        if sigmas:
            table.append(
                {
                    "parameter": charts.PARAMETERS[name],
                    "within": [format_figure(figure, "%") for figure in coverage_by_sigma(rows, name).values()],
                    "mean": format_figure(statistics.mean(sigmas), ""),
                    "n": str(len(sigmas)),
                }
            )
    return table


def worst(study: Study) -> list[dict[str, str]]:
    """Makes table rows of the worst cases of all cells: reasons, and commands to fly and view them again."""
    cell_of = {row["case_id"]: f", {cell.label}" for cell in study.cells for row in cell.rows if len(study.cells) > 1}
    folder = shlex.quote(str(study.folder))
    table = []
    for row in merit.worst_cases(study.rows):
        number = row["case_id"]
        place = shlex.quote(str(study.folder / "cases" / case_name(number)))
        table.append(
            {
                "case": case_name(number),
                "cell": cell_of.get(number, ""),
                "link": study.kept.get(number, ""),
                "why": "; ".join(row["failing"]),
                "rerun": f"massprop campaign run {folder} --only {number}",
                "view": f"massprop run {place} --view",
            }
        )
    return table


def execution(study: Study) -> list[tuple[str, str]]:
    """Returns name and text of versions and processor features of the execution, and the processor time."""
    rows = study.rows
    spent = sorted(merit.known_values(rows, "cpu_s"))
    lines = list(study.execution.items())
    if spent:
        lines.append(("processor time", f"{sum(spent) / 3600.0:.3g} h, median {spent[len(spent) // 2]:.3g} s a case"))
    return lines
