"""Parts of a vehicle's file: mass properties, jets, tanks, surroundings, and the solids of its shape."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, create_model, field_validator, model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import (
    Matrix3,
    Model,
    Name,
    NotNegative,
    NotNegative3,
    Positive,
    Real,
    RelativeSigma,
    Share,
    Text,
    Vector3,
    Whole,
    described,
    field_validation_error,
)
from massprop_drake.maths.mass_properties import MassProperties, is_possible_inertia

_UNIT_LENGTH_TOLERANCE = 0.002  # of a direction, as printed tables have it
_LARGEST_NUMBER = 1_000_000  # of a jet or a cluster
Positive3 = tuple[Positive, Positive, Positive]


def require_unit_length(value: Vector3) -> Vector3:
    """Returns a direction unchanged; raises ValueError if its length is not 1."""
    length = float(np.linalg.norm(value))
    if abs(length - 1.0) > _UNIT_LENGTH_TOLERANCE:
        raise ValueError(f"must have length 1 within {_UNIT_LENGTH_TOLERANCE}, got {length:.6g}")
    return value


UnitVector = Annotated[Vector3, AfterValidator(require_unit_length)]


def _require_symmetric(value: Matrix3) -> Matrix3:
    """Returns an inertia matrix; raises ValueError where it is not symmetric."""
    inertia = np.array(value)
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=0.0):
        raise ValueError("must be symmetric: element (i, j) equal to element (j, i)")
    return value


SymmetricMatrix3 = Annotated[Matrix3, AfterValidator(_require_symmetric)]


class MassPropertiesModel(Model):
    """Mass, center of mass and inertia of a rigid body, as a file gives them."""

    mass: Positive = described(..., "mass", "slug | kg", span=plausible.MASS)
    center_of_mass: Vector3 = described(..., "center of mass, vehicle frame", "ft | m", span=plausible.POSITION)
    inertia: SymmetricMatrix3 = described(
        ...,
        "inertia matrix about the center of mass, body axes; products are its entries (negative integrals)",
        "slug-ft^2 | kg-m^2",
        span=plausible.INERTIA,
    )

    @field_validator("inertia")
    @classmethod
    def _require_possible_inertia(cls, value: Matrix3) -> Matrix3:
        """Raises ValueError for an inertia that no rigid body has."""
        inertia = np.array(value)
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 1e-9 * moments[2]:
            raise ValueError(
                f"must be positive definite; its principal moments are {', '.join(f'{m:.6g}' for m in moments)}"
            )
        if not is_possible_inertia(inertia):
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

    nominal_thrust: Positive = described(
        ..., "thrust without plume impingement, for the propellant flow", "lbf | N", span=plausible.FORCE
    )
    specific_impulse_s: Positive = described(
        ..., "specific impulse; flow = thrust / (g0 x this)", "s", span=plausible.SPECIFIC_IMPULSE
    )
    time_constant_s: NotNegative = described(
        0.0, "first-order time constant of build-up and tail-off", "s", span=plausible.VALVE
    )
    minimum_on_time_s: NotNegative = described(0.0, "shortest firing", "s", span=plausible.VALVE)
    on_time_quantum_s: NotNegative = described(
        0.0, "step of the valve's clock, for `autopilot.jet_selection.output: on_time`", "s", span=plausible.VALVE
    )
    thrust_uncertainty: RelativeSigma = described(
        0.01, "1-sigma of each jet's constant thrust error, relative; for filter: joint, like the next four"
    )
    direction_std: RelativeSigma = described(0.0, "1-sigma of a jet's direction about either axis, estimated", "rad")
    position_std: NotNegative = described(
        0.0, "1-sigma of the force's place across its direction, estimated", "ft | m", span=plausible.POSITION
    )
    lag_uncertainty: Share = described(0.2, "1-sigma of the time constant, relative, one error per kind")
    repeatability: Share = described(0.0, "1-sigma of a jet's impulse over a sample, relative, white")
    command_delay_s: Real = described(
        0.0,
        "delay from command to action; negative where records pair readings with a command already in "
        "force; for filter: pose, like all below",
        "s",
        span=plausible.VALVE,
    )
    command_delay_std_s: NotNegative = described(
        0.0, "its 1-sigma, one error per kind; 0: known, unless a record contradicts it", "s", span=plausible.VALVE
    )
    opening_delay_s: Real = described(
        0.0,
        "delay of opening beyond that of closing; negative: pulses are longer than commanded",
        "s",
        span=plausible.VALVE,
    )
    opening_delay_std_s: NotNegative = described(
        0.0, "its 1-sigma, one error per kind; 0: known", "s", span=plausible.VALVE
    )
    pulse_scatter: Share = described(0.0, "1-sigma of a pulse's impulse, relative, one error from opening to closing")


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
    direction: UnitVector = described(..., "direction of the force on the vehicle, body axes, length 1 within 0.002")
    thrust: Positive = described(
        ..., "force on the vehicle, plume impingement included", "lbf | N", span=plausible.FORCE
    )
    manifold: Name | None = described(None, "manifold that feeds it; null: none that can be closed")
    mass_flow: Positive | None = described(
        None, "flow at full thrust; null: by its kind", "slug/s | kg/s", span=plausible.FLOW
    )
    thrust_uncertainty: RelativeSigma | None = described(
        None, "1-sigma of its constant thrust error, relative, as from a bench; null: that of its kind"
    )


class Tank(Model):
    """A propellant tank, in which propellant stands as a column at the outlet's end.

    The vehicle's mass properties have its propellant in them. What jets use up lies at the column's surface.
    """

    name: Name = described(..., "unique name", min_length=1)
    outlet: Vector3 = described(..., "middle of the outlet end, vehicle frame", "ft | m", span=plausible.POSITION)
    axis: UnitVector = described(..., "direction from there along the propellant, body axes, length 1")
    length: Positive = described(..., "length of the full column", "ft | m", span=plausible.SIZE)
    radius: NotNegative = described(0.0, "radius of the column", "ft | m", span=plausible.POSITION)
    capacity: Positive = described(..., "propellant when full", "slug | kg", span=plausible.MASS)
    propellant: NotNegative = described(..., "propellant at the start", "slug | kg", span=plausible.PAYLOAD)
    propellant_std: NotNegative = described(
        0.0, "its 1-sigma, estimated; 0: known", "slug | kg", span=plausible.PAYLOAD
    )
    flow_uncertainty: RelativeSigma = described(
        0.01,
        "1-sigma of the flow's constant error besides that of thrusts, relative, as by specific impulse, "
        "estimated; 0: known",
    )
    feeds: tuple[Name, ...] = described(..., "jets, or kinds of jets, that it feeds", min_length=1)

    @model_validator(mode="after")
    def _require_propellant_fits(self) -> Tank:
        """Raises ValidationError where a tank holds more than its capacity."""
        if self.propellant > self.capacity:
            problem = f"is {self.propellant:g}, more than the capacity, {self.capacity:g}"
            raise field_validation_error([(("propellant",), problem)])
        return self


class Surroundings(Model):
    """Forces and accelerations on the vehicle besides its jets'; used by `estimation.filter: pose`."""

    drag: NotNegative = described(0.0, "force against the velocity", "lbf-s/ft | N-s/m")
    drag_std: NotNegative = described(0.0, "its 1-sigma; 0: known", "lbf-s/ft | N-s/m")
    angular_drag: NotNegative = described(0.0, "torque against the rate", "ft-lbf-s | N-m-s")
    angular_drag_std: NotNegative = described(0.0, "its 1-sigma; 0: known", "ft-lbf-s | N-m-s")
    slope_std: NotNegative = described(
        0.0,
        "1-sigma of a constant acceleration in the fixed frame, as on a table that is not level",
        "ft/s^2 | m/s^2",
        span=plausible.ACCELERATION,
    )
    slope_walk: NotNegative = described(0.0, "its random walk, 1-sigma after 1 s")
    turn_std: NotNegative = described(
        0.0, "1-sigma of a constant angular acceleration, body axes, as by swirl", "rad/s^2"
    )
    turn_walk: NotNegative = described(0.0, "its random walk, 1-sigma after 1 s")
    heading_turn_std: NotNegative = described(
        0.0,
        "1-sigma of the cosine and sine parts of an angular acceleration that goes with the heading, as "
        "by an off-center mass on a tilted support",
        "rad/s^2",
    )
    velocity_walk: NotNegative = described(
        0.0,
        "random walk of the velocity by unmodeled forces, 1-sigma after 1 s",
        "ft/s/sqrt(s) | m/s/sqrt(s)",
        span=plausible.VELOCITY_STEP,
    )
    rate_walk: NotNegative = described(
        0.0, "random walk of the rate by unmodeled torques, likewise", "rad/s/sqrt(s)", span=plausible.RATE_STEP
    )
    kicks_per_minute: NotNegative = described(0.0, "rate of unstated pushes")
    kick_velocity: NotNegative = described(0.0, "change of velocity by one, 1-sigma", "ft/s | m/s")
    kick_rate: NotNegative = described(0.0, "change of rate by one, 1-sigma", "rad/s")


