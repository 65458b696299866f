"""Plots of a run, each described once: panels and marks from its signals, in units and colors.

Every function takes a `Source` and returns a `Plot`; `available` names those that a source has the signals
for. Their figure numbers are those of the thesis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import motion
from massprop_drake.display.spec import (
    Band,
    Bars,
    Level,
    Line,
    Mark,
    MomentLine,
    Over,
    Panel,
    Plot,
    Points,
    ShadedWindow,
    SymmetricLog,
    Whiskers,
    Zone,
)
from massprop_drake.display.style import BAND_COLOR, COLORS, FAILED_COLOR, POINT_SIZE, THIN_LINE, TRUTH_COLOR
from massprop_drake.inputs import params, pilot_params, true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, commanded_rate
from massprop_drake.maths.estimation.detector import Verdict as Code
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.results.against_followed import turned
from massprop_drake.results.consistency import ruled
from massprop_drake.results.fault_probabilities import LEAST_SHOWN, rounded
from massprop_drake.signals import AGAINST, AXES, SIGNALS, SYMBOLS, in_units, is_own, mass_property_units

if TYPE_CHECKING:
    from massprop_drake.results.run import Run

Array = NDArray[np.float64]

NIS_LIMITS = (0.21579528262389802, 9.348403604496148)  # 2.5 and 97.5 % of chi-square, 3 degrees of freedom
_RARE_NIS = 11.344866730144373  # 99 % of chi-square, 3 degrees of freedom
_DEGREES = 180.0 / np.pi
_LEAST_NIS = 0.003  # that its axis shows: 1 in 24,000 of a consistent filter is less
_FLOOR = 0.1  # of statistics on a logarithmic scale: what lies below says nothing
PROMPT_S = 1.0  # a detector that tests as soon is armed from the start
_NAMED = 5  # jets, or clusters, with a color of their own; the others are gray


_DIAGONAL, _PRODUCTS, _CENTER = (0, 1, 2), (3, 4, 5), (6, 7, 8)  # of the ten parameters


class Source(NamedTuple):
    """Source of plots: signals of a run and their scenario.

    Attributes:
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        scenario: for units, maneuver windows, failures and jets.
        consistency: mean NIS and number of samples used, as in the summary; None: the signals are complete,
            and the means are taken from them.
    """

    time_s: Array
    signals: Mapping[str, Array]
    scenario: Scenario
    consistency: Mapping[str, float | None] | None = None

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle of the scenario."""
        return self.scenario.vehicle_data

    @property
    def simulated(self) -> bool:
        """True if the true mass properties are known."""
        return "truth" in self.signals

    @property
    def turning(self) -> tuple[int, ...]:
        """The axes about which the vehicle turns."""
        return (2,) if self.vehicle.motion == "planar" else (0, 1, 2)

    @property
    def moving(self) -> tuple[int, ...]:
        """The axes along which it moves."""
        return (0, 1) if self.vehicle.motion == "planar" else (0, 1, 2)

    @property
    def clustered(self) -> bool:
        """True if any cluster has more than one jet."""
        return len({jet.cluster for jet in self.vehicle.jets}) < len(self.vehicle.jets)

    def where(self, name: str) -> NDArray[np.int_]:
        """Returns rows at which a signal of one component exists and is not zero, shape (k,)."""
        return np.flatnonzero(np.nan_to_num(self.signals[name][:, 0]) != 0.0)


def source(run: Run) -> Source:
    """Makes a source of plots of a run, or some of its rows."""
    return Source(run.time_s, run.signals, run.scenario, run.summary["consistency"] if run.thinned else None)


