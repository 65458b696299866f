"""Scenarios: one case to simulate, and how to estimate in it; read from YAML and validated.

Every variant of a method is a field here, never an edit of code. Angles are radians.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from massprop_drake.errors import InputError, dotted, moment, suggestion
from massprop_drake.inputs import plausible, renamed
from massprop_drake.inputs.kinds import bundled, require_kind, require_named
from massprop_drake.inputs.model import (
    Flag,
    Matrix3,
    Model,
    Real,
    Text,
    Vector3,
    Whole,
    described,
    keys_of_former_kind,
    none_negative,
    refusal,
    validated,
)
from massprop_drake.inputs.model_file import model_joints, model_text
from massprop_drake.inputs.moving import MovingPart, not_followed
from massprop_drake.inputs.vehicle_file import MassPropertiesModel, Vehicle, load_vehicle, symmetric_inertia
from massprop_drake.inputs.yaml import Document, FieldPath, exists, read_text
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.linear_algebra import is_covariance
from massprop_drake.maths.mass_properties import Spread, could_be_inertia, initial_standard_deviation, joined
from massprop_drake.maths.vehicle.joint_moves import peak_rate
from massprop_drake.maths.vehicle.on_times import samples_of

Array = NDArray[np.float64]

_DEGREE = np.pi / 180.0
_ESTIMATION = ("vehicle", "estimation", "rotation", "mass", "joint", "detector", "faults")
_USUAL_FILTER: Literal["thesis", "joint", "pose"] = "joint"
# detectors that a filter goes with, the usual one first
DETECTORS_OF = {"thesis": ("cglr", "cusum", "off"), "joint": ("hypotheses", "off"), "pose": ("thrust_factors", "off")}
# keys that speak to one filter alone
_KEYS_OF: dict[str, tuple[tuple[str, ...], ...]] = {
    "thesis": (
        ("rotation",),
        ("mass",),
        ("sensors", "combine"),
        ("estimation", "thrust_transient"),
        ("estimation", "thrust_uncertainty"),
    ),
    "joint": (("joint",), ("faults",)),
}
_T = TypeVar("_T", bound=Any)
_USUAL_VEHICLE = "orbiter"
_PRIORS = Priors()
_INDEX = re.compile(r"[0-9]{1,6}")
_LONGEST_NAME = 200  # characters; those of a folder's name are limited


def _in_order(timed: _T) -> _T:
    """Returns an interval as it is; raises ValueError where it does not end after its beginning."""
    start_s, end_s = timed.start_s, timed.end_s
    if end_s is not None and end_s <= start_s:
        raise ValueError(f"end_s must be later than start_s, got {moment(start_s)} to {moment(end_s)}")
    return timed


class HandControllerWindow(Model):
    """An interval in which a hand controller is held out of detent."""

    controller: Literal["rhc", "thc"] = described(
        ..., "rhc: rotational (discrete rate), thc: translational (acceleration)"
    )
    axis: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = described(..., "body axis and direction")
    start_s: Real = described(..., "leaves detent", "s", ge=0.0, span=plausible.TIME)
    end_s: Real = described(..., "returns to detent", "s", gt=0.0, span=plausible.TIME)

    _ordered = model_validator(mode="after")(_in_order)


class JetPulse(Model):
    """An interval in which a jet is commanded on, in a scenario with a prescribed jet schedule."""

    jet: Text = described(..., "designation")
    start_s: Real = described(..., "first commanded", "s", ge=0.0, span=plausible.TIME)
    end_s: Real = described(..., "no longer commanded", "s", gt=0.0, span=plausible.TIME)

    _ordered = model_validator(mode="after")(_in_order)


class WheelPulse(Model):
    """An interval in which the motor of a reaction wheel gives a torque."""

    wheel: Text = described(..., "name")
    start_s: Real = described(..., "first sample with it", "s", ge=0.0, span=plausible.TIME)
    end_s: Real = described(..., "first sample without it", "s", gt=0.0, span=plausible.TIME)
    torque: Real = described(
        ..., "torque on the wheel; the vehicle gets the opposite", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )

    _ordered = model_validator(mode="after")(_in_order)


class EngineBurn(Model):
    """An interval in which an engine burns at a level, or has its gimbal turned."""

    engine: Text = described(..., "name")
    start_s: Real = described(..., "first sample with it", "s", ge=0.0, span=plausible.TIME)
    end_s: Real = described(..., "first sample without it", "s", gt=0.0, span=plausible.TIME)
    level: Real = described(1.0, "share of its thrust", ge=0.0, le=1.0)
    gimbal: tuple[Real, Real] = described((0.0, 0.0), "gimbal angles", "rad")

    _ordered = model_validator(mode="after")(_in_order)


class EngineErrors(Model):
    """Errors of a true engine, in the order of its axes."""

    thrust: tuple[Real, Real] = described((0.0, 0.0), "at level 0 and at level 1, relative")
    direction: tuple[Real, Real] = described((0.0, 0.0), "angles about the gimbal's axes", "rad")
    position: tuple[Real, Real] = described((0.0, 0.0), "shifts across the direction", "ft | m")


class EngineFailureBlock(Model):
    """A failure of an engine."""

    engine: Text = described(..., "name")
    kind: Literal["out", "level_stuck", "gimbal_1_stuck", "gimbal_2_stuck"] = described(
        ..., "out: no thrust; others: the level or angle stays where it is"
    )
    start_s: Real = described(..., "first sample with it", "s", ge=0.0, span=plausible.TIME)
    end_s: Real | None = described(None, "first sample without it; null: never", "s", gt=0.0, span=plausible.TIME)

    _ordered = model_validator(mode="after")(_in_order)


class DisturbanceBlock(Model):
    """Uncommanded torque and force, body axes: a mean, and a first-order Gauss-Markov process about it."""

    torque: Vector3 = described(
        (0.0, 0.0, 0.0), "mean torque about the center of mass", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )
    torque_std: Vector3 = described(
        (0.0, 0.0, 0.0), "1-sigma of its changing part", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )
    force: Vector3 = described(
        (0.0, 0.0, 0.0), "mean force at the center of mass", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    force_std: Vector3 = described(
        (0.0, 0.0, 0.0), "1-sigma of its changing part", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    correlation_time_s: Real = described(
        100.0,
        "correlation time of the changing part, which is held over a sample",
        "s",
        gt=0.0,
        span=plausible.CORRELATION,
    )

    _not_negative = field_validator("torque_std", "force_std")(none_negative)


class _Plant(Model):
    """The fields common to all true vehicles."""

    kind: Literal["rigid", "multibody"]
    integrator: Literal["runge_kutta3", "runge_kutta5", "bogacki_shampine3"] = described(
        "runge_kutta5", "Drake's scheme for the continuous plant"
    )
    accuracy: Real = described(1e-10, "accuracy of that integrator", gt=0.0, span=plausible.ACCURACY)
    thrust_transient: Literal["none", "vehicle"] = described(
        "vehicle", "none: instantaneous thrust; vehicle: first-order lag with the vehicle's time constants"
    )
    lag_factor: Real = described(1.0, "true time constants of thrust over the vehicle file's", gt=0.0, le=10.0)
    thrust_dispersion: Real = described(
        0.0, "1-sigma of each jet's constant thrust error, relative, drawn", ge=0.0, le=0.3
    )
    mounting_dispersion: Real = described(
        0.0, "1-sigma of each jet's mounting error, in the vehicle's stated 1-sigmas, drawn", ge=0.0, le=10.0
    )
    initial_rate: Vector3 = described((0.0, 0.0, 0.0), "rate at the start, body axes", "rad/s", span=plausible.RATE)
    disturbance: DisturbanceBlock = described(
        DisturbanceBlock(), "torque and force that nobody commands, a mean and a drawn changing part"
    )
    wheel_speeds: dict[Text, Real] = described({}, "speeds of wheels at the start, by name; others stand", "rad/s")
    wheel_dispersion: Real = described(0.0, "1-sigma of each wheel's inertia error, relative, drawn", ge=0.0, le=0.3)


class Dispersion(Model):
    """Mass properties drawn about the scenario's: always those of a possible body.

    The second moments of the mass distribution are scaled along their principal axes, which are turned by a small
    rotation.
    """

    mass_percent: Real = described(0.0, "1-sigma of the mass, as a factor", "%", ge=0.0, le=100.0)
    center_of_mass: Real = described(0.0, "1-sigma of each coordinate", "ft | m", ge=0.0, le=1e3)
    second_moments_percent: Real = described(
        0.0, "1-sigma of each principal second moment, as a factor", "%", ge=0.0, le=100.0
    )
    axes_deg: Real = described(0.0, "1-sigma of the principal axes' rotation about each axis", "deg", ge=0.0, le=180.0)

    @property
    def spread(self) -> Spread:
        """Spread as the mathematics takes it."""
        return Spread(
            0.01 * self.mass_percent,
            self.center_of_mass,
            0.01 * self.second_moments_percent,
            float(np.radians(self.axes_deg)),
        )


class PlantBlock(_Plant):
    """The true vehicle as one rigid body."""

    kind: Literal["rigid"] = described("rigid", "one rigid body, whose propellant may be used up")
    time_step: Real | None = described(
        None, "0: continuous, by Drake's integrator; the sample period, or null: fixed steps of high order", "s"
    )
    depletion: Flag = described(
        True, "whether firing uses up mass; inertia and center of mass change only by what tanks lose"
    )
    mass_properties: MassPropertiesModel | None = described(None, "true values at the start; null: nominal")
    dispersion: Dispersion = described(Dispersion(), "errors of the true mass properties, drawn")
    engine_errors: dict[Text, EngineErrors] = described({}, "errors of engines, by name; others have none")
    engine_dispersion: Real = described(
        0.0, "1-sigma of each engine error, in the vehicle's stated 1-sigmas, drawn", ge=0.0, le=10.0
    )
    propellant: dict[Text, Real] = described(
        {}, "propellant in tanks at the start, by name; else as the vehicle states", "slug | kg"
    )


class JointStart(Model):
    """A joint of the model at the start."""

    joint: Text = described(..., "name of a joint of one degree of freedom")
    position: Real = described(0.0, "start, from the model's zero", "rad | ft | m")
    rate: Real = described(0.0, "rate at the start", "rad/s | ft/s | m/s")
    held: Flag = described(False, "whether a drive holds it; joints of `moves` are held without this")


class JointMove(Model):
    """A move of a joint by its drive, along a profile of least jerk."""

    joint: Text = described(..., "name of a joint of one degree of freedom")
    start_s: Real = described(..., "start of the move", "s", ge=0.0, span=plausible.TIME)
    end_s: Real = described(..., "end of the move", "s", gt=0.0, span=plausible.TIME)
    position: Real = described(..., "position at the end", "rad | ft | m")

    _ordered = model_validator(mode="after")(_in_order)


class MultibodyBlock(_Plant):
    """The true vehicle as bodies and joints of a model, by Drake's MultibodyPlant."""

    kind: Literal["multibody"] = described(..., "bodies and joints of an SDF or URDF model; firing uses up no mass")
    model: Text = described(
        ..., "SDF or URDF: bundled model, file relative to this one, or the text; its mass properties are the true ones"
    )
    body: Text = described(..., "link with jets and sensors, whose frame is the vehicle frame")
    joints: tuple[JointStart, ...] = described((), "joints that start elsewhere than at zero and rest, or are held")
    moves: tuple[JointMove, ...] = described((), "moves of driven joints")
    drive_frequency_hz: Real = described(
        2.0, "natural frequency of the drives, critically damped", "Hz", gt=0.0, le=100.0
    )

    @property
    def joint_columns(self) -> tuple[str, ...]:
        """Names of the joints' positions, as `joint_positions` has them."""
        return tuple(column for joint in model_joints(self.model) for column in joint.columns)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each joint position, with {length} for the vehicle's."""
        return tuple(joint.unit for joint in model_joints(self.model) for _ in joint.columns)

    @model_validator(mode="after")
    def _one_at_a_time(self) -> MultibodyBlock:
        problems = list(_overlaps("moves", [(move.joint, move.start_s, move.end_s) for move in self.moves]))
        named = [start.joint for start in self.joints]
        problems += [
            (("joints", index, "joint"), f"'{name}' has an entry already; give one")
            for index, name in enumerate(named)
            if name in named[:index]
        ]
        if problems := problems or list(self._too_fast()):
            raise refusal(problems)
        return self

    def _too_fast(self) -> Iterator[tuple[FieldPath, str]]:
        """Finds joints that start, or are moved, faster than anything turns."""
        most = plausible.RATE.most
        where = {start.joint: start.position for start in self.joints}
        for index, start in enumerate(self.joints):
            if abs(start.rate) > most:
                yield ("joints", index, "rate"), f"{start.rate:g} per s, is above {most:g}: {plausible.RATE.why}"
        for index, move in sorted(enumerate(self.moves), key=lambda one: one[1].start_s):
            way = move.position - where.get(move.joint, 0.0)
            fastest = peak_rate(way, move.end_s - move.start_s)
            if fastest > most:
                problem = f"reaches {fastest:.3g} per s, above {most:g}: {plausible.RATE.why}; give it more time"
                yield ("moves", index), problem
            where[move.joint] = move.position


