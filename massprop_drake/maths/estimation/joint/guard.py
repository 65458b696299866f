"""Conditions for estimates to be acted on, for rates to be judged by, and for the start to be over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import CENTER, N_PROPERTIES, JointParams, JointState, set_guard_status
from massprop_drake.maths.estimation.joint.process_noise import parameter_effects
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale
from massprop_drake.maths.kernels import kernel

_SCALED = (0, 1, 2, 9)  # judged relative to their own size
_SECOND_ORDER = 0.1  # sigmas by which products of errors may shift a prediction, 0.005 nats


@kernel
def is_converged(state: JointState, params: JointParams) -> bool:
    """Tests whether 1-sigmas of mass properties are below `JointParams.guard_relative` and `guard_center`."""
    properties, rows = parameters_with_scale(state, params)
    deviation = np.sqrt(np.sum(rows * rows, axis=1))
    for index, element in enumerate(_SCALED):
        limit = params.guard_relative[index]
        if np.isfinite(limit) and not deviation[element] < limit * properties[element]:
            return False
    return bool(np.all(deviation[CENTER] < params.guard_center))


@kernel
def update_guard(state: JointState, commanded: bool, params: JointParams) -> JointState:
    """Sets the convergence flag of the state once estimates have converged, then counts firing periods.

    Args:
        state: after the update.
        commanded: whether a jet was commanded in the interval.
    """
    if state.guarded:
        return set_guard_status(state, True, state.firing_count + 1.0 / params.rates.steps) if commanded else state
    if not is_converged(state, params):
        return state
    return set_guard_status(state, True, 1.0 if commanded else 0.0)


def knows_rotation(state: JointState, params: JointParams, jet_mask: NDArray[np.bool_] | None = None) -> bool:
    """Tests whether jets' effects on rates are known well enough for linear statistics of rates to hold.

    Rates are products of what is unknown: inverse inertia, and torque about the center of mass. With e the relative
    1-sigma of what the jets do to a rate, these products are off by e of the rate's own 1-sigma, in one sample as in a
    hundred. So linear statistics hold as far as e is small, however little is known of the mass, and of axes about
    which nothing turns the vehicle.

    Args:
        jet_mask: jets that turn the vehicle, shape (n_jets,); None: any may.
    """
    wrenches = params.wrenches if jet_mask is None else params.wrenches[jet_mask]
    effects = parameter_effects(state.mean, wrenches)[:3] @ state.root[:N_PROPERTIES]
    sigma = np.sqrt(np.sum(effects**2, axis=2)).max(axis=1, initial=0.0)
    largest = np.abs(effects_of(params.wrenches, state.mean)[:, :3]).max(axis=0, initial=0.0)
    return bool((sigma < _SECOND_ORDER * largest).all())


def reset_guard(state: JointState) -> JointState:
    """Returns the state with the convergence flag cleared and its count of firing periods zero."""
    return state._replace(guarded=False, firing_count=0.0)
