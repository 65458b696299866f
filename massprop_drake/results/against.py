"""Comparison of a record with a simulation of its commands: the differences, and their possible causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.model import Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, columns, is_physical
from massprop_drake.maths.estimation.offline.normal_equations import NormalEquations, stretch_equations, sum_equations
from massprop_drake.maths.estimation.pose.pose_hindsight import PoseEquations
from massprop_drake.maths.signals import AGAINST, AXES, SYMBOLS, fill_unit_template, mass_property_units
from massprop_drake.results.diagnoses import RATE
from massprop_drake.results.record_stretches import regression_pieces
from massprop_drake.results.regression_model import Names, make_model, vehicle_names, without_shifts
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_MOST = 5  # causes that are taken together
_PASSES = 3  # in which causes are fitted
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
        alone: share of the residuals beyond noise that it explains by itself, 0 to 1.
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
        thrust: of each jet over the vehicle file's, shape (n_jets,).
        time_constants_s: of each jet's lag, shape (n_jets,).
    """

    properties: Array
    thrust: Array
    time_constants_s: Array


class Against(NamedTuple):
    """Record compared with a simulation.

    Attributes:
        run: the folder of the run whose vehicle was simulated.
        until_s: what explains is sought in readings up to this time, when the first failure was declared; None: in all.
        misfit: mean square of the residuals of readings from what the commands give, over the variance that is stated:
            about 1 where the record is as simulated; None where there are too few readings.
        residuals: of every component.
        causes: the one that explains most first; empty where there is nothing to explain.
    """

    run: Text
    until_s: Real | None
    misfit: Real | None
    residuals: tuple[Residual, ...]
    causes: tuple[Explanation, ...]

    def as_json(self) -> dict[str, Any]:
        """Returns the comparison as `summary.json` has it."""
        residuals, causes = ([one._asdict() for one in part] for part in (self.residuals, self.causes))
        return {**self._asdict(), "residuals": residuals, "causes": causes}

    def in_words(self) -> str:
        """Returns a sentence: by how many times the stated variance readings differ, and before which failure."""
        if self.misfit is None:
            return "too few readings to say what would explain the difference"
        if not self.causes:
            return f"the readings are as simulated: {self.misfit:.3g} times the variance that is stated"
        before = "" if self.until_s is None else f" before {self.until_s:.2f} s"
        return f"readings{before} differ by {self.misfit:.3g} times the variance that is stated"


def residuals(scenario: Scenario, signals: Spool) -> tuple[Residual, ...]:
    """Computes the RMS and the largest difference of each sensor component, readings minus simulated readings.

    Args:
        scenario: of the record.
        signals: with readings, and what a simulation reads under `AGAINST`.
    """
    vehicle = scenario.vehicle_data
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    variances = make_model(scenario).variances
    found: list[Residual] = []
    for number, package in enumerate(packages):
        unit = fill_unit_template("rad/s" if package in vehicle.gyros else "{length}/s", vehicle.unit_names)
        noise = math.sqrt(float(variances[number]))
        named = [f"{package.name}_{letter}" for letter in AXES]
        found += summarize_residuals(named, unit, noise, differences(signals, package.name))
    return tuple(found)


def differences(signals: Spool, name: str) -> Iterator[tuple[Array, Array]]:
    """Yields sample times, s, and readings of a sensor minus simulated ones, shape (n, columns), block by block."""
    for block in signals.blocks("time_s", name, AGAINST + name):
        yield block["time_s"], block[name] - block[AGAINST + name]


def summarize_residuals(
    named: Sequence[str], unit: str, noise: float, left: Iterable[tuple[Array, Array]]
) -> Iterator[Residual]:
    """Yields the RMS, the largest value and its time of the residuals of each component of a sensor.

    Args:
        named: the components' columns, n of them.
        unit: of the numbers.
        noise: 1-sigma of a reading.
        left: times, s, and what is left, NaN where nothing was read, shapes (m,) and (m, n), block by block.
    """
    sums, counts = np.zeros(len(named)), np.zeros(len(named))
    largest, when = np.zeros(len(named)), np.full(len(named), np.nan)
    for time_s, off in left:
        sums += np.nansum(off**2, axis=0)
        counts += np.isfinite(off).sum(axis=0)
        for axis, column in enumerate(np.nan_to_num(off).T):
            row = int(np.argmax(np.abs(column)))
            if abs(column[row]) > abs(largest[axis]):
                largest[axis], when[axis] = column[row], time_s[row]
    for axis, name in enumerate(named):
        there = counts[axis] > 0
        yield Residual(
            name,
            unit,
            math.sqrt(sums[axis] / counts[axis]) if there else None,
            float(largest[axis]) if there else None,
            None if np.isnan(when[axis]) else float(when[axis]),
            noise,
        )


