"""From MultibodyPlant to a named thruster: the tutorial's script is short."""

from __future__ import annotations

import ast

from conftest import REPOSITORY


def test_it_has_thirty_lines_at_most() -> None:
    text = (REPOSITORY / "docs" / "tutorials" / "named_thruster.py").read_text(encoding="utf-8")
    docstring, *code = ast.parse(text).body
    lines = [line for line in text.splitlines()[docstring.end_lineno :] if line and not line.startswith("#")]
    assert len(lines) <= 30
    assert all(len(line) <= 98 and ";" not in line for line in lines)
    assert len({statement.lineno for statement in code}) == len(code)
