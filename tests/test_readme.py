"""Commands, code, outputs and links of README.md work as shown, and it stays short."""

from __future__ import annotations

import re
import tomllib

import pytest
from conftest import REPOSITORY, Massprop
from page_probe import blocks, commands, unshown

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
MOST_WORDS = 1200
CARD = re.compile(r"<!-- card:headlines -->\n.+\n<!-- /card:headlines -->", flags=re.DOTALL)


@pytest.mark.documentation
def test_every_command_runs_and_prints_what_is_shown(massprop: Massprop) -> None:
    ours = [words[1:] for words in commands(README) if words[0] == "massprop"]
    others = [words for words in commands(README) if words[0] != "massprop"]
    assert [words[0] for words in ours] == ["run", "view", "estimate", "list", "design"]
    printed = []
    for words in ours:
        # the plain loop gives the diagram's bits in half of the time
        done = massprop(*words, *(["--set", "execution.engine=loop"] if words[0] == "run" else []))
        assert done.status == 0, done.err
        printed.append(done.out)
    (shown,) = blocks(README, "text")
    assert unshown(shown, printed[0]) == []
    assert [line for line in printed[2].splitlines() if line.startswith("detected:")] == shown.splitlines()[1:]
    assert printed[4].startswith("5.2 s with 2.1 s of firings, 0.00107 kg")  # 1.1 g in 5 s
    assert others == [["pip", "install", "."]]  # `make release` installs it


@pytest.mark.documentation
def test_python_runs_and_prints_what_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks(README, "python")
    assert len([line for line in code.splitlines() if line]) <= 12
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    said = re.search(r"^This prints (.*)\.$", README, flags=re.MULTILINE)
    assert said is not None
    assert unshown("\n".join(re.findall("`([^`]+)`", said[1])), capsys.readouterr().out) == []


def test_it_is_short_and_figures_of_campaigns_stand_in_the_block_of_the_card() -> None:
    assert len(README.split()) <= MOST_WORDS
    assert CARD.search(README)
    assert re.findall(r"\d+ of \d+|\d+(?:\.\d+)? sigma|95 %", CARD.sub("", README)) == []


def test_what_is_named_is_there() -> None:
    targets = set(re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert set(re.findall(r"`make ([a-z]+)", README)) <= targets
    python = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]["requires-python"]
    assert f"Python {python.removeprefix('>=')} or newer" in README


def test_links_lead_somewhere() -> None:
    """Beside the file, as a host of repositories and a package index's source link show it; anchors are headings."""
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("https://")]
    assert "LICENSE" in links
    missing = []
    for link in links:
        path, _, anchor = link.partition("#")
        target = REPOSITORY / path
        headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE) if anchor else []
        anchors = {"", *(heading.lower().replace(" ", "-") for heading in headings)}
        if not target.exists() or anchor not in anchors:
            missing.append(link)
    assert missing == []
