"""Mass properties along a stretch while jets draw propellant from tanks, about its middle."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, columns
from massprop_drake.maths.estimation.offline.thrust_course import MiddleDerivatives, ThrustCourse, drawn_propellant
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT


def _parameters_at(unknowns: Array, on_times_s: Array, model: FlightModel, extra_draw: Array | None = None) -> Array:
    """Computes the ten parameters as tanks drain, from jet on-times until a moment and after it, (..., 10)."""
    places, tanks = columns(model), model.tanks
    flows = (tanks.feeds * model.flows) * (1.0 + unknowns[places.flow])[:, None]
    both = (on_times_s * (1.0 + unknowns[places.thrust])) @ flows.T
    left, to_draw = np.maximum(tanks.fill + unknowns[places.fill] - both.sum(axis=-2), 0.0), both[..., 1, :]
    to_draw = to_draw if extra_draw is None else to_draw + extra_draw
    inertia, center, mass = (
        np.linalg.inv(unknowns[:6][ELEMENT]),
        unknowns[CENTER],
        np.full(to_draw.shape[:-1], 1.0 / unknowns[MASS]),
    )
    for tank, column in enumerate(tanks.columns):
        q = to_draw[..., tank]
        arm = tanks.outlets[tank] + column * (left[..., tank] + 0.5 * q)[..., None] - center
        whole = mass + q
        spread = tanks.spreads[tank] + (q * q / 12.0)[..., None, None] * _unit_mass_inertia(column)
        inertia = inertia + (q * mass / whole)[..., None, None] * _unit_mass_inertia(arm) + q[..., None, None] * spread
        center, mass = center + (q / whole)[..., None] * arm, whole
    inverse = np.linalg.inv(inertia)[..., _ROWS_OF, _COLUMNS_OF]
    return np.concatenate((inverse, center, (1.0 / mass)[..., None]), axis=-1)


_ROWS_OF, _COLUMNS_OF = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])  # of six elements


def _unit_mass_inertia(arm: Array) -> Array:
    """Computes |a|^2 1 - a a^T of each vector, the inertia of a unit mass there, shape (..., 3, 3)."""
    squares = np.sum(arm * arm, axis=-1)[..., None, None]
    return np.asarray(squares * np.eye(3) - arm[..., :, None] * arm[..., None, :])


_STEP = 1e-4  # arithmetic, relative: of central differences, which have half the digits


def expand_about_middle(thrust: ThrustCourse, unknowns: Array, model: FlightModel) -> tuple[ThrustCourse, Array]:
    """Converts unknowns and a stretch from the end of the flight to the stretch's middle; unchanged without tanks.

    Args:
        thrust: of the stretch.
        unknowns: all unknowns, of the end of the flight, shape (n,).
    """
    record = thrust.read
    stretch, n = record.stretch, model.tanks.fill.size
    if stretch.seconds is None or n == 0:
        return thrust, unknowns
    places, row, given_s = columns(model), stretch.time_s.size // 2, stretch.seconds.copy()
    to_come_s = thrust.level * model.time_constants_s[record.on]  # what thrust that lags has still to give
    given_s[:, 0, record.on] -= to_come_s
    given_s[:, 1, record.on] += to_come_s
    on_times_s, middle = given_s[row], unknowns.copy()
    middle[:N_PROPERTIES] = _parameters_at(unknowns, on_times_s, model)
    size = np.zeros(unknowns.size)
    size[:6], size[CENTER], size[MASS] = np.abs(unknowns[:6]).max(), 1.0, unknowns[MASS]
    size[places.thrust], size[places.flow], size[places.fill] = 1.0, 1.0, model.tanks.capacities
    by, slopes = np.zeros((N_PROPERTIES, unknowns.size)), np.zeros((n, MASS, unknowns.size))
    for unknown in np.flatnonzero(size).tolist():
        step = np.zeros(unknowns.size)
        step[unknown] = _STEP * size[unknown]
        ahead, back = (_parameters_at(unknowns + way * step, on_times_s, model) for way in (1.0, -1.0))
        by[:, unknown] = (ahead - back) / (2.0 * step[unknown])
        wide = np.sqrt(_STEP) * step / _STEP  # of a difference of differences
        further, nearer = (_derivatives_by_draw(unknowns + way * wide, on_times_s, model) for way in (1.0, -1.0))
        slopes[:, :, unknown] = (further - nearer) / (2.0 * wide[unknown])
    within_s = 0.5 * (given_s[:-1] + given_s[1:])
    after_s = within_s[:, 1] - on_times_s[1]
    shifts = (_parameters_at(unknowns, within_s, model) - middle[:N_PROPERTIES])[:, :MASS].T
    by_jets = (model.tanks.feeds * model.flows * (1.0 + unknowns[places.flow])[:, None])[:, :, None] * after_s.T
    to_draw = np.einsum("kjm,j->km", by_jets, 1.0 + unknowns[places.thrust])
    given = np.einsum(
        "kj,j->j", model.tanks.feeds * (1.0 + unknowns[places.flow])[:, None], 1.0 + unknowns[places.thrust]
    )
    drawn = (given_s[:, 1] - on_times_s[1]) @ (given * model.flows)
    cut = stretch._replace(used_after=stretch.used_after - drawn_propellant(stretch, model).sum(axis=0) + drawn)
    by_draw, through = _derivatives_by_draw(unknowns, on_times_s, model), MiddleDerivatives(by, slopes, by_jets)
    moved = record._replace(stretch=cut, to_draw=to_draw, by_draw=by_draw, shifts=shifts, through=through)
    return thrust._replace(read=moved), middle


def _derivatives_by_draw(unknowns: Array, on_times_s: Array, model: FlightModel) -> Array:
    """Computes derivatives of parameters 0 to 8 by propellant still to be drawn from tanks, (n_tanks, 9)."""
    slopes = np.empty((model.tanks.fill.size, MASS))
    for tank, capacity in enumerate(model.tanks.capacities.tolist()):
        extra_draw = np.zeros(slopes.shape[0])
        extra_draw[tank] = _STEP * capacity
        ahead, back = (_parameters_at(unknowns, on_times_s, model, way * extra_draw) for way in (1.0, -1.0))
        slopes[tank] = (ahead - back)[:MASS] / (2.0 * extra_draw[tank])
    return slopes
