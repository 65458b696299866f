"""Maps that are proposed, and vehicles made of a log's parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_probe import (
    Flight,
    flight,
    px4_topics,
    require_the_flight,
    telemetry,
    usual_columns,
    write_bag,
    write_csv,
    write_ulog,
)

from massprop_drake.errors import InputError
from massprop_drake.inputs.model import validated
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.records.names import read_name
from massprop_drake.records.proposal import Proposal, propose
from massprop_drake.records.px4 import vehicle_of
from massprop_drake.records.recording import open_recording


@pytest.fixture(scope="module")
def one() -> Flight:
    return flight(load_vehicle("free_flyer"))


def proposed(path: Path, vehicle: Vehicle) -> Proposal:
    return propose(open_recording(path), vehicle)


def said(found: Proposal) -> str:
    return "\n".join(found.reasons)


@pytest.mark.parametrize(
    ("column", "words", "axis", "unit"),
    [
        ("gyro_x_dps", ("gyro",), 0, "dps"),
        ("gyro_x_degps", ("gyro",), 0, "deg/s"),
        ("qw", ("q",), 0, ""),
        ("att_q_z", ("q",), 3, ""),
        ("q[3]", ("q",), 3, ""),
        ("wy [deg/s]", ("w",), 1, "deg/s"),
        ("angularVelocity.z", ("angular", "velocity"), 2, ""),
        ("acc[1]", ("acc",), 1, ""),
        ("az (m/s^2)", ("a",), 2, "m/s^2"),
        ("yaw_rate_radps", ("yaw", "rate"), -1, "rad/s"),
        ("nominal_time_s", ("nominal", "time"), -1, "s"),
        ("gyro_x_deg_s", ("gyro",), 0, "deg/s"),
        ("acc_z_m_s2", ("acc",), 2, "m/s^2"),
        ("dvx_mm_s", ("dv",), 0, "mm/s"),
        ("x_m", (), 0, "m"),
        ("q", ("pqr",), 1, ""),
        ("thruster_12", ("thruster", "12"), -1, ""),
    ],
)
def test_names_are_read(column: str, words: tuple[str, ...], axis: int, unit: str) -> None:
    found = read_name(column)
    assert (found.words, found.axis, found.unit) == (words, axis, unit)


NAMES: dict[str, Callable[[Flight], dict[str, Any]]] = {
    "plain": lambda one: {
        "time_ms": 1000.0 * one.time_s,
        **{f"gyro_{axis}_dps": np.degrees(one.rates[:, index]) for index, axis in enumerate("xyz")},
        **{f"dv_{axis}_mmps": 1e3 * np.diff(one.velocities[:, index], prepend=0) for index, axis in enumerate("xyz")},
        **{f"cmd_{jet}": one.commands[:, index].astype(int) for index, jet in enumerate(one.jets)},
    },
    "bracketed": lambda one: {
        "t [us]": 1e6 * one.time_s,
        **{f"w{axis} [rad/s]": one.rates[:, index] for index, axis in enumerate("xyz")},
        **{f"acc[{index}]": one.velocities[:, index] for index in range(3)},
        **{f"thruster{index:02d}": 100.0 * one.commands[:, index] for index in range(len(one.jets))},
    },
    "mask": lambda one: {
        "timestamp": 1e9 * one.time_s,
        **{name: one.rates[:, index] for index, name in enumerate("pqr")},
        "valve_bits": (one.commands @ 2 ** np.arange(len(one.jets))).astype(int),
    },
    "list": lambda one: {
        "t": one.time_s,
        **{f"omega_{axis}": one.rates[:, index] for index, axis in enumerate("xyz")},
        "fired": [" ".join(jet for jet, on in zip(one.jets, row, strict=True) if on) for row in one.commands],
    },
    "on-times": lambda one: {
        "t": one.time_s,
        **{f"omega_{axis}": one.rates[:, index] for index, axis in enumerate("xyz")},
        **{f"{jet}_on_s": 0.05 * one.commands[:, index] for index, jet in enumerate(one.jets)},
    },
}


@pytest.mark.parametrize("name", NAMES)
def test_a_proposed_map_gives_the_flight(name: str, one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", NAMES[name](one))
    found = proposed(path, one.vehicle)
    assert found.lacking == []
    rows = telemetry(path, to_yaml(found.data), one.vehicle)
    if "acc_x" in rows or "acc_accel_x" in rows:
        require_the_flight(rows, one, close=1e-9)
    else:
        require_the_flight(rows | {f"acc_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}, one)


def test_columns_called_as_a_package_are_its_own(one: Flight, tmp_path: Path) -> None:
    renamed = one.vehicle.accelerometers[0].model_copy(update={"name": "Nav_IMU"})
    vehicle = one.vehicle.model_copy(update={"accelerometers": [renamed]})
    columns = {name: values for name, values in usual_columns(one).items() if name[0] != "v"}
    columns |= {f"nav_imu_{axis}_mm_s": one.velocities[:, index] for index, axis in enumerate("xyz")}
    entry = proposed(write_csv(tmp_path / "log.csv", columns), vehicle).data["sensors"]["Nav_IMU"]
    assert (entry["unit"], entry["gives"]) == ("mm/s", "integral")


def test_columns_of_a_vehicle_in_feet_are_in_feet(tmp_path: Path) -> None:
    one = flight(load_vehicle("orbiter"))
    columns = {name: values for name, values in usual_columns(one).items() if name[0] != "v"}
    columns |= {f"acc1_{axis}": one.velocities[:, index] for index, axis in enumerate("xyz")}
    entry = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle).data["sensors"]["acc1"]
    assert (entry["unit"], entry["gives"]) == ("ft/s", "integral")


def test_rows_that_repeat_the_rates_are_seen(one: Flight, tmp_path: Path) -> None:
    rows = np.arange(len(one.time_s)) // 2 * 2
    columns = usual_columns(one) | {f"w{axis}": one.rates[rows, index] for index, axis in enumerate("xyz")}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert found.data["sensors"]["gyro"]["every"] == 2
    assert "they change in every 2 rows at the most" in said(found)
    whole = proposed(write_csv(tmp_path / "all.csv", usual_columns(one)), one.vehicle)
    assert "every" not in whole.data["sensors"]["gyro"]


def test_what_is_left_is_told(one: Flight, tmp_path: Path) -> None:
    columns = {name: values for name, values in usual_columns(one).items() if name[0] != "v"}
    columns |= {"mystery": one.time_s}
    words = said(proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle))
    assert "no columns were found for acc: name them under `sensors`" in words
    assert "not used: mystery" in words
    assert "wx," not in words.partition("not used")[2]


def test_separators_are_put_into_the_map(one: Flight, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", NAMES["plain"](one), delimiter=";")
    path.write_text(path.read_text(encoding="utf-8").replace(".", ","), encoding="utf-8")
    found = proposed(path, one.vehicle)
    assert found.data["csv"] == {"separator": ";", "decimal": ","}
    require_the_flight(telemetry(path, to_yaml(found.data), one.vehicle), one, close=1e-9)


def test_what_jets_do_tells_the_unit_and_the_interval(one: Flight, tmp_path: Path) -> None:
    """Rates that follow the commands, in degrees that are not called so, and commands logged once they have acted."""
    vehicle = one.vehicle
    arms = vehicle.wrenches[:, :3] - np.cross(vehicle.nominal.center_of_mass, vehicle.wrenches[:, 3:])
    turning = arms @ np.linalg.inv(vehicle.nominal.inertia).T * vehicle.sample_period_s
    told = np.vstack([np.zeros((1, len(one.jets))), one.commands])[:-1]
    columns = usual_columns(one)
    columns |= {f"w{axis}": np.degrees(np.cumsum(told @ turning, axis=0))[:, index] for index, axis in enumerate("xyz")}
    found = proposed(write_csv(tmp_path / "log.csv", columns), vehicle)
    assert found.data["sensors"]["gyro"]["unit"] == "deg/s"
    assert found.data["commands"]["acts"] == "from_row"
    columns |= {f"u{index + 1}": told[:, index] for index in range(len(one.jets))}
    found = proposed(write_csv(tmp_path / "log.csv", columns), vehicle)
    assert found.data["commands"]["acts"] == "until_row"
    assert "correlation of" in said(found)
    assert "1.00 in the one before" in said(found)


def test_what_jets_do_tells_increments_from_their_sums(one: Flight, tmp_path: Path) -> None:
    vehicle = one.vehicle
    gained = one.commands @ vehicle.wrenches[:, 3:] / vehicle.nominal.mass * vehicle.sample_period_s
    gained = np.vstack([np.zeros(3), gained[:-1]])
    columns = {name: values for name, values in usual_columns(one).items() if name[0] != "v"}
    for values, gives in ((gained, "increment"), (np.cumsum(gained, axis=0), "integral")):
        named = {f"dv_{axis}": values[:, index] for index, axis in enumerate("xyz")}
        found = proposed(write_csv(tmp_path / "log.csv", columns | named), vehicle)
        assert found.data["sensors"]["acc"]["gives"] == gives
        assert ("sums of increments" in said(found)) == (gives == "integral")


def test_rates_too_fast_for_radians_are_degrees(one: Flight, tmp_path: Path) -> None:
    columns = usual_columns(one) | {"wz": 150.0 + one.rates[:, 2]}
    found = proposed(write_csv(tmp_path / "log.csv", columns), one.vehicle)
    assert found.data["sensors"]["gyro"]["unit"] == "deg/s"
    assert "too much for rad/s" in said(found)


def planar(one: Flight, exact: bool) -> dict[str, Any]:
    """A log of a planar vehicle: pose, and rates that are differences, or not quite."""
    random = np.random.default_rng(4)
    time_s = np.cumsum(random.uniform(0.045, 0.065, 200))
    values = {"x_m": 0.3 * np.sin(time_s), "y_m": 0.2 * np.cos(1.3 * time_s), "yaw_rad": 0.5 * time_s}
    slopes = {
        "x_m": 0.3 * np.cos(time_s),
        "y_m": -0.26 * np.sin(1.3 * time_s),
        "yaw_rad": 0.5 + 0.01 * np.sin(9.0 * time_s),
    }
    differences = {
        name: np.diff(value, prepend=np.nan) / np.diff(time_s, prepend=0.0) for name, value in values.items()
    }
    rates = differences if exact else slopes
    names = {"x_m": "vx_mps", "y_m": "vy_mps", "yaw_rad": "yaw_rate_radps"}
    commands = random.random((200, len(one.jets))) < 0.3
    return {
        "step": np.arange(200),
        "nominal_time_s": 0.05 * np.arange(200),
        **values,
        **{names[name]: np.where(np.isnan(rate), 0.0, rate) for name, rate in rates.items()},
        **{jet: commands[:, index].astype(int) for index, jet in enumerate(one.jets)},
    }


def test_rates_that_are_differences_are_no_sensors_but_tell_the_time(one: Flight, tmp_path: Path) -> None:
    found = proposed(write_csv(tmp_path / "log.csv", planar(one, exact=True)), one.vehicle)
    assert found.lacking == []
    assert list(found.data["sensors"]) == ["pose"]
    assert found.data["sensors"]["pose"]["position"] == ["x_m", "y_m", None]
    assert found.data["sensors"]["pose"]["heading"] == "yaw_rad"
    assert [pair["rate"] for pair in found.data["time"]["differences"]] == ["vx_mps", "vy_mps", "yaw_rate_radps"]
    assert "nominal_time_s only counts, 0.05 s a row, while the differences were divided by" in said(found)


def test_rates_that_are_measured_are_sensors(one: Flight, tmp_path: Path) -> None:
    found = proposed(write_csv(tmp_path / "log.csv", planar(one, exact=False)), one.vehicle)
    assert set(found.data["sensors"]) == {"pose", "velocity", "gyro"}
    assert found.data["sensors"]["gyro"]["columns"] == [None, None, "yaw_rate_radps"]
    assert "differences" not in found.data["time"]


def test_what_cannot_be_found_is_said(one: Flight, tmp_path: Path) -> None:
    found = proposed(write_csv(tmp_path / "log.csv", {"alpha": [1, 2, 3], "beta": [1, 5, 2]}), one.vehicle)
    assert [sentence.partition(":")[0] for sentence in found.lacking] == [
        "no column of time was found",
        "no sensor was found",
        "no commands were found",
    ]


def test_px4_topics(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    path = write_ulog(tmp_path / "log.ulg", px4_topics(one), {})
    found = proposed(path, one.vehicle)
    assert found.lacking == []
    require_the_flight(telemetry(path, to_yaml(found.data), one.vehicle), one)
    topics = px4_topics(one)
    topics["vehicle_acceleration"] = (topics["vehicle_imu"][0], {"xyz": one.rates})
    del topics["vehicle_imu"]
    found = proposed(write_ulog(tmp_path / "log.ulg", topics, {}), one.vehicle)
    assert found.data["sensors"]["acc"]["gives"] == "mean"  # one instant a sample could not be integrated
    assert "one a sample is taken for the mean over it" in said(found)
    slower = one.vehicle.model_copy(update={"sample_period_s": 0.2})
    assert proposed(tmp_path / "log.ulg", slower).data["sensors"]["acc"]["gives"] == "instant"


def test_a_log_of_actuators_that_is_too_slow_is_warned_of(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    topics = px4_topics(one)
    time_s, columns = topics["actuator_motors"]
    topics["actuator_motors"] = (time_s[::4], {"control": columns["control"][::4]})
    path = write_ulog(tmp_path / "log.ulg", topics, {})
    text = to_yaml(proposed(path, one.vehicle).data)
    from record_probe import made_of  # noqa: PLC0415

    notes = made_of(path, text, one.vehicle).notes
    assert "commands are logged every 0.2 s, and a sample is 0.05 s: firings in between are lost" in notes[0]
    slower = one.vehicle.model_copy(update={"sample_period_s": 0.2})
    notes = made_of(path, text, slower).notes
    assert "commands are logged every 0.2 s, and 'gyro' every 0.05 s: what happened in between" in notes[0]
    with pytest.raises(InputError, match="'gyro' is logged every"):
        made_of(path, text, one.vehicle.model_copy(update={"sample_period_s": 0.01}))


def test_parts_of_a_mat_file(one: Flight, tmp_path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415

    savemat(
        tmp_path / "log.mat",
        {
            "rcs": {"time_ms": 1e3 * one.time_s, **{f"valve{i}": one.commands[:, i] for i in range(len(one.jets))}},
            "imu": {"t": one.time_s, "gyro": one.rates, "dv": np.diff(one.velocities, axis=0, prepend=0.0)},
        },
    )
    found = proposed(tmp_path / "log.mat", one.vehicle)
    assert found.lacking == []
    assert (found.data["topic"], found.data["commands"]["topic"]) == ("imu", "rcs")
    require_the_flight(telemetry(tmp_path / "log.mat", to_yaml(found.data), one.vehicle), one)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_topics_of_a_bag(kind: str, one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / ("log.bag" if kind == "ros1" else "log"), one, kind)
    found = proposed(path, one.vehicle)
    assert found.lacking == []
    found.data["sensors"]["acc"]["gives"] = "mean"
    require_the_flight(telemetry(path, to_yaml(found.data), one.vehicle), one)


# ---------------------------------------------------------------------------- a vehicle of a log


def parameters() -> dict[str, Any]:
    """Of four thrusters in a plane, the rest at PX4's defaults."""
    found: dict[str, Any] = {"CA_THRUSTER_CNT": 4, "EKF2_IMU_POS_X": 0.05}
    places = ((-0.12, -0.12, 1.0), (0.12, -0.12, -1.0), (-0.12, 0.12, 1.0), (0.12, 0.12, -1.0))
    for index, (x, y, axis) in enumerate(places):
        found |= {f"CA_THRUSTER{index}_PX": x, f"CA_THRUSTER{index}_PY": y, f"CA_THRUSTER{index}_PZ": 0.0}
        found |= {f"CA_THRUSTER{index}_AX": axis, f"CA_THRUSTER{index}_AY": 0.0, f"CA_THRUSTER{index}_AZ": 0.0}
        found |= {f"CA_THRUSTER{index}_CT": 1.4}
    return found


