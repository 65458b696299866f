"""Sensors of a vehicle's file, and what is read besides: reaction wheels and engines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from pydantic import field_validator, model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import (
    Model,
    Name,
    NotNegative,
    Positive,
    Real,
    RelativeSigma,
    Vector3,
    described,
    field_validation_error,
)
from massprop_drake.inputs.vehicle_parts import UnitVector

_SENSOR_NAME = r"^[A-Za-z][A-Za-z0-9_]*$"
_RANGE = "reading either way at which the sensor saturates, skipped by filters; null: unlimited"
_APART = 0.1  # sine of the angle between two axes: arithmetic, beyond it they count as two
_FASTEST_WHEEL = 1e3  # rad/s^2, physics: no motor accelerates a wheel by more
_OVER_S = 10.0  # for which times of readings are counted


def distinct_times_per_s(rates_hz: Sequence[float]) -> float:
    """Counts the distinct reading times of sensors at several rates, 1/s, all being read at zero."""
    times_s = np.concatenate([np.arange(math.ceil(_OVER_S * rate)) / rate for rate in set(rates_hz)])
    return float(np.unique(np.round(times_s, 6)).size) / _OVER_S


_EACH_SAMPLE = "rate of readings; null: every sample"


class SensorPackage(Model):
    """A package of three sensors along the body axes: the fields common to gyros and accelerometers."""

    name: Name = described(
        ..., "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z", pattern=_SENSOR_NAME
    )
    quantum: NotNegative = described(0.0, "step of a reading", "rad/s | ft/s | m/s")
    noise_std: NotNegative = described(0.0, "white noise of a reading, 1-sigma", "rad/s | ft/s | m/s")
    bias_std: NotNegative = described(0.0, "1-sigma of a constant bias", "rad/s | ft/s^2 | m/s^2")
    range: Positive | None = described(None, _RANGE, "rad/s | ft/s | m/s")
    rate_hz: Positive | None = described(None, _EACH_SAMPLE, "1/s", span=plausible.FREQUENCY)

    @model_validator(mode="after")
    def _require_reading_error(self) -> SensorPackage:
        """Raises ValueError for a sensor without quantum and noise."""
        if self.quantum == 0.0 and self.noise_std == 0.0:
            raise ValueError(
                f"sensor '{self.name}' needs a quantum or a noise_std above zero: a filter cannot use a perfect sensor"
            )
        return self

    @property
    def variance(self) -> float:
        """Variance of the error of one reading, quantum^2 / 12 + noise_std^2, in the reading's unit squared."""
        return self.quantum**2 / 12.0 + self.noise_std**2

    @property
    def limit(self) -> float:
        """Largest reading either way, where the sensor saturates; infinity: unlimited."""
        return math.inf if self.range is None else self.range


class Gyro(SensorPackage):
    """A package of three rate gyros."""

    bias_std: NotNegative = described(
        0.0, "1-sigma of a constant bias per axis, estimated by filter: joint", "rad/s", span=plausible.RATE_STEP
    )

    quantum: NotNegative = described(0.0, "step of a reading", "rad/s", span=plausible.RATE_STEP)
    noise_std: NotNegative = described(0.0, "white noise of a reading, 1-sigma", "rad/s", span=plausible.RATE_STEP)
    range: Positive | None = described(None, _RANGE, "rad/s", span=plausible.RATE)


class Accelerometer(SensorPackage):
    """A package of three integrating accelerometers."""

    position: Vector3 = described(..., "place in the vehicle frame", "ft | m", span=plausible.POSITION)
    bias_std: NotNegative = described(
        0.0,
        "1-sigma of a constant bias per axis, estimated by filter: joint",
        "ft/s^2 | m/s^2",
        span=plausible.ACCELERATION,
    )
    quantum: NotNegative = described(0.0, "step of a reading", "ft/s | m/s", span=plausible.VELOCITY_STEP)
    noise_std: NotNegative = described(
        0.0, "white noise of a reading, 1-sigma", "ft/s | m/s", span=plausible.VELOCITY_STEP
    )
    range: Positive | None = described(None, _RANGE, "ft/s | m/s", span=plausible.VELOCITY)


