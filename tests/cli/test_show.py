"""What is printed of results."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run
from massprop_drake.cli import show, streams
from massprop_drake.inputs.model import list_keys
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results import table
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.fault_probabilities import FaultProbabilities, JetProbability
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.results.summary import Summary

STUCK_ON = DetectionRecord(50.0, 50.16, "jet_on", 12, "R4R", "jet", 868.8, 0.1, 1.0e4, 3, thrust=868.8, mode="stuck_on")
QUALITY = {
    "rows": 60,
    "samples": {"rotation": {"used": 40, "coasting": 12, "jets_changed": 8, "saturated": 0}},
    "information": ["times count from 5 s of its clock"],
    "warnings": ["acc[2] stands still"],
}
Capture = pytest.CaptureFixture[str]
Printed = Callable[..., list[str]]


@pytest.fixture
def printed(capsys: Capture, orbiter: Vehicle, short_run: Run, tmp_path: Path) -> Printed:
    """Lines that are printed of a run whose results are changed."""

    def call(show_run: Callable[[Summary, Vehicle, Path], None] = show.print_simulation, **changes: Any) -> list[str]:
        show_run(replace(short_run.results, **changes), orbiter, tmp_path)
        return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out).splitlines()

    return call


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Makes standard output a terminal of a width."""

    def widen(width: int) -> None:
        monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
        monkeypatch.setenv("COLUMNS", str(width))

    return widen


def cells(lines: list[str], symbol: str) -> list[str]:
    (line,) = [line for line in lines if line.startswith(f"│ {symbol} ")]
    return [cell.strip() for cell in line.strip("│").split("│")]


MISSED = InjectedRecord("stuck_on", "R4R", 50.0, 50.08, None, None, "missed")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"injected": (MISSED,)}, "missed:      R4R stuck on at 50.00 s, acting since 50.08 s: not found"),
        (
            {"injected": (MISSED._replace(outcome="wrong", taken_for=JUMP),)},
            "missed:      R4R stuck on at 50.00 s, acting since 50.08 s: taken for mass property jump",
        ),
        ({"injected": (MISSED._replace(outcome="never_acted", first_acted_s=None),)}, None),
        ({"injected": (MISSED._replace(outcome="group"),)}, None),
        (
            {"fault_probability": FaultProbabilities({"R4R": JetProbability(0.97, "leak", 10.0, 0.25)}, 0.03, 0.0)},
            "probable:    failed with probability: R4R 0.97 (leak, +10.00 ± 0.25 lbf)",
        ),
        ({"fault_probability": FaultProbabilities({"R4R": JetProbability(0.009)}, 0.03, 0.0)}, None),
    ],
)
def test_what_was_missed_or_is_probable_is_a_line(printed: Printed, changes: Any, said: str | None) -> None:
    found = [line for line in printed(**changes) if line.startswith(("missed:", "probable:"))]
    assert found == ([said] if said else [])


GROUP = {"jet": None, "isolated_to": "group", "jets": ("R4R", "R2R"), "told_apart_by": "R2R"}
NO_JET = {"kind": JUMP, "cluster": None, "jet": None, "magnitude": None, "magnitude_std": None, "mode": None}
STUCK = "jet R4R (cluster 12): stuck on, +868.80 ± 0.10 lbf"
SINCE = "declared at 50.16 s, since 50.00 s"


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, f"{STUCK}, {SINCE}"),
        ({"withdrawn_s": 61.0}, f"{STUCK}, {SINCE}, withdrawn at 61.00 s"),
        ({"jet": None}, f"a jet of cluster 12: stuck on, +868.80 ± 0.10 lbf, {SINCE}"),
        (NO_JET, f"mass property jump, {SINCE}"),
        (
            {"magnitude": 9.9992, "magnitude_std": 0.0013, "mode": "leak"},
            f"jet R4R (cluster 12): leaks 9.9992 ± 0.0013 lbf, 1.2 % of its thrust, {SINCE}",
        ),
        (
            {"kind": "jet_degraded", "magnitude": -217.2, "magnitude_std": 4.0, "mode": "loss", **GROUP},
            f"one of R4R, R2R: loses 217.2 ± 4.0 lbf, 25 % of its thrust, {SINCE}, "
            "R2R fired alone would tell them apart",
        ),
        (
            {**NO_JET, "mass": -978.0, "mass_std": 35.0, "mode": "release"},
            f"payload released: -978 ± 35 slug, {SINCE}",
        ),
        ({"thrust": None, "mode": None}, f"jet R4R (cluster 12): on, +868.80 ± 0.10 lbf, {SINCE}"),  # of an earlier one
        ({**NO_JET, "earliest_s": 48.0, "latest_s": 51.0},
         "mass property jump, declared at 50.16 s, begun between 48.00 and 51.00 s"),
    ],
)  # fmt: skip
def test_a_detection_is_a_line(capsys: Capture, orbiter: Vehicle, changes: dict[str, Any], line: str) -> None:
    show.print_detection(STUCK_ON._replace(**changes), orbiter)
    assert capsys.readouterr().out == f"detected:    {line}\n"


