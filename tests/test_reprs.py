"""What is shown of objects on a prompt and in a notebook: short, and telling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Campaign, Estimator, Run
from massprop_drake.diagrams import autopilot, closed_loop, estimation, open_loop, replay, vehicle
from massprop_drake.display import graphs
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results.spool import Spool


def test_objects_say_in_a_line_what_they_are(sample_maneuver: Scenario, orbiter: Vehicle, short_run: Run) -> None:
    estimator = Estimator(orbiter, sample_maneuver)
    said = {
        repr(sample_maneuver): ("sample_maneuver", "orbiter", "50 s", "thesis", "seed 0"),
        str(sample_maneuver): ("sample_maneuver",),
        repr(orbiter): ("orbiter", "44 jets", "3 accelerometer packages", "5908.11 slug"),
        repr(short_run): ("sample_maneuver", "orbiter", "6.96 s", "no failure found"),
        repr(estimator): ("orbiter", "thesis filter", "before its first sample"),
        repr(Campaign.load("every_jet")): ("every_jet", "healthy_long"),
    }
    for text, words in said.items():
        assert len(text) < 200
        assert all(word in text for word in words), text


def test_failures_and_what_was_found_are_counted(stuck_run: Run) -> None:
    assert ", 1 failure>" in repr(stuck_run.scenario)
    assert ": 1 declaration>" in repr(stuck_run)


def test_an_estimator_says_how_far_it_is(orbiter: Vehicle) -> None:
    estimator = Estimator(orbiter, load_scenario("sample_maneuver"))
    estimator.step(0.0, np.zeros(3), dict.fromkeys(("acc1", "acc2", "acc3"), np.zeros(3)), np.zeros(44))
    assert "at 0 s" in repr(estimator)


def test_signals_are_told_by_name_and_size_alone(short_run: Run, tmp_path: Path) -> None:
    loaded = Run.load(short_run.save(tmp_path / "run", pictures=False, report=False))
    for signals in (short_run.signals, loaded.signals):
        text = repr(signals)
        assert len(text) < 400
        assert f"{short_run.time_s.size} samples: rate (3), attitude (4)" in text


def test_signals_on_disk_are_not_read_to_be_told() -> None:
    spool = Spool(rows_per_piece=2, index="time_s")
    for start in (0.0, 2.0):
        spool.append({"time_s": np.array([start, start + 1.0]), "a": np.zeros((2, 3))})
    assert not spool.in_memory
    assert repr(spool) == "<1 signals of 4 samples: a (3)>"
    assert repr(Spool()) == "<0 signals of 0 samples: >"


@pytest.mark.parametrize("module", [autopilot, closed_loop, estimation, open_loop, replay, vehicle])
def test_a_diagram_says_what_it_is_of(module: object, sample_maneuver: Scenario) -> None:
    name = module.__name__.rpartition(".")[2]  # type: ignore[attr-defined]
    diagram = graphs.build(name)
    text = repr(diagram)
    assert text.startswith(f"<Diagram '{name}' of ")
    assert text.endswith(f"{diagram.num_output_ports()} out>")
    assert "object at" not in text


def test_a_figure_shows_itself(short_run: Run) -> None:
    assert short_run.plot.rates()._repr_png_().startswith(b"\x89PNG")
