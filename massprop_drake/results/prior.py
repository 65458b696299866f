"""Comparison of the estimates at the end with the prior, and search for a common factor between them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import factors, params
from massprop_drake.inputs.factors import Factor, format_factor
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.joint.process_noise import propellant_drift
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results.consistency import Diagnosis
from massprop_drake.results.record_stretches import used_propellant
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_CHANCE = 1e-6  # probability that a truth drawn from the start is called one that it does not allow
_COMMON = 1e-4  # the same of a factor that all scales have in common
_FEWEST = 2  # scales that show that it is what jets are told or give
_UNWEIGHED = "commands, thrusts or rates"  # without an accelerometer nothing tells them apart
_DIAGONAL = [0, 1, 2]
_SCALES = np.isin(np.arange(10), [*_DIAGONAL, MASS_RECIPROCAL])


class _Departure(NamedTuple):
    """Distance of the final estimates from the prior, as chi-square statistic and in sigmas.

    Attributes:
        statistic: chi-square distributed at the most, if the start is true.
        degrees: of freedom.
        ratios: of each parameter to its 1-sigma, NaN where not tested, shape (10,).
    """

    statistic: float
    degrees: int
    ratios: Array

    @property
    def is_near(self) -> bool:
        """True if the largest departure of any parameter, in sigmas, may be chance, at a probability of 1e-6."""
        largest = float(np.nanmax(np.abs(self.ratios), initial=0.0))
        return largest**2 <= chi_square_limit(_CHANCE / self.degrees, 1)

    @property
    def is_allowed(self) -> bool:
        """True if the chi-square of all parameters, and the largest departure in sigmas, may be chance."""
        return self.is_near and self.statistic <= chi_square_limit(_CHANCE, self.degrees)


class _Prior(NamedTuple):
    """Prior of the ten parameters, with the drift by propellant used during the run.

    Attributes:
        values: the ten parameters, shape (10,).
        covariance: of them, and of the estimates, shape (10, 10).
        tested: which parameters are estimated, and had a 1-sigma, shape (10,).
    """

    values: Array
    covariance: Array
    tested: NDArray[np.bool_]

    def departure(self, estimate: Array) -> _Departure:
        """Computes the distance of estimates from the prior: chi-square, and sigmas of each parameter.

        A scale that is larger counts by its logarithm, so that a truth is no farther off where it was drawn by a
        factor than where it was drawn by a difference.
        """
        change = estimate - self.values
        is_larger = _SCALES & (change > 0.0) & (self.values > 0.0)
        change[is_larger] = self.values[is_larger] * np.log(estimate[is_larger] / self.values[is_larger])
        deviation = np.sqrt(self.covariance.diagonal())
        scaled = (change / deviation)[self.tested]
        correlation = (self.covariance / np.outer(deviation, deviation))[np.ix_(self.tested, self.tested)]
        return _Departure(
            float(scaled @ np.linalg.lstsq(correlation, scaled, rcond=None)[0]),
            scaled.size,
            np.where(self.tested, change / deviation, np.nan),
        )


def find_contradiction(scenario: Scenario, signals: Spool, estimate: Array) -> Diagnosis | None:
    """Diagnoses final estimates too far from the prior, by a common factor if one explains it; or None.

    Args:
        scenario: as run, from its start on, without a jump of the mass properties.
        signals: with `standard_deviation` and `command`.
        estimate: of the ten parameters at the end, NaN where not observed, shape (10,).
    """
    if scenario.estimation.start == "zero":
        return None
    used = used_propellant(scenario, signals, scenario.vehicle_data.mass_flows)
    at_start = estimate.copy()
    if at_start[MASS_RECIPROCAL] > 0.0:
        at_start[MASS_RECIPROCAL] /= 1.0 + at_start[MASS_RECIPROCAL] * used
    prior = _make_prior(scenario, signals, at_start, used)
    if not prior.tested.any():
        return None
    result = prior.departure(at_start)
    explaining: list[tuple[float, _Group, float]] = []
    for group in _scale_groups(scenario, prior, at_start):
        factor, sigmas = _common_factor(prior, at_start, group.members)
        remainder = prior.departure(_divide_by_factor(at_start, group.members, factor))
        if not remainder.is_allowed:
            continue
        is_significant = sigmas**2 > chi_square_limit(_COMMON, 1)
        if not is_significant and group.of_jets and result.is_near:  # scales may have their errors in common
            return None
        if is_significant and (group.of_jets or not result.is_allowed):
            explaining.append((remainder.statistic, group, factor))
    if not explaining and result.is_allowed:
        return None
    direct = np.abs(at_start - prior.values) / np.sqrt(prior.covariance.diagonal())
    limit = chi_square_limit(_CHANCE, result.degrees)
    if explaining:
        _, group, factor = min(explaining, key=lambda one: one[0])
        sigmas = direct[group.members].max()
        words = f"{group.ends} at {format_factor(1.0 / factor)} times the start, {sigmas:.3g} of its sigmas off"
        return Diagnosis("factor", f"{words}, {group.in_words(factor)}", result.statistic, limit)
    worst = int(np.argmax(np.where(prior.tested, direct, -1.0)))
    words = f"{SYMBOLS[worst]} ends {direct[worst]:.3g} of the start's sigmas from it"
    if result.degrees > 1:
        words += f"; all {result.degrees} together have a chi-square of {result.statistic:.3g} ({limit:.3g} is allowed)"
    return Diagnosis("start", words, result.statistic, limit)


def _make_prior(scenario: Scenario, signals: Spool, estimate: Array, propellant_mass: float) -> _Prior:
    """Makes the prior of the ten parameters; its covariance includes propellant drift and the final 1-sigma."""
    values, covariance = params.initial_estimate(scenario), params.initial_covariance(scenario)
    known = covariance.diagonal() > 0.0
    is_tested = known & np.isfinite(estimate) & ~params.known_parameters(scenario)
    vehicle = scenario.vehicle_data
    drift = propellant_drift(values, propellant_mass, vehicle.tank_fraction, vehicle.rms_arm)
    deviation = np.nan_to_num(signals.last("standard_deviation"))
    covariance = covariance + np.diag(np.where(known, drift + deviation**2, 1.0))
    return _Prior(values, covariance, is_tested)


class _Group(NamedTuple):
    """Group of parameters that an error of units or scale would change by a common factor.

    Attributes:
        members: which of the ten parameters, shape (10,).
        cause: what is off then.
        ends: what of the vehicle is, and its verb.
        known: the common factors of the cause.
        of_jets: whether the cause is what jets are told or give.
    """

    members: NDArray[np.bool_]
    cause: str
    ends: str
    known: tuple[Factor, ...]
    of_jets: bool

    def in_words(self, factor: float) -> str:
        """Describes an error by a factor in the inverse inertia or 1/m, with the likely mistake behind it."""
        size = 1.0 / factor if self.of_jets else factor  # more thrust than is told looks like less mass
        found = factors.factors_near(size, self.known)
        likely = f"; {found[0].name} would make it {format_factor(found[0].size)}" if found else ""
        return f"as if {self.cause} were {format_factor(size)} times what acts{likely}"


def _scale_groups(scenario: Scenario, prior: _Prior, estimate: Array) -> Iterator[_Group]:
    """Yields groups of diagonal inverse inertias and 1/m that one error of scale would change together."""
    units, period_s = scenario.vehicle_data.units, scenario.vehicle_data.sample_period_s
    usable = prior.tested & _SCALES & (prior.values > 0.0) & (estimate > 0.0)
    of_mass = np.arange(10) == MASS_RECIPROCAL
    inertia, mass = usable & ~of_mass, usable & of_mass
    if usable.sum() >= _FEWEST:
        cause, ends = ("commands or thrusts", "inertia and mass end") if mass.any() else (_UNWEIGHED, "inertia ends")
        yield _Group(usable, cause, ends, factors.impulse_factors(units, period_s), True)
    if inertia.any() and mass.any():
        yield _Group(inertia, "rates", "inertia alone ends", factors.rate_factors(period_s), False)
        yield _Group(mass, "accelerometers", "mass alone ends", factors.velocity_factors(units, period_s), False)


def _common_factor(prior: _Prior, estimate: Array, mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Computes the mean factor of estimates over the prior for the masked parameters, and its size in sigmas."""
    logarithms = np.log(estimate[mask] / prior.values[mask])
    relative = np.sqrt(prior.covariance.diagonal()[mask]) / prior.values[mask]
    weights = 1.0 / relative**2
    mean = float(weights @ logarithms / weights.sum())
    return math.exp(mean), abs(mean) / float(relative.max())


def _divide_by_factor(estimate: Array, mask: NDArray[np.bool_], factor: float) -> Array:
    """Divides the inverse inertia, 1/m, or both, as masked, by a factor; returns the ten parameters."""
    result = estimate.copy()
    if mask[_DIAGONAL].any():
        result[:6] /= factor
    if mask[MASS_RECIPROCAL]:
        result[MASS_RECIPROCAL] /= factor
    return result
