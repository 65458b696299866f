"""Sensor errors one by one and together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import PERFECT_SENSOR

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import uniform_phase
from massprop_drake.maths.vehicle.sensing import (
    Draws,
    SensorModel,
    Tone,
    add_drawn_phases,
    make_vibration,
    mask_saturated,
    quantize,
    sense,
    smoothing_factor,
)

PERIOD = 0.5  # s
SIGNALS = np.array([[1.0, 2.0, -3.0], [1.5, 2.0, -2.0], [2.0, 0.0, 5.0], [0.25, 1.0, 0.0]])
NOISE = np.arange(24.0).reshape(4, 6)
BIAS, SCALE = np.array([0.5, -0.25, 0.125]), np.array([0.25, 0.0, -0.5])
WALK = np.cumsum(np.vstack((np.zeros(3), NOISE[:3, 3:])), axis=0)  # of the bias until each sample, in its sigmas


def model(**errors: Any) -> SensorModel:
    return PERFECT_SENSOR._replace(period_s=PERIOD, **errors)


def readings(dut: SensorModel, signals: Array = SIGNALS, noise: Array = NOISE) -> Array:
    memory, answers = np.zeros(dut.memory_size), []
    for number, signal in enumerate(signals):
        before = memory.copy()
        reading, after = sense(signal, memory, noise[number], dut, number * PERIOD)
        assert_array_equal(memory, before)  # what is given is left alone
        memory = after
        answers.append(reading)
    return np.array(answers)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ({}, SIGNALS),
        ({"scale_factor": SCALE}, SIGNALS * (1.0 + SCALE)),
        ({"bias": BIAS}, SIGNALS + BIAS),
        # the k-th reading of an accelerometer has gathered k periods of bias
        ({"bias": BIAS, "integrates": True}, SIGNALS + np.outer([0.0, 0.5, 1.0, 1.5], BIAS)),
        ({"noise_std": 0.5}, SIGNALS + 0.5 * NOISE[:, :3]),
        ({"walk_std": 2.0}, SIGNALS + 2.0 * WALK),
        # a walk of the acceleration is summed once more: biases of the samples before, each over a period
        (
            {"walk_std": 2.0, "integrates": True},
            SIGNALS + np.cumsum(np.vstack((np.zeros(3), PERIOD * 2.0 * WALK[:3])), axis=0),
        ),
        ({"limit": 1.5}, np.clip(SIGNALS, -1.5, 1.5)),
        ({"limit": 1.5, "delay": 1}, np.clip(SIGNALS[[0, 0, 1, 2]], -1.5, 1.5)),
        ({"delay": 3}, SIGNALS[[0, 0, 0, 0]]),
        # late readings keep the noise of their own sample; noise, bias and scale come before the quantizer, this
        # before the range
        ({"noise_std": 0.5, "delay": 2}, (SIGNALS + 0.5 * NOISE[:, :3])[[0, 0, 0, 1]]),
        (
            {"noise_std": 0.3, "bias": BIAS, "scale_factor": SCALE, "quantum": 0.4, "limit": 4.1},
            np.clip(0.4 * np.rint((SIGNALS * (1.0 + SCALE) + BIAS + 0.3 * NOISE[:, :3]) / 0.4), -4.1, 4.1),
        ),
    ],
)
def test_errors_act_in_their_order(errors: dict[str, Any], expected: Array) -> None:
    assert_allclose(readings(model(**errors)), expected, rtol=1e-14, atol=1e-14)


def test_quantizer_rounds_to_the_nearest_mark() -> None:
    # marks 0.25 of a quantum of 2 below the multiples of 2: ..., -2.5, -0.5, 1.5, 3.5, ...
    value = np.array([0.4, 0.6, -1.4, -1.6, 3.5])
    once = quantize(value, 2.0, np.full(5, 0.25))
    assert_allclose(once, [-0.5, 1.5, -0.5, -2.5, 3.5], rtol=1e-15)
    assert_array_equal(quantize(once, 2.0, np.full(5, 0.25)), once)
    assert_array_equal(quantize(value, 0.0, np.full(5, 0.25)), value)


@pytest.mark.parametrize(
    ("reading", "limit", "there"),
    [
        ([0.0, 1.4999, -1.4999], 1.5, True),
        ([0.0, 1.5, 0.0], 1.5, False),  # at its range a sensor does not say how much more there is
        ([0.0, 0.0, -1.5], 1.5, False),
        ([np.nan, 0.0, 0.0], 1.5, False),
        ([1e12, -1e12, np.nan], np.inf, True),
    ],
)
def test_a_reading_at_the_range_counts_as_missing(reading: list[float], limit: float, *, there: bool) -> None:
    assert_array_equal(mask_saturated(np.array(reading), limit), reading if there else [np.nan] * 3)


def test_bandwidth_answers_a_ramp_late_by_its_time_constant() -> None:
    # of dy/dt = w (x - y) with x = s t from rest: y = s (t - (1 - exp(-w t)) / w)
    slopes, w, times = np.array([2.0, -1.0, 0.5]), 3.0, PERIOD * np.arange(8)
    keep = smoothing_factor(w / (2.0 * np.pi), PERIOD)
    assert (keep, smoothing_factor(None, PERIOD)) == (pytest.approx(np.exp(-w * PERIOD), rel=1e-14), 0.0)
    answer = readings(model(smoothing=keep), np.outer(times, slopes), np.zeros((8, 6)))
    assert_allclose(answer, np.outer(times - (1.0 - np.exp(-w * times)) / w, slopes), rtol=1e-13, atol=1e-15)


def tone(frequency_hz: float, *amplitude: float, phase: float = 0.0) -> Tone:
    return Tone(frequency_hz, np.array(amplitude), np.full(3, phase))


def shaken(*tones: Tone) -> Array:
    return readings(model(vibration=make_vibration(tones, np.ones(3), None, integrates=False))) - SIGNALS


def test_a_vibration_shows_at_the_true_times_of_samples_and_aliases() -> None:
    # a quarter turn a sample of 0.5 s, from a phase of a quarter turn
    assert_allclose(shaken(tone(0.5, 1, 2, 0, phase=0.25)), np.outer([1, 0, -1, 0], [1, 2, 0]), atol=1e-14)
    # 2 Hz sampling: f and f + 2 n Hz give the same samples, and -f the same with the sign changed
    low = shaken(tone(0.3, 1, 1, 1))
    assert_allclose(shaken(tone(0.3 + 14.0, 1, 1, 1)), low, rtol=0.0, atol=1e-12)
    assert_allclose(shaken(tone(14.0 - 0.3, -1, -1, -1)), low, rtol=0.0, atol=1e-12)
    assert_allclose(shaken(tone(0.3, 1, 1, 1), tone(0.7, 0, 2, 1)), low + shaken(tone(0.7, 0, 2, 1)), atol=1e-14)


def test_an_accelerometers_vibration_is_the_integral_of_the_acceleration() -> None:
    gathered = make_vibration([tone(1.7, 3.0, 0.0, -1.0, phase=0.1)], np.ones(3), None, integrates=True)
    # from 0.2 s to 0.31 s, by the midpoint rule
    times = 0.2 + 0.11 * (np.arange(2000) + 0.5) / 2000
    expected = np.sin(2.0 * np.pi * (1.7 * times + 0.1)).mean() * 0.11 * np.array([3.0, 0.0, -1.0])
    assert_allclose(gathered.at(0.31) - gathered.at(0.2), expected, rtol=1e-6, atol=1e-15)


def test_bandwidth_takes_of_a_vibration_what_it_takes_at_its_own_frequency() -> None:
    # at the corner: 1 / sqrt 2 of it, an eighth of a turn late
    # at the scale of the package; a seed draws its phases and those of the quantizer's marks
    scaled, draws = model(scale_factor=SCALE, phase=BIAS), Draws("gyro", True, (tone(4.0, 1, 1, 1),), 4.0)
    drawn = add_drawn_phases(scaled, draws, 3)
    found, phases = drawn.vibration, uniform_phase(3, "vibration 0 of gyro", 3)
    assert found is not None
    assert_allclose(found.amplitude, [(1.0 + SCALE) / np.sqrt(2.0)])
    assert_allclose(found.phase, [2.0 * np.pi * phases - np.pi / 4.0])
    assert_array_equal(drawn.phase, BIAS + uniform_phase(3, "gyro", 3))
