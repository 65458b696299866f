"""The diagrams: what they export, how they are timed, and that they can be built into others."""

from __future__ import annotations

import contextlib
import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPortIndex, LeafSystem, OutputPortIndex
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import Estimator, InputError, Run, Scenario, Vehicle, load_scenario, simulate
from massprop_drake.diagrams import autopilot, closed_loop, estimation, open_loop, replay, vehicle
from massprop_drake.display import graphs
from massprop_drake.inputs.scenario import bundled_scenarios, resolved
from massprop_drake.runners.logs import ESTIMATION
from massprop_drake.systems.layouts import MASS_REPORT, ROTATION_REPORT

Array = NDArray[np.float64]

SENSORS = {"gyro": 3, "acc1": 3, "acc2": 3, "acc3": 3}
VEHICLE_OUT = {**SENSORS, "body_state": 23, "structure": 9, "mass_properties": 10, "thrust": 44}
AUTOPILOT_OUT = {
    "command": 44,
    "held_command": 44,
    "hand_controllers": 6,
    "attitude_error": 3,
    "request": 8,
    "selection_counts": 4,
    "out_of_use": 44,
}
ESTIMATION_OUT = {
    "impulses": 8,
    "estimate": 10,
    "standard_deviation": 10,
    "covariance": 100,
    "converged": 1,
    "rotation_innovation": 3,
    "rotation_innovation_covariance": 9,
    "rotation_report": 28,
    "mass_innovation": 3,
    "mass_innovation_covariance": 9,
    "mass_report": 11,
    "reconfiguration": 7 + 44,
    "closed": 44,
    "held_closed": 44,
    "detector_report": 14 + 4 * 44,
}
PORTS_IN = {"command", "held_command", "closed", "held_closed"}
# the orbiter's ports as they are documented: inputs and outputs
PORTS: dict[ModuleType, tuple[dict[str, int], dict[str, int]]] = {
    vehicle: (dict.fromkeys(PORTS_IN, 44), VEHICLE_OUT),
    autopilot: (
        {"gyro": 3, "estimate": 10, "converged": 1, "reconfiguration": 7 + 44, "prescribed": 44},
        AUTOPILOT_OUT,
    ),
    estimation: ({"jet_commands": 44, "outside_wrench": 6, **SENSORS}, ESTIMATION_OUT),
    closed_loop: ({}, {**VEHICLE_OUT, **AUTOPILOT_OUT, **ESTIMATION_OUT}),
    open_loop: ({}, {**VEHICLE_OUT, "command": 44, "held_command": 44, **ESTIMATION_OUT}),
    replay: (
        {},
        {**SENSORS, "jet_commands": 44, "command": 44, "outside_wrench": 6, "record_time": 1, **ESTIMATION_OUT},
    ),
}

# with the joint filter, and with its detector
JOINT_IN = {"record_time": 1, "command": 44}
JOINT_OUT = {"joint_report": 3}
POSE_OUT = {"pose_report": 24 + 2 * 44}
THESIS_OUT = {f"{name}_innovation{part}" for name in ("rotation", "mass") for part in ("", "_covariance")}
DETECTOR_OUT = {"reconfiguration", "closed", "held_closed", "detector_report"}
HYPOTHESES_OUT = {"hypothesis_report": 24 + 12 * 44, "fault_probability": 44 + 2}


def _with_filter(
    module: ModuleType, ports: tuple[dict[str, int], dict[str, int]], scenario: Scenario
) -> tuple[dict[str, int], dict[str, int]]:
    """Ports of a diagram with the thesis's filters as they are with a scenario's own filter and detector."""
    inputs, outputs = ports
    if scenario.estimation.filter == "thesis" or "estimate" not in outputs:
        return ports
    detects = scenario.detector.kind != "off"
    gone = THESIS_OUT if detects else THESIS_OUT | DETECTOR_OUT
    kept = {port: size for port, size in outputs.items() if port not in gone}
    report = JOINT_OUT if scenario.estimation.filter == "joint" else POSE_OUT
    return (
        {**inputs, **JOINT_IN} if module is estimation else inputs,
        {**kept, **report, **(HYPOTHESES_OUT if detects else {})},
    )


