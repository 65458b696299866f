"""Plots of a vehicle's motion and its jets: as simulated, as read, and as a simulation beside a record has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import motion
from massprop_drake.display.plot_source import DEGREES, Source, failing_jets, plot
from massprop_drake.display.spec import (
    Bars,
    Line,
    Mark,
    Over,
    Panel,
    Plot,
    Points,
)
from massprop_drake.display.style import BAND_COLOR, COLORS, FAILED_COLOR, THIN_LINE, TRUTH_COLOR
from massprop_drake.inputs import params, pilot_params, true_params
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, commanded_rate
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.maths.signals import AGAINST, AXES, SIGNALS, fill_unit_template
from massprop_drake.results.against_followed import rotation_differences

Array = NDArray[np.float64]


def rates(run: Source) -> Plot:
    """Plots the angular velocity (figure 5-2)."""
    return _plot_vector(run, "rates", "rate", "Angular rate", "deg/s", scale=DEGREES, axes=run.rotation_axes)


def velocities(run: Source) -> Plot:
    """Plots the velocity of the center of mass relative to the start, inertial axes (figure 5-3)."""
    title = "Velocity of the center of mass, relative to the start, inertial axes"
    return _plot_vector(run, "velocities", "velocity", title, axes=run.translation_axes)


def attitude_error(run: Source) -> Plot:
    """Plots the attitude error in hold."""
    title = "Attitude error in hold"
    return _plot_vector(run, "attitude_error", "attitude_error", title, "deg", scale=DEGREES, axes=run.rotation_axes)


def positions(run: Source) -> Plot:
    """Plots the position in the fixed frame: as read, as estimated and, in a simulation, as it is."""
    panels = []
    for axis in run.translation_axes:
        marks: list[Mark] = [
            Points(run.time_s, run.signals[sensor.name][:, axis], BAND_COLOR, f"{sensor.name} as read", size=2.0)
            for sensor in run.vehicle.poses
            if sensor.name in run.signals
        ]
        known = "position" in run.signals
        if known:
            marks.append(Line(run.time_s, run.signals["position"][:, axis], TRUTH_COLOR, "true center of mass"))
        estimate = run.signals["position_estimate"][:, axis]
        marks.append(Line(run.time_s, estimate, COLORS[axis], "estimated center of mass", dashed=known))
        panels.append(Panel(AXES[axis], run.vehicle.unit_names["length"], tuple(marks)))
    meaning = "what is read is the place of the point that is followed"
    return plot(run, "positions", "Position in the fixed frame", panels, meaning=meaning)


def phase_plane(run: Source) -> Plot:
    """Plots the rate over attitude error of the axes in hold, with the lines beyond which the autopilot acts.

    Both are as the autopilot measures them. An axis that does not hold its attitude has no path.
    """
    law = pilot_params.phase_space_params(run.scenario)
    error = DEGREES * np.where(run.signals["attitude_error"] == 0.0, np.nan, run.signals["attitude_error"])
    rate = DEGREES * motion.onboard_rate(run.scenario, run.signals)
    translates = any(window.controller == "thc" for window in run.scenario.maneuver)
    deadbands = {"corrects beyond": law.rate_deadband} | ({"in a translation": law.resolve_rate} if translates else {})
    panels = [
        _phase_panel(axis, (error[:, axis], rate[:, axis]), law, deadbands, labeled=axis == run.rotation_axes[0])
        for axis in run.rotation_axes
    ]
    meaning = "an axis beyond the dashed lines asks for a correction of all three"
    return plot(run, "phase_plane", "Phase plane: rate over attitude error, in hold", panels, meaning=meaning)


def _phase_panel(
    axis: int,
    error_and_rate: tuple[Array, Array],
    law: PhaseSpaceParams,
    deadbands: Mapping[str, float],
    *,
    labeled: bool,
) -> Panel:
    """Makes the phase-plane panel of an axis: path, deg and deg/s, and switching lines of named deadbands, rad/s."""
    error, rate = error_and_rate
    held = np.where(np.isnan(error), np.nan, rate)
    wide = _symmetric_limit(error, 0.0)
    high = _symmetric_limit(held, DEGREES * (law.hold_rate_limit + max(deadbands.values())))
    corner = DEGREES * law.hold_rate_limit / law.hold_gain if law.hold_gain > 0.0 else wide
    x = np.unique(np.clip([-wide, -corner, corner, wide], -wide, wide))
    wanted = np.array([DEGREES * commanded_rate(np.zeros(3), np.full(3, at), law)[0] for at in x / DEGREES])
    letter = AXES[axis]
    marks: list[Mark] = [
        Line(error, held, COLORS[axis], "path" if labeled else "", width=THIN_LINE),
        Line(x, wanted, TRUTH_COLOR, "rate wanted" if labeled else ""),
    ]
    for (label, deadband), color in zip(deadbands.items(), (TRUTH_COLOR, BAND_COLOR), strict=False):
        for sign, said in ((-1.0, ""), (1.0, label if labeled else "")):
            marks.append(Line(x, wanted + sign * DEGREES * deadband, color, said, dashed=True))
    over = Over(f"attitude error {letter}", "deg", (-wide, wide))
    return Panel(f"rate {letter}", "deg/s", tuple(marks), limits=(-high, high), over=over)


def _symmetric_limit(values: Array, minimum: float) -> float:
    """Computes the half width of a range around zero that holds all values, at least a minimum, with 10 % margin."""
    return 1.1 * max(float(np.nan_to_num(np.abs(values)).max()), minimum) or 1.0


def rates_estimated(run: Source) -> Plot:
    """Plots the angular rate that the filter estimates, of a vehicle without gyro."""
    title = "Angular rate, estimated"
    return _plot_vector(run, "rates_estimated", "rate_estimate", title, "deg/s", scale=DEGREES, axes=run.rotation_axes)


def torques(run: Source) -> Plot:
    """Plots the applied torque about the center of mass (figure 5-4)."""
    return _plot_vector(
        run, "torques", "torque", "Applied torque about the center of mass", steps=True, axes=run.rotation_axes
    )


def forces(run: Source) -> Plot:
    """Plots the applied force (figure 5-5)."""
    return _plot_vector(run, "forces", "force", "Applied force", steps=True, axes=run.translation_axes)


def gyro_readings(run: Source) -> Plot:
    """Plots the angular rate as each gyro package read it."""
    names = [gyro.name for gyro in run.vehicle.gyros]
    return _plot_readings(run, "gyro_readings", names, "Angular rate, as read", "deg/s", DEGREES)


def accelerometer_velocities(run: Source) -> Plot:
    """Plots the integrated specific force as each accelerometer package read it."""
    names = [package.name for package in run.vehicle.accelerometers]
    unit = f"{run.vehicle.unit_names['length']}/s"
    return _plot_readings(run, "accelerometer_velocities", names, "Integrated specific force, as read", unit, 1.0)


def against_rates(run: Source) -> Plot:
    """Plots the angular rate as read by the gyro in use, and as simulated with the same commands."""
    name = params.gyro(run.scenario).name
    return _plot_against_simulation(run, "against_rates", name, "Angular rate", "deg/s", DEGREES)


def against_velocities(run: Source) -> Plot:
    """Plots the integrated specific force as the accelerometer in use read it, and as a simulation has it."""
    name = params.accelerometers(run.scenario)[0].name
    unit = f"{run.vehicle.unit_names['length']}/s"
    return _plot_against_simulation(run, "against_velocities", name, "Integrated specific force", unit, 1.0)


def against_positions(run: Source) -> Plot:
    """Plots the position of the first tracked point, as read and as simulated with the same commands."""
    name = next(pose.name for pose in run.vehicle.poses if pose.position_std is not None)
    return _plot_against_simulation(run, "against_positions", name, "Position", run.vehicle.unit_names["length"], 1.0)


def against_attitudes(run: Source) -> Plot:
    """Plots the rotation from the simulated attitude to the measured one, of the first attitude sensor, deg."""
    name = next(pose.name for pose in run.vehicle.poses if pose.attitude_std is not None)
    left = DEGREES * rotation_differences(run.signals[name][:, 3:], run.signals[AGAINST + name][:, 3:])
    panels = [Panel(AXES[axis], "deg", (Line(run.time_s, left[:, axis], COLORS[axis]),)) for axis in run.rotation_axes]
    meaning = "from the attitude that the simulation has to the one that was read, body axes"
    title = "Attitude, beside a simulation of the same commands: difference"
    return plot(run, "against_attitudes", title, panels, meaning=meaning)


def _plot_against_simulation(run: Source, name: str, package: str, title: str, unit: str, scale: float) -> Plot:
    """Plots a package's readings and simulated readings, and their difference, for each axis that moves."""
    measured, simulated = scale * run.signals[package], scale * run.signals[AGAINST + package]
    panels = []
    turns = any(gyro.name == package for gyro in run.vehicle.gyros)
    for axis in run.rotation_axes if turns else run.translation_axes:
        letter = AXES[axis]
        lines = (
            Line(run.time_s, measured[:, axis], COLORS[axis], f"{package}, as read"),
            Line(run.time_s, simulated[:, axis], TRUTH_COLOR, "simulated", dashed=True),
        )
        difference = Line(run.time_s, (measured - simulated)[:, axis], COLORS[axis])
        panels += [Panel(letter, unit, lines), Panel(f"{letter}, difference", unit, (difference,))]
    meaning = "difference: what was read less what the simulation reads"
    return plot(run, name, f"{title}, beside a simulation of the same commands", panels, meaning=meaning)


