"""Vehicles: jets, nominal mass properties and sensors, read from YAML and validated."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, create_model, field_validator, model_validator

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import plausible
from massprop_drake.inputs.kinds import bundled, require_kind, require_named
from massprop_drake.inputs.model import (
    Matrix3,
    Model,
    Name,
    Real,
    Text,
    Vector3,
    Whole,
    described,
    none_negative,
    refusal,
    validated,
)
from massprop_drake.inputs.moving import MovingPart, not_followed
from massprop_drake.inputs.yaml import Document, FieldPath, exists, read_text
from massprop_drake.maths.mass_properties import MassProperties, could_be_inertia, six_elements, symmetric
from massprop_drake.maths.vehicle.depletion import Tanks, emptied
from massprop_drake.maths.vehicle.on_times import Place
from massprop_drake.maths.vehicle.thrust import thrust_wrenches
from massprop_drake.signals import SIGNALS

Array = NDArray[np.float64]

STANDARD_GRAVITY = {"us": plausible.GRAVITY / plausible.FOOT, "si": plausible.GRAVITY}  # ft/s^2, m/s^2
UNITS = {"us": {"length": "ft", "mass": "slug", "force": "lbf"}, "si": {"length": "m", "mass": "kg", "force": "N"}}
# names that a sensor may not have: of signals and telemetry columns, and of ports and systems beside it
_RESERVED = {
    *SIGNALS,
    *("time_s", "file", "jet", "known_force", "known_torque"),
    *("reaction_jets", "rigid_body", "disturbance", "noise_source", "noise_seed"),
    *("reaction_wheels", "wheels", "wheel_speeds", "wheel_torque", "engines", "engine_command", "engine_state"),
    *("propellant", "drained"),
    *("body_state", "structure", "mass_properties"),
    *("telemetry_source", "record_time"),
    *("closed", "held_closed", "command", "held_command", "held_command_onset", "jet_commands"),
    *("impulses", "turning", "evidence"),
    *("outside_wrench", "mean_level", "predicted", "published", "replacement"),
    *("estimate", "covariance", "innovation", "innovation_covariance", "status", "adaptation", "reconfiguration"),
}
_RESERVED_BEGINNINGS = ("rotation_", "mass_", "joint_", "predicted_", "detector_")
_SENSOR_NAME = r"^[A-Za-z][A-Za-z0-9_]*$"
_RANGE = "reading either way at which the sensor saturates, skipped by filters; null: unlimited"
_UNIT_LENGTH_TOLERANCE = 0.002  # of a direction, as printed tables have it
_LARGEST_NUMBER = 1_000_000  # of a jet or a cluster
_WITHOUT_RATES = "without measured rates neither inertia nor center of mass can be estimated"
_MOST_JETS = 500  # several times what any vehicle has
_APART = 0.1  # sine of the angle between two axes: arithmetic, beyond it they count as two
_FASTEST_WHEEL = 1e3  # rad/s^2, physics: no motor accelerates a wheel by more


_Fixable = Literal["Ixx_inv", "Iyy_inv", "Izz_inv", "Iyz_inv", "Ixz_inv", "Ixy_inv", "x_cm", "y_cm", "z_cm", "m_inv"]
PositiveReal = Annotated[Real, Field(gt=0.0)]
Positive3 = tuple[PositiveReal, PositiveReal, PositiveReal]


def _of_length_1(value: Vector3) -> Vector3:
    """Returns the direction as it is; raises ValueError if it is none."""
    length = float(np.linalg.norm(value))
    if abs(length - 1.0) > _UNIT_LENGTH_TOLERANCE:
        raise ValueError(f"must have length 1 within {_UNIT_LENGTH_TOLERANCE}, got {length:.6g}")
    return value


def symmetric_inertia(value: Matrix3) -> Matrix3:
    """Returns the inertia as it is; raises ValueError if it is not symmetric."""
    inertia = np.array(value)
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=0.0):
        raise ValueError("must be symmetric: element (i, j) equal to element (j, i)")
    return value


class MassPropertiesModel(Model):
    """Mass, center of mass and inertia of a rigid body, as a file gives them."""

    mass: Real = described(..., "mass", "slug | kg", gt=0.0, span=plausible.MASS)
    center_of_mass: Vector3 = described(..., "center of mass, vehicle frame", "ft | m", span=plausible.POSITION)
    inertia: Matrix3 = described(
        ...,
        "inertia matrix about the center of mass, body axes; products are its entries (negative integrals)",
        "slug-ft^2 | kg-m^2",
        span=plausible.INERTIA,
    )

    @field_validator("inertia")
    @classmethod
    def _possible(cls, value: Matrix3) -> Matrix3:
        inertia = np.array(symmetric_inertia(value))
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 1e-9 * moments[2]:
            raise ValueError(
                f"must be positive definite; its principal moments are {', '.join(f'{m:.6g}' for m in moments)}"
            )
        if not could_be_inertia(inertia):
            raise ValueError(
                "no rigid body has this inertia: a principal moment exceeds the sum of the other two "
                f"({', '.join(f'{m:.6g}' for m in moments)})"
            )
        return value

    def properties(self) -> MassProperties:
        """Returns the mass properties as arrays."""
        return MassProperties(self.mass, np.array(self.center_of_mass), np.array(self.inertia))


class JetKind(Model):
    """The properties that jets of one kind share."""

    nominal_thrust: Real = described(
        ..., "thrust without plume impingement, for the propellant flow", "lbf | N", gt=0.0, span=plausible.FORCE
    )
    specific_impulse_s: Real = described(
        ..., "specific impulse; flow = thrust / (g0 x this)", "s", gt=0.0, span=plausible.SPECIFIC_IMPULSE
    )
    time_constant_s: Real = described(
        0.0, "first-order time constant of build-up and tail-off", "s", ge=0.0, span=plausible.VALVE
    )
    minimum_on_time_s: Real = described(0.0, "shortest firing", "s", ge=0.0, span=plausible.VALVE)
    on_time_quantum_s: Real = described(
        0.0,
        "step of the valve's clock, for `autopilot.jet_selection.output: on_time`",
        "s",
        ge=0.0,
        span=plausible.VALVE,
    )
    thrust_uncertainty: Real = described(
        0.01,
        "1-sigma of each jet's constant thrust error, relative; for filter: joint, like the next four",
        ge=0.0,
        le=0.3,
    )
    direction_std: Real = described(
        0.0, "1-sigma of a jet's direction about either axis, estimated", "rad", ge=0.0, le=0.3
    )
    position_std: Real = described(
        0.0, "1-sigma of the force's place across its direction, estimated", "ft | m", ge=0.0, span=plausible.POSITION
    )
    lag_uncertainty: Real = described(0.2, "1-sigma of the time constant, relative, one error per kind", ge=0.0, le=1.0)
    repeatability: Real = described(0.0, "1-sigma of a jet's impulse over a sample, relative, white", ge=0.0, le=1.0)
    command_delay_s: Real = described(
        0.0,
        "delay from command to action; negative where records pair readings with a command already in "
        "force; for filter: pose, like all below",
        "s",
        span=plausible.VALVE,
    )
    command_delay_std_s: Real = described(
        0.0,
        "its 1-sigma, one error per kind; 0: known, unless a record contradicts it",
        "s",
        ge=0.0,
        span=plausible.VALVE,
    )
    opening_delay_s: Real = described(
        0.0,
        "delay of opening beyond that of closing; negative: pulses are longer than commanded",
        "s",
        span=plausible.VALVE,
    )
    opening_delay_std_s: Real = described(
        0.0, "its 1-sigma, one error per kind; 0: known", "s", ge=0.0, span=plausible.VALVE
    )
    pulse_scatter: Real = described(
        0.0, "1-sigma of a pulse's impulse, relative, one error from opening to closing", ge=0.0, le=1.0
    )


_MEANING: dict[str, Any] = {  # a word of Python, which a class cannot have as the name of a field
    "as": (
        Literal["level", "on_time"] | None,
        described(
            None,
            "level: share of thrust through the sample; on_time: full thrust for a share of the sample; null:"
            " on_time where a minimum_on_time_s is above zero and below a sample, else level",
        ),
    )
}
_Meaning: Any = create_model("_Meaning", __base__=Model, **_MEANING)


class JetCommands(_Meaning):  # type: ignore[misc] # made at run time
    """The meaning of a jet's command that is neither 0 nor 1."""

    at: Literal["start", "center", "end"] = described(
        "start", "place of an on-time in its sample where no onset is told"
    )


