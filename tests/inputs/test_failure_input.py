"""Failures and payloads that cannot be: one message each that says what, where, and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from massprop_drake import load_scenario
from massprop_drake.cli.main import main
from massprop_drake.errors import InputError

ORBITER_MASS = 5908.1093  # slug, table 5-2


def problems_of(text: str, folder: Path) -> tuple[str, ...]:
    """What loading a scenario file with this text complains about."""
    path = folder / "case.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as raised:
        load_scenario(path)
    return raised.value.problems


def failures(*entries: str) -> str:
    return "duration_s: 60\nfailures:\n" + "".join(f"  - {{{entry}}}\n" for entry in entries)


def jumps(*entries: str) -> str:
    return "duration_s: 60\njumps:\n" + "".join(f"  - {{{entry}}}\n" for entry in entries)


ON_R4R = "kind: stuck_on, jet: R4R, start_s: 50"

# text of the file, line and field that the message names, words it says
BAD = {
    "unknown jet": (
        failures("kind: stuck_on, jet: R4X, start_s: 50"),
        "line 3: failures[0].jet:",
        ["'R4X' is no jet of vehicle 'orbiter'", "did you mean 'R4"],
    ),
    "a jet's number in place of its designation": (
        failures(ON_R4R, "kind: stuck_off, jet: 11, start_s: 56"),
        "line 4: failures[1].jet:",
        ["string"],
    ),
    "onset before the start": (
        failures("kind: stuck_on, jet: R4R, start_s: -1"),
        "line 3: failures[0].start_s:",
        ["greater than or equal to 0", "-1"],
    ),
    "end before onset": (
        failures("kind: stuck_on, jet: R4R, start_s: 50, end_s: 40"),
        "line 3: failures[0]:",
        ["end_s must be later than start_s", "50 to 40"],
    ),
    "end at onset": (
        failures("kind: leak, jet: R4R, start_s: 50, end_s: 50, force: 3"),
        "line 3: failures[0]:",
        ["end_s must be later than start_s"],
    ),
    "fraction above one": (
        failures("kind: degraded, jet: R4R, start_s: 50, fraction: 1.5"),
        "line 3: failures[0].fraction:",
        ["less than or equal to 1", "1.5"],
    ),
    "fraction below zero": (
        failures("kind: degraded, jet: R4R, start_s: 50, fraction: -0.1"),
        "line 3: failures[0].fraction:",
        ["greater than or equal to 0", "-0.1"],
    ),
    "fraction missing": (
        failures("kind: degraded, jet: R4R, start_s: 50"),
        "line 3: failures[0].fraction:",
        ["required"],
    ),
    "leak without force": (
        failures("kind: leak, jet: R4R, start_s: 50, force: 0"),
        "line 3: failures[0].force:",
        ["greater than 0"],
    ),
    "force of what does not leak": (
        failures("kind: stuck_on, jet: R4R, start_s: 50, force: 3"),
        "line 3: failures[0].force:",
        ["is a key of kind: leak, and the kind is stuck_on"],
    ),
    "probability above one": (
        failures("kind: intermittent, jet: R4R, start_s: 50, probability: 2"),
        "line 3: failures[0].probability:",
        ["less than or equal to 1"],
    ),
    "onset not a number": (
        failures("kind: stuck_on, jet: R4R, start_s: .nan"),
        "line 3: failures[0].start_s:",
        ["finite"],
    ),
    "unknown kind": (
        failures("kind: stuckon, jet: R4R, start_s: 50"),
        "line 3: failures[0]",
        ["'stuckon'", "stuck_on, stuck_off, degraded, leak, intermittent, drift"],
    ),
    "missing kind": (
        failures("jet: R4R, start_s: 50"),
        "line 3: failures[0]",
        ["missing kind", "stuck_on, stuck_off, degraded, leak, intermittent, drift"],
    ),
    "release of more than there is": (
        jumps("kind: release, time_s: 45, mass: 6000, position: [32, 0, 2]"),
        "line 3: jumps[0].mass:",
        ["6000", "5908.11"],
    ),
    "release of the rest, after another": (
        jumps(
            "kind: release, time_s: 45, mass: 3000, position: [32, 0, 2]",
            "kind: release, time_s: 46, mass: 3000, position: [32, 0, 2]",
        ),
        "line 4: jumps[1].mass:",
        ["3000", "2908.11"],
    ),
    "release that leaves an impossible inertia": (
        jumps("kind: release, time_s: 45, mass: 1000, position: [500, 0, 0]"),
        "line 3: jumps[0]:",
        ["inertia", "no rigid body"],
    ),
    "payload of an impossible inertia": (
        jumps(
            "kind: release, time_s: 45, mass: 100, position: [32, 0, 2], inertia: [[9e8, 0, 0], [0, 1, 0], [0, 0, 1]]"
        ),
        "line 3: jumps[0]",
        ["inertia"],
    ),
    "payload without mass": (
        jumps("kind: dock, time_s: 45, mass: 0, position: [32, 0, 2]"),
        "line 3: jumps[0].mass:",
        ["greater than 0"],
    ),
    "jump before the start": (
        jumps("kind: dock, time_s: -45, mass: 10, position: [32, 0, 2]"),
        "line 3: jumps[0].time_s:",
        ["greater than or equal to 0"],
    ),
    "unknown kind of jump": (
        jumps("kind: explode, time_s: 45, mass: 10, position: [32, 0, 2]"),
        "line 3: jumps[0].kind:",
        ["'explode'", "'release' or 'dock'"],
    ),
    "place of two numbers": (
        jumps("kind: dock, time_s: 45, mass: 10, position: [32, 0]"),
        "line 3: jumps[0].position",
        ["3 values", "got 2"],
    ),
    "unknown reaction": (
        "detector: {kind: cglr, on_detection: ignore}\n",
        "line 1: detector.on_detection:",
        ["'ignore'", "'correct'"],
    ),
    "no alarms to declare": (
        "detector: {kind: cglr, reconfigure_after: 0}\n",
        "line 1: detector.reconfigure_after:",
        ["greater than or equal to 1"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_refused_with_file_line_and_field(case: str, tmp_path: Path) -> None:
    text, place, words = BAD[case]
    (problem,) = problems_of(text, tmp_path)
    assert problem.startswith(f"{tmp_path / 'case.yaml'}, {place}"), problem
    for word in words:
        assert word in problem


OVERLAPS = {
    "one within another": ("kind: stuck_on, jet: R4R, start_s: 50", "kind: stuck_off, jet: R4R, start_s: 55"),
    "the same time": (
        "kind: leak, jet: R4R, start_s: 50, end_s: 52, force: 3",
        "kind: stuck_off, jet: R4R, start_s: 50, end_s: 52",
    ),
    "the later one first": (
        "kind: stuck_off, jet: R4R, start_s: 54",
        "kind: stuck_on, jet: R4R, start_s: 50, end_s: 54.5",
    ),
}


@pytest.mark.parametrize("case", OVERLAPS)
def test_a_jet_fails_in_one_way_at_a_time(case: str, tmp_path: Path) -> None:
    (problem,) = problems_of(failures(*OVERLAPS[case]), tmp_path)
    assert str(tmp_path / "case.yaml") in problem
    assert "failures[1]: overlaps failures[0]" in problem
    assert "R4R" in problem


def test_failures_of_one_jet_after_another_and_of_two_jets_at_once_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(
        failures(
            "kind: stuck_on, jet: R4R, start_s: 50, end_s: 52",
            "kind: stuck_off, jet: R4R, start_s: 52",
            "kind: stuck_on, jet: F2R, start_s: 50",
            "kind: degraded, jet: F1L, start_s: 0, fraction: 0",
            "kind: intermittent, jet: F1D, start_s: 0, probability: 1, level: 1",
            "kind: drift, jet: L1A, start_s: 5, rate_per_s: -0.001",
        ),
        encoding="utf-8",
    )
    assert [entry.kind for entry in load_scenario(path).failures] == [
        "stuck_on",
        "stuck_off",
        "stuck_on",
        "degraded",
        "intermittent",
        "drift",
    ]


def test_payloads_that_fit_are_fine(tmp_path: Path) -> None:
    # the second may only go because the first came before
    path = tmp_path / "case.yaml"
    path.write_text(
        jumps(
            "kind: release, time_s: 46, mass: 6000, position: [32.1, 0, 2]",
            "kind: dock, time_s: 45, mass: 6000, position: [32.1, 0, 2]",
        ),
        encoding="utf-8",
    )
    assert [entry.kind for entry in load_scenario(path).jumps] == ["release", "dock"]


def test_the_true_mass_counts_not_the_nominal_one(tmp_path: Path) -> None:
    true = "plant: {mass_properties: {mass: 900, center_of_mass: [32, 0, 2], inertia: [[9e5, 0, 0], [0, 7e6, 0], [0, 0, 7e6]]}}\n"  # noqa: E501
    release = jumps("kind: release, time_s: 45, mass: 1000, position: [32, 0, 2]")
    assert ORBITER_MASS > 1000.0
    (problem,) = problems_of(true + release, tmp_path)
    assert "jumps[0].mass" in problem
    assert "900" in problem


def test_an_override_is_checked_like_a_file() -> None:
    with pytest.raises(InputError, match=r"failures\[0\].jet.*'R4Q' is no jet"):
        load_scenario("stuck_on_29", ["failures[0].jet=R4Q"])
    with pytest.raises(InputError, match=r"failures\[0\].start_s"):
        load_scenario("stuck_on_29", ["failures[0].start_s=-5"])


@pytest.mark.parametrize("case", ["unknown jet", "release of more than there is", "missing kind", "fraction above one"])
def test_the_command_line_says_so_once_and_ends_with_status_2(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text, place, words = BAD[case]
    path = tmp_path / "case.yaml"
    path.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    monkeypatch.setattr("sys.argv", ["massprop", "run", str(path), "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    message = " ".join(printed.err.split())  # one message, however the terminal wraps it
    assert message.startswith("massprop: ")
    assert message.count("massprop: ") == 1
    assert place in message
    for word in words:
        assert word in message
    assert "Traceback" not in message
    assert not out.exists()
