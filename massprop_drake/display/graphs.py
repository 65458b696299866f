"""Graphs of the diagrams, as DOT and SVG."""

from __future__ import annotations

import html
import importlib
import itertools
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPortIndex, OutputPortIndex, System

from massprop_drake.errors import InputError
from massprop_drake.inputs.scenario import Scenario, load_scenario


class GalleryDiagram(NamedTuple):
    """Diagram of the gallery that `massprop graph` draws.

    Attributes:
        module: that builds it.
        scenario: bundled, for which it is drawn.
        description: in words, where the module's documentation does not say it.
    """

    module: str
    scenario: str
    description: str = ""


DIAGRAMS = {
    "vehicle": GalleryDiagram("vehicle", "sample_maneuver"),
    "vehicle_tracked": GalleryDiagram("vehicle", "air_bearing_pulses", "The vehicle with sensors in a fixed frame."),
    "autopilot": GalleryDiagram("autopilot", "sample_maneuver"),
    "estimation": GalleryDiagram("estimation", "sample_maneuver"),
    "estimation_joint": GalleryDiagram(
        "estimation", "leak_named", "The estimators, with the joint filter and its detector."
    ),
    "estimation_pose": GalleryDiagram(
        "estimation", "air_bearing_pulses", "The estimators, with the filter in a fixed frame and its detector."
    ),
    "closed_loop": GalleryDiagram("closed_loop", "sample_maneuver"),
    "open_loop": GalleryDiagram("open_loop", "jet_pulses"),
    "replay": GalleryDiagram("replay", "sample_maneuver"),
}


def build(name: str, scenario: Scenario | None = None) -> Diagram:
    """Builds a Drake diagram of the gallery, by its name, for a scenario; None: the bundled one."""
    entry = DIAGRAMS[name]
    module = importlib.import_module(f"massprop_drake.diagrams.{entry.module}")
    diagram: Diagram = module.build(scenario or load_scenario(entry.scenario))
    return diagram


def as_diagram(result: Any, source: str) -> Diagram:
    """Converts the result of a user's function, a diagram, a builder, or one system, to a Drake diagram.

    Args:
        result: of the function.
        source: its name, for messages.

    Raises:
        InputError: when it is anything else.
        RuntimeError: when the builder cannot build.
    """
    if isinstance(result, Diagram):
        return result
    if isinstance(result, DiagramBuilder):
        return result.Build()
    if not isinstance(result, System):
        raise InputError(
            f"{source}: returned {type(result).__name__}; it must return a Diagram, a DiagramBuilder or a System"
        )
    builder = DiagramBuilder()
    builder.AddSystem(result)
    for index in range(result.num_input_ports()):
        builder.ExportInput(result.get_input_port(InputPortIndex(index)), result.get_input_port(index).get_name())
    for index in range(result.num_output_ports()):
        builder.ExportOutput(result.get_output_port(OutputPortIndex(index)), result.get_output_port(index).get_name())
    return builder.Build()


def diagram_names(scenario: Scenario | None) -> list[str]:
    """Returns names of the Drake diagrams that a scenario uses, those that fly it last; None: the whole gallery."""
    if scenario is None:
        return list(DIAGRAMS)
    flown = ["open_loop"] if scenario.open_loop else ["autopilot", "closed_loop"]
    return ["vehicle", "estimation", "replay", *flown]


def describe(name: str) -> str:
    """Returns one line of description of a Drake diagram of the gallery, by its name."""
    entry = DIAGRAMS[name]
    module = importlib.import_module(f"massprop_drake.diagrams.{entry.module}")
    return entry.description or (module.__doc__ or "").strip().splitlines()[0]


# letters of 0.6 of their size in width, in whichever font of its kind a viewer has: Graphviz makes boxes by that width
_FONT = "".join(f'{what} [fontname="Courier"]; ' for what in ("graph", "node", "edge")).rstrip()


