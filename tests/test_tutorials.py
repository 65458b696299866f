"""The tutorials of the documentation run, and come out as their pages say."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import load_vehicle
from massprop_drake.display import figures
from massprop_drake.display.graphs import svg_text
from massprop_drake.results.run import Run

TUTORIALS = Path(__file__).parent.parent / "docs" / "tutorials"

Tutorial = Callable[[str], dict[str, Any]]

pytestmark = pytest.mark.documentation


def promised(name: str) -> list[str]:
    """What the tutorial's page says that it prints."""
    page = (TUTORIALS / f"{name}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"prints\n\n```text\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    return [line for block in blocks for line in block.splitlines() if line != "..."]


@pytest.fixture
def tutorial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Tutorial:
    """Runs a tutorial as a user would, with a folder to write into; gives the names it leaves behind.

    Runs that it saves have no figures, which are two dozen each and drawn by other tests; its own pictures are drawn.
    """
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})

    def run(name: str) -> dict[str, Any]:
        path = TUTORIALS / f"{name}.py"
        monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
        left = runpy.run_path(str(path), run_name="__main__")
        printed = capsys.readouterr().out.splitlines()
        assert [line for line in promised(name) if line not in printed] == []
        return left

    return run


def test_first_run(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("first_run")
    error = left["estimate"] - left["truth"]
    assert (abs(error) <= 4.0 * left["sigma"]).all()
    assert 25.0 < left["converged_s"] < 27.0  # in the first translation
    assert (tmp_path / "mass_reciprocal.png").stat().st_size > 0
    assert left["again"].summary == left["run"].summary


def test_build_a_diagram(tutorial: Tutorial, tmp_path: Path, sample_run: Run) -> None:
    assert len((TUTORIALS / "build_a_diagram.py").read_text(encoding="utf-8").splitlines()) <= 40
    left = tutorial("build_a_diagram")
    dot = (tmp_path / "my_loop.dot").read_text(encoding="utf-8")
    for name in ("autopilot", "vehicle", "estimation", "gyro_2"):
        assert name in dot
    assert "<svg" in (svg_text(dot) or "<svg")  # what draws it may not be installed
    estimators = left["estimators"]
    context = estimators.GetMyContextFromRoot(left["simulator"].get_context())
    estimate, deviation = (estimators.GetOutputPort(name).Eval(context) for name in ("estimate", "standard_deviation"))
    assert 1.0 / estimate[9] == pytest.approx(5905.0, rel=0.05)
    # the second package is used, not only wired: half the variance, so 0.71 times the 1-sigma
    assert (deviation[:3] < 0.85 * sample_run["standard_deviation"][-1][:3]).all()


def test_named_thruster(tutorial: Tutorial, tmp_path: Path) -> None:
    run = tutorial("named_thruster")["run"]
    error = run.results.estimates - run.results.truth
    assert (abs(error) <= 3.0 * run.results.standard_deviations).all()
    assert "YP1" in (tmp_path / "named_thruster" / "report.html").read_text(encoding="utf-8")


def test_own_estimator(tutorial: Tutorial, tmp_path: Path, sample_run: Run) -> None:
    lines = (TUTORIALS / "own_estimator.py").read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if line]) <= 40
    run = tutorial("own_estimator")["run"]
    np.testing.assert_array_equal(run["estimate"], sample_run["estimate"])  # ours is undisturbed
    mine = run["least_squares.estimate"][-1]
    np.testing.assert_allclose(mine[:3], run["truth"][-1, :3], rtol=1e-3)
    assert np.isnan(mine[6:]).all()
    report = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "least_squares, at the end" in report
    assert (tmp_path / "own_estimator.png").stat().st_size > 0


def test_add_a_sensor(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("add_a_sensor")
    assert left["lost"] == pytest.approx(0.3 * 626, abs=4.0 * np.sqrt(626 * 0.3 * 0.7))
    assert (abs(left["ratio"]) <= 4.0).all()
    assert "radio_gyro" in (tmp_path / "with_radio_gyro.dot").read_text(encoding="utf-8")


def test_add_a_failure(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("add_a_failure")
    leak, dead = left["run"].summary["detections"]
    assert (leak["kind"], leak["cluster"], leak["jet"]) == ("jet_on", 10, None)  # the data name the cluster alone
    assert leak["magnitude"] == pytest.approx(60.0, abs=4.0)
    assert (dead["kind"], dead["jet"]) == ("jet_off", "F2R")
    assert {"F2R", "L4D"} <= set(left["run"].summary["autopilot"]["jets_out_of_use"])
    assert (tmp_path / "failure_magnitude.png").stat().st_size > 0


def test_verdicts(tutorial: Tutorial, tmp_path: Path) -> None:
    runs = tutorial("verdicts")["runs"]
    verdicts = {name: run.summary["consistency"]["verdict"] for name, run in runs.items()}
    assert (verdicts["healthy"], verdicts["wrong_thrusts"]) == ("consistent", "inconsistent")
    (leak,) = runs["leak"].results.detections
    assert leak.magnitude == pytest.approx(10.0, abs=4.0 * leak.magnitude_std)
    assert not runs["healthy"].results.detections
    assert (tmp_path / "failure_magnitude.png").stat().st_size > 0


def test_probability(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("probability")
    (soon,), (late,) = (flight.results.detections for flight in left["doubted"].values())
    assert (soon.jet, late.jet) == ("ZP1", "ZP1")
    assert soon.time_s < late.time_s  # who accepts more false declarations waits less
    assert left["others"]["healthy"].summary["fault_probability"]["none"] > 0.999
    assert left["others"]["gusts"].summary["fault_probability"]["unknown"] > 0.999
    claims, right = left["claims"], left["right"]
    for low, high in ((0.5, 0.9), (0.9, 0.99), (0.99, 0.999)):
        assert right[(claims >= low) & (claims < high)].mean() >= low
    assert right[claims >= 0.999].mean() >= 0.99  # samples of one flight are no independent trials
    assert (tmp_path / "probability.png").stat().st_size > 0


def test_design_a_maneuver(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("design_a_maneuver")
    for target in left["found"].targets:
        np.testing.assert_allclose(target.flown, target.predicted, rtol=0.1)
    assert {pair.jet for pair in left["test"].pairs} == {"YP1", "YN2"}
    assert left["orbiter"].propellant < 0.6 * 5.4  # slug, of the thesis's maneuver
    assert (tmp_path / "servicer_design" / "design.html").exists()
    assert (tmp_path / "design.png").stat().st_size > 0


def test_your_own_vehicle(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("your_own_vehicle")
    flight, last = left["flight"], left["last"]
    np.testing.assert_array_equal(last.estimate, flight["estimate"][-1])
    assert (abs(last.estimate - flight["truth"][-1]) <= 4.0 * last.standard_deviation).all()
    assert load_vehicle(TUTORIALS / "tug.yaml").name == "tug"
    assert (tmp_path / "flight" / "telemetry.csv").exists()
    assert not last.removed.any()


def test_a_real_vehicle(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("a_real_vehicle")
    (found,) = left["hardware"].results.detections
    assert (found.jet, found.isolated_to, found.onset_s) == ("T2", "jet", 0.0)
    assert found.time_s < 30.0
    assert not left["twin"].results.detections
    scales = left["hardware"].results.derived
    assert scales.mass == pytest.approx(23.09, abs=3.0 * scales.mass_std)
    twin = left["twin"].results.derived
    assert twin.inertia[2, 2] == pytest.approx(0.324, abs=3.0 * twin.inertia_std[2, 2])
    assert (tmp_path / "hardware" / "report.html").exists()


def test_consistency(tutorial: Tutorial, tmp_path: Path) -> None:
    results = tutorial("consistency")["results"]
    rotation, mass, nees_rotation, nees_mass, neighbors = results["Gaussian"]
    for nis in (rotation, mass):  # consecutive ones are correlated: the tolerance is four times that of independent
        assert nis.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / nis.size))
    assert nees_rotation < 9.0
    assert nees_mass < 1.0
    assert neighbors == pytest.approx(-0.5, abs=0.15)  # a moving average of two: the difference of readings
    assert results["quantized"][1].mean() < 2.5  # an axis without acceleration shows no noise at all
    assert (tmp_path / "nis.png").stat().st_size > 0


def test_your_spacecraft(tutorial: Tutorial) -> None:
    left = tutorial("your_spacecraft")
    assert [found.jet for found in left["again"].results.detections] == ["YP2"]