class Jet(Model):
    """One reaction-control jet."""

    number: Whole = described(..., "number in the vehicle's own table", ge=1, le=_LARGEST_NUMBER)
    designation: Name = described(..., "unique name, such as F1L", min_length=1)
    cluster: Whole = described(..., "cluster of neighboring, nearly parallel jets", ge=1, le=_LARGEST_NUMBER)
    kind: Name = described(..., "one of jet_kinds")
    position: Vector3 = described(..., "where it thrusts, vehicle frame", "ft | m", span=plausible.POSITION)
    direction: Vector3 = described(..., "direction of the force on the vehicle, body axes, length 1 within 0.002")
    thrust: Real = described(
        ..., "force on the vehicle, plume impingement included", "lbf | N", gt=0.0, span=plausible.FORCE
    )
    manifold: Name | None = described(None, "manifold that feeds it; null: none that can be closed")
    mass_flow: Real | None = described(
        None, "flow at full thrust; null: by its kind", "slug/s | kg/s", gt=0.0, span=plausible.FLOW
    )
    thrust_uncertainty: Real | None = described(
        None, "1-sigma of its constant thrust error, relative, as from a bench; null: that of its kind", ge=0.0, le=0.3
    )

    _unit = field_validator("direction")(_of_length_1)


_OVER_S = 10.0  # for which times of readings are counted


def times_per_s(rates_hz: Sequence[float]) -> float:
    """Counts different times a second of what recurs at several rates, from zero on."""
    every = np.concatenate([np.arange(math.ceil(_OVER_S * rate)) / rate for rate in set(rates_hz)])
    return float(np.unique(np.round(every, 6)).size) / _OVER_S


_EACH_SAMPLE = "rate of readings; null: every sample"


class SensorPackage(Model):
    """A package of three sensors along the body axes: the fields common to gyros and accelerometers."""

    name: Name = described(
        ..., "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z", pattern=_SENSOR_NAME
    )
    quantum: Real = described(0.0, "step of a reading", "rad/s | ft/s | m/s", ge=0.0)
    noise_std: Real = described(0.0, "white noise of a reading, 1-sigma", "rad/s | ft/s | m/s", ge=0.0)
    bias_std: Real = described(0.0, "1-sigma of a constant bias", "rad/s | ft/s^2 | m/s^2", ge=0.0)
    range: Real | None = described(None, _RANGE, "rad/s | ft/s | m/s", gt=0.0)
    rate_hz: Real | None = described(None, _EACH_SAMPLE, "1/s", gt=0.0, span=plausible.FREQUENCY)

    @model_validator(mode="after")
    def _noisy(self) -> SensorPackage:
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

    bias_std: Real = described(
        0.0,
        "1-sigma of a constant bias per axis, estimated by filter: joint",
        "rad/s",
        ge=0.0,
        span=plausible.RATE_STEP,
    )

    quantum: Real = described(0.0, "step of a reading", "rad/s", ge=0.0, span=plausible.RATE_STEP)
    noise_std: Real = described(0.0, "white noise of a reading, 1-sigma", "rad/s", ge=0.0, span=plausible.RATE_STEP)
    range: Real | None = described(None, _RANGE, "rad/s", gt=0.0, span=plausible.RATE)


