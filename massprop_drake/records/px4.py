"""Vehicle file from the parameters of a PX4 log: `CA_THRUSTERn_*` of its control allocation."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import InputError
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.records.topics import Recording

_COUNT, _JET = "CA_THRUSTER_CNT", "CA_THRUSTER{index}_{what}"
_DEFAULTS = {
    "AX": 0.0,
    "AY": 0.0,
    "AZ": -1.0,
    "PX": 0.0,
    "PY": 0.0,
    "PZ": 0.0,
    "CT": 6.5,
}  # PX4's, of what is not logged
_ALIKE = 0.9  # cosine between jets of a cluster, which lie closer than a quarter of the reach
_COMMANDS, _RATES, _IMU = "actuator_motors", "vehicle_angular_velocity", "vehicle_imu"
_NORMAL = 0.6745  # median of the absolute value of a standard normal number


class VehicleFromLog(NamedTuple):
    """Vehicle file made from a log.

    Attributes:
        data: as the file has it.
        assumed: what the log does not say, a sentence each.
    """

    data: dict[str, Any]
    assumed: list[str]


def vehicle_from_log(
    recording: Recording, name: str, mass: float | None, inertia: tuple[float, float, float] | None
) -> VehicleFromLog:
    """Makes the data of a vehicle file from the parameters of a PX4 log, with its assumptions.

    A thruster's axis is the direction of the force on the vehicle, its coefficient the thrust in N at full command, in
    body axes forward, right, down, as PX4's allocation takes them.

    Args:
        recording: of a ULog.
        name: of the vehicle.
        mass: kg; PX4 has no parameter for it.
        inertia: principal moments, kg-m^2, likewise.

    Raises:
        InputError: when there are no thrusters, mass and inertia are not given, or the vehicle is impossible.
    """
    parameters = recording.parameters
    count = int(parameters.get(_COUNT, 0))
    if count < 1:
        raise InputError(
            f"{recording.source}: has no parameter {_COUNT} above zero, and so no vehicle with thrusters; write the "
            "vehicle's file, docs/vehicle.md"
        )
    if mass is None or inertia is None:
        raise InputError(f"{recording.source}: PX4 logs neither mass nor inertia: give --mass and --inertia")
    jets, assumed = _read_jets(recording, count)
    period_s = _period_s(recording)
    gyro_noise = _white_noise_std(recording, _RATES, "xyz")
    if gyro_noise is None:
        raise InputError(f"{recording.source}: has no topic {_RATES}, and so no gyro")
    data: dict[str, Any] = {
        "name": name,
        "description": f"of the parameters of {recording.source.rpartition('/')[2]}",
        "units": "si",
        "sample_period_s": period_s,
        "mass_properties": {
            "mass": mass,
            "center_of_mass": [0.0, 0.0, 0.0],
            "inertia": [
                [moment if row == column else 0.0 for column in range(3)] for row, moment in enumerate(inertia)
            ],
        },
        "gyros": [{"name": "gyro", "noise_std": gyro_noise}],
    }
    assumed += [
        "the center of mass is the origin of the thrusters' positions, products of inertia are zero",
        f"sample_period_s is the median interval of {_COMMANDS} or of the rates, whichever is longer",
        "the gyro's noise is what successive readings differ by",
    ]
    increments = _white_noise_std(recording, _IMU, "delta_velocity")
    if increments is not None:
        position = [parameters.get(f"EKF2_IMU_POS_{axis}", 0.0) for axis in "XYZ"]
        data["accelerometers"] = [{"name": "imu", "position": position, "noise_std": increments}]
        assumed.append("the accelerometer's noise is what successive increments differ by; its place is EKF2_IMU_POS")
    thrusts = [jet["thrust"] for jet in jets]
    data["jet_kinds"] = {
        "thruster": {"nominal_thrust": max(thrusts), "specific_impulse_s": 60.0, "thrust_uncertainty": 0.1}
    }
    assumed.append("a specific impulse of 60 s (cold gas), no lag, and thrusts known to 10 % are assumed")
    data["jets"] = jets
    validate_data(Vehicle, data, source=f"vehicle of {recording.source}")
    return VehicleFromLog(data, assumed)


def _read_jets(recording: Recording, count: int) -> tuple[list[dict[str, Any]], list[str]]:
    """Returns the thrusters in a PX4 log's parameters as jets of a vehicle file, and assumptions made for them."""
    jets: list[dict[str, Any]] = []
    defaulted: set[str] = set()
    for index in range(count):
        values = {}
        for parameter, default in _DEFAULTS.items():
            name = _JET.format(index=index, what=parameter)
            if name not in recording.parameters:
                defaulted.add(parameter)
            values[parameter] = recording.parameters.get(name, default)
        axis = [_round_to_float32(values[f"A{letter}"]) for letter in "XYZ"]
        length = math.hypot(*axis)
        if length < 1e-6 or values["CT"] <= 0.0:
            raise InputError(
                f"{recording.source}: thruster {index} has no direction or no thrust: "
                f"{_JET.format(index=index, what='AX')}, AY, AZ, CT"
            )
        jets.append(
            {
                "number": index + 1,
                "designation": f"T{index}",
                "cluster": index + 1,
                "kind": "thruster",
                "position": [_round_to_float32(values[f"P{letter}"]) for letter in "XYZ"],
                "direction": [one / length for one in axis],
                "thrust": _round_to_float32(values["CT"]),
            }
        )
    max_arm = max(float(np.linalg.norm(jet["position"])) for jet in jets)
    for jet in jets:
        for other in jets[: jet["number"] - 1]:
            near = np.linalg.norm(np.subtract(jet["position"], other["position"])) < 0.25 * max_arm
            if near and abs(np.dot(jet["direction"], other["direction"])) > _ALIKE:
                jet["cluster"] = other["cluster"]
                break
    assumed = [f"PX4's default stands for {', '.join(sorted(defaulted))} of some thrusters"] if defaulted else []
    return jets, assumed


def _round_to_float32(value: float) -> float:
    """Rounds a number to 7 digits, the precision of the 32-bit float it was logged as."""
    return float(f"{value:.7g}")


def _period_s(recording: Recording) -> float:
    """Returns the median interval of commands or rates in a PX4 log, whichever is longer, s."""
    intervals = [
        float(np.median(np.diff(topic.stamps_s)))
        for name in (_COMMANDS, _RATES)
        if (topic := recording.topics.get(name)) is not None and topic.stamps_s is not None and topic.rows > 1
    ]
    if not intervals:
        raise InputError(f"{recording.source}: has neither {_COMMANDS} nor {_RATES}")
    return float(f"{max(intervals):.6g}")


def _white_noise_std(recording: Recording, topic: str, column: str) -> float | None:
    """Estimates 1-sigma of white noise of a topic's vector from successive differences; None without readings."""
    table = recording.topics.get(topic)
    if table is None or f"{column}[0]" not in table.columns or table.rows < 3:
        return None
    changes = np.concatenate([np.abs(np.diff(table.numbers(f"{column}[{axis}]"))) for axis in range(3)])
    changes = changes[np.isfinite(changes) & (changes > 0.0)]
    if not changes.size:
        return 1e-6
    return float(f"{float(np.median(changes)) / (_NORMAL * math.sqrt(2.0)):.3g}")
