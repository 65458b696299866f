"""Sensors as systems: rate gyro, integrating accelerometer and trackers, with their errors in the context."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import PERFECT_SENSOR
from systems_probe import PERIOD_S, feedthrough, give, inputs, output, outputs, sample

from massprop_drake import InputError
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.rigid_body import N_STATE, ORIGIN_VELOCITY, POSITION, QUATERNION, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import Tone, make_vibration, point_velocity, sense
from massprop_drake.maths.vehicle.tracking import PoseModel
from massprop_drake.systems import IntegratingAccelerometer, PoseTracker, RateGyro, VelocityTracker

PLACE = np.array([2.0, -1.0, 0.5])
SHAKEN = make_vibration(
    [Tone(0.2 / PERIOD_S, np.array([1.0, 0.0, -2.0]), np.zeros(3))], np.ones(3), None, integrates=False
)
PHASE = {"quantum": 0.1, "phase": np.array([0.25, -0.1, 0.4])}


def made(kind: Any, **errors: Any) -> Any:
    place = {} if kind is RateGyro else {"position": PLACE}
    return kind("package", PERFECT_SENSOR._replace(integrates=kind is not RateGyro, **errors), **place)


def signal(kind: Any, body: Array) -> Array:
    """Readings of an ideal package; the rest of the body must not matter."""
    if kind is RateGyro:
        return body[RATE]
    return point_velocity(body[ORIGIN_VELOCITY], body[RATE], body[SPIN_INTEGRAL], PLACE)


@pytest.mark.parametrize("kind", [RateGyro, IntegratingAccelerometer])
@pytest.mark.parametrize(
    "errors",
    [
        {"limit": 0.4, **PHASE},
        {"scale_factor": np.array([0.01, -0.02, 0.0]), "noise_std": 0.01, **PHASE},
        {"bias": np.array([0.5, 0.0, -0.5]), "delay": 2, "walk_std": 0.1, "limit": 1.0},
        {"smoothing": 0.6, "vibration": SHAKEN, "bias": np.ones(3)},
    ],
)
def test_a_package_reads_what_its_mathematics_say(kind: Any, errors: dict[str, Any]) -> None:
    dut, random = made(kind, **errors), np.random.default_rng(1)
    model, context = PERFECT_SENSOR._replace(integrates=kind is not RateGyro, **errors), dut.CreateDefaultContext()
    assert inputs(dut) == {"body_state": N_STATE, "noise": 6}
    assert outputs(dut) == {"reading": 3}
    # noise is no input of a sensor without any, and may stay unconnected
    assert feedthrough(dut) == {"reading": {"body_state", *(["noise"] if model.noisy else [])}}
    assert context.num_discrete_state_groups() == model.remembers
    memory = np.zeros(model.memory_size)
    for number in range(5):
        body, noise = random.standard_normal(N_STATE), random.standard_normal(6)
        give(dut, context, body_state=body, **({"noise": noise} if model.noisy else {}))
        expected, memory = sense(signal(kind, body), memory, noise, model, number * PERIOD_S)
        assert_allclose(sample(dut, context, "reading"), expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("kind", [RateGyro, IntegratingAccelerometer])
def test_errors_are_those_of_the_context(kind: Any) -> None:
    dut, body = made(kind), np.zeros(N_STATE)
    context = dut.CreateDefaultContext()
    body[RATE if kind is RateGyro else ORIGIN_VELOCITY] = [0.11, -0.28, 0.4]
    give(dut, context, body_state=body)
    for errors, expected in (
        ({"scale_factor_x": 1.0}, [0.22, -0.28, 0.4]),
        ({"scale_factor_x": 0.0, "quantum": 0.1}, [0.1, -0.3, 0.4]),
        ({"phase": [0.25, 0.25, 0.25]}, [0.075, -0.325, 0.375]),
        ({"quantum": 0.0, "limit": 0.3}, [0.11, -0.28, 0.3]),
        *([({"bias": [0.0, 0.0, -0.2]}, [0.11, -0.28, 0.2])] if kind is RateGyro else []),
    ):
        dut.parameters.set(context, **errors)
        assert_allclose(output(dut, context, "reading"), expected, rtol=1e-14)
    for errors, message in (({"noise_std": 0.1}, "has no noise: build it"), ({"walk_std": 0.1}, "has no noise")):
        dut.parameters.set(context, **errors)
        with pytest.raises(InputError, match=f"sensor 'package' {message}"):
            output(dut, context, "reading")
    if kind is IntegratingAccelerometer:
        dut.parameters.set(context, noise_std=0.0, walk_std=0.0, bias_x=0.1)
        with pytest.raises(InputError, match="sensor 'package' has no memory: build it with a bias or a walk_std"):
            output(dut, context, "reading")


MODEL = PoseModel(np.array([0.2, 0.0, 0.0]), 0.01, 0.02, 0.0, 0.0, planar=False)
AT = [1.21, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("dut", "time_s", "expected"),
    [
        (PoseTracker("cam", MODEL), 0.1, AT),
        (PoseTracker("cam", MODEL._replace(rate_hz=4.0, period_s=0.1)), 0.1, [np.nan] * 7),
        (PoseTracker("cam", MODEL._replace(rate_hz=4.0, period_s=0.1)), 0.3, AT),
        (VelocityTracker("cam", position=np.array([0.2, 0.0, 0.0]), noise_std=0.1), 0.1, [0.1, 0.0, 0.0]),
    ],
)
def test_a_tracker_reads_the_true_body_from_its_structure(dut: Any, time_s: float, expected: list[float]) -> None:
    assert inputs(dut) == {"body_state": N_STATE, "structure": 9, "noise": dut.n_noise}
    assert feedthrough(dut) == {"reading": set(inputs(dut))}
    body, context = np.zeros(N_STATE), dut.CreateDefaultContext()
    body[QUATERNION], body[POSITION] = (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
    give(dut, context, body_state=body, structure=np.zeros(9), noise=np.eye(dut.n_noise)[0])
    context.SetTime(time_s)
    assert_allclose(output(dut, context, "reading"), expected, atol=1e-12)
    assert_array_equal(np.isnan(expected), np.isnan(output(dut, context, "reading")))
