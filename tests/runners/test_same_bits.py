"""One table of flights through every runner: loop, diagram, record, replay diagram and estimator agree bit for bit.

The estimator is cut in the middle and goes on from its state as JSON has it, and as copies of it.
"""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pose_probe import again
from replay_probe import replayed
from vehicle_flights import quick, small_pulses, step

from massprop_drake import Estimator, Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.inputs.scenario import bundled_scenarios, resolve_scenario
from massprop_drake.inputs.vehicle_parts import Disturbance
from massprop_drake.inputs.vehicle_sensors import PoseSensor
from massprop_drake.runners.recorded import estimation_settings

NEAR = "estimation={filter: thesis, start: nominal, std_fraction: 0.001}"
JOINT_NEAR = (
    "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
    "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
)
TURN = "maneuver=[{controller: rhc, axis: +x, start_s: 0.2, end_s: 0.8}]"
STUCK = ("stuck_on_29", "duration_s=2.4", TURN, "failures=[{kind: stuck_on, jet: R4R, start_s: 1}]", NEAR)
DOCK = "jumps=[{kind: dock, time_s: 1, mass: 5, position: [0.1, 0.2, -0.1], "
DOCK += "inertia: [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]}]"
ERRORS = "sensors.errors=[{sensor: gyro, bias_random_walk: 1.0e-7, noise_std: 2.0e-6, vibration: [{frequency_hz: 9, "
ERRORS += "amplitude: [1.0e-4, 0, 0]}]}, {sensor: acc2, noise_std: 0.01, bias: [1.0e-3, 0, 0], delay_samples: 1}]"


def _two_gyros(combine: str, *overrides: str) -> Scenario:
    """The sample maneuver with a second, coarser gyro."""
    near = ("estimation.start=nominal", "estimation.std_fraction=0.001")
    given = ["duration_s=4", f"sensors.combine={combine}", *near, *overrides]
    data = load_scenario("sample_maneuver", given).model_dump(mode="json")
    vehicle = load_scenario("sample_maneuver").vehicle_data.model_dump(mode="json")
    vehicle["gyros"].append({**vehicle["gyros"][0], "name": "gyro2", "quantum": 3e-6})
    return resolve_scenario({**data, "vehicle": vehicle})


def _given_start() -> Scenario:
    """A start with a covariance of its own."""
    nominal = load_scenario("sample_maneuver").vehicle_data.nominal.vector()
    deviation = 0.05 * np.abs(nominal) + np.array([0.0] * 3 + [1e-9] * 3 + [0.1] * 3 + [0.0])
    covariance = np.diag(deviation**2)
    covariance[0, 6] = covariance[6, 0] = 0.3 * deviation[0] * deviation[6]
    data = load_scenario("sample_maneuver", ["duration_s=3"]).model_dump(mode="json")
    data["estimation"] |= {"start": "given", "given": {"covariance": covariance.tolist()}}
    return resolve_scenario(data)


def _stated_disturbance() -> Scenario:
    vehicle = quick("small_satellite", "hydrazine")
    stated = Disturbance(torque_std=0.005, force_std=0.01, time_constant_s=30.0)
    plant = {"disturbance": {"torque_std": [0.005] * 3, "force_std": [0.01] * 3, "correlation_time_s": 30.0}}
    return small_pulses(5.0, again(vehicle, disturbance=stated), plant=plant, detector={"kind": "off"})


def _tracked() -> Scenario:
    vehicle = again(quick("small_satellite", "hydrazine"), poses=(PoseSensor(name="st", attitude_std=5e-5),))
    return small_pulses(5.0, vehicle, detector={"kind": "off"})


