"""Forecasts of what a flight will tell: against flights, against a leak that is flown, and what cannot be told."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from massprop_drake import Run, foretell, load_scenario, simulate
from massprop_drake.cli.app import app
from massprop_drake.errors import InputError
from massprop_drake.runners import forecast
from massprop_drake.runners.forecast import Forecast

SHORT = ["duration_s=22", "estimation.filter=joint"]
ALONE = [*SHORT, "detector.kind=off", "execution.engine=loop"]


@pytest.fixture(scope="module")
def told() -> Forecast:
    return foretell(load_scenario("small_satellite_maneuver", SHORT), since_s=12.0)


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(load_scenario("small_satellite_maneuver", ALONE), look_back=False)


def test_sigmas_are_those_of_the_flight(told: Forecast, flown: Run) -> None:
    np.testing.assert_allclose(told.deviations[-1], flown["standard_deviation"][-1], rtol=0.05)
    np.testing.assert_allclose(told.properties, flown["truth"][-1], rtol=1e-6)


def test_what_all_thrusts_have_in_common_is_a_floor(told: Forecast) -> None:
    """Only jets that fire count: of n thrusts of 1 % the mean is known to 1 % / n^1/2."""
    floor = told.floors[0] / told.properties[0]
    fired = round((0.01 / floor) ** 2)
    assert 0.01 / floor == pytest.approx(np.sqrt(fired), rel=1e-9)
    assert 8 <= fired <= 12
    assert (told.deviations[-1][:3] >= 0.99 * told.floors[:3]).all()
    exact = foretell(load_scenario("small_satellite_maneuver", [*SHORT, "joint.thrust_uncertainty=0"]))
    assert not exact.floors.any()
    assert exact.deviations[-1][0] < 0.5 * told.deviations[-1][0]


def test_a_leak_is_named_when_it_is_foretold(told: Forecast) -> None:
    leak = {"kind": "leak", "jet": "ZP1", "start_s": 12.0, "force": 0.25}
    settings = [*SHORT, "execution.engine=loop", f"failures={json.dumps([leak])}"]
    run = simulate(load_scenario("small_satellite_maneuver", settings), look_back=False)
    (named,) = run.summary["detections"]
    (one,) = [suspect for suspect in told.suspects if suspect.jet == "ZP1"]
    assert one.after_s is not None
    assert one.after_s <= named["time_s"] - 12.0 <= one.after_s + 0.5  # it is the least; other histories are weighed
    assert one.force == pytest.approx(0.25)


def test_the_command_prints_it(told: Forecast, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[dict[str, Any]]()
    monkeypatch.setattr(forecast, "foretell", lambda _, **options: asked.append(options) or told)
    words = ["foretell", "small_satellite_maneuver", "--since", "12", "--leak", "0.05"]
    printed = CliRunner().invoke(app, words)
    assert printed.exit_code == 0
    assert "ZP1" in printed.stdout
    assert "propellant:" in printed.stdout
    found = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    np.testing.assert_allclose(found["standard_deviations"], told.deviations[-1], rtol=1e-9)
    assert [one["jet"] for one in found["suspects"]] == [one.jet for one in told.suspects]
    assert asked == 2 * [{"nominal": False, "share": 0.05, "since_s": 12.0}]


@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("air_bearing_pulses", {}, "in a fixed frame"),
        ("small_satellite_maneuver", {"share": 1.5}, "above 0 and at most 1, not 1.5"),
        ("small_satellite_maneuver", {"since_s": 99.0}, "before the end of the flight, 60 s, not at 99 s"),
    ],
)
def test_what_cannot_be_foretold_is_one_message(name: str, asked: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match="foretell: ") as caught:
        foretell(load_scenario(name), **asked)  # type: ignore[arg-type]
    assert words in str(caught.value)
