"""Rotations by torque alone, without net force, through the rotation filter: what they teach of the center of mass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters import rotation_filter
from massprop_drake.maths.estimation.filters.rate_increments import rate_increment
from massprop_drake.maths.estimation.filters.rotation_filter import RotationParams, RotationSample, RotationState
from reproduction.measures import CENTER, DIAGONAL, orbiter

Array = NDArray[np.float64]

_JETS = 3  # that fire together


def pure_rotations(seed: int) -> dict[str, Array]:
    """Runs 200 samples of jets that fire in threes, their torques kept and their net force taken away.

    Returns:
        - `center`: largest change of the error of the center of mass from its first value, over the run, %, shape (1,).
        - `center_std`: its 1-sigma at the end over that at the start, each component, shape (3,).
        - `diagonal`, `diagonal_extended`: largest error of the diagonal at the end, second-order and extended filter,
          %, shape (1,).
    """
    return rotations(seed, force=0.0)


def rotations(seed: int, *, force: float, samples: int = 200) -> dict[str, Array]:
    """Runs samples of jets that fire in threes through the filters, with a share of their net force kept."""
    random = np.random.default_rng([seed, 16])
    impulses = _impulses(random, force, samples)
    measured = _increments(impulses, random)
    truth = orbiter().nominal.vector()[:9]
    second, extended = (_run(impulses, measured, name) for name in ("second_order", "extended"))
    errors = 100.0 * np.abs(truth - second[0]) / np.abs(truth)
    ends = 100.0 * np.abs(truth - extended[0][-1]) / np.abs(truth)
    return {
        "center": np.array([np.abs(errors[:, CENTER] - errors[0, CENTER]).max()]),
        "center_std": second[1][-1, CENTER] / second[1][0, CENTER],
        "diagonal": np.array([errors[-1, DIAGONAL].max()]),
        "diagonal_extended": np.array([ends[DIAGONAL].max()]),
    }


def initial_state() -> RotationState:
    """Returns the rotation filter's initial state: estimates of zero with 100 % uncertainty."""
    return RotationState(np.zeros(9), np.diag(orbiter().nominal.vector()[:9] ** 2))


def update_filter(state: RotationState, increment: Array, impulse: Array, params: RotationParams) -> RotationState:
    """Updates the rotation filter with a rate increment caused by an impulse about the origin, shape (6,)."""
    variance = orbiter().gyros[0].variance
    angular, linear = np.split(impulse, 2)
    noise = 2.0 * variance * np.eye(3)
    sample = RotationSample(increment, np.zeros(3), noise, variance, angular, linear, firing=True)
    innovation = rotation_filter.innovate(state, sample, False, params)
    return rotation_filter.update(state, sample, innovation, NO_ADAPTATION, params).state


def _impulses(random: np.random.Generator, force_share: float, samples: int) -> Array:
    """Draws each sample's angular impulse about the vehicle origin and linear impulse, shape (n, 6)."""
    vehicle = orbiter()
    primary = [index for index, jet in enumerate(vehicle.jets) if jet.kind == "primary"]
    jets = np.array([random.choice(primary, _JETS, replace=False) for _ in range(samples)])
    angular, linear = np.split(vehicle.sample_period_s * vehicle.wrenches[jets].sum(axis=1), 2, axis=1)
    center = vehicle.nominal.center_of_mass
    about_center = angular - np.cross(center, linear)
    linear = force_share * linear
    return np.hstack([about_center + np.cross(center, linear), linear])


def _increments(impulses: Array, random: np.random.Generator) -> Array:
    """Computes differences of the quantized rates, rad/s, shape (n, 3); dynamic coupling is left out."""
    truth, quantum = orbiter().nominal.vector()[:9], orbiter().gyros[0].quantum
    exact = [rate_increment(truth, *np.split(impulse, 2)) for impulse in impulses]
    rates = np.vstack([np.zeros(3), np.cumsum(exact, axis=0)])
    result: Array = np.diff(quantum * np.floor(rates / quantum + random.uniform(size=3)), axis=0)
    return result


def _run(impulses: Array, increments: Array, filter_name: str) -> tuple[Array, Array]:
    """Returns estimates and 1-sigmas from zero, at the start and after each sample, shape (n + 1, 9)."""
    settings = ["rotation.jump=none", "rotation.coupling=ignore", f"rotation.filter={filter_name}"]
    rotation_params = params.thesis_params(load_scenario("sample_maneuver", settings)).rotation
    states = [initial_state()]
    for impulse, increment in zip(impulses, increments, strict=True):
        states.append(update_filter(states[-1], increment, impulse, rotation_params))
    return np.array([s.estimate for s in states]), np.sqrt([s.covariance.diagonal() for s in states])