_THRUST = ("plant.thrust_dispersion=0.01", "estimation.thrust_uncertainty=0.01")
FLIGHTS: dict[str, tuple[str, ...] | Callable[[], Scenario]] = {
    "thesis": ("sample_maneuver", "duration_s=4"),
    "serial": lambda: _two_gyros("{gyros: serial, accelerometers: serial}", *_THRUST),
    "averages": lambda: _two_gyros("{gyros: average, accelerometers: weighted_average, correlated: true}"),
    "middle": lambda: _two_gyros("{gyros: most_accurate, accelerometers: mid_value}"),
    "given": _given_start,
    "others": (
        "sample_maneuver",
        "duration_s=5",
        "rotation={filter: extended, coupling: subtract, jump: none, disturbance_std: 1e-7}",
        "mass={compensation: transverse_centripetal, process_noise_std: 1e-8}",
        "estimation={start: nominal, thrust_transient: gate_lag}",
        "plant.thrust_transient=vehicle",
        "sensors.accelerometer=acc3",
    ),
    "noisy": ("sample_maneuver", "duration_s=4", "plant.thrust_transient=vehicle", ERRORS),
    "scheduled": ("jet_pulses", "duration_s=3"),
    "autopilot of on-times": (
        "sample_maneuver",
        "duration_s=4",
        "vehicle.jet_kinds.primary.minimum_on_time_s=0.02",
        "vehicle.jet_kinds.primary.on_time_quantum_s=0.004",
        "vehicle.jet_commands={as: on_time, at: center}",
        "autopilot.jet_selection.output=on_time",
    ),
    "stuck": STUCK,
    "acted upon": (*STUCK, "detector.close_manifold=true", "autopilot.mass_properties=estimated"),
    "release": ("payload_release", "duration_s=3", "jumps[0].time_s=2", TURN, NEAR),
    "docking": ("free_flyer_maneuver", "duration_s=3", DOCK),
    "cusum": ("sample_maneuver", "duration_s=3", "detector={kind: cusum}"),
    "joint": ("orbiter_maneuver", "duration_s=5.6"),
    "joint, acted upon": ("orbiter_maneuver", "duration_s=2.4", *JOINT_NEAR, "autopilot.mass_properties=estimated"),
    "hypotheses": (
        "leak_named",
        "duration_s=3.2",
        *JOINT_NEAR,
        "failures=[{kind: leak, jet: L4D, start_s: 2, force: 60}]",
    ),
    "pose": ("air_bearing_pulses", "duration_s=1.6"),
    "pose, docking": ("air_bearing_pulses", "duration_s=2", DOCK.replace("0.2, -0.1], ", "0.05, 0.3], ")),
    "on-times": lambda: small_pulses(3.0, failures=[{"kind": "leak", "jet": "ZP1", "start_s": 2.03, "force": 1.0}]),
    "disturbance": _stated_disturbance,
    "star tracker": _tracked,
    "engine": ("lander_burn", "duration_s=2"),
    "wheels": ("servicer_on_wheels_leak", "duration_s=2"),
}
# what has failed is named later than there is time for here
UNSEEN = {"engine", "on-times", "pose", "pose, docking", "wheels"}
COPIES = (copy.copy, copy.deepcopy, lambda held: pickle.loads(pickle.dumps(held)))


def made(name: str, engine: str) -> Scenario:
    """A flight of the table, for an engine."""
    flight = FLIGHTS[name]
    scenario = flight() if callable(flight) else load_scenario(flight[0], list(flight[1:]))
    return scenario.model_copy(update={"execution": scenario.execution.model_copy(update={"engine": engine})})


def require_same(one: Run, other: Run) -> None:
    """Requires the same bits: every signal, the summary, the saved state."""
    assert list(one.signals) == list(other.signals)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    first, second = ({**run.summary, "timing": None, "provenance": None} for run in (one, other))
    assert first == second
    assert one.state == other.state


def require_same_step(dut: Estimator, run: Run, row: int) -> tuple[bytes, str]:
    """Requires the run's answers of a row; the wrench of failures that is taken as known, and what is declared."""
    found = step(dut, run, row)
    for part, signal in (("estimate", "estimate"), ("standard_deviation", "standard_deviation"), ("alarm", "alarm"),
                         ("rotation_nis", "rotation_nis"), ("mass_nis", "mass_nis")):  # fmt: skip
        if signal in run.signals:
            value = np.array(getattr(found, part))
            np.testing.assert_array_equal(value, run[signal][row].reshape(value.shape), err_msg=f"{part}, row {row}")
    assert found.used == bool(run["rotation_used"][row, 0])
    return found.known_wrench.tobytes(), repr(found.detection)