def test_estimates_stand_beside_the_truth(printed: Printed, short_run: Run, tmp_path: Path) -> None:
    known = short_run.results
    truth, percent = known.truth.copy(), known.percent_error.copy()
    truth[6], truth[7] = known.estimates[6] + 4.0 * known.standard_deviations[6], 0.0
    percent[7] = np.nan
    (tmp_path / "report.html").touch()
    (tmp_path / "figures").mkdir()
    lines = printed(
        autopilot=known.autopilot._replace(lp_infeasible=2, jets_out_of_use=["R4R", "F2R"], jets_left_in=["L4D"]),
        truth=truth,
        percent_error=percent,
        detections=(STUCK_ON,),
        derived=known.derived._replace(physically_possible=False),
        timing=known.timing._replace(real_time_factor=9.96),
    )
    assert lines[0].rstrip() == "sample_maneuver: orbiter, 6.96 s, seed 0"
    one, row = known.parameters[0], cells(lines, "Ixx⁻¹")
    assert [row[1], row[-1]] == ["1e-6/(slug-ft^2)", "yes"]
    numbers = [
        1e6 * one.estimate,
        1e6 * one.truth,
        one.percent_error,
        1e6 * one.standard_deviation,
        one.percent_deviation,
    ]
    assert [float(cell) for cell in row[2:7]] == pytest.approx(numbers, rel=0.05)
    assert cells(lines, "x_cm")[-1] == "no"
    assert float(cells(lines, "y_cm")[3]) == 0.0
    assert cells(lines, "y_cm")[4:7:2] == ["-", "-"]  # no percentage of nothing
    out = "\n".join(lines)
    for words in (
        f"over {known.consistency.samples} samples used",
        "impossible:  no rigid body can have the inertia that was estimated",
        "of propellant; 2 requests beyond the jets' reach, met as far as they go",
        "             out of use: R4R, F2R\n",
        "             left in, though in question: L4D\n",
        "detected:    jet R4R (cluster 12): stuck on",
        "speed:       10 times real time",
        f"report: {tmp_path}/report.html   figures: {tmp_path}/figures/",
    ):
        assert words in out
    assert "replay" not in out


def test_a_record_has_no_truth_but_warnings(printed: Printed, short_run: Run) -> None:
    known = short_run.results
    lines = printed(
        show.print_estimation,
        estimates=np.where(np.arange(10) == 9, np.nan, known.estimates),
        derived=known.derived._replace(mass=None, mass_std=None),
        provenance=known.provenance._replace(telemetry="flight[1].csv"),
        consistency=known.consistency._replace(translation_nis_mean=None),
        timing=known.timing._replace(wall_s=0.5),
        data_quality=QUALITY,
    )
    assert lines[0].rstrip() == "flight[1].csv: orbiter, 6.96 s"
    assert cells(lines, "1/m") == ["1/m", "1/slug", "not observable", "-", "-"]
    assert cells(lines, "m") == ["m", "slug", "-", "-", "-"]
    for words in (
        "note:        times count from 5 s of its clock",
        "warning:     acc[2] stands still",
        "samples:     60 rows; 40 used; skipped: 12 coasting, 8 jets changed",
        "detected:    nothing, since no sample was tested",
        "speed:       120 rows a second",
    ):
        assert words in lines
    assert any("rotation, - translation, over" in line for line in lines)


