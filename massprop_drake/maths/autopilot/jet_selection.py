r"""Jet selection: activity vectors, and bursts of whole cycles from on-times; pulses are in `pulses`.

The activity vector of jet j (1-1) is the change of rate and velocity per second of its thrust,

    a_j = [ I^-1 (r_j x T_j) ; T_j / m ],    r_j = r'_j - r_cm,

and a request [dw; dv] is met by on-times t_j >= 0 with sum_j a_j t_j = [dw; dv] (1-2), (1-3). The
linear program itself stands in `massprop_drake.systems.autopilot.jet_selection_program`.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.autopilot.phase_space import Request, Urgency
from massprop_drake.maths.kernels import kernel, numbers
from massprop_drake.maths.linear_algebra import Array, has_nonzero, skew
from massprop_drake.maths.mass_properties import symmetric_matrix


def activity_vectors(wrenches: Array, mass_properties: Array) -> Array:
    """Computes each jet's angular and linear acceleration, its activity vector (1-1), shape (6, n_jets).

    Args:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        mass_properties: the ten parameters, shape (10,).
    """
    inverse_inertia = symmetric_matrix(mass_properties[:6])
    torque = wrenches[:, :3] - wrenches[:, 3:] @ skew(mass_properties[6:9]).T
    result = np.empty((6, wrenches.shape[0]))
    result[:3] = inverse_inertia @ torque.T
    result[3:] = wrenches[:, 3:].T * mass_properties[9]
    return result


def jet_forces(wrenches: Array) -> Array:
    """Returns each jet's force as a column, shape (3, n_jets); ``wrenches`` as in `activity_vectors`."""
    return np.ascontiguousarray(wrenches[:, 3:].T)


def least_cycles(minimum_s: Array, period_s: float) -> Array:
    """Rounds minimum on-times, s, up to whole control cycles, shape (n_jets,)."""
    cycles: Array = np.ceil(minimum_s / period_s - 1e-9)
    return cycles


def burst_cycles(on_times_s: Array, period_s: float, minimum: Array) -> Array:
    """Rounds on-times to the nearest whole cycles, those above zero to at least ``minimum``, shape (n_jets,).

    An on-time of at least half a cycle but below the jet's minimum is raised to it.

    Args:
        on_times_s: zero or positive, s, shape (n_jets,).
        minimum: see `least_cycles`, shape (n_jets,).
    """
    cycles = np.floor(on_times_s / period_s + 0.5)
    return np.where(cycles > 0.0, np.maximum(cycles, minimum), 0.0)


def least_change(request: Array, on_times_s: Array, shortest_s: Array | float) -> float:
    """Computes by how much a rate request that rounds to no firing must change to round to one, rad/s.

    On-times grow in proportion to a request, so the same direction needs, as a factor, the shortest on-time that is
    flown over that selected, of the jet that is nearest to it. Until some element of the rate change differs by the
    growth of its largest element, there is no point in asking again.

    Args:
        request: [dw; dv], shape (6,).
        on_times_s: the answer, all below those that are flown, s, shape (n_jets,).
        shortest_s: that are flown: half a control period where they are whole cycles, s, shape (n_jets,) or one.
    """
    longest = float((on_times_s / shortest_s).max())
    if longest == 0.0:
        return 0.0
    return float(np.abs(request[:3]).max()) * (1.0 / longest - 1.0)


@kernel
def must_select(
    remaining: Array, request: Request, refused_request: Array, has_known_force: bool, has_new_failure: bool
) -> bool:
    """Tests whether jet selection must run at a sample: urgent request, failure, or idle jets and a new request.

    Args:
        remaining: cycles that each jet has still to fire, shape (n_jets,).
        request: of the controller.
        refused_request: rate change of the last request if it rounded to no firing, and by how much it must change to
            be asked again, rad/s, shape (4,).
        has_known_force: whether a known force acts, which is to be undone.
        has_new_failure: whether a failure was declared in this cycle.
    """
    if has_new_failure or request.urgency == Urgency.AT_ONCE:
        return True
    if has_nonzero(remaining):
        return False
    if has_known_force:
        return True
    if request.urgency != Urgency.WHEN_IDLE:
        return False
    x, y, z = numbers(np.abs(request.rate_change - refused_request[:3]), 3)
    return max(x, y, z) >= refused_request[3]


@kernel
def delivered_velocity(command: Array, forces: Array, mass_reciprocal: float, period_s: float) -> Array:
    """Computes the change of velocity that a jet command gives in a sample, ft/s or m/s, shape (3,).

    Args:
        command: share of the sample for which each jet fires, shape (n_jets,).
        forces: of the jets, shape (3, n_jets).
        mass_reciprocal: 1/slug or 1/kg.
    """
    if not has_nonzero(command):
        return np.zeros(3)
    return (forces * mass_reciprocal) @ command * period_s
