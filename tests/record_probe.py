"""A small flight, and files of it as other programs would have written them: by the libraries that read them."""

from __future__ import annotations

import csv
import io
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.yaml import Document
from massprop_drake.maths.vehicle.thrust import lag_factors, level_after, mean_level
from massprop_drake.records.mapped_rows import MappedTable, make_table
from massprop_drake.records.mapping import apply_map
from massprop_drake.records.recording import open_recording

Array = NDArray[np.float64]

EPOCH_NS = 1_700_000_000_000_000_000  # of the bags


class Flight(NamedTuple):
    """What happened, a row each sample period of the vehicle."""

    vehicle: Vehicle
    time_s: Array
    rates: Array  # rad/s, (n, 3)
    velocities: Array  # integrals, m/s, (n, 3)
    commands: Array  # over the interval that starts, (n, n_jets)

    @property
    def jets(self) -> tuple[str, ...]:
        return self.vehicle.designations


def flight(vehicle: Vehicle, rows: int = 60) -> Flight:
    """Numbers that have nothing in common with each other, so that a slip of a column shows."""
    random = np.random.default_rng(5)
    commands = (random.random((rows, len(vehicle.jets))) < 0.3).astype(float)
    rates = np.cumsum(random.normal(0.0, 0.01, (rows, 3)), axis=0)
    velocities = np.cumsum(random.normal(0.0, 0.002, (rows, 3)), axis=0)
    return Flight(vehicle, vehicle.sample_period_s * np.arange(rows), rates, velocities, commands)


ONE = flight(load_vehicle("free_flyer"))


def refused(action: Callable[[], object]) -> str:
    """The message of what is refused."""
    with pytest.raises(InputError) as told:
        action()
    return str(told.value)


def flown(vehicle: Vehicle, seed: int, rows: int = 400, longest: int = 6) -> Flight:
    """A flight that follows its commands by the jets' lag, pulses of random lengths of samples, with a little noise."""
    random = np.random.default_rng(seed)
    commands = np.zeros((rows, len(vehicle.jets)))
    for jet in range(len(vehicle.jets)):
        row = int(random.integers(3, 30))
        while row < rows:
            length = int(random.integers(1, longest + 1))
            commands[row : row + length, jet] = 1.0
            row += length + int(random.integers(5, 40))
    nominal, wrenches = vehicle.nominal, vehicle.wrenches
    torques = wrenches[:, :3] - np.cross(nominal.center_of_mass, wrenches[:, 3:])
    turning = torques @ np.linalg.inv(1.1 * nominal.inertia).T
    arm = np.subtract(vehicle.accelerometers[0].position, nominal.center_of_mass)
    pushing = wrenches[:, 3:] / (0.9 * nominal.mass) + np.cross(turning, arm)
    factors, level = lag_factors(vehicle.time_constants_s, vehicle.sample_period_s), np.zeros(len(vehicle.jets))
    steps = np.zeros_like(commands)
    for row, command in enumerate(commands[:-1]):
        steps[row + 1] = vehicle.sample_period_s * mean_level(level, command, factors.mean)
        level = level_after(level, command, factors.remaining)
    rates = np.cumsum(steps @ turning, axis=0)
    velocities = np.cumsum(steps @ pushing, axis=0)
    rates += random.normal(0.0, 0.02 * np.abs(np.diff(rates, axis=0)).max(), rates.shape)
    velocities += random.normal(0.0, 0.02 * np.abs(np.diff(velocities, axis=0)).max(), velocities.shape)
    return Flight(vehicle, vehicle.sample_period_s * np.arange(rows), rates, velocities, commands)


def as_map(text: str) -> RecordMap:
    document = Document(text, "map.yaml")
    return validate_data(RecordMap, document.data, document)


def telemetry(path: Path, text: str, vehicle: Vehicle) -> dict[str, Array]:
    """Columns of telemetry of a file by a map, by name."""
    return columns_of(made_of(path, text, vehicle))


def columns_of(made: MappedTable) -> dict[str, Array]:
    values = np.vstack([block.values for block in made.blocks(list(range(len(made.header))))])
    return dict(zip(made.header, values.T, strict=True))


def made_of(path: Path, text: str, vehicle: Vehicle) -> MappedTable:
    by = as_map(text)
    return make_table(apply_map(open_recording(path, by), by, vehicle, "map.yaml"), vehicle.gyros[0].name)