def _ports_of(ports: dict[str, int], scenario: Scenario) -> dict[str, int]:
    """The orbiter's ports as another vehicle has them: its own sensors, and sizes by its number of jets."""
    vehicle, burns, replayed = scenario.vehicle_data, bool(scenario.engine_schedule), "record_time" in ports
    n = len(vehicle.jets)
    sizes = {44: n, 7 + 44: 7 + n, 14 + 4 * 44: 14 + 4 * n, 24 + 12 * 44: 24 + 12 * n, 24 + 2 * 44: 24 + 2 * n}
    sizes[44 + 2] = n + 2
    unlike = set() if vehicle.accelerometers or vehicle.needs_pose_filter else {"mass_report"}
    wheels = {"wheel_speeds"} if "body_state" in ports else set()  # out of the vehicle, and torques into it
    wheels |= {"wheel_torque"} if ports.keys() == PORTS_IN or {"body_state", "estimate"} <= ports.keys() else set()
    # the autopilot has one gyro port, whatever the package is called
    sensors = dict.fromkeys(vehicle.sensor_names(), 3) if "acc1" in ports else {"gyro": 3} if "gyro" in ports else {}
    if "acc1" in ports:
        there = (sensor for sensor in vehicle.tracked if burns or replayed or sensor not in vehicle.engines)
        sensors |= {sensor.name: len(sensor.columns) for sensor in there}
    sensors |= dict.fromkeys(wheels if vehicle.wheels else (), len(vehicle.wheels))
    if burns and wheels:  # the same ports as of wheels
        engines = {
            name.replace("wheel_torque", "engine_command").replace("wheel_speeds", "engine_state") for name in wheels
        }
        sensors |= dict.fromkeys(engines, 3 * len(vehicle.engines))
    return sensors | {name: sizes.get(size, size) for name, size in ports.items() if name not in {*SENSORS, *unlike}}


def _inputs(dut: Diagram) -> dict[str, int]:
    ports = [dut.get_input_port(InputPortIndex(index)) for index in range(dut.num_input_ports())]
    return {port.get_name(): port.size() for port in ports}


def _outputs(dut: Diagram) -> dict[str, int]:
    ports = [dut.get_output_port(OutputPortIndex(index)) for index in range(dut.num_output_ports())]
    return {port.get_name(): port.size() for port in ports}


def _depends_on(dut: Diagram, output: str) -> set[str]:
    """Inputs that an output depends on at once."""
    port = dut.GetOutputPort(output).get_index()
    return {name for name in _inputs(dut) if dut.HasDirectFeedthrough(dut.GetInputPort(name).get_index(), port)}


# -------------------------------------------------------------------------------------------- ports


# that of the servicer on wheels, with onsets and a tank besides, is in tests/runners/test_on_wheels.py
@pytest.mark.parametrize("name", [name for name in bundled_scenarios() if name != "servicer_on_wheels_leak"])
@pytest.mark.parametrize("module", list(PORTS), ids=lambda module: module.__name__.rpartition(".")[2])
@pytest.mark.parametrize("time_step", ["null", "0"], ids=["stepped", "continuous"])
def test_every_diagram_is_built_for_every_scenario_with_the_documented_ports(
    module: ModuleType, name: str, time_step: str
) -> None:
    jointed = load_scenario(name).plant.kind == "multibody"  # always continuous
    scenario = load_scenario(name, [] if jointed else [f"plant.time_step={time_step}"])
    if module is closed_loop and not scenario.vehicle_data.gyros:
        with pytest.raises(InputError, match=r"has no gyro, which an autopilot flies by; prescribe its jets"):
            module.build(scenario)
        return
    before = scenario.model_copy(deep=True)
    dut = module.build(scenario)
    inputs, outputs = _with_filter(module, PORTS[module], scenario)
    assert _inputs(dut) == _ports_of(inputs, scenario)
    joints = {"joint_positions": 2} if jointed and "body_state" in outputs else {}
    assert _outputs(dut) == _ports_of(outputs, scenario) | joints
    assert dut.get_name() == module.__name__.rpartition(".")[2]
    assert scenario == before  # build reads its configuration and never changes it