class Accelerometer(SensorPackage):
    """A package of three integrating accelerometers."""

    position: Vector3 = described(..., "place in the vehicle frame", "ft | m", span=plausible.POSITION)
    bias_std: Real = described(
        0.0,
        "1-sigma of a constant bias per axis, estimated by filter: joint",
        "ft/s^2 | m/s^2",
        ge=0.0,
        span=plausible.ACCELERATION,
    )
    quantum: Real = described(0.0, "step of a reading", "ft/s | m/s", ge=0.0, span=plausible.VELOCITY_STEP)
    noise_std: Real = described(
        0.0, "white noise of a reading, 1-sigma", "ft/s | m/s", ge=0.0, span=plausible.VELOCITY_STEP
    )
    range: Real | None = described(None, _RANGE, "ft/s | m/s", gt=0.0, span=plausible.VELOCITY)


class PoseSensor(Model):
    """A sensor of position and attitude in a fixed frame, such as motion capture, or of one of them."""

    name: Name = described(
        ...,
        "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z and, of the "
        "quaternion from body to fixed frame, _qw, _qx, _qy, _qz",
        pattern=_SENSOR_NAME,
    )
    position_std: Real | None = described(
        None, "white noise of each coordinate, 1-sigma; null: not measured", "ft | m", gt=0.0, span=plausible.POSITION
    )
    attitude_std: Real | None = described(
        None, "white noise about each axis, 1-sigma; null: not measured", "rad", gt=0.0, le=1.0
    )
    time_std_s: Real = described(0.0, "white error of the stamps, 1-sigma", "s", ge=0.0, span=plausible.PERIOD)
    outliers: Real = described(0.0, "share of poor samples, ten times as noisy", ge=0.0, le=0.3)
    point: Vector3 = described(
        (0.0, 0.0, 0.0), "point whose position is measured, vehicle frame", "ft | m", span=plausible.POSITION
    )
    point_std: Real = described(
        0.0, "1-sigma of each coordinate, then estimated; 0: known", "ft | m", ge=0.0, span=plausible.POSITION
    )
    rate_hz: Real | None = described(None, _EACH_SAMPLE, "1/s", gt=0.0, span=plausible.FREQUENCY)

    @model_validator(mode="after")
    def _measures(self) -> PoseSensor:
        if self.position_std is None and self.attitude_std is None:
            raise ValueError(f"sensor '{self.name}' measures nothing: give position_std, attitude_std or both")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns in telemetry: those of the position, and those of the quaternion."""
        return (*(f"{self.name}_{axis}" for axis in "xyz"), *(f"{self.name}_q{part}" for part in "wxyz"))


class VelocitySensor(Model):
    """A sensor of velocity in the fixed frame."""

    name: Name = described(
        ..., "unique name of letters, digits and underscores; telemetry columns <name>_x, _y, _z", pattern=_SENSOR_NAME
    )
    noise_std: Real = described(
        ..., "white noise of each component, 1-sigma", "ft/s | m/s", gt=0.0, span=plausible.VELOCITY_STEP
    )
    position: Vector3 = described(
        (0.0, 0.0, 0.0), "point whose velocity is measured, vehicle frame", "ft | m", span=plausible.POSITION
    )

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns in telemetry."""
        return tuple(f"{self.name}_{axis}" for axis in "xyz")


