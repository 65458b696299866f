r"""Errors of rate gyros and integrating accelerometers, one sample at a time.

In the order a signal meets them: vibration of the structure, scale factor, first-order bandwidth, bias
with random walk, white noise, quantization, range; a delay of whole samples last.

What the rigid body does is known at the samples and taken as linear between them. Vibration is faster than
that, so it is reckoned at its own frequency and sampled as it is: from half the sample frequency on, a reading
shows it at another (aliasing).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel, numbers
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import Seed, uniform_phase


def increment_noise(reading_variance: float) -> Array:
    """Computes the covariance of a change between readings (2-64b), (3-36b), without disturbance, (3, 3).

    Args:
        reading_variance: of the error of one reading per component.
    """
    return 2.0 * reading_variance * np.eye(3)


@kernel
def mask_saturated(reading: Array, limit: float) -> Array:
    """Returns a reading, or NaN in all components where one has reached the sensor's range.

    Args:
        reading: shape (3,).
        limit: largest reading either way; infinity: unlimited.
    """
    if limit < math.inf and not bool((np.abs(reading) < limit).all()):
        return np.full(3, np.nan)
    return reading


@kernel
def nearest_mark(value: Array, quantum: Any, phase: Array) -> Array:
    """Rounds a value to the nearest mark of a quantizer; marks lie ``phase`` quanta (within 1/2) off the multiples.

    The error lies within half a quantum either way, with a mean of zero over random phases.

    Args:
        value: shape (..., 3).
        quantum: positive, a number or shape (..., 1).
        phase: shape (..., 3).
    """
    return (np.rint(value / quantum + phase) - phase) * quantum


@kernel
def quantize(value: Array, quantum: float, phase: Array) -> Array:
    """Quantizes a value to the nearest mark, see `nearest_mark`; a quantum of zero leaves it as it is."""
    return value if quantum == 0.0 else nearest_mark(value, quantum, phase)


def smoothing_factor(bandwidth_hz: float | None, period_s: float) -> float:
    """Computes the share of its old output that a first-order low-pass keeps over a period; 0: no low-pass.

    Args:
        bandwidth_hz: corner frequency, Hz; None: unlimited.
    """
    return 0.0 if bandwidth_hz is None else math.exp(-2.0 * math.pi * bandwidth_hz * period_s)


@kernel
def low_pass(value: Array, memory: Array, started: bool, smoothing: float) -> tuple[Array, Array]:
    """Computes a first-order low-pass's output for a signal linear between samples; returns it, and its memory.

    Exact for such a signal: at a corner of w rad/s and a period T the answer to a ramp is late by 1 / w.

    Args:
        value: of the signal now, shape (3,).
        memory: the memory, shape (3,): the answer now, had the signal gone to zero since the last sample.
        started: whether there was a sample before; if not, the signal is taken to have been steady.
        smoothing: share of the old value that is kept over one period, exp(-w T); 0: unlimited.
    """
    if smoothing == 0.0:
        return value, np.zeros(3)
    mean = (smoothing - 1.0) / math.log(smoothing)  # of the share that is kept, over the period
    answer = memory + (1.0 - mean) * value if started else value
    return answer, smoothing * answer + (mean - smoothing) * value


class Tone(NamedTuple):
    """Vibration of one frequency at a package of sensors.

    Attributes:
        frequency_hz: Hz.
        amplitude: of the rate, rad/s, or of the acceleration, ft/s^2 or m/s^2, shape (3,).
        phase: in turns, shape (3,).
    """

    frequency_hz: float
    amplitude: Array
    phase: Array


class Vibration(NamedTuple):
    """Vibration in the readings of a package, before bias and noise.

    Attributes:
        frequency: of each tone, rad/s, shape (n,).
        amplitude: in the reading's unit, shape (n, 3).
        phase: rad, shape (n, 3).
    """

    frequency: Array
    amplitude: Array
    phase: Array

    def at(self, time_s: float) -> Array:
        """Computes the vibration in a reading at a time, the sum of its tones, shape (3,)."""
        angles = (self.frequency * time_s)[:, None] + self.phase
        return (self.amplitude * np.sin(angles)).sum(axis=0)


def make_vibration(tones: Sequence[Tone], scale: Array, bandwidth_hz: float | None, *, integrates: bool) -> Vibration:
    """Makes the `Vibration` of readings from tones at the sensor: scaled, integrated, low-passed at their frequency.

    Args:
        tones: at the sensors.
        scale: reading over truth per axis, shape (3,).
        bandwidth_hz: corner of a first-order low-pass, Hz; None: unlimited.
        integrates: whether a reading is the integral of what is given, as in an integrating accelerometer.
    """
    gains = []
    for tone in tones:
        gain = 1.0 + 0.0j if bandwidth_hz is None else 1.0 / complex(1.0, tone.frequency_hz / bandwidth_hz)
        gains.append(gain / complex(0.0, 2.0 * math.pi * tone.frequency_hz) if integrates else gain)
    return Vibration(
        frequency=np.array([2.0 * math.pi * tone.frequency_hz for tone in tones]),
        amplitude=np.array([abs(g) * scale * tone.amplitude for g, tone in zip(gains, tones, strict=True)]),
        phase=np.array([cmath.phase(g) + 2.0 * math.pi * tone.phase for g, tone in zip(gains, tones, strict=True)]),
    )


class SensorModel(NamedTuple):
    """Errors of one package of three sensors along the body axes.

    Attributes:
        period_s: sample period, s.
        scale_factor: relative error per axis, shape (3,).
        smoothing: share of the old value that the bandwidth keeps per sample, 0: unlimited.
        bias: constant bias of the reading or, if ``integrates``, of its time derivative, shape (3,).
        walk_std: 1-sigma of the bias's random walk over one sample.
        integrates: whether the bias accumulates, as in an integrating accelerometer.
        noise_std: white noise of a reading, 1-sigma.
        quantum: step of a reading; 0: none.
        phase: where the quantizer's marks lie, in quanta, within 1/2, shape (3,).
        delay: samples by which a reading is late.
        limit: largest reading either way; infinity: unlimited.
        vibration: of the structure, as readings show it; None: there is none.
    """

    period_s: float
    scale_factor: Array
    smoothing: float
    bias: Array
    walk_std: float
    integrates: bool
    noise_std: float
    quantum: float
    phase: Array
    delay: int
    limit: float = math.inf
    vibration: Vibration | None = None

    @property
    def memory_size(self) -> int:
        """Length of the memory vector."""
        return 10 + 3 * self.delay

    @property
    def remembers(self) -> bool:
        """True if readings depend on earlier ones: low-pass, random walk, accumulated bias or delay."""
        drifts = self.walk_std > 0.0 or (self.integrates and bool(self.bias.any()))
        return self.smoothing > 0.0 or drifts or self.delay > 0

    @property
    def noisy(self) -> bool:
        """True if noise is drawn."""
        return self.noise_std > 0.0 or self.walk_std > 0.0

    @property
    def exact(self) -> bool:
        """True if a reading without memory is the signal itself, quantized and within the range."""
        return not (self.scale_factor.any() or self.bias.any() or self.noisy or self.vibration)

    @property
    def errors(self) -> PackageErrors:
        """Errors that make a reading."""
        return PackageErrors._make(getattr(self, name) for name in PackageErrors._fields)


class PackageErrors(NamedTuple):
    """The part of a `SensorModel` that makes a reading once vibration is known; attributes as there."""

    period_s: float
    scale_factor: Array
    smoothing: float
    bias: Array
    walk_std: float
    integrates: bool
    noise_std: float
    quantum: float
    phase: Array
    delay: int
    limit: float


class Draws(NamedTuple):
    """Random draws of a package, made by the seed before its first sample.

    Attributes:
        name: of the package.
        marks: whether the phase of the quantizer is drawn.
        tones: of vibration, whose phases are.
        bandwidth_hz: corner of the package's low-pass, Hz; None: unlimited.
    """

    name: str
    marks: bool
    tones: tuple[Tone, ...] = ()
    bandwidth_hz: float | None = None


def add_drawn_phases(model: SensorModel, draws: Draws, seed: Seed) -> SensorModel:
    """Adds phases of quantizer and vibration tones, drawn by a seed, to a package's sensor model.

    Args:
        model: with the phases before the draw.
    """
    phase, shaking = model.phase, model.vibration
    if draws.marks:
        phase = phase + uniform_phase(seed, draws.name, 3)
    if draws.tones:
        tones = [
            tone._replace(phase=uniform_phase(seed, f"vibration {number} of {draws.name}", 3))
            for number, tone in enumerate(draws.tones)
        ]
        shaking = make_vibration(tones, 1.0 + model.scale_factor, draws.bandwidth_hz, integrates=model.integrates)
    return model._replace(phase=phase, vibration=shaking)


_STILL = np.empty(0)  # vibration where there is none


@kernel
def limit_to_range(reading: Array, limit: float) -> Array:
    """Clips each component of a reading to within plus and minus a sensor's range."""
    return reading if limit == math.inf else np.minimum(np.maximum(reading, -limit), limit)


