"""The list of edits that `make mutants` makes: each can be made, and its tests are there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from mutants import REPOSITORY, Mutant, load, made
from random_edits import draw, edits_of

MUTANTS = load()
# what is to be held: each of these files, or a file below them, is edited at least once
HELD = (
    *(f"massprop_drake/maths/estimation/filters/{name}.py" for name in ("rotation_filter", "mass_filter", "thesis")),
    *(f"massprop_drake/maths/estimation/detectors/{name}.py" for name in ("cglr", "cusum", "jet_tests")),
    *(f"massprop_drake/runners/{name}.py" for name in ("simulate", "recorded", "estimator")),
    *(f"massprop_drake/records/{name}.py" for name in ("reader", "quality")),
    *(f"massprop_drake/vehicles/{name}.yaml" for name in ("orbiter", "lander", "free_flyer", "small_satellite")),
)


def test_there_are_enough_and_they_are_spread() -> None:
    assert len(MUTANTS) >= 60
    assert len({(mutant.file, mutant.old, mutant.new) for mutant in MUTANTS}) == len(MUTANTS)
    assert {mutant.file for mutant in MUTANTS} >= set(HELD)


def test_every_edit_applies_exactly_once() -> None:
    assert [mutant for mutant in MUTANTS if (REPOSITORY / mutant.file).read_text("utf-8").count(mutant.old) != 1] == []
    assert [mutant for mutant in MUTANTS if mutant.old == mutant.new] == []


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.file.rpartition("/")[2])
def test_its_tests_are_there(mutant: Mutant) -> None:
    assert mutant.tests
    for test in mutant.tests:
        file, _, name = test.partition("::")
        path = REPOSITORY / file
        assert path.exists(), test
        assert not name or re.search(rf"^def {name}\(", path.read_text("utf-8"), re.MULTILINE), test


def test_an_edit_is_made_and_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text("x = 1\ny = 2\n", encoding="utf-8")
    with made(Mutant("a.py", "x = 1", "x = 3", []), tmp_path) as applies:
        assert applies
        assert path.read_text("utf-8") == "x = 3\ny = 2\n"
    assert path.read_text("utf-8") == "x = 1\ny = 2\n"
    for old in ("z", " = "):
        with made(Mutant("a.py", old, "", []), tmp_path) as applies:
            assert not applies
    with made(Mutant("gone.py", "x", "", []), tmp_path) as applies:
        assert not applies


def test_random_edits_are_single_and_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    source = 'def f(x: int = 0) -> int:\n    """Two."""\n    return 2 * x if not x < -1 else 1.5\n'
    path.write_text(source, encoding="utf-8")
    edits = list(edits_of(path))
    pieces = {(source[edit.start : edit.end], edit.new) for edit in edits}
    assert pieces == {
        ("0", "1"),
        ("not x < -1", "(not (not x < -1))"),
        ("*", "/"),
        ("2", "3"),
        ("not x < -1", "x < -1"),
        ("<", ">="),
        ("-1", "1"),
        ("1", "2"),
        ("1.5", "2.25"),
    }
    for edit in edits:
        assert ast.dump(ast.parse(edit.text)) != ast.dump(ast.parse(source))
    assert draw([path], 4, seed=1) == draw([path], 4, seed=1) != draw([path], 4, seed=2)
