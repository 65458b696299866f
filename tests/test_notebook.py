"""The notebook of the documentation runs with the package alone, and comes out as it says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

NOTEBOOK = REPOSITORY / "docs" / "tutorials" / "notebook.ipynb"
WHERE = "import massprop_drake; print(massprop_drake.__file__)"


def code(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.fixture(scope="module")
def executed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The notebook with its outputs, run from an empty folder with the unpacked wheel in front of everything else."""
    pytest.importorskip("nbconvert", reason="nbconvert is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    folder = tmp_path_factory.mktemp("notebook")
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(folder / "site")], check=True)
    asked = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
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
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    notebook: dict[str, Any] = json.loads((folder / "done.ipynb").read_text(encoding="utf-8"))
    where = code(notebook)[-1]["outputs"][0]["text"]
    assert Path("".join(where).strip()).is_relative_to(folder / "site")
    return notebook


def printed(notebook: dict[str, Any]) -> str:
    """What its cells print."""
    outputs = [output for cell in code(notebook) for output in cell["outputs"]]
    return "".join("".join(output["text"]) for output in outputs if output["output_type"] == "stream")


def test_it_is_kept_without_outputs() -> None:
    kept = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert [cell for cell in code(kept) if cell["outputs"] or cell["execution_count"] is not None] == []
    assert [cell for cell in code(kept) if cell["metadata"]] == []


def test_it_finds_the_jet_and_its_estimator_agrees(executed: dict[str, Any]) -> None:
    text = printed(executed)
    assert "R4R: jet_on, +869 lbf" in text
    assert "since 50.00 s, declared at 50.16 s" in text
    assert "the same ten numbers, bit for bit" in text


def test_tables_and_figures_show_themselves(executed: dict[str, Any]) -> None:
    shown = [output.get("data", {}) for cell in code(executed) for output in cell["outputs"]]
    assert sum("image/png" in data for data in shown) == 2
    (table,) = ["".join(data["text/html"]) for data in shown if "text/html" in data]
    assert "Found: jet R4R: stuck on." in table
    assert max(len("".join(data.get("text/plain", ""))) for data in shown) < 500


def test_it_complains_of_nothing(executed: dict[str, Any]) -> None:
    outputs = [output for cell in code(executed) for output in cell["outputs"]]
    assert [output for output in outputs if output.get("name") == "stderr"] == []
