"""Solids that draw a vehicle: their places, sizes, and surfaces as triangles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import BoxSolid, ConeSolid, CylinderSolid, EllipsoidSolid, PlateSolid, Solid

Array = NDArray[np.float64]

_AROUND = 48  # corners of a circle
_NOZZLE = 0.016  # length of a nozzle over the vehicle's extent
_NOZZLE_CORNERS = 12
_MARKS = {"failed": 0.022, "found": 0.033}  # radius over the vehicle's extent


def vehicle_solids(vehicle: Vehicle) -> tuple[Solid, ...]:
    """Returns the solids of a vehicle; a box that spans its jets if it has none."""
    return vehicle.shape or (_box(vehicle),)


def rotation(solid: Solid) -> Array:
    """Computes the rotation matrix from a solid's axes to the vehicle frame, by roll, pitch, yaw, shape (3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = (turn(np.radians(solid.rotation_deg)).tolist() for turn in (np.sin, np.cos))
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return about_z @ about_y @ about_x


def extent(vehicle: Vehicle) -> float:
    """Computes the largest dimension of a vehicle, jets and solids, along an axis, ft or m."""
    return float(np.ptp(_outer_points(vehicle), axis=0).max()) or 1.0


def radius(vehicle: Vehicle) -> float:
    """Computes the distance from the nominal center of mass of the farthest point of a vehicle, ft or m."""
    return float(np.linalg.norm(_outer_points(vehicle) - vehicle.nominal.center_of_mass, axis=1).max()) or 1.0


def nozzle_length(vehicle: Vehicle) -> float:
    """Returns the length and width of a drawn nozzle, ft or m."""
    return _NOZZLE * extent(vehicle)


def plume_lengths(vehicle: Vehicle, thrust: Array) -> Array:
    """Returns drawn lengths of plumes, ft or m, by the square root of thrust, which shows small ones.

    Args:
        vehicle: for its size and its strongest jet.
        thrust: of any shape, lbf or N, above zero.
    """
    strongest = max(jet.thrust for jet in vehicle.jets)
    return np.asarray((0.05 + 0.11 * np.sqrt(thrust / strongest)) * extent(vehicle))


def plume_scales(vehicle: Vehicle, levels: Array) -> Array:
    """Returns drawn plume lengths over those of full thrust; levels: thrust over full thrust, (..., n_jets) each."""
    full = np.array([jet.thrust for jet in vehicle.jets])
    return plume_lengths(vehicle, np.maximum(levels, 0.0) * full) / plume_lengths(vehicle, full)


def round_length(length: float) -> float:
    """Rounds a length down to one significant digit."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(f"{power * np.floor(length / power * (1.0 + 1e-9)):.0e}")


def mark_radius(vehicle: Vehicle, kind: str) -> float:
    """Returns the radius of the ball that marks a jet as "failed" or "found", ft or m."""
    return _MARKS[kind] * extent(vehicle)


def center_radius(vehicle: Vehicle) -> float:
    """Returns the radius of the ball that marks the center of mass, ft or m."""
    return 0.012 * extent(vehicle)


def spread_limits(vehicle: Vehicle) -> tuple[float, float]:
    """Returns the least and the largest drawn half axis of the 3-sigma ellipsoid, ft or m."""
    return 0.002 * extent(vehicle), 0.35 * extent(vehicle)


def payload_radius(vehicle: Vehicle, mass: float) -> float:
    """Returns the radius of a payload's ball, ft or m, by the root of its mass over the vehicle's."""
    share = mass / vehicle.nominal.mass
    return 0.1 * extent(vehicle) * float(min(max(share, 0.02), 2.0) ** (1.0 / 3.0))


def triangles(solid: Solid) -> Array:
    """Computes a solid's surface triangles in the vehicle frame, ft or m, counterclockwise, shape (n, 3, 3)."""
    match solid:
        case BoxSolid():
            x, y, z = 0.5 * np.array(solid.size)
            vertices, faces = plate(np.array([(-x, -y), (x, -y), (x, y), (-x, y)]), 2.0 * float(z))
        case PlateSolid():
            vertices, faces = plate(np.array(solid.outline), solid.thickness)
        case CylinderSolid():
            vertices, faces = cylinder(solid.length, solid.radii)
        case ConeSolid():
            vertices, faces = _cone(solid.length, solid.radii, _AROUND)
        case EllipsoidSolid():
            vertices, faces = _ball()
            vertices = vertices * np.array(solid.radii)
    return np.asarray(vertices[faces] @ rotation(solid).T + np.array(solid.position))