def test_rows_and_samples_that_differ_say_what_they_count(printed: Printed, short_run: Run) -> None:
    known = short_run.results
    record = {"provenance": known.provenance._replace(telemetry="flight.csv"), "data_quality": QUALITY | {"rows": 120}}
    lines = printed(show.print_estimation, **record)
    assert any("120 rows, 60 counted a sample period apart; 40 used; skipped: 12 coast" in line for line in lines)


def test_lines_are_never_read_as_markup_and_json_is_whole(capsys: Capture) -> None:
    line = "[bold]x[/bold] " + "y" * 300
    show.say(line)
    streams.note(line)
    assert capsys.readouterr() == (f"{line}\n", f"massprop: {line}\n")
    show.print_json({"b": [1.5, None], "a": "é"})
    assert json.loads(capsys.readouterr().out) == {"b": [1.5, None], "a": "é"}
    with pytest.raises(ValueError, match="JSON"):
        show.print_json(float("nan"))
    found = [key for key in list_keys(Scenario) if key.name.startswith("maneuver")]
    show.print_schema(found)
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert all(any(line.startswith(f"{key.name} ") for line in lines) for key in found)


RECORD: dict[str, Any] = {
    **{"rows": 60, "period_s": 0.1, "first_s": 0.0, "last_s": 5.9, "gaps": 0, "late": 0, "unknown": [], "absent": []},
    **{"completeness": "complete", "completeness_detail": []},
}


def test_good_files_are_described(orbiter: Vehicle) -> None:
    assert show.describe_input(orbiter) == "vehicle 'orbiter', 44 jets, 1 gyro and 3 accelerometer packages, units us"
    assert (
        show.describe_input(load_scenario("sample_maneuver")) == "scenario 'sample_maneuver', 50 s, vehicle 'orbiter'"
    )
    assert show.describe_telemetry(RECORD, None) == "telemetry, 60 rows, 0.1 s apart, from 0 to 5.9 s"
    lost = {"completeness": "truncated", "completeness_detail": ["log.csv: is cut off within line 61"]}
    found = {**RECORD, **lost, "period_s": None, "gaps": 2, "unknown": list("abcdef"), "absent": ["acc2"]}
    assert show.describe_telemetry(found, orbiter) == (
        "telemetry of orbiter, 60 rows, from 0 to 5.9 s; 2 gaps; "
        "columns not used: a, b, c, d, e, ...; no readings of acc2; truncated: log.csv: is cut off within line 61"
    )


def _isolable(jet: str, on: float | None, rival: str | None) -> dict[str, Any]:
    return {"jet": jet, "on": {"force": on, "rival": rival}, "lost": {"force": None, "rival": rival}}


def test_a_report_on_a_vehicle_is_lines() -> None:
    report = {
        "body": {"mass": 123.44, "gyration": [1.0, 2.0, 3.0], "arms": [0.5, 0.5, 0.5], "thrusts": [10.0, 0.25]},
        "control": {"rank": 5, "condition": None, "missing": ["turn +x", "turn -x"]},
        "observability": {"rank": 8, "estimated": 10, "unobservable": [{"z_cm": 1.0}, {"Ixx_inv": 0.7, "y_cm": -0.7}]},
        "notes": ["all forces lie in one plane"],
        "alike": [{"jets": ["A", "B"], "angle_rad": np.radians(1.5), "opposed": True}],
        "isolable": [_isolable("A", 2.0, "B"), _isolable("B", 4.0, None), _isolable("C", None, None)],
    }
    assert show.vehicle_lines(report, {"mass": "kg", "length": "m", "force": "N"}) == [
        "  body:        123.4 kg, radii of gyration 1 to 3 m; jets of 0.25 to 10 N, 0.5 m from the center of mass",
        "  control:     rank 5 of 6; cannot push alone: turn +x, turn -x",
        "  observable:  8 of the 10 mass properties by firing each jet alone",
        "               not: z_cm",
        "               not: +0.7 Ixx_inv -0.7 y_cm",
        "  note:        all forces lie in one plane",
        "  look alike:  by the angle between what one sample shows of them",
        "                 1.500 deg  A failing off like B failing on",
        "  isolable:    smallest failure that one sample assigns to its jet, others off, N",
        "               on untold:    median 3, largest 4 (B); never: C (not seen)",
        "               lost, firing: never: A (like B), B (not seen), C (not seen)",
    ]