def jets(run: Source) -> Plot:
    """Plots the commands to each jet, a row per jet, by cluster."""
    every = run.vehicle.jets
    order = sorted(range(len(every)), key=lambda index: (every[index].cluster, index))
    if not run.clustered:
        rows = [_Row(every[index].designation, every[index].cluster, (index,)) for index in order]
        return _plot_firings(run, "jets", "Jets", "", rows)
    rows = [
        _Row(f"{every[index].designation} ({every[index].cluster})", every[index].cluster, (index,)) for index in order
    ]
    return _plot_firings(run, "jets", "Jets, one by one", "jet (cluster)", rows)._replace(folded=True)


def clusters(run: Source) -> Plot:
    """Plots the commands to each cluster, and its thrust; jets that fail or are declared have rows of their own."""
    every = run.vehicle.jets
    alone = {
        run.vehicle.jet_index(failure.jet) for failure in run.scenario.failures if failure.start_s <= run.time_s[-1]
    }
    if "known_force_variance" in run.signals:
        alone |= set(np.flatnonzero((run.signals["known_force_variance"] > 0.0).any(axis=0)).tolist())
    if "verdict" in run.signals:
        alone |= set(np.flatnonzero((run.signals["verdict"] == Word.FAILED).any(axis=0)).tolist())
    rows = [_Row(f"jet {every[jet].designation}", every[jet].cluster, (jet,)) for jet in sorted(alone)]
    for cluster in sorted({jet.cluster for jet in every}):
        members = tuple(index for index, jet in enumerate(every) if jet.cluster == cluster)
        rows.append(_Row(f"cluster {cluster}", cluster, members))
    return _plot_firings(run, "clusters", "Jets by cluster", "", rows)


