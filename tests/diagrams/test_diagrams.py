"""The diagrams: what they export, how they are timed, and that they can be built into others."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from systems_probe import feedthrough, inputs, outputs

from massprop_drake import Estimator, InputError, Run, Scenario, Vehicle, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation, open_loop, replay, vehicle
from massprop_drake.inputs.scenario import bundled_scenarios, resolve_scenario
from massprop_drake.systems.layouts import MASS_REPORT, ROTATION_REPORT

SENSORS = ("gyro", "acc1", "acc2", "acc3")
FEW = ["sample_maneuver", "small_satellite_leak", "servicer_slosh", "air_bearing_pulses", "lander_burn"]
EVERY = [name for name in bundled_scenarios() if name != "servicer_on_wheels_leak"]  # see tests/runners/test_on_wheels
MODULES = (vehicle, autopilot, estimation, closed_loop, open_loop, replay)
BUILT = {module: EVERY if module in (closed_loop, estimation) else FEW for module in MODULES}


@pytest.mark.parametrize(("module", "name"), [(module, name) for module, names in BUILT.items() for name in names])
def test_every_diagram_is_built_for_every_scenario(module: ModuleType, name: str) -> None:
    """With the ports that are documented: sizes are those of the systems, names stand in the pictures as well."""
    jointed = load_scenario(name).plant.kind == "multibody"  # always continuous
    scenario = load_scenario(name, [] if jointed or len(name) % 2 else ["plant.time_step=0"])
    if module is closed_loop and not scenario.vehicle_data.gyros:
        with pytest.raises(InputError, match=r"has no gyro, which an autopilot flies by; prescribe its jets"):
            module.build(scenario)
        return
    before = scenario.model_copy(deep=True)
    dut = module.build(scenario)
    assert dut.get_name() == module.__name__.rpartition(".")[2]
    assert scenario == before  # build reads its configuration and never changes it
    if module in (vehicle, autopilot, estimation):
        data, text = scenario.vehicle_data, module.build.__doc__ or ""
        own = {*data.sensor_names(), *(sensor.name for sensor in data.tracked), *(wheel.name for wheel in data.wheels)}
        assert [port for port in inputs(dut) | outputs(dut) if port not in own and port not in text] == []


def test_the_closed_loop_exports_few_ports_and_nothing_idle() -> None:
    """Connected inside, logged, or told to those who build diagrams."""
    overrides = ["detector.close_manifold=true", "autopilot.mass_properties=estimated"]
    dut = closed_loop.build(load_scenario("sample_maneuver", overrides))
    read = {(system.get_name(), int(port)) for system, port in dut.connection_map().values()}
    idle = set()
    for name in outputs(dut):
        part, index = dut.get_output_port_locator(dut.GetOutputPort(name).get_index())
        idle |= set() if (part.get_name(), int(index)) in read else {name}
    assert len(outputs(dut)) <= 30
    innovations = {f"{name}_innovation{part}" for name in ("rotation", "mass") for part in ("", "_covariance")}
    assert {"mass_properties", "standard_deviation", "covariance", *innovations} <= idle  # for those alone


def test_no_sensor_may_take_the_name_of_a_port_or_a_part(sample_maneuver: Scenario) -> None:
    """Two ports or parts of one name cannot be built; the history file uses `file` and `_...` itself."""
    taken = {system.get_name() for system in vehicle.build(sample_maneuver).GetSystems()}
    built = [module.build(load_scenario("sample_maneuver", ["estimation.filter=thesis"])) for module in MODULES]
    taken |= {"file", "_description"}.union(*map(outputs, built), inputs(built[2]))
    data = sample_maneuver.vehicle_data.model_dump(mode="json")
    for name in sorted((taken | {"joint_report"}) - set(SENSORS)):
        data["gyros"][0]["name"] = name
        with pytest.raises(ValueError, match="name"):
            Vehicle.model_validate(data)


def test_what_depends_on_what_at_once(sample_maneuver: Scenario) -> None:
    """Sensors read the body before the command of the same sample, the autopilot answers a reading at once."""
    of_vehicle = feedthrough(vehicle.build(sample_maneuver))
    assert of_vehicle.pop("thrust") == {"command", "held_command", "closed", "held_closed"}
    assert set().union(*of_vehicle.values()) == set()
    pilot = autopilot.build(sample_maneuver)
    of_pilot = feedthrough(pilot)
    assert of_pilot["command"] == set(inputs(pilot))
    for name in ("held_command", "selection_counts", "hand_controllers"):
        assert of_pilot[name] == set()
    # through the detector either filter's update depends on all sensors: where acc2 is missing, others are used
    of_estimation, known = feedthrough(estimation.build(sample_maneuver)), {"jet_commands", "outside_wrench"}
    for name in ("estimate", "covariance", "rotation_report", "mass_report", "reconfiguration", "detector_report"):
        assert of_estimation[name] == {*SENSORS, *known}, name
    for name, on in (("rotation_innovation", {"gyro"}), ("mass_innovation", set(SENSORS)), ("impulses", set())):
        assert of_estimation[name] == on | known
    assert of_estimation["held_closed"] == set()


# ------------------------------------------------------------------------------------------- timing


@pytest.fixture(scope="module", params=["null", "0"], ids=["stepped", "continuous"])
def flown(request: pytest.FixtureRequest) -> Run:
    """The maneuver's first rotations in closed loop, with either plant."""
    overrides = ["duration_s=12", f"plant.time_step={request.param}"]
    return simulate(load_scenario("sample_maneuver", overrides), look_back=False)


