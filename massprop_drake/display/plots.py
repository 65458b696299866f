"""The plots of a run, each described once: panels and marks from its signals, in units and colors.

Every function takes a `Source` and returns a `Plot`; `available` names those that a source has the signals
for. Their figure numbers are those of the thesis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.spec import (
    Band,
    Bars,
    Level,
    Line,
    Mark,
    Moment,
    Panel,
    Plot,
    Points,
    SymmetricLog,
    Whiskers,
    Window,
    Zone,
)
from massprop_drake.display.style import BAND_COLOR, COLORS, FAILED_COLOR, POINT_SIZE, SHOWN, TRUTH_COLOR
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.signals import AXES, SIGNALS, SYMBOLS, in_units, mass_property_units

if TYPE_CHECKING:
    from massprop_drake.results.run import Run

Array = NDArray[np.float64]

NIS_LIMITS = (0.21579528262389802, 9.348403604496148)  # 2.5 and 97.5 % of chi-square, 3 degrees of freedom
_DEGREES = 180.0 / np.pi
_FLOOR = 0.1  # of statistics on a logarithmic scale: what lies below says nothing
PROMPT_S = 1.0  # a detector that tests as soon is armed from the start
_NAMED = 5  # jets, or clusters, with a color of their own; the others are gray


class Source(NamedTuple):
    """What plots are made from.

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
        """Whether the truth is known; if not, the signals come from telemetry."""
        return "truth" in self.signals

    def where(self, name: str) -> NDArray[np.int_]:
        """Rows at which a signal of one component is not zero, shape (k,)."""
        return np.flatnonzero(self.signals[name][:, 0] != 0.0)


def source(run: Run) -> Source:
    """A run, or some of its rows, as a source of plots."""
    return Source(run.time_s, run.signals, run.scenario, run.summary["consistency"] if run.thinned else None)