def explain_differences(
    scenario: Scenario, signals: Spool, reference: SimulatedSide, until_s: float
) -> tuple[float | None, tuple[Explanation, ...]]:
    """Finds the unknowns of the flight model, such as thrusts, that explain readings off a simulation.

    The unknown that explains most by itself is taken and fitted, and then the one that explains most besides, as long
    as that is more than chance; all others stay as the simulation has them. What happens in the midst of a record is
    no such unknown: readings after the first failure that was declared are left out.

    Args:
        scenario: of the record.
        signals: with `time_s`, commands and readings.
        reference: what the simulation has.
        until_s: up to when, s.

    Returns:
        See `Against.misfit` and `Against.causes`.
    """
    made = without_shifts(make_model(scenario))._replace(time_constants_s=reference.time_constants_s)
    places = columns(made)
    at = np.zeros_like(made.prior)
    at[places.properties], at[places.thrust] = reference.properties, reference.thrust - 1.0
    with np.errstate(all="ignore"):
        parts = regression_pieces(scenario, signals, until_s, made)
        called = _name_unknowns(scenario, made, at)

        def about(there: Array) -> NormalEquations:
            """Returns the normal equations of all readings, linearized about these unknowns."""
            return sum_equations([stretch_equations(part, there, made) for part in parts], made)

        return find_causes(about, (at, called), is_physical, chance=_CHANCE)


Equations = NormalEquations | PoseEquations  # of readings by unknowns, about a point


class UnknownLabel(NamedTuple):
    """Name of an unknown, its unit in reports, and the scale to that unit."""

    what: str
    unit: str
    scale: float


def find_causes(
    about: Callable[[Array], Equations],
    of: tuple[Array, Sequence[UnknownLabel | None]],
    possible: Callable[[Array], bool],
    *,
    chance: float = 0.0,
) -> tuple[float | None, tuple[Explanation, ...]]:
    """Returns mean-square misfit over stated variance, None without readings, and what explains it, best first.

    Args:
        about: the equations about a point.
        of: the unknowns as the simulation has them, shape (n,), and what each is called; None: it is none.
        possible: whether a vehicle can have such unknowns.
        chance: misfit for each reading up to which nothing is to be explained.

    Returns:
        See `Against.misfit` and `Against.causes`.
    """
    first = about(of[0])
    if first.readings < 1.0:
        return None, ()
    misfit = first.misfit / first.readings
    if misfit <= chance:
        return misfit, ()
    return misfit, _select_causes(first, about, of, possible)


def _select_causes(
    first: Equations,
    about: Callable[[Array], Equations],
    of: tuple[Array, Sequence[UnknownLabel | None]],
    possible: Callable[[Array], bool],
) -> tuple[Explanation, ...]:
    """Selects unknowns one by one that reduce the misfit most, until no more than chance; as `find_causes`."""
    reference, called = of
    names = {place: one for place, one in enumerate(called) if one is not None}
    diagonal = np.where([place in names for place in range(len(called))], first.information.diagonal(), 0.0)
    there = np.flatnonzero(diagonal > 0.0)
    alone = np.zeros_like(diagonal)
    alone[there] = first.score[there] ** 2 / diagonal[there]
    excess = max(first.misfit - first.readings, 1e-300)
    limit = chi_square_limit(RATE / max(there.size, 1), 1)
    taken: list[int] = []
    shares: list[float] = []
    at, normal = reference, first
    while len(taken) < _MOST:
        gains = {place: _misfit_gain(normal, [*taken, place]) for place in there.tolist() if place not in taken}
        best = max(gains, key=lambda place: gains[place], default=-1)
        if best < 0 or gains[best] <= limit * max(normal.misfit / normal.readings, 1.0):
            break
        after, fit = _fit_unknowns(about, (at, normal), [*taken, best], possible)
        if fit.misfit >= normal.misfit:
            break
        at, normal = after, fit
        taken.append(best)
        shares.append(min((first.misfit - fit.misfit) / excess, 1.0))
    if not taken:
        return ()
    covariance = np.linalg.inv(normal.information[np.ix_(taken, taken)]) * max(normal.misfit / normal.readings, 1.0)
    found = []
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
                shares[number],
                tuple(names[other].what for other in others),
            )
        )
    return tuple(found)


