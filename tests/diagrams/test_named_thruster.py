"""From MultibodyPlant to a named thruster: the tutorial's script is short, runs, and names it."""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

from massprop_drake import Run
from massprop_drake.display import figures

SCRIPT = REPOSITORY / "docs" / "tutorials" / "named_thruster.py"


def test_it_has_thirty_lines_at_most() -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    docstring, *code = ast.parse(text).body
    lines = [line for line in text.splitlines()[docstring.end_lineno :] if line and not line.startswith("#")]
    assert len(lines) <= 30
    assert all(len(line) <= 98 and ";" not in line for line in lines)
    assert len({statement.lineno for statement in code}) == len(code)


def test_it_names_the_thruster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})  # other tests draw them
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(tmp_path)])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    run = Run.load(tmp_path / "named_thruster")
    (found,) = run.results.detections
    assert (found.jet, found.mode, found.onset_s) == ("YP1", "leak", 35.0)
    assert found.magnitude == pytest.approx(0.2, abs=3.0 * found.magnitude_std)
    assert found.time_s < 36.0
    assert run.results.autopilot.jets_out_of_use == ["YP1"]
    assert (abs(run.results.estimates - run.results.truth) <= 3.0 * run.results.standard_deviations).all()
    assert 1.0 / run.results.truth[9] == pytest.approx(184.3)
