"""A run in three dimensions: one offline HTML file with body, jets, plumes and both centres of mass.

Drawn by Drake's Meshcat. The camera goes with the vehicle: its centre of mass stays in the middle, the
inertial axes keep their direction.
"""

from __future__ import annotations

import json
import logging
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, Cylinder, Ellipsoid, Meshcat, MeshcatCone, MeshcatParams, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from massprop_drake import settings as make
from massprop_drake.files import write_whole
from massprop_drake.maths.attitude import propagated
from massprop_drake.report import events
from massprop_drake.run import Run
from massprop_drake.signals import (
    ESTIMATE_COLOUR,
    FAILED_COLOUR,
    PLUME_COLOUR,
    SUSPECT_COLOUR,
    TRUTH_COLOUR,
)
from massprop_drake.vehicle import (
    BoxSolid,
    ConeSolid,
    CylinderSolid,
    EllipsoidSolid,
    PlateSolid,
    Solid,
    Vehicle,
)

Array = NDArray[np.float64]

_FRAMES = 3000  # of the body's motion at the most
_SHOWN = 0.02  # of the full thrust; below it there is no plume
_OPACITY = 0.6  # of the body: the centres of mass lie inside
_EXTENT = 4.0  # of the vehicle in Meshcat's lengths, which its lights are made for
_BODY = "/world/body"
_STRUCTURE = f"{_BODY}/structure"  # the vehicle frame


def write_replay(run: Run, path: str | Path) -> Path:
    """Writes the replay of a run.

    Without the truth, the attitude is integrated from the gyro and the thrust taken from the commands.

    Args:
        run: simulated or from telemetry.
        path: of the HTML file; it appears whole or not at all.
    """
    target = Path(path)
    write_whole(target, replay_html(run))
    return target


def replay_html(run: Run) -> str:
    """The replay as one HTML text that needs no network."""
    scene = _Scene(run)
    page = scene.record()
    controls = (Path(__file__).parent / "replay_controls.html").read_text(encoding="utf-8")
    data = json.dumps(scene.narration()).replace("<", "\\u003c")
    name = json.dumps(run.scenario.vehicle_data.name).replace("<", "\\u003c")
    controls = controls.replace("/*NARRATION*/", data).replace("/*NAME*/", name)
    return page.replace("</body>", f"{controls}\n</body>")


