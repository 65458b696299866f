"""Engines in the joint estimator: their impulse over an interval, and its derivatives.

Equations: theory page of the joint filter, "Engines"; `maths.vehicle.engine_thrust` has their force and its six
errors. Level and angles are taken at the start, middle and end of an interval; the middle is such that Simpson's rule
has their mean. Thrust that changes bows the rate; that is left out. Reading errors last from one reading to the next.
What is read as it is has moved at some time since the reading before: the mean may be off by a uniform share of the
move. What is not read any more stays where it was, and its error grows by as much as throttle or gimbal may have
moved; a command holds until there is another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.vehicle.engine_thrust import (
    N_CHANNELS,
    N_ERRORS,
    EngineParams,
    follow_command,
    reading_std,
    thrust,
    wrenches_of,
)

_UNIFORM = 1.0 / np.sqrt(12.0)  # arithmetic: 1-sigma of a share that may be anything from -1/2 to 1/2


class Burn(NamedTuple):
    """Levels and angles of the engines over an interval.

    Attributes:
        points: level and angles at its start, middle and end, rad, see the module, shape (n, 3, 3).
        std: 1-sigma by which they are off over the interval, shape (n, 3).
    """

    points: Array
    std: Array


@kernel
def shut_engine_burn(n: int) -> Burn:
    """Returns levels and gimbal angles, all zero, of n engines that are off over an interval."""
    return Burn(np.zeros((n, 3, N_CHANNELS)), np.zeros((n, N_CHANNELS)))


UNLIT = shut_engine_burn(0)


class EngineSettings(NamedTuple):
    """Levels and angles of the engines after a reading.

    Attributes:
        now: as they are, shape (n, 3).
        told: command that they follow from now on; where they are read as they are, the same, shape (n, 3).
        since_s: time since each was read, s; negative: never yet, so that it counts as shut, shape (n, 3).
    """

    now: Array
    told: Array
    since_s: Array


def shut_engine_settings(n: int) -> EngineSettings:
    """Returns the settings of n engines that are shut: zero levels and gimbal angles."""
    none = np.zeros((n, N_CHANNELS))
    return EngineSettings(none, none, none - 1.0)


def make_burn(
    settings: EngineSettings, reading: Array, duration_s: float, engines: EngineParams
) -> tuple[Burn, EngineSettings]:
    """Makes engine levels and gimbal angles over an interval from its two readings; returns them and settings after it.

    Args:
        settings: at the start of the interval.
        reading: at its end, NaN where missing, shape (n, 3).
    """
    measured, missing = engines.measured.reshape(-1, 1) > 0.0, np.isnan(reading)
    target = np.where(missing, settings.told, reading)
    target[:, 0] = np.where(target[:, 0] < engines.least, 0.0, target[:, 0])
    followed, mean = follow_command(settings.now, settings.told, duration_s, engines)
    end = np.where(measured, target, followed)
    middle = np.where(measured, 0.5 * (settings.now + end), 1.5 * mean - 0.25 * (settings.now + end))
    elapsed_s = np.where(settings.since_s < 0.0, settings.since_s, settings.since_s + duration_s)
    since_s = np.where(missing, elapsed_s, 0.0)
    lasting_s = np.where(measured, since_s, 0.0)  # a command holds until there is another
    moved = np.where(measured, np.abs(end - settings.now), 0.0)
    timing_std = _UNIFORM * moved * np.maximum(1.0 - moved / (engines.rates * duration_s), 0.0)
    reading_error = reading_std(0.5 * (settings.now + end), engines)
    std = np.sqrt(reading_error**2 + (engines.rates * np.maximum(lasting_s, 0.0)) ** 2 + timing_std**2)
    return Burn(np.stack((settings.now, middle, end), axis=1), std), EngineSettings(end, target, since_s)


class EngineImpulse(NamedTuple):
    """Impulse of the engines over an interval, about the vehicle origin.

    Attributes:
        impulse: angular and linear, shape (6,).
        by_errors: its derivative by the six errors of each engine, shape (6 n, 6).
        noise: 1-sigma by what level and angles are off, rows of independent impulses, shape (3 n, 6).
        used: propellant, slug or kg.
    """

    impulse: Array
    by_errors: Array
    noise: Array
    used: float


@kernel
def replace_untrusted_levels(burn: Burn, assumed: Array) -> Burn:
    """Returns engine levels and gimbal angles over an interval, with assumed values where readings are distrusted.

    Args:
        assumed: level and angles of each engine, NaN where readings are trusted, shape (3 n,).
    """
    if np.isnan(assumed).all():
        return burn
    points, std = burn.points.copy(), burn.std.copy()
    for place in range(assumed.shape[0]):
        if not np.isnan(assumed[place]):
            engine, channel = place // N_CHANNELS, place % N_CHANNELS
            points[engine, :, channel], std[engine, channel] = assumed[place], 0.0
    return Burn(points, std)


@kernel
def engine_impulse(burn: Burn, errors: Array, duration_s: float, engines: EngineParams) -> EngineImpulse:
    """Computes the engines' impulse about the vehicle origin over an interval, with its derivatives.

    Args:
        errors: the six of each engine, shape (6 n,).
    """
    n = engines.thrusts.shape[0]
    impulse, by_errors, noise, used = np.zeros(6), np.zeros((N_ERRORS * n, 6)), np.zeros((N_CHANNELS * n, 6)), 0.0
    for k in range(n):
        impulses, derivatives, full, flow = single_engine_impulses(
            k, burn.points[k], errors[N_ERRORS * k : N_ERRORS * (k + 1)], duration_s, engines
        )
        impulse += impulses[0]
        by_errors[N_ERRORS * k : N_ERRORS * (k + 1)] = derivatives[:, 0]
        noise[N_CHANNELS * k] = burn.std[k, 0] * full[0]
        noise[N_CHANNELS * k + 1] = burn.std[k, 1] * derivatives[2, 0]
        noise[N_CHANNELS * k + 2] = burn.std[k, 2] * derivatives[3, 0]
        used += flow[0]
    return EngineImpulse(impulse, by_errors, noise, used)


@kernel
def single_engine_impulses(
    engine: int, points: Array, errors: Array, duration_s: float, engines: EngineParams
) -> tuple[Array, Array, Array, Array]:
    """Computes impulses of one engine over m intervals, their derivatives, and the propellant used.

    Args:
        engine: index of the engine.
        points: level and angles at the start, middle and end of each interval, rad, shape (3 m, 3).
        errors: its six, shape (6,).

    Returns:
        The impulses, shape (m, 6), their derivatives by the errors, shape (6, m, 6), and by the level, shape (m, 6),
        and the propellant used, shape (m,).
    """
    produced, level, normals = thrust(engine, points, errors, engines), points[:, 0], engines.normals[engine]
    force, unit_force = produced.force.reshape(-1, 1), engines.thrusts[engine] * produced.along
    full = wrenches_of(produced.place, unit_force)
    by_error = np.zeros((N_ERRORS, points.shape[0], 6))
    by_error[0], by_error[1] = (level * (1.0 - level)).reshape(-1, 1) * full, (level * level).reshape(-1, 1) * full
    by_error[2] = wrenches_of(produced.place, force * produced.by_angles[0])
    by_error[3] = wrenches_of(produced.place, force * produced.by_angles[1])
    force_vectors = force * produced.along
    by_error[4, :, :3], by_error[5, :, :3] = force_vectors @ skew(normals[0]).T, force_vectors @ skew(normals[1]).T
    derivatives = np.empty((N_ERRORS, points.shape[0] // 3, 6))
    for error in range(N_ERRORS):
        derivatives[error] = _simpson_integrals(by_error[error], duration_s)
    flows = np.interp(level, engines.levels, engines.flows[engine]).reshape(-1, 1)
    used = _simpson_integrals(flows, duration_s).ravel()
    return (
        _simpson_integrals(wrenches_of(produced.place, force_vectors), duration_s),
        derivatives,
        _simpson_integrals(full, duration_s),
        used,
    )


@kernel
def _simpson_integrals(values: Array, duration_s: float) -> Array:
    """Integrates by Simpson's rule over m intervals, from values at three points of each, shape (m, k)."""
    return (values[0::3] + 4.0 * values[1::3] + values[2::3]) * (duration_s / 6.0)
