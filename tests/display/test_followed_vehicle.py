"""Runs of vehicles without gyros: their plots, report, replay and table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import estimate, simulate
from massprop_drake.display import plots, write_replay, write_report
from massprop_drake.display.figures import Plots
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
    record.save(tmp_path / "run", pictures=False)
    assert (tmp_path / "run" / "report.html").stat().st_size > 0
    drawn = {name for name, figure in Plots(plots.source(record)).all().items() if figure.axes}
    assert {"detection_timeline", "thrust_factors", "positions"} <= drawn
    assert "</html>" in replay_html(record)


def test_what_is_fixed_has_no_sigma_in_the_table(record: Run) -> None:
    rows = {row.symbol: row for row in derived(record.results, record.scenario.vehicle_data.unit_names)}
    assert (rows["Ixx"].sigma, rows["Ixx"].percent) == ("-", "-")
    assert rows["Izz"].sigma != "-"


def test_readings_in_the_fixed_frame_are_loaded_again(record: Run, tmp_path: Path) -> None:
    again = Run.load(record.save(tmp_path / "run", pictures=False, report=False))
    np.testing.assert_array_equal(again["mocap"], record["mocap"])


def test_the_cursor_reads_half_the_width_of_a_band(opened: Any, record: Run, tmp_path: Path) -> None:
    page = opened(write_report(record, tmp_path / "report.html")).page
    said = page.evaluate("massprop.reading(massprop.figures.find(f => f.name === 'thrust_factors'), 1.0)")
    row = int(np.searchsorted(record.time_s, 1.0, side="right")) - 1
    assert [label for label, _, _ in said[:2]] == ["T1 3-sigma", "T1 factor"]
    assert float(said[0][1]) == pytest.approx(3.0 * record["thrust_factor_std"][row, 0], rel=1e-4)
    assert float(said[1][1]) == pytest.approx(record["thrust_factor"][row, 0], rel=1e-4)


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_every_corner_of_a_box_is_beside_bars_and_head(
    opened: Any, record: Run, tmp_path: Path, width: int, height: int
) -> None:
    replay = opened(write_replay(record, tmp_path / "replay.html"))
    page = replay.page
    page.set_viewport_size({"width": width, "height": height})
    replay.until(f"innerWidth === {width}")
    replay.painted()
    half = 0.145  # m: of its cube
    corners = [[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)]
    places = page.evaluate(
        f"{corners}.map(at => massprop.onScreen(massprop.node('world', 'body', 'structure'), ...at))"
    )
    head, bar = (page.locator(each).bounding_box() for each in ("#mp-head", "#mp-bar"))
    for x, y in places:
        assert 0 < x < width
        assert y < bar["y"]
        assert y > head["y"] + head["height"] or x > head["x"] + head["width"]