class _Scene:
    """Puts a run's vehicle into Meshcat and records its motion."""

    def __init__(self, run: Run):
        self._run = run
        self._vehicle = run.scenario.vehicle_data
        self._time_s = np.asarray(run.time_s) - float(run.time_s[0])
        stride = max(1, -(-self._time_s.size // _FRAMES))
        self._rows = np.arange(0, self._time_s.size, stride)
        period = self._vehicle.sample_period_s
        self._extent = _extent(self._vehicle)
        self._rate_hz = 1.0 / (stride * period)
        # the time of a row in the recording: gaps in telemetry are played as one sample
        self._at = np.arange(self._time_s.size) * period

        self._meshcat = _quiet_meshcat()

    def record(self) -> str:
        meshcat = self._meshcat
        scale = _EXTENT / self._extent
        upright = np.diag([scale, -scale, -scale, 1.0])  # z of the body axes points down
        meshcat.SetTransform("/world", upright)
        for path in ("/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)
        meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
        meshcat.SetProperty("/Background/<object>", "bottom_color", [0.75, 0.79, 0.85])
        meshcat.StartRecording(self._rate_hz, False)
        self._draw_body()
        self._draw_axes()
        self._move_body()
        self._draw_jets()
        self._draw_marks()
        self._draw_centers()
        meshcat.StopRecording()
        meshcat.PublishRecording()
        meshcat.SetCameraPose([0.46 * _EXTENT, -0.64 * _EXTENT, 0.36 * _EXTENT], [0.0, 0.0, 0.0])
        return str(meshcat.StaticHtml())

    # --------------------------------------------------------------------------------------- parts

    def _draw_body(self) -> None:
        for number, solid in enumerate(self._vehicle.shape or _box(self._vehicle)):
            _draw_solid(self._meshcat, f"{_STRUCTURE}/shape/{number}", solid)

    def _draw_axes(self) -> None:
        length, radius = 0.62 * self._extent, 0.003 * self._extent
        for axis, colour in enumerate(((0.8, 0.2, 0.2), (0.2, 0.6, 0.2), (0.2, 0.3, 0.8))):
            direction = np.eye(3)[axis]
            path = f"{_BODY}/axes/{'xyz'[axis]}"
            self._meshcat.SetObject(path, Cylinder(radius, length), Rgba(*colour, 0.8))
            self._meshcat.SetTransform(path, RigidTransform(_along(direction), 0.5 * length * direction))

    def _move_body(self) -> None:
        for row, attitude in zip(self._rows, _attitudes(self._run)[self._rows], strict=True):
            turned = RotationMatrix(Quaternion(attitude / np.linalg.norm(attitude)))
            self._meshcat.SetTransform(_BODY, RigidTransform(turned, np.zeros(3)), float(self._at[row]))
        center = self._center()
        for row in _changes(center):
            self._meshcat.SetTransform(_STRUCTURE, RigidTransform(-center[row]), float(self._at[row]))

    def _draw_jets(self) -> None:
        vehicle, extent = self._vehicle, self._extent
        level = self._levels()
        strongest = max(jet.thrust for jet in vehicle.jets)
        for index, jet in enumerate(vehicle.jets):
            path = f"{_STRUCTURE}/jets/{index}"
            outwards = -vehicle.thrusts[index] / jet.thrust
            self._meshcat.SetTransform(path, RigidTransform(_along(outwards), vehicle.positions[index]))
            nozzle = 0.016 * extent
            self._meshcat.SetObject(
                f"{path}/nozzle", MeshcatCone(nozzle, 0.5 * nozzle, 0.5 * nozzle), Rgba(0.25, 0.28, 0.33, 1.0)
            )
            length = (0.05 + 0.11 * (jet.thrust / strongest) ** 0.5) * extent
            plume = f"{path}/plume"
            self._meshcat.SetObject(plume, MeshcatCone(length, 0.2 * length, 0.2 * length), _rgba(PLUME_COLOUR, 0.75))
            self._switch(plume, level[:, index] > _SHOWN)

    def _draw_marks(self) -> None:
        radius = 0.022 * self._extent
        for kind, marks, colour, size in (
            ("failed", events.failures(self._run), FAILED_COLOUR, 1.0),
            ("found", events.found(self._run), SUSPECT_COLOUR, 1.5),
        ):
            for number, mark in enumerate(marks):
                shown = (self._time_s >= mark.start_s - 1e-9) & (self._time_s <= mark.end_s)
                for jet in mark.jets:
                    path = f"{_STRUCTURE}/marks/{kind}{number}_{jet}"
                    self._meshcat.SetObject(path, Sphere(size * radius), _rgba(colour, 0.55))
                    self._meshcat.SetTransform(path, RigidTransform(self._vehicle.positions[jet]))
                    self._switch(path, shown)

    def _draw_centers(self) -> None:
        radius, limit = 0.012 * self._extent, 0.35 * self._extent
        if "truth" in self._run.signals:
            self._meshcat.SetObject(f"{_BODY}/center", Sphere(radius), _rgba(TRUTH_COLOUR, 0.45))
        path = f"{_STRUCTURE}/estimate"
        self._meshcat.SetObject(f"{path}/point", Sphere(0.7 * radius), _rgba(ESTIMATE_COLOUR, 1.0))
        self._meshcat.SetObject(f"{path}/spread", Sphere(1.0), _rgba(ESTIMATE_COLOUR, 0.22))
        estimate = np.nan_to_num(np.asarray(self._run["estimate"])[:, 6:9])
        spread = 3.0 * np.asarray(self._run["standard_deviation"])[:, 6:9]
        spread = np.clip(spread, 0.2 * radius, limit)
        for row in self._sparse(_changes(estimate)):
            self._meshcat.SetTransform(path, RigidTransform(estimate[row]), float(self._at[row]))
        for row in self._sparse(_changes(spread)):
            self._meshcat.SetProperty(f"{path}/spread", "scale", spread[row].tolist(), float(self._at[row]))

    # ------------------------------------------------------------------------------------- helpers

    def _switch(self, path: str, shown: NDArray[np.bool_]) -> None:
        """Shows an object while a condition holds."""
        self._meshcat.SetProperty(path, "visible", bool(shown[0]), 0.0)
        for row in np.flatnonzero(np.diff(shown)) + 1:
            self._meshcat.SetProperty(path, "visible", bool(shown[row]), float(self._at[row]))

    def _sparse(self, rows: Array) -> Array:
        """At most so many rows as the body's motion has."""
        return rows[:: max(1, rows.size // _FRAMES + 1)]

    def _center(self) -> Array:
        """What the camera follows: the true centre of mass or, without it, the nominal one, shape (n, 3)."""
        if "truth" in self._run.signals:
            return np.asarray(self._run["truth"])[:, 6:9]
        return np.tile(self._vehicle.nominal.center_of_mass, (self._time_s.size, 1))

    def _levels(self) -> Array:
        """True thrust over full thrust or, without the truth, the command, shape (n, n_jets)."""
        if "thrust" in self._run.signals:
            return np.asarray(self._run["thrust"]) / np.linalg.norm(self._vehicle.thrusts, axis=1)
        return np.nan_to_num(np.asarray(self._run["command"]))

    def narration(self) -> dict[str, object]:
        """What the page says at each moment: beginnings of intervals with their texts."""
        scenario, start_s = self._run.scenario, float(self._run.time_s[0])
        failed, found = events.failures(self._run), events.found(self._run)
        edges = {0.0}
        for window in scenario.maneuver:
            edges |= {window.start_s, window.end_s}
        for mark in (*failed, *found):
            edges |= {mark.start_s, mark.end_s}
        moments = []
        for edge in sorted(edges):
            now = [mark.text for mark in failed if mark.start_s <= edge < mark.end_s]
            known = [mark.text for mark in found if mark.start_s <= edge < mark.end_s]
            moments.append(
                {"at": edge - start_s, "command": events.commanded(scenario, edge), "failed": now, "found": known}
            )
        return {
            "scenario": scenario.name,
            "start_s": start_s,
            "moments": moments,
            "truth": "truth" in self._run.signals,
            "colours": {
                "failed": FAILED_COLOUR,
                "found": SUSPECT_COLOUR,
                "estimate": ESTIMATE_COLOUR,
                "truth": TRUTH_COLOUR,
                "plume": PLUME_COLOUR,
            },
        }


def _quiet_meshcat() -> Meshcat:
    """A Meshcat on localhost that does not announce itself."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost"))
    finally:
        log.setLevel(level)


def _attitudes(run: Run) -> Array:
    """q_NB at every sample: the truth, or integrated from the gyro in use, shape (n, 4)."""
    if "attitude" in run.signals:
        return np.asarray(run["attitude"])
    rate = np.nan_to_num(np.asarray(run[make.gyro(run.scenario).name]))
    attitudes = np.empty((rate.shape[0], 4))
    attitudes[0] = (1.0, 0.0, 0.0, 0.0)
    for row, (before, after) in enumerate(pairwise(rate)):
        mean = 0.5 * (before + after)
        attitudes[row + 1] = propagated(attitudes[row], mean, run.scenario.vehicle_data.sample_period_s)
    return attitudes


def _changes(values: Array) -> Array:
    """Rows that differ from the one before, and the first, shape (k,)."""
    return np.concatenate([[0], np.flatnonzero(np.any(np.diff(values, axis=0) != 0.0, axis=1)) + 1])


def _extent(vehicle: Vehicle) -> float:
    """Largest distance between jets along an axis, or of the solids, ft or m."""
    corners = [vehicle.positions.min(axis=0), vehicle.positions.max(axis=0)]
    for solid in vehicle.shape:
        reach = _reach(solid)
        corners += [np.array(solid.position) - reach, np.array(solid.position) + reach]
    return float(np.ptp(np.array(corners), axis=0).max()) or 1.0


def _reach(solid: Solid) -> float:
    """From a solid's center to its farthest point, about, ft or m."""
    match solid:
        case BoxSolid():
            return 0.5 * max(solid.size)
        case EllipsoidSolid():
            return max(solid.radii)
        case CylinderSolid() | ConeSolid():
            return max(0.5 * solid.length, *solid.radii)
        case PlateSolid():
            return 0.5 * max(np.ptp(np.array(solid.outline), axis=0).tolist())


def _box(vehicle: Vehicle) -> tuple[Solid, ...]:
    """A box between the jets, for a vehicle without a shape."""
    low, high = vehicle.positions.min(axis=0), vehicle.positions.max(axis=0)
    size = np.maximum(0.9 * (high - low), 0.15 * float((high - low).max() or 1.0))
    middle = 0.5 * (low + high)
    return (BoxSolid(kind="box", size=tuple(size.tolist()), position=tuple(middle.tolist())),)


def _draw_solid(meshcat: Meshcat, path: str, solid: Solid) -> None:
    place = RigidTransform(RollPitchYaw(np.radians(solid.rotation_deg)), np.array(solid.position))
    colour = _rgba(solid.colour, _OPACITY)
    match solid:
        case BoxSolid():
            meshcat.SetObject(path, Box(*solid.size), colour)
        case EllipsoidSolid():
            meshcat.SetObject(path, Ellipsoid(*solid.radii), colour)
        case CylinderSolid():
            vertices, faces = _cylinder(solid.length, solid.radii)
            meshcat.SetTriangleMesh(path, vertices, faces, colour)
        case ConeSolid():
            # Meshcat's cone stands on its point: turned so that the point looks along +x
            meshcat.SetObject(f"{path}/cone", MeshcatCone(solid.length, solid.radii[1], solid.radii[0]), colour)
            point = np.array([0.5 * solid.length, 0.0, 0.0])
            meshcat.SetTransform(f"{path}/cone", RigidTransform(_along(np.array([-1.0, 0.0, 0.0])), point))
        case PlateSolid():
            vertices, faces = _plate(np.array(solid.outline), solid.thickness)
            meshcat.SetTriangleMesh(path, vertices, faces, colour)
    meshcat.SetTransform(path, place)


def _plate(outline: Array, thickness: float) -> tuple[Array, NDArray[np.int_]]:
    """Vertices (3, n) and triangles (3, k) of a plate, both sides of each face."""
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
    """Vertices and triangles of a cylinder along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    outline = np.column_stack([radii[0] * np.cos(angle), radii[1] * np.sin(angle)])
    vertices, faces = _plate(outline, length)
    return vertices[[2, 0, 1]], faces


def _along(direction: Array) -> RotationMatrix:
    """A rotation that takes z to a direction."""
    return RotationMatrix.MakeFromOneVector(direction, 2)


def _rgba(colour: str, opacity: float) -> Rgba:
    red, green, blue = (int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    return Rgba(red, green, blue, opacity)