def write_csv(path: Path, columns: dict[str, Any], delimiter: str = ",") -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=delimiter, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def usual_columns(one: Flight) -> dict[str, Any]:
    """Columns of a table in the vehicle's units: t, wx.., vx.., and u1.. of the jets."""
    return {
        "t": one.time_s,
        **{f"w{axis}": one.rates[:, index] for index, axis in enumerate("xyz")},
        **{f"v{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")},
        **{f"u{index + 1}": one.commands[:, index].astype(int) for index in range(len(one.jets))},
    }


def usual_map(one: Flight, **instead: str) -> str:
    """A map of them; parts may be given instead, as YAML in one line."""
    parts = {
        "time": "{column: t}",
        "gyro": "{kind: gyro, columns: [wx, wy, wz]}",
        "acc": "{kind: accelerometer, gives: integral, unit: m/s, columns: [vx, vy, vz]}",
        "commands": f"{{columns: {jet_columns(one, 'u{}', 1)}}}",
        "more": "",
    } | instead
    return (
        f"time: {parts['time']}\nsensors:\n  gyro: {parts['gyro']}\n  acc: {parts['acc']}\n"
        f"commands: {parts['commands']}\n{parts['more']}\n"
    )


def jet_columns(one: Flight, pattern: str, first: int) -> str:
    names = ", ".join(f"{jet}: '{pattern.format(index + first)}'" for index, jet in enumerate(one.jets))
    return f"{{{names}}}"


def require_the_flight(
    found: dict[str, Array], one: Flight, *, close: float = 1e-12, rows: slice = slice(None)
) -> None:
    """The telemetry is that of the flight, but for the command of the last row, which a log may not know."""
    np.testing.assert_allclose(found["time_s"] - found["time_s"][0], one.time_s[rows] - one.time_s[rows][0], atol=2e-7)
    for index, axis in enumerate("xyz"):
        np.testing.assert_allclose(found[f"gyro_{axis}"], one.rates[rows, index], atol=close, rtol=0)
        if f"acc_{axis}" in found:
            np.testing.assert_allclose(found[f"acc_{axis}"], one.velocities[rows, index], atol=close, rtol=0)
        else:
            steps = np.diff(one.velocities[rows, index]) / one.vehicle.sample_period_s
            np.testing.assert_allclose(found[f"acc_accel_{axis}"][1:], steps, atol=close / 0.01, rtol=0)
    for index, jet in enumerate(one.jets):
        np.testing.assert_allclose(found[f"jet_{jet}"][:-1], one.commands[rows, index][:-1], atol=1e-9)


def write_ulog(path: Path, topics: dict[str, tuple[Array, dict[str, Array]]], parameters: dict[str, float]) -> Path:
    """Writes topics by name, or `name/1`: times in s, and columns of shape (n,) or (n, m)."""
    from pyulog import ULog  # noqa: PLC0415 (an extra)

    log = ULog(None)
    for number, (name, (time_s, columns)) in enumerate(topics.items()):
        base, _, instance = name.partition("/")
        fields = ["uint64_t timestamp"]
        data: dict[str, Any] = {"timestamp": np.round(time_s * 1e6).astype(np.uint64)}
        for column, values in columns.items():
            if values.ndim == 1:
                fields.append(f"double {column}")
                data[column] = values
            else:
                fields.append(f"double[{values.shape[1]}] {column}")
                data |= {f"{column}[{index}]": values[:, index] for index in range(values.shape[1])}
        text = f"{base}:{''.join(f'{one};' for one in fields)}"
        log._message_formats[base] = ULog.MessageFormat(text.encode(), None)
        described = [ULog._FieldData(key, "uint64_t" if key == "timestamp" else "double") for key in data]
        log._data_list.append(
            SimpleNamespace(name=base, multi_id=int(instance or 0), msg_id=number, field_data=described, data=data)
        )
    log._initial_parameters = dict(parameters)
    log.write_ulog(str(path))
    return path


