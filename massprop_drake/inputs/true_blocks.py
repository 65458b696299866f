"""The true vehicle in a scenario: one rigid body, or a model of bodies and joints; and its disturbance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import (
    Flag,
    Model,
    NotNegative,
    NotNegative3,
    Positive,
    Real,
    RelativeSigma,
    Text,
    Vector3,
    described,
    field_validation_error,
)
from massprop_drake.inputs.model_file import model_joints
from massprop_drake.inputs.scheduled import ScheduledInterval, find_overlaps
from massprop_drake.inputs.vehicle_parts import MassPropertiesModel
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.mass_properties import Spread
from massprop_drake.maths.vehicle.joint_moves import peak_rate


class EngineErrors(Model):
    """Errors of a true engine, in the order of its axes."""

    thrust: tuple[Real, Real] = described((0.0, 0.0), "at level 0 and at level 1, relative")
    direction: tuple[Real, Real] = described((0.0, 0.0), "angles about the gimbal's axes", "rad")
    position: tuple[Real, Real] = described((0.0, 0.0), "shifts across the direction", "ft | m")


class DisturbanceBlock(Model):
    """Uncommanded torque and force, body axes: a mean, and a first-order Gauss-Markov process about it."""

    torque: Vector3 = described(
        (0.0, 0.0, 0.0), "mean torque about the center of mass", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )
    torque_std: NotNegative3 = described(
        (0.0, 0.0, 0.0), "1-sigma of its changing part", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )
    force: Vector3 = described(
        (0.0, 0.0, 0.0), "mean force at the center of mass", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    force_std: NotNegative3 = described(
        (0.0, 0.0, 0.0), "1-sigma of its changing part", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    correlation_time_s: Positive = described(
        100.0, "correlation time of the changing part, which is held over a sample", "s", span=plausible.CORRELATION
    )


class _Plant(Model):
    """The fields common to all true vehicles."""

    kind: Literal["rigid", "multibody"]
    integrator: Literal["runge_kutta3", "runge_kutta5", "bogacki_shampine3"] = described(
        "runge_kutta5", "Drake's scheme for the continuous plant"
    )
    accuracy: Positive = described(1e-10, "accuracy of that integrator", span=plausible.ACCURACY)
    thrust_transient: Literal["none", "vehicle"] = described(
        "vehicle", "none: instantaneous thrust; vehicle: first-order lag with the vehicle's time constants"
    )
    lag_factor: Real = described(1.0, "true time constants of thrust over the vehicle file's", gt=0.0, le=10.0)
    thrust_dispersion: RelativeSigma = described(0.0, "1-sigma of each jet's constant thrust error, relative, drawn")
    mounting_dispersion: Real = described(
        0.0, "1-sigma of each jet's mounting error, in the vehicle's stated 1-sigmas, drawn", ge=0.0, le=10.0
    )
    initial_rate: Vector3 = described((0.0, 0.0, 0.0), "rate at the start, body axes", "rad/s", span=plausible.RATE)
    disturbance: DisturbanceBlock = described(
        DisturbanceBlock(), "torque and force that nobody commands, a mean and a drawn changing part"
    )
    wheel_speeds: dict[Text, Real] = described({}, "speeds of wheels at the start, by name; others stand", "rad/s")
    wheel_dispersion: RelativeSigma = described(0.0, "1-sigma of each wheel's inertia error, relative, drawn")


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
        """Standard deviations as fractions and rad, as `draw_body` takes them."""
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


class JointMove(ScheduledInterval):
    """A move of a joint by its drive, along a profile of least jerk."""

    joint: Text = described(..., "name of a joint of one degree of freedom")
    start_s: NotNegative = described(..., "start of the move", "s", span=plausible.TIME)
    end_s: Positive = described(..., "end of the move", "s", span=plausible.TIME)
    position: Real = described(..., "position at the end", "rad | ft | m")


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
    def _require_feasible_moves(self) -> MultibodyBlock:
        """Raises ValidationError for overlapping moves, joints stated twice, or joints that move too fast."""
        problems = list(find_overlaps("moves", [(move.joint, move.start_s, move.end_s) for move in self.moves]))
        joints = [start.joint for start in self.joints]
        problems += [
            (("joints", index, "joint"), f"'{name}' has an entry already; give one")
            for index, name in enumerate(joints)
            if name in joints[:index]
        ]
        if problems := problems or list(self._find_fast_joints()):
            raise field_validation_error(problems)
        return self

    def _find_fast_joints(self) -> Iterator[tuple[FieldPath, str]]:
        """Yields path and problem of joints that start, or are moved, faster than the largest plausible rate."""
        max_rate = plausible.RATE.most
        position_by_joint = {start.joint: start.position for start in self.joints}
        for index, start in enumerate(self.joints):
            if abs(start.rate) > max_rate:
                yield ("joints", index, "rate"), f"{start.rate:g} per s, is above {max_rate:g}: {plausible.RATE.why}"
        for index, move in sorted(enumerate(self.moves), key=lambda entry: entry[1].start_s):
            distance = move.position - position_by_joint.get(move.joint, 0.0)
            fastest = peak_rate(distance, move.end_s - move.start_s)
            if fastest > max_rate:
                problem = f"reaches {fastest:.3g} per s, above {max_rate:g}: {plausible.RATE.why}; give it more time"
                yield ("moves", index), problem
            position_by_joint[move.joint] = move.position
