"""The plan of a campaign: draws and seeds depend on the campaign's seed and the sample's number alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import InputError
from massprop_drake.inputs.campaign_file import CampaignSpec, load_campaign
from massprop_drake.studies.campaign.plan import plan_cases, sample_coordinates

DRAWN = """\
name: drawn
base: sample_maneuver
seed: 7
draw:
  plant.thrust_dispersion: {uniform: {low: 0.0, high: 0.02, points: 3}}
  plant.initial_rate: [{normal: {std: 0.001}}, 0.0, {uniform: {low: -0.001, high: 0.001, points: 2}}]
"""


def spec(folder: Path, *overrides: str, text: str = DRAWN) -> CampaignSpec:
    path = folder / "drawn.yaml"
    path.write_text(text, encoding="utf-8")
    return load_campaign(path, overrides)


def test_the_seed_of_a_case_is_spawned_from_its_number(tmp_path: Path) -> None:
    for count in (3, 5):
        for case in plan_cases(spec(tmp_path, f"cases={count}")):
            sequence = np.random.SeedSequence(7, spawn_key=(case.case_id,))
            assert case.seed == int(sequence.generate_state(1, np.uint64)[0]) >> 1
            assert case.scenario(spec(tmp_path, "cases=1").base, "drawn").seed == case.seed


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_a_larger_plan_holds_the_smaller_bit_for_bit(tmp_path: Path, method: str) -> None:
    small, large = (plan_cases(spec(tmp_path, f"method={method}", f"cases={count}")) for count in (8, 20))
    assert large[:8] == small
    assert len({case.digest for case in large}) == 20


def test_hypercubes_and_sequences_fill_the_cube_evenly(tmp_path: Path) -> None:
    for method in ("lhs", "sobol"):
        points = sample_coordinates(spec(tmp_path, f"method={method}", "cases=16"))
        assert points.shape == (16, 3)
        np.testing.assert_array_equal(
            np.sort(np.floor(16 * points), axis=0), np.arange(16.0)[:, None].repeat(3, axis=1)
        )


def test_a_grid_holds_every_combination(tmp_path: Path) -> None:
    text = DRAWN.replace("{normal: {std: 0.001}}", "{choice: [0.0, 0.001]}")
    cases = plan_cases(spec(tmp_path, "method=grid", text=text))
    assert len(cases) == 3 * 2 * 2
    values = [tuple(case.drawn.values()) for case in cases]
    assert values[:3] == [(0.0, 0.0, -0.001), (0.0, 0.0, 0.001), (0.0, 0.001, -0.001)]
    assert len(set(values)) == 12
    assert len({case.seed for case in cases}) == 12
    with pytest.raises(InputError, match="the grid has 12 of them, got 10"):
        plan_cases(spec(tmp_path, "method=grid", "cases=10", text=text))
    with pytest.raises(InputError, match=r"plant.initial_rate\[0\]: grid needs to know how many values"):
        plan_cases(spec(tmp_path, "method=grid"))


def test_saltelli_pairs_points_column_by_column(tmp_path: Path) -> None:
    points = sample_coordinates(spec(tmp_path, "method=saltelli", "cases=20"))  # 4 (3 + 2)
    first, second, *mixed = np.split(points, 5)
    for column, part in enumerate(mixed):
        expected = first.copy()
        expected[:, column] = second[:, column]
        np.testing.assert_array_equal(part, expected)
    with pytest.raises(InputError, match=r"a power of two times 5 .*, such as 20; got 21"):
        plan_cases(spec(tmp_path, "method=saltelli", "cases=21"))


IMPOSSIBLE: list[tuple[str, Any]] = [
    (
        "plant.mass_properties: {mass: {normal: {mean: 100, std: 60}}, center_of_mass: [0, 0, 0], inertia: I}",
        r"\.mass: ",
    ),
    ("plant.mass_properties: {mass: 6000, center_of_mass: [0, 0, 0], inertia: J}", "inertia"),
    ("plant.thrust_dispersion: {normal: {mean: 0.1, std: 0.05}}", "thrust_dispersion: "),
]


@pytest.mark.parametrize(("drawn", "field"), IMPOSSIBLE)
def test_an_impossible_draw_is_refused_with_case_and_values(tmp_path: Path, drawn: str, field: str) -> None:
    full = drawn.replace("I}", "[[9e4, 0, 0], [0, 9e4, 0], [0, 0, 9e4]]}")
    full = full.replace("J}", "[[{uniform: {low: 7.0e5, high: 1.1e6}}, 0, 0], [0, 8e5, 0], [0, 0, 1.6e6]]}")
    text = f"name: x\nbase: sample_maneuver\ncases: 40\ndraw:\n  {full}\n"
    with pytest.raises(InputError, match=f"drawn.yaml: case [0-9]+: .*{field}.*; drawn: plant.*= ") as caught:
        plan_cases(spec(tmp_path, text=text))
    assert "\n" not in str(caught.value)


def test_records_are_estimated_one_a_case(tmp_path: Path) -> None:
    (tmp_path / "flights").mkdir()
    for number in (2, 0, 1):
        (tmp_path / "flights" / f"{number}.csv").touch()
    cases = plan_cases(spec(tmp_path, "records=flights/*.csv"))
    assert [Path(str(case.record)).name for case in cases] == ["0.csv", "1.csv", "2.csv"]
    assert len(plan_cases(spec(tmp_path, "records=flights/*.csv", "cases=2"))) == 2
    for override, said in (
        ("records=flights/*.parquet", "no file fits"),
        ("records=/etc/*.csv", "is no pattern of files"),
        ("records=''", "is no pattern of files"),
    ):
        with pytest.raises(InputError, match=said):
            plan_cases(spec(tmp_path, override))
    with pytest.raises(InputError, match="4 are asked for, and there are 3 records"):
        plan_cases(spec(tmp_path, "records=flights/*.csv", "cases=4"))
