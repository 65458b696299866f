"""Plots of a design: knowledge over propellant, and firings over time."""

from __future__ import annotations

import numpy as np

from massprop_drake.display.spec import Bars, Level, Line, Mark, Over, Panel, Plot, Points
from massprop_drake.display.style import COLORS, THIN_LINE, TRUTH_COLOR
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.studies.design.found import Design


def plots(made: Design, vehicle: Vehicle) -> list[Plot]:
    """Makes the plots of a design: 1-sigma over propellant, and firings over time."""
    return [*([pareto_front(made, vehicle)] if made.targets else []), firings(made, vehicle)]


def pareto_front(made: Design, vehicle: Vehicle) -> Plot:
    """Plots 1-sigma over requested 1-sigma of each target against propellant, of looser plans, and as flown."""
    most = 1.05 * max(float(made.front.propellant[-1]), made.propellant) or 1.0
    ends = np.array([0.0, most])
    marks: list[Mark] = [Line(ends, np.ones(2), TRUTH_COLOR, "asked", dashed=True)]
    for number, target in enumerate(made.targets):
        color = COLORS[number % (len(COLORS) - 1)]
        looser = made.front.deviations[:, number] / target.asked
        marks.append(Line(made.front.propellant, looser, color, target.name, THIN_LINE))
        flown = np.array(target.flown) / target.asked
        at = np.full(flown.size or 1, made.propellant)
        values = flown if flown.size else np.array([target.predicted / target.asked])
        marks.append(Points(at, values, color))
    over = Over("propellant", vehicle.unit_names["mass"], (0.0, most))
    panel = Panel("1-sigma / asked", "", tuple(marks), scale="log", over=over)
    meaning = "lines: plans for looser targets; points: this maneuver" + (", flown" if made.targets[0].flown else "")
    title = "What is known for how much propellant"
    return Plot("front", title, vehicle.name, np.zeros(1), (panel,), meaning=meaning)


def firings(made: Design, vehicle: Vehicle) -> Plot:
    """Plots firings of jets and torques of wheels over time, with 1-sigma over requested 1-sigma below."""
    begins, commanded = made.begins_s, made.commanded
    names = (*vehicle.designations, *(wheel.name for wheel in vehicle.wheels))
    rows = [name for name in names if any(name == one.name for one in commanded)]
    bars = Bars(
        np.array([one.start_s for one in commanded]),
        np.array([one.end_s for one in commanded]),
        np.array([float(rows.index(one.name)) for one in commanded]),
        COLORS[0],
        label="commanded",
    )
    panels = [Panel("", "", (bars,), rows=tuple(rows))]
    time_s = begins + np.insert(made.course.time_s, 0, 0.0)
    if made.targets:
        lines: list[Mark] = [Level(1.0, label="asked")]
        for number, target in enumerate(made.targets):
            values = np.insert(made.course.deviations[:, number], 0, target.before) / target.asked
            lines.append(Line(time_s, values, COLORS[number % (len(COLORS) - 1)], target.name))
        panels.append(Panel("1-sigma / asked", "", tuple(lines), scale="log"))
    return Plot("firings", "The maneuver", vehicle.name, np.array((begins, begins + made.duration_s)), tuple(panels))
