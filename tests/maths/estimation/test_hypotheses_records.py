"""What the detector by hypotheses says, as it is logged and as a run records it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from detector_probe import detector_params

from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Event
from massprop_drake.maths.estimation.detectors import hypotheses
from massprop_drake.maths.estimation.detectors.multi_hypothesis import (
    Declaration,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Status,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.joint.apart import Apart
from massprop_drake.maths.estimation.joint.cycle import initial as initial_filter
from massprop_drake.results.detections import DetectionRecord, detection_entries

N = 44
NOWHERE = np.full(3, np.nan)
PAIR = JetsDeclared(Word.FAILED, (3, 28), (1, -1), (10.0, 870.0), (0.1, 2.0), 4.0)
ALIKE = JetsDeclared(Word.GROUP, (30, 29), (-1, -1), (870.0, 868.0), (1.0, 1.0), 4.0, Apart(30))


def signals_of(*samples: tuple[Declaration, ...]) -> dict[str, Any]:
    """A log with a row for what is said at each sample."""
    rows: dict[str, list[Any]] = {}
    for said in samples:
        status = hypotheses._status(said, Status(), True, 3)
        own = hypotheses._own(said, Status(), N)
        for name, value in {**status._asdict(), **own._asdict()}.items():
            rows.setdefault(name, []).append(np.atleast_1d(value))
    assert set(STATUS) < set(rows)
    return {name: np.array(values, dtype=float) for name, values in rows.items()}


def recorded(vehicle: Vehicle, *samples: tuple[Declaration, ...]) -> list[DetectionRecord]:
    return detection_entries(vehicle, 5.0 + np.arange(len(samples)), signals_of(*samples))


def test_two_jets_that_fail_at_once_are_two_records(orbiter: Vehicle) -> None:
    first, second = recorded(orbiter, (PAIR,))
    names = orbiter.designations
    assert (first.kind, first.jet, first.jets, first.isolated_to) == ("jet_on", names[3], (names[3],), "jet")
    assert (second.kind, second.jet, second.cluster) == ("jet_off", names[28], orbiter.jets[28].cluster)
    assert (first.magnitude, second.magnitude, second.magnitude_std) == (10.0, -870.0, 2.0)
    assert (first.onset_s, first.time_s, first.alarms) == (4.0, 5.0, 3)


def test_a_group_is_one_record_with_its_members_likeliest_first(orbiter: Vehicle) -> None:
    (said,) = recorded(orbiter, (), (ALIKE,))
    names = orbiter.designations
    assert (said.jet, said.jets, said.isolated_to) == (None, (names[30], names[29]), "group")
    assert said.suspects == f"one of {names[30]}, {names[29]}"
    assert said.time_s == 6.0


def test_what_is_withdrawn_stays_listed(orbiter: Vehicle) -> None:
    nothing = JetsDeclared(Word.WITHDRAWN, (3,), (1,), (0.2,), (0.1,), 7.0)
    first, second = recorded(orbiter, (PAIR,), (), (nothing,))
    assert (first.withdrawn_s, second.withdrawn_s) == (7.0, None)


def test_a_jump_gets_its_mass_when_it_is_known(orbiter: Vehicle) -> None:
    found = JumpDeclared(False, 4.0, -20.0, 900.0, NOWHERE, NOWHERE)
    size = JumpDeclared(True, 4.0, -1003.0, 12.0, NOWHERE, NOWHERE)
    (early,) = recorded(orbiter, (found,))
    assert (early.kind, early.mass, early.onset_s) == ("mass_property_jump", None, 4.0)
    (late,) = recorded(orbiter, (found,), (size,))
    assert (late.time_s, late.mass, late.mass_std) == (5.0, -1003.0, 12.0)


@pytest.mark.parametrize(
    ("said", "event"),
    [
        (PAIR, Event.DECLARED),
        (ALIKE, Event.DECLARED),
        (PAIR._replace(word=Word.WITHDRAWN), Event.WITHDRAWN),
        (PAIR._replace(word=Word.CHANGED), Event.OTHER),
        (JumpDeclared(False, 4.0, 1.0, 1.0, NOWHERE, NOWHERE), Event.JUMP),
        (JumpDeclared(True, 4.0, 1.0, 1.0, NOWHERE, NOWHERE), Event.OTHER),
        (ReadingDeclared(2, 4.0), Event.OTHER),
        (Unexplained(4.0), Event.OTHER),
    ],
)
def test_everything_that_is_said_is_an_event(said: Declaration, event: Event, orbiter: Vehicle) -> None:
    signals = signals_of((said,))
    assert signals["detector_event"][0, 0] == event
    assert signals["onset"][0, 0] == 4.0
    known = len(detection_entries(orbiter, np.zeros(1), signals))
    assert known == (2 if said is PAIR else 1 if event in (Event.DECLARED, Event.JUMP) else 0)


def test_jets_that_are_named_alone_are_out_of_use_until_they_are_well() -> None:
    out = hypotheses._removed(np.zeros(N), (ALIKE, PAIR))
    assert np.flatnonzero(out).tolist() == [3, 28]
    changed = PAIR._replace(word=Word.CHANGED)
    np.testing.assert_array_equal(hypotheses._removed(out, (changed,)), out)
    well = JetsDeclared(Word.WITHDRAWN, (3,), (1,), (0.0,), (0.1,), 4.0)
    assert np.flatnonzero(hypotheses._removed(out, (well,))).tolist() == [28]


def test_a_kept_state_has_a_jump_that_is_not_measured_yet(orbiter: Vehicle) -> None:
    params = detector_params(orbiter, dispersed=False)
    state = hypotheses.initial(params)
    earlier = initial_filter(params.joint)._replace(time_s=7.0, firing_count=3.0, guarded=True)
    state = state._replace(method=state.method._replace(cycle=9, earlier=earlier), removed=np.eye(N)[4])
    again = hypotheses.restored(hypotheses.saved(state, params), params)
    assert again.method.earlier is not None
    np.testing.assert_array_equal(again.method.earlier.root, earlier.root)
    assert (again.method.earlier.time_s, again.method.earlier.guarded, again.method.cycle) == (7.0, True, 9)
    np.testing.assert_array_equal(again.removed, state.removed)
    assert again.method.bank.states == ()
    np.testing.assert_array_equal(hypotheses.saved(again, params), hypotheses.saved(state, params))