class Wheel(Model):
    """A reaction wheel, whose speed relative to the vehicle is read.

    The vehicle's mass properties are those with its wheels locked.
    """

    name: Name = described(..., "unique name, likewise; telemetry column <name>_speed, rad/s", pattern=_SENSOR_NAME)
    axis: Vector3 = described(..., "axis of positive speed, body axes, length 1")
    inertia: Real = described(..., "inertia about its axis", "slug-ft^2 | kg-m^2", gt=0.0, span=plausible.WHEEL)
    inertia_uncertainty: Real = described(0.01, "1-sigma of the inertia, relative, estimated; 0: known", ge=0.0, le=0.3)
    quantum: Real = described(0.0, "step of a reading of its speed", "rad/s", ge=0.0, span=plausible.SPEED_STEP)
    noise_std: Real = described(0.01, "white noise of a reading, 1-sigma", "rad/s", ge=0.0, span=plausible.SPEED_STEP)
    torque: Real | None = described(
        None,
        "largest torque of its motor, used where readings are missing; null: 1000 rad/s in a second",
        "ft-lbf | N-m",
        gt=0.0,
        span=plausible.OUTSIDE_TORQUE,
    )
    rate_hz: Real | None = described(None, _EACH_SAMPLE, "1/s", gt=0.0, span=plausible.FREQUENCY)

    speed_limit: Real | None = described(
        None, "largest speed either way; null: any", "rad/s", gt=0.0, span=plausible.SPIN
    )

    _unit = field_validator("axis")(_of_length_1)

    @model_validator(mode="after")
    def _is_read(self) -> Wheel:
        if self.quantum == 0.0 and self.noise_std == 0.0:
            raise ValueError(f"wheel '{self.name}' needs a quantum or a noise_std above zero: no reading is perfect")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Column in telemetry."""
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

    axes: tuple[Vector3, Vector3] = described(
        ..., "axes at zero, body axes, length 1; the second turns along with the first"
    )
    stop: Real = described(..., "largest angle either way", "rad", gt=0.0, le=math.pi / 2.0)
    rate: Real = described(
        1.0, "largest change of an angle per second, used where readings are missing", "rad/s", gt=0.0, le=100.0
    )
    time_constant_s: Real = described(0.0, "lag behind a command", "s", ge=0.0, span=plausible.VALVE)
    noise_std: Real = described(0.001, "error of a reading, 1-sigma", "rad", ge=0.0, le=0.3)

    @field_validator("axes")
    @classmethod
    def _apart(cls, value: tuple[Vector3, Vector3]) -> tuple[Vector3, Vector3]:
        for axis in value:
            _of_length_1(axis)
        if float(np.linalg.norm(np.cross(*value))) < _APART:
            raise ValueError("the two axes must not be parallel: a gimbal turns about both")
        return value


class ImpulseAtLevel(Model):
    """The specific impulse of an engine at one level of its throttle."""

    level: Real = described(..., "level, 1: full thrust", gt=0.0, le=1.0)
    specific_impulse_s: Real = described(..., "specific impulse there", "s", gt=0.0, span=plausible.SPECIFIC_IMPULSE)


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
    direction: Vector3 = described(
        ..., "direction of the force on the vehicle with the gimbal at zero, body axes, length 1"
    )
    thrust: Real = described(..., "force at level 1", "lbf | N", gt=0.0, span=plausible.FORCE)
    thrust_uncertainty: Real = described(
        0.01, "1-sigma of the thrust at levels 0 and 1, relative, linear in between; estimated", ge=0.0, le=0.3
    )
    direction_std: Real = described(
        0.005, "1-sigma of the direction about either axis, estimated", "rad", ge=0.0, le=0.3
    )
    position_std: Real = described(
        0.0, "1-sigma of the force's place across its direction, estimated", "ft | m", ge=0.0, span=plausible.POSITION
    )
    specific_impulse_s: PositiveReal | tuple[ImpulseAtLevel, ...] = described(
        ..., "specific impulse, or a list by rising level, linear in between", "s"
    )
    level_rate: Real = described(
        10.0, "largest change of the level per second, used where readings are missing", "1/s", gt=0.0, le=1e4
    )
    level_time_constant_s: Real = described(0.0, "lag behind a command", "s", ge=0.0, span=plausible.VALVE)
    level_noise_std: Real = described(0.002, "error of a reading, 1-sigma, relative to it", ge=0.0, le=0.3)
    least_level: Real = described(0.0, "a reading below it means that the engine is shut", ge=0.0, lt=1.0)
    gimbal: Gimbal | None = described(None, "its gimbal; null: fixed")
    telemetry: Literal["measured", "commanded"] = described(
        "measured",
        "measured: values at a sample, linear in between; commanded: values from the sample on, followed "
        "by the time constants and rates above",
    )

    _unit = field_validator("direction")(_of_length_1)

    @model_validator(mode="after")
    def _possible(self) -> RocketEngine:
        if isinstance(self.specific_impulse_s, tuple):
            levels = [each.level for each in self.specific_impulse_s]
            if not levels or any(low >= high for low, high in pairwise(levels)):
                raise refusal([(("specific_impulse_s",), "levels must rise, and there must be one at least")])
        if self.gimbal is not None:
            across = np.cross(self.gimbal.axes, self.direction)
            if float(np.linalg.norm(across, axis=1).min()) < _APART:
                problem = "an axis along the engine's direction does not turn its force"
                raise refusal([(("gimbal", "axes"), problem)])
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns in telemetry."""
        of_gimbal = () if self.gimbal is None else (f"{self.name}_gimbal_1", f"{self.name}_gimbal_2")
        return (f"{self.name}_level", *of_gimbal)

    @property
    def impulses(self) -> tuple[tuple[float, float], ...]:
        """Levels and the specific impulse at each, s."""
        given = self.specific_impulse_s
        if isinstance(given, tuple):
            return tuple((each.level, each.specific_impulse_s) for each in given)
        return ((1.0, given),)


class Tank(Model):
    """A propellant tank, in which propellant stands as a column at the outlet's end.

    The vehicle's mass properties have its propellant in them. What jets use up lies at the column's surface.
    """

    name: Name = described(..., "unique name", min_length=1)
    outlet: Vector3 = described(..., "middle of the outlet end, vehicle frame", "ft | m", span=plausible.POSITION)
    axis: Vector3 = described(..., "direction from there along the propellant, body axes, length 1")
    length: Real = described(..., "length of the full column", "ft | m", gt=0.0, span=plausible.SIZE)
    radius: Real = described(0.0, "radius of the column", "ft | m", ge=0.0, span=plausible.POSITION)
    capacity: Real = described(..., "propellant when full", "slug | kg", gt=0.0, span=plausible.MASS)
    propellant: Real = described(..., "propellant at the start", "slug | kg", ge=0.0, span=plausible.PAYLOAD)
    propellant_std: Real = described(
        0.0, "its 1-sigma, estimated; 0: known", "slug | kg", ge=0.0, span=plausible.PAYLOAD
    )
    flow_uncertainty: Real = described(
        0.01,
        "1-sigma of the flow's constant error besides that of thrusts, relative, as by specific impulse, "
        "estimated; 0: known",
        ge=0.0,
        le=0.3,
    )
    feeds: tuple[Name, ...] = described(..., "jets, or kinds of jets, that it feeds", min_length=1)

    _unit = field_validator("axis")(_of_length_1)

    @model_validator(mode="after")
    def _holds_it(self) -> Tank:
        if self.propellant > self.capacity:
            problem = f"is {self.propellant:g}, more than the capacity, {self.capacity:g}"
            raise refusal([(("propellant",), problem)])
        return self


