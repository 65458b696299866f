"""Targets, suspects and limits of a design, read from text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import units
from massprop_drake.inputs.estimation_blocks import FaultsBlock
from massprop_drake.inputs.plausible import FOOT, SLUG
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.faults.priors import Priors, log_failure_probability, log_jump_probability
from massprop_drake.maths.estimation.joint.hypotheses import jump_variances
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.maneuver.aims import Aims
from massprop_drake.maths.maneuver.information import n_known
from massprop_drake.maths.maneuver.planning import ManeuverLimits
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, MASS_RECIPROCAL, symmetric_matrix

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_MOMENTS = {"Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2)}
_PRODUCTS = {"Iyz": (1, 2), "Ixz": (0, 2), "Ixy": (0, 1)}
_GROUPS = {"inertia": tuple(_MOMENTS), "center": ("x_cm", "y_cm", "z_cm")}
TARGETS = ("mass", *_GROUPS, *_MOMENTS, *_PRODUCTS, *_GROUPS["center"])
LIMITS = {  # by what each is measured in, and what is said of it
    "rate": ("rate", "deg/s"),
    "angle": ("angle", "deg"),
    "displacement": ("length", "m"),
    "propellant": ("mass", "kg"),
    "time": ("time", "s"),
}
_SI = {"length": (1, 0), "mass": (0, 1)}


class Target(NamedTuple):
    """Quantity that an estimate must reach to a 1-sigma.

    Attributes:
        name: one of `TARGETS` but for groups.
        unit: of the rest.
        value: as the vehicle is taken to be.
        asked: 1-sigma.
        combination: its derivative by the ten parameters, shape (10,).
        share: what 100 % is; zero: it has no percent.
    """

    name: str
    unit: str
    value: float
    asked: float
    combination: Array
    share: float


def parse_targets(target_texts: Mapping[str, str], properties: Array, vehicle: Vehicle) -> list[Target]:
    """Parses 1-sigmas by quantity, such as ``{"mass": "1%"}``, to a list of targets, one per quantity of a group.

    Args:
        target_texts: 1-sigma by name, a share or with a unit.
        properties: the ten parameters as the vehicle is taken to be, shape (10,).
        vehicle: for its units.

    Raises:
        InputError: for a name or a 1-sigma that is none.
    """
    targets = list[Target]()
    for name, text in target_texts.items():
        if name not in TARGETS:
            raise InputError(f"design: target '{name}': no such quantity{suggestion(name, TARGETS)}")
        for each in _GROUPS.get(name, (name,)):
            if each in {one.name for one in targets}:
                raise InputError(f"design: target '{each}' is given twice")
            targets.append(_parse_target(name, each, text, properties, vehicle))
    return targets


def derivative_and_value(name: str, properties: Array) -> tuple[Array, float]:
    """Computes the derivative of a mass property by the ten parameters, shape (10,), and its value.

    Args:
        name: one of `TARGETS` but for groups.
        properties: the ten parameters, shape (10,).
    """
    combination = np.zeros(10)
    if name == "mass":
        combination[MASS_RECIPROCAL] = -(properties[MASS_RECIPROCAL] ** -2.0)
        return combination, float(1.0 / properties[MASS_RECIPROCAL])
    if name in _GROUPS["center"]:
        element = CENTER_OF_MASS.start + _GROUPS["center"].index(name)
        combination[element] = 1.0
        return combination, float(properties[element])
    inertia = np.linalg.inv(symmetric_matrix(properties[:6]))
    row, column = {**_MOMENTS, **_PRODUCTS}[name]
    for element in range(6):
        change = symmetric_matrix(np.eye(6)[element])
        combination[element] = -(inertia @ change @ inertia)[row, column]
    return combination, float(inertia[row, column])


def _parse_target(group: str, name: str, text: str, properties: Array, vehicle: Vehicle) -> Target:
    """Makes the target of one quantity from the text of its 1-sigma, with its derivative by the ten parameters."""
    combination, value = derivative_and_value(name, properties)
    names = vehicle.unit_names
    if name == "mass":
        unit, powers, reference = names["mass"], (0, 1), value
    elif name in _GROUPS["center"]:
        unit, powers, reference = names["length"], (1, 0), 0.0
    else:
        unit, powers = f"{names['mass']}-{names['length']}^2", (2, 1)
        row, column = {**_MOMENTS, **_PRODUCTS}[name]
        moments = [derivative_and_value(each, properties)[1] for each in _MOMENTS]
        reference = math.sqrt(moments[row] * moments[column])
    asks = _parse_deviation(text, reference, powers, vehicle, f"design: target {group}={text}")
    return Target(name, unit, value, asks, combination, reference)


def _parse_deviation(text: str, reference: float, powers: tuple[int, int], vehicle: Vehicle, location: str) -> float:
    """Parses a 1-sigma, in percent of a reference or in a unit of length and mass to these powers."""
    number, unit = _split_quantity(text, location)
    example = "1%" if reference else f"5 mm, or in {vehicle.unit_names['length']}"
    if not unit:
        raise InputError(f"{location}: needs a unit, such as {example}")
    parsed = units.parse_unit(unit)
    if parsed.dimension == (0, 0, 0, 0) and reference:
        deviation = number * parsed.factor * reference
    elif parsed.dimension == (*powers, 0, 0):
        deviation = number * parsed.factor / _si_factor(powers, vehicle)
    else:
        raise InputError(f"{location}: '{unit}' does not fit; write it like {example}")
    if not (math.isfinite(deviation) and deviation > 0.0):
        raise InputError(f"{location}: must be above zero")
    return deviation


def _split_quantity(text: str, location: str) -> tuple[float, str]:
    """Splits a text such as `0.5deg/s` into number and unit; raises InputError for any other text."""
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise InputError(f"{location}: is no number with a unit, such as 0.5 deg/s or 1%")
    return float(match[1]), match[2]


def _si_factor(powers: tuple[int, int], vehicle: Vehicle) -> float:
    """Returns the SI value of the vehicle's unit of length and mass to two powers, such as (1, 0) for a length."""
    if vehicle.unit_names["mass"] == "kg":
        return 1.0
    return float(FOOT ** powers[0] * SLUG ** powers[1])


