"""Jets that do not give exactly their thrust, in closed loop."""

from __future__ import annotations

import numpy as np

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs.params import thrust_factors

DISPERSED = "plant.thrust_dispersion=0.01"
CONSIDERED = "estimation.thrust_uncertainty=0.01"


def flown(*overrides: str) -> Run:
    """The sample maneuver and ten seconds more."""
    return simulate(
        load_scenario("sample_maneuver", ["duration_s=60", "execution.engine=loop", *overrides]), look_back=False
    )


def worst(run: Run) -> float:
    """Error of the ten estimates at the end, in sigmas."""
    return float(np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max())


def test_healthy_runs_raise_no_alarm_and_end_within_three_sigma_where_thrust_errors_are_considered() -> None:
    runs = [flown(f"seed={seed}", DISPERSED, CONSIDERED) for seed in (0, 1)]
    for run in runs:
        assert not run["alarm"].any()
        assert run.summary["detections"] == []
        assert run["converged"][-1, 0] == 1.0
        assert worst(run) < 3.0
        # every jet gives its own thrust all along, instantaneous here
        full, factors = np.array([jet.thrust for jet in run.scenario.vehicle_data.jets]), thrust_factors(run.scenario)
        np.testing.assert_allclose(run["thrust"], run["command"] * full * factors, rtol=1e-12, atol=1e-9)
    on = runs[0]["command"].any(axis=0) & runs[1]["command"].any(axis=0)
    assert on.sum() > 10
    assert (runs[0]["thrust"].max(axis=0)[on] != runs[1]["thrust"].max(axis=0)[on]).all()
    # 1 % of thrust is 1 % of inverse inertia; a run can be lucky, this one is not
    assert worst(flown("seed=1", DISPERSED)) > 6.0


def test_a_leak_gives_its_force_beside_a_thrust_that_is_off() -> None:
    leak = "failures=[{kind: leak, jet: R4R, start_s: 0.5, force: 10.4}]"
    run = simulate(load_scenario("sample_maneuver", ["duration_s=4", DISPERSED, leak]), look_back=False)
    jet = run.scenario.vehicle_data.jet_index("R4R")
    off = (run["command"][:, jet] == 0.0) & (run.time_s > 0.6)
    assert off.any()
    np.testing.assert_allclose(run["thrust"][off, jet], 10.4, rtol=1e-12)
