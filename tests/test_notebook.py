"""The notebooks of the documentation run with the package alone, and come out as they say."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

TUTORIALS = REPOSITORY / "docs" / "tutorials"
NOTEBOOKS = ("notebook", "drake")
WHERE = "import massprop_drake; print(massprop_drake.__file__)"


def code(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def kept(name: str) -> dict[str, Any]:
    """A notebook as it lies in the repository."""
    notebook: dict[str, Any] = json.loads((TUTORIALS / f"{name}.ipynb").read_text(encoding="utf-8"))
    return notebook


def done(name: str, wheel: Path, folder: Path) -> dict[str, Any]:
    """A notebook with its outputs, run from an empty folder with the unpacked wheel in front of everything else."""
    pytest.importorskip("nbconvert", reason="nbconvert is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(folder / "site")], check=True)
    asked = kept(name)
    asked["cells"].append({**code(asked)[0], "id": "where", "source": [WHERE]})
    (folder / "asked.ipynb").write_text(json.dumps(asked), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "nbconvert",
        "--to",
        "notebook",
        "--execute",
        "--output",
        "done.ipynb",
        "asked.ipynb",
    ]
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "IPYTHONDIR": str(folder / "ipython")}
    ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    notebook: dict[str, Any] = json.loads((folder / "done.ipynb").read_text(encoding="utf-8"))
    where = code(notebook)[-1]["outputs"][0]["text"]
    assert Path("".join(where).strip()).is_relative_to(folder / "site")
    return notebook


@pytest.fixture(scope="module")
def executed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The notebook of a failed jet."""
    return done("notebook", wheel, tmp_path_factory.mktemp("notebook"))


@pytest.fixture(scope="module")
def in_drake(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The notebook of a Drake user, and the folder that it ran in."""
    folder = tmp_path_factory.mktemp("drake")
    return done("drake", wheel, folder), folder


def printed(notebook: dict[str, Any]) -> str:
    """What its cells print."""
    outputs = [output for cell in code(notebook) for output in cell["outputs"]]
    return "".join("".join(output["text"]) for output in outputs if output["output_type"] == "stream")


def shown(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """What its cells show, by kind."""
    return [output.get("data", {}) for cell in code(notebook) for output in cell["outputs"]]


def complaints(notebook: dict[str, Any]) -> list[Any]:
    outputs = [output for cell in code(notebook) for output in cell["outputs"]]
    return [output for output in outputs if output.get("name") == "stderr"]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_kept_without_outputs(name: str) -> None:
    cells = code(kept(name))
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None] == []
    assert [cell for cell in cells if cell["metadata"]] == []


def test_it_finds_the_jet_and_its_estimator_agrees(executed: dict[str, Any]) -> None:
    text = printed(executed)
    assert "R4R: jet_on, +869 lbf" in text
    assert "since 50.00 s, declared at 50.16 s" in text
    assert "the same ten numbers, bit for bit" in text


def test_tables_and_figures_show_themselves(executed: dict[str, Any]) -> None:
    outputs = shown(executed)
    assert sum("image/png" in data for data in outputs) == 2
    (table,) = ["".join(data["text/html"]) for data in outputs if "text/html" in data]
    assert "Found: jet R4R (cluster 12): stuck on, " in table
    assert max(len("".join(data.get("text/plain", ""))) for data in outputs) < 500


def test_it_complains_of_nothing(executed: dict[str, Any]) -> None:
    assert complaints(executed) == []


def test_the_simulator_of_a_drake_user_stops_at_the_leak_and_the_run_names_it(
    in_drake: tuple[dict[str, Any], Path],
) -> None:
    notebook, _ = in_drake
    text = printed(notebook)
    assert "YP1 has failed, known at 37.1 s\ninnovations: consistent" in text
    assert "YP1: leak, +0.20 N, named at 37.1 s" in text
    assert "rad ('slosh_y', 'slosh_x')" in text
    assert complaints(notebook) == []


def test_graph_figures_and_flight_are_shown(in_drake: tuple[dict[str, Any], Path]) -> None:
    notebook, folder = in_drake
    outputs = shown(notebook)
    (graph,) = ["".join(data["image/svg+xml"]) for data in outputs if "image/svg+xml" in data]
    for part in ("autopilot", "vehicle", "estimation"):
        assert f">{part}<" in graph
    assert sum("image/png" in data for data in outputs) == 2
    table, flight = ["".join(data["text/html"]) for data in outputs if "text/html" in data]
    assert "Found: jet YP1 (cluster " in table
    assert 'src="replay.html"' in flight
    replay = (folder / "replay.html").read_text(encoding="utf-8")
    assert "meshcat" in replay.lower()
    assert "links" in replay  # of the model, with its own shapes
