"""The page of commands has each of them, with options that there are, and those that are quick run as they stand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from conftest import REPOSITORY, Massprop

PAGE = (REPOSITORY / "docs" / "commands.md").read_text(encoding="utf-8")
LINES = [
    shlex.split(line, comments=True)[1:]
    for block in re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    for line in block.splitlines()
]
QUICK = ("list", "check", "map")


def named(text: str) -> set[str]:
    """The commands that a help lists."""
    return set(re.findall(r"^│ ([a-z]+) {2,}\S", text.partition("Commands")[2], flags=re.MULTILINE))


def test_every_command_has_its_line(massprop: Massprop) -> None:
    assert named(massprop("--help").out) == {line[0] for line in LINES}
    assert named(massprop("campaign", "--help").out) == {line[1] for line in LINES if line[0] == "campaign"}
    for line in LINES:
        known = massprop(*line[: 2 if line[0] == "campaign" else 1], "--help").out
        assert [option for option in line if option.startswith("--") and not re.search(rf"{option}\b", known)] == []


@pytest.mark.parametrize("line", [line for line in LINES if line[0] in QUICK], ids=" ".join)
def test_what_is_quick_runs(massprop: Massprop, line: list[str]) -> None:
    Path("docs").symlink_to(REPOSITORY / "docs")
    done = massprop(*line)
    assert done.status == 0
    assert done.out


def test_graphs_are_drawn_for_a_scenario(massprop: Massprop) -> None:
    assert massprop("graph", "estimation", "--like", "leak_named", "-q").status == 0
    assert ">estimator<" in Path("runs/graphs/estimation_overview.dot").read_text(encoding="utf-8")