@pytest.mark.parametrize("name", FLIGHTS)
def test_every_runner_gives_the_same_bits(name: str, tmp_path: Path) -> None:
    run = simulate(made(name, "loop"), look_back=False)
    require_same(run, simulate(made(name, "diagram"), look_back=False))
    assert run["rotation_used"].any() or name == "autopilot of on-times"  # whose commands are hardly ever steady
    assert run.summary["detections"] or not run.scenario.failures or name in UNSEEN

    telemetry = run.save(tmp_path / "run", pictures=False, report=False) / "telemetry.csv"
    found = estimate(telemetry, load_scenario(tmp_path / "run"))
    second = replayed(telemetry, estimation_settings(run.scenario))
    assert {"estimate", "standard_deviation", "rotation_nis"} <= set(second.signals)
    for signal, expected in second.signals.items():
        np.testing.assert_array_equal(found[signal], expected, err_msg=signal)
        # a record does not have the last command, which acts at once where the delay may be negative
        np.testing.assert_array_equal(run[signal][:-1], expected[:-1], err_msg=signal)
    np.testing.assert_array_equal(found.covariance, second.covariance)
    assert found.state is not None
    assert found.state["states"] == second.states
    assert found.state["row"] == run.state["row"] == run.time_s.size - 1
    assert found.summary["detections"] == run.summary["detections"]
    assert found.summary["autopilot"]["firings"] == run.summary["autopilot"]["firings"]

    dut, rows = Estimator(run.scenario.vehicle_data, run.scenario), run.time_s.size
    began = np.flatnonzero(run["tested"]) if "tested" in run.signals else np.zeros(0)
    cut = min(int(began[0]) + 5, rows - 8) if began.size else rows // 2  # a joint filter's start is gone over whole
    if name == "acted upon":  # what has been said is not said again
        cut = int(np.searchsorted(run.time_s, run.results.detections[0].time_s)) + 1
    for row in range(cut):
        require_same_step(dut, run, row)
    state = dut.state
    text = json.dumps(state, allow_nan=False)
    others = [make(dut) for make in COPIES]
    others.append(Estimator(run.scenario.vehicle_data, run.scenario))
    others[-1].restore(json.loads(text))
    for row in range(cut, rows):
        known = require_same_step(dut, run, row)
        for other in others if row < cut + 8 else others[-1:]:
            assert require_same_step(other, run, row) == known
    assert json.dumps(state) == text  # what was kept does not change with the estimator
    np.testing.assert_array_equal(dut.covariance, run.covariance)
    np.testing.assert_array_equal(others[-1].covariance, run.covariance)


def first_second(name: str) -> str:
    """Content of a bundled scenario's first second, without its name and what comes later."""
    scenario = load_scenario(name)
    data = scenario.model_dump(mode="json", exclude={"name", "description", "duration_s", "seed"})
    for field in ("failures", "jumps", "maneuver"):
        data[field] = [one for one in data[field] if one.get("start_s", one.get("time_s")) < 1.0]
    return json.dumps([scenario.vehicle_data.name, data | {"vehicle": None}])


RIGID = [name for name in bundled_scenarios() if load_scenario(name).plant.kind == "rigid"]
FLOWN = {first_second(flight[0]) for flight in FLIGHTS.values() if isinstance(flight, tuple)}
OTHERS = {first_second(name): name for name in RIGID}  # one of those that begin alike


@pytest.mark.parametrize("name", [name for begins, name in OTHERS.items() if begins not in FLOWN])
def test_every_bundled_scenario_gives_the_diagrams_bits(name: str) -> None:
    cases = [load_scenario(name, ["duration_s=1", f"execution.engine={engine}"]) for engine in ("diagram", "loop")]
    require_same(*(simulate(case, look_back=False) for case in cases))
