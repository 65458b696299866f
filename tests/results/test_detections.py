"""Detections: their kinds, modes and words, and how they follow from the detector's signals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Verdict
from massprop_drake.results.detections import (
    JUMP,
    DetectionRecord,
    bound_jump_times,
    fault_mode,
    finalize_detections,
    in_words,
    note_mass_before_jumps,
    onset_in_words,
    update_detections,
)
from massprop_drake.results.events import list_events

SI = {"force": "N", "mass": "kg", "length": "m"}
JET = DetectionRecord(10.0, 11.0, "jet_on", 3, "T7", "jet", 0.05, 0.0012, 50.0, 2, jets=("T7",), thrust=1.0)
PAYLOAD = DetectionRecord(10.0, 11.0, JUMP, None, None, None, None, None, 50.0, 2)
STUCK_ON = DetectionRecord(50.0, 50.16, "jet_on", 12, "R4R", "jet", 868.0, 2.0, 1.0e4, 3, jet_index=28)


def detection_entries(vehicle: Vehicle, time_s: Any, signals: Any, earlier: Any = ()) -> list[DetectionRecord]:
    return update_detections(vehicle, list_events(vehicle, vehicle.sensor_names(), time_s, signals), earlier)


def force(magnitude: float, std: float = 0.0012, **more: Any) -> DetectionRecord:
    return JET._replace(magnitude=magnitude, magnitude_std=std, **more)


@pytest.mark.parametrize(
    ("record", "mode", "words"),
    [
        (JET, "leak", "jet T7: leaks 0.0500 N, 5 % of its thrust"),
        (force(0.004, 0.001), "leak", "jet T7: leaks 0.0040 N, 0.4 % of its thrust"),
        (force(0.85, 0.04), "leak", "jet T7: leaks 0.850 N, 85 % of its thrust"),
        (force(0.85, 0.06), "stuck_on", "jet T7: stuck on"),  # within 3 sigma of all
        (force(0.91, 0.001), "stuck_on", "jet T7: stuck on"),  # above 90 %
        (force(-0.05), "loss", "jet T7: loses 0.0500 N, 5 % of its thrust"),
        (force(-0.5, jet=None, jets=()), "loss", "a jet of cluster 3: loses 0.5000 N, 50 % of its thrust"),
        (force(-0.999), "stuck_off", "jet T7: stuck off"),
        (JET._replace(pattern="intermittent", erratic_s=12.0), "intermittent", "jet T7: intermittent"),
        (JET._replace(pattern="drifting", erratic_s=12.0), "drift", "jet T7: drifts"),
        (force(0.05, isolated_to="group", jet=None, jets=("T7", "T8")), "leak",
         "one of T7, T8: leaks 0.0500 N, 5 % of its thrust"),
        (JET._replace(thrust=None), None, "jet T7: on"),
        (PAYLOAD, None, "mass property jump"),
        (PAYLOAD._replace(mass=-53.0, mass_std=2.0), "release", "payload released"),
        (PAYLOAD._replace(mass=53.0, mass_std=2.0), "docking", "payload docked"),
        (PAYLOAD._replace(mass=5.0, mass_std=2.0), None, "mass property jump"),
        (PAYLOAD._replace(mass=0.0, mass_std=0.0), None, "mass property jump"),
    ],
)  # fmt: skip
def test_a_fault_is_called_what_its_size_is(record: DetectionRecord, mode: str | None, words: str) -> None:
    assert fault_mode(record) == mode
    assert in_words(record._replace(mode=mode), SI) == words


def signals(n_rows: int, **rows: dict[int, float]) -> dict[str, Any]:
    """Signals of a detector that are zero but at some rows."""
    found = {name: np.zeros((n_rows, 1)) for name in (*STATUS, "rotation_nis")}
    for name, values in rows.items():
        for row, value in values.items():
            found[name][row] = value
    return found


@pytest.mark.parametrize(
    ("magnitude", "std", "kind", "mode"),
    [
        (10.0, 1.0, "jet_on", "leak"),
        (870.0, 1.0, "jet_on", "stuck_on"),
        (-800.0, 1.0, "jet_off", "stuck_off"),  # above 90 % of 870
        (-700.0, 60.0, "jet_off", "stuck_off"),  # within 3 sigma of it
        (-700.0, 50.0, "jet_degraded", "loss"),
    ],
)
def test_a_declaration_becomes_a_record(orbiter: Vehicle, magnitude: float, std: float, kind: str, mode: str) -> None:
    jet = orbiter.jet_index("R4R")
    thrust = orbiter.jets[jet].thrust
    given = {"suspected_magnitude": magnitude, "suspected_magnitude_std": std, "suspected_likelihood": 77.0}
    row = {
        "detector_event": float(Verdict.DECLARED),
        "suspected_jet": float(jet),
        **given,
        "onset": 0.04,
        "alarms": 2.0,
    }
    time_s = np.array([0.0, 0.08, 0.16])
    alone = signals(3, jet_isolated={1: 1.0}, **{name: {1: value} for name, value in row.items()})
    (record,) = detection_entries(orbiter, time_s, alone)
    more = {"jets": ("R4R",), "thrust": thrust, "mode": mode, "jet_index": jet}
    assert thrust == pytest.approx(870.0, abs=2.0)
    assert record == DetectionRecord(0.04, 0.08, kind, 12, "R4R", "jet", magnitude, std, 77.0, 2, **more)
    (record,) = detection_entries(orbiter, time_s, {**alone, "jet_isolated": np.zeros((3, 1))})
    assert (record.cluster, record.jet, record.isolated_to, record.jet_index) == (12, None, "cluster", 28)


def test_jumps_and_withdrawals_become_records(orbiter: Vehicle) -> None:
    jumped = signals(2, detector_event={1: float(Verdict.JUMP)}, rotation_nis={1: 99.0}, alarms={1: 4.0})
    (record,) = detection_entries(orbiter, np.array([0.0, 0.08]), jumped)
    assert record == DetectionRecord(0.0, 0.08, JUMP, None, None, None, None, None, 99.0, 4)
    other, before = STUCK_ON._replace(jet="F2R", jet_index=3), STUCK_ON._replace(withdrawn_s=51.0)
    withdrawn = signals(2, detector_event={1: float(Verdict.WITHDRAWN)}, suspected_jet={1: 28.0})
    records = detection_entries(orbiter, np.array([52.0, 52.08]), withdrawn, (before, other, STUCK_ON))
    assert records == [before, other, STUCK_ON._replace(withdrawn_s=52.08)]  # the one that stands
    assert detection_entries(orbiter, np.zeros(2), {}, (STUCK_ON,)) == [STUCK_ON]  # without a detector


def test_the_force_of_a_jet_stuck_on_is_given_as_known_at_the_end() -> None:
    known, variance = np.zeros(44), np.zeros(44)
    known[28], variance[28] = 870.5, 0.25
    off = STUCK_ON._replace(kind="jet_off", magnitude=-870.0)
    jump = STUCK_ON._replace(kind=JUMP, jet_index=None)
    withdrawn = STUCK_ON._replace(withdrawn_s=51.0)  # keeps what it had while it stood
    found = finalize_detections((STUCK_ON, off, jump, withdrawn), known, variance)
    assert [one.magnitude for one in found] == [870.5, -870.0, jump.magnitude, 868.0]
    assert found[0].magnitude_std == 0.5
    assert {record.jet_index for record in found} == {None}
    (unknown,) = finalize_detections((STUCK_ON,), known, np.zeros(44))
    assert unknown.magnitude == 868.0


def test_a_jump_is_as_large_as_the_mass_before_and_after_differ(orbiter: Vehicle) -> None:
    """Two payloads in a row, of 5 and of 20, on a mass of 100; what a method has measured itself stays."""
    later = PAYLOAD._replace(time_s=21.0)
    time_s, reciprocal = np.array([10.0, 11.0, 20.0, 21.0]), 1.0 / np.array([100.0, 104.0, 105.0, 120.0])
    deviation = np.array([1e-4, 2e-4, 1e-4, 1e-4])
    found = note_mass_before_jumps([PAYLOAD, later, JET._replace(time_s=11.0)], time_s, reciprocal, deviation)
    assert [one.before for one in found] == [(reciprocal[0], 1e-4), (reciprocal[2], 1e-4), None]
    first, second, jet = finalize_detections(found, np.zeros(44), np.zeros(44), 1.0 / 125.0, 1e-4)
    assert (first.mass, second.mass, jet.mass) == (pytest.approx(5.0), pytest.approx(20.0), None)
    assert first.mass_std == pytest.approx(np.hypot(1.0, 1.1025))  # 1e-4 m^2, before and after
    assert (first.mode, second.mode) == ("docking", "docking")
    unknown = np.array([np.nan, *reciprocal[1:]])
    (at_once, blind) = (note_mass_before_jumps([PAYLOAD], *given, deviation)[0] for given in
                        ((time_s + 1.0, reciprocal), (time_s, unknown)))  # fmt: skip
    assert (at_once.before, blind.before) == (None, None)


TIME_S = np.arange(40) * 0.5
STEPS = {"gyro": 0.1}


def jump(onset_s: float, time_s: float = 18.0) -> DetectionRecord:
    return PAYLOAD._replace(onset_s=onset_s, time_s=time_s)


def blocks(fired: list[int], alarms: list[int], moved: int | None = None, *, rows: int = 7) -> Iterator[dict[str, Any]]:
    """Commands of two jets in the intervals after some rows, alarms at some, and a gyro that moves once."""
    command, gyro, alarm = np.zeros((40, 2)), np.zeros((40, 3)), np.zeros((40, 1))
    command[fired, 1], alarm[alarms] = 1.0, 1.0
    if moved is not None:
        gyro[moved:, 2] = 1.0
    whole = {"time_s": TIME_S, "command": command, "gyro": gyro, "alarm": alarm}
    for first in range(0, TIME_S.size, rows):
        yield {name: values[first : first + rows] for name, values in whole.items()}


@pytest.mark.parametrize("rows", [1, 7, 40])
def test_nothing_tells_the_moment_from_the_last_firing_to_the_next_alarm(rows: int) -> None:
    found = bound_jump_times([jump(9.0), jump(12.0)], blocks([4, 6, 20, 30], [8, 21, 22, 31], rows=rows), STEPS)
    assert [(one.earliest_s, one.latest_s) for one in found] == [(3.5, 10.5), (10.5, 15.5)]
    assert onset_in_words(found[0]) == "begun between 3.50 and 10.50 s"


@pytest.mark.parametrize(
    ("record", "fired", "alarms", "moved", "within"),
    [
        (jump(9.0), [17, 18, 19], [20], None, (9.0, 10.0)),  # while something acts it was after the comparison begins
        (jump(9.0), [4], [20], 18, (9.0, 10.0)),
        (jump(9.0, 12.0), [], [30], None, (0.0, 12.0)),  # between the beginning and its declaration
        (jump(9.0)._replace(kind="jet_on"), [], [], None, (None, None)),
    ],
)
def test_it_lies_where_nothing_shows_it(
    record: DetectionRecord, fired: list[int], alarms: list[int], moved: int | None, within: tuple[float, float]
) -> None:
    (found,) = bound_jump_times([record], blocks(fired, alarms, moved), STEPS)
    assert (found.earliest_s, found.latest_s) == within