def nozzle(vehicle: Vehicle, jet: int) -> Array:
    """Computes a nozzle's surface triangles in the vehicle frame, open towards its plume, shape (n, 3, 3)."""
    length = nozzle_length(vehicle)
    vertices, faces = _cone(length, (0.5 * length, 0.5 * length), _NOZZLE_CORNERS)
    outwards = -vehicle.thrusts[jet] / np.linalg.norm(vehicle.thrusts[jet])
    side = np.cross(outwards, np.eye(3)[np.abs(outwards).argmin()])
    side /= np.linalg.norm(side)
    axes = np.stack([-outwards, side, np.cross(-outwards, side)])  # the point of the cone is in the jet
    return np.asarray((vertices - [0.5 * length, 0.0, 0.0])[faces] @ axes + vehicle.positions[jet])


def plate(outline: Array, thickness: float) -> tuple[Array, NDArray[np.int_]]:
    """Returns vertices of a flat plate normal to z, shape (n, 3), and its triangles' vertex indices, shape (k, 3).

    Args:
        outline: corners of the plate in order, x and y, shape (m, 2); convex.
        thickness: along z.
    """
    x, y = outline.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0.0:  # twice the area: clockwise
        outline = outline[::-1]
    count = outline.shape[0]
    vertices = np.vstack([np.column_stack([outline, np.full(count, side)]) for side in (-0.5, 0.5)])
    vertices[:, 2] *= thickness
    fan = [(0, corner, corner + 1) for corner in range(1, count - 1)]
    faces = [face[::-1] for face in fan] + [tuple(count + corner for corner in face) for face in fan]
    for corner, following in pairwise([*range(count), 0]):
        faces += [(corner, following, count + following), (corner, count + following, count + corner)]
    return vertices, np.array(faces)


def cylinder(length: float, radii: tuple[float, float]) -> tuple[Array, NDArray[np.int_]]:
    """Returns vertices of a cylinder along x, shape (n, 3), and its triangles' vertex indices, shape (k, 3).

    Args:
        length: along x.
        radii: half axes along y and z.
    """
    vertices, faces = plate(_circle(_AROUND) * radii, length)
    return vertices[:, [2, 0, 1]], faces


def _circle(count: int) -> Array:
    """Returns evenly spaced points of the unit circle, shape (count, 2)."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _cone(length: float, radii: tuple[float, float], count: int) -> tuple[Array, NDArray[np.int_]]:
    """Returns vertices, shape (n, 3), and triangles' indices of a cone toward +x, the origin at half its length."""
    base = np.column_stack([np.full(count, -0.5 * length), _circle(count) * radii])
    vertices = np.vstack([base, [[0.5 * length, 0.0, 0.0], [-0.5 * length, 0.0, 0.0]]])
    faces = []
    for corner, following in pairwise([*range(count), 0]):
        faces += [(corner, following, count), (following, corner, count + 1)]
    return vertices, np.array(faces)


def _ball() -> tuple[Array, NDArray[np.int_]]:
    """Returns vertices, shape (n, 3), and triangles' vertex indices, shape (k, 3), of a sphere of radius 1."""
    around, rings = _AROUND // 2, _AROUND // 4
    height = np.linspace(0.0, np.pi, rings + 1)
    circle = _circle(around)
    vertices = np.vstack(
        [np.column_stack([np.sin(one) * circle, np.full(around, np.cos(one))]) for one in height.tolist()]
    )
    faces = []
    for ring in range(rings):
        for corner, following in pairwise([*range(around), 0]):
            above, below = ring * around, (ring + 1) * around
            if ring < rings - 1:
                faces.append((above + corner, below + corner, below + following))
            if ring > 0:
                faces.append((above + corner, below + following, above + following))
    return vertices, np.array(faces)


def _outer_points(vehicle: Vehicle) -> Array:
    """Returns points that bound a vehicle: jets, and corners of solids or of their boxes, ft or m, shape (n, 3)."""
    solids = [_solid_corners(solid) @ rotation(solid).T + np.array(solid.position) for solid in vehicle.shape]
    return np.vstack([vehicle.positions, *solids])


def _solid_corners(solid: Solid) -> Array:
    """Returns corners of a solid, or of its bounding box, in its own axes, ft or m, shape (n, 3)."""
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


def _box(vehicle: Vehicle) -> BoxSolid:
    """Returns a box solid that spans the jets of a vehicle without solids."""
    low, high = vehicle.positions.min(axis=0), vehicle.positions.max(axis=0)
    size = np.maximum(0.9 * (high - low), 0.15 * float((high - low).max() or 1.0))
    middle = 0.5 * (low + high)
    return BoxSolid(kind="box", size=tuple(size.tolist()), position=tuple(middle.tolist()))
