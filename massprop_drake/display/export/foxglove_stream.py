"""Export of a run as channels of Foxglove's SDK, into an MCAP file or to a viewer that follows it.

Signals are messages of package `massprop` with a `double` for each component; frames, scene and messages have
Foxglove's own schemas, which its 3-D and log panels know (docs.foxglove.dev/docs/sdk/schemas).
"""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove import channels
from foxglove.messages import (
    ArrowPrimitive,
    FrameTransform,
    FrameTransforms,
    Log,
    LogLevel,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)
from foxglove.messages import Color as Paint
from foxglove.websocket import Capability, ServerListener
from numpy.typing import NDArray

from massprop_drake.display.export import protobuf
from massprop_drake.display.export.content import (
    PARENTS,
    VEHICLE,
    Arrows,
    Balls,
    Color,
    Content,
    LogEntry,
    Outline,
    SampleBlock,
    Series,
)
from massprop_drake.errors import InputError

Array = NDArray[np.float64]

_LEVELS = {"info": LogLevel.Info, "warning": LogLevel.Warning, "error": LogLevel.Error}
_HEAD, _SHAFT, _TIP = 0.35, 0.08, 0.2  # length of an arrow's head, widths of shaft and head, over its length
_BACKLOG = 1 << 16  # messages that wait for a viewer that is slower
_SETTLES_S = 0.2  # after which a viewer on this machine has asked for, or taken, what it wants
_HOST = "127.0.0.1"
PORT = 8765  # where viewers look first


class FoxgloveStream:
    """Logs a run on channels; listeners of the context get it.

    Args:
        outline: of the run.
        context: of the SDK, with a file or a server.
    """

    def __init__(self, outline: Outline, context: foxglove.Context):
        self._outline = outline
        self._signals = {name: _make_signal_channel(series, context) for name, series in outline.series.items()}
        self._frames = channels.FrameTransformsChannel("/run/frames", context=context)
        self._jets = channels.FrameTransformsChannel("/run/jets", context=context)
        self._events = channels.LogChannel("/run/events", context=context)
        self._scene = {
            name: channels.SceneUpdateChannel(f"/run/{name}", context=context)
            for name in ("vehicle", "plumes", "marks", "centers", "payloads")
        }

    def begin(self, time_ns: int) -> None:
        """Logs the constant content: the vehicle's surface and the frames of its jets."""
        timestamp = _timestamp(time_ns)
        surfaces = [
            TriangleListPrimitive(
                points=[Point3(x=x, y=y, z=z) for x, y, z in mesh.triangles.reshape(-1, 3).tolist()],
                color=_paint(mesh.color),
            )
            for mesh in self._outline.body
        ]
        self._log_scene(
            "vehicle", time_ns, SceneEntity(**_vehicle_entity_fields(timestamp, "vehicle"), triangles=surfaces)
        )
        jets = [
            _make_transform(timestamp, VEHICLE, f"jet_{name}", place, quaternion)
            for name, (place, quaternion) in self._outline.jets.items()
        ]
        self._jets.log(FrameTransforms(transforms=jets), log_time=time_ns)

    def put(self, block: SampleBlock) -> None:
        """Logs a block's samples and messages in the order of time."""
        encoded = {name: protobuf.encode_rows(values) for name, values in block.signals.items()}
        changes: dict[int, list[tuple[str, Arrows | Balls]]] = {}
        for name, changed in block.scene.items():
            for row, part in changed:
                changes.setdefault(row, []).append((name, part))
        waiting = list(block.messages)
        for row, time_ns in enumerate(block.time_ns.tolist()):
            while waiting and waiting[0][0] < time_ns:
                self._log_event(*waiting.pop(0))
            for name, messages in encoded.items():
                self._signals[name].log(messages[row], log_time=time_ns)
            self._log_frames(block, row, time_ns)
            for name, part in changes.get(row, ()):
                self._log_scene(name, time_ns, _make_entity(name, part, _timestamp(time_ns)))
        for message in waiting:
            self._log_event(*message)

    def _log_frames(self, block: SampleBlock, row: int, time_ns: int) -> None:
        """Logs the poses of the frames that are known at a row of the block."""
        timestamp = _timestamp(time_ns)
        known = [
            _make_transform(timestamp, PARENTS[name], name, positions[row], quaternions[row])
            for name, (positions, quaternions) in block.frames.items()
            if np.isfinite(positions[row]).all() and np.isfinite(quaternions[row]).all()
        ]
        if known:
            self._frames.log(FrameTransforms(transforms=known), log_time=time_ns)

    def _log_scene(self, name: str, time_ns: int, entity: SceneEntity) -> None:
        """Logs an entity of the scene on its channel."""
        self._scene[name].log(SceneUpdate(entities=[entity]), log_time=time_ns)

    def _log_event(self, time_ns: int, message: LogEntry) -> None:
        """Logs a message with its severity and source on the channel of events."""
        log = Log(
            timestamp=_timestamp(time_ns), level=_LEVELS[message.level], message=message.text, name=message.source
        )
        self._events.log(log, log_time=time_ns)


def write(content: Content, path: Path) -> None:
    """Writes a run into a new MCAP file."""
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context) as file:
        outline = content.outline
        notes = {f"note_{number}": note for number, note in enumerate(outline.notes, start=1)}
        file.write_metadata("massprop", {"run": outline.title, "length_unit": outline.length_unit, **notes})
        stream = FoxgloveStream(outline, context)
        stream.begin(outline.start_ns)
        for block in content.stretches():
            stream.put(block)


