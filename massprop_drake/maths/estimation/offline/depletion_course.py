"""Mass properties along a stretch while jets draw propellant from tanks, about its middle."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, columns
from massprop_drake.maths.estimation.offline.thrust_course import MiddleDerivatives, ThrustCourse, drawn_propellant
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT


def _parameters_at(at: Array, seconds: Array, model: FlightModel, more: Array | None = None) -> Array:
    """Computes the ten mass-property parameters at some jet on-times, tanks partly drained, shape (..., 10)."""
    places, tanks = columns(model), model.tanks
    flows = (tanks.feeds * model.flows) * (1.0 + at[places.flow])[:, None]
    both = (seconds * (1.0 + at[places.thrust])) @ flows.T
    left, coming = np.maximum(tanks.fill + at[places.fill] - both.sum(axis=-2), 0.0), both[..., 1, :]
    coming = coming if more is None else coming + more
    inertia, center, mass = np.linalg.inv(at[:6][ELEMENT]), at[CENTER], np.full(coming.shape[:-1], 1.0 / at[MASS])
    for tank, column in enumerate(tanks.columns):
        q = coming[..., tank]
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


def expand_about_middle(course: ThrustCourse, at: Array, model: FlightModel) -> tuple[ThrustCourse, Array]:
    """Converts a stretch and the unknowns to mass properties at its middle; without tanks both stay.

    Args:
        course: of the stretch.
        at: all unknowns, of the end of the flight, shape (n,).
        model: see `FlightModel`.
    """
    read = course.read
    stretch, n = read.stretch, model.tanks.fill.size
    if stretch.seconds is None or n == 0:
        return course, at
    places, row, given_s = columns(model), stretch.time_s.size // 2, stretch.seconds.copy()
    to_come_s = course.level * model.time_constants_s[read.on]  # what thrust that lags has still to give
    given_s[:, 0, read.on] -= to_come_s
    given_s[:, 1, read.on] += to_come_s
    seconds, middle = given_s[row], at.copy()
    middle[:N_PROPERTIES] = _parameters_at(at, seconds, model)
    size = np.zeros(at.size)
    size[:6], size[CENTER], size[MASS] = np.abs(at[:6]).max(), 1.0, at[MASS]
    size[places.thrust], size[places.flow], size[places.fill] = 1.0, 1.0, model.tanks.capacities
    by, slopes = np.zeros((N_PROPERTIES, at.size)), np.zeros((n, MASS, at.size))
    for unknown in np.flatnonzero(size).tolist():
        step = np.zeros(at.size)
        step[unknown] = _STEP * size[unknown]
        ahead, back = (_parameters_at(at + way * step, seconds, model) for way in (1.0, -1.0))
        by[:, unknown] = (ahead - back) / (2.0 * step[unknown])
        wide = np.sqrt(_STEP) * step / _STEP  # of a difference of differences
        further, nearer = (_derivatives_by_draw(at + way * wide, seconds, model) for way in (1.0, -1.0))
        slopes[:, :, unknown] = (further - nearer) / (2.0 * wide[unknown])
    within_s = 0.5 * (given_s[:-1] + given_s[1:])
    after_s = within_s[:, 1] - seconds[1]
    shifts = (_parameters_at(at, within_s, model) - middle[:N_PROPERTIES])[:, :MASS].T
    by_jets = (model.tanks.feeds * model.flows * (1.0 + at[places.flow])[:, None])[:, :, None] * after_s.T
    to_draw = np.einsum("kjm,j->km", by_jets, 1.0 + at[places.thrust])
    given = np.einsum("kj,j->j", model.tanks.feeds * (1.0 + at[places.flow])[:, None], 1.0 + at[places.thrust])
    drawn = (given_s[:, 1] - seconds[1]) @ (given * model.flows)
    cut = stretch._replace(used_after=stretch.used_after - drawn_propellant(stretch, model).sum(axis=0) + drawn)
    by_draw, through = _derivatives_by_draw(at, seconds, model), MiddleDerivatives(by, slopes, by_jets)
    moved = read._replace(stretch=cut, to_draw=to_draw, by_draw=by_draw, shifts=shifts, through=through)
    return course._replace(read=moved), middle


def _derivatives_by_draw(at: Array, seconds: Array, model: FlightModel) -> Array:
    """Computes derivatives of parameters 0 to 8 by propellant still to be drawn from tanks, (n_tanks, 9)."""
    slopes = np.empty((model.tanks.fill.size, MASS))
    for tank, capacity in enumerate(model.tanks.capacities.tolist()):
        more = np.zeros(slopes.shape[0])
        more[tank] = _STEP * capacity
        ahead, back = (_parameters_at(at, seconds, model, way * more) for way in (1.0, -1.0))
        slopes[tank] = (ahead - back)[:MASS] / (2.0 * more[tank])
    return slopes