def test_a_vehicle_of_the_parameters(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    recording = open_recording(write_ulog(tmp_path / "log.ulg", px4_topics(one), parameters()))
    made = vehicle_of(recording, "box", 15.0, (0.2, 0.2, 0.3))
    vehicle = validated(Vehicle, made.data)
    assert vehicle.designations == ("T0", "T1", "T2", "T3")
    np.testing.assert_allclose(vehicle.thrusts[1], [-1.4, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(vehicle.wrenches[1, :3], np.cross([0.12, -0.12, 0.0], [-1.4, 0.0, 0.0]), rtol=1e-6)
    assert vehicle.sample_period_s == pytest.approx(0.05)
    assert vehicle.accelerometers[0].position == pytest.approx((0.05, 0.0, 0.0))
    assert 0.005 < vehicle.gyros[0].noise_std < 0.02  # the flight's rates are a random walk of 0.01 a row
    assert proposed(Path(recording.source), vehicle).lacking == []


def test_a_log_that_gives_no_vehicle(one: Flight, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")

    def refused(more: dict[str, Any], mass: float | None = 15.0) -> str:
        given = {name: value for name, value in (parameters() | more).items() if value is not None}
        recording = open_recording(write_ulog(tmp_path / "log.ulg", px4_topics(one), given))
        with pytest.raises(InputError) as told:
            vehicle_of(recording, "box", mass, (0.2, 0.2, 0.3))
        return str(told.value)

    assert "PX4 logs neither mass nor inertia: give --mass and --inertia" in refused({}, None)
    assert "has no parameter CA_THRUSTER_CNT above zero" in refused({"CA_THRUSTER_CNT": None})
    assert "thruster 2 has no direction or no thrust" in refused({"CA_THRUSTER2_CT": 0.0})
    assert "mass_properties.mass" in refused({}, -1.0)


def test_what_follows_a_vehicle_has_the_names_of_its_sensors(one: Flight, tmp_path: Path) -> None:
    columns = planar(one, exact=False)
    vehicle = load_vehicle("air_bearing")
    commands = np.random.default_rng(5).random((200, 8)) < 0.3
    columns |= {jet: commands[:, index].astype(int) for index, jet in enumerate(vehicle.designations)}
    found = proposed(write_csv(tmp_path / "log.csv", columns), vehicle)
    assert list(found.data["sensors"]) == ["mocap"]
    assert "vx_mps, vy_mps, velocities by their names: the vehicle has no further velocity sensor" in said(found)
    RecordMap.model_validate(found.data)
