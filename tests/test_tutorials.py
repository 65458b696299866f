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

import massprop_drake
from massprop_drake import load_scenario
from massprop_drake.display import figures
from massprop_drake.display.run import Run

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
        assert [image.name for image in tmp_path.glob("*.png") if not image.stat().st_size] == []
        return left

    return run


def within(left: dict[str, Any], sigmas: float) -> bool:
    """Tests whether a run's estimates are as near the truth as they claim."""
    results = left["run"].results
    return bool((abs(results.estimates - results.truth) <= sigmas * results.standard_deviations).all())


def test_first_run(tutorial: Tutorial) -> None:
    left = tutorial("first_run")
    assert (abs(left["estimate"] - left["truth"]) <= 4.0 * left["sigma"]).all()
    assert 25.0 < left["converged_s"] < 27.0  # in the first translation
    assert left["again"].summary == left["run"].summary


def test_build_a_diagram(tutorial: Tutorial, tmp_path: Path, sample_run: Run) -> None:
    left = tutorial("build_a_diagram")
    dot = (tmp_path / "my_loop.dot").read_text(encoding="utf-8")
    assert [name for name in ("autopilot", "vehicle", "estimation", "gyro_2") if name not in dot] == []
    estimators = left["estimators"]
    context = estimators.GetMyContextFromRoot(left["simulator"].get_context())
    estimate, deviation = (estimators.GetOutputPort(name).Eval(context) for name in ("estimate", "standard_deviation"))
    assert 1.0 / estimate[9] == pytest.approx(5905.0, rel=0.05)
    # the second package is used, not only wired: half the variance, so 0.71 times the 1-sigma
    assert (deviation[:3] < 0.85 * sample_run["standard_deviation"][-1][:3]).all()


def test_named_thruster(tutorial: Tutorial, tmp_path: Path) -> None:
    assert within(tutorial("named_thruster"), 3.0)
    assert "YP1" in (tmp_path / "named_thruster" / "report.html").read_text(encoding="utf-8")


def test_own_estimator(tutorial: Tutorial, tmp_path: Path, sample_run: Run) -> None:
    run = tutorial("own_estimator")["run"]
    np.testing.assert_array_equal(run["estimate"], sample_run["estimate"])  # ours is undisturbed
    mine = run["least_squares.estimate"][-1]
    np.testing.assert_allclose(mine[:3], run["truth"][-1, :3], rtol=1e-3)
    assert np.isnan(mine[6:]).all()
    assert "least_squares, at the end" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def test_own_estimator_on_another_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = load_scenario("free_flyer_maneuver", ["duration_s=30"])
    monkeypatch.setattr(massprop_drake, "load_scenario", lambda _: small, raising=False)
    monkeypatch.setattr(Run, "save", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["own_estimator.py", str(tmp_path)])
    run = runpy.run_path(str(TUTORIALS / "own_estimator.py"), run_name="__main__")["run"]
    np.testing.assert_allclose(run["least_squares.estimate"][-1, :3], run["truth"][-1, :3], rtol=0.03)


def test_add_a_sensor(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("add_a_sensor")
    assert left["lost"] == pytest.approx(0.3 * 626, abs=4.0 * np.sqrt(626 * 0.3 * 0.7))
    assert (abs(left["ratio"]) <= 4.0).all()
    assert "radio_gyro" in (tmp_path / "with_radio_gyro.dot").read_text(encoding="utf-8")


def test_add_a_failure(tutorial: Tutorial) -> None:
    summary = tutorial("add_a_failure")["run"].summary
    leak, dead = summary["detections"]
    assert (leak["kind"], leak["cluster"], leak["jet"]) == ("jet_on", 10, None)  # the data name the cluster alone
    assert leak["magnitude"] == pytest.approx(60.0, abs=4.0)
    assert (dead["kind"], dead["jet"]) == ("jet_off", "F2R")
    assert {"F2R", "L4D"} <= set(summary["autopilot"]["jets_out_of_use"])


def test_verdicts(tutorial: Tutorial) -> None:
    runs = tutorial("verdicts")["runs"]
    (leak,) = runs["leak"].results.detections
    assert leak.magnitude == pytest.approx(10.0, abs=4.0 * leak.magnitude_std)
    assert not runs["healthy"].results.detections


def test_probability(tutorial: Tutorial) -> None:
    left = tutorial("probability")
    (soon,), (late,) = (flight.results.detections for flight in left["doubted"].values())
    assert (soon.jet, late.jet) == ("ZP1", "ZP1")
    assert soon.time_s < late.time_s  # who accepts more false declarations waits less
    claims, right = left["claims"], left["right"]
    for low, high in ((0.5, 0.9), (0.9, 0.99), (0.99, 0.999)):
        assert right[(claims >= low) & (claims < high)].mean() >= low
    assert right[claims >= 0.999].mean() >= 0.99  # samples of one flight are no independent trials


def test_design_a_maneuver(tutorial: Tutorial, tmp_path: Path) -> None:
    left = tutorial("design_a_maneuver")
    for target in left["found"].targets:
        np.testing.assert_allclose(target.flown, target.predicted, rtol=0.1)
    assert {pair.jet for pair in left["test"].pairs} == {"YP1", "YN2"}
    assert (tmp_path / "servicer_design" / "design.html").exists()


def test_your_own_vehicle(tutorial: Tutorial) -> None:
    left = tutorial("your_own_vehicle")
    flight, last = left["flight"], left["last"]
    np.testing.assert_array_equal(last.estimate, flight["estimate"][-1])
    assert (abs(last.estimate - flight["truth"][-1]) <= 4.0 * last.standard_deviation).all()
    assert not last.removed.any()


def test_a_real_vehicle(tutorial: Tutorial) -> None:
    left = tutorial("a_real_vehicle")
    (found,) = left["hardware"].results.detections
    assert (found.jet, found.isolated_to, found.onset_s) == ("T2", "jet", 0.0)
    assert not left["twin"].results.detections
    scales, twin = left["hardware"].results.derived, left["twin"].results.derived
    assert scales.mass == pytest.approx(23.09, abs=3.0 * scales.mass_std)
    assert twin.inertia[2, 2] == pytest.approx(0.324, abs=3.0 * twin.inertia_std[2, 2])


def test_consistency(tutorial: Tutorial) -> None:
    results = tutorial("consistency")["results"]
    rotation, mass, nees_rotation, nees_mass, neighbors = results["Gaussian"]
    for nis in (rotation, mass):  # consecutive ones are correlated: the tolerance is four times that of independent
        assert nis.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / nis.size))
    assert (nees_rotation < 9.0, nees_mass < 1.0) == (True, True)
    assert neighbors == pytest.approx(-0.5, abs=0.15)  # a moving average of two: the difference of readings
    assert results["quantized"][1].mean() < 2.5  # an axis without acceleration shows no noise at all


def test_your_spacecraft(tutorial: Tutorial) -> None:
    left = tutorial("your_spacecraft")
    assert [found.jet for found in left["again"].results.detections] == ["YP2"]