def sense(signal: Array, memory: Array, noise: Array, model: SensorModel, time_s: float = 0.0) -> tuple[Array, Array]:
    """Computes a package's reading, shape (3,), from the true signal, and its memory for the next.

    Args:
        signal: the true quantity, shape (3,).
        memory: started (1, 0 or 1), memory of the low-pass (3), bias's random walk (3), accumulated bias (3),
            then the readings of the last ``delay`` samples, oldest first, shape (memory_size,).
        noise: standard normal: white (3), random walk (3), shape (6,).
        time_s: of the sample, s; matters to vibration alone.
    """
    return read_with_memory(signal, memory, noise, vibration_at(model, time_s), model.errors)


def vibration_at(model: SensorModel, time_s: float) -> Array:
    """Computes vibration in a reading at a time, shape (3,); empty where there is none."""
    return _STILL if model.vibration is None else model.vibration.at(time_s)


@kernel
def read_with_memory(
    signal: Array, memory: Array, noise: Array, vibration: Array, errors: PackageErrors
) -> tuple[Array, Array]:
    """Computes a reading, (3,), and memory for the next; ``vibration``: vibration in it, shape (3,) or empty."""
    started = memory[0] != 0.0
    value = (1.0 + errors.scale_factor) * signal
    after = memory.copy()
    after[0] = 1.0
    value, after[1:4] = low_pass(value, memory[1:4], started, errors.smoothing)
    if vibration.size:
        value = value + vibration
    walk = memory[4:7]
    if errors.integrates:
        value = value + memory[7:10]
        after[7:10] = memory[7:10] + (errors.bias + walk) * errors.period_s
    else:
        value = value + (errors.bias + walk)
    after[4:7] = walk + errors.walk_std * noise[3:]
    reading = _quantize_and_limit(value + errors.noise_std * noise[:3], errors)
    if not errors.delay:
        return reading, after
    line = memory[10:].copy()
    if not started:  # before the start the reading is taken to have been the first
        for begin in range(0, line.size, 3):
            line[begin : begin + 3] = reading
    after[10:-3], after[-3:] = line[3:], reading
    return line[:3], after


