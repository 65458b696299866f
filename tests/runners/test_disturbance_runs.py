"""A vehicle that states a torque and a force that change slowly: estimated, told from a failed jet, and believed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from pose_probe import again
from test_on_time_runs import pulses, quick

from massprop_drake import Estimator, Run, Scenario, simulate
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_parts import Disturbance

STATED = {"torque_std": 0.005, "force_std": 0.01, "time_constant_s": 30.0}
DISTURBANCE = {"torque_std": [0.005] * 3, "force_std": [0.01] * 3, "correlation_time_s": 30.0}
LEAK = {"kind": "leak", "jet": "ZP1", "start_s": 20.0, "force": 0.25}


def flight(stated: dict[str, Any] | None, **more: Any) -> Scenario:
    vehicle = again(
        quick("small_satellite", "hydrazine"), disturbance=None if stated is None else Disturbance(**stated)
    )
    own = {"name": "pulses", "vehicle": vehicle, "duration_s": 28.0, "seed": 5, "joint": {"tank_fraction": 0}}
    plant = {"dispersion": {}, "thrust_dispersion": 0.01, "disturbance": DISTURBANCE}
    return resolved(own | {"plant": plant, "jet_schedule": pulses(vehicle, 28.0)} | more)


def flown(stated: dict[str, Any] | None, **more: Any) -> Run:
    return simulate(flight(stated, **{"execution": {"engine": "loop"}, **more}))


@pytest.fixture(scope="module")
def leaking() -> Run:
    return flown(STATED, failures=[LEAK])


def errors(run: Run) -> float:
    """Largest error of the ten parameters, in their 1-sigma."""
    return float(np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]).max())


def test_untold_it_biases_and_is_seen() -> None:
    untold = flown(None, detector={"kind": "off"})
    assert errors(untold) > 5.0
    assert untold.summary["consistency"]["verdict"] == "inconsistent"


def test_stated_it_does_not_bias_and_the_failed_jet_is_named(leaking: Run) -> None:
    assert errors(leaking) < 4.0
    assert [one["jets"] for one in leaking.summary["detections"]] == [["ZP1"]]
    assert leaking.summary["detections"][0]["time_s"] < 23.0
    assert leaking.summary["consistency"]["verdict"] == "consistent"


def test_an_estimator_gives_the_run_again_and_what_acts(leaking: Run) -> None:
    vehicle = leaking.scenario.vehicle_data
    dut = Estimator(vehicle, leaking.scenario)
    for row in range(180):
        if row == 100:
            state, dut = dut.state, Estimator(vehicle, leaking.scenario)
            dut.restore(state)
        rates, velocities = (
            {one.name: leaking[one.name][row] for one in of} for of in (vehicle.gyros, vehicle.accelerometers)
        )
        told, onsets_s = leaking["command"][row], leaking["command_onset"][row]
        step = dut.step(leaking.time_s[row], rates, velocities, told, onsets_s=onsets_s)
        np.testing.assert_array_equal(step.estimate, leaking["estimate"][row])
    assert dut.disturbance is not None
    value, deviation = dut.disturbance
    rest = np.array([0.005] * 3 + [0.01] * 3)
    assert (deviation < 0.6 * rest).all()
    assert (np.abs(value) < 4.0 * rest).all()
    assert np.abs(value).max() > 3.0 * deviation.min()


def test_loop_and_diagram_give_the_same() -> None:
    loop, diagram = (
        simulate(flight(STATED, duration_s=6.0, execution={"engine": engine})) for engine in ("loop", "diagram")
    )
    for name in ("estimate", "standard_deviation", "alarm"):
        np.testing.assert_allclose(diagram[name], loop[name], rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_stated_walk_of_the_rate_turns_accelerometers_too() -> None:
    """A torque that is new in each sample, .05 N-m about each axis: a walk of the rate, whatever reads it."""
    torque = {"torque_std": [0.05] * 3, "correlation_time_s": 1e-6}
    plant = {"dispersion": {}, "thrust_dispersion": 0.01, "disturbance": torque}
    run = flown(None, plant=plant, detector={"kind": "off"}, joint={"tank_fraction": 0, "rate_walk": 1.7e-4})
    assert run.summary["consistency"]["verdict"] == "consistent"
    assert errors(run) < 4.0


def test_stated_ten_times_too_small_it_is_told_how_much_would_cover_it() -> None:
    small = {**STATED, "torque_std": 0.0005, "force_std": 0.001}
    found = flown(small, detector={"kind": "off"})
    assert found.summary["consistency"]["verdict"] == "inconsistent"
    words = re.compile(r"joint.rate_walk=(\S+) and joint.velocity_walk=(\S+) would cover it$")
    said = [words.search(str(one)) for one in found.summary["consistency"]["reasons"]]
    (told,) = [one for one in said if one is not None]
    walks = {"tank_fraction": 0, "rate_walk": float(told[1]), "velocity_walk": float(told[2])}
    covered = flown(None, detector={"kind": "off"}, joint=walks)
    assert covered.summary["consistency"]["verdict"] == "consistent"
    assert errors(covered) < 4.0


def test_untold_it_is_said_with_its_size_and_the_failed_jet_is_named_beside_it() -> None:
    found = flown(None, failures=[LEAK])
    assert [one["jets"] for one in found.summary["detections"]] == [["ZP1"]]
    assert found.summary["consistency"]["verdict"] == "inconsistent"
    first = next(one for one in found.summary["events"] if one["kind"] == "disturbance")
    assert found.summary["fault_probability"]["unknown"] > 0.99  # something pushes that is no jet
    assert 0.0005 < first["torque_std"] < 0.05
    assert 0.001 < first["force_std"] < 0.1
    assert errors(found) < 4.0


def test_a_torque_that_hardly_changes_is_one_draw_of_what_is_stated() -> None:
    """2.2 sigma about two axes: accelerometers that feel it as well are no second evidence, nor is its spectrum."""
    plant = {"dispersion": {}, "thrust_dispersion": 0.01, "disturbance": {"torque": [0.011, -0.011, 0.0]}}
    stated = {"torque_std": 0.005, "force_std": 0.001, "time_constant_s": 1000.0}
    run = flown(stated, plant=plant, detector={"kind": "off"})
    assert run.summary["consistency"]["verdict"] == "consistent"
    assert errors(run) < 4.0