def available(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """The plots of a run by name, in the order to read them."""
    found: dict[str, Callable[[Source], Plot]] = {}
    if run.simulated:
        found["rates"] = rates
        if "attitude_error" in run.signals:
            found["attitude_error"] = attitude_error
        found |= {"velocities": velocities, "clusters": clusters, "jets": jets, "torques": torques, "forces": forces}
    else:  # recorded telemetry: what was read, in place of what was true
        if run.vehicle.accelerometers:
            found["accelerometer_velocities"] = accelerometer_velocities
        if run.vehicle.gyros:
            found["gyro_readings"] = gyro_readings
        found |= {"clusters": clusters, "jets": jets}
    for name, plot in (
        ("inverse_inertia_diagonal", inverse_inertia_diagonal),
        ("inverse_inertia_products", inverse_inertia_products),
        ("center_of_mass", center_of_mass),
    ):
        if _estimated(run, _ELEMENTS[name]):
            found[name] = plot
    if "mass_nis" in run.signals:  # there is an accelerometer
        found["mass_reciprocal"] = mass_reciprocal
    found["consistency"] = consistency
    if "rotation_innovation" in run.signals and run.scenario.estimation.filter != "pose":  # which has several kinds
        found["innovations"] = innovations
    if run.consistency is None:
        found["propellant"] = propellant
    if "likelihood" in run.signals:
        found |= {
            "likelihoods": likelihoods,
            "margins": margins,
            "failure_magnitude": failure_magnitude,
            "detection_timeline": detection_timeline,
        }
    return found


# ------------------------------------------------------------------------------------------ motion


def rates(run: Source) -> Plot:
    """Angular velocity (figure 5-2)."""
    return _vector(run, "rates", "rate", "Angular rate", "deg/s", scale=_DEGREES)


def velocities(run: Source) -> Plot:
    """Velocity of the center of mass relative to the start, inertial axes (figure 5-3)."""
    title = "Velocity of the center of mass, relative to the start, inertial axes"
    return _vector(run, "velocities", "velocity", title)


def attitude_error(run: Source) -> Plot:
    """Attitude error in hold."""
    return _vector(run, "attitude_error", "attitude_error", "Attitude error in hold", "deg", scale=_DEGREES)


def torques(run: Source) -> Plot:
    """Applied torque about the center of mass (figure 5-4)."""
    return _vector(run, "torques", "torque", "Applied torque about the center of mass", steps=True)


def forces(run: Source) -> Plot:
    """Applied force (figure 5-5)."""
    return _vector(run, "forces", "force", "Applied force", steps=True)


def gyro_readings(run: Source) -> Plot:
    """Angular rate as each gyro package read it."""
    names = [gyro.name for gyro in run.vehicle.gyros]
    return _readings(run, "gyro_readings", names, "Angular rate, as read", "deg/s", _DEGREES)


def accelerometer_velocities(run: Source) -> Plot:
    """Integrated specific force as each accelerometer package read it."""
    names = [package.name for package in run.vehicle.accelerometers]
    unit = f"{run.vehicle.unit_names['length']}/s"
    return _readings(run, "accelerometer_velocities", names, "Integrated specific force, as read", unit, 1.0)


def jets(run: Source) -> Plot:
    """Which jet was commanded when, a row per jet, by cluster."""
    every = run.vehicle.jets
    order = sorted(range(len(every)), key=lambda index: (every[index].cluster, index))
    rows = [
        _Row(f"{every[index].designation} ({every[index].cluster})", every[index].cluster, (index,)) for index in order
    ]
    return _firings(run, "jets", "Jets, one by one", "jet (cluster)", rows)._replace(folded=True)


def clusters(run: Source) -> Plot:
    """Which cluster was commanded when, and what it gave; jets that fail or are declared have rows of their own."""
    every = run.vehicle.jets
    alone = {
        run.vehicle.jet_index(failure.jet) for failure in run.scenario.failures if failure.start_s <= run.time_s[-1]
    }
    if "known_force_variance" in run.signals:
        alone |= set(np.flatnonzero((run.signals["known_force_variance"] > 0.0).any(axis=0)).tolist())
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
    """Bars of command and, where it is known, of true thrust below; that of failed jets untold in another color."""
    command = np.nan_to_num(run.signals["command"]) > 0.0
    marks = [
        _bars(run, rows, command, -0.2 if run.simulated else 0.0, None, "commanded"),
    ]
    meaning = ""
    if run.simulated:
        thrust = run.signals["thrust"] / np.linalg.norm(run.vehicle.thrusts, axis=1) > SHOWN
        untold = thrust & ~command & failing(run.time_s, run.scenario)
        marks.append(_bars(run, rows, thrust & ~untold, 0.2, TRUTH_COLOR, "thrust"))
        marks.append(_bars(run, rows, untold, 0.2, FAILED_COLOR, "thrust untold"))
        meaning = "upper bar: commanded; lower bar: true thrust, orange: of a failed jet, untold"
    every = tuple(mark for part in marks for mark in part)
    return _plot(run, name, title, [Panel(label, "", every, rows=tuple(row.name for row in rows))], meaning=meaning)


def _bars(
    run: Source, rows: Sequence[_Row], on: NDArray[np.bool_], offset: float, color: str | None, label: str
) -> list[Bars]:
    """Bars of one kind in all rows, by color; None: each in that of its cluster."""
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
    """In which samples, each from its row to the next, a jet truly fails, shape (n, n_jets)."""
    vehicle = scenario.vehicle_data
    found = np.zeros((time_s.size, len(vehicle.jets)), dtype=bool)
    for failure in scenario.failures:
        end_s = np.inf if failure.end_s is None else failure.end_s
        within = (time_s > failure.start_s - vehicle.sample_period_s + 1e-9) & (time_s < end_s - 1e-9)
        found[within, vehicle.jet_index(failure.jet)] = True
    return found


def propellant(run: Source) -> Plot:
    """Propellant used, by what the jets gave or, where that is not known, by what they were told."""
    full, flows = np.linalg.norm(run.vehicle.thrusts, axis=1), params.plant_mass_flows(run.scenario)
    level = run.signals["thrust"] / full if run.simulated else np.nan_to_num(run.signals["command"])
    rate = (level * flows).sum(axis=1) * run.vehicle.sample_period_s
    used = np.concatenate([[0.0], np.cumsum(rate[:-1])])
    line = Line(run.time_s, used, COLORS[0])
    return _plot(run, "propellant", "Propellant used", [Panel("used", run.vehicle.unit_names["mass"], (line,))])


def _intervals(time_s: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Beginnings and ends of the intervals in which a jet is commanded, s.

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
) -> Plot:
    """A vector signal, a panel per axis."""
    values = scale * run.signals[signal]
    unit = unit or in_units(SIGNALS[signal].unit, run.vehicle.unit_names)
    panels = [
        Panel(letter, unit, (Line(run.time_s, values[:, axis], COLORS[axis], steps=steps),))
        for axis, letter in enumerate(AXES)
    ]
    return _plot(run, name, title, panels)


def _readings(run: Source, name: str, packages: Sequence[str], title: str, unit: str, scale: float) -> Plot:
    """What packages of one kind read, a panel per axis and a color per package."""
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


_ELEMENTS = {"inverse_inertia_diagonal": (0, 1, 2), "inverse_inertia_products": (3, 4, 5), "center_of_mass": (6, 7, 8)}


def _estimated(run: Source, elements: tuple[int, ...]) -> tuple[int, ...]:
    """Those that are estimated; what is fixed has no sigma."""
    known = np.isfinite(np.asarray(run.signals["standard_deviation"])[-1, list(elements)]).tolist()
    return tuple(element for element, one in zip(elements, known, strict=True) if one)


def inverse_inertia_diagonal(run: Source) -> Plot:
    """Errors of the diagonal of the inverse inertia (figure 5-6a)."""
    return _parameters(
        run, "inverse_inertia_diagonal", _ELEMENTS["inverse_inertia_diagonal"], "Inverse inertia, diagonal"
    )


def inverse_inertia_products(run: Source) -> Plot:
    """Errors of the products of the inverse inertia (figure 5-6b)."""
    return _parameters(
        run, "inverse_inertia_products", _ELEMENTS["inverse_inertia_products"], "Inverse inertia, products"
    )


def center_of_mass(run: Source) -> Plot:
    """Errors of the center of mass (figure 5-7)."""
    return _parameters(run, "center_of_mass", _ELEMENTS["center_of_mass"], "Center of mass")


def mass_reciprocal(run: Source) -> Plot:
    """Error of the mass reciprocal (figure 5-12)."""
    return _parameters(run, "mass_reciprocal", (9,), "Mass reciprocal")


def _parameters(run: Source, name: str, elements: tuple[int, ...], title: str) -> Plot:
    """Estimation errors with their 3-sigma band; without the truth the estimates with theirs."""
    panel, what = (_error, "estimation error") if run.simulated else (_estimate, "estimate")
    return _plot(run, name, f"{title}: {what}", [panel(run, element) for element in _estimated(run, elements)])


def _error(run: Source, element: int) -> Panel:
    """Estimation error in percent of the truth, or in the parameter's unit where the truth is about zero."""
    truth = run.signals["truth"]
    true = truth[:, element]
    unit, scale = mass_property_units(run.vehicle.unit_names)[element], np.ones_like(true)
    if np.abs(true).min() > 1e-12 * np.abs(truth).max():
        unit, scale = "%", 100.0 / np.abs(true)
    error = scale * (run.signals["estimate"][:, element] - true)
    band = scale * 3.0 * run.signals["standard_deviation"][:, element]
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, -band, band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, error, COLORS[element % 3], f"error, at the end {error[-1]:.3g} {unit}"),
        ),
        scale=SymmetricLog(float(band[-1]), float(np.nanmax(np.abs([error, band])))),
    )


