"""Posterior probabilities of faults: at the end of a run, in its summary, and in words."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from odds_probe import odds

from massprop_drake import InputError, Run
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.faults.declarations import Mode
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, Odds, own_row
from massprop_drake.results.fault_probabilities import FaultProbabilities, JetProbability, at_end, rounded
from massprop_drake.results.spool import Spool
from massprop_drake.results.summary import Summary

N = 44
UNITS = {"force": "lbf"}
LEAK = JetProbability(0.97, "leak", 10.0, 0.25)


def _signals(*rows: Odds) -> Spool:
    layout = HYPOTHESIS_REPORT.sized(jets=N)
    spool = Spool()
    spool.append(layout.columns(np.vstack([layout.pack(own_row((), row)) for row in rows])))
    return spool


def test_those_at_the_end_are_listed_the_likeliest_first(orbiter: Vehicle) -> None:
    before, last = odds(N, {5: 0.9}, 0.1), odds(N, {3: 0.02, 28: 0.97, 7: 1e-4}, 0.01, 0.005)
    names = orbiter.designations
    found = at_end(orbiter, _signals(before, last))
    assert found == FaultProbabilities({names[28]: LEAK, names[3]: LEAK._replace(probability=0.02)}, 0.01, 0.005)
    assert list(found.jets) == [names[28], names[3]]


@pytest.mark.parametrize(
    ("code", "word"),
    [
        (Mode.NONE, None),
        (Mode.STUCK_ON, "stuck_on"),
        (Mode.LEAK, "leak"),
        (Mode.STUCK_OFF, "stuck_off"),
        (Mode.LOSS, "loss"),
        (Mode.DRIFTING, "drift"),
        (Mode.INTERMITTENT, "intermittent"),
    ],
)
def test_every_mode_has_its_word(orbiter: Vehicle, code: Mode, word: str | None) -> None:
    one = odds(N, {3: 0.5})
    found = at_end(orbiter, _signals(one._replace(modes=np.where(one.modes > 0.0, float(code), 0.0))))
    assert found is not None
    assert found.jets[orbiter.designations[3]].mode == word


def test_a_force_that_no_hypothesis_has_is_null(orbiter: Vehicle) -> None:
    one = odds(N, {3: 0.5})
    found = at_end(orbiter, _signals(one._replace(forces=np.full(N, np.nan))))
    assert found is not None
    assert found.jets[orbiter.designations[3]][2:] == (None, None)


def test_sums_that_rounding_carries_beyond_one_are_probabilities(orbiter: Vehicle) -> None:
    found = at_end(orbiter, _signals(odds(N, {3: 1.0 + 1e-15}, -1e-17)))
    assert found is not None
    assert (found.jets[orbiter.designations[3]].probability, found.none) == (1.0, 0.0)


def test_a_detector_that_gives_none_has_none(orbiter: Vehicle, stuck_run: Run) -> None:
    assert stuck_run.summary["fault_probability"] is None
    spool, layout = Spool(), HYPOTHESIS_REPORT.sized(jets=N)
    spool.append(layout.columns(np.full((2, layout.size), np.nan)))
    assert at_end(orbiter, spool) is None


def _summary(run: Run, content: Any) -> dict[str, Any]:
    return {**run.summary, "fault_probability": content}


def test_the_summary_has_them_by_jet_and_reads_them_back(short_run: Run) -> None:
    told = FaultProbabilities({"R4R": LEAK, "F1U": JetProbability(0.02)}, 0.01, 0.003)
    content = json.loads(json.dumps(replace(short_run.results, fault_probability=told).as_json(), allow_nan=False))
    assert content["fault_probability"] == {
        "R4R": {"probability": 0.97, "mode": "leak", "force": 10.0, "force_std": 0.25},
        "F1U": {"probability": 0.02, "mode": None, "force": None, "force_std": None},
        "none": 0.01,
        "unknown": 0.003,
    }
    assert Summary.from_json(content).fault_probability == told
    content["fault_probability"]["R4R"]["since_s"] = 3.0  # of a later version
    assert Summary.from_json(content).fault_probability == told
    del content["fault_probability"]  # of an earlier one
    assert Summary.from_json(content).fault_probability is None


@pytest.mark.parametrize(
    "content",
    [
        {"none": 0.5},
        {"none": 1.5, "unknown": 0.0},
        {"none": 0.5, "unknown": 0.0, "R4R": 0.5},
        {"none": 0.5, "unknown": 0.0, "R4R": {"probability": 0.5, "mode": "open"}},
        [],
    ],
)
def test_what_are_no_probabilities_is_refused(short_run: Run, content: Any) -> None:
    with pytest.raises(InputError, match="fault_probability"):
        Summary.from_json(_summary(short_run, content))


def test_words_name_what_is_probable_and_nothing_else() -> None:
    told = FaultProbabilities({"R4R": LEAK, "F1U": JetProbability(0.0123), "L2D": JetProbability(0.009)}, 0.0, 0.0)
    assert told.in_words(UNITS) == "failed with probability: R4R 0.97 (leak, +10.00 ± 0.25 lbf), F1U 0.012"
    pushed = told._replace(unknown=0.25).in_words(UNITS)
    assert pushed.endswith("F1U 0.012; something unknown pushes with probability 0.25")
    none = FaultProbabilities({"L2D": JetProbability(0.009)}, 0.99, 0.001)
    assert none.in_words(UNITS) == ""
    many = FaultProbabilities({f"A{number}": JetProbability(0.1) for number in range(7)}, 0.3, 0.0)
    assert many.in_words(UNITS).endswith("A4 0.1, 2 more jets less")


@pytest.mark.parametrize(
    ("probability", "words"),
    [(1.0, "above 0.9999"), (0.99985, "0.9999"), (0.9912, "0.9912"), (0.9, "0.9"), (0.0123, "0.012"), (0.0, "0")],
)
def test_a_probability_has_the_digits_that_count(probability: float, words: str) -> None:
    assert rounded(probability) == words
