"""The pictures of the diagrams that lie in the repository."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

from massprop_drake.display.graphs import DIAGRAMS

GALLERY = REPOSITORY / "diagrams" / "graphs"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All graphs, drawn in a process of their own: Drake counts the systems that it has made."""
    folder = tmp_path_factory.mktemp("graphs")
    command = [sys.executable, "-m", "massprop_drake", "graph", "--out", str(folder), "--quiet"]
    subprocess.run(command, check=True, cwd=folder)
    return folder


def test_the_gallery_shows_the_diagrams_as_they_are(drawn: Path) -> None:
    """When this fails: massprop graph --out diagrams/graphs."""
    names = {path.name for path in GALLERY.glob("*.dot")}
    assert names == {path.name for path in drawn.glob("*.dot")}
    for name in sorted(names):
        assert (GALLERY / name).read_text("utf-8") == (drawn / name).read_text("utf-8"), name


def test_every_diagram_has_its_picture() -> None:
    for name in DIAGRAMS:
        picture = (GALLERY / f"{name}.svg").read_text("utf-8")
        assert picture.lstrip().startswith(("<?xml", "<svg"))
    assert ">held_command<" in (GALLERY / "closed_loop.svg").read_text("utf-8")
