"""An export is read back by the libraries of those who show it, and is what the run says."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import struct
import sys
import threading
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import InputError, Run, estimate, load_scenario, load_vehicle, simulate
from massprop_drake.display import export, solids
from massprop_drake.display.export import protobuf
from massprop_drake.display.export.content import Content, component_units
from massprop_drake.inputs.vehicle_file import bundled_vehicles
from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.mass_properties import CENTER_OF_MASS
from massprop_drake.results.spool import Spool

pytest.importorskip("foxglove")
pytest.importorskip("rerun")
mcap_reader = pytest.importorskip("mcap.reader")

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def leak(stuck_run: Run) -> Run:
    """The orbiter; a jet leaks, and is named at once."""
    (failure,) = load_scenario("leak_named").failures
    changes = {"failures": (failure.model_copy(update={"start_s": 1.0}),), "duration_s": 2.0}
    return simulate(stuck_run.scenario.model_copy(update=changes))


@pytest.fixture(scope="module")
def followed() -> Run:
    """A vehicle whose position and attitude a pose filter estimates."""
    failure = "failures=[{kind: stuck_off, jet: T2, start_s: 1}]"
    return simulate(load_scenario("air_bearing_pulses", ["duration_s=1.6", failure]))


def _record(run: Run, paths: pytest.TempPathFactory) -> Run:
    path = paths.mktemp("runs") / "telemetry.csv"
    run.write_telemetry(path)
    return estimate(path, run.scenario)


@pytest.fixture(scope="module")
def recorded(followed: Run, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The same from its telemetry alone."""
    return _record(followed, tmp_path_factory)


@pytest.fixture(scope="module")
def blind(stuck_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The orbiter's telemetry, which says nothing of position and attitude."""
    return _record(stuck_run, tmp_path_factory)


@pytest.fixture
def run(request: pytest.FixtureRequest) -> Run:
    found: Run = request.getfixturevalue(request.param)
    return found


EVERY = pytest.mark.parametrize("run", ["leak", "followed", "recorded", "blind"], indirect=True)


class File(NamedTuple):
    """An MCAP file as the library mcap reads it: messages by topic, with times, and schemas and channels."""

    messages: dict[str, list[tuple[int, bytes]]]
    schemas: dict[str, Any]
    channels: dict[str, Any]
    order: list[int]

    @staticmethod
    def read(path: Path) -> File:
        found = File(defaultdict(list), {}, {}, [])
        with path.open("rb") as file:
            for schema, channel, message in mcap_reader.make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            ):
                assert message.publish_time == message.log_time
                found.messages[channel.topic].append((message.log_time, message.data))
                found.schemas[channel.topic], found.channels[channel.topic] = schema, channel
                found.order.append(message.log_time)
        return found

    def values(self, topic: str) -> Array:
        """A signal's values: fields that are doubles, in their order, and nothing else."""
        rows = []
        for _, data in self.messages[topic]:
            row, place = [], 0
            while place < len(data):
                tag, place = _varint(data, place)
                assert tag == (len(row) + 1) << 3 | 1
                row.append(struct.unpack_from("<d", data, place)[0])
                place += 8
            rows.append(row)
        return np.array(rows)


def _varint(data: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[place] & 127) << shift
        place, shift = place + 1, shift + 7
        if data[place - 1] < 128:
            return value, place


def decoded(path: Path, topic: str) -> list[dict[str, Any]]:
    """Messages of a topic as Rerun's own reader of MCAP decodes them by the schema in the file."""
    from rerun.chunk import McapReader  # noqa: PLC0415 (an extra)

    rows: list[dict[str, Any]] = []
    for chunk in McapReader(path, decoders=["protobuf"]).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == topic:
            (name,) = (name for name in batch.schema.names if name.endswith(":message"))
            rows += [row[0] for row in batch.column(name).to_pylist()]
    return rows


def columns(path: Path) -> dict[tuple[str, str], list[tuple[Any, Any]]]:
    """A recording as Rerun reads it: times and values by path and component; static ones have no time."""
    from rerun.chunk import RrdReader  # noqa: PLC0415 (an extra)

    found: dict[tuple[str, str], list[tuple[Any, Any]]] = defaultdict(list)
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        times = [None] * batch.num_rows
        if "run_time" in batch.schema.names:
            times = batch.column("run_time").cast("int64").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                found[chunk.entity_path, name] += zip(times, batch.column(name).to_pylist(), strict=True)
    return found


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Run, str], Path]:
    """Exports a run, each once."""
    known: dict[tuple[int, str], Path] = {}

    def write(run: Run, to: str) -> Path:
        if (id(run), to) not in known:
            known[id(run), to] = run.export(to, tmp_path_factory.mktemp("exports") / f"run.{to}")
        return known[id(run), to]

    return write


