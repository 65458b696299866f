"""The campaign of vehicles that are followed in a fixed frame: it goes on where it was, and how it counts."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from script_probe import script


@pytest.fixture(scope="module")
def campaign() -> ModuleType:
    return script(Path(__file__).parents[1] / "benchmarks" / "poses.py")


def outcome(campaign: ModuleType, seed: int, **other: Any) -> Any:
    common = {"case": "planar", "seconds": 40.0, "grouped": [], "verdict": "consistent", "spent_s": 1.0}
    found = {"dead": "T2", "named": [("T2", 9.0)], "sigmas": [1.0, -2.0], "first_s": 5.0, "delay": (0.003, 0.4)}
    return campaign.Outcome(seed=seed, **(common | found | other))


def test_a_row_counts_flights(campaign: ModuleType) -> None:
    done = [
        outcome(campaign, 0),
        outcome(campaign, 1, named=[], first_s=None, delay=(-0.004, -1.5)),  # fired too seldom
        outcome(campaign, 2, named=[("T4", 3.0)]),
        outcome(campaign, 3, dead="", named=[], first_s=None, sigmas=[0.5, 3.5], delay=(0.0, 0.0)),
    ]
    assert [one.odd for one in done] == [False, True, True, False]
    assert campaign.row("planar", done) == (
        "| air-bearing satellite, 4 | 1 of 3 (1 fired less than ten times) | 1 | 87.5 % | 2.9 ms; 1.5 sigma |"
    )
    assert "9.0 s (median)" in campaign.besides("planar", done)


def test_an_interrupted_campaign_goes_on(
    campaign: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown: list[int] = []

    def fly(_name: str, seed: int, seconds: float) -> Any:
        flown.append(seed)
        return outcome(campaign, seed, seconds=seconds)

    monkeypatch.setattr(campaign, "fly", fly)
    path = tmp_path / "flights.jsonl"
    for count, seconds in ((2, "40"), (3, "40"), (1, "20")):
        arguments = ["--case", "planar", "--first", "7", "--count", str(count), "--seconds", seconds]
        monkeypatch.setattr(sys, "argv", ["poses.py", *arguments, "--write", str(path)])
        campaign.main()
    assert flown == [7, 8, 9, 7]
    printed = capsys.readouterr().out.splitlines()
    assert [line.split("|")[1].strip() for line in printed if line.startswith("| air")] == [
        f"air-bearing satellite, {count}" for count in (2, 3, 1)
    ]


def test_a_flight_is_judged_by_its_draw(campaign: ModuleType) -> None:
    one = campaign.fly("planar", 90, 1.5)
    assert (one.case, one.seed, one.named) == ("planar", 90, [])
    assert len(one.sigmas) == 4  # Izz, x, y, 1/m
    assert np.abs(one.sigmas).max() < 5.0
