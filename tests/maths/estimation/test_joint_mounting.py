"""Mounting of the jets in the joint filter and in hindsight: against differences, and drawn errors."""

from __future__ import annotations

import numpy as np
from joint_probe import POSITIONS, derivatives, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint.joint_cycle import driven
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, RATE, VELOCITY, PartCounts, make_places
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.mounting import mounting

EACH = mounting(small_params().wrenches, POSITIONS, np.full((6, 2), (0.02, 0.01)))
PARAMS = small_params(
    places=make_places(PartCounts(6, 2, 2, mounts=EACH.jets.size), 2, (True, True), True, 2, ticks=2),
    prior_sigma=np.concatenate((np.ones(6 + 2 + 6 + 6 + EACH.jets.size), np.zeros(1 + 2 + 2))),
    mounting=EACH,
    second_order=False,
)
PLACES = PARAMS.places
OWN = slice(PLACES.mount, PLACES.mount + PLACES.n_mount)


def test_derivatives_agree_with_central_differences() -> None:
    state, sample = some_state(PARAMS), some_sample(PARAMS)
    found, expected = derivatives(state, sample, PARAMS)
    assert np.abs(expected[RATE, OWN]).max() > 1e-6
    for group in (INERTIA, CENTER, OWN, slice(PLACES.thrust, PLACES.thrust + PLACES.n_thrust)):
        for row, least in ((RATE, 5e-3), (slice(VELOCITY, VELOCITY + 3), 2e-2)):  # as for engines
            scale = np.abs(expected[row, group]).max()
            if scale > 0.0:
                np.testing.assert_allclose(found[row, group] / scale, expected[row, group] / scale, atol=least)


def test_products_of_errors_count() -> None:
    """Mean and covariance of the products of these errors with those of the parameters, by drawn errors."""
    params = PARAMS._replace(second_order=True)
    state, rng = some_state(params), np.random.default_rng(3)
    root, rows = 0.0 * state.root, [*range(6, 9), *range(OWN.start, OWN.stop)]
    root[rows] = 0.02 * rng.standard_normal((len(rows), root.shape[1])) / np.sqrt(root.shape[1])
    root[OWN] *= 20.0
    state, sample = state._replace(root=root), some_sample(params)

    def change(errors: Array) -> Array:
        there = state._replace(mean=state.mean + errors, root=0.0 * root)
        return predict(there, driven(there, sample, params), unread(params), params).mean[RATE]

    found = predict(state, driven(state, sample, params), unread(params), params)
    plain = predict(state, driven(state, sample, PARAMS), unread(PARAMS), PARAMS)
    drawn = root @ rng.standard_normal((root.shape[1], 600))
    own = np.zeros(root.shape[0])
    own[OWN] = 1.0
    straight = change(0.0 * own)
    left = np.array([change(one) - change(one * own) - change(one * (1.0 - own)) + straight for one in drawn.T])
    mean = found.mean[RATE] - plain.mean[RATE]
    np.testing.assert_allclose(mean, left.mean(axis=0), atol=4.0 * left.std(axis=0).max() / np.sqrt(600))
    np.testing.assert_allclose(np.diag(found.noise - plain.noise)[:3], left.var(axis=0), rtol=0.4)
