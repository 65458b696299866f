"""The report of a reproduction: counts, Markdown, and a page that needs no other file."""

from __future__ import annotations

import base64
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from reproduction import report
from reproduction.claims import AtMost, Claim, Outcome, Reading, Source, Verdict
from reproduction.entry import Entry

EVIL = "a <b> & \"c\" 'd' | e"


def _outcome(verdict: Verdict, why: str = "", source: Source = Source.THESIS) -> Outcome:
    claim = Claim(1, EVIL, "10 %", Reading(AtMost(10.0), "small"), lambda _: 0.0, unit="%", source=source)
    return Outcome(claim, np.array([2.0]), 2.0, verdict, 1.0, why)


@pytest.fixture
def results() -> list[report.Reproduced]:
    first = Entry("fig_5_2", f"Rates {EVIL}", {}, ())
    second = Entry("section_6_1", "Conclusions", {}, ())
    return [
        report.Reproduced(first, (_outcome(Verdict.HOLDS), _outcome(Verdict.DIFFERS, EVIL)), (Path("a.png"),)),
        report.Reproduced(second, (_outcome(Verdict.SPREAD),), ()),
    ]


def test_the_page_says_what_was_found_and_holds_its_pictures(results: list[report.Reproduced], tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"picture")
    page = report.page(results, tmp_path)

    def texts(tag: str) -> list[str]:
        found = re.findall(rf"<{tag}[^>]*>(.*?)</{tag}>", page, re.DOTALL)
        return [unescape(re.sub(r"<div[^>]*>", ": ", text).replace("</div>", "")).strip() for text in found]

    assert texts("h2") == [f"Figure 5-2: Rates {EVIL}", "Section 6.1: Conclusions"]
    row = [EVIL, "thesis", "10 %", "≤ 10 % (small)", "2 %"]
    assert texts("td") == [*row, "holds", *row, f"differs: {EVIL}", *row, "holds within spread"]
    styles = ["source", "verdict holds", "source", "verdict differs", "source", "verdict within"]
    assert re.findall(r'<td class="([^"]*)"', page) == styles
    assert re.findall(r'src="([^"]*)"', page) == [f"data:image/png;base64,{base64.b64encode(b'picture').decode()}"]
    assert not re.search(r'(src|href)="(?!data:|#)', page)


def test_claims_that_are_not_the_thesis_s_are_counted_apart(results: list[report.Reproduced]) -> None:
    counts = {"holds": 1, "holds within spread": 1, "differs": 1}
    alone = "3 claims of the thesis: 1 holds, 1 holds within spread, 1 differs"
    assert (report.counted(results), report.summary_line(results)) == (counts, alone)
    ours = (
        *(_outcome(verdict, source=Source.REFERENCE) for verdict in (Verdict.HOLDS, Verdict.HOLDS, Verdict.DIFFERS)),
        _outcome(Verdict.SPREAD, source=Source.ERRATA),
    )
    results = [*results, report.Reproduced(Entry("errata", "Errata", {}, ()), ours, ())]
    line = (
        f"{alone}. Apart from these: "
        "3 numbers of our reference: 2 holds, 0 holds within spread, 1 differs; "
        "1 errata that it names: 0 holds, 1 holds within spread, 0 differs"
    )
    assert report.summary_line(results) == line
    assert f"\n{line}.\n" in report.markdown(results)
    data = report.as_data(results)
    assert data["verdicts"] == counts
    assert data["apart"] == {
        "reference": {"holds": 2, "holds within spread": 0, "differs": 1},
        "errata": {"holds": 0, "holds within spread": 1, "differs": 0},
    }
    sources = [claim["source"] for entry in data["entries"] for claim in entry["claims"]]
    assert sources == ["thesis"] * 3 + ["reference"] * 3 + ["errata"]
