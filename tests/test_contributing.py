"""What CONTRIBUTING.md shows is true of the code."""

from __future__ import annotations

import re

import numpy as np
from conftest import REPOSITORY

from massprop_drake import Run
from massprop_drake.display import plots
from massprop_drake.display.figures import drawn

TEXT = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.DOTALL | re.MULTILINE)


def test_what_it_names_is_there() -> None:
    named = set(re.findall(r"[`(]([\w./]+/[\w./]*|[A-Z]+\.md)[`)]", TEXT))
    named -= {"figures/"} | {name for name in named if "frozen" in name}  # a run's; the worked example's own
    assert len(named) > 10
    places = (REPOSITORY, REPOSITORY / "massprop_drake")
    assert [name for name in sorted(named) if not any((place / name).exists() for place in places)] == []


def test_its_targets_are_those_of_make() -> None:
    targets = set(re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert {word for line in re.findall(r"^make ([a-z ]+?)  ", TEXT, re.MULTILINE) for word in line.split()} <= targets


def test_its_figure_is_drawn(short_run: Run) -> None:
    (function,) = (code for code in PYTHON if "-> Plot" in code)
    scope = dict(vars(plots))
    exec(compile(function, "CONTRIBUTING.md", "exec"), scope)
    figure = drawn(scope["attitude_error"](plots.source(short_run)))
    line = figure.axes[1].lines[0].get_ydata()
    np.testing.assert_allclose(line, np.degrees(short_run["attitude_error"][:, 1]), rtol=1e-12)


def test_its_claim_is_one_of_the_reproduction() -> None:
    (claim,) = (code for code in PYTHON if code.startswith("Claim("))
    entry = REPOSITORY / "massprop_drake" / "studies" / "reproduction" / "entries" / "conclusions.py"
    assert "".join(claim.split()) in "".join(entry.read_text(encoding="utf-8").split())
