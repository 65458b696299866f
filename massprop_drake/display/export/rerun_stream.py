"""Export of a run as a recording of Rerun, into an .rrd file or to a viewer that follows it."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from massprop_drake.display.export.content import (
    PARENTS,
    VEHICLE,
    WORLD,
    Arrows,
    Balls,
    Content,
    Outline,
    SampleBlock,
    Series,
)
from massprop_drake.display.solids import round_length
from massprop_drake.errors import InputError

Array = NDArray[np.float64]

PORT = 9876  # where viewers listen
_HOST = "127.0.0.1"
_WAIT_S = 2.0  # for a viewer to answer
_FLUSH_S = 20.0  # for it to take what it is sent
_APPLICATION = "massprop_drake"
_TIMELINE = "run_time"
_EVENTS = "events"
_LEVELS = {"info": rr.TextLogLevel.INFO, "warning": rr.TextLogLevel.WARN, "error": rr.TextLogLevel.ERROR}
_PLOTS = {
    "inverse inertia": ("estimate/I*", "truth/I*"),
    "center of mass": ("estimate/*_cm", "truth/*_cm"),
    "mass reciprocal": ("estimate/m_inv", "truth/m_inv"),
    "rate": ("rate", "rate_estimate"),
    "NIS": ("rotation_nis", "mass_nis"),
    "commands": ("command",),
    "likelihood": ("likelihood",),
}


class RerunStream:
    """Logs a run into a recording.

    Args:
        outline: of the run.
        recording: with a file or a viewer.
    """

    def __init__(self, outline: Outline, recording: rr.RecordingStream):
        self._outline, self._recording = outline, recording

    def begin(self) -> None:
        """Logs the constant content: the vehicle's surface, the frames of its jets, and names of curves."""
        outline, put = self._outline, partial(self._recording.log, static=True)
        self._recording.send_recording_name(outline.title)
        put(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_DOWN)
        put(_frame_path(VEHICLE), rr.TransformAxes3D(axis_length=round_length(0.45 * outline.extent)))
        for number, mesh in enumerate(outline.body):
            put(f"{_frame_path(VEHICLE)}/shape/{number}", _make_mesh(mesh.triangles, mesh.color))
        for name, (position, rotation) in outline.jets.items():
            frame = rr.Transform3D(translation=position, quaternion=rr.Quaternion(xyzw=rotation[[1, 2, 3, 0]]))
            put(f"{_frame_path(VEHICLE)}/jets/{rr.escape_entity_path_part(name)}", frame)
        for name in ("marks", "centers", "payloads"):
            put(
                f"{_frame_path(VEHICLE)}/{name}", rr.Ellipsoids3D.from_fields(fill_mode="transparentfillmajorwireframe")
            )
        for series in outline.series.values():
            curve_names = _curve_names(series)
            for path, columns in _curves(series):
                put(path, rr.SeriesLines(names=curve_names[columns]))
        notes = "\n".join(f"- {note}" for note in outline.notes)
        put("about", rr.TextDocument(f"# {outline.title}\n\n{notes}\n", media_type=rr.MediaType.MARKDOWN))

    def put(self, block: SampleBlock) -> None:
        """Logs a block's samples and messages."""
        for name, values in block.signals.items():
            series = self._outline.series[name]
            for path, columns in _curves(series):
                numbers = np.ascontiguousarray(values[:, columns])
                batch = rr.Scalars.columns(scalars=numbers.ravel())
                self._send_columns(path, block.time_ns, batch.partition([numbers.shape[1]] * len(numbers)))
        for name, (positions, rotations) in block.frames.items():
            known = np.isfinite(positions).all(axis=1) & np.isfinite(rotations).all(axis=1)
            frames = rr.Transform3D.columns(translation=positions[known], quaternion=rotations[known][:, [1, 2, 3, 0]])
            self._send_columns(_frame_path(name), block.time_ns[known], frames)
        for name, changes in block.scene.items():
            times = block.time_ns[[row for row, _ in changes]]
            self._send_columns(f"{_frame_path(VEHICLE)}/{name}", times, _draw_parts([part for _, part in changes]))
        if block.messages:
            times = np.array([time_ns for time_ns, _ in block.messages])
            said = [message for _, message in block.messages]
            texts = rr.TextLog.columns(
                text=[f"{one.source}: {one.text}" for one in said], level=[_LEVELS[one.level] for one in said]
            )
            self._send_columns(_EVENTS, times, texts)

    def _send_columns(self, path: str, time_ns: NDArray[np.int64], columns: Iterable[Any]) -> None:
        """Sends columns of components at their times, those of the calendar if the run has an epoch."""
        if not time_ns.size:
            return
        if self._outline.has_epoch:
            times = rr.TimeColumn(_TIMELINE, timestamp=time_ns.astype("datetime64[ns]"))
        else:
            times = rr.TimeColumn(_TIMELINE, duration=time_ns.astype("timedelta64[ns]"))
        self._recording.send_columns(path, indexes=[times], columns=columns, strict=True)


