"""What is printed of results."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import Run
from massprop_drake.cli import show, streams
from massprop_drake.inputs.model import keys
from massprop_drake.inputs.scenario import Scenario, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results import table
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.fault_probabilities import FaultProbabilities, JetProbability
from massprop_drake.results.injected import InjectedRecord

STUCK_ON = DetectionRecord(
    onset_s=50.0,
    time_s=50.16,
    kind="jet_on",
    cluster=12,
    jet="R4R",
    isolated_to="jet",
    magnitude=868.8,
    magnitude_std=0.1,
    statistic=1.0e4,
    alarms=3,
    thrust=868.8,
    mode="stuck_on",
)
QUALITY = {
    "rows": 60,
    "samples": {"rotation": {"used": 40, "coasting": 12, "jets_changed": 8, "saturated": 0}},
    "warnings": ["acc[2] stands still"],
}
Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"outcome": "missed"}, "missed:      R4R stuck on at 50.00 s, acting since 50.08 s: not found\n"),
        ({"outcome": "wrong", "taken_for": "mass_property_jump"}, ": taken for mass property jump\n"),
        ({"outcome": "not_tested"}, ": not found: no sample was tested\n"),
        ({"outcome": "never_acted", "first_acted_s": None}, None),
        ({"outcome": "group"}, None),
    ],
)
def test_what_was_injected_and_not_found_is_said(
    capsys: Capture, stuck_run: Run, tmp_path: Path, changes: dict[str, Any], said: str | None
) -> None:
    one = InjectedRecord("stuck_on", "R4R", 50.0, 50.08, None, None, "missed")._replace(**changes)
    results = replace(stuck_run.results, injected=(one,))
    show.simulated(results, stuck_run.scenario.vehicle_data, tmp_path)
    printed = capsys.readouterr().out
    assert ("missed:" in printed) == (said is not None)
    assert (said or "") in printed


@pytest.mark.parametrize(("probability", "there"), [(0.97, True), (0.009, False)])
def test_what_is_probable_is_a_line(
    capsys: Capture, stuck_run: Run, tmp_path: Path, probability: float, there: bool
) -> None:
    told = FaultProbabilities({"R4R": JetProbability(probability, "leak", 10.0, 0.25)}, 0.03, 0.0)
    show.simulated(replace(stuck_run.results, fault_probability=told), stuck_run.scenario.vehicle_data, tmp_path)
    line = "probable:    failed with probability: R4R 0.97 (leak, +10.00 ± 0.25 lbf)\n"
    printed = capsys.readouterr().out
    assert (line in printed) == ("probable:" in printed) == there


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, "jet R4R (cluster 12): stuck on, +868.80 ± 0.10 lbf, declared at 50.16 s, since 50.00 s"),
        ({"jet": None}, "a jet of cluster 12: stuck on, +868.80 ± 0.10 lbf, declared at 50.16 s, since 50.00 s"),
        (
            {"withdrawn_s": 61.0},
            "jet R4R (cluster 12): stuck on, +868.80 ± 0.10 lbf, declared at 50.16 s, since 50.00 s, "
            "withdrawn at 61.00 s",
        ),
        (
            {
                "kind": "mass_property_jump",
                "cluster": None,
                "jet": None,
                "magnitude": None,
                "magnitude_std": None,
                "mode": None,
            },
            "mass property jump, declared at 50.16 s, since 50.00 s",
        ),
        (
            {"magnitude": 9.9992, "magnitude_std": 0.0013, "mode": "leak"},
            "jet R4R (cluster 12): leaks 9.9992 ± 0.0013 lbf, 1.2 % of its thrust, declared at 50.16 s, since 50.00 s",
        ),
        (
            {
                "kind": "jet_degraded",
                "magnitude": -217.2,
                "magnitude_std": 4.0,
                "mode": "loss",
                "jet": None,
                "isolated_to": "group",
                "jets": ("R4R", "R2R"),
                "told_apart_by": "R2R",
            },
            "one of R4R, R2R: loses 217.2 ± 4.0 lbf, 25 % of its thrust, declared at 50.16 s, since 50.00 s, "
            "R2R fired alone would tell them apart",
        ),
        (
            {
                "kind": "mass_property_jump",
                "cluster": None,
                "jet": None,
                "magnitude": None,
                "magnitude_std": None,
                "mass": -978.0,
                "mass_std": 35.0,
                "mode": "release",
            },
            "payload released: -978 ± 35 slug, declared at 50.16 s, since 50.00 s",
        ),
        (  # of a run of an earlier version
            {"thrust": None, "mode": None},
            "jet R4R (cluster 12): on, +868.80 ± 0.10 lbf, declared at 50.16 s, since 50.00 s",
        ),
    ],
)
def test_a_detection_is_a_line(capsys: Capture, orbiter: Vehicle, changes: dict[str, Any], line: str) -> None:
    show.declared(STUCK_ON._replace(**changes), orbiter)
    assert capsys.readouterr().out == f"detected:    {line}\n"


def _row(out: str, symbol: str) -> list[str]:
    """Cells of a parameter's row."""
    (line,) = [line for line in out.splitlines() if line.startswith(f"│ {symbol} ")]
    return [cell.strip() for cell in line.strip("│").split("│")]


