"""True engines of a vehicle: their response to commands, failures included, and their readings."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import Seed, normal_sample
from massprop_drake.maths.vehicle.engine_thrust import (
    N_CHANNELS,
    N_ERRORS,
    EngineParams,
    follow_command,
    reading_std,
    thrust,
    wrenches_of,
)

OUT = -1  # in place of a channel: the engine gives nothing
_DIGITS_S = 1e-9  # arithmetic
_PARTS = 50  # compute budget: of an interval, at whose middles the force is taken


class EngineFailure(NamedTuple):
    """Failure of an engine.

    Attributes:
        engine: index of it.
        channel: of level and two angles the one that stays where it is; `OUT`.
        start_s, end_s: the first sample with it, and the first one without.
    """

    engine: int
    channel: int
    start_s: float
    end_s: float


class EnginesModel(NamedTuple):
    """True engines of a vehicle.

    Attributes:
        engines: as stated.
        errors: the six errors of each, shape (6 n,).
        spread: 1-sigma of what the seed adds to them, shape (6 n,).
        failures: see `EngineFailure`.
    """

    engines: EngineParams
    errors: Array
    spread: Array
    failures: tuple[EngineFailure, ...]


def draw_engine_errors(model: EnginesModel, seed: Seed) -> Array:
    """Draws the engines' errors of thrust, direction and place by a seed, six per engine, shape (6 n,)."""
    if not model.spread.any():
        return model.errors
    return np.asarray(model.errors + model.spread * normal_sample(seed, "engines", 0, model.errors.size))


def limit_to_stops(command: Array, engines: EngineParams) -> Array:
    """Clips engine commands to the range of throttle and gimbal, shape (n, 3)."""
    least = -engines.stops
    least[:, 0] = 0.0
    return np.asarray(np.clip(command, least, engines.stops))


def _is_active(failure: EngineFailure, time_s: float) -> bool:
    """Tests whether an engine failure lasts at a time, s, with a tolerance for rounding."""
    return failure.start_s - _DIGITS_S <= time_s < failure.end_s - _DIGITS_S


def effective_command(settings: Array, command: Array, time_s: float, model: EnginesModel) -> Array:
    """Returns the command that engines follow under failures, (n, 3): a stuck channel keeps its value.

    Args:
        settings: levels and angles, shape (n, 3).
        command: command, likewise.
        time_s: of the sample from which on it holds.
    """
    result = limit_to_stops(command, model.engines)
    for failure in model.failures:
        if failure.channel != OUT and _is_active(failure, time_s):
            result[failure.engine, failure.channel] = settings[failure.engine, failure.channel]
    return result


def engines_wrench(settings: Array, errors: Array, time_s: float, model: EnginesModel) -> Array:
    """Computes all engines' torque about the vehicle origin, force and flow, mean over ``settings`` at instants, (7,).

    Args:
        settings: levels and angles at some instants, shape (m, n, 3).
        errors: see `draw_engine_errors`.
        time_s: of the sample that has begun.
    """
    total, engines = np.zeros(7), model.engines
    out = {one.engine for one in model.failures if one.channel == OUT and _is_active(one, time_s)}
    for which in range(engines.thrusts.size):
        if which not in out:
            given = thrust(which, settings[:, which], errors[N_ERRORS * which : N_ERRORS * (which + 1)], engines)
            total[:6] += wrenches_of(given.place, given.force[:, None] * given.along).mean(axis=0)
            total[6] += np.interp(settings[:, which, 0], engines.levels, engines.flows[which]).mean()
    return total


def mean_wrench(
    settings: Array, command: Array, errors: Array, timing_s: tuple[float, float], model: EnginesModel
) -> Array:
    """Computes the engines' mean wrench and flow over an interval in which they follow a command, shape (7,).

    Args:
        settings: levels and angles at its start, shape (n, 3).
        command: what they follow, see `effective_command`.
        errors: see `draw_engine_errors`.
        timing_s: its start and its length, s.
    """
    since_s, duration_s = timing_s
    parts = (np.arange(_PARTS) + 0.5) / _PARTS * duration_s
    at = np.stack([follow_command(settings, command, float(part), model.engines)[0] for part in parts])
    return engines_wrench(at, errors, since_s, model)


def read_engines(settings: Array, command: Array, noise: Any, engines: EngineParams) -> Array:
    """Measures levels and gimbal angles, shape (n, 3); a channel without a sensor reads its command.

    Args:
        settings: as they are, shape (n, 3).
        command: command from now on.
        noise: standard normal, shape (n, 3).
    """
    shown = settings + reading_std(settings, engines) * noise
    return np.where(engines.measured.reshape(-1, 1) > 0.0, shown, limit_to_stops(command, engines))


def reshape_by_engine(vector: Array) -> Array:
    """Reshapes a vector of levels and gimbal angles to a row per engine, shape (n, 3)."""
    return np.asarray(vector).reshape(-1, N_CHANNELS)