def test_the_hand_controllers_act_at_their_sample(flown: Run) -> None:
    # the window opens at 1 s, between samples 12 and 13, and closes at 3 s, between samples 37 and 38
    out = np.flatnonzero(flown["hand_controllers"][:60, 0])
    assert (out[0], out[-1]) == (13, 37)
    assert np.flatnonzero(flown["request"][:, 7])[0] == 13
    assert np.flatnonzero(flown["command"].any(axis=1))[0] == 13


def test_a_command_acts_from_its_sample_to_the_next(flown: Run) -> None:
    """No sample of delay: the rate at t_k+1 answers the command chosen at t_k."""
    assert not flown["rate"][:14].any()
    assert flown["rate"][14].any()
    # all along: I dw = (M - w x I w) T with the torque of row k and the mean of the rates k and k + 1. Where
    # the rate grows in proportion to time, the mean errs by (dw x I dw) T / 12 at most: for 5e-3 rad/s below
    # 2e-7 rad/s, where increments are 1e-3
    inertia = flown.scenario.vehicle_data.nominal.inertia
    rate = flown["rate"]
    mean = 0.5 * (rate[1:] + rate[:-1])
    torque = flown["torque"][:-1] - np.cross(mean, mean @ inertia)
    expected = np.linalg.solve(inertia, torque.T).T * 0.08
    increments = np.diff(rate, axis=0)
    assert np.abs(increments).max() > 5e-4
    assert np.abs(increments).max() < 5e-3
    np.testing.assert_allclose(increments, expected, rtol=0.0, atol=2e-7)


def test_the_logged_torque_is_that_of_the_logged_command(flown: Run) -> None:
    vehicle_data = flown.scenario.vehicle_data
    wrench = flown["command"] @ vehicle_data.wrenches  # thrust is instantaneous here
    np.testing.assert_allclose(flown["force"], wrench[:, 3:], rtol=1e-12, atol=1e-9)
    torque = wrench[:, :3] - np.cross(vehicle_data.nominal.center_of_mass, wrench[:, 3:])
    np.testing.assert_allclose(flown["torque"], torque, rtol=1e-12, atol=1e-6)


