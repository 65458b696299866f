"""Jets that do not give exactly their thrust, in closed loop."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs.params import thrust_factors
from massprop_drake.maths.linear_algebra import Array

DISPERSED = "plant.thrust_dispersion=0.01"
CONSIDERED = "estimation.thrust_uncertainty=0.01"


@cache
def flown(*overrides: str) -> Run:
    """The sample maneuver and ten seconds more."""
    return simulate(
        load_scenario("sample_maneuver", ["duration_s=60", "execution.engine=loop", *overrides]), look_back=False
    )


def errors_in_sigmas(run: Run) -> Array:
    """Of the ten estimates at the end."""
    return (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_healthy_run_raises_no_alarm_and_ends_within_three_sigma(seed: int) -> None:
    run = flown(f"seed={seed}", DISPERSED, CONSIDERED)
    assert not run["alarm"].any()
    assert run.summary["detections"] == []
    assert run["converged"][-1, 0] == 1.0
    assert np.abs(errors_in_sigmas(run)).max() < 3.0


def test_with_thrust_taken_as_known_the_filter_is_far_too_sure() -> None:
    # 1 % of thrust is 1 % of inverse inertia; a run can be lucky, this one is not
    assert np.abs(errors_in_sigmas(flown("seed=1", DISPERSED))).max() > 6.0


def test_every_jet_gives_its_own_thrust_all_along() -> None:
    run = flown("seed=0", DISPERSED, CONSIDERED)
    full = np.array([jet.thrust for jet in run.scenario.vehicle_data.jets])
    fired = run["command"].any(axis=0)
    assert fired.sum() > 10
    factors = thrust_factors(run.scenario)
    # thrust is instantaneous here
    np.testing.assert_allclose(run["thrust"], run["command"] * full * factors, rtol=1e-12, atol=1e-9)
    assert np.abs(factors[fired] - 1.0).max() > 0.005


def test_a_dispersed_run_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    run = flown("seed=0", DISPERSED, CONSIDERED)
    again = simulate(run.scenario, look_back=False)
    np.testing.assert_array_equal(again["rate"], run["rate"])
    np.testing.assert_array_equal(again["estimate"], run["estimate"])
    other = flown("seed=1", DISPERSED, CONSIDERED)
    on = run["command"].any(axis=0) & other["command"].any(axis=0)
    assert (run["thrust"].max(axis=0)[on] != other["thrust"].max(axis=0)[on]).all()


def test_a_leak_gives_its_force_beside_a_thrust_that_is_off() -> None:
    leak = "failures=[{kind: leak, jet: R4R, start_s: 0.5, force: 10.4}]"
    run = simulate(load_scenario("sample_maneuver", ["duration_s=4", DISPERSED, leak]), look_back=False)
    jet = run.scenario.vehicle_data.jet_index("R4R")
    off = (run["command"][:, jet] == 0.0) & (run.time_s > 0.6)
    assert off.any()
    np.testing.assert_allclose(run["thrust"][off, jet], 10.4, rtol=1e-12)