@pytest.mark.parametrize("module", list(PORTS), ids=lambda module: module.__name__.rpartition(".")[2])
def test_every_exported_port_is_documented(module: ModuleType) -> None:
    text = module.build.__doc__ or ""
    inputs, outputs = PORTS[module]
    if module in (closed_loop, open_loop, replay):
        assert "every output of the" in text  # of the diagrams that are documented themselves
        return
    if module is estimation:
        inputs, outputs = {**inputs, **JOINT_IN}, {**outputs, **JOINT_OUT, **HYPOTHESES_OUT}
    for name in {*inputs, *outputs} - set(SENSORS):
        assert name in text, name
    if module is not autopilot:
        assert "<gyro>" in text
        assert "<accelerometer>" in text


def _connected(dut: Diagram, output: str) -> bool:
    """Whether an exported output is read inside the diagram, at whatever depth."""
    part, index = dut.get_output_port_locator(dut.GetOutputPort(output).get_index())
    read = {(system.get_name(), int(port)) for system, port in dut.connection_map().values()}
    if (part.get_name(), int(index)) in read:
        return True
    return isinstance(part, Diagram) and _connected(part, part.get_output_port(index).get_name())


def test_the_closed_loop_exports_nothing_idle() -> None:
    """Connected inside, logged, or told to those who build diagrams; and few enough to look through."""
    overrides = ["detector.close_manifold=true", "autopilot.mass_properties=estimated"]
    dut = closed_loop.build(load_scenario("sample_maneuver", overrides))
    exported = set(_outputs(dut))
    assert len(exported) <= 30
    signals = {"body_state", "structure", "thrust", *AUTOPILOT_OUT, *ESTIMATION, *SENSORS}
    idle = {name for name in exported - signals if not _connected(dut, name)}
    text = "".join(module.build.__doc__ or "" for module in (vehicle, autopilot, estimation))
    assert {name for name in idle if not re.search(rf"\b{name} \(out, ", text)} == set()
    # for those who build diagrams alone; every other fact stands in a report
    assert idle == {
        "mass_properties",
        "standard_deviation",
        "covariance",
        *(f"{name}_innovation{part}" for name in ("rotation", "mass") for part in ("", "_covariance")),
    }


def test_no_sensor_may_take_the_name_of_a_port_or_a_part(sample_maneuver: Scenario) -> None:
    """Two ports or parts of one name cannot be built; the history file uses `file` and `_...` itself."""
    taken = {
        "file",
        "_description",
        *ESTIMATION_OUT,
        *JOINT_IN,
        *JOINT_OUT,
        *VEHICLE_OUT,
        *PORTS[estimation][0],
        *AUTOPILOT_OUT,
    }
    taken |= {system.get_name() for system in vehicle.build(sample_maneuver).GetSystems()}
    considerate = load_scenario("sample_maneuver", ["estimation.thrust_uncertainty=0.01"])
    for part in estimation.build(considerate).GetSystems():  # beside the sensors' ports
        taken |= {part.get_input_port(InputPortIndex(index)).get_name() for index in range(part.num_input_ports())}
    data = sample_maneuver.vehicle_data.model_dump(mode="json")
    accepted = []
    for name in sorted(taken - set(SENSORS)):
        data["gyros"][0]["name"] = name
        with contextlib.suppress(ValueError):
            accepted.append(Vehicle.model_validate(data).gyros[0].name)
    assert accepted == []


def test_sensors_read_the_body_before_the_command_of_the_same_sample(sample_maneuver: Scenario) -> None:
    dut = vehicle.build(sample_maneuver)
    for name in (*SENSORS, "body_state", "structure", "mass_properties"):
        assert _depends_on(dut, name) == set(), name
    assert _depends_on(dut, "thrust") == {"command", "held_command", "closed", "held_closed"}


def test_the_autopilot_answers_a_reading_at_once_and_holds_its_answer(sample_maneuver: Scenario) -> None:
    dut = autopilot.build(sample_maneuver)
    assert _depends_on(dut, "command") == {"gyro", "estimate", "converged", "reconfiguration", "prescribed"}
    assert _depends_on(dut, "held_command") == set()
    assert _depends_on(dut, "selection_counts") == set()
    assert _depends_on(dut, "hand_controllers") == set()


