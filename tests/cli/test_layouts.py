"""No file of the user is lost, however inputs and outputs lie in, above, below and beside each other.

Each seed makes a layout: runs of ours (some without manifest, as earlier versions wrote them), files of the user in and
beside them, links, and a command whose inputs and output are drawn from all of these. MASSPROP_LAYOUTS says how many.
"""

from __future__ import annotations

import os
import random
import shutil
from collections import Counter
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from command_probe import Massprop

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.display import flight3d, graphs
from massprop_drake.results import manifest

COUNT = int(os.environ.get("MASSPROP_LAYOUTS", "15"))
FOLDERS = ("K", "K/inner", "data", "data/K", "K.1", "a/b")
NEW = ("new", "K/new", "data/new/deep", "K.2", "page.html", "K/page.html", "data/replay.html")
OURS = ("report.html", "replay.html", "autopilot.dot", "summary.json", "manifest.json", "figures/rates.png")
LINKS = {"to_K": "K", "dangling": "nowhere", "K/to_data": "../data", "data/to_K": "../K", "to_log": "K/logs/flight.csv"}
LEAN = ("--no-report", "--no-figures", "-q")


@pytest.fixture(scope="module")
def ready_run() -> Run:
    return simulate(load_scenario("sample_maneuver", ["duration_s=1"]))


