r"""Priors of faults: rates and distributions, all there are.

A hypothesis opens a jet's force f as N(0, T^2), T full thrust. The prior meant is a half full thrust, N(T, (3 %)^2),
and a half anything else: of a force that is too much log-uniform from a thousandth of T, of one that is missing
uniform. `force_correction` gives what the one is worth over the other, given the posterior of f.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.hypotheses import JUMP_SHARES
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.linear_algebra import Array

_HOUR_S = 3600.0
_FULL_SPREAD = 0.03  # of full thrust, 1 sigma: of a jet that is stuck
LEAST_LEAK = 1e-3  # of full thrust: a smaller leak is none
_FAIRLY = 0.2  # arithmetic: 1-sigma of a force when it is declared, of it; 0.1 or 0.3 changes its prior by 0.1 nats
_MOST = 1.05  # of full thrust: no jet gives more
_FAR = 30.0  # sigmas: from there on a normal tail by its asymptote
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)  # of a standard normal variable
_LOG_ROOT_2_PI = 0.5 * math.log(2.0 * math.pi)


class Priors(NamedTuple):
    """Rates and probabilities of faults before any reading.

    Attributes:
        jet_per_hour: failures of one jet.
        together: probability that a given other jet fails in the same interval as one.
        full_thrust: share of failures that are of full thrust: stuck on, or off.
        drifting: share of failures whose force grows slowly from nothing.
        change_per_hour: changes of a force that is known to be wrong.
        intermittent: share of failures whose force changes all the time.
        payload_per_hour: payloads that come or leave.
        reading_per_hour: readings of one component that begin to be wrong.
        unknown_per_hour: pushes that nothing known explains.
        disturbed: probability that something acts all along that nobody stated, and shows from some time on.
        start: probability, when something contradicts a start, that this was stated too well.
        false_per_hour: false declarations of one jet, or of anything else, that a user accepts.
    """

    jet_per_hour: float = 1e-3
    together: float = 1e-4
    full_thrust: float = 0.5
    drifting: float = 0.05
    change_per_hour: float = 10.0
    intermittent: float = 0.1
    payload_per_hour: float = 0.1
    reading_per_hour: float = 1e-3
    unknown_per_hour: float = 1e-4
    disturbed: float = 0.1
    start: float = 0.1
    false_per_hour: float = 1e-6

    @classmethod
    def stated(cls, faults: Any) -> Priors:
        """Makes the priors from a scenario's block `faults`."""
        return cls(*(getattr(faults, name) for name in cls._fields))

    def doubt(self, events_per_hour: float) -> float:
        """Returns the accepted probability of a false declaration of events with a given prior rate, at most 0.5."""
        return min(self.false_per_hour / events_per_hour, 0.5)


class Params(NamedTuple):
    """Parameters of the hypothesis filter.

    Attributes:
        joint: of the filter, without increments.
        allowed: 1 for each fault of a jet that there may be, more thrust and then less, shape (2 n_jets,).
        rates: failures per hour of each jet in terms of the usual rate, shape (n_jets,).
    """

    joint: JointParams
    priors: Priors
    allowed: Array
    rates: Array


def log_event_probability(events_per_hour: float, duration_s: float) -> float:
    """Computes the log prior probability of an event within a duration, nats."""
    return math.log(events_per_hour * duration_s / _HOUR_S)


def log_failure_probability(force: float, thrust: float, duration_s: float, priors: Priors, *, is_loss: bool) -> float:
    """Computes a jet failure's log prior within a time, for a force known to 20 %, over the filter's own prior, nats.

    It comes on top of what a force N(0, T^2) is worth.

    Args:
        force, thrust: f and T, lbf or N.
        duration_s: within which it fails.
        is_loss: whether the force is missing thrust, else excess thrust.
    """
    known = force_correction(force, _FAIRLY * force, thrust, priors, is_loss=is_loss)
    return log_event_probability(priors.jet_per_hour, duration_s) + known


def log_jump_probability(duration_s: float, priors: Priors) -> float:
    """Computes the log prior that mass properties jump within a time by a given one of the discrete sizes, nats."""
    return log_event_probability(priors.payload_per_hour, duration_s) - math.log(len(JUMP_SHARES))


def force_correction(
    force: float, sigma: float, thrust: float, priors: Priors, *, is_loss: bool, old_force: float | None = None
) -> float:
    """Computes the log ratio of a force's prior to a filter's N(old_force, T^2), averaged over its posterior, nats.

    Args:
        force, sigma: of the posterior, lbf or N.
        thrust: T.
        is_loss: whether the force is missing thrust, else excess thrust.
        old_force: before it changed, a third of all changes to nothing, a third to full thrust; None: it is new.
    """
    shares = (force + sigma * _NODES) / thrust
    opened_at = 0.0 if old_force is None else old_force / thrust
    opened = -0.5 * (shares - opened_at) ** 2 - _LOG_ROOT_2_PI
    if old_force is None:
        inside = (shares > LEAST_LEAK) & (shares < _MOST)
        spread = np.log(_MOST / LEAST_LEAK)
        uniform, log_uniform = 1.0 / (_MOST - LEAST_LEAK), 1.0 / (np.where(inside, shares, 1.0) * spread)
        density = np.where(inside, uniform if is_loss else log_uniform, 0.0)
        total = (1.0 - priors.full_thrust) * _mean_ratio(density, opened)
        peaks: tuple[tuple[float, float], ...] = ((1.0, priors.full_thrust),)
    else:
        density = np.where((shares > 0.0) & (shares < _MOST), 1.0 / _MOST, 0.0)
        total = _mean_ratio(density, opened) / 3.0
        peaks = ((1.0, 1.0 / 3.0), (0.0, 1.0 / 3.0))
    for at, share in peaks:
        total += share * _peak_ratio(at, opened_at, force / thrust, sigma / thrust)
    return math.log(total) if total > 0.0 else -math.inf


def log_feasible_force(force: float, sigma: float, thrust: float) -> float:
    """Computes the log probability that a force N(force, sigma^2) is between zero and a jet's largest, nats."""
    low, high = force / sigma, (_MOST * thrust - force) / sigma
    return _log_normal_cdf(low) + _log_normal_cdf(high)


def _log_normal_cdf(z: float) -> float:
    """Computes the log probability that a standard normal variable is below z."""
    if z > -_FAR:
        return math.log(0.5 * math.erfc(-z / math.sqrt(2.0)))
    return -0.5 * z**2 - _LOG_ROOT_2_PI - math.log(-z)


def _peak_ratio(peak: float, opening_mean: float, mean: float, sigma: float) -> float:
    """Approximates the mean over f ~ N(mean, sigma^2) of N(f; peak, 0.03^2) / N(f; opening_mean, 1), in thrusts."""
    spread = math.hypot(sigma, _FULL_SPREAD)
    there = (mean * _FULL_SPREAD**2 + peak * sigma**2) / spread**2
    return math.exp(-0.5 * ((mean - peak) / spread) ** 2 + 0.5 * (there - opening_mean) ** 2) / spread


def _mean_ratio(density: Array, log_reference: Array) -> float:
    """Computes the mean of density / exp(log_reference) over a posterior by quadrature, both given at its nodes."""
    weights, possible = _WEIGHTS / _WEIGHTS.sum(), density > 0.0
    return float(np.sum(weights * density * np.exp(np.where(possible, -log_reference, 0.0))))
