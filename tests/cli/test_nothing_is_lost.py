"""A single file that is written takes the place of nothing that is read, nor of a part of a run or a campaign."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from campaign_rows import SWEPT, folder, many
from command_probe import Massprop, contents, require_refused
from record_probe import flight, usual_columns, write_bag, write_csv

from massprop_drake import Run, load_vehicle
from massprop_drake.inputs.model import yaml_text
from massprop_drake.results.folder import write_files

EXPORTS = ("run.mcap", "run.rrd")
RUN_FILES = (
    *("scenario.yaml", "summary.json", "telemetry.csv", "history.npz", "filter_state.json", "manifest.json"),
    *("report.html", "replay.html", *EXPORTS, "figures/rates.png"),
)
CAMPAIGN_FILES = (
    *("campaign.yaml", "base.yaml", "plan.parquet", "results/000000-000011.parquet", ".massprop", "manifest.json"),
    *("summary.json", "campaign.html", "cases/0001/summary.json", "cases/0001/report.html"),
)
OWNED = [f"A/{name}" for name in RUN_FILES if name not in ("scenario.yaml", "history.npz", "filter_state.json")]
OWNED += ["B/summary.json", "B/report.html"]
OWNED += [f"K/{name}" for name in CAMPAIGN_FILES if name not in ("base.yaml", ".massprop", "cases/0001/report.html")]
READ = ["log.csv", "bag/metadata.yaml", "bag/bag.db3", "vehicle.yaml"]
OTHERS = ["notes.txt", "A/notes.txt"]
COMMANDS = {
    "compare": ("compare", "A", "B"),
    "view": ("view", "A"),
    "view of a case": ("view", "K/cases/0001"),
    "campaign compare": ("campaign", "compare", "K"),
    "export": ("export", "A", "--to", "mcap"),
    "map": ("map", "log.csv", "--vehicle", "vehicle.yaml"),
    "map of a bag": ("map", "bag", "--vehicle", "vehicle.yaml"),
}
READS = {"map": {"log.csv", "vehicle.yaml"}, "map of a bag": {"bag/metadata.yaml", "bag/bag.db3", "vehicle.yaml"}}
# and what leads to it
REWRITTEN: dict[tuple[str, str], set[str]] = {
    ("view", "A/replay.html"): {"A/report.html"},
    ("export", "A/run.mcap"): set(),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, short_run: Run) -> Path:
    """Two runs, a campaign, two records, a vehicle and notes of a user."""
    here = tmp_path_factory.mktemp("built")
    before = Path.cwd()
    os.chdir(here)
    try:
        for name in ("A", "B", "K/cases/0001"):
            short_run.save(here / name, pictures=False, report=False)
            pages = dict.fromkeys(("figures/rates.png", "report.html", "replay.html", *EXPORTS), b"a page")
            write_files(here / name, pages)
        shutil.move("K", "kept")
        folder(Path("K"), SWEPT.format(cases=6), many(2, 6))
        shutil.move("kept/cases", "K/cases")
        write_files(here / "K", {"summary.json": b"{}", "campaign.html": b"a page"})
        vehicle = load_vehicle("free_flyer")
        (here / "vehicle.yaml").write_text(yaml_text(vehicle), encoding="utf-8")
        one = flight(vehicle)
        write_csv(here / "log.csv", usual_columns(one))
        write_bag(here / "bag", one, "sqlite3")
        for name in OTHERS:
            (here / name).write_text("mine", encoding="utf-8")
    finally:
        os.chdir(before)
    return here


@pytest.fixture
def here(massprop: Massprop, built: Path) -> Path:
    """A copy of them, in the folder that the command works in."""
    assert massprop("--version").status == 0
    shutil.copytree(built, ".", dirs_exist_ok=True)
    return Path()


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("command", COMMANDS)
def test_no_file_is_lost(massprop: Massprop, command: str) -> None:
    before = contents()
    for target in (*OWNED, *READ, *OTHERS):
        for force in ((), ("--force",)):
            done = massprop(*COMMANDS[command], "--out", target, *force, "-q")
            after = contents()
            if (command, target) in REWRITTEN:
                assert done == (0, "", "")
                assert before.keys() == after.keys()
            elif force and done.status == 0:
                assert target not in {*OWNED, *READS.get(command, ())}
                assert after[f"{target}.1"] == before[target]
            else:
                require_refused(done, f"massprop: {target}: ", "; give another place")
                assert after == before
            changed = {name for name in before if after[name] != before[name]}
            assert changed <= {target, "A/manifest.json", *REWRITTEN.get((command, target), ())}
            before = after


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("B/../A/summary.json", "belongs to what is read, A"),
        ("link_to_K/plan.parquet", "belongs to the work in"),
        ("link_to_K/cases/../cases/0001/history.npz", "belongs to the run or campaign in"),
        ("link_to_summary", "belongs to what is read, A"),
        ("A", "cannot be written; give a file in a folder that is there"),
        ("A/summary.json/page.html", "cannot be written; give a file in a folder that is there"),
        ("nowhere/page.html", "cannot be written; give a file in a folder that is there"),
        ("/dev/null", "is no regular file; give another place"),
    ],
)
def test_a_file_is_known_by_any_path(massprop: Massprop, here: Path, target: str, words: str) -> None:
    (here / "link_to_A").symlink_to("A")
    (here / "link_to_K").symlink_to("K")
    (here / "link_to_summary").symlink_to("A/summary.json")
    before = contents()
    for force in ((), ("--force",)):
        for command in (("compare", "A", "B"), ("export", "A", "--to", "rerun")):
            require_refused(massprop(*command, "--out", target, *force), f"massprop: {target}: {words}")
    assert contents() == before
