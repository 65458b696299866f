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

from massprop_drake.display import templates
from massprop_drake.results.folder import write_files
from reproduction.claims import Outcome, Source, Verdict
from reproduction.entry import Entry


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


def counted(results: Sequence[Reproduced], source: Source = Source.THESIS) -> dict[str, int]:
    """Counts the claims of a source by verdict."""
    outcomes = (outcome for result in results for outcome in result.outcomes)
    counts = Counter(outcome.verdict for outcome in outcomes if outcome.claim.source is source)
    return {verdict.value: counts[verdict] for verdict in Verdict}


_OF = {
    Source.THESIS: "claims of the thesis",
    Source.REFERENCE: "numbers of our reference",
    Source.ERRATA: "errata that it names",
}


def summary_line(results: Sequence[Reproduced]) -> str:
    """Sums up the verdicts in a sentence: the claims of the thesis, and apart from them those of our reference."""
    thesis, *others = (_counts_text(counted(results, source), words) for source, words in _OF.items())
    apart = [text for source, text in zip(list(_OF)[1:], others, strict=True) if sum(counted(results, source).values())]
    return f"{thesis}. Apart from these: {'; '.join(apart)}" if apart else thesis


def _counts_text(counts: dict[str, int], words: str) -> str:
    """Formats counts by verdict as text."""
    return f"{sum(counts.values())} {words}: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}"


def as_data(results: Sequence[Reproduced]) -> dict[str, Any]:
    """Returns the results as `--json` prints them."""
    return {
        "format": 1,
        "version": version("massprop-drake"),
        "verdicts": counted(results),
        "apart": {source.value: counted(results, source) for source in Source if source is not Source.THESIS},
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
    """Returns a claim and its outcome as data for JSON."""
    claim = outcome.claim
    return {
        "row": claim.row,
        "claim": claim.text,
        "thesis": claim.thesis,
        "source": claim.source.value,
        "expected": claim.expected,
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


_HERE = Path(__file__).parent
_TITLE = "The thesis, claim by claim"
_LEGEND = (
    "Source: thesis, what its words, figures and tables say; reference, a number that our reference worked out from "
    "the thesis's equations or found by a check of them; errata, what it says of errors in the thesis. "
    "Measured: the median over the sensor phases, in brackets their central 95 %, and what share of them meets what is "
    "expected, or where among them the source's number falls. A claim holds when 95 % of the phases meet it, holds "
    "within spread when half do, and else differs; a printed number holds within spread when it lies in the central "
    "95 %. Words that leave room are read as it says beside the bound."
)


def markdown(results: Sequence[Reproduced]) -> str:
    """Renders the results as Markdown, a section with a table per entry."""
    lines = [f"# {_TITLE}", "", summary_line(results) + ".", "", _LEGEND, ""]
    for result in results:
        lines += [f"## {label(result.entry)}: {result.entry.title}", ""]
        lines += [f"![{result.entry.title}]({picture.as_posix()})" for picture in result.pictures]
        lines += [""] if result.pictures else []
        lines += [*table(result), ""]
    return "\n".join(lines)


def table(result: Reproduced) -> list[str]:
    """Lists the claims of an entry as lines of a Markdown table."""
    lines = ["| claim | source | its words | expected | measured | verdict |", "| --- | --- | --- | --- | --- | --- |"]
    for outcome in result.outcomes:
        claim = outcome.claim
        verdict = outcome.verdict.value + (f": {outcome.why}" if outcome.why else "")
        cells = (claim.text, claim.source, claim.thesis, claim.expected, outcome.measured, verdict)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


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
    content = {
        "title": _TITLE,
        "summary": summary_line(results),
        "legend": _LEGEND,
        "sections": [
            {
                "name": result.entry.name,
                "label": label(result.entry),
                "title": result.entry.title,
                "pictures": [_base64_text(folder / picture) for picture in result.pictures],
                "rows": [{**_claim_data(outcome), "style": _STYLES[outcome.verdict]} for outcome in result.outcomes],
            }
            for result in results
        ],
    }
    return templates.page(_HERE / "page.html", content, styles=[(_HERE / "page.css").read_text(encoding="utf-8")])


def _base64_text(picture: Path) -> str:
    """Encodes an image file in base64."""
    return base64.b64encode(picture.read_bytes()).decode()