def px4_topics(one: Flight) -> dict[str, tuple[Array, dict[str, Array]]]:
    """What PX4 would have logged of the flight: rates, increments of velocity, and actuators, NaN when disarmed."""
    time_s = one.time_s + 3.0
    increments = np.diff(one.velocities, axis=0, prepend=one.velocities[:1])
    commands = np.pad(one.commands, ((0, 0), (0, 16 - one.commands.shape[1])), constant_values=np.nan)
    return {
        "vehicle_angular_velocity": (time_s, {"xyz": one.rates}),
        "vehicle_imu": (time_s, {"delta_velocity": increments}),
        "actuator_motors": (time_s, {"control": np.where(commands == 0.0, np.nan, commands)}),
        "cpuload": (time_s[::20], {"load": time_s[::20]}),
    }


def write_bag(path: Path, one: Flight, kind: str, packed: str = "") -> Path:
    """Writes a .bag, or a folder of SQLite or MCAP: an Imu with header, and the commands as an array without one.

    Of ROS 2, `packed` says what is compressed: "FILE", "MESSAGE", "STORAGE" or nothing.
    """
    from rosbags.rosbag1 import Writer as Writer1  # noqa: PLC0415 (an extra)
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin  # noqa: PLC0415
    from rosbags.rosbag2 import Writer as Writer2  # noqa: PLC0415
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = store.types
    imu, array = types["sensor_msgs/msg/Imu"], types["std_msgs/msg/Float64MultiArray"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    pack = store.serialize_ros1 if ros1 else store.serialize_cdr
    writer: Any = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    if packed:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    change = np.diff(one.velocities, axis=0, prepend=one.velocities[:1]) / one.vehicle.sample_period_s
    with writer:
        to_imu = writer.add_connection("/imu", imu.__msgtype__, typestore=store)
        to_jets = writer.add_connection("/jets", array.__msgtype__, typestore=store)
        for row, time_s in enumerate(one.time_s):
            now = EPOCH_NS + round(float(time_s) * 1e9)
            told = {"seq": row} if ros1 else {}
            message = imu(
                header=header(stamp=stamp(sec=now // 10**9, nanosec=now % 10**9), frame_id="body", **told),
                orientation=quaternion(0.0, 0.0, 0.0, 1.0),
                orientation_covariance=np.zeros(9),
                angular_velocity=vector(*one.rates[row].tolist()),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(*change[row].tolist()),
                linear_acceleration_covariance=np.zeros(9),
            )
            # written late, as a bag does: the header knows better
            writer.write(to_imu, now + 4_000_000, pack(message, imu.__msgtype__))
            writer.write(to_jets, now, pack(array(layout=layout, data=one.commands[row].copy()), array.__msgtype__))
    return path


def bag_map(one: Flight) -> str:
    return (
        "sensors:\n"
        "  gyro: {kind: gyro, topic: /imu, columns: [angular_velocity.x, angular_velocity.y, angular_velocity.z]}\n"
        "  acc: {kind: accelerometer, topic: /imu, gives: mean, unit: m/s^2,\n"
        "        columns: [linear_acceleration.x, linear_acceleration.y, linear_acceleration.z]}\n"
        f"commands: {{topic: /jets, columns: {jet_columns(one, 'data[{}]', 0)}}}\n"
    )


def ulog_map(one: Flight, more: str = "") -> str:
    return (
        "sensors:\n"
        "  gyro: {kind: gyro, topic: vehicle_angular_velocity, columns: ['xyz[0]', 'xyz[1]', 'xyz[2]']}\n"
        "  acc: {kind: accelerometer, topic: vehicle_imu, gives: increment, unit: m/s,\n"
        "        columns: ['delta_velocity[0]', 'delta_velocity[1]', 'delta_velocity[2]']}\n"
        f"commands: {{topic: actuator_motors, missing: 'off', columns: {jet_columns(one, 'control[{}]', 0)}}}\n{more}\n"
    )


def write_mat73(path: Path, variables: dict[str, Any]) -> Path:
    """Writes numbers and structures of them as MATLAB does from version 7.3 on: HDF5, dimensions reversed."""
    import h5py  # noqa: PLC0415 (an extra)

    def put(group: Any, content: dict[str, Any]) -> None:
        for name, value in content.items():
            if isinstance(value, dict):
                put(group.create_group(name), value)
            else:
                values = np.asarray(value, dtype=float)
                group.create_dataset(name, data=(values[:, None] if values.ndim == 1 else values).T)

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        put(file, variables)
    content = bytearray(buffer.getvalue())
    content[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM"
    path.write_bytes(content)
    return path