def test_estimates_stand_beside_the_truth(capsys: Capture, short_run: Run, orbiter: Vehicle, tmp_path: Path) -> None:
    autopilot = short_run.results.autopilot._replace(
        lp_infeasible=2, jets_out_of_use=["R4R", "F2R"], jets_left_in=["L4D"]
    )
    truth = short_run.results.truth.copy()
    truth[6], truth[7] = short_run.results.estimates[6] + 4.0 * short_run.results.standard_deviations[6], 0.0
    percent = short_run.results.percent_error.copy()
    percent[7] = np.nan
    (tmp_path / "report.html").touch()
    (tmp_path / "figures").mkdir()
    results = replace(
        short_run.results,
        autopilot=autopilot,
        truth=truth,
        percent_error=percent,
        detections=(STUCK_ON,),
        derived=short_run.results.derived._replace(physically_possible=False),
    )
    show.simulated(results, orbiter, tmp_path)
    out = capsys.readouterr().out
    assert out.splitlines()[0].rstrip() == "sample_maneuver: orbiter, 6.96 s, seed 0"
    one = results.parameters[0]
    digits = 1 - math.floor(math.log10(1e6 * one.standard_deviation))
    assert _row(out, "Ixx⁻¹") == [
        "Ixx⁻¹",
        "1e-6/(slug-ft^2)",
        f"{1e6 * one.estimate:.{digits}f}",
        f"{1e6 * one.truth:.{digits}f}",
        f"{one.percent_error:+.4f}",
        f"{1e6 * one.standard_deviation:.{digits}f}",
        f"{100.0 * one.standard_deviation / one.estimate:.4f}",
        "yes",
    ]
    assert _row(out, "x_cm")[-1] == "no"
    assert float(_row(out, "y_cm")[3]) == 0.0
    assert float(_row(out, "y_cm")[5]) == pytest.approx(results.standard_deviations[7], rel=0.05)
    assert _row(out, "y_cm")[4:7:2] == ["-", "-"]  # no percentage of nothing
    assert f"over {results.consistency.samples} samples used" in out
    assert "impossible:  no rigid body can have the inertia that was estimated" in out
    assert "of propellant; 2 requests beyond the jets' reach, met as far as they go" in out
    assert "             out of use: R4R, F2R\n" in out
    assert "             left in, though in question: L4D\n" in out
    assert "detected:    jet R4R (cluster 12): stuck on" in out
    assert f"report: {tmp_path}/report.html   figures: {tmp_path}/figures/" in out
    assert "replay" not in out


