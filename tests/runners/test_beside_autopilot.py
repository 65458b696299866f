"""Jets that are prescribed beside an autopilot, and flights with neither."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_flights import quick

from massprop_drake import load_scenario, simulate
from massprop_drake.errors import InputError
from massprop_drake.inputs.scenario import resolve_scenario

SHORT = ["duration_s=12", "maneuver=[]", "estimation.filter=joint", "detector.kind=off"]
PULSE = "jet_schedule=[{jet: ZP1, start_s: 2, end_s: 2.4}]"


def test_an_autopilot_holds_attitude_while_nothing_is_prescribed() -> None:
    run = simulate(
        load_scenario("small_satellite_maneuver", [*SHORT, PULSE, "autopilot.engaged=true"]), look_back=False
    )
    jet = run.scenario.vehicle_data.designations.index("ZP1")
    fires = run["command"] > 0.0
    prescribed = (run.time_s > 1.95) & (run.time_s < 2.35)
    assert fires[prescribed, jet].all()
    assert fires[prescribed].sum() == 4  # nothing else
    assert not fires[run.time_s < 1.95].any()
    assert fires[~prescribed].any()  # against what the pulse did
    turned = np.degrees(np.linalg.norm(run["rate"], axis=1))
    assert turned.max() > 0.4
    assert turned[-1] < 0.25  # within the rate deadband


def test_a_maneuver_needs_an_autopilot() -> None:
    with pytest.raises(InputError, match="flown by the autopilot, which does not fly"):
        load_scenario("small_satellite_maneuver", ["autopilot.engaged=false"])
    with pytest.raises(InputError, match=r"autopilot\.engaged: true, for both"):
        load_scenario("small_satellite_maneuver", [PULSE])
    both = load_scenario("small_satellite_maneuver", [PULSE, "autopilot.engaged=true"])
    assert both.maneuver
    assert both.jet_schedule


def test_firings_are_flown_until_targets_are_known() -> None:
    """Nothing is commanded by hand: the vehicle is weighed by what the estimators ask for."""
    asked = "{when: target, targets: {mass: 1%, Iyy: 1%}, limits: {rate: 1 deg/s}}"
    settings = ["duration_s=20", *SHORT[1:], f"autopilot.test_firing={asked}"]
    run = simulate(load_scenario("small_satellite_maneuver", settings), look_back=False)
    mass = run.covariance[9, 9] ** 0.5 / run.results.estimates[9]
    assert mass < 0.01
    assert abs(1.0 / run.results.estimates[9] - 560.0) < 4.0 * 5.6
    fires = run.time_s[(run["command"] > 0.0).any(axis=1)]
    assert fires.min() > 1.9  # the question has stood for two seconds
    turned = 2.0 * np.degrees(np.arccos(np.clip(np.abs(run["attitude"][:, 0]), 0.0, 1.0)))
    assert turned.max() < 3.0


def test_on_times_hold_attitude_better_and_for_less_propellant_than_whole_cycles() -> None:
    vehicle = quick("small_satellite", "hydrazine", on_time_quantum_s=0.001)
    pilot = {"hold_rate_limit": 0.0035, "capture_rate": 0.0035, "acceleration": 0.006, "horizon_s": 1.0}
    given = {"vehicle": vehicle, "duration_s": 25.0, "seed": 4, "detector": {"kind": "off"}}
    given |= {"plant": {"disturbance": {"torque": [0.01, -0.006, 0.008]}}, "execution": {"engine": "loop"}}
    given["estimation"] = {"filter": "thesis"}  # the quickest, whose estimates nothing here asks for
    rms, used = {}, {}
    for output in ("cycles", "on_time"):
        own = pilot | {"rate_deadband": 0.0005, "jet_selection": {"output": output}}
        run = simulate(resolve_scenario({**given, "autopilot": own}))
        held, mass = run["attitude_error"][80:], 1.0 / run["truth"][:, 9]
        rms[output], used[output] = float(np.sqrt(np.mean(held**2))), mass[80] - mass[-1]
    assert rms["on_time"] < 0.5 * rms["cycles"]
    assert used["on_time"] < 0.5 * used["cycles"]
