"""The card: how it judges flights, that each kind can be drawn, and that a flight alone is the same bit for bit."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from script_probe import script

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def _beside() -> Iterator[None]:
    """Modules of the card beside each other, as where it is a script."""
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def card() -> ModuleType:
    return script(FOLDER / "card.py")


@pytest.fixture(scope="module")
def fly() -> ModuleType:
    return script(FOLDER / "fly.py")


def declared(time_s: float, *jets: str, jump: bool = False, **other: Any) -> dict[str, Any]:
    kind, isolated = ("mass_property_jump", None) if jump else ("jet_on", "jet" if len(jets) == 1 else "group")
    entry = {"kind": kind, "isolated_to": isolated, "jets": list(jets), "time_s": time_s, "withdrawn_s": None}
    sizes = dict.fromkeys(("magnitude", "magnitude_std", "mass", "mass_std", "position", "position_std"))
    return entry | sizes | other


def failed(jet: str | None, acted_s: float | None, kind: str = "stuck_on") -> dict[str, Any]:
    return {"kind": kind, "jet": jet, "start_s": acted_s, "first_acted_s": acted_s, "force": 10.0}


def facts(*entries: dict[str, Any], happened: tuple[dict[str, Any], ...] = (), **other: Any) -> dict[str, Any]:
    ten = {"errors": [0.1] * 10, "deviations": [0.1] * 10, "sigmas": [1.0] * 10, "nees": 10.0}
    rest = {"verdict": "consistent", "reasons": [], "other": [], "payloads": []}
    return {"declared": list(entries), "failed": list(happened), **ten, **rest, **other}


TWO = (failed("A", 48.0), failed("B", 49.0))


@pytest.mark.parametrize(
    ("outcome", "entries"),
    [
        ("right", [declared(48.5, "A"), declared(50.0, "B")]),
        ("silent", [declared(48.5, "A")]),
        ("wrong", [declared(48.5, "A"), declared(48.6, "B")]),  # before it has acted
        ("wrong", [declared(48.5, "A"), declared(50.0, "B"), declared(51.0, "C")]),
        ("wrong", [declared(48.5, "A"), declared(50.0, jump=True)]),
        ("grouped", [declared(48.5, "A"), declared(50.0, "C", "B", "D")]),
        ("silent", [declared(48.5, "A"), declared(50.0, "C", "B", "D", "E")]),  # too many to act on
        ("wrong", [declared(48.5, "A"), declared(50.0, "C", "D")]),
        ("right", [declared(48.5, "A"), declared(50.0, "C", "B"), declared(51.0, "B")]),
    ],
)
def test_outcomes_of_two_failures(card: ModuleType, outcome: str, entries: list[dict[str, Any]]) -> None:
    assert card.table.judge(facts(*entries, happened=TWO), {}).outcome == outcome


def test_outcomes_of_payloads_and_readings(card: ModuleType) -> None:
    judge, dock = card.table.judge, (failed(None, 48.0, "dock"),)
    assert judge(facts(declared(50.0, jump=True), happened=dock), {}).outcome == "right"
    assert judge(facts(declared(47.0, jump=True), happened=dock), {}).outcome == "wrong"
    assert judge(facts(declared(50.0, jump=True), declared(55.0, jump=True), happened=dock), {}).outcome == "wrong"
    assert judge(facts(happened=dock), {}).outcome == "silent"
    reading = [{"kind": "false_reading", "time_s": 3.0, "sensor": "gyro", "axis": "x"}]
    assert judge(facts(other=reading), {"sensor": True}).outcome == "right"
    assert judge(facts(other=reading), {}).outcome == "wrong"
    assert judge(facts(), {"sensor": True}).outcome == "silent"
    unexplained = [{"kind": "unexplained", "time_s": 3.0, "sensor": None, "axis": None}]
    assert judge(facts(other=unexplained), {}).outcome == "wrong"
    assert judge(facts(other=unexplained), {"reason": "torque"}).outcome == "right"
    assert judge(facts(happened=(failed("A", None),)), {}).outcome == "right"  # never acted
    seldom = failed("A", None) | {"start_s": 10.0}
    assert judge(facts(declared(20.0, "A"), happened=(seldom,)), {}).outcome == "right"  # it has failed for all that
    assert judge(facts(declared(9.0, "A"), happened=(seldom,)), {}).outcome == "wrong"


def test_delays_forces_and_payloads_of_a_flight(card: ModuleType) -> None:
    entries = [
        declared(48.5, "A", "C"),
        declared(50.0, "A", magnitude=12.0, magnitude_std=1.0),
        declared(51.0, jump=True, mass=103.0, mass_std=2.0, position=[1.0, 2.0, 3.0], position_std=[0.5, 0.5, 1.0]),
    ]
    payload = [{"mass": 100.0, "position": [0.0, 2.0, 3.0]}]
    found = card.table.judge(facts(*entries, happened=(TWO[0], failed(None, 50.5, "dock")), payloads=payload), {})
    assert found.delays_s == [0.5, 0.5]
    assert found.forces == [2.0]
    assert found.payloads == [(1.5, 2.0)]


def test_a_row_counts_flights(card: ModuleType) -> None:
    flights = [
        facts(declared(48.5, "A"), happened=TWO[:1]),
        facts(happened=TWO[:1], sigmas=[7.0] + [None] * 9, nees=49.0),
        facts(declared(48.5, "C"), happened=TWO[:1], verdict="inconsistent"),
    ]
    rows = [{"facts": json.dumps(one), "timed": None} for one in flights] + [{"facts": None, "timed": None}]
    row = card.table.counted(rows, {})
    assert (row.n, row.crashed, row.counts, row.far, row.misjudged) == (3, 1, (1, 0, 1, 1), (1, 1), 1)
    assert row.nees == (69.0, 21)
    shown = dict(zip(card.table.HEADER, card.table.cells({"title": "x"}, row), strict=True))
    assert shown["wrong"] == "33.3 (0.84 to 90.6)"  # of Clopper and Pearson
    assert shown["largest error, sigma"] == "7.0 [1; 1]"
    assert card.table.headline("{right} of {n}", [row, row]) == "33.3 (4.33 to 77.7) of 6"
    assert card.table.brief_cells({"title": "x"}, row) == ["x", "1/3", "1", "0.50", "7.0", "1"]


def test_the_page_is_that_of_the_flights_in_the_baseline(card: ModuleType) -> None:
    content = card.load_card()
    version, found = card.baseline(content)
    written = (FOLDER.parent / "docs" / "card.md").read_text(encoding="utf-8")
    if version.label in written:  # else it is of flights that are not kept
        assert written == card.page(content, found, version, 0)
    assert written.count("\n| ") == 1 + 1 + sum(title in written for title in content.groups) + len(found)


def test_every_kind_can_be_drawn(card: ModuleType, fly: ModuleType) -> None:
    content = card.load_card()
    modules = {name: getattr(fly, name) for name in ("bundled", "moving", "orbiter", "vehicles")}
    numbers = set()
    for kind, spec in content.kinds.items():
        module, _, name = spec["draw"].partition(".")
        numbers |= {card.case(content, kind, number).case_id for number in range(20)}
        if module in modules:
            draw = getattr(modules[module], name)
            assert draw(np.random.default_rng(1), 1, **spec.get("with", {})).scenario
        elif module == "poses":
            given = {"vehicle": "", "departures": {}, "told": {}, "walk": 0.0, "seconds": 1.0} | spec.get("with", {})
            assert fly.poses.drawn_flight(1, **given)
        else:
            assert name in fly.real.KNOWN
    assert len(numbers) == 20 * len(content.kinds)  # each flight has a number of its own
    assert {kind for one in content.headlines for kind in one["kinds"]} <= content.kinds.keys()


def test_the_card_is_flown_once_and_a_flight_alone_is_the_same(
    tmp_path: Path,
    fly: ModuleType,
    card: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    kinds = ("small_satellite", "thesis_off")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["card.py", "--kinds", *kinds, "--count", "1", "--numpy", "--workers", "1"])
    card.main()
    first = capsys.readouterr()
    assert "2 of 2 flights" in first.err
    assert "| small satellite | 1 | " in first.out
    card.main()
    assert capsys.readouterr() == (first.out, "")  # the processor's time in it, too
    rows = [row for path in tmp_path.glob("runs/card/*/results/*.parquet") for row in pq.read_table(path).to_pylist()]
    assert sorted(row["kind"] for row in rows) == sorted(kinds)
    alone = fly.Flights({"kinds": card.load_card().kinds, "compiled": False})
    for row in rows:
        assert alone.fly({"kind": row["kind"], "number": row["number"]})["facts"] == row["facts"]
