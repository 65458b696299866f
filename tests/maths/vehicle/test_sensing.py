"""Sensor errors one by one and together, and what an accelerometer anywhere on the body gathers."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from params_probe import PERFECT_SENSOR

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.sensing import (
    SensorModel,
    Tone,
    increment_noise,
    low_passed,
    point_velocity,
    quantized,
    sense,
    smoothing_factor,
    unsaturated,
    vibration,
)

PERIOD = 0.5  # s
SILENCE = np.zeros(6)


def model(**errors: Any) -> SensorModel:
    return PERFECT_SENSOR._replace(period_s=PERIOD, **errors)


def readings(dut: SensorModel, signals: Array, noise: Array | None = None) -> Array:
    memory = np.zeros(dut.memory_size)
    answers = []
    for number, signal in enumerate(signals):
        heard = SILENCE if noise is None else noise[number]
        reading, memory = sense(signal, memory, heard, dut, number * PERIOD)
        answers.append(reading)
    return np.array(answers)


SIGNALS = np.array([[1.0, 2.0, -3.0], [1.5, 2.0, -2.0], [2.0, 0.0, 5.0], [0.25, 1.0, 0.0]])


def test_noise_of_an_increment_is_that_of_two_readings() -> None:
    np.testing.assert_array_equal(increment_noise(0.3), np.diag([0.6, 0.6, 0.6]))


def test_quantizer_rounds_to_the_nearest_mark() -> None:
    # marks 0.25 of a quantum of 2 below the multiples of 2: ..., -2.5, -0.5, 1.5, 3.5, ...
    value = np.array([0.4, 0.6, -1.4, -1.6, 3.5])
    np.testing.assert_allclose(quantized(value, 2.0, np.full(5, 0.25)), [-0.5, 1.5, -0.5, -2.5, 3.5], rtol=1e-15)


def test_quantization_error_lies_within_half_a_quantum() -> None:
    rng = np.random.default_rng(1)
    for phase in rng.uniform(-0.5, 0.5, 20):
        value = rng.uniform(-5.0, 5.0, 500)
        error = quantized(value, 0.125, np.full(500, phase)) - value
        assert np.abs(error).max() <= 0.0625 * (1.0 + 1e-12)
        assert np.abs(error).max() > 0.06  # the whole width is used


def test_quantization_errors_mean_is_zero_over_random_phases() -> None:
    phases = np.random.default_rng(2).uniform(-0.5, 0.5, 20_000)
    errors = quantized(np.full(20_000, 0.3), 1.0, phases) - 0.3
    # uniform within half a quantum: variance 1/12, so the mean has a standard error of sqrt(1 / 12 n)
    assert abs(errors.mean()) < 5.0 * np.sqrt(1.0 / 12.0 / 20_000)
    assert errors.var() == pytest.approx(1.0 / 12.0, rel=0.03)


def test_quantizing_twice_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    phase = rng.uniform(-0.5, 0.5, 100)
    once = quantized(rng.uniform(-5.0, 5.0, 100), 0.0344, phase)
    # rounding of the mark itself: of values up to 5
    np.testing.assert_allclose(quantized(once, 0.0344, phase), once, rtol=0.0, atol=2e-15)


def test_no_quantum_leaves_the_value() -> None:
    value = np.array([0.1234, -5.0, 1e-9])
    np.testing.assert_array_equal(quantized(value, 0.0, np.full(3, 0.4)), value)


def test_smoothing_factor_of_hand_value() -> None:
    # exp(-2 pi f T) with f T = 1 / 2 pi
    assert smoothing_factor(1.0 / np.pi, 0.5) == pytest.approx(np.exp(-1.0), rel=1e-14)
    assert smoothing_factor(None, 0.5) == 0.0


def test_ideal_sensor_reads_the_signal() -> None:
    np.testing.assert_array_equal(readings(model(), SIGNALS), SIGNALS)


def test_scale_factor_error_is_relative_per_axis() -> None:
    dut = model(scale_factor=np.array([0.25, 0.0, -0.5]))
    np.testing.assert_array_equal(readings(dut, SIGNALS), SIGNALS * [1.25, 1.0, 0.5])


def test_gyros_bias_shifts_every_reading() -> None:
    bias = np.array([0.5, -0.25, 0.125])
    np.testing.assert_array_equal(readings(model(bias=bias), SIGNALS), SIGNALS + bias)


def test_accelerometers_bias_accumulates_from_the_first_reading() -> None:
    # the k-th reading has gathered k sample periods of 0.5 s
    bias = np.array([0.5, -0.25, 0.125])
    dut = model(bias=bias, integrates=True)
    np.testing.assert_array_equal(readings(dut, SIGNALS), SIGNALS + np.outer([0.0, 0.5, 1.0, 1.5], bias))


def test_readings_are_held_within_the_range() -> None:
    expected = [[1.0, 1.5, -1.5], [1.5, 1.5, -1.5], [1.5, 0.0, 1.5], [0.25, 1.0, 0.0]]
    np.testing.assert_array_equal(readings(model(limit=1.5), SIGNALS), expected)
    # range comes after noise and quantizer: 1.4 + 0.2 on marks of 0.5 reads 1.5, which 1.25 holds back
    dut = model(limit=1.25, quantum=0.5, noise_std=0.1)
    noise = np.full((1, 6), 2.0)
    np.testing.assert_allclose(readings(dut, np.array([[1.4, -1.4, 0.3]]), noise), [[1.25, -1.0, 0.5]], rtol=1e-14)


def test_a_late_reading_is_held_within_the_range_too() -> None:
    dut = model(limit=1.5, delay=1)
    np.testing.assert_array_equal(readings(dut, SIGNALS)[1:], np.clip(SIGNALS[:-1], -1.5, 1.5))


@pytest.mark.parametrize(
    ("reading", "there"),
    [
        ([0.0, 1.4999, -1.4999], True),
        ([0.0, 1.5, 0.0], False),  # at its range a sensor does not say how much more there is
        ([0.0, 0.0, -1.5], False),
        ([2.0, 0.0, 0.0], False),
        ([np.nan, 0.0, 0.0], False),
    ],
)
def test_a_reading_at_the_range_counts_as_missing(reading: list[float], *, there: bool) -> None:
    dut = unsaturated(np.array(reading), 1.5)
    np.testing.assert_array_equal(dut, reading if there else [np.nan] * 3)


def test_without_a_range_every_reading_stays() -> None:
    reading = np.array([1e12, -1e12, np.nan])
    np.testing.assert_array_equal(unsaturated(reading, np.inf), reading)


def test_gyros_bias_walks_by_one_step_per_sample() -> None:
    # steps 2 * 0.5: the first reading has none, the k-th the sum of k
    noise = np.zeros((4, 6))
    noise[:, 3] = [0.5, 0.5, -1.5, 9.0]
    dut = model(walk_std=2.0)
    np.testing.assert_array_equal(readings(dut, np.zeros((4, 3)), noise)[:, 0], [0.0, 1.0, 2.0, -1.0])


def test_accelerometers_walk_is_summed_once_more() -> None:
    # bias 1, 2, -1 of the samples after the first, each over 0.5 s, on top of nothing in the first
    noise = np.zeros((5, 6))
    noise[:, 4] = [0.5, 0.5, -1.5, 9.0, 9.0]
    dut = model(walk_std=2.0, integrates=True)
    np.testing.assert_array_equal(readings(dut, np.zeros((5, 3)), noise)[:, 1], [0.0, 0.0, 0.5, 1.5, 1.0])


def test_white_noise_scales_the_first_three_numbers() -> None:
    noise = np.arange(24.0).reshape(4, 6)
    np.testing.assert_array_equal(readings(model(noise_std=0.5), SIGNALS, noise), SIGNALS + 0.5 * noise[:, :3])


def test_bandwidth_answers_a_ramp_late_by_its_time_constant() -> None:
    # of dy/dt = w (x - y) with x = s t from rest: y = s (t - (1 - exp(-w t)) / w)
    slopes, w = np.array([2.0, -1.0, 0.5]), 3.0
    times = PERIOD * np.arange(8)
    answer = readings(model(smoothing=np.exp(-w * PERIOD)), np.outer(times, slopes))
    late = times - (1.0 - np.exp(-w * times)) / w
    np.testing.assert_allclose(answer, np.outer(late, slopes), rtol=1e-13, atol=1e-15)


def test_bandwidth_of_any_broken_line_is_that_of_fine_steps() -> None:
    # the differential equation by 1000 steps of Euler's method between samples
    w, steps = 5.0, 1000
    answer = readings(model(smoothing=np.exp(-w * PERIOD)), SIGNALS)
    state, fine = SIGNALS[0].copy(), [SIGNALS[0]]
    for before, after in itertools.pairwise(SIGNALS):
        for step in range(steps):
            signal = before + (after - before) * (step + 0.5) / steps
            state = state + w * PERIOD / steps * (signal - state)
        fine.append(state)
    np.testing.assert_allclose(answer, fine, rtol=0.0, atol=0.01)  # a step keeps 0.25 %


def test_a_bandwidth_far_above_the_samples_is_none() -> None:
    # late by 1 / w, a 690th of a sample, in which the signal changes by 7 at the most
    np.testing.assert_allclose(readings(model(smoothing=1e-300), SIGNALS), SIGNALS, rtol=0.0, atol=7.0 / 690.0)
    answer, memory = low_passed(SIGNALS[0], SIGNALS[1], True, 0.0)
    np.testing.assert_array_equal(answer, SIGNALS[0])
    np.testing.assert_array_equal(memory, np.zeros(3))


def test_bandwidth_starts_from_the_first_signal_not_from_zero() -> None:
    np.testing.assert_array_equal(readings(model(smoothing=0.75), np.ones((3, 3))), np.ones((3, 3)))


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_delay_shows_the_reading_of_earlier_samples_and_before_that_the_first(delay: int) -> None:
    signals = np.arange(18.0).reshape(6, 3)
    expected = signals[np.maximum(np.arange(6) - delay, 0)]
    np.testing.assert_array_equal(readings(model(delay=delay), signals), expected)


def test_scale_factor_acts_before_bandwidth_and_bias() -> None:
    # gain 2; up by 1 in a sample with half kept: 2 (1 - 0.5 / ln 2), then half of what is missing; bias 3 not
    # scaled or smoothed
    dut = model(scale_factor=np.ones(3), smoothing=0.5, bias=np.full(3, 3.0))
    answer = readings(dut, np.array([[0.0] * 3, [1.0] * 3, [1.0] * 3]))
    first = 2.0 * (1.0 - 0.5 / np.log(2.0))
    np.testing.assert_allclose(answer[:, 0], [3.0, 3.0 + first, 4.0 + 0.5 * first], rtol=1e-14)


def test_noise_acts_before_the_quantizer() -> None:
    # 0.4 + 0.2 rounds to 1, though each alone rounds to 0; with the phase 0.25 the marks are k - 0.25
    noise = np.zeros((1, 6))
    noise[0, :3] = 0.2
    dut = model(noise_std=1.0, quantum=1.0)
    np.testing.assert_array_equal(readings(dut, np.full((1, 3), 0.4), noise), np.ones((1, 3)))
    shifted = dut._replace(phase=np.full(3, 0.25))
    np.testing.assert_array_equal(readings(shifted, np.full((1, 3), 0.4), noise), np.full((1, 3), 0.75))


def test_bias_acts_before_the_quantizer() -> None:
    dut = model(bias=np.full(3, 0.3), quantum=1.0)
    np.testing.assert_array_equal(readings(dut, np.full((1, 3), 0.3)), np.ones((1, 3)))


def test_delay_comes_last_and_keeps_the_noise_of_its_own_sample() -> None:
    noise = np.zeros((3, 6))
    noise[:, 0] = [0.1, 0.2, 0.3]
    answer = readings(model(noise_std=1.0, delay=1), np.zeros((3, 3)), noise)
    np.testing.assert_array_equal(answer[:, 0], [0.1, 0.1, 0.2])


def test_memory_given_is_not_changed() -> None:
    dut = model(smoothing=0.5, walk_std=1.0, integrates=True, bias=np.ones(3), delay=2)
    memory = np.arange(16.0)
    signal = np.ones(3)
    sense(signal, memory, np.ones(6), dut)
    np.testing.assert_array_equal(memory, np.arange(16.0))
    np.testing.assert_array_equal(signal, np.ones(3))


@pytest.mark.parametrize(
    ("errors", "remembers", "noisy"),
    [
        ({}, False, False),
        ({"bias": np.ones(3)}, False, False),
        ({"bias": np.ones(3), "integrates": True}, True, False),
        ({"integrates": True}, False, False),
        ({"smoothing": 0.5}, True, False),
        ({"delay": 1}, True, False),
        ({"walk_std": 1e-6}, True, True),
        ({"noise_std": 1e-6, "quantum": 1.0}, False, True),
    ],
)
def test_sensor_knows_whether_it_has_memory_and_noise(errors: dict[str, Any], remembers: bool, noisy: bool) -> None:
    dut = model(**errors)
    assert dut.remembers is remembers
    assert dut.noisy is noisy


def test_sensor_without_memory_reads_the_same_from_any_memory() -> None:
    # what `remembers` promises
    dut = model(scale_factor=np.full(3, 0.1), bias=np.ones(3), noise_std=0.3, quantum=0.25, phase=np.full(3, 0.1))
    noise = np.arange(6.0)
    fresh, _ = sense(SIGNALS[0], np.zeros(10), noise, dut)
    _, used_memory = sense(SIGNALS[1], np.zeros(10), -noise, dut)
    later, _ = sense(SIGNALS[0], used_memory, noise, dut)
    np.testing.assert_array_equal(later, fresh)


def test_point_velocity_of_hand_value() -> None:
    # w = (0, 0, 2) for 3 s: integral of w w^T has zz = 12; at (1, 2, 5):
    # w x r = (-4, 2, 0) and the centripetal part -12 (1, 2, 0)
    velocity = point_velocity(
        np.array([10.0, 20.0, 30.0]),
        np.array([0.0, 0.0, 2.0]),
        np.array([0.0, 0.0, 12.0, 0.0, 0.0, 0.0]),
        np.array([1.0, 2.0, 5.0]),
    )
    np.testing.assert_array_equal(velocity, [10.0 - 4.0 - 12.0, 20.0 + 2.0 - 24.0, 30.0])


def test_point_velocitys_centripetal_part_is_the_square_of_the_cross_product() -> None:
    # (w w^T - w^2 1) r = w x (w x r) for one second of a constant rate
    rng = np.random.default_rng(4)
    for rate, position in rng.standard_normal((20, 2, 3)):
        x, y, z = rate
        spin = np.array([x * x, y * y, z * z, y * z, x * z, x * y])
        expected = np.cross(rate, position) + np.cross(rate, np.cross(rate, position))
        # sums of a few products of size one
        np.testing.assert_allclose(point_velocity(np.zeros(3), rate, spin, position), expected, rtol=0.0, atol=1e-14)


# ---------------------------------------------------------------------------------------- vibration


def tone(frequency_hz: float, amplitude: tuple[float, float, float], phase: float = 0.0) -> Tone:
    return Tone(frequency_hz, np.array(amplitude), np.full(3, phase))


def test_a_gyro_shows_a_vibration_at_the_true_times_of_its_samples() -> None:
    # a quarter turn a sample of 0.5 s, from a phase of a quarter turn
    shaken = vibration([tone(0.5, (1.0, 2.0, 0.0), 0.25)], np.ones(3), None, integrates=False)
    answer = readings(model(vibration=shaken), SIGNALS)
    np.testing.assert_allclose(answer - SIGNALS, np.outer([1.0, 0.0, -1.0, 0.0], [1.0, 2.0, 0.0]), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("number", [1, 2, 7])
def test_a_vibration_above_half_the_sample_frequency_appears_at_another(number: int) -> None:
    # 2 Hz sampling: f and f + 2 n Hz give the same samples, and -f the same with the sign changed
    low = readings(
        model(vibration=vibration([tone(0.3, (1.0, 1.0, 1.0))], np.ones(3), None, integrates=False)), SIGNALS
    )
    fast = vibration([tone(0.3 + 2.0 * number, (1.0, 1.0, 1.0))], np.ones(3), None, integrates=False)
    np.testing.assert_allclose(readings(model(vibration=fast), SIGNALS), low, rtol=0.0, atol=1e-12)
    mirrored = vibration([tone(2.0 * number - 0.3, (-1.0, -1.0, -1.0))], np.ones(3), None, integrates=False)
    np.testing.assert_allclose(readings(model(vibration=mirrored), SIGNALS), low, rtol=0.0, atol=1e-12)


def test_an_accelerometers_vibration_is_the_integral_of_the_acceleration() -> None:
    shaken = vibration([tone(1.7, (3.0, 0.0, -1.0), 0.1)], np.ones(3), None, integrates=True)
    # from 0.2 s to 0.31 s, by the midpoint rule
    times = 0.2 + 0.11 * (np.arange(2000) + 0.5) / 2000
    acceleration = np.sin(2.0 * np.pi * (1.7 * times + 0.1))
    expected = acceleration.mean() * 0.11 * np.array([3.0, 0.0, -1.0])
    np.testing.assert_allclose(shaken.at(0.31) - shaken.at(0.2), expected, rtol=1e-6, atol=1e-15)


def test_bandwidth_takes_of_a_vibration_what_it_takes_at_its_own_frequency() -> None:
    # at the corner: 1 / sqrt 2 of it, an eighth of a turn late
    shaken = vibration([tone(4.0, (1.0, 1.0, 1.0))], np.array([1.5, 1.0, 0.5]), 4.0, integrates=False)
    np.testing.assert_allclose(shaken.amplitude, [[1.5 / np.sqrt(2.0), 1.0 / np.sqrt(2.0), 0.5 / np.sqrt(2.0)]])
    np.testing.assert_allclose(shaken.phase, np.full((1, 3), -np.pi / 4.0))
    # and by the differential equation, once its start is forgotten
    w, step, state = 2.0 * math.pi * 4.0, 1e-4, 0.0
    for number in range(10_000):
        state += w * step * (math.sin(w * (number + 0.5) * step) - state)
    assert shaken.at(1.0)[1] == pytest.approx(state, abs=3e-3)


def test_vibrations_add_up() -> None:
    one, two = tone(1.0, (1.0, 0.0, 0.0), 0.1), tone(3.3, (0.0, 2.0, 1.0), 0.2)
    both = vibration([one, two], np.ones(3), None, integrates=False)
    alone = [vibration([each], np.ones(3), None, integrates=False).at(0.7) for each in (one, two)]
    np.testing.assert_allclose(both.at(0.7), alone[0] + alone[1], rtol=1e-14)


def test_vibration_is_quantized_and_held_within_the_range_as_the_rest() -> None:
    shaken = vibration([tone(0.5, (9.0, 0.26, 0.0), 0.25)], np.ones(3), None, integrates=False)
    dut = model(vibration=shaken, quantum=0.5, limit=5.0)
    np.testing.assert_array_equal(readings(dut, np.zeros((1, 3))), [[5.0, 0.5, 0.0]])
