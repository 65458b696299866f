"""Parameters, states and samples of the joint estimator for tests, of a small invented vehicle."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from massprop_drake.maths.estimation.joint import ticks
from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import AttitudeSensors, JointParams, JointState, make_places
from massprop_drake.maths.estimation.joint.prediction import ALONE, predict, propagate_root
from massprop_drake.maths.estimation.joint.rate_coupling import RateRead
from massprop_drake.maths.estimation.joint.ticks import Clock, Commanded, Elapsed, Pace, timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import Spun
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import six_elements
from massprop_drake.maths.vehicle.on_times import level_onsets

PERIOD = 0.1  # s
INVERSE = np.linalg.inv(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]))
TRUTH = np.concatenate([six_elements(INVERSE), [0.05, -0.03, 0.02, 0.1]])
POSITIONS = np.array([[1.0, 0.2, 0], [-1, 0, 0.3], [0, 1, -0.1], [0.2, -1, 0], [0, 0.1, 1], [0.3, 0, -1]])
_FORCES = np.array([[0, 1.0, 0.2], [0.1, 0, 1], [1, 0, 0.1], [0.2, 0.3, -1], [-1, 0.2, 0], [0.4, -1, 0]])


def elapsed(clock: Clock, stamp_s: float, levels: tuple[Array, Array | None], pace: Pace) -> tuple[Clock, Elapsed]:
    """`ticks.measure_interval` of commands that are levels."""
    before, coming = (None if one is None else Commanded(one, level_onsets(one.size)) for one in levels)
    assert before is not None
    return ticks.measure_interval(clock, stamp_s, (before, coming), pace)


def derivatives(
    state: JointState, sample: JointSample, params: JointParams, around: tuple[Array, Spun] = ALONE
) -> tuple[Array, Array]:
    """Derivative of the predicted state by the state: as the covariance goes over, and by central differences."""

    def after(mean: Array) -> Array:
        there = state._replace(mean=mean)
        return predict(there, estimate_forces(there, sample, params), unread(params), params, around).mean

    expected = central_differences(after, state.mean, 1e-4 * np.maximum(np.abs(state.mean), 1e-2))
    prediction = predict(state, estimate_forces(state, sample, params), unread(params), params, around)
    return propagate_root(np.eye(params.places.size), prediction, params)[:, : params.places.size], expected


def small_params(**changed: Any) -> JointParams:
    """Six jets of two kinds, two gyros and two accelerometers, every kind of parameter, two slots."""
    settings: dict[str, Any] = {
        "places": make_places((6, 2, 2), 2, (True, True), True, 2, ticks=2),
        "wrenches": np.hstack([np.cross(POSITIONS, _FORCES), _FORCES]),
        "thrusts": np.linalg.norm(_FORCES, axis=1),
        "flows": np.full(6, 0.01),
        "time_constants_s": np.array([0.015, 0.015, 0.015, 0.03, 0.03, 0.03]),
        "kinds": np.array([0, 0, 0, 1, 1, 1]),
        "thrust_sigma": 0.01,
        "lag_sigma": 0.2,
        "gyro_bias_sigma": 1e-5,
        "acceleration_bias_sigma": 1e-3,
        "prior_sigma": np.append(np.ones(6 + 2 + 6 + 6), np.zeros(1 + 2 + 2)),
        "rate_walk": 0.0,
        "velocity_walk": 0.0,
        "repeatability": np.zeros(6),
        "tank_fraction": 0.0,
        "tick_sigma": PERIOD * np.array([0.01, 1e-3]),
        "arm": 1.0,
        "accelerometer_positions": np.array([[0.3, 0.1, -0.2], [-0.4, 0.2, 0.1]]),
        "variances": np.array([1e-10] * 3 + [2e-10] * 3 + [1e-8] * 6),
        "quanta": np.zeros(12),
        "start": TRUTH,
        "start_root": np.diag(np.abs(TRUTH) * 0.1),
        "increment_sigma": np.abs(TRUTH),
        "nominal": TRUTH,
        "thresholds": chi2.isf(1.5e-5, np.arange(1, 7)),
        "guard_relative": np.array([0.02, 0.02, 0.02, 0.2]),
        "guard_center": np.full(3, 0.03),
        "settled_after": 60.0,
        "second_order": True,
        "trackers": AttitudeSensors(*np.zeros((3, 0))),
        "disturbance": NO_DISTURBANCE,
    }
    settings |= changed
    variances = settings["variances"]
    noisy = {"cells": np.zeros_like(variances), "floors": variances, "dithered": np.ones_like(variances)}
    return JointParams(**(noisy | settings))


def unrounded(params: JointParams) -> JointParams:
    """The parameters with readings whose errors are Gaussian: every one counts, and updates are linear."""
    noisy = {"quanta": np.zeros_like(params.quanta), "cells": np.zeros_like(params.cells)}
    return params._replace(**noisy, floors=params.variances, dithered=np.ones_like(params.dithered))


def some_state(params: JointParams, seed: int = 0) -> JointState:
    """A state in flight: errors of all kinds, correlated, jets half built up, two slots taken."""
    rng = np.random.default_rng(seed)
    state, places = initial_joint_state(params), params.places
    mean = 0.3 * rng.standard_normal(places.size)
    mean[:10] = params.start
    mean[10:13] = [0.02, -0.03, 0.01]
    if places.n_force:
        mean[places.force :] = [0.1, 0.3]
    scale = np.maximum(np.abs(mean), 1e-6) * 1e-3
    return state._replace(
        mean=mean,
        root=scale[:, None] * rng.standard_normal((places.size, places.size)) / np.sqrt(places.size),
        level=rng.uniform(size=6),
        reference=np.array([0.001, 0.002, -0.003]),
        spin=1e-4 * np.abs(rng.standard_normal(6)),
        tick_slope=rng.standard_normal((2, 6)),
        slot_jet=np.array([1.0, 4.0])[: places.n_force],
        slot_sign=np.array([1.0, -1.0])[: places.n_force],
        started=True,
    )


def some_sample(params: JointParams, **changed: Any) -> JointSample:
    """A sample of one piece, three jets on, nothing read."""
    unread = (np.full((n, 3), np.nan) for n in (params.places.gyros, params.places.accelerometers))
    fired = np.array([[1.0, 0, 1, 0, 0, 1]])
    return JointSample(PERIOD, np.array([PERIOD]), fired, np.zeros(6), *unread, timing_on_ticks())._replace(**changed)


def read_as(rate: Array, params: JointParams) -> RateRead:
    """A rate read without biases."""
    return RateRead(rate, np.zeros((3, params.places.size)), np.zeros(3))


def unread(params: JointParams) -> RateRead:
    """No rate read."""
    return read_as(np.full(3, np.nan), params)


def central_differences(function: Any, at: Array, steps: Array) -> Array:
    """The Jacobian of a vector function, one column per element of its argument."""
    columns = []
    for index, step in enumerate(steps):
        shift = np.zeros(at.size)
        shift[index] = step
        columns.append((function(at + shift) - function(at - shift)) / (2.0 * step))
    return np.array(columns).T
