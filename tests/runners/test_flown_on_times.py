"""An autopilot that flies on-times: in both engines, from a record, and against whole cycles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import InputError, Run, Scenario, estimate, load_scenario, load_vehicle, simulate
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import JetCommands

PERIOD_S, CLOCK_S, MINIMUM_S = 0.1, 0.001, 0.01
SETTINGS = {"hold_rate_limit": 0.0035, "capture_rate": 0.0035, "acceleration": 0.006, "horizon_s": 1.0}


def vehicle(**changed: Any) -> Vehicle:
    """The small satellite with valves that can be open for 10 ms, in steps of 1 ms."""
    stated = load_vehicle("small_satellite")
    valve = {"minimum_on_time_s": MINIMUM_S, "on_time_quantum_s": CLOCK_S, **changed}
    return again(stated, jet_kinds={"hydrazine": stated.jet_kinds["hydrazine"].model_copy(update=valve)})


def flight(output: str = "on_time", deadband: float = 0.0005, **more: Any) -> Scenario:
    own = {"name": "on_times", "vehicle": vehicle(), "duration_s": 4.5, "seed": 4, "detector": {"kind": "off"}}
    turns = [{"controller": "rhc", "axis": "+x", "start_s": 0.5, "end_s": 1.5}]
    moves = [{"controller": "thc", "axis": "+y", "start_s": 2.0, "end_s": 3.5}]
    pilot = {**SETTINGS, "rate_deadband": deadband, "jet_selection": {"output": output}}
    return resolved(own | {"maneuver": turns + moves, "autopilot": pilot, "execution": {"engine": "loop"}} | more)


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(flight())


def test_pulses_are_whole_steps_of_the_clock_and_long_enough(flown: Run) -> None:
    lasts_s = flown["command"] * PERIOD_S
    steps = lasts_s / CLOCK_S
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    opened = (lasts_s > 0.0) & np.vstack((np.ones(lasts_s.shape[1], dtype=bool), flown["command"][:-1] < 1.0))
    assert lasts_s[opened].min() >= MINIMUM_S - 1e-9
    assert ((lasts_s > 0.0) & (lasts_s < PERIOD_S)).sum() > 10


def test_diagram_and_loop_fly_alike(flown: Run) -> None:
    other = simulate(flight(execution={"engine": "diagram"}))
    for name, expected in flown.signals.items():
        np.testing.assert_allclose(other[name], expected, rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("place", ["start", "center"])
def test_a_record_gives_the_estimates_again(place: str, tmp_path: Path) -> None:
    stated = again(vehicle(), jet_commands=JetCommands(at=place))
    run = simulate(flight(vehicle=stated, duration_s=3.0))
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    lines = [line.split(",") for line in (folder / "telemetry.csv").read_text(encoding="utf-8").splitlines()]
    kept = [column for column, name in enumerate(lines[0]) if not name.startswith("onset_")]
    path = tmp_path / "log.csv"
    path.write_text("".join(",".join(line[column] for column in kept) + "\n" for line in lines), encoding="utf-8")
    for source in (path, folder / "telemetry.csv"):
        found = estimate(source, load_scenario(folder))
        np.testing.assert_allclose(found["estimate"][:-1], run["estimate"][:-1], rtol=1e-9, atol=1e-15)


def test_attitude_is_held_better_and_for_less_propellant_than_by_whole_cycles() -> None:
    pushed = {"plant": {"disturbance": {"torque": [0.01, -0.006, 0.008]}}, "maneuver": [], "duration_s": 25.0}
    pushed |= {"estimation": {"filter": "thesis"}}  # the quickest, whose estimates nothing here asks for
    rms, used = {}, {}
    for output in ("cycles", "on_time"):
        run = simulate(flight(output, **pushed))
        held, mass = run["attitude_error"][80:], 1.0 / run["truth"][:, 9]
        rms[output], used[output] = float(np.sqrt(np.mean(held**2))), mass[80] - mass[-1]
    assert rms["on_time"] < 0.5 * rms["cycles"]
    assert used["on_time"] < 0.5 * used["cycles"]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"minimum_on_time_s": 0.1}, "on_time does not go with vehicle 'small_satellite', whose commands of jets are"),
        ({"on_time_quantum_s": 0.2}, "whose on_time_quantum_s of 0.2 s is longer than a sample, 0.1 s"),
    ],
)
def test_jets_that_cannot_are_said(changed: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        flight(vehicle=vehicle(**changed))