def available(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of a run by name, in the order to read them."""
    found = _of_motion(run)
    if any(name.startswith(AGAINST) for name in run.signals):
        found |= _of_comparison(run)
    found |= _of_estimates(run)
    if run.consistency is None:
        found["propellant"] = propellant
    if "likelihood" in run.signals:
        if "none_probability" in run.signals and np.isfinite(run.signals["none_probability"]).any():
            found["fault_probabilities"] = fault_probabilities
        else:
            found["likelihoods"] = likelihoods
        if any(np.isfinite(run.signals[name]).any() for name in ("jet_margin", "cluster_margin")):
            found["margins"] = margins
        found |= {"failure_magnitude": failure_magnitude, "detection_timeline": detection_timeline}
    if _own(run):
        found["own_signals"] = own_signals
    return found


def _of_comparison(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of a record beside a simulation of its commands."""
    vehicle, found = run.vehicle, dict[str, Callable[[Source], Plot]]()
    if any(pose.position_std is not None for pose in vehicle.poses) and "position_estimate" in run.signals:
        found["against_positions"] = against_positions
    if any(pose.attitude_std is not None for pose in vehicle.poses) and "attitude_estimate" in run.signals:
        found["against_attitudes"] = against_attitudes
    if vehicle.gyros:
        found["against_rates"] = against_rates
    return found | ({"against_velocities": against_velocities} if vehicle.accelerometers else {})


def _of_motion(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of the vehicle's motion; of recorded telemetry, readings in place of the truth."""
    found: dict[str, Callable[[Source], Plot]] = {}
    if "velocity" not in run.signals and run.vehicle.accelerometers:
        found["accelerometer_velocities"] = accelerometer_velocities
    if "rate" in run.signals:
        found["rates"] = rates
    else:
        found |= {"gyro_readings": gyro_readings} if run.vehicle.gyros else {"rates_estimated": rates_estimated}
    if "attitude_error" in run.signals:
        found["attitude_error"] = attitude_error
    if "velocity" in run.signals:
        found["velocities"] = velocities
    found |= {**_of_place(run), **_of_jets(run)}
    found |= {name: plot for name, signal, plot in _OF_THRUST if signal in run.signals}
    if "attitude_error" in run.signals:
        found["phase_plane"] = phase_plane
    return found


def _of_place(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of the position of a vehicle that is followed in a fixed frame."""
    return {"positions": positions} if "position_estimate" in run.signals else {}


def _of_jets(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of firing jets; one by one too, where clusters have several."""
    return {"clusters": clusters, "jets": jets} if run.clustered else {"jets": jets}


def _of_estimates(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of the filter's estimates."""
    estimates: dict[str, tuple[Callable[[Source], Plot], tuple[int, ...]]] = {
        "inverse_inertia_diagonal": (inverse_inertia_diagonal, _DIAGONAL),
        "inverse_inertia_products": (inverse_inertia_products, _PRODUCTS),
        "center_of_mass": (center_of_mass, _CENTER),
    }
    found = {name: plot for name, (plot, elements) in estimates.items() if _estimated(run, elements)}
    if "mass_nis" in run.signals:  # there is an accelerometer
        found["mass_reciprocal"] = mass_reciprocal
    if "thrust_factor" in run.signals:
        return found | {"consistency": consistency, "thrust_factors": thrust_factors, "surroundings": surroundings}
    found["consistency"] = consistency
    if "rotation_innovation" in run.signals:
        found["innovations"] = innovations
    if "mass_innovation" in run.signals:
        found["mass_innovations"] = mass_innovations
    return found


# ------------------------------------------------------------------------------------------ motion


def rates(run: Source) -> Plot:
    """Plots the angular velocity (figure 5-2)."""
    return _vector(run, "rates", "rate", "Angular rate", "deg/s", scale=_DEGREES, axes=run.turning)


def velocities(run: Source) -> Plot:
    """Plots the velocity of the center of mass relative to the start, inertial axes (figure 5-3)."""
    title = "Velocity of the center of mass, relative to the start, inertial axes"
    return _vector(run, "velocities", "velocity", title, axes=run.moving)


def attitude_error(run: Source) -> Plot:
    """Plots the attitude error in hold."""
    title = "Attitude error in hold"
    return _vector(run, "attitude_error", "attitude_error", title, "deg", scale=_DEGREES, axes=run.turning)


def positions(run: Source) -> Plot:
    """Plots the position in the fixed frame: as read, as estimated and, in a simulation, as it is."""
    panels = []
    for axis in run.moving:
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
    return _plot(run, "positions", "Position in the fixed frame", panels, meaning=meaning)


def phase_plane(run: Source) -> Plot:
    """Plots the rate over attitude error of the axes in hold, with the lines beyond which the autopilot acts.

    Both are as the autopilot sees them. An axis that does not hold its attitude has no error, and no path.
    """
    law = pilot_params.phase_space_params(run.scenario)
    error = _DEGREES * np.where(run.signals["attitude_error"] == 0.0, np.nan, run.signals["attitude_error"])
    rate = _DEGREES * motion.read(run.scenario, run.signals)
    translates = any(window.controller == "thc" for window in run.scenario.maneuver)
    deadbands = {"corrects beyond": law.rate_deadband} | ({"in a translation": law.resolve_rate} if translates else {})
    panels = [
        _phase_panel(axis, (error[:, axis], rate[:, axis]), law, deadbands, key=axis == run.turning[0])
        for axis in run.turning
    ]
    meaning = "an axis beyond the dashed lines asks for a correction of all three"
    return _plot(run, "phase_plane", "Phase plane: rate over attitude error, in hold", panels, meaning=meaning)


def _phase_panel(
    axis: int, path: tuple[Array, Array], law: PhaseSpaceParams, deadbands: Mapping[str, float], *, key: bool
) -> Panel:
    """Makes the path of an axis, deg and deg/s, among its switching lines; deadbands in rad/s by their use."""
    error, rate = path
    held = np.where(np.isnan(error), np.nan, rate)
    wide = _beyond(error, 0.0)
    high = _beyond(held, _DEGREES * (law.hold_rate_limit + max(deadbands.values())))
    corner = _DEGREES * law.hold_rate_limit / law.hold_gain if law.hold_gain > 0.0 else wide
    x = np.unique(np.clip([-wide, -corner, corner, wide], -wide, wide))
    wanted = np.array([_DEGREES * commanded_rate(np.zeros(3), np.full(3, at), law)[0] for at in x / _DEGREES])
    letter = AXES[axis]
    marks: list[Mark] = [
        Line(error, held, COLORS[axis], "path" if key else "", width=THIN_LINE),
        Line(x, wanted, TRUTH_COLOR, "rate wanted" if key else ""),
    ]
    for (label, deadband), color in zip(deadbands.items(), (TRUTH_COLOR, BAND_COLOR), strict=False):
        for sign, said in ((-1.0, ""), (1.0, label if key else "")):
            marks.append(Line(x, wanted + sign * _DEGREES * deadband, color, said, dashed=True))
    over = Over(f"attitude error {letter}", "deg", (-wide, wide))
    return Panel(f"rate {letter}", "deg/s", tuple(marks), limits=(-high, high), over=over)


def _beyond(values: Array, least: float) -> float:
    """Computes half the width of a range around zero that holds all values with some margin."""
    return 1.1 * max(float(np.nan_to_num(np.abs(values)).max()), least) or 1.0


def rates_estimated(run: Source) -> Plot:
    """Plots the angular rate as the filter has it, of a vehicle without gyro."""
    title = "Angular rate, estimated"
    return _vector(run, "rates_estimated", "rate_estimate", title, "deg/s", scale=_DEGREES, axes=run.turning)


def torques(run: Source) -> Plot:
    """Plots the applied torque about the center of mass (figure 5-4)."""
    return _vector(run, "torques", "torque", "Applied torque about the center of mass", steps=True, axes=run.turning)


def forces(run: Source) -> Plot:
    """Plots the applied force (figure 5-5)."""
    return _vector(run, "forces", "force", "Applied force", steps=True, axes=run.moving)


_OF_THRUST = (("torques", "torque", torques), ("forces", "force", forces))


def gyro_readings(run: Source) -> Plot:
    """Plots the angular rate as each gyro package read it."""
    names = [gyro.name for gyro in run.vehicle.gyros]
    return _readings(run, "gyro_readings", names, "Angular rate, as read", "deg/s", _DEGREES)


def accelerometer_velocities(run: Source) -> Plot:
    """Plots the integrated specific force as each accelerometer package read it."""
    names = [package.name for package in run.vehicle.accelerometers]
    unit = f"{run.vehicle.unit_names['length']}/s"
    return _readings(run, "accelerometer_velocities", names, "Integrated specific force, as read", unit, 1.0)


def against_rates(run: Source) -> Plot:
    """Plots the angular rate as the gyro in use read it, and as a simulation of the same commands has it."""
    name = params.gyro(run.scenario).name
    return _against(run, "against_rates", name, "Angular rate", "deg/s", _DEGREES)


def against_velocities(run: Source) -> Plot:
    """Plots the integrated specific force as the accelerometer in use read it, and as a simulation has it."""
    name = params.accelerometers(run.scenario)[0].name
    unit = f"{run.vehicle.unit_names['length']}/s"
    return _against(run, "against_velocities", name, "Integrated specific force", unit, 1.0)


def against_positions(run: Source) -> Plot:
    """Plots the position of the first point that is followed, as read and as simulated with the same commands."""
    name = next(pose.name for pose in run.vehicle.poses if pose.position_std is not None)
    return _against(run, "against_positions", name, "Position", run.vehicle.unit_names["length"], 1.0)


def against_attitudes(run: Source) -> Plot:
    """Plots the rotation from the simulated attitude to the read one, of the first attitude that is read."""
    name = next(pose.name for pose in run.vehicle.poses if pose.attitude_std is not None)
    left = _DEGREES * turned(run.signals[name][:, 3:], run.signals[AGAINST + name][:, 3:])
    panels = [Panel(AXES[axis], "deg", (Line(run.time_s, left[:, axis], COLORS[axis]),)) for axis in run.turning]
    meaning = "from the attitude that the simulation has to the one that was read, body axes"
    title = "Attitude, beside a simulation of the same commands: difference"
    return _plot(run, "against_attitudes", title, panels, meaning=meaning)


def _against(run: Source, name: str, package: str, title: str, unit: str, scale: float) -> Plot:
    """Plots, for each axis that moves, what was read and simulated, and the difference."""
    read, simulated = scale * run.signals[package], scale * run.signals[AGAINST + package]
    panels = []
    turns = any(gyro.name == package for gyro in run.vehicle.gyros)
    for axis in run.turning if turns else run.moving:
        letter = AXES[axis]
        lines = (
            Line(run.time_s, read[:, axis], COLORS[axis], f"{package}, as read"),
            Line(run.time_s, simulated[:, axis], TRUTH_COLOR, "simulated", dashed=True),
        )
        left = Line(run.time_s, (read - simulated)[:, axis], COLORS[axis])
        panels += [Panel(letter, unit, lines), Panel(f"{letter}, difference", unit, (left,))]
    meaning = "difference: what was read less what the simulation reads"
    return _plot(run, name, f"{title}, beside a simulation of the same commands", panels, meaning=meaning)


def jets(run: Source) -> Plot:
    """Plots the commands to each jet, a row per jet, by cluster."""
    every = run.vehicle.jets
    order = sorted(range(len(every)), key=lambda index: (every[index].cluster, index))
    if not run.clustered:
        rows = [_Row(every[index].designation, every[index].cluster, (index,)) for index in order]
        return _firings(run, "jets", "Jets", "", rows)
    rows = [
        _Row(f"{every[index].designation} ({every[index].cluster})", every[index].cluster, (index,)) for index in order
    ]
    return _firings(run, "jets", "Jets, one by one", "jet (cluster)", rows)._replace(folded=True)


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
    return _firings(run, "clusters", "Jets by cluster", "", rows)


class _Row(NamedTuple):
    """Jets that share a row, its name, and the cluster that gives its color."""

    name: str
    cluster: int
    jets: tuple[int, ...]


def _firings(run: Source, name: str, title: str, label: str, rows: Sequence[_Row]) -> Plot:
    """Makes bars of command and, where known, of true thrust below; uncommanded thrust in another color."""
    command = np.nan_to_num(run.signals["command"]) > 0.0
    marks = [
        _bars(run, rows, command, -0.2 if "thrust" in run.signals else 0.0, None, "commanded"),
    ]
    meaning = ""
    if "thrust" in run.signals:
        level = run.signals["thrust"] / np.linalg.norm(run.vehicle.thrusts, axis=1)
        seen = motion.plumes(level, command, failing(run.time_s, run.scenario))
        marks.append(_bars(run, rows, seen["given"], 0.2, TRUTH_COLOR, "thrust"))
        marks.append(_bars(run, rows, seen["untold"], 0.2, FAILED_COLOR, "thrust untold"))
        meaning = "upper bar: commanded; lower bar: true thrust, orange: of a failed jet, untold"
    every = tuple(mark for part in marks for mark in part)
    return _plot(run, name, title, [Panel(label, "", every, rows=tuple(row.name for row in rows))], meaning=meaning)


def _bars(
    run: Source, rows: Sequence[_Row], on: NDArray[np.bool_], offset: float, color: str | None, label: str
) -> list[Bars]:
    """Makes bars of one kind in all rows, by color; None: each in that of its cluster."""
    by_color: dict[str, list[Array]] = {}  # rows of begin, end and row
    for number, row in enumerate(rows):
        begin, end = _intervals(run.time_s, np.asarray(on[:, list(row.jets)].any(axis=1)))
        bars = np.column_stack([begin, end, np.full(begin.shape, number + offset)])
        by_color.setdefault(color or COLORS[row.cluster % (len(COLORS) - 1)], []).append(bars)
    height = 0.4 if offset else 0.84
    made = []
    for each, parts in by_color.items():
        begin, end, place = np.vstack(parts).T
        made.append(Bars(begin, end, place, each, height, label))
    return made


def failing(time_s: Array, scenario: Scenario) -> NDArray[np.bool_]:
    """Finds samples, each from its row to the next, in which a jet truly fails, shape (n, n_jets)."""
    vehicle = scenario.vehicle_data
    found = np.zeros((time_s.size, len(vehicle.jets)), dtype=bool)
    for failure in scenario.failures:
        end_s = np.inf if failure.end_s is None else failure.end_s
        within = (time_s > failure.start_s - vehicle.sample_period_s + 1e-9) & (time_s < end_s - 1e-9)
        found[within, vehicle.jet_index(failure.jet)] = True
    return found


def propellant(run: Source) -> Plot:
    """Plots the propellant used, by the jets' thrust or, where that is not known, by their commands."""
    full, flows = np.linalg.norm(run.vehicle.thrusts, axis=1), true_params.plant_mass_flows(run.scenario)
    level = run.signals["thrust"] / full if "thrust" in run.signals else np.nan_to_num(run.signals["command"])
    rate = (level * flows).sum(axis=1) * run.vehicle.sample_period_s
    used = np.concatenate([[0.0], np.cumsum(rate[:-1])])
    line = Line(run.time_s, used, COLORS[0])
    return _plot(run, "propellant", "Propellant used", [Panel("used", run.vehicle.unit_names["mass"], (line,))])


def _intervals(time_s: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Finds beginnings and ends of the intervals in which a jet is commanded, s.

    What a row commands lasts until the next row, also where rows are left out; the last row commands nothing.
    """
    change = np.flatnonzero(np.diff(on[:-1], prepend=False, append=False))
    return time_s[change[::2]], time_s[change[1::2]]


def _vector(
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
    """Plots a vector signal, a panel for each of some axes."""
    values = scale * run.signals[signal]
    unit = unit or in_units(SIGNALS[signal].unit, run.vehicle.unit_names)
    panels = [Panel(AXES[axis], unit, (Line(run.time_s, values[:, axis], COLORS[axis], steps=steps),)) for axis in axes]
    return _plot(run, name, title, panels)


def _readings(run: Source, name: str, packages: Sequence[str], title: str, unit: str, scale: float) -> Plot:
    """Plots the readings of packages of one kind, a panel per axis and a color per package."""
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
    return _plot(run, name, title, panels)


# --------------------------------------------------------------------------------------- estimates


def inverse_inertia_diagonal(run: Source) -> Plot:
    """Plots errors of the diagonal of the inverse inertia (figure 5-6a)."""
    return _parameters(run, "inverse_inertia_diagonal", _DIAGONAL, "Inverse inertia, diagonal")


def inverse_inertia_products(run: Source) -> Plot:
    """Plots errors of the products of the inverse inertia (figure 5-6b)."""
    return _parameters(run, "inverse_inertia_products", _PRODUCTS, "Inverse inertia, products")


def center_of_mass(run: Source) -> Plot:
    """Plots errors of the center of mass (figure 5-7)."""
    return _parameters(run, "center_of_mass", _CENTER, "Center of mass")


def mass_reciprocal(run: Source) -> Plot:
    """Plots the error of the mass reciprocal (figure 5-12)."""
    return _parameters(run, "mass_reciprocal", (9,), "Mass reciprocal")


def _parameters(run: Source, name: str, elements: tuple[int, ...], title: str) -> Plot:
    """Plots estimation errors with their 3-sigma band; without the truth the estimates with theirs.

    Another estimate, an output `estimate` of ten numbers of a system of the user's own, is drawn beside.
    """
    panel, what = (_error, "estimation error") if run.simulated else (_estimate, "estimate")
    return _plot(run, name, f"{title}: {what}", [panel(run, element) for element in _estimated(run, elements)])


def _other_estimates(run: Source, element: int) -> dict[str, tuple[Array, str]]:
    """Returns estimates of a parameter by systems of the user's own, by the system's name, with their colors."""
    names = [name for name in run.signals if is_own(name) and name.endswith(".estimate")]
    found = {name.rpartition(".")[0]: run.signals[name] for name in names if run.signals[name].shape[1] == len(SYMBOLS)}
    there = {name: values[:, element] for name, values in found.items() if np.isfinite(values[:, element]).any()}
    return {name: (values, COLORS[3 + number % 3]) for number, (name, values) in enumerate(there.items())}


def _estimated(run: Source, elements: tuple[int, ...]) -> list[int]:
    """Selects the parameters that are estimated, and neither fixed nor of no effect in a plane."""
    known = params.known_parameters(run.scenario)
    return [element for element in elements if not known[element]]


def thrust_factors(run: Source) -> Plot:
    """Plots the acceleration by each jet, over the nominal one: one panel a jet."""
    factor, deviation = run.signals["thrust_factor"], run.signals["thrust_factor_std"]
    panels = []
    for jet, name in enumerate(run.vehicle.designations):
        value, band = factor[:, jet], 3.0 * deviation[:, jet]
        marks = (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.2g}"),
            Line(run.time_s, value, COLORS[jet % 3], f"factor, at the end {value[-1]:.3g}"),
        )
        panels.append(Panel(name, "", marks, limits=_last_half(value, band)))
    title = "Thrust factors: acceleration by each jet over nominal"
    return _plot(run, "thrust_factors", title, panels)


def surroundings(run: Source) -> Plot:
    """Plots estimates besides the vehicle: the delay of commands, drag, and turning that goes with the heading."""
    shown = [("command_delay", 0, "delay of commands", "s")]
    shown += [("drag_rate", 0, "drag", "1/s"), ("drag_rate", 1, "angular drag", "1/s")]
    shown += [("heading_turn", part, f"turning, {name}", "rad/s^2") for part, name in enumerate(("cosine", "sine"))]
    panels = []
    for number, (signal, column, label, unit) in enumerate(shown):
        value, deviation = (run.signals[name][:, column] for name in (signal, f"{signal}_std"))
        if not deviation.max(initial=0.0) > 0.0:  # known, or of no effect
            continue
        band = 3.0 * deviation
        marks = (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.2g} {unit}"),
            Line(run.time_s, value, COLORS[number % 3], f"estimate, at the end {value[-1]:.3g} {unit}"),
        )
        panels.append(Panel(label, unit, marks, limits=_last_half(value, band)))
    meaning = "drag over mass, angular drag over inertia; turning: angular acceleration that goes with the heading"
    return _plot(run, "surroundings", "Delay of commands, and surroundings", panels, meaning=meaning)


def _error(run: Source, element: int) -> Panel:
    """Makes the estimation error in percent of the truth, or in the parameter's unit where the truth is near zero."""
    truth = run.signals["truth"]
    true = truth[:, element]
    unit, scale = mass_property_units(run.vehicle.unit_names)[element], np.ones_like(true)
    if np.abs(true).min() > 1e-12 * np.abs(truth).max():
        unit, scale = "%", 100.0 / np.abs(true)
    error = scale * (run.signals["estimate"][:, element] - true)
    band = scale * 3.0 * run.signals["standard_deviation"][:, element]
    others = {
        name: (scale * (values - true), color) for name, (values, color) in _other_estimates(run, element).items()
    }
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, -band, band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, error, COLORS[element % 3], f"error, at the end {error[-1]:.3g} {unit}"),
            *_beside(run, others, unit, 3),
        ),
        scale=SymmetricLog(float(band[-1]), float(np.nanmax(np.abs([error, band])))),
    )


def _estimate(run: Source, element: int) -> Panel:
    """Makes the estimate of a parameter, on a scale that the end of the record sets."""
    value = run.signals["estimate"][:, element]
    band = 3.0 * run.signals["standard_deviation"][:, element]
    unit = mass_property_units(run.vehicle.unit_names)[element]
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, value, COLORS[element % 3], f"estimate, at the end {value[-1]:.5g} {unit}"),
            *_beside(run, _other_estimates(run, element), unit, 5),
        ),
        limits=_last_half(value, band),
    )