class Surroundings(Model):
    """Forces and accelerations on the vehicle besides its jets'; used by `estimation.filter: pose`."""

    drag: Real = described(0.0, "force against the velocity", "lbf-s/ft | N-s/m", ge=0.0)
    drag_std: Real = described(0.0, "its 1-sigma; 0: known", "lbf-s/ft | N-s/m", ge=0.0)
    angular_drag: Real = described(0.0, "torque against the rate", "ft-lbf-s | N-m-s", ge=0.0)
    angular_drag_std: Real = described(0.0, "its 1-sigma; 0: known", "ft-lbf-s | N-m-s", ge=0.0)
    slope_std: Real = described(
        0.0,
        "1-sigma of a constant acceleration in the fixed frame, as on a table that is not level",
        "ft/s^2 | m/s^2",
        ge=0.0,
        span=plausible.ACCELERATION,
    )
    slope_walk: Real = described(0.0, "its random walk, 1-sigma after 1 s", ge=0.0)
    turn_std: Real = described(
        0.0, "1-sigma of a constant angular acceleration, body axes, as by swirl", "rad/s^2", ge=0.0
    )
    turn_walk: Real = described(0.0, "its random walk, 1-sigma after 1 s", ge=0.0)
    heading_turn_std: Real = described(
        0.0,
        "1-sigma of the cosine and sine parts of an angular acceleration that goes with the heading, as "
        "by an off-center mass on a tilted support",
        "rad/s^2",
        ge=0.0,
    )
    velocity_walk: Real = described(
        0.0,
        "random walk of the velocity by unmodeled forces, 1-sigma after 1 s",
        "ft/s/sqrt(s) | m/s/sqrt(s)",
        ge=0.0,
        span=plausible.VELOCITY_STEP,
    )
    rate_walk: Real = described(
        0.0, "random walk of the rate by unmodeled torques, likewise", "rad/s/sqrt(s)", ge=0.0, span=plausible.RATE_STEP
    )
    kicks_per_minute: Real = described(0.0, "rate of unstated pushes", ge=0.0)
    kick_velocity: Real = described(0.0, "change of velocity by one, 1-sigma", "ft/s | m/s", ge=0.0)
    kick_rate: Real = described(0.0, "change of rate by one, 1-sigma", "rad/s", ge=0.0)


def _each_axis(value: Any) -> Any:
    """Returns three numbers, of one that holds for each axis."""
    return (value,) * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