def parse_limits(limit_texts: Mapping[str, str], vehicle: Vehicle) -> ManeuverLimits:
    """Parses maneuver limits such as ``{"rate": "0.5 deg/s"}``; a bare number is in the vehicle's units."""
    limits = {}
    for name, text in limit_texts.items():
        location = f"design: limit {name}={text}"
        if name not in LIMITS:
            raise InputError(f"{location}: no such limit{suggestion(name, LIMITS)}")
        number, unit = _split_quantity(text, location)
        kind, example = LIMITS[name]
        if unit:
            parsed = units.parse_unit(unit)
            expected = units.parse_unit(example)
            if parsed.dimension != expected.dimension:
                raise InputError(f"{location}: '{unit}' does not fit; write it like 1 {example}")
            number *= parsed.factor / (_si_factor(_SI[kind], vehicle) if kind in _SI else 1.0)
        if not (math.isfinite(number) and number > 0.0):
            raise InputError(f"{location}: forbids every maneuver; it must be above zero")
        limits[name] = number
    return ManeuverLimits(**limits)


class Suspicion(NamedTuple):
    """Jets of which one may be failing.

    Attributes:
        pairs: places of those that are to be told apart, the second -1: from nothing, integers, shape (p, 2).
        forces: of the first of each pair, lbf or N, shape (p,).
        thrusts: of it, shape (p,).
        loss: whether a jet gives less while it fires; else it leaks.
    """

    pairs: NDArray[np.int_]
    forces: Array
    thrusts: Array
    loss: bool


def parse_suspects(suspects: Sequence[str], force: str, vehicle: Vehicle, usable_jets: NDArray[np.int_]) -> Suspicion:
    """Makes the pairs of failed jets to be separated: one suspect from all other jets, several from each other.

    Args:
        suspects: designations.
        force: that it leaks, a share of its thrust or with a unit; below zero: that is missing while it fires.
        vehicle: see `Vehicle`.
        usable_jets: jets that may be used, integers.

    Raises:
        InputError: when a suspect is none, or would never show.
    """
    jets = list[int]()
    for name in suspects:
        if name not in vehicle.designations:
            raise InputError(f"design: suspect '{name}': no such jet{suggestion(name, vehicle.designations)}")
        if vehicle.designations.index(name) in jets:
            raise InputError(f"design: suspect '{name}' is given twice")
        jets.append(vehicle.designations.index(name))
    if not jets:
        return Suspicion(np.zeros((0, 2), dtype=int), np.zeros(0), np.zeros(0), False)
    signed = parse_failure_forces(force, vehicle, jets)
    loss = bool(signed[jets[0]] < 0.0)
    for jet in jets if loss else ():
        if jet not in usable_jets:
            raise InputError(
                f"design: suspect '{vehicle.designations[jet]}': gives less only while it fires, and it may not "
                "fire; leave it out of 'without', or out of the suspects"
            )
    others = jets if len(jets) > 1 else list(range(len(vehicle.jets)))
    pairs = np.array([(one, other) for one in jets for other in (*others, -1) if one != other], dtype=int)
    first = pairs[:, 0]
    return Suspicion(pairs, np.abs(signed[first]), np.linalg.norm(vehicle.thrusts, axis=1)[first], loss)


