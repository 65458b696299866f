"""Jets that open and close within samples: in the simulators, from a record, step by step, and when one fails."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again
from replay_probe import replayed

from massprop_drake import Estimator, Run, Scenario, estimate, load_scenario, load_vehicle, simulate
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import JetCommands
from massprop_drake.runners.recorded import settings_alone

PERIOD_S = 0.1
LEAK = {"kind": "leak", "jet": "ZP1", "start_s": 14.03, "force": 0.25}


def quick(name: str, kind: str, **changed: Any) -> Vehicle:
    """A bundled vehicle whose valves can be open for 10 ms."""
    vehicle = load_vehicle(name)
    valve = {"minimum_on_time_s": 0.01, "thrust_uncertainty": 0.01, **changed}
    return again(vehicle, jet_kinds={kind: vehicle.jet_kinds[kind].model_copy(update=valve)})


def pulses(vehicle: Vehicle, until_s: float, seed: int = 0) -> list[dict[str, Any]]:
    """Pulses of 10 to 90 ms, some longer, from a sample's beginning on or within it."""
    random, told, time_s = np.random.default_rng(seed), list[dict[str, Any]](), 0.5
    while time_s < until_s - 1.0:
        for jet in random.choice(vehicle.designations, 2, replace=False):
            start_s = time_s + (0.0 if random.random() < 0.5 else random.uniform(0.0, 0.05))
            length_s = random.uniform(0.01, 0.09) if random.random() < 0.7 else random.uniform(0.1, 0.4)
            told.append({"jet": str(jet), "start_s": float(start_s), "end_s": float(start_s + length_s)})
        time_s += 0.6
    return told


def flight(**more: Any) -> Scenario:
    vehicle = quick("small_satellite", "hydrazine")
    own = {"name": "pulses", "vehicle": vehicle, "duration_s": 20.0, "seed": 3, "joint": {"tank_fraction": 0}}
    drawn = {"plant": {"dispersion": {}, "thrust_dispersion": 0.01}, "jet_schedule": pulses(vehicle, 20.0)}
    return resolved(own | drawn | more)


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(flight(failures=[LEAK], execution={"engine": "loop"}))


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("pulses") / "run", pictures=False, report=False)


def test_every_pulse_gives_what_it_lasts() -> None:
    """Without lag the impulse is thrust times on-time, to the last digits, and so is what the body gains."""
    vehicle = quick("small_satellite", "hydrazine", time_constant_s=0.0)
    told = [("XP1", 0.5, 0.535), ("XP2", 0.5, 0.535), ("XN1", 1.02, 1.055), ("XN1", 1.5, 2.01)]
    schedule = [dict(zip(("jet", "start_s", "end_s"), one, strict=True)) for one in told]
    run = simulate(resolved({"vehicle": vehicle, "duration_s": 3.0, "jet_schedule": schedule}))
    thrust = {jet.designation: jet.thrust for jet in vehicle.jets}
    given = dict(zip(vehicle.designations, run["thrust"][:-1].sum(axis=0) * PERIOD_S, strict=True))
    for name in ("XP1", "XP2", "XN1"):
        lasts_s = sum(end_s - start_s for jet, start_s, end_s in told if jet == name)
        np.testing.assert_allclose(given[name], thrust[name] * lasts_s, rtol=1e-12)