def test_estimates_at_a_sample_include_its_readings(sample_maneuver: Scenario) -> None:
    dut = estimation.build(sample_maneuver)
    # through the detector either filter's update depends on all sensors: where acc2 is missing, others are used
    known = {"jet_commands", "outside_wrench"}
    for name in ("estimate", "covariance", "rotation_report", "mass_report", "reconfiguration", "detector_report"):
        assert _depends_on(dut, name) == {*SENSORS, *known}, name
    assert _depends_on(dut, "rotation_innovation") == {"gyro", *known}
    assert _depends_on(dut, "mass_innovation") == {*SENSORS, *known}
    assert _depends_on(dut, "held_closed") == set()
    assert _depends_on(dut, "impulses") == known


# ------------------------------------------------------------------------------------------- timing


@pytest.fixture(scope="module", params=["null", "0"], ids=["stepped", "continuous"])
def flown(request: pytest.FixtureRequest) -> Run:
    """The maneuver's rotations in closed loop, with either plant."""
    return simulate(
        load_scenario("sample_maneuver", ["duration_s=24", f"plant.time_step={request.param}"]), look_back=False
    )


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


def test_the_innovation_is_that_of_the_interval_that_ended(flown: Run) -> None:
    """With a perfect estimate nothing would be left of it: judged with the truth and the same interval."""
    inertia = flown.scenario.vehicle_data.nominal.inertia
    truth = flown["truth"][0]
    increments = np.diff(flown["gyro"], axis=0)
    moment = flown["angular_impulse"] + np.cross(flown["linear_impulse"], truth[6:9])
    mean = 0.5 * (flown["gyro"][1:] + flown["gyro"][:-1])
    coupling = np.cross(mean, mean @ inertia) * 0.08
    left = increments - np.linalg.solve(inertia, (moment[1:] - coupling).T).T
    # two quantized readings of 1.52e-6 rad/s each err by at most a quantum together
    np.testing.assert_allclose(left, 0.0, atol=1.52e-6 * 1.01)
    # an interval earlier or later would leave whole increments
    assert np.abs(increments[1:] - np.linalg.solve(inertia, moment[1:-1].T).T).max() > 100 * 1.52e-6


def test_the_gyro_reads_the_body_of_its_row(flown: Run) -> None:
    np.testing.assert_allclose(flown["gyro"], flown["rate"], rtol=0.0, atol=0.5 * 1.52e-6 * (1 + 1e-9))


def test_estimates_of_a_row_include_its_readings(flown: Run) -> None:
    used = np.flatnonzero(flown["rotation_used"])
    assert used.size > 20
    changed = np.flatnonzero(np.diff(flown["estimate"][:, :9], axis=0).any(axis=1)) + 1
    np.testing.assert_array_equal(changed, used)


def test_jet_selection_by_the_estimates_flies_on_what_is_estimated() -> None:
    nominal = simulate(
        load_scenario("sample_maneuver_adaptive", ["autopilot.mass_properties=nominal"]), look_back=False
    )
    adaptive = simulate(load_scenario("sample_maneuver_adaptive"), look_back=False)
    converged = adaptive["converged"][:, 0] != 0.0
    first = int(np.flatnonzero(converged)[0])
    # until then both fly by the nominal mass properties
    np.testing.assert_array_equal(adaptive["command"][:first], nominal["command"][:first])
    np.testing.assert_array_equal(adaptive["estimate"][:first], nominal["estimate"][:first])
    assert not np.array_equal(adaptive["command"][first:], nominal["command"][first:])


# -------------------------------------------------------------------------------------------- noise


def test_the_filter_consumes_the_readings_that_are_logged(noisy_run: Run) -> None:
    """With noise, random walk, bias, bandwidth and delay on, the logged readings give the run's estimates."""
    dut = Estimator(noisy_run.scenario.vehicle_data, noisy_run.scenario)
    samples = zip(noisy_run.time_s, noisy_run["gyro"], noisy_run["acc2"], noisy_run["command"], strict=True)
    steps = [dut.step(*sample) for sample in samples]
    np.testing.assert_allclose([step.estimate for step in steps], noisy_run["estimate"], rtol=1e-12, atol=0.0)
    np.testing.assert_allclose(
        [step.standard_deviation for step in steps], noisy_run["standard_deviation"], rtol=1e-12, atol=0.0
    )
    np.testing.assert_array_equal([step.used for step in steps], noisy_run["rotation_used"][:, 0])
    assert noisy_run["rotation_used"].sum() > 20
    # there is noise to get wrong: 2e-6 rad/s beyond the quantum
    assert np.std(noisy_run["gyro"] - noisy_run["rate"]) > 1.5e-6