class _Timed(Model):
    """The fields common to all jet failures."""

    jet: Text = described(..., "designation")
    start_s: Real = described(..., "onset", "s", ge=0.0, span=plausible.TIME)
    end_s: Real | None = described(None, "when the jet recovers; null: never", "s", gt=0.0, span=plausible.TIME)

    _ordered = model_validator(mode="after")(_in_order)


class StuckOn(_Timed):
    """The jet fires regardless of its command."""

    kind: Literal["stuck_on"] = described(..., "kind of failure")


class StuckOff(_Timed):
    """The jet never fires."""

    kind: Literal["stuck_off"] = described(..., "kind of failure")


class Degraded(_Timed):
    """The jet produces only a fraction of its thrust."""

    kind: Literal["degraded"] = described(..., "kind of failure")
    fraction: Real = described(..., "share of thrust left", ge=0.0, le=1.0)


class Leak(_Timed):
    """The jet produces a force along its direction, commanded or not."""

    kind: Literal["leak"] = described(..., "kind of failure")
    force: Real = described(..., "additional force", "lbf | N", gt=0.0, span=plausible.LEAK)


class Intermittent(_Timed):
    """The jet's valve fails at random, sample by sample."""

    kind: Literal["intermittent"] = described(..., "kind of failure")
    probability: Real = described(..., "probability of failing in a sample", ge=0.0, le=1.0)
    level: Real = described(0.0, "thrust while it fails: 0 off, 1 on", ge=0.0, le=1.0)


class Drift(_Timed):
    """The jet's thrust changes slowly."""

    kind: Literal["drift"] = described(..., "kind of failure")
    rate_per_s: Real = described(..., "change of the thrust, relative", "1/s", span=plausible.DRIFT)


Failure = Annotated[StuckOn | StuckOff | Degraded | Leak | Intermittent | Drift, Field(discriminator="kind")]


class MassJump(Model):
    """A payload that leaves the vehicle or docks with it, moving with the structure at that moment."""

    kind: Literal["release", "dock"] = described(..., "whether the payload leaves or comes")
    time_s: Real = described(
        ..., "time; it happens at the first sample not before it", "s", ge=0.0, span=plausible.TIME
    )
    mass: Real = described(..., "mass of the payload", "slug | kg", gt=0.0, span=plausible.PAYLOAD)
    position: Vector3 = described(..., "its center of mass, vehicle frame", "ft | m", span=plausible.POSITION)
    inertia: Matrix3 | None = described(
        None,
        "inertia about its own center of mass, body axes; null: a point mass",
        "slug-ft^2 | kg-m^2",
        span=plausible.INERTIA,
    )

    @field_validator("inertia")
    @classmethod
    def _symmetric(cls, value: Matrix3 | None) -> Matrix3 | None:
        return value if value is None else symmetric_inertia(value)


class VibrationTone(Model):
    """A vibration of the structure as the sensors of a package feel it; estimators and autopilot do not know of it."""

    frequency_hz: Real = described(
        ..., "frequency; from half the sample frequency on it is aliased", "Hz", gt=0.0, span=plausible.TONE
    )
    amplitude: Vector3 = described(
        ..., "amplitude per axis, of rate or acceleration; phases are drawn", "rad/s | ft/s^2 | m/s^2"
    )


class SensorErrors(Model):
    """The true errors of one sensor package, unknown to the estimators, in the order in which they act on a signal."""

    sensor: Text = described(..., "name of a gyro or accelerometer package")
    vibration: tuple[VibrationTone, ...] = described((), "vibration of the structure at the sensor")
    scale_factor: Vector3 = described((0.0, 0.0, 0.0), "per axis: reading = (1 + this) x truth", span=plausible.SCALE)
    bandwidth_hz: Real | None = described(
        None,
        "corner of a first-order low-pass before sampling; null: unlimited",
        "Hz",
        gt=0.0,
        span=plausible.BANDWIDTH,
    )
    bias: Vector3 = described((0.0, 0.0, 0.0), "constant bias of rate or acceleration", "rad/s | ft/s^2 | m/s^2")
    bias_random_walk: Real = described(
        0.0, "random walk of the bias, 1-sigma after 1 s", "rad/s/sqrt(s) | ft/s^2/sqrt(s) | m/s^2/sqrt(s)", ge=0.0
    )
    noise_std: Real | None = described(None, "white noise, 1-sigma; null: the vehicle's", "rad/s | ft/s | m/s", ge=0.0)
    quantum: Real | None = described(None, "step of a reading; null: the vehicle's", "rad/s | ft/s | m/s", ge=0.0)
    delay_samples: Whole = described(0, "delay of readings", ge=0, le=100)


_RULES = Literal["single", "most_accurate", "mid_value", "average", "weighted_average", "serial"]
_RULE = (
    "single: the package in use, else the next; most_accurate: least covariance; mid_value: the "
    "median of each component; average; weighted_average: by covariance; serial: one update after the"
    " other"
)


class CombineBlock(Model):
    """Use of several packages of one kind by the filters."""

    gyros: _RULES = described("single", _RULE)
    accelerometers: _RULES = described("single", _RULE)
    correlated: Flag = described(
        False, "whether averages of accelerometers account for correlated errors; serial then is one stacked update"
    )


class SensorsBlock(Model):
    """The sensors."""

    quantizer_phase: Literal["seeded", "equal"] = described(
        "seeded", "seeded: random offset of each component's marks; equal: none"
    )
    gyro: Text | None = described(None, "package in use; null: the first")
    accelerometer: Text | None = described(None, "package in use; null: the vehicle's preferred one")
    combine: CombineBlock = described(CombineBlock(), "redundant packages")
    errors: tuple[SensorErrors, ...] = described((), "errors beyond the vehicle file's quanta and noise")