class _Audience(ServerListener):
    """Listener that notes that a viewer has asked for something."""

    def __init__(self) -> None:
        self.came = threading.Event()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Notes that a viewer has subscribed, in the server's thread."""
        self.came.set()


class FoxgloveServer:
    """Serves a run to Foxglove on this machine.

    Attributes:
        address: for the viewer's connection.
        is_served: the viewer connects to us, when it likes.

    Args:
        outline: of the run.
        port: to listen at; 0: any that is free.

    Raises:
        InputError: when the port is taken.
    """

    is_served = True

    def __init__(self, outline: Outline, port: int):
        self._context = foxglove.Context()  # channels do not keep it alive
        self._audience = _Audience()
        try:
            self._server = foxglove.start_server(
                name=outline.title,
                host=_HOST,
                port=port,
                capabilities=[Capability.Time],
                server_listener=self._audience,
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            raise InputError(f"--port {port}: cannot be listened at: {error}; give another one") from None
        self.address = f"ws://{_HOST}:{self._server.port}"
        self._stream = FoxgloveStream(outline, self._context)
        self._now_ns = outline.start_ns

    def wait(self, seconds: float) -> bool:
        """Waits up to some seconds for a viewer; returns True if one has subscribed since the last call."""
        if not self._audience.came.wait(seconds):
            return False
        self._audience.came.clear()
        return True

    def begin(self) -> None:
        """Sends the constant content, once viewers have subscribed to all that they want."""
        while self.wait(_SETTLES_S):
            pass
        self._stream.begin(self._now_ns)

    def put(self, block: SampleBlock) -> None:
        """Sends a block's samples and messages at once."""
        if self.wait(0.0):  # somebody has come later
            self._stream.begin(self._now_ns)
        self._stream.put(block)
        self._now_ns = int(block.time_ns[-1])
        self._server.broadcast_time(self._now_ns)

    def close(self) -> None:
        """Ends the server, once all buffered messages are sent."""
        time.sleep(_SETTLES_S)
        self._server.stop()


connected = FoxgloveServer


def _make_signal_channel(series: Series, context: foxglove.Context) -> foxglove.Channel:
    """Makes a signal's channel, with names and units of its components in the schema."""
    fields = protobuf.identifiers(series.components)
    message = protobuf.identifiers([series.name])[0]
    units = list(series.units)
    return foxglove.Channel(
        f"/{series.name}",
        message_encoding="protobuf",
        schema=foxglove.Schema(
            name=f"{protobuf.PACKAGE}.{message}",
            encoding="protobuf",
            data=protobuf.schema(message, series.label, list(zip(fields, units, strict=True))),
        ),
        metadata={
            "label": series.label,
            "unit": units[0] if not series.is_mixed else "; ".join(units),
            "components": json.dumps(series.components),
        },
        context=context,
    )


def _make_entity(name: str, element: Arrows | Balls, timestamp: Timestamp) -> SceneEntity:
    """Makes a scene entity of spheres or arrows that moves with the vehicle."""
    if isinstance(element, Balls):
        spheres = [
            SpherePrimitive(pose=Pose(position=_vector(center)), size=_vector(2.0 * half), color=_paint(color))
            for center, half, color in zip(*element, strict=True)
        ]
        return SceneEntity(**_vehicle_entity_fields(timestamp, name), spheres=spheres)
    arrows = []
    for origin, vector, color in zip(*element, strict=True):
        length = float(np.linalg.norm(vector))
        arrows.append(
            ArrowPrimitive(
                pose=Pose(position=_vector(origin), orientation=_rotation_from_x(vector / length)),
                shaft_length=(1.0 - _HEAD) * length,
                shaft_diameter=_SHAFT * length,
                head_length=_HEAD * length,
                head_diameter=_TIP * length,
                color=_paint(color),
            )
        )
    return SceneEntity(**_vehicle_entity_fields(timestamp, name), arrows=arrows)


def _vehicle_entity_fields(timestamp: Timestamp, name: str) -> dict[str, Any]:
    """Returns the common fields of a scene entity that moves with the vehicle: time, frame, name."""
    return {"timestamp": timestamp, "frame_id": VEHICLE, "id": name, "frame_locked": True}


def _make_transform(
    timestamp: Timestamp, parent: str, child: str, position: Array, quaternion: Array
) -> FrameTransform:
    """Makes the transform of a child frame in its parent, from a position and a quaternion (w, x, y, z)."""
    return FrameTransform(
        timestamp=timestamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(position),
        rotation=_quaternion(quaternion),
    )


def _timestamp(time_ns: int) -> Timestamp:
    """Converts a time, ns, to seconds and nanoseconds."""
    return Timestamp(*divmod(time_ns, 1_000_000_000))


def _vector(values: Array) -> Vector3:
    """Converts a vector, shape (3,), to Foxglove's."""
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: Array) -> Quaternion:
    """Converts a quaternion (w, x, y, z) to Foxglove's."""
    w, x, y, z = values.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _rotation_from_x(direction: Array) -> Quaternion:
    """Returns the quaternion of a rotation that takes the x axis, along which arrows point, to a unit vector."""
    x, y, z = direction.tolist()
    if x < -1.0 + 1e-12:
        return Quaternion(x=0.0, y=0.0, z=1.0, w=0.0)
    values = np.array([1.0 + x, 0.0, -z, y])  # (1 + x . d, x x d)
    return _quaternion(values / np.linalg.norm(values))


def _paint(color: Color) -> Paint:
    """Converts a color from 0 to 255 to Foxglove's, from 0 to 1."""
    red, green, blue, opacity = (part / 255.0 for part in color)
    return Paint(r=red, g=green, b=blue, a=opacity)
