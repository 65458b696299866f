"""What version 0.1.0 wrote is read, bit for bit, and gives the same numbers.

These differ by rounding where the linear algebra is that of another processor: one library takes other sums for each.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.inputs.renamed import RenamedWarning

LANDED = Path(__file__).parent / "data" / "landed_0_1"
RUN = LANDED / "run"
N_FIRST = 94  # rows that the part in first/ has taken
ROUNDING = 1e-8  # `unexplained` is what is left of two statistics of 1e8
ESTIMATED = ("estimate", "standard_deviation", "rotation_nis", "mass_nis", "likelihood", "known_force", "onset")

pytestmark = pytest.mark.filterwarnings("ignore::massprop_drake.inputs.renamed.RenamedWarning")


SUMMARY: dict[str, Any] = json.loads((RUN / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def stored() -> dict[str, np.ndarray]:
    with np.load(RUN / "history.npz", allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files if not name.startswith("_")}


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(RUN)


def detections(run: Run) -> list[dict[str, Any]]:
    """Detections with the keys that they had then."""
    return [{key: entry[key] for key in SUMMARY["detections"][0]} for entry in run.summary["detections"]]


def test_its_run_is_loaded_with_the_same_numbers(stored: dict[str, np.ndarray]) -> None:
    assert SUMMARY["version"] == "0.1.0"
    assert [(entry["kind"], entry["jet"]) for entry in SUMMARY["detections"]] == [("jet_on", "J4")]
    assert "quantiser_phase: equal" in (RUN / "scenario.yaml").read_text(encoding="utf-8")
    with pytest.warns(RenamedWarning) as caught:
        run = Run.load(RUN)
    assert len(caught) == 1
    consistency = {"verdict": "", "reasons": (), "diagnoses": []}
    consistency |= {f"{kind}_nis_{what}": None for kind in ("rotation", "translation") for what in ("beyond", "within")}
    later = {name: [] for name in ("identifiability", "events", "unconfirmed", "untested")} | {"injected": None}
    later |= {"completeness": "complete", "completeness_detail": [], "fault_probability": None}
    expected = {**SUMMARY, **later, "consistency": {**SUMMARY["consistency"], **consistency}}
    expected["derived"] = {**SUMMARY["derived"], "nearest_possible": None}
    assert {
        **run.summary,
        "detections": detections(run),
    } == expected  # that version did not judge, and did not follow failures
    assert set(run.signals) == set(stored) - {"time_s"}
    for name in run.signals:
        np.testing.assert_array_equal(run[name], stored[name], err_msg=name)
    np.testing.assert_array_equal(run.covariance, np.array(SUMMARY["covariance"], dtype=float))
    assert set(run.units) == set(run.signals)


def same(now: Any, then: Any) -> bool:
    """Whether two parts of a summary are the same, numbers but for rounding."""
    if isinstance(then, dict):
        return now.keys() == then.keys() and all(same(now[key], then[key]) for key in then)
    if isinstance(then, list):
        return len(now) == len(then) and all(map(same, now, then))
    return bool(now == (pytest.approx(then, rel=ROUNDING, abs=0.0) if isinstance(then, float) else then))


def require_alike(run: Run, stored: dict[str, np.ndarray], names: Iterable[str], first: int = 0) -> None:
    for name in names:
        then = stored[name][first:]
        scale = np.max(np.abs(then[np.isfinite(then)]), initial=0.0)
        np.testing.assert_allclose(run[name], then, rtol=ROUNDING, atol=ROUNDING * scale, err_msg=name)


def require_found(run: Run) -> None:
    """Estimates and detections, in what that version wrote of them."""
    for key in ("estimates", "standard_deviations"):
        assert same(run.summary[key], SUMMARY[key]), key
    deviations = np.sqrt(np.diag(SUMMARY["covariance"]))
    off = np.array(run.summary["covariance"]) - SUMMARY["covariance"]
    np.testing.assert_allclose(off / np.outer(deviations, deviations), 0.0, atol=ROUNDING)
    assert same(detections(run), SUMMARY["detections"])


def test_simulating_it_again_gives_its_telemetry_and_signals(
    scenario: Scenario, stored: dict[str, np.ndarray], tmp_path: Path
) -> None:
    assert scenario == load_scenario(LANDED / "turned_cube.yaml")
    run = simulate(scenario)
    require_alike(run, stored, stored)
    folder = run.save(tmp_path / "again", pictures=False, report=False)
    assert (folder / "telemetry.csv").read_bytes() == (RUN / "telemetry.csv").read_bytes()


def test_its_telemetry_gives_its_estimates(scenario: Scenario, stored: dict[str, np.ndarray]) -> None:
    run = estimate(RUN / "telemetry.csv", scenario)
    require_alike(run, stored, ESTIMATED)
    require_found(run)
    run = estimate(RUN / "telemetry.csv", scenario, resume_from=LANDED / "first")  # goes on from its filter state
    np.testing.assert_array_equal(run["time_s"], stored["time_s"][N_FIRST:])
    require_alike(run, stored, ESTIMATED, N_FIRST)
    require_found(run)
