"""Readings of gyros or accelerometers that are off by a common factor, such as one of units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import factors
from massprop_drake.inputs.factors import Factor
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.offline import regression, unexplained_motion
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.results.consistency import Diagnosis
from massprop_drake.results.diagnoses import EXPLAINED, FEWEST, GAINED, SCATTER, excess_misfit, fit_cost, fit_start
from massprop_drake.results.record_stretches import select_short_pieces
from massprop_drake.results.regression_model import vehicle_names

_UNLIKELY = 2.5  # ratio of what readings gain to what jets give by the vehicle's file, beyond which a unit is tried


class _Rescaled(NamedTuple):
    """Record whose readings were all off by common factors.

    Attributes:
        parts: the stretches without them.
        begin: the ten parameters by these, shape (10,).
        found: the factors.
    """

    parts: list[Stretch]
    begin: Array
    found: list[Diagnosis]


def find_common_factors(
    stretches: Sequence[Stretch], estimate: Array, model: FlightModel, scenario: Scenario
) -> _Rescaled | None:
    """Finds factors common to all gyro or accelerometer readings, such as wrong units; None without any.

    Args:
        stretches: of the whole record, since a wrong factor may have caused a declared failure.
        estimate: the ten parameters as estimated, shape (10,).
        model: see `make_model`.
        scenario: as run.
    """
    ratios = unexplained_motion.gain_ratios(stretches, model.prior, model)
    vehicle, gyro = scenario.vehicle_data, np.arange(ratios.size) < model.gyros
    rates = factors.rate_factors(vehicle.sample_period_s)
    velocities = factors.velocity_factors(vehicle.units, vehicle.sample_period_s)
    of_gyros, of_others = _candidate_factors(ratios, gyro, rates), _candidate_factors(ratios, ~gyro, velocities)
    known_factors = (None, *rates, *velocities)
    names = vehicle_names(scenario)
    tried: list[tuple[float, _Rescaled]] = []
    for pair in product((None, *of_gyros), (None, *of_others)):
        sizes, words = np.ones(ratios.size), []
        for mask, factor, among in zip((gyro, ~gyro), pair, (names.gyros, names.accelerometers), strict=True):
            if factor is not None:
                off = mask & ~_is_plausible(ratios)
                sizes[off] = factor.size
                sensors = [name for name, is_off in zip(among, off[mask], strict=True) if is_off]
                words.append(f"{', '.join(sensors)}: readings are {factor}")
        if not words:
            continue
        other = [_scale_readings(stretch, 1.0 / sizes) for stretch in stretches]
        chosen = select_short_pieces(other, math.inf, model)
        after = regression.fit_flight(chosen, model.prior, model)
        if after.normal.readings < FEWEST or not after.normal.is_finite:
            continue
        before = regression.fit_flight(
            [_scale_readings(stretch, sizes) for stretch in chosen], fit_start(estimate, model), model
        )
        gained = fit_cost(before, model) - fit_cost(after, model)
        settled = excess_misfit(after) <= (1.0 - EXPLAINED) * excess_misfit(before)
        if before.normal.is_finite and not (settled and gained > GAINED * max(after.normal.per_reading, 1.0)):
            continue
        found = [Diagnosis("factor", one, before.normal.per_reading, after.normal.per_reading) for one in words]
        exact = 1.0 if all(one in known_factors for one in pair) else SCATTER  # what was measured is not
        tried.append((exact * after.normal.per_reading, _Rescaled(other, after.at[:10], found)))
    return min(tried, key=lambda one: one[0], default=(0.0, None))[1]


def _scale_readings(stretch: Stretch, scales: Array) -> Stretch:
    """Multiplies a stretch's readings by a factor for each sensor package, shape (n_packages,)."""
    return stretch._replace(readings=stretch.readings * scales[:, None])


def _candidate_factors(ratios: Array, mask: NDArray[np.bool_], known_factors: Sequence[Factor]) -> list[Factor]:
    """Returns the masked sensors' median implausible ratio, after known factors near it; [] if all are plausible."""
    off = ratios[mask & ~_is_plausible(ratios)]
    if not off.size:
        return []
    size = float(np.median(off))
    return [*factors.factors_near(size, known_factors), Factor(size, "")] if size > 0.0 else []


def _is_plausible(ratios: Array) -> NDArray[np.bool_]:
    """Flags ratios of measured to predicted change within 1/2.5 to 2.5, or NaN, as mass properties may cause."""
    return np.isnan(ratios) | ((ratios >= 1.0 / _UNLIKELY) & (ratios <= _UNLIKELY))