def dot_text(diagram: Diagram, depth: int) -> str:
    """Returns a Drake diagram in Graphviz's DOT, with numbers that do not depend on other diagrams built.

    Args:
        diagram: the one to draw.
        depth: how many levels of nested diagrams to open; 0 shows a single box.
    """
    text: str = diagram.GetGraphvizString(max_depth=depth, options={"name/split": "I/O"})
    # Drake numbers systems as they are made in a process: number them as they appear instead
    numbers: dict[str, int] = {}

    def renumber(match: re.Match[str]) -> str:
        """Replaces the number of a matched system by its order of appearance."""
        return f"{match.group(1)}{numbers.setdefault(match.group(2), len(numbers))}"

    text = re.sub(r"(?<=<B>)[\w.]+\.(?=\w+</B>)", "", text)  # of a class its name, not where it is from
    text = text.replace("rankdir=LR\n", f"rankdir=LR\n{_FONT}\n", 1)
    text = re.sub(r"\b(_|s|cluster|clusters)(\d+)(?=(?:diagram|subsystems|in|out)?\b)", renumber, text)
    # and Drake lists the connections of a diagram in no fixed order
    lines: list[str] = []
    for connections, group in itertools.groupby(text.splitlines(), key=lambda line: " -> " in line):
        block = list(group)
        lines.extend(sorted(_label_arrows(block, text)) if connections else block)
    return "\n".join(lines) + "\n"


_SAY_NOTHING = ("reading", "y0")  # names of outputs, where that of the input says more
_SIGNALS = 4  # on one arrow of an overview, in a line each


def overview_text(diagram: Diagram) -> str:
    """Returns the overview of a Drake diagram in DOT: its subsystems, and one arrow between any connected two.

    The arrow has the names of the signals that it carries; exported ports are left out.
    """
    systems = diagram.GetSystems()
    names = {id(system): system.get_name() for system in systems}
    carried: dict[tuple[str, str], list[str]] = {}
    for (to, to_port), (source, port) in diagram.connection_map().items():
        ends = names[id(source)], names[id(to)]
        name = source.get_output_port(port).get_name()
        input_name = to.get_input_port(to_port).get_name()
        carried.setdefault(ends, []).append(input_name if name in _SAY_NOTHING else name)
    lines = [
        f"digraph {_quote(diagram.get_name())} {{",
        f"rankdir=LR; nodesep=0.35; ranksep=0.5; {_FONT}",
        'node [shape=box, style="rounded,filled", fillcolor="#eef2f7", color="#5a6675", fontsize=14]; '
        'edge [fontsize=12, color="#33475b", fontcolor="#33475b"];',
    ]
    for system in systems:
        kind = type(system).__name__
        kind_label = "" if kind == "Diagram" else f'<BR/><FONT POINT-SIZE="12">{kind}</FONT>'
        name = system.get_name()
        lines.append(f"{_quote(name)} [label=<<B>{html.escape(name)}</B>{kind_label}>];")
    for (source, to), signals in sorted(carried.items()):
        shown = sorted(set(signals))
        more = len(shown) - _SIGNALS
        labels = shown if more <= 0 else [*shown[: _SIGNALS - 1], f"and {more + 1} more"]
        lines.append(f"{_quote(source)} -> {_quote(to)} [label={_quote(_BREAK.join(labels))}];")
    return "\n".join([*lines, "}"]) + "\n"


def _quote(text: str) -> str:
    """Quotes text for Graphviz as a name or a label."""
    return '"' + text.replace('"', r"\"") + '"'


_BREAK = r"\n"  # as Graphviz writes the end of a line

_NODE = re.compile(r"^(\w+) \[shape=none,[^\n]*label=<\n(.*?)^>\];", re.DOTALL | re.MULTILINE)
_PORT = re.compile(r'PORT="([uy]?\d+)"[^>]*>([^<]*)</TD>')