def _beside(run: Source, others: Mapping[str, tuple[Array, str]], unit: str, digits: int) -> list[Line]:
    """Makes lines of others' estimates or errors, by name, each with its color."""
    return [
        Line(run.time_s, values, color, f"{name}, at the end {values[-1]:.{digits}g} {unit}", width=THIN_LINE)
        for name, (values, color) in others.items()
    ]


def _last_half(value: Array, band: Array) -> tuple[float, float]:
    """Computes limits that show an estimate, and its band over the last half; the first band may be huge."""
    half = value.size // 2
    low = min(float(value.min()), float((value - band)[half:].min()))
    high = max(float(value.max()), float((value + band)[half:].max()))
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def consistency(run: Source) -> Plot:
    """Describes the plot of NIS of rotation and of mass at the samples used (figures 5-8, 5-13)."""
    panels = []
    filters = [name for name in ("rotation", "mass") if f"{name}_nis" in run.signals]
    for name, color in zip(filters, COLORS, strict=False):
        used = run.where(f"{name}_used")
        nis = run.signals[f"{name}_nis"][used, 0]
        marks = (
            Zone(*NIS_LIMITS, label="95 % of chi-square, 3 degrees of freedom"),
            Points(run.time_s[used], nis, color, _mean_nis(run, name, nis)),
        )
        most = float(nis.max(initial=NIS_LIMITS[1]))
        panels.append(Panel(f"{name} filter", "", marks, scale="log", limits=(_LEAST_NIS, 2.0 * most)))
    return _plot(run, "consistency", "Consistency: NIS at the samples used", panels)


