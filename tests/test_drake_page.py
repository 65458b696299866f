"""The program on docs/drake.md runs from top to bottom, and prints what is shown."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY, Massprop
from page_probe import blocks
from pydrake.systems.framework import DiagramBuilder

from massprop_drake import Run
from massprop_drake.display import figures

PAGE = (REPOSITORY / "docs" / "drake.md").read_text(encoding="utf-8")
STEP = re.compile(r"^```python\n(.*?)^```$(?:\n\nIt prints\n\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)

pytestmark = pytest.mark.documentation


@pytest.fixture
def massprop_there(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> Massprop:
    """The command, in an empty folder; runs that are saved have no figures, which other tests draw."""
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    return massprop


def test_its_program_runs_and_prints_what_is_shown(
    massprop_there: Massprop, capsys: pytest.CaptureFixture[str]
) -> None:
    steps, left = STEP.findall(PAGE), {"__name__": "page", "builder": DiagramBuilder()}
    assert sum(bool(shown) for _, shown in steps) == PAGE.count("It prints") == len(blocks(PAGE, "text"))
    for number, (code, shown) in enumerate(steps):
        exec(compile(code, f"drake.md, block {number}", "exec"), left)
        assert capsys.readouterr().out == shown
    assert Path("my_run.mcap").stat().st_size > 0
    assert Path("my_run.rrd").stat().st_size > 0
    assert "YP1" in Path("my_run/report.html").read_text(encoding="utf-8")
    assert Run.load("my_run").results.detections[0].jet == "YP1"


def test_its_first_diagram_is_drawn(massprop_there: Massprop) -> None:
    (code,) = (block for block in blocks(PAGE, "python") if "def build" in block)
    Path("my_loop.py").write_text(code, encoding="utf-8")
    done: Any = massprop_there("graph", "my_loop.py:build")
    assert done.status == 0, done.err
    drawn = [path.read_text(encoding="utf-8") for path in Path().rglob("*.dot")]
    assert any("MassPropertyEstimator" in dot and "JetSchedule" in dot for dot in drawn)
