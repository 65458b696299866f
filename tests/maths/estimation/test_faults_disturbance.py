"""Something that acts and that nobody stated: hypotheses of it beside those of jets, and what is said."""

from __future__ import annotations

import numpy as np
import pytest
from faults_probe import commands_of, fail, flight, known_vehicle, make_params, push
from joint_probe import PERIOD, some_sample, unread

from massprop_drake.maths.estimation.faults.declarations import DisturbanceDeclared, JetsDeclared
from massprop_drake.maths.estimation.joint.beginning import begun
from massprop_drake.maths.estimation.joint.hypotheses import (
    STIRS,
    Cause,
    Kind,
    blurred,
    opened,
    size_of_unstated,
    stirs_beyond,
)
from massprop_drake.maths.estimation.joint.joint_cycle import driven
from massprop_drake.maths.estimation.joint.layout import RATE
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.propagation import propagated

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
    flown = flight(PARAMS, commands_of(160), changes=swinging(160, 30))
    said = [one for _, one in flown.said]
    assert not [one for one in said if isinstance(one, JetsDeclared)]
    first = next(one for one in said if isinstance(one, DisturbanceDeclared))
    torque, force = size_of_unstated(0.02, JOINT)
    assert 0.1 * torque < first.torque < 10.0 * torque
    assert 0.1 * force < first.force < 10.0 * force


@pytest.mark.parametrize(("jet", "force", "on_top"), [(2, 0.1, 1), (4, 1.0, 0)])
def test_a_failed_jet_is_named_where_something_unstated_may_act(jet: int, force: float, on_top: int) -> None:
    full = float(JOINT.thrusts[jet])
    flown = flight(PARAMS, commands_of(80), changes={30: fail(jet, force * full, on_top=on_top)})
    named = {one.jets for _, one in flown.said if isinstance(one, JetsDeclared)}
    assert named == {(jet,)}
    assert not [one for _, one in flown.said if isinstance(one, DisturbanceDeclared)]


def test_what_begins_to_act_is_as_strong_as_the_hypothesis_has_it() -> None:
    level, constant_s = STIRS[5]
    after = opened(KNOWN, Cause(Kind.WANDER, component=5), JOINT)
    np.testing.assert_allclose(after.root[OWN] @ after.root[OWN].T, level**2 * np.eye(6), atol=1e-15)
    assert (after.stir, after.stir_s) == (level, constant_s)
    before, now = (each.root[:10] @ each.root[:10].T for each in (KNOWN, after))
    np.testing.assert_allclose(now, before)


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


def test_what_acts_already_goes_on_faster_and_jumps_only_if_it_is_said_to() -> None:
    first = opened(KNOWN, Cause(Kind.WANDER, component=9), JOINT)
    faster = opened(first, Cause(Kind.WANDER, component=4), JOINT, 0.0)
    np.testing.assert_allclose(faster.root[OWN] @ faster.root[OWN].T, STIRS[9][0] ** 2 * np.eye(6), atol=1e-15)
    assert faster.stir == STIRS[4][0]
    jumped = opened(first, Cause(Kind.WANDER, component=4), JOINT, 1.0)
    expected = (STIRS[9][0] ** 2 + STIRS[4][0] ** 2) * np.eye(6)
    np.testing.assert_allclose(jumped.root[OWN] @ jumped.root[OWN].T, expected)


def test_what_has_acted_until_now_has_made_parameters_less_well_known() -> None:
    acts = KNOWN._replace(stir=0.1)
    once = blurred(acts, 0.0, PERIOD, JOINT)
    share = once.root[0, 0] / KNOWN.root[0, 0]
    assert share > 2.0
    np.testing.assert_allclose(abs(once.root[:10, :10]), share * abs(KNOWN.root[:10, :10]), atol=1e-18)
    again = blurred(acts, 0.1, PERIOD, JOINT)
    np.testing.assert_allclose(abs(again.root[:10, :10]), abs(KNOWN.root[:10, :10]), atol=1e-18)


def test_only_what_is_as_strong_or_stronger_is_looked_for() -> None:
    assert stirs_beyond(KNOWN, JOINT) == list(range(len(STIRS)))
    level, constant_s = STIRS[6]
    assert stirs_beyond(KNOWN._replace(stir=level, stir_s=constant_s), JOINT) == list(range(7))
    assert stirs_beyond(known_vehicle(make_params().joint), make_params().joint) == []


def test_after_a_gap_it_is_as_unknown_as_its_level() -> None:
    acts = opened(KNOWN, Cause(Kind.WANDER, component=5), JOINT)._replace(time_s=1.0)
    after = begun(acts, some_sample(JOINT, time_s=1.0 + 5.0 * STIRS[5][1]), JOINT)
    np.testing.assert_allclose(after.root[OWN] @ after.root[OWN].T, STIRS[5][0] ** 2 * np.eye(6), rtol=1e-3, atol=1e-12)
    closed = begun(KNOWN, some_sample(JOINT, time_s=9.0), JOINT)
    assert not closed.root[OWN].any()
