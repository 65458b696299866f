"""The readings of all packages of a sample, against those of each package alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle import cycle
from massprop_drake.maths.vehicle.rigid_body import N_STATE, ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import Package, SensorModel, package, point_velocity, sense

PERIOD = 0.08  # s
POSITIONS = (None, np.array([3.0, -1.0, 0.5]), np.array([-20.0, 4.0, 2.0]))
RNG = np.random.default_rng(5)
BODY = RNG.standard_normal(N_STATE)
NOISE, SHAKING = RNG.standard_normal((3, 6)), np.zeros((3, 3))
PHASE = np.array([0.3, -0.2, 0.45])


def _package(index: int, **errors: Any) -> Package:
    position = POSITIONS[index]
    ideal = SensorModel(
        period_s=PERIOD,
        scale_factor=np.zeros(3),
        smoothing=0.0,
        bias=np.zeros(3),
        walk_std=0.0,
        integrates=position is not None,
        noise_std=0.0,
        quantum=0.05,
        phase=PHASE,
        delay=0,
    )
    return package(f"package{index}", ideal._replace(**errors), position)


def _alone(one: Package, index: int) -> Array:
    signal = BODY[RATE]
    if one.position is not None:
        signal = point_velocity(BODY[ORIGIN_VELOCITY], BODY[RATE], BODY[SPIN_INTEGRAL], one.position)
    return sense(signal, np.zeros(one.model.memory_size), NOISE[index], one.model)[0]


def _sensed(packages: tuple[Package, ...]) -> Array:
    made: Any = cycle.packed_packages(packages)
    longest = max(one.model.memory_size for one in packages)
    state: Any = cycle.VehicleState(BODY, *(None,) * 5, np.zeros((len(packages), longest)))  # type: ignore[arg-type]
    luck: Any = cycle.Ahead(NOISE[None], SHAKING[None], *(None,) * 3)  # type: ignore[arg-type]
    truth: Any = cycle.Truth(PERIOD, *(None,) * 2, made, *(None,) * 2)  # type: ignore[arg-type]
    return cycle.sense(state, 0, luck, truth)[0]


@pytest.mark.parametrize(
    "errors",
    [
        ({}, {}, {}),
        ({}, {"quantum": 0.0}, {"quantum": 3.0}),
        ({"limit": 0.4}, {}, {"limit": 1.0}),
        ({"quantum": 0.0, "limit": 0.4}, {"noise_std": 0.1}, {}),
        ({"bias": np.ones(3)}, {"bias": np.ones(3), "delay": 2}, {"scale_factor": np.full(3, 0.1)}),
    ],
    ids=["marks alone", "one without marks", "ranges", "noise beside exact ones", "none exact"],
)
def test_packages_read_together_what_each_reads_alone(errors: tuple[dict[str, Any], ...]) -> None:
    packages = tuple(_package(index, **given) for index, given in enumerate(errors))
    together = _sensed(packages)
    np.testing.assert_array_equal(together, [_alone(one, index) for index, one in enumerate(packages)])
    assert math.isfinite(together.sum())
