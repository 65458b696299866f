"""The notebooks of the documentation run with the package alone, and come out as they say."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

TUTORIALS = REPOSITORY / "docs" / "tutorials"
NOTEBOOKS = ("notebook", "drake")
WHERE = "import massprop_drake; print(massprop_drake.__file__)"

Outputs = list[dict[str, Any]]


def cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def kept(name: str) -> dict[str, Any]:
    """A notebook as it lies in the repository."""
    notebook: dict[str, Any] = json.loads((TUTORIALS / f"{name}.ipynb").read_text(encoding="utf-8"))
    return notebook


def done(name: str, wheel: Path, folder: Path) -> Outputs:
    """Outputs of a notebook, run from an empty folder with the unpacked wheel in front of everything else."""
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(folder / "site")], check=True)
    asked = kept(name)
    asked["cells"].append({**cells(asked)[0], "id": "where", "source": [WHERE]})
    (folder / "asked.ipynb").write_text(json.dumps(asked), encoding="utf-8")
    command = [sys.executable, "-m", "nbconvert", "--to=notebook", "--execute", "--output=done.ipynb", "asked.ipynb"]
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "IPYTHONDIR": str(folder / "ipython")}
    ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    outputs = [one for cell in cells(json.loads((folder / "done.ipynb").read_text("utf-8"))) for one in cell["outputs"]]
    assert Path("".join(outputs.pop()["text"]).strip()).is_relative_to(folder / "site")
    assert [one for one in outputs if one.get("name") == "stderr"] == []
    return outputs


def printed(outputs: Outputs) -> str:
    return "".join("".join(one["text"]) for one in outputs if one["output_type"] == "stream")


def shown(outputs: Outputs, kind: str) -> list[str]:
    """Text that the cells of a kind show."""
    return ["".join(one["data"][kind]) for one in outputs if kind in one.get("data", {})]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_kept_without_outputs_and_imports_what_comes_with_the_package(name: str) -> None:
    code = cells(kept(name))
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"] is not None or cell["metadata"]] == []
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    there = {re.match(r"[\w-]+", one)[0] for one in project["dependencies"]} | {"massprop_drake", "pydrake", "IPython"}  # type: ignore[index]
    lines = "".join("".join(cell["source"]) + "\n" for cell in code)
    assert set(re.findall(r"^(?:import|from) (\w+)", lines, re.MULTILINE)) <= there | set(sys.stdlib_module_names)


@pytest.mark.documentation
def test_the_notebook_finds_the_jet_and_shows_it(wheel: Path, tmp_path: Path) -> None:
    outputs = done("notebook", wheel, tmp_path)
    text = printed(outputs)
    assert "R4R: jet_on, +869 lbf" in text
    assert "since 50.00 s, declared at 50.16 s" in text
    assert "the same ten numbers, bit for bit" in text
    assert len(shown(outputs, "image/png")) == 2
    (table,) = shown(outputs, "text/html")
    assert "Found: jet R4R (cluster 12): stuck on, " in table
    assert max(map(len, shown(outputs, "text/plain"))) < 500


@pytest.mark.documentation
def test_the_simulator_of_a_drake_user_stops_at_the_leak(wheel: Path, tmp_path: Path) -> None:
    outputs = done("drake", wheel, tmp_path)
    text = printed(outputs)
    assert "YP1 has failed, known at 37.1 s\ninnovations: consistent" in text
    assert "YP1: leak, +0.20 N, named at 37.1 s" in text
    assert "rad ('slosh_y', 'slosh_x')" in text
    (graph,) = shown(outputs, "image/svg+xml")
    assert [part for part in ("autopilot", "vehicle", "estimation") if f">{part}<" not in graph] == []
    assert len(shown(outputs, "image/png")) == 2
    table, flight = shown(outputs, "text/html")
    assert "Found: jet YP1 (cluster " in table
    assert 'src="replay.html"' in flight
    replay = (tmp_path / "replay.html").read_text(encoding="utf-8")
    assert "meshcat" in replay.lower()
    assert "links" in replay  # of the model, with its own shapes
