"""Whom the checks of a record blame: jets where jets explain the readings, sensors and units where they do not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import load_scenario
from massprop_drake.maths.mass_properties import pack
from massprop_drake.records.quality import QualityReport
from massprop_drake.records.rows import Record, Rows

Array = NDArray[np.float64]

CASE = load_scenario("sample_maneuver", ["detector={kind: off}"])
VEHICLE = CASE.vehicle_data
PERIOD_S = VEHICLE.sample_period_s
N_ROWS = 120
INVERSE = np.linalg.inv(VEHICLE.nominal.inertia)


def number(jet: str) -> int:
    return VEHICLE.designations.index(jet)


def fired(*bursts: tuple[tuple[str, ...], int, int]) -> Array:
    """Commands by row: jets, first and last row of each burst."""
    commands = np.zeros((N_ROWS, len(VEHICLE.jets)))
    for jets, first, last in bursts:
        commands[first:last, [number(jet) for jet in jets]] = 1.0
    return commands


def checked(
    commands: Array,
    given: dict[str, float] | None = None,
    *,
    scale: float = 1.0,
    stuck: tuple[str, int] | None = None,
    every: int = 1,
    failed_s: float = math.inf,
    inverse: Array = INVERSE,
    learned: Array | None = None,
    block: int = 50,
) -> dict[str, Any]:
    """Checks a record in which jets give a share of their thrust, and the gyro repeats, scales or stands still."""
    share = np.ones(len(VEHICLE.jets))
    for jet, part in (given or {}).items():
        share[number(jet)] = part
    before = np.vstack([np.zeros_like(commands[:1]), commands[:-1]])
    changed = np.vstack([np.zeros_like(commands[:1]), before[:-1]]) != before

    def increments(of: Array) -> tuple[Array, Array, Array]:
        impulses = of @ VEHICLE.wrenches * PERIOD_S
        angular, linear = impulses[:, :3], impulses[:, 3:]
        return (angular - np.cross(VEHICLE.nominal.center_of_mass, linear)) @ inverse, angular, linear

    turned, _, linear = increments(before * share)
    readings = {}
    for package in VEHICLE.sensors:
        if package.name in {gyro.name for gyro in VEHICLE.gyros}:
            change = turned * scale
        else:
            arm = np.array(package.position) - VEHICLE.nominal.center_of_mass  # type: ignore[attr-defined]
            change = linear / VEHICLE.nominal.mass + np.cross(turned, arm)
        read = np.cumsum(change, axis=0)
        quantum = package.quantum or 1e-9
        readings[package.name] = np.round(read / quantum) * quantum
    readings["gyro"] = readings["gyro"][np.arange(N_ROWS) // every * every]
    if stuck is not None:
        readings[stuck[0]][1:, stuck[1]] = readings[stuck[0]][1, stuck[1]]
    _, angular, linear = increments(before)
    nothing, estimate = np.zeros((N_ROWS, 1)), pack(INVERSE if learned is None else learned, np.zeros(3), 0.0)
    signals = {
        "angular_impulse": angular,
        "linear_impulse": linear,
        "usable": 1.0 - changed.any(axis=1, keepdims=True),
        "firing": (before > 0.0).any(axis=1, keepdims=True).astype(float),
        "rotation_used": nothing + 1.0,
        "mass_used": nothing + 1.0,
        "estimate": np.tile(np.append(estimate[:6], VEHICLE.nominal.vector()[6:]), (N_ROWS, 1)),
        "standard_deviation": np.ones((N_ROWS, 10)),
    }
    time_s = PERIOD_S * np.arange(N_ROWS)
    report = QualityReport(CASE)
    report.begin(commands[0] * 0.0)
    for first in range(0, N_ROWS, block):
        part = slice(first, first + block)
        rows = Rows(
            time_s[part],
            {name: values[part] for name, values in readings.items()},
            commands[part],
            None,
            np.ones(len(time_s[part]), dtype=bool),
        )
        report.add(rows, {name: values[part] for name, values in signals.items()})
    return report.summarize(RECORD, (0, 0, False), failed_s)


RECORD = Record()
RECORD.rows, RECORD.first_s, RECORD.last_s = N_ROWS, 0.0, PERIOD_S * (N_ROWS - 1)
BURSTS = fired((("F1U", "L1U"), 10, 30), (("R1U",), 40, 60), (("F2R",), 70, 110))


def test_jets_that_all_fire_leave_no_warning() -> None:
    found = checked(BURSTS)
    assert found["warnings"] == []
    assert found["units"]["gyro"]["slope"] > 0.9


def test_a_jet_that_does_not_fire_is_blamed_and_no_sensor() -> None:
    """F2R fires alone half the time: all readings stand still, and change by nothing of what they should."""
    found = checked(BURSTS, {"F2R": 0.0})
    assert found["stuck"] == []
    (entry,) = found["unanswered"]
    assert entry["jets"] == ["F2R"]
    assert entry["from_s"] < 71 * PERIOD_S
    assert abs(entry["share"]) < 0.01
    assert any("F2R told to fire from" in text and "not sensors that stood still" in text for text in found["warnings"])
    assert not any("must be in rad/s" in text for text in found["warnings"])
    known = checked(BURSTS, {"F2R": 0.0}, failed_s=60 * PERIOD_S)
    assert known["unanswered"] == []  # what fires against a failed jet may show nothing, too


def test_a_gyro_axis_that_stands_still_is_blamed_and_no_jet() -> None:
    found = checked(BURSTS, stuck=("gyro", 1))
    assert found["unanswered"] == []
    assert {(entry["sensor"], entry["axis"]) for entry in found["stuck"]} == {("gyro", "y")}
    assert all(entry["to_s"] - entry["from_s"] > 5.0 for entry in found["stuck"])  # whoever has failed
    assert checked(BURSTS, stuck=("gyro", 1), failed_s=0.0)["stuck"] == found["stuck"]


@pytest.mark.parametrize("every", [2, 3])
def test_readings_that_rows_repeat_are_said(every: int) -> None:
    found = checked(BURSTS, every=every)
    repeated = found["repeated"]["gyro"]
    assert repeated["count"] == pytest.approx(repeated["of"] * (1.0 - 1.0 / every), abs=3)
    assert found["stuck"] == found["unanswered"] == []
    assert any(text.startswith("gyro repeats its reading in") and "`every`" in text for text in found["warnings"])


def test_wrong_units_are_wrong_whichever_jet_fires() -> None:
    warnings = checked(BURSTS, scale=57.3)["warnings"]
    assert any("gyro changes by 57.3 times" in text and "degrees in place of radians" in text for text in warnings)
    assert checked(BURSTS, scale=57.3, failed_s=60 * PERIOD_S)["warnings"] == warnings


def not_about_x(*jets: str) -> Array:
    """The inverse inertia with the products by which two jets do not turn the vehicle about x."""
    wrenches = VEHICLE.wrenches[[number(jet) for jet in jets]]
    torques = wrenches[:, :3] - np.cross(VEHICLE.nominal.center_of_mass, wrenches[:, 3:])
    true = INVERSE.copy()
    true[0, 1:] = true[1:, 0] = INVERSE[0, 1:] - np.linalg.solve(torques[:, 1:], torques @ INVERSE[0])
    assert (np.linalg.eigvalsh(true) > 0.0).all()
    return true


OF_X = [("gyro", "x")]


def test_a_jet_that_turns_out_to_move_a_reading_hardly_proves_no_sensor_wrong() -> None:
    """Through a product of inertia that the file has wrong; what always stands still teaches nothing of it."""
    true = not_about_x("F2R", "F1L")
    for learned, stuck, expected in ((true, None, []), (None, None, OF_X), (true, ("gyro", 0), OF_X)):
        found = checked(BURSTS, inverse=true, learned=learned, stuck=stuck)["stuck"]
        assert [(each["sensor"], each["axis"]) for each in found] == expected


@pytest.mark.parametrize("block", [120, 7])
@pytest.mark.parametrize("jets", [("F2R", "F1L"), ("F1L", "F2R")])
def test_a_change_counts_from_its_least_to_its_most_wherever_these_were(jets: tuple[str, str], block: int) -> None:
    """Jets one way, and then the other for as much: at the end the change is as good as none, but has been large."""
    true = not_about_x(*jets)
    wrenches = VEHICLE.wrenches[[number(jet) for jet in jets]]
    about_x = (wrenches[:, :3] - np.cross(VEHICLE.nominal.center_of_mass, wrenches[:, 3:])) @ INVERSE[0]
    commands = fired((("F1U", "L1U"), 4, 28), ((jets[0],), 32, 52), ((jets[1],), 54, 74), (("F1U", "L1U"), 80, 104))
    commands[54:74] *= -about_x[0] / about_x[1]
    found = checked(commands, inverse=true, block=block)["stuck"]
    assert [(each["sensor"], each["axis"]) for each in found] == OF_X
