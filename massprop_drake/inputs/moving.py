"""Parts that move inside a vehicle, as its file states them: sloshing propellant, hinged panels, and modes of a model.

Each becomes one mode or more, see `maths.estimation.joint.modes`. A mass m on springs along unit vectors e, at the
point p, has Phi_v = m^1/2 e and Phi_w = m^1/2 p x e about the vehicle origin. A panel of the mass m and the inertia I
about its hinge, which is along the unit vector a through the point h, moves every point x by a x (x - h): with its
center of mass at c,

    Phi_v = m a x (c - h) I^-1/2,    Phi_w = (I a + h x (m a x (c - h))) I^-1/2,

for a hinge along a principal axis of the panel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import (
    Model,
    Name,
    NotNegative,
    Positive,
    Real,
    RelativeSigma,
    Share,
    Vector3,
    described,
)
from massprop_drake.inputs.vehicle_parts import UnitVector, require_unit_length
from massprop_drake.maths.estimation.joint.modes import ERRORS, ModeParams
from massprop_drake.maths.linear_algebra import Array

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_PLACED = 0.05  # of the jets' RMS arm: 1-sigma of a position, as of the middle of what sloshes in a tank
_TURNS = 0.1  # physics: of a swing in a sample, through which thrust is taken as even
_SQUARE_TOLERANCE = 0.01  # of the cosine between two directions that are square


class _MovingPart(Model):
    """The fields common to all parts that move."""

    name: Name = described(..., "unique name")
    frequency_hz: Positive = described(..., "natural frequency with the vehicle held still", "Hz", span=plausible.SWING)
    damping: Real = described(..., "ratio to critical damping", ge=0.0, lt=1.0)
    frequency_uncertainty: RelativeSigma = described(0.05, "1-sigma of the frequency, relative, estimated; 0: known")
    damping_uncertainty: Share = described(0.5, "1-sigma of the damping, relative, likewise")
    position_std: NotNegative | None = described(
        None,
        "1-sigma of each coordinate of its place, likewise; null: 5 % of the jets' RMS arm",
        "ft | m",
        span=plausible.POSITION,
    )


class Slosh(_MovingPart):
    """Propellant, or any mass, that moves on springs."""

    kind: Literal["slosh"] = described(..., "kind of part")
    mass: Positive = described(..., "moving mass", "slug | kg", span=plausible.MASS)
    position: Vector3 = described(..., "its place at rest, vehicle frame", "ft | m", span=plausible.POSITION)
    axes: tuple[Literal["x", "y", "z"] | Vector3, ...] = described(
        ...,
        "one to three directions of motion at right angles: x, y, z, or vectors of length 1, body axes",
        min_length=1,
        max_length=3,
    )
    pivot: Vector3 | None = described(
        None,
        "point about which it swings as a pendulum, at right angles to its axes, vehicle frame; null: "
        "straight on springs",
        "ft | m",
        span=plausible.POSITION,
    )
    mass_uncertainty: Share = described(0.05, "1-sigma of the mass, relative, likewise")
    start_std: NotNegative | None = described(
        None,
        "1-sigma of its displacement at the start, each axis; null: as the weakest jet's thrust holds it",
        "ft | m",
        span=plausible.POSITION,
    )

    @field_validator("axes")
    @classmethod
    def _require_orthonormal_axes(cls, value: tuple[str | Vector3, ...]) -> tuple[str | Vector3, ...]:
        """Raises ValueError unless the axes are unit vectors, square to each other."""
        axes = _directions(value)
        for axis in axes:
            require_unit_length(axis)
        if np.abs(axes @ axes.T - np.eye(len(axes))).max() > _SQUARE_TOLERANCE:
            raise ValueError("must be square to each other")
        return value

    @model_validator(mode="after")
    def _require_arm_normal_to_axes(self) -> Slosh:
        """Raises ValueError unless the arm from pivot to position is square to the axes."""
        if self.pivot is not None:
            arm = np.array(self.position) - np.array(self.pivot)
            length = float(np.linalg.norm(arm))
            if np.abs(_directions(self.axes) @ arm).max() > _SQUARE_TOLERANCE * length or length == 0.0:
                raise ValueError(f"slosh '{self.name}': the arm from pivot to position must be square to the axes")
        return self

    @property
    def bow(self) -> Array:
        """Change of the mode shape with the coordinate, -n/L for an arm L n, zero without a pivot, shape (3,)."""
        if self.pivot is None:
            return np.zeros(3)
        arm = np.array(self.position) - np.array(self.pivot)
        return np.asarray(-arm / (arm @ arm))

    @property
    def modes(self) -> list[tuple[Array, Array]]:
        """Mode shapes of translation and rotation, Phi_v and Phi_w, about the vehicle origin, a pair per axis."""
        root = math.sqrt(self.mass)
        axes = _directions(self.axes)
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        return [(root * axis, root * np.cross(self.position, axis)) for axis in axes]

    def swelling(self, center: Array) -> list[Array]:
        """Computes the inertia's derivative I_1 by each modal coordinate, about a center of mass, matrices (3, 3)."""
        return _inertia_derivatives(self.modes, np.array(self.position) - center)

    @property
    def size_uncertainty(self) -> float:
        """1-sigma of the participation, relative."""
        return 0.5 * self.mass_uncertainty

    @property
    def start_sigma(self) -> float | None:
        """1-sigma of the modal coordinate eta at the start."""
        return None if self.start_std is None else math.sqrt(self.mass) * self.start_std