def test_the_estimators_use_the_command_of_the_interval_that_ended(flown: Run) -> None:
    wrenches = flown.scenario.vehicle_data.wrenches
    acted = np.vstack([np.zeros((1, 44)), flown["command"][:-1]])  # over [t_k-1, t_k)
    np.testing.assert_allclose(flown["angular_impulse"], acted @ wrenches[:, :3] * 0.08, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(flown["linear_impulse"], acted @ wrenches[:, 3:] * 0.08, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(flown["firing"][:, 0], acted.any(axis=1))
    before = np.vstack([np.zeros((1, 44)), acted[:-1]])
    np.testing.assert_array_equal(flown["usable"][:, 0], (acted == before).all(axis=1))
    assert flown["firing"].any()


def test_the_filter_consumes_the_readings_that_are_logged_of_sensors_that_are_noisy_each_by_itself(
    noisy_run: Run,
) -> None:
    """With noise, random walk, bias, bandwidth and delay on, the logged readings give the run's estimates."""
    scenario = noisy_run.scenario
    dut = Estimator(scenario.vehicle_data, scenario)
    samples = zip(noisy_run.time_s, noisy_run["gyro"], noisy_run["acc2"], noisy_run["command"], strict=True)
    steps = [dut.step(*sample) for sample in samples]
    for name in ("estimate", "standard_deviation"):
        found = [getattr(step, name) for step in steps]
        np.testing.assert_allclose(found, noisy_run[name], rtol=1e-12, atol=0.0)
    assert noisy_run["rotation_used"].sum() > 20
    # there is noise to get wrong: 2e-6 rad/s beyond the quantum
    assert np.std(noisy_run["gyro"] - noisy_run["rate"]) > 1.5e-6
    fewer = scenario.sensors.model_copy(update={"errors": scenario.sensors.errors[1:]})
    run = simulate(scenario.model_copy(update={"sensors": fewer, "duration_s": 1.0}), look_back=False)
    assert not run["command"].any()  # before anything fires both runs see the same body
    for name, same in (("acc1", True), ("acc2", True), ("gyro", False)):
        assert np.array_equal(run[name], noisy_run[name][: len(run.time_s)]) == same


# ------------------------------------------------------------------------------- inside a larger one


@pytest.mark.parametrize("rule", ["single", "serial"])
def test_the_replay_diagram_serves_in_a_users_own_and_agrees_with_the_estimator(short_run: Run, rule: str) -> None:
    """Missing readings, unknown commands and a known outside wrench, with thrust errors considered."""
    data = short_run.scenario.model_dump(mode="json")
    data["estimation"] |= {"start": "nominal", "thrust_uncertainty": 0.01, "thrust_transient": "gate_lag"}
    data["sensors"]["combine"] = {"gyros": rule, "accelerometers": rule}
    scenario, rng, count = resolve_scenario(data), np.random.default_rng(1), short_run.time_s.size
    readings = {name: short_run[name].copy() for name in SENSORS}
    for table in readings.values():
        table[rng.random(count) < 0.15] = np.nan
        table[rng.random(count) < 0.05, 1] = np.nan
    command = short_run["command"].copy()
    command[rng.random(count) < 0.1, 3] = np.nan
    outside = np.where(rng.random((count, 1)) < 0.3, rng.normal(size=(count, 6)) * 100.0, 0.0)

    dut, steps = Estimator(scenario.vehicle_data, scenario), []
    for row, time_s in enumerate(short_run.time_s):
        accelerometers = {name: readings[name][row] for name in ("acc1", "acc2", "acc3")}
        steps.append(dut.step(time_s, readings["gyro"][row], accelerometers, command[row], outside[row]))

    builder = DiagramBuilder()
    record = builder.AddNamedSystem("mine", replay.build(scenario))
    names = ("estimate", "standard_deviation", "rotation_report", "mass_report")
    sinks = {name: LogVectorOutput(record.GetOutputPort(name), builder, 0.08) for name in names}
    simulator, source = Simulator(builder.Build()), record.GetSubsystemByName("telemetry_source")
    served = source.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    source.extend(served, short_run.time_s, readings, command, outside)
    simulator.AdvanceTo(short_run.time_s[-1])
    logs = {name: sink.FindLog(simulator.get_context()).data().T for name, sink in sinks.items()}
    rotation, mass = ROTATION_REPORT.columns(logs["rotation_report"]), MASS_REPORT.columns(logs["mass_report"])
    for name, found in (
        *((name, logs[name]) for name in ("estimate", "standard_deviation")),
        *(("rotation_nis", rotation["rotation_nis"][:, 0]), ("used", rotation["rotation_used"][:, 0])),
        *(("mass_nis", mass["mass_nis"][:, 0]), ("mass_used", mass["mass_used"][:, 0])),
    ):
        np.testing.assert_array_equal([getattr(step, name) for step in steps], found)
    assert np.isfinite(logs["estimate"]).all()
    assert rotation["rotation_used"].sum() > 5
    assert np.isnan(rotation["rotation_nis"]).sum() > 5
