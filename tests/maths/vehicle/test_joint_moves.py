"""Profiles of joint moves, and the forces of their drives."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.vehicle.joint_moves import (
    JointReference,
    Move,
    drive_forces,
    driven_inertia,
    peak_rate,
    reference,
)

MOVES = (Move(2.0, 6.0, 1.5), Move(6.0, 7.0, -0.5))


@pytest.mark.parametrize(
    ("time_s", "expected"),
    [
        (0.0, (0.5, 0.0, 0.0)),
        (2.0, (0.5, 0.0, 0.0)),
        # a quarter of 4 s: s = 1/4: 10/64 - 15/256 + 6/1024 = 0.103515625; 30/16 * 9/16 / 4; 60/4 * 3/4 * 1/2 / 16
        (3.0, (0.603515625, 0.263671875, 0.3515625)),
        (4.0, (1.0, 1.875 / 4.0, 0.0)),
        (6.0, (1.5, 0.0, 0.0)),
        (6.5, (0.5, -3.75, 0.0)),
        (9.0, (-0.5, 0.0, 0.0)),
    ],
)
def test_a_profile_has_its_hand_values(time_s: float, expected: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(reference(0.5, MOVES, time_s), expected, rtol=1e-14, atol=1e-14)


def test_the_peak_rate_is_that_of_the_middle() -> None:
    assert peak_rate(-2.0, 1.0) == abs(reference(0.5, MOVES, 6.5).rate)


def test_rates_and_accelerations_are_derivatives() -> None:
    step = 1e-4
    for time_s in np.linspace(2.1, 6.9, 13):
        before, here, after = (reference(0.5, MOVES, time_s + shift) for shift in (-step, 0.0, step))
        assert here.rate == pytest.approx((after.position - before.position) / (2 * step), abs=1e-6)
        assert here.acceleration == pytest.approx((after.rate - before.rate) / (2 * step), abs=1e-5)


def test_a_drive_gives_its_inertia_the_wanted_acceleration_and_damps_errors_critically() -> None:
    inertia = np.array([[2.0, 0.5], [0.5, 1.0]])
    wanted = [JointReference(1.0, 0.2, 3.0), JointReference(0.0, 0.0, 0.0)]
    exact = drive_forces(wanted, np.array([1.0, 0.0]), np.array([0.2, 0.0]), inertia, 2.0)
    np.testing.assert_allclose(exact, inertia @ [3.0, 0.0], rtol=1e-15)
    w = 2.0 * np.pi * 2.0
    off = drive_forces(wanted, np.array([0.9, 0.0]), np.array([0.1, 0.0]), inertia, 2.0)
    np.testing.assert_allclose(off, inertia @ [3.0 + 2.0 * w * 0.1 + w * w * 0.1, 0.0], rtol=1e-12)


def test_the_driven_inertia_is_that_with_all_else_free() -> None:
    # a cart of 3 kg with one of 1 kg on it, coordinates of the first and relative: M = [[4, 1], [1, 1]]; what drives
    # the second alone moves the reduced mass, 3/4 kg
    np.testing.assert_allclose(driven_inertia(np.array([[4.0, 1.0], [1.0, 1.0]]), [1]), [[0.75]], rtol=1e-15)
