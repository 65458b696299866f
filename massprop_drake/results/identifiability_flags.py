"""Identifiability of each of the ten parameters in a run, and the jet whose firing would improve it most."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.model import Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation import observability
from massprop_drake.maths.estimation.offline import identifiability
from massprop_drake.maths.estimation.offline.identifiability import FIRING_S, Flag
from massprop_drake.maths.vehicle.sensing import increment_noise

Array = NDArray[np.float64]

_OFFSET = np.array([0.62, -0.48, 0.62])  # a unit vector along no axis and in no plane of them
_UNMEASURED = 1e30  # variance of a velocity that nothing shows
_GROWN = 1.005  # of the start's 1-sigma: more than the digits that are shown
_LESS = 0.9  # times the bound: a 1-sigma below it is no matter of which readings count
_WORTH = 0.9  # share of the 1-sigma: a jet that leaves more of it is not worth naming


class Identifiability(NamedTuple):
    """Identifiability of a parameter in a run.

    Attributes:
        parameter: as in `maths.mass_properties.NAMES`.
        flag: see `maths.estimation.offline.identifiability.Flag`.
        reason: why it is not identified, and what would show it; empty where it is.
        share: 1-sigma at the end over that at the start; None where one of them is not known.
        jet: designation of the jet of which a second would tell the most; None where none tells anything.
        left: share of the 1-sigma at the end that it would leave.
        bound: least 1-sigma that the flight allows for rounding taken as noise (Cramér and Rao's), in the parameter's
            unit; None where not known.
    """

    parameter: Text
    flag: Text
    reason: Text
    share: Real | None = None
    jet: Text | None = None
    left: Real | None = None
    bound: Real | None = None


def unobservable_combinations(
    vehicle: Vehicle, *, accelerometer: bool, known: NDArray[np.bool_] | None = None
) -> Array:
    """Computes the combinations of the ten parameters that no jet and no sensor of a vehicle shows, shape (k, 10).

    A row each, in units of the 1-sigma at the start; those hidden wherever the center of mass lies.

    Args:
        vehicle: its jets.
        accelerometer: whether velocity is measured.
        known: parameters that are not estimated, shape (10,); None: none.
    """
    parameters = vehicle.nominal.vector()
    floor = vehicle.center_of_mass_floor or 1.0
    scale = mass_properties.initial_standard_deviation(parameters, vehicle.uncertainty, floor)
    parameters[mass_properties.CENTER_OF_MASS] += _OFFSET * floor
    free = np.ones(10, dtype=np.bool_) if known is None else ~known
    return _hidden_combinations(
        *(array.tobytes() for array in (vehicle.wrenches, parameters, scale, free)), accelerometer
    ).copy()


@lru_cache(maxsize=64)
def _hidden_combinations(wrenches: bytes, parameters: bytes, scale: bytes, free: bytes, accelerometer: bool) -> Array:
    """Computes unobservable combinations, shape (k, 10), from arrays as bytes, so that results can be cached."""
    jets = np.frombuffer(wrenches).reshape(-1, 6)
    jacobian = observability.impulse_jacobian(jets, np.frombuffer(parameters), accelerometer=accelerometer)
    indices = np.flatnonzero(np.frombuffer(free, dtype=np.bool_))
    combinations = observability.unobservable_combinations(jacobian[:, indices], np.frombuffer(scale)[indices])
    result = np.zeros((combinations.shape[0], 10))
    result[:, indices] = combinations
    return result


def classify_parameters(
    scenario: Scenario, estimate: Array, covariance: Array, bound: Array | None = None
) -> tuple[Identifiability, ...]:
    """Classifies each parameter as identified, weak, not excited, not observable or fixed, with reason.

    Args:
        scenario: as run.
        estimate: of the ten parameters, NaN where not observed, shape (10,).
        covariance: of their errors, shape (10, 10).
        bound: least 1-sigma that the run allows for rounding taken as noise, NaN where not known, shape (10,).
    """
    vehicle = scenario.vehicle_data
    least = np.full(10, math.nan) if bound is None else bound
    limits, known = params.convergence_limits(scenario), params.known_parameters(scenario)
    weighs = params.mass_is_observable(scenario)
    deviation = np.sqrt(covariance.diagonal())
    good = bool(mass_properties.are_converged(deviation[None], estimate[None], limits, known)[0])
    scaling = estimate if good else vehicle.nominal.vector()  # what is not known yet scales nothing
    limit = identifiability.requested_deviation(scaling, limits)
    start = np.sqrt(params.initial_covariance(scenario).diagonal())
    hidden = unobservable_combinations(vehicle, accelerometer=weighs, known=known)
    found = identifiability.classify_parameters(start, deviation, limit, (hidden != 0.0).any(axis=0))
    found = [Flag.FIXED if fixed else flag for fixed, flag in zip(known, found, strict=True)]

    jacobian = observability.impulse_jacobian(vehicle.wrenches * FIRING_S, scaling, accelerometer=weighs)
    jacobian = jacobian.reshape(len(vehicle.jets), -1, 10)
    noise = increments_noise(scenario)
    best, left_by = identifiability.predict_best_firing(covariance, jacobian, noise)

    entries = []
    for element, (name, flag) in enumerate(zip(mass_properties.NAMES, found, strict=True)):
        useful = flag != Flag.NOT_OBSERVABLE and left_by[element] < _WORTH
        jet = vehicle.jets[int(best[element])].designation if useful else None
        share = float(deviation[element] / start[element]) if start[element] > 0.0 else math.nan
        left = float(left_by[element]) if useful else None
        possible = None if flag == Flag.NOT_OBSERVABLE or not math.isfinite(least[element]) else float(least[element])
        ratios = float(deviation[element] / limit[element]), float(least[element] / limit[element])
        reason = _explain_flag(flag, share, ratios, jet, left)
        entries.append(
            Identifiability(name, str(flag), reason, share if math.isfinite(share) else None, jet, left, possible)
        )
    return tuple(entries)


def increments_noise(scenario: Scenario) -> Array:
    """Computes the covariance of a sample's increments of rate and, if observed, velocity, (3, 3) or (6, 6).

    A position or an attitude shows them by the difference of two differences.
    """
    vehicle, period_s = scenario.vehicle_data, scenario.vehicle_data.sample_period_s
    gyros, accelerometers = params.gyros(scenario), params.accelerometers(scenario)
    turning = [pose.attitude_std for pose in vehicle.poses if pose.attitude_std is not None]
    moving = [pose.position_std for pose in vehicle.poses if pose.position_std is not None]
    rates = [gyro.variance for gyro in gyros[:1]] + [3.0 * (std / period_s) ** 2 for std in turning]
    speeds = [package.variance for package in accelerometers[:1]] + [3.0 * (std / period_s) ** 2 for std in moving]
    speeds += [sensor.noise_std**2 for sensor in vehicle.velocities]
    noise = increment_noise(min(rates))
    if not params.mass_is_observable(scenario):
        return noise
    nothing = np.zeros((3, 3))
    return np.block([[noise, nothing], [nothing, increment_noise(min(speeds, default=_UNMEASURED))]])


def _explain_flag(
    flag: Flag, sigma_over_start: float, sigma_ratios: tuple[float, float], jet: str | None, sigma_left: float | None
) -> str:
    """Explains a flag in words by 1-sigma over its start, by it and its bound over the limit, and after a firing."""
    excess, least = sigma_ratios
    if flag == Flag.IDENTIFIED:
        return ""
    if flag == Flag.FIXED:
        return "known, or of no effect in a plane: not estimated"
    if flag == Flag.NOT_OBSERVABLE:
        return "no jet and no sensor in use shows it alone"
    allowed = f" (the flight allows {least:.2g})" if least < 1.0 < excess else ""
    if flag == Flag.WEAK:
        state = f"1-sigma is {excess:.3g}{allowed} times what is asked"
    elif sigma_over_start > _GROWN:  # by what propellant or a payload has changed
        state = f"1-sigma has grown to {sigma_over_start:.3g} times the start's"
    else:
        state = f"1-sigma is still {100.0 * sigma_over_start:.3g} % of the start's"
    if jet is None or sigma_left is None:
        return f"{state}; no jet would tell much of it"
    return f"{state}; a second of {jet} would leave {100.0 * sigma_left:.2g} % of it"


def in_words(entries: Sequence[Identifiability], symbols: Sequence[str]) -> list[tuple[str, str]]:
    """Lists (parameter and flag, reason) in words for parameters that are not identified; fixed ones together."""
    told = [(one, symbol) for one, symbol in zip(entries, symbols, strict=False) if one.flag != Flag.IDENTIFIED]
    said = [(f"{symbol} {one.flag.replace('_', ' ')}", one.reason) for one, symbol in told if one.flag != Flag.FIXED]
    fixed = [(one.reason, symbol) for one, symbol in told if one.flag == Flag.FIXED]
    return said + ([(f"{', '.join(symbol for _, symbol in fixed)} fixed", fixed[0][0])] if fixed else [])


def bound_in_words(
    deviations: Sequence[float], entries: Sequence[Identifiability], symbols: Sequence[str], *, has_failed: bool = False
) -> str:
    """Describes the range of final 1-sigma over its Cramér-Rao bound, in words; "" where no bound is known.

    A ratio below 1 is no fault: a quantized reading that changes tells more than the bound assumes.

    Args:
        deviations: 1-sigma of the ten parameters.
        entries, symbols: of each.
        has_failed: whether jets were declared failed; the bound is of healthy ones.
    """
    each = zip(deviations, entries, symbols, strict=False)
    ratios = [(deviation / one.bound, symbol) for deviation, one, symbol in each if one.bound]
    if not ratios:
        return ""
    (least, low), (most, high) = min(ratios), max(ratios)
    assumed = (
        "computed as if no jet had failed and rounding were noise" if has_failed else "with rounding taken as noise"
    )
    same = _format_ratio(least) == _format_ratio(most)
    above = f"{_format_ratio(least)}{'' if same else f' to {_format_ratio(most)} ({high})'}"
    span = above if least >= _LESS else f"{_format_ratio(least)} ({low}) to {_format_ratio(most)} ({high})"
    return f"1-sigma is {span} times its Cramér-Rao bound, {assumed}"


def _format_ratio(value: float) -> str:
    """Formats a ratio to two digits, without a power of ten where it is below a million."""
    return f"{value:.2g}" if not 99.5 <= value < 1e6 else f"{float(f'{value:.2g}'):.0f}"
