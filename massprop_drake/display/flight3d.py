"""Replay of a run in three dimensions, as one HTML file that plays offline."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import event_marks, instruments, interactive, motion, solids, templates
from massprop_drake.display.links import Links
from massprop_drake.display.plot_source import failing_jets as truly_failing
from massprop_drake.display.stage import MeshcatStage
from massprop_drake.display.style import (
    ESTIMATE_COLOR,
    FAILED_COLOR,
    PATH_COLOR,
    PAYLOAD_COLOR,
    PLUME_COLOR,
    SUSPECT_COLOR,
    TRUTH_COLOR,
    UNTOLD_COLOR,
    WITHHELD_COLOR,
)
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.maths.attitude import propagate_attitude
from massprop_drake.maths.mass_properties import CENTER_OF_MASS
from massprop_drake.maths.signals import JOINTS
from massprop_drake.results.detections import in_words
from massprop_drake.results.folder import write_page

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

Array = NDArray[np.float64]

_HERE = Path(__file__).parent
DIGITS = 7  # of a number in the page
# Meshcat writes its own styles, and reads the scene from addresses that hold it
_MESHCAT = {"style-src": "'unsafe-inline'", "connect-src": "data:"}


def write_replay(run: RunContent, path: str | Path, *, force: bool = False) -> Path:
    """Writes the replay of a run.

    Where the truth is unknown, attitude is integrated from the gyro and thrust taken from the commands.

    Args:
        run: simulated, or estimated from telemetry.
        path: the HTML file to write; it appears whole or not at all, and replaces nothing but a replay of ours.
        force: keep a file that is there and not ours as `<path>.1`, `<path>.2`, ....

    Raises:
        InputError: when a file is there that is not ours, or it cannot be written.
    """
    target = Path(path)
    write_page(target, replay_html(run), "replay", force=force)
    return target


def replay_html(run: RunContent) -> str:
    """Returns the replay of a run as the text of one HTML file that needs no network."""
    run = run.thin_for_plots()
    page, stage = build_scene(run.scenario, truth="truth" in run.signals, path=_positions(run))
    return flight_page(run.scenario, page, _flight_data(run, stage))


def flight_page(scenario: Scenario, scene_page: str, data: dict[str, Any], *, live: bool = False) -> str:
    """Returns the HTML page of a flight, from Meshcat's page and the replay's data.

    Args:
        scenario: that is flown.
        scene_page: Meshcat's page with the vehicle.
        data: see `scenario_page_data`.
        live: whether the rows come from the server of the page.
    """
    library, orders = re.findall(r"<script[^>]*>(.+?)</script>", scene_page, re.DOTALL)  # Meshcat's, and the scene
    data["scene"]["commands"] = orders.count("handle_command_bytearray")
    return templates.page(
        _HERE / "replay.html",
        {"title": f"{scenario.vehicle_data.name}: {scenario.name}"},
        data=data,
        styles=[(_HERE / "replay.css").read_text(encoding="utf-8")],
        scripts=[library, orders, (_HERE / "replay.js").read_text(encoding="utf-8")],
        extra_policy={**_MESHCAT, "connect-src": "data: 'self'"} if live else _MESHCAT,
    )


def build_scene(scenario: Scenario, *, truth: bool, path: Array | None = None) -> tuple[str, MeshcatStage]:
    """Builds Meshcat's page with the vehicle, free of user texts; returns its HTML and the stage.

    Args:
        scenario: that is flown.
        truth: whether to show the true center of mass.
        path: of the center of mass in the fixed frame, ft or m, shape (n, 3); None: it is not known.
    """
    links = Links(scenario.plant) if isinstance(scenario.plant, MultibodyBlock) else None
    stage = MeshcatStage(scenario.vehicle_data, truth=truth, links=links)
    for jet in range(len(scenario.vehicle_data.jets)):
        for kind in ("failed", "found"):
            stage.add_mark(kind, jet)
    for number, jump in enumerate(scenario.jumps):
        stage.add_payload(number, jump.mass, np.array(jump.position))
    if path is not None:
        stage.add_path(path)
    return str(stage.meshcat.StaticHtml()), stage


COLUMNS = ("time", "attitude", "center", "estimate", "deviation", "rate", "nis", "apart")  # of a row of the page
LINKS = "links"  # one more, of a multibody model: pose of each link in the vehicle frame
PLACE = "position"  # and one more, where it is known: of the center of mass in the fixed frame
LISTS = ("given", "untold", "withheld", "failed", "found")  # of jets, for each row


def scenario_page_data(scenario: Scenario, stage: MeshcatStage, *, truth: bool) -> dict[str, Any]:
    """Collects the replay data that a scenario determines: scene, columns, limits and colors."""
    vehicle = scenario.vehicle_data
    return {
        "scene": {
            "jets": [
                {"name": jet.designation, "cluster": jet.cluster, "place": list(jet.position)} for jet in vehicle.jets
            ],
            "axis": stage.axis,
            "unit": vehicle.unit_names["length"],
            "spread": stage.spread,
            "payloads": [{"at": jump.time_s, "docks": jump.kind == "dock"} for jump in scenario.jumps],
        },
        "columns": [*COLUMNS, *([LINKS] if stage.links else [])],
        "limits": instruments.limits(scenario),
        "truth": truth,
        "colors": {
            "failed": FAILED_COLOR,
            "found": SUSPECT_COLOR,
            "estimate": ESTIMATE_COLOR,
            "truth": TRUTH_COLOR,
            "given": PLUME_COLOR,
            "untold": UNTOLD_COLOR,
            "withheld": WITHHELD_COLOR,
            "payload": PAYLOAD_COLOR,
            "path": PATH_COLOR,
        },
    }


def _flight_data(run: RunContent, stage: MeshcatStage) -> dict[str, Any]:
    """Collects the replay data of a finished run: rows by sample, jets by plume kind, texts and events.

    The page shows the last row at or before its time, and turns only the attitude between two rows.
    """
    scenario, time_s = run.scenario, np.asarray(run.time_s)
    failed, found = event_marks.failure_marks(scenario, float(time_s[-1])), event_marks.detection_marks(run)
    asked = np.nan_to_num(np.asarray(run["command"])) > 0.0
    levels = _thrust_levels(run)
    lists = {
        **motion.classify_plumes(levels, asked, truly_failing(time_s, scenario)),
        "failed": _marked_jets(run, failed),
        "found": _marked_jets(run, found),
    }
    estimate, deviation = (np.asarray(run[name])[:, CENTER_OF_MASS] for name in ("estimate", "standard_deviation"))
    columns = {
        "time": time_s[:, None],
        "attitude": _attitudes(run),
        "center": _camera_target(run),
        "estimate": estimate,
        "deviation": deviation,
        **instruments.columns(run),
    }
    told = scenario_page_data(scenario, stage, truth="truth" in run.signals)
    if (place := _positions(run)) is not None:
        told["columns"].append(PLACE)
        columns[PLACE] = place
    if stage.links:
        columns[LINKS] = np.array([stage.links.poses(row) for row in _joint_positions(run)])
    return {
        **told,
        "live": False,
        "rows": [list(row) for row in zip(*(_to_lists(columns[name]) for name in told["columns"]), strict=True)],
        "lists": {
            **{name: [np.flatnonzero(row).tolist() for row in lists[name]] for name in LISTS},
            "sizes": [plume_sizes(scenario, *row) for row in zip(levels, lists["given"], lists["untold"], strict=True)],
        },
        "gaps": np.flatnonzero(np.asarray(run["gap"])[:, 0]).tolist() if "gap" in run.signals else [],
        "moments": list_moments(scenario, float(time_s[0]), failed, found),
        "events": _slider_events(run, failed, found),
    }


def plume_sizes(
    scenario: Scenario, levels: Array, regular: NDArray[np.bool_], uncommanded: NDArray[np.bool_]
) -> list[float]:
    """Lists plume lengths over full-thrust lengths: of jets firing regularly, then of jets firing uncommanded.

    Args:
        scenario: of the vehicle.
        levels: thrust over full thrust, shape (n_jets,).
        regular, uncommanded: masks of `motion.classify_plumes`, "given" and "untold", shape (n_jets,).
    """
    scales = solids.plume_scales(scenario.vehicle_data, levels)
    return [round(scale, 3) for scale in (*scales[regular].tolist(), *scales[uncommanded].tolist())]


def _positions(run: RunContent) -> Array | None:
    """Returns the positions of the center of mass in the fixed frame, true or estimated, shape (n, 3); None: not known.

    An unknown position is replaced by the last known one, or else by the first.
    """
    name = next((name for name in ("position", "position_estimate") if name in run.signals), None)
    if name is None:
        return None
    positions = np.asarray(run[name])
    known = np.isfinite(positions).all(axis=1)
    if not known.any():
        return None
    rows = np.maximum.accumulate(np.where(known, np.arange(len(positions)), int(np.argmax(known))))
    return np.asarray(positions[rows])


def _joint_positions(run: RunContent) -> Array:
    """Returns the positions of the model's joints at every sample, shape (n, n_joints)."""
    return np.asarray(run[JOINTS]) if JOINTS in run.signals else np.empty((np.asarray(run.time_s).size, 0))