@pytest.fixture(scope="module")
def earlier(ready_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder to be copied."""
    return ready_run.save(tmp_path_factory.mktemp("layouts") / "run", pictures=False)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, ready_run: Run) -> None:
    """What takes long costs nothing; everything that is read and written is real."""
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", lambda *_, **__: ready_run)
    monkeypatch.setattr(flight3d, "replay_html", lambda _: "<!DOCTYPE html>")
    monkeypatch.setattr(graphs, "build", lambda name, *_: name)
    monkeypatch.setattr(graphs, "dot_text", lambda name, _: f"digraph {name}")
    monkeypatch.setattr(graphs, "overview_text", lambda name: f"digraph {name}")
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)


@cache
def _vehicle() -> bytes:
    """A vehicle's file, whose telemetry is that of the runs."""
    return (resources.files("massprop_drake") / "vehicles" / "orbiter.yaml").read_bytes()


class Layout:
    """Files in the current folder, and a command on them.

    Attributes:
        mine: the user's files with their contents.
        arguments: of the command.
        late: where a file of the user arrives while the command is at work, or None.
    """

    def __init__(self, seed: int, earlier: Path):
        self._random = random.Random(seed)
        self._earlier = earlier
        self.mine: dict[Path, bytes] = {}
        self.runs = [path for path in map(Path, FOLDERS) if self._random.random() < 0.5 and self._make_run(path)]
        for number in range(self._random.randint(2, 6)):
            folder = Path(self._random.choice(FOLDERS))
            name = self._random.choice((f"notes_{number}.txt", f".hidden_{number}", f"logs/{number}.txt", *OURS))
            self._write(folder / name, f"mine {seed} {number}".encode())
        telemetry = (earlier / "telemetry.csv").read_bytes()
        for path in (Path("K/logs/flight.csv"), Path("data/flight.csv")):
            self._write(path, telemetry)
        for folder in (Path("K"), Path("data")):
            self._write(folder / "my_vehicle.yaml", _vehicle())
            scenario = f"name: s{seed}\nvehicle: my_vehicle.yaml\nduration_s: 1\n"
            self._write(folder / "my_scenario.yaml", scenario.encode())
        if self._random.random() < 0.4:  # only what is ours
            self._remove_mine(Path("K"))
        for link, goal in LINKS.items():
            if self._random.random() < 0.5 and Path(link).parent.is_dir() and not os.path.lexists(link):
                Path(link).symlink_to(goal)
        self.links = [Path(link) for link in LINKS if os.path.islink(link)]
        self.arguments = self._command()
        self.late = self._out / "late.txt" if self._random.random() < 0.2 else None

    def _make_run(self, path: Path) -> bool:
        shutil.copytree(self._earlier, path, dirs_exist_ok=True)
        if self._random.random() < 0.25:
            (path / "manifest.json").unlink()
            self.mine |= {file: file.read_bytes() for file in path.iterdir() if file.is_file()}
        return True

    def _write(self, path: Path, content: bytes) -> None:
        if path.is_dir() or any(parent.is_file() for parent in path.parents):
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        self.mine[path] = content
        if path.name == manifest.NAME:  # now nobody can tell
            others = [file for file in path.parent.rglob("*") if file.is_file()]
            self.mine |= {file: file.read_bytes() for file in others}

    def _remove_mine(self, folder: Path) -> None:
        found = manifest.read(folder)
        for name in list(manifest.foreign(folder, found)) if found is not None else []:
            path = folder / name.removesuffix(" (changed)")
            shutil.rmtree(path) if path.is_dir() else path.unlink()
            self.mine.pop(path, None)
        for path in [path for path in self.mine if not path.exists()]:
            del self.mine[path]
        for path in sorted(folder.rglob("*"), reverse=True) if folder.is_dir() else []:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()

    def _command(self) -> list[str]:
        draw = self._random.choice
        places = [*FOLDERS, *NEW, *LINKS, ".", "K/logs", "K/../K", "data/flight.csv", str(Path("K").absolute())]
        self._out = Path(draw(places) if self._random.random() < 0.5 or not self.runs else draw(self.runs))
        source = draw([*map(str, self.runs), "K", "to_K"])
        telemetry = draw(
            ["K/logs/flight.csv", "data/flight.csv", f"{source}/telemetry.csv", "to_log", "to_K/logs/flight.csv"]
        )
        resumed = ["--resume-from", source] if self._random.random() < 0.3 else []
        force = ["--force"] if self._random.random() < 0.3 else []
        command = draw(
            [
                ["run", draw(["sample_maneuver", "K/my_scenario.yaml", "data/my_scenario.yaml", source]), *LEAN],
                ["estimate", telemetry, "--like", source, *resumed, *LEAN],
                ["estimate", telemetry, "--vehicle", draw(["orbiter", "K/my_vehicle.yaml"]), *resumed, *LEAN],
                ["view", source, "-q"],
                ["graph", "autopilot", "-q"],
                ["reproduction", "--only", "fig_1_1", "-q"],
            ]
        )
        out = [] if command[0] == "view" and self._random.random() < 0.5 else ["--out", str(self._out)]
        return [*command, *out, *force]


def _files() -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file() and not path.is_symlink()}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("seed", range(COUNT))
def test_no_file_of_the_user_is_lost(
    seed: int, massprop: Massprop, reproduction: Massprop, monkeypatch: pytest.MonkeyPatch, earlier: Path
) -> None:
    layout = Layout(seed, earlier)
    before, saved, came = _files(), Run.save, []

    def late(self: Run, *arguments: Any, **options: Any) -> Path:
        if layout.late is not None and layout.late.parent.is_dir():
            came.append(layout.late.write_bytes(b"late"))
        return saved(self, *arguments, **options)

    monkeypatch.setattr(Run, "save", late)
    command, *options = layout.arguments
    done = reproduction(*options) if command == "reproduction" else massprop(command, *options)
    told = f"massprop {' '.join(layout.arguments)}: {done}"
    assert done.status in (0, 2), told
    assert done.err.count("\n") == (1 if done.status else 0) or "graph" in layout.arguments, told
    after = _files()
    if "--force" in layout.arguments:  # it may have another name
        assert not Counter(layout.mine.values()) - Counter(after.values()), told
    else:
        assert not [path for path, content in layout.mine.items() if after.get(path) != content], told
        assert all(os.path.islink(link) for link in layout.links), told
    if came:
        assert b"late" in after.values(), told
    elif done.status:
        assert after == before, told
    assert not list(Path().rglob(".massprop-*")), told
