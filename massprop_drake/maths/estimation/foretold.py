r"""Forecast of a flight: the joint filter's recursion at the truth, and how soon failures show.

Covariances go over as in `joint.bound`, by the readings that there will be. A force f of a jet that fails, constant
from some time on, moves the rate and what accelerometers gather; what the filter makes of it moves its estimates. With
B the error that a unit of each force has brought to the state, F and H the derivatives of prediction and outputs, K the
gain and S the covariance of innovations,

    B <- (1 - K H)(F B + g),    G <- G + (H (F B + g))^T S^-1 (H (F B + g)),

g is what a unit of each force does in the interval. G is the information about all the forces at once. A filter that
does not know of the force f_j is beaten by one that does by 1/2 f_j^2 G_jj in log likelihood, and one that takes
another jet k for it, with the force that suits it best, by 1/2 f_j^2 (G_jj - G_jk^2 / G_kk): both in the mean.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState, initial, sampled
from massprop_drake.maths.estimation.joint import bound
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import readings
from massprop_drake.maths.linear_algebra import Array


class Instant(NamedTuple):
    """The vehicle at a sample, as it is taken to be.

    Attributes:
        properties: the ten parameters, shape (10,).
        rate: rad/s, shape (3,).
        propellant: in tanks, slug or kg, shape (n_tanks,).
    """

    properties: Array
    rate: Array
    propellant: Array


class Foretelling(NamedTuple):
    """Forecast up to a sample.

    Attributes:
        filter: state of the joint filter, its `joint` at the truth.
        carried: B, by a leak of each jet, per lbf or N, shape (size, n_jets).
        shown: G, shape (n_jets, n_jets).
    """

    filter: JointFilterState
    carried: Array
    shown: Array


def begun(params: JointFilterParams) -> Foretelling:
    """Forecast before the first sample."""
    places = params.joint.places
    return Foretelling(initial(params), np.zeros((places.size, places.jets)), np.zeros((places.jets, places.jets)))


def step(
    before: Foretelling,
    read: tuple[Array, Array],
    told: Told,
    at: Instant,
    params: JointFilterParams,
    *,
    failing: bool = False,
) -> Foretelling:
    """Forecast after one more sample.

    Args:
        before: the forecast up to then.
        read: rates and velocities, NaN where there will be no reading, else of no meaning but for the rates, which are
            the true ones, shape (s, 3) each.
        told: see `Told`.
        at: see `Instant`.
        params: see `JointFilterParams`.
        failing: whether jets leak from before the interval on.
    """
    own, joint = before.filter, params.joint
    clock, sample, anew, (speeds, setting) = sampled(own, read, told, params)
    mean = _mean(own.joint, at, joint)
    carried, shown = before.carried, before.shown
    if anew or not own.joint.started:
        after = bound.begun_at(own.joint, sample, mean, joint)
    else:
        used = ~np.isnan(readings(sample.rates, sample.velocities, sample.attitudes))
        after, course = bound.course(own.joint, sample, mean, used, joint)
        if failing:
            carried, shown = bound.carried_on(
                (carried, shown), own.joint, course, bound.leaks(joint.places.jets), joint
            )
    kept = {"clock": clock, "frame": sample.frames[1], "speeds": speeds, "setting": setting}
    return Foretelling(own._replace(joint=after, **kept), carried, shown)


def _mean(state: JointState, at: Instant, params: JointParams) -> Array:
    """The state's mean at a sample: as before, but for what is known to change."""
    mean, places = state.mean.copy(), params.places
    mean[:N_PROPERTIES], mean[RATE] = at.properties, at.rate
    mean[places.fill : places.fill + places.tanks] = at.propellant
    return mean