@EVERY
def test_every_signal_is_in_mcap_bit_for_bit(run: Run, written: Callable[[Run, str], Path]) -> None:
    file = File.read(written(run, "mcap"))
    times = np.rint(1e9 * run.time_s).astype(int).tolist()
    assert {topic for topic in file.messages if not topic.startswith("/run/")} == {f"/{name}" for name in run.units}
    for name in run.units:
        assert [time_ns for time_ns, _ in file.messages[f"/{name}"]] == times
        assert file.values(f"/{name}").tobytes() == np.ascontiguousarray(run[name]).tobytes()
    assert file.order == sorted(file.order)  # a player need not look back


def test_schemas_are_read_by_others_with_names_and_units(leak: Run, written: Callable[[Run, str], Path]) -> None:
    path = written(leak, "mcap")
    (first, *_), names = decoded(path, "/estimate"), leak.components["estimate"]
    assert tuple(first) == names
    assert list(first.values()) == leak["estimate"][0].tolist()
    assert tuple(decoded(path, "/likelihood")[0]) == leak.scenario.vehicle_data.designations
    file = File.read(path)
    assert file.channels["/rate"].metadata["unit"] == leak.units["rate"] == "rad/s"
    units = [*["1/(slug-ft^2)"] * 6, *["ft"] * 3, "1/slug"]
    assert file.channels["/estimate"].metadata["unit"].split("; ") == units
    assert json.loads(file.channels["/estimate"].metadata["components"]) == list(names)
    assert b" 1/(slug-ft^2)\n" in file.schemas["/estimate"].data
    assert file.schemas["/estimate"].name == "massprop.estimate"
    kinds = {"FrameTransforms": ("frames", "jets"), "SceneUpdate": ("vehicle", "plumes"), "Log": ("events",)}
    for kind, topics in kinds.items():
        assert {file.schemas[f"/run/{topic}"].name for topic in topics} == {f"foxglove.{kind}"}


def _frames(path: Path, child: str) -> list[tuple[str, Array, Array]]:
    """Parent, translation and quaternion (w, x, y, z) of a frame in each message that has it."""
    found = []
    for message in decoded(path, "/run/frames"):
        for one in message["transforms"]:
            if one["child_frame_id"] == child:
                place = np.array([one["translation"][axis] for axis in "xyz"])
                found.append((one["parent_frame_id"], place, np.array([one["rotation"][part] for part in "wxyz"])))
    return found


@pytest.mark.parametrize(
    ("run", "frame", "signals"),
    [
        ("leak", "vehicle", ("position", "attitude", "truth")),
        ("followed", "vehicle", ("position", "attitude", "truth")),
        ("followed", "vehicle_estimated", ("position_estimate", "attitude_estimate", "estimate")),
        ("recorded", "vehicle", ("position_estimate", "attitude_estimate", "estimate")),
    ],
    indirect=["run"],
)
def test_the_center_of_mass_is_where_the_run_has_it(
    run: Run, frame: str, signals: tuple[str, str, str], written: Callable[[Run, str], Path]
) -> None:
    position, attitude, properties = (run[name] for name in signals)
    known = np.isfinite(attitude).all(axis=1)
    found = _frames(written(run, "mcap"), frame)
    assert len(found) == known.sum() > 0
    for row, (parent, place, turned) in zip(np.flatnonzero(known), found, strict=True):
        assert parent == "world"
        np.testing.assert_array_equal(turned, attitude[row])
        center = place + rotation_matrix(turned) @ properties[row, CENTER_OF_MASS]
        # rounding, of coordinates as large as the vehicle
        np.testing.assert_allclose(center, position[row], atol=1e-12 * np.abs(properties[row, CENTER_OF_MASS]).max())


def test_what_is_not_known_is_left_out_and_told(blind: Run, written: Callable[[Run, str], Path]) -> None:
    path = written(blind, "mcap")
    assert _frames(path, "vehicle") == _frames(path, "center_of_mass") == []
    assert len(_frames(path, "center_of_mass_estimated")) == len(blind.time_s)
    texts = [one["message"] for one in decoded(path, "/run/events")]
    assert "position and attitude are not known: the scene stands in the vehicle frame" in texts
    assert "thrust is not known: plumes show the commands" in texts
    assert not any("begins" in text for text in texts)
    found = columns(written(blind, "rerun"))
    assert ("/world/vehicle", "Transform3D:quaternion") not in found
    assert ("/world/vehicle/center_of_mass_estimated", "Transform3D:translation") in found


