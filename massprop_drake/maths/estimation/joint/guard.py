"""When the estimates are good enough to act on, and when the start is over."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import CENTER, N_PROPERTIES, JointParams, JointState, flagged
from massprop_drake.maths.estimation.joint.prediction import parameter_effects
from massprop_drake.maths.estimation.joint.thrust_scale import partitioned, reported
from massprop_drake.maths.kernels import kernel

_SCALED = (0, 1, 2, 9)  # judged relative to their own size


@kernel
def converged(state: JointState, params: JointParams) -> bool:
    """Whether each judged parameter is known well enough, as `JointParams.guard_relative` and `guard_center` say."""
    properties, rows = reported(state, params)
    deviation = np.sqrt(np.sum(rows * rows, axis=1))
    for index, element in enumerate(_SCALED):
        limit = params.guard_relative[index]
        if np.isfinite(limit) and not deviation[element] < limit * properties[element]:
            return False
    return bool(np.all(deviation[CENTER] < params.guard_center))


@kernel
def guarded(state: JointState, commanded: bool, params: JointParams) -> JointState:
    """The state after the guard: it latches; when it first holds, thrust errors are freed, their scale taken off.

    Args:
        state: after the update.
        commanded: whether a jet was commanded in the interval.
        params: see `JointParams`.
    """
    if state.guarded:
        return flagged(state, True, state.freed, state.rescaled, state.firing_count + 1.0) if commanded else state
    if not converged(state, params):
        return state
    if params.places.n_thrust > 0 and not state.rescaled:
        state = partitioned(state, params)
    return flagged(state, True, True, state.rescaled, 1.0 if commanded else 0.0)


def knows_rotation(state: JointState, params: JointParams) -> bool:
    """Tests whether the effects of all jets on each rate are known as well as the guard asks of the inertia.

    With e the largest relative 1-sigma of a rate's row, products of errors are a share e of the row's own 1-sigma, in
    one sample as in a hundred: the covariance of such a row says what its readings may be off by.
    """
    effects = parameter_effects(state.mean, params.wrenches)[:3] @ state.root[:N_PROPERTIES]
    sigma = np.sqrt(np.sum(effects**2, axis=2)).max(axis=1, initial=0.0)
    largest = np.abs(effects_of(params.wrenches, state.mean)[:, :3]).max(axis=0, initial=0.0)
    return bool((sigma < params.guard_relative[:3] * largest).all())


def unguarded(state: JointState) -> JointState:
    """The state after a jump of the mass properties: guard, count and the freeing of thrust errors begin anew."""
    return state._replace(guarded=False, freed=False, firing_count=0.0)