def test_errors_of_one_sensor_change_no_other(noisy_run: Run) -> None:
    """Noise is drawn per sensor: taking one's away leaves the others' as they were."""
    quiet = noisy_run.scenario.model_copy(
        update={
            "sensors": noisy_run.scenario.sensors.model_copy(update={"errors": noisy_run.scenario.sensors.errors[1:]})
        }
    )
    run = simulate(quiet, look_back=False)
    # before anything fires both runs see the same body
    still = slice(0, 13)
    assert not noisy_run["command"][still].any()
    assert not run["command"][still].any()
    np.testing.assert_array_equal(run["acc2"][still], noisy_run["acc2"][still])
    np.testing.assert_array_equal(run["acc1"][still], noisy_run["acc1"][still])
    assert not np.array_equal(run["gyro"][still], noisy_run["gyro"][still])


# ------------------------------------------------------------------------------- inside a larger one


class _Recording(LeafSystem):
    """A user's own source of readings and commands: row k from k T to (k + 1) T."""

    def __init__(self, tables: dict[str, Array], period_s: float):
        super().__init__()
        for name, table in tables.items():

            def calc(context: Any, output: Any, table: Array = table) -> None:
                output.SetFromVector(table[round(context.get_time() / period_s)])

            self.DeclareVectorOutputPort(name, table.shape[1], calc, prerequisites_of_calc={self.time_ticket()})


def test_the_estimation_diagram_serves_in_a_users_own_diagram(short_run: Run) -> None:
    builder = DiagramBuilder()
    ended = np.vstack([np.zeros((1, 44)), short_run["command"][:-1]])  # the command of the interval that ended
    tables = {"jet_commands": ended, **{name: short_run[name] for name in SENSORS}}
    recording = builder.AddNamedSystem("recording", _Recording(tables, 0.08))
    estimators = builder.AddNamedSystem("mine", estimation.build(short_run.scenario))
    for name in tables:
        builder.Connect(recording.GetOutputPort(name), estimators.GetInputPort(name))
    sinks = {
        name: LogVectorOutput(estimators.GetOutputPort(name), builder, 0.08)
        for name in ("estimate", "standard_deviation")
    }
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(short_run.time_s[-1])
    for name, sink in sinks.items():
        np.testing.assert_array_equal(sink.FindLog(simulator.get_context()).data().T, short_run[name])
    assert short_run["rotation_used"].any()