def innovations(run: Source) -> Plot:
    """Plots innovations of rotation at the samples used, with 3 sigma by the filter's own covariance."""
    return _innovations(run, "innovations", "rotation", _DEGREES, "deg/s")


def mass_innovations(run: Source) -> Plot:
    """Plots innovations of translation at the samples used, with 3 sigma by the filter's own covariance."""
    return _innovations(run, "mass_innovations", "mass", 1.0, f"{run.vehicle.unit_names['length']}/s")


_TURNED_OR_MOVED = {"rotation": "rotation", "mass": "translation"}  # by how a filter's signals begin


def _innovations(run: Source, name: str, filtered: str, scale: float, unit: str) -> Plot:
    """Plots innovations of a filter, a panel per axis."""
    used = run.where(f"{filtered}_used")
    time_s, values = run.time_s[used], scale * run.signals[f"{filtered}_innovation"][used]
    bands = 3.0 * scale * run.signals.get(f"{filtered}_innovation_std", np.full((run.time_s.size, 3), np.nan))[used]
    panels = []
    for axis, letter in enumerate(AXES):
        value, band = values[:, axis], bands[:, axis]
        marks: list[Mark] = [Points(time_s, value, COLORS[axis], "innovation" if axis == 0 else "")]
        if np.isfinite(band).any():  # not in runs made before it was logged
            label = "3 sigma by the filter's own covariance" if axis == 0 else ""
            marks.insert(0, Whiskers(time_s, -band, band, BAND_COLOR, label))
        limit = _reach(value, band)
        marks += _beyond_edges(time_s, value, limit, COLORS[axis])
        limits = (-limit, limit) if limit > 0.0 else None
        panels.append(Panel(letter, unit, tuple(marks), limits=limits, most=True))
    return _plot(run, name, f"Innovations of {_TURNED_OR_MOVED[filtered]} at the samples used", panels)