class Disturbance(Model):
    """Uncommanded torque and force, body axes, that change slowly: drag, solar pressure, venting.

    Each component is a first-order Gauss-Markov process, estimated along with the mass properties.
    """

    torque_std: Vector3 = described(
        (0.0, 0.0, 0.0),
        "1-sigma of the torque about the center of mass; one number: for each component",
        "ft-lbf | N-m",
        span=plausible.OUTSIDE_TORQUE,
    )
    force_std: Vector3 = described(
        (0.0, 0.0, 0.0), "1-sigma of the force, likewise", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    time_constant_s: Real = described(..., "correlation time", "s", gt=0.0, span=plausible.CORRELATION)

    _axes = field_validator("torque_std", "force_std", mode="before")(_each_axis)

    _not_negative = field_validator("torque_std", "force_std")(none_negative)

    @model_validator(mode="after")
    def _says_something(self) -> Disturbance:
        if not any((*self.torque_std, *self.force_std)):
            raise ValueError("nothing is said to act; give torque_std, force_std or both, or leave disturbance out")
        return self


class _Solid(Model):
    """The fields common to all solids of a shape."""

    position: Vector3 = described((0.0, 0.0, 0.0), "of its center, vehicle frame", "ft | m", span=plausible.POSITION)
    rotation_deg: Vector3 = described((0.0, 0.0, 0.0), "roll, pitch and yaw from the vehicle frame", "deg")
    color: Text = described("#c9ced6", "as #rrggbb", pattern=r"^#[0-9A-Fa-f]{6}$")


class BoxSolid(_Solid):
    """A box."""

    kind: Literal["box"] = described(..., "kind of solid")
    size: Positive3 = described(..., "edges along x, y, z", "ft | m", span=plausible.SIZE)


class EllipsoidSolid(_Solid):
    """An ellipsoid."""

    kind: Literal["ellipsoid"] = described(..., "kind of solid")
    radii: Positive3 = described(..., "half axes along x, y, z", "ft | m", span=plausible.SIZE)


class CylinderSolid(_Solid):
    """A circular or elliptic cylinder along x."""

    kind: Literal["cylinder"] = described(..., "kind of solid")
    length: Real = described(..., "along x", "ft | m", gt=0.0, span=plausible.SIZE)
    radii: tuple[PositiveReal, PositiveReal] = described(..., "half axes along y and z", "ft | m", span=plausible.SIZE)


class ConeSolid(_Solid):
    """A cone that points toward +x, its center halfway along its axis."""

    kind: Literal["cone"] = described(..., "kind of solid")
    length: Real = described(..., "along x", "ft | m", gt=0.0, span=plausible.SIZE)
    radii: tuple[PositiveReal, PositiveReal] = described(
        ..., "half axes of the base along y and z", "ft | m", span=plausible.SIZE
    )


class PlateSolid(_Solid):
    """A flat plate with a convex outline in the x-y plane of its own frame, such as a wing."""

    kind: Literal["plate"] = described(..., "kind of solid")
    outline: tuple[tuple[Real, Real], ...] = described(
        ..., "corners in order, x and y", "ft | m", min_length=3, max_length=1000, span=plausible.POSITION
    )
    thickness: Real = described(..., "along z", "ft | m", gt=0.0, span=plausible.SIZE)


Solid = Annotated[BoxSolid | EllipsoidSolid | CylinderSolid | ConeSolid | PlateSolid, Field(discriminator="kind")]


class Vehicle(Model):
    """A vehicle as the estimators know it: nominal mass properties, jets and sensors.

    The vehicle frame has its origin fixed in the structure and the body axes' directions.
    """

    name: Name = described(..., "short name", min_length=1)
    description: Text = described("", "one line")
    source: Text = described("", "where the data come from")
    units: Literal["us", "si"] = described(..., "us: ft, slug, lbf; si: m, kg, N; both s, rad")
    sample_period_s: Real = described(..., "period of control and estimation", "s", gt=0.0, span=plausible.PERIOD)
    mass_properties: MassPropertiesModel = described(..., "nominal mass properties")
    uncertainty: Real = described(
        0.3,
        "1-sigma of the nominal mass properties, relative to them; products have floors",
        gt=0.0,
        span=plausible.UNCERTAINTY,
    )
    center_of_mass_std: Real | None = described(
        None,
        "least 1-sigma of the center of mass at the start; null: 10 % of the jets' RMS arm",
        "ft | m",
        gt=0.0,
        span=plausible.POSITION,
    )
    tank_fraction: Real = described(
        0.01,
        "share of the jets' RMS arm by which propellant from no stated tank shifts center of mass and "
        "inertia; 0.1 where tanks lie far out; for filter: joint",
        ge=0.0,
        le=1.0,
    )
    mass_std: Real | None = described(
        None,
        "1-sigma of the nominal mass, as of scales; null: by `uncertainty`; for filter: pose, like the next four keys",
        "slug | kg",
        gt=0.0,
        span=plausible.MASS,
    )
    common_scale_uncertainty: Real = described(
        0.0, "1-sigma of the thrust error common to all jets, relative, as by supply pressure", ge=0.0, le=0.3
    )
    common_scale_walk: Real = described(0.0, "its random walk, 1-sigma after 1 s", "1/sqrt(s)", ge=0.0, le=0.3)
    motion: Literal["free", "planar"] = described("free", "planar: in x, y and about z alone, as on an air bearing")
    fixed: tuple[_Fixable, ...] = described((), "parameters that are known, not estimated")
    surroundings: Surroundings = described(Surroundings(), "what moves the vehicle besides its jets; for filter: pose")
    disturbance: Disturbance | None = described(None, "slowly changing torque and force, estimated; for filter: joint")
    poses: tuple[PoseSensor, ...] = described((), "sensors of position and attitude in a fixed frame")
    velocities: tuple[VelocitySensor, ...] = described((), "sensors of velocity in the fixed frame")
    wheels: tuple[Wheel, ...] = described((), "reaction wheels; for filter: joint", max_length=8)
    engines: tuple[RocketEngine, ...] = described(
        (), "engines with a throttle or a gimbal; for filter: joint", max_length=8
    )
    tanks: tuple[Tank, ...] = described((), "tanks from which jets draw; for filter: joint", max_length=8)
    moving: tuple[MovingPart, ...] = described((), "parts that move inside; for filter: joint", max_length=8)
    gyros: tuple[Gyro, ...] = described(
        ..., "rate-gyro packages; [] only with a pose sensor that gives attitude", reason=_WITHOUT_RATES
    )
    accelerometers: tuple[Accelerometer, ...] = described((), "integrating-accelerometer packages")
    preferred_accelerometer: Text | None = described(None, "package used where one is enough; null: the first")
    jet_kinds: dict[Name, JetKind] = described(..., "kinds of jets by name", min_length=1)
    jet_commands: JetCommands = described(JetCommands(), "meaning of a command between 0 and 1")
    jets: tuple[Jet, ...] = described(..., "reaction-control jets", min_length=1, max_length=_MOST_JETS)
    shape: tuple[Solid, ...] = described((), "solids of the 3-D replay; empty: a box between the jets")

    @model_validator(mode="after")
    def _planar(self) -> Vehicle:
        turns = any(pose.attitude_std is not None for pose in self.poses)
        if not self.gyros and not turns:
            raise refusal(
                [
                    (
                        ("gyros",),
                        f"is empty; this field is required: {_WITHOUT_RATES}; or by a pose sensor with attitude_std",
                    )
                ]
            )
        if (self.velocities or any(pose.position_std is not None for pose in self.poses)) and not turns:
            key = "poses" if self.poses else "velocities"
            raise refusal([((key,), "positions and velocities in a fixed frame need a pose sensor with attitude_std")])
        if self.disturbance is not None and self.needs_pose_filter:
            words = "is not estimated in a fixed frame; state surroundings.slope_std and surroundings.turn_std"
            raise refusal([(("disturbance",), words)])
        for key in ("wheels", "engines", "tanks", "moving"):
            if getattr(self, key) and self.needs_pose_filter:
                raise refusal([((key,), "play no part in a fixed frame; leave them out")])
        if self.motion == "planar":
            inertia = np.array(self.mass_properties.inertia)
            if inertia[0, 2] or inertia[1, 2]:
                raise refusal(
                    [(("mass_properties", "inertia"), "with motion: planar products xz and yz play no part; give 0")]
                )
            tilted = [index for index, jet in enumerate(self.jets) if jet.direction[0] == jet.direction[1] == 0.0]
            if tilted:
                raise refusal([(("jets", tilted[0], "direction"), "with motion: planar a jet along z moves nothing")])
        elif self.surroundings.heading_turn_std:
            path = ("surroundings", "heading_turn_std")
            raise refusal([(path, "goes with motion: planar, which has a heading; here it must be 0")])
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Vehicle:
        _require_unique("jets", "designation", [jet.designation for jet in self.jets])
        _require_unique("jets", "number", [jet.number for jet in self.jets])
        nominal = self.mass_properties.properties()
        known = nominal.mass, nominal.center_of_mass, nominal.inertia
        if problem := not_followed(self.moving, known, self.sample_period_s):
            raise refusal([(("moving",), problem)])
        names = [*self.sensor_names(), *(sensor.name for sensor in self.tracked)]
        _require_unique("sensors", "name", names)
        for name in names:
            if name in _RESERVED or name.startswith(_RESERVED_BEGINNINGS):
                raise ValueError(f"sensors: name {name!r} is a signal of every run; give the sensor another")
        for index, jet in enumerate(self.jets):
            if jet.kind not in self.jet_kinds:
                raise ValueError(
                    f"jets[{index}].kind: {jet.kind!r} is not one of jet_kinds"
                    + suggestion(jet.kind, list(self.jet_kinds))
                )
        accelerometers = [sensor.name for sensor in self.accelerometers]
        preferred = self.preferred_accelerometer
        if preferred is not None and preferred not in accelerometers:
            raise ValueError(
                f"preferred_accelerometer: {preferred!r} is not an accelerometer"
                + suggestion(preferred, accelerometers)
            )
        return self

    @model_validator(mode="after")
    def _fed(self) -> Vehicle:
        problems = list(_of_tanks(self))
        if problems:
            raise refusal(problems)
        return self

    @model_validator(mode="after")
    def _plausible(self) -> Vehicle:
        impossible = [(found.path, found.problem) for found in plausible.of_vehicle(self) if found.impossible]
        if impossible:
            raise refusal(impossible)
        return self

    @property
    def doubts(self) -> list[plausible.Finding]:
        """Entries that may be meant, but are more likely a slip."""
        return [found for found in plausible.of_vehicle(self) if not found.impossible]

    @property
    def sensors(self) -> tuple[SensorPackage, ...]:
        """All sensor packages, gyros first."""
        return (*self.gyros, *self.accelerometers)

    @property
    def tracked(self) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
        """Sensors other than the packages: those in a fixed frame, poses first, the wheels' speeds and the engines."""
        return (*self.poses, *self.velocities, *self.wheels, *self.engines)

    @property
    def has_own_rates(self) -> bool:
        """True if a sensor is read at a rate of its own."""
        return any(sensor.rate_hz is not None for sensor in self._timed)

    @property
    def readings_per_s(self) -> float:
        """Times at which anything is read or commanded, 1/s, all sensors being read at zero."""
        return times_per_s([1.0 / self.sample_period_s, *(one.rate_hz for one in self._timed if one.rate_hz)])

    @property
    def _timed(self) -> tuple[SensorPackage | PoseSensor | Wheel, ...]:
        return (*self.sensors, *self.poses, *self.wheels)

    @property
    def tracked_columns(self) -> tuple[str, ...]:
        """Columns of the tracked sensors in telemetry, in order."""
        return tuple(column for sensor in self.tracked for column in sensor.columns)

    @property
    def needs_pose_filter(self) -> bool:
        """True if the sensors and motion need the estimator in a fixed frame, `estimation.filter` pose."""
        located = bool(self.velocities) or any(pose.position_std is not None for pose in self.poses)
        return located or self.motion == "planar" or not self.gyros

    @property
    def has_on_times(self) -> bool:
        """True if jets open and close within a sample, see `maths.vehicle.on_times`."""
        stated = getattr(self.jet_commands, "as")
        if stated is not None:
            return bool(stated == "on_time")
        return any(0.0 < kind.minimum_on_time_s < self.sample_period_s for kind in self.jet_kinds.values())

    @property
    def opens_at(self) -> Place | None:
        """Place of an on-time in its sample where no onset is given; None: commands are levels."""
        return self.jet_commands.at if self.has_on_times else None

    @cached_property
    def designations(self) -> tuple[str, ...]:
        """The jets' designations, in order."""
        return tuple(jet.designation for jet in self.jets)

    @cached_property
    def positions(self) -> Array:
        """Positions of the jets in the vehicle frame, ft or m, shape (n_jets, 3)."""
        return np.array([jet.position for jet in self.jets])

    @cached_property
    def thrusts(self) -> Array:
        """Force vectors of the jets, thrust x direction / |direction|, lbf or N, shape (n_jets, 3)."""
        directions = np.array([jet.direction for jet in self.jets])
        magnitudes = np.array([jet.thrust for jet in self.jets])
        return directions * (magnitudes / np.linalg.norm(directions, axis=1))[:, None]

    @cached_property
    def wrenches(self) -> Array:
        """Torque about the vehicle origin and force of each jet, shape (n_jets, 6)."""
        return thrust_wrenches(self.positions, self.thrusts)

    @cached_property
    def mass_flows(self) -> Array:
        """Propellant flow of each jet at full thrust, slug/s or kg/s, shape (n_jets,)."""
        gravity = STANDARD_GRAVITY[self.units]

        def flow(jet: Jet) -> float:
            kind = self.jet_kinds[jet.kind]
            return jet.mass_flow or kind.nominal_thrust / (gravity * kind.specific_impulse_s)

        return self._per_jet(flow)

    @cached_property
    def time_constants_s(self) -> Array:
        """Time constant of each jet's thrust build-up and tail-off, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].time_constant_s)

    @cached_property
    def kind_indices(self) -> NDArray[np.int_]:
        """Index of each jet's kind in `jet_kinds`, shape (n_jets,)."""
        kinds = list(self.jet_kinds)
        return np.array([kinds.index(jet.kind) for jet in self.jets])

    def jets_of(self, tank: Tank) -> NDArray[np.bool_]:
        """Returns which jets draw from a tank, shape (n_jets,)."""
        return np.array([jet.designation in tank.feeds or jet.kind in tank.feeds for jet in self.jets])

    @cached_property
    def tank_geometry(self) -> Tanks:
        """The tanks as arrays, see `maths.vehicle.depletion`."""
        axes = np.array([tank.axis for tank in self.tanks]).reshape(-1, 3)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        heights = np.array([tank.length / tank.capacity for tank in self.tanks])
        return Tanks(
            outlets=np.array([tank.outlet for tank in self.tanks]).reshape(-1, 3),
            columns=axes * heights[:, None],
            spreads=np.array(
                [
                    0.25 * tank.radius**2 * (np.eye(3) + np.outer(axis, axis))
                    for tank, axis in zip(self.tanks, axes, strict=True)
                ]
            ).reshape(-1, 3, 3),
            feeds=np.array([self.jets_of(tank) for tank in self.tanks], dtype=float).reshape(-1, len(self.jets)),
        )

    @cached_property
    def minimum_on_times_s(self) -> Array:
        """Minimum on-time of each jet, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].minimum_on_time_s)

    @cached_property
    def on_time_quanta_s(self) -> Array:
        """Step of each valve's clock, zero: none, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].on_time_quantum_s)

    @cached_property
    def thrust_uncertainties(self) -> Array:
        """1-sigma of each jet's constant thrust error, relative, shape (n_jets,)."""

        def of(jet: Jet) -> float:
            own = jet.thrust_uncertainty
            return self.jet_kinds[jet.kind].thrust_uncertainty if own is None else own

        return self._per_jet(of)

    @cached_property
    def mounting_sigmas(self) -> Array:
        """1-sigma of the direction, rad, and of the place, ft or m, of each jet, shape (n_jets, 2)."""
        kinds = [self.jet_kinds[jet.kind] for jet in self.jets]
        return np.array([(kind.direction_std, kind.position_std) for kind in kinds])

    def _per_jet(self, value: Callable[[Jet], float]) -> Array:
        return np.array([value(jet) for jet in self.jets])

    def __repr__(self) -> str:
        return (
            f"<Vehicle '{self.name}': {len(self.jets)} jets, {self.sensors_in_words}, "
            f"{self.nominal.mass:g} {self.unit_names['mass']}>"
        )

    __str__ = __repr__

    @cached_property
    def nominal(self) -> MassProperties:
        """Nominal mass properties as arrays."""
        return self.mass_properties.properties()

    @cached_property
    def rms_arm(self) -> float:
        """Root mean square distance of the jets from the nominal center of mass, ft or m."""
        arms = self.positions - self.nominal.center_of_mass
        return float(np.sqrt((arms**2).sum(axis=1).mean()))

    @property
    def center_of_mass_floor(self) -> float:
        """The floor of the center of mass's 1-sigma at the start, ft or m."""
        return self.center_of_mass_std or 0.1 * self.rms_arm

    @property
    def unit_names(self) -> dict[str, str]:
        """Names of the units of length, mass and force."""
        return UNITS[self.units]

    def gyro(self, name: str) -> Gyro:
        """Returns the gyro package of a name; raises InputError where there is none."""
        return _of_name("gyro package", name, self.gyros)

    def accelerometer(self, name: str) -> Accelerometer:
        """Returns the accelerometer package of a name; raises InputError where there is none."""
        return _of_name("accelerometer package", name, self.accelerometers)

    def jet_index(self, designation: str) -> int:
        """Returns the index of a jet in `jets`; raises KeyError for an unknown designation."""
        try:
            return self.designations.index(designation)
        except ValueError:
            raise KeyError(designation) from None

    @property
    def sensors_in_words(self) -> str:
        """Numbers of sensors of each kind, in words."""
        others = {
            "pose sensor": len(self.poses),
            "velocity sensor": len(self.velocities),
            "reaction wheel": len(self.wheels),
            "engine": len(self.engines),
        }
        more = "".join(f", {count} {what}{'s' if count > 1 else ''}" for what, count in others.items() if count)
        return f"{len(self.gyros)} gyro and {len(self.accelerometers)} accelerometer packages{more}"

    def sensor_names(self) -> list[str]:
        """Returns the names of all sensor packages, gyros first."""
        return [sensor.name for sensor in self.sensors]


def _of_tanks(vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds problems of a vehicle's tanks, each with the path of its field."""
    _require_unique("tanks", "name", [tank.name for tank in vehicle.tanks])
    known, fed = [*vehicle.designations, *vehicle.jet_kinds], dict[str, str]()
    for index, tank in enumerate(vehicle.tanks):
        for place, name in enumerate(tank.feeds):
            if name not in known:
                problem = f"{name!r} is neither a jet nor one of jet_kinds{suggestion(name, known)}"
                yield ("tanks", index, "feeds", place), problem
        for jet in np.array(vehicle.designations)[vehicle.jets_of(tank)].tolist():
            if jet in fed:
                problem = f"jet {jet} draws from tank '{fed[jet]}' already; a jet draws from one tank"
                yield ("tanks", index, "feeds"), problem
                break
            fed[jet] = tank.name
    held = sum(tank.propellant for tank in vehicle.tanks)
    if held >= vehicle.mass_properties.mass:
        last, unit = len(vehicle.tanks) - 1, vehicle.unit_names["mass"]
        problem = (
            f"tanks hold {held:g} {unit} of propellant, and the vehicle's mass with it is "
            f"{vehicle.mass_properties.mass:g} {unit}"
        )
        yield ("tanks", last, "propellant"), problem
    elif held > 0.0:
        fill = np.array([tank.propellant for tank in vehicle.tanks])
        body = np.concatenate((six_elements(vehicle.nominal.inertia), vehicle.nominal.center_of_mass))
        dry = symmetric(emptied(body, vehicle.nominal.mass, fill, fill, vehicle.tank_geometry)[:6])
        if not could_be_inertia(dry):
            moments = ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(dry))
            problem = (
                "propellant so far out has a larger inertia than mass_properties leave for it: without it no rigid "
                f"body has the principal moments {moments}"
            )
            yield ("tanks",), problem


def _require_unique(where: str, what: str, values: list[Any]) -> None:
    seen = set()
    for value in values:
        if value in seen:
            raise ValueError(f"{where}: {what} {value!r} appears twice; it must be unique")
        seen.add(value)


_P = TypeVar("_P", bound=SensorPackage)


def _of_name(what: str, name: str, packages: Sequence[_P]) -> _P:
    found = next((package for package in packages if package.name == name), None)
    if found is None:
        raise InputError(f"'{name}' is no {what} of the vehicle{suggestion(name, [one.name for one in packages])}")
    return found


def bundled_vehicles() -> list[str]:
    """Lists the vehicles that come with the package."""
    return bundled("vehicle")


def load_vehicle(vehicle: str | Path) -> Vehicle:
    """Loads a bundled vehicle by name, or one from a YAML file.

    Args:
        vehicle: a name that `massprop list` shows, or the path of a file.

    Raises:
        InputError: when there is none of that name, or its data are wrong; the message says where.
    """
    name = str(vehicle)
    if name in bundled_vehicles():
        text = (resources.files("massprop_drake") / "vehicles" / f"{name}.yaml").read_text(encoding="utf-8")
        document = Document(text, f"vehicle '{name}'")
    else:
        path = Path(vehicle)
        if not exists(path):
            require_named(name, "vehicle")
        document = Document(read_text(path), str(path))
        require_kind(document.data, "vehicle", str(path))
    return validated(Vehicle, document.data, document)