@pytest.mark.parametrize("rule", ["single", "serial"])
def test_diagram_and_estimator_agree_on_telemetry_with_gaps_and_outside_forces(short_run: Run, rule: str) -> None:
    """Missing readings, unknown commands and a known outside wrench, with thrust errors considered."""
    data = short_run.scenario.model_dump(mode="json")
    data["estimation"] |= {"start": "nominal", "thrust_uncertainty": 0.01, "thrust_transient": "gate_lag"}
    data["sensors"]["combine"] = {"gyros": rule, "accelerometers": rule}
    scenario = resolved(data)
    rng = np.random.default_rng(1)
    count = short_run.time_s.size
    readings = {name: short_run[name].copy() for name in SENSORS}
    for table in readings.values():
        table[rng.random(count) < 0.15] = np.nan
        table[rng.random(count) < 0.05, 1] = np.nan
    command = short_run["command"].copy()
    command[rng.random(count) < 0.1, 3] = np.nan
    outside = np.where(rng.random((count, 1)) < 0.3, rng.normal(size=(count, 6)) * 100.0, 0.0)

    dut = Estimator(scenario.vehicle_data, scenario)
    steps = []
    for sample, time_s in enumerate(short_run.time_s):
        accelerometers = {name: readings[name][sample] for name in ("acc1", "acc2", "acc3")}
        steps.append(dut.step(time_s, readings["gyro"][sample], accelerometers, command[sample], outside[sample]))

    builder = DiagramBuilder()
    ended = np.vstack([np.zeros((1, 44)), command[:-1]])  # of the interval that ended
    acted = np.vstack([np.zeros((1, 6)), outside[:-1]])
    tables = {"jet_commands": ended, "outside_wrench": acted, **readings}
    recording = builder.AddNamedSystem("recording", _Recording(tables, 0.08))
    estimators = builder.AddNamedSystem("mine", estimation.build(scenario))
    for name in tables:
        builder.Connect(recording.GetOutputPort(name), estimators.GetInputPort(name))
    names = ("estimate", "standard_deviation", "rotation_report", "mass_report")
    sinks = {name: LogVectorOutput(estimators.GetOutputPort(name), builder, 0.08) for name in names}
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(short_run.time_s[-1])
    logs = {name: sink.FindLog(simulator.get_context()).data().T for name, sink in sinks.items()}
    np.testing.assert_array_equal([step.estimate for step in steps], logs["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], logs["standard_deviation"])
    rotation, mass = ROTATION_REPORT.columns(logs["rotation_report"]), MASS_REPORT.columns(logs["mass_report"])
    np.testing.assert_array_equal([step.rotation_nis for step in steps], rotation["rotation_nis"][:, 0])
    np.testing.assert_array_equal([step.used for step in steps], rotation["rotation_used"][:, 0])
    np.testing.assert_array_equal([step.mass_used for step in steps], mass["mass_used"][:, 0])
    np.testing.assert_array_equal([step.mass_nis for step in steps], mass["mass_nis"][:, 0])
    assert np.isfinite(logs["estimate"]).all()
    assert rotation["rotation_used"].sum() > 5
    assert np.isnan(rotation["rotation_nis"]).sum() > 5


def test_the_closed_loop_serves_in_a_users_own_diagram(short_run: Run) -> None:
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("loop", closed_loop.build(short_run.scenario))
    twin = builder.AddNamedSystem(
        "twin", closed_loop.build(short_run.scenario)
    )  # two of them do not disturb each other
    sinks = [LogVectorOutput(system.GetOutputPort("estimate"), builder, 0.08) for system in (loop, twin)]
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    for time_s in (1.0, 2.5, 2.56, short_run.time_s[-1]):  # in pieces of any length
        simulator.AdvanceTo(time_s)
    for sink in sinks:
        np.testing.assert_array_equal(sink.FindLog(simulator.get_context()).data().T, short_run["estimate"])


def test_a_diagram_runs_again_with_its_context_reset(short_run: Run) -> None:
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("loop", closed_loop.build(short_run.scenario))
    sink = LogVectorOutput(loop.GetOutputPort("body_state"), builder, 0.08)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    logs = []
    for _ in range(2):
        context.SetTime(0.0)
        diagram.SetDefaultContext(context)
        sink.FindMutableLog(context).Clear()
        simulator.Initialize()
        simulator.AdvanceTo(4.0)
        logs.append(np.array(sink.FindLog(context).data()))
    np.testing.assert_array_equal(logs[0], logs[1])
    np.testing.assert_array_equal(logs[0][4:7].T, short_run["rate"][:51])


# ------------------------------------------------------------------------------------------- graphs


@pytest.mark.parametrize("name", list(graphs.DIAGRAMS))
def test_every_diagram_is_drawn_with_its_parts(name: str) -> None:
    dut = graphs.build(name)
    text = graphs.dot_text(dut, 1)
    assert text.startswith("digraph")
    for system in dut.GetSystems():
        assert system.get_name() in text
    assert graphs.describe(name)


def test_a_graph_is_the_same_whatever_was_built_before() -> None:
    texts: dict[str, set[str]] = {name: set() for name in graphs.DIAGRAMS}
    for order in (list(graphs.DIAGRAMS), list(reversed(graphs.DIAGRAMS)), list(graphs.DIAGRAMS)):
        for name in order:
            texts[name].add(graphs.dot_text(graphs.build(name), 2))
    assert {name: len(found) for name, found in texts.items()} == dict.fromkeys(graphs.DIAGRAMS, 1)
