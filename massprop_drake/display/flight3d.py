"""The replay of a run in three dimensions, as one HTML file that plays offline."""

from __future__ import annotations

from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import events, templates
from massprop_drake.display.stage import SHOWN, Stage
from massprop_drake.display.style import (
    ESTIMATE_COLOR,
    FAILED_COLOR,
    PLUME_COLOR,
    SUSPECT_COLOR,
    TRUTH_COLOR,
)
from massprop_drake.inputs import params
from massprop_drake.maths.attitude import propagated
from massprop_drake.maths.mass_properties import CENTER_OF_MASS
from massprop_drake.results.folder import write_page

if TYPE_CHECKING:
    from massprop_drake.results.run import Run

Array = NDArray[np.float64]

_HERE = Path(__file__).parent
_FRAMES = 3000  # of the body's motion at the most
# Meshcat writes its own styles, and reads the scene from addresses that hold it
_MESHCAT = {"style-src": "'unsafe-inline'", "connect-src": "data:"}


def write_replay(run: Run, path: str | Path, *, force: bool = False) -> Path:
    """Writes the replay of a run.

    Where the truth is unknown, attitude is integrated from the gyro and thrust taken from the commands.

    Args:
        run: simulated, or estimated from telemetry.
        path: the HTML file to write; it appears whole or not at all, and replaces nothing but a page of ours.
        force: keep a file that is there and not ours as `<path>.1`, `<path>.2`, ....

    Raises:
        InputError: when a file is there that is not ours, or it cannot be written.
    """
    target = Path(path)
    write_page(target, replay_html(run), force=force)
    return target


def replay_html(run: Run) -> str:
    """Returns the replay as the text of one HTML file that needs no network."""
    run = run.shown()
    return templates.page(
        _HERE / "replay.html",
        {"title": f"{run.scenario.vehicle_data.name}: {run.scenario.name}"},
        data=_narration(run),
        styles=[(_HERE / "replay.css").read_text(encoding="utf-8")],
        scripts=[*_scripts(_recorded(run)), (_HERE / "replay.js").read_text(encoding="utf-8")],
        needs=_MESHCAT,
    )


class _Scripts(HTMLParser):
    """Collects the texts of a page's scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._inside = tag == "script"
        if self._inside:
            self.texts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = False

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.texts[-1] += data


def _scripts(page: str) -> list[str]:
    """Returns the texts of a page's scripts, in order: Meshcat's are its library and the recorded scene."""
    reader = _Scripts()
    reader.feed(page)
    reader.close()
    return [text for text in reader.texts if text]


def _recorded(run: Run) -> str:
    """Records the motion of a run and returns Meshcat's page with it, in which no text of the user's is."""
    vehicle, time_s = run.scenario.vehicle_data, np.asarray(run.time_s)
    stride = max(1, -(-time_s.size // _FRAMES))
    # rows are played a sample period apart: what lies in a gap of telemetry is not known
    at_s = (np.arange(time_s.size) * vehicle.sample_period_s).tolist()
    stage = Stage(vehicle, truth="truth" in run.signals)
    stage.meshcat.StartRecording(1.0 / (stride * vehicle.sample_period_s), False)

    attitudes = _attitudes(run)
    for row in range(0, time_s.size, stride):
        stage.turn(attitudes[row], at_s[row])
    center = _center(run)
    for row in _changes(center):
        stage.center(center[row], at_s[row])
    estimate, deviation = (np.asarray(run[name])[:, CENTER_OF_MASS] for name in ("estimate", "standard_deviation"))
    changed = _changes(np.hstack([estimate, deviation]))
    for row in changed[:: changed.size // _FRAMES + 1]:
        stage.estimate(estimate[row], deviation[row], at_s[row])
    for jet, level in enumerate(_levels(run).T):
        firing = level > SHOWN
        for row in _changes(firing[:, None]):
            stage.plume(jet, bool(firing[row]), at_s[row])
    for kind, marks in (("failed", events.failures(run)), ("found", events.found(run))):
        for number, mark in enumerate(marks):
            shown = (time_s >= mark.start_s - 1e-9) & (time_s <= mark.end_s)
            for path in [stage.add_mark(kind, str(number), jet) for jet in mark.jets]:
                for row in _changes(shown[:, None]):
                    stage.show(path, bool(shown[row]), at_s[row])

    stage.meshcat.StopRecording()
    stage.meshcat.PublishRecording()
    return str(stage.meshcat.StaticHtml())


def _narration(run: Run) -> dict[str, object]:
    """Collects what the page says and when: the start of every interval, with its texts."""
    scenario, start_s = run.scenario, float(run.time_s[0])
    failed, found = events.failures(run), events.found(run)
    edges = {start_s}
    for window in scenario.maneuver:
        edges |= {window.start_s, window.end_s}
    for mark in (*failed, *found):
        edges |= {mark.start_s, mark.end_s}

    def texts(marks: list[events.Mark], edge: float) -> list[str]:
        return [mark.text for mark in marks if mark.start_s <= edge < mark.end_s]

    return {
        "start_s": start_s,
        "moments": [
            {
                "at": edge - start_s,
                "command": events.commanded(scenario, edge),
                "failed": texts(failed, edge),
                "found": texts(found, edge),
            }
            for edge in sorted(edges)
        ],
        "truth": "truth" in run.signals,
        "colors": {
            "failed": FAILED_COLOR,
            "found": SUSPECT_COLOR,
            "estimate": ESTIMATE_COLOR,
            "truth": TRUTH_COLOR,
            "plume": PLUME_COLOR,
        },
    }


def _center(run: Run) -> Array:
    """Returns the point that the camera follows, the true center of mass or else the nominal one, shape (n, 3)."""
    if "truth" in run.signals:
        return np.asarray(run["truth"])[:, CENTER_OF_MASS]
    return np.tile(run.scenario.vehicle_data.nominal.center_of_mass, (np.asarray(run.time_s).size, 1))


def _levels(run: Run) -> Array:
    """Returns true over full thrust or, where the truth is unknown, the command, shape (n, n_jets)."""
    if "thrust" in run.signals:
        return np.asarray(run["thrust"]) / np.linalg.norm(run.scenario.vehicle_data.thrusts, axis=1)
    return np.nan_to_num(np.asarray(run["command"]))


def _attitudes(run: Run) -> Array:
    """Returns q_NB at every sample, the truth or else integrated from the gyro in use, shape (n, 4)."""
    if "attitude" in run.signals:
        return np.asarray(run["attitude"])
    rate = np.nan_to_num(np.asarray(run[params.gyro(run.scenario).name]))
    attitudes = np.empty((rate.shape[0], 4))
    attitudes[0] = (1.0, 0.0, 0.0, 0.0)
    for row, (before, after) in enumerate(pairwise(rate)):
        mean = 0.5 * (before + after)
        attitudes[row + 1] = propagated(attitudes[row], mean, run.scenario.vehicle_data.sample_period_s)
    return attitudes


def _changes(values: Array | NDArray[np.bool_]) -> NDArray[np.int_]:
    """Finds the first row and every row that differs from the one before it, shape (k,)."""
    return np.concatenate([[0], np.flatnonzero(np.any(np.diff(values, axis=0) != 0.0, axis=1)) + 1])
