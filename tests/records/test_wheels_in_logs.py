"""Speeds of reaction wheels in logs of other programs, and what a vehicle file may not say of wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.records import mapping, proposal
from massprop_drake.records.recording import open_recording

ROWS = 40


def written(path: Path, names: list[str]) -> Path:
    """A log of the CubeSat in degrees, milliseconds and revolutions a minute."""
    jets = [f"THR{number}_ON_MS" for number in range(1, 9)]
    lines = [";".join(["MET [ms]", "W_X [deg/s]", "W_Y [deg/s]", "W_Z [deg/s]", *jets, *names])]
    for row in range(ROWS):
        rates = [f"{0.01 * row * axis:.4f}" for axis in (1, -2, 3)]
        told = ["100" if row % 8 == number else "0" for number in range(8)]
        lines.append(";".join([str(1000 + 100 * row), *rates, *told, *(f"{600.0 + row:.1f}" for _ in names)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("names", [["RWX_RPM", "RWY_RPM", "RWZ_RPM"], ["wheel1 [rpm]", "wheel2 [rpm]", "wheel3 [rpm]"]])
def test_speeds_of_wheels_are_found_and_read(tmp_path: Path, names: list[str]) -> None:
    vehicle = load_vehicle("cubesat")
    recording = open_recording(written(tmp_path / "log.csv", names))
    proposed = proposal.propose(recording, vehicle)
    found = {name: proposed.data["sensors"][name] for name in ("RWX", "RWY", "RWZ")}
    assert [(one["kind"], one["speed"], one["unit"]) for one in found.values()] == [
        ("wheel", name, "rpm") for name in names
    ]
    made = mapping.mapped(recording, RecordMap.model_validate(proposed.data), vehicle)
    table = mapping.table(made, "gyro")
    (block,) = table.blocks([table.header.index("RWY_speed")])
    column = block.values[:, 0]
    assert column[0] == pytest.approx(600.0 * 2.0 * 3.141592653589793 / 60.0)


def test_wheels_that_the_vehicle_has_not_are_refused(tmp_path: Path) -> None:
    recording = open_recording(written(tmp_path / "log.csv", ["RWX_RPM"]))
    data = proposal.propose(recording, load_vehicle("cubesat")).data
    data["sensors"]["RW7"] = {"kind": "wheel", "speed": "RWX_RPM", "unit": "rpm"}
    with pytest.raises(InputError, match=r"sensors\.RW7: vehicle 'cubesat' has no wheel of this name"):
        mapping.mapped(recording, RecordMap.model_validate(data), load_vehicle("cubesat"))


@pytest.mark.parametrize(
    ("wheel", "problem"),
    [
        ({"axis": [1, 1, 0]}, "must have length 1 within 0.002"),
        ({"inertia": 0.0}, "greater than 0"),
        ({"inertia_uncertainty": 0.5}, "less than or equal to 0.3"),
        ({"noise_std": 0.0}, "needs a quantum or a noise_std above zero"),
        ({"name": "gyro"}, "must be unique|appears twice"),
        ({"name": "wheels"}, "is a signal of every run"),
    ],
)
def test_what_no_wheel_is_is_refused(wheel: dict[str, Any], problem: str) -> None:
    data = load_vehicle("cubesat").model_dump()
    data["wheels"] = [data["wheels"][0] | {"quantum": 0.0} | wheel, *data["wheels"][1:]]
    with pytest.raises(ValueError, match=problem):
        Vehicle.model_validate(data)


def test_wheels_play_no_part_in_a_fixed_frame() -> None:
    data = load_vehicle("cubesat").model_dump()
    data["poses"] = [{"name": "cameras", "position_std": 0.001, "attitude_std": 0.001}]
    with pytest.raises(ValueError, match="play no part in a fixed frame"):
        Vehicle.model_validate(data)
