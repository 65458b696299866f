"""Runs of vehicles without gyros: their plots, report, replay and table."""

from __future__ import annotations

from pathlib import Path

import pytest

from massprop_drake import estimate, simulate
from massprop_drake.display import plots
from massprop_drake.display.flight3d import replay_html
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.results.run import Run
from massprop_drake.results.table import derived


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Two seconds of the air-bearing satellite, from its own telemetry."""
    folder = tmp_path_factory.mktemp("flight")
    scenario = load_scenario("air_bearing_pulses", ["duration_s=2", "failures=[]"])
    simulate(scenario).save(folder / "run", pictures=False, report=False)
    return estimate(folder / "run" / "telemetry.csv", scenario)


def test_what_is_fixed_is_not_drawn(record: Run) -> None:
    source = plots.source(record)
    shown = plots.available(source)
    assert {"gyro_readings", "inverse_inertia_products", "innovations"}.isdisjoint(shown)
    assert len(shown["inverse_inertia_diagonal"](source).panels) == 1  # Izz
    assert len(shown["center_of_mass"](source).panels) == 2


def test_it_has_a_report_figures_and_a_replay(record: Run, tmp_path: Path) -> None:
    record.save(tmp_path / "run")
    assert (tmp_path / "run" / "report.html").stat().st_size > 0
    assert (tmp_path / "run" / "figures" / "detection_timeline.png").stat().st_size > 0
    assert "</html>" in replay_html(record)


def test_what_is_fixed_has_no_sigma_in_the_table(record: Run) -> None:
    rows = {row.symbol: row for row in derived(record.results, record.scenario.vehicle_data.unit_names)}
    assert (rows["Ixx"].sigma, rows["Ixx"].percent) == ("-", "-")
    assert rows["Izz"].sigma != "-"