def _label_arrows(connections: list[str], text: str) -> list[str]:
    """Returns the DOT lines of arrows between systems, labeled with the name of the output port that each leaves."""
    ports = {(node, port): name for node, inside in _NODE.findall(text) for port, name in _PORT.findall(inside)}
    labeled = []
    for line in connections:
        node, port = line.strip().split(" -> ")[0].split(":")[:2]
        name = ports.get((node, port))
        colored = "[" in line  # an exported port, which has its name already
        labeled.append(line if colored or not name else f'{line} [label="{name}", fontsize=9, fontcolor=gray35]')
    return labeled


def svg_text(dot: str) -> str | None:
    """Converts DOT to SVG text with `graphviz-pure` (pip) or `dot` (Graphviz); None if neither is installed."""
    beside = Path(sys.executable).parent / "graphviz-pure"
    program = str(beside) if beside.exists() else shutil.which("graphviz-pure") or shutil.which("dot")
    if program is None:
        return None
    done = subprocess.run([program, "-Tsvg"], input=dot, capture_output=True, text=True, check=True)
    return widen_frames(done.stdout, dot)


_MARGIN = 4.0  # points between a wire and the frame around it
_OPENED = re.compile(r"subgraph (\w+) \{|^(\w+) \[|^(\})$", re.MULTILINE)
_WIRE = re.compile(r'class="edge">\s*<title>(\w+)\S*?&gt;(\w+)[^<]*</title>\s*<path[^>]* d="([^"]+)"')
_FRAME = re.compile(r'(class="cluster">\s*<title>(cluster\d+diagram)</title>\s*<polygon[^>]*points=")([^"]+)')
_SHEET = re.compile(r'class="graph"[^>]*>\s*<title>[^<]*</title>\s*<polygon[^>]*points="([^"]+)')


def widen_frames(svg: str, dot: str) -> str:
    """Returns the SVG text with each diagram's frame widened to hold its wires, as far as the sheet goes.

    Graphviz makes frames around systems, and leads wires around these.

    Args:
        svg: the graph as drawn.
        dot: the same in Graphviz's language.
    """
    frames_around = _diagrams_around(dot)
    sheet = _SHEET.search(svg)
    if sheet is None:
        return svg
    wires: dict[str, list[tuple[float, float]]] = {}
    for source, to, path in _WIRE.findall(svg):
        for diagram in set(frames_around.get(source, ())) & set(frames_around.get(to, ())):
            wires.setdefault(diagram, []).extend(_parse_points(path))
    limits = _box(_parse_points(sheet[1]), -_MARGIN)

    def widen(match: re.Match[str]) -> str:
        """Returns the SVG of a matched frame with its corners moved outward to hold its wires."""
        frame = _box(_parse_points(match[3]), 0.0)
        wire_box = _box(wires[match[2]], _MARGIN) if match[2] in wires else frame
        left, low = (max(min(frame[k], wire_box[k]), limits[k]) for k in (0, 1))
        right, high = (min(max(frame[k], wire_box[k]), limits[k]) for k in (2, 3))
        return f"{match[1]}{left:g},{high:g} {left:g},{low:g} {right:g},{low:g} {right:g},{high:g} {left:g},{high:g}"

    return _FRAME.sub(widen, svg)


def _diagrams_around(dot: str) -> dict[str, list[str]]:
    """Maps each node of a DOT graph to the names of the diagram frames that enclose it, outermost first."""
    found: dict[str, list[str]] = {}
    within: list[str] = []
    for group, node, closed in _OPENED.findall(dot):
        if group:
            within.append(group)
        elif node:
            found[node] = [name for name in within if name.endswith("diagram")]
        elif closed and within:
            within.pop()
    return found


def _parse_points(text: str) -> list[tuple[float, float]]:
    """Parses the points of an SVG polygon or path."""
    return [(float(x), float(y)) for x, y in re.findall(r"(-?[\d.]+)[ ,](-?[\d.]+)", text)]


def _box(points: list[tuple[float, float]], margin: float) -> tuple[float, float, float, float]:
    """Returns the bounding box of points with a margin: least x and y, greatest x and y."""
    x, y = zip(*points, strict=True)
    return min(x) - margin, min(y) - margin, max(x) + margin, max(y) + margin