@kernel
def read_without_memory(signal: Array, noise: Array, vibration: Array, errors: PackageErrors) -> Array:
    """Computes a reading, (3,), of a package without memory; ``vibration``: vibration in it, (3,) or empty."""
    value = (1.0 + errors.scale_factor) * signal
    if vibration.size:
        value = value + vibration
    value = value + errors.bias
    if errors.noise_std > 0.0:
        value = value + errors.noise_std * noise[:3]
    return _quantize_and_limit(value, errors)


@kernel
def _quantize_and_limit(value: Array, errors: PackageErrors) -> Array:
    """Quantizes a value and clips it to the sensor's range, shape (3,)."""
    return limit_to_range(quantize(value, errors.quantum, errors.phase), errors.limit)


class TruePackage(NamedTuple):
    """True package of sensors.

    Attributes:
        name: of it, and of its noise.
        model: its errors.
        position: of an integrating accelerometer, vehicle frame, ft or m, shape (3,); None: a rate gyro.
    """

    name: str
    model: SensorModel
    position: Array | None


@kernel
def point_velocity(origin_velocity: Array, rate: Array, spin_integral: Array, position: Array) -> Array:
    r"""Computes the velocity that an ideal integrating accelerometer at a body-fixed point measures, shape (3,).

    The time integral, in body axes, of the specific force at the point (3-17):

        V = V_O + w x r' + (integral of [w x]^2 dt) r'

    with r' the point in the vehicle frame. The constant of integration is chosen so that a body
    turning at a constant rate from the start has w_0 x r' at t = 0; only differences matter.

    Args:
        origin_velocity: the integral of the specific force at the origin of the vehicle frame, less
            the integral of dw/dt x 0; ft/s or m/s, shape (3,).
        rate: w, rad/s, body axes, shape (3,).
        spin_integral: integral of w w^T dt as xx, yy, zz, yz, xz, xy, rad^2/s, shape (6,).
        position: r', ft or m, shape (3,).
    """
    xx, yy, zz, yz, xz, xy = numbers(spin_integral, 6)
    wx, wy, wz = numbers(rate, 3)
    vx, vy, vz = numbers(origin_velocity, 3)
    x, y, z = numbers(position, 3)
    return np.array(
        [
            vx + (wy * z - wz * y) + (xy * y + xz * z - (yy + zz) * x),
            vy + (wz * x - wx * z) + (xy * x + yz * z - (xx + zz) * y),
            vz + (wx * y - wy * x) + (xz * x + yz * y - (xx + yy) * z),
        ]
    )