class JetSelectionBlock(Model):
    """Flight of the on-times that the autopilot's linear program selects."""

    output: Literal["cycles", "on_time"] = described(
        "cycles", "cycles: whole sample periods; on_time: in steps of the valve's clock, of a vehicle with on-times"
    )
    below_minimum: Literal["accumulate", "drop"] = described(
        "accumulate",
        "treatment of on-times below a jet's minimum with output: on_time; accumulate: until they reach it",
    )


class WheelControlBlock(Model):
    """Reaction wheels that hold attitude and follow rates, and are unloaded by jets."""

    rate_gain: Real = described(
        1.0,
        "wheel torque per rate error and inertia; four times hold_gain damps critically",
        "1/s",
        gt=0.0,
        span=plausible.GAIN,
    )
    unload_above: Real | None = described(
        None, "share of its largest speed at which a wheel has jets unload all wheels; null: never", gt=0.0, le=1.0
    )
    unload_below: Real = described(0.2, "share below which unloading ends", ge=0.0, lt=1.0)
    unload_rate: Real | None = described(
        None,
        "largest rate change asked of jets at a time to unload; null: 1.5 times rate_deadband, below "
        "which nothing is asked",
        "rad/s",
        gt=0.0,
        span=plausible.RATE,
    )

    @model_validator(mode="after")
    def _in_order(self) -> WheelControlBlock:
        if self.unload_above is not None and self.unload_below >= self.unload_above:
            raise ValueError(
                f"unload_below must be less than unload_above, got {self.unload_below:g} and {self.unload_above:g}"
            )
        return self


class FiringTestBlock(Model):
    """Firings that are designed and flown when the estimators leave a question open."""

    when: Literal["group", "target"] = described(..., "group: to isolate a failed jet; target: to reach 1-sigmas")
    targets: dict[Text, Text] = described({}, "with when: target, 1-sigma by name, as for `massprop design`")
    force: Text = described("5%", "with when: group, force by which a suspect may fail, likewise")
    limits: dict[Text, Text] = described(
        {}, "limits of one test: rate, angle, displacement, propellant, time; likewise"
    )
    without: tuple[Text, ...] = described((), "jets not to be fired")
    patience_s: Real = described(
        2.0, "how long the question must stand, and pause between tests", "s", gt=0.0, span=plausible.TIME
    )

    @model_validator(mode="after")
    def _asks(self) -> FiringTestBlock:
        if (self.when == "target") != bool(self.targets):
            raise ValueError("targets go with when: target, which needs at least one")
        return self


class AutopilotBlock(Model):
    """Manual modes of the thesis: discrete rate, attitude hold, acceleration."""

    engaged: bool | None = described(
        None, "whether it flies; with a `jet_schedule` it holds attitude between pulses; null: only without one"
    )
    mass_properties: Literal["nominal", "estimated"] = described(
        "nominal", "source for activity vectors; estimated: once converged"
    )
    jet_kinds: tuple[Text, ...] | None = described(
        None, "kinds of jets that may be selected; null: `primary`, else all", min_length=1
    )
    jet_selection: JetSelectionBlock = described(JetSelectionBlock(), "how selected on-times are flown")
    test_firing: FiringTestBlock | None = described(None, "firings that settle what the estimators leave open")
    wheels: WheelControlBlock | None = described(
        None, "attitude control by wheels; null: they stand, or follow `wheel_schedule`"
    )
    discrete_rate: Real = described(
        0.5 * _DEGREE, "rate commanded by the rotational controller", "rad/s", gt=0.0, span=plausible.RATE
    )
    hold_gain: Real = described(0.15, "commanded rate per attitude error in hold", "1/s", ge=0.0, span=plausible.GAIN)
    hold_rate_limit: Real = described(
        0.1 * _DEGREE, "largest rate commanded in hold", "rad/s", ge=0.0, span=plausible.RATE
    )
    capture_rate: Real = described(
        0.05 * _DEGREE,
        "rate below which an axis in detent begins to hold attitude",
        "rad/s",
        gt=0.0,
        span=plausible.RATE,
    )
    rate_deadband: Real = described(
        0.02 * _DEGREE, "rate error that is corrected", "rad/s", gt=0.0, span=plausible.RATE
    )
    acceleration: Real = described(
        0.5,
        "acceleration commanded by the translational controller",
        "ft/s^2 | m/s^2",
        gt=0.0,
        span=plausible.ACCELERATION,
    )
    horizon_s: Real = described(2.0, "time for which a translation is requested", "s", gt=0.0, span=plausible.TIME)
    resolve_rate: Real = described(
        0.2 * _DEGREE, "in a translation, rate error that causes a new selection", "rad/s", gt=0.0, span=plausible.RATE
    )
    resolve_after_s: Real = described(
        0.4, "least time between two selections in a translation", "s", ge=0.0, span=plausible.TIME
    )
    gimbal_bandwidth: Real = described(
        0.0,
        "bandwidth with which gimbals hold zero rate during burns, beside their schedule; 0: schedule alone",
        "rad/s",
        ge=0.0,
        span=plausible.GAIN,
    )


_Ten = tuple[Real, Real, Real, Real, Real, Real, Real, Real, Real, Real]
_TEN_UNITS = "1/(slug-ft^2) | 1/(kg-m^2) (6), ft | m (3), 1/slug | 1/kg"


class ConvergenceLimits(Model):
    """1-sigma below which estimates may be acted on."""

    diagonal: Real = described(0.02, "inverse inertia's diagonal, relative", gt=0.0)
    mass_reciprocal: Real = described(0.2, "mass reciprocal, relative", gt=0.0)
    center_of_mass: Real | None = described(None, "center of mass; null: 3 % of the jets' RMS arm", "ft | m", gt=0.0)


class GivenStart(Model):
    """Mass properties known beforehand, with their uncertainty."""

    mass_properties: MassPropertiesModel | None = described(None, "estimates at the start; null: the nominal ones")
    standard_deviation: _Ten | None = described(None, "1-sigma of the ten parameters", _TEN_UNITS)
    covariance: tuple[_Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten] | None = described(
        None, "covariance instead; none between 1/m and the others", "products of those"
    )

    @model_validator(mode="after")
    def _one(self) -> GivenStart:
        if (self.standard_deviation is None) == (self.covariance is None):
            raise ValueError("give either standard_deviation or covariance")
        if self.standard_deviation is not None and min(self.standard_deviation) < 0.0:
            raise ValueError("standard_deviation: must be zero or positive")
        if self.covariance is not None:
            covariance = np.array(self.covariance)
            if not is_covariance(covariance):
                raise ValueError("covariance: must be symmetric and positive semidefinite")
            if covariance[9, :9].any():
                raise ValueError("covariance: must be zero between 1/m and the others, whose filters are apart")
        return self


class EstimationBlock(Model):
    """The estimators' starting point, and how they turn commands into thrust."""

    filter: Literal["thesis", "joint", "pose"] = described(
        _USUAL_FILTER,
        "joint: one filter for mass properties, rate, velocity and thrust; thesis: two filters, blocks "
        "`rotation` and `mass`; pose: one in a fixed frame, for vehicles with pose or velocity sensors, "
        "without gyros, or in a plane. Unless named, the vehicle or other keys choose it",
    )
    start: Literal["nominal", "zero", "given"] = described("nominal", "estimates at the start")
    given: GivenStart | None = described(None, "with start: given")
    std_fraction: Real | None = described(
        None,
        "1-sigma at the start relative to nominal; null: the vehicle's for nominal, 1 for zero",
        gt=0.0,
        span=plausible.UNCERTAINTY,
    )
    floors: Flag = described(True, "whether products of inertia and center of mass have a least 1-sigma at the start")
    thrust_transient: Literal["gate", "gate_lag"] = described(
        "gate_lag",
        "with filter: thesis; gate: skips samples whose jets have just changed; gate_lag: skips them, and"
        " takes impulses from the lagged thrust",
    )
    thrust_uncertainty: Real = described(
        0.0, "with filter: thesis, 1-sigma of each jet's constant thrust error, relative, considered", ge=0.0, le=0.3
    )
    convergence: ConvergenceLimits = described(ConvergenceLimits(), "1-sigmas below which estimates may be acted on")
    readings_per_s: Real | None = described(
        None,
        "with filter: joint, times a second at which anything is read, each a step of the filter; null: "
        "by `rate_hz` of sensors and rows of a record, else once a sample period",
        "1/s",
        gt=0.0,
        span=plausible.FREQUENCY,
    )

    @model_validator(mode="after")
    def _start_is_given(self) -> EstimationBlock:
        if (self.start == "given") != (self.given is not None):
            raise ValueError("start: given and the field `given` go together")
        return self

    def initial_covariance(self, vehicle: Vehicle) -> Array:
        """Returns the covariance of the ten parameters at the start, shape (10, 10)."""
        if self.given is not None:
            if self.given.covariance is not None:
                return np.array(self.given.covariance)
            return np.diag(np.square(np.array(self.given.standard_deviation)))
        fraction = self.std_fraction
        if fraction is None:
            fraction = vehicle.uncertainty if self.start == "nominal" else 1.0
        deviation = initial_standard_deviation(
            vehicle.nominal.vector(), fraction, vehicle.center_of_mass_floor, floors=self.floors
        )
        return np.diag(deviation**2)


