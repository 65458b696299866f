"""No file of the user is lost, however inputs and outputs lie in, above, below and beside each other.

Each seed makes a layout: runs of ours (some without manifest), files of the user in and beside them, links, and a
command whose inputs and output are drawn from all of these. MASSPROP_LAYOUTS says how many.
"""

from __future__ import annotations

import os
import random
import shutil
from collections import Counter
from pathlib import Path

import pytest
from command_probe import Massprop

from massprop_drake import Run, load_vehicle
from massprop_drake.display import flight3d, graphs
from massprop_drake.inputs.model import yaml_text
from massprop_drake.results import manifest

COUNT = int(os.environ.get("MASSPROP_LAYOUTS", "30"))
FOLDERS = ("K", "K/inner", "data", "data/K", "K.1", "a/b")
NEW = ("new", "K/new", "data/new/deep", "K.2", "page.html", "K/page.html", "data/replay.html")
OURS = ("report.html", "replay.html", "autopilot.dot", "summary.json", "manifest.json", "figures/rates.png")
LINKS = {"to_K": "K", "dangling": "nowhere", "K/to_data": "../data", "data/to_K": "../K", "to_log": "K/logs/flight.csv"}
LEAN = ("--no-report", "--no-figures", "-q")


@pytest.fixture(scope="module")
def earlier(short_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder to be copied."""
    return short_run.save(tmp_path_factory.mktemp("layouts") / "run", pictures=False)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, short_run: Run) -> None:
    """What takes long costs nothing; everything that is read and written is real."""
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", lambda *_, **__: short_run)
    monkeypatch.setattr(flight3d, "replay_html", lambda _: "<!DOCTYPE html>")
    monkeypatch.setattr(graphs, "build", lambda name, *_: name)
    monkeypatch.setattr(graphs, "dot_text", lambda name, _: f"digraph {name}")
    monkeypatch.setattr(graphs, "overview_text", lambda name: f"digraph {name}")
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)


class Layout:
    """Files in the current folder; `mine` holds the user's with their contents."""

    def __init__(self, seed: int, earlier: Path):
        self._random, self._earlier = random.Random(seed), earlier
        self.mine: dict[Path, bytes] = {}
        self.runs = [path for path in map(Path, FOLDERS) if self._random.random() < 0.5]
        for path in self.runs:
            shutil.copytree(earlier, path, dirs_exist_ok=True)
            if self._random.random() < 0.25:
                self._loses_manifest(path)
        for number in range(self._random.randint(2, 6)):
            name = self._random.choice((f"notes_{number}.txt", f".hidden_{number}", f"logs/{number}.txt", *OURS))
            self._write(Path(self._random.choice(FOLDERS)) / name, f"mine {seed} {number}".encode())
        vehicle = yaml_text(load_vehicle("orbiter")).encode()
        for place in ("K/logs/flight.csv", "data/flight.csv"):
            self._write(Path(place), (earlier / "telemetry.csv").read_bytes())
        for folder in (Path("K"), Path("data")):
            self._write(folder / "my_vehicle.yaml", vehicle)
            scenario = f"name: s{seed}\nvehicle: my_vehicle.yaml\nduration_s: 1\n"
            self._write(folder / "my_scenario.yaml", scenario.encode())
        for link, goal in LINKS.items():
            if self._random.random() < 0.5 and Path(link).parent.is_dir() and not os.path.lexists(link):
                Path(link).symlink_to(goal)
        self.links = [Path(link) for link in LINKS if os.path.islink(link)]

    def _loses_manifest(self, folder: Path) -> None:
        """Nobody can tell any more whose the files of a folder are."""
        (folder / manifest.NAME).unlink(missing_ok=True)
        self.mine |= {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}

    def _write(self, path: Path, content: bytes) -> None:
        if path.is_dir() or any(parent.is_file() for parent in path.parents):
            return
        if path.name == manifest.NAME and path.parent.is_dir():
            self._loses_manifest(path.parent)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        self.mine[path] = content

    def command(self) -> list[str]:
        """A command on them."""
        draw = self._random.choice
        places = [*FOLDERS, *NEW, *LINKS, ".", "K/logs", "K/../K", "data/flight.csv", str(Path("K").absolute())]
        out = Path(draw(places) if self._random.random() < 0.5 or not self.runs else draw(self.runs))
        source = draw([*map(str, self.runs), "K", "to_K"])
        logs = ["K/logs/flight.csv", "data/flight.csv", f"{source}/telemetry.csv", "to_log", "to_K/logs/flight.csv"]
        resumed = ["--resume-from", source] if self._random.random() < 0.3 else []
        command = draw(
            [
                ["run", draw(["sample_maneuver", "K/my_scenario.yaml", "data/my_scenario.yaml", source]), *LEAN],
                ["estimate", draw(logs), "--like", source, *resumed, *LEAN],
                ["estimate", draw(logs), "--vehicle", draw(["orbiter", "K/my_vehicle.yaml"]), *resumed, *LEAN],
                ["view", source, "-q"],
                ["graph", "autopilot", "-q"],
            ]
        )
        where = [] if command[0] == "view" and self._random.random() < 0.5 else ["--out", str(out)]
        return [*command, *where, *(["--force"] if self._random.random() < 0.3 else [])]


def _files() -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file() and not path.is_symlink()}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("seed", range(COUNT))
def test_no_file_of_the_user_is_lost(seed: int, massprop: Massprop, earlier: Path) -> None:
    layout = Layout(seed, earlier)
    before, command = _files(), layout.command()
    done = massprop(*command)
    told = f"massprop {' '.join(command)}: {done}"
    assert done.status in (0, 2), told
    assert done.err.count("\n") == (1 if done.status else 0) or "graph" in command, told
    after = _files()
    if "--force" in command:  # it may have another name
        assert not Counter(layout.mine.values()) - Counter(after.values()), told
    else:
        assert not [path for path, content in layout.mine.items() if after.get(path) != content], told
        assert all(os.path.islink(link) for link in layout.links), told
    assert not done.status or after == before, told
    assert not list(Path().rglob(".massprop-*")), told