_NORMAL = 4.45  # 3 sigma of a normal distribution over the median of its magnitudes
_ROOM = 1.5  # that is left around
_EDGE, _EDGE_SIZE = 0.94, 5.0  # where a value beyond the limits stands, of them, and the size of its triangle, points


def _reach(values: Array, band: Array) -> float:
    """Computes the range of an axis that shows the usual band, and 3 sigma of the values by their median; 0: none.

    Half of the values may be anywhere beyond. A median is a value that is there, the lower one of two, so that a page
    finds the same for a part of them.
    """
    found = [
        times * float(np.quantile(np.abs(part[np.isfinite(part)]), 0.5, method="lower"))
        for part, times in ((values, _NORMAL), (band, 1.0))
        if np.isfinite(part).any()
    ]
    return _ROOM * max(found, default=0.0)


def _beyond_edges(time_s: Array, values: Array, limit: float, color: str) -> list[Mark]:
    """Makes triangles at the edges for the values beyond them; for a zoomed part of the time a page makes its own."""
    high, low = values > limit, values < -limit
    count = int(high.sum() + low.sum())
    said = f"{count} beyond the axis" if count else ""
    places: tuple[tuple[NDArray[np.bool_], float, Literal["up", "down"], str], ...]
    places = ((high, _EDGE, "up", said), (low, -_EDGE, "down", ""))
    return [
        Points(time_s[there], np.full(int(there.sum()), share * limit), color, label, _EDGE_SIZE, symbol)
        for there, share, symbol, label in places
    ]