class RotationBlock(Model):
    """The filter for inverse inertia and center of mass."""

    filter: Literal["second_order", "second_order_without_bias", "second_order_without_covariance", "extended"] = (
        described("second_order", "second_order: with bias and covariance of the curvature; extended: with neither")
    )
    coupling: Literal["subtract", "ignore", "hybrid", "model"] = described(
        "hybrid",
        "dynamic coupling; hybrid: subtracted once the estimates are good enough; model: part of the "
        "measurement model, for vehicles that turn fast",
    )
    coupling_limit: Real = described(
        50.0, "hybrid subtracts below this ratio of innovation to measurement variance", gt=0.0
    )
    jump: Literal["none", "covariance_increment"] = described(
        "covariance_increment", "response to a too large innovation"
    )
    jump_threshold: Real = described(25.0, "NIS that is too large; 11.34 in the thesis", gt=0.0)
    jump_std_fraction: Real = described(1.0, "1-sigma then added, relative to the start", gt=0.0, le=100.0)
    process_noise_std: tuple[Real, Real, Real, Real, Real, Real, Real, Real, Real] = described(
        (0.0,) * 9, "1-sigma of the change per sample", "1/(slug-ft^2) | 1/(kg-m^2), ft | m"
    )
    disturbance_std: Real = described(
        0.0, "1-sigma per sample of unmodeled rate increments", "rad/s", ge=0.0, span=plausible.RATE_STEP
    )
    largest_turn: Real = described(0.2, "largest turn in a sample that is used", "rad", gt=0.0)

    _not_negative = field_validator("process_noise_std")(none_negative)


class MassBlock(Model):
    """The filter for the mass reciprocal."""

    compensation: Literal["none", "transverse", "transverse_centripetal"] = described(
        "transverse", "terms of rotation taken out of velocity increments"
    )
    compensation_covariance: Flag = described(True, "whether their uncertainty adds to the measurement covariance")
    jump: Literal["none", "single_sample", "single_sample_thesis", "glr"] = described(
        "single_sample",
        "test for a jump of 1/m; single_sample_thesis: with the thesis's variance after it; glr: over a "
        "window of used samples",
    )
    jump_false_alarm_rate: Real = described(
        1e-6, "false alarms of the test per used sample; 0.01 in the thesis", ge=1e-100, lt=1.0
    )
    jump_window: Whole = described(5, "used samples in glr's window", ge=2, le=1000)
    process_noise_std: Real = described(0.0, "1-sigma of the change of 1/m per sample", "1/slug | 1/kg", ge=0.0)
    disturbance_std: Real = described(
        0.0, "1-sigma per sample of unmodeled velocity increments", "ft/s | m/s", ge=0.0, span=plausible.VELOCITY_STEP
    )


class JointBlock(Model):
    """The joint filter of mass properties, rate, velocity and thrust."""

    thrust_transient: Literal["none", "vehicle"] | None = described(
        None,
        "none: instantaneous thrust; vehicle: first-order lag, its time constants estimated; null: as "
        "plant.thrust_transient",
    )
    thrust_uncertainty: Real | None = described(
        None,
        "1-sigma of each jet's constant thrust error, relative; 0 only where thrusts are exact; null: the vehicle's",
        ge=0.0,
        le=0.3,
    )
    lag_uncertainty: Real | None = described(
        None, "1-sigma of the time constants, relative, one error per kind of jet; null: the vehicle's", ge=0.0, le=1.0
    )
    tank_fraction: Real | None = described(
        None,
        "shift by used propellant, as the vehicle's key; 0 only where it shifts nothing; null: the vehicle's",
        ge=0.0,
        le=1.0,
    )
    rate_walk: Real = described(
        0.0,
        "random walk of the rate by unmodeled torques, 1-sigma after 1 s",
        "rad/s/sqrt(s)",
        ge=0.0,
        span=plausible.RATE_STEP,
    )
    velocity_walk: Real = described(
        0.0,
        "random walk of the velocity by unmodeled forces, likewise",
        "ft/s/sqrt(s) | m/s/sqrt(s)",
        ge=0.0,
        span=plausible.VELOCITY_STEP,
    )
    switching: Literal["ticks", "stamps"] = described(
        "ticks",
        "ticks: commands switch a sample period apart, stamps scatter about that; stamps: they switch at the stamps",
    )
    increment_rate: Real = described(
        1.5e-5,
        "probability of an innovation below which the covariance is inflated during the start",
        ge=1e-100,
        lt=1.0,
    )
    settled_after: Whole = described(
        60, "sample periods with a jet commanded after convergence that end the start", ge=0, le=1_000_000
    )


class CglrBlock(Model):
    """Detection and isolation of failed jets by the generalized likelihood ratio, and of jumps of mass properties."""

    kind: Literal["cglr", "off"] = described(
        "cglr",
        "off, or, usual with estimation.filter: thesis, the constrained generalized likelihood ratio of one sample",
    )
    margin: Real = described(6.0, "lead in likelihood argument that a cluster, and a jet in it, needs", gt=0.0)
    threshold: Real = described(0.0, "least likelihood argument of an alarm", ge=0.0)
    dispersion_threshold: Real = described(16.0, "the same while jets fire, with thrust_uncertainty", ge=0.0)
    magnitude_threshold: Real = described(0.0, "least magnitude of an alarm", "lbf | N", ge=0.0)
    mirror_sign_rule: Flag = described(False, "whether a jet that is on cannot give too much thrust")
    signature_uncertainty: Flag = described(True, "whether signatures are uncertain; not in the thesis")
    unexplained_limit: Real | None = described(
        20.5, "largest unexplained part of the innovations (0.1 % of chi-square, 5 degrees); null: any", gt=0.0
    )
    on_detection: Literal["correct", "correct_thesis", "reject"] = described(
        "correct", "use of a sample that shows a failure"
    )
    reconfigure_after: Whole | None = described(2, "alarms in a row that declare a failure; null: never", ge=1)
    close_manifold: Flag = described(False, "whether a declared failure closes the jet's manifold")
    alarm_gap: Whole = described(
        3, "largest number of samples between two alarms in a row; untested ones do not count", ge=1
    )


class CusumBlock(Model):
    """Detection of failed jets by a cumulative sum for each; a baseline."""

    kind: Literal["cusum"] = described(..., "cumulative sums, jet by jet")
    drift: Real = described(1.0, "taken off each sum at a sample, in its standard deviations", gt=0.0)
    threshold: Real = described(20.0, "sum above which a jet is declared", gt=0.0)


class HypothesesBlock(Model):
    """Detection of failed jets, payloads and false readings with the joint filter, by their posterior probability."""

    kind: Literal["hypotheses"] = described(
        "hypotheses", "usual with estimation.filter: joint; what may fail stands in the block `faults`"
    )


FaultMode = Literal["stuck_on", "leak", "stuck_off", "loss", "drifting", "intermittent"]
_MODES: tuple[FaultMode, ...] = ("stuck_on", "leak", "stuck_off", "loss", "drifting", "intermittent")
_MORE, _LESS = set(_MODES) - {"stuck_off", "loss"}, set(_MODES) - {"stuck_on", "leak"}  # thrust than commanded
_NO_MODE = "name the fault modes that there may be; a jet that hardly ever fails has a low per_hour"


class JetFaults(Model):
    """Faults of one jet, where they are not those of all jets."""

    per_hour: Real | None = described(None, "failures of this jet; null: faults.jet_per_hour", "1/h", gt=0.0)
    modes: tuple[FaultMode, ...] | None = described(
        None, "its fault modes; null: faults.modes", min_length=1, reason=_NO_MODE
    )

    @property
    def gives_more(self) -> bool:
        """True if some mode lets the jet give more thrust than commanded; where none are named, all are meant."""
        return not _MORE.isdisjoint(self.modes or _MODES)

    @property
    def gives_less(self) -> bool:
        """True if some mode lets the jet give less thrust than commanded; where none are named, all are meant."""
        return not _LESS.isdisjoint(self.modes or _MODES)


class FaultsBlock(Model):
    """Priors of the faults that the detector of the joint filter looks for: rates and probabilities."""

    jet_per_hour: Real = described(_PRIORS.jet_per_hour, "failures of one jet", "1/h", gt=0.0)
    together: Real = described(
        _PRIORS.together,
        "probability that a given other jet fails in the same interval, as by a shared driver",
        gt=0.0,
        lt=1.0,
    )
    full_thrust: Real = described(
        _PRIORS.full_thrust, "share of failures with full thrust, as of stuck valves", gt=0.0, lt=1.0
    )
    drifting: Real = described(_PRIORS.drifting, "share of failures whose force grows slowly", gt=0.0, lt=1.0)
    change_per_hour: Real = described(_PRIORS.change_per_hour, "changes of a failed jet's force", "1/h", gt=0.0)
    intermittent: Real = described(
        _PRIORS.intermittent, "share of failures whose force changes all the time", gt=0.0, lt=1.0
    )
    payload_per_hour: Real = described(_PRIORS.payload_per_hour, "payloads that come or leave", "1/h", gt=0.0)
    reading_per_hour: Real = described(
        _PRIORS.reading_per_hour, "sensor components that begin to read falsely, each", "1/h", gt=0.0
    )
    disturbed: Real = described(
        _PRIORS.disturbed, "probability of an unstated disturbance, such as slosh, drag or a vent", gt=0.0, lt=1.0
    )
    unknown_per_hour: Real = described(_PRIORS.unknown_per_hour, "pushes that nothing known explains", "1/h", gt=0.0)
    start: Real = described(
        _PRIORS.start,
        "probability, when data contradict the start, that its uncertainty was stated too small",
        gt=0.0,
        lt=1.0,
    )
    false_per_hour: Real = described(
        _PRIORS.false_per_hour, "accepted false declarations of one jet, or of anything else", "1/h", gt=0.0
    )
    slots: Whole = described(4, "failed jets whose forces are estimated at a time; each adds a state", ge=1, le=16)
    modes: tuple[FaultMode, ...] = described(
        _MODES,
        "fault modes that a jet may have; stuck_on and leak give more thrust than commanded, stuck_off "
        "and loss less, drifting and intermittent either",
        min_length=1,
        reason=_NO_MODE,
    )
    jets: dict[Text, JetFaults] = described({}, "jets unlike the others, by designation")

    @model_validator(mode="after")
    def _consistent(self) -> FaultsBlock:
        problems: list[tuple[FieldPath, str]] = []
        if (both := self.full_thrust + self.drifting) > 1.0 + 1e-12:
            problem = f"is with drifting {both:g} of all failures; both are shares, and sum to at most 1"
            problems.append((("full_thrust",), problem))
        if self.false_per_hour >= self.jet_per_hour:
            problem = (
                f"{self.false_per_hour:g} is not below jet_per_hour, {self.jet_per_hour:g}: declarations would be "
                "false as often as jets fail; give a small fraction of it"
            )
            problems.append((("false_per_hour",), problem))
        if problems:
            raise refusal(problems)
        return self

    def of_each_jet(self, designations: Iterable[str]) -> FaultsBlock:
        """Returns the priors with an entry for each jet, in the order given, in which nothing is left out."""
        usual, found = JetFaults(per_hour=self.jet_per_hour, modes=self.modes), {}
        for name in designations:
            own = self.jets.get(name, JetFaults()).model_dump(exclude_none=True)
            found[name] = usual.model_copy(update=own)
        return self.model_copy(update={"jets": found})


