"""What was suspected and never declared, and what nothing could have shown, from signals made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from massprop_drake import Scenario, load_scenario
from massprop_drake.results.events import EventRecord
from massprop_drake.results.unconfirmed import Suspicions, in_words

N = 44
PERIOD_S = 0.08


def case(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", list(overrides))


CGLR = case("detector={kind: cglr}")
HYPOTHESES = case("estimation={filter: joint, start: nominal}", "mass={}", "rotation={}", "detector={kind: hypotheses}")
POSE = load_scenario("air_bearing_pulses")
number = CGLR.vehicle_data.jet_index


def quiet(rows: int) -> dict[str, Any]:
    """Tested samples in which nothing is suspected, and no jet is told to fire."""
    names = ("alarm", "detector_event", "suspected_likelihood", "unexplained", "racing")
    signals = {name: np.zeros((rows, 1)) for name in names}
    return {**signals, "tested": np.ones((rows, 1)), "likelihood": np.zeros((rows, N)), "command": np.zeros((rows, N))}


def suspected(signals: dict[str, Any], rows: slice, **arguments: float) -> dict[str, Any]:
    """The signals with likelihood arguments of jets in some rows."""
    for jet, argument in arguments.items():
        signals["likelihood"][rows, number(jet)] = argument
    signals["suspected_likelihood"][rows] = max(arguments.values())
    return signals


def probable(rows: int, **jets: dict[int, float]) -> dict[str, Any]:
    """Signals of the detector by hypotheses: probabilities of jets, by the row from which on each holds."""
    signals = {**quiet(rows), "fault_probability": np.zeros((rows, N))}
    for jet, since in jets.items():
        for row, probability in since.items():
            signals["fault_probability"][row:, number(jet)] = probability
    return signals


def compared(racing: slice, leads: slice, **jets: float) -> dict[str, Any]:
    """Signals of the detector by thrust factors: when hypotheses are compared, and leads of jets, nats."""
    names, signals = POSE.vehicle_data.designations, quiet(20)
    signals |= {"likelihood": np.full((20, len(names)), np.nan), "command": np.zeros((20, len(names)))}
    signals["racing"][racing] = 1.0
    for jet, lead in jets.items():
        signals["likelihood"][leads, names.index(jet)] = lead
    return signals


def taken(scenario: Scenario, signals: dict[str, Any], *events: EventRecord) -> Suspicions:
    """All of the signals, in blocks that end anywhere."""
    found = Suspicions(scenario)
    time_s = PERIOD_S * np.arange(len(signals["tested"]))
    for first in range(0, time_s.size, 7):
        part = slice(first, first + 7)
        said = [event for event in events if time_s[part][0] <= event.time_s <= time_s[part][-1]]
        found.add(time_s[part], {name: values[part] for name, values in signals.items()}, said)
    return found


def event(row: int, kind: str, *jets: str, jet: int | None = None) -> EventRecord:
    return EventRecord(row * PERIOD_S, kind, 0.4, jets, 12, jet_index=number(jets[0]) if jet is None and jets else jet)


def test_two_jets_alike_in_every_sample_do_not_stay_silent() -> None:
    """As F3F stuck off: far beyond any threshold, and never six ahead of its neighbor."""
    signals = suspected(quiet(40), slice(10, 30), F3F=16500.0, F1F=16498.0, F2F=200.0)
    (found,) = taken(CGLR, signals).list_records()
    assert (found.jets, found.samples) == (("F3F", "F1F"), 20)
    assert found.statistic == pytest.approx(20 * 16500.0)
    assert (found.time_s, found.until_s) == (10 * PERIOD_S, pytest.approx(29 * PERIOD_S))
    assert "single samples do not tell which" in found.reason
    assert in_words(found).startswith("F3F or F1F, 0.80 to 2.32 s, 20 samples, statistic 3.3e+05: some jet has failed")
    apart = suspected(quiet(40), slice(0, 20), F3F=100.0, F1F=98.0)
    (found,) = taken(CGLR, suspected(apart, slice(20, 40), F3F=100.0, F1F=80.0)).list_records()
    assert found.jets == ("F3F",)  # more samples tell them apart
    signals["unexplained"][:] = 1e6  # of no jet
    assert taken(CGLR, signals).list_records() == ()


def test_alarms_that_were_declared_are_not_listed() -> None:
    signals = suspected(quiet(20), slice(5, 20), R4R=1e4)
    signals["alarm"][5:20] = 1.0
    signals["detector_event"][7] = 1.0
    assert taken(CGLR, signals, event(7, "failed", "R4R")).list_records() == ()
    (found,) = taken(case("detector={kind: cglr, reconfigure_after: null}"), signals).list_records()
    assert (found.jets, found.reason) == (("R4R",), "15 alarms; this scenario declares none")


def test_a_sum_that_nearly_reached_the_threshold() -> None:
    signals = suspected(quiet(20), slice(5, 9), L4D=13.0, L2D=12.0)
    (found,) = taken(case("detector={kind: cusum}"), suspected(signals, slice(9, 12), L4D=9.0)).list_records()
    assert (found.jets, found.statistic) == (("L4D", "L2D"), 13.0)
    assert found.reason == "the sum stayed below the 20 that declare a failure"


@pytest.mark.parametrize(
    ("jets", "expected"),
    [
        ({"L4D": {5: 0.4, 8: 0.6, 12: 0.98, 20: 0.7, 25: 0.5}, "L2D": {8: 0.3}}, [(("L4D",), 0.98, 17)]),
        # between these the probability moves: they look alike
        (
            {"L4D": {5: 0.6, 10: 0.3, 20: 0.65, 25: 0.2}, "L2D": {10: 0.7, 20: 0.3, 25: 0.4}},
            [(("L2D", "L4D"), 0.7, 20)],
        ),
        ({"L4D": {5: 0.9}, "F1U": {5: 0.8}}, [(("L4D",), 0.9, 25), (("F1U",), 0.8, 25)]),  # both have failed
        ({"L4D": {5: 0.9, 10: 0.001}, "F1U": {20: 0.8}}, [(("L4D",), 0.9, 5), (("F1U",), 0.8, 10)]),
    ],
)
def test_jets_that_were_probable_and_never_declared_are_suspected(jets: dict[str, Any], expected: list[Any]) -> None:
    found = taken(HYPOTHESES, probable(30, **jets)).list_records()
    assert [(one.jets, one.statistic, one.samples) for one in found] == expected
    alike = [one.reason == "these look alike" for one in found]
    assert alike == [len(one.jets) == 2 for one in found]


def test_a_declaration_takes_its_jet_from_the_suspicions() -> None:
    signals = probable(30, L4D={5: 0.6, 10: 0.999999})
    signals["detector_event"][11] = 1.0
    assert taken(HYPOTHESES, signals, event(11, "failed", "L4D")).list_records() == ()
    (other,) = taken(HYPOTHESES, signals, event(11, "failed", "L2D")).list_records()
    assert other.jets == ("L4D",)


@pytest.mark.parametrize(("end", "reason"), [(20, "still compared at the end"), (15, "none that is large enough")])
def test_a_comparison_that_decided_nothing(end: int, reason: str) -> None:
    (found,) = taken(POSE, compared(slice(8, end), slice(10, end), T1=40.0, T2=36.0, T3=20.0)).list_records()
    assert (found.jets, found.statistic, found.samples) == (("T1", "T2"), 40.0, end - 8)
    assert reason in found.reason


@pytest.mark.parametrize("lead", [5.0, 40.0])
def test_a_comparison_that_ends_in_a_word(lead: float) -> None:
    """Of a jet that is declared nothing is unconfirmed; what nothing explains is, whatever led."""
    signals = compared(slice(8, 12), slice(8, 12), T1=lead)
    signals["detector_event"][11] = 4.0
    for kind in ("failed", "withdrawn"):
        assert taken(POSE, signals, event(11, kind, "T1", jet=0)).list_records() == ()
    (found,) = taken(POSE, signals, event(11, "unexplained")).list_records()
    assert found.jets == (("T1",) if lead > 12.0 else ())
    assert "explains the readings" in found.reason


def test_jets_that_nothing_could_have_shown() -> None:
    signals = quiet(20)
    signals["command"][3:9] = 1.0
    signals["command"][:, number("R1U")] = 0.0
    signals["command"][:, number("F1U")] = np.arange(20) == 12
    signals["tested"][:9] = 0.0
    signals["tested"][5:7] = 1.0
    untested = taken(CGLR, signals).untested()
    assert [one.jets for one in untested] == [("R1U",), ("F1U",)]
    assert [one.jets for one in taken(CGLR, signals).untested(["R1U", None])] == [("F1U",)]  # it is known
    assert untested[0].reason.startswith("never commanded")
    assert untested[1].reason.startswith("commanded, but in fewer than 2 of the samples")
    assert taken(case("detector={kind: off}"), signals).untested() == ()


def test_a_record_in_two_parts_counts_as_one() -> None:
    first = suspected(quiet(20), slice(5, 15), F3F=16500.0, F1F=16498.0)
    first["command"][3:9] = 1.0
    part = taken(CGLR, first)
    again = Suspicions(CGLR, part.list_records(), part.counts)
    again.add(10.0 + PERIOD_S * np.arange(3), quiet(3), ())
    assert again.list_records() == part.list_records()
    assert again.untested() == part.untested() == ()
