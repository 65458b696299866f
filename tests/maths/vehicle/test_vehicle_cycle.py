"""The readings of all packages of a sample, against those of each package alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import PERFECT_SENSOR, PERIOD_S

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle import vehicle_cycle
from massprop_drake.maths.vehicle.depletion import Tanks
from massprop_drake.maths.vehicle.reaction_jets import make_jets
from massprop_drake.maths.vehicle.rigid_body import (
    N_STATE,
    ORIGIN_VELOCITY,
    RATE,
    SPIN_INTEGRAL,
    add_wheel_momentum,
    initial_state,
)
from massprop_drake.maths.vehicle.sensing import TruePackage, point_velocity, sense

POSITIONS = (None, np.array([3.0, -1.0, 0.5]), np.array([-20.0, 4.0, 2.0]))
BODY = np.random.default_rng(5).standard_normal(N_STATE)
STANDING = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # inertia and center of mass
JETS = make_jets(np.zeros((1, 7)), np.zeros(1), PERIOD_S)


def made(index: int, **errors: Any) -> TruePackage:
    ideal = PERFECT_SENSOR._replace(quantum=0.05, phase=np.array([0.3, -0.2, 0.45]))
    position = POSITIONS[index]
    return TruePackage(f"package{index}", ideal._replace(integrates=position is not None, **errors), position)


def alone(one: TruePackage, noise: Array) -> Array:
    signal = BODY[RATE]
    if one.position is not None:
        signal = point_velocity(BODY[ORIGIN_VELOCITY], BODY[RATE], BODY[SPIN_INTEGRAL], one.position)
    return sense(signal, np.zeros(one.model.memory_size), noise, one.model)[0]


@pytest.mark.parametrize(
    "errors",
    [
        ({}, {}, {}),  # marks alone
        ({"limit": 0.4}, {}, {"limit": 1.0}),
        ({"quantum": 0.0, "limit": 0.4}, {"noise_std": 0.1}, {}),
        ({"bias": np.ones(3)}, {"bias": np.ones(3), "delay": 2}, {"scale_factor": np.full(3, 0.1)}),
    ],
)
def test_packages_read_together_what_each_reads_alone(errors: tuple[dict[str, Any], ...]) -> None:
    packages = tuple(made(index, **given) for index, given in enumerate(errors))
    params = vehicle_cycle.VehicleParams(PERIOD_S, 1, JETS, (), packages, None, {}, BODY, STANDING)
    coming = vehicle_cycle.draw_ahead(0, 1, params)
    together, _ = vehicle_cycle.sense(vehicle_cycle.initial_state(params), 0, coming, vehicle_cycle.pack_truth(params))
    expected = [alone(one, noise) for one, noise in zip(packages, coming.noise[0], strict=True)]
    np.testing.assert_array_equal(together, expected)
    assert np.isfinite(together).all()


@pytest.mark.parametrize("fill", [np.zeros(0), np.ones(1)])
def test_wheels_turn_the_body_alike_in_one_piece_and_in_two(fill: Array) -> None:
    tanks = Tanks(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 1)))
    weak = make_jets(np.full((1, 7), 1e-12), np.zeros(1), PERIOD_S)
    body = initial_state(2.0)
    params = vehicle_cycle.VehicleParams(PERIOD_S, 1, weak, (), (), None, {}, body, STANDING, tanks=tanks, fill=fill)
    start = vehicle_cycle.initial_state(params)
    wheels = np.array([0.1, -0.2, 0.3, 0.5, 0.4, -0.6])  # momentum and its derivative
    turning = start._replace(constants=add_wheel_momentum(start.constants, wheels))
    command, within_s, none = np.array([0.5]), np.array([0.3 * PERIOD_S]), np.zeros(1)
    rates = []
    for told, onset_s in ((np.zeros(1), none), (command, within_s)):  # of a jet that hardly pushes
        draws = vehicle_cycle.draw_ahead(0, 1, params), 0
        after, _ = vehicle_cycle.step(turning, (told, onset_s, none), 0, draws, vehicle_cycle.pack_truth(params))
        rates.append(after.body[RATE])
    np.testing.assert_allclose(rates[0], rates[1], rtol=1e-8)
    np.testing.assert_allclose(rates[0], -wheels[3:] * PERIOD_S / STANDING[:3], rtol=0.05)