def _estimate(run: Source, element: int) -> Panel:
    """The estimate of a parameter, on a scale that the end of the record sets."""
    value = run.signals["estimate"][:, element]
    band = 3.0 * run.signals["standard_deviation"][:, element]
    unit = mass_property_units(run.vehicle.unit_names)[element]
    return Panel(
        SYMBOLS[element],
        unit,
        (
            Band(run.time_s, value - band, value + band, label=f"3-sigma, at the end {band[-1]:.3g} {unit}"),
            Line(run.time_s, value, COLORS[element % 3], f"estimate, at the end {value[-1]:.5g} {unit}"),
        ),
        limits=_last_half(value, band),
    )


def _last_half(value: Array, band: Array) -> tuple[float, float]:
    """Limits that show an estimate, and its band over the last half; the first band may be huge."""
    half = value.size // 2
    low = min(float(value.min()), float((value - band)[half:].min()))
    high = max(float(value.max()), float((value + band)[half:].max()))
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def consistency(run: Source) -> Plot:
    """NIS of both filters at the samples used (figures 5-8, 5-13)."""
    panels = []
    filters = [name for name in ("rotation", "mass") if f"{name}_nis" in run.signals]
    for name, color in zip(filters, COLORS, strict=False):
        used = run.where(f"{name}_used")
        nis = run.signals[f"{name}_nis"][used, 0]
        marks = (
            Zone(*NIS_LIMITS, label="95 % of chi-square, 3 degrees of freedom"),
            Points(run.time_s[used], nis, color, _mean_nis(run, name, nis)),
        )
        panels.append(Panel(f"NIS, {name} filter", "", marks, scale="log"))
    return _plot(run, "consistency", "Consistency: NIS at the samples used", panels)