def test_no_number_is_ever_cut(printed: Printed, terminal: Callable[[int], None], short_run: Run) -> None:
    value = short_run.results.parameters[0].estimate
    for width, spared in ((160, 0), (80, 1), (60, 3)):
        terminal(width)
        lines = printed()
        assert "…" not in "".join(lines)
        row = next(line for line in lines if "Ixx⁻¹" in line)
        assert max(len(line) for line in lines[: lines.index(row) + 1]) <= width
        shown = [cell for cell in row.replace("│", " ").split() if cell.lstrip("+-").replace(".", "").isdigit()]
        assert 1e-6 * float(shown[0]) == pytest.approx(value, rel=0.05)
        assert ("1-sigma %" in lines[1] + lines[2], "in 3 sigma" in lines[1] + lines[2]) == (spared < 1, spared < 2)
    terminal(40)  # a line for each number
    lines = printed()
    first = lines.index("Ixx⁻¹, 1e-6/(slug-ft^2)")
    assert [line.split("  ")[1] for line in lines[first + 1 : first + 4]] == ["estimate", "error %", "1-sigma"]
    assert 1e-6 * float(lines[first + 1].split()[-1]) == pytest.approx(value, rel=0.05)
    below = next(number for number, line in enumerate(lines) if line.startswith("files:"))  # paths stay whole
    assert max(map(len, lines[:below])) <= 40


FOUND = {
    "vehicles": {"free_flyer": f"A 4.3 kg free flyer {'with thrusters ' * 5}and no wheels"},
    "campaigns": {"sampling_period": "How often to read"},
}


@pytest.mark.parametrize("width", [None, 60, 100])
def test_a_list_uses_the_width_of_the_terminal(
    capsys: Capture, terminal: Callable[[int], None], width: int | None
) -> None:
    if width is not None:
        terminal(width)
    show.print_listing(FOUND)
    lines = [line.rstrip() for line in re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out).splitlines()]
    text = FOUND["vehicles"]["free_flyer"]
    assert text in " ".join(" ".join(lines).split())
    if width is None:
        assert lines == [f"vehicle   free_flyer       {text}", "campaign  sampling_period  How often to read"]
        return
    assert max(map(len, lines)) <= width
    column = 4 if width <= 80 else 27  # a narrow terminal has descriptions below names
    assert len(lines) == 2 * (width <= 80) + 1 + -(-len(text) // (width - column))


def test_lines_are_broken_between_words_on_a_terminal_alone(capsys: Capture, terminal: Callable[[int], None]) -> None:
    said = "detected:    jump: +30.11 ± 0.22 kg at (+0.8977 ± 0.0050, -0.00032 ± 0.00034) m"
    show.Terminal(120).say(said)
    assert capsys.readouterr().out.splitlines() == [said]
    terminal(40)
    show.Terminal().say(said)
    assert capsys.readouterr().out.splitlines() == [
        "detected:    jump: +30.11 ± 0.22 kg at",
        "             (+0.8977 ± 0.0050,",
        "             -0.00032 ± 0.00034) m",
    ]


@pytest.mark.parametrize(
    ("value", "deviation", "shown", "unit"),
    [
        (1.14322e-6, 1.15e-10, "1.14322", "1e-6 ft"),
        (5.0e-11, 9.6e-12, "50.0", "1e-12 ft"),
        (5909.2, 282.0, "5909", "ft"),
        (895348.0, 1610.0, "895.3", "1e3 ft"),
        (32.1, 0.0, "32.1000", "ft"),
        (-0.06, 5e-9, "-0.0600000", "ft"),
    ],
)
def test_a_number_has_two_digits_of_its_sigma_and_six_at_most(
    short_run: Run, value: float, deviation: float, shown: str, unit: str
) -> None:
    known, x_cm = short_run.results, np.arange(10) == 6
    estimates, sigmas = np.where(x_cm, value, known.estimates), np.where(x_cm, deviation, known.standard_deviations)
    results = replace(known, estimates=estimates, standard_deviations=sigmas, truth=np.full(10, np.nan))
    row = table.parameter_rows(results, {"length": "ft", "mass": "slug", "force": "lbf"})[6]
    assert (row.estimate, row.unit) == (shown, unit)
    reciprocal = table.parameter_rows(known, {"length": "ft", "mass": "slug", "force": "lbf"})[9]
    assert reciprocal.unit == "1e-6/slug"
