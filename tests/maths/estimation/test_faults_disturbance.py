"""Something that acts and that nobody stated: hypotheses of it beside those of jets, and what is said."""

from __future__ import annotations

import numpy as np
import pytest
from faults_probe import commands_of, fail, flight, known_vehicle, make_params, push
from joint_probe import PERIOD, some_sample, unread

from massprop_drake.maths.estimation.faults.declarations import DisturbanceDeclared, JetsDeclared
from massprop_drake.maths.estimation.joint.hypotheses import (
    STIRS,
    Cause,
    Kind,
    blurred,
    opened,
    size_of_unstated,
)
from massprop_drake.maths.estimation.joint.joint_cycle import driven
from massprop_drake.maths.estimation.joint.layout import RATE
from massprop_drake.maths.estimation.joint.prediction import predict, propagated

PARAMS = make_params(unstated=6)
JOINT = PARAMS.joint
PLACES = JOINT.places
OWN = slice(PLACES.unstated, PLACES.unstated + 6)
KNOWN = known_vehicle(JOINT)


def swinging(count: int, onset: int) -> dict[int, object]:
    """An acceleration of every component that swings once in some four seconds, from an interval on."""
    most = 0.02 * JOINT.unstated.diagonal()
    phases = np.arange(6.0)
    return {k: push(JOINT, most * np.sin(1.6 * PERIOD * (k - onset) + phases)) for k in range(onset, count)}


def test_something_unstated_is_said_with_its_size_and_no_jet_is_named() -> None:
    flown = flight(PARAMS, commands_of(100), changes=swinging(100, 30))
    said = [one for _, one in flown.said]
    assert not [one for one in said if isinstance(one, JetsDeclared)]
    first = next(one for one in said if isinstance(one, DisturbanceDeclared))
    torque, force = size_of_unstated(0.02, JOINT)
    assert 0.1 * torque < first.torque < 10.0 * torque
    assert 0.1 * force < first.force < 10.0 * force


def test_a_failed_jet_is_named_where_something_unstated_may_act() -> None:
    flown = flight(PARAMS, commands_of(60), changes={30: fail(2, 0.1 * JOINT.thrusts[2], on_top=1)})
    named = {one.jets for _, one in flown.said if isinstance(one, JetsDeclared)}
    assert named == {(2,)}
    assert not [one for _, one in flown.said if isinstance(one, DisturbanceDeclared)]


def test_it_stays_as_strong_as_it_is_while_nothing_is_read() -> None:
    acts = opened(KNOWN, Cause(Kind.WANDER, component=4), JOINT)
    sample = some_sample(JOINT, commands=np.zeros((1, 6)))
    prediction = predict(acts, driven(acts, sample, JOINT), unread(JOINT), JOINT)
    root = propagated(acts.root, prediction, JOINT)
    np.testing.assert_allclose(root[OWN] @ root[OWN].T, STIRS[4][0] ** 2 * np.eye(6), rtol=1e-9, atol=1e-15)
    turned = np.sqrt(np.sum(root[RATE] ** 2, axis=1))
    given = STIRS[4][0] * PERIOD * JOINT.unstated.diagonal()[:3]
    assert (turned > 0.95 * given).all()


def test_while_jets_fire_parameters_walk_by_the_share_that_it_has_in_what_they_give() -> None:
    level, constant_s = STIRS[4]
    acts = KNOWN._replace(stir=level, stir_s=constant_s)
    fires = some_sample(JOINT, commands=np.array([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]]))
    drift = predict(acts, driven(acts, fires, JOINT), unread(JOINT), JOINT).drift
    linear = (driven(acts, fires, JOINT).firing.amount @ JOINT.wrenches)[3:] * KNOWN.mean[9]
    share = level * PERIOD * np.linalg.norm(JOINT.unstated.diagonal()[3:]) / np.linalg.norm(linear)
    assert share < level * np.sqrt(6.0)  # else it is that of one jet
    assert drift[9] == pytest.approx(2.0 * PERIOD / constant_s * (share * KNOWN.mean[9]) ** 2)
    rest = some_sample(JOINT, commands=np.zeros((1, 6)))
    assert not predict(acts, driven(acts, rest, JOINT), unread(JOINT), JOINT).drift.any()
    assert not predict(KNOWN, driven(KNOWN, fires, JOINT), unread(JOINT), JOINT).drift.any()


def test_what_has_acted_until_now_has_made_parameters_less_well_known() -> None:
    acts = KNOWN._replace(stir=0.1)
    once = blurred(acts, 0.0, PERIOD, JOINT)
    share = once.root[0, 0] / KNOWN.root[0, 0]
    assert share > 2.0
    np.testing.assert_allclose(abs(once.root[:10, :10]), share * abs(KNOWN.root[:10, :10]), atol=1e-18)
    again = blurred(acts, 0.1, PERIOD, JOINT)
    np.testing.assert_allclose(abs(again.root[:10, :10]), abs(KNOWN.root[:10, :10]), atol=1e-18)
