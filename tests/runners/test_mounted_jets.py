"""Jets that do not point where the drawing has them: stated they bias nothing, untold they are seen."""

from __future__ import annotations

import numpy as np
import pytest
from test_on_time_runs import pulses, quick

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.errors import InputError
from massprop_drake.inputs import true_params
from massprop_drake.inputs.scenario import resolved

MOUNTED = {"direction_std": 0.02, "position_std": 0.01}


def flown(share: float, engine: str = "diagram", seed: int = 1) -> Run:
    """A flight whose vehicle states a share of what its jets are truly off by."""
    stated = {key: share * value for key, value in MOUNTED.items()}
    vehicle = quick("small_satellite", "hydrazine", **stated)
    own = {"name": "pulses", "vehicle": vehicle, "duration_s": 16.0, "seed": seed, "joint": {"tank_fraction": 0}}
    plant = {"dispersion": {}, "thrust_dispersion": 0.01, "mounting_dispersion": 1.0 / share}
    more = {"detector": {"kind": "off"}, "execution": {"engine": engine}, "jet_schedule": pulses(vehicle, 16.0)}
    return simulate(resolved(own | {"plant": plant} | more))


def errors(run: Run) -> float:
    """Largest error of the ten parameters, in their 1-sigma."""
    return float(np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max())


@pytest.fixture(scope="module")
def told() -> Run:
    return flown(1.0, "loop")


def test_stated_it_does_not_bias(told: Run) -> None:
    assert errors(told) < 3.5
    assert told.summary["consistency"]["verdict"] == "consistent"


def test_untold_it_is_seen() -> None:
    untold = flown(0.1, "loop")
    assert errors(untold) > 4.0
    assert untold.summary["consistency"]["verdict"] == "inconsistent"


def test_both_simulators_fly_the_same_jets(told: Run) -> None:
    np.testing.assert_allclose(flown(1.0)["estimate"], told["estimate"], rtol=1e-6, atol=1e-9)


def test_a_seed_draws_the_mounting_and_zero_leaves_it() -> None:
    drawn = [true_params.plant_wrenches(load_scenario("small_satellite_leak", [f"seed={seed}"])) for seed in (1, 2)]
    np.testing.assert_array_equal(*drawn)  # nothing is stated, and thrusts are exact
    one, other = flown(1.0, "loop", 1).scenario, flown(1.0, "loop", 2).scenario
    assert np.abs(true_params.plant_wrenches(one) - true_params.plant_wrenches(other)).max() > 0.01


def test_what_no_jet_can_be_off_by_is_refused() -> None:
    with pytest.raises(InputError, match="mounting_dispersion"):
        load_scenario("small_satellite_leak", ["plant.mounting_dispersion=-1"])
