r"""A record compared with one vehicle: likelihood of its readings, and its derivatives by what may differ.

The vehicle is taken as known but for its motion, which one filter follows; what walks by its nature, as what else
accelerates, walks from where it begins. Of its innovations e, with covariances S, a column of sensitivities for each
unknown theta is carried along, X = d state/d theta, by the filter's own linearization,

    X <- F X,    de/dtheta = -H X,    X <- (1 - K H) X,

so that information A = sum (H X)^T S^-1 H X and score h = sum (H X)^T S^-1 e are those of the readings' likelihood,
however the motion came about. A sample may be one after a kick, or a poor one: its likelihood is that of a mixture, in
which S^-1 and K are means over what has probably happened. The misfit of a sample is twice the logarithm of what its
likelihood is below that of e = 0, which is e^T S^-1 e where nothing is mixed.

The unknowns stand where the state has them (`pose_layout.Parts`), but in their own terms: of each jet the thrust over
that of the vehicle's file, in place of what all jets share 1/m, in place of K the inverse inertia, in place of ln tau
the lag.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_cycle import (
    Happened,
    PoseUpdate,
    kick_and_outlier_chances,
    list_possibilities,
    mix_possibilities,
    possibility_updates,
    scale_pose_noise,
)
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Parts, Places, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.pose_measurement import compare_readings
from massprop_drake.maths.estimation.pose.pose_prediction import Predicted, predict_bank
from massprop_drake.maths.estimation.pose.pose_start import (
    can_initialize,
    first_pose_sensor,
    initialize_bank,
    tracked_point,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT

_INSTANT_S = 1e-9  # a lag that is none
_MOTION = ("position", "attitude", "velocity", "rate", "gathered")  # what the filter follows
_OTHER = ("open", "pulse")  # what is of one hypothesis, or of one pulse


class PoseRecord(NamedTuple):
    """Readings and commands of n rows.

    Attributes:
        time_s: of the rows, increasing, shape (n,).
        levels: commanded from each row on, NaN where not known, shape (n, n_jets).
        readings: at each row.
        outside: known torque about the vehicle origin and force from each row on, shape (n, 6); None: none.
        pieces: when jets open and close, where that is not at rows alone, and what is commanded from then on; None: as
            `levels`.
    """

    time_s: Array
    levels: Array
    readings: Sequence[PoseReadings]
    outside: Array | None = None
    pieces: tuple[Array, Array] | None = None

    def commands(self, row: int) -> Commands:
        """Returns the commands that act up to the time of a row (an index), those given at that time included."""
        outside = None if self.outside is None else self.outside[row - 1]
        time_s, levels = (self.time_s, self.levels) if self.pieces is None else self.pieces
        count = int(np.searchsorted(time_s, self.time_s[row], side="right"))
        return Commands(time_s[:count], levels[:count], outside)

    def until(self, time_s: float) -> PoseRecord:
        """Returns the record cut to its rows before a time, s."""
        rows = int(np.searchsorted(self.time_s, time_s))
        cut = self._replace(time_s=self.time_s[:rows], levels=self.levels[:rows], readings=self.readings[:rows])
        return cut if self.outside is None else cut._replace(outside=self.outside[:rows])


class Assumed(NamedTuple):
    """Vehicle that is taken as known.

    Attributes:
        at: the unknowns as it has them, see the module, shape (size,).
        opens: jet that stands open by `at[parts.open]`, -1: none.
    """

    at: Array
    opens: int = -1


class PoseEquations(NamedTuple):
    """Normal equations of the unknowns, about a point.

    Attributes:
        information, score: see the module, shapes (size, size) and (size,).
        misfit: of all samples.
        readings: components that were read.
    """

    information: Array
    score: Array
    misfit: float
    readings: float

    def plus(self, other: PoseEquations) -> PoseEquations:
        """Adds the normal equations of other samples to these; returns the sum."""
        return PoseEquations(*map(operator.add, self, other))


def unknowns_from_state(state: Array, mass_reciprocal: float, params: PoseParams) -> Array:
    """Converts a filter's state and 1/m to the unknowns of the normal equations, shape (size,)."""
    parts, unknowns = params.parts, state.copy()
    scale = mass_reciprocal * params.nominal_mass
    unknowns[parts.thrust] = state[parts.thrust] / scale
    unknowns[parts.common] = mass_reciprocal
    unknowns[parts.spin] = state[parts.spin] * mass_reciprocal
    unknowns[parts.lag] = np.exp(state[parts.lag])
    return unknowns


def state_from_unknowns(unknowns: Array, params: PoseParams) -> Array:
    """Converts the unknowns to a filter's state, shape (size,): the inverse of `unknowns_from_state`."""
    parts, state = params.parts, unknowns.copy()
    reciprocal = unknowns[parts.common]
    state[parts.thrust] = unknowns[parts.thrust] * reciprocal * params.nominal_mass
    state[parts.common] = 0.0
    state[parts.spin] = unknowns[parts.spin] / reciprocal
    state[parts.lag] = np.log(np.maximum(unknowns[parts.lag], _INSTANT_S))
    return state


def state_derivatives(unknowns: Array, params: PoseParams) -> Array:
    """Computes derivatives of a filter's state by the unknowns, (size, size); zero for elements that are none."""
    parts, result = params.parts, np.diag(select_unknowns(params.parts).astype(float))
    reciprocal, mass = float(unknowns[parts.common.start]), params.nominal_mass
    result[parts.thrust, parts.thrust] *= reciprocal * mass
    result[parts.thrust, parts.common] = mass * unknowns[parts.thrust, None]
    result[parts.common, parts.common] = 0.0
    result[parts.spin, parts.spin] /= reciprocal
    result[parts.spin, parts.common] = -unknowns[parts.spin, None] / reciprocal**2
    result[parts.lag, parts.lag] /= np.maximum(unknowns[parts.lag], _INSTANT_S)
    return result