class ThrustFactorsBlock(Model):
    """Detection of jets that are weak or stand open, from the start or later, by hypotheses about their thrust."""

    kind: Literal["thrust_factors"] = described("thrust_factors", "usual with estimation.filter: pose")
    lead: Real = described(6.0, "log-likelihood lead of a hypothesis over others that name a jet, nats", gt=0.0)
    lead_nothing: Real = described(12.0, "lead over no failure, nats", gt=0.0)
    least: Real = described(
        0.1, "least loss or opening that is declared, as a share of thrust; it must also exceed 3 sigma", gt=0.0, lt=1.0
    )


DetectorBlock = Annotated[CglrBlock | CusumBlock | HypothesesBlock | ThrustFactorsBlock, Field(discriminator="kind")]


class ExecutionBlock(Model):
    """Computation of a case; the engine changes no bit of a result, compiled code the last ones."""

    engine: Literal["diagram", "loop"] = described(
        "diagram",
        "diagram: Drake's simulator; loop: the same functions in a plain loop, faster, for a stepped "
        "plant without wheels and engines",
    )
    compiled: Flag = described(
        False, "whether kernels are compiled by numba, extra `fast`; results differ by rounding alone"
    )


class Scenario(Model):
    """One case: a vehicle, its commands and failures, and how its mass properties are estimated.

        Scenario(vehicle="servicer", duration_s=60.0, failures=[{"jet": "YP1", "kind": "stuck_on", "start_s": 30.0}])

    Files that it names are relative to the current folder; `load_scenario` reads one from a file.

    Raises:
        ValueError: naming each field that is wrong, or that does not go with the vehicle.
    """

    name: Text = described(
        "scenario",
        "short name, also of the run's folder",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$",
        max_length=_LONGEST_NAME,
    )
    description: Text = described("", "one line")
    vehicle: Text | Vehicle = described(
        _USUAL_VEHICLE, "bundled vehicle, file relative to this one, or a vehicle's data"
    )
    moving: tuple[MovingPart, ...] = described(
        (), "parts that move inside, as in a vehicle's file, besides those of the vehicle"
    )
    duration_s: Real = described(50.0, "length of the run", "s", gt=0.0, le=1e6)
    seed: Whole = described(0, "seed of all random draws", ge=0, lt=2**63)
    maneuver: tuple[HandControllerWindow, ...] = described((), "hand-controller windows, flown by the autopilot")
    jet_schedule: tuple[JetPulse, ...] = described((), "prescribed jet commands")
    wheel_schedule: tuple[WheelPulse, ...] = described((), "prescribed torques of reaction wheels")
    engine_schedule: tuple[EngineBurn, ...] = described((), "prescribed levels and gimbal angles of engines")
    plant: Annotated[PlantBlock | MultibodyBlock, Field(discriminator="kind")] = described(
        PlantBlock(), "the true vehicle"
    )
    sensors: SensorsBlock = described(SensorsBlock(), "packages in use, and their true errors")
    autopilot: AutopilotBlock = described(AutopilotBlock(), "attitude hold and hand controllers, by jets or wheels")
    estimation: EstimationBlock = described(EstimationBlock(), "the filter and its start")
    rotation: RotationBlock = described(RotationBlock(), "filter for inverse inertia and center of mass")
    mass: MassBlock = described(MassBlock(), "filter for the mass reciprocal")
    joint: JointBlock = described(JointBlock(), "the filter of `estimation.filter: joint`")
    detector: DetectorBlock = described(
        HypothesesBlock(),
        "detection of failures: hypotheses or off with estimation.filter: joint; cglr, cusum or off with "
        "thesis; thrust_factors or off with pose; the first unless named",
    )
    faults: FaultsBlock = described(FaultsBlock(), "priors of faults, with estimation.filter: joint")
    failures: tuple[Failure, ...] = described((), "failures of jets")
    engine_failures: tuple[EngineFailureBlock, ...] = described((), "failures of engines")
    jumps: tuple[MassJump, ...] = described((), "payloads released or docked")
    execution: ExecutionBlock = described(ExecutionBlock(), "how a run is computed")

    @model_validator(mode="before")
    @classmethod
    def _as_the_filter_has_it(cls, data: Any) -> Any:
        """Fills in defaults that depend on the filter, and the filter itself."""
        if not isinstance(data, dict):
            return data
        if isinstance(data.get("vehicle"), str):  # in a program; names in files are `resolved` beside those
            data = {**data, "vehicle": load_vehicle(data["vehicle"])}
        data = _in_present_terms(_with_model(data, None, Path()))
        chosen, given = filter_of(data), dict(data)
        if isinstance(data.get("plant", {}), dict):
            given["plant"] = {"kind": "rigid", **data.get("plant", {})}
        if isinstance(data.get("estimation", {}), dict):
            given["estimation"] = {"filter": chosen, **data.get("estimation", {})}
        if isinstance(data.get("detector", {}), dict) and chosen in DETECTORS_OF:
            given["detector"] = {"kind": DETECTORS_OF[chosen][0], **data.get("detector", {})}
        transient, joint = _part(data.get("plant"), "thrust_transient", "vehicle"), data.get("joint", {})
        own = chosen == "joint" and isinstance(joint, dict) and joint.get("thrust_transient") is None
        if own and transient in ("none", "vehicle"):
            given["joint"] = {**joint, "thrust_transient": transient}
        return given

    @model_validator(mode="after")
    def _of_one_filter(self) -> Scenario:
        named, problems = self.estimation.filter, []
        for path, other in _foreign_keys(self):
            problem = (
                f"is a key of estimation.filter: {other}, and the filter is {named}; leave it out, or name the other"
            )
            problems.append((path, problem))
        if self.detector.kind not in DETECTORS_OF[named]:
            fitting = " or ".join(DETECTORS_OF[named])
            problem = f"{self.detector.kind} does not go with estimation.filter: {named}; use {fitting}"
            problems.append((("detector", "kind"), problem))
        if problems:
            raise refusal(problems)
        return self

    @model_validator(mode="after")
    def _windows(self) -> Scenario:
        if self.maneuver and self.open_loop:
            raise ValueError(
                "a maneuver is flown by the autopilot, which does not fly: leave out either maneuver or jet_schedule, "
                "or set autopilot.engaged: true, for both"
            )
        problems = [
            *_overlaps("maneuver", [(f"{w.controller} {w.axis[1]}", w.start_s, w.end_s) for w in self.maneuver]),
            *_overlaps("failures", [(f.jet, f.start_s, f.end_s or math.inf) for f in self.failures]),
            *_overlaps("jet_schedule", [(p.jet, p.start_s, p.end_s) for p in self.jet_schedule]),
            *_overlaps("wheel_schedule", [(p.wheel, p.start_s, p.end_s) for p in self.wheel_schedule]),
            *_overlaps("engine_schedule", [(p.engine, p.start_s, p.end_s) for p in self.engine_schedule]),
            *_overlaps(
                "engine_failures",
                [(f"{f.engine} {f.kind}", f.start_s, f.end_s or math.inf) for f in self.engine_failures],
            ),
        ]
        if not problems and isinstance(self.vehicle, Vehicle):
            problems = check_against_vehicle(self, self.vehicle)
        if problems:
            raise refusal(problems)
        return self

    def __repr__(self) -> str:
        vehicle = self.vehicle if isinstance(self.vehicle, str) else self.vehicle.name
        counts = {"failures": len(self.failures), "jumps": len(self.jumps)}
        happens = "".join(f", {count} {kind[: -1 if count == 1 else None]}" for kind, count in counts.items() if count)
        return (
            f"<Scenario '{self.name}': vehicle '{vehicle}', {self.duration_s:g} s, seed {self.seed}, "
            f"filter {self.estimation.filter}, detector {self.detector.kind}{happens}>"
        )

    __str__ = __repr__

    @property
    def vehicle_data(self) -> Vehicle:
        """Vehicle, loaded if the scenario only names it, with the parts that move inside."""
        vehicle = self.vehicle if isinstance(self.vehicle, Vehicle) else load_vehicle(self.vehicle)
        if not self.moving:
            return vehicle
        return vehicle.model_copy(update={"moving": (*vehicle.moving, *self.moving)})

    @property
    def open_loop(self) -> bool:
        """True if no autopilot flies."""
        engaged = self.autopilot.engaged
        return bool(self.jet_schedule) if engaged is None else not engaged

    @property
    def process_noise_std(self) -> tuple[float, ...]:
        """1-sigma of the change of the ten parameters per sample, as the blocks of their filters say."""
        return (*self.rotation.process_noise_std, self.mass.process_noise_std)

    @property
    def doubts(self) -> list[plausible.Finding]:
        """Entries that may be meant, but are more likely a slip; of the vehicle, too."""
        vehicle = self.vehicle_data
        own = [found for found in plausible.of_scenario(self, vehicle) if not found.impossible]
        return [found._replace(path=("vehicle", *found.path)) for found in vehicle.doubts] + own

    @property
    def simulation_doubts(self) -> list[plausible.Finding]:
        """Doubts that bear on a simulation: a run may be cut short before the last of its commands."""
        late = {(field, "start_s") for field in ("maneuver", "jet_schedule")}
        return [found for found in self.doubts if (found.path[0], found.path[-1]) not in late]

    @property
    def estimation_doubts(self) -> list[plausible.Finding]:
        """Doubts that bear on estimation from a record, too."""
        return [found for found in self.doubts if found.path[0] in _ESTIMATION]