class HingedPanel(_MovingPart):
    """A rigid panel on a springy hinge."""

    kind: Literal["panel"] = described(..., "kind of part")
    hinge: Vector3 = described(..., "point of the hinge line, vehicle frame", "ft | m", span=plausible.POSITION)
    axis: UnitVector = described(..., "direction of the hinge, body axes, length 1")
    mass: Positive = described(..., "mass of the panel", "slug | kg", span=plausible.MASS)
    center_of_mass: Vector3 = described(..., "its center of mass, vehicle frame", "ft | m", span=plausible.POSITION)
    inertia: Positive = described(..., "inertia about its hinge", "slug-ft^2 | kg-m^2", span=plausible.INERTIA)
    inertia_uncertainty: Share = described(0.05, "1-sigma of the inertia, relative, likewise")
    start_std: Share | None = described(None, "1-sigma of its angle at the start; null: likewise", "rad")

    @model_validator(mode="after")
    def _require_possible_inertia(self) -> HingedPanel:
        """Raises ValueError where the inertia about the hinge is less than that of the panel's mass at its center."""
        least = self.mass * float(np.sum(np.cross(self._unit_axis, self._arm) ** 2))
        if self.inertia < (1.0 - _SQUARE_TOLERANCE) * least:
            raise ValueError(
                f"panel '{self.name}': an inertia of {self.inertia:g} about the hinge is less than that of its mass at "
                f"its center of mass, {least:.4g}"
            )
        return self

    @property
    def _unit_axis(self) -> Array:
        """Direction of the hinge axis, length 1, shape (3,)."""
        axis = np.array(self.axis)
        return np.asarray(axis / np.linalg.norm(axis))

    @property
    def _arm(self) -> Array:
        """Vector from hinge to the panel's center of mass, ft or m, shape (3,)."""
        return np.array(self.center_of_mass) - np.array(self.hinge)

    @property
    def modes(self) -> list[tuple[Array, Array]]:
        """Mode shape of translation and rotation, Phi_v and Phi_w, about the vehicle origin."""
        translation = self.mass * np.cross(self._unit_axis, self._arm) / math.sqrt(self.inertia)
        return [(translation, math.sqrt(self.inertia) * self._unit_axis + np.cross(self.hinge, translation))]

    def swelling(self, center: Array) -> list[Array]:
        """Computes the inertia's derivative I_1 by the modal coordinate, the panel as a point mass, shape (3, 3)."""
        return _inertia_derivatives(self.modes, np.array(self.center_of_mass) - center)

    @property
    def size_uncertainty(self) -> float:
        """1-sigma of the participation, relative."""
        return 0.5 * self.inertia_uncertainty

    @property
    def start_sigma(self) -> float | None:
        """1-sigma of the modal coordinate eta at the start."""
        return None if self.start_std is None else math.sqrt(self.inertia) * self.start_std


