"""The lint of words counts fragments and names that stand twice, and fails when any of them grows."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY

LINT = REPOSITORY / ".ci" / "words.py"
CLEAN = {
    "massprop_drake/one.py": '"""A module."""\nclass First:\n    """One.\n\n    What follows is none.\n    """\n',
    "massprop_drake/two.py": '"""A module."""\ndef add() -> None:\n    """Adds two numbers."""\n',
}
ALLOWED = {"fragments": 0.0, "classes": 0, "modules": 0}


def lint(root: Path, *options: str, files: dict[str, str], allowed: dict[str, float] = ALLOWED) -> tuple[int, str]:
    """Exit status and output for a repository of some files."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    kept = root / "words.json"
    kept.write_text(json.dumps(allowed), encoding="utf-8")
    command = [sys.executable, LINT, root, "--allowed", kept, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_clean_words_pass_without_a_word(tmp_path: Path) -> None:
    assert lint(tmp_path, files=CLEAN) == (0, "")


@pytest.mark.parametrize(
    ("name", "text", "grown"),
    [
        ("massprop_drake/three.py", 'def left() -> None:\n    """What is left of it."""\n', "fragments"),
        ("benchmarks/three.py", '"""Of a package."""\n', "fragments"),
        ("diagrams/three.py", 'async def left() -> None:\n    """\n    Those that follow.\n    """\n', "fragments"),
        ("massprop_drake/room/three.py", 'class First:\n    """Another class of this name."""\n', "classes"),
        ("diagrams/three.py", "def make() -> type:\n    class First:\n        pass\n    return First\n", "classes"),
        ("massprop_drake/room/two.py", '"""A module of the same name."""\n', "modules"),
    ],
)
def test_each_count_fails_when_it_grows(tmp_path: Path, name: str, text: str, grown: str) -> None:
    status, said = lint(tmp_path, files={**CLEAN, name: text})
    assert status == 1
    assert f"words: {grown} has grown from 0" in said
    assert said.count("has grown") == 1
    _, listed = lint(tmp_path, "--list", grown, files={})
    assert name in listed


@pytest.mark.parametrize("name", ["massprop_drake/room/__init__.py", "tests/two.py", "benchmarks/two.py"])
def test_names_outside_of_the_package_do_not_count(tmp_path: Path, name: str) -> None:
    status, said = lint(tmp_path, files={**CLEAN, "massprop_drake/__init__.py": "", name: "class First:\n    pass\n"})
    assert (status == 1, "classes" in said) == (name.startswith("massprop_drake"),) * 2
    assert "modules" not in said


def test_what_is_allowed_is_lowered_on_demand_and_never_raised(tmp_path: Path) -> None:
    allowed = {"fragments": 3.5, "classes": 2, "modules": 0}
    status, said = lint(tmp_path, files=CLEAN, allowed=allowed)
    assert status == 0
    assert "fragments 0.0 (allowed 3.5), classes 0 (allowed 2)" in said
    assert lint(tmp_path, "--write", files={}, allowed=allowed) == (0, "")
    kept = tmp_path / "words.json"
    assert json.loads(kept.read_text(encoding="utf-8")) == ALLOWED
    twice = {"diagrams/one.py": '"""A module of the same name."""\n'}
    assert lint(tmp_path, "--write", files=twice, allowed=allowed)[0] == 1
    assert json.loads(kept.read_text(encoding="utf-8")) == ALLOWED


def test_the_repository_is_within_what_it_allows() -> None:
    done = subprocess.run([sys.executable, LINT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