def _repeat_per_axis(value: Any) -> Any:
    """Repeats a single number for each of three axes; returns any other value unchanged."""
    return (value,) * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


PerAxis = Annotated[NotNegative3, BeforeValidator(_repeat_per_axis)]


class Disturbance(Model):
    """Uncommanded torque and force, body axes, that change slowly: drag, solar pressure, venting.

    Each component is a first-order Gauss-Markov process, estimated along with the mass properties.
    """

    torque_std: PerAxis = described(
        (0.0, 0.0, 0.0),
        "1-sigma of the torque about the center of mass; one number: for each component",
        "ft-lbf | N-m",
        span=plausible.OUTSIDE_TORQUE,
    )
    force_std: PerAxis = described(
        (0.0, 0.0, 0.0), "1-sigma of the force, likewise", "lbf | N", span=plausible.OUTSIDE_FORCE
    )
    time_constant_s: Positive = described(..., "correlation time", "s", span=plausible.CORRELATION)

    @model_validator(mode="after")
    def _require_torque_or_force(self) -> Disturbance:
        """Raises ValueError where neither torque nor force acts."""
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
    length: Positive = described(..., "along x", "ft | m", span=plausible.SIZE)
    radii: tuple[Positive, Positive] = described(..., "half axes along y and z", "ft | m", span=plausible.SIZE)


class ConeSolid(_Solid):
    """A cone that points toward +x, its center halfway along its axis."""

    kind: Literal["cone"] = described(..., "kind of solid")
    length: Positive = described(..., "along x", "ft | m", span=plausible.SIZE)
    radii: tuple[Positive, Positive] = described(
        ..., "half axes of the base along y and z", "ft | m", span=plausible.SIZE
    )


class PlateSolid(_Solid):
    """A flat plate with a convex outline in the x-y plane of its own frame, such as a wing."""

    kind: Literal["plate"] = described(..., "kind of solid")
    outline: tuple[tuple[Real, Real], ...] = described(
        ..., "corners in order, x and y", "ft | m", min_length=3, max_length=1000, span=plausible.POSITION
    )
    thickness: Positive = described(..., "along z", "ft | m", span=plausible.SIZE)


Solid = Annotated[BoxSolid | EllipsoidSolid | CylinderSolid | ConeSolid | PlateSolid, Field(discriminator="kind")]
