"""Motion that no jet explains, and readings off by a common factor: both without a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS
from massprop_drake.maths.estimation.offline.coupled_rates import (
    MeanRates,
    cumulative_sums,
    mean_rates,
    moments_about,
    turning_products,
)
from massprop_drake.maths.estimation.offline.expected_motion import ExpectedMotion, engine_impulses, stretch_motion
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.estimation.offline.motion_derivatives import wheel_derivatives
from massprop_drake.maths.linear_algebra import Array, cross_products
from massprop_drake.maths.mass_properties import ELEMENT


def unexplained_impulses(stretches: Sequence[Stretch], model: FlightModel) -> tuple[float, float]:
    """Computes the largest angular momentum and impulse that no thrusts or inertia explain.

    Args:
        stretches: of the flight, of at least two rows.
        model: see `FlightModel`; momentum and impulse are by its mass properties.

    Returns:
        In ft-lbf-s or N-m-s, and in lbf-s or N-s; zero where nothing is read.
    """
    turned, pushed = list[Array](), list[Array]()
    for stretch in stretches:
        motion, unknowns = stretch_motion(stretch, model.prior, model)
        read = motion.course.read
        means, n_jets = mean_rates(read.rate), model.flows.size
        by_jets = np.zeros((n_jets, read.late_s.size))
        by_jets[read.on] = cumulative_sums(motion.course.amount.T)
        products = cumulative_sums(means.square[np.triu_indices(3)])
        wheels = wheel_derivatives(motion, unknowns, model)[0].sum(axis=0)
        engines = (
            cumulative_sums(engine_impulses(read, unknowns, model)[0].T) if model.engines.thrusts.size else by_jets[:0]
        )
        turned.append(_subtract_means(np.vstack((by_jets, engines, products, read.rate - wheels))).T)
        pushed += _velocity_columns(motion, means, model)
    inertia, mass = np.linalg.inv(model.prior[:6][ELEMENT]), 1.0 / model.prior[MASS]
    rates = _fit_residuals(turned, 3)
    momentum = float(np.linalg.norm(rates @ inertia, axis=1).max(initial=0.0))
    return momentum, mass * float(np.abs(_fit_residuals(pushed, 1)).max(initial=0.0))


def _velocity_columns(motion: ExpectedMotion, means: MeanRates, model: FlightModel) -> list[Array]:
    """Returns regressors and accelerometer velocity per component, rotation effects subtracted.

    Returns:
        For each component with two readings at least, means taken off: derivatives by the center of mass, by the thrust
        of each jet, and by each bias, and what is read; shape (r, k + 1).
    """
    read, n_jets = motion.course.read, model.flows.size
    turn = turning_products(read.rate, means, np.zeros_like(means.square), read.period_s)
    given = cumulative_sums((motion.course.amount * motion.lightness[:, None]).T)
    since_s, found = read.stretch.time_s - read.stretch.time_s[0], []
    impulses, _ = engine_impulses(read, model.prior, model)
    burnt = cumulative_sums((impulses[:, 3:] * motion.lightness[:, None]).T)
    for package in range(model.gyros, read.readings.shape[0]):
        arm, number = model.positions[package - model.gyros] - model.prior[CENTER], package - model.gyros
        for axis in range(3):
            there = np.flatnonzero(~np.isnan(read.readings[package, axis]))
            if there.size < 2:
                continue
            own = np.zeros((3 + n_jets + 3 * model.positions.shape[0] + 2, there.size))
            own[:3] = -turn[:, axis, there]
            own[3 + read.on] = model.wrenches[read.on, 3 + axis, None] * given[:, there]
            own[3 + n_jets + 3 * number + axis] = since_s[there]
            own[-2] = burnt[axis, there]
            own[-1] = read.readings[package, axis, there] - arm @ turn[:, axis, there]
            found.append(_subtract_means(own).T)
    return found


def _subtract_means(rows: Array) -> Array:
    """Subtracts each row's mean over its columns, shape (k, n)."""
    return rows - rows.mean(axis=1, keepdims=True)


def _fit_residuals(parts: Sequence[Array], n_outputs: int) -> Array:
    """Computes residuals of the last ``n_outputs`` columns regressed on the others, (n, n_outputs)."""
    if not parts:
        return np.zeros((0, n_outputs))
    together = np.vstack(parts)
    design, wanted = together[:, :-n_outputs], together[:, -n_outputs:]
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return wanted - design / size @ np.linalg.lstsq(design / size, wanted, rcond=None)[0]


_SPANS = (1, 4, 16, 64)  # rows over which gains are compared: the shortest over which enough of them are clear
_CLEAR = 7.0  # 1-sigma of a reading, two quanta and more, that jets must give over a span
_FEWEST = 10  # spans whose median is told


def gain_ratios(stretches: Sequence[Stretch], unknowns: Array, model: FlightModel) -> Array:
    """Computes medians of measured over predicted changes of each package's readings, (n_packages,).

    Args:
        stretches: of the flight.
        unknowns: all unknowns, shape (n,); see `possible`.

    Returns:
        NaN where readings tell too little, shape (n_packages,).
    """
    pairs = [list(_readings_and_expected(stretch, unknowns, model)) for stretch in stretches]
    found = np.full(model.variances.shape[0], np.nan)
    for package, variance in enumerate(model.variances.tolist()):
        for span in _SPANS:
            gained = [[np.diff(part[::span], axis=0) for part in own[package]] for own in pairs]
            nothing = np.zeros((2, 0, 3))
            read, given = (np.concatenate(part) for part in zip(*gained, strict=True)) if gained else nothing
            size = np.sum(given**2, axis=1)
            clear = size > _CLEAR**2 * variance
            if clear.sum() >= _FEWEST:
                found[package] = np.median(np.sum(read[clear] * given[clear], axis=1) / size[clear])
                break
    return found


def _readings_and_expected(stretch: Stretch, unknowns: Array, model: FlightModel) -> Iterator[tuple[Array, Array]]:
    """Yields each package's readings, and those predicted from impulses without coupling, shape (m, 3) each."""
    motion, unknowns = stretch_motion(stretch, unknowns, model)
    impulse = motion.sums.impulse
    turned = unknowns[:6][ELEMENT] @ moments_about(impulse, unknowns[CENTER])
    for package, readings in enumerate(motion.course.read.readings):
        given = turned
        if package >= model.gyros:
            arm = model.positions[package - model.gyros] - unknowns[CENTER]
            given = impulse[3:] * motion.lightness + cross_products(turned.T, np.broadcast_to(arm, turned.T.shape)).T
        there = ~np.isnan(readings).any(axis=0)
        yield readings[:, there].T, cumulative_sums(given)[:, there].T
