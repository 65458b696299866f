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
from massprop_drake.results.diagnoses import EXPLAINED, FEWEST, SCATTER, cost_of, excess, start_from
from massprop_drake.results.record_stretches import short_enough
from massprop_drake.results.regression_model import names_of

_GAINED = 30.0  # log likelihood, twice, that a factor must gain: 5 sigma, of some ten that are tried
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


def rescaled(parts: Sequence[Stretch], begin: Array, made: FlightModel, scenario: Scenario) -> _Rescaled | None:
    """Finds common factors of gyro and accelerometer readings whose removal explains the record; None without any.

    Args:
        parts: of the whole record, since a failure that was declared may be the factor's doing.
        begin: the ten parameters as estimated, shape (10,).
        made: see `model`.
        scenario: as run.
    """
    ratios = unexplained_motion.gain_ratios(parts, made.prior, made)
    vehicle, gyro = scenario.vehicle_data, np.arange(ratios.size) < made.gyros
    rates = factors.of_rates(vehicle.sample_period_s)
    velocities = factors.of_velocities(vehicle.units, vehicle.sample_period_s)
    of_gyros, of_others = _candidates(ratios, gyro, rates), _candidates(ratios, ~gyro, velocities)
    known = (None, *rates, *velocities)
    names = names_of(scenario)
    tried: list[tuple[float, _Rescaled]] = []
    for pair in product((None, *of_gyros), (None, *of_others)):
        sizes, words = np.ones(ratios.size), []
        for kind, factor, among in zip((gyro, ~gyro), pair, (names.gyros, names.accelerometers), strict=True):
            if factor is not None:
                off = kind & ~_is_plausible(ratios)
                sizes[off] = factor.size
                sensors = [name for name, is_off in zip(among, off[kind], strict=True) if is_off]
                words.append(f"{', '.join(sensors)}: readings are {factor}")
        if not words:
            continue
        other = [_times(part, 1.0 / sizes) for part in parts]
        chosen = short_enough(other, math.inf, made)
        after = regression.fitted(chosen, made.prior, made)
        if after.normal.readings < FEWEST or not after.normal.is_finite:
            continue
        before = regression.fitted([_times(part, sizes) for part in chosen], start_from(begin, made), made)
        gained = cost_of(before, made) - cost_of(after, made)
        settled = excess(after) <= (1.0 - EXPLAINED) * excess(before)
        if before.normal.is_finite and not (settled and gained > _GAINED * max(after.normal.per_reading, 1.0)):
            continue
        found = [Diagnosis("factor", one, before.normal.per_reading, after.normal.per_reading) for one in words]
        exact = 1.0 if all(one in known for one in pair) else SCATTER  # what was measured is not
        tried.append((exact * after.normal.per_reading, _Rescaled(other, after.at[:10], found)))
    return min(tried, key=lambda one: one[0], default=(0.0, None))[1]


def _times(part: Stretch, sizes: Array) -> Stretch:
    """Multiplies the readings of each package in a stretch by a factor, shape (n_packages,)."""
    return part._replace(readings=part.readings * sizes[:, None])


def _candidates(ratios: Array, kind: NDArray[np.bool_], known: Sequence[Factor]) -> list[Factor]:
    """Returns the common factors that packages of a kind may be off by, or else the measured one."""
    off = ratios[kind & ~_is_plausible(ratios)]
    if not off.size:
        return []
    size = float(np.median(off))
    return [*factors.near(size, known), Factor(size, "")] if size > 0.0 else []


def _is_plausible(ratios: Array) -> NDArray[np.bool_]:
    """Tests whether mass properties may be so far from nominal that readings change by so much more or less."""
    return np.isnan(ratios) | ((ratios >= 1.0 / _UNLIKELY) & (ratios <= _UNLIKELY))
