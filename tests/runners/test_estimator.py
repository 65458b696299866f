"""The real-time estimator: the diagram's answers without the diagram."""

from __future__ import annotations

import copy
import json
import math
import pickle
from typing import Any

import numpy as np
import pytest
from vehicle_flights import step

from massprop_drake import Estimator, InputError, Run, Vehicle, load_scenario
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import resolve_scenario

STILL = np.zeros(3)
OFF = np.zeros(44)


def test_where_the_preferred_accelerometer_is_missing_the_next_takes_over(sample_run: Run) -> None:
    used = np.flatnonzero(sample_run["mass_used"][:, 0])
    dut = Estimator(sample_run.scenario.vehicle_data, sample_run.scenario)
    lost = used[5]
    for sample in range(lost + 4):
        velocities = {name: sample_run[name][sample] for name in ("acc1", "acc2", "acc3")}
        if sample == lost:
            velocities["acc2"] = np.full(3, np.nan)
        step = dut.step(
            sample_run.time_s[sample], sample_run["gyro"][sample], velocities, sample_run["command"][sample]
        )
        assert step.mass_used == (sample_run["mass_used"][sample, 0] != 0.0)
        same = np.array_equal(step.estimate, sample_run["estimate"][sample])
        assert same == (sample < lost)


def test_a_saturated_reading_counts_as_missing(toy_data: dict[str, Any]) -> None:
    toy_data["gyros"][0]["range"] = 0.5
    toy_data["accelerometers"][0]["range"] = 10.0
    vehicle = Vehicle.model_validate(toy_data)
    dut = Estimator(vehicle, resolve_scenario({"estimation": {"filter": "thesis"}}))
    on = np.zeros(12)
    on[0] = 1.0
    seen = []
    for number, (rate, velocity) in enumerate(
        [(0.1, 0.0)] * 3 + [(-0.5, 0.0), (0.1, 0.0), (0.1, 10.0)] + [(0.1, 0.0)] * 3
    ):
        step = dut.step(0.1 * number, [rate, 0.0, 0.0], [0.0, velocity, 0.0], on)
        seen.append((step.used, bool(np.isfinite(step.mass_nis))))
    # a combination is steady from its second interval on; the mass filter needs the rates too
    full, none, turning = (True, True), (False, False), (True, False)
    assert seen == [none, (False, True), full, none, none, turning, turning, full, full]


def test_an_outside_wrench_is_what_a_jet_of_the_same_wrench_would_be(orbiter: Vehicle) -> None:
    jet = orbiter.jet_index("R4R")
    on = OFF.copy()
    on[jet] = 1.0
    settings = load_scenario("sample_maneuver", ["estimation.start=nominal"])
    firing, pushed = Estimator(orbiter, settings), Estimator(orbiter, settings)
    for k in range(6):
        rates, velocities = [1e-4 * k, 2e-4 * k, -1e-4 * k], [0.01 * k, 0.0, 0.0]
        one = firing.step(0.08 * k, rates, velocities, on)
        other = pushed.step(0.08 * k, rates, velocities, OFF, orbiter.wrenches[jet])
        if k == 0:
            continue
        # the jet's first interval is not steady, the outside force's is
        assert (one.used, other.used) == (k > 1, True)
    assert not np.array_equal(other.estimate, orbiter.nominal.vector())
    plain = Estimator(orbiter, settings)
    for k in range(3):
        step = plain.step(0.08 * k, [1e-4 * k, 0.0, 0.0], STILL, OFF, np.zeros(6))
        assert not step.used


def test_the_nearest_possible_estimate_on_request(orbiter: Vehicle) -> None:
    """What a body can have is the estimate; from zero, where nothing is known, there is none."""
    dut = Estimator(orbiter, load_scenario("sample_maneuver", ["estimation.start=nominal"]))
    step = dut.step(0.0, STILL, STILL, OFF)
    near = dut.nearest_possible()
    assert near is not None
    np.testing.assert_array_equal(near, step.estimate)
    assert Estimator(orbiter, load_scenario("sample_maneuver", ["estimation.start=zero"])).nearest_possible() is None


