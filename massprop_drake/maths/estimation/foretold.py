r"""Forecast of a flight: the joint filter's recursion along it, and how soon failures show.

The filter takes in what a flight without failures reads. A force of a jet that fails, constant from some time on, moves
its estimates: B and G are the error that a unit of each force has brought to the state, and the information about all
forces, by the recursion of `maths.maneuver.information`. A filter that does not know of the force f_j is beaten by one
that does by 1/2 f_j^2 G_jj in log likelihood, and one that takes another jet k for it, with the force that suits it
best, by 1/2 f_j^2 (G_jj - G_jk^2 / G_kk): both in the mean.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState
from massprop_drake.maths.estimation.joint.hypotheses import JUMP_SHARES, jump_sigma, without_increments
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.estimation.joint.sensitivity import (
    linearize_cycle,
    propagate_crossings,
    propagate_to_update,
    propagate_update,
)
from massprop_drake.maths.estimation.joint.start import OVER
from massprop_drake.maths.linear_algebra import Array


class Foretelling(NamedTuple):
    """Forecast up to a sample.

    Attributes:
        filter: state of the joint filter.
        carried: B, by a leak of each jet and a loss of each, per lbf or N, and by a large jump of the ten
            parameters, 1-sigma each, shape (size, p).
        shown: G, shape (p, p).
    """

    filter: JointFilterState
    carried: Array
    shown: Array


def begin_forecast(mass_properties: Array, params: JointFilterParams) -> tuple[Foretelling, JointFilterParams]:
    """Makes the initial forecast of fault information, and filter parameters without inflation or second order."""
    places, initial = params.joint.places, joint.initial_state(params)
    state = initial.joint._replace(mean=initial.joint.mean.copy(), guarded=True)
    state.mean[:N_PROPERTIES] = mass_properties
    pushes = 2 * places.jets + N_PROPERTIES
    carried_by = np.zeros((places.size, pushes))
    carried_by[:N_PROPERTIES, 2 * places.jets :] = np.diag(jump_sigma(params.joint, JUMP_SHARES[0]))
    linear = params._replace(joint=without_increments(params.joint)._replace(second_order=False))
    return Foretelling(initial._replace(joint=state, start=OVER), carried_by, np.zeros((pushes, pushes))), linear


def step(
    forecast: Foretelling,
    readings: tuple[Array, Array],
    commands: Told,
    params: JointFilterParams,
    *,
    failing: bool = False,
) -> Foretelling:
    """Advances the filter by a sample; if ``failing``, adds its information on leaks, losses and mass-property jumps.

    Args:
        readings: rates and velocities, NaN where missing, shape (s, 3) each.
        failing: whether jets leak from before the interval on.
    """
    measured = joint.step(forecast.filter, *readings, commands, params)
    report, sample = measured.evidence.report, measured.evidence.sample
    by_forces, shown = forecast.carried, forecast.shown
    if failing and report.course is not None:
        places, update = params.joint.places, report.course.update
        over = linearize_cycle(forecast.filter.joint, report, sample, params.joint)
        crossed = over.crossing_rows @ by_forces
        by_forces = propagate_crossings(by_forces, over, places)
        forcing = np.zeros((6, by_forces.shape[1]))
        forcing[:, : 2 * places.jets] = np.hstack((over.duration_s * over.effects.T, -over.amount * over.effects.T))
        by_forces = propagate_to_update(by_forces, forcing, over, places)
        shown = shown + crossed.T @ crossed
        counts = np.flatnonzero(report.used)
        if counts.size > 0:
            moved = over.jacobian @ by_forces
            seen = np.linalg.solve(update.upper.T, moved[counts])
            by_forces, shown = propagate_update(by_forces, moved, over), shown + seen.T @ seen
    return Foretelling(measured.state, by_forces, shown)
