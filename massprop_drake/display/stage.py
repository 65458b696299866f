"""A vehicle in Drake's Meshcat, live or recorded: body, jets, plumes, and the true and estimated center of mass.

The page keeps its center of mass in the middle, and the inertial axes keep their direction.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Cylinder, Ellipsoid, Meshcat, MeshcatCone, MeshcatParams, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from massprop_drake.display.links import Links
from massprop_drake.display.style import (
    ESTIMATE_COLOR,
    FAILED_COLOR,
    PAYLOAD_COLOR,
    PLUME_COLOR,
    SUSPECT_COLOR,
    TRUTH_COLOR,
)
from massprop_drake.inputs.vehicle import (
    BoxSolid,
    ConeSolid,
    CylinderSolid,
    EllipsoidSolid,
    PlateSolid,
    Solid,
    Vehicle,
)

Array = NDArray[np.float64]

_OPACITY = 0.6  # of the body: the centers of mass lie inside
_EXTENT = 4.0  # of the vehicle in Meshcat's lengths, which its lights are made for
_VIEW = np.array([0.46, -0.64, 0.36])  # direction of the camera
_FIELD = np.radians(75.0)  # of Meshcat's camera, from top to bottom
_CLOSE = 1.15  # distance of the camera over that from which a ball around the vehicle fits: room for what is beside
_BODY = "/world/body"
_STRUCTURE = f"{_BODY}/structure"  # the vehicle frame
_MARKS = {"failed": (FAILED_COLOR, 1.0), "found": (SUSPECT_COLOR, 1.5)}  # color and size


class Stage:
    """Shows a vehicle in Meshcat; the page moves it.

    Attributes:
        meshcat: what shows it.
        axis: length of the axes, a round number, ft or m.
        spread: least and largest half axis of the 3-sigma ellipsoid that is shown, ft or m.
        links: of a multibody model, which take the place of the vehicle's shape; None: there are none.

    Args:
        vehicle: the one to show.
        truth: whether to show the true center of mass.
        links: of its multibody model, if it has one.
    """

    def __init__(self, vehicle: Vehicle, *, truth: bool, links: Links | None = None):
        self._vehicle = vehicle
        self.links = links if links is not None and links.drawn else None
        self._extent = _extent(vehicle)
        self.axis = round_length(0.45 * self._extent)
        self.spread = (0.002 * self._extent, 0.35 * self._extent)
        self.meshcat = _quiet_meshcat()
        self._prepare()
        self._draw_body()
        self._draw_axes()
        self._draw_jets()
        self._draw_centers(truth)

    def add_mark(self, kind: str, jet: int) -> None:
        """Adds a hidden mark to a jet, "failed" or "found"."""
        color, size = _MARKS[kind]
        path = f"{_STRUCTURE}/marks/{kind}{jet}"
        self.meshcat.SetObject(path, Sphere(0.022 * size * self._extent), _rgba(color, 0.55))
        self.meshcat.SetTransform(path, RigidTransform(self._vehicle.positions[jet]))
        self.meshcat.SetProperty(path, "visible", False)

    def add_payload(self, number: int, mass: float, position: Array) -> None:
        """Adds a payload, slug or kg, at a point of the vehicle frame, ft or m, shape (3,)."""
        share = mass / self._vehicle.nominal.mass
        radius = 0.1 * self._extent * min(max(share, 0.02), 2.0) ** (1.0 / 3.0)
        path = f"{_STRUCTURE}/payloads/{number}"
        self.meshcat.SetObject(path, Sphere(radius), _rgba(PAYLOAD_COLOR, 0.6))
        self.meshcat.SetTransform(path, RigidTransform(position))

    # --------------------------------------------------------------------------------------- parts

    def _prepare(self) -> None:
        scale = _EXTENT / self._extent
        self.meshcat.SetTransform("/world", np.diag([scale, -scale, -scale, 1.0]))  # z of the body points down
        for path in ("/Grid", "/Axes"):
            self.meshcat.SetProperty(path, "visible", False)
        self.meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
        self.meshcat.SetProperty("/Background/<object>", "bottom_color", [0.75, 0.79, 0.85])
        away = _VIEW / np.linalg.norm(_VIEW) * _CLOSE * _radius(self._vehicle) / np.sin(0.5 * _FIELD)
        self.meshcat.SetCameraPose(scale * away, np.zeros(3))

    def _draw_body(self) -> None:
        if self.links is not None:
            self.links.draw(self.meshcat, f"{_STRUCTURE}/links")
            return
        for number, solid in enumerate(self._vehicle.shape or _box(self._vehicle)):
            _draw_solid(self.meshcat, f"{_STRUCTURE}/shape/{number}", solid)

    def _draw_axes(self) -> None:
        length, radius = self.axis, 0.003 * self._extent
        for axis, color in enumerate(((0.8, 0.2, 0.2), (0.2, 0.6, 0.2), (0.2, 0.3, 0.8))):
            direction = np.eye(3)[axis]
            path = f"{_BODY}/axes/{'xyz'[axis]}"
            self.meshcat.SetObject(path, Cylinder(radius, length), Rgba(*color, 0.8))
            self.meshcat.SetTransform(path, RigidTransform(_along(direction), 0.5 * length * direction))

    def _draw_jets(self) -> None:
        vehicle, extent = self._vehicle, self._extent
        strongest = max(jet.thrust for jet in vehicle.jets)
        for index, jet in enumerate(vehicle.jets):
            path = f"{_STRUCTURE}/jets/{index}"
            outwards = -vehicle.thrusts[index] / jet.thrust
            self.meshcat.SetTransform(path, RigidTransform(_along(outwards), vehicle.positions[index]))
            nozzle = 0.016 * extent
            shape = MeshcatCone(nozzle, 0.5 * nozzle, 0.5 * nozzle)
            self.meshcat.SetObject(f"{path}/nozzle", shape, Rgba(0.25, 0.28, 0.33, 1.0))
            length = (0.05 + 0.11 * (jet.thrust / strongest) ** 0.5) * extent
            plume = MeshcatCone(length, 0.2 * length, 0.2 * length)
            self.meshcat.SetObject(f"{path}/plume", plume, _rgba(PLUME_COLOR, 0.75))
            self.meshcat.SetProperty(f"{path}/plume", "visible", False)

    def _draw_centers(self, truth: bool) -> None:
        radius = 0.012 * self._extent
        if truth:
            self.meshcat.SetObject(f"{_BODY}/center", Sphere(radius), _rgba(TRUTH_COLOR, 0.45))
        path = f"{_STRUCTURE}/estimate"
        self.meshcat.SetObject(f"{path}/point", Sphere(0.7 * radius), _rgba(ESTIMATE_COLOR, 1.0))
        self.meshcat.SetObject(f"{path}/spread", Sphere(1.0), _rgba(ESTIMATE_COLOR, 0.22))


def _quiet_meshcat() -> Meshcat:
    """Starts Meshcat on localhost without its announcement on the terminal."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost"))
    finally:
        log.setLevel(level)


