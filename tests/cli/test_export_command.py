"""`massprop export`: files in a run's folder and elsewhere, and a run that is played."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_probe import Massprop

from massprop_drake import Run
from massprop_drake.cli import exports

pytest.importorskip("foxglove")
pytest.importorskip("rerun")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, short_run: Run) -> Path:
    return short_run.save(tmp_path_factory.mktemp("saved") / "A", pictures=False, report=False)


@pytest.fixture
def folder(massprop: Massprop, saved: Path) -> Path:
    """A run's folder in the folder that the command works in."""
    assert massprop("--version").status == 0
    shutil.copytree(saved, "A")
    return Path("A")


@pytest.mark.parametrize(("to", "name"), [("mcap", "run.mcap"), ("rerun", "run.rrd")])
def test_a_run_is_written_into_its_folder_again_and_again(
    massprop: Massprop, folder: Path, short_run: Run, to: str, name: str
) -> None:
    for _ in range(2):
        done = massprop("export", folder, "--to", to)
        size = (folder / name).stat().st_size
        assert (done.status, done.err) == (0, "")
        samples, signals = short_run.time_s.size, len(short_run.units)
        assert done.out.splitlines()[0] == f"A/{name}: {size / 1e6:.3g} MB, {signals} signals, {samples} samples"
        assert "  lengths of frames and scene are in ft" in done.out.splitlines()
    assert name in json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["files"]
    again = ("run", folder, "--out", "A", "--no-report", "-q", "--force")
    assert massprop(*again).status == 0  # it still is a run of ours


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere", "--to", "mcap"), "nowhere: there is no such run"),
        (("campaign", "--to", "mcap"), "campaign: "),
        (("empty", "--to", "rerun"), "empty: holds no run that can be read"),
        (("A", "--to", "csv"), "'csv' is no format to export to; valid are: mcap, rerun"),
        (("A",), "Missing option '--to'"),
        (("A", "--to", "mcap", "--out", "A/summary.json"), "A/summary.json: belongs to what is read, A"),
        (
            ("A", "--to", "mcap", "--out", "nowhere/a.mcap"),
            "nowhere/a.mcap: cannot be written; give a file in a folder",
        ),
        (("A", "--to", "mcap", "--epoch", "noon"), "--epoch noon: must be seconds since 1970 or a date such as"),
        (("A", "--to", "mcap", "--epoch", "-5"), "run of 'sample_maneuver': has the time -5 s"),
        (("A", "--to", "mcap", "--live", "--out", "a.mcap"), "--live: writes no file; give --out without it"),
        (("A", "--to", "mcap", "--live", "--speed", "0"), "--speed 0: must be a number above zero"),
        (("A", "--to", "rerun", "--live", "--port", "1"), "--port 1: no viewer of Rerun listens there"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_bad_input_is_one_message(massprop: Massprop, arguments: tuple[str, ...], said: str) -> None:
    Path("empty").mkdir()
    Path("campaign").mkdir()
    Path("campaign/plan.parquet").write_bytes(b"")
    done = massprop("export", *arguments)
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1)
    assert done.err.startswith(f"massprop: {said}")
    assert not Path("A/run.mcap").exists()


@pytest.mark.parametrize(
    ("epoch", "seconds"),
    [
        ("1.5e9", 1.5e9),
        ("2026-03-01T12:00:00.5", 1772366400.5),
        ("2026-03-01T12:00:00+02:00", 1772359200.0),
    ],
)
def test_an_epoch_is_seconds_or_a_date(epoch: str, seconds: float) -> None:
    assert exports.parse_epoch(epoch) == seconds