def parse_failure_forces(text: str, vehicle: Vehicle, jet_indices: Sequence[int]) -> Array:
    """Parses the failure force of each jet, lbf or N, shape (n_jets,); a negative one is missing thrust.

    Args:
        text: a share of the thrust, or with a unit.
        vehicle: see `Vehicle`.
        jet_indices: of the jets that it must be possible for.

    Raises:
        InputError: when it is none, or more than the thrust of one of these jets.
    """
    location = f"design: force {text}"
    number, unit = _split_quantity(text, location)
    force_unit = units.parse_unit("N" if vehicle.unit_names["force"] == "N" else "lbf")
    parsed = units.parse_unit(unit) if unit else force_unit
    thrusts: Array = np.linalg.norm(vehicle.thrusts, axis=1)
    if parsed.dimension == (0, 0, 0, 0):
        forces = number * parsed.factor * thrusts
    elif parsed.dimension == force_unit.dimension:
        forces = np.full(thrusts.size, number * parsed.factor / force_unit.factor)
    else:
        raise InputError(f"{location}: '{unit}' does not fit; write it like 5% or 0.2 N")
    if number == 0.0 or not math.isfinite(number):
        raise InputError(f"{location}: a suspect that never pushes cannot be told; give what it leaks, or misses")
    for jet in jet_indices:
        if abs(forces[jet]) > thrusts[jet]:
            thrust_text = f"{thrusts[jet]:g} {vehicle.unit_names['force']}"
            raise InputError(f"{location}: is more than the thrust of {vehicle.designations[jet]}, {thrust_text}")
    return forces


class AimSettings(NamedTuple):
    """Settings of the aims of a maneuver search.

    Attributes:
        faults: how likely a failure is, and how sure a declaration must be.
        margin: by which share each 1-sigma is to be smaller than asked.
        converging: whether estimates are to converge.
    """

    faults: FaultsBlock
    margin: float
    converging: bool


def make_aims(targets: Sequence[Target], suspicion: Suspicion, params: JointParams, settings: AimSettings) -> Aims:
    """Makes the aims of the maneuver search: 1-sigmas to reach and failures to separate, each with a margin.

    A failure is looked for once estimates have converged, so with suspects that is an aim.
    """
    (faults, margin, converging) = settings
    rows = [target.combination for target in targets]
    deviations = [target.asked for target in targets]
    if converging or suspicion.pairs.size:
        scaled = [*range(3), MASS_RECIPROCAL]
        guards = np.append(params.guard_relative * np.abs(params.nominal[scaled]), params.guard_center)
        for element, guard in zip([*scaled, *range(10)[CENTER_OF_MASS]], guards.tolist(), strict=True):
            if math.isfinite(guard):
                rows.append(np.eye(10)[element])
                deviations.append(guard)
    combinations = np.zeros((len(rows), n_known(params)))
    combinations[:, :10] = np.array(rows).reshape(-1, 10)
    no_rival = suspicion.pairs[:, 1] < 0
    pairs = suspicion.pairs + (params.places.jets if suspicion.loss else 0)
    pairs[no_rival, 1] = -1
    priors = Priors.stated(faults)
    sized = zip(suspicion.forces.tolist(), suspicion.thrusts.tolist(), strict=True)
    logs = [log_failure_probability(*both, 1.0, priors, is_loss=suspicion.loss) for both in sized]
    needed = (declaration_log_odds(faults) - np.where(no_rival, logs, 0.0)) * (1.0 + margin) ** 2
    asks = np.array(deviations) / (1.0 + margin)
    jumps = jump_variances(params), log_jump_probability(1.0, priors)
    return Aims(combinations, asks, pairs, suspicion.forces, suspicion.thrusts, needed, *jumps)


def declaration_log_odds(faults: FaultsBlock) -> float:
    """Computes the posterior log odds above which a failed jet is declared, nats, log 3 at least."""
    error = Priors.stated(faults).doubt(faults.jet_per_hour)  # probability with which one may be declared falsely
    return math.log(1.0 / min(error, 0.25) - 1.0)
