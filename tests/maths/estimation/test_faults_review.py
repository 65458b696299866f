"""Review of a likely hypothesis: first orders about itself against filters of the alternatives from their onsets on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from faults_probe import leaking

from massprop_drake.maths.estimation.faults import review as reviews
from massprop_drake.maths.estimation.faults.fault_events import advance_hypothesis
from massprop_drake.maths.estimation.faults.priors import Params
from massprop_drake.maths.estimation.faults.proposals import draw_proposals
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import Kind, failure_slot
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.linear_algebra import Array


def reviewed(tree: Tree, params: Params) -> reviews.Review:
    """The review of the likeliest hypothesis, up to now."""
    leader = tree.leader
    review = reviews.begin_review(leader, params.joint)
    for sample, over in tree.samples[review.run.cycle - tree.cycle :]:
        review = reviews.advance_review(review, leader, sample, over, params.joint)
    return review


def alternatives(tree: Tree, params: Params) -> Iterator[tuple[float, float]]:
    """Log likelihood and prior of alternatives less those of the reviewed: to first order, and of their own filters.

    First orders have the shares of full thrust in them, by which small jets are not favored.
    """
    leader = tree.leader
    _, births, _ = reviews.draw_alternatives(reviewed(tree, params), leader, tree.hypotheses, params)
    thrusts = params.joint.thrusts
    for birth in births:
        child, cause = birth.child, birth.child.run.cause
        if cause.kind != Kind.JETS or child.walks.any() or cause.failures == leader.ways:
            continue
        if child.run.onset != leader.run.onset:  # others stand for an onset of the screen that is of several cycles
            continue
        assert birth.than == leader.events
        for sample, over in tree.samples[child.run.cycle - tree.cycle :]:
            child = advance_hypothesis(child, sample, over, params.joint, starting=False)
        favor = np.log(thrusts[list(cause.jets)] / thrusts.max()).sum() - np.log(thrusts[3] / thrusts.max())
        own = child.run.score.likelihood + child.prior - leader.run.score.likelihood - leader.prior
        yield birth.ahead - favor, own


@pytest.mark.parametrize("quantum", [0.0, 3e-3], ids=["noisy", "rounded"])
def test_first_orders_of_alternatives_are_those_of_their_own_filters(quantum: float) -> None:
    """By the ratio of Savage and Dickey; but for what a force is worth, which first orders leave to N(0, T^2)."""
    flown = leaking(quantum)
    assert flown.tree.leader.ways == {(3, 1)}
    pairs = np.array(list(alternatives(flown.tree, flown.params)))
    assert pairs.shape[0] > 2
    off = pairs[:, 0] - pairs[:, 1]
    assert np.ptp(off) < 1.0
    assert np.abs(off).max() < 2.5  # the reviewed one was born when its impulse at the onset might still be larger
    assert np.ptp(pairs[:, 1]) > 1.0


def test_a_weaker_push_from_outside_costs_less_by_the_sample() -> None:
    """A push costs 20 nats a sample, and 30 % less for each tenth of it."""
    flown = leaking(3e-3)
    tree, each = next((tree, each) for tree in flown.trees for each in tree.hypotheses if each.alarm)
    births, _ = draw_proposals(each, tree.cycle, tree.hypotheses, flown.params)
    pushes = [birth for birth in births if birth.child.run.cause.kind == Kind.UNKNOWN]
    assert [birth.child.push for birth in pushes] == [1.0, 0.1, 0.01]
    samples = tree.cycle - each.alarm.screen.onsets[0]
    assert np.diff([birth.ahead for birth in pushes]) == pytest.approx(6.0 * samples)


def test_a_hypothesis_without_an_origin_or_with_a_force_that_walks_is_not_reviewed() -> None:
    leader = leaking(3e-3).tree.leader
    assert reviews.is_reviewable(leader)
    assert not reviews.is_reviewable(leader._replace(origin=None))
    assert not reviews.is_reviewable(leader._replace(walks=np.array([0.03, 0.0, 0.0, 0.0])))
    assert not reviews.is_reviewable(leader._replace(run=leader.run._replace(cycle=leader.run.onset)))


def test_a_force_is_weighed_by_its_share_of_the_jets_thrust() -> None:
    """The posterior density of a force at nothing is over that of N(0, T^2): a stronger jet may have such a force."""
    flown = leaking(3e-3)
    leader, joint = flown.tree.leader, flown.params.joint
    review = reviewed(flown.tree, flown.params)
    slot = joint.places.force + failure_slot(review.run.state, 3, 1)
    variance = float(np.sum(review.run.state.root[slot] ** 2))
    density = -0.5 * review.run.state.mean[slot] ** 2 / variance - 0.5 * np.log(variance) + np.log(joint.thrusts[3])
    assert density < -20.0
    assert reviews.is_force_significant(review, leader, joint)
    assert not reviews.is_force_significant(review, leader, joint._replace(thrusts=np.exp(-density) * joint.thrusts))


def test_parameters_that_are_known_after_all_count_as_if_they_never_were_estimated() -> None:
    """A linear model y = X b + F f + e, all of it at once: by a filter that estimates b, and with some of b known.

    The filter is off by C f, C = -B X^T Y^-1 F, Y = X B X^T + R.
    """
    rng = np.random.default_rng(8)
    n, h, readings = 7, 3, 40
    rows, value = np.array([1, 4]), np.array([0.7, -1.1])
    x, f = rng.standard_normal((readings, n)), rng.standard_normal((readings, N_PROPERTIES + h))
    prior, noise, y = rng.uniform(0.5, 2.0, n), 0.3, 2.0 * rng.standard_normal(readings)

    def explained_by(columns: Array, variances: Array, read: Array) -> tuple[Array, Array, Array]:
        """Information and projection of F with the columns X taken as unknown, and Y^-1."""
        inverse = np.linalg.inv(columns @ np.diag(variances) @ columns.T + noise**2 * np.eye(readings))
        return f.T @ inverse @ f, f.T @ inverse @ read, inverse

    information, projection, inverse = explained_by(x, prior, y)
    estimate = np.diag(prior) @ x.T @ inverse @ y
    covariance = np.diag(prior) - np.diag(prior) @ x.T @ inverse @ x @ np.diag(prior)
    columns = -np.diag(prior) @ x.T @ inverse @ f
    jump, jets = slice(0, N_PROPERTIES), slice(N_PROPERTIES, None)
    screen = screens.Screen(
        onsets=(0,),
        gaps=(1,),
        cycle=1,
        columns=columns,
        acting=np.zeros((1, 2, 3)),
        information=information[jets, jets][None],
        projection=projection[jets][None],
        jump_information=information[jump, jump],
        jump_projection=projection[jump],
        scores=(),
    )
    found = screens.condition_screen(screen, rows, value - estimate[rows], covariance[np.ix_(rows, rows)])
    rest = np.setdiff1d(np.arange(n), rows)
    whole, pulled, _ = explained_by(x[:, rest], prior[rest], y - x[:, rows] @ value)
    np.testing.assert_allclose(found.information[0], whole[jets, jets], rtol=1e-9)
    np.testing.assert_allclose(found.projection[0], pulled[jets], rtol=1e-9)
    np.testing.assert_allclose(found.jump_information, whole[jump, jump], rtol=1e-9)
    np.testing.assert_allclose(found.jump_projection, pulled[jump], rtol=1e-9)