class StatedMode(_MovingPart):
    """A mode of unit modal mass, as from a finite-element model of the vehicle held still."""

    kind: Literal["mode"] = described(..., "kind of part")
    translation: Vector3 = described((0.0, 0.0, 0.0), "participation in translation, body axes", "slug^1/2 | kg^1/2")
    rotation: Vector3 = described(
        (0.0, 0.0, 0.0), "participation in rotation about the vehicle origin", "slug^1/2-ft | kg^1/2-m"
    )
    participation_uncertainty: Share = described(0.05, "1-sigma of the participation, relative, likewise")
    start_std: NotNegative | None = described(
        None, "1-sigma of its coordinate at the start; null: likewise", "slug^1/2-ft | kg^1/2-m"
    )

    @model_validator(mode="after")
    def _require_motion(self) -> StatedMode:
        """Raises ValueError for a mode without translation and rotation."""
        if not any((*self.translation, *self.rotation)):
            raise ValueError(f"mode '{self.name}' moves nothing; give translation, rotation or both")
        return self

    @property
    def modes(self) -> list[tuple[Array, Array]]:
        """Mode shape of translation and rotation, Phi_v and Phi_w, about the vehicle origin."""
        return [(np.array(self.translation), np.array(self.rotation))]

    def swelling(self, center: Array) -> list[Array]:
        """Returns the inertia's derivative I_1 by the modal coordinate, not stated: zero, shape (3, 3)."""
        return [np.zeros((3, len(center)))]

    @property
    def size_uncertainty(self) -> float:
        """1-sigma of the participation, relative."""
        return self.participation_uncertainty

    @property
    def start_sigma(self) -> float | None:
        """1-sigma of the modal coordinate eta at the start."""
        return self.start_std


AnyPart = Slosh | HingedPanel | StatedMode
MovingPart = Annotated[AnyPart, Field(discriminator="kind")]


def _inertia_derivatives(modes: list[tuple[Array, Array]], arm: Array) -> list[Array]:
    """Computes the derivative I_1 of a point mass's inertia by each modal coordinate, a list of (3, 3) matrices."""
    return [2.0 * (arm @ push) * np.eye(3) - np.outer(arm, push) - np.outer(push, arm) for push, _ in modes]


def _directions(axes: Sequence[str | Vector3]) -> Array:
    """Returns axes, named x, y, z or given as vectors, as an array, shape (n, 3)."""
    return np.array([_AXES[axis] if isinstance(axis, str) else axis for axis in axes], dtype=np.float64)


def join_parts(of_vehicle: Sequence[AnyPart], of_scenario: Sequence[AnyPart]) -> tuple[AnyPart, ...]:
    """Returns the parts that move of a vehicle and of a scenario; those that both state count once."""
    return (*of_vehicle, *(part for part in of_scenario if part not in of_vehicle))


def moving_parts_problem(parts: Sequence[AnyPart], nominal: tuple[float, Array, Array], period_s: float) -> str | None:
    """Describes why a filter cannot estimate parts that move, such as a frequency too high; None: it can.

    Args:
        parts: as they are stated.
        nominal: see `mode_params`.
        period_s: sample period, s.
    """
    if len({part.name for part in parts}) < len(parts):
        return "two parts have one name"
    for part in parts:
        if part.frequency_hz * period_s > _TURNS:
            return (
                f"'{part.name}' swings at {part.frequency_hz:g} Hz, too fast for samples of {period_s:g} s, up to "
                f"{_TURNS / period_s:g} Hz; leave it out, and state joint.rate_walk and joint.velocity_walk"
            )
    if not _leaves_mass_and_inertia(parts, nominal):
        return "they have as much mass or inertia as the vehicle, which is the whole with them"
    return None


