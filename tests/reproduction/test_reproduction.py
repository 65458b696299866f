"""Every claim of the reference has an entry; entries run, are judged, drawn and reported."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import Massprop
from conftest import REPOSITORY

from massprop_drake.errors import InputError
from reproduction import catalog
from reproduction.cases import Calculation, Case, Flight
from reproduction.claims import AtMost, Claim, Source
from reproduction.entry import Entry
from reproduction.report import Reproduced
from reproduction.reproduce import reproduce
from reproduction.runner import Store, write_result

TEXT = (REPOSITORY / "docs" / "reproduction.md").read_text(encoding="utf-8")

# rows of claims in section 6 of the reference, and the entries that take them up together
ONE = ("fig_1_1", "fig_1_2", "fig_1_3", "fig_1_4", "fig_2_1", "fig_2_2", "fig_3_1", "fig_4_1", "fig_5_1", "fig_5_15")
ROWS: dict[tuple[str, ...], int] = {
    **{(name,): 1 for name in (*ONE, "table_5_1", "table_5_2")},
    ("table_5_3",): 12,  # ten parameters, the acceptance, the best mass
    **{("fig_5_2",): 3, ("fig_5_3",): 2, ("fig_5_4", "fig_5_5"): 5, ("fig_5_6",): 6, ("fig_5_7",): 2, ("fig_5_8",): 4},
    **{("fig_5_9", "fig_5_10"): 2, ("fig_5_11",): 2, ("fig_5_12",): 4, ("fig_5_13",): 3, ("fig_5_14",): 4},
    **{("fig_5_16", "fig_5_17", "fig_5_18"): 6, ("fig_5_19", "fig_5_20", "fig_5_21"): 4},
    **{("fig_5_22", "fig_5_23", "fig_5_24"): 4, ("fig_5_25", "fig_5_26", "fig_5_27"): 3},
    ("section_5_2",): 4,
    ("section_5_3",): 2,  # a failure taken for a jump, the reset (4.3, 4.4)
    ("section_5_3_2",): 4,  # three of claims, one of sigmas
    ("section_6_1",): 5,
}
ENTRIES = {entry.name: entry for entry in catalog.ENTRIES}
CLAIMS = [claim for entry in catalog.ENTRIES for claim in entry.claims]


def test_every_row_of_claims_is_taken_up_and_nothing_else() -> None:
    for names, count in ROWS.items():
        rows = {claim.row for name in names for claim in ENTRIES[name].claims}
        assert rows == set(range(1, count + 1)), names
    assert len(ENTRIES) == len(catalog.ENTRIES)
    assert set(ENTRIES) == {name for names in ROWS for name in names} | {"errata"}
    for entry in catalog.ENTRIES:
        for claim in entry.claims:
            assert (claim.source is Source.ERRATA) == (entry.name == "errata"), claim.text
            # words in parentheses are our reference's
            ours = re.fullmatch(r"\(.*\)", claim.thesis) is not None and claim.source is not Source.ERRATA
            assert (claim.source is Source.REFERENCE) == ours, claim.text


def test_the_counts_in_the_texts_are_of_all_claims() -> None:
    total = Counter(claim.source for claim in CLAIMS)
    said = {
        Source.THESIS: r"Of (\d+) claims that the thesis makes (\d+) hold, (\d+) hold within spread and (\d+) differ\.",
        Source.REFERENCE: r"of our reference (?P<hold>\d+) of (?P<all>\d+) hold, (\d+) within spread, (\d+) differ;",
        Source.ERRATA: r"of the errata (?P<hold>\d+) of (?P<all>\d+) hold, (\d+) within spread, (\d+) differs?\.",
    }
    for source, pattern in said.items():
        (numbers,) = (tuple(map(int, found.groups())) for found in re.finditer(pattern, TEXT))
        of_all, *verdicts = numbers if source is Source.THESIS else (numbers[1], numbers[0], *numbers[2:])
        assert of_all == sum(verdicts) == total[source]


def test_a_case_has_one_meaning_and_is_flown_in_twenty_phases() -> None:
    named: dict[str, Case] = {}
    for name, entry in ENTRIES.items():
        assert entry.pictures or not name.startswith("fig_5_"), name
        for case in entry.cases.values():
            assert named.setdefault(case.name, case) == case, f"two cases are named {case.name}"
            if isinstance(case, Calculation):
                assert "." not in case.function.__qualname__, case.name  # is found by other processes
            elif "sensors.quantizer_phase=equal" not in case.overrides:
                assert case.seeds >= 20, case.name


def test_an_entry_is_run_judged_drawn_and_reported(tmp_path: Path) -> None:
    thesis = "it turns & stops"
    claim = Claim(1, "largest <rate> | first", thesis, AtMost(1.0), lambda phase: float(phase["with"]["time_s"].size))
    entry = ENTRIES["fig_5_8"]
    cases = {
        label: replace(
            case, overrides=(*case.overrides, "duration_s=2.4"), name=f"short_{label}", seeds=1 + (label == "with")
        )
        for label, case in entry.cases.items()
        if isinstance(case, Flight)
    }
    entry = replace(entry, cases=cases, claims=(claim,))
    said: list[tuple[int, int]] = []
    (result,) = reproduce([entry], tmp_path, lambda *step: said.append(step))
    assert (said[0], said[-1]) == ((0, 5), (5, 5))
    assert result.outcomes[0].verdict == "differs"
    assert (tmp_path / "figures" / "fig_5_8.png").read_bytes().startswith(b"\x89PNG")
    row = "| largest <rate> \\| first | thesis | it turns & stops | ≤ 1 | 31 | differs |"
    assert row in (tmp_path / "reproduction.md").read_text(encoding="utf-8")
    page = (tmp_path / "reproduction.html").read_text(encoding="utf-8")
    assert "largest &lt;rate&gt; | first" in page
    assert "data:image/png;base64," in page
    data = json.loads((tmp_path / "reproduction.json").read_text(encoding="utf-8"))
    assert data["verdicts"] == {"holds": 0, "holds within spread": 0, "differs": 1}
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    reproduce([entry], tmp_path)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()} == before


def reproduced(entry: Entry, folder: Path) -> Reproduced:
    """The result of an entry whose runs are made here and not in processes of their own, which takes their start."""
    reproduce([], folder)
    store = Store(folder / "cache")
    for case in entry.cases.values():
        write_result(store.path(case, 0), case.run(0))
    (result,) = reproduce([entry], folder)
    return result


def test_pictures_of_a_failure_are_drawn(tmp_path: Path) -> None:
    # a leak at rest, with mass properties that are known well: no maneuver is needed to learn them
    given = "estimation={filter: thesis, start: nominal, std_fraction: 0.001, floors: false}"
    entry = ENTRIES["fig_5_26"]
    flight = entry.cases["flight"]
    assert isinstance(flight, Flight)
    quick = (*flight.overrides, given, "maneuver=[]", "duration_s=52", "execution.engine=loop")
    short = replace(flight, name="leak_at_rest", overrides=quick, from_s=45.0, seeds=1)
    kept = ("margin (b) at the first sample", "samples that name a jet")
    claims = tuple(claim for claim in entry.claims if claim.text in kept)
    result = reproduced(replace(entry, cases={"flight": short}, claims=claims), tmp_path)
    assert [str(outcome.verdict) for outcome in result.outcomes] == ["holds", "holds"]
    assert (tmp_path / "figures" / "fig_5_26.png").stat().st_size > 5000


def test_the_noise_free_tests_agree_with_the_sampled_ones() -> None:
    # sigma of a force from the noise-free tests, against the scatter of the argument's root over drawn samples
    from reproduction import analytic  # noqa: PLC0415 (slow to load)

    exact = analytic.separations(0)
    tests, isolation = analytic.noise_free_tests(39, 24.483, ())
    assert tests.likelihood[38] == pytest.approx(exact["argument"][38] * 24.483**2, rel=1e-12)
    assert isolation.cluster_margin == pytest.approx(exact["cluster_margin"][38] * 24.483**2, rel=1e-12)
    named = np.mean([analytic.vernier_gaussian(seed)["best"].mean() for seed in range(3)])
    # two jets alike but for a margin of 2.82: the right one wins with probability Phi(sqrt(2.82) / 2)
    assert named == pytest.approx(0.80, abs=0.04)


def test_the_example_of_the_docs_is_an_entry(tmp_path: Path) -> None:
    (code,) = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.DOTALL | re.MULTILINE)
    scope: dict[str, Any] = {"__name__": "docs"}  # a module that is not run
    exec(compile(code, "reproduction.md", "exec"), scope)
    quick = replace(scope["RELEASE"], overrides=("duration_s=2", "jumps=[]"), seeds=1)
    result = reproduced(replace(scope["ENTRY"], cases={"flight": quick}), tmp_path)
    assert result.outcomes[0].verdict == "holds"
    assert [picture.name for picture in result.pictures] == ["fig_release.png"]


def test_the_command_prints_claims_and_verdicts(reproduction: Massprop, tmp_path: Path) -> None:
    status, out, err = reproduction("--only", "table_5_1", "--only", "table_5_2", "--out", tmp_path / "new")
    assert (status, err) == (0, "")
    assert "Table 5-1: RCS jet data" in out
    assert "4 claims of the thesis: 4 holds, 0 holds within spread, 0 differs. Apart from these:" in out
    assert "4 numbers of our reference: 4 holds" in " ".join(out.split())
    status, out, _ = reproduction("--only", "table_5_2", "--out", tmp_path / "new", "--json")
    assert [entry["name"] for entry in json.loads(out)["entries"]] == ["table_5_2"]
    status, out, err = reproduction("--only", "fig_5_66", "--out", tmp_path / "none")
    assert (status, out, (tmp_path / "none").exists()) == (2, "", False)
    assert "'fig_5_66' is no figure or table of the reproduction; did you mean 'fig_5_6'?" in err
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("mine")
    for place, words in ((tmp_path / "mine", "holds files"), (tmp_path / "mine" / "letter.txt", "is a file")):
        with pytest.raises(InputError, match=words):
            reproduce([ENTRIES["table_5_1"]], place)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["letter.txt"]
    text = " ".join(re.sub(r"\x1b\[[0-9;]*m", "", reproduction("--help").out).split())
    assert "Usage: python -m reproduction [OPTIONS]" in text
    assert "Example: python -m reproduction --only" in text.replace("`", "")


def test_the_program_runs_in_a_checkout(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "reproduction", "--only", "fig_5_1", "--out", str(tmp_path / "new")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Figure 5-1: RCS jet locations" in done.stdout
    assert {path.name for path in (tmp_path / "new").iterdir()} >= {"reproduction.html", "reproduction.md", "figures"}
