"""Graphs of the diagrams, as DOT and SVG."""

from __future__ import annotations

import importlib
import itertools
import re
import shutil
import subprocess
import sys
from pathlib import Path

from pydrake.systems.framework import Diagram

from massprop_drake.inputs.scenario import load_scenario

# the diagrams by name, and the bundled scenario that each is drawn for
DIAGRAMS = {
    "vehicle": "sample_maneuver",
    "autopilot": "sample_maneuver",
    "estimation": "sample_maneuver",
    "closed_loop": "sample_maneuver",
    "open_loop": "jet_pulses",
    "replay": "sample_maneuver",
}


def build(name: str) -> Diagram:
    """Builds a bundled diagram, given its name."""
    module = importlib.import_module(f"massprop_drake.diagrams.{name}")
    diagram: Diagram = module.build(load_scenario(DIAGRAMS[name]))
    return diagram


def describe(name: str) -> str:
    """Returns the first line of a diagram's documentation."""
    module = importlib.import_module(f"massprop_drake.diagrams.{name}")
    return (module.__doc__ or "").strip().splitlines()[0]


def dot_text(diagram: Diagram, depth: int) -> str:
    """Returns a diagram in Graphviz's language, independent of what else the process has built.

    Args:
        diagram: the one to draw.
        depth: how many levels of nested diagrams to open; 0 shows a single box.
    """
    text: str = diagram.GetGraphvizString(max_depth=depth, options={"name/split": "I/O"})
    # Drake numbers systems as they are made in a process: number them as they appear instead
    numbers: dict[str, int] = {}

    def renumbered(match: re.Match[str]) -> str:
        return f"{match.group(1)}{numbers.setdefault(match.group(2), len(numbers))}"

    text = re.sub(r"(?<=<B>)[\w.]+\.(?=\w+</B>)", "", text)  # of a class its name, not where it is from
    text = re.sub(r"\b(_|s|cluster|clusters)(\d+)(?=(?:diagram|subsystems|in|out)?\b)", renumbered, text)
    # and Drake lists the connections of a diagram in no fixed order
    lines: list[str] = []
    for connections, group in itertools.groupby(text.splitlines(), key=lambda line: " -> " in line):
        block = list(group)
        lines.extend(sorted(_labeled(block, text)) if connections else block)
    return "\n".join(lines) + "\n"


_NODE = re.compile(r"^(\w+) \[shape=none,[^\n]*label=<\n(.*?)^>\];", re.DOTALL | re.MULTILINE)
_PORT = re.compile(r'PORT="([uy]?\d+)"[^>]*>([^<]*)</TD>')


def _labeled(connections: list[str], text: str) -> list[str]:
    """Labels arrows between systems with the signal they carry, which has the name of the port it leaves."""
    ports = {(node, port): name for node, inside in _NODE.findall(text) for port, name in _PORT.findall(inside)}
    labeled = []
    for line in connections:
        node, port = line.strip().split(" -> ")[0].split(":")[:2]
        name = ports.get((node, port))
        colored = "[" in line  # an exported port, which has its name already
        labeled.append(line if colored or not name else f'{line} [label="{name}", fontsize=9, fontcolor=gray35]')
    return labeled


def svg_text(dot: str) -> str | None:
    """Draws a graph as SVG with `graphviz-pure` (pip) or `dot` (Graphviz); None if neither is installed."""
    beside = Path(sys.executable).parent / "graphviz-pure"
    program = str(beside) if beside.exists() else shutil.which("graphviz-pure") or shutil.which("dot")
    if program is None:
        return None
    done = subprocess.run([program, "-Tsvg"], input=dot, capture_output=True, text=True, check=True)
    return done.stdout
