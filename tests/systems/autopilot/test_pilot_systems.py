"""Systems of the autopilot but jet selection: ports, dependences, and what they play back or steer."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from systems_probe import PERIOD_S, feedthrough, inputs, output, outputs, sample

from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.maths.autopilot.gimbal_control import GimbalControl, steer_gimbals
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, Window
from massprop_drake.maths.autopilot.wheel_control import (
    WheelControlParams,
    must_unload,
    rate_for_jets,
    torque_shares,
    wheel_torques,
)
from massprop_drake.maths.vehicle.engine_thrust import EngineParams
from massprop_drake.systems import (
    AttitudeReference,
    HandControllers,
    JetSchedule,
    PhaseSpaceController,
    WheelController,
    WheelSchedule,
)
from massprop_drake.systems.autopilot.engine_commands import EngineCommands

SETTINGS = PhaseSpaceParams(PERIOD_S, 0.01, 0.15, 0.002, 0.001, 0.0005, 0.5, 2.0, 0.004, 0.4)
# rotation and translation, as the crew moves them
CREW = [np.eye(6)[0] * on for on in (0, 1)] + [[1, 0, -1, 0, 0, 0], *[[0] * 6] * 3, *[[0, 0, 0, 1, 0, 0]] * 7]
CREW = [*CREW, [0, 0, 0, 1, 0, -1], [0] * 6, [0] * 6]


def test_hand_controllers_are_out_of_detent_from_the_start_of_a_window_until_before_its_end() -> None:
    windows = (Window(1, -1.0, 1.0, 3.0), Window(5, 1.0, 2.0, 3.0), Window(5, -1.0, 3.0, 4.0))
    dut = HandControllers(windows)
    assert inputs(dut) == {}
    assert outputs(dut) == {"hand_controllers": 6}
    context = dut.CreateDefaultContext()
    for time_s, second, last in (
        (0.0, 0, 0), (np.nextafter(1.0, 0.0), 0, 0), (1.0, -1, 0), (2.0, -1, 1), (np.nextafter(3.0, 0.0), -1, 1),
        (3.0, 0, -1), (4.0, 0, 0),
    ):  # fmt: skip
        context.SetTime(time_s)
        assert_array_equal(output(dut, context, "hand_controllers"), [0, second, 0, 0, 0, last])
    for number in range(1, 700):  # samples lie at k T as the computer multiplies, windows where the decimal point is
        dut = HandControllers((Window(0, 1.0, float(f"{8 * number / 100:.2f}"), 100.0),))
        context = dut.CreateDefaultContext()
        context.SetTime(number * PERIOD_S)
        assert output(dut, context, "hand_controllers")[0] == 1.0


def test_attitude_reference() -> None:
    dut = AttitudeReference(period_s=PERIOD_S, capture_rate=SETTINGS.capture_rate)
    assert inputs(dut) == {"gyro": 3, "hand_controllers": 6}
    assert outputs(dut) == {"attitude_error": 3}
    # the controller at t_k acts on the reading at t_k
    assert feedthrough(dut) == {"attitude_error": {"gyro", "hand_controllers"}}
    assert dut.CreateDefaultContext().get_discrete_state(0).size() == 14


def test_phase_space_controller() -> None:
    dut = PhaseSpaceController(SETTINGS)
    assert inputs(dut) == {"hand_controllers": 6, "attitude_error": 3, "gyro": 3, "delivered": 3}
    assert outputs(dut) == {"request": 8}
    assert feedthrough(dut) == {"request": set(inputs(dut))}


TABLE = np.array([[1.0, 0.0], [0.25, 1.0], [0.0, 0.5]])


def test_jet_schedule_plays_a_row_per_sample_and_holds_it_for_the_next() -> None:
    onsets_s = np.array([[np.nan, 0.0], [0.01, 0.0], [0.0, 0.02]])
    given = TABLE.copy()
    dut, alone = JetSchedule(given, period_s=PERIOD_S, onsets_s=onsets_s), JetSchedule(TABLE, period_s=PERIOD_S)
    given[:] = 0.75  # it is copied
    assert inputs(dut) == {}
    assert outputs(alone) == {"command": 2, "held_command": 2}
    assert outputs(dut) == {**outputs(alone), "command_onset": 2, "held_command_onset": 2}
    context, before = dut.CreateDefaultContext(), (np.zeros(2), np.full(2, np.nan))
    for row in (*zip(TABLE, onsets_s, strict=True), *[(np.zeros(2), np.full(2, np.nan))] * 2):
        for name, now, held in zip(("command", "command_onset"), row, before, strict=True):
            assert_array_equal(output(dut, context, name), now)
            assert_array_equal(output(dut, context, f"held_{name}"), held)
        sample(dut, context, "command")
        before = row
    many = JetSchedule(np.arange(1000.0)[:, None] / 1000.0, period_s=PERIOD_S)
    context = many.CreateDefaultContext()
    for number in range(1000):  # which survives the rounding of its time
        for time_s in np.nextafter(number * PERIOD_S, [-1.0, number * PERIOD_S, 1e9]):
            context.SetTime(time_s)
            assert output(many, context, "command")[0] == number / 1000.0


@pytest.mark.parametrize(
    ("commands", "onsets_s", "words"),
    [
        (np.zeros(4), None, r"a row per sample and a column per jet, got shape \(4,\)"),
        (np.full((2, 4), 1.1), None, "from 0 to 1"),
        (np.full((2, 4), np.nan), None, "from 0 to 1"),
        (TABLE, np.zeros((2, 2)), r"onsets must be a table like that of commands, \(3, 2\), got shape \(2, 2\)"),
    ],
)
def test_what_is_no_table_of_commands_is_refused(commands: np.ndarray, onsets_s: np.ndarray | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        JetSchedule(commands, period_s=PERIOD_S, onsets_s=onsets_s)
    with pytest.raises(ValueError, match=r"period_s: must be above zero, got -0\.1"):
        JetSchedule(TABLE, period_s=-0.1)


def test_wheel_schedule_plays_a_row_per_sample() -> None:
    dut = WheelSchedule(TABLE, period_s=PERIOD_S)
    assert (inputs(dut), outputs(dut)) == ({}, {"wheel_torque": 2})
    context = dut.CreateDefaultContext()
    for number, row in enumerate((*TABLE, np.zeros(2))):
        context.SetTime(number * PERIOD_S)
        assert_array_equal(output(dut, context, "wheel_torque"), row)


def test_wheel_controller() -> None:
    axes, inertia = np.eye(3), np.diag([50.0, 26.0, 55.0])
    params = WheelControlParams(
        axes, torque_shares(axes), np.full(3, 0.006), np.full(3, 0.1), np.full(3, 400.0), inertia, 1.0, 0.5, 0.2, 1e-3,
        SETTINGS,
    )  # fmt: skip
    dut = WheelController(params, ("W1", "W2", "W3"))
    assert inputs(dut) == {"hand_controllers": 6, "attitude_error": 3, "gyro": 3, "W1": 1, "W2": 1, "W3": 1}
    assert outputs(dut) == {"wheel_torque": 3, "rate_for_jets": 3}
    assert feedthrough(dut)["rate_for_jets"] == {"gyro", "W1", "W2", "W3"}
    context, random, unloading, seen = dut.CreateDefaultContext(), np.random.default_rng(3), False, []
    for crew, fastest in zip(CREW, (10, 150, 250, 150, 150, 50, 150, *[10] * 9), strict=True):
        error, rate = 1e-3 * random.standard_normal((2, 3))
        speeds = fastest * np.array([1.0, -0.5, 0.1])
        unloading = must_unload(unloading, speeds, params)
        given = dict(zip(("W1", "W2", "W3"), speeds[:, None], strict=True), hand_controllers=crew, attitude_error=error)
        turning = np.array(crew[:3], dtype=float), error, rate
        found = output(dut, context, "wheel_torque", gyro=rate, **given)
        assert_array_equal(found, wheel_torques(turning, speeds, params))
        assert_array_equal(sample(dut, context, "rate_for_jets"), rate_for_jets(rate, unloading, speeds, params))
        seen.append(unloading)
    assert seen[:7] == [False, False, True, True, True, False, False]


def test_engine_commands_play_a_schedule_and_hold_the_rate() -> None:
    nominal = load_vehicle("small_satellite").nominal
    one = np.ones((1, 3))
    engines = EngineParams(
        np.array([[-0.3, 0.0, 0.0]]), np.eye(3)[:1], np.eye(3)[None, 1:], np.eye(3)[None, 1:], np.array([8.0]),
        np.array([0.0, 1.0]), np.zeros((1, 2)), one, 0.0 * one, 0.2 * one, 0.0 * one, np.zeros(1), np.ones(1),
    )  # fmt: skip
    table = np.array([[0.0, 0.0, 0.0], [0.8, 0.01, 0.0], [0.8, 0.01, 0.0]])
    control = GimbalControl(engines, nominal, 1.5, PERIOD_S)
    dut, free = EngineCommands(table, control), EngineCommands(table, control._replace(bandwidth=0.0))
    assert (inputs(dut), inputs(free)) == ({"gyro": 3}, {})
    assert outputs(dut) == {"engine_command": 3}
    context, alone, turned = dut.CreateDefaultContext(), free.CreateDefaultContext(), np.zeros(3)
    rate = np.array([0.0, 0.002, -0.003])
    for row in (*table, np.zeros(3)):
        expected, turned = steer_gimbals(row[None], rate, turned, control)
        assert_array_equal(sample(dut, context, "engine_command", gyro=rate), expected[0])
        assert_array_equal(sample(free, alone, "engine_command"), row)
