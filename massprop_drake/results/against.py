"""Comparison of a record with a simulation of its commands: the differences, and their possible causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.model import Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, columns, is_physical
from massprop_drake.maths.estimation.offline.normal_equations import NormalEquations, stretch_equations, sum_equations
from massprop_drake.maths.estimation.offline.swings import can_swing
from massprop_drake.maths.estimation.pose.pose_hindsight import PoseEquations
from massprop_drake.maths.signals import AGAINST, AXES, SYMBOLS, fill_unit_template, mass_property_units
from massprop_drake.maths.vehicle.engine_thrust import N_ERRORS
from massprop_drake.results.detections import DetectionRecord, in_words
from massprop_drake.results.diagnoses import RATE
from massprop_drake.results.record_stretches import regression_pieces
from massprop_drake.results.regression_model import make_model, vehicle_names, without_shifts
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_MOST = 5  # causes that are taken together; compute budget: of those that are tried in vain
_PASSES = 3  # in which causes are fitted
_HALVINGS = 8  # compute budget: of a step that no vehicle can take, or that leaves more unexplained
_SETTLED = 1e-2  # squared sigmas that a pass would still gain
_ALIKE = 0.9  # of what the best alone explains: what explains as much cannot be told from it
_CHANCE = 1.3  # times the stated variance: no more than rounding may be


class Residual(NamedTuple):
    """Residual of a component of a sensor: the reading minus the simulated one.

    Attributes:
        signal: its column in telemetry, such as "gyro_x".
        unit: of the numbers.
        rms: root of the mean square; None where nothing was read.
        largest: by magnitude, with its sign.
        largest_s: when, s.
        noise: 1-sigma of a reading as the vehicle's file has it.
    """

    signal: Text
    unit: Text
    rms: Real | None
    largest: Real | None
    largest_s: Real | None
    noise: Real


class Explanation(NamedTuple):
    """Explanation of residuals by one unknown.

    Attributes:
        what: in words, such as "thrust of R4R".
        size: by how much it is other than in the simulation, together with those before it.
        size_std: its 1-sigma.
        unit: of both.
        alone: share of the residuals beyond noise, or of all that is explained if that is more, by itself, 0 to 1.
        together: the same with those before it.
        alike: others that explain as much by themselves as it does.
    """

    what: Text
    size: Real
    size_std: Real
    unit: Text
    alone: Real
    together: Real
    alike: tuple[Text, ...] = ()


class SimulatedSide(NamedTuple):
    """Quantities of a simulation that a record may contradict.

    Attributes:
        properties: the ten parameters, shape (10,).
        errors: of jets, wheels, engines and tanks from the vehicle file, by the names in `Columns`.
        time_constants_s: of each jet's lag, shape (n_jets,).
    """

    properties: Array
    errors: Mapping[str, Array]
    time_constants_s: Array


class Against(NamedTuple):
    """Record compared with a simulation.

    Attributes:
        run: the folder of the run whose vehicle was simulated.
        until_s: what explains is sought in readings up to this time, when the first failure was declared; None: in all.
        misfit: mean square of the residuals of readings from what the commands give, over the variance that is stated:
            about 1 where the record is as simulated; None where there are too few readings.
        residuals: of every component.
        causes: the one that explains most first; empty where there is nothing to explain, or nothing explains it.
        declared: the failure that readings from `until_s` on are left out for, in words; "": none was declared then.
    """

    run: Text
    until_s: Real | None
    misfit: Real | None
    residuals: tuple[Residual, ...]
    causes: tuple[Explanation, ...]
    declared: Text = ""

    def as_json(self) -> dict[str, Any]:
        """Returns the comparison as `summary.json` has it."""
        residuals, causes = ([entry._asdict() for entry in entries] for entries in (self.residuals, self.causes))
        return {**self._asdict(), "residuals": residuals, "causes": causes}

    def in_words(self) -> str:
        """Formats the misfit over the stated variance as a sentence, with the time up to which readings count."""
        before = "" if self.until_s is None else f" before {self.until_s:.2f} s"
        then = f"; then declared: {self.declared}" if self.declared else ""
        if self.misfit is None:
            return f"too few readings{before} to say what would explain the difference{then}"
        differ = bool(self.causes) or self.misfit > _CHANCE
        size = f"{self.misfit:.3g} times the variance that is stated"
        unexplained = ", which no error of the vehicle explains" if differ and not self.causes else ""
        return f"readings{before} are {'not ' if differ else ''}as simulated: {size}{unexplained}{then}"


def declared_in_words(detections: Iterable[DetectionRecord], onset_s: float, units: Mapping[str, str]) -> str:
    """Describes the standing detections that begin at a time, s, such as "jet T7: stuck on"; "" if none does."""
    return "; ".join(in_words(one, units) for one in detections if one.withdrawn_s is None and one.onset_s == onset_s)


def residuals(scenario: Scenario, signals: Spool) -> tuple[Residual, ...]:
    """Computes the RMS and the largest residual of each sensor component, readings minus simulated readings.

    Args:
        scenario: of the record.
        signals: with readings, and simulated readings under `AGAINST`.
    """
    vehicle = scenario.vehicle_data
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    variances = make_model(scenario).variances
    results: list[Residual] = []
    for number, package in enumerate(packages):
        unit = fill_unit_template("rad/s" if package in vehicle.gyros else "{length}/s", vehicle.unit_names)
        noise_std = math.sqrt(float(variances[number]))
        columns = [f"{package.name}_{letter}" for letter in AXES]
        results += summarize_residuals(columns, unit, noise_std, differences(signals, package.name))
    return tuple(results)


def differences(signals: Spool, name: str) -> Iterator[tuple[Array, Array]]:
    """Yields sample times, s, and readings of a sensor minus simulated ones, shape (n, columns), block by block."""
    for block in signals.blocks("time_s", name, AGAINST + name):
        yield block["time_s"], block[name] - block[AGAINST + name]


def summarize_residuals(
    columns: Sequence[str], unit: str, noise_std: float, residual_blocks: Iterable[tuple[Array, Array]]
) -> Iterator[Residual]:
    """Yields the RMS, the largest value and its time of the residuals of each component of a sensor.

    Args:
        columns: the components' columns, n of them.
        unit: of the numbers.
        noise_std: 1-sigma of a reading.
        residual_blocks: times, s, and residuals, NaN where nothing was read, shapes (m,) and (m, n), block by block.
    """
    sums, counts = np.zeros(len(columns)), np.zeros(len(columns))
    largest, when = np.zeros(len(columns)), np.full(len(columns), np.nan)
    for time_s, values in residual_blocks:
        sums += np.nansum(values**2, axis=0)
        counts += np.isfinite(values).sum(axis=0)
        for axis, component in enumerate(np.nan_to_num(values).T):
            row = int(np.argmax(np.abs(component)))
            if abs(component[row]) > abs(largest[axis]):
                largest[axis], when[axis] = component[row], time_s[row]
    for axis, name in enumerate(columns):
        has_readings = counts[axis] > 0
        yield Residual(
            name,
            unit,
            math.sqrt(sums[axis] / counts[axis]) if has_readings else None,
            float(largest[axis]) if has_readings else None,
            None if np.isnan(when[axis]) else float(when[axis]),
            noise_std,
        )


def explain_differences(
    scenario: Scenario, signals: Spool, reference: SimulatedSide, until_s: float
) -> tuple[float | None, tuple[Explanation, ...]]:
    """Finds parameters of the flight model, such as thrusts, that explain how readings differ from a simulation.

    The unknown that explains most is fitted, then the one that explains most besides, as long as that is more than
    chance; all others stay as the simulation has them.

    Args:
        scenario: of the record.
        signals: with `time_s`, commands and readings.
        reference: parameters of the simulation.
        until_s: time of the first declared failure, s; later readings are left out.

    Returns:
        See `Against.misfit` and `Against.causes`.
    """
    model = without_shifts(make_model(scenario))._replace(time_constants_s=reference.time_constants_s)
    slices = columns(model)
    unknowns = np.zeros_like(model.prior)
    unknowns[slices.properties] = reference.properties
    for group, errors in reference.errors.items():
        place = getattr(slices, group)
        unknowns[place] = errors[: place.stop - place.start]  # no filter but the joint one has errors of mounting
    with np.errstate(all="ignore"):
        stretches = regression_pieces(scenario, signals, until_s, model)
        labels = name_unknowns(scenario, model, unknowns)

        def make_equations(point: Array) -> NormalEquations:
            """Makes the normal equations of all readings, linearized about a point, shape (n,)."""
            return sum_equations([stretch_equations(stretch, point, model) for stretch in stretches], model)

        def is_possible(point: Array) -> bool:
            """Tests whether a vehicle can have such mass properties, with parts that move in it."""
            return is_physical(point) and can_swing(point[slices.properties], point[slices.moving], model.modes)

        return find_causes(make_equations, (unknowns, labels), is_possible)


Equations = NormalEquations | PoseEquations  # of readings by unknowns, about a point


class UnknownLabel(NamedTuple):
    """Name of an unknown, its unit in reports, and the scale to that unit."""

    what: str
    unit: str
    scale: float


def find_causes(
    make_equations: Callable[[Array], Equations],
    labeled_unknowns: tuple[Array, Sequence[UnknownLabel | None]],
    is_possible: Callable[[Array], bool],
) -> tuple[float | None, tuple[Explanation, ...]]:
    """Finds the unknowns that explain a misfit; returns it (mean square over stated variance) and the causes.

    Args:
        make_equations: makes the equations linearized about a point.
        labeled_unknowns: the unknowns as simulated, shape (n,), and their labels, None for those not fitted.
        is_possible: tests whether a vehicle can have such unknowns.

    Returns:
        See `Against.misfit` and `Against.causes`.
    """
    equations = make_equations(labeled_unknowns[0])
    if equations.readings < 1.0:
        return None, ()
    causes = _select_causes(equations, make_equations, labeled_unknowns, is_possible)
    return equations.misfit / equations.readings, causes


def _select_causes(
    first: Equations,
    make_equations: Callable[[Array], Equations],
    labeled_unknowns: tuple[Array, Sequence[UnknownLabel | None]],
    is_possible: Callable[[Array], bool],
) -> tuple[Explanation, ...]:
    """Selects one by one the unknowns that reduce the misfit most, beyond chance; arguments as `find_causes`."""
    reference, called = labeled_unknowns
    names = {place: one for place, one in enumerate(called) if one is not None}
    diagonal = np.where([place in names for place in range(len(called))], first.information.diagonal(), 0.0)
    there = np.flatnonzero(diagonal > 0.0)
    alone = np.zeros_like(diagonal)
    alone[there] = first.score[there] ** 2 / diagonal[there]
    limit = chi_square_limit(RATE / max(there.size, 1), 1)
    taken: list[int] = []
    gained: list[float] = []
    at, normal = reference, first
    failed = list[int]()
    while len(taken) < _MOST and len(failed) < _MOST:
        left = [place for place in there.tolist() if place not in taken and place not in failed]
        gains = {place: _misfit_gain(normal, [*taken, place]) for place in left}
        best = max(gains, key=lambda place: gains[place], default=-1)
        if best < 0 or gains[best] <= limit * max(normal.misfit / normal.readings, 1.0):
            break
        after, fit = _fit_unknowns(make_equations, (at, normal), [*taken, best], is_possible)
        if fit.misfit >= normal.misfit:
            failed.append(best)  # it explains no more than by its slope
            continue
        at, normal = after, fit
        taken.append(best)
        gained.append(first.misfit - fit.misfit)
    if not taken:
        return ()
    covariance = np.linalg.inv(normal.information[np.ix_(taken, taken)]) * max(normal.misfit / normal.readings, 1.0)
    excess, found = max(first.misfit - first.readings, gained[-1]), []
    for number, (place, deviation) in enumerate(zip(taken, np.sqrt(covariance.diagonal()), strict=True)):
        what, unit, scale = names[place]
        others = there[(alone[there] >= _ALIKE * alone[place]) & (there != place)] if number == 0 else ()
        found.append(
            Explanation(
                what,
                float(scale * (at[place] - reference[place])),
                float(scale * deviation),
                unit,
                min(float(alone[place]) / excess, 1.0),
                gained[number] / excess,
                tuple(names[other].what for other in others),
            )
        )
    return tuple(found)


def _fit_unknowns(
    make_equations: Callable[[Array], Equations],
    start: tuple[Array, Equations],
    indices: list[int],
    is_possible: Callable[[Array], bool],
) -> tuple[Array, Equations]:
    """Fits the unknowns at some indices by Gauss-Newton iterations; returns the point and the equations about it."""
    point, normal = start
    for _ in range(_PASSES):
        move = np.zeros_like(point)
        move[indices] = np.linalg.solve(normal.information[np.ix_(indices, indices)], normal.score[indices])
        if float(move @ normal.score) < _SETTLED:
            break
        for _ in range(_HALVINGS):
            if is_possible(point + move) and (moved := make_equations(point + move)).misfit < normal.misfit:
                point, normal = point + move, moved
                break
            move *= 0.5
        else:
            break
    return point, normal


def _misfit_gain(equations: Equations, indices: list[int]) -> float:
    """Computes the misfit reduction by freeing the unknowns at some indices, squared sigmas; 0 if not separable."""
    chosen = np.array(indices)
    information, score = equations.information[np.ix_(chosen, chosen)], equations.score[chosen]
    scale = np.sqrt(information.diagonal())
    correlation = information / np.outer(scale, scale)
    if np.linalg.cond(correlation) > _TELLABLE:
        return 0.0
    return float((score / scale) @ np.linalg.solve(correlation, score / scale))


_TELLABLE = 1e8  # condition of unknowns beyond which they are one


def name_mass_property(symbol: str, unit: str, value: float) -> UnknownLabel:
    """Labels a mass property: diagonal inverse inertia and 1/m in percent of the value, others in their unit."""
    in_percent = symbol in _IN_PERCENT and value != 0.0
    return UnknownLabel(symbol, "%", 100.0 / float(abs(value))) if in_percent else UnknownLabel(symbol, unit, 1.0)


def name_unknowns(scenario: Scenario, model: FlightModel, unknowns: Array) -> list[UnknownLabel | None]:
    """Returns the label of each unknown of the flight model, in its order; None where it is not fitted."""
    found: list[UnknownLabel | None] = [None] * unknowns.size
    slices, units = columns(model), mass_property_units(scenario.vehicle_data.unit_names)
    values = unknowns[slices.properties].tolist()
    found[slices.properties] = [name_mass_property(*entry) for entry in zip(SYMBOLS, units, values, strict=True)]
    groups = {**_name_usual_errors(scenario), **_name_errors_of_parts(scenario, model)}
    for group, labels in groups.items():
        places = range(*getattr(slices, group).indices(unknowns.size))
        for place, label in zip(places, labels if places else (), strict=True):  # mounting: of the joint filter alone
            found[place] = label if label.scale else None
    return found


def _name_usual_errors(scenario: Scenario) -> dict[str, list[UnknownLabel]]:
    """Maps groups of unknowns that every vehicle has, as named in `Columns`, to their labels."""
    names = vehicle_names(scenario)
    groups: dict[str, tuple[list[str], str, float]] = {
        "thrust": ([f"thrust of {jet}" for jet in names.jets], "%", 100.0),
        "lag": ([f"lag of {kind} jets" for kind in names.kinds], "ms", 1e3),
        "gyro_bias": ([f"gyro bias {axis}" for axis in AXES], "rad/s", 1.0),
        "acceleration_bias": (
            [f"{name}: bias or steady force {axis}" for name in names.accelerometers for axis in AXES],
            names.acceleration,
            1.0,
        ),
        "torque": ([f"torque {axis} that nobody commands" for axis in AXES], names.torque, 1.0),
        "drag": ([f"drag about {axis}" for axis in AXES], f"{names.torque}-s/rad", 1.0),
        "momentum": ([f"angular momentum {axis} of wheels" for axis in AXES], f"{names.torque}-s", 1.0),
        "gyro_gain": ([f"scale of {name} {axis}" for name in names.gyros for axis in AXES], "%", 100.0),
        "accelerometer_gain": (
            [f"scale of {name} {axis}" for name in names.accelerometers for axis in AXES],
            "%",
            100.0,
        ),
        "wheel": ([f"inertia of wheel {wheel}" for wheel in names.wheels], "%", 100.0),
    }
    return {
        group: [UnknownLabel(what, unit, scale) for what in of_group]
        for group, (of_group, unit, scale) in groups.items()
    }


def _name_errors_of_parts(scenario: Scenario, model: FlightModel) -> dict[str, list[UnknownLabel]]:
    """Maps groups of unknowns of engines, mounting, moving parts and tanks to labels; scale 0: known."""
    vehicle, length = scenario.vehicle_data, scenario.vehicle_data.unit_names["length"]
    across = "first axis", "second axis"  # normal to the force
    placed = [(f"place of {{}}, {axis}", length) for axis in across]
    pointed = [(f"direction of {{}}, {axis}", "rad") for axis in across]
    burning = [(f"thrust of {{}} at level {level}", "%") for level in (0, 1)]
    moving = [(f"{what} of {{}}", "%") for what in ("participation", "frequency", "damping")]
    moving += [(f"place of {{}}, {axis}", length) for axis in AXES]

    def label(parts: Iterable[str], errors: Sequence[tuple[str, str]], sigmas: Array) -> list[UnknownLabel]:
        """Labels the same errors of each part; `sigmas` scale the unknowns to their units, (n_parts, n_errors)."""
        entries = [(what.format(part), unit) for part in parts for what, unit in errors]
        return [
            UnknownLabel(what, unit, 100.0 * sigma if unit == "%" else sigma)
            for (what, unit), sigma in zip(entries, sigmas.ravel().tolist(), strict=True)
        ]

    engines = [f"engine {engine.name}" for engine in vehicle.engines]
    tanks = [tank.name for tank in vehicle.tanks]
    mounted = label(vehicle.designations, [*pointed, *placed], np.repeat(vehicle.mounting_sigmas, 2, axis=1))
    return {
        "engine": label(engines, [*burning, *pointed, *placed], np.ones(N_ERRORS * len(engines))),
        "mount": [one for one in mounted if one.scale],
        "moving": label([part.name for part in vehicle.moving], moving, model.modes.sigmas),
        "fill": label(tanks, [("propellant in {} at the start", vehicle.unit_names["mass"])], np.ones(len(tanks))),
        "flow": label(tanks, [("flow out of {}", "%")], np.ones(len(tanks))),
    }


_IN_PERCENT = ("Ixx⁻¹", "Iyy⁻¹", "Izz⁻¹", "1/m")
