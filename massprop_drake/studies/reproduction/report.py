"""Reports a reproduction: as data, in Markdown, and as an HTML page that holds every figure."""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from massprop_drake.display.page import environment
from massprop_drake.results.folder import write_files
from massprop_drake.studies.reproduction.claims import Outcome, Verdict
from massprop_drake.studies.reproduction.entry import Entry


@dataclass(frozen=True)
class Reproduced:
    """An entry and what became of it.

    Attributes:
        entry: the entry.
        outcomes: of its claims, in their order.
        pictures: files of its figures, relative to the folder of the reproduction.
    """

    entry: Entry
    outcomes: tuple[Outcome, ...]
    pictures: tuple[Path, ...]


def counted(results: Sequence[Reproduced]) -> dict[str, int]:
    """Counts the claims by verdict."""
    counts = Counter(outcome.verdict for result in results for outcome in result.outcomes)
    return {verdict.value: counts[verdict] for verdict in Verdict}


def summary_line(results: Sequence[Reproduced]) -> str:
    """Sums up the verdicts in a sentence."""
    counts = counted(results)
    total = sum(counts.values())
    parts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    good = total - counts[Verdict.DIFFERS]
    return f"{total} claims: {parts} ({100.0 * good / max(total, 1):.0f} % hold, by themselves or within spread)"


def as_data(results: Sequence[Reproduced]) -> dict[str, Any]:
    """Returns the results as `--json` prints them."""
    return {
        "format": 1,
        "version": version("massprop-drake"),
        "verdicts": counted(results),
        "entries": [
            {
                "name": result.entry.name,
                "title": result.entry.title,
                "figures": [str(picture) for picture in result.pictures],
                "claims": [_claim_data(outcome) for outcome in result.outcomes],
            }
            for result in results
        ],
    }


def _claim_data(outcome: Outcome) -> dict[str, Any]:
    claim = outcome.claim
    return {
        "row": claim.row,
        "claim": claim.text,
        "thesis": claim.thesis,
        "expected": str(claim.expect),
        "unit": claim.unit,
        "measured": outcome.measured,
        "verdict": outcome.verdict.value,
        "why": outcome.why,
    }


PAGES = ("reproduction.json", "reproduction.md", "reproduction.html")


def write(folder: Path, results: Sequence[Reproduced], *, force: bool = False) -> None:
    """Writes the `PAGES`, each whole or not at all."""
    texts = (json.dumps(as_data(results), indent=2) + "\n", markdown(results), page(results, folder))
    pages = {name: text.encode() for name, text in zip(PAGES, texts, strict=True)}
    write_files(folder, pages, force=force)


_LEGEND = (
    "Measured: the median over the sensor phases, in brackets their central 95 %, and what share of them meets what is "
    "expected, or where among them the thesis's number falls. A claim holds when 95 % of the phases meet it and holds "
    "within spread when 5 % do; a printed number holds within spread when it lies in the central 95 %."
)


def markdown(results: Sequence[Reproduced], *, pictures: bool = True) -> str:
    """Renders the results as Markdown, a section with a table per entry."""
    lines = ["# The thesis, claim by claim", "", summary_line(results) + ".", "", _LEGEND, ""]
    for result in results:
        lines += [f"## {label(result.entry)}: {result.entry.title}", ""]
        lines += [f"![{result.entry.title}]({picture.as_posix()})" for picture in result.pictures if pictures]
        lines += [""] if result.pictures and pictures else []
        lines += table(result)
        lines.append("")
    return "\n".join(lines)


def table(result: Reproduced) -> list[str]:
    """Lists the claims of an entry as lines of a Markdown table."""
    lines = ["| claim | thesis | expected | measured | verdict |", "| --- | --- | --- | --- | --- |"]
    for outcome in result.outcomes:
        claim = outcome.claim
        verdict = outcome.verdict.value + (f": {outcome.why}" if outcome.why else "")
        cells = (claim.text, claim.thesis, _expected(outcome), outcome.measured, verdict)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def _expected(outcome: Outcome) -> str:
    unit = outcome.claim.unit
    return f"{outcome.claim.expect} {unit}".strip()


def label(entry: Entry) -> str:
    """Names an entry as the thesis does: Figure 5-2 for fig_5_2."""
    kind, _, number = entry.name.partition("_")
    names = {"fig": "Figure", "table": "Table", "section": "Section"}
    separator = "." if kind == "section" else "-"
    return (
        f"{names[kind]} {number.replace('_', separator)}"
        if kind in names
        else entry.name.replace("_", " ").capitalize()
    )


_STYLES = {Verdict.HOLDS: "holds", Verdict.SPREAD: "within", Verdict.DIFFERS: "differs"}


def page(results: Sequence[Reproduced], folder: Path) -> str:
    """Renders the results as one HTML file that needs no other.

    Args:
        results: of the entries, in their order.
        folder: that the figures are read from.
    """
    return (
        environment(Path(__file__).parent)
        .get_template("page.html")
        .render(
            summary=summary_line(results),
            legend=_LEGEND,
            sections=[
                {
                    "name": result.entry.name,
                    "label": label(result.entry),
                    "title": result.entry.title,
                    "pictures": [_encoded(folder / picture) for picture in result.pictures],
                    "rows": [_row(outcome) for outcome in result.outcomes],
                }
                for result in results
            ],
        )
    )


def _row(outcome: Outcome) -> dict[str, str]:
    claim = outcome.claim
    return {
        "claim": claim.text,
        "thesis": claim.thesis,
        "expected": _expected(outcome),
        "measured": outcome.measured,
        "verdict": outcome.verdict.value,
        "style": _STYLES[outcome.verdict],
        "why": outcome.why,
    }


def _encoded(picture: Path) -> str:
    return base64.b64encode(picture.read_bytes()).decode()
