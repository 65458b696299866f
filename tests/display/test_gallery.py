"""The pictures of the diagrams that lie in the repository."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY
from pydrake.systems.framework import Diagram

from massprop_drake.cli import graphing
from massprop_drake.display import graphs

GALLERY = REPOSITORY / "diagrams" / "graphs"


@pytest.fixture(scope="module")
def diagrams() -> dict[str, Diagram]:
    return {name: graphs.build(name) for name in graphs.DIAGRAMS}


def test_the_gallery_shows_the_diagrams_as_they_are(
    diagrams: dict[str, Diagram], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When this fails: massprop graph --out diagrams/graphs."""
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)
    graphing.write({name: partial(diagrams.get, name) for name in diagrams}, tmp_path, force=False)
    names = {path.name for path in GALLERY.glob("*.dot")}
    assert names == {path.name for path in tmp_path.glob("*.dot")}
    for name in sorted(names):
        assert (GALLERY / name).read_text("utf-8") == (tmp_path / name).read_text("utf-8"), name
    assert {path.stem for path in GALLERY.glob("*.svg")} == {Path(name).stem for name in names}
    assert ">held_command<" in (GALLERY / "closed_loop.svg").read_text("utf-8")


OUTSIDE = """() => [...document.querySelectorAll("g.node")].flatMap(node => {
  const boxes = [...node.querySelectorAll("polygon, path")].map(shape => shape.getBBox());
  return [...node.querySelectorAll("text")].filter(text => {
    const own = text.getBBox(), x = own.x + own.width / 2, y = own.y + own.height / 2;
    const around = boxes.filter(box => box.x < x && x < box.x + box.width && box.y < y && y < box.y + box.height);
    return !around.length || around.some(box => box.x > own.x || own.x + own.width > box.x + box.width);
  }).map(text => text.textContent);
})"""  # texts of nodes that are wider than a box that they stand in


def test_text_is_inside_its_boxes_in_a_browser(opened: Any) -> None:
    for name in ("closed_loop", "closed_loop_overview"):
        picture = opened(GALLERY / f"{name}.svg", ready="svg").page
        assert picture.locator("g.node text").count() > 1
        assert picture.evaluate(OUTSIDE) == []


A4 = 780.0, 540.0  # points within the margins, on its side


@pytest.mark.parametrize("name", graphs.DIAGRAMS)
def test_an_overview_fits_a_sheet_with_every_part_and_one_arrow_for_each_pair(
    diagrams: dict[str, Diagram], name: str
) -> None:
    picture = (GALLERY / f"{name}_overview.svg").read_text("utf-8")
    width, height = map(float, re.findall(r'<svg width="([\d.]+)pt" height="([\d.]+)pt"', picture)[0])
    scale = min(1.0, A4[0] / width, A4[1] / height)
    assert min(float(size) for size in re.findall(r'font-size="([\d.]+)"', picture)) * scale >= 7.0
    diagram = diagrams[name]
    dot = graphs.overview_text(diagram)
    for system in diagram.GetSystems():
        assert f'"{system.get_name()}" [label=' in dot
    arrows = re.findall(r'^("\w+" -> "\w+") ', dot, flags=re.MULTILINE)
    pairs = {f'"{source.get_name()}" -> "{to.get_name()}"' for (to, _), (source, _) in diagram.connection_map().items()}
    assert sorted(arrows) == sorted(pairs)
    assert "massprop_drake" not in dot


def test_a_frame_is_widened_for_wires_of_its_own_diagram_alone() -> None:
    dot = "digraph _0 {\nsubgraph cluster0diagram {\na [x];\nsubgraph cluster1diagram {\nb [x];\nc [x];\n}\n}\n}\n"
    frame = '<g class="cluster">\n<title>{}</title>\n<polygon points="0,0 0,-50 50,-50 50,0 0,0"/>'
    wire = '<g class="edge">\n<title>{}:e&#45;&gt;{}:w</title>\n<path d="M10,-10C20,{} 30,-10 40,-10"/>'
    sheet = '<g class="graph">\n<title>_0</title>\n<polygon points="-90,90 -90,-90 90,-90 90,90"/>'
    frames = frame.format("cluster0diagram") + frame.format("cluster1diagram")
    svg = sheet + frames + wire.format("b", "c", 20) + wire.format("a", "b", -99)
    outer, inner = re.findall(
        r'"cluster">\s*<title>\w+</title>\s*<polygon points="([^"]+)"', graphs.widen_frames(svg, dot)
    )
    assert inner == "0,24 0,-50 50,-50 50,24 0,24"
    assert outer == "0,24 0,-86 50,-86 50,24 0,24"  # at most to the margin of the sheet
