"""The lint of words counts fragments and names that stand twice, and fails when any of them grows."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import REPOSITORY
from script_probe import script

CLEAN = {
    "massprop_drake/one.py": '"""A module."""\nclass First:\n    """One.\n\n    What follows is none.\n    """\n',
    "massprop_drake/two.py": '"""A module."""\ndef add() -> None:\n    """Adds two numbers."""\n',
}
ALLOWED = {"fragments": 0.0, "classes": 0, "modules": 0}

Lint = Callable[..., tuple[int, str]]


@pytest.fixture
def lint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Lint:
    """Exit status and output for a repository of some files, besides those that are there already."""
    program = script(REPOSITORY / ".ci" / "words.py")

    def run(*options: str, files: dict[str, str], allowed: dict[str, float] = ALLOWED) -> tuple[int, str]:
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text, encoding="utf-8")
        kept = tmp_path / "words.json"
        kept.write_text(json.dumps(allowed), encoding="utf-8")
        monkeypatch.setattr(sys, "argv", ["words.py", str(tmp_path), "--allowed", str(kept), *options])
        return program.main(), "".join(capsys.readouterr())

    return run


@pytest.mark.parametrize(
    ("name", "text", "grown"),
    [
        ("massprop_drake/three.py", 'def left() -> None:\n    """What is left of it."""\n', "fragments"),
        ("benchmarks/three.py", '"""Of a package."""\n', "fragments"),
        ("diagrams/three.py", 'async def left() -> None:\n    """\n    Those that follow.\n    """\n', "fragments"),
        ("massprop_drake/room/three.py", 'class First:\n    """Another class of this name."""\n', "classes"),
        ("diagrams/three.py", "def make() -> type:\n    class First:\n        pass\n    return First\n", "classes"),
        ("massprop_drake/room/two.py", '"""A module of the same name."""\n', "modules"),
        # names outside of the package do not count, nor do those of `__init__`
        ("massprop_drake/room/__init__.py", "class First:\n    pass\n", "classes"),
        ("tests/two.py", "class First:\n    pass\n", None),
        ("benchmarks/two.py", "class First:\n    pass\n", None),
    ],
)
def test_each_count_fails_when_it_grows(lint: Lint, name: str, text: str, grown: str | None) -> None:
    assert lint(files={**CLEAN, "massprop_drake/__init__.py": ""}) == (0, "")
    status, said = lint(files={name: text})
    assert (status, said.count("has grown")) == (int(grown is not None),) * 2
    if grown:
        assert f"words: {grown} has grown from 0" in said
        assert name in lint("--list", grown, files={})[1]


def test_what_is_allowed_is_lowered_on_demand_and_never_raised(lint: Lint, tmp_path: Path) -> None:
    allowed = {"fragments": 3.5, "classes": 2, "modules": 0}
    status, said = lint(files=CLEAN, allowed=allowed)
    assert status == 0
    assert "fragments 0.0 (allowed 3.5), classes 0 (allowed 2)" in said
    assert lint("--write", files={}, allowed=allowed) == (0, "")
    kept = tmp_path / "words.json"
    assert json.loads(kept.read_text(encoding="utf-8")) == ALLOWED
    twice = {"diagrams/one.py": '"""A module of the same name."""\n'}
    assert lint("--write", files=twice, allowed=allowed)[0] == 1
    assert json.loads(kept.read_text(encoding="utf-8")) == ALLOWED