def test_a_record_has_no_truth_but_warnings(capsys: Capture, short_run: Run, orbiter: Vehicle, tmp_path: Path) -> None:
    known = short_run.results
    estimates = known.estimates.copy()
    estimates[9] = np.nan
    results = replace(
        known,
        estimates=estimates,
        derived=known.derived._replace(mass=None, mass_std=None),
        provenance=known.provenance._replace(telemetry="flight[1].csv"),
        consistency=known.consistency._replace(translation_nis_mean=None),
        timing=known.timing._replace(wall_s=0.5),
        data_quality=QUALITY,
    )
    show.estimated(results, orbiter, tmp_path)
    out = capsys.readouterr().out
    assert out.splitlines()[0].rstrip() == "flight[1].csv: orbiter, 6.96 s"
    assert _row(out, "1/m") == ["1/m", "1/slug", "not observable", "-", "-"]
    assert _row(out, "m") == ["m", "slug", "-", "-", "-"]
    assert known.derived.inertia is not None
    assert known.derived.inertia_std is not None
    value, std = known.derived.inertia[1, 2], known.derived.inertia_std[1, 2]
    number, deviation, percent = map(float, _row(out, "Iyz")[2:])
    power = float(_row(out, "Iyz")[1].split()[0]) if " " in _row(out, "Iyz")[1] else 1.0
    assert (power * number, power * deviation) == pytest.approx((value, std), rel=0.05)
    assert percent == pytest.approx(100.0 * std / abs(value), abs=1e-4)
    assert "warning:     acc[2] stands still\n" in out
    assert "rotation, - translation, over" in out
    assert "samples:     60 rows; 40 used; skipped: 12 coasting, 8 jets changed\n" in out
    assert "detected:    nothing, since no sample was tested\n" in out
    assert "speed:       120 rows a second\n" in out


def test_lines_are_never_broken_nor_read_as_markup(capsys: Capture) -> None:
    line = "[bold]x[/bold] " + "y" * 300
    show.say(line)
    streams.note(line)
    assert capsys.readouterr() == (f"{line}\n", f"massprop: {line}\n")


def test_json_is_whole(capsys: Capture) -> None:
    show.as_json({"b": [1.5, None], "a": "é"})
    assert json.loads(capsys.readouterr().out) == {"b": [1.5, None], "a": "é"}
    with pytest.raises(ValueError, match="JSON"):
        show.as_json(float("nan"))


def test_a_schema_has_a_row_per_key(capsys: Capture) -> None:
    found = [key for key in keys(Scenario) if key.name.startswith("maneuver")]
    show.schema(found)
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    for key in found:
        assert any(line.startswith(f"{key.name} ") for line in lines), key.name


def test_good_files_are_described(orbiter: Vehicle) -> None:
    assert show.about(orbiter) == "vehicle 'orbiter', 44 jets, 1 gyro and 3 accelerometer packages, units us"
    assert show.about(load_scenario("sample_maneuver")) == "scenario 'sample_maneuver', 50 s, vehicle 'orbiter'"


RECORD: dict[str, Any] = {
    "rows": 60,
    "period_s": 0.1,
    "first_s": 0.0,
    "last_s": 5.9,
    "gaps": 0,
    "late": 0,
    "unknown": [],
    "absent": [],
    "completeness": "complete",
    "completeness_detail": [],
}


def test_a_good_record_is_described(orbiter: Vehicle) -> None:
    assert show.about_telemetry(RECORD, None) == "telemetry, 60 rows, 0.1 s apart, from 0 to 5.9 s"
    lost = {"completeness": "truncated", "completeness_detail": ["log.csv: is cut off within line 61"]}
    found = {**RECORD, **lost, "period_s": None, "gaps": 2, "unknown": list("abcdef"), "absent": ["acc2"]}
    assert show.about_telemetry(found, orbiter) == (
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


# -------------------------------------------------------------------------------------------- tables


def _tables(capsys: Capture, monkeypatch: pytest.MonkeyPatch, width: int, run: Run, folder: Path) -> list[str]:
    """What is printed of a run on a terminal of a width."""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", str(width))
    show.simulated(run.results, run.scenario.vehicle_data, folder)
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out).splitlines()


def test_no_number_is_ever_cut(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, short_run: Run, tmp_path: Path
) -> None:
    for width in (160, 100, 80, 60):
        lines = _tables(capsys, monkeypatch, width, short_run, tmp_path)
        assert "…" not in "".join(lines)
        row = next(line for line in lines if "Ixx⁻¹" in line)
        assert max(len(line) for line in lines[: lines.index(row) + 1]) <= max(width, 60)
        shown = [cell for cell in row.replace("│", " ").split() if cell.lstrip("+-").replace(".", "").isdigit()]
        value = short_run.results.parameters[0].estimate
        assert 1e-6 * float(shown[0]) == pytest.approx(value, rel=0.05)
    assert len(shown) == 3  # of the narrowest: estimate, error, 1-sigma


