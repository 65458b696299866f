"""Objects on a prompt and in a notebook are shown in one short, telling line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Campaign, Estimator, Run
from massprop_drake.display import graphs
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results.spool import Spool


def test_objects_say_in_a_line_what_they_are(
    sample_maneuver: Scenario, orbiter: Vehicle, short_run: Run, stuck_run: Run, tmp_path: Path
) -> None:
    estimator = Estimator(orbiter, sample_maneuver)
    begun = Estimator(orbiter, sample_maneuver)
    begun.step(0.0, np.zeros(3), dict.fromkeys(("acc1", "acc2", "acc3"), np.zeros(3)), np.zeros(44))
    loaded = Run.load(short_run.save(tmp_path / "run", pictures=False, report=False))
    samples = f"{short_run.time_s.size} samples: rate (3), attitude (4)"
    for what, *words in (
        (sample_maneuver, "sample_maneuver", "orbiter", "50 s", "thesis", "seed 0"),
        (orbiter, "orbiter", "44 jets", "3 accelerometer packages", "5908.11 slug"),
        (short_run, "sample_maneuver", "orbiter", "6.96 s", "no failure found"),
        (stuck_run.scenario, ", 1 failure>"),
        (stuck_run, ": 1 declaration>"),
        (estimator, "orbiter", "thesis filter", "before its first sample"),
        (begun, "at 0 s"),
        (Campaign.load("every_jet"), "every_jet", "healthy_long"),
        (short_run.signals, samples),
        (loaded.signals, samples),
        (Spool(), "<0 signals of 0 samples: >"),
    ):
        assert len(repr(what)) < 400
        assert all(word in repr(what) for word in words), repr(what)
    assert str(sample_maneuver) == repr(sample_maneuver)
    assert short_run.plot.rates()._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["closed_loop", "estimation"])
def test_a_diagram_says_what_it_is_of(name: str) -> None:
    text = repr(graphs.build(name))
    assert text.startswith(f"<Diagram '{name}' of ")
    assert "object at" not in text