def filter_of(data: Mapping[str, Any]) -> str:
    """Returns the filter that a scenario's data name, before they are validated.

    Where none is named it is the usual one, unless there are keys of another and none of the usual one's: so it is in
    files of before there was a choice.
    """
    named = _part(data.get("estimation"), "filter", None)
    if named is not None:
        return str(named)
    if _needs_pose_filter(data.get("vehicle")):
        return "pose"
    told = {name for name, paths in _KEYS_OF.items() if any(_present(data, path) for path in paths)}
    kind = _part(data.get("detector"), "kind", "off")
    told |= {name for name, kinds in DETECTORS_OF.items() if kind in kinds and kind != "off"}
    return told.pop() if len(told) == 1 else _USUAL_FILTER


def _needs_pose_filter(vehicle: Any) -> bool:
    """Tests whether a vehicle, or its data that may not be validated yet, is one for `estimation.filter: pose`."""
    if isinstance(vehicle, Mapping):
        poses = [pose for pose in vehicle.get("poses") or () if isinstance(pose, Mapping)]
        located = bool(vehicle.get("velocities")) or any(pose.get("position_std") is not None for pose in poses)
        return located or vehicle.get("motion") == "planar"
    return isinstance(vehicle, Vehicle) and vehicle.needs_pose_filter


def _present(data: Any, path: tuple[str, ...]) -> bool:
    for part in path:
        if not isinstance(data, Mapping) or part not in data:
            return False
        data = data[part]
    return True


def _part(block: Any, key: str, otherwise: str | None) -> Any:
    """Returns a key of a block, validated or not."""
    return block.get(key, otherwise) if isinstance(block, dict) else getattr(block, key, otherwise)


def _foreign_keys(scenario: Scenario) -> Iterator[tuple[FieldPath, str]]:
    """Yields the keys that belong to another filter than the scenario's, and that filter."""
    for other, paths in _KEYS_OF.items():
        if other == scenario.estimation.filter:
            continue
        for path in paths:
            here: Any = scenario
            for part in path[:-1]:
                here = getattr(here, part)
            value, default = getattr(here, path[-1]), type(here).model_fields[path[-1]].default
            if isinstance(value, Model):
                keys = [key for key in type(value).model_fields if getattr(value, key) != getattr(default, key)]
                yield from (((*path, key), other) for key in keys)
            elif value != default:
                yield path, other


def _overlaps(field: str, windows: list[tuple[str, float, float]]) -> Iterator[tuple[FieldPath, str]]:
    """Finds windows of the same axis, jet or joint that overlap, each with the first one before it that it overlaps."""
    for index, (what, start, end) in enumerate(windows):
        for other in range(index):
            if windows[other][0] == what and start < windows[other][2] and windows[other][1] < end:
                both = (f"{moment(begin)} to {moment(until)} s" for begin, until in ((start, end), windows[other][1:]))
                yield (
                    (field, index),
                    f"overlaps {field}[{other}] on the same axis, jet or joint ({what}): {' and '.join(both)}",
                )
                break


def check_against_vehicle(scenario: Scenario, vehicle: Vehicle) -> list[tuple[FieldPath, str]]:
    """Finds the problems of a scenario that only show against its vehicle, each with the path of its field."""
    outside = plausible.out_of_span(scenario, vehicle.units, skipped=("vehicle",))
    problems = [(finding.path, finding.problem) for finding in outside]
    if problems:  # nothing can be reckoned with such numbers
        return problems

    def require(what: str, name: str, valid: Iterable[str], *path: str | int) -> None:
        names = list(valid)
        if name not in names:
            problem = f"{name!r} is no {what} of vehicle '{vehicle.name}'{suggestion(name, names)}"
            problems.append((path, problem))

    problems.extend(_not_followed(scenario, vehicle))
    problems.extend(_impossible_parts(scenario, vehicle))
    known = {
        "jet": vehicle.designations,
        "wheel": tuple(wheel.name for wheel in vehicle.wheels),
        "engine": tuple(engine.name for engine in vehicle.engines),
        "tank": tuple(tank.name for tank in vehicle.tanks),
    }
    for what, name, path in _named(scenario):
        require(what, name, known[what], *path)
    problems.extend(_open_twice(scenario, vehicle))
    problems.extend(_beyond_stops(scenario, vehicle))
    problems.extend(_impossible_jumps(scenario, vehicle))
    faulty: list[str] = []
    for index, errors in enumerate(scenario.sensors.errors):
        require("sensor", errors.sensor, vehicle.sensor_names(), "sensors", "errors", index, "sensor")
        if errors.sensor in faulty:
            problem = f"'{errors.sensor}' has errors already; give one entry"
            problems.append((("sensors", "errors", index, "sensor"), problem))
        faulty.append(errors.sensor)
    if scenario.sensors.gyro is not None:
        require("gyro", scenario.sensors.gyro, (gyro.name for gyro in vehicle.gyros), "sensors", "gyro")
    if scenario.sensors.accelerometer is not None:
        packages = (package.name for package in vehicle.accelerometers)
        require("accelerometer", scenario.sensors.accelerometer, packages, "sensors", "accelerometer")
    for index, kind in enumerate((scenario.autopilot.jet_kinds or ()) if not scenario.open_loop else ()):
        require("jet kind", kind, vehicle.jet_kinds, "autopilot", "jet_kinds", index)
    for name in scenario.faults.jets:
        require("jet", name, vehicle.designations, "faults", "jets", name)
    problems.extend(_no_on_times(scenario, vehicle))
    problems.extend(_no_wheels(scenario, vehicle))
    problems.extend(_no_test_firing(scenario))
    problems.extend(_too_many_faults(scenario.faults, vehicle))
    period = vehicle.sample_period_s
    problems.extend(_of_the_plant(scenario, vehicle))
    if vehicle.motion == "planar" and isinstance(scenario.plant, PlantBlock) and scenario.plant.dispersion.axes_deg:
        problem = f"vehicle '{vehicle.name}' moves in a plane, in which its axes do not tilt; leave it out"
        problems.append((("plant", "dispersion", "axes_deg"), problem))
    if scenario.duration_s < period:
        problems.append((("duration_s",), f"must be at least one sample period, {period:g} s"))
    if not problems:
        found = plausible.of_scenario(scenario, vehicle)
        problems.extend((finding.path, finding.problem) for finding in found if finding.impossible)
    return problems


