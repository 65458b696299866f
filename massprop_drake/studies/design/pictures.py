"""Plots of a design: knowledge over propellant, and firings over time."""

from __future__ import annotations

import numpy as np

from massprop_drake.display.spec import Bars, Level, Line, Mark, Over, Panel, Plot, Points
from massprop_drake.display.style import COLORS, THIN_LINE, TRUTH_COLOR
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.studies.design.found import Design


def plots(design: Design, vehicle: Vehicle) -> list[Plot]:
    """Makes the plots of a design: 1-sigma over propellant, and firings over time."""
    return [*([pareto_front(design, vehicle)] if design.targets else []), firings(design, vehicle)]


def pareto_front(design: Design, vehicle: Vehicle) -> Plot:
    """Plots 1-sigma over requested 1-sigma of each target against propellant, of looser plans, and as flown."""
    largest = 1.05 * max(float(design.front.propellant[-1]), design.propellant) or 1.0
    ends = np.array([0.0, largest])
    marks: list[Mark] = [Line(ends, np.ones(2), TRUTH_COLOR, "asked", dashed=True)]
    for number, target in enumerate(design.targets):
        color = COLORS[number % (len(COLORS) - 1)]
        looser = design.front.deviations[:, number] / target.asked
        marks.append(Line(design.front.propellant, looser, color, target.name, THIN_LINE))
        flown = np.array(target.flown) / target.asked
        propellant = np.full(flown.size or 1, design.propellant)
        values = flown if flown.size else np.array([target.predicted / target.asked])
        marks.append(Points(propellant, values, color))
    over = Over("propellant", vehicle.unit_names["mass"], (0.0, largest))
    panel = Panel("1-sigma / asked", "", tuple(marks), scale="log", over=over)
    meaning = "lines: plans for looser targets; points: this maneuver" + (", flown" if design.targets[0].flown else "")
    title = "What is known for how much propellant"
    return Plot("front", title, vehicle.name, np.zeros(1), (panel,), meaning=meaning)


def firings(design: Design, vehicle: Vehicle) -> Plot:
    """Plots firings of jets and torques of wheels over time, with 1-sigma over requested 1-sigma below."""
    begins_s, commands = design.begins_s, design.commanded
    names = (*vehicle.designations, *(wheel.name for wheel in vehicle.wheels))
    rows = [name for name in names if any(name == command.name for command in commands)]
    bars = Bars(
        np.array([command.start_s for command in commands]),
        np.array([command.end_s for command in commands]),
        np.array([float(rows.index(command.name)) for command in commands]),
        COLORS[0],
        label="commanded",
    )
    panels = [Panel("", "", (bars,), rows=tuple(rows))]
    time_s = begins_s + np.insert(design.course.time_s, 0, 0.0)
    if design.targets:
        lines: list[Mark] = [Level(1.0, label="asked")]
        for number, target in enumerate(design.targets):
            values = np.insert(design.course.deviations[:, number], 0, target.before) / target.asked
            lines.append(Line(time_s, values, COLORS[number % (len(COLORS) - 1)], target.name))
        panels.append(Panel("1-sigma / asked", "", tuple(lines), scale="log"))
    return Plot(
        "firings", "The maneuver", vehicle.name, np.array((begins_s, begins_s + design.duration_s)), tuple(panels)
    )
