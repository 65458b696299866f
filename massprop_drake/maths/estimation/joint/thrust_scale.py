"""Common scale of all thrusts, separated when jets first fire.

Equations: theory page of the joint filter, "Thrust errors and their scale"; forces of failures have f' = f (1 -
sigma_T s). At the change no thrust error has been estimated, b^ = 0, so only errors are mapped; before, s has none.
What is reported is J = J' (1 - sigma_T s) and mu likewise, f = f' (1 + sigma_T s).
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.layout import (
    INERTIA,
    MASS,
    N_PROPERTIES,
    JointParams,
    JointState,
    replace_estimate,
)
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array


@kernel
def separate_scale(state: JointState, seconds: Array, params: JointParams) -> JointState:
    """Returns the state with the thrusts' common scale error split off as a variable s, once jets first fire.

    Args:
        seconds: of each jet's firing in the interval, shape (n_jets,).
    """
    places, fires = params.places, seconds > 0.0
    if places.n_scale == 0 or not fires.any() or state.root[places.scale].any():
        return state
    root = state.root.copy()
    thrusts = slice(places.thrust, places.thrust + places.n_thrust)
    common = fires.astype(np.float64) @ root[thrusts] / float(fires.sum())
    root[places.scale] = common
    root[thrusts] -= common
    root[INERTIA] += np.outer(params.thrust_sigma * state.mean[INERTIA], common)
    root[MASS] += params.thrust_sigma * state.mean[MASS] * common
    for slot in range(places.n_force):
        root[places.force + slot] -= params.thrust_sigma * state.mean[places.force + slot] * common
    return replace_estimate(state, state.mean, compress_root(root, places.thrust))


@kernel
def parameters_with_scale(state: JointState, params: JointParams) -> tuple[Array, Array]:
    """Returns the ten mass parameters with the thrust scale applied, shape (10,), and root rows, shape (10, size)."""
    properties, rows = state.mean[:N_PROPERTIES].copy(), state.root[:N_PROPERTIES].copy()
    if params.places.n_scale > 0:
        factor = 1.0 - params.thrust_sigma * state.mean[params.places.scale]
        of_scale = params.thrust_sigma * state.root[params.places.scale]
        for element in range(N_PROPERTIES):
            if element < INERTIA.stop or element == MASS:
                rows[element] = factor * rows[element] - properties[element] * of_scale
                properties[element] *= factor
    return properties, rows


def force_with_scale(state: JointState, slot: int, params: JointParams) -> tuple[float, float]:
    """Returns the force in a slot of failed jets with the thrust scale applied, and its 1-sigma, lbf or N."""
    row = params.places.force + slot
    force, root = float(state.mean[row]), state.root[row]
    if params.places.n_scale > 0:
        factor = 1.0 + params.thrust_sigma * float(state.mean[params.places.scale])
        root = factor * root + force * params.thrust_sigma * state.root[params.places.scale]
        force *= factor
    return force, float(np.sqrt(root @ root))
