"""Words of a campaign's report: figures with their intervals, and the sentences of the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from massprop_drake.studies.campaign import merit
from massprop_drake.studies.campaign.counts import (
    failed_to_run_text,
    outcome_sentences,
    progress_text,
    select_flown,
    select_judgeable,
)
from massprop_drake.studies.campaign.merit import DELAYS_S, MEANINGS, GateResult
from massprop_drake.studies.campaign.reading import Cell, Study
from massprop_drake.studies.campaign.statistics import Figure


def format_figure(figure: Figure, unit: str, *, interval: bool = True) -> str:
    """Formats a figure, value with bounds, such as '12.5 % (8.1 to 18.4)'."""
    if math.isnan(figure.value):
        bounded = figure.n and math.isfinite(figure.low)
        return f"at least {_number(figure.low, unit)}{_unit_suffix(unit)}" if bounded else "-"
    text = f"{_number(figure.value, unit)}{_unit_suffix(unit)}"
    return f"{text} ({format_interval(figure, unit)})" if interval and not math.isnan(figure.low) else text


def format_interval(figure: Figure, unit: str) -> str:
    """Formats the interval of a figure, such as '8.1 to 18.4'."""
    if math.isnan(figure.low) or math.isnan(figure.high):
        return ""
    if math.isinf(figure.high):
        return f"from {_number(figure.low, unit)}" if math.isfinite(figure.low) else "unknown"
    return f"{_number(figure.low, unit)} to {_number(figure.high, unit)}"


def _number(value: float, unit: str) -> str:
    """Formats a number in a unit, shares in percent."""
    if unit != "%":
        return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.3e}"
    return f"{100.0 * value:.1f}" if 0.0 < value < 1.0 else f"{100.0 * value:.0f}"


def _unit_suffix(unit: str) -> str:
    """Returns a unit after a blank; empty without one."""
    return f" {unit}" if unit else ""


def figure_row(name: str, figure: Figure) -> dict[str, str]:
    """Makes the table row of a figure of merit: words, value, interval and number of samples as text."""
    words, unit, measured_on = MEANINGS[name]
    text = format_figure(figure, unit, interval=False)
    return {
        "name": name, "words": words, "value": text,
        "interval": format_interval(figure, unit) if text[0] != "a" else "",
        "n": f"{figure.n:.3g} {measured_on}" if "hours" in measured_on else f"{figure.n:g} {measured_on}",
    }  # fmt: skip


def verdict(study: Study) -> list[dict[str, Any]]:
    """Returns the verdict's sentences, each a `text` with `good`: True, False, or None where not judged."""
    sentences: list[dict[str, Any]] = []

    def say(good: bool | None, text: str) -> None:
        """Adds a sentence to the verdict, with whether it is good."""
        sentences.append({"good": good, "text": text})

    cell = study.cells[study.reference]
    all_figures = [merit.figures(swept_cell.rows) for swept_cell in study.cells]
    found = all_figures[study.reference]
    judged = [merit.judge_gates(study.spec.file.gates, figures) for figures in all_figures]
    for results in zip(*judged, strict=True):
        say(all(result.passes for result in results), _gate_sentence(results, study.cells))
    for sentence in outcome_sentences(study.status):
        say(None, sentence)
    if len(study.cells) > 1:
        why = "the first cell" if study.reference == 0 else "the base scenario's own settings"
        say(None, f"Figures below, unless they say otherwise, are with {cell.label}, {why}.")
    judged_rows = select_judgeable(cell.rows)
    if judged_rows:
        rate, hours = found["false_declarations_per_hour"], merit.hours(judged_rows)
        count = len(merit.false_declarations(judged_rows))
        say(
            None,
            f"{count} false declarations in {hours:.3g} hours flown: {format_figure(rate, 'per hour')}; "
            f"{format_figure(found['false_declarations_in_case'], '%')} of the cases have one.",
        )
        wrong, out = (format_figure(found[name], "%") for name in ("ended_wrong", "healthy_jets_out"))
        say(None, f"{wrong} of the cases end wrong; {out} end with a healthy jet out of use.")
    else:
        count, hours = sum(len(row["declared"]) for row in select_flown(cell.rows)), merit.hours(cell.rows)
        say(None, f"{count} declarations in {hours:.3g} hours of telemetry; which of them are right nobody says.")
    acted = merit.events(cell.rows)
    if acted:
        within = ", ".join(f"{format_figure(found[f'found_within_{d:g}_s'], '%')} within {d:g} s" for d in DELAYS_S)
        say(None, f"Of {len(acted)} failures that acted, {format_figure(found['isolated'], '%')} were found: {within}.")
    never = sum(counts["never_acted"] for counts in merit.count_outcomes(cell.rows).values())
    if never:
        say(None, f"{never} failure{'s' if never > 1 else ''} never acted, and no figure counts them.")
    counts = study.status.counts
    if counts.failed_to_run:
        say(False, failed_to_run_text(counts))
    if counts.tried < counts.planned:
        say(False, progress_text(counts))
    return sentences


def _gate_sentence(results: Sequence[GateResult], cells: Sequence[Cell]) -> str:
    """Formats a gate's outcome: passed or failed, the figure's value in each cell, and the bounds asked."""
    gate, (words, unit, _) = results[0].gate, MEANINGS[results[0].name]
    asked = " and ".join(
        f"{word} {_number(bound, unit)}{_unit_suffix(unit)}"
        for word, bound in (("at least", gate.min), ("at most", gate.max))
        if bound is not None
    )
    values = [
        "not measured" if math.isnan(result.value) else f"{_number(result.value, unit)}{_unit_suffix(unit)}"
        for result in results
    ]
    if len(cells) > 1:
        values = [f"{value} with {cell.label}" for value, cell in zip(values, cells, strict=True)]
    verdict = "passed" if all(result.passes for result in results) else "failed"
    on = "" if gate.on == "estimate" else f", {gate.on.replace('_', ' ')}"
    return f"Gate {verdict}: {words}{on}: {'; '.join(values)}; asked {asked}."
