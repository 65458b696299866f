"""Ablations of the estimator in a fixed frame: the hardware record again, with one part left out.

    python benchmarks/pose_ablations.py [--case NAME ...] [--seconds 120]

A line a case: when T2 is named, its log ratio over "nothing has failed" after the first minute where nothing is named
(and the best of any other jet), mass and moment of inertia about z at the end, and every other thing that is said.
Nothing is tuned again: what is left out is taken from the vehicle's file or from the record, and all else stays.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake.display.run import Run
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.inputs.yaml import Document
from massprop_drake.runners.recorded import estimate

FOLDER = Path(__file__).parent.parent / "docs" / "tutorials" / "air_bearing"
DEAD = "T2"
_HALF_S = 60.0  # after which odds are compared
_NEVER = 1e9  # nats

Row = dict[str, str]
Data = dict[str, Any]


class Case(NamedTuple):
    """Parts that are left out.

    Attributes:
        vehicle: keys of the vehicle's file that are different, dotted.
        record: what becomes of the record's rows.
        mapped: what becomes of its map.
    """

    vehicle: Mapping[str, Any] = {}
    record: Callable[[list[Row]], None] | None = None
    mapped: Callable[[Data], None] | None = None


def _without_short(rows: list[Row]) -> None:
    """Removes commands of rows whose combination of jets is in force for that row alone."""
    jets = [name for name in rows[0] if name.startswith("T")]
    fired = [tuple(row[jet] for jet in jets) for row in rows]
    for row, before, here, after in zip(rows[1:-1], fired, fired[1:], fired[2:], strict=False):
        if here not in (before, after):
            row.update(dict.fromkeys(jets, ""))


def _nominal(by: Data) -> None:
    """Takes the clock as it is, which counts steps of 0.06 s."""
    by["time"].pop("differences")


def _even(by: Data) -> None:
    """Makes all steps equal, 0.063 s."""
    by["time"].pop("differences")
    by["time"]["drift"] = 0.06 / 0.063 - 1.0


def _differenced(by: Data) -> None:
    """Uses velocities and rates as measurements; of the pose only the heading is left."""
    by["sensors"]["mocap"].update(kind="attitude")
    for key in ("position", "unit"):
        by["sensors"]["mocap"].pop(key)
    by["sensors"]["speed"] = {"kind": "velocity", "columns": ["vx_mps", "vy_mps", None]}
    by["sensors"]["turn"] = {"kind": "gyro", "columns": [None, None, "yaw_rate_radps"]}


_KIND = "jet_kinds.nozzle."
_AROUND = "surroundings."
_SLOPE = {_AROUND + key: 0.0 for key in ("slope_std", "slope_walk", "turn_std", "turn_walk", "heading_turn_std")}
_KICKS = {_AROUND + "kicks_per_minute": 0.0}
_SCATTER = {_KIND + "repeatability": 0.0}
_NOISE = {_AROUND + "velocity_walk": 0.0, _AROUND + "rate_walk": 0.0}
_DIFFERENCES = {  # noise of the pose over a step, and a heading that does no more than turn axes
    "velocities": [{"name": "speed", "noise_std": 1.6e-3}],
    "gyros": [{"name": "turn", "noise_std": 7.4e-3}],
    "poses.0.position_std": None,
    "poses.0.attitude_std": 0.02,
    "poses.0.point_std": 0.0,
}
CASES = {
    "nothing": Case(),
    "pulses of one sample": Case(record=_without_short),
    "delay: none": Case({_KIND + "command_delay_s": 0.0, _KIND + "command_delay_std_s": 0.0}),
    "delay: 0.12 s": Case({_KIND + "command_delay_s": 0.12, _KIND + "command_delay_std_s": 0.0}),
    "opening edge": Case({_KIND + "opening_delay_std_s": 0.0}),
    "lag": Case({_KIND + "time_constant_s": 0.0}),
    "drag": Case({_AROUND + "drag_std": 0.0, _AROUND + "angular_drag_std": 0.0}),
    "slope, turn, heading torque": Case(_SLOPE),
    "pose (differences)": Case(_DIFFERENCES, mapped=_differenced),
    "true times (nominal)": Case(mapped=_nominal),
    "true times (even)": Case(mapped=_even),
    "stamps' jitter": Case({"poses.0.time_std_s": 0.0}),
    "kicks": Case(_KICKS),
    "pulses' scatter": Case(_SCATTER),
    "kicks and scatter": Case(_KICKS | _SCATTER),
    "poor readings": Case({"poses.0.outliers": 0.0}),
    "process noise": Case(_NOISE),
    "process noise and kicks": Case(_NOISE | _KICKS),
    "common scale": Case({"common_scale_uncertainty": 0.0}),
    **{f"thrusts: {share:.0%}": Case({_KIND + "thrust_uncertainty": share}) for share in (0.0, 0.01, 0.15, 0.3)},
}


def _changed(data: Data, keys: Mapping[str, Any]) -> Data:
    """Returns data with some keys replaced."""
    for key, value in keys.items():
        *path, last = key.split(".")
        here: Any = data
        for part in path:
            here = here[int(part)] if isinstance(here, (list, tuple)) else here[part]
        here[last] = value
    return data


def flown(case: Case, seconds: float, folder: Path, **detector: float) -> Run:
    """Estimates from the record with something left out.

    Args:
        case: see `Case`.
        seconds: of the record, by its nominal clock.
        folder: for the record as it is then.
        detector: keys of it.
    """
    with (FOLDER / "hardware.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["nominal_time_s"]) <= seconds]
    if case.record is not None:
        case.record(rows)
    path = folder / "record.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    by = Document((FOLDER / "hardware_map.yaml").read_text(encoding="utf-8"), "map").data
    if case.mapped is not None:
        case.mapped(by)
    vehicle = _changed(load_vehicle("air_bearing").model_dump(mode="json"), case.vehicle)
    settings: Data = {"name": "ablation", "vehicle": vehicle, "detector": {"kind": "thrust_factors", **detector}}
    return estimate(path, resolve_scenario(settings), record_map=RecordMap.model_validate(by))


def line(name: str, case: Case, seconds: float) -> str:
    """Formats the result of a case, a row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        run = flown(case, seconds, Path(folder))
        open_ended = flown(case, min(seconds, _HALF_S), Path(folder), lead_nothing=_NEVER)
    jets = load_vehicle("air_bearing").designations
    odds = dict(zip(jets, open_ended["likelihood"][-1], strict=True))
    dead, others = odds.pop(DEAD), max(odds.values())
    found, events = run.results.detections, run.results.events
    at = next((f"{one.time_s:.1f} s" for one in found if one.jet == DEAD), "never")
    rest = [f"{'/'.join(one.jets)} {one.time_s:.0f} s" for one in found if one.jet != DEAD]
    said = [(one.kind, one.time_s) for one in events if not one.jets]
    for kind, times in Counter(kind for kind, _ in said).items():
        first = min(time_s for each, time_s in said if each == kind)
        rest.append(f"{kind} {first:.0f} s" + (f" ({times} times)" if times > 1 else ""))
    derived = run.results.derived
    mass, turn = f"{derived.mass:.1f} ± {derived.mass_std:.1f}", f"{derived.inertia[2][2]:.3f}"
    turn += f" ± {derived.inertia_std[2][2]:.3f}"
    return f"| {name} | {at} | {dead:.0f} ({others:.0f}) | {mass} | {turn} | {', '.join(rest) or '-'} |"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--seconds", type=float, default=120.0)
    arguments = parser.parse_args()
    print("| left out | T2 named | log ratio (other) | m, kg | Izz, kg-m² | said besides |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in arguments.case:
        print(line(name, CASES[name], arguments.seconds), flush=True)


if __name__ == "__main__":
    main()
