"""What README.md shows works as shown."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.display import figures

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize(
    "code", blocks("python"), ids=lambda code: f"line {README[: README.index(code)].count(chr(10))}"
)
def test_python_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})  # a run's folder with figures: test_command_line
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_real_time_example_prints_what_the_text_says(capsys: pytest.CaptureFixture[str]) -> None:
    code = next(code for code in blocks("python") if "estimator.step" in code)
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    printed = capsys.readouterr().out.strip()
    assert f"This prints `{printed}`" in README


def test_scenario_runs(tmp_path: Path) -> None:
    (text,) = (block for block in blocks("yaml") if block.startswith("name:"))
    path = tmp_path / "with_payload.yaml"
    path.write_text(text, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    run = simulate(scenario)
    assert run.summary["duration_s"] == pytest.approx(scenario.duration_s)
    said = re.search(r"below (\S+) % in the moments of inertia, (\S+) % .* along x, (\S+) % in the mass", README)
    assert said is not None
    moments, along_x, mass = map(float, said.groups())
    found, true = run.summary["derived"], scenario.plant.mass_properties
    off = 100.0 * np.abs(np.diag(found["inertia"]) / np.diag(true.inertia) - 1.0)
    assert off.max() < moments
    assert abs(run.summary["percent_error"]["center_of_mass"][0]) < along_x
    assert abs(run.summary["percent_error"]["mass_reciprocal"]) < mass


def test_links_lead_somewhere() -> None:
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if not link.startswith("https://")]
    missing = [link for link in links if not (Path(__file__).parent.parent / link).exists()]
    assert "LICENSE" in links
    assert missing == []