def test_events_are_told_at_their_times(leak: Run, written: Callable[[Run, str], Path]) -> None:
    path = written(leak, "mcap")
    times = [time_ns for time_ns, _ in File.read(path).messages["/run/events"]]
    (declared,) = leak.results.detections
    said = [(time_ns, one["message"]) for time_ns, one in zip(times, decoded(path, "/run/events"), strict=True)]
    assert [text for _, text in said if "begins" in text] == ["jet L4D: leak begins"]
    assert round(1e9 * declared.time_s) in [time_ns for time_ns, text in said if "failed" in text]
    assert said[-1][0] == round(1e9 * leak.time_s[-1])
    assert re.match(r"verdict: .*; 1 declaration", said[-1][1])


def test_plumes_stand_at_the_jets_that_fire(leak: Run, written: Callable[[Run, str], Path]) -> None:
    path, vehicle = written(leak, "mcap"), leak.scenario.vehicle_data
    times = np.array([time_ns for time_ns, _ in File.read(path).messages["/run/plumes"]])
    scenes = decoded(path, "/run/plumes")
    full = np.linalg.norm(vehicle.thrusts, axis=1)
    leaking = vehicle.designations.index("L4D")
    for row in range(0, len(leak.time_s), 7):
        (entity,) = scenes[np.flatnonzero(times <= round(1e9 * leak.time_s[row]))[-1]]["entities"]
        assert (entity["frame_id"], entity["frame_locked"]) == ("vehicle", True)
        firing = set(np.flatnonzero(leak["thrust"][row] > 0.02 * full).tolist())
        if leak.time_s[row] >= 1.0:
            firing.add(leaking)
        arrows = entity["arrows"] or []  # Rerun gives none for an empty list
        assert len(arrows) == len(firing)
        for jet in firing:
            length = 0.05 + 0.11 * np.sqrt(leak["thrust"][row, jet] / full.max())
            at = vehicle.positions[jet]
            (arrow,) = (one for one in arrows if np.allclose([*one["pose"]["position"].values()], at, atol=1e-12))
            turned = np.array([arrow["pose"]["orientation"][part] for part in "wxyz"])
            along = rotation_matrix(turned)[:, 0] * (arrow["shaft_length"] + arrow["head_length"])
            expected = -vehicle.thrusts[jet] / full[jet] * length * solids.extent(vehicle)
            np.testing.assert_allclose(along, expected, atol=1e-9)


@EVERY
def test_every_signal_is_in_a_recording_bit_for_bit(run: Run, written: Callable[[Run, str], Path]) -> None:
    found = columns(written(run, "rerun"))
    times = np.rint(1e9 * run.time_s).astype(int).tolist()
    for name, names in run.components.items():
        values, units = run[name], component_units(run.units[name], len(names))
        whole = [f"/signals/{name.replace('.', chr(92) + '.')}"]
        paths = [f"/signals/{name}/{one}" for one in names] if len(set(units)) > 1 else whole
        rows = [found[path, "Scalars:scalars"] for path in paths]
        assert [time_ns for time_ns, _ in rows[0]] == times
        table = np.hstack([np.array([row for _, row in one], dtype=float) for one in rows])
        assert table.tobytes() == np.ascontiguousarray(values).tobytes()
        labels = [label for path in paths for _, row in found[path, "SeriesLines:names"] for label in row]
        assert len(labels) == len(names)
        assert all(label.endswith(unit) for label, unit in zip(labels, units, strict=True) if unit != "-")


@pytest.mark.parametrize(("epoch_s", "said"), [(-10.0, r"has the time -10 s"), (1e11, r"has the time 1e\+11 s")])
def test_times_that_no_file_holds_are_refused(followed: Run, tmp_path: Path, epoch_s: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        followed.export("mcap", tmp_path / "a.mcap", epoch_s=epoch_s)
    assert list(tmp_path.iterdir()) == []


def test_a_run_on_disk_gives_the_same_in_pieces(followed: Run, tmp_path: Path) -> None:
    spool = Spool(rows_per_piece=5, index="time_s")
    spool.append({"time_s": followed.time_s, **followed.signals})
    assert not spool.in_memory
    pieces = Run(followed.scenario, followed.results, None, spool)
    assert len(list(Content(pieces).stretches())) > 3
    for to in export.FORMATS:
        for name, run in (("whole", followed), ("pieces", pieces)):
            run.export(to, tmp_path / f"{name}.{to}")
    whole, parts = (File.read(tmp_path / f"{name}.mcap") for name in ("whole", "pieces"))
    assert parts.messages == whole.messages
    one, other = (columns(tmp_path / f"{name}.rerun") for name in ("whole", "pieces"))
    for key, rows in one.items():
        if rows[0][0] is not None:
            np.testing.assert_equal(other[key], rows)


@pytest.mark.parametrize("to", export.FORMATS)
def test_a_missing_package_is_told_with_its_extra(
    followed: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str
) -> None:
    for name in ("foxglove", "rerun", *(f"{export.__name__}.{form.module}" for form in export.FORMATS.values())):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=rf"exporting to {to} needs .*: pip install 'massprop-drake\[{to}\]'"):
        followed.export(to, tmp_path / "a")