def _mean_nis(run: Source, name: str, nis: Array) -> str:
    means = run.consistency
    if means is None:
        mean = float(nis.mean()) if nis.size else None
        within, of = float(nis[nis <= _RARE_NIS].mean()) if (nis <= _RARE_NIS).any() else None, f"{nis.size}"
    else:
        mean, within = (means.get(f"{_TURNED_OR_MOVED[name]}_nis_{which}") for which in ("mean", "within"))
        of = "all"
    if mean is None:
        return "NIS, no sample used"
    if within is None or not ruled(mean, within):
        return f"NIS, mean {mean:.2f} of {of} samples{'' if means is None else ' used'}"
    return f"NIS, mean {within:.2f} ({mean:.4g} with those beyond 99 %)"


# ---------------------------------------------------------------------------------------- detector


def likelihoods(run: Source) -> Plot:
    """Plots likelihood arguments of all jets, and of the clusters (figures 5-16, 5-19, 5-22, 5-25).

    The detector by thrust factors has the lead of each jet's failure over no failure in their place.
    """
    tested = run.where("tested")
    of_jets = run.signals["likelihood"][tested]
    clusters = np.array([jet.cluster for jet in run.vehicle.jets])
    numbers = np.unique(clusters)
    of_clusters = np.stack([of_jets[:, clusters == number].max(axis=1) for number in numbers], axis=1)
    declared = np.zeros(clusters.size, dtype=bool)
    if "known_force_variance" in run.signals:
        declared |= (run.signals["known_force_variance"] > 0.0).any(axis=0)
    said = run.signals["detector_event"][:, 0] == Code.DECLARED  # what is off has no known force
    declared[run.signals["suspected_jet"][said, 0].astype(int)] = True
    panels = [_highest(run.time_s[tested], of_jets, run.vehicle.designations, "of the jets", declared)]
    if run.clustered:
        groups, found = [f"cluster {number}" for number in numbers], np.isin(numbers, clusters[declared])
        panels.append(_highest(run.time_s[tested], of_clusters, groups, "of the clusters", found))
    leads = run.scenario.detector.kind == "thrust_factors"
    title = "Lead of each jet's failure over no failure, nats" if leads else "Likelihood arguments of a failed jet"
    others = any(isinstance(mark, Whiskers) for panel in panels for mark in panel.marks)
    return _plot(run, "likelihoods", title, panels, meaning="gray: the range of the others" if others else "")