class PoseSensor(Model):
    """A sensor of position and attitude in a fixed frame, such as motion capture, or of one of them."""

    name: Name = described(
        ...,
        "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z and, of the "
        "quaternion from body to fixed frame, _qw, _qx, _qy, _qz",
        pattern=_SENSOR_NAME,
    )
    position_std: Positive | None = described(
        None, "white noise of each coordinate, 1-sigma; null: not measured", "ft | m", span=plausible.POSITION
    )
    attitude_std: Real | None = described(
        None, "white noise about each axis, 1-sigma; null: not measured", "rad", gt=0.0, le=1.0
    )
    time_std_s: NotNegative = described(0.0, "white error of the stamps, 1-sigma", "s", span=plausible.PERIOD)
    outliers: RelativeSigma = described(0.0, "share of poor samples, ten times as noisy")
    point: Vector3 = described(
        (0.0, 0.0, 0.0), "point whose position is measured, vehicle frame", "ft | m", span=plausible.POSITION
    )
    point_std: NotNegative = described(
        0.0, "1-sigma of each coordinate, then estimated; 0: known", "ft | m", span=plausible.POSITION
    )
    rate_hz: Positive | None = described(None, _EACH_SAMPLE, "1/s", span=plausible.FREQUENCY)

    @model_validator(mode="after")
    def _require_measurement(self) -> PoseSensor:
        """Raises ValueError for a sensor of neither position nor attitude."""
        if self.position_std is None and self.attitude_std is None:
            raise ValueError(f"sensor '{self.name}' measures nothing: give position_std, attitude_std or both")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in telemetry: three of the position, four of the quaternion."""
        return (*(f"{self.name}_{axis}" for axis in "xyz"), *(f"{self.name}_q{part}" for part in "wxyz"))


class VelocitySensor(Model):
    """A sensor of velocity in the fixed frame."""

    name: Name = described(
        ..., "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z", pattern=_SENSOR_NAME
    )
    noise_std: Positive = described(
        ..., "white noise of each component, 1-sigma", "ft/s | m/s", span=plausible.VELOCITY_STEP
    )
    position: Vector3 = described(
        (0.0, 0.0, 0.0), "point whose velocity is measured, vehicle frame", "ft | m", span=plausible.POSITION
    )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the three columns of velocity in telemetry."""
        return tuple(f"{self.name}_{axis}" for axis in "xyz")


