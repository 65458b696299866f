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
CGLR = "detector={kind: cglr}"
CUSUM = "detector={kind: cusum}"
JOINT = ["estimation={filter: joint, start: nominal}", "mass={}", "rotation={}", "detector={kind: hypotheses}"]


def case(*overrides: str) -> Scenario:
    return load_scenario("sample_maneuver", list(overrides))


def number(jet: str) -> int:
    return case().vehicle_data.designations.index(jet)


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


def taken(scenario: Scenario, signals: dict[str, Any], *events: EventRecord, block: int = 7) -> Suspicions:
    """All of the signals, in blocks that end anywhere."""
    found = Suspicions(scenario)
    time_s = PERIOD_S * np.arange(len(signals["tested"]))
    for first in range(0, time_s.size, block):
        part = slice(first, first + block)
        said = [event for event in events if time_s[part][0] <= event.time_s <= time_s[part][-1]]
        found.add(time_s[part], {name: values[part] for name, values in signals.items()}, said)
    return found


def test_two_jets_alike_in_every_sample_do_not_stay_silent() -> None:
    """As F3F stuck off: far beyond any threshold, and never six ahead of its neighbor."""
    signals = suspected(quiet(40), slice(10, 30), F3F=16500.0, F1F=16498.0, F2F=200.0)
    (found,) = taken(case(CGLR), signals).found()
    assert found.jets == ("F3F", "F1F")
    assert found.statistic == pytest.approx(20 * 16500.0)
    assert (found.time_s, found.until_s, found.samples) == (10 * PERIOD_S, pytest.approx(29 * PERIOD_S), 20)
    assert "single samples do not tell which" in found.reason
    assert in_words(found).startswith("F3F or F1F, 0.80 to 2.32 s, 20 samples, statistic 3.3e+05: some jet has failed")


def test_what_more_samples_tell_apart_is_told_apart() -> None:
    signals = suspected(quiet(40), slice(0, 20), F3F=100.0, F1F=98.0)
    suspected(signals, slice(20, 40), F3F=100.0, F1F=80.0)
    (found,) = taken(case(CGLR), signals).found()
    assert found.jets == ("F3F",)


def test_a_sample_that_no_jet_explains_is_of_no_jet() -> None:
    signals = suspected(quiet(10), slice(3, 5), F3F=16500.0)
    signals["unexplained"][:] = 1000.0
    assert taken(case(CGLR), signals).found() == ()


def test_alarms_that_were_declared_are_not_listed() -> None:
    signals = suspected(quiet(20), slice(5, 20), R4R=1e4)
    signals["alarm"][5:20] = 1.0
    signals["detector_event"][7] = 1.0
    declared = EventRecord(float(7 * PERIOD_S), "failed", 0.4, ("R4R",), 12, jet_index=number("R4R"))
    assert taken(case(CGLR), signals, declared).found() == ()
    (found,) = taken(case("detector={kind: cglr, reconfigure_after: null}"), {**signals}).found()
    assert (found.jets, found.reason) == (("R4R",), "15 alarms; this scenario declares none")


def test_a_sum_that_nearly_reached_the_threshold() -> None:
    signals = suspected(quiet(20), slice(5, 9), L4D=13.0, L2D=12.0)
    suspected(signals, slice(9, 12), L4D=9.0)
    (found,) = taken(case(CUSUM), signals).found()
    assert (found.jets, found.statistic) == (("L4D", "L2D"), 13.0)
    assert found.reason == "the sum stayed below the 20 that declare a failure"


def probable(rows: int, **jets: dict[int, float]) -> dict[str, Any]:
    """Signals of the detector by hypotheses: probabilities of jets, by the row from which on each holds."""
    signals = quiet(rows)
    signals["fault_probability"] = np.zeros((rows, N))
    for jet, since in jets.items():
        for row, probability in since.items():
            signals["fault_probability"][row:, number(jet)] = probability
    return signals


def hypotheses() -> Scenario:
    return load_scenario("sample_maneuver", JOINT)


def test_a_jet_that_was_probable_and_never_declared_is_suspected() -> None:
    signals = probable(30, L4D={5: 0.4, 8: 0.6, 12: 0.98, 20: 0.7, 25: 0.5}, L2D={8: 0.3})
    (found,) = taken(hypotheses(), signals).found()
    assert (found.jets, found.statistic, found.samples) == (("L4D",), 0.98, 17)
    assert (found.time_s, found.until_s) == (pytest.approx(8 * PERIOD_S), pytest.approx(24 * PERIOD_S))
    assert found.reason == "its probability never exceeded what a declaration needs"
    assert in_words(found).startswith("L4D, 0.64 to 1.92 s, 17 samples, statistic 0.98: its probability")