def innovations(run: Source) -> Plot:
    """Innovations of the rotation filter at the samples used, with 3 sigma of the readings alone."""
    used = run.where("rotation_used")
    values = _DEGREES * run.signals["rotation_innovation"][used]
    limit = 3.0 * _DEGREES * float(np.sqrt(2.0 * params.gyro(run.scenario).variance))  # of a difference of two readings
    panels = [
        Panel(
            letter,
            "deg/s",
            (
                Zone(-limit, limit, label="3 sigma of the readings alone" if axis == 0 else ""),
                Points(run.time_s[used], values[:, axis], COLORS[axis], "innovation" if axis == 0 else ""),
            ),
            limits=_of_most(values[:, axis], limit),
        )
        for axis, letter in enumerate(AXES)
    ]
    return _plot(run, "innovations", "Innovations of the rotation filter at the samples used", panels)


def _of_most(values: Array, limit: float) -> tuple[float, float]:
    """Limits that show a range and nearly all values; a few during a failure may be far beyond."""
    reach = 2.0 * limit if not values.size else max(2.0 * limit, 1.2 * float(np.quantile(np.abs(values), 0.98)))
    return -reach, reach


def _mean_nis(run: Source, name: str, nis: Array) -> str:
    if run.consistency is None:
        return f"mean {nis.mean():.2f} of {nis.size} samples" if nis.size else "no sample used"
    mean = run.consistency["rotation_nis_mean" if name == "rotation" else "translation_nis_mean"]
    return "no sample used" if mean is None else f"mean {mean:.2f} of all samples used"


# ---------------------------------------------------------------------------------------- detector


def likelihoods(run: Source) -> Plot:
    """Likelihood arguments of all jets, and of the clusters (figures 5-16, 5-19, 5-22, 5-25)."""
    tested = run.where("tested")
    of_jets = run.signals["likelihood"][tested]
    clusters = np.array([jet.cluster for jet in run.vehicle.jets])
    numbers = np.unique(clusters)
    of_clusters = np.stack([of_jets[:, clusters == number].max(axis=1) for number in numbers], axis=1)
    declared = np.zeros(clusters.size, dtype=bool)
    if "known_force_variance" in run.signals:
        declared = np.asarray((run.signals["known_force_variance"] > 0.0).any(axis=0))
    groups = [f"cluster {number}" for number in numbers]
    found = np.isin(numbers, clusters[declared])
    panels = [
        _highest(run.time_s[tested], of_jets, run.vehicle.designations, "of the jets", declared),
        _highest(run.time_s[tested], of_clusters, groups, "of the clusters", found),
    ]
    return _plot(run, "likelihoods", "Likelihood arguments of a failed jet", panels)


