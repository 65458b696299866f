"""What many tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from massprop_drake import load_scenario, load_vehicle, simulate
from massprop_drake.run import Run
from massprop_drake.scenario import Scenario
from massprop_drake.vehicle import Vehicle

REPOSITORY = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def orbiter() -> Vehicle:
    return load_vehicle("orbiter")


@pytest.fixture(scope="session")
def sample_maneuver() -> Scenario:
    return load_scenario("sample_maneuver")


@pytest.fixture(scope="session")
def sample_run(sample_maneuver: Scenario) -> Run:
    """The sample manoeuvre with seed 0; do not change its arrays."""
    return simulate(sample_maneuver)