def test_jets_between_which_the_probability_moves_look_alike() -> None:
    signals = probable(30, L4D={5: 0.6, 10: 0.3, 20: 0.65, 25: 0.2}, L2D={10: 0.7, 20: 0.3, 25: 0.4})
    (found,) = taken(hypotheses(), signals).found()
    assert (found.jets, found.statistic, found.samples) == (("L2D", "L4D"), 0.7, 20)
    assert found.reason == "these look alike"


def test_two_jets_that_have_both_failed_do_not_look_alike() -> None:
    together = taken(hypotheses(), probable(30, L4D={5: 0.9}, F1U={5: 0.8})).found()
    assert [one.jets for one in together] == [("L4D",), ("F1U",)]
    later = taken(hypotheses(), probable(30, L4D={5: 0.9, 10: 0.001}, F1U={20: 0.8})).found()  # of something else
    assert [one.jets for one in later] == [("L4D",), ("F1U",)]


def test_a_declaration_takes_its_jet_from_the_suspicions() -> None:
    signals = probable(30, L4D={5: 0.6, 10: 0.999999})
    signals["detector_event"][11] = 1.0
    named = EventRecord(float(11 * PERIOD_S), "failed", 0.4, ("L4D",), 10, jet_index=number("L4D"))
    assert taken(hypotheses(), signals, named).found() == ()
    (other,) = taken(hypotheses(), signals, named._replace(jets=("L2D",), jet_index=number("L2D"))).found()
    assert other.jets == ("L4D",)


def pose() -> Scenario:
    return load_scenario("air_bearing_pulses")


def raced(racing: slice, leads: slice, **jets: float) -> dict[str, Any]:
    """Signals of the detector by thrust factors: when hypotheses are compared, and leads of jets, nats."""
    names, signals = pose().vehicle_data.designations, quiet(20)
    signals |= {name: np.zeros((20, len(names))) for name in ("likelihood", "command")}
    signals["likelihood"][:] = np.nan
    signals["racing"][racing] = 1.0
    for jet, lead in jets.items():
        signals["likelihood"][leads, names.index(jet)] = lead
    return signals


@pytest.mark.parametrize(("end", "reason"), [(20, "still compared at the end"), (15, "none that is large enough")])
def test_a_comparison_that_decided_nothing(end: int, reason: str) -> None:
    signals = raced(slice(8, end), slice(10, end), T1=40.0, T2=36.0, T3=20.0)
    (found,) = taken(pose(), signals).found()
    assert (found.jets, found.statistic, found.samples) == (("T1", "T2"), 40.0, end - 8)
    assert reason in found.reason


@pytest.mark.parametrize("lead", [5.0, 40.0])
def test_a_comparison_that_ends_in_a_word(lead: float) -> None:
    """Of a jet that is declared nothing is unconfirmed; what nothing explains is, whatever led."""
    signals = raced(slice(8, 12), slice(8, 12), T1=lead)
    signals["detector_event"][11] = 4.0
    now_s = float(11 * PERIOD_S)
    named = EventRecord(now_s, "failed", 0.5, ("T1",), 1, jet_index=0)
    assert taken(pose(), signals, named).found() == ()
    assert taken(pose(), signals, named._replace(kind="withdrawn")).found() == ()
    (found,) = taken(pose(), signals, EventRecord(now_s, "unexplained", 0.5)).found()
    assert found.jets == (("T1",) if lead > 12.0 else ())
    assert "explains the readings" in found.reason


def test_jets_that_nothing_could_have_shown() -> None:
    signals = quiet(20)
    signals["command"][3:9] = 1.0
    signals["command"][:, number("R1U")] = 0.0
    signals["command"][:, number("F1U")] = np.arange(20) == 12
    signals["tested"][:9] = 0.0
    signals["tested"][5:7] = 1.0
    untested = taken(case(CGLR), signals).untested()
    assert [one.jets for one in untested] == [("R1U",), ("F1U",)]
    assert [one.jets for one in taken(case(CGLR), signals).untested(["R1U", None])] == [("F1U",)]  # it is known
    assert untested[0].reason.startswith("never commanded")
    assert untested[1].reason.startswith("commanded, but in fewer than 2 of the samples")
    assert taken(case("detector={kind: off}"), signals).untested() == ()


def test_a_record_in_two_parts_counts_as_one() -> None:
    first = suspected(quiet(20), slice(5, 15), F3F=16500.0, F1F=16498.0)
    first["command"][3:9] = 1.0
    part = taken(case(CGLR), first)
    again = Suspicions(case(CGLR), part.found(), part.counts)
    again.add(10.0 + PERIOD_S * np.arange(3), quiet(3), ())
    assert again.found() == part.found()
    assert again.untested() == part.untested() == ()
