"""Vehicle in Drake's Meshcat, live or recorded: body, jets, plumes, and the true and estimated center of mass.

The page keeps its center of mass in the middle. Stars, or the floor below a vehicle that moves in a plane, keep their
direction, so that a turn and the flown path can be seen.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Cylinder, Ellipsoid, Meshcat, MeshcatCone, MeshcatParams, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import PointCloud

from massprop_drake.display import solids
from massprop_drake.display.links import Links
from massprop_drake.display.style import (
    ESTIMATE_COLOR,
    FAILED_COLOR,
    PATH_COLOR,
    PAYLOAD_COLOR,
    PLUME_COLOR,
    STAR_COLOR,
    SUSPECT_COLOR,
    TRUTH_COLOR,
)
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import BoxSolid, ConeSolid, CylinderSolid, EllipsoidSolid, PlateSolid, Solid

Array = NDArray[np.float64]

_OPACITY = 0.6  # of the body: the centers of mass lie inside
_EXTENT = 4.0  # of the vehicle in Meshcat's lengths, which its lights are made for
_VIEW = np.array([0.46, -0.64, 0.36])  # direction of the camera
_FIELD = np.radians(75.0)  # of Meshcat's camera, from top to bottom
_CLOSE = 1.15  # distance of the camera over that from which a ball around the vehicle fits: room for what is beside
_STARS, _FAR, _STAR_SIZE = 400, 12.0, 0.12  # number of stars, their distance and size in extents of the vehicle
_TILES, _BELOW = 12, 0.6  # of the floor: lines to each side, one axis apart; its distance, in extents
_BODY = "/world/body"
_STRUCTURE = f"{_BODY}/structure"  # the vehicle frame
_MARKS = {"failed": FAILED_COLOR, "found": SUSPECT_COLOR}


class MeshcatStage:
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
        self._extent = solids.extent(vehicle)
        self.axis = solids.round_length(0.45 * self._extent)
        self.spread = solids.spread_limits(vehicle)
        self.meshcat = _start_quiet_meshcat()
        self._set_up_world()
        self._draw_body()
        self._draw_axes()
        self._draw_jets()
        self._draw_centers(truth)
        self._draw_surroundings()

    def add_path(self, positions: Array) -> None:
        """Adds the path of the center of mass, fixed frame, ft or m, shape (n, 3); the page shows the part flown."""
        self.meshcat.SetLine("/world/path", np.asfortranarray(positions.T), 2.0, _rgba(PATH_COLOR, 1.0))

    def add_mark(self, kind: str, jet: int) -> None:
        """Adds a hidden ball that marks a jet as truly failed, "failed", or declared failed, "found"."""
        path = f"{_STRUCTURE}/marks/{kind}{jet}"
        self.meshcat.SetObject(path, Sphere(solids.mark_radius(self._vehicle, kind)), _rgba(_MARKS[kind], 0.55))
        self.meshcat.SetTransform(path, RigidTransform(self._vehicle.positions[jet]))
        self.meshcat.SetProperty(path, "visible", False)

    def add_payload(self, number: int, mass: float, position: Array) -> None:
        """Adds the ball of a payload, slug or kg, at a point of the vehicle frame, ft or m, shape (3,)."""
        path = f"{_STRUCTURE}/payloads/{number}"
        self.meshcat.SetObject(path, Sphere(solids.payload_radius(self._vehicle, mass)), _rgba(PAYLOAD_COLOR, 0.6))
        self.meshcat.SetTransform(path, RigidTransform(position))

    # --------------------------------------------------------------------------------------- parts

    def _set_up_world(self) -> None:
        """Scales the world with z down, sets the background, and points the camera at the vehicle."""
        scale = _EXTENT / self._extent
        self.meshcat.SetTransform("/world", np.diag([scale, -scale, -scale, 1.0]))  # z of the body points down
        for path in ("/Grid", "/Axes"):
            self.meshcat.SetProperty(path, "visible", False)
        self.meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
        self.meshcat.SetProperty("/Background/<object>", "bottom_color", [0.75, 0.79, 0.85])
        away = _VIEW / np.linalg.norm(_VIEW) * _CLOSE * solids.radius(self._vehicle) / np.sin(0.5 * _FIELD)
        self.meshcat.SetCameraPose(scale * away, np.zeros(3))

    def _draw_body(self) -> None:
        """Draws the links of the multibody model, or else the vehicle's solids."""
        if self.links is not None:
            self.links.draw(self.meshcat, f"{_STRUCTURE}/links")
            return
        for number, solid in enumerate(solids.vehicle_solids(self._vehicle)):
            _draw_solid(self.meshcat, f"{_STRUCTURE}/shape/{number}", solid)

    def _draw_axes(self) -> None:
        """Draws the axes of the vehicle frame in red, green and blue."""
        length, radius = self.axis, 0.003 * self._extent
        for axis, color in enumerate(((0.8, 0.2, 0.2), (0.2, 0.6, 0.2), (0.2, 0.3, 0.8))):
            direction = np.eye(3)[axis]
            path = f"{_BODY}/axes/{'xyz'[axis]}"
            self.meshcat.SetObject(path, Cylinder(radius, length), Rgba(*color, 0.8))
            self.meshcat.SetTransform(path, RigidTransform(_rotation_from_z(direction), 0.5 * length * direction))

    def _draw_jets(self) -> None:
        """Draws nozzles, and hidden plumes at full-thrust length."""
        vehicle = self._vehicle
        lengths = solids.plume_lengths(vehicle, np.array([jet.thrust for jet in vehicle.jets])).tolist()
        for index, jet in enumerate(vehicle.jets):
            path = f"{_STRUCTURE}/jets/{index}"
            outwards = -vehicle.thrusts[index] / jet.thrust
            self.meshcat.SetTransform(path, RigidTransform(_rotation_from_z(outwards), vehicle.positions[index]))
            nozzle = solids.nozzle_length(vehicle)
            shape = MeshcatCone(nozzle, 0.5 * nozzle, 0.5 * nozzle)
            self.meshcat.SetObject(f"{path}/nozzle", shape, Rgba(0.25, 0.28, 0.33, 1.0))
            plume = MeshcatCone(lengths[index], 0.2 * lengths[index], 0.2 * lengths[index])
            self.meshcat.SetObject(f"{path}/plume", plume, _rgba(PLUME_COLOR, 0.75))
            self.meshcat.SetProperty(f"{path}/plume", "visible", False)

    def _draw_centers(self, truth: bool) -> None:
        """Draws the estimated center of mass with its 3-sigma ellipsoid, and the true one if known."""
        radius = solids.center_radius(self._vehicle)
        if truth:
            self.meshcat.SetObject(f"{_BODY}/center", Sphere(radius), _rgba(TRUTH_COLOR, 0.45))
        path = f"{_STRUCTURE}/estimate"
        self.meshcat.SetObject(f"{path}/point", Sphere(0.7 * radius), _rgba(ESTIMATE_COLOR, 1.0))
        self.meshcat.SetObject(f"{path}/spread", Sphere(1.0), _rgba(ESTIMATE_COLOR, 0.22))

    def _draw_surroundings(self) -> None:
        """Draws the fixed background: a floor below a planar vehicle, stars around any other."""
        if self._vehicle.motion == "planar":
            reach = self.axis * _TILES
            along = self.axis * np.arange(-_TILES, _TILES + 1)
            ends = [
                np.stack([along, np.full(along.shape, end), np.full(along.shape, _BELOW * self._extent)])
                for end in (-reach, reach)
            ]
            both = (np.hstack([end, end[[1, 0, 2]]]) for end in ends)
            self.meshcat.SetLineSegments("/world/floor", *map(np.asfortranarray, both), 1.0, _rgba(STAR_COLOR, 0.5))
            return
        directions = np.random.default_rng(0).standard_normal((3, _STARS))
        cloud = PointCloud(_STARS)
        cloud.mutable_xyzs()[:] = _FAR * self._extent * directions / np.linalg.norm(directions, axis=0)
        size = _STAR_SIZE * _EXTENT  # points are not scaled with the world
        self.meshcat.SetObject("/world/stars", cloud, size, _rgba(STAR_COLOR, 1.0))


