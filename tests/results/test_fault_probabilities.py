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
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, Odds, hypothesis_report_row
from massprop_drake.results.fault_probabilities import (
    FaultProbabilities,
    JetProbability,
    final_probabilities,
    format_probability,
)
from massprop_drake.results.spool import Spool
from massprop_drake.results.summary import Summary

N = 44
LEAK = JetProbability(0.97, "leak", 10.0, 0.25)
LAYOUT = HYPOTHESIS_REPORT.sized(jets=N)


def ended(vehicle: Vehicle, *rows: Odds) -> FaultProbabilities:
    """Probabilities at the end of a run whose detector gave these, row by row."""
    spool = Spool()
    spool.append(LAYOUT.columns(np.vstack([LAYOUT.pack(hypothesis_report_row((), row)) for row in rows])))
    found = final_probabilities(vehicle, spool)
    assert found is not None
    return found


def test_those_at_the_end_are_listed_the_likeliest_first(orbiter: Vehicle, stuck_run: Run) -> None:
    names = orbiter.designations
    found = ended(orbiter, odds(N, {5: 0.9}, 0.1), odds(N, {3: 0.02, 28: 0.97, 7: 1e-4}, 0.01, 0.005))
    assert found == FaultProbabilities({names[28]: LEAK, names[3]: LEAK._replace(probability=0.02)}, 0.01, 0.005)
    assert list(found.jets) == [names[28], names[3]]
    found = ended(orbiter, odds(N, {3: 1.0 + 1e-15}, -1e-17))  # rounding carries sums beyond one
    assert (found.jets[names[3]].probability, found.none) == (1.0, 0.0)
    found = ended(orbiter, odds(N, {3: 0.5})._replace(forces=np.full(N, np.nan)))
    assert found.jets[names[3]][2:] == (None, None)  # a force that no hypothesis has
    words = (None, "stuck_on", "leak", "stuck_off", "loss", "drift", "intermittent")
    codes = (Mode.NONE, Mode.STUCK_ON, Mode.LEAK, Mode.STUCK_OFF, Mode.LOSS, Mode.DRIFTING, Mode.INTERMITTENT)
    for code, word in zip(codes, words, strict=True):
        one = odds(N, {3: 0.5})
        assert ended(orbiter, one._replace(modes=np.full_like(one.modes, float(code)))).jets[names[3]].mode == word
    assert stuck_run.summary["fault_probability"] is None
    spool = Spool()
    spool.append(LAYOUT.columns(np.full((2, LAYOUT.size), np.nan)))
    assert final_probabilities(orbiter, spool) is None  # of a detector that gives none


def test_the_summary_has_them_by_jet_and_reads_them_back(short_run: Run) -> None:
    told = FaultProbabilities({"R4R": LEAK, "F1U": JetProbability(0.02)}, 0.01, 0.003)
    content = json.loads(json.dumps(replace(short_run.results, fault_probability=told).as_json(), allow_nan=False))
    assert content["fault_probability"] == {
        "R4R": {"probability": 0.97, "mode": "leak", "force": 10.0, "force_std": 0.25},
        "F1U": {"probability": 0.02, "mode": None, "force": None, "force_std": None},
        "none": 0.01,
        "unknown": 0.003,
    }
    content["fault_probability"]["R4R"]["since_s"] = 3.0  # of a later version
    assert Summary.from_json(content).fault_probability == told
    del content["fault_probability"]  # of an earlier one
    assert Summary.from_json(content).fault_probability is None


SURE = {"none": 0.5, "unknown": 0.0}


@pytest.mark.parametrize(
    "content",
    [
        {"none": 0.5},
        {**SURE, "none": 1.5},
        {**SURE, "R4R": 0.5},
        {**SURE, "R4R": {"probability": 0.5, "mode": "?"}},
        [],
    ],
)
def test_what_are_no_probabilities_is_refused(short_run: Run, content: Any) -> None:
    with pytest.raises(InputError, match="fault_probability"):
        Summary.from_json({**short_run.summary, "fault_probability": content})


def test_words_name_what_is_probable_and_nothing_else() -> None:
    few = FaultProbabilities({"R4R": LEAK, "F1U": JetProbability(0.0123), "L2D": JetProbability(0.009)}, 0.0, 0.0)
    said = "failed with probability: R4R 0.97 (leak, +10.00 ± 0.25 lbf), F1U 0.012"
    many = FaultProbabilities({f"A{number}": JetProbability(0.1) for number in range(7)}, 0.3, 0.0)
    nothing = FaultProbabilities({"L2D": JetProbability(0.009)}, 0.99, 0.001)
    pushed = few._replace(unknown=0.25)
    words = [one.in_words({"force": "lbf"}) for one in (few, pushed, nothing, many)]
    assert words[:3] == [said, f"{said}; something unknown pushes with probability 0.25", ""]
    assert words[3].endswith("A4 0.1, 2 more jets less")
    digits = {1.0: "above 0.9999", 0.99985: "0.9999", 0.9912: "0.9912", 0.9: "0.9", 0.0123: "0.012", 0.0: "0"}
    assert {value: format_probability(value) for value in digits} == digits  # those that count