def _highest(time_s: Array, values: Array, names: Sequence[str], label: str, declared: NDArray[np.bool_]) -> Panel:
    """Plots statistics of many candidates: declared ones and the highest by name, others as a range in gray.

    What was declared is drawn last, and so on top. All are there to be read.
    """
    shown = np.maximum(values, _FLOOR)
    limits = (_FLOOR, max(10.0, 2.0 * float(np.fmax.reduce(shown, axis=None, initial=1.0))))
    if not time_s.size:
        return Panel(label, "", (), scale="log", limits=limits)
    most = np.fmax.reduce(shown, axis=0, initial=_FLOOR)  # of what there is: a detector need not judge all at all times
    order, reaching = np.lexsort((-most, ~declared)), int((most > _FLOOR).sum())
    top, rest = np.split(order, [min(_NAMED, max(1, reaching))])
    top = top[np.argsort(declared[top], kind="stable")]
    marks: list[Mark] = []
    if rest.size:
        low, high = (reduced(shown[:, rest], axis=1) for reduced in (np.fmin.reduce, np.fmax.reduce))
        marks.append(Whiskers(time_s, low, high, BAND_COLOR, "range of the others"))
    marks += [Points(time_s, shown[:, column], BAND_COLOR, names[column], drawn=False, group=label) for column in rest]
    for column, color in zip(top, COLORS, strict=False):
        size = POINT_SIZE if declared[column] else 0.7 * POINT_SIZE
        marks.append(Points(time_s, shown[:, column], color, names[column], size=size, group=label))
    return Panel(label, "", tuple(marks), scale="log", limits=limits)


def fault_probabilities(run: Source) -> Plot:
    """Plots posterior probabilities of faults: of the jets that reach 1 %, of nothing, and of something unknown."""
    of_jets, names = run.signals["fault_probability"], run.vehicle.designations
    most = np.fmax.reduce(of_jets, axis=0, initial=0.0)
    order = [jet for jet in np.argsort(-most, kind="stable").tolist() if most[jet] > LEAST_SHOWN]
    marks: list[Mark] = []
    if rest := order[_NAMED:]:
        low, high = (reduced(of_jets[:, rest], axis=1) for reduced in (np.fmin.reduce, np.fmax.reduce))
        marks.append(Whiskers(run.time_s, low, high, BAND_COLOR, f"range of {len(rest)} others"))
    marks += [Points(run.time_s, of_jets[:, jet], BAND_COLOR, names[jet], drawn=False, group="jets") for jet in rest]
    for jet, color in zip(order, COLORS[:_NAMED], strict=False):
        marks.append(Line(run.time_s, of_jets[:, jet], color, f"{names[jet]}, {_at_end(of_jets[:, jet])}", steps=True))
    others = []
    for name, color in (("none", TRUTH_COLOR), ("unknown", FAILED_COLOR)):
        values = run.signals[f"{name}_probability"][:, 0]
        others.append(Line(run.time_s, values, color, f"{name}, {_at_end(values)}", steps=True))
    limits = (-0.02, 1.02)
    panels = [Panel("jet has failed", "", tuple(marks), limits=limits)] if marks else []
    panels.append(Panel("nothing, or unknown", "", tuple(others), limits=limits))
    meaning = "none: nothing has failed or changed; unknown: something pushes that nothing else explains"
    return _plot(run, "fault_probabilities", "Probability of faults", panels, meaning=meaning)


def _at_end(values: Array) -> str:
    return f"at the end {rounded(float(values[-1]))}"


def margins(run: Source) -> Plot:
    """Plots margins of the likeliest jet and cluster (figures 5-17, 5-20, 5-23, 5-26)."""
    tested = run.where("tested")
    limit = getattr(run.scenario.detector, "margin", None)  # a matter of the method
    levels = () if limit is None else (Level(limit, label=f"isolated above {limit:g}"),)
    sides = (("jet_margin", "jet, within its cluster"), ("cluster_margin", "cluster, over all others"))
    panels = []
    for (name, label), color in zip(sides, COLORS, strict=False):
        values = np.maximum(run.signals[name][tested, 0], _FLOOR)
        marks = (Points(run.time_s[tested], values, color), *levels)
        panels.append(Panel(label, "", marks, scale="log"))
    return _plot(run, "margins", "Margins of the likeliest", panels)


def failure_magnitude(run: Source) -> Plot:
    """Plots the magnitude of a failure (figures 5-18, 5-21, 5-24, 5-27).

    Shows the estimate for the likeliest jet at every alarm, with its 1-sigma; the truth of the jets that were
    suspected or do fail; and the force that is taken as known from then on.
    """
    marks: list[Mark] = []
    alarm = run.where("alarm")
    if "thrust" in run.signals:
        jets = run.signals["suspected_jet"][alarm, 0]
        suspected = jets[~np.isnan(jets)].astype(int).tolist()
        failed = [run.vehicle.jet_index(failure.jet) for failure in run.scenario.failures]
        for jet, color in zip(dict.fromkeys(suspected + failed), (TRUTH_COLOR, *COLORS[2:]), strict=False):
            expected = run.vehicle.jets[jet].thrust * run.signals["command"][:, jet]
            label = f"truth of {run.vehicle.designations[jet]}"
            marks.append(Line(run.time_s, run.signals["thrust"][:, jet] - expected, color, label, steps=True))
    known = run.signals["known_force_variance"] > 0.0
    for jet in np.flatnonzero(known.any(axis=0)):
        force = np.where(known[:, jet], run.signals["known_force"][:, jet], np.nan)
        label = f"known force of {run.vehicle.designations[jet]}"
        marks.append(Line(run.time_s, force, COLORS[1], label, width=1.4, dashed=True))
    if alarm.size:
        time_s, magnitude = run.time_s[alarm], run.signals["suspected_magnitude"][alarm, 0]
        deviation = run.signals["suspected_magnitude_std"][alarm, 0]
        marks += [
            Whiskers(time_s, magnitude - deviation, magnitude + deviation, COLORS[0]),
            Points(time_s, magnitude, COLORS[0], "likeliest jet, 1-sigma"),
        ]
    panel = Panel("magnitude", run.vehicle.unit_names["force"], tuple(marks))
    return _plot(run, "failure_magnitude", "Magnitude of the failure", [panel])