def test_names_and_units_of_columns() -> None:
    assert component_units("rad/s (3); ft/s (3); s; -", 8) == (*["rad/s"] * 3, *["ft/s"] * 3, "s", "-")
    assert protobuf.identifiers(["a b", "a_b", "0", "ä", "R4R"]) == ["a_b", "a_b_2", "c0", "c_", "R4R"]


@pytest.mark.parametrize("name", bundled_vehicles())
def test_surfaces_are_closed_and_face_outwards(name: str) -> None:
    for solid in solids.vehicle_solids(load_vehicle(name)):
        faces = solids.triangles(solid) - np.array(solid.position)
        normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
        assert np.linalg.norm(normals, axis=1).min() > 0.0
        np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-9 * np.abs(normals).sum())
        volume = np.einsum("ij,ij->", faces[:, 0], normals) / 6.0
        expected = {
            "box": lambda one: np.prod(one.size),
            "ellipsoid": lambda one: 4.0 / 3.0 * np.pi * np.prod(one.radii),
            "cylinder": lambda one: np.pi * one.length * np.prod(one.radii),
            "cone": lambda one: np.pi / 3.0 * one.length * np.prod(one.radii),
        }
        if solid.kind in expected:  # circles have 48 corners, balls 24 times 12
            assert 0.93 * expected[solid.kind](solid) < volume < (1.0 + 1e-12) * expected[solid.kind](solid)
        assert volume > 0.0


def _heard(address: str) -> dict[str, list[int]]:
    """Times of what a viewer hears by topic, by Foxglove's protocol over a WebSocket, until the server ends."""
    from tornado.websocket import websocket_connect  # noqa: PLC0415 (comes with the extra campaign)

    found: dict[str, list[int]] = defaultdict(list)

    async def listen() -> None:
        server = await websocket_connect(address, subprotocols=["foxglove.sdk.v1"])
        topics: dict[int, str] = {}
        while (message := await server.read_message()) is not None:
            if isinstance(message, str):
                said = json.loads(message)
                if said["op"] == "advertise":
                    topics |= {one["id"]: one["topic"] for one in said["channels"]}
                    asked = [{"id": one["id"], "channelId": one["id"]} for one in said["channels"]]
                    await server.write_message(json.dumps({"op": "subscribe", "subscriptions": asked}))
            elif message[0] == 1:
                number, time_ns = struct.unpack_from("<IQ", message, 1)
                found[topics[number]].append(time_ns)
        server.close()

    asyncio.run(listen())
    return found


def test_a_viewer_of_foxglove_hears_the_whole_run(followed: Run) -> None:
    replay = export.Replay(followed, "mcap", port=0, speed=20.0)
    assert replay.address.startswith("ws://127.0.0.1:")
    heard: list[dict[str, list[int]]] = []
    viewer = threading.Thread(target=lambda: heard.append(_heard(replay.address)))
    viewer.start()
    replay.play()
    viewer.join(30.0)
    times = np.rint(1e9 * followed.time_s).astype(int).tolist()
    (found,) = heard
    assert found["/rate"] == found["/estimate"] == found["/run/frames"] == times
    assert found["/run/events"][-1] == times[-1]
    assert len(found["/run/vehicle"]) >= 1


def test_a_port_that_is_taken_or_has_no_viewer_is_told(followed: Run) -> None:
    replay = export.Replay(followed, "mcap", port=0)
    port = int(replay.address.rpartition(":")[2])
    with pytest.raises(InputError, match=rf"--port {port}: .*; give another one"):
        export.Replay(followed, "mcap", port=port)
    replay.close()
    for speed in (0.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"--speed .*: must be a number above zero"):
            export.Replay(followed, "mcap", speed=speed)
    with socket.socket() as silent:  # has the port to itself, and does not listen
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        with pytest.raises(InputError, match=rf"--port {port}: no viewer of Rerun listens there on this machine"):
            export.Replay(followed, "rerun", port=port)