def test_a_runs_filter_state_serves(stuck_run: Run) -> None:
    """What a simulated run leaves is what the estimator knows after its telemetry."""
    dut, whole = (Estimator(stuck_run.scenario.vehicle_data, stuck_run.scenario) for _ in range(2))
    steps = [step(whole, stuck_run, row) for row in range(stuck_run.time_s.size)]
    dut.restore(stuck_run.state)
    np.testing.assert_array_equal(dut.covariance, whole.covariance)
    assert dut.state["states"] == whole.state["states"]
    # the file does not say what is commanded beyond the end: that interval is not usable
    later = dut.step(stuck_run.time_s[-1] + 0.08, STILL, STILL, OFF)
    assert not later.used
    np.testing.assert_array_equal(later.estimate, steps[-1].estimate)
    np.testing.assert_array_equal(later.known_wrench, steps[-1].known_wrench)


NO_STATES: dict[str, tuple[dict[str, Any], str]] = {
    "format": ({"format": 3}, "format: input should be less than or equal to 2, got 3"),
    "time": ({"time_s": float("inf")}, "time_s: input should be a finite number"),
    "command": ({"command": [2.0] * 44}, "command"),
    "wrench": ({"outside_wrench": [0.0] * 5}, "outside_wrench: must have 6 values"),
    "states": ({"states": {}}, "the saved state of failure_detector has sizes none"),
    "key": ({"more": 1}, "more: unknown key"),
}


@pytest.mark.parametrize("name", NO_STATES)
def test_a_damaged_state_is_refused_and_the_estimator_goes_on(short_run: Run, name: str) -> None:
    change, words = NO_STATES[name]
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    for row in range(5):
        step(dut, short_run, row)
    before = json.dumps(dut.state)
    with pytest.raises(InputError, match=f"state: .*{words}|state: {words}"):
        dut.restore({**dut.state, **change})
    assert json.dumps(dut.state) == before


def test_a_state_of_format_1_is_taken_with_one_warning(short_run: Run) -> None:
    dut = Estimator(short_run.scenario.vehicle_data, short_run.scenario)
    kept = dut.state
    old = {key: value for key, value in kept.items() if key not in ("format", "made_with")}
    with pytest.warns(RenamedWarning, match=r"state: is of format 1, .* which does not say") as caught:
        dut.restore(old)
    assert len(caught) == 1
    assert json.dumps(dut.state) == json.dumps(kept)


NO_SAMPLES: dict[str, tuple[dict[str, Any], str]] = {
    "infinite time": ({"time_s": math.inf}, "time_s must be finite"),
    "unknown time": ({"time_s": math.nan}, "time must go forward"),
    "the same time": ({"time_s": 0.0}, r"time must go forward: .* after 0\.0 s"),
    "time in words": ({"time_s": "soon"}, "time_s must be numbers"),
    "two times": ({"time_s": [1.0, 2.0]}, r"time_s must have shape \(\)"),
    "infinite rate": ({"gyro": [0.0, math.inf, 0.0]}, "gyro must be finite"),
    "huge rate": ({"gyro": [0.0, 1e300, 0.0]}, "gyro must be finite and at most"),
    "four rates": ({"gyro": [0.0] * 4}, r"gyro must have shape \(3,\), got \(4,\)"),
    "complex rate": ({"gyro": [1j, 0.0, 0.0]}, "gyro must be numbers"),
    "no package": ({"gyro": {"gyro2": STILL}}, r"gyro: 'gyro2' is no package; the vehicle has \['gyro'\]"),
    "no reading": ({"gyro": {}}, r"gyro: no reading; the vehicle has \['gyro'\]"),
    "infinite velocity": ({"accelerometers": [math.inf] * 3}, "accelerometers must be finite"),
    "command of two": ({"commands": np.full(44, 2.0)}, "commands must be fractions"),
    "no commands": ({"commands": None}, "commands must be given with every sample"),
    "few commands": ({"commands": np.zeros(43)}, "commands must have shape"),
    "unknown wrench": ({"outside_wrench": [math.nan] * 6}, "outside_wrench must be finite"),
    "short wrench": ({"outside_wrench": [0.0] * 3}, r"outside_wrench must have shape \(6,\), got \(3,\)"),
}


def test_what_is_no_sample_is_refused_and_leaves_the_state(orbiter: Vehicle) -> None:
    dut = Estimator(orbiter, resolve_scenario({"estimation": {"filter": "thesis"}}))
    dut.step(0.0, STILL, STILL, OFF)
    before = json.dumps(dut.state)
    for name, (change, words) in NO_SAMPLES.items():
        sample = {"time_s": 0.08, "gyro": STILL, "accelerometers": STILL, "commands": OFF, **change}
        with pytest.raises(ValueError, match=words):
            dut.step(**sample)
        assert json.dumps(dut.state) == before, name


