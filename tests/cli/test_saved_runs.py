"""A run is saved whatever happens at its end: what there is, with a note of what is missing."""

from __future__ import annotations

import itertools
import json
import pkgutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import Massprop

from massprop_drake import Run
from massprop_drake.inputs.yaml import to_yaml

INNOVATE = "maths.estimation.filters.rotation_filter.innovate"
ENGINES = {"drake": (), "loop": ("--set", "execution={engine: loop}")}
RUN = ("run", "sample_maneuver", "--set", "duration_s=12", "--no-report", "--no-figures", "--out", "there", "-q")
ESTIMATE = ("estimate", "record.csv", "--like", "whole", "--no-report", "--no-figures", "--out", "there", "-q")
SAMPLES, PERIOD_S = 151, 0.08


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, short_run: Run) -> Path:
    return short_run.save(tmp_path_factory.mktemp("whole") / "whole", pictures=False, report=False)


def _failing(monkeypatch: pytest.MonkeyPatch, name: str, error: BaseException, after: int = 0) -> None:
    """Lets a function fail once, after some calls."""
    path = f"massprop_drake.{name}"
    real, calls = pkgutil.resolve_name(path), itertools.count()

    def fail(*arguments: Any, **options: Any) -> Any:
        if next(calls) == after:
            raise error
        return real(*arguments, **options)

    monkeypatch.setattr(path, fail)


def _saved() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(Path("there/summary.json").read_text(encoding="utf-8"))
    return content


@pytest.mark.parametrize("engine", ENGINES)
def test_a_failure_in_the_estimator_ends_the_run_early(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    assert massprop(*RUN, *ENGINES[engine]).status == 0
    expected = Run.load("there")
    _failing(monkeypatch, INNOVATE, ZeroDivisionError("no way"), after=100)
    done = massprop(*RUN, *ENGINES[engine])
    words = "massprop: internal failure: ZeroDivisionError: no way; the run is saved in there/\n"
    assert done == (1, "", words)
    run = Run.load("there")
    assert 50 < run.time_s.size < SAMPLES
    np.testing.assert_array_equal(run["estimate"], expected["estimate"][: run.time_s.size])
    ended = _saved()["ended"]
    assert ended["reason"] == "ZeroDivisionError: no way"
    assert ended["time_s"] == run.time_s[-1] == pytest.approx((run.time_s.size - 1) * PERIOD_S)
    assert Run.load("there.1").time_s.size == SAMPLES  # the whole run of before


@pytest.mark.parametrize(
    ("name", "missing"),
    [
        ("runners.simulate.add_batch_analysis", "hindsight"),
        ("runners.simulate.summarize", "summary"),
    ],
)
def test_a_summary_that_fails_leaves_the_run(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, name: str, missing: str
) -> None:
    for after in (0, 1):  # also while it is noted what is missing
        path = f"massprop_drake.{name}"
        monkeypatch.setattr(path, _always(ValueError("no way"))) if after else _failing(
            monkeypatch, name, ValueError("no way")
        )
        done = massprop(*RUN, *ENGINES["loop"], "--force")
        assert done == (1, "", "massprop: internal failure: ValueError: no way; the run is saved in there/\n")
        assert Run.load("there").time_s.size == SAMPLES
        assert "ended" not in _saved()
    assert _saved()["missing"][0] == f"{missing}: ValueError: no way"


def _always(error: Exception) -> Callable[..., Any]:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    return fail


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_that_its_scenario_ends_is_saved_up_to_there(
    massprop: Massprop, toy_data: dict[str, Any], engine: str
) -> None:
    toy_data["mass_properties"]["mass"] = 0.02
    pulses = [{"jet": "J1", "start_s": 0.2, "end_s": 3.0}]
    scenario = {"vehicle": toy_data, "duration_s": 3.0, "jet_schedule": pulses}
    Path("heavy.yaml").write_text(to_yaml(scenario), encoding="utf-8")
    done = massprop("run", "heavy.yaml", "--out", "there", "--no-figures", *ENGINES[engine])
    assert (done.status, done.out) == (2, "")
    assert "runs out of mass" in done.err
    assert done.err.endswith("; the run is saved in there/\n")
    assert "runs out of mass" in _saved()["ended"]["reason"]
    assert 0.5 < _saved()["ended"]["time_s"] < 3.0
    assert Run.load("there").time_s.size > 5


def test_an_interruption_in_flight_leaves_what_there_is(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    path = f"massprop_drake.{INNOVATE}"
    real, calls = pkgutil.resolve_name(path), itertools.count()

    def interrupted(*arguments: Any) -> Any:
        if next(calls) == 100:
            signal.raise_signal(signal.SIGINT)
        return real(*arguments)

    monkeypatch.setattr(path, interrupted)
    done = massprop(*RUN[:-5], *RUN[-3:], *ENGINES["loop"])  # pages are left out all the same
    assert done == (130, "", "massprop: interrupted: the run is saved in there/\n")
    assert not Path("there/report.html").exists()
    assert _saved()["ended"]["reason"] == "interrupted"
    assert 50 < Run.load("there").time_s.size < SAMPLES


# ------------------------------------------------------------------------------------------ records


@pytest.fixture
def record(massprop: Massprop, whole: Path) -> list[str]:
    """Rows of a record, with the run that it is of in `whole`."""
    assert massprop("--version").status == 0
    Path("whole").symlink_to(whole)
    rows = (whole / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    Path("record.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return rows


@pytest.mark.usefixtures("record")
@pytest.mark.parametrize(
    ("name", "after", "missing"),
    [
        (INNOVATE, 40, None),
        ("runners.recorded.analyze_run", 0, "ValueError: no way"),
        ("runners.recorded.compose_summary", 0, "ValueError: no way"),
    ],
)
def test_an_estimate_that_fails_is_saved(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, name: str, after: int, missing: str | None
) -> None:
    _failing(monkeypatch, name, ValueError("no way"), after=after)
    done = massprop(*ESTIMATE)
    assert done == (1, "", "massprop: internal failure: ValueError: no way; the run is saved in there/\n")
    rows = Run.load("there").time_s.size
    assert (20 < rows < 88) if missing is None else (rows == 88)
    assert _saved().get("missing", [None])[0] == missing
    assert ("ended" in _saved()) == (missing is None)


def _with_nonsense(record: list[str]) -> str:
    time_s, _, *rest = record[40].split(",")
    return "\n".join([*record[:40], ",".join([time_s, "nonsense", *rest]), *record[41:]])


def test_what_came_by_standard_input_is_saved_though_it_ends_in_nonsense(massprop: Massprop, record: list[str]) -> None:
    done = massprop("estimate", "-", *ESTIMATE[2:], stdin=_with_nonsense(record).encode())
    assert done.status == 2
    assert done.err.endswith("; the run is saved in there/\n")
    assert Run.load("there").time_s.size > 20