def _start_quiet_meshcat() -> Meshcat:
    """Starts Meshcat on localhost without its announcement on the terminal."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost"))
    finally:
        log.setLevel(level)


def _draw_solid(meshcat: Meshcat, path: str, solid: Solid) -> None:
    """Draws a solid at its place in the vehicle frame, below a Meshcat path."""
    place = RigidTransform(RotationMatrix(solids.rotation(solid)), np.array(solid.position))
    color = _rgba(solid.color, _OPACITY)
    match solid:
        case BoxSolid():
            meshcat.SetObject(path, Box(*solid.size), color)
        case EllipsoidSolid():
            meshcat.SetObject(path, Ellipsoid(*solid.radii), color)
        case CylinderSolid():
            _draw_mesh(meshcat, path, solids.cylinder(solid.length, solid.radii), color)
        case ConeSolid():
            # Meshcat's cone stands on its point: turned so that the point looks along +x
            meshcat.SetObject(f"{path}/cone", MeshcatCone(solid.length, solid.radii[1], solid.radii[0]), color)
            point = np.array([0.5 * solid.length, 0.0, 0.0])
            meshcat.SetTransform(f"{path}/cone", RigidTransform(_rotation_from_z(np.array([-1.0, 0.0, 0.0])), point))
        case PlateSolid():
            _draw_mesh(meshcat, path, solids.plate(np.array(solid.outline), solid.thickness), color)
    meshcat.SetTransform(path, place)


def _draw_mesh(meshcat: Meshcat, path: str, mesh: tuple[Array, NDArray[np.int_]], color: Rgba) -> None:
    """Draws a mesh of triangles, visible from both sides."""
    vertices, faces = mesh
    meshcat.SetTriangleMesh(path, vertices.T, np.vstack([faces, faces[:, ::-1]]).T, color)


def _rotation_from_z(direction: Array) -> RotationMatrix:
    """Returns a rotation matrix that takes the z axis to a direction."""
    return RotationMatrix.MakeFromOneVector(direction, 2)


def _rgba(color: str, opacity: float) -> Rgba:
    """Converts a color "#rrggbb" and an opacity from 0 to 1 to Drake's color."""
    red, green, blue = (int(color[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    return Rgba(red, green, blue, opacity)
