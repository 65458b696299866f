"""One flight of the card: its scenario, and the declarations that it should have."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import Run
from massprop_drake.maths.mass_properties import MassProperties

Array = NDArray[np.float64]
Random = np.random.Generator

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
STATED_LAG = 1.0 / 1.05  # the filter is told 5 % more lag than jets have


class Record(NamedTuple):
    """Telemetry of a flight.

    Attributes:
        time_s: of each row, s, shape (n,).
        rates: of the gyro, rad/s, shape (n, 3).
        velocities: of each accelerometer by name, ft/s or m/s, shape (n, 3).
        commands: from each row on, shape (n, n_jets).
    """

    time_s: Array
    rates: Array
    velocities: Mapping[str, Array]
    commands: Array


class Flight(NamedTuple):
    """Drawn flight.

    Attributes:
        scenario: name of a bundled one, or its content.
        settings: overrides of it, as `--set` takes them.
        vehicle: content of its vehicle file; None: the scenario names one.
        recorded: makes the record that is estimated, from the run; None: the estimates in flight count.
        told: overrides of the scenario by which the record is estimated.
    """

    scenario: str | Mapping[str, Any]
    settings: tuple[str, ...] = ()
    vehicle: Mapping[str, Any] | None = None
    recorded: Callable[[Run, Random], Record] | None = None
    told: tuple[str, ...] = ()


def setting(key: str, value: object) -> str:
    """Formats an override as `--set` takes it."""
    return f"{key}={json.dumps(value)}"


def truth(body: MassProperties) -> str:
    """Overrides the true mass properties."""
    content = {"mass": body.mass, "center_of_mass": body.center_of_mass.tolist(), "inertia": body.inertia.tolist()}
    return setting("plant.mass_properties", content)


def thrusts(how: str, number: int) -> tuple[str, str]:
    """Overrides the dispersion of thrusts, and the one that the filter assumes.

    Args:
        how: "exact", "dispersed" (1 %, as stated), "twice" (2 %, 1 % stated) or "either" (exact and dispersed in turn).
        number: of the flight.
    """
    if how == "either":
        how = ("exact", "dispersed")[number % 2]
    off, stated = {"exact": (0.0, 0.0), "dispersed": (0.01, 0.01), "twice": (0.02, 0.01)}[how]
    return f"plant.thrust_dispersion={off}", f"joint.thrust_uncertainty={stated}"


def windows(
    random: Random, controllers: Sequence[str], span_s: tuple[float, float], hold_s: tuple[float, float]
) -> list[dict[str, Any]]:
    """Draws windows of hand controllers one after the other, 1 to 3 s apart.

    Args:
        random: to draw with.
        controllers: "rhc", "thc" or both.
        span_s: when the first begins, and the latest that one may begin, s.
        hold_s: shortest and longest time out of detent, s.
    """
    now, found = span_s[0], []
    while now < span_s[1]:
        ends = now + float(random.uniform(*hold_s))
        controller, axis = str(random.choice(controllers)), str(random.choice(AXES))
        found.append({"controller": controller, "axis": axis, "start_s": now, "end_s": ends})
        now = ends + float(random.uniform(1.0, 3.0))
    return found


def failure(mode: str, jet: str, start_s: float, size: float = 0.0) -> dict[str, Any]:
    """Describes a failure as a scenario has it.

    Args:
        mode: "stuck_on", "stuck_off", "leak", "degraded" or "drift".
        jet: designation.
        start_s: onset, s.
        size: of a leak its force, lbf or N; of a degraded jet the share that is left; of drift its rate, 1/s.
    """
    names = {"leak": "force", "degraded": "fraction", "drift": "rate_per_s"}
    sized = {names[mode]: size} if mode in names else {}
    return {"kind": mode, "jet": jet, "start_s": start_s, **sized}


def write_record(record: Record, jets: Sequence[str], gyro: str, path: Path) -> None:
    """Writes a record as telemetry."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        packages = [gyro, *record.velocities]
        columns = [f"{name}_{axis}" for name in packages for axis in "xyz"]
        writer.writerow(["time_s", *columns, *(f"jet_{name}" for name in jets)])
        rows = np.column_stack((record.time_s, record.rates, *record.velocities.values(), record.commands))
        writer.writerows(rows.tolist())