def test_a_phone_s_width_has_a_line_for_each_number(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, short_run: Run, tmp_path: Path
) -> None:
    lines = _tables(capsys, monkeypatch, 40, short_run, tmp_path)
    first = lines.index("Ixx⁻¹, 1e-6/(slug-ft^2)")
    assert [line.split("  ")[1] for line in lines[first + 1 : first + 4]] == ["estimate", "error %", "1-sigma"]
    estimate = float(lines[first + 1].split()[-1])
    assert 1e-6 * estimate == pytest.approx(short_run.results.parameters[0].estimate, rel=0.05)
    below = next(number for number, line in enumerate(lines) if line.startswith("files:"))  # paths stay whole
    assert max(map(len, lines[:below])) <= 40


FOUND = {
    "vehicles": {"free_flyer": f"A 4.3 kg free flyer {'with thrusters ' * 5}and no wheels"},
    "campaigns": {"sampling_period": "How often to read"},
}


@pytest.mark.parametrize("width", [None, 60, 80, 100, 140, 200])
def test_a_list_uses_the_width_of_the_terminal(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, width: int | None
) -> None:
    if width is not None:
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    show.listing(FOUND)
    lines = [line.rstrip() for line in re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out).splitlines()]
    text = FOUND["vehicles"]["free_flyer"]
    told = " ".join(" ".join(lines).split())
    assert text in told
    if width is None:
        assert lines == [f"vehicle   free_flyer       {text}", "campaign  sampling_period  How often to read"]
        return
    assert max(map(len, lines)) <= width
    column = 4 if width <= 80 else 27  # a narrow terminal has descriptions below names
    assert len(lines) == 2 * (width <= 80) + 1 + -(-len(text) // (width - column))


@pytest.mark.parametrize(
    ("factor", "words"), [(0.0, "0"), (0.042, "0.042"), (0.5, "0.5"), (1.26, "1.3"), (9.96, "10"), (733.2, "733")]
)
def test_the_speed_is_a_number_however_slow(
    capsys: Capture, stuck_run: Run, tmp_path: Path, factor: float, words: str
) -> None:
    results = replace(stuck_run.results, timing=stuck_run.results.timing._replace(real_time_factor=factor))
    show.simulated(results, stuck_run.scenario.vehicle_data, tmp_path)
    assert f"speed:       {words} times real time\n" in capsys.readouterr().out


def test_lines_are_broken_between_words_on_a_terminal_alone(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    said = "detected:    jump: +30.11 ± 0.22 kg at (+0.8977 ± 0.0050, -0.00032 ± 0.00034) m"
    show.Terminal(120).say(said)
    assert capsys.readouterr().out.splitlines() == [said]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "40")
    show.Terminal().say(said)
    assert capsys.readouterr().out.splitlines() == [
        "detected:    jump: +30.11 ± 0.22 kg at",
        "             (+0.8977 ± 0.0050,",
        "             -0.00032 ± 0.00034) m",
    ]


def test_eighty_columns_hold_all_that_matters(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, short_run: Run, tmp_path: Path
) -> None:
    heading = _tables(capsys, monkeypatch, 80, short_run, tmp_path)[1]
    assert heading.startswith("parameter")
    for words in ("unit", "estimate", "truth", "error %", "1-sigma", "in 3 sigma"):
        assert words in heading


@pytest.mark.parametrize(
    ("value", "deviation", "expected"),
    [
        (1.14322e-6, 1.15e-10, "1.14322"),
        (5.0e-11, 9.6e-12, "50.0"),
        (5909.2, 282.0, "5909"),
        (895348.0, 1610.0, "895.3"),
        (0.0, 1e-9, "0.0"),
        (32.1, 0.0, "32.1000"),
        (-0.06, 5e-9, "-0.0600000"),
    ],
)
def test_a_number_has_two_digits_of_its_sigma_and_six_at_most(value: float, deviation: float, expected: str) -> None:
    assert table._scaled(value, deviation, table._power(value, math.nan, deviation)) == expected


@pytest.mark.parametrize(
    ("unit", "power", "expected"),
    [("1/slug", -6, "1e-6/slug"), ("slug-ft^2", 3, "1e3 slug-ft^2"), ("ft", 0, "ft")],
)
def test_a_unit_has_the_power_of_ten(unit: str, power: int, expected: str) -> None:
    assert table._in_power(unit, power) == expected