def test_settings_that_do_not_go_with_the_vehicle_are_refused(toy_data: dict[str, Any]) -> None:
    settings = load_scenario("sample_maneuver", ["sensors.accelerometer=acc3"])
    with pytest.raises(ValueError, match="acc3"):
        Estimator(Vehicle.model_validate(toy_data), settings)
    del toy_data["accelerometers"]
    vehicle = Vehicle.model_validate(toy_data)
    step = Estimator(vehicle).step(0.0, STILL, None, np.zeros(len(vehicle.jets)))
    assert np.isnan(step.estimate[9])
    assert np.isfinite(step.estimate[:9]).all()
    with pytest.raises(ValueError, match="vehicle 'toy' has no accelerometer, which the filters of the thesis need"):
        Estimator(vehicle, load_scenario("sample_maneuver", ["estimation.filter=thesis"]))


def test_missing_readings_and_commands_are_skipped_and_buffers_read_at_once(sample_run: Run) -> None:
    """A reading that is missing costs the two increments that it bounds, and nothing else."""
    used, mass_used = (sample_run[f"{name}_used"][:, 0] != 0.0 for name in ("rotation", "mass"))
    no_gyro = next(k for k in range(1, used.size - 1) if used[k] and used[k + 1])
    no_velocity = next(k for k in range(no_gyro + 5, used.size - 1) if mass_used[k] and mass_used[k + 1])
    no_command = next(k for k in range(no_velocity + 5, used.size - 1) if used[k] and used[k + 1])
    dut, steps = Estimator(sample_run.scenario.vehicle_data, sample_run.scenario), []
    gyro, velocity, command = np.empty(3), np.empty(3), np.empty(44)
    for sample, time_s in enumerate(sample_run.time_s[: no_command + 5]):
        gyro[:] = np.nan if sample == no_gyro else sample_run["gyro"][sample]
        velocity[:] = np.nan if sample == no_velocity else sample_run["acc2"][sample]
        command[:] = np.nan if sample == no_command - 1 else sample_run["command"][sample]
        steps.append(dut.step(time_s, gyro, velocity, command))
        for buffer in (gyro, velocity, command):
            buffer[:] = np.nan
        assert np.isfinite([*steps[-1].estimate, *steps[-1].standard_deviation]).all()
    count = len(steps)
    lost = [k for k, step in enumerate(steps) if used[k] and not step.used]
    assert lost == [no_gyro, no_gyro + 1, *(k for k in (no_command, no_command + 1) if used[k])]
    mass_lost = [k for k, step in enumerate(steps) if mass_used[k] and not step.mass_used]
    assert set(mass_lost) >= {no_gyro, no_gyro + 1, no_velocity, no_velocity + 1} & set(np.flatnonzero(mass_used))
    for sample in (no_gyro, no_gyro + 1):
        assert np.isnan([steps[sample].rotation_nis, steps[sample].mass_nis]).all()
        np.testing.assert_array_equal(steps[sample].estimate, steps[no_gyro - 1].estimate)
    assert steps[no_velocity].used == used[no_velocity]  # the gyro was there
    kept = steps[-1].estimate.copy()
    steps[-1].estimate[:] = 7.0  # a caller may do as they like with their copy
    again = dut.step(sample_run.time_s[count], STILL * np.nan, STILL * np.nan, OFF)
    np.testing.assert_array_equal(again.estimate, kept)


# --------------------------------------------------------------------------------- copies of what users hold

COPIES = {"pickle": lambda held: pickle.loads(pickle.dumps(held)), "deepcopy": copy.deepcopy, "copy": copy.copy}


@pytest.mark.parametrize("way", COPIES)
def test_vehicle_scenario_and_run_can_be_copied(short_run: Run, way: str) -> None:
    scenario, run = (COPIES[way](one) for one in (short_run.scenario, short_run))
    assert scenario == short_run.scenario
    assert COPIES[way](scenario.vehicle_data) == scenario.vehicle_data
    assert (run.summary, run.units) == (short_run.summary, short_run.units)
    np.testing.assert_array_equal(run["estimate"], short_run["estimate"])