def write(content: Content, path: Path) -> None:
    """Writes a run into an .rrd file."""
    recording = rr.RecordingStream(_APPLICATION)
    recording.save(path, default_blueprint=_blueprint(content.outline))
    with recording:
        stream = RerunStream(content.outline, recording)
        stream.begin()
        for block in content.stretches():
            stream.put(block)
    recording.disconnect()


class RerunViewer:
    """Sends a run to a viewer that is open on this machine.

    Attributes:
        address: of the viewer.
        is_served: the viewer was there before us.

    Args:
        outline: of the run.
        port: at which the viewer listens.

    Raises:
        InputError: when no viewer is there, also later.
    """

    is_served = False

    def __init__(self, outline: Outline, port: int):
        self.address = f"rerun+http://{_HOST}:{port}/proxy"
        try:
            socket.create_connection((_HOST, port), _WAIT_S).close()
        except OSError:
            raise InputError(
                f"--port {port}: no viewer of Rerun listens there on this machine; start one first: rerun --port {port}"
            ) from None
        self._recording = rr.RecordingStream(_APPLICATION)
        self._recording.connect_grpc(self.address, default_blueprint=_blueprint(outline))
        self._stream = RerunStream(outline, self._recording)

    def wait(self, seconds: float) -> bool:
        """Returns True: a viewer was connected at construction."""
        return True

    def begin(self) -> None:
        """Sends the constant content."""
        self._stream.begin()

    def put(self, block: SampleBlock) -> None:
        """Sends a block's samples and messages at once."""
        self._stream.put(block)
        self._flush()

    def close(self) -> None:
        """Ends the connection; the viewer keeps what it has."""
        self._flush()
        self._recording.disconnect()

    def _flush(self) -> None:
        """Sends buffered data; raises InputError where no viewer receives it."""
        try:
            self._recording.flush(timeout_sec=_FLUSH_S)
        except RuntimeError:
            raise InputError(
                f"{self.address}: takes no run: no viewer of Rerun is there, or it has been closed; start one: rerun"
            ) from None


connected = RerunViewer


def _curves(series: Series) -> list[tuple[str, slice]]:
    """Returns entity paths of a signal's curves, each with its columns; one path if all columns share a unit."""
    path = f"signals/{rr.escape_entity_path_part(series.name)}"
    if not series.is_mixed:
        return [(path, slice(None))]
    return [
        (f"{path}/{rr.escape_entity_path_part(component)}", slice(column, column + 1))
        for column, component in enumerate(series.components)
    ]


def _curve_names(series: Series) -> list[str]:
    """Returns the name of each of a signal's curves, with its unit."""
    alone = len(series.components) == 1
    return [
        (series.name if alone else f"{series.name} {component}") + ("" if unit == "-" else f", {unit}")
        for component, unit in zip(series.components, series.units, strict=True)
    ]


def _frame_path(frame: str) -> str:
    """Returns the entity path of a frame: below that of its parent."""
    return frame if frame == WORLD else f"{_frame_path(PARENTS[frame])}/{frame}"


def _make_mesh(triangles: Array, color: tuple[int, int, int, int]) -> rr.Mesh3D:
    """Makes a mesh of triangles, shape (n, 3, 3), with normals at the corners, so that a viewer shades them."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rr.Mesh3D(
        vertex_positions=triangles.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=color
    )


def _draw_parts(elements: Sequence[Arrows | Balls]) -> Any:
    """Converts arrows or balls to Rerun's columns, one set per row."""
    lengths = [len(element.colors) for element in elements]
    colors = [color for element in elements for color in element.colors]
    first, second = (np.vstack([element[index] for element in elements] or [np.empty((0, 3))]) for index in (0, 1))
    if elements and isinstance(elements[0], Arrows):
        return rr.Arrows3D.columns(origins=first, vectors=second, colors=colors).partition(lengths)
    return rr.Ellipsoids3D.columns(centers=first, half_sizes=second, colors=colors).partition(lengths)


def _blueprint(outline: Outline) -> rrb.Blueprint:
    """Makes the layout that a viewer opens with: the scene, plots of the main signals, and messages."""
    paths = {
        path.removeprefix("signals/"): f"/{path}" for series in outline.series.values() for path, _ in _curves(series)
    }
    plots = []
    for title, patterns in _PLOTS.items():
        found = [path for pattern in patterns for name, path in paths.items() if Path(name).match(pattern)]
        if found:
            plots.append(rrb.TimeSeriesView(origin="/signals", contents=found, name=title))
    scene = rrb.Spatial3DView(origin=f"/{WORLD}", name="vehicle")
    log = rrb.TextLogView(origin=f"/{_EVENTS}", name="events")
    half = (len(plots) + 1) // 2
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, log, row_shares=[3, 1]),
            rrb.Vertical(rrb.Tabs(*plots[:half]), rrb.Tabs(*plots[half:])),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(timeline=_TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
