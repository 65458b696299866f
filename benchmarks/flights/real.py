"""Spans of the bundled records of a real vehicle, an air-bearing satellite, and of its twin in another simulator."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from flights.flight import Random

_RECORDS = Path(__file__).parents[2] / "docs" / "tutorials" / "air_bearing"
_SPAN_S = 90.0


class Known(NamedTuple):
    """Facts about a record, from its source.

    Attributes:
        mass: kg.
        failed: designations of jets that hardly push.
    """

    mass: float
    failed: tuple[str, ...]


KNOWN: Mapping[str, Known] = {"hardware": Known(23.09, ("T2",)), "twin": Known(23.09, ())}


def cut(random: Random, name: str, folder: Path) -> tuple[Path, Path]:
    """Draws 90 s of a record and writes them; returns the file, and its map."""
    with (_RECORDS / f"{name}.csv").open(newline="") as file:
        head, *rows = list(csv.reader(file))
    clock = head.index("nominal_time_s")
    longest = float(rows[-1][clock]) - _SPAN_S
    start_s = float(random.uniform(0.0, max(longest, 0.0)))
    chosen: list[Any] = [row for row in rows if start_s <= float(row[clock]) <= start_s + _SPAN_S]
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([head, *chosen])
    return path, Path(shutil.copy(_RECORDS / f"{name}_map.yaml", folder))
