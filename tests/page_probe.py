"""Code, commands and outputs that a page of the documentation shows."""

from __future__ import annotations

import re
import shlex

import pytest

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])")
_CLOSE = 0.1  # relative: a reader sees the same; the numbers themselves are for other tests


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a language, in their order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)


def commands(page: str) -> list[list[str]]:
    """Words of each line of the page's shell blocks, without its comment."""
    return [words for block in blocks(page, "sh") for line in block.splitlines() if (words := shlex.split(line, True))]


def unshown(shown: str, printed: str) -> list[str]:
    """Lines of a block that no printed line begins like: the same words, and numbers within a tenth."""
    lines = [(_NUMBER.sub("#", line), _NUMBER.findall(line)) for line in printed.splitlines()]
    return [line for line in shown.splitlines() if not any(_alike(line, words, values) for words, values in lines)]


def _alike(line: str, words: str, values: list[str]) -> bool:
    wanted = [float(value) for value in _NUMBER.findall(line)]
    if not words.startswith(_NUMBER.sub("#", line)) or len(values) < len(wanted):
        return False
    found = [float(value) for value in values[: len(wanted)]]
    return found == pytest.approx(wanted, rel=_CLOSE)