def _to_lists(values: Array) -> list[Any]:
    """Converts rows to lists of numbers, or one-column rows to numbers; None for what is not finite."""
    flat = interactive.rounded_numbers(values.ravel(), digits=DIGITS)
    width = values.shape[1]
    return flat if width == 1 else [flat[start : start + width] for start in range(0, len(flat), width)]


def _marked_jets(run: RunContent, marks: Sequence[event_marks.Mark]) -> NDArray[np.bool_]:
    """Flags the jets that any mark covers at each sample, shape (n, n_jets)."""
    time_s = np.asarray(run.time_s)
    marked = np.zeros((time_s.size, len(run.scenario.vehicle_data.jets)), dtype=bool)
    for mark in marks:
        rows = (time_s >= mark.start_s - 1e-9) & (time_s <= mark.end_s)
        for jet in mark.jets:
            marked[rows, jet] = True
    return marked


def list_moments(
    scenario: Scenario,
    start_s: float,
    failure_marks: Sequence[event_marks.Mark],
    detection_marks: Sequence[event_marks.Mark],
) -> list[dict[str, object]]:
    """Lists the times, s, at which the replay's texts change, each with command, failures and declarations."""
    edges = {start_s}
    for window in scenario.maneuver:
        edges |= {window.start_s, window.end_s}
    for mark in (*failure_marks, *detection_marks):
        edges |= {mark.start_s, mark.end_s} - {math.inf}

    def active_texts(marks: Sequence[event_marks.Mark], edge: float) -> list[str]:
        """Lists the texts of the marks whose interval covers a time, s."""
        return [mark.text for mark in marks if mark.start_s <= edge < mark.end_s or edge == mark.start_s]

    return [
        {
            "at": edge,
            "command": event_marks.describe_command(scenario, edge),
            "failed": active_texts(failure_marks, edge),
            "found": active_texts(detection_marks, edge),
        }
        for edge in sorted(edges)
    ]


