"""Campaigns compared in pairs of cases with the same draws."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from campaign_rows import SWEPT, declaration, failure, folder, many, row

from massprop_drake.errors import InputError
from massprop_drake.studies.campaign import compare
from massprop_drake.studies.campaign.reading import read

ONE = """
name: one
base: stuck_on_29
cases: 12
seed: 3
draw: {plant.thrust_dispersion: {uniform: {low: 0.0, high: 0.02}}}
"""


def rows_of(found: set[int], delay_s: float = 1.0, duration_s: float = 60.0) -> list[Any]:
    """Cases with a failure each, some of which are found, and a false declaration where it is not."""
    return [
        row(case, [failure("R4R", "named" if case in found else "missed", declared_s=20.0 + delay_s)],
            [declaration("R4R", 20.0 + delay_s) if case in found else declaration("F1U", 50.0, "failure")],
            duration_s=duration_s)
        for case in range(12)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A campaign, and the same draws with another detector that finds eight more and loses one."""
    path = tmp_path_factory.mktemp("two")
    other = ONE + "set: {detector: {kind: cusum}}\n"
    return [
        folder(path / "glr", ONE, rows_of({0, 1, 2})),
        folder(path / "cusum", other, rows_of(set(range(1, 11)), 3.0, 120.0)),
    ]


def test_pairs_tell_what_changed_and_how_surely(two: list[Path]) -> None:
    first, second = compare.summary(two)["columns"]
    assert (first["label"], second["label"]) == ("glr", "cusum")
    assert first["differences"] == []
    found = {one["what"]: one for one in second["differences"]}
    isolated = found["Failures found: the jet, or its cluster"]
    assert (isolated["larger"], isolated["smaller"]) == (8, 1)
    assert isolated["difference"]["value"] == pytest.approx(7 / 12)
    assert isolated["p"] == pytest.approx(2 * (1 + 9) / 2**9)
    assert found["Delay of what both found, median"]["difference"]["value"] == pytest.approx(2.0)
    assert found["Delay of what both found, median"]["difference"]["n"] == 2
    false = found["False declarations"]
    assert (false["baseline"], false["here"]) == pytest.approx((9 / 0.2, 2 / 0.4))
    assert false["difference"]["value"] == pytest.approx(-7 / 0.2)
    json.dumps(compare.summary(two), allow_nan=False)


def test_cells_of_two_campaigns_are_compared_setting_by_setting(tmp_path: Path) -> None:
    rows = many(2, 6)
    studies = [read(folder(tmp_path / name, SWEPT.format(cases=6), rows)) for name in "ab"]
    found = compare.columns(studies)
    assert [column.baseline for column in found] == [1, 1, 0, 1]
    assert found[2].label == "b: margin 4"
    assert all(
        measure.paired.difference.value == 0.0 for measure in compare.measures(compare.pair_cases(found[0], found[2]))
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("seed: 3", "seed: 4"), r"other: is drawn by random with seed 4, .*glr by random with seed 3, .*same"),
        (("high: 0.02", "high: 0.03"), r"other: sample 0: plant.thrust_dispersion is 0\.\d+, in .*glr 0\.\d+, so that"),
        (
            ("plant.thrust_dispersion", "detector.threshold"),
            r"draws other quantities than .*detector.threshold only in .*other; plant.thrust_dispersion only in .*glr",
        ),
        (("cases: 12", "cases: 12\nmethod: lhs"), "drawn by lhs"),
    ],
)
def test_other_draws_are_refused(two: list[Path], tmp_path: Path, change: tuple[str, str], message: str) -> None:
    other = folder(tmp_path / "other", ONE.replace(*change), rows_of({0}))
    with pytest.raises(InputError, match=message) as problem:
        compare.page([two[0], other])
    assert "cannot be compared in pairs" in str(problem.value)


def test_it_opens_from_disk(opened: Any, two: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "compare.html"
    path.write_text(compare.page(two), encoding="utf-8")
    page = opened(path)
    assert page.said == []
    assert page.page.locator("section.plot:has(.main-svg)").count() == 2
    assert page.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