def test_loop_and_diagram_give_the_same(flown: Run) -> None:
    other = simulate(flight(failures=[LEAK], execution={"engine": "diagram"}))
    for name, expected in flown.signals.items():
        np.testing.assert_allclose(other[name], expected, rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_continuous_plant_moves_alike(flown: Run) -> None:
    whole = flight(duration_s=4.0)
    plant = whole.plant.model_copy(update={"time_step": 0.0, "accuracy": 1e-9})
    other = simulate(whole.model_copy(update={"plant": plant}))
    stepped = simulate(whole)
    for name, least in (("rate", 1e-6), ("velocity", 1e-6)):
        np.testing.assert_allclose(other[name], stepped[name], atol=least)
        assert np.abs(stepped[name]).max() > 1000 * least


def test_a_record_gives_the_run_again(flown: Run, folder: Path) -> None:
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    second = replayed(folder / "telemetry.csv", settings_alone(flown.scenario))
    for name in ("estimate", "standard_deviation", "fault_probability", "alarm"):
        np.testing.assert_array_equal(found[name][:-1], flown[name][:-1], err_msg=name)
        if name in second.signals:
            np.testing.assert_array_equal(second.signals[name], found[name], err_msg=name)
    assert found.results.detections == flown.results.detections
    assert found.state["states"] == second.states


def test_an_estimator_and_one_that_is_restored_give_the_run_again(flown: Run) -> None:
    dut = Estimator(flown.scenario.vehicle_data, flown.scenario)
    for row in range(60):
        if row == 40:
            state, dut = dut.state, Estimator(flown.scenario.vehicle_data, flown.scenario)
            dut.restore(state)
        vehicle, told = flown.scenario.vehicle_data, flown["command"][row]
        rates, velocities = (
            {one.name: flown[one.name][row] for one in of} for of in (vehicle.gyros, vehicle.accelerometers)
        )
        step = dut.step(flown.time_s[row], rates, velocities, told, onsets_s=flown["command_onset"][row])
        np.testing.assert_array_equal(step.estimate, flown["estimate"][row])


def test_a_jet_must_open_and_close_within_its_sample(flown: Run) -> None:
    dut = Estimator(flown.scenario.vehicle_data, flown.scenario)
    half = np.full(len(flown.scenario.vehicle_data.jets), 0.5)
    with pytest.raises(ValueError, match=r"onsets_s: a jet must open and close within the sample period of 0\.1 s"):
        dut.step(0.0, None, None, half, onsets_s=np.full_like(half, 0.06))


def test_the_failed_jet_is_named_and_all_else_is_as_stated(flown: Run) -> None:
    (found,) = flown.summary["detections"]
    assert found["jet"] == "ZP1"
    assert found["time_s"] <= 15.0
    assert flown.summary["consistency"]["verdict"] == "consistent"
    error = flown["estimate"][-1] - flown["truth"][-1]
    assert np.abs(error / flown["standard_deviation"][-1]).max() < 4.0


def test_a_row_whose_commands_are_missing_costs_little(flown: Run, folder: Path, tmp_path: Path) -> None:
    lines = [line.split(",") for line in (folder / "telemetry.csv").read_text(encoding="utf-8").splitlines()]
    told = [column for column, name in enumerate(lines[0]) if name.startswith(("jet_", "onset_"))]
    for row in (61, 97, 120):
        lines[row] = ["" if column in told else cell for column, cell in enumerate(lines[row])]
    path = tmp_path / "log.csv"
    path.write_text("".join(",".join(line) + "\n" for line in lines), encoding="utf-8")
    found = estimate(path, load_scenario(folder))
    assert [one["jet"] for one in found.summary["detections"]] == ["ZP1"]
    off = found["estimate"][-1] - flown["estimate"][-1]
    assert (np.abs(off) < found["standard_deviation"][-1]).all()
    assert (found["standard_deviation"][-1] < 1.5 * flown["standard_deviation"][-1]).all()


def test_on_times_taken_for_levels_contradict_the_readings(flown: Run, folder: Path, tmp_path: Path) -> None:
    """Reads a log without onsets with a vehicle whose jets have levels."""
    lines = [line.split(",") for line in (folder / "telemetry.csv").read_text(encoding="utf-8").splitlines()]
    kept = [column for column, name in enumerate(lines[0]) if not name.startswith("onset_")]
    path = tmp_path / "log.csv"
    path.write_text("".join(",".join(line[column] for column in kept) + "\n" for line in lines), encoding="utf-8")
    levels = again(flown.scenario.vehicle_data, jet_commands=JetCommands.model_validate({"as": "level"}))
    scenario = settings_alone(flown.scenario).model_copy(update={"vehicle": levels})
    found = estimate(path, scenario)
    assert found.summary["consistency"]["verdict"] == "inconsistent"
    assert "command_onset" not in found.signals


def test_a_vehicle_that_is_followed_in_a_fixed_frame() -> None:
    vehicle = quick("tracked_flyer", "cold_gas", command_delay_s=0.0, command_delay_std_s=0.005)
    failure = {"kind": "stuck_off", "jet": "T5", "start_s": 12.0}
    drawn = {"plant": {"dispersion": {}, "thrust_dispersion": 0.01}, "jet_schedule": pulses(vehicle, 30.0, seed=2)}
    run = simulate(resolved({"vehicle": vehicle, "duration_s": 30.0, "seed": 2, "failures": [failure]} | drawn))
    assert [one["jet"] for one in run.summary["detections"]] == ["T5"]
    error = run["estimate"][-1] - run["truth"][-1]
    assert np.abs(error / run["standard_deviation"][-1]).max() < 4.0