def _too_many_faults(faults: FaultsBlock, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds rates by which more than one event is expected in a sample period."""
    period, components = vehicle.sample_period_s, 3 * (len(vehicle.gyros) + len(vehicle.accelerometers))
    own = [jet.per_hour for jet in faults.jets.values() if jet.per_hour is not None]
    of_jets = sum(own) + (len(vehicle.jets) - len(own)) * faults.jet_per_hour
    total = of_jets + faults.payload_per_hour + components * faults.reading_per_hour + faults.unknown_per_hour
    most = 3600.0 / period
    if total > most:
        parts = f"{len(vehicle.jets)} jets, payloads, {components} components and what is unknown"
        problem = (
            f"rates of {parts} sum to {total:.3g} per hour, {total / most:.3g} events in a sample period of {period:g} "
            f"s; at most one, {most:.3g} per hour"
        )
        yield ("faults",), problem
    if faults.change_per_hour > most:
        problem = (
            f"{faults.change_per_hour:.3g} is {faults.change_per_hour / most:.3g} changes in a sample period of "
            f"{period:g} s; at most one, {most:.3g} per hour"
        )
        yield ("faults", "change_per_hour"), problem


def _no_on_times(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds on-times to be flown with jets that do not take them, or whose clock is too coarse."""
    if scenario.open_loop or scenario.autopilot.jet_selection.output != "on_time":
        return
    path: FieldPath = ("autopilot", "jet_selection", "output")
    if not vehicle.has_on_times:
        problem = (
            f"on_time does not go with vehicle '{vehicle.name}', whose commands of jets are levels; use cycles, or "
            "give the vehicle jet_commands: {as: on_time}"
        )
        yield path, problem
    for name, kind in vehicle.jet_kinds.items():
        if kind.on_time_quantum_s > vehicle.sample_period_s:
            problem = (
                f"on_time does not go with jets of kind '{name}', whose on_time_quantum_s of "
                f"{kind.on_time_quantum_s:g} s is longer than a sample, {vehicle.sample_period_s:g} s"
            )
            yield path, problem


def _no_test_firing(scenario: Scenario) -> Iterator[tuple[FieldPath, str]]:
    """Finds reasons for which an autopilot cannot fly test firings."""
    path: FieldPath = ("autopilot", "test_firing")
    if scenario.autopilot.test_firing is None:
        return
    if scenario.jet_schedule:
        yield path, "does not go with jet_schedule, which prescribes jets as well; leave out one of the two"
    elif scenario.open_loop:
        yield path, "needs an autopilot; leave out autopilot.engaged: false"


def _no_wheels(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds reasons for which wheels cannot turn the vehicle, and wheels that start faster than they can turn."""
    speeds = scenario.plant.wheel_speeds
    for wheel in vehicle.wheels:
        if abs(speeds.get(wheel.name, 0.0)) > wheel.fastest:
            problem = f"{speeds[wheel.name]:g} is beyond the wheel's speed_limit, {wheel.fastest:g} rad/s"
            yield ("plant", "wheel_speeds", wheel.name), problem
    block, path = scenario.autopilot.wheels, ("autopilot", "wheels")
    if block is None:
        return
    if scenario.open_loop:
        yield path, "does not go with jet_schedule without an autopilot; leave it out, or set autopilot.engaged: true"
    if scenario.wheel_schedule:
        yield ("wheel_schedule",), "does not go with autopilot.wheels, which turns the wheels; leave out one of the two"
    axes = np.array([wheel.axis for wheel in vehicle.wheels]).reshape(-1, 3)
    if np.linalg.matrix_rank(axes, tol=0.01) < 3:
        problem = f"needs wheels about three axes, of which vehicle '{vehicle.name}' has {len(axes) or 'none'}"
        yield path, problem
    endless = [wheel.name for wheel in vehicle.wheels if wheel.speed_limit is None]
    if block.unload_above is not None and endless:
        problem = f"is a share of a wheel's speed_limit, which the vehicle does not give for '{endless[0]}'"
        yield (*path, "unload_above"), problem


def _of_the_plant(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds entries that do not go with the kind of the plant, or with its time step."""
    period, loop = vehicle.sample_period_s, scenario.execution.engine == "loop"
    covers = "loop does not cover a continuous plant, whose steps are Drake's; use diagram"
    if isinstance(scenario.plant, PlantBlock):
        step = scenario.plant.time_step
        if step not in (None, 0.0) and not math.isclose(step, period, rel_tol=1e-12):
            problem = f"must be 0 (continuous) or the vehicle's sample period, {period:g} s; got {step:g}"
            yield ("plant", "time_step"), problem
        if step == 0.0 and loop:
            yield ("execution", "engine"), f"{covers}, or leave out plant.time_step"
        yield from _of_true_tanks(scenario.plant, vehicle)
        return
    if loop:
        yield ("execution", "engine"), covers
    if scenario.jumps:
        problem = "a multibody plant knows no payload that leaves or comes; leave them out, or use plant.kind: rigid"
        yield ("jumps",), problem
    if vehicle.motion == "planar":
        problem = f"multibody does not go with vehicle '{vehicle.name}', which moves in a plane; use rigid"
        yield ("plant", "kind"), problem
    if vehicle.engines:
        problem = (
            f"multibody does not go with vehicle '{vehicle.name}', whose engines are no part of a model; use rigid"
        )
        yield ("plant", "kind"), problem
    if vehicle.tanks:
        problem = f"multibody does not go with vehicle '{vehicle.name}', whose tanks no firing empties; use rigid"
        yield ("plant", "kind"), problem


def _of_true_tanks(plant: PlantBlock, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds more propellant in a true tank than it holds, or less than none."""
    for tank in vehicle.tanks:
        held = plant.propellant.get(tank.name, tank.propellant)
        if not 0.0 <= held <= tank.capacity:
            problem = f"must be between 0 and the tank's capacity, {tank.capacity:g}, got {held:g}"
            yield ("plant", "propellant", tank.name), problem


def _not_followed(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds a filter, or an engine, that does not match whether the vehicle is followed in a fixed frame."""
    named = scenario.estimation.filter
    if scenario.moving and named != "joint":
        yield ("moving",), f"plays no part in estimation.filter: {named}; use joint, or leave it out"
    if vehicle.wheels and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no wheels, which vehicle '{vehicle.name}' has; use joint"
    elif scenario.engine_schedule and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no engines, which engine_schedule burns; use joint"
    elif vehicle.tanks and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no tanks, which vehicle '{vehicle.name}' has; use joint"
    elif vehicle.needs_pose_filter != (named == "pose") and not (vehicle.tracked and named == "pose"):
        needs = "which needs pose" if vehicle.needs_pose_filter else "which has no pose or velocity sensor; use joint"
        yield ("estimation", "filter"), f"{named} does not go with vehicle '{vehicle.name}', {needs}"


def _named(scenario: Scenario) -> Iterator[tuple[Literal["jet", "wheel", "engine", "tank"], str, FieldPath]]:
    """Yields the jets, wheels, engines and tanks that a scenario names, and where."""
    for index, pulse in enumerate(scenario.jet_schedule):
        yield "jet", pulse.jet, ("jet_schedule", index, "jet")
    for index, failure in enumerate(scenario.failures):
        yield "jet", failure.jet, ("failures", index, "jet")
    for index, turn in enumerate(scenario.wheel_schedule):
        yield "wheel", turn.wheel, ("wheel_schedule", index, "wheel")
    for name in scenario.plant.wheel_speeds:
        yield "wheel", name, ("plant", "wheel_speeds", name)
    for index, burn in enumerate(scenario.engine_schedule):
        yield "engine", burn.engine, ("engine_schedule", index, "engine")
    for index, lost in enumerate(scenario.engine_failures):
        yield "engine", lost.engine, ("engine_failures", index, "engine")
    if isinstance(scenario.plant, PlantBlock):
        for name in scenario.plant.engine_errors:
            yield "engine", name, ("plant", "engine_errors", name)
        for name in scenario.plant.propellant:
            yield "tank", name, ("plant", "propellant", name)


def _beyond_stops(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds angles that the gimbal of an engine does not reach."""
    stops = {engine.name: 0.0 if engine.gimbal is None else engine.gimbal.stop for engine in vehicle.engines}
    for index, burn in enumerate(scenario.engine_schedule):
        most = stops.get(burn.engine, math.inf)
        if max(map(abs, burn.gimbal)) > most:
            at = f"its gimbal's stop is at {most:g} rad" if most else "it has no gimbal"
            yield ("engine_schedule", index, "gimbal"), f"{max(map(abs, burn.gimbal)):g} rad for {burn.engine}: {at}"


def _open_twice(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds pulses that open a jet a second time in a sample: a command holds one opening."""
    if not vehicle.has_on_times:
        return
    period_s, before = vehicle.sample_period_s, dict[tuple[str, int], int]()
    for index, pulse in enumerate(scenario.jet_schedule):
        first, end = samples_of(pulse.start_s, pulse.end_s, period_s)
        for sample in {first, end - 1} if end > first else ():
            if (pulse.jet, sample) in before:
                other = f"jet_schedule[{before[pulse.jet, sample]}]"
                yield (
                    ("jet_schedule", index),
                    f"opens {pulse.jet} a second time in the sample from {moment(sample * period_s)} s on, beside "
                    f"{other}; a jet opens once in a sample of {period_s:g} s",
                )
                break
            before[pulse.jet, sample] = index


def _impossible_parts(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Yields problems of parts that move inside, with those of the vehicle."""
    nominal, every = vehicle.nominal, (*vehicle.moving, *scenario.moving)
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    if scenario.moving and (problem := not_followed(every, known, vehicle.sample_period_s)):
        yield ("moving",), problem


def _impossible_jumps(scenario: Scenario, vehicle: Vehicle) -> list[tuple[FieldPath, str]]:
    """Finds a payload whose arrival or departure would leave an impossible body."""
    if not isinstance(scenario.plant, PlantBlock):
        return []
    properties = scenario.plant.mass_properties
    body = vehicle.nominal if properties is None else properties.properties()
    order = sorted(range(len(scenario.jumps)), key=lambda index: scenario.jumps[index].time_s)
    for index in order:
        jump = scenario.jumps[index]
        mass, position, inertia = jump_terms(jump)
        if body.mass + mass <= 0.0:
            return [(("jumps", index, "mass"), f"releases {-mass:g} of a vehicle that has {body.mass:g} left")]
        body = joined(body, mass, position, inertia)
        if not could_be_inertia(body.inertia):
            problem = "leaves an inertia that no rigid body has; check mass, position and inertia"
            return [(("jumps", index), problem)]
        for finding in plausible.of_body(body, vehicle, ("jumps", index)):
            if finding.impossible:
                return [(finding.path, f"leaves a body of which this {finding.problem}")]
    return []


def jump_terms(jump: MassJump) -> tuple[float, Array, Array]:
    """Returns mass, position and inertia of a payload; mass and inertia are negative if it leaves."""
    sign = -1.0 if jump.kind == "release" else 1.0
    inertia = np.zeros((3, 3)) if jump.inertia is None else np.array(jump.inertia)
    return sign * jump.mass, np.array(jump.position), sign * inertia


# ----------------------------------------------------------------------------------------- loading


def bundled_scenarios() -> list[str]:
    """Lists the scenarios that come with the package."""
    return bundled("scenario")


def load_scenario(scenario: str | Path, overrides: list[str] | None = None) -> Scenario:
    """Loads a bundled scenario by name, or one from a YAML file or a run's folder, together with its vehicle.

    Args:
        scenario: a name that `massprop list` shows, or the path of a file or of a run's folder.
        overrides: `KEY=VALUE` each, KEY dotted (`sensors.errors[0].noise_std`, `vehicle.gyros[0].quantum`), VALUE
            read as YAML.

    Raises:
        InputError: when there is none of that name, or its data are wrong; the message says where.
    """
    name = str(scenario)
    folder = Path()
    if name in bundled_scenarios():
        text = (resources.files("massprop_drake.scenarios") / f"{name}.yaml").read_text(encoding="utf-8")
        document = Document(text, f"scenario '{name}'")
    else:
        path = Path(scenario)
        if exists(path / "scenario.yaml"):
            path = path / "scenario.yaml"
        if not exists(path):
            require_named(name, "scenario")
        document = Document(read_text(path), str(path))
        require_kind(document.data, "scenario", str(path))
        folder = path.parent
    given: set[FieldPath] = set()
    for override in overrides or []:
        if override.startswith("vehicle."):
            _spell_out_vehicle(document, folder)
        set_field(document.data, override, given)
    return resolved(document.data, document, folder)


def _spell_out_vehicle(document: Document, folder: Path) -> None:
    """Puts the data of a vehicle into a scenario that names it, so that a field of it can be set."""
    named = document.data.get("vehicle", Scenario.model_fields["vehicle"].default)
    if isinstance(named, str):
        document.data["vehicle"] = _find_vehicle(named, folder, document).model_dump(mode="json")


def resolved(data: Any, document: Document | None = None, folder: Path | None = None) -> Scenario:
    """Makes a scenario from data, loads its vehicle and checks one against the other.

    Args:
        data: a mapping of a scenario's fields.
        document: the document it came from, for messages.
        folder: what a vehicle's file is relative to; default the current one.

    Raises:
        InputError: naming each field that is wrong.
    """
    data = _with_model(data, document, folder or Path())
    vehicle = data.get("vehicle", _USUAL_VEHICLE)
    if isinstance(vehicle, dict):  # validated by itself, so that messages name its fields
        vehicle = _inline_vehicle(vehicle, document)
    own = data if not isinstance(vehicle, (str, Vehicle)) else {key: data[key] for key in data if key != "vehicle"}
    there = vehicle if isinstance(vehicle, Vehicle) else _named_vehicle(vehicle, folder)
    scenario = validated(Scenario, _in_present_terms(_with_filter(own, there), document), document)
    vehicle = there or _find_vehicle(vehicle, folder or Path(), document)
    problems = check_against_vehicle(scenario, vehicle)
    if problems:
        raise InputError(*(f"{_place(path, document)}: {problem}" for path, problem in problems))
    return scenario.model_copy(update={"vehicle": vehicle})


def _with_model(data: Any, document: Document | None, folder: Path) -> Any:
    """Returns data in which the text of a multibody model stands in place of its file."""
    plant = data.get("plant")
    model = plant.get("model") if isinstance(plant, dict) else None
    if not isinstance(model, str) or plant.get("kind") != "multibody":
        return data
    try:
        return {**data, "plant": {**plant, "model": model_text(model, folder)}}
    except InputError as error:
        raise InputError(*(f"{_place(('plant', 'model'), document)}: {one}" for one in error.problems)) from None


def _named_vehicle(vehicle: Any, folder: Path | None) -> Vehicle | None:
    """Returns the vehicle that data name; None where there is none, which is reported when it is loaded for good."""
    try:
        return _find_vehicle(vehicle, folder or Path(), None) if isinstance(vehicle, str) else None
    except InputError:
        return None


def _with_filter(data: Any, vehicle: Vehicle | None) -> Any:
    """Returns data that name the filter which alone goes with a vehicle, where they name none."""
    if vehicle is None or not vehicle.needs_pose_filter or not isinstance(data, dict):
        return data
    estimation = data.get("estimation", {})
    return {**data, "estimation": {"filter": "pose", **estimation}} if isinstance(estimation, dict) else data


def _in_present_terms(data: Any, document: Document | None = None) -> Any:
    """Replaces former terms of the detector in data, with one warning."""
    if not isinstance(data, dict):
        return data
    faults, usual = data.get("faults"), DETECTORS_OF.get(filter_of(data), ("off",))[0]
    if isinstance(faults, FaultsBlock):  # a program's; `slots` may have to be put in
        data = {**data, "faults": faults.model_dump(mode="json", exclude_unset=True)}
    data, said = renamed.with_present_detector(data, usual)
    if said:
        renamed.warn(f"{'scenario' if document is None else document.source}: {', '.join(said)}", 4)
    if said and document is not None and "slots" not in data["detector"]:
        document.move(("detector", "slots"), ("faults", "slots"))
    return data


def _place(path: FieldPath, document: Document | None) -> str:
    return f"scenario: {dotted(path)}" if document is None else document.where(path)


def _inline_vehicle(data: Any, document: Document | None) -> Vehicle:
    try:
        return validated(Vehicle, data, None)
    except InputError as error:
        source = document.source if document is not None else "scenario"
        # of the vehicle as a whole, or of one of its keys
        said = (f"vehicle{problem}" if problem.startswith(":") else f"vehicle.{problem}" for problem in error.problems)
        raise InputError(*(f"{source}: {problem}" for problem in said)) from None


def _find_vehicle(name: str, folder: Path, document: Document | None) -> Vehicle:
    beside = Path(os.path.normpath(folder / name))
    try:
        return load_vehicle(beside if exists(beside) else name)
    except InputError as error:
        if document is None:
            raise
        raise InputError(*(f"{document.where(('vehicle',))}: {problem}" for problem in error.problems)) from None


def set_field(data: Any, override: str, given: set[FieldPath] | None = None) -> None:
    """Sets one field of a scenario's data from KEY=VALUE.

    Args:
        data: of the scenario.
        override: KEY=VALUE.
        given: fields that were set before, which stay when the kind of their block is replaced; the field is added.

    Raises:
        InputError: when it says something else, or names what cannot be set.
    """
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise InputError(f"--set {override}: expected KEY=VALUE, such as --set rotation.filter=extended")
    if len(text.splitlines()) > 1:
        raise InputError(
            f"--set {key}=...: the value has more than one line; write a list as [a, b], a mapping as {{a: 1, b: 2}}"
        )
    path = parsed_key(key, override)
    now = renamed.key_now(path)
    if now is not None:
        renamed.warn(f"--set {override}: {path[-1]} is now {now}")
        path[-1] = now
    text = f"value: {text}" if text.strip() else "value: null"
    value = Document(text, f"--set {override}", within=tuple(path)).data["value"]
    replace_at(data, path, value, f"--set {override}", set() if given is None else given)


def replace_at(data: Any, path: list[str | int], value: Any, where: str, given: set[FieldPath]) -> None:
    """Sets one field of a scenario's data; with the kind of a block, keys that meant something to the former one go.

    Args:
        data, path, value, where: as `set_at` takes them.
        given: fields that were set before, which stay; the field is added.

    Raises:
        InputError: when the path leads nowhere.
    """
    *above, last = field = tuple(path)
    former = value_at(data, path) if last == "kind" else None
    of_detector = field == ("detector", "kind")
    if of_detector and value == renamed.FORMER_KIND:
        renamed.warn(f"{where}: {value} is now {renamed.PRESENT_KIND}", 3)
        value = renamed.PRESENT_KIND
    set_at(data, path, value, where)
    if last == "kind":
        leaving = keys_of_former_kind(Scenario, data, field[:-1], former)
        if of_detector:
            leaving += [key for key in renamed.keys_left_behind(former, value) if key in value_at(data, above)]
        for key in dict.fromkeys(leaving):
            if not any(one[: len(field)] == (*above, key) for one in given):
                del value_at(data, above)[key]
    given.add(field)


def value_at(data: Any, path: Sequence[str | int]) -> Any:
    """Returns the value at a path in nested data; None where there is none."""
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def set_at(data: Any, path: list[str | int], value: Any, where: str) -> None:
    """Sets one field of nested data; missing blocks are made.

    Args:
        data: mappings and lists.
        path: keys and indices; an index may be one past the end of its list.
        value: to set.
        where: what to call it in messages.

    Raises:
        InputError: when the path leads nowhere.
    """
    here = data
    for part, following in pairwise(path):
        if isinstance(part, str) and isinstance(here, dict):
            here = here.setdefault(part, [] if isinstance(following, int) else {})
            continue
        if isinstance(part, int) and isinstance(here, list) and part < len(here):
            here = here[part]
            continue
        raise InputError(f"{where}: there is no {part!r} to set in")
    last = path[-1]
    if isinstance(last, str) and isinstance(here, dict):
        here[last] = value
    elif isinstance(last, int) and isinstance(here, list) and last <= len(here):
        here[last : last + 1] = [value]
    else:
        raise InputError(f"{where}: there is no {last!r} to set")


def parsed_key(key: str, override: str) -> list[str | int]:
    """Splits a dotted key such as sensors.errors[0].noise_std into its parts.

    Raises:
        InputError: when it is none; the message begins with --set and the override.
    """
    path: list[str | int] = []
    for part in key.split("."):
        name, *indices = part.split("[")
        if name:
            path.append(name)
        for index in indices:
            if not index.endswith("]") or not _INDEX.fullmatch(index[:-1]):
                raise InputError(f"--set {override}: expected an index such as [0] in {key!r}")
            path.append(int(index[:-1]))
        if not name and not indices:
            raise InputError(f"--set {override}: empty part in {key!r}")
    return path