def _fit_unknowns(
    about: Callable[[Array], Equations],
    begin: tuple[Array, Equations],
    places: list[int],
    possible: Callable[[Array], bool],
) -> tuple[Array, Equations]:
    """Fits some unknowns by Gauss-Newton iterations, the others held; returns the point and the equations about it."""
    at, normal = begin
    for _ in range(_PASSES):
        move = np.zeros_like(at)
        move[places] = np.linalg.solve(normal.information[np.ix_(places, places)], normal.score[places])
        if float(move @ normal.score) < _SETTLED:
            break
        while not possible(at + move):
            move *= 0.5
        after = about(at + move)
        if not after.misfit < normal.misfit:
            break
        at, normal = at + move, after
    return at, normal


def _misfit_gain(normal: Equations, places: list[int]) -> float:
    """Returns by how much freeing these unknowns reduces the misfit, squared sigmas; 0 if not separable."""
    chosen = np.array(places)
    information, score = normal.information[np.ix_(chosen, chosen)], normal.score[chosen]
    scale = np.sqrt(information.diagonal())
    unit = information / np.outer(scale, scale)
    if np.linalg.cond(unit) > _TELLABLE:
        return 0.0
    return float((score / scale) @ np.linalg.solve(unit, score / scale))


_TELLABLE = 1e8  # condition of unknowns beyond which they are one


def name_mass_property(symbol: str, unit: str, value: float) -> UnknownLabel:
    """Labels a mass property: diagonal inverse inertia and 1/m in percent of the value, others in their unit."""
    of_itself = symbol in _IN_PERCENT and value != 0.0
    return UnknownLabel(symbol, "%", 100.0 / float(abs(value))) if of_itself else UnknownLabel(symbol, unit, 1.0)


def _name_unknowns(scenario: Scenario, made: FlightModel, at: Array) -> list[UnknownLabel | None]:
    """Returns the label of each unknown of the flight model, in its order; None where it is not fitted."""
    names: Names = vehicle_names(scenario)
    places = columns(made)
    torque, drag = (names.torque, f"{names.torque}-s/rad")
    units = mass_property_units(scenario.vehicle_data.unit_names)
    named = [name_mass_property(*one) for one in zip(SYMBOLS, units, at.tolist(), strict=False)]
    found: list[tuple[str, str, float]] = [(f"thrust of {jet}", "%", 100.0) for jet in names.jets]
    found += [(f"lag of {kind} jets", "ms", 1e3) for kind in names.kinds[: places.lag.stop - places.lag.start]]
    found += [(f"gyro bias {letter}", "rad/s", 1.0) for letter in AXES]
    found += [
        (f"{name}: bias or steady force {a}", names.acceleration, 1.0) for name in names.accelerometers for a in AXES
    ]
    found += [(f"torque {letter} that nobody commands", torque, 1.0) for letter in AXES]
    found += [(f"drag about {letter}", drag, 1.0) for letter in AXES]
    found += [(f"angular momentum {letter} of wheels", f"{names.torque}-s", 1.0) for letter in AXES]
    sensors = (*names.gyros, *names.accelerometers)
    found += [(f"scale of {name} {letter}", "%", 100.0) for name in sensors for letter in AXES]
    return [*named, *(UnknownLabel(*one) for one in found), *[None] * (places.shift.stop - places.shift.start)]


_IN_PERCENT = ("Ixx⁻¹", "Iyy⁻¹", "Izz⁻¹", "1/m")