def _slider_events(
    run: RunContent, failure_marks: Sequence[event_marks.Mark], detection_marks: Sequence[event_marks.Mark]
) -> list[dict[str, object]]:
    """Lists events for the time slider: injected failures and mass-property jumps, and declarations."""
    end_s, units = float(run.time_s[-1]), run.scenario.vehicle_data.unit_names
    ticks = [{"at": mark.start_s, "kind": "failed", "text": mark.text} for mark in failure_marks]
    ticks += [
        {"at": jump.time_s, "kind": "payload", "text": f"payload: {jump.kind}"}
        for jump in run.scenario.jumps
        if jump.time_s <= end_s
    ]
    ticks += [
        {"at": entry.time_s, "kind": "found", "text": f"declared: {in_words(entry, units)}"}
        for entry in run.results.detections
    ]
    return sorted(ticks, key=lambda tick: float(str(tick["at"])))


def _camera_target(run: RunContent) -> Array:
    """Returns the points that the camera tracks: the true or else the nominal center of mass, shape (n, 3)."""
    if "truth" in run.signals:
        return np.asarray(run["truth"])[:, CENTER_OF_MASS]
    return np.tile(run.scenario.vehicle_data.nominal.center_of_mass, (np.asarray(run.time_s).size, 1))


def _thrust_levels(run: RunContent) -> Array:
    """Returns true thrust over full thrust or, where the truth is unknown, the command, shape (n, n_jets)."""
    if "thrust" in run.signals:
        return np.asarray(run["thrust"]) / np.linalg.norm(run.scenario.vehicle_data.thrusts, axis=1)
    return np.nan_to_num(np.asarray(run["command"]))


def _attitudes(run: RunContent) -> Array:
    """Returns q_NB at every sample, the truth or else integrated from the gyro in use, shape (n, 4)."""
    if "attitude" in run.signals:
        return np.asarray(run["attitude"])
    if "attitude_estimate" in run.signals:
        return np.asarray(run["attitude_estimate"])
    rate = np.nan_to_num(motion.onboard_rate(run.scenario, run.signals))
    attitudes = np.empty((rate.shape[0], 4))
    attitudes[0] = (1.0, 0.0, 0.0, 0.0)
    for row, (before, after) in enumerate(pairwise(rate)):
        mean = 0.5 * (before + after)
        attitudes[row + 1] = propagate_attitude(attitudes[row], mean, run.scenario.vehicle_data.sample_period_s)
    return attitudes