class _Row(NamedTuple):
    """Jets that share a row, its name, and the cluster that gives its color."""

    name: str
    cluster: int
    jets: tuple[int, ...]


def _plot_firings(run: Source, name: str, title: str, label: str, rows: Sequence[_Row]) -> Plot:
    """Plots rows of bars: commands, below them true thrust where known, uncommanded thrust in another color."""
    command = np.nan_to_num(run.signals["command"]) > 0.0
    marks = [
        _bars(run, rows, command, -0.2 if "thrust" in run.signals else 0.0, None, "commanded"),
    ]
    meaning = ""
    if "thrust" in run.signals:
        level = run.signals["thrust"] / np.linalg.norm(run.vehicle.thrusts, axis=1)
        plumes = motion.classify_plumes(level, command, failing_jets(run.time_s, run.scenario))
        marks.append(_bars(run, rows, plumes["given"], 0.2, TRUTH_COLOR, "thrust"))
        marks.append(_bars(run, rows, plumes["untold"], 0.2, FAILED_COLOR, "thrust untold"))
        meaning = "upper bar: commanded; lower bar: true thrust, orange: of a failed jet, untold"
    bars = tuple(mark for part in marks for mark in part)
    return plot(run, name, title, [Panel(label, "", bars, rows=tuple(row.name for row in rows))], meaning=meaning)