def _highest(time_s: Array, values: Array, names: Sequence[str], label: str, declared: NDArray[np.bool_]) -> Panel:
    """Statistics of many candidates: those that ever reach highest by name, the range of the others in gray.

    What was declared is drawn last, and so on top. All are there to be read.
    """
    shown = np.maximum(values, _FLOOR)
    limits = (_FLOOR, max(10.0, 2.0 * float(shown.max(initial=1.0))))
    if not time_s.size:
        return Panel(label, "", (), scale="log", limits=limits)
    order = np.argsort(-shown.max(axis=0))
    top, rest = order[:_NAMED], order[_NAMED:]
    top = top[np.argsort(declared[top], kind="stable")]
    marks: list[Mark] = []
    if rest.size:
        low, high = shown[:, rest].min(axis=1), shown[:, rest].max(axis=1)
        marks.append(Whiskers(time_s, low, high, BAND_COLOR, "range of the others"))
    marks += [Points(time_s, shown[:, column], BAND_COLOR, names[column], drawn=False, group=label) for column in rest]
    for column, color in zip(top, COLORS, strict=False):
        size = POINT_SIZE if declared[column] else 0.7 * POINT_SIZE
        marks.append(Points(time_s, shown[:, column], color, names[column], size=size, group=label))
    return Panel(label, "", tuple(marks), scale="log", limits=limits)


def margins(run: Source) -> Plot:
    """Margins of the likeliest jet and cluster (figures 5-17, 5-20, 5-23, 5-26)."""
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
    """Magnitude of a failure (figures 5-18, 5-21, 5-24, 5-27).

    Shows the estimate for the likeliest jet at every alarm, with its 1-sigma; the truth of the jets that were
    suspected or do fail; and the force that is taken as known from then on.
    """
    marks: list[Mark] = []
    alarm = run.where("alarm")
    if run.simulated:
        suspected = run.signals["suspected_jet"][alarm, 0].astype(int).tolist()
        failed = [run.vehicle.jet_index(failure.jet) for failure in run.scenario.failures]
        for jet, color in zip(dict.fromkeys(suspected + failed), (TRUTH_COLOR, *COLORS[2:]), strict=False):
            expected = run.vehicle.jets[jet].thrust * run.signals["command"][:, jet]
            label = f"truth, {run.vehicle.designations[jet]}"
            marks.append(Line(run.time_s, run.signals["thrust"][:, jet] - expected, color, label, steps=True))
    known = run.signals["known_force_variance"] > 0.0
    for jet in np.flatnonzero(known.any(axis=0)):
        force = np.where(known[:, jet], run.signals["known_force"][:, jet], np.nan)
        label = f"known force, {run.vehicle.designations[jet]}"
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
    """Tests, alarms and declarations beside the rates and the number of jets commanded."""
    rate = _DEGREES * run.signals["rate" if run.simulated else params.rate_signal(run.scenario)]
    turning = tuple(Line(run.time_s, rate[:, axis], COLORS[axis], letter) for axis, letter in enumerate(AXES))
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


# ------------------------------------------------------------------------------------ what all show


def _plot(run: Source, name: str, title: str, panels: Sequence[Panel], *, meaning: str = "") -> Plot:
    """A plot with what every plot of a run shows: whose it is, and what happened when."""
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


def _windows(run: Source) -> tuple[Window, ...]:
    """When a hand controller is out of detent, and when the detector is not armed."""
    commanded = tuple(
        Window(window.start_s, window.end_s, f"{window.controller.upper()} {window.axis}")
        for window in run.scenario.maneuver
        if window.start_s < run.time_s[-1]
    )
    if "tested" not in run.signals:
        return commanded
    start_s, until_s = float(run.time_s[0]), armed_from(run)
    end_s = float(run.time_s[-1]) if until_s is None else until_s
    return (Window(start_s, end_s, "", armed=False), *commanded) if end_s - start_s > PROMPT_S else commanded


def armed_from(run: Source) -> float | None:
    """When the detector tested a sample for the first time, s; None: it never did."""
    tested = run.where("tested")
    return float(run.time_s[tested[0]]) if tested.size else None


def _moments(run: Source) -> tuple[Moment, ...]:
    """When jets fail and mass properties jump, and when the detector says so."""
    happens = [failure.start_s for failure in run.scenario.failures] + [jump.time_s for jump in run.scenario.jumps]
    declared = run.time_s[run.where("detector_event")].tolist() if "detector_event" in run.signals else []
    return (
        *(Moment(time_s, declared=False) for time_s in happens if time_s <= run.time_s[-1]),
        *(Moment(time_s, declared=True) for time_s in declared),
    )
