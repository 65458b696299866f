"""Rate gyro and integrating accelerometer: readings and their errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from params_probe import PERFECT_SENSOR
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs, update

from massprop_drake.maths.vehicle.rigid_body import MASS, N_STATE, ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import Tone, vibration
from massprop_drake.systems.vehicle.integrating_accelerometer import IntegratingAccelerometer
from massprop_drake.systems.vehicle.rate_gyro import RateGyro
from massprop_drake.systems.vehicle.sensor import Sensor

POSITION = np.array([2.0, -1.0, 0.5])


def _gyro(**errors: Any) -> tuple[RateGyro, Any]:
    dut = RateGyro("gyro", PERFECT_SENSOR._replace(**errors))
    return dut, dut.CreateDefaultContext()


def _accelerometer(**errors: Any) -> tuple[IntegratingAccelerometer, Any]:
    dut = IntegratingAccelerometer("acc", PERFECT_SENSOR._replace(integrates=True, **errors), position=POSITION)
    return dut, dut.CreateDefaultContext()


def _body(rate: tuple[float, ...] = (0.0, 0.0, 0.0), velocity: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    state = np.full(N_STATE, 7.0)  # what a sensor must not read is not zero
    state[RATE] = rate
    state[ORIGIN_VELOCITY] = velocity
    state[SPIN_INTEGRAL] = 0.0
    return state


def _reading(dut: Sensor, context: Any, body: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
    dut.GetInputPort("body_state").FixValue(context, body)
    if noise is not None:
        dut.GetInputPort("noise").FixValue(context, noise)
    return dut.GetOutputPort("reading").Eval(context)


@pytest.mark.parametrize("make", [_gyro, _accelerometer])
def test_topology(make: Any) -> None:
    dut, context = make()
    assert inputs(dut) == {"body_state": N_STATE, "noise": 6}
    assert outputs(dut) == {"reading": 3}
    # noise is no input of a sensor without any, and may stay unconnected
    assert feedthrough(dut) == {"reading": {"body_state"}}
    assert context.num_discrete_state_groups() == 0
    noisy, _ = make(noise_std=0.1)
    assert feedthrough(noisy) == {"reading": {"body_state", "noise"}}
    slow, context = make(delay=2)
    assert feedthrough(slow) == {"reading": {"body_state"}}
    assert context.get_discrete_state(0).size() == 16


def test_a_gyro_reads_the_rate_and_nothing_else() -> None:
    dut, context = _gyro()
    np.testing.assert_array_equal(_reading(dut, context, _body(rate=(0.1, -0.2, 0.3))), [0.1, -0.2, 0.3])


def test_an_accelerometer_reads_the_velocity_gathered_where_it_stands() -> None:
    # V_O + w x r' with w = (0, 0, 0.5), r' = (2, -1, 0.5): (0.5, 1, 0)
    dut, context = _accelerometer()
    body = _body(rate=(0.0, 0.0, 0.5), velocity=(10.0, 20.0, 30.0))
    np.testing.assert_allclose(_reading(dut, context, body), [10.5, 21.0, 30.0], rtol=1e-15)
    # having turned about z: the integral of [w x]^2 with zz = 3 is diag(-3, -3, 0), so -6 and +3
    body[SPIN_INTEGRAL] = [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(_reading(dut, context, body), [4.5, 24.0, 30.0], rtol=1e-15)


def test_an_accelerometer_does_not_read_velocity_position_or_mass() -> None:
    dut, context = _accelerometer()
    body = _body(velocity=(1.0, 2.0, 3.0))
    before = _reading(dut, context, body)
    body[7:13] += 100.0  # position and velocity
    body[MASS] += 1.0
    np.testing.assert_array_equal(_reading(dut, context, body), before)


def test_a_reading_is_the_nearest_mark_of_the_quantizer() -> None:
    dut, context = _gyro(quantum=0.1)
    np.testing.assert_allclose(_reading(dut, context, _body(rate=(0.149, 0.151, -0.26))), [0.1, 0.2, -0.3], rtol=1e-14)
    # marks a quarter of a quantum below the multiples: ..., 0.075, 0.175, ...
    dut, context = _gyro(quantum=0.1, phase=np.full(3, 0.25))
    np.testing.assert_allclose(
        _reading(dut, context, _body(rate=(0.124, 0.126, 0.0))), [0.075, 0.175, -0.025], rtol=1e-14
    )


def test_scale_factor_and_bias() -> None:
    dut, context = _gyro(scale_factor=np.array([0.01, -0.02, 0.0]), bias=np.array([0.001, 0.0, -0.003]))
    np.testing.assert_allclose(_reading(dut, context, _body(rate=(1.0, 1.0, 1.0))), [1.011, 0.98, 0.997], rtol=1e-14)


def test_white_noise_is_the_noise_port_times_its_deviation() -> None:
    dut, context = _gyro(noise_std=0.01)
    noise = np.array([1.0, -2.0, 0.5, 9.0, 9.0, 9.0])
    np.testing.assert_allclose(
        _reading(dut, context, _body(rate=(1.0, 1.0, 1.0)), noise), [1.01, 0.98, 1.005], rtol=1e-14
    )


def test_noise_comes_before_the_quantizer() -> None:
    dut, context = _gyro(noise_std=0.01, quantum=0.1)
    noise = np.array([6.0, -6.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(_reading(dut, context, _body(), noise), [0.1, -0.1, 0.0], rtol=1e-14)


def test_a_late_sensor_reads_what_was_so_many_samples_before() -> None:
    dut, context = _gyro(delay=2)
    readings = []
    for sample in range(5):
        readings.append(_reading(dut, context, _body(rate=(0.1 * (sample + 1), 0.0, 0.0)))[0])
        advance(dut, context)
    # before the start the reading is taken to have been the first
    np.testing.assert_allclose(readings, [0.1, 0.1, 0.1, 0.2, 0.3], rtol=1e-15)


def test_the_bias_walks_from_sample_to_sample() -> None:
    dut, context = _gyro(walk_std=0.01)
    readings = []
    for step in (1.0, 2.0, -4.0):
        noise = np.array([9.0, 9.0, 9.0, step, 0.0, -step])
        readings.append(_reading(dut, context, _body(rate=(1.0, 1.0, 1.0)), noise))
        advance(dut, context)
    np.testing.assert_allclose(readings, [[1.0, 1.0, 1.0], [1.01, 1.0, 0.99], [1.03, 1.0, 0.97]], rtol=1e-14)


def test_the_bias_of_an_accelerometer_is_one_of_acceleration() -> None:
    # 0.5 ft/s^2 gathers 0.04 ft/s a sample, from nothing
    dut, context = _accelerometer(bias=np.array([0.5, 0.0, -0.5]))
    readings = []
    for _ in range(3):
        readings.append(_reading(dut, context, _body()))
        advance(dut, context)
    np.testing.assert_allclose(readings, np.outer([0.0, 1.0, 2.0], [0.04, 0.0, -0.04]), rtol=1e-14)


def test_a_low_pass_forgets_the_old_value_by_its_share() -> None:
    keep = math.exp(-2.0 * math.pi * 1.0 * PERIOD_S)
    dut, context = _gyro(smoothing=keep)
    readings = []
    for rate in (0.0, 1.0, 1.0):  # up by 1 within a sample, and steady from there: exact for that
        readings.append(_reading(dut, context, _body(rate=(rate, 0.0, 0.0)))[0])
        advance(dut, context)
    first = 1.0 - (1.0 - keep) / (2.0 * math.pi * 1.0 * PERIOD_S)
    np.testing.assert_allclose(readings, [0.0, first, 1.0 - keep * (1.0 - first)], rtol=1e-13)


@pytest.mark.parametrize("remembering", [{}, {"delay": 1}])
def test_vibration_is_taken_at_the_time_of_the_sample(remembering: dict[str, Any]) -> None:
    # a fifth of a turn a sample
    tone = Tone(0.2 / PERIOD_S, np.array([1.0, 0.0, -2.0]), np.zeros(3))
    dut, context = _gyro(vibration=vibration([tone], np.ones(3), None, integrates=False), **remembering)
    readings = []
    for _ in range(4):
        readings.append(_reading(dut, context, _body(rate=(0.0, 0.3, 0.0))))
        if remembering:
            update(dut, context)
        context.SetTime(context.get_time() + PERIOD_S)
    sines = np.sin(0.4 * np.pi * np.arange(4))
    if remembering:
        sines = np.array([sines[0], *sines[:3]])
    expected = np.outer(sines, [1.0, 0.0, -2.0])
    expected[:, 1] = 0.3
    np.testing.assert_allclose(readings, expected, rtol=0.0, atol=1e-14)


def test_asking_for_a_reading_changes_nothing() -> None:
    dut, context = _gyro(delay=1, walk_std=0.01)
    noise = np.ones(6)
    first = [_reading(dut, context, _body(rate=(0.1, 0.0, 0.0)), noise) for _ in range(3)]
    np.testing.assert_array_equal(first[0], first[2])
    assert not context.get_discrete_state(0).CopyToVector().any()


def test_every_sample_updates_the_memory_once() -> None:
    dut, context = _accelerometer(bias=np.array([0.5, 0.0, 0.0]))
    for _ in range(3):
        _reading(dut, context, _body())
        _reading(dut, context, _body())
    advance(dut, context)
    np.testing.assert_allclose(_reading(dut, context, _body())[0], 0.04, rtol=1e-14)


@pytest.mark.parametrize("remembering", [{}, {"delay": 1}])
def test_a_reading_stops_at_the_range(remembering: dict[str, Any]) -> None:
    dut, context = _gyro(limit=0.5, quantum=0.2, **remembering)
    for _ in range(2):
        reading = _reading(dut, context, _body(rate=(0.41, 0.61, -9.0)))
        if remembering:
            advance(dut, context)
    np.testing.assert_allclose(reading, [0.4, 0.5, -0.5], rtol=1e-14)
