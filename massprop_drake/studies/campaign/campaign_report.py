"""Report of a campaign: as data for `summary.json`, and as one self-contained HTML page with the verdict first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from massprop_drake.display import plotted, templates
from massprop_drake.inputs.model import yaml_text
from massprop_drake.studies.campaign import merit, report_plots, report_tables
from massprop_drake.studies.campaign.counts import Row
from massprop_drake.studies.campaign.merit import GateResult
from massprop_drake.studies.campaign.reading import Study
from massprop_drake.studies.campaign.report_words import figure_row, verdict
from massprop_drake.studies.campaign.statistics import Figure

FORMAT = 1  # of a campaign's `summary.json`
SIZED = ("leak", "degraded")  # kinds of failures that have a size

_HERE = Path(__file__).parent
_DISPLAY = Path(templates.__file__).parent


# ------------------------------------------------------------------------------------------- as data


def summary_data(study: Study) -> dict[str, Any]:
    """Returns the summary of a campaign's results: counts, figures by cell, and gates with their verdicts.

    Gates hold for every cell. The figures at the top are those of the reference: the cell with the base scenario's own
    settings, or the first.
    """
    file = study.spec.file
    cells: list[dict[str, Any]] = []
    for number, cell in enumerate(study.cells):
        figures = merit.figures(cell.rows)
        cells.append(
            {
                "cell": number,
                "settings": dict(cell.settings),
                "cases": cell.numbers._asdict(),
                "hours": merit.hours(cell.rows),
                "figures": {name: figure_data(figure) for name, figure in figures.items()},
                "gates": [_gate_data(result) for result in merit.judge_gates(file.gates, figures)],
            }
        )
    gates = [{"cell": cell["cell"], **gate} for cell in cells for gate in cell["gates"]]
    return {
        "format": FORMAT,
        "version": version("massprop-drake"),
        "campaign": file.name,
        "description": file.description,
        "base": study.spec.base.name,
        "vehicle": study.spec.base.vehicle_data.name,
        "method": file.method,
        "seed": file.seed,
        "cases": study.status.counts._asdict(),
        "hours": merit.hours(study.rows),
        "passed": all(gate["passes"] for gate in gates),
        "gates": gates,
        "reference": study.reference,
        "figures": cells[study.reference]["figures"],
        "cells": cells,
        "injected": {kind: dict(counts) for kind, counts in merit.count_outcomes(study.rows).items()},
        "failed_to_run": _count_reasons(study.rows),
    }


def figure_data(figure: Figure) -> dict[str, float | None]:
    """Converts a figure, value with bounds, to JSON's numbers by name; null for unknown or unbounded."""
    return {name: value if math.isfinite(value) else None for name, value in figure._asdict().items()}


def _gate_data(result: GateResult) -> dict[str, Any]:
    """Converts the result of a gate to JSON values: figure, bounds, value, and whether it passes."""
    value = result.value if math.isfinite(result.value) else None
    return {"figure": result.name, **result.gate.model_dump(mode="json"), "value": value, "passes": result.passes}


def _count_reasons(rows: Sequence[Row]) -> dict[str, int]:
    """Maps each reason for which cases failed to run to their number, the most frequent first."""
    return dict(Counter(str(row["reason"]) for row in rows if row["status"] != "flown").most_common())


# -------------------------------------------------------------------------------------------- as page


def report_page(study: Study) -> str:
    """Returns the report of a campaign's results as the text of one HTML file."""
    return plotted.page(_HERE / "campaign.html", page_content(study))


def notebook_html(study: Study) -> str:
    """Returns title and verdict of a campaign as HTML for a notebook."""
    title = f"{study.spec.file.name}: {study.spec.base.name}"
    return templates.fragment(_DISPLAY / "summary.html", {"title": title, "verdict": verdict(study)})


def page_content(study: Study) -> dict[str, Any]:
    """Makes the content of the report page as plain values: texts, tables and plots."""
    spec = study.spec
    cell = study.cells[study.reference]
    rows = cell.rows
    figures = merit.figures(rows)
    failures = merit.events(rows)
    force = spec.base.vehicle_data.unit_names["force"]
    failures_by_kind = {kind: group for kind, group in merit.group_events(failures, "kind").items() if kind in SIZED}
    plots_by_section = {
        "detection": report_plots.delay_plots(study, failures),
        "isolation": report_plots.confusion_plots(study, failures, merit.events(rows, payloads=True)),
        "sizes": report_plots.size_plots(failures_by_kind, force),
        "magnitudes": report_plots.magnitude_plots(failures, force),
        "consistency": report_plots.consistency_plots(cell, spec.file.times_s),
        "sensitivity": report_plots.sensitivity_plots(study, cell),
    }
    return {
        "title": spec.file.name,
        "description": spec.file.description,
        "about": _headline(study),
        "verdict": verdict(study),
        "figures": [figure_row(name, figure) for name, figure in figures.items() if figure.n],
        "sweep": report_tables.sweep(study),
        "falsely": report_tables.false_declaration_rows(rows),
        "false_of": report_tables.false_declarations_by_jet(rows),
        "outcomes": report_tables.outcomes(rows),
        "delays": report_tables.delays(failures),
        "jumps": report_tables.jump_confusion_rows(rows),
        "healthy_out": report_tables.healthy_jets_out(
            rows, {jet.designation: jet.cluster for jet in spec.base.vehicle_data.jets}
        ),
        "leaks": {kind: report_tables.smallest_found_rows(group, force) for kind, group in failures_by_kind.items()},
        "magnitudes": report_tables.magnitudes(failures, force),
        "groups": report_tables.consistency_rows(rows),
        "coverage": report_tables.coverage(rows),
        "sobol": spec.file.method == "saltelli",
        "worst": report_tables.worst(study),
        "failed": list(_count_reasons(study.rows).items()),
        "execution": report_tables.execution(study),
        "file": yaml_text(spec.file),
        "base": yaml_text(spec.base),
        "places_of": plots_by_section,
        "plots": [plot for plots in plots_by_section.values() for plot in plots],
    }


def _headline(study: Study) -> str:
    """Formats one line on what was flown: scenario, vehicle, cases, hours, method and seed."""
    file, base = study.spec.file, study.spec.base
    cells = f" in {len(study.cells)} cells of a sweep" if len(study.cells) > 1 else ""
    return (
        f"{base.name} on {base.vehicle_data.name}: {study.status.counts.flown} cases{cells}, "
        f"{merit.hours(study.rows):.3g} hours flown, {file.method}, seed {file.seed}"
    )