def select_unknowns(parts: Parts) -> np.ndarray:
    """Flags the state's elements that are unknowns of the normal equations, shape (size,)."""
    result = np.ones(parts.size, dtype=bool)
    for name in (*_MOTION, *_OTHER):
        result[getattr(parts, name)] = False
    return result


def is_physical(unknowns: Array, parts: Parts) -> bool:
    """Tests whether unknowns are physical: mass and inverse inertia positive, no valve lag negative."""
    inverse = unknowns[parts.spin][ELEMENT]
    return bool(
        unknowns[parts.common] > 0.0 and np.linalg.eigvalsh(inverse)[0] > 0.0 and (unknowns[parts.lag] >= 0.0).all()
    )


def known_vehicle_params(vehicle: Assumed, movable: Places, params: PoseParams) -> PoseParams:
    """Returns parameters of a filter that takes a vehicle as known and estimates its motion alone.

    Args:
        movable: places of all that may be other than thought, and of the motion, in order.
    """
    parts, variances = params.parts, np.zeros(params.parts.size)
    variances[params.free] = params.covariance.diagonal()
    follows = np.zeros(parts.size, dtype=bool)
    for name in _MOTION:
        follows[getattr(parts, name)] = True
    start = state_from_unknowns(vehicle.at, params)
    start[follows] = params.start[follows]
    return params._replace(free=movable, start=start, covariance=np.diag(np.where(follows, variances, 0.0)[movable]))


def record_equations(record: PoseRecord, vehicle: Assumed, movable: Places, params: PoseParams) -> PoseEquations:
    """Computes the normal equations of a record's readings by the unknowns, about an assumed vehicle.

    Args:
        vehicle: that is taken as known.
        movable: see `known_vehicle_params`.
    """
    known = known_vehicle_params(vehicle, movable, params)
    size = params.parts.size
    total = PoseEquations(np.zeros((size, size)), np.zeros(size), 0.0, 0.0)
    rows = len(record.readings)
    first = next((row for row in range(rows) if can_initialize(record.readings[row], known)), rows)
    if first == rows:
        return total
    bank = initialize_bank(record.readings[first], known)._replace(opens=np.array([vehicle.opens]))
    sensitivity = _initial_sensitivities(record.readings[first], bank, state_derivatives(vehicle.at, params), known)
    for row in range(first + 1, rows):
        span_s = float(record.time_s[row - 1]), float(record.time_s[row])
        predicted = predict_bank(bank, record.commands(row), *span_s, known)
        bank, sensitivity, sample = _advance_sample(
            predicted, predicted.through[0] @ sensitivity, record.readings[row], span_s, known
        )
        if sample is not None:
            total = total.plus(sample)
    return total


def _initial_sensitivities(readings: PoseReadings, bank: PoseBank, sensitivity: Array, params: PoseParams) -> Array:
    """Computes derivatives of the free elements at the first sample by the unknowns, shape (n, size)."""
    parts, place = params.parts, first_pose_sensor(readings)
    if place is not None:
        sensitivity = sensitivity.copy()
        sensitivity[parts.position] = bank.rotation[0] @ (
            sensitivity[parts.center] - sensitivity[tracked_point(place, parts)]
        )
    return sensitivity[params.free]


def _advance_sample(
    predicted: Predicted, sensitivity: Array, readings: PoseReadings, span_s: tuple[float, float], params: PoseParams
) -> tuple[PoseBank, Array, PoseEquations | None]:
    """Updates filter and sensitivities by readings; returns both, and normal equations or None: nothing read."""
    compared = compare_readings(predicted.bank, readings, params)
    if compared is None:
        return predicted.bank, sensitivity, None
    of_kick, of_poor = kick_and_outlier_chances(compared, span_s, params)
    noisy = scale_pose_noise(compared, params.pose.outlier_scale)
    cases = list_possibilities(predicted, (compared, noisy), (of_kick, of_poor))
    updates = possibility_updates(cases, predicted.bank.mean, params)
    weights, misfit = _possibility_shares(cases, updates)
    shows, innovation = compared.jacobian[0] @ sensitivity, compared.innovation[0]
    precisions = np.linalg.inv([case.shown[0] + case.beside.variance[0] for case in cases])
    precision, gain = (np.tensordot(weights, part, 1) for part in (precisions, [update.gain[0] for update in updates]))
    weighed = shows.T @ precision
    bank = mix_possibilities(predicted.bank, cases, updates, weights[:, None], params)
    return (
        bank,
        sensitivity - gain @ shows,
        PoseEquations(weighed @ shows, weighed @ innovation, misfit, float(innovation.size)),
    )


def _possibility_shares(cases: list[Happened], updates: list[PoseUpdate]) -> tuple[Array, float]:
    """Computes probabilities of an interval's possibilities, (n_ways,), and the sample's chi-square misfit."""
    chance = np.log([case.chance for case in cases])
    each = chance + [update.likelihood[0] for update in updates]
    best = chance + [update.likelihood[0] + 0.5 * update.nis[0] for update in updates]  # of no innovation at all
    total = np.logaddexp.reduce(each)
    return np.exp(each - total), 2.0 * float(np.logaddexp.reduce(best) - total)
