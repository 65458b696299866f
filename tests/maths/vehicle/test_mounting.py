"""Mounting of jets: to first order as it truly is, and only what is uncertain."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.vehicle.mounting import displace_wrenches, mounting_errors, true_mounted_wrenches

POSITIONS = np.array([[1.0, 0.2, 0.0], [-1.0, 0.0, 0.3], [0.2, -1.0, 0.4]])
FORCES = np.array([[0.0, 1.0, 0.2], [0.1, 0.0, 2.0], [3.0, 0.0, 0.1]])
WRENCHES = np.hstack((np.cross(POSITIONS, FORCES), FORCES))
SIGMAS = np.array([[1e-3, 2e-3], [2e-3, 0.0], [0.0, 1e-3]])


def test_first_order_is_that_of_what_it_truly_is() -> None:
    each = mounting_errors(WRENCHES, POSITIONS, SIGMAS)
    assert each.jets.tolist() == [0, 0, 0, 0, 1, 1, 2, 2]
    drawn = np.random.default_rng(1).standard_normal((3, 4))
    there = np.repeat(SIGMAS > 0.0, 2, axis=1)
    found = displace_wrenches(WRENCHES, drawn[there], each)
    expected = true_mounted_wrenches(WRENCHES, POSITIONS, drawn * np.repeat(SIGMAS, 2, axis=1))
    np.testing.assert_allclose(found, expected, atol=1e-4)  # of .006 rad the second order is 2e-5 of 3 units
    assert np.abs(found - WRENCHES).max() > 1e-3


def test_a_force_keeps_its_size_and_acts_where_it_is_moved_to() -> None:
    errors = np.array([[0.1, -0.2, 0.3, 0.1], [0.0, 0.1, 0.0, 0.2], [0.05, 0.0, -0.1, 0.0]])
    found = true_mounted_wrenches(np.hstack((WRENCHES, np.ones((3, 1)))), POSITIONS, errors)
    sizes = np.linalg.norm(FORCES, axis=1)
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:6], axis=1), sizes, rtol=1e-12)
    turned = np.arccos(np.sum(found[:, 3:6] * FORCES, axis=1) / sizes**2)
    np.testing.assert_allclose(np.tan(turned), np.linalg.norm(errors[:, :2], axis=1), rtol=1e-9)
    np.testing.assert_allclose(np.sum(found[:, :3] * found[:, 3:6], axis=1), 0.0, atol=1e-12)
    np.testing.assert_array_equal(found[:, 6], 1.0)
    shifted = true_mounted_wrenches(WRENCHES, POSITIONS, errors * [0, 0, 1, 1])
    arms = np.linalg.norm(shifted[:, :3] - WRENCHES[:, :3], axis=1) / sizes
    np.testing.assert_allclose(arms, np.linalg.norm(errors[:, 2:], axis=1), rtol=1e-12)  # across the force