def _leaves_mass_and_inertia(parts: Sequence[AnyPart], nominal: tuple[float, Array, Array]) -> bool:
    """Tests whether mass and inertia stay positive without the moving parts, arguments as `mode_params`."""
    mass, center, inertia = nominal
    pairs = [pair for part in parts for pair in part.modes]
    translations, rotations = (np.array([pair[k] for pair in pairs]).reshape(-1, 3) for k in (0, 1))
    rotations -= np.cross(center, translations)
    parts_share = translations @ translations.T / mass + rotations @ np.linalg.solve(inertia, rotations.T)
    return bool(np.linalg.eigvalsh(parts_share).max(initial=0.0) < 1.0)


def _crossing(parts: Sequence[Slosh | HingedPanel | StatedMode], shapes: Array, owners: NDArray[np.int_]) -> Array:
    """Computes cross products of the mode shapes of one sloshing mass, over its mass, else zero, shape (n, n, 3)."""
    result = np.zeros((owners.size, owners.size, 3))
    for row, owner in enumerate(owners):
        part = parts[owner]
        for column in np.flatnonzero(owners == owner) if isinstance(part, Slosh) else ():
            result[row, column] = np.cross(shapes[column], shapes[row]) / part.mass
    return result


def mode_params(
    parts: Sequence[AnyPart], nominal: tuple[float, Array, Array], wrenches: Array, arm: float
) -> ModeParams:
    """Makes the joint filter's parameters of vibration modes from sloshing masses, panels and stated modes.

    Args:
        parts: as they are stated.
        nominal: mass, center of mass and inertia of the nominal vehicle.
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        arm: RMS distance of the jets from the nominal center of mass, ft or m.
    """
    mass, center, inertia = nominal
    pairs = [pair for part in parts for pair in part.modes]
    translations, rotations = (np.array([pair[k] for pair in pairs]).reshape(-1, 3) for k in (0, 1))
    owners = np.array([index for index, part in enumerate(parts) for _ in part.modes], dtype=np.int_)
    frequencies = np.array([2.0 * math.pi * parts[owner].frequency_hz for owner in owners])
    moments = wrenches[:, :3] - np.cross(center, wrenches[:, 3:])
    accelerations = np.abs(translations @ wrenches[:, 3:].T / mass)
    accelerations += np.abs((rotations - np.cross(center, translations)) @ np.linalg.solve(inertia, moments.T))
    held = accelerations / frequencies[:, None] ** 2
    pendulums = [part if isinstance(part, Slosh) else None for part in (parts[owner] for owner in owners)]
    bows = np.array([np.zeros(3) if part is None else part.bow for part in pendulums]).reshape(-1, 3)
    positions = np.array([np.zeros(3) if part is None else part.position for part in pendulums]).reshape(-1, 3)
    weakest = int(np.argmin(np.linalg.norm(wrenches[:, 3:], axis=1)))
    starts = [parts[owner].start_sigma for owner in owners]
    return ModeParams(
        translation=translations,
        rotation=rotations,
        crossing=_crossing(parts, translations, owners),
        bow=bows,
        bow_turn=np.cross(positions - center, bows),
        swelling=np.array([swell for part in parts for swell in part.swelling(center)]).reshape(-1, 3, 3),
        frequencies=frequencies,
        dampings=np.array([parts[owner].damping for owner in owners]),
        parts=owners,
        sigmas=np.array(
            [
                (part.size_uncertainty, part.frequency_uncertainty, part.damping_uncertainty)
                + 3 * (_PLACED * arm if part.position_std is None else part.position_std,)
                for part in parts
            ]
        ).reshape(-1, ERRORS),
        start=np.array([own if start is None else start for start, own in zip(starts, held[:, weakest], strict=True)]),
        shaken=held.max(axis=1, initial=0.0),
    )
