"""The pictures of the diagrams that lie in the repository."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

from massprop_drake.display.graphs import DIAGRAMS, build, overview_text, widen_frames

GALLERY = REPOSITORY / "diagrams" / "graphs"


def test_the_gallery_shows_the_diagrams_as_they_are(tmp_path: Path) -> None:
    """When this fails: massprop graph --out diagrams/graphs."""
    # in a process of its own: Drake counts the systems that it has made
    command = [sys.executable, "-m", "massprop_drake", "graph", "--out", str(tmp_path), "--quiet"]
    subprocess.run(command, check=True, cwd=tmp_path)
    names = {path.name for path in GALLERY.glob("*.dot")}
    assert names == {path.name for path in tmp_path.glob("*.dot")}
    for name in sorted(names):
        assert (GALLERY / name).read_text("utf-8") == (tmp_path / name).read_text("utf-8"), name
    assert {path.stem for path in GALLERY.glob("*.svg")} >= {*DIAGRAMS, *(f"{name}_overview" for name in DIAGRAMS)}
    assert ">held_command<" in (GALLERY / "closed_loop.svg").read_text("utf-8")


OUTSIDE = """() => [...document.querySelectorAll("g.node")].flatMap(node => {
  const boxes = [...node.querySelectorAll("polygon, path")].map(shape => shape.getBBox());
  return [...node.querySelectorAll("text")].filter(text => {
    const own = text.getBBox(), x = own.x + own.width / 2, y = own.y + own.height / 2;
    const around = boxes.filter(box => box.x < x && x < box.x + box.width && box.y < y && y < box.y + box.height);
    return !around.length || around.some(box => box.x > own.x || own.x + own.width > box.x + box.width);
  }).map(text => text.textContent);
})"""  # texts of nodes that are wider than a box that they stand in


@pytest.mark.parametrize("name", ["closed_loop", "closed_loop_overview"])
def test_text_is_inside_its_boxes_in_a_browser(opened: Any, name: str) -> None:
    picture = opened(GALLERY / f"{name}.svg", ready="svg").page
    assert picture.locator("g.node text").count() > 1
    assert picture.evaluate(OUTSIDE) == []


A4 = 780.0, 540.0  # points within the margins, on its side


@pytest.mark.parametrize("name", DIAGRAMS)
def test_an_overview_fits_a_sheet_with_every_part_and_one_arrow_for_each_pair(name: str) -> None:
    picture = (GALLERY / f"{name}_overview.svg").read_text("utf-8")
    width, height = map(float, re.findall(r'<svg width="([\d.]+)pt" height="([\d.]+)pt"', picture)[0])
    scale = min(1.0, A4[0] / width, A4[1] / height)
    assert min(float(size) for size in re.findall(r'font-size="([\d.]+)"', picture)) * scale >= 7.0
    diagram = build(name)
    dot = overview_text(diagram)
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
    outer, inner = re.findall(r'"cluster">\s*<title>\w+</title>\s*<polygon points="([^"]+)"', widen_frames(svg, dot))
    assert inner == "0,24 0,-50 50,-50 50,24 0,24"
    assert outer == "0,24 0,-86 50,-86 50,24 0,24"  # at most to the margin of the sheet