def _bars(
    run: Source, rows: Sequence[_Row], is_on: NDArray[np.bool_], offset: float, color: str | None, label: str
) -> list[Bars]:
    """Makes bars of the intervals in which any jet of a row is on, by color; None: the color of each cluster."""
    by_color: dict[str, list[Array]] = {}  # rows of begin, end and row
    for number, row in enumerate(rows):
        begin, end = _intervals(run.time_s, np.asarray(is_on[:, list(row.jets)].any(axis=1)))
        bars = np.column_stack([begin, end, np.full(begin.shape, number + offset)])
        by_color.setdefault(color or COLORS[row.cluster % (len(COLORS) - 1)], []).append(bars)
    height = 0.4 if offset else 0.84
    marks = []
    for shade, parts in by_color.items():
        begin, end, position = np.vstack(parts).T
        marks.append(Bars(begin, end, position, shade, height, label))
    return marks


def propellant(run: Source) -> Plot:
    """Plots the propellant used, by the jets' thrust or, where that is not known, by their commands."""
    full, flows = np.linalg.norm(run.vehicle.thrusts, axis=1), true_params.plant_mass_flows(run.scenario)
    level = run.signals["thrust"] / full if "thrust" in run.signals else np.nan_to_num(run.signals["command"])
    rate = (level * flows).sum(axis=1) * run.vehicle.sample_period_s
    used = np.concatenate([[0.0], np.cumsum(rate[:-1])])
    line = Line(run.time_s, used, COLORS[0])
    return plot(run, "propellant", "Propellant used", [Panel("used", run.vehicle.unit_names["mass"], (line,))])


def _intervals(time_s: Array, is_on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Returns beginnings and ends of the intervals in which a mask is set, s, shape (k,) each.

    A command lasts until the next row, also where rows are left out; the last row commands nothing.
    """
    change = np.flatnonzero(np.diff(is_on[:-1], prepend=False, append=False))
    return time_s[change[::2]], time_s[change[1::2]]


def _plot_vector(
    run: Source,
    name: str,
    signal: str,
    title: str,
    unit: str | None = None,
    *,
    scale: float = 1.0,
    steps: bool = False,
    axes: Sequence[int] = (0, 1, 2),
) -> Plot:
    """Plots a vector signal, scaled to a unit, with a panel per axis."""
    values = scale * run.signals[signal]
    unit = unit or fill_unit_template(SIGNALS[signal].unit, run.vehicle.unit_names)
    panels = [Panel(AXES[axis], unit, (Line(run.time_s, values[:, axis], COLORS[axis], steps=steps),)) for axis in axes]
    return plot(run, name, title, panels)


def _plot_readings(run: Source, name: str, packages: Sequence[str], title: str, unit: str, scale: float) -> Plot:
    """Plots readings of sensor packages of one kind, with a panel per axis and a color per package."""
    panels = []
    for axis, letter in enumerate(AXES):
        marks = [
            Line(
                run.time_s,
                scale * run.signals[package][:, axis],
                COLORS[number % len(COLORS)],
                package if len(packages) > 1 else "",
            )
            for number, package in enumerate(packages)
        ]
        panels.append(Panel(letter, unit, tuple(marks)))
    return plot(run, name, title, panels)
