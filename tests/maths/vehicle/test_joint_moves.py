"""Profiles of joint moves, and the forces of their drives."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from massprop_drake.maths.vehicle.joint_moves import JointReference, Move, drive_forces, driven_inertia, peak_rate
from massprop_drake.maths.vehicle.joint_moves import joint_reference as at

MOVES = (Move(2.0, 6.0, 1.5), Move(6.0, 7.0, -0.5))


def test_a_profile_goes_from_rest_to_rest_and_is_consistent() -> None:
    for time_s, position in ((0.0, 0.5), (2.0, 0.5), (4.0, 1.0), (6.0, 1.5), (6.5, 0.5), (9.0, -0.5)):
        assert at(0.5, MOVES, time_s).position == pytest.approx(position, abs=1e-14)
    # a quarter of 4 s: s = 1/4: 10/64 - 15/256 + 6/1024 = 0.103515625
    assert at(0.5, MOVES, 3.0).position == pytest.approx(0.603515625, rel=1e-14)
    for time_s in (0.0, 2.0, 6.0, 7.0, 9.0):
        assert_allclose(at(0.5, MOVES, time_s)[1:], 0.0, atol=1e-14)
    assert peak_rate(-2.0, 1.0) == abs(at(0.5, MOVES, 6.5).rate)
    step = 1e-4
    for time_s in np.linspace(2.1, 6.9, 13):
        before, here, after = (at(0.5, MOVES, time_s + shift) for shift in (-step, 0.0, step))
        assert here.rate == pytest.approx((after.position - before.position) / (2 * step), abs=1e-6)
        assert here.acceleration == pytest.approx((after.rate - before.rate) / (2 * step), abs=1e-5)


def test_a_drive_gives_its_inertia_the_wanted_acceleration_and_damps_errors_critically() -> None:
    # a cart of 3 kg with one of 1 kg on it, coordinates of the first and relative: M = [[4, 1], [1, 1]]; what drives
    # the second alone moves the reduced mass, 3/4 kg
    assert_allclose(driven_inertia(np.array([[4.0, 1.0], [1.0, 1.0]]), [1]), [[0.75]], rtol=1e-15)
    inertia, w = np.array([[2.0, 0.5], [0.5, 1.0]]), 2.0 * np.pi * 2.0
    wanted = [JointReference(1.0, 0.2, 3.0), JointReference(0.0, 0.0, 0.0)]
    off = drive_forces(wanted, np.array([0.9, 0.0]), np.array([0.1, 0.0]), inertia, 2.0)
    assert_allclose(off, inertia @ [3.0 + 2.0 * w * 0.1 + w * w * 0.1, 0.0], rtol=1e-12)
