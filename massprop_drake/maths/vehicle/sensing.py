r"""Errors of rate gyros and integrating accelerometers, one sample at a time.

In the order a signal meets them: scale factor, first-order bandwidth, bias with random walk,
white noise, quantization, range; a delay of whole samples last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array, cross


def increment_noise(reading_variance: float) -> Array:
    """Covariance of the difference of two readings (2-64b), (3-36b), without disturbance, shape (3, 3).

    Args:
        reading_variance: of the error of one reading per component.
    """
    return 2.0 * reading_variance * np.eye(3)


def unsaturated(reading: Array, limit: float) -> Array:
    """A reading, or NaN throughout where a component has reached the sensor's range.

    Args:
        reading: shape (3,).
        limit: largest reading either way; infinity: unlimited.
    """
    if limit < math.inf and not bool((np.abs(reading) < limit).all()):
        return np.full(3, np.nan)
    return reading


def quantized(value: Array, quantum: float, phase: Array) -> Array:
    """The nearest mark of a quantizer, its marks ``phase`` quanta (within 1/2) off the multiples.

    The error lies within half a quantum either way, with a mean of zero over random phases. A quantum
    of zero leaves the value as it is.
    """
    if quantum == 0.0:
        return value
    return (np.rint(value / quantum + phase) - phase) * quantum


def smoothing_factor(bandwidth_hz: float | None, period_s: float) -> float:
    """Share of the old value that a first-order low-pass keeps over one period; 0: unlimited.

    Args:
        bandwidth_hz: corner frequency, Hz; None: unlimited.
        period_s: sample period, s.
    """
    return 0.0 if bandwidth_hz is None else math.exp(-2.0 * math.pi * bandwidth_hz * period_s)


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

    @property
    def memory_size(self) -> int:
        """Length of the memory vector."""
        return 10 + 3 * self.delay

    @property
    def remembers(self) -> bool:
        """Whether a reading depends on anything but the signal and the noise now."""
        drifts = self.walk_std > 0.0 or (self.integrates and bool(self.bias.any()))
        return self.smoothing > 0.0 or drifts or self.delay > 0

    @property
    def noisy(self) -> bool:
        """Whether noise is drawn."""
        return self.noise_std > 0.0 or self.walk_std > 0.0

    def read(self, value: Array) -> Array:
        """A noisy value quantized and held within the range, shape (3,)."""
        reading = quantized(value, self.quantum, self.phase)
        return reading if self.limit == math.inf else np.clip(reading, -self.limit, self.limit)


def sense(signal: Array, memory: Array, noise: Array, model: SensorModel) -> tuple[Array, Array]:
    """One reading, and what to remember for the next.

    Args:
        signal: the true quantity, shape (3,).
        memory: started (1, 0 or 1), low-passed signal (3), bias's random walk (3), accumulated bias (3),
            then the readings of the last ``delay`` samples, oldest first, shape (memory_size,).
        noise: standard normal: white (3), random walk (3), shape (6,).
        model: see `SensorModel`.
    """
    started = bool(memory[0])
    value = (1.0 + model.scale_factor) * signal
    if started:
        value = value + model.smoothing * (memory[1:4] - value)
    after = memory.copy()
    after[0] = 1.0
    after[1:4] = value
    walk = memory[4:7]
    if model.integrates:
        value = value + memory[7:10]
        after[7:10] = memory[7:10] + (model.bias + walk) * model.period_s
    else:
        value = value + (model.bias + walk)
    after[4:7] = walk + model.walk_std * noise[3:]
    reading = model.read(value + model.noise_std * noise[:3])
    if model.delay:
        # before the start the reading is taken to have been the first
        line = memory[10:] if started else np.tile(reading, model.delay)
        after[10:] = np.concatenate([line[3:], reading])
        reading = line[:3]
    return reading, after


def point_velocity(origin_velocity: Array, rate: Array, spin_integral: Array, position: Array) -> Array:
    r"""What an ideal integrating accelerometer has gathered at a point fixed in the body.

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
    xx, yy, zz, yz, xz, xy = spin_integral.tolist()
    x, y, z = position.tolist()
    centripetal = np.array(
        [
            xy * y + xz * z - (yy + zz) * x,
            xy * x + yz * z - (xx + zz) * y,
            xz * x + yz * y - (xx + yy) * z,
        ]
    )
    return origin_velocity + cross(rate, position) + centripetal