def _extent(vehicle: Vehicle) -> float:
    """Returns the largest dimension of the vehicle, jets and solids, along an axis, ft or m."""
    return float(np.ptp(_corners(vehicle), axis=0).max()) or 1.0


def _radius(vehicle: Vehicle) -> float:
    """Returns the distance from the nominal center of mass of the farthest point of the vehicle, ft or m."""
    return float(np.linalg.norm(_corners(vehicle) - vehicle.nominal.center_of_mass, axis=1).max()) or 1.0


def _corners(vehicle: Vehicle) -> Array:
    """Returns points on the outside of the vehicle, jets and solids, ft or m, shape (n, 3)."""
    solids = [_turned(solid).multiply(_outside(solid).T).T for solid in vehicle.shape]
    return np.vstack([vehicle.positions, *solids])


def _turned(solid: Solid) -> RigidTransform:
    """Returns where a solid stands in the vehicle frame."""
    return RigidTransform(RollPitchYaw(np.radians(solid.rotation_deg)), np.array(solid.position))


def round_length(length: float) -> float:
    """Returns the longest with one digit that is no longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(f"{power * np.floor(length / power * (1.0 + 1e-9)):.0e}")


def _outside(solid: Solid) -> Array:
    """Returns corners of a solid, or of a box around it, in its own axes, ft or m, shape (n, 3)."""
    match solid:
        case PlateSolid():
            outline = np.array(solid.outline)
            return np.column_stack([outline, np.zeros(len(outline))])
        case BoxSolid():
            half = 0.5 * np.array(solid.size)
        case EllipsoidSolid():
            return np.vstack([np.diag(solid.radii), -np.diag(solid.radii)])
        case CylinderSolid() | ConeSolid():
            half = np.array([0.5 * solid.length, *solid.radii])
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(signs * half)


def _box(vehicle: Vehicle) -> tuple[Solid, ...]:
    """Makes a box that spans the jets, for a vehicle without a shape."""
    low, high = vehicle.positions.min(axis=0), vehicle.positions.max(axis=0)
    size = np.maximum(0.9 * (high - low), 0.15 * float((high - low).max() or 1.0))
    middle = 0.5 * (low + high)
    return (BoxSolid(kind="box", size=tuple(size.tolist()), position=tuple(middle.tolist())),)


def _draw_solid(meshcat: Meshcat, path: str, solid: Solid) -> None:
    place = _turned(solid)
    color = _rgba(solid.color, _OPACITY)
    match solid:
        case BoxSolid():
            meshcat.SetObject(path, Box(*solid.size), color)
        case EllipsoidSolid():
            meshcat.SetObject(path, Ellipsoid(*solid.radii), color)
        case CylinderSolid():
            vertices, faces = _cylinder(solid.length, solid.radii)
            meshcat.SetTriangleMesh(path, vertices, faces, color)
        case ConeSolid():
            # Meshcat's cone stands on its point: turned so that the point looks along +x
            meshcat.SetObject(f"{path}/cone", MeshcatCone(solid.length, solid.radii[1], solid.radii[0]), color)
            point = np.array([0.5 * solid.length, 0.0, 0.0])
            meshcat.SetTransform(f"{path}/cone", RigidTransform(_along(np.array([-1.0, 0.0, 0.0])), point))
        case PlateSolid():
            vertices, faces = _plate(np.array(solid.outline), solid.thickness)
            meshcat.SetTriangleMesh(path, vertices, faces, color)
    meshcat.SetTransform(path, place)


def _plate(outline: Array, thickness: float) -> tuple[Array, NDArray[np.int_]]:
    """Makes the vertices (3, n) and triangles (3, k) of a plate, every face seen from both sides."""
    count = outline.shape[0]
    sides = [np.column_stack([outline, np.full(count, side)]) for side in (-0.5 * thickness, 0.5 * thickness)]
    faces = []
    for base in (0, count):
        faces += [(base, base + corner, base + corner + 1) for corner in range(1, count - 1)]
    for corner in range(count):
        following = (corner + 1) % count
        faces += [(corner, following, count + following), (corner, count + following, count + corner)]
    both = faces + [face[::-1] for face in faces]
    return np.vstack(sides).T, np.array(both).T


def _cylinder(length: float, radii: tuple[float, float]) -> tuple[Array, NDArray[np.int_]]:
    """Makes the vertices and triangles of a cylinder along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    outline = np.column_stack([radii[0] * np.cos(angle), radii[1] * np.sin(angle)])
    vertices, faces = _plate(outline, length)
    return vertices[[2, 0, 1]], faces


def _along(direction: Array) -> RotationMatrix:
    """Returns a rotation that takes z to a direction."""
    return RotationMatrix.MakeFromOneVector(direction, 2)


def _rgba(color: str, opacity: float) -> Rgba:
    red, green, blue = (int(color[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    return Rgba(red, green, blue, opacity)