def detection_timeline(run: Source) -> Plot:
    """Plots tests, alarms and declarations beside the rates and the number of jets commanded."""
    rate = _DEGREES * motion.rate(run.scenario, run.signals)
    turning = tuple(Line(run.time_s, rate[:, axis], COLORS[axis], AXES[axis]) for axis in run.turning)
    count = (run.signals["command"] > 0.0).sum(axis=1).astype(float)
    commanded = Band(run.time_s, np.zeros_like(count), count, COLORS[0], opacity=0.6, steps=True)
    rows = {
        "tested": ("tested", BAND_COLOR),
        "alarm": ("alarm", COLORS[4]),
        "jet_isolated": ("names the jet", COLORS[1]),
    }
    ticks = []
    for row, (name, (_, color)) in enumerate(rows.items()):
        at = run.time_s[run.where(name)]
        ticks.append(Points(at, np.full(at.shape, float(row)), color, size=9.0, symbol="tick"))
    panels = [
        Panel("rate", "deg/s", turning),
        Panel("jets commanded", "", (commanded,)),
        Panel("", "", tuple(ticks), rows=tuple(label for label, _ in rows.values())),
    ]
    return _plot(run, "detection_timeline", "Detection", panels)


def own_signals(run: Source) -> Plot:
    """Plots signals of the user's own systems that nothing else shows, a panel for each."""
    panels = []
    for name in _own(run):
        values = run.signals[name]
        components = range(values.shape[1])
        marks = [
            Line(run.time_s, values[:, at], COLORS[at % len(COLORS)], f"{at}" if len(components) > 1 else "")
            for at in components
        ]
        panels.append(Panel(name, "", tuple(marks)))
    return _plot(run, "own_signals", "Signals of your own", panels)


_READABLE = 12  # components of a signal that are drawn, at the most


def _own(run: Source) -> list[str]:
    """Returns names of the user's own signals that no other plot shows; long vectors are left out."""
    drawn = {f"{name}.estimate" for element in range(len(SYMBOLS)) for name in _other_estimates(run, element)}
    return [
        name
        for name, values in run.signals.items()
        if is_own(name)
        and not name.startswith(AGAINST)
        and name not in drawn
        and values.shape[1] <= _READABLE
        and np.isfinite(values).any()
    ]


# ------------------------------------------------------------------------------------ what all show


def _plot(run: Source, name: str, title: str, panels: Sequence[Panel], *, meaning: str = "") -> Plot:
    """Makes a plot with what every plot of a run has: the run's name, and its events."""
    drawn = f", seed {run.scenario.seed}" if run.simulated else ""
    caption = f"{run.vehicle.name}, {run.scenario.name}{drawn}"
    windows, moments = _windows(run), _moments(run)
    meanings = {
        "shaded: hand controller out of detent": any(window.armed for window in windows),
        "gray: detector not armed": any(not window.armed for window in windows),
        "dotted: it happens": any(not moment.declared for moment in moments),
        "red line: it is declared": any(moment.declared for moment in moments),
    }
    note = ", ".join(meaning for meaning, there in meanings.items() if there)
    return Plot(name, title, caption, run.time_s, tuple(panels), windows, moments, note, meaning)


def _windows(run: Source) -> tuple[ShadedWindow, ...]:
    """Returns windows in which a hand controller is out of detent, or the detector is not armed."""
    commanded = tuple(
        ShadedWindow(window.start_s, window.end_s, f"{window.controller.upper()} {window.axis}")
        for window in run.scenario.maneuver
        if window.start_s < run.time_s[-1]
    )
    if "tested" not in run.signals:
        return commanded
    start_s, until_s = float(run.time_s[0]), armed_from(run)
    end_s = float(run.time_s[-1]) if until_s is None else until_s
    return (ShadedWindow(start_s, end_s, "", armed=False), *commanded) if end_s - start_s > PROMPT_S else commanded


def armed_from(run: Source) -> float | None:
    """Returns when the detector tested a sample for the first time, s; None: it never did."""
    tested = run.where("tested")
    return float(run.time_s[tested[0]]) if tested.size else None


def _moments(run: Source) -> tuple[MomentLine, ...]:
    """Returns moments at which jets fail and mass properties jump, and at which the detector declares it."""
    happens = [failure.start_s for failure in run.scenario.failures] + [jump.time_s for jump in run.scenario.jumps]
    declared = run.time_s[run.where("detector_event")].tolist() if "detector_event" in run.signals else []
    return (
        *(MomentLine(time_s, declared=False) for time_s in happens if time_s <= run.time_s[-1]),
        *(MomentLine(time_s, declared=True) for time_s in declared),
    )
