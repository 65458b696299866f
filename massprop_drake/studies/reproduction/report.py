"""What a reproduction leaves: results as data, a page in Markdown and one in HTML with every figure in it."""

from __future__ import annotations

import base64
import html
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from massprop_drake.results.folder import write_whole
from massprop_drake.studies.reproduction.claims import Outcome, Verdict
from massprop_drake.studies.reproduction.entry import Entry


@dataclass(frozen=True)
class Reproduced:
    """An entry with what became of it.

    Attributes:
        entry: the entry.
        outcomes: of its claims, in their order.
        pictures: files of its figures, relative to the output folder.
    """

    entry: Entry
    outcomes: tuple[Outcome, ...]
    pictures: tuple[Path, ...]


def counted(results: Sequence[Reproduced]) -> dict[str, int]:
    """How many claims got which verdict."""
    counts = Counter(outcome.verdict for result in results for outcome in result.outcomes)
    return {verdict.value: counts[verdict] for verdict in Verdict}


def summary_line(results: Sequence[Reproduced]) -> str:
    """The counts as a sentence."""
    counts = counted(results)
    total = sum(counts.values())
    parts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    good = total - counts[Verdict.DIFFERS]
    return f"{total} claims: {parts} ({100.0 * good / max(total, 1):.0f} % hold, by themselves or within spread)"


def as_data(results: Sequence[Reproduced]) -> dict[str, Any]:
    """The results for `--json`."""
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


def write(folder: Path, results: Sequence[Reproduced]) -> None:
    """Writes `reproduction.json`, `reproduction.md` and `reproduction.html`, each in one step."""
    write_whole(folder / "reproduction.json", json.dumps(as_data(results), indent=2) + "\n")
    write_whole(folder / "reproduction.md", markdown(results))
    write_whole(folder / "reproduction.html", page(results, folder))


_LEGEND = (
    "Measured: the median over the sensor phases, in brackets their central 95 %, and what share of them meets what is "
    "expected, or where among them the thesis's number falls. A claim holds when 95 % of the phases meet it and holds "
    "within spread when 5 % do; a printed number holds within spread when it lies in the central 95 %."
)


def markdown(results: Sequence[Reproduced], *, pictures: bool = True) -> str:
    """The results as Markdown: a section and a table per entry."""
    lines = ["# The thesis, claim by claim", "", summary_line(results) + ".", "", _LEGEND, ""]
    for result in results:
        lines += [f"## {_heading(result.entry)}", ""]
        lines += [f"![{result.entry.title}]({picture.as_posix()})" for picture in result.pictures if pictures]
        lines += [""] if result.pictures and pictures else []
        lines += table(result)
        lines.append("")
    return "\n".join(lines)


def table(result: Reproduced) -> list[str]:
    """The claims of an entry as lines of a Markdown table."""
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


def _heading(entry: Entry) -> str:
    return f"{label(entry)}: {entry.title}"


def label(entry: Entry) -> str:
    """The thesis's name of an entry, such as Figure 5-2 for fig_5_2."""
    kind, _, number = entry.name.partition("_")
    names = {"fig": "Figure", "table": "Table", "section": "Section"}
    separator = "." if kind == "section" else "-"
    return (
        f"{names[kind]} {number.replace('_', separator)}"
        if kind in names
        else entry.name.replace("_", " ").capitalize()
    )


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1c2430; background: #fff; max-width: 70rem; margin: 2rem auto;
       padding: 0 1rem; }
h1, h2 { font-weight: 600; } h2 { margin-top: 2.5rem; border-top: 1px solid #dde3ea; padding-top: 1rem; }
img { max-width: 100%; display: block; margin: .5rem 0; }
table { border-collapse: collapse; width: 100%; font-size: 13px; }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem; border-bottom: 1px solid #e6ebf0; }
th { color: #5a6675; font-weight: 500; }
.verdict { white-space: nowrap; font-weight: 600; } .why { white-space: normal; font-weight: 400; color: #5a6675; }
.holds { color: #00795c; } .within { color: #0072b2; } .differs { color: #c04a00; }
nav a { margin-right: .7rem; white-space: nowrap; }
"""
_CLASSES = {Verdict.HOLDS: "holds", Verdict.SPREAD: "within", Verdict.DIFFERS: "differs"}


def page(results: Sequence[Reproduced], folder: Path) -> str:
    """The results as one HTML file that needs no other, its figures from the folder."""
    links = " ".join(f'<a href="#{r.entry.name}">{_text(label(r.entry))}</a>' for r in results)
    sections = "\n".join(_section(result, folder) for result in results)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>The thesis, claim by claim</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head><body>\n'
        f"<h1>The thesis, claim by claim</h1>\n<p>{_text(summary_line(results))}.</p>\n<p>{_text(_LEGEND)}</p>\n"
        f"<nav>{links}</nav>\n{sections}\n</body></html>\n"
    )


def _section(result: Reproduced, folder: Path) -> str:
    images = "".join(
        f'<img alt="{_text(result.entry.title)}" src="data:image/png;base64,'
        f'{base64.b64encode((folder / picture).read_bytes()).decode()}">'
        for picture in result.pictures
    )
    heads = "".join(f"<th>{head}</th>" for head in ("claim", "thesis", "expected", "measured", "verdict"))
    rows = "\n".join(_row(outcome) for outcome in result.outcomes)
    return (
        f'<h2 id="{result.entry.name}">{_text(_heading(result.entry))}</h2>\n{images}\n'
        f"<table><thead><tr>{heads}</tr></thead><tbody>\n{rows}\n</tbody></table>"
    )


def _row(outcome: Outcome) -> str:
    claim = outcome.claim
    cells = "".join(
        f"<td>{_text(cell)}</td>" for cell in (claim.text, claim.thesis, _expected(outcome), outcome.measured)
    )
    why = f'<div class="why">{_text(outcome.why)}</div>' if outcome.why else ""
    return f'<tr>{cells}<td class="verdict {_CLASSES[outcome.verdict]}">{outcome.verdict.value}{why}</td></tr>'


def _text(content: str) -> str:
    return html.escape(content)
