"""The pictures of the diagrams that lie in the repository."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

from massprop_drake.display.graphs import DIAGRAMS, build, overview_text

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


A4 = 780.0, 540.0  # points within the margins, on its side


@pytest.mark.parametrize("name", DIAGRAMS)
def test_an_overview_can_be_read_on_a_sheet_of_paper(name: str) -> None:
    picture = (GALLERY / f"{name}_overview.svg").read_text("utf-8")
    width, height = map(float, re.findall(r'<svg width="([\d.]+)pt" height="([\d.]+)pt"', picture)[0])
    scale = min(1.0, A4[0] / width, A4[1] / height)
    sizes = [float(size) for size in re.findall(r'font-size="([\d.]+)"', picture)]
    assert min(sizes) * scale >= 7.0


@pytest.mark.parametrize("name", DIAGRAMS)
def test_an_overview_has_every_part_and_one_arrow_for_each_pair(name: str) -> None:
    diagram = build(name)
    dot = overview_text(diagram)
    for system in diagram.GetSystems():
        assert f'"{system.get_name()}" [label=' in dot
    arrows = re.findall(r'^("\w+" -> "\w+") ', dot, flags=re.MULTILINE)
    pairs = {f'"{source.get_name()}" -> "{to.get_name()}"' for (to, _), (source, _) in diagram.connection_map().items()}
    assert sorted(arrows) == sorted(pairs)
    assert "massprop_drake" not in dot
