"""What CONTRIBUTING.md shows is true of the code."""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import REPOSITORY

from massprop_drake import Run, estimate, load_scenario, simulate
from massprop_drake.display import motion_plots
from massprop_drake.display.figures import draw_plot
from massprop_drake.display.plot_source import source
from massprop_drake.inputs import model, params
from massprop_drake.maths.estimation import filter as filter_module
from massprop_drake.maths.estimation.filters.registry import FILTERS

TEXT = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
PYTHON = [
    textwrap.dedent(code) for code in re.findall(r"^ *```python\n(.*?)^ *```$", TEXT, flags=re.DOTALL | re.MULTILINE)
]


def test_what_it_names_is_there() -> None:
    named = set(re.findall(r"[`(]([\w./]+/[\w./]*|[A-Z]+\.md)[`)]", TEXT))
    named -= {"figures/"} | {name for name in named if "frozen" in name}  # a run's; the worked example's own
    assert len(named) > 10
    places = (REPOSITORY, REPOSITORY / "massprop_drake")
    assert [name for name in sorted(named) if not any((place / name).exists() for place in places)] == []
    targets = set(re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {word for line in re.findall(r"^make ([a-z ]+?)  ", TEXT, re.MULTILINE) for word in line.split()} <= targets


def test_its_figure_is_drawn(short_run: Run) -> None:
    (function,) = (code for code in PYTHON if "-> Plot" in code)
    scope = dict(vars(motion_plots))
    exec(compile(function, "CONTRIBUTING.md", "exec"), scope)
    figure = draw_plot(scope["attitude_error"](source(short_run)))
    line = figure.axes[1].lines[0].get_ydata()
    np.testing.assert_allclose(line, np.degrees(short_run["attitude_error"][:, 1]), rtol=1e-12)


def test_its_claim_is_one_of_the_reproduction() -> None:
    (claim,) = (code for code in PYTHON if code.startswith("Claim("))
    entry = REPOSITORY / "reproduction" / "entries" / "conclusions.py"
    calls = {ast.dump(node) for node in ast.walk(ast.parse(entry.read_text(encoding="utf-8")))}
    assert ast.dump(ast.parse(claim, mode="eval").body) in calls


def test_its_filter_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel and the block as they are printed; the scenario's own field for the block is stood in for."""
    (kernel,) = (code for code in PYTHON if "class Frozen(" in code)
    (block,) = (code for code in PYTHON if "class FrozenBlock(" in code)
    scope: dict[str, Any] = {**vars(filter_module), **vars(model), "NamedTuple": NamedTuple, "Any": Any, "np": np}
    exec(compile("from __future__ import annotations\n" + block + kernel, "CONTRIBUTING.md", "exec"), scope)
    options = SimpleNamespace(frozen=scope["FrozenBlock"](covariance_factor=4.0))
    made = scope["FILTER"]._replace(params=lambda setup, _: scope["make_params"](setup, options))
    monkeypatch.setitem(FILTERS, "frozen", made)
    case = load_scenario("stuck_on_29", ["duration_s=2"])
    case = case.model_copy(update={"estimation": case.estimation.model_copy(update={"filter": "frozen"})})

    run = simulate(case)
    np.testing.assert_array_equal(run["estimate"], run["estimate"][:1].repeat(len(run.time_s), axis=0))
    run.save(tmp_path / "run", pictures=False, report=False)
    again = estimate(tmp_path / "run" / "telemetry.csv", case)
    np.testing.assert_array_equal(again["standard_deviation"], run["standard_deviation"])
    np.testing.assert_allclose(run["standard_deviation"][0], 2.0 * np.sqrt(params.initial_covariance(case).diagonal()))


def test_its_detector_is_the_one_that_is_there() -> None:
    (record,) = (code for code in PYTHON if code.startswith("DETECTOR = "))
    (block,) = (code for code in PYTHON if "class CusumBlock(" in code)
    folder = REPOSITORY / "massprop_drake"
    assert record in (folder / "maths" / "estimation" / "detectors" / "cusum.py").read_text(encoding="utf-8")
    assert any(block in path.read_text(encoding="utf-8") for path in (folder / "inputs").glob("*.py"))