class Wheel(Model):
    """A reaction wheel, whose speed relative to the vehicle is read.

    The vehicle's mass properties are those with its wheels locked.
    """

    name: Name = described(..., "unique name, likewise; telemetry column <name>_speed, rad/s", pattern=_SENSOR_NAME)
    axis: UnitVector = described(..., "axis of positive speed, body axes, length 1")
    inertia: Positive = described(..., "inertia about its axis", "slug-ft^2 | kg-m^2", span=plausible.WHEEL)
    inertia_uncertainty: RelativeSigma = described(0.01, "1-sigma of the inertia, relative, estimated; 0: known")
    quantum: NotNegative = described(0.0, "step of a reading of its speed", "rad/s", span=plausible.SPEED_STEP)
    noise_std: NotNegative = described(0.01, "white noise of a reading, 1-sigma", "rad/s", span=plausible.SPEED_STEP)
    torque: Positive | None = described(
        None,
        "largest torque of its motor, used where readings are missing; null: 1000 rad/s in a second",
        "ft-lbf | N-m",
        span=plausible.OUTSIDE_TORQUE,
    )
    rate_hz: Positive | None = described(None, _EACH_SAMPLE, "1/s", span=plausible.FREQUENCY)

    speed_limit: Positive | None = described(None, "largest speed either way; null: any", "rad/s", span=plausible.SPIN)

    @model_validator(mode="after")
    def _require_reading_error(self) -> Wheel:
        """Raises ValueError for a wheel without quantum and noise."""
        if self.quantum == 0.0 and self.noise_std == 0.0:
            raise ValueError(f"wheel '{self.name}' needs a quantum or a noise_std above zero: no reading is perfect")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Name of the column of the speed in telemetry, a tuple of one."""
        return (f"{self.name}_speed",)

    @property
    def speed_std(self) -> float:
        """1-sigma of the error of one reading, rad/s."""
        return math.sqrt(self.quantum**2 / 12.0 + self.noise_std**2)

    @property
    def fastest(self) -> float:
        """Largest speed either way, rad/s; infinity: any."""
        return math.inf if self.speed_limit is None else self.speed_limit

    @property
    def most_acceleration(self) -> float:
        """Acceleration by the largest torque, rad/s^2."""
        return _FASTEST_WHEEL if self.torque is None else self.torque / self.inertia


class Gimbal(Model):
    """A gimbal that turns an engine about two axes."""

    axes: tuple[UnitVector, UnitVector] = described(
        ..., "axes at zero, body axes, length 1; the second turns along with the first"
    )
    stop: Real = described(..., "largest angle either way", "rad", gt=0.0, le=math.pi / 2.0)
    rate: Real = described(
        1.0, "largest change of an angle per second, used where readings are missing", "rad/s", gt=0.0, le=100.0
    )
    time_constant_s: NotNegative = described(0.0, "lag behind a command", "s", span=plausible.VALVE)
    noise_std: RelativeSigma = described(0.001, "error of a reading, 1-sigma", "rad")

    @field_validator("axes")
    @classmethod
    def _require_distinct_axes(cls, value: tuple[Vector3, Vector3]) -> tuple[Vector3, Vector3]:
        """Raises ValueError where the two axes are parallel."""
        if float(np.linalg.norm(np.cross(*value))) < _APART:
            raise ValueError("the two axes must not be parallel: a gimbal turns about both")
        return value


class ImpulseAtLevel(Model):
    """The specific impulse of an engine at one level of its throttle."""

    level: Real = described(..., "level, 1: full thrust", gt=0.0, le=1.0)
    specific_impulse_s: Positive = described(..., "specific impulse there", "s", span=plausible.SPECIFIC_IMPULSE)


class RocketEngine(Model):
    """An engine with a throttle, on a gimbal or fixed.

    Its force is not in the jets' commands, and its error has no part in their common one: it shows a scale, as wheels
    do, to as much as its own thrust is known.
    """

    name: Name = described(
        ...,
        "unique name, likewise; telemetry columns <name>_level and, with a gimbal, _gimbal_1 and _gimbal_2, rad",
        pattern=_SENSOR_NAME,
    )
    position: Vector3 = described(..., "where its force acts, vehicle frame", "ft | m", span=plausible.POSITION)
    direction: UnitVector = described(
        ..., "direction of the force on the vehicle with the gimbal at zero, body axes, length 1"
    )
    thrust: Positive = described(..., "force at level 1", "lbf | N", span=plausible.FORCE)
    thrust_uncertainty: RelativeSigma = described(
        0.01, "1-sigma of the thrust at levels 0 and 1, relative, linear in between; estimated"
    )
    direction_std: RelativeSigma = described(0.005, "1-sigma of the direction about either axis, estimated", "rad")
    position_std: NotNegative = described(
        0.0, "1-sigma of the force's place across its direction, estimated", "ft | m", span=plausible.POSITION
    )
    specific_impulse_s: Positive | tuple[ImpulseAtLevel, ...] = described(
        ..., "specific impulse, or a list by rising level, linear in between", "s"
    )
    level_rate: Real = described(
        10.0, "largest change of the level per second, used where readings are missing", "1/s", gt=0.0, le=1e4
    )
    level_time_constant_s: NotNegative = described(0.0, "lag behind a command", "s", span=plausible.VALVE)
    level_noise_std: RelativeSigma = described(0.002, "error of a reading, 1-sigma, relative to it")
    least_level: Real = described(0.0, "a reading below it means that the engine is shut", ge=0.0, lt=1.0)
    gimbal: Gimbal | None = described(None, "its gimbal; null: fixed")
    telemetry: Literal["measured", "commanded"] = described(
        "measured",
        "measured: values at a sample, linear in between; commanded: values from the sample on, followed "
        "by the time constants and rates above",
    )

    @model_validator(mode="after")
    def _require_possible_levels_and_axes(self) -> RocketEngine:
        """Raises ValidationError where throttle levels do not rise, or a gimbal axis lies along the force."""
        if isinstance(self.specific_impulse_s, tuple):
            levels = [point.level for point in self.specific_impulse_s]
            if not levels or any(low >= high for low, high in pairwise(levels)):
                raise field_validation_error(
                    [(("specific_impulse_s",), "levels must rise, and there must be one at least")]
                )
        if self.gimbal is not None:
            normals = np.cross(self.gimbal.axes, self.direction)
            if float(np.linalg.norm(normals, axis=1).min()) < _APART:
                problem = "an axis along the engine's direction does not turn its force"
                raise field_validation_error([(("gimbal", "axes"), problem)])
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in telemetry: level and, with a gimbal, two angles."""
        of_gimbal = () if self.gimbal is None else (f"{self.name}_gimbal_1", f"{self.name}_gimbal_2")
        return (f"{self.name}_level", *of_gimbal)

    @property
    def impulses(self) -> tuple[tuple[float, float], ...]:
        """Levels and the specific impulse at each, s."""
        stated = self.specific_impulse_s
        if isinstance(stated, tuple):
            return tuple((point.level, point.specific_impulse_s) for point in stated)
        return ((1.0, stated),)
