"""The bundled vehicles against the figures of their sources, number by number; `tests/data/README.md` names these."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

DATA = Path(__file__).parent.parent / "data"
NAMES = ["orbiter", "small_satellite", "free_flyer", "lander"]
APART = ("jets", "shape")  # in a table of their own; for the eye alone


def rows(name: str, vehicle: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if row["vehicle"] == vehicle]


def content(vehicle: str) -> dict[str, Any]:
    """The file as it stands."""
    text = resources.files("massprop_drake.vehicles").joinpath(f"{vehicle}.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = YAML(typ="safe", pure=True).load(text)
    return found


def numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a file's content by its place; an entry of a list by its name, if it has one."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from numbers(part, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from numbers(part, f"{path}.{part.get('name', index) if isinstance(part, dict) else index}")
    elif isinstance(value, int | float):
        yield path, float(value)


@pytest.mark.parametrize("vehicle", NAMES)
def test_every_figure_is_that_of_its_source(vehicle: str) -> None:
    stated = {key: value for key, value in content(vehicle).items() if key not in APART}
    expected = {row["key"]: float(row["value"]) for row in rows("vehicle_figures.csv", vehicle)}
    assert dict(numbers(stated)) == expected


# the orbiter's jets are those of table 5-1, see `test_vehicle_file`
@pytest.mark.parametrize("vehicle", NAMES[1:])
def test_every_jet_is_where_and_what_its_source_says(vehicle: str) -> None:
    stated = [
        [str(jet[key]) for key in ("number", "designation", "cluster", "kind")]
        + [float(number) for number in (*jet["position"], *jet["direction"], jet["thrust"])]
        for jet in content(vehicle)["jets"]
    ]
    expected = [
        [row[key] for key in ("number", "designation", "cluster", "kind")]
        + [float(row[key]) for key in ("x", "y", "z", "dir_x", "dir_y", "dir_z", "thrust")]
        for row in rows("vehicle_jets.csv", vehicle)
    ]
    assert stated == expected
