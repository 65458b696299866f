"""What the hypothesis filter declares, as it is logged and as a run records it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from odds_probe import odds

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Verdict
from massprop_drake.maths.estimation.faults.declarations import (
    Declaration,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.faults.fault_report import hypothesis_report_row, no_fault_odds, status_row
from massprop_drake.maths.estimation.joint.separation import Separation
from massprop_drake.results.detections import DetectionRecord, remarks, size_in_words, update_detections
from massprop_drake.results.events import EventRecord, in_words, list_events

N = 44
NOWHERE = np.full(3, np.nan)
LEAK = JetsDeclared(Word.FAILED, (3,), (1,), (10.0,), (0.1,), 4.0)
LOSS = JetsDeclared(Word.FAILED, (28,), (-1,), (870.0,), (2.0,), 4.0)
ALIKE = JetsDeclared(Word.GROUP, (30, 29), (-1, -1), (870.0, 868.0), (1.0, 1.0), 4.0, Separation(30))


def signals_of(*samples: tuple[Declaration, ...]) -> dict[str, Any]:
    """A log with a row for what is said at each sample."""
    rows: dict[str, list[Any]] = {}
    for declared in samples:
        status = status_row(declared, no_fault_odds(N), tested=True, statistic=0.0)
        own = hypothesis_report_row(declared, no_fault_odds(N))
        for name, value in {**status._asdict(), **own._asdict()}.items():
            rows.setdefault(name, []).append(np.atleast_1d(value))
    assert set(STATUS) < set(rows)
    return {name: np.array(values, dtype=float) for name, values in rows.items()}


def recorded(vehicle: Vehicle, *samples: tuple[Declaration, ...]) -> list[DetectionRecord]:
    return update_detections(vehicle, heard(vehicle, *samples))


def heard(vehicle: Vehicle, *samples: tuple[Declaration, ...]) -> list[EventRecord]:
    return list_events(vehicle, vehicle.sensor_names(), 5.0 + np.arange(len(samples)), signals_of(*samples))


def of_jet(word: Word, force: float) -> JetsDeclared:
    return JetsDeclared(word, (3,), (1,), (force,), (0.1,), 4.0)


def test_jets_and_groups_of_one_sample_are_records_of_their_own(orbiter: Vehicle) -> None:
    """Groups share a jet; each has its own order, and what would tell it apart. What is withdrawn stays listed."""
    other = JetsDeclared(
        Word.GROUP, (12, 29, 7), (1, 1, 1), (9.0, 8.0, 7.0), (1.0,) * 3, 4.5, Separation(coasting_s=6.0)
    )
    well = JetsDeclared(Word.WITHDRAWN, (3,), (1,), (0.2,), (0.1,), 7.0)
    first, second, third, fourth = recorded(orbiter, (LEAK, ALIKE), (LOSS, other), (well,))
    names = orbiter.designations
    assert (first.kind, first.jet, first.jets, first.isolated_to) == ("jet_on", names[3], (names[3],), "jet")
    assert (first.onset_s, first.time_s, first.alarms, first.withdrawn_s) == (4.0, 5.0, 1, 7.0)
    assert (second.jet, second.jets, second.isolated_to) == (None, (names[30], names[29]), "group")
    assert second.suspects == f"one of {names[30]}, {names[29]}"
    assert (third.kind, third.jet, third.cluster) == ("jet_off", names[28], orbiter.jets[28].cluster)
    assert (third.magnitude, third.magnitude_std, third.withdrawn_s) == (-870.0, 2.0, None)
    assert (fourth.jets, fourth.time_s) == ((names[12], names[29], names[7]), 6.0)
    (_, event) = heard(orbiter, (LEAK, other))
    assert (event.kind, event.told_apart_by, event.told_apart_s, event.magnitude) == ("group", None, 6.0, 9.0)


@pytest.mark.parametrize(
    ("said", "event"),
    [
        (LEAK, Verdict.DECLARED),
        (ALIKE, Verdict.DECLARED),
        (LEAK._replace(word=Word.WITHDRAWN), Verdict.WITHDRAWN),
        (LEAK._replace(word=Word.CHANGED), Verdict.OTHER),
        (JumpDeclared(False, 4.0, 1.0, 1.0, NOWHERE, NOWHERE), Verdict.JUMP),
        (JumpDeclared(True, 4.0, 1.0, 1.0, NOWHERE, NOWHERE), Verdict.OTHER),
        (ReadingDeclared(2, 4.0), Verdict.OTHER),
        (Unexplained(4.0), Verdict.OTHER),
    ],
)
def test_everything_that_is_said_is_an_event(said: Declaration, event: Verdict, orbiter: Vehicle) -> None:
    signals = signals_of((said,))
    assert signals["detector_event"][0, 0] == event
    assert signals["onset"][0, 0] == 4.0
    known = len(recorded(orbiter, (said,)))
    assert known == (1 if event in (Verdict.DECLARED, Verdict.JUMP) else 0)


@pytest.mark.parametrize(
    ("apart", "words"),
    [
        (Separation(30), "{1} fired alone would tell them apart"),
        (Separation(coasting_s=3.21), "3.2 s without firing would tell them apart"),
        (Separation(), "firing none of them alone, nor waiting, would tell them apart"),
    ],
)
def test_a_group_says_what_would_tell_it_apart(orbiter: Vehicle, apart: Separation, words: str) -> None:
    names = orbiter.designations
    (event,) = heard(orbiter, (ALIKE._replace(apart=apart),))
    assert signals_of((ALIKE,))["verdict_place"][0, [30, 29, 0]].tolist() == [1.0, 2.0, 0.0]
    expected = words.format(names[29], names[30])
    assert in_words(event, orbiter.unit_names) == (
        f"one of {names[30]}, {names[29]} has failed: -870.0 ± 1.0 lbf, since 4.00 s; {expected}"
    )
    (record,) = recorded(orbiter, (ALIKE._replace(apart=apart),))
    assert remarks(record) == [expected]


def test_a_false_reading_is_named_by_package_and_axis(orbiter: Vehicle) -> None:
    first, second = heard(orbiter, (ReadingDeclared(1, 4.9),), (ReadingDeclared(8, 5.9),))
    assert (first.kind, first.sensor, first.axis, first.onset_s, first.time_s) == ("false_reading", "gyro", "y", 4.9, 5)
    assert (second.sensor, second.axis) == ("acc2", "z")
    assert (
        in_words(second, orbiter.unit_names) == "acc2_z reads falsely since 5.90 s; it is left out until it fits again"
    )


@pytest.mark.parametrize(
    ("forces", "pattern", "words"),
    [
        ((10.0, 0.5, 11.0, 0.2), "intermittent", "erratic (on and off) from 8.00 s on"),
        ((10.0, 20.0, 30.0, 40.0), "drifting", "erratic (drifting) from 8.00 s on"),
    ],
)
def test_a_jet_that_changes_again_and_again(
    orbiter: Vehicle, forces: tuple[float, ...], pattern: str, words: str
) -> None:
    kinds = (Word.FAILED, Word.CHANGED, Word.CHANGED, Word.ERRATIC)
    samples = [(of_jet(word, force),) for word, force in zip(kinds, forces, strict=True)]
    assert [event.kind for event in heard(orbiter, *samples)] == ["failed", "changed", "changed", "erratic"]
    (record,) = recorded(orbiter, *samples)
    assert (record.erratic_s, record.pattern, record.magnitude) == (8.0, pattern, forces[-1])
    assert remarks(record) == [words]


def test_what_comes_back_after_it_was_withdrawn_stands_again(orbiter: Vehicle) -> None:
    well = (of_jet(Word.WITHDRAWN, 0.2),)
    (record,) = recorded(orbiter, (of_jet(Word.FAILED, 10.0),), well, (of_jet(Word.CHANGED, 9.0),))
    assert (record.withdrawn_s, record.magnitude) == (None, 9.0)


def test_a_jump_has_a_place_and_is_measured_again(orbiter: Vehicle) -> None:
    place, spread = np.array([60.0, 0.1, -3.0]), np.array([0.2, 0.1, 0.3])
    found = JumpDeclared(False, 4.0, 480.0, 60.0, NOWHERE, NOWHERE)
    measured = JumpDeclared(True, 4.0, 501.0, 3.0, place, spread)
    first, second = heard(orbiter, (found,), (), (measured,))
    assert (first.kind, second.kind, second.onset_s, second.time_s) == ("jump", "jump_measured", 4.0, 7.0)
    (record,) = recorded(orbiter, (found,), (), (measured,))
    assert (record.position, record.measured_s, record.time_s) == ((60.0, 0.1, -3.0), 7.0, 5.0)
    where = "(+60.00 ± 0.20, +0.10 ± 0.10, -3.00 ± 0.30) ft"
    assert size_in_words(record, orbiter.unit_names) == f"+501.0 ± 3.0 slug at {where}"
    assert in_words(second, orbiter.unit_names) == (
        f"the jump of the mass properties, seen after 4.00 s: +501.0 ± 3.0 slug at {where}"
    )


def test_a_jet_that_is_likelier_than_not_raises_an_alarm_before_it_is_declared() -> None:
    for probability, alarm in ((0.4, 0.0), (0.6, 1.0)):
        row = status_row((), odds(N, {7: probability, 3: 0.1}), tested=True, statistic=30.0)
        assert (row.alarm, row.detector_event, row.suspected_likelihood) == (alarm, Verdict.NOTHING, 30.0)
        assert (
            np.isnan(row.suspected_jet) if alarm == 0.0 else (row.suspected_jet, row.suspected_magnitude) == (7, 10.0)
        )
